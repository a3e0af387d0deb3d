"""Reading Matrix Market files strictly, and MATLAB's .mat files, versions 4 to 7.2, by scipy.

scipy's reader of Matrix Market takes misspelt numbers, and crashes on truncated ones. That of .mat files may end the
process on a damaged file: read files that you trust.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.errors import LCPError, UnreadableFile

NUMBERS = ("real", "double", "integer", "unsigned-integer")
SIGN_OF_MIRROR = {"symmetric": 1.0, "skew-symmetric": -1.0}
MOST_UNSEEN = 10_000_000  # rows or columns that a file may announce with less than a byte for each
WHOLE = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
NUMERIC = {"sparse", "double", "single", "logical", *WHOLE}
WORDS = {
    "char": "text",
    "cell": "a cell array",
    "struct": "a struct",
    "object": "an object",
    "function": "a function",
}


@contextmanager
def opened(source: Path, kind: str) -> Iterator[Any]:
    """Open a file of that kind; whatever its decoders raise while it is read says that it is damaged."""
    try:
        with source.open("rb") as file:
            yield file
    except FileNotFoundError as error:
        raise UnreadableFile(f"no such file: {source}") from error
    except LCPError:
        raise
    except Exception as error:
        raise UnreadableFile(
            f"cannot read {source}: it is damaged or no {kind} ({error})"
        ) from error


def read_matrix_market(source: Path) -> Any:
    """Return what a real Matrix Market file holds: a COO array (coordinate) or an ndarray (array).

    Raises
    ------
    UnreadableFile
        Where the file is missing, or anything in it is not as its header and size line announce.
    """
    with opened(source, "Matrix Market file") as file:
        form, symmetry = _header(file.readline())
        line = file.readline()
        while line.startswith(b"%") or (line and not line.strip()):
            line = file.readline()
        size = _size(line, 3 if form == "coordinate" else 2)
        _refuse_what_cannot_follow(size, os.fstat(file.fileno()).st_size)
        body = _numbers(file)
        return (
            _from_entries(size, body, symmetry)
            if form == "coordinate"
            else _from_columns(size, body, symmetry)
        )


def _header(line: bytes) -> tuple[str, str]:
    """Return form and symmetry."""
    words = line.decode("ascii", errors="replace").lower().split()
    if len(words) != 5 or words[:2] != ["%%matrixmarket", "matrix"]:
        raise ValueError("its first line is no Matrix Market header")
    form, number, symmetry = words[2:]
    if form not in ("coordinate", "array") or number not in NUMBERS:
        raise ValueError(
            f"a {form} matrix of {number} numbers is not supported; write real numbers"
        )
    if symmetry != "general" and symmetry not in SIGN_OF_MIRROR:
        raise ValueError(f"the symmetry {symmetry!r} is not supported; write the matrix as general")
    return form, symmetry


def _size(line: bytes, count: int) -> list[int]:
    words = line.split()
    if len(words) != count or not all(word.isdigit() for word in words):
        raise ValueError(
            f"its size line must hold {count} whole numbers, got {line[:60].decode(errors='replace')!r}"
        )
    return [int(word) for word in words]


def _refuse_what_cannot_follow(size: list[int], length: int) -> None:
    """Raise where a file of that many bytes announces so much that its matrix would fill the memory with zeros."""
    if max(size) > max(MOST_UNSEEN, length):
        raise ValueError(
            f"its size line announces {' '.join(map(str, size))}, and it has {length} bytes"
        )


def _numbers(file: Any) -> NDArray[np.float64]:
    """Return the rows of numbers that follow, shape (rows, numbers in a row)."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "loadtxt: input contained no data")
        return np.loadtxt(file, comments="%", dtype=np.float64, ndmin=2)


