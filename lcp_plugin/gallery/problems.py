"""Test problems: membranes over an obstacle.

A journal bearing with cavitation, and the elastic-plastic torsion of a bar.

Games and options: Nash equilibria, the American put and the tree that checks it.

Matrices that couple each node of a grid with its nearest neighbors.

Problems with a solution chosen first: the paper's examples, and one with active constraints.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..core.checks import Vector
from ..core.lcp import LCP
from ..problems.reformulations import lcp_from_bimatrix_game
from .scene import Scene, require, scene_builder

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
    axis = nodes(-HALF_SIDE, HALF_SIDE, size)
    r = np.hypot(*np.ix_(axis, axis))
    solution, radius, legs = sphere_solution(r), r[interior(2)], (-1.0, -1.0)
    M = stencil_matrix(radius.shape, 4.0, legs, legs)
    q, lower = dirichlet_terms(solution, legs, legs), sphere_obstacle(radius).ravel()
    continuum = solution[interior(2)].ravel()
    if shifted:
        q, continuum, lower = M @ lower + q, continuum - lower, np.zeros(lower.size)
    return Scene(
        problem=LCP(M, q, lower=lower),
        continuum=continuum,
        coordinates=(axis[1:-1], axis[1:-1]),
        axis_labels=("x", "y"),
        unknown="height",
        active_means="on the obstacle",
    )


def sphere_obstacle(r: Field) -> Field:
    """Return ψ(r) = √(1 − r²), continued by the tangent at r = 0.9; any shape."""
    slope = -CONE_BEGINS / math.sqrt(1.0 - CONE_BEGINS**2)
    sphere = np.sqrt(1.0 - np.minimum(r, CONE_BEGINS) ** 2)
    return sphere + slope * np.maximum(r - CONE_BEGINS, 0.0)


def sphere_solution(r: Field) -> Field:
    """Return the analytic u(r); any shape."""
    strength = CONTACT_RADIUS**2 / math.sqrt(1.0 - CONTACT_RADIUS**2)
    free = -np.log(np.maximum(r, CONTACT_RADIUS) / 2.0)
    return np.where(r < CONTACT_RADIUS, sphere_obstacle(r), strength * free)


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
    angle = nodes(0.0, 2.0 * np.pi, size)
    width = nodes(0.0, 2.0 * half_length, size)
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
        coordinates=(angle[1:-1], width[1:-1]),
        axis_labels=("angle", "width"),
        unknown="pressure",
        active_means="torn film, no pressure",
    )


@scene_builder
def elastic_plastic_torsion(
    *, size: int = 100, section: str = "square", plastic_share: float = 0.5, mixed: bool = False
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
        unknown="stress function",
        active_means="plastic",
        coordinates=(axis, axis),
        axis_labels=("x", "y"),
    )


_CYCLE = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]])

# Payoffs of the row and of the column player; the equilibrium if there is only one.
_GAMES: dict[str, tuple[Any, Any, tuple[list[float], list[float]] | None]] = {
    "battle_of_the_sexes": ([[2, 0], [0, 1]], [[1, 0], [0, 2]], None),
    "prisoners_dilemma": ([[-1, -3], [0, -2]], [[-1, 0], [-3, -2]], ([0, 1], [0, 1])),
    "matching_pennies": ([[1, -1], [-1, 1]], [[-1, 1], [1, -1]], ([1, 1], [1, 1])),
    "chicken": ([[0, -1], [1, -9]], [[0, 1], [-1, -9]], None),
    "stag_hunt": ([[4, 1], [3, 2]], [[4, 3], [1, 2]], None),
    "rock_paper_scissors": (_CYCLE, -_CYCLE, ([1, 1, 1], [1, 1, 1])),
    "shapley": (np.eye(3), np.roll(np.eye(3), 1, axis=1), ([1, 1, 1], [1, 1, 1])),
    "indifferent": (np.ones((3, 4)), np.ones((3, 4)), None),
}


@scene_builder
def bimatrix_game(*, game: str = "battle_of_the_sexes") -> Scene:
    """Nash equilibria of a classical two-player game: M = [[0, K], [Lᵀ, 0]], zero diagonal, often several answers.

    Parameters
    ----------
    game
        Name of the game. Pure and mixed, unique and several equilibria; "indifferent" is degenerate everywhere.

    Notes
    -----
    ``scene.problem.origin.recover(result)`` gives the mixed strategies. `exact` is declared if the equilibrium is
    unique. In Shapley's game the players' best answers chase each other round a cycle.

    References
    ----------
    Luce, Raiffa, *Games and Decisions*, Wiley 1957. Lemke, Howson, *Equilibrium points of bimatrix games*, J. SIAM 12,
    1964, doi:10.1137/0112033.
    """
    require(game in _GAMES, f"game must be one of {', '.join(_GAMES)}, got {game!r}")
    row_payoffs, column_payoffs, unique = _GAMES[game]
    problem = lcp_from_bimatrix_game(row_payoffs, column_payoffs)
    M = problem.csr.toarray()
    exact = None if unique is None else _scaled(M, *unique)
    return Scene(problem=problem, exact=exact)


def _scaled(M: NDArray[np.float64], row: list[float], column: list[float]) -> Vector:
    """Return (x, y) with the smallest cost of either player scaled to 1."""
    m = len(row)
    x, y = np.array(row, dtype=np.float64), np.array(column, dtype=np.float64)
    return np.concatenate([x / np.min(M[m:, :m] @ x), y / np.min(M[:m, m:] @ y)])


# --- Options ----------------------------------------------------------------------------------------------------


@scene_builder
def american_put(
    *,
    size: int = 1001,
    strike: float = 100.0,
    rate: float = 0.05,
    volatility: float = 0.2,
    maturity: float = 1.0,
    log_range: float = 1.5,
    steps: int = 100,
) -> Scene:
    """American put, one implicit Euler step of length maturity/steps back from the payoff.

    Parameters
    ----------
    size
        Interior nodes in the logarithm of the spot price; odd numbers put one on the strike.
    strike
        Strike price K, currency; the unit of z.
    rate
        Riskless rate r ≥ 0, 1/year.
    volatility
        σ > 0, 1/√year.
    maturity
        T > 0, years.
    log_range
        The grid covers spot prices K e^±log_range.
    steps
        Number of steps that `maturity` is divided into; this problem is the first of them.

    Notes
    -----
    With x = log(S/K), time to maturity τ and 𝓐V = −½σ² V_xx − (r − ½σ²) V_x + r V the value solves
    V_τ + 𝓐V ≥ 0, V ≥ K(1 − eˣ)₊, complementary. One step: M = I + Δτ 𝓐ₕ, q = −V_old, lower = payoff, and
    the payoff on both endpoints of the grid folded into q. The drift is differenced centrally if that keeps the
    off-diagonal entries ≤ 0, which is h |r − ½σ²| ≤ σ², and upwind otherwise: M is always a strictly dominant
    M-matrix. The contact set is one interval of low prices.

    References
    ----------
    Brennan, Schwartz, *The valuation of American put options*, J. Finance 32, 1977, doi:10.2307/2326779.
    Jaillet, Lamberton, Lapeyre, *Variational inequalities and the pricing of American options*, Acta Appl.
    Math. 21, 1990, doi:10.1007/BF00047211.
    """
    return replace(american_put_march(**locals()), steps=1, advance=None)


@scene_builder
def american_put_march(
    *,
    size: int = 1001,
    strike: float = 100.0,
    rate: float = 0.05,
    volatility: float = 0.2,
    maturity: float = 1.0,
    log_range: float = 1.5,
    steps: int = 100,
) -> Scene:
    """American put, the whole march of implicit Euler steps from the payoff back to today.

    Parameters
    ----------
    size, strike, rate, volatility, maturity, log_range
        As in `american_put`.
    steps
        Number of equal steps in time; the solution of the last is today's price.

    Notes
    -----
    The matrix is the same in every step, only q changes: ``problem = problem.with_q(scene.advance(z))``.
    """
    names = ("strike", "volatility", "maturity", "log_range")
    for name, value in zip(names, (strike, volatility, maturity, log_range), strict=True):
        require(value > 0.0, f"{name} must be a number > 0, got {value}")
    time_step = maturity / steps
    log_price = nodes(-log_range, log_range, size)
    payoff = strike * np.maximum(1.0 - np.exp(log_price), 0.0)
    below, above = _log_price_legs(rate, volatility, time_step, 2.0 * log_range / (size + 1))
    M = stencil_matrix((size,), 1.0 + time_step * rate - below - above, [below], [above])
    # boundary − values, as a partial function that can be sent to other processes
    advance = partial(np.subtract, dirichlet_terms(payoff, [below], [above]))
    inside = payoff[1:-1]
    return Scene(
        problem=LCP(M, advance(inside), lower=inside),
        coordinates=(strike * np.exp(log_price[1:-1]),),
        axis_labels=("spot price",),
        unknown="option price",
        active_means="exercise at once",
        steps=steps,
        advance=advance,
    )


def _log_price_legs(
    rate: float, volatility: float, time_step: float, h: float
) -> tuple[float, float]:
    """Return the entries of Δτ 𝓐ₕ below and above the diagonal, neither of them positive."""
    diffusion = 0.5 * volatility**2 / h**2
    drift = (rate - 0.5 * volatility**2) / h
    below, above = 0.5 * drift - diffusion, -0.5 * drift - diffusion
    if max(below, above) > 0.0:
        below, above = min(drift, 0.0) - diffusion, min(-drift, 0.0) - diffusion
    return time_step * below, time_step * above


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
        As in `american_put`.
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
    for name, value in (("volatility", volatility), ("maturity", maturity), ("steps", steps)):
        require(value > 0, f"binomial_put: {name} must be positive, got {value}")
    is_whole = isinstance(steps, (int, np.integer))
    require(is_whole, f"binomial_put: steps must be an integer ≥ 1, as 1000, got {steps!r}")
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
    return _paper_scene(n, delta, below=-1.0, above=-1.0)


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
    diagonal block is printed as tridiag(−1, 4, −1); the tables were computed with the block given here.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, §5.
    """
    return _paper_scene(n, delta, below=-1.5, above=-0.5)


