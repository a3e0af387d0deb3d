"""Active sets of banded problems, one factorization of the band by LAPACK per round.

If M is tridiagonal with off-diagonal entries ≤ 0, and z bounded on one side, one pass of O(n) finds the free rows. Its
theory is due to Chandrasekaran, the order of the rows to Cryer. With all rows at their bounds, free a row whose w
is negative, then the next: z only rises, so that no free row returns to its bound. Take the rows from first to last,
with all later rows at their bounds. A row that becomes free raises its neighbors on both sides and joins the block of
free rows before it. If w becomes negative in the bound row before this block, that row also becomes free and joins the
next block. A block of free rows depends on the remaining rows only by the two values next to it, and z of its first and
last row is linear in these values. Two blocks and the row between them join by one division. Each row is joined once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.algorithm import Algorithm, Step
from ..core.checks import Vector, read_only
from ..core.entries import max_norm
from ..core.errors import UnsuitableMatrix
from ..core.kernels.compilation import helper, inline, kernel
from ..core.lcp import LCP
from ..core.matrix import Matrix, fact
from ..core.tuning import BANDED_PASSES
from ..systems.factors import Bands, bands
from ..systems.graph import bandwidth

NEGLIGIBLE_PIVOT = 1e-14  # relative to the diagonal entry; a smaller pivot makes the block singular
# The first row of no rows is the row to the right, the last row is the row to the left.
EMPTY = 0.0, 0.0, 1.0, 0.0, 1.0, 0.0
TURNS = 30  # direct rounds in which the sides take turns
TRIES = 10  # rounds without fewer wrong rows or fewer rows at bounds


@dataclass(frozen=True, kw_only=True)
class Banded(Algorithm):
    """Active sets of a banded M: solve for the rows off their bounds, then change the wrong rows.

    Notes
    -----
    An active-set iteration is one factorization of the free block, with pivots from the column, within the band: O(n)
    for a narrow band. Then all violated rows change: z leaves the bounds, or w has the wrong sign. On M-matrices with
    bounds on one side the changes are monotone and finite. The z of the final active set is refined once. A start
    determines the first active set.

    If M is tridiagonal and no off-diagonal entry is positive, the rows at the bounds of one side are found directly in
    O(n), with the rows at the other side fixed. One-sided bounds require one iteration; boxes require several, which
    alternate between the sides. After 30 iterations, the side is no longer alternated. On an M-matrix, z is monotone
    then and rows only leave the other side, so that the method terminates. The direct part is the method of Brennan and
    Schwartz if the contact set is one interval at an end, and Cryer's method in general.

    References
    ----------
    Cryer 1983, *ACM Trans. Math. Software* 9, 199–214, doi:10.1145/357456.357458. Brennan, Schwartz 1977, *J. Finance*
    32, 449–462, doi:10.2307/2326779. Chandrasekaran 1970, *Opsearch* 7, 263–268. Júdice, Pires 1994,
    doi:10.1016/0305-0548(94)90106-6.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[2, -1, 0], [-1, 2, -1], [0, -1, 2]], [-3, 4, 1])
    >>> lcp_plugin.solve(problem, Banded()).z
    array([1.5, 0. , 0. ])
    """

    name: ClassVar[str] = "banded"
    needs: ClassVar[str] = "a narrow band"
    solves: ClassVar[str] = "M-matrices, bounds on one side; tridiagonal ones"
    cost: ClassVar[str] = "1 factorization of the band"
    reference: ClassVar[str] = (
        "Cryer 1983, doi:10.1145/357456.357458; Júdice, Pires 1994, doi:10.1016/0305-0548(94)90106-6"
    )
    is_monotone: ClassVar[bool] = False
    ends_on_active_set: ClassVar[bool] = True

    def theorem(self, problem: LCP, report: Any) -> str | None:
        """Return the theorem on M-matrices."""
        is_one_sided = (problem.upper == np.inf).all() or (problem.lower == -np.inf).all()
        band = bands(problem.matrix)
        is_covered = is_one_sided or (band is not None and band.is_tridiagonal_z)
        if not is_covered or report.is_m_matrix is not True:
            return None
        what = "bounded on one side" if is_one_sided else "tridiagonal"
        return f"M is an M-matrix, {what}: the changes are monotone and finite (Chandrasekaran 1970, Cryer 1983)"

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the start, then z of each active set; end if no active set remains to be tried."""
        if (band := bands(problem.matrix)) is None:
            raise UnsuitableMatrix(
                f"{self.name} needs a narrow band, but the band of M with n = {problem.n} is too wide to factorize; "
                'try algorithm="auto"'
            )
        work = 0.0
        for z, residual in active_sets(problem, band, problem.q, z0):
            yield Step(z, residual, work=work or 1.0)
            work = (band.below + 2.0) * band.entries.size / max(problem.nonzeros, 1)


