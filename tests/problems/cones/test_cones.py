"""Complementarity over cones and friction cones: data, criterion, methods, derivative."""

from __future__ import annotations

from itertools import count
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from inputs.cone_families import (
    cancelled_diagonals,
    exact_relative_residual,
    planted_cones,
    planted_contacts,
    tower,
    violation,
)
from inputs.contact_families import rows_of_bodies
from inputs.published_problems import errors_of_contact
from scipy.linalg import block_diag
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    ConeProblem,
    FrictionalContact,
    InvalidProblem,
    LCPError,
    ModelWarning,
    Status,
    UnreadableFile,
    derivative,
    friction_cone,
    load_problem,
    solve,
    solve_batch,
)
from lcp_plugin.problems.cones.certificate import infeasibility_proof
from lcp_plugin.problems.cones.methods import CONE_METHODS

ONE = np.eye(3), [-1.0, 3.0, 4.0], 0.5
FC, CP = FrictionalContact, ConeProblem


@refusals(r"""
FC([[1, 2, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 0], 0.5) → symmetric
FC(*ONE[:2], -0.1) → friction\[0\] = -0.1
FC(*ONE[:2], [0.1, 0.2]) → no multiple|coefficients|shape
FC(np.eye(3), [0, np.nan, 0], 0.1) → b\[1\] = nan
FC(np.eye(3), [[-1, 0, 0]], 0.5, dimension=2) → b has 3 columns and dimension is 2
FC(np.eye(3), np.zeros(6), 0.1, dimension=3) → shape \(6, 6\)
CP(np.eye(3), np.zeros(3), 'second_order') → sequence of
CP(np.eye(3), np.zeros(3), ['nonnegative'])
    → cones\[0\] = 'nonnegative' is a text; write a list of tuples.*\(\"nonnegative\", 3\)
CP(np.eye(2), np.zeros(2), ('box', 0, 1)) → cones\[0\] = 'box' is a text; write a list of tuples
CP(np.eye(3), np.zeros(3), [('second_ordr', 3)]) → second_order
CP(np.eye(3), np.zeros(3), [('second_order', 2)]) → 2 rows and M has 3: too few
CP(np.eye(3), np.zeros(3), [('free', 2.5)]) → integer
CP(np.eye(1), np.zeros(1), [('box', 1.0, 0.0)]) → lower ≤ upper
CP(np.ones((2, 3)), np.zeros(2), [('free', 2)]) → square
""")
def test_bad_input_is_refused_in_words(call, words):
    """The error message contains the invalid value and the requirement."""
    assert_refused(call, words, globals(), InvalidProblem)


@pytest.mark.quick(4)
@pytest.mark.parametrize("seed", range(30))
def test_planted_contacts_are_solved(seed):
    """Open, sticking, sliding and degenerate contacts are SOLVED, with the known impulses."""
    rng = np.random.default_rng(seed)
    problem, r, _ = planted_contacts(
        int(rng.integers(1, 12)), int(rng.integers(1, 6)), 10.0 ** rng.uniform(0, 5), rng
    )
    result = solve(problem)
    assert result.status is Status.SOLVED, result
    assert exact_relative_residual(problem, result.z) <= 1e-8
    definite, r, _ = planted_contacts(3, 3, 10.0, rng, definite=True, most=0.3)
    np.testing.assert_allclose(
        solve(definite, tolerance=1e-10).z, r, atol=1e-12 + 1e-6 * np.abs(r).max()
    )


@pytest.mark.quick(7)
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("name", ["nsgs", "newton", "fixed_point"])
def test_each_method_solves_convex_problems(name, seed):
    """Each method finds the known solution over cones without friction for definite M."""
    problem, _ = planted_cones(4, np.random.default_rng(seed))
    # of an interior point, where cases are on the edge
    tolerance = 1e-3 if name == "fixed_point" else 1e-8
    result = solve(problem, name, tolerance=tolerance)
    assert result.is_solved, result
    assert exact_relative_residual(problem, result.z) <= tolerance


@pytest.mark.parametrize("name", CONE_METHODS)
def test_each_method_solves_a_contact_that_slides(name):
    """The impulse that friction allows, against the push."""
    result = solve(FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5), name)
    assert result.is_solved
    np.testing.assert_allclose(result.z, [1.0, -0.3, -0.4], atol=1e-7)


