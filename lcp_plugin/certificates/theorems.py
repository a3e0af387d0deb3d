"""The theorems by name and source: which one a proof is an instance of, and what the paper's own say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..problem.lcp import LCP
from .convergence import (
    MODULUS,
    PROJECTED_RELAXATION,
    PROJECTED_SPLITTING,
    Contraction,
    IterationFacts,
    numbers,
    scaled,
)

PAPER = "Kumar, Deepmala, Das"
PAPER_TITLE = "More on projected type iteration method and linear complementarity problem"
CRYER = "Cryer 1971, doi:10.1137/0309028; Mangasarian 1977, doi:10.1007/BF01268170"
BAI = "Bai 2010, doi:10.1002/nla.680"
LEVITIN = "Levitin, Polyak 1966, doi:10.1016/0041-5553(66)90114-5"
ULPS = 4.0 * 2.0**-52  # s = 1/d is rounded, also where it is subnormal


def theorem_of(facts: IterationFacts, problem: LCP, proof: Contraction) -> str:
    """Return the name and source of the theorem that the proof is an instance of."""
    if facts.family == PROJECTED_RELAXATION:
        if facts.relaxation is None:
            return (
                "trials of a larger ω are undone where they do not pay, so it converges wherever projected "
                f"Gauss–Seidel does, and M is an H₊-matrix ({CRYER})"
            )
        return f"M is an H₊-matrix and |1 − ω| + (|ω − β| + |β|)ℓ + ωu < 1, as for 0 ≤ β ≤ ω < 2/(1 + ρ) ({CRYER})"
    if facts.family == MODULUS:
        small = (facts.relaxation or 0.0) <= 1.0
        what = "min(Ω, D) − |B| is an M-matrix" if small else "α(ℓ + u) < 1, as for Ω ≥ D and α < 1/ρ"
        return f"M is an H₊-matrix and {what} ({BAI})"
    theta, _ = scaled(facts, problem)
    if proof.is_unified and facts.is_scaled and bool(np.all(theta <= 1.0 + ULPS)):
        return f"M is an H₊-matrix, its rows scaled so that SD ≤ I (Theorem 4.2 of {PAPER}, in one form for all D)"
    if proof.is_unified:
        return f"min(I, SD) − |SB| is an M-matrix (Theorem 4.2 of {PAPER}, in one form for all D)"
    if facts.family == PROJECTED_SPLITTING:
        return f"θ t < 1 and ℓ + u < 1 (Theorem 4.1 of {PAPER}, row by row)"
    return f"θ(ℓ + u) < min(θ, θ/α + 2) and (β/α)θℓ < 1 (sharper than Theorem 4.2 of {PAPER}, row by row)"


def positive_definite_theorem(facts: IterationFacts, largest_sum: float) -> str | None:
    """Return the theorem that covers the iteration on a symmetric positive definite M, or None.

    Parameters
    ----------
    facts : IterationFacts
    largest_sum : float
        An upper bound of ℓ + u for some v > 0.
    """
    if facts.family != PROJECTED_RELAXATION:
        return None
    omega, beta = numbers(facts)
    if facts.relaxation is None:
        return (
            "trials of a larger ω are undone where they do not pay, so it converges wherever projected Gauss–Seidel "
            f"does, and M is symmetric positive definite ({CRYER})"
        )
    if omega == beta and 0.0 < omega * (1.0 + ULPS) < 2.0:
        return f"M is symmetric positive definite and 0 < ω < 2 ({CRYER})"
    if beta == 0.0 and omega * (1.0 + largest_sum) < 2.0:
        return (
            "M is symmetric positive definite and ω λ_max(D⁻¹M) < 2: a projected gradient step in the norm of D "
            f"({LEVITIN})"
        )
    return None


def theorem_4_2(facts: IterationFacts, problem: LCP, bounds: Sequence[float], is_h_plus: bool) -> tuple[bool, str]:
    """Return whether the paper's Theorem 4.2 as stated covers the unscaled iteration, and a sentence that says so.

    Parameters
    ----------
    facts : IterationFacts
        Of a projected-type iteration without row scaling.
    problem : LCP
    bounds : (lower, upper)
        Of ρ(|L + U|).
    is_h_plus : bool
        Whether M is proven to be an H₊-matrix.
    """
    alpha, beta = numbers(facts)
    lower, upper = bounds
    between = f"{lower:.3g} … {upper:.3g}"
    number = f"ρ|L+U| = {(lower + upper) / 2.0:.3g}" if upper - lower <= 0.004 * upper else f"ρ|L+U| in {between}"
    diagonal = problem.diagonal
    premise = 0.0 <= beta <= alpha <= 1.0
    if not is_h_plus:
        return False, "not covered by Theorem 4.2 as stated (M is not proven to be an H₊-matrix)"
    case = 1 if np.all(diagonal >= 1.0) and upper < 1.0 else 2 if np.all(diagonal < 1.0) else 0
    if case and premise:
        return True, f"covered by Theorem 4.2 as stated, case {case} ({number})"
    reason = number if not case else "its splitting needs ⟨M⟩ = ⟨𝓜⟩ − |𝓝|, that is 0 ≤ β ≤ α ≤ 1"
    is_mixed = not (np.all(diagonal >= 1.0) or np.all(diagonal < 1.0))
    reason += "; neither D ≥ I nor D < I" if is_mixed else ""
    hindered = "; its premise ⟨M⟩ = ⟨𝓜⟩ − |𝓝| needs 0 ≤ β ≤ α ≤ 1 besides" if not premise and not case else ""
    return False, f"not covered by Theorem 4.2 as stated ({reason}); covered after diagonal scaling{hindered}"
