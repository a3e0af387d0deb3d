"""Units of the unknowns and rows of a program, powers of two, by a fit of the logarithms of its entries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import AnyMatrix, Array, Vector
from ...core.entries import or_one, with_entries

FIT_TO = 1e-3  # of the right-hand side: enough for powers of two


def fitted_units(P: AnyMatrix, C: AnyMatrix) -> tuple[Vector, Vector]:
    """Return u and v, powers of two: least squares of the logarithms of |p_jk| u_j u_k and |c_ij| v_i u_j.

    References
    ----------
    Curtis, Reid, *On the automatic scaling of matrices for Gaussian elimination*, IMA Journal of Applied Mathematics 10
    (1972), doi:10.1093/imamat/10.1.118.

    Examples
    --------
    >>> fitted_units(sp.csr_array([[4.0, 0.0], [0.0, 1.0]]), sp.csr_array([[1.0, 16.0]]))
    (array([0.5, 0.5]), array([0.5]))
    """
    (in_P, log_P), (in_C, log_C) = map(_pattern_and_logarithms, (P, C))
    pattern, n, ones = _bordered(in_P, in_C), P.shape[0], np.ones(sum(C.shape))
    counts = pattern(ones) + 1e-6  # the fit has null spaces: 2ᵗ of unknowns, 2⁻ᵗ of rows
    diagonal = counts + np.append(2.0 * in_P.diagonal(), np.zeros(C.shape[0]))
    sums = _bordered(log_P, log_C)(ones)
    units = _powers(_conjugate_gradients(lambda x: pattern(x) + counts * x, diagonal, -sums))
    return units[:n], units[n:]


def _bordered(P: AnyMatrix, C: AnyMatrix) -> Callable[[Vector], Vector]:
    """Return the function x ↦ [P + diag(P), Cᵀ; C, 0] x."""
    n, on, turned = P.shape[0], P.diagonal(), C.T
    return lambda x: np.concatenate([P @ x[:n] + on * x[:n] + turned @ x[n:], C @ x[:n]])


def _pattern_and_logarithms(M: AnyMatrix) -> Any:
    """Return matrices with 1, and with log₂ |entry|, in the place of each entry."""
    if sp.issparse(M):
        return with_entries(M, np.ones(M.nnz)), with_entries(M, np.log2(np.abs(M.data)))
    is_entry = M != 0.0
    return is_entry.astype(np.float64), np.log2(np.abs(M), where=is_entry, out=np.zeros(M.shape))


def _conjugate_gradients(product: Callable[[Vector], Vector], diagonal: Vector, b: Array) -> Vector:
    """Return about A⁻¹b from products with A; scipy's loop takes ten times as long for 100 to 1000 unknowns."""
    x, residual, inverse = np.zeros(b.size), b, 1.0 / diagonal
    direction = inverse * residual
    size = residual @ direction
    for _ in range(60):
        if not residual @ residual > (FIT_TO * FIT_TO) * (b @ b):
            break
        image = product(direction)
        step = size / (direction @ image)
        x, residual = x + step * direction, residual - step * image
        steepest = inverse * residual
        size, before = residual @ steepest, size
        direction = steepest + (size / before) * direction
    return x


def roots(sizes: Vector) -> Vector:
    """Return powers of two near the square roots, 1 of 0."""
    return _powers(0.5 * np.log2(or_one(sizes)))


def _powers(exponents: Vector) -> Vector:
    """Return 2 to the rounded exponents, within the range of doubles; 1 for NaN."""
    known = np.where(np.isnan(exponents), 0.0, exponents)
    return np.ldexp(1.0, np.rint(np.minimum(np.maximum(known, -1000.0), 1000.0)).astype(np.intc))