@fact
def banded_passes(matrix: Matrix) -> float:
    """Return the work of as many rounds as there usually are, in passes over M; ∞ if M is dense or no narrow band."""
    if matrix.is_dense:
        return math.inf
    M, middle = matrix.csr, matrix.n // 2
    columns = M.indices[M.indptr[middle] : M.indptr[middle + 1]] if matrix.n else np.zeros(0)
    if abs(columns - middle).max(initial=0) * 5.0 > BANDED_PASSES:
        return math.inf  # one row rules out most matrices without a scan of all rows
    below, above = bandwidth(matrix) or (0, 0)
    rounds, cost = 5.0, below + 2.0  # on random bands
    if max(below, above) <= 1 and (band := bands(matrix)) is not None and band.is_tridiagonal_z:
        # Passes over a tridiagonal M: the rows at bounds, the other rows, the residual.
        rounds, cost = 3.0, 3.0
    return rounds * cost * (below + above + 1.0) * matrix.n / max(matrix.nonzeros, 1)


def active_sets(problem: LCP, band: Bands, q: Vector, z0: Vector) -> Iterator[tuple[Vector, float]]:
    """Yield z, shape (n,), and its ‖r(z)‖∞: the start, then the z of one active set per round.

    An iteration solves w = 0 on the free rows, with all other rows at their bounds, and clips z to the bounds. Then
    every row changes whose z leaves the bounds or whose w has the wrong sign. If M is tridiagonal with off-diagonal
    entries ≤ 0, the rows at the bound of one side are found directly, with the rows at the other side fixed. The sides
    alternate until iteration TURNS; then one side stays, so that rows only leave the other side. A final active set is
    solved again with its residual as the right-hand side. This is unnecessary for such a tridiagonal matrix, because
    its elimination has no cancellation. The iterations end at a final active set, at a singular block, or if neither
    the number of wrong rows nor the number of rows at bounds has decreased in TRIES iterations.

    Parameters
    ----------
    problem : LCP
        The matrix and the bounds.
    band : Bands
        Bands of its matrix.
    q, z0 : arrays, shape (n,)
    """
    lower, upper, scale = problem.lower, problem.upper, problem.residual_scale
    is_fixed = lower == upper

    # at the edge of the number range ‖r(z)‖ is infinite
    def measured(z: Vector) -> tuple[Vector, NDArray[np.int8], float]:
        """Return w, the bounds that z − w/d reaches (−1, 0, 1) and ‖r(z)‖∞."""
        w = problem.matrix.array @ z + q
        step, above, beyond = w / scale, z - lower, z - upper
        side = (beyond >= step).astype(np.int8)
        side[is_fixed | (above <= step)] = -1
        return w, side, max_norm(np.clip(step, beyond, above))

    w, target, residual = measured(z0)
    yield z0, residual
    side = 1 if np.isfinite(lower).sum() >= np.isfinite(upper).sum() else -1
    is_direct, patience, fewest_wrong, fewest_held = band.is_tridiagonal_z, TRIES, np.inf, np.inf
    for k in itertools.count() if q.size else ():
        state, z = target, None
        if is_direct:
            state, z = _direct_contacts(problem, band, q, target, side)
            is_direct = z is not None
        if z is None:
            z = solve_on_band(band, state, np.where(state < 0, lower, upper), q)
        if z is None:
            return
        w, target, _ = measured(z)
        wrong = np.flatnonzero(state != target)
        if not (wrong.size or band.is_tridiagonal_z):
            step = solve_on_band(band, state, np.zeros(q.size), w)
            z = z if step is None else z + step
        inside = np.clip(z, lower, upper)
        yield inside, measured(inside)[2]
        if not wrong.size:
            return
        if is_direct:
            is_far = (state[wrong] == side) | (target[wrong] == side)
            is_direct = bool(is_far.any()) and k < TURNS + q.size
            side = -side if is_direct and k < TURNS else side
        if not is_direct:
            target = np.where(state == -target, 0, target).astype(np.int8)
            held = np.count_nonzero(target)
            is_better = wrong.size < fewest_wrong or held < fewest_held
            patience = TRIES if is_better else patience - 1
            fewest_wrong = min(float(wrong.size), fewest_wrong)
            fewest_held = min(float(held), fewest_held)
            if patience < 0:
                return


