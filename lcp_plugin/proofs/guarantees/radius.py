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
    unit = abs(sp.diags_array(1.0 / problem.diagonal) @ problem.csr)
    unit.setdiag(0.0)
    return float(np.mean(nonnegative_radius(sp.csr_array(unit))))


def bound_of_errors(problem: LCP, facts: IterationFacts) -> Any:
    """Return T, shape (n, n), dense; None if P is singular."""
    (alpha, beta), eye = numbers(facts), np.eye(problem.n)
    is_relaxation = facts.family == PROJECTED_RELAXATION
    scaling = 1.0 / problem.diagonal if is_relaxation else facts.scaling
    M = problem.csr.toarray() * (1.0 if scaling is None else np.reshape(scaling, (-1, 1)))
    D = np.diag(M.diagonal())
    below, above = np.tril(M, -1), np.triu(M, 1)
    if facts.sweep == "backward":
        below, above = above, below
    splitting = (D + beta * below) / alpha
    if facts.family == PROJECTED_SPLITTING:
        of_caller = sp.csr_array(facts.splitting).toarray()
        splitting = of_caller if scaling is None else scaling[:, np.newaxis] * of_caller
    rest = splitting - M
    if is_relaxation:
        P = eye - abs(beta * below)
        right = abs(1.0 - alpha) * eye + abs((alpha - beta) * below) + abs(alpha * above)
    elif facts.family == MODULUS:
        omega = np.diag(np.asarray(facts.omega))
        P, right = splitting + omega, abs(rest) + abs(omega - M)
    else:
        P, right = splitting + 2.0 * eye + D, abs(rest + eye + D) + abs(M - eye)
    try:
        return np.abs(np.linalg.inv(P)) @ right
    except np.linalg.LinAlgError:
        return None
