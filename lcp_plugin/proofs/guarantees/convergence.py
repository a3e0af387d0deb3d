"""Convergence of an iteration by a theorem, and its rate: plain facts in, a statement out.

Every rate here is the rate of a contraction in ‖x‖_v = max |x_i|/v_i, between any two points, so that it also proves
existence and uniqueness of the solution. One argument covers all bounds of a row. The residual
z − mid(lower, upper, z − S w) changes, row by row, by (1 − τ)e + τ S M e with some τ in [0, 1] (τ = 1 on a free row).
The projection of a component onto its bounds, which contain z*, never increases its distance from z*. A bound that is
convex in τ holds if it holds for τ = 0 and τ = 1. So boxes, free rows and the projection within a sweep cost nothing.

θ = s_i m_ii, ℓ = |L|v/(d v), u = |U|v/(d v), g = β/α; L is the part that the sweep has already updated (a backward
sweep exchanges L and U; a symmetric one is the product of both). The pivots p and the two cases:

| family | p | τ = 0 | τ = 1 |
|---|---|---|---|
| projected type | θ/α + θ + 2 | g θ ℓ < 1 | θ(ℓ + u) < min(θ, θ/α + 2), 0 ≤ g ≤ 2 |
| projected splitting, 𝓜 a part of M | 2θ + 2 | θ t < 1, t the sum of the entries of 𝓜 | ℓ + u < 1 |
| projected relaxation | 1 | – | for 0 ≤ β ≤ ω: ω(ℓ + u) < min(ω, 2 − ω) |
| modulus (of x, z = lower + max(x, 0)) | αΩ/d + 1 | – | α(ℓ + u) < min(α, 2 − α)/2 + α min(1, 2Ω/d − 1)/2 |

The last line too is for 0 ≤ β ≤ α; for α ≤ 1 it means that min(Ω, D) − |B| is an M-matrix.

A sweep that updates row after row multiplies the error e = z − z* by something nonnegative, row by row:

    p_i |e⁺_i|  ≤  A_i |e_i| + b_i (|L||e|)_i + u_i (|U||e|)_i + f_i (|L||e⁺|)_i

with L the already updated part. If this holds with |e| ≤ v and the right-hand side, f_i (|L|v)_i counted
in full, is below p_i v_i, the sweep contracts in ‖x‖_v = max |x_i|/v_i, by

    c = max_i (A v + b |L|v + u |U|v)_i / (p v − f |L|v)_i  <  1:

if |e⁺_j| ≤ c v_j for all rows j before i, then |e⁺_i| ≤ c v_i. All |L|v and |U|v here are rows of M divided by the
scale of the residual, so that no unit of a row can overflow them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...core.checks import FloatVector, read_only
from ...core.kernels.floats import EPSILON, TINY
from ...core.lcp import LCP
from ...core.matrix.iteration_facts import (
    PROJECTED_RELAXATION,
    PROJECTED_SPLITTING,
    PROJECTED_TYPE,
    IterationFacts,
)
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.row_sums import inverse_residual_scale, triangle_sums

NEGLIGIBLE = 1e-280  # below, products may have underflowed
Weights = FloatVector | float

Sums = tuple[FloatVector, FloatVector]


class RowCase(NamedTuple):
    """Row bound: free = p − A, and the weights b + f of |L|v and u of |U|v."""

    free: Weights
    lower: Weights
    upper: Weights


@dataclass(frozen=True)
class RowBound:
    """Effect of one sweep on an error; every case must hold, because a row may be in any of them.

    Attributes
    ----------
    pivot, feedback : array, shape (n,), or float
        p and f.
    cases : tuple of RowCase
    """

    pivot: Weights
    feedback: Weights
    cases: tuple[RowCase, ...]


# --- row bounds ------------------------------------------------------------------------------------------


def row_bound(facts: IterationFacts, problem: LCP) -> RowBound:
    """Return the bound of one sweep; L is the already updated part (for 𝓜: its entries)."""
    if facts.family == PROJECTED_TYPE:
        return _projected_type(facts, problem)
    if facts.family == PROJECTED_SPLITTING:
        theta, weight = scaled(facts, problem)
        zero_case = RowCase(np.minimum(2.0, 4.0 * theta + 2.0), 2.0 * weight, 0.0)
        return RowBound(
            2.0 * theta + 2.0, weight, (zero_case, RowCase(2.0 * theta, 2.0 * weight, 2.0 * weight))
        )
    alpha, beta = numbers(facts)
    diagonal = problem.diagonal
    per_diagonal = 1.0 / (diagonal * inverse_residual_scale(problem.matrix))
    if facts.family == PROJECTED_RELAXATION:
        free = min(alpha, 2.0 - alpha)
        lower = (abs(alpha - beta) + abs(beta)) * per_diagonal
        return RowBound(
            1.0, abs(beta) * per_diagonal, (RowCase(free, lower, alpha * per_diagonal),)
        )
    omega = np.ones(diagonal.size) if facts.omega is None else facts.omega / diagonal
    kept = min(alpha, 2.0 - alpha) + alpha * np.minimum(1.0, 2.0 * omega - 1.0)
    lower = (abs(alpha - beta) + alpha + abs(beta)) * per_diagonal
    case = RowCase(kept, lower, 2.0 * alpha * per_diagonal)
    return RowBound(alpha * omega + 1.0, abs(beta) * per_diagonal, (case,))


def _projected_type(facts: IterationFacts, problem: LCP) -> RowBound:
    alpha, beta = numbers(facts)
    g = beta / alpha
    theta, weight = scaled(facts, problem)
    zero = RowCase(
        np.minimum(2.0, 2.0 * theta / alpha + 2.0 * theta + 2.0), 2.0 * abs(g) * weight, 0.0
    )
    one = RowCase(
        np.minimum(2.0 * theta, 2.0 * theta / alpha + 4.0),
        (abs(2.0 - g) + abs(g)) * weight,
        2.0 * weight,
    )
    return RowBound(theta / alpha + theta + 2.0, abs(g) * weight, (zero, one))


def scaled(facts: IterationFacts, problem: LCP) -> tuple[FloatVector, FloatVector]:
    """Return (θ, s divided by the row scaling of the triangle sums), one entry per row."""
    scaling = np.ones(problem.n) if facts.scaling is None else facts.scaling
    return scaling * problem.diagonal, scaling / inverse_residual_scale(problem.matrix)


def numbers(facts: IterationFacts) -> tuple[float, float]:
    """Return (α, β); (1, 1) if they are determined during the run, which has the theorem of Gauss–Seidel."""
    return (
        1.0 if facts.relaxation is None else float(facts.relaxation),
        1.0 if facts.acceleration is None else float(facts.acceleration),
    )


def sums_for(facts: IterationFacts, problem: LCP, v: FloatVector) -> Sums:
    """Return the triangle sums of v that the row bound of a forward sweep requires."""
    if facts.family != PROJECTED_SPLITTING:
        return triangle_sums(problem.matrix, v)
    all_of_m = np.add(*triangle_sums(problem.matrix, v))
    taken = np.add(*triangle_sums(problem.matrix, v, facts.splitting))
    return taken, np.maximum(all_of_m - taken, 0.0) + all_of_m * (
        longest_row(problem.matrix) * EPSILON
    )


def _directed(facts: IterationFacts, sums: Sums) -> list[Sums]:
    """Return the sums in the order of each pass of one iteration."""
    exchanged = sums[1], sums[0]
    passes = {"forward": [sums], "backward": [exchanged], "symmetric": [sums, exchanged]}
    return passes["forward" if facts.family == PROJECTED_SPLITTING else facts.sweep]


#: A rate, None if it rounds to 1, and the weights v of ‖·‖_v, None without a rate.
Contraction = tuple[float | None, FloatVector | None]


def contraction(facts: IterationFacts, problem: LCP, v: FloatVector) -> Contraction | None:
    """Return the proof with these weights, or None if they prove nothing.

    Parameters
    ----------
    facts : IterationFacts
    problem : LCP
    v : array, shape (n,)
        Positive.
    """
    if facts.family == PROJECTED_SPLITTING and not facts.is_part_of_matrix:
        return None  # (𝓜 + 2I + D)⁻¹ may be of any signs
    sums = sums_for(facts, problem, v)
    terms, bound = longest_row(problem.matrix), row_bound(facts, problem)
    lost = underflow(v, terms)
    found = [
        float(gaps(bound, v, (updated + lost, rest + lost), terms).min(initial=1.0))
        for updated, rest in _directed(facts, sums)
    ]
    if not min(found) > 0.0:
        return None
    rates = [rate for gap in found if (rate := rate_of(gap)) is not None]
    if len(rates) < len(found):
        return None, None
    rate = math.prod(rates)
    return (float(np.nextafter(rate, 2.0)) if len(rates) > 1 else rate), read_only(v.copy())


# --- gaps of a row bound, evaluated so that rounding cannot flatter them ----------------------------------


def underflow(v: FloatVector, terms: int) -> float:
    """Return a bound of the underflow in a difference of two triangle sums of v, `terms` entries per row."""
    return 4.0 * terms * (1.0 + float(v.max(initial=0.0))) * TINY


def gaps(
    bound: RowBound, v: FloatVector, sums: tuple[FloatVector, FloatVector], terms: int
) -> FloatVector:
    """Return lower bounds of 1 − c_i, shape (n,), −∞ if no bound exists.

    Parameters
    ----------
    bound : RowBound
    v : array, shape (n,)
        Positive.
    sums : pair of arrays, shape (n,)
        Upper bounds of |L|v of what is already updated and |U|v of the rest except for the rounding of `terms`
        additions; see :func:`underflow`.

    Notes
    -----
    free = p − A is a difference of numbers no larger than p, and the sweep divides by a pivot that is rounded itself:
    its rounding error is measured relative to p.
    """
    updated, rest = sums
    slop = (terms + 32) * EPSILON
    smallest = np.full(v.size, np.inf)
    size = bound.pivot * v
    scale = (size - bound.feedback * updated) * (1.0 + slop) + 2.0 * slop * bound.feedback * updated
    for case in bound.cases:
        load = case.lower * updated + case.upper * rest
        surplus = (case.free * v - load) - slop * (size + load) - NEGLIGIBLE
        np.minimum(smallest, surplus / scale, out=smallest)
    usable = (scale > 0.0) & np.isfinite(scale) & (v > 0.0) & np.isfinite(v)
    smallest = smallest - 4.0 * EPSILON * np.abs(smallest)
    return np.where(usable & ~np.isnan(smallest), np.minimum(smallest, 1.0), -np.inf)


def rate_of(smallest: float) -> float | None:
    """Return an upper bound c < 1 of the contraction from the smallest gap, or None if that rounds to 1.

    Examples
    --------
    >>> rate_of(0.5)
    0.5000000000000001
    """
    rate = 1.0 - smallest
    rate = float(np.nextafter(rate, 2.0)) if smallest < 1.0 else 0.0
    return rate if rate < 1.0 else None


@fact
def longest_row(matrix: Matrix) -> int:
    """Return the largest number of entries in a row."""
    return int(np.diff(matrix.csr.indptr).max(initial=0))
