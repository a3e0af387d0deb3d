"""The compiled road of small problems: the same answers as step by step, and the long way."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import scipy.sparse as sp
from collection.truth import ExactData
from small_families import FAMILIES, definite_stack, draw, told

import lcp_plugin.methods.small.small_dense as small_dense
from lcp_plugin import LCP, Certificate, Status, march, solve, solve_batch
from lcp_plugin.methods.small.kernels.small_problems import run_all

ON_THE_ROAD = ("auto", "newton", "lemke")
SOLVED = (Status.SOLVED, Status.PRECISION_LIMIT)
INF = np.inf


# --- One by one --------------------------------------------------------------------------------------------------


@pytest.mark.sampled
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("algorithm", ON_THE_ROAD)
def test_watching_a_run_changes_nothing(family: str, algorithm: str) -> None:
    """With record or a callback the same bits, iterations, work and stages, for cold and warm starts and limits."""
    rng = np.random.default_rng(0)
    for k, drawn in enumerate(draw(family, 6, 9)):
        z0 = None if k % 3 else rng.normal(size=drawn.n)
        limit = {} if k % 4 else {"max_iterations": k % 5}
        alone = solve(drawn, algorithm, z0=z0, **limit)
        watched = solve(drawn, algorithm, z0=z0, record=True, **limit)
        called = solve(drawn, algorithm, z0=z0, callback=lambda sample, z: False, **limit)
        assert told(alone) == told(watched) == told(called)
        assert (
            alone.certificate.relative_residual == Certificate.of(drawn, alone.z).relative_residual
        )


@pytest.mark.parametrize("family", FAMILIES)
def test_the_roads_agree(family: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the compiled road solves is no lie, by exact arithmetic, and the long road disproves none of it."""
    for drawn in draw(family, 12, 8):
        short = solve(drawn)
        if short.status is Status.SOLVED:
            assert not ExactData(drawn).is_lie(short.z, 1e-8)
        with monkeypatch.context() as patch:
            patch.setattr(small_dense, "COMPILED_UP_TO", 0)
            patch.setattr(small_dense, "COMPILED_SPARSE_UP_TO", 0)
            long = solve(LCP(drawn.M, drawn.q, lower=drawn.lower, upper=drawn.upper))
        assert (short.status in SOLVED) == (long.status in SOLVED)


@pytest.mark.parametrize("n", [1, 2, 5, 17, 60, 128, 256])
def test_a_planted_solution_is_found_at_once(n: int) -> None:
    """z* and w* chosen first, bounds on both sides and free rows among them; M definite_stack, or triangular and P."""
    rng = np.random.default_rng(n)
    for matrix in (
        definite_stack(1, n, n)[0][0],
        np.tril(rng.normal(size=(n, n)), -1) / n + np.eye(n),
    ):
        lower = np.where(rng.random(n) < 0.1, -INF, np.where(rng.random(n) < 0.3, -1.0, 0.0))
        upper = np.where(rng.random(n) < 0.4, np.maximum(lower, 0.0) + 1.0, INF)
        side = rng.integers(0, 3, n)
        side[(side == 0) & (lower == -INF)] = 1
        side[(side == 2) & (upper == INF)] = 1
        inside = np.maximum(np.minimum(lower, upper), -0.5) + 0.25
        z = np.select([side == 0, side == 2], [lower, upper], inside)
        w = np.select([side == 0, side == 2], [1.0, -1.0], 0.0)
        result = solve(LCP(matrix, w - matrix @ z, lower=lower, upper=upper))
        assert result.status is Status.SOLVED
        np.testing.assert_allclose(result.z, z, atol=1e-7)
        assert {stage.name for stage in result.stages} <= {"npsor", "newton", "lemke"}
        assert result.setup_seconds == 0.0


def test_a_degenerate_path_does_not_cycle() -> None:
    """Ties on every pivot (Kostreva's matrix, and games of chance with q = −1): the order of the rows decides."""
    kostreva = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])
    assert solve(LCP(kostreva, [-1.0, -1.0, -1.0]), "lemke").z == pytest.approx([1 / 3] * 3)
    rng = np.random.default_rng(3)
    for _ in range(200):
        n = int(rng.integers(3, 12))
        M = rng.integers(0, 2, (n, n)) + np.diag(rng.integers(1, 3, n)).astype(
            float
        )  # strictly copositive
        result = solve(LCP(M, rng.integers(-1, 1, n).astype(float)), "lemke")
        assert result.is_solved
        assert result.iterations <= 1


def test_a_warm_start_costs_no_more_iterations_than_a_cold_one() -> None:
    """In a sequence of near problems the last answer's active set is the next one's, or near it."""
    M, q = (one[0] for one in definite_stack(1, 40))
    rng, z, warm, cold = np.random.default_rng(1), None, [], []
    for _ in range(60):
        q = q + 0.02 * rng.normal(size=40)
        warmed = solve(LCP(M, q), z0=z)
        warm.append(warmed.work)
        cold.append(solve(LCP(M, q)).work)
        z = warmed.z
    assert np.median(warm) <= np.median(cold)


def test_rounds_alone_are_newton_and_pivots_alone_are_lemke() -> None:
    """A named method takes its own phase of the road; with options of its own lemke does not take it."""
    drawn = LCP(*(one[0] for one in definite_stack(1, 12)))
    assert [stage.name for stage in solve(drawn, "newton").stages] == ["newton"]
    assert [stage.name for stage in solve(drawn, "lemke").stages] == ["lemke"]
    limited = solve(drawn, "lemke", max_pivots=50)
    assert limited.is_solved
    assert limited.setup_seconds > 0.0


def test_nothing_is_said_in_passing() -> None:
    """No warning, on problems of every kind."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solve_batch([drawn for family in FAMILIES for drawn in draw(family, 3, 7)])


def test_nobody_can_change_what_was_judged() -> None:
    """The z of a batch, even or ragged, and of a march are read-only."""
    M, q = definite_stack(3, 4)
    ragged = solve_batch([LCP(M[0], q[0]), LCP([[1.0]], [-1.0])])
    chain = sp.diags_array([-np.ones(199), np.full(200, 3.0), -np.ones(199)], offsets=[-1, 0, 1])
    steps = march(LCP(chain, np.zeros(200)), -np.ones((3, 200)))
    for z in (ragged.z[0], solve_batch(M, q).z, steps.z[0], steps[1].z):
        with pytest.raises(ValueError, match="read-only"):
            z[0] = 7.0


def test_a_batch_compiles_nothing_that_a_problem_alone_has_compiled() -> None:
    """Arrays of the caller's that may be written to, and views that may not, are one signature of the loop."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(3, 4, 4))
    M, q = A @ A.transpose(0, 2, 1) + np.eye(4), rng.normal(size=(3, 4))
    solve(LCP(M[0], q[0]))
    before = len(run_all.signatures)
    z0 = solve_batch(M, q).z
    solve_batch(M, q, lower=np.zeros((3, 4)), z0=z0)
    solve_batch(M[0], q)
    assert len(run_all.signatures) == before
