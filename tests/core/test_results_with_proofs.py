"""A result whose status is INFEASIBLE, NO_SOLUTION or UNBOUNDED has no numbers that could be applied by mistake."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_plugin import (
    LCP,
    ConeProblem,
    EquilibriumProgram,
    FrictionalContact,
    QuadraticProgram,
    Status,
    certify,
    prepare,
    solve,
    solve_batch,
    variational,
)

INF = np.inf
SUM = QuadraticProgram(None, [1.0, 2.0], A=[[1.0, 1.0]], b=[-1.0], lower=0)
PAIRED = QuadraticProgram(None, [1.0, 1.0], lower=1.0)
FALLING = QuadraticProgram(None, [-1.0, 0.0], lower=0)
UNSOLVABLE = [
    (LCP([[-1.0, 0.0], [0.0, 1.0]], [-1.0, 2.0]), Status.INFEASIBLE),
    (LCP([[-1.0]], [1.0], lower=2.0, upper=INF), Status.INFEASIBLE),
    (LCP([[0.0, 0, 0], [1, 0, 0], [2, 0, 2]], [1.0, -1e-3, -2.0]), Status.NO_SOLUTION),
    (QuadraticProgram(np.eye(2), [1.0, 1.0], [[1, 0], [-1, 0]], [-1.0, -1.0]), Status.INFEASIBLE),
    (QuadraticProgram(None, [-1.0, 0.0], A=[[1.0, -1.0]], b=[0.0], lower=0), Status.UNBOUNDED),
    (ConeProblem(np.zeros((3, 3)), [-1.0, 0, 0], [("second_order", 3)]), Status.INFEASIBLE),
    (FrictionalContact(np.zeros((3, 3)), [-1.0, 0, 0], 0.5), Status.INFEASIBLE),
    (EquilibriumProgram(SUM, [0], [1]), Status.INFEASIBLE),
    (EquilibriumProgram(PAIRED, [0], [1], 0.0, INF), Status.NO_SOLUTION),
    (EquilibriumProgram(FALLING, [0], [1]), Status.UNBOUNDED),
]


@pytest.mark.parametrize(("problem", "status"), UNSOLVABLE)
def test_every_vector_of_an_unsolvable_problem_is_nan(problem, status):
    """x, z, w and the multipliers, of one result and in a batch; the explanation still says why."""
    result = solve(problem)
    assert result.status is status
    vectors = [getattr(result, name) for name in ("x", "z", "w") if hasattr(result, name)]
    vectors += list(getattr(result, "duals", {}).values())
    assert all(np.isnan(vector).all() for vector in vectors)
    assert result.objective is None
    assert result.proof.verify()
    assert status.name in result.explain()
    batch = solve_batch([problem, problem])
    assert list(batch.status) == 2 * [status]
    assert np.isnan(batch.x).all()
    if hasattr(problem, "slack"):
        assert np.isnan(batch.w).all()


def test_a_solution_next_to_an_unsolvable_problem_is_not_touched():
    """One problem of a batch has no solution; the residual of its best point is known."""
    solvable, unsolvable = LCP([[2.0, 0], [0, 2]], [-2.0, 4]), UNSOLVABLE[0][0]
    batch = solve_batch([unsolvable, solvable])
    np.testing.assert_array_equal(batch.z, [[np.nan, np.nan], [1.0, 0.0]])
    np.testing.assert_array_equal(batch.w, [[np.nan, np.nan], [0.0, 4.0]])
    assert np.isfinite(solve(unsolvable).certificate.z).all()


def test_a_warm_step_after_an_infeasible_one_starts_anew():
    """The NaN of the last result is no start."""
    step = prepare(QuadraticProgram(np.eye(2), [0.0, 0.0], A=[[1.0, 1.0]], b=[1.0], lower=0))
    assert step.solve(b=[-1.0]).status is Status.INFEASIBLE
    np.testing.assert_allclose(step.solve(warm=True).x, [0.5, 0.5])


def test_a_nonlinear_inequality_over_an_empty_set_has_no_point():
    """x₀ + x₁ ≤ −1 is infeasible for x ≥ 0."""
    problem = variational(lambda x: x, G=[[1.0, 1.0]], h=[-1.0], lower=0)
    result = solve(problem, restarts=0)
    assert result.status is Status.INFEASIBLE
    assert np.isnan([result.z, result.w]).all()
    assert problem.origin.recover(result).status is Status.INFEASIBLE


def test_the_best_point_of_an_infeasible_lcp_is_certified():
    """certify(problem, result) measures the best point, which is no solution."""
    problem = LCP([[-1.0]], [-1.0])
    assert certify(problem, solve(problem)).verdict == "disproved"


def test_a_program_whose_pairs_have_no_solution_keeps_a_point():
    """Equations that differ by 1e-9: the conditions of optimality are infeasible, the program is nearly feasible."""
    rows, sides = [[-0.3, 0.2], [0.3, -0.2]], [0.37, -0.37 - 1e-9]
    program = QuadraticProgram([[9, -3], [-3, 1]], [-0.26, 1.4], rows, sides)
    result = solve(program, "lemke")
    assert np.isfinite(result.x).all()
    assert result.status.name in result.explain()
