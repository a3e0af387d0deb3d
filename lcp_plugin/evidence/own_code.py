"""What a study runs of somebody else: problems as functions, and where a mistake in them or in a method lies."""

from __future__ import annotations

import hashlib
import inspect
import sys
import sysconfig
import traceback
from pathlib import Path
from typing import Any

from ..core.errors import InvalidOption, LCPError
from ..core.kinds import refusal
from ..core.lcp import LCP
from ..gallery.scene import Scene

OURS = (str(Path(__file__).parents[1]), *(sysconfig.get_paths()[name] for name in ("stdlib", "purelib", "platlib")))


def told(error: BaseException) -> str:
    """Return an error in one line, with the last line of somebody else's code that it passed."""
    words = " ".join(str(error).split())
    if isinstance(error, LCPError):
        return words
    if isinstance(error, SyntaxError) and error.filename:
        return f"{Path(error.filename).name}, line {error.lineno}: {error.msg}: {(error.text or '').strip()}"
    said = f"{type(error).__name__}: {words}" if words else type(error).__name__
    last = own_frame(error)
    if last is None:
        return said
    return f"{Path(last.filename).name}, line {last.lineno}, in {last.name}: {said}: {last.line}"


def own_frame(error: BaseException) -> traceback.FrameSummary | None:
    """Return the last frame of an error that is neither ours nor a library's, None where there is none."""
    frames = traceback.extract_tb(error.__traceback__)
    return next((one for one in reversed(frames) if not one.filename.startswith((*OURS, "<"))), None)


def own_source(thing: Any) -> str:
    """Return a hash of the file that an object's class comes from, where that is neither ours nor a library's."""
    if isinstance(thing, str):
        return ""
    path = getattr(sys.modules.get(type(thing).__module__), "__file__", None)
    if path is None or path.startswith(OURS) or not Path(path).is_file():
        return ""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def as_scene_of(given: Any, name: str, size: int | None) -> Scene:
    """Return the scene that a problem, or a function of the size, or (M, q) means.

    Raises
    ------
    InvalidOption
        Where it is nothing of that, or a size is given to what has one.
    """
    if isinstance(given, LCP | Scene | tuple) and size is not None:
        raise InvalidOption(f"{name} is one problem and has its size; leave sizes out, or give a function of the size")
    if callable(given) and not isinstance(given, type):
        arguments = () if size is None else (size,)
        try:
            inspect.signature(given).bind(*arguments)
        except TypeError as error:
            needs = "needs a size (sizes=[100], --size 100)" if size is None else f"does not take the size {size}"
            raise InvalidOption(f"{name} {needs}, or its parameters, {name}:key=value: {error}") from None
        given = given(*arguments)
    if isinstance(given, tuple) and 2 <= len(given) <= 4:
        given = LCP(given[0], given[1], **dict(zip(("lower", "upper"), given[2:], strict=False)))
    if isinstance(given, LCP):
        return Scene(problem=given, name=name, is_declared=False)
    if isinstance(given, Scene):
        return given
    raise InvalidOption(f'{refusal("study", given)}; {name} may also be a scene, (M, q), or a function of the size')
