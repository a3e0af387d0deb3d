"""Many problems at once: prepare, solve_many, solve_batch."""
