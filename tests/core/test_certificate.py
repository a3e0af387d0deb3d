"""The certificate: every number in it against exact rational arithmetic, and no status without it."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from inputs.drawn_scaling import moved, nearly_singular, scaled_matrices, scaled_solved
from oracles.exact_criterion import references
from oracles.truth import ExactData

from lcp_plugin import LCP, Certificate, Status, UnsuitableMatrix, UnsuitableProblem, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.judges.lcp import reference_residual, row_data, scaled_residual
from lcp_plugin.strategies import solved_lcps

EPSILON = Fraction(1, 2**52)
FAR = st.sampled_from([math.inf, -math.inf, math.nan])


# --- The oracle: the definitions of MATHS in rational arithmetic -------------------------------------------


class Exact:
    """The certificate's numbers of (problem, z) without rounding."""

    def __init__(self, problem: LCP, z: object) -> None:
        data = ExactData(problem)
        self.z = [Fraction(value) for value in np.asarray(z, dtype=float).tolist()]
        self.w, self.d = data.slack(self.z), data.divisor
        self.scaled = data.steps(self.z, data.divisor)
        self.natural = data.steps(self.z, [Fraction(1)] * problem.n)
        self.magnitude, self.floor = data.terms(self.z), data.floor(self.z, Fraction(0))
        self.at_zero = data.at_zero()
        self.reference = max(self.at_zero)
        pairs = zip(map(abs, data.residual(self.z)), references(problem, self.z), strict=True)
        self.relative = max((r / s if s else math.inf) if r else Fraction(0) for r, s in pairs)


# --- Problems to measure -----------------------------------------------------------------------------------


@st.composite
def rough_problems(draw: st.DrawFn, *, empty_rows: bool = True) -> tuple[LCP, np.ndarray]:
    """Any small integers: zero or negative diagonals, empty rows, boxes, free rows, z on both sides of the bounds."""
    n = draw(st.integers(1, 5))
    M = draw(st.lists(st.integers(-9, 9) | st.just(0), min_size=n * n, max_size=n * n))
    rows = st.tuples(
        st.integers(-40, 40),
        st.integers(-80, 80),
        st.integers(0, 9) | st.just(math.inf),
        st.integers(0, 9) | st.just(math.inf),
        st.integers(-9, 9),
    )
    q, z, below, above, centre = np.array(
        draw(st.lists(rows, min_size=n, max_size=n)), dtype=float
    ).T
    matrix = np.array(M, dtype=float).reshape(n, n)
    if not empty_rows:
        matrix[~matrix.any(axis=1), 0] = 1.0
    problem = LCP(
        matrix if draw(st.booleans()) else sp.csr_array(matrix),
        q / 4,
        lower=centre - below,
        upper=centre + above,
    )
    return problem, z / 8


@st.composite
def floating_problems(draw: st.DrawFn) -> tuple[LCP, np.ndarray]:
    """H₊-matrices with wild rows, and q and z of any size, none of them dyadic."""
    M = draw(scaled_matrices(nearly_singular(), 60, 10)) / 3.0
    numbers = st.floats(-1e9, 1e9).map(lambda x: x if abs(x) > 1e-9 else 0.0)
    q, z, first, second = np.array(
        draw(st.lists(numbers, min_size=4 * len(M), max_size=4 * len(M)))
    ).reshape(4, -1)
    is_bounded = draw(st.booleans())
    lower = np.minimum(first, second) if is_bounded else 0.0
    upper = np.maximum(first, second) if is_bounded else np.inf
    return LCP(M, q * M.diagonal(), lower=lower, upper=upper), z


# --- Every field -------------------------------------------------------------------------------------------


@given(rough_problems())
def test_fields_without_division_are_exact(drawn):
    """On short dyadic data w, natural residual, violations and complementarity are the rational values."""
    problem, z = drawn
    certificate, exact = Certificate.of(problem, z), Exact(problem, z)
    assert certificate.w.tolist() == exact.w
    assert certificate.natural_residual == pytest.approx(
        float(max(map(abs, exact.natural))), rel=1e-13, abs=1e-13 * float(max(exact.magnitude))
    )
    squares = float(sum(r * r for r in exact.natural))
    assert certificate.euclidean_residual == pytest.approx(
        math.sqrt(squares), rel=1e-13, abs=1e-12 * float(max(exact.magnitude))
    )

    outside, products = [0], [0]
    bounds = zip(problem.lower.tolist(), problem.upper.tolist(), strict=True)
    for z_i, w_i, (lower, upper) in zip(exact.z, exact.w, bounds, strict=True):
        outside += [lower - z_i, z_i - upper]
        products += [(z_i - Fraction(lower)) * max(w_i, 0)] if math.isfinite(lower) else []
        products += [(Fraction(upper) - z_i) * max(-w_i, 0)] if math.isfinite(upper) else []
    assert certificate.bound_violation == max(outside)
    assert certificate.complementarity == max(products)


