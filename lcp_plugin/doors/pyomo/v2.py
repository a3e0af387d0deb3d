"""Pyomo's newer solver interface, ``pyomo.contrib.solver``, over the same answers."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import redirect_stdout
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from pyomo.common.collections import ComponentMap
from pyomo.common.tee import TeeStream
from pyomo.contrib.solver.common import solution_loader
from pyomo.contrib.solver.common.base import Availability, SolverBase
from pyomo.contrib.solver.common.config import SolverConfig
from pyomo.contrib.solver.common.factory import SolverFactory
from pyomo.contrib.solver.common.results import Results, SolutionStatus, TerminationCondition
from pyomo.contrib.solver.common.util import NoFeasibleSolutionError, NoOptimalSolutionError

from ... import __version__
from ...core.settings import Status
from .answers import Answer, answered

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


class Loader(LOADER):  # type: ignore[misc, valid-type]
    """Puts an answer into the model, or hands it out."""

    def __init__(self, answer: Answer, model: Any) -> None:
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
            raise _told(NoFeasibleSolutionError, self.answer.message)
        return values if wanted is None else ComponentMap((component, values[component]) for component in wanted)


def _told(kind: type[Exception], message: str) -> Exception:
    """Return Pyomo's exception with a message, which older versions do not take."""
    error = kind.__new__(kind)
    Exception.__init__(error, message)
    return error


class LCPPlugin(SolverBase):  # type: ignore[misc]
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
        with TemporaryDirectory() as temporary, TeeStream(*(config.tee or [])) as tee, redirect_stdout(tee.STDOUT):
            folder = Path(config.working_dir or temporary)
            folder.mkdir(parents=True, exist_ok=True)
            answer = answered(model, options, folder / "model.nl")
            if config.working_dir:
                answer.keep(folder / "model.nl", config.symbolic_solver_labels)
        results = _results_of(answer, model)
        results.solver_name, results.solver_version, results.solver_config = self.name, self.version(), config
        results.timing_info.start_timestamp, results.timing_info.wall_time = begin, perf_counter() - start
        is_optimal = results.solution_status == SolutionStatus.optimal
        if config.raise_exception_on_nonoptimal_result and not is_optimal:
            raise _told(NoOptimalSolutionError, answer.message)
        if config.load_solutions:
            if not answer.has_point:
                raise _told(NoFeasibleSolutionError, answer.message)
            results.solution_loader.load_solution()
        return results


def _results_of(answer: Answer, model: Any) -> Any:
    found, results = answer.found, Results()
    is_solved = found.status is Status.SOLVED and not answer.violated
    results.termination_condition = ENDS.get(found.status, TerminationCondition.unknown)
    if found.status is Status.SOLVED and answer.violated:
        results.termination_condition = TerminationCondition.unknown
    results.solution_status = SolutionStatus.optimal if is_solved else NOT_JUDGED
    if not answer.has_point:
        results.solution_status = SolutionStatus.noSolution
    results.solution_loader = Loader(answer, model)
    if is_solved and found.objective is not None:
        results.incumbent_objective = results.objective_bound = found.objective
    results.extra_info.message, results.extra_info.result = answer.message, found.result
    return results


def register(name: str) -> None:
    """Register it with the newer interface; the older one knows this class by a name of its own."""
    SolverFactory.register(name, legacy_name=f"{name}_v2", doc="Complementarity problems, by lcp_plugin")(LCPPlugin)
