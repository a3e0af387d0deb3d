"""Seconds of large nonlinear problems from near and far starts: ``python tests/campaigns/nonlinear_at_scale.py``.

Traffic on a grid of 100 nodes and 10 destinations, a Bratu problem in space under a ceiling, and a market of 7200
routes. Printed: seconds, status, Newton steps, max |x − mid(lower, upper, x − F(x))|, work.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import scipy.sparse as sp

from lcp_plugin import NonlinearProblem
from lcp_plugin.problems.nonlinear.solving import solve_nonlinear


def traffic(side=10, destinations=10):
    """Return link flows and node potentials of a user equilibrium, a commodity each destination."""
    random, nodes = np.random.default_rng(0), side * side
    place = np.arange(nodes).reshape(side, side)
    pairs = [(place[:, :-1], place[:, 1:]), (place[:-1], place[1:])]
    links = np.concatenate([np.c_[a.ravel(), b.ravel()] for x, y in pairs for a, b in ((x, y), (y, x))])
    count = len(links)
    free, capacity = random.uniform(1, 5, count), random.uniform(50, 150, count)
    ends = (np.r_[links[:, 0], links[:, 1]], np.tile(np.arange(count), 2))
    out = sp.csr_array((np.repeat([1.0, -1.0], count), ends), shape=(nodes, count))
    blocks, demands = [], []
    for end in random.choice(nodes, destinations, replace=False):
        kept = np.arange(nodes) != end
        blocks.append(out[kept])
        demands.append((random.uniform(0, 4, nodes) * (random.random(nodes) < 0.5))[kept])
    conserve, demand = sp.csr_array(sp.block_diag(blocks)), np.concatenate(demands)
    total = sp.csr_array(sp.hstack([sp.eye_array(count)] * destinations))
    flows = count * destinations

    def F(x):
        times = free * (1.0 + 0.15 * (total @ x[:flows] / capacity) ** 4)
        return np.r_[total.T @ times - conserve.T @ x[flows:], conserve @ x[:flows] - demand]

    def jacobian(x):
        slope = free * 0.6 * (total @ x[:flows] / capacity) ** 3 / capacity
        return sp.csr_array(sp.block_array([[total.T @ sp.diags_array(slope) @ total, -conserve.T], [conserve, None]]))

    n = flows + demand.size
    return NonlinearProblem(F, jacobian, np.zeros(n)), {"0": np.zeros(n), "1": np.ones(n), "10": np.full(n, 10.0)}


def bratu(side, factor, ceiling):
    """Return −Δu = factor eᵘ on a cube under a ceiling."""
    line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
    eye, n = sp.eye_array(side), side**3
    laplace = sp.kron(sp.kron(line, eye), eye) + sp.kron(sp.kron(eye, line), eye) + sp.kron(sp.kron(eye, eye), line)
    laplace, upper = sp.csr_array(laplace * (side + 1.0) ** 2), np.full(n, ceiling)
    problem = NonlinearProblem(
        lambda u: laplace @ u - factor * np.exp(u),
        lambda u: sp.csr_array(laplace - sp.diags_array(factor * np.exp(u))), -np.inf, upper,
    )
    return problem, {"0": np.zeros(n), "the ceiling": upper + 5.0}


def market(supplies=60, demands=120):
    """Return the shipments of a spatial price equilibrium, supply prices quadratic."""
    random = np.random.default_rng(0)
    base, slope = random.uniform(5, 20, supplies), random.uniform(0.1, 1, supplies)
    most, fall = random.uniform(30, 80, demands), random.uniform(0.1, 1, demands)
    cost = random.uniform(1, 15, supplies * demands)
    sent = sp.csr_array(sp.kron(sp.eye_array(supplies), np.ones((1, demands))))
    converged = sp.csr_array(sp.kron(np.ones((1, supplies)), sp.eye_array(demands)))

    def F(x):
        s = sent @ x
        return sent.T @ (base + slope * s + 0.01 * s**2) + cost - converged.T @ (most - fall * (converged @ x))

    def jacobian(x):
        by_supply = sp.diags_array(slope + 0.02 * (sent @ x))
        return sp.csr_array(sent.T @ by_supply @ sent + converged.T @ sp.diags_array(fall) @ converged)

    n = supplies * demands
    return NonlinearProblem(F, jacobian, np.zeros(n)), {"0": np.zeros(n), "1": np.ones(n)}


SCENES = {
    "traffic": traffic, "bratu 20³, 5, 2": lambda: bratu(20, 5.0, 2.0), "bratu 20³, 5, 3": lambda: bratu(20, 5.0, 3.0),
    "bratu 20³, 1, 5": lambda: bratu(20, 1.0, 5.0), "market": market,
}


def main(wanted, limit=60.0):
    """Print a line for each start of the scenes whose names begin so."""
    for name, scene in SCENES.items():
        for where, start in (scene()[1] if name.startswith(wanted) else {}).items():
            problem = scene()[0]
            began = time.perf_counter()
            result = solve_nonlinear(problem, start, max_seconds=limit)
            seconds = time.perf_counter() - began
            natural = np.abs(result.z - np.clip(result.z - result.w, problem.lower, problem.upper)).max()
            print(f"{name} from {where}: {seconds:.1f} s {result.status.name} {result.iterations} steps {natural:.1e} "
                  f"work {result.work:.0f}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
