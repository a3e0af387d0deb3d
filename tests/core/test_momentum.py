"""Momentum of the np methods: the rule, its savings, undone cycles, and the methods without the option."""

import numpy as np
import pytest

from lcp_plugin import LCP, convergence_guarantee, gallery, solve

OBSTACLE = gallery.obstacle_2d(size=30).problem
ROTATION = np.eye(30) + 1.2 * np.roll(np.eye(30), 1, axis=1)


@pytest.mark.parametrize("sweep", ["forward", "backward", "symmetric"])
def test_momentum_saves_most_iterations_of_an_obstacle_problem(sweep):
    """With 900 unknowns npsor needs less than a quarter of the plain iterations, for each order of the rows."""
    fast, plain = (solve(OBSTACLE, "npsor", sweep=sweep, momentum=m) for m in ("auto", None))
    assert fast.is_solved
    assert plain.is_solved
    assert fast.iterations < plain.iterations / 4


@pytest.mark.parametrize("name", ["npj", "npgs", "npsor", "npaor"])
def test_failed_cycles_are_undone(name):
    """On a P-matrix with complex eigenvalues momentum fails, and costs at most 15 % more iterations."""
    problem = LCP(ROTATION, np.cos(np.arange(30.0)) - 1.0)
    fast, plain = (solve(problem, name, momentum=m) for m in ("auto", None))
    assert fast.is_solved
    assert fast.iterations <= 1.15 * plain.iterations + 1


def test_the_guarantee_gives_the_reason_and_no_rate():
    """With momentum no iteration contracts by itself; the theorem of the plain iteration is named."""
    fast, plain = (convergence_guarantee(OBSTACLE, "npsor", momentum=m) for m in ("auto", None))
    assert fast.is_guaranteed == plain.is_guaranteed
    assert fast.rate is None
    assert fast.theorem.startswith(plain.theorem)
    assert "undone" in fast.theorem
