"""What a run found, put back into the Pyomo model: values, suffixes, and whether all that was stated holds."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pyomo.common.collections import ComponentMap
from pyomo.core import SortComponents, Suffix
from pyomo.core.staleflag import StaleFlagManager

from ...core.checks import FloatVector
from ...core.errors import UnsupportedModel
from ...core.settings import Settings, Status
from ...modeling.expressions.program import Program
from ..nl.answers import NLAnswer, NLModel, ProgramModel
from ..nl.content import NLContent
from ..nl.expressions import UNKNOWNS, Expressions
from ..nl.model import model_of
from ..nl.writing import write_nl
from .model import SOME, Statement, stated
from .pairs import Pair

FEASIBLE = 1e-6  # what holds beside the rows of the problem may be violated by that, or by ten times the tolerance
NO_POINT = (Status.INFEASIBLE, Status.NO_SOLUTION)


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a Pyomo model.

    Attributes
    ----------
    statement : Statement
    found : NLAnswer
    problem : NLModel
    values, duals : ComponentMap
        Of variables, of constraints and pairs.
    violated : str
        What was stated beside the problem and does not hold at the answer; empty where all of it does.
    """

    statement: Statement
    found: NLAnswer
    problem: NLModel
    values: ComponentMap
    duals: ComponentMap
    violated: str

    @property
    def has_point(self) -> bool:
        """True where there is something to load."""
        return self.found.x is not None and self.found.status not in NO_POINT

    @property
    def message(self) -> str:
        """How it ended, in a line."""
        return f"{self.found.message}; but {self.violated}" if self.violated else self.found.message

    @cached_property
    def reduced_costs(self) -> ComponentMap:
        """The multipliers of the variables' bounds: the rows of their pairs, or slopes of the Lagrangian."""
        variables, partners = self.statement.variables, self.statement.content.partners.tolist()
        if self.found.x is None or self.found.duals is None:
            return ComponentMap()
        found = {j: float(self.found.duals[i]) for i, j in enumerate(partners) if j >= 0}
        if isinstance(self.problem, ProgramModel):
            found = dict(enumerate(_slopes(self.statement.content, self.found.x, self.found.duals).tolist()))
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
        """Write the ``.nl`` file as it was solved, with names beside it where they are asked for."""
        content = self.statement.content
        write_nl(content if labels else replace(content, names=None, row_names=None), path)


def answered(model: Any, options: dict[str, Any], path: Path) -> Answer:
    """Return the answer to a Pyomo model, which is not changed.

    Parameters
    ----------
    model : Block
    options : dict
        Of :func:`lcp_plugin.solve`.
    path : Path
        Where Pyomo writes the rows.
    """
    statement = stated(model, path)
    problem = _problem(statement)
    found = problem.solve(**options)
    values, duals, violated = ComponentMap(), ComponentMap(), ""
    if found.x is not None and found.duals is not None:
        own = [(j, variable) for j, variable in enumerate(statement.variables) if j not in statement.added]
        values.update((variable, float(found.x[j])) for j, variable in own)
        duals.update(
            (row.stated if isinstance(row, Pair) else row, float(dual))
            for row, dual in zip(statement.rows, found.duals, strict=True) if row is not None
        )
    if values and found.status not in NO_POINT:
        tolerance = max(FEASIBLE, 10.0 * Settings(tolerance=options.get("tolerance", Settings.tolerance)).tolerance)
        violated = _violated(statement, values, tolerance)
    return Answer(statement, found, problem, values, duals, violated)


def _problem(statement: Statement) -> NLModel:
    try:
        return model_of(statement.content)
    except UnsupportedModel as error:
        added = [statement.content.names[j] for j in sorted(statement.added)] if statement.content.names else []
        if not added or statement.content.row_lower.size <= statement.content.lower.size:
            raise
        others = ", …" if len(added) > SOME else ""
        raise UnsupportedModel(
            f"{error}; one of the equations is for {', '.join(added[:SOME])}{others}: its pair holds no variable, or "
            "one that another pair holds"
        ) from error


def _slopes(content: NLContent, x: FloatVector, duals: FloatVector) -> FloatVector:
    """Return the gradient of the objective less the rows' multipliers times their gradients, shape (n,).

    By all variables, also those whose equal bounds make them numbers in the program.
    """
    n, m = content.lower.size, content.row_lower.size
    rows = Expressions(content, np.full(n, np.nan))
    results = np.arange(m + content.is_maximized.size)
    jacobian = Program.of(rows.compiler, [rows.rows(results)], {UNKNOWNS: 0}, n).jacobian(x)
    weights = np.append(-duals, np.ones(content.is_maximized.size))
    slopes: FloatVector = jacobian.T @ weights
    return slopes


def _violated(statement: Statement, values: ComponentMap, tolerance: float) -> str:
    """Return what does not hold beside the problem at the values."""
    if not statement.beside:
        return ""
    with _set_to(values):
        excesses = [beside.excess() for beside in statement.beside]
    worst = int(np.argmax(excesses))
    count = sum(excess > tolerance for excess in excesses)
    if not count:
        return ""
    beside, others = statement.beside[worst], f", nor {count - 1} more" if count > 1 else ""
    return f"{beside.name} does not hold{others}, off by {excesses[worst]:.2g}; it {beside.why}"


@contextmanager
def _set_to(values: ComponentMap) -> Iterator[None]:
    """Give the variables these values, and afterwards their own."""
    before = [(variable, variable.value, variable.stale) for variable in values]
    try:
        for variable, value in values.items():
            variable.set_value(value, skip_validation=True)
        yield
    finally:
        for variable, value, stale in before:
            variable.set_value(value, skip_validation=True)
            variable.stale = stale


def imported(model: Any, name: str) -> Any:
    """Return the suffix of that name that wants values from solvers, the nearest to the root, or None."""
    suffixes = model.component_objects(Suffix, active=True, descend_into=True, sort=SortComponents.deterministic)
    return next((suffix for suffix in suffixes if suffix.local_name == name and suffix.import_enabled()), None)
