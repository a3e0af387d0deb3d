"""Programs stated in cvxpy: bounds that cvxpy infers are not used, and every answer is measured as stated."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import cvxpy_programs
from cvxpy.reductions.solvers.qp_solvers.qp_solver import QpSolver
from scipy.optimize import nnls

from lcp_plugin import QPSolver, Status, complements
from lcp_plugin.modeling import qp_solver
from lcp_plugin.modeling._compat import CVXPY_STATUS
from lcp_plugin.modeling.stated_terms import EQUATIONS, StatedTerms
from lcp_plugin.problems.programs.conversion import QuadraticProgram

SolverError = cp.error.SolverError
CASES = 40


def hinge_loss() -> Any:
    """The loss of a support vector machine, 0.017347 at its minimum; 2 where pos(…) is held at or above 1."""
    w, y, A = cp.Variable(2), np.array([1.0, -1.0]), np.array([[1.0, 2.0], [3.0, -1.0]])
    return cp.Problem(
        cp.Minimize(cp.sum(cp.pos(1 - cp.multiply(y, A @ w))) + 0.05 * cp.sum_squares(w))
    )


# --- Nothing inferred is believed ------------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("second_solve", [False, True], ids=["first solve", "after Clarabel"])
def test_random_programs_agree_with_other_solvers(second_solve: bool) -> None:
    """Random DCP programs: no wrong value, no wrong status, at most one undecided (see the campaign)."""
    outcomes = Counter(
        cvxpy_programs.judged(7, k, second_solve=second_solve)[0] for k in range(CASES)
    )
    assert outcomes["agreed"] >= CASES - 1, outcomes
    assert not outcomes["wrong value"] + outcomes["wrong status"]


def test_a_contradiction_with_rounded_coefficients_is_proved() -> None:
    """Nine multipliers that vanish together up to rounding only: the proof takes more of them."""
    assert cvxpy_programs.judged(9, 338, second_solve=False)[0] == "agreed"


def test_the_campaign_is_as_wide_as_it_says() -> None:
    """At least 20 atoms, 6 combinations and 4 kinds of variables, whatever the release of cvxpy."""
    assert len(cvxpy_programs.CONVEX) >= 20
    assert len(cvxpy_programs.COMBINATIONS) >= 6
    assert len(cvxpy_programs.KINDS) >= 4


@pytest.mark.parametrize("first", [None, cp.CLARABEL, cp.SCS], ids=str)
def test_a_hinge_loss_has_its_minimum(first: Any) -> None:
    """The hinge loss is 0.017347 from the first solve and after another solver's, where bounds are inferred or not."""
    problem = hinge_loss()
    if first is not None:
        problem.solve(solver=first)
    assert problem.solve(solver=QPSolver) == pytest.approx(0.0173469, abs=1e-6)
    assert problem.status == "optimal"


def test_bounds_that_cvxpy_sends_are_refused() -> None:
    """Bounds of variables that come beside the rows are nobody's: SolverError, not an answer."""
    data = hinge_loss().get_problem_data(QPSolver)[0]
    assert data["lower_bounds"] is None
    assert data["upper_bounds"] is None
    with pytest.raises(SolverError, match="sends bounds"):
        qp_solver.quadratic_program({**data, "lower_bounds": np.zeros(data["n_var"])})


@pytest.mark.parametrize(
    "kind",
    [
        {"nonneg": True},
        {"nonpos": True},
        {"bounds": [-0.25, 0.5]},
        {"symmetric": True},
        {"sparsity": ([0, 1], [1, 0])},
        {},
    ],
    ids=str,
)
@pytest.mark.parametrize("turned", [cp.Minimize, cp.Maximize])
def test_attributes_of_one_s_own_variables_hold(kind: dict[str, Any], turned: Any) -> None:
    """Minima and maxima over variables of every attribute are Clarabel's, with constants and parameters about."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # cvxpy's words about sparse values
        X, target = cp.Variable((2, 2), **kind), cp.Parameter((2, 2))
        loss = cp.sum_squares(X - target) + cp.norm1(X) + 3.0
        problem = cp.Problem(turned(loss if turned is cp.Minimize else -loss), [cp.sum(X) <= 0.75])
        for value in (np.array([[1.0, 2.0], [-1.0, 0.5]]), -np.ones((2, 2))):
            target.value = value
            expected = problem.solve(solver=cp.CLARABEL)
            assert problem.solve(solver=QPSolver) == pytest.approx(expected, abs=1e-6)
            assert problem.status == "optimal"


@pytest.mark.parametrize("name", ["lp_bound_attr", "qp_bound_attr"])
def test_cvxpy_s_own_bounded_programs_are_solved(name: str) -> None:
    """Programs of cvxpy's with bounds as attributes have their values; that they arrive as bounds is not wanted."""
    helpers = pytest.importorskip("cvxpy.tests.solver_test_helpers")
    if not hasattr(helpers, name):
        pytest.skip("this release of cvxpy has no such program")
    helper = getattr(helpers, name)()
    helper.solve(QPSolver)
    helper.verify_objective(4)
    helper.verify_primal_values(4)


