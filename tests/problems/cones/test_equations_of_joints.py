"""Equations next to contacts: hinges, motors, loops; closed forms, minimal coordinates, batches, derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    FrictionalContact,
    InvalidProblem,
    Status,
    certify,
    derivative,
    load_problem,
    solve,
    solve_batch,
)

G = 0.0981  # gravity times a step of 0.01 s


def drawn(seed: int, d: int, *, dependent: bool) -> tuple[Any, Any, int]:
    """Return W and b of four contacts and of three equations, or of four of which the last is their sum."""
    random = np.random.default_rng(seed)
    J, joints = random.standard_normal((4 * d, 20)), random.standard_normal((3, 20))
    J = (
        np.vstack([J, joints, joints.sum(axis=0)[np.newaxis]])
        if dependent
        else np.vstack([J, joints])
    )
    W = J @ np.diag(random.uniform(0.5, 2.0, 20)) @ J.T
    return 0.5 * (W + W.T), J @ random.standard_normal(20), len(J) - 4 * d


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("d", [2, 3])
def test_a_constructed_motion_with_impulses_of_both_kinds_is_found(seed, d):
    """Impulses and velocities come first: open, sticking and sliding contacts; then b."""
    random = np.random.default_rng(seed)
    W, _, p = drawn(seed, d, dependent=False)
    r, u = np.zeros((4, d)), np.zeros((4, d))
    u[0], r[1:, 0] = [1.0, *random.standard_normal(d - 1)], 1.0
    way = random.standard_normal((2, d - 1))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    r[2:, 1:], u[2:, 1:] = 0.4 * way, -way
    z = np.append(r, random.standard_normal(p))
    b = np.append(u, np.zeros(p)) - W @ z
    result = solve(FrictionalContact(W, b, np.full(4, 0.4), equations=p))
    assert result.is_solved
    np.testing.assert_allclose(result.z, z, atol=1e-7)
    assert result.motion.sticks.tolist() == [False, True, False, False]
    np.testing.assert_allclose(result.motion.equations, z[4 * d :], atol=1e-7)


@pytest.mark.parametrize("algorithm", ["auto", "newton", "interior_point", "fixed_point"])
@pytest.mark.parametrize("seed", range(3))
def test_dependent_equations_give_the_motion_of_the_eliminated_ones(seed, algorithm):
    """The contacts alone, with the generalized inverse of the equations' block, move as they do together."""
    W, b, p = drawn(seed, 3, dependent=True)
    first, last = slice(12), slice(12, None)
    gain = W[first, last] @ np.linalg.pinv(W[last, last])
    S = W[first, first] - gain @ W[last, first]
    alone = solve(FrictionalContact(0.5 * (S + S.T), b[first] - gain @ b[last], np.full(4, 0.4)))
    result = solve(FrictionalContact(W, b, np.full(4, 0.4), equations=p), algorithm)
    assert result.is_solved
    np.testing.assert_allclose(result.w[first], alone.w, atol=1e-7)
    np.testing.assert_allclose(result.w[last], 0.0, atol=1e-8)


def pendulum(angle: float, heavy: float) -> tuple[Any, Any, Any]:
    """Return (mass matrix, normals, tangents), the rod, and velocities of a cart on a rail with a mass on a rod."""
    mass = np.diag([1.0, 1.0, heavy, heavy])  # cart, mass: along, up
    rod = np.array([[-np.sin(angle), np.cos(angle), np.sin(angle), -np.cos(angle)]])
    return (mass, [[0, 1, 0, 0]], [[1, 0, 0, 0]]), rod, np.array([0.0, -G, 0.0, -G])


