"""Batches: the bits of each problem alone, what is refused, time limits and Ctrl-C."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.small_families import definite_stack, told
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    ConeProblem,
    FrictionalContact,
    InvalidProblem,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    certify,
    solve,
    solve_batch,
    trace,
)

ON_THE_ROAD = ("auto", "newton", "lemke")
SOLVED = (Status.SOLVED, Status.PRECISION_LIMIT)
INF = np.inf


@pytest.mark.quick(1)
@pytest.mark.parametrize("algorithm", [*ON_THE_ROAD, "psor"])
@pytest.mark.parametrize("shared", [False, True])
def test_a_batch_is_what_solve_gives_one_by_one(algorithm, shared):
    """The same bits for any number of threads, and the answers of single solves; M for all or each."""
    M, q = definite_stack(40, 9)
    M = M[0] if shared else M
    batch = solve_batch(M, q, algorithm=algorithm)
    assert batch.all_solved
    for k, threads in enumerate((1, 2, 3, 7)):
        again = solve_batch(M, q, algorithm=algorithm, threads=threads)
        assert again.z.tobytes() == batch.z.tobytes()
        assert again.iterations.tolist() == batch.iterations.tolist()
        one = solve(LCP(M if shared else M[k], q[k]), algorithm)
        assert batch[k].status is batch.status[k] is one.status
        np.testing.assert_allclose(batch.z[k], one.z, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(batch.w[k], one.w, rtol=1e-9, atol=1e-12)
    listed = solve_batch([LCP(M if shared else M[k], q[k]) for k in range(40)], algorithm=algorithm)
    assert listed.z.tobytes() == batch.z.tobytes()


def test_an_editor_completes_the_arrays_of_a_batch():
    """The names of a batch include those of its arrays, before one of them is read, and each array has a type."""
    batches = solve_batch([[1.0]], [[-1.0]]), solve_batch([QuadraticProgram([[1.0]], [-1.0])])
    for batch in batches:
        assert {"x", "status", "iterations"} <= set(dir(batch))
    tables = {name for batch in batches for name in batch._run.tables()}
    assert tables == type(batches[0]).__annotations__.keys()


def test_solve_batch_of_large_problems_gives_blas_one_thread():
    """BLAS has one thread in stacks of problems with more than 128 unknowns, if threadpoolctl is installed."""
    tools, seen = pytest.importorskip("threadpoolctl"), list[int]()
    apart = np.tile([-1.0, 0.1, 0.0], 43)
    with tools.threadpool_limits(2):
        solve_batch(
            [FrictionalContact(np.eye(129), apart, 0.5)] * 2,
            callback=lambda *_: seen.extend(
                one["num_threads"] for one in tools.threadpool_info() if one["user_api"] == "blas"
            ),
        )
    assert set(seen) == {1}


def test_a_bad_problem_costs_that_one_alone():
    """NaN in M, q or a bound, crossed bounds, no solution: in their places, and the others are solved."""
    M, q = definite_stack(8, 4)
    lower, upper = np.zeros((8, 4)), np.full((8, 4), INF)
    M[1, 2, 3], q[2, 0], lower[3, 1], upper[4, 2] = np.nan, INF, np.nan, -1.0
    M[5], q[5] = -np.eye(4), -1.0
    batch = solve_batch(M, q, lower=lower, upper=upper)
    assert sorted(batch.errors) == [1, 2, 3, 4]
    assert all(batch.status[k] is None and np.isnan(batch.z[k]).all() for k in batch.errors)
    assert batch.status[5] is Status.INFEASIBLE
    assert batch[5].infeasibility.verify()
    assert [batch.status[k] for k in (0, 6, 7)] == [Status.SOLVED] * 3
    assert not batch.all_solved
    for k, what in (
        (1, r"M\[2, 3\] = nan"),
        (2, r"q\[0\] = inf"),
        (3, r"lower\[1\] = nan"),
        (4, "upper"),
    ):
        with pytest.raises(InvalidProblem, match=what):
            batch[k]
    assert np.isnan(batch.w[1]).all()
    assert "3 SOLVED" in repr(batch)
    assert "4 invalid" in repr(batch)


@refusals(r"""
solve_batch(*(np.eye(3), None)) → q is missing
solve_batch(*(np.ones((2, 3)), np.ones(3))) → M must have shape \(B, n, n\)
solve_batch(*(np.ones((4, 3, 3)), np.ones((5, 3)))) → equally long, got q 5, M 4
solve_batch(*(np.ones((4, 3, 3)), np.ones((4, 2)))) → q must have shape \(B, n\) or \(n,\), n = 3
solve_batch(*(np.ones((4, 3, 3)), 1.0)) → q must have shape
solve_batch(*(['M'], np.ones(3))) → real numbers|M must
solve_batch([ONE], upper=1.0) → InvalidOption: with_q
solve_batch([ONE], lower=3.0) → InvalidOption: with_q
solve_batch([ONE], lower=[0.0]) → InvalidOption: with_q
solve_batch([ONE], q=[1.0]) → InvalidOption: with_q
solve_batch([ONE, (np.eye(1), [1.0])]) → list of LCPs|write LCP\(M, q\)
solve_batch([(np.eye(2), np.ones(2)), (np.eye(3), np.ones(3))]) → list of LCPs|write LCP\(M, q\)
solve_batch(ONE) → needs many problems, got one LCP.*; write solve_batch
solve_batch(iter([ONE])) → list of LCPs|write LCP\(M, q\)|many problems
solve_batch(np.ones((4, 3, 3)), np.ones((3, 4))) → give its transpose
solve_batch(FIT, np.ones((3, 4))) → give its transpose
solve_batch(FIT, "nnls") → InvalidOption: algorithm=
solve_batch(FIT) → solve_batch\(problem, B\)
solve_batch(FIT, np.ones((4, 3)), algorithm="lemke") → InvalidOption: takes no algorithm
solve_batch(FIT, np.ones((4, 3)), absolute_tolerance=1e-3) → InvalidOption: absolute_tolerance
solve_batch(FIT, np.ones((4, 3)), callback=3) → InvalidOption: callable
solve_batch(QuadraticProgram(np.eye(4), np.ones(4)), np.ones((4, 6))) → give its transpose
solve_batch([QuadraticProgram([[1.0]], [0.0]), 3]) → InvalidProblem: item 1 of the batch: solve_batch needs .* got int
solve_batch(QuadraticProgram(np.eye(2), [0.0, 0.0])) → needs many problems, got one .*; write solve_batch
""")
def test_shapes_that_do_not_fit_are_refused(call, words):
    """Before anything is solved, with what was given and what is needed; what would be ignored is refused."""
    names = {"ONE": LCP([[2.0]], [-5.0]), "FIT": BoundedLeastSquares(np.ones((3, 2)), np.ones(3))}
    assert_refused(call, words, names, InvalidProblem)


def test_batches_of_nothing_of_one_and_of_sparse_matrices():
    """No problem at all, no unknowns, one problem without an axis in front, a sparse M for all, boxes as numbers."""
    assert solve_batch(np.zeros((0, 3, 3)), np.zeros((0, 3))).z.shape == (0, 3)
    assert solve_batch(np.zeros((2, 0, 0)), np.zeros((2, 0))).all_solved
    M, q = definite_stack(6, 5)
    assert solve_batch(M[0], q[0]).z.shape == (1, 5)
    assert "certificate" not in vars(solve_batch([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])[0])  # yet
    chain = sp.diags_array([-np.ones(4), np.full(5, 2.5), -np.ones(4)], offsets=[-1, 0, 1])
    batch = solve_batch(chain, q, upper=0.1, lower=np.full(5, -0.1))
    assert batch.all_solved
    np.testing.assert_allclose(
        batch[3].z, solve(LCP(chain, q[3], lower=-0.1, upper=0.1)).z, atol=1e-12
    )
    with pytest.raises(IndexError, match="6 results"):
        batch[6]
    assert told(batch[-1]) == told(batch[5])


def test_warm_starts_of_a_batch():
    """One for all or one each, outside the bounds too: as solve takes them."""
    M, q = definite_stack(5, 6)
    starts = np.random.default_rng(0).normal(size=(5, 6))
    for algorithm in ON_THE_ROAD:
        each, same = (solve_batch(M, q, z0=z0, algorithm=algorithm) for z0 in (starts, starts[0]))
        for k in range(5):
            for batch, z0 in ((each, starts[k]), (same, starts[0])):
                alone = solve(LCP(M[k], q[k]), algorithm, z0=z0)
                assert batch[k].status is alone.status
                np.testing.assert_allclose(batch[k].z, alone.z, atol=1e-10)


def test_a_batch_is_a_sequence():
    """Slices and negative numbers, as a list has them."""
    M, q = definite_stack(5, 3)
    batch = solve_batch(M, q)
    assert [told(one) for one in batch[1:4:2]] == [told(batch[1]), told(batch[3])]
    with pytest.raises(TypeError):
        batch[1.0]


def test_one_problem_takes_many_q():
    """solve_batch(problem, Q) has the problem's bounds and the answers of solve; a bad row harms no other."""
    problem = LCP(sp.csr_array([[2.0, 1.0], [1.0, 2.0]]), [0.0, 0.0], upper=[1.0, 4.0])
    Q = np.array([[-5.0, 1.0], [np.nan, 0.0], [-3.0, -3.0]])
    batch = solve_batch(problem, Q)
    assert np.isnan(batch.z[1]).all()
    assert set(batch.errors) == {1}
    for k in (0, 2):
        assert np.array_equal(batch.z[k], solve(problem.with_q(Q[k])).z)
    assert solve_batch(problem, Q[2:], upper=np.inf, lower=-1.0).z.round(6).tolist() == [[1.0, 1.0]]


