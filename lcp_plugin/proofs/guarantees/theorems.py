"""The theorems by name and source: the theorem behind a proof, and the theorems of the paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON, TINY
from ...core.lcp import LCP
from ...core.matrix.iteration_facts import (
    MODULUS,
    PROJECTED_RELAXATION,
    PROJECTED_SPLITTING,
    IterationFacts,
)
from .convergence import numbers
from .radius import jacobi_spectral_radius, spectral_radius

PAPER = "Kumar, Deepmala, Das"
PAPER_TITLE = "More on projected type iteration method and linear complementarity problem"
CRYER = "Cryer 1971, doi:10.1137/0309028; Mangasarian 1977, doi:10.1007/BF01268170"
BAI = "Bai 2010, doi:10.1002/nla.680"
LEVITIN = "Levitin, Polyak 1966, doi:10.1016/0041-5553(66)90114-5"
GUARANTEED, NOT_COVERED = "guaranteed", "not covered"
AUTOMATIC = (
    "trials of a larger ω are undone where they do not pay, so it converges wherever projected Gauss–Seidel does, and "
    f"M is {{}} ({CRYER})"
)
ULPS = 4.0 * EPSILON  # s = 1/d is rounded, also if it is subnormal
FloatMatrix = np.ndarray[Any, np.dtype[np.float64]]


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
    paper : str
        Verdict of the paper's original Theorem 4.2, for its methods without row scaling.
    speaks_of : {"z", "x"}
        The rate of a modulus method is one of its x, z = lower + max(x, 0):
        ‖z_k − z*‖_v ≤ cᵏ ‖x_0 − x*‖_v with x* = z* − lower − Ω⁻¹w*.
    facts, problem : IterationFacts and LCP, or None
        The iteration of `spectral_radius`; None if the method is not a splitting.
    """

    verdict: str
    theorem: str
    rate: float | None = None
    v: FloatVector | None = field(default=None, repr=False)
    remedy: str = ""
    paper: str = ""
    speaks_of: str = "z"
    facts: IterationFacts | None = field(default=None, repr=False)
    problem: LCP | None = field(default=None, repr=False)

    @cached_property
    def spectral_radius(self) -> float | None:
        """ρ(T) of the matrix T ≥ 0 with |z_{k+1} − z*| ≤ T |z_k − z*|, a float without proof, computed on first access.

        ρ of the iteration matrix itself may be less. None if the method is not a splitting, for a symmetric sweep,
        and for more than 1000 unknowns.
        """
        if self.facts is None or self.problem is None:
            return None
        return spectral_radius(self.problem, self.facts)

    @cached_property
    def jacobi_radius(self) -> float | None:
        """ρ(|J|), J = D⁻¹(L + U); below 1 only on H₊-matrices."""
        return None if self.problem is None else jacobi_spectral_radius(self.problem)

    @property
    def is_guaranteed(self) -> bool:
        """True if convergence is proven."""
        return self.verdict == GUARANTEED

    def __str__(self) -> str:
        speed = ""
        if self.rate is not None:
            speed = (
                f"; an iteration contracts by {_rounded_up(self.rate)} in a weighted maximum norm"
            )
            speed += "" if self.speaks_of == "z" else f" of {self.speaks_of}"
        lines = [f"{self.verdict}: {self.theorem}{speed}"]
        lines += [f"remedy: {self.remedy}"] if self.remedy else []
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


def theorem_of(facts: IterationFacts) -> str:
    """Return the name and source of the theorem that a row bound is an instance of."""
    if facts.family == PROJECTED_RELAXATION:
        if facts.relaxation is None:
            return AUTOMATIC.format("an H₊-matrix")
        return f"M is an H₊-matrix and |1 − ω| + (|ω − β| + |β|)ℓ + ωu < 1, as for 0 ≤ β ≤ ω < 2/(1 + ρ) ({CRYER})"
    if facts.family == MODULUS:
        return f"M is an H₊-matrix and min(Ω, D) − |B| is an M-matrix or α(ℓ + u) < 1 ({BAI})"
    if facts.family == PROJECTED_SPLITTING:
        return f"θ t < 1 and ℓ + u < 1 (Theorem 4.1 of {PAPER}, row by row)"
    return f"θ(ℓ + u) < min(θ, θ/α + 2) and (β/α)θℓ < 1 (Theorem 4.2 of {PAPER}, row by row in one form for all D)"


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
        return AUTOMATIC.format("symmetric positive definite")
    if omega == beta and 0.0 < omega * (1.0 + ULPS) < 2.0:
        return f"M is symmetric positive definite and 0 < ω < 2 ({CRYER})"
    if beta == 0.0 and omega * (1.0 + largest_sum) < 2.0:
        return (
            "M is symmetric positive definite and ω λ_max(D⁻¹M) < 2: a projected gradient step in the norm of D "
            f"({LEVITIN})"
        )
    return None


