"""Stopping criterion of a quadratic program: the test of a point x with multipliers y of the rows.

The program is min ½ xᵀP x + cᵀx with rows C x ≤ d, or = d, and bounds. The test moves x into its bounds, sets
multipliers with a wrong sign to 0, and takes the gradient r = P x + c + Cᵀy for the multipliers of the bounds. With
T_i = Σ_j |c_ij x_j| + |d_i| and K = 1000, it requires

1. rows: each row is violated by at most 1e-9 T_i;
2. gap: in each connected component, Σ |y_i| |C x − d|_i + Σ |r_j| reach_j + max |r_j| way_j ≤ tolerance · size.

- size = |cᵀx| + |xᵀP x|, at least 1e-8 of Σ |c_j x_j| + |xᵀP x|, and at least 1e-6 of Σ y'_i T_i.
- price_j = |c_j| + |P x|_j + Σ_i |c_ij| y'_i; way_j = K size / price_j is the move of x_j that costs K objectives.
- reach_j is the distance from x_j to the bound to which −r_j pushes; beyond way_j it is at most K |x_j|, and only then
  the last term counts.
- y'_i is |y_i|, at most the largest |P x + c|_j of unknowns off their bounds, divided by the largest |c_ij|.

So no feasible point is better by more than the tolerance if its unknowns differ by at most K |x_j| and by moves that
cost together at most K times the objective; at t times these moves, the gain is at most t times the tolerance. If c_j =
0, |P| |x| takes the place of |P x| in price_j; if all costs of a component are 0, also in the size. Sums are plain,
with bounds of rounding errors. If these do not decide, sums are computed without rounding, and a violation of at most
2⁻⁴⁷ |c_ij| T_k/|c_kj| is allowed: it is the rounding of x_j in another row k.

Limits: a coefficient of 1e11 in another row may make a violation of 9e-10 expensive. If coefficients of one column span
1e12, a row may be violated by more, but x_j only by its rounding. A program may be unbounded although a program within
1e-10 of it has a minimum. An objective below 1e-12 of the terms of the rows, weighted with their multipliers, or below
1e-14 of its own terms, counts as 0. Costs beyond 2^1000 overflow.

The solution of a quadratic program: primal and dual values, and their Karush–Kuhn–Tucker residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.certificates.residuals import WorstRow, WorstRows
from ...core.checks import Vector, checked_vector, derived_property, read_only
from ...core.errors import InvalidProblem
from ...core.kernels.floats import DATA_ROUNDING, UNIT
from ...core.matrix import largest_in_rows, largest_products
from ...core.rounding import compensated_product
from ...core.settings import checked_tolerance
from ...engines.linear_program import highs

Indices = NDArray[np.intp]
QuadraticProgram = Any  # of program.py, which imports this file

PROGRAM_TOLERANCE = 1e-6  # of the gap, by default
ROWS = 1e-9  # of the rows, at every tolerance
NEARLY = (1e-6, 1e-3)  # rows and gap: a point beyond is not even inaccurately optimal
NOISE = 1e-5  # of the coefficients of a row: ROWS of this on the right counts as a rounded 0
BLUR = 8.0 * UNIT  # of the terms of a sum: error of the data
CANCELLED = 1e-8  # share of the objective's terms to which they may cancel
LEAST_SIZE = 1e-6  # of the rows' terms with their multipliers
MOVES = 1000.0  # times its size, an unknown without a bound is moved
SMALLEST_SIZE = 2.0**-900  # of the gap: if all terms are 0, gradients are relative to their own
LEAST_PRICE = 2.0**-1000  # quotients by it are finite
ROUNDED_ELSEWHERE = (
    64.0 * UNIT
)  # of terms in the other rows of an unknown: rounding of this unknown


class KKTErrors(NamedTuple):
    """The two measures of a point: its worst row, and its worst component's gap; ∞ if a number is not finite."""

    primal: Any
    gap: Any

    def meet(self, tolerance: float) -> Any:
        """Return whether the point is a solution: the test of programs."""
        return (self.primal <= ROWS) & (self.gap <= tolerance)

    def nearly_meet(self, tolerance: float) -> bool:
        """Return whether both measures are small, but perhaps above the tolerance."""
        return bool(self.primal <= NEARLY[0] and self.gap <= max(tolerance, NEARLY[1]))

    @property
    def largest(self) -> Any:
        """The larger of both, with the rows' error in units of the gap's default tolerance."""
        return np.maximum(self.primal * (PROGRAM_TOLERANCE / ROWS), self.gap)

    @classmethod
    def of(
        cls, program: QuadraticProgram, x: Vector, y: Vector, tolerance: float = PROGRAM_TOLERANCE
    ) -> KKTErrors:
        """Return the errors of x and multipliers y of G and A; bounds of them if these meet the tolerance already."""
        found = cls(np.inf, np.inf)
        if np.isfinite(x).all() and np.isfinite(y).all():
            for is_exact in (False, True):
                point = PrimalDualPoint(program, x, y, is_exact=is_exact)
                both = point.row_errors().max(initial=0.0), point.gaps().max(initial=0.0)
                found = cls(*(np.inf if np.isnan(one) else float(one) for one in both))
                if found.meet(tolerance):
                    break
        return found


