"""Many problems at once: prepare, solve_batch."""
