"""Thirty discs are poured into a box and come to rest: a thousand steps in time, with contacts that come and go.

In each step of 10 ms (Moreau, Jean) the bodies that are near each other may touch. Friction is exact: no impulse leaves
its cone, and friction acts against the sliding. Impulses of the step before, kept by the numbers of the two
bodies, begin the next step; a new contact begins with zero.

The check: at rest floor and walls carry the weight, and discs overlap by less than a millionth of their radius.

Source: Jean, Computer Methods in Applied Mechanics and Engineering 177, 1999, doi:10.1016/S0045-7825(98)00383-1.
"""

import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer
from matplotlib.patches import Circle

from lcp_plugin import FrictionalContact, solve

DISCS, RADIUS, MASS, GRAVITY, FRICTION = 30, 0.1, 1.0, 9.81, 0.4  # m, kg, m/s²
STEP, STEPS, HALF, REACH = 0.01, 1000, 0.5, 0.03  # s, of the box and of possible contacts: m
MASSES = np.tile([MASS, MASS, 0.5 * MASS * RADIUS**2], DISCS)  # sideways, up, turning
FILM = (0, 30, 60, 120, 999)  # steps
# a normal, and how far behind the origin it stands
WALLS = ((0.0, 1.0, 0.0), (1.0, 0.0, HALF), (-1.0, 0.0, HALF))
# a disc, another or −1 − a wall, the normal towards the disc, the gap
Contact = tuple[int, int, np.ndarray, float]


def near(at: np.ndarray) -> list[Contact]:
    """Return the contacts that may close within a step or two."""
    found = []
    for i in range(DISCS):
        for wall, (x, y, away) in enumerate(WALLS):
            gap = at[i] @ (x, y) + away - RADIUS
            if gap < REACH:
                found.append((i, -1 - wall, np.array([x, y]), gap))
        for j in range(i):
            apart = at[i] - at[j]
            distance = np.hypot(*apart)
            if distance < 2.0 * RADIUS + REACH:
                found.append((i, j, apart / distance, distance - 2.0 * RADIUS))
    return found


def rows_of(contacts: list[Contact]) -> tuple[sp.csr_array, sp.csr_array]:
    """Return normals and tangents, shape (k, 3 discs), sparse."""
    normals, tangents = (sp.lil_array((len(contacts), 3 * DISCS)) for _ in range(2))
    for row, (i, j, (x, y), _) in enumerate(contacts):
        for body, sign in ((i, 1.0), (j, -1.0)):
            if body >= 0:
                normals[row, 3 * body], normals[row, 3 * body + 1] = sign * x, sign * y
                tangents[row, 3 * body], tangents[row, 3 * body + 1] = -sign * y, sign * x
                tangents[row, 3 * body + 2] = -RADIUS  # both turn against each other
    return sp.csr_array(normals), sp.csr_array(tangents)


def main(out: Path = Path()) -> None:
    """Pour the discs, weigh them at rest, save a film into the folder OUT."""
    place = np.arange(DISCS)
    at = np.column_stack([place % 4 - 1.5, place // 4 + 0.6]) * 2.3 * RADIUS
    at += np.random.default_rng(0).uniform(-0.01, 0.01, at.shape)
    velocities, mass = np.zeros(3 * DISCS), sp.csr_array(sp.diags_array(MASSES))
    kept, film, seconds, unsolved = dict[tuple[int, int], np.ndarray](), {}, [], 0
    for step in range(STEPS):
        if step in FILM:
            film[step] = at.copy()
        contacts = near(at)
        free = velocities - np.tile([0.0, STEP * GRAVITY, 0.0], DISCS)
        gaps = np.array([max(gap, 0.0) for *_, gap in contacts])
        problem = FrictionalContact(
            (mass, *rows_of(contacts)), free, FRICTION, gaps=gaps, time_step=STEP
        )
        start = np.concatenate([kept.get((i, j), np.zeros(2)) for i, j, *_ in contacts])
        began = time.perf_counter()
        result = solve(problem, z0=start)
        seconds.append(time.perf_counter() - began)
        unsolved += not result.is_solved
        kept = {
            (i, j): impulse
            for (i, j, *_), impulse in zip(contacts, result.z.reshape(-1, 2), strict=True)
        }
        velocities = result.motion.body_velocities
        at = at + STEP * velocities.reshape(DISCS, 3)[:, :2]
    lifted = (
        sum(
            float(impulse @ [normal[1], normal[0]])
            for (_, j, normal, _), impulse in zip(contacts, result.z.reshape(-1, 2), strict=True)
            if j < 0
        )
        / STEP
    )
    weight, overlap = DISCS * MASS * GRAVITY, max(-min(gap for *_, gap in near(at)), 0.0)
    print(
        f"{STEPS} steps, {len(contacts)} contacts at the end; {1e3 * np.median(seconds):.1f} ms a step, "
        f"{unsolved} not solved"
    )
    print(
        f"check: floor and walls carry the weight up to {abs(lifted / weight - 1.0):.1e}, "
        f"discs overlap by {overlap / RADIUS:.1e} of their radius"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, axes = plt.subplots(
        1, len(FILM), figsize=(12.0, 4.6), sharey=True, layout="constrained"
    )
    for panel, (number, places) in zip(axes, film.items(), strict=True):
        for k, centre in enumerate(places):
            panel.add_patch(
                Circle(centre, RADIUS, facecolor=plt.get_cmap("viridis")(k / DISCS), alpha=0.8)
            )
        panel.plot([-HALF, -HALF, HALF, HALF], [2.0, 0.0, 0.0, 2.0], color="black", linewidth=1.2)
        panel.set(
            xlim=(-HALF - 0.05, HALF + 0.05),
            ylim=(-0.05, 2.0),
            aspect="equal",
            xticks=[-0.5, 0.5],
            title=f"{number * STEP:.1f} s",
        )
    pushes = np.array([impulse[0] for impulse in kept.values()])
    for (i, j, normal, _), push in zip(contacts, pushes, strict=True):
        end = at[j] if j >= 0 else at[i] - RADIUS * normal
        axes[-1].plot(
            *np.transpose([at[i], end]), color="#D55E00", linewidth=6.0 * push / pushes.max()
        )
    axes[0].set_ylabel("m")
    figure.suptitle("Discs poured into a box; at the end, lines as wide as the contacts press")
    figure.savefig(out / "poured_discs.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
