"""Strategies for quadratic programs, cvxpy models and nonlinear problems whose answers are known exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

from ..core.checks import FloatVector
from ..core.lcp import LCP
from ..problems.nonlinear.data import NonlinearProblem
from ..problems.programs.conversion import QuadraticProgram
from .definite import positive_definite_matrices, positive_semidefinite_matrices
from .dominant import p_matrices
from .options import SIGNED, Numbers, blocks, drawn_number, entries, integer_vectors, sizes, vectors
from .problems import Answer, solved_lcps
from .rows import RowKinds, checked_kinds, drawn_rows, exact_double, exact_offset, exact_products, fractions_of


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
    bounds: float = True,
    active: float = 1 / 3,
    degenerate: float = 1 / 3,
    density: float = 1.0,
) -> st.SearchStrategy[tuple[QuadraticProgram, QPAnswer]]:
    """Return a strategy for pairs (program, answer), answer a minimum with its multipliers, exactly.

    Parameters
    ----------
    matrices : strategy of symmetric positive semidefinite (n, n) matrices, optional
        The Hessians P; definite and semidefinite ones of all sizes up to 8 by default.
    inequalities, equalities : int or strategy of int
        Rows of G and of A, up to 4 and 2 by default. Rows may depend on one another.
    bounds : bool or float
        Share of variables that may have bounds; the others are free.
    active, degenerate : float
        Shares of inequalities and of bounded variables that hold with equality and a positive multiplier, and with
        equality and the multiplier 0, roughly.
    density : float
        Share of nonzeros of G and A, in [0, 1], roughly.

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
    hessians = positive_definite_matrices() | positive_semidefinite_matrices() if matrices is None else matrices
    limits = checked_kinds(active, degenerate, 0.0)
    variables = checked_kinds(active, degenerate, bounds, otherwise_free=True)
    return _convex(hessians, sizes(inequalities), sizes(equalities), limits, variables, entries(density))


@st.composite
def _convex(
    draw: st.DrawFn, hessians: st.SearchStrategy[Any], inequalities: st.SearchStrategy[int],
    equalities: st.SearchStrategy[int], limits: RowKinds, variables: RowKinds,
    values: Numbers,
) -> tuple[QuadraticProgram, QPAnswer]:
    P = draw(hessians)
    n, m, p = P.shape[0], draw(inequalities), draw(equalities)
    x, reduced, lower, upper = drawn_rows(draw, n, variables)
    gap, multiplier, _, _ = drawn_rows(draw, m, limits)  # complementary and not negative: the classical rows
    equality = draw(vectors(p, SIGNED))
    rows = draw(blocks(m + p, n, values))
    G, A = rows[:m], rows[m:]
    products = exact_products(P, x)
    c = exact_gradient(products, reduced - G.T @ multiplier - A.T @ equality)
    program = QuadraticProgram(P, c, G, G @ x + gap, A, A @ x, lower, upper)
    duals = (multiplier, equality, np.maximum(reduced, 0.0), np.maximum(-reduced, 0.0))
    return program, QPAnswer._make([*map(fractions_of, (x, *duals)), _least_value(products, x, c)])


def exact_gradient(products: Sequence[Fraction], total: FloatVector) -> FloatVector:
    """Return c = total − P x of the products P x, shape (n,), or raise InvalidProblem where a double cannot hold it."""
    complaint = "c = −P x − … is not free of rounding in row {}; draw P with short entries of similar size"
    rows = enumerate(zip(total.tolist(), products, strict=True))
    return np.array([exact_double(Fraction(right) - product, complaint.format(i)) for i, (right, product) in rows])


def _least_value(products: Sequence[Fraction], x: FloatVector, c: FloatVector) -> Fraction:
    rows = zip(x.tolist(), products, c.tolist(), strict=True)
    return sum((Fraction(here) * (product / 2 + Fraction(linear)) for here, product, linear in rows), Fraction(0))


FORMS = ("plain", "swapped", "attribute", "shifted", "box", "free", "equation")


