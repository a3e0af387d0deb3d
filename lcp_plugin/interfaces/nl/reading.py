"""Content of ``.nl`` files, text or binary, and its reader.

The two forms give letters, numbers and names in the same order: text line by line, or bytes. The segments become an
`NLContent`: plain arrays, nothing computed. A place is the byte at which the last item read begins.
"""

from __future__ import annotations

import math
import struct
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import INFINITE_LIMIT, Indices, Vector
from ...core.errors import UnreadableFile, UnsupportedModel
from ...core.files import checked_path, opened, read_number
from ...core.names import Names

CONVERTERS: dict[str, type] = {"i": int, "h": int, "d": float}
NO_NUMBERS = "this is neither a number nor a letter of the format, or too few follow"


class NLSyntaxError(ValueError):
    """Error in a file, with its line or byte."""

    def __init__(self, place: int, what: str) -> None:
        super().__init__(what)
        self.place = place


class _Form:
    """Items of a file from a byte on; a binary file has a byte order, "<" or ">", as struct writes it."""

    def __init__(self, data: bytes, begin: int, order: str = "") -> None:
        self.data, self.order = data, order
        self.at = self._next = begin

    def fail(self, what: str) -> NoReturn:
        """Raise NLSyntaxError at the last item read."""
        is_end = self.at >= len(self.data)
        raise NLSyntaxError(self.at, "the file ends within a segment" if is_end else what)


class TextFormReader(_Form):
    """The segments of a text file; blank lines at its end do not count, and comments begin with #.

    Attributes
    ----------
    at : int
        The place of the line that has been read last.
    """

    def letter(self) -> str:
        """Return the first letter of the next line, nothing at the end of the file."""
        line = self._line().lstrip(b" ")
        self._words = line[1:].split()
        return chr(line[0]) if line else ""

    def behind(self, form: str, *, has_name: bool = False) -> list[Any]:
        """Return the numbers behind the letter, whole ones (i, h) or not (d)."""
        return self._numbers(form, self._words[: len(self._words) - has_name])

    def row(self, form: str) -> list[Any]:
        """Return the numbers of the next line."""
        return self._numbers(form, self._line().split())

    def _line(self) -> bytes:
        self.at = self._next
        self._next = self.data.find(b"\n", self.at) + 1 or len(self.data)
        return self.data[self.at : self._next].split(b"#")[0]

    def _numbers(self, form: str, words: list[bytes]) -> list[Any]:
        try:
            return [read_number(word, CONVERTERS[k]) for k, word in zip(form, words, strict=True)]
        except ValueError:
            self.fail(NO_NUMBERS)


class BinaryFormReader(_Form):
    """The segments of a binary file, read as `TextFormReader` is."""

    def letter(self) -> str:
        """Return the next byte as a letter, nothing at the end of the file."""
        self.at = self._next
        self._next += 1
        return chr(self.data[self.at]) if self.at < len(self.data) else ""

    def behind(self, form: str, *, has_name: bool = False) -> list[Any]:
        """Return the numbers behind the letter, whole ones (i, h) or not (d)."""
        numbers = self._numbers(form)
        if has_name:
            self._take(self._numbers("i")[0])
        return numbers

    def row(self, form: str) -> list[Any]:
        """Return the next numbers."""
        self.at = self._next
        return self._numbers(form)

    def _numbers(self, form: str) -> list[Any]:
        layout = self.order + form
        return list(struct.unpack_from(layout, self.data, self._take(struct.calcsize(layout))))

    def _take(self, length: int) -> int:
        """Return the start of the next bytes, and move past them."""
        begin, left = self._next, len(self.data) - self._next
        if not 0 <= length <= left:
            raise NLSyntaxError(begin, f"{length} bytes are needed here, and {left} follow")
        self._next = begin + length
        return begin


NARY, PIECEWISE = (-1, -2)  # instead of a number of operands: that follows; a number of slopes does


def _by_number(text: str) -> dict[int, str]:
    """Return names by numbers."""
    pairs = (entry.strip().partition(" ") for entry in text.split(","))
    return {int(number): name for number, _, name in pairs}


