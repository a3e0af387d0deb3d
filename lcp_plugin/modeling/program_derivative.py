"""The derivative of a quadratic program's solution by its parameters, through its optimality conditions as an LCP.

z = (x, multipliers), M = [[P, Gᵀ, Aᵀ], [−G, 0, 0], [−A, 0, 0]], q = (c, h, b). Where a problem follows the DPP rules,
the program that cvxpy compiles is affine in the parameters: P, c and [A b] are tensors times (parameters, 1). With z
held they make one sparse Jacobian of M z + q by the parameters.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from cvxpy import settings
from cvxpy.reductions.solution import Solution
from numpy.typing import NDArray

from ..checks import FloatVector
from ..conversions.qp_solution import QPSolution
from ..errors import UnsuitableProblem, UnsupportedModel
from ..problem.lcp import LCP
from ._compat import dense
from .model_derivative import Changes
from .qp_solver import Answer

if TYPE_CHECKING:
    from ..solving.derivative import Derivative


NOT_UNIQUE = (
    "the minimum of the program, or its multipliers, are not determined by the active constraints alone: these are "
    "linearly dependent, or the objective is flat between them; drop redundant constraints, or make the objective "
    "strictly convex"
)


class Entries(NamedTuple):
    """Which unknown each entry of a variable or dual value is, up to a sign; 0 for an entry that is always zero."""

    places: NDArray[np.int64]
    signs: FloatVector
    shape: tuple[int, ...]

    @classmethod
    def of(cls, numbers: Any, first: int, shape: tuple[int, ...]) -> Entries:
        """Return the entries from numbers that count the unknowns from 1; `first` is the place of the first."""
        flat = np.rint(np.ravel(dense(numbers), order="F"))
        return cls(np.maximum(np.abs(flat).astype(np.int64) - 1, 0) + first, np.sign(flat), shape)

    def taken(self, unknowns: FloatVector) -> Any:
        """Return the variable's entries."""
        return (self.signs * unknowns[self.places]).reshape(self.shape, order="F")

    def add_to(self, total: FloatVector, gradient: Any) -> None:
        """Add what a gradient by the entries is by the unknowns."""
        np.add.at(total, self.places, self.signs * np.ravel(gradient, order="F"))


