"""Paths of random families, judged by solves at random values of the parameter.

Run as ``python tests/campaigns/paths.py --cases 500 --seed 0``; ``--sweep 10000`` for the demand of a network
equilibrium, solved as often. Monotone LCPs of 2 to 300 rows, P-matrices to semidefinite ones of any rank, with and
without a skew part, with bounds on one side, on both and on none, some of them degenerate on purpose (data of whole
numbers), solvable at both ends by construction. Counted are

- unsolved: paths that are not SOLVED from end to end;
- wrong: pieces on which, at a random θ, the certificate refuses the solution, or (M + Mᵀ) z differs from that of a
  solve by more than 1e-6 relatively;
- apart: pieces that do not join, in (M + Mᵀ) z, where the path says of no jump and no segment.

Exit code 1 where anything is wrong or apart, or more than 0.5 % are unsolved.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from lcp_plugin import LCP, solve, solve_batch, trace

INF = np.inf


def random_family(rng: np.random.Generator, largest: int) -> tuple[LCP, np.ndarray]:
    """Return an LCP at θ = 0, and the direction of its q, with solutions at both ends."""
    n = int(np.exp(rng.uniform(np.log(2), np.log(largest + 1))))
    is_whole, rank = rng.random() < 0.3, int(rng.integers(1, n + 1))
    B, K = rng.standard_normal((n, rank)), rng.standard_normal((n, n))
    if is_whole:
        B, K = (
            rng.integers(-2, 3, (n, rank)).astype(float),
            rng.integers(-1, 2, (n, n)).astype(float),
        )
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


def examined(
    rng: np.random.Generator, largest: int, values: int
) -> tuple[str, int, int, int, float]:
    """Return the status of one path, its pieces, the wrong ones, those apart, and time ÷ (solve × breakpoints)."""
    problem, dq = random_family(rng, largest)
    path = trace(problem, {"q": dq}, 0.0, 1.0)
    spent, symmetric, wrong, apart = [], problem.M + problem.M.T, 0, 0
    for theta in rng.uniform(0.0, path.reached, values) if path.pieces else ():
        begun = time.perf_counter()
        answer = solve(problem.with_q(problem.q + theta * dq))
        spent.append(time.perf_counter() - begun)
        point = path.at(theta)
        off = np.abs(symmetric @ (point.z - answer.z)).max() if answer.is_solved else 0.0
        wrong += not point.is_solved or off > 1e-6 * (1.0 + np.abs(symmetric @ point.z).max())
    for one, other in zip(path.pieces, path.pieces[1:], strict=False):
        if other.begin == one.end and other.begin not in (*path.jumps, *path.segments):
            here, there = symmetric @ one.z_at(one.end), symmetric @ other.z_at(one.end)
            apart += np.abs(here - there).max() > 1e-6 * (1.0 + np.abs(here).max())
    share = path.seconds / (np.median(spent) * max(len(path), 1)) if spent else np.nan
    return path.status.name, len(path), int(wrong), int(apart), float(share)


def demand_sweep(count: int) -> int:
    """Compare the path of a network equilibrium with as many solves as are asked for; return how many are wrong.

    A grid of 5 × 5 junctions, 60 roads whose time rises with the traffic, 40 pairs of places with three paths each.
    """
    rng = np.random.default_rng(5)
    roads, pairs, ways = 60, 40, 3
    uses = np.zeros((roads, pairs * ways))
    for path in range(pairs * ways):
        uses[rng.choice(roads, size=int(rng.integers(3, 9)), replace=False), path] = 1.0
    slope, free = rng.uniform(0.05, 0.5, roads), rng.uniform(1.0, 3.0, roads)
    serves = np.kron(np.eye(pairs), np.ones((1, ways)))
    # Paths: time − price ≥ 0 ⟂ flow ≥ 0; prices: served = demand.
    M = np.block(
        [[uses.T @ (slope[:, None] * uses), -serves.T], [serves, np.zeros((pairs, pairs))]]
    )
    demand = rng.uniform(0.5, 2.0, pairs)
    problem = LCP(
        M,
        np.concatenate([uses.T @ free, np.zeros(pairs)]),
        lower=np.concatenate([np.zeros(pairs * ways), np.full(pairs, -INF)]),
    )
    dq = np.concatenate([np.zeros(pairs * ways), -demand])
    begun = time.perf_counter()
    path = trace(problem, {"q": dq}, 0.1, 10.0)
    traced = time.perf_counter() - begun
    thetas = np.linspace(0.1, 10.0, count)
    begun = time.perf_counter()
    answers = solve_batch(problem, problem.q + thetas[:, None] * dq)
    solved = time.perf_counter() - begun
    wrong = 0
    for theta, z in zip(thetas, answers.z, strict=True):
        flow, other = (
            uses @ one[: pairs * ways] for one in (path.at(theta).z, z)
        )  # on roads it is unique
        wrong += bool(np.abs(flow - other).max() > 1e-6 * np.abs(flow).max())
    print(
        f"demand: {path!r}; {count} solves {solved:.2f} s, the trace {traced:.3f} s; {wrong} wrong; "
        f"trace ÷ (one solve × breakpoints) {traced / (solved / count * len(path)):.2f}"
    )
    return wrong + (not path.is_solved)


def main() -> int:
    """Run the campaign; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--largest", type=int, default=300)
    parser.add_argument("--values", type=int, default=5)
    parser.add_argument("--sweep", type=int, default=0)
    parser.add_argument("--show", action="store_true")
    asked = parser.parse_args()
    statuses: dict[str, int] = {}
    pieces = wrong = apart = 0
    shares = []
    for case in range(asked.cases):
        status, count, bad, off, share = examined(
            np.random.default_rng([asked.seed, case]), asked.largest, asked.values
        )
        statuses[status] = statuses.get(status, 0) + 1
        pieces, wrong, apart = pieces + count, wrong + bad, apart + off
        shares.append(share)
        if asked.show and (bad or off or status != "SOLVED"):
            print(f"case {case}: {status}, {count} pieces, {bad} wrong, {off} apart")
    failed = asked.sweep and demand_sweep(asked.sweep)
    unsolved = asked.cases - statuses.get("SOLVED", 0)
    if asked.cases:
        quartiles = ", ".join(
            f"{value:.2f}" for value in np.nanquantile(shares, (0.25, 0.5, 0.75, 1.0))
        )
        print(
            f"{asked.cases} paths, {pieces} pieces: {statuses}; {wrong} wrong, {apart} apart; "
            f"time ÷ (one solve × pieces), quartiles and most: {quartiles}"
        )
    return int(bool(wrong or apart or failed or unsolved > 0.005 * asked.cases))


if __name__ == "__main__":
    sys.exit(main())
