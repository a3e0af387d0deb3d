"""Error bounds hold exactly, prove only what is true, and are sharp where the solution is near."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from drawn_scaling import nearly_semidefinite, nearly_singular, scaled_solved, scaled_symmetric
from exact import exact_solution, has_positive_pivots
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_plugin import LCP, UnsuitableMatrix, analyze, gallery
from lcp_plugin.core.kernels.floats import UNIT
from lcp_plugin.core.rounding import gamma
from lcp_plugin.proofs.bounds import solution_bounds
from lcp_plugin.proofs.bounds.error_bounds import ErrorBound, error_bound
from lcp_plugin.proofs.bounds.row_inequality import RowInequality
from lcp_plugin.proofs.bounds.solution_bounds import (
    HPlusBounds,
    bounds_of,
    smallest_eigenvalue_bound,
)
from lcp_plugin.proofs.exact.upward import product_above, quotient_above, sum_above
from lcp_plugin.proofs.verdicts import comparison_certificate
from lcp_plugin.strategies import h_plus_matrices, positive_definite_matrices, solved_lcps
from lcp_plugin.systems.equilibration import unit_diagonal
from lcp_plugin.systems.factors import positive_factor

POINTS = st.lists(st.floats(-1e6, 1e6, width=32), min_size=8, max_size=8)
STEPS = st.sampled_from([1.0, 1e-3, 1e-9, 2.0**-52, 0.0])


def near(exact: tuple[Fraction, ...], direction: list[float], step: float) -> np.ndarray:
    """Return the exact solution moved by a relative step."""
    z = np.array(exact, dtype=float)
    return z + step * np.array(direction[: z.size]) * np.maximum(
        np.abs(z).max(), np.finfo(float).tiny
    )


def check(problem: LCP, z: np.ndarray, exact: tuple[Fraction, ...], bound: ErrorBound) -> None:
    """Compare everything the bound states with the exact solution, in fractions."""
    w = [
        Fraction(float(q)) + sum(Fraction(float(a)) * b for a, b in zip(row, exact, strict=True))
        for row, q in zip(problem.csr.toarray(), problem.q, strict=True)
    ]
    errors = [abs(Fraction(float(value)) - truth) for value, truth in zip(z, exact, strict=True)]
    for i, error in enumerate(errors):
        limit = bound.componentwise[i]
        assert limit == np.inf or error <= Fraction(float(limit)), i
        ends = [float(end) for end in (problem.lower[i], problem.upper[i]) if np.isfinite(end)]
        assert not bound.proven_active[i] or exact[i] in ends, i
        assert not bound.proven_inactive[i] or (exact[i] not in ends and w[i] == 0), i
    assert bound.infinity == np.inf or max(errors) <= Fraction(bound.infinity)
    for other in (z, np.zeros_like(z), 1.0 - 3.0 * z):
        for value, truth, limit in zip(other, exact, bound.carried_to(other), strict=True):
            assert limit == np.inf or abs(Fraction(float(value)) - truth) <= Fraction(float(limit))
    if bound.relative < np.inf:
        assert max(errors) <= Fraction(bound.relative) * Fraction(float(np.abs(z).max()))


@settings.get_profile("many")
@given(
    scaled_solved(solved_lcps(h_plus_matrices(), bounds=True), 60, 60), POINTS, STEPS, st.booleans()
)
def test_bound_holds_for_h_plus(drawn, direction, step, sharp) -> None:
    """The bound exceeds the exact error, and rows are classified correctly, for H₊-matrices."""
    problem, exact = drawn
    z = near(exact, direction, step)
    bound = error_bound(problem, z, sharp=sharp)
    check(problem, z, exact, bound)


def near_singular_problem(seed: int) -> LCP:
    """Return a problem of decimals whose ⟨M⟩, or whose symmetric part, is singular except for some ulps."""
    rng = np.random.default_rng(seed)
    n, ulps = int(rng.integers(2, 6)), int(rng.integers(1, 5))
    if seed % 2:  # ⟨M⟩ v = 0 to rounding, any signs next to the diagonal
        M, v = rng.integers(-9, 10, (n, n)) / 10, rng.integers(1, 10, n) / 10
        np.fill_diagonal(M, 0.0)
        diagonal = np.abs(M) @ v / v
    else:  # a Gram matrix of rank n − 1, and a skew part
        factor, skew = (
            rng.integers(-9, 10, (n, n - 1)) / 10,
            np.triu(rng.integers(-9, 10, (n, n)) / 10, 1),
        )
        M = factor @ factor.T + (skew - skew.T) * (seed % 4 == 2)
        diagonal = M.diagonal().copy()
    diagonal = np.maximum(diagonal, 0.1)
    for _ in range(ulps):
        diagonal = np.nextafter(diagonal, np.inf)
    np.fill_diagonal(M, diagonal)
    upper = np.where(rng.random(n) < 0.3, rng.integers(1, 5, n), np.inf)
    return LCP(M, rng.integers(-20, 21, n) / 10, upper=upper)


@pytest.mark.full
@pytest.mark.parametrize("block", range(10))
def test_what_is_proved_of_a_near_singular_matrix_bounds_errors(block: int) -> None:
    """Each M proved H₊ has a valid bound; definite M that only rationals prove raise an error."""
    proved = 0
    for seed in range(60 * block, 60 * block + 60):
        problem = near_singular_problem(seed)
        report = analyze(problem)
        if not (report.is_h_plus or report.is_positive_definite):
            continue
        exact = exact_solution(problem).z
        for step in (0.0, 1e-9, 1.0):
            z = near(exact, np.random.default_rng(seed).standard_normal(5).tolist(), step)
            try:
                bound = error_bound(problem, z, sharp=bool(seed % 3))
            except UnsuitableMatrix:
                dense = problem.csr.toarray()
                assert not report.is_h_plus
                assert np.linalg.cond(dense + dense.T) > 1e14
                break
            check(problem, z, exact, bound)
            proved += step == 1.0
    assert proved > 20


@settings.get_profile("many")
@given(solved_lcps(positive_definite_matrices(), bounds=True), POINTS, STEPS, st.booleans())
def test_bound_holds_for_definite(drawn, direction, step, sharp) -> None:
    """The same where M is symmetric positive definite and usually no H₊-matrix."""
    problem, exact = drawn
    z = near(exact, direction, step)
    try:
        bound = error_bound(problem, z, sharp=sharp)
    except UnsuitableMatrix:
        # Doubles cannot tell M from a singular matrix.
        assert np.linalg.cond(problem.csr.toarray()) > 1e10
        return
    check(problem, z, exact, bound)


@settings.get_profile("many")
@given(solved_lcps(nearly_singular(), bounds=True), POINTS, STEPS)
def test_each_stage_holds_alone(drawn, direction, step) -> None:
    """The v-certificate and Φ of it bound the error each for itself, nearly singular M too."""
    problem, exact = drawn
    family = bounds_of(problem.matrix)
    assert isinstance(family, HPlusBounds)
    z = near(exact, direction, step)
    y = error_bound(problem, z, sharp=False).componentwise
    with np.errstate(all="ignore"):
        at = RowInequality.at(problem, z)
        stages = [y, at.image(y)]
    for stage in stages:
        for value, truth, limit in zip(z, exact, stage, strict=True):
            assert abs(Fraction(float(value)) - truth) <= Fraction(float(limit))


@pytest.mark.parametrize("radius", [0.5, 0.99, 0.999])
def test_reference_point_removes_overestimation(radius) -> None:
    """Bound/error ≤ 1.01 for random signs, also where ⟨M⟩⁻¹|r| exceeds |M⁻¹r| many times."""
    generator = np.random.default_rng(1)
    B = generator.standard_normal((40, 40))
    np.fill_diagonal(B, 0.0)
    M = np.eye(40) + radius / max(abs(np.linalg.eigvals(abs(B)))) * B
    problem = LCP(M, generator.standard_normal(40))
    z = np.array(exact_solution(LCP(problem.M, problem.q)).z, dtype=float)
    error = 1e-6 * generator.standard_normal(40)
    bound = error_bound(problem, z + error)
    assert np.abs(error).max() * (1 - 1e-6) <= bound.infinity <= 1.01 * np.abs(error).max()
    assert (bound.proven_active | bound.proven_inactive).all()
    if radius == 0.999:
        assert error_bound(problem, z + error, sharp=False).infinity > 50 * np.abs(error).max()


@settings.get_profile("many")
@given(h_plus_matrices().map(sp.csr_array), st.integers(-40, 40))
def test_v_certificate_is_attained(M, exponent) -> None:
    """For an M-matrix without bounds and z = z* + t v the v-certificate is the error itself."""
    M = sp.csr_array(2.0 * sp.diags_array(M.diagonal()) - abs(M))
    certificate = comparison_certificate(LCP(M, np.zeros(M.shape[0])).matrix)
    assert certificate is not None
    problem = LCP(M, np.zeros(M.shape[0]), lower=-np.inf)
    z = np.ldexp(certificate.v, exponent)
    y = error_bound(problem, z, sharp=False).componentwise
    assert (z <= y).all()
    assert (y <= z * (1.0 + 1e-10)).all()


def test_bound_of_the_exact_solution_is_zero() -> None:
    """If z = z* and w* has no rounding error, the bounds are 0 and every row is proved."""
    scene = gallery.half_active(n=400, degenerate=False)
    for sharp in (True, False):
        bound = error_bound(scene.problem, scene.exact, sharp=sharp)
        assert bound.infinity == bound.relative == 0.0
        assert (bound.proven_active | bound.proven_inactive).all()
        assert (bound.proven_active == (scene.exact == 0.0)).all()


def test_large_five_point_matrix() -> None:
    """A bound with n = 90 000 and no zeroth-order term has bound/error ≤ 1.6, all rows proved."""
    scene = gallery.half_active(n=90_000, delta=0.0, degenerate=False)
    z = scene.exact + 1e-7 * np.sin(np.arange(90_000))
    bound = error_bound(scene.problem, z)
    error = np.abs(z - scene.exact).max()
    assert error <= bound.infinity <= 1.6 * error
    assert (np.abs(z - scene.exact) <= bound.componentwise).all()
    assert (bound.proven_active | bound.proven_inactive).all()


@pytest.mark.full
def test_large_matrix_with_both_signs() -> None:
    """The bound of a large H₊-matrix with both signs is tightened by a Krylov method."""
    generator = np.random.default_rng(0)
    n = 60_000
    rows = np.repeat(np.arange(n), 4)
    B = sp.csr_array(
        (generator.standard_normal(4 * n), (rows, generator.integers(0, n, 4 * n))), shape=(n, n)
    )
    M = sp.csr_array(B + sp.diags_array(1.2 * np.asarray(abs(B).sum(axis=1))))
    exact = np.where(generator.random(n) < 0.5, generator.random(n), 0.0)
    problem = LCP(M, np.where(exact > 0.0, 0.0, 1.0) - M @ exact)
    z = exact + 1e-6 * generator.standard_normal(n)
    bound = error_bound(problem, z)
    error = np.abs(z - exact).max()
    assert 0.999 * error <= bound.infinity <= 1.6 * error


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("M", [[[2, 1], [1, 2]], [[1, 0.9], [0.9, 1]]])
def test_no_bound_of_no_number(value, M) -> None:
    """NaN or infinite entries of z give the bound ∞ and prove nothing."""
    bound = error_bound(LCP(M, [-5, 1]), [value, 0.0])
    assert bound.infinity == bound.relative == np.inf
    assert not (bound.proven_active | bound.proven_inactive).any()


def test_relative_bound_at_zero() -> None:
    """The relative bound at z = 0 is 0 if z* = 0 is proved, and otherwise ∞."""
    M = [[2.0, 1.0], [1.0, 2.0]]
    assert error_bound(LCP(M, [1, 1]), [0, 0]).relative == 0.0
    assert error_bound(LCP(M, [-1, 1]), [0, 0]).relative == np.inf


def test_points_outside_the_bounds() -> None:
    """A z far outside a box is bounded by its distance to the solution."""
    problem = LCP([[2, -1], [-1, 2]], [-9, 9], lower=-1, upper=1)
    bound = error_bound(problem, [1e6, -1e6])
    assert 1e6 - 1 <= bound.infinity <= 1e6 + 2
    assert bound.proven_active.all()


def test_free_and_fixed_rows_are_known() -> None:
    """A free row is inactive and a fixed row active for any z."""
    problem = LCP(np.eye(2) * 3, [-1, 1], lower=[-np.inf, 2], upper=[np.inf, 2])
    bound = error_bound(problem, [1e3, 1e3], sharp=False)
    assert bound.proven_inactive.tolist() == [True, False]
    assert bound.proven_active.tolist() == [False, True]


def test_empty_problem() -> None:
    """A problem without unknowns has error 0."""
    bound = error_bound(LCP(np.zeros((0, 0)), np.zeros(0)), np.zeros(0))
    assert bound.infinity == bound.relative == 0.0
    assert (bound.proven_active | bound.proven_inactive).all()


REFUSED = [
    ([[1, 2], [2, 1]], "M was not proven to have either"),
    ([[0, 1], [-1, 1]], "M was not proven to have either"),
    ([[1, 0], [5, -2]], "M was not proven to have either"),
]


@pytest.mark.parametrize(("M", "words"), REFUSED)
def test_unsuitable_matrices_are_refused_in_words(M, words) -> None:
    """Neither H₊ nor positive definite: the message names what was found and what is needed."""
    with pytest.raises(UnsuitableMatrix, match=words) as caught:
        error_bound(LCP(M, [1, 1]), [0, 0])
    assert "H₊-matrix" in str(caught.value)


@settings.get_profile("many")
@given(scaled_symmetric(nearly_semidefinite(2.0**-20), 30), st.booleans())
def test_eigenvalue_bound_is_below_every_eigenvalue(M, by_sparse_factor) -> None:
    """C M C − λ I is positive definite or at least semidefinite, in exact arithmetic, by either factorization."""
    problem = LCP(M, np.zeros(M.shape[0]))
    if by_sparse_factor:
        exponents = unit_diagonal(problem.diagonal)
        part, blur = solution_bounds._symmetric_part(problem.csr, exponents)
        value, scale = solution_bounds._proven_bound(part, blur), np.exp2(exponents.row)
    else:
        bound = smallest_eigenvalue_bound(problem.matrix)
        value, scale = (None, None) if bound is None else (bound.value, bound.scale)
    if value is None:
        return
    exact = [
        [
            Fraction(float(m)) * Fraction(float(a)) * Fraction(float(b))
            for m, b in zip(row, scale, strict=True)
        ]
        for row, a in zip(M, scale, strict=True)
    ]
    for i in range(len(exact)):
        exact[i][i] -= Fraction(value) * Fraction(999_999, 1_000_000)
    assert has_positive_pivots(exact)


def test_two_norm_bound_is_its_formula() -> None:
    """The 2-norm bound is C ‖C (Mᵀ + S⁻¹) r‖₂ / λ as numpy computes it, a little above and never below."""
    generator = np.random.default_rng(2)
    factor = generator.standard_normal((6, 6))
    skew = generator.standard_normal((6, 6))
    unit = np.exp2(generator.integers(-9, 9, 6))
    M = unit[:, None] * (factor @ factor.T + np.eye(6) + skew - skew.T) * unit
    lower, upper = (
        np.array([0, -1, -np.inf, 0, -1, -np.inf]) / unit,
        np.array([np.inf, 1, np.inf, 2, 1, 1]) / unit,
    )
    problem = LCP(M, generator.standard_normal(6) * unit, lower=lower, upper=upper)
    z = generator.standard_normal(6) / unit
    step = np.exp2(-np.round(np.log2(np.diag(M))))
    r = z - np.clip(z - step * (M @ z + problem.q), lower, upper)
    eigenvalue = smallest_eigenvalue_bound(problem.matrix)
    c = eigenvalue.scale
    formula = c * np.linalg.norm(c * (M.T @ r + r / step)) / eigenvalue.value
    with np.errstate(all="ignore"):
        y = solution_bounds.two_norm_bound(problem, RowInequality.at(problem, z), eigenvalue)
    assert (y >= formula * (1.0 - 1e-13)).all()
    assert (y <= formula * solution_bounds.OUTWARD**3).all()


@pytest.mark.parametrize("kind", ["dense", "sparse"])
def test_eigenvalue_bound_is_near(kind) -> None:
    """The proven bound is at least 0.9 of LAPACK's eigenvalue; a singular matrix gets none."""
    generator = np.random.default_rng(0)
    if kind == "dense":
        factor = generator.standard_normal((80, 80))
        M = factor @ factor.T + 0.1 * np.eye(80)
        singular = factor[:, :40] @ factor[:, :40].T
    else:
        line = sp.diags_array(
            [1.0, -4.0, 6.0, -4.0, 1.0], offsets=[-2, -1, 0, 1, 2], shape=(400, 400)
        )
        M = sp.csr_array(line + 0.01 * sp.eye_array(400))
        singular = sp.csr_array(line - 1e-3 * sp.eye_array(400))
    bound = smallest_eigenvalue_bound(LCP(M, np.zeros(M.shape[0])).matrix)
    scaled = bound.scale[:, None] * (M if kind == "dense" else M.toarray()) * bound.scale
    smallest = np.linalg.eigvalsh(scaled)[0]
    assert 0.9 * smallest < bound.value <= smallest
    assert smallest_eigenvalue_bound(LCP(singular, np.zeros(M.shape[0])).matrix) is None


