"""Three familiar problems that are LCPs: least squares with signs, a classifier, a portfolio.

A convex quadratic program min ½ xᵀP x + cᵀx with constraints is an LCP: the multiplier of each constraint and its slack
are the complementary pair. `LCP.from_qp` writes it down, and `origin.recover` leads back to x and all multipliers.

1. Non-negative least squares: min ‖A x − b‖², x ≥ 0. Here M = AᵀA, q = −Aᵀb; no more is needed.
2. Support vector machine: min ½ αᵀQ α − Σ α over 0 ≤ α ≤ C, yᵀα = 0, with Q_ij = y_i y_j x_i·x_j. The points with α > 0
   carry the line between two classes.
3. Portfolio: min ½ xᵀΣ x − r μᵀx over x ≥ 0, Σ x = 1: the least risk for the taste r of return, without short sales.

Each has a check without LCPs: scipy's nnls, the gap between dual and primal objective, a conic solver.

Sources: Lawson, Hanson, Solving Least Squares Problems, SIAM 1995, doi:10.1137/1.9781611971217; Cortes, Vapnik, Machine
Learning 20, 1995, doi:10.1007/BF00994018; Markowitz, J. Finance 7, 1952, doi:10.1111/j.1540-6261.1952.tb01525.x.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import scipy.optimize
import typer

from lcp_plugin import LCP, solve

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"
PENALTY = 2.0  # C of the support vector machine


def least_squares(axes: plt.Axes, random: np.random.Generator) -> float:
    """Unmix a spectrum into non-negative parts; return the distance from scipy's answer."""
    wave, centres = np.linspace(0, 10, 200), np.linspace(1, 9, 12)
    A = np.exp(-((wave[:, None] - centres) ** 2))
    b = A @ (
        random.uniform(0, 2, 12) * (random.uniform(size=12) < 0.5)
    ) + 0.05 * random.standard_normal(200)
    x = solve(LCP(A.T @ A, -A.T @ b), tolerance=1e-12).require_solved().z
    axes.plot(wave, b, ".", color="#aaaaaa", markersize=3, label="measured")
    axes.fill_between(wave, A @ x, color=BLUE, alpha=0.15, linewidth=0)
    axes.plot(wave, A @ x, color=BLUE, linewidth=1.5, label="sum of the parts")
    axes.vlines(
        centres[x > 0], 0, x[x > 0], color=ORANGE, linewidth=3, label="parts, none negative"
    )
    axes.set(
        xlabel="wavelength",
        ylabel="intensity",
        title="Non-negative least squares",
        ylim=(-0.2, 2.6),
    )
    axes.legend(fontsize=8, loc="upper right")
    return abs(x - scipy.optimize.nnls(A, b)[0]).max()


def classifier(axes: plt.Axes, random: np.random.Generator) -> float:
    """Separate two clouds; return the relative gap between the primal and the dual objective."""
    side = np.repeat([1.0, -1.0], 40)
    x = random.standard_normal((80, 2)) + np.outer(side, [1.2, 0.8])
    dual = LCP.from_qp(
        (side[:, None] * x) @ (side[:, None] * x).T,
        -np.ones(80),
        A=side[None, :],
        b=[0.0],
        lower=0.0,
        upper=PENALTY,
    )
    alpha = dual.origin.recover(solve(dual, tolerance=1e-12).require_solved()).x
    normal = (alpha * side) @ x
    on_margin = (alpha > 1e-6) & (alpha < PENALTY - 1e-6)
    offset = np.mean(side[on_margin] - x[on_margin] @ normal)
    primal = 0.5 * normal @ normal + PENALTY * np.maximum(1 - side * (x @ normal + offset), 0).sum()
    for sign, color in ((1, BLUE), (-1, GREEN)):
        axes.plot(*x[side == sign].T, "o" if sign > 0 else "s", color=color, markersize=4)
    axes.plot(
        *x[alpha > 1e-6].T,
        "o",
        color=ORANGE,
        markersize=9,
        markerfacecolor="none",
        label="support vectors",
    )
    across = np.array([-4.0, 4.0])
    for level, style in ((-1, ":"), (0, "-"), (1, ":")):
        axes.plot(
            across,
            (level - offset - normal[0] * across) / normal[1],
            style,
            color="#333333",
            linewidth=1,
        )
    axes.set(xlim=(-4, 4), ylim=(-3.6, 3.9), xlabel="first feature", ylabel="second feature")
    axes.set_title("Support vector machine")
    axes.legend(fontsize=8, loc="upper right")
    return abs(primal - (alpha.sum() - 0.5 * normal @ normal)) / primal


def portfolio(axes: plt.Axes, random: np.random.Generator) -> float:
    """Mix six funds for many tastes of return; return the largest distance from a conic solver's portfolio."""
    mean = np.array([2.0, 3.5, 5.0, 6.5, 8.0, 9.0])  # percent a year
    factor = random.standard_normal((6, 6)) * np.linspace(1, 7, 6)[:, None]
    covariance, tastes = (
        factor @ factor.T + np.diag(np.linspace(1, 5, 6) ** 2),
        np.linspace(0, 40, 41),
    )
    budget = {"A": np.ones((1, 6)), "b": [1.0], "lower": 0.0}
    problems = [LCP.from_qp(covariance, -taste * mean, **budget) for taste in tastes]
    mixes = np.array(
        [p.origin.recover(solve(p, tolerance=1e-12).require_solved()).x for p in problems]
    )
    x, taste = cp.Variable(6, nonneg=True), cp.Parameter(nonneg=True)
    model = cp.Problem(
        cp.Minimize(cp.quad_form(x, covariance) / 2 - taste * (mean @ x)), [cp.sum(x) == 1]
    )
    apart = []
    for k in (0, 10, 20, 40):
        taste.value = tastes[k]
        model.solve(solver="CLARABEL")
        apart.append(abs(mixes[k] - x.value).max())
    colors = plt.get_cmap("cividis")(np.linspace(0.05, 0.95, 6))
    axes.stackplot(
        tastes, 100 * mixes.T, colors=colors, labels=[f"{value:g} %" for value in mean], alpha=0.9
    )
    axes.set(
        xlim=(0, 40),
        ylim=(0, 100),
        xlabel="taste r of return",
        ylabel="share (%)",
        title="Portfolio",
    )
    axes.legend(title="return a year", fontsize=8, loc="upper right", frameon=True, framealpha=0.85)
    return max(apart)


def main(out: Path = Path()) -> None:
    """Solve all three, compare each with another method, and save a figure into the folder OUT."""
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, panels = plt.subplots(1, 3, figsize=(12.6, 4.0), layout="constrained")
    random = np.random.default_rng(3)
    print(
        f"check: least squares differ from scipy's nnls by {least_squares(panels[0], random):.1e}"
    )
    print(f"check: the classifier's duality gap is {classifier(panels[1], random):.1e}")
    print(
        f"check: the portfolios differ from the portfolios of a conic solver by {portfolio(panels[2], random):.1e}"
    )
    figure.savefig(out / "nnls_svm_portfolio.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
