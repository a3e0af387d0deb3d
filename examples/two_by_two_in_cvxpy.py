"""The smallest problem worth drawing: two unknowns, stated in cvxpy.

Find z ≥ 0 such that w = M z + q ≥ 0 and, in each row, z or w is zero. In cvxpy the two sides go into `complements`, and
the dual value of that constraint is w.

Why is there exactly one answer? Write the problem as q = w₁ e₁ + w₂ e₂ − z₁ M₁ − z₂ M₂ with the columns of the identity
and of M. In each row one of the two coefficients is zero, so q lies in one of four cones: (e₁, e₂), (−M₁, e₂),
(e₁, −M₂) or (−M₁, −M₂). If all principal minors of M are positive, these cones fill the plane without overlap:
every q lies in one of them, and the edges of that cone tell which of z and w are positive.

Source: Cottle, Pang, Stone, The Linear Complementarity Problem, SIAM 2009, doi:10.1137/1.9780898719000, section 1.3.
"""

from itertools import product
from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import complements

M = np.array([[2.0, 1.0], [1.0, 2.0]])
q = np.array([-5.0, 1.0])


def by_hand() -> np.ndarray:
    """Return z found by trying all four choices of the rows where w = 0."""
    for rows in map(np.flatnonzero, product([False, True], repeat=2)):
        z = np.zeros(2)
        z[rows] = np.linalg.solve(M[np.ix_(rows, rows)], -q[rows])
        if z.min() >= 0 and (M @ z + q).min() >= 0:
            return z
    raise ValueError("no choice fits")


def main(out: Path = Path()) -> None:
    """Solve the problem, compare with the answer by hand, and draw the four cones into the folder OUT."""
    z = cp.Variable(2)
    pair = complements(z >= 0, M @ z + q >= 0)
    problem = cp.Problem(cp.Minimize(0), [pair])
    problem.solve(method="LCP", tolerance=1e-12)
    print(f"{problem.status}: z = {z.value.round(6)}, w = {pair.dual_value.round(6)}")
    print(f"check: all four cases by hand differ by {abs(z.value - by_hand()).max():.1e}")

    edges = {"$e_1$": [1, 0], "$e_2$": [0, 1], "$-M_1$": -M[:, 0], "$-M_2$": -M[:, 1]}
    cones = [("$e_1$", "$e_2$"), ("$-M_1$", "$e_2$"), ("$e_1$", "$-M_2$"), ("$-M_1$", "$-M_2$")]
    says = ["z = 0", "z₁ > 0, w₂ > 0", "w₁ > 0, z₂ > 0", "w = 0"]
    unit = {name: np.array(edge) / np.linalg.norm(edge) for name, edge in edges.items()}
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, axes = plt.subplots(figsize=(5.6, 5.4), layout="constrained")
    for (first, second), text, color in zip(
        cones, says, ["#56B4E9", "#E69F00", "#009E73", "#CC79A7"], strict=True
    ):
        axes.fill(
            *np.array([[0, 0], 30 * unit[first], 30 * unit[second]]).T,
            color=color,
            alpha=0.25,
            linewidth=0,
        )
        middle = unit[first] + unit[second]
        axes.text(*(3.6 * middle / np.linalg.norm(middle)), text, ha="center", fontsize=11)
    for name, direction in unit.items():
        axes.annotate(
            "", 4.6 * direction, (0, 0), arrowprops={"arrowstyle": "-|>", "color": "#333333"}
        )
        axes.text(*(5.1 * direction), name, ha="center", va="center", fontsize=12)
    axes.plot(*q, "o", color="#D55E00", markersize=9)
    axes.annotate("q", q, (-10, 6), textcoords="offset points", color="#D55E00", fontsize=13)
    axes.set(
        xlim=(-6, 6),
        ylim=(-6, 6),
        aspect="equal",
        xlabel="first row of q",
        ylabel="second row of q",
    )
    axes.set_title("q lies in the cone of $-M_1$ and $e_2$, so $z_1$ and $w_2$ are positive")
    figure.savefig(out / "two_by_two_in_cvxpy.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
