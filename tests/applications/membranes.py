"""Membranes, plates and images of one function over a grid: obstacles, torsion, bearings, seepage."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from . import Application, application


def line(n: int, h: float | None = None) -> Any:
    """−u'' at n inner nodes, u = 0 at both ends."""
    h = 1.0 / (n + 1) if h is None else h
    return (
        sp.diags_array([-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
        / h**2
    )


def laplacian(*sides: int) -> Any:
    """−Δ with u = 0 on the boundary of the unit square or cube; the first index runs slowest."""
    M = line(sides[0])
    for side in sides[1:]:
        M = sp.kron(M, sp.eye_array(side)) + sp.kron(sp.eye_array(M.shape[0]), line(side))
    return sp.csr_array(M)


def nodes(*sides: int) -> Any:
    """Coordinates of the inner nodes of the unit square or cube, flat."""
    return [
        x.ravel()
        for x in np.meshgrid(*(np.arange(1, n + 1) / (n + 1) for n in sides), indexing="ij")
    ]


def conduction(x: Any, y: Any, k: Any) -> Any:
    """−∇·(k ∇u) by finite volumes on nodes x × y with u = 0 on the first and last; k at centres of cells."""
    hx, hy = np.diff(x), np.diff(y)
    nx, ny = x.size, y.size
    index = np.arange(nx * ny).reshape(nx, ny)
    inner = index[1:-1, 1:-1].ravel()
    # faces between (i, j) and (i + 1, j), j inner
    east = 0.5 * (k[:, :-1] * hy[:-1] + k[:, 1:] * hy[1:]) / hx[:, None]
    north = 0.5 * (k[:-1] * hx[:-1, None] + k[1:] * hx[1:, None]) / hy
    a = np.concatenate([index[:-1, 1:-1].ravel(), index[1:-1, :-1].ravel()])
    b = np.concatenate([index[1:, 1:-1].ravel(), index[1:-1, 1:].ravel()])
    g = np.concatenate([east.ravel(), north.ravel()])
    A = sp.coo_array(
        (
            np.concatenate([g, g, -g, -g]),
            (np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])),
        ),
        shape=(nx * ny, nx * ny),
    ).tocsr()
    return sp.csr_array(A[inner][:, inner])


@application(small=dict(side=30), full=dict(side=200))
def obstacle_2d(side: int) -> Application:
    """A membrane over hills and between, as every course on variational inequalities has it; Rodrigues (1987), §1.3."""
    x, y = nodes(side, side)
    return Application(
        laplacian(side, side), np.zeros(side**2), lower=np.sin(9.2 * x) * np.sin(9.3 * y)
    )


@application(small=dict(side=10), full=dict(side=26))
def obstacle_3d(side: int) -> Application:
    """A concentration kept above a ball's profile; a free boundary in space; Rodrigues (1987), ch. 2."""
    x, y, z = nodes(side, side, side)
    M = laplacian(side, side, side)
    return Application(
        M,
        np.full(side**3, 2.0),
        lower=0.3 - 4.0 * ((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.4) ** 2),
    )


@application(small=dict(side=30), full=dict(side=150))
def torsion(side: int) -> Application:
    """Stress function of a twisted square bar, |∇u| ≤ 1 as |u| ≤ distance; Moré, Toraldo (1991)."""
    x, y = nodes(side, side)
    distance = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y))
    return Application(
        laplacian(side, side), np.full(side**2, -5.0), lower=-distance, upper=distance
    )


@application(small=dict(side=9), full=dict(side=24))
def torsion_3d(side: int) -> Application:
    """The same bound in the cube, a load that changes its sign; Glowinski, *Numerical Methods* (1984)."""
    x, y, z = nodes(side, side, side)
    distance = np.minimum.reduce([x, 1 - x, y, 1 - y, z, 1 - z])
    return Application(
        laplacian(side, side, side),
        -20.0 * np.sin(6.0 * x) * (1 + y),
        lower=-distance,
        upper=distance,
    )


@application(
    small=[dict(side=24, eccentricity=0.1), dict(side=24, eccentricity=0.9)],
    full=[dict(side=150, eccentricity=0.1), dict(side=150, eccentricity=0.9)],
)
def bearing(side: int, eccentricity: float) -> Application:
    """Pressure of the film in a journal bearing, cavitation as p ≥ 0; Cryer (1971), MINPACK-2."""
    x, y = np.linspace(0.0, 2.0 * np.pi, side + 2), np.linspace(0.0, 20.0, side + 2)
    film = (1.0 + eccentricity * np.cos(0.5 * (x[1:] + x[:-1]))) ** 3
    M = conduction(x, y, np.repeat(film[:, None], side + 1, axis=1))
    area = (x[1] - x[0]) * (y[1] - y[0])
    return Application(M, np.repeat(-area * eccentricity * np.sin(x[1:-1]), side))


