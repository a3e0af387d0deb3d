"""The componentwise test of the criterion: it refuses nothing right, and no flow or unit hides a wrong row."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from badly_scaled import ANSWER, BOUNDS, M, Q
from campaigns.scaling import KINDS, answered, friction, game, measured, random_scaling

from lcp_plugin import LCP, Certificate, solve, solve_batch
from lcp_plugin.core.certificates.criterion import snapped

FAR = 2.0**20  # the units of unknowns are powers of two between its inverse and it


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_the_guard_refuses_nothing_right(kind: Any, tolerance: float) -> None:
    """Right to a hundredth of the tolerance, in any units: every row is right in its own terms."""
    for seed in range(30):
        M, q, z = answered(kind, seed)
        rows, of_z = random_scaling(seed, z.size)
        right = z * (
            1.0 + 0.01 * tolerance * np.random.default_rng(seed).uniform(-1.0, 1.0, z.size)
        )
        assert Certificate.of(measured(M, q, rows, of_z), right * of_z).term_residual <= tolerance


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in (friction, game)])
def test_the_guard_refuses_no_rounding_beside_a_bound(kind: Any) -> None:
    """Off its bound by 1e-12 of its unit, where w is positive and large, z is rounded; the diagonal tells units."""
    for seed in range(30):
        M, q, z = answered(kind, seed)
        rows, of_z = random_scaling(seed, z.size)[0], np.ones(z.size)
        problem = measured(M, q, rows, of_z)
        right = snapped(problem, np.where(z > 0.0, z, 1e-12) * of_z)
        assert Certificate.of(problem, right).term_residual <= 1e-8, seed


FLOWS = {"growth": (-6.0, 2.0, 4.0), "upwind": (-11.0, 12.0, -1.0), "steep": (-501.0, 502.0, -1.0)}


def flow(kind: str, n: int) -> np.ndarray:
    """A well conditioned matrix along which something flows: balancing |m_ij| against |m_ji| drifts by e^(Péclet)."""
    left, middle, right = FLOWS[kind]
    return (
        middle * np.eye(n) + np.diag(np.full(n - 1, left), -1) + np.diag(np.full(n - 1, right), 1)
    )


@pytest.mark.parametrize("algorithm", ["auto", "npsor", "newton", "interior_point", "lemke"])
@pytest.mark.parametrize("kind", FLOWS)
@pytest.mark.parametrize("units", ["own", "one", "each", "rows"])
def test_a_flow_is_no_unit(kind: str, algorithm: str, units: str) -> None:
    """Convection in other units: what is SOLVED is right to 1e-3, and auto solves it."""
    for n in (60, 200):
        rng = np.random.default_rng(n)
        M, q = flow(kind, n), rng.choice([-1.0, 1.0], n) * rng.uniform(0.5, 1.0, n)
        z = solve(LCP(M, q), "newton").z
        rows, of_z = np.exp2(rng.integers(-20, 21, (2, n)))
        if units in ("own", "one"):
            rows[:], of_z[:] = 1.0, 1.0
            of_z[n // 3] = 1.0 if units == "own" else 2.0**-10
        elif units == "rows":
            of_z[:] = 1.0
        result = solve(measured(M, q, rows, of_z), algorithm, max_iterations=2000)
        assert result.is_solved or algorithm != "auto"
        assert not result.is_solved or np.abs(result.z / of_z - z).max() <= 1e-3 * np.abs(z).max()


WRONG = np.array([1511.71259, 0.0, 0.0, 1e-4, 423442.392])


@pytest.mark.parametrize("algorithm", ["auto", "newton", "lemke", "interior_point"])
def test_nothing_calls_a_z_solved_that_is_wrong_in_its_small_unknowns(algorithm: str) -> None:
    """solve, watched or not, and solve_batch: a row missed its sign by 0.8 where its terms are 5."""
    problem = LCP(M, Q, **BOUNDS)
    results = [
        solve(problem, algorithm),
        solve(problem, algorithm, callback=lambda sample, z: False),
        solve_batch(M[None], Q[None], algorithm=algorithm, **BOUNDS)[0],
    ]
    for result in results:
        assert result.is_solved
        assert result.z == pytest.approx(ANSWER, rel=1e-6)


def test_what_is_small_by_the_callers_word_is_right() -> None:
    """A row whose residual is within absolute_tolerance, in the unit of its z, is right."""
    problem = LCP([[1.0, 2.0**-40], [2.0**40, 2.0]], [-1e-9, -1e3], upper=[np.inf, 1e3])
    z = [0.0, 500.0]
    assert Certificate.of(problem, z).relative_residual > 1e-8
    result = solve(problem, z0=z, absolute_tolerance=1e-3)
    assert result.is_solved


@pytest.mark.parametrize("algorithm", ["newton", "lemke", "interior_point"])
def test_a_penalty_row_beside_a_wind_is_no_unit(algorithm: str) -> None:
    """Upwind differences with one value held by 1e8: the wind grades no units, and nothing else is asked."""
    n = 200
    M = sp.diags_array(
        [np.full(n - 1, -61.0), np.full(n, 62.01), np.full(n - 1, -1.0)], offsets=[-1, 0, 1]
    ).tolil()
    M[0, 0], M[0, 1] = 1e8, 0.0
    q = np.where(np.arange(n) < n - 2, 0.0, -1.0)
    result = solve(LCP(sp.csr_array(M), q), algorithm)
    assert result.is_solved
    assert result.iterations <= 20


def test_a_far_field_in_one_unit_is_asked_for_nothing_else() -> None:
    """Far from the load z is 1e-20 and any error there is of its size: it counts beside the load, as ever."""
    n = 60
    M = sp.diags_array(
        [-np.ones(n - 1), np.full(n, 10.0), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr"
    )
    problem = LCP(M, -np.eye(n)[0])
    result = solve(problem, "psor")
    assert result.is_solved
    assert (
        Certificate.of(problem, np.where(np.arange(n) < 12, result.z, 0.0)).relative_residual
        <= 1e-8
    )
