"""Problems of several classes with known solutions, at any scale of rows and unknowns, from 2⁻²⁰ to 2²⁰."""

from __future__ import annotations

from typing import Any

import numpy as np

from lcp_plugin import LCP

Entries = np.ndarray


def definite(rng: np.random.Generator, n: int) -> Entries:
    """Symmetric."""
    B = rng.standard_normal((n, n))
    return np.asarray(B @ B.T + 0.5 * np.eye(n))


def monotone(rng: np.random.Generator, n: int) -> Entries:
    """Not symmetric."""
    S = rng.standard_normal((n, n))
    return 0.5 * definite(rng, n) + S - S.T


def dominant(rng: np.random.Generator, n: int) -> Entries:
    """Sparse, rows strictly dominant."""
    B = rng.standard_normal((n, n)) * (rng.random((n, n)) < 0.6)
    np.fill_diagonal(B, 0.0)
    return B + np.diag(1.1 * np.abs(B).sum(axis=1) + 0.1)


def saddle(rng: np.random.Generator, n: int) -> Entries:
    """A KKT form: zeros on a third of the diagonal."""
    m = n // 3
    G = rng.standard_normal((m, n - m))
    return np.block([[definite(rng, n - m) / n, -G.T], [G, np.zeros((m, m))]])


def friction(rng: np.random.Generator, n: int) -> Entries:
    """Pyramids: normal impulses, four directions each, and a multiplier with a zero on the diagonal."""
    c = max(1, n // 6)
    J = rng.standard_normal((5 * c, 3 * c + 2))
    A = J @ J.T + 0.1 * np.eye(5 * c)
    E = np.kron(np.eye(c), np.ones((4, 1)))
    U = np.diag(0.3 + rng.random(c))
    right = np.vstack([np.zeros((c, c)), E])
    return np.block([[A, right], [np.hstack([U, -E.T]), np.zeros((c, c))]])


def game(rng: np.random.Generator, n: int) -> Entries:
    """Zeros on the whole diagonal, in two blocks."""
    k = n // 2
    A, B = rng.random((k, n - k)) + 0.5, rng.random((n - k, k)) + 0.5
    return np.block([[np.zeros((k, k)), A], [B, np.zeros((n - k, n - k))]])


def grid(rng: np.random.Generator, n: int) -> Entries:
    """Five-point differences, 6 × 6."""
    T = 2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1)
    return np.kron(T, np.eye(6)) + np.kron(np.eye(6), T)


def jumps(rng: np.random.Generator, n: int) -> Entries:
    """The same in series with coefficients that jump by 2¹⁰ to 2³⁰."""
    a, M = np.exp2(rng.integers(0, 2, 36) * rng.integers(10, 31)), grid(rng, n)
    off = np.where(M < 0.0, -2.0 / (1.0 / a[:, None] + 1.0 / a), 0.0)
    return off + np.diag(2.0 * a * (M.sum(axis=1) + 0.1) - off.sum(axis=1))


KINDS = [definite, monotone, dominant, saddle, friction, game, grid, jumps]


def answered(kind: Any, seed: int) -> tuple[Entries, Entries, Entries]:
    """M, q and an answer z of size 1, with some rows at their bound."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    M = kind(rng, int(rng.integers(4, 13)))
    is_free = rng.random(len(M)) < 0.6
    is_free[[0, -1]] = True  # so that q is nonzero in both blocks of a game
    sizes = np.exp(rng.uniform(-1.0, 1.0, (2, len(M))))
    z = np.where(is_free, sizes[0], 0.0)
    w = np.where(is_free, 0.0, sizes[1] * np.abs(M).max(axis=1))
    return M, w - M @ z, z


def measured(M: Entries, q: Entries, rows: Entries, units: Entries) -> LCP:
    """Return the problem with scaled rows and unknowns."""
    return LCP(rows[:, None] * M / units, rows * q)


def random_scaling(seed: int, n: int) -> Any:
    """Return scalings of rows and of unknowns, powers of two, shape (2, n)."""
    return np.exp2(np.random.default_rng([seed, 7]).integers(-20, 21, (2, n)))
