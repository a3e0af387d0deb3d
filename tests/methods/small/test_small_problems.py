"""The compiled road of small problems, and batches: the same answers as step by step, one by one, and the long way."""

from __future__ import annotations

import signal
import threading
import warnings
from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from collection.truth import ExactData
from small_families import FAMILIES, problem

import lcp_plugin.methods.small.small_dense as small_dense
from lcp_plugin import LCP, Certificate, InvalidProblem, Result, Status, march, solve, solve_batch, solve_many
from lcp_plugin.core.errors import ConvergenceWarning, InvalidOption
from lcp_plugin.problems.batches import batch_run
from lcp_plugin.problems.many import chunks as sharing

ON_THE_ROAD = ("auto", "newton", "lemke")
SOLVED = (Status.SOLVED, Status.PRECISION_LIMIT)
INF = np.inf


def draw(family: str, count: int, largest: int = 20) -> list[LCP]:
    """Problems of a family."""
    rng = np.random.default_rng(list(FAMILIES).index(family))
    return [problem(family, largest, rng) for _ in range(count)]


def definite(count: int, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A stack of positive definite matrices and right-hand sides."""
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(count, n, n))
    return B @ B.transpose(0, 2, 1) / n + 0.5 * np.eye(n), rng.normal(size=(count, n))


def told(result: Result) -> tuple[Any, ...]:
    """All that watching a run must not change."""
    return (
        result.z.tobytes(), result.w.tobytes(), result.status, result.iterations, result.work, result.algorithm,
        result.stages, result.residual,
    )


# --- One by one --------------------------------------------------------------------------------------------------


@pytest.mark.sampled
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("algorithm", ON_THE_ROAD)
def test_watching_a_run_changes_nothing(family: str, algorithm: str) -> None:
    """With record or a callback the same bits, iterations, work and stages, for cold and warm starts and limits."""
    rng = np.random.default_rng(0)
    for k, drawn in enumerate(draw(family, 6, 9)):
        z0 = None if k % 3 else rng.normal(size=drawn.n)
        limit = {} if k % 4 else {"max_iterations": k % 5}
        alone = solve(drawn, algorithm, z0=z0, **limit)
        watched = solve(drawn, algorithm, z0=z0, record=True, **limit)
        called = solve(drawn, algorithm, z0=z0, callback=lambda sample, z: False, **limit)
        assert told(alone) == told(watched) == told(called)
        assert alone.certificate.relative_residual == Certificate.of(drawn, alone.z).relative_residual


@pytest.mark.parametrize("family", FAMILIES)
def test_the_roads_agree(family: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the compiled road solves is no lie, by exact arithmetic, and the long road refutes none of it."""
    for drawn in draw(family, 12, 8):
        short = solve(drawn)
        if short.status is Status.SOLVED:
            assert not ExactData(drawn).is_lie(short.z, 1e-8)
        with monkeypatch.context() as patch:
            patch.setattr(small_dense, "COMPILED_UP_TO", 0)
            patch.setattr(small_dense, "COMPILED_SPARSE_UP_TO", 0)
            long = solve(LCP(drawn.M, drawn.q, lower=drawn.lower, upper=drawn.upper))
        assert (short.status in SOLVED) == (long.status in SOLVED)


@pytest.mark.parametrize("n", [1, 2, 5, 17, 60, 128, 256])
def test_a_planted_solution_is_found_at_once(n: int) -> None:
    """z* and w* chosen first, bounds on both sides and free rows among them; M definite, or triangular and P."""
    rng = np.random.default_rng(n)
    for matrix in (definite(1, n, n)[0][0], np.tril(rng.normal(size=(n, n)), -1) / n + np.eye(n)):
        lower = np.where(rng.random(n) < 0.1, -INF, np.where(rng.random(n) < 0.3, -1.0, 0.0))
        upper = np.where(rng.random(n) < 0.4, np.maximum(lower, 0.0) + 1.0, INF)
        side = rng.integers(0, 3, n)
        side[(side == 0) & (lower == -INF)] = 1
        side[(side == 2) & (upper == INF)] = 1
        inside = np.maximum(np.minimum(lower, upper), -0.5) + 0.25
        z = np.select([side == 0, side == 2], [lower, upper], inside)
        w = np.select([side == 0, side == 2], [1.0, -1.0], 0.0)
        result = solve(LCP(matrix, w - matrix @ z, lower=lower, upper=upper))
        assert result.status is Status.SOLVED
        np.testing.assert_allclose(result.z, z, atol=1e-7)
        assert {stage.name for stage in result.stages} <= {"npsor", "newton", "lemke"}
        assert result.setup_seconds == 0.0


def test_a_degenerate_path_does_not_cycle() -> None:
    """Ties on every pivot (Kostreva's matrix, and games of chance with q = −1): the order of the rows decides."""
    kostreva = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])
    assert solve(LCP(kostreva, [-1.0, -1.0, -1.0]), "lemke").z == pytest.approx([1 / 3] * 3)
    rng = np.random.default_rng(3)
    for _ in range(200):
        n = int(rng.integers(3, 12))
        M = rng.integers(0, 2, (n, n)) + np.diag(rng.integers(1, 3, n)).astype(float)  # strictly copositive
        result = solve(LCP(M, rng.integers(-1, 1, n).astype(float)), "lemke")
        assert result.is_solved
        assert result.iterations <= 1


