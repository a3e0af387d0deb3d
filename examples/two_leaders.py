"""Two regions tax one firm each: several leaders with the same followers (an EPEC), by replies in turn.

A region aims at an output of 1 and a low tax. No region has a convex program, because the firms react to both taxes:
so each round solves the market for the present taxes, then each region's problem (MPEC) with the tax of the other as a
parameter. The replies end when no region can gain more than 1e-7. The gain is bounded by the present loss minus the
proved lower bound of the region's problem, so the end of the loop is the definition of an equilibrium.

The loop cannot promise that an equilibrium exists, that the replies converge (they may cycle: move only a part of the
way), or that only one equilibrium exists. Here the equilibrium by hand is 24/13.
"""

from pathlib import Path
from typing import Any

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import optimal

REGIONS, ROUNDS, LARGEST_GAIN = 2, 50, 1e-7


def followers(tax: list[Any]) -> tuple[cp.Variable, list[Any]]:
    """Return the outputs of the firms, and each firm's best decision as a constraint."""
    x = cp.Variable(REGIONS, nonneg=True)
    profit = [cp.multiply(9 - cp.sum(x) - tax[i], x[i]) for i in range(REGIONS)]
    return x, [optimal(cp.Problem(cp.Maximize(profit[i])), over=[x[i]]) for i in range(REGIONS)]


def loss(i: int, tax: list[Any], x: cp.Variable) -> cp.Expression:
    """Return the objective of a region."""
    return cp.square(x[i] - 1) + cp.square(tax[i]) / 2


def main(out: Path = Path()) -> None:
    """Let the regions reply in turn, save a figure into the folder OUT."""
    now = [cp.Parameter(value=0.0) for _ in range(REGIONS)]
    x, firms = followers(now)
    present, leaders = cp.Problem(cp.Minimize(0), firms), []
    for i in range(REGIONS):
        own = cp.Variable(bounds=[0, 9])
        tax = [own if k == i else now[k] for k in range(REGIONS)]
        y, others = followers(tax)
        leaders.append((own, cp.Problem(cp.Minimize(loss(i, tax, y)), others)))
    taxes, gains = [], []
    for _ in range(ROUNDS):
        present.solve(method="LCP", tolerance=1e-12)
        taxes.append([one.value for one in now])
        gains.append(0.0)
        for i, (_, leader) in enumerate(leaders):
            leader.solve(method="LCP", prove=True, tolerance=1e-9)
            best = leader.solver_stats.extra_stats
            assert best.bound_by == "proof"
            gains[-1] = max(gains[-1], float(loss(i, now, x).value) - best.lower_bound)
        if gains[-1] <= LARGEST_GAIN:
            break
        for (own, _), parameter in zip(leaders, now, strict=True):
            parameter.value = own.value
    print(f"{len(taxes)} rounds, taxes {np.round(taxes[-1], 4)}, outputs {x.value.round(4)}")
    print(
        f"check: the taxes differ from the taxes by hand by {abs(np.array(taxes[-1]) - 24 / 13).max():.1e}"
    )
    print(f"check: no region gains more than {gains[-1]:.1e}, as proved")

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    left.axhline(24 / 13, color="#999999", linestyle="--", label="by hand")
    left.plot(np.array(taxes)[:, 0], "o-", color="#0072B2", label="tax of each region")
    left.set(xlabel="round", ylabel="tax", title="replies in turn")
    left.legend()
    right.semilogy(np.maximum(gains, 1e-12), "o-", color="#D55E00")
    right.axhline(LARGEST_GAIN, color="#999999", linestyle="--")
    right.set(xlabel="round", ylabel="largest gain", title="proved bound of a region's gain")
    figure.savefig(out / "two_leaders.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
