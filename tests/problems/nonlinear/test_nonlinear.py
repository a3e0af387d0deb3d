"""Nonlinear complementarity: published and manufactured solutions, statuses, proofs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import example, given, settings
from hypothesis import strategies as st
from inputs import nonlinear_models as models
from nonlinear_families import KINDS, planted
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, NonlinearProblem, NotConverged, Result, Status, solve
from lcp_plugin.judges.lcp import RowData
from lcp_plugin.problems.nonlinear.data import Linearization
from lcp_plugin.problems.nonlinear.steps import small_step

INF = np.inf
ROOTS = {(round(np.sqrt(6) / 2, 6), 0.0, 0.0, 0.5), (1.0, 0.0, 3.0, 0.0)}
SEEDS = st.integers(0, 2**32 - 1)


def solved(result: Result) -> np.ndarray:
    assert result.status is Status.SOLVED, result.explain()
    return result.z


# --- published ---------------------------------------------------------------------------------------------------


def test_both_solutions_of_kojima_and_shindo_are_found(draws):
    """Both solutions are found, depending on the start."""
    starts = np.random.default_rng(0).uniform(0, 3, (len(draws(40, 4)), 4))
    found = {
        tuple(solved(solve(NonlinearProblem(models.kojima_shindo), x0=x0)).round(4) + 0.0)
        for x0 in starts
    }
    assert found == {tuple(np.round(root, 4)) for root in ROOTS}


def test_scarf():
    """Scarf's economy has no shortage, goods in excess are free, and no activity makes a profit."""
    problem, start, excess_supply = models.scarf()
    result = solve(problem, x0=start)
    prices, excess = excess_supply(solved(result))
    assert excess.min() > -1e-6
    assert np.abs(prices * excess).max() < 1e-5
    assert result.w[6:14].min() > -1e-7
    assert result.iterations <= 10


@pytest.mark.parametrize("size", [10, 30])
def test_a_convex_minimal_surface_takes_few_steps(size):
    """A monotone search reaches the surface over an obstacle in at most 20 steps; ‖∇F‖ degenerates on other ways."""
    problem = models.minimal_surface(size)
    result = solve(problem, x0=np.full(size * size, 0.5))
    x, w = solved(result), problem.F(result.z)
    assert (
        np.abs(np.minimum(np.where(problem.lower > -INF, x - problem.lower, INF), w)).max() < 1e-7
    )
    assert result.iterations <= 20


@pytest.mark.parametrize("search", ["monotone", "nonmonotone"])
def test_a_search_can_be_chosen(search):
    """Each search alone solves an oligopoly; without restarts a local minimum ends the run."""
    solved(solve(NonlinearProblem(models.NASH_5), x0=np.ones(5), search=search))
    problem = NonlinearProblem(models.billups)
    assert solve(problem, x0=[0.0], search=search, restarts=0).status is Status.STALLED


# --- manufactured solutions -------------------------------------------------------------------------------------


@settings.get_profile("few")
@given(SEEDS, st.sampled_from(KINDS), st.integers(1, 30), st.booleans())
def test_planted_problems(seed, kind, n, is_far):
    """SOLVED is true in extended precision; all other ends of solvable problems are honest failures."""
    rng = np.random.default_rng(seed)
    one = planted(rng, kind, n)
    result = solve(one.problem, x0=rng.standard_normal(n) * is_far)
    assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT, Status.STALLED)
    certificate = result.certificate
    if result.is_solved and certificate.by_row.reference.max() > 0.0:
        assert one.sharp_relative_residual(result.z, certificate.problem.residual_scale) <= 1e-8


@pytest.mark.parametrize("start", [0.0, 1.0, 4.0])
@pytest.mark.parametrize(
    ("offset", "answer"), [(1.0, 0.0), (-1.0, 1.0), (-1e-3, 1e-6), (-1e-6, 1e-12), (-1e-9, 1e-18)]
)
def test_an_infinite_slope_at_a_bound_is_no_obstacle(start, offset, answer):
    """√x + c, whose slope at the bound 0 is infinite, is solved where the bound is the answer, and where it is not."""
    problem = NonlinearProblem(
        lambda x: np.sqrt(x) + offset, lambda x: np.diag(0.5 / np.sqrt(x)), lower=[0.0]
    )
    result = solve(problem, x0=[start])
    assert result.status is Status.SOLVED
    assert result.iterations < 20
    np.testing.assert_allclose(result.z, answer, rtol=1e-7)


