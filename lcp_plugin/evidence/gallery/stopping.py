"""When to stop a diffusion with drift: an obstacle problem whose matrix is not symmetric."""

from __future__ import annotations

import numpy as np

from ...problem.lcp import LCP
from .parameters import Count, NonNegative, Positive
from .registry import scene_builder
from .scene import Scene
from .stencil import Field, dirichlet_terms, interior, nodes, stencil_matrix


@scene_builder
def optimal_stopping(
    *,
    size: Count = 100,
    diffusion: Positive = 1e-2,
    wind_x: float = 1.0,
    wind_y: float = 0.5,
    swirl: float = 0.0,
    discount: NonNegative = 1.0,
    gain: float = 0.0,
) -> Scene:
    """Optimal stopping of a drifting diffusion on the unit square: upwind differences, nonsymmetric M-matrix.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size², mesh width 1/(size + 1).
    diffusion
        ε > 0, length²/time; small values give sharp layers and a strongly nonsymmetric matrix.
    wind_x, wind_y, swirl
        b(x, y) = (wind_x − swirl·(y − ½), wind_y + swirl·(x − ½)), length/time. The process drifts with −b.
    discount
        Rate r ≥ 0, 1/time.
    gain
        Running gain f per unit of time until the process is stopped.

    Notes
    -----
    The value u is the largest expected discounted gain plus reward ψ at the moment of stopping, leaving the
    square included: −ε Δu + b·∇u + r u ≥ f, u ≥ ψ, complementary, u = ψ on the boundary. ψ is a hill and a
    lower one. First-order upwind differences keep every off-diagonal entry ≤ 0 at any ratio of b to ε, so M
    is an M-matrix. Rows are scaled by h². With all of the wind zero M is symmetric.

    References
    ----------
    Kushner, Dupuis, *Numerical Methods for Stochastic Control Problems in Continuous Time*, Springer 2001,
    doi:10.1007/978-1-4613-0007-6.
    """
    axis = nodes(0.0, 1.0, size)
    x, y = np.ix_(axis, axis)
    reward = _hill(x, y, 0.65, 0.6, 0.15) + 0.5 * _hill(x, y, 0.3, 0.25, 0.1)
    inside = interior(2)

    h = 1.0 / (size + 1)
    shape = (size, size)
    wind = (wind_x - swirl * (y[:, 1:-1] - 0.5), wind_y + swirl * (x[1:-1] - 0.5))
    below = [-diffusion - h * np.maximum(b, 0.0) for b in wind]
    above = [-diffusion - h * np.maximum(-b, 0.0) for b in wind]
    M = stencil_matrix(shape, -sum(below) - sum(above) + h**2 * discount, below, above)
    q = dirichlet_terms(reward, below, above) - h**2 * gain
    return Scene(
        problem=LCP(M, q, lower=reward[inside].ravel()),
        is_symmetric=wind_x == wind_y == swirl == 0.0,
        is_h_plus=True,
        grid=shape,
        coordinates=(axis[1:-1], axis[1:-1]),
        axis_labels=("x", "y"),
        unknown="value",
        active_means="stop at once",
    )


def _hill(x: Field, y: Field, at_x: float, at_y: float, width: float) -> Field:
    return np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / (2.0 * width**2))
