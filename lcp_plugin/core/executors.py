"""Jobs on an executor of ``concurrent.futures``: a process pool, MPIPoolExecutor of mpi4py, the client of dask."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any

from .errors import InvalidOption, WorkerLost

MOST_JOBS = 64  # of one call: each carries its own copy of shared data, and several workers need several jobs each
OF_FUNCTIONS = (
    "define functions with def, and classes, at the top of a module that the workers can import (lambdas and local "
    "functions do not pickle), or leave out executor"
)


def run_on(
    executor: Executor,
    work: Callable[[Any], Any],
    jobs: Sequence[Any],
    seconds_left: Callable[[], float] = lambda: math.inf,
) -> Iterator[tuple[int, Any]]:
    """Yield (k, work(jobs[k])) as workers finish, until no seconds are left; a lost job runs a second time.

    Raises
    ------
    InvalidOption
        If a job does not pickle.
    WorkerLost
        After all other jobs, if a job was lost twice, or the executor takes no further jobs.
    """
    if not isinstance(executor, Executor):
        raise InvalidOption(
            f"executor must be a concurrent.futures.Executor, got {executor!r}; of dask: client.get_executor()"
        )
    parcels = [_packed(work, job) for job in jobs]
    waiting: dict[Future[Any], int] = {}
    tries, lost = [0] * len(parcels), dict[int, Exception]()

    def submit(k: int) -> None:
        try:
            waiting[executor.submit(_run_parcel, parcels[k])] = k
            tries[k] += 1
        except RuntimeError as error:  # broken, or shut down
            lost[k] = error

    try:
        for k in range(len(parcels)):
            submit(k)
        while waiting:
            left = seconds_left()
            done = wait(waiting, None if left == math.inf else max(left, 0.0), FIRST_COMPLETED)[0]
            if not done:
                return
            for future in done:
                k = waiting.pop(future)
                try:
                    value, raised = future.result()
                except Exception as error:  # of the executor: its kinds differ
                    submit(k) if tries[k] < 2 else lost.setdefault(k, error)
                    continue
                if raised is not None:
                    raise raised
                yield k, value
    finally:
        for future in waiting:
            future.cancel()
    if lost:
        why = next(iter(lost.values()))
        raise WorkerLost(
            f"{len(lost)} of {len(parcels)} jobs were lost with their workers ({type(why).__name__}: {why}); look "
            "for a worker without memory, and start again with a new executor"
        )


def _packed(work: Callable[[Any], Any], job: Any) -> bytes:
    try:
        return pickle.dumps(partial(work, job), pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidOption(f"the problems do not pickle ({error}); {OF_FUNCTIONS}") from error


def _run_parcel(parcel: bytes) -> tuple[Any, Exception | None]:
    """Return the value of the job, or its error: the executor raises its own errors."""
    with _one_blas_thread():
        try:
            return pickle.loads(parcel)(), None
        except Exception as error:
            return None, error


def _one_blas_thread() -> AbstractContextManager[Any]:
    """Return a context in which BLAS has one thread, as far as threadpoolctl is installed."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        return nullcontext()
    return threadpool_limits(1)  # type: ignore[no-any-return]
