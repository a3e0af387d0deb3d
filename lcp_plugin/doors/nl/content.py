"""What an ``.nl`` file says, text or binary alike: plain arrays, nothing computed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector

Indices = NDArray[np.int64]


class Token(IntEnum):
    """What stands at a place of an expression tree."""

    NUMBER = 0  # its value
    VARIABLE = 1  # the number of a variable; from n on, of a defined variable
    OPERATOR = 2  # AMPL's number of the operator: 0 plus, 2 times …
    CALL = 3  # the number of an external function
    STRING = 4  # the place of a text in `strings`


@dataclass(frozen=True, eq=False)
class Trees:
    """Expression trees, one after the other, each in prefix order: an operator, then its operands.

    Attributes
    ----------
    kinds : ndarray of uint8, shape (t,)
        Of every token, as `Token` numbers them.
    values : ndarray of float64, shape (t,)
        The number, or the number of the variable, operator, function or string.
    counts : ndarray of int64, shape (t,)
        How many operands follow; 0 for what is neither operator nor call.
    starts : ndarray of int64, shape (k + 1,)
        Tree j is the tokens starts[j] to starts[j + 1]; every tree has at least one, a linear row the number 0.
    strings : tuple of bytes
    """

    kinds: NDArray[np.uint8]
    values: FloatVector
    counts: Indices
    starts: Indices
    strings: tuple[bytes, ...] = ()

    @property
    def size(self) -> int:
        """The number of trees."""
        return self.starts.size - 1


@dataclass(frozen=True, eq=False)
class Suffix:
    """Values that somebody attached: to variables (kind 0), rows (1), objectives (2) or the problem (3)."""

    name: str
    kind: int
    indices: Indices
    values: NDArray[Any]


@dataclass(frozen=True, eq=False)
class NLContent:
    """The content of an ``.nl`` file.

    Attributes
    ----------
    lower, upper : ndarray, shape (n,)
        Bounds of the variables.
    row_lower, row_upper : ndarray, shape (m,)
        Of the rows; −∞ and ∞ in a complementarity row.
    partners : ndarray of int, shape (m,)
        The variable that a complementarity row goes with; −1 for any other row.
    partner_bounds : ndarray of int, shape (m,)
        Which bounds of it are finite: 1 the lower, 2 the upper, 3 both, 0 none.
    linear : CSR array, shape (m, n)
        The linear terms of the rows; what is in a tree as well is stored as 0 here.
    trees : Trees
        The nonlinear terms of the rows, m trees.
    is_maximized : ndarray of bool, shape (o,)
        Of each objective.
    objective_linear, objective_trees
        As of the rows.
    defined_linear : CSR array, shape (d, n + d)
        The linear terms of defined variables, each of which uses only those before it.
    defined_trees : Trees
    is_integer : ndarray of bool, shape (n,)
    logical_rows : int
        How many logical constraints there are; what they say is not kept.
    functions : tuple of str
        Names of the external functions.
    start, dual_start : ndarray, shape (n,) and (m,)
        0 where the file says nothing.
    has_start : ndarray of bool, shape (n,)
        Where the file gives a start.
    suffixes : list of Suffix
    names, row_names : list of str or None
        Of ``.col`` and ``.row`` files beside it.
    options : tuple of int
        The numbers of the first line, which the ``.sol`` file repeats.
    tolerance : float or None
        What some writers put into the first line with them.
    """

    lower: FloatVector
    upper: FloatVector
    row_lower: FloatVector
    row_upper: FloatVector
    partners: Indices
    partner_bounds: Indices
    linear: sp.csr_array
    trees: Trees
    is_maximized: NDArray[np.bool_]
    objective_linear: sp.csr_array
    objective_trees: Trees
    defined_linear: sp.csr_array
    defined_trees: Trees
    is_integer: NDArray[np.bool_]
    logical_rows: int
    functions: tuple[str, ...]
    start: FloatVector
    dual_start: FloatVector
    has_start: NDArray[np.bool_]
    suffixes: list[Suffix]
    names: list[str] | None = None
    row_names: list[str] | None = None
    options: tuple[int, ...] = (3, 0, 1, 0)
    tolerance: float | None = None
