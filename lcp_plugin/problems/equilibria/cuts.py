"""Bounds of the sides of pairs by linear programs, and the cuts that they give.

Where l ≤ z ≤ u and 0 ≤ w ≤ v hold for every solution, (z − l)/(u − l) + w/v ≤ 1 does: one of the two terms is 0. It
cuts off most of what the relaxation of a pair lets in. u and v are proved by the multipliers of max z and max w.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.deadline import is_over
from ...proofs.bounds.curvature import curvature
from ..programs.compiled_call import solved_at_once
from ..programs.dual_bounds import DualBounds, implied_box
from ..programs.program import QuadraticProgram
from .equilibrium_program import BETWEEN, LOWER, EquilibriumProgram
from .monotone import ellipsoid, separating_points, tight_points, with_points

MOST_PROGRAMS = 400
LARGEST = 1e7  # times the smallest: a bound that is farther cuts nothing off
OUTWARD = 1.0 + 2.0**-40  # more than what rounds in a cut


class ProvedBound(NamedTuple):
    """An upper bound of a variable, and the point and multipliers that prove it; None where single rows imply it."""

    column: int
    bound: float
    dual: tuple[FloatVector, FloatVector] | None


@dataclass(frozen=True, eq=False)
class Strengthened:
    """A problem with cuts, and what proves them.

    Attributes
    ----------
    problem : EquilibriumProgram
        With the cuts among the inequalities.
    original : EquilibriumProgram
    bounds : tuple of ProvedBound
    points : tuple of ndarray
        Of the cuts from the ellipsoid of a monotone lower level that prove the bounds.
    kept : tuple of ndarray
        Those among them whose cuts the problem has.
    """

    problem: EquilibriumProgram
    original: EquilibriumProgram
    bounds: tuple[ProvedBound, ...]
    points: tuple[FloatVector, ...] = ()
    kept: tuple[FloatVector, ...] = ()

    def verify(self) -> bool:
        """Return whether all bounds hold, and the cuts are those that they give."""
        if not (self.bounds or self.points):
            return self.problem is self.original
        within = ellipsoid(self.original) if self.points else None
        sides = _Sides(with_points(self.original, within, self.points))
        for found in self.bounds:
            if found.dual is None:
                if not sides.implied[found.column] <= found.bound:
                    return False
            elif not sides.proved(found.column, found.dual) <= found.bound:
                return False
        base = with_points(self.original, within, self.kept)
        again, mine = _with_cuts(base, {one.column: one.bound for one in self.bounds}), self.problem
        return (
            np.array_equal(again.program.h, mine.program.h)
            and all((sp.csr_array(getattr(again.program, name)) != sp.csr_array(getattr(mine.program, name))).nnz == 0
                    for name in ("P", "A", "G"))
            and all(np.array_equal(getattr(again.program, name), getattr(mine.program, name))
                    for name in ("c", "b", "lower", "upper"))
        )


class _Sides:
    """The variables of pairs in the relaxation of all cases."""

    def __init__(self, problem: EquilibriumProgram) -> None:
        lower, upper = problem.bounds(problem.all_cases)
        self.program = problem.program.with_vectors(lower=lower, upper=upper)
        self.box = implied_box(self.program)
        self.implied = self.box[1]

    def furthest(self, column: int) -> ProvedBound | None:
        """Return a bound of a variable by a linear program, None where it has none."""
        linear = self._linear(column)
        found = solved_at_once(linear, 1e-9)
        if found is None:
            return None
        dual = found.solution.x, np.concatenate([found.solution.inequality, found.solution.equality])
        bound = self.proved(column, dual)
        return ProvedBound(column, bound, dual) if bound < min(self.implied[column], math.inf) else None

    def proved(self, column: int, dual: tuple[FloatVector, FloatVector]) -> float:
        """Return what a point and multipliers prove of the largest value of a variable."""
        linear = self._linear(column)
        return -DualBounds(linear, curvature(linear.P), self.box).best(*dual, -math.inf)

    def _linear(self, column: int) -> QuadraticProgram:
        program, slope = self.program, np.zeros(self.program.n)
        slope[column] = -1.0
        return QuadraticProgram(
            sp.csr_array((program.n, program.n)), slope, program.G, program.h, program.A, program.b, program.lower,
            program.upper,
        )


def strengthened(problem: EquilibriumProgram) -> Strengthened:
    """Return the problem with cuts from its lower level, and one for each pair of which both sides are bounded."""
    lower, upper = problem.bounds(problem.all_cases)
    if (lower > upper).any():  # no solution
        return Strengthened(problem, problem, ())
    within = ellipsoid(problem)
    points = () if within is None else separating_points(problem, within)
    sides = _Sides(with_points(problem, within, points))
    is_plain = problem.all_cases == LOWER + BETWEEN
    columns = np.unique(np.concatenate([problem.first[is_plain], problem.second[is_plain]]))
    bounds = []
    for column in columns.tolist():
        found = None
        if columns.size <= MOST_PROGRAMS and not is_over() and problem.program.upper[column] == math.inf:
            found = sides.furthest(column)
        if found is None and sides.implied[column] < math.inf:
            found = ProvedBound(column, float(sides.implied[column]), None)
        if found is not None:
            bounds.append(found)
    proved = {one.column: one.bound for one in bounds}
    kept = () if within is None else tight_points(_with_cuts(problem, proved), within, points)
    return Strengthened(_with_cuts(with_points(problem, within, kept), proved), problem, tuple(bounds), points, kept)


def _with_cuts(problem: EquilibriumProgram, bounds: dict[int, float]) -> EquilibriumProgram:
    program, rows, limits = problem.program, [], []
    pairs = (problem.first, problem.second, problem.lower, problem.all_cases)
    for z, w, lower, cases in zip(*(part.tolist() for part in pairs), strict=True):
        room, most = bounds.get(z, math.inf) - lower, bounds.get(w, math.inf)
        if cases != LOWER + BETWEEN or z == w or not (0.0 < room < math.inf and 0.0 < most < math.inf):
            continue
        room, most = room * OUTWARD + OUTWARD * abs(lower) * 2.0**-50, most * OUTWARD
        if max(room, most) > LARGEST * min(room, most):
            continue
        # most (z − l) + room w ≤ room · most, divided by the larger
        scale = max(room, most)
        rows.append(([most / scale, room / scale], [z, w]))
        limit = most / scale * lower + room * most / scale
        limits.append(limit + abs(limit) * 2.0**-44 + abs(most / scale * lower) * 2.0**-44)
    if not rows:
        return problem
    data, columns = np.array([row[0] for row in rows]).ravel(), np.array([row[1] for row in rows]).ravel()
    cuts = sp.csr_array((data, columns, np.arange(0, data.size + 1, 2)), shape=(len(rows), program.n))
    cuts.sort_indices()
    wider = QuadraticProgram(
        program.P, program.c, sp.vstack([sp.csr_array(program.G), cuts], format="csr"),
        np.append(program.h, limits), program.A, program.b, program.lower, program.upper,
    )
    return replace(problem, program=wider)
