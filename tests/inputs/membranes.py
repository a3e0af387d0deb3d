"""Membranes and a random matrix that only tests use; `build` and `parse` also take the test problems of the gallery."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from applications import Application
from applications import membranes as applied
from scipy.sparse.linalg import spsolve
from stability_atlas import Field, balanced_matrix, stencil_matrix, stiff_cells, upwind

from lcp_plugin import LCP, gallery
from lcp_plugin.core.settings import parse_options
from lcp_plugin.gallery import Scene

BLOCKS = 10


def stated(given: Application) -> LCP:
    """Return the problem of an application."""
    return LCP(given.M, given.q, lower=given.lower, upper=given.upper)


def obstacle_3d(*, size: int = 30) -> Scene:
    """Membrane over a ball's profile in the unit cube; n = size³."""
    return Scene(problem=stated(applied.obstacle_3d(size)))


def journal_bearing(*, size: int = 100, eccentricity: float = 0.8) -> Scene:
    """Pressure in the oil film of a journal bearing with cavitation; the film spans a ratio of ((1 + ε)/(1 − ε))³."""
    return Scene(problem=stated(applied.bearing(size, eccentricity)))


def convection_diffusion(
    *, size: int = 100, diffusion: float = 1e-3, wind_angle: float = 0.6
) -> Scene:
    """Membrane above the ground in a constant wind: upwind differences, nonsymmetric M-matrix.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size², mesh width h = 1/(size + 1).
    diffusion
        ε ≥ 0; below h the wind dominates.
    wind_angle
        Between the wind, which has length 1, and the first axis, radian.

    Notes
    -----
    −ε Δu + b·∇u ≥ f, u ≥ 0, complementary, u = 0 on the boundary, f = 10 sin 3πx sin 2πy, by first-order upwind
    differences. Rows are scaled by h²/max(ε, h).
    """
    h = 1.0 / (size + 1)
    scale = 1.0 / max(diffusion, h)
    below, above = upwind(diffusion, (h * math.cos(wind_angle), h * math.sin(wind_angle)))
    M = balanced_matrix(
        (size, size), ([scale * leg for leg in below], [scale * leg for leg in above])
    )
    return pulled_membrane(M, size, scale)


def pulled_membrane(M: sp.csr_array, size: int, scale: float = 1.0) -> Scene:
    """Return the test problem of a membrane above the ground that the force f pulls up and down."""
    axis = np.linspace(0.0, 1.0, size + 2)[1:-1]
    x, y = np.ix_(axis, axis)
    force: Field = 10.0 * np.sin(3.0 * np.pi * x) * np.sin(2.0 * np.pi * y)
    q = (-scale / (size + 1) ** 2 * force).ravel()
    return Scene(
        problem=LCP(M, q),
        coordinates=(axis, axis),
        axis_labels=("x", "y"),
        unknown="height",
        active_means="on the ground",
    )


