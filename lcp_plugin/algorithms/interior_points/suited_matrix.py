"""M as interior steps take it: monotone where row factors make it so, its rows and columns of even size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...checks import FloatVector, read_only
from ...crossovers import DENSE_NEWTON_UP_TO
from ...matrix.matrix import Matrix, fact
from ...matrix.symmetry import is_nearly_symmetric, is_symmetric_to_rounding
from .interior_linear_algebra import equilibration, rows_scaled_by, scaled_by
from .monotone_rows import monotone_rows
from .quasidefinite import signs_of
from .symbolic import Symbolic

SPARSE_BELOW = 0.01  # share of the entries: a symmetric M with fewer is not treated as a dense one


@dataclass(frozen=True, eq=False)
class SuitedMatrix:
    """diag(unit · row_factors) M diag(unit), and what is known of it.

    Attributes
    ----------
    M : canonical CSR array or ndarray, shape (n, n)
        Dense where it is symmetric and not too sparse for that.
    row_factors : ndarray, shape (n,), or None
        Powers of two, as of :func:`~.monotone_rows.monotone_rows`.
    unit : ndarray, shape (n,)
        Powers of two.
    signs : ndarray, shape (n,), or None
        Those of a quadratic program, with which M is symmetric.
    is_symmetric : bool
        It could be the matrix of a convex energy, and is dense.
    """

    M: Any
    row_factors: FloatVector | None
    unit: FloatVector
    signs: FloatVector | None
    is_symmetric: bool

    @classmethod
    def of(cls, M: Any, is_mirrored: bool | None = None) -> SuitedMatrix:
        """Return that of M; whether a dense one is its transpose to rounding may be known."""
        M, signs, is_symmetric = _stored(M, is_mirrored)
        r = None if is_symmetric else monotone_rows(M)
        if r is not None:
            M = rows_scaled_by(M, r)
            if sp.issparse(M):
                M, signs, is_symmetric = _stored(M)
        c = equilibration(M)
        if c is None:
            return cls(M, r, read_only(np.ones(M.shape[0])), signs, is_symmetric)
        return cls(scaled_by(M, c), r, read_only(c), signs, is_symmetric)

    @cached_property
    def symbolic(self) -> Symbolic | None:
        """Order and pattern of a factor of a sparse M with signs, for all numbers."""
        return Symbolic.of(self.M) if self.signs is not None and sp.issparse(self.M) else None

    @property
    def is_program(self) -> bool:
        """Whether some unknowns are multipliers."""
        return self.signs is not None and bool((self.signs < 0.0).any())


def _stored(M: Any, is_mirrored: bool | None = None) -> tuple[Any, FloatVector | None, bool]:
    """Return M, dense where it is symmetric and not too sparse for that, or else its signs; whether it is both."""
    if not sp.issparse(M):
        is_mirrored = is_symmetric_to_rounding(M) if is_mirrored is None else is_mirrored
        is_symmetric = is_mirrored and float(M.diagonal().min(initial=0.0)) >= 0.0
        return M, None if is_mirrored else signs_of(M), is_symmetric
    signs = signs_of(M)
    is_sparse = M.shape[0] > DENSE_NEWTON_UP_TO or M.nnz <= SPARSE_BELOW * M.shape[0] ** 2
    if is_sparse or (signs is not None and bool((signs < 0.0).any())):
        return M, signs, False
    dense = M.toarray()
    if float(dense.diagonal().min(initial=0.0)) >= 0.0 and is_symmetric_to_rounding(dense):
        return dense, None, True
    return M, signs, False


def suited(matrix: Matrix, kept: NDArray[np.intp] | None = None) -> SuitedMatrix:
    """Return the kept rows and columns, or all, as interior steps take them; those asked for last are known."""
    known, key = _known_parts(matrix), None if kept is None else kept.tobytes()
    found = known.get(key)
    if found is None:
        M = matrix.array
        if kept is None:
            found = SuitedMatrix.of(M, is_nearly_symmetric(matrix) if matrix.is_dense else None)
        else:
            found = SuitedMatrix.of(M[kept][:, kept] if sp.issparse(M) else M[np.ix_(kept, kept)])
        known.clear()
        known[key] = found
    return found


@fact
def _known_parts(matrix: Matrix) -> dict[bytes | None, SuitedMatrix]:
    """Return the part that was asked for last; one, as each may be as large as the matrix."""
    return {}
