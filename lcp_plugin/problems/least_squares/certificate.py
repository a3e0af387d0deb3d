r"""What SOLVED means for min ½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x|, lower ≤ x ≤ upper; what is proved of x.

Write W = diag(weights), r = A x − b, f for the cost. For any y ∈ ℝᵐ and s = AᵀWy + ridge·x, convexity gives, summed
without cancellation, for every feasible z

    f(x) − f(z) ≤ gap(x, y) = ½ Σ_i weights_i (r_i − y_i)² + Σ_j s_j⁺(x_j − lower_j) + s_j⁻(upper_j − x_j),

and, with μ ≥ ridge such that f(z) − ½μ‖z‖² is convex, no more than s_j²/(2μ) for any column j while y = r. A column
without a bound on one side needs an s_j of one sign, which rounding and the tolerance deny to y = r: y = r + δp with
AᵀWp of that sign has it. Where there is none (a free column, A not proved to have full rank) f(x) − f(z) ≤ f(x) is all
there is to say: that is the `gap` of a result, rounding included.

A penalty l1_j |x_j| is l1_j x_j where x_j ≥ 0 and −l1_j x_j elsewhere: in the sum x_j and z_j are split at 0, with
s_j + l1_j on the one side and s_j − l1_j on the other; s_j²/(2μ) becomes that of the least slope at x_j. A column
without bounds needs |s_j| ≤ l1_j then, which y = θ r has for some θ ≤ 1 (Mairal, doctoral thesis, Cachan 2010).

**SOLVED: x is within the bounds and, for some y, the gap is at most tolerance · cost, cost = ½ Σ weights y² + ½ ridge
‖x‖² + Σ l1 |x|, where of r_i − y_i and of s_j only what exceeds rounding counts**: in row i what exceeds ρ_i = γ
(|A||x| + |b|)_i, and τ_j = γ (|A|ᵀW|y| + ridge |x|)_j in column j, γ = 4 u (terms + 4). So x is optimal to the
tolerance beside its cost for entries of A and b that differ from those given by no more than that relative rounding:
b_i moved by r_i − y_i, and column j such that s_j is 0. The sums are taken with y, not r: y_i of a large row is small,
so that its rounding hides nothing of the others, and a residual that is rounding in each row (y = 0) is a cost of 0.
And rounding hides no cost that another x has not: in each row weights ρ² is at most 10⁻⁴ of weights (|A||x| + |b|)² at
the point of the box nearest to 0, or nothing beside the whole cost; or in those rows together, where it is neither, at
most 10⁴ times what it is at an answer found from there, or at a basic solution: far out, where columns cancel, what
rounding may hide is more, and no large row that shares these columns excuses it. Of an A of more than 10⁶ places the
first is asked of each connected component.
All that is compared is in the unit of its row, or of its column, or a cost: units of rows (with weights ÷ their
squares) and columns change nothing but rounding. It cannot see what such a change of A decides: columns that depend on
others up to rounding, where no bound stops them. For a LinearOperator, whose entries nobody knows, SOLVED means a small
gradient, and all is an estimate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.certificates.criterion import within
from ...core.checks import BoolVector, FloatVector
from ...core.deadline import OutOfTimeError, enforced_seconds_left
from ...core.kernels.floats import TINY
from ...core.rounding import compensated_product
from ...systems.equilibration import power_of_two
from .data import LARGEST_SCALE, BoundedLeastSquares
from .enclosures import NOTHING, OUTWARD, Ball, Enclosures, largest_residuals, typical_rounding
from .refined_steps import refined_steps
from .steps import FacePoint, through_orthants

UNAVOIDABLE = 1e4  # times what rounding costs at an answer near 0: that is no cost which is hidden
INDEPENDENT = (
    2.0**-40
)  # of the longest column: what is left of one that depends on others is shorter
REPAIR_STEPS = 300  # for a p; more than A of condition 100 needs
NEARLY = 1e-9  # of a cost that rounding may be
IS_NEAR = 1  # what LSMR says then
ENOUGH = 0.8  # of the 1 that (AᵀWp)_j is to be, in units of column j
IN_DOUBT = 1e-6  # of the largest multiplier: smaller ones may be those of free columns
PUSHES = 4  # times that δ may be doubled
ACCURACIES = (
    1e-3,
    1e-6,
    1e-8,
)  # with which a dual point is made orthogonal to the free columns, one after the other


@dataclass(eq=False)
class Optimality:
    """How optimal an x is.

    Attributes
    ----------
    enclosures : Enclosures
    x : ndarray, shape (n,)
    residual : (ndarray, ndarray), shape (m,) each
        A x − b, and how far it is known.
    value : float
        What SOLVED asks to be at most the tolerance: the least gap found, rounding aside, beside its cost, 1 at the
        most; of a LinearOperator `steepness`.
    dual : ndarray, shape (m,)
        The y of the value.
    """

    enclosures: Enclosures
    x: FloatVector
    residual: Ball
    value: float
    dual: FloatVector

    @classmethod
    def of(
        cls,
        enclosures: Enclosures,
        x: FloatVector,
        dual: FloatVector | None = None,
        *,
        tolerance: float = np.inf,
    ) -> Optimality:
        """Return the optimality of x on the caller's own data.

        A y that somebody has for x is tried beside the residual, and nothing else with an empty one; others are
        computed where neither reaches `tolerance`.
        """
        residual = enclosures.residual(x)
        judged = cls(enclosures, x, residual, 1.0, residual[0])
        if not enclosures.problem.has_entries:
            judged.value = judged.steepness
            return judged
        duals = _dual_points(judged, dual)
        duals = _with_shrunk(enclosures, x, duals) if enclosures.problem.l1.any() else duals
        judged.value, judged.dual = _beside_cost(enclosures.problem, x, residual, duals, tolerance)
        if judged.hides_costs:
            judged.value = 1.0
        return judged

    @classmethod
    def unjudged(cls, enclosures: Enclosures, x: FloatVector) -> Optimality:
        """Return that of an x of which nothing is proved: no time is left."""
        residual = enclosures.problem.product(x) - enclosures.problem.b
        return cls(enclosures, x, (residual, np.full(residual.size, np.inf)), 1.0, residual)

    @property
    @np.errstate(all="ignore")
    def hides_costs(self) -> bool:
        """Whether rounding costs much in some rows, and all of them far less at a nearer point that fits as well.

        That is a basic solution without bounds; where rounding is far less there, what an active set finds from near 0.
        Of a large A, whether it costs much in some connected component.
        """
        enclosures, problem = self.enclosures, self.enclosures.problem
        hidden, is_much = enclosures.hidden_costs(self.residual)
        if not is_much.any():
            return False
        if not problem.is_cheap_to_copy:
            return enclosures.hides_beside_components(hidden, self.residual)

        def is_avoided_at(point: FloatVector) -> bool:
            slip = enclosures.residual(point)[1]
            return not hidden[is_much].sum() <= UNAVOIDABLE * float(
                (problem.weighted(slip) * slip)[is_much].sum()
            )

        return is_avoided_at(_basic(enclosures)) and is_avoided_at(_near_answer(enclosures))

    def meets(self, tolerance: float) -> bool:
        """Return whether x is SOLVED; an operator's asks for a small gap besides."""
        return bool(within(self.value, 0.0, tolerance))

    def is_better(self, other: Optimality) -> bool:
        """Return whether this is more optimal than another."""
        return (self.value, self.steepness) < (other.value, other.steepness)

    @property
    def steepness(self) -> float:
        """The larger of ‖mid(x − upper, x − lower, g)‖∞/‖AᵀWb‖∞, g the gradient, and the same with unit columns.

        An upper bound, rounding included, where A has entries.
        """
        return max(map(_ratio, self._largest[:2], self.enclosures.reference))

    @property
    def is_at_rounding_level(self) -> bool:
        """Whether no component of it is larger than what rounding explains."""
        return self._largest[2]

    @property
    @np.errstate(over="ignore", invalid="ignore")
    def sharp_residual(self) -> FloatVector:
        """A x − b, computed without rounding where that is more than 1e-9 of the cost."""
        problem, (r, slip) = self.enclosures.problem, self.residual
        if not problem.has_entries or not problem.weighted(slip) @ np.abs(
            r
        ) > NEARLY * problem.cost(self.x, r):
            return r
        return compensated_product(sp.csr_array(problem.A), self.x, -problem.b)[0]

    @cached_property
    def _largest(self) -> tuple[float, float, bool]:
        problem = self.enclosures.problem
        gradient = self.enclosures.gradient(self.x, self.residual)
        if not problem.has_entries:
            gradient = gradient[0], typical_rounding(problem, self.x, self.residual[0])
        return largest_residuals(
            *gradient,
            self.x,
            problem.lower,
            problem.upper,
            problem.l1,
            problem.column_scales,
            problem.has_entries,
        )


