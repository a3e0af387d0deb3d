"""Rows that can be taken out of a problem and put back exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.algorithm import Algorithm, Step
from ..core.checks import FloatVector
from ..core.errors import InvalidProblem
from ..core.kernels.floats import EPSILON, NEGLIGIBLE_DIAGONAL
from ..core.kind import refusal
from ..core.lcp import LCP
from ..core.rounding import compensated_product

Indices = NDArray[np.int64]

MOST_ROUNDS = 8  # passes over M; what they leave is left
SMALL_GAIN = 0.01  # share of the rows that a round must take out for another one, where there are many
MOST_LEVELS = 2000


@dataclass(frozen=True, eq=False)
class Presolved:
    """A smaller problem, and the way back.

    Attributes
    ----------
    original, problem : LCP
        Before and after; the same object where nothing applied.
    kept : ndarray of int
        The rows of the original that are left.
    fixed, decided, separate : int
        How many rows went because lower = upper, because the sign of their w is the same for every z within the bounds,
        and because nothing else depends on their z, which is then computed last.
    """

    original: LCP
    problem: LCP
    kept: Indices
    fixed: int = 0
    decided: int = 0
    separate: int = 0
    steps: tuple[_Removed, ...] = field(default=(), repr=False)

    def restore(self, z: Any) -> Any:
        """Return the z of the original that belongs to a z of the smaller problem.

        Parameters
        ----------
        z : array, shape (rows left,)
            Of doubles, or of Fractions: these are put back without rounding.
        """
        z = np.asarray(z)
        if z.shape != (self.problem.n,):
            raise InvalidProblem(f"z must be a vector of length {self.problem.n}, got shape {z.shape}")
        if self.problem is self.original:
            return z
        full = np.zeros(self.original.n, dtype=object if z.dtype == object else np.float64)
        with np.errstate(all="ignore"):  # what overflows is seen in the residual
            full[self.kept] = z
            for step in reversed(self.steps):
                step.put_back(full)
        return full

    def iterates(self, algorithm: Algorithm, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the steps that an algorithm takes on the smaller problem, in terms of the original, which is given."""
        smaller = self.problem
        if smaller is problem:
            yield from algorithm.iterates(problem, z0)
            return
        start = np.clip(self.reduce(z0), smaller.lower, smaller.upper)
        share = smaller.nonzeros / max(problem.nonzeros, 1)
        for step in algorithm.iterates(smaller, start):
            z = np.clip(self.restore(step.z), problem.lower, problem.upper)
            yield replace(step, z=z, residual=None, increment=None, work=share * step.work, proof=None)

    def reduce(self, z: FloatVector) -> FloatVector:
        """Return the part of a z of the original that the smaller problem has, as a start for it."""
        part: FloatVector = z[self.kept]
        return part

    def __str__(self) -> str:
        n, left = self.original.n, self.problem.n
        return (
            f"presolve left {left} of {n} rows: {self.fixed} fixed, {self.decided} decided by their sign, "
            f"{self.separate} computed last"
        )


def presolve(problem: LCP) -> Presolved:
    """Return the problem without the rows that can be put back exactly.

    Parameters
    ----------
    problem : LCP

    Returns
    -------
    Presolved
        Its ``problem`` is the very same object where nothing applies. Every solution of the smaller problem gives one
        of the original by ``restore``, and it has one if the original has.

    Notes
    -----
    Three rules, repeated while they find something, for at most 8 passes over M:

    - lower = upper: z_i is known.
    - w_i ≥ 0 at z_i = lower_i for all other z within their bounds and m_ii > 0, or w_i > 0 for all z: z_i = lower_i
      in every solution; the same at the upper bound. Signs count only beyond the rounding of the sums that show them.
    - no other row has z_i in it, and row i alone can be solved whatever the others are (m_ii > 0, or two finite
      bounds): z_i is computed last. This alone takes a triangular M apart, rows and columns in any order.

    A value other than 0 goes into q only where that is exact in double precision; otherwise its row stays.

    Examples
    --------
    >>> smaller = presolve(LCP([[2, 1, 0], [1, 2, 0], [1, 1, 1]], [-5, 3, -4], lower=[0, 0, 0]))
    >>> print(smaller)
    presolve left 0 of 3 rows: 0 fixed, 1 decided by their sign, 2 computed last
    >>> smaller.restore([])
    array([2.5, 0. , 1.5])
    """
    if not isinstance(problem, LCP):
        raise InvalidProblem(refusal("presolve", problem))
    found = _Reduction(problem)
    if found.is_worth_a_look():
        found.run()
    if found.kept.size == problem.n:
        return Presolved(problem, problem, found.kept)
    return Presolved(problem, found.problem(), found.kept, **found.counts, steps=tuple(found.steps))


