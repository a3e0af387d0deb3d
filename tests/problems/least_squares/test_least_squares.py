"""Least squares within bounds: known solutions, exact gaps, statuses, errors."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import least_squares as campaign
from campaigns.kinds import SOLVED, least_cost
from campaigns.least_squares import Case, Exact, bounded_least_squares, complaint
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear, nnls
from tools.refusals import assert_refused, refusals

from lcp_plugin import BoundedLeastSquares, InvalidProblem, NotConverged, Status, solve
from lcp_plugin.core import deadline
from lcp_plugin.problems.least_squares.certificate import Optimality
from lcp_plugin.problems.least_squares.engines import FacePoint, minimize_on_face

INF = np.inf


def planted(
    A: Any, seed: int = 0, free: float = 0.5, boxed: float = 0.0
) -> tuple[Any, np.ndarray, np.ndarray, Any]:
    """A with some columns' signs turned, b, upper and the answer x within [0, upper], chosen first.

    The residual y is chosen orthogonal to the free columns; where Aᵀy has not the sign that the bound of a column
    needs, the column is turned.
    """
    rng = np.random.default_rng(seed)
    m, n = A.shape
    is_free = rng.random(n) < min(free, 0.5 * m / n)
    at_upper = ~is_free & (rng.random(n) < boxed)
    upper = np.where(at_upper | (rng.random(n) < boxed), 1.5, INF)
    x = np.where(is_free, rng.random(n) + 0.1, np.where(at_upper, upper, 0.0))
    y = rng.standard_normal(m)
    dense = A.toarray() if sp.issparse(A) else A
    orthogonal = np.linalg.qr(dense[:, is_free])[0]
    for _ in range(2):
        y -= orthogonal @ (orthogonal.T @ y)
    wrong = ~is_free & ((dense.T @ y > 0.0) == at_upper)
    turned = (
        A @ sp.diags_array(np.where(wrong, -1.0, 1.0))
        if sp.issparse(A)
        else A * np.where(wrong, -1.0, 1.0)
    )
    return turned, turned @ x - y, upper, x


def of_condition(m: int, n: int, condition: float, seed: int = 0) -> np.ndarray:
    """A dense matrix of that condition."""
    rng = np.random.default_rng(seed)
    k = min(m, n)
    left = np.linalg.qr(rng.standard_normal((m, k)))[0]
    right = np.linalg.qr(rng.standard_normal((n, k)))[0]
    return left @ np.diag(np.logspace(0.0, -np.log10(condition), k)) @ right.T


def random_rows(m: int, n: int, per_row: int, seed: int = 0) -> sp.csr_array:
    rng = np.random.default_rng(seed)
    rows = np.repeat(np.arange(m), per_row)
    return sp.csr_array(
        (rng.random(m * per_row), (rows, rng.integers(0, n, m * per_row))), shape=(m, n)
    )


def own_optimality(A: Any, b: Any, x: Any, lower: Any = 0.0, upper: Any = INF) -> float:
    """‖x − mid(lower, upper, x − Aᵀ(A x − b))‖∞/‖Aᵀb‖∞, computed here."""
    gradient = A.T @ (A @ x - b)
    return float(np.abs(np.clip(gradient, x - upper, x - lower)).max() / np.abs(A.T @ b).max())


# --- known solutions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("condition", [1e2, 1e5, 1e8])
@pytest.mark.parametrize("shape", [(60, 30), (30, 60), (300, 280), (400, 400)])
def test_planted_dense_answers_are_found(shape, condition):
    """A dense A of condition up to 1e8, tall, square or wide, gives SOLVED and the known cost."""
    A, b, upper, x = planted(of_condition(*shape, condition), boxed=0.2)
    result = bounded_least_squares(A, b, upper=upper).require_solved()
    best = 0.5 * np.sum((A @ x - b) ** 2)
    assert abs(result.cost - best) <= 1e-9 * best
    assert (result.x >= 0.0).all()
    assert (result.x <= upper).all()
    assert own_optimality(A, b, result.x, 0.0, upper) <= 1e-8
    if shape[0] >= shape[1] and condition <= 1e5:
        np.testing.assert_allclose(result.x, x, atol=1e-8)


@pytest.mark.parametrize("form", [sp.csr_array, sp.csc_matrix, sp.coo_array])
def test_planted_sparse_answers_are_found(form):
    """Any sparse format gives the known solution."""
    A, b, upper, x = planted(random_rows(3000, 600, 8), boxed=0.2)
    result = bounded_least_squares(form(A), b, 0.0, upper).require_solved()
    np.testing.assert_allclose(result.x, x, atol=1e-6)


@pytest.mark.parametrize("lower", [0.0, -INF])
@pytest.mark.parametrize(
    ("m", "n", "rank"), [(40, 2, 1), (34, 5, 1), (20, 161, 6), (30, 300, 10), (400, 300, 40)]
)
def test_rank_deficient_problems_have_an_answer_of_moderate_size(m, n, rank, lower):
    """If x is not unique, the solution is not large along singular vectors at rounding level."""
    rng = np.random.default_rng(m + n)
    A, b = rng.standard_normal((m, rank)) @ rng.standard_normal((rank, n)), rng.standard_normal(m)
    for given_A in (A, sp.csr_array(A)):
        result = bounded_least_squares(given_A, b, lower).require_solved()
        assert own_optimality(A, b, result.x, lower) <= 1e-8
        assert np.abs(result.x).max() <= 1e6


@given(st.integers(1, 12), st.integers(1, 12), st.integers(0, 10**6), st.floats(0.0, 0.8))
def test_conditions_hold_on_random_problems(m, n, seed, share):
    """Weights, a ridge, boxes, free and fixed columns, zero rows and columns, any rank: the conditions hold at x."""
    rng = np.random.default_rng(seed)
    A = rng.integers(-3, 4, (m, n)) * (rng.random((m, n)) < share)
    b, weights = rng.integers(-5, 6, m), rng.integers(0, 3, m)
    lower, upper = -rng.integers(0, 3, n).astype(float), rng.integers(0, 3, n).astype(float)
    lower[rng.random(n) < 0.3], upper[rng.random(n) < 0.3] = -INF, INF
    ridge = float(rng.choice([0.0, 0.5]))
    result = bounded_least_squares(A, b, lower, upper, weights=weights, ridge=ridge)
    assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT)
    x, fun = result.x, A @ result.x - b
    gradient = A.T @ (weights * fun) + ridge * x
    assert (lower <= x).all()
    assert (x <= upper).all()
    assert np.abs(np.clip(gradient, x - upper, x - lower)).max() <= 1e-7 * (
        1.0 + np.abs(A.T @ (weights * b)).max()
    )
    np.testing.assert_allclose(result.fun, fun, atol=1e-12 * (1.0 + np.abs(x).max()) * 50)
    assert result.cost == pytest.approx(0.5 * (weights @ fun**2 + ridge * x @ x), abs=1e-12)
    assert ((result.active_mask == -1) == (x == lower)).all()
    assert ((result.active_mask == 1) == ((x == upper) & (x > lower))).all()


# --- ranks below full -----------------------------------------------------------------------------------------


def of_rank(n: int, rank: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return a square A of this rank, up to rounding error, and b."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, rank)) @ rng.standard_normal((rank, n))
    return A, rng.standard_normal(n)


@pytest.mark.quick(1)
@pytest.mark.parametrize("bound", [INF, 1e3])
@pytest.mark.parametrize("n", [300, 500, 700])
def test_rounding_of_a_rank_hides_no_cost(n, bound):
    """Rank n − n/100, free or within ±1000: SOLVED at the cost of scipy's lsq_linear, with a moderate x."""
    A, b = of_rank(n, n - n // 100)
    result = bounded_least_squares(A, b, -bound, bound).require_solved()
    least = lsq_linear(A, b, (-1e3, 1e3)).cost
    assert result.cost == pytest.approx(least, rel=1e-8)
    assert np.abs(result.x).max() <= 1e3


@given(st.integers(0, 10**6), st.sampled_from([np.asarray, sp.csr_array]), st.booleans())
def test_no_point_that_costs_more_than_a_known_one_is_solved(seed, form, has_start):
    """Dependent columns, bounds up to 1e19, any start: SOLVED costs at most as much as the start or lstsq's point."""
    rng = np.random.default_rng(seed)
    m, n = (int(k) for k in rng.integers(2, 9, 2))
    A = rng.standard_normal((m, 1)) @ rng.standard_normal((1, n))
    A += 10.0 ** rng.integers(-17, 1) * rng.standard_normal((m, n))
    b, far = rng.standard_normal(m), 10.0 ** rng.integers(0, 20, n)
    start = np.clip(10.0 ** rng.integers(-3, 18) * rng.standard_normal(n), -far, far)
    result = bounded_least_squares(form(A), b, -far, far, x0=start if has_start else None)
    others = [start if has_start else np.zeros(n)]
    others.append(np.clip(np.linalg.lstsq(A, b, rcond=None)[0], -far, far))
    if result.is_solved:
        for x in others:
            rounding = 1e-13 * (np.abs(A) @ np.abs(x) + np.abs(b))
            most = 0.5 * np.sum((np.abs(A @ x - b) + rounding) ** 2)
            assert 0.5 * np.sum((A @ result.x - b) ** 2) <= most * (1.0 + 1e-6)


# --- typical fits -------------------------------------------------------------------------------------------


def relaxations(m: int, n: int) -> np.ndarray:
    """Exponential decays over a range of times: the kernel of an inversion for T2."""
    return np.exp(-np.linspace(0.01, 3.0, m)[:, np.newaxis] / np.logspace(-2.0, 1.0, n))


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize(("m", "n"), [(60, 80), (200, 300)])
def test_an_inversion_for_decay_times_is_solved(m, n, noise):
    """Condition 1e16 and more, with and without noise: SOLVED, at no more than the cost of scipy's nnls, in a step."""
    A = relaxations(m, n)
    b = A @ np.exp(-4.0 * np.linspace(-2.0, 2.0, n) ** 2) + noise * np.random.default_rng(
        2
    ).standard_normal(m)
    result = bounded_least_squares(A, b).require_solved()
    assert result.nit <= 2
    assert result.cost <= 0.5 * nnls(A, b, maxiter=30 * n)[1] ** 2 * (1.0 + 1e-9) + 1e-24 * (b @ b)


@pytest.mark.quick(1)
@pytest.mark.parametrize("lower", [0.0, -INF])
def test_a_clock_is_kept_by_the_judge_as_well(lower):
    """Tridiagonal, 2·10⁵ unknowns, max_seconds=.2: the run ends, and nothing is proved."""
    n = 200_000
    A = sp.diags_array(
        [np.full(n - 1, -1.0), np.full(n, 2.0), np.full(n - 1, -1.0)], offsets=[-1, 0, 1]
    ).tocsr()
    b = np.random.default_rng(0).standard_normal(n)
    result = bounded_least_squares(A, b, lower, max_seconds=0.2)
    assert result.status is Status.MAX_SECONDS
    assert result.optimality == 1.0
    np.testing.assert_allclose(result.cost, 0.5 * np.sum(np.square(A @ result.x - b)))


def test_no_step_on_a_face_begins_after_the_limit():
    """Each is a factorization: a run at its limit took up to 30 of them."""
    scaled = BoundedLeastSquares(np.eye(3) + 0.5, [1.0, 2.0, 3.0]).scaled
    rows, start = scaled.rows(is_dense=True), FacePoint(scaled, np.zeros(3))
    with deadline.limit(0.0):
        assert not minimize_on_face(start, *rows).x.any()
    assert minimize_on_face(start, *rows).x.any()


# --- the gap against exact arithmetic -----------------------------------------------------------------------


@given(
    st.integers(1, 5),
    st.integers(1, 4),
    st.integers(0, 10**6),
    st.sampled_from([1e-1, 1e-4, 1e-8, 1e-14]),
)
def test_solved_costs_no_more_than_the_tolerance_allows(m, n, seed, tolerance):
    """Rational arithmetic confirms SOLVED for all ranks and weights."""
    rng = np.random.default_rng(seed)
    A, b, weights = (
        rng.integers(-size, size + 1, shape).astype(float)
        for size, shape in ((4, (m, n)), (6, m), (2, m))
    )
    upper = np.where(rng.random(n) < 0.6, INF, rng.integers(0, 3, n))
    case = Case("", A, b, np.zeros(n), upper, abs(weights), float(rng.integers(0, 2)))
    limit = int(rng.integers(0, 4)) if tolerance > 1e-10 else None
    result = bounded_least_squares(
        A, b, 0.0, upper, weights=case.weights, ridge=case.ridge, tolerance=tolerance, max_iterations=limit
    )  # fmt: skip
    exact = Exact(case)
    true_gap = exact.cost([Fraction(value) for value in result.x.tolist()]) - exact.least
    assert true_gap >= 0
    if result.is_solved:  # at most the tolerance above the minimum, up to rounding error
        assert result.optimality <= tolerance
        assert complaint(case, exact, result.x, tolerance) != "FALSE"


def test_least_squares_in_mixed_units(draws):
    """Mixed scaling, any rank and exact fits give no false SOLVED, and 2 % unsolved."""
    kinds = (*campaign.KINDS, campaign.ODD)
    found = [
        finding.what
        for number in draws(360)
        for finding in least_cost(np.random.default_rng([7, number]), kinds[number % 10])
    ]
    assert SOLVED not in found
    assert len(found) <= 1 + 0.02 * len(draws(360))


# --- statuses -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("A", "b", "lower", "x"),
    [
        (np.zeros((3, 2)), np.ones(3), 0.0, [0.0, 0.0]),
        (np.eye(2), np.zeros(2), 0.0, [0.0, 0.0]),
        (np.eye(2), np.zeros(2), 1.0, [1.0, 1.0]),
        (np.zeros((0, 2)), np.zeros(0), -1.0, [0.0, 0.0]),
        (np.zeros((2, 0)), np.ones(2), 0.0, []),
        (sp.csr_array((3, 2)), np.ones(3), 2.0, [2.0, 2.0]),
        ([[1.0], [-1.0]], [1.0, 1.0], 0.0, [0.0]),
        ([[1.0, 0.0], [0.0, 0.0]], [2.0, 5.0], 0.0, [2.0, 0.0]),
    ],
)
def test_empty_and_trivial_problems(A, b, lower, x):
    """Empty problems, and problems with a trivial solution, return the best point nearest to 0."""
    result = bounded_least_squares(A, b, lower).require_solved()
    np.testing.assert_array_equal(result.x, x)


