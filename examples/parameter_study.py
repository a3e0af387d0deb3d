"""A hundred problems with one matrix: a bar is twisted until it yields.

Twist a square steel bar. Its stress function u vanishes on the edge, and −Δu = 2α inside, α the twist per length. The
stress |∇u| cannot exceed the yield stress 1, which means that u stays below the distance to the edge:

    u ≤ dist,   −Δu ≤ 2α,   and at every point at least one holds with equality.

From one α to the next only q = −2α h² changes. `prepare` computes the parts that depend only on M once,
and each solve starts from the answer before, whose contact set is nearly right: Newton's method
needs a step or two. `solve_batch` is shorter if the starts do not matter.

Two limits are known: for small α all is elastic and the torque is 0.1406 · 2⁴ · α (a bar of side 2); for large α all is
plastic and the torque is twice the volume under a pyramid, 8/3.

Sources: Ting, J. Math. Mech. 19, 1969 (the obstacle problem); Timoshenko, Goodier, Theory of Elasticity, 1970 (0.1406).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, prepare, solve_batch
from lcp_plugin.evidence.drawing import contact_level

SIZE = 49  # nodes along each side, the edge not counted
TWISTS = np.linspace(0.05, 5.0, 100)


def main(out: Path = Path()) -> None:
    """Solve for all twists, compare with both limits, and save a figure into the folder OUT."""
    nodes = np.linspace(-1, 1, SIZE + 2)[1:-1]
    h = nodes[1] - nodes[0]
    distance = 1 - np.maximum(abs(nodes[:, None]), abs(nodes))
    second_difference = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(SIZE, SIZE))
    M = sp.kron(second_difference, sp.eye_array(SIZE)) + sp.kron(
        sp.eye_array(SIZE), second_difference
    )
    step = prepare(LCP(M, np.zeros(SIZE**2), lower=-np.inf, upper=distance.ravel()), "newton")

    loads = -2 * TWISTS[:, None] * np.full(SIZE**2, h**2)
    warm, start = [], None
    for load in loads:
        warm.append(step.solve(q=load, z0=start).require_solved())
        start = warm[-1].z
    cold = solve_batch(step, loads, algorithm="newton")
    for name, results in (("each from the one before", warm), ("each from nothing", cold)):
        print(
            f"{len(results)} problems, {name:<25} {sum(one.iterations for one in results):5d} iterations, "
            f"{sum(one.work for one in results):7.0f} passes over M"
        )

    torque = np.array([2 * h**2 * one.z.sum() for one in warm])
    levels = [contact_level(one.certificate).reshape(SIZE, SIZE) for one in warm]
    # of a cell between 0 and 1
    plastic = [np.clip(0.5 - level, 0.0, 1.0).mean() for level in levels]
    elastic, fully_plastic = 0.1406 * 2**4 * TWISTS, 8 / 3
    print(
        f"check: the first torque differs from the elastic one by {abs(torque[0] / elastic[0] - 1):.2%}, "
        f"the last from the fully plastic one by {abs(torque[-1] / fully_plastic - 1):.2%}"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10.4, 4.4), width_ratios=[1.35, 1], layout="constrained"
    )
    left.plot(TWISTS, torque, color="#0072B2", linewidth=2, label="torque")
    left.plot(TWISTS, elastic, "--", color="#777777", label="all elastic")
    left.axhline(fully_plastic, color="#777777", linestyle=":", label="all plastic")
    left.plot(TWISTS, plastic, color="#D55E00", linewidth=2, label="plastic share of the section")
    left.set(
        xlim=(0, 5), ylim=(0, 3), xlabel="twist α (yield stress ÷ shear modulus and half side)"
    )
    left.set(ylabel="torque, share", title="The bar yields")
    left.legend(loc="center right", bbox_to_anchor=(1, 0.55))
    for twist, color in zip(
        (1.0, 1.5, 2.5, 5.0), ("#E9C46A", "#E69F00", "#D55E00", "#7F2704"), strict=True
    ):
        k = np.argmin(abs(TWISTS - twist))
        right.contour(nodes, nodes, levels[k], levels=[0.0], colors=color, linewidths=2)
        right.plot([], [], color=color, linewidth=2, label=f"α = {twist:g}")
    right.set(
        aspect="equal",
        xlim=(-1, 1),
        ylim=(-1, 1),
        xticks=[-1, 0, 1],
        yticks=[-1, 0, 1],
        xlabel="x",
        ylabel="y",
    )
    right.set_title("The plastic zones grow from the sides")
    right.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    figure.savefig(out / "parameter_study.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
