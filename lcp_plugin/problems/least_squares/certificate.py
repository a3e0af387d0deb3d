r"""Certificate of min ½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x|, lower ≤ x ≤ upper: SOLVED, bounds of the gap.

Write W = diag(weights), r = A x − b, f for the cost. For any y ∈ ℝᵐ and s = AᵀWy + ridge·x, convexity gives, summed
without cancellation, for every feasible z

    f(x) − f(z) ≤ gap(x, y) = ½ Σ_i weights_i (r_i − y_i)² + Σ_j s_j⁺(x_j − lower_j) + s_j⁻(upper_j − x_j),

and, with μ ≥ ridge such that f(z) − ½μ‖z‖² is convex, at most s_j²/(2μ) for any column j if y = r. A column without a
bound on one side requires an s_j of one sign. Because of rounding and the tolerance, y = r does not have this sign, but
y = r + δp does if AᵀWp has it. Without such a p (a free column, A not proved to have full rank), the only bound is
f(x) − f(z) ≤ f(x), which is then the `gap` of a result, rounding included.

A penalty l1_j |x_j| is l1_j x_j if x_j ≥ 0 and −l1_j x_j otherwise: in the sum, x_j and z_j are split at 0, with
s_j + l1_j on the positive side and s_j − l1_j on the negative side; s_j²/(2μ) uses the least slope at x_j. A column
without bounds requires |s_j| ≤ l1_j then, which y = θ r has for some θ ≤ 1 (Mairal, doctoral thesis, Cachan 2010).

**SOLVED: x is within the bounds and, for some y, the gap is at most tolerance · cost, cost = ½ Σ weights y² + ½ ridge
‖x‖² + Σ l1 |x|, without rows of A that have no entries, and rounding of the data is tolerated**: in row i, r_i − y_i up
to ρ_i = γ min((|A||x| + |b|)_i, S_i), and in column j, s_j up to τ_j = γ (|A|ᵀW|y| + ridge |x|)_j, γ = 4 u (terms + 4).
S_i is 2²⁰ times the largest term at the point of the box nearest to 0, in the unit of row i, so that an x that ran away
does not make every residual rounding. So x is optimal to the tolerance for entries of A and b that differ from the data
by at most this relative rounding, as for solutions of lstsq and nnls. A residual at rounding level in each row (y = 0)
is a cost of 0.
**A point that costs more than a known point is not SOLVED.** The known points are the point of the box nearest to 0,
rounding of its residual included, and the projected solution of lstsq, if A is small and rounding exceeds tolerance.
All comparisons are made in the unit of a row, of a column, or of the cost: units of rows (with weights ÷ their squares)
and columns change rounding only. Columns that are dependent up to rounding count as dependent. For a LinearOperator,
whose entries are unknown, SOLVED means a small gradient, and all numbers are estimates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import AnyMatrix, Array, BoolVector, Vector, derived_property
from ...core.deadline import OutOfTimeError, enforced_seconds_left
from ...core.kernels.floats import EPSILON, OUTWARD, TINY
from ...core.rounding import compensated_product
from .data import NOTHING, Ball, BoundedLeastSquares, Enclosures, clip, shortest_solution
from .engines import is_within_reach


@dataclass(eq=False)
class Optimality:
    """Upper bound of the suboptimality of a point x, with its dual point.

    Attributes
    ----------
    enclosures : Enclosures
    x : ndarray, shape (n,)
    misfit : (ndarray, ndarray), shape (m,) each
        A x − b, and bounds of its rounding errors.
    residual : float
        Measure that must be at most the tolerance for SOLVED: the least gap found, apart from rounding, relative to its
        cost, at most 1. For a LinearOperator ‖x − mid(lower, upper, x − g)‖∞/‖AᵀWb‖∞, g the gradient, in units in which
        columns have unit length. 1 if a point of lower cost is known.
    dual : ndarray, shape (m,)
        The y of the residual.
    passes : bool
        Whether the point is SOLVED, if a run has tested it.
    """

    enclosures: Enclosures
    x: Vector
    misfit: Ball
    residual: float
    dual: Vector
    passes: bool = False

    @classmethod
    def of(cls, enclosures: Enclosures, x: Vector, *, tolerance: float = np.inf) -> Optimality:
        """Return the optimality of x on the unscaled data; dual points are tried until one meets the tolerance."""
        misfit = enclosures.residual(x)
        judged = cls(enclosures, x, misfit, 1.0, misfit[0])
        if enclosures.problem.has_entries:
            judged.residual, judged.dual = _relative_gap(judged, tolerance)
        else:
            size, unit = judged._largest[0], enclosures.reference
            judged.residual = (
                OUTWARD * size / unit if unit > 0.0 else 0.0 if size == 0.0 else math.inf
            )
        if judged.is_worse_than_known(tolerance):
            judged.residual = 1.0
        return judged

    def is_worse_than_known(self, tolerance: float) -> bool:
        """Return whether x costs more than a known point, including the rounding of that point's cost."""
        enclosures, slip, known = self.enclosures, self.misfit[1], self.enclosures.known
        if _may_be_rounding(enclosures.problem, self.cost, slip, tolerance):
            known = [*known, enclosures.unbounded_solution]
        return any(_exceeds(self.cost, enclosures.cost_above(x), tolerance) for x in known)

    @derived_property
    def cost(self) -> float:
        """The cost of x."""
        return float(self.enclosures.problem.cost(self.x, self.misfit[0]))

    @property
    def is_limited(self) -> bool:
        """True if every component is at most its rounding error bound."""
        return self._largest[1]

    @property
    @np.errstate(all="ignore")
    def sharp_residual(self) -> Vector:
        """A x − b, computed by compensated sums if rounding is more than 1e-9 of the cost."""
        problem, (r, slip) = self.enclosures.problem, self.misfit
        # A smaller difference of costs may be rounding
        if not problem.has_entries or not problem.apply_weights(slip) @ np.abs(
            r
        ) > 1e-9 * problem.cost(self.x, r):
            return r
        return compensated_product(sp.csr_array(problem.A), self.x, -problem.b)[0]

    @derived_property
    def _largest(self) -> tuple[float, bool]:
        """A bound of ‖x − mid(lower, upper, prox(x − g))‖∞ in units of columns, and whether it is at rounding level.

        prox moves by l1 towards 0, but not beyond. NaN if a component is not a number. For a LinearOperator, the
        rounding error of the gradient is estimated, because the sizes of its terms are unknown.
        """
        problem, scales = self.enclosures.problem, self.enclosures.problem.column_scales
        slope, radius = self.enclosures.gradient(self.x, self.misfit)
        if not problem.has_entries:
            root = problem.root_weights
            vectors = root * self.misfit[0], root * problem.b, scales * self.x
            radius = 4.0 * EPSILON * scales * sum(map(np.linalg.norm, vectors))
        slope, radius, x, l1 = slope / scales, radius / scales, self.x * scales, problem.l1 / scales
        residual = clip(x, slope - l1, slope + l1)
        residual = np.abs(clip(residual, x - problem.upper * scales, x - problem.lower * scales))
        size = np.max(np.where(np.isfinite(slope), residual + radius, np.nan), initial=0.0)
        return OUTWARD * float(size), bool((residual <= 2.0 * radius).all())


