"""Checks of agents: each decision belongs to one of them, and programs and shared constraints are convex."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import cvxpy as cp
import numpy as np

from ..core.errors import ModelWarning, UnsupportedModel
from ..expressions.rows import added
from ..problems.programs.program import QuadraticProgram
from . import _compat as atoms
from ._compat import attribute_bounds, name_of
from .agent_conditions import StandardRows, with_data
from .agents import Optimal
from .model import Model, level_of_caller
from .reading import rewritten
from .stated_terms import INEQUALITIES, dense_value, sense_of

Data = Callable[[Any], Any]  # the parameter of a variable


def without_agents(constraints: Sequence[Any]) -> tuple[list[Any], list[Optimal]]:
    """Return constraints with the conditions of agents in place of the agents, and the agents.

    Raises
    ------
    UnsupportedModel
        If two agents decide one variable, if not all agents of a shared constraint share it, or if it is not jointly
        convex.
    """
    agents = [one for one in constraints if isinstance(one, Optimal)]
    owners: dict[tuple[int, int], Optimal] = {}
    for agent in agents:
        for variable, columns in agent.entries:
            for key in ((variable.id, column) for column in columns.tolist()):
                if key in owners:
                    raise UnsupportedModel(
                        f"two agents decide {variable.name()}: {owners[key]!r} and {agent!r}; list each variable, or "
                        "entry of one, in over=[…] of one agent"
                    )
                owners[key] = agent
    others = [one for one in constraints if not isinstance(one, Optimal)]
    programs = [agent.program for agent in agents]
    stated = [*others, *programs, *(row for one in programs for row in one.constraints)]
    shared: dict[int, Any] = {}
    for agent in agents:
        _check_convexity(agent, stated)
        for one in agent.program.constraints:
            if one.id in agent.shared and one.id not in shared:
                _check_shared(one, agents, stated)
                shared[one.id] = agent.conditions.rows[one.id][0]
    found = [*others, *shared.values()]
    for agent in agents:
        rows = agent.conditions.rows.items()
        found += [agent.conditions.stationarity]
        found += [pair for key, (pair, _) in rows if key not in agent.shared]
    return found, agents


def refuse_undecided(agents: Sequence[Optimal], constraints: Sequence[Any]) -> None:
    """Raise UnsupportedModel if a free variable of a program is decided by no agent and in no other constraint."""
    decided = {variable.id for agent in agents for variable, _ in agent.entries}
    own = {id(pair) for agent in agents for pair in agent.conditions.pairs}
    for one in constraints:
        decided.update(each.id for each in one.variables() if id(one) not in own)
    for agent in agents:
        for variable in agent.program.variables():
            is_bounded = any(np.isfinite(end).any() for end in attribute_bounds(variable))
            if variable.id not in decided and not is_bounded:
                raise UnsupportedModel(
                    f"{variable.name()} occurs in {agent!r}, but no agent decides it and no other constraint has it; "
                    "list it in over=[…], or make it a parameter"
                )


# --- convexity ---


def _signs(stated: Sequence[Any]) -> dict[int, tuple[bool, bool]]:
    """Return whether attributes and simple constraints make a variable ≥ 0, and ≤ 0, by its id."""
    model = Model(stated, takes_integers=True)
    lower, upper = model.declared
    for one in stated:
        if isinstance(one, INEQUALITIES):
            row = StandardRows.of(one)
            columns, weights, shift = model.statement.entries(
                model.reader.rows(row.expression)
            ) or (np.zeros(0, int), np.ones(0), np.zeros(0))
            for is_upper, end in enumerate((lower, upper)):
                own = (weights > 0.0) == is_upper
                tighter = np.minimum if is_upper else np.maximum
                end[columns[own]] = tighter(end[columns[own]], (-shift / weights)[own])
    return {
        one.id: (bool((lower[span] >= 0.0).all()), bool((upper[span] <= 0.0).all()))
        for one in model.variables
        for span in [model.spans[one.id]]
    }


def _terms(node: Any, factor: float) -> Iterator[tuple[float, Any]]:
    """Yield factors and terms, of which an expression is the sum."""
    if isinstance(node, atoms.SUM):
        for one in node.args:
            yield from _terms(one, factor)
    elif isinstance(node, atoms.NEGATIVE):
        yield from _terms(node.args[0], -factor)
    elif isinstance(node, atoms.ENTRY_SUM) and node.shape == ():
        yield from ((own, cp.sum(term)) for own, term in _terms(node.args[0], factor))
    elif isinstance(node, atoms.PRODUCT) and node.args[0].is_constant() and node.args[0].size == 1:
        yield from _terms(node.args[1], factor * float(dense_value(node.args[0].value)))
    else:
        yield factor, node


def _is_convex(expression: Any, factor: float, entries: Sequence[Any], data: Data) -> bool:
    """Return whether cvxpy's rules, or a semidefinite Hessian of quadratic terms, show that an expression is convex."""
    change = with_data(entries, data)
    if (factor * rewritten(expression, change)).is_convex():
        return True
    model, rows = Model([expression], takes_integers=True), []
    for own, term in _terms(expression, factor):
        try:
            found = model.reader.rows(term).scaled(own).spread(expression.shape)
            if any(
                model.statement.quadratic(found.taken(np.array([k]))) is None
                for k in range(found.size)
            ):
                raise UnsupportedModel("not quadratic")
            rows.append(found)
        except UnsupportedModel:
            if not (own * rewritten(term, change)).is_convex():
                return False
    if not rows:
        return True
    columns = np.concatenate(
        [model.spans[one.id].start + own for one, own in entries if one.id in model.spans]
    )
    total = added(rows, expression.shape)
    for k in range(total.size):
        P, *_ = model.statement.quadratic(total.taken(np.array([k]))) or [np.zeros((0, 0))]
        P = P[columns][:, columns]
        if not QuadraticProgram(P, np.zeros(columns.size)).matrices.is_nearly_semidefinite:
            return False
    return True


