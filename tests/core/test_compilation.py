"""Compiled kernels lie in the user's cache folder, and one command compiles them all."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from numba import njit
from typer.testing import CliRunner

import lcp_plugin
from lcp_plugin import LCP, gallery, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.commands.cli import app
from lcp_plugin.core.deadline import Clock, compilation
from lcp_plugin.core.errors import UnsuitableMatrix, UnsuitableProblem

COUNT_COMPILED = """
import sys
from lcp_plugin import QuadraticProgramBatch, derivative, error_bound, solve, solve_batch
from lcp_plugin import gallery
from numba.core.dispatcher import Dispatcher

for name in ("obstacle_2d:size=30", "half_active:n=25", "bimatrix_game"):
    problem = gallery.parse(name).problem
    for algorithm in ("auto", "npsor", "multigrid") if name.startswith("obstacle") else ("auto",):
        result = solve(problem, algorithm)
        if name.startswith("half"):
            error_bound(problem, result.z)
found = derivative(solve_batch([[[2.0, 1.0], [1.0, 2.0]]], [-5.0, 1.0]))
found.vjp([[1.0, 1.0]]), found.jvp(dq=[1.0, 0.0])
solve_batch(QuadraticProgramBatch([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0], lower=0.0))
kernels = [
    kernel for name, module in list(sys.modules.items()) if name.startswith("lcp_plugin")
    for kernel in vars(module).values() if isinstance(kernel, Dispatcher) and kernel.stats.cache_path
]
print(len(kernels) > 20, sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels))
"""


COUNT_OVERLOADS = """
import sys
import numpy as np
from lcp_plugin import LCP, QuadraticProgramBatch, derivative, error_bound, solve, solve_batch
from lcp_plugin.problems.least_squares.solving import bounded_least_squares
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin import gallery
from numba.core.dispatcher import Dispatcher
from numba.core.types import Array
from scipy.sparse import diags_array

for name in ("obstacle_2d:size=30", "half_active:n=25", "bimatrix_game", "obstacle_2d:size=260"):
    problem = gallery.parse(name).problem
    for algorithm in ("auto", "psor", "npsor", "multigrid") if name.startswith("obstacle") else ("auto", "lemke"):
        result = solve(problem, algorithm)
        if name.startswith("half"):
            error_bound(problem, result.z)
ones = np.ones(90)
string = LCP(diags_array([-ones[1:], 2.0 * ones, -ones[1:]], offsets=[-1, 0, 1], format="csr"), ones)
for algorithm in ("newton", "banded", "interior_point", "mgs"):
    own = solve(string, algorithm)
    solve(string.with_q(-np.arange(90.0)), algorithm, z0=own.z, record=True)
    solve(LCP(string.csr.copy(), np.ones(90)), algorithm, z0=np.ones(90))
M, q = [[[2.0, 1.0], [1.0, 2.0]]], [-5.0, 1.0]
found = derivative(solve_batch(M, q))
found.vjp([[1.0, 1.0]]), found.jvp(dq=[1.0, 0.0])
solve(LCP(M[0], q), record=True), solve_batch(np.array(M), np.array([q]), z0=np.ones(2))
for P in (M, M[0], np.asfortranarray(M * 2)):
    solve_batch(QuadraticProgramBatch(P, q, [[1.0, 1.0]], [2.0], lower=-9.0))
bounded_least_squares(np.eye(3)[:, :2], np.ones(3)), bounded_least_squares(np.eye(300)[:, :99], np.ones(300))


def widths(signature):
    return tuple((kind.dtype, kind.mutable) for kind in signature if isinstance(kind, Array))


