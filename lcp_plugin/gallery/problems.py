"""Test problems: a membrane over an obstacle, the paper's examples, and a solution with active constraints.

Also a binomial tree for American puts.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..core.checks import Vector
from ..core.errors import public
from ..core.lcp import LCP
from ..core.settings import whole_number
from .scene import Scene, require, scene_builder

Field = NDArray[np.float64]


CONTACT_RADIUS = 0.6979651482233735
"""The root r* in (0, 1) of r² (1 − log(r/2)) = 1."""

CONE_BEGINS = 0.9
"""From this radius on the sphere is continued by its tangent cone, so that ψ is finite everywhere."""

HALF_SIDE = 2.0  # of the square of the membrane


@scene_builder
def obstacle_2d(*, size: int = 100, shifted: bool = False) -> Scene:
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
    This u gives the boundary values on the square, so it also solves the problem there. From r = 0.9
    on, outside the contact set, ψ is continued by its tangent cone, concave and below u. Rows are the rows of
    the five-point stencil (4, −1), that is −h²Δ. The discretization error falls about like h², unevenly, as
    the discrete contact set grows by whole nodes.

    References
    ----------
    Kinderlehrer, Stampacchia, *An Introduction to Variational Inequalities and Their Applications*, SIAM
    2000, doi:10.1137/1.9780898719451.
    """
    axis, inner = np.linspace(-HALF_SIDE, HALF_SIDE, size + 2), (slice(1, -1), slice(1, -1))
    r = np.hypot(*np.ix_(axis, axis))
    solution, edge = sphere_solution(r), sphere_solution(r)
    continuum, lower, edge[inner] = solution[inner].ravel(), sphere_obstacle(r[inner]).ravel(), 0.0
    M = five_point_matrix(size, 4.0)
    q = 0.0 - (edge[:-2] + edge[2:])[:, 1:-1].ravel() - (edge[:, :-2] + edge[:, 2:])[1:-1].ravel()
    if shifted:
        q, continuum, lower = M @ lower + q, continuum - lower, np.zeros(lower.size)
    facts: dict[str, Any] = {"unknown": "height", "active_means": "on the obstacle"}
    facts |= {"coordinates": (axis[1:-1], axis[1:-1]), "axis_labels": ("x", "y")}
    return Scene(problem=LCP(M, q, lower=lower), continuum=continuum, **facts)


def sphere_obstacle(r: Field) -> Field:
    """Return ψ(r) = √(1 − r²), continued by the tangent at r = 0.9; any shape."""
    slope = -CONE_BEGINS / math.sqrt(1.0 - CONE_BEGINS**2)
    return np.sqrt(1.0 - np.minimum(r, CONE_BEGINS) ** 2) + slope * np.maximum(r - CONE_BEGINS, 0.0)


def sphere_solution(r: Field) -> Field:
    """Return the analytic u(r); any shape."""
    strength = CONTACT_RADIUS**2 / math.sqrt(1.0 - CONTACT_RADIUS**2)
    free = -np.log(np.maximum(r, CONTACT_RADIUS) / 2.0)
    return np.where(r < CONTACT_RADIUS, sphere_obstacle(r), strength * free)


@public
def binomial_put(
    spot: ArrayLike,
    *,
    strike: float,
    rate: float,
    volatility: float,
    maturity: float,
    steps: int = 1000,
) -> Vector:
    """Return American put prices from a binomial tree.

    Parameters
    ----------
    spot
        Spot prices, any shape, currency.
    strike, rate, volatility, maturity
        K in currency, r in 1/year, σ > 0 in 1/√year, T > 0 in years.
    steps
        Levels of the tree, at least 1; the error falls like 1/steps.

    Returns
    -------
    ndarray, shape of `spot`
        Prices, currency.

    Raises
    ------
    InvalidOption
        If volatility, maturity or steps is not positive, if steps is not an integer, or if the steps are so long that
        the tree's probabilities leave (0, 1).

    Notes
    -----
    Up by u = e^{σ√Δ}, down by 1/u, risk-neutral probability (e^{rΔ} − 1/u)/(u − 1/u); on the way back each
    value is the larger of exercise and discounted expectation. O(steps²) for each spot price.

    References
    ----------
    Cox, Ross, Rubinstein, *Option pricing: a simplified approach*, J. Financial Economics 7, 1979,
    doi:10.1016/0304-405X(79)90015-1.

    Examples
    --------
    >>> price = binomial_put(100.0, strike=100.0, rate=0.05, volatility=0.2, maturity=1.0)
    >>> round(float(price), 2)
    6.09
    """
    whole_number(steps, "binomial_put: steps", 1, ", as 1000")
    for name, value in (("volatility", volatility), ("maturity", maturity)):
        require(value > 0, f"binomial_put: {name} must be positive, got {value}")
    time_step = maturity / steps
    up, growth = math.exp(volatility * math.sqrt(time_step)), math.exp(rate * time_step)
    probability = (growth - 1.0 / up) / (up - 1.0 / up)
    least = math.floor(maturity * (rate / volatility) ** 2) + 1
    words = f"steps must be at least {least} at this rate and volatility, got {steps}"
    require(0.0 < probability < 1.0, f"binomial_put: {words}")
    price = np.asarray(spot, dtype=np.float64)[..., None]
    exercise = np.maximum(strike - price * up ** np.arange(-steps, steps + 1), 0.0)
    values = exercise[..., ::2]
    for level in range(steps - 1, -1, -1):
        expected = (probability * values[..., 1:] + (1.0 - probability) * values[..., :-1]) / growth
        first = steps - level
        values = np.maximum(expected, exercise[..., first : first + 2 * level + 1 : 2])
    return values[..., 0]


