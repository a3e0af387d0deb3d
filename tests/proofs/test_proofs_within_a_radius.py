"""Rows that are dependent except for rounding: claims that hold only within a radius."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from lcp_plugin import LCP, QPSolver, QuadraticProgram, Status, certify, march, solve, solve_batch
from lcp_plugin.problems.programs.no_minimum import (
    QPInfeasibility,
    QPUnboundedness,
    accepted_proof,
    known_proof,
)
from lcp_plugin.problems.programs.solution import QPSolution
from lcp_plugin.proofs.farkas import WIDE

DECIMAL = np.array([[0.1, 0.2, 0.3], [0.7, 0.1, 0.2], [0.8, 0.3, 0.5]])  # .1 + .7 ≠ .8
CONTRADICTORY, MET = [1.0, 2.0, 3.1], [0.6, 1.0, 1.6]


def decimals(rng: np.random.Generator, *shape: int) -> Any:
    """Numbers of one decimal in [−1, 1]."""
    return np.round(rng.uniform(-1.0, 1.0, shape), 1)


def redundant_program(kind: str, seed: int) -> QuadraticProgram:
    """Return decimal equalities, the last a combination: feasible, infeasible or unbounded.

    The objective of every other program is curved. Every third program has inactive bounds.
    """
    rng = np.random.default_rng([seed, 31])
    n = int(rng.integers(3, 10))
    m = int(rng.integers(2, n + 1))
    A = decimals(rng, m - 1, n)
    factors = rng.integers(1, 4, m - 1) / 10 if rng.random() < 0.5 else np.ones(m - 1)
    A = np.vstack([A, factors @ A])
    b = A @ decimals(rng, n)
    is_curved = seed % 2 == 0
    P, c = np.zeros((n, n)), decimals(rng, n)
    if kind == "unbounded":
        P = 2.0 * np.outer(A[0], A[0]) if is_curved else P
    elif kind == "infeasible":
        P = np.eye(n) if is_curved else P
        b[-1] += 0.1 * rng.integers(1, 10)
    else:
        P, c = (np.eye(n), c) if is_curved else (P, A.T @ decimals(rng, m))
    lower = np.where((np.arange(n) == 0) & (seed % 3 == 0) & (kind != "unbounded"), -20.0, -np.inf)
    return QuadraticProgram(P, c, A=A, b=b, lower=lower)


@pytest.mark.parametrize(
    ("is_linear", "b", "status"),
    [
        (False, CONTRADICTORY, cp.INFEASIBLE),
        (True, CONTRADICTORY, cp.INFEASIBLE),
        (True, MET, cp.OPTIMAL_INACCURATE),
        (False, MET, cp.OPTIMAL),
    ],
)
def test_redundant_decimal_rows_in_cvxpy(is_linear, b, status):
    """Rows that are redundant up to rounding are infeasible, or a descent leaves them beyond a radius."""
    x = cp.Variable(3)
    problem = cp.Problem(
        cp.Minimize(cp.sum(x) if is_linear else cp.sum_squares(x)), [DECIMAL @ x == b]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # cvxpy warns of an inaccurate optimum
        problem.solve(solver=QPSolver)
    assert problem.status == status
    result = problem.solver_stats.extra_stats
    if status != cp.OPTIMAL:
        assert WIDE <= (result.proof or result.doubtful).radius < np.inf
        assert "up to" in result.explain()


def test_the_advice_names_the_radius():
    """INFEASIBLE within a radius, and a descent that ends beyond it, report its first digit rounded down."""
    result = solve(QuadraticProgram(None, np.zeros(3), A=DECIMAL, b=CONTRADICTORY))
    assert result.has_no_solution
    digits = f"{result.proof.radius:.15e}"
    assert (
        f"; of all x up to {digits[0]}e{digits[-3:]}: a larger one is not excluded" in result.advice
    )
    assert "exactly" not in str(result.proof)
    descent = solve(QuadraticProgram(None, np.ones(3), A=DECIMAL, b=MET))
    assert descent.status is Status.PRECISION_LIMIT
    digits = f"{descent.doubtful.radius:.15e}"
    assert f"for all x and multipliers up to {digits[0]}e{digits[-3:]}, beyond" in descent.advice
    assert descent.solution.primal_residual <= 1e-9
    plain = solve(QuadraticProgram(None, [1.0], A=[[1.0], [1.0]], b=[1.0, 2.0]))
    assert plain.proof.radius == np.inf
    assert "up to" not in plain.advice


@pytest.mark.full
@pytest.mark.parametrize("kind", ["infeasible", "unbounded"])
def test_redundant_decimal_programs_are_proved_infeasible(kind):
    """All of 200 random programs get a proof that verifies, for all x or within a wide radius."""
    within = 0
    for seed in range(200):
        program = redundant_program(kind, seed)
        proof = known_proof(program)
        assert proof is not None, seed
        assert proof.status.name.lower() == kind, seed
        assert proof.verify(), seed
        within += proof.radius < np.inf
    assert within >= 50  # in the others the sums happen to be exact


@pytest.mark.full
def test_redundant_decimal_programs_that_are_met_are_never_infeasible():
    """All 200 consistent programs with the same rows have no accepted proof of infeasibility."""
    proofs = [accepted_proof(redundant_program("optimal", seed)) for seed in range(200)]
    assert [
        seed
        for seed, proof in enumerate(proofs)
        if proof is not None and proof.status.name.lower() == "infeasible"
    ] == []
    assert all(proof.is_exact for proof in proofs if proof is not None)


@pytest.mark.parametrize("seed", range(6))
def test_no_x_within_the_radius_is_below_the_margin(seed):
    """Every x up to the radius violates some row by the margin, exactly; distant x may not."""
    rng = np.random.default_rng(seed)
    program = QuadraticProgram(np.eye(3), np.zeros(3), A=DECIMAL, b=CONTRADICTORY)
    proof = accepted_proof(program)
    assert isinstance(proof, QPInfeasibility)
    unit = program.constraints.own_sizes

    def residual(x):
        sums = [
            sum(Fraction(a) * Fraction(v) for a, v in zip(row, x, strict=True))
            for row in DECIMAL.tolist()
        ]
        return max(
            abs(s - Fraction(b)) / Fraction(u)
            for s, b, u in zip(sums, CONTRADICTORY, unit.tolist(), strict=False)
        )

    for size in (1.0, 1e8, 1e12, proof.radius):
        x = rng.uniform(-size, size, 3)
        assert residual(x) >= Fraction(proof.margin)
    flat = np.linalg.svd(DECIMAL)[2][-1]
    start = np.linalg.lstsq(DECIMAL, np.array(CONTRADICTORY), rcond=1e-10)[0]
    for length in (1e9, -1e12, 0.9 * proof.radius):
        assert residual(start + length * flat) >= Fraction(proof.margin)
    assert (
        QPSolution(program, start, [], np.zeros(3), np.zeros(3), np.zeros(3)).primal_residual
        >= proof.margin
    )


def test_a_tampered_proof_within_a_radius_does_not_verify():
    """Other signs, a direction upwards, or rounding replaced by data: no proof."""
    infeasible = accepted_proof(
        QuadraticProgram(np.eye(3), np.zeros(3), A=DECIMAL, b=CONTRADICTORY)
    )
    unbounded = known_proof(QuadraticProgram(np.zeros((3, 3)), np.ones(3), A=DECIMAL, b=MET))
    assert isinstance(infeasible, QPInfeasibility)
    assert isinstance(unbounded, QPUnboundedness)
    first, *rest = infeasible.multipliers
    assert not replace(infeasible, multipliers=tuple(-y for y in infeasible.multipliers)).verify()
    assert not replace(infeasible, multipliers=(first * Fraction(1 + 1e-9), *rest)).verify()
    assert not replace(unbounded, direction=tuple(-d for d in unbounded.direction)).verify()
    moved = tuple(x + Fraction(1, 1000) for x in unbounded.point)
    assert not replace(unbounded, point=moved).verify()


@pytest.mark.parametrize("small", [1e-6, 1e-9, 1e-12, 1e-15])
def test_a_small_coefficient_is_data_and_no_rounding(small):
    """Equations x₁ = 0, x₁ + small x₂ = 1 with the solution x₂ = 1/small is never infeasible."""
    A, b = np.array([[1.0, 0.0], [1.0, small]]), np.array([0.0, 1.0])
    for P in (np.zeros((2, 2)), np.eye(2)):
        assert known_proof(QuadraticProgram(P, [0.0, 0.0], A=A, b=b)) is None
    result = solve(LCP(A, -b, lower=-np.inf))
    assert not result.has_no_solution
    assert result.infeasibility is None


@pytest.mark.full
def test_certify_proves_nothing_within_a_radius():
    """A proof within a radius is not sufficient for `certify`, whose claims hold for all x."""
    infeasible = QuadraticProgram(np.eye(3), np.zeros(3), A=DECIMAL, b=CONTRADICTORY)
    unbounded = QuadraticProgram(np.zeros((3, 3)), np.ones(3), A=DECIMAL, b=MET)
    assert math.isfinite(known_proof(infeasible).radius)  # type: ignore[union-attr]
    assert certify(infeasible, claim="infeasible").verdict != "proved"
    assert certify(unbounded, claim="unbounded").verdict != "proved"


def test_values_of_another_solver_far_out_disprove_no_answer():
    """Initial values of 4e16, for which rows do not cancel, do not affect the result."""
    A = np.array([[0.8, 0.4, 0.9, 0.6, -0.7, 0.1, 0.5, 0.9]] * 2)
    x = cp.Variable(8)
    problem = cp.Problem(cp.Minimize(-0.4 * A[0] @ x), [A @ x == A @ np.full(8, 0.4)])
    direction = np.linalg.svd(A[:1])[2][1:].sum(axis=0)
    for size in (1e14, 1e17, 1e20, 1e246):
        x.value = size * direction
        problem.solve(solver=QPSolver)
        assert problem.status == cp.OPTIMAL


def test_multipliers_of_1e21_excuse_no_gradient():
    """Rows scaled by 1e±6, unbounded up to rounding, are not "optimal" with a wrong gradient."""
    scale, x = np.array([1e-6, 1e6, 1e-3]), cp.Variable(3)
    rows = [(scale[:, None] * DECIMAL) @ x == scale * np.array(MET)]
    problem = cp.Problem(cp.Minimize(cp.sum(x)), rows)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # cvxpy's: the answer may be inaccurate
        problem.solve(solver=QPSolver)
    assert problem.status != cp.OPTIMAL


def low_rank(seed: int) -> tuple[Any, Any, float]:
    """Return J with more rows than columns, a load q, and the least qᵀy over y ≥ 0, Jᵀy = 0, Σy ≤ 1 by HiGHS."""
    rng = np.random.default_rng(seed)
    J, q = rng.standard_normal((8, 3)), rng.standard_normal(8)
    found = linprog(q, np.ones((1, 8)), [1.0], J.T, np.zeros(3), method="highs")
    return J, q, float(found.fun)


CLASSES: dict[str, Any] = {
    "LCP": lambda M, q: solve(LCP(M, q)),
    "batch": lambda M, q: solve_batch(M, [q, np.ones(8)])[0],
    "march": lambda M, q: march(LCP(M, q), [q])[0],
    "conditions of a program": lambda M, q: solve(LCP.from_qp(M, q, lower=0.0)),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", CLASSES)
@pytest.mark.parametrize("seed", [1, 2, 5])
def test_a_low_rank_problem_is_infeasible_within_a_radius(name, seed):
    """M = J Jᵀ in floating point is INFEASIBLE in every class if a load excites a zero-energy mode of J."""
    J, q, least = low_rank(seed)
    result = CLASSES[name](J @ J.T, q)
    assert least < -0.1
    assert result.status is Status.INFEASIBLE
    proof = result.proof
    assert proof.verify()
    assert proof.exact == (proof.radius == np.inf)
    assert ("up to" in str(proof)) == (proof.radius < np.inf)
    assert proof.radius >= WIDE