# --- Measured on the problem as stated --------------------------------------------------------------------------------


def losses() -> Any:
    x = cp.Variable(3)
    a = np.array([1.0, -2.0, 0.5])
    return cp.Problem(
        cp.Minimize(cp.norm1(x - a) + cp.sum_squares(x)), [cp.sum(x) == 1, x[0] <= 0.25, x[1] >= -1]
    )


def impossible() -> Any:
    x = cp.Variable(3)
    return cp.Problem(cp.Minimize(cp.sum_squares(x)), [cp.norm1(x) <= 1, x[0] + x[1] >= 1.5])


def endless() -> Any:
    x = cp.Variable(3)
    return cp.Problem(cp.Maximize(x[0] - cp.pos(x[1])), [cp.norm_inf(x[1:]) <= 1, x[0] >= 2 * x[1]])


PROBLEMS = {"optimal": losses, "infeasible": impossible, "unbounded": endless}
Tamper = Callable[[QuadraticProgram], QuadraticProgram]


def changed(program: QuadraticProgram, **parts: Any) -> QuadraticProgram:
    names = ("P", "c", "G", "h", "A", "b", "lower", "upper")
    return QuadraticProgram(**{**{name: getattr(program, name) for name in names}, **parts})


def without_equations(program: QuadraticProgram) -> QuadraticProgram:
    return changed(program, A=0.0 * program.A, b=0.0 * program.b)


def without_single_rows(program: QuadraticProgram) -> QuadraticProgram:
    single = np.diff(sp.csr_array(program.G).indptr) == 1
    return changed(program, h=np.where(single, np.inf, program.h))


def tighter(program: QuadraticProgram) -> QuadraticProgram:
    return changed(program, h=program.h - 0.25)


#: What an error of the host might do to the program so that its answer is none, and the kind of problem.
PLANTED: dict[str, tuple[str, Tamper]] = {
    "equations lost": ("optimal", without_equations),
    "bounds lost": ("optimal", without_single_rows),
    "another cost": ("optimal", lambda p: changed(p, c=p.c + 0.5)),
    "another curvature": ("optimal", lambda p: changed(p, P=1.25 * p.P)),
    "limits moved": ("optimal", tighter),
    "feasible by an error": ("infeasible", lambda p: changed(p, h=p.h + 1.0)),
}


@pytest.mark.parametrize("status", PROBLEMS)
def test_an_untouched_program_passes(status: str) -> None:
    """Each of the problems has its status, a first and a second time."""
    problem = PROBLEMS[status]()
    for _ in range(2):
        problem.solve(solver=QPSolver)
        assert problem.status == status