class StandIns(dict[int, Any]):
    """Parameters in place of variables, with the signs that are known of them."""

    def __init__(self, signs: dict[int, tuple[bool, bool]]) -> None:
        super().__init__()
        self.signs = signs

    def __call__(self, variable: Any) -> Any:
        """Return the parameter of a variable."""
        if variable.id not in self:
            is_nonneg, is_nonpos = self.signs.get(variable.id, (False, False))
            sign = {"nonneg": is_nonneg, "nonpos": is_nonpos and not is_nonneg}
            self[variable.id] = cp.Parameter(variable.shape, **sign)
        return self[variable.id]


def _doubtful(stated: list[Any], entries: Sequence[Any], constraints: Sequence[Any]) -> list[Any]:
    """Return the (expression, factor, whether an equation) that may not be convex, or affine, in the entries."""
    for with_signs in (False, True):
        if stated:
            data = StandIns(_signs(constraints) if with_signs else {})
            stated = [
                (expression, factor, is_equation)
                for expression, factor, is_equation in stated
                if not (
                    rewritten(expression, with_data(entries, data)).is_affine()
                    if is_equation
                    else _is_convex(expression, factor, entries, data)
                )
            ]
    return stated


def _check_convexity(agent: Optimal, constraints: Sequence[Any]) -> None:
    """Issue a ModelWarning if the program may not be convex; raise UnsupportedModel if it has kinks also."""
    program, has_kinks = agent.program, len(agent.smooth.rows) > len(agent.program.constraints)
    if agent.is_checked or (agent.check == "local" and not has_kinks):
        return
    stated = [(program.objective.args[0], sense_of(program), False)]
    rows = map(StandardRows.of, program.constraints)
    stated += [(one.expression, 1.0, one.is_equation) for one in rows]
    for expression, _, is_equation in _doubtful(stated, agent.entries, constraints)[:1]:
        what = "affine" if is_equation else "convex (of a maximum: concave)"
        fault = (
            f"{name_of(expression)} in {agent!r} is not known to be {what} in the agent's decisions"
        )
        if has_kinks:
            raise UnsupportedModel(
                f"{fault}, and the program has terms that are not smooth; write it by cvxpy's rules of convexity"
            )
        if agent.check == "convex":
            warnings.warn(
                f"{fault}, so that its optimality conditions are only necessary; check best.gap() after the solve, and "
                'write check="local" to accept them',
                ModelWarning,
                stacklevel=level_of_caller(),
            )
    agent.is_checked = True


def _check_shared(constraint: Any, agents: Sequence[Optimal], stated: Sequence[Any]) -> None:
    """Raise UnsupportedModel unless all agents of a shared constraint share it, and it is jointly convex."""
    inside = {one.id for one in constraint.variables()}
    involved = [one for one in agents if not inside.isdisjoint(v.id for v, _ in one.entries)]
    for agent in involved:
        if constraint.id not in agent.shared:
            raise UnsupportedModel(
                f"the shared constraint {name_of(constraint)} holds decisions of {agent!r}, which does not share it; "
                "list it in the program and in shared=[…] of each of its agents"
            )
    entries, row = [each for one in involved for each in one.entries], StandardRows.of(constraint)
    if _doubtful([(row.expression, 1.0, row.is_equation)], entries, stated):
        raise UnsupportedModel(
            f"the shared constraint {name_of(constraint)} is not known to be convex in the decisions of all its agents "
            "together; without shared=[…] each agent has a multiplier of its own"
        )
