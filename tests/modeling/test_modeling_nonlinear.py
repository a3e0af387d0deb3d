"""Pairs complements() with smooth nonlinear sides: derivatives, published problems, and errors."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    LCPError,
    ModelWarning,
    NonlinearProblem,
    Status,
    UnsupportedModel,
    box,
    complements,
    solve,
)
from lcp_plugin.expressions import functions
from lcp_plugin.expressions.rows import Program
from lcp_plugin.modeling.reading import Reader
from lcp_plugin.modeling.registration import is_complementarity_problem, model_of_constraints

STEP = 1e-200  # of complex differentiation, which has no subtraction and so no cancellation
B = np.array([[1.0, 0.5, 0.0], [-0.25, 2.0, 1.0], [0.0, 1.0, 3.0]])
S = sp.csr_array(B)


def compiled(expression: Any) -> Program:
    """The program of an expression over its variables, in the order of cvxpy."""
    first, count = {}, 0
    for variable in expression.variables():
        first[variable.id], count = count, count + variable.size
    reader = Reader()
    return Program.of(reader.compiler, [reader.rows(expression)], first, count)


class Unknowns:
    """x of shape (3,), X of shape (2, 3), s a number; as cvxpy has them, and as numpy has them."""

    def __init__(self) -> None:
        self.x, self.X, self.s = cp.Variable(3), cp.Variable((2, 3)), cp.Variable()
        self.everything = 0 * cp.sum(self.x) + 0 * cp.sum(self.X) + 0 * self.s

    @staticmethod
    def split(v: Any) -> tuple[Any, Any, Any]:
        return v[:3], v[3:9].reshape((2, 3), order="F"), v[9]


def softplus(u: Any) -> Any:
    return np.log(1.0 + np.exp(u))


# : The expression in cvxpy, and in numpy for complex arguments.
FORMS: dict[str, tuple[Callable[[Unknowns], Any], Callable[..., Any]]] = {
    "exp": (lambda u: cp.exp(u.x), lambda x, X, s: np.exp(x)),
    "log": (lambda u: cp.log(u.X), lambda x, X, s: np.log(X)),
    "logistic": (lambda u: cp.logistic(u.x - u.s), lambda x, X, s: softplus(x - s)),
    "entr": (lambda u: cp.entr(u.x), lambda x, X, s: -x * np.log(x)),
    "xexp": (lambda u: cp.xexp(u.x), lambda x, X, s: x * np.exp(x)),
    "real power": (lambda u: cp.power(u.x, 1.7), lambda x, X, s: x**1.7),
    "negative power": (lambda u: cp.power(u.X, -0.6), lambda x, X, s: X**-0.6),
    "multiply": (lambda u: cp.multiply(u.x, u.X[0] - u.s), lambda x, X, s: x * (X[0] - s)),
    "quotient": (lambda u: u.x / (u.X[1] + 1), lambda x, X, s: x / (X[1] + 1)),
    "matrix of variables times vector": (lambda u: u.X @ u.x, lambda x, X, s: X @ x),
    "matrix @ nonlinear": (
        lambda u: S @ cp.exp(u.x) - B @ u.x,
        lambda x, X, s: B @ np.exp(x) - B @ x,
    ),
    "sum along an axis": (
        lambda u: cp.sum(cp.exp(u.X), axis=0),
        lambda x, X, s: np.exp(X).sum(axis=0),
    ),
    "index, stack, transpose": (
        lambda u: cp.vstack([cp.exp(u.x)[::-1], cp.square(u.X)[1], u.x]).T,
        lambda x, X, s: np.vstack([np.exp(x)[::-1], X[1] ** 2, x]).T,
    ),
    "quad_over_lin": (lambda u: cp.quad_over_lin(u.x, u.s), lambda x, X, s: (x**2).sum() / s),
    "quad_form": (lambda u: cp.quad_form(u.x, B + B.T), lambda x, X, s: x @ (B + B.T) @ x),
    "geo_mean": (
        lambda u: cp.geo_mean(u.x, [1, 0, 2]),
        lambda x, X, s: x[0] ** (1 / 3) * x[2] ** (2 / 3),
    ),
    "prod": (lambda u: cp.prod(u.x), lambda x, X, s: x[0] * x[1] * x[2]),
    "log_sum_exp": (lambda u: cp.log_sum_exp(u.x), lambda x, X, s: np.log(np.exp(x).sum())),
    "rel_entr": (lambda u: cp.rel_entr(u.x, u.X[0]), lambda x, X, s: x * np.log(x / X[0])),
    "kl_div": (lambda u: cp.kl_div(u.x, u.X[0]), lambda x, X, s: x * np.log(x / X[0]) - x + X[0]),
    "deep": (
        lambda u: cp.exp(-cp.square(cp.log(u.x) + u.s)) / (1 + cp.sum(cp.sqrt(u.X))),
        lambda x, X, s: np.exp(-((np.log(x) + s) ** 2)) / (1 + np.sqrt(X).sum()),
    ),
}


def flat(value: Any) -> Any:
    return np.ravel(np.asarray(value), order="F")


@cache
def compiled_form(name: str) -> tuple[Program, Callable[[Any], Any], Any, Unknowns]:
    unknowns = Unknowns()
    form, reference = FORMS[name]
    expression = form(unknowns) + unknowns.everything
    order = {variable.id: variable for variable in expression.variables()}
    places = np.concatenate(
        [
            {
                unknowns.x.id: np.arange(3),
                unknowns.X.id: np.arange(3, 9),
                unknowns.s.id: np.arange(9, 10),
            }[key]
            for key in order
        ]
    )
    back = np.argsort(places)
    return (
        compiled(expression),
        lambda v: flat(reference(*Unknowns.split(v[back]))),
        expression,
        unknowns,
    )


def points(seed: int, count: int) -> Any:
    return np.random.default_rng(seed).uniform(0.3, 2.5, size=(count, 10))


@pytest.mark.parametrize("name", FORMS)
def test_values_and_derivatives_are_those_of_the_function(name):
    """Value and Jacobian agree with numpy's, differentiated along the imaginary axis, up to rounding."""
    program, reference, _, _ = compiled_form(name)
    for v in points(1, 5):
        np.testing.assert_allclose(program.value(v), reference(v), rtol=1e-13, atol=1e-13)
        columns = [reference(v + 1j * STEP * unit).imag / STEP for unit in np.eye(10)]
        np.testing.assert_allclose(
            program.jacobian(v).toarray(), np.array(columns).T, rtol=1e-12, atol=1e-12
        )


