"""Presolve: what it takes out can be put back exactly, and a solvable problem stays solvable."""

from __future__ import annotations

from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
import scipy.sparse as sp
from exact_assignments import solutions, solves
from hypothesis import given, settings

from lcp_plugin import LCP, Certificate, InvalidProblem
from lcp_plugin.methods.presolve import presolve

INF = np.inf


@st.composite
def sparse_lcps(draw: Any) -> LCP:
    """Small problems with many zeros, every kind of bounds, and numbers that sometimes round."""
    n = draw(st.integers(1, 4))
    number = st.sampled_from([0.0, 0.0, 0.0, 1.0, -1.0, 2.0, -3.0, 0.1, 5e-17])
    M = np.array(draw(st.lists(number, min_size=n * n, max_size=n * n))).reshape(n, n)
    if draw(st.booleans()):
        M[np.arange(n), np.arange(n)] = draw(st.lists(st.sampled_from([1.0, 2.0, 0.1]), min_size=n, max_size=n))
    q = np.array(draw(st.lists(st.sampled_from([0.0, 1.0, -1.0, 3.0, 0.3, -2.0]), min_size=n, max_size=n)))
    bounds = st.sampled_from([(0.0, INF), (0.0, INF), (-INF, INF), (-1.0, 1.0), (0.1, 0.1), (0.0, 0.0), (-INF, 2.0)])
    low, high = np.array(draw(st.lists(bounds, min_size=n, max_size=n))).T
    return LCP(sp.csr_array(M) if draw(st.booleans()) else M, q, lower=low, upper=high)


@settings.get_profile("many")
@given(sparse_lcps())
def test_solutions_come_back_exactly_and_none_is_lost(problem: LCP) -> None:
    """Each solution of the smaller problem restores to one of the original in Fractions; solvable stays solvable."""
    smaller = presolve(problem)
    below = solutions(smaller.problem)
    for z in below:
        assert solves(problem, smaller.restore(z))
    for z in solutions(problem):
        part = z[smaller.kept]
        assert solves(smaller.problem, part)
        assert solves(problem, smaller.restore(part))


@given(sparse_lcps())
def test_doubles_and_fractions_go_the_same_way(problem: LCP) -> None:
    """What restore makes of doubles is what it makes of Fractions, to rounding."""
    smaller = presolve(problem)
    for z in solutions(smaller.problem)[:3]:
        exact = np.array([*smaller.restore(z).astype(float)])
        np.testing.assert_allclose(smaller.restore(z.astype(float)), exact, atol=1e-12)


# --- The rules one by one --------------------------------------------------------------------------------------


def test_nothing_to_do_is_the_same_object() -> None:
    """Where no rule applies the problem that comes out is the one that went in, dense or sparse."""
    M = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
    for matrix in (M, sp.csr_array(M)):
        problem = LCP(matrix, [-1.0, 1.0, -1.0])
        smaller = presolve(problem)
        assert smaller.problem is problem
        z = np.ones(3)
        assert smaller.restore(z) is z


@pytest.mark.parametrize("transpose", [False, True])
def test_a_triangular_matrix_is_taken_apart(transpose: bool) -> None:
    """Murty's problem of 200 rows in either orientation, and shuffled, leaves no rows; z = (…, 0, 1) exactly."""
    n = 200
    M = np.tril(np.full((n, n), 2.0), -1) + np.eye(n)
    M = M.T if transpose else M
    expected = np.zeros(n)
    expected[-1 if transpose else 0] = 1.0
    order = np.random.default_rng(0).permutation(n)
    for place in (np.arange(n), order):
        smaller = presolve(LCP(M[np.ix_(place, place)], -np.ones(n)))
        assert smaller.problem.n == 0
        np.testing.assert_array_equal(smaller.restore(np.zeros(0)), expected[place])


def test_nonnegative_rows_are_decided() -> None:
    """A row without negative entries beside q_i ≥ 0 and m_ii > 0 is at its bound, and frees the rows beside it."""
    M = [[1.0, 2.0, 0.5], [-1.0, 1.0, 3.0], [-4.0, -1.0, 1.0]]
    smaller = presolve(LCP(M, [0.0, 1.0, -1.0]))
    assert smaller.decided == 2
    np.testing.assert_array_equal(smaller.restore(np.zeros(smaller.problem.n)), [0.0, 0.0, 1.0])


def test_a_zero_diagonal_decides_nothing_by_a_weak_sign() -> None:
    """With m_ii = 0 and w_i ≥ 0 only, z_i may be needed elsewhere: its row stays."""
    problem = LCP([[0.0, 0.0], [1.0, 0.0]], [0.0, -1.0])  # z = (1, ·) is a solution, z_1 = 0 is none
    assert 0 in presolve(problem).kept


def test_the_upper_bound_mirrors_the_lower() -> None:
    """A row whose w is negative throughout is at its upper bound."""
    problem = LCP([[1.0, 1.0], [2.0, -1.0]], [-10.0, 0.0], lower=-1.0, upper=1.0)
    smaller = presolve(problem)
    z = smaller.restore(np.zeros(smaller.problem.n)) if smaller.problem.n == 0 else None
    assert z is not None
    assert z[0] == 1.0
    assert Certificate.of(problem, z).natural_residual == 0.0


def test_a_value_that_would_round_stays() -> None:
    """A fixed 0.1 times 0.3 cannot go into q exactly: the row stays; times 2 beside q = 0 it goes."""
    stays = presolve(LCP([[1.0, 0.0], [0.3, 0.0]], [0.0, 1.0], lower=[0.1, -INF], upper=[0.1, INF]))
    assert stays.fixed == 0
    goes = presolve(LCP([[1.0, -1.0], [2.0, 0.0]], [0.0, 0.0], lower=[0.1, -INF], upper=[0.1, INF]))
    assert goes.fixed == 1
    assert goes.problem.q.tolist() == [0.2]


def test_an_infeasible_row_is_left_alone() -> None:
    """An empty row with q < 0 and no upper bound stays for those who can prove that it has no solution."""
    smaller = presolve(LCP([[0.0, 0.0], [0.0, 1.0]], [-1.0, -1.0]))
    assert smaller.problem.n == 1
    assert smaller.problem.q.tolist() == [-1.0]


def test_misuse_is_told() -> None:
    """Something else than an LCP, and a z of the wrong length, are refused with what is needed."""
    with pytest.raises(InvalidProblem, match="LCP"):
        presolve(np.eye(2))  # type: ignore[arg-type]
    with pytest.raises(InvalidProblem, match="length 0"):
        presolve(LCP([[1.0]], [-1.0])).restore([1.0])


def test_empty_and_single() -> None:
    """An empty problem stays as it is; a single row is decided or computed."""
    empty = LCP(np.zeros((0, 0)), [])
    assert presolve(empty).problem is empty
    assert presolve(LCP([[4.0]], [-1.0])).restore([]).tolist() == [0.25]
    assert presolve(LCP([[4.0]], [1.0])).restore([]).tolist() == [0.0]
