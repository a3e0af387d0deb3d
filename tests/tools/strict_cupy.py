"""A replacement of CuPy without a GPU: arrays of numpy that do not mix with arrays of the host."""

from __future__ import annotations

import types
from typing import Any

import numpy as np


class ndarray(np.ndarray):  # noqa: N801 - the name in CuPy
    """An array "on the GPU"."""

    __module__ = "cupy"

    @property
    def __cuda_array_interface__(self) -> Any:
        return self.__array_interface__

    def __dlpack_device__(self) -> Any:
        return 2, 0

    @property
    def __array_namespace__(self) -> Any:
        raise AttributeError("CuPy has none")

    def __array_ufunc__(self, ufunc: Any, method: str, *given: Any, **options: Any) -> Any:
        if "out" in options:
            options["out"] = tuple(map(_plain, options["out"]))
        found = getattr(ufunc, method)(*map(_plain, given), **options)
        return _on_gpu(found)

    def __array_function__(self, function: Any, kinds: Any, given: Any, options: Any) -> Any:
        if function in (np.copy, np.copyto):  # numba's simulator moves arguments
            return function(*map(_plain, given), **options)
        raise TypeError(f"numpy.{function.__name__} got an array on the GPU")


def _plain(value: Any) -> Any:
    """Return an array on the GPU as a plain one; reject others, except numbers."""
    if isinstance(value, ndarray):
        return value.view(np.ndarray)
    if isinstance(value, np.ndarray) and value.ndim:
        raise TypeError("an array of the host meets an array on the GPU")
    return value


def _on_gpu(value: Any) -> Any:
    return value.view(ndarray) if isinstance(value, np.ndarray) else np.asarray(value).view(ndarray)


def _function(name: str) -> Any:
    function = getattr(np, name)
    return lambda *given, **options: _on_gpu(function(*map(_plain, given), **options))


def module() -> Any:
    """Return the module; ``sys.modules["cupy"] = module()`` puts it in the place of CuPy."""
    found: Any = types.ModuleType("cupy")
    found.__getattr__ = _function
    found.asnumpy = lambda value: np.array(_plain(value))
    found.asarray = lambda value: value if isinstance(value, ndarray) else _on_gpu(np.array(value))
    found.from_dlpack = lambda value: value
    return found
