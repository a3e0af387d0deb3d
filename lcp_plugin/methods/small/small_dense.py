"""The solver of small dense problems: compiled sweeps, rounds of active sets and pivots, nothing between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from ...core.algorithm import Algorithm, FusedSolve, Phases, Step, without_warnings
from ...core.certificates.criterion import within
from ...core.checks import FloatVector, read_only
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.row_sums import has_positive_diagonal
from ...core.tuning import COMPILED_SPARSE_UP_TO, COMPILED_UP_TO, PIVOTS_FIRST_UP_TO

# the phases of `methods.small.kernels.small_problems`, by the methods that they are
PARTS = ("npsor", "newton", "lemke")
EVERYTHING, ROUNDS_ONLY, PIVOTS_ONLY = (
    (True, True, True),
    (False, True, False),
    (False, False, True),
)


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
        """Return whether the problem is small enough, and all of it is here; larger where pivots come first anyway."""
        pivots_first = problem.n <= PIVOTS_FIRST_UP_TO
        return is_short(problem) or (
            pivots_first and not has_positive_diagonal(problem.matrix).all()
        )

    def phases_of_small(self) -> Phases:
        """Return all phases."""
        return EVERYTHING

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step a sweep, a round and a path; end where nothing is left to be tried."""
        return without_warnings(steps(problem, z0, EVERYTHING))

    def solve_fused(
        self, problem: LCP, z0: FloatVector, tolerance: float, max_iterations: int
    ) -> FusedSolve | None:
        """Return where these steps converge."""
        return solve_fused(problem, z0, tolerance, max_iterations, EVERYTHING)


def is_short(problem: LCP) -> bool:
    """Return whether the problem is small enough, and all of it is here."""
    largest = COMPILED_UP_TO if problem.is_dense else COMPILED_SPARSE_UP_TO
    return 0 < problem.n <= largest


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
    arrays: tuple[Any, ...] = (
        as_dense(problem.matrix),
        *map(as_batch, (problem.q, problem.lower, problem.upper, z0)),
    )
    limits, state = (
        (-1.0, 1, 0, 1),
        workspace[1][STATE],
    )  # tolerance (nothing is judged), iterations, first and end
    kernels.run_all(*arrays, *phases, *limits, kernels.NONE_YET, *workspace, *answers.arrays)
    unit = 0
    if state[kernels.PHASE] == kernels.UNUSUAL:
        unit = int(np.frexp(np.abs(arrays[0]).max())[1])
        in_unit = (
            read_only(np.ldexp(vector, unit)) for vector in arrays[2:]
        )  # bounds and start; w = M z + q stays
        arrays = read_only(np.ldexp(arrays[0], -unit)), arrays[1], *in_unit
        answers.forget(0, 1)
        kernels.run_all(*arrays, *phases, *limits, kernels.NONE_YET, *workspace, *answers.arrays)
    if state[kernels.PHASE] == kernels.UNUSUAL:
        return
    phase = int(answers.work[0].argmax())
    while True:
        z = (
            np.clip(np.ldexp(answers.z[0], -unit), problem.lower, problem.upper)
            if unit
            else answers.z[0]
        )
        if np.isfinite(z).all():
            residual, work = np.ldexp(answers.residual[0], -unit), answers.work[0].sum()
            yield Step(z, residual=float(residual), work=float(work), label=PARTS[phase])
        answers.forget(0, 1)
        run_phases(arrays, phases, *limits, answers, steps=kernels.ONE_MORE, workspace=workspace)
        if not answers.made.any():
            return
        phase = int(answers.made[0].argmax())


def solve_fused(
    problem: LCP, z0: FloatVector, tolerance: float, max_iterations: int, phases: Phases
) -> FusedSolve | None:
    """Return where `steps` converge within the tolerance, None where they do not."""
    start = NO_START if z0 is problem.nearest_to_zero else as_batch(z0)
    vectors, answers = (
        map(as_batch, (problem.q, problem.lower, problem.upper)),
        Answers(1, problem.n),
    )
    run_phases(
        (as_dense(problem.matrix), *vectors, start),
        phases,
        tolerance,
        max_iterations,
        0,
        1,
        answers,
    )
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
) -> None:  # fmt: skip
    """Write the answers to problems first ≤ k < end of a batch, as far as the planned phases converge."""
    from .kernels.small_problems import ALL, follow_all, run_all

    arrays = tuple(
        read_only(array) if array.flags.writeable else array for array in arrays
    )  # one signature for all
    workspace, steps = (
        workspace or new_workspace(arrays[0].shape[1]),
        ALL if steps is None else steps,
    )
    limits = tolerance, max_iterations, first, end
    if run_all(*arrays, *phases, *limits, steps, *workspace, *answers.arrays):
        follow_all(*arrays[:4], tolerance, first, end, *workspace, *answers.arrays)
    answers.judge(first, end, tolerance)


class Answers:
    """What a compiled run writes of `count` problems with n unknowns each.

    Attributes
    ----------
    z : array, shape (count, n)
    residual : array, shape (count,)
        The relative one of z, enclosed; ∞ where that would be beyond the tolerance.
    terms : array, shape (count,)
        The term residual beside it.
    made, work : arrays, shape (count, 3)
        Steps of each phase; passes over M.
    has_converged : array of bool, shape (count,)
        Where z is SOLVED, once these were judged.
    needs_path : array of bool, shape (count,)
        Where pivots are to be tried.
    """

    def __init__(self, count: int, n: int) -> None:
        self.z, (self.residual, self.terms) = np.empty((count, n)), np.full((2, count), np.inf)
        self.made, self.work = np.zeros((count, 3), np.int64), np.zeros((count, 3))
        self.has_converged, self.needs_path = np.zeros(count, np.bool_), np.zeros(count, np.bool_)

    @property
    def arrays(self) -> tuple[Any, ...]:
        """All of them, in the order in which the kernel takes them."""
        return self.z, self.residual, self.terms, self.made, self.work, self.needs_path

    def forget(self, first: int, end: int) -> None:
        """Forget what a run before has written of these problems."""
        part = slice(first, end)
        self.residual[part] = self.terms[part] = np.inf
        self.made[part], self.work[part], self.needs_path[part] = 0, 0.0, False

    def judge(self, first: int, end: int, tolerance: float) -> None:
        """Judge the problems first ≤ k < end, each of one component in its own units."""
        self.has_converged[first:end] = within(
            self.residual[first:end], self.terms[first:end], tolerance
        )

    def solve_fused(self, k: int) -> FusedSolve | None:
        """Return the answer of problem k, None where there is none."""
        if not self.has_converged[k]:
            return None
        work = self.work[k].tolist()
        phases = zip(PARTS, self.made[k].tolist(), work, strict=False)
        parts = tuple((label, count, spent) for label, count, spent in phases if spent > 0.0)
        return FusedSolve(
            self.z[k], self.residual[k].item(), self.terms[k].item(), sum(work), parts
        )


def as_batch(array: Any) -> Any:
    """Return an array with an axis of length 1 in front, read-only: one signature of the kernels for all."""
    return read_only(array[np.newaxis])


NO_START = read_only(np.empty((1, 0)))
