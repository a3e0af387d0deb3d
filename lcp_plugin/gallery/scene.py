"""`Scene`: a test problem with the known facts about its solution; and the registry of all of them."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ..core.checks import Vector, checked_vector, fill, is_number
from ..core.errors import InvalidOption, InvalidProblem, did_you_mean
from ..core.lcp import LCP
from ..core.settings import parse_options

SIZES = {"n", "size"}  # parameters that are at least 1


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Frame:
    """Facts about unknowns that a plot shows; see :class:`Scene`."""

    description: str = ""
    grid: tuple[int, ...] | None = None
    coordinates: tuple[Vector, ...] | None = None
    axis_labels: tuple[str, ...] = ()
    unknown: str = "z"
    active_means: str = "unknowns at a bound"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Scene(Frame):
    """A test problem with what is known about it.

    The facts are declared, not computed: a `Scene` costs the assembly of its matrix and nothing else.

    Parameters
    ----------
    problem : LCP
        Problem.
    name, description, parameters
        Filled in by `scene_builder`: the builder's name, its first docstring line, the values used.
    exact : shape (n,), optional
        z* of the discrete problem, exact up to the rounding of the data; None if unknown.
    continuum : shape (n,), optional
        The solution of the differential problem at the nodes; it differs from z* by the discretization error.
    start : shape (n,), optional
        Start vector prescribed by the source.
    grid : optional
        Shape in which z can be plotted, C order; the shape of the coordinates if there are any.
    coordinates : optional
        One array of node positions per axis of `grid`, shapes (grid[0],), (grid[1],), ….
    axis_labels
        One label per axis of `grid`.
    unknown, active_means
        Meaning of z, and of a component at a bound; for plots.

    Raises
    ------
    InvalidProblem
        If a declared fact does not fit the size of the problem.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> scene = gallery.build("paper_example_1", n=16)
    >>> scene
    Scene(paper_example_1: n=16, delta=4.0)
    >>> scene.exact.reshape(scene.grid)[0]
    array([1., 2., 1., 2.])
    """

    problem: LCP
    name: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    exact: Vector | None = None
    continuum: Vector | None = None
    start: Vector | None = None

    def __post_init__(self) -> None:
        for fact in ("exact", "continuum", "start"):
            if (values := getattr(self, fact)) is not None:
                fill(self, **{fact: checked_vector(values, fact, self.n)})
        if self.coordinates is not None and self.grid is None:
            fill(self, grid=tuple(axis.size for axis in self.coordinates))
        if self.grid is not None and math.prod(self.grid) != self.n:
            raise InvalidProblem(f"grid {self.grid} must hold n = {self.n} nodes")

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.problem.n

    @property
    def title(self) -> str:
        """The test problem as a command-line argument, name:parameter=value,…."""
        values = ",".join(f"{name}={value}" for name, value in self.parameters.items())
        return f"{self.name}:{values}" if values else self.name

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value!r}" for name, value in self.parameters.items())
        return f"Scene({self.name}: {values})" if values else f"Scene({self.name})"


# --- The list -------------------------------------------------------------------------------------------------


Builder = Callable[..., Scene]


class Description(NamedTuple):
    """Name of a test problem, one-line description, and parameters with their defaults."""

    name: str
    summary: str
    parameters: dict[str, Any]


_SCENES: dict[str, Builder] = {}


def scene_builder(builder: Builder) -> Builder:
    """Register the function that builds a test problem, under its own name.

    The signature declares the parameters, keyword only and each with a default whose type a value must have. Integers
    are at least 0, parameters in `SIZES` at least 1, and floats finite. The description is the first docstring
    line.

    Parameters
    ----------
    builder : callable
        Returns a :class:`Scene`.

    Returns
    -------
    callable
        Function with checked parameters; its `Scene` carries name, description and parameters.

    Raises
    ------
    InvalidOption
        When the returned function is called with a value that its signature does not allow.
    """
    name, summary = builder.__name__, _summary(builder)

    @functools.wraps(builder)
    def checked(*unnamed: Any, **values: Any) -> Scene:
        defaults = defaults_of(name)
        if unnamed:
            raise InvalidOption(f"{name} takes parameters by name: {', '.join(defaults)}")
        for key, value in values.items():
            if key not in defaults:
                hint = did_you_mean(key, defaults) if defaults else "; it takes none"
                raise InvalidOption(f"test problem {name!r} has no parameter {key!r}{hint}")
            defaults[key] = _checked(name, key, value, defaults[key])
        return replace(builder(**defaults), name=name, description=summary, parameters=defaults)

    _SCENES[name] = checked
    return checked


def _checked(name: str, key: str, value: Any, default: Any) -> Any:
    """Return the value as a plain Python object of the default's type, or raise InvalidOption."""
    is_flag, least = isinstance(value, bool | np.bool_), 1 if key in SIZES else 0
    is_integer = isinstance(value, int | np.integer) and is_number(value)
    requirements = {
        bool: (is_flag, "true or false"),
        int: (is_integer and value >= least, f"an integer ≥ {least}"),
        float: (is_number(value) and math.isfinite(value), "a finite number"),
    }
    is_right, needs = requirements[type(default)]
    if is_right:
        return type(default)(value)
    raise InvalidOption(f"problem {name!r}: {key} must be {needs}, as {default!r}, got {value!r}")


