"""Batches and studies on an executor give the results of one process, in order."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import time
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    InvalidOption,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    solve,
    solve_batch,
    study,
)
from lcp_plugin.algorithms import algorithm_class
from lcp_plugin.core.errors import InvalidProblem, LCPError
from lcp_plugin.core.executors import run_on

RNG = np.random.default_rng(7)
A = RNG.normal(size=(40, 4, 4))
M = A @ A.transpose(0, 2, 1) + np.eye(4)
Q = RNG.normal(size=(40, 4))
FIT = BoundedLeastSquares(RNG.normal(size=(7, 3)), np.zeros(7))
PROGRAM = QuadraticProgram(np.eye(3), np.zeros(3), G=[[1, 1, 1]], h=[1], lower=0, constant=2.0)
PAIR = [LCP([[2.0, 1.0], [1.0, 2.0]], q) for q in ([-1.0, 2.0], [-3.0, -3.0])]
SLIDING = FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5)


class Here(Executor):
    """An executor of this process, which loses the jobs whose numbers are in `losses`, and may break with them."""

    def __init__(self, losses: tuple[int, ...] = (), *, breaks: bool = False) -> None:
        self.losses, self.breaks, self.count = losses, breaks, 0

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        """Run the job, or lose it."""
        if self.breaks and any(k < self.count for k in self.losses):
            raise BrokenProcessPool("no worker is left")
        future: Future[Any] = Future()
        self.count += 1
        if self.count - 1 in self.losses:
            future.set_exception(BrokenProcessPool("a worker died"))
        else:
            future.set_result(function(*given, **named))
        return future


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    """Two fresh processes, which find the modules of this folder."""
    paths = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), paths])
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as made:
        yield made
    os.environ["PYTHONPATH"] = paths


BATCHES: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {
    "arrays": ((M, Q), {}),
    "arrays with starts": ((M, Q), {"z0": np.ones(4)}),
    "one start per array": ((M, Q), {"z0": np.ones((40, 4))}),
    "a list with starts": ((PAIR,), {"z0": [np.ones(2), None]}),
    "a list that starts without a start": ((PAIR,), {"z0": [None, np.ones(2)]}),
    "one matrix": ((LCP(M[0], Q[0]), Q), {"upper": 1.0}),
    "a list": (([LCP(M[k], Q[k]) for k in range(9)] + [LCP([[2.0]], [-1.0])],), {}),
    "a named algorithm": ((M, Q), {"algorithm": "newton"}),
    "least squares": ((FIT, RNG.normal(size=(30, 7))), {}),
    "programs": ((PROGRAM, RNG.normal(size=(30, 3))), {}),
    "contacts": (
        (
            FrictionalContact.worlds(
                np.eye(6), RNG.normal(size=(20, 6)), 0.5, contacts=np.arange(20) % 3, dimension=3
            ),
        ),
        {},
    ),
    "all classes": (([SLIDING, FIT, PROGRAM, LCP(M[0], Q[0]), LCP([[1.0]], [-2.0])],), {}),
}


@pytest.mark.parametrize("name", BATCHES)
def test_a_batch_without_time_loses_no_problem(name: str) -> None:
    """With no time at all each problem ends with MAX_SECONDS or is solved."""
    given, options = BATCHES[name]
    for where in ({}, {"executor": Here()}):
        late = solve_batch(*given, max_seconds=0.0, **options, **where)
        assert {*late.status} <= {Status.SOLVED, Status.MAX_SECONDS}
        assert len(late) == len(late.status) == len(late.x)
        assert late[0].status is late.status[0]


@pytest.mark.parametrize("name", BATCHES)
def test_a_batch_on_an_executor_has_the_results_of_one_process(name: str) -> None:
    """Points, statuses, objectives and single results have the bits of the batch without an executor."""
    given, options = BATCHES[name]
    here, there = solve_batch(*given, **options), solve_batch(*given, executor=Here(), **options)
    assert list(there.status) == list(here.status)
    assert there.all_solved
    for one, other in zip(there.x, here.x, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(there.objective, here.objective)
    np.testing.assert_array_equal(there[1].x, here[1].x)


def test_processes_solve_a_batch_and_use_one_thread(pool: ProcessPoolExecutor) -> None:
    """Two spawned processes return the points of this one; the progress is reported in numbers of problems."""
    seen: list[tuple[int, int]] = []
    named: dict[str, Any] = {"algorithm": "newton", "executor": pool}
    found = solve_batch(M, Q, callback=lambda *counts: seen.append(counts), **named)
    np.testing.assert_allclose(found.x, solve_batch(M, Q).x, atol=1e-9)
    assert seen[-1] == (40, 40)
    assert len(seen) > 1
    [limits] = [pool.submit(blas_threads).result()]
    assert limits in ([], [1])


def blas_threads() -> list[int]:
    """Return the numbers of BLAS threads inside a job, without repetition."""
    from lcp_plugin.core.executors import one_blas_thread

    try:
        from threadpoolctl import threadpool_info
    except ImportError:
        return []
    with one_blas_thread():
        return sorted({one["num_threads"] for one in threadpool_info()})


def test_a_lost_worker_ends_a_batch_with_the_error_of_the_pool() -> None:
    """A process that dies breaks a ProcessPoolExecutor; the error has the batch with INTERRUPTED problems."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as short:
        short.submit(os._exit, 1)
        with pytest.raises(BrokenProcessPool) as lost:
            solve_batch(M, Q, executor=short)
    assert {*lost.value.finished.status} == {Status.INTERRUPTED}  # type: ignore[attr-defined]


