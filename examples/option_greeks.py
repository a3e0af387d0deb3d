"""The Greeks of an American put: how its value changes with spot, volatility and rate, up to the exercise boundary.

As in american_put.py, the value V ≥ g = max(K − S, 0) takes steps in the time to maturity τ, each an LCP. With
x = log(S/K) the operator is A = σ² D + r R, so that dA/dσ = 2σ D and dA/dr = R, and a step of length Δτ reads

    M V_new + q ≥ 0,   V_new ≥ g,   complementary;   M = I + ½Δτ A,   q = −(I − ½Δτ A) V_old.

The derivative of a step is one linear solve on the prices where waiting is right, and feeds that of the next step:

    dV_new = jvp(dM = ½Δτ dA,  dq = −(I − ½Δτ A) dV_old + ½Δτ dA V_old).

Delta is the derivative by a shift of the payoff along x, which comes in through the bound. Steps grow with τ, the first
four are implicit (1 instead of ½). The check: differences of a binomial tree, extrapolated in its levels, today and
15 % above the exercise boundary, at which vega and rho vanish.

Sources: Forsyth, Vetzal, SIAM J. Sci. Comput. 23, 2002, doi:10.1137/S1064827500382324 (steps in time); Leisen, Reimer,
Applied Mathematical Finance 3, 1996, doi:10.1080/13504869600000015 (tree).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, derivative, solve
from lcp_plugin.evidence.drawing import STYLE

STRIKE, RATE, VOLATILITY, MATURITY = 100.0, 0.05, 0.3, 1.0  # EUR, 1/year, 1/√year, years
SIZE, STEPS, KEPT, LEVELS = 5999, 1000, 10, (1001, 4001, 4001)  # every tenth step is kept; trees for each Greek


def march(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times to maturity, the exercise boundary at each, and from the second on delta, vega, rho; (.., 3, n)."""
    n, h, identity = x.size, x[1] - x[0], sp.eye_array(x.size)
    slope = sp.diags_array([-1.0, 1.0], offsets=[-1, 1], shape=(n, n)) / (2 * h)
    curvature = sp.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(n, n)) / h**2
    D, R = 0.5 * (slope - curvature), identity - slope
    A = VOLATILITY**2 * D + RATE * R
    spot = STRIKE * np.exp(x)  # the ends need no more: the first price is exercised, at the last the put is worthless
    payoff, shift = np.maximum(STRIKE - spot, 0.0), -spot * np.heaviside(-np.rint(x / h), 0.5)
    changes = ((0 * A, shift), (2 * VOLATILITY * D, 0 * shift), (R, 0 * shift))  # of A and of the bound
    years, value, tangents = MATURITY * np.linspace(0, 1, STEPS + 1) ** 2, payoff, [dg for _, dg in changes]
    boundary, kept = [STRIKE], []
    for k, step in enumerate(np.diff(years)):
        new = step if k < 4 else step / 2
        old = step - new
        at = derivative(solve(LCP(identity + new * A, old * (A @ value) - value, lower=payoff), z0=value))
        tangents = [at.jvp(dM=new * dA, dq=old * (A @ dV + dA @ value) - dV, dlower=dg)
                    for (dA, dg), dV in zip(changes, tangents, strict=True)]
        value = at.z
        boundary.append(spot[at.free.argmax()])
        if (k + 1) % KEPT == 0:
            kept.append([tangents[0] / spot, *tangents[1:]])
    return years[::KEPT], np.array(boundary[::KEPT]), np.array(kept)


