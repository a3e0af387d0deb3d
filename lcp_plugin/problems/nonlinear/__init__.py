"""Nonlinear complementarity problems: F and its derivative, steps by linearisation, certificate and proof."""
