"""Markets, roads and games."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP, QuadraticProgram

from . import Application, application
from .references import semidefinite


@application(small=dict(supplies=6, demands=8), full=dict(supplies=20, demands=25))
def spatial_prices(supplies: int, demands: int) -> Application:
    """What each of some mines ships to each town, linear prices, totals determined; Takayama, Judge (1971)."""
    rng = np.random.default_rng(34)
    b, d = rng.uniform(0.5, 2.0, supplies), rng.uniform(0.5, 2.0, demands)
    a, c = rng.uniform(1.0, 5.0, supplies), rng.uniform(15.0, 30.0, demands)
    cost = 10.0 * np.hypot(
        *(rng.random((supplies, 1)) - rng.random((1, demands)) for _ in range(2))
    )
    M = np.kron(np.diag(b), np.ones((demands, demands))) + np.kron(
        np.ones((supplies, supplies)), np.diag(d)
    )
    q = (a[:, None] + cost - c).ravel()
    return Application(
        sp.csr_array(M),
        q,
        answer=semidefinite,
        determined=lambda z: (
            z.reshape(supplies, demands).sum(1),
            z.reshape(supplies, demands).sum(0),
        ),
    )


@application(small=dict(side=4, pairs=6), full=dict(side=8, pairs=40))
def traffic(side: int, pairs: int) -> Application:
    """Drivers on paths through a grid of streets, times linear in flow, street flows determined; Wardrop (1952)."""
    rng = np.random.default_rng(35)
    paths, owner = [], []
    for pair in range(pairs):
        (i, k), (j, m) = (np.sort(rng.choice(side, 2, replace=False)) for _ in range(2))
        steps = [0] * (k - i) + [1] * (m - j)
        for chosen in {tuple(rng.permutation(steps)) for _ in range(6)}:
            at, streets = [i, j], []
            for axis in chosen:
                streets.append(2 * (at[0] * side + at[1]) + axis)
                at[axis] += 1
            paths.append(streets)
            owner.append(pair)
    path = np.repeat(np.arange(len(paths)), [len(p) for p in paths])
    uses = sp.coo_array(
        (np.ones(path.size), (np.concatenate(paths), path)), shape=(2 * side**2, len(paths))
    ).tocsr()
    joins = sp.coo_array(
        (np.ones(len(paths)), (owner, np.arange(len(paths)))), shape=(pairs, len(paths))
    ).tocsr()
    slope, free = rng.uniform(0.1, 2.0, 2 * side**2), rng.uniform(1.0, 3.0, 2 * side**2)
    demand = rng.uniform(1.0, 5.0, pairs)
    M = sp.csr_array(
        sp.block_array([[uses.T @ sp.diags_array(slope) @ uses, -joins.T], [joins, None]])
    )
    size = len(paths)
    return Application(
        M,
        np.concatenate([uses.T @ free, -demand]),
        answer=semidefinite,
        determined=lambda z: (uses @ z[:size], z[size:]),
    )


@application(small=dict(firms=5, markets=8), full=dict(firms=15, markets=20))
def nash_cournot(firms: int, markets: int) -> Application:
    """Firms that sell to markets within capacities, each knowing the others' sales; Harker (1984)."""
    rng = np.random.default_rng(36)
    slope, height = rng.uniform(0.5, 2.0, markets), rng.uniform(20.0, 40.0, markets)
    cost = rng.uniform(2.0, 15.0, (firms, markets))
    sales = np.kron(np.eye(firms) + np.ones((firms, firms)), np.diag(slope))
    own = np.kron(np.eye(firms), np.ones((1, markets)))
    M = np.block([[sales, own.T], [-own, np.zeros((firms, firms))]])
    return Application(M, np.concatenate([(cost - height).ravel(), rng.uniform(5.0, 40.0, firms)]))


@application(small=dict(rows=15), full=[dict(rows=60), dict(rows=150)])
def bimatrix(rows: int) -> Application:
    """A game of two players with random payoffs; Lemke, Howson (1964). The error is what a player could gain alone."""
    rng = np.random.default_rng(37)
    A, B = rng.random((rows, rows)), rng.random((rows, rows))
    problem = LCP.from_game(A, B)

    def regret(z: Any) -> float:
        x, y = z[:rows], z[rows:]
        if not min(x.sum(), y.sum()) > 0.0:
            return np.inf
        x, y = x / x.sum(), y / y.sum()
        return float(max((A @ y).max() - x @ A @ y, (x @ B).max() - x @ B @ y))

    return Application(problem.M, problem.q, error=regret)


@application(small=dict(assets=60), full=dict(assets=400))
def portfolio(assets: int) -> Application:
    """Weights ≥ 0 that sum to 1, risk of ten factors against return; Markowitz (1952)."""
    rng = np.random.default_rng(38)
    F = rng.normal(size=(assets, 10)) * 0.1
    risk = F @ F.T + np.diag(rng.uniform(0.005, 0.05, assets))
    gain, one = rng.uniform(0.0, 0.05, assets), np.ones((assets, 1))
    M = np.block([[risk, -one], [one.T, np.zeros((1, 1))]])
    lower = np.append(np.zeros(assets), -np.inf)
    return Application(
        M,
        np.append(-gain, -1.0),
        lower=lower,
        determined=lambda z: (z[:-1], z[-1:]),
        program=QuadraticProgram(risk, -gain, A=one.T, b=[1.0], lower=0.0),
    )
