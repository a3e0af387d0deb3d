"""Programs are reduced by a stack of steps; x, multipliers and proofs come back to the program that was stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from lcp_plugin import QuadraticProgram, solve
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.problems.programs.program_matrices import Indices
from lcp_plugin.problems.programs.reductions import FoldedRows, Reduction, ReductionStep


@dataclass(frozen=True, eq=False)
class DistinctRows(ReductionStep):
    """The program without the rows of G that are stated before: all that a step of one's own takes."""

    kept: Indices

    @classmethod
    def of(cls, program: QuadraticProgram) -> DistinctRows | None:
        """Return that of a program; None where no row is stated twice."""
        stated = np.column_stack(
            [program.matrices.rows.toarray(), np.append(program.h, program.b)]
        )[: program.h.size]
        left = np.sort(np.unique(stated, axis=0, return_index=True)[1])
        if left.size == program.h.size:
            return None
        left = np.append(left, np.arange(program.h.size, program.constraints.rows))
        kept = np.append(left, np.arange(program.constraints.rows, program.constraints.limit.size))
        h = program.h[left[left < program.h.size]]
        reduced = program.with_matrices(
            program.matrices.of_rows(left), program.c, h, program.b, program.lower, program.upper
        )
        return cls(program, reduced, kept)

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the multipliers of what is left."""
        return x, multipliers[self.kept]

    def multipliers(self, reduced: Any, x: FloatVector | None) -> Any:
        """Return the multipliers of all constraints: those of the rows that went are 0."""
        whole = np.zeros(self.program.constraints.limit.size, dtype=reduced.dtype)
        whole[self.kept] = reduced
        return whole


STEPS: dict[str, Callable[[QuadraticProgram], ReductionStep | None]] = {
    "simple rows": FoldedRows.of,
    "doubled rows": DistinctRows.of,
}


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


def whole_stack(program: QuadraticProgram) -> Reduction:
    """All steps."""
    reduction = Reduction(program)
    for step in STEPS.values():
        reduction = reduction.then(step)
    assert len(reduction.steps) == len(STEPS)
    return reduction


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("name", [*STEPS, "all"])
def test_the_answer_to_what_is_left_is_one_to_the_program(name: str, seed: int) -> None:
    """Points and multipliers of the reduced program come back as those of the program, one step or all."""
    program = program_with_all(seed)
    reduction = whole_stack(program) if name == "all" else Reduction(program).then(STEPS[name])
    found = solve(reduction.reduced)
    assert found.is_solved
    x, multipliers = reduction.outward(found.x, found.solution.multipliers)
    back = type(found.solution).of_rows(program, x, multipliers)
    assert back.is_optimal(1e-8)
    np.testing.assert_allclose(x, solve(program).x, atol=1e-8)
    inner = reduction.inward(x, multipliers)
    np.testing.assert_allclose(inner[0], found.x, atol=1e-12)
    np.testing.assert_allclose(reduction.outward(*inner)[1], multipliers, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_contradiction_of_what_is_left_is_one_of_the_program(seed: int) -> None:
    """What proves that the reduced program has no point comes back as a proof of the program: by its own rows."""
    program = program_with_all(seed, contradicts=True)
    reduction = whole_stack(program)
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
    reduction = Reduction(program).then(FoldedRows.of)
    assert len(reduction.steps) == 1
    proof = reduction.proof(reduction.reduced.facts.proof_of_no_minimum)
    assert proof is not None
    assert (proof.verdict, proof.program, proof.verify()) == ("unbounded", program, True)


@pytest.mark.parametrize(("n", "by"), [(40, "daqp"), (401, "piqp")])
def test_a_contradiction_is_named_by_what_came_upon_it(n: int, by: str) -> None:
    """Daqp takes up to 400 variables: what contradicts in more, PIQP came upon."""
    rows = np.zeros((2, n))
    rows[:, [3, 7]] = [[1.0, 1.0], [-1.0, -1.0]]
    result = solve(QuadraticProgram(np.eye(n), np.ones(n), rows, [-1.0, -1.0]))
    assert (result.status.name, result.algorithm) == ("INFEASIBLE", f"auto: {by}")
    assert [stage.name for stage in result.stages] == [by]


@pytest.mark.parametrize("name", ["npsor", "psor", "gfp", "multigrid"])
def test_sweeps_take_residuals_that_equations_define(name: str) -> None:
    """Minimise ½ |t|² with t = A x − b and x ≥ 0, as cvxpy writes least squares: M has no diagonal, AᵀA has one."""
    rng = np.random.default_rng(0)
    (m, n), lower = (12, 6), np.append(np.full(12, -np.inf), np.zeros(6))
    A, b = rng.standard_normal((m, n)), rng.standard_normal(m)
    program = QuadraticProgram(
        np.diag(np.append(np.ones(m), np.zeros(n))),
        np.zeros(m + n),
        A=np.hstack([np.eye(m), -A]),
        b=-b,
        lower=lower,
    )
    found, right = solve(program, name), solve(program)
    assert found.is_solved
    assert found.objective == pytest.approx(right.objective, rel=1e-9)
