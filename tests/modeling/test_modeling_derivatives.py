"""problem.backward() and problem.derivative() after solves by this package: exact, documented, never stale."""

from __future__ import annotations

import copy
import pickle
import tracemalloc
import warnings
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from fresh_process import printed_by
from hypothesis import given
from hypothesis import strategies as st
from test_extraction import FORMS, SPARSE, Unknowns, expression

from lcp_plugin import ModelWarning, UnsuitableProblem, UnsupportedModel, box, certify, complements
from lcp_plugin.modeling._compat import refuse_without_derivatives
from lcp_plugin.modeling.model_derivative import ParametricRows
from lcp_plugin.modeling.reading import Reader, folded
from lcp_plugin.modeling.registration import ComplementarityProblem

LEAVES = ("s", "x", "y", "X", "Y", "c", "Z")
Parts = tuple[Any, list[Any], list[Any], list[Any]]


class ParametersForUnknowns(Unknowns):
    """Parameters in the place of the variables."""

    def __init__(self, among: tuple[str, ...] = LEAVES) -> None:
        super().__init__()
        generator = np.random.default_rng(5)
        for name in (*among, "p", "v", "P"):
            leaf = getattr(self, name)
            setattr(
                self,
                name,
                cp.Parameter(leaf.shape, name=name, value=generator.uniform(0.5, 2.0, leaf.shape)),
            )


def changes(leaves: list[Any], seed: int = 0) -> list[Any]:
    generator = np.random.default_rng(seed)
    return [generator.standard_normal(leaf.shape) for leaf in leaves]


def dot(left: list[Any], right: list[Any]) -> float:
    return float(sum(np.sum(a * b) for a, b in zip(left, right, strict=True)))


# --- expressions --------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:conv is deprecated")
@pytest.mark.parametrize("name", FORMS)
def test_every_affine_form_is_differentiated_by_its_parameters(name: str) -> None:
    """With parameters in the place of variables the change is M times theirs, and the gradient is Mᵀ's."""
    F = expression(name)
    if name == "sum axis -1" and F.shape != (3,):
        pytest.skip(f"cvxpy {cp.__version__} gives it the shape {F.shape}")
    known, unknowns = Reader().rows(F), ParametersForUnknowns()
    for leaf in "pvP":  # these are parameters in both
        getattr(unknowns, leaf).value = getattr(Unknowns(), leaf).value
    twin = FORMS[name](unknowns)
    variables = {variable.name(): variable for variable in F.variables()}
    parameters = [parameter for parameter in twin.parameters() if parameter.name() in variables]
    moved, g = changes(parameters), np.random.default_rng(1).standard_normal(F.size)
    expected = np.zeros(F.size)
    for parameter, change in zip(parameters, moved, strict=True):
        expected += known.blocks[variables[parameter.name()].id] @ np.ravel(change, order="F")
    parametric = ParametricRows([twin], {})
    found = parametric.change({p.id: change for p, change in zip(parameters, moved, strict=True)})
    np.testing.assert_allclose(
        found, expected, atol=1e-13 * (1.0 + np.abs(expected).max(initial=0.0))
    )
    gradients = parametric.gradient(g)
    for parameter in parameters:
        column = known.blocks[variables[parameter.name()].id].T @ g
        np.testing.assert_allclose(np.ravel(gradients[parameter.id], order="F"), column, atol=1e-12)


CURVED: dict[str, Callable[[Any], Any]] = {
    "square": lambda u: u.x**2 + u.y,
    "reciprocal": lambda u: u.y / u.x + 1 / u.p,
    "exp times matrix": lambda u: (cp.exp(u.p) * SPARSE) @ u.x,
    "product of three": lambda u: u.P @ u.Y @ u.x,
    "quadratic form": lambda u: cp.quad_form(u.x, np.eye(4) + 1.0) * u.y,
    "two scaled sparse": lambda u: (u.s * SPARSE + u.p * SPARSE.T) @ u.x,
    "sparse product": lambda u: (u.s * SPARSE) @ (u.p * SPARSE) @ u.x,
    "sparse transposed and divided": lambda u: (u.s * SPARSE).T @ u.x / u.p + (SPARSE / u.s) @ u.y,
    "sparse blocks": lambda u: (
        cp.bmat([[u.s * SPARSE, -SPARSE], [SPARSE * u.p, SPARSE / u.p]]) @ cp.hstack([u.x, u.y])
    ),
    "sparse sums": lambda u: (
        cp.sum(u.s * SPARSE, axis=0) @ u.x + cp.sum(cp.sum(u.p * SPARSE, axis=1))
    ),
    "on a sparse pattern": lambda u: (
        cp.multiply(u.Y, SPARSE) @ u.x + cp.multiply(u.s * SPARSE, u.p * SPARSE) @ u.y
    ),
    "row times sparse": lambda u: u.x @ (u.s * SPARSE),
    "Gram matrix applied": lambda u: (
        (u.P.T @ u.P + np.eye(4)) @ u.x - (u.P @ u.Y + u.Y) @ (u.Y @ u.x)
    ),
    "sparse kron": lambda u: cp.kron(u.s * SPARSE, np.eye(2)) @ cp.hstack([u.x, u.y]),
    "log and root": lambda u: cp.log(u.x) + cp.sqrt(u.y) + cp.norm(u.v),
    "largest": lambda u: cp.maximum(u.x, 3 * u.y) + cp.max(u.v),
    "the same twice": lambda u: cp.multiply(u.x, u.x) + u.x,
}


