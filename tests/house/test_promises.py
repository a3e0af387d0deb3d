"""The manual's "Guarantees", line by line: each test quotes the guarantee that it checks."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import scipy.sparse as sp
from inputs import membranes
from inputs.families import BOUNDED
from inputs.scripted import TWO, Scripted
from oracles.relations import bits, data_of, surroundings

from lcp_plugin import (
    LCP,
    Certificate,
    Status,
    UnsuitableMatrix,
    UnsuitableProblem,
    analyze,
    convergence_guarantee,
    error_bound,
    gallery,
    solve,
    solve_batch,
)
from lcp_plugin.algorithms import REGISTRY

TESTS = Path(__file__).parents[1]
PAGE = (
    TESTS.parent.joinpath("examples", "manual", "guarantees.md")
    .read_text(encoding="utf-8")
    .partition("## Limitations")[0]
)
ALL = ["auto", *REGISTRY]
EVERY_ALGORITHM = pytest.mark.parametrize("name", ALL)


def promises() -> list[str]:
    """The words in bold that begin each line of the page."""
    found: list[str] = re.findall(r"^- \*\*(.*?)\*\*", PAGE, re.M | re.S)
    assert len(found) == PAGE.count("\n- ")
    return [" ".join(words.split()).rstrip(":,.") for words in found]


def quoted() -> list[str]:
    """Return all quotations in docstrings of tests."""
    texts = [file.read_text(encoding="utf-8") for file in TESTS.rglob("test_*.py")]
    return [words for text in texts for words in re.findall(r'"{3}“(.*?)”', text)]


def test_every_promise_has_its_test_and_every_test_its_promise():
    """The page and the tests contain the same quotations."""
    assert len(promises()) >= 10
    assert {*promises()} == {*quoted()}


def test_solved_is_measured():
    """“SOLVED is verified”: claims change nothing; the residual is computed from the data."""
    claims = Scripted(points=((0.25, 0.25),), claimed_residual=0.0)
    assert not solve(TWO, claims).is_solved
    result = solve(TWO)
    w = np.array([[2.0, 1.0], [1.0, 2.0]]) @ result.z + [-5.0, 1.0]
    r = result.z - np.maximum(result.z - w / 2.0, 0.0)
    assert result.is_solved
    assert abs(r).max() <= result.tolerance * 2.5  # r(0) = (−2.5, 0)


def test_rounding_hides_no_residual():
    """“SOLVED is verified”: not if z is so large that M z + q rounds from 2 to 0."""
    infeasible = LCP([[9.0, -3.0, 6.0], [-3.0, 1.0, -2.0], [6.0, -2.0, 4.0]], [-2.0, 0.0, 0.0])
    far = (2001613005325266.0, 6004839015975798.0, 0.0)
    assert Certificate.of(infeasible, far).relative_residual > 0.4  # for any order of BLAS sums
    result = solve(infeasible, Scripted(points=((0.0, 0.0, 0.0), far)))
    assert not result.is_solved
    assert result.status is not Status.PRECISION_LIMIT
    # here the large z is right
    nearly_singular = LCP([[1.0, -1.0], [-1.0, 1.0 + 2.0**-50]], [0.0, -1.0])
    right = solve(nearly_singular, "newton")
    assert right.is_solved
    assert right.z.tolist() == [2.0**50, 2.0**50]


# --- Bits -----------------------------------------------------------------------------------------------------------

BITS = """
import hashlib, json, sys, warnings
warnings.simplefilter("ignore")
from lcp_plugin import LCP, analyze, error_bound, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin import gallery
def bits(array):
    return hashlib.sha256(array.tobytes()).hexdigest()
found = {}
def all_bits():
    problem = gallery.build("obstacle_2d", size=24, shifted=True).problem
    for name in ("auto", *REGISTRY):
        result = solve(problem, name, max_iterations=100, record=True)
        samples = [(s.iteration, s.work, s.residual) for s in result.history]
        found[name] = [bits(result.z), result.status.name, result.iterations, result.work, repr(samples)]
    scene = gallery.build("paper_example_2", n=64).problem
    found["bound"] = [bits(error_bound(scene, solve(scene).z).componentwise)]
    found["analyze"] = [bits(analyze(scene.M).v)]
    return found
