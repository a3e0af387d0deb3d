"""How far x is from the solution of a linear system with a block of M, as a number that cannot be too small.

Let |M_FF x| ≤ s. With ⟨M_FF⟩v ≥ u > 0 and t = max s_i/u_i, ⟨M_FF⟩|x| ≤ s ≤ t ⟨M_FF⟩v, so that |x| ≤ t v; a v of M
serves each of its principal blocks. With λ ≤ the eigenvalues of C (M_FF + M_FFᵀ)/2 C,
λ‖C⁻¹x‖₂² ≤ xᵀM_FF x ≤ ‖C⁻¹x‖₂‖C s‖₂, so that ‖C⁻¹x‖₂ ≤ ‖C s‖₂/λ.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..exact.rounding import compensated_product
from ..exact.upward import product_above, quotient_above, sum_above
from ..matrix import comparison_certificate
from ..matrix.free_systems import FreeSystem
from ..matrix.matrix import Matrix
from .definite_bounds import norm_bound, smallest_eigenvalue_bound
from .reference_point import NearPoint


@np.errstate(all="ignore")
def block_solution_bound(system: FreeSystem, size: FloatVector) -> FloatVector:
    """Return a bound on the free rows of |x| for every x with |M_FF x| ≤ size_F, shape (n,).

    ∞ where M_FF is neither proven an H₊-matrix nor proven to have a positive definite symmetric part; on ranks the
    whole of M must be an H₊-matrix.

    Parameters
    ----------
    size : array, shape (n,)
        Not negative; on ranks the own part.

    Examples
    --------
    >>> system = FreeSystem(Matrix([[2.0, 1.0], [1.0, 2.0]]), np.array([True, True]))
    >>> block_solution_bound(system, np.array([1.0, 0.0])) >= [2 / 3, 1 / 3]
    array([ True,  True])
    """
    if not system.matrix.peers.is_alone:
        return _solution_bound(system.matrix, np.where(system.free, size, 0.0))
    bound = np.zeros(size.size)
    if system.rows.size:
        bound[system.free] = _solution_bound(system.principal, size[system.free])
    return bound


def _solution_bound(matrix: Matrix, size: FloatVector) -> FloatVector:
    is_positive = matrix.peers.everywhere(bool((matrix.diagonal > 0.0).all()))
    certificate = comparison_certificate(matrix) if is_positive else None
    if certificate is not None:
        share = quotient_above(size, certificate.margin).max(initial=0.0)
        return product_above(np.float64(matrix.peers.largest(float(share))), certificate.v)
    eigenvalue = smallest_eigenvalue_bound(matrix) if matrix.peers.is_alone else None
    if eigenvalue is None or not eigenvalue.is_rigorous:
        return np.full(size.size, np.inf)
    return norm_bound(size, eigenvalue)


@np.errstate(all="ignore")
def block_error_bound(
    system: FreeSystem, x: FloatVector, b: FloatVector, A: Any | None, z: NearPoint
) -> FloatVector:
    """Return a bound of |x − x*|, shape (n,), where (M x* + A z* + b)_F = 0 and x* = x elsewhere.

    Parameters
    ----------
    x, b : array, shape (n,)
        On ranks the own parts.
    A : array or CSR array, shape (n, n), or None
    z : NearPoint
        z* is no farther from it than its own bound.

    Examples
    --------
    >>> system = FreeSystem(Matrix([[2.0, 1.0], [1.0, 2.0]]), np.array([True, False]))
    >>> z = NearPoint(np.ones(2), np.zeros(2), np.zeros(2))
    >>> block_error_bound(system, np.array([1.5, 0.0]), np.zeros(2), -4.0 * np.eye(2), z) >= [0.5, 0.0]
    array([ True,  True])
    """
    matrix, blur = system.matrix, np.zeros(x.size)
    terms = [(matrix.csr_rows, matrix.whole(x), b)]
    if A is not None:
        blur = _sum_bound([(sp.csr_array(abs(A)), z.y, blur)], blur)
        terms += [(sp.csr_array(A), part, np.zeros(x.size)) for part in (z.high, z.low)]
    return np.where(system.free, block_solution_bound(system, _sum_bound(terms, blur)), 0.0)


def _sum_bound(terms: list[tuple[Any, FloatVector, FloatVector]], blur: FloatVector) -> FloatVector:
    """Return an upper bound of |Σ (A x + b)| + blur, shape (n,), for terms (A, x, b), A as CSR."""
    high = low = np.zeros(blur.size)
    for A, x, b in terms:
        value, radius = compensated_product(A, x, b)
        high, low, blur = sum_above(high, value), sum_above(low, -value), sum_above(blur, radius)
    bound = sum_above(np.maximum(high, low), blur)
    return np.where(np.isnan(bound), np.inf, bound)
