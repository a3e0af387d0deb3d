"""A problem whose rows are spread over ranks: made of their own rows, saved and loaded as a folder of chunks.

Whatever is wrong on one rank is refused on all of them.
"""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast
from zlib import crc32

import numpy as np
import scipy.sparse as sp

from ..core.checks import canonical_csr, check_kind
from ..core.communicator import Communicator
from ..core.errors import InvalidProblem, UnreadableFile
from ..core.matrix.matrix import Matrix
from ..interfaces.files.files import (
    MATRIX_KEYS,
    VECTORS,
    arrays_of,
    checked_path,
    csr_in,
    read_npz,
    require_keys,
)
from .petsc.collective import Ranks
from .petsc.halo import Halo, numbered_over_all, own_rows

if TYPE_CHECKING:
    from ..core.lcp import LCP

WIDEST = 2**31 - 1  # what a PETSc with 32-bit indices can count
CHUNK = re.compile(r"rows-(\d{5,})-of-(\d{5,})\.npz")
HEAD_KEYS = ("shape", "first_row", "save")
REMEDY = "write it with LCP.save"


def matrix_of_rows(comm: Any, rows: Any, first_row: int | None) -> Matrix:
    """Return the matrix whose rows follow each other in the order of the ranks; see :meth:`LCP.from_rows`."""
    ranks = Ranks(comm)
    matrix = ranks.together(lambda: _checked_rows(rows))
    own, n = matrix.shape
    ranks.require_same("the number of columns", n, "every rank gives its rows at full width")
    halo = Halo(ranks.comm, own)
    if halo.n != n:
        what = "missing" if halo.n < n else "too many; is one given twice?"
        counts = ", ".join(map(str, np.diff(halo.starts)))
        raise InvalidProblem(
            f"M has {n} columns, but the ranks give {halo.n} rows ({counts}): {abs(n - halo.n)} are {what}"
        )
    ranks.together(lambda: _check_first_row(first_row, halo.first))
    return Matrix.of_own_rows(*own_rows(halo, matrix))


def require_same_numbers(matrix: Matrix, **bounds: Any) -> None:
    """Raise where a bound that is a number for all rows is another one on some rank."""
    for name, bound in bounds.items():
        number = float(np.asarray(bound)) if np.ndim(bound) == 0 else "an array"
        advice = "a number holds for all rows; give arrays where rows differ"
        matrix.require_same(name, number, advice, InvalidProblem)


def equal_part(comm: Any, problem: LCP) -> tuple[Any, ...]:
    """Return this rank's rows, q, lower and upper of a problem that all ranks have.

    Raises
    ------
    InvalidProblem
        Where the ranks give different problems.
    """
    ranks = Ranks(comm)
    ranks.together(lambda: _check_whole(problem))
    M = problem.csr
    parts = (M.indptr, M.indices, M.data, problem.q, problem.lower, problem.upper)
    facts = (problem.n, M.nnz, *(crc32(np.ascontiguousarray(part).data) for part in parts))
    ranks.require_same(
        "the problem (n, nonzeros, checksums)", facts, "build the same one on every rank"
    )
    own = slice(*equal_share(problem.n, ranks))
    return M[own], problem.q[own], problem.lower[own], problem.upper[own]


def equal_share(n: int, ranks: Communicator) -> tuple[int, int]:
    """Return first and last of this rank's part where n rows are cut into parts of equal length."""
    return n * ranks.rank // ranks.size, n * (ranks.rank + 1) // ranks.size


def _checked_rows(rows: Any) -> sp.csr_array:
    """Return the rows as canonical CSR, every index checked: a wrong one would be met on another rank."""
    if not (sp.issparse(rows) and rows.ndim == 2):
        raise InvalidProblem(
            f"the own rows must be a sparse array of shape (own, n), got {type(rows).__name__}"
        )
    check_kind(rows.dtype, "rows must hold real numbers")
    if rows.shape[1] > WIDEST:
        raise InvalidProblem(
            f"M has {rows.shape[1]} columns; PETSc with 32-bit indices takes {WIDEST}"
        )
    return canonical_csr(rows, "rows")


