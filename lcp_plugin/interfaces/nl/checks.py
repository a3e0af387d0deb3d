"""Checks of a solution by the rows of the file and by side conditions.

Side conditions are inequalities without a partner and bounds of variables without a complementarity. Bounds of a
variable with a complementarity all belong to it, stated there or not, as PATH and AMPL take them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.matrix import entries_of_row
from ...expressions.program import Program
from .content import Indices, NLContent, Token
from .expressions import UNKNOWNS, Expressions
from .operators import OPERATORS, evaluated_tree, value_of

FEASIBLE = 1e-6  # by which a side condition may be violated, or ten times the tolerance


@np.errstate(all="ignore")
def evaluated(content: NLContent, x: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return the values of the rows and of the objectives at x, shapes (m,) and (o,); NaN if one has no value."""
    values: list[float] = x.tolist()

    def leaf(kind: int, value: float) -> float:
        return value if kind == Token.NUMBER else values[int(value)]

    linear = content.defined_linear
    for k in range(content.defined_trees.size):
        terms = zip(*entries_of_row(linear, k), strict=True)
        value = evaluated_tree(content.defined_trees, k, leaf, _operation)
        values.append(value + sum(factor * values[column] for column, factor in terms))
    rows, objectives = (
        matrix @ x
        + np.array([evaluated_tree(trees, k, leaf, _operation) for k in range(trees.size)])
        for matrix, trees in (
            (content.linear, content.trees),
            (content.objective_linear, content.objective_trees),
        )
    )
    return rows, objectives


def _operation(number: int, operands: list[float]) -> float:
    found = float(value_of(OPERATORS[number], operands))
    return found if math.isfinite(found) else math.nan


def jacobian(content: NLContent, x: FloatVector, rows: Indices) -> sp.csr_array:
    """Return the derivatives of rows, then objectives, with these numbers by all variables, shape (k, n)."""
    found = Expressions(content, np.full(x.size, np.nan))
    return Program.of(found.compiler, [found.rows(rows)], {UNKNOWNS: 0}, x.size).jacobian(x)


def sizes_of(content: NLContent, x: FloatVector, rows: Indices) -> FloatVector:
    """Return the sizes |J| |x| of the terms of rows, then objectives; 0 if a derivative is not finite."""
    sizes: FloatVector = abs(jacobian(content, x, rows)) @ np.abs(x)
    return np.where(np.isfinite(sizes), sizes, 0.0)


# --- Side conditions -----------------------------------------------------------------------------------------------


def pair_bounds(
    content: NLContent, rows: Indices, *, as_stated: bool
) -> tuple[FloatVector, FloatVector]:
    """Return the bounds that complementarity rows state, or all of their variables; else ∓∞."""
    columns, bits = content.partners[rows], content.partner_bounds[rows]
    lower, upper = content.lower[columns], content.upper[columns]
    if not as_stated:
        return lower, upper
    return np.where(bits & 1, lower, -np.inf), np.where(bits & 2, upper, np.inf)


@dataclass(frozen=True, eq=False)
class SideConditions:
    """Side conditions of a complementarity problem.

    Attributes
    ----------
    content : NLContent
    inequalities : ndarray of int
        Rows without a partner.
    bounded : ndarray of int
        Variables with bounds and without a complementarity.
    """

    content: NLContent
    inequalities: Indices
    bounded: Indices

    def names(self) -> list[str]:
        """Return the names: inequalities, variables."""
        content = self.content
        rows, variables = self.inequalities.tolist(), self.bounded.tolist()
        return [*map(content.row, rows), *map(content.variable, variables)]

    def violated(self, x: FloatVector, rows: FloatVector, tolerance: float) -> str:
        """Return the names of what is violated at x, with the rows' values there and the run's tolerance; else ""."""
        content, inner = self.content, self.inequalities
        if not (names := self.names()):
            return ""
        # The change of a row if all its variables change.
        units = abs(jacobian(content, x, inner)) @ (1.0 + np.abs(x))
        own, bounds = x[self.bounded], (content.lower[self.bounded], content.upper[self.bounded])
        limits = content.row_lower[inner], content.row_upper[inner]
        excesses = np.append(
            excess(rows[inner], *limits, units), excess(own, *bounds, 1.0 + np.abs(own))
        )
        excesses = np.where(np.isnan(excesses), np.inf, excesses)
        worst = int(np.argmax(excesses))
        count = int((excesses > max(FEASIBLE, 10.0 * tolerance)).sum())
        others = f", nor {count - 1} more" if count > 1 else ""
        what = f"{names[worst]} does not hold{others}, off by {excesses[worst]:.2g}"
        return f"the complementarities and equations are solved, but {what}" if count else ""


def excess(body: Any, lower: Any, upper: Any, units: Any) -> Any:
    """Return by how much a body is beyond its bounds: of their size, at least 1, or of the row's if that is less."""
    sizes = np.maximum(
        *(np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (lower, upper))
    )
    scales = np.minimum(np.maximum(1.0, sizes), np.where(units > 0.0, units, np.abs(body)) + sizes)
    return np.maximum(np.maximum(lower - body, body - upper), 0.0) / np.where(
        scales > 0.0, scales, 1.0
    )
