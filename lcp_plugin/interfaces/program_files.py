"""Problems of other kinds than LCPs from files: programs and least squares as arrays, QPS, MPS and LP through HiGHS."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.errors import InvalidProblem, ModelWarning, UnreadableFile, UnsupportedModel
from ..core.lcp import LCP
from ..core.problem_classes import with_article
from ..problems.cones.data import ConeProblem
from ..problems.cones.files import LAYOUT as CONE_LAYOUT
from ..problems.cones.files import problem_of as cone_problem_of
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.least_squares.data import BoundedLeastSquares
from ..problems.programs.program import QuadraticProgram
from .fclib import SUFFIXES as HDF5
from .fclib import load_fclib
from .files.files import MATRIX_KEYS, checked_path, csr_in, flat, names_in, read_npz, require_keys
from .files.matrix_market import read_mat
from .nl.model import program_in_nl

ARRAYS, MPS, NL = (".npz", ".mat"), (".mps", ".qps", ".lp"), ".nl"
PARTS = {f"{name}_{part}": name for name in "PAG" for part in MATRIX_KEYS}  # of CSC matrices
ALIASES = {"q": "c", "lb": "lower", "ub": "upper"}
QUADPROG = {
    "H": "P",
    "f": "c",
    "A": "G",
    "b": "h",
    "Aeq": "A",
    "beq": "b",
    "lb": "lower",
    "ub": "upper",
}
OF_PROGRAM = ("P", "c", "A", "l", "u", "G", "h", "b", "lower", "upper", "r")
OF_CONES = (
    "W",
    "M",
    *MATRIX_KEYS,
    "q",
    "b",
    "mu",
    "friction",
    "cone_kinds",
    "cone_rows",
    "lower",
    "upper",
    "contacts",
    "dimension",
)
OF_LEAST_SQUARES = ("A", "b", "lower", "upper", "weights", "ridge", "l1")
MATRICES = ("P", "A", "G", "H", "Aeq")
MOST_ROWS = 10**8
KEYS = {*OF_PROGRAM, *OF_LEAST_SQUARES, *PARTS, *ALIASES, *QUADPROG}
LAYOUT = (
    "a program holds P, q, A, l, u (l ≤ A x ≤ u), or P, c with G, h (G x ≤ h), A, b (A x = b), lower, upper where "
    "there are such, or H, f, A, b, Aeq, beq, lb, ub as quadprog has them; a sparse matrix by P_data, P_indices, "
    "P_indptr, P_shape (CSC)"
)


class Stated(NamedTuple):
    """A program as a file states it.

    Attributes
    ----------
    program : QuadraticProgram
        To be minimised.
    constant : float
        What is added to its objective.
    sign : float
        −1 where the file maximises: its objective is sign · (that of the program + constant).
    names : sequence of str or None
        Of the variables.
    """

    program: QuadraticProgram
    constant: float = 0.0
    sign: float = 1.0
    names: Sequence[str] | None = None


def load_problem(path: str | PathLike[str]) -> Any:
    """Return the problem of a file, of the kind that its content states.

    Parameters
    ----------
    path : str or Path
        ``.qps``, ``.mps`` and ``.lp`` state programs. ``.npz`` and ``.mat`` with M and q state an LCP; with P, q, A,
        l, u, or the arrays of a QuadraticProgram by their names, or quadprog's H, f, A, b, Aeq, beq, lb, ub a program;
        with A and b, no more than bounds, weights, ridge and l1 beside them, a BoundedLeastSquares; with mu beside a
        matrix a FrictionalContact, of many worlds where W has three axes, with cone_kinds a ConeProblem (``.npz``
        alone). ``.h5`` and ``.hdf5`` of fclib, the field's collection, state a FrictionalContact; h5py reads them.
        Everything else is read by :meth:`lcp_plugin.LCP.load`, and AMPL's ``.nl`` of any kind by
        :func:`lcp_plugin.interfaces.nl.read_nl`.

    Raises
    ------
    UnreadableFile
        Where the file is missing, damaged or of another kind.
    InvalidProblem, UnsupportedModel
        Where it states no problem, or one with integers.

    Notes
    -----
    A QuadraticProgram is minimised, and has no constant: a ModelWarning tells of a file that has it otherwise.
    """
    kind = kind_in(path)
    if kind is QuadraticProgram:
        program, constant, sign, _ = load_program(path)
        if constant or sign < 0.0:
            stated = f"objective {constant:+g}" if sign > 0.0 else f"-(objective {constant:+g})"
            said = f"{path} states {stated}, where objective is what the problem returned minimises"
            warnings.warn(said, ModelWarning, stacklevel=2)
        return program
    if kind is FrictionalContact and checked_path(path).suffix.lower() in HDF5:
        return load_fclib(checked_path(path))
    if kind in (ConeProblem, FrictionalContact):
        return _cones_in(checked_path(path))
    return load_least_squares(path) if kind is BoundedLeastSquares else LCP.load(path)


def _cones_in(source: Path) -> Any:
    content = dict(read_npz(source, OF_CONES))
    if content.keys() & {*MATRIX_KEYS}:
        require_keys(source, content, MATRIX_KEYS, CONE_LAYOUT)
        content["M"] = csr_in(source, content)
    return cone_problem_of(content, source)


def kind_in(path: str | PathLike[str]) -> Any:
    """Return the class of the problem that a file seems to state, by its ending and the names in it; LCP in doubt."""
    source = checked_path(path)
    try:
        is_file = source.is_file()
    except OSError:  # a name that no file can have
        is_file = False
    if source.suffix.lower() in MPS:
        return QuadraticProgram
    if source.suffix.lower() in HDF5:
        return FrictionalContact
    if source.suffix.lower() not in ARRAYS or not is_file:
        return LCP
    names = {PARTS.get(name, name) for name in names_in(source)}
    if names & {"mu", "friction"} and names & {"W", "M", *MATRIX_KEYS}:
        return FrictionalContact
    if "cone_kinds" in names:
        return ConeProblem
    if "M" in names or names & {*MATRIX_KEYS}:
        return LCP
    if names & {"P", "c", "H", "f"} or {"A", "q"} <= names:
        return QuadraticProgram
    return BoundedLeastSquares if {"A", "b"} <= names else LCP


def load_program(path: str | PathLike[str]) -> Stated:
    """Return the quadratic or linear program of a file.

    Parameters
    ----------
    path : str or Path
        ``.npz`` or ``.mat`` with the arrays P, q, A, l, u of min ½ xᵀP x + qᵀx over l ≤ A x ≤ u, or with those of
        :class:`~lcp_plugin.QuadraticProgram` by their names (q, lb, ub stand for c, lower, upper), or with MATLAB's H,
        f, A, b, Aeq, beq, lb, ub. No P means a linear program; r is a constant. A limit beyond ±1e20 is none. Sparse
        matrices in ``.npz`` are ``P_data, P_indices, P_indptr, P_shape`` (CSC), so of A and G; of a symmetric P all or
        one triangle. Never pickle. Or ``.qps``, ``.mps``, ``.lp``, which highspy reads, a package that cvxpy
        needs in its newer releases. Or AMPL's ``.nl``.

    Raises
    ------
    UnreadableFile
        Where it is missing, damaged or of another kind.
    InvalidProblem
        Where the arrays do not state a program.
    UnsupportedModel
        Of a file with integers, or an ``.nl`` file that states something else.
    """
    source = checked_path(path)
    suffix = source.suffix.lower()
    if suffix in ARRAYS:
        return _from_arrays(source)
    if suffix in MPS:
        return _from_mps(source)
    if suffix == NL:
        return Stated(*program_in_nl(source))
    if not source.exists():
        raise UnreadableFile(f"no such file: {source}")
    raise UnreadableFile(
        f"cannot read {source}: a program is an .npz, .mat, .qps, .mps, .lp or .nl file; other problems are for "
        "`lcp-plugin solve`"
    )


def load_least_squares(path: str | PathLike[str]) -> BoundedLeastSquares:
    """Return the problem of an ``.npz`` or ``.mat`` file with A, b and, if wanted, lower, upper, weights, ridge, l1.

    See :class:`~lcp_plugin.BoundedLeastSquares` for what is meant where one is missing: lower is 0 then. Bounds may be
    called lb and ub, and a sparse A is A_data, A_indices, A_indptr, A_shape (CSC) in ``.npz``.
    """
    source = checked_path(path)
    content = _arrays(source, {*OF_LEAST_SQUARES, "lb", "ub", *PARTS})
    content = {ALIASES.get(name, name): array for name, array in content.items()}
    require_keys(
        source,
        content,
        ("A", "b"),
        "a least squares problem holds A, b and, if wanted, lower and upper",
    )
    try:
        return BoundedLeastSquares(
            content["A"],
            content["b"],
            **_limits(content, "lower", "upper"),
            weights=content.get("weights"),
            ridge=_number(content.get("ridge", 0.0)),
            l1=_limits(content, "l1").get("l1", 0.0),
        )
    except (InvalidProblem, ValueError) as error:
        raise InvalidProblem(f"{source}: {error}") from error


# --- Arrays -----------------------------------------------------------------------------------------------------


def _from_arrays(source: Path) -> Stated:
    names = set(names_in(source))
    found = kind_in(source)
    if others := names & {"M", "W", *MATRIX_KEYS} or (
        names & {"b"} if found is BoundedLeastSquares else set()
    ):
        what = "a least squares problem" if others == {"b"} else with_article(found.__name__)
        raise UnreadableFile(
            f"{source} holds {what} (key {min(others)}), not a program: `lcp-plugin solve` takes it; {LAYOUT}"
        )
    content = _arrays(source, KEYS)
    renamed = QUADPROG if content.keys() & {"H", "f"} else ALIASES
    program: dict[str, Any] = {}
    for name, array in content.items():
        if (known := renamed.get(name, name)) in program or (
            renamed is QUADPROG and name not in (*QUADPROG, "r")
        ):
            raise UnreadableFile(f"{source} holds {name} beside other names for the same; {LAYOUT}")
        program[known] = array
    require_keys(source, program, ("c",), LAYOUT)
    constant = _number(program.pop("r", 0.0))
    P, c, A = program.pop("P", None), program.pop("c"), program.pop("A", None)
    P = sp.csr_array((c.size, c.size)) if P is None else _whole(P)
    try:
        bounds = _limits(program, "lower", "upper")
        kind = QuadraticProgram
        if program.keys() & {"l", "u"}:
            _require_ranges_alone(source, program, A)
            limits = {"l": -np.inf, "u": np.inf} | _limits(program, "l", "u")
            return Stated(kind.from_ranges(P, c, A, limits["l"], limits["u"], **bounds), constant)
        return Stated(kind(P, c, A=A, **program, **bounds), constant)
    except InvalidProblem as error:
        raise InvalidProblem(f"{source}: {error}") from error


def _require_ranges_alone(source: Path, program: Mapping[str, Any], A: Any) -> None:
    if A is None:
        raise UnreadableFile(
            f"{source} holds l or u, the limits of A x, and no A; bounds of x are lower and upper"
        )
    if others := sorted(program.keys() & {"G", "h", "b"}):
        raise UnreadableFile(
            f"{source} holds {', '.join(others)} beside l and u, the limits of all rows; {LAYOUT}"
        )


def _arrays(source: Path, wanted: set[str]) -> dict[str, Any]:
    """Return the arrays of a file by name, matrices put together from their parts; without what is empty in MATLAB."""
    if source.suffix.lower() == ".mat":
        found = {
            name: array
            for name, array in read_mat(source, wanted)[0].items()
            if 0 not in array.shape
        }
        for name, array in found.items():
            if (
                max(array.shape) > MOST_ROWS
            ):  # of a sparse one, which takes a few bytes until it is dense
                raise UnreadableFile(
                    f"{name} of {source} has the shape {array.shape}; at most {MOST_ROWS} are taken"
                )
        return {
            name: array if name in MATRICES else flat(array).reshape(-1)
            for name, array in found.items()
        }
    found = dict(read_npz(source, wanted))
    for name in "PAG":
        if parts := {
            part: found.pop(f"{name}_{part}") for part in MATRIX_KEYS if f"{name}_{part}" in found
        }:
            require_keys(
                source, parts, MATRIX_KEYS, f"the CSC matrix {name} is {', '.join(_parts(name))}"
            )
            found[name] = csr_in(source, parts, sp.csc_array)
    return found


def _parts(name: str) -> list[str]:
    return [f"{name}_{part}" for part in MATRIX_KEYS]


def _limits(program: dict[str, Any], *names: str) -> dict[str, Any]:
    """Take the limits of these names out of the arrays; a single number stands for all."""
    found = {name: np.asarray(program.pop(name)) for name in names if name in program}
    return {name: limit.reshape(()) if limit.size == 1 else limit for name, limit in found.items()}


def _number(value: Any) -> float:
    array = np.asarray(value)
    if array.size != 1 or array.dtype.kind not in "fiub":
        raise InvalidProblem(
            f"r and ridge must be numbers, got shape {array.shape} of dtype {array.dtype}"
        )
    return float(array.reshape(())[()])


def _whole(P: Any) -> Any:
    """Return P, or of a triangle of it, all of it."""
    if P.ndim != 2 or P.shape[0] != P.shape[1] or not sp.issparse(P):
        return P
    if (sp.tril(P, -1).nnz == 0) != (sp.triu(P, 1).nnz == 0):
        return P + P.T - sp.diags_array(P.diagonal())
    return P


# --- MPS --------------------------------------------------------------------------------------------------------


def _from_mps(source: Path) -> Stated:
    try:
        import highspy
    except ImportError as error:
        raise UnreadableFile(
            f"{source} is read by HiGHS; install it with: pip install highspy"
        ) from error
    if not source.is_file():
        raise UnreadableFile(f"no such file: {source}")

    class Silent(highspy.Highs):
        """HiGHS without its banner, which its constructor prints when it switches callbacks on."""

        def enableCallbacks(self) -> None:
            self.setOptionValue("output_flag", False)
            super().enableCallbacks()  # type: ignore[no-untyped-call]

    reader: Any = Silent()  # type: ignore[no-untyped-call]
    reader.setOptionValue("output_flag", False)
    with tempfile.TemporaryDirectory() as folder:  # HiGHS goes by the ending of the name
        copy = Path(folder) / f"program{'.lp' if source.suffix.lower() == '.lp' else '.mps'}"
        copy.write_bytes(source.read_bytes())
        if reader.readModel(str(copy)) == highspy.HighsStatus.kError:
            raise UnreadableFile(f"cannot read {source}: HiGHS finds no program in it")
    model = reader.getModel()
    linear, hessian = model.lp_, model.hessian_
    kinds = enumerate(linear.integrality_)
    if integers := [j for j, kind in kinds if kind != highspy.HighsVarType.kContinuous]:
        first = linear.col_names_[integers[0]] if linear.col_names_ else f"x[{integers[0]}]"
        raise UnsupportedModel(
            f"{source} has {len(integers)} integer variables, the first is {first}; a program has continuous ones: "
            "state it in cvxpy, or as an EquilibriumProgram with integers=…"
        )
    n, m = linear.num_col_, linear.num_row_
    matrix = linear.a_matrix_
    is_columns = matrix.format_ == highspy.MatrixFormat.kColwise
    kind = sp.csc_array if is_columns else sp.csr_array
    A = sp.csr_array(kind((np.array(matrix.value_), matrix.index_, matrix.start_), shape=(m, n)))
    P: Any = sp.csr_array((n, n))
    if hessian.dim_:
        P = sp.csr_array(
            sp.csc_array((np.array(hessian.value_), hessian.index_, hessian.start_), shape=(n, n))
        )
    sense = -1.0 if linear.sense_ == highspy.ObjSense.kMaximize else 1.0
    try:
        program = QuadraticProgram.from_ranges(
            sense * _whole(P),
            sense * np.array(linear.col_cost_),
            A,
            linear.row_lower_,
            linear.row_upper_,
            linear.col_lower_,
            linear.col_upper_,
        )
    except InvalidProblem as error:
        raise InvalidProblem(f"{source}: {error}") from error
    names = list(linear.col_names_)
    return Stated(program, sense * float(linear.offset_), sense, names if len(names) == n else None)
