"""The solver of small dense problems: compiled sweeps, rounds of active sets and pivots, nothing between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from ...core.algorithm import Algorithm, FusedSolve, Phases, Step, without_warnings
from ...core.certificates.criterion import within
from ...core.checks import DENSE_ABOVE_DENSITY, FloatVector, read_only
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix, fact
from ...core.tuning import COMPILED_SPARSE_UP_TO, COMPILED_UP_TO, CONTACTS_UP_TO

# the phases of `methods.small.kernels.small_problems`, by the methods that they are
PARTS = ("npsor", "newton", "lemke")
EVERYTHING, ROUNDS_ONLY, PIVOTS_ONLY = (True, True, True), (False, True, False), (False, False, True)


@dataclass(frozen=True, kw_only=True)
class SmallDenseSolver(Algorithm):
    """A few sweeps of NPSOR, rounds of active sets, Lemke's pivots: what `auto` begins with on small dense problems.

    Notes
    -----
    The sweeps guess the active set, from which a few rounds usually lead to the answer; where they do not, a path of
    complementary pivots does. From a start of the caller's the rounds come first. A row without a positive diagonal
    entry allows no sweep: then the pivots come first.
    """

    name: ClassVar[str] = "small dense solver"
    is_monotone: ClassVar[bool] = False
    ends_with_a_case: ClassVar[bool] = True

    @staticmethod
    def takes(problem: LCP) -> bool:
        """Return whether the problem is small enough, or of contacts with friction, and all of it is here."""
        return is_short(problem) or has_contacts(problem)

    def phases_of_small(self) -> Phases:
        """Return all phases."""
        return EVERYTHING

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step a sweep, a round and a path; end where nothing is left to be tried."""
        return without_warnings(steps(problem, z0, EVERYTHING))

    def solve_fused(self, problem: LCP, z0: FloatVector, tolerance: float, max_iterations: int) -> FusedSolve | None:
        """Return where these steps converge."""
        return solve_fused(problem, z0, tolerance, max_iterations, EVERYTHING)


def is_short(problem: LCP) -> bool:
    """Return whether the problem is small enough, and all of it is here."""
    largest = COMPILED_UP_TO if problem.is_dense else COMPILED_SPARSE_UP_TO
    return 0 < problem.n <= largest and not problem.is_distributed


def has_contacts(problem: LCP) -> bool:
    """Return whether the problem is one of contacts with friction that a compiled call takes."""
    may_have = 0 < problem.n <= CONTACTS_UP_TO and not problem.is_distributed
    return may_have and problem.is_plain and has_rows_of_contacts(problem.matrix)


@fact
def has_rows_of_contacts(matrix: Matrix) -> bool:
    """Return whether M has the rows that ``LCP.from_contacts`` writes, in its order."""
    if matrix.diagonal[-1]:
        return False
    from .kernels.contact_problems import count_contacts

    real, whole, _ = new_workspace(matrix.n)
    return bool(count_contacts(as_dense(matrix), real, whole) > 0)


@fact
def as_dense(matrix: Matrix) -> Any:
    """Return M as a batch of one ndarray, shape (1, n, n), read-only."""
    return as_batch(matrix.array if matrix.is_dense else matrix.csr.toarray())


