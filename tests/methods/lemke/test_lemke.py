"""Lemke: textbook problems, games, boxes, free rows, degenerate and exponential families, exact random answers."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from collection import all_entries
from hypothesis import given
from hypothesis import strategies as st
from inputs.planted import planted_lcp
from inputs.small_families import lower_triangle
from oracles.truth import SOLVABLE
from scipy.optimize import linear_sum_assignment
from scipy.sparse.linalg import spsolve

from lcp_plugin import LCP, Certificate, Status, solve
from lcp_plugin.algorithms import Lemke, Step
from lcp_plugin.gallery.problems import five_point_matrix
from lcp_plugin.methods.lemke import rows_of_components
from lcp_plugin.methods.lemke.pivoting_path import LemkePath, canonical_box, starts
from lcp_plugin.methods.lemke.tableau import GOING_ON, SMALL_PIVOT, SOLVED

INF = np.inf
PUBLISHED = [one for one in all_entries() if one.truth == SOLVABLE and one.problem.n <= 60]


def steps(problem: LCP, z0: Any = None, **options: Any) -> list[tuple[Step, np.ndarray]]:
    start = problem.nearest_to_zero.copy() if z0 is None else np.array(z0, dtype=float)
    return [(step, step.z.copy()) for step in Lemke(**options).iterates(problem, start)]


def best(problem: LCP, **options: Any) -> Certificate:
    return min(
        (Certificate.of(problem, z) for _, z in steps(problem, **options)),
        key=lambda found: found.relative_residual,
    )


# --- published problems ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", PUBLISHED, ids=[entry.name for entry in PUBLISHED])
def test_published_problems(entry):
    """The collection's textbook problems, games and programs of up to 60 rows are solved to rounding level."""
    assert best(entry.problem).relative_residual <= 1e-12


MIXED: dict[str, Callable[[], LCP]] = {
    "relays": lambda: LCP(np.eye(4), [-5, -0.5, 0.5, 5], lower=-1, upper=1),
    "relays, coupled, indefinite": lambda: LCP(
        [[0, 2, -1], [2, 0, 3], [1, -3, -1]], [0.5, -1, 1], lower=-1, upper=1
    ),
    "upper bounds only": lambda: LCP([[2, 1], [-1, 3]], [4, 5], lower=-INF, upper=[0, 1]),
    "fixed row": lambda: LCP([[0, 1], [-1, 2]], [1, -1], lower=[2, 0], upper=[2, INF]),
    "all fixed": lambda: LCP([[0, 1], [-1, 2]], [1, -1], lower=[2, 3], upper=[2, 3]),
    "linear system": lambda: LCP([[0, 1], [2, 0]], [1, -4], lower=-INF),
    "singular system": lambda: LCP([[1, 1], [1, 1]], [-2, -2], lower=-INF),
    "singular system, shifted": lambda: LCP([[0, 3], [0, 0]], [2, 0], lower=-INF),
    "linear program, free x": lambda: LCP(
        [[0, 0, -1, 1], [0, 0, -1, -1], [1, 1, 0, 0], [-1, 1, 0, 0]],
        [1, 2, -1, 1],
        lower=[-INF, -INF, 0, 0],
    ),
    "row without effect": lambda: LCP([[2, 0, 0], [1, 0, 2], [0, 0, 0]], [1, -5, 0]),
}


@pytest.mark.parametrize("name", MIXED)
def test_boxes_and_free_rows(name):
    """Box, one-sided, fixed and free rows are solved, singular free blocks included."""
    assert best(MIXED[name]()).relative_residual <= 1e-14


def test_many_definitions_are_eliminated():
    """Eighty free variables are defined by two others, whose sum is 1; the multiplier of the sum is dependent."""
    R, one = np.tile(np.eye(2), (40, 1)), np.ones((2, 1))
    rows = [[np.eye(80), -R, None], [R.T, None, one], [None, one.T, None]]
    lower, q = np.repeat([[-INF, 0, -INF], [0, 0, -1]], [80, 2, 1], axis=1)
    result = solve(LCP(sp.block_array(rows), q, lower=lower), "lemke")
    assert result.require_solved().z == pytest.approx([0.5] * 82 + [-20], rel=1e-14)


