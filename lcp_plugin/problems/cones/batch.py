"""Many small problems over cones in one compiled loop: sweeps and Newton's steps, judged all at once.

The problems are the diagonal blocks of one: each is a component of it, or several, and so has its own references. What
the loop leaves open, or the certificate does not confirm, is for whoever asked to solve by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.certificates.criterion import for_each_row, within
from ...core.certificates.row_residuals import over
from ...core.checks import FloatVector, read_only
from ...core.lcp import LCP
from ...core.matrix.scaling import are_well_scaled
from ...core.policy.policy import name_of
from ...core.settings import Settings, Status
from ...core.solving.result import Result, StageRecord
from .certificate import ConeCertificate, criterion_of
from .data import Blocks
from .methods import DECREASE, LEAST_PROXIMAL, MEMORY, NPGS, SHORTEST, SPREAD, Newton, diagonal_blocks
from .solving import FOLLOWS, SWEEPS, ConeAuto, ConeResult

LARGEST = 60  # unknowns: beyond, Newton's system is worth its sparsity
ROUNDS = np.array([10, 10, 50, 0, 100, 0, 0, 0, 200, 0, 0, 0])  # sweeps before each run of Newton's method
NEWTON_STEPS = 20
SEARCH = (MEMORY, SHORTEST, DECREASE, LEAST_PROXIMAL, SPREAD)
CLOSER = 0.9  # of the tolerance: that of the loop, whose residuals are not enclosed


class Found(NamedTuple):
    """Points that are proved to be answers.

    Attributes
    ----------
    items : array of int
        Which of the problems they answer.
    z : list of ndarray
    made : array of int, shape (items, 2)
        Sweeps, and steps of Newton's method.
    """

    items: NDArray[np.int64]
    z: list[FloatVector]
    made: NDArray[np.int64]


def groups_of(problems: Sequence[object]) -> list[NDArray[np.int64]]:
    """Return which problems may share a loop: small, dense, of the same blocks, none in mixed units."""
    alike: dict[tuple[object, ...], list[int]] = {}
    for k, problem in enumerate(problems):
        if isinstance(problem, Blocks) and 0 < problem.n <= LARGEST and isinstance(problem.rows.M, np.ndarray):
            alike.setdefault((problem.has_friction, problem.starts.tobytes()), []).append(k)
    groups = []
    for members in alike.values():
        starts = problems[members[0]].starts[:-1]  # type: ignore[attr-defined]
        squares = np.stack([problems[k].rows.M for k in members]) ** 2  # type: ignore[attr-defined]
        norms = np.sqrt(np.add.reduceat(np.add.reduceat(squares, starts, axis=1), starts, axis=2))
        groups.append(np.array(members)[are_well_scaled(norms)])
    return [group for group in groups if group.size > 1]


def together(problems: Sequence[Blocks]) -> Blocks:
    """Return the problem whose diagonal blocks are these, all of the same blocks and dense."""
    first, count = problems[0], len(problems)
    n = first.n
    M = np.stack([problem.rows.M for problem in problems])
    item, row, column = np.nonzero(M)
    indptr = np.concatenate([[0], np.cumsum(np.count_nonzero(M, axis=2).ravel())])
    whole = sp.csr_array((M[item, row, column], item * n + column, indptr), shape=(count * n, count * n))
    q, lower, upper, slope = (
        np.concatenate([getattr(problem, name) for problem in problems]) for name in ("q", "lower", "upper", "slope")
    )
    starts = (first.starts[:-1] + n * np.arange(count)[:, None]).ravel()
    rows = LCP(whole, q, lower=lower, upper=upper)
    return Blocks(rows, np.append(starts, count * n), slope, has_friction=first.has_friction)


def solve_small(
    problems: Sequence[Blocks], settings: Settings, in_chunks: Callable[[Callable[[int, int], None], int], None]
) -> Found:
    """Return the answers to problems of one group, as far as the loop finds them and the certificate confirms them.

    Parameters
    ----------
    problems : sequence of Blocks
    settings : Settings
    in_chunks : callable
        Calls a function of (first, end) for all items, while there is time.
    """
    from .kernels import solve_each

    whole, count = together(problems), len(problems)
    criterion, M = criterion_of(whole), whole.rows.csr
    ends = np.linspace(0, whole.slope.size, count + 1).round().astype(np.int64)
    z, made = np.array(whole.nearest_to_zero), np.full((count, 2), -1)
    diagonal, steps = diagonal_blocks(whole)
    proximal, goal = Newton().proximal, CLOSER * settings.tolerance

    def solve_chunk(first: int, end: int) -> None:
        solve_each(
            first, end, ends, *whole.arrays, M.indptr, M.indices, M.data, whole.q, diagonal, steps, criterion.scale,
            criterion.weights, goal, ROUNDS, NEWTON_STEPS, proximal, SEARCH, z, made,
        )

    with np.errstate(all="ignore"):
        in_chunks(solve_chunk, count)
    if criterion.answered is not None:
        z = np.where(criterion.answered, whole.nearest_to_zero, z)
    certificate = ConeCertificate.at(whole, z)
    relative = over(certificate._proved_rows, for_each_row(whole.block_norms, certificate.references[0]))
    relative, of_terms = (np.maximum.reduceat(values, ends[:-1]) for values in (relative, certificate.term_residuals))
    is_solved = within(relative, of_terms, settings.tolerance) & (made[:, 1] >= 0)
    items = np.flatnonzero(is_solved)
    own = z.reshape(count, -1)
    return Found(items, [own[k] for k in items.tolist()], made[items])


def result_of(problem: Blocks, z: FloatVector, made: Iterable[int], settings: Settings, seconds: float) -> ConeResult:
    """Return the result of an item that the loop has solved, after these seconds."""
    sweeps, newton = made
    rounds = sweeps // NPGS().sweeps
    stages = [StageRecord("npgs", SWEEPS, rounds, sweeps + rounds + 1.0)]
    if newton:
        passes = problem.n**3 / (3.0 * max(problem.nonzeros, 1)) + 2.0
        stages.append(StageRecord("newton", FOLLOWS, newton, newton * passes))
    policy = ConeAuto(problem, is_warm=False, prove_infeasibility=settings.prove_infeasibility)
    certificate = ConeCertificate.at(problem, read_only(z))
    return ConeResult.of(problem, Result(
        z=certificate.z, w=certificate.w, status=Status.SOLVED, certificate=certificate,
        tolerance=settings.tolerance, algorithm=name_of(policy, stages), iterations=rounds + newton,
        work=sum(stage.work for stage in stages), seconds=seconds, setup_seconds=0.0, stages=tuple(stages),
    ))
