"""SOLVED holds in every component of a problem: each of several uncoupled ones is judged by its own data."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import components as campaign
from collection.truth import ExactData

from lcp_plugin import LCP, Certificate, Status, derivative, error_bound, march, solve, solve_batch
from lcp_plugin.algorithms import REGISTRY

TOLERANCE = 1e-8
FAR_APART = LCP(np.eye(2), [-1e10, -0.5])
WRONG_IN_ONE = np.array([1e10, 0.6])  # relative to the larger component by 1e-11


def is_lie(problem: LCP, z: np.ndarray) -> bool:
    return ExactData(problem).is_lie(z.tolist(), TOLERANCE)


def two_grids(*units: float, side: int = 20, seed: int = 0) -> tuple[LCP, np.ndarray]:
    """Five-point grids without coupling, an answer planted in each; q in these units."""
    rng, n = np.random.default_rng(seed), side * side
    T = sp.diags_array(
        [-np.ones(side - 1), 2.0 * np.ones(side), -np.ones(side - 1)], offsets=[-1, 0, 1]
    )
    M = sp.csr_array(sp.kron(T, sp.eye_array(side)) + sp.kron(sp.eye_array(side), T))
    z = rng.integers(1, 5, (len(units), n)) * (rng.random((len(units), n)) < 0.3)
    q = (z == 0) * 1.0 - (M @ z.T).T
    size = np.repeat(units, n)
    return LCP(
        sp.block_diag([sp.csr_array(M)] * len(units), format="csr"), size * q.ravel()
    ), size * z.ravel()


# --- One component wrong, and small beside another -------------------------------------------------------------------


def test_a_small_component_that_is_wrong_is_not_called_solved() -> None:
    """diag(1, 1), q = (−1e10, −.5): z = (1e10, .6) is 1e-11 of the larger component off, and 0.2 of its own."""
    assert Certificate.of(FAR_APART, WRONG_IN_ONE).relative_residual == pytest.approx(0.2)
    result = solve(FAR_APART, z0=WRONG_IN_ONE)
    assert result.is_solved
    assert result.z[1] == 0.5


@pytest.mark.parametrize("name", REGISTRY)
def test_no_method_stops_at_a_component_that_is_wrong(name: str) -> None:
    """Every method goes on from there until the small component is within the tolerance, too."""
    result = solve(FAR_APART, name, z0=WRONG_IN_ONE)
    assert result.is_solved
    assert abs(result.z[1] - 0.5) <= TOLERANCE * 0.5


def test_the_certificate_names_the_worst_component() -> None:
    """The worst row is that of the component that is wrong beside its own reference, not of the largest residual."""
    certificate = Certificate.of(FAR_APART, [1e10 - 1.0, 0.6])
    assert certificate.worst_index == 1


def test_the_worst_component_is_named_by_what_is_proved() -> None:
    """Measured, the second row has no residual: 3 · 0.1 is rounded; exactly it is as wrong as z° is."""
    problem = LCP(np.diag([1.0, 0.1]), [-1.0, -(3.0 * 0.1)], lower=[0.0, 3.0])
    assert problem.slack([1.0, 3.0])[1] == 0.0
    certificate = Certificate.of(problem, [1.0 + 1e-12, 3.0])
    assert certificate.relative_residual >= 1.0
    assert certificate.worst_index == 1


def test_a_change_in_the_small_component_is_seen_by_a_warm_start() -> None:
    """Two grids in units 1e10 apart, solved; q of the small one changes: the old answer is no answer any more."""
    problem, z = two_grids(1e10, 1.0)
    first = solve(problem)
    assert first.is_solved
    other, wanted = two_grids(1e10, 1.0, seed=1)
    n = problem.n // 2
    changed = problem.with_q(np.r_[problem.q[:n], other.q[n:]])
    assert Certificate.of(changed, first.z).relative_residual > 0.1
    again = solve(changed, z0=first.z)
    assert again.is_solved
    assert not is_lie(changed, again.z)
    assert np.abs(again.z[n:] - wanted[n:]).max() <= 1e-5
    assert np.abs(again.z[:n] - z[:n]).max() <= 1e-5 * 1e10


@pytest.mark.parametrize("unit", [1e12, 1e-12])
def test_the_interior_point_method_solves_components_far_apart(unit: float) -> None:
    """Whose path is one for all components, in units 10^±12."""
    problem, z = two_grids(unit, 1.0, side=10)
    result = solve(problem, "interior_point")
    assert result.is_solved
    assert (np.abs(result.z - z) <= 1e-6 * np.repeat([unit, 1.0], 100)).all()


# --- Components that z° solves ---------------------------------------------------------------------------------------


def test_what_z0_solves_exactly_is_left_there() -> None:
    """A component that z° solves has no other answer by its own data: a start elsewhere does not stay there."""
    result = solve(LCP(np.eye(2), [-1.0, 2.0]), z0=[0.0, 1e-300])
    assert result.is_solved
    assert result.z.tolist() == [1.0, 0.0]


def test_a_narrow_box_is_no_rounding() -> None:
    """z₂ ≤ 1e-17 makes the residual of z° small; w₂ = −1 says that z° is wrong, and z₂ = 1e-17 is the answer."""
    problem = LCP(np.eye(2), [-3.0, -1.0], lower=[1.0, 0.0], upper=[np.inf, 1e-17])
    result = solve(problem)
    assert result.is_solved
    assert result.z.tolist() == [3.0, 1e-17]


def test_a_component_at_the_rounding_of_its_data_leaves_the_others_their_answer() -> None:
    """z₂ = 3 misses by the rounding of 0.3 alone; the first is solved all the same, and PRECISION_LIMIT said."""
    M = np.zeros((6, 6))
    M[:5, :5] = (
        np.tril(np.full((5, 5), -1.0), -1) + np.triu(np.full((5, 5), 2.0), 1) + 3.0 * np.eye(5)
    )
    M[5, 5] = 0.3
    problem = LCP(M, [-1.0, -2.0, -3.0, 1.0, -5.0, -0.9], lower=[0.0] * 5 + [3.0])
    for name in ("auto", "newton", "npsor", "interior_point", "lemke"):
        result = solve(problem, name)
        assert result.status is Status.PRECISION_LIMIT, name
        alone = problem.with_q(np.r_[problem.q[:5], 1.0])  # the last component is solved by z° here
        assert not is_lie(alone, result.z), name


def test_a_residual_beyond_the_range_of_doubles_is_not_rounding() -> None:
    """w₁ = −1e200 measured in 1e-200, and w₂ = −1 contradicts: the misfit of 1e400 is no rounding of 1e400."""
    result = solve(LCP([[-1e-200, 0.0], [0.0, 0.0]], [-1e200, -1.0]))
    assert result.status not in (Status.PRECISION_LIMIT, Status.SOLVED)


@pytest.mark.parametrize("name", ["auto", *REGISTRY])
def test_a_start_out_of_all_proportion_to_its_component_does_no_harm(name: str) -> None:
    """1e200 where the answer is 1e-200: the relative residual overflows, and a damped sweep cannot see that z falls."""
    problem = LCP(np.eye(2), [-1e-200, -1.0])
    result = solve(problem, name, z0=[1e200, 0.0])
    assert result.is_solved is (name not in ("npgs", "npj", "npsplitting"))
    assert not result.is_solved or not is_lie(problem, result.z)


def test_infeasible_is_infeasible_whatever_stands_beside() -> None:
    """A component without solution leaves the whole without one, with a proof in the caller's units."""
    problem = LCP(np.diag([1.0, -1.0, 2.0]), [-1e6, -1e3, -1.0])
    result = solve(problem)
    assert result.status is Status.INFEASIBLE
    assert result.infeasibility is not None
    assert result.infeasibility.problem is problem
    assert result.infeasibility.verify()