def _direct_contacts(
    problem: LCP, band: Bands, q: Vector, target: NDArray[np.int8], side: int
) -> tuple[NDArray[np.int8], Vector | None]:
    """Return the active set with directly found rows at the bound of side −side, and its z; None if this fails."""
    near, far = (problem.lower, problem.upper)[::side]
    is_held = (problem.lower == problem.upper) | (target == side)
    fixed, value, held = map(read_only, (q, np.where(is_held, far, near), is_held))
    z, is_free = solve_one_sided(band.entries, fixed, side, value, held)
    if z is None:
        return target, None
    return np.where(is_free, 0, np.where(is_held, side, -side)).astype(np.int8), z


def solve_one_sided(
    entries: Vector, q: Vector, side: int, value: Vector, is_held: NDArray[np.bool_]
) -> tuple[Vector | None, NDArray[np.bool_]]:
    """Return z and the free rows of a tridiagonal problem with bounds on one side; None on failure.

    Parameters
    ----------
    entries : array, shape (3, n)
        ``Bands.entries`` of M; no positive entry off the diagonal.
    q : array, shape (n,)
    side : int
        1 for lower bounds, −1 for upper ones.
    value : array, shape (n,)
        The bounds, ±∞ for none.
    is_held : array of bool, shape (n,)
        The rows that stay at their value.

    Notes
    -----
    All arrays should be read-only: numba compiles again for arrays that are not.
    """
    z, is_free = np.empty(q.size), np.empty(q.size, np.bool_)
    is_found = find_one_sided(entries, q, float(side), value, is_held, is_free, z)
    return z if is_found else None, is_free


def solve_on_band(band: Bands, state: NDArray[np.int8], value: Vector, q: Vector) -> Vector | None:
    """Return x with M x + q = 0 on rows of state 0 and x = value on all other rows; None if the block is singular.

    Parameters
    ----------
    band : Bands
        Bands of M.
    state : array of int, shape (n,)
    value, q : arrays, shape (n,)
    """
    right = np.where(state != 0, value, -q * band.weights)
    x = solve_held(held_entries(band, state != 0), band.below, right)
    return x if x is not None and np.isfinite(x).all() else None


def held_entries(band: Bands, is_held: NDArray[np.bool_]) -> Vector:
    """Return the bands of rows of size 1, for each active set: rows of the identity at their bounds.

    Parameters
    ----------
    band : Bands
    is_held : array of bool, shape (…, n)

    Returns
    -------
    array, shape (…, k, n)
    """
    entries = np.where(is_held[..., np.newaxis, :], 0.0, band.entries * band.weights)
    entries[..., band.below, :][is_held] = 1.0
    return entries


def solve_held(entries: Vector, below: int, right: Vector) -> Vector | None:
    """Return the solution of a banded system, None if it is singular.

    Parameters
    ----------
    entries : array, shape (k, n)
        Bands as in `Bands.entries`.
    below : int
        Number of subdiagonals.
    right : array, shape (n,)
    """
    from scipy.linalg import lapack  # slow to import

    n = right.size
    if len(entries) == 3 and below == 1 and n > 1:
        x, info = lapack.dgtsv(entries[0, 1:], entries[1], entries[2, :-1], right)[3:]
    else:
        above = len(entries) - 1 - below
        # the layout of LAPACK, with rows for its pivots
        columns = np.zeros((below + len(entries), n))
        for k, row in enumerate(entries):
            offset = k - below
            first, last = max(offset, 0), n + min(offset, 0)
            columns[below + above - offset, first:last] = row[first - offset : last - offset]
        x, info = lapack.dgbsv(below, above, columns, right)[2:]
    return x if info == 0 else None


# --- kernels -------------------------------------------------------------------------------------------------


@inline
def _join(before, after, a, d, c, q):  # type: ignore[no-untyped-def]
    """Return the block that results from two blocks and the free row between them, and the pivot of this row.

    A block is z of its first and of its last row, each as constant, factor of the left z, and factor of the right z.
    """
    pivot = d - a * before[5] - c * after[1]
    constant = (a * before[3] + c * after[0] - q) / pivot
    left, right = a * before[4] / pivot, c * after[2] / pivot
    first = before[0] + before[2] * constant, before[1] + before[2] * left, before[2] * right
    last = after[3] + after[4] * constant, after[4] * left, after[5] + after[4] * right
    return (first[0], first[1], first[2], last[0], last[1], last[2]), pivot


