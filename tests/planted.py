"""Batches whose rows are where they were put: the place of each is chosen first, then q."""

from __future__ import annotations

from typing import Any

import numpy as np

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
    at_lower, at_upper = (
        (draw < 0.4) & (lower > -INF),
        (draw > np.where(lower == upper, 0.4, 0.7)) & (upper < INF),
    )
    inside = np.where(
        upper < INF, 0.5 * (np.maximum(lower, upper - 2.0) + upper), np.maximum(lower, -5.0) + 1.0
    )
    z = np.where(at_lower, lower, np.where(at_upper, upper, inside))
    w = np.where(at_lower, 1.0, np.where(at_upper, -1.0, 0.0)) * (0.1 + rng.random((count, n)))
    q = w - (M @ z[:, :, None])[:, :, 0]
    return (M[0] if shared else M), q, lower, upper
