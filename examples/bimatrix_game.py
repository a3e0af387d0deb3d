"""A game of two players with all its equilibria.

Two firms choose one of three standards. Each has a favorite, but both gain more if they agree: the row player gets
A_ij and the column player B_ij when one plays row i and the other column j. In a Nash equilibrium no player gains by a
change of mind; the players may toss coins. With costs K, L > 0 in the place of the payoffs the equilibria are, up to a
scale factor, the solutions of an LCP:

    z = (x, y) ≥ 0,   K y ≥ 1,   Lᵀ x ≥ 1,   and in every row one of the two holds with equality.

`solve` finds one of them, `all_solutions` every one, in exact arithmetic.

The check tries all pairs of supports (the actions that a player uses) of the same size, and makes each player
indifferent between the strategies of the player. It is the classical way and uses linear equations only.

Sources: Nash, Annals of Mathematics 54, 1951, doi:10.2307/1969529; Lemke, Howson, J. SIAM 12, 1964,
doi:10.1137/0112033.
"""

from itertools import combinations
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import LCP, all_solutions

A = np.array([[6, 0, 1], [2, 5, 0], [0, 1, 3]])
B = np.array([[3, 1, 0], [0, 5, 2], [1, 0, 6]])


def by_supports() -> list[np.ndarray]:
    """Return (x, y), joined, of every equilibrium with supports of the same size."""
    supports = [list(s) for size in (1, 2, 3) for s in combinations(range(3), size)]
    found = []
    for rows, columns in ((r, c) for r in supports for c in supports if len(r) == len(c)):
        x, y = np.zeros(3), np.zeros(3)
        x[rows] = indifferent(B[np.ix_(rows, columns)].T)
        y[columns] = indifferent(A[np.ix_(rows, columns)])
        gain = max((A @ y).max() - (A @ y)[rows[0]], (x @ B).max() - (x @ B)[columns[0]])
        if min(*x, *y) >= 0 and gain < 1e-12:
            found.append(np.concatenate([x, y]))
    return found


def indifferent(payoffs: np.ndarray) -> np.ndarray:
    """Return probabilities that give every row the same payoff."""
    size = len(payoffs)
    system = np.block([[payoffs, -np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]])
    return np.linalg.solve(system, np.eye(size + 1)[-1])[:-1]


def main(out: Path = Path()) -> None:
    """Find all equilibria, compare with a search over supports, and save a figure into the folder OUT."""
    problem = LCP.from_game(A, B)
    equilibria = [problem.origin.recover(solution.z) for solution in all_solutions(problem)]
    for k, found in enumerate(equilibria, start=1):
        payoffs = ", ".join(f"{payoff:.3f}" for payoff in found.payoffs)
        print(
            f"{k}  row {found.row_strategy.round(3)}  column {found.column_strategy.round(3)}  payoffs {payoffs}  "
            f"regret {found.regret:.0e}"
        )
    ours = np.array([[*found.row_strategy, *found.column_strategy] for found in equilibria])
    apart = [abs(ours - one).max(axis=1).min() for one in by_supports()]
    print(
        f"check: {len(ours)} equilibria here, {len(apart)} by supports; the same up to {max(apart):.1e}"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, panels = plt.subplots(1, 2, figsize=(9.4, 4.4), layout="constrained")
    corners = np.array([[0, 0], [1, 0], [0.5, np.sqrt(3) / 2]])
    for axes, player in zip(panels, ("row", "column"), strict=True):
        axes.fill(*corners.T, facecolor="#f4f4f4", edgecolor="#999999")
        for corner, name, shift in zip(
            corners, "ABC", [(-14, -20), (14, -20), (0, 14)], strict=True
        ):
            axes.annotate(
                f"only {name}",
                corner,
                shift,
                textcoords="offset points",
                ha="center",
                color="#555555",
            )
        for k, found in enumerate(equilibria, start=1):
            strategy = getattr(found, f"{player}_strategy")
            is_pure = strategy.max() > 0.999
            axes.plot(
                *(strategy @ corners), "o", color="#D55E00" if is_pure else "#0072B2", markersize=15
            )
            axes.annotate(
                str(k),
                strategy @ corners,
                ha="center",
                va="center_baseline",
                color="white",
                fontsize=9,
            )
        axes.set(
            aspect="equal",
            xlim=(-0.15, 1.15),
            ylim=(-0.15, 1.05),
            title=f"{player.capitalize()} player",
        )
        axes.set_axis_off()
    figure.suptitle(
        "All equilibria: orange pure, blue mixed; the same number is the same equilibrium",
        fontsize=11,
    )
    figure.savefig(out / "bimatrix_game.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
