"""convergence_guarantee(): what is proven about an algorithm on a matrix.

Every rate here is the rate of a contraction in ‖x‖_v = max |x_i|/v_i, between any two points, so that it also proves
existence and uniqueness of the solution. One argument covers all bounds of a row. The residual
z − mid(lower, upper, z − S w) changes, row by row, by (1 − τ)e + τ S M e with some τ in [0, 1] (τ = 1 on a free row).
The projection of a component onto its bounds, which contain z*, never increases its distance from z*. A bound that is
convex in τ holds if it holds for τ = 0 and τ = 1. So boxes, free rows and the projection within a sweep cost nothing.

θ = s_i m_ii, ℓ = |L|v/(d v), u = |U|v/(d v), g = β/α; L is the part that the sweep has already updated (a backward
sweep exchanges L and U; a symmetric sweep is the product of both). The pivots p and the two cases:

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
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ..core.algorithm import (
    MODULUS,
    PROJECTED_RELAXATION,
    PROJECTED_SPLITTING,
    PROJECTED_TYPE,
    Algorithm,
    IterationFacts,
)
from ..core.checks import FloatMatrix, Vector, read_only
from ..core.errors import UnsuitableMatrix, UnsuitableProblem
from ..core.kernels.floats import EPSILON, FEW_ROUNDINGS, TINY, UNDERFLOW
from ..core.lcp import LCP
from ..core.sweep_data import inverse_residual_scale, triangle_sums, unit_triangle_sums
from ..core.tuning import CHEAP_UP_TO
from .verdicts import MatrixReport, comparison_certificate, h_plus

Weights = Vector | float


class RowCase(NamedTuple):
    """Row bound: free = p − A, and the weights b + f of |L|v and u of |U|v."""

    free: Weights
    lower: Weights
    upper: Weights


class RowBound(NamedTuple):
    """Effect of one sweep on an error: p and f, shape (n,) or numbers; a row may be in any of the cases."""

    pivot: Weights
    feedback: Weights
    cases: tuple[RowCase, ...]


# --- row bounds ------------------------------------------------------------------------------------------


def row_bound(facts: IterationFacts, problem: LCP) -> RowBound:
    """Return the bound of one sweep; L is the already updated part (for 𝓜: its entries)."""
    (alpha, beta), diagonal = relaxation_numbers(facts), problem.diagonal
    scaling = np.ones(problem.n) if facts.scaling is None else facts.scaling
    theta, weight = scaling * diagonal, scaling / inverse_residual_scale(problem.matrix)
    if facts.family == PROJECTED_SPLITTING:
        held = RowCase(np.minimum(2.0, 4.0 * theta + 2.0), 2.0 * weight, 0.0)
        between = RowCase(2.0 * theta, 2.0 * weight, 2.0 * weight)
        return RowBound(2.0 * theta + 2.0, weight, (held, between))
    if facts.family == PROJECTED_TYPE:
        g, over = beta / alpha, theta / alpha
        held = RowCase(np.minimum(2.0, 2.0 * over + 2.0 * theta + 2.0), 2.0 * abs(g) * weight, 0.0)
        at_one = np.minimum(2.0 * theta, 2.0 * over + 4.0)
        between = RowCase(at_one, (abs(2.0 - g) + abs(g)) * weight, 2.0 * weight)
        return RowBound(over + theta + 2.0, abs(g) * weight, (held, between))
    per_diagonal = 1.0 / (diagonal * inverse_residual_scale(problem.matrix))
    free, feedback = min(alpha, 2.0 - alpha), abs(beta) * per_diagonal
    if facts.family == PROJECTED_RELAXATION:
        lower = (abs(alpha - beta) + abs(beta)) * per_diagonal
        return RowBound(1.0, feedback, (RowCase(free, lower, alpha * per_diagonal),))
    omega = np.ones(diagonal.size) if facts.omega is None else facts.omega / diagonal
    lower = (abs(alpha - beta) + alpha + abs(beta)) * per_diagonal
    kept = free + alpha * np.minimum(1.0, 2.0 * omega - 1.0)
    case = RowCase(kept, lower, 2.0 * alpha * per_diagonal)
    return RowBound(alpha * omega + 1.0, feedback, (case,))


def relaxation_numbers(facts: IterationFacts) -> tuple[float, float]:
    """Return (α, β); (1, 1) if they are determined during the run, which has the theorem of Gauss–Seidel."""
    alpha, beta = facts.relaxation, facts.acceleration
    return 1.0 if alpha is None else float(alpha), 1.0 if beta is None else float(beta)


#: A rate, None if it rounds to 1, and the weights v of ‖·‖_v, None without a rate.
Contraction = tuple[float | None, Vector | None]


def contraction(facts: IterationFacts, problem: LCP, v: Vector) -> Contraction | None:
    """Return the proof with these weights, or None if they prove nothing.

    Parameters
    ----------
    facts : IterationFacts
    problem : LCP
    v : array, shape (n,)
        Positive.
    """
    has_splitting = facts.family == PROJECTED_SPLITTING
    if has_splitting and not facts.is_part_of_matrix:
        return None  # (𝓜 + 2I + D)⁻¹ may be of any signs
    sums = triangle_sums(problem.matrix, v)
    terms = int(np.diff(problem.csr.indptr).max(initial=0))
    if has_splitting:
        all_of_m, taken = np.add(*sums), np.add(*triangle_sums(problem.matrix, v, facts.splitting))
        sums = taken, np.maximum(all_of_m - taken, 0.0) + all_of_m * (terms * EPSILON)
    exchanged = sums[1], sums[0]
    passes = {"forward": [sums], "backward": [exchanged], "symmetric": [sums, exchanged]}
    bound = row_bound(facts, problem)
    # a bound of the underflow in a difference of two triangle sums of v
    lost = 4.0 * terms * (1.0 + float(v.max(initial=0.0))) * TINY
    pairs = passes["forward" if has_splitting else facts.sweep]
    with_lost = ((updated + lost, remaining + lost) for updated, remaining in pairs)
    least_gaps = [float(gaps(bound, v, pair, terms).min(initial=1.0)) for pair in with_lost]
    if not min(least_gaps) > 0.0:
        return None
    # an upper bound of each contraction; a sweep that moves nothing has the rate 0
    rates = [float(np.nextafter(1.0 - gap, 2.0)) if gap < 1.0 else 0.0 for gap in least_gaps]
    if max(rates) >= 1.0:
        return None, None
    rate = math.prod(rates)
    return (float(np.nextafter(rate, 2.0)) if len(rates) > 1 else rate), read_only(v.copy())


# --- gaps of a row bound, evaluated so that rounding cannot flatter them ----------------------------------


def gaps(bound: RowBound, v: Vector, sums: tuple[Vector, Vector], terms: int) -> Vector:
    """Return lower bounds of 1 − c_i, shape (n,), −∞ if no bound exists.

    Parameters
    ----------
    bound : RowBound
    v : array, shape (n,)
        Positive.
    sums : pair of arrays, shape (n,)
        Upper bounds of |L|v of what is already updated and |U|v of the rest except for the rounding of `terms`
        additions.

    Notes
    -----
    free = p − A is a difference of numbers no larger than p, and the sweep divides by a pivot that is rounded itself:
    its rounding error is measured relative to p.
    """
    updated, remaining = sums
    slop = (terms + 32) * EPSILON
    smallest = np.full(v.size, np.inf)
    size = bound.pivot * v
    scale = (size - bound.feedback * updated) * (1.0 + slop) + 2.0 * slop * bound.feedback * updated
    for case in bound.cases:
        load = case.lower * updated + case.upper * remaining
        surplus = (case.free * v - load) - slop * (size + load) - UNDERFLOW
        np.minimum(smallest, surplus / scale, out=smallest)
    usable = (scale > 0.0) & np.isfinite(scale) & (v > 0.0) & np.isfinite(v)
    smallest = smallest - FEW_ROUNDINGS * np.abs(smallest)
    return np.where(usable & ~np.isnan(smallest), np.minimum(smallest, 1.0), -np.inf)


AUTHORS = "Kumar, Deepmala, Das"
CRYER = "Cryer 1971, doi:10.1137/0309028; Mangasarian 1977, doi:10.1007/BF01268170"
BAI = "Bai 2010, doi:10.1002/nla.680"
LEVITIN = "Levitin, Polyak 1966, doi:10.1016/0041-5553(66)90114-5"
GUARANTEED, NOT_COVERED = "guaranteed", "not covered"
AUTOMATIC = (
    "trials of a larger ω are undone where they do not pay, so it converges wherever projected Gauss–Seidel does, and "
    f"M is {{}} ({CRYER})"
)
MOMENTUM = (
    "{}; cycles of momentum are undone where the step does not fall, so it converges wherever the plain iteration "
    "contracts (momentum=None has a rate)"
)


@dataclass(frozen=True, eq=False)
class Guarantee:
    """Convergence guarantee of an algorithm on a matrix, for all q and all bounds.

    Attributes
    ----------
    verdict : {"guaranteed", "not covered"}
        Convergence from every start is proven; or nothing is proven here.
    theorem : str
        The theorem and its source, or the missing condition.
    rate : float or None
        c < 1 with ‖z_{k+1} − z*‖_v ≤ c ‖z_k − z*‖_v for every k; of x if `speaks_of` is "x". So
        |z_k − z*| ≤ c/(1 − c) ‖z_k − z_{k−1}‖_v v, in exact arithmetic.
    v : array, shape (n,), or None
        The weights of that norm, positive.
    remedy : str
        Remedy if convergence is not guaranteed.
    speaks_of : {"z", "x"}
        The rate of a modulus method is a rate of its x, z = lower + max(x, 0):
        ‖z_k − z*‖_v ≤ cᵏ ‖x_0 − x*‖_v with x* = z* − lower − Ω⁻¹w*.
    facts : IterationFacts or None
        Parameters of the iteration; None if the method is not a splitting.
    """

    verdict: str
    theorem: str
    rate: float | None = None
    v: Vector | None = field(default=None, repr=False)
    remedy: str = ""
    speaks_of: str = "z"
    facts: IterationFacts | None = field(default=None, repr=False)

    @property
    def is_guaranteed(self) -> bool:
        """True if convergence is proven."""
        return self.verdict == GUARANTEED

    def __str__(self) -> str:
        speed = "" if self.rate is None else f"; an iteration contracts by {rounded_up(self.rate)}"
        speed += " in a weighted maximum norm" * bool(speed)
        speed += f" of {self.speaks_of}" * bool(speed and self.speaks_of != "z")
        remedy = self.remedy and f"remedy: {self.remedy}"
        first = f"{self.verdict}: {self.theorem}{speed}"
        return "\n".join(filter(None, (first, remedy)))


def rounded_up(rate: float) -> str:
    """Return the rate rounded up to three digits after the nines.

    Examples
    --------
    >>> rounded_up(0.81234), rounded_up(0.999871234)
    ('0.813', '0.999872')
    """
    places = 3 + max(0, -math.ceil(math.log10(1.0 - rate))) if rate < 1.0 else 17
    text = f"{math.ceil(rate * 10.0**places) / 10.0**places:.{min(places, 17)}f}"
    return text if float(text) < 1.0 else f"1 − {1.0 - rate:.1e}"


def theorem_of(facts: IterationFacts) -> str:
    """Return the name and source of the theorem that a row bound is an instance of."""
    if facts.family == PROJECTED_RELAXATION:
        if facts.relaxation is None:
            return AUTOMATIC.format("an H₊-matrix")
        return f"M is an H₊-matrix and |1 − ω| + (|ω − β| + |β|)ℓ + ωu < 1, as for 0 ≤ β ≤ ω < 2/(1 + ρ) ({CRYER})"
    if facts.family == MODULUS:
        return f"M is an H₊-matrix and min(Ω, D) − |B| is an M-matrix or α(ℓ + u) < 1 ({BAI})"
    if facts.family == PROJECTED_SPLITTING:
        return f"θ t < 1 and ℓ + u < 1 (Theorem 4.1 of {AUTHORS}, row by row)"
    return f"θ(ℓ + u) < min(θ, θ/α + 2) and (β/α)θℓ < 1 (Theorem 4.2 of {AUTHORS}, row by row in one form for all D)"


def theorem_4_1(M: FloatMatrix, splitting: FloatMatrix) -> tuple[float, Vector] | None:
    """Return (c, v) with T v ≤ c v, c < 1, v > 0 for the T of Method 3.1, or None without such a v.

    Parameters
    ----------
    M, splitting : arrays, shape (n, n)
        SM and S𝓜, dense, each entry right to two units in the last place.

    Notes
    -----
    T = |(𝓜 + 2I + D)⁻¹| (|𝓝 + I + D| + |M − I|), 𝓝 = 𝓜 − M. The error of one step is multiplied by a matrix that T
    bounds in every entry: (𝓜 + 2I + D)⁻¹ ((𝓝 + I + D) + (2τ − 1)(I − M)), τ_i in [0, 1]. So with boxes, free rows
    and the projection after the step ‖z⁺ − z*‖_v ≤ c ‖z − z*‖_v. The inverse X is LAPACK's; with PX = I − E,
    |P⁻¹| b ≤ |X| (I − |E|)⁻¹ b, all rounding counted.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, Theorem 4.1.

    Examples
    --------
    >>> rate, v = theorem_4_1(np.array([[1.0, -0.5], [-0.5, 1.0]]), np.eye(2))
    >>> round(rate, 6), v.size
    (0.75, 2)
    """
    n = M.shape[0]
    if not (np.isfinite(M).all() and np.isfinite(splitting).all()):
        return None
    identity, D = np.eye(n), np.diag(np.diag(M))
    unit = (n + 16) * EPSILON
    P = splitting + 2.0 * identity + D
    try:
        X = np.linalg.inv(P)
    except np.linalg.LinAlgError:
        return None
    sizes = np.abs(splitting) + np.abs(M) + identity + np.abs(D)
    right = np.abs(splitting - M + identity + D) + np.abs(M - identity)
    right = right + 16.0 * EPSILON * sizes + 8.0 * TINY
    uncertain = np.abs(P) + np.abs(splitting) + np.abs(D)
    error = np.abs(identity - P @ X) + unit * ((uncertain + TINY) @ np.abs(X) + identity) + n * TINY
    spread = float(error.sum(axis=1).max(initial=0.0))
    if not spread < 0.5:
        return None
    v = np.ones(n)
    for _ in range(60):
        grown = np.abs(X) @ (right @ v)
        v = 0.5 * (v + grown / grown.max(initial=1e-300)) if np.isfinite(grown).all() else v
    # |X|(b + |E|b + …), the tail of the series bounded by its norm
    b = (right @ v) * (1.0 + unit)
    tail = spread * spread / (1.0 - spread) * b.max(initial=0.0)
    bounded = np.abs(X) @ (b + error @ b + tail) * (1.0 + 4.0 * unit)
    rate = float(np.max(bounded / v, initial=0.0))
    return (float(np.nextafter(rate, 2.0)), v) if rate < 1.0 - EPSILON else None


@np.errstate(all="ignore")
def guarantee_of(problem: LCP, algorithm: Algorithm) -> Guarantee:
    """Return the guarantee of an algorithm on the matrix of a problem; see `convergence_guarantee`."""
    if problem.n == 0:
        return Guarantee(GUARANTEED, "the problem has no rows")
    try:
        facts = algorithm.facts(problem)
        theorem = algorithm.theorem(problem, MatrixReport(problem)) if facts is None else None
    except (UnsuitableMatrix, UnsuitableProblem) as error:
        return Guarantee(NOT_COVERED, "it cannot run on this problem", remedy=str(error))
    if theorem is not None:
        return Guarantee(GUARANTEED, theorem)
    if facts is None:
        about = f"no theorem here is about {algorithm.name} on such a problem"
        return Guarantee(NOT_COVERED, about)
    guarantee = replace(_full(problem, facts), facts=facts)
    if not (facts.has_momentum and guarantee.is_guaranteed):
        return guarantee
    return replace(guarantee, theorem=MOMENTUM.format(guarantee.theorem), rate=None, v=None)


def _full(problem: LCP, facts: IterationFacts) -> Guarantee:
    proof = _row_proof(problem, facts)
    if proof is not None:
        is_automatic = facts.relaxation is None and facts.family == PROJECTED_RELAXATION
        rate, v = (None, None) if is_automatic else proof
        speaks_of = "x" if facts.family == MODULUS else "z"
        return Guarantee(GUARANTEED, theorem_of(facts), rate, v, speaks_of=speaks_of)
    if facts.family == PROJECTED_SPLITTING and problem.n <= CHEAP_UP_TO:
        scaling: Any = 1.0 if facts.scaling is None else facts.scaling[:, None]
        splitting: Any = facts.splitting
        bound = theorem_4_1(scaling * problem.csr.toarray(), scaling * splitting.toarray())
        if bound is not None:
            known = f"ρ(T) < 1, certified by a vector (Theorem 4.1 of {AUTHORS})"
            return Guarantee(GUARANTEED, known, *bound)
    theorem = _positive_definite(problem, facts)
    if theorem is not None:
        return Guarantee(GUARANTEED, theorem)
    is_h_plus = h_plus(problem.matrix).value
    missing = "M is not proven to be an H₊-matrix"
    if facts.family == PROJECTED_SPLITTING and problem.n > CHEAP_UP_TO:
        missing = f"Theorem 4.1's ρ(T) is not computed for n > {CHEAP_UP_TO}"
    elif is_h_plus:
        missing = "M is an H₊-matrix, but no theorem covers these options (or only by less than rounding error)"
    elif facts.family == PROJECTED_RELAXATION:
        missing = "M is proven neither to be an H₊-matrix nor to be symmetric positive definite"
    remedy = 'no theorem covers this M; algorithm="auto" tries several methods'
    if is_h_plus or _is_positive_definite(problem):
        remedy = 'algorithm="psor" converges on this M'
    return Guarantee(NOT_COVERED, missing, remedy=remedy)


def _row_proof(problem: LCP, facts: IterationFacts) -> Contraction | None:
    """Return a contraction with the weights v of the H₊ certificate, or with 1 + v/(2‖v‖∞), or None.

    Every row bound implies ⟨M⟩v > 0 and a positive diagonal. Nearly equal weights help a row at its bound (τ = 0),
    whose sweep needs no margin of ⟨M⟩v but a small |L|v.
    """
    if h_plus(problem.matrix).value is False:
        return None
    certificate = comparison_certificate(problem.matrix)
    v = np.ones(problem.n) if certificate is None else certificate.v
    nearly_equal = 1.0 + 0.5 * v / v.max(initial=0.0)
    return contraction(facts, problem, v) or contraction(facts, problem, nearly_equal)


def _positive_definite(problem: LCP, facts: IterationFacts) -> str | None:
    """Return the theorem on positive definite matrices that covers it; M is factorized only if that is possible."""
    if facts.family != PROJECTED_RELAXATION:
        return None
    omega, beta = relaxation_numbers(facts)
    scaled_diagonal = problem.diagonal * inverse_residual_scale(problem.matrix)
    sums = np.add(*unit_triangle_sums(problem.matrix)) / scaled_diagonal
    largest_sum = float(np.max(sums, initial=0.0)) * (1.0 + 1e-12)  # above ℓ + u for v = 1
    if facts.relaxation is None:
        theorem = AUTOMATIC.format("symmetric positive definite")
    elif omega == beta and 0.0 < omega * (1.0 + FEW_ROUNDINGS) < 2.0:
        theorem = f"M is symmetric positive definite and 0 < ω < 2 ({CRYER})"
    elif beta == 0.0 and omega * (1.0 + largest_sum) < 2.0:
        theorem = (
            "M is symmetric positive definite and ω λ_max(D⁻¹M) < 2: a projected gradient step in the norm of D "
            f"({LEVITIN})"
        )
    else:
        return None
    return theorem if _is_positive_definite(problem) else None


def _is_positive_definite(problem: LCP) -> bool:
    report = MatrixReport(problem)
    return bool(report.is_symmetric and report.is_positive_definite)
