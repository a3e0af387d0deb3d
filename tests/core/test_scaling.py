"""SOLVED does not depend on units: what M is measured in changes neither the residual nor the status."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from badly_scaled import ANSWER, BOUNDS, M, Q
from campaigns.scaling import (
    KINDS,
    answered,
    definite,
    friction,
    game,
    grid,
    jumps,
    measured,
    random_scaling,
    saddle,
)

from lcp_plugin import LCP, Certificate, Status, march, solve, solve_batch
from lcp_plugin.algorithms import create
from lcp_plugin.core.matrix.matrix import Matrix
from lcp_plugin.core.matrix.scaling import scaling_of
from lcp_plugin.core.settings import Settings
from lcp_plugin.problems.batches import batch_run

FAR = 2.0**20  # the units of unknowns are powers of two between its inverse and it


WITHOUT_DIAGONAL = [saddle, friction, game]  # zeros there: rows and columns are fitted together


@pytest.mark.parametrize("kind", KINDS)
def test_any_units_change_no_status_and_the_residual_by_less_than_a_hundred(kind: Any) -> None:
    """Units are found to some powers of two: the residual of a z that is a little off tells its size in any of them."""
    for seed in range(12):
        M, q, z = answered(kind, seed)
        at, rng = z + 1e-4, np.random.default_rng(seed)
        residuals = []
        for _ in range(2):
            rows, units = np.exp2(rng.uniform(-20.0, 20.0, (2, z.size)))
            problem = measured(M, q, rows, units)
            residuals.append(Certificate.of(problem, at * units).relative_residual)
            assert solve(problem).is_solved
        assert max(residuals) <= (4.0 if kind in WITHOUT_DIAGONAL else 100.0) * min(residuals)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("units", ["mixed", "smooth"])
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in (grid, jumps)])
def test_the_residual_tells_right_from_wrong_in_any_units(kind: Any, units: str) -> None:
    """Wrong by 10⁻³ in one unknown's own unit never passes 10⁻⁶, unless it is an answer too; right to 10⁻¹⁰ passes."""
    for seed in range(60):
        M, q, z = answered(kind, seed)
        rng, (rows, of_z) = np.random.default_rng(seed), random_scaling(seed, z.size, units)
        problem, j = measured(M, q, rows, of_z), int(rng.integers(z.size))
        wrong = z + 1e-3 * np.eye(z.size)[j]
        shown = Certificate.of(problem, wrong * of_z).relative_residual
        assert shown > 1e-6 or np.abs(np.minimum(wrong, M @ wrong + q)).max() <= 1e-12, seed
        right = z * (1.0 + 1e-10 * rng.uniform(-1.0, 1.0, z.size))
        assert Certificate.of(problem, right * of_z).meets(Settings(tolerance=1e-8)), seed


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
        rows, of_z = random_scaling(seed, z.size)
        right = np.where(z > 0.0, z, 1e-12) * of_z
        assert Certificate.of(measured(M, q, rows, of_z), right).term_residual <= 1e-8, seed


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


def test_a_flow_in_its_own_unit_shows_none() -> None:
    """Entries up to 16 diagonals are no evidence: convection up to cell Péclet numbers of 30 keeps its unit"""
    for kind in FLOWS:
        assert scaling_of(Matrix(flow(kind, 200))) is None
        rows = np.exp2(np.random.default_rng(0).integers(-20, 21, 200))
        found = scaling_of(Matrix(rows[:, None] * flow(kind, 200)))
        assert found is None


