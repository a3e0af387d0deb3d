"""The criterion of a quadratic program: how large the errors of its conditions are, and which are called optimal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...core.checks import FloatVector

if TYPE_CHECKING:
    from .program import QuadraticProgram

PROGRAM_TOLERANCE = 1e-6  # of `QPSolution.is_optimal`, by default
CONSTRAINTS = 1e-7  # what constraints are asked for at any tolerance between this and 1e-6
SHARE = 0.1  # of a larger tolerance
SURE = 1e-3  # of what is called optimal: no exact proof of unboundedness beats an answer whose gradient is within that
STRICT = 1e3  # times a tolerance below 1e-9: what is asked of a program's own residuals
OBJECTIVE = 1e-6  # what the duality gap may be at any smaller tolerance: rounding of large terms stays in it


class Errors(NamedTuple):
    """The largest error of each kind of condition, rounding included; NaN where a number is not finite."""

    primal: float
    dual: float
    complementarity: float
    rows: float
    gap: float

    def meet(self, goal: float) -> Any:
        """Return whether all are small: constraints, then multipliers, products and rows, then the gap.

        The criterion, of everybody who calls a program optimal; of arrays of errors, an entry each.
        """
        is_small = self.primal <= constraint_tolerance(goal)
        for error in self[:4]:
            is_small = is_small & (error <= goal)
        return is_small & (self.gap <= max(OBJECTIVE, goal))

    def are_sure(self, goal: float) -> bool:
        """Return whether they meet the goal, and no exact proof of unboundedness may beat them."""
        return bool(self.meet(goal)) and max(self.dual, self.rows) <= SURE * goal

    @classmethod
    def of(cls, program: QuadraticProgram, x: FloatVector, multipliers: FloatVector) -> Errors:
        """Return the errors of x and of the multipliers of all constraints, in units of the program's data."""
        is_equality = program.constraints.is_equality
        signed = np.where(is_equality, multipliers, np.maximum(multipliers, 0.0))
        wrong = float((signed - multipliers).max(initial=0.0))
        errors = _measured(program, x, multipliers)
        if wrong <= 0.0:
            return errors
        coefficient, unknown, objective, _, _ = program.scaling
        excess = float(((signed - multipliers) * coefficient).max(initial=0.0))
        dual = _measured(program, x, signed).dual + excess / (objective + np.abs(program.c * unknown).max(initial=0.0))
        return errors._replace(dual=float(dual))


def _measured(program: QuadraticProgram, x: FloatVector, multipliers: FloatVector) -> Errors:
    from .kernels.program_residuals import program_residuals  # numba, which not every run needs

    matrices, rows = program.matrices, program.constraints
    worst, columns = np.zeros(7), np.zeros((4, program.n))
    program_residuals(
        *matrices.rows_of_hessian, *matrices.rows_of_constraints, program.h.size,
        program.c, rows.limit, rows.unit, rows.coefficient, program.dual_unit, np.array(program.scaling[2:4]), x,
        multipliers, columns, worst,
    )
    return Errors(*worst[: len(Errors._fields)].tolist())


def program_goal(tolerance: float) -> float:
    """Return the size of a program's own residuals that is called optimal at this tolerance of a run.

    Examples
    --------
    >>> program_goal(1e-8), program_goal(1e-4), program_goal(1e-12)
    (1e-06, 0.001, 1e-09)
    """
    return max(min(PROGRAM_TOLERANCE, STRICT * tolerance), 10.0 * tolerance)


def constraint_tolerance(tolerance: float) -> float:
    """Return the primal residual that is called optimal where the other conditions hold to a tolerance.

    A tenth of the tolerance, but no less than 1e-7 where the tolerance is no less: a program whose constraints
    contradict by 1e-6 is infeasible, not nearly feasible.

    Examples
    --------
    >>> constraint_tolerance(1e-6), constraint_tolerance(1e-12), constraint_tolerance(1e-3)
    (1e-07, 1e-12, 0.0001)
    """
    return max(SHARE * tolerance, min(tolerance, CONSTRAINTS))
