"""Reading Matrix Market files, and MATLAB's .mat files, versions 4 to 7.2, by scipy.

The reader of .mat files may end the process on a corrupt file: read files that you trust.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from traceback import walk_tb
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.errors import LCPError, UnreadableFile

NUMBERS = ("real", "double", "integer", "unsigned-integer")
SYMMETRIES = ("general", "symmetric", "skew-symmetric")
NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|[-+]?inf|nan"
NO_NUMBER = re.compile(rb"(?im)^(?!%)(?:(?:" + NUMBER + rb")(?:[ \t\r]+|$)|[ \t\r]+)*+(\S+)")
MOST_UNSEEN = 10_000_000  # rows or columns that a file may announce with less than a byte for each
WHOLE = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
NUMERIC = {"sparse", "double", "single", "logical", *WHOLE}


def in_folder(source: Path) -> str:
    """Return the next step for a path that does not exist: the folder from which it was looked up."""
    return "; check the path" + ("" if source.is_absolute() else f" (from the folder {Path.cwd()})")


@contextmanager
def opened(source: Path, kind: str) -> Iterator[Any]:
    """Open a file of that format; an exception of its decoders is reported as a corrupt file.

    An error of this package, a mistake in its own code and a warning that is raised as an error do not concern the
    file: they pass.
    """
    try:
        with source.open("rb") as file:
            yield file
    except FileNotFoundError as error:
        raise UnreadableFile(f"no such file: {source}{in_folder(source)}") from error
    except (LCPError, Warning):
        raise
    except MemoryError as error:
        raise UnreadableFile(
            f"cannot read {source}: more memory is required than is free ({error}); check the sizes in the file"
        ) from error
    except Exception as error:
        *_, (frame, _) = walk_tb(error.__traceback__)
        is_ours = frame.f_globals.get("__name__", "").startswith("lcp_plugin.")
        if is_ours and isinstance(error, (TypeError, AttributeError, NameError)):
            raise
        raise UnreadableFile(
            f"cannot read {source}: it is damaged or no {kind} ({error})"
        ) from error


def read_matrix_market(source: Path) -> Any:
    """Return the matrix of a real Matrix Market file: a COO array (coordinate) or an ndarray (array).

    Raises
    ------
    UnreadableFile
        If the file is missing or corrupt, or if its size line announces more than its bytes can hold.
    """
    from scipy.io import mminfo, mmread

    with opened(source, "Matrix Market file") as file:
        content = file.read()
        rows, columns, count, form, field, symmetry = mminfo(source)
        if field not in NUMBERS or symmetry not in SYMMETRIES:
            raise ValueError(f"{symmetry} matrices of {field} numbers are not supported")
        if max(rows, columns) > max(MOST_UNSEEN, len(content)) or count > len(content):
            size = f"{rows} {columns} {count}"
            raise ValueError(f"its size line announces {size}, and it has {len(content)} bytes")
        if wrong := NO_NUMBER.search(content):  # scipy reads 1,5 and 1x as 1
            raise ValueError(f"{wrong[1].decode(errors='replace')!r} is not a number")
        if not rows * columns:
            return (
                sp.coo_array((rows, columns)) if form == "coordinate" else np.zeros((rows, columns))
            )
        matrix = mmread(source, spmatrix=False)
    return sp.coo_array(matrix) if sp.issparse(matrix) else np.asarray(matrix, dtype=np.float64)


def folder_arrays(source: Path, layout: str) -> tuple[Path, dict[str, Any]]:
    """Return the file of M, and M, q, lower, upper of the Matrix Market files in a folder or with a prefix."""
    if source.is_dir():
        prefix = f"{source}{os.sep}"
    else:
        prefix = str(source).removesuffix("M.mtx") if source.name.endswith("M.mtx") else str(source)
    if not Path(prefix + "M.mtx").exists():
        if source.is_dir():
            raise UnreadableFile(f"no such file: {prefix}M.mtx; a folder must hold M.mtx and q.mtx")
        if source.is_file():
            raise UnreadableFile(
                f"cannot read {source}: expected an .npz, .mat, .nl, .qps, .mps, .lp or .h5 file, or M.mtx with "
                f"q.mtx; {layout}"
            )
        tried = "" if source.suffix else f" (nor {prefix}M.mtx)"
        raise UnreadableFile(f"no such file: {source}{tried}{in_folder(source)}")
    if not Path(prefix + "q.mtx").exists():
        raise UnreadableFile(f"{prefix}M.mtx has no companion {prefix}q.mtx; write q next to it")
    found = {"M": read_matrix_market(Path(prefix + "M.mtx"))}
    for name in ("q", "lower", "upper"):
        if (file := Path(f"{prefix}{name}.mtx")).exists():
            values = read_matrix_market(file)
            if max(values.shape) > max(found["M"].shape[0], 1):  # before a sparse one becomes dense
                raise UnreadableFile(f"{file} has the shape {values.shape}, too large for M")
            dense = values.toarray() if sp.issparse(values) else values
            found[name] = dense.reshape(-1) if 1 in dense.shape else dense
    return Path(prefix + "M.mtx"), found


def read_mat(source: Path, wanted: Collection[str]) -> tuple[dict[str, Any], list[str]]:
    """Return the wanted matrices, 2-D ndarrays or CSC arrays, and all names in the file.

    Variables with other names are skipped unread, and nothing is executed.

    Raises
    ------
    UnreadableFile
        If the file is missing, corrupt or of another version, or if a wanted name is not a real matrix.
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
            raise UnreadableFile(
                f"cannot read {source}: {other} is of the class {kinds[other]}; save a matrix of numbers"
            )
        names = [name for name in kinds if name in wanted]
        file.seek(0)
        found = loadmat(file, variable_names=names, spmatrix=False) if names else {}
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
            f"cannot read {source}: {name} is not a sparse matrix ({error}); write it again"
        ) from error
