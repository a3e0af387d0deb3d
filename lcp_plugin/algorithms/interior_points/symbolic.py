"""What a factorisation knows before any number: the order of the unknowns, and where L has entries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...checks import read_only
from ...matrix.factors import made, most_operations


@dataclass(frozen=True, eq=False)
class Symbolic:
    """The order and the pattern of L for every matrix with one pattern: made once, for all numbers, and never changed.

    Attributes
    ----------
    indptr, indices : ndarray of int
        The pattern of M that it is for, as of a canonical CSR array.
    pattern : tuple of arrays without signs
        For :mod:`lcp_plugin.kernels.symmetric_factors`: the order; L by columns (starts, rows); L by rows (starts,
        columns); what is above the diagonal in that order by columns (starts, rows, where M has it below its own).
    entries : int
        Of L.
    work, solve_work : float
        Multiplications of a factorisation, and of a solve.

    Examples
    --------
    >>> arrow = sp.csr_array(np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 0.0, 1.0]]))
    >>> Symbolic.of(arrow).solve_work  # two entries of L, used twice: no fill where the first row comes last
    4.0
    """

    indptr: Any
    indices: Any
    pattern: tuple[Any, ...]
    entries: int
    work: float
    solve_work: float

    @classmethod
    def of(cls, M: sp.csr_array) -> Symbolic:
        """Return that of M, canonical, with the pattern of its transpose: qdldl's order, by minimum degree."""
        import qdldl

        n = M.shape[0]
        rows = np.repeat(np.arange(n), np.diff(M.indptr))
        at = np.flatnonzero(M.indices < rows)
        rows, columns = rows[at], M.indices[at]
        # Row by row the lower triangle, its diagonal last: column by column the upper one.
        starts = np.append(0, np.cumsum(np.bincount(rows, minlength=n) + 1))
        numbers = np.zeros(starts[-1])  # none is looked at, and no pivot of these is 0
        numbers[starts[1:] - 1] = 1.0
        indices = np.empty(numbers.size, dtype=np.int64)
        indices[numbers > 0.0], indices[numbers == 0.0] = np.arange(n), columns
        upper = sp.csc_array((numbers, indices, starts), shape=(n, n))
        try:
            solver = made(lambda: qdldl.Solver(upper, upper=True), most_operations(upper))
        except RuntimeError as error:  # no pivot is 0: it found no memory
            raise MemoryError(str(error)) from error
        lower, _, order = solver.factors()
        position = np.empty(n, dtype=np.int64)
        position[order] = np.arange(n)
        first, second = position[rows], position[columns]
        above = sp.csc_array((at, (np.minimum(first, second), np.maximum(first, second))), shape=(n, n))
        by_rows = sp.csc_array((np.ones(lower.nnz), lower.indices, lower.indptr), shape=(n, n)).tocsr()
        parts = (
            (order, np.uint32), (lower.indptr, np.uint64), (lower.indices, np.uint32), (by_rows.indptr, np.uint64),
            (by_rows.indices, np.uint32), (above.indptr, np.uint64), (above.indices, np.uint32),
            (above.data, np.uint32),
        )
        pattern = tuple(read_only(part.astype(kind)) for part, kind in parts)
        counts = np.diff(lower.indptr).astype(np.float64)
        return cls(M.indptr, M.indices, pattern, lower.nnz, float(counts @ counts) / 2.0, 2.0 * lower.nnz)

    def fits(self, M: sp.csr_array) -> bool:
        """Return whether M has this pattern."""
        return np.array_equal(self.indptr, M.indptr) and np.array_equal(self.indices, M.indices)
