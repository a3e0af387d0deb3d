"""Many least squares problems with one A: exact least costs, the results of solve, limits and errors."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns.least_squares import Case, Exact, complaint
from scipy.optimize import nnls

from lcp_plugin import BoundedLeastSquares, QuadraticProgram, Status, solve, solve_batch

INF = np.inf


def mixtures(count: int, m: int = 30, n: int = 8, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return spectra A, shape (m, n), and noisy mixtures of them, shape (count, m)."""
    rng = np.random.default_rng(seed)
    A, shares = rng.random((m, n)), np.maximum(rng.standard_normal((count, n)), 0.0)
    return A, shares @ A.T + 0.01 * rng.standard_normal((count, m))


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", range(6))
def test_batch_of_small_integers_has_the_exact_least_cost(seed):
    """No SOLVED point costs more than the exact minimum by more than the tolerance."""
    rng = np.random.default_rng(seed)
    m, n, count = int(rng.integers(1, 9)), int(rng.integers(1, 7)), 30
    A = rng.integers(-3, 4, (m, n)).astype(float)
    A[:, 0] = A[:, -1] if seed % 3 == 0 else A[:, 0]
    B = rng.integers(-5, 6, (count, m)).astype(float)
    lower = np.where(rng.random((count, n)) < 0.2, -INF, -rng.integers(0, 2, (count, n)))
    upper = np.where(rng.random((count, n)) < 0.6, INF, rng.integers(0, 4, (count, n)))
    weights = None if seed % 2 else 2.0 ** rng.integers(-3, 4, m)
    ridge = float(rng.choice([0.0, 0.5]))
    problem = BoundedLeastSquares(A, B[0], weights=weights, ridge=ridge)
    results = solve_batch(problem, B, lower=lower, upper=upper)
    assert results.all_solved
    for k in range(count):
        case = Case("", A, B[k], lower[k], upper[k], weights, ridge)
        exact, x = Exact(case), results.x[k]
        assert ((lower[k] <= x) & (x <= upper[k])).all()
        assert complaint(case, exact, x) in ("", "attained 0", "above by rounding")
        cost = exact.cost([Fraction(float(value)) for value in x])
        assert results.objective[k] == pytest.approx(float(cost), rel=1e-12, abs=1e-28)


@pytest.mark.parametrize("form", [np.asarray, sp.csr_array])
def test_batch_has_the_costs_and_results_of_scipy_and_of_solve(form):
    """A batch of mixtures has the costs of nnls, and its items are results at its own points."""
    A, B = mixtures(200)
    problem = BoundedLeastSquares(form(A), B[0])
    results = solve_batch(problem, B)
    assert results.all_solved
    least = [0.5 * nnls(A, b)[1] ** 2 for b in B]
    np.testing.assert_allclose(results.objective, least, rtol=1e-9)
    for k in (0, 199):
        one, alone = results[k], solve(problem.with_vectors(b=B[k]))
        assert one.is_solved
        assert one.optimality <= one.tolerance
        assert np.array_equal(one.x, results.x[k])
        assert np.array_equal(one.active_mask, alone.active_mask)
        np.testing.assert_allclose(one.x, alone.x, rtol=1e-9, atol=1e-12)


def test_list_of_problems_with_one_matrix_has_the_same_points():
    """A list of problems that share A, also with penalties, has the points of solve."""
    A, B = mixtures(20)
    problem = BoundedLeastSquares(A, B[0])
    listed = solve_batch([problem.with_vectors(b=b) for b in B])
    assert np.array_equal(listed.x, solve_batch(problem, B).x)
    np.testing.assert_allclose(listed.objective, [one.cost for one in listed], rtol=1e-12)
    penalties = np.random.default_rng(0).random((20, 8))
    lassos = [
        problem.with_vectors(b=b, l1=l1, lower=-INF if k == 3 else 0.0)
        for k, (b, l1) in enumerate(zip(B, penalties, strict=True))
    ]
    for one, lasso in zip(solve_batch(lassos), lassos, strict=True):
        np.testing.assert_allclose(one.x, solve(lasso).x, rtol=1e-8, atol=1e-10)


