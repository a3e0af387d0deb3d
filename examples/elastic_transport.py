"""Dantzig's two canneries and three markets, when buyers answer to prices.

Plant i holds a_i cases of goods and sells at the price w_i; shipping a case to market j costs c_ij; market j buys
b_j (p̄_j/p_j)^ε_j cases at the price p_j. If goods flow, no trader profits, and goods that remain cost nothing:

    x_ij ≥ 0  with  w_i + c_ij − p_j ≥ 0,      w_i ≥ 0  with  a_i − Σ_j x_ij ≥ 0,
    p_j ≥ 0   with  Σ_i x_ij − b_j (p̄_j/p_j)^ε_j ≥ 0.

p̄ are the prices at which the fixed demands b are met by both plants; then buyers begin to choose, and the plant in San
Diego loses its capacity bit by bit. A convex solver gives the same sales: they maximize what buyers gain less what
shipping costs.

Sources: Dantzig, Linear Programming and Extensions, Princeton 1963, ch. 3.3; the elastic model and its figures are
those of the GAMS library's TRANSMCP.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.ticker import PercentFormatter

from lcp_plugin import complements

MARKETS = "New York", "Chicago", "Topeka"
CAPACITY, DEMAND = np.array([350.0, 600.0]), np.array([325.0, 300.0, 275.0])  # cases
# thousand miles, from Seattle and San Diego
DISTANCE = np.array([[2.5, 1.7, 1.8], [2.5, 1.8, 1.4]])
ELASTICITY = np.array([1.5, 1.2, 2.0])
FREIGHT = 0.09  # thousand dollars a case and thousand miles
LEFT = np.linspace(1.0, 0.0, 51)  # share of San Diego's capacity


def main(out: Path = Path()) -> None:
    """Follow the equilibrium while a plant closes, compare with the greatest surplus, save a figure into OUT."""
    flow, at_plant, at_market = cp.Variable((2, 3)), cp.Variable(2), cp.Variable(3)
    capacity = cp.Parameter(2, value=CAPACITY)
    profit = (
        cp.reshape(at_plant, (2, 1), order="C")
        + FREIGHT * DISTANCE
        - cp.reshape(at_market, (1, 3), order="C")
    )
    plants = [
        complements(flow >= 0, profit >= 0),
        complements(at_plant >= 0, capacity - cp.sum(flow, axis=1) >= 0),
    ]

    fixed = cp.Problem(
        cp.Minimize(0), [*plants, complements(at_market >= 0, cp.sum(flow, axis=0) - DEMAND >= 0)]
    )
    fixed.solve(method="LCP")
    usual = at_market.value

    demand = cp.multiply(
        DEMAND * usual**ELASTICITY,
        cp.hstack([at_market[j] ** -e for j, e in enumerate(ELASTICITY)]),
    )
    elastic = cp.Problem(
        cp.Minimize(0), [*plants, complements(at_market >= 0, cp.sum(flow, axis=0) - demand >= 0)]
    )
    sold, prices = [], []
    for share in LEFT:
        capacity.value = CAPACITY * [1.0, share]
        elastic.solve(method="LCP", tolerance=1e-12)
        sold.append(flow.value.sum(axis=0))
        prices.append(at_market.value)
    print(elastic.solver_stats.extra_stats)

    x, bought = cp.Variable((2, 3), nonneg=True), cp.Variable(3)
    gain = sum(
        usual[j] * DEMAND[j] ** (1 / e) / (1 - 1 / e) * cp.power(bought[j], 1 - 1 / e)
        for j, e in enumerate(ELASTICITY)
    )
    surplus = cp.Maximize(gain - FREIGHT * cp.sum(cp.multiply(DISTANCE, x)))
    convex = cp.Problem(surplus, [bought == cp.sum(x, axis=0), cp.sum(x, axis=1) <= capacity])
    convex.solve(solver="CLARABEL", tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    differs = abs(bought.value - sold[-1]).max()
    print(
        f"check: without San Diego, sales differ from those of the greatest surplus by {differs:.1e} cases"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.7), layout="constrained")
    for axes, curves, title in (
        (left, sold, "Cases sold"),
        (right, prices, "Price (thousand dollars a case)"),
    ):
        for curve, name, color in zip(
            np.transpose(curves), MARKETS, ("#0072B2", "#D55E00", "#009E73"), strict=True
        ):
            axes.plot(1 - LEFT, curve, color=color, linewidth=1.8, label=name)
        axes.set(
            title=title, xlabel="lost share of San Diego's capacity", xlim=(0, 1), ylim=(0, None)
        )
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    left.legend()
    figure.savefig(out / "elastic_transport.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
