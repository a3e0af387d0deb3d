"""What an ``.nl`` file says, text or binary alike: plain arrays, nothing computed.

The ten lines of the head are text in binary files too.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector

Indices = NDArray[np.int64]
NARY, PIECEWISE = -1, -2  # in ARITY: a number of operands follows; a number of slopes
NO_OPERATOR = -9
UNARY_OPERATORS = (13, 14, 15, 16, 34, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46, 47, 49, 50, 51, 52, 53, 77)
BINARY_OPERATORS = (
    0, 1, 2, 3, 4, 5, 6, 20, 21, 22, 23, 24, 28, 29, 30, 48, 55, 56, 57, 58, 62, 63, 66, 67, 68, 69, 73, 76, 78,
)
TERNARY_OPERATORS = (35, 65, 72)
NARY_OPERATORS = (11, 12, 54, 59, 60, 61, 70, 71, 74, 75)
PIECEWISE_OPERATOR = 64
ARITY = np.full(79, NO_OPERATOR, dtype=np.int64)
ARITY[list(UNARY_OPERATORS)] = 1
ARITY[list(BINARY_OPERATORS)] = 2
ARITY[list(TERNARY_OPERATORS)] = 3
ARITY[list(NARY_OPERATORS)] = NARY
ARITY[PIECEWISE_OPERATOR] = PIECEWISE
SUFFIX_KIND, SUFFIX_IS_REAL = 3, 4  # bits of the first number of an S segment
PARTNER = 5  # the kind of a complementarity row
LINES = 10
MOST_OPTIONS = 9
WITH_TOLERANCE = 3  # as the second option: the first line ends with a tolerance
LITTLE_ENDIAN, BIG_ENDIAN = 1, 2  # the kinds of arithmetic that can be read; 0 is the writer's own
MOST_LINE_BYTES = 4096  # a line of the header is never longer
NEEDED = {  # line: (numbers that must stand there, numbers that may)
    2: (3, 6), 3: (2, 6), 4: (2, 2), 5: (2, 3), 6: (2, 4), 7: (2, 5), 8: (2, 2), 9: (2, 2), 10: (5, 5),
}
MEANING = {
    2: "variables, rows, objectives", 3: "nonlinear rows and objectives", 4: "network rows", 5: "nonlinear variables",
    6: "network variables, functions", 7: "integer variables", 8: "nonzeros", 9: "lengths of names",
    10: "defined variables",
}


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

    def variable(self, column: int) -> str:
        """Return the name of a variable, or its number; behind the last one come the defined variables."""
        if column >= self.lower.size:
            return f"defined variable {column - self.lower.size}"
        return f"variable {column}" if self.names is None else self.names[column]

    def row(self, row: int) -> str:
        """Return the name of a row, or its number."""
        return f"row {row if self.row_names is None else self.row_names[row]}"


class Fault(ValueError):
    """What is wrong with a file, and in which line or at which byte."""

    def __init__(self, place: Any, what: str) -> None:
        super().__init__(what)
        self.place = int(place)


class HeadFault(Fault):
    """What is wrong with a line of the head, which is text in binary files too."""


@dataclass(frozen=True)
class Header:
    """The numbers of the head; the names are of what is used of them."""

    is_binary: bool
    options: tuple[int, ...]
    tolerance: float | None
    variables: int
    rows: int
    objectives: int
    logical_rows: int
    complementarities: int
    nonlinear: tuple[int, int, int]  # variables in rows, in objectives, in both
    functions: int
    byteorder: str  # as struct writes it
    integers: tuple[int, int, int, int, int]  # binary, integer; nonlinear in both, in rows, in objectives
    nonzeros: int
    objective_nonzeros: int
    name_lengths: tuple[int, int]
    defined: int



def read_header(data: bytes) -> tuple[Header, int]:
    """Return the head and where the segments begin."""
    lines, position = [], 0
    for number in range(1, LINES + 1):
        end = data.find(b"\n", position, position + MOST_LINE_BYTES)
        if end < 0:
            raise HeadFault(number, f"the head of an .nl file has {LINES} lines, and the file ends here"
                            if len(data) - position < MOST_LINE_BYTES else "this is no line of the head of an .nl file")
        lines.append(data[position:end])
        position = end + 1
        if number == 1 and lines[0][:1] not in (b"g", b"b"):
            raise HeadFault(1, "an .nl file begins with g (text) or b (binary)")
    is_binary = lines[0][:1] == b"b"
    options, tolerance = _options(lines[0][1:])
    numbers = {k: _numbers(lines[k - 1], k) for k in NEEDED}
    _refuse_what_cannot_follow(numbers, len(data) - position)
    size, complementarity, integers = numbers[2], numbers[3], numbers[7]
    arithmetic = numbers[6][2]
    if is_binary and arithmetic not in (0, LITTLE_ENDIAN, BIG_ENDIAN):
        raise HeadFault(6, f"its numbers are of the arithmetic {arithmetic}, and 1 (IEEE, little-endian) "
                        "or 2 (big-endian) is needed; write the file as text")
    return Header(
        is_binary=is_binary, options=options, tolerance=tolerance, variables=size[0], rows=size[1],
        objectives=size[2], logical_rows=size[5], complementarities=complementarity[2] + complementarity[3],
        nonlinear=(numbers[5][0], numbers[5][1], numbers[5][2]), functions=numbers[6][1],
        byteorder=">" if arithmetic == BIG_ENDIAN else "<",
        integers=(integers[0], integers[1], integers[2], integers[3], integers[4]), nonzeros=numbers[8][0],
        objective_nonzeros=numbers[8][1], name_lengths=(numbers[9][0], numbers[9][1]), defined=sum(numbers[10]),
    ), position


def _options(text: bytes) -> tuple[tuple[int, ...], float | None]:
    """Return the numbers of the first line, the first of which says how many follow, and the tolerance."""
    words = text.split(b"#")[0].split()
    try:
        count = int(words[0]) if words else 0
        if not 0 <= count <= MOST_OPTIONS:
            raise HeadFault(1, f"it announces {count} options, and at most {MOST_OPTIONS} are possible")
        given = [int(word) for word in words[1:count + 1]]
        options = (count, *given, *[0] * (count - len(given)))
        has_tolerance = count >= 2 and options[2] == WITH_TOLERANCE and len(words) > count + 1
        return options, float(words[count + 1]) if has_tolerance else None
    except ValueError as error:
        if isinstance(error, HeadFault):
            raise
        raise HeadFault(1, "the options behind its letter are whole numbers") from None


def _numbers(line: bytes, number: int) -> list[int]:
    """Return the numbers of a line, zeros for those that may be missing."""
    needed, possible = NEEDED[number]
    words = line.split(b"#")[0].split()
    if len(words) < needed or not b"".join(words[:possible]).isdigit():
        count = needed if needed == possible else f"{needed} to {possible}"
        raise HeadFault(number, f"{count} whole numbers are needed ({MEANING[number]})")
    if max(map(len, words[:possible])) > 18:
        raise HeadFault(number, "that is more than any file can hold")
    return [int(word) for word in words[:possible]] + [0] * (possible - len(words))


def _refuse_what_cannot_follow(numbers: dict[int, list[int]], length: int) -> None:
    """Raise where more is announced than so many bytes can hold, at one byte each, before anything is allocated."""
    for k, which in ((2, (0, 1, 2, 5)), (6, (1,)), (8, (0, 1)), (10, (0, 1, 2, 3, 4))):
        for position in which:
            if numbers[k][position] > length:
                raise HeadFault(k, f"{numbers[k][position]} are announced ({MEANING[k]}), and {length} bytes follow")
