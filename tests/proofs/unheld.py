"""Structures that nothing holds, by their stiffness, and what loads them: blocks, chains, graphs, trusses."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from applications.mechanics import assembled, square_stiffness, squares

from lcp_plugin import LCP, QuadraticProgram


class Structure(NamedTuple):
    """min ½xᵀKx + qᵀx, x ≥ lower, and its complementarity problem; −q is the load."""

    K: Any
    q: Any
    lower: Any

    @property
    def problem(self) -> LCP:
        """The complementarity problem."""
        return LCP(self.K, self.q, lower=self.lower)

    @property
    def program(self) -> QuadraticProgram:
        """The program."""
        return QuadraticProgram(self.K, self.q, lower=self.lower)


def block(nx: int, ny: int, right: float, up: float, spring: float = 0.0) -> Structure:
    """A steel plate in plane stress over a curved floor, held by it alone; loaded at its top edge, in newtons."""
    node, freedom = squares(nx, ny)
    K = assembled(square_stiffness(210e9, 0.3), freedom)
    K = K + sp.diags_array(np.tile([spring * 210e9, 0.0], node.size))
    q, lower = np.zeros(2 * node.size), np.full(2 * node.size, -np.inf)
    share = 5e7 / nx * np.where(np.isin(np.arange(nx + 1), [0, nx]), 0.5, 1.0)
    q[2 * node[:, -1]], q[2 * node[:, -1] + 1] = -right * share, -up * share
    lower[2 * node[:, 0] + 1] = -1e-3 * np.linspace(-0.5, 0.5, nx + 1) ** 2
    return Structure(sp.csr_array(0.5 * (K + K.T)), q, lower)


def chain(n: int, pull: float, ground: float = 0.0) -> Structure:
    """Masses in a row with springs of stiffness 1 between them, every seventh over a floor; its end is pulled up."""
    d = np.full(n, 2.0)
    d[0], d[-1] = 1.0 + ground, 1.0
    K = sp.diags_array([np.full(n - 1, -1.0), d, np.full(n - 1, -1.0)], offsets=[-1, 0, 1])
    lower = np.full(n, -np.inf)
    lower[::7] = 0.0
    return Structure(sp.csr_array(K), np.append(np.zeros(n - 1), -pull), lower)


def circuit(n: int, current: float, seed: int = 0) -> Structure:
    """A network of random conductances without ground, potentials ≥ 0; the currents that are fed in have this sum."""
    rng = np.random.default_rng(seed)
    ends = np.concatenate(
        [np.stack([np.arange(n - 1), np.arange(1, n)]), rng.integers(0, n, (2, n))], axis=1
    )
    i, j = ends[:, ends[0] != ends[1]]
    W = sp.coo_array((np.exp(rng.normal(size=i.size)), (i, j)), shape=(n, n)).tocsr()
    W = W + W.T
    q = rng.normal(size=n)
    return Structure(
        sp.csr_array(sp.diags_array(W @ np.ones(n)) - W), q - q.mean() - current / n, np.zeros(n)
    )


def truss(bays: int, up: float, *, braced: bool) -> Structure:
    """A pinned frame of square bays over a floor at its left end, which is hinged; without diagonals it folds up."""
    at = np.array([(x, y) for x in range(bays + 1) for y in (0, 1)])
    bars = [(2 * x, 2 * x + 1) for x in range(bays + 1)]
    bars += [(2 * x + y, 2 * x + 2 + y) for x in range(bays) for y in (0, 1)]
    bars += [(2 * x, 2 * x + 3) for x in range(bays) if braced]
    K = sp.lil_array((at.size, at.size))
    for i, j in bars:
        e = (at[j] - at[i]) / np.linalg.norm(at[j] - at[i])
        of = [2 * i, 2 * i + 1, 2 * j, 2 * j + 1]
        K[np.ix_(of, of)] += 1e6 * np.outer(np.append(e, -e), np.append(e, -e))
    free = np.arange(4, at.size)  # the two joints on the left are on hinges
    q = np.zeros(at.size)
    q[-1] = -up
    return Structure(sp.csr_array(K)[free][:, free], q[free], np.full(free.size, -np.inf))
