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

from ...core.checks import FloatVector
from ...proofs.exact.rational import like
from .program_matrices import Indices, ProgramMatrices, block

if TYPE_CHECKING:
    from .program import QuadraticProgram

OWN = -1  # the variable's own bound, not a row's


@dataclass(frozen=True, eq=False)
class Step(ABC):
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
    def of(cls, program: QuadraticProgram) -> Step | None:
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
            point, direction = (np.array(one, dtype=object) for one in (found.point, found.direction))
            ends = self.point(point), self.point(direction, is_direction=True)
            parts = dict(zip(("point", "direction"), (tuple(map(Fraction, end)) for end in ends), strict=True))
        proof = replace(found, program=self.program, **parts)
        return proof if proof.verify() else None


@dataclass(frozen=True, eq=False)
class Reduction:
    """Steps after each other, none at first: a program, what they leave of it, and the way back through all.

    Attributes
    ----------
    program : QuadraticProgram
    steps : tuple of Step

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[0, 2]], h=[2], lower=[3, 0], upper=[3, 9])
    >>> smaller = Reduction(program).then(FoldedRows.of).then(FixedVariables.of)
    >>> print(smaller.reduced)
    QuadraticProgram(n=1, 0 inequalities, 0 equalities)
    >>> smaller.outward(np.array([1.0]), np.array([0.0, 2.0]))
    (array([3., 1.]), array([1., 4., 0., 0., 0.]))
    """

    program: QuadraticProgram
    steps: tuple[Step, ...] = ()

    def then(self, step: Callable[[QuadraticProgram], Step | None]) -> Reduction:
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
class FoldedRows(Step):
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
        is_equality, (rows, columns, coefficient) = matrices.is_equality[: right.size], matrices.singletons
        with np.errstate(over="ignore"):
            limits = right[rows] / coefficient[rows]
        is_finite = np.isfinite(limits)
        rows, columns, limits = rows[is_finite], columns[is_finite], limits[is_finite]
        above, below = (is_equality[rows] | (sign * coefficient[rows] > 0.0) for sign in (1.0, -1.0))
        upper, upper_row = _tightest(program.upper, limits[above], columns[above], rows[above])
        negated, lower_row = _tightest(-program.lower, -limits[below], columns[below], rows[below])
        lower = -negated + 0.0  # no negative zeros
        contradicts = lower > upper
        lower[contradicts], upper[contradicts] = program.lower[contradicts], program.upper[contradicts]
        lower_row[contradicts] = upper_row[contradicts] = OWN

        is_empty = np.diff(matrices.rows.indptr) == 0
        stays = ~(np.where(is_equality, right == 0.0, right >= 0.0) & is_empty | (right == np.inf))
        stays[rows[~contradicts[columns]]] = False
        left = np.flatnonzero(stays)
        folded = program
        if left.size < right.size:
            folded = program.with_matrices(
                matrices.of_rows(left), program.c, program.h[left[left < program.h.size]],
                right[left[left >= program.h.size]], lower, upper,
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
        rows, *bounds = np.split(multipliers.copy(), [self.coefficient.size, self.coefficient.size + x.size])
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
            with np.errstate(over="ignore"):  # what is beyond the range of doubles is infinite, and no answer
                every[owner[moved]] += sign * share[moved] / like(self.coefficient[owner[moved]], reduced)
            own.append(np.where(owner == OWN, share, 0))
        return np.concatenate([every, *own])


@dataclass(frozen=True, eq=False)
class FixedVariables(Step):
    """The program in the variables whose bounds differ.

    Attributes
    ----------
    free : ndarray of int
        The variables that are left.
    x : ndarray, shape (n,)
        The values of the others, 0 elsewhere.
    """

    free: Indices
    x: FloatVector

    @classmethod
    def of(cls, program: QuadraticProgram) -> FixedVariables | None:
        """Return that of a program; None where no variable is fixed."""
        is_free = program.lower < program.upper
        if is_free.all():
            return None
        free, x, matrices = np.flatnonzero(is_free), np.where(is_free, 0.0, program.lower), program.matrices
        smaller = matrices.kept("free variables", (free,), lambda: ProgramMatrices(
            block(program.P, free, free), *(
                block(rows, np.arange(rows.shape[0]), free) for rows in (program.G, program.A)
            )
        ))
        h = program.h - program.G @ x if program.h.size else program.h
        b = program.b - program.A @ x if program.b.size else program.b
        c, lower, upper = (one[free] for one in (program.c + program.P @ x, program.lower, program.upper))
        reduced = program.with_matrices(smaller, c, h, b, lower, upper)
        return cls(program, reduced, free, x)

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the variables that are left, and the multipliers of rows and of their bounds."""
        rows, n = self.program.constraints.rows, self.program.n
        kept = np.concatenate([np.arange(rows), rows + self.free, rows + n + self.free])
        return x[self.free], multipliers[kept]

    def point(self, x: Any, *, is_direction: bool = False) -> Any:
        """Return x of all variables."""
        whole = np.zeros(self.x.size, dtype=x.dtype) if is_direction else like(self.x, x).copy()
        whole[self.free] = x
        return whole

    def multipliers(self, reduced: Any, x: FloatVector | None) -> Any:
        """Return the multipliers of all constraints: a fixed variable's bounds take what stationarity leaves."""
        program, m, k = self.program, self.program.constraints.rows, self.free.size
        y, lower, upper = reduced[:m], reduced[m : m + k], reduced[m + k :]
        if x is None:
            costs = np.zeros(program.n, dtype=object)
            for i in np.flatnonzero(y):
                for j, value in program.constraints.exactly[i].items():
                    costs[j] += value * y[i]
        else:
            costs = program.P @ x + program.c + program.matrices.sum_of_rows(y)
        whole = np.concatenate([y, np.maximum(costs, 0), np.maximum(-costs, 0)])
        whole[m + self.free], whole[m + program.n + self.free] = lower, upper
        return whole


def _tightest(own: FloatVector, limits: FloatVector, columns: Indices, rows: Indices) -> tuple[FloatVector, Indices]:
    """Return the smallest limit of each variable and the row it comes from; a variable's own bound wins a tie."""
    tightest, owner = own.copy(), np.full(own.size, OWN)
    np.minimum.at(tightest, columns, limits)
    gives = np.flatnonzero((limits == tightest[columns]) & (limits < own[columns]))[::-1]  # of equal ones the first
    owner[columns[gives]] = rows[gives]
    return tightest, owner
