"""American options by one implicit step from the payoff, and the best time to stop."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from . import Application, application

RATE, VOLATILITY, STRIKE = 0.05, 0.3, 100.0


def differences(x: Any) -> tuple[Any, Any]:
    """First and second derivative at the inner nodes of x, three points each, shape (n − 2, n)."""
    left, right = np.diff(x)[:-1], np.diff(x)[1:]
    n, span = x.size - 2, left + right
    first = [-right / (left * span), (right - left) / (left * right), left / (right * span)]
    second = [2.0 / (left * span), -2.0 / (left * right), 2.0 / (right * span)]
    return tuple(
        sp.csr_array(sp.diags_array(three, offsets=[0, 1, 2], shape=(n, n + 2)))
        for three in (first, second)
    )


def step(A: Any, payoff: Any, inner: Any, dt: float) -> Application:
    """(I + Δt A) u ≥ payoff, u ≥ payoff, complementary; u is the payoff on the boundary."""
    A = sp.csr_array(A)
    outer = np.setdiff1d(np.arange(payoff.size), inner)
    M = sp.csr_array(sp.eye_array(inner.size) + dt * A[:, inner])
    return Application(M, -payoff[inner] + dt * (A[:, outer] @ payoff[outer]), lower=payoff[inner])


def put(s: Any, dt: float = 0.1) -> Application:
    D, DD = differences(s)
    x, n = s[1:-1], s.size
    inside = sp.csr_array(sp.eye_array(n))[1:-1]
    A = (
        -0.5 * sp.diags_array((VOLATILITY * x) ** 2) @ DD
        - RATE * sp.diags_array(x) @ D
        + RATE * inside
    )
    return step(A, np.maximum(STRIKE - s, 0.0), np.arange(1, n - 1), dt)


@application(small=dict(n=400), full=dict(n=10_000))
def put_uniform(n: int) -> Application:
    """An American put on uniform prices; Brennan, Schwartz (1977)."""
    return put(np.linspace(0.0, 4.0 * STRIKE, n + 2))


@application(small=dict(n=400), full=dict(n=10_000))
def put_geometric(n: int) -> Application:
    """The same on prices that grow by a constant factor, .1 to 10 000; Tavella, Randall (2000)."""
    return put(np.geomspace(1e-3 * STRIKE, 100.0 * STRIKE, n + 2))


@application(small=dict(n=400), full=dict(n=10_000))
def put_logarithmic(n: int) -> Application:
    """The same in x = log S, constant coefficients; Jaillet, Lamberton, Lapeyre (1990)."""
    x = np.linspace(-3.0, 3.0, n + 2)
    D, DD = differences(x)
    A = (
        -0.5 * VOLATILITY**2 * DD
        - (RATE - 0.5 * VOLATILITY**2) * D
        + RATE * sp.csr_array(sp.eye_array(n + 2))[1:-1]
    )
    return step(A, STRIKE * np.maximum(1.0 - np.exp(x), 0.0), np.arange(1, n + 1), 0.1)


@application(small=dict(side=24), full=dict(side=120))
def two_assets(side: int) -> Application:
    """A put on the lesser of two assets of correlation .6, logarithms, cross derivative; Villeneuve, Zanette (2002)."""
    x = np.linspace(-1.5, 1.5, side + 2)
    D, DD = differences(x)
    inside = sp.csr_array(sp.eye_array(side + 2))[1:-1]
    a, b, drift = 0.3, 0.2, RATE
    A = (
        -0.5 * a * a * sp.kron(DD, inside)
        - 0.5 * b * b * sp.kron(inside, DD)
        - 0.6 * a * b * sp.kron(D, D)
    )
    A = A - (drift - 0.5 * a * a) * sp.kron(D, inside) - (drift - 0.5 * b * b) * sp.kron(inside, D)
    A = A + RATE * sp.kron(inside, inside)
    X, Y = np.meshgrid(x, x, indexing="ij")
    payoff = STRIKE * np.maximum(1.0 - np.minimum(np.exp(X), np.exp(Y)), 0.0).ravel()
    inner = np.arange((side + 2) ** 2).reshape(side + 2, side + 2)[1:-1, 1:-1].ravel()
    return step(A, payoff, inner, 0.1)


STEPS = (0.25, 0.02, 0.001)


@application(
    small=[
        dict(m=m, k=k, dt=dt)
        for (m, k), dt in zip([(20, 10), (40, 16), (60, 20)], STEPS, strict=True)
    ],
    full=[dict(m=m, k=k, dt=dt) for m, k in ((100, 40), (200, 80), (400, 150)) for dt in STEPS],
)
def heston(m: int, k: int, dt: float) -> Application:
    """Heston's put, m prices by k variances, four-point cross derivative, hybrid upwind; Ikonen, Toivanen (2009)."""
    strike, rate, sigma, kappa, theta, rho = 10.0, 0.1, 0.9, 5.0, 0.16, 0.1
    s, v = np.linspace(0.0, 20.0, m + 1), np.linspace(0.0, 1.0, k + 1)
    Ds, DDs = _closed(s)
    Dv, DDv = _closed(v)
    S, V, I, J = sp.diags_array(s), sp.diags_array(v), sp.eye_array(m + 1), sp.eye_array(k + 1)
    pull = kappa * (theta - v)
    # Upwind where the drift prevails, which is so much more diffusion, at v = 0 for one.
    along_s = np.maximum(0.5 * np.outer(s**2, v), 0.5 * rate * s[1] * s[:, None]).ravel()
    along_v = sp.diags_array(np.maximum(0.5 * sigma**2 * v, 0.5 * abs(pull) * v[1]))
    A = (
        -sp.diags_array(along_s) @ sp.kron(DDs, J)
        - sp.kron(I, along_v @ DDv)
        - rho * sigma * sp.kron(S @ Ds, V @ Dv)
    )
    A = A - rate * sp.kron(S @ Ds, J) - sp.kron(I, sp.diags_array(pull) @ Dv) + rate * sp.kron(I, J)
    # at s = 0 the price is the strike
    inner = np.arange((m + 1) * (k + 1)).reshape(m + 1, k + 1)[1:].ravel()
    payoff = np.repeat(np.maximum(strike - s, 0.0), k + 1)
    return step(sp.csr_array(A)[inner], payoff, inner, dt)


