"""Conjugate gradients, or generalized conjugate residuals, on the free rows; one V-cycle preconditions a step."""

from __future__ import annotations

import numpy as np

from ..core.checks import FloatVector
from ..systems.equilibration import power_of_two
from ..systems.hierarchy import sweeps
from ..systems.hierarchy.vectors import dot, largest_product, span
from .hierarchy import TruncationOnRanks


class Krylov:
    """An approximate c with (M c)_F = residual_F and c = 0 elsewhere, improved step by step.

    Parameters
    ----------
    truncation : Truncation
        Truncated problem; its free rows are F.
    residual : array, shape (own,)
        −w on the free rows, 0 elsewhere; overwritten by the remaining residual.
    is_symmetric : bool
        Conjugate gradients then; otherwise all directions are kept, and the residual is least in the norm of rows
        divided by their diagonal entries.
    """

    def __init__(
        self, truncation: TruncationOnRanks, residual: FloatVector, is_symmetric: bool
    ) -> None:
        self.truncation, self.residual, self.is_symmetric = truncation, residual, is_symmetric
        self.halo = truncation.grids[0].grid.halo
        # Squares of very large or small numbers leave the range of a double.
        self.unit: float = power_of_two(self.halo.largest(span(residual)))
        self.residual /= self.unit
        inverse = truncation.grids[0].inverse
        self._weight = (inverse / self.halo.largest(span(inverse))) ** 2
        self._sum = np.zeros(residual.size)
        self._directions: list[tuple[FloatVector, FloatVector, float]] = []

    def correction(self) -> FloatVector:
        """Return c, shape (own,)."""
        return self.unit * self._sum

    def largest(self) -> float:
        """Return the largest scaled residual that is left."""
        scaled = largest_product(self.residual, self.truncation.grids[0].inverse)
        return self.unit * self.halo.largest(scaled)

    def step(self) -> bool:
        """Take one step; return False if the matrix allows none."""
        top = self.truncation.grids[0]
        n = top.grid.n
        top.b = self.residual
        self.truncation.correct()
        self.halo.fetch(top.x)
        p, product = top.x[:n].copy(), np.empty(n)
        sweeps.free_product(top.rows, top.inverse, top.x, product)
        self.truncation.work += top.values.size
        for old_p, old_product, old_scale in self._directions:
            share = self._dot(self._against(old_p, old_product), product) / old_scale
            p -= share * old_p
            product -= share * old_product
        against = self._against(p, product)
        scale = self._dot(against, product)
        length = self._dot(against, self.residual) / scale if scale > 0.0 else np.nan
        if not np.isfinite(length):
            return False
        self._sum += length * p
        self.residual -= length * product
        if self.is_symmetric:
            self._directions.clear()
        self._directions.append((p, product, scale))
        return True

    def _dot(self, one: FloatVector, other: FloatVector) -> float:
        return self.halo.total(dot(one, other))

    def _against(self, p: FloatVector, product: FloatVector) -> FloatVector:
        return p if self.is_symmetric else product * self._weight