def test_the_end_of_a_path_is_solved_again_before_it_is_judged():
    """A payoff of −1e15 is played with 1e-15, right to more digits than the tableau has left."""
    problem = LCP.from_game([[-1e15, 1.0], [0.0, 0.0]], [[99.0, 2.0], [88.0, 94.0]])
    found = problem.origin.recover(solve(problem, "lemke"))
    assert found.column_strategy == pytest.approx([1e-15, 1.0], rel=1e-12)
    assert found.row_strategy == pytest.approx([6 / 103, 97 / 103], rel=1e-12)


# --- families ---------------------------------------------------------------------------------------------------


FAMILIES: dict[str, Callable[[int], np.ndarray]] = {
    "Murty": lower_triangle,
    "Murty, transposed": lambda n: lower_triangle(n).T.copy(),
    "Fathi": lambda n: lower_triangle(n) @ lower_triangle(n).T,
    "Csizmadia": lambda n: np.eye(n) - np.tril(np.ones((n, n)), -1),
}


@pytest.mark.parametrize("n", [1, 5, 20, 60])
@pytest.mark.parametrize("name", FAMILIES)
def test_exponential_families(name, n):
    """Where one covering vector needs 2ⁿ pivots another needs few."""
    M = FAMILIES[name](n)
    # Csizmadia's answer to q = −1 is 2ⁱ, whose w no double can check at n = 60.
    problem = planted_lcp(M, 0, bounds=False)[0] if name == "Csizmadia" else LCP(M, -np.ones(n))
    found = steps(problem)
    assert min(Certificate.of(problem, z).relative_residual for _, z in found) <= 1e-12
    assert len(found) <= 90


@pytest.mark.parametrize("seed", range(10))
def test_degenerate_integers_end(seed):
    """With ties at every pivot each path ends long before the limit, and numerically sound."""
    generator = np.random.default_rng(seed)
    n = 12
    M = generator.integers(-1, 2, size=(n, n)).astype(float)
    q = generator.integers(-1, 1, size=n).astype(float)
    path = LemkePath(M, q, np.full(n, INF))
    for start in starts(path, 12):
        if start(path):
            outcome = GOING_ON
            while outcome == GOING_ON and path.pivots < 2000:
                outcome = path.advance(25)
            assert outcome not in (GOING_ON, SMALL_PIVOT)


@pytest.mark.parametrize(("k", "seed"), [(5, 1), (10, 0), (15, 0), (15, 1)])
def test_degenerate_assignments_end_in_an_optimum(k, seed):
    """Multipliers of dependent equations are free, without a diagonal; scipy's assignment costs as much."""
    costs = np.random.default_rng(seed).integers(0, 10, (k, k))
    one, each = np.ones(k), np.eye(k)
    rows = np.vstack([np.kron(each, one), np.kron(one, each)])
    result = solve(LCP.from_qp(None, costs.ravel(), A=rows, b=np.ones(2 * k), lower=0.0), "lemke")
    best = costs[linear_sum_assignment(costs)].sum()
    assert costs.ravel() @ result.require_solved().z[: k * k] == pytest.approx(best, rel=1e-12)


def test_a_row_that_completes_free_rows_keeps_its_value():
    """Next to a second component: no value is moved to a bound because it is small in the units of the path."""
    M = np.zeros((5, 5))
    M[0, 1:4], M[1:4, 0], M[4, 4] = (
        (2.0**-20, -(2.0**31), 2.0**-18),
        (-(2.0**-27), 2.0**-27, -(2.0**-27)),
        1,
    )
    problem = LCP(M, [-2, -3, 4, -4, -1], lower=[-INF, 0, 0, 0, 0])
    assert solve(problem, "lemke").is_solved


@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_a_finite_box_always_has_an_answer(n, seed):
    """Any matrix with finite bounds: the path from r > 0 cannot escape and ends in a solution."""
    generator = np.random.default_rng(seed)
    lower = generator.integers(-3, 2, size=n)
    problem = LCP(
        generator.integers(-3, 4, size=(n, n)),
        generator.integers(-5, 6, size=n),
        lower=lower,
        upper=lower + generator.integers(0, 4, size=n),
    )
    assert best(problem, restarts=0).relative_residual <= 1e-10


# --- the contract -----------------------------------------------------------------------------------------------