def test_a_warm_start_costs_no_more_iterations_than_a_cold_one() -> None:
    """In a sequence of near problems the last answer's active set is the next one's, or near it."""
    M, q = (one[0] for one in definite(1, 40))
    rng, z, warm, cold = np.random.default_rng(1), None, [], []
    for _ in range(60):
        q = q + 0.02 * rng.normal(size=40)
        warmed = solve(LCP(M, q), z0=z)
        warm.append(warmed.work)
        cold.append(solve(LCP(M, q)).work)
        z = warmed.z
    assert np.median(warm) <= np.median(cold)


def test_rounds_alone_are_newton_and_pivots_alone_are_lemke() -> None:
    """A named method takes its own phase of the road; with options of its own lemke does not take it."""
    drawn = LCP(*(one[0] for one in definite(1, 12)))
    assert [stage.name for stage in solve(drawn, "newton").stages] == ["newton"]
    assert [stage.name for stage in solve(drawn, "lemke").stages] == ["lemke"]
    limited = solve(drawn, "lemke", max_pivots=50)
    assert limited.is_solved
    assert limited.setup_seconds > 0.0


# --- Batches -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", [*ON_THE_ROAD, "psor"])
@pytest.mark.parametrize("shared", [False, True])
def test_a_batch_is_what_solve_gives_one_by_one(algorithm: str, shared: bool) -> None:
    """The same bits for any number of threads, M for all or each, as arrays or as LCPs."""
    M, q = definite(40, 9)
    M = M[0] if shared else M
    batch = solve_batch(M, q, algorithm=algorithm)
    assert batch.all_solved
    for k, threads in enumerate((1, 2, 3, 7)):
        again = solve_batch(M, q, algorithm=algorithm, threads=threads)
        assert again.z.tobytes() == batch.z.tobytes()
        assert again.iterations.tolist() == batch.iterations.tolist()
        one = solve(LCP(M if shared else M[k], q[k]), algorithm)
        assert told(batch[k]) == told(one)
        assert batch.z[k].tobytes() == one.z.tobytes()
        assert batch.w[k].tobytes() == one.w.tobytes()
        assert (batch.status[k], batch.relative_residual[k]) == (one.status, one.residual)
    listed = solve_batch([LCP(M if shared else M[k], q[k]) for k in range(40)], algorithm=algorithm)
    assert listed.z.tobytes() == batch.z.tobytes()


@pytest.mark.parametrize("family", FAMILIES)
def test_a_batch_of_any_sizes_and_kinds(family: str) -> None:
    """A list of LCPs of different sizes: each has the status and the bits of its own run, solvable or not."""
    problems = draw(family, 10, 9)
    batch = solve_batch(problems)
    assert isinstance(batch.z, list) or len({drawn.n for drawn in problems}) == 1
    for drawn, result in zip(problems, batch, strict=True):
        assert told(result) == told(solve(drawn))