EXTREMES = [0.0, 5e-324, 2.0**-1022, 1.0, 1.0 + 2.0**-52, np.pi, 1.7e308, 1.7976931348623157e308]
DOUBLES = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(
    EXTREMES + [-x for x in EXTREMES]
)


@settings.get_profile("many")
@given(DOUBLES, DOUBLES)
def test_rounding_is_upwards(a, b) -> None:
    """Sums, products and quotients are never below the exact ones, nor more than two units above."""
    exact = [Fraction(a) + Fraction(b), Fraction(a) * Fraction(b)]
    with np.errstate(all="ignore"):
        results = [sum_above(a, b), product_above(a, b)]
        if b > 0.0:
            exact.append(Fraction(a) / Fraction(b))
            results.append(quotient_above(a, b))
    for truth, result in zip(exact, results, strict=True):
        assert result == np.inf or Fraction(float(result)) >= truth
        if abs(truth) < Fraction(1e308):
            assert Fraction(float(result)) <= truth + abs(truth) * Fraction(3, 2**52) + Fraction(
                3, 2**1074
            )
    if abs(exact[0]) < Fraction(1e308) and float(exact[0]) == exact[0]:
        assert results[0] == exact[0]


def test_numbers_near_the_end_of_the_range_are_refused_without_a_warning() -> None:
    """A matrix whose quotients overflow raises an error with the reason, without a warning."""
    with pytest.raises(UnsuitableMatrix, match="needs an H₊-matrix"):
        error_bound(LCP([[1e-300, 1e300], [1e300, 1e-300]], [1.0, 1.0]), [0.0, 0.0])


