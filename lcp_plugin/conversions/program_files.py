"""Quadratic programs from files: ``.npz`` of arrays, QPS and MPS through HiGHS."""

from __future__ import annotations

import tempfile
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..errors import InvalidProblem, UnreadableFile, UnsupportedModel
from ..problem.files import checked_path, read_npz
from .program import QuadraticProgram

MATRICES = tuple(f"{name}_{part}" for name in "PA" for part in ("data", "indices", "indptr", "shape"))
VECTORS = ("q", "l", "u")
MPS = (".mps", ".qps")


def load_program(path: str | PathLike[str]) -> tuple[QuadraticProgram, float]:
    """Return the program min ½ xᵀP x + qᵀx + r over l ≤ A x ≤ u of a file, and r.

    Parameters
    ----------
    path : str or Path
        ``.npz`` with the arrays ``P_data, P_indices, P_indptr, P_shape`` (CSC; of a symmetric P all or one triangle),
        the same of A, ``q, l, u`` (beyond ±1e20: no limit) and, if it is not 0, ``r``; never pickle. Or ``.qps``,
        ``.mps``, which highspy reads, a package that cvxpy needs in its newer releases. Or AMPL's ``.nl``.

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
    if source.suffix.lower() == ".npz":
        return _from_npz(source)
    if source.suffix.lower() in MPS:
        return _from_mps(source)
    if source.suffix.lower() == ".nl":
        from .. import program_in_nl

        stated: tuple[QuadraticProgram, float] = program_in_nl(source)
        return stated
    raise UnreadableFile(f"cannot read {source}: a quadratic program is an .npz, .qps, .mps or .nl file")


def _from_npz(source: Path) -> tuple[QuadraticProgram, float]:
    content = read_npz(source, {*MATRICES, *VECTORS, "r"})
    missing = [key for key in (*MATRICES, *VECTORS) if key not in content]
    if missing:
        raise UnreadableFile(f"{source} lacks the keys {missing}; a program holds {', '.join((*MATRICES, *VECTORS))}")
    try:
        P, A = (
            sp.csr_array(sp.csc_array(
                (content[f"{name}_data"], content[f"{name}_indices"], content[f"{name}_indptr"]),
                shape=tuple(int(k) for k in content[f"{name}_shape"]),
            )) for name in "PA"
        )
        offset = float(content.get("r", 0.0))
    except (ValueError, TypeError, OverflowError, MemoryError) as error:
        raise UnreadableFile(f"{source} holds no valid CSC matrices: {error}") from error
    return _program(source, P, content["q"], A, content["l"], content["u"]), offset


def _from_mps(source: Path) -> tuple[QuadraticProgram, float]:
    try:
        import highspy
    except ImportError as error:
        raise UnreadableFile(f"{source} is read by HiGHS; install it with: pip install highspy") from error
    if not source.is_file():
        raise UnreadableFile(f"no such file: {source}")
    reader: Any = highspy.Highs()  # type: ignore[no-untyped-call]
    reader.setOptionValue("output_flag", False)
    with tempfile.TemporaryDirectory() as folder:  # HiGHS goes by the ending of the name
        copy = Path(folder) / "program.mps"
        copy.write_bytes(source.read_bytes())
        if reader.readModel(str(copy)) == highspy.HighsStatus.kError:
            raise UnreadableFile(f"cannot read {source}: HiGHS finds no program in it")
    model = reader.getModel()
    linear, hessian = model.lp_, model.hessian_
    if any(kind != highspy.HighsVarType.kContinuous for kind in linear.integrality_):
        raise UnsupportedModel(f"{source} has integer variables; only continuous ones make a convex program")
    n, m = linear.num_col_, linear.num_row_
    matrix = linear.a_matrix_
    is_columns = matrix.format_ == highspy.MatrixFormat.kColwise
    kind = sp.csc_array if is_columns else sp.csr_array
    A = sp.csr_array(kind((np.array(matrix.value_), matrix.index_, matrix.start_), shape=(m, n)))
    P: Any = sp.csr_array((n, n))
    if hessian.dim_:
        P = sp.csr_array(sp.csc_array((np.array(hessian.value_), hessian.index_, hessian.start_), shape=(n, n)))
    sense = -1.0 if linear.sense_ == highspy.ObjSense.kMaximize else 1.0
    return _program(
        source, sense * P, sense * np.array(linear.col_cost_), A, linear.row_lower_, linear.row_upper_,
        linear.col_lower_, linear.col_upper_,
    ), sense * float(linear.offset_)


def _program(source: Path, P: Any, c: Any, A: Any, *limits: Any) -> QuadraticProgram:
    """Return the program; of a triangle of P, all of it."""
    try:
        if P.shape[0] == P.shape[1] and (sp.tril(P, -1).nnz == 0) != (sp.triu(P, 1).nnz == 0):
            P = P + P.T - sp.diags_array(P.diagonal())
        return QuadraticProgram.from_ranges(P, c, A, *limits)
    except InvalidProblem as error:
        raise InvalidProblem(f"{source}: {error}") from error
