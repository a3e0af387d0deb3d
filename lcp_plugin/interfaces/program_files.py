"""Problems from files: a table of the arrays of each class; MPS and QPS files in both formats; LP files by HiGHS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import groupby
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core import files
from ..core.checks import AnyMatrix, Array
from ..core.errors import InvalidProblem, UnreadableFile, UnsupportedModel, imported, warn
from ..core.files import checked_path, opened
from ..core.lcp import LCP
from ..core.names import Names
from ..core.problem_classes import with_article
from ..problems.cones.data import CONES, ConeProblem
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.contact import inverse_by_components
from ..problems.least_squares.data import BoundedLeastSquares
from ..problems.programs.program import QuadraticProgram
from .nl.model import lcp_in_nl

Lines = list[list[str]]  # the words of each line
Cells = dict[tuple[int, int], float]
Read = tuple[float, Names, list[str], Any]
WITH_WORDS = ("NAME", "OBJSENSE", "QSECTION")  # headers that other words may follow
SECTIONS = (*WITH_WORDS, "ROWS", "COLUMNS", "RHS", "RANGES", "BOUNDS", "QUADOBJ", "QMATRIX")
FIELDS = ((1, 3), (4, 12), (14, 22), (24, 36), (39, 47), (49, 61))
MARKED = "columns between markers of integers"
INTEGER = ("BV", "LI", "UI", "SC")
BOUND_TYPES = ("LO", "UP", "FX", "FR", "MI", "PL", *INTEGER)


class NumberOf(dict[str, int]):
    """Numbers of the rows or of the columns by their names."""

    def __init__(self, section: str, names: Iterable[str], remarks: list[str]) -> None:
        self.section, self.remarks = section, remarks
        for name in names:
            if name in self:
                raise InvalidProblem(f"{name} is stated twice in {section}; rename or join them")
            self[name] = len(self)

    def find(self, name: str, section: str, words: list[str]) -> int:
        """Return the number of a name in a line of a section; an unknown column is new, without coefficients."""
        if name not in self:
            fault = f'{name} of the line "{" ".join(words)}" in {section} is not in {self.section}'
            if self.section == "ROWS":
                raise InvalidProblem(fault)
            self.remarks.append(f"{fault}; it is a new variable")
            self[name] = len(self)
        return self[name]


def read_mps(source: Path, remarks: list[str]) -> Read:
    """Return −1 if the file maximizes, else 1; names of all, of integers; the arguments of `from_ranges`.

    Parameters
    ----------
    source : Path
    remarks : list of str
        Remarks for the user are appended.

    Raises
    ------
    InvalidProblem, ValueError
        If the file states no program.
    """
    lines = source.read_bytes().decode("utf-8", "replace").splitlines()
    sections = _sections(lines, str.split)
    has_blanks = any(len(words) != 2 for words in sections["ROWS"])
    if has_blanks or any(len(words) % 2 == 0 for words in sections["COLUMNS"]):  # fixed format
        fields = [slice(*places) for places in FIELDS]
        sections = _sections(lines, lambda line: [w for f in fields if (w := line[f].strip())])
    sense = [words[-1].upper()[:3] for words in sections["OBJSENSE"]] or ["MIN"]
    row_types = np.array([words[0].upper() for words in sections["ROWS"]], dtype=np.str_)
    if strange := {*row_types.tolist()} - {*"NLGE"} or {*sense} - {"MIN", "MAX"}:
        raise InvalidProblem(f"{strange.pop()} is not a row N, L, G, E or a sense MIN, MAX")
    rows = NumberOf("ROWS", (words[-1] for words in sections["ROWS"]), remarks)
    names = (name for name, _ in groupby(words[0] for words in sections["COLUMNS"]))
    columns = NumberOf("COLUMNS", names, remarks)
    integers = [words[0] for words in sections[MARKED]]
    entries = _entries(sections, "COLUMNS", rows, columns)
    right, ranges = (_entries(sections, section, rows) for section in ("RHS", "RANGES"))
    lower, upper = _limits(sections["BOUNDS"], columns, integers)
    products = [_entries(sections, name, columns, columns) for name in ("QUADOBJ", "QMATRIX")]
    n, m, sign = len(columns), len(rows), -1.0 if sense[-1] == "MAX" else 1.0
    A = _sparse(entries, (n, m)).T.tocsr()
    triangle, whole = (_sparse(part, (n, n)) for part in products)
    P = sign * (triangle + triangle.T - sp.diags_array(triangle.diagonal()) + whole)
    b, width = _full_row(right, 0.0, m), _full_row(ranges, np.nan, m)
    reach = np.where(np.isnan(width), np.inf, np.abs(width))
    # An equation has an interval on the side of its range's sign
    span = np.select([row_types == "L", row_types == "G"], [-reach, reach], np.nan_to_num(width))
    low, high = b + np.minimum(span, 0.0), b + np.maximum(span, 0.0)
    first, is_row = np.flatnonzero(row_types == "N")[:1], row_types != "N"
    limits = low[is_row], high[is_row], _full_row(lower, 0.0, n), _full_row(upper, np.inf, n)
    c, constant = sign * A[first].sum(axis=0), 0.0 - sign * b[first].sum()
    both = Names([name for name, k in rows.items() if is_row[k]], [*columns])
    return sign, both, [*dict.fromkeys(integers)], (P, c, A[is_row], *limits, constant)


def _sections(lines: list[str], split: Callable[[str], list[str]]) -> dict[str, Lines]:
    """Return the lines of each section, without comments."""
    sections: dict[str, Lines] = {name: [] for name in (*SECTIONS, MARKED)}
    section, known = "NAME", set[str]()  # other words that begin with $ are comments
    for line in lines:
        is_header = not line[:1].isspace()
        words = line.split() if is_header else split(line)
        if "$" in line:
            known |= {"ROWS": {*words[1:2]}, "COLUMNS": {*words[:1]}}.get(section, set())
            ends = (k for k, word in enumerate(words) if word[0] == "$" and word not in known)
            words = words[: next(ends, None)]
        if not words or words[0][0] == "*":
            continue
        name = words[0].upper().rstrip(":")
        if words[1:2] == ["'MARKER'"]:
            section = MARKED if words[-1] == "'INTORG'" else "COLUMNS"
        elif not is_header or not (len(words) == 1 or name in WITH_WORDS):
            sections[section].append(words)
        elif name == "ENDATA":
            return sections
        elif name[:3] in ("MAX", "MIN"):
            sections["OBJSENSE"].append(words)
        elif name not in SECTIONS:
            raise InvalidProblem(f"{words[0]} is not one of the sections {', '.join(SECTIONS)}")
        else:
            section = "QUADOBJ" if name == "QSECTION" else name
            sections["OBJSENSE"] += [words] if name == "OBJSENSE" and words[1:] else []
    raise InvalidProblem("it has no line ENDATA: is it complete?")


def _number_in(text: str, words: list[str], section: str) -> float:
    """Return a number of a line of a section; it may be infinite in RANGES and BOUNDS."""
    try:
        value: float = files.read_number(text)
    except ValueError:
        value = np.nan
    if np.isnan(value) or (np.isinf(value) and section not in ("RANGES", "BOUNDS")):
        line = " ".join(words)
        raise InvalidProblem(f'{text} of the line "{line}" in {section} is not a finite number')
    return value


def _entries(
    sections: dict[str, Lines], section: str, names: NumberOf, columns: NumberOf | None = None
) -> Cells:
    """Return the values by the number of a line's column, 0 if there is none, and of the name before the value."""
    entries: Cells = {}
    kept, repeated = "first" if columns is not names else "sum", ""
    for words in sections[section]:
        start = len(words) % 2 if columns is None else 1
        i = 0 if columns is None else columns.find(words[0], section, words)
        if (len(words) - start) % 2:
            line = " ".join(words)
            raise InvalidProblem(f'the line "{line}" in {section} has a name without a number')
        for name, text in zip(words[start::2], words[start + 1 :: 2], strict=True):
            key = i, names.find(name, section, words)
            value = _number_in(text, words, section)
            key = (max(key), min(key)) if section == "QUADOBJ" else key
            if key in entries:
                repeated = repeated or " ".join(sorted([name, *words[: columns is not None]]))
                value = entries[key] + value if kept == "sum" else entries[key]
            entries[key] = value
    if repeated:
        names.remarks.append(f"repeated entry of {repeated} in {section}; the {kept} holds")
    return entries


