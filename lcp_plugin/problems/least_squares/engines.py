"""Points of a least squares problem within bounds by lstsq, nnls and PIQP, solved on their faces.

A column with a penalty that may take both signs is split, x = x⁺ − x⁻, and a ridge is more rows, √ridge I:

    min ½‖E z − b‖² + slopesᵀz  subject to  lower ≤ z ≤ upper.

PIQP takes the program with r = E z − b if A is sparse. If A is dense and not wide, PIQP takes the normal equations. If
A is dense and wide, PIQP takes the dual min ½‖y‖² + bᵀy with −Eᵀy ≤ slopes (for z ≥ 0; z is its multiplier). The
condition number of the first and the last form is the condition number of A.

Points of a least squares problem within bounds, and steps that need only products with A and Aᵀ.

Projected gradients take the step lengths of Barzilai and Borwein until the face settles, conjugate gradients solve on
it: a product with A and one with Aᵀ per iteration; AᵀA is never formed. Measured in comparison on random
sparse, dense, ill-conditioned, blurring, difference and wide matrices: accelerated gradients with restarts need
1.3 – 8 times as many products, MPRGP .7 – 3 times, the projected steps alone 1 – 15 times.

References
----------
E. G. Birgin, J. M. Martínez, M. Raydan, *Nonmonotone spectral projected gradient methods on convex sets*,
SIAM J. Optim. 10 (2000), doi:10.1137/S1052623497330963. W. W. Hager, H. Zhang, *A new active set algorithm for box
constrained optimization*, SIAM J. Optim. 17 (2006), doi:10.1137/050635225.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core import deadline
from ...core.checks import AnyMatrix, Array, BoolVector, Indices, Vector
from ...core.entries import clip
from ...core.kernels.floats import DATA_ROUNDING, EPSILON, FEW_ROUNDINGS
from ...core.tuning import DENSE_OPERATIONS, SPARSE_OPERATIONS
from ...engines import engine_class, is_installed
from ...engines.engine import EnginePoint, ProgramData, SolverLimits
from ...engines.polish import polish_steps
from ...systems.minimum_degree import factor_sizes
from .data import BoundedLeastSquares, ScaledLeastSquares, shortest_solution

NamedPoints = Iterator[tuple[str, Vector]]  # each with the name of its solver


class FacePoint:
    """A point within the bounds.

    Parameters
    ----------
    problem : ScaledLeastSquares
    x : array, shape (n,)
        Within the bounds.
    residual : array, shape (m,), optional
        A x − b if it is known.

    Attributes
    ----------
    slope : ndarray, shape (n,)
        Aᵀ(A x − b) + ridge x.
    gradient : ndarray, shape (n,)
        `slope` plus the gradient of the penalty l1 in the problem's orthant.
    """

    def __init__(self, problem: ScaledLeastSquares, x: Vector, residual: Array = None) -> None:
        self.problem, self.x = problem, x
        self.residual = problem.product(x) - problem.b if residual is None else residual
        self.slope = problem.apply_transpose(self.residual) + problem.ridge * x
        self.gradient = self.slope + problem.linear

    @cached_property
    def cost(self) -> float:
        """Cost function at x."""
        quadratic = self.residual @ self.residual + (self.problem.ridge * self.x) @ self.x
        return float(0.5 * quadratic + self.problem.l1 @ np.abs(self.x))

    @cached_property
    def is_free(self) -> BoolVector:
        """Mask of the columns strictly between their bounds."""
        return (self.x > self.problem.lower) & (self.x < self.problem.upper)

    @cached_property
    def free_gradient(self) -> Vector:
        """The gradient on the free columns, 0 elsewhere."""
        return np.where(self.is_free, self.gradient, 0.0)

    @cached_property
    def pull(self) -> Vector:
        """Gradient of the columns that it pulls away from their bounds into the box, 0 elsewhere."""
        may_rise, may_fall = self.x < self.problem.upper, self.x > self.problem.lower
        rising, falling = np.minimum(self.gradient, 0.0), np.maximum(self.gradient, 0.0)
        inward = np.where(may_rise, rising, np.where(may_fall, falling, 0.0))
        return np.where(self.is_free, 0.0, inward)

    @cached_property
    def natural_residual(self) -> Vector:
        """Difference x − mid(lower, upper, x − gradient): 0 exactly at the minimum."""
        return clip(self.gradient, self.x - self.problem.upper, self.x - self.problem.lower)

    @cached_property
    def pull_across(self) -> float:
        """Largest pull on a column at 0 to the side outside the problem's orthant; 0 without such a pull."""
        problem = self.problem
        at_kink = problem.has_kink & (self.x == 0.0)
        across = np.where(problem.upper == 0.0, -self.slope, self.slope) - problem.l1
        return float(np.max(across, initial=0.0, where=at_kink))

    @property
    def residual_in_orthant(self) -> float:
        """The largest natural residual."""
        return float(np.abs(self.natural_residual).max(initial=0.0))

    @property
    def gradient_rounding(self) -> float:
        """Size of a gradient that may be only rounding."""
        norms = map(np.linalg.norm, (self.residual, self.x, self.problem.b))
        return FEW_ROUNDINGS * float(sum(norms))

    def curvature(self, direction: Vector, product: Vector) -> float:
        """Return dᵀ(AᵀA + ridge)d for a direction d and A d."""
        return float(product @ product + (self.problem.ridge * direction) @ direction)

    def move(self, direction: Vector, product: Vector, length: float) -> FacePoint:
        """Return the point at x + length · direction, which is within the bounds except for rounding."""
        x = clip(self.x + length * direction, self.problem.lower, self.problem.upper)
        return FacePoint(self.problem, x, self.residual + length * product)

    def farthest(self, direction: Vector) -> float:
        """Return the largest step length along the direction within the bounds."""
        bound = np.where(direction > 0.0, self.problem.upper, self.problem.lower)
        slack = (bound - self.x) / direction
        return float(np.min(slack, initial=np.inf, where=direction != 0.0))

    def rise(self, direction: Vector, product: Vector) -> float:
        """Return by how much the cost rises at x + d, of d and A d; costs themselves would cancel."""
        return float(self.gradient @ direction) + 0.5 * self.curvature(direction, product)

    def project(self, direction: Vector, product: Vector) -> FacePoint:
        """Return the better of x + direction, projected onto the bounds, and the first bound on the way there."""
        length = min(self.farthest(direction), 1.0)
        bent = clip(self.x + direction, self.problem.lower, self.problem.upper) - self.x
        bent_product = self.problem.product(bent)
        if self.rise(bent, bent_product) < self.rise(length * direction, length * product):
            return self.move(bent, bent_product, 1.0)
        return self.move(direction, product, length)


