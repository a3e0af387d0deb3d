"""One report of everything: `plan` says what is computed, `collect` computes, sections tell, `write_report` shows."""
