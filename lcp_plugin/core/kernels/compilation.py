"""How kernels are compiled: by numba at their first call, and kept on disk in the user's cache folder.

Python calls a `kernel`. Kernels call helpers: a `helper` stays a function of its own, an `inlined` one becomes a part
of its callers. All of them divide as numpy does, and hold no lock of the interpreter.

The folder is `lcp_plugin` in the place that the operating system has for such files; ``NUMBA_CACHE_DIR`` names another.
numba looks at a kernel's own file to see whether what it kept is still true. The helpers and constants of a kernel
stand in other files, too, so each state of these files has a folder of its own in there.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import lru_cache, partial
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryFile
from threading import local
from typing import Any

from platformdirs import user_cache_path

from ..deadline import NEW_KERNELS, Lock, compiling
from .compiler import config, event, njit

OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}  # C calls none of them
OF_HELPERS: dict[str, Any] = OPTIONS | {"no_cpython_wrapper": True}  # nor Python these
IN_ANY_ORDER = {
    "fastmath": {"reassoc", "contract", "nnan", "nsz"},
    "forceinline": True,
}  # sums of terms, none NaN
ROOM = 2**20  # bytes that a folder must take
_lock = Lock()


class _StoppedClocks(event.Listener):
    """Stops the clocks of all runs around, in the thread that compiles, loads, or waits for another one to do it."""

    def __init__(self, stopped: Any) -> None:
        self._stopped, self._thread = stopped, local()

    def on_start(self, event: Any) -> None:
        if not hasattr(self._thread, "entered"):
            self._thread.entered = []
        entered: AbstractContextManager[None] = self._stopped()
        self._thread.entered.append(entered)
        entered.__enter__()

    def on_end(self, event: Any) -> None:
        if self._thread.entered:  # Ctrl-C may have come as it began
            self._thread.entered.pop().__exit__(None, None, None)


event.register("numba:compiler_lock", _StoppedClocks(compiling))  # type: ignore[no-untyped-call]
event.register("numba:compile", _StoppedClocks(NEW_KERNELS.compiling))  # type: ignore[no-untyped-call]


def cache_folder() -> Path:
    """Return the folder that holds compiled kernels; it may not exist yet."""
    named: str = config.CACHE_DIR  # type: ignore[attr-defined]
    return Path(named) if named else user_cache_path("lcp_plugin", appauthor=False)


def kernel(function: Any) -> Any:
    """Compile a function that Python calls; what it writes to is named in its docstring."""
    with (
        _kept_on_disk() as is_kept,
        suppress(RuntimeError),
    ):  # the function stands in no file, as in a frozen program
        return njit(cache=is_kept, **OPTIONS)(function)
    return njit(**OPTIONS)(function)


def helper(function: Any = None, **options: Any) -> Any:
    """Compile a function that kernels call: not kept by itself, but as a part of these. Python must not call it.

    There is no wrapper that would take Python's objects: a call ends the process.
    """
    return njit(**(OF_HELPERS | options))(function) if function else partial(helper, **options)


def inlined(function: Any) -> Any:
    """Compile a short function that kernels call line by line as if it stood there."""
    return helper(function, inline="always")


@contextmanager
def _kept_on_disk() -> Iterator[bool]:
    """Point numba at our folder while a function is decorated; yield whether that takes files.

    No longer than that: other packages have their own.
    """
    folder = cache_folder() / _state_of_sources()
    with _lock.held():
        before = config.CACHE_DIR  # type: ignore[attr-defined]
        config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
        try:
            yield _takes_files(folder)
        finally:
            config.CACHE_DIR = before  # type: ignore[attr-defined]


@lru_cache
def _takes_files(folder: Path) -> bool:
    """Return whether there is room in the folder; what is compiled is kept nowhere else."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder) as file:
            file.write(bytes(ROOM))
    except OSError:
        return False
    return True


@lru_cache(maxsize=1)
def _state_of_sources() -> str:
    """Return a digest of the files that kernels are made of.

    These are the files of the package that import this one, as functions are compiled there, and the files from which
    they import: the constants of those are compiled, too.
    """
    package = Path(str(sys.modules[__name__.partition(".")[0]].__file__)).parent
    found: set[Path] = set()
    for path in package.rglob("*.py"):
        text = path.read_bytes()
        if b"compilation import" in text:
            found.add(path)
            for dots, module in re.findall(rb"^from (\.+)([\w.]*) import", text, re.MULTILINE):
                found.add(
                    path.parents[len(dots) - 1]
                    .joinpath(*module.decode().split("."))
                    .with_suffix(".py")
                )
    return sha256(
        b"".join(path.read_bytes() for path in sorted(found) if path.is_file())
    ).hexdigest()[:12]
