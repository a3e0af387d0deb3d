"""The units in which a program is called optimal, and in which it is refuted: those of its data, never of an x."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..exact.rounding import compensated_product

if TYPE_CHECKING:
    from .quadratic_program import QuadraticProgram

CONSTRAINTS = 1e-7  # what constraints are asked for at any tolerance between this and 1e-6
SHARE = 0.1  # of a larger tolerance


@dataclass(frozen=True, eq=False)
class Units:
    """What a program's residuals are relative to: sizes of its data, the same for every x.

    Attributes
    ----------
    inequality, equality : ndarray
        For each row of G and of A its largest coefficient (1 where it is empty) times 1 + its right-hand side ÷ that
        coefficient: the row's own, so that no large number elsewhere excuses it.
    lower, upper : ndarray, shape (n,)
        The same for the bounds, whose coefficient is 1.
    dual : ndarray, shape (n,)
        The largest entry of each column of P, G and A (1 where there is none) times 1 + the largest |c_j| ÷ that;
        where there is a P, the largest |b_i| ÷ coefficient of an equation, and of an inequality that x = 0 violates, if
        that is larger.

    Notes
    -----
    Where multipliers y contradict by c, every x violates some row by (c / Σ|y_i| unit_i) · unit_i at least: "optimal"
    and "infeasible" exclude each other. Along a direction d of descent some component of the dual residual is at least
    (−cᵀd / Σ|d_j| dual_j) · dual_j, whatever x and the multipliers are.
    """

    inequality: FloatVector
    equality: FloatVector
    lower: FloatVector
    upper: FloatVector
    dual: FloatVector

    @classmethod
    def of(cls, program: QuadraticProgram) -> Units:
        """Return the units of a program."""
        rows, equations = (_or_one(_largest(matrix, 1)) for matrix in (program.G, program.A))
        columns = [_largest(matrix, 0) for matrix in (program.P, program.G, program.A)]
        column = _or_one(np.max(columns, axis=0))
        with np.errstate(over="ignore"):
            limits, right = program.h / rows, np.abs(program.b / equations)
            size = max(right.max(initial=0.0), (-limits).max(initial=0.0))
            slope = float(np.abs(program.c / column).max(initial=0.0))
            return cls(
                rows * (1.0 + _finite(limits)), equations * (1.0 + right),
                1.0 + _finite(program.lower), 1.0 + _finite(program.upper),
                column * (1.0 + (max(slope, size) if columns[0].any() else slope)),
            )


def constraint_tolerance(tolerance: float) -> float:
    """Return the primal residual that is called optimal where the other conditions hold to a tolerance.

    A tenth of the tolerance, but no less than 1e-7 where the tolerance is no less: a program whose constraints
    contradict by 1e-6 is infeasible, not nearly feasible.

    Examples
    --------
    >>> constraint_tolerance(1e-6), constraint_tolerance(1e-12), constraint_tolerance(1e-3)
    (1e-07, 1e-12, 0.0001)
    """
    return max(SHARE * tolerance, min(tolerance, CONSTRAINTS))


def enclosed_sum(matrix: Any, vector: FloatVector, offset: FloatVector) -> FloatVector:
    """Return the end of a proved enclosure of matrix · vector + offset that is farther from 0; NaN where one is NaN."""
    with np.errstate(all="ignore"):
        value, radius = compensated_product(sp.csr_array(matrix), vector, offset)
        return np.where(np.isfinite(radius), value + np.copysign(radius, value), np.nan)


def _largest(matrix: Any, axis: int) -> FloatVector:
    """Return the largest |entry| of each row (axis 1) or column (axis 0)."""
    if 0 in matrix.shape:
        return np.zeros(matrix.shape[1 - axis])
    largest = abs(matrix).max(axis=axis)
    return np.asarray(largest.toarray() if sp.issparse(largest) else largest, dtype=np.float64).ravel()


def _finite(limits: FloatVector) -> FloatVector:
    """Return |limits|, 0 for infinite ones."""
    return np.where(np.isfinite(limits), np.abs(limits), 0.0)


def _or_one(sizes: FloatVector) -> FloatVector:
    return np.where(sizes > 0.0, sizes, 1.0)