@contextmanager
def _in_words_of_programs() -> Iterator[None]:
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
    answer : Answer
        What the solver said of it.

    Raises
    ------
    UnsupportedModel
        Where a variable is not found again in the compiled program.
    """

    def __init__(self, problem: Any, data: Any, chain: Any, inverse_data: Any, answer: Answer) -> None:
        self._answer, self._program = answer, data[settings.PARAM_PROB]
        self._equations = int(data["n_eq"])
        self._variables = {
            variable.id: self._entries_of(variable, chain, inverse_data) for variable in problem.variables()
        }
        numbers = 1.0 + np.arange(self._multipliers.size)
        inequality, equality = np.split(numbers, [numbers.size - self._equations])
        zero = np.zeros(answer.solution.x.size)
        counted = QPSolution(answer.solution.program, zero, inequality, equality, zero, zero)
        inverted = chain.invert(Answer(answer.result, counted, settings.OPTIMAL, answer.goal), inverse_data)
        self._duals = [
            (constraint, Entries.of(inverted.dual_vars[constraint.id], zero.size, constraint.dual_variables[0].shape))
            for constraint in problem.constraints if constraint.id in (inverted.dual_vars or {})
        ]

    @property
    def constraints(self) -> list[Any]:
        """Those that have dual values."""
        return [constraint for constraint, _ in self._duals]

    def pushed(self, changes: Changes) -> tuple[Changes, list[tuple[Any, Any]]]:
        """Return the change of each variable, by its id, and of each dual value, with its constraint."""
        self._refuse_unsolved()
        by_column = np.zeros(self._jacobian.shape[1])
        for key, column in self._columns.items():
            part = np.ravel(changes[key], order="F")
            by_column[column : column + part.size] = part
        with _in_words_of_programs():
            dz = self._at.jvp(dq=self._jacobian @ by_column)
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
        with _in_words_of_programs():
            by_column = self._jacobian.T @ self._at.vjp(g).q
        parameters = {parameter.id: parameter for parameter in self._program.parameters}
        return {
            key: by_column[first : first + parameters[key].size].reshape(parameters[key].shape, order="F")
            for key, first in self._columns.items()
        }

    @property
    def _columns(self) -> dict[int, int]:
        """The first column of each parameter by its id; the constants have a negative id, and the last column."""
        known = {parameter.id for parameter in self._program.parameters}
        return {key: column for key, column in self._program.param_id_to_col.items() if key in known}

    @property
    def _multipliers(self) -> FloatVector:
        solution = self._answer.solution
        return np.concatenate([solution.inequality, solution.equality])

    def _entries_of(self, variable: Any, chain: Any, inverse_data: Any) -> Entries:
        """Return which of the compiled program's unknowns are the entries of a user's variable."""
        numbers, leaf = None, variable
        for reduction, data in zip(chain.reductions, inverse_data, strict=False):
            if isinstance(data, tuple) and data and isinstance(data[0], dict) and variable.id in data[0]:
                leaf = data[0][variable.id]  # CvxAttr2Constr's, in the place of the variable
                if leaf.size != variable.size:
                    counted = {leaf.id: 1.0 + np.arange(leaf.size).reshape(leaf.shape, order="F")}
                    numbers = reduction.invert(Solution(settings.OPTIMAL, 0.0, counted, {}, {}), data)
                    numbers = numbers.primal_vars[variable.id]
        if numbers is None:
            numbers = 1.0 + np.arange(variable.size).reshape(variable.shape, order="F")
        if leaf.id not in self._program.var_id_to_col and variable.size:
            raise UnsupportedModel(
                f"variable {variable.name()} is not among those of the program that cvxpy made; leave requires_grad "
                "out, or use a plain variable"
            )
        return Entries.of(numbers, self._program.var_id_to_col.get(leaf.id, 0), variable.shape)

    def _refuse_unsolved(self) -> None:
        if self._answer.status != settings.OPTIMAL:
            raise UnsuitableProblem(
                f"only a solution has a derivative, and this run ended {self._answer.status}: "
                f"{self._answer.result.advice}"
            )

    @cached_property
    def _at(self) -> Derivative:
        """The derivative of the optimality conditions; rows without a limit have no multiplier."""
        from ..solving.derivative import Derivative  # with compiled kernels, which a program alone does not need

        solution, program = self._answer.solution, self._answer.solution.program
        rows = sp.csr_array(sp.vstack([program.G, program.A]))
        M = sp.block_array([[program.P, rows.T], [-rows, None]], format="csr")
        limits, free = np.concatenate([program.h, program.b]), np.full(program.n, np.inf)
        is_limit, none = np.isfinite(limits), np.full(program.b.size, np.inf)
        q = np.concatenate([program.c, np.where(is_limit, limits, 0.0)])
        lower = np.concatenate([-free, np.zeros(program.h.size), -none])
        upper = np.concatenate([free, np.where(is_limit[: program.h.size], np.inf, 0.0), none])
        z = np.concatenate([solution.x, self._multipliers])
        problem = LCP(M, q, lower=lower, upper=upper)
        return Derivative(problem, z, problem.M @ z + problem.q)

    @cached_property
    def _jacobian(self) -> sp.csr_array:
        """The derivative of M z + q by the columns of the parameters, z held.

        cvxpy's rows are A x + b = 0 first, then A x + b ≥ 0; entry (i, j) of [A b] is row i + j·rows of the tensor.
        """
        program, z = self._program, self._at.z
        n = program.x.size
        x, y, equality = np.split(z, [n, z.size - self._equations])
        multipliers = np.append(equality, -y)
        rows = multipliers.size
        place = n + np.append(y.size + np.arange(equality.size), np.arange(y.size))
        sign = np.append(np.full(equality.size, -1.0), np.ones(y.size))
        A, c = sp.coo_array(program.A), sp.coo_array(program.q)
        i, j = A.row % max(rows, 1), A.row // max(rows, 1)
        is_linear = j < n
        parts = [
            (c.row, c.col, np.where(c.row < n, c.data, 0.0)),
            (np.where(is_linear, j, 0), A.col, np.where(is_linear, multipliers[i] * A.data, 0.0)),
            (place[i], A.col, sign[i] * np.append(x, 1.0)[j] * A.data),
        ]
        if program.P is not None:
            P = sp.coo_array(program.P)
            parts.append((P.row % n, P.col, P.data * x[P.row // n]))
        row, column, data = (np.concatenate(part) for part in zip(*parts, strict=True))
        row = np.where(data != 0.0, row, 0)  # the constant of the objective has no row
        whole = sp.csr_array(sp.coo_array((data, (row, column)), shape=(z.size, program.q.shape[1])))
        return sp.csr_array(whole[:, :-1])