# --- The stages of an error bound, each alone ---

CIRCULANT = [[4.0, 3.0, 3.0], [3.0, 4.0, 3.0], [3.0, 3.0, 4.0]]  # definite, λ_min = 1, no H-matrix


def chain(n: int, diagonal: float = 2.0) -> sp.csr_array:
    return sp.csr_array(sp.diags_array([-1.0, diagonal, -1.0], offsets=[-1, 0, 1], shape=(n, n)))


def with_least_eigenvalue(n: int, least: float) -> np.ndarray:
    """A symmetric matrix with one small eigenvalue, the others 1."""
    Q = np.linalg.qr(np.random.default_rng(0).standard_normal((n, n)))[0]
    M = np.eye(n) - (1.0 - least) * np.outer(Q[0], Q[0])
    return 0.5 * (M + M.T)


# --- The 2-norm bound ---------------------------------------------------------------------------------------


def test_a_residual_without_blur_counts() -> None:
    """A z a little above the bound that w keeps it at: r is exact, nothing is blurred, and the bound is not zero."""
    problem = LCP(CIRCULANT, [100.0, 100.0, 100.0])
    bound = error_bound(problem, np.full(3, 0.5), sharp=False)
    assert (bound.componentwise >= 0.5).all()
    assert bound.method == "2-norm, λ_min"