def _limits(lines: Lines, columns: NumberOf, integers: list[str]) -> tuple[Cells, Cells]:
    """Return the lower and upper bounds; the last of several bounds of a variable holds.

    The lower bound is −∞ for a negative upper bound without a lower bound.
    """
    lower, upper = Cells(), Cells()
    for words in lines:
        kind, value = words[0].upper(), np.inf
        if kind not in BOUND_TYPES or len(words) < 2:
            fault = f'"{" ".join(words)}" in BOUNDS begins with none of {", ".join(BOUND_TYPES)}'
            raise InvalidProblem(fault)
        if kind in ("FR", "MI", "PL", "BV"):  # perhaps with a number
            name = next((word for word in words[:0:-1] if word in columns), words[-1])
        else:
            name, value = words[:4][-2], _number_in(words[:4][-1], words, "BOUNDS")
        key = 0, columns.find(name, "BOUNDS", words)
        if kind in INTEGER:
            integers.append(name)
        if kind not in ("UP", "PL"):
            lower[key] = value if kind in ("LO", "FX") else -np.inf
        if kind not in ("LO", "MI"):
            upper[key] = value
    for _, j in sorted(key for key in upper if upper[key] < 0.0 and key not in lower):
        lower[0, j] = -np.inf
        columns.remarks.append(
            f"{list(columns)[j]} has the upper bound {upper[0, j]:g} and no lower bound; it is −∞: write MI, or LO"
        )
    return lower, upper


