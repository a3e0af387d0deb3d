"""What a command works on: a file, a folder or a scene; and what there is of algorithms and scenes.

Problems and methods of one's own on the command line: ``module:name`` and ``file.py:name``.
"""

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

from ..algorithms import made
from ..core.algorithm import Algorithm
from ..core.errors import InvalidOption, LCPError, did_you_mean
from ..core.kind import refusal
from ..core.lcp import LCP
from ..evidence.contestants import as_scene_of, error_line
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
        known = [
            word
            for word, thing in vars(module).items()
            if getattr(thing, "__module__", "") == module.__name__
        ]
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
            raise InvalidOption(
                f"{setting!r} has no form key=value; write file.py:function:key=value,key=value"
            )
        given[key] = value
        with contextlib.suppress(ValueError, SyntaxError):  # a word
            given[key] = ast.literal_eval(value)
    return given


def _module_name(place: str) -> str:
    return Path(place).stem


def _imported(place: str) -> Any:
    is_file = place.endswith(".py")
    if is_file and not Path(place).is_file():
        raise InvalidOption(
            f"no file {place!r} in {Path.cwd()}; write file.py:name, or module:name"
        )
    folder, name = (
        (str(Path(place).resolve().parent), _module_name(place))
        if is_file
        else (str(Path.cwd()), place)
    )
    sys.path.insert(0, folder)
    try:
        if not is_file:
            return importlib.import_module(name)
        sys.modules.pop(name, None)  # of another folder
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name == name.partition(".")[0]:
            raise InvalidOption(
                f"no module {place!r} in {Path.cwd()} or installed; write file.py:name"
            ) from None
        raise InvalidOption(f"{place}: {error_line(error)}") from error
    except Exception as error:  # whatever a module of somebody else raises
        raise InvalidOption(f"{place}: {error_line(error)}") from error
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
        raise InvalidOption(
            f'{text} has no name; write name = "{found.__name__.lower()}" in the class'
        )
    if options and not (is_dataclass(found) and vars(found).get("__dataclass_fields__")):
        raise InvalidOption(
            f"{text} has no options, got {sorted(options)}; a dataclass has those that it declares"
        )
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
        raise InvalidOption(f"{text}: {error_line(error)}") from error


def read_target(target: str, way: str, size: int | None = None) -> tuple[LCP, Any]:
    """Return (problem, None) of a file or (problem, scene) of a scene's name; of another kind what to write instead."""
    from .. import gallery

    if (own := own_scene(target, size)) is not None:
        return own.problem, own
    if (text := scene_text(target, size)) is None:
        return lcp_of_file(target, way), None
    scene = gallery.parse(text)
    return scene.problem, scene


def own_scene(target: str, size: int | None = None) -> Any:
    """Return what ``file.py:function`` or ``module:function`` builds, None where the target has another form.

    Raises
    ------
    InvalidOption
        Where there is no such function, or it has a mistake, with its line.
    """
    return scene_of(target, size) if is_own_problem(target) else None


def is_own_problem(target: str) -> bool:
    """Return whether the target is written ``file.py:function`` or ``module:function``, and no scene."""
    from .. import gallery

    return (
        is_own(target) and target.partition(":")[0].strip().replace("-", "_") not in gallery.names()
    )


