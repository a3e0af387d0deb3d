"""Rigid bodies in contact: impulses against the velocities with which gaps open."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ...checks import FloatVector
from ...problem.lcp import LCP
from .parameters import Count, Positive, at_least
from .registry import scene_builder
from .scene import Scene


@scene_builder
def rigid_stack(
    *, blocks: Count = 10, points: Annotated[int, at_least(2)] = 4, mass_ratio: Positive = 1.0, push: float = 0.0
) -> Scene:
    """Stack of rigid blocks pressed together by gravity: M = J W Jᵀ, more contacts than degrees of freedom.

    Parameters
    ----------
    blocks
        Number of blocks; each moves up and down and turns.
    points
        Contact points between neighbours, at least 2, evenly spaced. With more than 2 M is singular.
    mass_ratio
        Mass of a block divided by that of the one below; far from 1 the problem is ill-conditioned.
    push
        Angular velocity of the top block before the impact; large enough it lifts off on one side.

    Notes
    -----
    z_i ≥ 0 is the impulse at contact i, w_i ≥ 0 the velocity with which its gap opens; q = J v with the falling
    velocity v. The velocities after the impact are unique, the impulses only with two points an interface. At rest
    (push 0) every interface then carries half of the momentum above it at each point, which is declared as `exact`
    for blocks of equal mass.

    References
    ----------
    Lötstedt, *Mechanical systems of rigid bodies subject to unilateral constraints*, SIAM J. Appl. Math. 42, 1982,
    doi:10.1137/0142022.
    """
    J = _normals(blocks, points)
    mass = mass_ratio ** np.arange(blocks, dtype=np.float64)
    inverse = np.repeat(1.0 / mass, 2) * np.tile([1.0, 2.0], blocks)
    velocity = np.tile([-1.0, 0.0], blocks)
    velocity[-1] = push
    M = (J * inverse) @ J.T
    M = 0.5 * (M + M.T)
    exact = _share_of_the_weight(blocks) if points == 2 and mass_ratio == 1.0 and push == 0.0 else None
    return Scene(
        problem=LCP(M, J @ velocity),
        exact=exact,
        is_symmetric=True,
        is_h_plus=blocks == 1 and points == 2,
        active_share=None if exact is None else 0.0,
    )


def _normals(blocks: int, points: int) -> NDArray[np.float64]:
    """Return how fast each gap opens for a unit velocity of each block, shape (blocks · points, 2 · blocks)."""
    arms = np.linspace(-1.0, 1.0, points)
    one = np.column_stack([np.ones(points), arms])
    above, below = np.kron(np.eye(blocks), one), np.kron(np.eye(blocks, k=-1), one)
    normals: NDArray[np.float64] = above - below
    return normals


def _share_of_the_weight(blocks: int) -> FloatVector:
    return np.repeat(np.arange(blocks, 0, -1) / 2.0, 2)
