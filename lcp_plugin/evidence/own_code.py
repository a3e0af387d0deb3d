"""Problems and methods of one's own, named ``module:name`` or ``file.py:name``, and where a mistake in them lies."""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib
import importlib.util
import inspect
import re
import sys
import sysconfig
import traceback
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..algorithms import Algorithm, made
from ..errors import InvalidOption, LCPError, did_you_mean
from ..kinds import refusal
from ..problem.lcp import LCP
from .gallery.scene import Scene

OURS = (str(Path(__file__).parents[1]), *(sysconfig.get_paths()[name] for name in ("stdlib", "purelib", "platlib")))
_OWN = re.compile(r"([^:]+\.py|[^\W\d]\w*(\.\w+)*):[^\W\d]\w*(:.*)?")


def is_own(text: str) -> bool:
    """Return whether the text has the form ``module:name`` or ``file.py:name``, with ``:key=value,…`` or without.

    Examples
    --------
    >>> is_own("mine:Fast"), is_own("lib/mine.py:family:n=9"), is_own("obstacle_2d:size=9"), is_own("psor")
    (True, True, False, False)
    """
    return _OWN.fullmatch(text) is not None


def name_in(text: str) -> str:
    """Return the name behind the module."""
    return text.split(":")[1]


def load(text: str) -> Any:
    """Return what a module calls by that name, with the settings if there are any; modules in this folder are found.

    Raises
    ------
    InvalidOption
        Where there is no such module or name, or the module itself has a mistake, with its line.
    """
    place, name, *settings = text.split(":", 2)
    module = sys.modules.get(_module_name(place)) if place.endswith(".py") else None
    if module is None or getattr(module, "__file__", None) != str(Path(place).resolve()):
        module = _imported(place)
    if not hasattr(module, name):
        known = [word for word, thing in vars(module).items() if getattr(thing, "__module__", "") == module.__name__]
        raise InvalidOption(f"{place} has no {name!r}{did_you_mean(name, known)}")
    found = getattr(module, name)
    return partial(found, **_settings(settings[0])) if settings else found


def _settings(text: str) -> dict[str, Any]:
    given = {}
    for setting in filter(None, map(str.strip, text.split(","))):
        key, equals, value = setting.partition("=")
        if not equals or not key.isidentifier():
            raise InvalidOption(f"{setting!r} has no form key=value; write file.py:function:key=value,key=value")
        given[key] = value
        with contextlib.suppress(ValueError, SyntaxError):  # a word
            given[key] = ast.literal_eval(value)
    return given


def _module_name(place: str) -> str:
    return Path(place).stem


def _imported(place: str) -> Any:
    is_file = place.endswith(".py")
    if is_file and not Path(place).is_file():
        raise InvalidOption(f"no file {place!r} in {Path.cwd()}; write file.py:name, or module:name of what is installed")
    folder, name = (str(Path(place).resolve().parent), _module_name(place)) if is_file else (str(Path.cwd()), place)
    sys.path.insert(0, folder)
    try:
        if not is_file:
            return importlib.import_module(name)
        specification = importlib.util.spec_from_file_location(name, Path(place).resolve())
        module = importlib.util.module_from_spec(specification)  # type: ignore[arg-type] - a .py file has one
        sys.modules[name] = module  # dataclasses look their module up
        try:
            specification.loader.exec_module(module)  # type: ignore[union-attr]
        except BaseException:
            del sys.modules[name]
            raise
        return module
    except ModuleNotFoundError as error:
        if error.name == name.partition(".")[0]:
            raise InvalidOption(f"no module {place!r} in {Path.cwd()} or installed; write file.py:name") from None
        raise InvalidOption(f"{place}: {told(error)}") from error
    except Exception as error:  # whatever a module of somebody else raises
        raise InvalidOption(f"{place}: {told(error)}") from error
    finally:
        sys.path.remove(folder)


def told(error: BaseException) -> str:
    """Return an error in one line, with the last line of somebody else's code that it passed."""
    words = " ".join(str(error).split())
    if isinstance(error, LCPError):
        return words
    if isinstance(error, SyntaxError) and error.filename:
        return f"{Path(error.filename).name}, line {error.lineno}: {error.msg}: {(error.text or '').strip()}"
    said = f"{type(error).__name__}: {words}" if words else type(error).__name__
    last = own_frame(error)
    return said if last is None else f"{Path(last.filename).name}, line {last.lineno}, in {last.name}: {said}: {last.line}"


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


def algorithm_of(text: str, options: Mapping[str, Any]) -> Algorithm:
    """Return the algorithm ``module:Class`` with these options, or the object that a module holds.

    Raises
    ------
    InvalidOption
        Where it is no algorithm, has no name, or does not take the options.
    """
    found = load(text)
    if isinstance(found, Algorithm) and not options:
        return found
    if not (isinstance(found, type) and issubclass(found, Algorithm)):
        raise InvalidOption(
            f"{text} must be a class below lcp_plugin.algorithms.Algorithm, got {type(found).__name__}"
            f"{'; an object has its options already' if isinstance(found, Algorithm) else ''}"
        )
    if not getattr(found, "name", ""):
        raise InvalidOption(f'{text} has no name; write name = "{found.__name__.lower()}" in the class')
    if options and not (is_dataclass(found) and vars(found).get("__dataclass_fields__")):
        raise InvalidOption(f"{text} has no options, got {sorted(options)}; a dataclass has those that it declares")
    try:
        return made(found, found.name, dict(options))
    except TypeError as error:
        raise InvalidOption(f"{text}: {error}") from error


def scene_of(text: str, size: int | None) -> Scene:
    """Return the problem that ``module:function`` returns for a size, or that a module holds.

    Raises
    ------
    InvalidOption
        Where the function raises anything, with its line, or returns no problem.
    """
    try:
        return as_scene_of(load(text), name_in(text), size)
    except LCPError:
        raise
    except Exception as error:  # whatever somebody else's function raises
        raise InvalidOption(f"{text}: {told(error)}") from error


def as_scene_of(given: Any, name: str, size: int | None) -> Scene:
    """Return the scene that a problem, or a function of the size, or (M, q) means.

    Raises
    ------
    InvalidOption
        Where it is nothing of that, or a size is given to what has one.
    """
    if isinstance(given, LCP | Scene) and size is not None:
        raise InvalidOption(f"{name} is one problem and has its size; leave sizes out, or give a function of the size")
    if callable(given) and not isinstance(given, type):
        arguments = () if size is None else (size,)
        try:
            inspect.signature(given).bind(*arguments)
        except TypeError as error:
            needs = "needs a size, give one" if size is None else f"does not take the size {size}"
            raise InvalidOption(f"{name} {needs}, or its parameters, {name}:key=value: {error}") from None
        given = given(*arguments)
    if isinstance(given, tuple) and 2 <= len(given) <= 4:
        given = LCP(given[0], given[1], **dict(zip(("lower", "upper"), given[2:], strict=False)))
    if isinstance(given, LCP):
        return Scene(problem=given, name=name, is_declared=False)
    if isinstance(given, Scene):
        return given
    raise InvalidOption(f'{refusal("study", given)}; {name} may also be a scene, (M, q), or a function of the size')
