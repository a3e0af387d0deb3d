"""Momentum of the np methods: the rule, its savings, undone cycles, and the methods without the option."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest

from lcp_plugin import LCP, convergence_guarantee, gallery, solve
from lcp_plugin.algorithms import NPGS, NPJ, NPSOR, NPSplitting, create

OBSTACLE = gallery.obstacle_2d(size=30).problem
ROTATION = np.eye(30) + 1.2 * np.roll(np.eye(30), 1, axis=1)


def literal_rule(problem: LCP, algorithm: Any, count: int) -> list[np.ndarray]:
    """Return the points of the rule in the docstring of `extrapolations`, while no cycle fails."""
    plain = create(algorithm.name, {"momentum": None})
    z = before = np.clip(0.0, problem.lower, problem.upper)
    y, t, last, is_plain, points = z, 1.0, np.inf, True, []
    for _ in range(count):
        points.append(y)
        z, before = [s.z.copy() for s in islice(plain.iterates(problem, y.copy()), 2)][1], z
        step = np.linalg.norm(z - y)
        if is_plain or step > last:
            is_plain = is_plain and not step > 0.8 * last
            t, last, y = 1.0, (step if is_plain else np.inf), z
        else:
            t, old = 0.5 + np.sqrt(0.25 + t * t), t
            y = np.clip(z + (old - 1.0) / t * (z - before), problem.lower, problem.upper)
            last = step
    return points


@pytest.mark.parametrize("algorithm", [NPJ(), NPGS(), NPSOR(), NPSplitting()])
def test_the_points_are_those_of_the_rule(algorithm: Any) -> None:
    """The first 150 points, some restarts among them, agree with the rule written out in numpy."""
    start = np.clip(0.0, OBSTACLE.lower, OBSTACLE.upper)
    found = [s.z.copy() for s in islice(algorithm.iterates(OBSTACLE, start), 150)]
    expected = literal_rule(OBSTACLE, algorithm, 150)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("sweep", ["forward", "backward", "symmetric"])
def test_momentum_saves_most_iterations_of_an_obstacle_problem(sweep: str) -> None:
    """With 900 unknowns npsor needs less than a quarter of the plain iterations, for each order of the rows."""
    fast, plain = (solve(OBSTACLE, "npsor", sweep=sweep, momentum=m) for m in ("auto", None))
    assert fast.is_solved
    assert plain.is_solved
    assert fast.iterations < plain.iterations / 4


@pytest.mark.parametrize("name", ["npj", "npgs", "npsor", "npaor"])
def test_failed_cycles_are_undone(name: str) -> None:
    """On a P-matrix with complex eigenvalues momentum fails, and costs at most 15 % more iterations."""
    problem = LCP(ROTATION, np.cos(np.arange(30.0)) - 1.0)
    fast, plain = (solve(problem, name, momentum=m) for m in ("auto", None))
    assert fast.is_solved
    assert fast.iterations <= 1.15 * plain.iterations + 1


def test_the_guarantee_gives_the_reason_and_no_rate() -> None:
    """With momentum no iteration contracts by itself; the theorem of the plain iteration is named."""
    fast, plain = (convergence_guarantee(OBSTACLE, "npsor", momentum=m) for m in ("auto", None))
    assert fast.is_guaranteed == plain.is_guaranteed
    assert fast.rate is None
    assert fast.theorem.startswith(plain.theorem)
    assert "undone" in fast.theorem
