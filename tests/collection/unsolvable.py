"""Problems without a solution: the linear constraints contradict, or only complementarity fails."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .entry import OWN, Entry, infeasible, solvable, without_solution

CHUNG = (
    "Chung, NP-completeness of the linear complementarity problem, J. Optim. Theory Appl. 60 (1989)"
)


def entries() -> Iterator[Entry]:
    """Yield infeasible ones, feasible ones without a solution, and subset sums, which are either."""
    yield from _infeasible()
    yield from _feasible()
    yield from _subset_sums()


def _infeasible() -> Iterator[Entry]:
    yield infeasible("zero_row", OWN, [[1, 0], [0, 0]], [-1, -2])
    yield infeasible("nonpositive_row", OWN, [[-1, -2], [3, 1]], [-1, 5])
    yield infeasible("two_rows_contradict", OWN, [[1, -1], [-1, 1]], [-1, -1])
    yield infeasible("skew", OWN, [[0, -1, 0], [1, 0, -1], [0, 1, 0]], [0, -1, -1])
    yield infeasible(
        "combination_of_all_rows", OWN, [[1, -3, 1], [-2, 1, 1], [1, 2, -3]], [-1, -1, -1]
    )
    yield infeasible(
        "thirds",
        f"{OWN}: a Farkas vector of thirds",
        [[3, -1, 0], [-3, -2, 0], [0, 3, -1]],
        [-1, -1, 0],
    )
    yield infeasible("margin_of_a_millionth", OWN, [[1, -1], [-1, 1]], [1, -1.000001])
    yield infeasible("box_out_of_reach", OWN, [[1, 0], [2, -1]], [0, -3], upper=[1.0, np.inf])
    yield infeasible("free_rows_contradict", OWN, [[1, 1], [1, 1]], [-1, -2], lower=-np.inf)
    yield infeasible("free_against_bounded", OWN, [[1, 2], [1, 2]], [1, -3], lower=[-np.inf, 0.0])
    yield infeasible(
        "fixed_row_decides", OWN, [[1, -2], [1, 0]], [0, -3], lower=[1, 0], upper=[1, np.inf]
    )
    yield infeasible("upper_only", OWN, [[-1, -1], [0, 0]], [1, 2], lower=-np.inf, upper=[0.0, 3.0])
    for n in (20, 100):
        generator = np.random.default_rng(n)
        y = generator.integers(0, 4, n)
        y[-1] = 1
        M = generator.integers(-5, 6, (n, n)).astype(float)
        M[-1] -= y @ M  # the rows weighted with y cancel …
        q = generator.integers(-5, 6, n).astype(float)
        q[-1] -= y @ q + 1.0  # … but their right sides do not
        yield infeasible(f"cancelling_rows_{n}", OWN, M, q, farkas=y)
        order = generator.permutation(n)
        yield infeasible(
            f"cancelling_rows_{n}_shuffled", OWN, M[np.ix_(order, order)], q[order], farkas=y[order]
        )


def _feasible() -> Iterator[Entry]:
    yield without_solution("needs_a_forbidden_variable", OWN, [[-1, 1], [0, 0]], [-1, 1])
    yield without_solution("needs_both", OWN, [[0, 1], [0, 0]], [-1, 2])
    yield without_solution(
        "box_without_solution", OWN, [[0, 1], [0, 0]], [-1, 2], upper=[np.inf, 4.0]
    )
    yield without_solution(
        "mixed_without_solution",
        OWN,
        [[0, 1, 0], [0, 0, 0], [0, 1, 1]],
        [-1, 2, 0],
        lower=[0, 0, -np.inf],
    )
    for n in (2, 3, 4, 5, 6, 7, 8):
        yield without_solution(f"chain_without_solution_{n}", OWN, *_chain(n))


def _chain(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Row 0 needs z_1 > 0, whose row then needs z_2 > 0, …; the last slack is positive whatever happens."""
    entries = np.random.default_rng(n).integers(0, 3, (n, n)).astype(float)
    M = -np.tril(entries)
    M[-1] = entries[-1]
    M[np.arange(n - 1), np.arange(1, n)] = 2.0
    q = np.full(n, -1.0)
    q[-1] = 1.0
    return M, q


def subset_sum(weights: list[int], target: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the problem whose solutions choose weights of that sum: z_j ∈ {0, weight_j}, then Σ z ≥ and ≤ target."""
    n = len(weights)
    M = np.zeros((n + 2, n + 2))
    M[:n, :n] = -np.eye(n)
    M[n, :n], M[n + 1, :n] = 1.0, -1.0
    M[n, n] = M[n + 1, n + 1] = -float(n)
    return M, np.array([*weights, -target, target], dtype=float)


def _subset_sums() -> Iterator[Entry]:
    for weights, target, chosen in (
        ([3, 5, 7], 12, [5, 7]),
        ([4, 6, 9, 11, 14, 20], 31, [11, 20]),
        ([2, 3, 5, 8, 13, 21], 24, [3, 21]),
    ):
        z = [x if x in chosen else 0 for x in weights] + [0, 0]
        yield solvable(
            f"subset_sum_{len(weights)}_to_{target}",
            CHUNG,
            *subset_sum(weights, target),
            solution=z,
        )
    for weights, target in (
        ([3, 5], 4),
        ([3, 5, 7], 11),
        ([4, 6, 10, 12], 15),
        ([6, 10, 14, 15, 22, 30], 49),
    ):
        yield without_solution(
            f"subset_sum_{len(weights)}_not_{target}", CHUNG, *subset_sum(weights, target)
        )
    yield infeasible("subset_sum_out_of_reach", CHUNG, *subset_sum([3, 5, 7], 16))
