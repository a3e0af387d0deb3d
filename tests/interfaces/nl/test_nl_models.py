"""Models of .nl files: values, derivatives, solutions and duals, evaluated independently."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from tools.nl_files import content_of_rows
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, QuadraticProgram, Status, UnsupportedModel, complements, solve
from lcp_plugin.expressions.rows import Program
from lcp_plugin.interfaces.nl import model_of, write_nl
from lcp_plugin.interfaces.nl.expressions import UNKNOWNS, Expressions
from lcp_plugin.interfaces.nl.reading import NLContent
from lcp_plugin.modeling.registration import model_of_constraints

INFINITY = math.inf
FUNCTIONS = ("tanh", "tan", "sqrt", "sinh", "sin", "log10", "log", "exp", "cosh", "cos", "atanh")
FUNCTIONS += ("atan2", "atan", "asinh", "asin", "acosh", "acos", "sum")  # numbers 37 to 54
NUMBERS = {"+": 0, "-": 1, "*": 2, "/": 3, "^": 5, "neg": 16}
NUMBERS |= {name: number for number, name in enumerate(FUNCTIONS, 37)}
IN_PYTHON: dict[str, Any] = {name: getattr(cmath, name, None) for name in FUNCTIONS}
IN_PYTHON |= {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "^": lambda a, b: a**b,
    "neg": lambda a: -a,
    "sum": lambda *a: sum(a),
}
STEP = 1e-30  # of complex differentiation, which has no subtraction and so no cancellation

#: A tree: ("+", tree, tree), ("x", 3) a variable or a defined variable, or a number.
Tree = Any


def tokens_of(tree: Tree) -> list[tuple[str, float, int]]:
    """The prefix tokens of a tree, however deep."""
    found, waiting = [], [tree]
    while waiting:
        one = waiting.pop()
        if not isinstance(one, tuple):
            found.append(("n", float(one), 0))
        elif one[0] == "x":
            found.append(("v", one[1], 0))
        else:
            number = NUMBERS[one[0]] if isinstance(one[0], str) else one[0]
            found.append(("o", number, len(one) - 1))
            waiting.extend(one[:0:-1])
    return found


def content_of(
    n: int,
    rows: list[Tree] = [],  # noqa: B006
    *,
    linear: Any = None,
    objective: Tree = None,
    objective_linear: Any = None,
    defined: list[Tree] = [],  # noqa: B006
    defined_linear: Any = None,
    is_maximized: bool = False,
    **own: Any,
) -> NLContent:
    """Return the content of a file; by default rows are equalities to 0, and variables are free."""
    m, d, objectives = len(rows), len(defined), [] if objective is None else [objective]

    def matrix(given: Any, height: int, width: int = n) -> sp.csr_array:
        return (
            sp.csr_array((height, width))
            if given is None
            else sp.csr_array(np.atleast_2d(given).astype(float))
        )

    content = replace(
        content_of_rows(
            np.full(n, -INFINITY),
            np.full(n, INFINITY),
            matrix(linear, m),
            [*map(tokens_of, rows)],
            (np.zeros(m), np.zeros(m)),
            np.full(m, -1),
            np.zeros(m, dtype=np.int64),
        ),
        objective_trees=[*map(tokens_of, objectives)],
        objective_linear=matrix(objective_linear, len(objectives)),
        is_maximized=np.array([is_maximized] * len(objectives), dtype=bool),
        defined_trees=[*map(tokens_of, defined)],
        defined_linear=matrix(defined_linear, d, n + d),
    )
    return replace(
        content,
        **{
            name: np.asarray(value)
            if isinstance(value, list) and name not in ("names", "row_names")
            else value
            for name, value in own.items()
        },
    )


def paired(content: NLContent, lower: float = 0.0, upper: float = INFINITY) -> NLContent:
    """The content with every row complementary to the variable of its number, within these bounds."""
    n = content.lower.size
    kind = int(np.isfinite(lower)) + 2 * int(np.isfinite(upper))
    return replace(
        content,
        lower=np.full(n, lower),
        upper=np.full(n, upper),
        partners=np.arange(n),
        partner_bounds=np.full(n, kind),
        row_lower=np.full(n, -INFINITY),
        row_upper=np.full(n, INFINITY),
    )


def value_of(tree: Tree, x: Any, defined: list[Any]) -> Any:
    """The value of a tree in complex numbers, by Python's own functions."""
    if not isinstance(tree, tuple):
        return complex(tree)
    if tree[0] == "x":
        return x[tree[1]] if tree[1] < len(x) else defined[tree[1] - len(x)]
    return IN_PYTHON[tree[0]](*(value_of(one, x, defined) for one in tree[1:]))


