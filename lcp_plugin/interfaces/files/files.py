"""Reading and writing problems: one ``.npz`` without pickle, or Matrix Market files side by side; reading ``.mat``."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.errors import InvalidOption, InvalidProblem, UnreadableFile
from .matrix_market import opened, read_mat, read_matrix_market

if TYPE_CHECKING:
    from ...core.lcp import LCP

MATRIX_KEYS = ("data", "indices", "indptr", "shape")
VECTORS = ("q", "lower", "upper")
MATLAB_BOUNDS = {
    "lower": ("lower", "lb", "l"),
    "upper": ("upper", "ub", "u"),
}  # the names that each may have there
MATLAB_LAYOUT = 'it must hold M, q and, if wanted, lower and upper (or lb and ub): in MATLAB save("file.mat", "M", "q")'
LAYOUT = "an LCP file holds M (or its CSR arrays data, indices, indptr, shape), q and, if wanted, lower and upper"


def save(problem: LCP, path: str | PathLike[str]) -> None:
    """Write the problem to a ``.npz`` or ``.nl`` file or, for any other path, into a folder of Matrix Market files."""
    target = checked_path(path)
    if target.suffix.lower() == ".nl":
        from ..nl.writing import write_nl

        write_nl(problem, target)
        return
    if target.suffix.lower() == ".npz":
        arrays = arrays_of(problem, problem.csr)
        write_whole({target: lambda file: np.savez_compressed(file, **arrays)})
    else:
        _save_folder(problem, checked_folder(target))


def save_arrays(path: str | PathLike[str], arrays: Mapping[str, Any], what: str) -> None:
    """Write the arrays that state a problem of another kind, in words, to a ``.npz`` file."""
    target = checked_path(path)
    if target.suffix.lower() != ".npz":
        raise UnreadableFile(
            f"cannot write {target}: {what} is saved in one .npz file; write {target.stem}.npz"
        )
    write_whole({target: lambda file: np.savez_compressed(file, **arrays)})


def arrays_of(problem: Any, M: sp.csr_array) -> dict[str, Any]:
    """Return what is saved of a problem, or of the own rows of one, by name."""
    arrays = {"data": M.data, "indices": M.indices, "indptr": M.indptr, "shape": np.array(M.shape)}
    return arrays | {name: getattr(problem, name) for name in VECTORS}


def checked_folder(target: Path) -> Path:
    """Return the path, or raise UnreadableFile where it looks like a file of another kind and is no folder yet."""
    # A number behind a dot is a part of the name, as in "size=0.5".
    if target.suffix[1:2].isalpha() and not target.is_dir():
        raise UnreadableFile(
            f"cannot write {target}: a problem becomes one .npz or .nl file or a folder of files, not a "
            f"{target.suffix} file; write {target.stem}.npz, or {target.stem} for a folder"
        )
    return target


def checked_path(path: Any) -> Path:
    """Return the path, or raise InvalidOption or UnreadableFile where it can be none."""
    try:
        target = Path(path)
    except TypeError:
        raise InvalidOption(f"path must be a string or a Path, got {type(path).__name__}") from None
    if "\0" in str(target):
        raise UnreadableFile(f"no file can be called {str(target)!r}; leave out the null character")
    return target


OF_CONES = ("mu", "friction", "cone_kinds")  # whose M and q without these would be another problem


def load(kind: type[LCP], path: str | PathLike[str]) -> LCP:
    """Read a problem from a ``.npz``, ``.mat`` or ``.nl`` file, or ``M.mtx`` and ``q.mtx`` in a folder or by prefix."""
    source = checked_path(path)
    if source.suffix.lower() == ".nl":
        from ..nl.model import lcp_in_nl

        return lcp_in_nl(source)
    if source.suffix.lower() == ".npz":
        return _load_npz(kind, source)
    if source.suffix.lower() == ".mat" and not source.is_dir():
        return _load_mat(kind, source)
    prefix = _matrix_market_prefix(source)
    M = read_matrix_market(Path(prefix + "M.mtx"))
    if not Path(prefix + "q.mtx").exists():
        raise UnreadableFile(f"{prefix}M.mtx has no companion {prefix}q.mtx; write q beside it")
    q = _read_vector(Path(prefix + "q.mtx"))
    _require_a_number_a_row(M, q, f"{prefix}M.mtx", f"{prefix}q.mtx")
    bounds = {}
    for name in ("lower", "upper"):
        if Path(f"{prefix}{name}.mtx").exists():
            bounds[name] = _read_vector(Path(f"{prefix}{name}.mtx"))
    return _problem(kind, prefix + "M.mtx", M, q, bounds)


def write_whole(contents: Mapping[Path, Callable[[Any], object]]) -> None:
    """Let each writer fill a temporary file beside its target, then rename them all: all whole, or nothing.

    Raises
    ------
    UnreadableFile
        Where a folder does not exist or cannot be written to.
    """
    finished: dict[Path, Path] = {}
    try:
        for target, write in contents.items():
            if not target.name:
                raise UnreadableFile(f"cannot write {str(target)!r}: it names no file")
            temporary = target.with_name(f".{target.stem}-{secrets.token_hex(6)}{target.suffix}")
            with temporary.open("xb") as file:
                finished[target] = temporary
                write(file)
        for target, temporary in finished.items():
            temporary.replace(target)
    except OSError as error:
        raise UnreadableFile(
            f"cannot write {target}: {error.strerror or error}; choose another place"
        ) from error
    finally:
        for temporary in finished.values():
            temporary.unlink(missing_ok=True)


def _save_folder(problem: LCP, folder: Path) -> None:
    from scipy.io import mmwrite

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnreadableFile(
            f"cannot make the folder {folder}: {error.strerror or error}"
        ) from error

    def writer(content: Any) -> Callable[[Any], object]:
        if 0 in content.shape:  # scipy divides by the number of columns
            kind = (
                "coordinate real general\n0 0 0"
                if sp.issparse(content)
                else "array real general\n0 1"
            )
            return lambda file: file.write(f"%%MatrixMarket matrix {kind}\n".encode())
        return lambda file: mmwrite(file, content, precision=17, symmetry="general")

    contents = {
        folder / "M.mtx": writer(sp.coo_array(problem.csr)),
        folder / "q.mtx": writer(problem.q.reshape(-1, 1)),
    }
    for name in ("lower", "upper"):
        bound = np.nan_to_num(getattr(problem, name), posinf=1e20, neginf=-1e20)  # which is none
        contents[folder / f"{name}.mtx"] = writer(bound.reshape(-1, 1))
    write_whole(contents)


def _load_npz(kind: type[LCP], source: Path) -> LCP:
    content = read_npz(source, {"M", *MATRIX_KEYS, *VECTORS, "P_data", *OF_CONES})
    if {"P_data", *OF_CONES} & content.keys() or not {"M", *MATRIX_KEYS} & content.keys():
        _refuse_other_kinds(source)
    is_compressed = any(key in content for key in MATRIX_KEYS)
    require_keys(source, content, (*(MATRIX_KEYS if is_compressed else ("M",)), "q"), LAYOUT)
    M = csr_in(source, content) if is_compressed else content["M"]
    bounds = {name: content[name] for name in ("lower", "upper") if name in content}
    return _problem(kind, str(source), M, content["q"], bounds)


def _refuse_other_kinds(source: Path) -> None:
    """Raise UnreadableFile in the words of what the names in the file state."""
    found = names_in(source)
    for what, names in (
        ("a contact problem with friction", ("mu", "friction")),
        ("a problem over cones", ("cone_kinds",)),
        ("a quadratic program", ("P", "P_data", "c", "H")),
        ("a least squares problem", ("b",)),
    ):
        if key := next((name for name in names if name in found), None):
            raise UnreadableFile(
                f"{source} holds {what} (key {key}), not an LCP: lcp_plugin.load_problem(path) reads it, "
                f"`lcp-plugin solve` solves it; {LAYOUT}"
            )


def _load_mat(kind: type[LCP], source: Path) -> LCP:
    content, names = read_mat(
        source, {"M", "q", *(name for pair in MATLAB_BOUNDS.values() for name in pair)}
    )
    there = f"it holds {', '.join(names) or 'nothing'}"
    if missing := [name for name in ("M", "q") if name not in content]:
        if "M" in missing:
            _refuse_other_kinds(source)
        raise UnreadableFile(f"{source} lacks the matrices {missing}, {there}; {MATLAB_LAYOUT}")
    rows, columns = content["M"].shape
    if rows != columns:
        raise UnreadableFile(f"M of {source} must be square, got {rows} × {columns}")
    for name in content.keys() - {"M"}:
        if max(content[name].shape) > max(rows, 1):  # before a sparse one becomes dense
            raise UnreadableFile(
                f"{name} of {source} has the shape {content[name].shape}, but M has {rows} rows"
            )
    q, bounds = flat(content["q"]), {}
    _require_a_number_a_row(content["M"], q, f"M of {source}", "q")
    for name, others in MATLAB_BOUNDS.items():
        given = [other for other in others if other in content]
        if len(given) > 1:
            raise UnreadableFile(
                f"{source} holds {' and '.join(given)}, which say the same; leave one of them out"
            )
        for other in given:
            bound = flat(content[other])
            bounds[name] = bound[0] if bound.size == 1 else bound
    return _problem(kind, str(source), content["M"], q, bounds)


def _require_a_number_a_row(M: Any, q: Any, matrix: str, vector: str) -> None:
    """Raise where that is not so, before M becomes CSR, which takes memory for every row that it announces."""
    if q.shape != M.shape[:1]:
        raise UnreadableFile(
            f"{matrix} holds a matrix of {M.shape[0]} rows and {vector} an array of shape {q.shape}; "
            "q must have one number a row"
        )


def require_keys(
    source: Path, content: Mapping[str, Any], keys: Collection[str], remedy: str
) -> None:
    """Raise UnreadableFile where one of the arrays is missing."""
    missing = [key for key in keys if key not in content]
    if missing:
        raise UnreadableFile(f"{source} lacks the keys {missing}; {remedy}")


def csr_in(source: Path, content: Mapping[str, Any], kind: Any = sp.csr_array) -> sp.csr_array:
    """Return the matrix of a file's CSR arrays, or of its CSC arrays, or raise UnreadableFile where they are none."""
    for key in ("indices", "indptr", "shape"):
        if content[key].dtype.kind not in "iu":
            raise UnreadableFile(
                f"{source}: {key} must hold integers, got dtype {content[key].dtype}"
            )
    try:
        shape = tuple(int(k) for k in content["shape"])
        matrix = kind((content["data"], content["indices"], content["indptr"]), shape=shape)
        matrix.check_format(full_check=True)
        return sp.csr_array(matrix)
    except (ValueError, IndexError, TypeError, OverflowError, MemoryError) as error:
        raise UnreadableFile(
            f"{source} holds no valid {kind.__name__[:3].upper()} matrix: {error}"
        ) from error