@pytest.mark.quick(3)
@pytest.mark.parametrize("seed", range(40))
def test_the_certificate_bounds_the_exact_residual(seed):
    """The certificate bounds the residual in 60 digits from above, up to rounding error; contacts have two laws."""
    rng = np.random.default_rng(seed)
    problem = planted_contacts(4, 3, 1e4, rng)[0] if seed % 2 else planted_cones(4, rng)[0]
    near = solve(problem, tolerance=1e-12).z
    for z in (
        near,
        near * (1.0 + 1e-9),
        near + 1e-6 * rng.standard_normal(near.size),
        rng.standard_normal(near.size),
    ):
        certificate = solve(problem, z0=z, max_iterations=0).certificate
        point = certificate.z
        exact = float(exact_relative_residual(problem, point))
        assert exact <= certificate.relative_residual
        assert certificate.relative_residual <= exact * (1.0 + 1e-9) + 1e-9


def test_components_have_their_own_references():
    """A light contact has a reference of its own next to a heavy contact that it does not touch."""
    problem = FrictionalContact(np.eye(6), [-1e10, 0.0, 0.0, -0.5, 0.0, 0.0], 0.5, dimension=3)
    certificate = solve(problem, z0=[1e10, 0, 0, 0.6, 0, 0], max_iterations=0).certificate
    assert certificate.relative_residual == pytest.approx(0.2)
    assert certificate.worst_index == 1


@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0])
def test_a_block_slides_against_its_impulse(friction):
    """Every contact has r_T = −μ r_N u_T/‖u_T‖ if the push exceeds friction, else u_T = 0."""
    for angle in np.linspace(0.0, 6.0, 13):
        push = np.array([np.cos(angle), np.sin(angle)])
        result = solve(FrictionalContact(np.eye(3), [-1.0, *push], friction), tolerance=1e-12)
        assert result.require_solved()
        expected = -min(friction, 1.0) * push
        np.testing.assert_allclose(result.z, [1.0, *expected], atol=1e-11)
        assert result.motion.sticks.tolist() == [friction >= 1.0]


def test_in_the_plane_friction_is_an_lcp():
    """The cone is a pyramid in two dimensions, so the impulses agree with LCP.from_contacts."""
    rng = np.random.default_rng(1)
    for _ in range(10):
        J = rng.standard_normal((6, 9))
        W, b = J @ J.T, rng.standard_normal((3, 2)) - [1.0, 0.0]
        lcp = LCP.from_contacts(W, 0.4, b)
        result = solve(FrictionalContact(W, b, 0.4), tolerance=1e-10)
        motion = lcp.origin.recover(solve(lcp, tolerance=1e-10))
        np.testing.assert_allclose(result.motion.normal, motion.normal, atol=1e-7)
        np.testing.assert_allclose(result.motion.tangential, motion.tangential, atol=1e-7)


def test_a_warm_start_ends_at_once():
    """A run from its solution takes no step; from a nearby solution it takes a few."""
    problem, _, _ = planted_contacts(10, 5, 10.0, np.random.default_rng(3))
    first = solve(problem)
    assert solve(problem, z0=first.z).iterations == 0
    nearby = problem.with_q(problem.b * (1.0 + 1e-4))
    assert solve(nearby, z0=first.z).iterations <= 10


@refusals(r"""
ConeProblem(np.eye(4), -np.ones(4), [('box', np.zeros((2, 2)), np.ones((2, 2)))])
    → shapes \(2, 2\) and \(2, 2\); write np.ravel\(lower\)
ConeProblem(np.eye(4), -np.ones(4), [('box', np.zeros(2), np.ones(3))])
    → shapes \(2,\) and \(3,\); write .* of one length
ConeProblem(np.eye(4), -np.ones(4), [('box', 'low', 1.0)])
    → lower and upper of cones\[0\] must be real numbers or vectors of the box's rows, got text entries
ConeProblem(np.eye(4), -np.ones(4), [('box', np.full(4, np.nan), 1.0)]) → lower of cones\[0\] must not hold NaN
ConeProblem(np.eye(4), -np.ones(4), [('second_order', np.inf)]) → must name an integer of rows
""")
def test_a_cone_of_a_wrong_shape_is_told_what_to_write(call, words):
    """Never an exception of numpy's, nor a box of as many rows as both shapes make together."""
    assert_refused(call, words, {})


