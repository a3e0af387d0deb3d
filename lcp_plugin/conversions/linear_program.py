"""Linear programs as linear complementarity problems."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..problem.lcp import LCP
from .checked import checked_vector
from .quadratic_program import QuadraticProgram, lcp_from_qp


def lcp_from_lp(
    c: ArrayLike, G: Any = None, h: ArrayLike | None = None, A: Any = None, b: ArrayLike | None = None,
    lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf,
) -> LCP:
    """Return the optimality conditions of min cᵀx, G x ≤ h, A x = b, lower ≤ x ≤ upper as a complementarity problem.

    Parameters
    ----------
    c : array, shape (n,)
        Real, finite.
    G, h, A, b, lower, upper
        As in :class:`~lcp_plugin.conversions.quadratic_program.QuadraticProgram`.

    Returns
    -------
    LCP
        The program of the form "kkt" with P = 0 (form "direct", M = 0, where all constraints are bounds): monotone
        with M = −Mᵀ, and a diagonal of zeros, on which relaxation methods cannot run. ``origin.recover(result)``
        gives a :class:`~lcp_plugin.conversions.qp_solution.QPSolution`.

    Raises
    ------
    InvalidProblem
        Where the data do not state such a program.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.2.

    Examples
    --------
    max x₁ + 2 x₂ subject to x₁ + x₂ ≤ 3, 0 ≤ x ≤ 2:

    >>> problem = lcp_from_lp([-1, -2], G=[[1, 1]], h=[3], lower=0, upper=2)
    >>> solution = problem.origin.recover([1.0, 2.0, 1.0])
    >>> solution.objective, solution.inequality, solution.upper
    (-5.0, array([1.]), array([0., 1.]))
    >>> solution.is_optimal(tolerance=0.0)
    True
    """
    n = checked_vector(c, "c", None).size
    return lcp_from_qp(QuadraticProgram(sp.csr_array((n, n)), c, G, h, A, b, lower, upper))