kernels = {
    kernel for name, module in list(sys.modules.items()) if name.startswith("lcp_plugin")
    for kernel in vars(module).values() if isinstance(kernel, Dispatcher) and kernel.stats.cache_path
}
print(len(kernels) > 20, *[
    kernel.py_func.__name__ for kernel in kernels
    if len(kernel.overloads) > len({widths(signature) for signature in kernel.overloads})
])
"""


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
def test_nothing_is_compiled_after_a_warm_up() -> None:
    """After `lcp-plugin warm-up` a fresh process finds every kernel it needs in the cache."""
    run = CliRunner().invoke(app, ["warm-up"])
    assert run.exit_code == 0
    assert in_a_new_process(COUNT_COMPILED) == "True 0"


@pytest.mark.full
def test_no_kernel_is_compiled_twice() -> None:
    """Constants and variables share one code: two are for index widths, precisions, and arrays that are read-only."""
    assert in_a_new_process(COUNT_OVERLOADS) == "True"


@pytest.mark.parametrize("algorithm", ["auto", *REGISTRY])
def test_a_history_has_floats(algorithm: str) -> None:
    """Numbers of a history are floats, not scalars of numpy."""
    rng, numbers = np.random.default_rng(0), []
    band = sp.diags_array([-np.ones(39), np.full(40, 3.0), -np.ones(39)], offsets=(-1, 0, 1))
    skew = np.triu(rng.normal(size=(30, 30)))
    problems = (
        gallery.build("obstacle_2d", size=24, shifted=True).problem,
        LCP(band, rng.normal(size=40)),
        LCP(skew - skew.T + 0.1 * np.eye(30), rng.normal(size=30)),
        gallery.build("bimatrix_game").problem,
    )
    for given in problems:
        with suppress(UnsuitableMatrix, UnsuitableProblem):
            for sample in solve(given, algorithm, record=True, max_iterations=200).history:
                numbers += [sample.residual, sample.work, sample.seconds]
    assert numbers
    assert {type(number) for number in numbers} == {float}


def test_numba_is_asked_in_one_place() -> None:
    """Whatever is compiled divides as numpy does, interpreted or not, and once: no kernel asks by itself."""
    for file in Path(lcp_plugin.__file__).parent.rglob("kernels/*.py"):
        is_the_place = file.name in ("compiler.py", "compilation.py")
        assert is_the_place or "njit" not in file.read_text(encoding="utf-8"), file.name


@pytest.mark.full
def test_the_clock_of_a_first_run_shows_no_compilation() -> None:
    """In a fresh process, too, most of the time of a small solve is loading compiled code, and not on the clock."""
    code = (
        "import time\nfrom lcp_plugin import gallery, solve\nproblem = gallery.parse('half_active:n=25').problem\n"
        "began = time.perf_counter()\nresult = solve(problem, 'mgs')\n"
        "print(result.is_solved, result.seconds < 0.5 * (time.perf_counter() - began))"
    )
    assert in_a_new_process(code) == "True True"


def test_whatever_is_compiled_within_a_run_stops_its_clock() -> None:
    """A kernel of another package, too, costs the run none of its seconds and none of its limit."""

    def anything(x: float) -> float:
        return x + 1.0

    began, before = time.perf_counter(), compilation().seconds
    clock = Clock()
    njit(anything)(1.0)
    stopped = compilation().seconds - before
    assert stopped > 0.0
    assert clock.read() <= time.perf_counter() - began - stopped


@pytest.mark.full
def test_shell_completes_scenes_and_algorithms() -> None:
    """The shell offers what the command knows."""
    code = "import sys; sys.argv = ['lcp-plugin']; from lcp_plugin.commands.cli import app; app(prog_name='lcp-plugin')"
    for words, offered in (
        ("lcp-plugin solve obstacle", "obstacle_2d obstacle_3d obstacle_bumps"),
        ("lcp-plugin solve x -a nps", "npsor npsplitting"),
    ):
        position = str(len(words.split()) - 1)
        found = in_a_new_process(
            code, _LCP_PLUGIN_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=position
        )
        assert found.split() == offered.split()


def _decorators(function: ast.FunctionDef) -> set[str]:
    return {
        name.id
        for each in function.decorator_list
        for name in ast.walk(each)
        if isinstance(name, ast.Name)
    }


def test_python_calls_kernels_alone() -> None:
    """No function of Python calls a helper of its own file, or one that it imports: there is no wrapper for that."""
    package = Path(lcp_plugin.__file__).parent
    texts = {
        path.with_suffix(""): path.read_text(encoding="utf-8") for path in package.rglob("*.py")
    }
    helpers: dict[Path, set[str]] = defaultdict(set)
    for path, text in texts.items():
        if re.search("^@(helper|inlined)", text, re.M):
            helpers[path] = {function.name for function in ast.parse(text).body if isinstance(function, ast.FunctionDef)
                             if _decorators(function) & {"helper", "inlined"}}  # fmt: skip
    names = set().union(*helpers.values())
    assert len(names) > 20
    for path, text in texts.items():
        if not names & set(re.findall(r"(?<![\w.])(\w+)\(", text)):
            continue
        tree = ast.parse(text)
        known = set(helpers[path])
        for each in ast.walk(tree):
            if isinstance(each, ast.ImportFrom) and each.level:
                module = path.parents[each.level - 1].joinpath(*(each.module or "").split("."))
                known |= {name.name for name in each.names} & helpers.get(module, set())
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef) and not _decorators(function) & {
                "kernel",
                "helper",
                "inlined",
            }:
                calls = {
                    call.func.id
                    for call in ast.walk(function)
                    if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
                }
                assert not calls & known or _makes_kernels(function), (
                    f"{path}: {function.name} calls {calls & known}"
                )


def _makes_kernels(function: ast.FunctionDef) -> bool:
    return any(
        isinstance(each, ast.FunctionDef) and _decorators(each) & {"kernel"}
        for each in ast.walk(function)
    )