def test_a_solve_from_the_answer_is_solved_where_F_is_undefined_at_0():
    """An oligopoly, in which the price at no output is infinite, is solved from its own equilibrium in no steps."""
    problem = NonlinearProblem(models.NASH_5)
    first = solve(problem, x0=np.full(5, 10.0)).require_solved()
    again = solve(problem, x0=first.z)
    assert again.status is Status.SOLVED
    assert again.iterations == 0


def test_steps_into_the_undefined_are_shortened():
    """The root of log x − 1, x ≥ 0, is found from both sides, although full steps lead to where log is undefined."""
    for start in (0.01, 100.0):
        assert solved(solve(NonlinearProblem(lambda x: np.log(x) - 1.0), x0=[start]))[
            0
        ] == pytest.approx(np.e)


@pytest.mark.parametrize("start", [-2.0, 3.0])
def test_steps_to_points_without_a_derivative_are_shortened(start):
    """The root 1 of x³ − 1 is found, although the derivative is NaN between 1.3 and 2.2."""
    problem = NonlinearProblem(
        lambda x: x**3 - 1.0,
        lambda x: np.diag(np.where((x > 1.3) & (x < 2.2), np.nan, 3.0 * x**2)),
        lower=-INF,
    )
    assert solved(solve(problem, x0=[start]))[0] == pytest.approx(1.0)


@pytest.mark.quick(1)
@pytest.mark.parametrize("size", [32, 100, 316])
def test_steps_do_not_grow_under_refinement(size):
    """A membrane with a nonlinear source takes at most 8 steps at n = 10³, 10⁴ and 10⁵."""
    result = solve(models.membrane(size)[0], x0=np.zeros(size * size))
    assert 0.2 < (solved(result) == models.membrane(size)[0].lower).mean() < 0.4
    assert result.iterations <= 8


# --- differences -------------------------------------------------------------------------------------------------


def test_differences_on_a_pattern():
    """Differences on a five-point pattern take 7 evaluations, and give the same solution."""
    problem, A = models.membrane(15)
    calls = []

    def F(x):
        calls.append(x)
        return problem.F(x)

    by_differences = NonlinearProblem(F, lower=problem.lower, pattern=A)
    x = np.random.default_rng(0).standard_normal(225)
    found = by_differences.derivative(x)
    assert len(calls) <= 8
    np.testing.assert_allclose(found.toarray(), problem.derivative(x).toarray(), atol=1e-6)
    np.testing.assert_allclose(
        solved(solve(by_differences, x0=np.zeros(225))),
        solve(problem, x0=np.zeros(225)).z,
        atol=1e-8,
    )


def test_differences_stay_within_the_bounds():
    """Differences are one-sided at an upper bound, or if F is undefined above x."""
    problem = NonlinearProblem(lambda x: np.sqrt(2.0 - x), upper=[2.0, 3.0])
    assert problem.derivative([1.0, 2.0 - 1e-9])[0, 0] == pytest.approx(-0.5)
    assert np.isfinite(problem.derivative([1.0, 2.0 - 1e-9])).all()


def test_columns_of_one_group_may_leave_the_domain_on_different_sides():
    """Each entry is taken on the side where F is defined."""

    def F(x):
        return np.array([(x[0] - 0.5) - (1.0 - x[0]) ** 1.5, (x[1] - 2.0) + (x[1] - 1.0) ** 1.5])

    problem = NonlinearProblem(F, pattern=sp.eye_array(2, format="csc"))
    assert solved(solve(problem, x0=[1.0, 1.0])).shape == (2,)


# --- how a run ends ----------------------------------------------------------------------------------------------


def test_an_equation_without_a_root_is_stalled():
    """An equation without a root ends STALLED with advice, never INFEASIBLE and never SOLVED."""
    result = solve(NonlinearProblem(lambda x: x**2 + 1.0, lower=-INF), x0=[3.0])
    assert result.status is Status.STALLED
    assert "(starts: 11): " in result.explain()
    assert "another start" in result.explain()
    with pytest.raises(NotConverged, match="local minimum of the residual"):
        result.require_solved()


