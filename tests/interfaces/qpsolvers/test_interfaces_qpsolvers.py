"""Interface for qpsolvers: x and duals in its conventions, found only if they are optimal."""

import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp
from qpsolvers import ParamError, Problem, ProblemError, solve_problem, solve_qp
from qpsolvers import problems as published
from scipy.optimize import nnls

from lcp_plugin import Status
from lcp_plugin.interfaces.qpsolvers import register_with_qpsolvers

register_with_qpsolvers()
NAME = "lcp_plugin"
P, Q = 2.0 * np.eye(2), np.array([-2.0, -4.0])
G, H = np.array([[1.0, 1.0]]), np.array([2.0])


@pytest.mark.parametrize("name", [name for name in dir(published) if name.startswith("get_qp")])
def test_published_programs(name):
    """The test programs of qpsolvers have residuals below 1e-9, relative to the objective."""
    problem, reference = getattr(published, name)()
    solution = solve_problem(problem, NAME)
    assert solution.found, solution.extras
    errors = [solution.primal_residual(), solution.dual_residual(), solution.duality_gap()]
    assert max(errors) <= 1e-9 * (1.0 + abs(solution.obj))
    if reference.x is not None:
        np.testing.assert_allclose(solution.x, reference.x, atol=1e-6)  # its published digits


def test_duals_have_the_signs_of_qpsolvers():
    """Duals have the signs of qpsolvers: z ≥ 0, z_box > 0 at an upper bound, empty without rows."""
    solution = solve_problem(Problem(P, Q, lb=np.array([2.0, 0.0]), ub=np.array([3.0, 1.0])), NAME)
    assert solution.x.tolist() == [2.0, 1.0]
    assert solution.z_box.tolist() == [-2.0, 2.0]
    assert solution.z.shape == solution.y.shape == (0,)
    solution = solve_problem(Problem(P, Q, G, H), NAME)
    np.testing.assert_allclose(solution.x, [0.5, 1.5], rtol=1e-12)
    np.testing.assert_allclose(solution.z, [1.0], rtol=1e-10)
    assert solution.z_box.shape == (0,)


@pytest.mark.parametrize("sparse", [None, True, False])
def test_least_squares(sparse):
    """``solve_ls`` within bounds agrees with scipy's nnls for both of its conversions."""
    rng = np.random.default_rng(2)
    R, s = rng.standard_normal((9, 4)), rng.standard_normal(9)
    x = qpsolvers.solve_ls(R, s, lb=np.zeros(4), solver=NAME, sparse_conversion=sparse)
    np.testing.assert_allclose(x, nnls(R, s)[0], atol=1e-9)


def test_infeasible_comes_with_a_proof():
    """An infeasible program has x None, INFEASIBLE in the extras, and a proof that verifies."""
    problem = Problem(P, Q, np.array([[1.0, 1.0], [-1.0, -1.0]]), np.array([1.0, -2.0]))
    solution = solve_problem(problem, NAME)
    assert (solution.found, solution.x, solution.extras["status"]) == (
        False,
        None,
        Status.INFEASIBLE,
    )
    assert solution.extras["result"].proof.verify()
    assert solution.extras["result"].has_no_solution


def test_a_limit_is_no_solution():
    """A run that ended early has found False, and its best x with residuals in the extras."""
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((80, 60))
    problem = Problem(np.diag(rng.random(60)), rng.standard_normal(60), rows, rng.random(80))
    solution = solve_problem(problem, NAME, max_seconds=0.0)
    assert (solution.found, solution.x, solution.extras["status"]) == (
        False,
        None,
        Status.MAX_SECONDS,
    )
    assert not solution.extras["result"].solution.is_optimal()
    assert solve_problem(problem, NAME).found


def test_initvals_start_a_program_with_bounds():
    """The solution as a start takes no step; in a program with rows it changes nothing."""
    n = 300
    laplacian = sp.diags_array(
        [-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csc"
    )
    problem = Problem(sp.csc_matrix(laplacian), -np.ones(n), lb=np.zeros(n), ub=np.full(n, 50.0))
    cold = solve_problem(problem, NAME, algorithm="newton")
    warm = solve_problem(problem, NAME, initvals=cold.x, algorithm="newton")
    assert warm.extras["result"].iterations < cold.extras["result"].iterations
    np.testing.assert_allclose(warm.x, cold.x, atol=1e-8)
    assert solve_qp(P, Q, G, H, initvals=np.zeros(2), solver=NAME) == pytest.approx(
        [0.5, 1.5], rel=1e-12
    )


@pytest.mark.parametrize(
    ("error", "given", "words"),
    [
        (
            ParamError,
            {"eps_abs": 1e-6},
            r"got \['eps_abs'\].*solve itself takes .*max_seconds.*tolerance",
        ),
        (ParamError, {"tolerence": 1e-6}, "did you mean 'tolerance'"),
        (ParamError, {"initvals": np.zeros(3)}, "initvals must be a vector of length 2, got shape"),
        (ParamError, {"callback": 3}, "callback must be callable"),
        (ProblemError, {"q": np.array([np.nan, 0.0])}, r"q must be finite, but q\[0\] = nan"),
        (ProblemError, {"P": 0.0 * P}, "the program is unbounded below"),
    ],
    ids=lambda value: str(value)[:24] if isinstance(value, (str, dict)) else "",
)
def test_what_is_refused(error, given, words):
    """Invalid arguments raise qpsolvers' exceptions, with a message."""
    with pytest.raises(error, match=words):
        solve_qp(**{"P": P, "q": Q, "solver": NAME, **given})
