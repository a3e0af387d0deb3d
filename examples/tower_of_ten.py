"""A tower of ten blocks, and how hard one must pull a block to get it out.

Ten equal blocks lie on each other; each face touches the next at its two edges, with friction. Someone pulls the block
in the middle sideways. Pulled a little the tower is at rest; harder, all blocks from there on move together;
harder still, the block slips out between its neighbors. The complementarity problem decides which,
for all twenty contacts at once.

The check: of b blocks from the pulled one on, of mass m and weight G each, nothing moves up to a pull of b μ G; then
all get the acceleration (pull − b μ G) / (b m). If that exceeds the largest friction of the blocks above, the block
alone gets (pull − (2 b − 1) μ G) / m. Each face carries the weight of all that lies above it. The blocks are wide:
narrow ones would tip.

Source: Anitescu, Potra, Nonlinear Dynamics 14, 1997, doi:10.1023/A:1008292328909 (the problem and its solvability).
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.patches import Rectangle

from lcp_plugin import LCP, solve

BLOCKS, PULLED, FRICTION = 10, 5, 0.4  # the ground is below block 0
MASS, WIDTH, HEIGHT, GRAVITY, STEP = 1.0, 1.0, 0.1, 9.81, 0.01  # kg, m, m, m/s², s
MASSES = np.tile([MASS, MASS, MASS * (WIDTH**2 + HEIGHT**2) / 12], BLOCKS)  # sideways, up, turning


def rows_of_contacts() -> tuple[np.ndarray, np.ndarray]:
    """Return normals and tangents, shape (20, 30): at the two edges of each face, from the ground up."""
    normals, tangents = np.zeros((2, 2 * BLOCKS, 3 * BLOCKS))
    for row in range(2 * BLOCKS):
        block, arm = row // 2, (-WIDTH / 2, WIDTH / 2)[row % 2]
        normals[row, 3 * block : 3 * block + 3] = 0, 1, arm
        # the contact lies below the centre
        tangents[row, 3 * block : 3 * block + 3] = (1, 0, HEIGHT / 2)
        if block:
            normals[row, 3 * block - 3 : 3 * block] = 0, -1, -arm
            tangents[row, 3 * block - 3 : 3 * block] = -1, 0, HEIGHT / 2
    return normals, tangents


def pulled(force: float) -> tuple[Any, np.ndarray]:
    """Return impulses and slip of the contacts after one step, and the velocities of the blocks, shape (10, 3)."""
    normals, tangents = rows_of_contacts()
    velocities = np.tile([0.0, -STEP * GRAVITY, 0.0], BLOCKS)
    velocities[3 * PULLED] += STEP * force / MASS
    problem = LCP.from_contacts((np.diag(MASSES), normals, tangents), FRICTION, velocities)
    motion = problem.origin.recover(solve(problem, tolerance=1e-12).require_solved())
    moved = velocities + (normals.T @ motion.normal + tangents.T @ motion.tangential[:, 0]) / MASSES
    return motion, moved.reshape(BLOCKS, 3)


def closed_form(force: float) -> float:
    """Return the speed of the pulled block after one step, in m/s."""
    weight, moving = MASS * GRAVITY, BLOCKS - PULLED
    together = (force - moving * FRICTION * weight) / (moving * MASS)
    alone = (force - (2 * moving - 1) * FRICTION * weight) / MASS
    return STEP * max(0.0, together, alone)


def main(out: Path = Path()) -> None:
    """Pull harder and harder, compare with the closed form, save a figure into the folder OUT."""
    weight, moving = MASS * GRAVITY, BLOCKS - PULLED
    moves, slips_out = moving * FRICTION * weight, 2 * moving * FRICTION * weight
    forces, speeds, worst_load, worst_speed = np.linspace(0.0, 1.4 * slips_out, 29), [], 0.0, 0.0
    for force in forces:
        motion, moved = pulled(force)
        load = motion.normal.reshape(BLOCKS, 2).sum(axis=1) / STEP
        worst_load = max(worst_load, abs(load - weight * np.arange(BLOCKS, 0, -1)).max())
        worst_speed = max(worst_speed, abs(moved[PULLED, 0] - closed_form(force)))
        speeds.append(moved[PULLED, 0])
    print(
        f"the block takes {moving - 1} along from {moves:.2f} N on, and slips out from {slips_out:.2f} N on"
    )
    print(
        f"check: the loads of the faces differ from the weights above them by {worst_load:.1e} N, "
        f"the speeds from the closed form by {worst_speed:.1e} m/s"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10.4, 4.4), width_ratios=[1, 1.2], layout="constrained"
    )
    motion, moved = pulled(1.4 * slips_out)
    for k, (speed, _, _) in enumerate(moved):
        left.add_patch(
            Rectangle(
                (4 * speed - WIDTH / 2, k * HEIGHT),
                WIDTH,
                HEIGHT,
                edgecolor="#0072B2",
                facecolor="#D55E00" if k == PULLED else "#56B4E9",
                alpha=0.6,
            )
        )
    left.set(
        xlim=(-0.9, 1.6),
        ylim=(0.0, 1.1),
        xlabel="m",
        title="Pulled hard: the blocks some instants later",
    )
    right.plot(forces, speeds, "o", color="#D55E00", markersize=4)
    lines = np.linspace(0.0, forces[-1], 400)
    right.plot(lines, [closed_form(force) for force in lines], color="#D55E00", linewidth=1.4)
    for force, what in ((moves, "all above move"), (slips_out, "it slips out")):
        right.axvline(force, color="#0072B2", linestyle=":")
        right.annotate(
            what, (force, right.get_ylim()[1]), (-4, -12), textcoords="offset points", ha="right"
        )
    right.set(
        xlabel="pull (N)", ylabel="speed of that block after 10 ms (m/s)", title="Line: closed form"
    )
    figure.savefig(out / "tower_of_ten.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