def _basic(enclosures: Enclosures) -> FloatVector:
    """Return a least squares solution without bounds of few columns, those furthest apart, refined once; it is kept."""
    if enclosures.basic is None:
        from scipy.linalg import qr, solve_triangular

        problem, scaled = enclosures.problem, enclosures.problem.scaled
        Q, R, columns = qr(scaled.dense(), mode="economic", pivoting=True, check_finite=False)
        rank = int(
            np.count_nonzero(np.abs(R.diagonal()) > INDEPENDENT * np.abs(R).max(initial=0.0))
        )
        chosen, x = columns[:rank], np.zeros(scaled.n)
        for _ in range(2):  # beside one large b the others are rounding at first
            left = (
                problem.root_weights
                * compensated_product(sp.csr_array(problem.A), x, -problem.b)[0]
            )
            step = solve_triangular(R[:rank, :rank], Q[:, :rank].T @ left, check_finite=False)
            x[chosen] -= step / scaled.columns[chosen]
        enclosures.basic = x
    return enclosures.basic


def _near_answer(enclosures: Enclosures) -> FloatVector:
    """Return the point that an active set finds from the point of the box nearest to 0; it is kept."""
    if enclosures.near_answer is None:
        scaled = enclosures.problem.scaled
        start = FacePoint(scaled, scaled.nearest_to_zero)
        *_, last = through_orthants(refined_steps)(start)
        enclosures.near_answer = scaled.to_caller(last.x)
    return enclosures.near_answer


