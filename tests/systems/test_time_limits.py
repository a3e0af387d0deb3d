"""Work of other libraries cannot be divided: it is not begun where it would end too late, and Ctrl-C acts after it."""

from __future__ import annotations

import signal
import threading
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from lcp_plugin import LCP, EquilibriumProgram, QuadraticProgram, Status, gallery, solve
from lcp_plugin.core import deadline
from lcp_plugin.core.settings import Settings
from lcp_plugin.solving.direct import direct_methods
from lcp_plugin.systems import factors
from lcp_plugin.systems.hierarchy.levels import build_hierarchy


def random_graph(n: int) -> LCP:
    """A problem whose factor fills in."""
    random = np.random.default_rng(0)
    rows, columns = random.integers(0, n, (2, 4 * n))
    M = sp.csr_array(
        (random.standard_normal(4 * n), (rows, columns)), shape=(n, n)
    ) + 20.0 * sp.eye_array(n)
    return LCP(M, -random.random(n))


def no_factor(*_: Any, **__: Any) -> None:
    pytest.fail("a factorization that would take minutes")


@pytest.mark.parametrize("name", ["newton", "interior_point"])
def test_no_sparse_factorization_starts_that_would_end_after_the_limit(name, monkeypatch):
    """On a graph of 20 000 nodes with max_seconds=1 the run ends with MAX_SECONDS and a point, and no factor begins."""
    monkeypatch.setattr("scipy.sparse.linalg.splu", no_factor)
    monkeypatch.setattr("qdldl.Solver", no_factor)
    result = solve(random_graph(20_000), name, max_seconds=1.0)
    assert result.status is Status.MAX_SECONDS
    assert np.isfinite(result.z).all()


@pytest.mark.quick(1)
@pytest.mark.parametrize("factorize", [
    factors.cholesky, factors.dense_lu, lambda M: factors.factorize(sp.csr_array(M), bandwidth=(60, 4)),
])  # fmt: skip
def test_no_factorization_starts_that_would_end_after_the_limit(factorize):
    """Where no time is left every factorization says so; with time, or where the limit is not enforced, it is made."""
    M = np.eye(2000)
    with deadline.limit(1e-4, is_enforced=True), pytest.raises(deadline.OutOfTimeError):
        factorize(M)
    with deadline.limit(1e-4):
        assert factorize(M) is not None
    with deadline.limit(1000.0, is_enforced=True):
        assert factorize(M) is not None


def test_a_question_of_the_plan_that_does_not_fit_leaves_the_methods():
    """Whether M is semidefinite is asked for the order alone: if its factor would end too late, newton still comes."""
    random, n = np.random.default_rng(0), 300
    B = sp.random_array((n, n), density=0.01, rng=random, format="csr")
    M = sp.csr_array(B @ B.T + 0.1 * sp.eye_array(n) + 0.3 * (B - B.T))
    with deadline.limit(1e-6, is_enforced=True):
        names = [stage.algorithm.name for stage in direct_methods(LCP(M, np.ones(n)), 1e-8)]
    assert "newton" in names


def test_no_hierarchy_is_built_after_the_limit():
    """A limit that is over ends the set-up of multigrid between two grids, also on an easy matrix."""
    M = gallery.build("obstacle_2d", size=20).problem.csr
    with deadline.limit(-1.0, is_enforced=True), pytest.raises(deadline.OutOfTimeError):
        build_hierarchy(M)


@pytest.mark.full
def test_a_program_ends_where_its_factor_would_end_after_the_limit():
    """A dense program of 1 000 unknowns with max_seconds=.001 ends with MAX_SECONDS, and a point."""
    random = np.random.default_rng(0)
    n = 1000
    G = random.standard_normal((n, n))
    result = solve(
        QuadraticProgram(np.eye(n), random.standard_normal(n), G=G, h=np.ones(n)), max_seconds=1e-3
    )
    assert result.status is Status.MAX_SECONDS
    assert np.isfinite(result.x).all()


