"""Problems as one ``.npz`` or a folder of Matrix Market files, and the arrays of MATLAB's .mat files of versions ≤ 7.2.

The reader of .mat files, of scipy, may end the process on a corrupt file: read files that you trust.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from traceback import walk_tb
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from .checks import Vector
from .errors import InvalidOption, LCPError, UnreadableFile

if TYPE_CHECKING:
    from .lcp import LCP

NUMBERS = ("real", "double", "integer", "unsigned-integer")
SYMMETRIES = ("general", "symmetric", "skew-symmetric")
NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|[-+]?inf|nan"
NO_NUMBER = re.compile(rb"(?im)^(?!%)(?:(?:" + NUMBER + rb")(?:[ \t\r]+|$)|[ \t\r]+)*+(\S+)")
WHOLE = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
NUMERIC = {"sparse", "double", "single", "logical", *WHOLE}


def read_number(word: bytes | str, kind: type = float) -> Any:
    """Return the number, of that type, that a word of a file states in ASCII characters.

    Python reads 1_0 as 10, and digits of all languages.

    Raises
    ------
    ValueError
        If it is no number.
    """
    text = word.encode() if isinstance(word, str) else word
    if not text.isascii() or b"_" in text:
        raise ValueError(f"{word!r} is not a number")
    return kind(text)


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
        # 10⁷ rows or columns may be announced with less than a byte for each
        if max(rows, columns) > max(10_000_000, len(content)) or count > len(content):
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
    """Return the file of M, and M, q, lower, upper of the Matrix Market files in a folder."""
    if source.is_file() and source.name != "M.mtx":
        raise UnreadableFile(
            f"cannot read {source}: expected an .npz, .mat, .nl, .qps, .mps, .lp or .h5 file, or a folder with M.mtx "
            f"and q.mtx; {layout}"
        )
    folder = source.parent if source.name == "M.mtx" else source
    if not folder.is_dir():
        raise UnreadableFile(f"no such file: {source}{in_folder(source)}")
    for name in ("M.mtx", "q.mtx"):
        if not (folder / name).exists():
            missing = f"no such file: {folder / name}"
            raise UnreadableFile(f"{missing}; a folder must hold M.mtx and q.mtx")
    found = {"M": read_matrix_market(folder / "M.mtx")}
    for name in ("q", "lower", "upper"):
        if (file := folder / f"{name}.mtx").exists():
            values = read_matrix_market(file)
            if max(values.shape) > max(found["M"].shape[0], 1):  # before a sparse one becomes dense
                raise UnreadableFile(f"{file} has the shape {values.shape}, too large for M")
            found[name] = flat(values)
    return folder / "M.mtx", found


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


MATRIX_KEYS = ("data", "indices", "indptr", "shape")
VECTORS = ("q", "lower", "upper")
#: Names of the parts of sparse matrices: of M in CSR without a prefix, of P, A and G in CSC.
PARTS = {key: "M" for key in MATRIX_KEYS} | {f"{M}_{key}": M for M in "PAG" for key in MATRIX_KEYS}
# matrices; everything else in a .mat file is a vector
DENSE = ("M", "W", "P", "A", "G", "H", "Aeq")
MOST_ROWS = 10**8  # a header with more is damaged: vectors alone would take 1 GB
LARGE_UNPACKED = 2**30  # bytes


def save(problem: LCP, target: Path) -> None:
    """Write the problem to a ``.npz`` file or, for any other path, into a folder of Matrix Market files."""
    if target.suffix.lower() == ".npz":
        M = {name: getattr(problem.csr, name) for name in MATRIX_KEYS}
        save_arrays(target, M | {name: getattr(problem, name) for name in VECTORS}, "an LCP")
    else:
        _save_folder(problem, checked_folder(target))


def save_arrays(path: str | PathLike[str], arrays: Mapping[str, Any], what: str) -> None:
    """Write the arrays of a problem, which `what` describes, to a ``.npz`` file."""
    target = checked_path(path)
    if target.suffix.lower() != ".npz":
        raise UnreadableFile(
            f"cannot write {target}: {what} is saved in one .npz file; write {target.stem}.npz"
        )
    write_whole({target: lambda file: np.savez_compressed(file, **arrays)})


def checked_folder(target: Path) -> Path:
    """Return the path; raise UnreadableFile for a name with the ending of another format."""
    # A number behind a dot is a part of the name, as in "size=0.5".
    if target.suffix[1:2].isalpha() and not target.is_dir():
        raise UnreadableFile(
            f"cannot write {target}: a problem becomes one .npz or .nl file or a folder of files, not a "
            f"{target.suffix} file; write {target.stem}.npz, or {target.stem} for a folder"
        )
    return target


def checked_path(path: Any) -> Path:
    """Return the path; raise InvalidOption or UnreadableFile if it cannot be a path."""
    try:
        target = Path(path)
    except TypeError:
        raise InvalidOption(f"path must be a string or a Path, got {type(path).__name__}") from None
    if "\0" in str(target):
        raise UnreadableFile(f"no file can be called {str(target)!r}; leave out the null character")
    return target


def write_whole(contents: Mapping[Path, Callable[[Any], object]]) -> None:
    """Write temporary files next to the targets, then rename them: all are complete, or none is.

    Raises
    ------
    UnreadableFile
        If a directory does not exist or is not writable.
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
        return lambda file: mmwrite(file, content, precision=17, symmetry="general")

    contents = {
        folder / "M.mtx": writer(sp.coo_array(problem.csr)),
        folder / "q.mtx": writer(problem.q.reshape(-1, 1)),
    }
    for name in ("lower", "upper"):
        bound = np.nan_to_num(getattr(problem, name), posinf=1e20, neginf=-1e20)  # which is none
        contents[folder / f"{name}.mtx"] = writer(bound.reshape(-1, 1))
    write_whole(contents)


