"""A carbon price set by a leader, when firms in two places answer, joined by a line with a capacity.

A plant in place 1 burns coal at the marginal cost 2 + s/2 (EUR/MWh, for s MWh) and emits 0.9 t per MWh; a plant in
place 2 burns gas at 5 + s/2 and emits 0.4 t. Demand is 12 − p MWh in both places at the price p; a trader carries up
to 2 MWh if prices differ. The leader sets the carbon price τ, so that welfare minus a damage of 3 EUR per t is largest.

The same is found by a fine grid of carbon prices, the market solved at each.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import complements

COST, EMITS, DAMAGE, LIMIT = np.array([2.0, 5.0]), np.array([0.9, 0.4]), 3.0, 2.0


def market(tax: cp.Expression | float) -> tuple[cp.Expression, list[cp.Constraint], cp.Variable]:
    """Return welfare less damage, the answer of firms and trader to a carbon price, and what is made."""
    made, carried, rent = cp.Variable(2), cp.Variable(2), cp.Variable(2)
    flow = carried[0] - carried[1]
    eaten = made + cp.hstack([-flow, flow])
    price = 12 - eaten
    rise = price[1] - price[0]
    answers = [
        complements(made >= 0, COST + 0.5 * made + tax * EMITS - price >= 0),
        complements(carried >= 0, rent - cp.hstack([rise, -rise]) >= 0),
        complements(rent >= 0, LIMIT - carried >= 0),
    ]
    welfare = (
        12 * cp.sum(eaten) - cp.sum_squares(eaten) / 2 - COST @ made - cp.sum_squares(made) / 4
    )
    return welfare - DAMAGE * (EMITS @ made), answers, made


def main(out: Path = Path()) -> None:
    """Find the carbon price, compare with a grid, and save a figure into the folder OUT."""
    tax = cp.Variable(bounds=[0, 12])
    welfare, answers, made = market(tax)
    problem = cp.Problem(cp.Maximize(welfare), answers)
    best = problem.solve(method="LCP", prove=True)
    print(problem.solver_stats.extra_stats.explain())
    print(
        f"carbon price {float(tax.value):.3f}, made {made.value.round(3).tolist()}, welfare {best:.4f}"
    )
    grid, values = np.linspace(0, 6, 25), []
    for one in grid:
        own, pairs, _ = market(float(one))
        values.append(float(cp.Problem(cp.Maximize(own), pairs).solve(method="LCP")))
    print(f"check: no price of the grid is better by more than {max(max(values) - best, 0.0):.1e}")

    with plt.style.context(Path(__file__).with_name("plots.mplstyle")):
        figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
        axes.plot(grid, values, ".-", label="market solved at each price")
        axes.plot([float(tax.value)], [best], "o", label="found")
        axes.set(xlabel="carbon price (EUR/t)", ylabel="welfare less damage (EUR)")
        axes.legend()
        figure.savefig(out / "carbon_price.png", dpi=150)
        plt.close(figure)


if __name__ == "__main__":
    typer.run(main)