@pytest.mark.skipif(
    not hasattr(signal, "pthread_kill"), reason="no way to send Ctrl-C to one thread"
)
def test_ctrl_c_acts_after_the_factorization_under_way(monkeypatch):
    """SIGINT in the middle of a factorization gives INTERRUPTED, with the best iterate, after its end."""
    main, ended = threading.main_thread().ident, []
    assert main is not None

    def interrupted(*arguments, **options):
        factor = splu(*arguments, **options)
        ended.append(factor)
        # Python hears it after the call, whenever it comes
        signal.pthread_kill(main, signal.SIGINT)
        return factor

    monkeypatch.setattr("scipy.sparse.linalg.splu", interrupted)
    result = solve(random_graph(2000), "newton")
    assert ended
    assert result.status is Status.INTERRUPTED
    assert np.isfinite(result.z).all()


def test_a_nested_time_limit_does_not_extend_the_outer_one():
    """The smaller of two nested limits counts, also if the inner one is infinite; the outer one is restored."""
    with deadline.limit(0.0):
        for seconds in (100.0, np.inf):
            with deadline.limit(seconds):
                assert deadline.is_over()
        with deadline.limit(100.0, is_enforced=True):
            assert deadline.enforced_left() <= 0.0
    with deadline.limit(100.0):
        with deadline.limit(0.0):
            assert deadline.is_over()
        assert not deadline.is_over()


def test_infinite_seconds_are_no_limit():
    """``max_seconds=inf`` is the default, and a clock without a limit is never over."""
    assert Settings(max_seconds=np.inf) == Settings()
    clock = deadline.Clock()
    assert (clock.left, clock.is_over) == (np.inf, False)
    clock = deadline.Clock(0.0)
    assert (clock.left, clock.is_over) == (0.0, True)


def _unbounded() -> QuadraticProgram:
    """Return min cᵀx over G x ≤ 1 with 8 rows and 12 free unknowns, whose descents take several linear programs."""
    rows = np.random.default_rng(1).standard_normal((8, 12))
    return QuadraticProgram(None, np.random.default_rng(1000).standard_normal(12), rows, np.ones(8))


def _infeasible() -> QuadraticProgram:
    """Return x in 30 boxes with two rows that cannot both hold."""
    row = np.random.default_rng(2).standard_normal(30)
    return QuadraticProgram(None, np.ones(30), [row, -0.1 * row], [1.0, -0.2], lower=-5.0, upper=5)


def _singular() -> LCP:
    """Return M = J Jᵀ with more rows than columns and loads out of its range: infeasible within a radius."""
    J = np.random.default_rng(3).standard_normal((6, 3))
    return LCP(J @ J.T, np.arange(6.0), lower=-np.inf)


def _best() -> EquilibriumProgram:
    """Return an equilibrium program with three pieces that are unbounded below."""
    program = QuadraticProgram(None, [0, 0, 1.0], A=[[1, -1, 0]], b=[1], lower=-np.inf)
    return EquilibriumProgram(program, [0], [1], 0.0, np.inf)


@pytest.mark.quick(1)
@pytest.mark.parametrize("state", [_unbounded, _infeasible, _singular, _best])
def test_a_limited_call_changes_no_later_one(state, monkeypatch):
    """Whichever question to the clock is the first after the limit, the next call has the status of a new problem."""
    expected, real, asked, last = solve(state()), deadline._now, 0, 0

    def stop_after_last():
        nonlocal asked
        asked += 1
        return real() + (1e6 if asked > last else 0.0)

    def solve_within_limit(problem, questions):
        nonlocal asked, last
        asked, last = 0, questions
        with monkeypatch.context() as patch:
            patch.setattr(deadline, "_now", stop_after_last)
            solve(problem, max_seconds=1e5)

    solve_within_limit(state(), 10**9)
    for questions in range(2, asked, max(asked // 7, 1)):
        problem = state()
        solve_within_limit(problem, questions)
        again = solve(problem)
        assert (again.status, again.proof.verify()) == (expected.status, True)
