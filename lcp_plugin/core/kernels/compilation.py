"""How kernels are compiled: by numba at their first call, once, kept on disk in the user's cache folder.

A kernel is what Python calls. Its parts are functions that only kernels call: these are optimised as a part of the
kernel, and not kept by themselves. No function is compiled twice because one caller's array may be written to and
another's may not. Kernels of the small problems that somebody begins with are not compiled before that pays: their
first calls are interpreted, with the same bits.

The folder is `lcp_plugin` in the place that the operating system has for such files; ``NUMBA_CACHE_DIR`` names another.
Where no folder can be written to, numba keeps the result beside the package or in memory.
"""

from __future__ import annotations

import gc
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache, partial
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from pickle import PickleError
from typing import Any, cast

import numpy as np
from platformdirs import user_cache_path

from ..deadline import NEW_KERNELS, Lock, compiling
from .compiler import (
    Compiler,
    FunctionCache,
    JITCodeLibrary,
    config,
    event,
    njit,
    normalize_signature,
    rtsys,
    to_its_end,
    types,
    vectorize,
)

FEW = 2**12  # numbers in the arrays of a call
_lock = Lock()


class _StoppedClocks(event.Listener):
    """Stops the clocks of all runs around while numba compiles, whatever the kernel; both events have the same data.

    Where Ctrl-C came after its registration, and this file is loaded again, there are two of them.
    """

    def on_start(self, event: Any) -> None:
        event.data[self] = NEW_KERNELS.compiling()
        event.data[self].__enter__()

    def on_end(self, event: Any) -> None:
        event.data[self].__exit__(None, None, None)


event.register("numba:compile", _StoppedClocks())  # type: ignore[no-untyped-call]


def cache_folder() -> Path:
    """Return the folder that holds compiled kernels; it may not exist yet."""
    named: str = config.CACHE_DIR  # type: ignore[attr-defined]
    return Path(named) if named else user_cache_path("lcp_plugin", appauthor=False)


def compiled_in_any_order(function: Any) -> Any:
    """Compile a part of kernels whose sums may be taken in another order, and whose numbers are never NaN.

    The order is fixed when it is compiled: the same call gives the same bits.
    """
    return compiled_part(function, fastmath={"reassoc", "contract", "nnan", "nsz"}, forceinline=True)


def interpreted_while_small(function: Any, *, longest: float = np.inf, numbers: int = FEW) -> Any:
    """Compile a kernel as `compiled` does once a call is large, or many have been interpreted; the bits are the same.

    A kernel that lies on disk is loaded. Calls with an axis above `longest` are compiled: where sums of more terms may
    be taken in another order, or where work grows faster than the numbers in the arrays. Those with more than `numbers`
    numbers in their arrays are compiled, too.
    """
    return compiled(function, longest, numbers)


def compiled_into_others(function: Any) -> Any:
    """Compile a short part of kernels: on a few unknowns a call costs more than what it does."""
    return compiled_part(function, forceinline=True)


def compiled_for_rows(by_arrays: Callable[..., Any]) -> Callable[[Any], Any]:
    """Compile a short part of kernels that works on a row; where kernels are interpreted, `by_arrays` does it at once.

    Both give the same bits: sums are taken in the same order.
    """

    def decorate(function: Any) -> Any:
        part = compiled_part(function, forceinline=True)
        if not hasattr(part, "compile"):
            return by_arrays
        part._compile_for_args = lambda *_, **__: by_arrays
        return part

    return decorate


def compiled_in_place(function: Any) -> Any:
    """Compile a part of one kernel or two, line by line as if it stood there."""
    return compiled_part(function, inline="always")


class _PartLibrary(JITCodeLibrary):
    """The code of a part: optimised where it is used, and no machine code of its own."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()  # type: ignore[no-untyped-call]
        return 0

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Leave out what numba does for functions that Python calls."""


class _PartCompiler(Compiler):
    def __init__(self, typing: Any, target: Any, library: Any, *others: Any) -> None:
        library = library or _PartLibrary(target.codegen(), "part")  # type: ignore[no-untyped-call]
        super().__init__(typing, target, library, *others)  # type: ignore[no-untyped-call]


class _ApartLibrary(_PartLibrary):
    """The code of a part that stays a function: where it is inlined, LLVM forgets that its arrays share no memory."""

    def add_ir_module(self, ir_module: Any) -> None:
        for function in ir_module.functions:
            if not function.is_declaration:
                function.attributes.add("noinline")
        super().add_ir_module(ir_module)  # type: ignore[no-untyped-call]


