"""Many worlds with contact and friction in arrays: answers, warm starts, worlds of different size, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from inputs.cone_families import exact_relative_residual, planted_contacts
from tools.refusals import assert_refused, refusals

from lcp_plugin import FrictionalContact, InvalidProblem, Status, solve, solve_batch

ONE = np.eye(3)[None], [[-1.0, 3.0, 4.0]], 0.5


def arrays(count: int, k: int = 4, seed: int = 0) -> tuple[Any, Any, Any]:
    made = [
        planted_contacts(k, 2, 10.0, np.random.default_rng([seed, i]), most=1.0)[0]
        for i in range(count)
    ]
    return tuple(np.array([getattr(one, name) for one in made]) for name in ("W", "b", "friction"))  # type: ignore[return-value]


@pytest.mark.quick(1)
@pytest.mark.parametrize("is_warm", [False, True])
def test_instances_have_the_results_of_each_by_itself(is_warm):
    """As solve to rounding, the same bits on any number of threads; residuals hold with 60 digits."""
    W, b, friction = arrays(100)
    z0 = solve_batch(FrictionalContact.worlds(W, 1.01 * b, friction)).z if is_warm else None
    instances = FrictionalContact.worlds(W, b, friction)
    batch, other = (solve_batch(instances, z0=z0, threads=threads) for threads in (1, 2))
    assert batch.all_solved
    assert batch.z.tobytes() == other.z.tobytes()
    for i in range(0, 100, 7):
        alone = solve(FrictionalContact(W[i], b[i], friction[i]), z0=None if z0 is None else z0[i])
        if not is_warm:
            np.testing.assert_array_equal(batch.z[i], batch[i].z)
            np.testing.assert_allclose(alone.w, batch.w[i], rtol=1e-9, atol=1e-12)
            if np.linalg.eigvalsh(W[i])[0] > 1e-12:  # otherwise several impulses make the motion
                np.testing.assert_allclose(alone.z, batch.z[i], rtol=1e-9, atol=1e-12)
            assert batch.iterations[i] == batch[i].iterations
        assert batch[i].certificate.relative_residual <= 1e-8
        assert (
            exact_relative_residual(alone.problem, batch.z[i]) <= batch.relative_residual[i] <= 1e-8
        )
        np.testing.assert_allclose(batch.w[i], batch[i].w, atol=1e-12)
        assert batch.motion.sticks[i].tolist() == batch[i].motion.sticks.tolist()
    assert "100 worlds: 100 SOLVED" in batch.explain()


def test_instances_have_as_many_contacts_as_they_have():
    """Behind a world's last contact anything may stand; its result has its own contacts only."""
    W, b, friction = arrays(12, seed=2)
    counts = np.arange(12) % 5
    for i, count in enumerate(counts):
        W[i, 3 * count :], b[i, 3 * count :], friction[i, count:] = np.nan, np.nan, -1.0
    batch = solve_batch(
        FrictionalContact.worlds(W, b.reshape(12, 4, 3), friction, contacts=counts)
    ).require_solved()
    for i, count in enumerate(counts):
        own = slice(3 * count)
        alone = solve(
            FrictionalContact(W[i, own, own], b[i, own], friction[i, :count], dimension=3)
        )
        assert not batch.z[i, 3 * count :].any()
        assert batch[i].z.size == 3 * count
        np.testing.assert_allclose(batch.z[i, : 3 * count], alone.z, atol=1e-7)


def test_one_world_harms_no_other():
    """NaN, a W that is not symmetric, no answer, mixed units: each is said of its own world."""
    W, b = np.stack([np.eye(3)] * 5), np.tile([-1.0, 3.0, 4.0], (5, 1))
    W[0, 0, 0], W[1, 0, 1], W[2] = np.nan, 1.0, np.diag([0.0, 1.0, 1.0])
    batch = solve_batch(FrictionalContact.worlds(W, b, [[0.5], [0.5], [0.0], [-1.0], [0.5]]))
    assert sorted(batch.errors) == [0, 1, 3]
    assert [batch.status[k] for k in (2, 4)] == [Status.INFEASIBLE, Status.SOLVED]
    assert np.isnan(batch.z[[0, 1, 3]]).all()
    with pytest.raises(InvalidProblem, match=r"friction\[0\] = -1"):
        _ = batch[3]
    np.testing.assert_allclose(batch.z[4], [1.0, -0.3, -0.4], atol=1e-8)