#: AMPL's operators by how many operands they have.
OPERATOR_NAMES: dict[int, dict[int, str]] = {
    1: _by_number(
        "13 floor, 14 ceil, 15 abs, 16 unary -, 34 not, 37 tanh, 38 tan, 39 sqrt, 40 sinh, 41 sin, 42 log10, 43 log, "
        "44 exp, 45 cosh, 46 cos, 47 atanh, 49 atan, 50 asinh, 51 asin, 52 acosh, 53 acos, 77 square"
    ),
    2: _by_number(
        "0 +, 1 -, 2 *, 3 /, 4 mod, 5 ^, 6 less, 20 or, 21 and, 22 <, 23 <=, 24 =, 28 >=, 29 >, 30 <>, 48 atan2, "
        "55 div, 56 precision, 57 round, 58 trunc, 62 atleast, 63 atmost, 66 exactly, 67 not atleast, 68 not atmost, "
        "69 not exactly, 73 <==>, 76 ^, 78 ^"
    ),
    3: _by_number("35 if, 65 if, 72 ==>"),
    NARY: _by_number(
        "11 min, 12 max, 54 +, 59 count, 60 numberof, 61 numberof, 70 forall, 71 exists, 74 alldiff, 75 not alldiff"
    ),
    PIECEWISE: _by_number("64 piecewise-linear term"),
}
ARITY = {number: arity for arity, names in OPERATOR_NAMES.items() for number in names}
PARTNER = 5  # the kind of a complementarity row
MOST_OPTIONS = 9  # in the first line; as other readers of .nl take
WITH_TOLERANCE = 3  # as the second option: the first line ends with a tolerance
# the kinds of arithmetic that can be read; 0 is the writer's
LITTLE_ENDIAN, BIG_ENDIAN = (1, 2)


#: An expression in prefix order, an operator before its operands: n, v or o; the number, or the number of the variable
#: (from n on, of a defined variable) or of AMPL's operator; and how many operands follow.
Tree = list[tuple[str, float, int]]


def number_tree(value: float) -> Tree:
    """Return the expression that is a number."""
    return [("n", value, 0)]


def variables_in(trees: Iterable[Tree]) -> Indices:
    """Return the numbers of the variables in expressions, as often as they occur."""
    found = [value for tree in trees for kind, value, _ in tree if kind == "v"]
    return np.array(found, dtype=np.int64)


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
    trees : list of Tree
        The nonlinear terms of the rows; of a linear row a number.
    is_maximized : ndarray of bool, shape (o,)
        True for an objective that is maximized.
    objective_linear, objective_trees
        Terms of the objectives, stored like the rows.
    defined_linear : CSR array, shape (d, n + d)
        The linear terms of defined variables; each uses only variables defined before.
    defined_trees : list of Tree
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

    lower: Vector
    upper: Vector
    row_lower: Vector
    row_upper: Vector
    partners: Indices
    partner_bounds: Indices
    linear: sp.csr_array
    trees: list[Tree]
    is_maximized: NDArray[np.bool_]
    objective_linear: sp.csr_array
    objective_trees: list[Tree]
    defined_linear: sp.csr_array
    defined_trees: list[Tree]
    is_integer: NDArray[np.bool_]
    start: Vector
    has_start: NDArray[np.bool_]
    names: list[str] | None = None
    row_names: list[str] | None = None
    options: tuple[int, ...] = (3, 0, 1, 0)
    tolerance: float | None = None

    def variable(self, column: int) -> str:
        """Return the name of a variable, or its number; defined variables follow the last variable."""
        if column >= self.lower.size:
            return f"defined variable {column - self.lower.size}"
        return Names(unknowns=self.names).unknown(column, "variable {}")

    def row(self, row: int) -> str:
        """Return the name of a row, or its number."""
        return Names(self.row_names).row(row)

    def rows_of(self, part: Indices) -> Callable[[int], str]:
        """Return the function from a place in some rows to the name of the row."""
        return partial(_row_in, self.row_names, part)


def _row_in(names: Sequence[str] | None, part: Indices, k: int) -> str:
    return Names(names).row(int(part[k]))