class _ApartCompiler(Compiler):
    """Tells LLVM that the arrays of a call share no memory: it can check that at run time for few of them only."""

    def __init__(
        self, typing: Any, target: Any, library: Any, args: Any, result: Any, flags: Any, *others: Any
    ) -> None:
        library = library or _ApartLibrary(target.codegen(), "part")  # type: ignore[no-untyped-call]
        flags = flags.copy()
        flags.noalias = True
        super().__init__(typing, target, library, args, result, flags, *others)  # type: ignore[no-untyped-call]


def compiled_on_arrays_apart(function: Any) -> Any:
    """Compile a part of kernels whose inner loops run on several numbers at a time; what it writes to is given once."""
    return compiled_part(function, pipeline_class=_ApartCompiler)


@compiling()
def compiled_part(function: Any, **options: Any) -> Any:
    """Compile a part of kernels."""
    options = {"pipeline_class": _PartCompiler, **options, "_nrt": False}
    options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = njit(nogil=True, error_model="numpy", **options)(function)
    if hasattr(dispatcher, "compile"):  # it has none where numba is told not to compile
        dispatcher._insert = lambda *_: None  # there is no machine code that Python could call
        dispatcher._compile_for_args = lambda *_, **__: function
    return _as_one_type(dispatcher)


@compiling()
def compiled(function: Any, longest: float = 0.0, numbers: int = FEW) -> Any:
    """Compile on first use: no lock of the interpreter held, divisions by zero as in numpy."""
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    dispatcher = njit(**options)(function)
    if hasattr(dispatcher, "compile"):
        with suppress(Exception), _kept_in(cache_folder()):  # numba finds no place, or what lies there is damaged
            dispatcher._cache = _KeptCode(function)
        compile_for, dispatcher.is_patient = dispatcher._compile_for_args, longest > 0.0

        def of_arguments(*arguments: Any) -> Any:
            if longest and _may_be_interpreted(dispatcher, arguments, longest, numbers):
                return partial(_interpret, function)
            with compiling(), _without_collector():  # or loading
                if not _is_set_up:
                    _set_up(dispatcher.targetctx, is_kept=_is_kept(dispatcher, arguments))
                return compile_for(*arguments)

        dispatcher._compile_for_args = of_arguments
    return _as_one_type(dispatcher)


LONGEST_IN_ORDER = 64  # terms of a sum in one order for the interpreter and the compiler; of more, in any order
NEEDED_BY_KEPT_CODE = "numba.np.arrayobj"  # and what this imports
PATIENCE = 1.0  # seconds that a process interprets before it compiles: about as long as a kernel or two are compiled
_interpreted = [0.0]
_is_set_up: list[bool] = []  # numba's tables of what it knows to compile, which its first compilation fills


def _set_up(target: Any, *, is_kept: bool) -> None:
    """Let numba fill its tables, once: of two threads that begin to, one would compile by half of them.

    Kept code needs some of its modules alone. Ctrl-C may interrupt neither: what a module has entered into the tables
    by then, it refuses to enter again.
    """
    with _lock.held():
        if is_kept:
            if NEEDED_BY_KEPT_CODE not in sys.modules:
                to_its_end(partial(import_module, NEEDED_BY_KEPT_CODE))
        elif not _is_set_up:
            to_its_end(target.refresh)  # before numba takes its lock, which this does as well
            _is_set_up.append(True)


def _may_be_interpreted(dispatcher: Any, arguments: tuple[Any, ...], longest: float, numbers: int) -> bool:
    arrays = [argument for argument in arguments if isinstance(argument, np.ndarray)]
    is_small = sum(array.size for array in arrays) <= numbers
    is_short = all(max(array.shape, default=0) <= longest for array in arrays)
    return is_small and is_short and _interpreted[0] < PATIENCE and not _is_kept(dispatcher, arguments)


def _is_kept(dispatcher: Any, arguments: tuple[Any, ...]) -> bool:
    """Return whether the code for arguments like these lies on disk."""
    try:
        signature = tuple(_plain(dispatcher.typeof_pyval(argument)) for argument in arguments)
        key = dispatcher._cache._index_key(signature, dispatcher.targetctx.codegen())
        return key in dispatcher._cache._cache_file._load_index()
    except Exception:  # there is no disk, or what lies there is damaged
        return False


def _interpret(function: Any, *arguments: Any) -> Any:
    """Run a kernel as Python, off the clocks of all runs around as its compilation would be."""
    began = time.perf_counter()
    with compiling(), np.errstate(all="ignore"):
        found = function(*arguments)
    _interpreted[0] += time.perf_counter() - began
    return found


