"""Distance of a point from the solution, by a v > 0 with ⟨M⟩v > 0, or by a bound of the smallest eigenvalue.

By v row by row (:mod:`.row_inequality`). By λ, no larger than the eigenvalues of C (M + Mᵀ)/2 C, C = diag(c) > 0: with
e = z − z*, any S = diag(s) > 0 and r_i = mid(z_i − upper_i, z_i − lower_i, s_i w_i), the point z − r is the projection
of z − S w to the bounds. Its variational inequality at z*, and the inequality of z* at z − r, add up row by row to

    (M e)_i e_i ≤ (M e)_i r_i + e_i r_i/s_i − r_i²/s_i,   so that   eᵀM e ≤ eᵀ(Mᵀ + S⁻¹) r,

and as λ‖C⁻¹e‖₂² ≤ eᵀM e, ‖C⁻¹e‖₂ ≤ ‖C (Mᵀ + S⁻¹) r‖₂ / λ: never more than (1 + ‖M‖)‖r‖/λ if S = C = I, and much
less if r is smooth.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.kernels.floats import TINY, UNIT
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.scaling import Exponents, scale_matrix
from ...core.matrix.structure import connected_components
from ...core.rounding import compensated_product, gamma
from ...systems.equilibration import unit_diagonal
from ...systems.factors import PositiveFactor, factor_fits, positive_factor
from ..exact.upward import product_above, quotient_above, sum_above
from ..verdicts import HCertificate, comparison_certificate
from .row_inequality import RowInequality

DENSE_UP_TO = 3000
SPARSE_UP_TO = 30_000
OUTWARD = 1.0 + 2.0**-36  # more than the rounding of sums of 2 · SPARSE_UP_TO terms of one sign
UNDERFLOW = 1e-290  # far more than all that underflows in a factorization of a matrix of unit size


class EigenvalueBound(NamedTuple):
    """λ ≤ the smallest eigenvalue of C (M + Mᵀ)/2 C, C = diag(scale), powers of two."""

    value: float
    scale: FloatVector


#: Proof behind an error bound: v with ⟨M⟩v > 0 of an M with a positive diagonal, or λ.
Family = HCertificate | EigenvalueBound


def bounds_of(matrix: Matrix) -> Family | None:
    """Return the proof behind error bounds for this M; None if M is neither proven H₊ nor positive definite."""
    is_positive = bool(np.all(matrix.diagonal > 0.0))
    found = comparison_certificate(matrix) if is_positive else None
    return smallest_eigenvalue_bound(matrix) if found is None else found


def bound_of_error(at: RowInequality, family: Family) -> FloatVector:
    """Return a bound of |z − z*|, shape (n,), by the least t v or by the 2-norm."""
    if isinstance(family, HCertificate):
        return product_above(at.inflation(family), family.v)
    y = two_norm_bound(at.problem, at, family)
    return np.minimum(y, at.image(y))


@fact
def smallest_eigenvalue_bound(matrix: Matrix) -> EigenvalueBound | None:
    """Return a lower bound of the smallest eigenvalue of M's symmetric part after equilibration, kept with M.

    Returns
    -------
    EigenvalueBound or None
        None if no positive bound can be proven.

    Notes
    -----
    C (M + Mᵀ)/2 C less a share of its smallest eigenvalue is factorized; a successful factorization proves a
    bound, less the margin for its rounding. Dense: LAPACK's Cholesky, n ≤ 3000. Sparse: LU with diagonal pivots,
    n ≤ 30 000, where its fill is bounded.

    References
    ----------
    S. M. Rump, *Verification of positive definiteness*, BIT 46 (2006), doi:10.1007/s10543-006-0056-1.

    Examples
    --------
    >>> bound = smallest_eigenvalue_bound(Matrix([[4.0, 2.0], [2.0, 4.0]]))
    >>> 0.45 < bound.value <= 0.5
    True
    """
    diagonal = matrix.diagonal
    if not (diagonal > 0.0).all() or matrix.n == 0:
        return None
    exponents = unit_diagonal(diagonal)
    scale = np.ldexp(1.0, exponents.row)
    is_dense = matrix.is_dense or matrix.n <= 200
    is_dense = is_dense and matrix.n <= DENSE_UP_TO
    part, blur = _symmetric_part(matrix.csr.toarray() if is_dense else matrix.csr, exponents)
    if not np.isfinite(blur):
        return None
    if not is_dense and not (matrix.n <= SPARSE_UP_TO and factor_fits(part)):
        return None
    value = _proven_bound(part, blur)
    return None if value is None else EigenvalueBound(value, scale)


def two_norm_bound(problem: LCP, at: RowInequality, eigenvalue: EigenvalueBound) -> FloatVector:
    """Return y with |z − z*| ≤ y, shape (n,), if `eigenvalue` holds."""
    inverse_step = np.exp2(np.clip(np.round(np.log2(problem.diagonal)), -1000.0, 1000.0))
    # Both bounds of each r_i; at a bound, with w_i of the right sign, they are equal for any rounding of w_i.
    residual = np.minimum(np.maximum(quotient_above(at.slack, inverse_step), at.over), at.above)
    negative = np.maximum(
        np.minimum(quotient_above(at.negative_slack, inverse_step), at.below), at.under
    )
    blur = np.maximum(sum_above(residual, negative), 0.0)
    if not (residual.any() or blur.any()):
        return np.zeros(problem.n)
    transpose = sp.csr_array(problem.csr.T)
    value, radius = compensated_product(transpose, residual, residual * inverse_step)
    blurred, blurred_radius = compensated_product(abs(transpose), blur, blur * inverse_step)
    size = sum_above(sum_above(np.abs(value), radius), sum_above(blurred, blurred_radius))
    size = sum_above(size, 4.0 * TINY)  # products may have underflowed
    several, even = connected_components(problem.matrix), product_above(eigenvalue.scale, size)
    labels = np.zeros(problem.n, np.int64) if several is None else several.labels
    norm = norms_above(even, labels)[labels]
    bound = product_above(eigenvalue.scale, quotient_above(norm, np.float64(eigenvalue.value)))
    return np.where(np.isnan(bound), np.inf, bound)


def norm_above(x: FloatVector) -> np.float64:
    """Return a double above ‖x‖₂ for x ≥ 0, also with underflow."""
    return np.float64(norms_above(x, np.zeros(x.size, np.int64)).max(initial=0.0))


def norms_above(x: FloatVector, labels: Any) -> FloatVector:
    """Return a double above ‖x_P‖₂, x ≥ 0, for each set P of entries with one label; also with underflow."""
    largest = np.zeros(int(labels.max(initial=-1)) + 1)
    np.maximum.at(largest, labels, x)
    is_usual = (largest > 0.0) & np.isfinite(largest)
    unit = np.exp2(np.floor(np.log2(np.where(is_usual, largest, 1.0))))
    squares = np.bincount(labels, (x / unit[labels]) ** 2, largest.size) * OUTWARD
    squares += x.size * UNDERFLOW
    norms: FloatVector = np.where(is_usual, unit * np.sqrt(squares) * OUTWARD, largest)
    return norms


def _symmetric_part(M: Any, exponents: Exponents) -> tuple[Any, float]:
    """Return C (M + Mᵀ)/2 C and a bound of the rounding of its eigenvalues, ∞ after overflow."""
    even = scale_matrix(M, exponents)
    part = 0.5 * (even + even.T)
    size = float(abs(part).sum(axis=1).max())
    return part, 2.0 * UNIT * size + part.shape[0] * UNDERFLOW


def _proven_bound(part: Any, blur: float) -> float | None:
    """Return a share of the smallest eigenvalue that is proven to be below it, the largest of some, or None."""
    factor = positive_factor(part)
    if factor is None:
        return None
    estimate = _inverse_iteration(factor.solve, part)
    identity = (sp.eye_array if sp.issparse(part) else np.eye)(part.shape[0])
    for share in (0.95, 0.5, 0.1):  # the first shift that a factorization proves
        shift = share * estimate
        shifted = part - shift * identity
        factor = positive_factor(shifted)
        if factor is not None:
            rounding = _rounding(shifted, factor) + 2.0 * UNIT * (
                float(part.diagonal().max()) + shift
            )
            value = (shift - rounding - blur) / OUTWARD
            if value > 0.0:
                return float(value)
    return None


def _rounding(matrix: Any, factor: PositiveFactor) -> float:
    """Return a bound of the distance of a factorized matrix from a semidefinite one: Cholesky's bound, or measured."""
    if factor.superlu is not None:
        return _factor_error(factor.superlu)
    n = matrix.shape[0]
    trace = float(np.sum(np.abs(matrix.diagonal()))) * OUTWARD
    return float(1.01 * gamma(n + 3) * trace + n * n * UNDERFLOW)


