"""Solving with a factor, and again with what is left over: when another solve is worth it."""

from __future__ import annotations

REFINEMENTS = 5
ROUGH = 1e-7  # beside the right-hand side: more is always worth another solve
REFINED = 1e-12  # beside the right-hand side: what is left is not worth another solve
USEFUL = 0.1  # a refinement that leaves more of the error than this is not worth another
STABLE = 1e-10  # the same beside the solution, which is large where the matrix is nearly singular
