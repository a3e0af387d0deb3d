"""A run whose single steps nobody watches: one compiled call from the start to the answer, judged as every run is."""

from __future__ import annotations

from ..algorithms import Algorithm, Sprint
from ..algorithms.rehearsal import rehearse
from ..certificates.residuals import Certificate
from ..checks import FloatVector
from ..policy.choice import Policy
from ..policy.stages import Choice
from ..problem.lcp import LCP
from ..settings import Settings, Status
from .result import Result, StageRecord
from .state import Clock, name_of


def sprinted(
    problem: LCP, policy: Policy, first: Choice, settings: Settings, start: FloatVector, clock: Clock
) -> Result | None:
    """Return the result of the first algorithm's steps taken all at once; None where they have to be driven.

    They are driven where somebody wants to see them, where another residual or the error is to be watched, and where
    the sprint does not arrive within the tolerance.
    """
    algorithm = first.algorithm
    if type(algorithm).sprint is Algorithm.sprint or not is_unwatched(settings) or first.presolved is not None:
        return None
    rehearse(algorithm, problem)
    clock.read()
    if clock.elapsed >= settings.max_seconds:
        return None
    sprint = algorithm.sprint(problem, start, settings.tolerance, settings.max_iterations)
    if sprint is None:
        return None
    return arrival(problem, policy, first, sprint, settings, clock.read())


def arrival(
    problem: LCP, policy: Policy, first: Choice, sprint: Sprint, settings: Settings, seconds: float
) -> Result:
    """Return the result of a sprint that arrived."""
    certificate = Certificate.enclosed(problem, sprint.z, sprint.residual)
    stages = tuple(
        StageRecord(name, "" if k else first.because, iterations, work)
        for k, (name, iterations, work) in enumerate(sprint.parts)
    )
    return Result(
        z=certificate.z, w=certificate.w, status=Status.SOLVED, certificate=certificate,
        tolerance=settings.tolerance, measure=settings.measure, algorithm=name_of(policy.name, stages),
        iterations=sum(stage.iterations for stage in stages), work=sprint.work,
        seconds=seconds, setup_seconds=0.0, stages=stages, chosen=policy.chosen,
    )


def is_unwatched(settings: Settings) -> bool:
    """Return whether nobody wants more of the way than that it ends within the tolerance on the relative residual."""
    is_plain = settings.measure == "relative" and not settings.is_on_error
    return is_plain and not settings.record and not settings.error_bound
