"""Reading ``.nl`` files: the segments of either form, each checked as it is read, become an `NLContent`."""

from __future__ import annotations

import math
from array import array
from os import PathLike
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.errors import UnreadableFile
from ..files.files import INFINITE_BOUND, checked_path
from ..files.matrix_market import opened
from .content import (
    ARITY,
    NARY,
    NO_OPERATOR,
    PARTNER,
    PIECEWISE,
    SUFFIX_IS_REAL,
    SUFFIX_KIND,
    Fault,
    Header,
    HeadFault,
    NLContent,
    Suffix,
    Token,
    Trees,
    fail,
    read_header,
)
from .sources import HEADS, Binary, Text, source_in

ENDING = ".nl"
SHOWN = 40  # bytes of a line that a message quotes
ARITIES = ARITY.tolist()
HAS_LOWER, HAS_UPPER, IS_AS_STATED = (0, 2, 4), (0, 1, 4), 4  # kinds of bounds; of the last 1e20 is a number


def source_of(path: str | PathLike[str]) -> Path:
    """Return the file; its ending may be left out, as AMPL does."""
    source = checked_path(path)
    if source.suffix.lower() == ENDING or not source.name:
        return source
    with_ending = source.with_name(source.name + ENDING)
    return source if source.is_file() and not with_ending.is_file() else with_ending


def read_content(path: str | PathLike[str]) -> NLContent:
    """Return what an ``.nl`` file says, text or binary, with the names in ``.col`` and ``.row`` files beside it.

    Parameters
    ----------
    path : str or Path
        The file; its ending may be left out, as AMPL does. Bounds of 1e20 and beyond are no bounds.

    Raises
    ------
    UnreadableFile
        Where it is missing, damaged or contradicts itself; the message names the line, in a binary file the byte.
    """
    source = source_of(path)
    with opened(source, ".nl file") as file:
        data = file.read()
    try:
        header, begin = read_header(data)
        return _Reader(header, source_in(data, begin, header)).content(source)
    except Fault as fault:
        raise UnreadableFile(
            f"cannot read {source}, {_place(data, fault)}: {fault}; the file is damaged, or no .nl file: write it again"
        ) from fault


def _place(data: bytes, fault: Fault) -> str:
    """Return where a fault is: the line and what it says, or the byte."""
    if data[:1] == b"b" and not isinstance(fault, HeadFault):
        return f"byte {fault.place}"
    begin = 0
    for _ in range(fault.place - 1):
        begin = data.find(b"\n", begin) + 1 or len(data)
    text = data[begin:begin + SHOWN].split(b"\n")[0].decode("ascii", errors="replace")
    return f"line {fault.place} ({text!r})"


class _Forest:
    """Expression trees of one letter in the order of the file; the arrays of parts are those of `content.Trees`."""

    def __init__(self) -> None:
        self.owners, self.starts, self.counts = array("q"), array("q", [0]), array("q")
        self.kinds, self.values = array("B"), array("d")