@pytest.mark.full
@pytest.mark.parametrize(
    ("F", "lower"),
    [
        (lambda x: -np.exp(-x), 0.0),
        (lambda x: -1 / x, 1.0),
        (lambda x: -1 / (1 + x) ** 3, 0.0),
        (lambda x: -1.0 - 1.0 / x, 1e-9),
        (lambda x: 1 / (1 + x**2), -INF),
        (np.exp, -INF),
        (lambda x: np.array([x[0] - 2, -np.exp(-x[-1])]), 0.0),
    ],
)
@pytest.mark.parametrize("start", [1.0, 3.0])
def test_running_away_is_no_solution(F, lower, start):
    """An F that only tends to 0 has no solution, however far x runs and however flat F is there."""
    result = solve(NonlinearProblem(F, lower=lower), x0=np.full(np.size(F(np.ones(2))), start))
    assert result.status is Status.STALLED


def test_slack_at_a_bound_lends_no_tolerance():
    """Unknown x₀ runs to 7e11 while slack of 5e10 keeps x₁ at its bound: row 0 must not pass."""

    def F(x):
        return np.array([-(x[0] ** -3.0) - 0.1 + 0.1 * x[1], 0.1 * x[0] + x[1] - 1.0])

    def jacobian(x):
        return np.array([[3.0 * x[0] ** -4.0, 0.1], [0.1, 1.0]])

    problem = NonlinearProblem(F, jacobian, lower=[-INF, 0.0])
    assert Linearization(problem, np.array([7e11, 0.0])).certificate.term_residuals[0] > 0.1


@pytest.mark.full
@pytest.mark.parametrize("has_jacobian", [False, True])
@pytest.mark.parametrize(
    "x0",
    [
        [0, 0, 0],
        [2, 0, 0],
        *(
            pytest.param(x0, marks=pytest.mark.full)
            for x0 in ([1, 1, 1], [0.5, 0.5, 0.5], [0, 0, 1], [1, 0, 1], [3, 1, 2])
        ),
    ],
)
def test_a_multiplier_that_runs_away_is_no_solution(x0, has_jacobian):
    """The minimum of (x₀−2)² + x₁² on x₁ ≤ (1−x₀)³, x ≥ 0, is a cusp: its multiplier runs away."""

    def F(z):
        return np.array(
            [2 * (z[0] - 2) + 3 * z[2] * (1 - z[0]) ** 2, 2 * z[1] + z[2], (1 - z[0]) ** 3 - z[1]]
        )

    def jacobian(z):
        flat = 3 * (1 - z[0]) ** 2
        return np.array([[2 - 6 * z[2] * (1 - z[0]), 0, flat], [0, 2, 1], [-flat, -1, 0]])

    result = solve(NonlinearProblem(F, jacobian if has_jacobian else None), x0=x0)
    assert result.status is Status.STALLED
    # A limit of the criterion: the point at e = 1e-7 passes, farther out the rounding errors of F are too large.
    for e, passes in ((1e-7, True), (1e-9, False), (1e-12, False)):
        x = np.array([1 - e, 0.0, 2 * (1 + e) / (3 * e**2)])
        found = solve(NonlinearProblem(F, jacobian), x0=x, max_iterations=0)
        assert found.is_solved is passes


def test_beside_a_pole_the_unit_of_the_part_excuses_nothing():
    """A derivative of 2e14 promises a zero 8e-9 away, nothing in the unit 100 of the other row; the zero is at .017."""

    def F(x):
        return np.array([1e-2 * (x[1] - 100.0) + 0.7 - 0.0128549 / x[0], x[1] - 100.0])

    def jacobian(x):
        return np.array([[0.0128549 / x[0] ** 2, 1e-2], [0.0, 1.0]])

    problem = NonlinearProblem(F, jacobian, lower=1e-9)
    for x, is_there in (
        ([8e-9, 100.0 + 1e-9], False),
        ([0.0128549 / 0.7 + 1e-12, 100.0 + 1e-9], True),
    ):
        certificate = solve(problem, x0=x, max_iterations=0).certificate
        assert (certificate.term_residual <= 1e-8) == is_there
    assert solved(solve(problem, x0=[8e-9, 100.0]))[0] == pytest.approx(0.0128549 / 0.7)


@pytest.mark.parametrize("jacobian", [None, lambda x: np.diag(-10.0 / x**2)])
def test_ten_by_x_less_one_is_solved_at_its_root_or_not(jacobian):
    """10/x − 1 from 100: a SOLVED x is 10, never so large that F = −1, and the run ends where the merit overflows."""
    result = solve(NonlinearProblem(lambda x: 10.0 / x - 1.0, jacobian), x0=[100.0])
    assert result.iterations < 1000
    assert not result.is_solved or result.z[0] == pytest.approx(10.0, rel=1e-6)