@pytest.mark.parametrize("planted", PLANTED)
@pytest.mark.parametrize("how", [{"solver": QPSolver}, {"method": "LCP"}], ids=["solver", "method"])
def test_a_program_that_is_not_the_problem_is_never_optimal(
    planted: str, how: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error planted between the problem and the program, which its answer shows, ends in SolverError."""
    status, tamper = PLANTED[planted]
    problem, original = PROBLEMS[status](), qp_solver.quadratic_program
    monkeypatch.setattr(qp_solver, "quadratic_program", lambda data: tamper(original(data)))
    with pytest.raises(SolverError, match="the problem itself contradicts"):
        problem.solve(**how)
    assert problem.status is None
    assert problem.variables()[0].value is None


@pytest.mark.parametrize("planted", PLANTED)
def test_a_re_solve_is_judged_as_a_first_solve_is(
    planted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same errors show where they come with new vectors only, to a program whose matrices were right before."""
    status, tamper = PLANTED[planted]
    problem, original = PROBLEMS[status](), QuadraticProgram.with_vectors
    problem.solve(solver=QPSolver)
    monkeypatch.setattr(
        QuadraticProgram, "with_vectors", lambda *args, **kwargs: tamper(original(*args, **kwargs))
    )
    whole = qp_solver.quadratic_program  # which a re-solve begins with again before cvxpy 1.8
    monkeypatch.setattr(qp_solver, "quadratic_program", lambda data: tamper(whole(data)))
    with pytest.raises(SolverError, match="the problem itself contradicts"):
        problem.solve(solver=QPSolver)
    assert problem.status is None


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_violation_shows_in_any_unit(unit: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit that the program lost is missed by the answer, however small the numbers are."""
    x, original = cp.Variable(), qp_solver.quadratic_program
    problem = cp.Problem(cp.Minimize(cp.abs(x - 3 * unit)), [x <= unit])
    assert problem.solve(solver=QPSolver) == pytest.approx(2 * unit, rel=1e-6)
    tampered = cp.Problem(problem.objective, problem.constraints)
    monkeypatch.setattr(
        qp_solver, "quadratic_program", lambda data: without_single_rows(original(data))
    )
    with pytest.raises(SolverError, match="is violated by"):
        tampered.solve(solver=QPSolver)


def test_the_problem_s_terms_have_the_values_that_cvxpy_gives_them() -> None:
    """At the values of the variables the objective and slacks are cvxpy's own: shared, constant, scalar, sparse."""
    rng = np.random.default_rng(6)
    X, y, z = cp.Variable((2, 3)), cp.Variable(3, nonneg=True), cp.Variable()
    p = cp.Parameter(3, value=rng.normal(size=3))
    shared = X.T @ np.array([1.0, -2.0]) + cp.multiply(p, y) / 2.0
    sparse = sp.csc_array(np.diag([1.0, 0.0, 3.0]))
    constraints = [
        shared <= 1 + cp.abs(p),
        cp.vstack([shared, y]) >= X - z,
        cp.sum(X, axis=0) == sparse @ y,
        z >= p[0],
        cp.constraints.NonNeg(2 - z),
        cp.constraints.Zero(cp.hstack([z, y]) - 1),
        cp.Constant(1.0) <= 2.0 + 0 * z,
    ]
    loss = cp.sum_squares(shared) + cp.norm1(X) + 3.0
    for objective in (cp.Minimize(loss), cp.Maximize(-cp.max(shared)), cp.Minimize(0)):
        problem = cp.Problem(objective, constraints)
        for variable in problem.variables():
            variable.value = np.abs(rng.normal(size=variable.shape))
        terms = StatedTerms.of(problem)
        assert terms.goal == objective.args[0].value * (
            -1.0 if isinstance(objective, cp.Maximize) else 1.0
        )
        for constraint, slack in zip(constraints, terms.slacks, strict=True):
            violation = (
                np.abs(slack) if isinstance(constraint, EQUATIONS) else np.maximum(slack, 0.0)
            )
            np.testing.assert_allclose(violation, constraint.residual, atol=1e-14)


def test_an_error_of_cvxpy_s_own_is_found() -> None:
    """Every cvxpy so far compiles vstack of a bare diag transposed: other solvers' answer violates its constraint."""
    X = cp.Variable((2, 2))
    doubled = cp.vstack([cp.diag(X), cp.diag(X)])
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(X)), [doubled == np.array([[1.0, 1.0], [1.5, 1.5]])]
    )
    problem.solve(solver=cp.CLARABEL)
    if problem.status == "infeasible":
        pytest.skip("this cvxpy compiles it as stated")
    assert problem.constraints[0].violation().max() > 0.4
    with pytest.raises(SolverError, match="is violated by"):
        problem.solve(solver=QPSolver)


def test_other_solvers_are_left_alone() -> None:
    """Problems for other solvers pass untouched through the method that measures ours."""
    problem = losses()
    data, chain, inverse = problem.get_problem_data(cp.OSQP)
    problem.unpack_results(chain.solve_via_data(problem, data, solver_opts={}), chain, inverse)
    assert problem.status == "optimal"
    data, chain, inverse = problem.get_problem_data(QPSolver)
    raw = chain.solve_via_data(problem, data, solver_opts={})
    problem.unpack_results(raw, chain, inverse)
    assert problem.status == "optimal"
    moved = replace(raw, solution=replace(raw.solution, x=raw.solution.x + 0.01))
    with pytest.raises(SolverError, match="contradicts"):
        problem.unpack_results(moved, chain, inverse)


