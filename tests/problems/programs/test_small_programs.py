"""Small quadratic programs, answered by an engine, have the answers that were chosen first."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planted import planted_program

from lcp_plugin import QuadraticProgramBatch, Status, solve, solve_batch
from lcp_plugin.problems.programs.conversion import lcp_from_qp
from lcp_plugin.problems.programs.program import QuadraticProgram
from lcp_plugin.problems.programs.solving import solve_program

INF = np.inf


@given(
    n=st.integers(1, 25),
    rows=st.integers(0, 20),
    equations=st.integers(0, 4),
    lacks=st.integers(0, 3),
    seed=st.integers(0, 2**32 - 1),
)
def test_answers_chosen_first_are_found(
    n: int, rows: int, equations: int, lacks: int, seed: int
) -> None:
    """The value is the planted one, and so is x where P is positive definite; each measure bounds the program's own."""
    equations = min(equations, n - 1)
    program, x, value = planted_program(n, rows, equations, max(n - lacks, 0), seed)
    result = solve_program(program)
    solution = result.solution
    assert solution.is_optimal()
    assert solution.objective == pytest.approx(value, rel=1e-8, abs=1e-8)
    if lacks == 0 and np.linalg.cond(program.P) < 1e6:
        assert np.allclose(solution.x, x, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("h", "b", "status"),
    [
        ([], [0.0, 0.0], Status.SOLVED),
        ([2.0], [0.0], Status.SOLVED),
        ([], [1.0], Status.INFEASIBLE),
        ([-1.0], [0.0], Status.INFEASIBLE),
        ([9.0, 0.0, -7.0, 2.0], [7.0], Status.INFEASIBLE),
    ],
)
def test_a_program_without_unknowns_is_what_its_rows_say(
    h: list[float], b: list[float], status: Status
) -> None:
    """All variables of a file may be fixed: 0 = 0 and 0 <= 2 hold, 0 = 1 and 0 <= -1 are proved not to."""
    rows = [np.zeros((len(right), 0)) for right in (h, b)]
    program = QuadraticProgram(np.zeros((0, 0)), np.zeros(0), rows[0], h, rows[1], b)
    assert solve_program(program).status is status


def test_a_program_and_its_complementarity_problem_agree() -> None:
    """Where equations fix x, where rows repeat or sum up to others, SOLVED is said where the program is optimal."""
    rng = np.random.default_rng(5)
    for k in range(60):
        program, _, value = planted_program(8, 6, 2, 8 - k % 4, k)
        A = np.vstack([program.A, program.A.sum(axis=0), rng.standard_normal((8 * (k % 2), 8))])
        x = solve_program(program).solution.x
        redundant = QuadraticProgram(
            program.P,
            program.c,
            np.vstack([program.G, program.G]),
            np.append(program.h, program.h),
            A,
            A @ x,
            program.lower,
            program.upper,
        )
        problem = lcp_from_qp(redundant)
        result = solve(problem)
        solution = problem.origin.recover(result)
        assert result.is_solved
        assert solution.is_optimal()
        assert solution.objective == pytest.approx(value, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("algorithm", ["auto", "interior_point"])
@pytest.mark.parametrize(("cost", "far"), [(1e-8, 1e3), (1e-9, 1e6), (1e-9, 1e11), (1e-10, 1e9)])
def test_a_small_cost_and_a_far_bound_hide_nothing(algorithm: str, cost: float, far: float) -> None:
    """The minimum is −1/2 − cost · far, at that bound: what is called optimal is there, in a batch, too."""
    program = QuadraticProgram(
        np.diag([1.0, 0.0]), [-1.0, cost], G=[[1.0, 1.0]], h=[50.0], lower=[-1.0, -far], upper=1.0
    )
    value = -0.5 - cost * far
    found = solve_program(program, algorithm)
    assert not found.is_solved or found.objective == pytest.approx(value, rel=2e-6)
    batch = solve_batch(
        QuadraticProgramBatch(
            program.P,
            [program.c] * 2,
            program.G,
            program.h,
            lower=program.lower,
            upper=program.upper,
        )
    )
    for one, status in zip(batch, batch.status, strict=True):
        assert status is not Status.SOLVED or one.objective == pytest.approx(value, rel=2e-6)


def test_a_result_can_be_replaced_pickled_and_given_a_start() -> None:
    """As any other result; z0 is a start, of which the compiled call knows nothing."""
    program, _, value = planted_program(5, 3, 1, 5, 2)
    result = solve_program(program)
    solution = result.solution
    other = dataclasses.replace(result, algorithm="mine")
    assert other.algorithm == "mine"
    assert pickle.loads(pickle.dumps(result)).x.tolist() == result.x.tolist()
    again = solve_program(program, z0=result.x)
    assert again.x.tobytes() == result.x.tobytes()
    found = again.solution
    assert found.objective == pytest.approx(value, rel=1e-8, abs=1e-8)
    assert solution.is_optimal()


def test_whoever_watches_or_limits_gets_the_same_bits() -> None:
    """A limit, a log, a record, a callback and a start change no bit of x and no status."""
    for program, *_ in (planted_program(6, 4, 1, 6, 3), planted_program(30, 20, 3, 20, 4)):
        plain = solve_program(program)
        seen: list[Any] = []
        for wish in (
            {"max_seconds": 15.0},
            {"verbose": True},
            {"record": True},
            {"z0": np.ones(program.n)},
            {"callback": lambda sample, x, seen=seen: seen.append(x)},
        ):
            found = solve_program(program, **wish)
            assert (found.status, found.algorithm) == (plain.status, plain.algorithm)
            assert found.x.tobytes() == plain.x.tobytes()
        assert len(seen) == 2
        assert np.array_equal(seen[-1], plain.x)