def own_algorithm(name: str, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the algorithm and its options as `solve` takes them, of ``file.py:Class`` an object that has them."""
    return (algorithm_of(name, options), {}) if is_own(name) else (name, options)


def lcp_of_file(path: str, way: str) -> LCP:
    """Return the LCP of a file; raise InvalidOption in the words of the table of kinds where it states another."""
    from ..interfaces.program_files import load_problem

    problem = load_problem(path)
    if not isinstance(problem, LCP):
        raise InvalidOption(f"{path}: {refusal(way, problem)}")
    return problem


def scene_text(target: str, size: int | None = None) -> str | None:
    """Return what `gallery.parse` reads, name:key=value,…, or None where the target is or looks like a path.

    The name may be written with dashes; a size given beside the target becomes the scene's.

    Raises
    ------
    InvalidOption
        Where the target is neither, or the size is given twice, or beside a file.
    """
    from .. import gallery

    name, _, settings = target.strip().partition(":")
    name = name.strip().replace("-", "_")
    if name not in gallery.names():
        if not (
            set(target) & set("/\\.") or Path(target).exists() or Path(f"{target}M.mtx").exists()
        ):
            hint = did_you_mean(name, gallery.names(), is_listed=True)
            raise InvalidOption(f"{target!r} is neither a file nor a scene{hint}")
        if size is not None:
            raise InvalidOption(
                f"--size {size} is for a scene, but {target!r} is none; leave it out"
            )
        return None
    given = [setting for setting in settings.split(",") if setting.strip()]
    if size is not None:
        if any(setting.partition("=")[0].strip() == "size" for setting in given):
            raise InvalidOption(
                f"the size is given twice, in {target!r} and as --size {size}; once is enough"
            )
        given.append(f"size={size}")
    return f"{name}:{','.join(given)}" if given else name


def scene_names(incomplete: str) -> list[str]:
    """Return the scenes that begin so."""
    from .. import gallery

    return [
        name for name in gallery.names() if name.startswith(incomplete)
    ]  # none of them: the shell tries files


def algorithm_names(incomplete: str) -> list[str]:
    """Return the algorithms that begin so, those of other packages too."""
    from ..algorithms import REGISTRY, from_other_packages
    from ..engines import ENGINES

    return [
        name
        for name in ("auto", *REGISTRY, *ENGINES, *from_other_packages())
        if name.startswith(incomplete)
    ]


def print_everything() -> None:
    """Print kinds of problems by the ways that take them, algorithms and engines with needs and sources, scenes."""
    from ..algorithms import REGISTRY, algorithm_class, from_other_packages
    from ..core.algorithm import Algorithm
    from ..core.kind import WAYS
    from ..engines import ENGINES, engine_class
    from ..gallery import describe
    from ..kinds import KINDS
    from ..problems.cones.methods import METHODS
    from .terminal import console, table

    foreign = from_other_packages()
    offers = {**{name: algorithm_class(name) for name in REGISTRY}, **foreign}
    kinds = {name: kind for name, kind in offers.items() if not isinstance(kind, LCPError)}
    engines = [engine_class(name) for name in ENGINES]
    every: tuple[Any, ...] = *kinds.values(), *METHODS.values(), *engines
    references = dict.fromkeys(
        kind.reference for kind in every if kind.reference != Algorithm.reference
    )
    sources = {reference: f"[{k}]" for k, reference in enumerate(references, start=1)}
    headings = ("name", "needs", "proved to converge on", "an iteration costs", "source")
    algorithms, over_cones = (
        [
            (name, kind.needs, kind.solves, kind.cost, sources.get(kind.reference, kind.reference))
            for name, kind in some.items()
        ]
        for some in (kinds, METHODS)
    )
    of_others = [
        (one.name, one.solves, one.cost, one.obeys, sources[one.reference]) for one in engines
    ]
    scenes = [
        (name, summary, ", ".join(f"{key}={value}" for key, value in parameters.items()))
        for name, summary, parameters in describe()
    ]
    terminal = console(160)
    ways = [(way, *("✓" if way in kind.ways else "–" for kind in KINDS)) for way in WAYS]
    words = ("", *(kind.word for kind in KINDS))
    terminal.print(table("Kinds of problems, and what takes each", words, ways, pad_edge=False))
    terminal.print()
    terminal.print(table("Algorithms", headings, algorithms, pad_edge=False))
    terminal.print()
    terminal.print(
        table(
            "Algorithms over cones, and for contact with friction",
            headings,
            over_cones,
            pad_edge=False,
        )
    )
    terminal.print()
    headings = ("name", "solves", "costs", "heeds while it runs", "source")
    terminal.print(
        table("Engines of others, for solve(program, name)", headings, of_others, pad_edge=False)
    )
    for reference, source in sources.items():
        terminal.print(f"{source} {reference}")
    for error in (one for one in foreign.values() if isinstance(one, LCPError)):
        terminal.print(f"left out: {error}")
    terminal.print()
    terminal.print(table("Scenes", ("name", "what", "parameters"), scenes, pad_edge=False))
