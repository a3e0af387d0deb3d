"""A heap that heats itself, beyond the point where it would catch fire, and the cooling that keeps it safe.

In a square heap of organic material the temperature u above that of its walls obeys −Δu = λ eᵘ: reactions heat it, and
faster where it is hot. Above λ ≈ 6.808 no such u exists, the heap burns. A cooling that switches on where u reaches a
limit takes away as much heat as it must:

    u ≤ limit  with  −Δu − λ eᵘ ≤ 0,       and where u < limit nothing is taken: −Δu = λ eᵘ,

an obstacle problem with a nonlinear source, stated in cvxpy on a grid. Between two walls (in one dimension) the
distance from the wall to the cooled middle is an integral: from (u′)² = 2 λ (e^limit − eᵘ) it is

    s = ∫₀^limit du / √(2 λ (e^limit − eᵘ)) = √2 artanh √(1 − e^−limit) / √(λ e^limit).

Sources: Frank-Kamenetskii, Diffusion and Heat Transfer in Chemical Kinetics, Plenum 1969; Bratu's problem.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, Certificate, box, complements
from lcp_plugin.evidence.drawing import contact_level

HEAT, LIMIT, SIZE = 12.0, 1.2, 99


def main(out: Path = Path()) -> None:
    """Find the temperatures and what is cooled, check a slab, and save a figure into the folder OUT."""
    n = 2001  # between two walls first
    slab = heap(laplacian(n) * (n + 1.0) ** 2)[0]
    hot = np.flatnonzero(slab >= LIMIT)
    curve = np.arange(hot[0] - 40, hot[0])  # the contact is smooth: √(limit − u) is straight there
    slope, offset = np.polyfit((curve + 1) / (n + 1), np.sqrt(LIMIT - slab[curve]), 1)
    exact = np.sqrt(2) * np.arctanh(np.sqrt(1 - np.exp(-LIMIT))) / np.sqrt(HEAT * np.exp(LIMIT))
    print(
        f"check: the cooled part of a slab begins at {-offset / slope:.4f} of its width, which differs from the "
        f"integral by {abs(-offset / slope - exact):.1e}"
    )

    line, eye = laplacian(SIZE), sp.eye_array(SIZE)
    A, x = (
        (sp.kron(line, eye) + sp.kron(eye, line)) * (SIZE + 1.0) ** 2,
        np.arange(1, SIZE + 1) / (SIZE + 1),
    )
    u, cooled, story = heap(A)
    print(story)
    print(
        f"cooling takes away {cooled.sum() / (HEAT * np.exp(u)).sum():.0%} of the heat, from "
        f"{np.mean(u >= LIMIT):.0%} of the area"
    )

    # the heat as it is at the answer
    frozen = LCP(A, -HEAT * np.exp(u), lower=-np.inf, upper=np.full(u.size, LIMIT))
    level = contact_level(Certificate.of(frozen, u)).reshape(SIZE, SIZE)
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 4.1), layout="constrained")
    for axes, values, title in (
        (left, u, "Temperature"),
        (right, cooled, "Heat that is taken away"),
    ):
        picture = axes.pcolormesh(
            x, x, values.reshape(SIZE, SIZE), cmap="cividis", shading="nearest", rasterized=True
        )
        figure.colorbar(picture, ax=axes, shrink=0.85).outline.set_visible(False)
        axes.contour(x, x, level, levels=[0.0], colors="white", linewidths=1.2)
        axes.set(title=title, aspect="equal", xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
        axes.grid(visible=False)
    figure.savefig(out / "self_heating.png", dpi=150)


def laplacian(n: int) -> sp.csr_array:
    """Return tridiag(−1, 2, −1)."""
    return sp.csr_array(
        sp.diags_array([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    )


def heap(A: sp.csr_array) -> tuple[np.ndarray, np.ndarray, object]:
    """Return the temperatures, the heat that cooling takes away, and how they were found."""
    u = cp.Variable(A.shape[0])
    pair = complements(box(u, -np.inf, LIMIT), A @ u - HEAT * cp.exp(u))
    problem = cp.Problem(cp.Minimize(0), [pair])
    u.value = np.zeros(u.size)
    problem.solve(method="LCP")
    return u.value, -pair.dual_value, problem.solver_stats.extra_stats


if __name__ == "__main__":
    typer.run(main)
