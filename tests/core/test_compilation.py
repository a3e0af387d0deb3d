"""Compiled kernels lie in the user's cache folder, and one command compiles them all."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from numba import njit, typeof
from small_families import FAMILIES, problem
from typer.testing import CliRunner

import lcp_plugin
from lcp_plugin import LCP, QuadraticProgramBatch, Status, gallery, solve, solve_batch
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.commands.cli import app
from lcp_plugin.core.checks import read_only
from lcp_plugin.core.deadline import NEW_KERNELS, Clock, compilation
from lcp_plugin.core.errors import UnsuitableMatrix, UnsuitableProblem
from lcp_plugin.core.kernels.compilation import cache_folder, compiled, compiling_at_once
from lcp_plugin.core.kernels.enclosures import fused, split_sum
from lcp_plugin.core.solving import run_log
from lcp_plugin.problems.least_squares.solving import bounded_least_squares

COUNT_COMPILED = """
import sys
from lcp_plugin import QuadraticProgramBatch, derivative, error_bound, solve, solve_batch
from lcp_plugin import gallery
from numba.core.dispatcher import Dispatcher

for name in ("obstacle_2d:size=30", "half_active:n=25", "bimatrix_game", "murty:n=30"):
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
from lcp_plugin.core.kernels.compilation import compiling_at_once
from numba.core.types import Array
from scipy.sparse import diags_array

with compiling_at_once():
    for name in ("obstacle_2d:size=30", "half_active:n=25", "bimatrix_game", "murty:n=30", "obstacle_2d:size=260"):
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
    return tuple(kind.dtype for kind in signature if isinstance(kind, Array))


kernels = {
    kernel for name, module in list(sys.modules.items()) if name.startswith("lcp_plugin")
    for kernel in vars(module).values() if hasattr(kernel, "is_patient")  # not the parts of kernels
}
print(len(kernels) > 50, *[
    kernel.py_func.__name__ for kernel in kernels
    if len(kernel.overloads) > len({widths(signature) for signature in kernel.overloads})
])
"""


def in_a_new_process(code: str, folder: Path | None = None, **environment: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=folder,
        env=os.environ | environment,
    )
    return run.stdout.strip()


@pytest.mark.full
def test_nothing_is_compiled_after_a_warm_up() -> None:
    """After `lcp-plugin warm-up` a fresh process finds every kernel it needs in the cache."""
    run = CliRunner().invoke(app, ["warm-up"])
    assert run.exit_code == 0
    assert f"they lie in {cache_folder()}" in run.output
    assert in_a_new_process(COUNT_COMPILED) == "True 0"


WAITING = """
import sys, threading, time
from lcp_plugin.commands import terminal
from lcp_plugin.core.deadline import NEW_KERNELS

terminal.QUIET_SECONDS = float(sys.argv[1])
try:
    with terminal.LINE:
        with NEW_KERNELS.compiling():
            time.sleep(float(sys.argv[2]))
        print("solved", file=sys.stderr)
except KeyboardInterrupt:
    print("stopped", file=sys.stderr)