@pytest.mark.parametrize("jacobian", [None, lambda x: np.diag(3.0 * x**2 + 2.0 * x - 2.0)])
def test_of_several_solutions_one_near_the_start_is_found(jacobian):
    """F = x (x − 1) (x + 2) from its root 1 stays there, although 0 solves as well."""
    problem = NonlinearProblem(lambda x: x * (x - 1.0) * (x + 2.0), jacobian)
    assert solved(solve(problem, x0=[1.0]))[0] == 1.0


@pytest.mark.parametrize("jacobian", [None, lambda x: np.diag([1.0, -1.0 / x[1] ** 2])])
@pytest.mark.parametrize("start", [(1e10, 0.6), (0.0, 0.6)])
def test_two_problems_in_units_of_their_own(jacobian, start):
    """The equations x₀ = 1e10 and 1/x₁ = 2 are two components, each solved at its size."""
    problem = NonlinearProblem(lambda x: np.array([x[0] - 1e10, 1.0 / x[1] - 2.0]), jacobian)
    np.testing.assert_allclose(solved(solve(problem, x0=start)), [1e10, 0.5], rtol=1e-7)


@pytest.mark.full
def test_an_algorithm_that_does_not_take_a_linearisation_is_replaced():
    """Algorithm psor requires a positive diagonal, and auto replaces it otherwise."""
    problem = NonlinearProblem(
        lambda x: np.array([x[0] ** 2 - 2.0 * x[0] + 0.5 * x[1] - 1.0, x[1] - 1.0])
    )
    solved(solve(problem, x0=[0.0, 0.0], algorithm="psor"))


POLICIES = ("auto", "npsor", "psor", "newton", "interior_point", "lemke")  # one per method family
HOPELESS = {
    "undefined beyond 2": lambda x: -2.0 - np.sqrt(2.0 - x),
    "indefinite": lambda x: -1.0 - x[::-1] * np.array([1.0, 2.0]),
    "no linearization has a solution": lambda x: -1.0 - x,
}


@pytest.mark.full
@pytest.mark.parametrize("algorithm", POLICIES)
@pytest.mark.parametrize("name", HOPELESS)
def test_a_hopeless_nonlinear_problem_ends(algorithm, name):
    """If nothing can be solved every policy ends after a bounded number of steps."""
    result = solve(NonlinearProblem(HOPELESS[name]), x0=[1.0, 0.5], algorithm=algorithm)
    assert not result.is_solved
    assert result.iterations <= 15 * 30  # starts and searches, and steps without a gain


def test_prices_near_zero_lend_no_tolerance():
    """F is 1e20 at z°, prices of 1e-5, but a SOLVED still means that the markets clear."""
    supply = np.array([3.0, 1.0, 0.5])
    result = solve(NonlinearProblem(lambda p: supply - p**-4.0, lower=1e-5), x0=np.full(3, 0.02))
    np.testing.assert_allclose(solved(result), supply**-0.25, rtol=1e-6)
    np.testing.assert_allclose(result.w, 0.0, atol=1e-6)


@pytest.mark.full
def test_rounding_in_f_is_a_precision_limit():
    """Rounding error in F above the tolerance gives PRECISION_LIMIT, a wrong derivative not."""
    noisy = NonlinearProblem(
        lambda x: (x**3 + 1e9 * np.sin(1e15 * x) * 2.0**-52) - 7.3,
        lambda x: np.diag(3 * x**2),
        lower=-INF,
    )
    result = solve(noisy, x0=[3.0], tolerance=1e-12, check_jacobian=False)
    assert result.status is Status.PRECISION_LIMIT
    wrong = NonlinearProblem(lambda x: np.array([x[0] ** 3 - 7.3]), lambda x: [[-1.0]], lower=-INF)
    assert solve(wrong, x0=[3.0], check_jacobian=False).status is not Status.PRECISION_LIMIT


FUNCTIONS_AT_ROUNDING_LEVEL: dict[str, tuple[Any, Any]] = {  # F(x) − d, and its root
    "exp(x) − 1": (lambda x: np.exp(x) - 1.0, np.log1p),
    "1 − exp(−x)": (lambda x: 1.0 - np.exp(-x), lambda d: -np.log1p(-d)),
    "√(1 + x) − 1": (lambda x: np.sqrt(1.0 + x) - 1.0, lambda d: 2.0 * d + d * d),
    "(1 + x)³ − 1": (lambda x: (1.0 + x) ** 3 - 1.0, lambda d: np.expm1(np.log1p(d) / 3.0)),
    "return mapping": (lambda x: 250.0 - abs(250.0 - x), lambda d: d),
}


