"""The efficient frontier: all portfolios that are not dominated, from the least risk to the highest return.

Of assets with expected returns μ and covariances Σ the best portfolio for a risk tolerance θ is

    min ½ xᵀΣx − θ μᵀx,   Σ x = 1,   0 ≤ x ≤ 40 %.

Its shares are piecewise affine in θ. `trace` returns all pieces, from corner portfolio to corner portfolio (Markowitz'
critical line algorithm finds the same), each certified; between two of them the frontier is an arc of a parabola. At
the end, where only the return counts, it is a linear program.

The comparison is the critical line by its definition: with a set of assets held and a set at 40 % the shares solve one
linear system, and that set is right where no share leaves its bounds and no asset left out would pay.

Source: Markowitz, Portfolio Selection, 1959; Niedermayer, Niedermayer, in: Handbook of Portfolio Construction, 2010.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import QuadraticProgram, trace

ASSETS, LIMIT = 10, 0.4
NAMES = (
    "bonds",
    "utilities",
    "food",
    "health",
    "banks",
    "energy",
    "cars",
    "tech",
    "chips",
    "biotech",
)


def market() -> tuple[np.ndarray, np.ndarray]:
    """Return yearly returns and covariances: three factors, and risks of each asset's own."""
    rng = np.random.default_rng(11)
    loads = np.column_stack(
        [np.linspace(0.02, 0.22, ASSETS), 0.06 * rng.standard_normal((ASSETS, 2))]
    )
    own = np.linspace(0.03, 0.15, ASSETS)
    return np.linspace(0.02, 0.11, ASSETS) + 0.01 * rng.standard_normal(
        ASSETS
    ), loads @ loads.T + np.diag(own**2)


def critical_line(mean: np.ndarray, risk: np.ndarray, theta: float) -> np.ndarray:
    """Return the best portfolio at one θ: the set of assets at a bound is changed until it is right."""
    free, full = np.ones(ASSETS, dtype=bool), np.zeros(ASSETS, dtype=bool)
    for _ in range(200):
        k, shares = free.sum(), np.where(full, LIMIT, 0.0)
        system = np.block(
            [[risk[np.ix_(free, free)], np.ones((k, 1))], [np.ones((1, k)), np.zeros((1, 1))]]
        )
        right = np.append((theta * mean - risk @ shares)[free], 1.0 - shares.sum())
        *own, price = np.linalg.solve(system, right)
        shares[free] = own
        gain = theta * mean - risk @ shares - price  # of an asset held more
        wrong = np.where(free, np.maximum(-shares, shares - LIMIT), np.where(full, -gain, gain))
        worst = int(np.argmax(wrong))
        if wrong[worst] <= 1e-12:
            return shares
        if free[worst]:
            free[worst], full[worst] = False, shares[worst] > LIMIT
        else:
            free[worst], full[worst] = True, False
    raise RuntimeError("the sets of assets go round in a circle")


def main(out: Path = Path()) -> None:
    """Trace the frontier, compare it with the critical line, and save a figure into the folder OUT."""
    mean, risk = market()
    program = QuadraticProgram(
        risk, np.zeros(ASSETS), A=np.ones((1, ASSETS)), b=[1], lower=0, upper=LIMIT
    )
    path = trace(program, {"c": -mean}, 0.0, 3.0).require_solved()
    print(path.explain())

    thetas = np.concatenate([path.breakpoints, np.linspace(0.0, 3.0, 301)])
    difference = max(
        abs(path.at(theta).x - critical_line(mean, risk, theta)).max() for theta in thetas
    )
    print(
        f"check: the shares of the critical line differ by {difference:.1e} at {thetas.size} risk tolerances"
    )
    price = path.at(0.5).solution.equality[0]
    slope = path.derivative(0.5)
    print(
        f"at θ = 0.5 a further per cent invested costs {-price / 100:.2e}; a larger θ buys "
        f"{NAMES[int(np.argmax(slope.x))]} and sells {NAMES[int(np.argmin(slope.x))]}"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11.0, 4.6), width_ratios=[1, 1.3], layout="constrained"
    )
    fine = np.unique(np.concatenate([np.linspace(p.begin, p.end, 30) for p in path.pieces]))
    for values, style in (
        (path.x(fine), {"color": "#0072B2", "linewidth": 2}),
        (path.x(path.breakpoints), {"color": "#D55E00", "marker": "o", "linestyle": "none"}),
    ):
        spread = np.sqrt(np.einsum("ki,ij,kj->k", values, risk, values))
        left.plot(100 * spread, 100 * values @ mean, **style)
    left.plot(100 * np.sqrt(np.diag(risk)), 100 * mean, ".", color="#999999")
    for name, x, y in zip(NAMES, 100 * np.sqrt(np.diag(risk)), 100 * mean, strict=True):
        left.annotate(
            name, (x, y), xytext=(4, -3), textcoords="offset points", fontsize=7.5, color="#777777"
        )
    left.set(xlabel="risk: standard deviation, % a year", ylabel="expected return, % a year")
    left.set_title(f"The frontier and its {len(path.breakpoints)} corner portfolios")
    colors = plt.get_cmap("viridis")(np.linspace(0.05, 0.95, ASSETS))
    right.stackplot(fine, 100 * path.x(fine).T, colors=colors, labels=NAMES, linewidth=0)
    for theta in path.breakpoints:
        right.axvline(theta, color="white", linewidth=0.6)
    right.set(xlim=(0, 3), ylim=(0, 100), xlabel="risk tolerance θ", ylabel="share, %")
    right.set_xscale("function", functions=(np.sqrt, np.square))
    right.set_xticks([0, 0.1, 0.5, 1, 2, 3])
    right.set_title("Shares, affine in θ between corners (over the root of θ)")
    handles, labels = right.get_legend_handles_labels()
    right.legend(
        handles[::-1], labels[::-1], loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8
    )
    figure.savefig(out / "efficient_frontier.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
