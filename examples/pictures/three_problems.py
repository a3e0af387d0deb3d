"""Draw the figure at the top of the README: a membrane, an exercise boundary and a pile, each solved first.

``python examples/pictures/three_problems.py --out FOLDER`` writes ``three_problems.png`` there.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer
from PIL import Image

from lcp_plugin import LCP, gallery, march, solve
from lcp_plugin.evidence.drawing import contact_level

sys.path.insert(0, str(Path(__file__).parents[1]))
from stack_of_blocks import BLOCKS, GRAVITY, INERTIA, contact_problem, draw, tower


def membrane(axes: plt.Axes) -> None:
    """Draw the surface of a membrane over a ball; where it touches, its color changes."""
    scene = gallery.obstacle_2d(size=120)
    result = solve(scene.problem).require_solved()
    x, y = np.meshgrid(*scene.coordinates, indexing="ij")
    touches = (result.z == scene.problem.lower).reshape(120, 120)
    colors = plt.get_cmap("Blues")(0.25 + 0.6 * (x + y - (x + y).min()) / np.ptp(x + y))
    colors[touches] = plt.get_cmap("Oranges")(0.65)
    height = result.z.reshape(120, 120)
    axes.plot_surface(
        x, y, height, facecolors=colors, rcount=60, ccount=60, linewidth=0, antialiased=False
    )
    axes.set_axis_off()
    axes.set_box_aspect((4, 4, 2.2), zoom=1.2)
    axes.set_title("A membrane over a ball\norange: it touches")


def exercise_boundary(axes: plt.Axes) -> None:
    """Draw where exercising an American put is best, through its year."""
    size, count, rate, volatility = 901, 150, 0.05, 0.3
    x = np.linspace(-1.5, 1.5, size + 2)  # log(price / strike)
    h, spot, payoff = x[1] - x[0], 100.0 * np.exp(x[1:-1]), 100.0 * np.maximum(1 - np.exp(x), 0)
    diffusion, drift = 0.5 * (volatility / h) ** 2, 0.5 * (rate - 0.5 * volatility**2) / h
    below, above = (drift - diffusion) / count, -(drift + diffusion) / count
    diagonals = [below, 1 + rate / count - below - above, above]
    M = sp.diags_array(diagonals, offsets=[-1, 0, 1], shape=(size, size))
    q, lower = np.zeros((count, size)), payoff[1:-1]
    q[:, 0] = below * payoff[0]
    path = march(LCP(M, q[0], lower=lower), q, propagator=-1.0, z0=lower)
    steps = [step.require_solved() for step in path]
    boundary = [100.0]
    for step in steps:  # between two nodes, where the level is 0
        level = contact_level(step.certificate)
        i = int(np.flatnonzero((step.z == lower) & (lower > 0)).max())
        boundary.append(np.interp(0.0, level[i : i + 2], spot[i : i + 2]))
    years = np.linspace(1, 0, count + 1)
    axes.plot(years, boundary, color="#D55E00", linewidth=1.8)
    axes.fill_between(
        years, boundary, 60, color="#D55E00", alpha=0.2, linewidth=0, antialiased=False
    )
    axes.text(0.4, 66, "exercise", color="#D55E00", fontsize=11)
    axes.text(0.2, 92, "wait", color="#0072B2", fontsize=11)
    axes.set(xlim=(0, 1), ylim=(60, 102), xlabel="time (years)", ylabel="price of the share (EUR)")
    axes.set_title("The right to sell at 100 EUR:\nwhen to use it")


def pile(axes: plt.Axes) -> None:
    """Draw a pile that begins to fall, and the forces between its blocks."""
    centre, ends = tower(1.15)
    problem, J = contact_problem(centre, ends)
    result = solve(problem, tolerance=1e-12).require_solved()
    motion = (J.T @ result.z).reshape(BLOCKS, 2) / [1.0, INERTIA] - [GRAVITY, 0.0]
    draw(axes, centre, ends, result.z.reshape(BLOCKS, 2), motion)
    axes.set_title("A pile that leans too far\norange: forces between blocks")


def main(out: Path = Path()) -> None:
    """Solve the three problems and save their figure into the folder OUT."""
    plt.style.use(Path(__file__).parents[1] / "plots.mplstyle")
    figure = plt.figure(figsize=(10.4, 3.5), layout="constrained")
    places = figure.add_gridspec(1, 3, width_ratios=[1.05, 1, 1])
    membrane(figure.add_subplot(places[0], projection="3d"))
    exercise_boundary(figure.add_subplot(places[1]))
    pile(figure.add_subplot(places[2]))
    file = out / "three_problems.png"
    figure.savefig(file, dpi=110)
    with Image.open(file) as picture:  # 128 colors are a third of the bytes
        small = picture.convert("RGB").quantize(128)
    small.save(file, optimize=True)


if __name__ == "__main__":
    typer.run(main)
