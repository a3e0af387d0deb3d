"""Stiff and extreme data: the solution is found if possible, else the status is correct."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.sparse as sp
from oracles.truth import ExactData

from lcp_plugin import (
    LCP,
    Certificate,
    Result,
    Status,
    UnsuitableMatrix,
    UnsuitableProblem,
    gallery,
    solve,
)
from lcp_plugin.algorithms import REGISTRY

ALL = ["auto", *REGISTRY]
EVERY_ALGORITHM = pytest.mark.parametrize("name", ALL)


# --- Honesty, in rational arithmetic -----------------------------------------------------------------------


def assert_honest(result: Result) -> None:
    """SOLVED and PRECISION_LIMIT hold in exact arithmetic; z is within the bounds, or NaN without a solution."""
    problem = result.certificate.problem
    if result.has_no_solution:
        assert np.isnan(result.z).all()
        return
    assert np.isfinite(result.z).all()
    assert np.array_equal(np.clip(result.z, problem.lower, problem.upper), result.z)
    if result.status is Status.SOLVED:
        assert not ExactData(problem).is_lie(result.z, result.tolerance)
    if result.status is Status.PRECISION_LIMIT:
        assert ExactData(problem).is_at_rounding_level(result.z)


# --- The edge of the number range --------------------------------------------------------------------------

TINY = np.array([[4.0, -1.0], [-1.0, 4.0]])


def edge_cases() -> dict[str, tuple[LCP, list[float] | None]]:
    """Return problems and starts at the edge of the number range; most of them cannot be solved."""
    huge, subnormal = 1e308, 5e-324
    return {
        "subnormal q": (LCP(TINY, [-1e-310, 1e-310]), None),
        "smallest q": (LCP(TINY, [-subnormal, subnormal]), None),
        "subnormal M": (LCP(TINY * 1e-310, [-1.0, 1.0]), None),
        "subnormal M and q": (LCP(TINY * 1e-310, [-1e-310, 1e-310]), None),
        "huge q": (LCP(TINY, [-huge / 10.0, huge / 10.0]), None),
        "largest q": (LCP(TINY, [-huge, huge]), None),
        "huge M": (LCP(TINY * 1e307, [-1.0, 1.0]), None),
        "huge M and q": (LCP(TINY * 1e307, [-huge, huge]), None),
        "slack overflows at the start": (LCP(TINY * 1e200, [-1.0, 1.0]), [1e200, 1e200]),
        "magnitude overflows at the start": (LCP([[1e10]], [-1.0]), [1e300]),
        "solution overflows": (LCP(np.eye(2) * 1e-200, [-1e200, 1.0]), None),
        "huge box": (LCP(TINY, [-1.0, 1.0], lower=-huge, upper=huge), [huge, -huge]),
        "tiny diagonal": (LCP([[1e-300, 1.0], [1.0, 1e-300]], [-1.0, -1.0]), None),
        "diverging": (LCP([[1.0, -9.0], [-9.0, 1.0]], [-1.0, -1.0]), None),
        "negative diagonal": (LCP([[-1.0, 0.0], [0.0, 1.0]], [-1.0, -1.0]), None),
        "zero matrix": (LCP(np.zeros((2, 2)), [-1.0, 1.0]), None),
    }  # fmt: skip


EDGES = edge_cases()


EXTREME = {"scaling": "diagonal", "scaling_factor": 2.0}
VARIANTS = [pytest.param(name, {}, id=name) for name in ALL] + [
    pytest.param(name, EXTREME, id=f"{name}-scaled") for name in ALL if name.startswith("np")
]
REFUSED = (
    "subnormal M",
    "subnormal M and q",
    "huge M",
    "huge M and q",
    "tiny diagonal",
    "diverging",
)
REFUSED += ("negative diagonal", "zero matrix", "huge box")


@pytest.mark.quick(9)
@pytest.mark.parametrize(("name", "options"), VARIANTS)
@pytest.mark.parametrize("case", EDGES)
def test_the_edge_of_the_number_range_is_never_silent(name, options, case):
    """Overflow and underflow give an error, a correct status or the right z, without NaN.

    A slack below the smallest normal number counts as 0.
    """
    problem, z0 = EDGES[case]
    try:
        result = solve(problem, name, z0=z0, max_iterations=500, **options)
    except (UnsuitableMatrix, UnsuitableProblem):
        assert case in REFUSED
        return
    if np.abs(problem.q).max() >= np.finfo(float).tiny:
        assert_honest(result)
    assert result.explain()
    if case in ("solution overflows", "diverging", "negative diagonal", "zero matrix"):
        assert result.status is not Status.SOLVED
    if case == "huge q":
        # In units of q, the exact solution is (1/4, 0).
        assert result.status is Status.SOLVED
        assert result.z / abs(problem.q[0]) == pytest.approx([0.25, 0.0], abs=1e-7)


# --- Tolerances --------------------------------------------------------------------------------------------


def inexact() -> LCP:
    """Return a problem whose solution is not representable in double precision."""
    scene = gallery.half_active(n=100)
    return LCP(scene.problem.csr / 3.0, scene.problem.q / 7.0)


@pytest.mark.quick(4)
@EVERY_ALGORITHM
def test_tolerance_zero_ends_at_the_rounding_level(name):
    """A run with tolerance 0 soon ends at PRECISION_LIMIT, or SOLVED at slacks of the rounding level."""
    problem = inexact()
    at_default = solve(problem, name)
    result = solve(problem, name, tolerance=0.0)
    assert result.status in (Status.PRECISION_LIMIT, Status.SOLVED)
    assert result.certificate.is_at_rounding_level
    assert result.iterations <= 4 * at_default.iterations + 100
    assert_honest(result)


# --- The automatic relaxation where a large one is a trap -------------------------------------------------------


@pytest.mark.parametrize("name", ["pj", "mj"])
def test_a_front_is_no_standstill(name):
    """If a front crosses 600 unknowns, one per sweep, the run is not called STALLED too early."""
    n = 600
    M = sp.diags_array([-np.ones(n - 1), np.ones(n)], offsets=[-1, 0])
    q = np.zeros(n)
    q[0] = -1.0
    assert solve(LCP(M, q), name).iterations == n


# --- Slacks beyond the number range -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
def test_a_slack_that_overflows_is_no_solution(name):
    """If partial sums of w overflow to +∞ although w is negative, the status is not SOLVED."""
    M = np.eye(5)
    # true slack of row 0 at z = (0, 1, 1, 1, 1): -1e308
    M[0] = [1e308, 1e308, 1e308, -1.5e308, -1.5e308]
    try:
        result = solve(LCP(sp.csr_array(M), [0.0, -1, -1, -1, -1]), name, max_iterations=300)
    except (UnsuitableMatrix, UnsuitableProblem):
        return
    assert_honest(result)


def test_nothing_is_measured_against_infinity():
    """If ‖r(z°)‖ itself overflows, the relative residual is NaN and no z is SOLVED."""
    problem = LCP(sp.csr_array([[0.1, 1e5], [0.0, 1.0]]), [-1e308, -1e303])
    assert math.isnan(Certificate.of(problem, [0.0, 1.7e303]).relative_residual)
    assert solve(problem, "pgs", z0=[0.0, 1.7e303], max_iterations=10).status is not Status.SOLVED


def test_rounding_as_large_as_the_problem_is_no_precision_limit():
    """A start of huge norm, whose residual is rounding error, gets no 'accept z' if infeasible."""
    result = solve(LCP([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0]), "pgs", z0=[1e17, 1e17])
    assert result.status not in (Status.SOLVED, Status.PRECISION_LIMIT)
