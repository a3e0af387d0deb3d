"""What a person meets in the first hour: words that name the variable, the row, the sign, and the way on."""

from __future__ import annotations

import warnings
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    FrictionalContact,
    InvalidOption,
    ModelWarning,
    NonlinearProblem,
    QuadraticProgram,
    UnsupportedModel,
    certify,
    complements,
    derivative,
    optimal,
    solve,
    solve_batch,
    trace,
)

E, COSTS = np.array([0.9, 0.4, 0.5]), np.array([8.0, 15.0, 14.0])


def market(permits: str) -> tuple[cp.Problem, list[cp.Variable], cp.Variable]:
    """Three Cournot firms with emissions E, and a permit price t that a pair, an inequality or a wrong pair limits."""
    x = [cp.Variable(name=f"x{k}", nonneg=True) for k in range(3)]
    t, total, emitted = cp.Variable(name="t", nonneg=True), sum(x), E @ cp.hstack(x)
    firms = [
        optimal(cp.Problem(cp.Maximize((60 - total - COSTS[k] - E[k] * t) * x[k])), over=[x[k]])
        for k in range(3)
    ]
    cap = {
        "pair": complements(30 - emitted, t),
        "inequality": emitted <= 30,
        "reversed": complements(emitted - 52 >= 0, t),
    }[permits]
    return cp.Problem(cp.Minimize(0), [*firms, cap]), x, t


def test_a_variable_that_nothing_determines_is_named():
    """The price of an inequality is arbitrary; with the pair it is 0, without a warning."""
    problem, _, t = market("inequality")
    with pytest.warns(ModelWarning, match=r"determines t, so that the value is arbitrary"):
        problem.solve(method="LCP")
    problem, _, t = market("pair")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problem.solve(method="LCP")
    assert abs(t.value) <= 1e-9


def test_smooth_equations_alone_are_solved():
    """The equation exp(x) = 3 needs no pair; an inequality next to it gets cvxpy's reason only."""
    x = cp.Variable(name="x")
    problem = cp.Problem(cp.Minimize(0), [cp.exp(x) == 3])
    problem.solve(method="LCP")
    assert problem.status == "optimal"
    assert x.value == pytest.approx(np.log(3.0))
    assert certify(problem).worst() is not None
    with pytest.raises(cp.error.DCPError) as caught:
        cp.Problem(cp.Minimize(0), [cp.exp(x) == 3, x >= 0]).solve(method="LCP")
    assert "quadratic objective" not in str(caught.value)


def test_rows_of_agents_have_the_names_of_their_decisions_and_constraints():
    """The worst rows of a moved point are the optimality of x0 and the cap, with its multiplier."""
    problem, x, _ = market("pair")
    problem.solve(method="LCP")
    x[0].value = x[0].value + 1
    assert str(certify(problem).worst()).startswith("optimality of x0 = 2 while x0 = 17.25 > 0")
    y = cp.Variable(2, name="output", nonneg=True)
    cap = cp.sum(y) <= 3
    agent = optimal(cp.Problem(cp.Minimize(cp.sum_squares(y - 5)), [cap]), over=[y])
    problem = cp.Problem(cp.Minimize(0), [agent])
    problem.solve(method="LCP")
    y.value = np.array([3.0, 1.0])
    told = str(certify(problem).worst())
    assert "optimality of output[0]" in told
    assert "Sum(output" in told or "sum(output)" in told
    assert "var" not in told


def test_a_reversed_cap_is_named_although_the_model_has_agents():
    """The products of quantities with each other have one sign, of the price and quantities the other."""
    problem, *_ = market("reversed")
    problem.solve(method="LCP")
    told = problem.solver_stats.extra_stats.explain()
    assert "the sign of constraint 3 (x0, x1, x2, t) may be wrong" in told


def test_a_game_has_no_reversed_row():
    """All products of a bimatrix game have one sign, and no row is wrong."""
    zero, A = np.zeros((2, 2)), np.array([[1.0, 2.0], [3.0, 1.0]])
    M = np.block([[zero, A], [A.T, zero]])
    result = solve(LCP(M, -np.ones(4)), max_iterations=0)
    assert "may be wrong" not in result.explain()


ONE = cp.Variable(nonneg=True)
SPACE = [[0.0, 0.0, 1.0]], [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]


def permits() -> Any:
    """Return the path of two permits whose supply is the parameter theta."""
    x, theta = cp.Variable(2, nonneg=True, name="permit"), cp.Parameter(name="theta", value=1.0)
    problem = cp.Problem(cp.Minimize(0), [complements(x, x - theta)])
    return trace(problem, along=theta, start=0.0, stop=2.0)


