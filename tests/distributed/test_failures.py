"""A rank that is killed ends the job, and Ctrl-C on one rank ends the run on all of them."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from launch import finish, start, wait_for

SECONDS = 20.0  # far more than an end takes, far less than a hang

# A run without end that leaves a note of each rank's process number once it iterates.
ENDLESS = """
import os
from pathlib import Path
from mpi4py import MPI
from lcp_plugin import LCP, gallery
rank = MPI.COMM_WORLD.rank
def note(sample, z):
    if sample.iteration == 3:
        Path({folder!r}, str(rank)).write_text(f"{{os.getpid()}}\\n")
whole = gallery.build("obstacle_2d", size=50).problem
own = slice(1250 * rank, 1250 * (rank + 1))
vectors = (one[own] for one in (whole.q, whole.lower, whole.upper))
problem = LCP.from_rows(MPI.COMM_WORLD, whole.csr[own], *vectors)
result = problem.solve("npj", tolerance=0.0, max_iterations=10**8, callback=note)
if rank == 0:
    print(result, flush=True)
"""


def endless(folder: Path) -> tuple[subprocess.Popen[str], list[int]]:
    """A run without end on two ranks, and the process numbers of its ranks."""
    job = start(2, "-c", ENDLESS.format(folder=str(folder)))
    return job, [int(wait_for(job, folder / str(rank))) for rank in range(2)]


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{process}/stat")
    return not state.exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"


def assert_gone(ranks: list[int]) -> None:
    until = time.monotonic() + SECONDS
    while any(map(alive, ranks)):
        assert time.monotonic() < until, "a rank outlived its job"
        time.sleep(0.05)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
def test_a_rank_that_is_killed_ends_the_job(tmp_path, number):
    """A rank killed from outside during a solve ends the job with a code that is not 0."""
    job, ranks = endless(tmp_path)
    os.kill(ranks[1], number)
    end = finish(job, SECONDS)
    assert end.returncode != 0
    assert_gone(ranks)


@pytest.mark.parametrize("rank", [0, 1])
def test_ctrl_c_on_one_rank_keeps_the_best(tmp_path, rank):
    """SIGINT on any one rank ends all of them INTERRUPTED, with the best point."""
    job, ranks = endless(tmp_path)
    os.kill(ranks[rank], signal.SIGINT)
    end = finish(job, SECONDS)
    assert end.returncode == 0, end.stderr
    assert end.stdout.count("INTERRUPTED") == 1
