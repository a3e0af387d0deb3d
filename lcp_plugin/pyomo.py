"""The interface for Pyomo: ``import lcp_plugin.pyomo``, then ``SolverFactory("lcp_plugin").solve(model)``.

Complementarities, equations and convex quadratic programs written in Pyomo are solved in this process, without an
executable. Pyomo's writer puts the rows into an ``.nl`` file, which the reader of those files turns into the problem;
the pairs are read from the model. The model is not changed, so that after a change of a ``Param`` another ``solve``
is enough. It starts from the values of the variables.

>>> import pyomo.environ as pyo
>>> from pyomo.mpec import Complementarity, complements
>>> import lcp_plugin.pyomo
>>> m = pyo.ConcreteModel()
>>> m.price = pyo.Param(mutable=True, initialize=3.0)
>>> m.x = pyo.Var([1, 2], within=pyo.NonNegativeReals, initialize=1.0)
>>> def pair(m, i):
...     return complements(m.x[i] >= 0, pyo.exp(m.x[i]) + m.x[3 - i] >= m.price**i)
>>> m.pair = Complementarity([1, 2], rule=pair)
>>> m.dual = pyo.Suffix(direction=pyo.Suffix.IMPORT)
>>> solver = pyo.SolverFactory("lcp_plugin")
>>> pyo.assert_optimal_termination(solver.solve(m))
>>> [round(m.x[i].value, 6) for i in m.x]
[0.0, 2.197225]
>>> [round(m.dual[m.pair[i]], 6) + 0.0 for i in m.x]
[0.197225, 0.0]
>>> m.price = 2.0
>>> results = solver.solve(m, options={"tolerance": 1e-12})
>>> results.solver.termination_condition.value, [round(m.x[i].value, 6) for i in m.x]
('optimal', [0.0, 1.386294])

**Supported.** ``Complementarity`` and ``ComplementarityList``, indexed and in blocks, of variables or expressions: with
inequalities, ranges, as ``complements(inequality(0, x, 5), F)``, or equalities. Equality constraints; smooth
functions, ``Expression``; fixed variables, deactivated components, mutable parameters anywhere. There must be as many
equations and pairs as variables. Without complementarities: linear and convex quadratic programs, and nonlinear
systems. **An objective with complementarities** requests the best of all solutions; then inequalities and bounds are
constraints, there may be any number of equalities, and integer variables. Objective, rows and pairs may be smooth,
convex or not: SCIP searches if it is installed (``pip install '.[global]'``). Without it, and with
``prove=True``, rows are affine and the objective convex quadratic, and the gap is proved.

- Without an objective, all bounds of a variable belong to its pair, stated there or not, as PATH and AMPL take them:
  at an upper bound the row may be < 0.
- Inequalities next to complementarities, and bounds of variables without a pair, are checked at the solution of the
  pairs. If one is violated, another solution of the pairs is searched, as with an objective. If none is found, the
  message names the violated condition.
- A pair whose variable is fixed, for example the price of a numeraire, is checked in the same way.
- **Square models**: ``solve(model, pairs="match")`` reads constraints and bounded variables as GAMS reads the pairs
  ``market.price``, without ``Complementarity``. Constraints belong to the variables with the same indices, and
  ``pairs=ComponentMap({m.market: m.price})`` states pairs that indices do not decide. An equation is body − right-hand
  side ≥ 0 at a lower bound, ≤ 0 at an upper bound, and 0 between. An inequality is its slack, ≥ 0 if the variable is at
  its lower bound, as in ``pyomo.mpec``. Equations of variables without bounds need no pair. ``dual`` gets these rows.
- Rejected with an error: disjunctions, functions that are not smooth or that SCIP does not have; without
  complementarities also integers, nonlinear rows if there is an objective, objectives that are not convex.
- Pyomo's own ``mpec.nl`` is not used: in 6.10 it fails on the pair of a range and an expression, states another problem
  for the pair of a range and a variable, and loosens upper bounds. A model that it has changed is solved as changed.

**Options** are the options of :func:`lcp_plugin.solve`: ``solver.options["algorithm"] = "newton"``, or
``solve(model, options={"tolerance": 1e-10})``; ``timelimit`` is ``max_seconds``, ``tee=True`` prints the run. With
``keepfiles=True`` the ``.nl`` file stays. ``lcp_plugin.pyomo.write_nl(model, "model.nl")`` writes it without a solve;
``model.write`` rejects complementarities. With an objective and complementarities, ``tolerance`` limits the gap, 1e-6
by default, and ``max_iterations`` limits the nodes; ``algorithm`` is rejected. The message then names the source of
the bound. The present values of the variables are tried first. The command
``pyomo solve --solver=lcp_plugin model.py`` also uses the solver.

**Afterwards** ``results.solver.termination_condition`` is ``optimal`` only if the status is SOLVED, ``infeasible`` and
``unbounded`` only with a proof. ``noSolution`` means that a solution is neither known nor excluded. ``other`` means
that double precision allows no better result (if the bounds are the solution, set ``absolute_tolerance``), or that a
side condition is violated. ``results.solver.message`` has the reason; ``solver.result`` is the result object of the
last solve; its ``conflict`` lists the constraints that conflict, if the model is infeasible. A ``dual`` suffix gets the
value of each pair's row, ≥ 0 at a lower bound and ≤ 0 at an upper bound, and the multipliers of a program; ``rc`` gets
the multipliers of its variables. With an objective and complementarities, rows without a pair get 0.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

try:
    from pyomo.core import SymbolMap, maximize
    from pyomo.core.base.label import NumericLabeler
    from pyomo.opt import (
        OptSolver,
        Solution,
        SolverFactory,
        SolverResults,
        SolverStatus,
        TerminationCondition,
    )
except ImportError as error:
    raise ImportError(
        "lcp_plugin.pyomo needs pyomo; install it with: pip install pyomo (or lcp_plugin[pyomo])"
    ) from error

from . import __version__
from .core.errors import InvalidOption, did_you_mean
from .core.settings import parse_options
from .interfaces.nl.writing import write_nl
from .interfaces.pyomo import PyomoAnswer, solve_model, suffix_of
from .problems.statement import STATUS_ELSEWHERE

NAME, HYPHENATED = "lcp_plugin", "lcp-plugin"  # by another name Pyomo looks for an executable
DOC = "Complementarity problems and convex quadratic programs, by lcp_plugin"
STATES = {
    TerminationCondition.optimal: SolverStatus.ok,
    TerminationCondition.userInterrupt: SolverStatus.aborted,
}  # of other ends a warning


@SolverFactory.register(HYPHENATED, doc=DOC)
@SolverFactory.register(NAME, doc=DOC)
class LCPPlugin(OptSolver):  # type: ignore[misc]
    """The solver that ``SolverFactory("lcp_plugin")`` gives; see ``help("lcp_plugin.pyomo")``."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(type=NAME, doc=DOC, options=keywords.pop("options", None))
        self.result: Any = None
        _refuse({key: value for key, value in keywords.items() if key != "solver_io"})

    def warm_start_capable(self) -> bool:
        """Return True: a run begins at the values of the variables."""
        return True

    def version(self) -> tuple[int, ...]:
        """Return the version of lcp_plugin."""
        return tuple(int(part) for part in __version__.split(".")[:3])

    def set_options(self, options: Mapping[str, Any] | str) -> None:
        """Set options for all solves that follow, as names and values or as words: "tolerance=1e-10 threads=1"."""
        if isinstance(options, str):
            options = parse_options(shlex.split(options.strip("\"' ")))
        self.options.update({name: value for name, value in options.items() if value is not None})

    def solve(
        self,
        model: Any,
        *,
        tee: bool = False,
        load_solutions: bool = True,
        timelimit: float | None = None,
        options: dict[str, Any] | None = None,
        pairs: Any = None,
        keepfiles: bool = False,
        symbolic_solver_labels: bool = False,
        warmstart: bool = True,
        file_determinism: object = None,
        **unknown: Any,
    ) -> Any:
        """Solve a model and return Pyomo's SolverResults.

        Parameters
        ----------
        model : ConcreteModel or Block
        tee : bool
            Print the run.
        load_solutions : bool
            Put the answer into the variables and suffixes; otherwise ``model.solutions.load_from(results)`` does.
        timelimit : float, optional
            Limit in seconds.
        options : dict, optional
            Options of this solve, in addition to ``self.options``.
        pairs : "match" or ComponentMap, optional
            Read a square model as a mixed complementarity problem; see **Square models** above.
        keepfiles : bool
            Keep the ``.nl`` file of the solved problem, in a new folder, and print its path.
        symbolic_solver_labels : bool
            Also write the names of rows and columns.
        warmstart : bool
            Accepted for compatibility: a run always begins at the values of the variables.
        file_determinism : int, optional
            Accepted for compatibility: the same model always gives the same file.

        Raises
        ------
        UnsupportedModel, InvalidOption
            If the model or an option is not supported.
        """
        _refuse({key: value for key, value in unknown.items() if value is not False})
        chosen = {**self.options, **(options or {}), "verbose": bool(tee)}
        if timelimit is not None:
            chosen["max_seconds"] = timelimit
        answer = solve_model(model, chosen, pairs)
        if keepfiles:
            path = Path(mkdtemp(prefix=f"{NAME}_", dir=Path.cwd())) / "model.nl"
            has_names, content = symbolic_solver_labels, answer.statement.in_a_file
            write_nl(content if has_names else replace(content, names=None, row_names=None), path)
            print(f"the .nl file is {path}")
        self.result = answer.solution.result
        results = _results_of(answer)
        if load_solutions:
            answer.load(model)
            if answer.has_point and hasattr(model, "solutions"):  # not of a block
                _keep(_solution_of(answer, model, results), model, results)
        elif answer.has_point:
            results.solution.insert(_solution_of(answer, model, results))
        return results