def _sparse(entries: Cells, shape: tuple[int, int]) -> sp.csr_array:
    places = np.array(list(entries), dtype=np.int64).reshape(-1, 2).T
    return sp.csr_array((list(entries.values()), tuple(places)), shape=shape)


def _full_row(entries: Cells, default: float, size: int) -> Any:
    values = np.full(size, default)
    values[[j for _, j in entries]] = list(entries.values())
    return values


ARRAYS, MPS, MARKET, NL = ".npz", (".mps", ".qps", ".lp"), ".mtx", ".nl"


# --- Contacts of fclib, the field's own collection: HDF5, read by h5py ----------------------------------------------

HDF5 = (".h5", ".hdf5")
LAYOUT = (
    "an fclib file holds fclib_local with spacedim, W, vectors/q and vectors/mu, or fclib_global with spacedim, M, H, "
    "vectors/f, vectors/w and vectors/mu; a matrix is m, n, nz, p, i, x"
)


def load_fclib(source: Path) -> FrictionalContact:
    """Return the contact problem of an fclib file, local or global, in the plane or in space.

    The local problems are u = W r + q. Global problems M v = H r + f, u = Hᵀv + w are reduced: W = Hᵀ M⁻¹ H and
    q = Hᵀ M⁻¹ f + w. A matrix is m, n, nz and the arrays p, i, x: entries with their rows p and columns i if nz ≥ 0,
    compressed columns if it is −1, compressed rows if it is −2. Guesses and solutions are not read.

    Raises
    ------
    UnreadableFile
        If the file is missing, corrupt or of another layout, or h5py is not installed.
    UnsupportedModel
        If the file has equations in addition to its contacts.
    """
    h5py = imported("h5py", f"{source} is read by h5py", "fclib", UnreadableFile)
    with opened(source, "HDF5 file") as file, h5py.File(file, "r") as content:
        try:
            for name in ("fclib_local", "fclib_global"):
                if name in content:
                    return _contacts(source, name, content[name])
            raise ValueError(f"it holds {', '.join(content) or 'nothing'}")
        except UnsupportedModel:
            raise
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise UnreadableFile(f"{source}: {error}; {LAYOUT}") from error


