"""Small dense LCPs in JAX: the path of :mod:`~lcp_plugin.core.kernels.small_lcps`, a sufficient test, derivatives.

All arrays have the batch as last axis, M of shape (n, n, B), so that one instruction serves several problems. XLA would
compute the operands of a pivot again for every entry of the table; a `cond` makes it compute them once.
"""

from __future__ import annotations

import math
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..core.checks import INFINITE_LIMIT, MAX_CROSSING, Array, check_kind, real_array
from ..core.errors import InvalidProblem, public
from ..core.kernels.floats import FREE, HIGH, INF, LOW, NEGLIGIBLE_DIAGONAL, SMALLEST_PIVOT
from ..core.settings import checked_tolerance
from ..judges.lcp import DEMAND_POWER, ROW_POWER
from .small import LOOP_UP_TO, tilts

# By bytes of a number; single precision shows no smaller residual of 30 unknowns
DEFAULT_TOLERANCES = {8: 1e-8, 4: 1e-3}


class _Path(NamedTuple):
    """Lemke's paths of B problems: the table of :func:`~lcp_plugin.core.kernels.small_lcps.follow_paths` and its rows.

    The basic variables `basis` are v + T x_N, within low and high; `columns` are the others, z_i = i, w_i = n + i,
    t = 2n. The variable `driven` moves from `value` in a direction. A path that has ended does not move any more.
    """

    T: Array
    v: Array
    low: Array
    high: Array
    basis: Array
    columns: Array
    sides: Array
    driven: Array
    value: Array
    direction: Array
    is_open: Array
    has_ended: Array


_gather = partial(jnp.take_along_axis, mode="promise_in_bounds")


def _at(table: Array, index: Array) -> Any:
    """Return entry `index` of each column of a table."""
    return _gather(table, index[None], 0)[0]


def _times(M: Array, x: Array) -> Any:
    """Return M x of each problem, without a product of matrices, which some devices round to fewer digits."""
    return (M * x[None]).sum(1)


def _pivot(T: Array, factor: Array, held: Array, keeps_row: Array, keeps_column: Array) -> Any:
    return keeps_row[:, None] * (keeps_column[None] * T) + factor[:, None] * held[None]


def _next_vertex(path: _Path, width: Array, count: int) -> tuple[_Path, Any]:
    """Return the paths after one step of each, an exchange or a move to another bound."""
    n, rows, t = len(path.v), jnp.arange(len(path.v))[:, None], 2 * len(path.v)
    T, v, low, high, basis, columns, sides, driven, value, direction, is_open, has_ended = path
    least = SMALLEST_PIVOT if v.dtype == np.float64 else 1e-5
    is_column = columns == driven
    factor = _gather(T, is_column.argmax(0)[None, None], 1)[:, 0]
    rate = direction * factor
    can_block = abs(rate) > least
    room = jnp.where(rate < 0.0, low, high) - v
    distance = jnp.where(can_block, room / jnp.where(can_block, rate, 1.0), INF)
    step = jnp.maximum(distance.min(0), 0.0)
    distance = jnp.where((basis == t) & (distance <= step * (1.0 + 1e-12)), -INF, distance)
    row = distance.argmin(0)
    wide, side = _at(width, driven % n), _at(sides, driven % n)
    reach = jnp.where(driven < n, wide, jnp.where(driven == t, value, INF))
    exchanges = (reach > step) | (reach == INF)  # else it reaches its other bound
    is_open &= ~(exchanges & (step == INF))
    exchanges &= is_open
    v += jnp.where(is_open, direction * jnp.where(exchanges, step, reach), 0.0) * factor
    leaving = jnp.where(exchanges, _at(basis, row), driven)
    slope = jnp.where(exchanges, _at(rate, row), direction)
    is_row, is_column, is_slack = (rows == row) & exchanges, is_column & exchanges, driven // n == 1
    was_high = is_slack & (side == HIGH)
    v = jnp.where(is_row, value + direction * step, v)
    low = jnp.where(is_row, jnp.where(was_high | (is_slack & (wide == 0.0)), -INF, 0.0), low)
    high = jnp.where(is_row, jnp.where(driven < n, wide, jnp.where(was_high, 0.0, INF)), high)
    sides = jnp.where((rows == driven) & exchanges, FREE, sides)
    inverse = -1.0 / jnp.where(exchanges, _at(factor, row), 1.0)
    held = _gather(T, row[None, None], 0)[0] * inverse
    held = jnp.where(exchanges, jnp.where(is_column, -inverse, held), 0.0)
    operands = jnp.where(is_row, 1.0, factor), held, 1.0 - is_row, 1.0 - is_column
    operands = tuple(array.astype(v.dtype) for array in operands)
    T = jax.lax.cond(exchanges.any(), _pivot, lambda T, *_: T, T, *operands)
    basis = jnp.where(is_row, driven, basis)
    columns = jnp.where(is_column, leaving, columns)
    has_ended |= is_open & (leaving == t)
    is_open &= leaving != t
    sides = jnp.where((rows == leaving) & is_open, jnp.where(slope > 0.0, HIGH, LOW), sides)
    is_unknown = leaving < n
    is_high = ~is_unknown & (_at(sides, leaving % n) == HIGH)
    back = jnp.where(is_unknown, -jnp.sign(slope), jnp.where(is_high, -1.0, 1.0))
    driven = jnp.where(is_unknown, leaving + n, leaving - n)
    value = jnp.where(is_high, _at(width, leaving % n), 0.0)
    return _Path(
        *(T, v, low, high, basis, columns, sides, driven, value, back, is_open, has_ended)
    ), count + 1


