"""Pivots with which sweeps that run on all processes at once converge."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..checks import FloatVector
from ..peers.alone import Peers


@np.errstate(all="ignore")
def pivot_weight(rows: Any, peers: Peers, relaxation: float) -> FloatVector:
    """Return what is added to the pivots d_i of a sweep on all processes at once, shape (own,).

    Parameters
    ----------
    rows : CSR array, shape (own, width)
        Of a symmetric matrix; the columns behind the own ones are those of other processes.
    peers : Peers
        Whoever has those; all of them call.
    relaxation : float
        r in (0, 2).

    Notes
    -----
    With σ_i = Σ |m_ij| √(d_i/d_j) over the foreign columns j the weight is ω_i = max(0, (r σ_i − (1 − r/2) d_i)/2).
    No scaling of rows and columns alike changes it. For M symmetric positive definite the splitting 𝓜 has
    𝓜 + 𝓜ᵀ − M = (2/r − 1) D + (2/r) Ω − (the foreign part of M), and that is positive definite, because
    2 |m_ij x_i x_j| ≤ |m_ij| (s x_i² + x_j²/s) with s = √(d_i/d_j). For an H₊-matrix and r ≤ 1 any ω ≥ 0 does.
    """
    own, width = rows.shape
    whole = np.ones(width)
    whole[:own] = diagonal = rows.diagonal()
    peers.fetch(whole)
    coupling = np.sqrt(np.abs(diagonal)) * (abs(rows[:, own:]) @ (1.0 / np.sqrt(np.abs(whole[own:]))))
    weight: FloatVector = np.maximum(0.0, 0.5 * relaxation * coupling - 0.25 * (2.0 - relaxation) * diagonal)
    return np.where(np.isfinite(weight), weight, 0.0)
