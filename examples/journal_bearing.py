"""The oil film of a journal bearing: where it tears.

A shaft turns off-centre in its bearing and drags oil into the narrowing gap h(θ) = 1 + ε cos θ. Pressure builds up
there and carries the load. Behind the narrowest place the equation alone would ask for suction; oil cannot pull, the
film tears (cavitation), and the pressure is zero:

    p ≥ 0,   −∇·(h³ ∇p) ≥ ε sin θ,   and at every point at least one holds with equality.

For a very long bearing there is a reference that needs no LCP: h³ p' = ε (cos θ − cos θc) up to the angle θc where the
film tears, which is found from p(θc) = 0 by quadrature.

Sources: Cryer, Math. Comp. 25, 1971, doi:10.1090/S0025-5718-1971-0298961-7 (cavitation as complementarity); Moré,
Toraldo, SIAM J. Optim. 1, 1991, doi:10.1137/0801008 (this model).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer
from scipy.integrate import quad
from scipy.optimize import brentq

from lcp_plugin import LCP, solve
from lcp_plugin.evidence.drawing import contact_level

ECCENTRICITY, SIZE = 0.6, 140


def pressure(half_length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return angles in degrees, places along the shaft in radii, and over both the pressure and the contact level."""
    angle = np.linspace(0.0, 2.0 * np.pi, SIZE + 2)
    along = np.linspace(0.0, 2.0 * half_length, SIZE + 2)[1:-1]
    step, depth = angle[1] - angle[0], along[1] - along[0]
    edge = (
        1.0 + ECCENTRICITY * np.cos(0.5 * (angle[1:] + angle[:-1]))
    ) ** 3  # h³ between the nodes
    angle = angle[1:-1]
    diagonals = [-edge[1:-1], edge[1:] + edge[:-1], -edge[1:-1]]
    around = sp.diags_array(diagonals, offsets=[-1, 0, 1])
    across = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(SIZE, SIZE))
    film = sp.diags_array((1.0 + ECCENTRICITY * np.cos(angle)) ** 3)
    M = sp.kron(depth / step * around, sp.eye_array(SIZE)) + sp.kron(step / depth * film, across)
    q = -np.repeat(ECCENTRICITY * np.sin(angle) * step * depth, SIZE)
    result = solve(LCP(M, q)).require_solved()
    print(
        f"length {2 * half_length:.0f} radii: {result.algorithm}, {result.iterations} iterations, "
        f"the film is torn at {np.mean(result.z == 0):.0%} of the nodes"
    )
    level = contact_level(result.certificate)
    return np.degrees(angle), along, result.z.reshape(SIZE, SIZE), level.reshape(SIZE, SIZE)


def very_long() -> tuple[float, np.ndarray]:
    """Return the angle θc in degrees where the film tears, and the pressure at whole degrees up to it."""

    def slope(angle: float, torn: float) -> float:
        return (
            ECCENTRICITY * (np.cos(angle) - np.cos(torn)) / (1 + ECCENTRICITY * np.cos(angle)) ** 3
        )

    torn = brentq(lambda end: quad(slope, 0, end, args=(end,))[0], np.pi * 1.01, np.pi * 1.9)
    degrees = np.arange(np.degrees(torn))
    return np.degrees(torn), np.array(
        [quad(slope, 0, np.radians(angle), args=(torn,))[0] for angle in degrees]
    )


def main(out: Path = Path()) -> None:
    """Solve a short and a long bearing, compare the long one with quadrature, save a figure into the folder OUT."""
    angle, along, film, level = pressure(1.0)
    _, _, long_film, long_level = pressure(10.0)
    middle, low = long_film[:, SIZE // 2], long_level[:, SIZE // 2]
    last = np.flatnonzero(low > 0.0)[-1]  # with pressure; the film is torn from there on
    torn_at = np.interp(0.0, -low[last : last + 2], angle[last : last + 2])
    torn, exact = very_long()
    print(
        f"the long film tears at {torn_at:.1f}°, by quadrature at {torn:.1f}° (step {angle[1] - angle[0]:.1f}°)"
    )
    print(
        f"check: the largest pressure differs from quadrature by {abs(middle.max() / exact.max() - 1):.2%}, "
        f"the place where the film tears by {abs(torn_at - torn):.2f}°"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.8, 4.2), layout="constrained")
    image = left.pcolormesh(along, angle, film, shading="nearest", cmap="cividis", rasterized=True)
    figure.colorbar(image, ax=left, label="pressure").outline.set_visible(False)
    left.contour(along, angle, level, levels=[0.0], colors="#D55E00", linewidths=1.8)
    left.text(1.0, 300, "torn film, p = 0", color="white", ha="center", fontsize=10)
    left.set(xlabel="along the shaft (radii)", ylabel="angle θ (degrees)", yticks=range(0, 361, 90))
    left.set_title("Short bearing, as long as wide")
    left.grid(visible=False)
    right.fill_between(angle, middle, color="#0072B2", alpha=0.15, linewidth=0)
    right.plot(angle, middle, color="#0072B2", linewidth=1.8, label="20 radii long")
    right.plot(
        range(len(exact))[::12],
        exact[::12],
        "o",
        color="#D55E00",
        markerfacecolor="white",
        label="quadrature",
    )
    right.plot(angle, film[:, SIZE // 2], color="#009E73", linestyle="--", label="2 radii long")
    right.set(
        xlim=(0, 360),
        ylim=(0, None),
        xticks=range(0, 361, 90),
        xlabel="angle θ (degrees)",
        ylabel="pressure",
    )
    right.set_title(f"In the middle of the shaft; the long film tears at {torn:.0f}°")
    right.legend(loc="upper right")
    figure.savefig(out / "journal_bearing.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
