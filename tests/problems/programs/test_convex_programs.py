"""Convex programs of every family: solved, or proved infeasible or unbounded."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import convex_programs

from lcp_plugin import (
    LCP,
    QPSolver,
    QuadraticProgram,
    Status,
    UnsupportedModel,
    certify,
    complements,
    solve,
    solve_batch,
)
from lcp_plugin.algorithms import InteriorPoint
from lcp_plugin.problems.programs.no_minimum import (
    QPInfeasibility,
    QPUnboundedness,
    accepted_proof,
    known_proof,
    proof_of_no_minimum,
    prove_unbounded,
)

INF = np.inf
INTERIOR = InteriorPoint()


# --- Solvable programs -------------------------------------------------------------------------------------------


# A point that solves their LCP is optimal for the program: rows are repeated, or fix all unknowns.
AGREE = (
    "plain",
    "redundant",
    "fixed by equations",
    "degenerate",
    "degenerate, integer",
    "low rank",
)


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", convex_programs.SOLVABLE)
def test_every_kind_of_convex_program_is_solved(kind):
    """As a program and as an LCP, two of each family reach the known value and the conditions."""
    for seed in (77, 78):
        case, value = convex_programs.case(kind, seed, 0, 25)
        wrong, left = convex_programs.judged(kind, case, value)
        assert wrong == []
        assert not [text for text in left if text.startswith("QP") or kind in AGREE]


def test_ranges_say_what_they_say():
    """Rows with limits on both sides, one side, none, and equal ones; multipliers come back in that shape."""
    A = np.array(
        [[1.0, 1.0, 0.0], [1.0, -1.0, 1.0], [0.0, 1.0, 2.0], [1.0, 0.0, 3.0], [2.0, 1.0, 1.0]]
    )
    low, high = [-1.0, 0.5, -9.999999999999998e19, -INF, 1.0], [1.0, 0.5, 2.0, 1e30, INF]
    P, c = np.diag([1.0, 0.0, 2.0]), np.array([-3.0, -1.0, 1.0])
    program = QuadraticProgram.from_ranges(P, c, A, low, high, lower=[-1e20, -5.0, -5.0], upper=5.0)
    assert (program.h.size, program.b.size) == (4, 1)
    assert program.lower[0] == -INF
    solution = solve(program, INTERIOR, tolerance=1e-9).solution
    assert solution.is_optimal(1e-9)
    y = solution.row_multipliers
    assert y.shape == (5,)
    np.testing.assert_allclose(
        P @ solution.x + c + A.T @ y - solution.lower + solution.upper, 0.0, atol=1e-9
    )
    x = cp.Variable(3)
    rows = [
        A[0] @ x <= 1,
        A[0] @ x >= -1,
        A[1] @ x == 0.5,
        A[2] @ x <= 2,
        A[4] @ x >= 1,
        x <= 5,
        x[1:] >= -5,
    ]
    problem = cp.Problem(cp.Minimize(0.5 * cp.quad_form(x, P, assume_PSD=True) + c @ x), rows)
    assert solution.objective == pytest.approx(problem.solve(solver=cp.HIGHS), abs=1e-6)
    value = A @ solution.x
    assert (y[value < np.array(high) - 1e-6] <= 1e-9).all()


def chain(n: int, rng: np.random.Generator) -> tuple[QuadraticProgram, float]:
    """Convexity on n points: second differences, whose multipliers are as large as n² times the forces."""
    slope = sp.csr_array(
        sp.diags_array([-np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n))
    )
    curvature = sp.csr_array(slope[:-1, :-1] @ slope)
    kinks = (rng.random(n - 2) < 0.02) * rng.random(n - 2)
    x = np.concatenate([[0.0, 0.0], np.cumsum(np.cumsum(kinks))]) / n
    y = n**1.5 * np.sin(np.linspace(0.0, 3.0, n - 2)) ** 2 * (curvature @ x == 0.0)
    held = curvature @ x
    c = curvature.T @ y - x
    return QuadraticProgram(sp.eye_array(n), c, -curvature, -np.where(y > 0.0, held, 0.0)), float(
        0.5 * x @ x + c @ x
    )


HARD = (
    "a chain of differences",
    "redundant",
    "free columns",
    "unstable control",
    "graded rows, columns",
)


@pytest.mark.quick(1)
@pytest.mark.parametrize("largest", [60, 400])
@pytest.mark.parametrize("kind", HARD)
def test_what_interior_points_find_hard_is_solved(kind, largest):
    """Hard programs reach the known value with row-wise KKT residuals of 1e-6."""
    for seed in range(4):
        made = chain(6 * largest, np.random.default_rng(seed)) if kind == HARD[0] else None
        program, value = made or convex_programs.case(kind, seed, 11, largest)
        result = solve(program)
        solution = result.solution
        assert result.is_solved, (seed, result, str(solution))
        assert solution.objective == pytest.approx(value, rel=1e-6, abs=1e-6)


def test_auto_solves_a_long_chain_of_differences_in_units_of_limits_and_costs():
    """A program that no external solver solves in fitted or given units is solved in a further attempt."""
    program, value = chain(2400, np.random.default_rng(3))
    result = solve(program)
    assert result.is_solved
    assert result.objective == pytest.approx(value, rel=1e-6)


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("family", "seed", "case"),
    [
        ("tiny P", 7001, 42),
        ("tiny P", 7001, 39),  # LDLᵀ, regularised, loses P behind many small pivots
        ("huge bounds", 7001, 43),  # minimisers reach to 1e9
        ("everything", 5, 2),
    ],
)
def test_solve_of_a_badly_scaled_program_has_the_planted_value_or_is_not_solved(family, seed, case):
    """A program with data of 1e-9 to 1e9 has no false proof, and SOLVED means its known value."""
    program, value = convex_programs.case(
        family, seed, case, 400 if family == "everything" else 2000
    )
    result = solve(program)
    assert not result.has_no_solution
    assert not result.is_solved or result.objective == pytest.approx(value, rel=1e-6, abs=1e-6)


@pytest.mark.quick(1)
@pytest.mark.parametrize(("seed", "largest", "case"), [(5, 300, 15), (1, 1000, 12), (1, 1000, 42)])
def test_solve_of_equations_that_contradict_by_rounding_returns_the_best_point(seed, largest, case):
    """If equalities are inconsistent by about the tolerance, the value is right, SOLVED or PRECISION_LIMIT."""
    program, value = convex_programs.case("redundant, rounded", seed, case, largest)
    result = solve(program)
    if not result.is_solved:
        assert result.status is Status.PRECISION_LIMIT
        assert "inconsistent, by a difference at rounding level" in result.advice
    assert result.objective == pytest.approx(value, rel=1e-6, abs=1e-6)


# --- Proofs of infeasibility and unboundedness
# ----------------------------------------------------------------------


@pytest.mark.quick(2)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", convex_programs.SOLVABLE)
def test_nothing_is_proven_of_a_solvable_program(kind, seed):
    """Programs with a known minimum have no accepted proof; rounded data may have one."""
    case, _ = convex_programs.case(kind, seed, 6, 10)
    assert accepted_proof(case, 1e-6) is None
    assert convex_programs.FAMILIES[kind].digits < 16 or proof_of_no_minimum(case) is None


@pytest.mark.parametrize(
    ("program", "word"),
    [
        (
            QuadraticProgram(np.eye(2), [1.0, 1.0], [[1.0, 1.0], [-1.0, -1.0]], [-1.0, -1.0]),
            "infeasible",
        ),
        (QuadraticProgram(None, [1.0, 1.0], [[1.0, 1.0], [1.0, -1.0]], [-1.0, -1.0]), "unbounded"),
    ],
)
def test_a_run_that_a_proof_ends_says_so(program, word, capsys):
    """An infeasible program has no multipliers, and verbose=True ends with the proof."""
    watched, quiet = solve(program, verbose=True), solve(program)
    end = capsys.readouterr().out.splitlines()[-1]
    assert end.startswith(f"{word.upper()}: ")
    assert f": {word}" in end
    assert "Ctrl-C" not in end
    for result in (watched, quiet):
        assert result.status.name.lower() == word
        assert all(np.isnan(part).all() for part in result.duals.values())
        assert str(result.solution) == "no solution: a proof came instead"


def test_a_rounded_bound_proves_nothing():
    """3 x ≥ 1 and x = a double below 1/3 contradict, if by rounding only: no proof or an exact one; above it, none."""
    for right in (np.nextafter(1.0 / 3.0, 0.0), 1.0 / 3.0, np.nextafter(1.0 / 3.0, 1.0)):
        program = QuadraticProgram([[0.0]], [1.0], [[-3.0]], [-1.0], A=[[1.0]], b=[right])
        proof = proof_of_no_minimum(program)
        assert proof is None or (Fraction(right) * 3 < 1 and proof.verify())


def test_a_linear_program_under_a_limit_of_seconds_is_refuted():
    """Σ x = 1 and x₀ = 2 are infeasible; there are too many unknowns for an active set."""
    rows = sp.csr_array(np.vstack([np.ones(240), np.eye(1, 240)]))
    program = QuadraticProgram(None, np.arange(1.0, 241.0), A=rows, b=[1.0, 2.0], lower=0.0)
    result = solve(program, max_seconds=60.0)
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()


NONCONVEX = {
    "concave": (-np.eye(2), "smallest eigenvalue of P is -1"),
    "a saddle": ([[1.0, 2.0], [2.0, 1.0]], "smallest eigenvalue of P is -1"),
    "a zero beside": ([[0.0, 1.0], [1.0, 5.0]], "smallest eigenvalue of P is -0.193"),
    "small and clear": ([[1e-8, 2e-8], [2e-8, 1e-8]], "smallest eigenvalue of P is -1e-08"),
    "large": (
        sp.block_diag([sp.eye_array(6000), sp.csr_array([[1.0, 2.0], [2.0, 1.0]])], format="csr"),
        "P has a negative eigenvalue",
    ),
    "large, one entry": (
        sp.diags_array(np.append(np.ones(6000), -1.0)),
        "P has a negative eigenvalue",
    ),
}


@pytest.mark.parametrize(
    ("P", "c", "value"),
    [(np.array([[1, 1 + 1e-8, 0], [1 + 1e-8, 1, 0], [0, 0, 4]]), [1, 1, 0], -0.5)],
)
def test_p_that_is_semidefinite_but_for_rounding_is_solved(P, c, value):
    """An eigenvalue of −1e-8 relative to its rows is rounding error, and the advice mentions it."""
    n = len(c)
    result = solve(QuadraticProgram(P, c, lower=-np.ones(n), upper=np.ones(n)))
    assert result.is_solved
    assert abs(result.objective - value) <= 1e-6
    assert "negative eigenvalue" in result.advice
    assert certify(result).verdict != "disproved"


@pytest.mark.parametrize("name", NONCONVEX)
def test_a_program_that_is_clearly_not_convex_is_refused(name):
    """A negative eigenvalue beyond rounding is rejected with a value and advice."""
    P, words = NONCONVEX[name]
    with pytest.raises(
        UnsupportedModel,
        match=f"not convex: (the )?{words}.*a stationary point need not be a minimum; solve Equi",
    ):
        LCP.from_qp(P, np.full(P.shape[0] if sp.issparse(P) else 2, 0.1), lower=-1.0, upper=1.0)


def test_an_unbounded_direction_needs_a_feasible_point():
    """A direction of descent with inconsistent constraints is infeasible, never unbounded."""
    program = QuadraticProgram(
        np.zeros((2, 2)), [-1.0, 0.0], [[0.0, 1.0], [0.0, -1.0]], [0.0, -1.0]
    )
    assert prove_unbounded(program) is None
    assert isinstance(proof_of_no_minimum(program), QPInfeasibility)


@pytest.mark.parametrize(
    ("program", "along"),
    [
        (QuadraticProgram(None, [-1e8, -1.0], lower=0.0, upper=[1.0, np.inf]), (0, 1)),
        (QuadraticProgram(None, [1.0, 1e-10], A=[[1.0, 0.0]], b=[1.0]), (0, -1)),
        (
            QuadraticProgram(
                None,
                [-1.0, 0.0, -1e8],
                [[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]],
                [0.0, 0.0],
                upper=[np.inf, np.inf, 1.0],
            ),
            (1, 1, 0),
        ),
    ],
    ids=["beside a large cost", "a small cost", "rows that cancel"],
)
def test_an_exact_descent_counts_beside_its_own_costs(program, along):
    """A recession direction with a small cost, relative to others, proves unboundedness."""
    point = np.zeros(program.n) if not program.b.size else np.array([1.0, 0.0])
    proof = QPUnboundedness(program, tuple(map(Fraction, point)), tuple(map(Fraction, along)))
    assert proof.is_exact
    assert (proof.margin, proof.excludes(1e-6)) == (1.0, True)
    assert certify(program, point).verdict == "disproved"
    assert certify(program, claim="unbounded").verdict == "proved"


def test_negative_curvature_excludes_every_minimum():
    """−x²/2 falls without a cost: no change of costs ends the descent."""
    proof = QPUnboundedness(QuadraticProgram([[-1.0]], [0.0]), (Fraction(0),), (Fraction(1),))
    assert proof.verify()
    assert (proof.margin, proof.excludes(1e-6)) == (INF, True)


def test_a_proof_says_by_how_much_its_point_misses_constraints():
    """If constraints are inconsistent by rounding, the proof reports the violation."""
    found = solve(
        QuadraticProgram(None, [-1.0, -1.0, -1.0], [[-4, -1, 2], [4, 1, -2]], [2e6, -2000000.001])
    )
    assert found.status is Status.UNBOUNDED
    assert found.proof is not None
    assert 0.0 < found.proof.violation <= 1e-9
    assert "feasible point" not in found.explain()
    assert f"misses constraints by {found.proof.violation:.1e}" in found.explain()


def test_a_splitting_method_is_refused_where_it_cannot_run():
    """A named method that needs a positive diagonal rejects a linear program."""
    x = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(cp.sum(x)), [x >= 0, x[0] + x[1] + x[2] >= 1])
    with pytest.raises(UnsupportedModel, match=r'psor needs a positive diagonal.*algorithm="auto"'):
        problem.solve(solver=QPSolver, algorithm="psor")


# --- Infeasible, and by how much ---------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1.0, 1e3, 1e6])
def test_infeasible_by_a_millionth_is_proved(size):
    """x₁ − x₂ = s and = s (1 + 2e-6) contradict by 1e-6 of their scale: proved at default tolerance."""
    x = cp.Variable(2)
    constraints = [x[0] - x[1] == size, x[0] - x[1] == size * (1 + 2e-6)]
    program = cp.Problem(cp.Minimize(cp.sum_squares(x)), constraints)
    program.solve(solver=QPSolver)
    assert program.status == cp.INFEASIBLE
    proof = program.solver_stats.extra_stats.proof
    assert proof.verify()
    assert proof.margin == pytest.approx(1e-6, rel=5e-2)


@pytest.mark.quick(5)
@pytest.mark.parametrize("seed", range(40))
def test_no_saddle_is_called_a_minimum_in_whatever_units(seed):
    """A block [[1, 2], [2, 1]] next to entries up to 1e12 larger, scaled, is never a minimum."""
    random = np.random.default_rng(seed)
    units, A = 10.0 ** random.integers(-6, 7, 4), random.standard_normal((4, 4))
    P = A.T @ A
    P[2:, 2:] = [[1.0, 2.0], [2.0, 1.0]]
    P[:2, 2:] *= 10.0 ** random.integers(-9, 1)
    P[2:, :2] = P[:2, 2:].T
    P[0, 0] *= 10.0 ** random.integers(0, 13)
    c = random.standard_normal(4) * (random.random(4) < 0.6)
    c[0] *= 1e6 if seed % 3 == 0 else 1.0
    program = QuadraticProgram(
        P * np.outer(units, units), c * units, lower=-1.0 / units, upper=1.0 / units
    )
    try:
        result = solve(program)
    except UnsupportedModel:
        return
    if result.is_solved:
        x = np.repeat((result.x * units)[None], 81, axis=0)
        x[:, 2:] = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 9)] * 2), axis=-1).reshape(-1, 2)
        values = 0.5 * np.einsum("ki,ij,kj->k", x, P, x) + x @ c
        own = result.x * units
        terms = 0.5 * np.abs(own) @ np.abs(P) @ np.abs(own) + np.abs(c) @ np.abs(own)
        assert values.min() >= 0.5 * own @ P @ own + c @ own - 1e-5 * terms


def test_bounds_that_cross_by_rounding_contradict_nothing():
    """A bound x ≤ 1 and a row x ≥ 1 + 2e-16 are met at x = 1; the proof that they are not does not count."""
    problem = LCP.from_qp([[0.0]], [1.0], G=[[-1.0]], h=[-np.nextafter(1.0, 2.0)], upper=1.0)
    solution = problem.origin.recover(solve(problem)).solution
    assert solution.is_optimal()
    proof = known_proof(problem.origin.program)
    assert proof is not None
    assert proof.verify()
    assert 0.0 < proof.margin < 1e-15
    assert accepted_proof(problem.origin.program) is None
    apart = LCP.from_qp([[0.0]], [1.0], G=[[-1.0]], h=[-1.00001], upper=1.0)
    assert solve(apart.origin.program).status is Status.INFEASIBLE


@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize("rank", [8, 3, 0])
def test_conditions_written_by_hand_are_solved(rank, turned):
    """Stationarity, feasibility and pairs of a QP have its value, whichever way its equations are turned."""
    rng = np.random.default_rng(rank)
    F = rng.normal(size=(8, rank))
    G = rng.normal(size=(5, 8))
    A = rng.normal(size=(3, 8))
    x0 = rng.normal(size=8)
    P, h, b = F @ F.T, G @ x0 + rng.random(5), A @ x0
    c = -(P @ x0 + G.T @ rng.random(5) + A.T @ rng.normal(size=3))
    x, inequality, equality = cp.Variable(8), cp.Variable(5), cp.Variable(3)
    constraints = [
        complements(inequality >= 0, h - G @ x >= 0),
        turned * (A @ x - b) == 0,
        turned * (P @ x + c + G.T @ inequality + A.T @ equality) == 0,
    ]
    problem = cp.Problem(cp.Minimize(0), constraints)
    problem.solve(method="LCP", algorithm=INTERIOR, tolerance=1e-10)
    assert problem.status == "optimal"
    answer = solve(QuadraticProgram(P, c, G, h, A, b), INTERIOR).solution
    assert 0.5 * x.value @ P @ x.value + c @ x.value == pytest.approx(
        answer.objective, rel=1e-8, abs=1e-8
    )


# --- One program, many callers -----------------------------------------------------------------------------------


def test_threads_that_share_the_matrices_of_a_program_get_its_solutions():
    """Right-hand sides 9 and ∞ in turn change which rows remain, in four threads at once; x = min(1, h)."""
    base = QuadraticProgram(np.eye(3), -np.ones(3), np.vstack([np.eye(3), np.ones(3)]), np.ones(4))
    limits = [[np.inf, 0.5, 9.0, np.inf], [0.25, np.inf, 9.0, 9.0], [9.0, 9.0, np.inf, np.inf]]

    def solved(k):
        h = np.array(limits[k % 3])
        return np.abs(solve(base.with_vectors(h=h)).x - np.minimum(1.0, h[:3])).max()

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            assert max(pool.map(solved, range(120))) <= 1e-8
    finally:
        sys.setswitchinterval(before)


def test_a_stiff_difference_of_two_unknowns_takes_no_arbitrary_starts_of_lemke(monkeypatch):
    """P = 2⁵⁰ ((1, −1), (−1, 1)) up to 10⁶: the gradient of one double next to another is 1e5, larger than c."""
    P = 2.0**50 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    program = QuadraticProgram(P, [-1.0, 0.5], lower=0.0, upper=1e6)
    arbitrary = "lcp_plugin.methods.lemke.pivoting_path._random_cell"
    monkeypatch.setattr(arbitrary, lambda *_: pytest.fail("hundreds of paths"))
    result = solve(program)
    assert not result.is_solved or result.objective == pytest.approx(-5e5)


def test_negative_curvature_at_rounding_level_counts_as_none():
    """P = diag(−1e-15, 10): a free x₁ has a minimum if its cost has one, and is free without a cost."""
    P = np.diag([-1e-15, 10.0])
    found = solve(QuadraticProgram(P, [1.0, 1.0], [[-1.0, 0.0]], [-1.0])).require_solved()
    np.testing.assert_allclose(found.x, [1.0, -0.1], atol=1e-9)
    flat = solve(QuadraticProgram(P, [0.0, 1.0], [[-1.0, 0.0]], [-1.0]))
    np.testing.assert_allclose(flat.require_solved().x[1], -0.1, atol=1e-9)
    x = cp.Variable(2)
    objective = 0.5 * cp.quad_form(x, cp.psd_wrap(P)) + cp.sum(x)
    problem = cp.Problem(cp.Minimize(objective), [x[0] >= 1.0])
    assert problem.solve(solver=QPSolver()) == pytest.approx(0.95)
    for refused in (np.diag([-1e-10, 10.0]), np.array([[-1e-15, 1e-3], [1e-3, 10.0]])):
        with pytest.raises(UnsupportedModel, match="not convex"):
            solve(QuadraticProgram(refused, [1.0, 1.0], lower=0.0))


def minimum_by_clarabel(program: QuadraticProgram, P: Any) -> float:
    """Return the minimum with another P, as Clarabel computes it."""
    x = cp.Variable(program.n)
    bounded = np.isfinite(program.lower)
    objective = 0.5 * cp.quad_form(x, cp.psd_wrap(P)) + program.c @ x
    rows = [x[bounded] >= program.lower[bounded], program.A @ x == program.b]
    return float(cp.Problem(cp.Minimize(objective), rows).solve(solver="CLARABEL"))


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_a_matrix_in_single_precision_is_solved_and_certified(kind):
    """With Laplacians, Gram matrices and covariances in float32, x is feasible and as good as Clarabel's for P + δD."""
    for seed in range(kind, 12, 3):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(5, 40))
        given = {"lower": 1.0 if kind == 0 else 0.0}
        c = np.zeros(n)
        if kind == 0:
            W = np.triu(rng.random((n, n)), 1)
            P = np.diag((W + W.T).sum(axis=1)) - W - W.T
        elif kind == 1:
            G = rng.normal(size=(n, n // 2 + 1)).astype(np.float32)
            P = G @ G.T
            c = np.asarray(P, float) @ rng.normal(size=n)
        else:
            P, c = np.cov(rng.normal(size=(n // 2 + 2, n)).T), 0.01 * rng.normal(size=n)
            given |= {"A": np.ones((1, n)), "b": [1.0]}
        P = P.astype(np.float32).astype(np.float64)
        program = QuadraticProgram((P + P.T) / 2.0, c, **given)
        result = solve(program).require_solved()
        x, d = result.x, program.P.diagonal()
        least = np.linalg.eigvalsh(program.P / np.sqrt(np.outer(d, d)))[0]
        limit = minimum_by_clarabel(
            program, program.P + (16.0 * max(-least, 0.0) + 1e-14) * np.diag(d)
        )
        terms = float(np.abs(x) @ np.abs(program.P) @ np.abs(x) + np.abs(c) @ x)
        assert program.objective(x) <= limit + 1e-6 * terms + 1e-12
        assert (x >= program.lower).all()
        np.testing.assert_allclose(program.A @ x, program.b, rtol=1e-9)
        answer = certify(program, result)
        assert answer.verdict == "proved"
        is_rounded = program.is_convex is False
        assert ("within rounding" in answer.reason) == is_rounded


def test_a_matrix_that_is_indefinite_by_rounding_has_no_far_minimum():
    """The Laplacian of a triangle, of which one entry is 3e-12 too small: the least x, (1, 1, 1), has the value 0."""
    P = 3.0 * np.eye(3) - np.ones((3, 3))
    P[0, 0] -= 3e-12
    for program in (
        QuadraticProgram(P, np.zeros(3), lower=1.0),
        QuadraticProgram(sp.csr_array(P), np.zeros(3), G=-np.eye(3), h=-np.ones(3)),
        QuadraticProgram(P, np.zeros(3), G=[[-1.0, -1.0, -1.0]], h=[-3.0], lower=0.5),
    ):
        result = solve(program).require_solved()
        np.testing.assert_allclose(result.x, 1.0, rtol=1e-9)
        assert len(result.stages) == 1, "the first external solver has the point"
        (point,) = solve_batch([program]).x
        np.testing.assert_allclose(point, 1.0, rtol=1e-6)
        assert (
            program.objective(LCP.from_qp(program).origin.recover(solve(LCP.from_qp(program))).x)
            < 1e-9
        )


def test_x_and_z_of_a_result_are_one_point():
    """The z of a result is its x with the multipliers of the rows, from any solver."""
    far = 2.0**30 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    for program in (
        QuadraticProgram(far, [-1.0, 0.5], [[1.0, 1.0]], [3.0], lower=0.0),
        QuadraticProgram(np.diag([-1e-15, 10.0]), [0.0, 1.0], [[-1.0, -1.0]], [-1.0]),
    ):
        result = solve(program)
        assert np.array_equal(result.z, np.append(result.x, result.solution.inequality))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("curvature", [-1e-10, -1.0])
def test_negative_curvature_of_a_fixed_unknown_is_no_obstacle(curvature, sign):
    """xᵀ diag(curvature, 10) x at x = (1, 2), and over x₁ = 1, x₂ ≥ 2; not convex with x₁ free."""
    x, P = cp.Variable(2), np.diag([curvature, 10.0])
    form = sign * cp.quad_form(x, cp.psd_wrap(P))
    goal = cp.Minimize(form) if sign > 0.0 else cp.Maximize(form)
    for constraints in ([x == [1, 2]], [x[0] == 1, x[1] >= 2]):
        problem = cp.Problem(goal, constraints)
        problem.solve(solver=QPSolver)
        assert problem.status == cp.OPTIMAL
        assert problem.value == pytest.approx(sign * (curvature + 40.0))
    with pytest.raises(UnsupportedModel, match="not convex"):
        solve(QuadraticProgram(2.0 * P, [0.0, 0.0], lower=[0.0, 2.0]))


def test_the_refusal_of_a_rounded_correlation_matrix_names_the_nearest_semidefinite_one():
    """The line of the message makes the program of 20 assets from 8 returns, rounded to 6 digits, convex."""
    returns = np.random.default_rng(0).normal(size=(8, 20))
    P = np.round(np.corrcoef(returns.T), 6)
    rows = {"A": np.ones((1, 20)), "b": [1.0], "lower": 0.0}
    with pytest.raises(
        UnsupportedModel, match=r"eigenvalue of P is -.*P = V \* w\.clip\(0\) @ V\.T"
    ):
        solve(QuadraticProgram(P, np.zeros(20), **rows))
    w, V = np.linalg.eigh(P)
    assert solve(QuadraticProgram(V * w.clip(0) @ V.T, np.zeros(20), **rows)).is_solved


def test_an_unstable_plant_by_single_shooting_is_not_worse_than_its_engines():
    """The terms of the objective are 1e11 times the optimum, .680: rounding decides what an engine returns."""
    N, begin = 60, np.array([0.05, 0.0])
    A, B = np.array([[1.3, 0.1], [0.0, 1.05]]), np.array([0.005, 0.1])
    powers = [np.linalg.matrix_power(A, k) for k in range(N + 1)]
    H = np.vstack(powers[1:])
    shots = [[powers[k - j] @ B if j <= k else 0.0 * B for j in range(N)] for k in range(N)]
    S = np.vstack([np.column_stack(row) for row in shots])
    P = S.T @ S + 0.1 * np.eye(N)
    program = QuadraticProgram(0.5 * (P + P.T), S.T @ (H @ begin), lower=-1.0, upper=1.0)

    def cost(u):
        x, total = begin, 0.0
        for v in u:
            x = A @ x + B * v
            total += float(x @ x + 0.1 * v * v)
        return total

    assert cost(solve(program).require_solved().x) <= 1.3


def drawn_program(seed, is_linear):
    """Return a program with a recession direction, its unknowns in units from 1e-4 to 1e4."""
    rng = np.random.default_rng(seed)
    n, m, p = (int(rng.integers(*ends)) for ends in ((2, 14), (1, 12), (0, 4)))
    rank = int(rng.integers(0, n))
    F = np.round(rng.normal(size=(n, max(1, rank))), 2) if rank else np.zeros((n, 1))
    G = np.round(rng.normal(size=(m, n)), 2)
    A = np.round(rng.normal(size=(p, n)), 2)
    x = np.round(rng.normal(size=n), 1)
    b, h = A @ x, G @ x + np.round(rng.random(m), 1)
    c = np.round(rng.normal(size=n), 2)
    units = 10.0 ** rng.integers(-4, 5, n)
    lower = np.where(rng.random(n) < 0.4, (x - 1.0) / units, -np.inf)
    P = None if is_linear else F @ F.T * units * units[:, None]
    return QuadraticProgram(P, c * units, G * units, h, A * units, b, lower)


@pytest.mark.parametrize(("seed", "is_linear"), [(88, True), (137, False)])
def test_an_unbounded_program_in_mixed_units_is_proved(seed, is_linear):
    """The feasible point is found in fitted units (88); the direction changes no row beyond rounding (137)."""
    result = solve(drawn_program(seed, is_linear))
    assert result.status is Status.UNBOUNDED
    assert result.proof.verify()


def test_a_sum_of_rows_that_is_rounded_proves_a_large_program_infeasible():
    """Row 119 is minus a sum of rows, and asks for more: the sum of the multipliers is 0 only to rounding."""
    rng = np.random.default_rng(8)
    n, m = int(rng.integers(60, 140)), int(rng.integers(100, 160))
    G, w, count = np.round(rng.normal(size=(m, n)), 3), np.zeros(m), int(rng.integers(3, m))
    w[rng.choice(m, count, False)] = rng.random(count)
    h = G @ rng.normal(size=n) + rng.random(m) * (rng.random(m) < 0.5)
    least = -(w @ h) - 10.0 ** rng.integers(-4, 1)
    result = solve(
        QuadraticProgram(None, np.ones(n), np.vstack([G, -(w @ G)]), np.append(h, least))
    )
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()
