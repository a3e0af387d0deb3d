"""Every piece of advice is followed on the problem that received it: the call runs, and does better."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from inputs.small_families import falling_bodies
from inputs.textbook_scenes import scaling_trap

from lcp_plugin import LCP, LCPError, Status, complements, gallery, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.settings import Settings
from lcp_plugin.solving.lcp_run import advice_of_run

CONTACT = falling_bodies(12)
TRAPPED = scaling_trap().problem  # an H₊-matrix on which unscaled steps run into a cycle
# a P-matrix, far from H₊
FAR = LCP([[1.0, 3.0, 0.0], [0.0, 1.0, 3.0], [3.0, 0.0, 1.0]], [-1.0, -2.0, -3.0])
SADDLE = LCP([[0.0, 1.0], [-1.0, 0.0]], [-1.0, 2.0])
UNSUITED = LCP(-4.0 * np.eye(3) + 1.0, [1.0, -1.0, 1.0], upper=5.0)


def advice_of(call: Callable[[], Any]) -> str:
    """Return the message of the error of a call, or the advice of its unsolved result."""
    try:
        found = call()
    except LCPError as error:
        return str(error)
    assert not found.is_solved
    return str(found.advice)


def calls_in(advice: str) -> list[dict[str, Any]]:
    """Return the keyword arguments that the advice names, one dictionary a name."""
    return [{name: value} for name, value in re.findall(r'(algorithm|scaling)="(\w+)"', advice)]


def indefinite() -> LCP:
    """Return a problem with a known solution and an indefinite M."""
    rng, n = np.random.default_rng(0), 30
    A = rng.standard_normal((n, n))
    z = np.where(rng.random(n) < 0.5, rng.random(n), 0.0)
    return LCP(A, np.where(z > 0.0, 0.0, rng.random(n)) - A @ z)


# The problem and the failed call; its advice names auto and nothing else.
FOLLOWED: list[tuple[LCP, dict[str, Any]]] = [
    # rejected before the first step
    (CONTACT, {"algorithm": "psor"}),
    (CONTACT, {"algorithm": "multigrid"}),
    (
        gallery.obstacle_2d(size=5).problem.with_q(np.ones(25), lower=-1.0, upper=1.0),
        {"algorithm": "mgs"},
    ),
    (UNSUITED, {"algorithm": "npgs"}),
    (LCP([[-1.0, 0.0], [0.0, 4.0]], [1.0, -1.0]), {"algorithm": "npsplitting", "scaling": None}),
    # without convergence
    (CONTACT, {"algorithm": "npsor"}),
    *((indefinite(), {"algorithm": name}) for name in ("interior_point", "banded")),
    (FAR, {"algorithm": "psor", "relaxation": 1.9}),
    (TRAPPED, {"algorithm": "npsor", "scaling": None}),
    # a limit
    (TRAPPED, {"algorithm": "npsplitting", "scaling": None, "max_iterations": 1}),
    (FAR, {"algorithm": "npsor", "max_iterations": 5}),
]


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("problem", "failed"), FOLLOWED, ids=[f"{k} {failed}" for k, (_, failed) in enumerate(FOLLOWED)]
)
def test_the_call_that_is_advised_solves_the_problem(problem, failed):
    """The advice names auto, which differs from the failed call and solves the problem."""
    assert calls_in(advice_of(lambda: solve(problem, **failed))) == [{"algorithm": "auto"}]
    assert solve(problem).is_solved


@pytest.mark.quick(2)
@pytest.mark.parametrize("name", list(REGISTRY))
def test_no_algorithm_is_advised_to_itself(name):
    """The error or advice of an algorithm that fails does not name the algorithm."""
    for problem in (CONTACT, FAR, SADDLE, UNSUITED, TRAPPED):
        for limit in (None, 2):
            try:
                result = solve(problem, name, max_iterations=limit)
            except LCPError as error:
                told = str(error)
            else:
                told = result.advice
            assert f'algorithm="{name}"' not in told


def hard(seed: int = 1) -> tuple[LCP, np.ndarray]:
    """Return a problem that auto does not solve from z°, and a solution of it."""
    rng, n = np.random.default_rng(seed), 90
    A = rng.standard_normal((n, n)) - 2.0 * np.eye(n)
    u = rng.random(n)
    z, w = np.where(u < 0.5, u + 0.5, 0.0), np.where(u < 0.5, 0.0, u)
    return LCP(A, w - A @ z), z


@pytest.mark.full
def test_auto_is_not_advised_to_itself():
    """If auto fails, its advice recommends another start, which helps."""
    problem, z = hard()
    result = solve(problem)
    assert result.status is Status.STALLED
    assert calls_in(result.advice) == []
    assert "try another start z0" in result.advice
    assert solve(problem, z0=z + 1e-6).is_solved


def test_a_matrix_with_the_wrong_sign_is_named():
    """The advice for a stalled LCP(−L, q) of a Laplacian L names −M, which is solved."""
    L = gallery.obstacle_2d(size=8).problem.csr
    wrong = LCP(-L, -np.ones(L.shape[0]))
    advice = advice_of_run(wrong, "auto", Settings(), Status.STALLED)
    assert "every m_ii is negative: is −M meant" in advice
    assert solve(LCP(L, -np.ones(L.shape[0]))).is_solved


@pytest.mark.parametrize("algorithm", ["auto", "psor", "multigrid", "newton"])
def test_a_limited_run_goes_on_from_its_z(algorithm):
    """The advice "continue from z0=result.z" is correct, and a higher limit solves the problem."""
    problem = gallery.obstacle_2d(size=25).problem
    first = solve(problem, algorithm, max_iterations=1)
    assert first.status is Status.MAX_ITERATIONS
    assert "raise max_iterations" in first.advice
    assert "continue from z0=result.z" in first.advice
    assert ('algorithm="auto"' in first.advice) == (algorithm != "auto")
    whole, rest = solve(problem, algorithm), solve(problem, algorithm, z0=first.z)
    assert whole.is_solved
    assert rest.is_solved
    assert rest.iterations <= 1.1 * whole.iterations  # psor selects its relaxation again


@pytest.mark.parametrize("size", [3, 40], ids=["in one compiled call", "step by step"])
@pytest.mark.parametrize("algorithm", ["auto", "psor", "newton"])
def test_a_start_that_is_the_solution_is_named(size, algorithm):
    """If the start is the solution, explain() reports this, and otherwise not."""
    problem = gallery.obstacle_2d(size=size).problem
    answer = solve(problem, algorithm, tolerance=1e-10)
    again = solve(problem, algorithm, z0=answer.z)
    assert again.iterations == 0
    words = "the residual of the start is within the tolerance already"
    assert words in again.explain()
    assert "0 iterations" in again.explain()
    assert words not in answer.explain()


def test_an_equation_too_many_is_told_the_way_out():
    """Prices that sum to one, with all markets: drop a market, or add a multiplier."""
    p, scale = cp.Variable(2), cp.Variable()
    with pytest.raises(LCPError, match=r"sum\(p\) == 1, drop a market .* free multiplier"):
        cp.Problem(cp.Minimize(0), [complements(p >= 0, p - 0.5 >= 0), cp.sum(p) == 1]).solve(
            method="LCP"
        )
    problem = cp.Problem(
        cp.Minimize(0), [complements(p >= 0, p - 0.25 + scale >= 0), cp.sum(p) == 1]
    )
    problem.solve(method="LCP")
    assert problem.status == "optimal"
    np.testing.assert_allclose(p.value, [0.5, 0.5], atol=1e-8)
