"""Definiteness of a symmetric matrix, decided by an attempt to factorize it with a rounding margin."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, FloatMatrix, Vector
from ..core.entries import count_entries, max_norm, row_numbers, scale_by
from ..core.kernels.floats import EPSILON, OUTWARD, UNDERFLOW, UNIT
from ..core.rounding import gamma
from ..core.tuning import FULL_CHOLESKY_UP_TO
from .factors import PositiveFactor, factor_fits, positive_factor, positive_triangle

LARGEST_SHIFT = 1e-6  # a proof of semidefiniteness up to more than this is useless
LARGEST_SUMMAND = 2.0**1023  # two below it have a sum


def is_semidefinite_to_rounding(P: AnyMatrix) -> bool | None:
    """Return whether P has no negative eigenvalue beyond rounding; None if n is too large to say.

    Parameters
    ----------
    P : ndarray or CSR array, shape (n, n)
        Exactly symmetric; each entry may be rounded once.

    Notes
    -----
    True: P scaled to a unit diagonal has no eigenvalue below −2δ, δ = n (n + 4) 2⁻⁵². P may be indefinite by less,
    which no factorization can exclude for a singular matrix. This test suits a computed P. False is a proof that P is
    not semidefinite. The result is None if δ > 1e-6 (n above about 67 000), or if the fill of a factorization would be
    too large.

    Examples
    --------
    >>> is_semidefinite_to_rounding(np.array([[1.0, 1.0], [1.0, 1.0]]))
    True
    >>> is_semidefinite_to_rounding(np.array([[1.0, 1.0], [1.0, 1.0 - 1e-15]]))
    True
    >>> is_semidefinite_to_rounding(np.array([[0.0, 1e-9], [1e-9, 1.0]]))
    False
    """
    diagonal: Vector = P.diagonal()
    least = diagonal.min(initial=np.inf)
    if not least >= 0.0:
        return False
    if sp.issparse(P):
        if is_diagonal(P):
            return True
        filled, sizes = np.flatnonzero(diagonal), np.abs(P.data)
        # If a diagonal entry of a semidefinite matrix is zero, its row is zero.
        if sizes[(diagonal == 0.0)[P.indices]].any():
            return False
        if (np.bincount(row_numbers(P), sizes, diagonal.size) - diagonal <= diagonal).all():
            return True  # no row is less than the sum of its other entries (Gershgorin)
        # A dense factor is quicker if P is small, or full in no order that a sparse factor could use.
        is_full = filled.size <= FULL_CHOLESKY_UP_TO and P.nnz > 0.02 * filled.size**2
        if filled.size <= 150 or is_full:
            P = P.toarray() if filled.size == diagonal.size else P[filled].toarray()[:, filled]
            diagonal, least = diagonal[filled], diagonal[filled].min(initial=np.inf)
    # Relative to √(p_ii p_jj), Cholesky's backward error is as small as for the scaled matrix (Demmel).
    if isinstance(P, np.ndarray):
        # Terms that underflow are negligible relative to it
        if least >= 2.0**-900 and positive_triangle(P) is not None:
            return True
        if is_diagonal(P):
            return True
        if P[diagonal == 0.0].any():
            return False
    shift = _margin(diagonal.size)
    if shift > LARGEST_SHIFT:
        return None
    unit = scaled_to(P, 1.0 / np.sqrt(np.where(diagonal == 0.0, 1.0, diagonal)))
    return None if unit is None else factorized(unit, shift) is not None


def is_positive_definite(P: AnyMatrix) -> bool | None:
    """Return whether P is positive definite: True and False are proven, None is neither.

    Parameters
    ----------
    P : ndarray or CSR array, shape (n, n)
        Exactly symmetric; each entry may be rounded once, as :func:`symmetric_part` does.

    Notes
    -----
    True: the matrix scaled to a unit diagonal, less a shift, factorizes, and the shift is more than the bound of the
    rounding error (measured if sparse) and 4 n u, u = 2⁻⁵³, for the rounding of the scaling and of P. False: plus
    n (n + 4) 2⁻⁵², it does not factorize, with more than twice the backward error n γ_{n+1}.

    References
    ----------
    S. M. Rump, *Verification of positive definiteness*, BIT 46 (2006), doi:10.1007/s10543-006-0056-1.

    Examples
    --------
    >>> is_positive_definite(np.array([[2.0, 1.0], [1.0, 2.0]]))
    True
    >>> is_positive_definite(np.array([[1.0, 2.0], [2.0, 1.0]]))
    False
    """
    diagonal: Vector = np.array(P.diagonal())
    if not (diagonal > 0.0).all():
        return False
    if is_diagonal(P):
        return True
    n, unit = diagonal.size, scaled_to(P, 1.0 / np.sqrt(diagonal))
    factor = None if unit is None else factorized(unit, 0.0)
    if factor is not None:
        shift = 2.0 * (factor_rounding(unit, factor) + 2.0 * n * EPSILON)
        factor = factorized(unit, -shift)
        is_proven = factor and factor_rounding(unit, factor) + 2.0 * n * EPSILON <= shift
        return True if is_proven else None
    shift = _margin(n)
    if unit is None or shift > LARGEST_SHIFT:
        return None
    return False if factorized(unit, shift) is None else None


def factor_rounding(matrix: AnyMatrix, factor: PositiveFactor) -> float:
    """Return a bound of the distance of a factorized matrix from semidefinite ones: Cholesky's bound, or measured."""
    n = matrix.shape[0]
    if factor.superlu is None:
        trace = float(np.sum(np.abs(matrix.diagonal()))) * OUTWARD
        return float(1.01 * gamma(n + 3) * trace + n * n * UNDERFLOW)
    # |A − L U| ≤ γ_k |L||U| for k terms a row, and U − D Lᵀ, rounding only, is measured; D = diag(U) > 0
    superlu, ones = factor.superlu, np.ones(n)
    L, U, product = abs(superlu.L), abs(superlu.U), superlu.L @ sp.diags_array(superlu.U.diagonal())
    asymmetry = abs(superlu.U - product.T) + 2.0 * UNIT * (U + abs(product.T))
    terms = int(max(np.diff(L.tocsr().indptr).max(), np.diff(U.tocsc().indptr).max())) + 2
    by_row = gamma(terms) * (L @ (U @ ones)) + L @ (asymmetry @ ones)
    return float(float(by_row.max()) * OUTWARD + n * UNDERFLOW)


