"""Problems and methods of one's own on the command line: ``module:name`` and ``file.py:name``."""

from __future__ import annotations

import ast
import contextlib
import importlib
import inspect
import re
import sys
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..core.algorithms import Algorithm, made
from ..core.errors import InvalidOption, LCPError, did_you_mean
from ..evidence.own_code import as_scene_of, told
from ..gallery.scene import Scene

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
    if not settings:
        return found
    given = _settings(settings[0])
    try:
        inspect.signature(found).bind_partial(**given)
    except TypeError as error:
        raise InvalidOption(f"{place}:{name} does not take {given}: {error}") from None
    return partial(found, **given)


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
        raise InvalidOption(f"no file {place!r} in {Path.cwd()}; write file.py:name, or module:name")
    folder, name = (str(Path(place).resolve().parent), _module_name(place)) if is_file else (str(Path.cwd()), place)
    sys.path.insert(0, folder)
    try:
        if not is_file:
            return importlib.import_module(name)
        sys.modules.pop(name, None)  # of another folder
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name == name.partition(".")[0]:
            raise InvalidOption(f"no module {place!r} in {Path.cwd()} or installed; write file.py:name") from None
        raise InvalidOption(f"{place}: {told(error)}") from error
    except Exception as error:  # whatever a module of somebody else raises
        raise InvalidOption(f"{place}: {told(error)}") from error
    finally:
        sys.path.remove(folder)
        if folder not in sys.path:  # for what its functions import when they are called
            sys.path.append(folder)


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
