"""The quadratic program that cvxpy compiles of a problem, and the problem's variables in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.error import DCPError, SolverError
from cvxpy.reductions.solution import Solution

from ..core.checks import FloatVector
from ..core.errors import UnsupportedModel
from ..expressions.rows import Indices
from ..problems.programs.program import QuadraticProgram
from .qp_solver import QPSolver, quadratic_program
from .stated_terms import dense_value


class Entries(NamedTuple):
    """Unknowns of a program that are the entries of a variable, column by column.

    Attributes
    ----------
    places : ndarray of int
    signs : ndarray
        −1 if the entry is the negative of the unknown, 0 if the entry is always zero.
    shape : tuple
    """

    places: Indices
    signs: FloatVector
    shape: tuple[int, ...]

    @classmethod
    def of(cls, variable: Any, columns: dict[int, int], chain: Any, inverse: Any) -> Entries:
        """Return the entries of a user's variable.

        cvxpy's own inversion would project the numbers onto the variable's bounds.
        """
        numbers = 1.0 + np.arange(variable.size).reshape(variable.shape, order="F")
        leaf = variable
        for reduction, known in zip(chain.reductions, inverse, strict=False):
            if isinstance(known, tuple) and known and isinstance(known[0], dict):
                # CvxAttr2Constr's variable instead of one with attributes.
                leaf = known[0].get(variable.id, leaf)
                if variable.id in known[0] and leaf.size != variable.size:
                    counted = {leaf.id: 1.0 + np.arange(leaf.size).reshape(leaf.shape, order="F")}
                    found = reduction.invert(
                        Solution(settings.OPTIMAL, 0.0, counted, {}, {}), known
                    )
                    numbers = found.primal_vars[variable.id]
        if leaf.id not in columns and variable.size:
            raise UnsupportedModel(
                f"cvxpy made a program in which {variable.name()} is not found again; use plain variables"
            )
        flat = np.rint(np.ravel(np.broadcast_to(dense_value(numbers), variable.shape), order="F"))
        places = np.maximum(np.abs(flat).astype(np.int64) - 1, 0) + columns.get(leaf.id, 0)
        return cls(places, np.sign(flat), variable.shape)

    def taken(self, unknowns: FloatVector) -> Any:
        """Return the value that the unknowns give."""
        return (self.signs * unknowns[self.places]).reshape(self.shape, order="F")

    def put_into(self, unknowns: FloatVector, value: Any) -> None:
        """Set the unknowns so that they give the value."""
        is_used = self.signs != 0.0
        flat = self.signs * np.ravel(dense_value(value), order="F")
        unknowns[self.places[is_used]] = flat[is_used]


@dataclass(frozen=True, eq=False)
class CompiledProblem:
    """The program that cvxpy compiles a problem to.

    Attributes
    ----------
    program : QuadraticProgram
    entries : dict
        Entries of each variable, by its id.
    """

    program: QuadraticProgram
    entries: dict[int, Entries]

    @classmethod
    def of(cls, problem: Any, *, is_folded: bool = False, **options: Any) -> CompiledProblem:
        """Return the program of a problem; if folded, rows of one unknown become bounds.

        Raises
        ------
        UnsupportedModel
            If it is not a quadratic program.
        """
        twin = cp.Problem(problem.objective, problem.constraints)  # what is compiled stays with it
        try:
            data, chain, inverse = twin.get_problem_data(QPSolver, **options)
        except (SolverError, DCPError) as error:
            raise UnsupportedModel(str(error)) from error
        program, columns = quadratic_program(data, {}), data[settings.PARAM_PROB].var_id_to_col
        if is_folded:
            program = program.folded.reduced
        entries = {one.id: Entries.of(one, columns, chain, inverse) for one in problem.variables()}
        program = program.with_vectors(constant=float(inverse[-1][settings.OFFSET]))
        return cls(program, entries)

    def values(self, x: FloatVector) -> dict[int, Any]:
        """Return the value of each variable by its id."""
        return {key: one.taken(x) for key, one in self.entries.items()}
