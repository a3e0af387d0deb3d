"""Rows of one variable become bounds; multipliers and proofs come back to the program that was stated."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_plugin import QuadraticProgram, solve
from lcp_plugin.problems.programs.reductions import FoldedRows


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
def test_the_answer_to_what_is_left_is_one_to_the_program(seed: int) -> None:
    """Points and multipliers of the reduced program come back as those of the program."""
    program = program_with_all(seed)
    folded = FoldedRows.of(program)
    found = solve(folded.reduced)
    assert found.is_solved
    multipliers = folded.multipliers(found.solution.multipliers)
    gradient = program.P @ found.x + program.c + program.constraints.matrix.T @ multipliers
    np.testing.assert_allclose(gradient, 0.0, atol=1e-8)
    assert type(found.solution).of_rows(program, found.x, multipliers).is_optimal(1e-8)
    np.testing.assert_allclose(found.x, solve(program).x, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_a_contradiction_of_what_is_left_is_one_of_the_program(seed: int) -> None:
    """What proves that the reduced program has no point comes back as a proof of the program: by its own rows."""
    program = program_with_all(seed, contradicts=True)
    reduction = FoldedRows.of(program)
    proof = reduction.proof(reduction.reduced.facts.proof_of_no_minimum)
    assert proof is not None
    assert proof.program is program
    assert proof.verify()
    rows = np.flatnonzero(np.array(proof.multipliers, dtype=np.float64)[: program.constraints.rows])
    assert set(rows.tolist()) <= {0, 1, 2}


def test_a_direction_of_descent_of_what_is_left_is_one_of_the_program() -> None:
    """Along with fixed variables, a direction and its point come back."""
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
    reduction = FoldedRows.of(program)
    assert not reduction.reduced.h.size
    proof = reduction.proof(reduction.reduced.facts.proof_of_no_minimum)
    assert proof is not None
    assert (proof.verdict, proof.program, proof.verify()) == ("unbounded", program, True)
