"""Objectives over complementarity constraints in cvxpy: the best of all solutions.

The objective and the rows are smooth, of any curvature; an absolute value becomes a pair. The gain of an agent is
the best that a change of only its decisions adds.
"""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.constraints import NonNeg
from cvxpy.error import SolverError
from cvxpy.problems.problem import SolverStats

from ..core import deadline
from ..core.checks import Indices
from ..core.errors import UnsupportedModel, warn
from ..core.settings import DEFAULT, Status
from ..expressions.rows import Program
from ..problems.equilibria.equilibrium_program import EquilibriumProgram
from ..solving.dispatch import solve
from . import _compat as compat
from .agent_conditions import StandardRows, joined, value_in_domain, violated_domain, with_data
from .constraint import Complements, complements
from .model import Model
from .reading import Reader, rewritten


def stated_program(problem: cp.Problem, constraints: list[Any]) -> tuple[EquilibriumProgram, Model]:
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
    pairs = [constraint for constraint in constraints if isinstance(constraint, Complements)]
    others = [constraint for constraint in constraints if not isinstance(constraint, Complements)]
    kinks: list[Complements] = []
    smooth = partial(rewritten, change=partial(_kink, kinks=kinks))
    goal = smooth(problem.objective.args[0])
    rows = [smooth(compat.expression_of(constraint)) for constraint in others]
    stated = [problem.objective, *constraints, *kinks]
    model = Model(stated, Reader(takes_integers=True), problem.constraints)
    statement = model.statement
    whole = [np.zeros(0, dtype=np.int64)]
    for variable in model.variables:
        first = model.spans[variable.id].start
        binary = first + _chosen(variable, variable.boolean_idx)
        statement.lower[binary] = np.maximum(statement.lower[binary], 0.0)
        statement.upper[binary] = np.minimum(statement.upper[binary], 1.0)
        whole += [binary, first + _chosen(variable, variable.integer_idx)]
    for constraint, row in zip(others, rows, strict=True):
        if not isinstance(constraint, (*compat.EQUATIONS, *compat.INEQUALITIES)):
            raise UnsupportedModel(f"{constraint} must be an equation or an inequality")
        low = 0.0 if isinstance(constraint, (*compat.EQUATIONS, NonNeg)) else -np.inf
        high = np.inf if isinstance(constraint, NonNeg) else 0.0
        statement.constrain(model.reader.rows(row), low, high, row)
    model.add_pairs([*pairs, *kinks])
    integers = np.concatenate(whole)
    return statement.best(model.reader.rows(goal), compat.sense_of(problem), integers), model


def _chosen(variable: cp.Variable, chosen: Any) -> Indices:
    """Return the mask of cvxpy's ``boolean_idx`` or ``integer_idx``, column by column."""
    if not len(chosen):
        return np.zeros(0, dtype=np.int64)
    # Arrays of row numbers and column numbers; or a list of entries.
    index = chosen if isinstance(chosen, tuple) else tuple(np.transpose(chosen))
    return np.asarray(np.ravel_multi_index(index, max(variable.shape, (1,)), order="F"))


def _kink(node: cp.Expression, kinks: list[Complements]) -> Any:
    """Return x + 2 s instead of |x|, and every other node unchanged; 0 ≤ s ⟂ x + s ≥ 0 is added to the pairs."""
    if not isinstance(node, cp.abs) or node.is_constant():
        return node
    x, s = node.args[0], cp.Variable(node.shape)
    s.value = None if x.value is None else np.maximum(-compat.dense(x.value), 0.0)
    kinks.append(complements(s >= 0, x + s >= 0))
    return x + 2 * s


def solve_for_the_best(
    problem: Any, stated: list[Any], warm_start: bool, options: dict[str, Any]
) -> Any:
    """Solve a cvxpy problem, given its constraints without agents; return its value."""
    program, model = stated_program(problem, stated)
    if warm_start and "x0" not in options:
        start = model.present()
        if start is not None and np.isfinite(start).all():
            options = options | {"x0": _with_multipliers(program, model, start)}
    result = solve(program, **options)
    if options["verbose"]:
        settings.LOGGER.info(result.explain())
    if result.x is None and not result.has_no_solution:  # nothing was found, and nothing is proved
        problem._status, problem._value = compat.CVXPY_STATUS[result.status], None
        problem._solver_stats = SolverStats.from_dict(compat.statistics(result), "LCP")
        return None
    point = None
    if not result.has_no_solution:
        slacks = np.zeros(result.x.size)
        slacks[program.first] = result.x[program.second]
        point = result.x, slacks, float(compat.sense_of(problem) * result.value)
    model.write_back(problem, result, point)
    return problem.value


def _with_multipliers(program: EquilibriumProgram, model: Model, start: Any) -> Any:
    """Return a start with multipliers of the agents' programs at its decisions, which have no values before a solve."""
    rows = [pair for agent in model.agents for pair in agent.conditions.rows.values()]
    answer = program.answer(start) if rows else None
    if answer is None:
        return start
    for _, multiplier in rows:
        start[model.spans[multiplier.id]] = answer[model.spans[multiplier.id]]
    return program.with_slacks(start)


