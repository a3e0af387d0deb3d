"""Small dense problems, one or a stack, by numpy only: sweeps of NPSOR, active-set iterations, Lemke's path.

Two sweeps guess the active set. A round, an active-set iteration, solves w = 0 on the free rows, with all other rows
at their bounds, and changes every violated row. If the rounds end without a solution, Lemke's path follows
w = M z + q + t r from large t to t = 0. The first axis of arrays counts problems: M has shape (B, n, n), or (1, n, n)
if they share it; the vectors have shape (B, n).

References
----------
Kumar, Deepmala, Das (sweeps). Júdice, Pires 1994, doi:10.1016/0305-0548(94)90106-6 (active sets). Lemke 1965,
doi:10.1287/mnsc.11.7.681. Lemke, Howson 1964, doi:10.1137/0112033 (games).

Small dense problems by numpy: sweeps, active-set iterations, pivots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar

import numpy as np
from numpy.linalg import LinAlgError

from ..core.algorithm import Algorithm, Step
from ..core.certificates.criterion import RowData, row_data, times
from ..core.certificates.measured import Measured
from ..core.checks import BoolVector, FloatVector
from ..core.lcp import LCP
from ..core.matrix import equation_signs, residual_scales

SMALL_DENSE, SMALL_SPARSE = 256, 128  # unknowns
RELAXATION, SWEEPS = 1.7, 2  # of NPSOR
ROUNDS, IDLE = 12, 2  # most active-set iterations; most of them in a row without fewer changes
SMALLEST_PIVOT = 1e-11  # of rows divided by their largest entry
PERTURBED = 2.0**-36  # of the largest q: no two rows block at once
SMALLEST = (
    1e-130  # smaller values of z relative to 1 or the largest are 0: their products underflow
)
WELL_CONDITIONED = 1e8
CHUNK = 2**17  # entries of matrices that stay in the cache
LOW, FREE, HIGH = 0, 1, 2  # side of z_i: at its lower bound, between the bounds, at its upper bound


@dataclass(frozen=True, kw_only=True)
class Rounds(Algorithm):
    """Active-set iterations, then Lemke's paths, on a small dense problem.

    Parameters
    ----------
    restarts : bool
        If False, only the first path is followed.
    """

    restarts: bool = True

    name: ClassVar[str] = "rounds"
    is_monotone: ClassVar[bool] = False
    ends_on_active_set: ClassVar[bool] = True

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, the point at which the rounds end, and the ends of the paths."""
        yield Step(z0, work=0.0)
        data, unit = dense_data(problem), max(problem.nonzeros, 1)
        for label, z, entries in candidates(data, z0, restarts=self.restarts):
            if np.isfinite(z).all():
                found = measure(data, z, 0.0)
                yield Step(found.z, work=entries / unit, label=label, measured=found)


def first_candidate(
    problem: LCP, z0: FloatVector, tolerance: float
) -> tuple[Measured, str, float] | None:
    """Return the first point of :func:`candidates`, its method and its work; None unless the point is a solution.

    The result is also None if z0 or z° is a solution already, because a step is then superfluous.
    """
    data = dense_data(problem)
    if not data.reference.all() or (z0 is not data.start and measure(data, z0, tolerance).passes):
        return None
    label, z, entries = next(candidates(data, z0))
    found = measure(data, z, tolerance)
    return (found, label, entries / max(problem.matrix.nonzeros, 1)) if found.passes else None


def is_small(problem: LCP) -> bool:
    """Return whether rounds on a dense M suit the problem."""
    return 0 < problem.n <= (SMALL_DENSE if problem.matrix.is_dense else SMALL_SPARSE)


def dense_data(problem: LCP) -> RowData:
    """Return the data of the criterion of a problem, M dense."""
    data = row_data(problem)
    if not problem.matrix.is_dense:
        M, bounds = data.M.toarray(), (data.lower, data.upper)
        rows = data.scale, data.labels, data.start, data.origin
        data = RowData(M, np.abs(M), data.q, *bounds, *rows)
    return data


# --- stacks --------------------------------------------------------------------------------------------------


def stack_of(M: Any, q: FloatVector, lower: FloatVector, upper: FloatVector) -> RowData:
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


