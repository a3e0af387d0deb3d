"""Where paths of complementary pivoting start: covering vectors, cells and the labels of a game."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ..small.kernels.workspace import AT_LOWER, AT_UPPER, BETWEEN
from .canonical_box import invertible_part
from .pivoting_path import Path

Start = Callable[[Path], bool]

INSIDE = 1e-3  # how far from its bounds a warm start begins, in the unit of an equilibrated problem


def starts(path: Path, z: FloatVector, restarts: int, *, is_near: bool = True) -> Iterator[Start]:
    """Yield ways to start the path, the most promising first; each returns whether it could.

    Parameters
    ----------
    path : Path
        Of an equilibrated problem.
    z : ndarray, shape (n,)
        A guess; z = 0 says nothing.
    restarts : int
        How many arbitrary starts follow the principled ones.
    is_near : bool
        Whether the cell of z is likely to be close to that of the answer; otherwise it is tried late.
    """
    n, q = path.n, path.q
    if z.any() and is_near:
        yield partial(_warm, z=z)
    players = bimatrix_players(path.M, q)
    if players is not None and np.all(path.upper == np.inf):
        for k in range(n):
            yield partial(_lemke_howson, players=players, k=k)
    yield partial(Path.start_along, covering=np.ones(n))
    size = np.maximum(np.abs(q), 2.0**-10)
    if np.ptp(size) > 0.0:
        yield partial(Path.start_along, covering=size)
    if z.any():
        yield partial(_warm, z=z, in_part=True)
    generator = np.random.default_rng(0)
    for k in range(restarts):
        if k % 4 == 0:
            covering = np.full(n, 2.0**-6)
            covering[(k // 4) % n] = 1.0
            yield partial(Path.start_along, covering=covering)
        elif k % 4 == 2:
            yield partial(Path.start_along, covering=np.exp2(generator.uniform(-4.0, 4.0, size=n)))
        else:
            yield _random_cell(path, generator)


def _warm(path: Path, z: FloatVector, *, in_part: bool = False) -> bool:
    """Start in the cell that z and its w stand for, a little inside, if its block is regular; or in that part of it."""
    w = path.M @ z + path.q
    upper = path.upper
    with np.errstate(all="ignore"):
        at_lower = z <= np.minimum(w, 0.5 * upper)
        at_upper = ~at_lower & (upper - z <= -w)
        margin = np.minimum(INSIDE, 0.25 * upper)
        inside = np.clip(z, margin, np.where(upper < np.inf, upper - margin, np.inf))
    if in_part:
        at_lower |= ~at_upper & ~_regular_part(path.M, ~at_lower & ~at_upper)
    side = np.where(at_lower, AT_LOWER, np.where(at_upper, AT_UPPER, BETWEEN))
    z = np.where(at_lower, 0.0, np.where(at_upper, upper, inside))
    w = np.where(at_lower, np.maximum(w, INSIDE), np.where(at_upper, np.minimum(w, -INSIDE), 0.0))
    return path.start_in_cell(side, z, w) and (in_part or path.is_well_conditioned)


def _random_cell(path: Path, generator: np.random.Generator) -> Start:
    """Return a start in an arbitrary cell; its path may lead anywhere, which is the purpose."""
    n = path.n
    is_between = generator.random(n) < generator.uniform(0.1, 0.9)
    size = np.exp2(generator.uniform(-3.0, 3.0, size=n))
    share = generator.uniform(0.1, 0.9, size=n)
    is_between = _regular_part(path.M, is_between)
    side = np.where(is_between, BETWEEN, AT_LOWER)
    with np.errstate(invalid="ignore"):
        inside = np.where(path.upper < np.inf, share * path.upper, size)
    return partial(
        Path.start_in_cell, side=side, z=np.where(is_between, inside, 0.0), w=np.where(is_between, 0.0, size)
    )


def _regular_part(M: NDArray[np.float64], chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the chosen rows, or those of them whose block stable pivots can invert, shape (n,)."""
    rows = np.flatnonzero(chosen)
    kept = np.zeros_like(chosen)
    kept[invertible_part(M, rows)] = True
    return kept


def bimatrix_players(M: NDArray[np.float64], q: FloatVector) -> NDArray[np.bool_] | None:
    """Return which rows belong to the first player if the problem is a game of costs, else None.

    A game: M = [[0, A], [Bᵀ, 0]] up to order, A, B ≥ 0 and q < 0. Every covering vector r > 0 ends such a path on
    its first ray.
    """
    n = q.size
    if n < 2 or not np.all(q < 0.0) or M.min() < 0.0 or M.diagonal().any():
        return None
    is_linked = (M != 0.0) | (M.T != 0.0)
    first = np.zeros(n, dtype=bool)
    second = np.zeros(n, dtype=bool)
    first[0] = True
    for _ in range(n):
        size = first.sum() + second.sum()
        second |= is_linked[first].any(axis=0)
        first |= is_linked[second].any(axis=0)
        if first.sum() + second.sum() == size:
            break
    if np.any(first & second) or not np.all(first | second):
        return None
    return first


def _lemke_howson(path: Path, players: NDArray[np.bool_], k: int) -> bool:
    """Start Lemke and Howson's path that drops label k: z_k rises from ∞, w_k is what r = −e_k covers."""
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
    basis, side = n + np.arange(n), np.full(n, AT_LOWER)
    basis[[k, s]] = k, s
    side[[k, s]] = BETWEEN
    if blocking == k:
        return path.start_at_vertex(covering, basis, side, 2 * n, -1.0)
    basis[blocking] = 2 * n
    return path.start_at_vertex(covering, basis, side, blocking, 1.0)


def _last_to_become_feasible(path: Path, column: int, rows: NDArray[np.bool_]) -> int | None:
    """Return the row whose w becomes ≥ 0 last as z_column rises from 0; None if one never does."""
    slope = path.M[:, column]
    if not np.all(slope[rows] > 0.0):
        return None
    needed = np.full(path.n, -np.inf)
    needed[rows] = -path.q[rows] / slope[rows]
    # Among equals, the last: the perturbation q + (ε, ε², …) is smallest there.
    return int(np.flatnonzero(needed == needed.max())[-1])