@helper
def _find_contacts(bands, q, sign, value, is_held, is_free, stops, blocks):  # type: ignore[no-untyped-def]
    """Fill is_free with the rows that are not at their bound in the least z ≥ value with w ≥ 0, complementary.

    Parameters
    ----------
    bands : array, shape (3, n)
        m_{i,i−1}, m_ii and m_{i,i+1}; 0 outside of M.
    q : array, shape (n,)
    sign : float
        1, or −1 for the problem of −z, with −q.
    value : array, shape (n,)
        The bound of each row, −∞ for none.
    is_held : array of flags, shape (n,)
        Rows that stay at their value for any w.
    is_free : array of flags, shape (n,)
    stops, blocks : arrays, shapes (n + 1,) of int64 and (n + 1, 7)
        Workspace: the rows at their bounds so far; the free rows before each, and its w.

    Returns
    -------
    bool
        False if a pivot is negligible or not positive: M is singular or not an M-matrix.
    """
    n = is_free.size
    top, left = 0, 0.0  # number of rows at bounds, and z of the last such row
    block = EMPTY  # the free rows behind it
    for i in range(n):
        a, d, c = -bands[0, i], bands[1, i], -bands[2, i]
        bound, after = value[i], value[i + 1] if i + 1 < n else 0.0
        # w without the part of the next row
        w = d * bound - a * (block[3] + block[4] * left + block[5] * bound) + sign * q[i]
        is_free[i] = (not is_held[i]) and (bound == -np.inf or w < c * after)
        if not is_free[i]:
            top += 1
            stops[top], blocks[top, 6], left = i, w, bound
            blocks[top, 0], blocks[top, 1], blocks[top, 2] = block[0], block[1], block[2]
            blocks[top, 3], blocks[top, 4], blocks[top, 5] = block[3], block[4], block[5]
            block = EMPTY
            continue
        block, pivot = _join(block, EMPTY, a, d, c, sign * q[i])
        if not pivot > NEGLIGIBLE_PIVOT * d:
            return False
        # a row without bound becomes free next, and the test follows then
        while top > 0 and after > -np.inf:
            k = stops[top]
            a, d, c = -bands[0, k], bands[1, k], -bands[2, k]
            part = c * (block[0] + block[1] * left + block[2] * after)
            if is_held[k] or not blocks[top, 6] < part:
                break
            is_free[k] = True
            kept = blocks[top]
            block, pivot = _join(
                (kept[0], kept[1], kept[2], kept[3], kept[4], kept[5]), block, a, d, c, sign * q[k]
            )
            if not pivot > NEGLIGIBLE_PIVOT * d:
                return False
            top -= 1
            left = value[stops[top]] if top > 0 else 0.0
    return True


@helper
def _substitute(bands, q, value, is_free, z, slope):  # type: ignore[no-untyped-def]
    """Fill z with `value` on the rows at their bounds and the solution of w = 0 on the free rows, without pivoting.

    On M-matrices that is backward stable in every entry (Higham, *Accuracy and stability*, SIAM 2002, theorem 9.12).
    """
    n = z.size
    constant = factor = 0.0
    for i in range(n):
        if is_free[i]:
            a = -bands[0, i]
            pivot = bands[1, i] - a * factor
            constant, factor = (a * constant - q[i]) / pivot, -bands[2, i] / pivot
        else:
            constant, factor = value[i], 0.0
        z[i], slope[i] = constant, factor
    for i in range(n - 2, -1, -1):
        z[i] += slope[i] * z[i + 1]


@kernel
def find_one_sided(bands, q, sign, value, is_held, is_free, z):  # type: ignore[no-untyped-def]
    """Fill z with the solution, and is_free with the free rows; return whether there is a solution.

    Parameters
    ----------
    bands : array, shape (3, n)
        m_{i,i−1}, m_ii and m_{i,i+1}; 0 outside of M.
    q : array, shape (n,)
    sign : float
        1 for z ≥ value and w ≥ 0; −1 for z ≤ value and w ≤ 0.
    value : array, shape (n,)
        The bound of each row, ±∞ for none.
    is_held : array of bool, shape (n,)
        Rows that stay at their value for any sign of w.
    is_free : array of bool, shape (n,)
    z : array, shape (n,)

    Returns
    -------
    bool
        False if a pivot is negligible or not positive: M is singular or not an M-matrix.
    """
    n = q.size
    stops, blocks = np.empty(n + 1, np.int64), np.empty((n + 1, 7))
    is_found = _find_contacts(bands, q, sign, sign * value, is_held, is_free, stops, blocks)
    if is_found:
        _substitute(bands, q, value, is_free, z, np.empty(n))
    return is_found
