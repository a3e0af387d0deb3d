"""Scenes that each rank builds for its own rows only; every other scene is built whole on each rank and cut."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from ..evidence import gallery
from ..evidence.gallery.obstacle import CONTACT_RADIUS, HALF_SIDE, sphere_obstacle, sphere_solution
from ..evidence.gallery.stencil import nodes
from ..problem import FloatVector
from .collective import together
from .problem import DistributedLCP

DIMENSIONS = {"obstacle_2d": 2, "obstacle_3d": 3}


def build(name: str, comm: MPI.Comm, parameters: dict[str, Any]) -> DistributedLCP:
    """Return the scene's problem with its rows spread over the ranks."""
    if name in DIMENSIONS and not parameters.get("shifted", False):
        size = int(parameters.get("size", 100 if name == "obstacle_2d" else 30))
        return sphere_obstacle_rows(comm, DIMENSIONS[name], size)
    scene = together(comm, lambda: gallery.build(name, **parameters))
    return DistributedLCP.from_problem(scene.problem, comm)


def sphere_obstacle_rows(comm: MPI.Comm, dimension: int, size: int) -> DistributedLCP:
    """Return `obstacle_2d` or `obstacle_3d` of that size, slab by slab."""
    layer = size ** (dimension - 1)
    begin, end = size * comm.rank // comm.size, size * (comm.rank + 1) // comm.size
    axis = nodes(-HALF_SIDE, HALF_SIDE, size)
    rest = [axis] * (dimension - 1)
    # One layer more on both sides, for the values on the boundary.
    radius = np.sqrt(sum(x**2 for x in np.ix_(axis[begin : end + 2], *rest)))
    inside = (slice(1, -1),) * dimension
    lower = sphere_obstacle(radius[inside]).ravel()
    q = _boundary_terms(radius, dimension, begin == 0, end == size)
    own = np.arange(begin * layer, end * layer, dtype=np.int64)
    rows = _laplacian_rows(own, (size,) * dimension)
    return DistributedLCP.from_rows(comm, rows, q, lower, np.full(own.size, np.inf), first_row=begin * layer)


def exact_error(problem: DistributedLCP, z: FloatVector, dimension: int, size: int) -> float:
    """Return the own largest distance of z from the membrane's closed form."""
    axis = nodes(-HALF_SIDE, HALF_SIDE, size)[1:-1]
    layer = size ** (dimension - 1)
    own = axis[problem.first // layer : problem.last // layer]
    radius = np.sqrt(sum(x**2 for x in np.ix_(own, *[axis] * (dimension - 1))))
    return float(np.abs(z - sphere_solution(radius, dimension).ravel()).max(initial=0.0))


def _boundary_terms(radius: Any, dimension: int, has_bottom: bool, has_top: bool) -> FloatVector:
    """Return what the values of the closed form on the boundary add to each row of a slab."""
    inside = (slice(1, -1),) * dimension
    terms = np.zeros(radius[inside].shape)
    if not terms.size:
        return terms.ravel()
    for axis in range(dimension):
        for end, is_outside in ((0, axis > 0 or has_bottom), (-1, axis > 0 or has_top)):
            if is_outside:
                face = list(inside)
                face[axis] = slice(end, None) if end else slice(0, 1)
                place = [slice(None)] * dimension
                place[axis] = slice(end, None) if end else slice(0, 1)
                terms[tuple(place)] -= sphere_solution(radius[tuple(face)], dimension)
    return terms.ravel()


def _laplacian_rows(own: Any, shape: tuple[int, ...]) -> sp.csr_array:
    """Return these rows of the matrix (2d, −1) on a grid, neighbours outside left out."""
    n = math.prod(shape)
    strides = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    offsets = [*(-stride for stride in strides), 0, *reversed(strides)]
    columns = own[:, None] + np.array(offsets, dtype=own.dtype)
    present = np.ones(columns.shape, np.bool_)
    for axis, stride in enumerate(strides):
        place = own // stride % shape[axis]
        present[:, axis] = place > 0
        present[:, -1 - axis] = place < shape[axis] - 1
    values = np.full(columns.shape, -1.0)
    values[:, len(shape)] = 2.0 * len(shape)
    index_type = np.int32 if n < 2**31 else np.int64
    indptr = np.zeros(own.size + 1, dtype=index_type)
    np.cumsum(np.count_nonzero(present, axis=1), out=indptr[1:])
    return sp.csr_array((values[present], columns[present].astype(index_type), indptr), shape=(own.size, n))


ACTIVE_RADIUS = CONTACT_RADIUS
