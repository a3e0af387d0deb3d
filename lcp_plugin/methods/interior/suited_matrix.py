"""M as interior steps take it: monotone where row factors make it so, its rows and columns of even size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector, read_only
from ...core.kernels.floats import EPSILON
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.scaling import Exponents, scaled, symmetrising_rows
from ...core.matrix.structure import IntVector, row_numbers
from ...core.tuning import DENSE_NEWTON_UP_TO
from ...systems.equilibration import unit_diagonal
from ...systems.graph import compressed_rows
from ...systems.symmetry import is_nearly_symmetric, is_symmetric_to_rounding
from .quasidefinite import Symbolic, signs_of

SPARSE_BELOW = 0.01  # share of the entries: a symmetric M with fewer is not treated as a dense one
WELL_SCALED = 1e3  # diagonals that differ by less are not worth a scaled copy of a dense M
SWEEPS, RUIZ_PASSES = 6, 8
CLEARLY = 1.1  # entries rounded to a few digits still count as monotone
LARGEST_EXPONENT = 1000
FIXED = 16.0 * EPSILON  # bounds that differ by less, beside their size, are the same but for rounding


@dataclass(frozen=True, eq=False)
class SuitedMatrix:
    """diag(unit · row_factors) M diag(unit), and what is known of it.

    Attributes
    ----------
    M : canonical CSR array or ndarray, shape (n, n)
        Dense where it is symmetric and not too sparse for that.
    row_factors : ndarray, shape (n,), or None
        Powers of two, as of `monotone_rows`.
    unit : ndarray, shape (n,)
        Powers of two.
    signs : ndarray, shape (n,), or None
        Those of a quadratic program, with which M is symmetric.
    is_symmetric : bool
        It could be the matrix of a convex energy, and is dense.
    """

    M: Any
    row_factors: FloatVector | None
    unit: FloatVector
    signs: FloatVector | None
    is_symmetric: bool

    @classmethod
    def of(cls, M: Any, is_mirrored: bool | None = None) -> SuitedMatrix:
        """Return that of M; whether a dense one is its transpose to rounding may be known."""
        M, signs, is_symmetric = _stored(M, is_mirrored)
        r = None if is_symmetric else monotone_rows(M)
        if r is not None:
            M, signs, is_symmetric = _stored(scaled(M, Exponents(r, np.zeros_like(r))))
        c = equilibration(M, signs)
        unit = read_only(np.ones(M.shape[0]) if c is None else np.ldexp(1.0, c.row))
        return cls(scaled(M, c), None if r is None else np.ldexp(1.0, r), unit, signs, is_symmetric)

    @cached_property
    def symbolic(self) -> Symbolic | None:
        """Order and pattern of a factor of a sparse M with signs, for all numbers."""
        return Symbolic.of(self.M) if self.signs is not None and sp.issparse(self.M) else None

    @property
    def is_program(self) -> bool:
        """Whether some unknowns are multipliers."""
        return self.signs is not None and bool((self.signs < 0.0).any())

    @cached_property
    def components(self) -> tuple[int, Any, Any]:
        """How many connected components M has, the number of each row's, and which of them have curvature."""
        from scipy.sparse.csgraph import connected_components

        count, component = connected_components(self.M, directed=False)
        is_dual, rows, bends = np.asarray(self.signs) < 0.0, row_numbers(self.M), np.zeros(count, dtype=bool)
        bends[component[rows[is_dual[rows] == is_dual[self.M.indices]]]] = True
        return count, component, bends


def _stored(M: Any, is_mirrored: bool | None = None) -> tuple[Any, FloatVector | None, bool]:
    """Return M, dense where it is symmetric and not too sparse for that, or else its signs; whether it is both."""
    if not sp.issparse(M):
        is_mirrored = is_symmetric_to_rounding(M) if is_mirrored is None else is_mirrored
        is_symmetric = is_mirrored and float(M.diagonal().min(initial=0.0)) >= 0.0
        return M, None if is_mirrored else signs_of(M), is_symmetric
    signs = signs_of(M)
    is_sparse = M.shape[0] > DENSE_NEWTON_UP_TO or M.nnz <= SPARSE_BELOW * M.shape[0] ** 2
    if is_sparse or (signs is not None and bool((signs < 0.0).any())):
        return M, signs, False
    dense = M.toarray()
    if float(dense.diagonal().min(initial=0.0)) >= 0.0 and is_symmetric_to_rounding(dense):
        return dense, None, True
    return M, signs, False


def suited(matrix: Matrix, kept: NDArray[np.intp] | None = None) -> SuitedMatrix:
    """Return the kept rows and columns, or all, as interior steps take them; those asked for last are known."""
    known, key = _known_blocks(matrix), None if kept is None else kept.tobytes()
    found = known.get(key)
    if found is None:
        M = matrix.array
        if kept is None:
            found = SuitedMatrix.of(M, is_nearly_symmetric(matrix) if matrix.is_dense else None)
        else:
            found = SuitedMatrix.of(M[kept][:, kept] if sp.issparse(M) else M[np.ix_(kept, kept)])
        known.clear()
        known[key] = found
    return found


@fact
def _known_blocks(matrix: Matrix) -> dict[bytes | None, SuitedMatrix]:
    """Return the block that was asked for last; one, as each may be as large as the matrix."""
    return {}


