"""Small LCPs in arrays on a GPU (PyTorch, CuPy, JAX): solved there, with results in the library of the arrays.

The kernels of the compiled loop solve the problems, one thread per problem, and test the points. A problem whose point
the sufficient test does not accept is copied to the host, and solved there as in arrays of numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple
from warnings import catch_warnings

import numpy as np

from ...core.checks import INFINITE_LIMIT, AnyMatrix, Array, read_only
from ...core.deadline import Clock, pause_for_compilation
from ...core.errors import InvalidProblem, LCPError, UnsuitableProblem
from ...core.lcp import LCP
from ...core.settings import Settings, Status
from ...judges.lcp import Measured
from ...methods.small import tilts
from ...solving.result import Result, StageRecord
from ..many import AnswerSequence
from .batch_run import BatchRun
from .instances import Stacked, have_values

MAX_UNKNOWNS = 70  # each thread has a tableau
MAX_SCRATCH = 2**30  # bytes of the tables of one launch
THREADS = 32  # per block: one warp, so that a small batch occupies many processors
ON_GPU = 2, 13  # device types of DLPack: memory of CUDA, managed memory of CUDA


def is_on_gpu(array: Array) -> bool:
    """Return whether an array is in the memory of a GPU, by its array protocols."""
    if hasattr(array, "__dlpack_device__"):
        return array.__dlpack_device__()[0] in ON_GPU
    return hasattr(array, "__cuda_array_interface__")


def _modules() -> tuple[Any, Any]:
    """Return CuPy and the kernels."""
    try:
        return import_module("cupy"), import_module("lcp_plugin.methods.small_lcps_on_gpu")
    except ImportError as error:
        raise ImportError(
            f"arrays on a GPU need numba-cuda and CuPy ({error}): pip install 'numba-cuda[cu13]' cupy-cuda13x (or "
            "lcp_plugin[gpu]), with CUDA 12 'numba-cuda[cu12]' cupy-cuda12x; or copy the arrays to the host"
        ) from error


def _library(array: Array) -> Callable[[Any], Any]:
    """Return the function that passes an array of CuPy to the library of `array`, without a copy."""
    has_namespace = hasattr(array, "__array_namespace__")
    name = type(array).__module__.partition(".")[0]
    space = array.__array_namespace__() if has_namespace else import_module(name)
    return getattr(space, "from_dlpack", lambda x: x)


class DeviceData(NamedTuple):
    """Arrays of CuPy: M of shape (B or 1, n, n), and vectors of shape (B, n)."""

    M: AnyMatrix
    q: Array
    lower: Array
    upper: Array

    @classmethod
    def of(cls, xp: Any, **named: Any) -> DeviceData:
        """Return checked arrays; a number is a bound of all rows."""
        for name, array in named.items():
            if not (is_on_gpu(array) or (name in ("lower", "upper") and np.ndim(array) == 0)):
                raise InvalidProblem(
                    f"{name} must be an array on the GPU, as others here are, got {type(array).__name__}; copy it there"
                )
        arrays = [xp.asarray(array) for array in named.values()]
        shapes = [array.shape for array in arrays]
        n = shapes[0][-1] if len(shapes[0]) in (2, 3) else 0
        try:
            shape = np.broadcast_shapes((1, n), (*shapes[0][:-2], n), *shapes[1:])
        except ValueError:
            shape = ()
        is_real = all(array.dtype.kind in "biuf" for array in arrays)
        if not is_real or len(shape) != 2 or shape[1] != n or shapes[0][-2:] != (n, n):
            pairs = zip(named, arrays, strict=True)
            got = ", ".join(f"{name} {array.shape} {array.dtype}" for name, array in pairs)
            raise InvalidProblem(
                f"M must have shape (B, n, n) or (n, n), q and bounds (B, n) or (n,), all real; got {got}"
            )
        if not 0 < n <= MAX_UNKNOWNS:
            raise UnsuitableProblem(
                f"a GPU solves LCPs of 1 to {MAX_UNKNOWNS} unknowns, got n = {n}; copy the arrays to the host"
            )
        M, *vectors = (array.astype(float) for array in arrays)
        q, low, high = (xp.broadcast_to(array, shape) for array in vectors)
        low = xp.where(low <= -INFINITE_LIMIT, -np.inf, low)
        return cls(M.reshape(-1, n, n), q, low, xp.where(high >= INFINITE_LIMIT, np.inf, high))

    def slacks(self, z: Array) -> Any:
        """Return M z + q of each problem, shape (B, n)."""
        return (self.M @ z[:, :, None])[:, :, 0] + self.q

    def on_host(self, xp: Any, k: Any) -> list[Any]:
        """Return M, q, lower and upper of problems in arrays of numpy; one matrix for all without its first axis."""
        M = self.M[0] if len(self.M) == 1 else self.M[k]
        return [xp.asnumpy(array) for array in (M, *(array[k] for array in self[1:]))]


def launch(
    gpu: Any, name: str, arrays: Array, shared: Any, results: Any, has_time: Any = lambda: True
) -> None:
    """Call a kernel for all problems, a thread for each, in parts whose tables fit into MAX_SCRATCH.

    Parameters
    ----------
    gpu : pair
        CuPy and the kernels.
    name : str
        The kernel.
    arrays, results : sequences of arrays, shape (B, …)
        Arguments that the kernel reads and writes; M may have shape (1, n, n).
    shared : tuple
        Arguments that apply to all problems.
    has_time : callable
        Called before each part; if it returns False, the remaining rows of `results` are unchanged.
    """
    (xp, kernels), (count, n) = gpu, arrays[1].shape
    size = min(count, MAX_SCRATCH // (8 * (n + 9) * (n + 1)))
    tables = xp.empty((n + 9, n + 1, size)), xp.empty((2, 2 * n + 1, size), np.int64)
    for first in range(0, count, size):
        if not has_time():
            break
        part = slice(first, min(first + size, count))
        read = [xp.array(array if len(array) == 1 else array[part], order="F") for array in arrays]
        values = [xp.array(array[part], order="F") for array in results]
        blocks = -(-len(values[-1]) // THREADS)
        # The launch itself returns at once; numba warns of few blocks.
        with pause_for_compilation(), catch_warnings(action="ignore"):
            getattr(kernels, name)[blocks, THREADS](*read, *shared, *tables, *values)
        kernels.cuda.synchronize()
        for array, value in zip(results, values, strict=True):
            array[part] = value


class DeviceAnswers(AnswerSequence[Any]):
    """The results of a batch in arrays on a GPU; ``answers[k]`` is the result of :func:`lcp_plugin.solve`.

    Attributes
    ----------
    x, z : array, shape (B, n)
        On the GPU, in the library of q; NaN if the data are invalid.
    status : array of Status, shape (B,)
        On the host, as the next two; None if the data are invalid.
    relative_residual : array, shape (B,)
        Upper bound of the residual of the stopping criterion.
    iterations : array of int, shape (B,)
    errors : dict
        The error of each problem k with invalid data; ``answers[k]`` raises it.
    seconds : float
        Seconds of the entire batch, compilation excluded.
    """

    status: Array

    def __init__(self, M: Any, q: Any, lower: Array, upper: Array, options: dict[str, Any]) -> None:
        self.gpu, self.library, self.settings = _modules(), _library(q), Settings(**options)
        (xp, _), clock, limit = self.gpu, Clock(), self.settings.max_seconds
        self.data = data = DeviceData.of(xp, M=M, q=q, lower=lower, upper=upper)
        (low, high), (count, n) = data[2:], data.q.shape
        start = xp.minimum(xp.maximum(low, 0.0), high)
        sides, z = xp.zeros((count, n), np.int64), xp.array(start, order="C")
        bound = xp.full(count, np.inf)
        shared = (xp.asarray(tilts(n)), float(self.settings.tolerance))
        arrays, at = (*data, start), (sides, z, bound)
        launch(self.gpu, "solve_each", arrays, shared, at, lambda: clock.read() <= limit)
        residual = xp.asnumpy(xp.where(have_values(low, high), bound, np.inf))
        self.status, self.errors = np.full(count, Status.SOLVED), dict[int, LCPError]()
        self._others: dict[int, Callable[[], Any]] = {}  # results of problems solved on the host
        self.iterations = xp.asnumpy((z != start).any(axis=1)).astype(int)
        rest = np.flatnonzero(residual == np.inf)
        if rest.size:
            remaining = options.copy()
            if limit < np.inf:
                remaining["max_seconds"] = max(limit - clock.read(), 0.0)
            A, b, below, above = data.on_host(xp, xp.asarray(rest))
            answers = BatchRun(Stacked(A, b, below, above, None), "auto", remaining).run()
            z[xp.asarray(rest)] = xp.asarray(answers.z)
            self.status[rest], residual[rest] = answers.status, answers.relative_residual
            self.iterations[rest] = answers.iterations
            self.errors = {int(rest[k]): error for k, error in answers.errors.items()}
            self._others = {k: partial(answers.at, i) for i, k in enumerate(rest.tolist())}
        self.relative_residual, self.points, self.seconds = residual, z, clock.read()
        self.x = self.z = self.library(z)

    def __len__(self) -> int:
        return len(self.status)

    def at(self, k: int) -> Any:
        """Return result k, or raise the error of its problem."""
        if k in self._others:
            return self._others[k]()
        M, q, lower, upper = self.data.on_host(self.gpu[0], k)
        stage = StageRecord("rounds", "one of a batch on a GPU", int(self.iterations[k]), 0.0)
        z = read_only(self.gpu[0].asnumpy(self.points[k]))
        share = self.seconds / len(self)
        point = Measured(z, 0.0, passes=True)
        return Result.of(LCP(M, q, lower=lower, upper=upper), point, [stage], self.settings, share)

    @property
    def w(self) -> Any:
        """M z + q of each problem, shape (B, n), on the GPU."""
        return self.library(self.data.slacks(self.points))
