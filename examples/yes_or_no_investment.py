"""A yes or no beside a market: which of four plants to build, when all firms answer as price takers.

A planner builds plants b ∈ {0, 1}⁴ with fixed costs; each then offers up to its capacity wherever the price exceeds
its cost, and demand is 20 − p. Welfare is concave, the firms' conditions are pairs, the b are integers:

    0 ≤ s ⟂ c + r − p ≥ 0,    0 ≤ r ⟂ capacity · b − s ≥ 0,    Σ s = 20 − p.

All sixteen choices are solved as well, one by one. Needs SCIP: pip install '.[global]'.
"""

from itertools import product
from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import complements

COST, CAPACITY, FIXED = map(
    np.array, ([2.0, 4.0, 3.0, 6.0], [5.0, 8.0, 4.0, 9.0], [20.0, 45.0, 12.0, 30.0])
)


def market(built: cp.Expression | np.ndarray, *rows: cp.Constraint) -> tuple[float, cp.Variable]:
    """Return welfare, and the sales of the plants."""
    sold, rent = cp.Variable(4), cp.Variable(4, bounds=[0, 20])
    price = 20 - cp.sum(sold)
    pairs = [
        complements(sold >= 0, COST + rent - price >= 0),
        complements(rent >= 0, cp.multiply(CAPACITY, built) - sold >= 0),
    ]
    total = cp.sum(sold)
    welfare = 20 * total - cp.square(total) / 2 - COST @ sold - FIXED @ built
    value = cp.Problem(cp.Maximize(welfare), [*pairs, *rows]).solve(method="LCP")
    return float(value), sold


def main(out: Path = Path()) -> None:
    """Choose the plants, compare with all sixteen choices, and save a figure into the folder OUT."""
    built = cp.Variable(4, boolean=True)
    welfare, sold = market(built)
    every = {
        choice: market(np.array(choice, dtype=float))[0] for choice in product((0, 1), repeat=4)
    }
    best = max(every, key=every.__getitem__)
    print(
        f"build {built.value.round().astype(int).tolist()}, sell {sold.value.round(3).tolist()}: {welfare:.4f}"
    )
    print(
        f"check: welfare differs from the best of all sixteen by {abs(welfare - every[best]):.1e}"
    )

    with plt.style.context(Path(__file__).with_name("plots.mplstyle")):
        figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
        ordered = sorted(every.items(), key=lambda one: one[1])
        colors = ["C1" if choice == best else "C0" for choice, _ in ordered]
        axes.barh(
            ["".join(map(str, choice)) for choice, _ in ordered],
            [value for _, value in ordered],
            color=colors,
        )
        axes.set(xlabel="welfare", ylabel="plants that are built")
        figure.savefig(out / "yes_or_no_investment.png", dpi=150)
        plt.close(figure)


if __name__ == "__main__":
    typer.run(main)