@dataclass(frozen=True, eq=False)
class _Removed:
    """Rows whose z nothing else depends on: each a problem in one unknown once the others are known."""

    indices: Indices
    row: Indices  # of each entry, counted from 0
    column: Indices
    entry: FloatVector
    offset: FloatVector
    diagonal: FloatVector
    lower: FloatVector
    upper: FloatVector

    def put_back(self, z: Any) -> None:
        rest, diagonal = like(self.offset, z).copy(), like(self.diagonal, z)
        np.add.at(rest, self.row, like(self.entry, z) * z[self.column])
        inner = -rest / np.where(diagonal > 0, diagonal, 1)
        # A row without a positive diagonal entry has two finite bounds, or is empty with q = 0 and takes any z.
        low = like(np.where(np.isfinite(self.lower), self.lower, 0.0), z)
        at_bound = np.where(diagonal * low + rest >= 0, self.lower, self.upper)
        wanted = np.where(diagonal > 0, inner, np.where((diagonal == 0) & (rest == 0), 0, at_bound))
        z[self.indices] = like(np.minimum(np.maximum(wanted, self.lower), self.upper), z)


class _Reduction:
    """The rows still there, and what has been taken out."""

    def __init__(self, problem: LCP) -> None:
        self.given = problem
        self.q, self.alive = problem.q, np.ones(problem.n, dtype=bool)
        self.steps: list[_Removed] = []
        self.counts = {"fixed": 0, "decided": 0, "separate": 0}
        self.stays = np.zeros(problem.n, dtype=bool)  # known, but not exact to take out
        self.meets = np.zeros(0, dtype=np.int64)  # other rows that have each z in them

    @property
    def kept(self) -> Indices:
        """The rows that are left."""
        return np.flatnonzero(self.alive).astype(np.int64)

    def is_worth_a_look(self) -> bool:
        """Whether any rule might apply; for a dense M without touching all of it."""
        problem, M = self.given, self.given.M
        if sp.issparse(M) or problem.n < 3 or bool((problem.lower == problem.upper).any()):
            return problem.n > 0
        if ((M[:3] == 0.0).sum(axis=0) >= 2).any():  # perhaps a column of the diagonal alone
            return True
        return any(self._has_right_signs(M, *side).any() for side in self._sides())

    def _sides(self) -> tuple[tuple[FloatVector, FloatVector], ...]:
        """Bounds of y = z and of y = −z."""
        lower, upper = self.given.lower, self.given.upper
        return (lower, upper), (-upper, -lower)

    def _has_right_signs(self, M: Any, low: FloatVector, high: FloatVector) -> NDArray[np.bool_]:
        """Return the rows of a dense M whose smallest value over low ≤ y ≤ high is not −∞."""
        possible = self._is_possible(low, high)
        for columns, sign in ((high == np.inf, 1.0), (low == -np.inf, -1.0)):
            if possible.any() and columns.any():
                part = M if columns.all() else M[:, columns]
                possible = possible & ((part.min(axis=1) if sign > 0.0 else -part.max(axis=1)) >= 0.0)
        return possible

    def _is_possible(self, low: FloatVector, high: FloatVector) -> NDArray[np.bool_]:
        possible = self.alive & ~self.stays & np.isfinite(low) & (low < high)
        # At z = 0, which is within the bounds, w is q.
        return possible & (self.q >= 0.0) if self.given.is_plain else possible

    def run(self) -> None:
        """Apply the rules until none finds anything, or for as many passes as are allowed."""
        csr, diagonal = self.given.csr, self.given.diagonal
        self.meets = np.bincount(csr.indices, minlength=self.given.n) - (diagonal != 0.0)
        for _ in range(MOST_ROUNDS):
            before = int(self.alive.sum())
            is_fixed = self.alive & (self.given.lower == self.given.upper) & ~self.stays
            self._fix(np.flatnonzero(is_fixed), self.given.lower, "fixed")
            for at, (low, high) in enumerate(self._sides()):
                self._fix(self._decided(low, high, -1.0 if at else 1.0), -low if at else low, "decided")
            self._peel()
            left = int(self.alive.sum())
            if left in (before, 0) or before - left < SMALL_GAIN * self.given.n - 20:
                return

    def _decided(self, low: FloatVector, high: FloatVector, sign: float) -> Indices:
        """Return the rows with y_i = low_i in every solution: w sign ≥ 0 there whatever the others are."""
        candidates = np.flatnonzero(self._is_possible(low, high))
        if self.given.is_plain and self.alive.all():
            csr = self.given.csr
            negative = np.concatenate([[0], np.cumsum(csr.data < 0.0)])
            candidates = candidates[negative[csr.indptr[candidates + 1]] == negative[csr.indptr[candidates]]]
        if not candidates.size:
            return candidates
        row, column, entry = self._entries_of(candidates)
        live = self.alive[column]
        row, column, entry = row[live], column[live], entry[live]
        own = column == candidates[row]
        with np.errstate(all="ignore"):
            terms = entry * np.where(entry > 0.0, low[column], high[column])
            terms_at_low = np.where(own, entry * low[column], terms)
            offset, count = sign * self.q[candidates], candidates.size
            margin = (np.bincount(row, minlength=count) + 3) * EPSILON
            sums = [
                (np.bincount(row, t, count) + offset, margin * (np.bincount(row, np.abs(t), count) + np.abs(offset)))
                for t in (terms, terms_at_low)
            ]
            strictly = (sums[0][0] > sums[0][1]) & np.isfinite(sums[0][0])
            weakly = (sums[1][0] >= sums[1][1]) & np.isfinite(sums[1][0]) & (self.given.diagonal[candidates] > 0.0)
        return candidates[strictly | weakly]

    def _fix(self, indices: Indices, bound: FloatVector, reason: str) -> None:
        """Take out rows whose z is known, where that changes q by nothing or exactly."""
        if not indices.size:
            return
        values = bound[indices]
        if values.any():
            exact = self._moved_into_q(indices, values)
            self.stays[indices[~exact]] = True
            indices, values = indices[exact], values[exact]
        nothing = np.zeros(0, dtype=np.int64)  # w = 1 between two equal bounds
        zero, one = np.zeros(indices.size), np.ones(indices.size)
        self.steps.append(_Removed(indices, nothing, nothing, zero[:0], one, zero, values, values))
        self._remove(indices, self._entries_of(indices)[1], reason)

    def _remove(self, indices: Indices, columns: Indices, reason: str) -> Indices:
        """Take rows with entries in these columns out; return the columns that have no entry left but their own."""
        self.alive[indices] = False
        self.counts[reason] += indices.size
        touched, times = np.unique(columns[self.alive[columns]], return_counts=True)
        self.meets[touched] -= times
        alone: Indices = touched[self.meets[touched] == 0]
        return alone

    def _moved_into_q(self, indices: Indices, values: FloatVector) -> NDArray[np.bool_]:
        """Add the columns times the values to q; return which of them could be added without rounding."""
        block = sp.coo_array(self.given.matrix.csc[:, indices])
        acts = self.alive[block.row] & (block.row != indices[block.col]) & (values[block.col] != 0.0)
        entries = (block.data * acts, (block.row, block.col))
        columns = sp.csr_array(entries, shape=block.shape)
        usable = np.ones(indices.size, dtype=bool)
        while True:
            moved, radius = compensated_product(columns, np.where(usable, values, 0.0), self.q)
            spoilt = usable & (abs(columns).T @ (radius != 0.0) > 0.0)
            if not spoilt.any():
                self.q = moved
                return usable
            usable &= ~spoilt

    def _peel(self) -> None:
        """Take out rows that nothing else depends on, and again what nothing depends on then."""
        empty = np.flatnonzero(self.alive & (self.meets == 0))
        for _ in range(MOST_LEVELS):
            empty = empty[self._is_solvable_alone(empty)]
            if not empty.size:
                return
            row, column, entry = self._entries_of(empty)
            beside = self.alive[column] & (column != empty[row])
            row, column, entry = row[beside], column[beside], entry[beside]
            given = (self.q, self.given.diagonal, self.given.lower, self.given.upper)
            self.steps.append(_Removed(empty, row, column, entry, *(values[empty] for values in given)))
            empty = self._remove(empty, column, "separate")

    def _is_solvable_alone(self, indices: Indices) -> NDArray[np.bool_]:
        """Whether m_ii z + t = w can be solved for every t, or for the only t there is."""
        problem, csr = self.given, self.given.csr
        diagonal = problem.diagonal[indices]
        boxed = np.isfinite(problem.lower[indices]) & np.isfinite(problem.upper[indices])
        is_idle = (csr.indptr[indices + 1] == csr.indptr[indices]) & (self.q[indices] == 0.0)
        steep = (diagonal > 0.0) & (diagonal >= NEGLIGIBLE_DIAGONAL * problem.residual_scale[indices])
        usable: NDArray[np.bool_] = steep | ((diagonal <= 0.0) & boxed) | is_idle
        return usable

    def _entries_of(self, indices: Indices) -> tuple[Indices, Indices, FloatVector]:
        """Return row (counted within `indices`), column and entry of these rows."""
        csr = self.given.csr
        part = csr[indices]
        row = np.repeat(np.arange(indices.size), np.diff(part.indptr))
        return row, part.indices.astype(np.int64), part.data

    def problem(self) -> LCP:
        """Return the problem of the rows that are left."""
        kept, given = self.kept, self.given
        M = given.csr[kept][:, kept] if sp.issparse(given.M) else given.M[np.ix_(kept, kept)]
        return LCP(M, self.q[kept], lower=given.lower[kept], upper=given.upper[kept])


def like(values: FloatVector, z: Any) -> Any:
    """Return doubles as they are, or as Fractions beside a z of Fractions."""
    return np.array([Fraction(value) for value in values.tolist()], dtype=object) if z.dtype == object else values
