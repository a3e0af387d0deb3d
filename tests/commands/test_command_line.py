"""The command line: output, files, exit codes, and messages for mistyped arguments."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.scenes import SMALL
from tools.nl_files import content_of
from tools.processes import lcp_plugin

from lcp_plugin import LCP, Status, gallery, solve
from lcp_plugin.algorithms import REGISTRY, algorithm_class
from lcp_plugin.engines import ENGINES, engine_class
from lcp_plugin.interfaces.nl import write_nl
from lcp_plugin.problems.cones.methods import CONE_METHODS

BOX = LCP(
    [[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]],
    [-5.0, 1.0, 2.0],
    upper=[2.0, np.inf, np.inf],
)
PNG = b"\x89PNG\r\n\x1a\n"

# Every test problem at a size that takes no time, and some also at sizes with a degenerate figure.
SMALL_SCENES = [*SMALL, "obstacle_2d:size=1"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A current folder of its own, so that relative paths are typed as a user would and leftovers are seen."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def in_a_process(*arguments: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """The command as a person runs it."""
    return subprocess.run(
        [sys.executable, "-m", "lcp_plugin", *arguments],
        capture_output=True,
        check=False,
        env={**os.environ, **environment},
    )


# --- solve -----------------------------------------------------------------------------------------------------


def test_settings_reach_the_run():
    """Tolerance, relaxation and options have the same effect as in solve."""
    arguments = (
        "-a npaor -o relaxation=1.5 -o acceleration=0.5 -o scaling=diagonal -o sweep=symmetric"
    )
    done = lcp_plugin(
        "solve", "obstacle_2d:size=12", *arguments.split(), "--tolerance", "1e-4", "--json"
    )
    ours = solve(
        gallery.build("obstacle_2d", size=12).problem,
        "npaor",
        relaxation=1.5,
        acceleration=0.5,
        scaling="diagonal",
        sweep="symmetric",
        tolerance=1e-4,
    )
    told = json.loads(done.stdout)
    assert told["iterations"] == ours.iterations > 0
    assert told["relative_residual"] == ours.residual
    assert told["tolerance"] == 1e-4


def test_json_is_all_there_is_on_stdout():
    """--json prints one JSON object with the numbers of the run and nothing else; the rest goes to stderr."""
    done = lcp_plugin("solve", "obstacle_2d:size=10", "-a", "npsor", "--json", "--out", "z.npz")
    told = json.loads(done.stdout, parse_constant=pytest.fail)
    ours = solve(gallery.build("obstacle_2d", size=10).problem, "npsor")
    assert done.exit_code == 0
    assert (told["status"], told["algorithm"], told["n"]) == ("SOLVED", "npsor", 100)
    assert (told["iterations"], told["work"]) == (ours.iterations, ours.work)
    for name in (
        "relative_residual",
        "natural_residual",
        "euclidean_residual",
        "bound_violation",
        "complementarity",
    ):
        assert told[name] == getattr(ours.certificate, name)
    assert told["advice"] == Status.SOLVED.value
    assert "saved z.npz" in done.stderr


def test_json_of_an_unsolved_run_is_json():
    """The JSON of a run without a solution is valid: a bound of the objective that is infinite is null; exit code 1."""
    rows = {"partners": np.array([0, -1]), "row_lower": np.array([-np.inf, 0.0])}
    model = content_of([[1.0, 1.0], [0.0, 1.0]], [-1.0, 0.0], objective=[0.0, -1.0], **rows)
    write_nl(model, Path("m.nl"))
    done = lcp_plugin("solve", "m.nl", "--json")
    assert done.exit_code == 1
    told = json.loads(done.stdout, parse_constant=pytest.fail)
    assert (told["status"], told["lower_bound"]) == ("UNBOUNDED", None)


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ({"P": np.eye(2), "c": np.ones(2)}, "x inequality equality lower upper"),
        ({"A": np.eye(2), "b": np.ones(2)}, "x"),
    ],
    ids=["program", "least squares"],
)
def test_out_holds_the_vectors_of_the_class(given, names):
    """--out writes x and the multipliers of a program, x of least squares, and the status."""
    np.savez("p.npz", **given)
    assert lcp_plugin("solve", "p.npz", "--out", "z.npz").exit_code == 0
    with np.load("z.npz") as saved:
        assert set(saved.files) == {*names.split(), "status"}


def test_out_replaces_an_earlier_answer_but_not_the_problem():
    """Option --out overwrites an earlier result, but not the file of the problem."""
    BOX.save("p.npz")
    lcp_plugin("solve", "half_active:n=4", "--out", "z.npz")
    assert lcp_plugin("solve", "p.npz", "--out", "z.npz").exit_code == 0
    with np.load("z.npz") as saved:
        assert saved["z"].size == 3
    assert lcp_plugin("solve", "p.npz", "--out", "./p.npz").exit_code == 2
    assert str(LCP.load("p.npz")) == str(BOX)


@pytest.mark.parametrize(
    ("limit", "status"),
    [("--max-iterations=3", Status.MAX_ITERATIONS), ("--max-seconds=0", Status.MAX_SECONDS)],
)
def test_unsolved_is_exit_code_one_with_advice(limit, status):
    """A limit gives exit code 1, the status and its advice are printed, and --out is written."""
    done = lcp_plugin("solve", "obstacle_2d:size=20", "-a", "npgs", limit, "--out", "z.npz")
    assert done.exit_code == 1
    happened, _, to_do = status.value.partition("; ")
    assert f"{status.name}: {happened}\n" in done.stdout
    assert '\nnext: try algorithm="auto", or ' in done.stdout
    assert to_do.removeprefix("next: ") in done.stdout
    assert done.stderr == ""
    with np.load("z.npz") as saved:
        assert str(saved["status"]) == status.name


# --- figures ---------------------------------------------------------------------------------------------------


@pytest.mark.quick(1)
@pytest.mark.parametrize("scene", SMALL_SCENES)
def test_every_scene_is_solved_and_has_a_picture(scene):
    """Exit code 0, problem, size and status; a PNG for one, two and three dimensions, no grid, and a single unknown."""
    done = lcp_plugin("solve", scene, "--plot", "out.png")
    assert (done.exit_code, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0].startswith(f"Scene({scene.partition(':')[0]}")
    assert lines[1].startswith(f"LCP(n={gallery.parse(scene).problem.n}, ")
    assert any(line.startswith("SOLVED: ") for line in lines)
    picture = Path("out.png").read_bytes()
    assert picture.startswith(PNG)
    assert len(picture) > 5000
    assert "saved out.png" in done.stdout
    assert list(Path().iterdir()) == [Path("out.png")]


def test_without_matplotlib_nothing_is_solved(monkeypatch):
    """Without matplotlib, --plot ends with the command to install it, before any solve."""
    for module in ("matplotlib", "matplotlib.figure"):
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(
        "lcp_plugin.commands.solving.solve", lambda *_, **__: pytest.fail("it was solved")
    )
    done = lcp_plugin("solve", "half_active:n=4", "--plot", "out.png")
    assert done.exit_code == 2
    assert re.fullmatch(
        r"lcp-plugin: .*matplotlib.*pip install matplotlib .*\[report\].*\n", done.stderr
    )
    assert list(Path().iterdir()) == []


# --- bad input -------------------------------------------------------------------------------------------------


def write_inputs() -> None:
    """Write the files of the table below."""
    BOX.save("box.npz")
    np.savez("qp.npz", P_data=np.ones(1), q=np.ones(1), A_data=np.ones(1))
    np.savez("ok.npz", P=np.eye(2), c=np.ones(2))
    np.savez("fit.npz", A=np.eye(2), b=np.ones(2))
    Path("empty").mkdir()
    Path("taken.png").mkdir()
    Path("taken.npz").mkdir()
    Path("M.mtx").write_text("%%MatrixMarket matrix array real general\n1 1\n2\n")


SOLVE = "solve half_active:n=4 "
BAD_INPUT = [
    ("solve missing", r"'missing' is neither a file nor a test problem.*known: "),
    ("solve empty", r"cannot read empty: expected an \.npz, "),
    ("solve M.mtx", r"no such file: q\.mtx"),
    ("solve qp.npz", r"qp\.npz lacks the keys .*a sparse P is P_data, P_indices"),
    (
        "solve half_activ",
        r"'half_activ' is neither a file nor a test problem; did you mean 'half_active'\?",
    ),
    ("solve obstacle_2d:sise=4", r"'obstacle_2d' has no parameter 'sise'; did you mean 'size'\?"),
    ("solve half_active:n", r"an option is name=value, .* got 'n'"),
    ("solve half_active:n=4,n=9", r"the option n is given twice"),
    ("solve half_active:n=four", r"n must be an integer .*got 'four'"),
    ("solve ok.npz -a psorr", "'psor'"),
    ("solve fit.npz -a psor", "no algorithm for a BoundedLeastSquares"),
    ("compare obstacle_2d:size=4 -a psr", r"unknown algorithm 'psr'; did you mean 'psor'\?"),
    ("compare obstacle_2d:size=4 -a psor --plot out.txt", r"must end in \.png"),
    (SOLVE + "-a psor -o relaxation", r"is name=value, .* got 'relaxation'"),
    (SOLVE + "-o relaxation=1.5", r"auto.*\['relaxation'\].*name an algorithm"),
    (SOLVE + "-a npsor -o tolerance=1e-3", r"tolerance"),
    (SOLVE + "-a npsor -o callback=3", r"'?callback'?"),
    (SOLVE + "--tolerance -1", r"tolerance must be finite and not negative, got -1"),
    (SOLVE + "--plot out.txt", r"must end in \.png, \.pdf, \.svg, got 'out\.txt'"),
    (SOLVE + "--plot taken.png", r"cannot write taken\.png"),
    (SOLVE + "--out taken.npz", r"it is a folder"),
    (SOLVE + "--out z.txt", r"--out writes an \.npz file, got 'z\.txt'"),
    (
        SOLVE + "--out missing/z.npz",
        r"cannot write missing/z\.npz: the folder missing does not exist",
    ),
]


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("arguments", "pattern"), BAD_INPUT, ids=[arguments for arguments, _ in BAD_INPUT]
)
def test_bad_input_is_one_line_and_exit_code_two(arguments, pattern, folder):
    """A mistake gives one readable line on stderr and exit code 2, and changes no file."""
    write_inputs()
    before = {f: f.read_bytes() for f in folder.rglob("*") if f.is_file()}
    done = lcp_plugin(*arguments.split())
    assert done.exit_code == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert re.match(f"lcp-plugin: .*{pattern}", done.stderr), done.stderr
    assert len(done.stderr) < 400
    assert {f: f.read_bytes() for f in folder.rglob("*") if f.is_file()} == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("slove half_active", "'slove'"),
        ("solve", "target"),
        ("solve half_active n=4", "n=4"),
        (SOLVE + "--jsn", "--json"),
        ("tables", "tables"),
    ],
)
def test_wrong_grammar_is_exit_code_two(arguments, words):
    """A command, option or kind of value that does not exist: exit code 2, the culprit on stderr."""
    done = lcp_plugin(*arguments.split())
    assert done.exit_code == 2
    assert done.stdout == ""
    assert words in done.stderr.lower()  # typer 0.16 writes TARGET


def test_repeated_option_is_refused():
    """An option that is given twice, in any spelling, is an error."""
    for arguments in ("-o relaxation=1.5 -o relaxation=1.2", "-o sweep=forward -o sweep=backward"):
        done = lcp_plugin("solve", "half_active:n=4", "-a", "psor", *arguments.split())
        assert done.exit_code == 2
        assert re.match(r"lcp-plugin: .*(relaxation|sweep)", done.stderr)


def test_failing_write_is_told_and_leaves_nothing(monkeypatch, folder):
    """A disk that fills up while --out is written: one line with the reason, exit code 2, no file."""

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    done = lcp_plugin("solve", "half_active:n=4", "--out", "z.npz")
    assert done.exit_code == 2
    assert re.fullmatch(
        r"lcp-plugin: cannot write z\.npz: No space left on device.*\n", done.stderr
    )
    assert list(folder.iterdir()) == []


# --- compare, list --------------------------------------------------------------------------------


def test_compare_prints_and_saves_error_against_time():
    """The command prints a line per algorithm and reference, and writes a figure."""
    words = "compare obstacle-2d:size=8 -a npsor -a psor --reference CLARABEL --repeats 1"
    done = lcp_plugin(*words.split(), "--plot", "out.png")
    assert done.exit_code == 0, done.output
    for name, status in (("npsor", "SOLVED"), ("psor", "SOLVED"), ("CLARABEL", "OPTIMAL")):
        assert re.search(rf"^{name} +{status} .* s, rigorous bound ", done.stdout, re.MULTILINE)
    assert Path("out.png").read_bytes().startswith(PNG)


def test_a_tolerance_of_zero_is_one():
    """--tolerance 0 reaches the runs of solve and compare: they end at the rounding level, not at 1e-8."""
    told = json.loads(
        lcp_plugin("solve", "obstacle_2d:size=6", "--tolerance", "0", "--json").stdout
    )
    assert told["tolerance"] == 0.0
    done = lcp_plugin(
        "compare", "obstacle_2d:size=6", "-a", "psor", "--tolerance", "0", "--repeats", "1"
    )
    assert float(re.search(r"rigorous bound (\S+)", done.stdout)[1]) < 1e-14


def test_list_shows_everything_there_is():
    """Every algorithm, engine and their sources, and every scene with its parameters and defaults are in the list."""
    done = lcp_plugin("list")
    assert done.exit_code == 0
    rows = re.findall(r"^ (\w+) {2,}\S", done.stdout.partition("Algorithms")[2], re.MULTILINE)
    assert [row for row in rows if row != "name"] == [
        *REGISTRY,
        *CONE_METHODS,
        *ENGINES,
        *gallery.names(),
    ]
    assert all(algorithm_class(name).reference in done.stdout for name in REGISTRY)
    assert all(kind.reference in done.stdout for kind in CONE_METHODS.values())
    assert all(engine_class(name).reference in done.stdout for name in ENGINES)
    for _, _, parameters in gallery.describe():
        for key, value in parameters.items():
            assert f"{key}={value}" in done.stdout


@pytest.mark.parametrize(
    ("name", "option"),
    [("daqp", "iter_limit=50"), ("piqp", "max_iter=50"), ("clarabel", "max_iter=50")],
)
def test_an_engine_solves_the_program_of_a_file(name, option):
    """`solve FILE -a ENGINE` finds the known minimum with its options, and rejects others."""
    matrices = {"P": sp.csc_array([[2.0, 0.0], [0.0, 2.0]]), "A": sp.csc_array([[1.0, 1.0]])}
    parts = {
        f"{key}_{part}": getattr(one, part)
        for key, one in matrices.items()
        for part in ("shape", "data", "indices", "indptr")
    }
    np.savez("program.npz", q=[-2.0, -5.0], l=[-np.inf], u=[1.0], **parts)
    for more in ((), ("-o", option)):
        done = lcp_plugin("solve", "program.npz", "-a", name, *more, "--json")
        assert done.exit_code == 0, done.output
        content = json.loads(done.stdout)
        assert content["algorithm"] == name
        assert content["objective"] == pytest.approx(-4.125, abs=1e-9)
    refused = lcp_plugin("solve", "program.npz", "-a", name, "-o", "omega=1.5")
    assert refused.exit_code == 2
    assert f"{name} does not take omega" in refused.stderr


# --- as a process ----------------------------------------------------------------------------------------------


@pytest.mark.full
def test_exit_codes_reach_the_shell():
    """The process itself ends with 1 where a run is not solved and with 2 on bad input, without a traceback."""
    unsolved = in_a_process("solve", "obstacle_2d:size=6", "--max-iterations", "0")
    assert (unsolved.returncode, unsolved.stderr) == (1, b"")
    bad = in_a_process("solve", "half_activ")
    assert (bad.returncode, bad.stdout) == (2, b"")
    assert re.match(rb"lcp-plugin: .*did you mean 'half_active'\?", bad.stderr)


BUFFERED = {**os.environ, "PYTHONUNBUFFERED": ""}  # as on most machines: what is written fails late


@pytest.mark.full
@pytest.mark.parametrize("arguments", ["solve half_active:n=4", "list"])
def test_reader_that_has_gone(arguments):
    """If the reader of the pipe has ended, as after ``| head -1``, the command ends silently."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "lcp_plugin", *arguments.split()],
        stdout=writer,
        stderr=subprocess.PIPE,
        check=False,
        env=BUFFERED,
    )
    os.close(writer)
    assert done.stderr == b""
    assert done.returncode in {0, 1}


