"""What an answer is held against: the rows of the file as they stand, and what stands beside the problem.

Rows are evaluated as they stand in the file; of what is solved they share no more than the functions. Beside
a complementarity problem stand inequalities without a partner, bounds of variables without a complementarity,
complementarities whose rows hold no unknown: no unknown gives way to them, so that the problem has solutions without
them. Bounds of a variable with a complementarity all belong to it, stated there or not, as PATH and AMPL take them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector
from ...expressions.program import Program
from ...problems.programs.program import QuadraticProgram
from ...problems.programs.solving import solve_program
from .content import Indices, NLContent, Token
from .expressions import UNKNOWNS, Expressions
from .operators import OPERATORS, Arithmetic, evaluated_tree, value_of

DISAGREEMENT = 1e-9  # of the terms of a row
FEASIBLE = 1e-6  # by which they may be violated, or by ten times the tolerance
#: Σ |term| of what is multiplied out, from operands and their sizes; the value of any other function is one term.
SIZES: dict[Any, Callable[[list[float], list[float]], float]] = {
    **dict.fromkeys(
        (Arithmetic.SUM, Arithmetic.DIFFERENCE, Arithmetic.NEGATION),
        lambda operands, sizes: sum(sizes),
    ),
    Arithmetic.PRODUCT: lambda operands, sizes: sizes[0] * sizes[1],
    Arithmetic.SQUARE: lambda operands, sizes: sizes[0] * sizes[0],
    Arithmetic.QUOTIENT: lambda operands, sizes: sizes[0] / abs(operands[1]),
    Arithmetic.POWER: lambda operands, sizes: math.pow(sizes[0], operands[1]),
}


class Evaluation(NamedTuple):
    """Rows and objectives at a point, NaN where they have no value, and the sizes of both: Σ |term|."""

    rows: FloatVector
    objectives: FloatVector
    row_sizes: FloatVector
    objective_sizes: FloatVector


@np.errstate(all="ignore")
def evaluated(content: NLContent, x: FloatVector) -> Evaluation:
    """Return the values of the rows and of the objectives at x, shapes (m,) and (o,), with their sizes."""
    values, sizes = x.tolist(), np.abs(x).tolist()  # type: list[float], list[float]

    def leaf(kind: int, value: float) -> tuple[float, float]:
        return (
            (value, abs(value)) if kind == Token.NUMBER else (values[int(value)], sizes[int(value)])
        )

    linear, trees = content.defined_linear, content.defined_trees
    for k in range(trees.size):
        value, size = evaluated_tree(trees, k, leaf, _operation)
        entries = slice(linear.indptr[k], linear.indptr[k + 1])
        for column, factor in zip(
            linear.indices[entries].tolist(), linear.data[entries].tolist(), strict=True
        ):
            value, size = value + factor * values[column], size + abs(factor) * sizes[column]
        values.append(value)
        sizes.append(size)
    found = []
    for matrix, own in (
        (content.linear, content.trees),
        (content.objective_linear, content.objective_trees),
    ):
        of_trees = [evaluated_tree(own, k, leaf, _operation) for k in range(own.size)]
        terms = np.array(of_trees, dtype=np.float64).reshape(-1, 2).T
        found.append((matrix @ x + terms[0], abs(matrix) @ np.abs(x) + terms[1]))
    (rows, row_sizes), (objectives, objective_sizes) = found
    return Evaluation(rows, objectives, row_sizes, objective_sizes)


def _operation(number: int, operands: list[tuple[float, float]]) -> tuple[float, float]:
    """Return value and size of an operator."""
    rule, values = OPERATORS[number], [value for value, _ in operands]
    found = float(value_of(rule, values))
    if not math.isfinite(found):
        return math.nan, math.nan
    if rule not in SIZES:
        return found, abs(found)
    try:
        return found, max(abs(found), SIZES[rule](values, [size for _, size in operands]))
    except OverflowError:
        return found, math.inf


def contradiction(
    content: NLContent,
    found: Evaluation,
    expected: FloatVector,
    allowed: Any = 0.0,
    objective: tuple[float, float] | None = None,
    relative: float = 0.0,
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
        return (
            f"{content.row(k)} is {rows[k]:.9g} at the answer, where {expected[k]:.9g} was computed"
        )
    if objective is not None and objectives.size:
        computed, terms = objective
        if not abs(objectives[0] - computed) <= DISAGREEMENT * (terms + found.objective_sizes[0]):
            return f"the objective is {objectives[0]:.9g} at the answer, where {computed:.9g} was computed"
    return ""


# --- Side conditions -----------------------------------------------------------------------------------------------


class PairBounds(NamedTuple):
    """The bounds that complementarity rows speak of, −∞ and ∞ where they speak of none, shape (k,)."""

    lower: FloatVector
    upper: FloatVector


def pair_bounds(content: NLContent, rows: Indices) -> PairBounds:
    """Return the bounds that complementarity rows speak of."""
    columns, bound_bits = content.partners[rows], content.partner_bounds[rows]
    lower, upper = content.lower[columns], content.upper[columns]
    return PairBounds(
        np.where(bound_bits & 1, lower, -np.inf), np.where(bound_bits & 2, upper, np.inf)
    )


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
    lone : array of int
        The variables that only inequalities hold.

    Attributes
    ----------
    bounded : array of bool, shape (n,)
        The variables without a complementarity that have bounds; none where nothing is complementary.
    """

    def __init__(
        self,
        content: NLContent,
        pairs: Indices,
        inequalities: Indices,
        spare: Indices,
        lone: Indices,
    ) -> None:
        self.content, self.pairs, self.inequalities, self.spare, self.lone = (
            content,
            pairs,
            inequalities,
            spare,
            lone,
        )
        self.bounded: BoolVector = (np.isfinite(content.lower) | np.isfinite(content.upper)) & bool(
            pairs.size
        )
        self.bounded[content.partners[pairs]] = False

    def names(self) -> list[str]:
        """Return what they are called: inequalities, complementarities, variables."""
        content, rows = self.content, [*self.inequalities.tolist(), *self.spare.tolist()]
        columns = np.flatnonzero(self.bounded).tolist()
        return [*map(content.row, rows), *map(content.variable, columns)]

    def settled(self, x: FloatVector) -> FloatVector:
        """Return x with the variables that only inequalities hold as near to their start as these let them."""
        if not self.lone.size:
            return x
        content, rows, start = self.content, self.inequalities, x[self.lone]
        for _ in range(10):  # one step where the rows are affine
            A = jacobian(content, x, rows)[:, self.lone]
            rest = evaluated(content, x).rows[rows] - A @ x[self.lone]
            holds = (np.diff(A.indptr) > 0) & np.isfinite(rest)
            least, most = (
                (limit[rows] - rest)[holds] for limit in (content.row_lower, content.row_upper)
            )
            near = solve_program(
                QuadraticProgram.from_ranges(
                    sp.eye_array(start.size),
                    -start,
                    A[holds],
                    least,
                    most,
                    content.lower[self.lone],
                    content.upper[self.lone],
                )
            )
            if not near.is_solved or np.allclose(near.x, x[self.lone], rtol=FEASIBLE, atol=0.0):
                break
            x = x.copy()
            x[self.lone] = near.x
        return x

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
        excesses = np.concatenate(
            [
                excess(
                    rows[inner],
                    content.row_lower[inner],
                    content.row_upper[inner],
                    units[: inner.size],
                ),
                pair_excess(
                    x[content.partners[self.spare]],
                    rows[self.spare],
                    *pair_bounds(content, self.spare),
                    units[inner.size :],
                ),
                excess(
                    *(
                        part[self.bounded]
                        for part in (x, content.lower, content.upper, 1.0 + np.abs(x))
                    )
                ),
            ]
        )
        what = worst_violation(names, excesses, tolerance)
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
            is_there = np.isfinite(bound) & (
                np.abs(x[columns] - bound) <= FEASIBLE * np.maximum(1.0, np.abs(bound))
            )
            for k in np.flatnonzero(is_there & (bound_bits & bit == 0)).tolist():
                return (
                    f"{content.variable(columns[k])} stops at its own {word} bound {bound[k]:g}, which counts although "
                    f"its complementarity, {content.row(rows[k])}, does not state it"
                )
        return ""


