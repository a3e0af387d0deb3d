"""Small dense problems: rounds by numpy for one problem, and Lemke's path in :mod:`lcp_plugin.core.kernels.small_lcps`.

Two sweeps of NPSOR guess the active set. A round, an active-set iteration, solves w = 0 on the free rows, with all
other rows at their bounds, and changes every violated row. If the rounds end without a solution, Lemke's path follows
w = M z + q + t r from large t to t = 0. The loop over many problems follows the path at once. In arrays of many
problems the first axis counts them: M has shape (B, n, n), or (1, n, n) if they share it; the vectors have shape
(B, n).

References
----------
Kumar, Deepmala, Das (sweeps). Júdice, Pires 1994, doi:10.1016/0305-0548(94)90106-6 (active sets). Lemke 1965,
doi:10.1287/mnsc.11.7.681. Lemke, Howson 1964, doi:10.1137/0112033 (games).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from typing import Any, ClassVar

import numpy as np
from numpy.linalg import LinAlgError

from ..core.algorithm import Algorithm, Step
from ..core.checks import AnyMatrix, Array, BoolVector, Indices, Vector, read_only
from ..core.entries import clip, residual_scales, unbounded
from ..core.kernels.compilation import kernel
from ..core.kernels.floats import FREE, HIGH, INF, LOW, SMALLEST
from ..core.kernels.small_lcps import LOST, follow_paths, solve_active_sets
from ..core.lcp import LCP
from ..core.matrix import fact
from ..core.settings import Settings
from ..core.structure import equation_signs
from ..judges import lcp as judge
from ..judges.lcp import Measured, RowData, bound_residual, bound_residuals, matvec, row_data
from .banded import banded_passes

GUESSED = "small: a few sweeps guess the active set"
SMALL_DENSE, SMALL_SPARSE = 256, 128  # unknowns
RELAXATION, START_SWEEPS = 1.7, 2  # of NPSOR
ROUNDS, IDLE = 12, 2  # most active-set iterations; most of them in a row without fewer changes
FOLLOW_IN_PYTHON = follow_paths.function
LOOP_FROM, LOOP_UP_TO = 32, 128  # problems, unknowns; fewer problems do not wait for a compilation
# unknowns: the path of one problem takes .2 ms in Python, numba is imported in .6 s
PYTHON_UP_TO = 10


@dataclass(frozen=True, kw_only=True)
class Rounds(Algorithm):
    """Active-set iterations, then Lemke's path, on a small dense problem."""

    name: ClassVar[str] = "rounds"
    is_monotone: ClassVar[bool] = False
    ends_on_active_set: ClassVar[bool] = True

    def first_points(self, problem: LCP, z0: Vector, tolerance: float) -> Iterator[Step] | None:
        """Return the points at which the rounds end, and the ends of the paths, if the problem is small."""
        return self._points(problem, z0) if takes_rounds(problem) and not problem.is_kkt else None

    def _points(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        data, unit = dense_data(problem), max(problem.matrix.nonzeros, 1)
        for label, z, entries in candidates(data, z0):
            if np.isfinite(z).all():
                yield Step(normal(data, z), work=entries / unit, label=label)

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the start; `first_points` has all points."""
        yield Step(z0, work=0.0)


def measure_small(problem: LCP, z: Vector, settings: Settings) -> Measured:
    """Return the measure of a point of a small problem; without its rows if the sufficient test accepts it."""
    data = dense_data(problem)
    if (bound := bound_residual(data, z, settings.tolerance)) < math.inf:
        return Measured(z, bound, passes=True)
    measured = data.measure(z, settings.goal, settings.absolute_tolerance)
    # The rows of a sparse M are measured on the stored M
    return measured if problem.is_dense else measured._replace(rows=None, by_row=None)


def fails_surely(problem: LCP, z: Vector, settings: Settings) -> bool:
    """Return whether a quick test shows that the criterion does not accept z; of a connected problem only."""
    data, tolerance = dense_data(problem), settings.goal
    if data.labels is not None or data.origin.any():
        return False
    w, terms = data.M @ z + data.q, data.absolute @ np.abs(z) + np.abs(data.q)
    step = np.where(np.abs(w) <= 2.0 * judge.NEAREST * terms, 0.0, w / data.scale)
    size = np.maximum.reduce(np.abs(clip(step, z - data.upper, z - data.lower)))
    at_0 = np.maximum.reduce(np.abs(clip(data.q / data.scale, -data.upper, -data.lower)))
    allowed = 2.0 * max(tolerance * at_0, settings.absolute_tolerance)
    return bool(at_0 > 0.0 and allowed < size < math.inf)


def is_small(problem: LCP) -> bool:
    """Return whether rounds on a dense M suit the problem."""
    return 0 < problem.n <= (SMALL_DENSE if problem.matrix.is_dense else SMALL_SPARSE)


def takes_rounds(problem: LCP) -> bool:
    """Return whether auto begins with rounds on a dense M: a small problem, no tridiagonal M-matrix kept sparse."""
    return is_small(problem) and (problem.is_dense or banded_passes(problem.matrix) > 10)


@fact
def dense_data(problem: LCP) -> RowData:
    """Return the data of the criterion of a problem, M dense."""
    data = row_data(problem)
    if not problem.matrix.is_dense:
        data = replace(data, M=data.M.toarray(), absolute=data.absolute.toarray())
    return data


# --- stacks --------------------------------------------------------------------------------------------------


def stacked_data(M: AnyMatrix, q: Vector, lower: Vector, upper: Vector) -> RowData:
    """Return problems of one size as data of the criterion; an axis of length 1 means shared data.

    One matrix for all stays one matrix, M of shape (1, n, n).
    """
    q, lower, upper = np.broadcast_arrays(M[:, 0], q, lower, upper)[1:]
    count, sizes = len(q), np.abs(M)
    scale = residual_scales(M.diagonal(axis1=-2, axis2=-1), sizes.max(-1, initial=0.0))
    labels = None
    if not (sizes[:, 0, 1:].all() or sizes[:, 1:, 0].all()):
        labels = _components(sizes)
        if labels is not None and len(labels) < count:
            labels = labels + M.shape[-1] * np.arange(count)[:, None]
    return RowData(M, sizes, q, lower, upper, scale, labels)


def _components(sizes: Vector) -> Any:
    """Return the component of each row, numbered through the stack; None if each M is connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, n = sizes.shape[:2]
    k, i, j = sizes.nonzero()
    links = coo_array((np.ones(k.size), (k * n + i, k * n + j)), shape=(count * n, count * n))
    labels = connected_components(links, directed=False)[1].reshape(count, n)
    return None if (labels == labels[:, :1]).all() else labels


def normal(data: RowData, z: Vector) -> Vector:
    """Return points at the ends of linear solves, within their bounds, without values whose products underflow."""
    size = np.abs(z)
    least = SMALLEST * np.minimum(size.max(-1, keepdims=True, initial=0.0), 1.0)
    return clip(np.where(size > least, z, 0.0), data.lower, data.upper)


def suits_loop(count: int, n: int) -> bool:
    """Return whether the compiled loop solves so many problems of n unknowns; it never depends on what is compiled."""
    return count >= LOOP_FROM and n <= LOOP_UP_TO and has_numba()


@cache
def has_numba() -> bool:
    """Return whether numba is installed."""
    return find_spec("numba") is not None


def solve_stack(
    M: Vector, q: Vector, lower: Array, upper: Array, starts: Array = None, *, tolerance: float
) -> tuple[Vector, Vector, Any, BoolVector]:
    """Return points of problems (B, n) by the compiled loop.

    A start names an active set, from which active-set iterations begin; a path follows if they end at no solution. The
    criterion measures the points on which the sufficient test does not decide.

    Returns
    -------
    z : array, shape (B, n)
    residual, iterations, is_solved : array, shape (B,)
        Relative residual; 0 if the point is the start, else 1; whether it is a solution.
    """
    arrays = M, q, lower, upper, clip(0.0, lower, upper)
    begun = arrays[4] if starts is None else starts
    z, items = np.array(begun), np.arange(len(q))
    residual, is_solved = np.full(len(q), np.inf), np.zeros(len(q), np.bool_)
    for attempt in range(0 if starts is not None else ROUNDS, ROUNDS + 3):
        if not items.size:
            break
        A, b, low, high, begin = data = _select(arrays, items)
        if attempt == ROUNDS:
            x, bound = bounded_ends(data, tolerance)
            side = _ends_of_paths(A, b, low, high) if math.isnan(bound[0]) else None
        else:
            scale = residual_scales(A.diagonal(axis1=-2, axis2=-1), np.abs(A).max(-1, initial=0.0))
            step = (matvec(A, z[items]) + b) / scale
            side = np.where(step > z[items] - low, LOW, FREE + (step < z[items] - high))
        if side is not None:
            x, bound = _bounded_points(A, b, low, high, begin, side, tolerance)
        z[items], residual[items], is_solved[items] = x, bound, bound < np.inf
        items = items[bound == np.inf]
        items = items[np.isfinite(z[items, 0])] if attempt >= ROUNDS else items
        if attempt >= ROUNDS and items.size:
            rows = stacked_data(*_select((M, q, lower, upper), items))
            measured = rows.measure(normal(rows, z[items]), tolerance)
            z[items], residual[items], is_solved[items] = measured[:3]
            items = items[~measured.passes]  # the path left out what is below its perturbation
    return z, residual, (z != begun).any(1).astype(int), is_solved


def _bounded_points(
    M: Vector, q: Vector, lower: Array, upper: Array, start: Array, sides: Array, tolerance: float
) -> tuple[Vector, Vector]:
    """Return the points of active sets and bounds of their residuals, by kernels; NaN and ∞ if a system is singular."""
    z, (count, n) = active_set_points(M, q, lower, upper, sides), q.shape
    table, bound = np.empty((6, n)), np.empty(count)
    bound_residuals(M, q, lower, upper, start, float(tolerance), table, z, bound)
    return z, bound


@kernel
def bound_ends(M, q, lower, upper, start, tilts, tolerance, z, bound):  # type: ignore[no-untyped-def]
    """Write the ends of the paths, and bounds of their residuals: ∞ if in doubt, NaN if an unknown of any is free.

    The z of one problem stays if the sufficient test accepts it; z[0, 0] is NaN if there is none.
    """
    count, n = q.shape
    for k in range(count):
        for i in range(n):
            if lower[k, i] == -INF and upper[k, i] == INF:
                bound[0] = np.nan
                return
    T, numbers = np.empty((n + 9, n + 1)), np.empty((2, 2 * n + 1), np.int64)
    sides = np.empty((count, n), np.int64)
    bound[0] = INF
    if z[0, 0] == z[0, 0]:
        bound_residuals(M, q, lower, upper, start, tolerance, T, z, bound)
    if bound[0] == INF:
        follow_paths(M, q, lower, upper, tilts, -1, T, numbers, sides)
        solve_active_sets(M, q, lower, upper, sides, T, numbers[0], z)
        bound_residuals(M, q, lower, upper, start, tolerance, T, z, bound)


def path_steps(problem: LCP, tolerance: float, z0: Vector) -> Iterator[Step]:
    """Yield the point of the active set of a start if the quick test accepts it, and the end of Lemke's compiled path.

    A stack of one: the compiled loop has the same bits. A path on a ray is left out.
    """
    arrays, origin, work = arrays_of_one(problem), problem.nearest_to_zero, float(problem.n)
    if z0 is not origin and (z0 != origin).any():
        step = problem.slack(z0) / problem.residual_scale
        is_low, is_high = step >= z0 - problem.lower, step <= z0 - problem.upper
        (z,), (bound,) = _bounded_points(
            *arrays, np.where(is_low, LOW, FREE + is_high)[None], tolerance
        )
        if bound < math.inf:
            yield Step(z, work=work, is_settling=True, measured=Measured(z, float(bound), True))
    points, bounds = bounded_ends(arrays, tolerance)
    if math.isnan(bounds.item(0)):
        points, bounds = _bounded_points(*arrays, _ends_of_paths(*arrays[:4]), tolerance)
    z, bound = points[0], bounds.item(0)
    if math.isfinite(z[0]):
        measured = Measured(z, bound, True) if bound < math.inf else None
        yield Step(z, work=work, is_settling=True, measured=measured)


def arrays_of_one(problem: LCP) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """Return M, q, the bounds and z° of a problem as a stack of one, read-only."""
    M = read_only(problem.matrix.toarray())
    q, lower, upper, start = problem.q, problem.lower, problem.upper, problem.nearest_to_zero
    return M[None], q[None], lower[None], upper[None], start[None]


def bounded_ends(arrays: Array, tolerance: float, start: Array = math.nan) -> tuple[Vector, Vector]:
    """Return the ends of the paths, or the start of one problem if it passes, and bounds as :func:`bound_ends`."""
    count, n = arrays[1].shape
    z, bound = np.empty((count, n)), np.empty(count)
    z[0] = start
    bound_ends(*arrays, tilts(n), tolerance, z, bound)
    return z, bound


def _select(arrays: Array, items: Indices) -> list[Any]:
    """Return these problems of arrays, C-contiguous and read-only; an array of length 1 applies to all."""
    are_all = items.size == len(arrays[1])
    selected = (array if are_all or len(array) == 1 else array[items] for array in arrays)
    return [read_only(np.ascontiguousarray(array)) for array in selected]


def _ends_of_paths(
    M: Vector, q: Vector, lower: Array, upper: Array, *, follow: Any = follow_paths, label: int = -1
) -> Any:
    """Return the active sets at the ends of Lemke's paths; free unknowns are eliminated before, or split.

    Free unknowns of a singular block become differences of two nonnegative ones.
    """
    n, sides = q.shape[1], np.full(q.shape, FREE)
    free = unbounded(lower, upper)
    if not free.any():
        table, numbers = np.empty((n + 9, n + 1)), np.empty((2, 2 * n + 1), np.int64)
        follow(M, q, lower, upper, tilts(n), label, table, numbers, sides)
        return sides
    for pattern in np.unique(free, axis=0):
        items = np.flatnonzero((free == pattern).all(1))
        E, R = np.flatnonzero(pattern), np.flatnonzero(~pattern)
        block = M[:, E[:, None], E] if len(M) == 1 else M[items[:, None, None], E[:, None], E]
        is_regular = np.broadcast_to(np.linalg.det(block) != 0.0, items.shape)
        for k in items[~is_regular].tolist():
            signs = equation_signs(M[k % len(M)], pattern)
            A, b = signs[:, None] * M[k % len(M)], signs * q[k]
            A = np.block([[A, -A[:, E]], [-A[E], A[E[:, None], E]]])
            low, high = np.where(pattern, 0.0, lower[k]), np.append(upper[k], upper[k, E])
            parts = A, np.append(b, -b[E]), np.append(low, low[E]), high
            data = _select([part[None] for part in parts], np.arange(1))
            sides[k, R] = _ends_of_paths(*data, follow=follow)[0, R]
        if not (items := items[is_regular]).size:
            continue
        A, b, low, high = _select((M, q, lower, upper), items)
        block, to = A[:, E[:, None], E], A[:, R[:, None], E]
        of_x, of_1 = (np.linalg.solve(-block, x) for x in (A[:, E[:, None], R], b[:, E, None]))
        if R.size:
            reduced = A[:, R[:, None], R] + to @ of_x, b[:, R] + (to @ of_1)[..., 0]
            data = _select((*reduced, low[:, R], high[:, R]), items)
            sides[items[:, None], R] = _ends_of_paths(*data, follow=follow)
    return sides


def _end_of_game(M: Vector, q: Vector, lower: Vector, upper: Vector, *, follow: Any) -> Any:
    """Return the active set at the end of Lemke and Howson's path that drops the first label.

    z_0 > 0 makes all rows of the other player feasible, the last of them row s. In the problem in which w_0, w_s and
    z_0, z_s have changed places, the path begins along the column of w_0, with w_0 > 0 and z_0 > 0.
    """
    need = -q[0] / np.where(M[0, :, 0] > 0.0, M[0, :, 0], INF)
    pair = np.array([0, need.argmax()])
    inverse = np.linalg.inv(M[0][pair[:, None], pair])
    left = M[0][:, pair] @ inverse
    A, b = M[0] - left @ M[0][pair], q[0] - left @ q[0, pair]
    A[:, pair], A[pair], b[pair] = left, -(inverse @ M[0][pair]), -(inverse @ q[0, pair])
    A[pair[:, None], pair] = inverse
    data = _select([A[None], b[None], lower, upper], np.arange(1))
    sides = _ends_of_paths(*data, follow=follow, label=0)
    if (sides != LOST).all():
        sides[0, pair] = LOW + FREE - sides[0, pair]
    return sides


def bimatrix_players(M: Vector, q: Vector) -> Any:
    """Return the mask of the first player's rows if the problem is a game of costs, else None.

    A game: M = [[0, A], [Bᵀ, 0]] up to order, A, B > 0 and q < 0. Every covering vector r > 0 ends such a path on
    its first ray.
    """
    first = M[:1].ravel() == 0.0
    is_same = first[:, np.newaxis] == first
    is_game = (q < 0.0).all() and not first.all() and ((M > 0.0) == ~is_same).all()
    return first if is_game and not M[is_same].any() else None


@cache
def tilts(n: int) -> Vector:
    """Return the perturbations of q on a path, in units of PERTURBED times the largest |q_i|."""
    return read_only(np.random.default_rng(1).uniform(1.0, 2.0, n))


def active_set_points(M: Vector, q: Vector, lower: Array, upper: Array, sides: Array) -> Vector:
    """Return z_i at the bound that `sides` names, w_i = 0 if FREE, shape (B, n); NaN if its system is singular."""
    (count, n), z = q.shape, np.empty(q.shape)
    data = _select((M, q, lower, upper, sides), np.arange(count))
    solve_active_sets(*data, np.empty((n, n + 1)), np.empty(n, np.int64), z)
    return z


# --- one problem ---------------------------------------------------------------------------------------------


def guess(data: RowData) -> Vector | None:
    """Return z after sweeps of NPSOR from z°: (D/α + D + 2S⁻¹ − L)(z⁺ − z) = −2 S⁻¹ r_S(z), S = D⁻¹.

    L is the block of M below its first half of rows and columns: every choice of L has the paper's theorem. The result
    is None if a row that is not free has no diagonal entry, or a negligible one, so that d_i is another entry.
    """
    is_own = data.M.diagonal() == data.scale
    if not np.logical_and.reduce(is_own):
        is_own |= unbounded(data.lower, data.upper)
        if not is_own.all():
            return None
    z: Vector = data.origin
    pivot, half = 1.0 / RELAXATION + 3.0, z.size // 2
    corner, pivots = data.M[half:, :half], pivot * data.scale[half:]
    for _ in range(START_SWEEPS):
        step = (data.M.dot(z) + data.q) / data.scale
        change = clip(step, z - data.upper, z - data.lower) * (2.0 / pivot)
        new = clip(z - change, data.lower, data.upper)
        change[half:] += corner.dot(new[:half] - z[:half]) / pivots
        z = clip(z - change, data.lower, data.upper)
    return z


def active_point(M: Vector, q: Vector, lower: Vector, upper: Vector, side: Indices) -> Vector:
    """Return z, z_i at the bound that `side` names, w_i = 0 if FREE; by least squares if that system is singular."""
    free = (side == FREE).nonzero()[0]
    z: Vector = np.where(side == HIGH, upper, lower)
    if free.size == 0:
        return z
    block, right = M, -q
    if free.size < z.size:
        z[free] = 0.0
        block, right = M[free[:, None], free], -(M.dot(z) + q)[free]
    try:
        z[free] = np.linalg.solve(block, right)
    except LinAlgError:
        z[free] = np.linalg.lstsq(block, right)[0]
    return z


def candidates(data: RowData, z0: Vector) -> Iterator[tuple[str, Vector, float]]:
    """Yield candidate solutions of one problem, each with its method and the number of entries touched."""
    entries = float(z0.size**3)
    is_cold = z0 is data.origin or bool((z0 == data.origin).all())
    first = guess(data) if is_cold else z0  # a start names an active set
    if first is not None:
        yield "rounds", rounds(data, first), entries
    if (is_short := z0.size <= PYTHON_UP_TO) or has_numba():
        arrays = data.M, data.q, data.lower, data.upper
        stack = [read_only(np.ascontiguousarray(array)[np.newaxis]) for array in arrays]
        is_game = first is None and bimatrix_players(data.M, data.q) is not None
        is_game = is_game and not data.lower.any() and bool((data.upper == INF).all())
        ends = _end_of_game if is_game else _ends_of_paths
        (side,) = ends(*stack, follow=FOLLOW_IN_PYTHON if is_short else follow_paths)
        z = active_point(*arrays, side) if (side != LOST).all() else np.full(side.size, np.nan)
        # A degenerate path ends with noise near bounds
        least = judge.SET_TO_BOUND * np.abs(z).max()
        near = np.where(data.upper - z <= least, data.upper, z)
        yield "path", np.where(z - data.lower <= least, data.lower, near), 3.0 * entries
        if np.isfinite(z).all():
            yield "rounds", rounds(data, z), entries
    if first is None:
        yield "rounds", rounds(data, data.origin), entries


def rounds(data: RowData, z: Vector) -> Vector:
    """Return the final point of active-set iterations."""
    M, q, lower, upper, scale = data.M, data.q, data.lower, data.upper, data.scale
    before, fewest, idle = None, z.size + 1, 0
    for _ in range(ROUNDS):
        step = (M.dot(z) + q) / scale
        side = np.where(step >= z - lower, LOW, FREE + (step <= z - upper))
        changes = z.size if before is None else int(np.count_nonzero(side != before))
        idle, fewest = (idle + 1, fewest) if changes >= fewest else (0, changes)
        if not changes or idle > IDLE or not step.dot(step) >= 0.0:  # NaN: a singular block
            break
        before = side
        z = active_point(M, q, lower, upper, side)
    return z
