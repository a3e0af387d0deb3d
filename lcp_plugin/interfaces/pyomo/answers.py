"""What a run found, put back into the Pyomo model: values and suffixes.

Pyomo's newer solver interface, ``pyomo.contrib.solver``, stands over the same answers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from pyomo.common.collections import ComponentMap
from pyomo.common.tee import TeeStream
from pyomo.contrib.solver.common import solution_loader
from pyomo.contrib.solver.common.base import Availability, SolverBase
from pyomo.contrib.solver.common.config import SolverConfig
from pyomo.contrib.solver.common.factory import SolverFactory
from pyomo.contrib.solver.common.results import Results, SolutionStatus, TerminationCondition
from pyomo.contrib.solver.common.util import NoFeasibleSolutionError, NoOptimalSolutionError
from pyomo.core import Constraint, Objective, SortComponents, Suffix
from pyomo.core.expr.visitor import identify_variables
from pyomo.core.staleflag import StaleFlagManager

from ... import __version__
from ...core.checks import FloatVector
from ...core.errors import UnsupportedModel
from ...core.settings import Status
from ..nl.answers import NLAnswer, NLModel, ProgramModel
from ..nl.checks import jacobian
from ..nl.content import NLContent
from ..nl.model import model_of
from ..nl.writing import write_nl
from .model import SOME, Statement, stated
from .pairs import Pair

NO_POINT = (Status.INFEASIBLE, Status.NO_SOLUTION)
ENDS = {
    Status.SOLVED: TerminationCondition.convergenceCriteriaSatisfied,
    Status.UNBOUNDED: TerminationCondition.unbounded,
    Status.MAX_ITERATIONS: TerminationCondition.iterationLimit,
    Status.MAX_SECONDS: TerminationCondition.maxTimeLimit,
    Status.INTERRUPTED: TerminationCondition.interrupted,
    Status.INFEASIBLE: TerminationCondition.provenInfeasible,
    Status.NO_SOLUTION: TerminationCondition.provenInfeasible,
}
NOT_JUDGED = getattr(SolutionStatus, "unknown", SolutionStatus.infeasible)
LOADER = getattr(solution_loader, "SolutionLoader", None) or solution_loader.SolutionLoaderBase


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

    statement: Statement
    found: NLAnswer
    problem: NLModel
    values: ComponentMap
    duals: ComponentMap

    @property
    def is_violated(self) -> bool:
        """True where the pairs are solved, and something that stands beside them does not hold."""
        return self.found.result.is_solved and not self.found.is_solved

    @property
    def has_point(self) -> bool:
        """True where there is something to load."""
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
        """Write the ``.nl`` file as it was solved, with names beside it where they are asked for."""
        content = self.statement.in_a_file
        write_nl(content if labels else replace(content, names=None, row_names=None), path)


def content_of(model: Any) -> NLContent:
    """Return what a file of a Pyomo model holds: the model as it is solved."""
    with TemporaryDirectory() as folder:
        statement = stated(model, Path(folder) / "model.nl")
    return statement.in_a_file


def answered(model: Any, options: dict[str, Any], path: Path) -> PyomoAnswer:
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
    values, duals = ComponentMap(), ComponentMap()
    if found.x is not None and found.duals is not None:
        own = [
            (j, variable)
            for j, variable in enumerate(statement.variables)
            if j not in statement.added
        ]
        values.update((variable, float(found.x[j])) for j, variable in own)
        values.update(
            (variable, _nearest_to_zero(variable)) for variable in _without_weight(model, values)
        )
        duals.update(
            (row.stated if isinstance(row, Pair) else row, float(dual))
            for row, dual in zip(statement.rows, found.duals, strict=True)
            if row is not None
        )
    return PyomoAnswer(statement, found, problem, values, duals)


def _without_weight(model: Any, values: ComponentMap) -> list[Any]:
    """Return the variables that the model mentions and its file does not: all that they stand in is 0."""
    found = ComponentMap()
    for stated_one in model.component_data_objects(
        (Objective, Constraint), active=True, descend_into=True
    ):
        if stated_one.expr is not None:
            found.update(
                (one, None) for one in identify_variables(stated_one.expr, include_fixed=False)
            )
    return [one for one in found if one not in values and one.value is None]


def _nearest_to_zero(variable: Any) -> float:
    lower, upper = variable.bounds
    return float(
        max(0.0 if lower is None else lower, min(0.0, math.inf if upper is None else upper))
    )


def _problem(statement: Statement) -> NLModel:
    try:
        return model_of(statement.content)
    except UnsupportedModel as error:
        added = (
            [statement.content.names[j] for j in sorted(statement.added)]
            if statement.content.names
            else []
        )
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
    weights = np.append(-duals, np.ones(content.is_maximized.size))
    slopes: FloatVector = jacobian(content, x, np.arange(weights.size)).T @ weights
    return slopes


def imported(model: Any, name: str) -> Any:
    """Return the suffix of that name that wants values from solvers, the nearest to the root, or None."""
    suffixes = model.component_objects(
        Suffix, active=True, descend_into=True, sort=SortComponents.deterministic
    )
    return next(
        (suffix for suffix in suffixes if suffix.local_name == name and suffix.import_enabled()),
        None,
    )


class Loader(LOADER):  # type: ignore[misc, valid-type]
    """Puts an answer into the model, or hands it out."""

    def __init__(self, answer: PyomoAnswer, model: Any) -> None:
        self.answer, self._pyomo_model = answer, model

    def get_number_of_solutions(self) -> int:
        """Return 1, or 0 where the model has no solution."""
        return int(self.answer.has_point)

    def load_vars(self, vars_to_load: Iterable[Any] | None = None) -> None:
        """Set the variables."""
        for variable, value in self.get_vars(vars_to_load).items():
            variable.set_value(value, skip_validation=True)

    def get_vars(self, vars_to_load: Iterable[Any] | None = None) -> ComponentMap:
        """Return the values of the variables."""
        return self._chosen(self.answer.values, vars_to_load)

    get_primals = get_vars

    def get_duals(self, cons_to_load: Iterable[Any] | None = None) -> Any:
        """Return the values of pairs' rows, and the multipliers of a program."""
        return dict(self._chosen(self.answer.duals, cons_to_load).items())

    def get_reduced_costs(self, vars_to_load: Iterable[Any] | None = None) -> ComponentMap:
        """Return the multipliers of the variables' bounds."""
        return self._chosen(self.answer.reduced_costs, vars_to_load)

    def load_solution(self) -> None:
        """Put values and suffixes into the model."""
        self.answer.load(self._pyomo_model)

    def _chosen(self, values: ComponentMap, wanted: Iterable[Any] | None) -> ComponentMap:
        """Return those that are wanted; raise where the model has no solution that they could belong to."""
        if not self.answer.has_point:
            raise _error_with(NoFeasibleSolutionError, self.answer.found.message)
        return (
            values
            if wanted is None
            else ComponentMap((component, values[component]) for component in wanted)
        )


