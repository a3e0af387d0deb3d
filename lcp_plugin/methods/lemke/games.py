"""Bimatrix games among complementarity problems: detected by signs only, solved along Lemke and Howson's paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.lcp import LCP
from ...core.matrix.matrix import fact
from ...core.tuning import PIVOTS_FIRST_UP_TO


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


def bimatrix_players(M: NDArray[np.float64], q: FloatVector) -> NDArray[np.bool_] | None:
    """Return the mask of the first player's rows if the problem is a game of costs, else None.

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