# : Exponentials, quotients or sums that overflow although the atom does not, and the point.
FAR_OUT: dict[str, tuple[Callable[[Any], Any], list[float]]] = {
    "log_sum_exp of thousands": (lambda x: cp.log_sum_exp(x + 5000), [1.0, 2.0, 3.0]),
    "log_sum_exp of minus thousands": (lambda x: cp.log_sum_exp(x), [-5000.0, -4999.0, -6000.0]),
    "logistic": (lambda x: cp.logistic(x), [1000.0, -1000.0, 0.0]),
    "rel_entr": (lambda x: cp.rel_entr(x[0], x[1:]), [1e-160, 1.0, 1e150]),
    "kl_div": (lambda x: cp.kl_div(x, x[::-1]), [1e306, 3e305, 2e306]),
    "geo_mean": (lambda x: cp.geo_mean(x), [1e300, 1e300, 1e200]),
}


@pytest.mark.parametrize("name", FAR_OUT)
def test_atoms_overflow_only_where_their_values_do(name):
    """At large arguments the value agrees with cvxpy, and the derivatives are finite."""
    form, point = FAR_OUT[name]
    x = cp.Variable(3)
    expression, x.value = form(x), np.array(point)
    program = compiled(expression)
    value, derivative = program.value(x.value), program.jacobian(x.value)
    np.testing.assert_allclose(value, flat(expression.value), rtol=1e-12)
    assert np.isfinite(derivative.data).all()


def test_relative_entropy_is_defined_where_cvxpy_has_it():
    """Terms 0 log 0 and 0 log(0/y) are 0; negative arguments are undefined for every quotient."""
    x = cp.Variable(2)
    for atom in (cp.rel_entr, cp.kl_div):
        program = compiled(atom(x[0], x[1]))
        assert [program.value(np.array(point))[0] for point in ((0.0, 0.0), (0.0, 2.0))] == [
            0.0,
            atom(0, 2).value,
        ]
        assert not np.isfinite(program.value(np.array([-1.0, -1.0]))).any()


def test_log_sum_exp_of_thousands_is_solved():
    """log_sum_exp(x + 5000) + x = 6000 has its solution by hand."""
    x = cp.Variable(2)
    x.value = np.zeros(2)
    F = cp.log_sum_exp(x + 5000) + x - [6000, 6001]
    solved([complements(x >= 0, F >= 0)])
    other = 500.5 - math.log(1 + math.exp(-1.0)) / 2
    np.testing.assert_allclose(x.value, [other - 1, other], atol=1e-8)


