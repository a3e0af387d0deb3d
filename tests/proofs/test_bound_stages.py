"""The stages of an error bound, each alone: what it proves, and that it takes off no more than it must."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP
from lcp_plugin.core.kernels.floats import UNIT
from lcp_plugin.core.rounding import gamma
from lcp_plugin.proofs.bounds import solution_bounds
from lcp_plugin.proofs.bounds.error_bounds import error_bound
from lcp_plugin.proofs.exact.upward import product_above, quotient_above, sum_above
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


# --- The stages for H₊-matrices -----------------------------------------------------------------------------


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
