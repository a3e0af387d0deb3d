"""The interior point reaches rounding level on every monotone problem, whatever its bounds and its rank."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.planted import planted_lcp
from oracles.exact_criterion import failures
from scipy.optimize import linprog

from lcp_plugin import LCP, QuadraticProgram, Status, solve
from lcp_plugin.algorithms import InteriorPoint
from lcp_plugin.core.matrix import Matrix
from lcp_plugin.methods.interior_point import signs_of, with_signed_equations


def random_matrix(kind: str, n: int, rng: np.random.Generator) -> Any:
    """A monotone matrix of the kind."""
    B = rng.standard_normal((n, n))
    half = B[:, : max(1, n // 2)]
    return {
        "definite": B @ B.T + 0.1 * np.eye(n),
        "rank-deficient": half @ half.T,
        "nonsymmetric": half @ half.T + B - B.T,
        "skew": B - B.T,
        "zero": np.zeros((n, n)),
    }[kind]


@pytest.mark.quick(3)
@pytest.mark.parametrize("bounds", [False, True])
@pytest.mark.parametrize("storage", ["dense", "sparse"])
@pytest.mark.parametrize("kind", ["definite", "rank-deficient", "nonsymmetric", "skew", "zero"])
def test_solves_monotone_problems(kind, storage, bounds):
    """Every monotone problem with a known answer is solved to 1e-10, degenerate rows included."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        n = [1, 2, 5, 12, 30, 200][seed]
        M = random_matrix(kind, n, rng)
        if storage == "sparse":
            M = (
                sp.csr_array(np.where(rng.random((n, n)) < 0.2, M, 0.0))
                if kind == "zero"
                else sp.csr_array(M)
            )
        problem, _ = planted_lcp(M, rng, bounds=bounds)
        result = solve(problem, InteriorPoint(), tolerance=1e-10)
        assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT), (seed, result.certificate)


def wall(side: int, seed: int) -> LCP:
    """Normal contacts of a grid of boxes, four a face, four times as many as the boxes need."""
    rng, n = np.random.default_rng(seed), side * side
    faces = [(k, k - side) for k in range(n)] + [(k, k - 1) for k in range(n) if k % side]
    J = np.zeros((len(faces), 4, n, 6))
    for face, (one, other) in enumerate(faces):
        way = np.eye(3)[2 if other == one - side else 0]
        for corner, (a, b) in enumerate(product((-1, 1), repeat=2)):
            arm = np.array([a, b, -1] if way[2] else [-1, a, b])
            J[face, corner, one] = [*way, *np.cross(arm, way)]
            if other >= 0:
                J[face, corner, other] = [*-way, *-np.cross(arm + 2 * way, way)]
    rows, inverse = J.reshape(-1, 6 * n), np.repeat(rng.choice([1.0, 1e-3], n), 6)
    velocity = 1e-6 * rng.standard_normal((n, 6)) - 0.1 * np.eye(6)[2]
    return LCP((rows * inverse) @ rows.T, rows @ velocity.ravel())


@pytest.mark.quick(1)
@pytest.mark.parametrize("algorithm", ["auto", "interior_point"])
@pytest.mark.parametrize(("side", "seed"), [(4, 1), (5, 0), (5, 3), (5, 5)])
def test_contacts_of_a_wall_that_hardly_moves(side, seed, algorithm):
    """A run on singular active sets finds one of many z, which passes the rule of SOLVED in rational arithmetic."""
    problem = wall(side, seed)
    assert failures(problem, solve(problem, algorithm).require_solved().z) == []


@pytest.mark.parametrize("seed", range(6))
def test_linear_programs_agree_with_highs(seed):
    """P = 0, redundant equalities, a degenerate vertex: the objective is that of HiGHS."""
    rng = np.random.default_rng(seed)
    n, m = 20, 12
    G, A = rng.standard_normal((m, n)), rng.standard_normal((3, n))
    A = np.vstack([A, A[0] + A[1], 2.0 * A[2]])
    x = np.where(rng.random(n) < 0.5, 0.0, rng.random(n))
    multiplier = np.maximum(rng.standard_normal(m), 0.0)
    c = -(G.T @ multiplier + A.T @ rng.standard_normal(5) - np.where(x == 0.0, rng.random(n), 0.0))
    h = G @ x + np.where(multiplier > 0.0, 0.0, rng.random(m) * (rng.random(m) < 0.5))
    problem = LCP.from_qp(QuadraticProgram(np.zeros((n, n)), c, G, h, A, A @ x, lower=0.0))
    solution = problem.origin.recover(solve(problem, InteriorPoint(), tolerance=1e-10)).solution
    truth = linprog(c, G, h, A, A @ x, bounds=(0.0, None), method="highs").fun
    assert solution.error <= 1e-9
    assert abs(solution.objective - truth) <= 1e-8 * (1.0 + abs(truth))