def _relative_gap(judged: Optimality, tolerance: float) -> tuple[float, Vector]:
    """Return the gap relative to its cost, apart from rounding, at most 1, and its y."""
    enclosures, x = judged.enclosures, judged.x
    residual = enclosures.explained(x, judged.misfit)
    least, best = np.inf, residual[0]
    for y, slope in _with_shrunk(enclosures, x, _dual_points(judged)):
        if (value := float(_gap_of_cost(enclosures.problem, x, residual, y, slope))) < least:
            least, best = value, y
        if least <= tolerance:
            break
    return min(least, 1.0), best


def _gap_of_cost(
    problem: BoundedLeastSquares, x: Vector, residual: Ball, y: Vector, slope: Ball
) -> Any:
    """Return the gap apart from rounding, relative to its cost; ∞ if that is 0."""
    gap, cost = _gap(problem, x, residual, y, slope, rounding=-1.0)
    return np.where(gap == 0.0, 0.0, OUTWARD * gap / cost)


def _may_be_rounding(problem: BoundedLeastSquares, cost: Array, slip: Vector, tol: float) -> Any:
    """Return whether rounding of A x − b, known up to slip, exceeds the tolerance, of a small A."""
    return problem.is_small & (0.5 * np.vecdot(problem.apply_weights(slip), slip) > tol * cost)


def _exceeds(cost: Array, known: Any, tolerance: float) -> Any:
    """Return whether a cost exceeds an upper bound of the least by more than the tolerance, or is NaN."""
    return np.logical_not(cost <= OUTWARD * (1.0 + tolerance) * known)


