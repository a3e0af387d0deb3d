"""An American put under Heston's model: the price and its variance are the two unknown directions.

The variance v has the mean θ, the speed κ, the volatility ξ and the correlation ρ with the price. In x = log(S/K)

    V ≥ g,   V_τ − ½ v V_xx − (r − ½ v) V_x − ρ ξ v V_xv − ½ ξ² v V_vv − κ (θ − v) V_v + r V ≥ 0,

and at least one holds with equality. At v = 0 the diffusion is zero, and the difference is taken to the inside; at the
largest v, V does not depend on v. An implicit step is an LCP with the same M in every step: `march` performs all.

Published prices are the check: Clarke, Parrott, Applied Mathematical Finance 6, 1999, doi:10.1080/135048699334528.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, march
from lcp_plugin.evidence.drawing import contact_level

STRIKE, RATE, YEARS = 10.0, 0.1, 0.25
KAPPA, THETA, XI, RHO = 5.0, 0.16, 0.9, 0.1
NX, NV, STEPS = 200, 65, 50
SPOTS, VARIANCE = np.array([8.0, 9.0, 10.0, 11.0, 12.0]), 0.0625
PUBLISHED = np.array([2.0000, 1.1076, 0.5200, 0.2137, 0.0820])


def differences(n: int, h: float) -> tuple[sp.lil_array, sp.lil_array]:
    """Return the central first and second differences of n nodes with the distance h."""
    first = sp.diags_array([-0.5, 0.5], offsets=[-1, 1], shape=(n, n)).tolil() / h
    second = sp.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(n, n)).tolil() / h**2
    return first, second


def main(out: Path = Path()) -> None:
    """Price the put, compare with published prices, save a figure into the folder OUT."""
    x, v = np.linspace(-1.5, 1.5, NX + 2), np.linspace(0.0, 1.0, NV)
    hx, hv, dt = x[1] - x[0], v[1] - v[0], YEARS / STEPS
    (x1, x2), (v1, v2) = differences(NX, hx), differences(NV, hv)
    v1[0, :2], v2[0] = [-1 / hv, 1 / hv], 0.0  # v = 0
    v1[NV - 1], v2[NV - 1, NV - 1] = 0.0, -1 / hv**2  # V_v = 0
    Dv, Ix, Iv = sp.diags_array(v), sp.eye_array(NX), sp.eye_array(NV)
    L = sp.kron(0.5 * Dv, x2) + sp.kron(RATE * Iv - 0.5 * Dv, x1) - RATE * sp.eye_array(NX * NV)
    across = 0.5 * XI**2 * Dv @ v2 + KAPPA * (THETA * Iv - Dv) @ v1
    L += sp.kron(across, Ix) + RHO * XI * sp.kron(Dv @ v1, x1)
    payoff = np.tile(np.maximum(STRIKE - STRIKE * np.exp(x[1:-1]), 0.0), NV)
    left = np.zeros((NV, NX))  # the payoff to the left of the grid
    left[:, 0] = (STRIKE - STRIKE * np.exp(x[0])) * (0.5 * v / hx**2 - (RATE - 0.5 * v) / (2 * hx))
    problem = LCP(sp.csr_array(sp.eye_array(NX * NV) - dt * L), np.zeros(NX * NV), lower=payoff)
    forcing = np.tile(-dt * left.ravel(), (STEPS, 1))
    last = march(problem, forcing, propagator=-1.0, z0=payoff, keep="last")[-1].require_solved()
    value = last.z.reshape(NV, NX)
    row = int(np.argmin(abs(v - VARIANCE)))
    prices = np.interp(np.log(SPOTS / STRIKE), x[1:-1], value[row])
    print("prices", prices.round(4))
    print(f"check: published prices differ by at most {abs(prices - PUBLISHED).max():.4f}")

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left_axes, right_axes) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    S = STRIKE * np.exp(x[1:-1])
    shown = (S > 5) & (S < 15)
    field = left_axes.pcolormesh(S[shown], v, value[:, shown], cmap="cividis", shading="gouraud")
    figure.colorbar(field, ax=left_axes, label="value (EUR)")
    level = contact_level(last.certificate).reshape(NV, NX)
    left_axes.contour(S[shown], v, level[:, shown], levels=[0.0], colors="white")
    left_axes.set(xlabel="share (EUR)", ylabel="variance", title="value; exercise left of the line")
    right_axes.plot(S[shown], value[row, shown], color="#0072B2", label=f"v = {VARIANCE}")
    right_axes.plot(SPOTS, PUBLISHED, "o", color="#D55E00", label="published")
    right_axes.plot(
        S[shown], np.maximum(STRIKE - S[shown], 0), "--", color="#999999", label="payoff"
    )
    right_axes.set(xlabel="share (EUR)", ylabel="value (EUR)", title="one variance")
    right_axes.legend()
    figure.savefig(out / "heston.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
