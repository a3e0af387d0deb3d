"""An objective beside complementarity in cvxpy: the best of all solutions.

What follows cvxpy's rules of convexity and makes a quadratic program is compiled by cvxpy: norms, maxima, absolute
values. Everything else is read by our own expressions, whatever their curvature: products, smooth sides, integers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.constraints import Equality, Inequality, NonNeg, NonPos, Zero
from cvxpy.problems.problem import SolverStats
from cvxpy.reductions.solution import Solution

from ..core.checks import FloatVector
from ..core.errors import UnsupportedModel
from ..problems.equilibria.branch_and_bound import OPTIONS, minimize_over_solutions
from ..problems.equilibria.equilibrium_program import EquilibriumProgram
from ..problems.equilibria.result import EquilibriumResult
from ..problems.programs.reductions import FoldedRows
from ._compat import CVXPY_STATUS, by_columns, dense, leaf_value, statistics
from .builder import (
    Builder,
    bounds_of_rows,
    by_rank,
    entry_name,
    of_equality_between_bounds,
    of_missing_bounds,
    sign_of_inequality,
    states_bounds,
    warn,
)
from .certified_problem import ReducedProblem
from .constraint import Complements, complements
from .equilibrium_rows import EquilibriumRows
from .expressions.rows import Indices, as_matrix
from .reading import Reader
from .stated_terms import expression_of, sense_of


class StatedPair:
    """One complementarity as z ⟂ w: the expressions, the bounds of z, and the sign of w."""

    def __init__(self, pair: Complements) -> None:
        self.pair = pair
        self.first, self.second = first, second = by_rank(pair)
        self.lower, self.upper = bounds_of_rows(first)
        self.sign = np.ones(self.lower.size)
        has_lower, has_upper = np.isfinite(self.lower), np.isfinite(self.upper)
        is_bounded = bool((has_lower | has_upper).any())
        self.is_equation = second.kind == "zero" and not is_bounded
        self.remarks: list[str] = []
        if second.kind == "zero" and is_bounded:
            self.remarks.append(of_equality_between_bounds(pair, first))
        if first.kind == second.kind == "value" and not is_bounded and not states_bounds(first):
            self.remarks.append(of_missing_bounds(first))
        self.w = second.expression
        if second.kind == "nonnegative" and first.kind != "nonnegative":
            self.sign = sign_of_inequality(pair, self.lower, self.upper)
            if (self.sign < 0.0).any():
                self.w = cp.multiply(self.sign, cp.vec(second.expression, order="F"))

    @property
    def sides(self) -> tuple[Any, Any]:
        """The expressions of z and w."""
        return self.first.expression, self.w


@dataclass(frozen=True, eq=False)
class Statement:
    """The equilibrium program of a cvxpy problem, and the ways back.

    Attributes
    ----------
    program : EquilibriumProgram
    pairs : list of StatedPair
    columns : list of tuple
        Of each pair the unknowns that are z and w.
    values : callable
        From x to the value of each variable, by its id.
    places : callable
        From a variable to the unknowns that its entries are, column by column; None where they are not entries.
    """

    program: EquilibriumProgram
    pairs: list[StatedPair]
    columns: list[tuple[Indices, Indices]]
    values: Callable[[FloatVector], dict[int, Any]]
    places: Callable[[Any], Indices | None]

    def start(self, variables: list[Any]) -> FloatVector | None:
        """Return x at the present values of the variables; None where one has none, or a side is not defined there."""
        x = np.zeros(self.program.program.n)
        for variable in variables:
            value, own = leaf_value(variable), self.places(variable)
            if value is None:
                return None
            if own is not None:
                x[own] = by_columns(value)
        with np.errstate(all="ignore"):  # outside of a domain
            for pair, columns in zip(self.pairs, self.columns, strict=True):
                for side, own in zip(pair.sides, columns, strict=True):
                    x[own] = by_columns(side.value) if side.size else 0.0
        return x if np.isfinite(x).all() else None


def stated_program(problem: Any) -> Statement:
    """Return the equilibrium program of a cvxpy problem, and the ways back.

    Raises
    ------
    UnsupportedModel
        Naming what is neither convex nor smooth.
    """
    pairs = [StatedPair(one) for one in problem.constraints if isinstance(one, Complements)]
    others = [one for one in problem.constraints if not isinstance(one, Complements)]
    warn([remark for pair in pairs for remark in pair.remarks])
    is_affine = all(side.is_affine() for pair in pairs for side in pair.sides)
    if (
        is_affine
        and not _integers(problem.variables())
        and cp.Problem(problem.objective, others).is_dcp()
    ):
        try:
            return _compiled(problem, pairs, others)
        except UnsupportedModel as error:
            refusal: Exception = error
    else:
        refusal = UnsupportedModel("it is not convex by cvxpy's rules either")
    try:
        return _read(problem, pairs, others)
    except UnsupportedModel as error:
        raise UnsupportedModel(f"{error} ({refusal})") from error


def _integers(variables: list[Any]) -> list[Any]:
    return [
        one for one in variables if one.attributes.get("integer") or one.attributes.get("boolean")
    ]


def _entries(variable: Any, chosen: Any) -> Indices:
    """Return which entries, column by column, cvxpy's ``boolean_idx`` or ``integer_idx`` names."""
    if not len(chosen):
        return np.zeros(0, dtype=np.int64)
    shape = max(variable.shape, (1,))
    try:
        found = np.ravel_multi_index(chosen, shape, order="F")
    except (
        ValueError
    ):  # a list of entries, as cvxpy took it before it took arrays of rows and of columns
        found = np.ravel_multi_index(tuple(np.transpose(chosen)), shape, order="F")
    return np.asarray(found, dtype=np.int64)


