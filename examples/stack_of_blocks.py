"""A stable leaning tower of blocks, and an unstable one.

Blocks lie on each other, each shifted a little to the right. Two touching faces press at their outermost points with
forces f ≥ 0, or they part there with a relative acceleration w ≥ 0, never both:

    f ≥ 0,   w = J W⁻¹ Jᵀ f − J g ≥ 0,   fᵀ w = 0,

where J gives the rate at which each gap opens when the blocks rise and turn, W their masses and moments of inertia, and
g the pull of gravity (frictionless, at the first instant). If no gap opens, the tower is stable.

Shifts of 1/2, 1/4, 1/6, … of a block, counted from the top, are the most a tower can bear. The check: while it stands,
the lever rule gives all forces, and a tower that is 15 % bolder must tip over.

Source: Lötstedt, SIAM J. Appl. Math. 42, 1982, doi:10.1137/0142022 (contact as complementarity).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.patches import Rectangle
from matplotlib.transforms import Affine2D

from lcp_plugin import LCP, solve

BLOCKS, WIDTH, HEIGHT, GRAVITY = 6, 1.0, 0.3, 9.81  # –, m, m, m/s²; each block weighs 1 kg
INERTIA = (WIDTH**2 + HEIGHT**2) / 12


def tower(boldness: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of each block and the ends of each touching face, from the ground up; (n,) and (n, 2)."""
    shifts = boldness * WIDTH / (2.0 * np.arange(BLOCKS - 1, 0, -1))
    centre = np.concatenate([[0.0], np.cumsum(shifts)])
    left = centre - WIDTH / 2
    right = np.concatenate([[WIDTH / 2], centre[:-1] + WIDTH / 2])
    return centre, np.column_stack([left, right])


def contact_problem(centre: np.ndarray, ends: np.ndarray) -> tuple[LCP, np.ndarray]:
    """Return the LCP of the contact forces, and J, two rows a face and two columns (up, turn) a block."""
    J = np.zeros((2 * BLOCKS, 2 * BLOCKS))
    for k, face in enumerate(ends):
        for row, point in zip((2 * k, 2 * k + 1), face, strict=True):
            J[row, 2 * k : 2 * k + 2] = 1, point - centre[k]
            if k:
                J[row, 2 * k - 2 : 2 * k] = -1, -(point - centre[k - 1])
    inverse_mass = np.tile([1.0, 1.0 / INERTIA], BLOCKS)
    return LCP(J * inverse_mass @ J.T, J @ np.tile([-GRAVITY, 0.0], BLOCKS)), J


def lever_rule(centre: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the forces at the two ends of each face that carry all that lies above, in N; (n, 2)."""
    above = np.arange(BLOCKS, 0, -1)
    mean = np.array([centre[k:].mean() for k in range(BLOCKS)])
    share = (mean - ends[:, 0]) / (ends[:, 1] - ends[:, 0])
    return (above * GRAVITY)[:, None] * np.column_stack([1 - share, share])


def draw(
    axes: plt.Axes, centre: np.ndarray, ends: np.ndarray, force: np.ndarray, motion: np.ndarray
) -> None:
    """Draw the blocks after an instant of the motion, with a disc at each contact, its area the force."""
    for k, (x, (up, turn)) in enumerate(zip(centre, motion, strict=True)):
        moved = (
            Affine2D().rotate_around(x, (k + 0.5) * HEIGHT, 0.025 * turn).translate(0, 0.025 * up)
        )
        axes.add_patch(
            Rectangle(
                (x - WIDTH / 2, k * HEIGHT),
                WIDTH,
                HEIGHT,
                facecolor="#56B4E9",
                alpha=0.45,
                edgecolor="#0072B2",
                linewidth=1.2,
                transform=moved + axes.transData,
            )
        )
    heights = np.repeat(HEIGHT * np.arange(BLOCKS), 2)
    axes.scatter(
        ends.ravel(), heights, s=4 * force.ravel(), color="#D55E00", edgecolors="white", zorder=3
    )
    axes.axhspan(-0.2, 0, color="#e9e9e9")
    axes.set(
        aspect="equal",
        xlim=(-0.8, 2.2),
        ylim=(-0.2, 2.0),
        xlabel="m",
        ylabel="m",
        yticks=[0, 0.5, 1, 1.5, 2],
    )


def main(out: Path = Path()) -> None:
    """Solve a stable tower and one that tips over, check the forces, save a figure into the folder OUT."""
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, panels = plt.subplots(1, 2, figsize=(9.6, 4.1), layout="compressed")
    for axes, boldness in zip(panels, (0.85, 1.15), strict=True):
        centre, ends = tower(boldness)
        problem, J = contact_problem(centre, ends)
        result = solve(problem, tolerance=1e-12).require_solved()
        force, opening = result.z.reshape(BLOCKS, 2), result.w
        motion = (J.T @ result.z).reshape(BLOCKS, 2) / [1.0, INERTIA] - [GRAVITY, 0.0]
        stands = opening.max() < 1e-8
        print(
            f"{boldness:.2f} times the boldest shifts: {'it stands' if stands else 'it tips over'}; "
            f"fastest gap {opening.max():.2f} m/s², load on the ground {force[0].sum():.2f} N"
        )
        if stands:
            worst = abs(force - lever_rule(centre, ends)).max()
        draw(axes, centre, ends, force, motion)
        axes.set_title(
            f"{boldness:.2f} × the boldest shifts: {'it stands' if stands else 'it tips over'}"
        )
    print(f"check: the forces of the standing tower differ from the lever rule by {worst:.1e} N")
    figure.suptitle(
        "Blue: the blocks an instant later. Orange: the contact forces, as areas", fontsize=10
    )
    figure.savefig(out / "stack_of_blocks.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
