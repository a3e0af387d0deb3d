"""Contacts with gaps, the motion of their bodies, and what is refused or warned of."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from inputs.contact_families import rows_of_bodies
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, FrictionalContact, InvalidProblem, ModelWarning, solve

STEP = 0.01


def given(seed: int, count: int = 3, bodies: int = 3) -> dict[str, Any]:
    """What states random contacts of falling bodies, more motions than forces, some gaps open."""
    rng = np.random.default_rng(seed)
    J = rows_of_bodies(count, bodies, rng).reshape(count, 3, -1)
    root = np.diag(rng.uniform(0.5, 2.0, 6 * bodies)) + 0.1 * rng.standard_normal(
        (6 * bodies, 6 * bodies)
    )
    fall = 0.3 * rng.standard_normal(6 * bodies)
    fall[2::6] -= 1.0
    return {
        "mass": root @ root.T,
        "rows": J,
        "friction": rng.uniform(0.1, 1.0, count),
        "velocities": fall,
        "gaps": 0.002 * rng.random(count),
    }


def stated(data: dict[str, Any]) -> LCP:
    rows = data["rows"]
    contacts = data["mass"], rows[:, 0], rows[:, 1:]
    return LCP.from_contacts(
        contacts, data["friction"], data["velocities"], gaps=data["gaps"], time_step=STEP
    )


def test_a_gap_is_what_a_contact_may_lose_in_a_step():
    """Gaps beside a mass matrix, beside W, and gap / time step added by hand to contacts' velocities are the same."""
    for seed in range(6):
        data = given(seed)
        problem = stated(data)
        origin = problem.origin
        by_W = LCP.from_contacts(
            origin.W, data["friction"], origin.velocities, gaps=data["gaps"], time_step=STEP
        )
        by_hand = origin.velocities.copy()
        by_hand[:, 0] += data["gaps"] / STEP
        for other in (by_W, LCP.from_contacts(origin.W, data["friction"], by_hand)):
            assert other.q == pytest.approx(problem.q, abs=1e-14)
        motion = origin.recover(solve(problem, tolerance=1e-12))
        assert (motion.separation >= -data["gaps"] / STEP - 1e-9).all()
        assert motion.separation[motion.touches] == pytest.approx(
            -data["gaps"][motion.touches] / STEP, abs=1e-9
        )


@refusals(r"""
LCP.from_contacts(body, 0.5, [0.0, -1.0], gaps=0.1) → time_step is missing
LCP.from_contacts(body, 0.5, [0.0, -1.0], time_step=0.1) → gaps is missing
LCP.from_contacts(body, 0.5, [0.0, -1.0], gaps=0.1, time_step=0) → time_step must be a number of seconds > 0, got 0
LCP.from_contacts(body, 0.5, [0.0, -1.0], gaps=[0, 0], time_step=1)
    → gaps must be a number, or .* of shape \(1,\).*got shape \(2,\)
""")
def test_gaps_need_a_time_step_and_gaps(call, words):
    """One without the other, another number of gaps, or a step that takes no time is refused in words."""
    assert_refused(call, words, {"body": (np.eye(2), [[0, 1]], [[1, 0]])}, InvalidProblem)


def test_more_friction_than_any_material_has_is_warned_of():
    """μ = 50 is a ModelWarning that says where and what may be meant, at the caller's line; 5 passes in silence."""
    with pytest.warns(
        ModelWarning, match=r"friction\[1\] = 50 is more than 5.*if a percentage, divide by 100"
    ) as told:
        LCP.from_contacts(np.eye(4), [0.5, 50.0], np.zeros((2, 2)))
    assert told[0].filename == __file__
    with pytest.warns(ModelWarning, match=r"friction\[0\] = 30") as told:
        FrictionalContact(np.eye(2), np.zeros((1, 2)), 30.0)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        LCP.from_contacts(np.eye(4), 5.0, np.zeros((2, 2)))