def equilibration(M: Any, signs: FloatVector | None = None) -> Exponents | None:
    """Return powers of two, alike for rows and columns, that bring these to even size; None where they are not needed.

    The same factors on both sides keep a monotone matrix monotone and a symmetric one symmetric. Passes of Ruiz alone
    would leave the rows and columns of a program's constraints in units that depend on those in which they were given.
    """
    if not M.shape[0]:
        return None
    diagonal = M.diagonal()
    if not sp.issparse(M) and diagonal.min() > 0.0:
        return None if diagonal.max() <= WELL_SCALED * diagonal.min() else unit_diagonal(diagonal)
    from .kernels.interior_rows import equilibrate

    c = np.ones(diagonal.size)
    is_program = signs is not None and bool((signs < 0.0).any())
    equilibrate(*compressed_rows(M), signs if is_program else c, SWEEPS if is_program else 0, RUIZ_PASSES, c)
    half = np.clip(np.rint(np.log2(c)), -500, 500).astype(np.int64)
    return Exponents(half, half)


def monotone_rows(M: Any) -> IntVector | None:
    """Return r, shape (n,), such that the rows 2^r_i M_i may be monotone although M is not; else None.

    M is not monotone where |m_ij + m_ji| > 2 √(m_ii m_jj), and only what is so clearly is changed. Tried are the
    factors that make M symmetric, if there are any, and those that make its diagonal 1.

    Examples
    --------
    >>> monotone_rows(np.array([[2.0, -1.0], [-64.0, 128.0]]))
    array([ 0, -6])
    >>> monotone_rows(np.array([[2.0, -1.0], [-1.0, 2.0]])) is None
    True
    """
    diagonal: FloatVector = M.diagonal()
    if not diagonal.size or diagonal.min() <= 0.0:
        return None
    rows = sp.csr_array(M)
    exponents = np.zeros(diagonal.size, np.int64)
    if _may_be_monotone(rows, exponents):
        return None
    for logarithms in (symmetrising_rows(rows), -np.log2(diagonal)):
        exponents = np.rint(logarithms).astype(np.int64)
        if np.abs(exponents).max() <= LARGEST_EXPONENT and _may_be_monotone(rows, exponents):
            return exponents
    return None


def _may_be_monotone(M: sp.csr_array, exponents: IntVector) -> bool:
    with np.errstate(all="ignore"):
        M = scaled(M, Exponents(exponents, np.zeros_like(exponents)))
        root = np.sqrt(M.diagonal())
        both = sp.coo_array(M + M.T)
        allowed = 2.0 * root[both.row] * root[both.col] * CLEARLY
        return bool(np.all(np.abs(both.data) <= allowed))


def known_before(problem: LCP) -> FloatVector:
    """Return z where it is fixed, to rounding, or meets no other unknown that is not, else NaN.

    Beside unknowns in units of their own all others would have to wait for them.
    """
    lower, upper = problem.lower, problem.upper
    known, size = np.full(problem.n, np.nan), np.maximum(np.abs(lower), np.abs(upper))
    is_fixed = (lower == upper) | ((upper - lower <= FIXED * size) & np.isfinite(size))
    known[is_fixed] = lower[is_fixed]
    if problem.is_dense or not (is_fixed.any() or np.diff(problem.csr.indptr).min(initial=2) < 2):
        return known
    rows, columns = row_numbers(problem.csr), problem.csr.indices
    meets = ~(is_fixed[rows] | is_fixed[columns]) & (rows != columns)
    alone = np.ones(problem.n, dtype=bool)
    alone[rows[meets]] = alone[columns[meets]] = False
    alone = np.flatnonzero(alone & ~is_fixed)
    if alone.size:
        q, d = problem.q[alone], problem.diagonal[alone]
        if is_fixed.any():
            q = q + problem.csr[alone] @ np.where(is_fixed, lower, 0.0)
        inner = np.where(d > 0.0, -q / np.where(d > 0.0, d, 1.0), np.where(q == 0.0, 0.0, np.copysign(np.inf, -q)))
        z = np.clip(inner, lower[alone], upper[alone])
        # An equation of fixed unknowns alone holds but for rounding, or nothing helps.
        z = np.where(np.isfinite(z), z, np.clip(0.0, lower[alone], upper[alone]))
        known[alone] = np.where(d >= 0.0, z, np.nan)
    return known


def sizes_of_components(
    suited: SuitedMatrix, q: FloatVector, lower: FloatVector, upper: FloatVector
) -> tuple[FloatVector, FloatVector]:
    """Return powers of two to measure z and w in, shape (n,) each: limits and costs of each component are near 1 then.

    Connected components of a program do not share the units of M: in common ones the large would hide the small.
    M stays as it is. Where nothing in a component bends, its unknowns may have another unit than its multipliers.
    """
    ones = np.ones(q.size)
    if not suited.is_program or not sp.issparse(suited.M):
        return ones, ones
    count, component, bends = suited.components
    if count == 1:
        return ones, ones
    is_dual = np.asarray(suited.signs) < 0.0
    limits = np.abs(np.where(is_dual, q, np.clip(0.0, lower, upper)))
    limits, costs = (_means(component, count, values) for values in (limits, np.where(is_dual, 0.0, np.abs(q))))
    known = np.isfinite(limits) & np.isfinite(costs)
    mean = np.where(known, 0.5 * (limits + costs), np.where(np.isfinite(limits), limits, costs))
    size, ratio = (
        np.ldexp(1.0, np.rint(np.clip(np.where(np.isfinite(values), values, 0.0), -300, 300)).astype(int))[component]
        for values in (mean, np.where(known & ~bends, 0.5 * (limits - costs), 0.0))
    )
    return np.where(is_dual, size / ratio, size * ratio), np.where(is_dual, size * ratio, size / ratio)


def _means(component: Any, count: int, values: FloatVector) -> FloatVector:
    """Return the mean log₂ of the positive values in each component, NaN where there are none."""
    is_positive = values > 0.0
    sums = np.bincount(component[is_positive], np.log2(values[is_positive]), count)
    return np.asarray(sums / np.bincount(component[is_positive], minlength=count))