def test_nothing_is_known_outside_a_domain():
    """A point outside of the domain gives no number, and no exception."""
    x = cp.Variable(4)
    program = compiled(cp.hstack([cp.log(x[0]), cp.sqrt(x[1]), 1 / x[2], x[3] ** -1.5]))
    assert not np.isfinite(program.value(np.array([-1.0, -1.0, 0.0, -1.0]))).any()
    assert not np.isfinite(program.jacobian(np.array([0.0, 0.0, 0.0, 0.0])).data).any()


def solved(constraints: list[Any], **options: Any) -> cp.Problem:
    problem = cp.Problem(cp.Minimize(0), constraints)
    assert is_complementarity_problem(problem)
    assert problem.solve(method="LCP", tolerance=1e-11, **options) == 0.0
    assert problem.status == cp.OPTIMAL
    return problem


@settings.get_profile("few")
@given(st.integers(0, 2**32 - 1))
def test_planted_answers_are_found(seed):
    """A monotone F with x and w chosen first, bounds on both sides and free rows: x is found."""
    generator = np.random.default_rng(seed)
    n = 6
    lower = generator.choice([-1.0, -np.inf], size=n)
    upper = generator.choice([2.0, np.inf], size=n)
    low, high = np.where(np.isfinite(lower), lower, -0.5), np.where(np.isfinite(upper), upper, 0.7)
    where = generator.integers(0, 3, size=n)
    planted = np.where(
        where == 0, low, np.where(where == 1, high, low + (high - low) * generator.random(n))
    )
    is_low, is_high = planted == lower, planted == upper
    w = np.where(is_low, 1.0, np.where(is_high, -1.0, 0.0)) * generator.random(n)
    A = generator.standard_normal((n, n))
    M = A @ A.T + (A - A.T)
    x = cp.Variable(n)
    F = M @ x + cp.exp(x) + x**3
    shift = w - (M @ planted + np.exp(planted) + planted**3)
    pair = complements(box(x, lower, upper), F + shift)
    solved([pair])
    np.testing.assert_allclose(x.value, planted, atol=1e-6)
    np.testing.assert_allclose(pair.dual_value, w, atol=1e-6)


