"""How interior points go for the minimum of a program: what is tried in turn where steps end without it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from .newton_matrix import NewtonMatrix, SparseNewtonMatrix
from .quasidefinite import newton_matrix
from .suited_matrix import SuitedMatrix

MOST_TO_PIVOT = 1e7  # entries of L beyond which no factor with pivots is tried


class Attempt(NamedTuple):
    """How steps of a program are made, where others before have not led to its minimum.

    Attributes
    ----------
    weight : float
        How much larger its multipliers are beside its distances at the start.
    ridge : float
        Added to the diagonal of its unknowns, in the units of the steps: where the minimisers reach to infinity, it
        chooses those near 0.
    is_pivoting : bool
        LU with pivots instead of LDLᵀ, which loses a P of low rank behind many small pivots.
    """

    weight: float
    ridge: float = 0.0
    is_pivoting: bool = False

    def matrix(self, suited: SuitedMatrix, is_symmetric: bool) -> NewtonMatrix:
        """Return the Newton matrix, with the factor that is asked for where that is not too large."""
        M, symbolic, signs = suited.M, suited.symbolic, suited.signs
        if self.ridge:
            ridge = np.where(np.asarray(signs) > 0.0, self.ridge, 0.0)
            M = sp.csr_array(M + sp.diags_array(ridge)) if sp.issparse(M) else M + np.diag(ridge)
        if self.is_pivoting and symbolic is not None and symbolic.entries <= MOST_TO_PIVOT:
            return SparseNewtonMatrix(M, signs)
        return newton_matrix(M, is_symmetric, signs, symbolic)


ATTEMPTS = Attempt(1.0), Attempt(1.0, ridge=1e-10, is_pivoting=True), Attempt(1e4, is_pivoting=True)
