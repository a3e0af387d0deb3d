"""Compilation of kernels: by numba at the first call, with numba's own cache; the first call also imports numba.

Python calls a `kernel`. Kernels call helpers: a `helper` remains a function, an `inline` function becomes a part of its
callers. All functions divide as numpy does, and release the lock of the interpreter. Import numba's names from here.

numba compiles a kernel again if the kernel's own file has changed. The key of the cache also has the constants and
helpers that the kernel uses from other files.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from functools import cache, cached_property, partial, update_wrapper
from threading import RLock
from typing import Any

import numpy as np

from ..deadline import compilation, pause_for_compilation

__all__ = ["helper", "inline", "kernel", "uintp"]
# C calls none of them
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
OF_HELPERS: dict[str, Any] = OPTIONS | {"no_cpython_wrapper": True}  # nor Python these
LOCK = RLock()

uintp: Any = int  # numba's type in the files whose kernels are compiled


@cache
def _numba() -> Any:
    """Return numba, which counts the seconds that it compiles, or None if it is not installed."""
    try:
        with pause_for_compilation():  # most of a second
            import numba
            from numba.core import event
    except ImportError:
        warnings.warn(
            "numba is not installed: kernels run as Python, which is slower; pip install numba",
            RuntimeWarning,
            stacklevel=2,
        )
        return None

    class Seconds(event.Listener):
        """Sum of the seconds of a thread for compilation, for loading cached code, and for waiting on a thread."""

        def on_start(self, event: object) -> None:
            compilation().begin()

        def on_end(self, event: object) -> None:
            compilation().end()

    event.register("numba:compiler_lock", Seconds())  # type: ignore[no-untyped-call]
    return numba


class Compiled:
    """Function that numba compiles at its first call.

    Parameters
    ----------
    function : callable
    is_cached : bool
        Keep the code in numba's cache if that is possible.
    **options
        Options of numba's ``njit``.
    """

    def __init__(self, function: Any, *, is_cached: bool = False, **options: Any) -> None:
        self.function, self.is_cached, self.options = function, is_cached, options
        self._dispatcher: Any = None
        update_wrapper(self, function)

    def __call__(self, *args: Any) -> Any:
        """Return the value of the function."""
        return self.dispatcher(*args)

    @property
    def py_func(self) -> Any:
        """The function in Python, which names numba's types and functions."""
        return getattr(self.dispatcher, "py_func", self.function)

    @cached_property
    def dispatcher(self) -> Any:
        """Dispatcher of numba for the function; it takes the place of this object in the function's file."""
        with LOCK:
            if self._dispatcher is not None:  # of another thread
                return self._dispatcher
            if (numba := _numba()) is None:
                return np.errstate(all="ignore")(self.function) if self.is_cached else self.function
            self._dispatcher = compiled = self._compiled_by(numba.njit)
            names = self.function.__globals__
            for name, value in list(names.items()):
                if isinstance(value, Compiled):
                    names[name] = value.dispatcher
                elif value is uintp:
                    names[name] = numba.uintp
            return compiled

    def _compiled_by(self, njit: Any) -> Any:
        if self.is_cached:
            with suppress(RuntimeError):  # no directory for a cache
                dispatcher = njit(cache=True, **self.options)(self.function)
                # None with NUMBA_DISABLE_JIT
                if (cache := getattr(dispatcher, "_cache", None)) is not None:
                    cache.save_overload = partial(_save, cache.save_overload)
                    cache._index_key = partial(_key, cache._index_key, uses(self.function))
                return dispatcher
        return njit(**self.options)(self.function)


def _save(save: Any, *compiled: Any) -> None:
    """Write compiled code to the cache; ignore a disk that is full or read-only."""
    with suppress(OSError):
        save(*compiled)


def _key(index_key: Any, used: str, *compiled: Any) -> Any:
    """Return numba's key of compiled code, with the constants and helpers that it uses."""
    return index_key(*compiled), used


def uses(function: Any) -> str:
    """Return the code of a function with the numbers and the code of the helpers that its names refer to.

    Examples
    --------
    >>> def area(r): return PI * r**2
    >>> area.__globals__["PI"] = 3.0
    >>> "PI = 3.0" in uses(area)
    True
    """
    code, text = function.__code__, ""
    for name in code.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, (int, float, tuple, np.generic)):
            text += f"{name} = {value!r}\n"
        elif isinstance(value, Compiled) or hasattr(value, "py_func"):
            text += uses(value.function if isinstance(value, Compiled) else value.py_func)
    return f"{text}{code.co_code.hex()} {[entry for entry in code.co_consts if not hasattr(entry, 'co_code')]}\n"


def kernel(function: object) -> Any:
    """Compile a function that Python calls, and keep the code in numba's cache if that is possible."""
    return Compiled(function, is_cached=True, **OPTIONS)


def helper(function: object = None, **options: Any) -> Any:
    """Compile a function that only kernels call; it is cached as a part of them.

    Python must not call it: without a wrapper for Python objects, a call ends the process.
    """
    if function is None:
        return partial(helper, **options)
    return Compiled(function, **(OF_HELPERS | options))


def inline(function: object) -> Any:
    """Compile a short function whose code is inserted into the kernels that call it."""
    return helper(function, inline="always")
