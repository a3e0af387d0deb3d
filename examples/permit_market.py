"""A cap on emissions: two Cournot firms, a competitive fringe and a permit price, for all caps.

Firms with coal (cost 1 EUR/MWh, 0.9 t/MWh) and gas (2 EUR/MWh, 0.4 t/MWh) know that their output x changes the price
p = 12 − x₁ − x₂ − s. The fringe takes p as given; its output s costs 4 s + s²/2 and emits 0.5 t/MWh. All pay the permit
price τ, which is positive only if the emissions reach the cap: 0 ≤ τ ⟂ cap − emissions ≥ 0.

`trace` computes all results for caps from 1 to 6 t, `derivative` their slopes. The check: with affine demand the
equilibrium is the maximum of one concave function (a potential), whose cap has the dual value τ; Clarabel computes it.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import complements, derivative, optimal, trace

COST, EMITS = np.array([1.0, 2.0, 4.0]), np.array([0.9, 0.4, 0.5])  # coal, gas, fringe


def reference(cap: float) -> np.ndarray:
    """Return price and permit price by the potential program, solved by Clarabel."""
    y = cp.Variable(3, nonneg=True)
    limit = EMITS @ y <= cap
    surplus = 12 * cp.sum(y) - cp.square(cp.sum(y)) / 2 - cp.sum_squares(y) / 2 - COST @ y
    accuracy = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-12)
    cp.Problem(cp.Maximize(surplus), [limit]).solve(solver="CLARABEL", **accuracy)
    return np.array([12 - y.value.sum(), limit.dual_value])


def main(out: Path = Path()) -> None:
    """Trace the market over the cap, compare with Clarabel, and save a figure into the folder OUT."""
    cap = cp.Parameter(value=3.0, name="cap")
    x, s = cp.Variable(2, nonneg=True, name="firms"), cp.Variable(nonneg=True, name="fringe")
    price, permit = cp.Variable(name="price"), cp.Variable(name="permit price")
    demand = 12 - cp.sum(x) - s
    firms = [
        optimal(
            cp.Problem(cp.Maximize(cp.multiply(demand - COST[i] - EMITS[i] * permit, x[i]))), [x[i]]
        )
        for i in range(2)
    ]
    profit = (price - COST[2] - EMITS[2] * permit) * s - cp.square(s) / 2
    fringe = optimal(cp.Problem(cp.Maximize(profit)), over=[s])
    limit = complements(permit >= 0, cap - EMITS[:2] @ x - EMITS[2] * s >= 0)
    model = cp.Problem(cp.Minimize(0), [*firms, fringe, price == demand, limit])

    path = trace(model, cap, 1.0, 6.0)
    print(path.explain())
    caps = np.linspace(1.2, 5.8, 24)
    ours = np.array([[path.value(one, cap) for one in (price, permit)] for cap in caps])
    theirs = np.array([reference(cap) for cap in caps])
    print(f"check: prices differ from Clarabel's by {abs(ours - theirs).max():.0e} EUR at most")
    model.solve(method="LCP")
    slope, step = derivative(model).jvp({cap: 1.0}), 0.01
    by_hand = (reference(3.0 + step) - reference(3.0 - step)) / (2 * step)
    off = abs(np.array([slope[price], slope[permit]]) - by_hand).max()
    print(f"check: their slopes at 3 t differ from differences of Clarabel by {off:.0e} EUR/t")

    with plt.style.context(Path(__file__).with_name("plots.mplstyle")):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
        at = path.breakpoints
        for variable, name in ((price, "price (EUR/MWh)"), (permit, "permit (EUR/t)")):
            left.plot(at, [path.value(variable, cap) for cap in at], label=name)
        left.plot(caps, theirs, "o", color="0.3", markersize=3, markerfacecolor="white")
        left.plot([], [], "o", color="0.3", markersize=3, markerfacecolor="white", label="Clarabel")
        left.set(xlabel="cap (t)", ylabel="prices", xlim=(1, 6), ylim=(0, None))
        made = np.array([[*path.value(x, cap), path.value(s, cap)] for cap in at])
        for own, name in zip(made.T, ("coal", "gas", "fringe"), strict=True):
            right.plot(at, own, label=name)
        right.set(xlabel="cap (t)", ylabel="output (MWh)", xlim=(1, 6), ylim=(0, None))
        left.legend()
        right.legend()
        figure.savefig(out / "permit_market.png", dpi=150)
        plt.close(figure)


if __name__ == "__main__":
    typer.run(main)
