"""optimal(program, over=…): the optimality conditions of an agent's program, as a constraint that cvxpy accepts.

It checks that each decision belongs to one agent, and that programs and shared constraints are convex.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.constraints.constraint import Constraint

from ..core.checks import Indices
from ..core.errors import InvalidOption, InvalidProblem, UnsupportedModel, warn
from ..expressions.rows import as_matrix, is_definition
from ..problems.programs.program import QuadraticProgram
from . import _compat as atoms
from ._compat import EQUATIONS, INEQUALITIES, by_id, dense_value, name_of, sense_of
from .agent_conditions import AgentProgram, StandardRows, joined, with_data
from .best_equilibrium import possible_gain
from .constraint import Condition
from .model import Model
from .reading import Reader, restricting_attribute, rewritten


def optimal(program: Any, over: object, *, shared: Any = (), check: str = "convex") -> Optimal:
    """Return the constraint that variables solve a program, given all other variables.

    Parameters
    ----------
    program : cvxpy.Problem
        The program of one agent, with affine equations and convex inequalities. Entries of an inequality with an
        infinite constant side, as ``x <= [1, np.inf]``, are left out; parameters must be finite. Decisions stay in
        the domain of cvxpy's rules: ``log(y)`` and ``y**3`` require y ≥ 0.
    over : list of cvxpy.Variable, or of entries of variables
        The agent's decisions, for example ``[x]`` or ``[x[0]]``. Other variables of the program are data of it.
    shared : cvxpy constraint, or list of them
        Constraints of the program that other agents list also: all of them use one multiplier.
    check : str
        If "convex", a program that is not known to be convex in the agent's decisions causes a ModelWarning. With
        "local" the conditions are accepted as necessary conditions.

    Returns
    -------
    Optimal
        For ``cp.Problem(…, [...]).solve(method="LCP")``, next to pairs, equations and other agents.

    Raises
    ------
    InvalidOption
        If `check` is another value.
    UnsupportedModel
        If the program has an integer decision or a constraint other than equations and inequalities, or `over` is not
        a list of different entries of its variables.

    Examples
    --------
    >>> import cvxpy as cp
    >>> x, y = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
    >>> price = 10 - x - y
    >>> first = cp.Problem(cp.Maximize(cp.multiply(price - 1, x)), [x <= 2])
    >>> second = cp.Problem(cp.Maximize(cp.multiply(price - 1, y)))
    >>> best = optimal(first, over=[x])
    >>> _ = cp.Problem(cp.Minimize(0), [best, optimal(second, over=[y])]).solve(method="LCP")
    >>> [round(float(value), 6) for value in (x.value, y.value, best.dual_value[0])], best.gap() <= 1e-6
    ([2.0, 3.5, 1.5], True)
    """
    if not isinstance(program, cp.Problem):
        raise UnsupportedModel(
            f"optimal needs the agent's program, got {type(program).__name__}; write cp.Problem(cp.Maximize(…), […])"
        )
    if check not in ("convex", "local"):
        raise InvalidOption(f'check must be "convex" or "local", got {check!r}')
    return _agent(program, over, shared, check)


def variational_inequality(F: object, over: object, constraints: list[Any]) -> Optimal:
    """Return the condition F(x)ᵀ(y − x) ≥ 0 for all y that satisfy constraints; see :func:`lcp_plugin.variational`.

    Parameters
    ----------
    F, over : cvxpy expressions, or lists of them of the same shapes
    constraints : list of cvxpy constraints
    """
    functions, decisions = _listed(F, cp.Expression) or [], _listed(over, cp.Expression) or []
    shapes = [[part.shape for part in parts] for parts in (functions, decisions)]
    if shapes[0] != shapes[1]:
        raise UnsupportedModel(
            "variational needs one F of the shape of each variable in variational(F, over=[x]), got F of "
            f"{', '.join(map(str, shapes[0]))} and over of {', '.join(map(str, shapes[1])) or 'no variable'}"
        )
    if (rows := _listed(constraints, Constraint)) is None:
        raise UnsupportedModel(f"constraints must be a list as [G @ x <= h], got {constraints!r}")
    terms = [cp.sum(cp.multiply(*pair)) for pair in zip(functions, decisions, strict=True)]
    program = cp.Problem(cp.Minimize(sum(terms)), rows)
    return _agent(program, decisions, (), "convex", joined(functions))


def _agent(program: Any, over: object, shared: object, check: str, F: object = None) -> Optimal:
    """Return the condition of an agent, or of F in place of the gradient of its objective, after checks."""
    for constraint in program.constraints:
        if isinstance(constraint, Condition):
            raise UnsupportedModel(
                f"the agent's program has the equilibrium {name_of(constraint):.60}… among its constraints: several "
                "leaders over followers (EPEC) are not supported; keep one leader, the objective of the solved "
                "problem, and let the others follow"
            )
        if not isinstance(constraint, (*EQUATIONS, *INEQUALITIES)):
            raise UnsupportedModel(
                f"the constraint {name_of(constraint)} of an agent's program is neither an equation nor an inequality; "
                "write a second-order cone as cp.sum_squares(x) <= t**2 with a constant t, and conditions of other "
                "agents outside of the program"
            )
    decisions, listed = _listed(over, cp.Expression), _listed(shared, Constraint)
    if not decisions or listed is None:
        wrong = ("over", "variables", over) if not decisions else ("shared", "constraints", shared)
        raise UnsupportedModel("{} must be a list of {} of the program, got {!r}".format(*wrong))
    known = by_id(program.variables())
    for variable in (variable for decision in decisions for variable in decision.variables()):
        if variable.id not in known:
            raise UnsupportedModel(f"over has {variable.name()}, not a variable of the program")
        if tie := restricting_attribute(variable):
            raise UnsupportedModel(
                f"over has {variable.name()} with the attribute {tie!r}: it has no optimality conditions; relax it"
            )
    for constraint in listed:
        if all(constraint is not stated for stated in program.constraints):
            raise UnsupportedModel(
                f"shared has {name_of(constraint)}, not in the program; list it in both"
            )
    return Optimal(program, decisions, frozenset(constraint.id for constraint in listed), check, F)


def _listed(argument: object, cls: type) -> list[Any] | None:
    """Return one object of a type, or several, as a list; None for other objects."""
    items = [argument] if isinstance(argument, cls) or not np.iterable(argument) else list(argument)
    return items if all(isinstance(item, cls) for item in items) else None


def entries_of(expression: cp.Expression) -> tuple[Any, Indices]:
    """Return the variable and the entries of a decision; raise if the expression is not a decision."""
    reader = Reader(takes_integers=True)
    rows, variables = reader.rows(expression), expression.variables()
    if len(variables) == 1 and not rows.level and not rows.offset.any():
        block = as_matrix(rows.blocks[variables[0].id], rows.size)
        if is_definition(block) and (block.data == 1.0).all():
            return variables[0], block.indices.astype(np.int64)
    raise UnsupportedModel(f"over needs variables or entries of them, got {name_of(expression)}")


def check_different(entries: Iterable[tuple[Any, Indices]]) -> None:
    """Raise UnsupportedModel if an entry of a variable is listed twice as a decision."""
    listed = Counter((v.id, v.name(), k) for v, columns in entries for k in columns.tolist())
    for (_, name, _), count in listed.items():
        if count > 1:
            raise UnsupportedModel(
                f"over=[…] lists {name} twice; list each variable, or entry of one, once, in over=[…] of one agent"
            )


class Optimal(Condition):
    """The condition that decisions solve an agent's program, given all other variables; see :func:`optimal`.

    Parameters
    ----------
    program : cvxpy.Problem
    decisions : sequence of cvxpy.Variable, or of entries of variables
    shared : frozenset of int
        Ids of the constraints whose multiplier is common to all agents that share them.
    check : str
        "convex" or "local".
    F : cvxpy expression, shape (number of decisions,), or None
        Map of a variational inequality: the program is min F(x)ᵀy over y, at the solution x.
    """

    def __init__(
        self, program: Any, decisions: Any, shared: frozenset[int], check: str, F: object
    ) -> None:
        self.program, self.decisions, self.shared, self.check = program, decisions, shared, check
        self.F = F
        self.entries = [entries_of(decision) for decision in decisions]
        check_different(self.entries)
        self.checked_for: list[bytes] | None = None  # parameters with which convexity was checked
        rows = [side for constraint in program.constraints for side in constraint.args]
        super().__init__([program.objective.args[0], *rows, *decisions])

    def _construct_dual_variables(self, args: Any) -> None:
        self.dual_variables = [cp.Variable(row.shape) for row in self.program.constraints]

    def __repr__(self) -> str:
        over = ", ".join(map(str, self.decisions))
        if self.F is not None:
            return f"variational({name_of(self.F)}, over=[{over}])"
        return f"optimal({name_of(self.program.objective)}, over=[{over}])"

    def variables(self) -> list[Any]:
        """Return the variables of the program, the multipliers and the variables of epigraphs."""
        conditions = [variable for pair in self.conditions.pairs for variable in pair.variables()]
        return list(by_id((*super().variables(), *conditions)).values())

    def parameter_values(self) -> list[bytes]:
        """Return the values of the program's parameters, which decide whether it is convex."""
        return [np.asarray(parameter.value).tobytes() for parameter in self.program.parameters()]

    @cached_property
    def conditions(self) -> AgentProgram:
        """The program with epigraphs instead of kinks, and its optimality conditions."""
        return AgentProgram(self)

    @property
    def dual_value(self) -> list[Any]:
        """Dual values of the program's constraints, in their order, with cvxpy's signs."""
        return [dual.value for dual in self.dual_variables]

    @property
    def residual(self) -> Any:
        """The natural residual of each condition; None without values."""
        residuals = [pair.residual for pair in self.conditions.pairs]
        if any(residual is None for residual in residuals):
            return None
        return np.concatenate([np.ravel(residual) for residual in residuals])

    def gap(self) -> float | None:
        """Return the gain that the agent could make, with the present values of all other variables.

        For a variational inequality, return the maximum of F(x)ᵀ(x − y) over the feasible y.

        Returns
        -------
        float or None
            Difference of the present value and the best value of the program, or the largest violation of its
            constraints if that is larger. If SCIP's best point is not confirmed, the largest gain that its bound
            permits. None with a ModelWarning if no solver finds the best value; ∞ with a ModelWarning outside of the
            domain of the program, as for log(y) at y < 0 and for y**3, which is convex for y ≥ 0.

        Raises
        ------
        InvalidProblem
            If a variable has no value yet.
        """
        if any(variable.value is None for variable in self.program.variables()):
            raise InvalidProblem("variables of the agent have no values; solve the problem first")
        return possible_gain(self)

    def describe_gap(self) -> str:
        """Return a line for ``explain()`` of a result."""
        if self.check == "local":
            return f"{self!r} is a local condition: gap() searches for a better point"
        gap = self.gap()
        amount = "an unknown amount" if gap is None else f"{gap:.1e}"
        if self.F is not None:
            return f"{self!r} has the gap {amount}"
        return f"{self!r} could gain {amount} by itself"

    def save_duals(self) -> None:
        """Give the program's constraints their dual values."""
        duals = self.conditions.duals()
        for dual, constraint in zip(self.dual_variables, self.program.constraints, strict=True):
            dual.save_value(duals.get(constraint.id))
            constraint.save_dual_value(dual.value)


