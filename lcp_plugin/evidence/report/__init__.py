"""One report of everything: `plan` says what is computed, `collect` computes, `summary` reads, `page` shows it."""
