"""Rows beside their own terms: what a residual relative to one reference hides is not SOLVED, and what is right is."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import tiny_diagonals

from lcp_plugin import LCP, Certificate, solve, solve_batch
from lcp_plugin.core.settings import Settings


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
