"""Contacts with friction as LCPs: the pyramid's conditions, closed forms, batches, and mistakes in words."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, FrictionalContact, InvalidProblem, solve, solve_batch

GRAVITY, STEP = 9.81, 0.01


def contacts_of_bodies(count: int, bodies: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """W and the velocities of random contacts among free bodies, some of which press."""
    generator = np.random.default_rng(seed)
    J = generator.standard_normal((3 * count, 6 * bodies))
    return J @ J.T / (6 * bodies), (J @ generator.standard_normal(6 * bodies)).reshape(count, 3)


@pytest.mark.parametrize("directions", [4, 6, 8])
def test_an_answer_keeps_the_conditions_of_contact_and_friction(directions):
    """Normals do not pull or overlap, friction is in its pyramid, and is the most that opposes the slip."""
    for seed in range(8):
        W, velocities = contacts_of_bodies(5, 4, seed)
        problem = LCP.from_contacts(W, 0.6, velocities, directions)
        motion = problem.origin.recover(solve(problem).require_solved())
        moved = (W @ np.column_stack([motion.normal, motion.tangential]).ravel()).reshape(
            5, 3
        ) + velocities
        np.testing.assert_allclose(
            moved, np.column_stack([motion.separation, motion.slip]), atol=1e-12
        )
        assert min(motion.normal.min(), motion.separation.min()) >= -1e-7
        np.testing.assert_allclose(motion.normal * motion.separation, 0.0, atol=1e-7)
        edges = problem.origin.edges
        power = np.einsum("ct,ct->c", motion.tangential, motion.slip)
        np.testing.assert_allclose(
            power, 0.6 * motion.normal * (motion.slip @ edges.T).min(axis=1), atol=1e-7
        )
        assert (motion.sticks <= motion.touches).all()


def block_on_incline(angle: float, friction: float) -> tuple[float, bool]:
    """The speed along the slope after one step from rest, of a block on its two corners, and whether it sticks."""
    mass = np.diag([2.0, 2.0, 0.4])  # down the slope, away from it, turning
    normals, tangents = [[0, 1, -0.5], [0, 1, 0.5]], [[1, 0, 0.2], [1, 0, 0.2]]
    pull = STEP * GRAVITY * np.array([np.sin(angle), -np.cos(angle), 0.0])
    problem = LCP.from_contacts((mass, normals, tangents), friction, pull)
    motion = problem.origin.recover(solve(problem, tolerance=1e-12).require_solved())
    return motion.slip[0, 0], bool(motion.sticks.all())


def test_a_block_slides_where_the_slope_is_steeper_than_its_friction():
    """It slides at tan θ > μ with the speed of the closed form, to 1e-9, and rests below; also a millionth beside."""
    for friction in (0.3, 0.8):
        for share in (0.5, 0.999999, 1.000001, 1.2):
            angle = np.arctan(share * friction)
            speed, sticks = block_on_incline(angle, friction)
            expected = STEP * GRAVITY * max(np.sin(angle) - friction * np.cos(angle), 0.0)
            assert abs(speed - expected) <= 1e-9
            assert sticks == (share < 1.0)


EYE, FALL = np.eye(3), [[-1.0, 0.0, 0.0]]
BODY = (np.eye(3), [[0, 0, 1]], [[[1, 0, 0], [0, 1, 0]]])


@refusals(r"""
LCP.from_contacts(EYE, [-0.5], FALL) → friction must not be negative, but friction\[0\] = -0.5
LCP.from_contacts(EYE, [0.5, 0.5], FALL) → array of shape \(1,\)
LCP.from_contacts((np.eye(3), [[0, 0, 1]], [[[2, 0, 0], [0, 1, 0]]]), 0.5, np.zeros(3))
    → must be orthogonal unit vectors, but contact 0 has products that differ from 1 or 0 by .* divide