def _components(sizes: FloatVector) -> Any:
    """Return the component of each row, numbered through the stack; None if each M is connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, n = sizes.shape[:2]
    k, i, j = sizes.nonzero()
    links = coo_array((np.ones(k.size), (k * n + i, k * n + j)), shape=(count * n, count * n))
    labels = connected_components(links, directed=False)[1].reshape(count, n)
    return None if (labels == labels[:, :1]).all() else labels


def select_problems(stack: RowData, items: Any) -> RowData:
    """Return the problems of a stack with these numbers as a stack."""
    labels = stack.labels
    if labels is not None:
        labels = np.unique(labels[items], return_inverse=True)[1].reshape(-1, labels.shape[1])
    parts: dict[str, Any] = {name: getattr(stack, name)[items] for name in ("q", "lower", "upper")}
    for name in ("M", "absolute", "scale"):
        whole = getattr(stack, name)
        parts[name] = whole if len(stack.M) == 1 else whole[items]
    return RowData(**parts, labels=labels)


def measure(data: RowData, z: FloatVector, tolerance: float) -> Measured:
    """Measure points at the ends of linear solves, within their bounds, without values whose products underflow."""
    size = np.abs(z)
    least = SMALLEST * np.minimum(size.max(-1, keepdims=True, initial=0.0), 1.0)
    z = np.minimum(np.maximum(np.where(size > least, z, 0.0), data.lower), data.upper)
    return data.measure(z, tolerance, power=1.0)


def solve_stack(
    M: FloatVector,
    q: FloatVector,
    lower: FloatVector,
    upper: FloatVector,
    starts: FloatVector | None,
    tolerance: float,
) -> tuple[FloatVector, FloatVector, Any, BoolVector]:
    """Return points of problems (B, n) after iterations and paths of all problems at once.

    Returns
    -------
    z : array, shape (B, n)
    residual, iterations, is_solved : array, shape (B,)
        Relative residual; 0 if the point is the start, else 1; whether it is a solution.
    """
    stack = stack_of(M, q, lower, upper)
    first = guess(stack) if starts is None else np.broadcast_to(starts, stack.q.shape)
    ends = stack.start if first is None else rounds_of_stack(stack, first)
    found = measure(stack, ends, tolerance)
    has_free = ((stack.lower == -np.inf) & (stack.upper == np.inf)).any(1)
    items = np.flatnonzero(~found.passes & ~has_free)
    if items.size:
        few = select_problems(stack, items)
        of_paths = measure(few, paths(few), tolerance)
        for table, values in zip(found[:3], of_paths[:3], strict=True):
            table[items] = values
    begun = stack.start if starts is None else starts
    return found.z, found.residual, (found.z != begun).any(1).astype(int), found.passes


def guess(stack: RowData) -> FloatVector | None:
    """Return z after sweeps of NPSOR from z°: (D/α + D + 2S⁻¹ − L)(z⁺ − z) = −2 S⁻¹ r_S(z), S = D⁻¹.

    L is the block of M below its first half of rows and columns: every choice of L has the paper's theorem. The result
    is None if a row that is not free has no diagonal entry, or a negligible one, so that d_i is another entry.
    """
    free = (stack.lower == -np.inf) & (stack.upper == np.inf)
    if not ((stack.M.diagonal(axis1=-2, axis2=-1) == stack.scale) | free).all():
        return None
    z = stack.start
    pivot, half = 1.0 / RELAXATION + 3.0, z.shape[-1] // 2
    for _ in range(SWEEPS):
        step = (times(stack.M, z) + stack.q) / stack.scale
        change = np.minimum(np.maximum(step, z - stack.upper), z - stack.lower) * (2.0 / pivot)
        new = np.minimum(np.maximum(z - change, stack.lower), stack.upper)
        more = times(stack.M[..., half:, :half], new[..., :half] - z[..., :half])
        change[..., half:] += more / (pivot * stack.scale[..., half:])
        z = np.minimum(np.maximum(z - change, stack.lower), stack.upper)
    return z


def rounds_of_stack(stack: RowData, z: FloatVector) -> FloatVector:
    """Return the final points of active-set iterations, which begin with the active sets of z."""
    z, items, side = z.copy(), np.arange(len(z)), np.full(z.shape, -1)
    fewest, idle = np.full(len(z), z.shape[1] + 1), np.zeros(len(z), int)
    for _ in range(ROUNDS):
        step, before = (times(stack.M, z) + stack.q) / stack.scale, side
        is_low, is_high = step >= z - stack.lower, step <= z - stack.upper
        side = np.where(is_low, LOW, FREE + is_high)
        changes = (side != before).sum(1)
        idle = np.where(changes < fewest, 0, idle + 1)
        fewest = np.minimum(changes, fewest)
        is_open = (changes > 0) & (idle <= IDLE) & ~np.isnan(step).any(1)  # NaN: a singular block
        items = items[is_open[items]]
        if not items.size:
            break
        z[items] = solve_active_sets(stack, side, items)
    return z


def solve_active_sets(stack: RowData, side: Any, items: Any) -> FloatVector:
    """Return z of these problems, z_i at the bound that `side` names, w_i = 0 if FREE; NaN if singular."""
    if len(side) == 1:
        return _solve_active_set(stack.M[0], stack.q[0], stack.lower[0], stack.upper[0], side[0])[
            None
        ]
    z: FloatVector = np.where(side == LOW, stack.lower, np.where(side == HIGH, stack.upper, 0.0))
    free = side[items] == FREE
    most = int(free.sum(1).max(initial=0))
    right, z = -(stack.q + times(stack.M, z))[items], z[items]
    if not most:
        return z
    order = np.argsort(~free, 1, kind="stable")[:, :most]
    inside = np.take_along_axis(free, order, 1)
    n = side.shape[1]
    first = items[:, None] * n if len(stack.M) > 1 else 0
    rows = (first + order)[:, :, None] * n
    blocks = stack.M.reshape(-1).take(rows + order[:, None, :])
    if not inside.all():
        # Smaller blocks are filled up by rows z_i = bound; `right` has the terms of z_i in other rows already.
        blocks = np.where(inside[:, :, None] & inside[:, None, :], blocks, np.eye(most))
    known = np.take_along_axis(z, order, 1)
    right = np.where(inside, np.take_along_axis(right, order, 1), known)
    np.put_along_axis(z, order, _solve_systems(blocks, right), 1)
    return z


def _solve_active_set(
    M: FloatVector, q: FloatVector, lower: Any, upper: FloatVector, side: Any
) -> FloatVector:
    """Return z of one problem, as :func:`solve_active_sets` does."""
    free = (side == FREE).nonzero()[0]
    z: FloatVector = np.where(side == HIGH, upper, lower)
    if free.size:
        z[free] = 0.0
        right = -(M @ z + q)[free]
        try:
            z[free] = np.linalg.solve(M[free[:, None], free], right)
        except LinAlgError:
            z[free] = np.nan
    return z


def _solve_systems(A: FloatVector, b: FloatVector) -> FloatVector:
    """Return the solutions of a stack of systems, NaN for a singular one."""
    try:
        return np.asarray(np.linalg.solve(A, b[..., None])[..., 0], dtype=np.float64)
    except LinAlgError:
        if len(A) == 1:
            return np.full_like(b, np.nan)
    half = len(A) // 2
    return np.concatenate([_solve_systems(A[:half], b[:half]), _solve_systems(A[half:], b[half:])])


def paths(stack: RowData) -> FloatVector:
    """Return the ends of Lemke's paths from r = 1, NaN for a lost path; no row is free."""
    flips = stack.lower == -np.inf
    base, sign = np.where(flips, stack.upper, stack.lower), np.where(flips, -1.0, 1.0)
    M = sign[:, :, None] * stack.M * sign[:, None, :]
    side = _follow_paths(M, sign * (stack.q + times(stack.M, base)), stack.upper - stack.lower)
    side = np.where(flips & (side >= 0), HIGH - side, side)
    z = solve_active_sets(stack, side, np.arange(len(side)))
    z[(side < 0).any(1)] = np.nan
    return z


