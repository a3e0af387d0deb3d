"""Bounds that hold for every solution, from a monotone lower level.

Of pairs 0 ≤ z ⟂ w = M z + N x + q ≥ 0 with S = ½ (M + Mᵀ) ≻ 0 the sum of the products z w = 0 gives

    zᵀS z = −zᵀ(N x + q) ≤ rᵀz,    r = max −(N x + q) over the bounds of x.

z lies in an ellipsoid. S ⪰ diag(d) > 0, which is proved, puts that into one with axes along the coordinates,
Σ dᵢ (zᵢ − rᵢ/2dᵢ)² ≤ R = Σ rᵢ²/4dᵢ, so that zᵢ ≤ rᵢ/2dᵢ + √(R/dᵢ). At any ẑ convexity gives (2 S ẑ − r)ᵀz ≤ ẑᵀS ẑ:
where zᵢ is largest in the ellipsoid, this bounds zᵢ nearly alone, and the bounds of the others do the rest.

Relaxations fall for ever without such bounds, SCIP's too, wherever an objective likes large z or w.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.rounding import gamma
from ...proofs.bounds.curvature import curvature
from ..programs.dual_bounds import implied_box
from .equilibrium_program import BETWEEN, LOWER, EquilibriumProgram, Indices

MOST_PAIRS = 300  # S is dense


def tightened(problem: EquilibriumProgram) -> EquilibriumProgram:
    """Return the problem with upper bounds of z that its lower level proves.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram(np.zeros((2, 2)), [0, -1], lower=[-1, 0], upper=[1, np.inf])
    >>> problem = EquilibriumProgram.of_rows(program, [1], [[-1, 2]], [0])  # 0 ≤ y ⟂ 2 y − x ≥ 0, x ≤ 1
    >>> float(tightened(problem).program.upper[1].round(9))
    0.5
    """
    lower, upper = problem.bounds(problem.all_cases)
    found = None if (lower > upper).any() else _ellipsoid(problem)
    if found is None:
        return problem
    columns, S, r, weights = found
    upper = np.array(problem.program.upper)
    upper[columns] = np.minimum(
        upper[columns], np.maximum(_largest(S, r, weights), problem.program.lower[columns])
    )
    return replace(problem, program=problem.program.with_vectors(upper=upper))


def _largest(S: FloatVector, r: FloatVector, weights: FloatVector) -> FloatVector:
    """Return upper bounds of z ≥ 0 in the ellipsoid zᵀS z ≤ rᵀz, rounded up."""
    k = r.size
    error = gamma(2 * k + 16)
    middle, reach = 0.5 * r / weights, np.sqrt(0.25 * float((r * r / weights).sum()) / weights)
    most = np.maximum(middle + reach + error * (np.abs(middle) + reach), 0.0)
    inverse = np.linalg.inv(S)
    center, spread = 0.5 * inverse @ r, np.diag(inverse)
    level = float(center @ S @ center)
    if not (np.isfinite(inverse).all() and level > 0.0 and (spread > 0.0).all()):
        return most
    touched = center[:, None] + inverse * np.sqrt(level / spread)  # column i where zᵢ is largest
    bent, size = S @ touched, np.abs(S) @ np.abs(touched)
    slopes = 2.0 * bent - r[:, None] - error * (2.0 * size + np.abs(r)[:, None])
    heights = (touched * bent).sum(axis=0) + error * (np.abs(touched) * size).sum(axis=0)
    own = np.diag(slopes)
    others = np.maximum(-slopes, 0.0)
    np.fill_diagonal(others, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        total = heights + most @ others
        alone = np.where(
            own > 0.0,
            (total + error * (np.abs(heights) + most @ others)) / own * (1.0 + error),
            np.inf,
        )
    return np.minimum(most, np.maximum(alone, 0.0))


def _ellipsoid(
    problem: EquilibriumProgram,
) -> tuple[Indices, FloatVector, FloatVector, FloatVector] | None:
    """Return z's columns, S, r and weights with S ⪰ diag(weights) > 0; None where there is no such S.

    Of the pairs whose w is one row of equations in bounded x.
    """
    if not 0 < problem.pairs <= MOST_PAIRS:
        return None
    lower, upper = implied_box(problem.relaxation)
    A, by_column = sp.csr_array(problem.program.A), sp.csc_array(problem.program.A)
    rows: dict[int, tuple[int, float]] = {}
    plain = (problem.all_cases == LOWER + BETWEEN) & (problem.lower == 0.0)
    for i in np.flatnonzero(plain).tolist():
        own = slice(by_column.indptr[problem.second[i]], by_column.indptr[problem.second[i] + 1])
        for row, factor in zip(
            by_column.indices[own].tolist(), by_column.data[own].tolist(), strict=True
        ):
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
            weights = np.nextafter(curvature(sp.csr_array(S)).weights - lost, 0.0)
            return (z, S, r, weights) if (weights > 0.0).all() else None
        chosen = [i for i, limit in zip(chosen, r, strict=True) if np.isfinite(limit)]
    return None


def _is_rounded(M: FloatVector) -> bool:
    """Return whether a sum of M + Mᵀ is rounded."""
    total = M + M.T
    part = total - M
    return bool(((M - (total - part)) + (M.T - part)).any())
