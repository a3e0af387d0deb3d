"""Which theorem makes an iteration converge, and how fast: plain facts in, a statement out.

Every rate here is that of a contraction in ‖x‖_v = max |x_i|/v_i, between any two points, so that it proves existence
and uniqueness of the solution as well. What rows do is covered by one argument for all bounds: the residual
z − mid(lower, upper, z − S w) changes, row by row, by (1 − τ)e + τ S M e with some τ in [0, 1] (τ = 1 on a free row),
and the projection of a component onto its bounds, which hold z*, never takes it further from z*. A bound that is
convex in τ holds if it holds for τ = 0 and τ = 1. So boxes, free rows and the projection within a sweep cost nothing.

θ = s_i m_ii, ℓ = |L|v/(d v), u = |U|v/(d v), g = β/α; L is what the sweep has already updated (a backward sweep
exchanges L and U; a symmetric one is the product of both). The pivots p and the two cases:

| family | p | τ = 0 | τ = 1 |
|---|---|---|---|
| projected type | θ/α + θ + 2 | g θ ℓ < 1 | θ(ℓ + u) < min(θ, θ/α + 2), 0 ≤ g ≤ 2 |
| projected splitting, 𝓜 a part of M | 2θ + 2 | θ t < 1, t the sum of what 𝓜 takes | ℓ + u < 1 |
| projected relaxation | 1 | – | for 0 ≤ β ≤ ω: ω(ℓ + u) < min(ω, 2 − ω) |
| modulus (of x, z = lower + max(x, 0)) | αΩ/d + 1 | – | α(ℓ + u) < min(α, 2 − α)/2 + α min(1, 2Ω/d − 1)/2 |

The last line too is for 0 ≤ β ≤ α; where α ≤ 1 it says that min(Ω, D) − |B| is an M-matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..checks import FloatVector
from ..problem.lcp import LCP
from .contraction import (
    Case,
    RowBound,
    gaps,
    growth,
    inverse_residual_scale,
    longest_row,
    rate_of,
    row_blocks,
    triangle_sums,
    underflow,
)

ALL = slice(None)
PROJECTED_TYPE = "projected type"
PROJECTED_SPLITTING = "projected splitting"
PROJECTED_RELAXATION = "projected relaxation"
MODULUS = "modulus"

GUARANTEED, NOT_COVERED, CAN_DIVERGE = "guaranteed", "not covered", "can diverge"

Sums = tuple[FloatVector, FloatVector]


@dataclass(frozen=True, eq=False, kw_only=True)
class IterationFacts:
    """What the theorems ask of an iteration.

    Attributes
    ----------
    family : str
        "projected type", "projected splitting", "projected relaxation" or "modulus".
    relaxation : float or None
        α (ω of a projected relaxation); None where it is found during the run.
    acceleration : float or None
        β.
    sweep : {"forward", "backward", "symmetric"}
    scaling : array, shape (n,), or None
        The diagonal of S of the projected-type families.
    is_scaled : bool
        Whether S was chosen, so that the paper's theorems are not about M itself.
    omega : array, shape (n,), or None
        The diagonal of Ω of the modulus family.
    splitting : sparse array, shape (n, n), or None
        𝓜 of a projected splitting; `is_part_of_matrix` where its entries are those of M or 0, the diagonal complete.
    """

    family: str
    relaxation: float | None = 1.0
    acceleration: float | None = 1.0
    sweep: str = "forward"
    scaling: FloatVector | None = field(default=None, repr=False)
    is_scaled: bool = False
    omega: FloatVector | None = field(default=None, repr=False)
    splitting: Any = field(default=None, repr=False)
    is_part_of_matrix: bool = False


@dataclass(frozen=True, eq=False)
class Guarantee:
    """What is proven about an algorithm on a matrix, whatever q and the bounds are.

    Attributes
    ----------
    verdict : {"guaranteed", "not covered", "can diverge"}
        Convergence from every start is proven; nothing is proven here; or with this M, some q and bounds there
        are starts from which it does not converge.
    theorem : str
        The theorem and its source, or what stands in the way.
    rate : float or None
        c < 1 with ‖z_{k+1} − z*‖_v ≤ c ‖z_k − z*‖_v for every k; of x where `speaks_of` is "x". So
        |z_k − z*| ≤ c/(1 − c) ‖z_k − z_{k−1}‖_v v, in exact arithmetic.
    v : array, shape (n,), or None
        The weights of that norm, positive.
    remedy : str
        What to do where it is not guaranteed.
    paper : str
        What the paper's Theorem 4.2 as stated says, for its methods without row scaling.
    speaks_of : {"z", "x"}
        The rate of a modulus method is one of its x, z = lower + max(x, 0):
        ‖z_k − z*‖_v ≤ cᵏ ‖x_0 − x*‖_v with x* = z* − lower − Ω⁻¹w*.
    """

    verdict: str
    theorem: str
    rate: float | None = None
    v: FloatVector | None = field(default=None, repr=False)
    remedy: str = ""
    paper: str = ""
    speaks_of: str = "z"

    @property
    def is_guaranteed(self) -> bool:
        """True where convergence is proven."""
        return self.verdict == GUARANTEED

    def __str__(self) -> str:
        speed = ""
        if self.rate is not None:
            speed = f"; an iteration contracts by {_rounded_up(self.rate)} in a weighted maximum norm"
            speed += "" if self.speaks_of == "z" else f" of {self.speaks_of}"
        lines = [f"{self.verdict}: {self.theorem}{speed}"]
        lines += [f"what to do: {self.remedy}"] if self.remedy else []
        return "\n".join(lines + ([self.paper] if self.paper else []))


def _rounded_up(rate: float) -> str:
    """Return the rate rounded up to three digits after the nines.

    Examples
    --------
    >>> _rounded_up(0.81234), _rounded_up(0.999871234)
    ('0.813', '0.999872')
    """
    places = 3 + max(0, -math.ceil(math.log10(1.0 - rate))) if rate < 1.0 else 17
    text = f"{math.ceil(rate * 10.0**places) / 10.0**places:.{min(places, 17)}f}"
    return text if float(text) < 1.0 else f"1 − {1.0 - rate:.1e}"


# --- row bounds ------------------------------------------------------------------------------------------


def row_bound(facts: IterationFacts, problem: LCP, rows: slice = ALL) -> RowBound:
    """Return the bound of one sweep for these rows; L is what it has already updated (of 𝓜: what it takes)."""
    with np.errstate(all="ignore"):  # what overflows proves nothing
        if facts.family == PROJECTED_TYPE:
            return _projected_type(facts, problem, rows)
        if facts.family == PROJECTED_SPLITTING:
            theta, weight = scaled(facts, problem, rows)
            zero_case = Case(np.minimum(2.0, 4.0 * theta + 2.0), 2.0 * weight, 0.0)
            return RowBound(2.0 * theta + 2.0, weight, (zero_case, Case(2.0 * theta, 2.0 * weight, 2.0 * weight)))
        alpha, beta = numbers(facts)
        diagonal = problem.diagonal[rows]
        per_diagonal = 1.0 / (diagonal * inverse_residual_scale(problem.matrix)[rows])
        if facts.family == PROJECTED_RELAXATION:
            free = min(alpha, 2.0 - alpha)
            lower = (abs(alpha - beta) + abs(beta)) * per_diagonal
            return RowBound(1.0, abs(beta) * per_diagonal, (Case(free, lower, alpha * per_diagonal),))
        omega = np.ones(diagonal.size) if facts.omega is None else facts.omega[rows] / diagonal
        kept = min(alpha, 2.0 - alpha) + alpha * np.minimum(1.0, 2.0 * omega - 1.0)
        lower = (abs(alpha - beta) + alpha + abs(beta)) * per_diagonal
        case = Case(kept, lower, 2.0 * alpha * per_diagonal)
        return RowBound(alpha * omega + 1.0, abs(beta) * per_diagonal, (case,))


def _projected_type(facts: IterationFacts, problem: LCP, rows: slice) -> RowBound:
    alpha, beta = numbers(facts)
    g = beta / alpha
    theta, weight = scaled(facts, problem, rows)
    zero = Case(np.minimum(2.0, 2.0 * theta / alpha + 2.0 * theta + 2.0), 2.0 * abs(g) * weight, 0.0)
    one = Case(
        np.minimum(2.0 * theta, 2.0 * theta / alpha + 4.0), (abs(2.0 - g) + abs(g)) * weight, 2.0 * weight
    )
    return RowBound(theta / alpha + theta + 2.0, abs(g) * weight, (zero, one))


def scaled(facts: IterationFacts, problem: LCP, rows: slice = ALL) -> tuple[FloatVector, FloatVector]:
    """Return (θ, s divided by what the rows of the triangle sums are scaled with), one entry a row."""
    diagonal = problem.diagonal[rows]
    scaling = np.ones(diagonal.size) if facts.scaling is None else facts.scaling[rows]
    with np.errstate(all="ignore"):
        return scaling * diagonal, scaling / inverse_residual_scale(problem.matrix)[rows]


def numbers(facts: IterationFacts) -> tuple[float, float]:
    """Return (α, β); (1, 1) where they are found during the run, whose theorem is that of Gauss–Seidel."""
    return (
        1.0 if facts.relaxation is None else float(facts.relaxation),
        1.0 if facts.acceleration is None else float(facts.acceleration),
    )


def sums_for(facts: IterationFacts, problem: LCP, v: FloatVector) -> Sums:
    """Return the triangle sums of v that the row bound of a forward sweep asks for."""
    if facts.family != PROJECTED_SPLITTING:
        return triangle_sums(problem.matrix, v)
    all_of_m = np.add(*triangle_sums(problem.matrix, v))
    taken = np.add(*triangle_sums(problem.matrix, v, facts.splitting))
    return taken, np.maximum(all_of_m - taken, 0.0) + all_of_m * (longest_row(problem.matrix) * 2.0**-52)


def _directed(facts: IterationFacts, sums: Sums) -> list[Sums]:
    """Return the sums in the order of each pass of one iteration."""
    exchanged = sums[1], sums[0]
    passes = {"forward": [sums], "backward": [exchanged], "symmetric": [sums, exchanged]}
    return passes["forward" if facts.family == PROJECTED_SPLITTING else facts.sweep]


@dataclass(frozen=True, eq=False)
class Contraction:
    """A proof that one iteration contracts in ‖·‖_v; `rate` is None where it rounds to 1."""

    rate: float | None
    v: FloatVector = field(repr=False)
    is_unified: bool

    @property
    def sortable(self) -> float:
        """The rate, or 1."""
        return 1.0 if self.rate is None else self.rate


def contraction(facts: IterationFacts, problem: LCP, v: FloatVector, sums: Sums | None = None) -> Contraction | None:
    """Return the proof with these weights, or None where they prove nothing.

    Parameters
    ----------
    facts : IterationFacts
    problem : LCP
    v : array, shape (n,)
        Positive.
    sums : pair of arrays, shape (n,), optional
        :func:`sums_for` of v, where the caller has them.
    """
    if facts.family == PROJECTED_SPLITTING and not facts.is_part_of_matrix:
        return None  # (𝓜 + 2I + D)⁻¹ may be of any signs
    sums = sums_for(facts, problem, v) if sums is None else sums
    found = [_smallest_gap(facts, problem, v, order) for order in _directed(facts, sums)]
    if not min(found) > 0.0:
        return None
    rates = [rate_of(gap) for gap in found]
    rate = None if None in rates else math.prod(rate for rate in rates if rate is not None)
    if rate is not None and len(rates) > 1:
        rate = float(np.nextafter(rate, 2.0))
    return Contraction(rate, v, is_unified(facts, problem, v, sums))


def _smallest_gap(facts: IterationFacts, problem: LCP, v: FloatVector, sums: Sums) -> float:
    smallest, terms = 1.0, longest_row(problem.matrix)
    lost = underflow(v, terms)
    for rows in row_blocks(problem.n):
        bound = row_bound(facts, problem, rows)
        smallest = min(smallest, float(gaps(bound, v[rows], (sums[0][rows] + lost, sums[1][rows] + lost), terms).min()))
        if not smallest > 0.0:
            break
    return smallest


def is_unified(facts: IterationFacts, problem: LCP, v: FloatVector, sums: Sums) -> bool:
    """Return whether min(I, SD) − |SB| is proven an M-matrix by v, and 0 ≤ β ≤ α."""
    if facts.family not in (PROJECTED_TYPE, PROJECTED_SPLITTING):
        return False
    alpha, beta = numbers(facts)
    slop = (longest_row(problem.matrix) + 32) * 2.0**-52
    lost = underflow(v, longest_row(problem.matrix))
    for rows in row_blocks(problem.n) if 0.0 <= beta <= alpha else ():
        theta, weight = scaled(facts, problem, rows)
        with np.errstate(all="ignore"):
            load = weight * (sums[0][rows] + sums[1][rows] + 2.0 * lost)
            surplus = np.minimum(1.0, theta) * v[rows] - load - slop * (v[rows] + load)
        if not bool(np.all(surplus > 0.0)):
            return False
    return 0.0 <= beta <= alpha


def next_weights(facts: IterationFacts, problem: LCP, v: FloatVector, sums: Sums | None = None) -> FloatVector:
    """Return what |e| ≤ v may become in one sweep, shape (n,): weights with a better rate, or a refutation.

    Where it is ≥ v in every row, no weights at all give a contraction.
    """
    sums = sums_for(facts, problem, v) if sums is None else sums
    bound = row_bound(facts, problem)
    grown = [growth(bound, v, order) for order in _directed(facts, sums)]
    largest: FloatVector = np.maximum.reduce(grown)
    return largest
