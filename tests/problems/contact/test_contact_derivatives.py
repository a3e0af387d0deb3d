"""Contacts differentiated by friction, velocities, gaps and mass: closed forms, differences, adjoints, and in words."""

from __future__ import annotations

import pickle
import warnings
from typing import Any

import numpy as np
import pytest
from contact_families import rows_of_bodies

from lcp_plugin import LCP, derivative, march, solve, solve_batch
from lcp_plugin.core.errors import InvalidOption, InvalidProblem, ModelWarning
from lcp_plugin.problems.contact import Contacts, contact_data

STEP, GRAVITY = 0.01, 9.81
NAMES = ("friction", "velocities", "gaps", "mass")


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


def changed(name: str, data: dict[str, Any], rng: np.random.Generator) -> np.ndarray:
    change = rng.standard_normal(np.shape(data[name]))
    return 0.5 * (change + change.T) if name == "mass" else change


def impulses(problem: LCP, z: Any) -> np.ndarray:
    motion = problem.origin.recover(z)
    return np.column_stack([motion.normal, motion.tangential]).ravel()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", NAMES)
def test_a_change_of_the_data_moves_the_impulses_as_differences_do(name: str) -> None:
    """By each name jvp is the one-sided difference of all impulses, to 1e-5, whether contacts open, stick or slip."""
    seen = set()
    for seed in range(12):
        data = given(seed)
        problem, change = stated(data), changed(name, data, np.random.default_rng(seed))
        result = solve(problem, tolerance=1e-13).require_solved()
        motion = problem.origin.recover(result)
        seen |= {(bool(a), bool(b)) for a, b in zip(motion.touches, motion.sticks, strict=True)}
        small = 1e-7
        near = stated({**data, name: data[name] + small * change})
        moved = impulses(near, solve(near, tolerance=1e-13).require_solved())
        found = impulses(problem, derivative(result).jvp(**{f"d{name}": change}))
        assert found == pytest.approx(
            (moved - impulses(problem, result)) / small, abs=1e-5 * (1 + abs(found).max())
        )
    assert seen == {(False, False), (True, False), (True, True)}


@pytest.mark.parametrize("seed", range(4))
def test_gradients_are_the_adjoints_of_the_changes(seed: int) -> None:
    """For a function of the impulses Σ gradient · change, over all names at once, is g · jvp; W likewise."""
    rng, data = np.random.default_rng(seed), given(seed)
    problem = stated(data)
    found, k = derivative(solve(problem, tolerance=1e-13)), 3
    weights = rng.standard_normal((k, 3))
    g = np.concatenate(
        [weights[:, 0], (weights[:, 1:] @ problem.origin.edges.T).ravel(), np.zeros(k)]
    )
    change = {name: changed(name, data, rng) for name in NAMES}
    gradient = found.vjp(g)
    by_data = sum(float(np.sum(getattr(gradient, name) * change[name])) for name in NAMES)
    dz = found.jvp(**{f"d{name}": values for name, values in change.items()})
    assert by_data == pytest.approx(float(g @ dz), rel=1e-9, abs=1e-9)
    bent = rng.standard_normal(problem.origin.W.shape)
    bent += bent.T
    assert float(np.sum(gradient.W * bent)) == pytest.approx(
        float(g @ found.jvp(dW=bent)), rel=1e-9, abs=1e-9
    )
    by_q, by_lower, by_upper, by_M = gradient
    assert by_q is gradient.q
    assert by_M is gradient.M
    assert by_lower.shape == by_upper.shape == (problem.n,)