def steps(problem: LCP, z0: FloatVector, phases: Phases) -> Iterator[Step]:
    """Yield the start and then a step of the planned phases each, until nothing is left to be tried.

    Where the entries of M are near an end of the range, z takes another unit here, a power of two. Nothing at all is
    yielded where they are near both ends.
    """
    from .kernels import small_problems as kernels
    from .kernels.workspace import STATE

    workspace, answers = new_workspace(problem.n), Answers(1, problem.n)
    arrays: tuple[Any, ...] = as_dense(problem.matrix), *map(as_batch, (problem.q, problem.lower, problem.upper, z0))
    limits, state = (-1.0, 1, 0, 1), workspace[1][STATE]  # tolerance (nothing is judged), iterations, first and end
    kernels.run_all(*arrays, *phases, *limits, kernels.NONE_YET, *workspace, *answers.arrays)
    unit = 0
    if state[kernels.PHASE] == kernels.UNUSUAL:
        unit = int(np.frexp(np.abs(arrays[0]).max())[1])
        in_unit = (read_only(np.ldexp(vector, unit)) for vector in arrays[2:])  # bounds and start; w = M z + q stays
        arrays = read_only(np.ldexp(arrays[0], -unit)), arrays[1], *in_unit
        kernels.run_all(*arrays, *phases, *limits, kernels.NONE_YET, *workspace, *answers.arrays)
    if state[kernels.PHASE] == kernels.UNUSUAL:
        return
    phase = int(answers.work[0, :3].argmax())
    contacts = Answers(1, problem.n)
    if phases == EVERYTHING and not unit:
        run_contacts(arrays, -1.0, 0, 1, new_workspace(problem.n), contacts)
    if contacts.made.any():
        z, touched = answers.z[0], problem.n**2 / max(problem.nonzeros, 1)
        yield Step(z, residual=float(answers.residual[0]), work=touched, label=PARTS[1])
        z, work = contacts.z[0], contacts.work[0, kernels.TOTAL] - touched
        yield Step(z, residual=float(contacts.residual[0]), work=work, label=PARTS[1])
    while is_short(problem):
        z = np.clip(np.ldexp(answers.z[0], -unit), problem.lower, problem.upper) if unit else answers.z[0]
        if np.isfinite(z).all():
            residual, work = np.ldexp(answers.residual[0], -unit), answers.work[0, kernels.TOTAL]
            yield Step(z, residual=float(residual), work=float(work), label=PARTS[phase])
        run_phases(arrays, phases, *limits, answers, steps=kernels.ONE_MORE, workspace=workspace)
        if not answers.made.any():
            return
        phase = int(answers.made[0].argmax())


def solve_fused(
    problem: LCP, z0: FloatVector, tolerance: float, max_iterations: int, phases: Phases
) -> FusedSolve | None:
    """Return where `steps` converge within the tolerance, None where they do not."""
    start = NO_START if z0 is problem.nearest_to_zero else as_batch(z0)
    vectors, answers = map(as_batch, (problem.q, problem.lower, problem.upper)), Answers(1, problem.n)
    arrays, may_have = (as_dense(problem.matrix), *vectors, start), has_rows_of_contacts(problem.matrix)
    run_phases(arrays, phases, tolerance, max_iterations, 0, 1, answers, may_have_contacts=may_have)
    return answers.solve_fused(0)


def new_workspace(n: int) -> tuple[Any, Any, Any]:
    """Return the work arrays of one problem at a time, as ``kernels.workspace`` has them."""
    real, whole, matrix = _shapes(n)
    return np.empty(real), np.empty(whole, np.int64), np.empty(matrix)


@cache
def _shapes(n: int) -> Any:
    from .kernels.workspace import shapes

    return shapes(n)  # type: ignore[no-untyped-call]


def run_phases(
    arrays: tuple[Any, ...], phases: Phases, tolerance: float, max_iterations: int, first: int, end: int,
    answers: Answers, *, steps: int | None = None, workspace: tuple[Any, Any, Any] | None = None,
    may_have_contacts: bool = True,
) -> None:  # fmt: skip
    """Write the answers to problems first ≤ k < end of a batch, as far as the planned phases converge."""
    from .kernels.small_problems import ALL, follow_all, run_all

    workspace, left = workspace or new_workspace(arrays[0].shape[1]), [(first, end)]
    if may_have_contacts and phases == EVERYTHING and steps is None and max_iterations > 0:
        left = run_contacts(arrays, tolerance, first, end, workspace, answers)
    else:
        answers.made[first:end] = 0
    steps = ALL if steps is None else steps
    for begin, stop in left:
        before = int(answers.made[begin].sum())  # steps for contacts, as many in all of a range
        spent = (answers.made[begin:stop].copy(), answers.work[begin:stop].copy()) if before else (0, 0.0)
        limits = tolerance, max_iterations - before, begin, stop
        if run_all(*arrays, *phases, *limits, steps, *workspace, *answers.arrays):
            follow_all(*arrays[:4], tolerance, begin, stop, *workspace, *answers.arrays)
        answers.judge(begin, stop, tolerance)
        if before:
            answers.made[begin:stop] += spent[0]
            answers.work[begin:stop] += spent[1]