@np.errstate(all="ignore")  # outside of a domain
def possible_gain(agent: Any) -> float | None:
    """Return the gain that an agent could make, or its largest violation; see :meth:`Optimal.gap`.

    A constraint that the present point violates may be violated by the same amount.
    """
    smooth, sense = agent.conditions, compat.sense_of(agent.program)
    values = {v.id: cp.Constant(v.value) for v in agent.program.variables()}
    change = with_data(smooth.entries, values)
    rows = [row for item in agent.program.constraints for row in StandardRows.of(item)]
    stated = {row.origin.id: row.expression for row in rows}
    held = [rewritten(domain.condition.expr, change) <= 0 for domain in smooth.domain]
    deciding, violations = {variable.id for variable, _ in agent.entries}, [0.0]
    for standard in smooth.standard:
        row = rewritten(standard.expression, change)
        excess = np.zeros(row.shape)
        if (original := stated.get(standard.origin.id)) is not None:
            excess = compat.dense_value(value_in_domain(original, deciding))
        excess = excess if standard.is_equation else np.maximum(excess, 0.0)
        held.append(row == excess if standard.is_equation else row <= excess)
        violations.append(np.abs(excess).max(initial=0.0))
    for variable, _ in agent.entries:
        lower, upper = compat.attribute_bounds(variable)
        excess = np.maximum(lower - variable.value, variable.value - upper)
        violations.append(excess.max(initial=0.0))
    violation = float(np.max(violations))  # NaN also
    present = sense * float(compat.dense_value(value_in_domain(agent.args[0], deciding)))
    outside = violated_domain(agent.args, deciding)
    if outside is not None or not np.isfinite(present + violation):
        reason = "is not finite" if outside is None else f"is not defined, because {outside} fails"
        warn(f"the value of {agent!r} {reason} at its variables, so that its gap is infinite")
        return np.inf
    goal = sense * rewritten(smooth.goal, change)
    if smooth.F is not None:
        goal = cp.Constant(compat.by_columns(smooth.F.value)) @ smooth.decisions
    best, reason = _best_value(cp.Problem(cp.Minimize(goal), held))
    if not best > -np.inf:  # NaN also: a margin near zero is hard to solve
        fee, changes = _fee(agent)
        best, reason = _best_value(cp.Problem(cp.Minimize(goal + fee), held + changes))
    if np.isnan(best):
        warn(f"the best value of {agent!r} is unknown: {reason}")
        return None
    return max(0.0, violation, present - best)


def _fee(agent: Any) -> tuple[Any, list[Any]]:
    """Return terms of the gradient times the change of each decision, and rows that define the change.

    Their factor is the tolerance of a solve, because less gains nothing.
    At equilibrium prices the margin of a linear program is zero up to rounding, and its gain must not be infinite.
    """
    gradient = agent.conditions.stationarity.second.expression
    model = Model([gradient], Reader(takes_integers=True))
    rows, first = model.reader.rows(gradient), model.statement.first
    point = np.zeros(model.statement.lower.size)
    for variable in model.variables:
        if variable.value is not None:
            point[model.spans[variable.id]] = compat.by_columns(variable.value)
    program = Program.of(model.reader.compiler, [rows], first, point.size)
    slopes = program.jacobian(point)
    terms = abs(slopes) @ abs(point) + abs(program.value(point) - slopes @ point)
    x = joined(agent.decisions)
    more, less = cp.Variable(x.size, nonneg=True), cp.Variable(x.size, nonneg=True)
    return DEFAULT.tolerance * terms[: x.size] @ (more + less), [x - x.value == more - less]


def _best_value(problem: cp.Problem) -> tuple[float, str]:
    """Return the minimum of a program without kinks, or NaN and the reason.

    This package solves a QuadraticProgram, cvxpy's solver another program that follows cvxpy's rules of convexity, and
    SCIP a program of any other class.
    """
    program, _ = stated_program(problem, problem.constraints)
    is_quadratic = program.smooth is None and program.program.matrices.is_nearly_semidefinite
    if problem.is_dcp() and not is_quadratic:
        before = [(variable, variable.value) for variable in problem.variables()]
        try:
            with warnings.catch_warnings(action="ignore"):  # on approximations that cvxpy chooses
                problem.solve()
            best = problem.solution.opt_val  # rounding may put the point outside of a domain
            is_known = best is not None and best < np.inf
            return float(best) if is_known else np.nan, problem.status
        except SolverError as error:
            return np.nan, str(error)
        finally:
            for variable, value in before:
                variable.save_value(value)
    if is_quadratic:
        result: Any = solve(program.program, max_seconds=deadline.SEARCH_SECONDS)
        value = result.objective
    else:
        result = solve(program, max_seconds=deadline.SEARCH_SECONDS)
        value = result.value
        if result.status is Status.STALLED and np.isfinite(result.lower_bound):
            return result.lower_bound, ""  # the gain is not larger
    if result.is_solved:
        return value, ""
    return (-np.inf if result.status is Status.UNBOUNDED else np.nan), result.advice
