"""Strategies for quadratic programs, cvxpy models and nonlinear problems whose answers are known exactly."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

from ..core.checks import FloatVector
from ..core.lcp import LCP
from ..problems.nonlinear.data import NonlinearProblem
from ..problems.programs.conversion import QuadraticProgram
from ..proofs.exact.rational import exact_slack
from .matrices import (
    SIGNED,
    blocks,
    p_matrices,
    positive_definite_matrices,
    positive_semidefinite_matrices,
    rows,
    sizes,
    vectors,
)
from .problems import (
    Answer,
    columns_of,
    complementary_rows,
    exact_offset,
    fractions_of,
    solved_lcps,
)


class QPAnswer(NamedTuple):
    """A minimum of a convex quadratic program and multipliers that prove it, all exact.

    P x + c + Gᵀ inequality + Aᵀ equality − lower + upper = 0, each multiplier of an inequality or a bound ≥ 0 and 0
    where that does not hold with equality. `x` is the only minimum where P is positive definite; `objective` is the
    least value always.
    """

    x: Answer
    inequality: Answer
    equality: Answer
    lower: Answer
    upper: Answer
    objective: Fraction


def convex_qps(
    matrices: st.SearchStrategy[Any] | None = None,
    *,
    inequalities: int | st.SearchStrategy[int] = st.integers(0, 4),  # noqa: B008 - strategies do not change
    equalities: int | st.SearchStrategy[int] = st.integers(0, 2),  # noqa: B008
    bounds: bool = True,
) -> st.SearchStrategy[tuple[QuadraticProgram, QPAnswer]]:
    """Return a strategy for pairs (program, answer), answer a minimum with its multipliers, exactly.

    Parameters
    ----------
    matrices : strategy of symmetric positive semidefinite (n, n) matrices, optional
        The Hessians P; definite and semidefinite ones of all sizes up to 8 by default.
    inequalities, equalities : int or strategy of int
        Rows of G and of A, up to 4 and 2 by default. Rows may depend on one another.
    bounds : bool
        Draw variables with bounds; otherwise they are free.

    Returns
    -------
    strategy of (QuadraticProgram, QPAnswer)

    Raises
    ------
    InvalidOption
        Where an option is out of its range.
    InvalidProblem
        While drawing, where P is not symmetric or c is not free of rounding.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> program, answer = find(convex_qps(inequalities=1), lambda drawn: True, settings=quick)
    >>> program
    QuadraticProgram([[1.0]], [0.0], G=[[0.0]], h=[1.0], lower=-1.0, upper=1.0)
    >>> answer.x, answer.objective
    ((Fraction(0, 1),), Fraction(0, 1))
    """
    hessians = (
        positive_definite_matrices() | positive_semidefinite_matrices()
        if matrices is None
        else matrices
    )
    inequality_count, equality_count = sizes(inequalities), sizes(equalities)
    variable, pair = complementary_rows(bounds, otherwise_free=True), complementary_rows()

    @st.composite
    def convex(draw: st.DrawFn) -> tuple[QuadraticProgram, QPAnswer]:
        P = draw(hessians)
        n, m, p = P.shape[0], draw(inequality_count), draw(equality_count)
        x, reduced, lower, upper = columns_of(draw(rows(n, variable)))
        gap, multiplier, _, _ = columns_of(draw(rows(m, pair)))
        equality = draw(vectors(p, SIGNED))
        G, A = np.split(draw(blocks(m + p, n, SIGNED)), [m])
        c = exact_offset(P, x, reduced - G.T @ multiplier - A.T @ equality)
        # ½xᵀP x + cᵀx = ½xᵀ((P x + c) + c)
        terms = zip(fractions_of(x), exact_slack(LCP(P, c), x), fractions_of(c), strict=True)
        least = sum(
            (value * (gradient + linear) / 2 for value, gradient, linear in terms), Fraction(0)
        )
        program = QuadraticProgram(P, c, G, G @ x + gap, A, A @ x, lower, upper)
        answers = (x, multiplier, equality, np.maximum(reduced, 0.0), np.maximum(-reduced, 0.0))
        return program, QPAnswer._make([*map(fractions_of, answers), least])

    return convex()


FORMS = ("plain", "swapped", "attribute", "shifted", "box", "free")


def complementarity_models(
    matrices: st.SearchStrategy[Any] | None = None,
) -> st.SearchStrategy[tuple[Any, dict[str, FloatVector]]]:
    """Return a strategy for pairs (model, answers): complementarity problems in cvxpy, and what their variables become.

    Parameters
    ----------
    matrices : strategy of (n, n) matrices, n ≥ 1, optional
        P-matrices by default, so that the answer is the only one.

    Returns
    -------
    strategy of (cvxpy.Problem, dict)
        The model is a ``cp.Problem`` with the objective 0, in one variable, "x". It is stated in one of the ways that
        ``complements`` knows: with x >= 0 on either side, a variable's attribute, x >= l, a box, or free with F == 0.
        The dict has the exact value of the variable by its name:
        ``model.var_dict["x"].value`` should be near it.

    Raises
    ------
    InvalidProblem
        While drawing, as in :func:`solved_lcps`.

    Notes
    -----
    cvxpy is loaded when the first model is drawn.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> model, answers = find(complementarity_models(), lambda drawn: True, settings=quick)
    >>> answers
    {'x': array([1.])}
    >>> _ = model.solve(method="LCP")
    >>> model.var_dict["x"].value.round(6)
    array([1.])
    """
    chosen = p_matrices() if matrices is None else matrices

    @st.composite
    def model(draw: st.DrawFn) -> tuple[Any, dict[str, FloatVector]]:
        import cvxpy as cp

        from ..modeling.constraint import box, complements
        from ..modeling.registration import register

        register()
        M, form = sp.csr_array(draw(chosen)), draw(st.sampled_from(FORMS))
        row = complementary_rows(form == "box", otherwise_free=form == "free")
        z, w, lower, upper = columns_of(draw(rows(M.shape[0], row)))
        if form == "shifted":
            lower = lower + draw(SIGNED)
            z = z + lower
        x = cp.Variable(z.size, name="x", nonneg=form == "attribute")
        F = M @ x + exact_offset(M, z, w)
        pairs = {
            "swapped": (F >= 0, x >= 0),
            "attribute": (x, F),
            "box": (box(x, lower, upper), F),
            "free": (x, F == 0),
        }
        pair = complements(*pairs.get(form, (x >= lower, F >= 0)))
        return cp.Problem(cp.Minimize(0), [pair]), {"x": z}

    return model()


# --- Nonlinear problems -----------------------------------------------------------------------------------------

TERMS: dict[
    str, tuple[Callable[[FloatVector], FloatVector], Callable[[FloatVector], FloatVector]]
] = {
    "cubic": (lambda t: t**3, lambda t: 3.0 * t**2),
    "exponential": (np.exp, np.exp),
}


def solved_nonlinear_problems(
    matrices: st.SearchStrategy[Any] | None = None, *, bounds: bool = False
) -> st.SearchStrategy[tuple[NonlinearProblem, Answer]]:
    """Return a strategy for pairs (problem, x) where x solves the problem exactly, in floating point too.

    Parameters
    ----------
    matrices, bounds
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
    lcps = solved_lcps(matrices, bounds=bounds)

    @st.composite
    def solved(draw: st.DrawFn) -> tuple[NonlinearProblem, Answer]:
        problem, answer = draw(lcps)
        at = np.array(answer, dtype=float)
        weights = draw(vectors(at.size, st.integers(0, 4))) / 4.0
        term, slope = TERMS[draw(st.sampled_from(sorted(TERMS)))]
        M, q = problem.M, problem.q

        def F(x: FloatVector) -> FloatVector:
            value: FloatVector = M @ x + q + weights * (term(x) - term(at))
            return value

        def jacobian(x: FloatVector) -> Any:
            added = weights * slope(x)
            return M + sp.diags_array(added) if sp.issparse(M) else M + np.diag(added)

        return NonlinearProblem(F, jacobian, problem.lower, problem.upper), answer

    return solved()
