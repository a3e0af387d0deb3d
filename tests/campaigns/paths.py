"""Paths of random families, judged by solves at random values of the parameter.

Monotone LCPs of 2 to 300 rows, P-matrices to semidefinite ones of any rank, with and
without a skew part, with bounds on one side, on both and on none, some of them degenerate on purpose (data of whole
numbers), solvable at both ends by construction. Counted are

- unsolved: paths that are not SOLVED from end to end;
- wrong: pieces on which, at a random θ, the certificate refuses the solution, or (M + Mᵀ) z differs from that of a
  solve by more than 1e-6 relatively;
- apart: pieces that do not join, in (M + Mᵀ) z, where the path says of no jump and no segment.
"""

from __future__ import annotations

import numpy as np

from lcp_plugin import LCP, solve, trace

INF = np.inf


def random_family(rng: np.random.Generator, largest: int) -> tuple[LCP, np.ndarray]:
    """Return an LCP at θ = 0, and the direction of its q, with solutions at both ends."""
    n = int(np.exp(rng.uniform(np.log(2), np.log(largest + 1))))
    is_whole, rank = rng.random() < 0.3, int(rng.integers(1, n + 1))
    B, K = rng.standard_normal((n, rank)), rng.standard_normal((n, n))
    if is_whole:
        B = rng.integers(-2, 3, (n, rank)).astype(float)
        K = rng.integers(-1, 2, (n, n)).astype(float)
    M = B @ B.T * (1.0 if is_whole else 1.0 / n) + rng.choice([0.0, 1.0]) * (K - K.T)
    if rng.random() < 0.4:
        M += np.diag(rng.integers(1, 4, n).astype(float))
    lower = np.where(
        rng.random(n) < rng.choice([0.7, 1.0]), -rng.integers(0, 2, n).astype(float), -INF
    )
    upper = np.where(
        rng.random(n) < rng.choice([0.0, 0.5]), rng.integers(1, 3, n).astype(float), INF
    )
    ends = []
    for _ in range(2):
        z = np.clip(np.round(2.0 * rng.standard_normal(n)), lower, upper)
        size = rng.integers(0, 3, n).astype(float) if is_whole else rng.random(n)
        ends.append(np.where(z == lower, size, np.where(z == upper, -size, 0.0)) - M @ z)
    return LCP(M, ends[0], lower=lower, upper=upper), ends[1] - ends[0]


def examined(rng: np.random.Generator, largest: int, values: int) -> tuple[str, int, int]:
    """Return the status of one path, and how many points are wrong and how many pieces apart."""
    problem, dq = random_family(rng, largest)
    path = trace(problem, {"q": dq}, 0.0, 1.0)
    symmetric, wrong, apart = problem.M + problem.M.T, 0, 0
    for theta in rng.uniform(0.0, path.reached, values) if path.pieces else ():
        answer, point = solve(problem.with_q(problem.q + theta * dq)), path.at(theta)
        off = np.abs(symmetric @ (point.z - answer.z)).max() if answer.is_solved else 0.0
        wrong += not point.is_solved or off > 1e-6 * (1.0 + np.abs(symmetric @ point.z).max())
    for one, other in zip(path.pieces, path.pieces[1:], strict=False):
        if other.begin == one.end and other.begin not in (*path.jumps, *path.segments):
            here, there = symmetric @ one.z_at(one.end), symmetric @ other.z_at(one.end)
            apart += np.abs(here - there).max() > 1e-6 * (1.0 + np.abs(here).max())
    return path.status.name, int(wrong), int(apart)