@given(rough_problems())
def test_scaled_fields_are_the_rational_ones(drawn):
    """Scaled residual, worst row, reference and floor agree with the rational values."""
    problem, z = drawn
    certificate, exact = Certificate.of(problem, z), Exact(problem, z)
    assert problem.residual_scale.tolist() == exact.d
    residual = [abs(r) for r in exact.scaled]
    slip = 4 * float(
        EPSILON
        * max(abs(x) + abs(w / d) for x, w, d in zip(exact.z, exact.w, exact.d, strict=True))
    )
    of_rows = references(problem, z)
    worst = certificate.worst_index
    assert certificate.scaled_residual == pytest.approx(float(residual[worst]), rel=1e-15, abs=slip)
    if of_rows[worst]:
        largest = (residual[worst] + Fraction(slip)) / of_rows[worst]
        assert all(
            r <= largest * of + Fraction(slip)
            for r, of in zip(residual, of_rows, strict=True)
            if of
        )
    assert certificate.rounding_floor == pytest.approx(
        [float(value) for value in exact.floor], rel=1e-15
    )

    assert reference_residual(problem) == pytest.approx(float(exact.reference), rel=1e-14)
    if exact.relative == math.inf:
        assert certificate.relative_residual == math.inf


# --- Invariance --------------------------------------------------------------------------------------------


@given(
    rough_problems(empty_rows=False) | floating_problems(),
    st.lists(st.integers(-200, 200), min_size=8, max_size=8),
    st.integers(-200, 30),  # beyond, a bound is none
)
def test_relative_residual_has_no_unit(drawn, rows, unit):
    """Rows in units of powers of two and another unit of z have the same relative residual."""
    problem, z = drawn
    other = moved(problem, np.array(rows[: problem.n]), np.full(problem.n, -unit))
    before, after = Certificate.of(problem, z), Certificate.of(other, np.ldexp(z, unit))
    assert after.relative_residual == pytest.approx(before.relative_residual, rel=1e-9, abs=1e-12)


# --- Numbers that are none ---------------------------------------------------------------------------------


@given(rough_problems(), st.integers(0, 4), FAR)
def test_nan_and_infinity_never_pass(drawn, index, value):
    """A z with NaN or ±∞ anywhere is measured without a warning and passes no test."""
    problem, z = drawn
    z[index % problem.n] = value
    certificate = Certificate.of(problem, z)
    assert not math.isfinite(certificate.scaled_residual)
    assert not math.isfinite(certificate.relative_residual)
    assert not math.isfinite(certificate.natural_residual)
    assert not math.isfinite(certificate.euclidean_residual)
    assert not certificate.is_at_rounding_level
    assert str(certificate)


def test_an_overflowing_slack_is_no_rounding_level():
    """Where |M||z| overflows the floor is infinite and explains nothing."""
    certificate = Certificate.of(LCP([[1e10]], [-1.0]), [1e300])
    assert certificate.scaled_residual > 0.0
    assert not certificate.is_at_rounding_level


# --- The rounding floor ------------------------------------------------------------------------------------


@settings.get_profile("many")
@given(floating_problems())
def test_rounding_floor_bounds_the_rounding(drawn):
    """For z within the bounds no row's floating-point residual is further from the exact one than its floor."""
    problem, z = drawn
    z = np.clip(z, problem.lower, problem.upper)
    certificate, exact = Certificate.of(problem, z), Exact(problem, z)
    floor = [Fraction(value) for value in certificate.rounding_floor.tolist()]
    worst = certificate.worst_index
    assert abs(Fraction(certificate.scaled_residual) - abs(exact.scaled[worst])) <= max(floor)
    scale = np.array([float(d) for d in exact.d])
    measured = map(abs, map(Fraction, scaled_residual(problem, z, certificate.w, scale).tolist()))
    for value, truth, allowed in zip(measured, exact.scaled, floor, strict=True):
        assert abs(value - abs(truth)) <= allowed


