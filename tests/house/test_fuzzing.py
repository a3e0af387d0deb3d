"""Mutated files are refused in words or valid."""

from __future__ import annotations

import io
import warnings
import zipfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_plugin import LCP, LCPError

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


KEYS = ("data", "indices", "indptr", "shape", "q", "lower", "upper")


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