ENDING = ".nl"
#: How many numbers follow the letter of a segment; a name follows in S.
HEADS = {letter: k for k, group in enumerate(("br", "CLkKxd", "OGJS", "VF")) for letter in group}
SKIPPED = {"k": "i", "K": "i", "d": "id", "S": "ii"}  # entries of columns, multipliers, suffixes
#: The numbers behind a letter in bytes: of a number, and of the kind of a bound.
NUMBER_FORMATS = {"n": "d", "l": "i", "s": "h"}
BOUND_FORMATS = {"0": "dd", "1": "d", "2": "d", "3": "", "4": "d", "5": "ii"}
NO_SEGMENT = f"no segment begins here; the letters are {' '.join(HEADS)}"
NO_PART = "a part of an expression is needed here"
HAVE_LOWER, HAVE_UPPER = (0, 2, 4), (0, 1, 4)  # kinds of bounds
LINES = 10  # of the head, which are text in binary files too
#: Lines of the head after the first: how many numbers are required, and their names; a star marks a number of items
#: in the file, each of at least a byte.
HEAD = """\
3 variables* rows* objectives* ranges equations logical_rows*
2 nonlinear_rows nonlinear_objectives linear_pairs nonlinear_pairs _ _
2 _ _
2 in_rows in_objectives in_both
2 _ functions* arithmetic _
2 binaries integers integers_in_both integers_in_rows integers_in_objectives
2 nonzeros* objective_nonzeros*
2 row_name_length name_length
5 defined0* defined1* defined2* defined3* defined4*"""


def source_of(path: str | PathLike[str]) -> Path:
    """Return the file; its ending may be left out, as AMPL does."""
    source = checked_path(path)
    if source.suffix.lower() == ENDING or not source.name:
        return source
    with_ending = source.with_name(source.name + ENDING)
    return source if source.is_file() and not with_ending.is_file() else with_ending


def read_content(path: str | PathLike[str]) -> NLContent:
    """Return the content of an ``.nl`` file, with the names in its ``.col`` and ``.row`` files.

    Parameters
    ----------
    path : str or Path
        The file; its ending may be left out, as AMPL does. Bounds of size 1e20 and above are infinite.

    Raises
    ------
    UnreadableFile
        If it is missing, corrupt or contradicts itself; the message names the line, in a binary file the byte.
    UnsupportedModel
        If it has logical constraints or calls external functions.
    """
    source = source_of(path)
    with opened(source, ".nl file") as file:
        data = file.read()
    try:
        reader = _Reader(data)
        reader.read_segments()
        return reader.content(source)
    except NLSyntaxError as fault:
        raise UnreadableFile(
            f"cannot read {source}, {_place(data, fault)}: {fault}; the file is damaged, or no .nl file: write it again"
        ) from fault


def _place(data: bytes, fault: NLSyntaxError) -> str:
    """Return the position of a fault: the line and its text, or the byte."""
    begin = fault.place
    line = data.count(b"\n", 0, begin) + 1
    if data[:1] == b"b" and line > LINES:
        return f"byte {begin}"
    text = data[begin : begin + 40].split(b"\n")[0].decode("ascii", errors="replace")
    return f"line {line} ({text!r})"


# --- The head --------------------------------------------------------------------------------------------------------


def _header(data: bytes) -> tuple[SimpleNamespace, int]:
    """Return the numbers of the head by name, and the start of the segments."""
    if data[:1] not in (b"g", b"b"):
        raise NLSyntaxError(0, "an .nl file begins with g (text) or b (binary)")
    lines, begin = [b""], 0
    header = SimpleNamespace(is_binary=data[:1] == b"b", places=[0])  # of its lines, from 1 on
    for _ in range(LINES):
        end = data.find(b"\n", begin, begin + 4096)
        if end < 0:
            raise NLSyntaxError(begin, f"an .nl file begins with {LINES} short lines of numbers")
        lines.append(data[begin:end])
        header.places.append(begin)
        begin = end + 1
    header.options, header.tolerance = _options(lines[1][1:])
    for number, names in enumerate(HEAD.splitlines(), start=2):
        _read_head_line(header, number, names, lines[number], len(data) - begin)
    if header.is_binary and header.arithmetic not in (0, LITTLE_ENDIAN, BIG_ENDIAN):
        what = f"its numbers are of the arithmetic {header.arithmetic}, and 1 or 2 (IEEE) is needed"
        raise NLSyntaxError(header.places[6], f"{what}; write the file as text")
    if header.logical_rows:
        raise UnsupportedModel(f"{header.logical_rows} logical constraints are not read; drop them")
    header.defined = sum(getattr(header, f"defined{k}") for k in range(5))
    return header, begin


