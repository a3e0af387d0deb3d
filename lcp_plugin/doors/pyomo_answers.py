"""What a run found, put back into the Pyomo model: values, suffixes, and whether all that was stated holds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pyomo.common.collections import ComponentMap
from pyomo.core import SortComponents, Suffix
from pyomo.core.staleflag import StaleFlagManager

from ..checks import FloatVector
from ..errors import UnsupportedModel
from ..modeling.nl.answers import NLAnswer, NLModel, ProgramModel
from ..modeling.nl.model import model_of
from ..modeling.nl.writing import write_nl
from ..settings import Settings, Status
from .pyomo_model import SOME, Statement, stated
from .pyomo_pairs import Pair

FEASIBLE = 1e-6  # what holds beside the rows of the problem may be violated by that, or by ten times the tolerance
NO_POINT = (Status.INFEASIBLE, Status.NO_SOLUTION)


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a Pyomo model.

    Attributes
    ----------
    statement : Statement
    found : NLAnswer
    values, duals, reduced_costs : ComponentMap
        Of variables, of constraints and pairs, of variables.
    violated : str
        What was stated beside the problem and does not hold at the answer; empty where all of it does.
    """

    statement: Statement
    found: NLAnswer
    values: ComponentMap
    duals: ComponentMap
    reduced_costs: ComponentMap
    violated: str

    @property
    def has_point(self) -> bool:
        """True where there is something to load."""
        return self.found.status not in NO_POINT

    @property
    def message(self) -> str:
        """How it ended, in a line."""
        return f"{self.found.message}; but {self.violated}" if self.violated else self.found.message

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
    own = [(j, variable) for j, variable in enumerate(statement.variables) if j not in statement.added]
    values = ComponentMap((variable, float(found.x[j])) for j, variable in own)
    duals, reduced_costs = _multipliers(statement, found)
    if isinstance(problem, ProgramModel):
        slopes = _slopes(problem, found)
        reduced_costs = ComponentMap((variable, float(slopes[j])) for j, variable in own)
    tolerance = max(FEASIBLE, 10.0 * Settings(tolerance=options.get("tolerance", Settings.tolerance)).tolerance)
    violated = _violated(statement, values, tolerance) if found.status not in NO_POINT else ""
    return Answer(statement, found, values, duals, reduced_costs, violated)


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


def _multipliers(statement: Statement, found: NLAnswer) -> tuple[ComponentMap, ComponentMap]:
    """Return the values of the rows of pairs, by pair and by variable, and the multipliers of constraints."""
    duals, reduced_costs = ComponentMap(), ComponentMap()
    for i, row in enumerate(statement.rows):
        if not isinstance(row, str):
            duals[row.stated if isinstance(row, Pair) else row] = float(found.duals[i])
        partner = int(statement.content.partners[i])
        if partner >= 0 and partner not in statement.added:
            reduced_costs[statement.variables[partner]] = float(found.duals[i])
    return duals, reduced_costs


def _slopes(problem: ProgramModel, found: NLAnswer) -> FloatVector:
    """Return the gradient of the objective less the rows' multipliers times their gradients."""
    program, unknowns = problem.program, problem.unknowns
    slopes: FloatVector = -(problem.content.linear.T @ found.duals)
    sign = -1.0 if problem.content.is_maximized.any() else 1.0
    slopes[unknowns] += sign * (program.P @ found.x[unknowns] + program.c)
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
