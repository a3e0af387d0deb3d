"""What every Newton matrix of an interior point does: regularise, factorise, and refine the regularisation away."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...checks import FloatVector, read_only
from ...kernels.floats import REFINED, REFINEMENTS, STABLE, USEFUL

REGULARISATION = 1e-9  # of the equilibrated matrix, on rows without a barrier term of that size
SMALLEST_REGULARISATION, LARGEST_REGULARISATION = 1e-15, 1e-4
SMALLEST = 1e-300
WORSE = 100.0  # times as large an error, beside its right-hand side, as before a smaller regularisation


class NewtonMatrix(ABC):
    """M + diag(diagonal), factorised once an iteration; M itself is given, equilibrated, and not modified.

    Attributes
    ----------
    work : float
        Multiplications so far.
    missed : float
        The largest error that a solve has left since the last factorisation.
    share : float
        The same beside the largest component of its right-hand side.
    signs : ndarray, shape (n,)
        −1 on the rows whose z is a multiplier of others, else 1.
    """

    def __init__(self, n: int, M: Any = None) -> None:
        self.n, self.M = n, M
        self.work = 0.0
        self.signs = read_only(np.ones(self.n))
        self.regularisation = self._least = REGULARISATION
        self.missed = 0.0
        self.share, self._share_before = 0.0, np.inf
        self._may_sharpen = True
        self._diagonal = np.zeros(self.n)

    def product(self, z: FloatVector) -> FloatVector:
        """Return M z."""
        return np.asarray(self.M @ z)

    def factorise(self, diagonal: FloatVector) -> bool:
        """Factorise with this diagonal, shape (n,), ≥ 0; return False where no regularisation helps."""
        self._diagonal, self.missed, self.share = diagonal, 0.0, 0.0
        self.regularisation = max(self._least, 0.01 * self.regularisation)
        while not self._try(diagonal + self.regularisation):
            self._may_sharpen = False
            self.regularisation *= 100.0
            self._least = min(self.regularisation, REGULARISATION)
            if self.regularisation > LARGEST_REGULARISATION:
                return False
        return True

    def sharpen(self) -> None:
        """Regularise less from the next factorisation on, unless that has failed, or made matters worse, before."""
        if not self._may_sharpen:
            return
        self._may_sharpen = self.share <= WORSE * self._share_before
        self._share_before = self.share
        if self._may_sharpen:
            self._least = max(0.01 * self._least, SMALLEST_REGULARISATION)
        else:
            self._least = min(100.0 * self._least, REGULARISATION)

    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with (M + diag(diagonal)) x = right, shape (n,), the regularisation refined away where possible."""
        x = self._apply(right)
        size = float(np.max(np.abs(right), initial=0.0))
        left, error = self._left(right, x)
        for _ in range(REFINEMENTS):
            if not REFINED * size < error < np.inf:
                break
            better = x + self._apply(left)
            left, smaller = self._left(right, better)
            if not smaller < error:
                break
            x, error = better, smaller
        self.missed, self.share = max(self.missed, error), max(self.share, error / max(size, SMALLEST))
        return x

    def _left(self, right: FloatVector, x: FloatVector) -> tuple[FloatVector, float]:
        """Return what x leaves of the right-hand side, and its largest magnitude."""
        self.work += self._entries
        left = right - self.M @ x - self._diagonal * x
        return left, float(np.max(np.abs(left), initial=0.0))

    def is_useful(self, diagonal: FloatVector) -> bool:
        """Whether a solve leaves a residual of M + diag(diagonal) that refinement can reduce."""
        x = self._apply(np.ones(self.n))
        left = float(np.max(np.abs(1.0 - self.M @ x - diagonal * x), initial=0.0))
        return left <= max(USEFUL, STABLE * float(np.max(np.abs(x), initial=0.0)))

    @property
    def _entries(self) -> float:
        return float(self.M.nnz if sp.issparse(self.M) else self.M.size)

    @abstractmethod
    def _try(self, diagonal: FloatVector) -> bool:
        """Factorise M + diag(diagonal); return whether that succeeded."""

    @abstractmethod
    def _apply(self, right: FloatVector) -> FloatVector:
        """Return the factor's answer to one right-hand side."""
