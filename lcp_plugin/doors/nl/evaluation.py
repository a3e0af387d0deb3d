"""The rows of an ``.nl`` file evaluated as they stand, by Python's own functions: what an answer is held against.

It shares nothing with the programs that are solved but the file.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from .content import NLContent, Token, Trees
from .tokens import row_name

DISAGREEMENT = 1e-9  # of the terms of a row
FUNCTIONS: dict[float, Callable[..., float]] = {
    0: operator.add, 1: operator.sub, 2: operator.mul, 3: operator.truediv, 5: math.pow, 16: operator.neg,
    37: math.tanh, 38: math.tan, 39: math.sqrt, 40: math.sinh, 41: math.sin, 42: math.log10, 43: math.log,
    44: math.exp, 45: math.cosh, 46: math.cos, 47: math.atanh, 49: math.atan, 50: math.asinh, 51: math.asin,
    52: math.acosh, 53: math.acos, 54: lambda *terms: math.fsum(terms), 76: math.pow, 77: lambda a: a * a,
    78: math.pow,
}


def evaluated(content: NLContent, x: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return the values of the rows and of the objectives at x, shapes (m,) and (o,); NaN where there is none."""
    values: list[float] = x.tolist()
    linear, trees = content.defined_linear, content.defined_trees
    for k in range(trees.size):
        entries = slice(linear.indptr[k], linear.indptr[k + 1])
        terms = zip(linear.indices[entries].tolist(), linear.data[entries].tolist(), strict=True)
        values.append(sum(factor * values[column] for column, factor in terms) + _values(trees, values, k, k + 1)[0])
    rows, objectives = (
        matrix @ x + np.array(_values(own, values, 0, own.size), dtype=np.float64)
        for matrix, own in ((content.linear, content.trees), (content.objective_linear, content.objective_trees))
    )
    return rows, objectives


def contradiction(
    content: NLContent, x: FloatVector, found: tuple[FloatVector, FloatVector], expected: FloatVector,
    allowed: FloatVector, objective: tuple[float, float] | None = None,
) -> str:
    """Return which row, or the objective, is something else at x than was computed; nothing where all agree.

    Parameters
    ----------
    content : NLContent
    x : ndarray, shape (n,)
    found : tuple of ndarray
        What `evaluated` says of x.
    expected : ndarray, shape (m,)
        NaN for a row that is not asked.
    allowed : ndarray, shape (m,)
        What a row may differ by, beside the rounding of its linear terms.
    objective : tuple of float, optional
        The first objective, and the sum of the absolute values of its terms.
    """
    rows, objectives = found
    size = 1.0 + np.abs(expected) + abs(content.linear) @ np.abs(x)
    wrong = np.flatnonzero(~np.isnan(expected) & ~(np.abs(rows - expected) <= DISAGREEMENT * size + allowed))
    if wrong.size:
        k = int(wrong[0])
        return f"{row_name(content, k)} is {rows[k]:.9g} at the answer, where {expected[k]:.9g} was computed"
    if objective is not None and objectives.size:
        computed, terms = objective
        if not abs(objectives[0] - computed) <= DISAGREEMENT * (1.0 + terms):
            return f"the objective is {objectives[0]:.9g} at the answer, where {computed:.9g} was computed"
    return ""


def _values(trees: Trees, values: list[float], first: int, last: int) -> list[float]:
    """Return the values of the trees from `first` to `last`, read backwards, operands before operators."""
    begin, end = int(trees.starts[first]), int(trees.starts[last])
    stack: list[Any] = []
    parts = (getattr(trees, name)[begin:end][::-1].tolist() for name in ("kinds", "values", "counts"))
    for kind, value, count in zip(*parts, strict=True):
        if kind == Token.NUMBER:
            stack.append(value)
        elif kind == Token.VARIABLE:
            stack.append(values[int(value)])
        else:
            operands = stack[: -count - 1 : -1]
            del stack[-count:]
            try:
                stack.append(FUNCTIONS[value](*operands))
            except (ValueError, ZeroDivisionError, OverflowError):
                stack.append(math.nan)
    return stack[::-1]