def worst_constraints(program: QuadraticProgram, x: Vector, y: Vector, count: int) -> WorstRows:
    """Return the constraints that x violates by most, relative to their terms; y are multipliers of G and A.

    Rows of G and A are measured, as by the criterion, with each x_j outside its bounds put on the nearer bound.
    """
    point, rows = PrimalDualPoint(program, x, y, is_exact=True), program.constraints
    errors, m = point.row_errors(), rows.rows
    with np.errstate(all="ignore"):
        within, given = (rows.matrix @ at - rows.limit for at in (point.x, x))
        excess = np.append(within[:m], given[m:])
        terms = largest_products(abs(rows.matrix), np.abs(x))
    where = " with x on its bounds" if point.outside.any() else ""
    # row_errors has one entry per unknown for both of its bounds
    sides = np.append(excess[m : m + x.size] > 0.0, excess[m + x.size :] > 0.0)
    errors = np.concatenate([errors[:m], np.where(sides, np.tile(errors[m:], 2), 0.0)])
    found = []
    for k in np.argsort(-errors, kind="stable")[:count].tolist():
        if errors[k] > ROWS:
            value, limit = float(excess[k] + rows.limit[k]), float(rows.limit[k])
            sign = -1.0 if m <= k < m + x.size else 1.0
            beyond = "≠" if rows.is_equality[k] else ">" if sign > 0.0 else "<"
            text = f"{program.name(k)} is violated{where if k < m else ''}: "
            text += f"{sign * value:.6g} {beyond} {sign * limit:.6g}"
            size = max(float(terms[k]), abs(limit))
            found.append(
                WorstRow(program.name(k), float(errors[k]), abs(float(excess[k])), size, text)
            )
    return WorstRows(found)


