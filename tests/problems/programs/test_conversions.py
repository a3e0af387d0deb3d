"""Conversions: the converted problem is equivalent, duals included."""

from __future__ import annotations

import pickle
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import convex_programs
from oracles.exact_program import dot, exact
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, Certificate, InvalidProblem, QuadraticProgram, Status, solve
from lcp_plugin.problems.programs.conversion import qp_from_lcp
from lcp_plugin.problems.programs.solution import QPSolution

TIGHT = {"tolerance": 1e-10, "max_iterations": 200_000}
SEEDS = range(6)


# --- Programs whose answer came first ----------------------------------------------------------------------


def assert_agree(ours: QPSolution, right: QPSolution, tolerance: float) -> None:
    for name in ("x", "inequality", "equality", "lower", "upper"):
        np.testing.assert_allclose(
            getattr(ours, name), getattr(right, name), atol=tolerance, err_msg=name
        )


def planted(seed: int, m: int = 4, p: int = 2, singletons: int = 0) -> QPSolution:
    """x, its active set and all multipliers are drawn; then c, h and b make them right.

    Each third of the rows is active, inactive and degenerate; few enough are active for unique multipliers.
    """
    rng, n = np.random.default_rng(seed), 8
    factor = rng.normal(size=(n, n))
    P = factor @ factor.T + np.eye(n)
    G = np.vstack([rng.normal(size=(m, n)), np.zeros((singletons, n))])
    owned = rng.permutation(n)[:singletons]
    G[np.arange(m, m + singletons), owned] = rng.choice([-2.0, 3.0], singletons)
    A, x = rng.normal(size=(p, n)), rng.normal(size=n)
    kind = np.arange(m + singletons) % 3  # 0 active, 1 inactive, 2 degenerate
    inequality = np.where(kind == 0, rng.uniform(1, 2, m + singletons), 0.0)
    h = G @ x + np.where(kind == 1, 1.0, 0.0)
    equality = rng.normal(size=p)
    state = np.full(n, 1)  # the unknown of a singleton row has loose bounds
    state[np.setdiff1d(np.arange(n), owned)[:2]] = [0, 2]
    lower, upper = np.where(state == 0, x, x - 1.0), np.where(state == 2, x, x + 1.0)
    at_lower, at_upper = (np.where(state == s, rng.uniform(1, 2, n), 0.0) for s in (0, 2))
    c = -(P @ x + G.T @ inequality + A.T @ equality - at_lower + at_upper)
    program = QuadraticProgram(P, c, G, h, A, A @ x, lower, upper)
    return QPSolution(program, x, inequality, equality, at_lower, at_upper)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("sizes", "form", "algorithm"), [((0, 0, 3), "direct", "psor"), ((4, 2, 1), "kkt", "auto")]
)
def test_planted_multipliers_are_recovered(seed, sizes, form, algorithm):
    """A program with bounds and singleton rows only is the direct problem of n rows, and PSOR solves it."""
    answer = planted(seed, *sizes)
    problem = LCP.from_qp(answer.program)
    assert problem.origin.form == form
    assert (problem.n == answer.program.n) == (form == "direct")
    found = problem.origin.recover(solve(problem, algorithm, **TIGHT).require_solved()).solution
    assert_agree(found, answer, 1e-6)


# --- Which form, and what is folded -------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(30))
def test_multipliers_of_crowded_variables(seed):
    """Many singleton rows and bounds on the same variables, ties included: the multipliers found are optimal ones."""
    rng = np.random.default_rng(seed)
    n, m = 4, 12
    G = np.zeros((m, n))
    G[np.arange(m), rng.integers(0, n, m)] = rng.choice([-2.0, -1.0, 1.0, 4.0], m)
    G[:2] = rng.normal(size=(2, n))
    h = rng.integers(0, 3, m).astype(float)
    A, b = (np.eye(n)[:1] * -2.0, [0.0]) if seed % 3 == 0 else (None, None)
    factor = rng.normal(size=(n, n))
    P = factor @ factor.T + np.eye(n)
    program = QuadraticProgram(P, 5 * rng.normal(size=n), G, h, A, b, lower=-1, upper=1)
    problem = LCP.from_qp(program)
    # The smallest cost may be 1e-3, and errors of multipliers are relative to it.
    solution = problem.origin.recover(solve(problem, tolerance=1e-12).require_solved()).solution
    assert solution.is_optimal(1e-8), solution