# --- However it is asked ---------------------------------------------------------------------------------------------


def batch_of_components() -> tuple[Any, ...]:
    rng = np.random.default_rng(0)
    M, q = (
        np.zeros((40, 6, 6)),
        rng.normal(size=(40, 6)) * 10.0 ** rng.integers(-12, 13, (40, 2)).repeat(3, axis=1),
    )
    for k in range(40):
        for block in (slice(3), slice(3, 6)):
            B = rng.normal(size=(3, 3))
            M[k, block, block] = B @ B.T + np.eye(3)
    M[::7] += 0.1  # one component
    return M, q


def test_batches_have_the_answers_of_single_solves() -> None:
    """Stacked and listed: answer and status; and none is a lie."""
    M, q = batch_of_components()
    problems = [LCP(*one) for one in zip(M, q, strict=True)]
    alone = [solve(problem) for problem in problems]
    for batch in (solve_batch(M, q), solve_batch(problems)):
        assert batch.all_solved
        for k, one in enumerate(alone):
            assert batch.status[k] is one.status
            np.testing.assert_allclose(batch.z[k], one.z, rtol=1e-9, atol=1e-300)
            assert not is_lie(problems[k], batch.z[k])


def test_marches_take_each_step_in_units_of_its_own() -> None:
    """Two rods in units 1e9 apart, on narrow bands: every step is right in both."""
    T = 3.0 * np.eye(20) - np.eye(20, k=1) - np.eye(20, k=-1)
    rods = LCP(sp.block_diag([sp.csr_array(T)] * 2, format="csr"), np.zeros(40))
    forcing = np.broadcast_to(np.repeat([-1e9, -1.0], 20), (5, 40))
    steps = march(rods, forcing)
    assert steps.all_solved
    before = np.zeros(40)
    for step in steps:
        assert not is_lie(rods.with_q(forcing[0] - before), step.z)
        before = step.z