def _options(text: bytes) -> tuple[tuple[int, ...], float | None]:
    """Return the numbers of the first line, which begins with their count, and the tolerance."""
    words = text.split(b"#")[0].split()
    try:
        count = read_number(words[0], int) if words else 0
        options = [read_number(word, int) for word in words[1 : max(count, 0) + 1]]
        has_tolerance = count >= 2 and options[1:2] == [WITH_TOLERANCE] and len(words) > count + 1
        tolerance = read_number(words[count + 1]) if has_tolerance else None
    except ValueError:
        count = -1
    if not 0 <= count <= MOST_OPTIONS:
        what = f"its letter is followed by up to {MOST_OPTIONS} integers, and how many"
        raise NLSyntaxError(0, what)
    return (count, *options, *[0] * (count - len(options))), tolerance


def _read_head_line(header: SimpleNamespace, k: int, names: str, line: bytes, length: int) -> None:
    """Take in the numbers of a line, zeros for those that may be missing; so many bytes follow the head."""
    needed, *called = names.split()
    words = line.split(b"#")[0].split()[: len(called)]
    is_whole = b"".join(words).isdigit() and max(map(len, words)) <= 18
    if len(words) < int(needed) or not is_whole:
        what = f"{needed} integers or more are needed: {' '.join(called)}"
        raise NLSyntaxError(header.places[k], what)
    numbers = [int(word) for word in words] + [0] * (len(called) - len(words))
    for name, value in zip(called, numbers, strict=True):
        if name[-1] == "*" and value > length:  # before anything is allocated
            what = f"{value} {name[:-1]} are announced, and {length} bytes follow"
            raise NLSyntaxError(header.places[k], what)
        setattr(header, name.rstrip("*"), value)


# --- The segments ----------------------------------------------------------------------------------------------------