def _vector(group: Any, name: str, number_type: type = float) -> Any:
    """Return an array of numbers as a vector."""
    values = np.ravel(group[name][()])
    if values.dtype.kind not in ("iu" if number_type is int else "iuf"):
        needed = number_type.__name__
        raise TypeError(f"{group.name}/{name} holds {values.dtype} in place of {needed}")
    return values.astype(np.int64 if number_type is int else np.float64)


def _read_matrix(group: Any, rows: int, columns: int) -> sp.csr_array:
    """Return a matrix, whose shape follows from the vectors."""
    m, n, nz = (int(_vector(group, name, int)[0]) for name in ("m", "n", "nz"))
    if (m, n) != (rows, columns):
        raise ValueError(f"{group.name} is of {m} × {n}, its vectors need {rows} × {columns}")
    p, i, x = _vector(group, "p", int), _vector(group, "i", int), _vector(group, "x")
    if nz >= 0:
        p, i, x = p[:nz], i[:nz], x[:nz]
        if p.max(initial=0) >= rows or i.max(initial=0) >= columns:
            p, i = i, p  # CSparse stores triplets in this order
        return sp.csr_array((x, (p, i)), shape=(rows, columns))
    form, count = (sp.csc_array if nz == -1 else sp.csr_array), int(p[-1]) if p.size else 0
    matrix = form((x[:count], i[:count], p), shape=(rows, columns))
    matrix.check_format(full_check=True)
    return sp.csr_array(matrix)


def _contacts(source: Path, name: str, group: Any) -> FrictionalContact:
    d = int(_vector(group, "spacedim", int)[0])
    if equations := {"V", "R", "G"} & group.keys():
        raise UnsupportedModel(
            f"{source} has equations in addition to its contacts ({name}/{min(equations)}), which are not read; "
            "give FrictionalContact(W, b, friction, equations=p), the p equations as the last rows of W and b"
        )
    vectors, is_local = group["vectors"], name == "fclib_local"
    offset, friction = _vector(vectors, "q" if is_local else "w"), _vector(vectors, "mu")
    if d not in (2, 3) or offset.size != d * friction.size:
        raise ValueError(
            f"mu has {friction.size} numbers, spacedim is {d} (2 or 3), but velocities are {offset.size}, not d each"
        )
    if is_local:
        W = _read_matrix(group["W"], offset.size, offset.size)
    else:
        f = _vector(vectors, "f")
        H = _read_matrix(group["H"], f.size, offset.size)
        by_impulse = inverse_by_components(_read_matrix(group["M"], f.size, f.size)) @ H
        W, offset = H.T @ by_impulse, by_impulse.T @ f + offset
    return FrictionalContact(W, offset.reshape(-1, d), friction)


# --- The classes and their arrays --------------------------------------------------------------------------------


def _built_lcp(M: AnyMatrix, q: Array, **bounds: Array) -> LCP:
    # Before M becomes CSR, which takes memory for every row that a sparse matrix announces.
    if sp.issparse(M) and q.shape != M.shape[:1]:
        raise InvalidProblem(f"q must be a finite vector of length {M.shape[0]}, got {q.shape}")
    return LCP(M, q, **bounds)


def _contact(W: AnyMatrix, b: Array, friction: Array, **others: Any) -> Any:
    state = FrictionalContact.worlds if W.ndim == 3 else FrictionalContact
    return state(W, b, friction, **others)


def _cones(M: AnyMatrix, q: Array, cone_kinds: Any, cone_rows: Any, **ends: Array) -> ConeProblem:
    kinds, sizes = cone_kinds.tolist(), cone_rows.tolist()
    if not set(kinds) <= {*range(len(CONES))}:
        raise InvalidProblem(f"cone_kinds must be 0 to {len(CONES) - 1}, got {kinds}")
    cones: list[Any] = []
    for kind, size, end in zip(kinds, sizes, np.cumsum(sizes, dtype=np.int64), strict=True):
        rows = slice(end - size, end)
        is_box = CONES[kind] == "box"
        bounds = [np.atleast_1d(ends[name])[rows] for name in ("lower", "upper") if is_box]
        if any(bound.shape != (size,) for bound in bounds):
            raise InvalidProblem("lower and upper must have an entry per row if there are boxes")
        cones.append((CONES[kind], *(bounds or [size])))
    return ConeProblem(M, q, cones)


