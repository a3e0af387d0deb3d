"""`lcp-plugin solve --backend petsc`: the answer of one process, from any number of ranks, told once."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from launch import ROOT, run, run_code

from lcp_plugin import LCP, Certificate, gallery

PETSC = ("--backend", "petsc")

COMPARE = """
import numpy as np
from mpi4py import MPI
from lcp_plugin import gallery
from lcp_plugin.commands import distributed as scenes
from lcp_plugin.ranks.petsc.collective import ends_together
from lcp_plugin.ranks.petsc.halo import numbered_over_all

def compare(name, size, shifted):
    part = scenes.scene_on_ranks(name, MPI.COMM_WORLD, dict(size=size, shifted=shifted)).problem
    whole = gallery.build(name, size=size, shifted=shifted).problem
    own = part.own_rows
    rows = numbered_over_all(part.matrix.csr_rows, part.matrix.communicator)
    M = whole.csr[own]
    for one, other in ((rows.indptr, M.indptr), (rows.indices, M.indices), (rows.data, M.data)):
        assert np.array_equal(one, other), (name, size, shifted)
    for vector in ("q", "lower", "upper"):
        assert np.array_equal(getattr(part, vector), getattr(whole, vector)[own]), (name, size, shifted, vector)

with ends_together():
    for name, sizes in (("obstacle_2d", (1, 2, 3, 17)), ("obstacle_3d", (1, 2, 6))):
        for size in sizes:
            for shifted in (False, True):
                compare(name, size, shifted)
print("the same", flush=True)
"""


def command(ranks: int, *words: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    return run(ranks, "-m", "lcp_plugin", *words, timeout=timeout)


@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_rows_of_scenes_are_the_gallery_s(ranks: int) -> None:
    """Each rank's own rows of both obstacles, plain and shifted, are the gallery's bit for bit."""
    end = run_code(ranks, COMPARE)
    assert end.stdout.count("the same") == ranks, end.stderr


@pytest.mark.parametrize("ranks", [1, 2, 4])
def test_the_saved_answer_solves_the_gallery_s_problem(tmp_path: Path, ranks: int) -> None:
    """z.npy and w.npy hold the whole answer in order, one process judges it solved, and the story is told once."""
    folder = tmp_path / "answer"
    end = command(
        ranks, "solve", "obstacle-2d", "--size", "60", *PETSC, "--out", str(folder), "--error-bound"
    )
    assert end.returncode == 0, end.stderr
    assert end.stdout.count("SOLVED") == 1
    assert f"ranks={ranks}" in end.stdout
    assert "from the continuum" in end.stdout
    assert "MB" in end.stdout
    assert end.stderr == ""
    assert sorted(path.name for path in folder.iterdir()) == ["status.json", "w.npy", "z.npy"]
    problem = gallery.build("obstacle_2d", size=60).problem
    z, w = np.load(folder / "z.npy"), np.load(folder / "w.npy")
    assert Certificate.of(problem, z).relative_residual <= 1e-8
    np.testing.assert_allclose(w, problem.slack(z), rtol=0.0, atol=1e-12)
    status = json.loads((folder / "status.json").read_text(encoding="utf-8"))
    assert (status["status"], status["n"], status["ranks"]) == ("SOLVED", 3600, ranks)
    assert len(status["peak_memory_bytes"]) == ranks
    proven = next(line for line in end.stdout.splitlines() if line.startswith("proven: "))
    assert sum(int(word) for word in proven.replace(",", "").split() if word.isdigit()) == 2 * 3600


def test_json_is_one_document() -> None:
    """--json prints one document from all ranks, with the fields of one process and those of the ranks."""
    end = command(3, "solve", "obstacle_3d:size=8,shifted=true", *PETSC, "--json")
    assert end.returncode == 0, end.stderr
    content = json.loads(end.stdout)
    assert (content["status"], content["n"], content["ranks"]) == ("SOLVED", 512, 3)


def test_not_solved_is_exit_code_1() -> None:
    """A limit that comes first is told once; all ranks end with 1."""
    end = command(2, "solve", "obstacle-2d", "--size", "40", *PETSC, "--max-iterations", "1")
    assert end.returncode == 1
    assert end.stdout.count("MAX_ITERATIONS") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("obstacle-2d", "--size", "0"), "size must be an integer, ≥ 1, got 0"),
        (("obstacle-2d:size=5", "--size", "6"), "the size is given twice"),
        (("obstacle-2d:sice=5",), "no parameter 'sice'; did you mean 'size'?"),
        (("obstcle-2d",), "neither a file nor a scene; did you mean 'obstacle_2d'?"),
        (("missing.npz",), "no such file: missing.npz"),
        (("missing.npz", "--size", "3"), "--size 3 is for a scene"),
        (("obstacle-2d", "--plot", "a.png"), "--plot is not offered with --backend petsc"),
        (("obstacle-2d", "-a", "lemke"), "'lemke' does not run on several ranks"),
        (("obstacle-2d", "-a", "npgs", "-o", "color=1"), "color"),
        (("obstacle-2d", "--tolerance", "-1"), "tolerance must be finite and not negative"),
        (("obstacle-2d", "--out", "missing/answer"), "the folder missing does not exist"),
        (("obstacle-2d", "--out", "answer.npz"), "--out names a folder"),
        (("american-put-march",), "is a march in time"),
        (("obstacle-2d", "--measur", "x"), "No such option: --measur"),
        (("murty:n=5", "-a", "npgs", "--max-seconds", "x"), "Invalid value for '--max-seconds'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_input_is_told_once(words: tuple[str, ...], message: str) -> None:
    """What cannot be run ends all ranks with 2 and one message, without a traceback."""
    end = command(2, "solve", *words, *PETSC)
    assert end.returncode == 2, end.stderr
    said = " ".join(end.stderr.replace("│", " ").split())
    assert said.count(message) == 1, end.stderr
    assert "Traceback" not in said
    assert end.stdout == ""


def test_files_of_one_process_are_cut(tmp_path: Path) -> None:
    """A .npz file and a Matrix Market folder are read whole, cut and solved; the start of a scene is used."""
    rng = np.random.default_rng(3)
    n = 40
    M = sp.csr_array(
        sp.diags_array(
            [np.full(n - 1, -1.0), np.full(n, 3.0), np.full(n - 1, -1.0)], offsets=[-1, 0, 1]
        )
    )
    z = np.maximum(rng.normal(size=n), 0.0)
    problem = LCP(M, np.where(z > 0.0, 0.0, 1.0) - M @ z)
    for name in ("problem.npz", "folder"):
        problem.save(tmp_path / name)
        end = command(
            3,
            "solve",
            str(tmp_path / name),
            *PETSC,
            "-a",
            "npgs",
            "--out",
            str(tmp_path / "answer"),
        )
        assert end.returncode == 0, end.stderr
        np.testing.assert_allclose(np.load(tmp_path / "answer" / "z.npy"), z, rtol=0.0, atol=1e-7)
    end = command(2, "solve", "paper-example-1", *PETSC)
    assert end.returncode == 0, end.stderr
    assert "true error" in end.stdout


def test_a_saved_problem_is_read_in_parts(tmp_path: Path) -> None:
    """What LCP.save wrote on three ranks, the command solves on two."""
    code = f"""
