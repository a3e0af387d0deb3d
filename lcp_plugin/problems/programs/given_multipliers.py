"""What is wrong with the multipliers that came with an answer to a program."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from .program import QuadraticProgram

LOOSE = 10.0  # times the tolerance: errors of x beside its unit and ‖x‖∞, of multipliers beside their column's terms


def multiplier_error(program: QuadraticProgram, x: FloatVector, given: list[FloatVector], tolerance: float) -> str:
    """Return what is wrong with multipliers that were given, beyond what repairing them may excuse, or nothing."""
    names, (coefficient, unknown, objective, _, _) = ("inequality", "equality", "lower", "upper"), program.units
    every = np.concatenate(given)
    pulls = every * coefficient[: every.size]  # what each is, in the unit of the objective
    is_wrong = ~program.constraints.is_equality[: every.size]
    is_wrong &= pulls < -LOOSE * tolerance * (objective + float(np.abs(pulls).max(initial=0.0)))
    if is_wrong.any():
        ends = np.cumsum([0, *(part.size for part in given)])
        worst = int(np.where(is_wrong, pulls, 0.0).argmin())
        k = int(np.searchsorted(ends, worst, side="right")) - 1
        return f"the multiplier {names[k]}[{worst - ends[k]}] = {every[worst]:.3g} has the wrong sign"
    if idle := multiplier_beside_room(program, x, every, tolerance):
        return idle
    inequality, equality = given[:2]
    terms = [abs(sp.csr_array(program.P)) @ np.abs(x), np.abs(program.c)]
    terms += [abs(sp.csr_array(rows)).T @ np.abs(y) for rows, y in ((program.G, inequality), (program.A, equality))]
    s = program.P @ x + program.c + program.G.T @ inequality + program.A.T @ equality
    allowed = LOOSE * tolerance * (objective / unknown + np.max(terms, axis=0))
    if len(given) == len(names):
        s, low, high = s - given[2] + given[3], 0.0 * s, 0.0 * s
    else:  # a bound takes up what its sign allows, at the x that holds it
        with np.errstate(invalid="ignore"):
            reach = tolerance * (unknown + np.abs(x)) * LOOSE
            low = np.where(x - program.lower <= reach, np.inf, 0.0)
            high = np.where(program.upper - x <= reach, np.inf, 0.0)
    wrong = np.maximum(np.maximum(s - low, -s - high), 0.0) - allowed
    if wrong.max(initial=0.0) > 0.0:
        j = int(wrong.argmax())
        return f"the multipliers leave {abs(s[j]):.3g} of the gradient in component {j}"
    return ""


def multiplier_beside_room(program: QuadraticProgram, x: FloatVector, y: FloatVector, tolerance: float) -> str:
    """Return which of the first multipliers is not 0 although x leaves room at its inequality, or nothing.

    Others may balance it in the gradient. Their product is a part of the gap, and beside f(x) and its own terms here.
    """
    rows, k = program.constraints, y.size
    matrix, limit = rows.matrix[:k], rows.limit[:k]
    is_finite = np.isfinite(limit)
    coefficient, objective = program.units.coefficient[:k], program.units.objective
    room = np.where(is_finite, np.maximum(limit - matrix @ x, 0.0), coefficient)  # y itself has to be 0 at no limit
    terms = np.where(is_finite, np.maximum(np.abs(limit), abs(matrix) @ np.abs(x)), coefficient)
    value = np.where(is_finite, abs(program.objective(x)), 0.0)
    excess = np.abs(y * room) - LOOSE * tolerance * (objective + np.maximum(value, np.abs(y) * terms))
    excess[rows.is_equality[:k]] = 0.0
    if excess.max(initial=0.0) > 0.0:
        i = int(excess.argmax())
        what = f"{room[i]:.3g} of room" if is_finite[i] else "no limit"
        return f"a multiplier {y[i]:.3g} stands where there is {what}"
    return ""
