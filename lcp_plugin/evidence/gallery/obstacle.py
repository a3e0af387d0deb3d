"""Membranes stretched over obstacles: −Δu ≥ f, u ≥ ψ, one of the two an equation at every point."""

from __future__ import annotations

import math

import numpy as np

from ...problem.lcp import LCP
from .parameters import Count, Seed
from .scene import Scene, scene_builder
from .stencil import Field, dirichlet_terms, interior, nodes, stencil_matrix

CONTACT_RADIUS = {2: 0.6979651482233735, 3: 0.7892441190408083}
"""By dimension, the root r* in (0, 1) of r² (1 − log(r/2)) = 1 and of 2 r² − r³/2 = 1."""

CONE_BEGINS = 0.9
"""From this radius on the sphere is continued by its tangent cone, so that ψ is finite everywhere."""

HALF_SIDE = 2.0


@scene_builder
def obstacle_2d(*, size: Count = 100, shifted: bool = False) -> Scene:
    """Membrane over a sphere on [−2, 2]², with analytic solution and free boundary.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size², mesh width 4/(size + 1).
    shifted
        False: the unknown is u with lower = ψ. True: it is u − ψ with lower = 0, the plain LCP.

    Notes
    -----
    ψ(r) = √(1 − r²) and −Δu ≥ 0. Off the contact set the radial solution that vanishes at r = 2 is
    u = −A log(r/2); u and u′ continuous with ψ at r* give A = r*²/√(1 − r*²) and r*² (1 − log(r*/2)) = 1.
    The boundary values on the square are those of this u, so it solves the problem there too. From r = 0.9
    on, outside the contact set, ψ is continued by its tangent cone, concave and below u. Rows are those of
    the five-point stencil (4, −1), that is −h²Δ. The discretisation error falls about like h², unevenly, as
    the discrete contact set grows by whole nodes.

    References
    ----------
    Kinderlehrer, Stampacchia, *An Introduction to Variational Inequalities and Their Applications*, SIAM
    2000, doi:10.1137/1.9780898719451.
    """
    return _sphere_scene(2, size, shifted)


@scene_builder
def obstacle_3d(*, size: Count = 30, shifted: bool = False) -> Scene:
    """Membrane over a sphere on [−2, 2]³, with analytic solution and free boundary.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size³, mesh width 4/(size + 1).
    shifted
        False: the unknown is u with lower = ψ. True: it is u − ψ with lower = 0, the plain LCP.

    Notes
    -----
    As `obstacle_2d` with the radial solution u = A (1/r − 1/2): u and u′ continuous with ψ at r* give
    A = r*³/√(1 − r*²) and 2 r*² − r*³/2 = 1. Rows are those of the seven-point stencil (6, −1).
    """
    return _sphere_scene(3, size, shifted)


def sphere_obstacle(r: Field) -> Field:
    """Return ψ(r) = √(1 − r²), continued by the tangent at r = 0.9; any shape."""
    slope = -CONE_BEGINS / math.sqrt(1.0 - CONE_BEGINS**2)
    sphere = np.sqrt(1.0 - np.minimum(r, CONE_BEGINS) ** 2)
    return sphere + slope * np.maximum(r - CONE_BEGINS, 0.0)


def sphere_solution(r: Field, dimension: int) -> Field:
    """Return the analytic u(r) in dimension 2 or 3; any shape."""
    contact = CONTACT_RADIUS[dimension]
    strength = contact**dimension / math.sqrt(1.0 - contact**2)
    outside = np.maximum(r, contact)
    free = -np.log(outside / 2.0) if dimension == 2 else 1.0 / outside - 0.5
    return np.where(r < contact, sphere_obstacle(r), strength * free)


def _sphere_scene(dimension: int, size: int, shifted: bool) -> Scene:
    axis = nodes(-HALF_SIDE, HALF_SIDE, size)
    r = np.sqrt(sum(x**2 for x in np.ix_(*[axis] * dimension)))
    solution = sphere_solution(r, dimension)
    inside = interior(dimension)
    obstacle, continuum = sphere_obstacle(r[inside]).ravel(), solution[inside].ravel()

    shape, legs = (size,) * dimension, (-1.0,) * dimension
    M = stencil_matrix(shape, 2.0 * dimension, legs, legs)
    q = dirichlet_terms(solution, legs, legs)
    problem = LCP(M, M @ obstacle + q) if shifted else LCP(M, q, lower=obstacle)
    return Scene(
        problem=problem,
        continuum=continuum - obstacle if shifted else continuum,
        is_symmetric=True,
        is_h_plus=True,
        active_share=float(np.mean(r[inside] < CONTACT_RADIUS[dimension])),
        coordinates=(axis[1:-1],) * dimension,
        axis_labels=("x", "y", "z")[:dimension],
        unknown="height",
        active_means="on the obstacle",
    )


@scene_builder
def obstacle_bumps(*, size: Count = 100, bumps: Count = 8, load: float = -5.0, seed: Seed = 0) -> Scene:
    """Membrane under a load over several bumps on the unit square, zero on the boundary.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size², mesh width 1/(size + 1).
    bumps
        Number of paraboloids of random height, width and place; ψ is their maximum.
    load
        f in −Δu ≥ f; negative values press the membrane onto the bumps.
    seed
        Of the generator that draws the bumps.

    Notes
    -----
    Several contact sets with free boundaries of different curvature, and no closed form. Each paraboloid is
    positive only inside the square, so ψ ≤ 0 on the boundary. Rows are scaled by h².
    """
    axis = nodes(0.0, 1.0, size)[1:-1]
    x, y = np.ix_(axis, axis)
    generator = np.random.default_rng(seed)
    obstacle = np.full((size, size), -np.inf)
    for _ in range(bumps):
        width, height = generator.uniform(0.08, 0.25), generator.uniform(0.1, 0.5)
        at_x, at_y = generator.uniform(width, 1.0 - width, size=2)
        bump = height * (1.0 - ((x - at_x) ** 2 + (y - at_y) ** 2) / width**2)
        np.maximum(obstacle, bump, out=obstacle)

    legs = (-1.0, -1.0)
    M = stencil_matrix((size, size), 4.0, legs, legs)
    mesh_width = 1.0 / (size + 1)
    return Scene(
        problem=LCP(M, np.full(size**2, -load * mesh_width**2), lower=obstacle.ravel()),
        is_symmetric=True,
        is_h_plus=True,
        coordinates=(axis, axis),
        axis_labels=("x", "y"),
        unknown="height",
        active_means="on the obstacle",
    )