def test_nonlinear_problems_begin_at_their_own_starts():
    """A list of problems with starts as z0: x² = a has two roots, and the start chooses one."""
    problems = [NonlinearProblem(lambda x, a=a: x**2 - a, lower=[-INF]) for a in (1.0, 4.0)]
    answers = solve_batch(problems, z0=[[3.0], [-3.0]])
    assert answers.all_solved
    np.testing.assert_allclose(answers.z.ravel(), [1.0, -2.0], rtol=1e-7)
    assert [answer.z.tolist() for answer in answers] == answers.z.tolist()


CLASSES: dict[str, Any] = {
    "LCP": LCP([[4.0, -1.0], [-1.0, 4.0]], [-3.0, 5.0]),
    "NonlinearProblem": NonlinearProblem(lambda x: x**3 + x - 1, lower=[0.0, 0.0]),
    "BoundedLeastSquares": BoundedLeastSquares(np.eye(3)[:, :2] + 0.5, [1.0, -1.0, 2.0], lower=0),
    "ConeProblem": ConeProblem(np.eye(3), [-1.0, 3.0, 4.0], [("second_order", 3)]),
    "FrictionalContact": FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5),
}


@pytest.mark.parametrize("name", CLASSES)
def test_a_batch_has_the_limits_of_single_solves(name):
    """No iteration solves none of these; the points and statuses of a batch are those of `solve`."""
    problem = CLASSES[name]
    for limit in (0, 1, 100):
        alone = solve(problem, max_iterations=limit)
        batch = solve_batch([problem] * 3, max_iterations=limit)
        assert [*batch.status] == [alone.status] * 3
        assert (alone.status is Status.MAX_ITERATIONS) or limit > 0
        for one in batch:
            np.testing.assert_allclose(one.x, alone.x, atol=1e-9)


