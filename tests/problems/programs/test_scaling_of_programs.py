"""No answer to a program depends on its units: one criterion, and exact proofs that no tolerance overrules."""

import contextlib

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import scaled_programs
from scipy.optimize import linprog

from lcp_plugin import InvalidProblem, QuadraticProgram, Status, solve, solve_batch


@pytest.mark.quick(4)
@pytest.mark.parametrize("tolerance", [1e-8, 1e-12])
@pytest.mark.parametrize(
    ("c", "rows"),
    [
        ([-1e-6], {"lower": -1.0}),
        ([-1.0], {"G": [[-1e6]], "h": [1e6]}),
        ([-1e12, 0.0], {"A": [[1.0, -1.0]], "b": [0.0]}),
        ([1.0, 1e-10], {"A": [[1.0, 0.0]], "b": [1.0]}),
        *(([-1.0, 0.0], {"A": [[s, -s]], "b": [0.0]}) for s in (1e-12, 1e-9, 1e-6, 1e6, 1e9, 1e12)),
    ],
)
def test_what_falls_for_ever_is_unbounded_in_any_unit(c, rows, tolerance):
    """However small the slope, however large the row: UNBOUNDED, with a proof that verifies exactly."""
    result = solve(QuadraticProgram(None, c, **rows), tolerance=tolerance)
    assert result.status is Status.UNBOUNDED
    assert result.proof is not None
    assert result.proof.is_exact
    assert result.proof.verify()


def test_a_small_slope_is_followed_to_its_bound():
    """Minimizing −1e-9 x over x ≤ 1 is at x = 1, alone and in a batch, not at 0 within a tolerance."""
    assert solve(QuadraticProgram(None, [-1e-9], upper=1.0)).x.tolist() == [1.0]
    answers = solve_batch(QuadraticProgram(None, [0.0], upper=1.0), [[-1e-9], [-1e-6]])
    assert answers.x.tolist() == [[1.0], [1.0]]


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("family", scaled_programs.FAMILIES)
def test_planted_programs_say_the_same_in_every_unit(family, seed):
    """Sparse, dense, degenerate, of low rank, linear; with a minimum, infeasible, unbounded; units of 10^±12."""
    pytest.importorskip("scipy", minversion="1.15")  # the programs are drawn by random_array(rng=…)
    assert scaled_programs.one(family, seed) == []


@pytest.mark.parametrize(
    "far", [{"upper": [np.inf, 1e15]}, {"upper": [np.inf, 1e19]}, "row"], ids=str
)
@pytest.mark.parametrize("by", [1e-3, 1e-5])
def test_a_far_limit_hides_no_contradiction(far, by):
    """x₁ ≤ 1 and x₁ ≥ 1 + 1e-5 contradict, whatever limit of x₂ nobody reaches."""
    G, h = [[1.0, 0.0], [-1.0, 0.0]], [1.0, -1.0 - by]
    rows = {"G": [*G, [0.0, 1.0]], "h": [*h, 1e15]} if far == "row" else {"G": G, "h": h, **far}
    result = solve(QuadraticProgram(np.eye(2), [1.0, -1.0], **rows))
    assert result.status is Status.INFEASIBLE
    assert result.proof.is_exact
    assert result.proof.verify()
    assert result.proof.least_violation == pytest.approx(by / 2, rel=1e-6)


@pytest.mark.parametrize("far", [-1e13, -1e15, -1e16, -1e19])
def test_an_unknown_far_out_excuses_no_row_that_it_has_no_part_in(far):
    """x₂ = −1 by one row and x₁ at a bound of −1e19: right where −1 is permitted, contradictory where it is −10."""
    programs = [
        QuadraticProgram(
            None, [3.0, 2.0], A=[[0.0, -2.0]], b=[b], lower=[far, -1.0], upper=[3.0, np.inf]
        )
        for b in (2.0, 20.0)
    ]
    met, contradictory = map(solve, programs)
    assert met.status is Status.SOLVED
    assert met.x.tolist() == [far, -1.0]
    assert contradictory.status is Status.INFEASIBLE
    assert contradictory.proof.is_exact
    assert contradictory.proof.verify()


@pytest.mark.parametrize("exponent", [-40, -35, 35, 40])
@pytest.mark.parametrize("curvature", [0.0, 2.0])
def test_an_unknown_in_no_row_has_the_unit_of_the_others(exponent, curvature):
    """One unknown in a row or in P, one that only falls: UNBOUNDED, whatever unit both of them are in."""
    s = 2.0**exponent
    program = QuadraticProgram(
        np.diag([curvature * s * s, 0.0]), [-s, -s], G=[[s, 0.0]], h=[1.0], lower=[0.0, 0.0]
    )
    assert solve(program).status is Status.UNBOUNDED


