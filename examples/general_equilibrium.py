"""Prices of an economy: three families of firms, five consumers, six goods, without a planner.

An activity s turns goods into others, a_cs of good c (inputs negative), and runs at a level y_s only where it makes no
loss. A consumer h owns e_ch, earns i_h = Σ_c p_c e_ch and spends it on goods by a utility of constant elasticity σ_h:

    y_s ≥ 0   with  −Σ_c a_cs p_c ≥ 0                                       (no activity makes a profit)
    p_c ≥ 0   with  Σ_s a_cs y_s + Σ_h e_ch − Σ_h d_ch(p, i_h) ≥ 0          (what is left over costs nothing)
    d_ch = α_ch i_h p_c^−σ_h / Σ_k α_kh p_k^(1−σ_h).

Only relative prices matter: the income of the first consumer is the unit of money. Nonlinear in p and i, and stated in
cvxpy as it stands here. A convex solver checks each consumer: at these prices, no consumer can buy a better basket.

Sources: Scarf, Hansen, The Computation of Economic Equilibria, Yale 1973; as a complementarity problem: Mathiesen,
Computation of economic equilibria by a sequence of linear complementarity problems, Math. Prog. Study 23, 1985.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import complements

GOODS = (
    "capital, later",
    "food, clothes",
    "durables",
    "capital, now",
    "skilled work",
    "unskilled work",
)
ACTIVITIES = (
    "durables 1",
    "durables 2",
    "food 1",
    "food 2",
    "food 3",
    "keeping",
    "building 1",
    "building 2",
)
OWNED = np.array(
    [
        [0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0],
        [1, 2, 1.5, 1, 2],
        [3, 0.1, 2, 1, 6],
        [5, 0.1, 6, 0.1, 0.1],
        [0.1, 7, 0.1, 8, 0.5],
    ]
)
WANTED = np.array(
    [
        [4, 0.4, 2, 5, 3],
        [2, 4, 2, 5, 4],
        [3.2, 1, 1.5, 4.5, 2],
        [0, 0, 0, 0, 0],
        [0.2, 0, 0.5, 0, 0],
        [0, 0.6, 0, 0.2, 0.2],
    ]
)
ELASTICITY = np.array([1.2, 1.6, 0.8, 0.5, 0.6])
TECHNIQUE = np.array(
    [
        [4, 4, 1.6, 1.6, 1.6, 0.9, 7, 8],
        [0, 0, 6, 8, 7, 0, 0, 0],
        [4, 3.5, 0, 0, 0, 0, 0, 0],
        [-5.3, -5, -2, -2, -2, -1, -4, -5],
        [-2, -1, -2, -4, -1, 0, -3, -2],
        [-1, -6, -3, -1, -8, 0, -1, -8],
    ]
)


def main(out: Path = Path()) -> None:
    """Find prices that clear all markets, check every consumer, and save a figure into the folder OUT."""
    goods, activities = TECHNIQUE.shape
    share = WANTED / WANTED.sum(axis=0)
    prices, levels = cp.Variable(goods), cp.Variable(activities)
    incomes = cp.Variable(ELASTICITY.size - 1)
    prices.value, levels.value, incomes.value = (
        np.ones(goods),
        np.ones(activities),
        OWNED.sum(axis=0)[1:],
    )

    money = OWNED.sum(axis=0)[0]  # the unit: what the first consumer has
    earned = cp.hstack([money, incomes])
    bought = 0
    for h, elasticity in enumerate(ELASTICITY):
        index = share[:, h] @ prices ** (1 - elasticity)
        bought += earned[h] / index * cp.multiply(share[:, h], prices**-elasticity)
    market = complements(prices >= 0, TECHNIQUE @ levels + OWNED.sum(axis=1) - bought >= 0)
    economy = cp.Problem(
        cp.Minimize(0),
        [
            market,
            complements(levels >= 0, -TECHNIQUE.T @ prices >= 0),
            incomes == OWNED[:, 1:].T @ prices,
        ],
    )
    economy.solve(method="LCP")
    print(economy.solver_stats.extra_stats)

    p, y, income = prices.value, levels.value, np.append(money, incomes.value)
    baskets = [basket(p, income[h], share[:, h], ELASTICITY[h]) for h in range(income.size)]
    left = TECHNIQUE @ y + OWNED.sum(axis=1) - np.sum(baskets, axis=0)
    print(
        "the budget of the first consumer, which the model does not state, holds "
        f"up to {abs(OWNED[:, 0] @ p - money):.1e}"
    )
    most = abs(left).max()
    print(
        f"check: with the baskets of a convex solver, markets differ from cleared ones by {most:.1e} units"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left_axes, right_axes) = plt.subplots(1, 2, figsize=(9.6, 3.8), layout="constrained")
    left_axes.barh(GOODS, p, color="#0072B2")
    left_axes.set(
        title="Prices that clear every market", xlabel="price (the first consumer's income is 9.1)"
    )
    profit = TECHNIQUE.T @ p
    colors = np.where(y > 1e-9, "#D55E00", "#bbbbbb")
    right_axes.barh(ACTIVITIES, y, color=colors)
    for k, loss in enumerate(-profit):
        words = f"  {y[k]:.3g}" if y[k] > 1e-9 else f"  idle: would lose {loss:.2f} a unit"
        right_axes.annotate(words, (y[k], k), va="center", fontsize=8, color="#333333")
    right_axes.set(title="Who produces", xlabel="level of the activity", xlim=(0, 1.35 * y.max()))
    for axes in (left_axes, right_axes):
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
    figure.savefig(out / "general_equilibrium.png", dpi=150)


def basket(p: np.ndarray, income: float, share: np.ndarray, elasticity: float) -> np.ndarray:
    """Return the purchases of a consumer, by maximizing the utility; goods without utility are not bought."""
    wanted, power = share > 0, 1 - 1 / elasticity
    x = cp.Variable(int(wanted.sum()))
    utility = np.sign(power) * share[wanted] ** (1 / elasticity) @ cp.power(x, power)
    cp.Problem(cp.Maximize(utility), [p[wanted] @ x <= income]).solve(solver="CLARABEL")
    bought = np.zeros(p.size)
    bought[wanted] = x.value
    return bought


if __name__ == "__main__":
    typer.run(main)