def measure_stack(
    problem: BoundedLeastSquares,
    x: Vector,
    tolerance: float,
    newton_step: Callable[[Vector], Vector],
) -> tuple[Vector, BoolVector]:
    """Return the relative gap of each point of a stack, and whether it proves that the point is SOLVED.

    y = r, then y = r + A d for the Newton step d of the free columns, as the docstring of this module allows. Other y
    may show that further points are solved.

    Parameters
    ----------
    problem : BoundedLeastSquares
        Stack of B problems with entries.
    x : array, shape (B, n)
        Within the bounds.
    tolerance : float
    newton_step : callable
        Returns d of a gradient, each of shape (B, n).

    Returns
    -------
    value, is_solved : array, shape (B,)
    """
    enclosures = Enclosures(problem)
    residual = enclosures.explained(x, enclosures.residual(x))
    y, slope = residual[0], enclosures.gradient_at(x, residual[0])
    value = _gap_of_cost(problem, x, residual, y, slope)
    if not (value <= tolerance).all():
        y = y + newton_step(slope[0]) @ problem.A.T
        more = _gap_of_cost(problem, x, residual, y, enclosures.gradient_at(x, y))
        value = np.where(more < value, more, value)
    cost = problem.cost(x, residual[0])
    least = enclosures.cost_above(np.broadcast_to(problem.nearest_to_zero, x.shape))
    is_solved = (value <= tolerance) & ~_exceeds(cost, least, tolerance)
    return value, is_solved & ~_may_be_rounding(problem, cost, residual[1], tolerance)


def _dual_points(judged: Optimality) -> Iterator[tuple[Vector, Ball]]:
    """Yield dual points y with their s, the cheapest first."""
    enclosures, x, (r, slip) = judged.enclosures, judged.x, judged.misfit
    problem, at_r = enclosures.problem, enclosures.gradient_at(x, r)
    yield r, at_r
    yield from _with_zeros(enclosures, x, r, slip)
    free = (problem.lower < x) & (x < problem.upper) & ((x != 0.0) | (problem.l1 == 0.0))
    wrong = np.where(free, (at_r[0] + np.copysign(problem.l1, x)) / problem.column_scales, 0.0)
    orthogonal = r - _push(problem, wrong, free, 1e-8)  # orthogonal to the free columns
    slope = enclosures.gradient_at(x, orthogonal)
    yield orthogonal, slope
    yield from _with_zeros(enclosures, x, orthogonal, slip)


def _with_zeros(
    enclosures: Enclosures, x: Vector, y: Vector, slip: Vector
) -> Iterator[tuple[Vector, Ball]]:
    """Yield y with its entries at rounding level set to 0, if there are any: their multipliers are exactly 0."""
    if (np.abs(y) <= slip).any():
        zeroed = np.where(np.abs(y) > slip, y, 0.0)
        yield zeroed, enclosures.gradient_at(x, zeroed)


def _with_shrunk(
    enclosures: Enclosures, x: Vector, duals: Iterable[tuple[Vector, Ball]]
) -> Iterator[tuple[Vector, Ball]]:
    """Yield each y, and then the shrunk y."""
    for y, slope in duals:
        yield y, slope
        if (shrunk := _shrunk(enclosures, x, y, slope)) is not None:
            yield shrunk


def _shrunk(
    enclosures: Enclosures, x: Vector, y: Vector, slope: Ball
) -> tuple[Vector, Ball] | None:
    """Return θ y, θ ≤ 1, with |s_j| ≤ l1_j in penalized columns without a bound, and its s; None if y satisfies it."""
    problem = enclosures.problem
    of_y, margin = slope[0] - problem.ridge * x, 2.0 * slope[1]
    shares = [
        np.divide(
            problem.l1 - margin - sign * problem.ridge * x,
            sign * of_y,
            out=np.ones(x.size),
            where=(sign * of_y > 0.0) & (bound == sign * -np.inf) & (problem.l1 > 0.0),
        )
        for sign, bound in ((1.0, problem.lower), (-1.0, problem.upper))
    ]
    share = float(np.min(shares, initial=1.0)) * (1.0 - 2.0**-50)
    if not 0.0 < share < 1.0 - 2.0**-49:
        return None
    return share * y, enclosures.gradient_at(x, share * y)