@scene_builder
def paper_example_1(*, n: int = 100, delta: float = 4.0) -> Scene:
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
    the fourth block row is printed without its minus sign. As w* = 0 and z* > 0, the solution solves the
    linear system M z = −q.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, §5.
    """
    exact, start = np.resize([1.0, 2.0], n), np.resize([1.0, 0.0], n)
    return _five_point(delta, exact, start=start)


@scene_builder
def paper_example_2(*, n: int = 100, delta: float = 4.0) -> Scene:
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
    diagonal block is printed as tridiag(−1, 4, −1); the tables were computed with this block.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, §5.
    """
    exact, start = np.resize([1.0, 2.0], n), np.resize([1.0, 0.0], n)
    return _five_point(delta, exact, legs=(-1.5, -0.5), start=start)


def five_point_matrix(
    side: int, centre: float, legs: tuple[float, float] = (-1.0, -1.0)
) -> sp.csr_array:
    """Return the matrix of centre u_i + Σ (legs[0] u_(i − e) + legs[1] u_(i + e)) over both axes of a square grid.

    Examples
    --------
    >>> five_point_matrix(2, 4.0, (-1.5, -0.5)).toarray()
    array([[ 4. , -0.5, -0.5,  0. ],
           [-1.5,  4. ,  0. , -0.5],
           [-1.5,  0. ,  4. , -0.5],
           [ 0. , -1.5, -1.5,  4. ]])
    """
    line = sp.diags_array([legs[0], centre / 2, legs[1]], offsets=[-1, 0, 1], shape=(side, side))
    return sp.csr_array(sp.kronsum(line, line, format="csr"))


def _five_point(
    delta: float,
    exact: Vector,
    slack: float | Vector = 0.0,
    legs: tuple[float, float] = (-1.0, -1.0),
    **facts: Any,
) -> Scene:
    """Return the test problem of a five-point matrix plus delta I whose solution and slack are chosen."""
    side = _root(exact.size)
    M = five_point_matrix(side, 4.0 + delta, legs)
    facts |= {"grid": (side, side), "axis_labels": ("row", "column")}
    return Scene(problem=LCP(M, slack - M @ exact), exact=exact, **facts)


@scene_builder
def half_active(*, n: int = 10_000, delta: float = 4.0, degenerate: bool = True) -> Scene:
    """Five-point Laplacian plus delta I, constraints active on every other block of a checkerboard.

    Parameters
    ----------
    n
        Number of unknowns, a perfect square m².
    delta
        Shift of the diagonal, at least 0; q is exact in floating point if it is an integer.
    degenerate
        Whether the first corner of each active block has z* = w* = 0; otherwise z* + w* > 0 throughout.

    Notes
    -----
    The solution is chosen first: z* = 1, 2, 1, 2, … and w* = 0 on free blocks, on active ones the other way round;
    then q = w* − M z*. The paper's examples have no active constraint and so do not test
    complementarity: an iteration for the linear system alone would solve them.
    """
    row, column = np.divmod(np.arange(n), _root(n))
    block = 5  # side of the squares of the checkerboard
    is_active = (row // block + column // block) % 2 == 1
    values = np.resize([1.0, 2.0], n)
    exact = np.where(is_active, 0.0, values)
    slack = np.where(is_active, values, 0.0)
    if degenerate:
        slack[(row % block == 0) & (column % block == 0)] = 0.0
    return _five_point(delta, exact, slack)


def _root(n: int) -> int:
    """Return √n, or raise InvalidOption."""
    side = math.isqrt(n)
    require(side**2 == n, f"n must be a perfect square, got {n}")
    return side