def test_a_sliding_block_has_the_derivatives_of_its_closed_form() -> None:
    """Where p = m g Δt and friction is −μ p: by μ, by mass, by the push and by the gap, to 1e-12."""
    push, m = np.array([1.0, -STEP * GRAVITY]), 2.0
    block = m * np.eye(2), [[0, 1]], [[1, 0]]
    problem = LCP.from_contacts(block, 0.3, push, gaps=0.0, time_step=STEP)
    found, origin = derivative(solve(problem, tolerance=1e-14)), problem.origin
    weight = m * STEP * GRAVITY
    for named, normal, tangential in (
        ({"dfriction": 1.0}, 0.0, -weight),
        ({"dmass": np.eye(2)}, weight / m, -0.3 * weight / m),
        ({"dvelocities": [0.0, -1.0]}, m, -0.3 * m),
        ({"dgaps": 1.0}, -m / STEP, 0.3 * m / STEP),
    ):
        motion = origin.recover(found.jvp(**named))
        assert motion.normal[0] == pytest.approx(normal, rel=1e-12, abs=1e-12)
        assert motion.tangential[0, 0] == pytest.approx(tangential, rel=1e-12)
    # the speed that is left, 1 − μ g Δt, is λ: by μ it falls by g Δt, and w of the normal row stays 0
    gradient = found.vjp(np.eye(problem.n)[-1])
    assert gradient.friction == pytest.approx([-STEP * GRAVITY], rel=1e-12)
    assert gradient.velocities == pytest.approx([1.0, 0.3], rel=1e-12)
    assert np.diag(gradient.mass) == pytest.approx(
        [0.3 * weight / m**2, -0.3 * weight / m**2], rel=1e-12
    )
    assert gradient.gaps == pytest.approx([0.3 / STEP], rel=1e-12)
    assert found.dw(found.jvp(dfriction=1.0), dfriction=1.0)[0] == pytest.approx(0.0, abs=1e-15)


def test_a_gap_is_what_a_contact_may_lose_in_a_step() -> None:
    """Gaps beside a mass matrix, beside W, and gap / time step added by hand to contacts' velocities are the same."""
    for seed in range(6):
        data = given(seed)
        problem = stated(data)
        origin: Contacts = problem.origin
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


def test_bodies_have_velocities_after_the_impulses() -> None:
    """They gain m⁻¹ Jᵀ impulses, and J of them is separation and slip; None where nobody gave u, or q is another."""
    data = given(1)
    problem = stated(data)
    result = solve(problem, tolerance=1e-12)
    motion, J = problem.origin.recover(result), data["rows"].reshape(9, -1)
    assert motion.body_velocities.shape == data["velocities"].shape
    gained = data["mass"] @ (motion.body_velocities - data["velocities"])
    assert gained == pytest.approx(J.T @ impulses(problem, result), abs=1e-12)
    assert J @ motion.body_velocities == pytest.approx(
        np.column_stack([motion.separation, motion.slip]).ravel(), abs=1e-12
    )
    by_W = LCP.from_contacts(problem.origin.W, 0.5, np.zeros((3, 3)))
    assert by_W.origin.recover(np.zeros(18)).body_velocities is None
    other = solve(problem.with_q(problem.q + 1.0))
    assert problem.origin.recover(other).body_velocities is None
    back = pickle.loads(pickle.dumps(problem)).origin.recover(result.z)
    np.testing.assert_array_equal(back.body_velocities, motion.body_velocities)


def batch_data() -> Contacts:
    """Five problems of the same bodies with other velocities and friction."""
    data, rng = given(2), np.random.default_rng(2)
    rows, velocities = data["rows"], data["velocities"] + 0.2 * rng.standard_normal((5, 18))
    friction = rng.uniform(0.1, 1.0, (5, 3))
    return contact_data(
        (data["mass"], rows[:, 0], rows[:, 1:]),
        friction,
        velocities,
        gaps=data["gaps"],
        time_step=STEP,
    )


