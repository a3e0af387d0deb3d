"""Banded problems: tridiagonal M-matrices, whose contacts are found directly, and rounds on other narrow bands."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from inputs.planted import planted_lcp
from oracles.exact import exact_solution

from lcp_plugin import LCP, Status, solve

Generator = np.random.Generator


def tridiagonal_m(n: int, rng: Generator) -> sp.csr_array:
    """A nonsymmetric M-matrix of small integers, not dominant in its rows: A v > 0 for a v > 0 of them."""
    below, above = (rng.integers(0, 9, n - 1) * (rng.random(n - 1) < 0.9) for _ in range(2))
    v = rng.integers(1, 9, n)
    sums = np.append(0, below * v[:-1]) + np.append(above * v[1:], 0)
    return sp.csr_array(
        sp.diags_array([-1.0 * below, sums // v + 1.0, -1.0 * above], offsets=[-1, 0, 1])
    )


def band(n: int, below: int, above: int, rng: Generator) -> np.ndarray:
    """Random entries within the band."""
    entries = rng.normal(size=(n, n))
    return np.triu(np.tril(entries, above), -below)


def dominant(n: int, below: int, above: int, rng: Generator) -> sp.csr_array:
    """A nonsymmetric H₊-matrix within the band."""
    M = band(n, below, above, rng)
    np.fill_diagonal(M, 1.01 * abs(M).sum(axis=1) + 0.1)
    return sp.csr_array(M)


def definite(n: int, below: int, above: int, rng: Generator) -> sp.csr_array:
    """A strongly nonsymmetric positive definite matrix within the band, neither M nor H₊."""
    del above
    skew, factor = band(n, below, 0, rng), band(n, below // 2, 0, rng)
    return sp.csr_array(skew - skew.T + factor @ factor.T + 0.1 * np.eye(n))


# --- Tridiagonal M-matrices -----------------------------------------------------------------------------------


@settings.get_profile("many")
@given(seed=st.integers(0, 2**32), n=st.integers(1, 13), boxes=st.booleans())
def test_the_answer_of_a_tridiagonal_m_matrix_is_that_of_fractions(seed, n, boxes):
    """Also where nobody chose the answer: it agrees with exact rational arithmetic."""
    rng = np.random.default_rng(seed)
    M = tridiagonal_m(n, rng) if n > 1 else sp.csr_array([[2.0]])
    lower = rng.integers(-3, 1, n).astype(float)
    upper = (
        np.where(rng.random(n) < 0.5, lower + rng.integers(0, 4, n), np.inf) if boxes else np.inf
    )
    problem = LCP(M, rng.integers(-20, 20, n).astype(float), lower=lower, upper=upper)
    exact = exact_solution(problem).z
    z = solve(problem, "banded").require_solved().z
    size = max(1, *map(abs, exact))
    assert all(
        abs(Fraction(mine) - right) <= Fraction(1, 10**9) * size
        for mine, right in zip(z, exact, strict=True)
    )


def test_two_obstacles_take_few_rounds_however_fine_the_grid_is():
    """A string between two walls, 20 000 nodes: the sides take turns, and no front moves row by row."""
    n = 20_000
    x = np.linspace(0.0, 1.0, n + 2)[1:-1]
    M = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)) * (n + 1.0) ** 2
    for q, lower, upper in (
        (-200.0 * np.sin(9.0 * np.pi * x), -0.05, 0.05),
        (-30.0, -0.3, np.minimum(x, 1.0 - x)),
    ):
        problem = LCP(M, np.full(n, q), lower=lower, upper=upper)
        result = solve(problem, "banded").require_solved()
        assert result.iterations <= 10
        assert 0.1 < np.mean((result.z == problem.lower) | (result.z == problem.upper)) < 0.95


@pytest.mark.full
def test_without_an_m_matrix_no_status_is_false():
    """Where a pivot is not positive, rounds go on without the direct way, or the run ends unsolved."""
    rng = np.random.default_rng(5)
    for _ in range(300):
        n = int(rng.integers(14, 40))
        M = tridiagonal_m(n, rng) - 3.0 * sp.eye_array(n)
        result = solve(LCP(M, rng.integers(-9, 9, n).astype(float)), "banded")
        if result.status is Status.INFEASIBLE:
            assert result.infeasibility.verify()
        elif result.is_solved:
            assert np.abs(np.minimum(result.z, result.w)).max() <= 1e-6


@pytest.mark.parametrize("name", ["auto", "banded"])
@pytest.mark.parametrize(
    ("right", "status"), [(0.5, Status.INFEASIBLE), (1.0, Status.SOLVED), (2.0, Status.SOLVED)]
)
def test_a_string_without_hold_is_proved_infeasible_or_solved(name, right, status):
    """Singular, pulled up by 1 at one end and down at the other: no huge z makes its rounding an excuse."""
    diagonal = np.full(30, 2.0)
    diagonal[[0, -1]] = 1.0
    M = sp.diags_array([-np.ones(29), diagonal, -np.ones(29)], offsets=[-1, 0, 1])
    q = np.zeros(30)
    q[[0, -1]] = -1.0, right
    assert solve(LCP(M, q), name).status is status


# --- Other bands ----------------------------------------------------------------------------------------------


@pytest.mark.quick(1)
@pytest.mark.parametrize("make", [dominant, definite])
@pytest.mark.parametrize(("below", "above"), [(1, 1), (2, 2), (4, 4), (0, 3), (3, 0), (1, 5)])
@pytest.mark.parametrize("boxes", [False, True])
def test_other_bands_take_rounds(make, below, above, boxes):
    """Boxes, more bands: H₊-matrices are solved to seven digits; others too, or by auto if the wrong rows cycle."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        M = make(int(rng.integers(20, 200)), below, above, rng)
        problem, z = planted_lcp(M, rng, bounds=boxes)
        result = solve(problem, "banded")
        if make is definite and result.status is Status.STALLED:
            result = solve(problem)
        # of one that z° solves to rounding
        assert result.is_solved or result.certificate.is_at_rounding_level
        assert np.abs(result.z - z).max() <= 1e-6 * max(1.0, np.abs(z).max())
        assert result.iterations <= 200
