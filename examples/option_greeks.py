"""The Greeks of an American put: how its value changes with spot, volatility and rate, up to the exercise boundary.

As in american_put.py, the value V ≥ g = max(K − S, 0) takes steps in the time to maturity τ, each an LCP. With
x = log(S/K) the operator is A = σ² D + r R, so that dA/dσ = 2σ D and dA/dr = R, and a Crank–Nicolson step reads

    M V_new + C V_old ≥ 0,   V_new ≥ g,   complementary;   M = I + ½Δτ A,   C = ½Δτ A − I.

The first four steps are implicit and half as long, with the same M and C = −I: they damp oscillations from the
kink of g (Rannacher). `march` takes the steps, ten marches in a row with longer and longer ones. `derivative`
differentiates all steps, forwards by one datum, or backwards one price by all data.

Delta is the derivative by a shift of the payoff along x, which comes in through the bound and the first V. The checks:
differences of a binomial tree, extrapolated in its levels, today and 15 % above the exercise boundary, at which vega
and rho vanish; and backwards as forwards.

Sources: Forsyth, Vetzal, SIAM J. Sci. Comput. 23, 2002, doi:10.1137/S1064827500382324 (steps in time); Rannacher,
Numer. Math. 43, 1984, doi:10.1007/BF01390130 (damping); Leisen, Reimer, Applied Mathematical Finance 3, 1996,
doi:10.1080/13504869600000015 (tree).
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, derivative, march

STRIKE, RATE, VOLATILITY, MATURITY = 100.0, 0.05, 0.3, 1.0  # EUR, 1/year, 1/√year, years
# unknowns, marches, steps of each; every twelfth is drawn
SIZE, MARCHES, STEPS, KEPT = (5999, 10, 120, 12)
LEVELS = 1001, 4001, 4001  # of the trees for each Greek

Leg = tuple[Any, float, float]  # of one march: its derivative, the shares of A in M and in C


def operator(x: np.ndarray) -> tuple[sp.sparray, np.ndarray, list[tuple[sp.sparray, np.ndarray]]]:
    """Return A and g, and how these two change with the shift of the payoff, the volatility and the rate."""
    n, h, identity = x.size, x[1] - x[0], sp.eye_array(x.size)
    slope = sp.diags_array([-1.0, 1.0], offsets=[-1, 1], shape=(n, n)) / (2 * h)
    curvature = sp.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(n, n)) / h**2
    D, R = 0.5 * (slope - curvature), identity - slope
    # the ends need no more: the first price is exercised, at the last the put is worthless
    spot = STRIKE * np.exp(x)
    payoff, shift = np.maximum(STRIKE - spot, 0.0), -spot * np.heaviside(-np.rint(x / h), 0.5)
    return (
        VOLATILITY**2 * D + RATE * R,
        payoff,
        [(0 * D, shift), (2 * VOLATILITY * D, 0 * x), (R, 0 * x)],
    )


def legs(A: sp.sparray, payoff: np.ndarray) -> list[Leg]:
    """Return the derivatives of all marches, one after the other; the k-th ends at τ = (k/MARCHES)² years."""
    identity, value, done = sp.eye_array(payoff.size), payoff, []
    for k in range(MARCHES):
        half = MATURITY * (2 * k + 1) / MARCHES**2 / STEPS / 2
        problem = LCP(identity + half * A, 0 * payoff, lower=payoff)
        for steps, old in ((4, 0.0), (STEPS - 2, half)) if k == 0 else ((STEPS, half),):
            found = march(problem, np.zeros((steps, payoff.size)), old * A - identity, z0=value)
            done.append((derivative(found), half, old))
            value = found.z[-1]
    return done


def forwards(
    spot: np.ndarray,
    done: list[Leg],
    payoff: np.ndarray,
    changes: list[tuple[sp.sparray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times to maturity, the exercise boundary at each, and from the second on delta, vega, rho; (.., 3, n)."""
    boundary, kept, tangents = [STRIKE], [], [dg for _, dg in changes]
    for found, half, old in done:
        moves = [
            found.jvp(dM=half * dA, dpropagator=old * dA, dlower=dg, dz0=dV)
            for (dA, dg), dV in zip(changes, tangents, strict=True)
        ]
        tangents = [dV[-1] for dV in moves]
        for k in (
            range(len(found) - 1, 0, -KEPT)[::-1] if old else ()
        ):  # the damping steps are not drawn
            boundary.append(spot[(found.march.z[k] > payoff).argmax()])
            kept.append([moves[0][k] / spot, *(dV[k] for dV in moves[1:])])
    of_march = np.arange(MARCHES + 1)
    years = np.interp(
        np.linspace(0, MARCHES, len(boundary)), of_march, MATURITY * (of_march / MARCHES) ** 2
    )
    return years, np.array(boundary), np.array(kept)


def backwards(
    node: int, done: list[Leg], changes: list[tuple[sp.sparray, np.ndarray]]
) -> np.ndarray:
    """Return how the price at one node changes with the shift of the payoff, the volatility and the rate."""
    weights, greeks = np.zeros(SIZE), np.zeros(len(changes))
    weights[node] = 1.0
    for found, half, old in reversed(done):
        by = found.vjp(weights)
        weights, shares = by.z0, half * by.M + old * by.propagator
        greeks += [shares.multiply(dA).sum() + by.lower @ dg for dA, dg in changes]
    return greeks + [weights @ dg for _, dg in changes]