def _from_entries(size: list[int], body: NDArray[np.float64], symmetry: str) -> sp.coo_array:
    rows, columns, count = size
    body = body.reshape(0, 3) if body.size == 0 else body
    if body.shape != (count, 3):
        raise ValueError(
            f"it announces {count} entries of 3 numbers and holds an array of shape {body.shape}"
        )
    index = body[:, :2]
    if (index != np.floor(index)).any() or (index < 1).any() or (index > [rows, columns]).any():
        raise ValueError(f"an index lies outside 1 … {rows} × 1 … {columns}")
    i, j = index.T.astype(np.int64) - 1
    values = body[:, 2]
    if symmetry != "general":
        off = i != j
        values = np.concatenate([values, SIGN_OF_MIRROR[symmetry] * values[off]])
        i, j = np.concatenate([i, j[off]]), np.concatenate([j, i[off]])
    return sp.coo_array((values, (i, j)), shape=(rows, columns))


def _from_columns(size: list[int], body: NDArray[np.float64], symmetry: str) -> NDArray[np.float64]:
    """Return the matrix from its columns one below the other; of a symmetric one only the lower triangle is stored."""
    rows, columns = size
    if symmetry == "general":
        _check_count(body, rows * columns)
        return body.reshape(columns, rows).T
    if rows != columns:
        raise ValueError(f"a {symmetry} matrix must be square, got {rows} × {columns}")
    first = 0 if symmetry == "symmetric" else 1
    _check_count(body, (rows - first + 1) * (rows - first) // 2)
    j, i = np.triu_indices(rows, first)
    matrix = np.zeros((rows, rows))
    matrix[j, i] = SIGN_OF_MIRROR[symmetry] * body.reshape(-1)
    matrix[i, j] = body.reshape(-1)
    return matrix


def _check_count(body: NDArray[np.float64], count: int) -> None:
    if body.size != count or (body.size and body.shape[1] != 1):
        raise ValueError(f"it announces {count} numbers, one a line, and holds {body.size}")


def read_mat(source: Path, wanted: Collection[str]) -> tuple[dict[str, Any], list[str]]:
    """Return those of the wanted matrices that the file holds, 2-D ndarrays or CSC arrays, and all names in it.

    Whatever else has another name is passed over unread, and nothing is executed.

    Raises
    ------
    UnreadableFile
        Where the file is missing, damaged, of another version, or a wanted name is no real matrix.
    """
    from scipy.io import loadmat, whosmat

    with opened(source, ".mat file of numbers") as file:
        try:
            kinds = {name: kind for name, _, kind in whosmat(file) if not name.startswith("__")}
        except NotImplementedError as error:
            raise UnreadableFile(
                f"cannot read {source}: it is of version 7.3 (HDF5); in MATLAB write "
                f'save("{source.name}", "M", "q", "-v7")'
            ) from error
        if other := next(
            (name for name in wanted if kinds.get(name, "double") not in NUMERIC), None
        ):
            what = WORDS.get(kinds[other], "no array")
            raise UnreadableFile(
                f"cannot read {source}: {other} is {what}; save a matrix of numbers"
            )
        names = [name for name in kinds if name in wanted]
        file.seek(0)
        arrays = (
            {"spmatrix": False} if "spmatrix" in signature(loadmat).parameters else {}
        )  # an older scipy has none
        found = loadmat(file, variable_names=names, **arrays) if names else {}
    return {name: _checked(found[name], name, source) for name in names}, list(kinds)


def _checked(matrix: Any, name: str, source: Path) -> Any:
    if np.iscomplexobj(matrix):
        raise UnreadableFile(f"cannot read {source}: {name} is complex; save real numbers")
    if len(matrix.shape) != 2:
        raise UnreadableFile(
            f"cannot read {source}: {name} has the shape {matrix.shape}; save a matrix or a vector"
        )
    if not sp.issparse(matrix):
        return matrix.astype(matrix.dtype.newbyteorder("="))
    try:
        columns = sp.csc_array(matrix)
        columns.check_format(full_check=True)
        return columns
    except (ValueError, IndexError, OverflowError) as error:
        raise UnreadableFile(
            f"cannot read {source}: {name} is no sparse matrix ({error}); write it again"
        ) from error
