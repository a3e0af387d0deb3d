"""The first three lines of explain(): the event, its certainty, the next step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from inputs.small_families import falling_bodies

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    EquilibriumProgram,
    FrictionalContact,
    InvalidOption,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    gallery,
    solve,
)

RNG = np.random.default_rng(0)
OBSTACLE = gallery.obstacle_2d(size=20).problem
FIT = BoundedLeastSquares(RNG.standard_normal((30, 5)), np.arange(30.0), l1=20.0)
PAIRS, COSTS = RNG.standard_normal((12, 12)), RNG.standard_normal(24)
BEST = EquilibriumProgram(
    QuadraticProgram(
        np.zeros((24, 24)),
        COSTS,
        A=np.hstack([PAIRS, -np.eye(12)]),
        b=PAIRS.sum(axis=1),
        lower=0,
        upper=10,
    ),
    np.arange(12),
    np.arange(12, 24),
)
BLOCK = FrictionalContact(
    (np.eye(3), [[0.0, 0.0, 1.0]], [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]), [1.0, 0.0, -1.0], 0.4
)

# Each with how it is found, its status, and how its second and its third line begin.
RESULTS: dict[str, tuple[Callable[[], Any], Status, str, str]] = {
    "solved": (lambda: solve(OBSTACLE), Status.SOLVED, "relative residual", ""),
    "limit": (
        lambda: solve(OBSTACLE, "psor", max_iterations=5),
        Status.MAX_ITERATIONS,
        "relative residual",
        'next: try algorithm="auto", or raise max_iterations, or continue from z0=result.z',
    ),
    "infeasible": (
        lambda: solve(LCP([[0.0, 1.0], [-1.0, 0.0]], [-1.0, -1.0])),
        Status.INFEASIBLE,
        "no z within its bounds gives w the signs it needs: row",
        "next: print(result.conflict), which conditions conflict",
    ),
    "no solution": (
        lambda: solve(LCP([[0.0, 1.0], [1.0, 0.0]], [1.0, -1.0])),
        Status.NO_SOLUTION,
        "no solution: each of the 2 cases",
        "next: check the data",
    ),
    "unbounded": (
        lambda: solve(QuadraticProgram(np.diag([1.0, 0.0]), [0.0, -1.0], lower=0.0)),
        Status.UNBOUNDED,
        "unbounded below along",
        "next: add bounds for the unknowns",
    ),
    "precision": (
        lambda: solve(
            LCP([[-1.0, -1.0], [-1.0, 2.0]], [-5.6e-17, 1.0])
        ),  # no solution, by rounding
        Status.PRECISION_LIMIT,
        "relative residual",
        "next: accept z, or rescale the data",
    ),
    "stalled": (
        lambda: solve(falling_bodies(12), "npsor"),
        Status.STALLED,
        "relative residual",
        'next: try algorithm="auto"',
    ),
    "equilibrium program": (
        lambda: solve(BEST, prove=True, max_nodes=8),
        Status.MAX_ITERATIONS,
        "objective -",
        "next: raise max_nodes",
    ),
    "contact": (lambda: solve(BLOCK), Status.SOLVED, "relative residual", ""),
    "program": (
        lambda: solve(
            QuadraticProgram([[2.0, 1.0], [1.0, 2.0]], [-3.0, -4.0], G=[[1.0, 1.0]], h=[1.0]),
            "daqp",
            max_iterations=1,
        ),
        Status.MAX_ITERATIONS,
        "objective 0; constraints are violated by",
        "next: raise max_iterations",
    ),
    "least squares": (lambda: solve(FIT), Status.SOLVED, "optimality", ""),
    "nonlinear": (
        lambda: solve(NonlinearProblem(lambda x: x * x + 1.0, lower=-np.inf), x0=[1.0]),
        Status.STALLED,
        "relative residual",
        "next: try another start x0",
    ),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", RESULTS)
def test_the_first_three_lines_answer_three_questions(name):
    """The summary names the status, the residual or the proof, and the next step of an unsolved problem."""
    call, status, sure, to_do = RESULTS[name]
    result = call()
    first, second, third, *_ = result.explain().splitlines()
    assert result.status is status
    assert first.startswith(f"{status.name}: ")
    assert second.startswith(sure)
    assert third.startswith(to_do or result.algorithm)
    assert result.is_solved is not third.startswith("next: ")


def test_explain_of_a_polished_point_names_the_polish():
    """A last linear solve on the active set is a line of explain(); without it, the point is the last iterate."""
    polished, iterate = (
        solve(OBSTACLE, "npsor", momentum=None, polish=one) for one in (True, False)
    )
    line = "  polish: a linear solve on the active set of the last iterate gives z"
    assert polished.is_polished
    assert line in polished.explain().splitlines()
    assert not iterate.is_polished
    assert "polish" not in iterate.explain()
    assert polished.residual < 1e-12 < iterate.residual <= 1e-8


def test_polish_is_an_option_of_lcps_only():
    """Other classes raise InvalidOption for `polish=False`."""
    for problem in (QuadraticProgram(np.eye(2), [1.0, 1.0]), FIT, BLOCK):
        with pytest.raises(InvalidOption, match="solve takes no polish"):
            solve(problem, polish=False)


def test_a_solution_is_not_called_unproven():
    """The lack of a theorem is a warning after failures only."""
    problem = LCP([[1.0, -2.0], [-2.0, 1.0]], [1.0, 1.0])
    solved, failed = solve(problem, "psor"), solve(problem.with_q([-1.0, -1.0]), "psor")
    words = "nothing proves that psor converges"
    assert (solved.is_solved, words in solved.explain()) == (True, False)
    assert (failed.is_solved, words in failed.explain()) == (False, True)
