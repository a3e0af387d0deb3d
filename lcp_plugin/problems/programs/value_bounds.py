"""Rigorous lower bounds of the optimal value of a quadratic program, from any point and any multipliers.

With weights μ for which P − diag(μ) is positive semidefinite, any x̂, multipliers λ ≥ 0 of G x ≤ h and any ν of A x = b,
s = P x̂ + c + Gᵀλ + Aᵀν, every feasible x within a box [l, u] that holds all of them has

    f(x) ≥ f(x̂) + λᵀ(G x̂ − h) + νᵀ(A x̂ − b) + Σ_i inf over l_i ≤ t ≤ u_i of s_i (t − x̂_i) + ½ μ_i (t − x̂_i)².

If the weights belong to P + ρ AᵀA, ½ ρ‖A x̂ − b‖² must be subtracted: f is then f + ½ ρ‖A x − b‖², with
multipliers ν − ρ (A x̂ − b).

All sums are rounded downwards. The sum is −∞ if μ_i = 0 and the box is infinite on the side to which s_i falls. Then
(x̂, λ, ν) is repaired first, by least squares with some slack, or in rationals if s_i must be exactly zero.

Points that are proved to satisfy all constraints of a program, near a point that nearly does.

Least squares move a point to the equalities and away from tight inequalities. Then every row is evaluated with a
rounding bound, and an approximate inverse proves that the equalities have a solution close by.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import chain
from operator import add, sub
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core import deadline
from ...core.checks import BoolVector, Vector
from ...core.entries import largest_in_rows, max_norm, or_one, row_numbers
from ...core.kernels.floats import OUTWARD, UNDERFLOW
from ...core.rounding import compensated_pair, compensated_product, gamma, lower_end, upper_end
from ...proofs.bounds import Curvature
from ...proofs.exact import (
    Fractions,
    Row,
    enclosures,
    independent_rows,
    product_above,
    products,
    quotient_above,
    rational,
    rational_rows,
    solved_nearby,
    sum_above,
)
from .program import FoldedRows, QuadraticProgram

# of the terms of a component: small and large, above the rounding of least squares
SLACKS = (2.0**-46, 2.0**-36)
Box = tuple[Vector, Vector]


class DualPoint(NamedTuple):
    """Point x̂, which may be infeasible, and multipliers of G (not negative) and of A."""

    x: Vector
    y: Vector


@dataclass(frozen=True, eq=False)
class DualBounds:
    """Program with the data for lower bounds of its optimal value.

    Attributes
    ----------
    program : QuadraticProgram
    curvature : Curvature
    box : pair of ndarray, shape (n,)
        Bounds that every feasible x keeps.
    """

    program: QuadraticProgram
    curvature: Curvature
    box: Box

    def best(self, x: Vector, y: Vector, enough: float = np.inf) -> float:
        """Return the largest lower bound that the point and the multipliers, or their repairs, prove; −∞ for none.

        Repairs end once a bound reaches `enough`.
        """
        if not np.isfinite(self.curvature.weights).all():
            return -np.inf
        largest = -np.inf
        for bound in self._bounds(self.admit(x, y)):
            largest = max(largest, bound)
            if largest >= enough or deadline.is_over():
                break
        return largest

    def _bounds(self, point: DualPoint) -> Iterator[float]:
        """Yield the bounds that a point and its repairs prove, the cheapest first."""
        points = [point]
        yield self.value(point)
        for slack in SLACKS:
            points.append(self._with_slack(point, slack))
            yield self.value(points[-1])
        yield from map(self._exact_value, points)

    def admit(self, x: Vector, y: Vector) -> DualPoint:
        """Return the point with admissible multipliers: not negative, and 0 for rows that the box contains."""
        m = self.program.h.size
        allowed = np.where(np.isfinite(y), y, 0.0)
        allowed[:m] = np.where(np.isfinite(self.program.h), np.maximum(allowed[:m], 0.0), 0.0)
        allowed[self._is_bound] = 0.0
        return DualPoint(x, allowed)

    def value(self, at: DualPoint) -> float:
        """Return a double below the bound that this point proves without a repair; −∞ if it proves no bound."""
        program, matrices, (x, y) = self.program, self.program.matrices, at
        ends = _ends(*compensated_pair(matrices.terms.gradient, np.concatenate(at), program.c))
        bent = compensated_pair(matrices.terms.sparse_P, x)
        excess = compensated_pair(matrices.terms.rows, x, -self._limit)
        # Twice f(x̂) + λᵀ(G x̂ − h) + νᵀ(A x̂ − b), as halves may underflow.
        factors = np.concatenate([x, x, 2.0 * program.c, 2.0 * y, 2.0 * y])
        values = np.concatenate([*bent[:2], x, *excess[:2]])
        twice, error = compensated_product(sp.csr_array(factors[None, :]), values)
        errors = [product_above(np.abs(x), bent[2]), product_above(np.abs(2.0 * y), excess[2])]
        missed = np.max(np.abs(_ends(*excess)), axis=0)[program.h.size :]
        errors.append(product_above(0.5 * self.curvature.penalty, product_above(missed, missed)))
        loss = self._loss(*ends, *self._distances(x, x))
        loss = float(sum_above(_sum_above(np.concatenate(errors)), loss))
        bound = -float(sum_above(loss, half_above(-lower_end(twice, error)[0])))
        return bound if not math.isnan(bound) else -np.inf

    def _distances(self, low: Vector, high: Vector) -> Box:
        """Return x̂ − l and u − x̂, rounded up, of x̂ between two vectors."""
        return sum_above(high, -self.box[0]), sum_above(self.box[1], -low)

    def _loss(self, s_low: Vector, s_high: Vector, below: Vector, above: Vector) -> float:
        """Return Σ sup over −below ≤ t ≤ above of −s t − ½ μ t², rounded up."""
        weights = self.curvature.weights
        ends = (s_high, below), (s_low, below), (-s_high, above), (-s_low, above)
        corners = np.max([product_above(*end) for end in ends], axis=0)
        largest = np.maximum(np.abs(s_low), np.abs(s_high))
        bent = or_one(weights)
        vertex = quotient_above(product_above(largest, largest), 2.0 * bent)
        reach = np.maximum(np.abs(below), np.abs(above))
        sagging = sum_above(corners, product_above(-0.5 * weights, product_above(reach, reach)))
        return _sum_above(np.where(weights > 0.0, np.minimum(corners, vertex), sagging))

    # --- Repairs ------------------------------------------------------------------------------------------------

    def _with_slack(self, at: DualPoint, slack: float) -> DualPoint:
        """Return a nearby point whose s has the signs that open sides require, with slack if possible."""
        needs_rise, needs_fall = self._open_sides
        is_free = needs_rise & needs_fall
        sign = np.where(needs_rise, 1.0, -1.0)
        columns = sp.csr_array(self.program.matrices.terms.rows.T)
        largest = largest_in_rows(columns) * max_norm(at.y)
        for _ in range(4):  # a repair of some components may break other components
            v, s, size = self._slopes(at)
            size = np.maximum(size, largest)
            target = np.where(is_free, 0.0, sign * np.maximum(sign * s, slack * size))
            asked = needs_rise | needs_fall
            if not (asked & (np.abs(target - s) > 0.1 * slack * size)).any():
                break
            # What is nearly zero must not become wrong by what is put right elsewhere.
            # A component that least squares leave unchanged
            near = np.flatnonzero(asked & (is_free | (sign * s <= 2.0**-20 * size)))
            movable = np.flatnonzero(self._is_movable(at))
            v[movable] += least_squares(
                self.program.matrices.terms.gradient[near][:, movable], (target - s)[near]
            )
            at = self.admit(v[: at.x.size], v[at.x.size :])
        return at

    def _slopes(self, at: DualPoint) -> tuple[Vector, Vector, Vector]:
        """Return the point as one vector, its s, and the sums of the sizes of the terms of s."""
        K, c, v = self.program.matrices.terms.gradient, self.program.c, np.concatenate(at)
        return v, K @ v + c, abs(K) @ np.abs(v) + np.abs(c)

    def _is_movable(self, at: DualPoint) -> BoolVector:
        """Return the mask of the entries of x̂ and of the multipliers that a repair may change."""
        m = self.program.h.size
        return np.concatenate([np.ones(at.x.size, bool), at.y[:m] > 0.0, ~self._is_bound[m:]])

    def _exact_value(self, at: DualPoint) -> float:
        """Return the bound of a nearby point with s exactly zero if required; −∞ if no point is found."""
        needs_rise, needs_fall = self._open_sides
        v, s, size = self._slopes(at)
        rounding = SLACKS[0] * size
        is_zero = (needs_rise & (s <= rounding)) | (needs_fall & (s >= -rounding))
        zero = np.flatnonzero(is_zero)
        rows, m, n = [self._exact_stacked[j] for j in zero], self.program.h.size, at.x.size
        target = [-Fraction(self.program.c[j]) for j in zero.tolist()]
        guess, movable = rational(v), self._is_movable(at)
        lots = independent_rows(
            [{j: entry for j, entry in row.items() if movable[j]} for row in rows]
        )
        # Dependent equations in rationals: 100 of them take .4 s, 200 take 1.7 s
        if max(map(len, lots), default=0) > 150:
            return -np.inf
        exact = solved_nearby(rows, target, guess, movable.tolist())
        if exact is None or any(y < 0 for y in exact[n : n + m]):
            return -np.inf
        return self._value_of(exact[:n], exact[n:])

    def _value_of(self, x: Fractions, y: Fractions) -> float:
        """Return `value` of rational numbers."""
        c = rational(self.program.c)
        curved = products(rational_rows(self.program.P), x)
        value = sum(at * (bent / 2 + slope) for at, bent, slope in zip(x, curved, c, strict=True))
        rows = rational_rows(self.program.matrices.terms.rows)
        missed = [*map(sub, products(rows, x), rational(self._limit))]
        value += sum(weight * miss for weight, miss in zip(y, missed, strict=True) if weight)
        penalty = Fraction(self.curvature.penalty) / 2
        value -= penalty * sum(miss * miss for miss in missed[self.program.h.size :])
        s = [*map(add, products(self._exact_stacked, [*x, *y]), c)]
        loss = self._loss(*enclosures(s), *self._distances(*enclosures(x)))
        bound = -float(sum_above(loss, -enclosures([value])[0][0]))
        return bound if not math.isnan(bound) else -np.inf

    @cached_property
    def _open_sides(self) -> tuple[BoolVector, BoolVector]:
        """Masks of s ≥ 0 and of s ≤ 0 as requirements: infinite sides without curvature.

        A bound that only several rows together imply does not count, because it may be very large.
        """
        is_flat, folded = self.curvature.weights <= 0.0, FoldedRows.of(self.program).reduced
        return is_flat & np.isinf(folded.upper), is_flat & np.isinf(folded.lower)

    @cached_property
    def _limit(self) -> Vector:
        right = self.program.constraints.right
        return np.where(np.isfinite(right), right, 0.0)

    @cached_property
    def _is_bound(self) -> BoolVector:
        """Mask of the rows with at most one entry, which the box contains."""
        return np.asarray(np.diff(self.program.matrices.terms.rows.indptr) <= 1)

    @cached_property
    def _exact_stacked(self) -> list[Row]:
        return rational_rows(self.program.matrices.terms.gradient)


def _ends(high: Vector, low: Vector, radius: Vector) -> Box:
    """Return doubles below and above every value that a compensated pair stands for."""
    spread = sum_above(low, radius), sum_above(-low, radius)
    return -sum_above(-high, spread[1]), sum_above(high, spread[0])


def half_above(value: float) -> float:
    """Return value/2 if it is a double, else the next larger double."""
    half = 0.5 * float(value)
    return half if 2.0 * half == value else math.nextafter(half, math.inf)


def _sum_above(values: Vector) -> float:
    """Return a double above the sum of the values; 0 if all values are 0."""
    if not np.isfinite(values).all():
        return float(np.inf)
    try:
        return math.nextafter(math.fsum(values), math.inf) if values.any() else 0.0
    except OverflowError:
        return math.inf


def least_squares(matrix: sp.csr_array, right: Vector) -> Vector:
    """Return the shortest least squares solution, accurate to rounding for a small matrix; 0 if it overflows."""
    if matrix.shape[0] * matrix.shape[1] <= 1_000_000:  # entries of a least squares problem; .1 s
        try:
            solution = np.linalg.lstsq(matrix.toarray(), right, rcond=None)[0]
        except np.linalg.LinAlgError:
            return np.zeros(matrix.shape[1])
    else:
        from scipy.sparse.linalg import lsmr

        solution = lsmr(matrix, right, atol=1e-15, btol=1e-15, maxiter=1000)[0]
    return np.where(np.isfinite(solution), solution, 0.0)


def implied_box(program: QuadraticProgram) -> Box:
    """Return (lower, upper) with lower ≤ x ≤ upper for every feasible x, shape (n,) each, rounded outwards.

    A row a·x ≤ d bounds x_j if all other terms are bounded: a_j x_j ≤ d − Σ min a_k x_k. Every pass over the rows may
    bound more variables, so passes continue as long as a bound changes.

    Examples
    --------
    >>> program = QuadraticProgram([[0, 0], [0, 0]], [1, 1], A=[[1, 2]], b=[4], lower=0)
    >>> with np.errstate(all="ignore"):  # as the calls that solve do
    ...     implied_box(program)
    (array([0., 0.]), array([4., 2.]))
    """
    lower, upper = np.array(program.lower), np.array(program.upper)
    A, G = sp.csr_array(program.A), sp.csr_array(program.G)
    limited = np.flatnonzero(np.isfinite(program.h))
    rows = sp.csr_array(sp.vstack([G[limited], A, -A], format="csr"))
    limit = np.concatenate([program.h[limited], program.b, -program.b])
    by_column = sp.csc_array(rows)
    touched = np.arange(limit.size)
    # A chain of equalities needs one pass per link; a pass tests only rows with new bounds
    for _ in range(10_000):
        was_open = np.isinf(lower), np.isinf(upper)
        _tighten(rows[touched], limit[touched], lower, upper)
        closed = np.flatnonzero(
            (was_open[0] & np.isfinite(lower)) | (was_open[1] & np.isfinite(upper))
        )
        if not closed.size or deadline.is_over():
            break
        touched = np.unique(by_column[:, closed].indices)
    return lower, upper


def _tighten(rows: sp.csr_array, limit: Vector, lower: Vector, upper: Vector) -> None:
    """Replace bounds by tighter bounds that single rows imply."""
    entry, column, owner, m = rows.data, rows.indices, row_numbers(rows), limit.size
    # The largest value of −a x, the least of a x with its sign turned.
    most = product_above(-entry, np.where(entry > 0.0, lower[column], upper[column]))
    is_open = most == np.inf
    held = np.where(is_open, 0.0, most)
    total = np.bincount(owner, held, m).astype(np.float64)
    size = np.bincount(owner, np.abs(held), m) * (1.0 + gamma(entry.size))
    total = sum_above(
        total, product_above(size, gamma(int(np.diff(rows.indptr).max(initial=0)) + 2))
    )
    open_terms = np.bincount(owner, is_open, m)
    is_bounded = open_terms[owner] - is_open == 0
    room = sum_above(sum_above(limit, total)[owner], -held)
    room = np.where(np.diff(rows.indptr)[owner] == 1, limit[owner], room)
    most_of_x = quotient_above(room, np.abs(entry))
    usable = is_bounded & np.isfinite(most_of_x)
    above, below = usable & (entry > 0.0), usable & (entry < 0.0)
    np.minimum.at(upper, column[above], most_of_x[above])
    np.maximum.at(lower, column[below], -most_of_x[below])


def value_near(program: QuadraticProgram, x: Vector) -> float | None:
    """Return a double above the objective of a feasible point near x; None if floating point proves no such point."""
    points = chain([x], (_move_off(program, x, slack) for slack in SLACKS))
    values = (_value_of_enclosed(program, at) for at in points)
    return next((value for value in values if value is not None), None)


def _move_off(program: QuadraticProgram, x: Vector, slack: float) -> Vector:
    """Return the nearest point that satisfies the equalities to rounding, with some slack in tight inequalities."""
    rows, x = program.constraints, np.clip(x, program.lower, program.upper)
    value, right = rows.matrix @ x - rows.limit, np.where(np.isfinite(rows.limit), rows.limit, 0.0)
    # Estimates of the largest terms, which only guide the search
    size = np.abs(right) + largest_in_rows(rows.matrix) * max_norm(x)
    tight = np.flatnonzero((rows.is_equality | (value >= -1e-9 * size))[: rows.rows])
    free = np.flatnonzero((x > program.lower) & (x < program.upper))
    change = np.where(rows.is_equality, -value, np.minimum(-value - slack * size, 0.0))[tight]
    moved = x.copy()
    moved[free] += least_squares(rows.matrix[tight][:, free], change)
    return np.clip(moved, program.lower, program.upper)


def _value_of_enclosed(program: QuadraticProgram, x: Vector) -> float | None:
    """Return a double above the objective of x, or of a solution of the equalities nearby; None without a proof."""
    if not ((excess := program.constraints.excess(x)) > 0.0).any():
        return objective_bounds(program, x)[1]
    rows, m, others = program.constraints, program.h.size, ~program.constraints.is_equality
    radius = distance_of_equations(program, x, excess[m : m + program.b.size])
    if radius is None or (excess[others] > 0.0).any():
        return None
    sizes = abs(rows.matrix[np.flatnonzero(others)])
    spread = (
        sizes @ radius + np.where(sizes.astype(bool) @ (radius > 0.0), UNDERFLOW, 0.0)
    ) * OUTWARD
    if not (sum_above(excess[others], spread) <= 0.0).all():
        return None
    return objective_bounds(program, x, radius)[1]


def distance_of_equations(program: QuadraticProgram, x: Vector, excess: Vector) -> Vector | None:
    """Return a componentwise bound of the distance from x to a solution of A x = b; None if none is proved.

    Only variables between their bounds move.

    Parameters
    ----------
    excess : array, shape (rows of A,)
        Upper bounds of |A x − b|.

    Notes
    -----
    With B the free columns of A, rows scaled by powers of two, x + Bᵀu is a solution if B Bᵀu = r, r = b − A x. If
    ‖I − R B Bᵀ‖∞ ≤ α < 1 for an approximate inverse R, rounding included, a solution has ‖u‖∞ ≤ ‖|R||r|‖∞/(1 − α).
    """
    free = np.flatnonzero((program.lower < x) & (x < program.upper))
    B, radius = sp.csr_array(program.A)[:, free], np.zeros(x.size)
    p, n = B.shape
    # Larger equality rows are not treated as one dense matrix
    if max(p * n, p * p) > 4_000_000:
        return None
    B = B.toarray()
    _, exponent = np.frexp(np.abs(B).max(axis=1, initial=0.0))
    if (np.abs(exponent) > 400).any() or not np.isfinite(excess).all():
        return None
    B, r = np.ldexp(B, -exponent[:, None]), np.ldexp(excess, -exponent)
    product, sizes = B @ B.T, np.abs(B) @ np.abs(B).T
    try:
        R = np.linalg.inv(product)
    except np.linalg.LinAlgError:
        return None
    error = np.abs(np.eye(p) - R @ product) + gamma(p + 3) * (np.abs(R) @ np.abs(product) + 1.0)
    error += gamma(n + 3) * (np.abs(R) @ sizes) + UNDERFLOW * (1.0 + np.abs(R).sum())
    alpha = float(error.sum(axis=1).max(initial=0.0)) * OUTWARD
    if not alpha <= 0.5:
        return None
    largest = float((np.abs(R) @ r).max(initial=0.0)) * OUTWARD / (1.0 - alpha) + UNDERFLOW
    radius[free] = (np.abs(B).sum(axis=0) * largest + UNDERFLOW) * OUTWARD
    return radius


def objective_bounds(
    program: QuadraticProgram, x: Vector, radius: Vector | None = None, *, linear: float = 1.0
) -> tuple[float, float]:
    """Return doubles below and above ½ xᵀP x + linear · cᵀx, and above it for all points within the radius of x."""
    high, low, rounding = compensated_pair(program.matrices.terms.sparse_P, x)
    row = sp.csr_array(np.concatenate([x, x, 2.0 * linear * program.c])[None, :])
    twice, error = compensated_product(row, np.concatenate([high, low, x]))
    error = sum_above(error, product_above(np.abs(x), rounding).sum() * (1.0 + 2.0**-30))
    lowest = -half_above(upper_end(-twice, error)[0])
    highest = half_above(upper_end(twice, error)[0])
    if radius is not None and radius.any():
        # |∇f| r + ½ rᵀ|P| r, where r is some units in the last place.
        slope = sum_above(sum_above(np.abs(high + program.c), np.abs(low)), rounding)
        bent = 0.5 * (abs(program.matrices.terms.sparse_P) @ radius)
        spread = product_above(sum_above(slope, bent), radius).sum() * (1.0 + 2.0**-30)
        highest = float(sum_above(highest, spread))
    return lowest, highest
