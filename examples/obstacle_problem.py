"""A membrane over a ball, and where it touches.

A membrane is fixed along the edge of a square and stretched over a ball. At contact, its height u equals the
height ψ of the ball, and the ball presses it up; everywhere else it is in balance and −Δu = 0. In one line:

    u ≥ ψ,   −Δu ≥ 0,   and at every point at least one holds with equality.

The edge of the contact set, the free boundary, is not known beforehand. On a grid −Δ becomes the five-point matrix M,
the heights along the edge go into q, and the problem is an LCP with lower = ψ.

For this edge the answer is known: u = −A log(r/2) outside the radius r* with r*² (1 − log(r*/2)) = 1.

Source: Kinderlehrer, Stampacchia, An Introduction to Variational Inequalities and Their Applications, SIAM 2000,
doi:10.1137/1.9780898719451.
"""

from pathlib import Path

import numpy as np
import scipy.sparse as sp
import typer
from scipy.optimize import brentq

from lcp_plugin import LCP, solve

SIZE = 120  # nodes along each side, the edge not counted


def main(out: Path = Path()) -> None:
    """Solve the obstacle problem, compare with the closed form, and save a figure into the folder OUT."""
    nodes = np.linspace(-2, 2, SIZE + 2)
    r = np.hypot(*np.meshgrid(nodes, nodes))
    ball = np.where(r < 0.9, np.sqrt(1 - np.minimum(r, 0.9) ** 2), -1.0)
    contact_radius = brentq(lambda radius: radius**2 * (1 - np.log(radius / 2)) - 1, 0.1, 0.9)
    strength = contact_radius**2 / np.sqrt(1 - contact_radius**2)
    exact = np.where(
        r < contact_radius, ball, -strength * np.log(np.maximum(r, contact_radius) / 2)
    )

    second_difference = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(SIZE, SIZE))
    identity = sp.eye_array(SIZE)
    M = sp.kron(second_difference, identity) + sp.kron(identity, second_difference)
    edge = exact.copy()
    edge[1:-1, 1:-1] = 0.0
    q = -(edge[:-2, 1:-1] + edge[2:, 1:-1] + edge[1:-1, :-2] + edge[1:-1, 2:]).ravel()
    problem = LCP(M, q, lower=ball[1:-1, 1:-1].ravel())

    result = solve(problem, record=True).require_solved()
    print(result.explain())
    touches = result.z == problem.lower  # exactly at the bound, no tolerance needed
    inside = r[1:-1, 1:-1].ravel()
    print(
        f"it touches at {touches.sum()} of {problem.n} nodes, up to the radius {inside[touches].max():.4f}"
    )
    print(
        f"check: free boundary at r* = {contact_radius:.4f}; the heights differ from the closed form by "
        f"{abs(result.z - exact[1:-1, 1:-1].ravel()).max():.1e} (mesh width {nodes[1] - nodes[0]:.3f})"
    )

    axes = result.plot(shape=(SIZE, SIZE))
    axes.set(xlabel="node along x", ylabel="node along y")
    axes.figure.savefig(out / "obstacle_problem.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
