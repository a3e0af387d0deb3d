"""What cvxpy compiled a problem to, as a program at the present values of its parameters.

cvxpy keeps each number of a compiled problem as an affine function of the parameters, column by column of a matrix
whose last column is the right-hand side. To apply it, to slice it into equations and inequalities and to sort these by
rows takes longer than to solve a small program. Here the numbers are sorted once, and what no parameter enters is kept.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import FloatVector, assembled
from ..core.matrix.symmetry import is_its_mirror
from ..problems.programs.program_matrices import ProgramMatrices

RELEASES = ("1.8.", "1.9.")  # of cvxpy, which are known to compile to this
ONES = -1  # cvxpy's id of the parameter that is 1


class _Numbers(NamedTuple):
    """Numbers that are affine in the parameters, and the places of a matrix in which they stand.

    Attributes
    ----------
    places : ndarray of int
        Counted column by column; in this order.
    constant : ndarray or None
        The numbers where no parameter enters them.
    coefficients : CSR array or None
        Where one does: times the parameters they are the numbers.
    """

    places: NDArray[np.int64]
    constant: FloatVector | None
    coefficients: Any

    @classmethod
    def of(cls, tensor: Any, first: int, end: int, ones: int) -> _Numbers:
        """Return the numbers first ≤ place < end of a sparse array, shape (places, parameters)."""
        if tensor.shape[1] == 1 and tensor.format == "csc":
            listed, columns = tensor.indices, np.zeros(1)
        else:
            triplets = tensor.tocoo()
            listed, columns = triplets.row, triplets.col
        chosen = (tensor.data != 0.0) & (listed >= first) & (listed < end)
        rows, data = listed[chosen].astype(np.int64) - first, tensor.data[chosen]
        is_constant = bool((columns == ones).all())
        if is_constant and (np.diff(rows) > 0).all():
            return cls(rows, data, None)
        places, at = np.unique(rows, return_inverse=True)
        if is_constant:
            return cls(places, np.bincount(at, data, places.size).astype(np.float64), None)
        shape = places.size, tensor.shape[1]
        return cls(places, None, sp.csr_array((data, (at, columns[chosen])), shape=shape))

    def at(self, parameters: FloatVector) -> FloatVector:
        """Return the numbers at these values of the parameters."""
        numbers: FloatVector = (
            self.coefficients @ parameters if self.constant is None else self.constant
        )
        return numbers

    def vector(self, parameters: FloatVector, size: int) -> FloatVector:
        """Return them as a vector that is 0 elsewhere."""
        whole = np.zeros(size)
        whole[self.places] = self.at(parameters)
        return whole


class _Rows(NamedTuple):
    """Some rows of a matrix: which of its numbers are their entries, row by row, and with which sign."""

    order: NDArray[np.int64]
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]
    shape: tuple[int, int]
    sign: float

    @classmethod
    def of(
        cls, places: NDArray[np.int64], height: int, first: int, shape: tuple[int, int], sign: float
    ) -> _Rows:
        """Return the rows from the first on of a matrix of that height, whose numbers stand in these places."""
        columns, rows = np.divmod(places, max(height, 1))
        rows -= first
        chosen = np.flatnonzero((rows >= 0) & (rows < shape[0]))
        order = chosen[np.argsort(rows[chosen], kind="stable")]
        indptr = np.zeros(shape[0] + 1, dtype=np.int32)
        np.cumsum(np.bincount(rows[order], minlength=shape[0]), out=indptr[1:])
        return cls(order, columns[order].astype(np.int32), indptr, shape, sign)

    def matrix(self, numbers: FloatVector) -> sp.csr_array:
        """Return the rows as a CSR array; it holds zeros where numbers are 0."""
        return assembled(self.sign * numbers[self.order], self.indices, self.indptr, self.shape)


class CompiledProgram:
    """The program min ½ xᵀP x + qᵀx + d, A x = b, F x ≤ g of a problem that cvxpy compiled, by its parameters.

    Parameters
    ----------
    problem : ParamConeProg of cvxpy
        With equations, then inequalities, and no other cones.
    """

    def __init__(self, problem: Any) -> None:
        n, rows, equations = problem.x.size, problem.constr_size, problem.cone_dims.zero
        ones, self._sizes = problem.param_id_to_col[ONES], (n, rows, equations)
        columns = problem.param_id_to_col.items()
        self._parameters = [
            (problem.id_to_param[key], column) for key, column in columns if key != ONES
        ]
        self._ones = np.zeros(problem.total_param_size + 1)
        self._ones[ones] = 1.0
        of_P = (
            sp.csc_array((n * n, self._ones.size)) if problem.P is None else problem.P
        )  # none of a linear program
        self._qd, self._P = (
            _Numbers.of(tensor, 0, tensor.shape[0], ones) for tensor in (problem.q, of_P)
        )
        self._entries = _Numbers.of(problem.A, 0, rows * n, ones)
        self._offsets = _Numbers.of(problem.A, rows * n, rows * (n + 1), ones)
        self._rows = (
            _Rows.of(self._P.places, n, 0, (n, n), 1.0),
            _Rows.of(self._entries.places, rows, equations, (rows - equations, n), -1.0),
            _Rows.of(self._entries.places, rows, 0, (equations, n), 1.0),
        )
        self._latest: tuple[tuple[FloatVector, ...], tuple[Any, Any, Any, Any]] | None = None

    @classmethod
    def of(cls, problem: Any) -> CompiledProgram | None:
        """Return the program, or None where it is not sure to be one: another release, another class or size."""
        if not cp.__version__.startswith(RELEASES) or type(problem).__name__ != "ParamConeProg":
            return None
        n, rows, parameters = problem.x.size, problem.constr_size, problem.total_param_size + 1
        shapes = (n + 1, parameters), (rows * (n + 1), parameters), (n * n, parameters)
        tensors = problem.q, problem.A, *([] if problem.P is None else [problem.P])
        dims = problem.cone_dims
        is_known = dims.zero + dims.nonneg == rows and n > 0 and ONES in problem.param_id_to_col
        has_bounds = any(
            getattr(problem, name, None) is not None for name in ("lb_tensor", "ub_tensor")
        )  # since 1.9
        is_known = is_known and not has_bounds
        is_known = (
            is_known and all(map(sp.issparse, tensors)) and max(n, rows, problem.A.nnz) < 2**31
        )
        return (
            cls(problem)
            if is_known and shapes[: len(tensors)] == tuple(one.shape for one in tensors)
            else None
        )

    def present(self) -> PresentProgram:
        """Return the numbers at the present values of the parameters."""
        (n, rows, equations), parameters = self._sizes, self._ones.copy()
        for parameter, column in self._parameters:
            parameters[column : column + parameter.size] = np.array(parameter.value).ravel(
                order="F"
            )
        qd, bg = self._qd.vector(parameters, n + 1), self._offsets.vector(parameters, rows)
        return PresentProgram(
            *self._matrices(parameters), qd[:n], float(qd[n]), bg[equations:], -bg[:equations]
        )

    def _matrices(self, parameters: FloatVector) -> tuple[Any, Any, Any, ProgramMatrices | None]:
        """Return P, F, A and what holds them; the very same ones where no number has changed."""
        of_P, entries = numbers = self._P.at(parameters), self._entries.at(parameters)
        if self._latest is None or not all(map(np.array_equal, numbers, self._latest[0])):
            P, F, A = (
                rows.matrix(values)
                for rows, values in zip(self._rows, (of_P, entries, entries), strict=True)
            )
            is_checked = all(
                (np.isfinite(part.data) & (part.data != 0.0)).all() for part in (P, F, A)
            )
            self._latest = (
                numbers,
                (P, F, A, ProgramMatrices(P, F, A) if is_checked and is_its_mirror(P) else None),
            )
        return self._latest[1]


class PresentProgram(NamedTuple):
    """The numbers of a program min ½ xᵀP x + qᵀx + d, A x = b, F x ≤ g.

    Attributes
    ----------
    matrices : ProgramMatrices or None
        P, F and A, where they are finite, symmetric and hold no zeros.
    """

    P: sp.csr_array
    F: sp.csr_array
    A: sp.csr_array
    matrices: ProgramMatrices | None
    q: FloatVector
    d: float
    g: FloatVector
    b: FloatVector