def test_equations_pairs_and_slacks_may_be_nonlinear():
    """An equation with a product, a definition, and two nonlinear sides without a variable."""
    x, y, w = cp.Variable(2), cp.Variable(), cp.Variable(2, nonneg=True)
    x.value, y.value, w.value = np.ones(2), 1.0, np.ones(2)
    pair = complements(cp.exp(x) - 1 >= 0, w >= 0)
    solved([pair, w == cp.multiply(x, 1 + x**2) + y - [3, -1], cp.exp(y) * y == math.e])
    assert y.value == pytest.approx(1.0)
    np.testing.assert_allclose(x.value, [1.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(w.value, [0.0, 2.0], atol=1e-8)


#: Sides with their zeros and whether they increase; of two that do, the larger zero solves the pair.
SIDES: dict[str, tuple[Callable[[Any], Any], float, bool]] = {
    "exp": (lambda x: cp.exp(x) - 3, math.log(3.0), True),
    "log": (lambda x: cp.log(x) + 1, math.exp(-1.0), True),
    "softplus": (lambda x: 2 * cp.logistic(x) - 3, math.log(math.exp(1.5) - 1.0), True),
    "affine": (lambda x: 2 * x - 1, 0.5, True),
    "power": (lambda x: cp.power(x, -0.6) - 0.5, 0.5 ** (-1 / 0.6), False),
    "falling exp": (lambda x: 12 - cp.exp(x), math.log(12.0), False),
}


#: In both orders; where both sides fall, or are one, the answer is not unique.
PAIRS = [(a, b) for a in SIDES for b in SIDES if a != b and (SIDES[a][2] or SIDES[b][2])]


@pytest.mark.quick(3)
@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_two_sides_may_be_nonlinear(first, second):
    """One side is zero at the solution, in either order, and each side is the dual of the other."""
    (G, zero_of_G, rises), (F, zero_of_F, also_rises) = SIDES[first], SIDES[second]
    x = cp.Variable(2)
    x.value = np.array([1.0, 2.0])
    sides = G(x) >= 0, F(x) >= 0
    pair = complements(*sides)
    solved([pair])
    answers = [max(zero_of_G, zero_of_F)] if rises and also_rises else [zero_of_G, zero_of_F]
    assert np.abs(x.value[:, None] - answers).min(axis=1).max() <= 1e-8
    assert pair.violation() <= 1e-9
    w = G(x) if second == "affine" else F(x)  # of a side that is a variable, w is the other one
    np.testing.assert_allclose(pair.dual_value, w.value, atol=1e-9)
    np.testing.assert_allclose(sides[0].dual_value, F(x).value, atol=1e-9)
    np.testing.assert_allclose(sides[1].dual_value, G(x).value, atol=1e-9)


def test_bounds_beside_two_expressions_hold_and_a_box_may_hold_an_expression():
    """Bounds that no pair states are kept by the answer; exp(x) between 1 and 2 complements x − 3: x = ln 2."""
    x, y = cp.Variable(2, nonneg=True), cp.Variable()
    problem = solved([complements(cp.exp(x) >= 1, cp.exp(x) + x >= 4)])
    np.testing.assert_allclose(np.exp(x.value) + x.value, 4.0)
    y.value = 1.0
    pair = complements(box(cp.exp(y), 1, 2), y - 3)
    problem = cp.Problem(cp.Minimize(0), [pair])
    problem.solve(method="LCP", tolerance=1e-12)
    assert float(y.value) == pytest.approx(math.log(2.0))
    assert float(pair.dual_value) == pytest.approx(math.log(2.0) - 3.0)


def test_parameters_are_read_at_every_solve():
    """A coefficient, an exponent and a bound may be parameters, read at each solve."""
    x, factor, exponent, bound = cp.Variable(), cp.Parameter(), cp.Parameter(), cp.Parameter()
    problem = cp.Problem(
        cp.Minimize(0), [complements(box(x, bound, np.inf), factor * cp.power(x, exponent) - 8)]
    )
    x.value = 1.0
    for a, p, low, answer in (
        (1.0, 3, 0.0, 2.0),
        (2.0, 2, 0.0, 2.0),
        (2.0, 2, 3.0, 3.0),
        (4.0, 1, 0.0, 2.0),
    ):
        factor.value, exponent.value, bound.value = a, p, low
        problem.solve(method="LCP", tolerance=1e-12)
        assert x.value == pytest.approx(answer, abs=1e-9)


def test_start_is_the_value_of_the_variables():
    """The solution near the start is found; a start where F is not defined is replaced."""
    x = cp.Variable()
    problem = cp.Problem(cp.Minimize(0), [complements(box(x, -10, 10), x**2 - 4)])
    x.value = 1.0
    problem.solve(method="LCP")
    assert x.value == pytest.approx(2.0)
    problem.solve(method="LCP", warm_start=False, z0=[-10.0])
    assert x.value == pytest.approx(-10.0)
    other = cp.Problem(cp.Minimize(0), [complements(x >= 0, cp.log(x) + 1 >= 0)])
    x.value = -1.0
    other.solve(method="LCP")
    assert x.value == pytest.approx(math.exp(-1))


def test_affine_models_stay_lcps():
    """A constant exponential, a product with a parameter and a first power are affine."""
    x, p = cp.Variable(3), cp.Parameter(value=2.0)
    model = model_of_constraints(
        [complements(x >= 0, cp.exp(p) * x + cp.power(x, 1) - cp.square(p) >= 0)]
    )
    assert not isinstance(model.problem, NonlinearProblem)


def with_parameter(value: Any) -> Any:
    x, p = cp.Variable(2), cp.Parameter(2)
    p._value = value
    return complements(x >= 0, cp.exp(x) - p >= 0)


X = cp.Variable(2)


@refusals(r"""
cp.Problem(cp.Minimize(0), [complements(X >= 0, cp.abs(X) - 1 >= 0)]).solve(method="LCP")
    → abs\(.*not smooth.*and a pair
cp.Problem(cp.Minimize(0), [complements(X[0] >= 0, cp.lambda_max(cp.diag(X)) >= 0)]).solve(method="LCP")
    → lambda_max.*no derivative
cp.Problem(cp.Minimize(0), [with_parameter(np.array([np.nan, 1.0]))]).solve(method="LCP") → finite
cp.Problem(cp.Minimize(0), [complements(cp.exp(X[:1]) >= 1, cp.exp(X[1:]) >= 3)]).solve(method="LCP")
    → 1 equation, 1 of them from pairs of two expressions and 2 unknowns
cp.Problem(cp.Minimize(0), [complements(cp.exp(X) - 1, cp.exp(X) - 3)]).solve(method="LCP") → has no sign.*y == side
cp.Problem(cp.Minimize(0), [complements(X[0] >= 0, cp.exp(X[0]) + X[1] >= 0)]).solve(method="LCP") → 1 unknown without
cp.Problem(cp.Minimize(0), [complements(X >= 0, cp.exp(X) >= 2)]).solve(method="LCP", relaxation=1.7)
    → InvalidOption: no relaxation.*tolerance
LCP.from_cvxpy(cp.Problem(cp.Minimize(0), [complements(X >= 0, cp.exp(X) >= 2)])) → affine sides
""")
def test_what_is_refused_is_refused_in_words(call, words):
    """The error names the expression and the remedy."""
    assert_refused(call, words, globals(), UnsupportedModel)


def test_a_missing_start_is_named():
    """If F is undefined at the values, at 0 and at 1, the error recommends another start."""
    x = cp.Variable()
    x.value = -1.0
    with pytest.raises(LCPError, match=r"start|x0"):
        cp.Problem(cp.Minimize(0), [complements(x >= -10, cp.log(x - 5))]).solve(method="LCP")


@pytest.mark.full
def test_a_model_without_solution_is_not_called_solved():
    """exp(x) + 1 = 0 has none: the status is honest, and x keeps the best iterate."""
    x = cp.Variable()
    problem = cp.Problem(cp.Minimize(0), [complements(x, cp.exp(x) + 1 == 0)])
    with pytest.warns(UserWarning, match="inaccurate"):
        problem.solve(method="LCP", max_iterations=30)
    assert problem.status in ("user_limit", "optimal_inaccurate")
    assert x.value is not None


def test_a_wrong_rule_is_noticed_and_the_point_kept(monkeypatch):
    """An atom whose rule disagrees with cvxpy's value causes a warning, and x keeps the computed point."""
    double = lambda u: 2 * np.exp(u)  # noqa: E731
    wrong = functions.Function("exp", 1, double, lambda u: (double(u),))
    from lcp_plugin.modeling import reading

    monkeypatch.setitem(reading.SMOOTH, type(cp.exp(X)), reading._elementary(wrong))
    x = cp.Variable()
    with pytest.warns(ModelWarning, match="evaluates the model to other values"):
        cp.Problem(cp.Minimize(0), [complements(x >= 0, cp.exp(x) - 3 >= 0)]).solve(method="LCP")
    assert x.value == pytest.approx(np.log(1.5))


@pytest.mark.parametrize("d", [1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("is_cube", [False, True])
def test_a_root_at_rounding_level_is_returned(d, is_cube):
    """The root d of eˣ − 1 − d, and that of a cube, are returned although cvxpy's values there are rounding errors."""
    x = cp.Variable()
    x.value = 0.0
    F = cp.power(1 + x, 3) if is_cube else cp.exp(x)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, F - 1 - d >= 0)])
    with warnings.catch_warnings():
        warnings.simplefilter("error", ModelWarning)
        warnings.filterwarnings("ignore", "the solution may be inaccurate")
        problem.solve(method="LCP")
    assert problem.status in ("optimal", "optimal_inaccurate")
    assert x.value == pytest.approx(d / (3 if is_cube else 1), abs=1e-15, rel=1e-7)


def test_a_bearing_whose_oil_thickens_under_pressure():
    """Viscosity e^(α p): the reduced pressure (1 − e^(−α p))/α solves the linear bearing, cavitation included."""
    n, alpha, eccentricity = 400, 0.5, 0.6
    x = np.linspace(0, 2 * np.pi, n + 2)
    film = (1 + eccentricity * np.cos(x[:-1] + np.pi / (n + 1))) ** 3  # h³ between the nodes
    A = (
        sp.diags_array([-film[1:-1], film[:-1] + film[1:], -film[1:-1]], offsets=[-1, 0, 1])
        / x[1] ** 2
    )
    load = -eccentricity * np.sin(x[1:-1])
    linear = solve(LCP(A, load), tolerance=1e-12)
    assert linear.status is Status.SOLVED
    assert alpha * linear.z.max() < 1
    p = cp.Variable(n)
    pair = complements(p >= 0, A @ ((1 - cp.exp(-alpha * p)) / alpha) + load >= 0)
    problem = cp.Problem(cp.Minimize(0), [pair])
    p.value = np.zeros(n)
    # Rounding errors of F are 1e-12 of the reference: no tolerance below them can be met.
    problem.solve(method="LCP", tolerance=1e-10)
    assert problem.status == "optimal"
    np.testing.assert_allclose(p.value, -np.log1p(-alpha * linear.z) / alpha, atol=1e-10)
    assert 0.2 < np.mean(p.value == 0.0) < 0.7  # cavitation