def _compiled(problem: Any, pairs: list[StatedPair], others: list[Any]) -> Statement:
    """Let cvxpy compile the objective and the constraints, the sides being variables."""
    added: list[Any] = []
    sides = [(_variable(pair.sides[0], added), _variable(pair.sides[1], added)) for pair in pairs]
    added += [
        one == 0
        for pair, (_, w) in zip(pairs, sides, strict=True)
        if pair.is_equation
        for one in (w,)
    ]
    named = {
        one.id
        for constraint in [problem.objective, *others, *added]
        for one in constraint.variables()
    }
    own = {side.id: side for both in sides for side in both if side.id not in named and side.size}
    added += [
        cp.Variable(one.size) == cp.vec(one, order="F") for one in own.values()
    ]  # so that cvxpy knows them
    reduced = ReducedProblem.of(cp.Problem(problem.objective, [*others, *added]))
    places = reduced.entries.variables
    if places is None:
        raise UnsupportedModel(
            "a variable is not found again in what cvxpy compiled; use plain variables"
        )
    program = FoldedRows.of(reduced.program).reduced
    nothing = np.zeros(0, dtype=np.int64)
    found = {
        side.id: places[side.id].places if side.size else nothing for both in sides for side in both
    }
    columns = [(found[z.id], found[w.id]) for z, w in sides]
    is_pair = [not pair.is_equation and pair.lower.size for pair in pairs]
    paired = [
        (*both, pair.lower, pair.upper)
        for pair, both, one in zip(pairs, columns, is_pair, strict=True)
        if one
    ]
    parts = [np.concatenate([*(one[k] for one in paired), nothing]) for k in range(4)]
    first, second = (part.astype(np.int64) for part in parts[:2])

    def values(x: FloatVector) -> dict[int, Any]:
        return {
            one.id: places[one.id].taken(x) if one.size else np.zeros(one.shape)
            for one in problem.variables()
        }

    def places_of(variable: Any) -> Indices | None:
        found = places[variable.id].places if variable.size else nothing
        return found if found.size == variable.size else None

    names = [""] * program.n
    for one in problem.variables():
        for k, column in enumerate(
            [] if (own_places := places_of(one)) is None else own_places.tolist()
        ):
            names[column] = entry_name(one, k)
    stated = EquilibriumProgram(
        program, first, second, parts[2], parts[3], reduced.offset, names=names
    )
    return Statement(stated, pairs, columns, values, places_of)


def _variable(expression: Any, added: list[Any]) -> Any:
    """Return a variable that is the expression, column by column, perhaps with an equation that is added."""
    rows, own = (
        Reader().rows(expression),
        {one.id: one for one in expression.variables() if one.ndim <= 1},
    )
    if len(rows.blocks) == 1 and not rows.offset.any() and (of := next(iter(rows.blocks))) in own:
        matrix = as_matrix(rows.blocks[of], rows.size)
        if matrix.shape[0] == matrix.shape[1] == matrix.nnz and (matrix.diagonal() == 1.0).all():
            return own[of]
    variable = cp.Variable(expression.size)
    added.append(variable == cp.vec(expression, order="F"))
    return variable


def _without_abs(expression: Any, kinks: list[Complements]) -> Any:
    """Return the expression with x + 2 s in the place of |x|, 0 ≤ s ⟂ x + s ≥ 0 being added to the pairs."""
    arguments = [_without_abs(one, kinks) for one in expression.args]
    if isinstance(expression, cp.abs) and not expression.is_constant():
        x, s = arguments[0], cp.Variable(expression.shape)
        s.value = None if x.value is None else np.maximum(-dense(x.value), 0.0)
        kinks.append(complements(s >= 0, x + s >= 0))
        return x + 2 * s
    is_same = all(one is own for one, own in zip(arguments, expression.args, strict=True))
    return expression if is_same else expression.copy(arguments)


