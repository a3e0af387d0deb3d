r"""Points of a least squares problem within bounds by other people's engines: nnls of scipy, daqp, PIQP.

Every column is made of parts z, 0 ≤ z ≤ w: x = start ± z at a finite bound, the sum of one upwards and one downwards
where a column is free, or where its penalty has a kink at 0. With Ã, b̃ and the slopes c of the parts the problem is
min ½‖Ãz − b̃‖² + cᵀz, which nnls takes as it stands where all c are 0 and all w infinite. Its dual,

    min ½‖y‖² + b̃ᵀy + wᵀv  subject to  −Ãᵀy − v ≤ c, v ≥ 0,

has z as multipliers and y = Ãz − b̃ at the answer. It is a program for daqp and PIQP with the condition of A, not that
of AᵀA. A ridge is more rows, √ridge I. A dense A with more rows than columns is reduced to its triangle first.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, all_hold
from ...core.deadline import is_over, seconds_left
from ...core.kernels.floats import UNIT
from ...engines import Limits, Point, Statement
from ...engines.piqp import PIQP
from ...engines.polish import polished
from ...systems.factors import lapack
from .data import ROWS, BoundedLeastSquares, ScaledLeastSquares
from .enclosures import MOST_HIDDEN, NOTHING, OUTWARD, clipped
from .steps import FacePoint

NNLS_UP_TO = 600  # columns or rows, whichever are fewer: it frees one column at a time
PIQP_UP_TO = 1500  # the same of a dense A, of which it makes a dense factor
SOLVES = 2  # by one factor of a face
FACTORS = 20  # that PIQP makes, about
PATIENCE = 60.0  # seconds for that
SECONDS = 1e-6  # of one, an entry, row and column of a sparse A, where its factor hardly fills in
LARGEST_FILL = 1e8  # entries of a factor
FACES = 8  # one after the other
LARGEST = 2.0**200  # cost, or square of x, that sums of products do not underflow beside
STEPS = 10  # of nnls, times the number of columns


class Parts(NamedTuple):
    """The parts z of the columns of a problem; see the module.

    Attributes
    ----------
    columns : array of int, shape (parts,)
    signs, widths, slopes, ends : array, shape (parts,)
        The ends are x where only this part is, as wide as it may be.
    start : array, shape (n,)
        x where all parts are 0.
    """

    columns: Any
    signs: FloatVector
    widths: FloatVector
    slopes: FloatVector
    ends: FloatVector
    start: FloatVector

    @classmethod
    def of(cls, whole: ScaledLeastSquares, A: Any) -> Parts:
        """Return those of a problem; fixed and empty columns have none."""
        is_empty = (
            ~A.any(axis=0)
            if isinstance(A, np.ndarray)
            else np.bincount(A.indices, minlength=whole.n) == 0
        )
        lower, upper = (
            np.where(is_empty, whole.nearest_to_zero, bound) for bound in (whole.lower, whole.upper)
        )
        is_split = whole.has_kink & ~is_empty | ((lower == -np.inf) & (upper == np.inf))
        start = np.where(is_split, 0.0, np.where(np.isfinite(lower), lower, upper))
        up = np.flatnonzero((upper > start) & (is_split | np.isfinite(lower)))
        down = np.flatnonzero((lower < start) & (is_split | ~np.isfinite(lower)))
        falling = np.where(whole.has_kink, whole.l1, -whole.linear)
        return cls(
            np.concatenate([up, down]),
            np.repeat([1.0, -1.0], [up.size, down.size]),
            np.concatenate([(upper - start)[up], (start - lower)[down]]),
            np.concatenate([whole.linear[up], falling[down]]),
            np.concatenate([upper[up], lower[down]]),
            start,
        )

    def entries(self, A: Any) -> Any:
        """Return Ã."""
        chosen = A[:, self.columns]
        return (
            chosen * self.signs
            if isinstance(A, np.ndarray)
            else chosen @ sp.diags_array(self.signs)
        )

    def of_dual(self, dual: Statement, point: Point) -> FloatVector:
        """Return the multipliers z of a point of the dual, 0 or w where the slacks say so."""
        z = point.multipliers.inequality
        z = np.where(z > dual.h - dual.G @ point.x, z, 0.0)
        bounded = np.flatnonzero(self.widths < np.inf)
        past, most = point.x[point.x.size - bounded.size :], self.widths[bounded]
        z[bounded] = np.where(past > most - z[bounded], most, z[bounded])
        return z

    def point(self, z: FloatVector, problem: ScaledLeastSquares) -> FacePoint:
        """Return the point that is made of parts z, which has nothing but its residual to show."""
        z = clipped(z, np.zeros(z.size), self.widths)
        x, is_full = (
            self.start + np.bincount(self.columns, self.signs * z, self.start.size),
            z == self.widths,
        )
        x[self.columns[is_full]] = self.ends[is_full]
        return FacePoint(problem, clipped(x, problem.lower, problem.upper), dual=NOTHING)


def engine_points(problem: ScaledLeastSquares) -> Iterator[FacePoint]:
    """Yield what nnls and PIQP find, where they suit, solved on the face that they name."""
    m, n = problem.problem.shape
    is_dense = problem.problem.is_dense or problem.problem.is_cheap_to_copy
    if is_dense and min(m, n) > PIQP_UP_TO:
        return
    A, b = _rows(problem, is_dense=is_dense)
    if not (is_dense or _has_end_in_sight(A)):
        return
    parts = Parts.of(problem, A)
    if not parts.columns.size:
        yield FacePoint(problem, parts.start)
        return
    entries, right = parts.entries(A), b - A @ parts.start
    is_open = not (parts.widths < np.inf).any()
    if is_dense and not is_over():
        is_asked = min(m, n) <= NNLS_UP_TO and not parts.slopes.any()
        z = (
            _by_nnls(entries, right, is_asked=is_asked)
            if is_open
            else _by_bounds(parts, entries, right)
        )
        if np.isfinite(z).all():
            point = parts.point(z, problem)
            if is_open:  # nnls ends with a face solved by an orthogonal factor
                yield point
            yield on_its_face(point, A, b)
    if is_over():
        return
    if is_dense and A.shape[0] > A.shape[1]:
        entries, right = _triangle(entries, right)
    dual = dual_program(parts, entries, right)
    answer = _by_piqp(dual)
    for found in (answer,) if is_dense else polished(dual, answer):
        if np.isfinite(found.multipliers.inequality).all():
            point = parts.point(parts.of_dual(dual, found), problem)
            yield on_its_face(point, A, b) if is_dense else point
    for z in _with_small_slopes(parts, entries, right) if is_dense and is_open else ():
        yield on_its_face(parts.point(z, problem), A, b)


def nonnegative_as_given(
    problem: BoundedLeastSquares, tolerance: float
) -> tuple[FloatVector, FloatVector, FloatVector, float] | None:
    """Return x by nnls of a problem as it stands, with A x − b, y and optimality, if it is SOLVED; None otherwise.

    That is what the certificate says of y = A x − b, or of the part of that which is orthogonal to the columns at work.
    """
    A, b = problem.A, problem.b
    if not problem.is_nonnegative_alone or min(A.shape) > NNLS_UP_TO:
        return None
    x = _by_nnls(A, b, is_asked=True)
    with np.errstate(all="ignore"):
        if not x.dot(x) < LARGEST:
            return None
        residual, of_A = A @ x - b, np.abs(A)
        rounding = (2 * x.size + 8) * UNIT * (of_A @ x + np.abs(b))
        if not rounding.max(initial=0.0) ** 2 <= MOST_HIDDEN * np.square(b[b != 0.0]).min(
            initial=np.inf
        ):
            return None
        value = _nonnegative_optimality(A, of_A, x, residual, 0.0)
        if value <= tolerance:
            return x, residual, residual, value
        columns = A[:, x > 0.0]
        if not 0 < columns.shape[1] <= A.shape[0]:
            return None
        solved, info = lapack().dgels(columns, residual)[1:]
        y = residual - columns @ solved[: columns.shape[1]]
        off = np.maximum(np.abs(residual - y) - rounding, 0.0)
        value = _nonnegative_optimality(A, of_A, x, y, 0.5 * float(off.dot(off)))
    return (x, residual, y, value) if info == 0 and value <= tolerance else None


def _nonnegative_optimality(
    A: FloatVector, of_A: FloatVector, x: FloatVector, y: FloatVector, gap: float
) -> float:
    """Return by how much the cost at x ≥ 0 exceeds the least, beside that of y, rounding aside; ∞ where it may."""
    slope, rounding, cost = (
        A.T @ y,
        (2 * y.size + 8) * UNIT * (of_A.T @ np.abs(y)),
        0.5 * float(y.dot(y)),
    )
    if not (all_hold(slope + rounding >= 0.0) and 1.0 / LARGEST < cost < LARGEST):
        return np.inf
    gap += float(np.maximum(slope - rounding, 0.0).dot(x))
    return OUTWARD**3 * gap / cost


def _with_small_slopes(parts: Parts, A: FloatVector, b: FloatVector) -> Iterator[FloatVector]:
    """Yield parts z whose faces are right where slopes go to 0: those of none, and of least slope that fit b."""
    from ...proofs.no_solution.farkas import linear_program

    if (
        not parts.slopes.any() or parts.signs.size > parts.start.size
    ):  # a column of two parts has no face of its own
        return
    if not is_over() and min(A.shape) <= NNLS_UP_TO:
        z = _by_nnls(A, b, is_asked=True)
        if np.isfinite(z).all():
            yield z
    if not is_over() and A.shape[0] < A.shape[1]:
        found = linear_program(
            parts.slopes / parts.slopes.max(), sp.csr_array(A), b, (0.0, None), (None, None)
        )
        if found is not None:
            yield np.maximum(found.x, 0.0)


def _has_end_in_sight(A: Any) -> bool:
    """Return whether PIQP, which nothing stops, can be asked within the time that is left: its sparse factors fit."""
    from ...core.tuning import SPARSE_OPERATIONS
    from ...systems.minimum_degree import factor_sizes

    most = min(seconds_left(), PATIENCE) / FACTORS
    if most < SECONDS * (A.nnz + sum(A.shape)):
        return False
    both = sp.csr_array(sp.block_array([[None, A], [A.T, None]]))
    return factor_sizes(both, LARGEST_FILL, most * SPARSE_OPERATIONS)[0] < np.inf


def _by_nnls(A: FloatVector, b: FloatVector, *, is_asked: bool) -> FloatVector:
    """Return the parts z by scipy; NaN where it gives up, or is not asked."""
    from scipy.optimize import nnls

    try:
        z: FloatVector = (
            nnls(A, b, maxiter=STEPS * A.shape[1])[0] if is_asked else np.full(A.shape[1], np.nan)
        )
    except (
        RuntimeError,
        ValueError,
        np.linalg.LinAlgError,
    ):  # too many steps; what is not finite; what is singular
        return np.full(A.shape[1], np.nan)
    return z


def _by_bounds(parts: Parts, A: FloatVector, b: FloatVector) -> FloatVector:
    """Return the parts z by PIQP on the normal equations, 0 or w where multipliers say so."""
    n = parts.signs.size
    none = np.zeros((0, n)), np.zeros(0)
    normal = Statement(A.T @ A, parts.slopes - A.T @ b, *none, *none, np.zeros(n), parts.widths)
    z, multipliers, _, _ = _by_piqp(normal)
    z = np.where(multipliers.lower > z, 0.0, z)
    return np.where(multipliers.upper > parts.widths - z, parts.widths, z)


def _by_piqp(program: Statement) -> Point:
    """Return PIQP's point, NaN where it has none."""
    return PIQP().answer(program, Limits(seconds_left()))