def tree(spot: np.ndarray, rate: float, volatility: float, years: np.ndarray, levels: int) -> np.ndarray:
    """Return American puts by a tree with an odd number of levels, shape (points,)."""
    def probability(d: np.ndarray) -> np.ndarray:
        scaled = d**2 * (levels + 1 / 6) / (levels + 1 / 3 + 0.1 / (levels + 1)) ** 2
        return 0.5 + np.copysign(0.5, d) * np.sqrt(1 - np.exp(-scaled))

    spread, growth, ups = volatility * np.sqrt(years), np.exp(rate * years / levels), np.arange(levels + 1)
    d2 = (np.log(spot / STRIKE) + rate * years) / spread - spread / 2
    p, share = probability(d2), probability(d2 + spread)
    up, down = growth * share / p, growth * (1 - share) / (1 - p)
    price = spot[:, None] * np.exp(ups * np.log(up)[:, None] + (levels - ups) * np.log(down)[:, None])
    falls, rises, back = np.array([(1 - p) / growth, p / growth, 1 / down])[..., None]
    value = np.maximum(STRIKE - price, 0.0)
    for _ in range(levels):
        price = price[:, :-1] * back
        value = np.maximum(falls * value[:, :-1] + rises * value[:, 1:], STRIKE - price)
    return value[:, 0]


def tree_greeks(spot: np.ndarray, years: np.ndarray) -> np.ndarray:
    """Return delta, vega and rho by fourth-order differences of the extrapolated tree, shape (3, points)."""
    found = np.zeros((3, spot.size))
    for greek, ((ds, dv, dr), levels) in enumerate(zip(np.diag([1.0, 0.012, 0.007]), LEVELS, strict=True)):
        for k, weight in ((-2, 1), (-1, -8), (1, 8), (2, -1)):
            data = spot + k * ds, RATE + k * dr, VOLATILITY + k * dv, years
            found[greek] += weight / 12 / (ds + dv + dr) * (2 * tree(*data, 2 * levels + 1) - tree(*data, levels))
    return found


def main(out: Path = Path()) -> None:
    """Compute the Greeks at all times, compare with a binomial tree, save a picture into the folder OUT."""
    x = np.linspace(-1.5, 1.5, SIZE + 2)[1:-1]
    spot, (years, boundary, kept) = STRIKE * np.exp(x), march(x)
    at = np.array([100, 100, 100, 80, 60])  # three prices today, the last of them along the boundary
    prices = np.array([100.0, 120.0, *1.15 * boundary[at[2:]]])
    ours = np.array([[np.interp(price, spot, one) for one in kept[k - 1]] for price, k in zip(prices, at, strict=True)])
    theirs = tree_greeks(prices, years[at]).T
    for price, left, mine, other in zip(prices, years[at], ours, theirs, strict=True):
        print(f"spot {price:6.2f}, {left:.2f} years left: delta, vega, rho {mine.round(4)}   tree {other.round(4)}")
    off = abs(ours / theirs - 1).max(axis=0)
    print("check: delta differs from the tree's by {:.1e}, vega by {:.1e}, rho by {:.1e}, relatively".format(*off))
    plt.style.use(STYLE)
    figure, panels = plt.subplots(2, 3, figsize=(11, 6.2), layout="constrained", height_ratios=[1.35, 1])
    shown, today = slice(*np.searchsorted(spot, (60, 150)), 5), MATURITY - years
    names = ("delta", "vega (EUR per 1.00 of σ)", "rho (EUR per 1.00 of r)")
    for greek, (name, (above, below)) in enumerate(zip(names, panels.T, strict=True)):
        field, colours = kept[:, greek, shown].T, ("cividis", "viridis", "viridis_r")[greek]
        figure.colorbar(above.pcolormesh(today[1:], spot[shown], field, cmap=colours, shading="gouraud"), ax=above)
        above.fill_between(today, boundary, 60, color="white", linewidth=0)
        above.plot(today, boundary, color="#D55E00", linewidth=2)
        above.plot(today[at], prices, "o", color="#D55E00", markersize=4, markerfacecolor="white", clip_on=False)
        above.set(xlim=(0, MATURITY), ylim=(60, 150), title=name, xlabel="time (years)", ylabel="S (EUR)")
        below.plot(spot[shown], field[:, -1], color="#0072B2", linewidth=1.8, label="derivative of the LCPs")
        below.plot(prices[:3], theirs[:3, greek], "o", color="#D55E00", markerfacecolor="white", label="tree")
        below.set(xlim=(60, 150), xlabel="spot price S (EUR)", title=f"{name.split()[0]} today")
        above.text(0.3, 63, "exercise", color="#D55E00")
    panels[1, 0].legend(loc="lower right")
    figure.savefig(out / "option_greeks.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
