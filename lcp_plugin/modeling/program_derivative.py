"""The derivative of a quadratic program's solution by its parameters, through its optimality conditions as an LCP.

z = (x, multipliers), M = [[P, Gᵀ, Aᵀ], [−G, 0, 0], [−A, 0, 0]], q = (c, h, b). Where a problem follows the DPP rules,
the program that cvxpy compiles is affine in the parameters: P, c and [A b] are tensors times (parameters, 1). With z
held they make one sparse Jacobian of M z + q by the parameters.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy import settings

from ..core.checks import FloatVector
from ..core.errors import UnsuitableProblem, UnsupportedModel
from ..core.lcp import LCP
from ..problems.programs.conversion import conditions
from ._compat import by_columns, dense, leaf_value
from .model_derivative import Changes
from .qp_solver import SAME, ProgramEntries, SolverAnswer

if TYPE_CHECKING:
    from ..problems.sensitivity import Derivative


ROUNDING = 1e-9  # of the terms of a residual that is computed in two ways

NOT_UNIQUE = (
    "the minimum of the program, or its multipliers, are not determined by the active constraints alone: these are "
    "linearly dependent, or the objective is flat between them; drop redundant constraints, or make the objective "
    "strictly convex"
)


@contextmanager
def in_words_of_programs() -> Iterator[None]:
    """Say of a program what is said of its optimality conditions."""
    try:
        yield
    except UnsuitableProblem as error:
        raise UnsuitableProblem(NOT_UNIQUE) from error


def refuse_undisciplined(chain: Any) -> None:
    """Raise where cvxpy compiled a program without its parameters, because they break the DPP rules."""
    if any(type(reduction).__name__ == "EvalParams" for reduction in chain.reductions):
        raise UnsupportedModel(
            "gradients of a quadratic program need the DPP rules, by which every number of the program is affine in "
            "the parameters; make the offending expression a parameter of its own, or state the optimality conditions "
            "with complements, where parameters may stand anywhere"
        )


class ProgramDerivative:
    """The derivative at the solution of a quadratic program that cvxpy compiled.

    Parameters
    ----------
    problem : cvxpy.Problem
        Nothing of it is kept but its constraints.
    data, chain, inverse_data
        What ``problem.get_problem_data`` returned.
    answer : SolverAnswer
        What the solver said of it.
    known : dict
        From the id of a parameter to the value with which the program was solved.

    Raises
    ------
    UnsupportedModel
        Where a variable is not found again in the compiled program.
    """

    def __init__(
        self,
        problem: Any,
        data: Any,
        chain: Any,
        inverse_data: Any,
        answer: SolverAnswer,
        known: Changes,
    ) -> None:
        self._answer, self._program, self._known = answer, data[settings.PARAM_PROB], known
        self._equations = int(data["n_eq"])
        variables, duals = ProgramEntries.of(
            problem, answer.solution.program, data, chain, inverse_data
        )
        if variables is None:
            raise UnsupportedModel(
                f"cvxpy {cp.__version__} made a program in which a variable is not found again; leave requires_grad "
                "out, or use plain variables"
            )
        self._variables = variables
        self._duals = [(one, duals[one.id]) for one in problem.constraints if one.id in duals]

    def confirm(self, problem: Any) -> None:
        """Raise where the compiled program, as it is read here, is not the one that was solved and unpacked.

        Parameters
        ----------
        problem : cvxpy.Problem
            With the values of the solve.
        """
        if self._answer.status != settings.OPTIMAL:
            return
        z, point = self._z, self._by_column(self._known)
        point[-1] = 1.0
        found = [
            (self._variables[variable.id].taken(z), leaf_value(variable))
            for variable in problem.variables()
        ]
        found += [(entries.taken(z), constraint.dual_value) for constraint, entries in self._duals]
        residual = self._residual(z)
        M, q = self._conditions.M, self._conditions.q
        error, terms = np.abs(residual @ point - (M @ z + q)), abs(M) @ np.abs(z) + np.abs(q)
        is_same = (error <= ROUNDING * (abs(residual) @ np.abs(point) + terms)).all()
        goal = (
            SAME * self._answer.goal
        )  # cvxpy projects values on the attributes of their variables
        if not is_same or not all(_agree(own, dense(theirs), goal) for own, theirs in found):
            raise UnsupportedModel(
                f"cvxpy {cp.__version__} compiled this program to a layout that is not known here, so that its "
                "gradients would be wrong; leave requires_grad out, or use a release from 1.6 to 1.9"
            )

    @property
    def constraints(self) -> list[Any]:
        """Those that have dual values."""
        return [constraint for constraint, _ in self._duals]

    def pushed(self, changes: Changes) -> tuple[Changes, list[tuple[Any, Any]]]:
        """Return the change of each variable, by its id, and of each dual value, with its constraint."""
        self._refuse_unsolved()
        with in_words_of_programs():
            dz = self._at.jvp(dq=self._jacobian @ self._by_column(changes)[:-1])
        self._require_determined(
            np.concatenate([entries.used for entries in self._variables.values()])
        )
        variables = {key: entries.taken(dz) for key, entries in self._variables.items()}
        return variables, [(constraint, entries.taken(dz)) for constraint, entries in self._duals]

    def pulled(self, by_variable: Changes, by_dual: Changes) -> Changes:
        """Return the gradients by the parameters, by their ids."""
        self._refuse_unsolved()
        g = np.zeros(self._jacobian.shape[0])
        for key, entries in self._variables.items():
            entries.add_to(g, by_variable[key])
        for constraint, entries in self._duals:
            if constraint.id in by_dual:
                entries.add_to(g, by_dual[constraint.id])
        self._require_determined(np.flatnonzero(g))
        with in_words_of_programs():
            by_column = self._jacobian.T @ self._at.vjp(g).q
        parameters = {parameter.id: parameter for parameter in self._program.parameters}
        return {
            key: by_column[first : first + parameters[key].size].reshape(
                parameters[key].shape, order="F"
            )
            for key, first in self._columns.items()
        }

    def _require_determined(self, entries: Any) -> None:
        """Raise where these have several values at the minimum: multipliers may, where they are not asked for."""
        if not self._at.determined[entries].all():
            raise UnsuitableProblem(NOT_UNIQUE)

    @property
    def _columns(self) -> dict[int, int]:
        """The first column of each parameter by its id; the constants have a negative id, and the last column."""
        known = {parameter.id for parameter in self._program.parameters}
        return {
            key: column for key, column in self._program.param_id_to_col.items() if key in known
        }

    def _by_column(self, values: Changes) -> FloatVector:
        """Return values of the parameters in their columns, and 0 in the last one."""
        whole = np.zeros(self._program.q.shape[1])
        for key, column in self._columns.items():
            part = by_columns(values[key])
            whole[column : column + part.size] = part
        return whole

    @property
    def _multipliers(self) -> FloatVector:
        solution = self._answer.solution
        return np.concatenate([solution.inequality, solution.equality])

    def _refuse_unsolved(self) -> None:
        if self._answer.status != settings.OPTIMAL:
            raise UnsuitableProblem(
                f"only a solution has a derivative, and this run ended {self._answer.status}: "
                f"{self._answer.result.advice}"
            )

    @property
    def _z(self) -> FloatVector:
        return np.concatenate([self._answer.solution.x, self._multipliers])

    @cached_property
    def _conditions(self) -> LCP:
        return conditions(self._answer.solution.program)

    @cached_property
    def _at(self) -> Derivative:
        from ..problems.sensitivity import (
            Derivative,  # with compiled kernels, which a program alone does not need
        )

        problem, z = self._conditions, self._z
        return Derivative(problem, z, problem.M @ z + problem.q)

    @cached_property
    def _jacobian(self) -> sp.csr_array:
        """The derivative of M z + q by the columns of the parameters, z held."""
        return sp.csr_array(self._residual(self._at.z)[:, :-1])

    def _residual(self, z: FloatVector) -> sp.csr_array:
        """Return the matrix that makes M z + q of (parameters, 1), z held.

        cvxpy's rows are A x + b = 0 first, then A x + b ≥ 0; entry (i, j) of [A b] is row i + j·rows of the tensor.
        """
        program = self._program
        n = program.x.size
        x, y, equality = np.split(z, [n, z.size - self._equations])
        multipliers = np.append(equality, -y)
        place = n + np.append(y.size + np.arange(equality.size), np.arange(y.size))
        sign = np.append(np.full(equality.size, -1.0), np.ones(y.size))
        A, c = sp.coo_array(program.A), sp.coo_array(program.q)
        data = np.where(np.isfinite(A.data), A.data, 0.0)  # rows without a limit
        j, i = np.divmod(A.row, max(multipliers.size, 1))
        of_x, of_c = j < n, c.row < n  # the others are b, and the constant of the objective
        parts = [
            (c.row[of_c], c.col[of_c], c.data[of_c]),
            (j[of_x], A.col[of_x], (multipliers[i] * data)[of_x]),
            (place[i], A.col, sign[i] * np.append(x, 1.0)[j] * data),
        ]
        if program.P is not None:
            P = sp.coo_array(program.P)
            parts.append((P.row % n, P.col, P.data * x[P.row // n]))
        row, column, values = (np.concatenate(part) for part in zip(*parts, strict=True))
        return sp.csr_array(
            sp.coo_array((values, (row, column)), shape=(z.size, program.q.shape[1]))
        )


def _agree(own: Any, theirs: Any, tolerance: float) -> bool:
    return bool((np.abs(own - theirs) <= tolerance * (1.0 + np.abs(own).max(initial=0.0))).all())