def test_what_cannot_be_evaluated_is_not_judged_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where an atom of cvxpy fails at a value, the program's answer stands, with a warning."""
    x = cp.Variable(3)
    norm = cp.norm1(x)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(x - 1)), [norm <= 1])

    def failing(self: Any, values: Any) -> Any:
        raise ValueError("kth out of bounds")

    monkeypatch.setattr(type(norm), "numeric", failing)
    with pytest.warns(UserWarning, match="could not be judged .* kth out of bounds"):
        problem.solve(solver=QPSolver)
    assert problem.value == pytest.approx(4 / 3, abs=1e-6)


# --- What a person finds afterwards ----------------------------------------------------------------------------------


@pytest.mark.parametrize("how", [{"solver": QPSolver}, {"method": "LCP"}], ids=["solver", "method"])
@pytest.mark.parametrize("status", PROBLEMS)
def test_extra_stats_have_one_shape(status: str, how: dict[str, Any]) -> None:
    """extra_stats is a Result with status and infeasibility, whatever became of the program."""
    problem = PROBLEMS[status]()
    problem.solve(**how)
    told = problem.solver_stats.extra_stats
    assert problem.status == status
    assert CVXPY_STATUS[told.status] == status
    assert (told.proof is None) == (status == "optimal")
    if status != "optimal":
        assert told.proof.verify()
        assert status in str(told.proof)
        assert status in told.explain()


@pytest.mark.parametrize("q", [-1.0, 1.0])
def test_extra_stats_of_complementarity_have_the_same_shape(q: float) -> None:
    """The same names for a complementarity problem: solved, and proved to have no solution."""
    x = cp.Variable()
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, -x - q >= 0)])
    problem.solve(method="LCP")
    told = problem.solver_stats.extra_stats
    assert told.status is (Status.SOLVED if q < 0 else Status.INFEASIBLE)
    assert told.proof is None if q < 0 else told.proof.verify()


def refused() -> dict[str, tuple[Any, str]]:
    x, k, S = cp.Variable(2), cp.Variable(2, integer=True), cp.Variable((2, 2), PSD=True)
    return {
        "norm": (
            cp.Problem(cp.Minimize(cp.sum(x)), [cp.norm(x) <= 1]),
            "<= 1.0 is not piecewise linear",
        ),
        "exp": (
            cp.Problem(cp.Minimize(cp.sum(cp.exp(x)))),
            "the objective .*exp.* is not quadratic",
        ),
        "cone": (cp.Problem(cp.Minimize(x[0]), [cp.SOC(x[0], x)]), "is a SOC"),
        "integer": (cp.Problem(cp.Minimize(cp.sum_squares(k - 0.4))), "is integer"),
        "semidefinite": (cp.Problem(cp.Minimize(cp.trace(S)), [S[0, 1] == 1]), "is PSD"),
    }


@pytest.mark.parametrize("name", refused())
def test_a_refusal_has_its_reason(name: str) -> None:
    """A cone program or one with integers is refused by the name of what is neither quadratic nor linear."""
    problem, reason = refused()[name]
    with pytest.raises(SolverError, match=reason):
        problem.solve(method="LCP")
    with pytest.raises(SolverError) as raised:
        problem.solve(solver=QPSolver)
    if (
        hasattr(QpSolver, "can_solve") and name != "integer"
    ):  # before 1.9, and of integers, cvxpy has words of its own
        assert re.search(reason, str(raised.value))


@pytest.mark.parametrize("algorithm", ["psor", "pgs", "npgs", "npsor", "newton", "interior_point"])
def test_projected_methods_take_least_squares_as_cvxpy_compiles_them(algorithm: str) -> None:
    """Σ (A x − b)² with x ≥ 0: its t = A x − b is put in, so that M has no zero on its diagonal; scipy's value."""
    rng = np.random.default_rng(0)
    A, b, x = rng.standard_normal((30, 10)), rng.standard_normal(30), cp.Variable(10)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b)), [x >= 0])
    problem.solve(method="LCP", algorithm=algorithm)
    right, distance = nnls(A, b)
    assert problem.status == cp.OPTIMAL
    np.testing.assert_allclose(problem.value, distance**2, rtol=1e-8)
    np.testing.assert_allclose(x.value, right, atol=1e-6)