def excess(body: Any, lower: Any, upper: Any, units: Any) -> Any:
    """Return by how much a body is beyond its bounds: of their size, at least 1, or of the row's where that is less."""
    sizes = np.maximum(
        *(np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (lower, upper))
    )
    scales = np.minimum(np.maximum(1.0, sizes), np.where(units > 0.0, units, np.abs(body)) + sizes)
    return np.maximum(np.maximum(lower - body, body - upper), 0.0) / np.where(
        scales > 0.0, scales, 1.0
    )


def pair_excess(body: Any, row: Any, lower: Any, upper: Any, units: Any) -> Any:
    """Return |body − mid(lower, upper, body − row/unit)| of pairs, of the body's size, at least 1; else NaN."""
    moved = np.where(
        np.isfinite(row), body - row / np.where(units > 0.0, np.minimum(units, 1.0), 1.0), np.nan
    )
    return np.abs(body - np.clip(moved, lower, upper)) / np.maximum(1.0, np.abs(body))


def worst_violation(names: Sequence[str], excesses: Any, tolerance: float) -> str:
    """Return what does not hold, in words, and the largest excess; nothing where all are at most `FEASIBLE`."""
    excesses = np.where(np.isnan(excesses), np.inf, excesses)
    worst, count = int(np.argmax(excesses)), int((excesses > max(FEASIBLE, 10.0 * tolerance)).sum())
    others = f", nor {count - 1} more" if count > 1 else ""
    return f"{names[worst]} does not hold{others}, off by {excesses[worst]:.2g}" if count else ""