def _error_with(kind: type[Exception], message: str) -> Exception:
    """Return Pyomo's exception with a message, which older versions do not take."""
    error = kind.__new__(kind)
    Exception.__init__(error, message)
    return error


class LCPPluginV2(SolverBase):  # type: ignore[misc]
    """The solver by the newer interface; ``solver_options`` are those of :func:`lcp_plugin.solve`."""

    CONFIG = SolverConfig()

    def available(self) -> Any:
        """Return that it is here."""
        return Availability.FullLicense

    def version(self) -> tuple[int, ...]:
        """Return the version of lcp_plugin."""
        return tuple(int(part) for part in __version__.split(".")[:3])

    def solve(self, model: Any, **given: Any) -> Any:
        """Solve a model and return Results; see ``help("lcp_plugin.pyomo")``."""
        begin, start = datetime.now(UTC), perf_counter()
        config = self.config(value=given, preserve_implicit=True)
        options = {**config.solver_options.value(), "verbose": bool(config.tee)}
        for name, value in (("max_seconds", config.time_limit), ("threads", config.threads)):
            if value is not None:
                options[name] = value
        with (
            TemporaryDirectory() as temporary,
            TeeStream(*(config.tee or [])) as tee,
            redirect_stdout(tee.STDOUT),
        ):
            folder = Path(config.working_dir or temporary)
            folder.mkdir(parents=True, exist_ok=True)
            answer = answered(model, options, folder / "model.nl")
            if config.working_dir:
                answer.keep(folder / "model.nl", config.symbolic_solver_labels)
        results = _results_of(answer, model)
        results.solver_name, results.solver_version, results.solver_config = (
            self.name,
            self.version(),
            config,
        )
        results.timing_info.start_timestamp, results.timing_info.wall_time = (
            begin,
            perf_counter() - start,
        )
        is_optimal = results.solution_status == SolutionStatus.optimal
        if config.raise_exception_on_nonoptimal_result and not is_optimal:
            raise _error_with(NoOptimalSolutionError, answer.found.message)
        if config.load_solutions:
            if not answer.has_point:
                raise _error_with(NoFeasibleSolutionError, answer.found.message)
            results.solution_loader.load_solution()
        return results


def _results_of(answer: PyomoAnswer, model: Any) -> Any:
    found, results = answer.found, Results()
    results.termination_condition = ENDS.get(found.status, TerminationCondition.unknown)
    results.solution_status = SolutionStatus.optimal if found.is_solved else NOT_JUDGED
    if not answer.has_point:
        results.solution_status = SolutionStatus.noSolution
    results.solution_loader = Loader(answer, model)
    if found.is_solved and found.objective is not None:
        results.incumbent_objective = results.objective_bound = found.objective
    results.extra_info.message, results.extra_info.result = found.message, found.result
    return results


def register(name: str) -> None:
    """Register it with the newer interface; the older one knows this class by a name of its own."""
    SolverFactory.register(
        name, legacy_name=f"{name}_v2", doc="Complementarity problems, by lcp_plugin"
    )(LCPPluginV2)
