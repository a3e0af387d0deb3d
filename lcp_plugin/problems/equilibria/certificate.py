"""Verdict on a point of an equilibrium program, from any solver: its rows and pairs, and the proved bound."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from ...core import deadline
from ...core.checks import Array, Vector, checked_vector
from ...engines.linear_program import FEASIBLE
from ...judges.worst_rows import WorstRow, WorstRows
from .branch_and_bound import minimize_over_solutions
from .equilibrium_program import EquilibriumProgram
from .relaxations import EquilibriumResult

NODES = 100  # of a search for a bound


@np.errstate(all="ignore")
def verdict_at(problem: EquilibriumProgram, x: Array, tolerance: float) -> dict[str, Any]:
    """Return the fields of the verdict on x.

    Rows hold to the tolerance of their terms, or to FEASIBLE as in a solve if that is more; pairs and integers hold to
    the same in the unit of x. The bound is that of a result whose proof is checked here, or of a search of NODES nodes
    if its pieces are convex.
    """
    claimed, x = x, checked_vector(getattr(x, "x", x), "x", problem.program.n)
    allowed, size = max(tolerance, FEASIBLE), problem.objective_size(x)
    rows = partial(worst_conditions, problem, x, allowed)
    fields = {"claim": "optimal", "violation": problem.excess(x), "rows": rows}
    if violated := rows(1):
        return fields | {"verdict": "disproved", "reason": violated[0].text}
    value, sense, best = problem.objective(x), problem.program.sense, claimed
    is_known = isinstance(claimed, EquilibriumResult) and claimed.problem is problem
    if not (is_known and best.proof is not None and best.verify()):
        if not problem.is_provable:
            reason = "x is feasible, and no bound of the objective of this problem can be proved"
            return fields | {"verdict": "unproved", "reason": reason}
        limits: Any = {"max_nodes": NODES, "max_seconds": deadline.left(), "x0": x, "prove": True}
        best = minimize_over_solutions(problem, tolerance=0.1 * tolerance, **limits)
    lower, upper, excess = best.lower_bound, min(best.value, value), value - best.lower_bound
    fields |= {"lower": lower if lower > -math.inf else None, "upper": upper}
    fields["gap"] = max(excess, 0.0) if lower > -math.inf else None
    if upper < value - tolerance * size:
        best_value, this = sense * upper, sense * value
        reason = f"a solution has the objective {best_value:.9g}, and this one {this:.9g}"
        return fields | {"verdict": "disproved", "reason": reason}
    if excess <= tolerance * size:
        reason = f"no solution has an objective that is better by more than {max(excess, 0.0):.2g}"
        return fields | {"verdict": "proved", "reason": reason}
    reason = "x is feasible, and its objective is only proved to be within "
    reason += f"{excess:.3g} of the best"
    return fields | {"verdict": "unproved", "reason": reason}


def worst_conditions(
    problem: EquilibriumProgram, x: Vector, allowed: float, count: int
) -> WorstRows:
    """Return the rows, pairs and integers that x violates by more than is allowed, the worst first."""
    program, worst = problem.program, []
    relative, missed = problem.excess_of_rows(x), program.constraints.excess(x)
    for k in np.flatnonzero(~(relative <= allowed)).tolist():
        name, terms = program.name(k), float(missed[k] / relative[k])
        text = f"{name} is violated by {missed[k]:.3g}"
        worst.append(WorstRow(name, float(relative[k]), float(missed[k]), terms, text))
    distances, first, second = problem.violations(x), problem.first, problem.second
    for i in np.flatnonzero(~(distances <= allowed)).tolist():
        z, w = (program.names.unknown(j[i], "x[{}]") for j in (first, second))
        text = f"{z} = {x[first[i]]:.6g} and {w} = {x[second[i]]:.6g} are not complementary"
        distance = float(distances[i])
        worst.append(WorstRow(f"{z} ⟂ {w}", distance, distance, 1.0, text))
    for j in problem.integers[np.abs(x - np.rint(x))[problem.integers] > allowed].tolist():
        name, distance = program.names.unknown(j, "x[{}]"), float(abs(x[j] - round(x[j])))
        text = f"{name} = {x[j]:.6g} is not an integer"
        worst.append(WorstRow(name, distance, distance, 1.0, text))
    if not worst and not (excess := problem.excess(x)) <= allowed:
        text = f"a smooth row is violated by {excess:.3g} of its terms"
        worst.append(WorstRow("smooth part", excess, excess, 1.0, text))
    return WorstRows(sorted(worst, key=lambda row: -row.residual)[:count])
