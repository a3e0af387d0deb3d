"""Constraints that contradict: proved by what engines and least squares see, whatever the objective is; by how much."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import (
    EquilibriumProgram,
    QuadraticProgram,
    Status,
    UnsupportedModel,
    certify,
    prepare,
    solve,
)
from lcp_plugin.problems.programs.no_minimum import multipliers_of_soft_rows, with_bounds

INF = np.inf
VECTORS_AND_ROWS = "c", "G", "h", "A", "b", "lower", "upper"


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


@pytest.mark.parametrize("gap", [2.0**-30, 2.0**-40])
def test_rows_that_meet_far_away_do_not_contradict(gap):
    """Rows x + 1 ≤ y and (1 − gap) y ≤ x meet at x = 1/gap − 1: a difference above rounding is part of the data."""
    program = QuadraticProgram(None, [1.0, 0.0], [[1.0, -1.0], [-1.0, 1.0 - gap]], [-1.0, 0.0])
    assert solve(program).require_solved().x[0] == pytest.approx(1.0 / gap - 1.0, rel=1e-6)


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


def inconsistent(rng: np.random.Generator, gap: float) -> QuadraticProgram:
    """Return a program whose last row contradicts others, an equation and bounds by `gap`, or by none if it is ≤ 0."""
    n, m = (int(size) for size in rng.integers(2, 12, 2))
    x, G, A = rng.normal(size=n), rng.normal(size=(m, n)), rng.normal(size=(1, n))
    low, high = x, x + rng.random(n)
    lower, upper = (
        np.where(rng.random(n) < 0.3, bound, np.inf * s) for bound, s in ((low, -1), (high, 1))
    )
    y, of_bounds = rng.random(m), rng.random(n) * np.isfinite(lower)
    G, h = np.vstack([G, of_bounds - y @ G - A[0]]), G @ x
    last = of_bounds @ np.where(np.isfinite(lower), lower, 0.0) - y @ h - A[0] @ x
    return QuadraticProgram(
        np.eye(n), rng.normal(size=n), G, np.append(h, last - gap), A, A @ x, lower, upper
    )


@pytest.mark.parametrize("gap", [10.0, 0.1, 1e-3])
def test_small_inconsistent_programs_need_no_run_and_have_a_proof(gap, draws, monkeypatch):
    """`solve` and steps return without a run; the proof is searched for when it is read."""

    def refuse(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr("lcp_plugin.problems.programs.solving.ProgramRun", refuse)
    for seed in draws(16):
        program = inconsistent(np.random.default_rng(seed), gap)
        step, stalled = prepare(program), solve(program, prove_infeasibility=False)
        for result in (solve(program), step.solve(c=program.c), step.solve(h=program.h)):
            assert result.status is Status.INFEASIBLE
            assert np.isnan(result.x).all()
            assert result.proof.verify()
        assert stalled.status is Status.STALLED
        assert stalled.proof is None
        assert (stalled.x >= program.lower).all()
        assert (stalled.x <= program.upper).all()


def test_a_small_infeasible_linear_program_needs_no_search_before_its_proof_is_read(draws):
    """Multipliers by daqp show the contradiction that PIQP reports; the proof of the status holds when it is read."""
    for seed in draws(8):
        program = inconsistent(np.random.default_rng(seed), 1.0)
        linear = QuadraticProgram(None, *(getattr(program, name) for name in VECTORS_AND_ROWS))
        result = solve(linear)
        assert result.status is Status.INFEASIBLE
        assert "proof" not in linear.known
        assert result.proof.verify()


def test_multipliers_of_soft_rows_prove_what_they_accept(draws):
    """They accept no consistent program, however small the gap, and are a proof with a margin above 1e-7 otherwise."""
    shown = 0
    for seed in draws(800, 4):
        rng = np.random.default_rng(seed)
        gap = rng.choice([0.0, -1e-9, *10.0 ** rng.uniform(-8, 1, 4)])
        program = inconsistent(rng, gap)
        found = multipliers_of_soft_rows(program.judged)
        if found is not None:
            proof = with_bounds(program, {i: Fraction(y) for i, y in enumerate(found[1]) if y})
            assert gap > 0.0
            assert proof.margin >= 1e-7
            shown += 1
    assert shown > 8