@pytest.mark.parametrize("held", [(), ("y", "X")], ids=["parameters", "beside variables"])
@pytest.mark.parametrize("name", CURVED)
def test_parameters_need_not_enter_affinely(name: str, held: tuple[str, ...]) -> None:
    """The change is that of central differences, and ⟨g, forward(h)⟩ = ⟨backward(g), h⟩."""
    unknowns = ParametersForUnknowns(tuple(leaf for leaf in LEAVES if leaf not in held))
    F = CURVED[name](unknowns)
    values = {
        variable.id: np.random.default_rng(8).uniform(0.5, 2.0, variable.shape)
        for variable in F.variables()
    }
    parameters, g = F.parameters(), np.random.default_rng(1).standard_normal(F.size)
    moved, step = changes(parameters), 1e-5
    parametric = ParametricRows([F], values)
    found = parametric.change({p.id: change for p, change in zip(parameters, moved, strict=True)})
    ends = []
    for side in (1.0, -1.0):
        at = {
            p.id: p.value + side * step * change
            for p, change in zip(parameters, moved, strict=True)
        }
        ends.append(np.ravel(folded(F, Reader(held={**values, **at})._value, {}), order="F"))
    np.testing.assert_allclose(found, (ends[0] - ends[1]) / (2 * step), rtol=1e-7, atol=1e-7)
    gradients = parametric.gradient(g)
    adjoint = dot([gradients[p.id] for p in parameters], moved)
    assert abs(adjoint - g @ found) <= 1e-13 * (1.0 + np.abs(g) @ np.abs(found))


def test_a_scaled_sparse_matrix_stays_sparse() -> None:
    """The derivative by k in (k A) @ x with n = 4000 takes less than a tenth of one dense n × n array."""
    n = 4000
    A = sp.csr_array(sp.diags_array([-1.0, 4.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)))
    k, x = cp.Parameter(value=2.0), cp.Variable(n)
    F = (k * A + A.T / k) @ x
    parametric = ParametricRows([F], {x.id: np.ones(n)})
    tracemalloc.start()
    try:
        total = parametric.gradient(np.ones(n))[k.id]
        change = parametric.change({k.id: np.array(1.0)})
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.1 * 8 * n * n
    np.testing.assert_allclose([total, change.sum()], A.sum() * 0.75, rtol=1e-13)


def test_products_of_matrices_are_applied_from_the_right() -> None:
    """The derivative by P of (PᵀP + I) x with n = 150 takes less than n³ numbers; written out, it has more."""
    n = 150
    P, x = (
        cp.Parameter((n, n), value=np.random.default_rng(0).standard_normal((n, n))),
        cp.Variable(n),
    )
    F = (P.T @ P + np.eye(n)) @ x
    tracemalloc.start()
    try:
        found = ParametricRows([F], {x.id: np.ones(n)}).gradient(np.arange(n))[P.id]
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * n**3
    u, v = np.arange(n), np.ones(n)
    expected = np.outer(P.value @ v, u) + np.outer(P.value @ u, v)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


# --- models: the answer first -------------------------------------------------------------------------------------

M2, Z2 = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([2.5, 0.0])


def two_unknowns() -> Any:
    """A model with the solution x = (5/2, 0), w = (0, 7/2)."""
    M, q = cp.Parameter((2, 2), name="M", value=M2), cp.Parameter(2, name="q", value=[-5.0, 1.0])
    x = cp.Variable(2, name="x")
    problem = ComplementarityProblem([complements(x >= 0, M @ x + q >= 0)])
    return problem, M, q, x


def test_gradients_of_dual_values() -> None:
    """A gradient set on the pair's dual variable is that by w; x's own is taken out with zeros."""
    problem, M, q, x = two_unknowns()
    pair = problem.constraints[0]
    problem.solve(requires_grad=True)
    x.gradient, pair.dual_variables[0].gradient = np.zeros(2), np.array([0.0, 1.0])
    problem.backward()  # w₂ = x₁ + q₂ = −q₁/2 + q₂ = −m₂₁ q₁/m₁₁ + q₂
    np.testing.assert_allclose(q.gradient, [-0.5, 1.0], atol=1e-14)
    np.testing.assert_allclose(M.gradient, [[-1.25, 0.0], [2.5, 0.0]], atol=1e-14)
    M.delta = np.array([[0.0, 0.0], [2.0, 0.0]])
    problem.derivative()
    np.testing.assert_allclose(pair.dual_variables[0].delta, [0.0, 5.0], atol=1e-13)