@pytest.mark.parametrize("power", [-600, 0, 600])
def test_norms_are_not_below_the_exact_ones(power) -> None:
    """The bound of ‖x‖₂ is at least its exact value, and at most 1 + 10⁻¹⁰ times, at any scale."""
    rng = np.random.default_rng(0)
    for n in (1, 2, 3, 50):
        x = np.ldexp(np.abs(rng.standard_normal(n)), power)
        exact = sum(Fraction(float(entry)) ** 2 for entry in x)
        bound = Fraction(float(solution_bounds.norm_above(x)))
        assert exact <= bound**2 <= exact * (1 + Fraction(2, 10**10))
    assert solution_bounds.norm_above(np.zeros(3)) == 0.0
    assert solution_bounds.norm_above(np.array([1.0, np.inf])) == np.inf
    assert gamma(2 * solution_bounds.SPARSE_UP_TO) + 1.0 < solution_bounds.OUTWARD


def test_the_margin_of_a_dense_factor_is_what_the_theorem_asks_for() -> None:
    """An eigenvalue 1.5 times the margin (n + 3) u · trace of the theorem is proven positive, one of half of it not."""
    n = 50
    margin = (n + 3) * UNIT * n
    for times, is_proven in ((1.6, True), (0.5, False)):
        M = with_least_eigenvalue(n, times * margin)
        part = solution_bounds._symmetric_part(M, unit_diagonal(M.diagonal()))
        assert (solution_bounds._proven_bound(*part) is not None) == is_proven


