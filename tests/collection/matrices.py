"""By class of matrix: Z, M, H+, singular, nonnegative, copositive; two phases in a porous medium."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from .entry import COTTLE_PANG_STONE, OWN, Entry, infeasible, planted, solvable

CHANDRASEKARAN = (
    "Chandrasekaran, A special case of the complementary pivot problem, Opsearch 7 (1970)"
)


MOTZKIN = "Motzkin, Straus, Maxima for graphs and a new proof of a theorem of Turán, Canadian J. Math. 17 (1965)"
LAUSER = (
    "Lauser, Hager, Helmig, Wohlmuth, A new approach for phase transitions in miscible multi-phase flow in porous "
    "media, Advances in Water Resources 34 (2011)"
)


def entries() -> Iterator[Entry]:
    """Yield small classes, then two phases."""
    yield from _z_matrices()
    yield from _nonnegative()
    yield from _copositive()
    yield from _phases()


def _z_matrices() -> Iterator[Entry]:
    yield solvable(
        "z_least_element", CHANDRASEKARAN, [[1, -1, 0], [-1, 2, -1], [0, -1, 3]], [-1, 2, -3]
    )
    yield solvable("z_singular_m", CHANDRASEKARAN, [[1, -1], [-1, 1]], [1, -1], solution=[0, 1])
    yield infeasible("z_singular_m_infeasible", CHANDRASEKARAN, [[1, -1], [-1, 1]], [1, -2])
    yield solvable("z_negative_diagonal", CHANDRASEKARAN, [[-1, -1], [-2, 1]], [5, -1])
    yield infeasible("z_infeasible", CHANDRASEKARAN, [[1, -2], [-2, 1]], [-1, -1])
    for n in (10, 100):
        generator = np.random.default_rng(n)
        M = -generator.integers(0, 3, (n, n)).astype(float)
        np.fill_diagonal(M, 0.0)
        np.fill_diagonal(M, -M.sum(axis=1))  # rows sum to zero: singular M-matrix
        z = generator.integers(0, 4, n).astype(float)
        yield planted(f"singular_m_{n}", OWN, M, z, (z == 0) * generator.integers(0, 3, n))


def _nonnegative() -> Iterator[Entry]:
    yield solvable(
        "nonnegative_zero_diagonal", OWN, [[0, 2, 1], [1, 0, 1], [1, 3, 0]], [-1, -1, -1]
    )
    yield solvable(
        "nonnegative_one_good_row",
        OWN,
        [[0, 0, 1], [0, 0, 1], [0, 0, 2]],
        [-2, -1, -4],
        solution=[0, 0, 2],
    )
    for n in (8, 40):
        generator = np.random.default_rng(n)
        M = generator.integers(0, 5, (n, n)).astype(float)
        z = generator.integers(0, 3, n)
        yield planted(f"nonnegative_{n}", OWN, M, z, (z == 0) * 2.0)


def _copositive() -> Iterator[Entry]:
    horn = np.array(
        [
            [1, -1, 1, 1, -1],
            [-1, 1, -1, 1, 1],
            [1, -1, 1, -1, 1],
            [1, 1, -1, 1, -1],
            [-1, 1, 1, -1, 1.0],
        ]
    )
    yield solvable(
        "horn_matrix",
        f"Horn's copositive matrix (Hall, Newman 1963); {COTTLE_PANG_STONE}",
        horn,
        [0, 1, 0, 1, 1],
        solution=[0] * 5,
    )
    yield solvable("horn_matrix_negative_right_side", OWN, horn + np.eye(5), [-1, -2, 1, -1, -3])
    yield solvable("motzkin_straus_petersen", MOTZKIN, _petersen() + np.eye(10), [-1] * 10)


def _petersen() -> np.ndarray:
    A = np.zeros((10, 10))
    for k in range(5):
        for a, b in ((k, (k + 1) % 5), (k, k + 5), (k + 5, (k + 2) % 5 + 5)):
            A[a, b] = A[b, a] = 1.0
    return A


def _phases() -> Iterator[Entry]:
    """Pressure (free), saturation (in [0, 1]): upwinded transport behind elliptic pressure; nonsymmetric blocks."""
    for n in (20, 200):
        K = sp.diags_array([-1.0, 3.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
        T = sp.diags_array([-4.0, 5.0], offsets=[-1, 0], shape=(n, n))
        M = sp.bmat(
            [[K, 0.25 * sp.eye_array(n)], [-sp.eye_array(n, k=1) + sp.eye_array(n), T]]
        ).tocsr()
        k = np.arange(n)
        saturation = np.clip(1.0 - (k - n // 3) / 4.0, 0.0, 1.0)
        z = np.concatenate([(n - k) % 7, saturation])
        w = np.concatenate(
            [np.zeros(n), np.where(saturation == 0, k % 3, np.where(saturation == 1, -(k % 2), 0))]
        )
        lower = np.concatenate([np.full(n, -np.inf), np.zeros(n)])
        upper = np.concatenate([np.full(n, np.inf), np.ones(n)])
        yield planted(
            f"two_phases_{2 * n}", f"after {LAUSER}; planted", M, z, w, lower=lower, upper=upper
        )
