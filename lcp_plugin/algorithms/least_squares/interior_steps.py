"""Interior points: they find the face where A is too ill-conditioned for other steps.

The gradient on the columns that may move is M x + q with M = AᵀA + ridge, and the predictor–corrector takes that as it
takes any monotone M. A point is shown with the columns at their bounds whose multipliers exceed their distances.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from ...checks import FloatVector
from ...kernels.floats import EPSILON
from ..interior_points.newton_matrix import NewtonMatrix
from ..interior_points.predictor_corrector import PredictorCorrector
from .faces import Faces, Solve
from .point import Point

CORRECTIONS = 2  # a solve is cheap beside a factor of AᵀA
SMALLEST_STEP = 1e-8  # a shorter one leads nowhere
PRECISION = EPSILON**2  # complementarity, ÷ that of the start, from which on rounding decides
STEPS = 100


class NormalMatrix(NewtonMatrix):
    """AᵀA + ridge + diag on some columns: products by A, factors by AᵀA, whose errors active sets mend at the end."""

    def __init__(self, faces: Faces, columns: Any) -> None:
        self._faces, self._columns = faces, columns
        super().__init__(LinearOperator((columns.size, columns.size), self._product, dtype=np.float64))
        self._solve: Solve = np.copy

    def _product(self, d: FloatVector) -> FloatVector:
        problem = self._faces.problem
        direction = np.zeros(problem.lower.size)
        direction[self._columns] = d
        bent = problem.transposed(problem.product(direction)) + problem.ridge * direction
        return np.asarray(bent[self._columns])

    def _try(self, diagonal: FloatVector) -> bool:
        solve = self._faces.factor(self._columns, diagonal)
        self._solve = solve or self._solve
        return solve is not None

    factorise = _try  # the faces find the shift that a singular AᵀA needs

    def _apply(self, right: FloatVector) -> FloatVector:
        return self._solve(right)

    solve = _apply


def interior_steps(start: Point, faces: Faces) -> Iterator[Point]:
    """Yield points from the start on; ends where rounding decides which columns are free."""
    yield start
    problem, x = start.problem, start.x
    columns = np.flatnonzero(problem.lower < problem.upper)
    matrix, lower, upper = NormalMatrix(faces, columns), problem.lower[columns], problem.upper[columns]
    fixed = np.where(problem.lower < problem.upper, 0.0, problem.lower)
    point = PredictorCorrector(matrix, Point(problem, fixed).gradient[columns], lower, upper, CORRECTIONS)
    point.start_near(x[columns], start.gradient[columns])
    first = point.gap
    for _ in range(STEPS):
        if not point.step():
            return
        active, at = point.active(1.0)
        x = fixed.copy()
        x[columns] = np.clip(np.where(active, at, point.z), lower, upper)
        yield Point(problem, x)
        if point.length <= SMALLEST_STEP or not point.gap > PRECISION * first:
            return
