"""Programs made smaller by one stack of steps, each with its way back for x, multipliers and proofs.

A step is a class: how it makes the smaller program (`of`), and its way back (`inward`, `point`, `multipliers`). One
that drops rows which are stated twice, say, keeps the variables and needs no `point`. Whether a contradiction or a
direction of descent of the smaller program is one of the program is checked on the program's own numbers, whatever the
step says.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...proofs.exact.rational import like
from .program_matrices import Indices, as_csr

if TYPE_CHECKING:
    from .program import QuadraticProgram

OWN = -1  # the variable's own bound, not a row's


@dataclass(frozen=True, eq=False)
class ReductionStep(ABC):
    """A program and a smaller one that stands for it.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        Before and after.
    """

    program: QuadraticProgram
    reduced: QuadraticProgram

    @classmethod
    @abstractmethod
    def of(cls, program: QuadraticProgram) -> ReductionStep | None:
        """Return that of a program; None, or the same object left, where there is nothing to do."""

    @abstractmethod
    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x and the multipliers of all constraints of the smaller program, from those of the program."""

    def point(self, x: Any, *, is_direction: bool = False) -> Any:
        """Return x of the program, of doubles or of Fractions; of a direction, the one that it is."""
        return x

    @abstractmethod
    def multipliers(self, reduced: Any, x: FloatVector | None) -> Any:
        """Return the multipliers of all constraints of the program, from those of the smaller one.

        Of doubles, at x, a point of the program, or of Fractions that contradict each other, where x is None: the
        gradient that these leave is 0.
        """

    def outward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x and the multipliers of all constraints of the program, from those of the smaller one."""
        whole = self.point(x)
        return whole, self.multipliers(multipliers, whole)

    def proof(self, found: Any) -> Any:
        """Return the same proof that there is no minimum, of the program; None where it does not hold there.

        What a step has rounded, a limit over a coefficient, is no number of the program.
        """
        if found is None or self.reduced is self.program:
            return found
        if found.verdict == "infeasible":
            whole = self.multipliers(np.array(found.multipliers, dtype=object), None)
            parts = {"multipliers": tuple(map(Fraction, whole))}
        else:
            point, direction = (
                np.array(one, dtype=object) for one in (found.point, found.direction)
            )
            ends = self.point(point), self.point(direction, is_direction=True)
            parts = dict(
                zip(
                    ("point", "direction"), (tuple(map(Fraction, end)) for end in ends), strict=True
                )
            )
        proof = replace(found, program=self.program, **parts)
        return proof if proof.verify() else None


@dataclass(frozen=True, eq=False)
class Reduction:
    """Steps after each other, none at first: a program, what they leave of it, and the way back through all.

    Attributes
    ----------
    program : QuadraticProgram
    steps : tuple of ReductionStep

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[0, 2]], h=[2])
    >>> smaller = Reduction(program).then(FoldedRows.of)
    >>> print(smaller.reduced)
    QuadraticProgram(n=2, 0 inequalities, 0 equalities)
    >>> smaller.outward(np.array([1.0, 1.0]), np.array([0.0, 0.0, 0.0, 2.0]))
    (array([1., 1.]), array([1., 0., 0., 0., 0.]))
    """

    program: QuadraticProgram
    steps: tuple[ReductionStep, ...] = ()

    def then(self, step: Callable[[QuadraticProgram], ReductionStep | None]) -> Reduction:
        """Return the reduction with one more step, or as it is where that does nothing."""
        found = step(self.reduced)
        if found is None or found.reduced is self.reduced:
            return self
        return Reduction(self.program, (*self.steps, found))

    @property
    def reduced(self) -> QuadraticProgram:
        """What is left of the program."""
        return self.steps[-1].reduced if self.steps else self.program

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x and the multipliers of all constraints of what is left."""
        for step in self.steps:
            x, multipliers = step.inward(x, multipliers)
        return x, multipliers

    def point(self, x: Any) -> Any:
        """Return x of the program."""
        for step in reversed(self.steps):
            x = step.point(x)
        return x

    def outward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x and the multipliers of all constraints of the program."""
        for step in reversed(self.steps):
            x, multipliers = step.outward(x, multipliers)
        return x, multipliers

    def proof(self, found: Any) -> Any:
        """Return the same proof of the program; None where it does not hold there."""
        for step in reversed(self.steps):
            found = step.proof(found)
        return found


@dataclass(frozen=True, eq=False)
class FoldedRows(ReductionStep):
    """The program's bounds and rows with singleton, empty and unlimited rows gone.

    A row g x_j ≤ h or a x_j = b becomes a bound; 0 ≤ h, 0 = 0 and g x ≤ ∞ are dropped. What cannot hold – 0 ≤ −1, or
    singleton rows whose bounds contradict one another – stays a row: that it has no solution is for a solver to find.

    Attributes
    ----------
    left : ndarray of int
        Rows of [G; A] that remain.
    lower_row, upper_row : ndarray of int, shape (n,)
        The row of [G; A] that gives the bound, or −1.
    coefficient : ndarray, shape (rows of G + rows of A,)
        The only entry of a singleton row; 1 elsewhere.
    """

    left: Indices
    lower_row: Indices
    upper_row: Indices
    coefficient: FloatVector

    @classmethod
    def of(cls, program: QuadraticProgram) -> FoldedRows:
        """Return that of a program, the same object left where no row went; done once for a program."""
        known: FoldedRows | None = program.__dict__.get("_folded")
        if known is None:
            known = program.__dict__["_folded"] = cls._of(program)
        return known

    @classmethod
    def _of(cls, program: QuadraticProgram) -> FoldedRows:
        matrices, right = program.matrices, np.concatenate([program.h, program.b])
        is_equality, (rows, columns, coefficient) = (
            matrices.is_equality[: right.size],
            matrices.singletons,
        )
        with np.errstate(over="ignore"):
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

    @property
    def _moved(self) -> Iterator[tuple[int, Indices, Indices]]:
        """The sign of each kind of bound, which of them rows give, and which rows."""
        for sign, owner in ((-1, self.lower_row), (1, self.upper_row)):
            moved = np.flatnonzero(owner != OWN)
            yield sign, moved, owner[moved]

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x, and with the multiplier of each bound what the row has that gives it."""
        rows, *bounds = np.split(
            multipliers.copy(), [self.coefficient.size, self.coefficient.size + x.size]
        )
        for (sign, moved, owner), values in zip(self._moved, bounds, strict=True):
            values[moved] += np.maximum(sign * self.coefficient[owner] * rows[owner], 0.0)
        return x, np.concatenate([rows[self.left], *bounds])

    def multipliers(self, reduced: Any, x: FloatVector | None) -> Any:
        """Return the multipliers of all constraints: what a bound has, its row gets."""
        rows, *bounds = np.split(reduced, [self.left.size, self.left.size + self.program.n])
        every = np.zeros(self.coefficient.size, dtype=reduced.dtype)
        every[self.left] = rows
        own = []
        for owner, share, sign in ((self.lower_row, bounds[0], -1), (self.upper_row, bounds[1], 1)):
            moved = np.flatnonzero((owner != OWN) & (share != 0))
            with np.errstate(
                over="ignore"
            ):  # what is beyond the range of doubles is infinite, and no answer
                every[owner[moved]] += (
                    sign * share[moved] / like(self.coefficient[owner[moved]], reduced)
                )
            own.append(np.where(owner == OWN, share, 0))
        return np.concatenate([every, *own])


