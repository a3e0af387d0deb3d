"""Rows that speak of one variable, or of none: folded into bounds, with the way back for their multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from .qp_units import CONSTRAINTS

if TYPE_CHECKING:
    from .quadratic_program import QuadraticProgram

Indices = NDArray[np.intp]
OWN = -1  # the variable's own bound, not a row's


@dataclass(frozen=True, eq=False)
class FoldedRows:
    """The bounds of a quadratic program with its singleton rows folded in, and the rows that are left.

    Attributes
    ----------
    lower, upper : ndarray, shape (n,)
        The tightest bounds that the program's own bounds and its singleton rows give.
    inequalities, equalities : ndarray of int
        Rows of G and of A that remain.
    lower_row, upper_row : ndarray of int, shape (n,)
        The row of [G; A] that gives the bound, or −1.
    coefficient : ndarray, shape (rows of G + rows of A,)
        The only entry of a singleton row; 1 elsewhere.
    """

    lower: FloatVector
    upper: FloatVector
    inequalities: Indices
    equalities: Indices
    lower_row: Indices
    upper_row: Indices
    coefficient: FloatVector

    @property
    def count(self) -> int:
        """Number of rows that remain."""
        return int(self.inequalities.size + self.equalities.size)

    def contradict(self, program: QuadraticProgram) -> bool:
        """Return whether x within the bounds misses one of the rows left by more than what is called optimal."""
        units = program.units
        unit = np.concatenate([units.inequality[self.inequalities], units.equality[self.equalities]])
        left = [sp.csr_array(program.G)[self.inequalities], sp.csr_array(program.A)[self.equalities]]
        limits = np.concatenate([program.h[self.inequalities], program.b[self.equalities]])
        lowest, highest = activity(sp.csr_array(sp.vstack(left, format="csr")), self.lower, self.upper)
        is_equality = np.arange(limits.size) >= self.inequalities.size
        clearly = CONSTRAINTS * unit
        too_high, too_low = lowest - clearly > limits, highest + clearly < limits
        return bool(np.any(too_high | too_low & is_equality))

    def spread(
        self, program: QuadraticProgram, inequality: FloatVector, equality: FloatVector, reduced_cost: FloatVector
    ) -> tuple[FloatVector, FloatVector, FloatVector, FloatVector]:
        """Return the duals of the whole program: inequality, equality, lower, upper.

        Parameters
        ----------
        program : QuadraticProgram
            The program whose rows these are.
        inequality, equality : ndarray
            Multipliers of the rows that remain.
        reduced_cost : ndarray, shape (n,)
            P x + c + Gᵀλ + Aᵀν over these rows: what the bounds have to balance, μ_lower − μ_upper.
        """
        at_lower = np.where(np.isfinite(self.lower), np.maximum(reduced_cost, 0.0), 0.0)
        at_upper = np.where(np.isfinite(self.upper), np.maximum(-reduced_cost, 0.0), 0.0)
        m = program.h.size
        multipliers = np.zeros(self.coefficient.size)
        multipliers[self.inequalities] = inequality
        multipliers[m + self.equalities] = equality
        for owner, share, sign in ((self.lower_row, at_lower, -1.0), (self.upper_row, at_upper, 1.0)):
            moved = (owner != OWN) & (share != 0.0)
            multipliers[owner[moved]] += sign * share[moved] / self.coefficient[owner[moved]]
        own_lower = np.where(self.lower_row == OWN, at_lower, 0.0)
        own_upper = np.where(self.upper_row == OWN, at_upper, 0.0)
        return multipliers[:m], multipliers[m:], own_lower, own_upper


def activity(matrix: sp.csr_array, lower: FloatVector, upper: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return the least and the largest value of each row of matrix · x within the bounds, to rounding."""
    m = matrix.shape[0]
    at = np.repeat(np.arange(m), np.diff(matrix.indptr))
    with np.errstate(all="ignore"):
        ends = [matrix.data * bound[matrix.indices] for bound in (lower, upper)]
        lowest = np.bincount(at, weights=np.minimum(*ends), minlength=m)
        highest = np.bincount(at, weights=np.maximum(*ends), minlength=m)
    return lowest.astype(np.float64), highest.astype(np.float64)


def fold_simple_rows(program: QuadraticProgram) -> FoldedRows:
    """Return the program's bounds and rows with singleton, empty and unlimited rows gone.

    A row g x_j ≤ h or a x_j = b becomes a bound; 0 ≤ h, 0 = 0 and g x ≤ ∞ are dropped. What cannot hold – 0 ≤ −1, or
    singleton rows whose bounds contradict one another – stays a row: that it has no solution is for a solver to find.
    """
    m = program.h.size
    rows, columns, coefficients, is_empty = _singletons(program.G, program.A)
    right = np.concatenate([program.h, program.b])
    is_equality = np.arange(right.size) >= m
    with np.errstate(over="ignore"):
        limits = right[rows] / coefficients
    usable = np.isfinite(limits)
    rows, columns, coefficients, limits = rows[usable], columns[usable], coefficients[usable], limits[usable]

    is_upper = is_equality[rows] | (coefficients > 0.0)
    is_lower = is_equality[rows] | (coefficients < 0.0)
    upper, upper_row = _tightest(program.upper, limits[is_upper], columns[is_upper], rows[is_upper])
    negated, lower_row = _tightest(-program.lower, -limits[is_lower], columns[is_lower], rows[is_lower])
    lower = -negated + 0.0  # no negative zeros
    contradicts = lower > upper
    lower[contradicts], upper[contradicts] = program.lower[contradicts], program.upper[contradicts]
    lower_row[contradicts] = upper_row[contradicts] = OWN

    says_nothing = np.where(is_equality, right == 0.0, right >= 0.0) & is_empty | (right == np.inf)
    stays = ~says_nothing
    stays[rows[~contradicts[columns]]] = False
    coefficient = np.ones(right.size)
    coefficient[rows] = coefficients
    left = np.flatnonzero(stays)
    return FoldedRows(lower, upper, left[left < m], left[left >= m] - m, lower_row, upper_row, coefficient)


def _singletons(G: Any, A: Any) -> tuple[Indices, Indices, FloatVector, NDArray[np.bool_]]:
    """Return row, column and entry of each row of [G; A] with one nonzero, and which rows have none."""
    stacked = sp.vstack([sp.csr_array(G), sp.csr_array(A)], format="csr")
    counts = np.diff(stacked.indptr)
    rows = np.flatnonzero(counts == 1)
    at = stacked.indptr[rows]
    return rows, stacked.indices[at].astype(np.intp), stacked.data[at], counts == 0


def _tightest(own: FloatVector, limits: FloatVector, columns: Indices, rows: Indices) -> tuple[FloatVector, Indices]:
    """Return the smallest limit of each variable and the row it comes from; a variable's own bound wins a tie."""
    n = own.size
    all_limits = np.concatenate([own, limits])
    all_columns = np.concatenate([np.arange(n), columns])
    all_rows = np.concatenate([np.full(n, OWN), rows])
    order = np.lexsort((all_limits, all_columns))
    first = order[np.searchsorted(all_columns[order], np.arange(n))]
    return all_limits[first], all_rows[first]