"""


def bits_in_a_process(**environment: str) -> dict[str, Any]:
    path = os.pathsep.join([str(TESTS.parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", f"{BITS}\nprint(json.dumps(all_bits()))"],
        capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": path, **environment},
    )  # fmt: skip
    return json.loads(done.stdout)  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def own_bits():
    namespace = {}
    exec(BITS.replace('warnings.simplefilter("ignore")', ""), namespace)
    return json.loads(json.dumps(namespace["all_bits"]()))  # type: ignore[no-any-return]


@pytest.mark.full
def test_processes_agree(own_bits):
    """“Results are bit-reproducible”: z, status, counts and samples agree in a new process."""
    assert bits_in_a_process(PYTHONHASHSEED="12345") == own_bits


# --- Unchanged data and state
# ---------------------------------------------------------------------------------------


def given_matrices() -> dict[str, Any]:
    """Return one matrix in several accepted forms."""
    M = np.array([[4.0, -1, 0], [-1, 4, -1], [0, -1, 4]])
    csr, columns = sp.csr_array(M), np.array([1, 0, 2, 1, 0, 1, 2])
    unsorted = sp.csr_array((np.array([-1.0, 4, -1, 4, -1, -1, 4]), columns, csr.indptr), (3, 3))
    zeros = sp.csr_array(
        (np.append(csr.data, 0.0), np.append(csr.indices, 0), np.append(csr.indptr[:3], 8)), (3, 3)
    )
    return {
        "double": M,
        "csr": csr,
        "unsorted": unsorted,
        "stored zeros": zeros,
        "csc": csr.tocsc(),
    }


@pytest.mark.parametrize("form", given_matrices())
def test_nothing_given_changes(form):
    """“Inputs are never modified”: matrix, q, bounds, start and batch, in any form, by any call."""
    M = given_matrices()[form]
    q, lower, upper = np.array([-3.0, 5.0, -1.0]), np.zeros(3), np.full(3, 9.0)
    z0, Q = np.array([7.0, -7.0, 0.5]), np.array([[1.0, -1.0], [0.0, np.nan], [-2.0, -3.0]])
    everything = (M, q, lower, upper, z0, Q)
    before = bits(*everything)
    problem = LCP(M, q, lower=lower, upper=upper)
    inner = data_of(problem)
    for name in ("auto", *BOUNDED):
        solve(problem, name, z0=z0, record=True)
    solve_batch(problem, Q.T[:2])
    analyze(M)
    error_bound(problem, z0)
    convergence_guarantee(problem, "npsor")
    solve(LCP(M, q, lower=lower), "mgs", z0=z0)
    assert bits(*everything) == before
    assert data_of(problem) == inner
    for array in (q, lower, upper, z0, Q):
        assert array.flags.writeable


@EVERY_ALGORITHM
def test_nothing_global_changes(name):
    """“Global state is never modified”: also after a stop, a rejection or an error."""
    assert scipy.optimize is not None  # loaded: its filter is not ours

    def raises(sample, z):
        raise ZeroDivisionError

    surroundings()  # loads numba's threads, which the next line lists
    threads = blas_threads()  # sets a variable of the environment where threadpoolctl is loaded
    before = surroundings()
    problem = membranes.build("random_h_plus", n=20).problem
    for call in (
        lambda: solve(problem, name, max_iterations=30),
        lambda: solve(problem, name, callback=raises),
        lambda: solve(problem, name, callback=lambda sample, z: True),
        lambda: solve(LCP(-np.eye(3), [-1.0, -2.0, 3.0]), name, max_iterations=30),
    ):
        with suppress(ZeroDivisionError, UnsuitableMatrix, UnsuitableProblem):
            call()
        assert surroundings() == before
        assert blas_threads() == threads


def blas_threads() -> Any:
    """Return the number of BLAS threads, if threadpoolctl is installed."""
    try:
        from threadpoolctl import threadpool_info
    except ImportError:
        return None
    return [(library["prefix"], library["num_threads"]) for library in threadpool_info()]


# --- Errors
# ---------------------------------------------------------------------------------------------------------


@EVERY_ALGORITHM
def test_callbacks_may_raise(name):
    """“Exceptions raised in a callback propagate”: the same object, an LCPError and a SystemExit, too."""
    for error in (
        ZeroDivisionError("mine"),
        UnsuitableMatrix("mine"),
        SystemExit(3),
        MemoryError("mine"),
    ):

        def raises(sample, z, error=error):
            raise error

        with pytest.raises(type(error)) as caught:
            solve(TWO, name, callback=raises)
        assert caught.value is error


@pytest.mark.parametrize("kind", [UnsuitableMatrix, UnsuitableProblem])
def test_callbacks_may_raise_in_a_later_stage(kind):
    """“Exceptions raised in a callback propagate”: also error classes that auto handles."""
    problem = LCP([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0])  # no solution: several methods
    labels = []

    def raises(sample, z):
        labels.append(sample.label)
        if sample.label != labels[0]:
            raise kind("mine")

    with pytest.raises(kind, match=r"^mine$"):
        solve(problem, callback=raises)


@EVERY_ALGORITHM
def test_an_ended_run_keeps_what_it_has(name):
    """“Ctrl-C and `max_seconds` keep the best iterate”: no worse than any that the callback has seen measured."""
    problem = gallery.build("half_active", n=100).problem
    seen = []

    def interrupts(sample, z):
        if sample.residual is not None:
            seen.append(sample.residual)
        if sample.iteration == 2:
            signal.raise_signal(signal.SIGINT)

    result = solve(problem, name, callback=interrupts)
    assert result.status in (Status.INTERRUPTED, Status.SOLVED)
    assert result.residual <= min(seen) * (1.0 + 1e-9)  # the rounding bound is included at the end
    late = solve(problem, name, max_seconds=0.0)
    assert late.status in (Status.MAX_SECONDS, Status.SOLVED)
    assert late.residual <= 1.0 + 1e-12  # the residual of the start z°
    assert bits(solve(problem, name).z) == bits(solve(LCP(problem.csr.copy(), problem.q), name).z)


def test_caches_are_not_needed(tmp_path, monkeypatch):
    """“The compilation cache is optional”: here none can be had; test_faults.py does it with real disks."""
    from lcp_plugin.core.kernels.compilation import kernel

    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setattr("numba.config.CACHE_DIR", str(blocked / "cache"))
    assert kernel(lambda x: x + 1.0)(1.0) == 2.0