def _path_ends(M: Array, q: Array, lower: Array, upper: Array) -> tuple[Any, Any]:
    """Return z at the ends of Lemke's paths, solved for the data, and the mask of its free rows, False on a ray.

    A free unknown is between bounds on its path that are far from the data. The table at the end contains the inverse
    of M on the free rows, with which z is refined.
    """
    n, largest = len(q), abs(M).max(1)
    has_no_bound, is_below = (lower == -INF) & (upper == INF), lower == -INF
    base = jnp.where(has_no_bound, 0.0, jnp.where(is_below, upper, lower))
    sign = jnp.where(is_below & ~has_no_bound, -1.0, 1.0).astype(q.dtype)
    largest = jnp.where(largest > 0.0, largest, 1.0)
    scale = sign / largest
    v = scale * (q + _times(M, base))
    size = abs(v).max(0)
    reach = jnp.finfo(q.dtype).eps ** -0.4 * jnp.maximum(size, abs(q).max(0) / largest)
    far = jnp.where(has_no_bound, reach, 0.0)
    T = M * scale[:, None] * sign[None]
    perturbed = jnp.finfo(q.dtype).eps ** 0.7 * size * jnp.asarray(tilts(n), q.dtype)[:, None]
    # An equation may hold at one point
    v += jnp.where(has_no_bound, 0.0, perturbed) - _times(T, far)
    base, width = base - far, jnp.where(has_no_bound, 2.0 * far, upper - lower)
    value = jnp.where(width == 0.0, 0.0, -v).max(0, initial=0.0)
    zero, count, is_open = jnp.zeros_like(q), q.shape[1], jnp.ones(q.shape[1], bool)
    columns = jnp.append(jnp.arange(n), 2 * n)[:, None]
    path = _Path(
        jnp.concatenate([T, zero[:, None] + 1.0], 1),
        *(v + value, jnp.where(width == 0.0, -INF, zero), zero + INF),
        jnp.broadcast_to(n + jnp.arange(n)[:, None], q.shape),
        jnp.broadcast_to(columns, (n + 1, count)),
        *(jnp.full(q.shape, LOW), jnp.full(count, 2 * n), value, -jnp.ones_like(value)),
        *(is_open, ~is_open),
    )
    path, _ = jax.lax.while_loop(
        lambda state: state[0].is_open.any() & (state[1] < 10 * (n + 10)),
        lambda state: _next_vertex(state[0], width, state[1]),
        (path, 0),
    )
    place = jnp.where(path.basis < n, path.basis, n), jnp.arange(count)
    is_free = path.sides == FREE
    slacks = jnp.clip(path.columns - n, 0, n - 1)
    is_slack = path.columns // n == 1
    ends = jnp.where((path.sides == HIGH) == (sign > 0.0), upper, lower)
    z = base + sign * zero.at[place].set(path.v, mode="drop")
    ends = jnp.where(has_no_bound, jnp.where(path.sides == HIGH, far, -far), ends)
    z = jnp.where(is_free, z, ends)
    for _ in range(2):
        wrong = jnp.where(is_free, -scale * (q + _times(M, z)), 0.0)
        wrong = jnp.where(is_slack, _gather(wrong, slacks, 0), 0.0)
        z += jnp.where(is_free, sign * zero.at[place].set(_times(path.T, wrong), mode="drop"), 0.0)
    return jnp.where(path.has_ended, z, jnp.nan), is_free & path.has_ended


