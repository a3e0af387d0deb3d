"""Row factors that make a matrix monotone again: rows in other units change no solution, but hide the monotonicity."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ...checks import FloatVector

CLEARLY = 1.1  # entries rounded to a few digits still count as monotone
LARGEST_SEARCH = 20_000  # rows up to which a tree through the pattern is followed row by row
LARGEST_EXPONENT = 1000


def monotone_rows(M: Any) -> FloatVector | None:
    """Return r, powers of two, shape (n,), such that diag(r) M may be monotone although M is not; else None.

    M is not monotone where |m_ij + m_ji| > 2 √(m_ii m_jj), and only what is so clearly is changed. Tried are the
    factors that make M symmetric, if there are any, and those that make its diagonal 1.

    Examples
    --------
    >>> monotone_rows(np.array([[2.0, -1.0], [-64.0, 128.0]]))
    array([1.      , 0.015625])
    >>> monotone_rows(np.array([[2.0, -1.0], [-1.0, 2.0]])) is None
    True
    """
    diagonal = M.diagonal()
    if not diagonal.size or diagonal.min() <= 0.0:
        return None
    rows = sp.csr_array(M)
    exponents = np.zeros(diagonal.size)
    if _may_be_monotone(rows, exponents):
        return None
    candidates = [_symmetrising(rows)] if diagonal.size <= LARGEST_SEARCH else []
    for exponents in (*candidates, -np.rint(np.log2(diagonal))):
        if np.abs(exponents).max() <= LARGEST_EXPONENT and _may_be_monotone(rows, exponents):
            factors: FloatVector = np.ldexp(1.0, exponents.astype(np.int64))
            return factors
    return None


def _may_be_monotone(M: sp.csr_array, exponents: FloatVector) -> bool:
    scaled = M.copy()
    with np.errstate(all="ignore"):
        scaled.data = np.ldexp(M.data, np.repeat(exponents, np.diff(M.indptr)).astype(np.int64))
        root = np.sqrt(scaled.diagonal())
        both = sp.coo_array(scaled + scaled.T)
        allowed = 2.0 * root[both.row] * root[both.col] * CLEARLY
        return bool(np.all(np.abs(both.data) <= allowed))


def _symmetrising(M: sp.csr_array) -> FloatVector:
    """Return the exponents r of 2^r_i m_ij = 2^r_j m_ji along a tree through each connected part of the pattern."""
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    pattern = sp.csr_array((np.ones(M.nnz), M.indices, M.indptr), shape=M.shape)
    mutual = sp.csr_array(pattern * pattern.T)
    size = _logarithms(M)
    ratio = sp.csr_array(mutual * size) - sp.csr_array(mutual * size.T)  # log₂ of m_ij/m_ji
    exponents = np.zeros(M.shape[0])
    count, part = connected_components(mutual, directed=False)
    first = np.full(count, -1)
    first[part[::-1]] = np.arange(M.shape[0])[::-1]
    for start in first.tolist():
        order, before = breadth_first_order(mutual, start, directed=False)
        for i in order[1:].tolist():
            exponents[i] = exponents[before[i]] - ratio[i, before[i]]
    return np.rint(exponents)


def _logarithms(M: sp.csr_array) -> sp.csr_array:
    """Return log₂|m_ij| in the pattern of M."""
    return sp.csr_array((np.log2(np.abs(M.data)), M.indices, M.indptr), shape=M.shape)