@dataclass(frozen=True, eq=False)
class DefinedVariables(ReductionStep):
    """The program without the variables that its equations define, as cvxpy writes t = A x − b, and without these.

    Only where bounds are all that is left then: its complementarity problem is that of a P, which sweeps take.

    Attributes
    ----------
    defined : ndarray of int
        The variable of each equation: free, in no other one, with a quadratic term.
    kept : ndarray of int
    D : CSR array, shape (equations, kept)
        x_defined = shift − D x_kept.
    shift, pivots : ndarray, shape (equations,)
    """

    defined: Indices
    kept: Indices
    D: sp.csr_array
    shift: FloatVector
    pivots: FloatVector

    @classmethod
    def of(cls, program: QuadraticProgram) -> DefinedVariables | None:
        """Return that of a program; None where some row or equation would be left."""
        A, n = as_csr(program.A), program.n
        if program.h.size or not program.b.size:
            return None
        is_open = (
            np.isinf(program.lower) & np.isinf(program.upper) & (program.matrices.diagonal > 0.0)
        )
        places = np.flatnonzero((is_open & (np.bincount(A.indices, minlength=n) == 1))[A.indices])
        owners = np.repeat(np.arange(program.b.size), np.diff(A.indptr))[places]
        order = np.lexsort(
            (-np.abs(A.data[places]), owners)
        )  # the largest entry of a row is the safest pivot
        rows, first = np.unique(owners[order], return_index=True)
        if rows.size < program.b.size:
            return None
        places = places[order[first]]
        defined, pivots = A.indices[places].astype(np.intp), A.data[places]
        kept = np.setdiff1d(np.arange(n), defined)
        D, shift = sp.csr_array(sp.diags_array(1.0 / pivots) @ A[:, kept]), program.b / pivots
        P = as_csr(program.P)
        across = P[kept][:, defined] @ D
        reduced_P = P[kept][:, kept] - across - across.T + D.T @ P[defined][:, defined] @ D
        whole = np.zeros(n)
        whole[defined] = shift
        slope = program.c + P @ whole
        reduced = type(program)(
            0.5 * (reduced_P + reduced_P.T),
            slope[kept] - D.T @ slope[defined],
            lower=program.lower[kept],
            upper=program.upper[kept],
        )
        return cls(program, reduced, defined, kept, D, shift, pivots)

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the variables that are left, and the multipliers of their bounds."""
        lower, upper = np.split(multipliers[self.defined.size :], 2)
        return x[self.kept], np.concatenate([lower[self.kept], upper[self.kept]])

    def point(self, x: Any, *, is_direction: bool = False) -> Any:
        """Return x of all variables."""
        whole, values = (
            np.zeros(self.program.n, dtype=x.dtype),
            like(self.D.data, x) * x[self.D.indices],
        )
        whole[self.kept], sums = x, np.zeros(self.defined.size, dtype=x.dtype)
        np.add.at(sums, np.repeat(np.arange(sums.size), np.diff(self.D.indptr)), values)
        whole[self.defined] = -sums if is_direction else like(self.shift, x) - sums
        return whole

    def multipliers(self, reduced: Any, x: FloatVector | None) -> Any:
        """Return the multipliers of all constraints: an equation's is what its variable's quadratic term leaves."""
        own, (lower, upper) = np.zeros(self.defined.size, dtype=reduced.dtype), np.split(reduced, 2)
        if x is not None:
            own = -(self.program.P @ x + self.program.c)[self.defined] / self.pivots
        whole = np.zeros((2, self.program.n), dtype=reduced.dtype)
        whole[0, self.kept], whole[1, self.kept] = lower, upper
        return np.concatenate([own, *whole])


def _tightest(
    own: FloatVector, limits: FloatVector, columns: Indices, rows: Indices
) -> tuple[FloatVector, Indices]:
    """Return the smallest limit of each variable and the row it comes from; a variable's own bound wins a tie."""
    tightest, owner = own.copy(), np.full(own.size, OWN)
    np.minimum.at(tightest, columns, limits)
    gives = np.flatnonzero((limits == tightest[columns]) & (limits < own[columns]))[
        ::-1
    ]  # of equal ones the first
    owner[columns[gives]] = rows[gives]
    return tightest, owner
