"""A bar twisted until part of it yields: the stress function can nowhere be steeper than the yield stress."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from ...problem.lcp import LCP
from .parameters import Count, Rule, one_of
from .registry import scene_builder
from .scene import Scene
from .stencil import Field, nodes, stencil_matrix

PlasticShare = Annotated[float, Rule("≥ 0 and < 1", lambda value: 0.0 <= value < 1.0)]


@scene_builder
def elastic_plastic_torsion(
    *,
    size: Count = 100,
    section: Annotated[str, one_of("square", "disc")] = "square",
    plastic_share: PlasticShare = 0.5,
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
    distance = 1.0 - np.maximum(np.abs(x), np.abs(y)) if section == "square" else np.maximum(1.0 - r, 0.0)
    twist = 2.0 / math.sqrt(1.0 - plastic_share)
    load = twist * (np.sign(x) if mixed else 1.0) * (2.0 / (size + 1)) ** 2
    continuum = None
    if section == "disc" and not mixed:
        continuum = np.where(distance > 0.0, _disc_solution(r, distance, twist), 0.0).ravel()
    bound = distance.ravel()
    legs = (-1.0, -1.0)
    return Scene(
        problem=LCP(
            stencil_matrix((size, size), 4.0, legs, legs), -np.broadcast_to(load, (size, size)).ravel(),
            lower=-bound, upper=bound,
        ),
        continuum=continuum,
        is_symmetric=True,
        is_h_plus=True,
        active_share=None if continuum is None else float(np.mean(np.abs(continuum) == bound)),
        unknown="stress function",
        active_means="plastic",
        grid=(size, size),
        coordinates=(axis, axis),
        axis_labels=("x", "y"),
    )


def _disc_solution(r: Field, distance: Field, twist: float) -> Field:
    """Return the stress function of the disc without reversal; plastic, u = 1 − r, from r = 2/c on."""
    elastic_radius = 2.0 / twist
    core = 1.0 - elastic_radius + 0.25 * twist * (elastic_radius**2 - r**2)
    return np.where(r < elastic_radius, np.minimum(core, distance), distance)