def on_its_face(point: FacePoint, A: FloatVector, b: FloatVector) -> FacePoint:
    """Return the minimum on the face of the point, or on one nearby, by orthogonal factors, each refined once.

    Columns that leave their bounds, or their side of 0, are held there; those that are pulled away from there are let
    go: until none is.
    """
    from scipy.linalg import qr, solve_triangular

    before, is_filled = None, A.any(axis=0)
    for _ in range(FACES):
        orthant = point.problem.whole.orthant(point.x, point.slope)
        point = FacePoint(orthant, point.x, point.residual, dual=NOTHING)
        free = np.flatnonzero(is_filled & (point.is_free | (np.abs(point.pull) > point.noise)))
        case = free.tobytes(), orthant.linear[free].tobytes()
        if case == before or not 0 < free.size <= A.shape[0]:
            break
        Q, R = qr(A[:, free], mode="economic", check_finite=False)
        if not np.diag(R).all():
            break
        before, x, linear = case, point.x.copy(), orthant.linear[free]
        slant = solve_triangular(R, linear, trans=1, check_finite=False) if linear.any() else 0.0
        for _ in range(SOLVES):
            x[free] -= solve_triangular(R, Q.T @ (A @ x - b) + slant, check_finite=False)
        if not np.isfinite(x).all():
            break
        point = FacePoint(orthant, clipped(x, orthant.lower, orthant.upper), dual=NOTHING)
    return point