class _Reader:
    """Items read from a file so far.

    It is one class because all methods move one position through one file.
    """

    def __init__(self, data: bytes) -> None:
        self.header, begin = _header(data)
        order = ">" if self.header.arithmetic == BIG_ENDIAN else "<"
        self.source: TextFormReader | BinaryFormReader
        if self.header.is_binary:
            self.source = BinaryFormReader(data, begin, order)
        else:
            self.source = TextFormReader(data.rstrip() + b"\n", begin)
        #: Number of possible owners of a segment.
        self.owners = dict.fromkeys("CJ", self.header.rows) | {"V": self.header.defined}
        self.owners |= dict.fromkeys("OG", self.header.objectives)
        self.trees: dict[str, dict[int, Tree]] = {letter: {} for letter in "COV"}
        # Row, index and value of each linear term.
        self.entries = {letter: (array("q"), array("q"), array("d")) for letter in "JGVx"}
        self.bounds: dict[str, list[tuple[float, float, int, int]]] = {"b": [], "r": []}
        self.is_maximized: dict[int, bool] = {}

    def read_segments(self) -> None:
        """Read all segments, in any order."""
        header, source, n = self.header, self.source, self.header.variables
        while letter := source.letter():
            if letter not in HEADS:
                source.fail(NO_SEGMENT)
            if letter == "F":
                raise UnsupportedModel("the model calls external functions; write elementary ones")
            numbers = source.behind("i" * HEADS[letter], has_name=letter == "S")
            owner = 0
            if letter in self.owners:
                owner = numbers[0] - (n if letter == "V" else 0)
                self._require_below(owner, self.owners[letter], f"the owner of a segment {letter}")
            reach = n + owner if letter == "V" else n
            if letter in "JGVx":
                self._read_pairs(letter, owner, numbers[letter != "x"], reach)
            if letter == "O":
                if numbers[1] not in (0, 1):
                    source.fail("the sense of an objective is 0 or 1")
                self.is_maximized[owner] = numbers[1] == 1
            if letter in self.trees:
                self._read_tree(letter, owner, reach if letter == "V" else n + header.defined)
            if letter in self.bounds:
                self._read_bounds(letter)
            if letter in SKIPPED:
                # Values of an S segment are real by a bit of its first number, and always in text
                is_real = letter == "S" and (numbers[0] & 4 or not header.is_binary)
                for _ in range(numbers[-1]):
                    source.row("id" if is_real else SKIPPED[letter])

    def _require_below(self, index: int, count: int, what: str) -> None:
        if not 0 <= index < count:
            self.source.fail(f"{what} must be one of {count}, and this is number {index} from 0")

    def _read_tree(self, letter: str, owner: int, variables: int) -> None:
        """Read an expression over that many variables."""
        tree, missing = Tree(), 1
        while missing:
            tree.append(token := self._token(variables))
            missing += token[-1] - 1
        self.trees[letter][owner] = tree

    def _token(self, variables: int) -> tuple[str, float, int]:
        """Return the next part of an expression: its kind, its value and how many operands follow."""
        source, letter = self.source, self.source.letter()
        if letter in NUMBER_FORMATS:
            value = float(source.behind(NUMBER_FORMATS[letter])[0])
            if not math.isfinite(value):
                source.fail("a number is not finite")
            return "n", value, 0
        if letter not in ("v", "o"):
            source.fail(NO_PART if letter in HEADS else NO_NUMBERS)
        (number,) = source.behind("i")
        if letter == "v":
            self._require_below(number, variables, "a variable that is allowed here")
            return letter, number, 0
        if number not in ARITY:
            source.fail("this operator number is unknown")
        count = ARITY[number]
        if count in (NARY, PIECEWISE):
            (operands,) = source.row("i")
            factor = 1 if count == NARY else 2
            if not factor <= operands <= len(self.source.data):
                self.source.fail(f"an operator cannot have {operands} operands here")
            count = factor * operands
        return letter, number, count

    def _read_pairs(self, letter: str, owner: int, count: int, reach: int) -> None:
        """Read `count` indices below `reach` with their values."""
        source, (rows, indices, values) = self.source, self.entries[letter]
        if count < 0:
            source.fail(NO_NUMBERS)
        for _ in range(count):
            index, value = source.row("id")
            self._require_below(index, reach, "an index")
            if not math.isfinite(value):
                source.fail("the value of an index must be finite")
            rows.append(owner)
            indices.append(index)
            values.append(value)

    def _read_bounds(self, letter: str) -> None:
        """Read lower and upper bound, partner and its finite bounds of each variable or row."""
        header, partners = self.header, set[int]()
        for _ in range(header.variables if letter == "b" else header.rows):
            letter_of_kind = self.source.letter()
            if letter_of_kind not in BOUND_FORMATS:
                self.source.fail(f"a bound's kind is 0 to {PARTNER}")
            kind, numbers = int(letter_of_kind), self.source.behind(BOUND_FORMATS[letter_of_kind])
            if kind == PARTNER:
                finite, variable = numbers
                self._check_partner(letter, finite, variable, partners)
                self.bounds[letter].append((-math.inf, math.inf, variable - 1, finite))
                continue
            if any(map(math.isnan, numbers)):
                self.source.fail("a bound is not a number")
            low = numbers[0] if kind in HAVE_LOWER else -math.inf
            high = numbers[-1] if kind in HAVE_UPPER else math.inf
            if kind != 4:  # a bound of kind 4 may be 1e20
                low = -math.inf if low <= -INFINITE_LIMIT else low
                high = math.inf if high >= INFINITE_LIMIT else high
            self.bounds[letter].append((low, high, -1, 0))

    def _check_partner(self, letter: str, finite: int, variable: int, earlier: set[int]) -> None:
        """Raise if a row cannot be complementary to a variable, numbered from 1 here."""
        source, n = self.source, self.header.variables
        if letter == "b" or not 0 <= finite < 4 or not 1 <= variable <= n:
            what = f"which bounds are finite (0 to 3), and a variable from 1 to {n}"
            source.fail(f"the bounds of rows have the code 5, followed by {what}")
        if variable in earlier:
            source.fail(
                f"variable {variable} is complementary to an earlier row also; one is possible"
            )
        earlier.add(variable)

    # --- Consistency of all segments ---

    def content(self, path: Path) -> NLContent:
        """Return the content."""
        header = self.header
        self._check_counts()
        n, m, o, d = header.variables, header.rows, header.objectives, header.defined
        lower, upper, _, _ = _columns(self.bounds["b"])
        low, high, partners, bits = _columns(self.bounds["r"])
        bounds = lower, upper, low, high, partners.astype(np.int64), bits.astype(np.int64)
        rows = *bounds, self._matrix("J", m, n), self._trees("C", m)
        is_maximized = np.array([self.is_maximized[k] for k in range(o)], dtype=bool)
        goals = is_maximized, self._matrix("G", o, n), self._trees("O", o)
        terms = *goals, self._matrix("V", d, n + d), self._trees("V", d)
        start, has_start = np.zeros(n), np.zeros(n, dtype=bool)
        _, indices, values = self.entries["x"]
        start[indices], has_start[indices] = values, True
        variables = self._integers(), start, has_start
        names = _names(path.with_suffix(".col"), n, header.name_length)
        row_names = _names(path.with_suffix(".row"), m, header.row_name_length)
        first_line = header.options, header.tolerance
        return NLContent(*rows, *terms, *variables, names, row_names, *first_line)

    def _check_counts(self) -> None:
        """Raise if the head announces more than the file holds, before memory is allocated."""
        header, bounds, trees = self.header, self.bounds, self.trees
        pairs = header.linear_pairs + header.nonlinear_pairs
        slopes, announced_slopes = len(self.entries["G"][2]), header.objective_nonzeros
        if 0 < slopes < announced_slopes:  # AMPL counts entries that simplifications removed later
            announced_slopes = slopes
        for line, announced, count, what in (
            (2, header.variables, len(bounds["b"]), "bounds of variables"),
            (2, header.rows, len(bounds["r"]), "bounds of rows"),
            (2, header.objectives, len(trees["O"]), "objectives"),
            (3, pairs, sum(row[2] >= 0 for row in bounds["r"]), "complementarity rows"),
            (8, header.nonzeros, len(self.entries["J"][2]), "nonzeros of the segments J"),
            (8, announced_slopes, slopes, "nonzeros of the segments G"),
            (10, header.defined, len(trees["V"]), "defined variables"),
        ):
            if announced != count:
                fault = f"{announced} {what} are announced, {count} are there"
                raise NLSyntaxError(header.places[line], fault)

    def _matrix(self, letter: str, height: int, width: int) -> sp.csr_array:
        """Return linear terms as a CSR array; raise if a row has an index twice."""
        *places, values = self.entries[letter]
        kind = np.int32 if max(len(values), width) < 2**31 else np.int64
        rows, indices = (np.array(numbers, dtype=kind) for numbers in places)
        matrix = sp.coo_array((np.array(values), (rows, indices)), shape=(height, width)).tocsr()
        if matrix.nnz < len(values):
            what = f"an index occurs twice in a row in the segments {letter}"
            raise NLSyntaxError(self.header.places[8], what)
        matrix.sort_indices()
        return matrix

    def _trees(self, letter: str, count: int) -> list[Tree]:
        """Return the expression of each owner in order; the number 0 for an owner without one."""
        return [self.trees[letter].get(k) or number_tree(0.0) for k in range(count)]

    def _integers(self) -> Any:
        """Return the mask of integer variables, the last ones of each group of the format."""
        header, n = self.header, self.header.variables
        is_integer = np.zeros(n, dtype=bool)
        for end, count in (
            (n, header.binaries + header.integers),
            (header.in_both, header.integers_in_both),
            (header.in_rows, header.integers_in_rows),
            (max(header.in_rows, header.in_objectives), header.integers_in_objectives),
        ):
            if count > end or end > n:
                what = f"{count} integer variables are announced where there are {min(end, n)}"
                raise NLSyntaxError(header.places[7], what)
            is_integer[end - count : end] = True
        return is_integer


def _columns(rows: list[tuple[float, float, int, int]]) -> Any:
    return np.array(rows, dtype=np.float64).reshape(-1, 4).T.copy()


def _names(path: Path, count: int, longest: int) -> list[str] | None:
    """Return the names in an accompanying file, or None if it belongs to another problem."""
    try:
        names = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    # a length of 0 means that no names were written
    return names[:count] if longest and len(names) >= count else None