TWO = np.zeros((2, 6))


@refusals(r"""
FrictionalContact.worlds(np.eye(4), TWO, 0.5, dimension=3) → W must have shape \(B, 6, 6\)
FrictionalContact.worlds(np.eye(3)[None], 1.0, 0.5) → b must have shape \(B, d k\)
FrictionalContact.worlds(np.eye(6), TWO, np.ones(4)) → shape \(2,\) or \(B, 2\), B = 2, got
FrictionalContact.worlds(np.zeros((3, 6, 6)), TWO, 0.5, dimension=3) → B = 2 and 6 as b has, got \(3, 6, 6\)
FrictionalContact.worlds(np.eye(6), TWO, 0.5, dimension=3, contacts=[1, 3]) → from 0 to 2
solve_batch(FrictionalContact.worlds(*ONE), z0=np.zeros(6)) → InvalidOption: z0 must have shape \(1, 3\) or \(3,\)
solve_batch(FrictionalContact.worlds(*ONE), np.zeros(3)) → InvalidOption: FrictionalContact.worlds\(W, b, friction\)
""")
def test_wrong_arrays_are_refused_in_words(call, words):
    """With what they must be."""
    assert_refused(call, words, globals(), InvalidProblem)


def test_a_batch_of_contacts_has_a_length_and_a_text():
    """Also a batch of no worlds."""
    batch = FrictionalContact.worlds(*ONE)
    assert repr(batch) == "FrictionalContact(1 instances of up to 1 contacts in space)"
    assert len(list(batch)) == len(solve_batch(batch)) == 1
    assert (
        len(solve_batch(FrictionalContact.worlds(np.zeros((0, 3, 3)), np.zeros((0, 3)), 0.5))) == 0
    )


def test_gaps_of_a_batch_are_the_gaps_of_each():
    """The speed gaps / time_step is added to the normal rows of every instance, for a number and for each shape."""
    rng = np.random.default_rng(0)
    b = rng.normal(size=(3, 4, 2))
    for gaps in (0.01, rng.normal(size=4), rng.normal(size=(3, 4))):
        batch = FrictionalContact.worlds(np.eye(8), b, 0.3, gaps=gaps, time_step=0.1)
        for k, own in enumerate(np.broadcast_to(gaps, (3, 4))):
            single = FrictionalContact(np.eye(8), b[k], 0.3, gaps=own, time_step=0.1)
            np.testing.assert_array_equal(batch[k].b, single.b)
    for wrong, words in (
        ({"gaps": np.zeros(3)}, r"gaps .*\(4,\) or \(3, 4\)"),
        ({}, "gaps is missing"),
    ):
        with pytest.raises(InvalidProblem, match=words):
            FrictionalContact.worlds(np.eye(8), b, 0.3, time_step=0.1, **wrong)


@pytest.mark.parametrize("index", [slice(0, 1), 0.0, "first"])
def test_instances_are_taken_one_by_one(index):
    """An index that is no integer is refused, with what to write."""
    batch = FrictionalContact.worlds(np.eye(3)[None], [[-1.0, 0.0, 0.0]], 0.3)
    with pytest.raises(TypeError, match=r"batch\[i\], i an integer"):
        batch[index]


def test_a_default_that_is_stated_is_no_other_way():
    """absolute_tolerance=0.0 and an equal string for the algorithm change no bit."""
    batch = FrictionalContact.worlds(*arrays(10))
    stated = solve_batch(batch, absolute_tolerance=0.0, algorithm="".join(["au", "to"]))
    assert stated.z.tobytes() == solve_batch(batch).z.tobytes()
