"""Families on which pivoting may need exponentially many steps, in either orientation, and their relatives."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .entry import MURTY_BOOK, OWN, Entry, planted, solvable

MURTY = "Murty, Computational complexity of complementary pivot methods, Math. Programming Study 7 (1978)"
FATHI = (
    "Fathi, Computational complexity of LCPs associated with positive definite symmetric matrices, "
    "Math. Programming 17 (1979)"
)
CSIZMADIA = (
    "Csizmadia, New pivot based methods in linear optimization, and an application in petroleum industry, "
    "PhD thesis, ELTE Budapest 2007"
)
HILBERT = f"{OWN}: the Hilbert matrix"

Matrix = NDArray[np.float64]
SIZES = (2, 3, 8, 20, 50, 100, 200)


def entries() -> Iterator[Entry]:
    """Yield Murty, Fathi and Csizmadia to n = 200, then other triangular and ill-conditioned ones."""
    for n in SIZES:
        twos = murty_matrix(n)
        yield solvable(f"murty_upper_{n}", MURTY, twos.T, -np.ones(n), solution=unit(n, n - 1))
        yield solvable(f"murty_lower_{n}", MURTY, twos, -np.ones(n), solution=unit(n, 0))
        yield solvable(f"fathi_{n}", FATHI, twos @ twos.T, -np.ones(n), solution=unit(n, 0))
        yield solvable(
            f"fathi_reversed_{n}", FATHI, twos.T @ twos, -np.ones(n), solution=unit(n, n - 1)
        )
    for n in (3, 20, 50):
        doubling = [2**k for k in range(n)]
        yield solvable(
            f"csizmadia_{n}", CSIZMADIA, csizmadia_matrix(n), -np.ones(n), solution=doubling
        )
        yield solvable(
            f"csizmadia_reversed_{n}",
            CSIZMADIA,
            csizmadia_matrix(n).T,
            -np.ones(n),
            solution=doubling[::-1],
        )
    for n in (100, 200):
        z = np.zeros(n)
        z[[0, n // 2, n - 1]] = 1.0, 2.0, 3.0
        for name, M in (("", csizmadia_matrix(n)), ("_reversed", csizmadia_matrix(n).T)):
            yield planted(f"csizmadia{name}_{n}", f"{CSIZMADIA}; planted", M, z, (z == 0) * 1.0)
    for n in (10, 60):
        q = -np.cumsum(2.0 ** -np.arange(n)) if n < 40 else -np.ones(n)
        exact = {10: None}.get(n, [1] + [0] * (n - 1))
        yield solvable(
            f"murty_other_right_side_{n}",
            f"{MURTY_BOOK}, chapter 6",
            murty_matrix(n),
            q,
            solution=exact,
        )
    for n in (5, 8, 12):
        H = scaled_hilbert(n)
        z = np.arange(n) % 3
        yield planted(f"hilbert_{n}", HILBERT, H, z, (z == 0) * 2.0**20)


def murty_matrix(n: int) -> Matrix:
    """Ones on the diagonal, twos below."""
    return np.eye(n) + 2.0 * np.tri(n, k=-1)


def csizmadia_matrix(n: int) -> Matrix:
    """Ones on the diagonal, −1 below: its handicap grows exponentially."""
    return np.eye(n) - np.tri(n, k=-1)


def scaled_hilbert(n: int) -> Matrix:
    """Return 2³⁶/(i + j + 1), rounded to integers, so that planted data are exact."""
    H: Matrix = np.round(2.0**36 / (1.0 + np.add.outer(np.arange(n), np.arange(n))))
    return H


def unit(n: int, k: int) -> list[int]:
    """Return the k-th unit vector."""
    return [int(i == k) for i in range(n)]
