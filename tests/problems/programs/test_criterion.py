"""What SOLVED means of programs: values and violations of answers, with the numbers that users write."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import qpsolvers

from lcp_plugin import QPSolver, QuadraticProgram, QuadraticProgramBatch, register_with_qpsolvers, solve, solve_batch

register_with_qpsolvers()

HALF_SPACES = np.diag([2.0, 2.0]), np.array([-300.0, -500.0]), np.array([[3.0, 1.0], [1.0, 4.0]]), np.array([10.0, 10])
NEAREST = [30 / 11, 20 / 11]  # of these, whatever is far away
FAR = [1e20, 9.999999999999999e19, 1e30, np.inf]


# --- Limits that say nothing -----------------------------------------------------------------------------------------


def by_bounds(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    return solve(QuadraticProgram(P, c, G, h, lower=[-far, 0.0], upper=far)).solution.x


def by_rows(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    return solve(QuadraticProgram(P, c, [*G, [1.0, 0.0]], [*h, far], lower=0.0)).solution.x


def by_other_vectors(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    program = QuadraticProgram(P, c, [*G, [1.0, 0.0]], [*h, 1.0], lower=0.0, upper=1.0)
    return solve(program.with_vectors(h=[*h, far], upper=[far, far])).solution.x


def by_batch(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    programs = QuadraticProgramBatch([P, P], c, [*G, [1.0, 0.0]], [*h, far], lower=[-far, 0.0], upper=far)
    answers = solve_batch(programs)
    np.testing.assert_array_equal(answers.x[0], answers.x[1])
    return answers.x[0]


def by_qpsolvers(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    return qpsolvers.solve_qp(P, c, G, h, lb=np.array([-far, 0.0]), ub=np.full(2, far), solver="lcp_plugin")


def by_cvxpy(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    x = cp.Variable(2, bounds=[-far, far])
    cp.Problem(cp.Minimize(0.5 * cp.quad_form(x, P) + c @ x), [G @ x <= h, x[0] <= min(far, 1e300)]).solve(QPSolver)
    return x.value


@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("answer", [by_bounds, by_rows, by_other_vectors, by_batch, by_qpsolvers, by_cvxpy])
def test_limits_of_1e20_say_nothing(answer: Callable[[float], Any], far: float) -> None:
    """By every way in, an upper limit of 1e20 and beyond is none, as ∞ is, and so is a lower one of −1e20."""
    np.testing.assert_allclose(answer(far), NEAREST, rtol=1e-9)


def test_limits_of_1e20_are_kept_as_infinite() -> None:
    """What a program shows of them is ∞; a right-hand side of −1e20 says something, and stays."""
    program = QuadraticProgram([[0.0]], [1.0], [[1.0], [-1.0]], [1e20, -1e20], lower=-1e20, upper=1e30)
    np.testing.assert_array_equal([*program.h, *program.lower, *program.upper], [np.inf, -1e20, -np.inf, np.inf])
    for P in (np.zeros((1, 1)), np.zeros((1, 1, 1))):
        batch = QuadraticProgramBatch(P, [[1.0]], [[1.0], [-1.0]], [1e20, -1e20], lower=-1e20, upper=1e30)
        assert repr(batch[0]) == repr(program)