def test_statuses_say_why_a_run_ended():
    """Limits end a run with their status and the best point; rounding level is SOLVED."""
    A, b, _, _ = planted(random_rows(3000, 600, 8))
    none = bounded_least_squares(A, b, max_iterations=0)
    few = bounded_least_squares(A, b, max_iterations=5)
    assert none.status is few.status is Status.MAX_ITERATIONS
    assert few.nit == 5
    assert few.cost < none.cost
    assert bounded_least_squares(A, b, max_seconds=0.0).status is Status.MAX_SECONDS
    assert bounded_least_squares(A, b, tolerance=0.0).require_solved().optimality == 0.0
    with pytest.raises(NotConverged, match=r"MAX_ITERATIONS after 5 .*: optimality .*x0=result\.x"):
        few.require_solved()
    assert bounded_least_squares(A, b, x0=few.x).is_solved


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e160, 1e300])
def test_data_whose_squares_are_no_doubles_are_refused(size):
    """An A, a b or weights of 1e±160 raise InvalidProblem; one tiny entry is accepted."""
    A, b = np.array([[1.0, 0.5], [0.5, 1.0], [2.0, 1.0]]), np.ones(3)
    for data in ((size * A, b), (sp.csr_array(size * A), b), (A, size * b)):
        with pytest.raises(InvalidProblem, match=r"divide A and b by a number"):
            BoundedLeastSquares(*data)
    if size > 1.0:
        with pytest.raises(InvalidProblem, match="with weights"):
            BoundedLeastSquares(A, b, weights=[1e305, 1.0, 1.0])
    with pytest.raises(InvalidProblem, match=r"divide b, lower and upper"):
        BoundedLeastSquares(A, b).with_vectors(b=size * b)
    A[0, 1] = 1e-300
    assert bounded_least_squares(A, b).is_solved


