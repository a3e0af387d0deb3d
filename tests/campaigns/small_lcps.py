"""Random small problems of all kinds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lcp_plugin import LCP

Matrix = np.ndarray
Generator = np.random.Generator

LARGEST = 6


# --- The problems ---------------------------------------------------------------------------------------------------


def integers(n: int, rng: Generator) -> Matrix:
    spread = int(rng.integers(1, 6))
    return rng.integers(-spread, spread + 1, (n, n)).astype(float)


def factor(n: int, rng: Generator, columns: int) -> Matrix:
    return rng.integers(-3, 4, (n, columns)).astype(float)


def skew(n: int, rng: Generator) -> Matrix:
    upper = np.triu(integers(n, rng), 1)
    return upper - upper.T


def p_matrix(n: int, rng: Generator) -> Matrix:
    """By rejection, now and then triangular."""
    while True:
        M = integers(n, rng) + np.diag(rng.integers(1, 6, n)).astype(float)
        if all(np.linalg.det(M[np.ix_(rows, rows)]) > 0.5 for rows in subsets(n)):
            return M
        if rng.random() < 0.3:
            return np.tril(integers(n, rng), -1) + np.diag(rng.integers(1, 4, n))


def subsets(n: int) -> list[list[int]]:
    return [[i for i in range(n) if mask >> i & 1] for mask in range(1, 2**n)]


def positive_definite(n: int, rng: Generator) -> Matrix:
    half = factor(n, rng, n)
    return half @ half.T + np.eye(n)


def symmetric(n: int, rng: Generator) -> Matrix:
    M = integers(n, rng)
    return M + M.T


def psd_singular(n: int, rng: Generator) -> Matrix:
    half = factor(n, rng, max(n // 2, 1))
    return half @ half.T


def z_matrix(n: int, rng: Generator) -> Matrix:
    M = -np.abs(integers(n, rng))
    np.fill_diagonal(M, rng.integers(-2, 8, n))
    return M


def bimatrix(n: int, rng: Generator) -> Matrix:
    half = n // 2
    M = np.zeros((n, n))
    M[:half, half:] = rng.integers(1, 5, (half, n - half))
    M[half:, :half] = rng.integers(1, 5, (n - half, half))
    return M


def sparse(n: int, rng: Generator) -> Matrix:
    return integers(n, rng) * (rng.random((n, n)) < 0.4)


def zero_rows(n: int, rng: Generator) -> Matrix:
    M = integers(n, rng)
    if n:
        M[rng.integers(n)] = 0.0
        M[:, rng.integers(n)] *= rng.integers(0, 2)
    return M


def repeated_rows(n: int, rng: Generator) -> Matrix:
    M = integers(n, rng)
    if n > 1:
        M[-1] = rng.choice([-1, 1, 2]) * M[0]
        M[:, -1] = M[:, 0]
    return M


def copositive(n: int, rng: Generator) -> Matrix:
    return psd_singular(n, rng) + np.abs(integers(n, rng))


def program(n: int, rng: Generator) -> Matrix:
    rows = n // 2
    M = np.zeros((n, n))
    A = integers(n, rng)[:rows, : n - rows]
    M[n - rows :, : n - rows], M[: n - rows, n - rows :] = A, -A.T
    half = factor(n - rows, rng, 1) if n - rows else np.zeros((0, 1))
    M[: n - rows, : n - rows] = half @ half.T * rng.integers(0, 2)
    return M


def badly_scaled(n: int, rng: Generator) -> Matrix:
    return np.ldexp(integers(n, rng), rng.integers(-20, 21, (n, 1)))


def doubles(n: int, rng: Generator) -> Matrix:
    return rng.standard_normal((n, n)) + rng.integers(0, 3) * np.eye(n)


KINDS: dict[str, Callable[[int, Generator], Matrix]] = {
    "P": p_matrix,
    "PSD": positive_definite,
    "PSD singular": psd_singular,
    "PSD nonsymmetric": lambda n, rng: psd_singular(n, rng) + skew(n, rng),
    "skew": skew,
    "indefinite": integers,
    "symmetric": symmetric,
    "Z": z_matrix,
    "nonnegative": lambda n, rng: np.abs(integers(n, rng)),
    "nonpositive": lambda n, rng: -np.abs(integers(n, rng)),
    "copositive": copositive,
    "bimatrix": bimatrix,
    "program": program,
    "sparse": sparse,
    "zero rows": zero_rows,
    "repeated rows": repeated_rows,
    "badly scaled": badly_scaled,
    "doubles": doubles,
}


def anywhere(low: int, high: int) -> Callable[[Generator, tuple[int, ...]], Matrix]:
    """Numbers of either sign, a third of them 0, whose exponents of two are anything from low to high."""

    def draw(rng: Generator, shape: tuple[int, ...]) -> Matrix:
        mantissa = rng.choice([1.0, 1.0, 1.5, rng.uniform(1.0, 2.0)], shape) * rng.choice(
            [-1.0, 0.0, 1.0], shape
        )
        return np.ldexp(mantissa, rng.integers(low, high + 1, shape))

    return draw


# What products and quotients overflow or underflow in: not in KINDS, as many of the answers are no doubles.
EXTREMES: dict[str, Callable[[Generator, tuple[int, ...]], Matrix]] = {
    "any exponent": anywhere(-1000, 1000),
    "huge": anywhere(480, 1020),
    "tiny": anywhere(-1074, -480),
    "subnormal": anywhere(-1074, -1010),
    "squares overflow": anywhere(-520, 520),
    "ordinary beside huge": lambda rng, shape: np.where(
        rng.random(shape) < 0.7,
        rng.integers(-3, 4, shape).astype(float),
        anywhere(-1000, 1000)(rng, shape),
    ),
}


def extreme_problem(kind: str, rng: Generator) -> LCP:
    """One to six rows with entries and bounds of any exponent."""
    n, draw = int(rng.integers(1, LARGEST + 1)), EXTREMES[kind]
    M, q = draw(rng, (n, n)), draw(rng, (n,))
    if rng.random() < 0.5:  # the diagonal of a matrix for which methods have reasons
        M[np.diag_indices(n)] = np.abs(M.diagonal())
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if rng.random() < 0.5:
        ends = np.sort(draw(rng, (2, n)), axis=0)
        # plain, box or fixed, upper only, free, shifted
        shape = rng.choice(5, n, p=[0.4, 0.2, 0.15, 0.1, 0.15])
        lower = np.select([shape == 0, (shape == 2) | (shape == 3)], [0.0, -np.inf], ends[0])
        upper = np.select([(shape == 1) | (shape == 2)], [ends[1]], np.inf)
    return LCP(M, q, lower=lower, upper=upper)


def random_problem(kind: str, rng: Generator, largest: int = LARGEST) -> LCP:
    """Integers but for the last kind; q random, degenerate or planted; half of the problems with bounds."""
    n = int(rng.choice([0, 1, 1, *[n for n in range(2, LARGEST + 1) for _ in range(4)]]))
    M = KINDS[kind](n, rng)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if rng.random() < 0.5:
        lower, upper = random_bounds(n, rng)
    return LCP(M, random_offset(kind, M, lower, upper, rng), lower=lower, upper=upper)


def random_bounds(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    a = rng.integers(-2, 2, n).astype(float)
    b = a + rng.integers(1, 4, n)
    # plain, box, upper only, free, shifted, fixed
    shape = rng.choice(6, n, p=[0.35, 0.2, 0.15, 0.1, 0.15, 0.05])
    lower = np.select([shape == 0, (shape == 2) | (shape == 3)], [0.0, -np.inf], a)
    upper = np.select([(shape == 1) | (shape == 2), shape == 5], [b, a], np.inf)
    return lower, upper


def random_offset(kind: str, M: Matrix, lower: Matrix, upper: Matrix, rng: Generator) -> Matrix:
    n = len(M)
    if kind == "bimatrix" and rng.random() < 0.7:
        return -np.ones(n)
    choice = rng.random()
    if choice < 0.35 and kind != "doubles":
        return planted_offset(M, lower, upper, rng)
    q = rng.integers(-6, 7, n).astype(float)
    if kind == "badly scaled":
        q *= 2.0 ** rng.integers(-3, 4)
    if choice < 0.5:
        q[rng.random(n) < 0.6] = 0.0
    return q + rng.standard_normal(n) if kind == "doubles" else q


def planted_point(lower: Matrix, upper: Matrix, rng: Generator) -> tuple[Matrix, Matrix]:
    """Return z of small integers and a complementary w, as degenerate as it comes."""
    n = len(lower)
    z = np.clip(rng.integers(-3, 4, n).astype(float), lower, upper)
    w = rng.integers(0, 4, n) * ((z == lower) * 1.0 - ((z == upper) & (lower < upper)))
    return z, np.where(lower == upper, rng.integers(-3, 4, n), w)


def planted_offset(M: Matrix, lower: Matrix, upper: Matrix, rng: Generator) -> Matrix:
    """Return q of a problem with a solution of small integers, without rounding."""
    z, w = planted_point(lower, upper, rng)
    return w - M @ z
