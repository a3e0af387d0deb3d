"""The gain that an agent of an equilibrium could make by a change of its own decisions only."""

from __future__ import annotations

import warnings
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy.error import SolverError

from ..core.errors import ModelWarning
from ..core.settings import Status
from ..expressions.program import Program
from ..problems.equilibria.branch_and_bound import minimize_over_solutions
from ..problems.programs.solving import solve_program
from ._compat import attribute_bounds, by_columns, dense_value, sense_of
from .agent_conditions import StandardRows, joined, value_in_domain, violated_domain, with_data
from .best_equilibrium import stated_program
from .model import level_of_caller, spans_of
from .reading import Reader, rewritten

MAX_SECONDS = 60.0  # of a search for an agent's best value
MARGIN = (
    1e-8  # of the terms of a gradient, as the tolerance of a solve: a smaller margin gains nothing
)


@np.errstate(all="ignore")  # outside of a domain
def possible_gain(agent: Any) -> float | None:
    """Return the gain that an agent could make, or its largest violation; see :meth:`Optimal.gap`.

    A constraint that the present point violates may be violated by the same amount.
    """
    smooth, sense = agent.conditions, sense_of(agent.program)
    values = {one.id: cp.Constant(one.value) for one in agent.program.variables()}
    change = with_data(smooth.entries, values)
    stated = {one.id: StandardRows.of(one).expression for one in agent.program.constraints}
    held = [rewritten(one.condition.expr, change) <= 0 for one in smooth.domain]
    deciding, violation = {one.id for one, _ in agent.entries}, 0.0
    for one in smooth.standard:
        row, own = rewritten(one.expression, change), stated.get(one.origin.id)
        excess = np.zeros(row.shape) if own is None else dense_value(value_in_domain(own, deciding))
        excess = excess if one.is_equation else np.maximum(excess, 0.0)
        held.append(row == excess if one.is_equation else row <= excess)
        violation = float(np.maximum(violation, np.abs(excess).max(initial=0.0)))  # NaN also
    for variable, _ in agent.entries:
        lower, upper = attribute_bounds(variable)
        excess = np.maximum(lower - variable.value, variable.value - upper)
        violation = float(np.maximum(violation, excess.max(initial=0.0)))
    own = sense * float(dense_value(value_in_domain(agent.args[0], deciding)))
    outside = violated_domain(agent.args, deciding)
    if outside is not None or not np.isfinite(own + violation):
        reason = "is not finite" if outside is None else f"is not defined, because {outside} fails"
        warnings.warn(
            f"the value of {agent!r} {reason} at its variables, so that its gap is infinite",
            ModelWarning,
            stacklevel=level_of_caller(),
        )
        return np.inf
    goal = sense * rewritten(smooth.goal, change)
    best, reason = _best_value(cp.Problem(cp.Minimize(goal), held))
    if not best > -np.inf:  # NaN also: a margin near zero is hard to solve
        fee, rows = _fee(agent)
        best, reason = _best_value(cp.Problem(cp.Minimize(goal + fee), held + rows))
    if np.isnan(best):
        warnings.warn(
            f"the best value of {agent!r} is unknown: {reason}",
            ModelWarning,
            stacklevel=level_of_caller(),
        )
        return None
    return max(0.0, violation, own - best)


def _fee(agent: Any) -> tuple[Any, list[Any]]:
    """Return MARGIN of the terms of the gradient times the change of each decision, and rows that define the change.

    At equilibrium prices the margin of a linear program is zero up to rounding, and its gain must not be infinite.
    """
    gradient = agent.conditions.stationarity.second.expression
    leaves = {one.id: one for one in gradient.variables()}
    spans, size = spans_of(leaves)
    at = np.zeros(size)
    for key, one in leaves.items():
        at[spans[key]] = 0.0 if one.value is None else by_columns(one.value)
    reader = Reader(takes_integers=True)
    rows = reader.rows(gradient)
    first = {key: span.start for key, span in spans.items()}
    program = Program.of(reader.compiler, [rows], first, size)
    slopes = program.jacobian(at)
    terms = abs(slopes) @ abs(at) + abs(program.value(at) - slopes @ at)
    x = joined(agent.decisions)
    more, less = cp.Variable(x.size, nonneg=True), cp.Variable(x.size, nonneg=True)
    return MARGIN * terms[: x.size] @ (more + less), [x - x.value == more - less]


def _best_value(problem: Any) -> tuple[float, str]:
    """Return the minimum of a program without kinks, or NaN and the reason.

    A QuadraticProgram is solved here, another program by cvxpy's rules of convexity by cvxpy's solver, and the rest by
    SCIP.
    """
    program, _ = stated_program(problem, problem.constraints)
    is_quadratic = program.smooth is None and program.program.matrices.is_nearly_semidefinite
    if problem.is_dcp() and not is_quadratic:
        before = [(one, one.value) for one in problem.variables()]
        try:
            with warnings.catch_warnings(action="ignore"):  # on approximations that cvxpy chooses
                problem.solve()
            is_known = problem.value is not None and problem.value < np.inf
            return float(problem.value) if is_known else np.nan, problem.status
        except SolverError as error:
            return np.nan, str(error)
        finally:
            for variable, value in before:
                variable.save_value(value)
    if is_quadratic:
        result: Any = solve_program(program.program, max_seconds=MAX_SECONDS)
        value = result.objective
    else:
        result = minimize_over_solutions(program, max_seconds=MAX_SECONDS)
        value = result.value
        if result.status is Status.STALLED and np.isfinite(result.lower_bound):
            return result.lower_bound, ""  # the gain is not larger
    if result.is_solved:
        return value, ""
    return (-np.inf if result.status is Status.UNBOUNDED else np.nan), result.advice