@pytest.mark.parametrize("name", FUNCTIONS_AT_ROUNDING_LEVEL)
@pytest.mark.parametrize("is_coupled", [False, True])
def test_a_root_below_the_rounding_errors_of_constants_is_found(name, is_coupled):
    """Constants of F hide the root from 10⁻⁷ to 10⁻¹³: x is as near to it as F tells."""
    F, root = FUNCTIONS_AT_ROUNDING_LEVEL[name]
    A = np.eye(2) + 0.25 * is_coupled * np.array([[0.0, 1.0], [-1.0, 0.0]])
    for exponent in range(7, 14):
        unit = 250.0 if name == "return mapping" else 1.0
        d = unit * np.array([10.0**-exponent, 10.0 ** -(exponent - 3)])
        f = lambda x, d=d: A @ (np.array([F(x[0]), F(x[1])]).ravel() - d)  # noqa: E731
        result = solve(NonlinearProblem(f, lower=[0.0, 0.0]), x0=[0.0, 0.0])
        assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT), d
        np.testing.assert_allclose(result.z, root(d), rtol=1e-7, atol=2e-15 * unit)
        assert result.iterations < 30


def test_a_tolerance_below_the_rounding_errors_of_exponentials_is_a_precision_limit():
    """1 − e⁻ˣ has rounding errors of 2⁻⁵⁴, and x is small: no point has a measured residual of 1e-15."""
    n = 100
    A = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    load = -np.sin(np.linspace(0, 2 * np.pi, n + 2)[1:-1]) / 2 / (n + 1) ** 2
    problem = NonlinearProblem(
        lambda x: A @ (1 - np.exp(-x)) + load, lambda x: A * np.exp(-x), np.zeros(n)
    )
    result = solve(problem, tolerance=1e-15)
    assert result.status is Status.PRECISION_LIMIT
    np.testing.assert_allclose(result.z, -np.log1p(-solve(LCP(A, load)).z), atol=1e-8)


def test_nothing_of_the_callers_is_changed():
    """Start, bounds and returned arrays of F are not modified, and F receives read-only arrays."""
    x0, lower, kept = np.ones(2), np.zeros(2), np.array([-1.0, 2.0])

    def F(x):
        assert not x.flags.writeable
        return kept

    solve(
        NonlinearProblem(F, lambda x: np.eye(2), lower),
        x0=x0,
        check_jacobian=False,
        max_iterations=3,
    )
    assert x0.tolist() == [1, 1]
    assert lower.tolist() == [0, 0]
    assert kept.tolist() == [-1, 2]


@pytest.mark.parametrize("kind", ["csr", "csc", "coo", "lil", "dok", "dia", "bsr"])
def test_every_kind_of_sparse_derivative_is_taken(kind):
    """The solution is the same for every sparse format of scipy."""

    def jacobian(x):
        return sp.csr_array(np.diag(3 * x**2) + np.eye(3, k=1)).asformat(kind)

    result = solve(
        NonlinearProblem(lambda x: x**3 + np.append(x[1:], 0.0) - 9.0, jacobian), x0=np.ones(3)
    )
    np.testing.assert_allclose(result.w, 0.0, atol=1e-7)


def test_a_derivative_that_is_written_to_again_is_no_obstacle():
    """A derivative in one reused array gives the same result bit for bit as new arrays."""
    F, slopes = models.kojima_shindo, NonlinearProblem(models.kojima_shindo).derivative
    shared = sp.csr_array(np.ones((4, 4)))

    def fresh(x):
        return sp.csr_array((np.ravel(slopes(x)), shared.indices, shared.indptr), shape=(4, 4))

    def refilled(x):
        shared.data[:] = fresh(x).data
        return shared

    start = np.array([3.0, 0.0, 5.0, 1.0])
    one, other = (
        solve(NonlinearProblem(F, J), x0=start, max_iterations=2) for J in (fresh, refilled)
    )
    np.testing.assert_array_equal(one.z, other.z)
    assert str(one.certificate) == str(other.certificate)
    first, second = (
        NonlinearProblem(F, refilled).linearize(np.full(4, value)) for value in (1.0, 2.0)
    )
    assert (first.M != second.M).nnz > 0


def test_the_lcp_solver_can_be_chosen():
    """A named algorithm solves the linearizations."""
    for algorithm in ("lemke", "newton"):
        solved(solve(NonlinearProblem(models.NASH_5), x0=np.ones(5), algorithm=algorithm))


