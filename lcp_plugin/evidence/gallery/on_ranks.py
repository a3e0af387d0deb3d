"""Scenes that each rank builds for its own rows only; every other scene is built whole on each rank and cut."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from ...checks import FloatVector
from ...peers.ranks.collective import together
from ...problem.lcp import LCP
from .. import gallery
from .obstacle import HALF_SIDE, sphere_obstacle, sphere_solution
from .parameters import Parameter, parameters_of
from .stencil import dirichlet_terms, interior, nodes, stencil_matrix

DIMENSIONS = {"obstacle_2d": 2, "obstacle_3d": 3}
BY_ROWS = tuple(DIMENSIONS)


def build(name: str, comm: MPI.Comm, parameters: dict[str, Any]) -> LCP:
    """Return the scene's problem with its rows spread over the ranks; all ranks call.

    Raises
    ------
    LCPError
        On every rank, as :func:`lcp_plugin.gallery.build`.
    """
    if name in DIMENSIONS:
        values = together(comm, lambda: _checked(name, parameters))
        return sphere_obstacle_rows(comm, DIMENSIONS[name], **values)
    scene = together(comm, lambda: gallery.build(name, **parameters))
    return LCP.from_problem(scene.problem, comm)


def by_rows(text: str) -> tuple[str, dict[str, Any]] | None:
    """Return name and checked parameters where the text names a scene that is built row by row, without building it.

    None for any other text, also for one with a mistake: `gallery.parse` says what is wrong with it.

    Raises
    ------
    InvalidOption
        Where a value has the wrong type or range.
    """
    name, _, settings = text.strip().partition(":")
    if name.strip() not in DIMENSIONS:
        return None
    declared = _parameters(name.strip())
    pairs = [[part.strip() for part in setting.split("=")] for setting in settings.split(",") if setting.strip()]
    given = {pair[0]: pair[-1] for pair in pairs}
    if len(given) < len(pairs) or any(len(pair) != 2 or pair[0] not in declared for pair in pairs):
        return None
    return name.strip(), _checked(name.strip(), {key: declared[key].read(value) for key, value in given.items()})


def sphere_obstacle_rows(comm: MPI.Comm, dimension: int, size: int, *, shifted: bool = False) -> LCP:
    """Return `obstacle_2d` or `obstacle_3d` of that size; every rank has some layers of the grid."""
    layer = size ** (dimension - 1)
    begin, end = size * comm.rank // comm.size, size * (comm.rank + 1) // comm.size

    def assembled() -> tuple[sp.csr_array, FloatVector, FloatVector]:
        axis = nodes(-HALF_SIDE, HALF_SIDE, size)
        # One layer more on both sides: the boundary, or what the next rank holds.
        radius = np.sqrt(sum(x**2 for x in np.ix_(axis[begin : end + 2], *[axis] * (dimension - 1))))
        obstacle = sphere_obstacle(radius[:, *interior(dimension - 1)])
        lower = obstacle[1:-1].ravel()
        values = sphere_solution(radius, dimension)
        if begin > 0:
            values[0] = 0.0
        if end < size:
            values[-1] = 0.0
        legs = (-1.0,) * dimension
        q = dirichlet_terms(values, legs, legs) if end > begin else np.empty(0)
        rows = _slab_rows((size,) * dimension, 2.0 * dimension, legs, begin, end)
        if shifted:
            window = sp.csr_array(
                (rows.data, rows.indices - (begin - 1) * layer, rows.indptr), shape=(lower.size, obstacle.size)
            )
            q = window @ obstacle.ravel() + q
            lower = np.zeros(lower.size)
        return rows, q, lower

    rows, q, lower = together(comm, assembled)
    return LCP.from_rows(comm, rows, q, lower, np.full(lower.size, np.inf), first_row=begin * layer)


def continuum_error(problem: LCP, z: FloatVector, name: str, *, size: int, shifted: bool = False) -> float:
    """Return the own largest distance of z from the membrane's closed form at the nodes."""
    dimension = DIMENSIONS[name]
    axis = nodes(-HALF_SIDE, HALF_SIDE, size)[1:-1]
    layer = size ** (dimension - 1)
    own = axis[problem.first // layer : problem.last // layer]
    radius = np.sqrt(sum(x**2 for x in np.ix_(own, *[axis] * (dimension - 1))))
    continuum = sphere_solution(radius, dimension)
    if shifted:
        continuum -= sphere_obstacle(radius)
    return float(np.abs(z - continuum.ravel()).max(initial=0.0))


def _slab_rows(
    shape: tuple[int, ...], centre: float, legs: tuple[float, ...], begin: int, end: int
) -> sp.csr_array:
    """Return the rows of `stencil_matrix` that belong to the layers begin ≤ i < end, with global columns."""
    n, layer = math.prod(shape), math.prod(shape[1:])
    index_type = np.int32 if n < 2**31 else np.int64
    if begin == end:
        return sp.csr_array((0, n), dtype=np.float64)
    low, high = max(begin - 1, 0), min(end + 1, shape[0])  # the neighbours' layers, so that no leg is cut off
    slab = stencil_matrix((high - low, *shape[1:]), centre, legs, legs)
    own = slab[(begin - low) * layer : (end - low) * layer]
    return sp.csr_array(
        (own.data, own.indices.astype(index_type) + low * layer, own.indptr), shape=(own.shape[0], n)
    )


def _parameters(name: str) -> dict[str, Parameter]:
    builders: dict[str, Callable[..., Any]] = {"obstacle_2d": gallery.obstacle_2d, "obstacle_3d": gallery.obstacle_3d}
    return parameters_of(builders[name])


def _checked(name: str, given: dict[str, Any]) -> dict[str, Any]:
    """Return all parameters of the scene, those not given at their defaults."""
    declared = _parameters(name)
    for word in given:
        if word not in declared:
            gallery.build(name, **given)  # raises, and says which words it knows
    return {key: parameter.check(given.get(key, parameter.default)) for key, parameter in declared.items()}
