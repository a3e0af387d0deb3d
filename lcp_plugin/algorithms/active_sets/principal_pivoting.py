"""Principal pivoting, blocks first and single indices in a fixed order where blocks do not pay."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..base import Step
from .active_set import BoolVector, classify
from .newton_state import NewtonState

LARGEST = 500
BLOCKS = 5  # block steps that may pass without a new smallest number of wrong rows
PIVOTS_PER_STEP = 10


def principal_pivots(state: NewtonState) -> Iterator[Step]:
    """Yield after every few pivots; nothing for large problems.

    A row is wrong where its z leaves the bounds or its w has the wrong sign. Change all wrong rows as long as their
    number reaches new minima, else only the first in a fixed order. On P-matrices that is finite; it may be
    exponential, so that the number of pivots is bounded.

    References
    ----------
    Júdice, Pires 1994, doi:10.1016/0305-0548(94)90106-6. Murty 1974, *Opsearch* 11, 123–130.
    """
    problem = state.problem
    if problem.n > LARGEST:
        return
    rank = np.random.default_rng(0).permutation(problem.n)
    state.move(state.best_z)
    at_lower, at_upper = classify(problem, state.z, state.w)
    fewest, blocks_left = problem.n + 1, BLOCKS
    for pivot in range(20 * problem.n + 100):
        solution = state.solve(at_lower, at_upper)
        if solution is None:
            return
        state.move(solution.z)
        to_lower, to_upper = classify(problem, state.z, state.w)
        wrong = np.flatnonzero((to_lower != at_lower) | (to_upper != at_upper))
        if wrong.size == 0 or pivot % PIVOTS_PER_STEP == 0:
            yield state.step()
        if wrong.size == 0:
            return
        if wrong.size < fewest:
            fewest, blocks_left = wrong.size, BLOCKS
        else:
            blocks_left -= 1
        changed = wrong if blocks_left > 0 else wrong[[np.argmin(rank[wrong])]]
        at_lower, at_upper = _changed(at_lower, to_lower, changed), _changed(at_upper, to_upper, changed)
    yield state.step()


def _changed(old: BoolVector, new: BoolVector, rows: NDArray[np.intp]) -> BoolVector:
    result = old.copy()
    result[rows] = new[rows]
    return result
