"""Five firms share a market, until one of them becomes too expensive.

Firm i makes q_i at the cost c_i q + β_i/(1 + β_i) L_i^(−1/β_i) q^((1 + β_i)/β_i), and the price p(Q) = (5000/Q)^(1/1.1)
falls with the total output. Each chooses the q_i ≥ 0 that is best for itself as the others produce now. Nobody
wants to change, a Cournot–Nash equilibrium:

    q_i maximizes q_i p(Q) − cost_i(q_i) for the outputs of the others.

Then the first cost of one firm rises until it closes: a complementarity changes sides. Each answer is checked as the
definition says: no firm, moved alone by a search of one dimension, earns more.

Source: Murphy, Sherali, Soyster, A mathematical programming approach for determining oligopolistic market equilibrium,
Math. Prog. 24, 1982, doi:10.1007/BF01585096, with its answer for five firms.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer
from scipy.optimize import minimize_scalar

from lcp_plugin import optimal

COST, SCALE = np.array([10.0, 8.0, 6.0, 4.0, 2.0]), 5.0
BETA, ELASTICITY = np.array([1.2, 1.1, 1.0, 0.9, 0.8]), 1.1
PUBLISHED = np.array([36.9325, 41.8181, 43.7066, 42.6592, 39.1790])
RISES = np.linspace(0.0, 40.0, 41)


def earned_alone(output: np.ndarray, cost: np.ndarray) -> float:
    """Return the most that any firm could earn besides by changing its own output only."""
    most = 0.0
    for i, beta in enumerate(BETA):
        others = output.sum() - output[i]

        def loss(q: float, i: int = i, beta: float = beta, others: float = others) -> float:
            made = cost[i] * q + beta / (1 + beta) * SCALE ** (-1 / beta) * q ** ((1 + beta) / beta)
            return made - q * (5000 / (others + q)) ** (1 / ELASTICITY)

        most = max(
            most, loss(output[i]) - minimize_scalar(loss, bounds=(0.0, 200.0), method="bounded").fun
        )
    return most


def main(out: Path = Path()) -> None:
    """Find the published equilibrium, follow it while a cost rises, and save a figure into the folder OUT."""
    made, cost = cp.Variable(5, nonneg=True), cp.Parameter(5, value=COST)
    price = 5000 ** (1 / ELASTICITY) * cp.sum(made) ** (-1 / ELASTICITY)
    power = 1 + 1 / BETA
    scale = SCALE ** (-1 / BETA) / power
    firms = [
        cp.Maximize(cp.multiply(price - cost[i], q) - scale[i] * q ** power[i])
        for i, q in enumerate(made)
    ]
    # The income is not concave by cvxpy's rules; each answer is checked below.
    best = [
        optimal(cp.Problem(one), [q], check="local") for one, q in zip(firms, made, strict=True)
    ]
    market = cp.Problem(cp.Minimize(0), best)

    made.value = np.full(5, 10.0)
    outputs = []
    for rise in RISES:
        cost.value = COST + rise * np.eye(5)[4]
        market.solve(method="LCP", tolerance=1e-12)
        outputs.append(made.value)
    print(repr(market.solver_stats.extra_stats))
    closed = next(rise for rise, output in zip(RISES, outputs, strict=True) if output[4] == 0.0)
    print(f"the fifth firm closes when its cost has risen by {closed:g}")
    regret = max(
        earned_alone(output, COST + rise * np.eye(5)[4])
        for rise, output in zip(RISES, outputs, strict=True)
    )
    print(
        f"check: the published outputs differ by {abs(outputs[0] - PUBLISHED).max():.1e}, "
        f"and alone no firm could earn more than {regret:.1e} besides"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    for i, color in enumerate(("#D55E00", "#0072B2", "#009E73", "#B07D00", "#6A4C93")):
        curve = np.array(outputs)[:, i]
        axes.plot(RISES, curve, color=color, linewidth=1.8)
        lift = {0: -9, 1: 1, 2: 12, 3: -9}.get(i, 0)  # four lines end close together
        axes.annotate(
            f" firm {i + 1}",
            (RISES[-1], curve[-1]),
            (0, lift),
            color=color,
            va="center",
            textcoords="offset points",
        )
    axes.axvline(closed, color="#bbbbbb", linewidth=0.8)
    axes.annotate(" firm 5 closes", (closed, 6), color="#555555")
    axes.set(
        title="Output of each firm while the cost of the fifth rises",
        xlabel="rise of the cost of firm 5",
        ylabel="output",
        xlim=(0, 46),
        ylim=(0, None),
    )
    figure.savefig(out / "cournot_oligopoly.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
