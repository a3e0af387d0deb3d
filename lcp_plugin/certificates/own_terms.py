"""Rows judged in their own terms: what one size of z hides where unknowns have different units.

The relative residual compares r_i with one number for all unknowns that hang together: what is wrong with one of 10⁻⁴
vanishes in it beside one of 10⁶. So every row is judged by itself as well. Row i is made of T_i = (|M||z| + |q|)_i;
v_i is |w_i| where z_i is not at the bound that goes with this sign of w_i, and else 0. The *term residual* of a row is
the least s for which

- v_i ≤ s^(3/4) T_i, 1e-6 T_i at a tolerance of 1e-8: so near z is the solution of a problem that is so near, or
- z_i is no farther than √s |z_i| from the bound where w_i has the right sign, or
- |r̂_i| ≤ s max_k |r̂_k(z°)|, k in its part, r̂ the residuals in units of the unknowns in which D⁻¹M is balanced.

The first two are the same in all units of rows and unknowns. The third excuses far fields, where all terms of a row
are nothing beside the part's: in units that are alike it is what the relative residual asks for anyway, so that nothing
else is asked of such problems, and in others it does not depend on the unknowns' units.

Not seen are units that change by less than 2¹⁰ from each unknown to those it is coupled with, and, where the diagonal
has zeros as that of KKT forms, many others: of 4456 such forms in units 2^±20 auto called 28 wrong ones SOLVED. A
symmetric M whose diagonal spans more than 2²⁰ counts as one in other units, though it may be stiff: there a sweep takes
many more steps, until the stiff part is right in its own terms.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..checks import FloatVector
from ..matrix.equilibration import Units, has_even_entries, units_of_unknowns
from ..matrix.structure import IntVector
from ..problem.lcp import LCP
from .references import for_each_row, largest_of_parts
from .row_residuals import BLOCK, over, scaled_residual


def term_residual(problem: LCP, z: FloatVector, w: FloatVector, enough: float = 0.0, least: float = 0.0) -> float:
    """Return the largest term residual of all rows; 0 where units are alike, and where rows are spread over ranks.

    Parameters
    ----------
    z, w : array, shape (n,)
    enough : float
        No row is looked at closely that has no larger one: 0 is returned where none has.
    least : float
        Rows with |r_i| ≤ enough · least have none.

    Examples
    --------
    >>> problem = LCP([[2, 1e-10], [1, 2e-10]], [-3, -3])  # z = (1, 1e10)
    >>> for z in (np.array([0.5, 1e10]), np.array([1.0, 1e10])):
    ...     w = problem.slack(z)
    ...     print(f"{np.abs(w / problem.diagonal).max() / 1.5e10:.0e} {term_residual(problem, z, w):.0e}")
    2e-01 1e-01
    0e+00 0e+00
    """
    matrix = problem.matrix
    if problem.is_distributed or has_even_entries(matrix):
        return 0.0
    with np.errstate(all="ignore"):
        rows, ratios = _doubtful(problem, z, w, enough, least)
        if not rows.size or (units := units_of_unknowns(matrix)) is None:
            return 0.0
        excuse = _beside_reference(problem, z, w, units)[rows]
        return float(np.fmin(ratios, excuse).max())


def _doubtful(
    problem: LCP, z: FloatVector, w: FloatVector, enough: float, least: float
) -> tuple[IntVector, FloatVector]:
    """Return the rows that neither their own terms nor their bounds make right, and how wrong they are."""
    share, wrong = math.sqrt(enough) * math.sqrt(math.sqrt(enough)), []
    for first in range(0, z.size, BLOCK):
        here = slice(first, first + BLOCK)
        x, slack = z[here], w[here]
        least_terms = share * np.maximum(np.abs(problem.q[here]), np.abs(problem.diagonal[here] * x))
        is_wrong = (slack > least_terms) & (x > problem.lower[here])
        is_wrong |= (slack < -least_terms) & (x < problem.upper[here])
        if is_wrong.any():
            wrong.append(np.flatnonzero(is_wrong) + first)
    rows = np.concatenate(wrong) if wrong else np.empty(0, np.int64)
    if not rows.size:
        return rows, np.empty(0)
    some: Any = problem.matrix.rows[rows]
    terms = abs(some) @ np.abs(z) + np.abs(problem.q[rows])
    distance = np.where(w[rows] > 0.0, z[rows] - problem.lower[rows], problem.upper[rows] - z[rows])
    ratios = np.fmin((np.abs(w[rows]) / terms) ** (4.0 / 3.0), (distance / np.abs(z[rows])) ** 2)
    left = ratios > enough
    if least and left.any():
        left &= np.abs(scaled_residual(problem, z, w))[rows] > enough * least
    return rows[left], ratios[left]


def _beside_reference(problem: LCP, z: FloatVector, w: FloatVector, units: Units) -> FloatVector:
    """Return |r_i| beside the reference of its part, both in units of their unknowns, shape (n,)."""
    origin = problem.nearest_to_zero
    reference = _in_units(problem, origin, problem.slack(origin), units)
    largest = for_each_row(problem, largest_of_parts(problem, reference))
    return over(_in_units(problem, z, w, units), largest)


def _in_units(problem: LCP, z: FloatVector, w: FloatVector, units: Units) -> FloatVector:
    """Return |r_i|, shape (n,), in units of the unknowns."""
    row, column = units.exponents
    below, above = (np.ldexp(step, -column) for step in (z - problem.upper, z - problem.lower))
    return np.abs(np.minimum(np.maximum(np.ldexp(w, row) / units.residual_scale, below), above))
