"""An objective beside complementarity in cvxpy: the best of all solutions, by branch and bound with a proved gap."""

from __future__ import annotations

import math
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.problems.problem import SolverStats
from cvxpy.reductions.solution import Solution

from ..core.errors import UnsupportedModel
from ..problems.equilibria.branch_and_bound import OPTIONS, minimize_over_solutions
from ..problems.equilibria.equilibrium_program import EquilibriumProgram
from ..problems.equilibria.result import EquilibriumResult
from ..problems.programs.reductions import fold_simple_rows
from ._compat import CVXPY_STATUS, name_of, statistics
from .builder import bounds_of_rows, by_rank, sign_of_inequality, states_bounds, warn_of_unbounded
from .certified_problem import ReducedProblem
from .constraint import Complements
from .expressions.rows import as_matrix
from .reading import Reader
from .stated_terms import sense_of


class StatedPair:
    """One complementarity as z ⟂ w: two vectors of variables, and the constraints that make them what it says."""

    def __init__(self, pair: Complements) -> None:
        self.pair, self.constraints = pair, list[Any]()
        ranked = by_rank(pair)
        for side in ranked:
            if not side.expression.is_affine():
                raise UnsupportedModel(
                    f"the side {side} of {pair!r} is not affine, and the best of all solutions is found among affine "
                    "ones only: linearise it, or leave out the objective and use requires_grad=True for a local search"
                )
        self.first, self.second = first, second = ranked
        self.lower, self.upper = bounds_of_rows(first)
        self.z, self.w = (self._variable(side.expression) for side in (first, second))
        self.is_equation, self.sign = second.kind == "zero", np.ones(self.lower.size)
        has_lower, has_upper = np.isfinite(self.lower), np.isfinite(self.upper)
        if self.is_equation and (has_lower | has_upper).any():
            raise UnsupportedModel(f"{pair!r} pairs an equality with a bounded variable; pair it with a free one")
        is_bounded = bool((has_lower | has_upper).any())
        self.is_unbounded = first.kind == second.kind == "value" and not is_bounded and not states_bounds(first)
        if second.kind == "nonnegative" and first.kind != "nonnegative":
            self.sign = sign_of_inequality(pair, self.lower, self.upper)
            if (self.sign < 0.0).any():
                self.w = self._variable(cp.multiply(self.sign, cp.vec(second.expression, order="F")))

    def _variable(self, expression: Any) -> Any:
        """Return a variable that is the expression, column by column."""
        rows, own = Reader().rows(expression), {one.id: one for one in expression.variables() if one.ndim <= 1}
        if len(rows.blocks) == 1 and not rows.offset.any() and (of := next(iter(rows.blocks))) in own:
            matrix = as_matrix(rows.blocks[of], rows.size)
            if matrix.shape[0] == matrix.shape[1] == matrix.nnz and (matrix.diagonal() == 1.0).all():
                return own[of]
        variable = cp.Variable(expression.size)
        self.constraints.append(variable == cp.vec(expression, order="F"))
        return variable


def stated_program(problem: Any) -> tuple[EquilibriumProgram, ReducedProblem, list[StatedPair]]:
    """Return the equilibrium program of a cvxpy problem, and the ways back.

    Raises
    ------
    UnsupportedModel
        Where it is none: sides that are not affine, an objective that is not convex quadratic or piecewise linear.
    """
    pairs = [StatedPair(one) for one in problem.constraints if isinstance(one, Complements)]
    others = [one for one in problem.constraints if not isinstance(one, Complements)]
    warn_of_unbounded([pair.first for pair in pairs if pair.is_unbounded])
    if not problem.objective.is_dcp():
        sense = "minimise" if sense_of(problem) > 0.0 else "maximise"
        shape = "convex" if sense == "minimise" else "concave"
        raise UnsupportedModel(
            f"the objective {name_of(problem.objective.args[0])} is not {shape} by cvxpy's rules, as it has to be to "
            f"{sense} it over complementarities: linearise it, or fix variables; a {shape} quadratic or piecewise "
            "linear one is taken"
        )
    added = [constraint for pair in pairs for constraint in pair.constraints]
    added += [one == 0 for pair in pairs if pair.is_equation for one in (pair.w,)]
    named = {one.id for constraint in [problem.objective, *others, *added] for one in constraint.variables()}
    own = {side.id: side for pair in pairs for side in (pair.z, pair.w) if side.id not in named and side.size}
    added += [cp.Variable(one.size) == cp.vec(one, order="F") for one in own.values()]  # so that cvxpy knows them
    reduced = ReducedProblem.of(cp.Problem(problem.objective, [*others, *added]))
    places = reduced.entries.variables
    if places is None:
        raise UnsupportedModel("a variable is not found again in what cvxpy compiled; use plain variables")
    program = fold_simple_rows(reduced.program).folded
    paired = [pair for pair in pairs if not pair.is_equation and pair.z.size]
    columns = [[places[side.id].places for side in (pair.z, pair.w)] for pair in paired]
    first, second = (np.concatenate([*(pair[k] for pair in columns), np.zeros(0, dtype=np.int64)]) for k in (0, 1))
    lower = np.concatenate([*(pair.lower for pair in paired), np.zeros(0)])
    upper = np.concatenate([*(pair.upper for pair in paired), np.zeros(0)])
    return EquilibriumProgram(program, first, second, lower, upper, reduced.offset), reduced, pairs


def solve_for_the_best(problem: Any, verbose: bool, options: dict[str, Any]) -> Any:
    """Solve a cvxpy problem with an objective beside complementarities, and write the answer back; return its value."""
    for name in options:
        if name not in OPTIONS:
            raise UnsupportedModel(
                f"the search for the best of all solutions has no option {name!r}; it has {', '.join(OPTIONS)}"
            )
    program, reduced, pairs = stated_program(problem)
    result = minimize_over_solutions(program, verbose=verbose, **options)
    write_back(problem, reduced, pairs, result)
    return problem.value


def write_back(problem: Any, reduced: ReducedProblem, pairs: list[StatedPair], result: EquilibriumResult) -> None:
    """Give the cvxpy problem its status, values, duals and statistics."""
    sense, status, attributes = sense_of(problem), CVXPY_STATUS[result.status], statistics(result)
    if result.x is None and status == settings.USER_LIMIT:  # nothing was found, and nothing is proved
        problem._clear_solution()
        problem._status = status
    elif result.x is None:
        value = math.inf if status == settings.INFEASIBLE else -math.inf
        problem.unpack(Solution(status, float(sense * value), {}, {}, attributes))
    else:
        places = reduced.entries.variables or {}
        x = result.x

        def values_of(one: Any) -> Any:
            return places[one.id].taken(x) if one.size else np.zeros(one.shape)

        values = {one.id: values_of(one) for one in problem.variables()}
        problem.unpack(Solution(status, float(sense * result.value), values, {}, attributes))
        for pair in pairs:
            z, w = values_of(pair.z), pair.sign * values_of(pair.w)
            for constraint, dual in ((pair.pair, w), (pair.first.constraint, w), (pair.second.constraint, z)):
                if constraint is not None:
                    constraint.save_dual_value(np.reshape(dual, pair.pair.shape, order="F"))
    problem._solver_stats = SolverStats.from_dict(attributes, "LCP")
