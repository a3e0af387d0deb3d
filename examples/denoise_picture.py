"""Total-variation denoising of an image: noise is removed, edges are kept.

Given a noisy image f, find the image u that is close to it and has little total variation, that is, few and clear
jumps between neighbors (D u holds all differences between neighboring pixels):

    min ½ ‖u − f‖² + λ ‖D u‖₁.

(This is the anisotropic kind: it adds up jumps between rows and jumps between columns.)

Its dual has one number p for each pair of neighbors, −λ ≤ p ≤ λ, and minimizes ½ ‖Dᵀp − f‖²: an LCP with bounds on
both sides, M = D Dᵀ and q = −D f. Then u = f − Dᵀp, and w = −D u: where two neighbors differ, p is at a bound.

The check needs no reference: every p within its bounds gives a lower bound of the least energy, every u an upper one.

Sources: Rudin, Osher, Fatemi, Physica D 60, 1992, doi:10.1016/0167-2789(92)90242-F; Chambolle, J. Math. Imaging and
Vision 20, 2004, doi:10.1023/B:JMIV.0000011325.36760.1e (the dual).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, solve

SIZE, WEIGHT, NOISE = 96, 0.28, 0.2  # pixels, λ, standard deviation in units of the grey scale


def drawn() -> np.ndarray:
    """Return an image of a disc, a bar, a triangle and a slope, shape (SIZE, SIZE), values in [0, 1]."""
    y, x = np.mgrid[0 : 1 : SIZE * 1j, 0 : 1 : SIZE * 1j]
    picture = np.full((SIZE, SIZE), 0.15)
    picture[(x > 0.55) & (y > 0.1) & (y < 0.45) & (x < 0.92)] = 0.6
    picture[np.hypot(x - 0.3, y - 0.3) < 0.2] = 1.0
    picture[(y > 0.6) & (y < 0.92) & (abs(x - 0.3) < 0.7 * (y - 0.6))] = 0.85
    return np.where((x > 0.6) & (y > 0.6) & (y < 0.9) & (x < 0.92), 0.3 + 2 * (x - 0.6), picture)


def main(out: Path = Path()) -> None:
    """Remove the noise of an image, check the duality gap, and save the figures into the folder OUT."""
    truth = drawn()
    noisy = (truth + NOISE * np.random.default_rng(0).standard_normal(truth.shape)).ravel()
    step = sp.diags_array([-1.0, 1.0], offsets=[0, 1], shape=(SIZE - 1, SIZE))
    D = sp.vstack([sp.kron(step, sp.eye_array(SIZE)), sp.kron(sp.eye_array(SIZE), step)])

    problem = LCP(D @ D.T, -(D @ noisy), lower=-WEIGHT, upper=WEIGHT)
    result = solve(problem, "psor", tolerance=1e-5).require_solved()
    clean = noisy - D.T @ result.z
    print(result.explain())

    above = 0.5 * np.sum((clean - noisy) ** 2) + WEIGHT * abs(D @ clean).sum()
    below = 0.5 * (noisy @ noisy - clean @ clean)
    rms = [np.sqrt(np.mean((picture - truth.ravel()) ** 2)) for picture in (noisy, clean)]
    print(f"distance from the true image: {rms[0]:.3f} with noise, {rms[1]:.3f} without")
    print(
        f"check: the energy {above:.6f} is at most {(above - below) / above:.1e} above the least, relatively"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, panels = plt.subplots(1, 3, figsize=(11.4, 4.2), layout="constrained")
    titles = [
        "True picture",
        f"With noise: rms error {rms[0]:.3f}",
        f"Total variation: rms error {rms[1]:.3f}",
    ]
    for axes, picture, title in zip(panels, (truth, noisy, clean), titles, strict=True):
        axes.imshow(
            picture.reshape(truth.shape), cmap="gray", vmin=-0.2, vmax=1.2, interpolation="nearest"
        )
        axes.set_title(title)
        axes.set_axis_off()
    figure.savefig(out / "denoise_picture.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
