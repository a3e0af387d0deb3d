"""The derivative of a function by differences: columns that share no row are moved together; and its linearisation.

Solving a linearisation is a run within another one, which judges its steps itself.

References
----------
A. R. Curtis, M. J. D. Powell, J. K. Reid, *On the estimation of sparse Jacobian matrices*, IMA J. Appl. Math. 13
(1974), doi:10.1093/imamat/13.1.117.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numba import uintp
from numpy.typing import NDArray

from ...core.algorithms import Algorithm
from ...core.certificates.criterion import CommonUnits
from ...core.checks import BoolVector, FloatVector
from ...core.crossovers import INTERIOR_STEPS
from ...core.deadline import Clock, seconds_left
from ...core.errors import InvalidProblem
from ...core.kernels.compilation import compiled
from ...core.kernels.floats import EPSILON
from ...core.lcp import LCP
from ...core.policy.choice import Policy, policy_for
from ...core.policy.stages import Choice, Stage
from ...core.settings import Settings
from ...core.solving.result import Result, Sample
from ...core.solving.run import Run
from ...methods.lemke.lemke import Lemke
from ...methods.small.fused import fused

DENSE_PATTERN_UP_TO = 1000  # unknowns, each of which costs an evaluation of F a derivative
STEP = float(np.sqrt(EPSILON))  # of |x_i|: rounding and curvature take about as many digits
SMALL = 1e-3  # beside a step that is made for unknowns of the size 1
ROUNDINGS, TOLD = 4.0, 1024.0  # of F: a difference is one, or none
FACTORS = {"newton": 12, "interior_point": INTERIOR_STEPS}  # without half the residual, on a large linearisation
LARGE = 1000  # unknowns: beyond them steps without progress are too expensive
PATHS = 2  # of pivots


@compiled
def colour_columns(indptr, indices, row_indptr, row_indices, colours):  # type: ignore[no-untyped-def]
    """Give each column the first colour that no column has which meets one of its rows; colours begin as −1.

    The pattern comes by columns and by rows. Cost: the sum of the squared lengths of the rows.
    """
    one, n = uintp(1), uintp(colours.size)
    seen_by = np.full(colours.size + 1, -1, np.int64)  # which column has met this colour last
    for j in range(n):
        for k in range(uintp(indptr[j]), uintp(indptr[j + one])):
            i = uintp(indices[k])
            for m in range(uintp(row_indptr[i]), uintp(row_indptr[i + one])):
                colour = colours[uintp(row_indices[m])]
                if colour >= 0:
                    seen_by[uintp(colour)] = j
        first = 0
        while seen_by[uintp(first)] == j:
            first += 1
        colours[j] = first


class Differences:
    """Forward differences on one pattern.

    Parameters
    ----------
    pattern : csc_array, shape (n, n)
    groups : array of int, shape (n,)
        The number of the group with which each column is moved.
    """

    def __init__(self, pattern: sp.csc_array, groups: NDArray[np.int32]) -> None:
        self.pattern, self.groups = pattern, groups
        self._columns = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))

    @classmethod
    def on(cls, pattern: sp.csc_array | None, n: int) -> Differences:
        """Return the differences on a pattern, or where there is none on all places.

        Raises
        ------
        InvalidProblem
            Where all places would be too many.
        """
        if pattern is None:
            if n > DENSE_PATTERN_UP_TO:
                raise InvalidProblem(
                    f"differences on all {n}×{n} places take {n} evaluations of F a derivative, and are made up to "
                    f"n = {DENSE_PATTERN_UP_TO}; give a jacobian, or the pattern of its entries as a sparse array"
                )
            return cls(sp.csc_array(np.ones((n, n))), np.arange(n, dtype=np.int32))

        rows = sp.csr_array(pattern)
        groups = np.full(n, -1, dtype=np.int32)
        colour_columns(
            pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64), rows.indptr.astype(np.int64),
            rows.indices.astype(np.int64), groups,
        )
        return cls(pattern, groups)

    def at(
        self, F: Callable[[FloatVector], FloatVector], x: FloatVector, value: FloatVector, lower: FloatVector,
        upper: FloatVector,
    ) -> sp.csr_array:
        """Return the derivative at x, where F has that value; steps stay within the bounds where these are apart.

        Where F is not defined at one side of x, the other one is asked; what remains is NaN. Where |x_j| ≪ 1 that may
        be its unit: a step of its size counts where it tells something else, and four times that step says the same.
        What rounding of the terms of F explains is 0.
        """
        step = _steps(np.maximum(np.abs(x), 1.0), x, lower, upper)
        small = np.where(np.abs(x) < SMALL, _steps(np.abs(x), x, lower, upper), 0.0)
        derivative, steps = np.empty(self.pattern.nnz), np.abs(step)[self._columns]
        for members, places in self._groups():
            found = self._quotients(F, x, value, np.where(members, step, 0.0), places)
            if not np.isfinite(found).all():
                found = np.where(
                    np.isfinite(found), found, self._quotients(F, x, value, np.where(members, -step, 0.0), places)
                )
            if (shorter := np.where(members, small, 0.0)).any():
                near = self._quotients(F, x, value, shorter, places)
                if not _agree(near, found).all():
                    other = self._quotients(F, x, value, 4.0 * shorter, places)
                    least = TOLD * EPSILON * np.abs(value)[self.pattern.indices[places]]
                    is_told = _agree(near, other) & ~_agree(near, found)
                    is_told &= np.abs(near * shorter[self._columns[places]]) > least
                    found = np.where(is_told, near, found)
                    steps[places] = np.where(is_told, np.inf, steps[places])
            derivative[places] = found
        derivative = self._without_rounding(derivative, x, value, steps)
        pattern = self.pattern
        return sp.csr_array(sp.csc_array((derivative, pattern.indices, pattern.indptr), shape=pattern.shape))

    def _without_rounding(
        self, derivative: FloatVector, x: FloatVector, value: FloatVector, steps: FloatVector
    ) -> FloatVector:
        """Return the entries with 0 for those whose difference is no more than a few roundings of their row's terms."""
        rows, products = self.pattern.indices, derivative * x[self._columns]
        with np.errstate(all="ignore"):
            rest = value - np.bincount(rows, products, value.size)
            terms = np.abs(rest) + np.bincount(rows, np.abs(products), value.size)
            is_rounding = np.abs(derivative) * steps <= ROUNDINGS * EPSILON * terms[rows]
        return np.where(is_rounding, 0.0, derivative)

    def _groups(self) -> Iterator[tuple[NDArray[np.bool_], NDArray[Any]]]:
        """Yield the columns of each group, and the places of their entries."""
        of_entries = self.groups[self._columns]
        order = np.argsort(of_entries, kind="stable")
        ends = np.searchsorted(of_entries[order], np.arange(int(self.groups.max(initial=-1)) + 2))
        for k in range(ends.size - 1):
            yield self.groups == k, order[ends[k]:ends[k + 1]]

    def _quotients(
        self, F: Callable[[FloatVector], FloatVector], x: FloatVector, value: FloatVector, step: FloatVector,
        places: NDArray[Any],
    ) -> FloatVector:
        moved = x + step
        with np.errstate(all="ignore"):
            difference = F(moved) - value
            quotient: FloatVector = difference[self.pattern.indices[places]] / (moved - x)[self._columns[places]]
        return quotient


def _agree(one: FloatVector, other: FloatVector) -> BoolVector:
    """Return where two quotients differ by a hundredth at most; a NaN agrees with nothing."""
    with np.errstate(all="ignore"):
        agree: BoolVector = np.abs(one - other) <= 0.01 * np.maximum(np.abs(one), np.abs(other))
    return agree


def _steps(size: FloatVector, x: FloatVector, lower: FloatVector, upper: FloatVector) -> FloatVector:
    """Return how far each unknown is moved: away from 0, but towards the bound that is farther where one is near."""
    length = STEP * size
    with np.errstate(all="ignore"):
        above, below = upper - x, x - lower
        sign = np.where(x < 0.0, -1.0, 1.0)
        ahead, behind = np.where(sign > 0.0, above, below), np.where(sign > 0.0, below, above)
        steps: FloatVector = np.where((ahead < length) & (behind > ahead), -sign, sign) * length
    return steps


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