def test_origins_survive_pickling():
    """A pickled origin recovers the same solution, in either form."""
    for answer in (planted(1), planted(1, m=0, p=0)):
        problem = LCP.from_qp(answer.program)
        z = np.linspace(0, 1, problem.n)
        copy = pickle.loads(pickle.dumps(problem.origin))
        np.testing.assert_array_equal(copy.recover(z).x, problem.origin.recover(z).x)


# --- Back again --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [0, 1, 5])
@pytest.mark.parametrize("sparse", [False, True])
def test_round_trip_of_symmetric_problems(n, sparse):
    """from_qp(to_qp(problem)) has the same M, q and bounds, boxes and free rows included."""
    rng = np.random.default_rng(n)
    factor = rng.normal(size=(n, n))
    M = factor @ factor.T
    M = (M + M.T) / 2
    lower = np.array([0.0, -np.inf, -1.0, -np.inf, 2.0])[:n]
    upper = np.array([np.inf, np.inf, 1.0, 3.0, 2.0])[:n]
    problem = LCP(sp.csr_array(M) if sparse else M, rng.normal(size=n), lower=lower, upper=upper)
    again = LCP.from_qp(qp_from_lcp(problem))
    np.testing.assert_array_equal(again.csr.toarray(), problem.csr.toarray())
    for name in ("q", "lower", "upper"):
        np.testing.assert_array_equal(getattr(again, name), getattr(problem, name))


@pytest.mark.parametrize("seed", SEEDS)
def test_gap_program_of_monotone_problems(seed):
    """The gap program's minimum is at the problem's solution, with value aᵀq, one-sided and free rows included."""
    rng = np.random.default_rng(seed)
    n = 6
    factor, skew = rng.normal(size=(n, n)), rng.normal(size=(n, n))
    M = factor @ factor.T + skew - skew.T
    lower = np.array([0.0, 1.0, -np.inf, -np.inf, -2.0, 0.0])
    upper = np.array([np.inf, np.inf, 3.0, np.inf, np.inf, np.inf])
    z = np.array([0.0, 2.0, 3.0, -1.0, -2.0, 1.5])
    w = np.array([1.5, 0.0, -1.0, 0.0, 2.0, 0.0])
    problem = LCP(M if seed % 2 else sp.csr_array(M), w - M @ z, lower=lower, upper=upper)
    program = qp_from_lcp(problem)
    anchor = np.array([0.0, 1.0, 3.0, 0.0, -2.0, 0.0])
    assert program.objective(z) == pytest.approx(anchor @ problem.q)
    assert program.is_convex
    x = cp.Variable(n)
    reference = cp.Problem(
        cp.Minimize(0.5 * cp.quad_form(x, cp.psd_wrap(program.P)) + program.c @ x),
        [program.G @ x <= program.h, program.A @ x == program.b, x >= lower, x <= upper],
    )
    reference.solve(solver="CLARABEL")
    np.testing.assert_allclose(x.value, z, atol=1e-4)


# --- Definiteness ------------------------------------------------------------------------------------------


def game_of(*payoffs: Any) -> Any:
    """Return a game: players with payoff arrays, each the player's action on the first axis."""
    return SimpleNamespace(
        players=tuple(SimpleNamespace(payoff_array=payoff) for payoff in payoffs)
    )


# --- Linear programs, games, absolute values ----------------------------------------------------------------


