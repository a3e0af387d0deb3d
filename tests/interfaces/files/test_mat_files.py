"""MATLAB's files: what MATLAB and scipy have written is read, what is damaged or no matrix is refused in words."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io.matlab
import scipy.sparse as sp
from scipy.io import loadmat, savemat, whosmat
from tools.processes import lcp_plugin

from lcp_plugin import LCP, UnreadableFile
from lcp_plugin.core.files import read_mat

M = np.array([[4.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 4.0]])
# not in every installation
WRITTEN_BY_MATLAB = sorted(Path(scipy.io.matlab.__file__).parent.glob("tests/data/*.mat"))


def written(content: dict[str, Any], **how: Any) -> bytes:
    buffer = io.BytesIO()
    savemat(buffer, content, **how)
    return buffer.getvalue()


HOW = [{"format": "4"}, {"format": "5"}, {"format": "5", "do_compression": True}]
VECTORS = {
    "q": [[-3.0], [5.0], [-1.0]],
    "lower": [0.0, -1.0, -1e20],
    "ub": [[1.0], [np.inf], [9.0]],
}
WHOLE = [written({"M": matrix, **VECTORS}, **how) for how in HOW for matrix in (sp.csc_array(M), M)]


@pytest.mark.parametrize("whole", WHOLE, ids=range(len(WHOLE)))
def test_what_scipy_writes_is_read(whole: bytes, tmp_path: Path) -> None:
    """Versions 4, 5 and 7, M sparse or dense, q a row or a column, bounds by MATLAB's names."""
    (tmp_path / "p.mat").write_bytes(whole)
    problem = LCP.load(tmp_path / "p.mat")
    np.testing.assert_array_equal(problem.csr.toarray(), M)
    assert problem.q.tolist() == [-3.0, 5.0, -1.0]
    assert (problem.lower.tolist(), problem.upper.tolist()) == (
        [0.0, -1.0, -np.inf],
        [1.0, np.inf, 9.0],
    )


@pytest.mark.parametrize("source", WRITTEN_BY_MATLAB, ids=lambda source: source.stem)
def test_what_matlab_wrote_is_what_scipy_reads(source: Path) -> None:
    """Of the files of scipy's own tests, of either byte order: the same numbers, or a refusal."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            names = [name for name, *_ in whosmat(source) if not name.startswith("_")]
            theirs = loadmat(source, spmatrix=False)
        except Exception:  # damaged, or of version 7.3
            names, theirs = ["M"], {}
    for name in names:
        try:
            ours = read_mat(source, {name})[0][name]
        except (UnreadableFile, KeyError):
            continue
        dense, expected = (
            one.toarray() if sp.issparse(one) else one for one in (ours, theirs.get(name))
        )
        np.testing.assert_array_equal(dense, expected)


def test_command_solves_a_mat_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``lcp-plugin solve p.mat``."""
    monkeypatch.chdir(tmp_path)
    Path("p.mat").write_bytes(WHOLE[0])
    done = lcp_plugin("solve", "p.mat", "--json")
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"N": M, "r": [1.0]}, r"lacks the keys \['M', 'q'\]; .* in MATLAB save\(\"p\.mat\""),
        (
            {"A": M, "b": [1.0]},
            r"holds a BoundedLeastSquares, not an LCP: lcp_plugin\.load_problem",
        ),
        ({"M": M, "q": [1.0, 2.0]}, r"states no LCP: .*length 3.*, got shape \(2,\)"),
        ({"M": {"a": 1}, "q": [1.0]}, "M is of the class struct; save a matrix of numbers"),
        ({"M": 1j * M, "q": np.ones(3)}, "M is complex; save real numbers"),
        (
            {"M": M, "q": np.ones(3), "lb": np.zeros(3), "lower": np.zeros(3)},
            "lower and lb, which are two names for one thing",
        ),
    ],
    ids=range(6),
)
def test_what_is_no_problem_is_refused(content: dict[str, Any], words: str, tmp_path: Path) -> None:
    """Each refusal names the file, what it holds and what is needed."""
    savemat(tmp_path / "p.mat", content)
    with pytest.raises(UnreadableFile, match=rf"p\.mat.*{words}|M of .*p\.mat.*{words}"):
        LCP.load(tmp_path / "p.mat")


def test_newer_files_are_refused_with_a_remedy(tmp_path: Path) -> None:
    """Version 7.3, which is HDF5: the command that writes an older one."""
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    (tmp_path / "p.mat").write_bytes(head.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n")
    with pytest.raises(
        UnreadableFile, match=r'7\.3 \(HDF5\); in MATLAB write save\("p\.mat", "M", "q", "-v7"\)'
    ):
        LCP.load(tmp_path / "p.mat")


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    """An empty file, and text."""
    for content in (b"", b"M = [1 2; 3 4];" * 40):
        (tmp_path / "p.mat").write_bytes(content)
        with pytest.raises(
            UnreadableFile, match=r"p\.mat: it is damaged or no \.mat file of numbers"
        ):
            LCP.load(tmp_path / "p.mat")