def _follow_paths(M: FloatVector, q: FloatVector, width: FloatVector) -> Any:  # noqa: PLR0915 - one loop
    """Return LOW, FREE or HIGH of each row at the ends of the paths of 0 ≤ x ≤ width, −1 for a lost path.

    The path belongs to a perturbed q. x_i = i, w_i = n + i, t = 2n are the numbers of variables.
    """
    count, n = q.shape
    unit = np.abs(M).max(2)
    unit = 1.0 / np.where(unit > 0.0, unit, 1.0)
    T = np.concatenate([M * unit[:, :, None], np.ones((count, n, 1))], 2)
    v, t = q * unit, 2 * n
    largest = np.abs(v).max(1, keepdims=True)
    v += PERTURBED * largest * np.random.default_rng(1).uniform(1.0, 2.0, n)
    u = np.concatenate([width, np.full((count, n + 1), np.inf)], 1)
    value = np.maximum(np.where(width == 0.0, 0.0, -v).max(1), 0.0)
    v += value[:, None]
    low, high = np.where(width == 0.0, -np.inf, 0.0), np.full((count, n), np.inf)
    basis = np.tile(np.arange(n, 2 * n), (count, 1))
    place = np.tile(np.r_[np.arange(2 * n), n], (count, 1))
    side, result, here = np.full((count, n), LOW), np.full((count, n), -1), np.arange(count)
    driven, direction, t_row = np.full(count, t), np.full(count, -1.0), np.full(count, -1)
    for _ in range(10 * (n + 10)):
        b = np.arange(len(here))
        column = place[b, driven]
        factor = T[b, :, column]
        rate = direction[:, None] * factor
        distance = np.where(
            np.abs(rate) > SMALLEST_PIVOT, (np.where(rate < 0.0, low, high) - v) / rate, np.inf
        )
        row = distance.argmin(1)
        step = np.maximum(distance[b, row], 0.0)
        is_end = (t_row >= 0) & (distance[b, t_row] <= step * (1.0 + 1e-12))
        row = np.where(is_end, t_row, row)
        own = np.where(driven == t, value, u[b, driven])
        jumps = own <= np.where(step < np.inf, step, 0.0)  # to its own other bound
        step = np.where(jumps, own, step)
        is_lost = ~(step < np.inf)
        v += (direction * step)[:, None] * factor
        falls = np.where(jumps, direction < 0.0, rate[b, row] < 0.0)
        leaving = np.where(jumps, driven, basis[b, row])
        i = np.flatnonzero(~(jumps | is_lost))
        if i.size:
            k, c, entering = row[i], column[i], driven[i]
            index, is_x, is_t = entering % n, entering < n, entering == t
            is_high = ~is_x & ~is_t & (side[i, index] == HIGH)
            v[i, k] = value[i] + direction[i] * step[i]
            is_fixed = ~is_x & ~is_t & (u[i, index] == 0.0)
            low[i, k] = np.where(is_high | is_fixed, -np.inf, 0.0)
            high[i, k] = np.where(is_high, 0.0, u[i, entering])
            side[i[is_x], index[is_x]] = FREE
            basis[i, k], place[i, leaving[i]] = entering, c
            t_row[i] = np.where(is_t, k, np.where(t_row[i] == k, -1, t_row[i]))
            at = np.arange(i.size)
            pivot, factor = factor[i, k][:, None], factor[i]
            held = T[i, k] / -pivot
            held[at, c], factor[at, k] = 1.0 / pivot[:, 0], 1.0
            T[i, :, c] = T[i, k] = 0.0
            if i.size == b.size:
                T += factor[:, :, None] * held[:, None, :]
            else:
                T[i] += factor[:, :, None] * held[:, None, :]
        index, was_x = leaving % n, leaving < n
        side[b[was_x], index[was_x]] = np.where(falls[was_x], LOW, HIGH)
        is_high = side[b, index] == HIGH
        driven = np.where(was_x, n + index, index)  # its complement
        value = np.where(~was_x & is_high, u[b, index], 0.0)
        direction = np.where(was_x, np.where(falls, 1.0, -1.0), np.where(is_high, -1.0, 1.0))
        is_over = leaving == t
        result[here[is_over]] = side[is_over]
        on = ~(is_over | is_lost)
        if not on.any():
            break
        if not on.all():
            here, T, v, low, high, basis, place, side, driven, value, direction, t_row, u = (
                a[on]
                for a in (
                    here,
                    T,
                    v,
                    low,
                    high,
                    basis,
                    place,
                    side,
                    driven,
                    value,
                    direction,
                    t_row,
                    u,
                )
            )
    return result


