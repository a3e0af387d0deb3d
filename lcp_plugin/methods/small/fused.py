"""All steps of a run in one compiled call, where nobody watches them; the answer is judged as that of any run."""

from __future__ import annotations

from ...core.algorithms import Algorithm, FusedSolve
from ...core.certificates.criterion import CommonUnits, least_reference, reference_residual
from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector
from ...core.deadline import Clock
from ...core.kernels.floats import EPSILON
from ...core.matrix.structure import parts
from ...core.policy.choice import Policy, name_of
from ...core.policy.stages import Choice, reason_of_part
from ...core.settings import Settings, Status
from ...core.solving.advice import NOTHING_TO_DO
from ...core.solving.judge import answers_program
from ...core.solving.result import Result, StageRecord


def fused(
    units: CommonUnits, policy: Policy, first: Choice, settings: Settings, start: FloatVector, clock: Clock
) -> Result | None:
    """Return the result of the first algorithm's steps taken in one compiled call; None where they have to be driven.

    They are driven where somebody wants to see them, where another residual or the error is to be watched, and where
    the call does not converge within the tolerance.
    """
    algorithm, problem = first.algorithm, units.problem
    may_fuse = settings.is_unobserved and first.presolved is None
    if type(algorithm).solve_fused is Algorithm.solve_fused or not may_fuse:
        return None
    clock.read()
    if clock.elapsed >= settings.max_seconds:
        return None
    is_one = parts(problem.matrix) is None
    found = algorithm.solve_fused(problem, start, _tolerance_of_all(units, settings, is_one), settings.max_iterations)
    if found is None:
        return None
    if is_one and units.is_identity:  # the kernel has enclosed the residual of the whole
        certificate = Certificate.enclosed(units.stated, found.z, found.residual)
    else:
        certificate = Certificate.of(units.stated, units.outward(found.z))
    if not settings.accept(certificate) or answers_program(units.stated, settings, certificate.z) is False:
        return None
    return fused_result(certificate, policy, first, found, settings, clock.read())


def _tolerance_of_all(units: CommonUnits, settings: Settings, is_one: bool) -> float:
    """Return the tolerance beside the largest reference of all parts that means the one asked for beside the least."""
    if settings.absolute_tolerance and units.reference > 0.0:  # of which the kernel does not know
        share = units.reference / reference_residual(units.problem)
        return settings.goal * share * (1.0 if is_one else 1.0 - 4.0 * EPSILON)
    return settings.goal if is_one else beside_the_largest(*units.references, settings.goal)


def beside_the_largest(least: FloatVector, most: FloatVector, tolerance: float) -> float:
    """Return the same for parts with these bounds of their references."""
    largest = float(most.max(initial=0.0))
    if not largest > 0.0 or least.size == 1:
        return tolerance
    return tolerance * (least_reference(least, most) / largest) * (1.0 - 4.0 * EPSILON)


def fused_result(
    certificate: Certificate, policy: Policy, first: Choice, found: FusedSolve, settings: Settings, seconds: float
) -> Result:
    """Return the result of a fused solve that converged at the z of a certificate, after these seconds."""
    stages = tuple(
        StageRecord(name, reason_of_part(name, first.algorithm, first.because, is_first=k == 0), iterations, work)
        for k, (name, iterations, work) in enumerate(found.parts)
    )
    if not any(stage.iterations for stage in stages):  # the first step is the start
        stages = tuple(stage._replace(because=NOTHING_TO_DO) for stage in stages)
    return Result(
        z=certificate.z, w=certificate.w, status=Status.SOLVED, certificate=certificate,
        tolerance=settings.tolerance, algorithm=name_of(policy, stages),
        iterations=sum(stage.iterations for stage in stages), work=found.work,
        absolute_tolerance=settings.absolute_tolerance, seconds=seconds,
        setup_seconds=0.0, stages=stages, _asked=policy.chosen,
    )
