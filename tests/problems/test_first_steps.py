"""The first step of a small problem: made once, whatever limits, starts or describes the solve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from inputs.small_families import spectrum

from lcp_plugin import LCP, BoundedLeastSquares, FrictionalContact, QuadraticProgram, prepare, solve
from lcp_plugin.engines import solvers
from lcp_plugin.methods import small
from lcp_plugin.problems.cones import solving as cones
from lcp_plugin.problems.least_squares import engines

pytestmark = pytest.mark.quick
RNG = np.random.default_rng(0)
A, B = RNG.random((60, 30)), RNG.random(60)
FIT = BoundedLeastSquares(A, B)
J, PUSH = RNG.normal(size=(15, 6)), RNG.normal(size=15)
W = J @ J.T + np.eye(15)
CONTACT = FrictionalContact(W, PUSH, 0.5, dimension=3)
TOUCHING = solve(CONTACT).z
ONE = spectrum(8, 1e2, 0.4, 0)
M, Q = np.array(ONE.M), np.array(ONE.q)
BLOCKS = np.kron(np.eye(2), M)
NEAR = solve(ONE).z
PROGRAM = QuadraticProgram(
    np.eye(4) + 1.0, [1.0, -2.0, 0.5, -1.0], np.arange(12.0).reshape(3, 4) % 5.0 - 2.0, np.ones(3)
)
TWO = QuadraticProgram(
    np.kron(np.eye(2), PROGRAM.P),
    np.tile(PROGRAM.c, 2),
    np.kron(np.eye(2), PROGRAM.G),
    np.tile(PROGRAM.h, 2),
)
OF_LCPS: dict[str, Callable[[], Any]] = {
    "a time limit": lambda: solve(ONE, max_seconds=60.0),
    "a start": lambda: solve(ONE, z0=np.ones(8)),
    "a solution as start": lambda: solve(ONE, z0=NEAR),
    "a default": lambda: solve(ONE, verbose=False),
    "an absolute tolerance": lambda: solve(ONE, absolute_tolerance=1e-12),
    "lists": lambda: solve(LCP(M.tolist(), Q.tolist())),
    "single precision": lambda: solve(LCP(M.astype(np.float32), Q.astype(np.float32))),
    "two components": lambda: solve(LCP(BLOCKS, np.r_[Q, -Q])),
    "a component that 0 solves": lambda: solve(LCP(BLOCKS, np.r_[Q, np.abs(Q)])),
    "0 as solution": lambda: solve(LCP(M, np.abs(Q))),
    "lemke, a time limit": lambda: solve(ONE, "lemke", max_seconds=60.0),
    "lemke, a start": lambda: solve(ONE, "lemke", z0=np.ones(8)),
    "lemke, two components": lambda: solve(LCP(BLOCKS, np.r_[Q, -Q]), "lemke"),
    "prepared, a time limit": lambda: prepare(ONE, max_seconds=60.0).solve(q=Q),
    "prepared, a start": lambda: prepare(ONE).solve(q=Q, z0=[1.0] * 8),
    "prepared, lists": lambda: prepare(ONE).solve(q=Q.tolist(), M=M.tolist(), lower=0),
    "prepared, two components": lambda: prepare(LCP(BLOCKS, np.r_[Q, -Q])).solve(),
}
OF_CONTACTS: dict[str, Callable[[], Any]] = {
    "a time limit": lambda: solve(CONTACT, max_seconds=60.0),
    "a start": lambda: solve(CONTACT, z0=np.ones(15)),
    "a start in the cones": lambda: solve(CONTACT, z0=TOUCHING),
    "a default": lambda: solve(CONTACT, verbose=False),
    "an absolute tolerance": lambda: solve(CONTACT, absolute_tolerance=1e-12),
    "lists": lambda: solve(FrictionalContact(W.tolist(), PUSH.tolist(), 0.5, dimension=3)),
    "prepared, a time limit": lambda: prepare(CONTACT, max_seconds=60.0).solve(b=PUSH),
    "prepared, a start": lambda: prepare(CONTACT).solve(b=PUSH.tolist(), z0=TOUCHING),
}
OF_FITS: dict[str, Callable[[], Any]] = {
    "a time limit": lambda: solve(FIT, max_seconds=60.0),
    "a start": lambda: solve(FIT, x0=np.ones(30)),
    "a default": lambda: solve(FIT, verbose=False),
    "lists": lambda: solve(BoundedLeastSquares(A.tolist(), B.tolist())),
    "prepared, a time limit": lambda: prepare(FIT, max_seconds=60.0).solve(b=B),
    "prepared, a start": lambda: prepare(FIT).solve(b=B.tolist(), x0=np.ones(30)),
}
OF_PROGRAMS: dict[str, Callable[[], Any]] = {
    "a time limit": lambda: solve(PROGRAM, max_seconds=60.0),
    "a default": lambda: solve(PROGRAM, verbose=False),
    "a start": lambda: solve(PROGRAM, z0=np.zeros(7)),
    "two components": lambda: solve(TWO),
    "prepared, a time limit": lambda: prepare(PROGRAM, max_seconds=60.0).solve(),
    "prepared, a start": lambda: prepare(PROGRAM).solve(c=PROGRAM.c, z0=np.zeros(7)),
    "prepared, lists": lambda: prepare(PROGRAM).solve(c=PROGRAM.c.tolist(), lower=-50),
    "prepared, matrices": lambda: prepare(PROGRAM).solve(P=PROGRAM.P, G=PROGRAM.G.tolist()),
    "prepared, two components": lambda: prepare(TWO).solve(c=TWO.c),
}
RUNS = {  # what a run begins with, calls without one, and what their results are
    "lcp_plugin.solving.lcp_run.LCPRun.__init__": (OF_LCPS, lambda one: one.residual <= 1e-8),
    "lcp_plugin.problems.cones.solving.ConeRun": (OF_CONTACTS, lambda one: one.residual <= 1e-8),
    "lcp_plugin.problems.least_squares.solving.LeastSquaresRun": (
        OF_FITS,
        lambda one: np.array_equal(one.x, solve(FIT).x),
    ),
    "lcp_plugin.problems.programs.solving.ProgramRun": (
        OF_PROGRAMS,
        lambda one: np.allclose(one.x[:4], solve(PROGRAM).x, atol=1e-9),
    ),
}
CALLS = [
    pytest.param(run, call, is_right, id=f"{run.split('.')[2]}, {name}")
    for run, (calls, is_right) in RUNS.items()
    for name, call in calls.items()
]


@pytest.mark.parametrize(("run", "call", "is_right"), CALLS)
def test_a_small_problem_is_solved_without_a_run(run, call, is_right, monkeypatch):
    """Limits, starts, components, matrices and other forms of the data lead to no run, and to the same solution."""
    monkeypatch.setattr(run, lambda *_, **__: pytest.fail("a run"))
    assert is_right(call().require_solved())


@pytest.mark.parametrize("is_prepared", [False, True])
def test_active_bounds_of_a_program_lead_to_no_run(is_prepared, monkeypatch):
    """Where the minimum x* is at a bound, the slope of the objective points out of the box; else it is 0."""
    run = "lcp_plugin.problems.programs.solving.ProgramRun"
    monkeypatch.setattr(run, lambda *_, **__: pytest.fail("a run"))
    rng = np.random.default_rng(0)
    for n in range(1, 6):
        best, factor = rng.choice([-0.5, 0.1, 0.5], n), rng.normal(size=(n + 1, n))
        P, slope = factor.T @ factor, -np.sign(best) * (np.abs(best) == 0.5)
        program = QuadraticProgram(P, slope - P @ best, lower=-0.5, upper=0.5)
        result = prepare(program).solve(c=program.c) if is_prepared else solve(program)
        assert result.iterations == solve(program).iterations  # the engine's, prepared or not
        np.testing.assert_allclose(result.require_solved().x, best, atol=1e-6)


def test_a_start_that_passes_is_returned():
    """It takes no iteration; recorded or not, a start of a fit that fails leads to the solution by nnls."""
    for algorithm in ("auto", "lemke"):
        again = solve(ONE, algorithm, z0=NEAR)
        assert again.iterations == 0
        assert np.array_equal(again.z, NEAR)
    assert prepare(ONE).solve(z0=NEAR).iterations == 0
    best = solve(FIT).x
    near = best * (1.0 + 1e-12)
    again = solve(FIT, x0=near)
    assert (again.algorithm, again.iterations, again.is_solved) == ("start", 0, True)
    assert np.array_equal(again.x, near)
    for how in ({}, {"record": True}):
        assert np.array_equal(solve(FIT, x0=np.ones(30), **how).x, best)


@pytest.fixture
def counted(monkeypatch):
    """Count the calls of a function of a module."""

    def count(module, name):
        calls, function = [], getattr(module, name)
        monkeypatch.setattr(module, name, lambda *data: calls.append(1) or function(*data))
        return calls

    return count


@pytest.mark.parametrize("how", [{}, {"record": True}, {"callback": lambda *_: None}])
def test_a_run_of_an_lcp_guesses_once(how, counted):
    """It takes the first points that solve nothing; what watches a run changes no bits."""
    calls, rng = counted(small, "guess"), np.random.default_rng(0)
    for _ in range(8):
        problem = LCP(rng.normal(size=(8, 8)), rng.normal(size=8))
        plain = solve(problem, prove_infeasibility=False, max_iterations=20)
        calls.clear()
        found = solve(problem, prove_infeasibility=False, max_iterations=20, **how)
        assert len(calls) == 1
        assert found.status is plain.status
        assert np.array_equal(found.z, plain.z)


@pytest.mark.parametrize("is_prepared", [False, True])
def test_first_sweeps_of_contacts_are_made_once(is_prepared, counted):
    """A run takes the sweeps that find no solution of a problem with one component."""
    calls, rng = counted(cones, "sweep_contacts"), np.random.default_rng(1)
    for _ in range(20):
        J, mu = rng.normal(size=(12, 6)), 2.0 * rng.random(4)
        problem = FrictionalContact(J @ J.T, rng.normal(size=12), mu, dimension=3)
        calls.clear()
        prepare(problem).solve() if is_prepared else solve(problem)
        assert len(calls) == 1


def test_nnls_and_daqp_are_called_once(counted):
    """A run takes the point that does not pass, and the end of daqp on a program that it does not solve."""
    calls = counted(engines, "nnls_point")
    A = np.c_[np.ones(30), np.arange(2000.0, 2030.0), np.arange(2000.0, 2030.0) ** 2]
    solve(BoundedLeastSquares(A, np.sin(A[:, 1]), lower=[0.0, 0.0, 0.0]), tolerance=0.0)
    assert len(calls) == 1
    calls = counted(solvers, "call_daqp")
    solve(QuadraticProgram(PROGRAM.P, PROGRAM.c, PROGRAM.G, PROGRAM.h - 1e12))
    G = np.vstack([PROGRAM.G, -PROGRAM.G[:1]])
    solve(QuadraticProgram(PROGRAM.P, PROGRAM.c, G, np.append(PROGRAM.h, -2.0)))
    assert len(calls) == 2
