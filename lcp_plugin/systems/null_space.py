"""Which directions a symmetric positive semidefinite matrix maps to 0, named by a factor that meets pivots near 0."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from ..core.kernels.floats import EPSILON
from ..core.matrix.matrix import Matrix, fact
from ..core.matrix.symmetry import is_nearly_symmetric
from .definiteness import factorised, scaled_to

SHIFT = 1e-12  # beside a unit diagonal: what stands in the place of a pivot of 0
LOOSE = 1e3  # pivots of 0 are n of these shifts, but for a direction that hardly moves the unknown
MOST = 30  # directions: more are no matter of a structure that is not held
MORE = 2  # vectors than small pivots: a pivot may hide a direction
ROUNDS = 5  # each gains the shift beside the least eigenvalue that is not 0
ROUNDING = 2.0**-45  # beside a unit diagonal: what rounding makes of an eigenvalue 0
EQUAL = (
    2.0**-44
)  # of the diagonal: by so much the sum of a row's other entries may differ from it by rounding
CLEAN = 2.0**-50  # what is left of P d, d of length 1, where no round makes it less


def null_space(P: Any) -> FloatVector | None:
    """Return an orthonormal basis of the null space of P to rounding, shape (n, k); None where none is found.

    Parameters
    ----------
    P : ndarray or CSR array, shape (n, n)
        Symmetric, positive semidefinite to rounding.

    Notes
    -----
    P scaled to a unit diagonal plus 10⁻¹² on it is factorised. Pivots that are as small say how many directions there
    may be; so many vectors and two more are solved for, again and again (subspace iteration), until P maps those of
    the smallest Ritz values to rounding. None where P is no such matrix, where a factor would be too large, and beyond
    30 directions, or where P is 0. Cost: one factorisation; where no pivot is small, nothing else.

    References
    ----------
    B. N. Parlett, *The Symmetric Eigenvalue Problem*, SIAM 1998, doi:10.1137/1.9781611971163, §14.

    Examples
    --------
    >>> springs = sp.csr_array([[1.0, -1.0, 0.0], [-1.0, 3.0, -2.0], [0.0, -2.0, 2.0]])
    >>> null_space(springs).round(9).T.tolist()
    [[0.577350269, 0.577350269, 0.577350269]]
    >>> null_space(springs + sp.diags_array([1e-9, 0.0, 0.0])) is None
    True
    """
    diagonal: FloatVector = np.array(P.diagonal())
    empty = np.flatnonzero(diagonal == 0.0)
    if (
        empty.size > min(MOST, diagonal.size - 1)
        or (diagonal < 0.0).any()
        or (empty.size and abs(P[empty]).sum())
    ):
        return None
    filled = np.flatnonzero(diagonal > 0.0)
    if sp.issparse(P) and (known := null_space_by_rows(sp.csr_array(P))) is not None:
        return known if 0 < known.shape[1] <= MOST else None
    alone = np.zeros((diagonal.size, empty.size))
    alone[empty, np.arange(empty.size)] = 1.0
    block = P if not empty.size else P[filled][:, filled]
    found = _of_filled(block, diagonal[filled]) if filled.size else None
    if found is None:
        return alone if empty.size else None
    whole = np.zeros((diagonal.size, found.shape[1]))
    whole[filled] = found
    return np.hstack([alone, whole])


def null_space_by_rows(P: sp.csr_array) -> FloatVector | None:
    """Return the same by the sums of the rows alone, with no column where P is regular; None where these do not say.

    Where no row is less than the sum of its other entries, a component in which one is clearly more is regular
    (Taussky, Amer. Math. Monthly 56, 1949, doi:10.2307/2305561). Without such a row, and without positive entries off
    the diagonal, the component is the Laplacian of a graph, which maps constants to 0.

    Examples
    --------
    >>> null_space_by_rows(sp.csr_array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 5.0]])).round(3).T.tolist()
    [[0.707, 0.707, 0.0]]
    >>> null_space_by_rows(sp.csr_array([[1.0, 2.0], [2.0, 5.0]])) is None
    True
    """
    diagonal: FloatVector = P.diagonal()
    slack = 2.0 * diagonal - abs(P) @ np.ones(diagonal.size)
    if not (slack >= -EQUAL * diagonal).all():
        return None
    from scipy.sparse.csgraph import connected_components

    count, component = connected_components(P, directed=False)
    is_held = np.bincount(component, slack > EQUAL * diagonal, count) > 0.0
    loose = np.flatnonzero(~is_held)
    if not loose.size:
        return np.zeros((diagonal.size, 0))
    if np.count_nonzero(P.data > 0.0) > np.count_nonzero(diagonal > 0.0) or loose.size > MOST:
        return None
    basis: FloatVector = (component[:, None] == loose).astype(np.float64)
    basis /= np.sqrt(basis.sum(axis=0))
    return basis


@fact
def null_space_of(matrix: Matrix) -> FloatVector | None:
    """Return that of a symmetric M, None where there is none or where M is not symmetric."""
    if not is_nearly_symmetric(matrix):
        return None
    return null_space(matrix.array)


def _of_filled(P: Any, diagonal: FloatVector) -> FloatVector | None:
    """Return the same of a P with a positive diagonal."""
    n, scale = diagonal.size, 1.0 / np.sqrt(diagonal)
    unit, shift = scaled_to(P, scale), max(SHIFT, n * EPSILON)
    factor = None if unit is None else factorised(unit, shift)
    if factor is None:
        return None
    if factor.superlu is None:  # whose pivots nobody sees
        count = min(n, MOST)
        x = factor.solve(np.random.default_rng(0).standard_normal(n))
        if x @ (unit @ x) > LOOSE * n * shift * (x @ x):
            return None
    else:
        small = int(np.count_nonzero(factor.superlu.U.diagonal() <= LOOSE * n * shift))
        if not 0 < small <= MOST:
            return None
        count = min(n, small + MORE)
    basis = np.random.default_rng(0).standard_normal((n, count))
    least = np.inf
    for _ in range(ROUNDS):
        basis = np.linalg.qr(factor.solve(basis))[0]
        product = unit @ basis
        values, turn = np.linalg.eigh(basis.T @ product)
        left = np.abs(product @ turn).max(axis=0)
        is_null = (np.abs(values) <= ROUNDING) & (left <= ROUNDING)
        before, least = least, float(left.max(initial=0.0, where=is_null))
        basis = basis @ turn
        if is_null.any() and (least <= CLEAN or least > 0.5 * before):
            break
    if not is_null.any() or (is_null.all() and count < n):
        return None
    return np.asarray(np.linalg.qr(scale[:, None] * basis[:, is_null])[0])
