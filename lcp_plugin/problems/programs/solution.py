"""Solution of a quadratic program: x and the multipliers of all constraints, with the two measures of the criterion."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from ...core.checks import MadeOnAccess, Vector, checked_vector, derived_property, fill, read_only
from ...core.entries import largest_products, max_norm
from ...core.errors import InvalidProblem
from ...core.settings import checked_tolerance
from ...engines.linear_program import highs
from ...judges.program import PROGRAM_TOLERANCE, ROWS, KKTErrors, PrimalDualPoint
from ...judges.worst_rows import WorstRow, WorstRows
from .program import QuadraticProgram

MULTIPLIERS = "inequality", "equality", "lower", "upper"
MEANINGS = {
    "primal_residual": "by how much x violates a constraint, relative to its terms",
    "duality_gap": "bound of the change of the objective by all errors together, relative to its terms",
}


@dataclass(frozen=True, eq=False)
class QPSolution(MadeOnAccess):
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
        Multipliers of lower ≤ x and x ≤ upper; 0 for an infinite bound. x and all multipliers are NaN if the result
        has a proof that no solution exists.

    Notes
    -----
    The references of the measures: :mod:`lcp_plugin.judges.program`.

    Raises
    ------
    InvalidProblem
        If a vector has the wrong length or an infinite entry, or if x has a NaN.
    """

    program: QuadraticProgram = field(repr=False)
    x: Vector
    inequality: Vector
    equality: Vector
    lower: Vector
    upper: Vector

    def __post_init__(self) -> None:
        """Keep read-only copies: the residuals are computed once."""
        sizes = self.program.n, *self.program.matrices.sizes
        for name, size in zip(("x", *MULTIPLIERS), sizes, strict=True):
            vector = checked_vector(getattr(self, name), name, size, allow_nan=name != "x")
            fill(self, **{name: vector})

    @classmethod
    def of_rows(cls, program: QuadraticProgram, x: Vector, multipliers: Vector) -> QPSolution:
        """Return the solution with finite x and all multipliers of ``program.constraints`` in one array, not copied."""
        every = read_only(multipliers)
        parts = dict(zip(MULTIPLIERS, program.constraints.split(every), strict=True))
        return cls.of_known(None, program=program, x=read_only(x), multipliers=every, **parts)

    @classmethod
    def from_reduced(cls, program: QuadraticProgram, x: Vector, y: Vector) -> QPSolution:
        """Return the solution from x and multipliers of the rows of `FoldedRows`; bounds get the remaining gradient.

        Wrong signs of multipliers become 0.

        Raises
        ------
        InvalidProblem
            If a multiplier of the program is beyond the range of doubles.
        """
        reduced, y = program.reduced, y.copy()
        m = reduced.h.size
        np.maximum(y[:m], 0.0, out=y[:m])
        P, C = reduced.matrices.stacked
        slopes = P @ x + reduced.c
        y = reduced.matrices.terms.needed_multipliers(slopes, y)
        of_bounds = bound_multipliers(reduced, slopes + C.T @ y)
        every = np.concatenate([y, *of_bounds])
        if reduced is not program:
            every = program.folded.multipliers(every)
        if (is_infinite := np.isinf(every)).any():
            name = program.name(int(is_infinite.argmax()))
            raise InvalidProblem(
                f"the multiplier of {name} is beyond the range of doubles, ±1.8e308; give that constraint, limits and "
                "the objective in units in which their largest coefficients are near 1"
            )
        return cls.of_rows(program, x, every)

    @classmethod
    def on_access(cls, program: QuadraticProgram, x: Vector, y: Vector) -> QPSolution:
        """Return `from_reduced` of these, which is made at the first access to a multiplier."""
        make, x = partial(cls.from_reduced, program, x, y), read_only(x)
        return cls.of_known(make, program=program, x=x)

    @classmethod
    def none(cls, program: QuadraticProgram) -> QPSolution:
        """Return NaN for x and the multipliers, for a result with a proof that no solution exists."""
        x, y = (np.full(size, np.nan) for size in (program.n, program.constraints.limit.size))
        return cls.of_rows(program, x, y)

    @derived_property
    def objective(self) -> float:
        """½ xᵀP x + cᵀx + constant."""
        return self.program.objective(self.x)

    @property
    def primal_residual(self) -> float:
        """Largest violation of a row or bound, relative to the terms of the row."""
        return float(self.errors.primal)

    @derived_property
    def multipliers(self) -> Vector:
        """Multipliers of all rows of ``program.constraints``."""
        return np.concatenate([getattr(self, name) for name in MULTIPLIERS])

    @property
    def error(self) -> float:
        """The larger of the duality gap and 1000 times the primal residual: at most 1e-6 if x is optimal."""
        return float(self.errors.largest)

    @property
    def row_multipliers(self) -> Vector:
        """Multipliers y of the rows that `QuadraticProgram.from_ranges` was given, P x + c + Aᵀy − lower + upper = 0.

        Positive at a row's upper limit, negative at its lower limit.

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
        y: Vector = np.zeros(count)
        np.add.at(y, order, signs * np.concatenate([self.inequality, self.equality]))
        return y

    @np.errstate(all="ignore")
    def residuals(self) -> ProgramResiduals:
        """Return the residuals that other packages print: absolute and relative, by largest components."""
        program, (P, C) = self.program, self.program.matrices.stacked
        y, z = self.multipliers[: C.shape[0]], self.upper - self.lower
        x, rows, Px, Cy = self.x, C @ self.x, P @ self.x, C.T @ y
        d = np.concatenate([program.h, program.b])
        lower, upper, d = (
            np.where(np.isfinite(value), value, 0.0) for value in (program.lower, program.upper, d)
        )
        primal = float(np.maximum(program.constraints.excess(x), 0.0).max(initial=0.0))
        gradient, curved, linear = Px + program.c + Cy + z, float(x @ Px), float(program.c @ x)
        dual_value = -0.5 * curved - d @ y + lower @ self.lower - upper @ self.upper
        gap = abs(0.5 * curved + linear - float(dual_value))
        values = max(abs(0.5 * curved + linear), abs(float(dual_value)))
        terms = (rows, d, lower, upper), (Px, program.c, Cy, z)
        sizes = [*(max(map(max_norm, vectors)) for vectors in terms), values]
        absolute = np.array([primal, max_norm(gradient), gap])
        relative = absolute / np.maximum(sizes, 2.0**-1000)
        return ProgramResiduals(*absolute.tolist(), *relative.tolist())

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

    def gap(self) -> float:
        """Return the maximum of (P x + c)ᵀ(x − y) over all feasible y, by one linear program: 0 at a solution.

        ∞ without a maximum. NaN if HiGHS finds no feasible y, or x is not finite.
        """
        program = self.program
        slopes, sides = program.P @ self.x + program.c, (program.G, program.h, program.A, program.b)
        terms = abs(program.P) @ np.abs(self.x) + np.abs(program.c)
        # A slope at rounding level would be unbounded if x_j is free
        slopes = np.where(np.abs(slopes) <= 1e-12 * terms, 0.0, slopes)
        size = max_norm(slopes)
        if not 0.0 < size < np.inf:
            return float(size)
        optimum = highs(slopes / size, *sides, (program.lower, program.upper))
        if optimum.status:
            return np.inf if optimum.status == 3 else np.nan
        return max(0.0, float(slopes @ self.x - size * optimum.fun))

    @derived_property
    def errors(self) -> KKTErrors:
        """Both measures."""
        return self.errors_for(0.0)

    @np.errstate(all="ignore")
    def errors_for(self, tolerance: float) -> KKTErrors:
        """Return both measures, or bounds of them if these meet the tolerance already."""
        return KKTErrors.of(self.program.reduced.judged, self.x, self.reduced_y, tolerance)

    @property
    def reduced_y(self) -> Vector:
        """Multipliers of the rows that remain in `FoldedRows`."""
        rows = self.program.h.size + self.program.b.size
        return self.multipliers[:rows][self.program.folded.left]

    def __str__(self) -> str:
        if np.isnan(self.x).any():
            return "no solution: a proof came instead"
        lines = [f"{'objective':<16} {self.objective:.9g}"]
        for name, meaning in MEANINGS.items():
            lines.append(f"{name.replace('_', ' '):<16} {getattr(self, name):.3e}  {meaning}")
        return "\n".join(lines)


class ProgramResiduals(NamedTuple):
    """Residuals of x and its multipliers, in the form that most solvers of programs print.

    Attributes
    ----------
    primal : float
        Largest violation of a constraint or bound.
    dual : float
        ‖P x + c + Gᵀ inequality + Aᵀ equality − lower + upper‖∞.
    gap : float
        |primal objective − dual objective|.
    relative_primal, relative_dual, relative_gap : float
        Divided by the largest of ‖rows x‖∞ and the right-hand sides, of the terms of the gradient, and of both
        objectives.
    """

    primal: float
    dual: float
    gap: float
    relative_primal: float
    relative_dual: float
    relative_gap: float


def bound_multipliers(program: QuadraticProgram, gradient: Vector) -> tuple[Vector, Vector]:
    """Return the multipliers of the finite lower and upper bounds that balance a gradient of the Lagrangian."""
    at_lower = np.where(np.isfinite(program.lower), np.maximum(gradient, 0.0), 0.0)
    at_upper = np.where(np.isfinite(program.upper), np.maximum(-gradient, 0.0), 0.0)
    return at_lower, at_upper


def worst_constraints(
    program: QuadraticProgram, x: Vector, y: Vector, tolerance: float, count: int
) -> WorstRows:
    """Return the constraints that x violates by most, relative to their terms, then unknowns that add to the gap.

    y are multipliers of G and A. An unknown is shown if it adds more than the tolerance. Rows of G and A are measured,
    as by the criterion, with each x_j outside its bounds put on the nearer bound.
    """
    point, rows = PrimalDualPoint(program.judged, x, y, is_exact=True), program.constraints
    errors, m = point.row_errors(), rows.rows
    with np.errstate(all="ignore"):
        within, outside = (rows.matrix @ at - rows.limit for at in (point.x, x))
        excess = np.append(within[:m], outside[m:])
        terms = largest_products(abs(rows.matrix), np.abs(x))
    where = " with x on its bounds" if point.outside.any() else ""
    # row_errors has one entry per unknown for both of its bounds
    sides = np.append(excess[m : m + x.size] > 0.0, excess[m + x.size :] > 0.0)
    errors = np.concatenate([errors[:m], np.where(sides, np.tile(errors[m:], 2), 0.0)])
    worst = []
    for k in np.argsort(-errors, kind="stable")[:count].tolist():
        if errors[k] > ROWS:
            value, limit = float(excess[k] + rows.limit[k]), float(rows.limit[k])
            sign = -1.0 if m <= k < m + x.size else 1.0
            beyond = "≠" if rows.is_equality[k] else ">" if sign > 0.0 else "<"
            text = f"{program.name(k)} is violated{where if k < m else ''}: "
            text += f"{sign * value:.6g} {beyond} {sign * limit:.6g}"
            size, violation = max(float(terms[k]), abs(limit)), abs(float(excess[k]))
            worst.append(WorstRow(program.name(k), float(errors[k]), violation, size, text))
    shares = point.shares()
    for j in np.argsort(-shares, kind="stable")[: count - len(worst)].tolist():
        if shares[j] > tolerance:
            name, r = program.names.unknown(j, f"x[{j}]"), float(point.gradient[j])
            text = f"{name} = {x[j]:.6g} adds {shares[j]:.1e} to the gap: its gradient with the multipliers is {r:.3g}"
            worst.append(
                WorstRow(name, float(shares[j]), abs(r), float(point.slope_terms[j]), text)
            )
    return WorstRows(worst)
