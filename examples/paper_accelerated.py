"""The paper's methods, plain and with momentum, next to psor and multigrid: error against time.

Three problems: a membrane over an obstacle, an American put, and a random M-matrix. The clock stops while the residual
is measured, and excludes compilation. The check at the end is a linear solve: where z > 0, Mz + q = 0.

Source: O'Donoghue, Candès, Adaptive restart for accelerated gradient schemes, Found. Comput. Math. 15, 2015,
doi:10.1007/s10208-013-9150-3.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer
from scipy.sparse.linalg import spsolve

from lcp_plugin import LCP, gallery, solve

SIZE, UNKNOWNS, MOST = 60, 1000, 10_000
METHODS = {
    "npgs": ("npgs", {"momentum": None}),
    "npsor": ("npsor", {"momentum": None}),
    "npgs, momentum": ("npgs", {}),
    "npsor, momentum": ("npsor", {}),
    "psor": ("psor", {}),
    "multigrid": ("multigrid", {}),
}


def random_m_matrix() -> LCP:
    """Return a problem with five negative entries in a row, and the diagonal a thousandth larger than their sum."""
    rng = np.random.default_rng(0)
    others = sp.random_array((UNKNOWNS, UNKNOWNS), density=5 / UNKNOWNS, rng=rng)
    others.setdiag(0.0)
    M = sp.diags_array(1.001 * others.sum(axis=1) + 1e-3) - others
    return LCP(M, rng.normal(size=UNKNOWNS))


def american_put() -> LCP:
    """Return the last of a hundred steps in time of an option with strike 1, one year before its maturity."""
    size, step, rate, volatility = 1001, 0.01, 0.05, 0.2
    x = np.linspace(-1.5, 1.5, size + 2)  # log(price / strike)
    h, payoff = x[1] - x[0], np.maximum(1.0 - np.exp(x), 0.0)
    diffusion, drift = 0.5 * (volatility / h) ** 2, 0.5 * (rate - 0.5 * volatility**2) / h
    below, above = step * (drift - diffusion), -step * (drift + diffusion)
    diagonals = [below, 1.0 + step * rate - below - above, above]
    M = sp.diags_array(diagonals, offsets=[-1, 0, 1], shape=(size, size))
    q = -payoff[1:-1]
    q[0] += below * payoff[0]
    return LCP(M, q, lower=payoff[1:-1])


def main(out: Path = Path()) -> None:
    """Run the methods, print their iterations, and save the curves into the folder OUT."""
    problems = {
        "obstacle": gallery.build("obstacle_2d", size=SIZE, shifted=True).problem,
        "American put": american_put(),
        "random M-matrix": random_m_matrix(),
    }
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, every = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained", sharey=True)
    apart = 0.0
    for axes, (title, problem) in zip(every, problems.items(), strict=True):
        for label, (name, options) in METHODS.items():
            for _ in range(2):  # the first run may compile
                found = solve(problem, name, record=True, max_iterations=MOST, **options)
            print(f"{title:<17}{label:<16}{found.iterations:>6} iterations, {found.seconds:.2g} s")
            points = [(at.seconds, at.residual) for at in found.history]
            axes.loglog(*zip(*points, strict=True), label=label)
            if label == "npsor, momentum":
                free = np.flatnonzero(found.z > problem.lower)
                at_bound = np.where(found.z > problem.lower, 0.0, problem.lower)
                right = -problem.slack(at_bound)[free]
                exact = spsolve(problem.csr[free][:, free].tocsc(), right)
                apart = max(apart, abs(found.z[free] - exact).max() / abs(exact).max())
        axes.set(title=title, xlabel="seconds")
    every[0].set(ylabel="relative residual")
    every[0].legend(fontsize="small")
    figure.savefig(out / "paper_accelerated.png", dpi=110)
    print(f"check: linear solves with the same free unknowns differ by {apart:.1e} from npsor")


if __name__ == "__main__":
    typer.run(main)
