"""The lasso for every penalty at once: which genes matter, and in which order they come in.

A measurement b is explained by few of many columns of A:

    min ½ ‖A x − b‖² + λ Σ |x_j|.

For λ ≥ ‖Aᵀb‖∞ nothing is explained, x = 0; as λ falls columns come in one after the other, and some leave again. x is
piecewise affine in λ. `trace` returns all pieces, with the exact λ at which each column comes in or leaves: no grid of
penalties, and none of its values is missed. The same path is stated in cvxpy with a Parameter.

Fresh measurements say which λ explains best, here at every λ: between two breakpoints the error on them is a parabola,
whose least value is found in closed form.

Source: Efron, Hastie, Johnstone, Tibshirani, Annals of Statistics 32, 2004 (least angle regression).
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import BoundedLeastSquares, solve, trace

SAMPLES, GENES, TRUE = 80, 200, {3: 2.0, 17: -1.5, 60: 1.0, 101: 1.0, 150: -0.7}


def measured(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return expressions of genes that vary in groups, and their noisy measurements."""
    A = rng.standard_normal((SAMPLES, GENES)) + np.repeat(
        rng.standard_normal((SAMPLES, GENES // 10)), 10, axis=1
    )
    x = np.zeros(GENES)
    x[list(TRUE)] = list(TRUE.values())
    return A, A @ x + 1.5 * rng.standard_normal(SAMPLES)


def main(out: Path = Path()) -> None:
    """Trace the path, choose its best point, compare with solves, and save a figure into the folder OUT."""
    rng = np.random.default_rng(4)
    A, b = measured(rng)
    fresh, seen = measured(rng)
    most = abs(A.T @ b).max()
    path = trace(
        BoundedLeastSquares(A, b, lower=-np.inf), {"l1": 1}, most, most / 100
    ).require_solved()
    print(path.explain())

    best, least = most, np.inf
    for piece in path.pieces:  # on each the error is the square of r0 + (λ − begin) r1
        r0, r1 = fresh @ piece.x0 - seen, fresh @ piece.x1
        inside = piece.begin - (r0 @ r1) / (r1 @ r1) if r1.any() else piece.begin
        penalty = min(max(inside, piece.end), piece.begin)
        if (error := np.sum((r0 + (penalty - piece.begin) * r1) ** 2)) < least:
            best, least = penalty, error
    chosen = path.at(best)
    print(
        f"the best λ is {best:.3f} of {most:.1f}: {np.count_nonzero(chosen.x)} genes, the five true ones "
        f"{'among them' if chosen.x[list(TRUE)].all() else 'not all among them'}"
    )

    differences = []
    for penalty in np.geomspace(most, most / 100, 20):
        alone = solve(BoundedLeastSquares(A, b, lower=-np.inf, l1=penalty)).require_solved()
        differences.append(abs(alone.x - path.at(penalty).x).max())
    x, parameter = cp.Variable(GENES), cp.Parameter(nonneg=True)
    model = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(A @ x - b) + parameter * cp.norm1(x)))
    stated = trace(model, parameter, most, best).require_solved()
    in_cvxpy = abs(stated.value(x, best) - chosen.x).max()
    print(
        f"check: twenty solves differ from the path by at most {max(differences):.1e}, and cvxpy's by {in_cvxpy:.1e}"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11.0, 4.6), width_ratios=[1.5, 1], layout="constrained"
    )
    values = path.x(path.breakpoints)
    for j in np.flatnonzero(values.any(axis=0)):
        if j in TRUE:
            left.plot(
                path.breakpoints, values[:, j], linewidth=2, label=f"gene {j}, in truth {TRUE[j]:g}"
            )
        else:
            left.plot(path.breakpoints, values[:, j], color="#bbbbbb", linewidth=0.8, zorder=1)
    left.axvline(best, color="#222222", linestyle=":", label="best on fresh measurements")
    left.set(
        xscale="log",
        xlim=(most, most / 100),
        ylim=(-1.6, 3.4),
        xlabel="penalty λ",
        ylabel="coefficient",
    )
    left.set_title(f"Genes come in one after the other: {len(path)} exact pieces")
    left.legend(loc="upper left", fontsize=8)
    penalties = np.geomspace(most, most / 100, 400)
    x_at = path.x(penalties)
    for name, one, other, color in (("fresh", fresh, seen, "#D55E00"), ("own", A, b, "#0072B2")):
        right.plot(
            penalties,
            np.mean((x_at @ one.T - other) ** 2, axis=1),
            color=color,
            label=f"{name} measurements",
        )
    right.plot(best, least / SAMPLES, "o", color="#D55E00")
    right.set(
        xscale="log",
        yscale="log",
        xlim=(most, most / 100),
        xlabel="penalty λ",
        ylabel="mean squared error",
    )
    right.set_title("The best point, found on the pieces")
    right.legend()
    figure.savefig(out / "lasso_path.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
