"""`certify` takes every problem class: right points from outside are proved, and wrong neighbors never are."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    ConeProblem,
    EquilibriumProgram,
    FrictionalContact,
    NonlinearProblem,
    QuadraticProgram,
    certify,
    solve,
)
from lcp_plugin.core.problem_classes import CLASSES

INF = np.inf
PAIR = QuadraticProgram(None, [1.0, 2.0], A=[[1.0, 1.0]], b=[1.0], lower=0)
ONE_OF_EACH = {
    "LCP": LCP([[2.0, 1], [1, 2]], [-5.0, 1]),
    "NonlinearProblem": NonlinearProblem(lambda x: x**3 - 8.0, lower=np.zeros(1)),
    "QuadraticProgram": QuadraticProgram(np.eye(2), [1.0, -1.0], lower=0),
    "EquilibriumProgram": EquilibriumProgram(PAIR, [0], [1]),
    "BoundedLeastSquares": BoundedLeastSquares([[1.0, 0], [1, 1], [0, 1]], [2.0, 1, -1]),
    "ConeProblem": ConeProblem(np.eye(3), [0.0, -2.0, 0.0], [("second_order", 3)]),
    "FrictionalContact": FrictionalContact(np.eye(3), [[-1.0, 3.0, 4.0]], 0.5),
}


@pytest.mark.parametrize("name", CLASSES)
def test_every_class_has_a_verdict(name):
    """The point of a solve is proved, as an array and as a result; that point plus 0.01 is not; the rows have names."""
    problem = ONE_OF_EACH[name]
    result = solve(problem).require_solved()
    assert certify(problem, result.x).verdict == certify(problem, result).verdict == "proved"
    wrong = certify(problem, result.x + 0.01)
    assert wrong.verdict == "disproved"
    assert wrong.reason
    assert len(wrong.worst(3)) > 0 or name == "QuadraticProgram"  # all rows hold
    if name != "NonlinearProblem":  # a lambda is not pickled
        assert pickle.loads(pickle.dumps(wrong)).worst(3) == wrong.worst(3)


@pytest.mark.parametrize("seed", range(8))
def test_least_squares_points_of_scipy_are_proved_and_neighbors_are_not(seed):
    """Points of nnls and of bvls, rows and columns in units up to 1e±3; a neighbor differs by 1 % of one unknown."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(12, 5)) * 10.0 ** rng.uniform(-3, 3, 5)
    b, upper = rng.normal(size=12), 0.3 / np.abs(A).max(0)
    right = lsq_linear(A, b, (-upper, upper), method="bvls", tol=1e-15).x
    for problem, x in (
        (BoundedLeastSquares(A, b), nnls(A, b)[0]),
        (BoundedLeastSquares(A, b, lower=-upper, upper=upper), right),
    ):
        answer = certify(problem, x)
        assert answer.verdict == "proved", answer
        for j in range(5):
            near = x.copy()
            near[j] += 0.01 * np.abs(b).max() / np.abs(A[:, j]).max()
            answer = certify(problem, near)
            assert answer.verdict == "disproved", answer
            assert "x[" in answer.reason


def test_a_point_beyond_a_bound_by_rounding_counts_as_on_it():
    """−1e-12 next to 1.5 is a bound of 0 as other solvers return it; −1e-3 is not."""
    problem = ONE_OF_EACH["BoundedLeastSquares"]
    assert certify(problem, [1.5, -1e-12]).verdict == "proved"
    answer = certify(problem, [1.5, -1e-3])
    assert answer.verdict == "disproved"
    assert answer.reason == "x[1] = -0.001 is beyond its bound 0"


@pytest.mark.parametrize("seed", range(6))
def test_points_of_an_equilibrium_program_by_enumeration(seed):
    """4 pairs: the best of 16 pieces by HiGHS is proved; other pieces never are; a broken pair is named."""
    from scipy.optimize import linprog

    rng, k = np.random.default_rng(seed), 4
    M, q = rng.normal(size=(k, k)), rng.normal(size=k)
    costs = rng.uniform(0.1, 1.0, 2 * k)
    program = QuadraticProgram(None, costs[:k], lower=0, upper=10.0)
    problem = EquilibriumProgram.of_rows(program, np.arange(k), M @ M.T + np.eye(k), q)
    program = problem.program
    points = []
    for piece in range(2**k):
        is_zero = (piece >> np.arange(k)) & 1 == 1
        upper = np.array(program.upper)
        upper[:k][is_zero], upper[k:][~is_zero] = 0.0, 0.0
        bounds = np.column_stack([np.maximum(program.lower, 0.0), upper])
        found = linprog(program.c, A_eq=program.A.toarray(), b_eq=program.b, bounds=bounds)
        if found.status == 0:
            points.append((found.fun, found.x))
    best, x = min(points, key=lambda point: point[0])
    answer = certify(problem, x)
    assert answer.verdict == "proved", answer
    assert answer.lower <= best + 1e-9
    for value, other in points:
        if value > best + 1e-5 * abs(best):
            assert certify(problem, other).verdict != "proved"
    broken = certify(problem, x + np.where(np.arange(2 * k) == k, 0.1, 0.0))
    assert broken.verdict == "disproved"


def test_without_a_bound_a_feasible_point_is_unproved():
    """An objective that is not convex has no proved bound here; an infeasible point is disproved all the same."""
    program = QuadraticProgram([[-1.0, 0], [0, 0]], [0.0, 1], lower=0, upper=[1.0, INF])
    problem = EquilibriumProgram(program, [0], [1])
    answer = certify(problem, [1.0, 0.0])
    assert (answer.verdict, answer.lower) == ("unproved", None)
    assert "no bound" in answer.reason
    answer = certify(problem, [0.5, 0.5])
    assert answer.verdict == "disproved"
    assert answer.reason == "x[0] = 0.5 and x[1] = 0.5 are not complementary"
