"""Compiled kernels lie in the user's cache folder, and one command compiles them all."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tools.processes import lcp_plugin

COUNT_COMPILED = """
import sys
import numpy as np
from lcp_plugin import FrictionalContact, LCP, QuadraticProgram, gallery
from lcp_plugin import derivative, error_bound, march, solve, solve_batch
from numba.core.dispatcher import Dispatcher

game = LCP.from_game([[2, 0], [0, 1]], [[1, 0], [0, 2]])
for name in ("obstacle_2d:size=30", "half_active:n=25", "game"):
    problem = game if name == "game" else gallery.parse(name).problem
    for algorithm in ("auto", "npsor", "multigrid") if name.startswith("obstacle") else ("auto",):
        result = solve(problem, algorithm)
        if name.startswith("half"):
            error_bound(problem, result.z)
found = derivative(solve_batch([[[2.0, 1.0], [1.0, 2.0]]], [-5.0, 1.0]))
found.vjp([[1.0, 1.0]]), found.jvp(dq=[1.0, 0.0])
solve_batch([QuadraticProgram([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0], lower=0.0)])
solve(FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5))
march(LCP(2.0 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1), np.ones(40)), np.zeros((2, 40)))
kernels = [
    kernel for name, module in list(sys.modules.items()) if name.startswith("lcp_plugin")
    for kernel in vars(module).values() if isinstance(kernel, Dispatcher) and kernel.stats.cache_path
]
print(len(kernels) > 10, sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels))
"""


USED = """
from numpy import int64
from lcp_plugin.core.kernels.compilation import helper
SIZE = {0}
@helper
def scaled(x): return {1} * x
"""
USING = """
from used_constants import SIZE, scaled
from lcp_plugin.core.kernels.compilation import kernel
@kernel
def total(x): return SIZE + scaled(x)
"""


def test_a_kernel_is_compiled_again_after_a_change_in_another_file(tmp_path, monkeypatch):
    """A constant and a helper of another file are part of the key of the cache."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "using_kernels.py").write_text(USING)
    # texts of different lengths: Python itself keeps a file of equal length written in the same second
    sizes = {"1.0": 1.0, "10.0": 10.0, "int64(20)": 20.0, "int64(300)": 300.0}
    for size, factor in (*((one, "2.0") for one in sizes), ("10.0", "200.0")):
        (tmp_path / "used_constants.py").write_text(USED.format(size, factor))
        importlib.invalidate_caches()
        for name in ("used_constants", "using_kernels"):
            sys.modules.pop(name, None)
        value = importlib.import_module("using_kernels").total(3.0)
        assert value == sizes[size] + 3.0 * float(factor)


def in_a_new_process(code: str, folder: Path | None = None, **environment: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env=os.environ | environment,
    )
    return run.stdout.strip()


@pytest.mark.full
def test_nothing_is_compiled_after_a_warm_up():
    """After `lcp-plugin warm-up` a fresh process finds every kernel it needs in the cache."""
    run = lcp_plugin("warm-up")
    assert run.exit_code == 0
    assert in_a_new_process(COUNT_COMPILED) == "True 0"


@pytest.mark.full
def test_the_clock_of_a_first_run_shows_no_compilation():
    """In a fresh process the loading of compiled code is recorded, and what is recorded is on no clock."""
    code = (
        "import time\nfrom lcp_plugin import gallery, solve\nfrom lcp_plugin.core.deadline import compilation\n"
        "problem, began = gallery.parse('half_active:n=25').problem, time.perf_counter()\n"
        "result = solve(problem, 'mgs')\nwhole, loading = time.perf_counter() - began, compilation().seconds\n"
        "print(result.is_solved, loading > 0.0, result.seconds <= whole - loading)"
    )
    assert in_a_new_process(code) == "True True True"