@given(seed=st.integers(0, 10**6), n=st.integers(1, 6))
def test_derivatives_are_the_formula_of_a_planted_solution(seed: int, n: int) -> None:
    """With z chosen first, dz_F = −M_FF⁻¹ (dM z + dq + M_FA db)_F, dz_A = db, to rounding, also of its adjoint."""
    r = np.random.default_rng(seed)
    state = r.integers(-1, 2, n)  # at lower, between, at upper
    low, high = -r.integers(1, 4, n).astype(float), r.integers(1, 4, n).astype(float)
    z = np.where(state < 0, low, np.where(state > 0, high, r.uniform(-0.5, 0.5, n)))
    w = np.where(state == 0, 0.0, -state * r.uniform(1.0, 2.0, n))
    A = r.uniform(-1.0, 1.0, (n, n)) + 2 * n * np.eye(n)
    M, q = cp.Parameter((n, n), value=A), cp.Parameter(n, value=w - A @ z)
    lower, upper, x = cp.Parameter(n, value=low), cp.Parameter(n, value=high), cp.Variable(n)
    problem = ComplementarityProblem(complements(box(x, lower, upper), M @ x + q))
    problem.solve(requires_grad=True)
    parameters = [M, q, lower, upper]
    moved = changes(parameters, seed)
    for parameter, change in zip(parameters, moved, strict=True):
        parameter.delta = change
    problem.derivative()
    free = state == 0
    expected = np.where(state < 0, moved[2], np.where(state > 0, moved[3], 0.0))
    right = moved[0] @ z + moved[1] + A @ expected
    expected[free] = -np.linalg.solve(A[np.ix_(free, free)], right[free])
    np.testing.assert_allclose(x.delta, expected, atol=1e-12 * (1.0 + np.abs(expected).max()))
    x.gradient = r.standard_normal(n)
    problem.backward()
    adjoint = dot([parameter.gradient for parameter in parameters], moved)
    assert abs(adjoint - x.gradient @ x.delta) <= 1e-12 * (
        1.0 + np.abs(x.gradient) @ np.abs(x.delta)
    )


# --- models of all kinds ------------------------------------------------------------------------------------------


def dominant(r: Any, n: int) -> Any:
    return r.standard_normal((n, n)) * 0.3 + n * np.eye(n)


def matrix_and_offset(r: Any) -> Parts:
    M, q = (
        cp.Parameter((6, 6), value=dominant(r, 6)),
        cp.Parameter(6, value=10 * r.standard_normal(6)),
    )
    x = cp.Variable(6)
    pair = complements(x >= 0, M @ x + q >= 0)
    return (
        ComplementarityProblem(pair),
        [M, q],
        [x],
        [pair, pair.first.constraint, pair.second.constraint],
    )


def not_disciplined(r: Any) -> Parts:
    p, s, x = cp.Parameter(value=1.3), cp.Parameter(5, value=r.uniform(1, 2, 5)), cp.Variable(5)
    A, q = sp.csr_array(dominant(r, 5)), 10 * r.standard_normal(5)
    F = (cp.exp(p) * A + p**2 * np.eye(5)) @ x + p * cp.multiply(s, q)
    pair = complements(cp.multiply(s**2, x) - 1 / p >= 0, F >= 0)
    return (
        ComplementarityProblem(pair),
        [p, s],
        [x],
        [pair, pair.first.constraint, pair.second.constraint],
    )


def boxed(r: Any) -> Parts:
    lower, upper = cp.Parameter(6, value=-r.uniform(0.1, 1, 6)), cp.Parameter(value=0.5)
    q, x = cp.Parameter(6, value=20 * r.standard_normal(6)), cp.Variable(6)
    pair = complements(box(x, lower, 2 * upper), dominant(r, 6) @ x + q)
    return ComplementarityProblem(pair), [lower, upper, q], [x], [pair]


def definitions_and_equations(r: Any) -> Parts:
    q, k = cp.Parameter(5, value=10 * r.standard_normal(5)), cp.Parameter(value=0.7)
    B = cp.Parameter((2, 5), value=r.standard_normal((2, 5)))
    x, w, y = cp.Variable(5, nonneg=True), cp.Variable(5, nonneg=True), cp.Variable(2)
    pair = complements(x >= 0, w >= 0)
    defined = w == (k * dominant(r, 5)) @ x + q - B.T @ y
    balance = (k * (np.eye(2) + 0.1 * r.standard_normal((2, 2)))) @ y == -B @ x + k
    return (
        ComplementarityProblem([pair, defined, balance]),
        [q, B, k],
        [x, w, y],
        [pair, defined, balance],
    )