def _refuse(keywords: dict[str, Any]) -> None:
    if unknown := [name for name, value in keywords.items() if value is not None]:
        word, known = unknown[0], tuple(LCPPlugin.solve.__kwdefaults__ or ())
        raise InvalidOption(
            f"lcp_plugin takes no keyword {word!r} in Pyomo{did_you_mean(word, known)}; options of the "
            'run go into options={"tolerance": 1e-10} or solver.options'
        )


def _results_of(answer: PyomoAnswer) -> Any:
    """Return Pyomo's account of an answer."""
    solution, content = answer.solution, answer.statement.content
    results = SolverResults()
    # A condition next to the pairs may be violated
    is_violated = solution.result.is_solved and not solution.is_solved
    word = "other" if is_violated else STATUS_ELSEWHERE[solution.status][2]
    condition = TerminationCondition(word)
    results.solver.name, results.solver.message = NAME, solution.message
    if solution.result.has_conflict:
        results.solver.message += "; print(solver.result.conflict) lists constraints that conflict"
    results.solver.status = STATES.get(condition, SolverStatus.warning)
    results.solver.termination_condition = condition
    results.solver.time = solution.result.seconds
    problem = results.problem
    problem.number_of_constraints = content.row_lower.size
    problem.number_of_variables = content.lower.size
    problem.number_of_objectives = content.is_maximized.size
    problem.number_of_nonzeros = content.linear.nnz
    if content.is_maximized.any():
        problem.sense = maximize
    if solution.objective is not None and condition is TerminationCondition.optimal:
        problem.lower_bound = problem.upper_bound = solution.objective
    return results


def _solution_of(answer: PyomoAnswer, model: Any, results: Any) -> Any:
    """Return the values in the form that ``model.solutions.load_from(results)`` takes."""
    solution, symbols = Solution(), SymbolMap()
    symbols.default_labeler = NumericLabeler("x")
    for variable, value in answer.values.items():
        solution.variable[symbols.getSymbol(variable)] = {"Value": value}
    if suffix_of(model, "dual") is not None:
        for row, value in answer.duals.items():
            solution.constraint[symbols.getSymbol(row)] = {"Dual": value}
    if suffix_of(model, "rc") is not None:
        for variable, value in answer.reduced_costs.items():
            solution.variable[symbols.getSymbol(variable)]["Rc"] = value
    results._smap, results._smap_id = symbols, id(symbols)
    return solution


def _keep(solution: Any, model: Any, results: Any) -> None:
    """Keep a loaded solution in the model, because ``pyomo solve`` writes it into a file."""
    model.solutions.clear()
    model.solutions.add_symbol_map(results._smap)
    model.solutions.add_solution(solution, results._smap_id)
    results._smap_id = None