def test_the_error_of_a_sparse_factor_is_enclosed() -> None:
    """‖A − L D Lᵀ‖∞ in rational arithmetic is not above the bound, which is (k + 2) u ‖|L||U|‖∞ and little more."""
    A = chain(40, 2.5) * (100.0 / 3.0)
    factor = positive_factor(A.tocsc()).superlu
    bound = solution_bounds._factor_error(factor)
    order = np.argsort(factor.perm_c)
    L = [[Fraction(float(entry)) for entry in row] for row in factor.L.toarray()]
    D = [Fraction(float(entry)) for entry in factor.U.diagonal()]
    for i, row in enumerate(A.toarray()[order][:, order]):
        product = [
            sum((L[i][k] * D[k] * L[j][k] for k in range(40) if L[i][k] and L[j][k]), Fraction(0))
            for j in range(40)
        ]
        assert sum(
            abs(Fraction(float(a)) - b) for a, b in zip(row, product, strict=True)
        ) <= Fraction(bound)
    longest = max(np.diff(factor.L.tocsr().indptr).max(), np.diff(factor.U.tocsc().indptr).max())
    size = (abs(factor.L) @ abs(factor.U)).sum(axis=1).max()
    assert (longest + 2) * UNIT * size <= bound <= (longest + 2 + 5) * UNIT * size