@pytest.mark.parametrize("form", ["cone", "pyramid"])
@pytest.mark.parametrize("heavy", [1.0, 100.0])
def test_a_pendulum_on_a_rail_sticks_and_slides_as_the_closed_form(heavy, form):
    """Sticks if μ ≥ m s c / (1 + m c²), s and c the sine and cosine of the angle; a sliding cart solves 3 equations."""
    s, c = np.sin(0.5), np.cos(0.5)
    bodies, rod, u = pendulum(0.5, heavy)
    least = heavy * s * c / (1.0 + heavy * c * c)
    for friction in (1.01 * least, 0.5 * least):
        if form == "cone":
            result = solve(FrictionalContact(bodies, u, friction, equations=rod))
            motion = result.motion
        else:
            problem = LCP.from_contacts(bodies, friction, u, equations=rod)
            motion = problem.origin.recover(solve(problem).require_solved())
        if friction > least:
            assert motion.sticks.all()
            np.testing.assert_allclose(motion.normal, G * (1.0 + heavy * c * c))
            np.testing.assert_allclose(motion.tangential, -G * heavy * s * c)
            np.testing.assert_allclose(motion.equations, -heavy * G * c)
        else:
            pull = -G * (c + friction * s) / (s * s + 1.0 / heavy - friction * s * c)
            np.testing.assert_allclose(motion.equations, pull)
            np.testing.assert_allclose(motion.normal, G - c * pull)
            np.testing.assert_allclose(motion.slip, -s * pull - friction * (G - c * pull))
        np.testing.assert_allclose(rod @ motion.body_velocities, 0.0, atol=1e-12 * heavy)


def four_bar() -> tuple[Any, Any, Any, Any]:
    """Return mass, contact rows, hinges (two of them stated twice) and velocities of three bars and a floor below."""
    ends = np.array([[0.0, 1.0], [0.3, 2.0], [1.6, 1.8], [1.5, 1.0]])  # of the bars, in order
    middle = 0.5 * (ends[1:] + ends[:-1])

    def rows(body: int, point: Any) -> Any:
        """Return the velocity of a point of a bar by (x, y, rotation) of all bars, shape (2, 9)."""
        J = np.zeros((2, 9))
        arm = point - middle[body]
        J[:, 3 * body : 3 * body + 3] = [[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]]]
        return J

    hinges = [
        rows(0, ends[0]),
        rows(0, ends[1]) - rows(1, ends[1]),
        rows(1, ends[2]) - rows(2, ends[2]),
        rows(2, ends[3]),
    ]
    tip = rows(1, np.array([0.9, 0.5]))  # a foot of the second bar, on the floor
    lengths = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    mass = np.diag(np.column_stack([lengths, lengths, lengths**3 / 12]).ravel())
    return mass, tip[[1, 0]], np.vstack([*hinges, hinges[0], hinges[2]]), np.tile([0.0, -G, 0.0], 3)


@pytest.mark.parametrize("friction", [0.0, 0.2, 2.0])
def test_a_four_bar_linkage_on_the_floor_moves_as_in_its_one_coordinate(friction):
    """Of 12 hinge rows 8 are independent, and one coordinate is left: u = Z s with hinges · Z = 0."""
    mass, J, hinges, u = four_bar()
    Z = np.linalg.svd(hinges)[2][8:].T
    inertia = Z.T @ mass @ Z
    W = J @ Z @ np.linalg.solve(inertia, Z.T @ J.T)
    reduced = solve(
        FrictionalContact(
            W, J @ Z @ np.linalg.solve(inertia, Z.T @ mass @ u), friction, dimension=2
        )
    )
    bodies = mass, J[[0]], J[[1]]
    result = solve(FrictionalContact(bodies, u, friction, equations=hinges))
    assert result.is_solved
    np.testing.assert_allclose(result.w[:2], reduced.w, atol=1e-10)
    np.testing.assert_allclose(hinges @ result.motion.body_velocities, 0.0, atol=1e-10)
    pyramid = LCP.from_contacts(bodies, friction, u, equations=hinges)
    motion = pyramid.origin.recover(solve(pyramid).require_solved())
    np.testing.assert_allclose(motion.body_velocities, result.motion.body_velocities, atol=1e-9)


def test_a_motor_reaches_its_velocity_and_contradictory_motors_are_infeasible():
    """A cart of 2 kg on a rail must have 3 m/s: friction .5 · 2 G and the push add up to its impulse."""
    bodies = np.diag([2.0, 2.0]), [[0, 1]], [[1, 0]]
    motor = solve(FrictionalContact(bodies, [-G, 0.0, -3.0], 0.5, equations=[[1, 0]]))
    np.testing.assert_allclose(motor.motion.slip, 3.0)
    np.testing.assert_allclose(motor.motion.equations, 6.0 + 0.5 * 2.0 * G)
    both = FrictionalContact(bodies, [-G, 0.0, -3.0, -2.0], 0.5, equations=[[1, 0], [1, 0]])
    result = solve(both)
    assert result.has_no_solution
    assert result.proof.verify()


