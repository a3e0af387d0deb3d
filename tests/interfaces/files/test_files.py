"""Files: bit-identical round trips, errors for corrupt files, and no trace of a failed write."""

from __future__ import annotations

import errno
import io
import math
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_plugin import LCP, UnreadableFile
from lcp_plugin.core import files

INF = math.inf
M = np.array([[4.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 1 / 3]])
PROBLEM = LCP(M, [1e-320, 0.1, -3e300], lower=[-INF, 0.0, -1.0], upper=[INF, INF, 1.0])


def assert_same(one: LCP, other: LCP) -> None:
    """The same bits in every array."""
    for mine, theirs in zip(bits(one), bits(other), strict=True):
        assert mine == theirs
    assert (other.n, str(other)) == (one.n, str(one))


def bits(p: LCP) -> list[bytes]:
    return [a.tobytes() for a in (p.csr.data, p.csr.indices, p.csr.indptr, p.q, p.lower, p.upper)]


def keys(p: LCP) -> dict[str, Any]:
    """The documented layout: CSR of M, then q and the bounds."""
    return {
        "data": p.csr.data,
        "indices": p.csr.indices,
        "indptr": p.csr.indptr,
        "shape": np.array(p.csr.shape),
        "q": p.q,
        "lower": p.lower,
        "upper": p.upper,
    }


def npz(path: Path, **changes: Any) -> Path:
    """Write PROBLEM in the documented layout; a change of None leaves a key out."""
    content = {**keys(PROBLEM), **changes}
    np.savez(path, **{key: value for key, value in content.items() if value is not None})
    return path


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


# --- round trips -----------------------------------------------------------------------------------------------


FINITE = st.floats(allow_nan=False, allow_infinity=False)
BELOW_1E20 = st.floats(-9e19, 9e19)


@settings.get_profile("few")
@given(data=st.data(), n=st.integers(1, 4))
def test_round_trip_of_any_numbers(data, n, tmp_path):
    """A file preserves all doubles."""
    entries = data.draw(st.lists(FINITE, min_size=n * n, max_size=n * n))
    q = data.draw(st.lists(FINITE, min_size=n, max_size=n))
    low = data.draw(st.lists(st.one_of(st.just(-INF), BELOW_1E20), min_size=n, max_size=n))
    width = data.draw(
        st.lists(st.one_of(st.just(INF), st.floats(0.0, 1e10)), min_size=n, max_size=n)
    )
    with np.errstate(invalid="ignore"):
        upper = np.maximum(np.nan_to_num(np.add(low, width), nan=INF, posinf=INF, neginf=INF), low)
    p = LCP(np.array(entries).reshape(n, n), q, lower=low, upper=upper)
    p.save(tmp_path / "p.npz")
    loaded = LCP.load(tmp_path / "p.npz")
    for mine, theirs in zip(
        (p.q, p.lower, p.upper), (loaded.q, loaded.lower, loaded.upper), strict=True
    ):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(p.csr.toarray(), loaded.csr.toarray())


@pytest.mark.parametrize("name", ["a.mat", "deep/M.mtx", "problem.txt", "half.npy", "folder"])
def test_a_file_of_another_kind_is_not_written(name, tmp_path):
    """An unknown file extension raises an error that names the right one, and writes nothing."""
    words = rf"cannot write .*{name}: .*; write {Path(name).stem}\.npz"
    with pytest.raises(UnreadableFile, match=words):
        PROBLEM.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


# --- third-party layouts -----------------------------------------------------------------------------------------


def test_documented_keys_are_enough(tmp_path):
    """A file with the documented keys, in any dtype that fits, is read; other keys are ignored, pickled ones too."""
    small = {
        "indices": PROBLEM.csr.indices.astype(np.uint8),
        "indptr": PROBLEM.csr.indptr.astype(np.int64),
    }
    unknown = {
        "z_reference": np.zeros(3),
        "comment": np.array("contact"),
        "pickled": np.array([{}], dtype=object),
    }
    assert_same(PROBLEM, LCP.load(npz(tmp_path / "p.npz", **small, **unknown)))
    whole = LCP([[2.0, 1.0], [0.0, 2.0]], [1.0, 2.0])
    np.savez(
        tmp_path / "w.npz",
        **{key: value.astype(int) for key, value in keys(whole).items() if key[-3:] != "per"},
    )
    assert_same(whole, LCP.load(tmp_path / "w.npz"))