def test_components_are_solved_one_by_one():
    """Connected components of the matrix are found and each is solved, whatever the order of the rows."""
    order = np.random.default_rng(0).permutation(30)
    M = np.kron(np.eye(10), [[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])[
        np.ix_(order, order)
    ]
    problem = planted_lcp(M, 0, bounds=False)[0]
    assert sorted(rows.size for rows in rows_of_components(problem)) == [3] * 10
    assert best(problem).relative_residual <= 1e-14


# --- the canonical problem ----------------------------------------------------------------------------------


EXTREME = {
    "q beyond its row": ([[0.0, -1e-145], [1.0, 0.0]], [1e278, -1.0]),
    "q beyond, and no matter": ([[1e-145, 0.0], [0.0, 1.0]], [1e278, -1.0]),
    "a product that overflows": ([[1e-200, 1e200], [1e200, 1e-200]], [-1e300, 1e-300]),
    "subnormal": ([[5e-324, 0.0], [1.0, 5e-324]], [-1.0, -1e-310]),
    "a solution of 1e600": ([[1e-300, 0.0], [0.0, 1.0]], [-1e300, -1.0]),
}


@pytest.mark.parametrize("name", EXTREME)
def test_numbers_at_the_edge_raise_nothing(name):
    """Data whose scaled tableau leaves the range of doubles end a run in words, with a finite z."""
    problem = LCP(*EXTREME[name])
    result = solve(problem, "lemke")
    assert np.isfinite(result.z).all()
    assert result.status in (Status.SOLVED, Status.STALLED, Status.PRECISION_LIMIT)


def test_a_huge_q_that_does_not_matter_is_no_obstacle():
    """A row far from being active whose q overflows in the scale of the row leaves the others solvable."""
    result = solve(LCP(*EXTREME["q beyond, and no matter"]), "lemke")
    assert result.status is Status.SOLVED
    assert result.z.tolist() == [0.0, 1.0]


def test_a_time_limit_ends_starts_that_have_no_path(monkeypatch):
    """A start in a singular active set gives no path, so only the loop over the starts can read the clock."""
    now = [0.0]

    def starts_of_a_second(path, restarts):
        for start in starts(path, restarts):
            now[0] += 1.0
            yield start

    monkeypatch.setattr("lcp_plugin.core.deadline.time.perf_counter", lambda: now[0])
    monkeypatch.setattr("lcp_plugin.methods.lemke.starts", starts_of_a_second)
    problem = LCP(np.full((30, 30), -1.0), np.full(30, -1.0))
    result = solve(problem, "lemke", restarts=100, max_seconds=5.5)
    assert (result.status, now[0]) == (Status.MAX_SECONDS, 6.0)


def test_a_square_system_is_one_factorization():
    """Without bounds, auto solves a sparse nonsymmetric system with a negative diagonal by newton, in one step."""
    M = five_point_matrix(75, -4.0, (1.5, 0.25))
    result = solve(LCP(M, np.ones(5625), lower=-INF))
    assert (result.status, result.algorithm, result.iterations) == (
        Status.SOLVED,
        "auto: newton",
        1,
    )
    np.testing.assert_allclose(result.z, spsolve(M.tocsc(), -np.ones(5625)), rtol=1e-9)


def test_elimination_of_a_free_row_of_rank_one_leaves_zeros():
    """M = v vᵀ without its free row is 0, also in double precision, because pivots must not use rounding errors."""
    for seed in range(20):
        v = np.random.default_rng(seed).integers(1, 100, 9).astype(float)
        problem = LCP(np.outer(v, v), -v, lower=np.where(np.arange(9), 0.0, -np.inf))
        assert not canonical_box(problem).M.any()


def test_each_label_of_a_game_has_a_path_to_an_equilibrium():
    """Lemke, Howson (1964): whichever label is dropped, the path of a nondegenerate game ends in a solution."""
    rng = np.random.default_rng(0)
    for n in (2, 3, 4):
        problem = LCP.from_game(rng.random((n, n)), rng.random((n, n)))
        box = canonical_box(problem)
        path = LemkePath(box.M, box.q, box.upper)
        for start in itertools.islice(starts(path, 0), 2 * n):
            assert start(path)
            assert path.advance(100) == SOLVED
            assert Certificate.of(problem, box.recover(path.z)).relative_residual <= 1e-10


def test_the_far_field_of_a_chain_is_solved():
    """The path leaves out what is below its perturbation; a second active set has it."""
    n = 60
    M = 2.0 * np.eye(n) - 0.5 * (np.eye(n, k=1) + np.eye(n, k=-1))
    problem = LCP(sp.csr_array(M), -np.eye(n)[0])
    z = solve(problem, Lemke(restarts=0)).require_solved().z
    np.testing.assert_allclose(z, np.linalg.solve(M, np.eye(n)[0]), rtol=1e-9, atol=1e-30)