def names_in(source: Path) -> list[str]:
    """Return the names of the arrays in a ``.npz`` or ``.mat`` file; raise UnreadableFile where it is none."""
    if source.suffix.lower() == ".mat":
        return read_mat(source, ())[1]
    with _archive(source) as archive:
        return list(archive.files)


def read_npz(source: Path, wanted: Collection[str]) -> Mapping[str, Any]:
    """Return those of the wanted arrays that are in the file; whatever is wrong with it is an UnreadableFile."""
    with _archive(source) as archive:
        return {key: archive[key] for key in archive.files if key in wanted}


@contextmanager
def _archive(source: Path) -> Iterator[Any]:
    """Open a ``.npz`` file; whatever is found wrong with it is an UnreadableFile."""
    with opened(source, ".npz archive") as file:
        if file.read(2) != b"PK":
            raise UnreadableFile(
                f"cannot read {source}: it is damaged or no .npz archive; write it with LCP.save"
            )
        file.seek(0)
        try:
            with np.load(file, allow_pickle=False) as archive:
                yield archive
        except ValueError as error:
            if "allow_pickle" not in str(error):
                raise
            raise UnreadableFile(
                f"cannot read {source}: it holds pickled objects, which are never read; LCP.save writes a sparse M, a "
                "program's sparse P is saved as P_data, P_indices, P_indptr, P_shape, and what is None left out"
            ) from error