def _factor_error(factor: Any) -> float:
    """Return a bound of ‖A − L D Lᵀ‖₂, D = diag(U) > 0: A is that near to a semidefinite matrix.

    |A − L U| ≤ γ_k |L||U| for k terms a row, and U − D Lᵀ, rounding only, is measured.
    """
    L, U = abs(factor.L), abs(factor.U)
    n = L.shape[0]
    terms = int(max(np.diff(L.tocsr().indptr).max(), np.diff(U.tocsc().indptr).max())) + 2
    product = factor.L @ sp.diags_array(factor.U.diagonal())
    asymmetry = abs(factor.U - product.T) + 2.0 * UNIT * (U + abs(product.T))
    ones = np.ones(n)
    by_row = gamma(terms) * (L @ (U @ ones)) + L @ (asymmetry @ ones)
    return float(float(by_row.max()) * OUTWARD + n * UNDERFLOW)


def _inverse_iteration(solve: Any, part: Any) -> float:
    """Return the Rayleigh quotient of a vector near the lowest eigenvector; an upper bound except for rounding."""
    x = np.random.default_rng(0).standard_normal(part.shape[0])
    for _ in range(30):  # an estimate, which is proved afterwards
        x /= np.linalg.norm(x)
        x = solve(x)
    return float(x @ (part @ x) / (x @ x))
