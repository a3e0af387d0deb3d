"""A run: its stages, its best point, the stopping criterion, the result."""
