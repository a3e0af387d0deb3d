"""Proofs that a problem has no solution: linear constraints that contradict, cases that are all excluded."""