def duality_gap(problem: BoundedLeastSquares, x: Vector, y: Vector | None = None) -> float:
    """Return an upper bound of f(x) − min f, for x within the bounds; an estimate for a LinearOperator.

    Parameters
    ----------
    problem : BoundedLeastSquares
    x : array, shape (n,)
    y : array, shape (m,), optional
        Any dual point; A x − b by default.
    """
    enclosures = Enclosures(problem)
    residual = enclosures.residual(x)
    at_x = enclosures.gradient(x, residual)
    exactly = residual[0], np.zeros(residual[0].size)  # y is the exact residual
    y = residual[0] if y is None else y
    slopes = [*_with_shrunk(enclosures, x, [(y, enclosures.gradient_at(x, y))])]

    def bound_gap(*given: Any) -> float:
        return float(_gap(problem, x, *given)[0])

    found = [bound_gap(exactly, residual[0], at_x)]
    found += [bound_gap(residual, *slope) for slope in slopes]
    if not np.nanmin(found) < np.inf:
        repairs = (repair for slope in slopes for repair in _repair(enclosures, x, *slope))
        found += [bound_gap(residual, *repair) for repair in repairs]
    if not np.nanmin(found) < np.inf and (convexity := enclosures.convexity) is not None:
        found.append(bound_gap(exactly, residual[0], at_x, convexity))
    cost = float(OUTWARD**3 * (enclosures.cost_above(x) + TINY))
    return min(gap for gap in (cost, *found) if not np.isnan(gap))


def _gap(
    problem: BoundedLeastSquares,
    x: Vector,
    residual: Ball,
    y: Vector,
    slope: Ball,
    convexity: Vector = NOTHING,
    *,
    rounding: float = 1.0,
) -> tuple[Any, Any]:
    """Return gap(x, y) for s in `slope`, and the cost of y, each of shape (B,) for a stack.

    Radii of residual and slope are added if `rounding` is 1, subtracted if it is −1.
    """
    l1, (s, radius), distance = problem.l1, slope, np.abs(x)
    off = np.maximum(np.abs(residual[0] - y) + rounding * residual[1], 0.0)
    near, far, margin = x - problem.lower, problem.upper - x, rounding * radius
    linear, least = _fall(s, near, margin) + _fall(-s, far, margin), np.abs(s)
    if l1.any():  # x and z split at 0
        both = np.zeros(x.shape)
        for sign, low, high in (
            (1.0, problem.lower, problem.upper),
            (-1.0, -problem.upper, -problem.lower),
        ):
            slant, at = s * sign + l1, np.maximum(sign * x, 0.0)
            both += _fall(slant, at - np.maximum(low, 0.0), margin)
            both += _fall(-slant, high - at, margin)  # at is 0 if high < 0
        linear = np.where(l1 == 0.0, linear, both)
        least = np.where(x != 0.0, np.abs(s + np.copysign(l1, x)), np.maximum(np.abs(s) - l1, 0.0))
    curved = convexity if convexity.size else np.full(x.shape, problem.ridge)
    if curved.any():
        steep = least + margin
        steepest = 0.5 * steep * (steep / curved) + TINY
        linear = np.where((linear > 0.0) & (curved > 0.0), np.minimum(linear, steepest), linear)
    linear = linear + 0.0 * (s + radius)  # NaN if one is not finite
    gap = 0.5 * np.vecdot(problem.apply_weights(off), off) + linear.sum(-1)
    gap = np.where(gap < np.inf, OUTWARD**3 * gap + TINY * (gap > 0.0), np.inf)
    y = np.where(problem.has_terms, y, 0.0)  # no x changes the cost of the other rows
    squares = np.vecdot(problem.apply_weights(y), y) + problem.ridge * np.vecdot(x, x)
    return gap, 0.5 * squares + np.vecdot(l1, distance)


def _fall(slant: Vector, slack: Vector, off: Vector) -> Vector:
    """Return by how much the cost falls at most over the slack, at a slant known up to `off`."""
    steep = slant + off
    return np.where((steep > 0.0) & (slack > 0.0), steep * slack + TINY, 0.0)