def projected_steps(start: FacePoint) -> Iterator[FacePoint]:
    """Yield points of an orthant, then of the orthant to which columns at 0 are pulled, until no column is pulled.

    In an orthant Σ l1 |x| is linear. Cost falls from orthant to orthant: a solved orthant does not come back.
    """
    point = start
    while True:
        orthant = start.problem.whole.orthant(point.x, point.slope)
        for point in steps_in_orthant(FacePoint(orthant, point.x, point.residual)):  # noqa: B020 - each orthant begins at the last point
            yield point
            pull = point.pull_across
            # A smaller residual in the orthant is not worth a step
            if pull > point.gradient_rounding and 0.1 * pull > point.residual_in_orthant:
                break
        if not point.pull_across > max(point.gradient_rounding, point.residual_in_orthant):
            return


def steps_in_orthant(start: FacePoint) -> Iterator[FacePoint]:
    """Yield the start and the following points; end when no step makes progress."""
    yield start
    point, length = start, _cauchy_length(start)
    while length > 0.0 and point.natural_residual.any():
        point, length = yield from _spectral_steps(point, length)
        is_on = True
        while is_on:  # conjugate gradients on a face, then on the next face, until columns at a bound pull harder
            point, is_on = yield from _steps_on_face(point)


def _cauchy_length(point: FacePoint) -> float:
    """Return the length that minimizes along the projected gradient; 0 if the curvature is not positive."""
    direction = point.free_gradient + point.pull
    curvature = point.curvature(direction, point.problem.product(direction))
    return float(direction @ direction) / curvature if curvature > 0.0 else 0.0


def _spectral_steps(
    point: FacePoint, length: float
) -> Generator[FacePoint, None, tuple[FacePoint, float]]:
    """Take projected gradient steps until the face hardly changes; return the last point and step length."""
    # A projected step has to undercut the largest of ten costs
    costs, settled = deque([point.cost], maxlen=10), 0
    while settled < 2:  # steps in a row that hardly change the face
        problem = point.problem
        direction = clip(point.x - length * point.gradient, problem.lower, problem.upper) - point.x
        product = problem.product(direction)
        slope, curvature = float(point.gradient @ direction), point.curvature(direction, product)
        if not (slope < 0.0 < curvature):  # any further gain is at rounding level
            return point, 0.0
        share = 1.0
        # A step keeps a small share of the slope
        if point.cost + slope + 0.5 * curvature > max(costs) + 1e-4 * slope:
            share = min(1.0, -slope / curvature)
        after = point.move(direction, product, share)
        length = float(direction @ direction) / curvature
        changes = np.count_nonzero(after.is_free != point.is_free)
        # Conjugate gradients pay before the face has settled completely
        settled = settled + 1 if changes <= 0.01 * problem.n else 0
        point = after
        costs.append(point.cost)
        yield point
    return point, length


