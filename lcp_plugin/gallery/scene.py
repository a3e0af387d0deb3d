"""A scene: a problem together with everything its source knows about it; and the list of all scenes."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.certificates.row_residuals import is_at_bound
from ..core.checks import FloatVector
from ..core.errors import InvalidOption, InvalidProblem, did_you_mean
from ..core.lcp import LCP
from .parameters import Parameter, parameters_of

_VECTORS = ("exact", "continuum", "start")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Scene:
    """A test problem with what is known about it.

    The facts are declared, not computed: building a scene costs its assembly and nothing else.

    Parameters
    ----------
    problem : LCP
        The problem; the first one where the scene is a march in time.
    name, description, parameters
        Filled in by the registry: the builder's name, its first docstring line, the values actually used.
    exact : shape (n,), optional
        z* of the discrete problem, exact up to the rounding of the data; None when unknown.
    continuum : shape (n,), optional
        The solution of the differential problem at the nodes; it differs from z* by the discretisation error.
    start : shape (n,), optional
        Start vector prescribed by the source.
    is_symmetric, is_h_plus : bool
        True where M is known to be so.
    is_declared : bool
        False where M is not described, as in a user's own problem; its properties are then computed.
    active_share : float, optional
        Share of components at a bound, in [0, 1]: of `exact`, where it is known, or of `continuum`.
    grid : optional
        Shape in which z is a picture, C order; that of the coordinates where there are any.
    coordinates : optional
        One array of node positions per axis of `grid`, shapes (grid[0],), (grid[1],), ….
    axis_labels
        One label per axis of `grid`.
    unknown, active_means
        What z is, and what it means that a component rests on a bound; for pictures.
    steps : int, at least 1
        Length of the march in time; 1 for a single problem.
    advance : callable, optional
        From the solution z of one step the q of the next, shapes (n,): the march is
        ``problem, problem.with_q(advance(z)), …``, `steps` problems in all.

    Raises
    ------
    InvalidProblem
        Where a declared fact does not fit the size of the problem.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> scene = gallery.build("paper_example_1", n=16)
    >>> scene
    Scene(paper_example_1: n=16, delta=4.0)
    >>> scene.picture(scene.exact)[0]
    array([1., 2., 1., 2.])
    """

    problem: LCP
    name: str = ""
    description: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    exact: FloatVector | None = None
    continuum: FloatVector | None = None
    start: FloatVector | None = None
    is_symmetric: bool = False
    is_h_plus: bool = False
    is_declared: bool = True
    active_share: float | None = None
    grid: tuple[int, ...] | None = None
    coordinates: tuple[FloatVector, ...] | None = None
    axis_labels: tuple[str, ...] = ()
    unknown: str = "z"
    active_means: str = "at a bound"
    steps: int = 1
    advance: Callable[[FloatVector], FloatVector] | None = None

    def __post_init__(self) -> None:
        for fact in _VECTORS:
            values = getattr(self, fact)
            if values is not None:
                object.__setattr__(self, fact, _read_only(values, fact, self.problem.q.size))
        if self.exact is not None and self.active_share is None and self.n:
            object.__setattr__(
                self, "active_share", float(np.mean(is_at_bound(self.problem, self.exact)))
            )
        if self.grid is None and self.coordinates is not None:
            object.__setattr__(self, "grid", tuple(axis.size for axis in self.coordinates))
        if self.grid is not None:
            self._check_picture(self.grid)
        if self.steps > 1 and self.advance is None:
            raise InvalidProblem(
                f"a march of {self.steps} steps needs advance, got None; pass a callable z → q"
            )

    def _check_picture(self, grid: tuple[int, ...]) -> None:
        if np.prod(grid, dtype=np.int64) != self.problem.n:
            raise InvalidProblem(
                f"grid must hold n = {self.n} nodes, got {grid}; give the shape of z"
            )
        lengths = (
            grid if self.coordinates is None else tuple(axis.size for axis in self.coordinates)
        )
        if lengths != grid or len(self.axis_labels) != len(grid):
            raise InvalidProblem(
                f"coordinates and axis_labels must match grid {grid}, got axes of length {lengths} and "
                f"labels {self.axis_labels}; give one of each per axis"
            )

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.problem.n

    def picture(self, z: ArrayLike) -> NDArray[np.float64]:
        """Return z in the shape of the grid.

        Parameters
        ----------
        z : shape (n,)

        Raises
        ------
        InvalidProblem
            Where the scene has no picture or z does not fit it.
        """
        values = np.asarray(z, dtype=np.float64)
        if self.grid is None:
            raise InvalidProblem(
                f"scene {self.name!r} has no grid, so z is no picture; plot z by its index"
            )
        if values.shape != (self.n,):
            raise InvalidProblem(f"z must have shape ({self.n},), got {values.shape}")
        return values.reshape(self.grid)

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value!r}" for name, value in self.parameters.items())
        return f"Scene({self.name}: {values})" if values else f"Scene({self.name})"


def _read_only(values: FloatVector, fact: str, n: int) -> FloatVector:
    """Return a view that cannot be written to, so that the reference is not spoilt by accident."""
    if values.shape != (n,):
        raise InvalidProblem(f"{fact} must have shape ({n},) like z, got {values.shape}")
    view = values.view()
    view.flags.writeable = False
    return view


# --- The list -------------------------------------------------------------------------------------------------


Builder = Callable[..., Scene]


class Description(NamedTuple):
    """The name of a test problem, its one-line description, and its parameters with their defaults."""

    name: str
    summary: str
    parameters: dict[str, Any]


_SCENES: dict[str, Builder] = {}


def scene_builder(builder: Builder) -> Builder:
    """Register the function that builds a test problem, under its own name.

    The signature declares the parameters (keyword only, each with a default and, where it needs one, a range
    from :mod:`.parameters`); the first docstring line is the description. The returned function checks every
    value before the builder sees it, then completes the scene with name, description and parameters.

    Parameters
    ----------
    builder : callable
        Returns a :class:`Scene`.
    """
    name = builder.__name__

    @functools.wraps(builder)
    def checked(**given: Any) -> Scene:
        values = checked_values(name, given)
        return replace(
            builder(**values), name=name, description=_summary(builder), parameters=values
        )

    _SCENES[name] = checked
    return checked


def _summary(builder: Builder) -> str:
    return inspect.cleandoc(builder.__doc__ or "").partition("\n")[0]


def checked_values(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of all parameters of a scene, those not given at their defaults.

    Raises
    ------
    InvalidOption
        As :func:`build`.
    """
    for word in given:
        _parameter(name, word)
    return {
        key: p.check(given.get(key, p.default))
        for key, p in parameters_of(builder_of(name)).items()
    }