@pytest.mark.full
def test_ctrl_c_prints_the_best_so_far():
    """Ctrl-C in a long run ends it with INTERRUPTED, the result of the best iterate, --out written, exit code 1.

    The terminal's progress line shows that the run has started, so that the test does not depend on a clock.
    """
    pty = pytest.importorskip("pty", reason="terminals are a thing of Unix")
    ours, theirs = pty.openpty()
    command = "solve obstacle_2d:size=600 -a npgs --tolerance 1e-14 --out z.npz"
    running = subprocess.Popen(
        [sys.executable, "-m", "lcp_plugin", *command.split()],
        stdout=subprocess.PIPE,
        stderr=theirs,
    )
    os.close(theirs)
    try:
        shown = b""
        give_up = time.monotonic() + 120.0
        with suppress(OSError):  # if the process has ended, its output is shown
            while b"iteration" not in shown and time.monotonic() < give_up:
                shown += os.read(ours, 4096)
        assert b"npgs: iteration" in shown, shown.decode()
        assert b"Ctrl-C" in shown
        running.send_signal(signal.SIGINT)
        stdout, _ = running.communicate(timeout=120)
    finally:
        running.kill()
        running.wait()
        assert running.stdout
        running.stdout.close()
        os.close(ours)
    assert running.returncode == 1
    text = stdout.decode()
    happened, _, to_do = Status.INTERRUPTED.value.partition("; ")
    assert f"INTERRUPTED: {happened}\n" in text
    assert f"\n{to_do}" in text
    residual = re.search(r"relative residual (\S+), tolerance 1e-14", text)
    assert residual
    assert 0.0 < float(residual[1]) <= 1.0  # after one sweep .9999
    assert "Traceback" not in text
    with np.load("z.npz") as saved:
        assert str(saved["status"]) == "INTERRUPTED"
        assert saved["z"].any()