def _steps_on_face(point: FacePoint) -> Generator[FacePoint, None, tuple[FacePoint, bool]]:
    """Take conjugate gradient steps on one face; return the last point, and whether a bound stopped a later step."""
    direction, steps = -point.free_gradient, 0
    size = float(direction @ direction)
    while size > 0.0 and float(point.pull @ point.pull) <= size:
        product = point.problem.product(direction)
        curvature = point.curvature(direction, product)
        if not curvature > 0.0:
            break
        length = size / curvature
        if length > point.farthest(direction):
            point = point.project(length * direction, length * product)
            yield point
            return point, steps > 0
        point, steps = point.move(direction, product, length), steps + 1
        yield point
        before, size = size, float(point.free_gradient @ point.free_gradient)
        direction = (size / before) * direction - point.free_gradient
    return point, False


NORMAL_EQUATIONS = "normal equations"
FACTORS = 20  # that PIQP makes, about


def is_within_reach(problem: ScaledLeastSquares) -> bool:
    """Return whether PIQP, which cannot be stopped, is predicted to end in the remaining time."""
    # A minute, if there is no limit
    whole, (m, n), seconds = problem.problem, problem.problem.shape, min(deadline.left(), 60.0)
    if whole.is_small:
        return True
    if whole.is_dense:
        return bool(FACTORS * min(m, n) ** 2 * max(m, n) < seconds * DENSE_OPERATIONS)
    A = problem.matrix(is_dense=False)
    # A microsecond for each entry of a sparse A with little fill
    if FACTORS * 1e-6 * (A.nnz + m + n) > seconds:
        return False
    both = sp.csr_array(sp.block_array([[None, A], [A.T, None]]))
    most = seconds / FACTORS * SPARSE_OPERATIONS
    return bool(factor_sizes(both, 1e8, most)[0] < np.inf)  # entries of a factorization


def engine_points(problem: ScaledLeastSquares) -> NamedPoints:
    """Yield points x within the bounds by the solvers that suit the problem."""
    is_dense = problem.problem.is_dense or problem.problem.is_small
    if is_dense and problem.ridge.all() and problem.has_no_corner:
        yield NORMAL_EQUATIONS, ridge_solution(problem)
    A, b = problem.rows(is_dense=is_dense)
    if not is_dense:
        if is_installed("piqp"):
            yield from (("piqp", x) for x in Split.of(problem, A).solve_residual_form(b))
        return
    for name, x in _dense_solutions(problem, A, b):
        if np.isfinite(x).all():
            point = FacePoint(problem, clip(x, problem.lower, problem.upper))
            yield name, minimize_on_face(point, A, b).x


def _dense_solutions(problem: ScaledLeastSquares, A: Vector, b: Vector) -> NamedPoints:
    """Yield solutions x, the cheapest first."""
    if problem.has_no_corner:
        yield "lstsq", shortest_solution(A, b)
    if is_for_nnls(problem.problem):
        yield "nnls", _solve_by_nnls(problem, A, b)
    if not is_installed("piqp"):
        return
    split = Split.of(problem, A)
    has_two = np.isfinite(split.lower) & np.isfinite(split.upper)
    if A.shape[0] <= A.shape[1] and not has_two.any():
        yield "piqp", split.solve_dual(b)
    yield "piqp", split.solve_normal_equations(b)
    yield from (("piqp", x) for x in split.solve_residual_form(b))
    yield "lstsq", shortest_solution(A, b)  # bounds may be far, and PIQP's point between them, too