@pytest.mark.parametrize("left_out", [("lower",), ("upper",), ("lower", "upper")])
def test_missing_bounds_are_zero_and_infinity(left_out, tmp_path):
    """A file without lower or upper means 0 and ∞."""
    expected = {name: getattr(PROBLEM, name) for name in ("lower", "upper") if name not in left_out}
    p = LCP(M, PROBLEM.q, **expected)
    assert_same(p, LCP.load(npz(tmp_path / "p.npz", **dict.fromkeys(left_out))))


@pytest.mark.parametrize(
    "bounds", [{"lower": [0.0, 1e20, 0.0]}, {"lower": -np.inf, "upper": [1.0, -1e200, 1.0]}]
)
def test_huge_bounds_that_exclude_zero_come_back(bounds, tmp_path):
    """A lower bound of 1e20 and an upper one of −1e200 are bounds, in files too."""
    problem = LCP(M, PROBLEM.q, **bounds)
    problem.save(tmp_path / "p.npz")
    assert_same(problem, LCP.load(tmp_path / "p.npz"))


def test_matrix_market_as_others_write_it(tmp_path):
    """Symmetric, integer, dense and coordinate files, comments, and vectors as rows or with gaps are read."""
    entries = "% by hand\n3 3 3\n1 1 2\n2 1 -1\n3 3 5\n"
    (tmp_path / "M.mtx").write_text(
        "%%MatrixMarket matrix coordinate integer symmetric\n" + entries
    )
    (tmp_path / "q.mtx").write_text(
        "%%MatrixMarket matrix coordinate real general\n3 1 2\n3 1 -7.5\n1 1 1e-320\n"
    )
    (tmp_path / "lower.mtx").write_text(
        "%%MatrixMarket matrix array real general\n1 3\n-1\n-1e30\n0\n"
    )
    p = LCP.load(tmp_path / "M.mtx")
    np.testing.assert_array_equal(
        p.csr.toarray(), [[2.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 5.0]]
    )
    assert (p.q.tolist(), p.lower.tolist()) == ([1e-320, 0.0, -7.5], [-1.0, -INF, 0.0])
    (tmp_path / "M.mtx").write_text(
        "%%MatrixMarket matrix array real general\n3 3\n1\n2\n3\n4\n5\n6\n7\n8\n9\n"
    )
    np.testing.assert_array_equal(
        LCP.load(tmp_path / "M.mtx").M, [[1.0, 4.0, 7.0], [2.0, 5.0, 8.0], [3.0, 6.0, 9.0]]
    )


# --- rejected files ----------------------------------------------------------------------------------------------

NO_CSR = "no valid CSR matrix|damaged sparse array|must hold integers"
NO_ARRAYS: dict[str, Any] = dict.fromkeys(("data", "indices", "indptr", "shape"))
WRONG_KEYS: dict[str, tuple[dict[str, Any], str]] = {
    "no matrix": (
        {"data": None, "indptr": None},
        r"lacks the keys \['data', 'indptr'\]; a sparse M is data, indices, indptr, shape",
    ),
    "no q": ({"q": None}, r"lacks the keys \['q'\]"),
    "quadratic program": (
        {"P_data": np.ones(2), "A_data": np.ones(2)},
        r"a QuadraticProgram, not an LCP",
    ),
    "q too short": ({"q": np.ones(2)}, r"q must be a finite vector of length 3.*\(2,\)"),
    "q pickled": (
        {"q": np.array([1.0, 2.0, 3.0], dtype=object)},
        r"pickled objects, which are never read",
    ),
    "M sparse and pickled": (
        NO_ARRAYS | {"M": np.array(sp.csr_array(M))},
        r"never read; LCP\.save writes a sparse M",
    ),
    "M not square": ({"shape": [3, 4]}, r"square.*\(3, 4\)"),
    "shape enormous": ({"shape": [10**15, 10**15]}, NO_CSR),
    "indptr too short": ({"indptr": [0, 2, 7]}, NO_CSR),
    "indices beyond n": ({"indices": np.full(7, 3)}, NO_CSR),
    "lower 1e20": ({"lower": np.full(3, 1e20)}, r"lower ≤ upper.*lower\[2\] = 1e\+20"),
}