def _matrix_market_prefix(source: Path) -> str:
    if source.is_dir():
        prefix = f"{source}{os.sep}"
    elif source.name.endswith("M.mtx"):
        prefix = str(source)[: -len("M.mtx")]
    else:
        prefix = str(source)
    if not Path(prefix + "M.mtx").exists():
        if source.is_dir():
            raise UnreadableFile(f"no such file: {prefix}M.mtx; a folder must hold M.mtx and q.mtx")
        if source.is_file():
            raise UnreadableFile(
                f"cannot read {source}: expected an .npz, .mat, .nl file, or M.mtx with q.mtx beside it "
                f"(load_problem reads .qps, .mps, .h5); {LAYOUT}: write "
                f'LCP(M, q).save("{source.stem}.npz"), or numpy.savez("{source.stem}.npz", M=M, q=q)'
            )
        tried = "" if source.suffix else f" (nor {prefix}M.mtx)"
        raise UnreadableFile(f"no such file: {source}{tried}")
    return prefix


def _read_vector(source: Path) -> FloatVector:
    return flat(read_matrix_market(source))


def flat(values: Any) -> FloatVector:
    """Return a row or a column as a vector."""
    dense: FloatVector = np.asarray(values.toarray() if sp.issparse(values) else values)
    return dense.reshape(-1) if 1 in dense.shape else dense


def _problem(kind: type[LCP], source: str, M: Any, q: Any, bounds: Mapping[str, Any]) -> LCP:
    try:
        return kind(M, q, **bounds)
    except InvalidProblem as error:
        raise UnreadableFile(
            f"{source} states no linear complementarity problem: {error}"
        ) from error
    except MemoryError as error:
        raise UnreadableFile(
            f"{source} states a problem too large for the memory ({error})"
        ) from error