def _closed(x: Any) -> tuple[Any, Any]:
    """Both derivatives at all nodes, the first 0 at both ends (Neumann)."""
    h, n = x[1] - x[0], x.size
    D = sp.diags_array([-np.ones(n - 1), np.ones(n - 1)], offsets=[-1, 1], shape=(n, n)).tolil() / (
        2.0 * h
    )
    DD = (
        sp.diags_array(
            [np.ones(n - 1), -2.0 * np.ones(n), np.ones(n - 1)], offsets=[-1, 0, 1]
        ).tolil()
        / h**2
    )
    D, DD = D.tolil(), DD.tolil()
    D[0, :2], D[-1, -2:] = 0.0, 0.0
    DD[0, 1], DD[-1, -2] = 2.0 / h**2, 2.0 / h**2
    return sp.csr_array(D), sp.csr_array(DD)


@application(small=dict(n=150), full=dict(n=800))
def merton(n: int) -> Application:
    """Merton's jumps: an integral over all log prices makes M dense; Cont, Voltchkova (2005)."""
    x = np.linspace(-2.0, 2.0, n + 2)
    D, DD = differences(x)
    rate, mean, spread = 0.8, -0.2, 0.3
    drop = np.exp(mean + 0.5 * spread**2) - 1.0
    density = np.exp(-0.5 * ((x - x[1:-1, None] - mean) / spread) ** 2) / (
        spread * np.sqrt(2.0 * np.pi)
    )
    inside = sp.csr_array(sp.eye_array(n + 2))[1:-1]
    A = (
        -0.5 * VOLATILITY**2 * DD
        - (RATE - 0.5 * VOLATILITY**2 - rate * drop) * D
        + (RATE + rate) * inside
    )
    A = A - sp.csr_array(rate * (x[1] - x[0]) * density)
    dense = step(A, STRIKE * np.maximum(1.0 - np.exp(x), 0.0), np.arange(1, n + 1), 0.1)
    return Application(dense.M.toarray(), dense.q, lower=dense.lower)


@application(small=dict(n=500), full=dict(n=20_000))
def optimal_stopping(n: int) -> Application:
    """When to sell: a Markov chain with discount .99, value ≥ reward; Cottle, Pang, Stone (1992), §1.2."""
    rng = np.random.default_rng(33)
    i = np.repeat(np.arange(n), 4)
    j = np.clip(i + rng.integers(-6, 7, size=4 * n), 0, n - 1)
    P = sp.coo_array((rng.random(4 * n) + 0.05, (i, j)), shape=(n, n)).tocsr()
    P = sp.diags_array(1.0 / P.sum(axis=1)) @ P
    reward = 1.0 + np.cos(np.arange(n) * 40.0 / n) + 0.2 * rng.random(n)
    return Application(sp.csr_array(sp.eye_array(n) - 0.99 * P), np.zeros(n), lower=reward)


@application(small=dict(n=120), full=dict(n=2000))
def queue(n: int) -> Application:
    """When to close a queue whose rates of arrival and service span 10⁻² to 10²; Puterman (1994), ch. 11."""
    rng = np.random.default_rng(34)
    up, down = 10.0 ** rng.uniform(-2, 2, n - 1), 10.0 ** rng.uniform(-2, 2, n - 1)
    leave = np.append(up, 0.0) + np.append(0.0, down)
    M = sp.diags_array([-down, leave + 0.05, -up], offsets=[-1, 0, 1])
    return Application(
        sp.csr_array(M), 1.0 - 0.1 * rng.uniform(0.0, 40.0, n), lower=-rng.uniform(0.0, 5.0, n)
    )