@pytest.mark.parametrize("breaks", [False, True])
def test_a_lost_chunk_ends_a_batch_and_the_finished_results_stay(breaks: bool) -> None:
    """The results before the loss keep their status; nothing is submitted a second time."""
    executor = Here((3,), breaks=breaks)
    with pytest.raises(BrokenProcessPool, match="a worker died") as lost:
        solve_batch(M, Q, algorithm="newton", executor=executor)
    finished: Any = lost.value.finished  # type: ignore[attr-defined]
    solved = [one is Status.SOLVED for one in finished.status]
    assert solved[:3] == [True] * 3
    assert not solved[3]
    assert {*finished.status} == {Status.SOLVED, Status.INTERRUPTED}
    np.testing.assert_allclose(finished[2].x, solve(LCP(M[2], Q[2])).x, atol=1e-9)
    assert executor.count == (4 if breaks else len(Q))


def test_an_invalid_problem_raises_its_own_error_only_when_it_is_read() -> None:
    """A NaN, an infeasible problem and an invalid program do not affect the others."""
    q = Q.copy()
    q[3] = np.nan
    found = solve_batch(M, q, executor=Here())
    assert found.status[3] is None
    assert np.isnan(found.x[3]).all()
    c = np.zeros((4, 3))
    c[1] = np.inf
    programs = solve_batch(PROGRAM, c, executor=Here())
    assert [one is Status.SOLVED for one in programs.status] == [True, False, True, True]
    with pytest.raises(InvalidProblem):
        _ = programs[1]


@pytest.mark.parametrize(
    ("given", "count"),
    [(([],), 0), ((M[0], np.empty((0, 4))), 0), ((M[0], np.full((3, 4), np.nan)), 3)],
)
def test_a_batch_without_a_valid_problem_sends_no_job(given: Any, count: int) -> None:
    """The lengths and errors are equal with and without an executor."""
    executor = Here()
    there, here = solve_batch(*given, executor=executor), solve_batch(*given)
    assert len(there) == len(here) == count
    assert there.errors.keys() == here.errors.keys() == {*range(count)}
    assert executor.count == 0


class TwoArguments(Exception):
    """An exception that pickles and does not unpickle."""

    def __init__(self, text: str, other: int) -> None:
        super().__init__(text)


def raise_two_arguments(_: Any) -> None:
    """Raise an exception that does not unpickle."""
    raise TwoArguments("the text of the user", 1)


def test_an_exception_that_does_not_unpickle_arrives_with_its_type_and_text() -> None:
    """A process pool would break when it reads the exception, and report a lost worker."""
    with ThreadPoolExecutor(1) as executor:
        with pytest.raises(LCPError, match="TwoArguments: the text of the user") as raised:
            [*run_on(executor, raise_two_arguments, [1])]
        assert isinstance(pickle.loads(pickle.dumps(raised.value)), LCPError)


def test_an_executor_that_was_shut_down_raises_its_own_error() -> None:
    """The error has the batch, whose problems are INTERRUPTED."""
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(RuntimeError, match="after shutdown") as lost:
        solve_batch(M, Q, executor=executor)
    assert {*lost.value.finished.status} == {Status.INTERRUPTED}  # type: ignore[attr-defined]


def test_functions_that_do_not_pickle_are_refused_with_advice() -> None:
    """A local class cannot be sent to another process."""

    class Own(algorithm_class("npgs")):
        """An algorithm of a module that no worker can import."""

    with pytest.raises(InvalidOption, match="at the top of a module"):
        solve_batch(M, Q, algorithm=Own(), executor=Here())
    with pytest.raises(InvalidOption, match=r"client\.get_executor"):
        solve_batch(M, Q, executor=4)


