"""How wrong each row is beside the numbers that it is made of, in the caller's own units: the guard of the criterion.

A residual relative to one reference may hide a row: in units that M does not have, along a flow, beside a tiny diagonal
entry, or where a nonlinear F flattens. So beside it every row is judged by its own terms T_i = |q_i| + Σ_j |m_ij z_j|.
With v_i the part of w_i that has the wrong sign (|w_i| where z_i is off its bounds), row i is right to s if

- v_i ≤ s T_i, or
- q_i = 0, T_i ≤ 2⁻⁴² |m_ii| ‖z_P‖∞ (d_i for m_ii = 0) and T_i ≤ 2⁻⁴² T_k for a row k that acts (z_k off its bounds,
  or v_k > 0), both in its component P: beside what acts at the answer it is negligible in the unit of z and in that of
  w, as in a far field, and what is left of z there explains it. A q_i says what is asked for in its own unit.
- v_i is no more than underflow makes of it: the distance to the next double of each z_j that is no normal number, times
  |m_ij|, and of each term. No z is nearer.

Its *term residual* is the least such s²: at most the tolerance where it is right to √tolerance. A component is also
right where it is so at another z', with z_i at its bound where the sign of w_i is right there and d_i·distance ≤ |w_i|,
or where row i is wrong and the distance at most 10⁻⁸ of the largest |z_j − z°_j|: as where z* and w* are both 0, which
sweeps approach and do not reach. z' is judged by what it is, and z by how far it is from there, beside the largest
|z_j − z°_j|: that has to be right to √tolerance as well.

No size that is guessed from the data enters: what acts is read from z, and limits, costs or rows that nothing touches
count nowhere. Beside a T_i that is large because its terms cancel, the relative residual has its say.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import FloatVector
from ..kernels.floats import NEGLIGIBLE, NORMAL, TINY
from .criterion import for_each_row, largest_of_components
from .row_residuals import magnitude

if TYPE_CHECKING:
    from ..lcp import LCP

NEAR = 1e-8  # to a bound, beside the largest step from z°; and a row whose term residual is below is right


def term_residuals(problem: LCP, z: FloatVector, w: FloatVector) -> FloatVector:
    """Return how wrong each row is in its own terms, shape (n,): 0 where it is right.

    Parameters
    ----------
    problem : LCP
    z, w : array, shape (n,)
        The point, and its slack.

    Examples
    --------
    >>> from lcp_plugin import LCP
    >>> problem = LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])
    >>> for z in ([2.5, 0.0], [2.5 + 1e-9, 0.0], [2.0, 0.0]):
    ...     print(term_residuals(problem, np.array(z), problem.slack(np.array(z))).round(3))
    [0. 0.]
    [0. 0.]
    [0.012 0.   ]
    """
    here = _beside_own_terms(problem, z, w)
    if not here.any():
        return here
    with np.errstate(all="ignore"):
        moves = for_each_row(
            problem, largest_of_components(problem, np.abs(z - problem.nearest_to_zero))
        )
        moved = _at_bounds(problem, z, w, np.where(here > NEAR, NEAR * moves, 0.0))
        there = _beside_own_terms(problem, moved, problem.slack(moved))
        there = np.fmax(there, np.where(moved == z, 0.0, ((moved - z) / moves) ** 2))
    is_better = largest_of_components(problem, there) < largest_of_components(problem, here)
    return np.where(for_each_row(problem, is_better), there, here)


def _at_bounds(problem: LCP, z: FloatVector, w: FloatVector, near: FloatVector) -> FloatVector:
    """Return z', shape (n,): with z_i at a bound that w_i asks for, or that is as near as that."""
    step = w / problem.residual_scale
    above, below = z - problem.lower, problem.upper - z
    to_lower = (above <= np.maximum(step, near)) & (above <= below)
    to_upper = below <= np.maximum(-step, near)
    return np.where(to_lower, problem.lower, np.where(to_upper, problem.upper, z))


def _beside_own_terms(problem: LCP, z: FloatVector, w: FloatVector) -> FloatVector:
    """Return (v_i / T_i)² of each row, 0 where it is negligible and ∞ where it is no number, shape (n,)."""
    is_low, is_high = z <= problem.lower, z >= problem.upper
    wrong = np.where(is_low, np.where(is_high, 0.0, -w), np.where(is_high, w, np.abs(w)))
    is_wrong = ~(wrong <= 0.0)
    if not is_wrong.any():
        return np.zeros(z.size)
    with np.errstate(all="ignore"):
        whole = z
        terms = magnitude(problem, whole)
        acts = np.where(is_wrong | ~(is_low | is_high), terms, 0.0)
        of_z, of_w = (
            for_each_row(problem, largest_of_components(problem, side))
            for side in (np.abs(z), acts)
        )
        unit = np.where(problem.diagonal != 0.0, np.abs(problem.diagonal), problem.residual_scale)
        counts = (problem.q != 0.0) | ~(terms <= NEGLIGIBLE * np.minimum(unit * of_z, of_w))
        counts &= ~(wrong <= _underflow(problem, whole))
        squares = np.where(is_wrong & counts, (wrong / terms) ** 2, 0.0)
    return np.where(np.isfinite(squares), squares, np.inf)


def _underflow(problem: LCP, whole: FloatVector) -> FloatVector | float:
    """Return what underflow alone makes of each w_i, shape (n,), or 0 where each z_j is 0 or a normal number."""
    sizes = np.abs(whole)
    grid = np.where((sizes > 0.0) & (sizes < NORMAL), TINY, 0.0)
    if not grid.any():
        return 0.0
    absolute: Any = abs(problem.matrix.array)
    margin: FloatVector = absolute @ grid + TINY * (np.diff(problem.matrix.csr.indptr) + 2)
    return margin
