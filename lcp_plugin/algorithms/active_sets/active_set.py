"""Active sets: which bounds hold, and the linear system that remains once that is decided."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...checks import BoolVector, FloatVector
from ...matrix.factors import Factor, factorise
from ...matrix.matrix import Matrix, fact
from ...matrix.structure import bandwidth
from ...matrix.symmetry import is_nearly_symmetric
from ...problem.lcp import LCP

SINGULAR = 1e13  # a block whose scaled inverse is larger than this is treated as singular
RIDGE = 1e-8  # of the residual scale, added to the diagonal of a singular block
RIDGE_STEPS = 12
CONSISTENT = 1e-10  # backward error below which a singular system counts as solved
UNEVEN = 1e4  # rows or columns that differ by more than this in size are equilibrated
LEAST_SQUARES_UP_TO = 500


class ActiveSetSolution(NamedTuple):
    """What an active set gives.

    Attributes
    ----------
    z : ndarray, shape (n,)
        At its bound on the active rows; w = 0 on the free rows, as well as can be.
    is_singular : bool
        The free block is singular to working precision: z solves its system in the sense of the ridge or of least
        squares, and is one of many or of none. The residual tells.
    work : float
        Matrix entries touched, factorisation included, divided by the nonzeros of M.
    """

    z: FloatVector
    is_singular: bool
    work: float


@dataclass
class FactorCache:
    """The factor of the last free set; an unchanged set costs no second one."""

    key: bytes = b""
    factor: Factor | None = None
    ridge: Factor | None = None
    is_singular: bool = False


def classify(
    problem: LCP, z: FloatVector, w: FloatVector, scale: FloatVector | None = None
) -> tuple[BoolVector, BoolVector]:
    """Return (at_lower, at_upper), the bounds that z − w/d reaches or passes, shape (n,) each.

    Parameters
    ----------
    z, w : ndarray, shape (n,)
    scale : ndarray, shape (n,), optional
        d > 0; the scale of the residual by default. A row with equal bounds is at its lower one.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> at_lower, at_upper = classify(problem, np.array([2.5, 0.0]), np.array([0.0, 3.5]))
    >>> at_lower
    array([False,  True])
    """
    d = problem.residual_scale if scale is None else scale
    with np.errstate(all="ignore"):
        step = w / d
        # z − step ≤ lower, written so that a small step is not lost beside a large z.
        at_lower = z - problem.lower <= step
        at_upper = (problem.upper - z <= -step) & ~at_lower
    is_fixed = problem.lower == problem.upper
    return at_lower | is_fixed, at_upper & ~is_fixed


def signature(at_lower: BoolVector, at_upper: BoolVector) -> bytes:
    """Return a short key of an active set, for the detection of cycles."""
    packed = np.packbits(at_lower).tobytes() + np.packbits(at_upper).tobytes()
    return blake2b(packed, digest_size=16).digest()


def solve_active_set(
    problem: LCP, at_lower: BoolVector, at_upper: BoolVector, *, fixed_values: FloatVector | None = None,
    near: FloatVector | None = None, factor_cache: FactorCache | None = None,
) -> ActiveSetSolution | None:
    """Return z with z at its bounds on the active rows and w = 0 on the free ones, or None where none is finite.

    Parameters
    ----------
    at_lower, at_upper : ndarray of bool, shape (n,)
        The active rows; the bounds there are finite, unless fixed_values says what z is.
    fixed_values : ndarray, shape (n,), optional
        Values of z on the active rows in place of the bounds; the rest of it is not read.
    near : ndarray, shape (n,), optional
        Where the free block is singular, a solution close to this z is sought; 0 by default.
    factor_cache : FactorCache, optional
        Keeps the factor for another call with the same free rows and the same M.

    Notes
    -----
    One factorisation of the free block and a step of iterative refinement. A singular block is shifted by a ridge
    and the shift is taken out again by a few proximal steps; a dense one that resists is solved in the
    sense of least squares. Nothing is judged here: look at the residual of z.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> solve_active_set(problem, np.array([False, True]), np.array([False, False])).z
    array([2.5, 0. ])
    """
    z = np.where(at_lower, problem.lower, np.where(at_upper, problem.upper, 0.0))
    is_free = ~(at_lower | at_upper)
    if fixed_values is not None:
        z = np.where(is_free, 0.0, fixed_values)
    free = np.flatnonzero(is_free)
    entries = max(problem.nonzeros, 1)
    if free.size == 0:
        return ActiveSetSolution(z, False, 0.0) if np.isfinite(z).all() else None
    with np.errstate(all="ignore"):
        right = -problem.slack(z)[free]
        system = _FreeSystem(problem, free, FactorCache() if factor_cache is None else factor_cache)
        start = np.zeros(free.size) if near is None else near[free]
        x = system.solve(right, start)
    if x is None or not np.isfinite(z).all():
        return None
    z[free] = x
    return ActiveSetSolution(z, system.cache.is_singular, 1.0 + system.work / entries)


def free_block(problem: LCP, free: NDArray[np.intp]) -> Any:
    """Return M[free, free] as it is kept, dense or CSR; M itself where all rows are free."""
    M = problem.M
    if free.size == problem.n:
        return M
    return M[free][:, free] if sp.issparse(M) else M[np.ix_(free, free)]


class _FreeSystem:
    """M_FF x = right, equilibrated where that matters, refined, and regularised where it is singular."""

    def __init__(self, problem: LCP, free: NDArray[np.intp], cache: FactorCache) -> None:
        self.problem, self.free, self.cache = problem, free, cache
        self.block = free_block(problem, free)
        self.work = 0.0
        self._entries = float(self.block.nnz if sp.issparse(self.block) else self.block.size)
        rows, columns = _equilibration(problem.matrix)
        self._rows = None if rows is None else rows[free]
        self._columns = None if columns is None else columns[free]
        self._scale = problem.residual_scale[free]

    def solve(self, right: FloatVector, start: FloatVector) -> FloatVector | None:
        cache = self.cache
        key = self.free.tobytes()
        if cache.key != key:
            cache.key, cache.ridge = key, None
            cache.factor = self._factorised(0.0)
            cache.is_singular = cache.factor is None or self._is_nearly_singular(cache.factor)
            if cache.is_singular:
                cache.ridge = self._factorised(RIDGE)
        if cache.is_singular:
            return self._regularised(right, start)
        steps = 1 if self._rows is None else 3  # what was equilibrated may need more than one
        return self._direct(cache.factor, right, steps)

    def _direct(self, factor: Factor | None, right: FloatVector, steps: int) -> FloatVector | None:
        return None if factor is None else self._refined(factor, self._apply(factor, right), right, steps)

    def _regularised(self, right: FloatVector, start: FloatVector) -> FloatVector | None:
        """Return a solution close to start; if there seems to be none, the most accurate of all attempts."""
        attempts = []
        if self.cache.ridge is not None:
            x = self._refined(self.cache.ridge, start, right, RIDGE_STEPS)
            if self._backward_error(x, right) <= CONSISTENT:
                return x
            attempts.append(x)
        x_direct = self._direct(self.cache.factor, right, 1)  # ill-conditioned is not singular
        if x_direct is not None:
            attempts.append(x_direct)
        if self.free.size <= LEAST_SQUARES_UP_TO:
            attempts.append(self._least_squares(right, start))
        finite = [x for x in attempts if np.isfinite(x).all()]
        return min(finite, key=lambda x: _largest((right - self.block @ x) / self._scale), default=None)

    def _refined(self, factor: Factor, x: FloatVector, right: FloatVector, steps: int) -> FloatVector:
        """Return x after steps x ← x + A⁻¹(right − M_FF x), as long as they reduce the residual."""
        remainder = right - self.block @ x
        size = _largest(remainder / self._scale)
        for _ in range(steps):
            if size == 0.0:
                break
            better = x + self._apply(factor, remainder)
            left = right - self.block @ better
            self.work += 2.0 * self._entries
            smaller = _largest(left / self._scale)
            if not smaller < size:
                break
            x, remainder, size = better, left, smaller
        return x

    def _factorised(self, ridge: float) -> Factor | None:
        matrix = self.block
        if ridge:
            shift = ridge * self._scale
            matrix = sp.csr_array(matrix + sp.diags_array(shift)) if sp.issparse(matrix) else matrix + np.diag(shift)
        if self._rows is not None:
            matrix = _scaled(matrix, self._rows, self._columns)
        is_symmetric = self._rows is None and is_nearly_symmetric(self.problem.matrix)
        factor = factorise(matrix, is_symmetric=is_symmetric, bandwidth=bandwidth(self.problem.matrix))
        self.work += 0.0 if factor is None else factor.work
        return factor

    def _apply(self, factor: Factor, right: FloatVector) -> FloatVector:
        self.work += factor.solve_work
        x: FloatVector = factor.solve(right if self._rows is None else right * self._rows)
        return x if self._columns is None else x * self._columns

    def _is_nearly_singular(self, factor: Factor) -> bool:
        """Estimate the scaled inverse by one solve with random signs."""
        signs = np.random.default_rng(0).choice([-1.0, 1.0], size=self.free.size)
        x = self._apply(factor, signs * self._scale)
        if self._columns is not None:
            x = x / self._columns
        return not _largest(x) <= SINGULAR

    def _backward_error(self, x: FloatVector, right: FloatVector) -> float:
        size = abs(self.block) @ np.abs(x) + np.abs(right)
        remainder = np.abs(right - self.block @ x)
        error = np.divide(remainder, size, out=np.zeros_like(size), where=remainder > 0.0)
        return _largest(error)

    def _least_squares(self, right: FloatVector, start: FloatVector) -> FloatVector:
        """Return the point closest to start that makes the row-scaled system's error least."""
        from scipy.linalg import LinAlgError, lstsq

        block = self.block.toarray() if sp.issparse(self.block) else self.block
        scaled = block / self._scale[:, None]
        self.work += 4.0 * self.free.size**3
        try:
            step: FloatVector = lstsq(scaled, right / self._scale - scaled @ start, cond=1e-12, check_finite=False)[0]
        except LinAlgError:
            return np.full(self.free.size, np.nan)
        return start + step


