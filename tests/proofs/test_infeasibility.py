"""Proofs that constraints contradict: found where they do, never where they do not, checked by other code."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from oracles.truth import is_farkas

from lcp_plugin import LCP, Certificate, QuadraticProgram, Status, solve
from lcp_plugin.methods.search import NoSolution, search
from lcp_plugin.proofs.no_solution import Infeasibility, find_infeasibility


def contradicting(rng: np.random.Generator, n: int, free: int = 0, boxes: int = 0) -> LCP:
    """Integers M, q with yᵀw < 0 for all z: the last row completes an integer combination of the others."""
    y = rng.integers(1, 4, n)
    y[-1] = 1
    M = rng.integers(-4, 5, (n, n))
    q = rng.integers(-4, 5, n)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    lower[:free] = -np.inf
    slack = rng.integers(0, 2, n)
    slack[:free] = 0
    if boxes:
        upper[free : free + boxes] = 2.0
        y[free : free + boxes] = 0
    M[-1] -= y @ M + slack
    q[-1] -= y @ q + 1
    return LCP(M.astype(float), q.astype(float), lower=lower, upper=upper)


@pytest.mark.quick(1)
@pytest.mark.parametrize(("free", "boxes"), [(0, 0), (2, 0), (0, 2), (2, 2)])
@pytest.mark.parametrize("n", [5, 12])
def test_contradicting_constraints_are_proven(n, free, boxes):
    """Problems built to contradict get a proof that independent fractions confirm."""
    for seed in range(8):
        problem = contradicting(np.random.default_rng(seed), n, free, boxes)
        proof = find_infeasibility(problem)
        assert proof is not None
        assert is_farkas(problem, list(proof.exact_y))
        assert proof.verify()
        assert "inconsistent" in str(proof)


@given(st.integers(0, 10**6))
def test_feasible_problems_are_never_called_infeasible(seed):
    """A problem built around a feasible point gets no proof."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    M, z = rng.integers(-5, 6, (n, n)), rng.integers(0, 3, n)
    lower = np.where(rng.random(n) < 0.2, -np.inf, 0.0)
    upper = np.where(rng.random(n) < 0.3, 3.0, np.inf)
    w = np.where(upper == np.inf, rng.integers(0, 2, n), -rng.integers(0, 2, n))
    w[(lower == -np.inf) & (upper == np.inf)] = 0
    problem = LCP(M, w - M @ z, lower=lower, upper=upper)
    assert find_infeasibility(problem) is None


