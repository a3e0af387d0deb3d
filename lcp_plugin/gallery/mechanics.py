"""A journal bearing with cavitation, and the elastic-plastic torsion of a bar."""

from __future__ import annotations

import math

import numpy as np

from ..core.lcp import LCP
from .scene import SYMMETRIC, Scene, require, scene_builder
from .stencil import balanced_matrix, nodes, stencil_matrix


@scene_builder
def journal_bearing(
    *, size: int = 100, eccentricity: float = 0.8, half_length: float = 10.0
) -> Scene:
    """Pressure in the oil film of a journal bearing with cavitation.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size².
    eccentricity
        Eccentricity relative to the clearance; at 1 the journal would touch. The film's coefficient spans a ratio of
        ((1 + ε)/(1 − ε))³: 8e6 at 0.99.
    half_length
        Half the width of the bearing, in radii.

    Notes
    -----
    Reynolds' equation on θ in (0, 2π) and y in (0, 2 · half_length): −∇·(h³ ∇p) ≥ −∂h/∂θ = ε sin θ, p ≥ 0,
    complementary, p = 0 on the boundary, h = 1 + ε cos θ. An edge takes h³ at its midpoint. Rows are the rows of the
    five-point stencil times both mesh widths.

    References
    ----------
    Cryer, *The method of Christopherson for solving free boundary problems for infinite journal bearings*, Math.
    Comp. 25, 1971, doi:10.1090/S0025-5718-1971-0298961-7. Moré, Toraldo, *On the solution of large quadratic
    programming problems with bound constraints*, SIAM J. Optim. 1, 1991, doi:10.1137/0801008.
    """
    require(0.0 <= eccentricity < 1.0, f"eccentricity must lie in [0, 1), got {eccentricity}")
    require(half_length > 0.0, f"half_length must be a number > 0, got {half_length}")
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
        **SYMMETRIC,
        coordinates=(angle[1:-1], width[1:-1]),
        axis_labels=("angle", "width"),
        unknown="pressure",
        active_means="torn film, no pressure",
    )


@scene_builder
def elastic_plastic_torsion(
    *,
    size: int = 100,
    section: str = "square",
    plastic_share: float = 0.5,
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
    c = 2/√(1 − plastic_share). Rows are the rows of the five-point stencil (4, −1), that is −h²Δ.

    References
    ----------
    Ting, *Elastic-plastic torsion of convex cylindrical bars*, J. Math. Mech. 19, 1969. Moré, Toraldo, *On the
    solution of large quadratic programming problems with bound constraints*, SIAM J. Optim. 1, 1991,
    doi:10.1137/0801008.
    """
    require(section in ("square", "disc"), f"section must be 'square' or 'disc', got {section!r}")
    require(0.0 <= plastic_share < 1.0, f"plastic_share must lie in [0, 1), got {plastic_share}")
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
        elastic_radius = 2.0 / twist  # plastic, u = 1 − r, from here on
        core = 1.0 - elastic_radius + 0.25 * twist * (elastic_radius**2 - r**2)
        continuum = np.where(r < elastic_radius, np.minimum(core, distance), distance).ravel()
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
        **SYMMETRIC,
        active_share=None if continuum is None else float(np.mean(np.abs(continuum) == bound)),
        unknown="stress function",
        active_means="plastic",
        coordinates=(axis, axis),
        axis_labels=("x", "y"),
    )
