"""A run whose single steps nobody watches: one compiled call from the start to the answer, judged as every run is."""

from __future__ import annotations

from ..algorithms import Algorithm, Sprint
from ..certificates.references import CommonUnits, least_reference, reference_residual
from ..certificates.residuals import Certificate
from ..checks import FloatVector
from ..kernels.floats import EPSILON
from ..matrix.parts import parts
from ..policy.choice import Policy
from ..policy.stages import Choice
from ..settings import Settings, Status
from .judge import is_within
from .result import Result, StageRecord
from .state import Clock, name_of


def sprinted(
    units: CommonUnits, policy: Policy, first: Choice, settings: Settings, start: FloatVector, clock: Clock
) -> Result | None:
    """Return the result of the first algorithm's steps taken all at once; None where they have to be driven.

    They are driven where somebody wants to see them, where another residual or the error is to be watched, and where
    the sprint does not arrive within the tolerance.
    """
    algorithm, problem = first.algorithm, units.problem
    if type(algorithm).sprint is Algorithm.sprint or not is_unwatched(settings) or first.presolved is not None:
        return None
    clock.read()
    if clock.elapsed >= settings.max_seconds:
        return None
    sprint = algorithm.sprint(problem, start, tolerance_of_sprint(units, settings), settings.max_iterations)
    if sprint is None:
        return None
    certificate = certificate_of_sprint(units, sprint.z, sprint.residual)
    if not is_within(certificate, settings):
        return None
    return arrival(certificate, policy, first, sprint, settings, clock.read())


def tolerance_of_sprint(units: CommonUnits, settings: Settings) -> float:
    """Return the tolerance beside the largest reference of all parts that means the one asked for beside the least."""
    several = parts(units.problem.matrix)
    if settings.absolute_tolerance and units.reference > 0.0:  # of which the kernel does not know
        share = units.reference / reference_residual(units.problem)
        return settings.goal * share * (1.0 if several is None else 1.0 - 4.0 * EPSILON)
    return settings.goal if several is None else beside_the_largest(*units.references, settings.goal)


def beside_the_largest(least: FloatVector, most: FloatVector, tolerance: float) -> float:
    """Return the same for parts with these bounds of their references."""
    largest = float(most.max(initial=0.0))
    if not largest > 0.0 or least.size == 1:
        return tolerance
    return tolerance * (least_reference(least, most) / largest) * (1.0 - 4.0 * EPSILON)


def certificate_of_sprint(units: CommonUnits, z: FloatVector, residual: float) -> Certificate:
    """Return the certificate of where a sprint arrived, whose kernel has enclosed the residual of the whole."""
    if parts(units.problem.matrix) is None:
        return Certificate.enclosed(units.callers, z, residual)
    return Certificate.of(units.callers, units.outward(z))


def arrival(
    certificate: Certificate, policy: Policy, first: Choice, sprint: Sprint, settings: Settings, seconds: float
) -> Result:
    """Return the result of a sprint that arrived at the z of a certificate."""
    stages = tuple(
        StageRecord(name, "" if k else first.because, iterations, work)
        for k, (name, iterations, work) in enumerate(sprint.parts)
    )
    return Result(
        z=certificate.z, w=certificate.w, status=Status.SOLVED, certificate=certificate,
        tolerance=settings.tolerance, measure=settings.measure, algorithm=name_of(policy.name, stages),
        iterations=sum(stage.iterations for stage in stages), work=sprint.work,
        absolute_tolerance=settings.absolute_tolerance, seconds=seconds, setup_seconds=0.0, stages=stages,
        chosen=policy.chosen,
    )


def is_unwatched(settings: Settings) -> bool:
    """Return whether nobody wants more of the way than that it ends within the tolerance on the relative residual."""
    is_plain = settings.measure == "relative" and not settings.is_on_error
    return is_plain and not (settings.record or settings.error_bound or settings.verbose)