def _beside_cost(
    problem: BoundedLeastSquares,
    x: FloatVector,
    residual: Ball,
    duals: Iterator[tuple[FloatVector, Ball, FloatVector]],
    tolerance: float,
) -> tuple[float, FloatVector]:
    """Return what SOLVED compares with the tolerance (the module's docstring), 1 at the most, and its y."""
    least, best = np.inf, residual[0]
    for y, slope, convexity in duals:
        gap, cost, _ = _gap(problem, x, residual, y, slope, convexity, rounding=-1.0)
        value = 0.0 if gap == 0.0 else OUTWARD * gap / cost if cost > 0.0 else np.inf
        if value < least:
            least, best = value, y
        if least <= tolerance:
            break
    return min(least, 1.0), best


def _dual_points(
    judged: Optimality, dual: FloatVector | None
) -> Iterator[tuple[FloatVector, Ball, FloatVector]]:
    """Yield what y may be, with its s and the convexity that goes with it, the cheapest first."""
    enclosures, x, (r, slip) = judged.enclosures, judged.x, judged.residual
    problem = enclosures.problem
    if dual is not None and dual.size:
        yield dual, enclosures.gradient_at(x, dual), NOTHING
    slope = enclosures.gradient_at(x, r)
    yield r, slope, NOTHING
    if (np.abs(r) <= slip).any():
        zeroed = np.where(np.abs(r) > slip, r, 0.0)
        yield zeroed, enclosures.gradient_at(x, zeroed), NOTHING
    if dual is not None:  # whoever has one knows better than what follows
        return
    free, y, at_y = (
        (problem.lower < x) & (x < problem.upper) & ((x != 0.0) | (problem.l1 == 0.0)),
        r,
        slope,
    )
    if judged.is_at_rounding_level:
        yield from ((*found, NOTHING) for found in _repaired(enclosures, x, y, at_y, rounding=-1.0))
    for accuracy in ACCURACIES:
        wrong = at_y[0] + np.copysign(problem.l1, x)
        y = y - _push(problem, np.where(free, wrong / problem.column_scales, 0.0), free, accuracy)
        at_y = enclosures.gradient_at(x, y)
        yield y, at_y, NOTHING
        if (
            np.abs(y) <= slip
        ).any():  # the only entry of a column without bounds wants a y_i of 0, not of rounding
            zeroed = np.where(np.abs(y) > slip, y, 0.0)
            yield zeroed, enclosures.gradient_at(x, zeroed), NOTHING
        yield from ((*found, NOTHING) for found in _repaired(enclosures, x, y, at_y, rounding=-1.0))
    if (convexity := enclosures.convexity) is not None:
        yield r, slope, convexity


def _with_shrunk(
    enclosures: Enclosures, x: FloatVector, duals: Iterator[tuple[FloatVector, Ball, FloatVector]]
) -> Iterator[tuple[FloatVector, Ball, FloatVector]]:
    """Yield each y, and behind it the same shrunk."""
    for y, slope, convexity in duals:
        yield y, slope, convexity
        if not convexity.size and (shrunk := _shrunk(enclosures, x, y, slope)) is not None:
            yield (*shrunk, NOTHING)


