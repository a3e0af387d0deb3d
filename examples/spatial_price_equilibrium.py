"""Trade between regions: who ships how much to whom, at which prices.

Each region i supplies at the price π_i = a_i + b_i s_i and buys at the price ρ_i = c_i − d_i y_i; shipping a unit from
i to j costs t_ij. No trader ships at a loss, and where goods flow, competition leaves no profit:

    x_ij ≥ 0,   π_i + t_ij − ρ_j ≥ 0,   and for every pair (i, j) one of the two is zero,

with the supply s_i = Σ_j x_ij and the demand y_j = Σ_i x_ij. In the flows x this is an LCP: with the 0–1 matrices S and
Y that add up supplies and demands, M = Sᵀ diag(b) S + Yᵀ diag(d) Y and q = Sᵀ a + t − Yᵀ c.

Samuelson's theorem gives a second way: the same flows maximize a total surplus, so that a convex solver finds them too.

Sources: Samuelson, Spatial price equilibrium and linear programming, American Economic Review 42, 1952; Takayama,
Judge, Equilibrium among spatially separated markets: a reformulation, Econometrica 32, 1964.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import LCP, solve

REGIONS = 12


def main(out: Path = Path()) -> None:
    """Find the equilibrium, compare with the greatest surplus, and save a map into the folder OUT."""
    random = np.random.default_rng(7)
    place = np.array([(300 * (k % 4), 300 * (k // 4)) for k in range(REGIONS)]) + random.uniform(
        0, 190, (REGIONS, 2)
    )
    # EUR/t, EUR/t per kt
    a, b = (random.uniform(20, 120, REGIONS), random.uniform(0.2, 1.0, REGIONS))
    c, d = random.uniform(80, 180, REGIONS), random.uniform(0.2, 1.0, REGIONS)
    t = 0.03 * np.linalg.norm(place[:, None] - place, axis=2).ravel()  # EUR/t
    S, Y = np.kron(np.eye(REGIONS), np.ones(REGIONS)), np.kron(np.ones(REGIONS), np.eye(REGIONS))

    M = S.T @ np.diag(b) @ S + Y.T @ np.diag(d) @ Y
    result = solve(LCP(M, S.T @ a + t - Y.T @ c)).require_solved()
    flow = result.z.reshape(REGIONS, REGIONS)
    price = c - d * flow.sum(axis=0)
    print(result.explain())
    trade = [(i, j) for i, j in np.argwhere(flow > 0.5) if i != j]
    for i, j in trade:
        print(
            f"{i:2d} → {j:2d}  {flow[i, j]:6.1f} kt   price {price[i]:6.2f} + transport {t[i * REGIONS + j]:5.2f} "
            f"= {price[j]:6.2f} EUR/t"
        )

    x = cp.Variable(REGIONS**2, nonneg=True)
    costs = a @ (S @ x) + t @ x + b / 2 @ (S @ x) ** 2
    cp.Problem(cp.Maximize(c @ (Y @ x) - d / 2 @ (Y @ x) ** 2 - costs)).solve(solver="CLARABEL")
    print(
        f"check: the prices of the greatest surplus differ by {abs(price - (c - d * (Y @ x.value))).max():.1e} EUR/t"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, axes = plt.subplots(figsize=(8.4, 5.6), layout="constrained")
    for i, j in trade:
        axes.annotate(
            "",
            place[j],
            place[i],
            arrowprops={
                "arrowstyle": "-|>",
                "linewidth": 0.5 + 0.07 * flow[i, j],
                "color": "#888888",
                "mutation_scale": 14,
                "shrinkA": 11,
                "shrinkB": 11,
                "connectionstyle": "arc3,rad=0.12",
            },
        )
        ahead = place[j] - place[i]
        middle = place[i] + 0.5 * ahead + 0.06 * ahead[::-1] * [1, -1]  # on the curve of the arrow
        axes.annotate(
            f"{flow[i, j]:.0f}",
            middle,
            fontsize=8,
            color="#333333",
            ha="center",
            va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.85},
        )
    dots = axes.scatter(
        *place.T, c=price, s=420, cmap="cividis", edgecolors="white", linewidths=1.5, zorder=3
    )
    for i, at in enumerate(place):
        ink = "white" if price[i] < price.mean() else "black"
        axes.annotate(
            str(i), at, ha="center", va="center_baseline", fontsize=9, color=ink, zorder=4
        )
    figure.colorbar(dots, ax=axes, shrink=0.85, label="price (EUR/t)").outline.set_visible(False)
    axes.set(xlabel="km", ylabel="km", aspect="equal", xlim=(-60, 1150), ylim=(-60, 850))
    axes.set_title("Goods flow where the difference in price pays the transport (kt)")
    figure.savefig(out / "spatial_price_equilibrium.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
