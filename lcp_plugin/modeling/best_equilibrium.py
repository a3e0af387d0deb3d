"""Objectives over complementarity constraints in cvxpy: the best of all solutions.

The objective and the rows are smooth, of any curvature; an absolute value becomes a pair.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.constraints import NonNeg
from cvxpy.problems.problem import SolverStats

from ..core.errors import UnsupportedModel
from ..expressions.rows import Indices
from ..problems.equilibria.branch_and_bound import OPTIONS, minimize_over_solutions
from ..problems.equilibria.equilibrium_program import EquilibriumProgram
from ._compat import (
    CVXPY_STATUS,
    EQUATIONS,
    INEQUALITIES,
    dense,
    expression_of,
    sense_of,
    statistics,
)
from .constraint import Complements, complements
from .model import Model
from .reading import rewritten


def stated_program(problem: Any, constraints: list[Any]) -> tuple[EquilibriumProgram, Model]:
    """Return the equilibrium program of a cvxpy problem, and the map back to its variables.

    Parameters
    ----------
    problem : cvxpy.Problem
    constraints : list
        Its constraints, the conditions of agents in place of agents.

    Raises
    ------
    UnsupportedModel
        Names a term that is not smooth.
    """
    pairs = [one for one in constraints if isinstance(one, Complements)]
    others = [one for one in constraints if not isinstance(one, Complements)]
    kinks: list[Complements] = []
    smooth = partial(rewritten, change=partial(_kink, kinks=kinks))
    goal = smooth(problem.objective.args[0])
    rows = [smooth(expression_of(one)) for one in others]
    model = Model([problem.objective, *constraints, *kinks], takes_integers=True)
    statement = model.statement
    whole = [np.zeros(0, dtype=np.int64)]
    for one in model.variables:
        first = model.spans[one.id].start
        binary = first + _chosen(one, one.boolean_idx)
        statement.lower[binary] = np.maximum(statement.lower[binary], 0.0)
        statement.upper[binary] = np.minimum(statement.upper[binary], 1.0)
        whole += [binary, first + _chosen(one, one.integer_idx)]
    statement.integers = np.concatenate(whole)
    for one, row in zip(others, rows, strict=True):
        if not isinstance(one, (*EQUATIONS, *INEQUALITIES)):
            raise UnsupportedModel(
                f"the constraint {one} is neither an equation nor an inequality; write it as such"
            )
        low = 0.0 if isinstance(one, (*EQUATIONS, NonNeg)) else -np.inf
        high = np.inf if isinstance(one, NonNeg) else 0.0
        statement.constrain(model.reader.rows(row), low, high, row)
    model.add_pairs([*pairs, *kinks])
    return statement.best(model.reader.rows(goal), sense_of(problem)), model


def _chosen(variable: Any, chosen: Any) -> Indices:
    """Return the mask of cvxpy's ``boolean_idx`` or ``integer_idx``, column by column."""
    if not len(chosen):
        return np.zeros(0, dtype=np.int64)
    # Arrays of row numbers and column numbers; or a list of entries.
    index = chosen if isinstance(chosen, tuple) else tuple(np.transpose(chosen))
    found = np.ravel_multi_index(index, max(variable.shape, (1,)), order="F")
    return np.asarray(found, dtype=np.int64)


def _kink(node: Any, kinks: list[Complements]) -> Any:
    """Return x + 2 s instead of |x|, and every other node unchanged; 0 ≤ s ⟂ x + s ≥ 0 is added to the pairs."""
    if not isinstance(node, cp.abs) or node.is_constant():
        return node
    x, s = node.args[0], cp.Variable(node.shape)
    s.value = None if x.value is None else np.maximum(-dense(x.value), 0.0)
    kinks.append(complements(s >= 0, x + s >= 0))
    return x + 2 * s


def solve_for_the_best(
    problem: Any, stated: tuple[list[Any], list[Any]], warm_start: bool, options: dict[str, Any]
) -> Any:
    """Solve a cvxpy problem, given its constraints without agents and its agents; return its value."""
    for name in options:
        if name not in OPTIONS:
            raise UnsupportedModel(
                f"the search for the best of all solutions has no option {name!r}; it has {', '.join(OPTIONS)}"
            )
    program, model = stated_program(problem, stated[0])
    model.agents = stated[1]
    if warm_start and "x0" not in options:
        start = model.present()
        is_start = start is not None and np.isfinite(start).all()
        options = {**options, "x0": start if is_start else None}
    result = minimize_over_solutions(program, **options)
    if options["verbose"]:
        settings.LOGGER.info(result.explain())
    if result.x is None and not result.has_no_solution:  # nothing was found, and nothing is proved
        problem._status, problem._value = CVXPY_STATUS[result.status], None
        problem._solver_stats = SolverStats.from_dict(statistics(result), "LCP")
        return None
    found = None
    if result.x is not None:
        slacks = np.zeros(result.x.size)
        slacks[program.first] = result.x[program.second]
        found = result.x, slacks, float(sense_of(problem) * result.value)
    model.write_back(problem, result, found)
    return problem.value
