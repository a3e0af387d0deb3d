"""Solving contacts: every family, warm starts, batches, the order of rows, and what has not quite the form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inputs.contact_families import FAMILIES, falling, planted

from lcp_plugin import LCP, FrictionalContact, InvalidProblem, solve
from lcp_plugin.problems.contact import Contacts, contact_data

SIZES = st.sampled_from([(1, 1), (2, 1), (4, 2), (6, 1), (8, 4)])


def problem_of(data: Contacts) -> LCP:
    return LCP(*data.arrays)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(FAMILIES)), SIZES, st.sampled_from([1.0, 1e3]), st.integers(0, 2**16))
def test_contacts_that_have_an_answer_get_one(name, size, ratio, seed):
    """Of any rank of W, masses up to 10³ apart, contacts at a kink: SOLVED, and the motion keeps Coulomb's law."""
    data = FAMILIES[name](*size, ratio, np.random.default_rng(seed))
    result = solve(problem_of(data)).require_solved()
    motion = data.recover(result)
    slow = 1e-5 * np.abs(data.velocities).max()
    assert motion.normal.min() >= 0.0
    assert motion.separation.min() >= -slow
    assert (
        np.abs(motion.separation[motion.normal > 1e-6 * motion.normal.max(initial=1e-300)]).max(
            initial=0.0
        )
        <= slow
    )
    limit = data.friction * motion.normal
    rounding = 1e-6 * limit.max() + 1e-12 * motion.normal.max()
    assert (np.abs(motion.tangential).sum(axis=1) <= limit + rounding).all()


def test_a_start_with_the_answers_contacts_costs_no_more_work():
    """From the answer before, where velocities have moved a little, contacts take no more work."""
    data = planted(8, 8, 10.0, np.random.default_rng(3))
    before = solve(problem_of(data))
    moved = contact_data(data.W, data.friction, data.velocities * (1.0 + 1e-9))
    warm, cold = solve(problem_of(moved), z0=before.z), solve(problem_of(moved))
    assert warm.is_solved
    assert cold.is_solved
    assert warm.work <= cold.work
    np.testing.assert_allclose(data.recover(warm).slip, data.recover(cold).slip, atol=1e-7)


def test_an_answer_of_another_length_is_refused():
    """The message has the length that it must have."""
    data = falling(2, 1, 1.0, np.random.default_rng(0))
    with pytest.raises(InvalidProblem, match=r"z must have shape \(12,\)"):
        data.recover(np.zeros(11))


def test_three_contacts_with_much_friction_are_solved():
    """A W of rank 6 with μ of 1 and 5, whose central path comes near the boundary, is SOLVED."""
    rng = np.random.default_rng(3811)
    H, b = rng.normal(size=(9, 6)), rng.normal(size=9)
    solve(FrictionalContact(H @ H.T, b, rng.choice([1.0, 5.0], 3))).require_solved()
