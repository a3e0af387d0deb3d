"""Checks of agents: each decision belongs to one of them, and programs and shared constraints are convex."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import cvxpy as cp
import numpy as np

from ..core.errors import ModelWarning, UnsupportedModel
from ..expressions.rows import as_matrix
from ..problems.programs.program import QuadraticProgram
from . import _compat as atoms
from ._compat import INEQUALITIES, dense_value, name_of, sense_of
from .agent_conditions import StandardRows, with_data
from .agents import Optimal, check_different
from .model import Model, level_of_caller
from .reading import rewritten


def without_agents(constraints: Sequence[Any]) -> tuple[list[Any], list[Optimal]]:
    """Return constraints with the conditions of agents in place of the agents, and the agents.

    Raises
    ------
    UnsupportedModel
        If two agents decide one variable, if not all agents of a shared constraint share it, or if it is not jointly
        convex.
    """
    agents = [one for one in constraints if isinstance(one, Optimal)]
    found = [one for one in constraints if not isinstance(one, Optimal)]
    if any(agent.checked_for != agent.parameter_values() for agent in agents):
        _check(agents, found)
    shared: set[int] = set()
    for agent in agents:
        found.append(agent.conditions.stationarity)
        for key, (pair, _) in agent.conditions.rows.items():
            if key not in shared:
                found.append(pair)
            shared |= {key} & agent.shared
    return found, agents


def _check(agents: Sequence[Optimal], others: Sequence[Any]) -> None:
    """Raise UnsupportedModel, or issue a ModelWarning, for agents that do not fit together or are not convex."""
    check_different(entry for agent in agents for entry in agent.entries)
    programs = [agent.program for agent in agents]
    rules = Convexity([*others, *programs, *(row for one in programs for row in one.constraints)])
    for agent in agents:
        if agent.checked_for != agent.parameter_values():
            _check_program(agent, rules)
            agent.checked_for = agent.parameter_values()
    for one in {row.id: row for program in programs for row in program.constraints}.values():
        if any(one.id in agent.shared for agent in agents):
            _check_shared(one, agents, rules)


def _check_program(agent: Optimal, rules: Convexity) -> None:
    """Issue a ModelWarning if the program may not be convex; raise UnsupportedModel if it has kinks also."""
    program, has_kinks = agent.program, agent.conditions.has_kinks
    stated = list(
        map(StandardRows.of, program.constraints)
    )  # raises for parameters that are not finite
    if agent.check == "local" and not has_kinks:
        return
    goal = StandardRows(None, sense_of(program) * program.objective.args[0], False)
    for one in (goal, *stated):
        if rules.hold(one, agent.entries):
            continue
        fault = (
            f"{name_of(one.expression)} in {agent!r} is not known to be {'affine' if one.is_equation else 'convex'} in "
            "the agent's decisions"
        )
        if has_kinks:
            raise UnsupportedModel(
                f"{fault}, and the program has terms that are not smooth; write it by cvxpy's rules of convexity"
            )
        message = (
            f"{fault}, so that its optimality conditions are only necessary; check gap() after the solve, and write "
            'check="local" to accept them'
        )
        warnings.warn(message, ModelWarning, stacklevel=level_of_caller())
        return


def _check_shared(constraint: Any, agents: Sequence[Optimal], rules: Convexity) -> None:
    """Raise UnsupportedModel unless all agents of a shared constraint share it, and it is jointly convex."""
    inside = rules.unknowns_in(StandardRows.of(constraint).expression)
    involved = [one for one in agents if not inside.isdisjoint(rules.unknowns_of(one.entries))]
    if others := [one for one in involved if constraint.id not in one.shared]:
        raise UnsupportedModel(
            f"the shared constraint {name_of(constraint)} holds decisions of {others[0]!r}, which does not share it; "
            "list it in the program and in shared=[…] of each of its agents"
        )
    if not rules.hold(StandardRows.of(constraint), [e for one in involved for e in one.entries]):
        raise UnsupportedModel(
            f"the shared constraint {name_of(constraint)} is not known to be convex in the decisions of all its agents "
            "together; without shared=[…] each agent has a multiplier of its own"
        )


class Convexity:
    """Rules that show convexity in some entries of variables, for all values of the other variables.

    Parameters
    ----------
    stated : list
        Constraints and programs of the whole model.
    """

    def __init__(self, stated: list[Any]) -> None:
        self.model, self.stated = Model(stated, takes_integers=True), stated

    @cached_property
    def data(self) -> dict[int, Any]:
        """Parameters in place of variables, by their ids, with the signs that attributes and constraints state."""
        lower, upper = self.model.declared
        for one in self.stated:
            if not isinstance(one, INEQUALITIES) or not one.args[0].is_affine():
                continue
            rows = self.model.reader.rows(StandardRows.of(one).expression)
            columns, weights, shift = self.model.statement.entries(rows) or ([], np.ones(0), 1.0)
            for end, sign in ((lower, -1.0), (upper, 1.0)):
                tighter = np.where(sign * weights > 0.0, -shift / weights, sign * np.inf)
                end[columns] = sign * np.minimum(sign * end[columns], sign * tighter)
        found = {}
        for one in self.model.variables:
            span = self.model.spans[one.id]
            nonneg, nonpos = bool((lower[span] >= 0.0).all()), bool((upper[span] <= 0.0).all())
            found[one.id] = cp.Parameter(one.shape, nonneg=nonneg, nonpos=nonpos and not nonneg)
        return found

    def hold(self, row: StandardRows, entries: Sequence[Any]) -> bool:
        """Return whether an expression is convex, of an equation affine, in entries of variables.

        By cvxpy's rules, term by term, with the others as parameters; or quadratic terms have a semidefinite Hessian.
        """
        change = with_data(entries, self.data)
        held = rewritten(row.expression, change)
        if held.is_affine() or row.is_equation or held.is_convex():
            return bool(held.is_affine() or not row.is_equation)
        columns, quadratic = self.unknowns_of(entries), []
        for factor, term in _terms(row.expression, 1.0):
            if (hessians := self._hessians(term, row.expression.shape, columns)) is not None:
                quadratic.append([factor * one for one in hessians])
            elif not (factor * rewritten(term, change)).is_convex():
                return False
        return all(
            QuadraticProgram(sum(parts), np.zeros(len(columns))).matrices.is_nearly_semidefinite
            for parts in zip(*quadratic, strict=True)
        )

    def unknowns_of(self, entries: Sequence[Any]) -> list[int]:
        """Return the numbers of entries of variables."""
        spans = self.model.spans
        columns = [spans[v.id].start + own for v, own in entries if v.id in spans]
        return list(map(int, np.concatenate(columns)))

    def unknowns_in(self, expression: Any) -> set[int]:
        """Return the numbers of the unknowns on which an expression depends."""
        try:
            found = [self.model.reader.rows(expression)]
        except UnsupportedModel:  # its kinks are functions of its arguments
            return set().union(*map(self.unknowns_in, expression.args))
        unknowns: set[int] = set()
        while found:
            rows = found.pop()
            for key, block in rows.blocks.items():
                if key in self.model.spans:
                    matrix = as_matrix(block, rows.size)
                    used = matrix.indices[matrix.data != 0.0]
                    unknowns.update((self.model.spans[key].start + used).tolist())
                else:
                    found.extend(self.model.reader.compiler.groups[-1 - key][2])
        return unknowns

    def _hessians(self, term: Any, shape: Any, columns: Any) -> list[Any] | None:
        """Return the Hessian of each row in some unknowns; None if a row is not quadratic."""
        try:
            rows = self.model.reader.rows(term).spread(shape)
        except UnsupportedModel:
            return None
        found: list[Any] = [
            self.model.statement.quadratic(rows.taken(one))
            for one in np.arange(rows.size)[:, np.newaxis]
        ]
        return None if None in found else [one[0][columns][:, columns] for one in found]


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
