"""Linear programs for HiGHS: slack columns of equations are left out, and their values and multipliers come back."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import linprog

from lcp_plugin.engines.linear_program import highs

FULL_ROWS_AND_A_BAND = """
import numpy as np, scipy.sparse as sp
from lcp_plugin import LCP, solve
band = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(400, 400))
q = -np.sin(9.0 * np.linspace(0.0, 1.0, 400))
print(solve(LCP(-(sp.eye_array(400) + 0.01 * band).tocsr(), q)).status.name)
"""


@pytest.mark.parametrize("seed", range(8))
def test_a_linear_program_with_slack_columns_has_the_value_and_multipliers_of_linprog(seed):
    rng = np.random.default_rng(seed)
    E, R = rng.integers(-3, 4, (5, 4)), rng.integers(0, 4, (2, 4))
    signs = np.diag(rng.choice([-2.0, 1.0], 5))[:, : 3 + seed % 3]  # some equations have no slack
    v = np.append(rng.integers(0, 3, 4), rng.integers(0, 3, signs.shape[1]))
    equations, rows = np.hstack([E, signs]), np.hstack([R, np.zeros((2, signs.shape[1]))])
    cost = np.append(rng.integers(-3, 4, 4), np.zeros(signs.shape[1])).astype(float)
    bounds = np.zeros(v.size), np.append(np.full(4, 9.0), np.full(signs.shape[1], np.inf))
    right, limits = equations @ v, rows @ v + 1.0
    found = highs(cost, rows, limits, equations, right, bounds)
    known = linprog(cost, rows, limits, equations, right, np.stack(bounds, axis=1), method="highs")
    y, multipliers = -found.ineqlin.marginals, -found.eqlin.marginals
    reduced = cost + y @ rows + multipliers @ equations
    assert found.fun == pytest.approx(known.fun, abs=1e-9)
    assert np.abs(equations @ found.x - right).max() < 1e-9
    assert min((limits - rows @ found.x).min(), y.min(), found.x.min()) > -1e-9
    dual = -limits @ y - right @ multipliers + np.minimum(reduced[:4], 0.0) @ bounds[1][:4]
    assert reduced[4:].min() > -1e-9
    assert dual == pytest.approx(known.fun, abs=1e-9)


def test_a_proof_with_full_rows_next_to_a_band_does_not_end_the_process():
    command = [sys.executable, "-c", FULL_ROWS_AND_A_BAND]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "INFEASIBLE")


def test_equations_with_slacks_alone_are_infeasible():
    """Two equations v = −1 with v ≥ 0."""
    none = np.zeros((0, 2)), np.zeros(0)
    found = highs(np.zeros(2), *none, np.eye(2), -np.ones(2), (np.zeros(2), np.full(2, np.inf)))
    assert found.status == 2
