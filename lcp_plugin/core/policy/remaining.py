"""What the method at work still needs, for those who ask whether another one would need less."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..algorithm import Algorithm
from ..lcp import LCP
from ..matrix.symmetry import is_nearly_symmetric
from ..splittings.projected_relaxation import PGS, PSOR
from ..splittings.projected_type import NPSOR
from ..tuning import DIRECT_UP_TO, MULTIGRID_PASSES
from .stages import Stage

TRIAL_SWEEPS, TRIAL_SWEEPS_DENSE, SHORTEST_TRIAL, TRIAL_SWEEPS_PSOR = 10, 1, 3, 40
ASKED_EVERY = 20  # sweeps
PATIENCE = (
    1.5  # what sweeps have cost and still need stays below this multiple of what the rival predicts
)
BROKEN_PROMISE = 3.0  # multigrid that has cost this multiple of what it takes on grids is asked what it still needs
NEAR = 1e-2  # of the largest unknown: so near to a bound is none that is free


@dataclass(frozen=True)
class Remaining:
    """What the method at work still needs, as far as that is known.

    Attributes
    ----------
    name : str
        Of the method.
    work : float
        What it has cost so far, in passes over M.
    sweeps : float
        How many more it needs; ∞ where it does not get nearer, or has failed.
    has_failed : bool
    is_guess : bool
        Only one sweep is known of: nothing but multigrid may take over.
    """

    name: str
    work: float
    sweeps: float
    has_failed: bool
    is_guess: bool

    @classmethod
    def of(cls, problem: LCP, now: Stage, goal: float, *, failed: bool) -> Remaining | None:
        """Return what a stage still needs, None where it is too early to ask."""
        if now.algorithm.name == "multigrid":
            now.watch_bounds(problem, ASKED_EVERY)
        failed = failed or (
            isinstance(now.algorithm, PGS) and now.iterations > 1
        )  # it should have been exact
        if failed:
            return cls(now.algorithm.name, now.work, math.inf, True, False)
        is_asked, is_large = (
            _is_asked(problem, now),
            problem.n > DIRECT_UP_TO and not problem.is_dense,
        )
        may_guess = (
            isinstance(now.algorithm, NPSOR) and is_large and (is_asked or now.iterations == 1)
        )
        sweeps = _least_sweeps(problem, now, goal) if may_guess else 0.0
        if is_asked and now.algorithm.name == "multigrid":
            passes = now.steps_to_go(goal) * now.work / now.iterations
            return cls("multigrid", now.work, passes, False, False)
        if is_asked:
            return cls(
                now.algorithm.name, now.work, max(sweeps, now.steps_to_go(goal)), False, False
            )
        # After one sweep multigrid has to be clearly less than psor, which takes the root.
        return (
            cls(now.algorithm.name, now.work, sweeps / PATIENCE**2, False, True) if sweeps else None
        )

    def loses_to(self, rival: Algorithm, passes: float) -> bool:
        """Return whether the rival is predicted to need less, or this method's own prediction came true too late."""
        if self.is_guess and rival.name != "multigrid":
            return False
        return (
            self.has_failed or self.sweeps > passes or self.work + self.sweeps > PATIENCE * passes
        )

    def __str__(self) -> str:
        if self.has_failed:
            return f"{self.name} ended without a solution"
        known = self.sweeps < math.inf
        if self.name == "multigrid" and known:
            return f"multigrid had cost as much as {self.work:.0f} sweeps and would have cost {self.sweeps:.0f} more"
        if not known:
            return f"{self.name} was not converging"
        return f"{self.name} would have needed {self.sweeps:.0f} more sweeps"


def _is_asked(problem: LCP, now: Stage) -> bool:
    """Return whether the stage's rate is known well enough to ask for what needs less work."""
    k = now.iterations
    if isinstance(now.algorithm, PSOR):
        return k >= TRIAL_SWEEPS_PSOR and k % ASKED_EVERY == 0
    if now.algorithm.name == "multigrid":
        return k > 0 and k % ASKED_EVERY == 0 and now.work > BROKEN_PROMISE * MULTIGRID_PASSES
    if not isinstance(now.algorithm, NPSOR):
        return False
    if problem.is_dense:
        return k >= TRIAL_SWEEPS_DENSE
    is_trial_over = k >= TRIAL_SWEEPS and (k - TRIAL_SWEEPS) % ASKED_EVERY == 0
    return is_trial_over or (SHORTEST_TRIAL <= k < TRIAL_SWEEPS and now.is_steady())


def _least_sweeps(problem: LCP, now: Stage, goal: float) -> float:
    """Return how many sweeps errors that are constant on the free unknowns take, 0 where that is not known."""
    if now.z is None or not now.residuals or not goal > 0.0:
        return 0.0
    gain = now.residuals[-1][1] / goal
    with np.errstate(all="ignore"):
        margin = NEAR * max(
            now.z.max(), -now.z.min()
        )  # npsor approaches a bound without reaching it
        is_free = (problem.lower + margin < now.z) & (now.z < problem.upper - margin)
        free = is_free.astype(np.float64)
        sums, diagonal = problem.csr @ free, problem.diagonal
        share, least = (
            free @ sums / (free @ diagonal),
            (sums / diagonal).min(initial=1.0, where=is_free),
        )
        slowest = max(0.5 * (math.pi * share) ** 2, least)
    is_far = gain > 1.0 and 0.0 < slowest < 1.0
    if not (is_far and is_nearly_symmetric(problem.matrix)):
        return 0.0
    return float(min(math.sqrt(gain), 0.5 * math.log(gain) / slowest))
