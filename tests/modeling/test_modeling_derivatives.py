"""derivative(problem) of cvxpy models: jvp and vjp by parameters, of variables and of dual values."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from test_extraction import FORMS, SPARSE, Unknowns, expression

from lcp_plugin import (
    ModelWarning,
    UnsuitableProblem,
    UnsupportedModel,
    box,
    complements,
    derivative,
)
from lcp_plugin.modeling.parameters import ParametricRows
from lcp_plugin.modeling.reading import Reader, folded

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


@pytest.mark.quick(13)
@pytest.mark.filterwarnings("ignore:conv is deprecated")
@pytest.mark.parametrize("name", FORMS)
def test_every_affine_form_is_differentiated_by_its_parameters(name):
    """With parameters in the place of variables the change is M times theirs, and the gradient is Mᵀ's."""
    F = expression(name)
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
    "reciprocal": lambda u: u.y / u.x + 1 / u.p,
    "exp times matrix": lambda u: (cp.exp(u.p) * SPARSE) @ u.x,
    "quadratic form": lambda u: cp.quad_form(u.x, np.eye(4) + 1.0) * u.y,
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
    "Gram matrix applied": lambda u: (
        (u.P.T @ u.P + np.eye(4)) @ u.x - (u.P @ u.Y + u.Y) @ (u.Y @ u.x)
    ),
    "sparse kron": lambda u: cp.kron(u.s * SPARSE, np.eye(2)) @ cp.hstack([u.x, u.y]),
    "log and root": lambda u: cp.log(u.x) + cp.sqrt(u.y) + cp.norm(u.v),
    "largest": lambda u: cp.maximum(u.x, 3 * u.y) + cp.max(u.v),
}


@pytest.mark.parametrize("held", [(), ("y", "X")], ids=["parameters", "beside variables"])
@pytest.mark.parametrize("name", CURVED)
def test_parameters_need_not_enter_affinely(name, held):
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


# --- models: the answer first -------------------------------------------------------------------------------------

M2 = np.array([[2.0, 1.0], [1.0, 2.0]])


def two_unknowns() -> Any:
    """A model with the solution x = (5/2, 0), w = (0, 7/2)."""
    M, q = cp.Parameter((2, 2), name="M", value=M2), cp.Parameter(2, name="q", value=[-5.0, 1.0])
    x = cp.Variable(2, name="x")
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, M @ x + q >= 0)])
    return problem, M, q, x


def test_gradients_of_dual_values():
    """A gradient by a pair is one by w, which jvp returns too."""
    problem, M, q, _ = two_unknowns()
    pair = problem.constraints[0]
    problem.solve(method="LCP")
    found = derivative(problem)
    gradients = found.vjp({pair: [0.0, 1.0]})  # w₂ = x₁ + q₂ = −q₁/2 + q₂ = −m₂₁ q₁/m₁₁ + q₂
    np.testing.assert_allclose(gradients[q], [-0.5, 1.0], atol=1e-14)
    np.testing.assert_allclose(gradients[M], [[-1.25, 0.0], [2.5, 0.0]], atol=1e-14)
    changed = found.jvp({M: [[0.0, 0.0], [2.0, 0.0]]})
    np.testing.assert_allclose(changed[pair], [0.0, 5.0], atol=1e-13)


# --- models of all kinds ------------------------------------------------------------------------------------------


def dominant(r: Any, n: int) -> Any:
    return r.standard_normal((n, n)) * 0.3 + n * np.eye(n)


def not_disciplined(r: Any) -> Parts:
    p, s, x = cp.Parameter(value=1.3), cp.Parameter(5, value=r.uniform(1, 2, 5)), cp.Variable(5)
    A, q = sp.csr_array(dominant(r, 5)), 10 * r.standard_normal(5)
    F = (cp.exp(p) * A + p**2 * np.eye(5)) @ x + p * cp.multiply(s, q)
    pair = complements(cp.multiply(s**2, x) - 1 / p >= 0, F >= 0)
    return (
        cp.Problem(cp.Minimize(0), [pair]),
        [p, s],
        [x],
        [pair, pair.first.constraint, pair.second.constraint],
    )


def boxed(r: Any) -> Parts:
    lower, upper = cp.Parameter(6, value=-r.uniform(0.1, 1, 6)), cp.Parameter(value=0.5)
    q, x = cp.Parameter(6, value=20 * r.standard_normal(6)), cp.Variable(6)
    pair = complements(box(x, lower, 2 * upper), dominant(r, 6) @ x + q)
    return cp.Problem(cp.Minimize(0), [pair]), [lower, upper, q], [x], [pair]


def definitions_and_equations(r: Any) -> Parts:
    q, k = cp.Parameter(5, value=10 * r.standard_normal(5)), cp.Parameter(value=0.7)
    B = cp.Parameter((2, 5), value=r.standard_normal((2, 5)))
    x, w, y = cp.Variable(5, nonneg=True), cp.Variable(5, nonneg=True), cp.Variable(2)
    pair = complements(x >= 0, w >= 0)
    defined = w == (k * dominant(r, 5)) @ x + q - B.T @ y
    balance = (k * (np.eye(2) + 0.1 * r.standard_normal((2, 2)))) @ y == -B @ x + k
    return (
        cp.Problem(cp.Minimize(0), [pair, defined, balance]),
        [q, B, k],
        [x, w, y],
        [pair, defined, balance],
    )