@pytest.mark.parametrize(("changes", "pattern"), WRONG_KEYS.values(), ids=WRONG_KEYS.keys())
def test_wrong_content_is_refused(changes, pattern, tmp_path):
    """A file with inconsistent arrays raises UnreadableFile with the file's name and the reason."""
    path = npz(tmp_path / "wrong.npz", **changes)
    with pytest.raises(UnreadableFile, match=pattern) as caught:
        LCP.load(path)
    assert str(path) in str(caught.value)
    assert isinstance(caught.value, OSError)


def array_bytes(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


NO_ARCHIVES: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "damaged or no .npz"),
    "text": (b"M = [[4, 1], [1, 4]]\n", "damaged or no .npz"),
    "zip of nothing": (
        b"PK\x05\x06" + bytes(18),
        r"lacks the keys \['M', 'q'\]; an LCP file holds M \(or",
    ),
    "single array": (array_bytes(np.ones(3)), r"single array|no .npz"),
    "pickle": (pickle.dumps({"data": 1}), "never read|no .npz"),
}


@pytest.mark.parametrize(("content", "pattern"), NO_ARCHIVES.values(), ids=NO_ARCHIVES.keys())
def test_no_archive_is_refused(content, pattern, tmp_path):
    """A file that is not an .npz archive raises UnreadableFile, without unsafe advice."""
    (tmp_path / "p.npz").write_bytes(content)
    with pytest.raises(UnreadableFile, match=pattern) as caught:
        LCP.load(tmp_path / "p.npz")
    assert "unsafe" not in str(caught.value)


class Trap:
    """An object that leaves a mark where its pickle is read."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str, str]]:
        return open, (str(self.mark), "w")  # the file it opens is the mark


def test_an_archive_that_unpacks_to_a_multiple_is_refused_before(tmp_path, monkeypatch):
    """8 MB of zeros from 8 kB, where 1 MB is much, are not unpacked; the same array without compression is read."""
    monkeypatch.setattr(files, "LARGE_UNPACKED", 10**6)
    M, q = np.zeros((1000, 1000)), np.zeros(1000)
    np.savez_compressed(tmp_path / "packed.npz", M=M, q=q)
    np.savez(tmp_path / "plain.npz", M=M, q=q)
    with monkeypatch.context() as patch:
        patch.setattr(np.lib.npyio.NpzFile, "__getitem__", lambda *_: pytest.fail("unpacked"))
        with pytest.raises(UnreadableFile, match=r"unpack to 80\d{5}"):
            LCP.load(tmp_path / "packed.npz")
    assert LCP.load(tmp_path / "plain.npz").n == 1000


@pytest.mark.parametrize("key", ["q", "data", "shape", "lower", "P_data", "unknown"])
def test_pickles_are_never_read(key, tmp_path):
    """A pickled array raises an error, or is skipped, and its code never runs."""
    mark = tmp_path / "mark"
    path = npz(tmp_path / "p.npz", **{key: np.array([Trap(mark)], dtype=object)})
    assert b"mark" in path.read_bytes()
    if key == "unknown":
        assert_same(PROBLEM, LCP.load(path))
    else:
        with pytest.raises(UnreadableFile):
            LCP.load(path)
    assert not mark.exists()


# --- corrupt files -----------------------------------------------------------------------------------------------


COORDINATES = "%%MatrixMarket matrix coordinate real general\n"
WRONG_MATRIX_MARKET = {
    "empty": ("", "Matrix Market"),
    "complex": (COORDINATES.replace("real", "complex") + "3 3 1\n1 1 2.0 0.0\n", "complex"),
    "pattern": (
        COORDINATES.replace("real", "pattern") + "3 3 1\n1 1\n",
        "matrices of pattern numbers",
    ),
    "no size": (COORDINATES, "Premature EOF"),
    "negative size": (COORDINATES + "-3 -3 0\n", "size|shape|negative"),
    "enormous size": (COORDINATES + "1000000000000 1000000000000 1\n1 1 2.0\n", r"M\.mtx"),
    "too few entries": (COORDINATES + "3 3 2\n1 1 2.0\n", "Truncated"),
    "index beyond n": (COORDINATES + "3 3 1\n1 4 2.0\n", "Column index"),
    "fractional index": (COORDINATES + "3 3 1\n1.5 1 2.0\n", "Line 3: Invalid integer"),
    "NaN": (COORDINATES + "3 3 1\n2 1 nan\n", r"M\[1, 0\] = nan"),
    "decimal comma": (COORDINATES + "3 3 1\n1 1 2,5\n", "2,5"),
}


@pytest.mark.parametrize(
    ("content", "pattern"), WRONG_MATRIX_MARKET.values(), ids=WRONG_MATRIX_MARKET.keys()
)
def test_wrong_matrix_market_file_is_refused(content, pattern, tmp_path):
    """A text that is not a matrix raises UnreadableFile with the file's name."""
    (tmp_path / "M.mtx").write_text(content)
    scipy.io.mmwrite(tmp_path / "q.mtx", np.ones((3, 1)))
    with pytest.raises(UnreadableFile, match=pattern) as caught:
        LCP.load(tmp_path / "M.mtx")
    assert str(tmp_path / "M.mtx") in str(caught.value)
    assert not re.search(
        "unpack|codec|NoneType|list index out of|invalid literal|object", str(caught.value)
    )


