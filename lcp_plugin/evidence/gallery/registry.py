"""The list of scenes: built by name, described in one line each, written as text on a command line."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from ...errors import InvalidOption, did_you_mean
from .parameters import Parameter, parameters_of
from .scene import Scene

Builder = Callable[..., Scene]


class Description(NamedTuple):
    """A scene's name, its one-line description, and its parameters with their defaults."""

    name: str
    summary: str
    parameters: dict[str, Any]


@dataclass(frozen=True)
class _Entry:
    build: Builder
    summary: str
    parameters: dict[str, Parameter]


_SCENES: dict[str, _Entry] = {}


def scene_builder(builder: Builder) -> Builder:
    """Register a builder under its own name.

    The signature declares the parameters (keyword only, each with a default and, where it needs one, a range
    from :mod:`.parameters`); the first docstring line is the description. The returned function checks every
    value before the builder sees it, then completes the scene with name, description and parameters.

    Parameters
    ----------
    builder : callable
        Returns a :class:`Scene`.
    """
    name = builder.__name__
    parameters = parameters_of(builder)
    summary = inspect.cleandoc(builder.__doc__ or "").partition("\n")[0]

    @functools.wraps(builder)
    def checked(**given: Any) -> Scene:
        for word in given:
            _parameter(name, word)
        values = {key: p.check(given.get(key, p.default)) for key, p in parameters.items()}
        return replace(builder(**values), name=name, description=summary, parameters=values)

    _SCENES[name] = _Entry(checked, summary, parameters)
    return checked


def names() -> list[str]:
    """Return the names of all scenes, sorted."""
    return sorted(_SCENES)


def describe() -> list[Description]:
    """Return name, one-line description and parameters with defaults of every scene, sorted by name.

    Examples
    --------
    >>> describe()[0].parameters["strike"]
    100.0
    """
    entries = sorted(_SCENES.items())
    return [
        Description(name, entry.summary, {key: p.default for key, p in entry.parameters.items()})
        for name, entry in entries
    ]


def build(name: str, /, **parameters: Any) -> Scene:
    """Return the scene of that name.

    Parameters
    ----------
    name
        One of :func:`names`.
    **parameters
        The scene's own parameters; those not given take their defaults.

    Raises
    ------
    InvalidOption
        Where the scene or a parameter does not exist, or a value has the wrong type or range.

    Examples
    --------
    >>> build("murty", n=3).exact
    array([0., 0., 1.])
    """
    return _entry(name).build(**parameters)


def parse(text: str) -> Scene:
    """Return the scene written as ``name`` or ``name:parameter=value,parameter=value``.

    Parameters
    ----------
    text : str
        Each value is read as the kind its parameter has: integer, number, word, or true/false.

    Raises
    ------
    InvalidOption
        As :func:`build`, and where the text has another form.

    Examples
    --------
    >>> parse("obstacle_2d:size=20,shifted=true")
    Scene(obstacle_2d: size=20, shifted=True)
    """
    if not isinstance(text, str):
        raise InvalidOption(f'a scene is written as a text, "half_active:n=900", got {text!r}')
    name, _, settings = text.strip().partition(":")
    name = name.strip()
    _entry(name)
    values: dict[str, Any] = {}
    for setting in filter(None, map(str.strip, settings.split(","))):
        key, equals, value = (part.strip() for part in setting.partition("="))
        if not equals or key in values:
            fault = "repeats a parameter" if equals else "has no '='"
            raise InvalidOption(
                f"{setting!r} in {text!r} {fault}; write scene:parameter=value,parameter=value"
            )
        values[key] = _parameter(name, key).read(value)
    return build(name, **values)


def _entry(name: str) -> _Entry:
    if not isinstance(name, str) or name not in _SCENES:
        raise InvalidOption(f"unknown scene {name!r}{did_you_mean(name, _SCENES)}")
    return _SCENES[name]


def _parameter(scene: str, name: str) -> Parameter:
    parameters = _SCENES[scene].parameters
    if name not in parameters:
        hint = did_you_mean(name, parameters) if parameters else "; it takes none"
        raise InvalidOption(f"scene {scene!r} has no parameter {name!r}{hint}")
    return parameters[name]