def names() -> list[str]:
    """Return the names of all test problems, sorted."""
    return sorted(_SCENES)


def describe() -> list[Description]:
    """Return name, one-line description and parameters of every test problem, sorted by name.

    Examples
    --------
    >>> describe()[0].parameters["strike"]
    100.0
    """
    return [
        Description(
            name, _summary(builder), {key: p.default for key, p in parameters_of(builder).items()}
        )
        for name, builder in sorted(_SCENES.items())
    ]


def build(name: str, /, **parameters: Any) -> Scene:
    """Return the test problem of that name.

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
    return builder_of(name)(**parameters)


def parse(text: str) -> Scene:
    """Return the test problem written as ``name`` or ``name:parameter=value,parameter=value``.

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
    name, values = read(text)
    return build(name, **values)


def read(text: str) -> tuple[str, dict[str, Any]]:
    """Return the name and the parameters of a test problem written as text, without building it.

    Parameters
    ----------
    text : str
        As :func:`parse` takes it.

    Raises
    ------
    InvalidOption
        Where the scene or a parameter does not exist, a value has the wrong type, or the text another form.

    Examples
    --------
    >>> read("obstacle_2d:size=20")
    ('obstacle_2d', {'size': 20})
    """
    if not isinstance(text, str):
        raise InvalidOption(f'a scene is written as a text, "half_active:n=900", got {text!r}')
    name, _, settings = text.strip().partition(":")
    name = name.strip()
    builder_of(name)
    values: dict[str, Any] = {}
    for setting in filter(None, map(str.strip, settings.split(","))):
        key, equals, value = (part.strip() for part in setting.partition("="))
        if not equals or key in values:
            fault = "repeats a parameter" if equals else "has no '='"
            raise InvalidOption(
                f"{setting!r} in {text!r} {fault}; write scene:parameter=value,parameter=value"
            )
        values[key] = _parameter(name, key).read(value)
    return name, values


def builder_of(name: str) -> Builder:
    """Return the function that builds the scene of that name."""
    if not isinstance(name, str) or name not in _SCENES:
        raise InvalidOption(f"unknown scene {name!r}{did_you_mean(name, _SCENES, is_listed=True)}")
    return _SCENES[name]


def _parameter(scene: str, name: str) -> Parameter:
    parameters = parameters_of(_SCENES[scene])
    if name not in parameters:
        hint = did_you_mean(name, parameters) if parameters else "; it takes none"
        raise InvalidOption(f"scene {scene!r} has no parameter {name!r}{hint}")
    return parameters[name]
