"""A problem on disk, of which each rank reads its own part: a folder of chunks."""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from ..errors import UnreadableFile
from ..peers.ranks.collective import as_mpi, from_first, together
from ..peers.ranks.halo import Halo, numbered_over_all
from .files import VECTORS, checked_path, read_npz
from .own_rows import equal_share

if TYPE_CHECKING:
    from .lcp import LCP

CHUNK = re.compile(r"rows-(\d{5,})-of-(\d{5,})\.npz")
MATRIX_KEYS = ("data", "indices", "indptr")
HEAD_KEYS = ("shape", "first_row", "save")


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
    comm = problem.peers.comm
    target = together(comm, lambda: checked_path(path))
    name, folder = from_first(comm, lambda: (secrets.token_hex(8), _new_folder(target)))
    try:
        together(comm, lambda: _write_chunk(problem, folder, name))
        from_first(comm, lambda: _put_in_place(folder, target))
    finally:
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


def load(kind: type[LCP], path: str | PathLike[str], communicator: Any) -> LCP:
    """Return the problem of a folder of chunks, on any number of ranks.

    Raises
    ------
    UnreadableFile, InvalidProblem
        On every rank, where anything is missing or damaged on one of them.
    """
    comm = as_mpi(communicator)
    source = together(comm, lambda: checked_path(path))
    heads = _heads(source, comm)
    first, last = equal_share(heads[0].columns, comm.size, comm.rank)
    rows, *vectors = together(comm, lambda: _read_rows(heads, first, last))
    return kind.from_rows(comm, rows, *vectors, first_row=first)


# --- writing --------------------------------------------------------------------------------------------


def _new_folder(target: Path) -> Path:
    if target.exists() and not (target.is_dir() and all(CHUNK.fullmatch(one.name) for one in target.iterdir())):
        raise UnreadableFile(f"{target} holds something else than chunks of a problem; choose another place")
    folder = target.with_name(f".{target.name}-{secrets.token_hex(6)}")
    folder.mkdir(parents=True)
    return folder


def _write_chunk(problem: LCP, folder: Path, name: str) -> None:
    rank, ranks = problem.peers.rank, problem.peers.size
    M = numbered_over_all(problem.matrix.csr_rows, cast(Halo, problem.peers))
    try:
        with (folder / f"rows-{rank:05d}-of-{ranks:05d}.npz").open("xb") as file:
            np.savez(
                file, data=M.data, indices=M.indices, indptr=M.indptr, shape=np.array(M.shape),
                first_row=np.array(problem.first), save=np.array(name),
                q=problem.q, lower=problem.lower, upper=problem.upper,
            )
    except FileNotFoundError as error:
        raise UnreadableFile(f"the folder {folder} is not seen; all ranks must share the file system") from error


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


# --- reading --------------------------------------------------------------------------------------------


def _heads(source: Path, comm: MPI.Comm) -> list[Head]:
    """Return what all chunks say of themselves, each read by one rank, in order and checked."""
    paths = from_first(comm, lambda: _complete(source))
    own = together(comm, lambda: [_head(path) for path in paths[comm.rank :: comm.size]])
    heads = sorted((head for part in comm.allgather(own) for head in part), key=lambda head: head.path.name)
    first_row, columns, name = 0, heads[0].columns, heads[0].save
    for head in heads:
        if (head.columns, head.save) != (columns, name):
            raise UnreadableFile(f"{head.path} and {heads[0].path.name} are not of one save; write the folder again")
        if head.first_row != first_row:
            raise UnreadableFile(
                f"{head.path} begins with row {head.first_row}, but the chunks before it end with row {first_row - 1}"
            )
        first_row += head.rows
    if first_row != columns:
        raise UnreadableFile(f"{source} holds {first_row} rows of a matrix with {columns} columns; M must be square")
    return heads


def _complete(source: Path) -> list[Path]:
    if not source.is_dir():
        raise UnreadableFile(
            f"cannot read {source}: it is a file; read it whole and cut it: LCP.from_problem(LCP.load(file), comm)"
            if source.exists() else f"no such file or folder: {source}"
        )
    found = [match for one in source.iterdir() if (match := CHUNK.fullmatch(one.name))]
    totals = sorted({match[2] for match in found})
    if not found:
        raise UnreadableFile(f"{source} holds no chunk rows-…-of-….npz; write it with LCP.save")
    if len(totals) > 1:
        raise UnreadableFile(f"{source} holds chunks of several saves (of {', '.join(totals)}); keep one of them")
    names = [f"rows-{k:05d}-of-{totals[0]}.npz" for k in range(int(totals[0]))]
    missing = sorted(set(names) - {match[0] for match in found})
    if missing:
        raise UnreadableFile(f"{source} lacks {len(missing)} of {len(names)} chunks, the first is {missing[0]}")
    return [source / name for name in names]


def _read(path: Path, keys: Sequence[str]) -> Mapping[str, Any]:
    if not path.exists():
        raise UnreadableFile(f"no such file: {path}; all ranks must share the file system")
    content = read_npz(path, keys)
    missing = [key for key in keys if key not in content]
    if missing:
        raise UnreadableFile(f"{path} lacks the keys {missing}; write it with LCP.save")
    return content


def _head(path: Path) -> Head:
    content = _read(path, HEAD_KEYS)
    shape, first_row = content["shape"], content["first_row"]
    if shape.shape != (2,) or first_row.shape != () or not {shape.dtype.kind, first_row.dtype.kind} <= {"i", "u"}:
        raise UnreadableFile(f"{path}: shape must be two whole numbers and first_row one; write it again")
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
            content = _read(head.path, (*MATRIX_KEYS, *VECTORS))
            own = slice(begin - head.first_row, end - head.first_row)
            yield _matrix(head, content)[own], *(_vector(head, content, name)[own] for name in VECTORS)


def _matrix(head: Head, content: Mapping[str, Any]) -> sp.csr_array:
    if any(content[key].dtype.kind not in "iu" for key in ("indices", "indptr")):
        raise UnreadableFile(f"{head.path}: indices and indptr must hold whole numbers; write it again")
    try:
        rows = sp.csr_array(tuple(content[key] for key in MATRIX_KEYS), shape=(head.rows, head.columns))
        rows.check_format(full_check=True)
    except (ValueError, IndexError, TypeError, OverflowError) as error:
        raise UnreadableFile(f"{head.path} holds no valid CSR rows: {error}") from error
    return rows


def _vector(head: Head, content: Mapping[str, Any], name: str) -> Any:
    if content[name].shape != (head.rows,):
        raise UnreadableFile(f"{head.path}: {name} has shape {content[name].shape}, but there are {head.rows} rows")
    return content[name]