def test_a_bad_problem_costs_that_one_alone() -> None:
    """NaN in M, q or a bound, crossed bounds, no solution: in their places, and the others are solved."""
    M, q = definite(8, 4)
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
    for k, what in ((1, r"M\[2, 3\] = nan"), (2, r"q\[0\] = inf"), (3, r"lower\[1\] = nan"), (4, "upper")):
        with pytest.raises(InvalidProblem, match=what):
            batch[k]
    assert np.isnan(batch.w[1]).all()
    assert "3 SOLVED" in repr(batch)
    assert "4 no problem" in repr(batch)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((np.eye(3), None), "q is missing"),
        ((np.ones((2, 3)), np.ones(3)), r"M must have shape \(B, n, n\)"),
        ((np.ones((4, 3, 3)), np.ones((5, 3))), "equally long, got q 5, M 4"),
        ((np.ones((4, 3, 3)), np.ones((4, 2))), r"q must have shape \(B, n\) or \(n,\), n = 3"),
        ((np.ones((4, 3, 3)), 1.0), "q must have shape"),
        ((["M"], np.ones(3)), "real numbers|M must"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(arguments: Any, said: str) -> None:
    """Before anything is solved, with what was given and what is needed."""
    with pytest.raises(InvalidProblem, match=said):
        solve_batch(*arguments)


def test_options_are_refused_as_by_solve() -> None:
    """Threads, tolerance, starts and names."""
    M, q = definite(3, 4)
    for wrong in ({"threads": 0}, {"threads": True}, {"tolerance": -1.0}, {"z0": np.full(4, np.nan)}):
        with pytest.raises(InvalidOption):
            solve_batch(M, q, **wrong)
    with pytest.raises(InvalidOption, match="list of 2 starts"):
        solve_batch([LCP(M[0], q[0]), LCP(M[1], q[1])], z0=[np.zeros(4)])


def test_batches_of_nothing_of_one_and_of_sparse_matrices() -> None:
    """No problem at all, no unknowns, one problem without an axis in front, a sparse M for all, boxes as numbers."""
    assert len(solve_batch([])) == 0
    assert solve_batch(np.zeros((0, 3, 3)), np.zeros((0, 3))).z.shape == (0, 3)
    assert solve_batch(np.zeros((2, 0, 0)), np.zeros((2, 0))).all_solved
    M, q = definite(6, 5)
    assert solve_batch(M[0], q[0]).z.shape == (1, 5)
    chain = sp.diags_array([-np.ones(4), np.full(5, 2.5), -np.ones(4)], offsets=[-1, 0, 1])
    batch = solve_batch(chain, q, upper=0.1, lower=np.full(5, -0.1))
    assert batch.all_solved
    assert told(batch[3]) == told(solve(LCP(chain, q[3], lower=-0.1, upper=0.1)))
    with pytest.raises(IndexError, match="6 results"):
        batch[6]
    assert told(batch[-1]) == told(batch[5])


def test_warm_starts_of_a_batch() -> None:
    """One for all or one each, outside the bounds too: as solve takes them."""
    M, q = definite(5, 6)
    starts = np.random.default_rng(0).normal(size=(5, 6))
    for algorithm in ON_THE_ROAD:
        each, same = (solve_batch(M, q, z0=z0, algorithm=algorithm) for z0 in (starts, starts[0]))
        for k in range(5):
            assert told(each[k]) == told(solve(LCP(M[k], q[k]), algorithm, z0=starts[k]))
            assert told(same[k]) == told(solve(LCP(M[k], q[k]), algorithm, z0=starts[0]))


def test_a_batch_obeys_its_time_limit() -> None:
    """With no time at all each ends with MAX_SECONDS or solved, and none is lost."""
    M, q = definite(2000, 6)
    batch = solve_batch(M, q, max_seconds=0.0)
    assert set(batch.status) <= {Status.SOLVED, Status.MAX_SECONDS}
    assert np.isfinite(batch.z).all()


def test_ctrl_c_ends_a_batch_and_keeps_what_is_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those left are INTERRUPTED at their starts, on one thread and on several."""
    M, q = definite(400, 30)
    main = threading.main_thread().ident

    def interrupted_at_100(first: int, end: int, solve_chunk: Any) -> None:
        if first == 100:
            signal.pthread_kill(main, signal.SIGINT)
        solve_chunk(first, end)

    for threads in (1, 2):
        with monkeypatch.context() as patch:
            patch.setattr(sharing, "LARGEST_CHUNK", 10)
            patch.setattr(
                batch_run, "in_chunks",
                lambda work, *given: sharing.in_chunks(partial(interrupted_at_100, solve_chunk=work), *given),
            )
            batch = solve_batch(M, q, threads=threads)
        assert set(batch.status) <= {Status.SOLVED, Status.INTERRUPTED}
        assert threads == 2 or set(batch.status[100:]) == {Status.INTERRUPTED}  # another thread may finish all before
        assert np.isfinite(batch.z).all()
        interrupted = np.flatnonzero(batch.status == Status.INTERRUPTED)
        assert all(batch[int(k)].status is Status.INTERRUPTED for k in interrupted[:3])


def test_many_right_hand_sides_are_a_batch() -> None:
    """solve_many gives the results of solve, whether it is watched or not."""
    M, q = definite(4, 7)
    prepared = LCP(M[0], q[0])
    for options in ({}, {"record": True}, {"callback": lambda sample, z: False}):
        for one, answer in zip(q, solve_many(prepared, list(q), **options), strict=True):
            assert told(answer) == told(solve(prepared.with_q(one), **options))


def test_nothing_is_said_in_passing() -> None:
    """No warning but those meant for the caller, on problems of every kind."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ConvergenceWarning)
        solve_batch([drawn for family in FAMILIES for drawn in draw(family, 3, 7)])


def test_nobody_can_change_what_was_judged() -> None:
    """The z of a batch, even or ragged, and of a march are read-only."""
    M, q = definite(3, 4)
    ragged = solve_batch([LCP(M[0], q[0]), LCP([[1.0]], [-1.0])])
    chain = sp.diags_array([-np.ones(199), np.full(200, 3.0), -np.ones(199)], offsets=[-1, 0, 1])
    steps = march(LCP(chain, np.zeros(200)), -np.ones((3, 200)))
    for z in (ragged.z[0], solve_batch(M, q).z, steps.z[0], steps[1].z):
        with pytest.raises(ValueError, match="read-only"):
            z[0] = 7.0


def test_lcps_bring_their_bounds_and_are_not_mixed_with_other_things() -> None:
    """What would be ignored is refused, and so is a list of something else."""
    drawn = LCP([[2.0]], [-5.0])
    for options in ({"upper": 1.0}, {"lower": 3.0}, {"lower": [0.0]}, {"q": [1.0]}):
        with pytest.raises(InvalidOption, match="with_q"):
            solve_batch([drawn], **options)
    pairs = [(np.eye(2), np.ones(2)), (np.eye(3), np.ones(3))]
    for wrong in ([drawn, (np.eye(1), [1.0])], pairs, drawn, iter([drawn])):
        with pytest.raises(InvalidProblem, match=r"list of LCPs|write LCP\(M, q\)|many problems, got one LCP"):
            solve_batch(wrong)
    with pytest.raises(InvalidProblem, match="give its transpose"):
        solve_batch(np.ones((4, 3, 3)), np.ones((3, 4)))


@pytest.mark.parametrize("algorithm", ["auto", "psor"])
def test_what_a_batch_did_not_begin_costs_nothing(algorithm: str) -> None:
    """Beyond the limit nothing is solved; each stands at its start, with the settings that were asked for."""
    M, q = definite(5000, 8)
    starts = np.full((5000, 8), 0.25)
    batch = solve_batch(M, q, algorithm=algorithm, z0=starts, max_seconds=1e-9, tolerance=1e-6)
    assert batch.seconds < 1.0
    assert set(batch.status) == {Status.MAX_SECONDS}
    assert (batch.z == 0.25).all()
    assert np.isnan(batch.relative_residual).all()
    late = batch[4999]
    assert (late.status, late.tolerance) == (Status.MAX_SECONDS, 1e-6)
    assert late._asked == solve(LCP(M[0], q[0]), algorithm)._asked
    assert late.iterations == 0


def test_narrow_bands_are_solved_as_bands_in_batches_too() -> None:
    """A tridiagonal M-matrix kept sparse goes to banded, alone, in a stack, in a list and in a march."""
    n = 30
    chain = np.diag(np.full(n, 3.0)) - np.eye(n, k=1) - np.eye(n, k=-1)
    q = np.random.default_rng(0).normal(size=(4, n))
    alone = [solve(LCP(chain, one)) for one in q]
    assert alone[0].algorithm == "auto: banded"
    stacked = solve_batch(np.array([chain] * 4), q)
    listed = solve_batch([LCP(chain, one) for one in q])
    shared = solve_batch(chain, q)
    for k, one in enumerate(alone):
        assert told(one) == told(stacked[k]) == told(listed[k]) == told(shared[k])
        assert stacked.w[k].tobytes() == one.w.tobytes()
    assert {result.algorithm for result in march(LCP(chain, q[0]), q)} == {"auto: banded"}


def test_a_march_keeps_what_it_has() -> None:
    """A q that overflows on the way ends it and says so; the first step's is refused."""
    steps = march(LCP([[1.0]], [0.0]), [[-1.0]] * 3, carry=-1e200)
    assert not steps.all_solved
    assert 1 <= len(steps) < 3
    assert "q[0]" in str(steps.error)
    assert "ended by" in repr(steps)
    with pytest.raises(InvalidProblem):
        march(LCP([[1.0]], [0.0]), [[-1.0]], carry=[[1j]])
    assert march(LCP([[2.0]], [0.0]), sp.csr_array([[-1.0], [-1.0]])).all_solved


def test_a_batch_is_a_sequence() -> None:
    """Slices and negative numbers, as a list has them."""
    M, q = definite(5, 3)
    batch = solve_batch(M, q)
    assert [told(one) for one in batch[1:4:2]] == [told(batch[1]), told(batch[3])]
    with pytest.raises(TypeError):
        batch[1.0]