from mpi4py import MPI
from lcp_plugin.commands import distributed as scenes
scenes.scene_on_ranks("obstacle_2d", MPI.COMM_WORLD, dict(size=20)).problem.save({str(tmp_path / "parts")!r})
"""
    end = run_code(3, code)
    assert end.returncode == 0, end.stderr
    end = command(2, "solve", str(tmp_path / "parts"), *PETSC)
    assert end.returncode == 0, end.stderr
    assert "n=400" in end.stdout


def test_a_note_says_what_is_built_whole() -> None:
    """A large scene that each rank builds whole is announced once, beside the answer."""
    end = command(2, "solve", "obstacle_bumps:size=320", *PETSC, "--json", "--max-iterations", "1")
    assert end.stderr.count("note: obstacle_bumps is built whole on each of the 2 ranks") == 1
    json.loads(end.stdout)


def test_out_replaces_an_older_answer_and_nothing_else(tmp_path: Path) -> None:
    """A second answer replaces the first; other files of the folder stay; a file in its place is refused."""
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    for size in ("5", "6"):
        assert (
            command(
                2, "solve", "obstacle-2d", "--size", size, *PETSC, "--out", str(tmp_path)
            ).returncode
            == 0
        )
    assert np.load(tmp_path / "z.npy").shape == (36,)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "notes.txt",
        "status.json",
        "w.npy",
        "z.npy",
    ]
    end = command(2, "solve", "obstacle-2d", *PETSC, "--out", str(tmp_path / "notes.txt"))
    assert end.returncode == 2
    assert "it is a file" in end.stderr


def test_solve_takes_rows_on_ranks() -> None:
    """lcp_plugin.solve takes an LCP with its rows on ranks and gives every rank its own part."""
    code = """
from mpi4py import MPI
from lcp_plugin import solve
from lcp_plugin.commands import distributed as scenes
problem = scenes.scene_on_ranks("obstacle_2d", MPI.COMM_WORLD, dict(size=30)).problem
result = solve(problem, "npgs", tolerance=1e-6).require_solved()
assert result.z.shape == (problem.q.size,)
print("solved", flush=True)
"""
    end = run_code(2, code)
    assert end.stdout.count("solved") == 2, end.stderr


def without(package: str, *words: str) -> subprocess.CompletedProcess[str]:
    """The command in one process that has no such package."""
    code = f"import sys; sys.modules[{package!r}] = None; sys.argv[1:] = {list(words)!r}"
    return plain("-c", f"{code}\nfrom lcp_plugin.commands import cli\ncli.run()")


def plain(*words: str) -> subprocess.CompletedProcess[str]:
    """Python in one process, no mpiexec around it."""
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, cwd=ROOT, timeout=60, check=False
    )


@pytest.mark.parametrize("package", ["petsc4py", "mpi4py"])
def test_a_missing_package_is_named_with_its_remedy(package: str) -> None:
    """Without petsc4py or mpi4py the backend is refused with the line that installs it; serial runs need neither."""
    end = without(package, "solve", "murty:n=4", *PETSC)
    assert end.returncode == 2
    assert package in end.stderr
    assert "pip install 'lcp_plugin[petsc]'" in end.stderr
    assert "Traceback" not in end.stderr
    assert without(package, "solve", "murty:n=4").returncode == 0


def test_without_mpiexec_there_is_one_rank() -> None:
    """The backend runs in a plain process; --size and dashes serve the serial backend too; another one is refused."""
    solve = ("-m", "lcp_plugin", "solve")
    end = plain(*solve, "obstacle-2d", "--size", "20", *PETSC)
    assert end.returncode == 0, end.stderr
    assert "ranks=1" in end.stdout
    assert "n=400" in plain(*solve, "obstacle-2d", "--size", "20").stdout
    assert "did you mean 'petsc'?" in plain(*solve, "obstacle-2d", "--backend", "pets").stderr