def test_error_bounds_hold_in_every_component() -> None:
    """In each component, in the caller's units; the tolerance on the error is relative to ‖z‖∞."""
    problem, z = two_grids(2.0**-33, 2.0**33, side=6)  # nothing is rounded
    for result in (solve(problem, error_bound=True),):
        assert result.is_solved
        assert result.error_bound is not None
        assert (np.abs(result.z - z) <= result.error_bound.componentwise).all()
    assert (np.abs(1.5 * z - z) <= error_bound(problem, 1.5 * z).componentwise).all()


def test_derivatives_stay_in_their_component() -> None:
    """A change of q in the small component moves nothing in the other."""
    problem, z = two_grids(1e10, 1.0, side=6)
    dq = np.r_[np.zeros(36), np.ones(36)]
    dz = derivative(solve(problem)).jvp(dq=dq)
    assert not dz[:36].any()
    free = np.flatnonzero(z[36:] > 0.0) + 36
    expected = np.linalg.solve(problem.csr.toarray()[np.ix_(free, free)], -dq[free])
    assert dz[free] == pytest.approx(expected, rel=1e-9)


# --- The campaign ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", range(len(campaign.ASKED)))
def test_the_campaign_finds_nothing(first: int) -> None:
    """Some of its problems, asked in every way; see campaigns/components.py."""
    for number in (first * len(REGISTRY) + k for k in range(1, 3)):
        with warnings.catch_warnings(action="ignore"):  # of methods not covered
            bad, kind, status = campaign.judge(5, number)
        assert not bad, number
        assert kind != campaign.SOLVABLE or status == "SOLVED", number


def test_the_campaign_sees_one_norm_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """A certificate that compares all components with the largest reference is found out."""

    def by_the_largest(self: Certificate) -> float:
        largest, least = self.residuals_of_components
        return float(largest.max(initial=0.0) / max(least.max(initial=0.0), 1e-300))

    monkeypatch.setattr(Certificate, "relative_residual", property(by_the_largest))
    with warnings.catch_warnings(action="ignore"):
        found = [text for number in range(1, 8) for text in campaign.judge(5, number)[0]]
    assert any("exactly" in text or "SOLVED with" in text for text in found)
