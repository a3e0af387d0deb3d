"""Content of an ``.nl`` file, text or binary alike: plain arrays, nothing computed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector

Indices = NDArray[np.int64]
NARY, PIECEWISE = (-1, -2)  # instead of a number of operands: that follows; a number of slopes does


def _table(text: str) -> dict[int, str]:
    """Return names by numbers."""
    pairs = (one.strip().partition(" ") for one in text.split(","))
    return {int(number): name for number, _, name in pairs}


#: AMPL's operators by how many operands they have.
OPERATOR_NAMES: dict[int, dict[int, str]] = {
    1: _table(
        "13 floor, 14 ceil, 15 abs, 16 unary -, 34 not, 37 tanh, 38 tan, 39 sqrt, 40 sinh, "
        "41 sin, 42 log10, 43 log, 44 exp, 45 cosh, 46 cos, 47 atanh, 49 atan, 50 asinh, 51 "
        "asin, 52 acosh, 53 acos, 77 square"
    ),
    2: _table(
        "0 +, 1 -, 2 *, 3 /, 4 mod, 5 ^, 6 less, 20 or, 21 and, 22 <, 23 <=, 24 =, 28 >=, "
        "29 >, 30 <>, 48 atan2, 55 div, 56 precision, 57 round, 58 trunc, 62 atleast, 63 "
        "atmost, 66 exactly, 67 not atleast, 68 not atmost, 69 not exactly, 73 <==>, 76 ^, "
        "78 ^"
    ),
    3: _table("35 if, 65 if, 72 ==>"),
    NARY: _table(
        "11 min, 12 max, 54 +, 59 count, 60 numberof, 61 numberof, 70 forall, 71 exists, 74 "
        "alldiff, 75 not alldiff"
    ),
    PIECEWISE: _table("64 piecewise-linear term"),
}
ARITY = {number: arity for arity, names in OPERATOR_NAMES.items() for number in names}
SUFFIX_IS_REAL = 4  # a bit of the first number of an S segment
PARTNER = 5  # the kind of a complementarity row
MOST_OPTIONS = 9
WITH_TOLERANCE = 3  # as the second option: the first line ends with a tolerance
LITTLE_ENDIAN, BIG_ENDIAN = (
    1,
    2,
)  # the kinds of arithmetic that can be read; 0 is the writer's own


class Token(IntEnum):
    """Type of a token of an expression tree."""

    NUMBER = 0  # its value
    VARIABLE = 1  # the number of a variable; from n on, of a defined variable
    OPERATOR = 2  # AMPL's number of the operator: 0 plus, 2 times …


@dataclass(frozen=True, eq=False)
class Trees:
    """Expression trees in one array, each in prefix order: an operator, then the operands.

    Attributes
    ----------
    kinds : ndarray of uint8, shape (t,)
        Type of every token, a `Token`.
    values : ndarray of float64, shape (t,)
        The number, or the number of the variable or operator.
    counts : ndarray of int64, shape (t,)
        Number of operands that follow; 0 unless the token is an operator.
    starts : ndarray of int64, shape (k + 1,)
        Tree j is the tokens starts[j] to starts[j + 1]; every tree has at least one, a linear row the number 0.
    """

    kinds: NDArray[np.uint8]
    values: FloatVector
    counts: Indices
    starts: Indices

    @classmethod
    def of_numbers(cls, values: FloatVector) -> Trees:
        """Return a tree a number."""
        k = values.size
        return cls(
            np.full(k, Token.NUMBER, np.uint8),
            values,
            np.zeros(k, dtype=np.int64),
            np.arange(k + 1),
        )

    @property
    def size(self) -> int:
        """The number of trees."""
        return self.starts.size - 1


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
        Finite bounds of the partner: 1 the lower, 2 the upper, 3 both, 0 none.
    linear : CSR array, shape (m, n)
        The linear terms of the rows; a variable that occurs only in the tree has an explicit 0.
    trees : Trees
        The nonlinear terms of the rows, m trees.
    is_maximized : ndarray of bool, shape (o,)
        True for an objective that is maximized.
    objective_linear, objective_trees
        Terms of the objectives, stored like the rows.
    defined_linear : CSR array, shape (d, n + d)
        The linear terms of defined variables; each uses only variables defined before.
    defined_trees : Trees
    is_integer : ndarray of bool, shape (n,)
    start : ndarray, shape (n,)
        0 if the file gives no start.
    has_start : ndarray of bool, shape (n,)
        True if the file gives a start.
    names, row_names : list of str or None
        Names in the ``.col`` and ``.row`` files.
    options : tuple of int
        The numbers of the first line, which the ``.sol`` file repeats.
    tolerance : float or None
        Tolerance, which some writers add to the first line.
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
    start: FloatVector
    has_start: NDArray[np.bool_]
    names: list[str] | None = None
    row_names: list[str] | None = None
    options: tuple[int, ...] = (3, 0, 1, 0)
    tolerance: float | None = None

    @classmethod
    def of_rows(
        cls,
        lower: FloatVector,
        upper: FloatVector,
        linear: sp.csr_array,
        trees: Trees,
        limits: tuple[FloatVector, FloatVector],
        partners: Indices,
        partner_bounds: Indices,
        objective: Trees | None = None,
        objective_linear: sp.csr_array | None = None,
    ) -> NLContent:
        """Return the content of rows with limits, and of an objective to minimize, if any."""
        n, count = lower.size, 0 if objective is None else 1
        none = Trees.of_numbers(np.zeros(0))
        return cls(
            lower=lower,
            upper=upper,
            row_lower=limits[0],
            row_upper=limits[1],
            partners=partners,
            partner_bounds=partner_bounds,
            linear=linear,
            trees=trees,
            is_maximized=np.zeros(count, dtype=bool),
            objective_linear=sp.csr_array((count, n))
            if objective_linear is None
            else objective_linear,
            objective_trees=objective or none,
            defined_linear=sp.csr_array((0, n)),
            defined_trees=none,
            is_integer=np.zeros(n, dtype=bool),
            start=np.zeros(n),
            has_start=np.zeros(n, dtype=bool),
        )

    def variable(self, column: int) -> str:
        """Return the name of a variable, or its number; behind the last one come the defined variables."""
        if column >= self.lower.size:
            return f"defined variable {column - self.lower.size}"
        return f"variable {column}" if self.names is None else self.names[column]

    def row(self, row: int) -> str:
        """Return the name of a row, or its number."""
        return f"row {row if self.row_names is None else self.row_names[row]}"