# --- one problem ---------------------------------------------------------------------------------------------


COVERINGS: dict[str, Callable[[FloatVector], FloatVector]] = {
    "path": lambda q: np.ones(q.size),
    "path, r = |q|": lambda q: np.maximum(np.abs(q), 2.0**-10 * np.abs(q).max()),
    "path, random r": lambda q: np.random.default_rng(0).uniform(0.25, 1.0, q.size),
}


def candidates(
    data: RowData, z0: FloatVector, *, restarts: bool = True
) -> Iterator[tuple[str, FloatVector, float]]:
    """Yield candidate solutions of one problem, each with its method and the number of entries touched."""
    entries = float(z0.size**3)
    is_cold = z0 is data.start or bool((z0 == data.start).all())
    first = guess(data) if is_cold else z0  # a start names an active set
    if first is not None:
        yield "rounds", rounds(data, first), entries
    M, q, width, back = _canonical(data.M, data.q, data.lower, data.upper)
    game = (
        _rows_of_first_player(M, q) if q.size and not M[0, 0] and np.isposinf(width).all() else None
    )
    if game is not None:
        yield "game", back(path(M, q, width, game=game)), 3.0 * entries
    for name, covering in islice(COVERINGS.items(), None if restarts else 1):
        z = back(path(M, q, width, covering(q)) if q.size else q)
        yield name, np.clip(z, data.lower, data.upper), 3.0 * entries
        if np.isfinite(z).all():
            yield "rounds", rounds(data, z), entries
    if guess(data) is None:
        yield "rounds", rounds(data, data.start), entries


