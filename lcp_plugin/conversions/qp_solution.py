"""The answer to a quadratic program: primal and dual values, judged by the conditions of Karush, Kuhn and Tucker."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import FloatVector, checked_vector
from ..errors import InvalidOption, InvalidProblem
from ..matrix.matrix import largest_in_rows
from .constraints import constraint_tolerance, enclosed_sum_of_two
from .program_matrices import as_csr

if TYPE_CHECKING:
    from .program import QuadraticProgram
    from .qp_proofs import QPInfeasibility, QPUnboundedness

LARGEST_SLOPE = 1e-3

@dataclass(frozen=True, eq=False)
class QPSolution:
    """A point x and multipliers of a quadratic program, with the three residuals that judge them.

    The multipliers have the signs of cvxpy's ``dual_value``: at a solution

        P x + c + Gᵀ inequality + Aᵀ equality − lower + upper = 0,   inequality, lower, upper ≥ 0.

    Attributes
    ----------
    program : QuadraticProgram
        The data on which everything is measured.
    x : ndarray, shape (n,)
    inequality : ndarray, shape (rows of G,)
        Of G x ≤ h; 0 where h is ∞.
    equality : ndarray, shape (rows of A,)
        Of A x − b = 0, of either sign.
    lower, upper : ndarray, shape (n,)
        Of lower ≤ x and of x ≤ upper; 0 where the bound is infinite. All multipliers are NaN where the answer came
        with a proof that there are none.

    Notes
    -----
    The primal and the dual residual are in units of the data (``unit`` and ``dual_unit`` in
    :mod:`lcp_plugin.conversions.constraints`), never relative to x: what is optimal in them cannot be refuted.
    Complementarity is relative to 1 + its largest term. ``row_residual`` compares each row with its own terms only, so
    that a coefficient of 1e7 in one row, or a limit of 1e9 that nobody reaches, excuses nothing in another.

    Raises
    ------
    InvalidProblem
        Where one of them is no vector of its length, or has an infinite entry; x must have no NaN either.
    """

    program: QuadraticProgram = field(repr=False)
    x: FloatVector
    inequality: FloatVector
    equality: FloatVector
    lower: FloatVector
    upper: FloatVector

    def __post_init__(self) -> None:
        """Keep read-only copies: the residuals are computed once."""
        n, program = self.program.n, self.program
        sizes = {"x": n, "inequality": program.h.size, "equality": program.b.size, "lower": n, "upper": n}
        for name, size in sizes.items():
            vector = checked_vector(getattr(self, name), name, size, allow_nan=name != "x")
            object.__setattr__(self, name, vector)

    @cached_property
    def objective(self) -> float:
        """½ xᵀP x + cᵀx."""
        return self.program.objective(self.x)

    @cached_property
    def primal_residual(self) -> float:
        """By how much x violates G x ≤ h, A x = b and its bounds, rounding included; each row in units of the data."""
        rows = self.program.constraints
        return _largest(rows.excess(self.x) / rows.unit)

    @cached_property
    def dual_residual(self) -> float:
        """What is left of P x + c + Gᵀ inequality + Aᵀ equality − lower + upper, or a multiplier's wrong sign.

        Each component in units of the data; multipliers of a wrong sign count as 0 in the sum.
        """
        program, rows, y = self.program, self.program.constraints, self.multipliers
        right = np.where(rows.is_equality, y, np.maximum(y, 0.0))
        left = enclosed_sum_of_two((as_csr(program.P), self.x), (rows.transposed, right), program.c)
        return _largest(np.abs(left) / program.dual_unit) + _largest(right - y) / (1.0 + _largest(np.abs(program.c)))

    @cached_property
    def complementarity(self) -> float:
        """The largest product of a multiplier and the distance from its limit."""
        rows, y = self.program.constraints, np.where(self.program.constraints.is_equality, 0.0, self.multipliers)
        value = self._values
        limit = np.where((y != 0.0) & np.isfinite(rows.limit), rows.limit, value)
        # A multiplier of an infinite limit can never be right.
        products = np.abs(np.where(np.isinf(rows.limit), y, y * (limit - value)))
        return _largest(products) / (1.0 + _largest(np.abs(np.concatenate([y * value, y * limit]))))

    @cached_property
    def _values(self) -> FloatVector:
        values: FloatVector = self.program.constraints.matrix @ self.x
        return values

    @cached_property
    def multipliers(self) -> FloatVector:
        """All multipliers, one a row of ``program.constraints``."""
        return np.concatenate([self.inequality, self.equality, self.lower, self.upper])

    @property
    def residual(self) -> float:
        """The largest of the primal residual, the dual residual and complementarity."""
        return float(np.max([self.primal_residual, self.dual_residual, self.complementarity]))

    @cached_property
    def row_residual(self) -> float:
        """The largest error of any condition, each relative to 1 + the largest term of its own row."""
        program, rows, y = self.program, self.program.constraints, self.multipliers
        is_finite = np.isfinite(rows.limit)
        gap = np.where(is_finite, rows.limit - self._values, 0.0)
        size = np.maximum(_largest_terms(rows.matrix, self.x), np.where(is_finite, np.abs(rows.limit), 0.0))
        violated = np.where(rows.is_equality, np.abs(gap), np.maximum(-gap, 0.0))
        wrong = np.where(is_finite, np.maximum(-y, 0.0), np.abs(y))
        y_size = np.abs(y) * size
        # A limit that holds is no term of a violation, as above.
        errors = [violated / (1.0 + np.where(violated > 0.0, size, 0.0))]
        errors += [error[~rows.is_equality] for error in (np.abs(y * gap) / (1.0 + y_size), wrong)]
        terms = [_largest_terms(program.P, self.x), np.abs(program.c), _largest_terms(rows.transposed, y)]
        return _largest(np.concatenate([*errors, np.abs(self._left) / (1.0 + np.max(terms, axis=0))]))

    @property
    def row_multipliers(self) -> FloatVector:
        """Multipliers y of the rows that `QuadraticProgram.from_ranges` was given, P x + c + Aᵀy − lower + upper = 0.

        Positive at a row's upper limit, negative at its lower one.

        Raises
        ------
        InvalidProblem
            Where the program was not made by `from_ranges`.
        """
        if self.program.ranges is None:
            raise InvalidProblem("the program has no ranges; use inequality and equality, or from_ranges to make it")
        y: FloatVector = self.program.ranges @ np.concatenate([self.inequality, self.equality])
        return y

    def is_optimal(self, tolerance: float = 1e-6) -> bool:
        """Return whether x is stationary and P is shown to be positive semidefinite, up to rounding.

        Only then the conditions are sufficient. Where it takes a factorisation to show that, it is made once; where
        that would be too large (n above some 67 000, much fill) and no row shows it, this is False: `is_stationary` is
        enough if you know the program to be convex.

        Raises
        ------
        InvalidOption
            Where the tolerance is no number ≥ 0.
        """
        return self.is_stationary(tolerance) and self.program.is_shown_convex

    def is_stationary(self, tolerance: float = 1e-6) -> bool:
        """Return whether all three residuals and every row's own are at most the tolerance, and `slope_along_x` small.

        Constraints are asked for a tenth of the tolerance, but no less than 1e-7 where the tolerance is no less.
        For a convex program the conditions are sufficient.

        Raises
        ------
        InvalidOption
            Where the tolerance is no number ≥ 0.
        """
        if isinstance(tolerance, bool) or not isinstance(tolerance, (int, float, np.number)) or not tolerance >= 0.0:
            raise InvalidOption(f"tolerance must be a number ≥ 0, got {tolerance!r}")
        if not self.primal_residual <= constraint_tolerance(float(tolerance)):
            return False
        is_small = self.residual <= tolerance and self.row_residual <= tolerance
        return bool(is_small and self.slope_along_x <= max(LARGEST_SLOPE, tolerance))

    @cached_property
    def slope_along_x(self) -> float:
        """What the error of the gradient makes of the objective on the way from 0 to x, beside its largest term.

        Rows with large entries, or multipliers of 1e20, excuse any gradient beside their own terms.
        """
        program = self.program
        by_row = np.abs(np.concatenate([program.c * self.x, (program.P @ self.x) * self.x]))
        return float(abs(self._left @ self.x)) / (1.0 + _largest(by_row))

    @cached_property
    def _left(self) -> FloatVector:
        program, y = self.program, self.multipliers
        left: FloatVector = program.P @ self.x + program.c + program.constraints.transposed @ y
        return left

    @cached_property
    def proof(self) -> QPInfeasibility | QPUnboundedness | None:
        """A proof that no x is optimal (to 1e-6): looked for, by linear programs, where x is not stationary."""
        return None if self.is_stationary() else self.program.refutation()

    @property
    def status(self) -> str:
        """Return "optimal" by the residuals, "infeasible" or "unbounded" by a proof, otherwise "unknown".

        "stationary" instead of "optimal" where P is not shown to be positive semidefinite.
        """
        if self.is_stationary():
            return "optimal" if self.is_optimal() else "stationary"
        return "unknown" if self.proof is None else self.proof.verdict

    def __str__(self) -> str:
        lines = [
            ("objective", f"{self.objective:.9g}"),
            ("primal residual", f"{self.primal_residual:.3e}"),
            ("dual residual", f"{self.dual_residual:.3e}"),
            ("complementarity", f"{self.complementarity:.3e}"),
            ("row residual", f"{self.row_residual:.3e}"),
        ]
        return "\n".join(f"{name:<16} {value}" for name, value in lines)


def _largest(values: FloatVector) -> float:
    return float(values.max(initial=0.0))


def _largest_terms(matrix: Any, vector: FloatVector) -> FloatVector:
    """Return max_j |a_ij v_j| of each row."""
    rows = as_csr(matrix)
    return largest_in_rows(rows, np.abs(rows.data * vector[rows.indices]))
