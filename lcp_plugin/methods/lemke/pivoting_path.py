"""Paths of complementary pivoting: starts, state, and tests of their accuracy.

They start along covering vectors, at the labels of a game or inside random active sets. Before that, a dense problem
is stated as 0 ≤ z ≤ u with u > 0, without fixed and free rows. Bimatrix games are detected by signs only, and solved
along Lemke and Howson's paths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core import deadline
from ...core.checks import Array, FloatMatrix, Indices, Vector
from ...core.entries import max_norm, unbounded
from ...core.kernels.floats import DATA_ROUNDING
from ...core.lcp import LCP
from ...core.matrix import fact
from ...core.rounding import ROUNDING
from ...core.structure import equation_signs
from ...core.tuning import PIVOTS_FIRST_UP_TO
from ...systems.equilibration import power_of_two
from ..small import bimatrix_players
from . import tableau


@dataclass(frozen=True, eq=False)
class CanonicalBox:
    """Canonical problem (M, q, upper), and the inverse mapping z[rows] = offset[rows] + step z̄ with the elimination.

    Attributes
    ----------
    M : ndarray, shape (k, k)
        The largest entry of each row is about 1.
    q, upper : ndarray, shape (k,)
        max |q_i| is about 1; upper > 0.
    offset : ndarray, shape (n,)
    rows : ndarray, shape (k,)
        Variable of the problem for each canonical variable, up to shift, sign and scale; split variables appear twice.
    step : ndarray, shape (k,)
        Change of that variable per unit of the canonical variable; negative if the bounds are exchanged, and 0 if the
        canonical variable is w of that row.
    eliminated : ndarray, shape (g,)
        Eliminated variables: free variables, and variables whose place w has taken.
    elimination : ndarray, shape (g, k)
        Change of each eliminated variable per unit of a canonical variable.
    """

    M: FloatMatrix
    q: Vector
    upper: Vector
    offset: Vector
    rows: Indices
    step: Vector
    eliminated: Indices
    elimination: FloatMatrix

    @property
    def work(self) -> float:
        """Entries that the elimination touched: a factorization and its solves."""
        g, k = self.eliminated.size, float(self.q.size)
        return g * (g * g / 3.0 + g * k + k * k)

    @property
    def is_finite(self) -> bool:
        """True if all arrays are finite."""
        parts = self.M, self.q, self.step, self.elimination, self.offset
        return all(bool(np.isfinite(part).all()) for part in parts)

    def recover(self, z: Vector) -> Vector:
        """Return the z of the problem, shape (n,), for a z of the canonical problem, shape (k,)."""
        result = np.array(self.offset)
        np.add.at(result, self.rows, self.step * z)
        result[self.eliminated] += self.elimination @ z
        return result


def canonical_box(problem: LCP) -> CanonicalBox:
    """Return the problem in canonical form; M is made dense.

    Fixed rows (lower = upper) go into q. Rows with an upper bound only change sign. Free rows are eliminated. If their
    block is singular, rows with one bound complete it, as a basis of the equations completes multipliers. Other free
    variables become differences of two nonnegative ones.
    """
    M = problem.matrix.toarray()
    row_scale = 1 - np.frexp(problem.matrix.row_largest)[1]
    is_free = unbounded(problem.lower, problem.upper)
    sign = np.where((problem.lower == -np.inf) & ~is_free, -1.0, 1.0)
    base = np.where(is_free, 0.0, np.where(sign > 0.0, problem.lower, problem.upper))
    # The scale of a row may take its q to the exponent 1000.
    row_scale = np.minimum(row_scale, 1000 - np.frexp(problem.q)[1])
    M, column_scale, more = _equilibrated(np.ldexp(M, row_scale[:, None]))
    row_scale = row_scale + more
    is_void = (problem.q == 0.0) & ~M.any(axis=1)
    if is_void.any():
        # A zero row is always satisfied. With minus its column as row i, z_i acts like a multiplier of the other rows.
        M = np.where(is_void[:, None], -M.T, M)
    rows = sign * equation_signs(M, is_free)
    M = M * rows[:, None] * sign
    q = np.ldexp(problem.q, row_scale) * rows + M @ np.ldexp(base * sign, -column_scale)
    upper = np.where(is_free, np.inf, np.ldexp(problem.upper - problem.lower, -column_scale))
    unit = np.ldexp(sign, column_scale)
    keep = np.flatnonzero(problem.lower < problem.upper)
    if keep.size < problem.n:
        M = M[np.ix_(keep, keep)]
    return _without_free_rows(M, q[keep], upper[keep], unit, base, keep, is_free[keep])


def _equilibrated(M: FloatMatrix) -> tuple[FloatMatrix, Indices, Indices]:
    """Return M with columns and rows of size 1 and the exponents of both, which are 0 if the units are alike."""
    column, row = np.zeros((2, len(M)), np.intp)
    for _ in range(8):
        change = -np.frexp(np.abs(M).max(axis=0, initial=0.0))[1]
        # Columns whose sizes differ by less stay.
        if max_norm(change) <= 10:
            break
        M, column = np.ldexp(M, change), column + change
        change = 1 - np.frexp(np.abs(M).max(axis=1, initial=0.0))[1]
        M, row = np.ldexp(M, change[:, None]), row + change
    return M, column, row


def _without_free_rows(
    M: Array, q: Vector, upper: Vector, unit: Vector, base: Vector, keep: Array, is_free: Array
) -> CanonicalBox:
    free, one_sided = np.flatnonzero(is_free), np.flatnonzero(~is_free & (upper == np.inf))
    kept, empty = _independent(M, free), free[:0]
    choices = [(kept, empty), (empty, empty)] if free.size else [(empty, empty)]
    if kept.size < free.size:
        choices.insert(0, _with_partners(M, kept, np.setdiff1d(free, kept), one_sided))
    for gone, partners in choices:
        basic, stays = np.append(gone, partners), np.delete(np.arange(keep.size), gone)
        place, columns = np.searchsorted(stays, partners), np.column_stack([M[:, stays], q])
        # z and w of a partner's row change places
        columns[:, place], columns[partners, place] = 0.0, -1.0
        solution = _solved_block(M, basic, columns[basic])
        if solution is not None:
            break
    reduced = _cleaned_product(M[np.ix_(stays, basic)], solution, columns[stays])
    reduced[place] = solution[gone.size :]
    M, q, upper, rows = reduced[:, :-1], reduced[:, -1], upper[stays], keep[stays]
    offset, elimination = base.copy(), solution[:, :-1]
    offset[keep[basic]] += solution[:, -1] * unit[keep[basic]]
    step, split = unit[rows], np.flatnonzero(is_free[stays])
    step[place] = 0.0
    if split.size:  # z_i = z_i⁺ − z_i⁻ on these rows
        M = np.block([[M, -M[:, split]], [-M[split], M[np.ix_(split, split)]]])
        q, upper = np.append(q, -q[split]), np.append(upper, upper[split])
        rows, step = np.append(rows, rows[split]), np.append(step, -step[split])
        elimination = np.hstack([elimination, -elimination[:, split]])
    size = power_of_two(max_norm(q))
    q, upper, step, gone = q / size, upper / size, step * size, keep[basic]
    elimination = elimination * (unit[gone] * size)[:, None]
    return CanonicalBox(M, q, upper, offset, rows, step, gone, elimination)


def _independent(M: FloatMatrix, free: Indices) -> Indices:
    """Return the free rows whose pivots in a factorization of their block are not at rounding level."""
    if not free.size:
        return free
    from scipy.linalg import lapack

    pivots = np.abs(lapack.dgetrf(M[np.ix_(free, free)])[0].diagonal())
    return np.asarray(free[pivots > max(1e-8 * pivots.max(), 2.0**-48)])


def _with_partners(
    M: FloatMatrix, kept: Indices, lost: Indices, one_sided: Indices
) -> tuple[Indices, Indices]:
    """Return free rows, and as many other rows as may make their common block regular."""
    solution = _solved_block(M, kept, M[np.ix_(kept, one_sided)])
    if solution is None or not (lost.size and one_sided.size):
        return kept, lost[:0]
    from scipy.linalg import qr

    block = M[np.ix_(lost, one_sided)] + M[np.ix_(lost, kept)] @ solution
    R, order = qr(block, mode="r", pivoting=True)
    pivots = np.abs(R.diagonal())
    order = order[: np.count_nonzero(pivots > 1e-8 * pivots[0])]
    rows = qr(block[:, order].T, mode="r", pivoting=True)[1][: order.size]
    return np.append(kept, lost[rows]), one_sided[order]


def _solved_block(M: FloatMatrix, rows: Indices, right: FloatMatrix) -> Any:
    """Return −block⁻¹ right for the block of these rows; None if it is ill-conditioned."""
    if not rows.size:
        return np.empty(right.shape)
    from scipy.linalg import lapack

    block = M[np.ix_(rows, rows)]
    factor, pivots, info = lapack.dgetrf(block)
    if info or not lapack.dgecon(factor, np.linalg.norm(block, 1))[0] > 1e-8:
        return None
    return np.asarray(lapack.dgetrs(factor, pivots, -right)[0], dtype=np.float64)


@fact
def is_game(problem: LCP) -> bool:
    """Return whether the problem is a game of costs, z ≥ 0, and small enough that pivots come first.

    Examples
    --------
    >>> is_game(LCP([[0, 0, 1, 2], [0, 0, 2, 1], [2, 1, 0, 0], [1, 2, 0, 0]], [-1, -1, -1, -1]))
    True
    """
    if not (problem.is_dense or problem.n <= PIVOTS_FIRST_UP_TO) or problem.diagonal.any():
        return False
    is_cone = not problem.lower.any() and bool((problem.upper == np.inf).all())
    return is_cone and bimatrix_players(problem.matrix.toarray(), problem.q) is not None


Move = tuple[int, float]  # the driven variable, and its direction

# relative to each |q|, and to the smallest nonzero |q| where q is 0: no two rows block at once
TIE_BREAK = 2.0**-48
# of the largest basic variable: largest violation of the bounds of a basic variable
OUTSIDE_TOLERANCE = 1e-7


class LemkePath:
    """The path of w = M z + q + t r, 0 ≤ z ≤ u complementary, from a start towards t = 0.

    It is one class because all methods read or pivot one table.

    Parameters
    ----------
    M : ndarray, shape (n, n)
        Equilibrated; not modified.
    q, upper : ndarray, shape (n,)
        The path perturbs q; `upper` is positive, ∞ allowed.
    """

    def __init__(self, M: FloatMatrix, q: Vector, upper: Vector) -> None:
        self.M, self.upper = M, upper
        self.n = n = q.size
        tilts = np.random.default_rng(1).uniform(1.0, 2.0, n)
        sizes = np.abs(q)
        sizes[q == 0.0] = sizes.min(where=q != 0.0, initial=sizes.max(initial=0.0))
        self.q = q + TIE_BREAK * sizes * tilts
        self.absolute, self.columns = np.abs(M), np.column_stack([M, np.zeros(n)])
        self.real = np.zeros((5, n + 1))
        self.whole = np.zeros((5, 2 * n + 1), dtype=np.int64)
        self.matrix = np.zeros((n + 1, n + 1))
        self.real[tableau.WIDTH, :n] = upper
        self.basis = self.whole[tableau.BASIC, :n]
        self.others = self.whole[tableau.OTHER, : n + 1]
        self.side = self.whole[tableau.SIDE, :n]
        self.values, self.tableau = self.real[tableau.KEPT, :n], self.matrix[:n]
        self.entries = self.reported = 0.0  # touched so far, and at the last report
        # Pivots until the tableau is computed again, at about that cost.
        self.fresh_for = max(25, n)
        self.pivots = self.age = 0
        self.basis[:] = n + np.arange(n)

    # --- starts -----------------------------------------------------------------------------------------

    def start_along(self, covering: Vector) -> bool:
        """Start at z = 0 with the smallest t for which q + t r ≥ 0; return False if no such t exists.

        `covering` is r ≥ 0, shape (n,), with r_i > 0 if q_i < 0.
        """
        n, q = self.n, self.q
        if not np.all(covering[q < 0.0] > 0.0):
            return False
        level = np.where(covering > 0.0, -q / covering, -np.inf)
        basis, side = n + np.arange(n), np.full(n, tableau.AT_LOWER)
        t = max(0.0, float(level.max()))
        return self.start_at_vertex(covering, basis, side, (2 * n, -1.0), t)

    def start_in_cell(self, side: Array, z: Vector, w: Vector) -> bool:
        """Start at t = 1 from a complementary pair with the r that makes it exact; return False if it is singular."""
        n = self.n
        basis = np.where(side == tableau.BETWEEN, np.arange(n), n + np.arange(n))
        covering = w - self.M @ z - self.q
        is_started = self.start_at_vertex(covering, basis, side, (2 * n, -1.0), 1.0)
        self.whole[tableau.START, :n] = side
        return is_started

    def start_at_vertex(
        self, covering: Vector, basis: Array, side: Array, move: Move, level: float = 0.0
    ) -> bool:
        """Start at a basis; `move` are the driven variable and its direction, `level` is the value of a driven t."""
        self.covering = self.columns[:, self.n] = covering
        self.basis[:], self.side[:] = basis, side
        (self.driven, self.direction), self.value = move, level
        self.whole[tableau.START, : self.n] = tableau.NOT_STARTED
        self.pivots = 0
        return self._renew()

    def touched(self) -> float:
        """Return the number of entries touched since the last call."""
        since, self.reported = self.entries - self.reported, self.entries
        return since

    # --- moving -----------------------------------------------------------------------------------------

    def advance(self, limit: int) -> int:
        """Make up to `limit` pivots and return the outcome, a constant of `tableau`.

        A ray or an unreliable small pivot is tested again with a new tableau.
        """
        outcome = self._run(limit)
        if outcome == tableau.RAY and self.t <= 2.0**-40 * max_norm(self.q):
            return tableau.SOLVED  # t is at rounding level
        if outcome in (tableau.SOLVED, tableau.RETURNED):
            return outcome
        is_doubtful = outcome != tableau.GOING_ON and self.age > 0
        if not self._is_sound(is_doubtful):
            return tableau.SMALL_PIVOT
        if is_doubtful:
            outcome = self._run(limit)
        return tableau.GOING_ON if outcome == tableau.SMALL_PIVOT else outcome

    def _run(self, limit: int) -> int:
        arrays = self.real, self.whole, self.matrix, self.n
        driven = self.driven, self.value, self.direction
        outcome, *moved, made = tableau.make_pivots(*arrays, *driven, self.age == 0, limit)
        self.driven, self.value, self.direction = moved
        self.pivots += int(made)
        self.age += int(made)
        self.entries += float(made) * self.n * (self.n + 1.0)
        return int(outcome)

    def _is_sound(self, is_doubtful: bool) -> bool:
        """Correct the values, with a new tableau if necessary; return whether the values are feasible."""
        wrong = self._correct()
        if is_doubtful or wrong > ROUNDING or self.age >= self.fresh_for:
            if not self._renew():
                return False
            wrong = self._correct()
        if not wrong <= np.sqrt(ROUNDING):
            return False
        low, high = self.real[tableau.LOW, : self.n], self.real[tableau.HIGH, : self.n]
        outside = np.maximum(low - self.values, self.values - high)
        return bool((outside <= OUTSIDE_TOLERANCE * max(1.0, max_norm(self.values))).all())

    def _renew(self) -> bool:
        """Compute tableau and basic values from the data; False if the basis is singular to working precision."""
        n, basis, D = self.n, self.basis, self.columns  # w = D (z, t) + q
        is_other = np.ones(2 * n + 1, dtype=bool)
        is_other[basis] = False
        others = self.others[:] = np.flatnonzero(is_other)
        place = self.whole[tableau.PLACE]
        place[basis], place[others] = np.arange(n), n + np.arange(n + 1)
        inner, outer, is_slack, rows = self._sorted_out()
        columns, other_columns, slack_rows = (
            np.minimum(part, n) for part in (basis[inner], others[~is_slack], basis[outer] - n)
        )
        b = self._right_hand_side()
        if inner.size:
            core = D[np.ix_(rows, columns)]
            try:
                inverse = np.linalg.inv(core)
            except np.linalg.LinAlgError:
                return False
            if deadline.is_over() or not np.isfinite(inverse).all():
                return False
            absolute = np.abs(inverse)
            # Entries that are zero in exact arithmetic must be zero here, because a pivot could otherwise use them.
            inverse[absolute <= DATA_ROUNDING * (absolute @ np.abs(core) @ absolute)] = 0.0
            if deadline.is_over() or not inverse.any(axis=1).all():  # a row of nothing but rounding
                return False
            beyond = D[np.ix_(slack_rows, columns)]
            top, below = np.empty((inner.size, n + 1)), np.zeros((outer.size, n + 1))
            top[:, is_slack] = inverse
            top[:, ~is_slack] = _cleaned_product(-inverse, D[np.ix_(rows, other_columns)])
            below[:, ~is_slack] = D[np.ix_(slack_rows, other_columns)]
            self.tableau[inner], self.tableau[outer] = top, _cleaned_product(beyond, top, below)
            self.values[inner] = -inverse @ b[rows]
            self.values[outer] = beyond @ self.values[inner] + b[slack_rows]
        else:
            self.tableau[:], self.values[:] = D[slack_rows], b[slack_rows]
        self.entries += float(rows.size) * (3.0 * float(rows.size) ** 2 + 2.0 * float(n) ** 2)
        low, high = self.real[tableau.LOW, :n], self.real[tableau.HIGH, :n]
        is_above = np.ones(n, dtype=bool)
        is_above[outer] = self.side[slack_rows] != tableau.AT_UPPER
        low[:], high[:] = np.where(is_above, 0.0, -np.inf), np.where(is_above, np.inf, 0.0)
        is_z = basis < n
        high[is_z] = self.upper[basis[is_z]]
        self.age = 0
        if inner.size:
            self._correct()
        return True

    def _sorted_out(self) -> tuple[Any, Any, Any, Any]:
        """Return positions of basic z and t, positions of basic w, the mask of nonbasic w, and the rows of these w."""
        n = self.n
        is_w = (self.basis >= n) & (self.basis < 2 * n)
        is_slack = (self.others >= n) & (self.others < 2 * n)
        return np.flatnonzero(~is_w), np.flatnonzero(is_w), is_slack, self.others[is_slack] - n

    def _right_hand_side(self) -> Vector:
        b = self.q.copy()
        at_upper = self.side == tableau.AT_UPPER
        if at_upper.any():
            b += self.M[:, at_upper] @ self.upper[at_upper]
        if self.driven == 2 * self.n:
            b += self.value * self.covering
        return b

    def _correct(self) -> float:
        """Refine the basic values by one step; return their previous residual, relative to its terms."""
        n, z, w = self.n, self.z, np.zeros(self.n)
        _, outer, is_slack, rows = self._sorted_out()
        slack_rows = self.basis[outer] - n
        w[slack_rows] = self.values[outer]
        cover = self.t * self.covering
        error = w - self.M @ z - cover - self.q
        size = np.abs(w) + self.absolute @ np.abs(z) + np.abs(cover) + np.abs(self.q)
        self.entries += 3.0 * n * n
        of_others = np.zeros(n + 1)
        of_others[is_slack] = error[rows]
        self.values += self.tableau @ of_others  # the columns of w are columns of −B⁻¹
        self.values[outer] -= error[slack_rows]
        return max_norm(error / np.maximum(size, 1e-300))

    # --- reading ----------------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        """The multiple t of r; 0 at a solution."""
        end = 2 * self.n
        return self.value if self.driven == end else float(self.values[self.basis == end].sum())

    @property
    def z(self) -> Vector:
        """Current z, shape (n,)."""
        z = np.where(self.side == tableau.AT_UPPER, self.upper, 0.0)
        is_z = self.basis < self.n
        z[self.basis[is_z]] = self.values[is_z]
        return z


def _cleaned_product(A: FloatMatrix, B: FloatMatrix, C: FloatMatrix | None = None) -> FloatMatrix:
    """Return A B, or A B + C, with entries at rounding level set to 0."""
    product, terms = A @ B, np.abs(A) @ np.abs(B)
    if C is not None:
        product += C
        terms += np.abs(C)
    product[np.abs(product) <= DATA_ROUNDING * terms] = 0.0
    return product


# --- where paths start -----------------------------------------------------------------------------------

Start = Callable[[LemkePath], bool]


def starts(path: LemkePath, restarts: int) -> Iterator[Start]:
    """Yield functions that start the path, the most promising first; each returns whether the start exists.

    Parameters
    ----------
    path : Path
        Path of an equilibrated problem.
    restarts : int
        Number of arbitrary starts after the systematic starts.
    """
    n, q = path.n, path.q
    players = bimatrix_players(path.M, q)
    if players is not None and np.all(path.upper == np.inf):
        for k in range(n):
            yield partial(_lemke_howson, players=players, k=k)
    yield partial(LemkePath.start_along, covering=np.ones(n))
    size = np.maximum(np.abs(q), 2.0**-10)
    if np.ptp(size) > 0.0:
        yield partial(LemkePath.start_along, covering=size)
    generator = np.random.default_rng(0)
    for _ in range(restarts):
        yield _random_cell(path, generator)


def _random_cell(path: LemkePath, generator: np.random.Generator) -> Start:
    """Return a start inside an arbitrary active set; r has both signs, so that its path may lead anywhere."""
    n = path.n
    is_between = generator.random(n) < generator.uniform(0.1, 0.9)
    size = np.exp2(generator.uniform(-3.0, 3.0, size=n))
    inside = np.where(path.upper < np.inf, generator.uniform(0.1, 0.9, size=n) * path.upper, size)
    return partial(
        LemkePath.start_in_cell,
        side=np.where(is_between, tableau.BETWEEN, tableau.AT_LOWER),
        z=np.where(is_between, inside, 0.0),
        w=np.where(is_between, 0.0, size),
    )


def _lemke_howson(path: LemkePath, players: NDArray[np.bool_], k: int) -> bool:
    """Start Lemke and Howson's path that drops label k: z_k rises from ∞, and r = −e_k covers w_k."""
    n = path.n
    mine, others = players == players[k], players != players[k]
    s = _last_to_become_feasible(path, k, others)
    if s is None:
        return False
    blocking = _last_to_become_feasible(path, s, mine)
    if blocking is None:
        return False
    covering = np.zeros(n)
    covering[k] = -1.0
    basis, side = n + np.arange(n), np.full(n, tableau.AT_LOWER)
    basis[[k, s]] = k, s
    side[[k, s]] = tableau.BETWEEN
    if blocking == k:
        return path.start_at_vertex(covering, basis, side, (2 * n, -1.0))
    basis[blocking] = 2 * n
    return path.start_at_vertex(covering, basis, side, (blocking, 1.0))


def _last_to_become_feasible(path: LemkePath, column: int, rows: NDArray[np.bool_]) -> int | None:
    """Return the row whose w becomes ≥ 0 last as z_column rises from 0; None if some w does not rise."""
    slope = path.M[:, column]
    if not np.all(slope[rows] > 0.0):
        return None
    needed = np.full(path.n, -np.inf)
    needed[rows] = -path.q[rows] / slope[rows]
    return int(needed.argmax())