def two_functions(r: Any) -> Parts:
    q = cp.Parameter(4, value=10 * r.standard_normal(4))
    k = cp.Parameter(value=1.2)
    x = cp.Variable(4)
    pair = complements((k * dominant(r, 4)) @ x + q * k >= 0, dominant(r, 4) @ x - q >= 0)
    return (
        cp.Problem(cp.Minimize(0), [pair]),
        [q, k],
        [x],
        [pair, pair.first.constraint, pair.second.constraint],
    )


def several_pairs(r: Any) -> Parts:
    X, y, B = cp.Variable((2, 3)), cp.Variable(4, bounds=[-1, 1]), 0.3 * r.standard_normal((4, 6))
    P = cp.Parameter((2, 2), value=dominant(r, 2))
    Q = cp.Parameter((2, 3), value=4 * r.standard_normal((2, 3)))
    t = cp.Parameter(pos=True, value=2.0)
    psi = cp.Parameter((2, 3), value=r.standard_normal((2, 3)))
    F = P @ X + X + Q - cp.reshape(B.T @ y, (2, 3), order="F")
    first = complements(psi <= X, F >= 0)
    second = complements(y, 5 * t * y + B @ cp.vec(X, order="F") - cp.sum(Q) / t)
    return (
        cp.Problem(cp.Minimize(0), [first, second]),
        [P, Q, t, psi],
        [X, y],
        [first, second, first.second.constraint],
    )


def bounds_of_the_variable(r: Any) -> Parts:
    lower = cp.Parameter(5, value=-r.uniform(0.1, 1, 5))
    upper = cp.Parameter(5, value=r.uniform(0.1, 1, 5))
    try:
        x = cp.Variable(5, bounds=[lower, upper])
    except ValueError as error:
        pytest.skip(f"cvxpy {cp.__version__} refuses parameters as bounds: {error}")
    q = cp.Parameter(5, value=20 * r.standard_normal(5))
    pair = complements(x, dominant(r, 5) @ x + q)
    return cp.Problem(cp.Minimize(0), [pair]), [lower, upper, q], [x], [pair]


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
    q = cp.Parameter(4, value=10 * r.standard_normal(4))
    at = cp.Parameter(4, value=r.standard_normal(4))
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


def smooth(r: Any) -> Parts:
    p, k, y = cp.Parameter(2, value=r.uniform(0.5, 1, 2)), cp.Parameter(value=1.3), cp.Variable()
    x = cp.Variable(2, nonneg=True)
    x.value, y.value = np.ones(2), 1.0
    pair = complements(x, cp.exp(cp.multiply(p, x)) + x**3 / k - 3 * y)
    row = y**3 + k * y == 2 * k + cp.sum(x) * cp.exp(-k)
    return cp.Problem(cp.Minimize(0), [pair, row]), [p, k], [x, y], [pair]


MODELS = (
    not_disciplined, pytest.param(boxed, marks=pytest.mark.quick), definitions_and_equations, two_functions,
    several_pairs, bounds_of_the_variable, chain_of_definitions, fixed_by_a_parameter, free_with_its_equation, smooth,
)  # fmt: skip


def solved(problem: Any, **options: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        problem.solve(method="LCP", tolerance=1e-12, **options)


@pytest.mark.quick(2)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("make", MODELS, ids=lambda make: make.__name__)
def test_derivatives_agree_with_differences_of_solves(make, seed):
    """Changes of values and dual values are central differences of tight solves; vjp is the adjoint of jvp."""
    problem, parameters, variables, constraints = make(np.random.default_rng(seed))
    solved(problem)
    owners = [*variables, *constraints]
    moved, step = changes(parameters), 1e-6
    solution = derivative(problem)
    changed = solution.jvp(dict(zip(parameters, moved, strict=True)))
    found = [changed[one] for one in owners]
    given_gradients = changes(owners, 1)
    gradients = solution.vjp(dict(zip(owners, given_gradients, strict=True)))
    forward = dot(given_gradients, found)
    adjoint = dot([gradients[parameter] for parameter in parameters], moved)
    size = dot([np.abs(one) for one in given_gradients], [np.abs(change) for change in found])
    assert abs(forward - adjoint) <= 1e-12 * size
    base, ends = [parameter.value for parameter in parameters], []
    for side in (1.0, -1.0):
        for parameter, value, change in zip(parameters, base, moved, strict=True):
            parameter.value = value + side * step * change
        solved(problem)
        values = [one.value for one in variables] + [one.dual_value for one in constraints]
        ends.append([np.asarray(value) for value in values])
    for before, after, change in zip(ends[1], ends[0], found, strict=True):
        np.testing.assert_allclose(change, (after - before) / (2 * step), atol=3e-7)


# --- degenerate, old, copied --------------------------------------------------------------------------------------


def test_at_a_kink_vjp_gives_one_piece_and_jvp_one_side():
    """Of x = max(−q/2, 0) at q = 0 the gradient is 0 or −1/2, the change that of the side."""
    q, x = cp.Parameter(value=0.0), cp.Variable()
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, 2 * x + q >= 0)])
    problem.solve(method="LCP")
    found = derivative(problem)
    assert float(found.vjp({x: 1.0})[q]) in (0.0, -0.5)
    for side, change in ((1.0, 0.0), (-1.0, 0.5)):
        assert float(found.jvp({q: side})[x]) == change