def ridge_solution(problem: ScaledLeastSquares) -> Vector:
    """Return x without bounds and penalty, by the smaller of (AᵀA + D) and (A D⁻¹Aᵀ + I), D the ridge; NaN at failure.

    A second solve with the remaining gradient refines it.
    """
    from scipy.linalg import cho_factor, cho_solve

    A, ridge, x = problem.matrix(is_dense=True), problem.ridge, np.zeros(problem.n)
    is_wide = A.shape[0] < A.shape[1]
    half = (A / np.sqrt(ridge)).T if is_wide else A
    gram = half.T @ half  # a symmetric product, of half the operations
    gram.flat[:: len(gram) + 1] += 1.0 if is_wide else ridge
    try:
        factor = cho_factor(gram, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return np.full(problem.n, np.nan)
    for _ in range(2):
        pull = A.T @ (problem.b - A @ x) - ridge * x
        if is_wide:
            pull -= A.T @ cho_solve(factor, A @ (pull / ridge), check_finite=False)
            x = x + pull / ridge
        else:
            x = x + cho_solve(factor, pull, check_finite=False)
    return x


def is_for_nnls(problem: BoundedLeastSquares) -> bool:
    """Return whether each column of a small A has one bound, and no penalty."""
    is_small = problem.is_small and 0 < min(problem.shape) <= 600  # nnls frees one column at a time
    return bool(is_small and (problem.bounds_per_column == 1).all() and not problem.l1.any())


def nnls_point(problem: BoundedLeastSquares) -> Vector:
    """Return the solution by nnls, unscaled without weights and ridge; NaN if nnls fails."""
    if problem.weights is not None or problem.ridge > 0.0:
        scaled = problem.scaled
        return scaled.to_caller(_solve_by_nnls(scaled, *scaled.rows(is_dense=True)))
    A = problem.A.toarray() if problem.is_sparse else problem.A
    return _solve_by_nnls(problem, A, problem.b)


def _solve_by_nnls(problem: Any, A: Vector, b: Vector) -> Vector:
    """Return the solution within one bound per column, NaN if nnls fails."""
    from scipy.optimize import nnls

    is_below, n = np.isfinite(problem.lower), A.shape[1]
    sign, bound = np.ones(1), problem.lower
    if not is_below.all():
        sign, bound = np.where(is_below, 1.0, -1.0), np.where(is_below, bound, problem.upper)
        A = A * sign
    if bound.any():
        b = b - A @ (sign * bound)
    try:
        z = nnls(A, b, maxiter=10 * n)[0]
    except (RuntimeError, ValueError, np.linalg.LinAlgError):
        return np.full(n, np.nan)
    return np.asarray(bound + sign * z)


class Split(NamedTuple):
    """The problem of z; see the module."""

    E: AnyMatrix
    slopes: Vector
    lower: Vector
    upper: Vector
    kink: Indices

    @classmethod
    def of(cls, problem: ScaledLeastSquares, A: AnyMatrix) -> Split:
        """Return the split of A with the rows of its ridge; x is nearest to 0 in a column without entries."""
        kink, is_sparse = np.flatnonzero(problem.has_kink), sp.issparse(A)
        E = (sp.hstack if is_sparse else np.hstack)([A, -A[:, kink]])
        is_filled = np.bincount(A.indices, minlength=problem.n) > 0 if is_sparse else A.any(axis=0)
        lower = np.where(is_filled, problem.lower, problem.nearest_to_zero)
        upper = np.where(is_filled, problem.upper, problem.nearest_to_zero)
        # Relative to b and columns of size 1: x is 0
        slopes = np.minimum(np.append(problem.linear, problem.l1[kink]), 1e6)
        of_z = np.append(np.where(problem.has_kink, 0.0, lower), np.zeros(kink.size))
        return cls(E, slopes, of_z, np.append(upper, -lower[kink]), kink)

    def join_parts(self, z: Vector) -> Vector:
        """Return x."""
        z = clip(z, self.lower, self.upper)
        x = z[: z.size - self.kink.size].copy()
        x[self.kink] -= z[x.size :]
        return x

    def solve_normal_equations(self, b: Vector) -> Vector:
        """Return PIQP's x for min ½ zᵀEᵀE z + (slopes − Eᵀb)ᵀz, at the bounds that the multipliers show."""
        E, k = self.E, self.slopes.size
        none = np.zeros((0, k)), np.zeros(0)
        cost = self.slopes - E.T @ b
        z = _run_piqp(E.T @ E, cost, *none, *none, self.lower, self.upper)[1].x
        slope = E.T @ (E @ z) + cost
        z = np.where(slope > z - self.lower, self.lower, z)
        return self.join_parts(np.where(-slope > self.upper - z, self.upper, z))

    def solve_residual_form(self, b: Vector) -> Iterator[Vector]:
        """Yield PIQP's x for min ½‖r‖² + slopesᵀz with E z − r = b, polished and as returned."""
        m, k = self.E.shape
        P = sp.diags_array(np.repeat([0.0, 1.0], [k, m]), format="csr")
        E = sp.csr_array(sp.hstack([self.E, -sp.eye_array(m)]))
        none, free = (sp.csr_array((0, k + m)), np.zeros(0)), np.full(m, np.inf)
        bounds = np.append(self.lower, -free), np.append(self.upper, free)
        program, answer = _run_piqp(P, np.append(self.slopes, np.zeros(m)), *none, E, b, *bounds)
        if np.isfinite(answer.x).all():
            for point in (*polish_steps(program, answer), answer):
                yield self.join_parts(point.x[:k])

    def solve_dual(self, b: Vector) -> Vector:
        """Return x of the multipliers z of PIQP's y; no column may have two bounds."""
        has_lower, has_upper = np.isfinite(self.lower), np.isfinite(self.upper)
        is_bounded = has_lower | has_upper
        sign = np.where(has_upper, -1.0, 1.0)
        start = np.where(has_lower, self.lower, np.where(has_upper, self.upper, 0.0))
        unit = min(float(np.max(self.slopes, initial=0.0)), 1.0) or 1.0  # y is as small as slopes
        rows, right, m = -(self.E * sign).T, sign * self.slopes / unit, b.size
        free, cost = np.full(m, np.inf), b - self.E @ start
        inequalities = rows[is_bounded], right[is_bounded]
        equations = rows[~is_bounded], right[~is_bounded]
        answer = _run_piqp(unit * np.eye(m), cost, *inequalities, *equations, -free, free)[1]
        z = np.zeros(sign.size)
        z[is_bounded], z[~is_bounded] = np.split(answer.y, [np.count_nonzero(is_bounded)])
        z = np.where(is_bounded & (z <= right - rows @ answer.x), 0.0, z)
        return self.join_parts(start + sign * z)


def _run_piqp(*statement: Any) -> tuple[ProgramData, EnginePoint]:
    """Return the program, and PIQP's point at a tolerance at which a small l1 counts."""
    program = ProgramData(*statement)
    engine = engine_class("piqp")(eps_abs=1e-13, eps_rel=1e-13)
    return program, engine.solve(program, SolverLimits(deadline.left()))


def minimize_on_face(point: FacePoint, A: Vector, b: Vector) -> FacePoint:
    """Return the minimum on the face of the point, or on a nearby face of lower cost.

    A step leads towards the minimum on a face, by an orthogonal factorization, up to the bounds. Columns that the
    gradient pulls away from their bound, or from 0, are released first: all, or only the column with the strongest pull
    if the cost rises otherwise.
    """
    order = np.argsort(-np.abs(A).max(axis=1, initial=0.0), kind="stable")
    A, b, before = A[order], b[order], b""
    is_filled = A.any(axis=0)
    for _ in range(30):
        orthant = point.problem.whole.orthant(point.x, point.slope)
        point = FacePoint(orthant, point.x, point.residual)
        pull = np.where(is_filled, np.abs(point.pull), 0.0)
        pulled = pull > point.gradient_rounding
        for released in (pulled, pulled & (pull == pull.max(initial=0.0))):
            free = np.flatnonzero(is_filled & (point.is_free | released))
            face = free.tobytes() + orthant.linear[free].tobytes()
            if face == before or not free.size or deadline.is_over():
                return point
            after = _step_to_minimum(point, free, A, b)
            # A step may cost more, by rounding
            if after.cost <= (1.0 + 1e-12) * point.cost and (after.x != point.x).any():
                break
        else:
            return point
        point, before = after, face
    return point


def _step_to_minimum(point: FacePoint, free: Array, A: Vector, b: Vector) -> FacePoint:
    """Return the point after a step of the free columns; columns that depend on earlier columns are unchanged.

    The rows of A are sorted by size: Householder's factor with column pivots is stable row by row then (Cox and Higham
    1998, doi:10.1023/A:1022361023563).
    """
    from scipy.linalg import qr, solve_triangular

    Q, R, columns = qr(A[:, free], mode="economic", pivoting=True, check_finite=False)
    sizes = np.abs(np.diag(R))
    rank = int(np.count_nonzero(sizes > max(R.shape) * EPSILON * sizes[0]))
    Q, R, free = Q[:, :rank], R[:rank, :rank], free[columns[:rank]]
    x, linear = point.x.copy(), point.problem.linear[free]
    slant = solve_triangular(R, linear, trans=1, check_finite=False) if linear.any() else 0.0
    for _ in range(2):  # the second refines the first
        x[free] -= solve_triangular(R, Q.T @ (A @ x - b) + slant, check_finite=False)
    step = x - point.x
    if not np.isfinite(step).all():
        return point
    x = point.project(step, point.problem.product(step)).x
    noise, lower, upper = DATA_ROUNDING * np.abs(x).max(), point.problem.lower, point.problem.upper
    for bound in (lower, upper, 0.0):
        x = np.where(np.abs(x - bound) <= noise, bound, x)
    return FacePoint(point.problem, clip(x, lower, upper))
