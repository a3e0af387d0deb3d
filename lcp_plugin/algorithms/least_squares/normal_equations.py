"""Least squares as the LCP with M = AᵀA, where that is no larger than A: the methods for M find the face.

The condition of M is that of A squared, so their answer is where active sets begin, which take A itself.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...checks import BoolVector, FloatVector
from ...errors import LCPError
from ...problem.lcp import LCP
from ...problem.least_squares import UnitLeastSquares
from ..interior_points.interior_point import InteriorPoint
from ..short_road import as_batch, sprint_of_arrays
from .faces import DenseFaces, SparseFaces
from .point import Point

GOAL = 1e-8  # more than M tells at the condition from which on its answer is only a start
COMPILED_STEPS = 1000


def compiled_face(start: Point, faces: DenseFaces) -> tuple[Point, BoolVector] | None:
    """Return the face where the compiled methods for small problems arrive, None where they do not.

    It is a point with columns at their bounds, and which others are free: these are as near to 0 as may be, since where
    A is rank-deficient the x of AᵀA may be of any size.
    """
    problem = start.problem
    M, q = faces.matrix.T @ faces.matrix, -(faces.matrix.T @ faces.right)
    if not np.isfinite(M.sum() + q.sum()):
        return None
    arrays = tuple(map(as_batch, (M, q, problem.lower, problem.upper, start.x)))
    sprint = sprint_of_arrays(arrays, GOAL, COMPILED_STEPS)
    if sprint is None:
        return None
    free = (sprint.z > problem.lower) & (sprint.z < problem.upper)
    return _point(problem, np.where(free, 0.0, sprint.z)), free


def interior_points_of_gram(start: Point, faces: SparseFaces) -> Iterator[Point]:
    """Yield the points of the interior point method on AᵀA."""
    problem = start.problem
    try:
        gram = LCP(faces.gram, -problem.transposed(problem.b), lower=problem.lower, upper=problem.upper)
        for step in InteriorPoint().iterates(gram, start.x):
            yield _point(problem, step.z)
    except LCPError:  # it has no way with this matrix
        return


def _point(problem: UnitLeastSquares, z: FloatVector) -> Point:
    return Point(problem, np.clip(z, problem.lower, problem.upper))

