"""Problems as one ``.npz`` file, and matrices of Matrix Market files."""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from traceback import walk_tb
from typing import Any

import numpy as np
import scipy.sparse as sp

from .checks import Array, Vector
from .errors import InvalidOption, LCPError, UnreadableFile
from .lcp import LCP

NUMBERS = ("real", "double", "integer", "unsigned-integer")
SYMMETRIES = ("general", "symmetric", "skew-symmetric")
NUMBER_TEXT = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|[-+]?inf|nan"
NO_NUMBER = re.compile(rb"(?im)^(?!%)(?:(?:" + NUMBER_TEXT + rb")(?:[ \t\r]+|$)|[ \t\r]+)*+(\S+)")


def read_number(word: bytes | str, number_type: type = float) -> Any:
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
    return number_type(text)


def in_folder(source: Path) -> str:
    """Return the next step for a path that does not exist: the folder from which it was looked up."""
    return "; check the path" + ("" if source.is_absolute() else f" (from the folder {Path.cwd()})")


@contextmanager
def opened(source: Path, file_format: str) -> Iterator[Any]:
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
            f"cannot read {source}: it is damaged or no {file_format} ({error})"
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
            shape = rows, columns
            return sp.coo_array(shape) if form == "coordinate" else np.zeros(shape)
        matrix = mmread(source, spmatrix=False)
    return sp.coo_array(matrix) if sp.issparse(matrix) else np.asarray(matrix, dtype=np.float64)


def market_arrays(source: Path) -> dict[str, Any]:
    """Return M of a Matrix Market file, and q, lower, upper of the files of these names next to it."""
    arrays = {"M": read_matrix_market(source)}
    for name in LCP.vector_names:
        if (file := source.with_name(f"{name}.mtx")).exists() or name == "q":
            values = read_matrix_market(file)
            # before a sparse array becomes dense
            if max(values.shape) > max(arrays["M"].shape[0], 1):
                raise UnreadableFile(f"{file} has the shape {values.shape}, too large for M")
            arrays[name] = flat(values)
    return arrays


MATRIX_KEYS = ("data", "indices", "indptr", "shape")
#: Names of the parts of sparse matrices: of M in CSR without a prefix, of P, A and G in CSC.
PARTS = {key: "M" for key in MATRIX_KEYS} | {f"{M}_{key}": M for M in "PAG" for key in MATRIX_KEYS}
LARGE_UNPACKED = 2**30  # bytes


def save_lcp(problem: LCP, path: str | PathLike[str]) -> None:
    """Write the problem to a ``.npz`` file."""
    M = {name: getattr(problem.csr, name) for name in MATRIX_KEYS}
    save_arrays(path, M | {name: getattr(problem, name) for name in LCP.vector_names}, "an LCP")


def save_arrays(path: str | PathLike[str], arrays: Mapping[str, Any], what: str) -> None:
    """Write the arrays of a problem, which `what` describes, to a ``.npz`` file."""
    target = checked_path(path)
    if target.suffix.lower() != ".npz":
        raise UnreadableFile(
            f"cannot write {target}: {what} is saved in one .npz file; write {target.stem}.npz"
        )
    write_whole({target: lambda file: np.savez_compressed(file, **arrays)})


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


def csr_in(source: Path, content: Mapping[str, Any], layout: Any = sp.csr_array) -> sp.csr_array:
    """Return the matrix of a file's CSR or CSC arrays; raise UnreadableFile if they are invalid."""
    for key in ("indices", "indptr", "shape"):
        if content[key].dtype.kind not in "iu":
            raise UnreadableFile(
                f"{source}: {key} must hold integers, got dtype {content[key].dtype}"
            )
    try:
        shape = tuple(int(k) for k in content["shape"])
        matrix = layout((content["data"], content["indices"], content["indptr"]), shape=shape)
        matrix.check_format(full_check=True)
        return sp.csr_array(matrix)
    except (ValueError, IndexError, TypeError, OverflowError, MemoryError) as error:
        raise UnreadableFile(
            f"{source} holds no valid {layout.__name__[:3].upper()} matrix: {error}"
        ) from error


def names_in(source: Path) -> list[str]:
    """Return the names of the arrays in a ``.npz`` file, or raise UnreadableFile."""
    with _archive(source) as archive:
        return list(archive.files)


def arrays_in(source: Path, wanted: Collection[str]) -> dict[str, Any]:
    """Return the wanted arrays of a ``.npz`` file that are there, sparse matrices put together."""
    content = dict(read_npz(source, {*wanted, *(part for part, M in PARTS.items() if M in wanted)}))
    for matrix in dict.fromkeys(PARTS.values()):
        parts = [part for part, of in PARTS.items() if of == matrix]
        if any(part in content for part in parts):
            layout = sp.csr_array if matrix == "M" else sp.csc_array
            form = "CSR" if matrix == "M" else "CSC"
            if missing := [part for part in parts if part not in content]:
                is_form = f"a sparse {matrix} is {', '.join(parts)} ({form})"
                raise UnreadableFile(f"{source} lacks the keys {missing}; {is_form}")
            arrays = dict(zip(MATRIX_KEYS, map(content.pop, parts), strict=True))
            content[matrix] = csr_in(source, arrays, layout)
    return content


def read_npz(source: Path, wanted: Collection[str]) -> Mapping[str, Any]:
    """Return the wanted arrays of the file; any fault of the file raises UnreadableFile."""
    with _archive(source) as npz:
        parts = [one for one in npz.zip.infolist() if one.filename.removesuffix(".npy") in wanted]
        packed, size = sum(one.compress_size for one in parts), sum(one.file_size for one in parts)
        # Sparse arrays of a problem shrink about tenfold, a matrix of zeros 1000-fold.
        if size > max(LARGE_UNPACKED, 100 * packed):
            raise UnreadableFile(
                f"cannot read {source}: its {packed} bytes unpack to {size}, almost all of them repetitions; save "
                "a sparse matrix as the arrays data, indices, indptr and shape"
            )
        return {key: npz[key] for key in npz.files if key in wanted}


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


def flat(values: Array) -> Vector:
    """Return a row or a column as a vector."""
    dense: Vector = np.asarray(values.toarray() if sp.issparse(values) else values)
    return dense.reshape(-1) if 1 in dense.shape else dense