def dual_program(parts: Parts, entries: Any, b: FloatVector) -> Statement:
    """Return the dual, y and v in units of the largest slope, divided by that."""
    m, k = entries.shape
    unit = min(float(np.max(parts.slopes, initial=0.0)), 1.0) or 1.0
    bounded = np.flatnonzero(parts.widths < np.inf)
    size = m + bounded.size
    curvature = np.append(np.full(m, unit), np.zeros(bounded.size))
    lower = np.append(np.full(m, -np.inf), np.zeros(bounded.size))
    v = sp.csr_array(
        (np.ones(bounded.size), (bounded, np.arange(bounded.size))), shape=(k, bounded.size)
    )
    if sp.issparse(entries):
        P, G = sp.diags_array(curvature, format="csr"), sp.csr_array(sp.hstack([-entries.T, -v]))
        none = sp.csr_array((0, size))
    else:
        P, G, none = np.diag(curvature), np.hstack([-entries.T, -v.toarray()]), np.zeros((0, size))
    cost = np.append(b, parts.widths[bounded])
    return Statement(
        P, cost, G, parts.slopes / unit, none, np.zeros(0), lower, np.full(size, np.inf)
    )


def _rows(problem: ScaledLeastSquares, *, is_dense: bool) -> tuple[Any, FloatVector]:
    """Return A and b, a ridge as further rows; their triangle where copies of A are too much."""
    (m, n), root = problem.problem.shape, np.sqrt(problem.ridge)
    if not is_dense:
        A, b = problem.entries(), problem.b
    elif problem.problem.is_cheap_to_copy:
        A, b = problem.dense(), problem.b
    else:
        A, b = np.zeros((0, n)), np.zeros(0)
        for begin in range(0, m, ROWS * n):
            rows = slice(begin, begin + ROWS * n)
            A, b = _triangle(np.vstack([A, problem.dense(rows)]), np.append(b, problem.b[rows]))
            if is_over():
                break
    if not root.any():
        return A, b
    b = np.append(b, np.zeros(root.size))
    return (
        np.vstack([A, np.diag(root)])
        if is_dense
        else sp.csr_array(sp.vstack([A, sp.diags_array(root)]))
    ), b


def _triangle(A: FloatVector, b: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return R and c with ‖A x − b‖ = ‖R x − c‖ and no more than a row more than columns."""
    from scipy.linalg import qr

    both = qr(np.column_stack([A, b]), mode="r", overwrite_a=True, check_finite=False)[0][
        : A.shape[1] + 1
    ]
    return both[:, :-1], both[:, -1]
