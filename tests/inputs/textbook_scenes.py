"""Test problems of textbooks that only tests use."""

from __future__ import annotations

import numpy as np

from lcp_plugin import LCP
from lcp_plugin.gallery import Scene


def murty(*, n: int = 50, orientation: str = "upper") -> Scene:
    """Murty's triangular matrix, on which pivoting methods can take exponentially many steps.

    Parameters
    ----------
    n
        Number of unknowns, at most 5000: half of the matrix is filled.
    orientation
        On which side of the diagonal the twos stand.

    Notes
    -----
    1 on the diagonal, 2 strictly above (or below) it, q = −1. In the last (first) row the only entry is the
    diagonal one, so that z* = e_n (e_1): there w = 1 − 1 = 0, elsewhere w = 2 − 1 = 1. Triangular with a
    positive diagonal: J is nilpotent, so M is H+ with ρ(J) = 0, yet J is far from normal.

    References
    ----------
    Murty, *Computational complexity of complementary pivot methods*, Math. Programming Study 7, 1978.
    """
    twos = np.full((n, n), 2.0)
    M = np.eye(n) + (np.triu(twos, 1) if orientation == "upper" else np.tril(twos, -1))
    exact = np.zeros(n)
    exact[-1 if orientation == "upper" else 0] = 1.0
    return Scene(problem=LCP(M, np.full(n, -1.0)), exact=exact)


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
