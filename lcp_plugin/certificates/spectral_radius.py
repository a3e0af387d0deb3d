"""Spectral radii between two numbers that are both proven, rounding included."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..exact.rounding import compensated_product, lower_end, upper_end
from ..matrix.factors import diagonal_pivot_factor, factor_fits
from ..matrix.matrix import Matrix, fact
from ..matrix.structure import row_numbers

POWER_STEPS = 30
NODA_STEPS = 40
ENOUGH = 1e-9  # relative width at which nobody asks for better
FACTOR_LIMIT = 2_000
UNDERFLOW = 2.0**-1060  # more than what a product of complex numbers loses
COMPLEX_ROUNDING = 8.0  # a complex product or sum errs at most so many times as much as a real one


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
    from scipy.sparse.csgraph import connected_components

    B = sp.csr_array(matrix, copy=True)
    n = B.shape[0]
    if B.nnz == 0:
        return 0.0, 0.0
    _, labels = connected_components(B, directed=True, connection="strong")
    # What leads from block to block is not felt by the radius.
    rows = row_numbers(B)
    data = np.where(labels[rows] == labels[B.indices], B.data, 0.0)
    B = sp.csr_array((data, B.indices, B.indptr), shape=B.shape)
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


def radius_above_one(pivot: Any, numerator: Any, magnitude: Any = None) -> float | None:
    """Return a proven lower bound > 1 of the spectral radius of P⁻¹N, or None where none was found.

    Parameters
    ----------
    pivot, numerator : arrays, shape (n, n)
        P and N, dense.
    magnitude : array, shape (n, n), optional
        Each entry of P and N is right to 8 units in the last place of it; |P| + |N| by default.

    Notes
    -----
    LAPACK proposes eigenvectors X and eigenvalues Λ of P⁻¹N. With Z = PX, Y ≈ Z⁻¹ and E = I − YZ,

        X⁻¹(P⁻¹N)X = Λ + G,   |G| ≤ (I − |E|)⁻¹ |Y| |NX − ZΛ|,

    bounded with rounding counted. The discs of radius r = ‖G‖∞ around the Λ_i hold the eigenvalues, each connected
    group as many as it has discs (Gerschgorin); the group of the largest |Λ_i| reaches at most 2nr further in.
    """
    import scipy.linalg

    P, N = np.asarray(pivot), np.asarray(numerator)
    n = P.shape[0]
    if n == 0 or not (np.isfinite(P).all() and np.isfinite(N).all()):
        return None
    with np.errstate(all="ignore"):
        try:
            values, X = scipy.linalg.eig(np.linalg.solve(P, N))
            Y = np.linalg.inv(P @ X)
        except (np.linalg.LinAlgError, ValueError):  # singular, or eigenvectors that overflow
            return None
        unit = COMPLEX_ROUNDING * (n + 16) * 2.0**-52
        Z = P @ X
        size = np.abs(P) + np.abs(N) if magnitude is None else magnitude
        around = unit * (size @ np.abs(X)) + n * UNDERFLOW  # of Z and of N X
        residual = np.abs(N @ X - Z * values) + unit * (np.abs(Z) + around) * np.abs(values)
        residual += around * (1.0 + np.abs(values))
        error = np.abs(np.eye(n) - Y @ Z) + unit * (np.abs(Y) @ np.abs(Z) + np.eye(n)) + np.abs(Y) @ around
        spread = float(np.abs(error).sum(axis=1).max())
        if not spread < 0.5:
            return None
        G = np.abs(Y) @ residual
        disc = float(G.sum(axis=1).max()) / (1.0 - spread) * (1.0 + unit)
        lower = float(np.abs(values).max()) * (1.0 - unit) - 2.0 * n * disc
    return lower if lower > 1.0 else None


@fact
def jacobi_radius(matrix: Matrix) -> tuple[float, float]:
    """Return bounds of the spectral radius of |L + U|."""
    return nonnegative_radius(abs(matrix.csr - sp.diags_array(matrix.diagonal)))
