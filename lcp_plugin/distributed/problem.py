"""A linear complementarity problem whose rows are spread over ranks."""

from __future__ import annotations

from functools import cached_property
from os import PathLike
from typing import Any
from zlib import crc32

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..checks import FloatVector, check_kind, check_order, checked_bound, finite_vector, read_only, real_vector
from ..errors import InvalidProblem
from ..matrix.matrix import residual_scale_of
from ..peers.ranks.collective import as_mpi, require_same, together, total
from ..peers.ranks.rows import Layout, Rows
from ..problem.lcp import LCP

WIDEST = 2**31 - 1  # what a PETSc with 32-bit indices can count


class DistributedLCP:
    """Find z with lower ≤ z ≤ upper and w = M z + q complementary to it, each rank holding some consecutive rows.

    Made by :meth:`from_rows`, :meth:`from_problem` or :meth:`load`; every method is to be called by all ranks.

    Attributes
    ----------
    comm : mpi4py communicator
    n : int
        Number of rows of the whole problem.
    first, last : int
        This rank holds the rows first ≤ i < last.
    q, lower, upper : ndarray, shape (last − first,)
        Of the own rows, read-only.
    local : LCP
        The own rows as a square problem: behind the own unknowns stand those of other ranks that the rows meet, each
        with the equation z_j = its value.
    """

    def __init__(self, rows: Rows, q: FloatVector, lower: FloatVector, upper: FloatVector) -> None:
        """Take checked parts as they are; all ranks call."""
        self.rows, self.layout = rows, rows.columns
        self.comm, self.n = self.layout.comm, self.layout.n
        self.first, self.last = self.layout.first, self.layout.last
        self.q, self.lower, self.upper = map(read_only, (q, lower, upper))
        matrix = rows.as_csr()
        self.diagonal = read_only(np.array(matrix.diagonal(), dtype=np.float64))
        self.residual_scale = read_only(residual_scale_of(matrix, self.diagonal))
        self.nearest_to_zero = read_only(np.clip(0.0, self.lower, self.upper))
        self.nonzeros = int(total(self.comm, float(rows.data.size))[0])

    is_distributed = True

    @cached_property
    def local(self) -> LCP:
        """The own rows as a square problem of this rank alone, made when first asked for."""
        rows, foreign = self.rows, self.rows.ghosts.size
        ends = rows.indptr[-1] + np.arange(1, foreign + 1, dtype=rows.indptr.dtype)
        matrix = sp.csr_array(
            (
                np.concatenate([rows.data, np.ones(foreign)]),
                np.concatenate([rows.indices, np.arange(self.layout.own, rows.width, dtype=rows.indices.dtype)]),
                np.concatenate([rows.indptr, ends]),
            ),
            shape=(rows.width, rows.width),
        )
        no_bound = np.full(foreign, np.inf)
        return LCP(
            matrix, np.concatenate([self.q, np.zeros(foreign)]),
            lower=np.concatenate([self.lower, -no_bound]), upper=np.concatenate([self.upper, no_bound]),
        )

    # --- where it comes from ----------------------------------------------------------------------------

    @classmethod
    def from_rows(
        cls, comm: Any, rows: Any, q: ArrayLike, lower: ArrayLike = 0.0, upper: ArrayLike = np.inf, *,
        first_row: int | None = None,
    ) -> DistributedLCP:
        """Return the problem whose rows follow each other in the order of the ranks.

        Parameters
        ----------
        comm : communicator of mpi4py or petsc4py; None for the whole job
        rows : sparse array, shape (own, n)
            The own rows of M with global column indices; a rank may have none. They are only read.
        q : array, shape (own,)
        lower, upper : scalar or array, shape (own,)
            A scalar holds for all rows and must be the same on every rank.
        first_row : int, optional
            The index of the first own row, where you know it: it is checked then.

        Raises
        ------
        InvalidProblem
            On every rank, where any part is damaged or the parts do not fit together.
        """
        mpi = as_mpi(comm)
        matrix = together(mpi, lambda: _checked_rows(rows))
        own, n = matrix.shape
        require_same(mpi, "the number of columns", n, "every rank gives its rows at full width")
        layout = Layout(mpi, own)
        _require_all_rows(layout, n)
        together(mpi, lambda: _check_first_row(first_row, layout))
        vectors = together(mpi, lambda: _checked_vectors(q, lower, upper, own))
        for name, bound in (("lower", lower), ("upper", upper)):
            number = float(np.asarray(bound)) if np.ndim(bound) == 0 else "an array"
            require_same(mpi, name, number, "a number holds for all rows; give arrays where rows differ")
        return cls(Rows(layout, matrix.indptr, matrix.indices, matrix.data), *vectors)

    @classmethod
    def from_problem(cls, problem: LCP, comm: Any = None) -> DistributedLCP:
        """Return the problem cut into equal parts; every rank gives the same whole one.

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
        first, last = equal_share(problem.n, mpi.size, mpi.rank)
        own = slice(first, last)
        return cls.from_rows(mpi, M[first:last], problem.q[own], problem.lower[own], problem.upper[own])

    @classmethod
    def load(cls, path: str | PathLike[str], comm: Any = None) -> DistributedLCP:
        """Return the problem of a folder of chunks or a PETSc binary file, each rank reading its own part.

        Parameters
        ----------
        path : str or PathLike
            A folder written by :meth:`save`, on any number of ranks; or a file with M, q and optionally lower and
            upper one after the other, as PETSc's binary viewer writes them.
        comm : communicator, optional

        Raises
        ------
        UnreadableFile, InvalidProblem
            On every rank.
        """
        from .files import load

        return load(path, as_mpi(comm))

    def save(self, path: str | PathLike[str]) -> None:
        """Write a folder with one .npz file a rank, which :meth:`load` reads on any number of ranks."""
        from .files import save

        save(self, path)

    # --- what it can do ---------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"DistributedLCP(n={self.n}, nonzeros={self.nonzeros}, ranks={self.comm.size})"

    def own_part(self, z: ArrayLike, name: str = "z") -> FloatVector:
        """Return the vector of which each rank gives its own part, shape (last − first,); NaN is allowed.

        Raises
        ------
        InvalidProblem
            On every rank, where the length of one part is wrong.
        """
        return together(self.comm, lambda: real_vector(z, name, self.layout.own))

    def slack(self, z: FloatVector) -> FloatVector:
        """Return the own part of w = M z + q for the own part of z, each of shape (last − first,)."""
        w: FloatVector = self.rows.as_csr() @ self.rows.filled(self.own_part(z))
        w += self.q
        return w

    def at(self, z: FloatVector) -> tuple[LCP, FloatVector]:
        """Return the local problem and z with the foreign values at hand: what holds row by row can be asked there.

        z must be finite on all ranks.
        """
        whole = self.rows.filled(z).copy()
        return self.local.with_q(np.concatenate([self.q, -whole[self.layout.own:]])), whole

    def gathered(self, own: FloatVector) -> FloatVector | None:
        """Return the parts of all ranks one after the other on rank 0, None on the others."""
        own = self.own_part(own, "the vector")
        counts = np.diff(self.layout.starts)
        whole = np.empty(self.n) if self.comm.rank == 0 else None
        self.comm.Gatherv(np.ascontiguousarray(own), (whole, counts), root=0)
        return whole

    def solve_with(self, **asked: Any) -> Any:
        """Do what ``lcp_plugin.solve(problem, …)`` promises."""
        from .solving import solve

        return solve(self, **asked)


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


def _checked_vectors(q: ArrayLike, lower: ArrayLike, upper: ArrayLike, own: int) -> tuple[FloatVector, ...]:
    vectors = (finite_vector(q, "q", own), checked_bound(lower, "lower", own), checked_bound(upper, "upper", own))
    check_order(*vectors[1:])
    return vectors


def _check_first_row(first_row: int | None, layout: Layout) -> None:
    if first_row is not None and first_row != layout.first:
        raise InvalidProblem(
            f"first_row is {first_row}, but the ranks before this one give {layout.first} rows: rows are missing, "
            "given twice, or in another order than the ranks"
        )


def _check_whole(problem: Any) -> None:
    if not isinstance(problem, LCP):
        raise InvalidProblem(f"from_problem needs an LCP, got {type(problem).__name__}; write LCP(M, q)")