def coefficient_jumps(*, size: int = 100, contrast: float = 1e6, seed: int = 0) -> Scene:
    """Membrane above the ground whose stiffness jumps at random between 10 × 10 blocks.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size², mesh width 1/(size + 1).
    contrast
        The logarithm of the stiffness is uniform over a range of this ratio.
    seed
        Seed of the generator that draws the blocks.

    Notes
    -----
    −∇·(k ∇u) ≥ f, u ≥ 0, complementary, u = 0 on the boundary, f = 10 sin 3πx sin 2πy. k is constant on each cell of
    the mesh; an edge takes the mean of the two cells it separates. Rows are scaled by h². The error of z can be much
    larger than its residual: about contrast times.
    """
    stiffness = 10.0 ** (
        np.random.default_rng(seed).uniform(-0.5, 0.5, (BLOCKS, BLOCKS)) * math.log10(contrast)
    )
    block = np.minimum(np.arange(size + 1) * BLOCKS // (size + 1), BLOCKS - 1)
    cells = stiffness[np.ix_(block, block)]
    M = balanced_matrix((size, size), stiff_cells(cells))
    return pulled_membrane(M, size)


def rotated_anisotropy(*, size: int = 100, ratio: float = 1e-4, degrees: float = 30.0) -> Scene:
    """Membrane above the ground, stiff along fibres that cross the grid at an angle; M has positive couplings.

    Parameters
    ----------
    size
        Interior nodes along each axis; n = size², mesh width 1/(size + 1).
    ratio
        Stiffness across the fibres, divided by that along them.
    degrees
        Angle between the fibres and the first axis.

    Notes
    -----
    −∇·(K ∇u) ≥ f as in `coefficient_jumps`, K with the eigenvalues 1 and `ratio`, by bilinear finite elements: a
    nine-point stencil, symmetric and positive definite, but no M-matrix.
    """
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    first, second = cosine**2 + ratio * sine**2, sine**2 + ratio * cosine**2
    mixed = (1.0 - ratio) * cosine * sine
    mass, slope, stiffness = (
        sp.diags_array(legs, offsets=[-1, 0, 1], shape=(size, size), dtype=np.float64)
        for legs in ([1 / 6, 4 / 6, 1 / 6], [-0.5, 0.0, 0.5], [-1.0, 2.0, -1.0])
    )
    M = sp.csr_array(
        first * sp.kron(stiffness, mass)
        + second * sp.kron(mass, stiffness)
        - 2.0 * mixed * sp.kron(slope, slope)
    )
    M.eliminate_zeros()
    return pulled_membrane(M, size)


def random_h_plus(
    *,
    n: int = 2000,
    entries_per_row: int = 5,
    row_scale: int = 20,
    column_scale: int = 10,
    active_share: float = 0.5,
    seed: int = 0,
) -> Scene:
    """Random sparse H₊-matrix, rows and columns scaled by 2^±scale, with a solution exact to the last bit.

    Notes
    -----
    M = R A C with A an integer matrix of strictly dominant rows and R, C diagonal powers of two. z* = C⁻¹ẑ, w* = R ŵ
    with small integers ẑ, ŵ, one in ten of the zeros of ẑ degenerate, and q = R (ŵ − A ẑ), without rounding.
    """
    rng, rows = np.random.default_rng(seed), np.repeat(np.arange(n), entries_per_row)
    # A step of 1 … n − 1 around the circle never lands on the diagonal.
    columns = (rows + rng.integers(1, n, size=rows.size)) % n
    signs, sizes = rng.choice([-1.0, 1.0], rows.size), rng.integers(1, 10, rows.size)
    others = sp.csr_array((signs * sizes, (rows, columns)), shape=(n, n))
    diagonal = np.asarray(abs(others).sum(axis=1)).ravel() + rng.integers(1, 10, size=n)
    A = (others + sp.diags_array(diagonal)).tocsr()
    A.eliminate_zeros()
    active = rng.permutation(n)[: round(active_share * n)]
    z, w = rng.integers(1, 10, size=n).astype(np.float64), np.zeros(n)
    w[active], z[active] = z[active], 0.0
    w[active[: len(active) // 10]] = 0.0
    row_power = np.exp2(rng.integers(-row_scale, row_scale + 1, size=n))
    column_power = np.exp2(rng.integers(-column_scale, column_scale + 1, size=n))
    q = row_power * (w - A @ z)
    A.data *= np.repeat(row_power, np.diff(A.indptr)) * column_power[A.indices]
    return Scene(problem=LCP(A, q), exact=z / column_power)


class Put(NamedTuple):
    """The first problem of an American put in implicit Euler steps; ``advance(z)`` is the q of the next step."""

    problem: LCP
    steps: int
    advance: Callable[[Field], Field]


def american_put(*, size: int = 1001, volatility: float = 0.2, steps: int = 100) -> Put:
    """An American put of one year, at a strike of 100 and 5 % interest, over log(S/K) in (−1.5, 1.5)."""
    log_price = np.linspace(-1.5, 1.5, size + 2)
    payoff, h = 100.0 * np.maximum(1.0 - np.exp(log_price), 0.0), 3.0 / (size + 1)
    diffusion, drift = 0.5 * (volatility / h) ** 2, 0.5 * (0.05 - 0.5 * volatility**2) / h
    below, above = (drift - diffusion) / steps, -(drift + diffusion) / steps
    M = stencil_matrix((size,), 1.0 + 0.05 / steps - below - above, [below], [above])
    inside, terms = payoff[1:-1], np.zeros(size)
    terms[0] = below * payoff[0]  # at the other end the put is worth nothing
    return Put(LCP(M, terms - inside, lower=inside), steps, lambda z: terms - z)


def active_set(problem: LCP, z: Field) -> Field:
    """Return the answer by primal-dual active-set steps from z, each one sparse direct solve."""
    M, lower, upper, known = problem.csr, problem.lower, problem.upper, None
    for _ in range(100):
        step = z - problem.slack(z) / problem.diagonal
        sides = (step >= upper).astype(int) - (step <= lower)
        if known is not None and np.array_equal(sides, known):
            return z
        known = sides
        z = np.where(sides < 0, lower, np.where(sides > 0, upper, 0.0))
        free = np.flatnonzero(sides == 0)
        z[free] = spsolve(M[free][:, free].tocsc(), -problem.slack(z)[free])
    raise AssertionError("the reference did not settle")


BUILDERS: dict[str, Callable[..., Scene]] = {
    builder.__name__: builder
    for builder in (
        obstacle_3d,
        convection_diffusion,
        coefficient_jumps,
        rotated_anisotropy,
        random_h_plus,
        journal_bearing,
    )
}


def build(name: str, **parameters: Any) -> Scene:
    """Return the test problem of that name, of this file or of the gallery."""
    if name not in BUILDERS:
        return gallery.build(name, **parameters)
    return replace(BUILDERS[name](**parameters), name=name, parameters=parameters)


def parse(text: str) -> Scene:
    """Return the test problem written as name or name:parameter=value,…"""
    name, _, settings = text.partition(":")
    return build(name, **parse_options(filter(None, settings.split(","))))
