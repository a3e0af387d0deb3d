"""What a forked child finds: every lock free, whoever held it in the parent, and nothing half done."""

from __future__ import annotations

import os
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lcp_plugin import LCP, analyze
from lcp_plugin.core.deadline import Lock
from lcp_plugin.core.kernels import compilation
from lcp_plugin.core.matrix.matrix import Matrix, fact

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="a fork beside threads is tried where it is common"
)

PATIENCE = 120.0  # seconds until a child counts as hanging


def exit_code_of_a_child(work: Callable[[], bool]) -> int | None:
    """Fork, let the child work, and return its exit code; None where it hangs, which ends it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of forks beside threads,
        warnings.simplefilter("ignore", RuntimeWarning)  # and JAX, where another test has loaded it
        child = os.fork()
    if child == 0:
        try:
            os._exit(0 if work() else 1)
        finally:
            os._exit(2)
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return None


class Busy:
    """A thread that enters something and stays there until it is let go."""

    def __init__(self, work: Callable[[Callable[[], Any]], Any]) -> None:
        self.inside, self.go_on = threading.Event(), threading.Event()
        self.thread = threading.Thread(target=work, args=(self._wait,))

    def _wait(self) -> str:
        self.inside.set()
        self.go_on.wait()
        return "computed"

    def __enter__(self) -> None:
        self.thread.start()
        self.inside.wait()

    def __exit__(self, *_: object) -> None:
        self.go_on.set()
        self.thread.join()


def test_a_fork_while_a_thread_computes_leaves_no_locked_cache() -> None:
    """A child forked while another thread fills the cache of a matrix computes for itself, from the beginning."""
    problem = LCP([[4.0, -1.0], [-1.0, 4.0]], [-3.0, 5.0])

    ways = []

    @fact
    def slow(matrix: Matrix) -> str:
        return str(ways.pop()())

    def works() -> bool:
        ways.append(lambda: "computed here")
        return slow(problem.matrix) == "computed here" and analyze(problem).is_h_plus is True

    def compute(wait: Callable[[], Any]) -> None:
        ways.append(wait)
        slow(problem.matrix)

    with Busy(compute):
        assert exit_code_of_a_child(works) == 0
    assert slow(problem.matrix) == "computed"


def test_a_fork_inside_what_is_computed_goes_on_there() -> None:
    """The thread that forks while it computes goes on computing, in parent and child alike."""
    problem = LCP(np.eye(2), np.ones(2))
    codes = []

    @fact
    def outer(matrix: Matrix) -> str:
        codes.append(exit_code_of_a_child(lambda: matrix.csc.nnz == 2))
        return "done"

    assert outer(problem.matrix) == "done"
    assert codes == [0]


@pytest.mark.parametrize("lock", [compilation._lock, Lock()], ids=["compilation", "any"])
def test_every_lock_of_ours_is_free_in_a_child(lock: Lock) -> None:
    """A lock held by another thread of the parent is free in a child and stays held in the parent."""

    def can_enter() -> bool:
        with lock.held():
            return True

    def hold(wait: Callable[[], Any]) -> None:
        with lock.held():
            wait()

    with Busy(hold):
        assert exit_code_of_a_child(can_enter) == 0
        taken = threading.Thread(target=can_enter, daemon=True)
        taken.start()
        taken.join(0.05)
        assert taken.is_alive()
    taken.join()
