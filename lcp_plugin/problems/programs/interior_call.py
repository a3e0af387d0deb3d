"""Programs solved by interior points, on the KKT form that auto begins with, without a run around them."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.checks import FloatVector
from ...core.communicator import ALONE
from ...core.deadline import Clock
from ...core.solving.result import StageRecord
from ...methods.interior.interior_point import InteriorPoint, points
from .compiled_call import REACHED, ProgramResult
from .conversion import attempts
from .convexity import refuse_nonconvex
from .criterion import program_goal
from .program import QuadraticProgram
from .qp_certificates import LARGEST
from .qp_forms import QPOrigin
from .qp_proofs import QPInfeasibility, QPUnboundedness
from .qp_solution import QPSolution

BECAUSE = "solves the optimality (KKT) conditions by steps that keep strictly inside the inequalities"
AGAIN = "the active set of an earlier answer"


@dataclass(frozen=True, eq=False)
class InteriorAnswer:
    """The answer to a program, judged by its own criterion and by the residual of its complementarity problem.

    Attributes
    ----------
    solution : QPSolution
    steps : int
    seconds : float
    """

    solution: QPSolution
    steps: int
    seconds: float
    name = InteriorPoint.name
    _origin: QPOrigin
    _z: FloatVector
    _work: float
    _because: str = BECAUSE

    def is_enough(self, tolerance: float) -> bool:
        """Return whether the residual of the complementarity problem is what was asked for, where that is asked."""
        return tolerance >= REACHED or self.result(tolerance).residual <= tolerance

    def result(self, tolerance: float, algorithm: str = "auto") -> ProgramResult:
        """Return the same as the result of the complementarity problem of the program."""
        stage = StageRecord(self.name, self._because, self.steps, self._work)
        return ProgramResult.of(self._origin, self._z, stage, self.seconds, tolerance, algorithm)


def solved_by_interior_points(
    program: QuadraticProgram, tolerance: float, *, refutes: bool = True
) -> InteriorAnswer | QPInfeasibility | QPUnboundedness | None:
    """Return the answer by interior points; None where another form comes first, or where they find none.

    After a first attempt without one, a proof that there is none is looked for, and returned; of large programs by a
    run, to which they are left.
    """
    clock = Clock(ALONE)
    refuse_nonconvex(program)
    problem = next(attempts(program)).problem
    origin, goal = problem.origin, program_goal(tolerance)
    if origin.form != "kkt":
        return None
    for z, steps, work, is_at_end in points(problem, tolerance):
        solution = origin.recover(z)
        found = InteriorAnswer(solution, steps, clock.read(), origin, z, work)
        if solution.is_stationary(goal) and found.is_enough(tolerance):
            return found
        if is_at_end and refutes:
            proof = program.refutation(goal)
            if proof is not None or sum(program.matrices.sizes) > LARGEST:
                return proof
    return None


def solved_again(program: QuadraticProgram, guess: FloatVector, tolerance: float) -> InteriorAnswer | None:
    """Return the answer that the active set of an earlier one gives; None where that is not right."""
    clock = Clock(ALONE)
    refuse_nonconvex(program)
    problem = next(attempts(program)).problem
    if guess.size != problem.n:
        return None
    origin, z = problem.origin, InteriorPoint().finish(problem, guess)
    solution = origin.recover(z)
    if not solution.is_stationary(program_goal(tolerance)):
        return None
    found = InteriorAnswer(solution, 1, clock.read(), origin, z, 1.0, AGAIN)
    return found if found.is_enough(tolerance) else None
