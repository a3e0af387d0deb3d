r"""Certificate of min ½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x|, lower ≤ x ≤ upper: SOLVED, bounds of the gap.

Write W = diag(weights), r = A x − b, f for the cost. For any y ∈ ℝᵐ and s = AᵀWy + ridge·x, convexity gives, summed
without cancellation, for every feasible z

    f(x) − f(z) ≤ gap(x, y) = ½ Σ_i weights_i (r_i − y_i)² + Σ_j s_j⁺(x_j − lower_j) + s_j⁻(upper_j − x_j),

and, with a ridge, at most s_j²/(2 ridge) for any column j if y = r. A column without a bound on one side requires an
s_j of one sign.

A penalty l1_j |x_j| is l1_j x_j if x_j ≥ 0 and −l1_j x_j otherwise: in the sum, x_j and z_j are split at 0, with
s_j + l1_j on the positive side and s_j − l1_j on the negative side; s_j²/(2 ridge) uses the least slope at x_j. A
column without bounds requires |s_j| ≤ l1_j then, which y = θ r has for some θ ≤ 1 (Mairal, doctoral thesis, Cachan
2010).

**SOLVED: x is within the bounds and, for some y, the gap is at most tolerance · cost, cost = ½ Σ weights y² + ½ ridge
‖x‖² + Σ l1 |x|, without rows of A that have no entries, and rounding of the data is tolerated**: in row i, r_i − y_i up
to ρ_i = γ min((|A||x| + |b|)_i, S_i), and in column j, s_j up to τ_j = γ (|A|ᵀW|y| + ridge |x|)_j, γ = 4 u (terms + 4).
S_i is 2²⁰ times the largest term at the point of the box nearest to 0, in the unit of row i, so that an x that ran away
does not make every residual rounding; of a small A, 4 times the terms at the shortest solution without bounds if that
is more, as for nearly dependent columns. So x is optimal to the tolerance for entries of A and b that differ from the
data by at most this relative rounding, as for solutions of lstsq and nnls. A residual at rounding level in each row (y
= 0) is a cost of 0.
**A point that costs more than a known point is not SOLVED.** The known points are the point of the box nearest to 0,
rounding of its residual included, and the projected solution of lstsq, if A is small and rounding exceeds tolerance.
All comparisons are made in the unit of a row, of a column, or of the cost: units of rows (with weights ÷ their squares)
and columns change rounding only. Columns that are dependent up to rounding count as dependent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import scipy.sparse as sp

from ...core import deadline
from ...core.checks import AnyMatrix, Array, BoolVector, Vector, derived_property
from ...core.entries import clip, max_norm
from ...core.kernels.floats import OUTWARD, TINY
from ...core.rounding import compensated_product
from ...judges.worst_rows import WorstRow, WorstRows, outside_row
from .data import Ball, BoundedLeastSquares, Enclosures, shortest_solution
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
        Measure that must be at most the tolerance for SOLVED: the least gap, apart from rounding, relative to its
        cost, at most 1. 1 if a point of lower cost is known.
    passes : bool
        Whether the point is SOLVED: its residual is at most the tolerance, and the goal of a run.
    """

    enclosures: Enclosures
    x: Vector
    misfit: Ball
    residual: float
    passes: bool = False

    @classmethod
    def of(cls, enclosures: Enclosures, x: Vector, tolerance: float, goal: float = np.inf) -> Self:
        """Return the optimality of x on the unscaled data; dual points are tried until one meets the tolerance."""
        misfit = enclosures.residual(x)
        optimality, residual = cls(enclosures, x, misfit, 1.0), enclosures.explained(x, misfit)
        for y, slope in _dual_points(optimality):
            gap = float(_relative_gap(enclosures.problem, x, residual, y, slope))
            optimality.residual = min(optimality.residual, gap)
            if optimality.residual <= tolerance:
                break
        if optimality.is_worse_than_known(tolerance):
            optimality.residual = 1.0
        optimality.passes = optimality.residual <= min(tolerance, goal)
        return optimality

    def is_worse_than_known(self, tolerance: float) -> bool:
        """Return whether x costs more than a known point, including the rounding of that point's cost."""
        enclosures, problem = self.enclosures, self.enclosures.problem
        known = [problem.nearest_to_zero]
        if _may_be_rounding(problem, self.cost, self.misfit[1], tolerance):
            known.append(clip(enclosures.shortest, problem.lower, problem.upper))
        return any(exceeds(self.cost, enclosures.cost_above(x), tolerance) for x in known)

    @derived_property
    def cost(self) -> float:
        """The cost of x."""
        return float(self.enclosures.problem.cost(self.x, self.misfit[0]))

    @property
    @np.errstate(all="ignore")
    def sharp_residual(self) -> Vector:
        """A x − b, computed by compensated sums if rounding is more than 1e-9 of the cost."""
        problem, (r, radius) = self.enclosures.problem, self.misfit
        # A smaller difference of costs may be rounding
        if not problem.apply_weights(radius) @ np.abs(r) > 1e-9 * problem.cost(self.x, r):
            return r
        return compensated_product(sp.csr_array(problem.A), self.x, -problem.b)[0]

    @derived_property
    def is_limited(self) -> bool:
        """True if x − mid(lower, upper, prox(x − g)) is at rounding level in every component.

        prox moves by l1 towards 0, but not beyond.
        """
        problem, scales = self.enclosures.problem, self.enclosures.problem.column_scales
        slope, radius = self.enclosures.gradient(self.x, self.misfit)
        slope, radius, x, l1 = slope / scales, radius / scales, self.x * scales, problem.l1 / scales
        residual = clip(x, slope - l1, slope + l1)
        residual = clip(residual, x - problem.upper * scales, x - problem.lower * scales)
        return bool((np.abs(residual) <= 2.0 * radius).all())


