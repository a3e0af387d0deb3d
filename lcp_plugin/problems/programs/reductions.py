"""Program without rows of one variable, and the inverse transformation of solutions and proofs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.checks import FloatVector
from ...proofs.exact.rational import like
from .program_matrices import Indices

if TYPE_CHECKING:
    from .no_minimum import QPInfeasibility, QPUnboundedness
    from .program import QuadraticProgram

OWN = -1  # the variable's own bound, not a row's


@dataclass(frozen=True, eq=False)
class FoldedRows:
    """The program's bounds and rows with singleton, empty and unlimited rows gone.

    A row g x_j ≤ h or a x_j = b becomes a bound; 0 ≤ h, 0 = 0 and g x ≤ ∞ are dropped. An infeasible row – 0 ≤ −1, or
    singleton rows with inconsistent bounds – remains a row, so that the solver detects that the program is infeasible.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        Before and after; the same object if no row goes.
    left : ndarray of int
        Rows of [G; A] that remain.
    lower_row, upper_row : ndarray of int, shape (n,)
        The row of [G; A] that gives the bound, or −1.
    coefficient : ndarray, shape (rows of G + rows of A,)
        The only entry of a singleton row; 1 elsewhere.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[0, 2]], h=[2])
    >>> folded = program.folded
    >>> print(folded.reduced)
    QuadraticProgram(n=2, 0 inequalities, 0 equalities)
    >>> folded.multipliers(np.array([0.0, 0.0, 0.0, 2.0]))
    array([1., 0., 0., 0., 0.])
    """

    program: QuadraticProgram
    reduced: QuadraticProgram
    left: Indices
    lower_row: Indices
    upper_row: Indices
    coefficient: FloatVector

    @classmethod
    def of(cls, program: QuadraticProgram) -> FoldedRows:
        """Return the reduction of a program; `QuadraticProgram.folded` keeps it."""
        matrices, right = program.matrices, np.concatenate([program.h, program.b])
        if not matrices.has_short_rows and np.isfinite(right).all():
            own = np.full(program.n, OWN)
            return cls(program, program, np.arange(right.size), own, own, np.ones(right.size))
        is_equality, (rows, columns, coefficient) = (
            matrices.is_equality[: right.size],
            matrices.singletons,
        )
        limits = right[rows] / coefficient[rows]
        is_finite = np.isfinite(limits)
        rows, columns, limits = rows[is_finite], columns[is_finite], limits[is_finite]
        above, below = (
            is_equality[rows] | (sign * coefficient[rows] > 0.0) for sign in (1.0, -1.0)
        )
        upper, upper_row = _tightest(program.upper, limits[above], columns[above], rows[above])
        negated, lower_row = _tightest(-program.lower, -limits[below], columns[below], rows[below])
        lower = -negated + 0.0  # no negative zeros
        contradicts = lower > upper
        lower[contradicts], upper[contradicts] = (
            program.lower[contradicts],
            program.upper[contradicts],
        )
        lower_row[contradicts] = upper_row[contradicts] = OWN

        is_empty = np.diff(matrices.rows.indptr) == 0
        stays = ~(np.where(is_equality, right == 0.0, right >= 0.0) & is_empty | (right == np.inf))
        stays[rows[~contradicts[columns]]] = False
        left = np.flatnonzero(stays)
        folded = program
        if left.size < right.size:
            folded = program.with_matrices(
                matrices.of_rows(left),
                program.c,
                program.h[left[left < program.h.size]],
                right[left[left >= program.h.size]],
                lower,
                upper,
            )
        return cls(program, folded, left, lower_row, upper_row, coefficient)

    def multipliers(self, reduced: Any) -> Any:
        """Return the multipliers of all constraints, doubles or Fractions; rows get the multipliers of their bounds."""
        if self.reduced is self.program:
            return reduced
        rows, *bounds = np.split(reduced, [self.left.size, self.left.size + self.program.n])
        every = np.zeros(self.coefficient.size, dtype=reduced.dtype)
        every[self.left] = rows
        own = []
        for owner, share, sign in ((self.lower_row, bounds[0], -1), (self.upper_row, bounds[1], 1)):
            moved = np.flatnonzero((owner != OWN) & (share != 0))
            every[owner[moved]] += (
                sign * share[moved] / like(self.coefficient[owner[moved]], reduced)
            )
            own.append(np.where(owner == OWN, share, 0))
        return np.concatenate([every, *own])

    def proof(
        self, found: QPInfeasibility | QPUnboundedness | None
    ) -> QPInfeasibility | QPUnboundedness | None:
        """Return the proof for the original program; None if the proof does not hold there.

        A limit over a coefficient is rounded, and no number of the program.
        """
        if found is None or self.reduced is self.program:
            return found
        proof: Any = replace(found, program=self.program)
        if found.verdict == "infeasible":
            whole = self.multipliers(np.array(proof.multipliers, dtype=object))
            proof = replace(proof, multipliers=tuple(map(Fraction, whole)))
        return proof if proof.verify() else None


def _tightest(
    own: FloatVector, limits: FloatVector, columns: Indices, rows: Indices
) -> tuple[FloatVector, Indices]:
    """Return the smallest upper bound of each variable and its row; the variable's bound wins a tie."""
    tightest, owner = own.copy(), np.full(own.size, OWN)
    np.minimum.at(tightest, columns, limits)
    gives = np.flatnonzero((limits == tightest[columns]) & (limits < own[columns]))[
        ::-1
    ]  # of equal ones the first
    owner[columns[gives]] = rows[gives]
    return tightest, owner
