"""An American put option, and when it is best to exercise it early.

A put is the right to sell a share for the strike K until the maturity T. It is never worth less than
its payoff g = max(K − S, 0). If it is worth more, waiting is right, and its value V follows the
Black–Scholes equation. In x = log(S/K) and time to maturity τ:

    V ≥ g,   V_τ − ½σ² V_xx − (r − ½σ²) V_x + r V ≥ 0,   and at least one holds with equality.

An implicit Euler step of length Δτ is an LCP with M = I + Δτ A, q = −(the values before the step), lower = g. M is the
same in every step, and tridiagonal: `march` takes all steps in one compiled loop.

Sources: Brennan, Schwartz, J. Finance 32, 1977, doi:10.2307/2326779. The check is the binomial tree of Cox, Ross and
Rubinstein, J. Financial Economics 7, 1979, doi:10.1016/0304-405X(79)90015-1, which uses no differential equation.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, gallery, march
from lcp_plugin.evidence.drawing import contact_level

STRIKE, RATE, VOLATILITY, MATURITY = 100.0, 0.05, 0.3, 1.0  # EUR, 1/year, 1/√year, years
SIZE, STEPS = 901, 150


def main(out: Path = Path()) -> None:
    """Price the option, compare with a binomial tree, and save a figure into the folder OUT."""
    x = np.linspace(-1.5, 1.5, SIZE + 2)
    h, time_step = x[1] - x[0], MATURITY / STEPS
    spot, payoff = STRIKE * np.exp(x), np.maximum(STRIKE - STRIKE * np.exp(x), 0.0)
    diffusion, drift = 0.5 * (VOLATILITY / h) ** 2, 0.5 * (RATE - 0.5 * VOLATILITY**2) / h
    below, above = time_step * (drift - diffusion), -time_step * (drift + diffusion)
    M = sp.diags_array(
        [below, 1 + time_step * RATE - below - above, above], offsets=[-1, 0, 1], shape=(SIZE, SIZE)
    )
    edge = np.zeros(SIZE)
    # deep in the money it is exercised; far out of the money it is worth nothing
    edge[0] = below * payoff[0]

    lower = payoff[1:-1]
    march_back = march(
        LCP(M, edge, lower=lower), np.broadcast_to(edge, (STEPS, SIZE)), propagator=-1.0, z0=lower
    )
    steps = [step.require_solved() for step in march_back]
    value, seconds = steps[-1].z, sum(step.seconds for step in steps)
    edges = [np.interp(0.0, contact_level(step.certificate), x[1:-1]) for step in steps]
    boundary = [STRIKE, *(STRIKE * np.exp(edges))]
    print(f"{STEPS} steps with {SIZE} unknowns each: {seconds:.2g} s")

    some = np.array([70.0, 80.0, 90.0, 100.0, 110.0, 120.0, 130.0, 140.0])
    ours = np.interp(np.log(some / STRIKE), x[1:-1], value)
    tree = gallery.binomial_put(
        some, strike=STRIKE, rate=RATE, volatility=VOLATILITY, maturity=MATURITY, steps=1000
    )
    for price, mine, theirs in zip(some, ours, tree, strict=True):
        print(f"spot {price:5.0f}   LCP {mine:8.4f}   tree {theirs:8.4f}")
    print(
        f"check: the prices differ from a binomial tree by at most {abs(ours - tree).max():.4f} EUR"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.2), layout="constrained")
    left.plot(spot, payoff, color="#999999", linestyle="--", label="exercise at once")
    left.plot(spot[1:-1], value, color="#0072B2", linewidth=1.8, label="value of the option")
    left.plot(
        some,
        tree,
        "o",
        color="#D55E00",
        markersize=5,
        markerfacecolor="white",
        label="binomial tree",
    )
    left.set(
        xlim=(50, 160), ylim=(0, 50), xlabel="spot price S (EUR)", ylabel="EUR", title="Value today"
    )
    left.legend()
    years = np.linspace(0, MATURITY, STEPS + 1)[::-1]
    right.plot(years, boundary, color="#D55E00", linewidth=1.8)
    right.fill_between(years, boundary, 60, color="#D55E00", alpha=0.12, linewidth=0)
    right.text(0.45, 65, "exercise", color="#D55E00", fontsize=11)
    right.text(0.25, 88, "wait", color="#0072B2", fontsize=11)
    right.set(
        xlim=(0, MATURITY), ylim=(60, 102), xlabel="time (years)", ylabel="spot price S (EUR)"
    )
    right.set_title("Early exercise: the free boundary")
    figure.savefig(out / "american_put.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
