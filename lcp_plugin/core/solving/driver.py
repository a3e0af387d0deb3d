"""What `solve` does of an LCP once it is known what is asked: one compiled call for an unobserved run, else a run."""

from __future__ import annotations

from collections.abc import Callable

from ..algorithm import Algorithm, FusedSolve
from ..certificates.criterion import CommonScaling
from ..certificates.residuals import Certificate
from ..checks import FloatVector
from ..deadline import Clock
from ..kernels.threads import threads_for
from ..lcp import LCP
from ..policy.policy import Policy, name_of, with_reasons
from ..policy.stages import Choice
from ..settings import Settings, Status
from .advice import NOTHING_TO_DO
from .judge import End, Judge
from .result import Result, StageRecord
from .run import Callback, Run
from .run_log import Header


def solved_by(
    policy: Policy,
    problem: LCP,
    settings: Settings,
    start: FloatVector,
    clock: Clock,
    callback: Callback | None,
    *,
    judge: Callable[[CommonScaling, Settings], Judge] = Judge,
    header: Header | None = None,
) -> Result:
    """Return the result of what a policy chooses.

    Parameters
    ----------
    policy : Policy
    problem : LCP
    settings : Settings
    start : ndarray, shape (n,)
        Within the bounds.
    clock : Clock
        Running.
    callback : callable or None
    judge : callable
        Makes the judge of a run.
    header : callable, optional
        What ``verbose=True`` tells of M.
    """
    run = None

    def run_in(scaling: CommonScaling) -> Run:
        return Run(scaling, policy, settings, callback, clock, judge(scaling, settings), header)

    with threads_for(settings.threads):
        try:
            scaling = CommonScaling.of(problem, settings.least_reference)
            start, first = scaling.inward(start), policy.first(scaling.problem)
            if (
                callback is None
                and (result := fused(scaling, policy, first, settings, start, clock)) is not None
            ):
                return result
            run = run_in(scaling)
            return run.judged(start, run.drive(start, first))
        except KeyboardInterrupt:
            if run is None or run.state.iteration < 0:  # no step is made yet
                raise
            return run.judged(start, End.INTERRUPTED)


def fused(
    scaling: CommonScaling,
    policy: Policy,
    first: Choice,
    settings: Settings,
    start: FloatVector,
    clock: Clock,
) -> Result | None:
    """Return the result of the first algorithm's steps taken in one compiled call; None where they have to be driven.

    They are driven where somebody wants to see them, where another residual or the error is to be watched, and where
    the call does not converge within the tolerance.
    """
    algorithm, problem = first.algorithm, scaling.problem
    if type(algorithm).solve_fused is Algorithm.solve_fused or not settings.is_unobserved:
        return None
    clock.read()
    if clock.elapsed >= settings.max_seconds:
        return None
    tolerance = scaling.beside_the_largest(settings.goal)
    found = algorithm.solve_fused(problem, start, tolerance, settings.max_iterations)
    if found is None:
        return None
    is_as_stated = scaling.is_connected and scaling.is_identity
    if is_as_stated:  # the kernel has enclosed the residual of the whole
        certificate = Certificate.enclosed(
            scaling.stated, found.z, found.residual, found.term_residual
        )
    else:
        certificate = Certificate.of(scaling.stated, scaling.outward(found.z))
    is_solved = certificate.ends_a_run(settings)
    return (
        fused_result(certificate, policy, first, found, settings, clock.read())
        if is_solved
        else None
    )


def fused_result(
    certificate: Certificate,
    policy: Policy,
    first: Choice,
    found: FusedSolve,
    settings: Settings,
    seconds: float,
) -> Result:
    """Return the result of a fused solve that converged at the z of a certificate, after these seconds."""
    stages = [
        StageRecord(*part) for part in with_reasons(found.parts, first.algorithm, first.because)
    ]
    iterations = sum(stage.iterations for stage in stages)
    if not iterations:  # the first step is the start
        stages = [stage._replace(because=NOTHING_TO_DO) for stage in stages]
    return Result(
        z=certificate.z,
        w=certificate.w,
        status=Status.SOLVED,
        certificate=certificate,
        tolerance=settings.tolerance,
        algorithm=name_of(policy, stages),
        iterations=iterations,
        work=found.work,
        absolute_tolerance=settings.absolute_tolerance,
        seconds=seconds,
        setup_seconds=0.0,
        stages=tuple(stages),
        _asked=policy.chosen,
    )
