"""What stands beside the rows and unknowns of a complementarity problem, and is held against its answer afterwards.

An inequality without a partner, a bound that the complementarity of its variable does not state, one of a variable
without a complementarity, a complementarity whose row holds no unknown: no unknown gives way to them, so that the
problem has solutions without them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...core.checks import BoolVector, FloatVector
from ...modeling.expressions.program import Program
from .content import Indices, NLContent
from .expressions import UNKNOWNS, Expressions
from .tokens import row_name

FEASIBLE = 1e-6  # by which they may be violated, or by ten times the tolerance


class PairBounds(NamedTuple):
    """The bounds that complementarity rows speak of, −∞ and ∞ where they speak of none, shape (k,)."""

    lower: FloatVector
    upper: FloatVector


def pair_bounds(content: NLContent, rows: Indices) -> PairBounds:
    """Return the bounds that complementarity rows speak of."""
    columns, told = content.partners[rows], content.partner_bounds[rows]
    lower, upper = content.lower[columns], content.upper[columns]
    return PairBounds(np.where(told & 1, lower, -np.inf), np.where(told & 2, upper, np.inf))


def slopes(content: NLContent, x: FloatVector, rows: Indices) -> FloatVector:
    """Return Σ |slope| (1 + |x|) over all variables, of each row: how much it changes where they all do."""
    found = Expressions(content, np.full(x.size, np.nan))
    jacobian = Program.of(found.compiler, [found.rows(np.asarray(rows))], {UNKNOWNS: 0}, x.size).jacobian(x)
    sums: FloatVector = abs(jacobian) @ (1.0 + np.abs(x))
    return sums


class SideConditions:
    """The side conditions of a complementarity problem.

    Parameters
    ----------
    content : NLContent
    pairs, inequalities, spare : array of int
        The complementarity rows that are solved, the rows without a partner, and the complementarity rows left out.

    Attributes
    ----------
    loose : array of int
        Those left out, and those whose variable has bounds that they do not speak of.
    bounded : array of bool, shape (n,)
        The variables without a complementarity that have bounds; none where nothing is complementary.
    """

    def __init__(self, content: NLContent, pairs: Indices, inequalities: Indices, spare: Indices) -> None:
        self.content, self.inequalities, self.spare = content, inequalities, spare
        columns = content.partners[pairs]
        is_finite = np.isfinite(content.lower) + 2 * np.isfinite(content.upper)
        self.loose = np.append(spare, pairs[(is_finite[columns] & ~content.partner_bounds[pairs]) != 0])
        self.bounded: BoolVector = (is_finite != 0) & bool(pairs.size)
        self.bounded[columns] = False

    def names(self) -> list[str]:
        """Return what they are called: inequalities, complementarities, variables."""
        content, rows = self.content, [*self.inequalities.tolist(), *self.loose.tolist()]
        columns = np.flatnonzero(self.bounded).tolist()
        variables = [content.names[j] if content.names else f"variable {j}" for j in columns]
        return [row_name(content, i) for i in rows] + variables

    def violated(self, x: FloatVector, rows: FloatVector, tolerance: float) -> str:
        """Return what does not hold at x, nothing where all of it does.

        Parameters
        ----------
        x, rows : array
            The answer, and the values of the rows there.
        tolerance : float
            Of the run.
        """
        content, inner = self.content, self.inequalities
        if not (names := self.names()):
            return ""
        units = slopes(content, x, np.append(inner, self.loose))
        excesses = np.concatenate([
            _excess(rows[inner], content.row_lower[inner], content.row_upper[inner], units[: inner.size]),
            self._pair_excess(x, rows, units[inner.size:]),
            _excess(*(part[self.bounded] for part in (x, content.lower, content.upper, 1.0 + np.abs(x)))),
        ])
        excesses = np.where(np.isnan(excesses), np.inf, excesses)
        worst, count = int(np.argmax(excesses)), int((excesses > max(FEASIBLE, 10.0 * tolerance)).sum())
        if not count:
            return ""
        others = f", nor {count - 1} more" if count > 1 else ""
        return (
            f"solved, but {names[worst]} does not hold{others}, off by {excesses[worst]:.2g}: it stands beside the "
            "complementarities, and no unknown gives way to it; with an objective all solutions are searched"
        )

    def _pair_excess(self, x: FloatVector, rows: FloatVector, units: FloatVector) -> FloatVector:
        """Return |x − mid(lower, upper, x − w/unit)| of the pairs that were solved within other bounds."""
        own = x[self.content.partners[self.loose]]
        moved = own - rows[self.loose] / np.where(units > 0.0, np.minimum(units, 1.0), 1.0)
        bounds = pair_bounds(self.content, self.loose)
        excess: FloatVector = np.abs(own - np.clip(moved, bounds.lower, bounds.upper)) / np.maximum(1.0, np.abs(own))
        return excess


def _excess(body: FloatVector, lower: FloatVector, upper: FloatVector, units: FloatVector) -> FloatVector:
    """Return by how much a body is beyond its bounds: of their size, at least 1, or of the row's where that is less."""
    sizes = np.maximum(*(np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (lower, upper)))
    scales = np.minimum(np.maximum(1.0, sizes), np.where(units > 0.0, units, np.abs(body)) + sizes)
    excess: FloatVector = np.maximum(np.maximum(lower - body, body - upper), 0.0) / np.where(scales > 0.0, scales, 1.0)
    return excess
