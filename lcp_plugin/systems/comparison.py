"""The comparison matrix ⟨M⟩, equilibrated, and approximate solutions of systems with it.

No solution is rigorous: those who ask verify it (:mod:`.h_matrix`). The two bounds of the spectral radius of a
nonnegative matrix are, rounding included.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import Vector
from ..core.matrix import ROUNDED, Exponents, Matrix, fact, mismatch, scale_matrix, times_power
from ..core.rounding import compensated_product, lower_end, upper_end
from .equilibration import scaling_exponents
from .factors import dense_lu, diagonal_pivot_factor, factor_fits
from .graph import comparison_of, strong_blocks, within_blocks
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
        if not np.linalg.norm(correction.residual) <= goal:
            return None
        x = np.empty(rhs.size)
        correction.apply_to(np.zeros(rhs.size), x)
        return _finite(x)

    def to_caller(self, x: Vector) -> Vector:
        """Return the unscaled vector for a vector x of the scaled matrix, shape (n,)."""
        return times_power(x, None if self.exponents is None else self.exponents.column)


def _finite(x: Vector) -> Vector | None:
    return x if np.isfinite(x).all() else None


def nonnegative_radius(matrix: Any) -> tuple[float, float]:
    """Return (lower, upper) around the spectral radius of a nonnegative matrix, rigorous (Collatz–Wielandt).

    Parameters
    ----------
    matrix : sparse array, shape (n, n)
        Entries ≥ 0.

    Notes
    -----
    On each strongly connected block, min (Bx)_i/x_i ≤ ρ ≤ max (Bx)_i/x_i for every x > 0. The radius of B is the
    largest radius of a block. Power steps compute x, followed up to n = 2000 by Noda's iteration (σI − B)x⁺ = x with
    σ = max (Bx)_i/x_i. Small entries of x are also accurate then, because σI − B is an M-matrix.

    References
    ----------
    Berman, Plemmons, *Nonnegative Matrices in the Mathematical Sciences*, SIAM 1994, doi:10.1137/1.9781611971262.
    Noda, *Note on the computation of the maximal eigenvalue of a non-negative irreducible matrix*, Numer. Math. 17
    (1971), doi:10.1007/BF01436087.

    Examples
    --------
    >>> lower, upper = nonnegative_radius(sp.csr_array(np.array([[0.0, 4.0], [1.0, 0.0]])))
    >>> lower <= 2.0 <= upper <= lower + 1e-6
    True
    """
    B = sp.csr_array(matrix, copy=True)
    B.eliminate_zeros()
    n = B.shape[0]
    _, labels = strong_blocks(B)
    B = within_blocks(B, labels)  # entries between blocks do not change the radius
    B.eliminate_zeros()
    if B.nnz == 0:
        return 0.0, 0.0
    blocks = _IrreducibleBlocks(B, labels)
    x = blocks.power_steps(np.ones(n))
    best = blocks.bounds(x)
    for better in blocks.noda_steps(x) if n <= 2_000 and factor_fits(B) else ():
        now = blocks.bounds(better)
        best = max(best[0], now[0]), min(best[1], now[1])
        # The enclosure is narrow enough.
        if best[1] - best[0] <= 1e-9 * best[1]:
            break
    return best


class _IrreducibleBlocks:
    """Block diagonal nonnegative matrix with irreducible blocks."""

    def __init__(self, B: Any, labels: Any) -> None:
        self.B = B
        self.order = np.argsort(labels, kind="stable")
        self.starts = np.flatnonzero(np.diff(labels[self.order], prepend=-1))
        self.sizes = np.diff(self.starts, append=labels.size)

    def power_steps(self, x: Vector) -> Vector:
        """Return x after some steps of B plus a shift, which keeps bipartite graphs from swinging."""
        for _ in range(30):
            product = self.B @ x
            shift = 0.5 * float(np.max(product / x))
            new = product + shift * x
            new = new / new.max()
            if not (np.isfinite(new).all() and new.min() > 1e-200):
                break
            x = new
        return x

    def noda_steps(self, x: Vector) -> Iterator[Vector]:
        """Yield x after each step of Noda's iteration, all blocks at once, until a shifted matrix is singular."""
        for _ in range(40):
            ratio = (self.B @ x) / x
            largest = np.maximum.reduceat(ratio[self.order], self.starts) * (1.0 + 1e-12)
            shift = np.empty_like(x)
            shift[self.order] = np.repeat(np.maximum(largest, 1e-300), self.sizes)
            factor = diagonal_pivot_factor(sp.diags_array(shift) - self.B)
            if factor is None:  # σ is ρ up to rounding
                return
            x = factor.solve(x)
            highest = np.maximum.reduceat(x[self.order], self.starts)
            x[self.order] /= np.repeat(highest, self.sizes)
            if not (np.isfinite(x).all() and x.min() > 0.0):
                return
            yield x

    def bounds(self, x: Vector) -> tuple[float, float]:
        """Return the two bounds for x > 0, over all blocks."""
        value, radius = compensated_product(self.B, x)
        low = np.nextafter(lower_end(value, radius) / x, -np.inf)
        high = np.nextafter(upper_end(value, radius) / x, np.inf)
        lowest = np.minimum.reduceat(low[self.order], self.starts)
        highest = np.maximum.reduceat(high[self.order], self.starts)
        return max(0.0, float(np.nanmax(lowest))), float(np.max(highest))


@fact
def jacobi_radius(matrix: Matrix) -> tuple[float, float]:
    """Return bounds of the spectral radius of |L + U|."""
    return nonnegative_radius(abs(matrix.csr - sp.diags_array(matrix.diagonal)))
