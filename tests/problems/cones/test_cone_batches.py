"""Batches of small problems over cones: one compiled loop, judged as each by itself."""

from __future__ import annotations

import numpy as np

from lcp_plugin import LCP, ConeProblem, FrictionalContact, Status, derivative, solve, solve_batch


def contacts(count: int, k: int = 4, seed: int = 0) -> list[FrictionalContact]:
    rng = np.random.default_rng(seed)
    J = rng.standard_normal((count, 3 * k, 6))
    W = J @ np.swapaxes(J, 1, 2) + 0.05 * np.eye(3 * k)
    b, mu = rng.standard_normal((count, k, 3)), rng.uniform(0.0, 1.0, (count, k))
    b[:, :, 0] -= 0.5
    return [FrictionalContact(*one) for one in zip(W, b, mu, strict=True)]


def test_a_batch_of_contacts_is_judged_as_by_solve():
    """Every item within the tolerance by its own certificate, open, sticking and sliding, with the answers of solve."""
    problems = contacts(200)
    batch = solve_batch(problems, tolerance=1e-10)
    assert batch.all_solved
    agree = 0
    for problem, answer in zip(problems, batch, strict=True):
        assert answer.status is Status.SOLVED
        assert answer.certificate.relative_residual <= 1e-10
        assert answer.certificate.term_residual <= 1e-10
        np.testing.assert_allclose(answer.w, problem.W @ answer.z + problem.b, atol=1e-12)
        by_itself = solve(problem, tolerance=1e-10)
        agree += bool(np.abs(answer.z - by_itself.z).max() <= 1e-6)
    assert agree >= 190  # others have several answers
    assert "nsgs" in batch[0].explain()
    assert derivative(batch[0]).jvp(dq=np.ones(12)).shape == (12,)


def test_cones_boxes_and_friction_share_a_batch_with_others():
    """Each kind in a loop of its own, what has no loop one by one, all in order."""
    rng = np.random.default_rng(2)
    A = rng.standard_normal((6, 6))
    M = A @ A.T + np.eye(6)
    cones = [("box", [-1.0, 0.0], [1.0, np.inf]), ("second_order", 4)]
    mixed = []
    for contact in contacts(3, k=2, seed=3):
        mixed += [
            contact,
            ConeProblem(M, rng.standard_normal(6), cones),
            LCP(M, rng.standard_normal(6)),
        ]
    batch = solve_batch(mixed)
    assert batch.all_solved
    for problem, answer in zip(mixed, batch, strict=True):
        np.testing.assert_allclose(answer.z, solve(problem).z, atol=1e-6)


def test_what_the_loop_leaves_open_is_solved_by_itself():
    """An item without an answer ends INFEASIBLE with a proof; one that 0 answers is 0; mixed units stay out."""
    hopeless = FrictionalContact(np.diag([0.0, 1.0, 1.0]), [[-1.0, 0.0, 0.0]], 0.5)
    open_one = FrictionalContact(np.eye(3), [[1.0, 0.3, 0.0]], 0.5)
    sliding = FrictionalContact(np.eye(3), [[-1.0, 3.0, 4.0]], 0.5)
    batch = solve_batch([hopeless, open_one, sliding, hopeless])
    assert [status.name for status in batch.status] == [
        "INFEASIBLE",
        "SOLVED",
        "SOLVED",
        "INFEASIBLE",
    ]
    assert batch[0].proof.verify()
    assert not batch[1].z.any()
    np.testing.assert_allclose(batch[2].z, [1.0, -0.3, -0.4], atol=1e-8)


def test_a_start_or_an_algorithm_is_the_callers():
    """A named algorithm solves each problem, and no iteration is made from its solution."""
    problems = contacts(3)
    batch = solve_batch(problems, algorithm="nsgs", tolerance=1e-6)
    assert all(answer.algorithm == "nsgs" for answer in batch)
    again = solve_batch(problems, z0=batch.z, tolerance=1e-6)
    assert [answer.iterations for answer in again] == [0, 0, 0]
    np.testing.assert_array_equal(again.z, batch.z)
