"""Programs that new users write, with default settings: the right value and status, and soon."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import (
    InvalidProblem,
    QPSolver,
    QuadraticProgram,
    Status,
    certify,
    solve,
    solve_batch,
    trace,
)


def test_a_linear_program_over_a_box_is_never_dense():
    """The signs of the costs decide: P without entries, None or 0, would take 320 GB."""
    c = np.random.default_rng(0).standard_normal(200_000)
    result = solve(QuadraticProgram(None, c, lower=0, upper=1)).require_solved()
    np.testing.assert_array_equal(result.x, (c < 0.0).astype(float))
    assert solve(QuadraticProgram(0, c[:50], lower=0)).status is Status.UNBOUNDED


def test_one_full_row_makes_no_dense_matrix():
    """The cheapest of 5 000 unknowns whose sum is 1."""
    c = np.random.default_rng(0).standard_normal(5_000)
    result = solve(QuadraticProgram(None, c, A=np.ones((1, c.size)), b=[1], lower=0))
    assert result.is_solved
    assert result.objective == pytest.approx(c.min(), rel=1e-6)


@pytest.mark.parametrize("by", [1e-7, 2e-7])
def test_a_small_contradiction_has_one_status(by):
    """x₁ = 1, x₂ = x₁ and x₂ = 1 − 1e-7, the same with every row twice, and in another unit of the objective."""
    A, b = np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, -1.0]]), np.array([1.0, 0.0, -1.0 + by])
    stated = (
        QuadraticProgram(None, [1, 1], A=A, b=b, lower=0),
        QuadraticProgram(None, [1, 1], A=np.vstack([A, A]), b=np.append(b, b), lower=0),
        QuadraticProgram(None, [2.0**20, 2.0**20], A=A, b=b, lower=0),
    )
    assert {solve(program).status for program in stated} == {Status.INFEASIBLE}


def grid(n: int, seed: int = 0) -> Any:
    """Four entries in each of n rows."""
    rng = np.random.default_rng(seed)
    return sp.random_array((n, n), density=4.0 / n, rng=rng, format="csr")


@pytest.mark.full
def test_an_unbounded_program_of_thousand_rows_is_unbounded():
    """Its rows bound differences only, and every unknown falls at the same rate."""
    G = grid(1_000)
    rows = sp.csr_array(sp.hstack([G, -G.sum(axis=1)[:, np.newaxis]]))
    program = QuadraticProgram(None, np.append(-np.ones(1_000), 0.0), rows, np.ones(1_000), lower=0)
    assert solve(program).status is Status.UNBOUNDED


@pytest.mark.full
def test_an_infeasible_program_of_thousand_rows_is_proved():
    """All rows sum up to a contradiction that rounding of their sum does not hide."""
    n = 1_000
    G = grid(n)
    rows = sp.vstack([G, -G.sum(axis=0)[np.newaxis]])
    result = solve(
        QuadraticProgram(sp.eye_array(n), np.ones(n), rows, np.append(np.ones(n), -n - 1))
    )
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()


def test_the_tolerance_is_the_one_that_is_tested():
    """1e-6 by default, in `solve`, `solve_batch` and `trace`; rows are tested to 1e-9 at any tolerance."""
    program = QuadraticProgram(np.eye(2), [-1, -2], [[1, 1]], [1])
    assert solve(program).tolerance == 1e-6
    assert solve_batch([program, program])[0].tolerance == 1e-6
    assert trace(program, {"h": [1.0]}, 0, 1).status is Status.SOLVED
    for tolerance in (1e-4, 1e-8):
        assert solve(program, tolerance=tolerance).tolerance == tolerance
    off = program.with_vectors(h=[1.0 - 1e-8])
    found = solve(program).solution
    assert found.is_optimal(1e-4)
    assert not type(found).of_rows(off, found.x, found.multipliers).is_optimal(1e-4)


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.full
def test_a_quasiconvex_program_is_bisected():
    """(v₀ + 2 v₁ + 1)/(v₀ + v₁ + 1) over [0, 3]² is 1 at v₁ = 0.

    The bisection ends with constraints that contradict by 10⁻¹⁴: neither feasible nor infeasible.
    """
    v = cp.Variable(2, nonneg=True)
    problem = cp.Problem(cp.Minimize((v[0] + 2 * v[1] + 1) / (v[0] + v[1] + 1)), [v <= 3])
    problem.solve(qcp=True, solver=QPSolver())
    assert problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
    assert problem.value == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("name", ["lemke", "npsor"])
def test_methods_of_complementarity_solve_programs_by_name(name):
    """Their answer passes the same test."""
    program = QuadraticProgram([[2, 1], [1, 2]], [-3, -3], lower=0)
    result = solve(program, name)
    assert result.is_solved
    assert result.solution.is_optimal()
    assert result.x == pytest.approx([1, 1], abs=1e-6)
    assert result.z.shape == (2,)


def test_a_constant_is_in_the_objective_and_in_its_bounds():
    """(x − 3)² over x ≤ 1 as x² − 6 x + 9 is 4: in a result, a certificate, a batch, cvxpy, and for other vectors."""
    program = QuadraticProgram([[2.0]], [-6.0], upper=1.0, constant=9.0)
    result = solve(program)
    assert program.objective([1.0]) == 4.0
    assert result.objective == result.solution.objective == pytest.approx(4.0, abs=1e-12)
    found = certify(result)
    assert found.verdict == "proved"
    assert found.lower <= 4.0 <= found.upper + 1e-12
    assert found.upper - found.lower <= 1e-12
    assert certify(program, [0.0]).reason == "a feasible point has the objective 4, below 9"
    assert solve(program.with_vectors(upper=[2.0])).objective == pytest.approx(1.0)
    assert program.with_vectors(constant=0.0).constant == 0.0
    ranges = QuadraticProgram.from_ranges([[2.0]], [-6.0], [[1.0]], [-1.0], [1.0], constant=9.0)
    assert solve(ranges).objective == pytest.approx(4.0)
    batch = [program, QuadraticProgram([[2.0]], [-4.0], upper=1.0, constant=4.0)]
    assert solve_batch(batch).objective == pytest.approx([4.0, 1.0])
    assert [solve(batch[k]).objective for k in range(2)] == pytest.approx([4.0, 1.0])
    assert solve_batch([program, program]).objective == pytest.approx([4.0, 4.0])
    x = cp.Variable()
    problem = cp.Problem(cp.Minimize(x**2 - 6 * x + 9), [x <= 1])
    problem.solve(solver=QPSolver)
    assert problem.value == pytest.approx(4.0)
    assert certify(problem).upper == pytest.approx(4.0)
    for wrong in (np.nan, np.inf, "a", [1.0], True):
        with pytest.raises(InvalidProblem, match="constant must be a finite number"):
            QuadraticProgram([[2.0]], [-6.0], constant=wrong)


def test_a_constant_that_cancels_the_rest_leaves_the_digits_of_both():
    """(x − 10⁸)² at x = 10⁸ + 1 is 1: the terms are 10¹⁶, and the constant is one of them."""
    program = QuadraticProgram([[2.0]], [-2e8], constant=1e16)
    assert program.objective([1e8 + 1.0]) == 1.0


def test_a_sparse_program_of_six_thousand_rows_and_variables_is_proved_unbounded():
    """Fewer rows than unknowns leave a direction along which any other costs fall."""
    rng = np.random.default_rng(0)
    rows = sp.random_array((2_900, 3_200), density=1.6e-3, rng=rng, format="csr")
    x, costs = rng.standard_normal((2, 3_200))
    result = solve(QuadraticProgram(None, costs, rows, rows @ x + 1.0))
    assert result.status is Status.UNBOUNDED
    direction = np.array(result.proof.direction, dtype=float)
    assert (rows @ direction).max() <= 1e-12 * np.abs(direction).max()
    assert costs @ direction < 0.0


@pytest.mark.full
def test_the_search_for_a_proof_against_a_huge_point_ends():
    """A nearly singular matrix, x of size 1e9: the simplex method of the search, which repeats vertices, is cut off."""
    rng = np.random.default_rng(1)
    rows = sp.random_array((1_000, 1_000), density=3e-3, rng=rng, format="csr")
    x, y = rng.random((2, 1_000))
    result = solve(QuadraticProgram(None, -rows.T @ y, rows, rows @ x + 1.0), max_seconds=600.0)
    assert result.status is not Status.MAX_SECONDS


def test_a_banded_program_loads_no_numba():
    """5 000 unknowns in a chain: the band in another order shows that a factorization stays sparse."""
    code = (
        "import sys, numpy as np, scipy.sparse as sp, lcp_plugin as lp\n"
        "rows = sp.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(4998, 5000))\n"
        "P = sp.eye_array(5000).tocsr()\n"
        "assert lp.solve(lp.QuadraticProgram(P, np.ones(5000), rows.tocsr(), np.ones(4998))).is_solved\n"
        "assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_point_inside_an_optimal_face_names_the_solver_that_returns_a_vertex():
    """An assignment with ties: shares by auto, zeros and ones by HiGHS, whose advice does not repeat it."""
    n = 12
    rows = np.vstack([np.kron(np.eye(n), np.ones(n)), np.kron(np.ones(n), np.eye(n))])
    cost = np.random.default_rng(0).integers(1, 4, n * n)
    program = QuadraticProgram(None, cost, A=rows, b=np.ones(2 * n), lower=0)
    assert 'solve(program, "highs")' in solve(program).advice
    vertex = solve(program, "highs")
    assert set(vertex.x.round(9).tolist()) == {0.0, 1.0}
    assert "vertex" not in vertex.advice + vertex.explain()


@pytest.mark.parametrize("seed", range(4))
def test_the_only_optimum_of_a_linear_program_is_a_vertex_without_advice(seed):
    """Random costs over random rows; a quadratic program has an optimum inside, and no such advice either."""
    random = np.random.default_rng(seed)
    G, c = random.standard_normal((5, 8)), random.standard_normal(8)
    for P in (None, np.eye(8)):
        result = solve(QuadraticProgram(P, c, G=G, h=random.random(5) + 1.0, lower=-1, upper=1))
        assert "vertex" not in result.advice
