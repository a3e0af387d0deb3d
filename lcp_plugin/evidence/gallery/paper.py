"""The two examples of the paper on new projected-type methods, and a variant where constraints bind."""

from __future__ import annotations

import math

import numpy as np

from ...checks import FloatVector
from ...problem.lcp import LCP
from .parameters import Count, NonNegative, Square
from .scene import Scene, scene_builder
from .stencil import stencil_matrix


@scene_builder
def paper_example_1(*, n: Square = 100, delta: NonNegative = 4.0) -> Scene:
    """Five-point Laplacian plus delta I with z* = (1, 2, 1, 2, …), nothing active: Example 1 of the paper.

    Parameters
    ----------
    n
        Number of unknowns, a perfect square m²; the paper takes 100, 900, 2500, 3600, 6400, 10000.
    delta
        Shift of the diagonal, at least 0; the tables take 4. With 0 inner rows are not strictly dominant.

    Notes
    -----
    M = blocktridiag(−I, tridiag(−1, 4, −1), −I) + δI, q = −M z*, start (1, 0, 1, 0, …). The identity in
    the fourth block row is printed without its minus sign. As w* = 0 and z* > 0, the solution is that of the
    linear system M z = −q.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, §5.
    """
    return _paper_scene(n, delta, lower=(-1.0, -1.0), upper=(-1.0, -1.0))


@scene_builder
def paper_example_2(*, n: Square = 100, delta: NonNegative = 4.0) -> Scene:
    """Nonsymmetric five-point matrix plus delta I with z* = (1, 2, 1, 2, …): Example 2 of the paper.

    Parameters
    ----------
    n
        Number of unknowns, a perfect square m²; the paper takes 100, 900, 2500, 3600, 6400, 10000.
    delta
        Shift of the diagonal, at least 0; the tables take 4.

    Notes
    -----
    M = blocktridiag(−1.5 I, tridiag(−1.5, 4, −0.5), −0.5 I) + δI, q = −M z*, start (1, 0, 1, 0, …). The
    diagonal block is printed as tridiag(−1, 4, −1); the tables were computed with the block given here.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, §5.
    """
    return _paper_scene(n, delta, lower=(-1.5, -1.5), upper=(-0.5, -0.5))


def _paper_scene(n: int, delta: float, lower: tuple[float, float], upper: tuple[float, float]) -> Scene:
    side = math.isqrt(n)
    M = stencil_matrix((side, side), 4.0 + delta, lower, upper)
    exact = _alternating(n, 1.0, 2.0)
    return Scene(
        problem=LCP(M, -(M @ exact)),
        exact=exact,
        start=_alternating(n, 1.0, 0.0),
        is_symmetric=lower == upper,
        is_h_plus=True,
        grid=(side, side),
        axis_labels=("row", "column"),
    )


@scene_builder
def half_active(
    *, n: Square = 10_000, delta: NonNegative = 4.0, block: Count = 5, degenerate: bool = True
) -> Scene:
    """Five-point Laplacian plus delta I, constraints active on every other block of a checkerboard.

    Parameters
    ----------
    n
        Number of unknowns, a perfect square m².
    delta
        Shift of the diagonal, at least 0; q is exact in floating point where it is an integer.
    block
        Side of the checkerboard's blocks in nodes. The share is exactly one half where 2·block divides m.
    degenerate
        Whether the first corner of each active block has z* = w* = 0; otherwise z* + w* > 0 throughout.

    Notes
    -----
    The answer comes first: on free blocks z* = 1, 2, 1, 2, … and w* = 0, on active ones the other way round;
    then q = w* − M z*. The paper's own examples have no active constraint and so say nothing about
    complementarity: an iteration for the linear system alone would solve them.
    """
    side = math.isqrt(n)
    M = stencil_matrix((side, side), 4.0 + delta, (-1.0, -1.0), (-1.0, -1.0))
    row, column = np.divmod(np.arange(n), side)
    is_active = (row // block + column // block) % 2 == 1
    values = _alternating(n, 1.0, 2.0)
    exact = np.where(is_active, 0.0, values)
    slack = np.where(is_active, values, 0.0)
    if degenerate:
        slack[(row % block == 0) & (column % block == 0)] = 0.0
    return Scene(
        problem=LCP(M, slack - M @ exact),
        exact=exact,
        is_symmetric=True,
        is_h_plus=True,
        grid=(side, side),
        axis_labels=("row", "column"),
    )


def _alternating(n: int, first: float, second: float) -> FloatVector:
    values = np.full(n, first)
    values[1::2] = second
    return values
