"""What every Newton matrix of an interior point does: regularise, factorise, and refine the regularisation away."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...checks import FloatVector

REGULARISATION = 1e-9  # of the equilibrated matrix, on rows without a barrier term of that size
LARGEST_REGULARISATION = 1e-4
REFINEMENTS = 5
USEFUL = 0.1  # a refinement that leaves more of the error than this is not worth another
REFINED = 1e-14


class NewtonMatrix(ABC):
    """M + diag(diagonal), factorised once an iteration; M itself is given, equilibrated, and not modified.

    Attributes
    ----------
    work : float
        Multiplications so far.
    """

    def __init__(self, M: Any) -> None:
        self.M = M
        self.n = M.shape[0]
        self.work = 0.0
        self.regularisation = REGULARISATION
        self._diagonal = np.zeros(self.n)

    def factorise(self, diagonal: FloatVector) -> bool:
        """Factorise with this diagonal, shape (n,), ≥ 0; return False where no regularisation helps."""
        self._diagonal = diagonal
        self.regularisation = max(REGULARISATION, 0.01 * self.regularisation)
        while not self._try(diagonal + self.regularisation):
            self.regularisation *= 100.0
            if self.regularisation > LARGEST_REGULARISATION:
                return False
        return True

    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with (M + diag(diagonal)) x = right, shape (n,), the regularisation refined away where possible."""
        x = self._apply(right)
        goal = REFINED * float(np.max(np.abs(right), initial=0.0))
        left = self._left(right, x)
        error = float(np.max(np.abs(left), initial=0.0))
        for _ in range(REFINEMENTS):
            if not goal < error < np.inf:
                break
            better = x + self._apply(left)
            left = self._left(right, better)
            smaller = float(np.max(np.abs(left), initial=0.0))
            if not smaller < error:
                break
            x, error = better, smaller
        return x

    def _left(self, right: FloatVector, x: FloatVector) -> FloatVector:
        self.work += self._entries
        left: FloatVector = right - self.M @ x - self._diagonal * x
        return left

    def is_useful(self, diagonal: FloatVector) -> bool:
        """Whether a solve leaves a residual of M + diag(diagonal) that refinement can reduce."""
        x = self._apply(np.ones(self.n))
        left = 1.0 - self.M @ x - diagonal * x
        return bool(np.max(np.abs(left), initial=0.0) <= USEFUL)

    @property
    def _entries(self) -> float:
        return float(self.M.nnz if sp.issparse(self.M) else self.M.size)

    @abstractmethod
    def _try(self, diagonal: FloatVector) -> bool:
        """Factorise M + diag(diagonal); return whether that succeeded."""

    @abstractmethod
    def _apply(self, right: FloatVector) -> FloatVector:
        """Return the factor's answer to one right-hand side."""
