"""Constraints that contradict: proved by what engines and least squares see, whatever the objective is; by how much."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import (
    EquilibriumProgram,
    QuadraticProgram,
    Status,
    UnsupportedModel,
    certify,
    solve,
)

INF = np.inf


@pytest.mark.parametrize("algorithm", ["auto", "daqp", "lemke"])
def test_rows_that_contradict_are_infeasible_for_every_objective(algorithm):
    """A Farkas vector speaks of the rows alone; where they have a point, a nonconvex program is refused as before."""
    P, c, rows = np.diag([1.0, -1.0]), np.zeros(2), [[1.0, 1.0], [-1.0, -1.0]]
    program = QuadraticProgram(P, c, rows, [1.0, -2.0])
    result = solve(program, algorithm)
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()
    assert certify(result).verdict == certify(program, claim="infeasible").verdict == "proved"
    for other in (
        QuadraticProgram(P, c, rows, [1.0, 2.0]),
        QuadraticProgram(P, c, rows, [1.0, -1.0 - 1e-9]),
    ):
        with pytest.raises(UnsupportedModel, match="not convex"):
            solve(other, algorithm)
    with pytest.raises(UnsupportedModel, match="not convex"):
        solve(program, algorithm, prove_infeasibility=False)


TINY = 1e-13


@pytest.mark.quick(3)
@pytest.mark.parametrize("lower", [0.0, -INF])
@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("others", [0, 3])
def test_a_limit_of_rounding_size_is_met_or_refuted_at_once(lower, signs, others):
    """d·x + (1 + d)·y ≤ −d with d = 1e-13, in all signs, bounded and free: an answer that meets it, or a proof."""
    n = 2 + others
    row = np.concatenate([np.multiply(signs, [TINY, 1.0 + TINY]), np.zeros(others)])
    result = solve(QuadraticProgram(np.eye(n), np.ones(n), row[None], [-TINY], lower=lower))
    if lower == 0.0 and signs == (1, 1):
        assert result.status is Status.INFEASIBLE
        assert result.proof.verify()
    else:
        assert result.is_solved
        assert row @ result.x <= 1e-6 * TINY + 1e-12 * np.abs(row * result.x).max()


@pytest.mark.quick(1)
@pytest.mark.parametrize("slope", [0.0, 1.0])
@pytest.mark.parametrize("P", [np.eye(2), np.zeros((2, 2))])
def test_rounding_in_the_place_of_0_is_named_at_once(P, slope):
    """X + y ≤ −1e-17 over x, y ≥ 0: neither met nor a contradiction that counts, and no run finds anything else."""
    for row, limit in (([1.0, 1.0], -1e-17), ([1e-14, 1.0], -1e-14)):
        result = solve(QuadraticProgram(P, np.full(2, slope), [row], [limit], lower=0.0, upper=3.0))
        assert result.status is Status.PRECISION_LIMIT
        assert "rounding level relative to their coefficients" in result.explain()
        np.testing.assert_array_equal(result.x, 0.0)


def test_what_an_engine_says_of_a_program_without_its_zero_rows_is_read_as_of_that():
    """The least x² with 2 + 2e-8 ≤ x ≤ 2 − 2e-8 and 0 x ≤ −6e-9: the engine is asked with fewer rows."""
    program = QuadraticProgram(
        [[2.0]], [0.0], G=[[-1.0], [2.0], [0.0], [1.0]], h=[-2.00000002, 10, -6e-9, 1.99999998]
    )
    assert not solve(program).is_solved


@pytest.mark.parametrize("tilt", [0.0, 2.0**-52, 1e-15])
def test_nearly_parallel_rows_within_the_tolerance_are_met(tilt):
    """The rows x + y ≤ 1 and (1 + tilt) x + y ≥ 1 + 1e-9: the least ½‖x‖² + x + y is at (1/2, 1/2)."""
    rows = [[1.0, 1.0], [-1.0 - tilt, -1.0]]
    result = solve(QuadraticProgram(np.eye(2), np.ones(2), rows, [1.0, -1.0 - 1e-9]))
    assert result.is_solved or result.status is Status.INFEASIBLE
    assert result.proof is not None or result.x == pytest.approx([0.5, 0.5], abs=1e-6)


@pytest.mark.quick(1)
@pytest.mark.parametrize("k", [43, 44, 45, 47, 50])
@pytest.mark.parametrize("is_inequality", [False, True])
def test_a_direction_that_leaves_the_rows_is_no_recession_direction(k, is_inequality):
    """Rows (1, 1) and (1, 1 + 2⁻ᵏ) meet in (−1, 2), the least x₁; along (−1, 1) the second one changes by 2⁻ᵏ."""
    rows = np.array([[1.0, 1.0], [1.0, 1.0 + 2.0**-k]])
    right = np.array([1.0, 1.0 + 2.0 ** (1 - k)])
    signs = np.array([-1.0, 1.0])
    limited = {"G": signs[:, None] * rows, "h": signs * right}
    program = QuadraticProgram(
        None, [1.0, 0.0], **(limited if is_inequality else {"A": rows, "b": right})
    )
    result = solve(program)
    assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT)
    if result.is_solved:
        assert result.x == pytest.approx([-1.0, 2.0])
    limited_run = solve(program, "daqp")
    assert limited_run.status in (Status.SOLVED, Status.PRECISION_LIMIT)
    assert limited_run.is_solved or "up to" in limited_run.advice
    assert certify(program, [-1.0, 2.0]).verdict == "proved"
    assert certify(program, claim="unbounded").verdict == "disproved"


def test_the_status_does_not_depend_on_an_earlier_call():
    """X + y ≤ −1e-17 over x, y ≥ 0 without and with a search for a proof, in both orders."""

    def program():
        return QuadraticProgram(None, [1.0, 1.0], G=[[1.0, 1.0]], h=[-1e-17], lower=0.0)

    one, other = program(), program()
    first = [solve(one, prove_infeasibility=sought).status for sought in (False, True, False)]
    second = [solve(other, prove_infeasibility=sought).status for sought in (True, False, True)]
    assert first == [Status.STALLED, Status.PRECISION_LIMIT, Status.STALLED]
    assert second == [Status.PRECISION_LIMIT, Status.STALLED, Status.PRECISION_LIMIT]


@pytest.mark.quick(1)
@pytest.mark.parametrize("unit", [2.0**-60, 1e-10, 1.0, 1e9])
@pytest.mark.parametrize("door", ["equality", "inequality", "cvxpy", "pairs"])
def test_a_row_without_coefficients_is_judged_by_its_own_side(door, unit):
    """0 = 1 is infeasible in every unit, next to a row whose side is 1000 times smaller as well; 0 = 1e-16 is 0 = 0."""
    for side, status in ((1.0, Status.INFEASIBLE), (1e-16, Status.SOLVED)):
        rows, other = np.array([[0.0, 0.0], [1.0, 1.0]]), 1e-3 if side == 1.0 else 1.0
        limits = unit * np.array([side, other])
        sides = {"A": rows, "b": limits}
        if door == "inequality":
            sides = {"G": -rows, "h": -limits}
        program = QuadraticProgram(None, [1.0, 2.0], **sides, lower=0.0, upper=unit)
        if door == "cvxpy":
            x = cp.Variable(2, nonneg=True)
            stated = [x[0] - x[0] == limits[0], cp.sum(x) == limits[1], x <= unit]
            problem = cp.Problem(cp.Minimize(x[0] + 2.0 * x[1]), stated)
            problem.solve(method="LCP")
            result = problem.solver_stats.extra_stats
        else:
            result = solve(EquilibriumProgram(program, [], []) if door == "pairs" else program)
        assert result.status is status
        if door != "cvxpy" and status is Status.SOLVED:
            assert certify(program, result.x).verdict != "disproved"
