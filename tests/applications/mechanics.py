"""Bodies that touch: elasticity over a floor, beams, friction, a wall of bricks."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP, QuadraticProgram

from . import Application, application
from .references import semidefinite, violation


def square_stiffness(young: float, poisson: float) -> Any:
    """Plane stress on a bilinear square of thickness 1, any side; nodes (0, 0), (1, 0), (1, 1), (0, 1)."""
    k = np.array(
        [
            0.5 - poisson / 6,
            0.125 + poisson / 8,
            -0.25 - poisson / 12,
            -0.125 + 3 * poisson / 8,
            -0.25 + poisson / 12,
            -0.125 - poisson / 8,
            poisson / 6,
            0.125 - 3 * poisson / 8,
        ]
    )
    order = [
        [0, 1, 2, 3, 4, 5, 6, 7],
        [1, 0, 7, 6, 5, 4, 3, 2],
        [2, 7, 0, 5, 6, 3, 4, 1],
        [3, 6, 5, 0, 7, 2, 1, 4],
        [4, 5, 6, 7, 0, 1, 2, 3],
        [5, 4, 3, 2, 1, 0, 7, 6],
        [6, 3, 4, 1, 2, 7, 0, 5],
        [7, 2, 1, 4, 3, 6, 5, 0],
    ]
    return young / (1 - poisson**2) * k[np.array(order)]


def assembled(stiffness: Any, freedom: Any) -> Any:
    """The sum of one stiffness of all elements, whose degrees of freedom are the rows of `freedom`."""
    width = freedom.shape[1]
    at = np.repeat(freedom, width, axis=1).ravel(), np.tile(freedom, width).ravel()
    return sp.coo_array((np.tile(stiffness.ravel(), len(freedom)), at)).tocsr()


def squares(nx: int, ny: int) -> tuple[Any, Any]:
    """The numbers of the nodes of a plate of nx × ny squares, and the degrees of freedom of each square."""
    node = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    corners = np.stack([node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]], axis=-1)
    return node, (2 * corners.reshape(-1, 4)[:, :, None] + [0, 1]).reshape(-1, 8)


def on_a_floor(
    nx: int, ny: int, length: float, pressure: float, gap: float, unit: str, spring: float = 0.0
) -> Application:
    """Steel pressed (in Pa) on a floor gap · x² below (in m), held by u_x = 0 on the left, or by springs."""
    metre = {"m": 1.0, "mm": 1e3}[unit]
    young, pressure, h = 210e9 / metre**2, pressure / metre**2, length * metre / nx
    node, freedom = squares(nx, ny)
    K = assembled(square_stiffness(young, 0.3), freedom)
    q, lower = np.zeros(2 * node.size), np.full(2 * node.size, -np.inf)
    q[2 * node[:, -1] + 1] = pressure * h * np.where(np.isin(np.arange(nx + 1), [0, nx]), 0.5, 1.0)
    lower[2 * node[:, 0] + 1] = -gap * metre * (np.linspace(0.0, length, nx + 1)) ** 2
    if spring:
        K = K + sp.diags_array(np.tile([spring * young, 0.0], node.size))
        kept = np.arange(2 * node.size)
    else:
        kept = np.setdiff1d(np.arange(2 * node.size), 2 * node[0])
    K = sp.csr_array(K[kept][:, kept])
    K, q, lower = sp.csr_array(0.5 * (K + K.T)), q[kept], lower[kept]
    return Application(K, q, lower=lower, program=QuadraticProgram(K, q, lower=lower))


@application(
    small=[dict(side=12, unit="m"), dict(side=12, unit="mm")],
    full=[dict(side=100, unit="m"), dict(side=60, unit="mm")],
)
def block(side: int, unit: str) -> Application:
    """A steel block of 1 × 1 m pressed on a curved floor, in m and N/m² or mm and N/mm²; Kikuchi, Oden (1988)."""
    return on_a_floor(side, side, 1.0, 5e7, 1e-3, unit)


@application(
    small=[dict(nx=96, ny=6, unit="m"), dict(nx=96, ny=6, unit="mm")],
    full=[dict(nx=400, ny=25, unit="m"), dict(nx=240, ny=15, unit="mm")],
)
def beam(nx: int, ny: int, unit: str) -> Application:
    """A steel beam of 10 × .5 m that is pressed on a curved floor, bilinear squares; Kikuchi, Oden (1988)."""
    return on_a_floor(nx, ny, 10.0, 1e5, 4e-5, unit)


@application(small=dict(side=12), full=dict(side=60))
def hardly_supported(side: int) -> Application:
    """The block, held sideways by springs of 10⁻⁹ of its stiffness alone; Wriggers (2006)."""
    return on_a_floor(side, side, 1.0, 5e7, 1e-3, "m", spring=1e-9)


@application(small=dict(elements=40), full=dict(elements=1000))
def hermite_beam(elements: int) -> Application:
    """A cantilever over a floor by cubic elements, unknowns m and rad; Zienkiewicz, Taylor (2000)."""
    h, n = 1.0 / elements, 2 * elements + 2
    k = (
        1e5
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h * h, -6 * h, 4 * h * h],
            ]
        )
    )
    K = assembled(k, 2 * np.arange(elements)[:, None] + np.arange(4))
    q, lower = np.zeros(n), np.full(n, -np.inf)
    q[0::2], lower[0::2] = 1e4 * h, -2e-3
    return Application(sp.csr_array(K[2:, 2:]), q[2:], lower=lower[2:])


def own_residual(problem: LCP) -> Application:
    """Friction may have several answers: the residual of any, in newton seconds and metres a second, is its error."""
    M = sp.csr_array(problem.M)
    data = (M, np.array(problem.q), np.zeros(problem.n), np.full(problem.n, np.inf))
    return Application(problem.M, problem.q, error=lambda z: violation(data, np.maximum(z, 0.0)))


@application(
    small=[dict(contacts=8, uneven=0.0), dict(contacts=8, uneven=0.01)],
    full=[dict(contacts=30, uneven=0.0), dict(contacts=12, uneven=0.01)],
)
def friction_low_rank(contacts: int, uneven: float) -> Application:
    """A plate on many feet, six motions, friction .5, even ground or gaps of all sizes; Stewart, Trinkle (1996)."""
    rng = np.random.default_rng(24)
    arms = np.column_stack([rng.uniform(-0.5, 0.5, size=(contacts, 2)), np.full(contacts, -0.1)])
    rows = [np.hstack([np.tile(e, (contacts, 1)), np.cross(arms, e)]) for e in np.eye(3)]
    mass = np.diag([2.0, 2.0, 2.0, 0.17, 0.17, 0.33])
    pull = np.array([0.03, 0.01, -0.0981, 0.002, -0.001, 0.003])
    velocities = np.stack([rows[2] @ pull, rows[0] @ pull, rows[1] @ pull], axis=1)
    velocities[:, 0] += uneven * rng.random(contacts)  # a gap, by the time step
    return own_residual(
        LCP.from_contacts((mass, rows[2], np.stack(rows[:2], axis=1)), 0.5, velocities)
    )


@application(small=dict(contacts=10), full=dict(contacts=60))
def friction_full_rank(contacts: int) -> Application:
    """Grains that touch, as many motions as contact forces, friction .3; Anitescu, Potra (1997)."""
    rng = np.random.default_rng(25)
    B = rng.normal(size=(3 * contacts, 3 * contacts + 6))
    velocities = rng.normal(size=(contacts, 3)) - [1.0, 0.0, 0.0]
    return own_residual(LCP.from_contacts(B @ B.T / (3 * contacts), 0.3, velocities))


@application(small=dict(courses=4, width=4), full=dict(courses=8, width=6))
def brick_wall(courses: int, width: int) -> Application:
    """A wall in running bond at rest, two frictionless contact points an interface, M singular; Livesley (1978)."""
    bricks = [
        (course, k + 0.5 * (course % 2))
        for course in range(courses)
        for k in range(width - course % 2)
    ]
    touching = [
        (i, None, arm) for i, (course, _) in enumerate(bricks) if course == 0 for arm in (-0.5, 0.5)
    ]
    touching += [
        (i, j, 0.5 * (x + y) + side - x)
        for i, (above, x) in enumerate(bricks)
        for j, (below, y) in enumerate(bricks)
        if above == below + 1 and abs(x - y) < 1
        for side in (-0.25, 0.25)
    ]
    J = np.zeros((len(touching), 2 * len(bricks)))
    for row, (i, j, arm) in enumerate(touching):
        J[row, 2 * i : 2 * i + 2] = 1.0, arm
        if j is not None:
            J[row, 2 * j : 2 * j + 2] = -1.0, bricks[j][1] - bricks[i][1] - arm
    light = J / np.tile([1.0, (1.0 + 0.5**2) / 12.0], len(bricks))
    M = sp.csr_array(light @ J.T)
    falling = np.tile([-1.0, 0.0], len(bricks))
    return Application(
        M,
        J @ falling,
        answer=semidefinite,
        determined=lambda z: (np.append(falling + light.T @ z, 1.0),),
    )  # beside the speed of falling
