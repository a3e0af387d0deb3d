"""Nonlinear complementarity problems: F, steps by linearisation, certificate."""