@pytest.mark.parametrize("dependent", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_derivatives_agree_with_differences_of_solves(seed, dependent):
    """By b and friction, of velocities; the gradient is the transpose."""
    W, b, p = drawn(seed, 3, dependent=dependent)
    random, mu, step = np.random.default_rng(seed), np.full(4, 0.4), 1e-6
    db, dmu = random.standard_normal(b.size), 0.1 * random.standard_normal(4)
    if dependent:
        db[-1] = db[12:-1].sum()
    ends = [
        solve(FrictionalContact(W, b + t * db, mu + t * dmu, equations=p), tolerance=1e-12).w
        for t in (-step, step)
    ]
    found = derivative(solve(FrictionalContact(W, b, mu, equations=p), tolerance=1e-12))
    dz = found.jvp(dq=db, dfriction=dmu)
    np.testing.assert_allclose(found.dw(dz, dq=db), (ends[1] - ends[0]) / (2 * step), atol=1e-6)
    g = W @ random.standard_normal(b.size)
    gradient = found.vjp(g)
    assert gradient.friction.shape == (4,)
    assert gradient.q @ db + gradient.friction @ dmu == pytest.approx(g @ dz)


@pytest.mark.parametrize("contacts", [None, np.arange(8) % 5])
def test_a_batch_is_its_instances_with_derivatives_and_a_file(contacts, tmp_path):
    """Arrays of eight instances with three equations each; some have fewer contacts."""
    drawn_ones = [drawn(seed, 3, dependent=False)[:2] for seed in range(8)]
    W, b = map(np.array, zip(*drawn_ones, strict=True))
    worlds = FrictionalContact.worlds(W, b, 0.4, equations=3, dimension=3, contacts=contacts)
    batch = solve_batch(worlds)
    assert batch.all_solved
    assert batch.motion.equations.shape == (8, 3)
    found = derivative(batch)
    changes = found.jvp(dq=np.ones(15), dfriction=0.1)
    assert found.vjp(np.ones(15)).friction.shape == (8, 4)
    for k in range(8):
        alone = solve(worlds[k])
        np.testing.assert_allclose(batch.z[k], alone.z, atol=1e-8)
        np.testing.assert_allclose(
            changes[k], derivative(alone).jvp(dq=np.ones(15), dfriction=0.1), atol=1e-8
        )
    worlds.save(tmp_path / "worlds.npz")
    worlds[0].save(tmp_path / "one.npz")
    one = load_problem(tmp_path / "one.npz")
    assert load_problem(tmp_path / "worlds.npz").equations == one.equations == 3  # type: ignore[attr-defined]
    assert certify(one, batch.z[0]).verdict == "proved"


@refusals(r"""
FrictionalContact(np.eye(4), np.zeros(4), 0.5, equations=np.eye(4)) → normals
FrictionalContact(np.eye(4), np.zeros(4), 0.5, equations=-1) → last rows of W
FrictionalContact(np.eye(4), np.zeros(4), 0.5, equations=1.5) → last rows of W
FrictionalContact((np.eye(2), [[0, 1]], [[1, 0]]), [0, 0], 0.5, equations=1) → single row as \[\[…\]\]
FrictionalContact((np.eye(2), [[0, 1]], [[1, 0]]), [0, 0], 0.5, equations=[[1, 0, 0]]) → 2 columns
LCP.from_contacts(np.eye(4), 0.5, np.zeros(4), equations=1) → per contact
""")
def test_a_wrong_call_is_told_what_to_write(call, words):
    """InvalidProblem with the right form."""
    assert_refused(call, words, {}, InvalidProblem)


def test_contradictory_equations_without_a_contact_are_infeasible():
    """x₁ + x₂ = 1 and = −1, alone and next to a contact."""
    alone = FrictionalContact(np.ones((2, 2)), [-1.0, 1], [], dimension=3, equations=2)
    W = np.diag([1.0, 1, 1, 0])
    beside = FrictionalContact(W, [-1.0, 0, 0, 1], [0.5], dimension=3, equations=1)
    for problem in (alone, beside):
        assert solve(problem).status is Status.INFEASIBLE
