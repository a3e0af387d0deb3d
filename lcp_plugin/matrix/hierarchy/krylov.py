"""Krylov steps on the free rows, preconditioned by one V-cycle each."""

from __future__ import annotations

import numpy as np

from ...checks import FloatVector, read_only
from . import sweeps, transfers
from .truncation import Truncation
from .vectors import add_both, add_within, dot, largest_product, power_of_two, span


class KrylovCorrection:
    """An approximate c with (M c)_F = residual_F and c = 0 elsewhere, improved step by step.

    Conjugate gradients where M is symmetric, otherwise generalised conjugate residuals with all directions kept: they
    make the residual least in the norm of its rows divided by the diagonal, which may have any unit.

    Parameters
    ----------
    truncation : Truncation
        Seen from its finest grid; its free rows are F.
    residual : ndarray, shape (n,)
        −w on the free rows, 0 elsewhere; overwritten by what is left of it.
    is_symmetric : bool
    transposed : bool
        Mᵀ in the place of M, by the rows of M; one process has them all.
    """

    def __init__(
        self, truncation: Truncation, residual: FloatVector, is_symmetric: bool, *, transposed: bool = False
    ) -> None:
        self.truncation, self.residual, self.is_symmetric = truncation, residual, is_symmetric
        self.transposed = transposed and not is_symmetric
        self.peers = truncation.grids[0].grid.peers
        # Squares of very large or small numbers leave the range of a double.
        self.unit = power_of_two(self.peers.largest(span(residual)))
        self.residual /= self.unit
        inverse = truncation.grids[0].inverse
        # A transposed V-cycle divides by the diagonal last.
        scaled = 1.0 if self.transposed else self.peers.largest(largest_product(residual, inverse))
        truncation.unit = power_of_two(scaled)
        self._weight = (inverse / self.peers.largest(span(inverse))) ** 2 if self._weighs(transposed) else None
        self._sum = truncation.vector()
        self._sum[:] = 0.0
        self.directions: list[tuple[FloatVector, FloatVector, float]] = []

    def give_back(self) -> None:
        """Leave the room of all vectors to the next correction; this one has ended."""
        self.truncation.spare.append(self._sum)
        self._forget_directions()

    def apply_within(
        self, origin: FloatVector, lower: FloatVector, upper: FloatVector, z: FloatVector
    ) -> None:
        """Overwrite z by mid(lower, upper, origin + c)."""
        add_within(origin, self.unit, self._sum, read_only(lower), read_only(upper), z)

    def apply_to(self, origin: FloatVector, z: FloatVector) -> None:
        """Overwrite z by origin + c."""
        np.multiply(self._sum, self.unit, out=z)
        z += origin

    def largest(self) -> float:
        """Return the largest scaled residual that is left."""
        scaled = largest_product(self.residual, self.truncation.grids[0].inverse)
        return self.unit * self.peers.largest(scaled)

    @np.errstate(all="ignore")
    def step(self) -> bool:
        """Take one step; return False where the matrix allows none."""
        top = self.truncation.grids[0]
        matrix = top.grid.matrix
        top.b = self.residual
        p, product = self.truncation.vector(), self.truncation.vector()
        if self.transposed:
            self.truncation.correct_transposed(0)
            np.copyto(p, top.x)
            product[:] = 0.0
            transfers.add_transposed_product(*matrix.arrays, 1.0, p, product)
            product *= top.is_free
        else:
            self.truncation.correct(0)
            np.copyto(p, top.x[: top.grid.n])
            self.peers.fetch(top.x)
            sweeps.free_product(top.rows, top.inverse, top.x, product)
        self.truncation.work += matrix.data.size
        for old_p, old_product, old_scale in self.directions:
            share = self._dot(self._against(old_p, old_product), product) / old_scale
            add_both(-share, old_p, p, -share, old_product, product)
        against = self._against(p, product)
        scale = self._dot(against, product)
        length = self._dot(against, self.residual) / scale if scale > 0.0 else np.nan
        if not np.isfinite(length):
            return False
        add_both(length, p, self._sum, -length, product, self.residual)
        if self.is_symmetric:
            self._forget_directions()
        self.directions.append((p, product, scale))
        return True

    def _forget_directions(self) -> None:
        for p, product, _ in self.directions:
            self.truncation.spare += [p, product]
        self.directions.clear()

    def _dot(self, one: FloatVector, other: FloatVector) -> float:
        return self.peers.total(dot(one, other))

    def _weighs(self, transposed: bool) -> bool:
        return not (self.is_symmetric or transposed)

    def _against(self, p: FloatVector, product: FloatVector) -> FloatVector:
        if self.is_symmetric:
            return p
        return product if self._weight is None else product * self._weight