def _check_first_row(given: int | None, first: int) -> None:
    if given is not None and given != first:
        raise InvalidProblem(
            f"first_row is {given}, but the ranks before this one give {first} rows: rows are missing, "
            "given twice, or in another order than the ranks"
        )


def _check_whole(problem: Any) -> None:
    if not isinstance(getattr(problem, "matrix", None), Matrix):
        raise InvalidProblem(
            f"from_problem needs an LCP, got {type(problem).__name__}; write LCP(M, q)"
        )
    problem.matrix.require_all_rows()


# --- files --------------------------------------------------------------------------------------------------


class Head(NamedTuple):
    """What one chunk says of itself: which rows it has, and which save it belongs to."""

    path: Path
    first_row: int
    rows: int
    columns: int
    save: str


def save(problem: LCP, path: str | PathLike[str]) -> None:
    """Write one chunk a rank into a folder that all ranks see; the folder appears whole or not at all.

    A chunk ``rows-00000-of-00004.npz`` holds the own rows of M in CSR (data, indices counted over all ranks, indptr,
    shape), first_row, q, lower, upper, and in ``save`` a number that all chunks of one save share. A folder that is
    there is replaced if it holds nothing but chunks.

    Raises
    ------
    UnreadableFile
        On every rank, where one of them cannot write, or the folder holds something else.
    """
    ranks = problem.matrix.communicator
    target = ranks.together(lambda: checked_path(path))
    name, folder = ranks.from_first(lambda: (secrets.token_hex(8), _new_folder(target)))
    try:
        ranks.together(lambda: _write_chunk(problem, folder, name))
        ranks.from_first(lambda: _put_in_place(folder, target))
    finally:
        if ranks.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


def load(kind: type[LCP], path: str | PathLike[str], communicator: Any) -> LCP:
    """Return the problem of a folder of chunks, on any number of ranks.

    Raises
    ------
    UnreadableFile, InvalidProblem
        On every rank, where anything is missing or damaged on one of them.
    """
    ranks = Ranks(communicator)
    source = ranks.together(lambda: checked_path(path))
    heads = _heads(source, ranks)
    first, last = equal_share(heads[0].columns, ranks)
    rows, *vectors = ranks.together(lambda: _read_rows(heads, first, last))
    return kind.from_rows(ranks.comm, rows, *vectors, first_row=first)


def _new_folder(target: Path) -> Path:
    if target.exists() and not (
        target.is_dir() and all(CHUNK.fullmatch(one.name) for one in target.iterdir())
    ):
        raise UnreadableFile(
            f"{target} holds something else than chunks of a problem; choose another place"
        )
    folder = target.with_name(f".{target.name}-{secrets.token_hex(6)}")
    folder.mkdir(parents=True)
    return folder


def _write_chunk(problem: LCP, folder: Path, name: str) -> None:
    ranks = cast(Halo, problem.matrix.communicator)
    M = numbered_over_all(problem.matrix.csr_rows, ranks)
    try:
        with (folder / f"rows-{ranks.rank:05d}-of-{ranks.size:05d}.npz").open("xb") as file:
            np.savez(
                file,
                **arrays_of(problem, M),
                first_row=np.array(problem.own_rows.start),
                save=np.array(name),
            )
    except FileNotFoundError as error:
        raise UnreadableFile(
            f"the folder {folder} is not seen; all ranks must share the file system"
        ) from error