ENORMOUS = {
    "rows of M": {"M": COORDINATES + "300000000 300000000 0\n"},
    "rows of both": {
        "M": COORDINATES + "300000000 300000000 0\n",
        "q": COORDINATES + "300000000 1 0\n",
    },
}


@pytest.mark.quick(1)
@pytest.mark.skipif(
    sys.platform != "linux", reason="the peak of the memory is read from Linux's resource usage"
)
@pytest.mark.parametrize("what", ENORMOUS)
def test_a_short_file_that_announces_much_takes_no_memory(what, tmp_path):
    """A file of a few bytes that declares 3e8 rows raises an error before memory is allocated."""
    scipy.io.mmwrite(tmp_path / "q.mtx", np.ones((3, 1)))
    for name, content in ENORMOUS[what].items():
        (tmp_path / f"{name}.mtx").write_text(content)
    code = (
        "import resource, sys\nfrom lcp_plugin import LCP, UnreadableFile\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\nbefore = peak()\n"
        "try:\n    LCP.load(sys.argv[1])\nexcept UnreadableFile as error:\n"
        "    print((peak() - before) // 1024, error)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "M.mtx")],
        capture_output=True,
        text=True,
        check=True,
    )
    megabytes, message = ran.stdout.split(" ", 1)
    assert int(megabytes) < 50
    assert ".mtx" in message


# --- failing writes ----------------------------------------------------------------------------------------------


def no_space(file: Any, *_: object, **__: object) -> None:
    """Write a little, then fail as a full disk does."""
    file.write(b"PK\x03\x04 the first half")
    file.flush()
    raise OSError(errno.ENOSPC, "No space left on device")


def test_failed_archive_keeps_the_old_one(tmp_path, monkeypatch):
    """If overwriting fails, the old file remains bit for bit."""
    PROBLEM.save(tmp_path / "p.npz")
    before = files_in(tmp_path)
    monkeypatch.setattr(np, "savez_compressed", no_space)
    with pytest.raises(UnreadableFile):
        LCP([[1.0]], [1.0]).save(tmp_path / "p.npz")
    assert files_in(tmp_path) == before


@pytest.mark.parametrize(
    ("path", "pattern"),
    [
        ("no/folder/p.npz", r"cannot write .*p\.npz: No such file or directory; choose"),
        ("file/p.npz", r"cannot write .*p\.npz: Not a directory"),
    ],
)
def test_impossible_target_is_refused(path, pattern, tmp_path):
    """A target in a missing folder, below a file or in place of a folder raises an error."""
    (tmp_path / "file").write_bytes(b"precious")
    (tmp_path / "taken.npz").mkdir()
    with pytest.raises(UnreadableFile, match=pattern):
        PROBLEM.save(tmp_path / path)
    assert files_in(tmp_path) == {"file": b"precious"}
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "taken.npz"]


@pytest.mark.parametrize("line", ["array real general\n0 0", "coordinate real general\n0 0 0"])
def test_an_empty_matrix_market_file_is_an_empty_matrix(line, tmp_path):
    """A matrix of shape (0, 0); scipy's reader divides by the number of columns, which ends the process."""
    (tmp_path / "M.mtx").write_text(f"%%MatrixMarket matrix {line}\n")
    assert files.read_matrix_market(tmp_path / "M.mtx").shape == (0, 0)
