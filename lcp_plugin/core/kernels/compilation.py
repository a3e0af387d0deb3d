"""Compilation of kernels: by numba at the first call, with numba's own cache.

Python calls a `kernel`. Kernels call helpers: a `helper` remains a function, an `inline` function becomes a part of its
callers. All functions divide as numpy does, and release the lock of the interpreter. Import numba's names from here.

numba compiles a kernel again if the kernel's own file has changed. After a change of a helper or of a constant in
another file, delete the cache: the files ``*.nb?`` in ``__pycache__``, or the folder ``NUMBA_CACHE_DIR``.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from ..deadline import compilation, pause_for_compilation

try:
    with pause_for_compilation():  # most of a second
        from numba import njit, uintp
        from numba.core import event
except ImportError:
    HAS_NUMBA, uintp = False, int  # type: ignore[assignment]
    warnings.warn(
        "numba is not installed: kernels run as Python, which is slower; pip install numba",
        RuntimeWarning,
        stacklevel=2,
    )
else:
    HAS_NUMBA = True

__all__ = ["helper", "inline", "kernel", "uintp"]
# C calls none of them
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
OF_HELPERS: dict[str, Any] = OPTIONS | {"no_cpython_wrapper": True}  # nor Python these


if HAS_NUMBA:

    class _Seconds(event.Listener):
        """Sum of the seconds of a thread for compilation, for loading cached code, and for waiting on a thread."""

        def on_start(self, event: Any) -> None:
            compilation().begin()

        def on_end(self, event: Any) -> None:
            compilation().end()

    event.register("numba:compiler_lock", _Seconds())  # type: ignore[no-untyped-call]


def kernel(function: Any) -> Any:
    """Compile a function that Python calls, and keep the code in numba's cache if that is possible."""
    if not HAS_NUMBA:
        return np.errstate(all="ignore")(function)
    with suppress(RuntimeError):  # no directory for a cache
        compiled = njit(cache=True, **OPTIONS)(function)
        if (cache := getattr(compiled, "_cache", None)) is not None:  # NUMBA_DISABLE_JIT: none
            cache.save_overload = partial(_save, cache.save_overload)
        return compiled
    return njit(**OPTIONS)(function)


def _save(save: Any, *compiled: Any) -> None:
    """Write compiled code to the cache; ignore a disk that is full or read-only."""
    with suppress(OSError):
        save(*compiled)


def helper(function: Any = None, **options: Any) -> Any:
    """Compile a function that only kernels call; it is cached as a part of them.

    Python must not call it: without a wrapper for Python objects, a call ends the process.
    """
    if function is None:
        return partial(helper, **options)
    return njit(**(OF_HELPERS | options))(function) if HAS_NUMBA else function


def inline(function: Any) -> Any:
    """Compile a short function whose code is inserted into the kernels that call it."""
    return helper(function, inline="always")
