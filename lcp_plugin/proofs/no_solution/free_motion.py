"""Directions that a positive semidefinite matrix does not resist and along which a linear function falls.

A structure that nothing holds: its stiffness P maps a rigid motion d to 0, no contact is in its way, and the load does
work along it. Then ½ xᵀP x + cᵀx falls without end, and no z solves the complementarity problem of P and c.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector
from ...core.kernels.floats import EPSILON
from .linear_constraints import WIDE

NEGLIGIBLE = 1e-11  # of c: what is left of its part along the directions is rounding
TOUCHING = 1e-9  # of the largest movement: an unknown at a bound that moves so little stays there
BITS = (4, 16)  # behind the point of directions that are tried first: ones and zeros, fractions
# Of the terms of P d, on average over its rows; of √(p_ii p_jj) |d_j| in each row: more is data, as a weak spring is.
MEAN_ROUNDING, ROW_ROUNDING = 8.0 * EPSILON, 256.0 * EPSILON
NAMED, NAMED_FROM = 4, 1e-6  # unknowns, and of the largest movement


def falling_directions(
    P: Any,
    null_space: FloatVector,
    c: FloatVector,
    rises: BoolVector,
    falls: BoolVector,
    rows: Any = None,
    is_equality: Any = None,
) -> Iterator[FloatVector]:
    """Yield directions d with P d = 0 to rounding, the signs that bounds ask for and cᵀd < 0; none where there is none.

    Parameters
    ----------
    P : ndarray or CSR array, shape (n, n)
    null_space : ndarray, shape (n, k)
        An orthonormal basis of what P maps to 0.
    c : ndarray, shape (n,)
    rises, falls : arrays of bool, shape (n,)
        Where d ≥ 0 and d ≤ 0 is asked for.
    rows : CSR array, shape (m, n), optional
        rows · d ≤ 0, or = 0 where `is_equality`, is asked for as well.

    Notes
    -----
    The projection of −c onto the cone of these directions is one of them or 0 (Moreau): nonnegative least squares in k
    unknowns. Of its roundings to few bits the one comes first of which P d is smallest.

    Examples
    --------
    >>> springs, anywhere = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.zeros(2, np.bool_)
    >>> line = np.full((2, 1), 0.5**0.5)
    >>> [d.tolist() for d in falling_directions(springs, line, np.array([-3.0, 1.0]), anywhere, anywhere)]
    [[1.0, 1.0]]
    >>> list(falling_directions(springs, line, np.array([3.0, -1.0]), ~anywhere, anywhere))
    []
    """
    from scipy.linalg import LinAlgError, LinAlgWarning
    from scipy.optimize import nnls

    slope = -(null_space.T @ c)
    if not np.linalg.norm(slope) > NEGLIGIBLE * np.linalg.norm(c):
        return
    asked = [-null_space[rises], null_space[falls]]
    if rows is not None and rows.shape[0]:
        along = rows @ null_space
        along[np.abs(along) <= TOUCHING * (abs(rows) @ np.abs(null_space))] = 0.0
        asked += [along, -along[is_equality]]
    normals = np.vstack(asked)
    size = np.abs(normals).max(axis=1, initial=0.0)
    normals = normals[size > TOUCHING * np.abs(null_space).max()]
    if normals.shape[0]:
        try:
            slope = slope - normals.T @ nnls(normals.T, slope)[0]
        except (
            RuntimeError,
            LinAlgError,
            LinAlgWarning,
        ):  # too many steps; before scipy 1.15, dependent columns
            return
    d = null_space @ slope
    largest = float(np.abs(d).max())
    if not largest > NEGLIGIBLE * np.linalg.norm(c):
        return
    d = d / largest
    d[(rises | falls) & (np.abs(d) <= TOUCHING)] = 0.0
    found: list[FloatVector] = [d, *(np.ldexp(np.round(np.ldexp(d, bits)), -bits) for bits in BITS)]
    left = [_left(P, one) for one in found]
    distinct: list[FloatVector] = []
    for k in np.argsort(left, kind="stable").tolist():
        one = found[k]
        has_signs = bool((one[rises] >= 0.0).all() and (one[falls] <= 0.0).all())
        if (
            left[k] <= MEAN_ROUNDING
            and has_signs
            and c @ one < 0.0
            and not _is_among(one, distinct)
        ):
            distinct.append(one)
            yield one


def _left(P: Any, d: FloatVector) -> float:
    """Return Σ_i |(P d)_i| beside Σ_i (|P||d|)_i."""
    terms = float((abs(P) @ np.abs(d)).sum())
    return float(np.abs(P @ d).sum()) / terms if terms > 0.0 else 0.0


def _is_among(d: FloatVector, others: list[FloatVector]) -> bool:
    return any(np.array_equal(d, other) for other in others)


def moved_unknowns(d: Any) -> str:
    """Return which unknowns move along a direction, in words, but for those that hardly move.

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


def is_far_out(P: Any, c: FloatVector, direction: Any, left: Any) -> bool:
    """Return whether a load c has to move what P hardly resists much farther than the softest part that d moves.

    t = Σ_j |c_j d_j| / min_i (Σ_j |p_ij d_j|)² / p_ii, over the rows i that d moves, is how far the softest part gives
    under all of the load; P d stops x = s d at an s ≥ |cᵀd| / Σ_j |d_j left_j|. In any units: stiff parts hide no weak
    spring of a soft one.

    Parameters
    ----------
    P, c, direction
    left : mapping of int to number
        P d where it is not 0.

    Examples
    --------
    >>> springs = np.array([[4.0, -4.0, 0.0], [-4.0, 5.0, -1.0], [0.0, -1.0, 1.0]])
    >>> load = np.array([6.0, 0.0, 0.0])
    >>> is_far_out(springs, load, [1, 1, 1], {2: 1e-10}), is_far_out(springs, load, [1, 1, 1], {2: 1e-7})
    (True, False)
    """
    d = np.array([float(value) for value in direction])
    sizes, diagonal = np.abs(d), P.diagonal()
    rows = np.flatnonzero((sizes > TOUCHING * sizes.max(initial=0.0)) & (diagonal > 0.0))
    with np.errstate(all="ignore"):  # what overflows is not
        stiffness = np.square((abs(P) @ sizes)[rows] / np.sqrt(diagonal[rows])).min(initial=np.inf)
        resisted = sum(abs(float(value)) * sizes[j] for j, value in left.items() if j < d.size)
        return bool(resisted * 2.0 * WIDE * (np.abs(c) @ sizes) <= abs(c @ d) * stiffness)


def is_at_rest(P: Any, direction: Any) -> bool:
    """Return whether P d = 0 to rounding, P not being 0 along d: what P resists elsewhere, it does not along d."""
    d = np.array([float(value) for value in direction])
    moving = np.flatnonzero(d)
    P = sp.csr_array(P)
    if not P[moving].count_nonzero() or _left(P, d) > MEAN_ROUNDING:
        return False
    pattern, root = (
        sp.csr_array((np.ones(P.nnz), P.indices, P.indptr), shape=P.shape),
        np.sqrt(np.abs(P.diagonal())),
    )
    return bool((np.abs(P @ d) <= ROW_ROUNDING * root * (pattern @ (root * np.abs(d)))).all())
