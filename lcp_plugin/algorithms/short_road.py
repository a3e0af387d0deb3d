"""The short road of small dense problems: compiled sweeps, rounds of active sets and pivots, nothing between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..checks import FloatVector, read_only
from ..crossovers import COMPILED_SPARSE_UP_TO, COMPILED_UP_TO
from ..matrix.matrix import Matrix, fact
from ..problem.lcp import LCP
from .base import Algorithm, Plan, Sprint, Step, without_warnings

PARTS = ("npsor", "newton", "lemke")  # the phases of `kernels.small_problems`, by the methods that they are
EVERYTHING, ROUNDS_ONLY, PIVOTS_ONLY = (True, True, True), (False, True, False), (False, False, True)


@dataclass(frozen=True, kw_only=True)
class ShortRoad(Algorithm):
    """A few sweeps of NPSOR, rounds of active sets, Lemke's pivots: what `auto` begins with on small dense problems.

    Notes
    -----
    The sweeps guess the active set, from which a few rounds usually lead to the answer; where they do not, a path of
    complementary pivots does. From a start of the caller's the rounds come first. A row without a positive diagonal
    entry allows no sweep: then the pivots come first.
    """

    name: ClassVar[str] = "short road"
    is_compiled: ClassVar[bool] = True
    is_monotone: ClassVar[bool] = False

    def short_plan(self) -> Plan:
        """Return all phases."""
        return EVERYTHING

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step a sweep, a round and a path; end where nothing is left to be tried."""
        return without_warnings(steps(problem, z0, EVERYTHING))

    def sprint(self, problem: LCP, z0: FloatVector, tolerance: float, max_iterations: int) -> Sprint | None:
        """Return where these steps arrive."""
        return sprint(problem, z0, tolerance, max_iterations, EVERYTHING)


def is_short(problem: LCP) -> bool:
    """Return whether the problem is small enough, and all of it is here."""
    largest = COMPILED_UP_TO if problem.is_dense else COMPILED_SPARSE_UP_TO
    return 0 < problem.n <= largest and not problem.is_distributed


@fact
def as_dense(matrix: Matrix) -> Any:
    """Return M as a batch of one ndarray, shape (1, n, n), read-only."""
    return as_batch(matrix.array if matrix.is_dense else matrix.csr.toarray())


def steps(problem: LCP, z0: FloatVector, plan: Plan) -> Iterator[Step]:
    """Yield the start and then a step of the planned phases each, until nothing is left to be tried.

    Where the entries of M are near an end of the range, z takes another unit here, a power of two. Nothing at all is
    yielded where they are near both ends.
    """
    from ..kernels import small_problems as kernels
    from ..kernels.desk import LOWER, UPPER, Q, Z, sizes

    M, n, unit = as_dense(problem.matrix), problem.n, 0
    of_real, of_whole, of_room = sizes(n)
    real, whole, room = np.empty(of_real), np.empty(of_whole, np.int64), np.empty(of_room)
    nonzeros, is_usual, may_sweep, is_symmetric = kernels.look_at(M, 0, real)
    if not is_usual:
        unit = int(np.frexp(np.abs(M).max())[1])
        M = read_only(np.ldexp(M, -unit))
        nonzeros, is_usual, may_sweep, is_symmetric = kernels.look_at(M, 0, real)
    if not is_usual:
        return
    real[Q, :n] = problem.q
    for row, values in ((LOWER, problem.lower), (UPPER, problem.upper), (Z, z0)):
        real[row, :n] = np.ldexp(values, unit)
    is_cold = np.array_equal(z0, problem.nearest_to_zero)
    residual = kernels.begin(M, 0, real, whole, *plan, may_sweep, is_cold)
    phase, touched = kernels.next_phase(whole), float(n * n)
    while phase != kernels.OVER:
        z = np.clip(np.ldexp(real[Z, :n], -unit), problem.lower, problem.upper) if unit else real[Z, :n]
        if np.isfinite(z).all():
            yield Step(z, residual=float(np.ldexp(residual, -unit)), work=touched / nonzeros, label=PARTS[phase])
        phase, residual, touched = kernels.advance(M, 0, real, whole, room, is_symmetric)


def sprint(problem: LCP, z0: FloatVector, tolerance: float, max_iterations: int, plan: Plan) -> Sprint | None:
    """Return where `steps` arrive within the tolerance, None where they do not."""
    start = NO_START if z0 is problem.nearest_to_zero else as_batch(z0)
    vectors = map(as_batch, (problem.q, problem.lower, problem.upper))
    return sprint_of_arrays((as_dense(problem.matrix), *vectors, start), tolerance, max_iterations, plan)


def sprint_of_arrays(
    arrays: tuple[Any, ...], tolerance: float, max_iterations: int, plan: Plan = EVERYTHING
) -> Sprint | None:
    """Return the same for a problem that is no more than M, q, lower, upper and a start, finite, each `as_batch`."""
    from ..kernels.small_problems import run_all

    answers = Answers(*arrays[1].shape)
    run_all(*arrays, *plan, tolerance, max_iterations, 0, 1, *answers.arrays)
    return answers.sprint(0)


class Answers:
    """What a compiled run writes of `count` problems with n unknowns each.

    Attributes
    ----------
    z : array, shape (count, n)
    residual : array, shape (count,)
        The relative one of z, enclosed.
    made, work : arrays, shapes (count, 3) and (count, 4)
        Steps of each phase; passes over M of each phase and of all.
    has_arrived : array of bool, shape (count,)
        Where z is within the tolerance.
    """

    def __init__(self, count: int, n: int) -> None:
        self.z, self.residual = np.empty((count, n)), np.empty(count)
        self.made, self.work = np.empty((count, 3), np.int64), np.empty((count, 4))
        self.has_arrived = np.zeros(count, np.bool_)

    @property
    def arrays(self) -> tuple[Any, ...]:
        """All of them, in the order in which the kernel takes them."""
        return self.z, self.residual, self.made, self.work, self.has_arrived

    def sprint(self, k: int) -> Sprint | None:
        """Return the answer of problem k, None where there is none."""
        if not self.has_arrived[k]:
            return None
        phases = zip(PARTS, self.made[k].tolist(), self.work[k].tolist(), strict=False)
        parts = tuple((label, count, spent) for label, count, spent in phases if spent > 0.0)
        return Sprint(self.z[k], self.residual[k].item(), self.work[k, 3].item(), parts)


def as_batch(array: Any) -> Any:
    """Return an array with an axis of length 1 in front, read-only: one signature of the kernels for all."""
    return read_only(array[np.newaxis])


NO_START = read_only(np.empty((1, 0)))