# --- errors -------------------------------------------------------------------------------------------------


@refusals(r"""
fit([1.0, 2.0, 3.0], B) → InvalidProblem: A must be a real matrix.*shape \(3,\); write a single row
fit(A * 1j, B) → InvalidProblem: A must be a real matrix.*complex entries
fit(np.full((3, 2), np.nan), B) → InvalidProblem: A must be finite, but A\[0, 0\] = nan
fit(None, B) → InvalidProblem: A must be a real matrix.*got None
fit(A, [1.0, 2.0]) → InvalidProblem: b must be a vector of length 3, an entry per row of A, got shape \(2,\): 1 too few
fit(A, [[1.0, 2.0], [3.0], [4.0]]) → InvalidProblem: got no rectangular array
fit(A, np.ones((3, 4))) → InvalidProblem: for many right-hand sides: solve_batch\(.*got shape \(3, 4\)
fit(np.ones((3, 4)), B, (0, 1)) → InvalidProblem: lower must be a number or a vector of length 4, got shape \(2,\)
fit(A, [1.0, np.nan, 2.0]) → InvalidProblem: b must be finite, but b\[1\] = nan
fit(A, B, 1.0, [2.0, 0.0]) → InvalidProblem: lower\[1\] = 1.0 and upper\[1\] = 0.0
fit(A, B, [0.0]) → InvalidProblem: lower must be a number or a vector of length 2, got shape \(1,\)
fit(A, B, upper=np.nan) → InvalidProblem: upper must not hold NaN
fit(A, B, weights=[1.0, -1.0, 1.0]) → InvalidProblem: ≥ 0, but weights\[1\] = -1.0; 0 leaves a row out
fit(A, B, weights=[1.0]) → InvalidProblem: weights must be a vector of length 3
fit(A, B, ridge=-1.0) → InvalidOption: ridge must be a finite number ≥ 0, got -1.0
fit(A, B, x0=[1.0]) → InvalidOption: x0 must be a vector of length 2
fit(A, B, tolerance=-1e-8) → InvalidOption: tolerance must be finite and not negative
fit(A, B, max_iterations=1.5) → InvalidOption: max_iterations must be an integer
fit(A, B, max_seconds="1") → InvalidOption: max_seconds must be a finite number
""")
def test_mistakes_are_refused_in_words(call, words):
    """Error messages state the invalid value, its place, and the requirement."""
    data = {"A": np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), "B": np.array([2.0, 1.0, -1.0])}
    assert_refused(call, words, data | {"fit": bounded_least_squares})


