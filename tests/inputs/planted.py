"""Problems whose solutions are chosen first, then q or c: of one LCP, of a batch, of a program."""

from __future__ import annotations

from typing import Any

import numpy as np

from lcp_plugin import LCP, QuadraticProgram

INF = np.inf


def planted(
    count: int,
    n: int,
    seed: int,
    *,
    symmetric: bool = True,
    shared: bool = False,
    fixed: float = 0.1,
) -> tuple[Any, ...]:
    """(M, q, lower, upper): boxes, half-lines, free rows and, of that share, equal bounds; far from any kink."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(1 if shared else count, n, n)) / np.sqrt(n)
    M = A @ A.transpose(0, 2, 1) + 0.5 * np.eye(n) if symmetric else A + 3.0 * np.eye(n)
    lower = np.where(rng.random((count, n)) < 0.8, rng.normal(size=(count, n)), -INF)
    upper = np.where(
        rng.random((count, n)) < 0.6, np.maximum(lower, -2.0) + rng.random((count, n)) + 0.5, INF
    )
    upper = np.where((rng.random((count, n)) < fixed) & (lower > -INF), lower, upper)
    draw = rng.random((count, n))
    at_lower = (draw < 0.4) & (lower > -INF)
    at_upper = (draw > np.where(lower == upper, 0.4, 0.7)) & (upper < INF)
    inside = np.where(
        upper < INF, 0.5 * (np.maximum(lower, upper - 2.0) + upper), np.maximum(lower, -5.0) + 1.0
    )
    z = np.where(at_lower, lower, np.where(at_upper, upper, inside))
    w = np.where(at_lower, 1.0, np.where(at_upper, -1.0, 0.0)) * (0.1 + rng.random((count, n)))
    q = w - (M @ z[:, :, None])[:, :, 0]
    return (M[0] if shared else M), q, lower, upper


def planted_lcp(
    M: Any, rng: Any, *, bounds: bool = True, unit: float = 1.0
) -> tuple[LCP, np.ndarray]:
    """Return the LCP and z*, integers as w*: active, inactive, degenerate; boxed, one-sided, free, fixed rows."""
    if isinstance(rng, int):
        rng = np.random.default_rng(rng)
    n = M.shape[0]
    if not bounds:
        share = rng.random(n)
        z = np.where(share < 0.5, rng.integers(1, 10, n), 0.0)
        return LCP(M, np.where(share > 0.6, unit * rng.integers(1, 10, n), 0.0) - M @ z), z
    lower = np.where(rng.random(n) < 0.3, -INF, -2.0)
    upper = np.where(rng.random(n) < 0.3, INF, 3.0)
    lower = np.where(rng.random(n) < 0.1, 1.0, lower)
    upper = np.where(rng.random(n) < 0.1, 1.0, np.maximum(upper, 1.0))
    z = np.clip(rng.choice([-2.0, 0.0, 3.0], n), lower, upper)
    w = rng.integers(0, 4, n) * ((z == lower).astype(float) - (z == upper))
    w = np.where(lower == upper, rng.integers(-3, 4, n), w)
    return LCP(M, w - M @ z, lower=lower, upper=upper), z


def planted_program(
    n: int, rows: int, equations: int, rank: int, seed: int
) -> tuple[QuadraticProgram, np.ndarray, float]:
    """Return a program, its solution x and its value; half of the rows and a third of the bounds are active."""
    rng = np.random.default_rng(seed)
    factor = rng.standard_normal((n, rank))
    P, G, A = factor @ factor.T, rng.standard_normal((rows, n)), rng.standard_normal((equations, n))
    x = np.round(rng.standard_normal(n), 3)
    multipliers = np.where(rng.random(rows) < 0.5, rng.random(rows) + 0.1, 0.0)
    lower = np.where(rng.random(n) < 0.3, x, -INF)
    upper = np.where(rng.random(n) < 0.5, x + 1.0, INF)
    at_lower = np.where(lower == x, rng.random(n), 0.0)
    h = G @ x + np.where(multipliers > 0.0, 0.0, rng.random(rows) + 0.1)
    c = -(P @ x + G.T @ multipliers + A.T @ rng.standard_normal(equations)) + at_lower
    program = QuadraticProgram(P, c, G, h, A, A @ x, lower, upper)
    return program, x, program.objective(x)


def planted_worlds(count: int) -> tuple[Any, ...]:
    """W, b and friction of one body at two contacts."""
    rng = np.random.default_rng(3)
    J = rng.standard_normal((count, 6, 6))
    b = (J @ rng.standard_normal((count, 6, 1)))[:, :, 0]
    return J @ J.swapaxes(1, 2) + 0.1 * np.eye(6), b, rng.uniform(0.2, 0.8, (count, 2))
