"""Error bounds hold exactly, prove only what is true, and are sharp where the solution is near."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from inputs.drawn_scaling import nearly_singular, scaled_solved
from oracles.exact import Exact, bound_violations, exact_solution
from oracles.truth import ExactData

from lcp_plugin import LCP, UnsuitableMatrix, error_bound, gallery
from lcp_plugin.proofs.bounds import ErrorBound
from lcp_plugin.proofs.verdicts import comparison_certificate
from lcp_plugin.strategies import h_plus_matrices, positive_definite_matrices, solved_lcps

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
    slack = tuple(ExactData(problem).slack(exact))
    assert bound_violations(z, Exact(exact, slack), bound) == 0


@settings.get_profile("many")
@given(
    scaled_solved(solved_lcps(h_plus_matrices(), bounds=True), 60, 60)
    | solved_lcps(nearly_singular(), bounds=True),
    POINTS,
    STEPS,
    st.booleans(),
)
def test_bound_holds_for_h_plus(drawn, direction, step, sharp):
    """“A rigorous bound holds for the exact solution”: near and far, and rows are classified correctly, for H₊."""
    problem, exact = drawn
    z = near(exact, direction, step)
    bound = error_bound(problem, z, sharp=sharp)
    check(problem, z, exact, bound)


@settings.get_profile("many")
@given(solved_lcps(positive_definite_matrices(), bounds=True), POINTS, STEPS, st.booleans())
def test_bound_holds_for_definite(drawn, direction, step, sharp):
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


@pytest.mark.parametrize("radius", [0.5, 0.99, 0.999])
def test_reference_point_removes_overestimation(radius):
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
    if radius == 0.999:
        assert error_bound(problem, z + error, sharp=False).infinity > 50 * np.abs(error).max()


@settings.get_profile("many")
@given(h_plus_matrices().map(sp.csr_array), st.integers(-40, 40))
def test_v_certificate_is_attained(M, exponent):
    """For an M-matrix without bounds and z = z* + t v the v-certificate is the error itself."""
    M = sp.csr_array(2.0 * sp.diags_array(M.diagonal()) - abs(M))
    certificate = comparison_certificate(LCP(M, np.zeros(M.shape[0])).matrix)
    assert certificate is not None
    problem = LCP(M, np.zeros(M.shape[0]), lower=-np.inf)
    z = np.ldexp(certificate.v, exponent)
    y = error_bound(problem, z, sharp=False).componentwise
    assert (z <= y).all()
    assert (y <= z * (1.0 + 1e-10)).all()


def test_bound_of_the_exact_solution_is_zero():
    """If z = z* and w* has no rounding error, the bounds are 0."""
    scene = gallery.half_active(n=400, degenerate=False)
    for sharp in (True, False):
        bound = error_bound(scene.problem, scene.exact, sharp=sharp)
        assert bound.infinity == bound.relative == 0.0


@pytest.mark.parametrize("n", [10_000, pytest.param(90_000, marks=pytest.mark.full)])
def test_large_five_point_matrix(n):
    """The bound of a matrix without a zeroth-order term is at most 1.6 times the error."""
    scene = gallery.half_active(n=n, delta=0.0, degenerate=False)
    z = scene.exact + 1e-7 * np.sin(np.arange(n))
    bound = error_bound(scene.problem, z)
    error = np.abs(z - scene.exact).max()
    assert error <= bound.infinity <= 1.6 * error
    assert (np.abs(z - scene.exact) <= bound.componentwise).all()


@pytest.mark.full
def test_large_matrix_with_both_signs():
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
def test_no_bound_of_no_number(value, M):
    """NaN or infinite entries of z give the bound ∞."""
    bound = error_bound(LCP(M, [-5, 1]), [value, 0.0])
    assert bound.infinity == bound.relative == np.inf


def test_relative_bound_at_zero():
    """The relative bound at z = 0 is 0 if z* = 0 is proved, and otherwise ∞."""
    M = [[2.0, 1.0], [1.0, 2.0]]
    assert error_bound(LCP(M, [1, 1]), [0, 0]).relative == 0.0
    assert error_bound(LCP(M, [-1, 1]), [0, 0]).relative == np.inf


def test_points_outside_the_bounds():
    """A z far outside a box is bounded by its distance to the solution."""
    problem = LCP([[2, -1], [-1, 2]], [-9, 9], lower=-1, upper=1)
    bound = error_bound(problem, [1e6, -1e6])
    assert 1e6 - 1 <= bound.infinity <= 1e6 + 2


def test_an_unsuitable_matrix_is_rejected():
    """Neither H₊ nor positive definite, or beyond the range: the message names both classes, without a warning."""
    for M in ([[1, 2], [2, 1]], [[1, 0], [5, -2]], [[1e-300, 1e300], [1e300, 1e-300]]):
        with pytest.raises(UnsuitableMatrix, match=r"H₊-matrix.* M was not proven to have either"):
            error_bound(LCP(M, [1, 1]), [0, 0])


# --- The stages of an error bound, each alone ---

CIRCULANT = [[4.0, 3.0, 3.0], [3.0, 4.0, 3.0], [3.0, 3.0, 4.0]]  # definite, λ_min = 1, no H-matrix


# --- The 2-norm bound ---------------------------------------------------------------------------------------


def test_an_exact_residual_counts():
    """A z a little above the bound that w keeps it at: r is exact, nothing is blurred, and the bound is not zero."""
    problem = LCP(CIRCULANT, [100.0, 100.0, 100.0])
    bound = error_bound(problem, np.full(3, 0.5), sharp=False)
    assert (bound.componentwise >= 0.5).all()
    assert bound.method == "2-norm, λ_min"