def test_a_wrong_option_and_an_error_of_the_solver_are_raised_as_without_an_executor() -> None:
    """An error inside a job is not a lost worker."""
    with pytest.raises(InvalidOption, match="did you mean 'tolerance'"):
        solve_batch(M, Q, tolerence=1e-9, executor=Here())  # type: ignore[call-arg]
    with pytest.raises(InvalidOption, match="no algorithm for a"):
        solve_batch([FIT, FIT], algorithm="npgs", executor=Here())


def test_a_callback_ends_a_batch_on_an_executor() -> None:
    """Problems without a result are INTERRUPTED after the callback."""
    named: dict[str, Any] = {"algorithm": "newton", "executor": Here()}
    ended = solve_batch(M, Q, callback=lambda *_: True, **named)
    assert {*ended.status} == {Status.INTERRUPTED, Status.SOLVED}


def _slow(x: Any) -> Any:
    time.sleep(0.002)
    return np.exp(x) - 2.0


def test_what_workers_have_solved_at_the_limit_arrives() -> None:
    """Each chunk ends at the limit of the batch, and the caller waits for it up to a second more."""
    problems = [NonlinearProblem(_slow, lower=[0.0])] * 640
    with ThreadPoolExecutor(2) as pool:
        late = solve_batch(problems, max_seconds=1.0, executor=pool)
    assert [*late.status].count(Status.SOLVED) > 2, late.counts()
    assert [*late.status].count(Status.MAX_SECONDS) > 2, late.counts()
    assert late.seconds < 2.5
    np.testing.assert_allclose(late.z[late.status == Status.SOLVED], np.log(2.0), rtol=1e-7)


def _fails(x: Any) -> Any:
    raise ZeroDivisionError("demand 0")


@pytest.mark.parametrize("executor", [None, Here()])
def test_an_error_of_a_function_has_the_number_of_its_problem(executor: Any) -> None:
    """The exception passes as it is, with a note."""
    problems = [NonlinearProblem(np.exp, lower=[0.0])] * 70
    with pytest.raises(ZeroDivisionError, match="demand 0") as caught:
        solve_batch([*problems, NonlinearProblem(_fails, lower=[0.0])], executor=executor)
    assert caught.value.__notes__ == ["in problem 70 of the batch"]


def test_a_study_on_an_executor_has_the_rows_of_one_process_in_order(tmp_path: Path) -> None:
    """All columns but the seconds agree, in the file as well."""
    named: dict[str, Any] = {"sizes": [100, 196], "repeats": 1}
    here = study("half_active", ["npsor", "psor"], **named)
    file = tmp_path / "rows.csv"
    there = study("half_active", ["npsor", "psor"], executor=Here(), out=file, **named)
    assert [(row.n, row.method, row.status) for row in there.rows] == [
        (row.n, row.method, row.status) for row in here.rows
    ]
    assert file.read_text().count("half_active") >= 4
    with pytest.raises(InvalidOption, match="do not pickle"):
        study(lambda size: LCP(np.eye(size), np.ones(size)), sizes=[3], executor=Here())
    with pytest.raises(BrokenProcessPool) as lost:
        study("half_active", ["npsor"], executor=Here((1,)), **named)
    assert [row.n for row in lost.value.finished.rows] == [100]  # type: ignore[attr-defined]


def test_an_executor_of_dask_gives_the_same_results() -> None:
    """Two workers of a local cluster; tests/distributed has MPI."""
    dask = pytest.importorskip("dask.distributed", reason="dask is not installed")
    with dask.Client(n_workers=2, threads_per_worker=1) as client:
        found = solve_batch(M, Q, executor=client.get_executor())
    np.testing.assert_allclose(found.x, solve_batch(M, Q).x, atol=1e-9)


@pytest.mark.parametrize("name", ["w", "motion"])
@pytest.mark.parametrize("given", [(PROGRAM, Q[:2, :3]), (FIT, np.ones((2, 7))), ([FIT, PAIR[0]],)])
def test_an_array_that_the_problems_lack_is_an_error_of_batch_answers(
    name: str, given: tuple[Any, ...]
) -> None:
    """The message has the name of the public class and the arrays of the batch, not the name of an internal class."""
    answers = solve_batch(*given)
    with pytest.raises(
        AttributeError, match=f"BatchAnswers .* no {name}; its arrays include status, x"
    ):
        getattr(answers, name)
    with pytest.raises(AttributeError, match="has no motion"):
        _ = solve_batch(PAIR).motion