def test_a_file_over_cones_is_not_taken_for_an_lcp(tmp_path):
    """LCP.load rejects the file, and the message names the problem class and load_problem."""
    contact, _, _ = planted_contacts(2, 3, 10.0, np.random.default_rng(0))
    cones = ConeProblem(np.eye(3), [-1.0, 0.0, 0.0], [("second_order", 3)])
    for problem, words in ((contact, "a FrictionalContact"), (cones, "a ConeProblem")):
        problem.save(tmp_path / "p.npz")
        with pytest.raises(LCPError, match=rf"{words}.*load_problem\(path\) reads it"):
            LCP.load(tmp_path / "p.npz")
    with pytest.raises(LCPError, match="npz"):
        contact.save(tmp_path / "p.nl")


SQUEEZED = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
LOW = np.random.default_rng(3).standard_normal((24, 3))  # L Lᵀ is singular up to rounding
HOPELESS: dict[str, Any] = {
    "nothing moves the normal": FrictionalContact(np.diag([0.0, 1.0, 1.0]), [-1.0, 0.2, 0.0], 0.5),
    "between two walls that close": FrictionalContact(
        SQUEEZED @ SQUEEZED.T, [-1.0, 0, 0, -1.0, 0, 0], 0.5, dimension=3
    ),
    "beside one that slides": FrictionalContact(
        np.diag([1.0, 1, 1, 0, 1, 1]), [-1.0, 3, 4, -1.0, 0, 0], 0.5, dimension=3
    ),
    "no M": ConeProblem(np.zeros((3, 3)), [-1.0, 0.0, 0.0], [("second_order", 3)]),
    "J Jᵀ, contacts": FrictionalContact(
        LOW @ LOW.T, np.tile([-2.0, 0.3, -0.1], 8), 0.5, dimension=3
    ),
    "J Jᵀ, cones": ConeProblem(
        LOW[6:12, :2] @ LOW[6:12, :2].T, [-2.0, 1, 0, -2.0, 0, -1], [("second_order", 3)] * 2
    ),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", HOPELESS)
def test_what_has_no_answer_is_proved_infeasible(name):
    """INFEASIBLE with a proof that verifies, and whose margin no point is below."""
    problem = HOPELESS[name]
    result = solve(problem)
    assert result.status is Status.INFEASIBLE, result
    assert result.proof.verify()
    assert str(result.proof) in result.explain()
    rng = np.random.default_rng(0)
    for size in (0.0, 1.0, 10.0, 1e6):
        z = size * rng.standard_normal(problem.n)
        assert (
            solve(problem, z0=z, max_iterations=0).certificate.relative_residual
            >= result.proof.margin
        )
    assert solve(problem, prove_infeasibility=False).status is not Status.INFEASIBLE


def test_contacts_whose_normals_oppose_are_infeasible_in_any_units():
    """Two gaps whose rates sum to a negative number for any impulses have a proof, in any units of W and b."""
    rng = np.random.default_rng(1)
    for _ in range(8):
        H, b = rng.standard_normal((12, 8)), rng.standard_normal(12)
        H[3] = -H[0]
        b[3] = -b[0] - abs(rng.standard_normal())
        W = 2.0**22 * (H @ H.T)
        result = solve(FrictionalContact((W + W.T) / 2, 2.0**-23 * b, np.full(4, 0.5)))
        assert result.status is Status.INFEASIBLE, result
        assert result.proof.verify()


@pytest.mark.parametrize("name", ["J Jᵀ, contacts", "J Jᵀ, cones"])
def test_a_multiplier_that_rounding_spoils_is_not_a_proof(name):
    """Rounded multipliers of Clarabel do not verify for a singular M; the proof that is returned does."""
    with np.errstate(all="ignore"):
        assert infeasibility_proof(HOPELESS[name]).verify()


def test_a_result_tells_of_its_contacts():
    """The explanation counts open, sticking and sliding contacts and contains the dissipation."""
    told = solve(
        FrictionalContact(np.eye(6), [-1.0, 3.0, 4.0, 1.0, 0.0, 0.0], 0.5, dimension=3)
    ).explain()
    assert (
        "2 contacts: 1 open, 0 stick, 1 slide; friction and impact take 2.875 J in SI units" in told
    )  # ½·26 − ½·4.5²


def test_other_velocities_of_contacts_do_not_tell_those_of_bodies():
    """With another q the body velocities are None, because the old velocities would be wrong."""
    block = 2.0 * np.eye(3), [[0.0, 0.0, 1.0]], [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]
    problem = FrictionalContact(block, [1.0, 0.0, -1.0], 0.1)
    assert solve(problem).motion.body_velocities is not None
    other = solve(problem.with_q([4.0, 0.0, 0.0]))
    assert other.motion.body_velocities is None
    assert other.motion.separation == pytest.approx([4.0])


def test_pyramids_of_many_edges_come_near_to_the_cone():
    """64 edges give bodies and gaps nearly the velocities of the cone."""
    bodies = (np.diag([2.0] * 3), [[0.0, 0.0, 1.0]], [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    friction = 0.4
    velocities = [1.0, 2.0, -3.0]
    exact = FrictionalContact(bodies, velocities, friction, gaps=0.01, time_step=0.1)
    moved = solve(exact, tolerance=1e-12).require_solved().motion.body_velocities
    speed = np.hypot(1.0, 2.0)
    np.testing.assert_allclose(
        moved[:2], np.array([1.0, 2.0]) * (1.0 - 0.4 * 2.9 / speed), atol=1e-9
    )
    pyramid = LCP.from_contacts(bodies, friction, velocities, 64, gaps=0.01, time_step=0.1)
    assert isinstance(pyramid, LCP)
    near = pyramid.origin.recover(solve(pyramid).require_solved()).body_velocities
    assert 0.0 < np.abs(near - moved).max() < 0.1


def test_the_answer_is_in_the_cone_where_a_diagonal_cancels():
    """The scale ignores rounding error in a block's diagonal: z is in K, and w in K*."""
    M = [[0.2, -0.5, 0.7], [0.0, 0.0, 0.5], [-0.7, 0.6, -0.2 + 2.0**-54]]
    problem = ConeProblem(M, [1.1, -1.2, 1.2], [("second_order", 3)])
    result = solve(problem)
    assert result.is_solved
    assert result.z[0] > 1.0
    assert violation(problem, result.z) <= 1e-7


def test_a_small_residual_with_another_case_is_solved_on():
    """Diagonal entries of 1e-6 and 1e-9: z_1 was 2.8 times the right one, with a relative residual of 1e-9."""
    M = [[1e-6, 1.0, 0.0], [-1.0, 1.0, -1.0], [0.0, 1.0, 1e-9]]
    problem = ConeProblem(
        M, [-1000001.0, 1000001.0, -1000001.001], [("nonnegative", 1), ("second_order", 2)]
    )
    result = solve(problem)
    assert result.is_solved
    assert result.z == pytest.approx([1e6, 1e6, 1e6], rel=1e-9)


def test_solved_means_solved_where_diagonals_cancel(draws):
    """Cones over small M that are not monotone: what is called SOLVED is so in 50 digits, block by block."""
    solved = 0
    for seed in draws(60):
        problem = cancelled_diagonals(np.random.default_rng(seed))
        result = solve(problem, max_iterations=100, prove_infeasibility=False)
        solved += result.is_solved
        assert not result.is_solved or violation(problem, result.z) <= 1e-6, seed
    assert solved >= len(draws(60)) // 4


AMBIGUOUS: dict[str, Any] = {
    "FrictionalContact": lambda n, **options: FrictionalContact(
        np.eye(n), np.tile([-1.0, 0.5], n // 2), 0.3, **options
    ),
    "worlds": lambda n, **options: FrictionalContact.worlds(
        np.eye(n), np.tile([-1.0, 0.5], (2, n // 2)), 0.3, **options
    )[0],
    "friction_cone": lambda n, **options: friction_cone(cp.Variable(n), 0.3, **options),
}


@pytest.mark.parametrize("door", AMBIGUOUS)
def test_contacts_of_the_plane_or_of_space_are_not_guessed_silently(door):
    """6, 12 and 18 rows with one number μ cause a ModelWarning; `dimension`, an array μ or 4 rows decide."""
    build = AMBIGUOUS[door]
    for n in (6, 12, 18):
        words = (
            f"read as {n // 3} contacts in space, not as {n // 2} in the plane; pass dimension=2"
        )
        with pytest.warns(ModelWarning, match=words):
            build(n)
        for d in (2, 3):
            build(n, dimension=d)
    if door == "FrictionalContact":
        found = solve(build(6, dimension=2)).z
        np.testing.assert_allclose(found, [1.0, -0.3] * 3, atol=1e-7)
        same = FrictionalContact(np.eye(6), [-1.0, 0.5] * 3, np.full(3, 0.3))
        np.testing.assert_array_equal(solve(same).z, found)
    build(4)


def together(*problems: FrictionalContact) -> FrictionalContact:
    """Return groups of contacts without common bodies as one problem."""
    W = sp.block_diag([problem.rows.csr for problem in problems], format="csr")
    b, mu = (np.concatenate([getattr(one, name) for one in problems]) for name in ("b", "friction"))
    return FrictionalContact(W, b, mu)


@pytest.mark.quick(1)
@pytest.mark.parametrize("seeds", [(0, 2), (4, 6), (7, 8), (11, 13), (14, 15)])
def test_groups_of_contacts_are_right_each(seeds):
    """Two groups of 70 contacts with velocities 1 : 1e-7 are SOLVED together."""
    rngs = [np.random.default_rng(seed) for seed in seeds]
    groups = [planted_contacts(70, int(rng.integers(3, 15)), 1e3, rng)[0] for rng in rngs]
    groups[1] = groups[1].with_q(1e-7 * groups[1].b)
    result = solve(together(*groups))
    assert result.is_solved
    for problem, r in zip(groups, np.split(result.z, [groups[0].n]), strict=True):
        data = {"M": problem.rows.csr, "q": problem.b, "mu": problem.friction}
        assert errors_of_contact(data, r) <= 1e-6


def test_one_group_without_an_answer_makes_all_infeasible():
    """One contact that nothing opens makes the problem INFEASIBLE, with a proof."""
    good = planted_contacts(5, 4, 1e3, np.random.default_rng(0))[0]
    problem = together(good, FrictionalContact(np.diag([0.0, 1.0, 1.0]), [-1.0, 0.2, 0.0], 0.5))
    result = solve(problem)
    assert result.status is Status.INFEASIBLE
    assert result.proof.problem is problem
    assert result.proof.verify()
    limited = solve(problem, max_iterations=20)
    assert limited.status is Status.MAX_ITERATIONS
    assert limited.iterations <= 20
    assert violation(good, limited.z[: good.n]) <= 1e-6


def test_a_row_on_the_edge_has_one_sided_derivatives():
    """A row with z = w = 0 in a half-line is degenerate, with one-sided derivatives."""
    found = derivative(solve(ConeProblem([[2, 1], [1, 2]], [-1, -2], [("nonnegative", 2)])))
    assert found.degenerate.tolist() == [0]
    np.testing.assert_allclose(found.jvp(dq=[-1.0, 0.0]), [2.0 / 3.0, -1.0 / 3.0], rtol=1e-12)
    np.testing.assert_array_equal(found.jvp(dq=[1.0, 0.0]), [0.0, 0.0])


EDGES: dict[str, Any] = {  # μ, z, w; without μ a second-order cone
    "the apex": (None, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "the boundary, at rest": (None, [1.0, 0.6, -0.8], [0.0, 0.0, 0.0]),
    "the apex, and w on the boundary": (None, [0.0, 0.0, 0.0], [1.25, 0.75, 1.0]),
    "a contact that grazes": (0.5, [0.0, 0.0, 0.0], [0.0, 0.3, 0.4]),
    "a contact about to close": (0.5, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "a contact about to slide": (0.5, [1.0, 0.3, -0.4], [0.0, 0.0, 0.0]),
    "no friction, grazing": (0.0, [0.0, 0.0, 0.0], [0.0, 0.3, 0.4]),
    "no friction, at rest": (0.0, [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("name", EDGES)
def test_derivatives_on_an_edge_are_one_sided_differences(name):
    """The jvp equals one-sided differences in every direction, and names a degenerate block."""
    mu, z, w = EDGES[name]
    for seed in range(6):
        rng = np.random.default_rng(seed)
        A, dq, step = rng.standard_normal((3, 3)), rng.standard_normal(3), 1e-7
        M = 0.3 * A @ A.T + np.eye(3)
        q = np.array(w) - M @ z

        def answer(of_q, M=M):
            cone = (
                ConeProblem(M, of_q, [("second_order", 3)])
                if mu is None
                else FrictionalContact(M, of_q, mu)
            )
            return solve(cone, tolerance=1e-13)

        found, moved = derivative(answer(q)), answer(q + step * dq).z
        np.testing.assert_allclose(found.jvp(dq=dq), (moved - z) / step, atol=1e-5)
        assert found.degenerate.tolist() == ([] if name == "no friction, at rest" else [0])


def test_a_contact_close_to_its_limit_of_friction_sticks():
    """5e-7 below μ r_N the impulse follows the push; beyond the limit it would not."""
    problem = FrictionalContact(np.eye(3), [-1.0, 0.5 * (1.0 - 5e-7), 0.0], 0.5)
    found = derivative(solve(problem))
    np.testing.assert_allclose(found.jvp(dq=[0.0, 1.0, 0.0]), [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.vjp([0.0, 1.0, 0.0]).q, [0.0, -1.0, 0.0], atol=1e-12)
    assert not found.degenerate.size


@pytest.mark.parametrize("seed", range(5))
def test_friction_at_the_limit_of_sticking_has_one_sided_derivatives(seed):
    """Less friction moves contacts that hold with all of it, more friction moves none: as differences."""
    rng = np.random.default_rng(seed)
    B, mu, n = rng.normal(size=(6, 6)), rng.integers(1, 8, 2) / 8.0, rng.integers(1, 5, 2)
    z = np.array([n[0], mu[0] * n[0], 0.0, n[1], 0.6 * mu[1] * n[1], 0.8 * mu[1] * n[1]])
    W = [np.eye(6), B @ B.T + np.eye(6)][seed % 2]
    found = derivative(solve(FrictionalContact(W, -W @ z, mu)))
    for dmu in ([-1.0, 0.5], [0.3, -2.0], [1.0, 1.0], [-1.0, -1.0]):
        moved = FrictionalContact(W, -W @ z, mu + 1e-7 * np.array(dmu))
        step = (solve(moved, tolerance=1e-13).z - z) / 1e-7
        np.testing.assert_allclose(
            found.jvp(dfriction=dmu), step, atol=1e-4 * (1 + abs(step).max())
        )


@pytest.mark.parametrize("unit", [1.0, 1e-170, 1e170])
def test_a_sliding_contact_of_any_size_has_a_derivative(unit):
    """Squares may leave the range of doubles: 1e±170 times the velocities makes 1e±170 times the derivative."""
    result = solve(FrictionalContact(np.eye(3), unit * np.array([-1.0, 3.0, 4.0]), 0.5))
    assert not result.motion.sticks[0]
    np.testing.assert_allclose(
        derivative(result).jvp(dfriction=0.1) / unit, [0.0, -0.06, -0.08], atol=1e-15
    )


def test_a_fast_slide_in_a_small_step_is_judged_by_its_own_rounding():
    """With μ‖u_T‖ = 27 nearly canceling in R and a reference of 2e-5, few steps suffice."""
    W = np.array([[3.128, -2.472], [-2.472, 3.872]])
    for algorithm in ("auto", "newton", "nsgs", "interior_point", "fixed_point"):
        result = solve(
            FrictionalContact(W, [-9.81e-5, -55.0], 0.5, dimension=2), algorithm
        ).require_solved()
        assert result.iterations <= 30
        assert exact_relative_residual(result.problem, result.z) <= 1e-8


def test_what_rounding_limits_ends_after_one_look():
    """If the slack at 0 leaves the dual cone by 1e-8 of its size, the run ends without restarts."""
    M, q = np.array([[5.0, 5.0], [5.0, 10.0]]), [1.0, -1.0 - 1e-8]
    alone = solve(ConeProblem(M, q, [("second_order", 2)]))
    both = (
        block_diag(M, np.eye(3)),
        [*q, 0.0, -2.0, 0.0],
        [("second_order", 2), ("second_order", 3)],
    )
    beside = solve(ConeProblem(*both))
    for result in (alone, beside):
        assert result.status is Status.PRECISION_LIMIT
        assert result.iterations <= 30
        np.testing.assert_allclose(result.z[:2], 4e-10, rtol=1e-5)


def poured(count: int, seed: int) -> tuple[Any, Any, Any, Any]:
    """The mass matrix, normals, tangents and velocities of bodies that fall into three times as many contacts."""
    rng = np.random.default_rng(seed)
    J = rows_of_bodies(3 * count, count, rng)
    blocks = rng.standard_normal((count, 6, 6))
    mass = sp.block_diag(
        [sp.csr_array(np.eye(6) + 0.1 * (block + block.T) / 6.0) for block in blocks], format="csr"
    )
    tangents = np.arange(len(J)) % 3 > 0
    return (
        mass,
        sp.csr_array(J[~tangents]),
        sp.csr_array(J[tangents]),
        -np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], count),
    )


@pytest.mark.full  # half a minute of compilation
@pytest.mark.parametrize("seed", range(4))
def test_an_answer_of_bodies_is_one_of_their_contacts(seed):
    """A solution in the velocities of bodies is also one for W only, from cold and warm starts."""
    *contacts, velocities = poured(30, seed)
    found = solve(FrictionalContact(tuple(contacts), velocities, 0.4)).require_solved()
    again = solve(
        FrictionalContact(tuple(contacts), 1.001 * velocities, 0.4), z0=found.z
    ).require_solved()
    for result in (found, again):
        alone = FrictionalContact(result.problem.W, result.problem.b, 0.4, dimension=3)
        assert solve(alone, z0=result.z, max_iterations=0).is_solved


SLIDES = np.array([-1.0, 3.0, 4.0])


@pytest.mark.parametrize("seed", range(6))
def test_components_are_those_of_the_pattern(seed):
    """Blocks in order, permuted, sparse, with stored zeros between them: one status, residuals by components."""
    rng = np.random.default_rng(seed)
    groups = [planted_contacts(count, 2, 10.0, rng)[0] for count in (2, 3, 1)]
    groups[1] = groups[1].with_q(1e-6 * groups[1].b)
    whole = together(*groups)
    W, b, mu = whole.rows.csr.toarray(), whole.b, whole.friction
    order = rng.permutation(6)
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    full = sp.csr_array(
        (W.ravel(), np.tile(np.arange(18), 18), np.arange(0, 325, 18)), shape=(18, 18)
    )
    problems = (
        FrictionalContact(W, b, mu),
        FrictionalContact(sp.csr_array(W), b, mu),
        FrictionalContact(full, b, mu),
        FrictionalContact(W[np.ix_(rows, rows)], b[rows], mu[order]),
    )
    z = np.zeros(18)
    z[6] = 1e-3 * np.abs(b).max()
    wrong = {
        solve(one, z0=at, max_iterations=0).status
        for one, at in zip(problems, (z, z, z, z[rows]), strict=True)
    }
    assert wrong == {Status.MAX_ITERATIONS}
    for problem in problems:
        assert exact_relative_residual(problem, solve(problem).require_solved().z) <= 1e-8


HUGE = [1e-160, 1e160, 1e308]


@pytest.mark.parametrize("entry", HUGE)
@pytest.mark.parametrize("where", ["W", "b", "W of another", "b of another", "z0"])
def test_numbers_at_the_ends_of_the_range_are_never_falsely_solved(entry, where):
    """Alone or next to numbers of size 1, coupled or not: SOLVED only within the tolerance, with 60 digits."""
    W, b = np.eye(6), np.concatenate([SLIDES, SLIDES])
    if where.startswith("W"):
        W[:3, :3] *= entry
        W[0, 3] = W[3, 0] = 0.0 if "another" in where else min(entry, 1e-3)
    elif where.startswith("b"):
        b[:3] *= entry / 8.0
        W[0, 3] = W[3, 0] = 0.0 if "another" in where else 0.1
    z0 = np.full(6, entry) if where == "z0" else None
    cones = [("second_order", 3)] * 2
    with np.errstate(all="ignore"):
        problems = [FrictionalContact(W, b, 0.5, dimension=3), ConeProblem(W, b, cones)]
        for problem in problems:
            result = solve(problem, z0=z0, max_iterations=300)
            if result.is_solved:
                assert np.isfinite(result.z).all()
                assert exact_relative_residual(problem, result.z) <= 1e-8
        batch = solve_batch(
            FrictionalContact.worlds(W[None], b[None], 0.5, dimension=3), max_iterations=300
        )
        for result in batch:
            assert not result.is_solved or exact_relative_residual(result.problem, result.z) <= 1e-8


def test_more_friction_than_a_solution_has_is_never_falsely_solved():
    """Coefficients of 1000, which may jam any contact, give a correct status."""
    W = [[3.0, -1.0, 0.0], [-1.0, 1.0, -1.0], [0.0, -1.0, 2.0]]
    with pytest.warns(ModelWarning):
        problem = FrictionalContact(W, [-3.0, 1.0, 1.0], 1000.0)
    result = solve(problem)
    assert result.status in (Status.STALLED, Status.SOLVED, Status.PRECISION_LIMIT)
    if result.is_solved:
        assert exact_relative_residual(problem, result.z) <= 1e-8


def test_components_that_are_solved_alone_are_seen_by_the_callback():
    """The callback receives samples and points of the entire problem, and ends the run."""
    rngs = [np.random.default_rng(seed) for seed in (0, 2)]
    groups = [planted_contacts(70, int(rng.integers(3, 15)), 1e3, rng)[0] for rng in rngs]
    groups[1] = groups[1].with_q(1e-7 * groups[1].b)
    problem, seen = together(*groups), list[tuple[int, Any]]()
    result = solve(
        problem, record=True, callback=lambda sample, z: seen.append((sample.iteration, z.copy()))
    )
    assert result.is_solved
    assert [len(z) for _, z in seen] == [problem.n] * len(seen)
    assert max(iteration for iteration, _ in seen) == result.iterations > 30
    assert result.history[-1].iteration > 30
    ended = solve(problem, callback=lambda sample, z: sample.iteration >= 25)
    assert ended.status is Status.INTERRUPTED
    assert solve(problem).z.tobytes() == result.z.tobytes()


def test_warm_steps_of_a_pile_obey_their_limit(monkeypatch):
    """A limit that is over at the second look ends 17 steps from a bad start, with the best point so far."""
    *contacts, velocities = poured(60, 0)
    problem = FrictionalContact(tuple(contacts), velocities, 0.4)
    monkeypatch.setattr("lcp_plugin.core.deadline.time.perf_counter", count().__next__)
    result = solve(problem, z0=np.full(problem.n, 1e3), max_seconds=1.5, tolerance=1e-15)
    assert result.status is Status.MAX_SECONDS
    assert result.iterations <= 2
    assert np.isfinite(result.z).all()


def test_gaps_next_to_w_are_as_next_to_bodies():
    """For W in few digits, sparse, b flat: gap / time step is added, W is unchanged."""
    W = np.eye(6)
    W[0, 3], W[3, 0] = 0.1, 0.101
    b, gaps = np.concatenate([SLIDES, SLIDES]), [0.01, 0.0]
    for given in (W, sp.csr_array(W)):
        for velocities in (b, b.reshape(2, 3)):
            problem = FrictionalContact(
                given, velocities, 0.5, gaps=gaps, time_step=0.1, dimension=3
            )
            np.testing.assert_allclose(problem.b, b + 0.1 * np.eye(6)[0])
            assert problem.W[3, 0] == 0.101
            assert sp.issparse(problem.W) or not sp.issparse(given)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"shape": [np.inf, 4]}, "shape must hold integers"),
        ({"indices": [np.nan, 1, 2, 3]}, "indices must hold integers"),
        ({"indices": [9, 1, 2, 3]}, "no valid CSR"),
        ({"cone_kinds": [-1, 1]}, r"cone_kinds must be 0 to 3, got \[-1, 1\]"),
        ({"cone_kinds": [3]}, "states no ConeProblem"),
        ({"cone_rows": [-3, 7]}, "rows ≥ 0"),
        ({"cone_kinds": [2, 1], "lower": [0.0]}, "must have an entry per row"),
        ({"data": None}, "lacks the keys"),
    ],
)
def test_a_damaged_file_over_cones_is_told_what_is_wrong(changed, words, tmp_path):
    """Invalid shapes, indices, types and row numbers in a file raise UnreadableFile."""
    ConeProblem(np.eye(4), -np.ones(4), [("second_order", 3), ("nonnegative", 1)]).save(
        tmp_path / "p.npz"
    )
    with np.load(tmp_path / "p.npz") as file:
        content = {**file, **changed}
    np.savez(
        tmp_path / "p.npz",
        **{name: np.array(value) for name, value in content.items() if value is not None},
    )
    with pytest.raises(UnreadableFile, match=words):
        load_problem(tmp_path / "p.npz")


@pytest.mark.parametrize(
    ("heavy", "light", "corners", "has_foot"),
    [(1e6, 2, (0.0,), True), (1e6, 10, (-0.5, 0.5), False), (1e8, 5, (-0.5, 0.5), True)],
)
def test_heavy_stands_on_light(heavy, light, corners, has_foot):
    """Each face of a tower of heavy and light boxes carries the weight above the face."""
    problem, weights = tower([heavy] * has_foot + [1.0] * light + [heavy], corners)
    result = solve(problem)
    carried = result.motion.normal.reshape(len(weights), -1).sum(axis=1)
    np.testing.assert_allclose(carried, weights, rtol=1e-5 if heavy < 1e8 else 1e-4)
    assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT)
    assert result.is_solved or heavy == 1e8
