"""The problem that a model became, the way back to its variables and constraints, and where its data come from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.certificates.row_residuals import magnitude
from ..core.checks import FloatVector
from ..core.errors import UnsupportedModel
from ..core.lcp import LCP
from ..problems.cones.data import Blocks
from ..problems.nonlinear.data import NonlinearProblem
from ._compat import by_columns, name_of
from .equations import Elimination
from .stated_terms import dense_value, values_below

DISAGREEMENT = 1e-9  # of the terms of a row


@dataclass(eq=False)
class DualReport:
    """What to write back into a constraint's dual variable: scale · (w or z)[columns] + shift."""

    constraint: Any
    columns: NDArray[np.int64]
    shape: tuple[int, ...]
    is_slack: bool
    scale: Any = 1.0
    shift: Any = 0.0
    expression: Any = None  # whose parameters move scale and shift

    def value(self, z: FloatVector, w: FloatVector) -> NDArray[np.float64]:
        """Return the dual value in the constraint's own shape."""
        values: FloatVector = self.scale * (w if self.is_slack else z)[self.columns] + self.shift
        return values.reshape(self.shape, order="F")


@dataclass(eq=False)
class Model:
    """A complementarity problem together with the way back to the cvxpy variables and constraints.

    `problem` is an LCP where everything is affine, with cones a ConeProblem or a FrictionalContact, else a
    NonlinearProblem.
    """

    problem: LCP | NonlinearProblem | Blocks
    variables: list[Any]
    offsets: dict[int, int]
    reports: list[DualReport] = field(repr=False)
    elimination: Elimination = field(repr=False)
    sources: Sources = field(repr=False)

    def lcp(self, purpose: str) -> LCP:
        """Return the LCP; raise where there is none.

        Raises
        ------
        UnsupportedModel
            Saying that the purpose needs affine sides.
        """
        if isinstance(self.problem, LCP):
            return self.problem
        if isinstance(self.problem, Blocks):
            raise UnsupportedModel(
                f'{purpose} takes no cones, and this model has some; problem.solve(method="LCP") solves it'
            )
        raise UnsupportedModel(
            f'{purpose} needs affine sides, and this model has nonlinear ones; problem.solve(method="LCP") solves it'
        )

    def values(self, z: FloatVector) -> dict[int, Any]:
        """Return the value of each variable by its id, in its own shape."""
        return self.split(self.elimination.expand(z))

    def split(self, unknowns: FloatVector) -> dict[int, Any]:
        """Return what belongs to each variable, by its id and in its shape."""
        places = [(variable, self.offsets[variable.id]) for variable in self.variables]
        return {
            v.id: unknowns[start : start + v.size].reshape(v.shape, order="F")
            for v, start in places
        }

    def duals(self, z: FloatVector, w: FloatVector) -> list[tuple[Any, Any]]:
        """Return (constraint, dual value): w for what bounds a variable, the variable for what bounds w."""
        z, w = self.elimination.expand(z), self.elimination.expand_slack(w)
        return [(report.constraint, report.value(z, w)) for report in self.reports]

    def start(self) -> FloatVector | None:
        """Return the present values of all variables and slacks as one vector; None where a variable has no value."""
        if any(variable.value is None for variable in self.variables):
            return None
        z = np.zeros(self.elimination.offset.size)
        for variable in self.variables:
            first = self.offsets[variable.id]
            z[first : first + variable.size] = np.ravel(variable.value, order="F")
        with np.errstate(all="ignore"):  # outside of a domain
            for k, columns in self.sources.slacks.items():
                value = by_columns(self.sources.functions[k].value)
                # A start over cones is projected by their solver.
                z[columns] = value if isinstance(self.problem, Blocks) else np.maximum(value, 0.0)
        return z[self.elimination.kept]


@dataclass(frozen=True, eq=False)
class BoundSource:
    """Bounds of some unknowns: lower ≤ expression ≤ upper, where the expression is weights · unknowns + constants.

    Attributes
    ----------
    columns : ndarray of int
        The unknowns.
    weights : ndarray
        None of them zero.
    expression : cvxpy expression
    lower, upper : number, array or cvxpy expression
    """

    columns: NDArray[np.int64]
    weights: FloatVector
    expression: Any
    lower: Any
    upper: Any


@dataclass(frozen=True, eq=False)
class Sources:
    """Where the data of an LCP come from: the expressions of a model, before definitions were put in.

    Attributes
    ----------
    functions : list of cvxpy expression
        Those of the pairs, then those of the equations.
    matrices : csr_array, csr_array
        The entries of the pairs and of the equations, over all unknowns; empty in a nonlinear model, which nothing is
        eliminated from.
    places : ndarray of int, shape (n,)
        Which row is each row of the LCP, up to `signs`: of the pairs, then of the equations that define nothing.
    signs : ndarray, shape (n,)
    bounds : list of BoundSource
        What holds of an unknown is what comes last.
    slacks : dict
        From the number of a function to the unknowns that its rows are less than its expression, one a row.
    friction : list of pairs
        Coefficients as they were stated, and of how many contacts they are.
    """

    functions: list[Any]
    matrices: tuple[sp.csr_array, sp.csr_array]
    places: NDArray[np.int64]
    signs: FloatVector
    bounds: list[BoundSource]
    slacks: dict[int, NDArray[np.int64]]
    friction: list[tuple[Any, int]] = field(default_factory=list)


def contradiction(model: Model, z: FloatVector, w: FloatVector) -> str | None:
    """Return what the expressions themselves, evaluated by cvxpy, say against w, or None.

    Parameters
    ----------
    model : Model
        Whose variables have the values of z.
    z, w : array, shape (n,)
    """
    sources, elimination, problem = model.sources, model.elimination, model.problem
    with np.errstate(all="ignore"):
        found = values_below(sources.functions)
        values = [
            np.ravel(dense_value(found[id(expression)]), order="F")
            for expression in sources.functions
        ]
    unknowns = elimination.expand(z)
    for k, columns in sources.slacks.items():
        values[k] = values[k] - unknowns[columns]
    theirs = np.concatenate([*values, np.zeros(0)])
    expected, terms = np.zeros((2, theirs.size))
    left = np.delete(np.arange(theirs.size), sources.matrices[0].shape[0] + elimination.rows)[
        sources.places
    ]
    expected[left] = sources.signs * w
    if not isinstance(problem, NonlinearProblem):
        terms = np.concatenate([abs(matrix) @ np.abs(unknowns) for matrix in sources.matrices])
    else:
        terms[left] = magnitude(problem.linearised(z), z)
    allowed = DISAGREEMENT * (terms + np.abs(theirs) + np.abs(expected))
    wrong = np.flatnonzero(np.isfinite(expected) & ~(np.abs(theirs - expected) <= allowed))
    if not wrong.size:
        return None
    owner = np.searchsorted(np.cumsum([value.size for value in values]), wrong[0], side="right")
    less = " less its slack" if owner in sources.slacks else ""
    return (
        f"{name_of(sources.functions[owner])}{less} is {theirs[wrong[0]]:.9g} in one entry at the values of its "
        f"variables, and {expected[wrong[0]]:.9g} was computed"
    )
