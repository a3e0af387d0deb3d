"""Upper bounds of the distance of z from the solution.

**Hidden errors.** To first order z − z* = (S M_FF)⁻¹ r_F on the rows F strictly between their bounds, S = D⁻¹: an error
as large as ‖(S M_FF)⁻¹‖∞ ‖r‖∞ may hide behind a residual r. LAPACK estimates the norm up to 500 rows; this proves
nothing (see `error_bounds` for what does).

**Curvature** of a quadratic form is bounded below by μ with P − diag(μ) proved semidefinite. P falls into the blocks
that its pattern connects. The weight of a block of one entry is this entry. A larger block is definite by a
factorization with a rounding margin, or semidefinite by its row sums or by exact elimination. Otherwise it may be
semidefinite to rounding: then its weights are negative, by a bound of the rounding error.

On the solutions of A x = b the objective is also f(x) + ½ ρ‖A x − b‖². If P + ρ AᵀA is positive definite, ρ > 0, its
weights may replace the weights of P, between points that satisfy the equations exactly.

**By rows**, with outward rounding. Let e = z − z*. If e_i > 0, then either z*_i is the upper bound and e_i = z_i −
upper_i, or w*_i ≥ 0, so that (M e)_i ≤ w_i; and e_i ≤ z_i − lower_i in any case. With m_ii = d_i > 0 and B the rest of
M,

    e_i ≤ max(z_i − upper_i, min(z_i − lower_i, (w_i + (|B||e|)_i)/d_i)),

and the mirror image holds if e_i < 0. Together |e| ≤ Φ(|e|) with an isotone Φ. Two things follow.

1. |e| ≤ y gives |e| ≤ Φ(y), for any B.
2. If ⟨M⟩v > 0 for some v > 0, every y ≥ 0 with Φ(y) ≤ y bounds |e|: Φ(y + σv) < y + σv for σ > 0, so the smallest σ
   with |e| ≤ y + σv cannot be positive. And t v is such a y once t is large enough, which is read off row by row: the
   v-certificate.

If ẑ is so close to the solution that the error bound of ẑ is small, |z − ẑ| + bound(ẑ) is tight. A bound by ⟨M⟩⁻¹|r|
ignores all signs, and if ρ(D⁻¹|B|) is close to 1 it exceeds |M⁻¹r| a thousand times. One step of the active-set
method uses the signs: ẑ = z + δ with δ to the bound on the rows that seem active, and M_FF δ_F = −(w + M δ)_F on all
other rows. ẑ may be any point: a poor solve or a wrong guess only makes the bound larger. ẑ is stored as a sum of two
float64 numbers, so that its error can be less than the spacing of float64.

**By eigenvalues**, λ no larger than the eigenvalues of C (M + Mᵀ)/2 C, C = diag(c) > 0: with
e = z − z*, any S = diag(s) > 0 and r_i = mid(z_i − upper_i, z_i − lower_i, s_i w_i), the point z − r is the projection
of z − S w to the bounds. Its variational inequality at z*, and the inequality of z* at z − r, add up row by row to

    (M e)_i e_i ≤ (M e)_i r_i + e_i r_i/s_i − r_i²/s_i,   so that   eᵀM e ≤ eᵀ(Mᵀ + S⁻¹) r,

and as λ‖C⁻¹e‖₂² ≤ eᵀM e, ‖C⁻¹e‖₂ ≤ ‖C (Mᵀ + S⁻¹) r‖₂ / λ: never more than (1 + ‖M‖)‖r‖/λ if S = C = I, and much
less if r is smooth.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..core import deadline
from ..core.checks import AnyMatrix, Array, BoolVector, Vector, checked_vector
from ..core.entries import largest_products, max_norm, scale_matrix
from ..core.errors import InvalidOption, InvalidProblem, UnsuitableMatrix
from ..core.kernels.floats import OUTWARD, TINY, UNDERFLOW, UNIT
from ..core.lcp import LCP
from ..core.matrix import Matrix, fact
from ..core.problem_classes import refusal
from ..core.rounding import compensated_pair, compensated_product, gamma, lower_end
from ..core.structure import connected_components
from ..core.tuning import CHEAP_UP_TO
from ..judges.lcp import row_data, scaled_residual
from ..systems.definiteness import factor_rounding, is_semidefinite_to_rounding, semidefinite_margin
from ..systems.equilibration import unit_diagonal
from ..systems.factors import factor_fits, positive_factor
from ..systems.free_systems import KRYLOV_GOAL, FreeSystem
from ..systems.graph import block_rows, comparison_product
from . import exact
from .exact import product_above, quotient_above, sum_above
from .verdicts import HCertificate, comparison_certificate

BOTH = np.array([[1.0], [-1.0]])


@dataclass(frozen=True, eq=False)
class RowInequality:
    """Φ of one point, the sum `high` + `low`; every number is an upper bound of the exact value.

    Attributes
    ----------
    within : ndarray, shape (2, n)
        z − lower and upper − z.
    beyond : ndarray, shape (2, n)
        z − upper and lower − z.
    slack : ndarray, shape (2, n)
        w and −w.
    """

    problem: LCP
    high: Vector
    low: Vector
    within: Vector
    beyond: Vector
    slack: Vector

    @classmethod
    def at(cls, problem: LCP, high: Vector, low: Vector | None = None) -> RowInequality:
        """Return the inequality at the finite point high + low, each of shape (n,)."""
        if low is None:
            value, radius = compensated_product(problem.csr, high, problem.q)
            slack, low = BOTH * value, np.zeros(problem.n)
        else:  # w is small relative to its terms
            first, remainder, radius = compensated_pair(problem.csr, high, problem.q)
            second, second_radius = compensated_product(problem.csr, low)
            radius = sum_above(radius, second_radius)
            slack = sum_above(sum_above(BOTH * first, BOTH * second), BOTH * remainder)

        def distance(*bounds: Vector) -> Vector:
            return sum_above(sum_above(BOTH * high, np.stack(bounds)), BOTH * low)

        lower, upper = problem.lower, problem.upper
        within, beyond = distance(-lower, upper), distance(-upper, lower)
        return cls(problem, high, low, within, beyond, sum_above(slack, radius))

    @property
    def w(self) -> Vector:
        """The middle of the bounds of w, shape (n,)."""
        return np.asarray(0.5 * (self.slack[0] - self.slack[1]))

    def inflation(self, certificate: HCertificate) -> Vector:
        """Return t ≥ 0, one number per component, with Φ(t v) ≤ t v.

        The result has one entry per row, shape (n,), or (1,) if there is a single component.
        """
        v, margin = certificate.v, certificate.margin
        direct = np.minimum(quotient_above(self.within, v), quotient_above(self.slack, margin))
        sides = np.maximum(quotient_above(self.beyond, v), direct)
        largest = row_data(self.problem).largest(np.maximum(sides.max(axis=0), 0.0))
        return np.where(np.isnan(largest), np.inf, largest)

    def image(self, y: Vector) -> Vector:
        """Return Φ(y), shape (n,); (w + |B|y)/d as y + (w − ⟨M⟩y)/d."""
        value, radius = comparison_product(self.problem.csr, y)
        moved = sum_above(self.slack, sum_above(-value, radius))
        solved = sum_above(y, quotient_above(moved, self.problem.diagonal))
        image = np.maximum(self.beyond, np.minimum(self.within, solved)).max(axis=0)
        return np.where(np.isnan(image), np.inf, np.maximum(image, 0.0))


class NearPoint(NamedTuple):
    """A point ẑ = high + low near the solution, and a bound y of its error; each of shape (n,)."""

    high: Vector
    low: Vector
    y: Vector

    def distance(self, z: Vector) -> Vector:
        """Return an upper bound of |z − ẑ|, shape (n,)."""
        signed = sum_above(sum_above(BOTH * z, -BOTH * self.high), -BOTH * self.low)
        return np.asarray(signed.max(axis=0))

    def bound_at(self, z: Vector) -> Vector:
        """Return a bound of |z − z*|, shape (n,)."""
        bound = sum_above(self.distance(z), self.y)
        return np.where(np.isnan(bound), np.inf, bound)

    def is_sharp(self, z: Vector, bound: Vector) -> bool:
        """Return whether the error of z is proved to be nearly as large as its bound."""
        # Possible improvement, relative to a lower bound of the error
        enough = 0.05 if z.size <= CHEAP_UP_TO else 0.5
        error = (self.distance(z) - self.y).max(initial=0.0)
        return bool(bound.max(initial=0.0) <= (1.0 + enough) * error)


class ActiveSetSteps:
    """Steps of the active-set method on one problem; a factorization serves as long as the free set stays.

    Attributes
    ----------
    system : FreeSystem
        The system of the last step; initially the system of another problem with the same M, if passed.
    """

    def __init__(
        self, problem: LCP, *, goal: float = KRYLOV_GOAL, system: FreeSystem | None = None
    ) -> None:
        self.problem, self.goal = problem, goal
        self.system = system or FreeSystem(problem.matrix, np.zeros(problem.n, np.bool_))

    def next_point(self, at: RowInequality) -> RowInequality | None:
        """Return the inequality at the next point, or None if the step is not finite."""
        problem = self.problem
        on_lower, free = self._sides(at)
        bound = np.where(on_lower, problem.lower, problem.upper)
        delta = np.where(free, 0.0, (bound - at.high) - at.low)
        if not np.array_equal(free, self.system.free):
            self.system = FreeSystem(problem.matrix, free)
        solution = self.system.solve(-(at.w + problem.csr @ delta), goal=self.goal)
        if solution is None or not np.isfinite(delta := delta + solution).all():
            return None
        high = at.high + delta
        part = high - at.high
        low = (at.high - (high - part)) + (delta - part) + at.low
        return RowInequality.at(problem, np.where(free, high, bound), np.where(free, low, 0.0))

    def is_settled(self, at: RowInequality) -> bool:
        """Return whether the point of the last step has the free rows of this step."""
        return np.array_equal(self._sides(at)[1], self.system.free)

    def _sides(self, at: RowInequality) -> tuple[BoolVector, BoolVector]:
        """Return the rows at their lower bounds by the sign of w, and the free rows."""
        # next to a large z its digits would be lost
        step = 1.0 / self.problem.residual_scale * at.w
        on_lower = (at.within[0] <= step) | (self.problem.lower == self.problem.upper)
        return on_lower, ~(on_lower | (at.within[1] <= -step))


GOAL = 1e-6  # of a linear solve in such a step, if it is iterative
# of rounding of a row, up to which w is 0: free rows amplify the rounding of the data
FLOORS = 64.0


class ActiveRows(NamedTuple):
    """Classification of the rows of a solution; every row is in one of the first four sets.

    Attributes
    ----------
    free, at_lower, at_upper, degenerate : ndarray of bool, shape (n,)
        Free rows are strictly between their bounds. Rows at a bound have w ≠ 0, or equal bounds. Degenerate rows are
        at a bound with w = 0, up to rounding of the data.
    is_upper : ndarray of bool, shape (n,)
        True if a row that is not free is at its upper bound.
    z : ndarray, shape (n,)
        The solution, solved again on the free rows.
    system : FreeSystem or None
        The solved system, its rows `free` and perhaps `degenerate`.
    """

    free: BoolVector
    at_lower: BoolVector
    at_upper: BoolVector
    degenerate: BoolVector
    is_upper: BoolVector
    z: Vector
    system: FreeSystem | None


@np.errstate(all="ignore")
def settled_rows(
    problem: LCP, z: Vector, w: Vector, system: FreeSystem | None = None
) -> ActiveRows:
    """Return the classification of the rows, after steps of the active-set method in twice the working precision.

    If the steps fail (the block of the free rows is singular) the rows are classified by the arguments z and w.

    Parameters
    ----------
    z, w : array, shape (n,)
        A solution within some tolerance, and its slack.
    system : FreeSystem, optional
        System of a problem with the same M, which is reused if the free rows are the same.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> rows = settled_rows(problem, np.array([2.5 + 1e-9, 0.0]), np.array([2e-9, 3.5 + 1e-9]))
    >>> rows.free, rows.at_lower, rows.z
    (array([ True, False]), array([False,  True]), array([2.5, 0. ]))
    """
    settled = _settled(problem, z, system)
    within, error = np.stack([z - problem.lower, problem.upper - z]), np.zeros(problem.n)
    if settled is None:
        system = None
    else:
        at, system, error = settled
        z, w, within = at.high, at.w, at.within
    scale, data = problem.residual_scale, row_data(problem)
    floor = data.rounding_floor(data.rows(z).terms)
    # by a tiny diagonal entry no row moves z_i
    near = floor * np.minimum(scale / problem.matrix.row_largest, 1.0)
    if (has_no_diagonal := problem.diagonal == 0.0).any():
        # a multiplier, without a unit in common with its row: it is 0 if the rows that it enters see only rounding
        columns = sp.csr_array(abs(problem.matrix.csr).T)
        seen = largest_products(columns, 1.0 / (floor * scale))
        near = np.where(has_no_diagonal & (seen > 0.0), 1.0 / seen, near)
    near = near + error
    slight = floor + abs(problem.matrix.array) @ error / scale
    is_fixed, step = problem.lower == problem.upper, w / scale
    degenerate = (within.min(axis=0) <= FLOORS * near) & (np.abs(step) <= FLOORS * slight)
    degenerate &= ~is_fixed
    above, below = within
    is_upper = np.where(is_fixed, w < 0.0, below < above)
    reaches = np.where(is_upper, below <= -step, above <= step)
    held = is_fixed | (reaches & ~degenerate)
    sets = ~(held | degenerate), held & ~is_upper, held & is_upper, degenerate
    return ActiveRows(*sets, is_upper, z, system)


def _settled(
    problem: LCP, z: Vector, system: FreeSystem | None
) -> tuple[RowInequality, FreeSystem, Vector] | None:
    """Return a point whose rows solve their equations, the system, and an error estimate.

    The result is None if the steps do not converge. Rows that are exactly degenerate may change sides indefinitely,
    by the rounding of other rows; the point then does not change with their side.
    """
    steps = ActiveSetSteps(problem, goal=GOAL, system=system)
    at, change, allowed = RowInequality.at(problem, z), np.zeros(0), 0.0
    for _ in range(8):  # from a solved problem one or two steps settle all rows
        before, following = steps.system, steps.next_point(at)
        if following is None:  # a row on the edge made the block singular
            is_solved = bool(change.size) and GOAL * change.max(initial=0.0) <= allowed
            return (at, before, GOAL * change) if is_solved else None
        change, at = np.abs((following.high - at.high) + (following.low - at.low)), following
        allowed = 1e-14 * max_norm(at.high)  # all digits
        if steps.is_settled(at) and GOAL * change.max(initial=0.0) <= allowed:
            return at, steps.system, GOAL * change
    return (at, steps.system, GOAL * change) if change.max(initial=0.0) <= allowed else None


def free_rows(problem: LCP, z: Vector, w: Vector) -> BoolVector:
    """Return the mask of rows between their bounds according to z and its slack w, shape (n,)."""
    target = z - w / problem.residual_scale
    return (target > problem.lower) & (target < problem.upper)


def estimated_error(problem: LCP, z: Vector, w: Vector, residual: float) -> float | None:
    """Return an estimate of the largest ‖z − z*‖∞ that goes with a scaled residual, or None if it is too costly.

    Parameters
    ----------
    problem : LCP
    z, w : arrays, shape (n,)
        A point and its slack.
    residual : float
        ‖r(z)‖∞, in the unit of z.

    Examples
    --------
    >>> problem = LCP([[1, -1 + 2**-30], [-1 + 2**-30, 1]], [-1, -1])
    >>> z = np.full(2, 2.0**30)
    >>> round(estimated_error(problem, z, problem.slack(z), 1e-8), 6)
    10.737418
    """
    from scipy.linalg import lapack

    free = np.flatnonzero(free_rows(problem, z, w))
    if residual == 0.0 or not free.size:
        return 0.0
    if not 0.0 < residual < np.inf or free.size > 500:  # free rows: a few milliseconds
        return None
    block = problem.M[free][:, free]
    block = (block.toarray() if sp.issparse(block) else block) / problem.residual_scale[free, None]
    if not np.isfinite(block).all():
        return None
    norm = float(np.abs(block).sum(axis=1).max())
    reciprocal = norm * lapack.dgecon(lapack.dgetrf(block)[0], norm, norm="I")[0]
    return residual / reciprocal if reciprocal > 0.0 else np.inf


SPARSE_UP_TO = 30_000  # rows of a sparse matrix that is factorized for a bound


class EigenvalueBound(NamedTuple):
    """λ ≤ the smallest eigenvalue of C (M + Mᵀ)/2 C, C = diag(scale), powers of two."""

    value: float
    scale: Vector


#: Proof behind an error bound: v with ⟨M⟩v > 0 of an M with a positive diagonal, or λ.
BoundProof = HCertificate | EigenvalueBound


def bound_of_error(at: RowInequality, family: BoundProof) -> Vector:
    """Return a bound of |z − z*|, shape (n,), by the least t v or by the 2-norm."""
    if isinstance(family, HCertificate):
        return product_above(at.inflation(family), family.v)
    y = two_norm_bound(at, family)
    return np.minimum(y, at.image(y))


@fact
def smallest_eigenvalue_bound(matrix: Matrix) -> EigenvalueBound | None:
    """Return a lower bound of the smallest eigenvalue of M's symmetric part after equilibration, kept with M.

    Returns
    -------
    EigenvalueBound or None
        None if no positive bound can be proven.

    Notes
    -----
    C (M + Mᵀ)/2 C less a share of its smallest eigenvalue is factorized; a successful factorization proves a
    bound, less the margin for its rounding. Dense: LAPACK's Cholesky, n ≤ 3000. Sparse: LU with diagonal pivots,
    n ≤ 30 000, where its fill is bounded.

    References
    ----------
    S. M. Rump, *Verification of positive definiteness*, BIT 46 (2006), doi:10.1007/s10543-006-0056-1.

    Examples
    --------
    >>> bound = smallest_eigenvalue_bound(Matrix([[4.0, 2.0], [2.0, 4.0]]))
    >>> 0.45 < bound.value <= 0.5
    True
    """
    diagonal = matrix.diagonal
    if not (diagonal > 0.0).all() or matrix.n == 0:
        return None
    exponents = unit_diagonal(diagonal)
    scale = np.ldexp(1.0, exponents.row)
    is_dense = matrix.n <= (3000 if matrix.is_dense else 200)
    if not is_dense and matrix.n > SPARSE_UP_TO:
        return None
    value = _proven_bound(scale_matrix(matrix.csr.toarray() if is_dense else matrix.csr, exponents))
    return None if value is None else EigenvalueBound(value, scale)


def two_norm_bound(at: RowInequality, eigenvalue: EigenvalueBound) -> Vector:
    """Return y with |z − z*| ≤ y, shape (n,), if `eigenvalue` holds."""
    problem = at.problem
    inverse_step = np.exp2(np.clip(np.round(np.log2(problem.diagonal)), -1000.0, 1000.0))
    # Both bounds of each r_i; at a bound, with w_i of the right sign, they are equal for any rounding of w_i.
    steps = np.minimum(quotient_above(at.slack, inverse_step), at.within)
    residual, negative = np.maximum(steps, at.beyond)
    width = np.maximum(sum_above(residual, negative), 0.0)
    if not (residual.any() or width.any()):
        return np.zeros(problem.n)
    transpose = sp.csr_array(problem.csr.T)
    value, radius = compensated_product(transpose, residual, residual * inverse_step)
    spread, spread_radius = compensated_product(abs(transpose), width, width * inverse_step)
    size = sum_above(sum_above(np.abs(value), radius), sum_above(spread, spread_radius))
    size = sum_above(size, 4.0 * TINY)  # products may have underflowed
    labels, even = connected_components(problem.matrix), product_above(eigenvalue.scale, size)
    labels = np.zeros(problem.n, np.int64) if labels is None else labels
    norm = norms_above(even, labels)[labels]
    bound = product_above(eigenvalue.scale, quotient_above(norm, np.float64(eigenvalue.value)))
    return np.where(np.isnan(bound), np.inf, bound)


def norms_above(x: Vector, labels: Array) -> Vector:
    """Return a double above ‖x_P‖₂, x ≥ 0, for each set P of entries with one label; also with underflow."""
    largest = np.zeros(int(labels.max(initial=-1)) + 1)
    np.maximum.at(largest, labels, x)
    is_usual = (largest > 0.0) & np.isfinite(largest)
    unit = np.exp2(np.floor(np.log2(np.where(is_usual, largest, 1.0))))
    squares = np.bincount(labels, (x / unit[labels]) ** 2, largest.size) * OUTWARD
    squares += x.size * UNDERFLOW
    return np.where(is_usual, unit * np.sqrt(squares) * OUTWARD, largest)


def _proven_bound(even: Any) -> float | None:
    """Return a share of the smallest eigenvalue of (A + Aᵀ)/2 that is proven to be below it, or None."""
    part = 0.5 * (even + even.T)
    # of its eigenvalues' rounding, ∞ after overflow
    entry_rounding = 2.0 * UNIT * float(abs(part).sum(axis=1).max()) + part.shape[0] * UNDERFLOW
    if not np.isfinite(entry_rounding) or (sp.issparse(part) and not factor_fits(part)):
        return None
    factor = positive_factor(part)
    if factor is None:
        return None
    # The Rayleigh quotient of a vector near the lowest eigenvector, an upper bound except for rounding
    x = np.random.default_rng(0).standard_normal(part.shape[0])
    for _ in range(30):  # an estimate, which is proved afterwards
        x = factor.solve(x / np.linalg.norm(x))
    estimate = float(x @ (part @ x) / (x @ x))
    identity = (sp.eye_array if sp.issparse(part) else np.eye)(part.shape[0])
    for share in (0.95, 0.5, 0.1):  # the first shift that a factorization proves
        shift = share * estimate
        shifted = part - shift * identity
        factor = positive_factor(shifted)
        if factor is not None:
            rounding = factor_rounding(shifted, factor) + 2.0 * UNIT * (
                part.diagonal().max() + shift
            )
            value = (shift - rounding - entry_rounding) / OUTWARD
            if value > 0.0:
                return float(value)
    return None


NO_PROOF = (
    "an error bound needs an H₊-matrix (⟨M⟩v > 0 for some v > 0, positive diagonal) or a positive definite symmetric "
    "part, and M was not proven to have either; Certificate.of(problem, z) has the residuals"
)


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """A bound of |z − z*|, the distance from z to the solution.

    Attributes
    ----------
    componentwise : ndarray, shape (n,)
        |z_i − z*_i| ≤ componentwise_i, in the unit of z.
    infinity : float
        Their maximum, ‖z − z*‖∞ ≤ infinity.
    relative : float
        ‖z − z*‖∞ ≤ relative · ‖z‖∞, in every component of the problem by itself; ∞ if z = 0 there and z* = 0 is not
        proved.
    method : str
        "v-certificate", "reference point" or "2-norm, λ_min", whichever gave `infinity`.
    residual : float
        ‖r(z)‖∞, the numerator of the relative residual: in the unit of z, as `infinity` is.
    near : NearPoint or None
        The point near z* at which most is known; None if nothing is.
    seconds : float
        Seconds that it took to compute.
    """

    componentwise: Vector = field(repr=False)
    infinity: float
    relative: float
    method: str
    residual: float = np.nan
    near: NearPoint | None = field(default=None, repr=False)
    seconds: float = field(default=0.0, repr=False)

    def carried_to(self, z: Vector) -> Vector:
        """Return a bound of |z − z*|, componentwise, for any z of shape (n,): by its distance to `near`, in O(n).

        Examples
        --------
        >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
        >>> bound = error_bound(problem, [2.5 + 1e-6, 0])
        >>> bool(0.999e-3 <= bound.carried_to(np.array([2.5 + 1e-3, 0.0])).max() <= 1.001e-3)
        True
        """
        return np.full(z.shape, np.inf) if self.near is None else self.near.bound_at(z)

    def __str__(self) -> str:
        return f"‖z − z*‖∞ ≤ {self.infinity:.3e}, relative {self.relative:.3e} ({self.method})"


@np.errstate(all="ignore")
def error_bound(problem: LCP, z: ArrayLike, *, sharp: bool = True) -> ErrorBound:
    """Return a bound of |z − z*|, componentwise, for the unique solution z*.

    Parameters
    ----------
    problem : LCP
        M an H₊-matrix, or with a positive definite symmetric part: then z* exists and is unique.
    z : array, shape (n,)
        Any point, also outside the bounds. With NaN or infinite entries the bound is ∞.
    sharp : bool
        False: only the v-certificate (or the 2-norm bound), one pass over M once the matrix is known. True: also the
        stages that solve linear systems; the least of all counts.

    Raises
    ------
    InvalidProblem
        If `problem` is not an LCP or z not a real vector of length n.
    InvalidOption
        If `sharp` is neither True nor False.
    UnsuitableMatrix
        If M is neither proven H₊ nor proven positive definite.

    Notes
    -----
    Rigorous in floating point: the only assumption is that M, q and the bounds are the stored doubles.

    References
    ----------
    X. Chen, S. Xiang, *Computation of error bounds for P-matrix linear complementarity problems*, Math. Program. 106
    (2006), doi:10.1007/s10107-005-0645-9 (the classical bounds that these sharpen).

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> bound = error_bound(problem, [2.5 + 1e-6, 0])
    >>> 1e-6 <= bound.infinity < 1.001e-6
    True
    """
    if not isinstance(problem, LCP):
        raise InvalidProblem(refusal("error_bound", problem))
    if not isinstance(sharp, bool | np.bool_):
        raise InvalidOption(f"sharp must be True or False, got {sharp!r}")
    z, clock = checked_vector(z, "z", problem.n, is_finite=False), deadline.Clock()
    is_positive = bool(np.all(problem.diagonal > 0.0))
    family: BoundProof | None = comparison_certificate(problem.matrix) if is_positive else None
    if family is None and (family := smallest_eigenvalue_bound(problem.matrix)) is None:
        raise UnsuitableMatrix(NO_PROOF)
    method = "2-norm, λ_min" if isinstance(family, EigenvalueBound) else "v-certificate"
    if np.isfinite(z).all():
        at, largest = RowInequality.at(problem, z), row_data(problem).largest
        y = first = bound_of_error(at, family)
        near = NearPoint(z, at.low, y)
        if sharp:
            y, near = _sharpened(at, y, family)
            method = "reference point" if max_norm(y) < max_norm(first) else method
        y = np.where(np.isnan(y), np.inf, y)
        relative = float(quotient_above(largest(y), largest(np.abs(z))).max())
        residual = max_norm(scaled_residual(problem, z, at.w))
        bound = ErrorBound(y, max_norm(y), relative, method, residual, near)
    else:
        bound = ErrorBound(np.full(problem.n, np.inf), np.inf, np.inf, method)
    return replace(bound, seconds=clock.read())


def _sharpened(at: RowInequality, y: Vector, family: BoundProof) -> tuple[Vector, NearPoint]:
    """Return a bound of the error of `at`, and a point nearer to z*; steps follow while they lower the bound."""
    steps, point, near = ActiveSetSteps(at.problem), at, NearPoint(at.high, at.low, y)
    is_large = y.size > CHEAP_UP_TO
    for _ in range(12):  # each takes two digits off the bound, and a third of a linear solve
        if (following := steps.next_point(point)) is None:
            break
        point, bound = following, bound_of_error(following, family)
        bound = np.minimum(bound, point.image(bound))
        before = near.y.max(initial=0.0)
        if bound.max(initial=0.0) < 0.5 * before:
            near = NearPoint(point.high, point.low, bound)
            y = np.minimum(y, near.bound_at(at.high))
            if is_large and near.is_sharp(at.high, y):
                break
        # A step of the active-set method may lead astray before it leads home.
        elif is_large or before == 0.0 or near.is_sharp(at.high, y):
            break
    return y, near


UNKNOWN = "P could not be shown to be positive semidefinite"


@dataclass(frozen=True, eq=False)
class Curvature:
    """Weights μ for which xᵀP x ≥ Σ μ_i x_i² holds for every x.

    Attributes
    ----------
    weights : ndarray, shape (n,)
        −∞ if nothing is known.
    indefinite : str
        Why P is certainly not positive semidefinite, or nothing.
    penalty : float
        ρ: the weights are a lower bound of xᵀP x + ρ‖A x‖² for every x.
    """

    weights: Vector
    indefinite: str = ""
    penalty: float = 0.0

    @property
    def is_semidefinite(self) -> bool:
        """True if P, or P on the null space of A, is proved to be positive semidefinite."""
        return bool((self.weights >= 0.0).all())

    @property
    def evidence(self) -> str:
        """Description of the result about P."""
        if self.is_semidefinite:
            where = " on the null space of A" if self.penalty else ""
            return f"P is positive {'definite' if (self.weights > 0.0).all() else 'semidefinite'}{where}"
        if np.isfinite(self.weights).all():
            return f"P is positive semidefinite only to rounding, λ_min ≥ {self.weights.min():.1e}"
        return self.indefinite or UNKNOWN


def curvature(P: AnyMatrix) -> Curvature:
    """Return the largest weights that can be proved at the cost of two factorizations.

    Parameters
    ----------
    P : ndarray or CSR array, shape (n, n)
        Exactly symmetric.

    Examples
    --------
    >>> curvature(np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 3.0]])).weights.round(2)
    array([0.95, 0.95, 3.  ])
    >>> curvature(np.array([[1.0, 1.0], [1.0, 1.0]])).evidence
    'P is positive semidefinite'
    >>> curvature(np.array([[1.0, 2.0], [2.0, 1.0]])).evidence
    'P has a negative eigenvalue'
    """
    from scipy.sparse.csgraph import connected_components  # slow to import

    rows = sp.csr_array(P)
    weights = np.array(rows.diagonal())
    if (weights < 0.0).any():
        i = int(weights.argmin())
        return Curvature(np.full(weights.size, -np.inf), f"P[{i}, {i}] = {weights[i]:g}")
    for block in block_rows(connected_components(rows, directed=False)[1]):
        if block.size == 1:
            continue
        part = -np.inf if deadline.is_over() else _weights(sp.csr_array(rows[block][:, block]))
        if part is None:
            return Curvature(np.full(weights.size, -np.inf), "P has a negative eigenvalue")
        weights[block] = part
    return Curvature(weights)


def constrained_curvature(P: AnyMatrix, A: AnyMatrix) -> Curvature:
    """Return the curvature of P, or of P + ρ AᵀA if only this matrix is definite.

    Parameters
    ----------
    P, A : arrays or CSR arrays, shapes (n, n) and (p, n)

    Examples
    --------
    >>> curved = constrained_curvature(np.diag([0.0, 2.0]), np.array([[1.0, -1.0]]))
    >>> curved.evidence, curved.penalty
    ('P is positive definite on the null space of A', 2.0)
    """
    of_P, rows = curvature(P), sp.csr_array(A)
    if of_P.indefinite or (of_P.weights > 0.0).all() or not rows.nnz or deadline.is_over():
        return of_P
    rank = np.count_nonzero(np.diff(sp.csr_array(P).indptr))  # at most, without A
    if rank + rows.shape[0] < of_P.weights.size:
        return of_P
    square = sp.csr_array(rows.T @ rows)
    size_of_P, size_of_A = (float(np.max(X.diagonal(), initial=0.0)) for X in (P, square))
    # the squares underflow
    if size_of_A == 0.0 or size_of_P / size_of_A == np.inf:
        return of_P
    ratio = size_of_P / size_of_A
    penalty = float(np.exp2(np.round(np.log2(ratio)))) if ratio > 0.0 else 1.0
    form = sp.csr_array(P + penalty * square)
    form = sp.csr_array((form + form.T) * 0.5)
    if not np.isfinite(form.data).all():
        return of_P
    of_form = curvature(form)
    # An entry's rounding error is below γ (|P| + ρ|A|ᵀ|A|), and a matrix is below the diagonal matrix of its row sums.
    ones, magnitude = np.ones(of_P.weights.size), abs(rows)
    size = abs(sp.csr_array(P)) @ ones + penalty * (magnitude.T @ (magnitude @ ones))
    weights = of_form.weights - 2.0 * gamma(rows.shape[0] + 8) * size - UNDERFLOW * (1.0 + penalty)
    return Curvature(weights * (1.0 - 2.0**-50), penalty=penalty) if (weights > 0.0).all() else of_P


def _weights(P: sp.csr_array) -> Vector | None:
    """Return the weights of a block that does not fall apart; None if it is proved to be indefinite."""
    bound = smallest_eigenvalue_bound(Matrix(P))
    if bound is not None:
        return np.asarray(bound.value / bound.scale / bound.scale)
    dominance = lower_end(*comparison_product(P, np.ones(P.shape[0])))
    if (dominance >= 0.0).all():
        return dominance
    # Exact elimination of 40 rows takes a tenth of a second, of 60 six times as long
    if P.shape[0] <= 40 and exact.has_nonnegative_pivots(exact.exact_symmetric_part(P)):
        return np.zeros(P.shape[0])
    to_rounding = is_semidefinite_to_rounding(P)
    if to_rounding is not True:
        return None if to_rounding is False else np.full(P.shape[0], -np.inf)
    diagonal = np.array(P.diagonal())
    unit = sp.csr_array(sp.diags_array(np.where(diagonal > 0.0, 1.0, 0.0)))
    # More than the rounding of a margin of a few operations
    return np.asarray(-semidefinite_margin(unit) * (1.0 + 2.0**-40) * diagonal)