LCP.from_contacts(np.eye(6), 0.5, FALL) → must have shape \(2, 3\).*got shape \(1, 3\)
LCP.from_contacts(BODY, 0.5, np.zeros(2)) → velocities must have shape \(3,\).*too few
LCP.from_contacts(EYE, 0.5, [[0.0] * 3] * 2) → \(1, 3\).*got shape \(2, 3\)
LCP.from_contacts(EYE, 0.5, np.zeros(3)) → must have shape \(1, 3\)
LCP.from_contacts(EYE, 0.5, [[np.nan, 0.0, 0.0]]) → velocities\[0, 0\] = nan; repair it
LCP.from_contacts(np.tri(3), 0.5, FALL) → W must be symmetric.*same J
LCP.from_contacts(np.ones((3, 2)), 0.5, FALL) → W must be square
LCP.from_contacts((np.diag([1.0, 1.0, 0.0]), *BODY[1:]), 0.5, np.zeros(3)) → positive definite
LCP.from_contacts(BODY[:2], 0.5, FALL) → got 2 arrays
LCP.from_contacts((EYE, [[0, 1]], [[[1, 0]]]), 0.5, FALL) → normals must be a real matrix with 3 columns
LCP.from_contacts((EYE, [[0, 0, 1]], [[[1, 0, 0]]] * 2), 0.5, FALL) → tangents must .*k = 1
LCP.from_contacts(EYE, 0.5, FALL, 2) → even number ≥ 4, got 2; leave directions out in the plane
LCP.from_contacts(EYE, 0.5, FALL, 5) → even number ≥ 4.*got 5
LCP.from_contacts(EYE, 0.5, [FALL, FALL]) → must have shape \(1, 3\)
""")
def test_a_mistake_is_refused_in_words(call, words):
    """What does not state contacts is an InvalidProblem that says what is needed."""
    assert_refused(call, words, globals(), InvalidProblem)


def test_rotations_of_length_one_are_no_mistake():
    """Of a body with spherical inertia, rotations before translations, lever arms may have any length."""
    for arm in ([1.0, 0, 0], [0, 1.0, 0], [1.0, 1.0, -1.0], [0, 0, -1.0]):
        directions = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
        rows = np.hstack([np.cross(arm, directions), directions])
        contacts = (np.diag([1.0, 1, 1, 2, 2, 2]), rows[:1], rows[None, 1:])
        assert solve(LCP.from_contacts(contacts, 0.5, [0, 0, 0, 0, 0, -1.0])).is_solved


@pytest.mark.parametrize(
    "tangents",
    [
        [[1, 1, 0], [0, 1, 0]],
        [[3, 1, 0], [0, 5, 0]],
        [[5, 0, 0.1], [0, 5, 0]],
        [[1, 0, 0], [0.6, 0.8, 0]],
        [[0, 0, 0], [0, 0, 0]],
        [[1, 0, 0], [0, 0, 0]],
        [[1, 0, 0], [1, 0, 0]],
        [[0, 0, 1], [1, 0, 0]],
    ],
    ids=[
        *("long and skew", "longer", "along the normal", "unit and skew"),
        *("zero", "one is zero", "equal", "equal to the normal"),
    ],
)
def test_tangents_of_a_free_body_are_orthogonal_unit_vectors(tangents):
    """What is skew is refused as well, with a way out for unknowns that are no translations."""
    bodies = 2.0 * np.eye(3), [[0.0, 0.0, 1.0]], [tangents]
    with pytest.raises(
        InvalidProblem, match=r"must be orthogonal unit vectors.*or, if the unknowns are not transl"
    ):
        LCP.from_contacts(bodies, 0.4, [0.5, 0.3, -1.0])
    far = 2.0 * np.eye(6), np.eye(1, 6, 5), np.hstack([np.zeros((2, 3)), tangents])
    for given in (far, tuple(map(sp.csr_array, far))):
        with pytest.raises(InvalidProblem, match="orthogonal unit vectors, but contact 0"):
            FrictionalContact(given, np.zeros(6), 0.4)


@pytest.mark.parametrize(("shape", "t"), [((0, 1, 4), 1), ((0, 2, 4), 2), ((0, 4), 2)])
def test_bodies_that_do_not_touch_move_on(shape, t):
    """Without contacts the velocities stay, unless equations change them; flat tangents are read as in space."""
    bodies, velocities = (np.eye(4), np.zeros((0, 4)), np.zeros(shape)), np.ones(4)
    for rows, expected in ((np.zeros((0, 4)), velocities), (np.ones((1, 4)), np.zeros(4))):
        pyramids = LCP.from_contacts(bodies, 0.5, velocities, equations=rows)
        cones = FrictionalContact(bodies, velocities, 0.5, equations=rows)
        for motion in (pyramids.origin.recover(solve(pyramids)), solve(cones).motion):
            assert motion.tangential.shape == (0, t)
            np.testing.assert_allclose(motion.body_velocities, expected, atol=1e-12)


def test_an_answer_to_another_q_has_its_own_velocities():
    """``problem.with_q(q)`` along a trajectory leads back to the velocities that its q stands for."""
    bodies = [np.diag([2.0, 2.0, 2.0]), [[0.0, 0.0, 1.0]], [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]]
    here, there = (LCP.from_contacts(bodies, 0.4, u) for u in ([0.5, 0.3, -1.0], [4.0, -0.2, -0.5]))
    moved = here.origin.recover(solve(here.with_q(there.q)))
    truth = there.origin.recover(solve(there))
    for name in ("normal", "tangential", "separation", "slip", "sticks"):
        assert getattr(moved, name) == pytest.approx(getattr(truth, name), abs=1e-14)


def test_a_batch_of_other_velocities_is_not_led_back_with_these():
    """Contacts of one problem know one set of velocities: answers of many are refused in words."""
    problem = LCP.from_contacts(np.eye(3), 0.5, FALL)
    batch = solve_batch(np.array([problem.M]), np.array([2.0 * problem.q]))
    with pytest.raises(
        InvalidProblem, match=r"shape \(6,\), of one result at a time.*got \(1, 6\)"
    ):
        problem.origin.recover(batch)
