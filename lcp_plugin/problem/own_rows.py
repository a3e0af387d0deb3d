"""The own rows of a problem whose rows are spread over ranks: what is refused, on every rank alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from zlib import crc32

import numpy as np
import scipy.sparse as sp

from ..checks import check_kind
from ..errors import InvalidProblem
from ..matrix.matrix import Matrix
from ..peers.alone import Peers
from ..peers.ranks.collective import as_mpi, require_same, together
from ..peers.ranks.halo import own_rows
from ..peers.ranks.layout import Layout

if TYPE_CHECKING:
    from .lcp import LCP

WIDEST = 2**31 - 1  # what a PETSc with 32-bit indices can count


def matrix_of_rows(comm: Any, rows: Any, first_row: int | None) -> Matrix:
    """Return the matrix whose rows follow each other in the order of the ranks; see :meth:`LCP.from_rows`."""
    mpi = as_mpi(comm)
    matrix = together(mpi, lambda: _checked_rows(rows))
    own, n = matrix.shape
    require_same(mpi, "the number of columns", n, "every rank gives its rows at full width")
    layout = Layout(mpi, own)
    _require_all_rows(layout, n)
    together(mpi, lambda: _check_first_row(first_row, layout))
    return Matrix.of_own_rows(*own_rows(layout, matrix))


def require_same_numbers(peers: Peers, **bounds: Any) -> None:
    """Raise where a bound that is a number for all rows is another one on some rank."""
    for name, bound in bounds.items():
        number = float(np.asarray(bound)) if np.ndim(bound) == 0 else "an array"
        peers.require_same(name, number, "a number holds for all rows; give arrays where rows differ", InvalidProblem)


def equal_part(comm: Any, problem: LCP) -> tuple[Any, ...]:
    """Return this rank's rows, q, lower and upper of a problem that all ranks have.

    Raises
    ------
    InvalidProblem
        Where the ranks give different problems.
    """
    mpi = as_mpi(comm)
    together(mpi, lambda: _check_whole(problem))
    M = problem.csr
    parts = (M.indptr, M.indices, M.data, problem.q, problem.lower, problem.upper)
    sums = tuple(crc32(np.ascontiguousarray(part).data) for part in parts)
    facts = (problem.n, M.nnz, *sums)
    require_same(mpi, "the problem (n, nonzeros, checksums)", facts, "build the same one on every rank")
    own = slice(*equal_share(problem.n, mpi.size, mpi.rank))
    return M[own], problem.q[own], problem.lower[own], problem.upper[own]


def equal_share(n: int, ranks: int, rank: int) -> tuple[int, int]:
    """Return first and last of a rank's part where n rows are cut into parts of equal length.

    Examples
    --------
    >>> [equal_share(5, 3, rank) for rank in range(3)]
    [(0, 1), (1, 3), (3, 5)]
    """
    return n * rank // ranks, n * (rank + 1) // ranks


def _checked_rows(rows: Any) -> sp.csr_array:
    """Return the rows as canonical CSR, every index checked: a wrong one would be met on another rank."""
    if not (sp.issparse(rows) and rows.ndim == 2):
        raise InvalidProblem(f"the own rows must be a sparse array of shape (own, n), got {type(rows).__name__}")
    check_kind(rows.dtype, "M must hold real numbers")
    if rows.shape[1] > WIDEST:
        raise InvalidProblem(f"M has {rows.shape[1]} columns; PETSc with 32-bit indices takes {WIDEST}")
    try:
        rows = rows.tocsr()
        # A fresh array: scipy's flags may be older than the entries.
        matrix = sp.csr_array((rows.data, rows.indices, rows.indptr), shape=rows.shape)
        matrix.check_format(full_check=True)
    except (ValueError, IndexError, TypeError) as error:
        raise InvalidProblem(
            f"the own rows are a damaged sparse array: {error}; columns count over all ranks, 0 … {rows.shape[1] - 1}"
        ) from error
    if matrix.dtype != np.float64:
        with np.errstate(over="ignore"):
            matrix = matrix.astype(np.float64)
    if not matrix.has_canonical_format or not matrix.data.all():
        matrix = matrix.copy()
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
    wrong = np.flatnonzero(~np.isfinite(matrix.data))
    if wrong.size:
        k = int(wrong[0])
        row = int(np.searchsorted(matrix.indptr, k, side="right")) - 1
        raise InvalidProblem(
            f"M must be finite, but row {row} of the own rows has {matrix.data[k]} in column {matrix.indices[k]}"
        )
    return matrix


def _require_all_rows(layout: Layout, n: int) -> None:
    if layout.n != n:
        what = "missing" if layout.n < n else "too many; is one given twice?"
        counts = ", ".join(map(str, np.diff(layout.starts)))
        raise InvalidProblem(
            f"M has {n} columns, but the ranks give {layout.n} rows ({counts}): {abs(n - layout.n)} are {what}"
        )


def _check_first_row(first_row: int | None, layout: Layout) -> None:
    if first_row is not None and first_row != layout.first:
        raise InvalidProblem(
            f"first_row is {first_row}, but the ranks before this one give {layout.first} rows: rows are missing, "
            "given twice, or in another order than the ranks"
        )


def _check_whole(problem: Any) -> None:
    if not isinstance(getattr(problem, "matrix", None), Matrix):
        raise InvalidProblem(f"from_problem needs an LCP, got {type(problem).__name__}; write LCP(M, q)")
    problem.matrix.require_all_rows()