def _read(problem: Any, pairs: list[StatedPair], others: list[Any]) -> Statement:
    """Read objective, constraints and sides by our own expressions."""
    kinks: list[Complements] = []
    goal_read = _without_abs(problem.objective.args[0], kinks)
    rows = [_without_abs(expression_of(one), kinks) for one in others]
    pairs = [*pairs, *map(StatedPair, kinks)]
    builder = Builder([problem.objective, *problem.constraints, *kinks], {}, takes_integers=True)
    columns = [np.arange(one.size) + builder.offsets[one.id] for one in builder.variables]
    integers = []
    for one, own in zip(builder.variables, columns, strict=True):
        binary, whole = own[_entries(one, one.boolean_idx)], own[_entries(one, one.integer_idx)]
        integers += [binary, whole]
        builder.lower[binary] = np.maximum(builder.lower[binary], 0.0)
        builder.upper[binary] = np.minimum(builder.upper[binary], 1.0)
    found = EquilibriumRows(
        builder.compiler,
        builder.first,
        builder.lower,
        builder.upper,
        np.concatenate([*integers, np.zeros(0, dtype=np.int64)]),
    )
    for one, row in zip(others, rows, strict=True):
        if not isinstance(one, (Equality, Zero, Inequality, NonPos, NonNeg)):
            raise UnsupportedModel(
                f"the constraint {one} is neither an equation nor an inequality; write it as such"
            )
        low = 0.0 if isinstance(one, (Equality, Zero, NonNeg)) else -np.inf
        high = np.inf if isinstance(one, NonNeg) else 0.0
        found.constrain(builder.reader.rows(row), low, high)
    sides = []
    for pair in pairs:
        z, w = (builder.reader.rows(side) for side in pair.sides)
        if pair.is_equation:
            found.constrain(w, 0.0, 0.0)
            sides.append((found.named(z), found.named(w)))
        else:
            sides.append(found.pair(z, w, pair.lower, pair.upper))
    goal = builder.reader.rows(goal_read)
    places = {one.id: own for one, own in zip(builder.variables, columns, strict=True)}

    def values(x: FloatVector) -> dict[int, Any]:
        return {
            one.id: x[places[one.id]].reshape(one.shape, order="F") for one in problem.variables()
        }

    names = [entry_name(one, k) for one in builder.variables for k in range(one.size)]
    program = replace(found.program(goal, sense_of(problem)), names=names)
    return Statement(program, pairs, sides, values, lambda one: places[one.id])


def solve_for_the_best(
    problem: Any, verbose: bool, warm_start: bool, options: dict[str, Any]
) -> Any:
    """Solve a cvxpy problem with an objective beside complementarities, and write the answer back; return its value."""
    for name in options:
        if name not in OPTIONS:
            raise UnsupportedModel(
                f"the search for the best of all solutions has no option {name!r}; it has {', '.join(OPTIONS)}"
            )
    stated = stated_program(problem)
    if warm_start and "x0" not in options:
        options = {**options, "x0": stated.start(problem.variables())}
    result = minimize_over_solutions(stated.program, verbose=verbose, **options)
    if verbose:
        settings.LOGGER.info(result.explain())
    write_back(problem, stated, result)
    return problem.value


def write_back(problem: Any, stated: Statement, result: EquilibriumResult) -> None:
    """Give the cvxpy problem its status, values, duals and statistics; without a point variables keep their values."""
    sense, status, attributes = sense_of(problem), CVXPY_STATUS[result.status], statistics(result)
    if (
        result.x is None and status == settings.USER_LIMIT
    ):  # nothing was found, and nothing is proved
        problem._status, problem._value = status, None
    elif result.x is None:
        value = math.inf if status == settings.INFEASIBLE else -math.inf
        problem.unpack(Solution(status, float(sense * value), {}, {}, attributes))
    else:
        x = result.x
        problem.unpack(
            Solution(status, float(sense * result.value), stated.values(x), {}, attributes)
        )
        for pair, (z, w) in zip(stated.pairs, stated.columns, strict=True):
            slack = pair.sign * x[w]
            for constraint, dual in (
                (pair.pair, slack),
                (pair.first.constraint, slack),
                (pair.second.constraint, x[z]),
            ):
                if constraint is not None:
                    constraint.save_dual_value(np.reshape(dual, pair.pair.shape, order="F"))
    problem._solver_stats = SolverStats.from_dict(attributes, "LCP")
