"""The spectral radius of the matrix that bounds an iteration's errors, the number that papers print.

Each iteration of these families satisfies |z_{k+1} − z*| ≤ T |z_k − z*| in every component, with a nonnegative T:

    projected type        T = |P⁻¹| (|𝓜 − M + I + D| + |M − I|),  P = 𝓜 + 2I + D   (the paper's Theorem 4.1)
    projected relaxation  T = (I − |βL|)⁻¹ (|1 − ω| I + |ω − β| |L| + |ω U|),  of M scaled to unit diagonal
    modulus               T = |(𝓜 + Ω)⁻¹| (|𝓜 − M| + |Ω − M|), for x

ρ(T) < 1 makes it converge from every start; ρ(T) is a float and no proof: for one, `rate`, which
rests on a sharper bound than the paper's T where rows are not scaled.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, spsolve_triangular

from ...core.lcp import LCP
from ...core.matrix.iteration_facts import MODULUS, PROJECTED_RELAXATION, PROJECTED_SPLITTING, IterationFacts
from ...systems.comparison import nonnegative_radius
from .convergence import numbers

DENSE_UP_TO = 500
AGREES_TO = 1e-10


def spectral_radius(problem: LCP, facts: IterationFacts) -> float | None:
    """Return ρ(T) of an iteration; None of a symmetric sweep, and where a large inverse would have to be formed.

    Up to n = 500 every |P⁻¹| is formed. Beyond, P must be triangular and its off-diagonal entries ≤ 0, as for every
    named splitting of a matrix whose off-diagonal entries are.
    """
    if facts.sweep == "symmetric" and facts.family != PROJECTED_SPLITTING:
        return None
    T = _bound(problem, facts)
    return None if T is None else _largest(T, problem.n)


def jacobi_spectral_radius(problem: LCP) -> float:
    """Return ρ(|J|), J = D⁻¹(L + U) that of Jacobi's iteration; ∞ where a diagonal entry is 0."""
    if not problem.diagonal.all():
        return np.inf
    beside = abs(problem.csr - sp.diags_array(problem.diagonal))
    return float(np.mean(nonnegative_radius(sp.csr_array(sp.diags_array(1.0 / np.abs(problem.diagonal)) @ beside))))


def _bound(problem: LCP, facts: IterationFacts) -> Any:
    """Return T, or of a large one v → T v; None where that is not to be had."""
    M, n = problem.csr, problem.n
    alpha, beta = numbers(facts)
    eye, is_backward = sp.eye_array(n, format="csr"), facts.sweep == "backward"
    if facts.family == PROJECTED_RELAXATION:
        unit = sp.csr_array(sp.diags_array(1.0 / problem.diagonal) @ M)
        below, above = sp.tril(unit, -1, format="csr"), sp.triu(unit, 1, format="csr")
        below, above = (above, below) if is_backward else (below, above)
        right = abs(1.0 - alpha) * eye + abs(alpha - beta) * abs(below) + abs(alpha) * abs(above)
        return _solved(sp.csr_array(eye - abs(beta) * abs(below)), sp.csr_array(right), is_lower=not is_backward)
    scaling = np.ones(n) if facts.scaling is None else facts.scaling
    scaled = sp.csr_array(sp.diags_array(scaling) @ M)
    D = sp.diags_array(scaled.diagonal(), format="csr")
    if facts.family == PROJECTED_SPLITTING:
        splitting = sp.csr_array(sp.diags_array(scaling) @ facts.splitting)
    else:
        part = sp.triu(scaled, 1, format="csr") if is_backward else sp.tril(scaled, -1, format="csr")
        splitting = sp.csr_array((D + beta * part) / alpha)
    if facts.family == MODULUS:
        omega = sp.diags_array(np.asarray(facts.omega), format="csr")
        P, right = splitting + omega, abs(splitting - scaled) + abs(omega - scaled)
    else:
        P, right = splitting + 2.0 * eye + D, abs(splitting - scaled + eye + D) + abs(scaled - eye)
    return _solved(sp.csr_array(P), sp.csr_array(right), is_lower=not is_backward)


def _solved(P: Any, right: Any, *, is_lower: bool) -> Any:
    """Return |P⁻¹| right, or of a large one v → |P⁻¹| right v; None where that is not to be had."""
    n = P.shape[0]
    if n <= DENSE_UP_TO:
        try:
            return np.abs(np.linalg.inv(P.toarray())) @ right.toarray()
        except np.linalg.LinAlgError:
            return None
    outside = sp.triu(P, 1) if is_lower else sp.tril(P, -1)
    beside = P - sp.diags_array(P.diagonal())
    if outside.count_nonzero() or beside.max() > 0.0 or P.diagonal().min() <= 0.0:
        return None
    return lambda v: np.asarray(spsolve_triangular(P, right @ v, lower=is_lower))  # P⁻¹ ≥ 0


def _largest(T: Any, n: int) -> float | None:
    """Return the spectral radius of a nonnegative matrix, which is its eigenvalue with the largest real part."""
    if isinstance(T, np.ndarray):
        return float(np.abs(np.linalg.eigvals(T)).max(initial=0.0)) if np.isfinite(T).all() else None
    try:
        found = eigs(LinearOperator((n, n), matvec=T, dtype=float), 1, which="LR", v0=np.ones(n), tol=AGREES_TO,
                     return_eigenvectors=False)
    except ArpackNoConvergence:
        return None
    return float(found[0].real)
