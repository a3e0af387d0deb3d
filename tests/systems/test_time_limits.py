"""Limits and Ctrl-C are obeyed inside work of other libraries that cannot be divided into steps."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import lapack

from lcp_plugin import LCP, Status, solve
from lcp_plugin.core.deadline import OutOfTimeError, time_limit
from lcp_plugin.systems import factors
from lcp_plugin.systems import interruptible as waiting
from lcp_plugin.systems.interruptible import interruptible
from lcp_plugin.systems.lapack import dgbtrf, dpotrf

LONG = 120.0  # seconds that a factorisation takes unless it is told to end


class SlowFactor:
    """Every sparse factor takes that long, without the interpreter's lock as SuperLU's: no clock is compared."""

    def __init__(self, monkeypatch, at_work=lambda: None):
        self.may_end, self.has_ended, self.at_work = threading.Event(), False, at_work
        monkeypatch.setattr("scipy.sparse.linalg.splu", self.splu)

    def splu(self, *_, **__):
        self.at_work()
        self.may_end.wait(LONG)
        self.has_ended = True
        raise RuntimeError("the factor is exactly singular")


def large_sparse(n=20_000):
    """Return a problem whose factor fills in: a random graph."""
    random = np.random.default_rng(0)
    rows, columns = random.integers(0, n, (2, 4 * n))
    M = sp.csr_array((random.standard_normal(4 * n), (rows, columns)), shape=(n, n)) + 20.0 * sp.eye_array(n)
    return LCP(M, -random.random(n))


def test_a_limit_of_one_second_ends_a_run_inside_a_factorisation_of_many(monkeypatch):
    """max_seconds=1 on a sparse problem of 20 000 rows gives MAX_SECONDS and the best iterate, within one."""
    factor, problem = SlowFactor(monkeypatch), large_sparse()
    result = solve(problem, "newton", max_seconds=1.0)
    assert not factor.has_ended
    assert result.status is Status.MAX_SECONDS
    assert np.isfinite(result.z).all()
    factor.may_end.set()


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no way to send Ctrl-C to one thread")
def test_ctrl_c_ends_a_run_inside_a_long_factorisation(monkeypatch):
    """SIGINT in the middle of a factorisation gives INTERRUPTED, with the best iterate, before its end."""
    main = threading.main_thread().ident
    factor = SlowFactor(monkeypatch, at_work=lambda: signal.pthread_kill(main, signal.SIGINT))
    result = solve(large_sparse(), "newton")
    assert not factor.has_ended
    assert result.status is Status.INTERRUPTED
    factor.may_end.set()


def test_interruptible_work_returns_raises_and_is_left_behind():
    """What a call returns or raises comes through; an enforced limit leaves it behind, another one waits for it."""
    assert interruptible(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)
    with time_limit(0.05, is_enforced=True), pytest.raises(OutOfTimeError):
        interruptible(lambda: time.sleep(0.5))
    with time_limit(0.05):
        assert interruptible(lambda: time.sleep(0.2)) is None


def test_no_thread_is_begun_for_short_factorisations(monkeypatch):
    """Small factors, and long narrow ones, are made where they are asked for."""
    monkeypatch.setattr(factors, "interruptible", lambda call: pytest.fail("a thread for a short factorisation"))
    band = sp.diags_array([-1.0, 2.5, -1.0], offsets=[-1, 0, 1], shape=(5000, 5000), format="csr")
    assert factors.factorise(band, bandwidth=None) is not None
    assert factors.factorise(np.eye(300)) is not None


@pytest.mark.parametrize("n", [1, 7, 200])
def test_lapack_without_the_lock_is_lapack(n):
    """Both functions give the bits that scipy's give, and change what they are given only where they may."""
    random = np.random.default_rng(n)
    A = random.standard_normal((n, n))
    A = A @ A.T + n * np.eye(n)
    before, expected = A.copy(), lapack.dpotrf(A.T, lower=1, clean=0)
    for overwrite in (False, True):
        found = dpotrf(A.T, overwrite=overwrite)
        assert found[1] == expected[1] == 0
        assert np.array_equal(found[0], expected[0])
        assert np.array_equal(A, before) != overwrite
    assert dpotrf(-before.T)[1] == lapack.dpotrf(-before.T, lower=1)[1] == 1
    band = np.asfortranarray(random.standard_normal((6, n)))
    for found, expected in zip(dgbtrf(band.copy(order="F"), 2, 1), lapack.dgbtrf(band, 2, 1), strict=True):
        assert np.array_equal(found, expected)


@pytest.mark.parametrize("fails", [True, False], ids=["refused", "never begins"])
def test_without_another_thread_the_call_is_made_here(fails: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no thread can begin, or one finds no memory before its first line, the call is made here, once."""
    made = []

    def start(*_: object) -> None:
        if fails:
            raise RuntimeError("can't start new thread")

    monkeypatch.setattr(waiting._thread, "start_new_thread", start)
    gc.collect()  # factors of other tests are dropped now, not in between
    left_by_other_tests = set(waiting._under_way)
    assert interruptible(lambda: made.append(threading.get_ident()) or 7) == 7
    assert made == [threading.get_ident()]
    assert waiting._under_way <= left_by_other_tests


def resident():
    """Return the bytes of memory that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is told by /proc")
def test_memory_of_long_factorisations_is_given_back():
    """SuperLU's factor is dropped in the thread that made it: elsewhere scipy keeps its memory for ever."""
    matrix = sp.csc_array(np.random.default_rng(1).standard_normal((600, 600)) + 30.0 * np.eye(600))
    right = np.ones(600)

    def factorise():
        factor = factors.sparse_lu(matrix)
        assert np.allclose(matrix @ factor.solve(right), right)
        assert factor.nnz >= 600**2
        return factor

    assert isinstance(factorise(), waiting.Kept)
    before = resident()
    for _ in range(40):  # of 4 MB each
        factorise()
    assert resident() - before < 60e6


def test_a_factor_that_is_kept_to_the_end_disturbs_no_end():
    """The process ends in silence while a factor of another thread is alive."""
    code = (
        "import numpy as np, scipy.sparse as sp\n"
        "from lcp_plugin.systems.factors import sparse_lu\n"
        "factor = sparse_lu(sp.csc_array(np.random.default_rng(1).standard_normal((600, 600))))\n"
        "print(factor.shape, type(factor).__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "(600, 600) Kept\n", "")
