"""Random and mutated files and command lines: a refusal in words, or something valid, and nothing else ever."""

from __future__ import annotations

import io
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from typer.testing import CliRunner

from lcp_plugin import LCP, LCPError
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.commands.cli import app

PROBLEM = LCP(
    [[4.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 4.0]],
    [-3.0, 5.0, -1.0],
    upper=[1.0, np.inf, 9.0],
)
TOKENS = (b"1e999", b"nan", b"-1", b"\x00", b"\xff\xfe", b"\n", b"%", b"9" * 25, b"i4", b"<O8")
FILES = ("M.mtx", "q.mtx", "lower.mtx", "upper.mtx")


def load(path: Path) -> LCP | None:
    """A valid problem, or None where it is refused in words; whatever else is raised passes."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            problem = LCP.load(path)
    except LCPError:
        return None
    assert np.isfinite(problem.csr.data).all()
    assert np.isfinite(problem.q).all()
    assert (problem.lower <= problem.upper).all()
    assert problem.csr.shape == (problem.n, problem.n) == (problem.q.size,) * 2
    assert problem.csr.has_canonical_format
    return problem


@st.composite
def mutated(draw: st.DrawFn, whole: bytes) -> bytes:
    """The bytes with pieces cut out, doubled, exchanged, and others put in."""
    content = bytearray(whole)
    for _ in range(draw(st.integers(1, 4))):
        start, end = sorted(draw(st.tuples(*[st.integers(0, len(content))] * 2)))
        end = min(end, start + draw(st.integers(0, 40)))
        kind = draw(st.sampled_from(("cut", "double", "put", "end")))
        if kind == "cut":
            del content[start:end]
        elif kind == "double":
            content[start:start] = content[start:end]
        elif kind == "put":
            content[start:end] = draw(st.sampled_from(TOKENS) | st.binary(max_size=8))
        else:
            del content[start:]
    return bytes(content)


def archive() -> bytes:
    buffer = io.BytesIO()
    csr = PROBLEM.csr
    np.savez(
        buffer, data=csr.data, indices=csr.indices, indptr=csr.indptr, shape=[3, 3], q=PROBLEM.q
    )
    return buffer.getvalue()


@given(content=mutated(archive()))
def test_mutated_archives_are_refused_or_valid(content, tmp_path):
    """An archive with pieces missing, doubled or wrong is refused, or states some valid problem."""
    (tmp_path / "p.npz").write_bytes(content)
    load(tmp_path / "p.npz")


TEXTS = {
    "M.mtx": b"%%MatrixMarket matrix coordinate real general\n% text\n2 2 3\n1 1 4.0\n1 2 -1e0\n2 2 4\n",
    "q.mtx": b"%%MatrixMarket matrix array real general\n2 1\n-3.0\n5\n",
    "symmetric": b"%%MatrixMarket matrix coordinate integer symmetric\n2 2 2\n1 1 4\n2 1 -1\n",
    "dense": b"%%MatrixMarket matrix array real general\n2 2\n4\n-1\n-1\n4\n",
}


@settings.get_profile("many")
@given(data=st.data())
def test_mutated_matrix_market_files_are_refused_or_valid(data, tmp_path):
    """A text file with pieces missing, doubled or wrong is refused, or states some valid problem."""
    for name in ("M.mtx", "q.mtx"):
        (tmp_path / name).write_bytes(TEXTS[name])
    kind = data.draw(st.sampled_from(list(TEXTS)))
    (tmp_path / (kind if kind in FILES else "M.mtx")).write_bytes(data.draw(mutated(TEXTS[kind])))
    load(tmp_path / "M.mtx")


def any_array() -> st.SearchStrategy[Any]:
    """Arrays of every kind that a file can hold without pickling."""
    kinds = (
        arrays.floating_dtypes()
        | arrays.integer_dtypes()
        | arrays.unsigned_integer_dtypes()
        | arrays.boolean_dtypes()
        | arrays.complex_number_dtypes()
        | arrays.unicode_string_dtypes(max_len=3)
        | arrays.datetime64_dtypes()
    )
    return arrays.arrays(kinds, arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))


KEYS = ("data", "indices", "indptr", "shape", "q", "lower", "upper")


@pytest.mark.full
@settings.get_profile("many")
@given(
    changes=st.dictionaries(
        st.sampled_from((*KEYS, "P_data", "other")), any_array() | st.none(), max_size=3
    )
)
def test_archives_of_other_arrays_are_refused_or_valid(changes, tmp_path):
    """A whole archive whose members have any type, shape and values is refused, or states some valid problem."""
    csr = PROBLEM.csr
    whole = {
        "data": csr.data,
        "indices": csr.indices,
        "indptr": csr.indptr,
        "shape": np.array([3, 3]),
    }
    whole |= {"q": PROBLEM.q, "lower": PROBLEM.lower, "upper": PROBLEM.upper}
    content = {key: value for key, value in (whole | changes).items() if value is not None}
    np.savez(tmp_path / "p.npz", **content)
    load(tmp_path / "p.npz")


def test_an_archive_may_lie_about_its_sizes(tmp_path):
    """A member that announces more than any memory holds is refused without being allocated."""
    for shape in ((2**40,), (2**62,), (2**31, 2**31), (-5,)):
        header = (
            f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape!r}, }}".ljust(117) + "\n"
        )
        member = (
            b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(16)
        )
        with zipfile.ZipFile(tmp_path / "p.npz", "w") as file:
            for key in KEYS[:5]:
                file.writestr(f"{key}.npy", member)
        assert load(tmp_path / "p.npz") is None


# --- The command ----------------------------------------------------------------------------------------------------

NUMBERS = st.sampled_from(
    ["0", "1", "-1", "3", "1e-3", "nan", "inf", "1e400", "", "x", "∞", "0x1", "1_0", "-0", "2"]
)
WORDS = st.sampled_from(
    ["", "--", "-", ".", "/", "//", "'", "a b", "\t", "-h", "--json", "ü", "=", ":", ",", "%s"]
)
SCENES = ("half_active:n=9", "obstacle_2d:size=4", "paper_example_1:n=9", "paper_example_2:n=4")
OPTIONS = st.sampled_from(["sweep", "scaling", "omega", "relaxation", "x", "", "tolerance"])
PATHS = ("p.npz", "M.mtx", "damaged.npz", "nothing.npz", "empty", "folder/")


@st.composite
def targets(draw: st.DrawFn) -> str:
    """A scene or a file, often misspelt or with parameters that make no sense."""
    target = draw(st.sampled_from((*SCENES, *PATHS)))
    if draw(st.booleans()):
        return target
    name = target.partition(":")[0]
    key = draw(st.sampled_from(["n", "size", "steps", "x", ""]))
    value = draw(NUMBERS)
    changed = [name[:-1], f"{name}:{key}={value}", f"{target},{key}={value}", f"{name}:{value}"]
    return draw(st.sampled_from(changed) | WORDS.map(lambda word: target + word) | WORDS)


@st.composite
def command_lines(draw: st.DrawFn) -> list[str]:
    """Arguments of a command, then mutated."""
    command = draw(st.sampled_from(["solve", "solve", "solve", "analyze", "list"]))
    line = [command] if command == "list" else [command, draw(targets())]
    options = {
        "--algorithm": st.sampled_from(["auto", *REGISTRY, "psr", ""]),
        "--option": st.builds(
            "{}={}".format, OPTIONS, NUMBERS | st.sampled_from(["forward", "none", "diagonal"])
        ),
        "--tolerance": NUMBERS,
        "--tolerance-on": st.sampled_from(["residual", "error", "x", ""]),
        "--max-iterations": NUMBERS,
        "--max-seconds": NUMBERS,
        "--out": st.sampled_from(["z.npz", "z.txt", "no/z.npz", "p.npz", "", "empty"]),
        "--json": st.none(),
    }
    if command == "solve":
        for name in draw(st.lists(st.sampled_from(list(options)), max_size=4)):
            value = draw(options[name])
            line += [name] if value is None else [name, value]
    if draw(st.integers(0, 2)) == 0 and line:
        place = draw(st.integers(0, len(line) - 1))
        kind = draw(st.sampled_from(["cut", "double", "word", "swap"]))
        if kind == "cut":
            del line[place]
        elif kind == "double":
            line.insert(place, line[place])
        elif kind == "word":
            line[place] = draw(WORDS | st.text(max_size=5))
        else:
            line[place], line[0] = line[0], line[place]
    # These compute for minutes, whatever follows.
    return line if not {"tables", "report"} & {*line} else ["list"]


@given(line=command_lines())
@example(line=["--"])
def test_mutated_commands_end_in_zero_one_or_two(line, tmp_path, monkeypatch):
    """Any arguments give exit code 0, 1 or 2, some words, and never a traceback."""
    monkeypatch.chdir(tmp_path)
    PROBLEM.save("p.npz")
    Path("damaged.npz").write_bytes(archive()[:99])
    Path("empty").write_bytes(b"")
    outcome = CliRunner().invoke(app, line)
    assert outcome.exit_code in (0, 1, 2), line
    assert outcome.exception is None or isinstance(outcome.exception, SystemExit), (
        line,
        outcome.exception,
    )
    assert "Traceback" not in outcome.output
    assert outcome.output, line
    if "p.npz" not in line[2:]:  # --out may replace another file than the problem
        assert LCP.load("p.npz").q.tolist() == PROBLEM.q.tolist()
