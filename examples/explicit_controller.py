"""A controller as a table: what a cart does next, computed once for every state.

A cart has a position and a speed, |each| ≤ 5; a motor changes the speed by at most 1 a second. Model predictive control
asks in each state for the cheapest forces of the next five seconds, a quadratic program in which only the right-hand
sides depend on the state x:

    minimise Σ ‖x_k‖² + u_k²/10,   |u_k| ≤ 1,   |x_k| ≤ 5.

Its solution is piecewise affine in x. `regions` gives all pieces, so that the controller on board looks its law up and
solves nothing. Each step here is compared with daqp's answer to the program in that state.

Source: Bemporad, Morari, Dua, Pistikopoulos, Automatica 38, 2002, doi:10.1016/S0005-1098(01)00174-1.
"""

import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer
from scipy.linalg import solve_discrete_are

from lcp_plugin import QuadraticProgram, regions, solve
from lcp_plugin.evidence.drawing import STYLE

A, B, HORIZON, ROOM = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.5], [1.0]]), 5, 5.0


def controller() -> tuple[QuadraticProgram, dict[str, np.ndarray]]:
    """Return the program in the five forces at x = 0, and how its vectors depend on x."""
    cost = np.eye(2 * HORIZON)
    cost[-2:, -2:] = solve_discrete_are(A, B, np.eye(2), 0.1 * np.eye(1))  # of all later steps
    powers = [np.linalg.matrix_power(A, k) for k in range(HORIZON + 1)]
    free = np.vstack(powers[1:])
    forced = np.block(
        [
            [powers[i - j] @ B if j <= i else np.zeros((2, 1)) for j in range(HORIZON)]
            for i in range(HORIZON)
        ]
    )
    P = forced.T @ cost @ forced + 0.1 * np.eye(HORIZON)
    program = QuadraticProgram(
        (P + P.T) / 2,
        np.zeros(HORIZON),
        G=np.vstack([forced, -forced]),
        h=np.full(4 * HORIZON, ROOM),
        lower=-1.0,
        upper=1.0,
    )
    return program, {"c": forced.T @ cost @ free, "h": np.vstack([-free, free])}


def main(out: Path = Path()) -> None:
    """Find all regions, drive some carts home by the table, and save a picture into the folder OUT."""
    program, depends = controller()
    table = regions(program, depends, ([-ROOM, -ROOM], [ROOM, ROOM]))
    print(table.explain())

    carts, worst = [], 0.0
    for start in ([-4.5, 2.5], [4.5, -1.0], [-3.0, -1.5], [2.0, 2.0]):
        states = [np.array(start)]
        for _ in range(12):
            force = table.x_at(states[-1])[0]
            worst = max(
                worst, abs(force - solve(table.at(states[-1]), "daqp").require_solved().x[0])
            )
            states.append(A @ states[-1] + B[:, 0] * force)
        carts.append(np.array(states))
    many = np.random.default_rng(0).uniform(-ROOM, ROOM, (3600, 2))
    table.x_at(many[:10])
    began = time.perf_counter()
    law = table.x_at(many)
    print(
        f"{len(many)} states, of which {np.isfinite(law[:, 0]).mean():.0%} can be held: "
        f"{(time.perf_counter() - began) / len(many) * 1e6:.1f} µs each"
    )
    print(f"check: along four drives the forces differ from daqp's by {worst:.1e}")

    plt.style.use(STYLE)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.2, 4.2), layout="constrained")
    table.plot(axes=left)
    for states in carts:
        left.plot(*states.T, "o-", color="#D55E00", markersize=3, linewidth=1.2)
        right.step(range(12), table.x_at(states[:-1])[:, 0], where="post", linewidth=1.6)
    left.set(
        xlabel="position",
        ylabel="speed",
        title=f"{len(table)} regions, coloured by the next force; four drives",
    )
    right.set(xlabel="second", ylabel="force", title="What the motor does", ylim=(-1.1, 1.1))
    figure.savefig(out / "explicit_controller.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
