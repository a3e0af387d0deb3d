"""Where the entries of a problem's variables and dual values stand in the program that cvxpy makes of it.

cvxpy's way back is linear: what it makes of unknowns that are counted from 1 says which unknown each entry is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from cvxpy import settings
from numpy.typing import NDArray

from ..checks import FloatVector
from ..conversions.program import QuadraticProgram
from ..conversions.qp_solution import QPSolution
from .qp_solver import Answer
from .stated_terms import dense_value


class Entries(NamedTuple):
    """Which unknown of (x, multipliers of G, multipliers of A) each entry of a value is, column by column.

    Attributes
    ----------
    places : ndarray of int
    signs : ndarray
        −1 where the entry is the unknown with the other sign, 0 where it is always zero.
    shape : tuple
    """

    places: NDArray[np.int64]
    signs: FloatVector
    shape: tuple[int, ...]

    @property
    def used(self) -> NDArray[np.int64]:
        """The unknowns of the entries that are not always zero."""
        used: NDArray[np.int64] = self.places[self.signs != 0.0]
        return used

    def taken(self, unknowns: FloatVector) -> Any:
        """Return the value that the unknowns give."""
        return (self.signs * unknowns[self.places]).reshape(self.shape, order="F")

    def add_to(self, total: FloatVector, gradient: Any) -> None:
        """Add what a gradient by the entries is by the unknowns."""
        np.add.at(total, self.places, self.signs * np.ravel(gradient, order="F"))

    def put_into(self, unknowns: FloatVector, value: Any) -> None:
        """Set the unknowns so that they give the value."""
        unknowns[self.used] = (self.signs * np.ravel(dense_value(value), order="F"))[self.signs != 0.0]


class ProgramEntries(NamedTuple):
    """The entries of each variable and of each dual value that cvxpy gives, by the ids of variables and constraints.

    None where one of them is no unknown.
    """

    variables: dict[int, Entries] | None
    duals: dict[int, Entries] | None

    @classmethod
    def of(cls, problem: Any, program: QuadraticProgram, chain: Any, inverse: Any) -> ProgramEntries:
        """Return the entries, from what ``problem.get_problem_data`` gave."""
        rows = program.constraints
        counted = np.arange(1.0, program.n + rows.rows + 1.0)

        def inverted(unknowns: FloatVector) -> tuple[dict[int, Any], dict[int, Any]]:
            x, y = np.split(unknowns, [program.n])
            solution = QPSolution(program, x, *rows.split(np.append(y, np.zeros(2 * program.n))))
            found = chain.invert(Answer(None, solution, settings.OPTIMAL, np.inf), inverse)
            return found.primal_vars, found.dual_vars or {}

        found, nothing = inverted(counted), inverted(np.zeros(counted.size))
        variables = {variable.id: variable.shape for variable in problem.variables()}
        duals = {one.id: one.dual_variables[0].shape for one in problem.constraints if one.id in found[1]}
        return cls(*map(_entries, (variables, duals), found, nothing))


def _entries(
    shapes: dict[int, tuple[int, ...]], counted: dict[int, Any], nothing: dict[int, Any]
) -> dict[int, Entries] | None:
    entries = {}
    for key, shape in shapes.items():
        if key not in counted or np.any(dense_value(nothing[key])):
            return None
        numbers = np.ravel(np.broadcast_to(dense_value(counted[key]), shape), order="F")
        if np.any(numbers != np.rint(numbers)):
            return None
        entries[key] = Entries(np.maximum(np.abs(numbers).astype(np.int64) - 1, 0), np.sign(numbers), shape)
    return entries