def _repair(
    enclosures: Enclosures, x: Vector, y: Vector, slope: Ball
) -> Iterator[tuple[Vector, Ball]]:
    """Yield y + δp with the least δ that gives all columns the required sign, and its s, if δ is found.

    p is to push the columns whose sign is in doubt, or else all of them.
    """
    problem = enclosures.problem
    wanted = np.isposinf(problem.upper).astype(float) - np.isneginf(problem.lower)
    wanted = np.where(np.maximum(np.abs(slope[0]), slope[1]) > 0.0, wanted, 0.0)
    sizes = (wanted * slope[0] + problem.l1) / problem.column_scales
    # Columns with smaller multipliers may be free
    in_doubt = sizes <= 1e-6 * np.max(np.abs(sizes), initial=0.0)
    missing = np.maximum(slope[1] - wanted * slope[0] - problem.l1, 0.0)
    lacking = (wanted != 0.0) & (missing > 0.0)
    for push in _pushes(problem, np.where(in_doubt, wanted, 0.0), wanted):
        moved = wanted * problem.apply_transpose(problem.apply_weights(push))
        share = float(np.max(missing[lacking] / moved[lacking], initial=0.0))
        for _ in range(4 if (moved[lacking] > 0.0).all() else 0):
            share *= 1.0 + 2.0**-10
            repaired = y + share * push
            value, radius = enclosures.gradient_at(x, repaired)
            if (wanted * value + problem.l1 >= radius)[wanted != 0.0].all():
                yield repaired, (value, radius)
                return
            share *= 2.0


def _pushes(problem: BoundedLeastSquares, *wanted: Vector) -> Iterator[Vector]:
    """Yield candidates for p: A times the first wanted signs, which suits entries ≥ 0; then the shortest p."""
    yield problem.product(wanted[0] / problem.column_scales)
    for signs in wanted:
        # A bit less than the target 1 of (AᵀWp)_j, in units of column j
        yield _push(
            problem, signs, signs != 0.0, 0.8 / math.sqrt(max(int(np.count_nonzero(signs)), 1))
        )


def _push(
    problem: BoundedLeastSquares, wanted: Vector, chosen: BoolVector, accuracy: float
) -> Vector:
    """Return the shortest p with (AᵀWp)_j about wanted_j times the length of column j, for the chosen j.

    The caller checks the signs.
    """
    columns, root = np.flatnonzero(chosen), problem.root_weights
    if not wanted[columns].any():
        return np.zeros(root.size)
    if problem.is_small:
        few = problem.weighted_matrix[:, columns]
        few = (few.toarray() if problem.is_sparse else few) / problem.column_scales[columns]
        push = shortest_solution(few.T, wanted[columns])
    else:
        push = _push_by_products(problem, wanted[columns], columns, accuracy)
    return np.asarray(np.divide(push, root, out=np.zeros(root.size), where=root > 0.0))


def _push_by_products(
    problem: BoundedLeastSquares, wanted: Vector, columns: Array, accuracy: float
) -> Vector:
    """Return the shortest p of the scaled problem by lsmr, by a sparse factorization if lsmr does not converge."""
    from scipy.sparse.linalg import LinearOperator, lsmr

    scaled, (m, n) = problem.scaled, problem.shape

    def back(pull: Vector) -> Vector:
        if enforced_seconds_left() < 0.0:
            raise OutOfTimeError
        full = np.zeros(n)
        full[columns] = pull
        return np.asarray(scaled.product(full))

    across = LinearOperator(
        (columns.size, m), lambda push: scaled.apply_transpose(push)[columns], back, dtype=float
    )
    steps = min(300, 2 * columns.size + 1)  # more than A of condition 100 needs
    push, *_, left = lsmr(across, wanted, atol=0.0, btol=accuracy, conlim=0.0, maxiter=steps)[:4]
    if left > accuracy * np.linalg.norm(wanted) and problem.is_sparse and is_within_reach(scaled):
        push = _push_by_factorization(scaled.matrix(is_dense=False)[:, columns], wanted, push)
    return np.asarray(push)


def _push_by_factorization(A: AnyMatrix, wanted: Vector, otherwise: Vector) -> Vector:
    """Return the shortest p with Aᵀp = wanted, of p + A u = 0, with one refinement; `otherwise` if A is singular."""
    from scipy.sparse.linalg import splu

    m = A.shape[0]
    both = sp.csc_array(sp.block_array([[sp.eye_array(m), A], [A.T, None]]))
    right = np.append(np.zeros(m), wanted)
    try:
        factors = splu(both)
    except RuntimeError:
        return otherwise
    solution = factors.solve(right)
    return np.asarray((solution + factors.solve(right - both @ solution))[:m])