@contextmanager
def _without_collector() -> Iterator[None]:
    """Leave out the collection of garbage: numba makes none, and is searched for it a tenth of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@contextmanager
def compiling_at_once() -> Iterator[None]:
    """Interpret nothing inside a ``with`` statement."""
    before, _interpreted[0] = _interpreted[0], PATIENCE
    try:
        yield
    finally:
        _interpreted[0] = before


def _as_one_type(dispatcher: Any) -> Any:
    """Let all arguments that differ in no more than a constant, or in whether an array may be written to, use one code.

    numba would compile another one for every constant, for the first value of a variable in a loop, too, and for every
    mixture of arrays that are read-only and not. What a kernel writes to is named in its docstring.
    """
    if not hasattr(dispatcher, "compile"):
        return dispatcher
    template, compile_for = dispatcher.get_call_template, dispatcher.compile
    known: dict[tuple[int, ...], object] = {}

    def of_types(arguments: Any, named: Any) -> Any:
        return template(tuple(map(_plain, arguments)), {name: _plain(kind) for name, kind in named.items()})

    def compile_once(signature: Any) -> Any:
        arguments, _ = normalize_signature(signature)  # type: ignore[no-untyped-call]
        plain = tuple(map(_plain, arguments))
        entry, mine = compile_for(plain), object()
        codes = tuple(kind._code for kind in arguments)
        # Two threads may ask at once. Of what was entered twice numba takes neither, and asks again at every call.
        if plain != arguments and known.setdefault(codes, mine) is mine:
            dispatcher._insert(list(codes), entry, False)
        return entry

    dispatcher.get_call_template, dispatcher.compile = of_types, compile_once
    return dispatcher


def _plain(kind: Any) -> Any:
    kind = cast(Any, types.unliteral)(kind)
    if isinstance(kind, types.BaseTuple):
        return types.BaseTuple.from_types(tuple(_plain(part) for part in kind.types))  # type: ignore[no-untyped-call, attr-defined]
    return kind.copy(readonly=False) if isinstance(kind, types.Array) and not kind.mutable else kind


def compiled_elementwise(function: Any) -> Any:
    """Compile a function of two numbers into one of two arrays, at its first call."""

    @cache
    def kernel() -> Any:
        with suppress(Exception), _kept_in(cache_folder()):
            return vectorize(["float64(float64, float64)"], cache=True)(function)  # type: ignore[no-untyped-call]
        return vectorize(["float64(float64, float64)"])(function)  # type: ignore[no-untyped-call]

    def called(a: Any, b: Any) -> Any:
        return kernel()(a, b)

    return called


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
    """Return the date and size of every file that kernels are made of.

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
                found.add(path.parents[len(dots) - 1].joinpath(*module.decode().split(".")).with_suffix(".py"))
    stats = (path.stat() for path in sorted(found) if path.is_file())
    return tuple((stat.st_mtime_ns, stat.st_size) for stat in stats)


def _save(file: Any, key: Any, data: Any) -> None:
    """Keep compiled code in a file that is called by what it was compiled for, and enter it into the index."""
    name = file._data_name(int(sha256(repr(key).encode()).hexdigest()[:12], 16))
    file._save_data(name, data)
    overloads = file._load_index()
    if overloads.get(key) != name:
        file._save_index({**overloads, key: name})


class _KeptCode(FunctionCache):
    """numba's cache of one function; a full disk or a damaged file costs a compilation, not the run.

    What is kept is used while no file of kernels has changed: numba itself looks at the function's own file only, and
    would go on with what another one was before. And it numbers what it keeps: of two processes that compile a function
    for different types at the same time, each would give its code the same file, and one would run that of the other.
    """

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        file: Any = self._cache_file
        file._source_stamp = file._source_stamp, _sources()
        file.save = partial(_save, file)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return the code that is kept, or None; no rules of compilation are loaded for it, which takes a tenth of 1 s.

        numba loads those of all that it knows to compile before it looks; whatever it compiles, it loads them then.
        """
        try:
            rtsys.initialize(target_context)  # what compiled code may call
            return self._load_overload(signature, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # a damaged file raises whatever its decoders raise
            return None

    def save_overload(self, signature: Any, data: Any) -> None:
        with suppress(OSError):
            try:
                super().save_overload(signature, data)  # type: ignore[no-untyped-call]
            except (EOFError, ValueError, PickleError):  # the index of what is there is damaged: begin a new one
                self.flush()  # type: ignore[no-untyped-call]
                super().save_overload(signature, data)  # type: ignore[no-untyped-call]