def values_of(trees: list[Tree], defined: list[Tree], linear: np.ndarray, x: Any) -> Any:
    """The values of all trees over x, a list of complex numbers."""
    known: list[Any] = []
    for tree, weights in zip(defined, linear, strict=True):
        known.append(
            value_of(tree, x, known)
            + sum(a * v for a, v in zip(weights, [*x, *known], strict=False))
        )
    return np.array([value_of(tree, x, known) for tree in trees])


def program_of(content: NLContent) -> Program:
    """The program of all rows."""
    found = Expressions(content, np.full(content.lower.size, np.nan))
    return Program.of(
        found.compiler,
        [found.rows(np.arange(len(content.trees)))],
        {UNKNOWNS: 0},
        content.lower.size,
    )


def require_same_derivatives(
    rows: list[Tree], defined: list[Tree], linear: np.ndarray, x: np.ndarray
) -> None:
    """Compare F and F′ with complex arithmetic and complex differentiation."""
    program = program_of(
        content_of(x.size, rows, defined=defined, defined_linear=linear if defined else None)
    )
    steps = x + 1j * STEP * np.eye(x.size)
    F = values_of(rows, defined, linear, list(x.astype(complex))).real
    J = np.array([values_of(rows, defined, linear, list(step)).imag / STEP for step in steps]).T
    np.testing.assert_allclose(program.value(x), F, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        program.jacobian(x).toarray(), J, rtol=1e-11, atol=1e-12 * (1.0 + np.abs(J).max())
    )


X = [("x", k) for k in range(4)]
LEAVES = st.one_of(st.sampled_from(X), st.floats(0.5, 2.0).map(lambda v: round(v, 3)))


def trees(leaves: Any = LEAVES) -> Any:
    """Trees whose values stay finite and smooth at any point between 0 and 1."""

    def larger(below: Any) -> Any:
        bounded = below.map(lambda one: ("*", 0.3, ("tanh", one)))
        return st.one_of(
            st.tuples(st.sampled_from(["+", "-", "*"]), below, below),
            st.tuples(st.just("sum"), below, below, below),
            st.tuples(st.sampled_from(["neg", "tanh", "sin", "cos", "atan", "asinh"]), below),
            st.tuples(
                st.sampled_from(["exp", "sinh", "cosh", "tan", "asin", "acos", "atanh"]), bounded
            ),
            st.tuples(
                st.sampled_from(["sqrt", "log", "log10", "acosh"]),
                bounded.map(lambda one: ("+", one, 1.5)),
            ),
            st.tuples(st.just("/"), below, bounded.map(lambda one: ("+", one, 1.5))),
            st.tuples(st.just("/"), below, st.just(4.0)),
            st.tuples(
                st.just("^"),
                bounded.map(lambda one: ("+", one, 1.5)),
                st.sampled_from([-1.0, 0.0, 1.0, 2.5]),
            ),
            st.tuples(st.just("^"), bounded.map(lambda one: ("+", one, 1.5)), bounded),
            st.tuples(st.just("^"), st.just(1.75), bounded),
        )

    return st.recursive(leaves, larger, max_leaves=12)


