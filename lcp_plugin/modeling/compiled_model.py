"""An LCP together with the way back to the values and duals of a cvxpy problem."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import FloatVector
from ..problem.lcp import LCP
from .elimination import Elimination


@dataclass(eq=False)
class Report:
    """What to write back into a constraint's dual variable: scale · (w or z)[columns] + shift."""

    constraint: Any
    columns: NDArray[np.int64]
    shape: tuple[int, ...]
    is_slack: bool
    scale: Any = 1.0
    shift: Any = 0.0

    def value(self, z: FloatVector, w: FloatVector) -> NDArray[np.float64]:
        """Return the dual value in the constraint's own shape."""
        values: FloatVector = self.scale * (w if self.is_slack else z)[self.columns] + self.shift
        return values.reshape(self.shape, order="F")


@dataclass(eq=False)
class Model:
    """An LCP together with the way back to the cvxpy variables and constraints."""

    problem: LCP
    variables: list[Any]
    offsets: dict[int, int]
    reports: list[Report] = field(repr=False)
    elimination: Elimination | None = field(default=None, repr=False)

    def unknowns(self, z: FloatVector) -> FloatVector:
        """Return all unknowns of the model: those of the problem, and those that equations define."""
        return z if self.elimination is None else self.elimination.expand(z)

    def values(self, z: FloatVector) -> dict[int, Any]:
        """Return the value of each variable by its id, in its own shape."""
        values, z = {}, self.unknowns(z)
        for variable in self.variables:
            start = self.offsets[variable.id]
            values[variable.id] = z[start : start + variable.size].reshape(variable.shape, order="F")
        return values

    def duals(self, z: FloatVector, w: FloatVector) -> list[tuple[Any, Any]]:
        """Return (constraint, dual value): w for what bounds a variable, the variable for what bounds w."""
        if self.elimination is not None:
            w = self.elimination.expand_slack(w)
        z = self.unknowns(z)
        return [(report.constraint, report.value(z, w)) for report in self.reports]

    def start(self) -> FloatVector | None:
        """Return the present values of all variables as one vector; None where one has no value."""
        if any(variable.value is None for variable in self.variables):
            return None
        z = np.zeros(self.problem.n if self.elimination is None else self.elimination.offset.size)
        for variable in self.variables:
            first = self.offsets[variable.id]
            z[first : first + variable.size] = np.ravel(variable.value, order="F")
        return z if self.elimination is None else z[self.elimination.kept]
