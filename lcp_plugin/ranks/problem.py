"""An LCP whose rows are spread over MPI ranks.

Bad input on one rank is rejected on all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, ClassVar, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..core import checks
from ..core.entries import largest_in_rows, residual_scales
from ..core.errors import InvalidProblem
from ..core.lcp import LCP
from ..core.problem_classes import Door
from .halo import Halo, Ranks, own_rows


class RowsOnRanks:
    """The LCP z ∈ [lower, upper], w = M z + q complementary, whose rows are spread over MPI ranks.

    Every vector is the local part of a rank, shape (own,). All ranks call every method, in the same order. Build it
    by :meth:`lcp_plugin.LCP.from_rows`.

    Attributes
    ----------
    n, own : int
        Number of rows, of all ranks and of this rank.
    rows : csr_array, shape (own, own + foreign)
        The local rows in local columns: first the local unknowns, then their ghosts.
    halo : Halo
        The ranks, and the values that they need from each other.
    q, lower, upper : array, shape (own,)
    diagonal, residual_scale : array, shape (own,)
        m_ii, and d_i of the residual.
    methods : dict
        Further algorithms of this class, by name.
    """

    methods: ClassVar[dict[str, Callable[..., Any]]] = {}

    def __init__(
        self, rows: sp.csr_array, halo: Halo, q: ArrayLike, lower: ArrayLike, upper: ArrayLike
    ) -> None:
        self.rows, self.halo, self.n, self.own = rows, halo, halo.n, halo.own
        self.q = checks.checked_vector(q, "q", self.own)
        self.lower, self.upper = checks.checked_bounds(lower, upper, self.own)
        self.diagonal = checks.read_only(np.asarray(rows.diagonal(), np.float64))
        self.residual_scale = residual_scales(self.diagonal, largest_in_rows(rows))
        self.nearest_to_zero = checks.read_only(np.clip(0.0, self.lower, self.upper))

    @classmethod
    def from_rows(
        cls, comm: Any, rows: Any, q: ArrayLike, lower: ArrayLike = 0.0, upper: ArrayLike = np.inf
    ) -> Self:
        """Return the problem of the rows that each rank passes, in the order of the ranks.

        Parameters
        ----------
        comm : communicator of mpi4py; None for the whole job
        rows : sparse array, shape (own, n)
            The local rows of M with global column indices; a rank may have none. They are only read.
        q : array, shape (own,)
        lower, upper : scalar or array, shape (own,)
            A scalar holds for all rows and must be the same on every rank.

        Raises
        ------
        InvalidProblem
            On every rank, if a part is corrupt or the parts do not fit together.
        """
        ranks = Ranks(comm)
        matrix = ranks.together(lambda: _checked_csr(rows))
        count, n = matrix.shape
        ranks.require_same("the number of columns", n, "every rank gives its rows at full width")
        halo = Halo(ranks.comm, count)
        if halo.n != n:
            lack = "missing" if halo.n < n else "too many; is one given twice?"
            counts = ", ".join(map(str, np.diff(halo.starts)))
            raise InvalidProblem(
                f"M has {n} columns, but the ranks give {halo.n} rows ({counts}): "
                f"{abs(n - halo.n)} are {lack}"
            )
        parts = own_rows(halo, matrix)
        problem = ranks.together(lambda: cls(*parts, q, lower, upper))
        for name, bound in (("lower", lower), ("upper", upper)):
            number = float(np.asarray(bound)) if np.ndim(bound) == 0 else "an array"
            advice = "a number holds for all rows; give arrays where rows differ"
            ranks.require_same(name, number, advice)
        return problem

    def with_q(self, q: ArrayLike) -> RowsOnRanks:
        """Return the problem with another local part of q."""
        data = self.rows, self.halo, q, self.lower, self.upper
        return self.halo.together(lambda: RowsOnRanks(*data))

    def own_part(self, z: Any, name: str = "z", *, is_finite: bool = True) -> checks.Vector:
        """Return a checked vector, shape (own,); all ranks reject a part that is wrong on one rank."""
        check = partial(checks.checked_vector, z, name, self.own, is_finite=is_finite)
        return self.halo.together(check)

    def slack(self, z: checks.Vector) -> checks.Vector:
        """Return the local part of w = M z + q."""
        return self.rows @ self.halo.whole(self.own_part(z, is_finite=False)) + self.q

    def gathered(self, z: ArrayLike) -> checks.Vector | None:
        """Return the parts of all ranks as one vector on rank 0, None on the others."""
        local = np.ascontiguousarray(self.own_part(z, is_finite=False))
        whole = np.empty(self.n) if self.halo.rank == 0 else None
        self.halo.comm.Gatherv(local, (whole, np.diff(self.halo.starts)), root=0)
        return whole

    def gathered_problem(self) -> LCP | None:
        """Return the whole LCP on rank 0, None on the others."""
        local, halo = self.rows, self.halo
        numbers = np.concatenate([np.arange(halo.first, halo.last), halo.ghosts])
        entries = local.data, numbers[local.indices], local.indptr
        rows = sp.csr_array(entries, shape=(self.own, self.n))
        parts = halo.comm.gather((rows, self.q, self.lower, self.upper), root=0)
        if parts is None:
            return None
        M, *vectors = zip(*parts, strict=True)
        q, lower, upper = map(np.concatenate, vectors)
        return LCP(sp.vstack(M, format="csr"), q, lower=lower, upper=upper)

    @cached_property
    def is_symmetric(self) -> bool:
        """True if xᵀM y = yᵀM x for x and y of arbitrary entries, up to rounding.

        That happens by chance with probability 0; a wrong answer would cost speed only.
        """
        unit = 1.0 / np.sqrt(np.abs(self.residual_scale))
        random = np.random.default_rng([2, self.halo.rank])
        x, y = (unit * random.uniform(-1.0, 1.0, self.own) for _ in range(2))
        x_product, y_product = (self.rows @ self.halo.whole(vector) for vector in (x, y))
        sums = float(y @ x_product), float(x @ y_product), float(np.sum((unit * x_product) ** 2))
        forward, backward, size = map(self.halo.total, sums)
        difference = abs(forward - backward)
        # Relative difference of xᵀM y and yᵀM x beyond which M is not symmetric
        return bool(difference <= 1e-10 * np.sqrt(size * self.n) and np.isfinite(size))

    solve, measured = Door(), Door()  # of solving.py

    def __repr__(self) -> str:
        return f"RowsOnRanks(n={self.n}, ranks={self.halo.size})"


def _checked_csr(rows: Any) -> sp.csr_array:
    """Return the rows as canonical CSR, every index checked: a wrong one would be met on another rank."""
    if not (sp.issparse(rows) and rows.ndim == 2):
        raise InvalidProblem(f"rows must be sparse, of shape (own, n), got {type(rows).__name__}")
    checks.check_kind(rows.dtype, "rows must hold real numbers")
    widest = np.iinfo(np.int32).max
    if rows.shape[1] > widest:
        raise InvalidProblem(f"M has {rows.shape[1]} columns; at most {widest} are taken")
    return checks.canonical_csr(rows, "rows")
