"""Small examples of textbooks and papers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .entry import MURTY_BOOK, OWN, Entry, infeasible, planted, solvable, without_solution

HANDBOOK = (
    "Floudas, Pardalos et al., Handbook of Test Problems in Local and Global Optimization, Kluwer 1999, chapter 10, "
    "doi:10.1007/978-1-4757-3040-1"
)
KOSTREVA = "Kostreva, Cycling in linear complementarity problems, Math. Programming 16 (1979)"
MORRIS = "Morris, Randomized pivot algorithms for P-matrix linear complementarity problems, Math. Programming 92 (2002)"
BEN_GHARBIA = (
    "Ben Gharbia, Gilbert, Nonconvergence of the plain Newton-min algorithm for linear complementarity problems with a "
    "P-matrix, Math. Programming 134 (2012)"
)
AHN = (
    "Ahn, Iterative methods for linear complementarity problems with upperbounds on primary variables, "
    "Math. Programming 26 (1983)"
)
GEIGER_KANZOW = "Geiger, Kanzow, On the resolution of monotone complementarity problems, Comput. Optim. Appl. 5 (1996)"


def entries() -> Iterator[Entry]:
    """Yield the examples of books, then the cycling ones, then degenerate sizes."""
    yield from _books()
    yield from _cycling()
    yield from _newton_min()
    yield from _tridiagonal()


def _books() -> Iterator[Entry]:
    M = [[1, -1, -1, -1], [-1, 1, -1, -1], [1, 1, 2, 0], [1, 1, 0, 2]]
    yield solvable("murty_example_2_8", f"{MURTY_BOOK}, example 2.8", M, [3, 5, -9, -5])
    M = [[-1, 0, -3], [1, -2, -5], [-2, -1, -2]]
    yield infeasible(
        "murty_example_2_9", f"{MURTY_BOOK}, example 2.9 (ray termination)", M, [-3, -2, -1]
    )
    M = [[0, -1, 2], [2, 0, -2], [-1, 1, 0]]
    yield solvable("handbook_n3", HANDBOOK, M, [-3, 6, -1], solution=[0, 1, 3])
    M = [[0, 0, 10, 20], [0, 0, 30, 15], [10, 20, 0, 0], [30, 15, 0, 0]]
    yield solvable(
        "handbook_bimatrix", HANDBOOK, M, [-1] * 4, solution=["1/90", "2/45", "1/90", "2/45"]
    )
    M = [[11, 0, 10, -1], [0, 11, 10, -1], [10, 10, 11, -1], [1, 1, 1, 0]]
    yield solvable(
        "handbook_quadratic_program", HANDBOOK, M, [50, 50, 23, -6], solution=[0, 0, 6, 89]
    )
    M = [[11, 0, 10, -1], [0, 11, 10, -1], [10, 10, 11, -1], [1, 1, 1, -3]]
    yield without_solution(
        "handbook_quadratic_program_spoilt", f"{OWN}: one entry changed", M, [50, 50, 23, -6]
    )
    yield solvable("all_ones_2", HANDBOOK, np.ones((2, 2)), [-1, -1], solution=[1, 0])
    yield solvable(
        "two_by_two",
        f"{MURTY_BOOK}, chapter 1 (the example of two by two cones)",
        [[2, 1], [1, 2]],
        [-5, -6],
        solution=["4/3", "7/3"],
    )
    yield solvable(
        "three_solutions",
        f"{OWN}: three solutions",
        [[1, 2], [2, 1]],
        [-1, -1],
        solution=["1/3", "1/3"],
    )
    yield solvable("continuum_of_solutions", OWN, [[0, 1], [0, 1]], [-1, -1], solution=[0, 1])
    yield solvable("degenerate_at_zero", OWN, [[1, -1], [-1, 1]], [0, 0], solution=[0, 0])
    yield solvable("copositive_plus", OWN, [[1, 2, -1], [-2, 0, 1], [1, -1, 0]], [-1, 1, 1])
    yield solvable(
        "strictly_copositive", OWN, [[1, -0.5, 4], [-0.5, 1, 4], [4, 4, 1]], [-1, -2, -3]
    )
    yield solvable("lemke_secondary_ray", OWN, [[0, 1], [1, 0]], [-1, -1], solution=[1, 1])
    yield solvable(
        "lemke_ray_of_ones",
        f"{OWN}: Lemke with the vector of ones ends in a ray",
        [[1, 0, 0], [1, -1, 3], [-2, 3, -1]],
        [0, -1, -1],
        solution=[0, "1/2", "1/2"],
    )


def _cycling() -> Iterator[Entry]:
    """A circulant P-matrix on which least-index, Lemke-type and Newton-min rules may cycle; z* = 1/3 everywhere."""
    M = np.array([[1, 2, 0], [0, 1, 2], [2, 0, 1]])
    yield solvable("kostreva_cycle", KOSTREVA, M, [-1] * 3, solution=["1/3"] * 3)
    yield solvable("kostreva_cycle_transposed", KOSTREVA, M.T, [-1] * 3, solution=["1/3"] * 3)
    yield infeasible(
        "cycle_infeasible",
        f"{OWN}, in the manner of Kostreva's second example",
        [[1, -1, 3], [2, -1, 3], [-1, -2, 0]],
        [-1, -1, -1],
    )
    for n in (5, 9, 51, 201):
        circulant = np.eye(n) + 2.0 * np.roll(np.eye(n), 1, axis=1)
        yield solvable(f"morris_{n}", MORRIS, circulant, [-1] * n, solution=["1/3"] * n)


def _newton_min() -> Iterator[Entry]:
    """Circulants I + α S (odd order) and I + α S + β S² (even order): plain Newton-min cycles, M is P."""
    for n, alpha in ((3, 1.5), (3, 8.0), (5, 1.25), (7, 3.0)):
        M = np.eye(n) + alpha * np.roll(np.eye(n), 1, axis=0)
        share = f"{4}/{int(4 * (1 + alpha))}"
        yield solvable(f"newton_min_{n}_{alpha}", BEN_GHARBIA, M, [-1] * n, solution=[share] * n)
    for n, alpha, beta, share in ((4, 0.5, 0.75, "4/9"), (6, -0.75, 1.0, "4/5")):
        M = np.eye(n) + alpha * np.roll(np.eye(n), 1, axis=0) + beta * np.roll(np.eye(n), 2, axis=0)
        yield solvable(
            f"newton_min_{n}_two_bands",
            f"{BEN_GHARBIA}; own numbers",
            M,
            [-1] * n,
            solution=[share] * n,
        )
    yield _joined(12, 4)
    yield _joined(60, 20)


def _joined(n: int, cycles: int) -> Entry:
    """Three-cycles on the diagonal, coupled downwards only: still P; every other block has z = 0."""
    M = np.zeros((n, n))
    for k in range(cycles):
        block = slice(3 * k, 3 * k + 3)
        M[block, block] = np.eye(3) + 2.0 * np.roll(np.eye(3), 1, axis=0)
        M[3 * k, : 3 * k] = -1.0
    z = np.repeat(np.arange(cycles) % 2 == 0, 3) * 1.0
    return planted(f"newton_min_joined_{n}", f"{BEN_GHARBIA}, extended", M, z, 1.0 - z)


def _tridiagonal() -> Iterator[Entry]:
    for n in (8, 64, 200):
        M = 4.0 * np.eye(n) - 2.0 * np.eye(n, k=1) + np.eye(n, k=-1)
        yield planted(
            f"ahn_{n}", f"{AHN}; planted", M, np.arange(n) % 3, (np.arange(n) % 3 == 0) * 2.0
        )
    for n in (8, 128):
        M = 4.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        z = (np.arange(n) % 4).astype(float)
        yield planted(f"geiger_kanzow_{n}", f"{GEIGER_KANZOW}; planted", M, z, (z == 0.0) * 1.0)
    yield solvable(
        "geiger_kanzow_ones",
        GEIGER_KANZOW,
        4 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1),
        [-1] * 3,
        solution=["5/14", "3/7", "5/14"],
    )
