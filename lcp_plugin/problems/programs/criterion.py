"""Stopping criterion of a quadratic program: the test of a point x with multipliers y of the rows.

The program is min ½ xᵀP x + cᵀx with rows C x ≤ d, or = d, and bounds. Multipliers serve only as a proof, so the test
cleans them: a wrong sign becomes 0, and the gradient r = P x + c + Cᵀy gives the multiplier of a bound. Two measures
decide:

- **primal**: the violation of a row relative to max(|d_i|, max_j |c_ij x_j|); of a bound relative to |x_j| or itself.
  The size of a row without coefficients is at least 10⁻⁵ of the largest right-hand side. A violation is tolerated if
  it is at most 2⁻⁴⁴ (rounding) of |c_ij| times the unknowns that matter in its component.
- **gap**, of each connected component: Σ |y_i| |slack_i| + Σ (|r_j| − blur_j)⁺ reach_j + Σ blur_j shake_j, and the
  price of repairing tolerated rows, relative to the objective's terms. reach_j is the distance to the bound in the
  descent direction −r_j, at most 10⁴ times the size of x_j; blur_j is the rounding error of r_j, and is not counted
  beyond |r_j| reach_j.

A point that passes violates no row beyond rounding, and no unknown that moves to its bound or to 10⁴ times its size
gains more than the tolerance. Plain sums decide most points, because all sizes that they use are on the safe side. For
the remaining points, the test uses sums without rounding and the multipliers y'. The user's summary is
``examples/manual/solved.md``.

Sizes:

- The size of x_j is the largest of |x_j|, the size of the gap divided by the largest term of r_j, and the size of the
  other unknowns in a scaling fitted to P and C (Curtis, Reid). shake_j is the larger of |x_j| and the last of them,
  which is at most the distance to the bound; blur_j shake_j is at most |r_j| reach_j.
- The size of the gap is the smaller of Σ |c_j x_j| + |xᵀPx| and Σ |y'_i d_i| + Σ |r_j bound_j| + |xᵀPx|, and at least
  |cᵀx + xᵀPx|. If terms cancel, it is at least 1e-8 of them; for slacks and blur_j, at least 1e-8 of
  Σ |y'_i| (Σ |c_ij x_j| + |d_i|). |y'_i| is the smaller of |y_i| and the largest |P x + c|_j of its component, in
  fitted units, over the unknowns that have room. So y of 10³³, which a cost of 10³⁴ allows if x_j = 0, make no gap
  small, and the rounding error of their sums is part of |r_j|.
- blur_j shake_j is not counted if r_j is at the rounding level of |c_j| + Σ |c_ij y'_i|. If xᵀP x is the square of
  rounding errors of x, c_j + Σ c_ij y_i takes the place of r_j. So a point where all terms are 0 may be optimal.
- The price of a tolerated violation is the price of its repair: unknowns move up to their bounds in the order of
  (|r_j| − blur_j)⁺ / |c_ij|. Above 2⁻⁴⁴ of the fitted scale of a row, a proof of infeasibility is searched first.

Limits: a row may be violated by 9e-10 of its terms although a coefficient of 1e11 in another row makes this violation
expensive. A program may be unbounded although a program within 1e-10 of it has a minimum. An objective below 1e-14 of
the terms of the rows, weighted with their multipliers, counts as 0.

The solution of a quadratic program: primal and dual values, and their Karush–Kuhn–Tucker residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...core.certificates.residuals import WorstRow, WorstRows
from ...core.checks import Vector, checked_vector, derived_property, read_only
from ...core.errors import InvalidProblem
from ...core.kernels.floats import DATA_ROUNDING, UNIT
from ...core.matrix import largest_products
from ...core.rounding import compensated_pair, split_sum
from ...core.settings import checked_tolerance
from ...engines.linear_program import highs

if TYPE_CHECKING:
    from .program import QuadraticProgram
    from .program_matrices import Indices

PROGRAM_TOLERANCE = 1e-6  # of the gap, by default
ROWS = 1e-9  # of the rows, at every tolerance
NOISE = 1e-5  # of the coefficients of a row: ROWS of this on the right counts as a rounded 0
BLUR = 8.0 * UNIT  # of the terms of a sum: error of the data
# The objective's terms, and the rows' with their multipliers, may cancel to this share
LEAST_SIZE = 1e-8
LEAST_SIZE_OF_TERMS = 2.0**-1000  # quotients by it are finite


class KKTErrors(NamedTuple):
    """The two measures of a point: its worst row, and its worst component's gap; ∞ if a number is not finite.

    `tolerated` is the largest violation of a row relative to the rounding error of a right-hand side, 2⁻⁴⁴ of the
    fitted scale of the row. Only rows count that are violated relative to their terms, by rounding of large unknowns.
    """

    primal: Any
    gap: Any
    tolerated: float = 0.0

    def meet(self, tolerance: float) -> Any:
        """Return whether the point is a solution: the test of programs."""
        return (self.primal <= ROWS) & (self.gap <= tolerance)

    @property
    def largest(self) -> Any:
        """The larger of both, with the rows' error in units of the gap's default tolerance."""
        return np.maximum(self.primal * (PROGRAM_TOLERANCE / ROWS), self.gap)

    @classmethod
    def of(
        cls, program: QuadraticProgram, x: Vector, y: Vector, tolerance: float = PROGRAM_TOLERANCE
    ) -> KKTErrors:
        """Return the errors of x and multipliers y of G and A; bounds of them if these meet the tolerance already."""
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            return cls(np.inf, np.inf)
        point = PrimalDualPoint(program, x, y, is_exact=False)
        primal, gap = point.row_errors(), np.full(1, np.inf)
        if (primal <= ROWS).all():
            if np.isfinite(point.room).all():
                gap = point.gaps(has_units=False)
            if not (gap <= tolerance).all():
                gap = np.minimum(gap, point.gaps(has_units=True))
        if not (gap <= tolerance).all():
            point = PrimalDualPoint(program, x, y, is_exact=True)
            primal, gap = point.row_errors(), point.gaps(has_units=True)
        worst = [np.where(np.isnan(one), np.inf, one).max(initial=0.0) for one in (primal, gap)]
        tolerated = point.tolerated() if point.is_exact else 0.0
        return cls(float(worst[0]), float(worst[1]), tolerated)


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


def errors_of_each(together: QuadraticProgram, x: Vector, y: Vector, tolerance: float) -> KKTErrors:
    """Return bounds of the errors, shape (B,), of B programs joined into one, at the rows of x, shape (B, n).

    Sums are plain. If they do not decide a program, test this program on its own.
    """
    (count, n), (m, p) = x.shape, (size // len(x) for size in together.matrices.sizes[:2])
    is_finite: Any = np.isfinite(x).all(axis=1)
    at = np.where(is_finite[:, np.newaxis], x, 0.0).ravel()
    point = PrimalDualPoint(together, at, np.nan_to_num(y), is_exact=False)
    primal, gap = point.row_errors(), point.gaps(has_units=False)
    if not (gap <= tolerance).all():
        gap = np.where(gap <= tolerance, gap, point.gaps(has_units=True))
    of_G, of_A, of_bounds = np.split(primal, [m * count, (m + p) * count])
    parts = (of_G.reshape(count, m), of_A.reshape(count, p), of_bounds.reshape(count, n))
    gaps = gap[together.matrices.components.of_unknown].reshape(count, n)
    worst = (np.concatenate(parts, axis=1).max(axis=1, initial=0.0), gaps.max(axis=1, initial=0.0))
    primal, gap = (np.where(is_finite & (one >= 0.0), one, np.inf) for one in worst)
    return KKTErrors(primal, gap)


class PrimalDualPoint:
    """Point with all terms of its two measures.

    Parameters
    ----------
    program : QuadraticProgram
    x, y : arrays
        Finite.
    is_exact : bool
        True if sums are computed without rounding. Otherwise the full rounding bounds `doubt` and `hidden` are added.

    Attributes
    ----------
    bound, distance : array, shape (n,)
        Bound in the descent direction −r_j, and the distance of x_j to it.
    room : array, shape (n,)
        The distance, or the one to the farther bound if rounding hides the direction.
    curved, objective : array
        |xᵀP x| of each component, and Σ |c_j x_j| + |xᵀP x|.
    """

    def __init__(self, program: QuadraticProgram, x: Vector, y: Vector, *, is_exact: bool) -> None:
        self.program, self.matrices, self.is_exact = program, program.matrices, is_exact
        m = self.matrices.sizes[0]
        d, lower, upper = np.concatenate([program.h, program.b]), program.lower, program.upper
        is_limit = np.isfinite(d)
        sides = np.where(is_limit, d, 0.0)
        self.given, x = x, np.minimum(np.maximum(x, lower), upper)
        self.outside = np.abs(self.given - x)
        y = np.where(is_limit, y, 0.0)
        np.maximum(y[:m], 0.0, out=y[:m])
        self.x, self.y, self.of_x, self.of_y = x, y, np.abs(x), np.abs(y)
        P, C, of_P, of_C, of_columns = self.matrices.measured
        self.limits, self.cost = np.abs(sides), np.abs(program.c)
        self.bend = of_P @ self.of_x
        terms = self.bend + self.cost + of_columns @ self.of_y
        self.terms_of_rows = of_C @ self.of_x + self.limits
        if is_exact:
            self.product, low, radius = compensated_pair(self.matrices.sparse_P, x)
            pull, more, doubt = compensated_pair(self.matrices.columns, y, program.c)
            self.pull = np.abs(pull) + doubt
            high, rest = split_sum(pull, self.product)
            rest += low + more
            self.left = high + rest
            # Two sums of rests are rounded, each of which is at most u times a rounded sum
            self.doubt = (doubt + radius + 4.0 * UNIT * np.abs(rest)) * (1.0 + 4.0 * UNIT)
            self.doubt += 4.0 * UNIT * (np.abs(low) + np.abs(more))
            excess, _, _ = compensated_pair(self.matrices.rows, x, -sides)
            self.hidden: Any = 0.0
            row_doubt: Any = 0.0
        else:
            in_rows, in_P, in_columns = self.matrices.summands
            self.product = P @ x
            self.left = self.product + program.c + C.T @ y
            self.doubt = (in_P + in_columns + 3.0) * UNIT * terms
            excess, row_doubt = C @ x - sides, (in_rows + 3.0) * UNIT * self.terms_of_rows
            self.hidden = self._sums(self.of_x * ((in_P + 3.0) * UNIT * self.bend))
        self.excess = np.where(is_limit, excess, -np.inf)
        missed = np.concatenate([self.excess[:m], np.abs(self.excess[m:])])
        self.over = np.maximum(missed + row_doubt, 0.0)
        self.slack = np.where(self.of_y > 0.0, np.abs(excess) + row_doubt, 0.0)
        self.blur = BLUR * terms
        self.bound = np.where(self.left > 0.0, lower, upper)
        self.distance = np.abs(x - self.bound)
        is_pushed = np.abs(self.left) > self.doubt + (0.0 if is_exact else self.blur)
        self.room = np.where(is_pushed, self.distance, np.maximum(x - lower, upper - x))
        self.curved = np.abs(self._sums(x * self.product)) + self.hidden
        self.objective = self._sums(self.cost * self.of_x) + self.curved
        self.own = np.maximum(
            largest_products(of_C, self.of_x), np.where(self.over > 0.0, self.limits, 0.0)
        )
        if (
            is_empty := self.matrices.counts == 0
        ).any():  # sides are rounded relative to the largest
            self.own[is_empty] = np.maximum(self.own, NOISE * self.limits.max())[is_empty]

    # --- Rows --------------------------------------------------------------------------------------------------------

    def row_errors(self) -> Vector:
        """Return the error of each row and of each bound; rounding in rows is tolerated if sums are exact."""
        own, of_bounds = self.own, self.outside
        if self.is_exact and (self.over > ROWS * own).any():
            own = np.maximum(own, DATA_ROUNDING / ROWS * self.reached)
        if of_bounds.any():
            lower, upper = self.program.lower, self.program.upper
            bound = np.where(self.x == lower, np.abs(lower), np.abs(upper))
            of_bounds = ratio(of_bounds, np.maximum(bound, np.abs(self.given)))
        return np.concatenate([ratio(self.over, own), of_bounds])

    def tolerated(self) -> float:
        """Return the largest violation beyond the terms of its row, relative to the rounding of its right-hand side."""
        over = np.where(self.over > ROWS * self.own, self.over, 0.0)
        return float((over * (self.matrices.fit[1] / DATA_ROUNDING)).max(initial=0.0))

    @cached_property
    def reached(self) -> Vector:
        """Size of the unknowns that matter in each row: the minimum over the user's units and fitted units."""
        units, of_row = self.matrices.fit[0], self.matrices.components.of_row
        of_C = self.matrices.measured[3]
        return np.minimum(
            *(
                largest_products(of_C, one) * self._largest_by_component(self.matters / one)[of_row]
                for one in (np.ones(units.size), units)
            )
        )

    @cached_property
    def price(self) -> Vector | None:
        """Price of repairing each tolerated row; None without such a row.

        Unknowns move in the direction that repairs the row, up to their bounds, the cheapest first. The price of a move
        is the remaining gradient per coefficient; the least of them counts for a rest that the bounds do not allow.
        """
        is_bad = self.over > ROWS * self.own
        if not (self.is_exact and is_bad.any()):
            return None
        is_bad &= self.over <= DATA_ROUNDING * self.reached
        price, rows = np.zeros(self.over.size), self.matrices.rows
        lower, upper = self.program.lower, self.program.upper
        for i in np.flatnonzero(is_bad):
            part = slice(rows.indptr[i], rows.indptr[i + 1])
            a, j, over = rows.data[part], rows.indices[part], self.over[i]
            mends = -np.sign(a) * np.sign(self.excess[i])
            room = np.where(mends > 0.0, upper[j] - self.x[j], self.x[j] - lower[j])
            paid = np.maximum(mends * self.left[j] - self.blur[j], 0.0) / np.abs(a)
            order = np.argsort(paid)
            repaired = np.minimum(np.cumsum(np.minimum(np.abs(a) * room, over)[order]), over)
            moved = np.diff(repaired, prepend=0.0)
            price[i] = np.where(moved > 0.0, moved * paid[order], 0.0).sum()
            if repaired[-1] < over:
                price[i] += (over - repaired[-1]) * (np.abs(self.left[j]) / np.abs(a)).min()
        return price

    # --- The gap -----------------------------------------------------------------------------------------------------

    def gaps(self, has_units: bool) -> Vector:
        """Return the gap of each component; without units, no distance to a bound is thought too large to matter."""
        of = self.matrices.components.of_unknown
        size, least = self._size()
        rest = np.maximum(np.abs(self.left) + self.doubt - self.blur, 0.0)
        reach = shake = self.room
        if has_units:
            units = self.matrices.fit[0]
            at_most = units * self._largest_by_component(self.matters / units)[of]
            by_terms = size[of] / np.maximum(self.size_of_gradient, LEAST_SIZE_OF_TERMS)
            # An unknown without a bound is moved so many times its size
            far = 1e4 * np.maximum(np.maximum(self.of_x, by_terms), at_most)
            reach = np.where(self.objective[of] > 0.0, np.minimum(reach, far), reach)
            shake = np.minimum(shake, at_most)
        # NaN, which is the gradient of an overflow, stays NaN
        moves = np.where(rest == 0.0, 0.0, rest * reach)
        shakes = np.where(self.blur == 0.0, 0.0, self.blur * np.maximum(self.of_x, shake))
        if self.is_exact:  # a gradient that is 0 has no rounding in it
            most = np.abs(self.left) + self.doubt
            most = np.where(most > 0.0, most * reach, 0.0) - moves
            shakes = np.where(most < shakes, most, shakes)
            shakes = np.where(self._is_rounding, 0.0, shakes)
        held = np.where(self.slack > 0.0, self.of_y * self.slack, 0.0)
        return ratio(self._sums(moves, self.price), size) + ratio(
            self._sums(shakes, held), np.maximum(size, least)
        )

    @cached_property
    def size_of_gradient(self) -> Vector:
        """Largest term of each unknown's gradient."""
        of_P, _, of_columns = self.matrices.measured[2:]
        return np.maximum(
            np.maximum(self.cost, largest_products(of_P, self.of_x)),
            largest_products(of_columns, self.of_y),
        )

    @cached_property
    def matters(self) -> Vector:
        """Sizes of unknowns whose terms are a relevant part of the objective's terms; 0 for the remaining unknowns."""
        part = self.objective[self.matrices.components.of_unknown]
        # Unknowns with smaller terms do not matter
        return np.where(self.size_of_gradient * self.of_x >= 1e-6 * part, self.of_x, 0.0)

    def _size(self) -> tuple[Vector, Any]:
        """Return the size of the gap of each component, and the least size for its terms at rounding level.

        The first is the smaller of the objective's terms and of its dual's, both at least |cᵀx + xᵀP x|. The second is
        taken of the rows' terms with multipliers: no x of doubles makes |3 x - 0.3| zero.
        """
        value = np.abs(self._sums((self.program.c + self.product) * self.x))
        value -= LEAST_SIZE * self.objective + self.hidden
        dual: Any = np.maximum(self.curved - 2.0 * self.hidden, value)
        least: Any = 0.0
        if self.is_exact:
            bound = np.where(self.distance <= self.of_x, np.abs(self.bound), 0.0)
            terms = self._sums(np.abs(self.left) * bound, self.needed_y * self.limits) + self.curved
            dual = np.maximum(dual, terms)
            least = LEAST_SIZE * self._sums(0.0 * self.x, self.needed_y * self.terms_of_rows)
        own = self.objective
        if not self.cost.all():
            has_costs = self._sums(self.cost) > 0.0
            own = own + np.where(has_costs, 0.0, self._sums(self.of_x * self.bend))
        return np.maximum(np.minimum(self.objective, dual), LEAST_SIZE * own), least

    @property
    def _is_rounding(self) -> Any:
        """Return the unknowns whose gradient is the rounding error of a cost and multipliers, or of x where P x = 0."""
        at_rest = self.curved <= BLUR * BLUR * self._sums(self.of_x * self.bend)
        at_rest = at_rest[self.matrices.components.of_unknown]
        most = np.where(at_rest, self.pull, np.abs(self.left) + self.doubt)
        return most <= BLUR * (self.cost + self.matrices.measured[4] @ self.needed_y)

    @cached_property
    def needed_y(self) -> Vector:
        """Sizes of the multipliers, each at most the size that balances P x + c at the unknowns that have room.

        An unknown has none if its distance to a bound is at rounding level of the unknowns of its component: a cost of
        10³⁶ that keeps it there needs no multiplier of this size.
        """
        (units, row_units), parts = self.matrices.fit, self.matrices.components
        way = np.minimum(self.x - self.program.lower, self.program.upper - self.x)
        sizes = self._largest_by_component(self.of_x / units)[parts.of_unknown]
        pull = units * np.abs(self.product + self.program.c)
        pulls = np.where(way > DATA_ROUNDING * units * sizes, pull, 0.0)
        return np.minimum(self.of_y, row_units * self._largest_by_component(pulls)[parts.of_row])

    def _sums(self, of_unknowns: Vector, of_rows: Vector | None = None) -> Vector:
        """Return the sums over each component."""
        parts = self.matrices.components
        if parts.number == 1:
            sums: Any = np.add.reduce(of_unknowns, keepdims=True)
            return np.asarray(sums if of_rows is None else sums + np.add.reduce(of_rows))
        sums = np.bincount(parts.of_unknown, of_unknowns, parts.number) + 0.0  # of none too
        if of_rows is not None:
            sums += np.bincount(parts.of_row, of_rows, parts.number)
        return np.asarray(sums)

    def _largest_by_component(self, sizes: Vector) -> Vector:
        """Return the largest size in each component."""
        parts = self.matrices.components
        if parts.number == 1:
            return np.maximum.reduce(sizes, keepdims=True, initial=0.0)
        most = np.zeros(parts.number)
        np.maximum.at(most, parts.of_unknown, sizes)
        return most


def least_size(program: QuadraticProgram, x: Vector, y: Vector) -> float:
    """Return the size that a value at x has at least, 1e-8 of the rows' terms with the multipliers y."""
    point = PrimalDualPoint(program, x, y, is_exact=True)
    return LEAST_SIZE * float(point.needed_y @ point.terms_of_rows)


def excused_rows(program: QuadraticProgram, x: Vector) -> Vector:
    """Return the violation of each row that counts as rounding at x."""
    point = PrimalDualPoint(program, x, np.zeros(program.constraints.right.size), is_exact=True)
    return np.where(program.matrices.counts == 0, ROWS * point.own, DATA_ROUNDING * point.reached)


class ProgramComponents(NamedTuple):
    """The parts of a program that no entry connects: the number of each unknown's and row's, and how many there are."""

    of_unknown: Indices
    of_row: Indices
    number: int


def ratio(errors: Vector, sizes: Vector) -> Vector:
    """Return the quotients, 0 / 0 = 0."""
    return np.where(errors > 0.0, errors / np.maximum(sizes, LEAST_SIZE_OF_TERMS), errors)


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
