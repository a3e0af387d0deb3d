"""Whether a matrix is its transpose, entry by entry to rounding, and how strong couplings are both ways together."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector, read_only
from ..kernels.threads import share
from .joint_facts import has_symmetric_products
from .matrix import Matrix, fact

UNNOTICED = 1e-12  # relative asymmetry of an entry that conjugate gradients do not notice
SHARED_ROWS = 16_384  # rows that are worth a hand-over
NO_DATA = np.zeros(0)


def is_symmetric_entrywise(M: Any) -> bool:
    """Return whether a CSR array with sorted rows has the pattern of its transpose, and its entries to 1e-12.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> is_symmetric_entrywise(sp.csr_array([[2.0, 1e-9], [1e-9, 2.0]]))
    True
    >>> is_symmetric_entrywise(sp.csr_array([[2.0, 1e-20], [0.0, 2.0]]))
    False
    """
    return is_mirrored(M.indptr[:-1], M.indptr[1:], M.indices, M.data)


def is_mirrored(begin: Any, last: Any, indices: Any, data: FloatVector = NO_DATA) -> bool:
    """Return whether row i has column j wherever j has i, with the same entry to 1e-12 where there are data.

    Row i holds the columns indices[begin[i]:last[i]], sorted. Where each entry right of the diagonal has its mirror,
    and there are no more on the left, all have.
    """
    from ..kernels.rows import unmirrored

    operands = *map(read_only, (begin, last, indices, data)), UNNOTICED
    return bool(sum(share(partial(unmirrored, *operands), last.size, SHARED_ROWS)) == 0)


@fact
def has_symmetric_entries(matrix: Matrix) -> bool:
    """Return whether M is symmetric up to rounding: entry by entry, or on several ranks by two products.

    For x and y of arbitrary entries xᵀM y = yᵀM x happens by chance with probability 0. A wrong answer would cost
    speed, not correctness: every z is judged by its residual.
    """
    if matrix.processes > 1:
        return has_symmetric_products(matrix)
    return is_symmetric_entrywise(matrix.csr_rows)


@fact
def mean_coupling(matrix: Matrix) -> float:
    """Return max_i Σ_{j≠i} √(|m_ij m_ji| / (m_ii m_jj)); ∞ without a positive diagonal, and on several ranks.

    No scaling of rows or columns changes it. Of a tridiagonal M, and of any whose |m_ij / m_ji| are those of a scaling
    D, it is the largest row sum of D⁻¹J D for some D, J = |I − diag(M)⁻¹M|: no less than the spectral radius of J,
    however strong a flow makes m_ij beside m_ji.

    Examples
    --------
    >>> flow = np.array([[20.0, -1.0, 0.0], [-19.0, 20.0, -1.0], [0.0, -19.0, 20.0]])
    >>> round(mean_coupling(Matrix(flow)), 3)
    0.436
    """
    diagonal = matrix.diagonal
    if matrix.processes > 1 or not (diagonal > 0.0).all():
        return np.inf
    with np.errstate(all="ignore"):
        M, root = matrix.csr, np.sqrt(diagonal)
        both = sp.csr_array(abs(M).multiply(abs(M).T))
        both.setdiag(0.0)
        return float(((np.sqrt(both) @ (1.0 / root)) / root).max(initial=0.0))
