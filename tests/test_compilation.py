"""Compiled kernels lie in the user's cache folder, and one command compiles them all."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from numba import njit
from typer.testing import CliRunner

from lcp_plugin.commands.cli import app
from lcp_plugin.deadline import compilation
from lcp_plugin.kernels.compilation import cache_folder, compiled
from lcp_plugin.peers.alone import ALONE
from lcp_plugin.solving.state import Clock

COUNT_COMPILED = """
import sys
from lcp_plugin import derivative, error_bound, solve, solve_batch
from lcp_plugin.evidence import gallery
from numba.core.dispatcher import Dispatcher

for name in ("obstacle_2d:size=30", "half_active:n=25", "bimatrix_game", "murty:n=30"):
    problem = gallery.parse(name).problem
    for algorithm in ("auto", "npsor", "multigrid") if name.startswith("obstacle") else ("auto",):
        result = solve(problem, algorithm)
        if name.startswith("half"):
            error_bound(problem, result.z)
found = derivative(solve_batch([[[2.0, 1.0], [1.0, 2.0]]], [-5.0, 1.0]))
found.vjp([[1.0, 1.0]]), found.jvp(dq=[1.0, 0.0])
kernels = [
    kernel for name, module in list(sys.modules.items()) if name.startswith("lcp_plugin")
    for kernel in vars(module).values() if isinstance(kernel, Dispatcher) and kernel.stats.cache_path
]
print(len(kernels) > 20, sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels))
"""


def in_a_new_process(code: str, **environment: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ | environment
    )
    return run.stdout.strip()


@pytest.mark.full
def test_nothing_is_compiled_after_a_warm_up() -> None:
    """After `lcp-plugin warm-up` a fresh process finds every kernel it needs in the cache."""
    run = CliRunner().invoke(app, ["warm-up"])
    assert run.exit_code == 0
    assert f"they lie in {cache_folder()}" in run.output
    assert in_a_new_process(COUNT_COMPILED) == "True 0"


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
    """A kernel that nobody rehearsed costs the run none of its seconds and none of its limit."""

    def anything(x: float) -> float:
        return x + 1.0

    began, before = time.perf_counter(), compilation().seconds
    clock = Clock(ALONE)
    njit(anything)(1.0)
    stopped = compilation().seconds - before
    assert stopped > 0.0
    assert clock.read() <= time.perf_counter() - began - stopped


@pytest.mark.full
def test_cache_is_the_user_s(tmp_path: Path) -> None:
    """The kernels lie in the user's cache folder or where NUMBA_CACHE_DIR says; other packages' lie where they did."""
    code = (
        "from numba import config, njit\n"
        "before = config.CACHE_DIR\n"
        "from lcp_plugin.kernels import splitting_sweeps as kernels\n"
        "print(config.CACHE_DIR == before, kernels.split_rows.stats.cache_path)"
    )
    said = in_a_new_process(code, XDG_CACHE_HOME=str(tmp_path / "user"), NUMBA_CACHE_DIR="")
    unchanged, _, path = said.partition(" ")
    assert unchanged == "True"
    assert Path(path).is_relative_to(tmp_path / "user" / "lcp_plugin" if sys.platform == "linux" else Path.home())
    unchanged, _, path = in_a_new_process(code, NUMBA_CACHE_DIR=str(tmp_path / "named")).partition(" ")
    assert unchanged == "True"
    assert Path(path).is_relative_to(tmp_path / "named")


@pytest.mark.full
def test_shell_completes_scenes_algorithms_and_benchmarks() -> None:
    """The shell offers what the command knows."""
    code = "import sys; sys.argv = ['lcp-plugin']; from lcp_plugin.commands.cli import app; app(prog_name='lcp-plugin')"
    for words, offered in (
        ("lcp-plugin solve obstacle", "obstacle_2d obstacle_3d obstacle_bumps"),
        ("lcp-plugin solve x -a nps", "npsor npsplitting"),
        ("lcp-plugin bench riv", "rivals"),
    ):
        position = str(len(words.split()) - 1)
        found = in_a_new_process(
            code, _LCP_PLUGIN_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=position
        )
        assert found.split() == offered.split()


def test_a_kernel_is_compiled_anew_when_another_file_of_kernels_changes() -> None:
    """What lies on disk carries the dates of all files: a kernel may have been compiled into one of another file."""
    from lcp_plugin.kernels import compilation, enclosures, small_problems

    files = sorted(Path(compilation.__file__).parent.glob("*.py"))
    dates = tuple((file.stat().st_mtime_ns, file.stat().st_size) for file in files)
    for kernel in (small_problems.run_all, enclosures.residual_ends):
        _, others = kernel._cache._cache_file._source_stamp  # the first is numba's, of its own file
        assert others == dates


def test_a_constant_argument_compiles_no_kernel_of_its_own() -> None:
    """Of a kernel called with constants and variables there is one version for the same kinds of arrays."""
    from lcp_plugin import LCP, solve
    from lcp_plugin.kernels import small_problems, small_systems

    assert solve(LCP([[2.0, 1.0], [0.0, 1.0]], [-1.0, -1.0]), "newton").is_solved
    for kernel in (small_problems._ends, small_problems.slack, small_problems.classify, small_systems._eliminate):
        kinds = [tuple(str(kind) for kind in signature) for signature in kernel.signatures]
        assert len(kinds) == len(set(kinds))
        assert not any("Literal" in kind for key in kinds for kind in key)


def test_two_types_compiled_at_once_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither process sees what the other enters into the index: each keeps its code in a file of its own."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))

    @compiled
    def twice(x):  # type: ignore[no-untyped-def]
        return x + x

    monkeypatch.setattr(twice._cache._cache_file, "_load_index", dict)
    assert (twice(1), twice(1.5)) == (2, 3.0)
    assert len({file.read_bytes() for file in tmp_path.rglob("*.nbc")}) == 2
