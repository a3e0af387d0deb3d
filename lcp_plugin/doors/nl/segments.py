"""What the text and the binary reader of ``.nl`` files hand on: the segments as they stand, with their places."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector
from .content import Indices

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
BOUND_WORDS = (2, 1, 1, 0, 1, 2)  # numbers behind the kind of a bound
PARTNER = 5  # the kind of a complementarity row


class Fault(ValueError):
    """What is wrong with a file, and in which line or at which byte."""

    def __init__(self, place: int, what: str) -> None:
        super().__init__(what)
        self.place = int(place)


class HeadFault(Fault):
    """What is wrong with a line of the head, which is text in binary files too."""


def fail(place: Any, what: str) -> NoReturn:
    """Raise the Fault."""
    raise Fault(int(place), what)


@dataclass
class Linear:
    """The segments of one letter that hold pairs of an index and a value, one after the other.

    Attributes
    ----------
    owners : ndarray of int64, shape (s,)
        What each segment belongs to, for instance the row.
    counts : ndarray of int64, shape (s,)
        How many pairs it has.
    places, first_places : ndarray of int64, shape (s,)
        Where it begins, and where its first pair stands.
    stride : int
        From one pair to the next: a line, or so many bytes.
    columns, values : ndarray of float64
        The pairs.
    """

    owners: Indices
    counts: Indices
    places: Indices
    first_places: Indices
    stride: int
    columns: FloatVector
    values: FloatVector

    def place(self, pair: int) -> int:
        """Where the pair of that number stands."""
        ends = np.cumsum(self.counts)
        k = int(np.searchsorted(ends, pair, side="right"))
        return int(self.first_places[k] + self.stride * (pair - (ends[k] - self.counts[k])))


@dataclass
class Forest:
    """The expression trees of the segments of one letter; the arrays of tokens are those of `content.Trees`."""

    owners: Indices
    places: Indices
    kinds: NDArray[np.uint8]
    values: FloatVector
    counts: Indices
    token_places: Indices
    starts: Indices


@dataclass
class Bounds:
    """A ``b`` or ``r`` segment: the kind of each bound, and the numbers behind it, 0 where there is none."""

    kinds: FloatVector
    first: FloatVector
    second: FloatVector
    places: Indices


@dataclass
class NamedValues:
    """An ``S`` segment."""

    name: bytes
    bits: int
    pairs: Linear


@dataclass
class Segments:
    """All segments of a file."""

    linear: dict[str, Linear] = field(default_factory=dict)  # J, G, V, x, d
    trees: dict[str, Forest] = field(default_factory=dict)  # C, O, V, L
    bounds: dict[str, Bounds] = field(default_factory=dict)  # b, r
    senses: list[int] = field(default_factory=list)  # of the O segments
    suffixes: list[NamedValues] = field(default_factory=list)
    functions: list[tuple[int, int, bytes]] = field(default_factory=list)  # place, number, name
    column_counts: FloatVector | None = None
    column_place: int = 0
    is_cumulative: bool = True
    strings: list[bytes] = field(default_factory=list)
    hidden_lines: list[tuple[int, int]] = field(default_factory=list)  # a string's line, how many more it goes over

    def line(self, place: int) -> int:
        """Return the line of a text file that is the one of that number where no string goes over several."""
        return place + sum(count for line, count in self.hidden_lines if line < place)


def checked_count(value: float, most: int, place: Any, what: str) -> int:
    """Return a whole number from 0 to `most`, or fail."""
    if not 0 <= value <= most or value != int(value):
        fail(place, f"{what} is {value:g}, and only 0 to {most} is possible here")
    return int(value)