def complementarity_models(
    matrices: st.SearchStrategy[Any] | None = None, *, active: float = 1 / 3, degenerate: float = 1 / 3
) -> st.SearchStrategy[tuple[Any, dict[str, FloatVector]]]:
    """Return a strategy for pairs (model, answers): complementarity problems in cvxpy, and what their variables become.

    Parameters
    ----------
    matrices : strategy of (n, n) matrices, n ≥ 1, optional
        P-matrices by default, so that the answer is the only one.
    active, degenerate : float
        As in :func:`solved_lcps`.

    Returns
    -------
    strategy of (cvxpy.Problem, dict)
        The model is a ``ComplementarityProblem`` or a ``cp.Problem`` with the objective 0, in one variable, "x", or in
        "x" and "y". Their pairs are stated in one of the ways that ``complements`` knows: with x >= 0 on either side, a
        variable's attribute, x >= l, a box; free ones with F == 0, in a pair or alone. The dict has the exact value of
        each variable by name: ``model.var_dict[name].value`` should be near it.

    Raises
    ------
    InvalidOption
        Where an option is out of its range.
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
    plain = checked_kinds(active, degenerate, 0.0)
    free = plain._replace(otherwise_free=True)
    kinds = {"box": plain._replace(bounds=1.0), "free": free, "equation": free}
    return _model(p_matrices() if matrices is None else matrices, {form: kinds.get(form, plain) for form in FORMS})


@st.composite
def _model(
    draw: st.DrawFn, matrices: st.SearchStrategy[Any], kinds: dict[str, RowKinds]
) -> tuple[Any, dict[str, FloatVector]]:
    import cvxpy as cp

    from ..modeling.registration import ComplementarityProblem, register

    register()
    M = sp.csr_array(draw(matrices))
    n = M.shape[0]
    cut = n - draw(st.integers(0, n - 1))
    parts = [slice(0, cut), slice(cut, n)] if cut < n else [slice(0, n)]
    # An equation alone is no complementarity: the first pair must be one.
    forms = [draw(st.sampled_from(FORMS[:-1])), *(draw(st.sampled_from(FORMS)) for _ in parts[1:])]
    drawn = [_stated_rows(draw, form, kinds[form], part) for form, part in zip(forms, parts, strict=True)]
    z, slack, lower, upper = np.concatenate(drawn, axis=1)
    q = exact_offset(M, z, slack, np.zeros(n, dtype=np.int64))
    variables = [_variable(form, name, part) for form, name, part in zip(forms, "xy", parts, strict=False)]
    constraints = []
    for form, variable, part in zip(forms, variables, parts, strict=True):
        F = q[part] + sum(M[part, columns] @ other for columns, other in zip(parts, variables, strict=True))
        constraints.append(_constraint(form, variable, F, lower[part], upper[part]))
    is_ours = draw(st.booleans())
    model = cp.Problem(cp.Minimize(0), constraints) if is_ours else ComplementarityProblem(constraints)
    return model, {variable.name(): z[part] for variable, part in zip(variables, parts, strict=True)}


def _stated_rows(draw: st.DrawFn, form: str, kinds: RowKinds, part: slice) -> Any:
    drawn = np.array(drawn_rows(draw, part.stop - part.start, kinds))
    if form == "shifted":
        drawn[[0, 2]] += drawn_number(draw, SIGNED)
    return drawn


def _variable(form: str, name: str, part: slice) -> Any:
    import cvxpy as cp

    return cp.Variable(part.stop - part.start, name=name, nonneg=form == "attribute")


def _constraint(form: str, variable: Any, F: Any, lower: FloatVector, upper: FloatVector) -> Any:
    from ..modeling.constraint import box, complements

    if form == "swapped":
        return complements(F >= 0, variable >= 0)
    if form == "attribute":
        return complements(variable, F)
    if form == "box":
        return complements(box(variable, lower, upper), F)
    if form == "free":
        return complements(variable, F == 0)
    return F == 0 if form == "equation" else complements(variable >= lower, F >= 0)


# --- Nonlinear problems -----------------------------------------------------------------------------------------

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
