"""Whatever ends one rank ends the job: within seconds, with a message, with an exit code that is not 0."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from launch import finish, run_code, start, wait_for

SECONDS = 20.0  # far more than an end takes, far less than a hang

FAIL = """
import sys, time
from mpi4py import MPI
from lcp_plugin.ranks.collective import ends_together
from lcp_plugin.core.errors import InvalidOption
rank = MPI.COMM_WORLD.rank
with ends_together():
    {body}
print("went on", flush=True)
"""

# A run without end that leaves a note of each rank's process number once it iterates.
ENDLESS = """
import os
from pathlib import Path
from mpi4py import MPI
from lcp_plugin import gallery
from lcp_plugin.ranks.collective import ends_together
from lcp_plugin.ranks.problem import RowsOnRanks
rank = MPI.COMM_WORLD.rank
def note(sample, z):
    if sample.iteration == 3:
        Path({folder!r}, str(rank)).write_text(f"{{os.getpid()}}\\n")
with ends_together():
    problem = RowsOnRanks.from_problem(gallery.build("obstacle_2d", size=50).problem)
    result = problem.solve("npj", tolerance=0.0, max_iterations=10**8, callback=note)
if rank == 0:
    print(result, flush=True)
"""


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("rank == 1 and {}['key']; MPI.COMM_WORLD.Barrier()", "rank 1 of 3: KeyError: 'key'"),
        (
            "if rank == 2: raise MemoryError('3 GB')\n    MPI.COMM_WORLD.Barrier()",
            "rank 2 of 3: not enough memory",
        ),
        (
            "if rank == 0: raise InvalidOption('mine alone')\n    MPI.COMM_WORLD.Barrier()",
            "rank 0 of 3: mine alone",
        ),
        ("if rank == 1: raise InvalidOption('at the end')", "rank 1 of 3: at the end"),
        (
            "if rank == 1: raise KeyboardInterrupt\n    MPI.COMM_WORLD.Barrier()",
            "rank 1 of 3: interrupted",
        ),
        (
            "if rank == 1: sys.exit(7)\n    MPI.COMM_WORLD.Barrier()",
            "rank 1 of 3: left alone, by sys.exit(7)",
        ),
    ],
    ids=["bug", "memory", "refusal", "refusal at the end", "interrupt", "exit"],
)
def test_an_exception_on_one_rank_ends_all(body: str, message: str) -> None:
    """An exception on one rank alone names the rank in one message and ends the ranks that wait for it."""
    end = run_code(3, FAIL.format(body=body), timeout=60)
    assert end.returncode not in (0, None)
    assert end.stderr.count(message) == 1
    assert "went on" not in end.stdout


def test_a_refusal_on_all_ranks_can_be_caught() -> None:
    """An LCPError that all ranks raise leaves the block on all of them, and they go on."""
    body = "pass\ntry:\n    with ends_together():\n        raise InvalidOption('all')\nexcept InvalidOption:\n    pass"
    end = run_code(3, FAIL.format(body=body), timeout=60)
    assert end.returncode == 0, end.stderr
    assert end.stdout.count("went on") == 3


def test_a_block_that_ends_well_is_no_hindrance() -> None:
    """Ranks that end at different times all go on."""
    end = run_code(3, FAIL.format(body="time.sleep(0.3 * rank)"), timeout=60)
    assert end.returncode == 0, end.stderr
    assert end.stdout.count("went on") == 3


def test_one_rank_passes_exceptions_on() -> None:
    """On one rank the block changes nothing about an exception."""
    end = run_code(1, FAIL.format(body="raise KeyError('mine')"), timeout=60)
    assert end.returncode == 1
    assert "KeyError: 'mine'" in end.stderr
    assert "all ranks end" not in end.stderr


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
def test_a_rank_that_is_killed_ends_the_job(tmp_path: Path, number: signal.Signals) -> None:
    """A rank killed from outside during a solve ends the job with a code that is not 0."""
    job, ranks = endless(tmp_path)
    os.kill(ranks[1], number)
    end = finish(job, SECONDS)
    assert end.returncode != 0
    assert_gone(ranks)


@pytest.mark.parametrize("rank", [0, 1])
def test_ctrl_c_on_one_rank_keeps_the_best(tmp_path: Path, rank: int) -> None:
    """SIGINT on any one rank ends all of them INTERRUPTED, with the best point."""
    job, ranks = endless(tmp_path)
    os.kill(ranks[rank], signal.SIGINT)
    end = finish(job, SECONDS)
    assert end.returncode == 0, end.stderr
    assert end.stdout.count("INTERRUPTED") == 1
