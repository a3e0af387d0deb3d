"""Strategies for nonlinear complementarity problems whose answer is exact."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

from ..checks import FloatVector
from ..problem.lcp import LCP
from ..problem.nonlinear import NonlinearProblem
from .options import Numbers, integer_vectors
from .problems import Answer, solved_lcps

TERMS: dict[str, tuple[Callable[[FloatVector], FloatVector], Callable[[FloatVector], FloatVector]]] = {
    "cubic": (lambda t: t**3, lambda t: 3.0 * t**2),
    "exponential": (np.exp, np.exp),
}


def solved_nonlinear_problems(
    matrices: st.SearchStrategy[Any] | None = None,
    *,
    active: float = 1 / 3,
    degenerate: float = 1 / 3,
    bounds: float = False,
) -> st.SearchStrategy[tuple[NonlinearProblem, Answer]]:
    """Return a strategy for pairs (problem, x) where x solves the problem exactly, in floating point too.

    Parameters
    ----------
    matrices, active, degenerate, bounds
        As in :func:`solved_lcps`; the default matrices make x the only solution.

    Returns
    -------
    strategy of (NonlinearProblem, tuple of Fraction)
        F(x) = M x + q + s (g(x) − g(x*)) by rows, g(t) = t³ or exp t, s ≥ 0; with its derivative.

    Raises
    ------
    InvalidOption, InvalidProblem
        As in :func:`solved_lcps`.

    Notes
    -----
    The answer comes first: x* solves the LCP, and F is shifted so that nothing is added there.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> problem, x = find(solved_nonlinear_problems(), lambda drawn: True, settings=quick)
    >>> problem, x, problem.value([3.0])
    (NonlinearProblem(n=1, jacobian given), (Fraction(1, 1),), array([2.]))
    """
    return _solved(solved_lcps(matrices, active=active, degenerate=degenerate, bounds=bounds))


@st.composite
def _solved(draw: st.DrawFn, lcps: st.SearchStrategy[tuple[LCP, Answer]]) -> tuple[NonlinearProblem, Answer]:
    problem, answer = draw(lcps)
    at = np.array(answer, dtype=float)
    weights = np.array(draw(integer_vectors(at.size, Numbers(0, 4)))) / 4.0
    term, slope = TERMS[draw(st.sampled_from(sorted(TERMS)))]
    M, q = problem.M, problem.q

    def F(x: FloatVector) -> FloatVector:
        value: FloatVector = M @ x + q + weights * (term(x) - term(at))
        return value

    def jacobian(x: FloatVector) -> Any:
        added = weights * slope(x)
        return M + sp.diags_array(added) if sp.issparse(M) else M + np.diag(added)

    return NonlinearProblem(F, jacobian, problem.lower, problem.upper), answer