def _paper_scene(n: int, delta: float, below: float, above: float) -> Scene:
    side = _side(n)
    M = stencil_matrix((side, side), 4.0 + delta, (below, below), (above, above))
    exact = np.resize([1.0, 2.0], n)
    return Scene(
        problem=LCP(M, -(M @ exact)),
        exact=exact,
        start=np.resize([1.0, 0.0], n),
        grid=(side, side),
        axis_labels=("row", "column"),
    )


@scene_builder
def half_active(
    *, n: int = 10_000, delta: float = 4.0, block: int = 5, degenerate: bool = True
) -> Scene:
    """Five-point Laplacian plus delta I, constraints active on every other block of a checkerboard.

    Parameters
    ----------
    n
        Number of unknowns, a perfect square m².
    delta
        Shift of the diagonal, at least 0; q is exact in floating point if it is an integer.
    block
        Side of the checkerboard's blocks in nodes. The share is exactly one half if 2·block divides m.
    degenerate
        Whether the first corner of each active block has z* = w* = 0; otherwise z* + w* > 0 throughout.

    Notes
    -----
    The solution is chosen first: z* = 1, 2, 1, 2, … and w* = 0 on free blocks, on active ones the other way round;
    then q = w* − M z*. The paper's own examples have no active constraint and so do not test
    complementarity: an iteration for the linear system alone would solve them.
    """
    side = _side(n)
    M = stencil_matrix((side, side), 4.0 + delta, (-1.0, -1.0), (-1.0, -1.0))
    row, column = np.divmod(np.arange(n), side)
    is_active = (row // block + column // block) % 2 == 1
    values = np.resize([1.0, 2.0], n)
    exact = np.where(is_active, 0.0, values)
    slack = np.where(is_active, values, 0.0)
    if degenerate:
        slack[(row % block == 0) & (column % block == 0)] = 0.0
    return Scene(
        problem=LCP(M, slack - M @ exact),
        exact=exact,
        grid=(side, side),
        axis_labels=("row", "column"),
    )


def _side(n: int) -> int:
    """Return √n, or raise InvalidOption."""
    side = math.isqrt(n)
    require(side**2 == n, f"n must be a perfect square, got {n}")
    return side
