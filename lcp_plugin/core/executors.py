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

from .errors import InvalidOption, LCPError


def run_on(
    executor: Executor,
    function: Callable[[Any], Any],
    jobs: Sequence[Any],
    seconds_left: Callable[[], float] = lambda: math.inf,
) -> Iterator[tuple[int, Any]]:
    """Yield (k, function(jobs[k])) as jobs finish, until no seconds are left.

    The error of a lost worker, or of an executor that takes no further jobs, ends the jobs: it is raised after the
    results that have arrived.

    Raises
    ------
    InvalidOption
        If a job does not pickle.
    """
    if not isinstance(executor, Executor):
        raise InvalidOption(
            f"executor must be a concurrent.futures.Executor, got {executor!r}; for dask, pass client.get_executor()"
        )
    waiting: dict[Future[Any], int] = {}
    lost: Exception | None = None
    try:
        for k, job in takewhile(lambda _: seconds_left() > 0.0, enumerate(jobs)):
            pickled = _pickled(function, job)
            try:
                waiting[executor.submit(_run_job, pickled)] = k
            except RuntimeError as error:  # broken, or shut down
                lost = error
                break
        while waiting:
            left = 0.0 if lost else seconds_left()
            # After 10⁶ seconds the waiting for a result is repeated
            for future in wait(waiting, min(max(left, 0.0), 1e6), FIRST_COMPLETED)[0]:
                k = waiting.pop(future)
                try:
                    value, raised = future.result()
                except Exception as error:  # each executor has its own classes for a lost worker
                    lost = error
                    continue
                if raised is not None:
                    raise raised
                yield k, value
            if left <= 0.0:
                break
    finally:
        for future in waiting:
            future.cancel()
    if lost is not None:
        raise lost


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
    with one_blas_thread():
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


def one_blas_thread() -> AbstractContextManager[Any]:
    """Return a context in which BLAS has one thread, as far as threadpoolctl is installed."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        return nullcontext()
    return threadpool_limits(1)