def test_the_proof_does_not_depend_on_units():
    """Rows and columns in units apart by many powers of ten leave a contradiction provable."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        plain = contradicting(rng, 6)
        rows, columns = 10.0 ** rng.integers(-9, 9, (6, 1)), 2.0 ** rng.integers(-20, 20, 6)
        problem = LCP(
            plain.csr.toarray() * rows * columns - 1e-16 * rows * columns, plain.q * rows[:, 0]
        )
        proof = find_infeasibility(problem)
        assert proof is not None
        assert is_farkas(problem, list(proof.exact_y))


@pytest.mark.full
def test_a_large_problem_is_proven_exactly():
    """For n = 3000 a proof is found, and other fractions confirm it."""
    n = 3000
    laplacian = sp.diags_array(
        [-np.ones(n - 1), 2.1 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1]
    )
    problem = LCP(-laplacian, np.random.default_rng(0).standard_normal(n) - 0.5)
    proof = find_infeasibility(problem)
    assert proof is not None
    assert proof.verify()
    assert is_farkas(problem, list(proof.exact_y))
    assert Infeasibility.of(problem, dict.fromkeys(range(n), 1)).verify()


# --- By how much -------------------------------------------------------------------------------------------------


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", range(12))
def test_no_z_has_a_residual_below_the_margin(seed):
    """Every z within the bounds, the answers of all methods among them, has a residual of at least the margin."""
    rng = np.random.default_rng(seed)
    problem = contradicting(rng, 6, seed % 3, seed % 2)
    proof = find_infeasibility(problem)
    assert proof is not None
    assert 0.0 < proof.margin < 1.0
    points = [
        solve(problem, name, max_iterations=50).z
        for name in ("npsor", "newton", "interior_point", "lemke")
    ]
    points += [
        np.clip(rng.standard_normal(6) * 10.0 ** rng.integers(-2, 4), problem.lower, problem.upper)
        for _ in range(40)
    ]
    for z in points:
        certificate = Certificate.of(problem, z)
        assert certificate.relative_residual >= proof.margin * (1.0 - 1e-12)


def test_the_largest_margin_is_looked_for():
    """A row that contradicts by 1e-14 hides no contradiction of 0.1 in two others."""
    problem = LCP([[1.0, -1.0, -1.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]], [-1.0, 0.8, -1e-14])
    proof = find_infeasibility(problem)
    assert proof is not None
    assert proof.margin == pytest.approx(0.1, rel=1e-6)
    assert solve(problem).status is Status.INFEASIBLE


@pytest.mark.quick(1)
@pytest.mark.parametrize("t", [1e-3, 1e-6, 1e-10])
def test_cases_have_a_margin_too(t):
    """w₁ = 1 forces z₁ = 0, w₂ = z₁ − t asks for t: every z misses by t/2, which counts beyond the tolerance only."""
    problem = LCP([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 2.0]], [1.0, -t, -2.0])
    tree = search(problem)
    assert isinstance(tree, NoSolution)
    assert tree.margin == pytest.approx(t / 2, rel=1e-9)
    assert tree.margin <= t / 2
    status = solve(problem).status
    assert (status is Status.NO_SOLUTION) == (t > 1e-8)
    near = np.array([t / 2, 0.0, 1.0 - t / 2])
    assert Certificate.of(problem, near).relative_residual == pytest.approx(t / 2)


@pytest.mark.parametrize(
    ("M", "q"),
    [
        ([[-1e300]], [-1e-300]),
        ([[-1e-300]], [-1e300]),
        ([[-5e-324]], [-5e-324]),
        ([[-1e308, -1e308], [0, -1e308]], [-1e308, -1e308]),
        ([[0, -5e-324], [0, 0]], [-1, 1e308]),
    ],
)
def test_margins_at_the_edge_of_the_numbers_are_sound(M, q):
    """Whatever overflows or underflows on the way, the proof holds and its margin is not above the exact margin."""
    problem = LCP(M, q)
    proof = find_infeasibility(problem)
    assert proof is not None
    assert proof.verify()
    assert proof.margin <= 1.0 or not np.isfinite(problem.q[0] / problem.residual_scale[0])


def test_a_contradiction_of_the_conditions_alone_is_none_of_the_program():
    """Where rounding is all that acts in the optimality conditions of a consistent program, nothing is infeasible."""
    P, G = [[2.0, -2.0], [-2.0, 5.0]], [[-0.05, 0.06], [3.0, 1.0], [0.0, 0.01]]
    h, bounds = [0.17 - 2.0**-55, 3.0, 0.05], {"lower": [-np.inf, 2.0], "upper": [-1.0, np.inf]}
    data = (P, [-10.9, 2.87], G, h, [[0.0, 0.003]], [0.006])
    assert solve(QuadraticProgram(*data, **bounds)).is_solved
    assert not solve(LCP.from_qp(*data, **bounds)).has_no_solution


def test_a_contradiction_between_numbers_of_many_sizes_is_found():
    """Rows and bounds of sizes from 1e-3 to 1e3 that miss each other by less than 1 % of the residual at 0."""
    M = [
        [1 / 4, 0, 128, -1 / 16, -1 / 128, 1 / 128, 64], [1 / 4, 0, 192, 0, 1 / 128, -3 / 128, -128],
        [3 / 8, -1, 256, -1 / 16, 0, 0, -64], [1 / 8, -1 / 2, -128, 0, 0, -1 / 128, 0],
        [0, -1.5, 0, 0, 1 / 64, 1 / 128, 0], [-1 / 8, -1 / 2, 192, 0, 3 / 128, 1 / 128, 0],
        [-1 / 8, 5.5, -512, -1 / 32, -5 / 64, -1 / 64, 192],
    ]  # fmt: skip
    q = [-3.999999890701664, -3.0, -5.0001119214964, 3.0, 2.999999993168854, -1.000000003415573]
    lower = [-np.inf, -2.0, 1 / 64, 0.0, 0.0, 0.0, 0.0]
    proof = find_infeasibility(LCP(M, [*q, -2.0000839411222993], lower=lower))
    assert proof is not None
    assert proof.verify()
    assert 4.9e-8 <= proof.margin <= 5.464917115040035e-08  # a point attains this violation


def decimal_network(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return the Laplacian of a network with weights in tenths, summed in double precision."""
    W = np.triu(rng.integers(0, 10, (n, n)) / 10, 1)
    return np.diag((W + W.T).sum(axis=1)) - W - W.T


def test_a_load_above_rounding_is_a_contradiction():
    """A network that nothing holds, with a total load of 1e-9 of its terms, has no solution."""
    rng = np.random.default_rng(9)
    K = decimal_network(rng, 6)
    result = solve(LCP(K, np.full(6, -1e-9), lower=0.3))
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()
