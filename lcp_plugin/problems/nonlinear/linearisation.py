"""Solving a linearisation of a nonlinear problem: a run within another one, which judges its steps itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...core.algorithms import Algorithm
from ...core.certificates.criterion import CommonUnits
from ...core.checks import FloatVector
from ...core.crossovers import INTERIOR_STEPS
from ...core.deadline import Clock, seconds_left
from ...core.lcp import LCP
from ...core.policy.choice import Policy, policy_for
from ...core.policy.stages import Choice, Stage
from ...core.settings import Settings
from ...core.solving.result import Result, Sample
from ...core.solving.run import Run
from ...methods.lemke import Lemke
from ...methods.small.fused import fused

FACTORS = {"newton": 12, "interior_point": INTERIOR_STEPS}  # without half the residual, on a large linearisation
LARGE = 1000  # unknowns: beyond them steps without progress are too expensive
PATHS = 2  # of pivots


class LinearPolicy(Policy):
    """What solves a linearisation: the caller's policy without a look for proofs; pivots are its last resort."""

    def __init__(self, algorithm: str | Algorithm) -> None:
        self._policy = policy_for(algorithm, {}, refutes=False, looks_at_cases=False)
        self.name, self.chosen = self._policy.name, self._policy.chosen

    def first(self, problem: LCP) -> Choice:
        """Return what the policy begins with."""
        return self._policy.first(problem)

    def next_step(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Choice | None:
        """Return the policy's next choice; pivots are the last, and nothing has two turns."""
        if isinstance(stages[-1].algorithm, Lemke):
            return None
        choice = self._policy.next_step(problem, stages, target, failed)
        if choice is None or any(stage.algorithm == choice.algorithm for stage in stages):
            return None
        is_pivoting = isinstance(choice.algorithm, Lemke)
        return replace(choice, algorithm=Lemke(restarts=PATHS)) if is_pivoting else choice


def solved_within(problem: LCP, algorithm: str | Algorithm, tolerance: float) -> Result:
    """Return the result of a run within another one, whose limits hold for it and whose Ctrl-C ends both.

    It solves a linearisation of a nonlinear problem, from the projected gradient step: the methods see a start and look
    for a solution near it.
    """
    left, clock, units = seconds_left(), Clock(problem.communicator), CommonUnits.of(problem)
    policy = LinearPolicy(algorithm)
    settings = Settings(tolerance, max_seconds=None if left == math.inf else left)
    step = np.nan_to_num(-problem.q / problem.residual_scale)
    start, first = units.inward(np.clip(step, problem.lower, problem.upper)), policy.first(units.problem)
    if (result := fused(units, policy, first, settings, start, clock)) is not None:
        return result
    run = Run(units, policy, settings, _Patience() if problem.n > LARGE else None, clock)
    return run.judged(start, run.drive(start, first))


class _Patience:
    """Ends a run in which many factorisations have not halved the residual."""

    def __init__(self) -> None:
        self.lowest, self.idle, self.before = math.inf, 0, 0

    def __call__(self, sample: Sample, z: FloatVector) -> bool:
        """Return whether the run has had its time."""
        residual, steps = math.inf if sample.residual is None else sample.residual, sample.iteration - self.before
        self.before = sample.iteration
        if residual <= 0.5 * self.lowest:
            self.lowest, self.idle = residual, 0
        elif sample.label in FACTORS:
            self.idle += steps
        return self.idle >= FACTORS.get(sample.label, math.inf)