def errors_of_each(together: QuadraticProgram, x: Vector, y: Vector) -> KKTErrors:
    """Return bounds of the errors, shape (B,), of B programs joined into one, at the rows of x, shape (B, n).

    Sums are plain. If they do not decide a program, test this program on its own.
    """
    (count, n), (m, p) = x.shape, (size // len(x) for size in together.matrices.sizes[:2])
    is_finite: Any = np.isfinite(x).all(axis=1)
    at = np.where(is_finite[:, np.newaxis], x, 0.0).ravel()
    point = PrimalDualPoint(together, at, np.nan_to_num(y), is_exact=False)
    primal, gap = point.row_errors(), point.gaps()
    of_G, of_A, of_bounds = np.split(primal, [m * count, (m + p) * count])
    parts = (of_G.reshape(count, m), of_A.reshape(count, p), of_bounds.reshape(count, n))
    gaps = gap[together.matrices.components.of_unknown].reshape(count, n)
    worst = (np.concatenate(parts, axis=1).max(axis=1, initial=0.0), gaps.max(axis=1, initial=0.0))
    primal, gap = (np.where(is_finite & (one >= 0.0), one, np.inf) for one in worst)
    return KKTErrors(primal, gap)


class PrimalDualPoint:
    """Point with the sums of its two measures, and the sizes of all terms of these sums.

    Parameters
    ----------
    program : QuadraticProgram
    x, y : arrays
        Finite.
    is_exact : bool
        True if sums are computed without rounding. Otherwise full bounds of rounding errors are added.

    Attributes
    ----------
    excess, row_doubt : array, shape (m + p,)
        C x − d, and a bound of its rounding error.
    left, doubt, product, lost : array, shape (n,)
        r and P x, with bounds of their rounding errors.
    row_terms, bend : array, shapes (m + p,) and (n,)
        Σ_j |c_ij x_j| + |d_i|, and |P| |x|.
    """

    def __init__(self, program: QuadraticProgram, x: Vector, y: Vector, *, is_exact: bool) -> None:
        self.program, self.matrices, self.is_exact = program, program.matrices, is_exact
        m, lower, upper = self.matrices.sizes[0], program.lower, program.upper
        d = np.concatenate([program.h, program.b])
        is_limit = np.isfinite(d)
        d, y = (np.where(is_limit, one, 0.0) for one in (d, y))
        np.maximum(y[:m], 0.0, out=y[:m])
        self.given, self.x = x, np.minimum(np.maximum(x, lower), upper)
        self.outside = np.abs(x - self.x)
        x, self.of_x, self.of_y, self.cost = self.x, np.abs(self.x), np.abs(y), np.abs(program.c)
        P, C, of_P, of_C, of_columns = self.matrices.measured
        self.limits, self.bend = np.abs(d), of_P @ self.of_x
        self.row_terms = of_C @ self.of_x + self.limits
        if is_exact:
            self.product, self.lost = compensated_product(self.matrices.sparse_P, x)
            both = np.concatenate([x, y])
            self.left, self.doubt = compensated_product(self.matrices.gradient, both, program.c)
            self.excess, self.row_doubt = compensated_product(self.matrices.rows, x, -d)
        else:
            in_rows, in_P, in_columns = self.matrices.summands
            terms = self.bend + self.cost + of_columns @ self.of_y
            self.product, self.lost = P @ x, (in_P + 3.0) * UNIT * self.bend
            self.left = self.product + program.c + C.T @ y
            self.doubt = (in_P + in_columns + 3.0) * UNIT * terms
            self.excess, self.row_doubt = C @ x - d, (in_rows + 3.0) * UNIT * self.row_terms
        self.missed = np.abs(self.excess) + self.row_doubt
        if not is_limit.all():
            self.excess[~is_limit] = -np.inf

    def row_errors(self) -> Vector:
        """Return the error of each row and of each bound; rounding in rows is tolerated if sums are exact."""
        m, sizes, of_bounds = self.matrices.sizes[0], self.row_terms, self.outside
        over = self.missed.copy()
        np.maximum(self.excess[:m] + self.row_doubt[:m], 0.0, out=over[:m])
        if self.is_exact and (over > ROWS * sizes).any():
            sizes = np.maximum(sizes, self.excused / ROWS)
        if of_bounds.any():
            lower, upper = self.program.lower, self.program.upper
            bound = np.where(self.x == lower, np.abs(lower), np.abs(upper))
            of_bounds = ratio(of_bounds, np.maximum(bound, np.abs(self.given)))
        return np.concatenate([ratio(over, sizes), of_bounds])

    @property
    def excused(self) -> Vector:
        """Violation of each row that counts as rounding: of its unknowns in other rows, or of the right-hand sides."""
        columns, matrices = self.matrices.columns, self.matrices
        terms = self.row_terms[columns.indices] / np.abs(columns.data)
        reached = largest_products(matrices.measured[3], largest_in_rows(columns, terms))
        sides = np.where(matrices.counts == 0, self.limits.max(initial=0.0), 0.0)
        return np.maximum(ROUNDED_ELSEWHERE * reached, ROWS * NOISE * sides)

    def gaps(self) -> Vector:
        """Return the gap of each component."""
        x, of_x, sums = self.x, self.of_x, self._sums
        below, above = x - self.program.lower, self.program.upper - x
        y = self.needed_y(np.minimum(below, above))
        curved = np.maximum(np.abs(sums(x, self.product)) - sums(of_x, self.lost), 0.0)
        size = np.abs(sums(self.program.c, x)) + curved
        # Without costs, the terms of P x take their place
        bend = self.bend * 0.0
        if not self.cost.all():
            bend = np.where(self._of_unknowns(sums(self.cost, self.cost)) > 0.0, 0.0, self.bend)
        size = np.maximum(size, CANCELLED * (sums(self.cost, of_x) + curved))
        size = np.maximum(size, LEAST_SIZE * sums(bend, of_x, y, self.row_terms))
        size = np.maximum(size, SMALLEST_SIZE)
        # An unknown without a cost may be balanced by terms of P x that cancel
        bend = np.where(self.cost > 0.0, 0.0, self.bend)
        price = np.maximum(np.abs(self.product) - self.lost, bend) + self.cost
        price += self.matrices.measured[4] @ y
        left = np.abs(self.left)
        rest, distance = left + self.doubt, np.where(self.left > 0.0, below, above)
        if (left <= self.doubt).any():  # either direction may be the one of descent
            distance = np.where(left <= self.doubt, np.maximum(below, above), distance)
        way = self._of_unknowns(MOVES * size) / np.maximum(price, LEAST_PRICE)
        is_far = distance > way
        reach = np.where(is_far, np.minimum(distance, MOVES * of_x), distance)
        gap = sums(rest, np.where(rest == 0.0, 0.0, reach), self.of_y, self.missed)
        gap += self._largest(np.where(is_far, rest * way, 0.0))
        return np.where(size < np.inf, gap / size, np.nan)

    def needed_y(self, way: Vector) -> Vector:
        """Return sizes of the multipliers: each at most balances P x + c at an unknown that is off its bounds.

        `way` is the distance to the nearest bound. An unknown at rounding level of its component is at its bound.
        """
        pull = np.abs(self.product + self.program.c) - self.lost
        at_bound = way <= self._of_unknowns(DATA_ROUNDING * self._largest(self.of_x))
        parts, most = self.matrices.components, self._largest(np.where(at_bound, 0.0, pull))
        if parts.number > 1:
            most = most[parts.of_row]
        return np.minimum(self.of_y, most / self.matrices.row_sizes[: self.of_y.size])

    @property
    def row_weight(self) -> float:
        """Terms of all rows with the multipliers y'."""
        way = np.minimum(self.x - self.program.lower, self.program.upper - self.x)
        return float(self.needed_y(way) @ self.row_terms)

    def _sums(self, a: Vector, b: Vector, of_rows: Any = 0.0, other: Any = 0.0) -> Vector:
        """Return the sums of the products a_j b_j over each component, and of products of its rows."""
        parts = self.matrices.components
        if parts.number == 1:
            return np.array([a @ b + np.dot(of_rows, other)])
        found = np.bincount(parts.of_unknown, a * b, parts.number) + 0.0  # of none too
        if isinstance(of_rows, np.ndarray):
            found += np.bincount(parts.of_row, of_rows * other, parts.number)
        return np.asarray(found)

    def _of_unknowns(self, values: Vector) -> Vector:
        """Return the value of each unknown's component."""
        parts = self.matrices.components
        return values if parts.number == 1 else values[parts.of_unknown]

    def _largest(self, sizes: Vector) -> Vector:
        """Return the largest size in each component."""
        parts = self.matrices.components
        if parts.number == 1:
            return np.array([sizes.max(initial=0.0)])
        most = np.zeros(parts.number)
        np.maximum.at(most, parts.of_unknown, sizes)
        return most


def least_size(program: QuadraticProgram, x: Vector, y: Vector) -> float:
    """Return the size that a value at x has at least, 1e-6 of the rows' terms with the multipliers y."""
    return LEAST_SIZE * PrimalDualPoint(program, x, y, is_exact=True).row_weight


def excused_rows(program: QuadraticProgram, x: Vector) -> Vector:
    """Return the violation of each row that counts as rounding at x."""
    none = np.zeros(program.constraints.right.size)
    return PrimalDualPoint(program, x, none, is_exact=False).excused


class ProgramComponents(NamedTuple):
    """The parts of a program that no entry connects: the number of each unknown's and row's, and how many there are."""

    of_unknown: Indices
    of_row: Indices
    number: int


def ratio(errors: Vector, sizes: Vector) -> Vector:
    """Return the quotients, 0 / 0 = 0."""
    return np.where(errors > 0.0, errors / np.maximum(sizes, LEAST_PRICE), errors)


MULTIPLIERS = "inequality", "equality", "lower", "upper"
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
            object.__setattr__(self, name, vector)

    @classmethod
    def of_rows(cls, program: QuadraticProgram, x: Vector, multipliers: Vector) -> QPSolution:
        """Return the solution with finite x and all multipliers of ``program.constraints`` in one array, not copied."""
        made, every = object.__new__(cls), read_only(multipliers)
        made.__dict__.update(zip(MULTIPLIERS, program.constraints.split(every), strict=True))
        made.__dict__.update(program=program, x=read_only(x), multipliers=every)
        return made

    @classmethod
    def from_reduced(cls, program: QuadraticProgram, x: Vector, y: Vector) -> QPSolution:
        """Return the solution from x and multipliers of the rows of `FoldedRows`; bounds get the remaining gradient.

        Wrong signs of multipliers become 0.

        Raises
        ------
        InvalidProblem
            If a multiplier of the program is beyond the range of doubles.
        """
        folded = program.folded
        reduced, m = folded.reduced, folded.reduced.h.size
        y = y.copy()
        np.maximum(y[:m], 0.0, out=y[:m])
        P, C = reduced.matrices.stacked
        left = P @ x + reduced.c + C.T @ y
        at_lower = np.where(np.isfinite(reduced.lower), np.maximum(left, 0.0), 0.0)
        at_upper = np.where(np.isfinite(reduced.upper), np.maximum(-left, 0.0), 0.0)
        every = folded.multipliers(np.concatenate([y, at_lower, at_upper]))
        for k in np.flatnonzero(np.isinf(every))[:1].tolist():
            raise InvalidProblem(
                f"the multiplier of {program.name(k)} is beyond the range of doubles, ±1.8e308; give that constraint, "
                "limits and the objective in units in which their largest coefficients are near 1"
            )
        return cls.of_rows(program, x, every)

    @classmethod
    def without_multipliers(cls, program: QuadraticProgram, x: Vector) -> QPSolution:
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
        y: Vector = np.zeros(count)
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

    def gap(self) -> float:
        """Return the maximum of (P x + c)ᵀ(x − y) over all feasible y, by one linear program: 0 at a solution.

        ∞ without a maximum. NaN if HiGHS finds no feasible y, or x is not finite.
        """
        one = self.program
        slopes, sides = one.P @ self.x + one.c, (one.G, one.h, one.A, one.b)
        size = np.abs(slopes).max(initial=0.0)
        if not 0.0 < size < np.inf:
            return float(size)
        found = highs(slopes / size, *sides, (one.lower, one.upper))
        if found.status:
            return np.inf if found.status == 3 else np.nan
        return max(0.0, float(slopes @ self.x - size * found.fun))

    @derived_property
    def errors(self) -> KKTErrors:
        """Both measures."""
        return self.errors_for(0.0)

    @np.errstate(all="ignore")
    def errors_for(self, tolerance: float) -> KKTErrors:
        """Return both measures, or bounds of them if these meet the tolerance already."""
        return KKTErrors.of(self.program.folded.reduced, self.x, self.reduced_y, tolerance)

    @property
    def reduced_y(self) -> Vector:
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
