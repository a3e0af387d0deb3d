"""The load that makes a membrane touch the floor where wanted: in a heart, and nowhere else.

A membrane is fixed along the edge of a square, a load p ≥ 0 presses it down, and a floor lies beneath it:

    u ≥ −1,   s = p − Δu ≥ 0,   and at every point at least one holds with equality.

s is the pressure on the floor where the membrane touches, and zero elsewhere. What is wanted is u = −1 and s = S inside
a heart and s = 0 outside; how far a load is from it, is

    L(p) = ½ ∫_heart (u + 1)² + ½ β ∫ (s − S · heart)².

There are as many unknowns as nodes, 40 000. One adjoint, a linear solve on the nodes that do not touch, gives the
gradient by all of them, at about the cost of the solve, and scipy's L-BFGS-B goes downhill from no load at all. The
check: a difference of L in a random direction.

Source: Mignot, J. Funct. Anal. 22, 1976, doi:10.1016/0022-1236(76)90017-3 (the derivative of an obstacle problem).
"""

import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer
from scipy.optimize import minimize

from lcp_plugin import LCP, Certificate, derivative, prepare
from lcp_plugin.evidence.drawing import contact_level

SIZE, EVALUATIONS = 200, 24  # nodes along each side; solves, each with its gradient
FLOOR, PRESSURE, BETA = -1.0, 5.0, 1e-6


class Membrane:
    """How far a load is from touching in the heart, with the gradient."""

    def __init__(self) -> None:
        self.nodes = np.linspace(-1, 1, SIZE + 2)[1:-1]
        self.area = (self.nodes[1] - self.nodes[0]) ** 2
        x, y = np.meshgrid(1.9 * self.nodes, 1.9 * self.nodes + 0.15)
        self.heart = ((x**2 + y**2 - 1) ** 3 < x**2 * y**3).ravel()
        second_difference = sp.diags_array(
            [-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(SIZE, SIZE)
        )
        M = sp.kron(second_difference, sp.eye_array(SIZE)) + sp.kron(
            sp.eye_array(SIZE), second_difference
        )
        self.step = prepare(LCP(M, np.zeros(SIZE**2), lower=FLOOR))
        self.height, self.history, self.seconds = None, [], [0.0, 0.0]

    def __call__(self, load: np.ndarray) -> tuple[float, np.ndarray]:
        """Return L and its gradient by the load at each node, over the area of a node."""
        began = time.perf_counter()
        result = self.step.solve(q=self.area * load, z0=self.height).require_solved()
        solved = time.perf_counter()
        at = derivative(result)
        self.height = at.z
        gap = self.heart * (at.z - FLOOR)
        surplus = np.where(at.z > FLOOR, 0.0, result.w / self.area) - PRESSURE * self.heart
        loss = 0.5 * (gap @ gap + BETA * (surplus @ surplus))
        gradient = self.area * at.vjp(gap, BETA * surplus / self.area).q
        self.seconds[0] += solved - began
        self.seconds[1] += time.perf_counter() - solved
        self.history.append(self.area * loss)
        return loss, gradient


def relative_difference(membrane: Membrane) -> float:
    """Return how far the gradient is from a central difference in a random direction, relatively."""
    rng = np.random.default_rng(0)
    load, direction = np.full(SIZE**2, 8.0), rng.standard_normal(SIZE**2)
    step = 1e-4
    slope = membrane(load)[1] @ direction
    return abs(
        (membrane(load + step * direction)[0] - membrane(load - step * direction)[0])
        / (2 * step)
        / slope
        - 1
    )


def main(out: Path = Path()) -> None:
    """Find the load, compare a gradient with a difference, save a figure into the folder OUT."""
    error = relative_difference(Membrane())
    membrane = Membrane()
    limits = {"maxfun": EVALUATIONS, "maxiter": EVALUATIONS, "maxcor": 20, "gtol": 0.0, "ftol": 0.0}
    load = minimize(
        membrane,
        np.zeros(SIZE**2),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0, None)] * SIZE**2,
        options=limits,
    ).x
    membrane(load)
    forward, backward = membrane.seconds
    touches, heart = membrane.height == FLOOR, membrane.heart
    print(
        f"{len(membrane.history)} solves with {load.size} unknowns: {forward:.1f} s, and gradients {backward:.1f} s; "
        f"L falls from {membrane.history[0]:.1e} to {membrane.history[-1]:.1e}"
    )
    print(
        f"it touches at {touches[heart].mean():.1%} of the heart's nodes, and at {touches[~heart].sum()} others; "
        f"{membrane.step.problem.n - touches.sum()} nodes are free"
    )
    print(
        f"check: in a random direction the gradient differs from a difference by {error:.1e}, relatively"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.9), layout="constrained")
    nodes, shape = membrane.nodes, (SIZE, SIZE)
    for axes, field, colors, title, top in (
        (left, membrane.height, "cividis", "Height of the membrane", 0.0),
        (middle, load, "magma", "The load that was found", np.percentile(load, 99.5)),
    ):
        image = axes.imshow(
            field.reshape(shape), origin="lower", extent=(-1, 1, -1, 1), cmap=colors, vmax=top
        )
        figure.colorbar(image, ax=axes, pad=0.02)
        axes.set(title=title, xticks=[-1, 0, 1], yticks=[-1, 0, 1], xlabel="x", ylabel="y")
        axes.grid(visible=False)
    left.contour(nodes, nodes, heart.reshape(shape), levels=[0.5], colors="white", linewidths=1)
    answer = Certificate.of(membrane.step.problem.with_q(membrane.area * load), membrane.height)
    level = contact_level(answer).reshape(shape)
    left.contour(nodes, nodes, level, levels=[0.0], colors="#D55E00", linewidths=2)
    left.text(0, 0, "touches", color="#D55E00", ha="center", fontsize=11)
    left.text(0, 0.72, "wanted", color="white", ha="center", fontsize=9)
    right.semilogy(membrane.history, ".-", color="#0072B2", linewidth=1.5)
    right.set(
        title="How far it is from what is wanted",
        xlabel="solves, each with its gradient",
        ylabel="L",
    )
    figure.savefig(out / "designed_contact.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