def tree(
    spot: np.ndarray, rate: float, volatility: float, years: np.ndarray, levels: int
) -> np.ndarray:
    """Return American puts by a tree with an odd number of levels, shape (points,)."""

    def probability(d: np.ndarray) -> np.ndarray:
        scaled = d**2 * (levels + 1 / 6) / (levels + 1 / 3 + 0.1 / (levels + 1)) ** 2
        return 0.5 + np.copysign(0.5, d) * np.sqrt(1 - np.exp(-scaled))

    spread, growth, ups = (
        volatility * np.sqrt(years),
        np.exp(rate * years / levels),
        np.arange(levels + 1),
    )
    d2 = (np.log(spot / STRIKE) + rate * years) / spread - spread / 2
    p, share = probability(d2), probability(d2 + spread)
    up, down = growth * share / p, growth * (1 - share) / (1 - p)
    price = spot[:, None] * np.exp(
        ups * np.log(up)[:, None] + (levels - ups) * np.log(down)[:, None]
    )
    falls, rises, back = np.array([(1 - p) / growth, p / growth, 1 / down])[..., None]
    value = np.maximum(STRIKE - price, 0.0)
    for _ in range(levels):
        price, value, of_rises = price[:, :-1], value[:, :-1], rises * value[:, 1:]
        price *= back
        value *= falls
        value += of_rises
        np.maximum(value, STRIKE - price, out=value)
    return value[:, 0]


def tree_greeks(spot: np.ndarray, years: np.ndarray) -> np.ndarray:
    """Return delta, vega and rho by fourth-order differences of the extrapolated tree, shape (3, points)."""
    found = np.zeros((3, spot.size))
    for greek, ((ds, dv, dr), levels) in enumerate(
        zip(np.diag([1.0, 0.012, 0.007]), LEVELS, strict=True)
    ):
        for k, weight in ((-2, 1), (-1, -8), (1, 8), (2, -1)):
            data = spot + k * ds, RATE + k * dr, VOLATILITY + k * dv, years
            found[greek] += (
                weight
                / 12
                / (ds + dv + dr)
                * (2 * tree(*data, 2 * levels + 1) - tree(*data, levels))
            )
    return found


def main(out: Path = Path()) -> None:
    """Compute the Greeks at all times, compare with a binomial tree, save a figure into the folder OUT."""
    x = np.linspace(-1.5, 1.5, SIZE + 2)[1:-1]
    spot, (A, payoff, changes) = STRIKE * np.exp(x), operator(x)
    done = legs(A, payoff)
    years, boundary, kept = forwards(spot, done, payoff, changes)
    # three prices today, the last of them along the boundary
    at = np.array([100, 100, 100, 80, 60])
    prices = np.array([100.0, 120.0, *1.15 * boundary[at[2:]]])
    ours = np.array(
        [
            [np.interp(price, spot, one) for one in kept[k - 1]]
            for price, k in zip(prices, at, strict=True)
        ]
    )
    theirs = tree_greeks(prices, years[at]).T
    for price, left, mine, other in zip(prices, years[at], ours, theirs, strict=True):
        print(
            f"spot {price:6.2f}, {left:.2f} years left: delta, vega, rho {mine.round(4)}   tree {other.round(4)}"
        )
    off = abs(ours / theirs - 1).max(axis=0)
    print(
        "check: delta differs from the tree's by {:.1e}, vega by {:.1e}, rho by {:.1e}, relatively".format(
            *off
        )
    )
    node, to_spot = SIZE // 2, np.array([1 / STRIKE, 1.0, 1.0])
    both = backwards(node, done, changes) * to_spot / kept[-1][:, node]
    print(f"check: backwards they are the same at the money to {abs(both - 1).max():.1e}")
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, panels = plt.subplots(
        2, 3, figsize=(11, 6.2), layout="constrained", height_ratios=[1.35, 1]
    )
    shown, today = slice(*np.searchsorted(spot, (60, 150)), 5), MATURITY - years
    names = ("delta", "vega (EUR per 1.00 of σ)", "rho (EUR per 1.00 of r)")
    for greek, (name, (above, below)) in enumerate(zip(names, panels.T, strict=True)):
        field, colors = kept[:, greek, shown].T, ("cividis", "viridis", "viridis_r")[greek]
        figure.colorbar(
            above.pcolormesh(today[1:], spot[shown], field, cmap=colors, shading="gouraud"),
            ax=above,
        )
        above.fill_between(today, boundary, 60, color="white", linewidth=0)
        above.plot(today, boundary, color="#D55E00", linewidth=2)
        above.plot(
            today[at],
            prices,
            "o",
            color="#D55E00",
            markersize=4,
            markerfacecolor="white",
            clip_on=False,
        )
        above.set(
            xlim=(0, MATURITY), ylim=(60, 150), title=name, xlabel="time (years)", ylabel="S (EUR)"
        )
        below.plot(spot[shown], field[:, -1], color="#0072B2", linewidth=1.8, label="derivative")
        below.plot(
            prices[:3],
            theirs[:3, greek],
            "o",
            color="#D55E00",
            markerfacecolor="white",
            label="tree",
        )
        below.set(xlim=(60, 150), xlabel="spot price S (EUR)", title=f"{name.split()[0]} today")
        above.text(0.3, 63, "exercise", color="#D55E00")
    panels[1, 0].legend(loc="lower right")
    figure.savefig(out / "option_greeks.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
