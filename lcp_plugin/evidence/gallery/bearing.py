"""The oil film of a journal bearing, which tears where its pressure would fall below that of vapour."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from ...problem.lcp import LCP
from .parameters import Count, Positive, Rule
from .registry import scene_builder
from .scene import Scene
from .stencil import nodes, stencil_matrix

Eccentricity = Annotated[float, Rule("≥ 0 and < 1", lambda value: 0.0 <= value < 1.0)]


@scene_builder
def journal_bearing(*, size: Count = 100, eccentricity: Eccentricity = 0.8, half_length: Positive = 10.0) -> Scene:
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
    below, above = [-around[:-1], -across], [-around[1:], -across]
    M = stencil_matrix((size, size), -sum(below) - sum(above), below, above)
    source = eccentricity * np.sin(angle[1:-1]) * (step * depth)
    return Scene(
        problem=LCP(M, -np.repeat(source, size)),
        is_symmetric=True,
        is_h_plus=True,
        grid=(size, size),
        coordinates=(angle[1:-1], width[1:-1]),
        axis_labels=("angle", "width"),
        unknown="pressure",
        active_means="torn film, no pressure",
    )