def test_a_batch_is_differentiated_as_its_problems_are() -> None:
    """Arrays by data.changes and data.gradient, lists by the names: what the problems give one by one."""
    data, each = batch_data(), given(2)
    rows = each["rows"]
    problems = [
        LCP.from_contacts(
            (each["mass"], rows[:, 0], rows[:, 1:]), mu, u, gaps=each["gaps"], time_step=STEP
        )
        for mu, u in zip(data.friction, data.bodies.velocities, strict=True)  # type: ignore[union-attr]
    ]
    found = derivative(solve_batch(*data.arrays, tolerance=1e-13))
    listed = derivative(solve_batch(problems, tolerance=1e-13))
    ones = [derivative(solve(problem, tolerance=1e-13)) for problem in problems]
    moves = (
        {"dfriction": 1.0, "dgaps": 2.0},
        {"dmass": np.eye(18)},
        {"dvelocities": 1.0, "dfriction": [1.0, 0.0, -1.0]},
    )
    for named in moves:
        expected = [one.jvp(**named) for one in ones]
        assert found.jvp(**data.changes(**named)) == pytest.approx(np.array(expected), abs=1e-8)
        lists = {
            name: [values] * 5 if np.ndim(values) else values for name, values in named.items()
        }
        assert listed.jvp(**lists) == pytest.approx(np.array(expected), abs=1e-8)
    # one a problem
    each_its_own = np.arange(15.0).reshape(5, 3)
    expected = [one.jvp(dfriction=own) for one, own in zip(ones, each_its_own, strict=True)]
    assert found.jvp(**data.changes(dfriction=each_its_own)) == pytest.approx(
        np.array(expected), abs=1e-8
    )
    g = np.random.default_rng(0).standard_normal(18)
    gradient = data.gradient(found.vjp(g), found.z)
    for k, one in enumerate(ones):
        alone = one.vjp(g)
        for name in (*NAMES, "W"):
            assert getattr(gradient, name)[k] == pytest.approx(getattr(alone, name), abs=1e-7)
    assert gradient.M.shape == (5, 18, 18)


def test_a_march_is_differentiated_by_what_changes_its_matrix() -> None:
    """By friction a march has the one-sided difference of its last state; velocities are those of its forcing."""
    push, block = np.array([1.0, -STEP * GRAVITY]), (2.0 * np.eye(2), [[0, 1]], [[1, 0]])

    def last(friction: float) -> Any:
        problem = LCP.from_contacts(block, friction, push)
        forcing = problem.q * np.array([[1.0], [1.5], [0.5]])
        return march(problem, forcing, propagator=0.1, tolerance=1e-13)

    found = derivative(last(0.3))
    difference = (last(0.3 + 1e-6).z[-1] - last(0.3).z[-1]) / 1e-6
    assert found.jvp(dfriction=1.0, only_last=True) == pytest.approx(difference, abs=1e-5)
    with pytest.raises(
        InvalidOption, match=r"dvelocities would change q.*dforcing=problem.origin.changes\(dvel"
    ):
        found.jvp(dvelocities=push)
    with pytest.raises(InvalidOption, match="takes no dfrction here; did you mean 'dfriction'"):
        found.jvp(dfrction=1.0)