@st.composite
def systems(draw: Any) -> tuple[list[Tree], list[Tree], np.ndarray, np.ndarray]:
    """Draw rows, defined variables in order of dependence, their linear terms, and a point."""
    defined: list[Tree] = []
    for k in range(draw(st.integers(0, 3))):
        defined.append(
            draw(trees(st.one_of(LEAVES, st.sampled_from([("x", 4 + j) for j in range(k)] or X))))
        )
    leaves = st.one_of(LEAVES, st.sampled_from([("x", 4 + j) for j in range(len(defined))] or X))
    rows = draw(st.lists(trees(leaves), min_size=1, max_size=3))
    d = len(defined)
    entries = draw(
        st.lists(st.sampled_from([0, 0, 0, 1, -2]), min_size=d * (4 + d), max_size=d * (4 + d))
    )
    linear = np.tril(np.reshape(entries, (d, 4 + d)), 3).astype(float)
    return (
        rows,
        defined,
        linear,
        np.array(draw(st.lists(st.floats(0.05, 0.95), min_size=4, max_size=4))),
    )


@given(systems())
def test_values_and_derivatives_are_those_of_the_trees(system):
    """For any trees and defined variables, F and F′ agree with Python's complex arithmetic."""
    require_same_derivatives(*system)


def stocks(n: int) -> tuple[list[Tree], list[Tree], np.ndarray]:
    """Stocks v_k = v_(k−1)/2 + x_k as defined variables, rows v_k + x_k − 1, and the matrix of these."""
    defined = [("+", ("*", 0.5, ("x", n + k - 1)), ("x", k)) if k else ("x", 0) for k in range(n)]
    rows = [("+", ("x", n + k), ("-", ("x", k), 1.0)) for k in range(n)]
    distance = np.subtract.outer(np.arange(n), np.arange(n))
    return rows, defined, np.where(distance >= 0, 0.5 ** np.maximum(distance, 0), 0.0) + np.eye(n)


def test_long_chains_of_affine_defined_variables_stay_affine():
    """Defined variables that would fill the matrix become unknowns with equations: a sparse LCP."""
    rows, defined, M = stocks(300)
    model = model_of(paired(content_of(300, rows, defined=defined)))
    assert isinstance(model.problem, LCP)
    assert model.problem.nonzeros < 60 * 300
    answer = model.solve(tolerance=1e-12)
    assert answer.x.shape == (300,)
    np.testing.assert_allclose(answer.x, solve(LCP(M, -np.ones(300)), tolerance=1e-12).z, atol=1e-9)
    np.testing.assert_allclose(answer.duals, M @ answer.x - 1.0, atol=1e-9)


def test_arguments_of_functions_stand_below_the_equations_of_such_unknowns():
    """Stocks and eˣ: v_k + x_k + exp(x_k) = 3 has its root in every row."""
    rows, defined, M = stocks(300)
    rows = [("+", row, ("-", ("exp", ("x", k)), 2.0)) for k, row in enumerate(rows)]
    x = model_of(paired(content_of(300, rows, defined=defined))).solve(tolerance=1e-12).x
    np.testing.assert_allclose(M @ x + np.exp(x), 3.0, atol=1e-9)


