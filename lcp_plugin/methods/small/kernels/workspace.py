"""The workspace of one small problem: which row of its few work arrays holds what.

On a few unknowns a compiled call with twelve arrays, or a view of a part of one, costs more than what is done with it.
So all vectors of a problem lie in one array `real`, shape (16, n + 1), all indices in one array `whole`, (7, 2n + 6),
and a tableau or a linear system in `matrix`, (n + 16, n + 1); functions take these three and (M, k), M of shape
(B, n, n).
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import inlined

# Rows of `real`: the problem, the point, what a search for the next point needs, what a path needs.
# Of numpy's integers, as numba compiles a function anew for each of Python's that is passed to it.
Q, LOWER, UPPER, SCALE, Z, W, FOUND, KEPT = np.arange(8)
WIDTH, BASE, ROW_UNIT, UNIT, LOW, HIGH, DISTANCE, HELD_AT = np.arange(8, 16)

# Rows of `whole`.
SIDE, STATE, FREE, BASIC, PLACE, OTHER, CANDIDATE = 0, 1, 2, 3, 4, 5, 6

HELD = 8  # pivots whose products are added to a large tableau at once; their columns and rows lie behind it in `matrix`

AT_LOWER, BETWEEN, AT_UPPER, FIXED = 0, 1, 2, 3


def shapes(n):  # type: ignore[no-untyped-def]
    """Return those of `real`, `whole` and `matrix`."""
    return (16, n + 1), (7, 2 * n + 6), (n + 2 * HELD, n + 1)


sizes = inlined(shapes)
