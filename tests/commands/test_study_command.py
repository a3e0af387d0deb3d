"""Problems and methods of one's own from a shell: found by file and name, measured, and mistaken in words."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from lcp_plugin.commands.cli import app

OWN = '''
from dataclasses import dataclass
import numpy as np, scipy.sparse as sp
from lcp_plugin import LCP
from lcp_plugin.algorithms import Algorithm, Step

def chain(n):
    return sp.diags_array([-1.0, 2.1, -1.0], offsets=[-1, 0, 1], shape=(n, n)), np.sin(0.3 * np.arange(n)) - 0.2

def even(n, shift=2.1):
    if n % 2:
        raise ValueError(f"n must be even, got {n}")
    return LCP(shift * np.eye(n), -np.ones(n))

@dataclass(frozen=True)
class Damped(Algorithm):
    """Damped projected Jacobi."""
    name = "damped"
    omega: float = 0.7
    def iterates(self, problem, z0):
        z = z0
        while True:
            yield Step(z)
            z = np.clip(z - self.omega * problem.slack(z) / problem.diagonal, problem.lower, problem.upper)

class Raises(Algorithm):
    name = "raises"
    def iterates(self, problem, z0):
        yield Step(z0)
        yield Step(z0[problem.n + 1])

class Nameless(Algorithm):
    def iterates(self, problem, z0):
        yield Step(z0)
'''


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a module of one's own, in which the command runs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    return tmp_path


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


def rows(path: str = "study.csv") -> list[dict[str, str]]:
    with Path(path).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


# --- Own names, wherever a name is taken ----------------------------------------------------------------------


@pytest.mark.sampled(1)
@pytest.mark.parametrize("module", ["mine.py", "mine"])
def test_a_module_in_the_current_folder_is_found(module: str) -> None:
    """solve, check, analyze and report take ``module:function`` and ``module:Class``, with options and parameters."""
    for arguments in (
        ("solve", f"{module}:chain", "--size", "40", "-a", f"{module}:Damped", "-o", "omega=0.5"),
        ("solve", f"{module}:even:n=4,shift=3", "-a", "psor"),
        ("check", f"{module}:chain:n=20"),
        ("analyze", f"{module}:chain:n=20"),
    ):
        done = run(*arguments)
        assert done.exit_code == 0, done.output
    assert "damped" in run("solve", f"{module}:chain:n=9", "-a", f"{module}:Damped").output


@pytest.mark.full
def test_the_report_takes_a_function(here: Path) -> None:
    """A problem that a function builds has its part of the report."""
    pytest.importorskip("matplotlib")
    done = run("report", "mine.py:chain:n=20", "--quick", "--out", "r")
    assert done.exit_code == 0, done.output
    assert "<h3>chain</h3>" in (here / "r" / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("solve mine.py:chian --size 9", "mine.py has no 'chian'; did you mean 'chain'"),
        ("solve nothing.py:f", "no file 'nothing.py'"),
        ("solve nothing:f", "no module 'nothing'"),
        ("solve broken.py:f", "broken.py, line 2, in <module>: AttributeError"),
        ("solve syntax.py:f", "syntax.py, line 1: "),
        ("solve mine.py:chain", "chain needs a size"),
        ("solve mine.py:even --size 3", "in even: ValueError: n must be even, got 3"),
        ("solve mine.py:even:n=4,shft=1", "got an unexpected keyword argument 'shft'"),
        ("solve mine.py:even:n", "write file.py:function:key=value"),
        ("solve mine.py:OWN --size 3", "mine.py has no 'OWN'"),
        (
            "solve mine.py:chain:n=9 -a mine.py:chain",
            "must be a class below lcp_plugin.algorithms.Algorithm",
        ),
        ("solve mine.py:chain:n=9 -a mine.py:Nameless", 'has no name; write name = "nameless"'),
        ("solve mine.py:chain:n=9 -a mine.py:Damped -o omga=1", "did you mean 'omega'"),
        ("solve mine.py:chain:n=9 -a mine.py:Raises -o omega=1", "has no options, got ['omega']"),
        ("solve mine.py:chain:n=9 -a mine.py:Raises", "in iterates: IndexError"),
        ("check mine.py:chain:n=9 -a mine.py:Raises", "in iterates: IndexError"),
    ],
)
def test_a_mistake_of_one_s_own_is_told_with_its_line(
    here: Path, arguments: str, words: str
) -> None:
    """One line on stderr, exit code 2, and no traceback."""
    (here / "broken.py").write_text("import numpy\nx = numpy.nothing\n", encoding="utf-8")
    (here / "syntax.py").write_text("def f(:\n", encoding="utf-8")
    done = run(*arguments.split())
    assert done.exit_code == 2, done.output
    assert words in done.output
    assert "Traceback" not in done.output


# --- The study ------------------------------------------------------------------------------------------------


def test_families_methods_and_sizes_from_options(here: Path) -> None:
    """Problems and methods, own and ours, sizes and views: a CSV, a table that prints, and what was asked for."""
    done = run(
        "study",
        "mine.py:chain",
        "half_active",
        "-a",
        "psor",
        "-a",
        "mine.py:Damped",
        "--size",
        "16",
        "--size",
        "64",
        "--size",
        "256",
        "--repeats",
        "1",
        "--save",
        "iterations=t.tex",
        "--save",
        "results=r.md",
        "--out",
        "r.csv",
    )
    assert done.exit_code == 0, done.output
    assert {(row["problem"], row["size"], row["method"]) for row in rows("r.csv")} == {
        (problem, size, method)
        for problem in ("chain", "half_active")
        for size in ("16", "64", "256")
        for method in ("psor", "damped")
    }
    assert "chain: iterations" in done.output
    assert "\\toprule" in (here / "t.tex").read_text(encoding="utf-8")
    assert len((here / "r.md").read_text(encoding="utf-8").splitlines()) == 14


FILE = """
problems = ["mine.py:chain"]
sizes = [16, 64]
repeats = 1
save = ["work=w.csv"]
[methods]
fast = { algorithm = "mine.py:Damped", omega = 0.9 }
ours = "psor"
"""


def test_a_study_file_says_the_same_and_options_go_before_it(here: Path) -> None:
    """TOML with labels and options of methods; a flag beside it wins."""
    (here / "s.toml").write_text(FILE, encoding="utf-8")
    assert run("study", "s.toml").exit_code == 0
    assert {(row["method"], row["size"]) for row in rows()} == {
        (name, size) for name in ("fast", "ours") for size in ("16", "64")
    }
    assert (here / "w.csv").read_text(encoding="utf-8").startswith("method,n = 16,n = 64")
    assert "4 of them from a former run" in run("study", "s.toml").output
    assert ": 1 row\n" in run("study", "s.toml", "-a", "pgs", "--size", "9").output


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("repeats", "repeat", "s.toml: unknown key 'repeat'; did you mean 'repeats'"),
        ("[16, 64]", "[16, 64", "s.toml is no TOML: "),
        ("[16, 64]", '"16"', "s.toml: sizes must be list, got '16'"),
        ("repeats = 1", "repeats = true", "s.toml: repeats must be int, got True"),
        ("work=w", "wrk=w", "did you mean 'work'"),
        ("w.csv", "w.txt", "'w.txt' must end in .tex, .md, .csv"),
        ("w.csv", "no/w.csv", "the folder no does not exist"),
        ("mine.py:chain", "mine.py:chian", "did you mean 'chain'"),
        ("mine.py:chain", "half_activ", "did you mean 'half_active'"),
        ('"psor"', '"psr"', "did you mean 'psor'"),
        ("omega = 0.9", "omga = 0.9", "did you mean 'omega'"),
        ('algorithm = "mine.py:Damped", ', "", "method 'fast' needs an algorithm"),
    ],
)
def test_a_typo_in_a_study_file_is_found_before_anything_runs(
    here: Path, old: str, new: str, words: str
) -> None:
    """One line with a guess, exit code 2, and what was computed before is still there."""
    assert run("study", "mine.py:chain", "-a", "pgs", "--size", "9").exit_code == 0
    (here / "s.toml").write_text(FILE.replace(old, new), encoding="utf-8")
    done = run("study", "s.toml")
    assert done.exit_code == 2, done.output
    assert words in done.output
    assert len(rows()) == 1


def test_code_that_raises_loses_nothing(here: Path) -> None:
    """A method that raises and a size that is refused stand below the table, in words; the rest is measured."""
    done = run(
        "study", "mine.py:even", "-a", "mine.py:Raises", "-a", "psor", "--size", "4", "--size", "5"
    )
    assert done.exit_code == 1
    assert "ERROR raises on even of size 4: mine.py, line " in done.output
    assert "REFUSED on even of size 5: mine.py, line " in done.output
    assert [row["status"] for row in rows()] == ["ERROR", "SOLVED", "REFUSED", "REFUSED"]
    (here / "mine.py").write_text(OWN.replace("z0[problem.n + 1]", "z0"), encoding="utf-8")
    again = run("study", "mine.py:even", "-a", "mine.py:Raises", "-a", "psor", "--size", "4")
    assert "1 of them from a former run" in again.output, again.output


@pytest.mark.full
def test_ctrl_c_in_a_shell_and_on(here: Path) -> None:
    """A study of a process of its own, interrupted: exit code 1, rows kept; the same command ends it."""
    command = [
        sys.executable,
        "-m",
        "lcp_plugin",
        "study",
        "mine.py:chain",
        "-a",
        "mine.py:Damped",
        "-a",
        "psor",
        *(word for size in range(5000, 25000, 1000) for word in ("--size", str(size))),
    ]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=here,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    while not (Path("study.csv").exists() and len(rows()) >= 2):
        time.sleep(0.02)
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 1, out
    kept = len(rows())
    assert 2 <= kept < 40
    assert "the same command goes on from here" in out
    again = subprocess.run(
        command, capture_output=True, text=True, cwd=here, timeout=120, check=True
    )
    assert f"study.csv: 40 rows, {kept} of them from a former run" in again.stdout