# --- mistakes ----------------------------------------------------------------------------------------------------

NP = NonlinearProblem


@refusals(r"""
NP(np.eye(2)) → InvalidProblem: F must be callable as F\(x\), got ndarray; .* LCP\(M, q\)
NP(np.sin, 3) → InvalidProblem: jacobian must be callable
NP(np.sin, np.diag, pattern=np.eye(2)) → InvalidProblem: leave one out
NP(np.sin, pattern=np.ones((2, 3))) → InvalidProblem: square
NP(np.sin, lower=[0, 0], upper=[1, 1, 1]) → InvalidProblem: upper must be a number or a vec
solve(NP(np.sin)) → InvalidOption: x0 is needed because the number of unknowns is not known
solve(NP(np.sin, lower=[0, 0]), x0=[1.0]) → InvalidOption: x0 must be .* length 2
solve(NP(lambda x: x[:1]), x0=np.ones(2)) → InvalidProblem: length 2 .* shape \(1,\)
solve(NP(lambda x: None), x0=np.ones(2)) → InvalidProblem: got None
solve(NP(lambda x: np.log(x - 5), lower=-INF), x0=[-1.0]) → InvalidProblem: F\(x0\)\[0\] = nan
solve(NP(np.sin, lambda x: np.eye(3)), x0=[1.0]) → InvalidProblem: shape \(1, 1\)
solve(NP(np.sin, lambda x: [[np.nan]]), x0=[1.0]) → InvalidProblem: jacobian.*finite
solve(NP(np.sin), x0=np.ones(1001)) → InvalidProblem: pattern
solve(NP(np.sin), x0=[1.0], search="both") → InvalidOption: search must be "monotone", "nonmonotone" or None, got 'both'
solve(NP(models.NASH_5), x0=np.ones(5), algorithm="lemk") → UnknownAlgorithm: lemke
solve(NP(np.sin), x0=[1.0], restarts=-1) → InvalidOption: restarts must be an integer ≥ 0
""")
def test_mistakes_are_refused_in_words(call, words):
    """Every mistake is named, with what is needed instead."""
    assert_refused(call, words, globals())


def test_a_wrong_jacobian_is_named():
    """The row of a derivative that contradicts F is named in explain(); the check can be switched off."""
    problem, _ = models.membrane(10)

    def wrong(x):
        J = sp.lil_array(problem.jacobian(x))
        J[37, 38] = 5.0
        return J.tocsr()

    mistaken = NonlinearProblem(problem.F, wrong, problem.lower)
    words = "jacobian disagrees with F at the start: along one direction row 37 of"
    assert words in solve(mistaken, x0=np.zeros(100)).explain()
    unchecked = solve(mistaken, x0=np.zeros(100), check_jacobian=False)
    assert words not in unchecked.explain()


@pytest.mark.parametrize("precision", [np.float64, np.float32])
@settings.get_profile("few")
@given(SEEDS, st.sampled_from(KINDS), st.integers(1, 20))
@example(3, "far exponential", 3)
def test_a_right_jacobian_is_not_warned_of(precision, seed, kind, n):
    """The check finds no fault in derivatives that are right, in single precision also, wherever the start is."""
    rng = np.random.default_rng(seed)
    one = planted(rng, kind, n)
    problem = NonlinearProblem(
        lambda x: np.asarray(one.F(x), precision),
        lambda x: one.jacobian(x).astype(precision),
        one.lower,
        one.upper,
    )
    result = solve(problem, x0=rng.standard_normal(n), max_iterations=0)
    assert "disagrees" not in result.explain()


@pytest.mark.parametrize("offset", [1e9, 1e13, 1e14, 1e15])
def test_rounding_of_a_large_function_is_no_wrong_jacobian(offset):
    """Differences of √2 x + 10¹⁵ are multiples of 1/8, of steps of 10⁻³."""
    problem = NonlinearProblem(lambda x: np.sqrt(2.0) * x + offset, lambda x: [[np.sqrt(2.0)]])
    assert "disagrees" not in solve(problem, x0=[1.0 / 3.0], max_iterations=0).explain()


