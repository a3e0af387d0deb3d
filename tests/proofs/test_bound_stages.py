"""The stages of an error bound, each alone: what it proves, and that it takes off no more than it must."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, Certificate
from lcp_plugin.core.certificates.row_residuals import ratio
from lcp_plugin.core.kernels.floats import UNIT
from lcp_plugin.core.rounding import gamma
from lcp_plugin.proofs.bounds import row_inequality, solution_bounds
from lcp_plugin.proofs.bounds.error_bounds import error_bound
from lcp_plugin.proofs.bounds.row_inequality import RowInequality
from lcp_plugin.proofs.bounds.solution_bounds import EigenvalueBound, smallest_eigenvalue_bound
from lcp_plugin.proofs.exact.upward import product_above, quotient_above, sum_above
from lcp_plugin.systems import factors, free_systems
from lcp_plugin.systems.equilibration import unit_diagonal
from lcp_plugin.systems.factors import positive_factor

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
    """‖x‖₂ in rational arithmetic is not above its bound, and that is no looser than 1 + 10⁻¹⁰, in any unit."""
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


@pytest.mark.parametrize("kind", ["dense", "sparse"])
def test_a_poor_estimate_costs_a_share_and_not_the_bound(kind, monkeypatch) -> None:
    """Where the estimate is above the eigenvalue, smaller shares of it are tried."""
    n = 250 if kind == "sparse" else 30
    least = 4.0 * np.sin(np.pi / (2 * (n + 1))) ** 2
    for factor, share in ((1.5, 0.5), (5.0, 0.1)):
        monkeypatch.setattr(
            solution_bounds, "_inverse_iteration", lambda *_, wrong=factor * least: wrong
        )
        bound = smallest_eigenvalue_bound(LCP(chain(n), np.zeros(n)).matrix)
        assert bound.value == pytest.approx(share * factor * least)


def test_what_a_sparse_factor_errs_is_taken_off(monkeypatch) -> None:
    """The proven eigenvalue is lower by the error of the factor."""
    M = chain(250, 4.0)
    before = smallest_eigenvalue_bound(LCP(M, np.zeros(250)).matrix).value
    monkeypatch.setattr(solution_bounds, "_factor_error", lambda _: 0.25)
    assert smallest_eigenvalue_bound(LCP(M, np.zeros(250)).matrix).value == pytest.approx(
        before - 0.25, rel=1e-9
    )


def test_dense_and_sparse_matrices_have_their_own_factor(monkeypatch) -> None:
    """LAPACK factorises dense matrices and small ones, SuperLU the others."""
    used = []
    monkeypatch.setattr(
        solution_bounds,
        "_proven_bound",
        lambda part, _: used.append("sparse" if sp.issparse(part) else "dense") or 1.0,
    )
    for M in (np.eye(300) + 1.0, chain(200), chain(201)):
        smallest_eigenvalue_bound(LCP(M, np.zeros(M.shape[0])).matrix)
    assert used == ["dense", "dense", "sparse"]


def test_a_nonpositive_diagonal_has_no_eigenvalue_bound() -> None:
    """Nor has a problem without rows."""
    assert smallest_eigenvalue_bound(LCP([[1.0, 0.0], [0.0, 0.0]], [0.0, 0.0]).matrix) is None
    assert smallest_eigenvalue_bound(LCP(np.zeros((0, 0)), []).matrix) is None
    assert isinstance(smallest_eigenvalue_bound(LCP(CIRCULANT, [0.0] * 3).matrix), EigenvalueBound)


# --- The stages for H₊-matrices -----------------------------------------------------------------------------


def test_steps_that_lead_astray_lead_home() -> None:
    """From points far away, where the first guess of the active set is poor, the bound ends at the error itself."""
    rng = np.random.default_rng(0)
    for _ in range(30):
        M = chain(40, 2.0).toarray() * np.exp(rng.standard_normal(40))[:, None] + 1e-3 * np.eye(40)
        exact = np.maximum(rng.standard_normal(40), 0.0)
        problem = LCP(M, np.where(exact > 0.0, 0.0, rng.random(40)) - M @ exact)
        z = 10.0 * np.abs(rng.standard_normal(40))
        bound = error_bound(problem, z)
        assert (bound.proven_active | bound.proven_inactive).all()
        assert (
            np.abs(z - exact).max() * (1.0 - 1e-9)
            <= bound.infinity
            <= 1.01 * np.abs(z - exact).max()
        )


@pytest.mark.parametrize(
    ("limits", "sign"), [((1000, 0), -1), ((1000, 64), -1), ((0, 0), -1), ((0, 0), 1)]
)
def test_every_solver_leads_to_the_solution(limits, sign, monkeypatch) -> None:
    """SuperLU, LAPACK's band and Krylov steps on the grids: some steps of the active-set method end near the solution.

    With couplings of the other sign the grids are of no use, and a factor takes over.
    """
    monkeypatch.setattr(free_systems, "DIRECT_UP_TO", limits[0])
    monkeypatch.setattr(free_systems, "BANDED_UP_TO", limits[1])
    monkeypatch.setattr(factors, "BANDED_UP_TO", limits[1])
    M = chain(600, 2.5) + (1.0 + sign) * sp.eye_array(600, k=1)
    exact = np.maximum(np.sin(np.arange(600)), 0.0)
    problem = LCP(M, np.where(exact > 0.0, 0.0, 1.0) - M @ exact)
    steps = row_inequality.ActiveSetSteps(problem, 1.0 / problem.residual_scale)
    with np.errstate(all="ignore"):
        point = RowInequality.at(problem, exact * (1.0 + 1e-3))
        for _ in range(5):
            point = steps.next_point(point)
    assert np.abs(point.high + point.low - exact).max() <= 1e-9


def test_a_singular_factor_ends_the_steps(monkeypatch) -> None:
    """Where LAPACK finds a zero pivot there is no next point."""
    monkeypatch.setattr(free_systems, "factorise", lambda *_, **__: None)
    problem = LCP(chain(4), -np.ones(4))
    with np.errstate(all="ignore"):
        at = RowInequality.at(problem, np.ones(4))
        assert row_inequality.ActiveSetSteps(problem, np.ones(4)).next_point(at) is None


def test_the_least_bound_names_its_method() -> None:
    """The stage that gave the bound is named, the v-certificate where nothing else was asked."""
    rng = np.random.default_rng(0)
    M = np.eye(20) + 0.04 * rng.standard_normal((20, 20))
    problem = LCP(M, rng.standard_normal(20))
    z = rng.standard_normal(20)
    plain, sharp = error_bound(problem, z, sharp=False), error_bound(problem, z)
    assert plain.method == "v-certificate"
    assert sharp.method == "reference point"
    assert sharp.infinity < plain.infinity
    assert "(reference point)" in str(sharp)
    assert "‖z − z*‖∞ ≤ " in str(sharp)
    assert "array" not in repr(sharp)


@pytest.mark.parametrize("sharp", [True, False])
def test_the_unit_of_z_changes_nothing(sharp) -> None:
    """With z and q in a unit of 2⁻²⁰ or 2²⁰ the bound is the same to the bit, and so is what it proves."""
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
    """Where a result a little above a power of two is rounded down to it, the next double is returned."""
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


# --- Residuals ----------------------------------------------------------------------------------------------


def test_a_certificate_is_of_an_lcp() -> None:
    """Anything else is refused by its name."""
    with pytest.raises(Exception, match=r"Certificate\.of needs an LCP, got list"):
        Certificate.of([[1.0]], [0.0])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("numerator", "denominator", "expected"),
    [
        (0.0, 0.0, 0.0),
        (0.0, 2.0, 0.0),
        (1.0, 2.0, 0.5),
        (3.0, 2.0, 1.5),
        (1.0, 0.0, np.inf),
        (np.nan, 0.0, np.nan),
        (np.nan, 1.0, np.nan),
        (1.0, np.inf, np.nan),
        (0.0, np.inf, np.nan),
        (np.inf, 1.0, np.inf),
    ],
)
def test_ratios_of_residuals(numerator: float, denominator: float, expected: float) -> None:
    """0/0 is 0, a positive residual over none is ∞, and nothing can be measured against ∞."""
    np.testing.assert_equal(ratio(numerator, denominator), expected)


def test_rounding_level_ends_at_four_floors() -> None:
    """A residual of three floors is explained by rounding, one of four and a half is not."""
    problem = LCP([[1.0]], [-1.0])
    floor = float(Certificate.of(problem, [1.0]).rounding_floor[0])
    for factor, expected in ((3.0, True), (4.5, False)):
        certificate = Certificate.of(problem, [1.0 + factor * floor])
        assert certificate.scaled_residual == pytest.approx(factor * floor, rel=0.1)
        assert certificate.is_at_rounding_level is expected