def _shrunk(
    enclosures: Enclosures, x: FloatVector, y: FloatVector, slope: Ball
) -> tuple[FloatVector, Ball] | None:
    """Return θ y, θ ≤ 1, with |s_j| ≤ l1_j where there is a penalty and no bound, and its s; None where y has that."""
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


def _ratio(size: float, unit: float) -> float:
    if math.isnan(size):
        return math.inf
    return OUTWARD * size / unit if unit > 0.0 else (math.inf if size > 0.0 else 0.0)


@np.errstate(all="ignore")
def duality_gap(problem: BoundedLeastSquares, x: FloatVector, *duals: FloatVector) -> float:
    """Return an upper bound of f(x) − min f, for x within the bounds; an estimate for a LinearOperator.

    Parameters
    ----------
    problem : BoundedLeastSquares
    x : array, shape (n,)
    *duals : arrays, shape (m,)
        Of any origin; residuals of points nearer to the answer make the bound sharper.
    """
    enclosures = Enclosures(problem)
    residual = enclosures.residual(x)
    at_x = enclosures.gradient(x, residual)
    exactly = residual[0], np.zeros(residual[0].size)  # y is the residual, whatever that is
    slopes = [(y, enclosures.gradient_at(x, y)) for y in duals or (residual[0],)]
    if problem.l1.any():
        slopes += [
            shrunk
            for y, slope in slopes
            if (shrunk := _shrunk(enclosures, x, y, slope)) is not None
        ]

    def above(*given: Any) -> float:
        gap, _, size = _gap(problem, x, *given)
        return OUTWARD * gap * size * size + TINY if gap < np.inf else np.inf

    found = [above(exactly, residual[0], at_x), *(above(residual, *slope) for slope in slopes)]
    if not np.nanmin(found) < np.inf:
        found += [
            above(residual, *repair)
            for slope in slopes
            for repair in _repaired(enclosures, x, *slope)
        ]
    if not np.nanmin(found) < np.inf and (convexity := enclosures.convexity) is not None:
        found.append(above(exactly, residual[0], at_x, convexity))
    cost = float(OUTWARD**3 * (problem.cost(x, np.abs(residual[0]) + residual[1]) + TINY))
    return min(gap for gap in (cost, *found) if not np.isnan(gap))


def _gap(
    problem: BoundedLeastSquares,
    x: FloatVector,
    residual: Ball,
    y: FloatVector,
    slope: Ball,
    convexity: FloatVector = NOTHING,
    *,
    rounding: float = 1.0,
) -> tuple[float, float, float]:
    """Return gap(x, y) for s in `slope`, the cost of y, and the size whose square is the unit of both.

    Residual and slope are known up to radii: those are added where `rounding` is 1, excused where it is −1.
    """
    root, scales, l1, (s, radius) = problem.root_weights, problem.column_scales, problem.l1, slope
    off, distance = np.maximum(np.abs(residual[0] - y) + rounding * residual[1], 0.0), np.abs(x)
    bent, penalty = math.sqrt(problem.ridge) * distance, np.sqrt(l1) * np.sqrt(distance)
    parts = root * np.abs(y), root * off, bent, penalty
    size = float(
        power_of_two(max(float(np.max(part, initial=0.0)) for part in parts), LARGEST_SCALE)
    )
    unit, share = scales * size, scales / size
    of_y, of_rows, of_ridge, _ = (part / size for part in parts)
    cost = 0.5 * float(of_y @ of_y + of_ridge @ of_ridge) + float((l1 / unit) @ (distance * share))
    near, far = x - problem.lower, problem.upper - x
    margin = rounding * radius
    linear = _fall(s, near, margin, unit, share) + _fall(-s, far, margin, unit, share)
    least = np.abs(s)
    if l1.any():  # x and z split at 0
        both = np.zeros(x.size)
        for sign, low, high in (
            (1.0, problem.lower, problem.upper),
            (-1.0, -problem.upper, -problem.lower),
        ):
            slant, at = s * sign + l1, np.maximum(sign * x, 0.0)
            both += _fall(slant, at - np.maximum(low, 0.0), margin, unit, share)
            both += _fall(-slant, np.maximum(high, 0.0) - at, margin, unit, share)
        linear = np.where(l1 == 0.0, linear, both)
        least = np.where(x != 0.0, np.abs(s + np.copysign(l1, x)), np.maximum(np.abs(s) - l1, 0.0))
    curved = (convexity if convexity.size else problem.ridge) / scales / scales
    if np.any(curved > 0.0):
        steepest = np.square((least + margin) / unit) / (2.0 * curved) + TINY
        linear = np.where((linear > 0.0) & (curved > 0.0), np.minimum(linear, steepest), linear)
    gap = 0.5 * float(of_rows @ of_rows) + float(
        np.sum(linear + 0.0 * (s + radius))
    )  # NaN where one is not finite
    return (OUTWARD * OUTWARD * gap if gap < np.inf else np.inf), cost, size