class _Rows(NamedTuple):
    """Slack, terms and a bound of the rounding error of the slack of each row at a point, in this precision."""

    w: Array
    terms: Array
    rounding: Array

    @classmethod
    def at(cls, M: Array, q: Array, z: Array) -> _Rows:
        """Return the values of all rows at z."""
        products, info = _times(abs(M), abs(z)), jnp.finfo(q.dtype)
        terms = products + abs(q)
        # Of a sum here, and of a second one in double precision
        unit = 0.5 * float(info.eps) + 3.0 * 2.0**-53
        rounding = (len(q) + 8) * (unit * terms + float(info.tiny) * (1.0 + abs(z).sum(0)))
        return cls(q + _times(M, z), terms, jnp.where(products > 0.0, rounding, 0.0))

    def residual_ends(self, z: Array, lower: Array, upper: Array, scale: Array) -> tuple[Any, Any]:
        """Return bounds of each |r_i|, for all slacks within w ± rounding."""
        ends = (self.w - self.rounding) / scale, (self.w + self.rounding) / scale
        bottom, top = (jnp.clip(end, z - upper, z - lower) for end in ends)
        return jnp.maximum(jnp.maximum(bottom, -top), 0.0), jnp.maximum(-bottom, top)


def _is_extreme(x: Array) -> Any:
    """Return the problems with a finite number below 2⁻³⁴⁰ or above 2³⁴⁰ that is not 0; 2⁻⁴² in single precision.

    Products and quotients of three such numbers may underflow, and devices take subnormal numbers for 0.
    """
    info, kind = jnp.finfo(x.dtype), jnp.int64 if x.dtype == np.float64 else jnp.int32
    size = jax.lax.bitcast_convert_type(x, kind) & jnp.iinfo(kind).max
    power = 2.0 ** (info.minexp // 3)
    least, most, infinite = np.array([power, 1.0 / power, INF], x.dtype).view(np.dtype(kind))
    is_extreme = (size > 0) & (size < least) | (size > most) & (size < infinite)
    return is_extreme.any(tuple(range(x.ndim - 1)))


def _parts(M: Array) -> Any:
    """Return the least row of the connected component of each row, shape (n, B)."""
    rows, links = jnp.arange(len(M))[:, None], (M != 0.0) | (M != 0.0).swapaxes(0, 1)

    def join(state: Array) -> Any:
        label, _ = state
        least = jnp.minimum(label, jnp.where(links, label[None], len(M)).min(1))
        least = _gather(least, least, 0)
        return least, (least != label).any()

    first = jnp.where(links[0] | (rows == 0), 0, rows)
    return jax.lax.while_loop(lambda state: state[1], join, (first, (first > 0).any()))[0]


def _largest(part: Array, *values: Array) -> list[Any]:
    """Return the largest of values ≥ 0 in the component of each row."""

    def of_parts(values: Array) -> Any:
        is_same = part[:, None] == part[None]
        return [jnp.where(is_same, value[None], 0.0).max(1) for value in values]

    def of_all(values: Array) -> Any:
        return [jnp.broadcast_to(value.max(0), value.shape) for value in values]

    return jax.lax.cond((part > 0).any(), of_parts, of_all, list(values))


def _accepted(
    M: Array, q: Array, lower: Array, upper: Array, z: Array, tolerance: Array
) -> tuple[Any, Any]:
    """Return points and bounds of their relative residuals, ∞ unless the stopping criterion accepts them: a proof.

    The point is z with z° in components that z° solves, and with values near a bound at it. The test implies the
    criterion of :mod:`lcp_plugin.judges.lcp` in double precision, because

    - w computed in any order, here or in double precision, is within `rounding` of w as computed here, and r is
      monotone in w, so that the ends here enclose the ends there; a problem with extreme data is not accepted;
    - each `high` is at most .9 tolerance times `limit`, a lower bound of the reference up to 1e-4 if the criterion does
      not find r_i = 0: it then counts the terms of row i, and the terms of free rows of the component always; a slack
      at z° below the least normal number counts as 0;
    - the step −w_i/d_i, rounding included, ends before a bound, or z_i is at that bound: the criterion moves nothing;
    - each violation is at most 2⁻⁴³ T_i, half of the limit of test 2 at any tolerance, as in the compiled test
      :func:`~lcp_plugin.judges.lcp.bound_residuals`, or with rounding at most half of the other limit of test 2, whose
      demand a_i is bounded from below.
    """
    tiny = jnp.finfo(q.dtype).tiny
    sizes, diagonal = abs(M), jnp.einsum("iib->ib", M)
    largest = sizes.max(1)
    scale = jnp.where(largest > 0.0, largest, 1.0)
    is_scale = (diagonal > 0.0) & (diagonal >= NEGLIGIBLE_DIAGONAL * largest)
    scale, part = jnp.where(is_scale, diagonal, scale), _parts(M)
    start = jnp.clip(0.0, lower, upper)
    at = _Rows.at(M, q, start)
    first, last = at.residual_ends(start, lower, upper, scale)
    first, last = _largest(part, jnp.where(abs(at.w) > 4.0 * tiny, first, 0.0), last)
    demand = jnp.where(abs(at.w) > 2.0**-41 * at.terms + 2.0 * at.rounding, 0.5 * abs(at.w), 0.0)
    demand = jnp.maximum(demand, (sizes * (demand / scale)[None]).max(1))
    z = jnp.where(last == 0.0, start, jnp.clip(z, lower, upper))
    at = _Rows.at(M, q, z)
    for bound, distance, slack in ((lower, z - lower, at.w), (upper, upper - z, -at.w)):
        reach = jnp.maximum((slack + at.rounding) * (1.0 + 2.0**-10) / scale, 2.0**-47 * abs(z))
        z = jnp.where(distance <= reach, bound, z)
    at = _Rows.at(M, q, z)
    _, high = at.residual_ends(z, lower, upper, scale)
    violation = scale * abs(jnp.clip(at.w / scale, z - upper, z - lower))
    is_free = (z > lower) & (z < upper)
    counts = _largest(part, jnp.where(is_free, at.terms / scale, 0.0))[0]
    limit = jnp.minimum(first, jnp.maximum(counts, at.terms / scale))
    residual = jnp.where(high > 0.0, high / limit, 0.0)
    allowed = 0.5 * jnp.minimum(tolerance**ROW_POWER * at.terms, tolerance**DEMAND_POWER * demand)
    is_small = scale * high <= allowed
    if q.dtype == np.float64:
        is_small |= violation <= 2.0**-43 * at.terms
    stays = (z == lower) | (at.w + at.rounding < scale * (z - lower) * (1.0 - 2.0**-11))
    stays &= (z == upper) | (at.rounding - at.w < scale * (upper - z) * (1.0 - 2.0**-11))
    is_right = is_small & stays & (at.terms < INF) & (residual <= 0.9 * tolerance)
    is_right &= (lower <= upper) & (lower < INF) & (upper > -INF)
    is_right = is_right.all(0)
    is_right &= ~(_is_extreme(M) | _is_extreme(jnp.concatenate([q, lower, upper])))
    return z, jnp.where(is_right, residual.max(0, initial=0.0), INF)


def _solve_together(*data: Array) -> tuple[Any, Any, Any]:
    """Return the results of `solve_stack`, all problems at once."""
    M, q, lower, upper, tolerance = data
    M, q, lower, upper = (jnp.moveaxis(array, 0, -1) for array in (M, q, lower, upper))
    lower = jnp.where(lower <= -INFINITE_LIMIT, -INF, lower)
    upper = jnp.where(upper >= INFINITE_LIMIT, INF, upper)
    z, is_free = _path_ends(M, q, lower, upper)
    z, residual = _accepted(M, q, lower, upper, z, tolerance)
    is_solved = residual < INF
    z, is_free = jnp.where(is_solved, z, 0.0), (is_free & is_solved).astype(q.dtype)
    return z.T, is_free.T, residual


def _solve_in_parts(*data: Array) -> Any:
    """Return the results of `solve_stack`, of so many problems at once that their tables stay in the cache."""
    arrays, tolerance = data[:4], data[4]
    count, n = arrays[1].shape
    size = min(max(2**17 // n**2, 16), 512)
    if count <= size:
        return _solve_together(*data)
    items = jnp.minimum(jnp.arange(-(-count // size) * size), count - 1).reshape(-1, size)
    found = jax.lax.map(lambda k: _solve_together(*(x[k] for x in arrays), tolerance), items)
    return tuple(x.reshape(-1, *x.shape[2:])[:count] for x in found)


@jax.custom_batching.custom_vmap  # type: ignore[untyped-decorator]
@jax.jit  # type: ignore[untyped-decorator]
def solve_stack(
    M: Array, q: Array, lower: Array, upper: Array, tolerance: Array
) -> tuple[Any, Any, Any]:
    """Return z, 0 if not solved, the rows solved for as 0 or 1, and bounds of the residuals, ∞ if not solved.

    The arrays have the batch as first axis, as results have.
    """
    data = M, q, lower, upper, tolerance
    return jax.lax.platform_dependent(*data, cpu=_solve_in_parts, default=_solve_together)


@solve_stack.def_vmap  # type: ignore[untyped-decorator]
def _solve_mapped_stack(size: int, are_mapped: Array, *data: Array) -> Any:
    """Join a mapped axis and the axis of the batch."""
    *arrays, tolerance = data
    wide = (
        array if is_mapped else jnp.broadcast_to(array, (size, *array.shape))
        for array, is_mapped in zip(arrays, are_mapped, strict=False)
    )
    count = data[1].shape[are_mapped[1]]
    stacks = (array.reshape(size * count, *array.shape[2:]) for array in wide)
    results = solve_stack(*stacks, tolerance)
    return tuple(x.reshape(size, count, *x.shape[1:]) for x in results), (True,) * 3


@jax.custom_jvp  # type: ignore[untyped-decorator]
def _solved(M: Array, q: Array, lower: Array, upper: Array, tolerance: Array) -> Any:
    """Return the results of `solve_stack`, as a function with derivatives."""
    return solve_stack(M, q, lower, upper, tolerance)


@_solved.defjvp  # type: ignore[untyped-decorator]
def _change_of_solution(data: Array, changes: Array) -> Any:
    """Return the solutions and their changes: rows strictly between bounds keep w = 0, others follow their bounds.

    If M is singular on these rows, degenerate rows of the path count as free, as in
    :class:`lcp_plugin.problems.sensitivity.Derivative`. A problem that is not solved does not change.
    """
    M, q, lower, upper, _ = data
    dM, dq, dlower, dupper, _ = changes
    z, path, residual = _solved(*data)
    is_solved = (residual < INF)[:, None]
    M = jnp.where(is_solved[..., None], M, 0.0)
    identity, largest = jnp.eye(q.shape[1], dtype=q.dtype), abs(M).max(-1, keepdims=True)
    largest = jnp.where(largest > 0.0, largest, 1.0)

    def system(is_free: Array) -> Any:
        return jnp.where(is_free[..., None], M / largest * is_free[:, None], identity)

    is_free = is_solved & (z > lower) & (z < upper)
    pivots = abs(jnp.diagonal(jax.lax.linalg.lu(system(is_free))[0], axis1=1, axis2=2))
    is_regular = pivots.min(1) > 16.0 * jnp.finfo(q.dtype).eps * q.shape[1] * pivots.max(1)
    is_free = jnp.where(is_regular[:, None], is_free, path > 0.0)
    w = jnp.where(is_solved, q, 0.0) + (M * z[:, None]).sum(-1)
    is_upper = jnp.where(lower == upper, w < 0.0, z == upper)
    moved = jnp.where(is_free | ~is_solved, 0.0, jnp.where(is_upper, dupper, dlower))
    right = dq + (dM * z[:, None]).sum(-1) + (M * moved[:, None]).sum(-1)
    right = jnp.where(is_free, -right / largest[..., 0], moved)
    dz = jnp.linalg.solve(system(is_free), right[..., None])[..., 0]
    return (z, path, residual), (dz, jnp.zeros_like(path), jnp.zeros_like(residual))


@public
def solve_lcp(
    M: Array, q: Array, lower: Array = 0.0, upper: Array = INF, *, tolerance: float | None = None
) -> tuple[Any, Any]:
    """Return the solution z of a small dense LCP, and whether it is proved to be one, by operations of JAX only.

    Used within ``jit``, ``vmap``, ``grad``, ``jacfwd`` and ``lax.scan``, on every device of JAX, without a callback.

    Parameters
    ----------
    M : array, shape (…, n, n), n at most 128
    q : array, shape (…, n)
        Leading axes are batch axes, and broadcast. Arrays of JAX in float64 or float32, or numbers, which become
        float64 if JAX has it.
    lower, upper : array, shape (…, n), or number
    tolerance : float, optional
        Of the stopping criterion of SOLVED; 1e-8 in double precision, 1e-3 in single precision.

    Returns
    -------
    z : array, shape (…, n)
        0 unless solved.
    is_solved : array of bool, shape (…)
        True only if :func:`lcp_plugin.certify` proves z at the tolerance. False proves nothing about the problem: pass
        it to :func:`lcp_plugin.solve`.

    Raises
    ------
    InvalidProblem
        If shapes do not fit together, n is larger, or lower > upper, unless JAX traces the bounds.
    InvalidOption
        If the tolerance is not between 0 and 1, or for another argument.

    Notes
    -----
    Lemke's path, refined on its last active set, and a sufficient test of the criterion. Derivatives are forward and
    backward, by M, q, lower and upper. They are exact unless a row is at a bound with w = 0; they then belong to the
    piece on which such rows stay at their bounds. A problem that is not solved has the derivative 0.

    Examples
    --------
    >>> jax.config.update("jax_enable_x64", True)
    >>> M, q = jnp.array([[2.0, 1.0], [1.0, 2.0]]), jnp.array([[-5.0, 1.0], [1.0, -4.0]])
    >>> z, is_solved = jax.jit(jax.vmap(solve_lcp, (None, 0)))(M, q)
    >>> z.tolist(), is_solved.tolist()
    ([[2.5, 0.0], [0.0, 2.0]], [True, True])
    >>> (jax.jacfwd(lambda q: solve_lcp(M, q)[0])(q[0]) + 0.0).tolist()
    [[-0.5, 0.0], [0.0, 0.0]]
    """
    M, q, lower, upper = checked_arrays(M, q, lower, upper)
    crosses = lower > upper + MAX_CROSSING * jnp.finfo(q.dtype).eps * abs(upper)
    if not isinstance(crosses, jax.core.Tracer) and crosses.any():
        raise InvalidProblem("lower exceeds upper; bounds must satisfy lower ≤ upper: swap them")
    axes, n, dtype = q.shape[:-1], q.shape[-1], q.dtype
    tolerance = DEFAULT_TOLERANCES[dtype.itemsize] if tolerance is None else tolerance
    if not isinstance(tolerance, jax.Array):
        checked_tolerance(tolerance, may_be_zero=False)
    count = math.prod(axes)
    vectors = (array.reshape(count, n) for array in (q, lower, upper))
    z, _, residual = _solved(M.reshape(count, n, n), *vectors, tolerance)
    return z.reshape(*axes, n), (residual < INF).reshape(axes)


def checked_arrays(*arrays: Array) -> list[Any]:
    """Return M, q, lower and upper with all batch axes and of one type, float64 or float32; raise InvalidProblem."""
    arrays = tuple(map(real_values, arrays, ("M", "q", "lower", "upper")))
    dtype, shapes = jnp.result_type(*arrays[:2]), [array.shape for array in arrays]
    if dtype not in (np.float32, np.float64):
        raise InvalidProblem(f"M and q must be arrays of float64 or float32, got {dtype}")
    n = shapes[1][-1] if shapes[1] else 0
    if shapes[0][-2:] == (n, n) and 0 < n <= LOOP_UP_TO:
        with suppress(ValueError):
            axes = np.broadcast_shapes(shapes[0][:-2], *(shape[:-1] for shape in shapes[1:]))
            ends = [(n, n), (n,), (n,), (n,)]
            pairs = zip(arrays, ends, strict=True)
            return [jnp.broadcast_to(array, (*axes, *end)).astype(dtype) for array, end in pairs]
    raise InvalidProblem(
        f"M must have shape (…, n, n), q (…, n), bounds (…, n) or be numbers, 1 ≤ n ≤ {LOOP_UP_TO}; got M {shapes[0]}, "
        f"q {shapes[1]}, lower {shapes[2]}, upper {shapes[3]}"
    )


def has_arrays(values: Array) -> bool:
    """Return whether the values are an array of JAX, or contain one."""
    return any(isinstance(part, jax.Array) for part in jax.tree.leaves(values))


def real_values(values: Array, name: str) -> Any:
    """Return the values as an array of JAX, in double precision unless they are floats of another type."""
    need = f"{name} must be an array of real numbers"
    is_single = getattr(values, "dtype", None) == np.float32
    if not (is_single or has_arrays(values)):
        values = real_array(values, need)
    array = jnp.asarray(values)
    if jnp.issubdtype(array.dtype, jnp.floating):
        return array
    check_kind(array.dtype, need)
    return array.astype(float)