@pytest.mark.parametrize(
    ("P", "c", "h", "message"),
    [
        (np.eye(2), [1.0, 1.0], 1e200, Status.SOLVED),
        (np.eye(2), [1.0, 1.0], 0.0, Status.SOLVED),
        (np.diag([1.0, 0.0]), [1.0, 1.0], -1.0, Status.SOLVED),
        (np.diag([1.0, 0.0]), [1.0, 1.0], 1e200, Status.UNBOUNDED),
        (None, [1.0, 1.0], 1e200, Status.UNBOUNDED),
        (np.eye(2), [1.0, 1.0], -1.0, None),
    ],
)
def test_numbers_beyond_the_range_of_doubles_are_no_answer(P, c, h, message):
    """−1e-200 x ≤ h: a status and finite x; not SOLVED with a multiplier or an objective of 1e400; never a warning."""
    program = QuadraticProgram(P, c, G=[[0.0, -1e-200]], h=[h])
    if message is None:
        with contextlib.suppress(InvalidProblem):
            assert not solve(program).is_solved
        far = solve(QuadraticProgram(P, c, G=[[0.0, -1.0]], h=[1e200 * h]))
        assert not far.is_solved
        assert np.isfinite(far.x).all()
        return
    result = solve(program)
    assert result.status is message
    assert np.isfinite(result.x).all() == (message is Status.SOLVED)


@pytest.mark.parametrize("exponent", [0, 60, 100, 300, 996, -60, -300])
def test_costs_of_any_size_have_the_value_of_ordinary_ones(exponent):
    """Costs times 2^k, also where products of doubles overflow; unbounded optimal faces hide no better value."""
    costs = 2.0**exponent
    square = solve(
        QuadraticProgram(costs * np.array([[2.0, 1], [1, 2]]), costs * np.array([-5, 1]))
    )
    assert square.x == pytest.approx([11 / 3, -7 / 3], rel=1e-6)
    if exponent < 996:
        line = QuadraticProgram(None, costs * np.array([1.0, -1]), [[-1, 1]], [2])
        assert solve(line).objective / costs == pytest.approx(-2.0, rel=1e-5)
        bounds = {"lower": [-4, -np.inf, -np.inf], "upper": [0, -2, np.inf]}
        space = QuadraticProgram(
            None, costs * np.array([2.0, -3, 2]), [[3, 3, -2]], [-10], **bounds
        )
        assert solve(space).objective / costs == pytest.approx(-10.0, rel=1e-5)


def test_quantile_regression_with_heavy_tails_is_solved_by_the_first_solver():
    """The polish balances a gradient of 10 000 multipliers, whose plain sum has a rounding error of 1e-9."""
    rng, m = np.random.default_rng(5), 5000
    Z = np.column_stack([np.ones(m), rng.normal(size=m)])
    right, one = Z @ [1.0, 2.0] + rng.standard_t(3, m), sp.eye_array(m)
    rows = sp.block_array([[-Z, -one, None], [Z, None, -one]])
    costs = np.concatenate([np.zeros(2), np.full(m, 0.3), np.full(m, 0.7)])
    lower = np.append(np.full(2, -np.inf), np.zeros(2 * m))
    program = QuadraticProgram(None, costs, rows, np.append(-right, right), lower=lower)
    result = solve(program)
    assert (result.status, result.algorithm) == (Status.SOLVED, "auto: piqp")
    dual = linprog(-right, A_eq=Z.T, b_eq=np.zeros(2), bounds=[(-0.7, 0.3)] * m)
    assert result.objective == pytest.approx(-dual.fun, rel=1e-9)


def test_full_matrices_are_dense_in_any_storage():
    """Sparse storage of full rows does not lead to sparse arithmetic; rows with few entries stay sparse."""
    rows, n = sp.csr_array(np.ones((500, 500))), 500
    full = QuadraticProgram(sp.eye_array(n), np.zeros(n), rows, np.ones(n))
    few = QuadraticProgram(sp.eye_array(n), np.zeros(n), sp.eye_array(n), np.ones(n))
    assert [sp.issparse(one.matrices.arrays[0]) for one in (full, few)] == [False, True]
