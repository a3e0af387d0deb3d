"""Bearings, bars, blocks and switches: a film that tears, a section that yields, bodies that press, diodes, relays."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.lcp import LCP
from .parameters import Count, Positive, Rule, Seed, at_least, one_of
from .scene import Scene, scene_builder
from .stencil import Field, balanced_matrix, nodes, stencil_matrix

BelowOne = Annotated[float, Rule("≥ 0 and < 1", lambda value: 0.0 <= value < 1.0)]


@scene_builder
def journal_bearing(
    *, size: Count = 100, eccentricity: BelowOne = 0.8, half_length: Positive = 10.0
) -> Scene:
    """Pressure in the oil film of a journal bearing with cavitation.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size².
    eccentricity
        Of the journal, relative to the clearance; at 1 it would touch. The film's coefficient spans a ratio of
        ((1 + ε)/(1 − ε))³: 8e6 at 0.99.
    half_length
        Half the width of the bearing, in radii.

    Notes
    -----
    Reynolds' equation on θ in (0, 2π) and y in (0, 2 · half_length): −∇·(h³ ∇p) ≥ −∂h/∂θ = ε sin θ, p ≥ 0,
    complementary, p = 0 on the boundary, h = 1 + ε cos θ. An edge takes h³ at its midpoint. Rows are those of the
    five-point stencil times both mesh widths.

    References
    ----------
    Cryer, *The method of Christopherson for solving free boundary problems for infinite journal bearings*, Math.
    Comp. 25, 1971, doi:10.1090/S0025-5718-1971-0298961-7. Moré, Toraldo, *On the solution of large quadratic
    programming problems with bound constraints*, SIAM J. Optim. 1, 1991, doi:10.1137/0801008.
    """
    angle, width = nodes(0.0, 2.0 * np.pi, size), nodes(0.0, 2.0 * half_length, size)
    step, depth = angle[1] - angle[0], width[1] - width[0]

    def film_cubed(at: np.ndarray) -> np.ndarray:
        return np.asarray((1.0 + eccentricity * np.cos(at)) ** 3)[:, None]

    middle = 0.5 * (angle[1:] + angle[:-1])
    around = film_cubed(middle) * (depth / step)
    across = film_cubed(angle[1:-1]) * (step / depth)
    M = balanced_matrix((size, size), ([-around[:-1], -across], [-around[1:], -across]))
    source = eccentricity * np.sin(angle[1:-1]) * (step * depth)
    return Scene(
        problem=LCP(M, -np.repeat(source, size)),
        is_symmetric=True,
        is_h_plus=True,
        coordinates=(angle[1:-1], width[1:-1]),
        axis_labels=("angle", "width"),
        unknown="pressure",
        active_means="torn film, no pressure",
    )


@scene_builder
def elastic_plastic_torsion(
    *,
    size: Count = 100,
    section: Annotated[str, one_of("square", "disc")] = "square",
    plastic_share: BelowOne = 0.5,
    mixed: bool = False,
) -> Scene:
    """Stress function of a twisted elastic, perfectly plastic bar: a box whose width is the distance to the boundary.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size², mesh width 2/(size + 1).
    section
        Square [−1, 1]², or the unit disc within it; the nodes outside the disc are fixed at 0.
    plastic_share
        Share of the disc that is plastic, in [0, 1); the square is twisted as much as the disc would be, and less of
        it yields: its corners stay elastic.
    mixed
        Twist the two halves of the section in opposite directions, so that both bounds become active.

    Notes
    -----
    −Δu = c where |u| < dist, −dist ≤ u ≤ dist, dist the distance to the boundary; |∇u| ≤ 1 is the yield condition.
    On the disc, without `mixed`, u = 1 − r where r ≥ r* = 2/c, and u = 1 − r* + c (r*² − r²)/4 elsewhere, so that
    c = 2/√(1 − plastic_share). Rows are those of the five-point stencil (4, −1), that is −h²Δ.

    References
    ----------
    Ting, *Elastic-plastic torsion of convex cylindrical bars*, J. Math. Mech. 19, 1969. Moré, Toraldo, *On the
    solution of large quadratic programming problems with bound constraints*, SIAM J. Optim. 1, 1991,
    doi:10.1137/0801008.
    """
    axis = nodes(-1.0, 1.0, size)[1:-1]
    x, y = np.ix_(axis, axis)
    r = np.hypot(x, y)
    distance = (
        1.0 - np.maximum(np.abs(x), np.abs(y)) if section == "square" else np.maximum(1.0 - r, 0.0)
    )
    twist = 2.0 / math.sqrt(1.0 - plastic_share)
    load = twist * (np.sign(x) if mixed else 1.0) * (2.0 / (size + 1)) ** 2
    continuum = None
    if section == "disc" and not mixed:
        continuum = np.where(distance > 0.0, _disc_solution(r, distance, twist), 0.0).ravel()
    bound = distance.ravel()
    legs = (-1.0, -1.0)
    return Scene(
        problem=LCP(
            stencil_matrix((size, size), 4.0, legs, legs),
            -np.broadcast_to(load, (size, size)).ravel(),
            lower=-bound,
            upper=bound,
        ),
        continuum=continuum,
        is_symmetric=True,
        is_h_plus=True,
        active_share=None if continuum is None else float(np.mean(np.abs(continuum) == bound)),
        unknown="stress function",
        active_means="plastic",
        coordinates=(axis, axis),
        axis_labels=("x", "y"),
    )


def _disc_solution(r: Field, distance: Field, twist: float) -> Field:
    """Return the stress function of the disc without reversal; plastic, u = 1 − r, from r = 2/c on."""
    elastic_radius = 2.0 / twist
    core = 1.0 - elastic_radius + 0.25 * twist * (elastic_radius**2 - r**2)
    return np.where(r < elastic_radius, np.minimum(core, distance), distance)


@scene_builder
def rigid_stack(
    *,
    blocks: Count = 10,
    points: Annotated[int, at_least(2)] = 4,
    mass_ratio: Positive = 1.0,
    push: float = 0.0,
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
    exact = (
        _share_of_the_weight(blocks) if points == 2 and mass_ratio == 1.0 and push == 0.0 else None
    )
    return Scene(
        problem=LCP(M, J @ velocity),
        exact=exact,
        is_symmetric=True,
        is_h_plus=blocks == 1 and points == 2,
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


# --- Switches ---------------------------------------------------------------------------------------------------


@scene_builder
def diode_bridge(*, current: float = 3.0, leak: Positive = 0.125, load: Positive = 0.375) -> Scene:
    """Full-wave rectifier with four ideal diodes: potentials are free, currents are not negative.

    Parameters
    ----------
    current
        Fed into the first terminal and out of the second, ampere; with either sign it flows through the load one way.
    leak
        Conductance between the terminals, siemens.
    load
        Conductance of the load, siemens.

    Notes
    -----
    Unknowns: potentials of terminals 1, 2 and of the load's ends 3, 4 in volt, then the currents of the diodes 1→3,
    2→3, 4→1, 4→2 in ampere. Rows: Kirchhoff's current law in each node (equations), and no forward voltage across a
    diode. M = [[G, A], [−Aᵀ, 0]] is positive semidefinite, half of its diagonal may be zero. The load's lower end is
    earthed through 1 siemens, so that it lies at 0 volt; two diodes conduct, and the terminals are
    |current|/(leak + load) apart.

    References
    ----------
    Acary, Bonnefon, Brogliato, *Nonsmooth Modeling and Simulation for Switched Circuits*, Springer 2011,
    doi:10.1007/978-90-481-9681-4.
    """
    G = np.array(
        [[leak, -leak, 0, 0], [-leak, leak, 0, 0], [0, 0, load, -load], [0, 0, -load, load + 1.0]]
    )
    A = np.array([[1, 0, -1, 0], [0, 1, 0, -1], [-1, -1, 0, 0], [0, 0, 1, 1]])
    M = np.block([[G, A], [-A.T, np.zeros((4, 4))]])
    voltage = abs(current) / (leak + load)
    through = voltage * load
    forward = current >= 0.0
    potentials = [voltage * forward, voltage * (not forward), voltage, 0.0]
    currents = [
        through * forward,
        through * (not forward),
        through * (not forward),
        through * forward,
    ]
    exact = np.array(potentials + currents)
    lower = np.repeat([-np.inf, 0.0], 4)
    return Scene(
        problem=LCP(M, np.array([-current, current, 0, 0, 0, 0, 0, 0]), lower=lower),
        exact=exact,
    )


@scene_builder
def relay_control(*, n: Count = 20, seed: Seed = 0) -> Scene:
    """Relays that steer a system to its sliding surfaces in one implicit Euler step: z in [−1, 1], skew M.

    Parameters
    ----------
    n
        Number of relays.
    seed
        Of the generator that draws everything.

    Notes
    -----
    z_i = 1 where the surface is still to be reached from above (w_i < 0), −1 from below, between where the system
    slides. M = D + K with D diagonal and positive and K skew and much larger: positive definite, far from dominant,
    so that relaxation methods go astray; the answer is unique. It is planted, multiples of ¼, some relays exactly at
    the switch (|z_i| = 1 and w_i = 0).

    References
    ----------
    Acary, Brogliato, *Implicit Euler numerical scheme and chattering-free implementation of sliding mode systems*,
    Systems & Control Letters 59, 2010.
    """
    generator = np.random.default_rng(seed)
    above = np.triu(generator.integers(-4, 5, (n, n)), 1).astype(np.float64)
    M = np.diag(generator.integers(1, 4, n)) + above - above.T
    exact = np.clip(generator.integers(-6, 7, n) / 4.0, -1.0, 1.0)
    w = np.where(np.abs(exact) == 1.0, -exact * generator.integers(0, 4, n), 0.0)
    return Scene(
        problem=LCP(M, w - M @ exact, lower=-1.0, upper=1.0),
        exact=exact,
        is_symmetric=not above.any(),
        is_h_plus=not above.any(),
    )