GAMES = {
    "battle of the sexes": ([[3, 0], [0, 2]], [[2, 0], [0, 3]], [0.6, 0.4], [0.4, 0.6], (1.2, 1.2)),
    "its pure equilibrium": ([[3, 0], [0, 2]], [[2, 0], [0, 3]], [1, 0], [1, 0], (3, 2)),
    "prisoner's dilemma": ([[-1, -3], [0, -2]], [[-1, 0], [-3, -2]], [0, 1], [0, 1], (-2, -2)),
    "rock paper scissors": (
        [[0, -1, 1], [1, 0, -1], [-1, 1, 0]],
        [[0, 1, -1], [-1, 0, 1], [1, -1, 0]],
        [1 / 3] * 3,
        [1 / 3] * 3,
        (0, 0),
    ),
    "one sure thing": ([[5]], [[7]], [1], [1], (5, 7)),
    "three against two": (
        [[2, 0], [0, 2], [0.5, 0.5]],
        [[0, 3], [1, 0], [5, 0]],
        [1 / 4, 3 / 4, 0],
        [1 / 2, 1 / 2],
        (1, 0.75),
    ),
}


@pytest.mark.parametrize("name", GAMES)
def test_bimatrix_games(name):
    """A known equilibrium, scaled by the costs it meets, solves the problem; recovered, it has no regret."""
    A, B, x, y, payoffs = GAMES[name]
    problem = LCP.from_game(A, B)
    m = len(x)
    costs, other = problem.csr.toarray()[:m, m:], problem.csr.toarray()[m:, :m]
    assert costs.min() > 0 < other.min()
    z = np.concatenate([np.array(x) / (y @ other @ x), np.array(y) / (x @ costs @ y)])
    assert Certificate.of(problem, z).relative_residual < 1e-12
    found = problem.origin.recover(z)
    np.testing.assert_allclose(found.row_strategy, x)
    np.testing.assert_allclose(found.column_strategy, y)
    assert found.payoffs == pytest.approx(payoffs, abs=1e-14)
    assert found.regret < 1e-14


# --- Errors, and data that are not modified -------------------------------------------------------------------

EYE, QP = np.eye(2), QuadraticProgram
game = LCP.from_game


@refusals(r"""
QP([[1, 2]], [1, 2]) → InvalidProblem: P must be a real matrix of shape
QP([[1, 1], [0, 1]], [1, 2]) → InvalidProblem: P\[0, 1\] = 1.0 and P\[1, 0\] = 0.0
QP([[1e+20, 0, 0], [0, 1, 0.5], [0, 0.4, 1]], [1, 2, 3]) → InvalidProblem: P must be symmetric
QP(EYE * 1j, [1, 2]) → InvalidProblem: complex
QP([[1, 0], [0, np.nan]], [1, 2]) → InvalidProblem: P\[1, 1\] = nan
QP(EYE, [[1, 2], [3, 4]]) → InvalidProblem: c must be a vector.*shape \(2, 2\)
QP(np.eye(4), [1, 2, 3, 4], np.ones((4, 3)), [1, 2, 3]) → InvalidProblem: got shape \(4, 3\); did you mean G.T\?
LCP.from_qp(EYE, [1, 2], A=sp.csr_array(np.ones((2, 3))), b=[1, 2, 3])
    → InvalidProblem: got shape \(2, 3\); did you mean A.T\?
QP.from_ranges(EYE, [1, 2], np.ones((2, 3)), np.zeros(3), np.ones(3)) → InvalidProblem: did you mean A.T\?
QP(EYE, [1, 2], np.ones((3, 4)), [1, 2, 3]) → InvalidProblem: got shape \(3, 4\)$
QP(EYE, [1, 2], [1, 2], [1]) → InvalidProblem: as \[\[…\]\]
solve(QP(-3 * EYE, [1, 2])) → UnsupportedModel: smallest eigenvalue of P is -3
solve(QP(None, [-1, 0], [[0, 1]], [1])).require_solved() → NotConverged: UNBOUNDED.*add bounds for the unknowns
QP(EYE, [1, 2], lower=[0, np.nan]) → InvalidProblem: lower\[1\] = nan; use -inf
QP(EYE, [1, 2], EYE) → InvalidProblem: got G without h
QP(EYE, [1, 2], EYE, [1]) → InvalidProblem: h must be a vector of length 2
QP(EYE, [1, 2], EYE, [-np.inf, 1]) → InvalidProblem: h\[0\] = -inf
QP(EYE, [1, 2], lower=1, upper=0) → InvalidProblem: lower ≤ upper
QP.from_ranges(EYE, [1, 2], EYE, 1.0, 0.0) → InvalidProblem: lower
LCP.from_qp(QP(EYE, [1, 2])).origin.recover([-1, -2]).solution.row_multipliers → InvalidProblem: from_ranges
LCP.from_qp(QP(EYE, [1, 2]), c=[1.0]) → InvalidOption: a QuadraticProgram has all data
LCP.from_qp(QP(EYE, [1, 2]), lower=0.0) → InvalidOption: a QuadraticProgram has all data
LCP.from_qp(QP(EYE, [1, 2])).origin.recover([1]) → InvalidProblem: z must be a vector of length 2
qp_from_lcp(LCP([[1, 1], [0, 1]], [1, 1], upper=1)) → UnsuitableProblem: z\[0\] has two bounds
qp_from_lcp(LCP([[1, 4], [0, 1]], [1, 1])) → UnsuitableMatrix: semidefinite
planted(0).is_optimal(-1) → InvalidOption: tolerance must be
game(EYE, [[1, 2]]) → InvalidProblem: B must be.*\(2, 2\)
game(game_of(EYE, EYE), EYE) → InvalidProblem: leave B out
game(game_of(EYE, EYE, EYE)) → InvalidProblem: two players, got a game of 3
game(np.zeros((0, 2)), EYE) → InvalidProblem: at least one row
game(EYE, EYE).origin.recover(np.zeros(4)) → NotConverged: row player
""")
def test_refused(call, words):
    """Invalid data and options raise errors with the value and the next step."""
    assert_refused(call, words, globals())