def _may_be_rounding(problem: BoundedLeastSquares, cost: Array, radius: Vector, tol: float) -> Any:
    """Return whether rounding of A x − b, known up to radius, exceeds the tolerance, of a small A."""
    return problem.is_small & (0.5 * np.vecdot(problem.apply_weights(radius), radius) > tol * cost)


def exceeds(cost: Array, known: Array, tolerance: float) -> Any:
    """Return whether a cost exceeds an upper bound of the least by more than the tolerance, or is NaN."""
    return np.logical_not(cost <= OUTWARD * (1.0 + tolerance) * known)


def measure_stack(
    problem: BoundedLeastSquares, x: Vector, tolerance: float, newton_step: Callable[..., Vector]
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
    value = _relative_gap(problem, x, residual, y, slope)
    if not (value <= tolerance).all():
        y = y + newton_step(slope[0]) @ problem.A.T
        more = _relative_gap(problem, x, residual, y, enclosures.gradient_at(x, y))
        value = np.where(more < value, more, value)
    cost = problem.cost(x, residual[0])
    least = enclosures.cost_above(np.broadcast_to(problem.nearest_to_zero, x.shape))
    is_solved = (value <= tolerance) & ~exceeds(cost, least, tolerance)
    return value, is_solved & ~_may_be_rounding(problem, cost, residual[1], tolerance)


def _dual_points(optimality: Optimality) -> Iterator[tuple[Vector, Ball]]:
    """Yield dual points y with their s, the cheapest first: each also shrunk, and with 0 for rounding errors."""
    enclosures, x, radius = optimality.enclosures, optimality.x, optimality.misfit[1]
    for y in _orthogonal_residuals(optimality):
        is_noise = np.abs(y) <= radius  # their multipliers are exactly 0
        for dual in (y, np.where(is_noise, 0.0, y)) if is_noise.any() else (y,):
            slope = enclosures.gradient_at(x, dual)
            yield dual, slope
            share = _admissible_share(enclosures.problem, x, slope)
            if 0.0 < share < 1.0 - 2.0**-49:
                yield share * dual, enclosures.gradient_at(x, share * dual)


def _orthogonal_residuals(optimality: Optimality) -> Iterator[Vector]:
    """Yield the residual, then its part that is orthogonal to the free columns."""
    problem, x, r = optimality.enclosures.problem, optimality.x, optimality.misfit[0]
    yield r
    free = (problem.lower < x) & (x < problem.upper) & ((x != 0.0) | (problem.l1 == 0.0))
    slope = optimality.enclosures.gradient_at(x, r)[0] + np.copysign(problem.l1, x)
    yield r - _push(problem, np.where(free, slope / problem.column_scales, 0.0), free, 1e-8)


def _admissible_share(problem: BoundedLeastSquares, x: Vector, slope: Ball) -> float:
    """Return the largest θ ≤ 1 with |s_j| ≤ l1_j of θ y in penalized columns without a bound, to rounding."""
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
    return float(np.min(shares, initial=1.0)) * (1.0 - 2.0**-50)


def _relative_gap(
    problem: BoundedLeastSquares, x: Vector, residual: Ball, y: Vector, slope: Ball
) -> Any:
    """Return gap(x, y) relative to the cost of y, apart from rounding, for s in `slope`; shape (B,) for a stack."""
    gap = falls(problem, x, slope).sum(-1)
    if y is not residual[0]:
        off = np.maximum(np.abs(residual[0] - y) - residual[1], 0.0)
        gap = 0.5 * np.vecdot(problem.apply_weights(off), off) + gap
    gap = np.where(gap < np.inf, OUTWARD**3 * gap + TINY * (gap > 0.0), np.inf)
    y = np.where(problem.has_terms, y, 0.0)  # no x changes the cost of the other rows
    squares = np.vecdot(problem.apply_weights(y), y) + problem.ridge * np.vecdot(x, x)
    cost = 0.5 * squares + np.vecdot(problem.l1, np.abs(x))
    return np.where(gap == 0.0, 0.0, OUTWARD * gap / cost)


def falls(problem: BoundedLeastSquares, x: Vector, slope: Ball) -> Vector:
    """Return by how much the cost may fall at most in each column, for the s in `slope`, apart from its rounding."""
    l1, (s, radius) = problem.l1, slope
    near, far = x - problem.lower, problem.upper - x
    linear, least = _fall(s - radius, near) + _fall(-s - radius, far), np.abs(s)
    if l1.any():  # x and z split at 0
        both, negative = np.zeros(x.shape), (-problem.upper, -problem.lower)
        for sign, low, high in ((1.0, problem.lower, problem.upper), (-1.0, *negative)):
            slant, at = s * sign + l1, np.maximum(sign * x, 0.0)
            both += _fall(slant - radius, at - np.maximum(low, 0.0))
            both += _fall(-slant - radius, high - at)  # at is 0 if high < 0
        linear = np.where(l1 == 0.0, linear, both)
        least = np.where(x != 0.0, np.abs(s + np.copysign(l1, x)), np.maximum(np.abs(s) - l1, 0.0))
    if problem.ridge > 0.0:
        steep = least - radius
        steepest = 0.5 * steep * (steep / problem.ridge) + TINY
        linear = np.where(linear > 0.0, np.minimum(linear, steepest), linear)
    return linear + 0.0 * (s + radius)  # NaN if an entry is not finite


def onto_bounds(problem: BoundedLeastSquares, x: Vector, tolerance: float) -> tuple[Vector, Array]:
    """Return x within the bounds, and the columns in which x is farther beyond them than tolerated, the worst first."""
    near, scales = clip(x, problem.lower, problem.upper), problem.column_scales
    moves = np.abs(x - near) * scales
    return near, np.argsort(-moves)[: np.count_nonzero(moves > tolerance * max_norm(x * scales))]


def worst_columns(
    problem: BoundedLeastSquares, x: Vector, tolerance: float, count: int
) -> WorstRows:
    """Return the columns with x_j beyond a bound, else those whose slope may lower the cost by most."""
    (near, beyond), scales = onto_bounds(problem, x, tolerance), problem.column_scales
    if beyond.size:
        return WorstRows(outside_row(f"x[{j}]", x[j], near[j]) for j in beyond[:count].tolist())
    at = Optimality.of(Enclosures(problem), near, tolerance=tolerance)
    if at.residual <= tolerance:
        return WorstRows()
    s, radius = at.enclosures.gradient(near, at.misfit)
    fall, worst = falls(problem, near, (s, radius)), []
    for j in np.lexsort((-np.abs(s) / scales, -fall))[:count].tolist():
        most = f"may lower the cost by {fall[j]:.3g}" if fall[j] < np.inf else "must be 0"
        text = f"x[{j}] = {x[j]:.6g}: the slope of the cost is {s[j]:.3g}, and {most}"
        share = float(fall[j] / at.cost) if at.cost > 0.0 else np.inf
        worst.append(WorstRow(f"x[{j}]", share, abs(float(s[j])), float(radius[j]), text))
    return WorstRows(row for row in worst if row.residual > 0.0)


def _fall(slant: Vector, slack: Vector) -> Vector:
    """Return by how much the cost falls at most over the slack, at a slant."""
    return np.where((slant > 0.0) & (slack > 0.0), slant * slack + TINY, 0.0)


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
        deadline.require_seconds(0.0)
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
