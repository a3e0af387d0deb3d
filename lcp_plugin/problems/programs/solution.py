"""The solution of a quadratic program: primal and dual values, and their Karush–Kuhn–Tucker residuals."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ...core.checks import FloatVector, checked_vector, derived_property, read_only
from ...core.errors import InvalidProblem
from ...core.settings import checked_tolerance
from .criterion import PROGRAM_TOLERANCE, KKTErrors

if TYPE_CHECKING:
    from .program import QuadraticProgram

MEANINGS = {
    "primal_residual": "by how much x violates a constraint, relative to its terms",
    "duality_gap": "bound of the change of the objective by all errors together, relative to its terms",
}


@dataclass(frozen=True, eq=False)
class QPSolution:
    """Point x and multipliers of a quadratic program, with the two measures of the test.

    The multipliers have the signs of cvxpy's ``dual_value``: at a solution

        P x + c + Gᵀ inequality + Aᵀ equality − lower + upper = 0,   inequality, lower, upper ≥ 0.

    Attributes
    ----------
    program : QuadraticProgram
        The data on which everything is measured.
    x : ndarray, shape (n,)
    inequality : ndarray, shape (rows of G,)
        Multipliers of G x ≤ h; 0 if h_i = ∞.
    equality : ndarray, shape (rows of A,)
        Multipliers of A x − b = 0, of either sign.
    lower, upper : ndarray, shape (n,)
        Multipliers of lower ≤ x and x ≤ upper; 0 for an infinite bound. All multipliers are NaN if the result has a
        proof that no solution exists.

    Notes
    -----
    The references of the measures: :mod:`lcp_plugin.problems.programs.criterion`.

    Raises
    ------
    InvalidProblem
        If one of them is not a vector of the right length, or has an infinite entry, or if x has a NaN.
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
        """Return the solution with finite x and all multipliers of ``program.constraints`` in one array, not copied."""
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
    def from_reduced(cls, program: QuadraticProgram, x: FloatVector, y: FloatVector) -> QPSolution:
        """Return the solution from x and multipliers of the rows of `FoldedRows`; bounds get the remaining gradient.

        Wrong signs of multipliers become 0.

        Raises
        ------
        InvalidProblem
            If a multiplier of the program is beyond the range of doubles.
        """
        folded = program.folded
        reduced, m = folded.reduced, folded.reduced.h.size
        y = np.append(np.maximum(y[:m], 0.0), y[m:])
        P, C = reduced.matrices.measured[:2]
        left = P @ x + reduced.c + C.T @ y
        at_lower = np.where(np.isfinite(reduced.lower), np.maximum(left, 0.0), 0.0)
        at_upper = np.where(np.isfinite(reduced.upper), np.maximum(-left, 0.0), 0.0)
        every = folded.multipliers(np.concatenate([y, at_lower, at_upper]))
        _refuse_infinite(program, every)
        return cls.of_rows(program, x, every)

    @classmethod
    def without_multipliers(cls, program: QuadraticProgram, x: FloatVector) -> QPSolution:
        """Return a solution with NaN multipliers, for a result with a proof."""
        return cls.of_rows(program, x, np.full(program.constraints.limit.size, np.nan))

    @derived_property
    def objective(self) -> float:
        """½ xᵀP x + cᵀx + constant."""
        return self.program.objective(self.x)

    @property
    def primal_residual(self) -> float:
        """Largest violation of a row or bound, relative to the terms of the row."""
        return float(self.errors.primal)

    @derived_property
    def multipliers(self) -> FloatVector:
        """Multipliers of all rows of ``program.constraints``."""
        return np.concatenate([self.inequality, self.equality, self.lower, self.upper])

    @property
    def error(self) -> float:
        """The larger of the duality gap and 1000 times the primal residual: at most 1e-6 if x is optimal."""
        return float(self.errors.largest)

    @property
    def row_multipliers(self) -> FloatVector:
        """Multipliers y of the rows that `QuadraticProgram.from_ranges` was given, P x + c + Aᵀy − lower + upper = 0.

        Positive at a row's upper limit, negative at its lower one.

        Raises
        ------
        InvalidProblem
            If the program was not constructed by `from_ranges`.
        """
        if self.program.ranges is None:
            raise InvalidProblem(
                "the program has no ranges; use inequality and equality, or from_ranges to make it"
            )
        order, signs, count = self.program.ranges
        y: FloatVector = np.zeros(count)
        np.add.at(y, order, signs * np.concatenate([self.inequality, self.equality]))
        return y

    def is_optimal(self, tolerance: float = PROGRAM_TOLERANCE) -> bool:
        """Return whether x is optimal for a convex program: `primal_residual` ≤ 1e-9 and `duality_gap` ≤ tolerance.

        Raises
        ------
        InvalidOption
            If the tolerance is not a number in [0, 1).
        """
        return bool(self.errors_for(checked_tolerance(tolerance)).meet(tolerance))

    @property
    def duality_gap(self) -> float:
        """Bound of the change of the objective by all errors, relative to its terms; of the worst component."""
        return float(self.errors.gap)

    @derived_property
    def errors(self) -> KKTErrors:
        """Both measures."""
        return self.errors_for(0.0)

    @np.errstate(all="ignore")
    def errors_for(self, tolerance: float) -> KKTErrors:
        """Return both measures, or bounds of them if these meet the tolerance already."""
        return KKTErrors.of(self.program.folded.reduced, self.x, self.reduced_y, tolerance)

    @property
    def reduced_y(self) -> FloatVector:
        """Multipliers of the rows that remain in `FoldedRows`."""
        rows = self.program.h.size + self.program.b.size
        return self.multipliers[:rows][self.program.folded.left]

    def __str__(self) -> str:
        lines = [f"{'objective':<16} {self.objective:.9g}"]
        for name, meaning in MEANINGS.items():
            if not np.isnan(value := getattr(self, name)):
                lines.append(f"{name.replace('_', ' '):<16} {value:.3e}  {meaning}")
        if np.isnan(self.multipliers).any():
            lines.append("no multipliers: a proof came instead")
        return "\n".join(lines)


def _refuse_infinite(program: QuadraticProgram, multipliers: FloatVector) -> None:
    """Raise InvalidProblem if the multiplier of a constraint is beyond the range of doubles."""
    if np.isfinite(multipliers).all():
        return
    for name, part in zip(
        ("G", "A", "lower", "upper"), program.constraints.split(multipliers), strict=True
    ):
        for row in np.flatnonzero(np.isinf(part))[:1]:
            raise InvalidProblem(
                f"the multiplier of {name}[{row}] is beyond the range of doubles, ±1.8e308; give that constraint, "
                "limits and the objective in units in which their largest coefficients are near 1"
            )