@application(small=dict(side=24), full=dict(side=150))
def seepage(side: int) -> Application:
    """Water through a dam of 16 × 24 m, 4 m behind it, by Baiocchi's variable; Baiocchi et al. (1973)."""
    width, high, low = 16.0, 24.0, 4.0
    m, n = side, side * 3 // 2
    hx, hy = width / (m + 1), high / (n + 1)
    x, y = hx * np.arange(1, m + 1), hy * np.arange(1, n + 1)
    M = sp.csr_array(sp.kron(line(m, hx), sp.eye_array(n)) + sp.kron(sp.eye_array(m), line(n, hy)))
    q = np.ones((m, n))
    q[0] -= 0.5 * (high - y) ** 2 / hx**2
    q[-1] -= 0.5 * np.maximum(low - y, 0.0) ** 2 / hx**2
    q[:, 0] -= (0.5 * high**2 - (high**2 - low**2) * x / (2.0 * width)) / hy**2
    return Application(M, q.ravel())


@application(small=dict(side=24), full=dict(side=120))
def graded_mesh(side: int) -> Application:
    """An obstacle with its tip in a corner, nodes graded towards it as t³; Apel (1999)."""
    x = np.linspace(0.0, 1.0, side + 2) ** 3
    M = conduction(x, x, np.ones((side + 1, side + 1)))
    X, Y = (a.ravel() for a in np.meshgrid(x[1:-1], x[1:-1], indexing="ij"))
    area = np.outer(x[2:] - x[:-2], x[2:] - x[:-2]).ravel() / 4.0
    return Application(M, area, lower=0.1 - 2.0 * np.hypot(X - 0.1, Y - 0.1))


@application(small=dict(side=24), full=dict(side=120))
def stretched_mesh(side: int) -> Application:
    """A boundary layer's cells, a hundred times as long as high; Trottenberg et al., *Multigrid* (2001), ch. 5."""
    x, y = np.linspace(0.0, 100.0, side + 2), np.linspace(0.0, 1.0, side + 2)
    M = conduction(x, y, np.ones((side + 1, side + 1)))
    X, Y = (a.ravel() for a in np.meshgrid(x[1:-1] / 100.0, y[1:-1], indexing="ij"))
    area = (x[1] - x[0]) * (y[1] - y[0])
    return Application(M, np.full(side**2, area), lower=0.05 - (X - 0.5) ** 2 - (Y - 0.5) ** 2)


@application(small=dict(side=30), full=dict(side=120))
def jumps(side: int) -> Application:
    """Heads in ground of clay and gravel, conductivities 10⁻³ to 10³, wells that run dry at 0; Bear (1972)."""
    rng = np.random.default_rng(9)
    blocks = 10.0 ** rng.choice([-3.0, 0.0, 3.0], size=(6, 6))
    k = np.kron(blocks, np.ones((side // 6 + 1, side // 6 + 1)))[: side + 1, : side + 1]
    x = np.linspace(0.0, 1.0, side + 2)
    X, Y = nodes(side, side)
    return Application(conduction(x, x, k), -np.sin(7.0 * X) * np.cos(5.0 * Y) / side**2)


@application(small=dict(side=30), full=dict(side=120))
def rotated_anisotropy(side: int) -> Application:
    """Diffusion along fibres at 30°, 1000 to 1, cross derivative by four points; Trottenberg et al. (2001), ch. 5."""
    c, s, e = np.cos(np.pi / 6), np.sin(np.pi / 6), 1e-3
    D = (
        sp.diags_array([-np.ones(side - 1), np.ones(side - 1)], offsets=[-1, 1], shape=(side, side))
        * (side + 1)
        / 2
    )
    L, eye = line(side), sp.eye_array(side)
    M = sp.kron((c * c + e * s * s) * L, eye) + sp.kron(eye, (s * s + e * c * c) * L)
    M = sp.csr_array(M - 2.0 * (1.0 - e) * c * s * sp.kron(D, D))
    x, y = nodes(side, side)
    return Application(M, 2.0 - 12.0 * np.exp(-20.0 * ((x - 0.4) ** 2 + (y - 0.6) ** 2)))


@application(small=dict(side=16), full=[dict(side=40), dict(side=100)])
def plate(side: int) -> Application:
    """A simply supported plate pressed on a stiff floor, the biharmonic operator as Δ²; Brézis, Stampacchia (1973)."""
    L = laplacian(side, side)
    return Application(sp.csr_array(L @ L), np.full(side**2, 1.0), lower=-2e-3)