@fact
def _equilibration(matrix: Matrix) -> tuple[FloatVector | None, FloatVector | None]:
    """Return powers of two that bring rows and then columns to size 1; None where they are even already."""
    if not matrix.n:
        return None, None
    rows = _inverse_power_of_two(matrix.residual_scale)
    scaled = abs(_scaled(matrix.array, rows, np.ones(matrix.n)))
    largest = scaled.max(axis=0)
    columns = _inverse_power_of_two(np.asarray(largest.toarray() if sp.issparse(largest) else largest).ravel())
    return (None, None) if max(_spread(rows), _spread(columns)) <= UNEVEN else (rows, columns)


def _inverse_power_of_two(sizes: FloatVector) -> FloatVector:
    exponents = np.frexp(np.where(sizes > 0.0, sizes, 1.0))[1]
    powers: FloatVector = np.ldexp(1.0, np.clip(-exponents, -1000, 1000))
    return powers


def _spread(values: FloatVector) -> float:
    return float(values.max() / values.min())


def _scaled(matrix: Any, rows: FloatVector, columns: FloatVector | None) -> Any:
    factors = np.ones(rows.size) if columns is None else columns
    if sp.issparse(matrix):
        return sp.csr_array(sp.diags_array(rows) @ matrix @ sp.diags_array(factors))
    return matrix * rows[:, None] * factors


def _largest(values: FloatVector) -> float:
    return float(np.max(np.abs(values), initial=0.0))
