"""Derivatives of random small problems compared with rational arithmetic.

The active set of each problem is drawn beforehand, and rational arithmetic decides whether it belongs to the exact
solution. In this case jvp (by M, q and the bounds) and vjp (to M, q and the bounds, from z and w) must equal the
exact products to 1e-12 κ(M_FF) relative. Degenerate problems are drawn by tests/problems/sensitivity.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import scipy.sparse as sp
from oracles.exact import FREE, LOWER, UPPER
from oracles.exact_derivatives import Change, Piece, distance, piece_at

from lcp_plugin import LCP, derivative, solve
from lcp_plugin.problems.sensitivity import Derivative

Generator = np.random.Generator
ACCURACY = 1e-12


COARSE = 1e-3  # a z from which steps of the active-set method may cycle; then nothing is proven
SECONDS = 20.0
KINDS = ("plain", "box", "mixed")


def h_plus(n: int, rng: Generator) -> np.ndarray:
    """Dominant after a scaling of columns, signs arbitrary, half of the entries zero."""
    M = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.5)
    np.fill_diagonal(M, 0.0)
    np.fill_diagonal(M, abs(M).sum(axis=1) * rng.uniform(1.01, 2.0, n) + 0.1)
    return M * 2.0 ** rng.integers(-3, 4, n)


def definite(n: int, rng: Generator, digits: float = 3.0) -> np.ndarray:
    """Symmetric positive definite."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    M = (Q * np.geomspace(1.0, 10.0**-digits, n)) @ Q.T
    return 0.5 * (M + M.T)


def p_matrix(n: int, rng: Generator) -> np.ndarray:
    """Return a P-matrix: a permuted triangle, or a cycle of odd length."""
    if n % 2:
        return np.eye(n) + rng.uniform(0.5, 3.0) * np.roll(np.eye(n), -1, axis=0)
    order, M = rng.permutation(n), np.triu(2.0 * rng.normal(size=(n, n)), 1)
    return (M + np.diag(rng.uniform(0.5, 2.0, n)))[np.ix_(order, order)]


def nonsymmetric(n: int, rng: Generator) -> np.ndarray:
    """Positive definite symmetric part, and a skew one as large."""
    K = rng.normal(size=(n, n))
    return definite(n, rng, 1.0) + 0.5 * (K - K.T)


def ill_conditioned(n: int, rng: Generator) -> np.ndarray:
    """Symmetric positive definite, condition 1e4 … 1e10."""
    return definite(n, rng, rng.uniform(4.0, 10.0))


def scaled(n: int, rng: Generator) -> np.ndarray:
    """Return an H₊-matrix with random scaling of rows and columns."""
    return h_plus(n, rng) * 10.0 ** rng.integers(-6, 7, n)[:, None] * 10.0 ** rng.integers(-6, 7, n)


def chain(n: int, rng: Generator) -> np.ndarray:
    """A tridiagonal M-matrix."""
    upper, lower = -rng.random((2, n - 1))
    return np.diag(rng.uniform(2.0, 3.0, n)) + np.diag(upper, 1) + np.diag(lower, -1)


def nearly_degenerate(n: int, rng: Generator) -> np.ndarray:
    """Any of these; `drawn` makes slacks of it as small as rounding, or smaller."""
    kinds = (h_plus, definite, nonsymmetric, scaled, chain)
    return kinds[rng.integers(len(kinds))](n, rng)


FAMILIES: dict[str, Callable[[int, Generator], np.ndarray]] = {
    one.__name__: one
    for one in (h_plus, definite, p_matrix, nonsymmetric, ill_conditioned, scaled, chain, nearly_degenerate)
}  # fmt: skip


