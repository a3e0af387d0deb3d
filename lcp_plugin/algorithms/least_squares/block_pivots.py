"""Block pivots: solve on the free columns, exchange all that have the wrong sign, until none has.

A few rounds lead to the face from anywhere, however many columns change, where AᵀA is well-conditioned. Proximal terms
½ δ ‖x − x_k‖² make it so: x_k+1 is the minimum with the term, and with the next, smaller δ few columns change.

References
----------
L. F. Portugal, J. J. Júdice, L. N. Vicente, *A comparison of block pivoting and interior-point algorithms for linear
least squares problems with nonnegative variables*, Math. Comp. 63 (1994), doi:10.1090/S0025-5718-1994-1250776-4.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ...checks import FloatVector
from ...deadline import is_over
from .active_set import active_set_steps
from .faces import Faces
from .point import Point

PROXIMITY = (1e-4, 1e-8)  # δ, of columns of unit length; the first where A is wide, so that AᵀA is singular
NOISE = 1e3  # times rounding: less is no pull on a column at its bound, by a gradient with AᵀA
PATIENCE = 5  # rounds that do not lessen the columns with a wrong sign
ROUNDS = 20  # of active sets, which let A have the last word


def block_pivot_steps(start: Point, faces: Faces) -> Iterator[Point]:
    """Yield points from the start on: active sets from where the rounds arrive, nothing else where they do not."""
    yield start
    point = start
    for proximity in PROXIMITY[0 if faces.is_wide else 1 :]:
        x = _proximal_point(point, faces, proximity)
        if x is None:
            return
        point = Point(point.problem, x)
    yield from islice(active_set_steps(point, faces), 1, ROUNDS)


def _proximal_point(centre: Point, faces: Faces, proximity: float) -> FloatVector | None:
    """Return the minimum of the cost + ½ δ ‖x − centre‖² within the bounds; None where the rounds do not arrive."""
    problem, side = centre.problem, _sides(centre)
    fewest, patience = side.size + 1, PATIENCE
    noise = NOISE * centre.noise
    while patience > 0 and not is_over():
        bound = np.where(side < 0, problem.lower, np.where(side > 0, problem.upper, centre.x))
        d, free = bound - centre.x, np.flatnonzero(side == 0)
        solve = faces.factor(free, np.full(free.size, proximity))
        if solve is None:
            return None
        d[free] = solve(-(centre.gradient + faces.product(d))[free])
        slope = centre.gradient + faces.product(d) + proximity * d
        x = np.where(side == 0, centre.x + d, bound)
        after = np.where(x < problem.lower, -1, np.where(x > problem.upper, 1, side))
        after[(side * slope > noise) & (problem.lower < problem.upper)] = 0
        wrong = int(np.count_nonzero(after != side))
        if wrong == 0:
            return x
        fewest, patience = min(wrong, fewest), PATIENCE if wrong < fewest else patience - 1
        side = after
    return None


def _sides(point: Point) -> NDArray[np.int_]:
    """Return −1 for columns at their lower bound, 1 at the upper one, 0 for those between and those pulled inwards."""
    held = ~point.is_free & (point.pull == 0.0)
    return np.where(held, np.where(point.x <= point.problem.lower, -1, 1), 0)
