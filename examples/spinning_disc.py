"""A disc slides and spins on a table: however it starts, both motions end at once, at v / (R ω) = 0.653.

Friction of a disc that spins pulls less against its sliding, and the other way round; so the faster of both motions,
compared with the other, loses more. The disc touches the table at points that carry equal areas. Their pressures would
not be determined, a rigid disc having more than three, so the table yields a little: W = J m⁻¹ Jᵀ + a compliance of the
normals, however small, makes the pressure even. The steps get shorter as the
disc slows down.

The check: the ratio at the end, which Farkas and others derived for even pressure; 75 points come within some 2 %, as
one of them sticks for a moment where the centre of the rotation passes. Pyramids beside it.

Source: Farkas, Bartels, Unger, Wolf, Physical Review Letters 90, 248302, 2003, doi:10.1103/PhysRevLett.90.248302.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer

from lcp_plugin import LCP, FrictionalContact, solve

GRAVITY, MASS, RADIUS, FRICTION = 9.81, 0.5, 0.05, 0.3  # m/s², kg, m, –
RINGS, SHARE, STEPS = 5, 0.25, 40  # of points; of the time that is left, a step; and how many
COMPLIANCE = 1e-3  # of the table, 1/kg: m/s by N s
EXPECTED, STARTS = 0.653, (0.3, 1.0, 3.0)  # v / (R ω) at the end, and at the start


def touching_points() -> np.ndarray:
    """Return points of a disc of radius 1 in rings, each for an equal area, shape (3 RINGS², 2)."""
    points = []
    for ring in range(1, RINGS + 1):
        angle = 2.0 * np.pi * np.arange(6 * ring - 3) / (6 * ring - 3)
        points.append((ring - 0.5) / RINGS * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(points)


def contacts_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return W, the rows J of all contacts and the inertia of the disc, whose velocities are v (3) and ω (3)."""
    inertia = MASS * np.array([1.0, 1.0, 1.0, *(RADIUS**2 * np.array([0.25, 0.25, 0.5]))])
    ways = np.eye(3)[[2, 0, 1]]  # normal, tangents
    arms = np.column_stack([RADIUS * points, np.zeros(len(points))])
    J = np.concatenate([np.concatenate([ways, np.cross(arm, ways)], axis=1) for arm in arms])
    return (
        J / inertia @ J.T + COMPLIANCE * np.diag(np.tile([1.0, 0.0, 0.0], len(points))),
        J,
        inertia,
    )


def impulses_of(W: np.ndarray, free: np.ndarray, edges: int | None) -> np.ndarray:
    """Return the impulses of all contacts, by the cone or by pyramids of so many edges."""
    if edges is None:
        problem = FrictionalContact(W, free, FRICTION, dimension=3)
        return solve(problem, "interior_point").require_solved().z
    problem = LCP.from_contacts(W, FRICTION, free.reshape(-1, 3), directions=edges)
    motion = problem.origin.recover(solve(problem).require_solved())
    return np.column_stack([motion.normal, motion.tangential]).ravel()


def ratios(start: float, edges: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return v / (R ω) and v of each step, by the cone or by pyramids of so many edges."""
    points, velocities, found = (
        touching_points(),
        np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0 / (start * RADIUS)]),
        [],
    )
    for _ in range(STEPS):
        W, J, inertia = contacts_of(points)
        step = SHARE * (np.hypot(*velocities[:2]) + RADIUS * velocities[5]) / (FRICTION * GRAVITY)
        free = velocities - step * GRAVITY * np.eye(6)[2]
        velocities = free + J.T @ impulses_of(W, J @ free, edges) / inertia
        velocities[2:5] = 0.0  # the table springs back
        turn = step * velocities[5]
        points = points @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        found.append(
            [np.hypot(*velocities[:2]) / (RADIUS * velocities[5]), np.hypot(*velocities[:2])]
        )
    ratio, speed = np.transpose(found)
    return ratio, speed


def main(out: Path = Path()) -> None:
    """Stop a disc from four starts, compare the ratios at the end, save a figure into the folder OUT."""
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    ends = []
    for start in STARTS:
        ratio, speed = ratios(start)
        axes.plot(speed, ratio, label=f"begun at {start:g}")
        ends.append(ratio[-1])
    print(
        f"check: at the end v / (R ω) differs from 0.653 by {max(abs(end - EXPECTED) for end in ends):.2g}"
    )
    for edges, style in ((4, ":"), (8, "--")):
        ratio, speed = ratios(1.0, edges)
        axes.plot(speed, ratio, style, color="black", label=f"at 1, pyramids of {edges} edges")
        print(f"pyramids of {edges} edges: {ratio[-1]:.3f}")
    axes.axhline(EXPECTED, color="gray", linewidth=0.8)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="speed of sliding v (m/s)",
        ylabel="v / (R ω)",
        title="A disc that slides and spins stops both at once",
    )
    axes.invert_xaxis()
    axes.legend()
    figure.savefig(out / "spinning_disc.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
