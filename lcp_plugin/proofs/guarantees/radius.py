"""The spectral radius of the matrix that bounds an iteration's errors, the number that papers print.

Each iteration of these families satisfies |z_{k+1} − z*| ≤ T |z_k − z*| in every component, with a nonnegative T:

    projected type        T = |P⁻¹| (|𝓜 − M + I + D| + |M − I|),  P = 𝓜 + 2I + D   (the paper's Theorem 4.1)
    projected relaxation  T = (I − |βL|)⁻¹ (|1 − ω| I + |ω − β| |L| + |ω U|),  of M scaled to unit diagonal
    modulus               T = |(𝓜 + Ω)⁻¹| (|𝓜 − M| + |Ω − M|), for x

ρ(T) < 1 makes the iteration converge from every start. ρ of the iteration matrix itself may be less. ρ(T) is a
float, not a proof. The proof is `rate`, whose bound is tighter than the paper's T if rows are not scaled.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.lcp import LCP
from ...core.matrix.iteration_facts import (
    MODULUS,
    PROJECTED_RELAXATION,
    PROJECTED_SPLITTING,
    IterationFacts,
)
from ...systems.comparison import nonnegative_radius
from .convergence import numbers

DENSE_UP_TO = (
    1000  # unknowns: two seconds; beyond, products with a T so far from normal give few digits
)


def spectral_radius(problem: LCP, facts: IterationFacts) -> float | None:
    """Return ρ(T) of an iteration; None of a symmetric sweep, and of more than 1000 unknowns."""
    if problem.n > DENSE_UP_TO or (
        facts.sweep == "symmetric" and facts.family != PROJECTED_SPLITTING
    ):
        return None
    T = bound_of_errors(problem, facts)
    return (
        None
        if T is None or not np.isfinite(T).all()
        else float(np.abs(np.linalg.eigvals(T)).max(initial=0.0))
    )


def jacobi_spectral_radius(problem: LCP) -> float:
    """Return ρ(|J|), J = D⁻¹(L + U) the Jacobi iteration matrix; ∞ if a diagonal entry is 0."""
    if not problem.diagonal.all():
        return np.inf
    beside = abs(problem.csr - sp.diags_array(problem.diagonal))
    return float(
        np.mean(
            nonnegative_radius(
                sp.csr_array(sp.diags_array(1.0 / np.abs(problem.diagonal)) @ beside)
            )
        )
    )


def bound_of_errors(problem: LCP, facts: IterationFacts) -> Any:
    """Return T, shape (n, n), dense; None if P is singular."""
    M, n = problem.csr, problem.n
    alpha, beta = numbers(facts)
    eye, is_backward = sp.eye_array(n, format="csr"), facts.sweep == "backward"
    if facts.family == PROJECTED_RELAXATION:
        unit = sp.csr_array(sp.diags_array(1.0 / problem.diagonal) @ M)
        below, above = sp.tril(unit, -1, format="csr"), sp.triu(unit, 1, format="csr")
        below, above = (above, below) if is_backward else (below, above)
        right = abs(1.0 - alpha) * eye + abs(alpha - beta) * abs(below) + abs(alpha) * abs(above)
        return _solved(sp.csr_array(eye - abs(beta) * abs(below)), sp.csr_array(right))
    scaling = np.ones(n) if facts.scaling is None else facts.scaling
    scaled = sp.csr_array(sp.diags_array(scaling) @ M)
    D = sp.diags_array(scaled.diagonal(), format="csr")
    if facts.family == PROJECTED_SPLITTING:
        splitting = sp.csr_array(sp.diags_array(scaling) @ facts.splitting)
    else:
        part = (
            sp.triu(scaled, 1, format="csr") if is_backward else sp.tril(scaled, -1, format="csr")
        )
        splitting = sp.csr_array((D + beta * part) / alpha)
    if facts.family == MODULUS:
        omega = sp.diags_array(np.asarray(facts.omega), format="csr")
        P, right = splitting + omega, abs(splitting - scaled) + abs(omega - scaled)
    else:
        P, right = splitting + 2.0 * eye + D, abs(splitting - scaled + eye + D) + abs(scaled - eye)
    return _solved(sp.csr_array(P), sp.csr_array(right))


def _solved(P: Any, right: Any) -> Any:
    """Return |P⁻¹| right, None if P is singular."""
    try:
        return np.abs(np.linalg.inv(P.toarray())) @ right.toarray()
    except np.linalg.LinAlgError:
        return None
