"""How wrong each row is beside the numbers that it is made of, in the caller's own units: the guard of the criterion.

A residual relative to one reference may hide a row: in units that M does not have, along a flow, or where a nonlinear F
flattens. So beside it every row is judged by its own terms. With T_i = |q_i| + Σ_j |m_ij z_j|, U = max T_i / d_i over
the component, and v_i the part of w_i that has the wrong sign (|w_i| where z_i is off its bounds), row i is right
to s if

- v_i ≤ s (T_i + s d_i U), or
- z_i is no farther than s max(|z_i|, s U) from a bound where its sign is right, and the step there keeps that sign.

Its *term residual* is the least such s²: at most the tolerance where it is right to √tolerance. The second term is for
rows whose own terms are negligible beside those of the component, as in a far field. Where t_i |m_ij| are symmetric, U
is also no larger than max T_j / e_j times e_i / d_i, e_i = √(d_i/t_i), d_i the diagonal entry, however small it is:
neither in the caller's units nor in those of energy may a row be wrong, be it negligible in the other ones.

In the caller's own units an LCP within the tolerance has no larger term residual: z° is nearer to 0 than z is, so that
‖r(z°)‖∞ ≤ U, and a row with |r_i| ≤ s² U meets it. There nothing has to be computed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..checks import FloatVector
from ..matrix.scaling import energy_scale
from .criterion import for_each_row, largest_of_components
from .row_residuals import magnitude

if TYPE_CHECKING:
    from ..lcp import LCP


def term_residuals(problem: LCP, z: FloatVector, w: FloatVector) -> FloatVector:
    """Return how wrong each row is in its own terms, shape (own,): 0 where it is right.

    Parameters
    ----------
    problem : LCP
    z, w : array, shape (own,)
        The point, and its slack.

    Examples
    --------
    >>> from lcp_plugin import LCP
    >>> problem = LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])
    >>> for z in ([2.5, 0.0], [2.5 + 1e-9, 0.0], [2.0, 0.0]):
    ...     print(term_residuals(problem, np.array(z), problem.slack(np.array(z))).round(3))
    [0. 0.]
    [0. 0.]
    [0.01 0.  ]
    """
    scale, is_above = problem.residual_scale, w > 0.0
    with np.errstate(all="ignore"):
        distance = np.where(is_above, z - problem.lower, problem.upper - z)  # to where this sign is right
        wrong = np.where(distance > 0.0, np.abs(w), 0.0)
        terms = magnitude(problem, problem.matrix.whole(z))
        if (energy := energy_scale(problem.matrix)) is not None:  # which knows of units beside the diagonal alone
            scale = np.where(np.isnan(energy), scale, problem.diagonal)
        unit = for_each_row(problem, largest_of_components(problem, terms / scale))
        if energy is not None:
            largest = largest_of_components(problem, np.nan_to_num(terms / energy))
            unit = np.fmin(unit, for_each_row(problem, largest) * energy / scale)
        own = (2.0 * wrong / (terms + np.sqrt(terms**2 + 4.0 * wrong * scale * unit))) ** 2
        stays_right = ~(np.abs(w) - problem.diagonal * distance < 0.0)  # as far as the diagonal entry tells
        of_bound = np.where(stays_right, np.fmin((distance / np.abs(z)) ** 2, distance / unit), np.inf)
        squares: FloatVector = np.fmin(own, of_bound)
    return np.where(wrong == 0.0, 0.0, np.where(np.isfinite(squares), squares, np.inf))
