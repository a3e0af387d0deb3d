"""How kernels are compiled: by numba at their first call, kept on disk in the user's cache folder.

The folder is `lcp_plugin` in the place that the operating system has for such files; ``NUMBA_CACHE_DIR`` names another.
Where no folder can be written to, numba keeps the result beside the package or in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from hashlib import sha256
from pathlib import Path
from pickle import PickleError
from threading import local
from typing import Any, cast

from numba import config, njit, types, vectorize
from numba.core import event
from platformdirs import user_cache_path

from ..deadline import NEW_KERNELS
from ..locks import Lock

_lock = Lock()


class _StoppedClocks(event.Listener):
    """Stops the clocks of all runs around while numba compiles, whatever the kernel."""

    def __init__(self) -> None:
        self._under_way = local()

    def on_start(self, event: Any) -> None:
        stack = self._under_way.__dict__.setdefault("stack", [])
        stack.append(NEW_KERNELS.compiling())
        stack[-1].__enter__()

    def on_end(self, event: Any) -> None:
        self._under_way.stack.pop().__exit__(None, None, None)


event.register("numba:compile", _StoppedClocks())  # type: ignore[no-untyped-call]


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


def interpreted_while_small(function: Any) -> Any:
    """Compile on first use."""
    return _compiled(function)


def compiled_part(function: Any) -> Any:
    """Compile a part of kernels."""
    return _compiled(function)


def compiled_into_others(function: Any) -> Any:
    """Compile a short function that other kernels call: on a few unknowns a call costs more than what it does."""
    return _compiled(function, forceinline=True)


def compiled_in_place(function: Any) -> Any:
    """Compile a function as a part of the only kernel that calls it: neither is optimised twice."""
    return _compiled(function, inline="always")


def _compiled(function: Any, **options: Any) -> Any:
    dispatcher = _kept(lambda cache: njit(cache=cache, nogil=True, error_model="numpy", **options)(function))
    if hasattr(dispatcher, "_cache"):  # there is none where numba is told not to compile
        dispatcher._cache = _ForgivingCache(dispatcher._cache)
        _forget_constants(dispatcher)
    return dispatcher


def _forget_constants(dispatcher: Any) -> None:
    """Let a call with a constant use the kernel for variables: numba would compile another one for every constant.

    It would do so for the first value of a variable in a loop, too, while the first small problem of an installation
    waits.
    """
    resolve, plain = dispatcher.get_call_template, cast(Any, types.unliteral)

    def of_types(arguments: Any, named: Any) -> Any:
        return resolve(tuple(map(plain, arguments)), {name: plain(kind) for name, kind in named.items()})

    dispatcher.get_call_template = of_types


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


@lru_cache(maxsize=1)
def _sources() -> tuple[tuple[int, int], ...]:
    """Return the date and size of every file of kernels."""
    stats = (path.stat() for path in sorted(Path(__file__).parent.glob("*.py")))
    return tuple((stat.st_mtime_ns, stat.st_size) for stat in stats)


def _save(file: Any, key: Any, data: Any) -> None:
    """Keep compiled code in a file that is called by what it was compiled for, and enter it into the index."""
    name = file._data_name(int(sha256(repr(key).encode()).hexdigest()[:12], 16))
    file._save_data(name, data)
    overloads = file._load_index()
    if overloads.get(key) != name:
        file._save_index({**overloads, key: name})


class _ForgivingCache:
    """numba's cache of one function; a full disk or a damaged file costs a compilation, not the run.

    What is kept is used while no file of kernels has changed: numba itself looks at the function's own file only, and
    would go on with what another one was before. And it numbers what it keeps: of two processes that compile a function
    for different types at the same time, each would give its code the same file, and one would run that of the other.
    """

    def __init__(self, cache: Any) -> None:
        self._cache = cache
        with suppress(AttributeError, OSError):
            file = cache._cache_file
            file._source_stamp = file._source_stamp, _sources()
            file.save = partial(_save, file)

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