def two_functions(r: Any) -> Parts:
    q, k, x = (
        cp.Parameter(4, value=10 * r.standard_normal(4)),
        cp.Parameter(value=1.2),
        cp.Variable(4),
    )
    pair = complements((k * dominant(r, 4)) @ x + q * k >= 0, dominant(r, 4) @ x - q >= 0)
    return (
        ComplementarityProblem(pair),
        [q, k],
        [x],
        [pair, pair.first.constraint, pair.second.constraint],
    )


def several_pairs(r: Any) -> Parts:
    X, y, B = cp.Variable((2, 3)), cp.Variable(4, bounds=[-1, 1]), 0.3 * r.standard_normal((4, 6))
    P, Q = (
        cp.Parameter((2, 2), value=dominant(r, 2)),
        cp.Parameter((2, 3), value=4 * r.standard_normal((2, 3))),
    )
    t, psi = (
        cp.Parameter(pos=True, value=2.0),
        cp.Parameter((2, 3), value=r.standard_normal((2, 3))),
    )
    F = P @ X + X + Q - cp.reshape(B.T @ y, (2, 3), order="F")
    first = complements(psi <= X, F >= 0)
    second = complements(y, 5 * t * y + B @ cp.vec(X, order="F") - cp.sum(Q) / t)
    return (
        ComplementarityProblem([first, second]),
        [P, Q, t, psi],
        [X, y],
        [first, second, first.second.constraint],
    )


def upper_bounds(r: Any) -> Parts:
    a, b = cp.Parameter(5, value=r.uniform(1, 2, 5)), cp.Parameter(5, value=r.standard_normal(5))
    q, x = cp.Parameter(5, value=10 * r.standard_normal(5)), cp.Variable(5)
    pair = complements(b - cp.multiply(a, x) >= 0, q - dominant(r, 5) @ x >= 0)
    return (
        ComplementarityProblem(pair),
        [a, b, q],
        [x],
        [pair, pair.first.constraint, pair.second.constraint],
    )


def bounds_of_the_variable(r: Any) -> Parts:
    lower, upper = (
        cp.Parameter(5, value=-r.uniform(0.1, 1, 5)),
        cp.Parameter(5, value=r.uniform(0.1, 1, 5)),
    )
    try:
        x = cp.Variable(5, bounds=[lower, upper])
    except ValueError as error:
        pytest.skip(f"cvxpy {cp.__version__} refuses parameters as bounds: {error}")
    q = cp.Parameter(5, value=20 * r.standard_normal(5))
    pair = complements(x, dominant(r, 5) @ x + q)
    return ComplementarityProblem(pair), [lower, upper, q], [x], [pair]


def parts_of_a_variable(r: Any) -> Parts:
    q, u = (
        cp.Parameter(6, value=10 * r.standard_normal(6)),
        cp.Parameter(3, value=r.standard_normal(3)),
    )
    x = cp.Variable(6)
    F = dominant(r, 6) @ x + q
    first, second = (
        complements(x[:3] >= u, F[:3] >= 0),
        complements(box(x[3:], -1, cp.exp(u)), F[3:]),
    )
    return (
        cp.Problem(cp.Minimize(0), [first, second]),
        [q, u],
        [x],
        [first, second, first.first.constraint],
    )


def chain_of_definitions(r: Any) -> Parts:
    q, k = cp.Parameter(4, value=10 * r.standard_normal(4)), cp.Parameter(value=2.0)
    x, a, b, t = cp.Variable(4), cp.Variable(4), cp.Variable(4), cp.Variable()
    pair = complements(x >= 0, b >= 0)
    chain = [
        a == k * (dominant(r, 4) @ x) - t,
        b == a / k + q * k + t * k,
        t == cp.sum(x) / k + k**2,
    ]
    return cp.Problem(cp.Minimize(0), [pair, *chain]), [q, k], [x, a, b, t], [pair, *chain]


def fixed_by_a_parameter(r: Any) -> Parts:
    q, at = (
        cp.Parameter(4, value=10 * r.standard_normal(4)),
        cp.Parameter(4, value=r.standard_normal(4)),
    )
    x = cp.Variable(4)
    pair = complements(box(x, at, at), dominant(r, 4) @ x + q)
    return cp.Problem(cp.Minimize(0), [pair]), [q, at], [x], [pair]


def free_with_its_equation(r: Any) -> Parts:
    q, k = cp.Parameter(4, value=10 * r.standard_normal(4)), cp.Parameter(value=2.0)
    x, y, B = cp.Variable(4, nonpos=True), cp.Variable(2), r.standard_normal((2, 4))
    pair = complements(x, dominant(r, 4) @ x + q - B.T @ y <= 0)
    equation = complements(y, (k * np.eye(2)) @ y + B @ x - k == 0)
    problem = cp.Problem(cp.Minimize(0), [pair, equation])
    return problem, [q, k], [x, y], [pair, equation, equation.second.constraint]


