"""Which algorithm for your own problem? Error against time.

Put your M, q and bounds into `my_problem`; the rest is unchanged. Every algorithm runs on the same data, the clock
stops while the error is measured, and excludes compilation. `error_against_time(problem)` is a shorter call. The axis
names the error: a proved bound of ‖z − z*‖∞ where M allows one (as here, an H₊-matrix), else the relative residual.

Here: a heated plate that loses heat to its surroundings and is carried through a cooler, so that M is not symmetric:

    T ≤ T_max,   −Δ T + v ∂T/∂x + c T ≤ f,   and at every point at least one holds with equality:

a thermostat takes the heat away where the plate would become hotter than T_max. As M is not symmetric, T is not
the least of an energy. The check at the end is a linear solve: with the hottest points known, T solves a linear system.

Source: Duvaut, Lions, Inequalities in Mechanics and Physics, Springer 1976, doi:10.1007/978-3-642-66165-5.
"""

from pathlib import Path

import numpy as np
import scipy.sparse as sp
import typer
from scipy.sparse.linalg import spsolve

from lcp_plugin import LCP, solve, study

SIZE, SPEED, LOSS, HOTTEST = 48, 20.0, 5.0, 0.6


def my_problem() -> LCP:
    """Return the problem to examine: (M, q) and bounds."""
    h = 1 / (SIZE + 1)
    x = np.linspace(h, 1 - h, SIZE)
    heat = 60 * np.exp(-30 * ((x - 0.3) ** 2 + (x[:, None] - 0.5) ** 2)) + 15
    spread = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(SIZE, SIZE))
    carried = SPEED * h * sp.diags_array([-1.0, 1.0], offsets=[-1, 0], shape=(SIZE, SIZE))
    one = sp.eye_array(SIZE)
    M = sp.kron(one, spread + carried) + sp.kron(spread, one) + LOSS * h**2 * sp.eye_array(SIZE**2)
    return LCP(M, -(h**2) * heat.ravel(), lower=-np.inf, upper=HOTTEST)


def main(out: Path = Path()) -> None:
    """Run several algorithms, print the table, and save the curves into the folder OUT."""
    problem = my_problem()
    algorithms = ["npgs", "npsor", "pgs", "psor", "gfp", "newton", "multigrid", "auto"]
    found = study({"heated plate in a flow": problem}, algorithms, repeats=2, tolerance=1e-10)
    print(found)
    fastest = min(
        (row for row in found.rows if row.is_solved and row.is_curve), key=lambda row: row.seconds
    )
    print(f"fastest here: {fastest.method}, {fastest.seconds:.3g} s")

    z = solve(problem, fastest.method, tolerance=1e-10).require_solved().z
    warm = np.flatnonzero(z < HOTTEST)
    hot = np.where(z < HOTTEST, 0.0, HOTTEST)
    second = spsolve(problem.csr[warm][:, warm].tocsc(), -(problem.slack(hot))[warm])
    apart = abs(z[warm] - second).max()
    print(
        f"check: with the same {problem.n - warm.size} hottest points a linear solve differs by {apart:.1e}"
    )
    found.save(out / "error_against_time.png")


if __name__ == "__main__":
    typer.run(main)