def random_pairs(seed: int = 3, n: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, q and a solution z of an LCP, the answer first."""
    rng = np.random.default_rng(seed)
    M = rng.integers(-3, 4, (n, n)).astype(float)
    M += np.diag(np.abs(M).sum(axis=1) + 1.0)
    z, w = rng.integers(1, 9, n).astype(float), rng.integers(1, 9, n).astype(float)
    is_zero = np.arange(n) % 2 == 0
    z[is_zero], w[~is_zero] = 0.0, 0.0
    return M, w - M @ z, z


def test_affine_rows_are_the_lcp_that_cvxpy_states():
    """Affine complementarity rows give the LCP of the same model in cvxpy, and its solution; duals are w."""
    M, q, z = random_pairs()
    model = model_of(paired(content_of(6, list(q), linear=M)))
    x = cp.Variable(6)
    theirs = model_of_constraints([complements(x >= 0, M @ x + q >= 0)]).problem
    assert isinstance(model.problem, LCP)
    assert isinstance(theirs, LCP)
    np.testing.assert_array_equal(model.problem.csr.toarray(), theirs.csr.toarray())
    np.testing.assert_array_equal(model.problem.q, theirs.q)
    factors = model_of(paired(content_of(1, [("-", ("*", X[0], 3.0), ("*", 2.0, X[0]))])))
    assert factors.problem.csr.toarray() == [[1.0]]
    answer = model.solve(tolerance=1e-12)
    assert answer.is_solved
    assert answer.code == 0
    np.testing.assert_allclose(answer.x, z, atol=1e-10)
    np.testing.assert_allclose(answer.duals, M @ z + q, atol=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_all_kinds_of_bounds_in_any_order(seed):
    """Lower, upper, both or no bounds, rows in any order, affine and smooth, as Pyomo writes them: all are solved."""
    rng = np.random.default_rng(seed)
    n, kinds, order = 6, np.array([0, 1, 2, 3, 1, 3]), rng.permutation(6)
    root = rng.standard_normal((n, n))
    M, q = root @ root.T + 0.5 * np.eye(n), 3.0 * rng.standard_normal(n)
    lower = np.where(kinds & 1, rng.integers(-2, 2, n), -INFINITY)
    upper = np.where(kinds & 2, np.where(kinds & 1, lower, 0.0) + rng.integers(1, 5, n), INFINITY)
    rows = [
        ("+", q[k], ("*", 0.3, ("tanh", ("x", (k + 1) % n)))) if seed % 2 else q[k] for k in order
    ]
    content = paired(content_of(n, rows, linear=M[order]))
    content = replace(
        content, partners=order, partner_bounds=kinds[order], lower=lower, upper=upper
    )
    answer = model_of(content).solve(tolerance=1e-10)
    assert answer.is_solved
    x = answer.x[:n]
    w = M @ x + q + (0.3 * np.tanh(np.roll(x, -1)) if seed % 2 else 0.0)
    assert np.abs(np.minimum(np.maximum(w, x - upper), x - lower)).max() < 1e-7
    np.testing.assert_allclose(answer.duals[-n:], w[order], atol=1e-6)


P = np.array([[2.0, -1.0, 0.0], [-1.0, 4.0, 1.0], [0.0, 1.0, 6.0]])
COST = np.array([1.0, -2.0, -3.0])
ROWS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [0.0, 1.0, 2.0]])


def quadratic(kind: str) -> tuple[Tree, list[Tree]]:
    """½ xᵀP x in three ways, with its defined variables."""
    if kind == "products":
        return (
            "sum",
            *(("*", P[i, j] / 2, ("*", X[i], X[j])) for i in range(3) for j in range(3) if P[i, j]),
        ), []
    if kind == "squares":
        terms = [("^", X[0], 2.0), ("/", ("^", X[1], 2.0), 0.5), ("*", 3.0, ("*", X[2], X[2]))]
        return ("+", ("sum", *terms), ("*", X[1], ("-", X[2], X[0]))), []
    # Shared: (x0 + x1 + x2)² + … by a defined variable that is used twice.
    total = ("+", ("+", X[0], X[1]), X[2])
    rest = [("*", (P[i, j] - 1.0) / 2.0, ("*", X[i], X[j])) for i in range(3) for j in range(3)]
    return ("+", ("*", 0.5, ("*", ("x", 3), ("x", 3))), ("sum", *rest)), [total]


def program(kind: str, sign: float = 1.0, right: Any = (0.5, 0.25, 1.0)) -> NLContent:
    """A strictly convex program, stated as a maximization where the sign is −1."""
    tree, defined = quadratic(kind)
    return content_of(
        3,
        [0.0, 0.0, 0.0],
        linear=ROWS,
        objective=("+", ("*", sign, tree), 7.0),
        objective_linear=sign * COST,
        defined=defined,
        defined_linear=None,
        is_maximized=sign < 0.0,
        lower=[-5.0] * 3,
        upper=[5.0] * 3,
        row_lower=[right[0], -INFINITY, right[2]],
        row_upper=[right[0], right[1], INFINITY],
    )


@pytest.mark.quick(1)
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["products", "squares", "shared"])
def test_quadratic_objectives_are_recognised(kind, sign):
    """Products, squares and defined variables give P and c; the optimum is cvxpy's, and duals are its derivatives."""
    model = model_of(program(kind, sign))
    assert isinstance(model.problem, QuadraticProgram)
    np.testing.assert_allclose(model.problem.P.toarray(), P, atol=1e-14)
    np.testing.assert_array_equal(model.problem.c, COST)
    answer = model.solve()
    x = cp.Variable(3)
    theirs = cp.Problem(
        cp.Minimize(0.5 * cp.quad_form(x, P) + COST @ x),
        [ROWS[0] @ x == 0.5, ROWS[1] @ x <= 0.25, ROWS[2] @ x >= 1.0, x >= -5, x <= 5],
    )
    theirs.solve(solver=cp.CLARABEL)
    assert answer.is_solved
    assert answer.objective == pytest.approx(sign * theirs.value + 7.0, abs=1e-6)
    np.testing.assert_allclose(answer.x, x.value, atol=1e-5)
    for k in range(3):
        ends = [
            model_of(program(kind, sign, np.array([0.5, 0.25, 1.0]) + step * np.eye(3)[k]))
            .solve()
            .objective
            for step in (1e-4, -1e-4)
        ]
        assert answer.duals[k] == pytest.approx((ends[0] - ends[1]) / 2e-4, abs=1e-6)  # type: ignore[operator]


def objective_of(content: NLContent) -> dict[str, Any]:
    """The objective of a content."""
    names = ("is_maximized", "objective_linear", "objective_trees")
    return {name: getattr(content, name) for name in names}


def one_equation() -> dict[str, Any]:
    """A pair, and an equation."""
    return {
        "partners": np.array([0, -1]),
        "partner_bounds": np.array([1, 0]),
        "row_lower": np.array([-INFINITY, 0.0]),
        "row_upper": np.array([INFINITY, 0.0]),
    }


@refusals(r"""
model_of(content_of(1, [X[0]], is_integer=[True], names=["count"])) → count is an integer variable
model_of(content_of(1, [(15, X[0], X[0])], row_names=["balance"])) → balance holds the operator abs
model_of(content_of(1, [(35, X[0], X[0])], row_names=["balance"])) → balance holds the operator if
model_of(content_of(1, [(99, X[0])])) → operator number 99
model_of(content_of(1, [("*", ("log", -1.0), X[0])])) → log of -1
model_of(content_of(1, [("/", X[0], 0.0)])) → row 0 divides by zero
model_of(content_of(1, [("+", INFINITY, X[0])])) → which is not finite
model_of(content_of(1, [("exp", X[0])], row_upper=[1.0], row_lower=[-INFINITY])) → row 0 is nonlinear
model_of(content_of(1, objective=("exp", X[0]))) → the objective is not quadratic
model_of(replace(paired(content_of(2, X[:2])), partners=np.array([1, 1])))
    → 0 equations and 1 unknown without a complementarity
model_of(content_of(2, [("*", *X[:2])]))
    → 1 equation and 2 unknowns without a complementarity \(variable 0, variable 1\)
model_of(content_of(1, [X[0]], lower=[2.0], upper=[1.0])) → variable 0: lower bound 2 >
model_of(replace(paired(content_of(1, [X[0], 1.0])), **one_equation())) → row 1 holds no unknown
""")
def test_what_is_not_taken_is_named(call, words):
    """Each error names the row or the variable, and the reason."""
    assert_refused(call, words, globals(), UnsupportedModel)


def test_what_the_rounding_of_a_large_row_leaves_open_is_no_missed_sign():
    """z_3 is known to 1e-7 from a row of 10^9, and is all that another row, which must be 0, holds."""
    M = np.array([
        [1767.0789394778778, -15.091112263833528, 451.24801270459926, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [-0.45124801270459924, 0.6687908158483009, 0.5000000000000001, 0.0],
        [454324331.64218384, -446874127.90628374, 200637244.7544903, 3.0],
    ])  # fmt: skip
    low, high = np.array([[-1.0, -INFINITY, 1.0, -INFINITY], [1.0, 0.0, 3.0, INFINITY]])
    content = paired(
        content_of(
            4, [-2391.777943611688, 0.0, 0.049416058554031486, -1278150608.7731402], linear=M
        )
    )
    answer = model_of(
        replace(content, lower=low, upper=high, partner_bounds=np.array([3, 2, 3, 0]))
    ).solve()
    assert answer.is_solved


def test_statuses_tell_the_truth():
    """Infeasible and unbounded programs have AMPL's codes; equations that hold only beyond bounds are unsolved."""
    infeasible = content_of(
        1, [0.0], linear=[[1.0]], row_lower=[2.0], row_upper=[INFINITY], upper=[1.0]
    )
    answer = model_of(infeasible).solve()
    assert (answer.status, answer.code, answer.objective) == (Status.INFEASIBLE, 200, None)
    unbounded = content_of(1, objective=0.0, objective_linear=[[1.0]], upper=[1.0])
    assert model_of(unbounded).solve().code == 300
    circle = [("-", ("^", X[0], 2.0), 4.0)]
    inside = model_of(content_of(1, circle, lower=[0.0], upper=[5.0], start=[1.0])).solve(
        tolerance=1e-12
    )
    assert inside.is_solved
    assert inside.x[0] == pytest.approx(2.0, abs=1e-12)
    outside = model_of(content_of(1, circle, lower=[3.0], upper=[5.0], start=[4.0])).solve()
    assert outside.status is Status.STALLED
    assert outside.code == 500
    assert "equations are solved, but variable 0 does not hold" in outside.message


def test_fixed_and_unused_variables_and_empty_rows_change_nothing():
    """A fixed variable is its value, also as an exponent; an unused variable stays at its start."""
    rows = [("-", ("^", X[0], X[1]), 9.0), 0.0]
    content = replace(
        paired(content_of(3, [*rows, 0.0])),
        lower=np.array([0.0, 2.0, -INFINITY]),
        upper=np.array([INFINITY, 2.0, INFINITY]),
        partners=np.array([0, -1, -1]),
        start=np.array([1.0, 0.0, 5.0]),
        has_start=np.ones(3, dtype=bool),
        row_lower=np.array([-INFINITY, 0.0, -INFINITY]),
        row_upper=np.array([INFINITY, 0.0, INFINITY]),
    )
    answer = model_of(content).solve(tolerance=1e-12)
    np.testing.assert_allclose(answer.x, [3.0, 2.0, 5.0], rtol=1e-12)


def test_a_long_defined_variable_that_many_rows_share_is_taken_in_a_program():
    """The least S = Σ x with S + x_i ≥ 1 for 80 rows is 80/81; S is a defined variable, too long to be put in."""
    rows, ones = [("x", 80)] * 80, np.ones((1, 80))
    defined = {"defined": [0.0], "defined_linear": np.append(ones, [[0.0]], axis=1)}
    goal = {"objective": 0.0, "objective_linear": ones, "lower": np.zeros(80)}
    limits = {"row_lower": np.ones(80), "row_upper": np.full(80, INFINITY)}
    answer = model_of(content_of(80, rows, linear=np.eye(80), **defined, **goal, **limits)).solve()
    assert abs(answer.objective - 80 / 81) < 1e-8
    np.testing.assert_allclose(answer.duals, 1 / 81, atol=1e-8)


def test_a_fixed_variable_in_a_defined_one_is_its_value():
    """With v = 3 x₁ + x₀, x₁ = 2 and v = 10, x₀ is 4."""
    content = content_of(
        2, [("-", ("x", 2), 10.0)], defined=[X[0]], defined_linear=[[0.0, 3.0, 0.0]]
    )
    content = replace(content, lower=np.array([-INFINITY, 2.0]), upper=np.array([INFINITY, 2.0]))
    assert model_of(content).solve().x.tolist() == [4.0, 2.0]


def beside_pairs(kind: str, at: float) -> NLContent:
    """Return 0 ≤ x₀ ⟂ x₀ − 2 ≥ 0, solved by x₀ = 2, and a constraint equivalent to x₀ ≤ at."""
    one = replace(
        paired(content_of(2, [("-", X[0], 2.0), ("exp", X[0])])), partners=np.array([0, -1])
    )
    one = replace(one, lower=np.array([0.0, -INFINITY]))
    if kind == "inequality":
        return replace(one, row_upper=np.array([INFINITY, math.exp(at)]))
    equation = content_of(2, [("-", X[0], 2.0), ("-", X[1], X[0])])
    return replace(
        one,
        trees=equation.trees,
        upper=np.array([INFINITY, at]),
        row_lower=np.array([-INFINITY, 0.0]),
        row_upper=np.array([INFINITY, 0.0]),
    )


@pytest.mark.parametrize("kind", ["inequality", "bound of another"])
def test_what_stands_beside_complementarities_is_held_against_the_answer(kind, tmp_path):
    """An inequality or bound without a pair gives SOLVED or infeasible."""
    holds = model_of(beside_pairs(kind, 3.0)).solve()
    assert (holds.status, holds.x[0]) == (Status.SOLVED, pytest.approx(2.0))
    fails = model_of(beside_pairs(kind, 1.0)).solve()
    name, status = {
        "inequality": (
            "row 1",
            Status.STALLED,
        ),  # smooth: SCIP finds no solution, and proves nothing
        "bound of another": ("variable 1", Status.INFEASIBLE),
    }[kind]
    assert fails.status is status
    assert f"{name} does not hold, off by" in fails.message
    write_nl(beside_pairs(kind, 3.0), tmp_path / "m.nl")
    with pytest.raises(UnsupportedModel, match=rf"more than a complementarity problem: {name}"):
        LCP.load(tmp_path / "m.nl")


@pytest.mark.parametrize(("sign", "wanted"), [(1.0, [0.0, 0.0]), (-1.0, [0.5, 0.0])])
def test_a_bound_that_a_pair_does_not_state_is_a_plain_one_beside_an_objective(sign, wanted):
    """0 ≤ x₀ ⟂ x₁ ≥ 0 and x₀ ≤ ½ of its own: at ½ nothing is gained by x₁ < 0."""
    objective = content_of(2, objective=0.0, objective_linear=[[sign, 1.0]])
    pair = paired(content_of(2, [X[1], 0.0]))
    content = replace(pair, **objective_of(objective), partners=np.array([0, -1]), lower=np.array([0.0, -9.0]),
                      upper=np.array([0.5, 9.0]))  # fmt: skip
    answer = model_of(content).solve()
    assert answer.is_solved
    np.testing.assert_allclose(answer.x, wanted, atol=1e-9)


def test_lcp_load_reads_the_affine_ones(tmp_path):
    """LCP.load reads affine complementarity files; the error for others names read_nl."""
    M, q, _ = random_pairs()
    write_nl(paired(content_of(6, list(q), linear=M)), tmp_path / "m.nl")
    np.testing.assert_array_equal(LCP.load(tmp_path / "m.nl").csr.toarray(), M)
    write_nl(program("products"), tmp_path / "p.nl")
    with pytest.raises(UnsupportedModel, match=r"p\.nl states a QuadraticProgram, not .*read_nl"):
        LCP.load(tmp_path / "p.nl")
    write_nl(best(), tmp_path / "b.nl")
    with pytest.raises(UnsupportedModel, match=r"b\.nl states an EquilibriumProgram, not an LCP"):
        LCP.load(tmp_path / "b.nl")


def best() -> NLContent:
    """The least x₁ of 0 ≤ x₀ ⟂ x₀ + x₁ − 1 ≥ 0."""
    pair = paired(content_of(2, [("-", ("+", X[0], X[1]), 1.0), 0.0]))
    objective = content_of(2, objective=0.0, objective_linear=[[0.0, 1.0]])
    return replace(pair, **objective_of(objective), partners=np.array([0, -1]))


def test_a_side_condition_holds_as_closely_as_the_tolerance_asks():
    """Ten times a loose tolerance is allowed: the start 2.00005 solves x = 2, and misses exp(x) ≤ exp(2) by 4e-4."""
    model = beside_pairs("inequality", 2.0)
    start = replace(model, start=np.array([2.00005, 0.0]), has_start=np.array([True, True]))
    loose = model_of(start).solve(tolerance=1e-4)
    assert (loose.status, loose.x[0]) == (Status.SOLVED, 2.00005)
    assert model_of(start).solve().x[0] == pytest.approx(2.0, abs=1e-6)