# --- Numbers far from the others -----------------------------------------------------------------------------------


@pytest.mark.parametrize("small", [1e-120, 1e-100])
def test_a_bound_that_acts_is_one_beside_a_tiny_right_hand_side(small):
    """With b of 1e-120, lower bounds of 1 are active and never count as infinite."""
    found = bounded_least_squares([[1.0, 0.0], [1.0, 2.0]], [small, small], lower=[1.0, -INF])
    assert found.status is Status.SOLVED
    np.testing.assert_allclose(found.x, [1.0, -0.5], rtol=1e-14)


def test_rounding_that_every_answer_has_is_no_hidden_cost():
    """Equations with right-hand side 0 and large x are SOLVED at rounding level."""
    A, b = [[3.0, -2.0, 2.0], [-1.0, -3.0, 2.0], [1.0, -2.0, -2.0]], [1e15, -3.0, -2.0]
    bounds = {"lower": [0.0, 0.0, -np.inf], "upper": [np.inf, 1.0, np.inf]}
    assert solve(BoundedLeastSquares(A, b, **bounds)).is_solved
    rng = np.random.default_rng(1)
    x = np.repeat(np.maximum(rng.normal(size=30), 0.0), 2)
    pairs = np.kron(np.eye(30), [[1.0, -1.0]])
    rows = np.vstack([rng.normal(size=(40, 60)), pairs])
    assert solve(BoundedLeastSquares(rows, rows @ x)).is_solved


