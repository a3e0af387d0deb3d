"""Small problems of every kind, the nasty ones included: what the compiled road must not be wrong about."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lcp_plugin import LCP, Result

from .contact_families import pyramids, rows_of_bodies

Generator = np.random.Generator
Matrix = np.ndarray


def definite(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """Symmetric positive definite, condition 1 … 1e10."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    M = (Q * np.geomspace(1.0, 10.0 ** -rng.uniform(0.0, 10.0), n)) @ Q.T
    return 0.5 * (M + M.T), rng.normal(size=n)


def spectrum(n: int, condition: float, active: float, seed: int = 5) -> LCP:
    """Symmetric positive definite, eigenvalues evenly spread in the logarithm, a share `active` of z* at its bound."""
    rng = np.random.default_rng(seed)
    vectors, _ = np.linalg.qr(rng.standard_normal((n, n)))
    M = (vectors * np.geomspace(1.0, 1.0 / condition, n)) @ vectors.T
    M = 0.5 * (M + M.T)
    is_active = rng.random(n) < active
    z, w = np.where(is_active, 0.0, rng.random(n)), np.where(is_active, rng.random(n), 0.0)
    return LCP(M, w - M @ z)


def falling_bodies(contacts: int, seed: int = 5) -> LCP:
    """Contacts between bodies with Coulomb friction on a pyramid of four edges: 6 unknowns a contact.

    The matrix is copositive, neither symmetric nor semidefinite, and has rows without a diagonal entry (Stewart,
    Trinkle 1996, doi:10.1002/(SICI)1097-0207(19960815)39:15<2673::AID-NME972>3.0.CO;2-I).
    """
    rng = np.random.default_rng(seed)
    bodies = max(1, contacts // 2)
    J = rows_of_bodies(contacts, bodies, rng)
    W = (J * np.exp(0.5 * rng.standard_normal(6 * bodies))) @ J.T
    velocity = rng.standard_normal(6 * bodies)
    velocity[2::6] -= 2.0  # they fall
    return LCP(*pyramids(W, J @ velocity, rng.uniform(0.1, 0.9, contacts)))


def friction(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """Contacts with Coulomb friction on a pyramid of four edges (Stewart, Trinkle): copositive, not symmetric."""
    case = falling_bodies(max(1, n // 6), int(rng.integers(2**31)))
    return case.M, case.q


def integers(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """Often singular, degenerate or without solution."""
    return rng.integers(-2, 3, (n, n)).astype(float), rng.integers(-2, 3, n).astype(float)


def arbitrary(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    return rng.normal(size=(n, n)), rng.normal(size=n)


def semidefinite(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """Of half the rank, q in its range or not."""
    B = rng.integers(-3, 4, (n, max(1, n // 2))).astype(float)
    return B @ B.T, B @ rng.normal(size=B.shape[1]) if rng.random() < 0.5 else rng.normal(size=n)


def chain(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """A tridiagonal M-matrix."""
    M = (
        np.diag(rng.uniform(2.0, 3.0, n))
        - np.diag(rng.random(n - 1), 1)
        - np.diag(rng.random(n - 1), -1)
    )
    return M, rng.normal(size=n)


def lower_triangle(n: int) -> Matrix:
    """Murty's matrix: 1 on the diagonal, 2 below."""
    return np.eye(n) + 2.0 * np.tril(np.ones((n, n)), -1)


def murty(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """Exponential for pivoting; Fathi's is its product with the transpose."""
    L = lower_triangle(n)
    return (L, L.T, L @ L.T)[rng.integers(3)], -np.ones(n)


def cyclic(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """Rounds of active sets cycle (Ben Gharbia, Gilbert 2012); a P-matrix for odd n."""
    return np.eye(n) + rng.uniform(1.0, 3.0) * np.roll(np.eye(n), -1, axis=0), -np.ones(n)


def game(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """A bimatrix game: every path from a positive covering vector ends on a ray."""
    m = max(1, n // 2)
    A, B = rng.integers(1, 9, (2, m, n - m if n > m else 1)).astype(float)
    zero = np.zeros
    return np.block([[zero((m, m)), A], [B.T, zero((B.shape[1], B.shape[1]))]]), -np.ones(
        m + B.shape[1]
    )


def extreme(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """Of any size, 1e±150."""
    M, q = definite(n, rng)
    return M * 10.0 ** rng.integers(-150, 151), q * 10.0 ** rng.integers(-100, 101)


def scaled(n: int, rng: Generator) -> tuple[Matrix, Matrix]:
    """Rows and columns of any unit."""
    M, q = definite(n, rng)
    units = 10.0 ** rng.integers(-8, 9, n)
    return M * units[:, None] * units, q * units


FAMILIES: dict[str, Callable[[int, Generator], tuple[Matrix, Matrix]]] = {
    one.__name__: one
    for one in (
        definite,
        friction,
        integers,
        arbitrary,
        semidefinite,
        chain,
        murty,
        cyclic,
        game,
        extreme,
        scaled,
    )
}


def problem(family: str, largest: int, rng: Generator) -> LCP:
    """Draw a problem with up to about so many unknowns; half of them with boxes, fixed, free or one-sided rows."""
    M, q = FAMILIES[family](int(rng.integers(2, largest + 1)), rng)
    n = q.size
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if rng.random() < 0.5:
        unit = abs(q).max() / max(abs(M).max(), 1e-300) or 1.0
        lower = np.where(rng.random(n) < 0.3, -unit * rng.random(n), lower)
        upper = np.where(rng.random(n) < 0.3, lower + unit * rng.exponential(size=n), upper)
        upper = np.where(rng.random(n) < 0.05, lower, upper)
        lower = np.where(rng.random(n) < rng.choice([0.0, 0.1]), -np.inf, lower)
    return LCP(M, q, lower=lower, upper=upper)


def draw(family: str, count: int, largest: int = 20) -> list[LCP]:
    """Problems of a family."""
    rng = np.random.default_rng(list(FAMILIES).index(family))
    return [problem(family, largest, rng) for _ in range(count)]


def definite_stack(count: int, n: int, seed: int = 0) -> tuple[Matrix, Matrix]:
    """A stack of positive definite matrices and right-hand sides."""
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(count, n, n))
    return B @ B.transpose(0, 2, 1) / n + 0.5 * np.eye(n), rng.normal(size=(count, n))


def told(result: Result) -> tuple[Any, ...]:
    """All that watching a run must not change."""
    names = ("status", "iterations", "work", "algorithm", "stages", "residual")
    return (result.z.tobytes(), result.w.tobytes(), *(getattr(result, name) for name in names))