def symmetric_part(M: AnyMatrix) -> Any:
    """Return (M + Mᵀ)/2, exactly symmetric; M itself if it is symmetric.

    Each entry is rounded once, entries below 2⁻¹⁰²² to a multiple of 2⁻¹⁰⁷⁴.

    Examples
    --------
    >>> symmetric_part(np.array([[1.0, 4.0], [0.0, 1.0]]))
    array([[1., 2.],
           [2., 1.]])
    """
    entries = M.data if sp.issparse(M) else M
    transposed = M.T.tocsr() if sp.issparse(M) else M.T
    if max_norm(entries) < LARGEST_SUMMAND:
        return (M + transposed) * 0.5
    return M * 0.5 + transposed * 0.5


def semidefinite_margin(P: AnyMatrix) -> float:
    """Return δ of λ_min(P) ≥ −δ, which :func:`is_semidefinite_to_rounding` proves, in the unit of P."""
    diagonal: Vector = np.array(P.diagonal())
    return 2.0 * _margin(diagonal.size) * float(diagonal.max(initial=0.0))


def is_diagonal(P: AnyMatrix) -> bool:
    """Return whether all off-diagonal entries are zero."""
    nonzeros = count_entries(P)
    return int(nonzeros) == np.count_nonzero(P.diagonal())


def _margin(n: int) -> float:
    return n * (n + 4) * EPSILON


def scaled_to(P: AnyMatrix, scale: Vector) -> Any:
    """Return P with scaled rows and columns; None if P overflows or is too large to be factorized."""
    if not sp.issparse(P):
        dense = scale_by(P, scale, scale)
        return dense if np.isfinite(dense).all() else None
    if not factor_fits(P):
        return None
    scaled = scale_by(sp.csr_array(P), scale, scale).T  # by columns; it is symmetric
    return scaled if np.isfinite(scaled.data).all() else None


def factorized(unit: FloatMatrix, shift: float) -> PositiveFactor | None:
    """Return a factorization of unit + shift·I with positive pivots, or None if there is none.

    Parameters
    ----------
    unit : ndarray or CSC array, shape (n, n)
        Symmetric, entries of moderate size.
    shift : float
        Shift in the unit of the entries.
    """
    n = unit.shape[0]
    if sp.issparse(unit):
        return positive_factor(unit + shift * sp.eye_array(n))
    shifted = np.array(unit)
    shifted.flat[:: n + 1] += shift
    return positive_factor(shifted)
