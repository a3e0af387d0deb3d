"""Jobs on an executor of ``concurrent.futures``: a process pool, MPIPoolExecutor of mpi4py, the client of dask."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from itertools import takewhile
from typing import Any

from .errors import InvalidOption, LCPError, WorkerLost


def run_on(
    executor: Executor,
    function: Callable[[Any], Any],
    jobs: Sequence[Any],
    seconds_left: Callable[[], float] = lambda: math.inf,
) -> Iterator[tuple[int, Any]]:
    """Yield (k, function(jobs[k])) as jobs finish, until no seconds are left; a lost job is submitted a second time.

    The second time is for dask and MPI: a ProcessPoolExecutor takes no further jobs after one of its workers died.

    Raises
    ------
    InvalidOption
        If a job does not pickle.
    WorkerLost
        After all other jobs, if a job was lost twice, or the executor takes no further jobs.
    """
    if not isinstance(executor, Executor):
        raise InvalidOption(
            f"executor must be a concurrent.futures.Executor, got {executor!r}; for dask, pass client.get_executor()"
        )
    pickled: dict[int, bytes] = {}
    waiting: dict[Future[Any], tuple[int, bool]] = {}
    lost: dict[int, Exception] = {}

    def submit(k: int, *, is_first: bool) -> None:
        try:
            waiting[executor.submit(_run_job, pickled[k])] = k, is_first
        except RuntimeError as error:  # broken, or shut down
            lost[k] = error

    try:
        for k, job in takewhile(lambda _: seconds_left() > 0.0, enumerate(jobs)):
            pickled[k] = _pickled(function, job)
            submit(k, is_first=True)
        while waiting:
            left = seconds_left()
            done = wait(waiting, None if left == math.inf else max(left, 0.0), FIRST_COMPLETED)[0]
            if not done:
                return
            for future in done:
                k, is_first = waiting.pop(future)
                try:
                    value, raised = future.result()
                except Exception as error:  # each executor has its own classes for a lost worker
                    if is_first:
                        submit(k, is_first=False)
                    else:
                        lost[k] = error
                    continue
                if raised is not None:
                    raise raised
                yield k, value
    finally:
        for future in waiting:
            future.cancel()
    if lost:
        raise _worker_lost(lost, len(jobs))


def _worker_lost(lost: dict[int, Exception], count: int) -> WorkerLost:
    why = next(iter(lost.values()))
    advice = "look for a worker without memory, and start again with a new executor"
    if (
        type(why) is RuntimeError
    ):  # of submit after a shutdown; a BrokenExecutor if workers are lost
        advice = "the executor was shut down: pass one that still accepts jobs"
    reason = f"{type(why).__name__}: {why}"
    return WorkerLost(f"{len(lost)} of {count} jobs were lost ({reason}); {advice}")


def _pickled(function: Callable[[Any], Any], job: Any) -> bytes:
    try:
        return pickle.dumps(partial(function, job), pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidOption(
            f"the problems do not pickle ({error}); define functions with def, and classes, at the top of a module "
            "that the workers can import (lambdas and local functions do not pickle), or leave out executor"
        ) from error


def _run_job(pickled: bytes) -> tuple[Any, Exception | None]:
    """Return the value of the job, or its error: an exception of the future means that the worker was lost."""
    with _one_blas_thread():
        try:
            return pickle.loads(pickled)(), None
        except Exception as error:
            return None, _picklable(error)


def _picklable(error: Exception) -> Exception:
    """Return the error, or an LCPError with its type and text if it does not unpickle, which breaks a process pool."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return LCPError(f"{type(error).__name__}: {error}")
    return error


def _one_blas_thread() -> AbstractContextManager[Any]:
    """Return a context in which BLAS has one thread, as far as threadpoolctl is installed."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        return nullcontext()
    return threadpool_limits(1)  # type: ignore[no-any-return]