def test_an_unknown_that_no_active_row_depends_on_is_excused():
    """Unknown x₂ appears only in a row at its bound, and does not affect the small x₁."""

    def F(v):
        return np.array(
            [
                v[0] / 3 + v[1] / 7 - 1000.1,
                v[0] / 3 - v[1] / 11 - 999.9 + 1e-9 * v[0],
                v[3],
                v[2] + 3 + 1e-3 * v[0],
            ]
        )

    def jacobian(v):
        return np.array(
            [[1 / 3, 1 / 7, 0, 0], [1 / 3 + 1e-9, -1 / 11, 0, 0], [0, 0, 0, 1], [1e-3, 0, 1, 0]]
        )

    problem = NonlinearProblem(F, jacobian, lower=[0, 0, -INF, 0])
    result = solve(problem, x0=[1.0, 1.0, 5.0, 0.0])
    v = solved(result)
    np.testing.assert_allclose(np.minimum(v[:2], F(v)[:2]), 0.0, atol=1e-8)
    assert result.z[3] == 0.0


@pytest.mark.parametrize("k", [1, 3, 8, 20])
def test_after_ctrl_c_the_function_is_not_called_again(k):
    """An interrupt in call k of F is the last call, and the result is INTERRUPTED after the first step."""
    calls = []

    def F(x):
        calls.append(x)
        if len(calls) == k:
            raise KeyboardInterrupt
        return np.exp(x) - [1.0, 8.0]

    try:
        assert solve(NonlinearProblem(F), x0=[9.0, 9.0]).status is Status.INTERRUPTED
    except KeyboardInterrupt:
        assert k < 8
    assert len(calls) == k


def test_a_run_without_a_start_begins_in_the_bounds_nearest_to_0():
    """The lower bound 1, the upper bound −2 and no bound give the start (1, −2, 0)."""
    seen = []
    problem = NonlinearProblem(
        lambda x: seen.append(x.copy()) or x - [3.0, -3.0, 2.0],  # type: ignore[func-returns-value]
        lower=[1.0, -np.inf, -np.inf],
        upper=[np.inf, -2.0, np.inf],
    )
    np.testing.assert_allclose(solve(problem).require_solved().x, [3.0, -3.0, 2.0])
    np.testing.assert_array_equal(seen[0], [1.0, -2.0, 0.0])


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_a_root_without_slope_ends_at_the_limit(size):
    """Hock and Schittkowski's problem 78 has stationary points at which the conditions lose their slope.

    min Π x_i under Σ x² = 10, x₂ x₃ = 5 x₄ x₅, x₁³ + x₂³ = −1: from (−1, 1.5, 2, −1, −2) at (−1, 0, 0, 0, −3).
    """

    def F(z):
        x, (a, b, c) = z[:5], z[5:]
        slopes = np.array([np.prod(np.delete(x, i)) for i in range(5)]) - 2 * a * x
        slopes -= b * np.array([0, x[2], x[1], -5 * x[4], -5 * x[3]])
        slopes[:2] -= 3 * c * x[:2] ** 2
        rows = [x @ x - 10, x[1] * x[2] - 5 * x[3] * x[4], x[0] ** 3 + x[1] ** 3 + 1]
        return size * np.concatenate([slopes, rows])

    start = np.array([-1, 1.5, 2, -1, -2, 1, 1, 1])
    result = solve(NonlinearProblem(F, lower=np.full(8, -INF)), x0=start)
    np.testing.assert_allclose(solved(result)[:5], [-1, 0, 0, 0, -3], atol=1e-10)
    assert result.iterations < 100


def test_evaluations_are_counted():
    """The result has the numbers of calls of F, of derivatives, and of calls without a finite value."""
    calls = []
    problem = NonlinearProblem(lambda x: calls.append(x) or np.log(x) - 1.0)  # type: ignore[func-returns-value]
    F, slopes, undefined = solve(problem, x0=[100.0]).evaluations
    assert len(calls) == F
    assert 1 < slopes < F
    assert undefined == sum((x < 0).any() or (x == 0).any() for x in calls) > 0


@pytest.mark.parametrize("F", [lambda x: x**3, lambda x: x * np.sin(x)])
def test_a_root_at_0_without_a_slope_is_reached_from_afar(F):
    """Newton's steps only halve the distance or so, and the run ends at the exact root."""
    result = solve(NonlinearProblem(F, lower=np.full(1, -np.inf)), x0=np.ones(1))
    assert (result.status, result.z[0]) == (Status.SOLVED, 0.0)
    assert result.iterations < 50