def run_contacts(
    arrays: tuple[Any, ...], tolerance: float, first: int, end: int, workspace: Any, answers: Answers
) -> list[tuple[int, int]]:
    """Write the answers to those of these problems that are of contacts with friction; return the rest, as ranges.

    Those of a range have taken as many steps, none or one. What is too large for other phases is not in the rest.
    """
    M, n = arrays[0], arrays[0].shape[1]
    if (M[first:end] if len(M) > 1 else M)[:, -1, -1].all():  # the last row is of no speed λ
        answers.made[first:end] = 0
        return [(first, end)]
    from .kernels.contact_problems import solve_all_contacts

    left = solve_all_contacts(*arrays, tolerance, first, end, *workspace, *answers.arrays)
    answers.judge(first, end, tolerance)
    if not left:
        return []
    if n > COMPILED_SPARSE_UP_TO and (n > COMPILED_UP_TO or np.count_nonzero(M[:1]) <= DENSE_ABOVE_DENSITY * n * n):
        return []
    kinds = np.where(answers.has_converged[first:end], -1, answers.made[first:end, 1])
    cuts = [0, *(np.flatnonzero(np.diff(kinds)) + 1).tolist(), end - first]
    return [(first + a, first + b) for a, b in pairwise(cuts) if kinds[a] >= 0]


class Answers:
    """What a compiled run writes of `count` problems with n unknowns each.

    Attributes
    ----------
    z : array, shape (count, n)
    residual : array, shape (count,)
        The relative one of z, enclosed; ∞ where that would be beyond the tolerance.
    terms : array, shape (count,)
        The term residual beside it.
    made, work : arrays, shapes (count, 3) and (count, 4)
        Steps of each phase; passes over M of each phase and of all.
    has_converged : array of bool, shape (count,)
        Where z is SOLVED, once these were judged.
    needs_path : array of bool, shape (count,)
        Where pivots are to be tried.
    """

    def __init__(self, count: int, n: int) -> None:
        self.z, (self.residual, self.terms) = np.empty((count, n)), np.empty((2, count))
        self.made, self.work = np.zeros((count, 3), np.int64), np.empty((count, 4))
        self.has_converged, self.needs_path = np.zeros(count, np.bool_), np.zeros(count, np.bool_)

    @property
    def arrays(self) -> tuple[Any, ...]:
        """All of them, in the order in which the kernel takes them."""
        return self.z, self.residual, self.terms, self.made, self.work, self.needs_path

    def judge(self, first: int, end: int, tolerance: float) -> None:
        """Judge the problems first ≤ k < end, each of one component in its own units."""
        self.has_converged[first:end] = within(self.residual[first:end], self.terms[first:end], tolerance)

    def solve_fused(self, k: int) -> FusedSolve | None:
        """Return the answer of problem k, None where there is none."""
        if not self.has_converged[k]:
            return None
        phases = zip(PARTS, self.made[k].tolist(), self.work[k].tolist(), strict=False)
        parts = tuple((label, count, spent) for label, count, spent in phases if spent > 0.0)
        return FusedSolve(self.z[k], self.residual[k].item(), self.terms[k].item(), self.work[k, 3].item(), parts)


def as_batch(array: Any) -> Any:
    """Return an array with an axis of length 1 in front, read-only: one signature of the kernels for all."""
    return read_only(array[np.newaxis])


NO_START = read_only(np.empty((1, 0)))
