"""A block on a slope that is tilted further and further: it rests, and where tan θ > μ it slides.

The block presses on the slope at its two lower corners, each with an impulse p ≥ 0 along the normal and one of friction
of at most μ p along the slope, against the motion. Both are unknown, as is whether a corner rests, slips or lifts off:
`LCP.from_contacts` states all cases at once, and `origin.recover` says which of them it is.

The check: from rest the block has the speed T g (sin θ − μ cos θ) after a time T where that is positive, and else none.

Source: Stewart, Trinkle, Int. J. Numer. Meth. Eng. 39, 1996 (contact with friction as complementarity, step by step).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import LCP, solve

GRAVITY, MASS, WIDTH, HEIGHT = 9.81, 2.0, 0.3, 0.1  # m/s², kg, m, m
STEP, STEPS = 0.025, 20  # s, –
FRICTIONS = (0.2, 0.4, 0.7)


def speed_after(angle: float, friction: float) -> tuple[float, float]:
    """Return the block's speed after all steps, in m/s, and the share of its weight on the lower corner."""
    # down the slope, away from it, turning
    mass = np.diag([MASS, MASS, MASS * (WIDTH**2 + HEIGHT**2) / 12])
    corners = np.array([[-WIDTH / 2, -HEIGHT / 2], [WIDTH / 2, -HEIGHT / 2]])
    normals = np.column_stack([np.zeros(2), np.ones(2), corners[:, 0]])
    tangents = np.column_stack([np.ones(2), np.zeros(2), -corners[:, 1]])
    pull = STEP * GRAVITY * np.array([np.sin(angle), -np.cos(angle), 0.0])
    velocity, result = np.zeros(3), None
    for _ in range(STEPS):
        problem = LCP.from_contacts((mass, normals, tangents), friction, velocity + pull)
        result = solve(
            problem, z0=None if result is None else result.z, tolerance=1e-12
        ).require_solved()
        motion = problem.origin.recover(result)
        impulse = normals.T @ motion.normal + tangents.T @ motion.tangential[:, 0]
        velocity = velocity + pull + impulse / np.diag(mass)
    return velocity[0], motion.normal[1] / motion.normal.sum()


def main(out: Path = Path()) -> None:
    """Tilt the slope for three coefficients, compare the speeds, save a figure into the folder OUT."""
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.4, 4.2), layout="constrained")
    degrees, worst = np.linspace(0.0, 45.0, 46), 0.0
    for friction, color in zip(FRICTIONS, ("#0072B2", "#D55E00", "#009E73"), strict=True):
        angles = np.radians(degrees)
        found = np.array([speed_after(angle, friction) for angle in angles])
        expected = (
            STEPS * STEP * GRAVITY * np.maximum(np.sin(angles) - friction * np.cos(angles), 0.0)
        )
        worst = max(worst, abs(found[:, 0] - expected).max())
        left.plot(degrees, expected, color=color, linewidth=1.6)
        left.plot(degrees, found[:, 0], "o", color=color, markersize=3)
        left.annotate(
            f"μ = {friction:g}",
            (np.degrees(np.arctan(friction)), 0.0),
            (-2, 8),
            color=color,
            ha="right",
            textcoords="offset points",
        )
        right.plot(degrees, 100 * found[:, 1], color=color, linewidth=1.6)
        slides = degrees[found[:, 0] > 1e-9]
        limit = np.degrees(np.arctan(friction))
        print(f"μ = {friction:g}: it slides from {slides[0]:g}° on, tan θ > μ from {limit:.2f}°")
    print(f"check: the speeds differ from the closed form by {worst:.1e} m/s")
    left.set(
        xlabel="slope (degrees)",
        ylabel=f"speed after {STEPS * STEP:g} s (m/s)",
        title="Lines: closed form. Dots: step by step",
    )
    right.set(
        xlabel="slope (degrees)",
        ylabel="weight on the lower corner (%)",
        title="It leans on what is below",
    )
    figure.savefig(out / "block_on_incline.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