def theorem_4_2(
    facts: IterationFacts, problem: LCP, bounds: Sequence[float], is_h_plus: bool
) -> str:
    """Return whether the paper's original Theorem 4.2 covers the unscaled iteration, as a sentence with the reason.

    Parameters
    ----------
    facts : IterationFacts
        Facts of a projected-type iteration without row scaling.
    problem : LCP
    bounds : (lower, upper)
        Bounds of ρ(|L + U|).
    is_h_plus : bool
        Whether M is proven to be an H₊-matrix.
    """
    if not is_h_plus:
        return "not covered by the original Theorem 4.2 (M is not proven to be an H₊-matrix)"
    (alpha, beta), (lower, upper), diagonal = numbers(facts), bounds, problem.diagonal
    is_close = upper - lower <= 0.004 * upper
    number = f"= {(lower + upper) / 2.0:.3g}" if is_close else f"in {lower:.3g} … {upper:.3g}"
    is_large, is_small = bool((diagonal >= 1.0).all()), bool((diagonal < 1.0).all())
    case = 1 if is_large and upper < 1.0 else 2 if is_small else 0
    reasons = [f"ρ|L+U| {number}"] if not case else []
    if not (is_large or is_small):
        reasons.append("neither D ≥ I nor D < I")
    if not 0.0 <= beta <= alpha <= 1.0:
        reasons.append("its splitting needs ⟨M⟩ = ⟨𝓜⟩ − |𝓝|, that is 0 ≤ β ≤ α ≤ 1")
    if not reasons:
        return f"covered by the original Theorem 4.2, case {case} (ρ|L+U| {number})"
    return (
        f"not covered by the original Theorem 4.2 ({'; '.join(reasons)}); covered after diagonal "
        "scaling"
    )


def theorem_4_1(M: FloatMatrix, splitting: FloatMatrix) -> tuple[float, FloatVector] | None:
    """Return (c, v) with T v ≤ c v, c < 1, v > 0 for the T of Method 3.1, or None if no such v was found.

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
    right = (
        np.abs(splitting - M + identity + D)
        + np.abs(M - identity)
        + 16.0 * EPSILON * sizes
        + 8.0 * TINY
    )
    uncertain = np.abs(P) + np.abs(splitting) + np.abs(D)
    error = np.abs(identity - P @ X) + unit * ((uncertain + TINY) @ np.abs(X) + identity) + n * TINY
    spread = float(error.sum(axis=1).max(initial=0.0))
    if not spread < 0.5:
        return None
    v = np.ones(n)
    for _ in range(60):
        grown = np.abs(X) @ (right @ v)
        v = 0.5 * (v + grown / grown.max(initial=1e-300)) if np.isfinite(grown).all() else v
    bounded = _inverse_bound(np.abs(X), error, spread, (right @ v) * (1.0 + unit)) * (
        1.0 + 4.0 * unit
    )
    rate = float(np.max(bounded / v, initial=0.0))
    return (float(np.nextafter(rate, 2.0)), v) if rate < 1.0 - EPSILON else None


def _inverse_bound(
    size_of_inverse: FloatMatrix, error: FloatMatrix, spread: float, b: FloatVector
) -> FloatVector:
    """Return |X|(b + |E|b + …), the tail of the series bounded by its norm."""
    tail = spread * spread / (1.0 - spread) * b.max(initial=0.0)
    bound: FloatVector = size_of_inverse @ (b + error @ b + tail)
    return bound