def _qp(c: Any, P: Any = None, l: Any = None, u: Any = None, **data: Any) -> QuadraticProgram:
    P = sp.csr_array((c.size, c.size)) if P is None else _symmetric(P)
    if l is None and u is None:
        return QuadraticProgram(P, c, **data)
    if "A" not in data:
        raise InvalidProblem("l, u limit A x, and A is missing; bounds of x are lower, upper")
    if rows := sorted(data.keys() & {"G", "h", "b"}):
        raise InvalidProblem(f"{', '.join(rows)} and l, u state rows; l, u are the limits of all")
    limits = -np.inf if l is None else l, np.inf if u is None else u
    return QuadraticProgram.from_ranges(P, c, data.pop("A"), *limits, **data)


def _symmetric(P: AnyMatrix) -> Any:
    """Return P; of a triangle of it the whole matrix."""
    if P.ndim != 2 or P.shape[0] != P.shape[1] or not sp.issparse(P):
        return P
    if (sp.tril(P, -1).nnz == 0) != (sp.triu(P, 1).nnz == 0):
        return P + P.T - sp.diags_array(P.diagonal())
    return P


def _aliases(words: str) -> dict[str, tuple[str, ...]]:
    """Return the names that an argument may have in a file: "c=c,q r" for c by the names c and q, and r."""
    pairs = (word.partition("=") for word in words.split())
    return {argument: tuple((names or argument).split(",")) for argument, _, names in pairs}


class Layout(NamedTuple):
    """Names in a file of each argument of a problem class, and its required arguments."""

    build: Callable[..., Any]
    names: dict[str, tuple[str, ...]]
    needed: tuple[str, ...]
    text: str


OF_PROGRAM = (
    "a program holds P, q, A, l, u (l ≤ A x ≤ u), or P, c with G, h (G x ≤ h), A, b (A x = b), lower, upper; a "
    "sparse matrix is P_data, P_indices, P_indptr, P_shape (CSC)"
)
OF_LCP = (
    "an LCP file holds M (or its CSR arrays data, indices, indptr, shape), q and, if wanted, lower and upper (or lb, "
    'ub): numpy.savez("p.npz", M=M, q=q)'
)
LAYOUTS: dict[type, Layout] = {
    LCP: Layout(_built_lcp, _aliases("M q lower=lower,lb,l upper=upper,ub,u"), ("M", "q"), OF_LCP),
    FrictionalContact: Layout(
        _contact,
        _aliases("W=W,M b=b,q friction=mu,friction contacts dimension equations"),
        ("W", "b", "friction"),
        "a FrictionalContact holds W (or the CSR arrays data, indices, indptr, shape), b (or q), mu (or friction); "
        "a batch has an axis in front, and contacts if its instances differ in size",
    ),
    ConeProblem: Layout(
        _cones,
        _aliases("M q cone_kinds cone_rows lower upper"),
        ("M", "q", "cone_kinds", "cone_rows"),
        "a ConeProblem holds M (or its CSR arrays data, indices, indptr, shape), q, cone_kinds (0 free, 1 nonnegative, "
        "2 box, 3 second order), cone_rows, and lower, upper if there are boxes",
    ),
    QuadraticProgram: Layout(
        _qp,
        _aliases("P c=c,q A l u G h b lower=lower,lb upper=upper,ub constant=r"),
        ("c",),
        OF_PROGRAM,
    ),
    BoundedLeastSquares: Layout(
        BoundedLeastSquares,
        _aliases("A b lower=lower,lb upper=upper,ub weights ridge l1"),
        ("A", "b"),
        "a least squares problem holds A, b and, if wanted, lower and upper",
    ),
}
#: Arguments that may be one number, of all rows.
SCALARS = {"lower", "upper", "l", "u", "l1", "ridge", "constant", "dimension", "equations"}