def test_a_watched_run_takes_the_same_steps() -> None:
    """A run that reports its steps ends at the same bits after the same evaluations, also if Newton steps fail."""
    for F, n, start in (
        (np.expm1, 3, 1.0),
        (models.kojima_shindo, 4, 1.0),  # with a damped step
        (models.josephy, 4, 10.0),
        (lambda x: x**3 - 1e-3 + 0.1 * x[::-1], 2, -2.0),
        (lambda x: np.arctan(x) + 2.0, 1, 3.0),  # without a solution
    ):
        problem = NonlinearProblem(F, lower=np.full(n, -2.0 if F is np.expm1 else 0.0))
        quiet, watched = (
            solve(problem, x0=np.full(n, start), callback=call) for call in (None, lambda *_: None)
        )
        assert (quiet.status, quiet.z.tobytes()) == (watched.status, watched.z.tobytes())
        for name in ("iterations", "work", "evaluations", "stages", "begun", "advice", "residual"):
            assert getattr(quiet, name) == getattr(watched, name), name


@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1.0])
def test_a_right_jacobian_is_trusted_where_unknowns_are_small(unit):
    """(x/D)³ + x/D = 2 has the root D: the steps that check the jacobian there have the size of x."""
    problem = NonlinearProblem(
        lambda x: (x / unit) ** 3 + x / unit - 2,
        lambda x: np.diag(3 * (x / unit) ** 2 + 1) / unit,
        lower=np.zeros(1),
    )
    np.testing.assert_allclose(solve(problem).require_solved().z, unit)


def test_an_absolute_tolerance_ends_no_later():
    """A run with an absolute tolerance ends where the call without it ends, or sooner."""
    problem = NonlinearProblem(lambda x: np.exp(x) - 2.0, lower=np.zeros(4))
    plain = solve(problem)
    fine, rough = (solve(problem, absolute_tolerance=size) for size in (1e-12, 1e-2))
    assert fine.z.tobytes() == plain.z.tobytes()
    assert rough.is_solved
    assert rough.iterations < plain.iterations
    assert np.abs(rough.z - np.log(2.0)).max() <= 1e-2


@pytest.mark.parametrize("F", [lambda x: np.exp(x) - 2.0, lambda x: np.arctan(x - 9.0)])
def test_a_sample_costs_no_measurement(monkeypatch, F):
    """A recorded run has the bits of the plain run, computes as many residuals, and has a sample per step."""
    calls: list[int] = []
    residual = RowData.residual
    monkeypatch.setattr(RowData, "residual", lambda *data: calls.append(0) or residual(*data))
    problem = NonlinearProblem(F, lower=np.zeros(4))
    plain, so_many = solve(problem), len(calls)
    result = solve(problem, record=True)
    assert len(calls) == 2 * so_many
    assert result.z.tobytes() == plain.z.tobytes()
    assert [sample.iteration for sample in result.history] == [*range(result.iterations + 1)]
    assert all(sample.residual > 1e-8 for sample in result.history[:-1])
    assert result.history[-1].residual <= 1e-8


@pytest.mark.parametrize("absolute", [0.0, 1e-12])
def test_a_point_at_rounding_level_is_accepted_without_its_rows(monkeypatch, absolute):
    """Rows are measured on access only: the sufficient test accepts the end, and far points cannot pass."""
    monkeypatch.setattr(RowData, "measure_at", None)
    problem = NonlinearProblem(lambda x: np.exp(x) - 2.0, lower=np.zeros(4))
    result = solve(problem, absolute_tolerance=absolute)
    assert result.is_solved
    assert result.residual <= 1e-12


@pytest.mark.parametrize("where", [0.0, 1.0])
def test_an_attribute_error_of_f_reaches_its_user(where):
    """An AttributeError of F, at z° or at the start, is raised as it is."""

    def F(x):
        return x.missing if (x == where).all() else x - 3.0

    with pytest.raises(AttributeError, match="missing"):
        solve(NonlinearProblem(F, lower=np.zeros(2)), x0=np.ones(2))


def test_no_linear_problem_is_solved_twice(monkeypatch):
    """An arctan = 0 from 10 takes shorter steps: no linear problem is solved twice."""
    seen: list[bytes] = []
    monkeypatch.setattr(
        "lcp_plugin.problems.nonlinear.steps.small_step",
        lambda M, w, *data: seen.append(M.tobytes() + w.tobytes()) or small_step(M, w, *data),
    )
    F = lambda x: np.arctan(x - np.array([0.0, 0.1]))  # noqa: E731
    result = solve(NonlinearProblem(F), x0=np.array([10.0, 10.0]))
    assert result.is_solved
    assert len(seen) == len(set(seen)) > 2
