"""Linear programs for HiGHS: slack columns of equations are left out, and their values and multipliers come back."""

import subprocess
import sys

import numpy as np

from lcp_plugin.engines.linear_program import highs

FULL_ROWS_AND_A_BAND = """
import numpy as np, scipy.sparse as sp
from lcp_plugin import LCP, solve
band = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(400, 400))
q = -np.sin(9.0 * np.linspace(0.0, 1.0, 400))
print(solve(LCP(-(sp.eye_array(400) + 0.01 * band).tocsr(), q)).status.name)
"""


def test_a_proof_with_full_rows_next_to_a_band_does_not_end_the_process():
    command = [sys.executable, "-c", FULL_ROWS_AND_A_BAND]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "INFEASIBLE")


def test_equations_with_slacks_alone_are_infeasible():
    """Two equations v = −1 with v ≥ 0."""
    none = np.zeros((0, 2)), np.zeros(0)
    found = highs(np.zeros(2), *none, np.eye(2), -np.ones(2), (np.zeros(2), np.full(2, np.inf)))
    assert found.status == 2
