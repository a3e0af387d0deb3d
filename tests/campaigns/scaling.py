"""Right and wrong solutions of problems with known solutions, at any scale of rows and unknowns.

Cases of each class are scaled by powers of two from 2⁻²⁰ to 2²⁰. The scaling "smooth" differs little from one
unknown to the next. Points that are right to 10⁻¹⁰ must pass at 1e-8. auto must return the same status in two
scalings, and a SOLVED z must be as accurate as the known solution.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lcp_plugin import LCP, solve
from lcp_plugin.core.certificates.criterion import row_data

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
    A, E, U = (
        J @ J.T + 0.1 * np.eye(5 * c),
        np.kron(np.eye(c), np.ones((4, 1))),
        np.diag(0.3 + rng.random(c)),
    )
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
    z, w = (
        np.where(is_free, sizes[0], 0.0),
        np.where(is_free, 0.0, sizes[1] * np.abs(M).max(axis=1)),
    )
    return M, w - M @ z, z


def measured(M: Entries, q: Entries, rows: Entries, units: Entries) -> LCP:
    """Return the problem with scaled rows and unknowns."""
    return LCP(rows[:, None] * M / units, rows * q)


def random_scaling(seed: int, n: int, kind: str = "mixed") -> tuple[Entries, Entries]:
    """Return scalings of rows and unknowns, powers of two; "smooth" ones vary little."""
    rng = np.random.default_rng([seed, 7])
    rows, units = np.exp2(rng.integers(-20, 21, (2, n)))
    if kind == "smooth":
        ends = rng.uniform(-20.0, 20.0, 2)
        units = np.exp2(np.rint(np.linspace(*ends, n)))
    return rows, units


def is_answer(M: Entries, q: Entries, z: Entries) -> bool:
    """Return whether z solves the problem up to rounding error."""
    return bool(np.abs(np.minimum(z, M @ z + q)).max() <= 1e-12 * np.abs(q).max())


def judged(kind: Any, seed: int, units: str) -> list[str]:
    """Return the failures of a case."""
    M, q, z = answered(kind, seed)
    rng, (rows, of_z) = np.random.default_rng([seed, 1]), random_scaling(seed, z.size, units)
    problem, found = measured(M, q, rows, of_z), []
    near = z * (1.0 + 1e-10 * rng.uniform(-1.0, 1.0, z.size))
    if not row_data(problem).measure_at(near * of_z, None, 1e-8).passes:
        found.append("right refused")
    result = solve(problem)
    if (
        solve(measured(M, q, *random_scaling(seed + 10**6, z.size, units))).status
        is not result.status
    ):
        found.append("other units, another status")
    is_far = result.is_solved and not np.abs(result.z / of_z - z).max() <= 1e-3
    if is_far and not is_answer(M, q, result.z / of_z):
        found.append("SOLVED, but far")
    return found