print(threading.active_count(), file=sys.stderr)
"""


def on_a_terminal(quiet: float, seconds: float, *, ctrl_c: bool = False) -> list[str]:
    """What a terminal has got while something is compiled for some seconds, from one return of the cursor to the next.

    After Ctrl-C, if that is wanted, as soon as there is a line.
    """
    pty = pytest.importorskip("pty", reason="terminals are a thing of Unix")
    ours, theirs = pty.openpty()
    running = subprocess.Popen([sys.executable, "-c", WAITING, str(quiet), str(seconds)], stderr=theirs)
    os.close(theirs)
    shown = b""
    try:
        while chunk := read_from(ours):
            shown += chunk
            if ctrl_c and b"compiling" in shown:
                running.send_signal(signal.SIGINT)
                ctrl_c = False
    finally:
        running.kill()
        running.wait()
        os.close(ours)
    return [part.strip() for part in re.split("[\r\n]+", shown.decode()) if part]


def read_from(terminal: int) -> bytes:
    """What a terminal gets next; nothing where nobody writes to it any more."""
    try:
        return os.read(terminal, 4096)
    except OSError:
        return b""


def test_a_terminal_says_that_kernels_are_compiled() -> None:
    """A line moves and counts the seconds, and is wiped before anything else is written; no thread is left."""
    *line, wiped, solved, threads = on_a_terminal(0.0, 1.5)
    assert all(re.fullmatch(r"[-|/\\] compiling, once an installation: [012] s so far", text) for text in line)
    assert len(set(line)) > 4
    assert (wiped, solved, threads) == ("", "solved", "1")


def test_a_short_compilation_is_silent() -> None:
    """What is compiled within a second is not worth a line."""
    assert on_a_terminal(1.0, 0.5) == ["solved", "1"]


def test_ctrl_c_while_compiling_leaves_the_terminal_tidy() -> None:
    """The line is wiped, and its thread is gone."""
    assert on_a_terminal(0.0, 60.0, ctrl_c=True)[-3:] == ["", "stopped", "1"]


def test_compilation_is_silent_where_nobody_looks() -> None:
    """A pipe gets no moving line."""
    run = subprocess.run([sys.executable, "-c", WAITING, "0", "0.5"], capture_output=True, text=True, check=True)
    assert run.stderr == "solved\n1\n"


def test_numba_tells_when_it_compiles() -> None:
    """Who watches hears the beginning and the end of a compilation, and the seconds are counted."""
    heard: list[bool] = []
    watcher = lambda: heard.append(NEW_KERNELS.is_under_way)  # noqa: E731
    before = NEW_KERNELS.seconds
    NEW_KERNELS.watchers.append(watcher)
    try:
        njit(lambda x: x + 1.0)(1.0)
    finally:
        NEW_KERNELS.watchers.remove(watcher)
    assert heard[0]
    assert not heard[-1]
    assert NEW_KERNELS.seconds > before


def test_a_verbose_run_says_that_kernels_are_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It says so once, and nothing where nothing is printed."""
    monkeypatch.setattr(run_log, "QUIET", -1.0)

    def compiles(*_: object) -> None:
        with NEW_KERNELS.compiling():
            pass

    problem = gallery.obstacle_2d(size=10).problem
    solve(problem, callback=compiles)
    assert capsys.readouterr().out == ""
    solve(problem, callback=compiles, verbose=True)
    assert capsys.readouterr().out.count("(compiling, once an installation") == 1


@pytest.mark.full
def test_no_kernel_is_compiled_twice() -> None:
    """Read-only arrays and others, constants and variables, share one code: two are for index widths and precisions."""
    assert in_a_new_process(COUNT_OVERLOADS) == "True"


