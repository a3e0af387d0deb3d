"""What the first solve of an installation costs, in a fresh process with an empty cache; and the warm-up of everything.

Each is compared with compiling two small kernels by plain numba, a fresh process before it and one after it: a slow or
a busy machine is slow for these, too.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from . import first_solves

# At most so many times as long as the two kernels.
TARGETS = {
    "ten": 6,
    "string": 6,
    "grid": 12,
    "model": 9,
    "program": 8,
    "least squares": 7,
    "nonlinear": 9,
    "game": 5,
    "contact": 4,
    "pile": 4,
    "warm-up": 40,
}
WHAT = {
    "ten": "dense, n = 10",
    "string": "string, 200 nodes",
    "grid": "obstacle, 200 × 200",
    "model": "model in cvxpy",
    "program": "program in cvxpy",
    "least squares": "least squares",
    "nonlinear": "nonlinear",
    "game": "bimatrix game",
    "contact": "one contact",
    "pile": "bodies, with a start",
    "warm-up": "warm-up",
}


@dataclass(frozen=True)
class _Cost:
    """Seconds on the clock and of the processors, and how many functions numba compiled in the process."""

    seconds: float
    processor: float
    compilations: int


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a first solve: seconds, processor seconds, compilations, and both times over those of two kernels.

    The quick form solves one problem, with the kernels that are there.
    """
    yield f"{'first solve':<22}{'clock':>9}{'processors':>12}{'compiled':>10}   ÷ two kernels: clock, processors"
    yield from (_line(name, is_empty=not quick) for name in (["ten"] if quick else TARGETS))


def _line(name: str, *, is_empty: bool) -> str:
    before = _reference()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        cost = _measured(name, folder if is_empty else None)
    after = _reference()
    clock = 2.0 * cost.seconds / (before.seconds + after.seconds)
    processor = 2.0 * cost.processor / (before.processor + after.processor)
    return (
        f"{WHAT[name]:<22}{cost.seconds:>7.1f} s{cost.processor:>10.1f} s{cost.compilations:>10}"
        f"   {clock:>21.1f}, {processor:.1f}   target ≤ {TARGETS[name]}"
    )


def _reference() -> _Cost:
    """Return what compiling the two kernels costs, without the start of the process and the imports."""
    found = _run("reference", None)
    return _Cost(found["seconds"], found["processor"], 2)


def _measured(name: str, cache_folder: str | None) -> _Cost:
    began, children = time.perf_counter(), sum(os.times()[2:4])
    if name == "warm-up":  # in several processes: what is kept is counted
        _output_of([sys.executable, "-m", "lcp_plugin", name], cache_folder)
        kept = len(list(Path(cache_folder or "").rglob("*.nbc")))
        return _Cost(time.perf_counter() - began, sum(os.times()[2:4]) - children, kept)
    found = _run(name, cache_folder)
    return _Cost(time.perf_counter() - began, found["processor"], int(found["compilations"]))


def _run(name: str, cache_folder: str | None) -> dict[str, float]:
    """Return what :mod:`first_solves` prints in a fresh process."""
    output = _output_of([sys.executable, first_solves.__file__, name], cache_folder)
    return dict(json.loads(output.splitlines()[-1]))


def _output_of(command: list[str], cache_folder: str | None) -> str:
    """Return what a fresh process prints, with kernels in that folder or where they are."""
    paths = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    if cache_folder is not None:
        environment["NUMBA_CACHE_DIR"] = cache_folder
    return subprocess.run(
        command, env=environment, stdout=subprocess.PIPE, text=True, check=True
    ).stdout
