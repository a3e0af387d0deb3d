"""Matrices that couple each node of a grid with its nearest neighbors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import Vector

Field = NDArray[np.float64]
Coefficient = float | Field
Legs = tuple[list[Coefficient], list[Coefficient]]  # below and above, one coefficient per axis


def nodes(low: float, high: float, size: int) -> Vector:
    """Return `size` equidistant nodes inside [low, high] and its endpoints, shape (size + 2,)."""
    return np.linspace(low, high, size + 2)


def interior(dimension: int) -> tuple[slice, ...]:
    """Return the index of the interior of a field that includes its boundary layer."""
    return (slice(1, -1),) * dimension


def stencil_matrix(
    shape: tuple[int, ...],
    centre: Coefficient,
    below: Sequence[Coefficient],
    above: Sequence[Coefficient],
) -> sp.csr_array:
    """Return the matrix of (centre u)_i + Σ_axis (below[axis] u_{i − e} + above[axis] u_{i + e}) on a grid.

    Neighbors outside the grid are left out: their known values belong into q, see `dirichlet_terms`.

    Parameters
    ----------
    shape
        Number of nodes along each axis; unknowns are numbered in C order.
    centre, below, above
        Coefficients: numbers, or arrays that broadcast to `shape`; `below` and `above` hold one per axis.

    Returns
    -------
    csr_array, shape (n, n)
        Canonical, with 32-bit indices if they suffice.

    Examples
    --------
    >>> stencil_matrix((3,), 2.0, [-1.0], [-1.0]).toarray()
    array([[ 2., -1.,  0.],
           [-1.,  2., -1.],
           [ 0., -1.,  2.]])
    """
    n = math.prod(shape)
    strides = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    # The far neighbor below comes first, the far neighbor above last: each row is born sorted.
    offsets = [*(-stride for stride in strides), 0, *reversed(strides)]
    entries = np.empty((*shape, len(offsets)))
    for axis in range(len(shape)):
        entries[..., axis] = below[axis]
        entries[..., -1 - axis] = above[axis]
        np.moveaxis(entries, axis, 0)[0, ..., axis] = 0.0
        np.moveaxis(entries, axis, 0)[-1, ..., -1 - axis] = 0.0
    entries[..., len(shape)] = centre

    entries = entries.reshape(n, len(offsets))
    present = entries != 0.0
    index_type = np.int32 if entries.size < 2**31 else np.int64
    columns = np.arange(n, dtype=index_type)[:, None] + np.array(offsets, dtype=index_type)
    row_ends = np.zeros(n + 1, dtype=index_type)
    np.cumsum(np.count_nonzero(present, axis=1), out=row_ends[1:])
    return sp.csr_array((entries[present], columns[present], row_ends), shape=(n, n))


def balanced_matrix(shape: tuple[int, ...], legs: Legs) -> sp.csr_array:
    """Return the stencil whose centre balances its legs exactly: −∇·(k∇u) + b·∇u."""
    below, above = legs
    return stencil_matrix(shape, -sum(below) - sum(above), below, above)


def stiff_cells(cells: Field) -> Legs:
    """Return the legs of −∇·(k∇u), k given on each cell of the mesh; an edge takes the mean of its two cells."""
    # edges along the first axis have the shape (size + 1, size)
    across = (cells[:, :-1] + cells[:, 1:]) / 2.0
    along = (cells[:-1, :] + cells[1:, :]) / 2.0
    return [-across[:-1], -along[:, :-1]], [-across[1:], -along[:, 1:]]


def upwind(diffusion: float, wind: Sequence[Coefficient]) -> Legs:
    """Return the legs of −diffusion Δu + wind·∇u by first-order upwind differences, on a mesh of width 1."""
    return [-(diffusion + np.maximum(b, 0.0)) for b in wind], [
        -(diffusion + np.maximum(-b, 0.0)) for b in wind
    ]


def dirichlet_terms(
    field: Field, below: Sequence[Coefficient], above: Sequence[Coefficient]
) -> Vector:
    """Return the terms that known values on the boundary layer add to each row of the stencil, shape (n,).

    Parameters
    ----------
    field : shape (size + 2 along each axis)
        Values on the grid and its boundary layer; only the layer is used.
    below, above
        The coefficients given to `stencil_matrix`.

    Examples
    --------
    >>> dirichlet_terms(np.array([5.0, 0, 0, 0, 7.0]), [-1.0], [-1.0])
    array([-5.,  0., -7.])
    """
    inside = interior(field.ndim)
    layer = field.copy()
    layer[inside] = 0.0
    terms = np.zeros_like(layer[inside])
    for axis in range(field.ndim):
        before, after = list(inside), list(inside)
        before[axis], after[axis] = slice(None, -2), slice(2, None)
        terms += below[axis] * layer[tuple(before)] + above[axis] * layer[tuple(after)]
    return terms.ravel()