def solutions() -> list[bytes]:
    """Answers to problems of a few unknowns, of every kind whose kernels may be interpreted."""
    rng = np.random.default_rng(3)
    found: list[np.ndarray] = []
    for family in FAMILIES:
        drawn = problem(family, 9, rng)
        for algorithm in ("auto", "newton", "lemke"):
            result = solve(LCP(drawn.matrix.array, drawn.q, lower=drawn.lower, upper=drawn.upper), algorithm)
            found += [result.z, np.array([result.residual, result.work])]
    for n in (1, 2, 30):
        string = sp.diags_array([-np.ones(n - 1), np.full(n, 2.0), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr")
        for algorithm in ("auto", "banded", "interior_point"):
            found.append(solve(LCP(string, rng.normal(size=n), upper=rng.random(n)), algorithm).z)
    for n in (3, 60):  # of a Neumann problem, singular
        ends = np.r_[1.0, np.full(n - 2, 2.0), 1.0]
        string = sp.diags_array([-np.ones(n - 1), ends, -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr")
        for algorithm in ("auto", "banded"):
            result = solve(LCP(string, -np.ones(n)), algorithm)
            found += [result.z, np.array([result.status is Status.INFEASIBLE])]
    hopeless = [[0.0, 0.0], [0.0, 0.0]], [[-1.0, -1.0], [-1.0, -2.0]], [[1, -2, 1], [-3, 2, -2], [1, -2, 0]]
    for M in hopeless:
        result = solve(LCP(M, [-5.0, 1.0, 2.0][: len(M)]))
        found += [result.z, np.array([result.status is Status.INFEASIBLE])]
    for k in range(6):
        A, b = rng.normal(size=(9 + k, 5)), rng.normal(size=9 + k)
        found.append(bounded_least_squares(A, b, upper=0.3 + k, ridge=0.1 * (k % 2)).x)
        found.append(solve(LCP(A.T @ A + np.eye(5), A.T @ b), "interior_point").z)
        programs = QuadraticProgramBatch(np.diag([1.0] * k + [0.0] * (5 - k)), b[:5], A[:, :5], b + 1.0, lower=-1.0)
        answers = solve_batch(programs, prove_infeasibility=False)
        found += [answers.x, answers.inequality, answers.lower, answers.residual]
    return [array.tobytes() for array in found]


def test_interpreted_kernels_have_the_bits_of_compiled_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a first call answers before anything is compiled is what every later call answers."""
    with compiling_at_once():
        compiled_bits = solutions()
    assert interpret_all(monkeypatch) > 8
    assert solutions() == compiled_bits


def interpret_all(monkeypatch: pytest.MonkeyPatch) -> int:
    """Have every kernel run by the interpreter that may be; return how many names of such were found."""
    interpreted = 0
    for name, module in list(sys.modules.items()):
        for attribute, kernel in list(vars(module).items()) if name.startswith("lcp_plugin.") else ():
            if getattr(kernel, "is_patient", False):
                monkeypatch.setattr(module, attribute, np.errstate(all="ignore")(kernel.py_func))
                interpreted += 1
    return interpreted


@pytest.mark.parametrize("algorithm", ["auto", *REGISTRY])
def test_a_history_has_floats_whether_kernels_are_compiled_or_not(
    algorithm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The interpreter returns scalars of numpy where compiled code returns floats: a method's step has floats."""
    rng, numbers = np.random.default_rng(0), []
    band = sp.diags_array([-np.ones(39), np.full(40, 3.0), -np.ones(39)], offsets=(-1, 0, 1))
    skew = np.triu(rng.normal(size=(30, 30)))
    problems = (
        gallery.build("obstacle_2d", size=24, shifted=True).problem, LCP(band, rng.normal(size=40)),
        LCP(skew - skew.T + 0.1 * np.eye(30), rng.normal(size=30)), gallery.build("bimatrix_game").problem,
    )
    for given in problems:
        with suppress(UnsuitableMatrix, UnsuitableProblem):
            solve(given, algorithm, record=True, max_iterations=200)  # loads its kernels
            interpret_all(monkeypatch)
            for sample in solve(given, algorithm, record=True, max_iterations=200).history:
                numbers += [sample.residual, sample.work, sample.seconds]
    assert numbers
    assert {type(number) for number in numbers} == {float}


def test_numba_is_asked_in_one_place() -> None:
    """Whatever is compiled divides as numpy does, interpreted or not, and once: no kernel asks by itself."""
    for file in Path(lcp_plugin.__file__).parent.rglob("kernels/*.py"):
        is_the_place = file.name in ("compiler.py", "compilation.py")
        assert is_the_place or "njit" not in file.read_text(encoding="utf-8"), file.name


def test_a_first_small_problem_compiles_nothing(tmp_path: Path) -> None:
    """With no kernel kept anywhere, ten unknowns are solved by interpreted kernels, without a file in the cache."""
    code = (
        "import numpy as np\nfrom lcp_plugin import LCP, solve\nfrom lcp_plugin.core.deadline import NEW_KERNELS\n"
        "M = np.diag(np.full(10, 4.0)) - np.diag(np.ones(9), 1) - np.diag(np.ones(9), -1)\n"
        "print(solve(LCP(M, np.linspace(-1.0, 1.0, 10))).status.name)"
    )
    assert in_a_new_process(code, NUMBA_CACHE_DIR=str(tmp_path)) == "SOLVED"
    assert not list(tmp_path.rglob("*.nbc"))


def test_a_part_of_kernels_is_interpreted_where_python_calls_it() -> None:
    """It has no machine code of its own to crash in."""
    total, error = split_sum(1.0, 2.0**-60)
    assert (total, error) == (1.0, 2.0**-60)
    assert not split_sum.overloads or fused(3.0, 1.0 / 3.0, -1.0) != 0.0


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
def test_cache_is_the_user_s(tmp_path: Path) -> None:
    """The kernels lie in the user's cache folder or where NUMBA_CACHE_DIR says; other packages' lie where they did."""
    code = (
        "from numba import config, njit\n"
        "before = config.CACHE_DIR\n"
        "from lcp_plugin.core.kernels import splitting_sweeps as kernels\n"
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


@pytest.mark.full
@pytest.mark.parametrize(("file", "old", "new"), [
    ("systems/hierarchy/grids.py", "    return low\n", "    return runs.shape[0]\n"),
    ("systems/hierarchy/galerkin.py", "touched[i] = is_row_changed[i]", "touched[i] = 0 * is_row_changed[i]"),
])
def test_a_kernel_is_compiled_anew_when_a_file_it_is_made_of_changes(
    file: str, old: str, new: str, tmp_path: Path
) -> None:
    """Its own or one whose functions were compiled into it; code on disk from before is not run."""
    package = Path(lcp_plugin.__file__).parent
    shutil.copytree(package, tmp_path / "lcp_plugin", ignore=shutil.ignore_patterns("__pycache__"))
    code = (
        "import numpy as np\nfrom lcp_plugin.systems.hierarchy import galerkin\n"
        "flag, touched = np.ones(1, np.uint8), np.zeros(1, np.uint8)\n"
        "operands = np.array([0, 0]), np.zeros(0, np.int64), np.array([[0, 1, 0]]), flag, flag, touched\n"
        "galerkin.mark_rows(*operands)\n"
        "print(galerkin.__file__, touched[0], sum(galerkin._mark_rows.stats.cache_hits.values()))"
    )
    at = str(tmp_path / "lcp_plugin" / "systems" / "hierarchy" / "galerkin.py")
    cache = str(tmp_path / "cache")
    for hits in "01":
        assert in_a_new_process(code, tmp_path, NUMBA_CACHE_DIR=cache, PYTHONPATH="") == f"{at} 1 {hits}"
    changed = tmp_path / "lcp_plugin" / file
    text = changed.read_text()
    assert text.count(old) == 1
    changed.write_text(text.replace(old, new))
    assert in_a_new_process(code, tmp_path, NUMBA_CACHE_DIR=cache, PYTHONPATH="") == f"{at} 0 0"


def test_constants_of_other_files_are_part_of_kernels() -> None:
    """The stamp of what lies on disk covers every file where functions are compiled, and what these import."""
    from lcp_plugin.core import tuning
    from lcp_plugin.core.kernels import compilation
    from lcp_plugin.methods.small.kernels import small_problems
    from lcp_plugin.proofs.exact import upward
    from lcp_plugin.systems.hierarchy import grids

    stamps = compilation._sources()
    for module in (tuning, upward, small_problems, grids):
        stat = Path(str(module.__file__)).stat()
        assert (stat.st_mtime_ns, stat.st_size) in stamps
    _, others = grids.mark_equal._cache._cache_file._source_stamp  # the first is numba's, of its own file
    assert others == stamps


def test_a_constant_argument_compiles_no_kernel_of_its_own() -> None:
    """Of a kernel called with constants and variables there is one version for the same kinds of arrays."""
    from lcp_plugin import LCP, solve
    from lcp_plugin.methods.small.kernels import small_problems, small_systems

    assert solve(LCP([[2.0, 1.0], [0.0, 1.0]], [-1.0, -1.0]), "newton").is_solved
    for kernel in (small_problems.ends, small_problems.slack, small_problems.classify, small_systems.eliminate):
        kinds = [tuple(str(kind) for kind in signature) for signature in kernel.signatures]
        assert len(kinds) == len(set(kinds))
        assert not any("Literal" in kind for key in kinds for kind in key)


def test_a_kernel_that_two_threads_asked_for_is_found_at_once() -> None:
    """Asked for twice for the same read-only arrays, as by two threads at once, a kernel has one entry for them."""

    @compiled
    def last(values):  # type: ignore[no-untyped-def]
        return values[-1]

    values = read_only(np.ones(3))
    signature = (typeof(values),)
    for _ in range(2):  # as if the second had asked before the first was answered
        last.compile(signature)
    asked, compile_for = [], last._compile_for_args
    last._compile_for_args = lambda *arguments: asked.append(arguments) or compile_for(*arguments)
    assert last(values) == 1.0
    assert asked == []


def test_two_types_compiled_at_once_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither process sees what the other enters into the index: each keeps its code in a file of its own."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))

    @compiled
    def twice(x):  # type: ignore[no-untyped-def]
        return x + x

    monkeypatch.setattr(twice._cache._cache_file, "_load_index", dict)
    assert (twice(1), twice(1.5)) == (2, 3.0)
    assert len({file.read_bytes() for file in tmp_path.rglob("*.nbc")}) == 2
