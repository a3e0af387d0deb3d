"""The answer to a quadratic program: primal and dual values, judged by the conditions of Karush, Kuhn and Tucker."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...core.checks import FloatVector, checked_vector, read_only
from ...core.errors import InvalidOption, InvalidProblem
from .convexity import bends
from .criterion import SURE, Errors

if TYPE_CHECKING:
    from .no_minimum import QPInfeasibility, QPUnboundedness
    from .program import QuadraticProgram

MEANINGS = {  # each beside what acts there
    "primal_residual": "by how much x violates a constraint, beside its terms",
    "dual_residual": "what is left of the gradient of the Lagrangian, beside its terms",
    "duality_gap": "what all errors together may change the objective by, beside its terms",
}


@dataclass(frozen=True, eq=False)
class QPSolution:
    """A point x and multipliers of a quadratic program, with the three measures that judge them.

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
    What the three residuals are relative to: :mod:`lcp_plugin.problems.programs.criterion`.

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
        sizes = {
            "x": n,
            "inequality": program.h.size,
            "equality": program.b.size,
            "lower": n,
            "upper": n,
        }
        for name, size in sizes.items():
            vector = checked_vector(getattr(self, name), name, size, allow_nan=name != "x")
            object.__setattr__(self, name, vector)

    @classmethod
    def of_rows(
        cls, program: QuadraticProgram, x: FloatVector, multipliers: FloatVector
    ) -> QPSolution:
        """Return that of finite vectors, the multipliers of all ``program.constraints`` in one; they are kept."""
        m, p, n, _ = program.matrices.sizes
        made, every = object.__new__(cls), read_only(multipliers)
        made.__dict__.update(
            program=program,
            x=read_only(x),
            inequality=every[:m],
            equality=every[m : m + p],
            lower=every[m + p : m + p + n],
            upper=every[m + p + n :],
            multipliers=every,
        )
        return made

    @classmethod
    def without_multipliers(cls, program: QuadraticProgram, x: FloatVector) -> QPSolution:
        """Return that of an answer that came with a proof: its multipliers are NaN."""
        return cls.of_rows(program, x, np.full(program.constraints.limit.size, np.nan))

    @cached_property
    def objective(self) -> float:
        """½ xᵀP x + cᵀx."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.program.objective(self.x)

    @property
    def primal_residual(self) -> float:
        """By how much x violates a row or a bound beside that row's own terms."""
        return float(self._errors.primal)

    @property
    def dual_residual(self) -> float:
        """What is left of a component of the Lagrangian's gradient beside its terms, or a multiplier's wrong sign."""
        return float(self._errors.dual)

    @cached_property
    def multipliers(self) -> FloatVector:
        """All multipliers, one a row of ``program.constraints``."""
        return np.concatenate([self.inequality, self.equality, self.lower, self.upper])

    @property
    def error(self) -> float:
        """The largest of the primal residual, the dual residual and the duality gap."""
        return float(self._errors.largest)

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
            raise InvalidProblem(
                "the program has no ranges; use inequality and equality, or from_ranges to make it"
            )
        order, signs, count = self.program.ranges
        y: FloatVector = np.zeros(count)
        np.add.at(y, order, signs * np.concatenate([self.inequality, self.equality]))
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
        return self.is_stationary(tolerance) and self.program.facts.is_shown_convex

    def is_stationary(self, tolerance: float = 1e-6) -> bool:
        """Return whether all three residuals and every row's own are at most the tolerance, and `duality_gap` small.

        Constraints are asked for a tenth of the tolerance, but no less than 1e-7 where the tolerance is no less.
        For a convex program the conditions are sufficient.

        Raises
        ------
        InvalidOption
            Where the tolerance is no number ≥ 0.
        """
        if (
            isinstance(tolerance, bool)
            or not isinstance(tolerance, (int, float, np.number))
            or not tolerance >= 0.0
        ):
            raise InvalidOption(f"tolerance must be a number ≥ 0, got {tolerance!r}")
        return bool(self.own_errors.decide(float(tolerance)) or self._errors.meet(float(tolerance)))

    def is_minimal(self, tolerance: float = 1e-6, *, is_beside_own: bool = False) -> bool:
        """Return whether x is stationary, and no negative curvature acts at it: what SOLVED says of a program.

        Or whether a quicker look says so already, beside the own terms of rows and columns alone.
        """
        is_met = (
            bool(self.own_errors.decide(tolerance))
            if is_beside_own
            else self.is_stationary(tolerance)
        )
        return is_met and not bends(self.program, self.x, tolerance)

    def is_sure(self, tolerance: float = 1e-6) -> bool:
        """Return whether x is stationary, and no exact proof of unboundedness may beat it: none is looked for.

        The gradient is 0 to a thousandth of the tolerance, or the program falls nowhere for ever.
        """
        is_small = self.own_errors.gap <= SURE * tolerance  # which nothing that acts makes smaller
        return (is_small and self._errors.are_sure(tolerance)) or (
            self.is_stationary(tolerance) and self.program.facts.falls_nowhere
        )

    def balances_surely(self, tolerance: float = 1e-6) -> bool:
        """Return whether the multipliers balance the gradient so well that no proof of endless descent may beat it.

        Along a direction d of descent Pd = 0 and all constraints hold: cᵀd ≥ 0 whatever slack there is.
        """
        return bool(self.own_errors.dual <= SURE * tolerance) or self.program.facts.falls_nowhere

    def holds_surely(self, tolerance: float = 1e-6) -> bool:
        """Return whether x holds all constraints so well that no proof of a contradiction may beat it."""
        return bool(self._errors.primal <= SURE * tolerance)

    @property
    def duality_gap(self) -> float:
        """By how much the errors of all conditions together may change the objective, beside its size.

        Σ |x_j left_j| + Σ |y_i (d_i − c_i x)|, of what is left of the gradient and of all constraints c_i x ≤ d_i: far
        out along a direction in which the objective hardly changes each error is small beside its own terms, and not
        all of them beside the objective.
        """
        return float(self._errors.gap)

    @cached_property
    def own_errors(self) -> Errors:
        """Bounds of the errors from above, in half the time."""
        return Errors.beside_own_terms(self.program, self.x, self.multipliers)

    @cached_property
    def _errors(self) -> Errors:
        return self.own_errors.or_excused(self.program, self.x, self.multipliers)

    @cached_property
    def proof(self) -> QPInfeasibility | QPUnboundedness | None:
        """A proof that no x is optimal (to 1e-6): looked for, by linear programs, where x is not surely stationary.

        Where it verifies exactly, it is stronger than an x within the tolerance.
        """
        return None if self.is_sure() else self.program.facts.accepted_proof()

    @property
    def status(self) -> str:
        """Return "optimal" by the residuals, "infeasible" or "unbounded" by a proof, otherwise "unknown".

        "stationary" instead of "optimal" where P is not shown to be positive semidefinite.
        """
        if self.proof is not None:
            return self.proof.verdict
        if not self.is_stationary():
            return "unknown"
        return "optimal" if self.is_optimal() else "stationary"

    def __str__(self) -> str:
        lines = [f"{'objective':<16} {self.objective:.9g}"]
        for name, meaning in MEANINGS.items():
            if not np.isnan(value := getattr(self, name)):
                lines.append(f"{name.replace('_', ' '):<16} {value:.3e}  {meaning}")
        if np.isnan(self.multipliers).any():
            lines.append("no multipliers: a proof came instead")
        return "\n".join(lines)
