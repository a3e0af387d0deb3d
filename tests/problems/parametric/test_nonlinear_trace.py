"""Paths of nonlinear problems along one parameter: smooth segments, breakpoints, folds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import lambertw
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, NonlinearProblem, Status, trace


def cubic(**bounds):
    return NonlinearProblem(lambda x: x + x**3 + 1.0, lambda x: np.diag(1.0 + 3.0 * x**2), **bounds)


@pytest.mark.parametrize(("start", "stop"), [(0.0, 4.0), (4.0, 0.0)])
def test_a_root_within_bounds_has_its_breakpoints_and_slopes(start, stop):
    """The root of x + x³ + 1 = θ for 0 ≤ x ≤ 1, against scipy's roots; θ = 1 is a computed solution."""
    path = trace(cubic(lower=[0.0], upper=1.0), {"q": -1.0}, start, stop)
    assert path.status is Status.SOLVED
    np.testing.assert_allclose(
        path.breakpoints, sorted([start, 1.0, 3.0, stop], reverse=stop < 2), atol=1e-7
    )
    thetas = np.linspace(0.0, 4.0, 201)
    roots = [brentq(lambda x, t=t: x + x**3 + 1.0 - t, -2.0, 2.0, xtol=1e-14) for t in thetas]
    exact = np.clip(roots, 0.0, 1.0)
    np.testing.assert_allclose(path.x(thetas)[:, 0], exact, rtol=0, atol=1e-5)
    for theta, x in zip(thetas[1:-1:20], exact[1:-1:20], strict=True):
        point = path.at(theta)
        assert point.status is Status.SOLVED
        assert point.x[0] == pytest.approx(x, abs=1e-9)
        slope = 1.0 / (1.0 + 3.0 * x**2) if 0.0 < x < 1.0 else 0.0
        assert path.derivative(theta).x[0] == pytest.approx(slope, abs=1e-4)
    assert path.derivative(3.0, side="ahead").x[0] == pytest.approx(
        0.0 if stop > 2 else 0.25, abs=1e-6
    )


def test_an_affine_function_has_the_path_of_its_matrix():
    """Breakpoints and values equal the ones of the LCP, with a moving bound."""
    rng = np.random.default_rng(0)
    A, q, dq = rng.normal(size=(8, 8)), rng.normal(size=8), rng.normal(size=8)
    M, along = A @ A.T + np.eye(8), {"q": dq, "upper": 0.5}
    exact = trace(LCP(M, q, upper=1.0), along, 0.0, 3.0)
    path = trace(
        NonlinearProblem(lambda z: M @ z + q, lambda z: M, 0.0, np.ones(8)), along, 0.0, 3.0
    )
    assert len(exact) == 4
    np.testing.assert_allclose(path.breakpoints, exact.breakpoints, atol=1e-7)
    thetas = np.linspace(0.0, 3.0, 61)
    np.testing.assert_allclose(path.x(thetas), exact.x(thetas), rtol=0, atol=1e-7)
    np.testing.assert_allclose(path.at(1.5).w, exact.at(1.5).w, atol=1e-7)


def test_a_parameter_inside_of_the_function_moves_the_solution():
    """Each point of the path solves the complementarity problem of its formulas, and rows change sides on the way."""
    C = np.array([[3.0, -1.0, 0.0], [-1.0, 3.0, -1.0], [0.0, -1.0, 3.0]])

    def F(theta):
        return lambda x: (
            C @ x
            + np.exp(theta * x)
            - np.array([2.0, 2.0 - 2.0 * theta, 3.0 * np.sin(3.0 * theta)])
        )

    path = trace(
        NonlinearProblem(abs, lower=np.zeros(3)), lambda theta: NonlinearProblem(F(theta)), 0.0, 2.0
    )
    assert path.require_solved().reached == 2.0
    sides = set()
    for theta in np.linspace(0.0, 2.0, 41):
        x, near = path.at(theta).x, path.x(theta)[0]
        assert np.abs(x - np.maximum(x - F(theta)(x), 0.0)).max() < 1e-7
        np.testing.assert_allclose(near, x, atol=1e-5)
        sides.add(tuple(x > 0.0))
    assert len(sides) >= 3
    assert len(path) >= 3


