"""Drawn nonlinear problems have the answer that is drawn with them, and solve_nonlinear finds it."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from hypothesis import given

from lcp_plugin import Status
from lcp_plugin.problems.nonlinear.data import NonlinearProblem
from lcp_plugin.problems.nonlinear.solving import solve_nonlinear
from lcp_plugin.strategies import solved_nonlinear_problems

Drawn = tuple[NonlinearProblem, tuple[Fraction, ...]]


@given(solved_nonlinear_problems(bounds=True))
def test_the_drawn_answer_solves_the_problem(drawn: Drawn) -> None:
    """At the drawn x, F has exactly the signs that the bounds permit."""
    problem, answer = drawn
    x = np.array(answer, dtype=float)
    w = problem.value(x)
    assert ((problem.lower <= x) & (x <= problem.upper)).all()
    assert (w[x > problem.lower] <= 0.0).all()
    assert (w[x < problem.upper] >= 0.0).all()


@given(solved_nonlinear_problems(bounds=True))
def test_the_drawn_answer_is_found(drawn: Drawn) -> None:
    """Monotone by rows, the default problems have one solution, and Josephy–Newton finds it from 0."""
    problem, answer = drawn
    x = np.array(answer, dtype=float)
    result = solve_nonlinear(problem, np.zeros(x.size), tolerance=1e-12)
    assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT)
    np.testing.assert_allclose(result.z, x, atol=1e-6)
