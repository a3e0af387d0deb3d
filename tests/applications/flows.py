"""What flows: convection, fractional diffusion, graphs, circuits, and the paper's two examples."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.special import gamma

from . import Application, application
from .membranes import laplacian, line, nodes

PECLET = (1.0, 30.0, 1000.0)


def convection(side: int, peclet: float, upwind: bool) -> Application:
    h, eye = 1.0 / (side + 1), sp.eye_array(side)
    back = sp.diags_array([-np.ones(side - 1), np.ones(side)], offsets=[-1, 0]) / h
    middle = sp.diags_array([-np.ones(side - 1), np.ones(side - 1)], offsets=[-1, 1]) / (2.0 * h)
    D = back if upwind else middle
    M = laplacian(side, side) + peclet * (sp.kron(D, eye) + 0.5 * sp.kron(eye, D))
    x, y = nodes(side, side)
    source = 4.0 * np.exp(-30.0 * ((x - 0.3) ** 2 + (y - 0.4) ** 2)) - 1.0
    return Application(sp.csr_array(M), -(1.0 + peclet) * source)


@application(
    small=[dict(side=24, peclet=p) for p in PECLET], full=[dict(side=120, peclet=p) for p in PECLET]
)
def upwind(side: int, peclet: float) -> Application:
    """A concentration that is carried by the wind and dries up, upwind differences; Roos, Stynes, Tobiska (2008)."""
    return convection(side, peclet, True)


@application(
    small=[dict(side=24, peclet=p) for p in PECLET], full=[dict(side=120, peclet=p) for p in PECLET]
)
def central(side: int, peclet: float) -> Application:
    """The same with central differences, no M-matrix at 1000; Roos, Stynes, Tobiska (2008)."""
    return convection(side, peclet, False)


@application(small=dict(n=200), full=dict(n=10_000))
def river(n: int) -> Application:
    """A concentration ≥ 0 along a river, central differences, cell Péclet number 10; Roos, Stynes, Tobiska (2008)."""
    M = sp.diags_array(
        [np.full(n - 1, -6.0), np.full(n, 2.0), np.full(n - 1, 4.0)], offsets=[-1, 0, 1]
    )
    rng = np.random.default_rng(14)
    return Application(sp.csr_array(M), rng.choice([-1.0, 1.0], n) * rng.uniform(0.5, 1.0, n))


@application(small=dict(n=120), full=dict(n=800))
def fractional_diffusion(n: int) -> Application:
    """An obstacle under the fractional Laplacian of order 1.5, dense; centred differences of Çelik, Duman (2012)."""
    order, k = 1.5, np.arange(n)
    ratio = 1.0 - (order + 1.0) / (0.5 * order + k[1:])
    g = gamma(order + 1.0) / gamma(0.5 * order + 1.0) ** 2 * np.cumprod(np.append(1.0, ratio))
    M = g[abs(k[:, None] - k)] * (0.5 * (n + 1)) ** order
    x = np.linspace(-1.0, 1.0, n + 2)[1:-1]
    return Application(M, np.full(n, 1.0), lower=0.5 - 4.0 * (x - 0.2) ** 2)


@application(small=dict(n=600), full=dict(n=10_000))
def graph_laplacian(n: int) -> Application:
    """A cluster around a seed by ℓ₁-regularised PageRank; Fountoulakis et al., *Variational perspective* (2019)."""
    rng = np.random.default_rng(15)
    a, b = rng.integers(n, size=4 * n), rng.integers(n, size=4 * n)
    b = np.where(rng.random(4 * n) < 0.98, (a + rng.integers(1, 20, size=4 * n)) % n, b)
    A = sp.coo_array((np.ones(4 * n), (a, b)), shape=(n, n)).tocsr()
    A = sp.csr_array(A + A.T)
    A.setdiag(0.0)
    A.eliminate_zeros()
    degree, alpha, rho = np.maximum(A.sum(axis=1), 1.0), 0.05, 1e-4
    half = sp.diags_array(1.0 / np.sqrt(degree))
    M = (1 + alpha) / 2 * sp.eye_array(n) - (1 - alpha) / 2 * half @ A @ half
    seed = np.zeros(n)
    seed[0] = 1.0
    return Application(
        sp.csr_array(M), rho * alpha * np.sqrt(degree) - alpha * seed / np.sqrt(degree)
    )


@application(small=dict(n=300), full=dict(n=10_000))
def circuit(n: int) -> Application:
    """Node voltages clamped to ground by ideal diodes, conductances 10⁻⁴ to 10² S; van Bokhoven (1981)."""
    rng = np.random.default_rng(16)
    a, b = rng.integers(n, size=2 * n), rng.integers(n, size=2 * n)
    b = np.where(rng.random(2 * n) < 0.95, (a + rng.integers(1, 9, size=2 * n)) % n, b)
    a, b = a[a != b], b[a != b]
    g, leak = 10.0 ** rng.uniform(-4, 2, a.size), 10.0 ** rng.uniform(-4, -1, n)
    B = sp.coo_array(
        (
            np.concatenate([np.ones(a.size), -np.ones(a.size)]),
            (np.tile(np.arange(a.size), 2), np.concatenate([a, b])),
        ),
        shape=(a.size, n),
    ).tocsr()
    G = B.T @ sp.diags_array(g) @ B + sp.diags_array(leak)
    return Application(sp.csr_array(G), -1e-3 * rng.normal(size=n))


@application(small=dict(stages=40), full=dict(stages=2000))
def rectifier(stages: int) -> Application:
    """A ladder of rectifier bridges, node voltages free, diode currents ≥ 0; Acary, Bonnefon, Brogliato (2011)."""
    rng = np.random.default_rng(17)
    n = 4 * stages  # each stage: two nodes of alternating current, plus, minus
    k = 4 * np.arange(stages)
    pairs = [(k, k + 2), (k + 1, k + 2), (k + 3, k), (k + 3, k + 1)]  # anode, cathode
    anode, cathode = (np.concatenate(end) for end in zip(*pairs, strict=True))
    count, diode = anode.size, np.arange(anode.size)
    A = sp.coo_array(
        (
            np.concatenate([np.ones(count), -np.ones(count)]),
            (np.concatenate([anode, cathode]), np.tile(diode, 2)),
        ),
        shape=(n, count),
    ).tocsr()
    own = np.diag([1e-2, 1e-2, 1e-4, 1e-4])
    own[2:, 2:] += [[1e-3, -1e-3], [-1e-3, 1e-3]]  # what it feeds
    G = sp.kron(line(stages, 1.0), sp.diags_array([0.0, 0.0, 0.02, 0.02])) + sp.kron(
        sp.eye_array(stages), own
    )
    current = np.zeros(n)
    current[k] = rng.normal(size=stages)
    current[k + 1] = -current[k]
    M = sp.block_array([[G, A], [-A.T, None]], format="csr")
    return Application(
        sp.csr_array(M),
        np.concatenate([-current, np.full(count, 0.6)]),
        lower=np.concatenate([np.full(n, -np.inf), np.zeros(count)]),
        determined=lambda z: (z[:n],),
    )


@application(
    small=[dict(example=1, side=30), dict(example=2, side=30)],
    full=[dict(example=1, side=300), dict(example=2, side=300)],
)
def paper(example: int, side: int) -> Application:
    """Both examples of Kumar, Deepmala, Das, *More on projected type iteration method*, δ = 4; z* = (1, 2, 1, 2, …)."""
    west, east = ((-1.0, -1.0), (-1.5, -0.5))[example - 1]
    T = sp.diags_array(
        [west * np.ones(side - 1), np.full(side, 4.0), east * np.ones(side - 1)], offsets=[-1, 0, 1]
    )
    S = sp.diags_array(
        [west * np.ones(side - 1), east * np.ones(side - 1)], offsets=[-1, 1], shape=(side, side)
    )
    eye = sp.eye_array(side)
    M = sp.csr_array(sp.kron(eye, T) + sp.kron(S, eye) + 4.0 * sp.eye_array(side**2))
    z: Any = np.tile([1.0, 2.0], side**2 // 2 + 1)[: side**2]
    return Application(M, -(M @ z), answer=z)
