"""A march in time on a two-dimensional grid: an American put in the model of Heston."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP
from lcp_plugin.core.checks import Vector


class Steps(NamedTuple):
    """What ``march(problem, forcing, propagator, z0=z0)`` takes."""

    problem: LCP
    forcing: Vector
    propagator: sp.csr_array
    z0: Vector


# Clarke and Parrott 1999, doi:10.1080/135048699334528; the values are those that later papers agree upon.
HESTON = {
    "strike": 10.0,
    "rate": 0.1,
    "reversion": 5.0,
    "mean": 0.16,
    "of_variance": 0.9,
    "correlation": 0.1,
}
HESTON_YEARS = 0.25
HESTON_SPOTS, HESTON_VARIANCE = (8.0, 9.0, 10.0, 11.0, 12.0), 0.0625
HESTON_VALUES = (2.0000, 1.107641, 0.520030, 0.213668, 0.082036)


def heston(
    prices: int = 400, variances: int = 150, steps: int = 20
) -> tuple[Steps, Vector, Vector]:
    """Return an American put under stochastic variance, and its prices and variances, the fastest index that of price.

    Upwind where central differences would give a positive neighbor; the cross derivative by nine points. Dirichlet at
    the least and the largest price, Neumann at the largest variance, the equation itself at variance 0.
    """
    strike, rate, kappa, mean, sigma, rho = HESTON.values()
    top, largest, dt = 2.0 * strike, 1.0, HESTON_YEARS / steps
    ds, dv = top / (prices + 1), largest / (variances - 1)
    s, v = ds * np.arange(1, prices + 1), dv * np.arange(variances)
    S, V = np.meshgrid(s, v)
    boundary = np.zeros((variances, prices))
    rows, columns, values = [], [], []
    index = np.arange(prices * variances).reshape(variances, prices)

    def add(where: Vector, j: int, i: int, value: Vector) -> None:
        """Add entries that couple rows to the neighbor j variances and i prices away."""
        jj, ii = np.nonzero(where)
        j_to, i_to = jj + j, ii + i
        j_to = np.where(j_to >= variances, variances - 1, j_to)  # Neumann
        found = value[jj, ii]
        left = i_to < 0
        np.add.at(boundary, (jj[left], ii[left]), found[left] * strike)
        inside = (i_to >= 0) & (i_to < prices)
        rows.append(index[jj[inside], ii[inside]])
        columns.append(index[j_to[inside], i_to[inside]])
        values.append(found[inside])

    everywhere = np.ones_like(S, dtype=bool)
    cross = -0.25 * rho * sigma * V * S / (ds * dv)
    cross[0] = 0.0
    for j, i, sign in ((1, 1, 1.0), (-1, -1, 1.0), (1, -1, -1.0), (-1, 1, -1.0)):
        add((V > 0.0) & everywhere, j, i, sign * cross)
    centre = np.full_like(S, rate)
    for diffusion, drift, h, (j, i) in (
        (0.5 * V * S**2, rate * S, ds, (0, 1)),
        (0.5 * sigma**2 * V, kappa * (mean - V), dv, (1, 0)),
    ):
        below, above = -diffusion / h**2 + 0.5 * drift / h, -diffusion / h**2 - 0.5 * drift / h
        is_central = (below <= 0.0) & (above <= 0.0)
        below = np.where(is_central, below, -diffusion / h**2 + np.minimum(drift, 0.0) / h)
        above = np.where(is_central, above, -diffusion / h**2 - np.maximum(drift, 0.0) / h)
        centre -= below + above
        add(below != 0.0, -j, -i, below)
        add(above != 0.0, j, i, above)
    add(everywhere, 0, 0, centre)
    n = prices * variances
    A = sp.csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
    )
    M = sp.csr_array(sp.eye_array(n) + dt * A)
    payoff = np.maximum(strike - S, 0.0).ravel()
    forcing = np.broadcast_to(dt * boundary.ravel(), (steps, n))
    return (
        Steps(LCP(M, np.zeros(n), lower=payoff), forcing, sp.csr_array(-sp.eye_array(n)), payoff),
        s,
        v,
    )
