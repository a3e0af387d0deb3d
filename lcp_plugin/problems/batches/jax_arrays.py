"""Small LCPs in arrays of JAX, or of PyTorch and CuPy on a GPU: solved on their device, with z there.

Problems whose points the test of :func:`~lcp_plugin.interfaces.learn.jax.solve_lcp` does not accept, and the tables of
the results, are those of the host.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from ...core.checks import Array, check_kind
from ...core.errors import InvalidProblem
from ...methods.small import LOOP_UP_TO
from .batch_run import BatchAnswers, BatchRun
from .instances import Stacked, Stacks

LARGEST_PART = 2**25  # numbers in the matrices of problems that a device solves at once


def is_of_device(array: Array) -> bool:
    """Return whether an array is of JAX, or in the memory of a GPU."""
    if (jax := sys.modules.get("jax")) is not None and isinstance(array, jax.Array):
        return True
    return hasattr(array, "__dlpack_device__") and array.__dlpack_device__()[0] != 1  # the host


class DeviceProblems(Stacked):
    """LCPs in arrays of JAX, which a device solves if they have no start and at most 128 unknowns."""

    def __init__(self, *data: Array) -> None:
        try:
            jax = self.jax
        except ImportError:
            raise ImportError(
                "arrays on a GPU are solved by JAX; install it for the GPU: pip install 'jax[cuda13]'; or copy them to "
                "the host"
            ) from None
        if any(isinstance(array, jax.core.Tracer) for array in data):
            raise InvalidProblem(
                "solve_batch got an array without values, as within jax.jit; there call solve_lcp of "
                "lcp_plugin.interfaces.learn.jax"
            )
        with self.double():
            arrays = [self.on_device(array) if is_of_device(array) else array for array in data]
            super().__init__(*(None if array is None else np.asarray(array) for array in arrays))
        self.arrays, self.n = arrays[:4], self.M.shape[-1]

    @property
    def jax(self) -> Any:
        """The module."""
        return import_module("jax")

    def double(self) -> Any:
        """Return a context in which JAX calculates in double precision."""
        has_switch = hasattr(self.jax, "enable_x64")
        return (self.jax if has_switch else import_module("jax.experimental")).enable_x64(True)

    @property
    def device(self) -> Any:
        """Device of the first array that is on one."""
        return next(array.device for array in self.arrays if isinstance(array, self.jax.Array))

    def on_device(self, array: Array) -> Any:
        """Return a float64 array of JAX, on its device; an array of another library without a copy."""
        jax = self.jax
        array = array if isinstance(array, jax.Array) else jax.dlpack.from_dlpack(array)
        if not jax.numpy.issubdtype(array.dtype, jax.numpy.floating):
            check_kind(array.dtype, "the arrays must hold real numbers")
        return jax.numpy.asarray(array, float)

    def slacks(self, z: Array) -> Any:
        """Return M z + q of each problem on the host, shape (B, n), in double precision without x64 also."""
        with self.double():
            return super().slacks(np.asarray(self.on_device(z) if is_of_device(z) else z))

    def stacks(self, tolerance: float, has_time: Callable[[], bool], threads: int) -> Stacks:
        """Yield parts of the batch that the device solves."""
        if "z0" in self.rows or not 0 < self.n <= LOOP_UP_TO:
            yield from super().stacks(tolerance, has_time, threads)
            return
        kernel = import_module("lcp_plugin.methods.small_lcps_in_jax")
        size = max(LARGEST_PART // self.n**2, 1)
        parts = [slice(first, first + size) for first in range(0, self.count, size)]
        for part in parts:
            yield np.arange(self.count)[part], partial(self._solve, kernel, part, tolerance)

    def _solve(self, kernel: Array, part: slice, tolerance: float) -> Any:
        with self.double():
            M, *vectors = kernel.checked_arrays(*self.jax.device_put(self.arrays, self.device))
            vectors = [self.jax.numpy.broadcast_to(x, (self.count, self.n))[part] for x in vectors]
            M = self.jax.numpy.broadcast_to(M, (self.count, self.n, self.n))[part]
            z, _, residual = map(np.array, kernel.solve_stack(M, *vectors, tolerance))
            start = np.asarray(self.jax.numpy.clip(0.0, *vectors[1:]))
        return z, residual, (z != start).any(1).astype(int), residual < np.inf


def solve_on_device(
    data: tuple[Any, ...], algorithm: Array, options: dict[str, Any], callback: object
) -> BatchAnswers:
    """Return the results of a batch; x and z are on the device, in the library of q."""
    problems = DeviceProblems(*data)
    answers = BatchRun(problems, algorithm, options).run(callback)
    library = import_module(type(data[1]).__module__.partition(".")[0])
    with problems.double():
        z = problems.jax.device_put(problems.jax.numpy.asarray(answers.z), problems.device)
    is_other = is_of_device(data[1]) and not isinstance(data[1], problems.jax.Array)
    for name in ("x", "z"):
        setattr(answers, name, library.from_dlpack(z) if is_other else z)
    return answers
