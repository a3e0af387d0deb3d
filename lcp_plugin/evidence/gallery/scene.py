"""A scene: a problem together with everything its source knows about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import FloatVector
from ...errors import InvalidProblem
from ...problem.lcp import LCP

_VECTORS = ("exact", "continuum", "start")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Scene:
    """One named problem with the facts its builder declares.

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
        False where nobody has said what M is, as of anybody's own problem; what counts is then found out.
    active_share : float, optional
        Share of components at a bound, in [0, 1]: of `exact`, or of `continuum` where that is all we know.
    grid : optional
        Shape in which z is a picture, C order.
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
    >>> from lcp_plugin.evidence import gallery
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
                object.__setattr__(self, fact, _read_only(values, fact, self.problem.n))
        if self.grid is not None:
            self._check_picture(self.grid)
        if self.steps > 1 and self.advance is None:
            raise InvalidProblem(
                f"a march of {self.steps} steps needs advance, got None; pass a callable z → q"
            )

    def _check_picture(self, grid: tuple[int, ...]) -> None:
        if np.prod(grid, dtype=np.int64) != self.problem.n:
            raise InvalidProblem(f"grid must hold n = {self.n} nodes, got {grid}; give the shape of z")
        lengths = grid if self.coordinates is None else tuple(axis.size for axis in self.coordinates)
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
            raise InvalidProblem(f"scene {self.name!r} has no grid, so z is no picture; plot z by its index")
        if values.shape != (self.n,):
            raise InvalidProblem(f"z must have shape ({self.n},), got {values.shape}")
        return values.reshape(self.grid)

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value!r}" for name, value in self.parameters.items())
        return f"Scene({self.name}: {values})" if values else f"Scene({self.name})"


def _read_only(values: FloatVector, fact: str, n: int) -> FloatVector:
    """Return a view that cannot be written to, so that nobody spoils the reference by accident."""
    if values.shape != (n,):
        raise InvalidProblem(f"{fact} must have shape ({n},) like z, got {values.shape}")
    view = values.view()
    view.flags.writeable = False
    return view
