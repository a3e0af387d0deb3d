"""Active sets: Newton's method, its linear systems, and principal pivots."""
