"""Price × quantity: a monopolist over a competitive fringe, whose income is not convex.

The monopolist sells x at cost 1 a unit, many small firms sell y at rising cost 2 + y, and all get p = 10 − x − y:

    max (p − 1) x    where    0 ≤ y ⟂ 2 + y − p ≥ 0.

By hand: for x ≤ 8 the fringe sells y = (8 − x)/2, so that p = (12 − x)/2, and (10 − x) x/2 is largest at x = 5.
Needs SCIP: pip install '.[global]'.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import complements


def main(out: Path = Path()) -> None:
    """Find the best output, compare with the formula, and save a figure into the folder OUT."""
    x, y, price = cp.Variable(bounds=[0, 10]), cp.Variable(), cp.Variable()
    fringe = complements(y >= 0, 2 + y - price >= 0)
    problem = cp.Problem(cp.Maximize(cp.multiply(price, x) - x), [fringe, price == 10 - x - y])
    income = problem.solve(method="LCP")
    print(problem.solver_stats.extra_stats.explain())
    print(
        f"the monopolist sells {x.value:.3f} at {price.value:.3f}, the fringe {y.value:.3f}: income {income:.4f}"
    )
    print(f"check: the income differs from the formula's 12.5 by {abs(income - 12.5):.1e}")

    outputs = np.linspace(0, 10, 201)
    sold = np.maximum((8 - outputs) / 2, 0)
    with plt.style.context(Path(__file__).with_name("plots.mplstyle")):
        figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
        axes.plot(outputs, (9 - outputs - sold) * outputs, label="income where the fringe answers")
        axes.plot([float(x.value)], [income], "o", label="found")
        axes.set(xlabel="the monopolist's output x", ylabel="income (p − 1) x")
        axes.legend()
        figure.savefig(out / "monopolist_over_fringe.png", dpi=150)
        plt.close(figure)


if __name__ == "__main__":
    typer.run(main)