def without_agents(constraints: Sequence[Any]) -> list[Any]:
    """Return constraints with the conditions of agents in place of the agents.

    Raises
    ------
    UnsupportedModel
        If two agents decide one variable, if not all agents of a shared constraint share it, or if it is not jointly
        convex.
    """
    agents = [constraint for constraint in constraints if isinstance(constraint, Optimal)]
    others = [constraint for constraint in constraints if not isinstance(constraint, Optimal)]
    if any(agent.checked_for != agent.parameter_values() for agent in agents):
        _check_agents(agents, others)
    shared: set[int] = set()
    for agent in agents:
        others.append(agent.conditions.stationarity)
        rows = agent.conditions.rows.items()
        others += [pair for key, (pair, _) in rows if key not in shared]
        shared |= agent.shared
    return others


def _check_agents(agents: Sequence[Optimal], others: Sequence[Any]) -> None:
    """Raise UnsupportedModel, or issue a ModelWarning, for agents that do not fit together or are not convex."""
    check_different(entry for agent in agents for entry in agent.entries)
    programs = [agent.program for agent in agents]
    constraints = [constraint for program in programs for constraint in program.constraints]
    rules = Convexity([*others, *programs, *constraints])
    for agent in agents:
        if agent.checked_for != agent.parameter_values():
            _check_program(agent, rules)
            agent.checked_for = agent.parameter_values()
    for constraint in by_id(constraints).values():
        if any(constraint.id in agent.shared for agent in agents):
            _check_shared(constraint, agents, rules)