MODELS = (
    *(
        matrix_and_offset,
        not_disciplined,
        boxed,
        definitions_and_equations,
        two_functions,
        several_pairs,
    ),
    *(
        upper_bounds,
        bounds_of_the_variable,
        parts_of_a_variable,
        chain_of_definitions,
        fixed_by_a_parameter,
    ),
    free_with_its_equation,
)

# --- quadratic and linear programs --------------------------------------------------------------------------------


def least_squares(r: Any) -> Parts:
    b, k, x = (
        cp.Parameter(8, value=r.standard_normal(8)),
        cp.Parameter(nonneg=True, value=0.4),
        cp.Variable(4),
    )
    rows = [x >= -0.1, cp.sum(x) == k]
    goal = cp.sum_squares(r.standard_normal((8, 4)) @ x - b) + k * cp.norm1(x)
    return cp.Problem(cp.Minimize(goal), rows), [b, k], [x], rows


def fitted_matrix(r: Any) -> Parts:
    A, x = cp.Parameter((8, 4), value=r.standard_normal((8, 4))), cp.Variable(4, nonneg=True)
    rows = [np.ones(4) @ x <= 0.5]
    return (
        cp.Problem(cp.Minimize(cp.sum_squares(A @ x - r.standard_normal(8))), rows),
        [A],
        [x],
        rows,
    )


def maximum(r: Any) -> Parts:
    p, G = (
        cp.Parameter(3, value=r.standard_normal(3)),
        cp.Parameter((5, 3), value=r.standard_normal((5, 3))),
    )
    x, t = cp.Variable(3), cp.Variable(bounds=[-1, 2])
    rows = [G @ x <= 1 + t, t >= 0.1 * cp.sum(p)]
    return (
        cp.Problem(cp.Maximize(p @ x - cp.sum_squares(x) - cp.square(t)), rows),
        [p, G],
        [x, t],
        rows,
    )


def linear_program(r: Any) -> Parts:
    h, c, x = (
        cp.Parameter(9, value=r.uniform(1, 2, 9)),
        cp.Parameter(3, value=r.standard_normal(3)),
        cp.Variable(3),
    )
    rows = [r.standard_normal((9, 3)) @ x <= h, x <= 3, x >= -3]
    return cp.Problem(cp.Minimize(c @ x), rows), [h, c], [x], rows[:1]


def symmetric_variable(r: Any) -> Parts:
    p, X = (
        cp.Parameter((3, 3), value=r.standard_normal((3, 3))),
        cp.Variable((3, 3), symmetric=True),
    )
    rows = [p - 1 <= X, cp.trace(X) == 1]
    return cp.Problem(cp.Minimize(cp.sum_squares(X - p)), rows), [p], [X], rows[1:]


def huber(r: Any) -> Parts:
    b, w = (
        cp.Parameter(9, value=3 * r.standard_normal(9)),
        cp.Parameter(3, nonneg=True, value=r.uniform(1, 2, 3)),
    )
    x = cp.Variable(3)
    goal = cp.sum(cp.huber(r.standard_normal((9, 3)) @ x - b)) + w @ cp.abs(x)
    return cp.Problem(cp.Minimize(goal)), [b, w], [x], []


PROGRAMS = (least_squares, fitted_matrix, maximum, linear_program, symmetric_variable, huber)


