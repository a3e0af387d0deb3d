"""The cheapest bolts that keep a cover tight: forces for which the contact that they make is closed where needed.

A cover lies on a flange. Pressure lifts it from within, bolts hold it down, and where it does not lift it bears:

    lift ≥ 0,   K lift − pressure + bolts ≥ 0,   and at every point at least one holds with equality.

K is the stiffness of the cover as a beam. At some points, the seals, the flange has to bear with a given force at
least; elsewhere the cover may lift by a millimetre. A bolt costs as much as its force, more where it is hard to reach.
Which pieces of the cover lift is not known beforehand: a linear program with complementarity constraints. Without these
the flange would push where nothing touches it, and the bolts would seem cheaper than any are.

For the bolts found, the contact problem alone is solved again by Lemke's method; and an integer program, one choice a
point, finds the same cost.

Source: Luo, Pang, Ralph, Mathematical Programs with Equilibrium Constraints, Cambridge 1996,
doi:10.1017/CBO9780511983658.
"""

from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer
from scipy.optimize import LinearConstraint, milp

from lcp_plugin import LCP, complements, solve

POINTS = 41
STIFFNESS = 2e4  # kN/m, of the cover as a beam with springs to the flange
PRESSURE = 1.0  # kN a point, between the seals
BEARING = 0.5  # kN: least force at a seal
SEALS = (6, 20, 34)
BOLTS = range(2, POINTS, 4)
LARGEST = 12.0  # kN, of a bolt
MOST = 1.0  # mm, of the lift


def main(out: Path = Path()) -> None:
    """Find the bolts, prove them cheapest, compare, and save a figure into the folder OUT."""
    K = _stiffness()
    pressure = np.where(
        (np.arange(POINTS) >= SEALS[0]) & (np.arange(POINTS) <= SEALS[-1]), PRESSURE, 0.0
    )
    price = 1.0 + 0.8 * np.sin(np.arange(POINTS)) ** 2
    is_bolt = np.isin(np.arange(POINTS), list(BOLTS))

    lift, bolts = cp.Variable(POINTS, nonneg=True), cp.Variable(POINTS, bounds=[0, LARGEST])
    force = K @ lift - pressure + bolts
    contact = complements(lift >= 0, force >= 0)
    limits = [
        lift <= MOST,
        force <= 2 * LARGEST,
        bolts[~is_bolt] == 0,
        force[list(SEALS)] >= BEARING,
    ]
    problem = cp.Problem(cp.Minimize(price @ bolts), [contact, *limits])
    problem.solve(method="LCP")
    result, found, pull = problem.solver_stats.extra_stats, lift.value, bolts.value
    without = cp.Problem(cp.Minimize(price @ bolts), [lift >= 0, force >= 0, *limits]).solve()
    print(f"cost {problem.value:.6f}, {result}; without the condition of contact {without:.3f}")
    print("bolts:", {k: round(float(pull[k]), 3) for k in BOLTS if pull[k] > 1e-9})
    print("all bounds checked again:", result.verify())

    again = solve(LCP(K, pull - pressure), "lemke").require_solved()
    cost = _by_integers(K, pressure, price, is_bolt)
    print(
        f"check: the contact problem alone gives the same lift up to {abs(again.z - found).max():.1e} mm; "
        f"the cost of an integer program differs by {abs(cost - problem.value):.1e}"
    )
    _draw(found, again.w, pull, out)


def _stiffness() -> sp.csr_array:
    """Return the stiffness of a beam with free ends on weak springs, in kN/mm."""
    bend = sp.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(POINTS - 2, POINTS))
    return sp.csr_array(STIFFNESS * 1e-3 * (bend.T @ bend) + 0.05 * sp.eye_array(POINTS))


def _by_integers(
    K: sp.csr_array, pressure: np.ndarray, price: np.ndarray, is_bolt: np.ndarray
) -> float:
    """Return the cost that a mixed-integer program finds, with MOST and 2 LARGEST as bounds of both sides."""
    n, identity, nothing = POINTS, np.eye(POINTS), np.zeros((POINTS, POINTS))
    stiffness = K.toarray()
    least = np.where(np.isin(np.arange(n), SEALS), BEARING, 0.0)
    rows = [
        (np.hstack([stiffness, identity, nothing]), pressure + least, np.full(n, np.inf)),
        (np.hstack([identity, nothing, -MOST * identity]), np.full(n, -np.inf), np.zeros(n)),
        (
            np.hstack([stiffness, identity, 2 * LARGEST * identity]),
            np.full(n, -np.inf),
            pressure + 2 * LARGEST,
        ),
    ]
    found = milp(
        np.concatenate([np.zeros(n), price, np.zeros(n)]),
        integrality=np.repeat([0, 0, 1], n),
        bounds=(
            np.zeros(3 * n),
            np.concatenate([np.full(n, MOST), np.where(is_bolt, LARGEST, 0.0), np.ones(n)]),
        ),
        constraints=[LinearConstraint(*row) for row in rows],
        options={"mip_rel_gap": 1e-9},
    )
    return float(found.fun)


def _draw(lift: np.ndarray, force: np.ndarray, bolts: np.ndarray, out: Path) -> None:
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(9.0, 5.4), sharex=True, layout="constrained"
    )
    points = np.arange(POINTS)
    above.fill_between(points, lift, color="#0072B2", alpha=0.25)
    above.plot(points, lift, color="#0072B2", linewidth=2)
    above.set(ylabel="lift in mm", title="The cover lifts between the seals")
    below.bar(points, force, color="#009E73", label="the flange bears")
    below.bar(points, -bolts, color="#D55E00", label="bolts pull")
    for seal in SEALS:
        below.annotate("seal", (seal, force[seal]), (seal, force[seal] + 0.4), ha="center")
    below.axhline(0, color="#777777", linewidth=0.8)
    below.set(xlabel="point along the cover", ylabel="force in kN")
    below.legend(loc="lower right")
    figure.savefig(out / "cheapest_bolts.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
