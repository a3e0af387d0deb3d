"""Algebraic multigrid hierarchy of one matrix, and its truncation to the free unknowns."""
