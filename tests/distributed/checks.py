"""Named checks that run in one MPI job on 1, 2, … ranks of it; what pytest reads of them afterwards."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from launch import finish, start

RANKS = 4
PATIENCE = 5.0  # seconds that a rank which failed waits for the others to end the check
HERE = Path(__file__).parent
Check = Callable[[Any], None]
_checks: dict[str, tuple[Check, tuple[int, ...]]] = {}


def check(*sizes: int) -> Callable[[Check], Check]:
    """Register a check, a function of a communicator, to run on each of these numbers of ranks."""

    def register(function: Check) -> Check:
        _checks[function.__name__] = (function, sizes)
        return function

    return register


def run_checks() -> None:
    """Run all registered checks on parts of this job; rank 0 prints a line of JSON for each."""
    from mpi4py import MPI
    from petsc4py import PETSc  # noqa: F401 - PETSc begins on all ranks of a job at once

    world = MPI.COMM_WORLD
    parts = {size: world.Split(int(world.rank >= size)) for size in range(1, world.size + 1)}
    for name, (function, sizes) in _checks.items():
        for size in sizes:
            begun, failure = time.perf_counter(), ""
            if world.rank < size:
                try:
                    function(parts[size])
                except Exception:
                    failure = traceback.format_exc()
            if not _met(
                world.Ibarrier(), PATIENCE if failure else None
            ):  # the others wait for this rank in the check
                _say(f"{name}-{size}", [f"rank {world.rank}: {failure}"], begun)
                world.Abort(1)
            failures = [
                f"rank {rank}: {one}" for rank, one in enumerate(world.allgather(failure)) if one
            ]
            if world.rank == 0:
                _say(f"{name}-{size}", failures, begun)


def _say(identity: str, failures: list[str], begun: float) -> None:
    line = {"id": identity, "failures": failures, "seconds": time.perf_counter() - begun}
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def _met(request: Any, patience: float | None) -> bool:
    """Wait without work, as the ranks that a check needs share the processors with those it does not need."""
    begun = time.perf_counter()
    while not request.Test():
        if patience is not None and time.perf_counter() - begun > patience:
            return False
        time.sleep(0.005)
    return True


def identities(script: str) -> list[str]:
    """Return the checks of a script, "name-ranks", without importing what only runs under MPI."""
    tree = ast.parse((HERE / script).read_text(encoding="utf-8"))
    return [
        f"{node.name}-{size.value}"
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        for mark in node.decorator_list
        if isinstance(mark, ast.Call) and getattr(mark.func, "id", "") == "check"
        for size in mark.args
    ]


@cache
def _outcome(script: str, seconds: float) -> tuple[dict[str, list[str]], str]:
    job = start(RANKS, "-W", "error::RuntimeWarning", str(HERE / script))
    try:
        done = finish(job, seconds)
        out, err = done.stdout, done.stderr
    except subprocess.TimeoutExpired as error:
        out, err = str(error.stdout or ""), f"no end within {seconds} s\n{error.stderr or ''}"
    lines = [json.loads(line) for line in out.splitlines() if line.startswith('{"id"')]
    return {line["id"]: line["failures"] for line in lines}, err


def require_passed(script: str, identity: str, seconds: float = 120.0) -> None:
    """Fail unless that check of the script passed on all ranks."""
    outcome, err = _outcome(script, seconds)
    assert identity in outcome, (
        f"{identity} did not end; the last that did: {list(outcome)[-1:]}\n{err[-3000:]}"
    )
    assert not outcome[identity], "\n".join(outcome[identity])