def class_of_file(source: Path) -> type:
    """Return the problem class that the ending of a file and the names in it suggest; LCP in doubt."""
    suffix = source.suffix.lower()
    if suffix in MPS:
        return QuadraticProgram
    if suffix in HDF5:
        return FrictionalContact
    if suffix != ARRAYS:
        return LCP
    names = {files.PARTS.get(name, name) for name in files.names_in(source)}
    if names & {"mu", "friction"} and names & {"W", "M"}:
        return FrictionalContact
    if "cone_kinds" in names:
        return ConeProblem
    if "P" not in names and "M" in names:
        return LCP
    if names & {"P", "c"} or {"A", "q"} <= names:
        return QuadraticProgram
    return BoundedLeastSquares if {"A", "b"} <= names else LCP


def _built(source: Path, problem_class: type, arrays: Mapping[str, Any]) -> Any:
    """Return the problem of the arrays of a file."""
    build, names, needed, text = LAYOUTS[problem_class]
    content: dict[str, Any] = {}
    for argument, choices in names.items():
        present = [name for name in choices if name in arrays]
        if len(present) > 1:
            raise UnreadableFile(
                f"{source} holds {' and '.join(present)}, two names for one thing; leave one of them out"
            )
        if present:
            array = arrays[present[0]]
            content[argument] = array.item() if argument in SCALARS and array.size == 1 else array
    if missing := [names[argument][0] for argument in needed if argument not in content]:
        raise UnreadableFile(f"{source} lacks the keys {missing}; {text}")
    return _stated(source, problem_class, lambda: build(**content))


def _stated(source: Path, problem_class: type, build: Callable[[], Any]) -> Any:
    try:
        return build()
    except MemoryError as error:
        raise UnreadableFile(f"{source} is too large for the memory ({error})") from error
    except (InvalidProblem, ValueError, LookupError, TypeError) as error:
        raise UnreadableFile(f"{source} states no {problem_class.__name__}: {error}") from error


def _read(source: Path, needed: type | None = None) -> Any:
    """Return the problem of a file."""
    problem_class, suffix = class_of_file(source), source.suffix.lower()
    if suffix == NL:
        return lcp_in_nl(source)
    if suffix not in (ARRAYS, MARKET, *MPS, *HDF5):
        raise UnreadableFile(
            f"cannot read {source}: expected an .npz, .nl, .qps, .mps, .lp, .h5 or .mtx file; {OF_LCP}"
        )
    if needed not in (None, problem_class):
        holds, is_not = with_article(problem_class.__name__), with_article(needed.__name__)
        raise UnreadableFile(
            f"{source} holds {holds}, not {is_not}: lcp_plugin.load_problem(path) reads it, `lcp-plugin solve` takes "
            f"it; {LAYOUTS[needed].text}"
        )
    if suffix in MPS:
        return _from_mps(source)
    if suffix in HDF5:
        return load_fclib(source)
    if suffix == MARKET:
        return _built(source, problem_class, files.market_arrays(source))
    wanted = {name for names in LAYOUTS[problem_class].names.values() for name in names}
    return _built(source, problem_class, files.arrays_in(source, wanted))


def load_lcp(path: str | PathLike[str]) -> LCP:
    """Return the LCP of a file; raise UnreadableFile if it states another problem."""
    return _read(checked_path(path), LCP)


def load_program(path: str | PathLike[str]) -> QuadraticProgram:
    """Return the program of a file, with its sense and names; see :func:`load_problem`."""
    return _read(checked_path(path), QuadraticProgram)


