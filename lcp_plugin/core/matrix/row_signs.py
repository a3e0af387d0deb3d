r"""The sign of a free unknown's row: w_i = 0 says the same as −w_i = 0, but M may be monotone with one of them only.

With s_i = ±1, and 1 on every row whose z_i has a bound, diag(s) M is looked at by its principal minors of order one and
two, which a monotone M has ≥ 0, whatever positive numbers its rows were multiplied by:

    s_i m_ii ≥ 0,   s_i m_ij s_j m_ji ≤ |m_ii m_jj|.

A free row takes its sign from its diagonal entry; where that is 0, from the rows that it meets, s_i m_ij s_j m_ji ≤ 0.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector
from .matrix import Matrix, fact
from .structure import row_numbers

ALMOST = 1.0 + 1e-12  # minors that are 0 but for rounding


@fact
def monotone_signs(matrix: Matrix, free: bytes) -> FloatVector | None:
    """Return s of the module's head, shape (n,), where M fails its minors and diag(s) M does not; else None.

    Parameters
    ----------
    free : bytes
        Of the array of bool, shape (n,), that says which unknowns have no bound.

    Examples
    --------
    >>> free = np.array([False, True]).tobytes()
    >>> monotone_signs(Matrix([[2.0, 1.0], [1.0, 0.0]]), free)
    array([ 1., -1.])
    >>> monotone_signs(Matrix([[2.0, 1.0], [-1.0, 0.0]]), free) is None
    True
    """
    is_free: BoolVector = np.frombuffer(free, np.bool_)
    diagonal = matrix.diagonal / matrix.row_largest
    if (diagonal[is_free] > 0.0).all() or (diagonal[~is_free] < 0.0).any():
        return None
    pairs = _pairs(matrix)
    signs = np.where(is_free, np.sign(diagonal), 1.0)
    _spread(pairs, signs)
    signs[signs == 0.0] = 1.0
    given = np.ones(signs.size)
    if (
        (signs == given).all()
        or not _has_minors(pairs, diagonal, signs)
        or _has_minors(pairs, diagonal, given)
    ):
        return None
    return signs


@fact
def with_row_signs(matrix: Matrix, free: bytes) -> tuple[Matrix, FloatVector] | None:
    """Return diag(s) M, whose residuals are scaled as those of M, and s; None where M stays as it is.

    Examples
    --------
    >>> with_row_signs(Matrix([[2.0, 1.0], [1.0, 0.0]]), np.array([False, True]).tobytes())[0].array
    array([[ 2.,  1.],
           [-1., -0.]])
    """
    signs = monotone_signs(matrix, free)
    if signs is None:
        return None
    M = matrix.array
    if sp.issparse(M):
        turned = Matrix(
            sp.csr_array((M.data * signs[row_numbers(M)], M.indices, M.indptr), shape=M.shape)
        )
    else:
        turned = Matrix(M * signs[:, np.newaxis])
    Matrix.residual_scale.fget.keep(turned, matrix.residual_scale)  # type: ignore[attr-defined]
    return turned, signs


@fact
def why_not_monotone(matrix: Matrix) -> str:
    """Return which of its minors show that M is not monotone, rows multiplied by what positive numbers; '' where none.

    Examples
    --------
    >>> why_not_monotone(Matrix([[1.0, 2.0], [2.0, 1.0]]))
    'M is not monotone (m_ij m_ji > m_ii m_jj for i = 0, j = 1)'
    >>> why_not_monotone(Matrix([[1.0, 2.0], [-2.0, 1.0]]))
    ''
    """
    if matrix.is_distributed:
        return ""
    diagonal = matrix.diagonal / matrix.row_largest
    if (negative := np.flatnonzero(diagonal < 0.0)).size:
        i = int(negative[0])
        return f"M is not monotone (m_ii < 0 for i = {i})"
    pairs = _pairs(matrix)
    found = np.flatnonzero(_exceed(pairs, diagonal, np.ones(diagonal.size)))
    if not found.size:
        return ""
    i, j = int(row_numbers(pairs)[found[0]]), int(pairs.indices[found[0]])
    return f"M is not monotone (m_ij m_ji > m_ii m_jj for i = {i}, j = {j})"


def _pairs(matrix: Matrix) -> sp.csr_array:
    """Return m_ij m_ji beside the rows' largest entries, i ≠ j, as CSR."""
    M = matrix.csr
    M = sp.csr_array(
        (M.data / matrix.row_largest[row_numbers(M)], M.indices, M.indptr), shape=M.shape
    )
    both = sp.coo_array(M.multiply(sp.csr_array(M.T)))
    is_off = (both.row != both.col) & (both.data != 0.0)
    return sp.csr_array((both.data[is_off], (both.row[is_off], both.col[is_off])), shape=M.shape)


def _spread(pairs: sp.csr_array, signs: FloatVector) -> None:
    """Fill in signs that are 0 by what most of their neighbours ask for, from those that are known outwards."""
    wanted, is_open = (
        sp.csr_array((-np.sign(pairs.data), pairs.indices, pairs.indptr), shape=pairs.shape),
        signs == 0.0,
    )
    while is_open.any():
        votes = np.sign(wanted @ signs)
        now = is_open & (votes != 0.0)
        if not now.any():
            return
        signs[now] = votes[now]
        is_open &= ~now


def _has_minors(pairs: sp.csr_array, diagonal: FloatVector, signs: FloatVector) -> bool:
    """Return whether the principal minors of order one and two are ≥ 0."""
    if (signs * diagonal < 0.0).any():
        return False
    return not _exceed(pairs, diagonal, signs).any()


def _exceed(pairs: sp.csr_array, diagonal: FloatVector, signs: FloatVector) -> BoolVector:
    """Return where s_i m_ij s_j m_ji > |m_ii m_jj|, shape (nonzeros,)."""
    rows, own = row_numbers(pairs), np.abs(diagonal)
    exceed: BoolVector = (
        pairs.data * signs[rows] * signs[pairs.indices] > ALMOST * own[rows] * own[pairs.indices]
    )
    return exceed