def csr_in(source: Path, content: Mapping[str, Any], kind: Any = sp.csr_array) -> sp.csr_array:
    """Return the matrix of a file's CSR or CSC arrays; raise UnreadableFile if they are invalid."""
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
    """Return the names of the arrays in a ``.npz`` or ``.mat`` file, or raise UnreadableFile."""
    if source.suffix.lower() == ".mat":
        return read_mat(source, ())[1]
    with _archive(source) as archive:
        return list(archive.files)


def arrays_in(source: Path, wanted: Collection[str]) -> dict[str, Any]:
    """Return the wanted arrays of a ``.npz`` or ``.mat`` file that are there, sparse matrices put together."""
    if source.suffix.lower() == ".mat":
        found = {}
        for name, array in read_mat(source, wanted)[0].items():
            # of a sparse array, which takes few bytes until it is dense
            if max(array.shape) > MOST_ROWS:
                most = f"at most {MOST_ROWS} are taken"
                raise UnreadableFile(f"{name} of {source} has the shape {array.shape}; {most}")
            if 0 not in array.shape:  # nothing, in MATLAB
                found[name] = array if name in DENSE else flat(array)
        return found
    found = dict(read_npz(source, {*wanted, *(part for part, M in PARTS.items() if M in wanted)}))
    for matrix in dict.fromkeys(PARTS.values()):
        parts = [part for part, of in PARTS.items() if of == matrix]
        if any(part in found for part in parts):
            kind = sp.csr_array if matrix == "M" else sp.csc_array
            form = "CSR" if matrix == "M" else "CSC"
            if missing := [part for part in parts if part not in found]:
                is_form = f"a sparse {matrix} is {', '.join(parts)} ({form})"
                raise UnreadableFile(f"{source} lacks the keys {missing}; {is_form}")
            arrays = dict(zip(MATRIX_KEYS, map(found.pop, parts), strict=True))
            found[matrix] = csr_in(source, arrays, kind)
    return found


def read_npz(source: Path, wanted: Collection[str]) -> Mapping[str, Any]:
    """Return the wanted arrays of the file; any fault of the file raises UnreadableFile."""
    with _archive(source) as archive:
        parts = [
            one for one in archive.zip.infolist() if one.filename.removesuffix(".npy") in wanted
        ]
        packed, size = sum(one.compress_size for one in parts), sum(one.file_size for one in parts)
        # Sparse arrays of a problem shrink about tenfold, a matrix of zeros 1000-fold.
        if size > max(LARGE_UNPACKED, 100 * packed):
            raise UnreadableFile(
                f"cannot read {source}: its {packed} bytes unpack to {size}, almost all of them repetitions; save "
                "a sparse matrix as the arrays data, indices, indptr and shape"
            )
        return {key: archive[key] for key in archive.files if key in wanted}


@contextmanager
def _archive(source: Path) -> Iterator[Any]:
    """Open a ``.npz`` file; any fault of the file raises UnreadableFile."""
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
                "program's sparse P is saved as P_data, P_indices, P_indptr, P_shape, and arrays that are None are "
                "left out"
            ) from error


def flat(values: Any) -> Vector:
    """Return a row or a column as a vector."""
    dense: Vector = np.asarray(values.toarray() if sp.issparse(values) else values)
    return dense.reshape(-1) if 1 in dense.shape else dense
