"""Iterations that can fail to converge, with the proof."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..kernels.floats import EPSILON
from ..problem.lcp import LCP
from .convergence import MODULUS, PROJECTED_RELAXATION, PROJECTED_SPLITTING, IterationFacts, numbers
from .theorems import CRYER

DENSE_LIMIT = 100
UNDERFLOW = 2.0**-1060  # more than what a product of complex numbers loses
COMPLEX_ROUNDING = 8.0  # a complex product or sum errs at most so many times as much as a real one


def divergence(facts: IterationFacts, problem: LCP) -> str | None:
    """Return why the iteration does not converge from some start, for some q and bounds, or None: nothing is proven.

    Where z* lies inside its bounds and w* = 0, the iteration is linear near z*, everywhere if all rows are free. A
    spectral radius of 1 or more is the proof; it is verified for n up to 100.
    """
    return _diverges_for_every_matrix(facts) or _diverges_for_this_matrix(facts, problem)


def _diverges_for_every_matrix(facts: IterationFacts) -> str | None:
    """Return why the iteration fails to converge whatever M is, where it does with no constraint active."""
    if facts.family != PROJECTED_RELAXATION or facts.relaxation is None or facts.relaxation < 2.0:
        return None
    if facts.acceleration in (facts.relaxation, 0.0):
        mean = "determinant ±(ω − 1)ⁿ" if facts.acceleration else "trace n(1 − ω)"
        return (
            f"with no constraint active an error is multiplied by a matrix of {mean}, so that one of its eigenvalues "
            f"is at least |ω − 1| = {facts.relaxation - 1.0:g} in absolute value ({CRYER})"
        )
    return None


def _diverges_for_this_matrix(facts: IterationFacts, problem: LCP) -> str | None:
    if problem.n > DENSE_LIMIT or facts.relaxation is None:
        return None
    with np.errstate(all="ignore"):
        lower = radius_above_one(*linear_iteration(facts, problem))
    if lower is None:
        return None
    return (
        "with no constraint active an error is multiplied by a matrix whose spectral radius is at least "
        f"{_rounded_down(lower)}, verified for this M"
    )


def linear_iteration(facts: IterationFacts, problem: LCP) -> tuple[Any, Any, Any]:
    """Return dense P, N with P e⁺ = N e where no constraint is active; a symmetric sweep has twice the size.

    With two passes the matrix is that of (e, e') ↦ (N_b e', N_f e): its eigenvalues are the square roots. The third
    array holds the sums of the magnitudes of which P and N were made, which their rounding is relative to.
    """
    M = problem.csr.toarray()
    forward = _one_pass(facts, M, np.tril(M, -1))
    if facts.family == PROJECTED_SPLITTING or facts.sweep == "forward":
        return forward
    backward = _one_pass(facts, M, np.triu(M, 1))
    if facts.sweep == "backward":
        return backward
    (P, N, size), (Q, K, other), zero = forward, backward, np.zeros_like(M)
    both = np.block([[size, size], [other, other]])
    return np.block([[P, zero], [zero, Q]]), np.block([[zero, N], [K, zero]]), both


def _one_pass(facts: IterationFacts, M: Any, updated: Any) -> tuple[Any, Any, Any]:
    D = np.diag(np.diag(M))
    alpha, beta = numbers(facts)
    if facts.family == PROJECTED_RELAXATION:
        parts, drive = [D, beta * updated], alpha * M
    elif facts.family == MODULUS:
        omega = D if facts.omega is None else np.diag(facts.omega)
        parts, drive = [alpha * omega, D, beta * updated], 2.0 * alpha * M
    else:
        scaling = np.ones((M.shape[0], 1)) if facts.scaling is None else facts.scaling[:, None]
        drive = 2.0 * scaling * M
        is_any = facts.family == PROJECTED_SPLITTING
        inner = [facts.splitting.toarray()] if is_any else [D / alpha, beta / alpha * updated]
        parts = [*(scaling * part for part in (D, *inner)), 2.0 * np.eye(M.shape[0])]
    P = sum(parts)
    return P, P - drive, sum(np.abs(part) for part in parts) + np.abs(drive)


def radius_above_one(pivot: Any, numerator: Any, magnitude: Any = None) -> float | None:
    """Return a proven lower bound > 1 of the spectral radius of P⁻¹N, or None where none was found.

    Parameters
    ----------
    pivot, numerator : arrays, shape (n, n)
        P and N, dense.
    magnitude : array, shape (n, n), optional
        Each entry of P and N is right to 8 units in the last place of it; |P| + |N| by default.

    Notes
    -----
    LAPACK proposes eigenvectors X and eigenvalues Λ of P⁻¹N. With Z = PX, Y ≈ Z⁻¹ and E = I − YZ,

        X⁻¹(P⁻¹N)X = Λ + G,   |G| ≤ (I − |E|)⁻¹ |Y| |NX − ZΛ|,

    bounded with rounding counted. The discs of radius r = ‖G‖∞ around the Λ_i hold the eigenvalues, each connected
    group as many as it has discs (Gerschgorin); the group of the largest |Λ_i| reaches at most 2nr further in.
    """
    import scipy.linalg

    P, N = np.asarray(pivot), np.asarray(numerator)
    n = P.shape[0]
    if n == 0 or not (np.isfinite(P).all() and np.isfinite(N).all()):
        return None
    with np.errstate(all="ignore"):
        try:
            values, X = scipy.linalg.eig(np.linalg.solve(P, N))
            Y = np.linalg.inv(P @ X)
        except (np.linalg.LinAlgError, ValueError):  # singular, or eigenvectors that overflow
            return None
        unit = COMPLEX_ROUNDING * (n + 16) * EPSILON
        Z = P @ X
        size = np.abs(P) + np.abs(N) if magnitude is None else magnitude
        around = unit * (size @ np.abs(X)) + n * UNDERFLOW  # of Z and of N X
        residual = np.abs(N @ X - Z * values) + unit * (np.abs(Z) + around) * np.abs(values)
        residual += around * (1.0 + np.abs(values))
        error = np.abs(np.eye(n) - Y @ Z) + unit * (np.abs(Y) @ np.abs(Z) + np.eye(n)) + np.abs(Y) @ around
        spread = float(np.abs(error).sum(axis=1).max())
        if not spread < 0.5:
            return None
        G = np.abs(Y) @ residual
        disc = float(G.sum(axis=1).max()) / (1.0 - spread) * (1.0 + unit)
        lower = float(np.abs(values).max()) * (1.0 - unit) - 2.0 * n * disc
    return lower if lower > 1.0 else None


def _rounded_down(value: float) -> str:
    """Return a number above 1 with enough digits to show that it is, rounded down.

    Examples
    --------
    >>> _rounded_down(1.2399), _rounded_down(1.0001238)
    ('1.23', '1.00012')
    """
    places = 2 + max(0, -int(np.ceil(np.log10(min(value - 1.0, 1.0)))))
    return f"{np.floor(value * 10.0**places) / 10.0**places:.{places}f}"
