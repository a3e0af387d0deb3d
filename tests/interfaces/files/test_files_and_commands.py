"""Each subcommand with each file format works, or names the right command in one line."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from scipy.io import mmwrite
from tools.nl_files import content_of
from tools.processes import lcp_plugin

from lcp_plugin import LCP
from lcp_plugin.commands.cli import app
from lcp_plugin.interfaces.nl import write_nl
from lcp_plugin.interfaces.program_files import ARRAYS, MARKET, MPS, NL

M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-5.0, 1.0])
QPS = """NAME          TWO
OBJSENSE
    MAX
ROWS
 N  obj
 L  r1
COLUMNS
    first     obj        2.0   r1        1.0
    second    obj        4.0   r1        1.0
RHS
    rhs       r1        2.0
    rhs       obj      -3.0
QUADOBJ
    first     first     -2.0
    second    second    -2.0
ENDATA
"""
PLAIN = QPS[: QPS.index("QUADOBJ")] + "ENDATA\n"
LP = "maximize\n 2 first + 4 second\nsubject to\n first + second <= 2\nend\n"
PROGRAM = dict(P=M, q=q, A=[[1.0, 1.0]], l=[-np.inf], u=[2.0], lower=0.0)
FIT = dict(A=[[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], b=[2.0, 1.0, -1.0])


FILES: dict[str, tuple[str, Callable[[str], object]]] = {  # name: problem class, writer
    "lcp.npz": ("LCP", lambda path: np.savez(path, M=M, q=q)),
    "saved.npz": ("LCP", LCP(M, q).save),
    "M.mtx": ("LCP", lambda path: [mmwrite(path, M), mmwrite("q.mtx", q[:, None])]),
    "lcp.nl": ("LCP", lambda path: write_nl(content_of(M, q), path)),
    "qp.npz": ("program", lambda path: np.savez(path, **PROGRAM)),
    "qp.qps": ("program", lambda path: Path(path).write_text(QPS)),
    "lp.mps": ("program", lambda path: Path(path).write_text(PLAIN)),
    "lp.lp": ("program", lambda path: Path(path).write_text(LP)),
    "qp.nl": (
        "program",
        lambda path: write_nl(
            content_of(
                M,
                q,
                partners=np.array([-1, -1]),
                partner_bounds=np.array([0, 0]),
                objective=[1.0, 2.0],
                row_lower=np.array([0.0, 0.0]),
            ),
            path,
        ),
    ),
    "fit.npz": ("least squares", lambda path: np.savez(path, **FIT)),
}
DONE, REFUSED = 0, r"needs an LCP, got (?:QuadraticProgram|BoundedLeastSquares)"
CELLS: dict[
    str, dict[str, Any]
] = {  # subcommand: its exit code, or the pattern of its error message, for each problem class
    "solve": {"LCP": DONE, "program": DONE, "least squares": DONE},
    "analyze": {"LCP": DONE, "program": DONE, "least squares": DONE},
    "compare": {"LCP": DONE, "program": REFUSED, "least squares": REFUSED},
}
WITHOUT_FILES = {"list", "warm-up"}
HIGHS = (".qps", ".mps", ".lp")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A current folder of its own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_subcommand_and_every_format_has_its_row():
    """A new subcommand, or a new ending of files, fails here until it is walked."""
    assert {one.name for one in app.registered_commands} == {*CELLS, *WITHOUT_FILES}
    assert {Path(name).suffix for name in FILES} == {ARRAYS, *MPS, NL, MARKET}
    assert all(cells.keys() == {kind for kind, _ in FILES.values()} for cells in CELLS.values())


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("name", "command"), [(name, command) for name in FILES for command in CELLS]
)
def test_each_cell_works_or_names_what_the_command_needs(name, command):
    """Exit code 0 and something on stdout; or 2 and one line on stderr that names the class that it needs."""
    kind, write = FILES[name]
    expected = CELLS[command][kind]
    if name.endswith(HIGHS):
        pytest.importorskip("highspy")
    write(name)
    done = lcp_plugin(command, name)
    if expected is DONE:
        assert (done.exit_code, done.stderr) == (0, "")
        assert done.stdout
        return
    assert (done.exit_code, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert re.match(f"lcp-plugin: .*(?:{expected})", done.stderr), done.stderr


def test_files_of_mps_are_answered_in_their_own_terms():
    """The output uses the names of variables, and the objective of the file with its constant."""
    pytest.importorskip("highspy")
    Path("qp.qps").write_text(QPS)
    done = lcp_plugin("solve", "qp.qps", "--out", "out.npz")
    assert done.exit_code == 0
    # 2 x₁ + 4 x₂ − x₁² − x₂² + 3 at (½, 1½)
    assert "objective 7.5;" in done.stdout
    assert re.search(r"^first   0\.5\d*\nsecond  1\.5$", done.stdout, re.MULTILINE)
    with np.load("out.npz") as saved:
        assert saved["names"].tolist() == ["first", "second"]
        np.testing.assert_allclose(saved["inequality"], [1.0], atol=1e-7)


def test_the_tolerance_of_the_command_reaches_a_program():
    """Option --tolerance is passed on unchanged; without it a program uses its default."""
    np.savez("qp.npz", **PROGRAM)
    given = [
        json.loads(lcp_plugin("solve", "qp.npz", "--json", *words).stdout)["tolerance"]
        for words in ((), ("--tolerance", "1e-8"), ("--tolerance", "1e-4"))
    ]
    assert given == [1e-6, 1e-8, 1e-4]


def test_no_minimum_is_told_and_shows_no_point():
    """Infeasible and unbounded programs: exit code 1, the status and its proof, and no x that could be mistaken."""
    np.savez("no.npz", P=M, q=q, A=[[1.0, 0.0], [1.0, 0.0]], l=[-np.inf, 3.0], u=[2.0, 9.0])
    np.savez("falls.npz", c=q)
    for name, status in (("no.npz", "INFEASIBLE"), ("falls.npz", "UNBOUNDED")):
        done = lcp_plugin("solve", name)
        assert done.exit_code == 1
        assert f"\n{status}: " in done.stdout
        assert "x[0]" not in done.stdout


# --- Mistakes ---------------------------------------------------------------------------------------------------


def test_each_example_in_a_help_page_is_a_command():
    """The examples below each help page use existing subcommands and options."""
    group = typer.main.get_command(app)
    for name, command in group.commands.items():
        known = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
        lines = re.findall(r"^  lcp-plugin (.*)$", command.epilog, re.MULTILINE)
        assert lines, name
        for words in map(str.split, lines):
            assert words[0] == name
            assert {word for word in words if word.startswith("-")} <= known, words


def test_a_maximum_of_0_is_printed_without_a_sign(tmp_path):
    """The objective of a file to be maximized is the negative one of the program, and 0 is not −0."""
    path = tmp_path / "p.lp"
    path.write_text(LP.replace("2 first + 4", "- first - 4"))
    assert '"objective": 0.0' in lcp_plugin("solve", str(path), "--json").stdout