def rows(
    kind: str, states: np.ndarray, z: np.ndarray, rng: Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds that give each row of z its state; −1, 0, 1 as in `exact`."""
    n = states.size
    away = rng.integers(1, 5, (2, n)).astype(float)
    lower = np.where(states == LOWER, z, z - away[0])
    upper = np.where(states == UPPER, z, z + away[1])
    if kind == "plain":
        return lower, np.full(n, np.inf)
    if kind == "mixed":
        open_end = rng.random(n)
        lower = np.where((open_end < 0.5) & (states != LOWER), -np.inf, lower)
        upper = np.where((open_end > 0.25) & (open_end < 0.75) & (states != UPPER), np.inf, upper)
        is_fixed = (states != FREE) & (rng.random(n) < 0.2)
        lower, upper = np.where(is_fixed, z, lower), np.where(is_fixed, z, upper)
    return lower, upper


def drawn_states(kind: str, n: int, rng: Generator) -> np.ndarray:
    """Return the state of each row."""
    return rng.choice([LOWER, FREE] if kind == "plain" else [LOWER, FREE, FREE, UPPER], n)


def delivered(M: np.ndarray, rng: Generator) -> object:
    """Return M dense or sparse."""
    return M if rng.random() < 0.5 else sp.csr_array(M)


def drawn(family: str, kind: str, largest: int, rng: Generator) -> LCP:
    """Return a problem whose solution was drawn, up to the rounding error of q."""
    n = int(rng.integers(2, largest + 1))
    M, states = FAMILIES[family](n, rng), drawn_states(kind, n, rng)
    z = rng.normal(size=n)
    w = -states * (0.1 + rng.random(n)) * abs(M).max(axis=1)
    if family == "nearly_degenerate":
        w *= 10.0 ** -rng.choice([0.0, 8.0, 12.0, 14.0, 15.0, 16.0, 18.0, 30.0], size=n)
    if kind == "plain":
        z = np.where(states == LOWER, 0.0, abs(z))
    if family == "scaled":
        z = z / abs(M).max(axis=0)
    lower, upper = rows(kind, states, z, rng)
    if kind == "plain":
        lower = np.zeros(n)
    return LCP(delivered(M, rng), w - M @ z, lower=lower, upper=upper)


def wrong_products(
    found: Derivative, piece: Piece, rng: Generator, accuracy: float = ACCURACY
) -> Iterator[str]:
    """Yield which products, in all data and to all data, are not those of the exact piece."""
    change, (g, gw) = Change.drawn(piece.problem.n, rng), rng.normal(size=(2, piece.problem.n))
    gradient, exact, pattern = found.vjp(g, gw), piece.vjp(g, gw), piece.problem.csr.tocoo()
    by_entry = [exact.M[i][j] for i, j in zip(pattern.row, pattern.col, strict=True)]
    ends = np.r_[gradient.lower, gradient.upper]
    for name, ours, theirs in (
        ("z", found.z, piece.z),
        ("jvp", found.jvp(**change.arguments), piece.jvp(change)),
        ("vjp to q", gradient.q, exact.q),
        ("vjp to the bounds", ends, exact.lower + exact.upper),
        ("vjp to M", gradient.M.data, by_entry),
    ):
        if not (error := distance(ours, theirs)) <= accuracy:
            yield f"{name} off by {error:.1e}"


def condition(piece: Piece) -> float:
    """Return the condition of M on the free rows, at least 1."""
    F = piece.free
    return float(np.linalg.cond(piece.problem.csr.toarray()[np.ix_(F, F)], np.inf)) if F else 1.0


def faults(family: str, kind: str, largest: int, rng: Generator) -> Iterator[str]:
    """Yield errors of the derivative of one nondegenerate problem."""
    problem = drawn(family, kind, largest, rng)
    tolerance = rng.choice([1e-8, 1e-8, COARSE])
    result = solve(problem, tolerance=tolerance, max_seconds=SECONDS)
    if not result.is_solved:
        return
    found = derivative(result)
    piece = piece_at(problem, found.z, found.free)
    if found.degenerate.size:
        return
    if piece.is_strict:
        yield from wrong_products(found, piece, rng, ACCURACY * condition(piece))
    elif tolerance != COARSE or found.is_unique is not None:
        yield "the free rows are those of no solution, or degenerate"