def test_derivatives_are_at_a_solution_of_the_present_parameters():
    """A parameter that has changed since the solve, even in place, is named; the next solve has its derivative."""
    k, q, x = cp.Parameter(value=2.0), cp.Parameter(1, value=[-6.0]), cp.Variable(1)
    upper = cp.Parameter(1, value=[3.0])
    problem = cp.Problem(cp.Minimize(0), [complements(box(x, 0, upper), k * x + q)])
    for change in ({k: 50.0}, {q: np.array([-7.0])}, {upper: np.array([4.0])}):
        problem.solve(method="LCP")
        derivative(problem)
        before = {one: one.value for one in change}
        for one, value in change.items():
            one.value = value
        with pytest.raises(UnsupportedModel, match="solve again"):
            derivative(problem)
        for one, value in before.items():
            one.value = value
    upper.value = np.array([9.0])
    problem.solve(method="LCP")
    gradients = derivative(problem).vjp({x: [1.0]})
    np.testing.assert_allclose([gradients[k], gradients[q][0]], [-1.5, -0.5], atol=1e-14)


# --- refusals -----------------------------------------------------------------------------------------------------


RIGID: tuple[dict[str, Any], ...] = (
    *({name: True} for name in ("integer", "boolean", "symmetric", "PSD", "diag", "complex")),
    {"sparsity": [(0, 1), (0, 1)]},
)


@pytest.mark.parametrize("attributes", RIGID, ids=lambda attributes: next(iter(attributes)))
def test_tied_or_discrete_parameters_are_refused(attributes):
    """Integer, Boolean, complex, symmetric, PSD, diagonal and sparse parameters are refused by name."""
    P, x = cp.Parameter((2, 2), name="rigid", **attributes), cp.Variable(2)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, cp.real(P) @ x - 1 >= 0)])
    with pytest.raises(
        UnsupportedModel, match=f"parameter rigid has the attribute '{next(iter(attributes))}'"
    ):
        derivative(problem)


@pytest.mark.parametrize("given_gradient", [np.ones(3), 1.0, [np.nan, 0.0]], ids=str)
def test_gradients_and_changes_of_another_shape_are_refused(given_gradient):
    """What is set must be finite numbers of the leaf's own shape."""
    problem, _, q, x = two_unknowns()
    problem.solve(method="LCP")
    found = derivative(problem)
    with pytest.raises(
        UnsupportedModel, match=r"the gradient of x must be finite, of its shape \(2,\)"
    ):
        found.vjp({x: given_gradient})
    with pytest.raises(
        UnsupportedModel, match=r"the change of q must be finite, of its shape \(2,\)"
    ):
        found.jvp({q: given_gradient})
    with pytest.raises(UnsupportedModel, match="y has no gradient; give x"):
        found.vjp({cp.Variable(name="y"): 1.0})
    with pytest.raises(UnsupportedModel, match="r has no change; give"):
        found.jvp(r=1.0)


def test_what_has_no_solution_has_no_derivative():
    """Before a solve, after another solver's, of an infeasible model and of a program: refused with a way out."""
    q, x = cp.Parameter(value=1.0), cp.Variable()
    model = cp.Problem(cp.Minimize(0), [complements(x >= 0, -x - q >= 0)])
    with pytest.raises(UnsupportedModel, match=r"derivative needs a solution"):
        derivative(model)
    model.solve(method="LCP")
    assert model.status == "infeasible"
    with pytest.raises(UnsuitableProblem, match="only a solution has a derivative"):
        derivative(model)
    program = cp.Problem(cp.Minimize(cp.square(x)), [x >= q])
    program.solve(method="LCP")
    with pytest.raises(UnsupportedModel, match="requires_grad=True"):
        derivative(program)
    with pytest.raises(UnsupportedModel, match=r"lcp_plugin.derivative\(problem\)"):
        model.solve(method="LCP", requires_grad=True)


def test_atoms_without_a_derivative_are_refused_by_name():
    """A root at 0: the atom, and what to do."""
    p, x = cp.Parameter(value=0.0), cp.Variable()
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, x - cp.sqrt(p) - 1 >= 0)])
    problem.solve(method="LCP")
    with pytest.raises(UnsupportedModel, match=r"(no|no finite) derivative"):
        derivative(problem).vjp({x: 1.0})
