"""Pieces of work that threads share: in order, whole, ended before anybody goes on, the same bits for any number."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest
from inputs import membranes

from lcp_plugin import LCP, InvalidOption, NonlinearProblem, prepare, solve
from lcp_plugin.algorithms import NPGS
from lcp_plugin.core.kernels.threads import share, threads_for, threads_now
from lcp_plugin.core.settings import checked_threads

TWO = LCP([[2.0, -1.0], [-1.0, 2.0]], [-1.0, 1.0])


def pieces(count: int, smallest: int) -> list[tuple[int, int]]:
    """What work is called with."""
    return share(lambda first, end: (first, end), count, smallest)


def test_an_error_waits_until_every_piece_has_ended():
    """Nobody is at work when the error of a piece that failed comes out; what follows is shared again."""
    together, ended = threading.Barrier(3, timeout=60.0), []

    def work(first, end):
        together.wait()
        if first < 2:
            raise ValueError(f"piece {first}")
        time.sleep(0.05)
        ended.append(first)

    with threads_for(3):
        with pytest.raises(ValueError, match=r"piece [01]"):
            share(work, 3, 1)
        assert ended == [2]
        assert pieces(3, 1) == [(0, 1), (1, 2), (2, 3)]


class Seen(NPGS):
    """Sweeps that note how many threads they may use."""

    counts: ClassVar[list[int]] = []

    def iterates(self, problem: Any, z0: Any) -> Any:
        self.counts.append(threads_now())
        yield from super().iterates(problem, z0)


def counted(run: Callable[..., Any], **options: Any) -> int:
    """How many threads a run may use."""
    Seen.counts.clear()
    run(Seen(), **options)
    return Seen.counts[0]


def in_solve(algorithm: Any, **options: Any) -> Any:
    return solve(TWO, algorithm, **options)


def in_a_nonlinear_solve(algorithm: Any, **options: Any) -> Any:
    problem = NonlinearProblem(lambda x: TWO.M @ x + TWO.q)
    return solve(problem, x0=[3.0, 3.0], algorithm=algorithm, **options)


@pytest.mark.parametrize("run", [in_solve, in_a_nonlinear_solve], ids=lambda run: run.__name__)
def test_a_solve_uses_the_stated_number_of_threads(run):
    """So many, all that may be used by default, and one again afterwards."""
    assert counted(run, threads=3) == 3
    assert counted(run) == checked_threads(None)
    assert threads_now() == 1


@pytest.mark.parametrize("wrong", [0, -1, 1.5, True, "2", np.nan])
def test_wrong_numbers_of_threads_are_refused(wrong):
    """By all who take them, with what was given and what is needed."""
    problem = NonlinearProblem(lambda x: x)
    for attempt in (
        lambda: solve(TWO, threads=wrong),
        lambda: prepare(TWO, threads=wrong),
        lambda: solve(problem, x0=[1.0], threads=wrong),
    ):
        with pytest.raises(InvalidOption, match=r"threads must be an integer ≥ 1, or None .* got"):
            attempt()


SCENES = [
    ("obstacle_2d", {"size": 400}, "multigrid"),
    ("convection_diffusion", {"size": 400}, "multigrid"),
    ("random_h_plus", {"n": 40_000}, "auto"),
]


@pytest.mark.full
@pytest.mark.parametrize(("name", "size", "algorithm"), SCENES)
def test_the_number_of_threads_changes_no_bit(name, size, algorithm):
    """“Results do not depend on the number of threads”: z, w, residuals and counts, with 1 to 4 threads of a solve."""
    told = []
    for threads in (1, 2, 3, 4):
        result = solve(membranes.build(name, **size).problem, algorithm, threads=threads)
        certificate = result.certificate
        numbers = (
            certificate.relative_residual,
            certificate.scaled_residual,
            certificate.euclidean_residual,
        )
        told.append(
            (
                result.z.tobytes(),
                result.w.tobytes(),
                numbers,
                result.status,
                result.iterations,
                result.work,
            )
        )
    assert told.count(told[0]) == 4
