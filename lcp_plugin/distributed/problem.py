"""A linear complementarity problem whose rows are spread over ranks."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..checks import finite_vector, read_only
from ..errors import InvalidProblem
from ..problem import LCP, FloatVector
from .collective import as_mpi, require_same, together, total
from .rows import Layout, Rows

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
        self.rows, self.layout = rows, rows.columns
        self.comm, self.n = self.layout.comm, self.layout.n
        self.first, self.last = self.layout.first, self.layout.last
        ghosts = rows.ghosts.size
        matrix = rows.as_csr()
        if ghosts:
            ends = rows.indptr[-1] + np.arange(1, ghosts + 1, dtype=rows.indptr.dtype)
            matrix = sp.csr_array(
                (
                    np.concatenate([rows.data, np.ones(ghosts)]),
                    np.concatenate([rows.indices, np.arange(self.layout.own, rows.width, dtype=rows.indices.dtype)]),
                    np.concatenate([rows.indptr, ends]),
                ),
                shape=(rows.width, rows.width),
            )
        everywhere = np.full(ghosts, np.inf)
        self.local = LCP(
            matrix, np.concatenate([q, np.zeros(ghosts)]),
            lower=np.concatenate([lower, -everywhere]), upper=np.concatenate([upper, everywhere]),
        )
        own = slice(self.layout.own)
        self.q, self.lower, self.upper = (
            read_only(vector[own]) for vector in (self.local.q, self.local.lower, self.local.upper)
        )
        self.diagonal = read_only(self.local.diagonal[own])
        self.residual_scale = read_only(self.local.residual_scale[own])
        self.nearest_to_zero = read_only(np.clip(0.0, self.lower, self.upper))
        self.nonzeros = int(total(self.comm, float(rows.data.size))[0])

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
        if layout.n != n:
            what = "missing" if layout.n < n else "given twice"
            counts = ", ".join(map(str, np.diff(layout.starts)))
            raise InvalidProblem(
                f"M has {n} columns, but the ranks give {layout.n} rows ({counts}): {abs(n - layout.n)} are {what}"
            )
        together(mpi, lambda: _check_first_row(first_row, layout))
        for name, bound in (("lower", lower), ("upper", upper)):
            is_number = np.ndim(bound) == 0
            require_same(mpi, f"the kind of {name}", "number" if is_number else "array", "give one kind everywhere")
            if is_number:
                require_same(mpi, name, str(bound), "a number holds for all rows; give arrays where rows differ")
        vectors = together(mpi, lambda: (
            finite_vector(q, "q", own), _checked_bound(lower, "lower", own), _checked_bound(upper, "upper", own)
        ))
        local = Rows(layout, matrix.indptr, matrix.indices, matrix.data)
        return together(mpi, lambda: cls(local, *vectors))

    @classmethod
    def from_problem(cls, problem: LCP, comm: Any = None) -> DistributedLCP:
        """Return the problem cut into equal parts; every rank gives the same whole one.

        Raises
        ------
        InvalidProblem
            Where the ranks give different problems, as far as a check of sums tells.
        """
        mpi = as_mpi(comm)
        together(mpi, lambda: _check_whole(problem))
        M = problem.csr
        sums = [float(np.sum(part)) for part in (M.data, M.indices, problem.q, problem.lower, problem.upper)]
        require_same(mpi, "the problem", (problem.n, M.nnz, repr(sums)), "build the same one on every rank")
        first, last = problem.n * mpi.rank // mpi.size, problem.n * (mpi.rank + 1) // mpi.size
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

    def slack(self, z: FloatVector) -> FloatVector:
        """Return the own part of w = M z + q for the own part of z, each of shape (last − first,)."""
        w: FloatVector = self.rows.as_csr() @ self.rows.filled(z)
        w += self.q
        return w

    def at(self, z: FloatVector) -> tuple[LCP, FloatVector]:
        """Return the local problem and z with the foreign values at hand: what holds row by row can be asked there."""
        whole = self.rows.filled(z).copy()
        return self.local.with_q(np.concatenate([self.q, -whole[self.layout.own:]])), whole

    def gathered(self, own: FloatVector) -> FloatVector | None:
        """Return the parts of all ranks one after the other on rank 0, None on the others."""
        parts = self.comm.gather(own, root=0)
        return None if parts is None else np.concatenate(parts)

    def solve_with(self, **asked: Any) -> Any:
        """Do what ``lcp_plugin.solve(problem, …)`` promises."""
        from .solving import solve

        return solve(self, **asked)


def _checked_rows(rows: Any) -> sp.csr_array:
    """Return the rows as canonical CSR with 64-bit checks of everything a foreign rank could stumble over."""
    if not (sp.issparse(rows) and rows.ndim == 2):
        raise InvalidProblem(f"the own rows must be a sparse array of shape (own, n), got {type(rows).__name__}")
    if np.iscomplexobj(rows):
        raise InvalidProblem("the own rows hold complex numbers; M must be real")
    own, n = rows.shape
    if n > WIDEST:
        raise InvalidProblem(f"M has {n} columns; PETSc with 32-bit indices takes {WIDEST}")
    matrix = sp.csr_array(rows)
    if matrix.indices.size and not (0 <= matrix.indices.min() and matrix.indices.max() < n):
        bad = int(matrix.indices.min() if matrix.indices.min() < 0 else matrix.indices.max())
        raise InvalidProblem(f"a column index is {bad}; it must be in 0 … {n - 1}: columns are counted globally")
    steps = np.diff(matrix.indptr)
    if steps.size and (steps.min() < 0 or matrix.indptr[-1] > matrix.indices.size):
        raise InvalidProblem("indptr of the own rows is not ascending or too long; build them with scipy.sparse")
    if not matrix.has_canonical_format or not matrix.data.all():
        matrix = matrix.copy()
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
    data = matrix.data.astype(np.float64, copy=False)
    if not np.isfinite(data).all():
        k = int(np.flatnonzero(~np.isfinite(data))[0])
        row = int(np.searchsorted(matrix.indptr, k, side="right")) - 1
        raise InvalidProblem(f"row {row} of the own rows, column {matrix.indices[k]}, is {data[k]}; M must be finite")
    return sp.csr_array((data, matrix.indices, matrix.indptr), shape=(own, n))


def _check_first_row(first_row: int | None, layout: Layout) -> None:
    if first_row is not None and first_row != layout.first:
        raise InvalidProblem(
            f"first_row is {first_row}, but the ranks before this one give {layout.first} rows: rows are missing, given "
            "twice, or in another order than the ranks"
        )


def _checked_bound(bound: ArrayLike, name: str, own: int) -> FloatVector:
    from ..checks import checked_bound

    return checked_bound(bound, name, own)


def _check_whole(problem: Any) -> None:
    if not isinstance(problem, LCP):
        raise InvalidProblem(f"from_problem needs an LCP, got {type(problem).__name__}; write LCP(M, q)")