def test_a_row_that_leaves_its_bound_briefly_is_seen_ahead():
    """The row x = max(0, 10⁻⁴ − (θ − ½)²) is positive from 0.49 to 0.51 only."""
    path = trace(
        NonlinearProblem(abs, lower=[0.0]),
        lambda theta: NonlinearProblem(lambda x: x - 1e-4 + (theta - 0.5) ** 2, lambda x: np.eye(1)), 0.0, 1.0,
    )  # fmt: skip
    np.testing.assert_allclose(path.breakpoints, [0.0, 0.49, 0.51, 1.0], atol=1e-6)
    assert path.x(0.5)[0, 0] == pytest.approx(1e-4, rel=1e-4)


def test_a_path_ends_at_a_fold_or_jumps_beyond():
    """The equation x = θ eˣ has solutions up to θ = 1/e: the path is −W(−θ), and jumps to a bound if there is one."""

    def at(theta):
        return NonlinearProblem(lambda x: x - theta * np.exp(x))

    path = trace(NonlinearProblem(abs, lower=[-np.inf]), at, 0.0, 0.4)
    assert path.status is Status.STALLED
    assert path.reached == pytest.approx(np.exp(-1.0), abs=1e-5)
    thetas = np.linspace(0.0, 0.36, 19)
    np.testing.assert_allclose(path.x(thetas)[:, 0], -lambertw(-thetas).real, atol=1e-5)
    assert "smooth in θ" in path.explain()
    assert "within a step, at most 1/32 of the way, may be missed" in path.explain()
    assert "it ends at 0.3678" in path.explain()
    jumping = trace(NonlinearProblem(abs, lower=[-np.inf], upper=5.0), at, 0.0, 1.0)
    assert jumping.jumps == [pytest.approx(np.exp(-1.0), abs=1e-4)]
    assert jumping.status is Status.SOLVED
    assert jumping.at(1.0).x[0] == 5.0


def test_a_picture_of_a_smooth_path_is_a_curve():
    """The line of an unknown has points between the breakpoints, on the path."""
    pytest.importorskip("matplotlib")
    path = trace(cubic(lower=[0.0], upper=1.0), {"q": -1.0}, 1.0, 3.0)
    theta, x = path.plot().lines[-1].get_data()
    assert theta.size > 20
    np.testing.assert_allclose(x + x**3 + 1.0, theta, atol=1e-5)


@refusals(r"""
trace(NonlinearProblem(abs), {"q": 1.0}, 0, 1) → InvalidOption: needs the number of unknowns; pass a bound as an array
trace(F, np.exp, 0, 1)
    → InvalidProblem: along\(0\) must be a NonlinearProblem, got float.*; return NonlinearProblem\(F\)
trace(F, {"M": 1.0}, 0, 1) → InvalidOption: 'M'.* is not a vector of NonlinearProblem.* q, lower, upper may move
trace(F, {"q": [1.0, 2.0]}, 0, 1) → q must
trace(F, 1.0, 0, 1) → InvalidOption: along must name data
trace(LCP([[1.0]], [0.0]), np.exp, 0, 1) → InvalidOption: along must name data
""")
def test_what_cannot_be_traced_is_refused(call, words):
    """Sizes, directions and functions that do not fit raise errors."""
    assert_refused(call, words, {"F": NonlinearProblem(lambda x: x, lower=[0.0])})


def test_no_way_to_go_has_no_pieces():
    """With start = stop a smooth path has no direction."""
    path = trace(cubic(lower=[0.0]), {"q": -1.0}, 2.0, 2.0)
    assert not path.pieces
    assert path.status is Status.STALLED
