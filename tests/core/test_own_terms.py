"""Rows beside their own terms: what a residual relative to one reference hides is not SOLVED, and what is right is."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import tiny_diagonals

from lcp_plugin import LCP, Certificate, Status, solve, solve_batch
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.errors import UnsuitableMatrix
from lcp_plugin.core.settings import Settings

STACKED = [[1e-8, -1e-8, 0.0], [-1e-8, 1.0 + 1e-8, -1.0], [0.0, -1.0, 1.0 + 1e-8]]
FAR_ROWS = [
    [0.1, 0.0, 0.0, 1.0],
    [0.0, 0.1, 0.0, 1e8],
    [0.0, 0.0, 0.1, 1e16],
    [-1.0, -1.0, -1.0, 0.0],
]
HIDDEN = {
    "a tiny diagonal entry": ([[1.0, -2.0], [3.0, 1e-9]], [-3.0, -1.0], [3.0, 0.0], [1.672, 0.0]),
    "heavy on light": (
        STACKED,
        [-0.04905, 0.0, 0.0],
        [9.81e6, 4.905e6, 4.905e6],
        [4.905e6, 0.0, 0.0],
    ),
    "rows that do not act": (
        FAR_ROWS,
        [-50.0, -50.0, -50.0, 1.0],
        [1.0, 0.0, 0.0, 49.9],
        [2.0, 0.0, 0.0, 49.8],
    ),
}


@pytest.mark.parametrize("algorithm", ["auto", *REGISTRY])
@pytest.mark.parametrize("kind", HIDDEN)
def test_solved_is_the_solution(kind: str, algorithm: str) -> None:
    """From wherever a run begins: SOLVED is right to 1e-5, and auto solves it; a false z is refused."""
    M, q, right, false = HIDDEN[kind]
    problem = LCP(M, q)
    assert not Certificate.of(problem, false).meets(Settings())
    for z0 in (None, false):
        try:
            result = solve(problem, algorithm, z0=z0, max_iterations=2000)
        except UnsuitableMatrix:
            continue
        assert result.is_solved or algorithm != "auto"
        if result.is_solved:
            assert result.z == pytest.approx(right, rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("kind", HIDDEN)
def test_a_batch_is_judged_alike(kind: str) -> None:
    """What a compiled loop takes is judged by rows, too, whatever the start."""
    M, q, right, false = HIDDEN[kind]
    batch = solve_batch(np.array([M, M]), np.array([q, q]), z0=np.array([np.zeros(len(q)), false]))
    assert batch.all_solved
    for z in batch.z:
        assert z == pytest.approx(right, rel=1e-5, abs=1e-3)


def test_no_row_below_its_sign_is_solved() -> None:
    """w_2 = −z_1 − 1 < 0 for every z: infeasible, however far z_2 would bring the residual down."""
    problem = LCP([[1e-9, 1.0], [-1.0, 0.0]], [-1.0, -1.0])
    assert not Certificate.of(problem, [0.0, 1.1e16]).meets(Settings())
    assert solve(problem).status is Status.INFEASIBLE
    far = LCP(
        [[1.0, 0.0, 2.0], [0.0, 1.0, 2.0], [-2.0, -2.0, 0.0]], [0.0, -1e15, -1.0]
    )  # w_3 ≤ −1 beside w_2 of 1e15
    assert not Certificate.of(far, [0.0, 0.0, 0.5e15]).meets(Settings())
    assert solve(far).status is not Status.SOLVED


def test_right_to_an_ulp_is_solved_whatever_the_diagonal_entry_is() -> None:
    """Where m_ii is small beside its row, w_i measures it: 1e-16 is no distance of 1e-4."""
    for tiny in 10.0 ** -np.arange(6.0, 14.0):
        problem = LCP([[1.0, -2.0], [3.0, tiny]], [-3.0, -8.0])
        right = np.array([(3.0 * tiny + 16.0), 8.0 - 9.0]) / (tiny + 6.0)
        assert right[1] < 0.0  # so that z = (3, 0) is the solution
        assert Certificate.of(problem, [np.nextafter(3.0, 4.0), 0.0]).meets(Settings())
        beside = LCP([[1.0, -2.0], [3.0, tiny]], [-1.0, -5.0])
        z_2 = 2.0 / (tiny + 6.0)
        assert Certificate.of(beside, [1.0 + 2.0 * z_2, np.nextafter(z_2, 1.0)]).meets(Settings())


def test_what_fell_under_attack_is_refused() -> None:
    """Points that earlier forms of the rule passed: not moved to a bound; excused at 1e-8; moved as far as z is."""
    for M, q, false in (
        ([[1e-9, -1.0], [1.0, 1e-9]], [-1e-9, 0.0], [6.0, 5e-9]),
        ([[2e-6, 1.0], [-1.0, 1e-11]], [-1.0, -2e-11], [2e-12, 1.0]),
        (
            [
                [1e-6, 0.0, 0.0, 0.0],
                [1.0, 1e-6, 0.0, 0.0],
                [-3.0, -2.0, 1.0, 0.0],
                [-2.0, 1.0, 3.0, 1e-6],
            ],
            [-1e-6, -1.0, 1.0, 2999996.0],
            [1.0, 0.0, 2.0, 0.9993],
        ),
    ):
        assert not Certificate.of(LCP(M, q), false).meets(Settings())


@pytest.mark.full
def test_no_row_is_explained_by_a_number_that_does_not_act() -> None:
    """w_3 = .5 where z_3 = 1: neither SOLVED nor rounding, though m_34 = −1e19 would hide it."""
    M = [
        [0.0, -3.0, 2.0, -1.0],
        [3.0, -3.0, 3.0, 1.0],
        [1.0, -2.0, 2.0, -1e19],
        [1.0, -3.0, 1.0, -2.0],
    ]
    problem = LCP(M, [-2.0, 0.0, -1.5, 0.0])
    for result in (solve(problem), *solve_batch([problem, problem])):
        assert result.status not in (Status.SOLVED, Status.PRECISION_LIMIT)


def test_a_row_with_a_q_is_asked_for_in_its_own_unit() -> None:
    """w_2 = −1 and w_3 = −1 off a bound beside z = 1e15 and 1e19 in the same component: neither has a solution."""
    for M, q, lower, false in (
        (
            [[1e6, 0.0, 0.0], [-2.0, -1.0, 0.0], [-1.0, 2.0, 1.0]],
            [-1e6, 1.0, -1e15],
            0.0,
            [1.0, 0.0, 1e15],
        ),
        (
            [
                [1.0, 0.0, 1.0, -1.0],
                [0.0, 1.0, 1.0, -1.0],
                [-1.0, -1.0, 0.0, 0.0],
                [1.0, 1.0, 0.0, 0.0],
            ],
            [-1e19, 2.0, -2.0, 0.0],
            [-1e10, -1.0, 0.0, 0.0],
            [0.0, -1.0, 1e19, 0.0],
        ),
    ):
        problem = LCP(M, q, lower=lower)
        assert not Certificate.of(problem, false).meets(Settings())
        assert solve(problem).status is not Status.SOLVED


def test_rows_where_no_double_is_nearer_are_right() -> None:
    """A step of diffusion into a far field that underflows is solved; a wrong row of 1e-309 there is not excused."""
    n = 2400
    M = sp.diags_array([-8.0, 17.0, -8.0], offsets=[-1, 0, 1], shape=(n, n), format="csr")
    problem = LCP(M, -np.fmax(5e-324, 0.1 ** np.arange(n)))
    result = solve(problem)
    assert result.is_solved
    assert 0.0 < result.z[-1] < 1e-320
    false = result.z.copy()
    false[n - 200] += 1e-309
    assert not Certificate.of(problem, false).meets(Settings())


@pytest.mark.full
def test_a_diagonal_entry_of_1e12_may_leave_no_solution() -> None:
    """w_4 = −3.3e-13 and −2.2e-12 are all of their rows; without them w_1 > 0 where z_1 > 0."""
    for M, q in (
        ([[1e-12, 0, -1, -1], [0, 1e-11, 0, 2], [3, 2, 1e-10, 3], [0, 0, -1, -3]], [0, 2, -1, 0]),
        (
            [
                [1e-12, -2, 2, 2, 3],
                [2, 0, -1, 2, -1],
                [1, -3, 2, 1, 2],
                [0, -3, -3, -2, 3],
                [0, 1, 1, -3, -3],
            ],
            [0, -3, 0, 0, 3],
        ),
    ):
        assert solve(LCP(M, q)).status is not Status.SOLVED


@pytest.mark.full
def test_integers_with_tiny_diagonals_by_all_cases() -> None:
    """No SOLVED of 300 drawn problems is false, and none of ten planted ones."""
    rng = np.random.default_rng(3)
    for _ in range(300):
        case = tiny_diagonals.drawn(rng, int(rng.integers(1, 6)))
        assert not tiny_diagonals.judged(case)[0].endswith("falsely"), case
    for _ in range(10):
        M, q, right = tiny_diagonals.planted(rng)
        result = solve(LCP(M, q))
        assert not result.is_solved or abs(result.z - right).max() <= 1e-3 * abs(right).max()


def test_a_degenerate_row_that_sweeps_approach_is_right() -> None:
    """z* = w* = 0: what is left of z in such a row is as large as its terms, and no wrong row."""
    M = 4.0 * np.eye(60) - np.eye(60, k=1) - np.eye(60, k=-1)
    z = np.where(np.arange(60) < 20, 1.0, 0.0)
    result = solve(LCP(M, np.where(np.arange(60) == 20, 1.0, 0.0) - M @ z), "npgs")
    assert result.is_solved
    assert result.z == pytest.approx(z, abs=1e-7)
    assert result.iterations <= 80


@pytest.mark.parametrize("none", [1e20, 1e30, np.inf])
def test_a_bound_of_1e20_is_none(none: float) -> None:
    """As in files and other solvers: in arrays, with another q, in a batch; 1e19 is a bound."""
    M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-5.0, 1.0])
    problem = LCP(M, q, lower=-none, upper=[none, 1e19])
    assert problem.lower.tolist() == [-np.inf, -np.inf]
    assert problem.upper.tolist() == [np.inf, 1e19]
    right = np.linalg.solve(M, -q)
    other = problem.with_q(2.0 * q, lower=[-1e25, -none])
    batch = solve_batch(M, np.array([q, 2.0 * q]), lower=-none, upper=np.full((2, 2), none))
    answers = [solve(problem), solve(other), *batch]
    for result, expected in zip(answers, (right, 2.0 * right, right, 2.0 * right), strict=True):
        assert result.is_solved
        assert result.z == pytest.approx(expected)
