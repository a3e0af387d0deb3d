"""The comparison matrix ⟨M⟩, equilibrated, and approximate solutions of systems with it.

No solution is rigorous: those who ask verify it (:mod:`lcp_plugin.proofs.verdicts`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.checks import Vector
from ..core.matrix import ROUNDED, Exponents, mismatch, scale_matrix, times_power
from .equilibration import scaling_exponents
from .factors import dense_lu, diagonal_pivot_factor, factor_fits
from .graph import comparison_of
from .hierarchy.levels import build_hierarchy
from .hierarchy.truncation import KrylovCorrection, Truncation

if TYPE_CHECKING:
    from .hierarchy.grids import Hierarchy

Solver = Callable[[Vector], Vector]


class ComparisonMatrix:
    """⟨M⟩ scaled by powers of two to a diagonal near 1 if M needs it, and approximate solutions of its systems.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        Matrix with a nonzero diagonal.

    Attributes
    ----------
    matrix : CSR array, shape (n, n)
        ⟨M⟩ with entries scaled by 2^(row_i + column_j).
    exponents : Exponents or None
        None if nothing was scaled.
    diagonal : array, shape (n,)
        Diagonal of `matrix`, positive.
    """

    def __init__(self, M: Any) -> None:
        self.is_symmetric = mismatch(M, np.abs(M.diagonal()), ROUNDED)[1] is None
        self.exponents: Exponents | None = scaling_exponents(M, self.is_symmetric)
        self.matrix = scale_matrix(comparison_of(M), self.exponents)
        self.diagonal: Vector = self.matrix.diagonal()
        self._multigrid_failed = False

    @cached_property
    def hierarchy(self) -> Hierarchy:
        """The grids of the matrix."""
        return build_hierarchy(self.matrix)

    @cached_property
    def direct_solver(self) -> Solver | None:
        """Rhs ↦ matrix⁻¹ rhs by a factorization; None if the matrix is singular or too large."""
        if not factor_fits(self.matrix):
            return None
        # A dense LU of so few rows is faster than a sparse one.
        is_small = self.matrix.shape[0] <= 300
        factor = dense_lu(self.matrix.toarray()) if is_small else diagonal_pivot_factor(self.matrix)
        return None if factor is None else factor.solve

    def solve(self, rhs: Vector, tolerance: float = 0.1) -> Vector | None:
        """Return an approximate solution, shape (n,), or None if no method applies.

        The matrix is then singular, or too large for a factorization if multigrid fails. `tolerance` bounds
        ‖residual‖₂/‖rhs‖₂ if the solution is iterative.
        """
        # Below, a sparse LU is as fast as a hierarchy.
        if rhs.size > 5_000 and not self._multigrid_failed:
            x = self.iterated(rhs, tolerance)
            if x is not None:
                return x
            self._multigrid_failed = True
        return None if self.direct_solver is None else _finite(np.asarray(self.direct_solver(rhs)))

    def iterated(self, rhs: Vector, tolerance: float) -> Vector | None:
        """Return x with ‖rhs − matrix x‖₂ ≤ tolerance ‖rhs‖₂ by Krylov steps, or None within a number of them."""
        correction = KrylovCorrection(Truncation(self.hierarchy), rhs.copy(), self.is_symmetric)
        goal = tolerance * np.linalg.norm(correction.residual)
        for _ in range(60):
            if not np.linalg.norm(correction.residual) > goal or not correction.step():
                break
        is_near = np.linalg.norm(correction.residual) <= goal
        return _finite(correction.solution) if is_near else None

    def to_caller(self, x: Vector) -> Vector:
        """Return the unscaled vector for a vector x of the scaled matrix, shape (n,)."""
        return times_power(x, None if self.exponents is None else self.exponents.column)


def _finite(x: Vector) -> Vector | None:
    return x if np.isfinite(x).all() else None