def test_a_large_grid_in_mixed_units_goes_to_multigrid() -> None:
    """Its passes are at most three times those in one unit, and at most one and a half where one unknown differs."""
    m = 80
    T = sp.diags_array([-np.ones(m - 1), 2.0 * np.ones(m), -np.ones(m - 1)], offsets=[-1, 0, 1])
    A = sp.csr_array(sp.kron(sp.eye_array(m), T) + sp.kron(T, sp.eye_array(m)))
    rng = np.random.default_rng(0)
    q, (rows, of_z) = (
        rng.uniform(-1.0, 0.8, m * m) * 1e-3,
        np.exp2(rng.integers(-20, 21, (2, m * m))),
    )
    own = solve(LCP(A, q))
    scaled = solve(
        LCP(sp.csr_array(sp.diags_array(rows) @ A @ sp.diags_array(1.0 / of_z)), rows * q)
    )
    one = np.ones(m * m)
    one[m * m // 2] = 2.0**12
    beside = solve(LCP(sp.csr_array(A @ sp.diags_array(one)), q))
    assert own.is_solved
    assert scaled.is_solved
    assert beside.is_solved
    assert scaled.work <= 3.0 * own.work
    assert beside.work <= 1.5 * own.work
    assert np.abs(scaled.z / of_z - own.z).max() <= 1e-6 * np.abs(own.z).max()


@pytest.mark.parametrize("name", ["npsor", "npgs"])
def test_without_row_scaling_the_iterates_are_those_on_the_callers_matrix(name: str) -> None:
    """What the paper iterates is not changed by the units in which it is judged."""
    M, q, z = answered(definite, 3)
    rows, of_z = random_scaling(3, z.size)
    problem = measured(M, q, rows, of_z)
    assert scaling_of(problem.matrix) is not None
    seen: list[np.ndarray] = []
    solve(
        problem,
        name,
        scaling=None,
        max_iterations=5,
        callback=lambda sample, at: seen.append(at.copy()),
    )
    steps = create(name, {"scaling": None}).iterates(problem, np.zeros(z.size))
    for at in seen:
        assert np.array_equal(at, next(steps).z)
    assert len(seen) == 6


def test_a_zero_on_the_diagonal_says_nothing_about_units() -> None:
    """Friction, games, KKT forms and grids in one unit keep it, jumps and dominance too: no bit changes there."""
    for kind in KINDS:
        for seed in range(5):
            assert scaling_of(Matrix(answered(kind, seed)[0])) is None


def planted(seed: int) -> tuple[LCP, np.ndarray]:
    """A problem in units that are alike, and its only answer: M + Mᵀ is definite, or M strictly dominant."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 31))
    B = rng.standard_normal((n, n)) * (rng.random((n, n)) < 0.6)
    if seed % 3 == 1:
        M = B - np.diag(np.diag(B))
        M += np.diag(1.1 * np.abs(M).sum(axis=1) + 0.1)
    else:
        S = rng.standard_normal((n, n)) * (seed % 3 == 0)
        M = 0.5 * B @ B.T + 0.5 * np.eye(n) + S - S.T
    z = np.where(rng.random(n) < 0.4, 0.0, np.abs(rng.standard_normal(n)) + 0.1)
    w = np.where(z == 0.0, np.abs(rng.standard_normal(n)) + 0.1, 0.0)
    return LCP(M, w - M @ z, upper=np.where(rng.random(n) < 0.2, 2.0 * z + 1.0, np.inf)), z


def rescaled(problem: LCP, seed: int) -> tuple[LCP, np.ndarray]:
    """The same problem in other units of its rows and unknowns, and those of the unknowns."""
    rng = np.random.default_rng([seed, 1])
    rows, columns = np.exp2(rng.integers(-20, 21, (2, problem.n)))
    M = rows[:, None] * (problem.M.toarray() if sp.issparse(problem.M) else problem.M) / columns
    return LCP(M, rows * problem.q, upper=columns * problem.upper), columns


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


def test_the_residual_shows_a_wrong_row_in_small_units() -> None:
    """A z that is a third off, with a row wrong by a seventh of its terms, is far from SOLVED."""
    problem = LCP(M, Q, **BOUNDS)
    assert Certificate.of(problem, WRONG).relative_residual > 1e-3
    assert Certificate.of(problem, solve(problem, "lemke").z).relative_residual <= 1e-8


@pytest.mark.parametrize("algorithm", ["auto", "newton", "lemke", "interior_point", "psor"])
def test_what_is_solved_in_any_units_is_near_the_answer(algorithm: str) -> None:
    """Of problems in random units (seeds that were lies among them) what is SOLVED has all unknowns to 1e-3."""
    solved = 0
    for seed in (*range(12), 27, 29, 48, 98, 108, 155, 177):
        problem, z = planted(seed)
        scaled, units = rescaled(problem, seed)
        result = solve(scaled, algorithm, max_iterations=3000)
        solved += result.is_solved
        assert not result.is_solved or np.abs(result.z / units - z).max() <= 1e-3, seed
    assert solved >= 12


@pytest.mark.parametrize("algorithm", ["auto", "lemke"])
def test_other_units_change_no_status(algorithm: str) -> None:
    """Rows and unknowns multiplied by powers of two: SOLVED as before, and the same z."""
    for seed in range(30):
        problem, z = planted(seed)
        scaled, units = rescaled(problem, seed)
        before, after = solve(problem, algorithm), solve(scaled, algorithm)
        assert (before.status, after.status) == (Status.SOLVED, Status.SOLVED), seed
        assert after.z / units == pytest.approx(z, abs=1e-5), seed


@pytest.mark.parametrize("seed", range(12))
def test_the_units_are_found(seed: int) -> None:
    """Balancing finds the units of the unknowns to a few powers of two; of a problem in one unit there are none."""
    problem = planted(seed)[0]
    scaled, columns = rescaled(problem, seed)
    scaling = scaling_of(scaled.matrix)
    assert scaling is not None
    assert np.ptp(scaling.column - np.log2(columns)) <= 8
    assert scaling_of(problem.matrix) is None


def test_a_far_field_in_one_unit_stays_in_the_compiled_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a batch no problem is solved by itself."""
    n = 14
    near = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    M = 10.0 * np.eye(n) - (near == 1) - 0.1 * (near == 2)

    def alone(*args: Any, **wishes: Any) -> None:
        raise AssertionError("solved by itself")

    monkeypatch.setattr(batch_run, "solve_lcp", alone)
    batch = solve_batch(M, -np.eye(n)[-3:], tolerance=0.1)
    assert batch.all_solved


def test_what_is_small_by_the_callers_word_is_right() -> None:
    """A row whose residual is within absolute_tolerance, in the unit of its z, is right."""
    problem = LCP([[1.0, 2.0**-40], [2.0**40, 2.0]], [-1e-9, -1e3], upper=[np.inf, 1e3])
    z = [0.0, 500.0]
    assert Certificate.of(problem, z).relative_residual > 1e-8
    result = solve(problem, z0=z, absolute_tolerance=1e-3)
    assert result.is_solved


def test_a_march_judges_each_step_in_these_units() -> None:
    """Tridiagonal, its units 1e±6 in turn: every step is what the march in one unit gives."""
    n = 40
    M = sp.diags_array(
        [-np.ones(n - 1), np.full(n, 3.0), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr"
    )
    units = np.where(np.arange(n) % 2 == 0, FAR, 1.0 / FAR)
    forcing = np.random.default_rng(0).standard_normal((4, n))
    D, inverse = sp.diags_array(units), sp.diags_array(1.0 / units)
    plain = march(LCP(M, np.zeros(n)), forcing)
    scaled = march(
        LCP(sp.csr_array(M @ inverse), np.zeros(n)), forcing, propagator=-sp.csr_array(inverse)
    )
    assert plain.all_solved
    assert scaled.all_solved
    for one, other in zip(plain.z, scaled.z, strict=True):
        assert D @ one == pytest.approx(other, abs=1e-6 / FAR, rel=1e-6)


def test_entries_near_the_end_of_the_range_have_units_too() -> None:
    """What would overflow in other units is no error: the certificate still says what is wrong."""
    problem = LCP([[1e300, 1e307], [1.0, 1e8]], [-1e307, -1e8])
    assert scaling_of(problem.matrix) is not None
    assert solve(problem, "lemke").is_solved
    assert Certificate.of(problem, [0.5, 0.5]).relative_residual > 1e-3


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


def test_the_residual_in_the_unit_of_z_is_what_an_absolute_tolerance_speaks_of() -> None:
    """In mixed units, too: what `scaled_residual` says is enough of it, and a little less is not."""
    M, q, z = answered(definite, 3)
    rows, of_z = random_scaling(3, z.size)
    problem = measured(M, q, rows, of_z)
    assert scaling_of(problem.matrix) is not None
    at = (z + 1e-3) * of_z
    size = Certificate.of(problem, at).scaled_residual
    for absolute, is_solved in ((1.001 * size, True), (0.999 * size, False)):
        result = solve(
            problem, "psor", z0=at, absolute_tolerance=absolute, tolerance=0.0, max_iterations=0
        )
        assert result.is_solved is is_solved


def test_a_far_field_in_one_unit_is_asked_for_nothing_else() -> None:
    """Far from the load z is 1e-20 and any error there is of its size: it counts beside the load, as ever."""
    n = 60
    M = sp.diags_array(
        [-np.ones(n - 1), np.full(n, 10.0), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr"
    )
    problem = LCP(M, -np.eye(n)[0])
    result = solve(problem, "psor")
    assert result.is_solved
    assert scaling_of(problem.matrix) is None
    assert (
        Certificate.of(problem, np.where(np.arange(n) < 12, result.z, 0.0)).relative_residual
        <= 1e-8
    )
