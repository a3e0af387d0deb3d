"""Small problems over cones, one or many, and contacts of bodies, in compiled loops: sweeps and Newton's steps.

What these loops leave open, or do not prove, goes the way of larger ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.certificates.criterion import within
from ...core.checks import FloatVector, read_only
from ...core.matrix.matrix import fact
from ...core.rounding import read_only_views
from ...core.settings import Settings
from .data import Blocks, Starts
from .methods import DECREASE, EASIER, HARDER, LEAST_PROXIMAL, MEMORY, PROXIMAL, SHORTEST

LARGEST, ALL_ROUNDS_UP_TO = 400, 100  # unknowns: beyond, Newton's system is worth its sparsity
SMALLEST_STEP = 60  # unknowns: below, a dense system costs as little
LARGEST_STEP = 1500  # rows: the steps on velocities watch no clock, and are to be over in some tenths of a second
ROUNDS = np.array(
    [10, 10, 50, 0, 100, 0, 0, 0, 200, 0, 0, 0]
)  # sweeps before each run of Newton's method
FIRST_ROUNDS = 3
NEWTON_STEPS, LONG_STEPS = 20, 50  # of a run: where all rounds follow, and where the first do
CONSTANTS = (PROXIMAL, SHORTEST, DECREASE, LEAST_PROXIMAL, HARDER, EASIER)
STEP_ROUNDS, STEP_NEWTON = (
    np.array([10, 30, 0, 0, 300, 0]),
    40,
)  # the same of bodies; see solve_step
STEP_PROXIMAL = 1e-8  # at the least: of bodies, 1 / that is in the system
SPREAD = 0.3  # of the mean of |z_i|: as far as starts are moved at random
CLOSER = 0.9  # of the tolerance: that of the loop, whose residuals are not enclosed


class LoopAnswers(NamedTuple):
    """What the loop has reached, an item a row.

    Attributes
    ----------
    z : array, shape (B, n)
    made : array, shape (B, 2)
        Sweeps, and steps of Newton's method; of bodies (1, 3), with those of the central path.
    residual : array, shape (B,)
        Upper bounds of their relative residuals; ∞ where there is none.
    is_proved : array of bool, shape (B,)
        Whether z is proved to be an answer.
    """

    z: NDArray[np.float64]
    made: NDArray[np.int64]
    residual: FloatVector
    is_proved: NDArray[np.bool_]


def groups_of(problems: Sequence[object]) -> list[NDArray[np.int64]]:
    """Return which problems may share a loop: small, and of the same blocks."""
    alike: dict[tuple[object, ...], list[int]] = {}
    for k, problem in enumerate(problems):
        if isinstance(problem, Blocks) and 0 < problem.n <= LARGEST:
            alike.setdefault((problem.has_friction, problem.starts.tobytes()), []).append(k)
    return [np.array(members) for members in alike.values()]


def solve_small(
    problems: Sequence[Blocks],
    settings: Settings,
    in_chunks: Callable[[Callable[[int, int], None], int], None] | None = None,
    *,
    start: FloatVector | None = None,
) -> LoopAnswers:
    """Return what the loop makes of problems of one group.

    Parameters
    ----------
    problems : sequence of Blocks
    settings : Settings
    in_chunks : callable, optional
        Calls a function of (first, end) for all items, while there is time.
    start : array, shape (n,), optional
        A point in K near the answer, of one problem.
    """
    first = problems[0]
    arrays = tuple(_stacked([getter(problem) for problem in problems]) for getter in _ARRAYS)
    z = np.array(arrays[-2] if start is None else start[np.newaxis])
    (starts,) = read_only_views(first.starts)
    return run_loop(
        starts,
        arrays,
        z,
        settings,
        in_chunks,
        has_friction=first.has_friction,
        is_warm=start is not None,
    )


def run_loop(
    starts: Starts,
    arrays: tuple[Any, ...],
    z: NDArray[np.float64],
    settings: Settings,
    in_chunks: Callable[[Callable[[int, int], None], int], None] | None = None,
    *,
    has_friction: bool,
    is_warm: bool,
) -> LoopAnswers:
    """Return what the loop makes of problems of the same blocks, from the rows of z, shape (B, n), which it overwrites.

    Parameters
    ----------
    starts : array of int, shape (k + 1,)
        As of :class:`Blocks`.
    arrays : tuple
        M, (B, n, n), q, lower, upper and z°, (B, n) each, and slope, (B, k): contiguous, read-only.
    z, settings, in_chunks
        As of :func:`solve_small`.
    has_friction : bool
        As of :class:`Blocks`.
    is_warm : bool
        Whether Newton's steps come before sweeps.
    """
    from .small_kernels import solve_each

    M, q, lower, upper, origins, slopes = arrays
    count, n = z.shape
    rounds, steps = (
        (ROUNDS, NEWTON_STEPS) if n <= ALL_ROUNDS_UP_TO else (ROUNDS[:FIRST_ROUNDS], LONG_STEPS)
    )
    rounds = np.concatenate([[0], rounds]) if is_warm else rounds
    made, proved = np.zeros((count, 2), np.int64), np.zeros((count, 2)) + np.inf

    def solve_chunk(begin: int, end: int) -> None:
        solve_each(
            begin,
            end,
            starts,
            float(has_friction),
            slopes,
            lower,
            upper,
            M,
            q,
            origins,
            CLOSER * settings.tolerance,
            read_only(rounds),
            steps,
            MEMORY,
            CONSTANTS,
            SPREAD,
            z,
            made,
            proved,
        )

    if in_chunks is None:
        solve_chunk(0, count)
    else:
        in_chunks(solve_chunk, count)
    residual, terms = proved.T
    return LoopAnswers(z, made, residual, within(residual, terms, settings.tolerance))


def has_few_bodies(problem: Blocks) -> bool:
    """Return whether the velocities of bodies are fewer than the rows of their contacts, neither very few nor many."""
    bodies = problem.bodies
    return (
        bodies is not None and max(SMALLEST_STEP, bodies.mass.shape[-1]) < problem.n <= LARGEST_STEP
    )


def solve_contacts(problem: Blocks, settings: Settings, *, start: FloatVector) -> LoopAnswers:
    """Return what the loop over the velocities of bodies makes of their contacts, from a start in the cones."""
    from .step_kernels import solve_step

    z, made, proved, M = (
        np.array(start),
        np.zeros(3, np.int64),
        np.full(2, np.inf),
        problem.rows.csr,
    )
    starts, *others = problem.arrays
    constants = (PROXIMAL, SHORTEST, DECREASE, STEP_PROXIMAL, HARDER, EASIER)
    solve_step(
        starts,
        *others,
        *read_only_views(M.indptr, M.indices, M.data, problem.q, problem.nearest_to_zero),
        *_rows_of_bodies(problem),
        CLOSER * settings.tolerance,
        read_only(STEP_ROUNDS),
        STEP_NEWTON,
        MEMORY,
        constants,
        z,
        made,
        proved,
    )
    is_proved = within(proved[:1], proved[1:], settings.tolerance)
    return LoopAnswers(z[np.newaxis], made[np.newaxis], proved[:1], is_proved)


@fact
def _rows_of_bodies(problem: Any) -> tuple[Any, ...]:
    """Return the mass matrix and the rows of the bodies, checked where they were stated, as arrays of CSR."""
    parts, index = (
        map(sp.csr_array, (problem.bodies.mass, problem.bodies.rows)),
        problem.rows.csr.indices.dtype,
    )
    return tuple(
        read_only_views(
            *(
                array
                for part in parts
                for array in (
                    part.indptr.astype(index, copy=False),
                    part.indices.astype(index, copy=False),
                    part.data,
                )
            )
        )
    )


_ARRAYS: tuple[Callable[[Blocks], Any], ...] = (
    lambda problem: (
        problem.rows.M if isinstance(problem.rows.M, np.ndarray) else problem.rows.M.toarray()
    ),
    lambda problem: problem.q,
    lambda problem: problem.lower,
    lambda problem: problem.upper,
    lambda problem: problem.nearest_to_zero,
    lambda problem: problem.slope,
)


def _stacked(arrays: list[Any]) -> Any:
    """Return the arrays of all problems as one, read-only: one signature of the loop for one problem and for many."""
    stacked = np.ascontiguousarray(arrays[0])[np.newaxis] if len(arrays) == 1 else np.stack(arrays)
    stacked.flags.writeable = False
    return stacked