@refusals(r"""
FrictionalContact((2.0, *SPACE), [0, 0, -1.0], 0.5)
    → must be square, got shape \(\); of masses it is np.diag\(masses\)
FrictionalContact((np.ones(3), *SPACE), [0, 0, -1.0], 0.5) → got shape \(3,\); of masses it is np.diag\(masses\)
FrictionalContact(np.eye(3), np.zeros((4, 3)), 0.5) → for many problems use FrictionalContact\.worlds
solve(FrictionalContact.worlds(np.eye(3), -np.ones((4, 3)), 0.5)) → write solve_batch\(…\)
solve(cp.Problem(cp.Minimize(ONE))) → write problem\.solve\(method="LCP"\)
prepare(LCP([[1.0]], [1.0])).solve([1.0]) → data have names: write step.solve\(q=…\)
prepare(FrictionalContact(np.eye(3), [-1.0, 0.0, 0.0], 0.5)).solve([1.0]) → write step.solve\(b=…\)
prepare(LCP([[1.0]], [1.0])).solve(warm=np.zeros(2)) → warm must be True or False
prepare(LCP([[1.0]], [1.0])).solve(warm_start=True) → known: .*, warm
prepare(QuadraticProgram(np.eye(2), [1, 1]), max_second=1) → did you mean 'max_seconds'
march(FrictionalContact(np.eye(3), [-1.0, 1.0, 0.0], 0.4), [[-1.0, 1.0, 0.0]])
    → needs an array as propagator.* call step.solve\(b=…\) .* in a loop
optimal(cp.Problem(cp.Minimize(ONE**2)), over=[ONE]).gap() → have no values; solve the problem first
complements(ONE, ONE + 1).violation() → have no values; solve first
FrictionalContact(np.eye(4), np.ones(4), [0.5], dimension=4)
    → dimension, the rows of a contact, must be 3, or 2 in the plane, got 4
certify(QuadraticProgram(np.eye(1), [1.0])) → write certify.program, x.
solve(LCP([[1.0]], [1.0]), prove=True) → prove=True needs an objective
prepare(QuadraticProgram(np.eye(2), [1, 1])).solve(q=[1, 2]) → step.solve takes no q; the linear term is called c
FrictionalContact.worlds(np.eye(3), [[1.0, 0.0, 0.0]]) → write FrictionalContact\.worlds\(W, b, friction
derivative("text") → got str$
gallery.binomial_put(100.0, dividend=0.03) → binomial_put: missing .*'strike'; write binomial_put\(spot, strike=…,
gallery.obstacle_2d(30) → by name: size, shifted$
certify(None, [1.0]) → got NoneType$
prepare(LCP([[1.0]], [1.0])).solve(max_seconds=1) → options of a run belong to prepare
solve(LCP([[1.0]], [1.0]), method="psor") → did you mean algorithm=…
BoundedLeastSquares(np.eye(2), [1, 1], (0, 1))
    → too many positional arguments; write BoundedLeastSquares\(A, b, lower=…, upper=…
LCP([[1.0]], [1.0], 0, 1) → write LCP\(M, q, lower=…, upper=…
QuadraticProgram(np.eye(2), q=[1, 1]) → missing a required argument: 'c'; write QuadraticProgram\(P, c,
LCP([[1.0]], [1.0], uper=1) → got an unexpected keyword argument 'uper'; did you mean 'upper'\?
BoundedLeastSquares([2.0], [1.0]) → A must be a real matrix, got shape \(1,\)
permits().value("prmit", 1.0) → give one of permit
""")
def test_a_mistake_is_answered_by_the_next_step(call, words):
    """No raw error of Python: the message has the value, the need and the call."""
    assert_refused(call, words, globals())


def test_a_mistake_inside_of_the_user_s_function_stays_a_mistake_of_python():
    """A TypeError of F is not reported as a wrong call of this package."""
    with pytest.raises(TypeError, match="takes 0 positional") as caught:
        solve(NonlinearProblem((lambda: 1), lower=[0.0]))
    assert not isinstance(caught.value, InvalidOption)


def test_columns_of_batches_of_contacts_are_vectors():
    """Velocities of shape (B, n, 1) and friction of shape (B, 1) are those of (B, n) and (B, k)."""
    b = np.array([[-1.0, 3.0, 4.0, -1.0, 0.3, 0.0], [-1.0, 0.0, 0.1, -2.0, 0.0, 0.0]])
    flat = solve_batch(FrictionalContact.worlds(np.eye(6), b, [[0.5, 0.5], [0.1, 0.1]]))
    mu = [[0.5], [0.1]]
    columns = solve_batch(FrictionalContact.worlds(np.eye(6), b[..., None], mu, dimension=3))
    assert np.array_equal(flat.z, columns.z)
    assert derivative(flat).is_unique == [derivative(flat)[k].is_unique for k in range(2)]


def test_values_are_read_by_name():
    """A result, a path and a change of a parameter take the names of unknowns and parameters."""
    result = solve(LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0], names=["coal", "steel"]))
    assert result.named == {"coal": 2.5, "steel": 0.0}
    program = QuadraticProgram(np.eye(2), [-1, -2], names=["coal", "steel"])
    assert solve(program).named == pytest.approx({"coal": 1.0, "steel": 2.0})
    path = permits()
    assert path.value("permit", 1.5).tolist() == [1.5, 1.5]
    x, theta = cp.Variable(2, nonneg=True, name="permit"), cp.Parameter(name="theta", value=1.0)
    problem = cp.Problem(cp.Minimize(0), [complements(x, x - theta)])
    problem.solve(method="LCP")
    assert derivative(problem).jvp(theta=1.0)[x].tolist() == [1.0, 1.0]
    assert derivative(problem).jvp({theta: 1.0})[x].tolist() == [1.0, 1.0]


def test_bounds_of_a_nonlinear_problem_are_there_before_its_size():
    """A number stands for all unknowns until F is known."""
    problem = NonlinearProblem(lambda x: x - 1, lower=0.0, upper=0.35)
    assert (problem.lower, problem.upper) == (0.0, 0.35)


def test_texts_of_cvxpy_have_no_private_words():
    """A constraint is named as it was written, without Promote, reshape and Approx."""
    z = cp.Variable(3, name="z")
    problem = cp.Problem(cp.Minimize(cp.sum(z)), [z <= 0.1, cp.sum(z) >= 10])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem.solve(method="LCP")
    assert "Promote" not in str(problem.solver_stats.extra_stats.conflict)
    v = cp.Variable(name="v")
    problem = cp.Problem(cp.Minimize(v), [cp.square(v) <= 2])
    with pytest.raises(UnsupportedModel, match=r"lcp_plugin\.optimal\(problem") as caught:
        problem.solve(method="LCP")
    assert "Approx" not in str(caught.value)