def _put_in_place(folder: Path, target: Path) -> None:
    """Rename the new folder to its place; an old one steps aside before, and is removed afterwards."""
    aside = folder.with_name(f"{folder.name}-old")
    if not target.exists():
        folder.rename(target)
        return
    target.rename(aside)
    try:
        folder.rename(target)
    except OSError:
        aside.rename(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _heads(source: Path, ranks: Ranks) -> list[Head]:
    """Return what all chunks say of themselves, each read by one rank, in order and checked."""
    paths = ranks.from_first(lambda: _complete(source))
    own = ranks.together(lambda: [_head(path) for path in paths[ranks.rank :: ranks.size]])
    heads = sorted(
        (head for part in ranks.comm.allgather(own) for head in part),
        key=lambda head: head.path.name,
    )
    first_row, columns, name = 0, heads[0].columns, heads[0].save
    for head in heads:
        if (head.columns, head.save) != (columns, name):
            raise UnreadableFile(
                f"{head.path} and {heads[0].path.name} are not of one save; write the folder again"
            )
        if head.first_row != first_row:
            raise UnreadableFile(
                f"{head.path} begins with row {head.first_row}, but the chunks before it end with row {first_row - 1}"
            )
        first_row += head.rows
    if first_row != columns:
        raise UnreadableFile(
            f"{source} holds {first_row} rows of a matrix with {columns} columns; M must be square"
        )
    return heads


def _complete(source: Path) -> list[Path]:
    if not source.is_dir():
        raise UnreadableFile(
            f"cannot read {source}: it is a file; read it whole and cut it: LCP.from_problem(LCP.load(file), comm)"
            if source.exists()
            else f"no such file or folder: {source}"
        )
    found = [match for one in source.iterdir() if (match := CHUNK.fullmatch(one.name))]
    totals = sorted({match[2] for match in found})
    if not found:
        raise UnreadableFile(f"{source} holds no chunk rows-…-of-….npz; write it with LCP.save")
    if len(totals) > 1:
        raise UnreadableFile(
            f"{source} holds chunks of several saves (of {', '.join(totals)}); keep one of them"
        )
    names = [f"rows-{k:05d}-of-{totals[0]}.npz" for k in range(int(totals[0]))]
    missing = sorted(set(names) - {match[0] for match in found})
    if missing:
        raise UnreadableFile(
            f"{source} lacks {len(missing)} of {len(names)} chunks, the first is {missing[0]}"
        )
    return [source / name for name in names]


def _head(path: Path) -> Head:
    content = read_npz(path, HEAD_KEYS)
    require_keys(path, content, HEAD_KEYS, REMEDY)
    shape, first_row = content["shape"], content["first_row"]
    if (
        shape.shape != (2,)
        or first_row.shape != ()
        or not {shape.dtype.kind, first_row.dtype.kind} <= {"i", "u"}
    ):
        raise UnreadableFile(
            f"{path}: shape must be two whole numbers and first_row one; write it again"
        )
    return Head(path, int(first_row), int(shape[0]), int(shape[1]), str(content["save"]))


def _read_rows(heads: Sequence[Head], first: int, last: int) -> tuple[Any, ...]:
    """Return the rows first ≤ i < last of M, q, lower and upper."""
    parts = list(_parts(heads, first, last))
    if not parts:
        none = np.zeros(0)
        return sp.csr_array((0, heads[0].columns)), none, none, none
    rows, *vectors = zip(*parts, strict=True)
    return sp.vstack(rows, format="csr"), *map(np.concatenate, vectors)


def _parts(heads: Sequence[Head], first: int, last: int) -> Iterator[tuple[Any, ...]]:
    for head in heads:
        begin, end = max(first, head.first_row), min(last, head.first_row + head.rows)
        if begin < end:
            content = read_npz(head.path, {*MATRIX_KEYS, *VECTORS})
            require_keys(head.path, content, (*MATRIX_KEYS, *VECTORS), REMEDY)
            for name in VECTORS:
                if content[name].shape != (head.rows,):
                    raise UnreadableFile(
                        f"{head.path}: {name} has shape {content[name].shape}, but there are {head.rows} rows"
                    )
            own = slice(begin - head.first_row, end - head.first_row)
            yield csr_in(head.path, content)[own], *(content[name][own] for name in VECTORS)
