"""What an answer is held against: the rows of the file as they stand, and what stands beside the problem.

Rows are evaluated by Python's own functions, which share nothing with the programs that are solved but the file. Beside
a complementarity problem stand inequalities without a partner, bounds of variables without a complementarity,
complementarities whose rows hold no unknown: no unknown gives way to them, so that the problem has solutions without
them. Bounds of a variable with a complementarity all belong to it, stated there or not, as PATH and AMPL take them.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector
from ...modeling.expressions.program import Program
from .content import Indices, NLContent, Token, Trees
from .expressions import UNKNOWNS, Expressions

DISAGREEMENT = 1e-9  # of the terms of a row
FEASIBLE = 1e-6  # by which they may be violated, or by ten times the tolerance
FUNCTIONS: dict[float, Callable[..., float]] = {
    0: operator.add, 1: operator.sub, 2: operator.mul, 3: operator.truediv, 5: math.pow, 16: operator.neg,
    37: math.tanh, 38: math.tan, 39: math.sqrt, 40: math.sinh, 41: math.sin, 42: math.log10, 43: math.log,
    44: math.exp, 45: math.cosh, 46: math.cos, 47: math.atanh, 49: math.atan, 50: math.asinh, 51: math.asin,
    52: math.acosh, 53: math.acos, 54: lambda *terms: math.fsum(terms), 76: math.pow, 77: lambda a: a * a,
    78: math.pow,
}
#: Σ |term| of what is multiplied out, from operands and their sizes; the value of any other function is one term.
SIZES: dict[float, Callable[[list[float], list[float]], float]] = {
    **dict.fromkeys((0, 1, 16, 54), lambda operands, sizes: math.fsum(sizes)),
    2: lambda operands, sizes: sizes[0] * sizes[1],
    77: lambda operands, sizes: sizes[0] * sizes[0],
    3: lambda operands, sizes: sizes[0] / abs(operands[1]),
    **dict.fromkeys((5, 76, 78), lambda operands, sizes: math.pow(sizes[0], operands[1])),
}


class Evaluation(NamedTuple):
    """Rows and objectives at a point, NaN where they have no value, and the sizes of both: Σ |term|."""

    rows: FloatVector
    objectives: FloatVector
    row_sizes: FloatVector
    objective_sizes: FloatVector


def evaluated(content: NLContent, x: FloatVector) -> Evaluation:
    """Return the values of the rows and of the objectives at x, shapes (m,) and (o,), with their sizes."""
    values, sizes = x.tolist(), np.abs(x).tolist()  # type: list[float], list[float]
    linear, trees = content.defined_linear, content.defined_trees
    for k in range(trees.size):
        entries = slice(linear.indptr[k], linear.indptr[k + 1])
        columns, factors = linear.indices[entries].tolist(), linear.data[entries].tolist()
        (value,), (size,) = _values(trees, values, sizes, k, k + 1)
        values.append(sum(factor * values[j] for j, factor in zip(columns, factors, strict=True)) + value)
        sizes.append(sum(abs(factor) * sizes[j] for j, factor in zip(columns, factors, strict=True)) + size)
    found = []
    for matrix, own in ((content.linear, content.trees), (content.objective_linear, content.objective_trees)):
        of_trees = np.array(_values(own, values, sizes, 0, own.size), dtype=np.float64)
        found.append((matrix @ x + of_trees[0], abs(matrix) @ np.abs(x) + of_trees[1]))
    (rows, row_sizes), (objectives, objective_sizes) = found
    return Evaluation(rows, objectives, row_sizes, objective_sizes)


def contradiction(
    content: NLContent, found: Evaluation, expected: FloatVector, allowed: Any = 0.0,
    objective: tuple[float, float] | None = None, relative: float = 0.0,
) -> str:
    """Return which row, or the objective, is something else at the answer than was computed; nothing where all agree.

    Parameters
    ----------
    content : NLContent
    found : Evaluation
        At the answer.
    expected : ndarray, shape (m,)
        NaN for a row that is not asked.
    allowed : number or ndarray, shape (m,)
        What a row may differ by, beside the rounding of its terms.
    objective : tuple of float, optional
        The first objective, and the sum of the absolute values of its terms.
    relative : float
        What a row may differ by beside its size, as well.
    """
    rows, objectives = found.rows, found.objectives
    allowed = (DISAGREEMENT + relative) * (np.abs(expected) + found.row_sizes) + allowed
    wrong = np.flatnonzero(~np.isnan(expected) & ~(np.abs(rows - expected) <= allowed))
    if wrong.size:
        k = int(wrong[0])
        return f"{content.row(k)} is {rows[k]:.9g} at the answer, where {expected[k]:.9g} was computed"
    if objective is not None and objectives.size:
        computed, terms = objective
        if not abs(objectives[0] - computed) <= DISAGREEMENT * (terms + found.objective_sizes[0]):
            return f"the objective is {objectives[0]:.9g} at the answer, where {computed:.9g} was computed"
    return ""


def _values(
    trees: Trees, values: list[float], sizes: list[float], first: int, last: int
) -> tuple[list[float], list[float]]:
    """Return values and sizes of the trees from `first` to `last`, read backwards, operands before operators."""
    begin, end = int(trees.starts[first]), int(trees.starts[last])
    stack: list[float] = []
    own: list[float] = []  # their sizes
    parts = (getattr(trees, name)[begin:end][::-1].tolist() for name in ("kinds", "values", "counts"))
    for kind, value, count in zip(*parts, strict=True):
        if kind == Token.NUMBER:
            stack.append(value)
            own.append(abs(value))
        elif kind == Token.VARIABLE:
            stack.append(values[int(value)])
            own.append(sizes[int(value)])
        else:
            operands, of_operands = stack[: -count - 1 : -1], own[: -count - 1 : -1]
            del stack[-count:], own[-count:]
            try:
                found = FUNCTIONS[value](*operands)
                size = abs(found) if value not in SIZES else max(abs(found), SIZES[value](operands, of_operands))
            except (ValueError, ZeroDivisionError, OverflowError):
                found = size = math.nan
            stack.append(found)
            own.append(size)
    return stack[::-1], own[::-1]


# --- Side conditions -----------------------------------------------------------------------------------------------


class PairBounds(NamedTuple):
    """The bounds that complementarity rows speak of, −∞ and ∞ where they speak of none, shape (k,)."""

    lower: FloatVector
    upper: FloatVector


def pair_bounds(content: NLContent, rows: Indices) -> PairBounds:
    """Return the bounds that complementarity rows speak of."""
    columns, bound_bits = content.partners[rows], content.partner_bounds[rows]
    lower, upper = content.lower[columns], content.upper[columns]
    return PairBounds(np.where(bound_bits & 1, lower, -np.inf), np.where(bound_bits & 2, upper, np.inf))


def jacobian(content: NLContent, x: FloatVector, rows: Indices) -> sp.csr_array:
    """Return the derivatives of rows, then objectives, with these numbers by all variables, shape (k, n)."""
    found = Expressions(content, np.full(x.size, np.nan))
    return Program.of(found.compiler, [found.rows(rows)], {UNKNOWNS: 0}, x.size).jacobian(x)


class SideConditions:
    """The side conditions of a complementarity problem.

    Parameters
    ----------
    content : NLContent
    pairs, inequalities, spare : array of int
        The complementarity rows that are solved, the rows without a partner, and the complementarity rows left out.

    Attributes
    ----------
    bounded : array of bool, shape (n,)
        The variables without a complementarity that have bounds; none where nothing is complementary.
    """

    def __init__(self, content: NLContent, pairs: Indices, inequalities: Indices, spare: Indices) -> None:
        self.content, self.pairs, self.inequalities, self.spare = content, pairs, inequalities, spare
        self.bounded: BoolVector = (np.isfinite(content.lower) | np.isfinite(content.upper)) & bool(pairs.size)
        self.bounded[content.partners[pairs]] = False

    def names(self) -> list[str]:
        """Return what they are called: inequalities, complementarities, variables."""
        content, rows = self.content, [*self.inequalities.tolist(), *self.spare.tolist()]
        columns = np.flatnonzero(self.bounded).tolist()
        return [*map(content.row, rows), *map(content.variable, columns)]

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
        # How much a row changes where all its variables do.
        units = abs(jacobian(content, x, np.append(inner, self.spare))) @ (1.0 + np.abs(x))
        excesses = np.concatenate([
            excess(rows[inner], content.row_lower[inner], content.row_upper[inner], units[: inner.size]),
            pair_excess(x[content.partners[self.spare]], rows[self.spare], *pair_bounds(content, self.spare),
                        units[inner.size:]),
            excess(*(part[self.bounded] for part in (x, content.lower, content.upper, 1.0 + np.abs(x)))),
        ])
        what = worst_violation(names, excesses, tolerance)[1]
        return what and (
            f"solved, but {what}: it stands beside the complementarities, and no unknown gives way to it; with an "
            "objective all solutions are searched"
        )

    def at_bounds_of_their_own(self, x: FloatVector) -> str:
        """Return which variable stops at a bound that its complementarity does not state; nothing where none does."""
        content, rows = self.content, self.pairs
        columns, bound_bits = content.partners[rows], content.partner_bounds[rows]
        for bit, word, bounds in ((1, "lower", content.lower), (2, "upper", content.upper)):
            bound = bounds[columns]
            is_there = np.isfinite(bound) & (np.abs(x[columns] - bound) <= FEASIBLE * np.maximum(1.0, np.abs(bound)))
            for k in np.flatnonzero(is_there & (bound_bits & bit == 0)).tolist():
                return (
                    f"{content.variable(columns[k])} stops at its own {word} bound {bound[k]:g}, which counts although "
                    f"its complementarity, {content.row(rows[k])}, does not state it"
                )
        return ""


def excess(body: Any, lower: Any, upper: Any, units: Any) -> Any:
    """Return by how much a body is beyond its bounds: of their size, at least 1, or of the row's where that is less."""
    sizes = np.maximum(*(np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (lower, upper)))
    scales = np.minimum(np.maximum(1.0, sizes), np.where(units > 0.0, units, np.abs(body)) + sizes)
    return np.maximum(np.maximum(lower - body, body - upper), 0.0) / np.where(scales > 0.0, scales, 1.0)


def pair_excess(body: Any, row: Any, lower: Any, upper: Any, units: Any) -> Any:
    """Return |body − mid(lower, upper, body − row/unit)| of pairs, of the body's size, at least 1; else NaN."""
    moved = np.where(np.isfinite(row), body - row / np.where(units > 0.0, np.minimum(units, 1.0), 1.0), np.nan)
    return np.abs(body - np.clip(moved, lower, upper)) / np.maximum(1.0, np.abs(body))


def worst_violation(names: Sequence[str], excesses: Any, tolerance: float) -> tuple[int, str]:
    """Return which excess is the largest, and what does not hold, in words; none where all are at most `FEASIBLE`."""
    excesses = np.where(np.isnan(excesses), np.inf, excesses)
    worst, count = int(np.argmax(excesses)), int((excesses > max(FEASIBLE, 10.0 * tolerance)).sum())
    others = f", nor {count - 1} more" if count > 1 else ""
    return worst, f"{names[worst]} does not hold{others}, off by {excesses[worst]:.2g}" if count else ""