@given(st.integers(0, 2**32 - 1))
def test_zeros_that_are_stored_change_no_measure(seed):
    """A matrix with zeros has the same residuals and rounding bounds as an array and as a sparse array."""
    rng = np.random.default_rng(seed)
    M, (q, z) = rng.integers(-1, 2, (5, 5)) + 3 * np.eye(5), rng.integers(0, 4, (2, 5))
    full, thin = (Certificate.of(LCP(one, q), z / 2.0) for one in (M, sp.csr_array(M)))
    for one, other in zip(full.by_row, thin.by_row, strict=True):
        assert np.array_equal(one, other)
    assert (full.rounding_floor == thin.rounding_floor).all()


# --- No lies -----------------------------------------------------------------------------------------------


@pytest.mark.quick(3)
@pytest.mark.parametrize("name", ["auto", *REGISTRY])
def test_solved_is_never_a_lie(name):
    """SOLVED means: the exact rational residual is at most the tolerance, no allowance."""
    solved = solved_lcps(bounds=True)

    @settings.get_profile("few")
    @given(scaled_solved(solved, 60, 10) | solved, st.sampled_from([1e-3, 1e-8, 1e-12]))
    def check(drawn, tolerance):
        try:
            result = solve(drawn[0], name, tolerance=tolerance, max_iterations=300)
        except UnsuitableProblem:
            return
        if result.is_solved:
            assert Exact(drawn[0], result.z).relative <= Fraction(tolerance)

    check()


@given(rough_problems() | floating_problems())
def test_residuals_are_proved_upwards(drawn):
    """The relative, natural and euclidean residuals are no smaller than the exact ones."""
    problem, z = drawn
    certificate, exact = Certificate.of(problem, z), Exact(problem, z)
    least, most = (float(end.max()) for end in row_data(problem).references)
    assert least <= exact.reference <= most <= least * (1 + 1e-13)
    natural, squares = max(map(abs, exact.natural)), sum(r * r for r in exact.natural)
    assert natural <= Fraction(certificate.natural_residual)
    assert squares <= Fraction(certificate.euclidean_residual) ** 2
    if certificate.relative_residual < math.inf:
        assert exact.relative <= Fraction(certificate.relative_residual)


NEAR_SINGULAR = LCP([[5, -5 + 2**-38], [-5 + 2**-39, 5]], [-1, -2])
ONE_ULP = LCP(
    [[1, 3, -1], [0, 1, 0], [0, 0, 1]],
    [0] * 3,
    lower=[0, 3.6028797018963976e16, 1.0808639105689194e17],
    upper=[np.inf, 3.6028797018963976e16, 1.0808639105689194e17],
)


@pytest.mark.parametrize("name", ["auto", *REGISTRY])
def test_solved_is_proved_where_doubles_measure_nothing(name):
    """No method calls a point SOLVED whose residual is lost in rounding, unless it is small exactly."""
    problem = NEAR_SINGULAR
    try:
        result = solve(problem, name, max_iterations=1000)
    except (UnsuitableProblem, UnsuitableMatrix):
        return
    exact = Exact(problem, result.z)
    is_within = exact.relative <= Fraction(1e-8)
    assert result.status is not Status.SOLVED or is_within
    if name == "newton":
        assert result.status is Status.PRECISION_LIMIT


def test_a_demand_of_one_ulp_next_to_the_data_is_noise():
    """The slack 3 a − b = −8 is half an ulp of b: z° solves the problem, and so does the z with z₀ = 8."""
    assert reference_residual(ONE_ULP) == 0.0
    assert solve(ONE_ULP).is_solved
    for first in (0.0, 8.0):
        assert Certificate.of(ONE_ULP, [first, *ONE_ULP.lower[1:]]).relative_residual <= 1e-14


@pytest.mark.parametrize("algorithm", ["auto", "lemke"])
def test_a_result_does_not_follow_a_sparse_matrix_that_the_caller_overwrites(algorithm):
    """Slack and residual belong to the M of the solve."""
    M = sp.csr_array(np.array([[2.0, 1.0], [1.0, 2.0]]))
    result = solve(LCP(M, [-5.0, 1.0]), algorithm)
    M.data[:] = 9.0
    assert result.w == pytest.approx([0.0, 3.5], abs=1e-12)
    assert result.residual <= 1e-14