def refused() -> dict[str, tuple[type[Exception], str, Any]]:
    data = given(0)
    by_bodies = derivative(solve(stated(data)))
    by_W = derivative(solve(LCP.from_contacts(np.eye(3), 0.5, [[-1.0, 0.3, 0.0]])))
    plain = derivative(solve(LCP([[2.0]], [-1.0])))
    of_arrays = derivative(solve_batch(*batch_data().arrays))
    option, problem = InvalidOption, InvalidProblem
    return {
        "a typo": (
            option,
            "takes no dfricton here; did you mean 'dfriction'.*known: dM, dW, df",
            lambda: by_bodies.jvp(dfricton=1.0),
        ),
        "no contacts": (
            option,
            "takes no dfriction here.*known: dM, dlower, dq",
            lambda: plain.jvp(dfriction=1.0),
        ),
        "no gaps": (option, "takes no dgaps here.*known", lambda: by_W.jvp(dgaps=1.0)),
        "no gaps in changes": (
            option,
            "with gaps=… and time_step=…",
            lambda: by_W.problem.origin.changes(dgaps=1),
        ),
        "no mass": (option, "takes no dmass here", lambda: by_W.jvp(dmass=np.eye(3))),
        "no mass in changes": (
            option,
            "give dW = −J",
            lambda: by_W.problem.origin.changes(dmass=np.eye(3)),
        ),
        "dw": (option, "takes no dfricton here", lambda: by_bodies.dw(by_bodies.z, dfricton=1.0)),
        "arrays": (
            option,
            r"jvp\(\*\*data.changes\(dfriction=…\)\)",
            lambda: of_arrays.jvp(dfriction=1.0),
        ),
        "shape": (
            problem,
            r"dfriction must be a finite array of shape \(3,\), got \(2,\)",
            lambda: by_bodies.jvp(dfriction=[1.0, 2.0]),
        ),
        "bodies' shape": (
            problem,
            r"dvelocities .* shape \(18,\), got \(3, 3\)",
            lambda: by_bodies.jvp(dvelocities=np.ones((3, 3))),
        ),
        "not symmetric": (
            problem,
            "dmass must be symmetric",
            lambda: by_bodies.jvp(dmass=np.tri(18)),
        ),
        "not finite": (
            problem,
            "dgaps must be a finite array",
            lambda: by_bodies.jvp(dgaps=np.nan),
        ),
    }


def test_what_a_derivative_does_not_take_is_said_with_what_it_takes() -> None:
    """A wrong name is an InvalidOption that lists the right ones, a wrong shape an InvalidProblem."""
    for error, words, call in refused().values():
        with pytest.raises(error, match=words):
            call()


def test_gaps_need_a_time_step_and_gaps() -> None:
    """One without the other, another number of gaps, or a step that takes no time is refused in words."""
    body = np.eye(2), [[0, 1]], [[1, 0]]
    for words, wrong in (
        ("time_step is missing", {"gaps": 0.1}),
        ("gaps is missing", {"time_step": 0.1}),
        ("time_step must be a number of seconds > 0, got 0", {"gaps": 0.1, "time_step": 0}),
        (
            r"gaps must be a number, or .* of shape \(1,\).*got shape \(2,\)",
            {"gaps": [0, 0], "time_step": 1},
        ),
    ):
        with pytest.raises(InvalidProblem, match=words):
            LCP.from_contacts(body, 0.5, [0.0, -1.0], **wrong)


def test_more_friction_than_any_material_has_is_warned_of() -> None:
    """μ = 50 is a ModelWarning that says where and what may be meant, at the caller's line; 5 passes in silence."""
    with pytest.warns(
        ModelWarning, match=r"friction\[1\] = 50 is more than 5.*if a percentage, divide by 100"
    ) as told:
        LCP.from_contacts(np.eye(4), [0.5, 50.0], np.zeros((2, 2)))
    assert told[0].filename == __file__
    with pytest.warns(ModelWarning, match=r"friction\[0, 0\] = 30") as told:
        contact_data(np.eye(2), 30.0, np.zeros((4, 1, 2)))
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        LCP.from_contacts(np.eye(4), 5.0, np.zeros((2, 2)))


def test_a_file_does_not_know_what_its_problem_was_made_from(tmp_path: Any) -> None:
    """A saved contact problem is M and q: its derivative takes changes of these, which the data's origin gives."""
    problem = stated(given(0))
    problem.save(tmp_path / "contacts.npz")
    found = derivative(solve(LCP.load(tmp_path / "contacts.npz")))
    with pytest.raises(InvalidOption, match="takes no dfriction here"):
        found.jvp(dfriction=1.0)
    expected = derivative(solve(problem)).jvp(dfriction=1.0)
    assert found.jvp(**problem.origin.changes(dfriction=1.0)) == pytest.approx(expected)
