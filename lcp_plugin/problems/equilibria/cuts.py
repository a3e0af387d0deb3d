"""Cuts that hold for every solution, from a monotone lower level.

Of pairs 0 ≤ z ⟂ w = M z + N x + q ≥ 0 with S = ½ (M + Mᵀ) ⪰ 0 the sum of the products z w = 0 gives

    zᵀS z = −zᵀ(N x + q) ≤ rᵀz,    r = max −(N x + q) over the bounds of x.

z lies in an ellipsoid, which no relaxation of single pairs knows. At any ẑ ≥ 0 convexity turns it into a linear cut,
(2 S ẑ − r)ᵀz ≤ ẑᵀS ẑ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.rounding import gamma
from ...proofs.bounds.curvature import curvature
from ..programs.compiled_call import solved_at_once
from ..programs.dual_bounds import implied_box
from .equilibrium_program import BETWEEN, LOWER, EquilibriumProgram

MOST_PAIRS = 300  # a cut has an entry for each
ROUNDS = 20
VIOLATED = 1e-3  # of rᵀz


@dataclass(frozen=True, eq=False)
class Strengthened:
    """A problem with cuts, and what proves them.

    Attributes
    ----------
    problem : EquilibriumProgram
        With the cuts among the inequalities.
    original : EquilibriumProgram
    points : tuple of ndarray
        Where the cuts touch the ellipsoid of a monotone lower level.
    """

    problem: EquilibriumProgram
    original: EquilibriumProgram
    points: tuple[FloatVector, ...] = ()

    def verify(self) -> bool:
        """Return whether the cuts are those that the points give."""
        if not self.points:
            return self.problem is self.original
        again, mine = with_points(self.original, ellipsoid(self.original), self.points), self.problem
        return (
            np.array_equal(again.program.h, mine.program.h)
            and all((sp.csr_array(getattr(again.program, name)) != sp.csr_array(getattr(mine.program, name))).nnz == 0
                    for name in ("P", "A", "G"))
            and all(np.array_equal(getattr(again.program, name), getattr(mine.program, name))
                    for name in ("c", "b", "lower", "upper"))
        )


def strengthened(problem: EquilibriumProgram) -> Strengthened:
    """Return the problem with cuts from its lower level: those that the relaxation needs."""
    lower, upper = problem.bounds(problem.all_cases)
    within = None if (lower > upper).any() else ellipsoid(problem)
    points = () if within is None else tight_points(problem, within, separating_points(problem, within))
    return Strengthened(with_points(problem, within, points), problem, points)


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """z ≥ 0 with zᵀS z ≤ rᵀz for every solution.

    Attributes
    ----------
    columns : ndarray of int, shape (k,)
    S : ndarray, shape (k, k)
    r : ndarray, shape (k,)
    """

    columns: NDArray[np.int64]
    S: FloatVector
    r: FloatVector

    def cut(self, at: FloatVector) -> tuple[FloatVector, float]:
        """Return (a, d) with aᵀz ≤ d for every z in it: a rounded down, d up."""
        error = gamma(2 * at.size + 8)
        slope, size = 2.0 * (self.S @ at) - self.r, 2.0 * (np.abs(self.S) @ np.abs(at)) + np.abs(self.r)
        curved = float(np.abs(at) @ np.abs(self.S) @ np.abs(at))
        return slope - error * size, float(at @ self.S @ at) + error * curved

    def boundary(self, z: FloatVector) -> FloatVector | None:
        """Return the multiple of z where a cut separates z best; None where z is within."""
        curved, slope = float(z @ self.S @ z), float(self.r @ z)
        if not curved > slope + VIOLATED * abs(slope):
            return None
        return np.maximum(z, 0.0) * max(slope, 0.0) / curved if slope > 0.0 else None


def ellipsoid(problem: EquilibriumProgram) -> Ellipsoid | None:
    """Return what the products say of the pairs whose w is one row of equations in bounded x; None where S ⋡ 0."""
    if not 0 < problem.pairs <= MOST_PAIRS:
        return None
    lower, upper = implied_box(problem.relaxation)
    A, by_column = sp.csr_array(problem.program.A), sp.csc_array(problem.program.A)
    rows: dict[int, tuple[int, float]] = {}
    plain = (problem.all_cases == LOWER + BETWEEN) & (problem.lower == 0.0)
    for i in np.flatnonzero(plain).tolist():
        own = slice(by_column.indptr[problem.second[i]], by_column.indptr[problem.second[i] + 1])
        for row, factor in zip(by_column.indices[own].tolist(), by_column.data[own].tolist(), strict=True):
            if abs(math.frexp(factor)[0]) == 0.5 and row not in {one for one, _ in rows.values()}:
                rows[i] = row, factor
                break
    chosen = sorted(rows)
    while chosen:
        z, w = problem.first[chosen], problem.second[chosen]
        if np.unique(z).size < z.size:
            return None
        factors = np.array([rows[i][1] for i in chosen])
        terms = -(A[[rows[i][0] for i in chosen]].toarray() / factors[:, None])  # of w
        terms[np.arange(len(chosen)), w] += 1.0
        M = terms[:, z]
        terms[:, z] = 0.0
        with np.errstate(invalid="ignore"):
            most = np.where(terms > 0.0, -terms * lower, np.where(terms < 0.0, -terms * upper, 0.0))
        limits = problem.program.b[[rows[i][0] for i in chosen]] / factors
        size = np.abs(most).sum(axis=1) + np.abs(limits)
        r = most.sum(axis=1) - limits + gamma(terms.shape[1] + 4) * size
        if np.isfinite(r).all():
            S = 0.5 * (M + M.T)
            lost = gamma(4) * len(chosen) * float(np.abs(S).max(initial=0.0)) * _is_rounded(M)
            is_convex = S.any() and bool((curvature(sp.csr_array(S)).weights >= lost).all())
            return Ellipsoid(z, S, r) if is_convex else None
        chosen = [i for i, limit in zip(chosen, r, strict=True) if np.isfinite(limit)]
    return None


def _is_rounded(M: FloatVector) -> bool:
    """Return whether a sum of M + Mᵀ is rounded."""
    total = M + M.T
    part = total - M
    return bool(((M - (total - part)) + (M.T - part)).any())


def with_points(
    problem: EquilibriumProgram, within: Ellipsoid | None, points: Sequence[FloatVector]
) -> EquilibriumProgram:
    """Return the problem with a cut for each point among its inequalities."""
    if within is None or not points:
        return problem
    cuts = [within.cut(at) for at in points]
    rows, limits = np.zeros((len(points), problem.program.n)), np.array([limit for _, limit in cuts])
    rows[:, within.columns] = [slope for slope, _ in cuts]
    scale = np.abs(rows).max(axis=1)
    exponent = np.exp2(np.ceil(np.log2(np.where(scale > 0.0, scale, 1.0))))
    return problem.with_inequalities(sp.csr_array(rows / exponent[:, None]), limits / exponent)


def separating_points(problem: EquilibriumProgram, within: Ellipsoid) -> tuple[FloatVector, ...]:
    """Return where cuts are wanted: by rounds beyond the relaxation's solution, and where each z is largest."""
    points = _largest(within)
    for _ in range(ROUNDS):
        found = solved_at_once(with_points(problem, within, points).relaxation, 1e-9)
        at = None if found is None else within.boundary(found.solution.x[within.columns])
        if at is None:
            break
        points.append(at)
    return tuple(points)


def tight_points(
    problem: EquilibriumProgram, within: Ellipsoid, points: tuple[FloatVector, ...]
) -> tuple[FloatVector, ...]:
    """Return the points whose cuts hold with equality where the relaxation with all of them is least."""
    found = solved_at_once(with_points(problem, within, points).relaxation, 1e-9)
    if found is None:
        return points
    multipliers = found.solution.inequality[problem.program.h.size :]
    return tuple(point for point, multiplier in zip(points, multipliers, strict=True) if multiplier > 0.0)


def _largest(within: Ellipsoid) -> list[FloatVector]:
    """Return the points of the ellipsoid where one entry is largest."""
    try:
        inverse = np.linalg.inv(within.S)
    except np.linalg.LinAlgError:
        return []
    center = 0.5 * inverse @ within.r
    room, spread = float(center @ within.S @ center), np.diag(inverse)
    if not (np.isfinite(inverse).all() and room > 0.0 and (spread > 0.0).all()):
        return []
    return [center + inverse[:, i] * math.sqrt(room / spread[i]) for i in range(center.size)]
