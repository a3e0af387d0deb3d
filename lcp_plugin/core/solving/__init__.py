"""solve(): a run, its incumbent and its judge; the result."""
