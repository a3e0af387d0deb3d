"""Test problems of textbooks that only tests use."""

from __future__ import annotations

import numpy as np

from lcp_plugin import LCP
from lcp_plugin.gallery import Scene


def scaling_trap() -> Scene:
    """Three unknowns, strictly dominant, yet the unscaled NPSOR(1.7) runs into a limit cycle beside z*.

    Notes
    -----
    z* = (1, 1, 0), w* = (0, 0, 50). min(I, D) − |B| is not an M-matrix, so nothing is promised without
    scaling; with the rows divided by the diagonal every H+-matrix is safe. From the start given here, beside
    z*, NPGS converges slowly (over a thousand sweeps to 1e-10), the scaled NPSOR(1.7) within thirty.
    """
    M = [[110.0, 100.0, 0.0], [0.0, 110.0, 100.0], [-100.0, 0.0, 110.0]]
    return Scene(
        problem=LCP(M, [-210.0, -110.0, 150.0]),
        exact=np.array([1.0, 1.0, 0.0]),
        start=np.array([1.0, 1.0, 0.001]),
    )
