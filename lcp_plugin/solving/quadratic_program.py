"""Solves convex quadratic programs by `solve`: form after form, until the program's own residuals are small."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from ..algorithms.search.stages import FeasibilityCheck
from ..checks import FloatVector
from ..conversions.program import QuadraticProgram, refuse_nonconvex
from ..conversions.qp_solution import QPSolution
from ..conversions.quadratic_program import attempts
from ..deadline import is_over, seconds_left
from ..errors import UnsuitableMatrix, UnsuitableProblem, UnsupportedModel
from ..settings import Status
from .driver import solve
from .result import Result, Sample, StageRecord

KKT_TOLERANCE = 1e-6
TIGHTER = 1e-4
ANY_DIAGONAL = ("auto", "interior_point", "newton", "lemke")  # the algorithms that the zeros of a KKT form do not stop


class ProgramRun(NamedTuple):
    """A run on one form of a program, what it says of the program, and why it was made."""

    result: Result
    solution: QPSolution
    because: str

    @property
    def error(self) -> float:
        """The largest residual of the program, ∞ where there is none."""
        error = max(self.solution.residual, self.solution.row_residual)
        return math.inf if math.isnan(error) else error


def solve_quadratic_program(
    program: QuadraticProgram, algorithm: Any = "auto", *, tolerance: float = 1e-9, guess: FloatVector | None = None,
    **options: Any,
) -> tuple[Result, QPSolution]:
    """Return the run and the answer with the smallest residuals in the program's own terms.

    Parameters
    ----------
    program : QuadraticProgram
        Convex; merely convex and linear programs included.
    algorithm, tolerance, **options
        Of :func:`lcp_plugin.solve`. The tolerance is that of the complementarity problem; where the program's own
        residuals are above 1e-6 at it (or above ten times the tolerance, if that is larger), a smaller one is tried,
        and then the KKT form without substitutions. A limit of the caller holds for each trial and ends them all.
        As soon as a method has ended without a solution, ``program.refutation`` is looked for; where there is
        one, it ends them too, and the run is INTERRUPTED; not so with ``refute=False``.

    guess : array, optional
        An earlier run's z: the start where it has the right length.

    Raises
    ------
    UnsupportedModel
        Where the program is not convex, or the named algorithm cannot run on a merely convex one.
    """
    refuse_nonconvex(program)
    goal, refutes = kkt_goal(tolerance), options.get("refute", True)
    runs = list(program_runs(
        program, algorithm, (tolerance, TIGHTER * tolerance), (goal, goal), guess=guess,
        is_refuted=(lambda: program.refutation(goal) is not None) if refutes else None, **options,
    ))
    best = min(runs, key=lambda run: run.error)
    return replace(best.result, stages=_stages(runs, best)), best.solution


def program_runs(
    program: QuadraticProgram, algorithm: Any, tolerances: tuple[float, float], goals: tuple[float, float], *,
    guess: FloatVector | None = None, is_refuted: Callable[[], bool] | None = None, callback: Any = None,
    **options: Any,
) -> Iterator[ProgramRun]:
    """Yield runs on the forms of a program until one is stationary to the first goal, or something ends them all.

    Each form is solved at the first tolerance, and at the second where that leaves more than the second goal.
    """
    has_run, refusal = False, None

    def ends(sample: Sample, z: FloatVector) -> bool:
        wants_end = callback is not None and bool(callback(sample, z))
        return wants_end or (is_refuted is not None and sample.label == FeasibilityCheck.name and is_refuted())

    for attempt in attempts(program, needs_diagonal=getattr(algorithm, "name", algorithm) not in ANY_DIAGONAL):
        for tolerance, because in zip(tolerances, (attempt.because, "a smaller tolerance"), strict=True):
            start = {"z0": guess} if guess is not None and guess.size == attempt.problem.n else {}
            if (left := seconds_left()) < math.inf:
                options["max_seconds"] = min(left, options.get("max_seconds", math.inf))
            try:
                result = solve(
                    attempt.problem, algorithm, tolerance=tolerance,
                    callback=ends if callback or is_refuted else None, **{**start, **options},
                )
            except (UnsuitableMatrix, UnsuitableProblem) as error:
                refusal = refusal or error
                break
            solution, has_run, guess = attempt.problem.origin.recover(result), True, result.z
            yield ProgramRun(result, solution, because)
            options.pop("z0", None)
            if ended_by_caller(result, options) or is_over():
                return
            # Where it is not solved, a smaller tolerance would change nothing.
            if solution.is_stationary(goals[1]) or not result.is_solved:
                break
        if has_run and (solution.is_stationary(goals[0]) or (is_refuted is not None and is_refuted())):
            return
    if not has_run:
        raise UnsupportedModel(f"{refusal}; or leave it out: this program may be merely convex") from refusal


def _stages(runs: list[ProgramRun], best: ProgramRun) -> tuple[StageRecord, ...]:
    """Return the stages of all runs, as of one: why another run was made, its first stage says."""
    stages: list[StageRecord] = []
    for run in runs:
        first = len(stages)
        stages += [stage if run is best else stage._replace(remark="") for stage in run.result.stages]
        if 0 < first < len(stages):
            reasons = [reason for reason in (run.because, stages[first].because) if reason]
            stages[first] = stages[first]._replace(because="; ".join(reasons))
    return tuple(stages)


def kkt_goal(tolerance: float) -> float:
    """Return the size of a program's own residuals that is called optimal at this tolerance of the run."""
    return max(KKT_TOLERANCE, 10.0 * tolerance)


def ended_by_caller(result: Result, options: Mapping[str, Any]) -> bool:
    """Return whether a limit that the caller set, or the caller, ended the run."""
    limits = {Status.MAX_ITERATIONS: "max_iterations", Status.MAX_SECONDS: "max_seconds"}
    return result.status is Status.INTERRUPTED or limits.get(result.status) in options