def _fall(
    slant: FloatVector, slack: FloatVector, off: Any, unit: FloatVector, share: FloatVector
) -> FloatVector:
    """Return by how much the cost falls at the most over the slack, in units, at a slant known up to `off`."""
    steep = (slant + off) / unit
    falls = (steep > 0.0) & (slack > 0.0)
    if not falls.any():
        return np.zeros(slack.size)
    return np.where(falls, np.where(falls, steep, 0.0) * (slack * share) + TINY, 0.0)


def _repaired(
    enclosures: Enclosures, x: FloatVector, y: FloatVector, slope: Ball, *, rounding: float = 1.0
) -> Iterator[tuple[FloatVector, Ball]]:
    """Yield y + δp with a least δ that gives all columns the sign that they need, and its s, if one is found.

    p is to push the columns whose sign is in doubt, or else all of them.
    """
    problem = enclosures.problem
    wanted = np.where(problem.upper == np.inf, 1.0, 0.0) - np.where(
        problem.lower == -np.inf, 1.0, 0.0
    )
    wanted = np.where(np.maximum(np.abs(slope[0]), slope[1]) > 0.0, wanted, 0.0)
    sizes = (wanted * slope[0] + problem.l1) / problem.column_scales
    in_doubt = sizes <= IN_DOUBT * np.max(np.abs(sizes), initial=0.0)
    missing = np.maximum(rounding * slope[1] - wanted * slope[0] - problem.l1, 0.0)
    lacking = (wanted != 0.0) & (missing > 0.0)
    for push in _pushes(problem, np.where(in_doubt, wanted, 0.0), wanted):
        moved = wanted * problem.transposed(problem.weighted(push))
        share = float(np.max(missing[lacking] / moved[lacking], initial=0.0))
        for _ in range(PUSHES if (moved[lacking] > 0.0).all() else 0):
            share *= 1.0 + 2.0**-10
            repaired = y + share * push
            value, radius = enclosures.gradient_at(x, repaired)
            if (wanted * value + problem.l1 >= rounding * radius)[wanted != 0.0].all():
                yield repaired, (value, radius)
                return
            share *= 2.0


def _pushes(problem: BoundedLeastSquares, *wanted: FloatVector) -> Iterator[FloatVector]:
    """Yield what p may be: A times the first that is wanted, which serves where entries are ≥ 0; then the shortest."""
    yield problem.product(wanted[0] / problem.column_scales)
    for signs in wanted:
        yield _push(
            problem, signs, signs != 0.0, ENOUGH / math.sqrt(max(int(np.count_nonzero(signs)), 1))
        )


def _push(
    problem: BoundedLeastSquares, wanted: FloatVector, chosen: BoolVector, accuracy: float
) -> FloatVector:
    """Return the shortest p with (AᵀWp)_j about wanted_j times the length of column j, for the chosen j.

    Its signs are looked at where it is used.
    """
    scaled, columns, root = problem.scaled, np.flatnonzero(chosen), problem.root_weights
    if not wanted[columns].any():
        return np.zeros(root.size)
    from scipy.sparse.linalg import LinearOperator, lsmr

    from ..programs.dual_bounds import least_squares

    def back(pull: FloatVector) -> FloatVector:
        if enforced_seconds_left() < 0.0:
            raise OutOfTimeError
        full = np.zeros(wanted.size)
        full[columns] = pull
        return np.asarray(scaled.product(full))

    shape = (columns.size, root.size)
    across = LinearOperator(
        shape, lambda push: scaled.transposed(push)[columns], back, dtype=np.float64
    )
    steps = min(REPAIR_STEPS, 2 * columns.size + 1)
    push, reason, *_ = lsmr(
        across, wanted[columns], atol=0.0, btol=accuracy, conlim=0.0, maxiter=steps
    )
    if reason != IS_NEAR and problem.is_cheap_to_copy:  # however ill-conditioned A is
        push = least_squares(sp.csr_array(scaled.entries()[:, columns]).T, wanted[columns])
    return np.asarray(np.divide(push, root, out=np.zeros(root.size), where=root > 0.0))