def test_a_cost_is_that_of_its_x():
    """For nearly dependent columns x is large, the residual cancels, its cost accurate to 1e-7."""
    A, b = [[2.0, 2.0], [1.0, 1.0 + 1e-12], [3.0, 3.0]], [1.0, 2.0, 3.0]
    result = solve(BoundedLeastSquares(A, b, lower=-np.inf))
    off = [
        sum(Fraction(a) * Fraction(v) for a, v in zip(row, result.x.tolist(), strict=True))
        - Fraction(right)
        for row, right in zip(A, b, strict=True)
    ]
    assert result.cost == pytest.approx(float(sum(one * one for one in off) / 2), rel=1e-7)


def test_a_start_at_the_solution_is_measured_alone(monkeypatch):
    """The start is returned after one measurement, as many as a call without a start needs."""
    problem = BoundedLeastSquares([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [2.0, 1.0, -1.0])
    points: list[np.ndarray] = []
    measure = Optimality.of.__func__
    counted = classmethod(
        lambda cls, data, x, **how: points.append(x) or measure(cls, data, x, **how)
    )
    monkeypatch.setattr(Optimality, "of", counted)
    result = solve(problem, x0=[1.5, 0.0])
    assert (result.algorithm, result.iterations) == ("start", 0)
    assert [x.tolist() for x in points] == [[1.5, 0.0]]
