"""Proofs that a problem has no solution: inconsistent linear constraints, or excluded complementarity pieces."""
