"""A march is its steps one by one: forces and matrices that change, options, where it ends, what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, InvalidOption, InvalidProblem, Status, gallery, march, solve


def test_a_march_is_its_steps_one_by_one() -> None:
    """On a narrow band, and where another method solves each step: the same z bit for bit, and the same status."""
    scene = gallery.build("american_put_march", size=101, steps=25)
    assert scene.advance is not None
    forcing = np.broadcast_to(scene.advance(np.zeros(101)), (25, 101))
    for algorithm in ("auto", "banded", "psor"):
        steps = march(scene.problem, forcing, z0=scene.problem.lower, algorithm=algorithm)
        problem, z = scene.problem, np.array(scene.problem.lower)
        for step, state in zip(steps, steps.z, strict=True):
            alone = solve(problem, algorithm, z0=z)
            assert np.array_equal(step.certificate.problem.q, problem.q)
            assert np.array_equal(state, step.z)
            assert np.array_equal(step.z, alone.z)
            assert np.array_equal(step.w, alone.w)
            assert step.status is alone.status
            assert step.certificate.relative_residual == alone.certificate.relative_residual
            z = step.z
            problem = problem.with_q(scene.advance(z))
        assert steps[-1].is_solved


def test_a_march_has_a_propagator_and_forces_that_change() -> None:
    """Crank–Nicolson: (2I + A) z = (2I − A) z_before + f_k, between bounds; each step solves its own problem."""
    rng = np.random.default_rng(4)
    n, k = 60, 30
    A = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    explicit = sp.csr_array(2.0 * sp.eye_array(n) - A)
    problem = LCP(2.0 * sp.eye_array(n) + A, np.zeros(n), lower=-1.0, upper=1.0)
    force = rng.normal(scale=3.0, size=(k, n)).cumsum(axis=0)
    z = rng.normal(scale=5.0, size=n)  # outside the bounds
    for before in (explicit, explicit.toarray()):
        steps = march(problem, -force, -before, z0=z)
        state = z
        for step, f in zip(steps, force, strict=True):
            np.testing.assert_allclose(
                step.certificate.problem.q, -f - explicit @ state, atol=1e-12
            )
            state = step.require_solved().z
        assert all(0.0 < np.mean(np.abs(state) == 1.0) < 1.0 for state in steps.z[3:])


def test_a_march_takes_what_a_solve_takes() -> None:
    """Other options, a callback, a measure and a limit in seconds are those of `solve`, step by step and for all."""
    scene = gallery.build("american_put_march", size=31, steps=4)
    forcing, heard = np.broadcast_to(scene.problem.q, (4, scene.problem.n)), []
    plain = march(scene.problem, forcing, z0=scene.problem.lower)
    watched = march(
        scene.problem,
        forcing,
        z0=scene.problem.lower,
        algorithm="psor",
        relaxation=1.2,
        record=True,
        callback=lambda sample, z: heard.append(sample.iteration),
    )
    assert watched.all_solved
    assert len(watched) == 4
    assert len(heard) == sum(
        len(result.history) > 0 and result.iterations + 1 for result in watched
    )
    for ours, theirs in zip(watched.z, plain.z, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)
    late = march(
        scene.problem,
        forcing,
        z0=scene.problem.lower,
        algorithm="psor",
        tolerance=0.0,
        max_seconds=0.0,
    )
    assert [result.status for result in late] == [Status.MAX_SECONDS]
    with pytest.raises(InvalidOption, match="has no option 'relaxaton'; did you mean 'relaxation'"):
        march(scene.problem, forcing, algorithm="psor", relaxaton=1.2)


def test_a_march_ends_where_a_step_is_not_solved() -> None:
    """The steps after it would start from nothing; what cannot be taken in one loop is taken by itself."""
    problem = LCP(
        sp.diags_array([0.5, 1.0, 0.5], offsets=[-1, 0, 1], shape=(30, 30)), np.zeros(30), upper=1.0
    )
    forcing = np.random.default_rng(0).normal(size=(5, 30))
    assert len(march(problem, forcing, 0.0)) == 5
    cut = march(problem, forcing, 0.0, max_iterations=0)
    assert len(cut) == 1
    assert not cut.all_solved
    assert cut[0].status is Status.MAX_ITERATIONS
    idle = march(
        problem, np.vstack([forcing[:2], np.ones((1, 30)), forcing[2:]]), 0.0
    )  # z° solves the third
    assert idle.all_solved
    assert len(idle) == 6
    assert not idle.z[2].any()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"forcing": np.zeros(3)},
            r"forcing must be .* \(k, n\), a row a step, n = 3, got shape \(3,\)",
        ),
        ({"forcing": [[0.0, np.nan, 0.0]]}, r"forcing\[0, 1\] = nan; repair that entry"),
        (
            {"propagator": np.eye(2)},
            r"propagator must be a number or a finite array of shape \(3, 3\), got shape \(2, 2\)",
        ),
        (
            {"propagator": np.full((3, 3), np.inf)},
            "propagator must be .* got NaN or infinite entries; repair them",
        ),
        ({"z0": np.zeros(2)}, "z0 must be"),
    ],
)
def test_what_a_march_refuses(given: dict[str, Any], message: str) -> None:
    """Data of another shape, or not finite, in words and before the first step."""
    with pytest.raises(InvalidProblem, match=message):
        march(LCP(np.eye(3), np.zeros(3)), **{"forcing": np.zeros((1, 3)), **given})
    with pytest.raises(
        InvalidOption, match="march needs an LCP, ConeProblem or FrictionalContact, got ndarray"
    ):
        march(np.eye(3), np.zeros((1, 3)))


def test_a_march_keeps_what_it_has() -> None:
    """A q that overflows on the way ends it and says so; the first step's is refused."""
    steps = march(LCP([[1.0]], [0.0]), [[-1.0]] * 3, propagator=-1e200)
    assert not steps.all_solved
    assert 1 <= len(steps) < 3
    assert "q[0]" in str(steps.error)
    assert "ended by" in repr(steps)
    with pytest.raises(InvalidProblem):
        march(LCP([[1.0]], [0.0]), [[-1.0]], propagator=[[1j]])
    assert march(LCP([[2.0]], [0.0]), sp.csr_array([[-1.0], [-1.0]])).all_solved