def require(condition: bool, words: str) -> None:
    """Raise InvalidOption with these words unless the condition holds; for the builders."""
    if not condition:
        raise InvalidOption(words)


def defaults_of(name: str) -> dict[str, Any]:
    """Return the parameters of a test problem with their defaults."""
    parameters = inspect.signature(builder_of(name)).parameters
    return {key: parameter.default for key, parameter in parameters.items()}


def names() -> list[str]:
    """Return the names of all test problems, sorted."""
    return sorted(_SCENES)


def describe() -> list[Description]:
    """Return name, one-line description and parameters of every test problem, sorted by name.

    Examples
    --------
    >>> describe()[0].parameters["n"]
    10000
    """
    return [Description(name, _summary(_SCENES[name]), defaults_of(name)) for name in names()]


def _summary(builder: Builder) -> str:
    """Return the first line of the docstring."""
    return inspect.cleandoc(builder.__doc__ or "").partition("\n")[0]


def build(name: str, /, **parameters: Any) -> Scene:
    """Return the test problem of that name.

    Parameters
    ----------
    name
        One of :func:`names`.
    **parameters
        Parameters of the test problem; the others take their defaults.

    Raises
    ------
    InvalidOption
        If the test problem or a parameter does not exist, or a value has the wrong type or range.

    Examples
    --------
    >>> build("half_active", n=4).exact
    array([1., 2., 1., 2.])
    """
    return builder_of(name)(**parameters)


def parse(text: str) -> Scene:
    """Return the test problem written as ``name`` or ``name:parameter=value,parameter=value``.

    Parameters
    ----------
    text : str
        Values are numbers or true/false.

    Raises
    ------
    InvalidOption
        As :func:`build`, and if the text has another form.

    Examples
    --------
    >>> parse("obstacle_2d:size=20,shifted=true")
    Scene(obstacle_2d: size=20, shifted=True)
    """
    words = f'a test problem is written as a text, "half_active:n=900", got {text!r}'
    require(isinstance(text, str), words)
    name, _, settings = text.strip().partition(":")
    builder = builder_of(name.strip())
    return builder(**parse_options(filter(None, map(str.strip, settings.split(",")))))


def builder_of(name: str) -> Builder:
    """Return the function that builds the test problem of that name."""
    if not isinstance(name, str) or name not in _SCENES:
        hint = did_you_mean(name, _SCENES, is_listed=True)
        raise InvalidOption(f"unknown test problem {name!r}{hint}")
    return _SCENES[name]
