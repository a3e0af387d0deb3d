"""Semismooth Newton on the scaled natural residual, alias primal-dual active set, with its safeguards."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...checks import BoolVector, FloatVector
from ...problem.lcp import LCP
from ..base import Algorithm, Plan, Sprint, Step, direct_passes, without_warnings
from ..short_road import ROUNDS_ONLY, is_short, sprint, steps
from .active_set import classify
from .damped_newton import damped_steps
from .newton_state import LARGE_PATIENCE, NewtonState

PATIENCE = 30  # full steps without a smaller residual or fewer changes, plus one a row up to PATIENT_ROWS
PATIENT_ROWS = 250
ROUNDS = 3
PIVOTED_ROWS = 500  # up to here single pivots are tried
BLOCKS = 5  # block steps that may pass without a new smallest number of wrong rows
PIVOTS_PER_STEP = 10


@dataclass(frozen=True, kw_only=True)
class Newton(Algorithm):
    """Semismooth Newton, alias primal-dual active set: w_F = 0, and z_A at the bounds that z − w/d reaches.

    Notes
    -----
    Full steps as long as they lead to new active sets; on M-matrices these are finite and monotone. When an active
    set comes back, or nothing improves, a line search on the Fischer–Burmeister function takes over, which tries
    full steps again where they halve it. Small problems that resist are pivoted, one index at a time where blocks
    do not pay, and tried once more from the point of the box nearest to 0. In theory the line search converges, and
    the pivots are finite, on P-matrices; here both are bounded in number. Singular blocks are regularised, and the
    residual judges what comes of it. On more than 3000 rows, steps that gain little are given up early. Each step
    yields the best z so far, projected onto the bounds.

    References
    ----------
    Hintermüller, Ito, Kunisch 2002, doi:10.1137/S1052623401383558. De Luca, Facchinei, Kanzow 1996,
    doi:10.1007/BF02592192. Murty 1974, *Opsearch* 11, 123–130.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[2, 1], [1, 2]], [-5, 1])
    >>> lcp_plugin.solve(problem, Newton()).z
    array([2.5, 0. ])
    """

    name: ClassVar[str] = "newton"
    assumption: ClassVar[str] = "none"
    converges_on: ClassVar[str] = "M, bounds on one side, n ≤ 250"
    cost: ClassVar[str] = "1 factorisation of the free block"
    reference: ClassVar[str] = (
        "Hintermüller, Ito, Kunisch 2002, doi:10.1137/S1052623401383558; De Luca, Facchinei, Kanzow 1996, "
        "doi:10.1007/BF02592192"
    )
    is_monotone: ClassVar[bool] = False

    def predicted_passes(self, problem: LCP, sweeps: float) -> float:
        """Return those of a direct answer."""
        return direct_passes(problem)

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the best z so far, once a factorisation; end where nothing more can be done."""
        return without_warnings(self._steps(problem, z0))

    def theorem(self, problem: LCP) -> str | None:
        """Return the theorem on M-matrices: full steps are monotone then, at most n + 2; patience suffices for them."""
        from ...matrix import analyze

        is_one_sided = bool(np.all(problem.upper == np.inf) or np.all(problem.lower == -np.inf))
        if problem.n > PATIENT_ROWS or not is_one_sided or analyze(problem).is_m_matrix is not True:
            return None
        return "M is an M-matrix and bounded on one side: monotone and finite (Hintermüller, Ito, Kunisch 2002)"

    def short_plan(self) -> Plan:
        """Return full steps only."""
        return ROUNDS_ONLY

    def sprint(self, problem: LCP, z0: FloatVector, tolerance: float, max_iterations: int) -> Sprint | None:
        """Return where compiled full steps arrive on a small dense problem."""
        return sprint(problem, z0, tolerance, max_iterations, ROUNDS_ONLY) if is_short(problem) else None

    def _steps(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        if is_short(problem):
            yield from steps(problem, z0, ROUNDS_ONLY)
        start = np.clip(z0, problem.lower, problem.upper)
        is_elsewhere = problem.n <= PIVOTED_ROWS and not np.array_equal(start, problem.nearest_to_zero)
        state = NewtonState(problem, start)
        yield state.step()
        if problem.n == 0 or (yield from rounds(state)) or not is_elsewhere:
            return
        again = NewtonState(problem, problem.nearest_to_zero)
        if state.inside < again.inside:
            again.inside, again.inside_z = state.inside, state.inside_z
        yield from rounds(again)


def rounds(state: NewtonState) -> Generator[Step, None, bool]:
    """Yield full steps and damped ones in turn, and pivots where they fail; return whether an active set settled."""
    for _ in range(ROUNDS):
        is_settled = yield from full_steps(state)
        before = state.best
        is_settled = is_settled or (yield from damped_steps(state))
        if is_settled:
            return True
        if not state.best < (0.9 * before if state.is_large else before):
            break
    yield from principal_pivots(state)
    return False


def full_steps(state: NewtonState) -> Generator[Step, None, bool]:
    """Yield undamped active-set steps, until an active set comes back or neither residual nor changes fall.

    Return whether the last set reproduced itself with a regular block: nothing but rounding is left.
    """
    problem = state.problem
    patience = LARGE_PATIENCE if state.is_large else PATIENCE + min(problem.n, PATIENT_ROWS)
    lowest, fewest, idle = math.inf, problem.n + 1, 0
    previous = classify(problem, state.z, state.w)
    while idle < patience and not state.is_known(*previous):
        solution = state.solve(*previous)
        if solution is None:
            return False
        state.move(solution.z)
        yield state.step()
        present = classify(problem, state.z, state.w)
        changes = int(np.count_nonzero((present[0] != previous[0]) | (present[1] != previous[1])))
        if changes == 0:
            return not solution.is_singular
        size = float(np.sum(state.residual))
        idle = 0 if size < lowest or changes < fewest else idle + 1
        lowest, fewest = min(lowest, size), min(fewest, changes)
        previous = present
    return False


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
    if problem.n > PIVOTED_ROWS:
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
