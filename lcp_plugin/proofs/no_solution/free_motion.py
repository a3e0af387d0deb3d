"""Zero-energy modes: directions d with P d = 0 to rounding, for example of an unsupported structure."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON
from .linear_constraints import WIDE

TOUCHING = 1e-9  # of the largest movement: an unknown at a bound that moves so little stays there
# Relative to the terms of P d, averaged over its rows; to √(p_ii p_jj) |d_j| in each row. More is data (a weak spring).
MEAN_ROUNDING, ROW_ROUNDING = 8.0 * EPSILON, 256.0 * EPSILON
NAMED, NAMED_FROM = 4, 1e-6  # unknowns, and of the largest movement


def _left(P: Any, d: FloatVector) -> float:
    """Return Σ_i |(P d)_i| / Σ_i (|P||d|)_i."""
    terms = float((abs(P) @ np.abs(d)).sum())
    return float(np.abs(P @ d).sum()) / terms if terms > 0.0 else 0.0


def moved_unknowns(d: Any) -> str:
    """Return a text with the unknowns that move along a direction, except for negligible movements.

    Examples
    --------
    >>> moved_unknowns([0, 1, 1]), moved_unknowns([1, 0] * 6)
    ('unknowns 1, 2', 'unknowns 0, 2, 4, 6, … (6 of 12)')
    >>> moved_unknowns([0, -2])
    'unknown 1'
    """
    sizes = np.abs(np.array([float(value) for value in d]))
    moving = np.flatnonzero(sizes > NAMED_FROM * sizes.max(initial=0.0)).tolist()
    named = ", ".join(map(str, moving[:NAMED]))
    if len(moving) > NAMED:
        return f"unknowns {named}, … ({len(moving)} of {len(d)})"
    return f"unknown{'s' * (len(moving) != 1)} {named}"


def is_minimizer_beyond_radius(P: Any, c: FloatVector, direction: Any, left: Any) -> bool:
    """Return whether a load c moves the zero-energy mode much farther than the softest part of the structure.

    t = Σ_j |c_j d_j| / min_i (Σ_j |p_ij d_j|)² / p_ii, over the rows i that d moves, is how far the softest part gives
    under all of the load; P d stops x = s d at an s ≥ |cᵀd| / Σ_j |d_j left_j|. This is invariant to scaling: stiff
    parts hide no weak spring of a soft one.

    Parameters
    ----------
    P, c, direction
    left : mapping of int to number
        Entries of P d that are not 0.

    Examples
    --------
    >>> springs = np.array([[4.0, -4.0, 0.0], [-4.0, 5.0, -1.0], [0.0, -1.0, 1.0]])
    >>> load = np.array([6.0, 0.0, 0.0])
    >>> is_minimizer_beyond_radius(springs, load, [1, 1, 1], {2: 1e-10})
    True
    >>> is_minimizer_beyond_radius(springs, load, [1, 1, 1], {2: 1e-7})
    False
    """
    d = np.array([float(value) for value in direction])
    sizes, diagonal = np.abs(d), P.diagonal()
    rows = np.flatnonzero((sizes > TOUCHING * sizes.max(initial=0.0)) & (diagonal > 0.0))
    with np.errstate(all="ignore"):  # an overflow counts as no
        stiffness = np.square((abs(P) @ sizes)[rows] / np.sqrt(diagonal[rows])).min(initial=np.inf)
        resisted = sum(abs(float(value)) * sizes[j] for j, value in left.items() if j < d.size)
        return bool(resisted * 2.0 * WIDE * (np.abs(c) @ sizes) <= abs(c @ d) * stiffness)


def is_at_rest(P: Any, direction: Any) -> bool:
    """Return whether P d = 0 to rounding, although P is not 0 for the unknowns of d: a zero-energy mode."""
    d = np.array([float(value) for value in direction])
    moving = np.flatnonzero(d)
    P = sp.csr_array(P)
    if not P[moving].count_nonzero() or _left(P, d) > MEAN_ROUNDING:
        return False
    root = np.sqrt(np.abs(P.diagonal()))
    pattern = sp.csr_array((np.ones(P.nnz), P.indices, P.indptr), shape=P.shape)
    return bool((np.abs(P @ d) <= ROW_ROUNDING * root * (pattern @ (root * np.abs(d)))).all())
