"""A block slides down a slope exactly along gravity, whichever way the slope falls; with pyramids it drifts aside.

Coulomb's friction acts against the velocity. If its cone is replaced by a pyramid of m edges, it acts against the
nearest edges, so that a block on a slope whose fall lies between two edges leaves the line of steepest descent.
`FrictionalContact` takes the exact cone; `LCP.from_contacts` takes pyramids.

The check: the block slides along gravity with T g (sin θ − μ cos θ).

Source: De Saxcé, Feng, Mathematical and Computer Modelling 28, 1998 (friction as a complementarity over cones).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import LCP, FrictionalContact, solve

GRAVITY, MASS, SLOPE, FRICTION, STEP = 9.81, 2.0, np.radians(25.0), 0.4, 0.01  # m/s², kg, –, –, s
EDGES = {4: "#0072B2", 8: "#D55E00", 16: "#009E73"}


def pull(direction: float) -> np.ndarray:
    """Return the change by gravity in a step of the velocities along normal and tangents, in m/s."""
    along = np.sin(SLOPE) * np.array([np.cos(direction), np.sin(direction)])
    return STEP * GRAVITY * np.array([-np.cos(SLOPE), *along])


def drift(slip: np.ndarray, direction: float) -> float:
    """Return by how many degrees a velocity turns away from gravity."""
    across = slip @ [-np.sin(direction), np.cos(direction)]
    return float(np.degrees(np.arctan2(across, slip @ [np.cos(direction), np.sin(direction)])))


def main(out: Path = Path()) -> None:
    """Turn the slope through a half circle, compare directions and speeds, save a figure into the folder OUT."""
    W, directions = np.eye(3) / MASS, np.radians(np.linspace(0.0, 180.0, 181))
    expected = STEP * GRAVITY * (np.sin(SLOPE) - FRICTION * np.cos(SLOPE))
    exact = [
        solve(FrictionalContact(W, pull(one), FRICTION), tolerance=1e-12).require_solved()
        for one in directions
    ]
    slips = np.array([one.motion.slip[0] for one in exact])
    aside = np.array([drift(slip, one) for slip, one in zip(slips, directions, strict=True)])
    speeds = np.linalg.norm(slips, axis=1)
    print(
        f"check: with the cone it slides at most {abs(aside).max():.1e}° aside, and its speed is off by "
        f"{abs(speeds - expected).max():.1e} m/s"
    )
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.4, 4.2), layout="constrained")
    for edges, color in EDGES.items():
        found = []
        for one in directions:
            problem = LCP.from_contacts(W, FRICTION, pull(one)[None], directions=edges)
            found.append(
                problem.origin.recover(solve(problem, tolerance=1e-12).require_solved()).slip[0]
            )
        off = [drift(slip, one) for slip, one in zip(found, directions, strict=True)]
        left.plot(np.degrees(directions), off, color=color, label=f"pyramid of {edges} edges")
        right.plot(np.degrees(directions), np.linalg.norm(found, axis=1) / expected, color=color)
        print(
            f"pyramid of {edges} edges: up to {max(map(abs, off)):.2g}° aside, "
            f"speeds {np.linalg.norm(found, axis=1).max() / expected - 1.0:+.1%} at the most"
        )
    left.plot(np.degrees(directions), aside, color="black", label="cone")
    right.plot(np.degrees(directions), speeds / expected, color="black")
    left.set(
        xlabel="direction of the fall (degrees)",
        ylabel="drift from gravity (degrees)",
        title="Which way it slides",
    )
    right.set(
        xlabel="direction of the fall (degrees)", ylabel="speed ÷ closed form", title="How fast"
    )
    left.legend()
    figure.savefig(out / "sliding_along_gravity.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
