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

Of a nonlinear F, M is F′(x) and q = F(x) − F′(x) x. Where F flattens as x runs away, d → 0 or is the noise of
differences, and beside a pole d is anything. So there only rows that have to vanish, and nearly do, tell U, no larger
than ‖x_P‖∞, and instead of the first condition

- v_i ≤ s^(3/2) T_i, 1e-6 T_i at a tolerance of 1e-8, or
- |x_j| ≤ s² U for all unknowns of the row, and |q_i| ≪ T_i: it vanishes near 0, as it does not beside a pole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..checks import FloatVector
from ..matrix.matrix import largest_in_rows
from ..matrix.scaling import energy_scale
from .criterion import for_each_row, largest_of_components
from .row_residuals import magnitude

if TYPE_CHECKING:
    from ..lcp import LCP

VANISHING = 1e-3  # of its terms: more is no row that vanishes


def term_residuals(problem: LCP, z: FloatVector, w: FloatVector, *, is_linear: bool = True) -> FloatVector:
    """Return how wrong each row is in its own terms, shape (own,): 0 where it is right.

    Parameters
    ----------
    problem : LCP
        Of a nonlinear F its linearisation at z.
    z, w : array, shape (own,)
        The point, and its slack, or F there.
    is_linear : bool
        Whether w is M z + q everywhere.

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
        if is_linear:
            if (energy := energy_scale(problem.matrix)) is not None:  # which knows of units beside the diagonal alone
                scale = np.where(np.isnan(energy), scale, problem.diagonal)
            unit = for_each_row(problem, largest_of_components(problem, terms / scale))
            if energy is not None:
                largest = largest_of_components(problem, np.nan_to_num(terms / energy))
                unit = np.fmin(unit, for_each_row(problem, largest) * energy / scale)
            own = (2.0 * wrong / (terms + np.sqrt(terms**2 + 4.0 * wrong * scale * unit))) ** 2
        else:
            tells = (distance > 0.0) & (wrong <= VANISHING * terms)
            unit = largest_of_components(problem, np.where(tells, terms / scale, 0.0))
            unit = for_each_row(problem, np.minimum(unit, largest_of_components(problem, np.abs(z))))
            rows = problem.matrix.csr_rows
            unknowns = largest_in_rows(rows, np.where(rows.data != 0.0, np.abs(z)[rows.indices], 0.0))  # of each row
            vanishes = np.abs(problem.q) <= VANISHING * (terms - np.abs(problem.q))
            own = np.fmin((wrong / terms) ** (4.0 / 3.0), np.where(vanishes, unknowns / unit, np.inf))
        stays_right = ~(np.abs(w) - problem.diagonal * distance < 0.0)  # as far as the diagonal entry tells
        of_bound = np.where(stays_right, np.fmin((distance / np.abs(z)) ** 2, distance / unit), np.inf)
        squares: FloatVector = np.fmin(own, of_bound)
    return np.where(wrong == 0.0, 0.0, np.where(np.isfinite(squares), squares, np.inf))
