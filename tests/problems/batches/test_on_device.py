"""Batches in arrays on a GPU, without a GPU; with one, run ``python .ci/on_a_gpu.py``."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tools import strict_cupy

from lcp_plugin import InvalidOption, InvalidProblem, UnsuitableProblem, solve_batch


@pytest.mark.full
def test_on_a_gpu_simulated_kernels_give_results_of_cpu():
    """The checks of .ci/on_a_gpu.py pass with numba's simulator and arrays that do not mix with numpy's."""
    script = Path(__file__).parents[3] / ".ci" / "on_a_gpu.py"
    command = [sys.executable, "-W", "ignore", str(script), "--simulated"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "n = 6: 12 of 12 on the GPU" in found.stdout, found.stderr


@pytest.mark.parametrize(
    ("change", "options", "error", "words"),
    [
        ({"q": np.ones(2)}, {}, InvalidProblem, "q must be an array on the GPU"),
        ({"q": np.ones(3)}, {}, InvalidProblem, r"M must have shape .* q \(3,\)"),
        ({"M": np.eye(71), "q": np.ones(71)}, {}, UnsuitableProblem, "got n = 71; copy"),
        ({}, {"z0": np.ones(2)}, InvalidOption, "take no z0"),
        ({}, {"algorithm": "lemke"}, InvalidOption, "or algorithm"),
    ],
)
def test_solve_batch_on_a_gpu_refuses(monkeypatch, change, options, error, words):
    """Arrays of two memories, wrong shapes, large problems and options of the host raise an error with advice."""
    xp = strict_cupy.module()
    monkeypatch.setitem(sys.modules, "cupy", xp)
    data = {"M": np.eye(2), "q": np.ones(2), **change}
    given = {name: xp.asarray(one) for name, one in data.items()}
    if words.startswith("q must"):
        given["q"] = data["q"]
    with pytest.raises(error, match=words):
        solve_batch(given["M"], given["q"], **options)


def test_solve_batch_on_a_gpu_without_cupy_names_what_to_install(monkeypatch):
    """Without CuPy the message contains the command that installs it, also for CUDA 12."""
    monkeypatch.setitem(sys.modules, "cupy", None)
    array = strict_cupy.module().asarray(np.eye(2))
    with pytest.raises(ImportError, match=r"pip install 'numba-cuda\[cu13\]' .* cupy-cuda12x"):
        solve_batch(array, array[0])