def test_rounding_in_the_symmetry_is_averaged_away():
    """A P that is symmetric up to rounding error is symmetrized, and the asymmetry is reported."""
    P = np.array([[2.0, 1.0], [1.0 + 1e-15, 2.0]])
    program = QuadraticProgram(P, [0, 0])
    assert program.asymmetry == pytest.approx(1e-15, rel=0.2)
    assert program.P[0, 1] == program.P[1, 0]
    assert "asymmetry" in str(program)


# --- Rows of one variable become bounds; multipliers and proofs come back t ---


def program_with_all(seed: int, *, contradicts: bool = False) -> QuadraticProgram:
    """A program with a doubled row, three simple rows and two fixed variables."""
    rng = np.random.default_rng(seed)
    n = 9
    F = rng.standard_normal((n - 3, n - 3))
    P = np.zeros((n, n))
    P[:-3, :-3], P[-3:, -3:] = F @ F.T + np.eye(n - 3), np.diag([1.0, 2.0, 3.0])
    G = np.zeros((6, n))
    G[:2, :-3], G[3, 1], G[4, 2], G[5, 1] = rng.standard_normal((2, n - 3)), 2.0, -4.0, -1.0
    G[2] = G[0]
    inside = rng.standard_normal(n - 3)
    x = np.append(inside, rng.standard_normal(3))
    h = G @ x + 0.1
    h[2] = h[0]
    if contradicts:
        G[1], h[1] = -G[0], -h[0] - 1.0
    A = np.hstack([rng.standard_normal((3, n - 3)), np.diag([1.0, -2.0, 0.5])])
    lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    lower[[3, 4]] = upper[[3, 4]] = inside[[3, 4]]
    lower[0] = -20.0
    return QuadraticProgram(
        P, rng.standard_normal(n), G, h, A, rng.standard_normal(3), lower, upper
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_program_with_rows_that_become_bounds_is_solved_with_its_multipliers(seed):
    """Points and multipliers belong to the original program, with every row and fixed variable."""
    program = program_with_all(seed)
    found = solve(program)
    assert found.solution.is_optimal(1e-8)
    gradient = (
        program.P @ found.x + program.c + program.constraints.matrix.T @ found.solution.multipliers
    )
    np.testing.assert_allclose(gradient, 0.0, atol=1e-8)


@pytest.mark.parametrize("is_sparse", [False, True])
@pytest.mark.parametrize("P", [None, [[2.0**-60, 0.0], [0.0, 0.0]]])
def test_conditions_at_a_distant_point_with_another_objective_are_not_solved(P, is_sparse):
    """The conditions hold to 2⁻³⁰ at (1 + 2²⁰, 2²⁰), but the objective is larger by 2⁻¹⁰ than at the solution (1, 0).

    The program is: minimize (1 + 2⁻³⁰) x₀ − x₁ with x₀ − x₁ = 1.
    """
    A = sp.csr_array([[1.0, -1.0]]) if is_sparse else np.array([[1.0, -1.0]])
    problem = LCP.from_qp(P, [1.0 + 2.0**-30, -1.0], A=A, b=[1.0], lower=0.0)
    z = [1.0 + 2.0**20, 2.0**20, -1.0]
    assert Certificate.of(problem, z).relative_residual <= 1e-8
    for algorithm in ("auto", "lemke", "newton", "interior_point"):
        found = problem.origin.recover(solve(problem, algorithm, z0=z))
        assert found.is_solved == found.solution.is_optimal()
        if found.is_solved:
            np.testing.assert_allclose(found.objective, 1.0 + 2.0**-30, rtol=1e-6)
    for answer in (z, solve(problem, z0=z)):
        found = problem.origin.recover(answer)
        assert not found.is_solved
        assert "solve(problem.origin.program)" in found.explain()
    assert solve(problem.origin.program).objective == pytest.approx(1.0 + 2.0**-30, rel=1e-6)


@pytest.mark.parametrize("algorithm", ["auto", "psor"])
def test_conditions_without_rows_end_where_the_plain_problem_ends(algorithm):
    """The duality gap of an obstacle problem is not tested: sweeps would need a third more iterations."""
    n = 200
    P = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tocsr()
    c = np.sin(np.arange(n)) - 0.1
    program, plain = LCP.from_qp(P, c, lower=0.0), LCP(P, c)
    found, expected = (solve(one, algorithm) for one in (program, plain))
    assert found.is_solved
    assert found.z.tobytes() == expected.z.tobytes()


@pytest.mark.parametrize(
    ("family", "number"),
    [("large P", 4000000001289), ("graded rows", 4000000001975), ("large P", 4000000002315)],
)
def test_conditions_of_a_program_of_low_rank_are_solved_at_its_value(family, number):
    """P is singular up to rounding, and PIQP ends up to 7e8 away: rows hold to 1e-8, the objective was -29 for -2.6."""
    program, value = convex_programs.planted(family, np.random.default_rng(number), 12)
    problem = LCP.from_qp(program)
    found = problem.origin.recover(solve(problem))
    assert not found.is_solved or abs(found.objective - value) <= 1e-6 * (1.0 + abs(value))


def test_a_point_of_the_conditions_has_the_status_of_the_program():
    """A point 1e-9 from the minimizer is SOLVED below a limit of 1, and keeps the status of a run that ended early."""
    problem = LCP.from_qp(np.eye(2), [-1.0, -1.0], G=[[1.0, 1.0]], h=[1.0])
    assert problem.origin.recover([0.5, 0.5, 0.5]).status is Status.SOLVED
    early = solve(problem, callback=lambda sample, z: True, z0=[0.2, 0.2, 0.5])
    assert problem.origin.recover(early).status is early.status is Status.INTERRUPTED
    assert problem.origin.recover([0.2, 0.2, 0.5]).status is Status.STALLED


def test_values_of_a_program_with_huge_bounds():
    """Methods solve its conditions at its value, or not at all."""
    rng = np.random.default_rng(4000000000664)
    program, value = convex_programs.planted("huge bounds", rng, 12)
    problem = LCP.from_qp(program)
    for algorithm in ("auto", "lemke", "interior_point"):
        found = problem.origin.recover(solve(problem, algorithm))
        assert abs(found.objective / value - 1.0) <= 1e-6 or not found.is_solved
    assert abs(solve(program).objective - value) <= 1e-6 * (1.0 + abs(value))


@pytest.mark.parametrize("seed", range(5))
def test_a_contradiction_beside_rows_that_become_bounds_is_proved(seed):
    """The proof uses the rows of the original program."""
    program = program_with_all(seed, contradicts=True)
    proof = solve(program).proof
    assert proof.program is program
    assert proof.verify()


def test_a_direction_of_descent_beside_fixed_variables_is_proved():
    """A row of one variable becomes a bound, and the last variable is fixed: UNBOUNDED with a proof."""
    P = np.diag([0.0, 0.0, 1.0, 0.0])
    program = QuadraticProgram(
        P,
        [-1.0, 0.0, 0.0, 1.0],
        G=[[0.0, -2.0, 0.0, 0.0]],
        h=[1.0],
        A=[[0.0, 1.0, 3.0, 1.0]],
        b=[2.0],
        lower=[-np.inf, -np.inf, -np.inf, 0.1],
        upper=[np.inf, 4.0, np.inf, 0.1],
    )
    proof = solve(program).proof
    assert (proof.status.name.lower(), proof.program, proof.verify()) == (
        "unbounded",
        program,
        True,
    )


# --- Properties of a program's matrices are computed once, and are shared ---

VECTORS = ("c", "h", "b", "lower", "upper")


@pytest.mark.parametrize("name", VECTORS)
@pytest.mark.parametrize("wrong", [[np.nan, 0.0], [0.0], "two"])
def test_other_vectors_are_checked(name, wrong):
    """A vector of another length, of text or with a NaN raises an error."""
    first = QuadraticProgram(np.eye(2), [1, 1], G=np.eye(2), h=[1, 1], A=np.eye(2), b=[1, 1])
    with pytest.raises(InvalidProblem, match=name):
        first.with_vectors(**{name: wrong})


def exactly(row: Any, x: Any) -> Fraction:
    """Return a sum of products without rounding."""
    return dot(exact(row), exact(x))


@pytest.mark.parametrize("kind", [np.asarray, sp.csr_array])
def test_residuals_of_a_program_are_bounds(kind):
    """If terms cancel, the primal residual is the exact one."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        P, G, A = (
            np.ldexp(rng.normal(size=(4, 4)), rng.integers(-20, 21, (4, 4))) for _ in range(3)
        )
        P, (x, equality, lower, upper), inequality = P + P.T, rng.normal(size=(4, 4)), rng.random(4)
        lower, upper, h, b = np.abs(lower), np.abs(upper), G @ x, A @ x
        c = -(P @ x + G.T @ inequality + A.T @ equality - lower + upper)
        program = QuadraticProgram(kind(P), c, kind(G), h, kind(A), b, x - 1.0, x)
        solution = QPSolution(program, x, inequality, equality, lower, upper)
        rows, at = np.vstack([np.column_stack([G, -h]), np.column_stack([A, -b])]), np.append(x, 1)
        exact = max(
            abs(exactly(row, at)) / exactly(np.abs(row), np.abs(at))
            for i, row in enumerate(rows)
            if i >= 4 or exactly(row, at) > 0
        )
        assert abs(Fraction(solution.primal_residual) - exact) <= exact * Fraction(1, 2**40)


def test_from_qp_takes_a_program_alone():
    """LCP.from_qp(program) is LCP.from_qp(P, c, …)."""
    program = QuadraticProgram([[2.0]], [-4.0], G=[[1.0], [2.0]], h=[1.0, 9.0])
    one, other = LCP.from_qp(program), LCP.from_qp([[2.0]], [-4.0], [[1.0], [2.0]], [1.0, 9.0])
    np.testing.assert_array_equal(one.csr.toarray(), other.csr.toarray())