def test_dependent_or_ill_conditioned_columns_are_solved_by_themselves():
    """Problems whose normal equations lose the answer are solved one by one."""
    times, rates = np.linspace(0.01, 0.32, 60), np.logspace(-2.0, 0.3, 40)
    A = np.exp(-times[:, None] / rates)
    B = np.random.default_rng(0).random((5, 40)) ** 4 @ A.T
    results = solve_batch(BoundedLeastSquares(A, B[0]), B)
    assert results.all_solved
    assert (np.linalg.norm(results.x @ A.T - B, axis=1) <= 1e-6 * np.linalg.norm(B, axis=1)).all()


def test_invalid_right_side_harms_no_other():
    """A right-hand side with NaN, or out of range, has an error."""
    A, B = mixtures(4)
    problem = BoundedLeastSquares(A, B[0], upper=3.0)
    B[1, 0], B[2] = np.nan, 1e200
    results = solve_batch(problem, B)
    assert set(results.errors) == {1, 2}
    assert np.isnan(results.x[1:3]).all()
    assert np.isnan(results.objective[1:3]).all()
    assert np.array_equal(results.x[[0, 3]], solve_batch(problem, B[[0, 3]]).x)


def test_starts_are_those_of_solve():
    """A start that is optimal is returned."""
    A, B = mixtures(4)
    problem = BoundedLeastSquares(A, B[0])
    solved = solve_batch(problem, B)
    again = solve_batch(problem, B, z0=solved.x)
    assert np.array_equal(again.x, solved.x)
    assert {one.algorithm for one in again} == {"start"}


@pytest.mark.parametrize("threads", [1, 2])
def test_callback_counts_finished_problems_and_may_end_the_batch(threads):
    """Chunks report the number of finished problems; a truthy return value interrupts the others."""
    A, B = mixtures(5000)
    problem, seen = BoundedLeastSquares(A, B[0]), []
    whole = solve_batch(problem, B, threads=threads, callback=lambda *at: seen.append(at))
    assert seen == sorted(seen)
    assert len(seen) > 2
    assert seen[-1] == (5000, 5000)
    assert np.array_equal(whole.x, solve_batch(problem, B).x)
    ended = solve_batch(problem, B, threads=threads, callback=lambda done, count: done > 0)
    assert set(ended.status) == {Status.SOLVED, Status.INTERRUPTED}
    with pytest.raises(ZeroDivisionError):
        solve_batch(problem, B, threads=threads, callback=lambda done, count: 1 // 0)


def test_one_program_takes_an_array_of_costs():
    """solve_batch(program, C) has the results of mappings {"c": c}; a NaN harms no other program."""
    rng = np.random.default_rng(0)
    factor, C = rng.standard_normal((4, 4)), rng.standard_normal((6, 4))
    program = QuadraticProgram(factor @ factor.T, C[0], G=[[1.0] * 4], h=[1.0], lower=-2.0, upper=2)
    by_name = solve_batch(program, [{"c": c} for c in C])
    for given in (C, C.tolist()):
        results = solve_batch(program, given)
        assert results.all_solved
        assert np.array_equal(results.x, by_name.x)
        assert np.array_equal(results[5].x, results.x[5])
    shifted = QuadraticProgram(np.eye(4), C[0], lower=0.0, constant=7.0)
    alone = [solve(shifted.with_vectors(c)).objective for c in C]
    np.testing.assert_allclose(solve_batch(shifted, C).objective, alone, rtol=1e-9)
    C[2, 0] = np.nan
    assert set(solve_batch(program, C).errors) == {2}
    large = QuadraticProgram(sp.eye_array(500), np.zeros(500), lower=0.0)
    assert np.array_equal(solve_batch(large, -np.ones((2, 500))).x, np.ones((2, 500)))


def test_more_than_128_atoms_stay_in_the_compiled_loop():
    """Fewer bands than atoms: each pixel has scipy's cost, and no pixel leaves the stack for a solve by itself."""
    rng = np.random.default_rng(4)
    A, B = rng.random((30, 160)), rng.random((32, 30))
    answers = solve_batch(BoundedLeastSquares(A, B[0]), B)
    assert {answers[k].algorithm for k in range(32)} == {"normal equations"}
    for k, b in enumerate(B):
        least = nnls(A, b)[1]
        assert np.linalg.norm(A @ answers.x[k] - b) <= least * (1.0 + 1e-8)
