"""Reading and writing problems: one ``.npz`` without pickle, or Matrix Market files side by side."""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from .errors import InvalidProblem, UnreadableFile
from .problem import LCP, FloatVector

INFINITE_BOUND = 1e20
MATRIX_KEYS = ("data", "indices", "indptr", "shape")
VECTORS = ("q", "lower", "upper")


def save(problem: LCP, path: str | PathLike[str]) -> None:
    """Write the problem to a ``.npz`` file or, for any other path, into a folder of Matrix Market files."""
    target = Path(path)
    _refuse_huge_bounds(problem)
    if target.suffix == ".npz":
        M = problem.csr
        write_whole(
            target,
            lambda temporary: np.savez_compressed(
                temporary, data=M.data, indices=M.indices, indptr=M.indptr, shape=np.array(M.shape),
                q=problem.q, lower=problem.lower, upper=problem.upper,
            ),
        )
    else:
        _save_folder(problem, target)


def load(path: str | PathLike[str]) -> LCP:
    """Read a problem from a ``.npz`` file, or from ``M.mtx`` and ``q.mtx`` in a folder or behind a prefix."""
    source = Path(path)
    if source.suffix == ".npz":
        return _load_npz(source)
    prefix = _matrix_market_prefix(source)
    M = _read_matrix_market(Path(prefix + "M.mtx"))
    if not Path(prefix + "q.mtx").exists():
        raise UnreadableFile(f"{prefix}M.mtx has no companion {prefix}q.mtx; write q beside it")
    q = _read_vector(Path(prefix + "q.mtx"))
    bounds = {}
    for name in ("lower", "upper"):
        if Path(f"{prefix}{name}.mtx").exists():
            bounds[name] = _with_infinities(_read_vector(Path(f"{prefix}{name}.mtx")))
    return _problem(prefix + "M.mtx", M, q, bounds)


def write_whole(target: Path, write: Callable[[Any], object]) -> None:
    """Let `write` fill a temporary file beside the target, then rename it: whole or not at all.

    Raises
    ------
    UnreadableFile
        Where the folder does not exist or cannot be written to.
    """
    try:
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}-", suffix=target.suffix)
    except OSError as error:
        raise UnreadableFile(f"cannot write {target}: {error.strerror or error}; choose another folder") from error
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)
        Path(temporary).replace(target)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise UnreadableFile(f"cannot write {target}: {error.strerror or error}") from error
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _save_folder(problem: LCP, folder: Path) -> None:
    from scipy.io import mmwrite

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnreadableFile(f"cannot make the folder {folder}: {error.strerror or error}") from error

    def writer(content: Any) -> Callable[[Any], object]:
        return lambda file: mmwrite(file, content, precision=17, symmetry="general")

    write_whole(folder / "M.mtx", writer(sp.coo_array(problem.csr)))
    for name in VECTORS:
        values = np.clip(getattr(problem, name), -INFINITE_BOUND, INFINITE_BOUND) if name != "q" else problem.q
        write_whole(folder / f"{name}.mtx", writer(values.reshape(-1, 1)))


def _refuse_huge_bounds(problem: LCP) -> None:
    for name in ("lower", "upper"):
        bound = getattr(problem, name)
        huge = np.isfinite(bound) & (np.abs(bound) >= INFINITE_BOUND)
        if huge.any():
            i = int(np.flatnonzero(huge)[0])
            raise InvalidProblem(
                f"{name}[{i}] = {bound[i]} would be read back as infinite (|bound| ≥ 1e20); use ±inf or rescale z"
            )


def _load_npz(source: Path) -> LCP:
    content = _read_npz(source)
    if "P_data" in content:
        raise UnreadableFile(f"{source} holds a quadratic program (key P_data), not an LCP with the keys data … q")
    missing = [key for key in (*MATRIX_KEYS, "q") if key not in content]
    if missing:
        wanted = ", ".join((*MATRIX_KEYS, *VECTORS))
        raise UnreadableFile(f"{source} lacks the keys {missing}; an LCP file holds {wanted}")
    try:
        shape = tuple(int(k) for k in content["shape"])
        M = sp.csr_array((content["data"], content["indices"], content["indptr"]), shape=shape)
    except (ValueError, TypeError, OverflowError, MemoryError) as error:
        raise UnreadableFile(f"{source} holds no valid CSR matrix: {error}") from error
    bounds = {name: _with_infinities(content[name]) for name in ("lower", "upper") if name in content}
    return _problem(str(source), M, content["q"], bounds)


def _read_npz(source: Path) -> Mapping[str, Any]:
    try:
        with np.load(source, allow_pickle=False) as archive:
            if not hasattr(archive, "files"):
                raise UnreadableFile(f"{source} is a single array, not an archive; write it with LCP.save")
            wanted = {*MATRIX_KEYS, *VECTORS, "P_data"}
            return {key: archive[key] for key in archive.files if key in wanted}
    except FileNotFoundError as error:
        raise UnreadableFile(f"no such file: {source}") from error
    except UnreadableFile:
        raise
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, NotImplementedError, MemoryError) as error:
        is_pickled = "allow_pickle" in str(error)
        hint = "it holds pickled objects, which are never read" if is_pickled else "it is damaged or no .npz file"
        raise UnreadableFile(f"cannot read {source}: {hint} ({error})") from error


def _matrix_market_prefix(source: Path) -> str:
    if source.is_dir():
        prefix = f"{source}{os.sep}"
    elif source.name.endswith("M.mtx"):
        prefix = str(source)[: -len("M.mtx")]
    else:
        prefix = str(source)
    if not Path(prefix + "M.mtx").exists():
        if source.is_file():
            raise UnreadableFile(f"cannot read {source}: expected a .npz file, or M.mtx with q.mtx beside it")
        raise UnreadableFile(f"no such file: {source if source.suffix else prefix + 'M.mtx'}")
    return prefix


def _read_matrix_market(source: Path) -> Any:
    from scipy.io import mmread

    try:
        return mmread(source)
    except (OSError, ValueError, TypeError, OverflowError, StopIteration, MemoryError) as error:
        raise UnreadableFile(f"cannot read {source}: it is damaged or no Matrix Market file ({error})") from error


def _read_vector(source: Path) -> FloatVector:
    values = _read_matrix_market(source)
    dense = np.asarray(values.toarray() if sp.issparse(values) else values)
    if dense.ndim == 2 and 1 in dense.shape:
        dense = dense.reshape(-1)
    return dense


def _with_infinities(bound: Any) -> Any:
    """Return the bound with ±1e20 and beyond read as ±∞, the convention of most file formats."""
    values = np.asarray(bound)
    if values.dtype.kind not in "fiu":
        return values
    values = values.astype(np.float64)
    values[values >= INFINITE_BOUND] = np.inf
    values[values <= -INFINITE_BOUND] = -np.inf
    return values


def _problem(source: str, M: Any, q: Any, bounds: Mapping[str, Any]) -> LCP:
    try:
        return LCP(M, q, **bounds)
    except InvalidProblem as error:
        raise UnreadableFile(f"{source} states no linear complementarity problem: {error}") from error