def test_the_starts_of_a_batch_choose_among_solutions():
    """The points (0, 1), (1, 0) and (⅓, ⅓) are solutions, and the run stays at each."""
    problem = LCP([[1.0, 2.0], [2.0, 1.0]], [-1.0, -1.0])
    for z0 in ([0.0, 1.0], [1.0, 0.0], [1 / 3, 1 / 3]):
        batch = solve_batch([problem] * 4, z0=[z0] * 4)
        np.testing.assert_allclose(batch.z, [z0] * 4, atol=1e-9)


def test_conditions_of_a_program_have_one_status_alone_and_in_a_batch():
    """At (0, 0, 96) the conditions are proved, and (0, 48, 0) costs 4e-9 less: one status for one and for 40 copies."""
    c = [1.0000000009313226, 1.9999999944120646, 1.0000000009313226]
    P, G = np.diag([2.0**-23, 0, 0]), [[0.0, -2, -1]]
    problems = [LCP.from_qp(P, c, G, [-96.0], lower=0) for _ in range(40)]
    assert {*solve_batch(problems).status} == {solve(problems[0]).status} == {Status.SOLVED}
    z = [0, 0, 96, 1.0]
    assert certify(problems[0], z, tolerance=1e-8).verdict == "proved"
    assert not problems[0].origin.recover(z, tolerance=1e-9).is_solved


def test_objectives_of_a_batch_and_of_a_path_have_the_sense_of_their_programs():
    """A program that maximizes has the objective 5 alone, in a list, with other costs, and along a path."""
    program = QuadraticProgram(2 * np.eye(2), [-2.0, -4], G=[[1.0, 1]], h=[9.0]).replaced(
        sense=-1.0
    )
    assert solve(program).objective == pytest.approx(5.0)
    assert solve_batch([program, program]).objective == pytest.approx(5.0)
    assert solve_batch(program, [[-2.0, -4], [-1, 0]]).objective == pytest.approx([5.0, 0.25])
    assert trace(program, {"c": [1.0, 0]}, 0, 1).at(0.5).objective == pytest.approx(4.5625)


def test_none_as_a_bound_of_a_batch_is_no_bound():
    """As in LCP(M, q, lower=None); without the argument the bounds are 0 and ∞, or those of the problem."""
    M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), [[1.0, -5.0]]
    free = np.linalg.solve(M, -np.array(q[0]))
    for matrices in (M[np.newaxis], M, LCP(M, q[0])):
        np.testing.assert_allclose(solve_batch(matrices, q, lower=None).z[0], free)
        np.testing.assert_allclose(solve_batch(matrices, q).z[0], [0.0, 2.5])
        np.testing.assert_allclose(solve_batch(matrices, q, upper=None).z[0], [0.0, 2.5])
