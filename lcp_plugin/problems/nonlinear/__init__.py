"""Nonlinear complementarity problems: F, steps by linearization, certificate."""