def test_few_equations_hide_no_error():
    """Residuals of few equations more than barely consistent, z ≥ 0: every w is 0 at the answer."""
    rng = np.random.default_rng(1)
    A, x = rng.standard_normal((300, 600)), rng.standard_normal(600) * (rng.random(600) < 0.1)
    b = A @ x + 0.1 * rng.standard_normal(300)
    P = A.T @ A
    assert solve(LCP(0.5 * (P + P.T), -A.T @ b), "interior_point").status is Status.SOLVED


def test_signs_of_dense_and_sparse_matrices_agree(draws):
    """Symmetric matrices with rows of random signs, some entries replaced: the same signs or none in both storages."""
    found = set()
    for seed in draws(240, 4):
        rng = np.random.default_rng([98, seed])
        n = int(rng.integers(2, 8))
        A = rng.integers(-2, 3, (n, n)).astype(float)
        A, signs = A + A.T, rng.choice([-1.0, 1.0], n)
        A[np.ix_(signs < 0.0, signs < 0.0)] = 0.0
        A *= signs[:, None]
        if rng.random() < 0.5:
            A[rng.integers(n), rng.integers(n)] += 1.0
        dense = Matrix(A)
        expected = signs_of(Matrix(sp.csr_array(A)))
        assert (signs_of(dense) is None) is (expected is None)
        found.add(expected is None)
        if expected is not None:
            np.testing.assert_array_equal(signs_of(dense), expected)
    assert found == {True, False}


@pytest.mark.parametrize("unit", [1.0, 3.0])
def test_a_zero_sum_game_has_the_value_of_its_linear_program(unit):
    """A large game with B = u − t A has the value by HiGHS: a term per row of B has no influence."""
    rng = np.random.default_rng(100)
    A = rng.integers(-5, 6, (160, 150)).astype(float)
    problem = LCP.from_game(A, rng.integers(0, 9, 160)[:, np.newaxis] - unit * A)
    result = solve(problem)
    costs, ones = np.append(np.zeros(160), -1.0), np.append(np.ones(160), 0.0)
    rows = np.column_stack([-A.T, np.ones(150)])
    bounds = [(0.0, None)] * 160 + [(None, None)]
    value = -linprog(costs, rows, np.zeros(150), ones[np.newaxis], [1.0], bounds).fun
    found = problem.origin.recover(result)
    assert (result.status, result.algorithm) == (Status.SOLVED, "auto: interior_point")
    assert found.payoffs[0] == pytest.approx(value, abs=1e-9)
    assert found.regret <= 1e-9


@pytest.mark.parametrize("units", [(1.0, 1.0), (1e-6, 1e6), (1.0, 1e7)])
def test_a_program_with_an_equation_is_recognized_in_any_units_of_its_row_and_multiplier(units):
    """A body pressed by a given force, in SI units: K p − δ + g ≥ 0 and a sum of p: its program, by PIQP alone."""
    m, size, E = 18, 1e-2, 2e11
    h, s = size / m, (np.arange(m) + 0.5) * size / m - 0.5 * size
    x, y = (one.ravel() for one in np.meshgrid(s, s))
    distance = np.hypot(x[:, None] - x, y[:, None] - y) + np.eye(m * m)
    K = h * h / (np.pi * E * distance) + np.diag(np.full(m * m, 2.5 * h / (np.pi * E)))
    column, row = units
    M = np.block([[K, np.full((m * m, 1), -column)], [np.full((1, m * m), row), np.zeros((1, 1))]])
    q = np.append((x * x + y * y) / 0.1, -100.0 * row / h**2)
    problem = LCP(M, q, lower=np.append(np.zeros(m * m), -np.inf))
    scaled = with_signed_equations(problem)
    assert signs_of(scaled.matrix) is not None
    result = solve(problem, "interior_point").require_solved()
    program = QuadraticProgram(K, q[:-1], A=np.ones((1, m * m)), b=[100.0 / h**2], lower=0)
    expected = solve(program).require_solved().x
    np.testing.assert_allclose(result.z[:-1], expected, rtol=1e-6, atol=1e-6 * expected.max())