def rounds(data: RowData, z: FloatVector) -> FloatVector:
    """Return the final point of active-set iterations on one problem, as :func:`rounds_of_stack` does."""
    M, q, lower, upper, scale = data.M, data.q, data.lower, data.upper, data.scale
    before, fewest, idle = None, z.size + 1, 0
    for _ in range(ROUNDS):
        step = (M @ z + q) / scale
        side = np.where(step >= z - lower, LOW, FREE + (step <= z - upper))
        changes = z.size if before is None else int(np.count_nonzero(side != before))
        idle, fewest = (idle + 1, fewest) if changes >= fewest else (0, changes)
        if not changes or idle > IDLE or not step @ step >= 0.0:  # NaN: a singular block
            break
        before = side
        z = _solve_active_set(M, q, lower, upper, side)
    return z


def _exchange(T: FloatVector, factor: FloatVector, row: int, column: int) -> None:
    """Exchange the basic variable of a row and the nonbasic one of a column with the entries `factor`, in place."""
    pivot = factor[row]
    held = T[row] / -pivot
    held[column], factor[row] = 1.0 / pivot, 1.0
    T[row], T[:, column] = 0.0, 0.0
    T += factor[:, None] * held


def path(  # noqa: PLR0912, PLR0915 - one loop
    M: FloatVector, q: FloatVector, width: FloatVector, r: Any = None, game: Any = None
) -> FloatVector:
    """Return x, 0 ≤ x ≤ width, at the end of Lemke's path w = M x + q + t r, NaN if the path is lost.

    The path belongs to a perturbed q, for which no two rows block at once. x is the solution for the unperturbed q in
    the last basis. For a game, the path is Lemke and Howson's.
    """
    n = q.size
    unit = np.abs(M).max(1)
    unit = 1.0 / np.where(unit > 0.0, unit, 1.0)
    if game is not None:
        r = np.where(game, 1.0, 0.0)
        r[0] = 0.5
    T = np.empty((n, n + 1))
    T[:, :n], T[:, n] = M * unit[:, None], r
    v = q * unit
    v = v + PERTURBED * np.abs(v).max() * np.random.default_rng(1).uniform(1.0, 2.0, n)
    fixed = width == 0.0
    value = float(np.where(fixed, 0.0, -v / r).max()) if game is None else 0.0
    if value <= 0.0 and game is None:
        return np.zeros(n)
    v = v + value * r
    low, high, side = np.where(fixed, -np.inf, 0.0), np.full(n, np.inf), [LOW] * n
    basis, other = list(range(n, 2 * n)), [*range(n), 2 * n]  # x_i = i, w_i = n + i, t = 2n
    t, column, direction, t_row, u = 2 * n, n, -1.0, -1, width.tolist()
    driven = t
    if game is not None:  # x_0 covers the other player's rows, t the remaining rows, in one vertex
        s = int(np.where(game, -np.inf, -v / T[:, 0]).argmax())
        for row, at in ((s, 0), (0, n)):
            factor = T[:, at].copy()
            value = -v[row] / factor[row]
            v += value * factor
            v[row] = value
            basis[row], other[at] = other[at], basis[row]
            _exchange(T, factor, row, at)
        side[0], t_row, driven, value, direction = FREE, 0, s, 0.0, 1.0
        column = other.index(s)
    for _ in range(10 * (n + 10)):
        factor = T[:, column].copy()
        rate = factor if direction > 0.0 else -factor
        distance = np.where(
            np.abs(rate) > SMALLEST_PIVOT, (np.where(rate < 0.0, low, high) - v) / rate, np.inf
        )
        row = int(distance.argmin())
        step = max(float(distance[row]), 0.0)
        if t_row >= 0 and distance[t_row] <= step * (1.0 + 1e-12):
            row = t_row
        own = value if driven == t else u[driven] if driven < n else math.inf
        if own <= step and own < math.inf:  # the driven variable reaches its other bound
            v += (direction * own) * factor
            if driven == t:
                break
            side[driven] = HIGH if direction > 0.0 else LOW
            driven, value, direction = n + driven, 0.0, -direction
            column = other.index(driven)
            continue
        if not step < math.inf:
            return np.full(n, np.nan)
        v += (direction * step) * factor
        v[row] = value + direction * step
        leaving, falls = basis[row], rate[row] < 0.0
        if driven < n:
            side[driven], low[row], high[row] = FREE, 0.0, u[driven]
        elif driven == t:
            t_row, low[row], high[row] = row, 0.0, math.inf
        else:
            i = driven - n
            low[row] = -math.inf if side[i] == HIGH or fixed[i] else 0.0
            high[row] = 0.0 if side[i] == HIGH else math.inf
        t_row = -1 if row == t_row and driven != t else t_row
        basis[row], other[column] = driven, leaving
        if leaving == t:
            break
        _exchange(T, factor, row, column)
        if leaving >= n:
            i = leaving - n
            driven, value, direction = (i, 0.0, 1.0) if side[i] == LOW else (i, u[i], -1.0)
        else:
            side[leaving] = LOW if falls else HIGH
            driven, value, direction = n + leaving, 0.0, 1.0 if falls else -1.0
        column = other.index(driven)
    else:
        return np.full(n, np.nan)
    return _solve_active_set(M, q, 0.0, width, np.array(side))