def load_problem(path: str | PathLike[str]) -> Any:
    """Return the problem of a file, of the class that its content states.

    Parameters
    ----------
    path : str or Path
        ``.qps``, ``.mps`` and ``.lp`` state programs; highspy reads .lp. ``.npz`` with M and q states an LCP; with P,
        q, A, l, u, or the arrays of a QuadraticProgram by their names, a program; with A, b and no more than bounds,
        weights, ridge and l1, a BoundedLeastSquares; with mu and a matrix a FrictionalContact, a batch if W has
        three axes; with cone_kinds a ConeProblem. No P means a linear program, r is a constant. A sparse M is data,
        indices, indptr, shape (CSR); a sparse P, A or G is P_data, P_indices, P_indptr, P_shape (CSC), of P all or one
        triangle. Never pickle. ``.h5`` and ``.hdf5`` of fclib state a FrictionalContact; h5py reads them. A Matrix
        Market file ``.mtx`` has M; q.mtx, and lower.mtx and upper.mtx if wanted, are next to it. An ``.nl`` file states
        an LCP here, any model for :func:`lcp_plugin.interfaces.nl.read_nl`.

    Raises
    ------
    UnreadableFile
        If the file is missing, corrupt, or states no problem.
    UnsupportedModel
        If the program has integers.

    Notes
    -----
    A QuadraticProgram is minimized: a ModelWarning reports a file that maximizes.
    """
    problem = _read(checked_path(path))
    if getattr(problem, "sense", 1.0) < 0.0:
        warn(
            f"{path} maximizes; the problem returned minimizes minus the objective, results state the one of the file"
        )
    return problem


# --- MPS and LP -------------------------------------------------------------------------------------------------


def _from_mps(source: Path) -> QuadraticProgram:
    if not source.is_file():
        raise UnreadableFile(f"no such file: {source}{files.in_folder(source)}")
    read, remarks = read_lp if source.suffix.lower() == ".lp" else read_mps, list[str]()
    sign, names, integers, parts = _stated(source, QuadraticProgram, lambda: read(source, remarks))
    if integers:
        raise UnsupportedModel(
            f"{source} has {len(integers)} integer variables, the first is {integers[0]}; a program has continuous "
            "ones: state it in cvxpy, or as an EquilibriumProgram with integers=…"
        )
    if remarks:
        warn(f"{source}: {'; '.join(remarks[:3])}")
    program = _stated(source, QuadraticProgram, lambda: QuadraticProgram.from_ranges(*parts))
    return program.replaced(sense=sign, names=names)


def read_lp(source: Path, remarks: list[str]) -> Read:
    """Return the program of an LP file by HiGHS, as :func:`read_mps` does."""
    try:
        import highspy
    except ImportError as error:
        raise UnreadableFile(
            f"{source} is read by HiGHS; install it with: pip install highspy"
        ) from error

    class QuietHighs(highspy.Highs):
        """HiGHS without its banner, which the constructor prints when callbacks are switched on."""

        def enableCallbacks(self) -> None:
            self.setOptionValue("log_to_console", False)
            super().enableCallbacks()  # type: ignore[no-untyped-call]

    reader: Any = QuietHighs()  # type: ignore[no-untyped-call]
    if reader.readModel(str(source)) == highspy.HighsStatus.kError:
        raise UnreadableFile(f"cannot read {source}: HiGHS finds no program in it")
    linear, hessian = reader.getLp(), reader.getModel().hessian_
    n, sign = linear.num_col_, -1.0 if linear.sense_ == highspy.ObjSense.kMaximize else 1.0

    def matrix(of: Any, rows: int) -> Any:
        return sp.csr_array(sp.csc_array((np.array(of.value_), of.index_, of.start_), (rows, n)))

    P = _symmetric(matrix(hessian, n)) if hessian.dim_ else sp.csr_array((n, n))
    limits = linear.row_lower_, linear.row_upper_, linear.col_lower_, linear.col_upper_
    parts = sign * P, sign * np.array(linear.col_cost_), matrix(linear.a_matrix_, linear.num_row_)
    column_types = zip(linear.col_names_, linear.integrality_, strict=False)
    continuous = highspy.HighsVarType.kContinuous
    integers = [name for name, column_type in column_types if column_type != continuous]
    names = Names(linear.row_names_ or None, linear.col_names_ or None)
    return sign, names, integers, (*parts, *limits, sign * linear.offset_ + 0.0)
