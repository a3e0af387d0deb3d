"""How kernels are compiled: by numba at their first call, kept on disk in the user's cache folder.

The folder is `lcp_plugin` in the place that the operating system has for such files; ``NUMBA_CACHE_DIR`` names another.
Where no folder can be written to, numba keeps the result beside the package or in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from pickle import PickleError
from typing import Any

from numba import config, njit, vectorize
from platformdirs import user_cache_path

from ..locks import Lock

_lock = Lock()


def cache_folder() -> Path:
    """Return the folder that holds compiled kernels; it may not exist yet."""
    named: str = config.CACHE_DIR  # type: ignore[attr-defined]
    return Path(named) if named else user_cache_path("lcp_plugin", appauthor=False)


def compiled(function: Any) -> Any:
    """Compile on first use: no lock of the interpreter held, divisions by zero as in numpy."""
    return _compiled(function)


def compiled_in_any_order(function: Any) -> Any:
    """Compile a function whose sums may be taken in another order, and whose numbers are never NaN.

    The order is fixed when it is compiled: the same call gives the same bits.
    """
    return _compiled(function, fastmath={"reassoc", "contract", "nnan", "nsz"}, forceinline=True)


def compiled_into_others(function: Any) -> Any:
    """Compile a short function that other kernels call: on a few unknowns a call costs more than what it does."""
    return _compiled(function, forceinline=True)


def _compiled(function: Any, **options: Any) -> Any:
    dispatcher = _kept(lambda cache: njit(cache=cache, nogil=True, error_model="numpy", **options)(function))
    if hasattr(dispatcher, "_cache"):  # there is none where numba is told not to compile
        dispatcher._cache = _ForgivingCache(dispatcher._cache)
    return dispatcher


def compiled_elementwise(function: Any) -> Any:
    """Compile a function of two numbers into one of two arrays, at once."""
    return _kept(lambda cache: vectorize(["float64(float64, float64)"], cache=cache)(function))  # type: ignore[no-untyped-call]


def _kept(decorate: Callable[[bool], Any]) -> Any:
    try:
        with _kept_in(cache_folder()):
            return decorate(True)
    except Exception:  # numba found no place for its cache, the disk is full, or what lies there is damaged
        return decorate(False)


@contextmanager
def _kept_in(folder: Path) -> Iterator[None]:
    """Point numba at the folder while a function is decorated, and no longer: other packages have their own."""
    with _lock.held():
        before = config.CACHE_DIR  # type: ignore[attr-defined]
        config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
        try:
            yield
        finally:
            config.CACHE_DIR = before  # type: ignore[attr-defined]


class _ForgivingCache:
    """numba's cache of one function; a full disk or a damaged file costs a compilation, not the run."""

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        try:
            return self._cache.load_overload(signature, target_context)
        except Exception:  # a damaged file raises whatever its decoders raise
            return None

    def save_overload(self, signature: Any, data: Any) -> None:
        with suppress(OSError):
            try:
                self._cache.save_overload(signature, data)
            except (EOFError, ValueError, PickleError):  # the index of what is there is damaged: begin a new one
                self._cache.flush()
                self._cache.save_overload(signature, data)