def solved(problem: Any, **options: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        problem.solve(method="LCP", tolerance=1e-12, **options)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("make", [*MODELS, *PROGRAMS], ids=lambda make: make.__name__)
def test_derivatives_agree_with_differences_of_solves(
    make: Callable[[Any], Parts], seed: int
) -> None:
    """Changes of values and dual values are central differences of tight solves; backward is the adjoint."""
    problem, parameters, variables, constraints = make(np.random.default_rng(seed))
    solved(problem, requires_grad=True)
    duals = [constraint.dual_variables[0] for constraint in constraints]
    moved, step = changes(parameters), 1e-6
    for parameter, change in zip(parameters, moved, strict=True):
        parameter.delta = change
    for variable in problem.variables():
        variable.gradient = np.zeros(variable.shape)
    for leaf, gradient in zip((*variables, *duals), changes([*variables, *duals], 1), strict=True):
        leaf.gradient = gradient
    problem.derivative()
    problem.backward()
    found, gradients = (
        [leaf.delta for leaf in (*variables, *duals)],
        [leaf.gradient for leaf in (*variables, *duals)],
    )
    forward, adjoint = (
        dot(gradients, found),
        dot([parameter.gradient for parameter in parameters], moved),
    )
    size = dot([np.abs(gradient) for gradient in gradients], [np.abs(change) for change in found])
    assert abs(forward - adjoint) <= 1e-12 * size
    base, ends = [parameter.value for parameter in parameters], []
    for side in (1.0, -1.0):
        for parameter, value, change in zip(parameters, base, moved, strict=True):
            parameter.value = value + side * step * change
        solved(problem)
        ends.append([np.asarray(leaf.value) for leaf in (*variables, *duals)])
    for before, after, change in zip(ends[1], ends[0], found, strict=True):
        np.testing.assert_allclose(change, (after - before) / (2 * step), atol=3e-7)


@pytest.mark.parametrize(
    "attributes", [{"nonpos": True}, {"bounds": [-3.0, 1.5]}, {"bounds": [-2.5, -0.5]}], ids=str
)
def test_entries_of_bounded_variables_are_found(attributes: dict[str, Any]) -> None:
    """Of x = p inside any bounds of its own the change is that of p, and the values can be certified."""
    p, x, y = (
        cp.Parameter(4, value=[-1.0, -2.0, -1.5, -1.2]),
        cp.Variable(4, **attributes),
        cp.Variable(2),
    )
    problem = cp.Problem(cp.Minimize(cp.sum_squares(x - p) + cp.sum_squares(y - p[:2])))
    problem.solve(method="LCP", requires_grad=True)
    p.delta = np.arange(1.0, 5.0)
    problem.derivative()
    np.testing.assert_allclose(x.delta, p.delta, atol=1e-12)
    said = certify(problem)
    assert (
        said.verdict == "proved" or said.gap <= 1e-30
    )  # beside a minimum of 0 an ulp of x is no small error
    assert said.distance is not None
    assert said.distance <= 1e-15


@pytest.mark.parametrize("make", PROGRAMS, ids=lambda make: make.__name__)
def test_derivatives_agree_with_cvxpys_own(make: Callable[[Any], Parts]) -> None:
    """Where diffcp is installed, both fill the same gradients and changes."""
    pytest.importorskip("diffcp")
    problem, parameters, variables, _ = make(np.random.default_rng(0))
    for parameter in parameters:
        parameter.delta = np.ones(parameter.shape)
    problem.solve(requires_grad=True, eps=1e-10)
    problem.backward()
    problem.derivative()
    expected = [leaf.gradient for leaf in parameters] + [leaf.delta for leaf in variables]
    solved(problem, requires_grad=True)
    problem.backward()
    problem.derivative()
    found = [leaf.gradient for leaf in parameters] + [leaf.delta for leaf in variables]
    for own, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(own, theirs, atol=1e-5)


# --- degenerate, old, copied --------------------------------------------------------------------------------------


def test_at_a_kink_backward_gives_one_piece_and_derivative_one_side() -> None:
    """Of x = max(−q/2, 0) at q = 0 the gradient is 0 or −1/2, the change that of the side."""
    q, x = cp.Parameter(value=0.0), cp.Variable()
    problem = ComplementarityProblem(complements(x >= 0, 2 * x + q >= 0))
    problem.solve(requires_grad=True)
    problem.backward()
    assert float(q.gradient) in (0.0, -0.5)
    for side, change in ((1.0, 0.0), (-1.0, 0.5)):
        q.delta = side
        problem.derivative()
        assert float(x.delta) == change


def test_a_program_at_a_kink_moves_to_one_side() -> None:
    """The minimum of (x − p)² over x ≥ 0 is max(p, 0), with the multiplier max(−2 p, 0): at p = 0 each side its own."""
    p, x = cp.Parameter(value=0.0), cp.Variable()
    rows = [x >= 0]
    problem = cp.Problem(cp.Minimize(cp.square(x - p)), rows)
    problem.solve(method="LCP", requires_grad=True)
    for side, change, multiplier in ((1.0, 1.0, 0.0), (-1.0, 0.0, 2.0)):
        p.delta = side
        problem.derivative()
        assert [float(x.delta), float(rows[0].dual_variables[0].delta)] == [change, multiplier]
    problem.backward()
    assert float(p.gradient) in (0.0, 1.0)


def test_derivatives_are_at_the_values_of_the_solve() -> None:
    """A parameter that has changed since, even in place, changes nothing before the next solve."""
    k, q, x = cp.Parameter(value=2.0), cp.Parameter(1, value=[-6.0]), cp.Variable(1)
    problem = ComplementarityProblem(complements(x >= 0, k * x + q >= 0))
    problem.solve(requires_grad=True)
    k.value = 50.0
    q.value[:] = 100.0
    problem.backward()
    np.testing.assert_allclose([k.gradient, q.gradient[0]], [-1.5, -0.5], atol=1e-14)
    q.value = np.array([-100.0])
    problem.solve(requires_grad=True)
    problem.backward()
    np.testing.assert_allclose([k.gradient, q.gradient[0]], [-0.04, -0.02], atol=1e-14)


def quadratic() -> Any:
    p, x = cp.Parameter(value=3.0), cp.Variable()
    return cp.Problem(cp.Minimize(cp.square(x - 2 * p)), [x >= 0]), p, x


def test_the_example_of_cvxpys_documentation() -> None:
    """The minimum 2 p has the gradient 2, or 8 where x.gradient = 4, and changes by 2e-3 for 1e-3."""
    problem, p, x = quadratic()
    problem.solve(method="LCP", requires_grad=True)
    problem.backward()
    np.testing.assert_allclose(p.gradient, 2.0)
    x.gradient, p.delta = 4.0, 1e-3
    problem.backward()
    problem.derivative()
    np.testing.assert_allclose([p.gradient, x.delta], [8.0, 2e-3])


@pytest.mark.parametrize("make", [two_unknowns, quadratic])
@pytest.mark.parametrize("name", ["backward", "derivative"])
def test_no_stale_gradient_answers(make: Callable[[], Any], name: str) -> None:
    """Before a solve, after one without requires_grad, and in a copy, nothing answers; after the next with it, all."""
    problem = make()[0]
    with pytest.raises(ValueError, match="requires_grad"):
        getattr(problem, name)()
    problem.solve(method="LCP", requires_grad=True)
    getattr(problem, name)()
    for twin in (problem.copy(), pickle.loads(pickle.dumps(problem))):
        with pytest.raises(ValueError, match="requires_grad"):
            getattr(twin, name)()
        twin.solve(method="LCP", requires_grad=True)
        getattr(twin, name)()
    if isinstance(
        problem, ComplementarityProblem
    ):  # cvxpy copies a compiled program with the ids it had before
        twin = copy.deepcopy(problem)
        with pytest.raises(ValueError, match="requires_grad"):
            getattr(twin, name)()
    problem.solve(method="LCP")
    with pytest.raises(
        UnsupportedModel, match=r'problem.solve\(method="LCP", requires_grad=True\)'
    ):
        getattr(problem, name)()
    problem.solve(method="LCP", requires_grad=True)
    getattr(problem, name)()


def test_other_solvers_leave_nothing_of_ours_and_we_nothing_of_theirs() -> None:
    """After another solver's solve ours is gone; ours clears what diffcp keeps."""
    import lcp_plugin

    problem, p, x = quadratic()
    for other in (
        lambda: problem.solve(solver=lcp_plugin.QPSolver),
        lambda: problem.solve(solver=cp.CLARABEL),
    ):
        problem.solve(method="LCP", requires_grad=True)
        problem.backward()
        other()
        with pytest.raises(ValueError, match="requires_grad"):
            problem.backward()
    problem.solve(solver=cp.CLARABEL)
    problem._solver_cache["DIFFCP"] = {"DT": None, "D": None, "s": x.value}
    problem.solve(method="LCP")
    with pytest.raises(ValueError, match="requires_grad"):
        problem.backward()
    problem.solve(method="LCP", requires_grad=True)
    problem.backward()
    np.testing.assert_allclose(p.gradient, 2.0)


def test_parameters_that_do_not_matter_have_gradient_zero() -> None:
    """A parameter in a bound that does not hold, and one that is multiplied by zero."""
    upper, idle, x = cp.Parameter(2, value=[9.0, 9.0]), cp.Parameter(value=1.0), cp.Variable(2)
    problem = ComplementarityProblem(complements(box(x, 0, upper), M2 @ x + [-5, 1] + 0 * idle))
    problem.solve(requires_grad=True)
    problem.backward()
    assert upper.gradient.tolist() == [0.0, 0.0]
    assert idle.gradient.shape == ()
    assert float(idle.gradient) == 0.0


# --- refusals -----------------------------------------------------------------------------------------------------


RIGID: tuple[dict[str, Any], ...] = (
    *({name: True} for name in ("integer", "boolean", "symmetric", "PSD", "diag", "complex")),
    {"sparsity": [(0, 1), (0, 1)]},
)


@pytest.mark.parametrize("attributes", RIGID, ids=lambda attributes: next(iter(attributes)))
def test_tied_or_discrete_parameters_are_refused(attributes: dict[str, Any]) -> None:
    """Integer, Boolean, complex, symmetric, PSD, diagonal and sparse parameters: refused before the solve, by name."""
    P, x = cp.Parameter((2, 2), name="rigid", **attributes), cp.Variable(2)
    problem = ComplementarityProblem(complements(x >= 0, cp.real(P) @ x - 1 >= 0))
    with pytest.raises(
        UnsupportedModel, match=f"parameter rigid has the attribute '{next(iter(attributes))}'"
    ):
        problem.solve(requires_grad=True)
    if not attributes.keys() & {"complex", "sparsity"}:
        P.value = np.eye(2)
        assert problem.solve() == 0.0


@pytest.mark.parametrize(
    "given_gradient", [np.ones(3), [[1.0, 2.0]], 1.0, ["a", "b"], [np.nan, 0.0]], ids=str
)
def test_gradients_and_changes_of_another_shape_are_refused(given_gradient: Any) -> None:
    """What is set must be finite numbers of the leaf's own shape."""
    problem, _, q, x = two_unknowns()
    problem.solve(requires_grad=True)
    x.gradient = q.delta = given_gradient
    with pytest.raises(
        UnsupportedModel, match=r"the gradient of x must be finite real numbers of its shape \(2,\)"
    ):
        problem.backward()
    with pytest.raises(
        UnsupportedModel, match=r"the delta of q must be finite real numbers of its shape \(2,\)"
    ):
        problem.derivative()


def test_what_has_no_solution_has_no_derivative() -> None:
    """Infeasible models and programs, and runs that were cut short, are refused with what they ended with."""
    q, x = cp.Parameter(value=1.0), cp.Variable()
    model = ComplementarityProblem(complements(x >= 0, -x - q >= 0))
    program = cp.Problem(cp.Minimize(cp.square(x)), [x >= q, x <= q - 1])
    for problem in (model, program):
        problem.solve(method="LCP", requires_grad=True)
        assert problem.status == "infeasible"
        for name in ("backward", "derivative"):
            with pytest.raises(UnsuitableProblem, match="only a solution has a derivative"):
                getattr(problem, name)()


def test_what_is_not_determined_has_no_derivative_and_the_rest_has() -> None:
    """Two equal constraints leave the multipliers open, a flat objective x: said in the words of programs."""
    p, x, y = cp.Parameter(value=1.0), cp.Variable(), cp.Variable(2)
    equal = [x == p, 2 * x == 2 * p]
    problem = cp.Problem(cp.Minimize(cp.square(x)), equal)
    problem.solve(method="LCP", requires_grad=True)
    problem.backward()
    assert p.gradient == pytest.approx(1.0, abs=1e-12)
    p.delta = 2.0
    problem.derivative()
    assert x.delta == pytest.approx(2.0, abs=1e-12)
    equal[0].dual_variables[0].gradient, flat = (
        1.0,
        cp.Problem(cp.Minimize(cp.square(cp.sum(y) - p))),
    )
    flat.solve(method="LCP", requires_grad=True)
    for one, name in ((problem, "backward"), (flat, "backward"), (flat, "derivative")):
        with pytest.raises(UnsuitableProblem, match="drop redundant constraints"):
            getattr(one, name)()


def test_programs_must_be_disciplined_and_models_need_not() -> None:
    """A product of parameters in a program: refused with both ways out."""
    p, x = cp.Parameter(nonneg=True, value=2.0), cp.Variable()
    problem = cp.Problem(cp.Minimize(cp.square(x) - p * p * x))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # cvxpy's, about DPP
        with pytest.raises(UnsupportedModel, match="DPP rules"):
            problem.solve(method="LCP", requires_grad=True)


def test_atoms_without_a_derivative_are_refused_by_name() -> None:
    """A root at 0: the atom, and what to do."""
    p, x = cp.Parameter(value=0.0), cp.Variable()
    problem = ComplementarityProblem(complements(x >= 0, x - cp.sqrt(p) - 1 >= 0))
    problem.solve(requires_grad=True)
    with pytest.raises(UnsupportedModel, match=r"(no|no finite) derivative"):
        problem.backward()


def test_releases_without_derivatives_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where cvxpy has no Problem.backward, requires_grad says so and names another way."""
    refuse_without_derivatives()
    monkeypatch.delattr(cp.Problem, "backward")
    problem, *_ = two_unknowns()
    with pytest.raises(UnsupportedModel, match=r"no Problem\.backward.*lcp_plugin\.derivative"):
        problem.solve(requires_grad=True)


def test_another_layout_of_the_compiled_program_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where cvxpy's tensors do not make the program that was solved, no gradient comes of them."""
    compiled = cp.Problem.get_problem_data

    def changed(self: Any, *args: Any, **kwargs: Any) -> Any:
        data, *rest = compiled(self, *args, **kwargs)
        program = copy.copy(data["param_prob"])
        program.A = 2 * program.A
        return {**data, "param_prob": program}, *rest

    monkeypatch.setattr(cp.Problem, "get_problem_data", changed)
    problem, *_ = quadratic()
    with pytest.raises(UnsupportedModel, match="layout that is not known"):
        problem.solve(method="LCP", requires_grad=True)
    with pytest.raises(ValueError, match="requires_grad"):
        problem.backward()


@pytest.mark.full
def test_modeling_loads_no_kernels() -> None:
    """Stating models loads no numba: derivatives load when they are asked for."""
    assert (
        printed_by("import sys, lcp_plugin; lcp_plugin.complements; print('numba' in sys.modules)")
        == "False"
    )
