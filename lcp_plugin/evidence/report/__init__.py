"""One report of everything: `plan` says what is computed, `collect` computes it, `summary` reads it, `page` shows it."""