def _canonical(
    M: FloatVector, q: FloatVector, lower: FloatVector, upper: FloatVector
) -> tuple[FloatVector, FloatVector, FloatVector, Callable[[FloatVector], FloatVector]]:
    """Return (M, q, width, back) of the problem in the form 0 ≤ x ≤ width; free rows are eliminated, or split."""
    free = (lower == -np.inf) & (upper == np.inf)
    flips = (lower == -np.inf) & ~free
    base, sign = np.where(flips, upper, np.where(free, 0.0, lower)), np.where(flips, -1.0, 1.0)
    rows, n = sign * equation_signs(M, free), q.size
    b, A = rows * (q + M @ base), rows[:, None] * M * sign
    if not free.any():
        return A, b, upper - lower, lambda x: base + sign * x
    E, R = np.flatnonzero(free), np.flatnonzero(~free)
    to, block = A[np.ix_(R, E)], A[np.ix_(E, E)]
    try:
        S = np.linalg.solve(block, -np.column_stack([A[np.ix_(E, R)], b[E]]))
        is_regular = bool(np.abs(S).max() < WELL_CONDITIONED)
    except LinAlgError:
        is_regular = False
    if is_regular:

        def back(x: FloatVector) -> FloatVector:
            z = np.empty(n)
            z[R], z[E] = x, S[:, :-1] @ x + S[:, -1]
            return base + sign * z

        reduced = A[np.ix_(R, R)] + to @ S[:, :-1]
        return reduced, b[R] + to @ S[:, -1], (upper - lower)[R], back
    A = np.block([[A, -A[:, E]], [-A[E], block]])
    width = np.concatenate([upper - lower, np.full(E.size, np.inf)])

    def join(x: FloatVector) -> FloatVector:
        z = x[:n].copy()
        z[E] -= x[n:]
        return base + sign * z

    return A, np.concatenate([b, -b[E]]), width, join


def _rows_of_first_player(M: FloatVector, q: FloatVector) -> Any:
    """Return the rows of the first player of a bimatrix game, bool, or None."""
    first = M[0] == 0.0
    same = first[:, None] == first
    is_game = (q < 0.0).all() and not first.all() and ((M > 0.0) == ~same).all()
    return first if is_game else None