def _check_program(agent: Optimal, rules: Convexity) -> None:
    """Issue a ModelWarning if the program may not be convex; raise UnsupportedModel if it has kinks also."""
    program, has_kinks = agent.program, agent.conditions.has_kinks
    # raises for parameters that are not finite
    stated = [row for constraint in program.constraints for row in StandardRows.of(constraint)]
    if agent.check == "local" and not has_kinks:
        return
    goal = StandardRows(None, sense_of(program) * program.objective.args[0], False)
    for row in stated if agent.F is not None else (goal, *stated):
        if rules.hold(row, agent.entries):
            continue
        kind = "affine" if row.is_equation else "convex"
        fault = f"{name_of(row.expression)} in {agent!r} is not known to be {kind} in its decisions"
        if has_kinks:
            raise UnsupportedModel(
                f"{fault}, and the program has terms that are not smooth; write it by cvxpy's rules of convexity"
            )
        warn(
            f"{fault}, so that its optimality conditions are only necessary; check gap() after the solve, and write "
            'check="local" to accept them'
        )
        return


def _check_shared(constraint: cp.Constraint, agents: Sequence[Optimal], rules: Convexity) -> None:
    """Raise UnsupportedModel unless all agents of a shared constraint share it, and it is jointly convex."""
    if not (rows := StandardRows.of(constraint)):
        return
    inside = rules.unknowns_in(rows[0].expression)
    involved = [one for one in agents if not inside.isdisjoint(rules.unknowns_of(one.entries))]
    if others := [agent for agent in involved if constraint.id not in agent.shared]:
        raise UnsupportedModel(
            f"the shared constraint {name_of(constraint)} holds decisions of {others[0]!r}, which does not share it; "
            "list it in the program and in shared=[…] of each of its agents"
        )
    if not rules.hold(rows[0], [entry for agent in involved for entry in agent.entries]):
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
        self.model, self.stated = Model(stated, Reader(takes_integers=True)), stated

    @cached_property
    def data(self) -> dict[int, Any]:
        """Parameters in place of variables, by their ids, with the signs that attributes and constraints state."""
        lower, upper = self.model.declared
        for constraint in self.stated:
            if not isinstance(constraint, INEQUALITIES) or not constraint.args[0].is_affine():
                continue
            for row in StandardRows.of(constraint):
                rows = self.model.reader.rows(row.expression)
                if (entries := self.model.statement.entries(rows)) is not None:
                    columns, weights, shift = entries
                    low = np.where(weights < 0.0, -shift / weights, -np.inf)
                    high = np.where(weights > 0.0, -shift / weights, np.inf)
                    lower[columns] = np.maximum(lower[columns], low)
                    upper[columns] = np.minimum(upper[columns], high)
        data = {}
        for variable in self.model.variables:
            span = self.model.spans[variable.id]
            nonneg, nonpos = bool((lower[span] >= 0.0).all()), bool((upper[span] <= 0.0).all())
            signs = {"nonneg": nonneg, "nonpos": nonpos and not nonneg}
            data[variable.id] = cp.Parameter(variable.shape, **signs)
        return data

    def hold(self, row: StandardRows, entries: Sequence[Any]) -> bool:
        """Return whether an expression is convex, of an equation affine, in entries of variables.

        By cvxpy's rules, term by term, with all other variables as parameters; or by a semidefinite Hessian.
        """
        change = with_data(entries, self.data)
        held = rewritten(row.expression, change)
        if row.is_equation or held.is_convex():
            return bool(held.is_affine() or not row.is_equation)
        columns, quadratic = self.unknowns_of(entries), []
        for factor, term in _summands(row.expression, 1.0):
            if (hessians := self._hessians(term, row.expression.shape, columns)) is not None:
                quadratic.append([factor * hessian for hessian in hessians])
            elif not (factor * rewritten(term, change)).is_convex():
                return False
        sums = map(sum, zip(*quadratic, strict=True))
        programs = (QuadraticProgram(P, np.zeros(len(columns))) for P in sums)
        return all(program.matrices.is_nearly_semidefinite for program in programs)

    def unknowns_of(self, entries: Sequence[Any]) -> list[int]:
        """Return the numbers of entries of variables."""
        spans = self.model.spans
        return np.concatenate([spans[v.id].start + numbers for v, numbers in entries]).tolist()

    def unknowns_in(self, expression: cp.Expression) -> set[int]:
        """Return the numbers of the unknowns on which an expression depends."""
        try:
            pending = [self.model.reader.rows(expression)]
        except UnsupportedModel:  # its kinks are functions of its arguments
            return set().union(*map(self.unknowns_in, expression.args))
        unknowns: set[int] = set()
        while pending:
            rows = pending.pop()
            for key, block in rows.blocks.items():
                if key in self.model.spans:
                    _, columns, _ = sp.find(as_matrix(block, rows.size))
                    unknowns.update((self.model.spans[key].start + columns).tolist())
                else:
                    pending.extend(self.model.reader.compiler.groups[-1 - key][2])
        return unknowns

    def _hessians(self, term: Any, shape: Any, columns: object) -> list[Any] | None:
        """Return the Hessian of each row in some unknowns; None if a row is not quadratic."""
        try:
            rows = self.model.reader.rows(term).spread(shape)
        except UnsupportedModel:
            return None
        parts = [rows.taken(number) for number in np.arange(rows.size)[:, np.newaxis]]
        quadratics: list[Any] = list(map(self.model.statement.quadratic, parts))
        return None if None in quadratics else [P[columns][:, columns] for P, *_ in quadratics]


def _summands(node: cp.Expression, factor: float) -> Iterator[tuple[float, Any]]:
    """Yield factors and terms, of which an expression is the sum."""
    if isinstance(node, atoms.SUM):
        for term in node.args:
            yield from _summands(term, factor)
    elif isinstance(node, atoms.NEGATIVE):
        yield from _summands(node.args[0], -factor)
    elif isinstance(node, atoms.ENTRY_SUM) and node.shape == ():
        yield from ((multiple, cp.sum(term)) for multiple, term in _summands(node.args[0], factor))
    elif isinstance(node, atoms.PRODUCTS) and node.args[0].is_constant() and node.args[0].size == 1:
        yield from _summands(node.args[1], factor * float(dense_value(node.args[0].value)))
    else:
        yield factor, node
