"""A hundred American puts, each with a volatility of its own: found from their prices by Newton's method.

A market quotes prices; traders compare the volatility σ that explains each of them. The price of a put solves

    V ≥ g,   V_τ − ½σ² V_xx − (r − ½σ²) V_x + r V ≥ 0,   and at least one holds with equality,

with x = log(S/K), τ the time to maturity, g = max(K − S, 0). An implicit step of length Δτ is an LCP with
M(σ) = I + Δτ A(σ). σ and Δτ differ from put to put, and M with them; all matrices are tridiagonal, so that a step of
`march` is one pass over the rows. `derivative` of each march gives vega,
the change of the price with σ, exactly: Newton's method on the logarithm of the price takes a few marches.

Quotes come from a binomial tree with known volatilities, which uses no differential equation: these are the check.

Sources: Brennan, Schwartz, J. Finance 32, 1977, doi:10.2307/2326779; Cox, Ross, Rubinstein, J. Financial Economics 7,
1979, doi:10.1016/0304-405X(79)90015-1.
"""

import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, derivative, gallery, march

SPOT, RATE = 100.0, 0.05  # EUR, 1/year
STRIKES, YEARS = np.linspace(76.0, 105.0, 10), np.linspace(0.25, 2.0, 10)
SIZE, STEPS, LEVELS = 201, 100, 500  # unknowns, steps in time, of the trees
BEGIN, AT_MOST, RIGHT = 0.3, 8, 1e-8  # first guess of each volatility, rounds, of a price


def planted(strike: np.ndarray, years: np.ndarray) -> np.ndarray:
    """Return a surface with a smile that flattens with time."""
    distance = np.log(strike / SPOT)
    return 0.2 + 0.03 * np.exp(-years) - 0.15 * distance / np.sqrt(years + 0.2) + 0.4 * distance**2


def matrix(below: float, above: float, centre: float) -> sp.csr_array:
    """Return a tridiagonal matrix with constant diagonals."""
    return sp.csr_array(
        sp.diags_array([below, centre, above], offsets=[-1, 0, 1], shape=(SIZE, SIZE))
    )


def prices(
    sigma: np.ndarray, strike: np.ndarray, years: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return price and vega of each put, and the seconds of the run."""
    # six standard deviations either way of today's price
    reach, dt = (6 * BEGIN * np.sqrt(years), years / STEPS)
    h, x = (
        2 * reach / (SIZE + 1),
        np.log(SPOT / strike)[:, None] + reach[:, None] * np.linspace(-1, 1, SIZE + 2),
    )
    payoff = np.maximum(strike[:, None] * (1 - np.exp(x)), 0.0)
    diffusion, drift = 0.5 * (sigma / h) ** 2, 0.5 * (RATE - 0.5 * sigma**2) / h
    below, above = dt * (drift - diffusion), -dt * (drift + diffusion)
    by_sigma = dt * (-0.5 * sigma / h - sigma / h**2), -dt * (-0.5 * sigma / h + sigma / h**2)
    edge = np.zeros((3, sigma.size, SIZE))  # at the lowest price the put is exercised
    edge[:, :, 0] = np.array([below, *by_sigma]) * payoff[:, 0]

    began = time.perf_counter()
    problems = [
        LCP(matrix(a, c, 1 + k * RATE - a - c), np.zeros(SIZE), lower=g)
        for a, c, k, g in zip(below, above, dt, payoff[:, 1:-1], strict=True)
    ]
    marches = [
        march(problem, np.broadcast_to(row, (STEPS, SIZE)), propagator=-1.0, z0=problem.lower)
        for problem, row in zip(problems, edge[0], strict=True)
    ]
    marched = time.perf_counter()
    node = SIZE // 2  # that of today's price
    value, vega = (
        np.array([one[-1].require_solved().z[node] for one in marches]),
        np.empty(sigma.size),
    )
    for j, (one, da, dc) in enumerate(zip(marches, *by_sigma, strict=True)):
        vega[j] = derivative(one).jvp(
            dM=matrix(da, dc, -da - dc), dforcing=edge[1, j], only_last=True
        )[node]
    return value, vega, marched - began, time.perf_counter() - marched


def main(out: Path = Path()) -> None:
    """Quote all puts, find their volatilities again, save a figure into the folder OUT."""
    strike, years = (grid.ravel() for grid in np.meshgrid(STRIKES, YEARS))
    right = planted(strike, years)
    quotes = np.array(
        [
            gallery.binomial_put(
                np.array([SPOT]), strike=k, rate=RATE, volatility=s, maturity=t, steps=LEVELS
            )[0]
            for k, s, t in zip(strike, right, years, strict=True)
        ]
    )
    sigma, misses = np.full(strike.size, BEGIN), []
    prices(sigma[:2], strike[:2], years[:2])  # compiles, once on a machine
    for _ in range(AT_MOST):
        value, vega, to_march, to_differentiate = prices(sigma, strike, years)
        misses.append(abs(value / quotes - 1))
        print(
            f"{sigma.size} prices in {to_march:.2f} s, their vegas in {to_differentiate:.2f} s; "
            f"prices off by up to {misses[-1].max():.1e}"
        )
        if misses[-1].max() < RIGHT:
            break
        sigma = sigma - np.log(value / quotes) * value / vega
    step, off = 1e-4, 100 * abs(sigma - right)
    some = slice(None, None, 5)  # puts whose vega is checked
    up, down = (
        prices(sigma[some] + sign * step, strike[some], years[some])[0] for sign in (1.0, -1.0)
    )
    bumped = (up - down) / (2 * step)
    print(f"check: all quotes are met to {misses[-1].max():.1e}, relatively")
    print(
        f"check: the volatilities differ from the known ones by at most {off.max():.3f} percentage points"
    )
    print(
        f"check: vega differs from a central difference by at most {abs(bumped / vega[some] - 1).max():.1e}, relatively"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, middle, last) = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    shape = YEARS.size, STRIKES.size
    field = left.pcolormesh(
        STRIKES, YEARS, 100 * sigma.reshape(shape), cmap="cividis", shading="gouraud"
    )
    figure.colorbar(field, ax=left, label="volatility (%)")
    left.set(
        xlabel="strike (EUR)",
        ylabel="maturity (years)",
        title=f"{sigma.size} puts, a volatility each",
    )
    for k, color in zip((0, 3, 9), ("#D55E00", "#0072B2", "#009E73"), strict=True):
        middle.plot(STRIKES, 100 * planted(STRIKES, np.full(STRIKES.size, YEARS[k])), color=color)
        middle.plot(
            STRIKES,
            100 * sigma.reshape(shape)[k],
            "o",
            color=color,
            markersize=4,
            markerfacecolor="white",
            label=f"{YEARS[k]:.2g} years",
        )
    middle.set(xlabel="strike (EUR)", ylabel="volatility (%)", title="found (dots), known (lines)")
    middle.legend()
    last.semilogy([miss.max() for miss in misses], "o-", color="#0072B2", label="largest")
    last.semilogy([np.median(miss) for miss in misses], "o--", color="#999999", label="median")
    last.set(
        xlabel="Newton step",
        ylabel="relative error of the price",
        title=f"{sigma.size} marches a step",
    )
    last.legend()
    figure.savefig(out / "calibration.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
