"""Programs solved by interior points, on the KKT form that auto begins with, without a run around them."""

from __future__ import annotations

from functools import cached_property

from ...core.checks import FloatVector
from ...core.communicator import ALONE
from ...core.deadline import Clock, is_over
from ...core.solving.result import StageRecord
from ...methods.interior.interior_point import InteriorPoint, points
from .conversion import Attempt, attempts
from .convexity import refuse_nonconvex
from .criterion import program_goal
from .no_minimum import QPInfeasibility, QPUnboundedness
from .program import QuadraticProgram
from .small_programs import Found

BECAUSE = "solves the optimality (KKT) conditions by steps that keep strictly inside the inequalities"
AGAIN = "the active set of an earlier answer"


class Begun:
    """What is made of a program before there is a run, which goes on from there.

    Attributes
    ----------
    z : ndarray or None
        The best point of the first form that interior points have led to.
    steps : int
    work : float
        What they took, in passes over M.
    """

    def __init__(self, program: QuadraticProgram) -> None:
        self.program, self.steps, self.work = program, 0, 0.0
        self.z: FloatVector | None = None

    @cached_property
    def first(self) -> Attempt:
        """The form that comes first."""
        refuse_nonconvex(self.program)
        return next(attempts(self.program))

    @property
    def record(self) -> StageRecord | None:
        """The stage of a run that interior points were; None where they have not come to an end."""
        is_made = "first" in self.__dict__ and InteriorPoint.name in self.first.problem.origin.attempted
        return StageRecord(InteriorPoint.name, BECAUSE, self.steps, self.work) if is_made else None


def solved_by_interior_points(
    begun: Begun, tolerance: float, *, prove_infeasibility: bool = True
) -> Found | QPInfeasibility | QPUnboundedness | None:
    """Return the answer by interior points; None where another form comes first, or where they find none.

    After a first attempt without one, a proof that there is none is looked for, and returned.
    """
    clock, program, problem = Clock(ALONE), begun.program, begun.first.problem
    origin, goal = problem.origin, program_goal(tolerance)
    if origin.form != "kkt":
        return None
    for z, steps, work, is_at_end in points(problem, tolerance):
        solution = origin.recover(z)
        begun.z, begun.steps, begun.work = z, steps, work
        if solution.is_stationary(goal):
            return Found(solution, StageRecord(InteriorPoint.name, BECAUSE, steps, work), clock.read(), origin)
        if is_at_end and prove_infeasibility and (proof := program.accepted_proof(goal)) is not None:
            return proof
    if not is_over():
        origin.note_attempt(InteriorPoint.name)
    return None


def solved_again(begun: Begun, guess: FloatVector, tolerance: float) -> Found | None:
    """Return the answer that the active set of an earlier one gives; None where that is not right."""
    clock, problem = Clock(ALONE), begun.first.problem
    if guess.size != problem.n:
        return None
    origin, z = problem.origin, InteriorPoint().finish(problem, guess)
    solution = origin.recover(z)
    if not solution.is_stationary(program_goal(tolerance)):
        return None
    return Found(solution, StageRecord(InteriorPoint.name, AGAIN, 1, 1.0), clock.read(), origin)