class _Reader:
    """What has been read of a file."""

    def __init__(self, header: Header, source: Text | Binary) -> None:
        self.header, self.source = header, source
        n, m, d = header.variables, header.rows, header.defined
        self.owners = {  # the numbers that segments of a letter may have
            "C": range(m), "J": range(m), "O": range(header.objectives), "G": range(header.objectives),
            "L": range(header.logical_rows), "V": range(n, n + d), "F": range(header.functions),
        }
        self.lengths = {"b": n, "r": m, "x": n, "d": m, "k": max(n - 1, 0)}
        self.done = {letter: bytearray(len(self.owners.get(letter, "1"))) for letter in HEADS}
        self.entries = {letter: (array("q"), array("q"), array("d")) for letter in "JGV"}  # rows, columns, values
        self.forests = {letter: _Forest() for letter in "COVL"}
        self.bounds: dict[str, tuple[Any, Any]] = {}
        self.partners = array("q"), array("q"), array("q")  # rows, variables, which bounds are finite
        self.has_row = bytearray(n)
        self.starts: dict[str, tuple[list[int], list[float]]] = {"x": ([], []), "d": ([], [])}
        self.maximized: list[int] = []
        self.functions: dict[int, str] = {}
        self.suffixes: list[Suffix] = []
        self.column_counts: tuple[int, Any] | None = None

    def content(self, path: Path) -> NLContent:
        """Read all segments and return the content."""
        source = self.source
        try:
            while source.at < source.end:
                self._segment(*source.head())
        except Fault:
            raise
        except ValueError as error:
            what = "this is neither a number nor a letter of the format, or there are not as many as are needed"
            raise Fault(source.place, what) from error
        header, n, m, d = self.header, self.header.variables, self.header.rows, self.header.defined
        self._check_announced()
        linear = self._matrix("J", m, n, 0, header.nonzeros)
        self._check_column_counts(linear)
        partners, partner_bounds = np.full(m, -1, dtype=np.int64), np.zeros(m, dtype=np.int64)
        rows, variables, finite = self.partners
        partners[rows], partner_bounds[rows] = variables, finite
        is_maximized = np.zeros(header.objectives, dtype=bool)
        is_maximized[self.maximized] = True
        (lower, upper), (row_lower, row_upper) = (map(np.array, self.bounds[letter]) for letter in "br")
        start, has_start = self._start("x")
        return NLContent(
            lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper, partners=partners,
            partner_bounds=partner_bounds, linear=linear, trees=self._trees("C", m, 0), is_maximized=is_maximized,
            objective_linear=self._matrix("G", header.objectives, n, 0, header.objective_nonzeros),
            objective_trees=self._trees("O", header.objectives, 0),
            defined_linear=self._matrix("V", d, n + d, n, None), defined_trees=self._trees("V", d, n),
            is_integer=self._integers(), logical_rows=header.logical_rows,
            functions=tuple(self.functions[k] for k in range(header.functions)), start=start,
            dual_start=self._start("d")[0], has_start=has_start, suffixes=self.suffixes,
            names=_names(path.with_suffix(".col"), n, header.name_lengths[1]),
            row_names=_names(path.with_suffix(".row"), m, header.name_lengths[0]),
            options=header.options, tolerance=header.tolerance,
        )

    # --- Segments ------------------------------------------------------------------------------------------------

    def _segment(self, letter: str, numbers: list[int], name: bytes) -> None:
        number = numbers[0] if letter in self.owners else 0
        owners = self.owners.get(letter, range(1))
        if number not in owners:
            self._fail(f"a segment {letter} has a number from {owners[0]} to {owners[-1]}" if owners else
                       f"the head announces nothing that a segment {letter} could belong to")
        if letter != "S":
            done = self.done["k" if letter == "K" else letter]
            if done[number - owners[0]]:
                self._fail(f"a second segment {letter}{number if letter in self.owners else ''}; a file has one")
            done[number - owners[0]] = True
        if letter in "JGV":
            self._linear(letter, number, numbers[1])
        if letter in "COVL":
            if letter == "O" and self._checked(numbers[1], 1, "the sense of an objective"):
                self.maximized.append(number)
            self._tree(letter, number)
        elif letter in "br":
            self._bounds(letter)
        elif letter in "xd":
            self.starts[letter] = self._pairs(numbers[0], self.lengths[letter])
        elif letter in "kK":
            self._column_counts(max(numbers[0], 0), letter == "k")  # −1 without variables
        elif letter == "F":
            self.functions[number] = name.decode(errors="replace") or "?"
        elif letter == "S":
            self._suffix(numbers[0], numbers[1], name)

    def _fail(self, what: str) -> NoReturn:
        fail(self.source.place, what)

    def _checked(self, value: int, most: int, what: str) -> int:
        """Return a number from 0 to `most`, or fail."""
        if not 0 <= value <= most:
            self._fail(f"{what} is {value}, and only 0 to {most} is possible here")
        return value

    def _room(self, count: int, what: str) -> int:
        return self._checked(count, self.source.end - self.source.at, f"the number of {what}")

    def _pairs(
        self, count: int, width: int, *, is_real: bool = True, is_suffix: bool = False
    ) -> tuple[list[int], list[float]]:
        """Return as many indices below `width` and values; whatever a suffix says is let pass."""
        self._room(count, "pairs of an index and a value")
        indices, values, places = self.source.pairs(count, is_real)
        if not count:
            return indices, values
        if not 0 <= min(indices) <= max(indices) < width:
            k = next(k for k, index in enumerate(indices) if not 0 <= index < width)
            fail(places[k], f"the index {indices[k]} lies outside 0 … {width - 1}")
        if not (is_suffix or all(map(math.isfinite, values))):
            k = next(k for k, value in enumerate(values) if not math.isfinite(value))
            fail(places[k], f"the value {values[k]} is not finite")
        if not is_suffix and len(set(indices)) < count:
            k = next(k for k, index in enumerate(indices) if index in indices[:k])
            fail(places[k], f"a second entry of variable {indices[k]} in one segment")
        return indices, values

    def _linear(self, letter: str, owner: int, count: int) -> None:
        """Read the linear terms of a row, or of a defined variable, which uses those before it."""
        own = self._pairs(count, owner if letter == "V" else self.header.variables)
        rows, columns, values = self.entries[letter]
        rows.extend([owner] * count)
        columns.extend(own[0])
        values.extend(own[1])

    def _tree(self, letter: str, owner: int) -> None:
        """Read parts until every operand has come."""
        forest, header, part = self.forests[letter], self.header, self.source.part
        variables = owner if letter == "V" else header.variables + header.defined
        add_kind, add_value, add_count = forest.kinds.append, forest.values.append, forest.counts.append
        wanted = 1
        while wanted:
            kind, value, count = part()
            if kind is Token.OPERATOR:
                count = self._operands(int(value))
            elif kind is Token.NUMBER:
                if not math.isfinite(value):
                    self._fail("a number is not finite")
            elif kind is Token.VARIABLE:
                if not 0 <= value < variables:
                    self._fail(f"there are {variables} variables that may stand here, numbered from 0")
            elif kind is Token.CALL:
                self._room(count, "operands")
                if not 0 <= value < header.functions:
                    self._fail(f"there are {header.functions} functions here, numbered from 0")
            add_kind(kind)
            add_value(value)
            add_count(count)
            wanted += count - 1
        forest.owners.append(owner)
        forest.starts.append(len(forest.kinds))

    def _operands(self, operator: int) -> int:
        """Return how many operands an operator has; behind some of them stands a number that tells."""
        arity = ARITIES[operator] if 0 <= operator < len(ARITIES) else NO_OPERATOR
        if arity == NO_OPERATOR:
            self._fail("there is no operator of this number")
        if arity not in (NARY, PIECEWISE):
            return int(arity)
        count = self._room(self.source.integer(), "operands")
        if count < 1 + (arity == PIECEWISE):
            self._fail("an operator needs more operands")
        return 2 * count if arity == PIECEWISE else count

    def _bounds(self, letter: str) -> None:
        lower, upper = array("d"), array("d")
        for row in range(self.lengths[letter]):
            kind, numbers = self.source.bound()
            if any(map(math.isnan, numbers)):
                self._fail("a bound is not a number")
            if kind == PARTNER:
                self._partner(letter, row, *numbers)
            low = numbers[0] if kind in HAS_LOWER else -math.inf
            high = numbers[-1] if kind in HAS_UPPER else math.inf
            is_open = kind != IS_AS_STATED
            lower.append(-math.inf if is_open and low <= -INFINITE_BOUND else low)
            upper.append(math.inf if is_open and high >= INFINITE_BOUND else high)
        self.bounds[letter] = lower, upper

    def _partner(self, letter: str, row: int, finite: float, variable: float) -> None:
        """Take a complementarity row: which bounds of its variable are finite, and the variable, numbered from 1."""
        if letter == "b":
            self._fail("a bound of kind 5 belongs to a row, not to a variable")
        if not (0 <= finite <= 3 and finite == int(finite)):
            self._fail("behind 5 stands which bounds are finite: 0 to 3")
        if not (1 <= variable <= self.header.variables and variable == int(variable)):
            self._fail(f"a row is complementary to a variable from 1 to {self.header.variables}")
        if self.has_row[int(variable) - 1]:
            self._fail(f"variable {variable:g} is complementary to an earlier row as well; one row is possible")
        self.has_row[int(variable) - 1] = True
        for part, value in zip(self.partners, (row, int(variable) - 1, int(finite)), strict=True):
            part.append(value)

    def _column_counts(self, count: int, is_cumulative: bool) -> None:
        place = self.source.place
        if count != self.lengths["k"]:
            self._fail(f"{count} counts of columns are given, and {self.lengths['k']} are needed")
        counts = np.array([self.source.integer() for _ in range(count)], dtype=object)
        self.column_counts = place, np.diff(counts, prepend=0) if is_cumulative else counts

    def _suffix(self, bits: int, count: int, name: bytes) -> None:
        header = self.header
        kind = self._checked(bits, 2 * SUFFIX_IS_REAL - 1, "the kind of a suffix") & SUFFIX_KIND
        width = (header.variables, header.rows + header.logical_rows, header.objectives, 1)[kind]
        is_real = bool(bits & SUFFIX_IS_REAL)
        indices, numbers = self._pairs(count, width, is_real=is_real, is_suffix=True)
        values: Any = np.array(numbers, dtype=np.float64)
        if not is_real and (np.abs(values) < 2.0**53).all() and (values == np.floor(values)).all():
            values = values.astype(np.int64)
        self.suffixes.append(Suffix(name.decode(errors="replace"), kind, np.array(indices, dtype=np.int64), values))

    # --- What the segments say together --------------------------------------------------------------------------

    def _check_announced(self) -> None:
        """Raise where the head announces what is not there, before anything of that size is allocated."""
        header = self.header
        for letter, needed in (("b", header.variables), ("r", header.rows)):
            if letter not in self.bounds:
                if needed:
                    raise HeadFault(2, f"the segment {letter} is missing: {needed} bounds are needed")
                self.bounds[letter] = [], []
        given = {letter: len(forest.owners) for letter, forest in self.forests.items()}
        for line, announced, what, count in (
            (2, header.objectives, "objectives", given["O"]),
            (3, header.complementarities, "complementarity rows", len(self.partners[0])),
            (6, header.functions, "functions", len(self.functions)),
            (10, header.defined, "defined variables", given["V"]),
            (2, header.logical_rows if given["L"] else 0, "logical constraints", given["L"]),
        ):
            if announced != count:
                raise HeadFault(line, f"{announced} {what} are announced, {count} are there")

    def _matrix(self, letter: str, count: int, width: int, first: int, nonzeros: int | None) -> sp.csr_array:
        """Return the linear terms of segments, one row for each owner."""
        rows, columns, values = self.entries[letter]
        given = len(values)
        # AMPL counts for G what its simplifications removed later, too.
        if nonzeros is not None and (given > nonzeros or (given < nonzeros and (letter == "J" or not given))):
            raise HeadFault(8, f"{nonzeros} nonzeros are announced for the segments {letter}, {given} are there")
        kind = np.int32 if max(given, count, width) < 2**31 else np.int64
        places = np.array([rows, columns]).astype(kind) - np.array([[first], [0]], dtype=kind)
        matrix = sp.csr_array((np.array(values), places), shape=(count, width))
        matrix.sort_indices()
        return matrix

    def _check_column_counts(self, linear: sp.csr_array) -> None:
        """Raise where the segment k contradicts the segments J."""
        if self.column_counts is None:
            return
        place, given = self.column_counts
        counts = np.bincount(linear.indices, minlength=max(self.header.variables, 1))[:given.size]
        wrong = np.flatnonzero(given != counts)
        if wrong.size:
            j = wrong[0]
            fail(place, f"the segment says that variable {j} is in {given[j]} rows, and the segments J have it in "
                 f"{counts[j]}")

    def _trees(self, letter: str, count: int, first: int) -> Trees:
        """Return one tree for each owner in their order; the number 0 where there is none."""
        forest, strings = self.forests[letter], tuple(self.source.strings)
        owners, begins = np.array(forest.owners, dtype=np.int64) - first, np.array(forest.starts, dtype=np.int64)
        lengths = np.ones(count, dtype=np.int64)
        lengths[owners] = np.diff(begins)
        starts = np.concatenate([[0], np.cumsum(lengths)])
        targets = np.repeat(starts[owners] - begins[:-1], np.diff(begins)) + np.arange(begins[-1])
        kinds, values, counts = (np.zeros(starts[-1], dtype=kind) for kind in (np.uint8, np.float64, np.int64))
        kinds[targets], values[targets], counts[targets] = forest.kinds, forest.values, forest.counts
        return Trees(kinds, values, counts, starts, strings)

    def _integers(self) -> Any:
        """Return which variables are integer: the last ones of each group in the order of the format."""
        n, (in_rows, in_objectives, in_both) = self.header.variables, self.header.nonlinear
        binary, integer, both, rows, objectives = self.header.integers
        is_integer = np.zeros(n, dtype=bool)
        for end, count in ((n, binary + integer), (in_both, both), (in_rows, rows),
                           (max(in_rows, in_objectives), objectives)):
            if count > end or end > n:
                raise HeadFault(7, f"{count} integer variables are announced where there are {min(end, n)}")
            is_integer[end - count:end] = True
        return is_integer

    def _start(self, letter: str) -> tuple[FloatVector, Any]:
        """Return the values of a segment x or d, and where there are some."""
        indices, values = self.starts[letter]
        start, has_start = np.zeros(self.lengths[letter]), np.zeros(self.lengths[letter], dtype=bool)
        start[indices], has_start[indices] = values, True
        return start, has_start


def _names(path: Path, count: int, longest: int) -> list[str] | None:
    """Return the names in a file beside this one, or None where it is not of this problem."""
    if not longest or not path.is_file():  # a length of 0 says that none were written
        return None
    try:
        names = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    return names[:count] if len(names) >= count else None
