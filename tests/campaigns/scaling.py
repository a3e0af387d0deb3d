"""Problems of several classes with known solutions, at any scale of rows and unknowns, from 2⁻²⁰ to 2²⁰."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from inputs.small_families import FAMILIES, Generator, Matrix, definite

from lcp_plugin import LCP


def saddle(n: int, rng: Generator) -> Matrix:
    """A KKT form: zeros on a third of the diagonal."""
    m = n // 3
    G = rng.standard_normal((m, n - m))
    return np.block([[definite(n - m, rng)[0] / n, -G.T], [G, np.zeros((m, m))]])


def jumps(n: int, rng: Generator) -> Matrix:
    """Five-point differences, 6 × 6, in series with coefficients that jump by 2¹⁰ to 2³⁰."""
    T = 2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1)
    M = np.kron(T, np.eye(6)) + np.kron(np.eye(6), T)
    a = np.exp2(rng.integers(0, 2, 36) * rng.integers(10, 31))
    off = np.where(M < 0.0, -2.0 / (1.0 / a[:, None] + 1.0 / a), 0.0)
    return off + np.diag(2.0 * a * (M.sum(axis=1) + 0.1) - off.sum(axis=1))


OWN: dict[str, Callable[[int, Generator], Matrix]] = {"saddle": saddle, "jumps": jumps}
KINDS = ("definite", "semidefinite", "chain", "murty", "friction", "game", *OWN)


def answered(kind: str, seed: int) -> tuple[Matrix, Matrix, Matrix]:
    """M, q and an answer z of size 1, with some rows at their bound."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    n = int(rng.integers(4, 13))
    M = OWN[kind](n, rng) if kind in OWN else FAMILIES[kind](n, rng)[0]
    is_free = rng.random(len(M)) < 0.6
    is_free[[0, -1]] = True  # so that q is nonzero in both blocks of a game
    sizes = np.exp(rng.uniform(-1.0, 1.0, (2, len(M))))
    z = np.where(is_free, sizes[0], 0.0)
    w = np.where(is_free, 0.0, sizes[1] * np.abs(M).max(axis=1))
    return M, w - M @ z, z


def measured(M: Matrix, q: Matrix, rows: Matrix, units: Matrix) -> LCP:
    """Return the problem with scaled rows and unknowns."""
    return LCP(rows[:, None] * M / units, rows * q)


def random_scaling(seed: int, n: int) -> Matrix:
    """Return scalings of rows and of unknowns, powers of two, shape (2, n)."""
    return np.exp2(np.random.default_rng([seed, 7]).integers(-20, 21, (2, n)))
