"""The solution of a run, put back into the Pyomo model: values and suffixes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pyomo.common.collections import ComponentMap
from pyomo.core import SortComponents, Suffix
from pyomo.core.staleflag import StaleFlagManager

from ...core.checks import FloatVector
from ...core.errors import UnsupportedModel
from ...core.settings import Status
from ..nl.model import NLAnswer, NLModel, ProgramModel, model_of, values_and_slopes
from ..nl.reading import NLContent
from ..nl.writing import write_nl
from .model import SOME, PyomoStatement, stated
from .pairs import Pair

NO_POINT = (Status.INFEASIBLE, Status.NO_SOLUTION)


@dataclass(frozen=True, eq=False)
class PyomoAnswer:
    """The answer to a Pyomo model.

    Attributes
    ----------
    statement : Statement
    found : NLAnswer
    problem : NLModel
    values, duals : ComponentMap
        Of variables, of constraints and pairs.
    """

    statement: PyomoStatement
    found: NLAnswer
    problem: NLModel
    values: ComponentMap
    duals: ComponentMap

    @property
    def is_violated(self) -> bool:
        """True if the pairs are solved and a side condition is violated."""
        return self.found.result.is_solved and not self.found.is_solved

    @property
    def has_point(self) -> bool:
        """True if there is something to load."""
        return self.found.x is not None and self.found.status not in NO_POINT

    @cached_property
    def reduced_costs(self) -> ComponentMap:
        """The multipliers of the variables' bounds: the rows of their pairs, or slopes of the Lagrangian."""
        variables, partners = self.statement.variables, self.statement.content.partners.tolist()
        if self.found.x is None or self.found.duals is None:
            return ComponentMap()
        found = {j: float(self.found.duals[i]) for i, j in enumerate(partners) if j >= 0}
        if isinstance(self.problem, ProgramModel):
            found = dict(
                enumerate(_slopes(self.statement.content, self.found.x, self.found.duals).tolist())
            )
        own = [j for j in found if j not in self.statement.added and math.isfinite(found[j])]
        return ComponentMap((variables[j], found[j]) for j in own)

    def load(self, model: Any) -> None:
        """Put values and suffixes into the model."""
        if not self.has_point:
            return
        StaleFlagManager.mark_all_as_stale()
        for variable, value in self.values.items():
            variable.set_value(value, skip_validation=True)
        StaleFlagManager.mark_all_as_stale(delayed=True)
        for name, values in (("dual", self.duals), ("rc", self.reduced_costs)):
            if (suffix := imported(model, name)) is not None:
                suffix.clear()
                suffix.update(values)

    def keep(self, path: Path, labels: bool) -> None:
        """Write the ``.nl`` file of the solved model, and files of names if requested."""
        content = self.statement.in_a_file
        write_nl(content if labels else replace(content, names=None, row_names=None), path)


def content_of(model: Any) -> NLContent:
    """Return the content of a Pyomo model, as it is passed to the solver."""
    with TemporaryDirectory() as folder:
        statement = stated(model, Path(folder) / "model.nl")
    return statement.in_a_file


def answered(model: Any, options: dict[str, Any], path: Path) -> PyomoAnswer:
    """Return the solution of a Pyomo model, which is not changed.

    Parameters
    ----------
    model : Block
    options : dict
        Options of :func:`lcp_plugin.solve`.
    path : Path
        Path of the file that Pyomo writes.
    """
    statement = stated(model, path)
    problem = _problem(statement)
    found = problem.solve(**options)
    values, duals = ComponentMap(), ComponentMap()
    if found.x is not None and found.duals is not None:
        values.update(
            (variable, float(found.x[j]))
            for j, variable in enumerate(statement.variables)
            if j not in statement.added
        )
        duals.update(
            (row.stated if isinstance(row, Pair) else row, float(dual))
            for row, dual in zip(statement.rows, found.duals, strict=True)
            if row is not None
        )
    return PyomoAnswer(statement, found, problem, values, duals)


def _problem(statement: PyomoStatement) -> NLModel:
    content = statement.content
    try:
        return model_of(content)
    except UnsupportedModel as error:
        if not (statement.added and content.names and content.row_lower.size > content.lower.size):
            raise
        added = ", ".join(content.names[j] for j in sorted(statement.added)[:SOME])
        raise UnsupportedModel(
            f"{error}; one of the equations is for {added}: its pair holds no variable, or one that another pair holds"
        ) from error


def _slopes(content: NLContent, x: FloatVector, duals: FloatVector) -> FloatVector:
    """Return the gradient of the objective less the rows' multipliers times their gradients, shape (n,).

    The gradient is by all variables, including variables with equal bounds, which are constants in the program.
    """
    weights = np.append(-duals, np.ones(content.is_maximized.size))
    slopes: FloatVector = values_and_slopes(content, x, np.arange(weights.size))[1].T @ weights
    return slopes


def imported(model: Any, name: str) -> Any:
    """Return the suffix of that name nearest to the root that imports values, or None."""
    suffixes = model.component_objects(
        Suffix, active=True, descend_into=True, sort=SortComponents.deterministic
    )
    return next(
        (suffix for suffix in suffixes if suffix.local_name == name and suffix.import_enabled()),
        None,
    )