# --- The stages for H₊-matrices -----------------------------------------------------------------------------


@pytest.mark.parametrize("sharp", [True, False])
def test_the_unit_of_z_changes_nothing(sharp) -> None:
    """The bound, and the rows that it proves, scale exactly with z and q by 2⁻²⁰ or 2²⁰."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        B = rng.standard_normal((12, 12)) * (rng.random((12, 12)) < 0.5)
        np.fill_diagonal(B, 0.0)
        M = B + np.diag(1.02 * np.abs(B).sum(axis=1) + 0.01)
        q, z = rng.standard_normal(12), np.maximum(rng.standard_normal(12), 0.0)
        plain = error_bound(LCP(M, q), z, sharp=sharp)
        for exponent in (-20, 20):
            problem = LCP(M, np.ldexp(q, exponent))
            bound = error_bound(problem, np.ldexp(z, exponent), sharp=sharp)
            np.testing.assert_array_equal(
                bound.componentwise, np.ldexp(plain.componentwise, exponent)
            )
            np.testing.assert_array_equal(bound.proven_active, plain.proven_active)
            assert bound.relative == plain.relative


@pytest.mark.parametrize("power", [0, -30, 30, -1000, 1000])
def test_rounding_at_powers_of_two_is_upwards(power) -> None:
    """If a result above a power of two is rounded down to it, the next double is returned."""
    one, unit = 2.0**power, 2.0**-52
    assert sum_above(one, one * unit / 2.0) > one
    assert product_above(one * (1.0 + unit), 1.0 - unit / 2.0) > one
    assert quotient_above(one * (1.0 + unit), 1.0 + unit) >= one
    assert quotient_above(one, 1.0 - unit / 2.0) >= one * (1.0 + unit)
    assert sum_above(one, one) == 2.0 * one


def test_small_diagonals_are_h_plus_too() -> None:
    """The unit of the rows does not decide which bound there is."""
    for unit in (2.0**-30, 1.0, 2.0**30):
        bound = error_bound(
            LCP(unit * chain(4).toarray(), -unit * np.ones(4)), np.ones(4), sharp=False
        )
        assert bound.method == "v-certificate"
