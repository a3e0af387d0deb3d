"""Steps in time over cones: each is what solve gives for the q of its step."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_plugin import (
    ConeProblem,
    FrictionalContact,
    InvalidOption,
    InvalidProblem,
    derivative,
    march,
    solve,
)

COMPLIANCE = np.array([[1.0, 0.2, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]])
PAD = FrictionalContact(COMPLIANCE, np.zeros(3), 0.5)
SLIP = -np.diag([0.0, 1.0, 1.0]) @ COMPLIANCE  # what the tangents move on from


def pulled(*distances: float) -> np.ndarray:
    return np.array([[-1.0, distance, 0.0] for distance in distances])


@pytest.mark.parametrize("algorithm", ["auto", "nsgs", "newton"])
def test_a_pad_pulled_to_and_fro_sticks_after_each_turn(algorithm):
    """Each step is solve's answer to its q, and a pad that is pulled back sticks before it slides."""
    forcing = pulled(*[0.1] * 8, *[-0.1] * 12)
    done = march(PAD, forcing, SLIP, algorithm=algorithm)
    assert done.all_solved
    state = np.zeros(3)
    for row, result in zip(forcing, done, strict=True):
        alone = solve(PAD.with_q(row + SLIP @ state), tolerance=1e-12)
        np.testing.assert_allclose(result.z, alone.z, atol=1e-6)
        state = result.z
    sticks = [bool(result.motion.sticks[0]) for result in done]
    assert sticks == [True] * 3 + [False] * 5 + [True] * 9 + [False] * 3
    np.testing.assert_allclose(done.z[7][1], -0.5 * done.z[7][0], rtol=1e-7)  # at friction's limit


def test_free_rows_carry_a_body_s_velocity_from_step_to_step():
    """M dv = h f + r for a body whose impulse r lies in a cone: it falls to rest on the floor of a corner."""
    mass, step = 2.0, 0.1
    M = np.block([[mass * np.eye(3), -np.eye(3)], [np.eye(3), np.zeros((3, 3))]])
    problem = ConeProblem(M, np.zeros(6), [("free", 3), ("second_order", 3)])
    pulls = np.array([10.0, 0.0, 0.0]), np.array([-20.0, 0.0, 0.0])
    forcing = np.array([np.concatenate([-step * pull, np.zeros(3)]) for pull in pulls])
    carried = np.diag([-mass] * 3 + [0.0] * 3)
    done = march(problem, forcing, carried)
    np.testing.assert_allclose([z[0] for z in done.z], [0.5, 0.0], atol=1e-7)
    # what is left of 2 N s when 1 N s has stopped it
    np.testing.assert_allclose(done.z[1][3], 1.0, atol=1e-6)


def test_what_no_march_over_cones_does_is_named():
    """Options, sizes, derivatives."""
    with pytest.raises(InvalidOption, match="solve takes no polish for a FrictionalContact"):
        march(PAD, pulled(0.1), SLIP, polish=False)
    with pytest.raises(InvalidProblem, match=r"shape \(k, n\), a row per step, n = 3"):
        march(PAD, np.zeros((2, 2)), SLIP)
    done = march(PAD, pulled(0.1, 0.2), SLIP)
    with pytest.raises(InvalidOption, match=r"derivative\(done\[k\]\)"):
        derivative(done)
    assert derivative(done[1]).vjp([1.0, 0.0, 0.0]).q.shape == (3,)
