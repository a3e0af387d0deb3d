"""The spectral radius of a nonnegative matrix between two numbers that are both proven, rounding included."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..exact.rounding import compensated_product, lower_end, upper_end
from .factors import diagonal_pivot_factor, factor_fits
from .matrix import Matrix, fact
from .structure import strong_blocks, within_blocks

POWER_STEPS = 30
NODA_STEPS = 40
ENOUGH = 1e-9  # relative width at which nobody asks for better
FACTOR_LIMIT = 2_000


def nonnegative_radius(matrix: Any) -> tuple[float, float]:
    """Return (lower, upper) around the spectral radius of a nonnegative matrix, rigorous (Collatz–Wielandt).

    Parameters
    ----------
    matrix : sparse array, shape (n, n)
        Entries ≥ 0.

    Notes
    -----
    On each strongly connected block, min (Bx)_i/x_i ≤ ρ ≤ max (Bx)_i/x_i for every x > 0; the radius of the whole is
    the largest of the blocks'. x comes from some power steps and, up to n = 2000, from Noda's iteration
    (σI − B)x⁺ = x with σ = max (Bx)_i/x_i: σI − B is an M-matrix, so that small entries of x come out right too.

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
    B = within_blocks(B, labels)  # what leads from block to block is not felt by the radius
    B.eliminate_zeros()
    if B.nnz == 0:
        return 0.0, 0.0
    blocks = _Blocks(B, labels)
    x = blocks.power_steps(np.ones(n))
    best = blocks.bounds(x)
    for better in blocks.noda_steps(x) if n <= FACTOR_LIMIT and factor_fits(B) else ():
        now = blocks.bounds(better)
        best = max(best[0], now[0]), min(best[1], now[1])
        if best[1] - best[0] <= ENOUGH * best[1]:
            break
    return best


class _Blocks:
    """A block diagonal nonnegative matrix with irreducible blocks."""

    def __init__(self, B: Any, labels: Any) -> None:
        self.B = B
        self.order = np.argsort(labels, kind="stable")
        self.starts = np.flatnonzero(np.diff(labels[self.order], prepend=-1))
        self.sizes = np.diff(self.starts, append=labels.size)

    def power_steps(self, x: FloatVector) -> FloatVector:
        """Return x after some steps of B plus a shift, which keeps bipartite graphs from swinging."""
        with np.errstate(all="ignore"):
            for _ in range(POWER_STEPS):
                product = self.B @ x
                shift = 0.5 * float(np.max(product / x))
                new = product + shift * x
                new = new / new.max()
                if not (np.isfinite(new).all() and new.min() > 1e-200):
                    break
                x = new
        return x

    def noda_steps(self, x: FloatVector) -> Iterator[FloatVector]:
        """Yield x after each step of Noda's iteration, all blocks at once, until a factor is singular."""
        for _ in range(NODA_STEPS):
            with np.errstate(all="ignore"):
                ratio = (self.B @ x) / x
                largest = np.maximum.reduceat(ratio[self.order], self.starts) * (1.0 + 1e-12)
            shift = np.empty_like(x)
            shift[self.order] = np.repeat(np.maximum(largest, 1e-300), self.sizes)
            factor = diagonal_pivot_factor(sp.diags_array(shift) - self.B)
            if factor is None:  # σ is ρ up to rounding
                return
            x = factor.solve(x)
            highest = np.maximum.reduceat(x[self.order], self.starts)
            with np.errstate(all="ignore"):
                x[self.order] /= np.repeat(highest, self.sizes)
            if not (np.isfinite(x).all() and x.min() > 0.0):
                return
            yield x

    def bounds(self, x: FloatVector) -> tuple[float, float]:
        """Return the two bounds for x > 0, over all blocks."""
        value, radius = compensated_product(self.B, x)
        with np.errstate(all="ignore"):
            low = np.nextafter(lower_end(value, radius) / x, -np.inf)
            high = np.nextafter(upper_end(value, radius) / x, np.inf)
        lowest = np.minimum.reduceat(low[self.order], self.starts)
        highest = np.maximum.reduceat(high[self.order], self.starts)
        return max(0.0, float(np.nanmax(lowest))), float(np.max(highest))


@fact
def jacobi_radius(matrix: Matrix) -> tuple[float, float]:
    """Return bounds of the spectral radius of |L + U|."""
    return nonnegative_radius(abs(matrix.csr - sp.diags_array(matrix.diagonal)))
