"""Reading ``.nl`` files: the segments of either form, those of one letter at once, become an `NLContent`."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.errors import UnreadableFile
from ..files.files import INFINITE_BOUND, checked_path
from ..files.matrix_market import opened
from .content import (
    ARITY,
    LINES,
    NARY,
    NO_OPERATOR,
    PARTNER,
    PIECEWISE,
    SUFFIX_IS_REAL,
    SUFFIX_KIND,
    Fault,
    Header,
    HeadFault,
    Indices,
    NLContent,
    Suffix,
    Token,
    Trees,
    read_header,
)
from .sources import ALONE, NO_NUMBERS, NO_SEGMENT, WORDS, WRONG_KIND, Items, Segments, is_whole, items_of, runs_of

ENDING = ".nl"
SHOWN = 40  # bytes of a line that a message quotes
NUMBER, VARIABLE, OPERATOR, CALL, STRING = map(int, Token)
NO_PART = "a part of an expression is needed here"
WRONG_PART = {  # of a kind, with how many there are
    NUMBER: "a number is not finite", VARIABLE: "there are {:g} variables that may stand here, numbered from 0",
    OPERATOR: "there is no operator of this number", CALL: "there are {:g} functions here, numbered from 0",
}
KINDS = np.zeros(256, dtype=np.uint8)
KINDS[list(b"nlsvofh")] = [NUMBER, NUMBER, NUMBER, VARIABLE, OPERATOR, CALL, STRING]
#: Of bounds by their kinds: how many numbers there are, and which.
BOUND_NUMBERS, HAS_LOWER, HAS_UPPER = np.array([[2, 1, 1, 0, 1, 2], [1, 0, 1, 0, 1, 0], [1, 1, 0, 0, 1, 0]])
IS_AS_STATED = 4  # a bound of this kind may be 1e20


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
        with np.errstate(invalid="ignore"):  # of a signalling NaN, which is refused
            return _Reader(header, items_of(data, begin, header)).content(source)
    except Fault as fault:
        raise UnreadableFile(
            f"cannot read {source}, {_place(data, fault)}: {fault}; the file is damaged, or no .nl file: write it again"
        ) from fault


def _place(data: bytes, fault: Fault) -> str:
    """Return where a fault is: the line and what it says, or the byte."""
    line, begin = fault.place, fault.place
    if isinstance(fault, HeadFault):
        begin = sum(len(one) + 1 for one in data.split(b"\n", LINES)[:line - 1])
    elif data[:1] == b"b":
        return f"byte {begin}"
    else:
        line = data.count(b"\n", 0, begin) + 1
    text = data[begin:begin + SHOWN].split(b"\n")[0].decode("ascii", errors="replace")
    return f"line {line} ({text!r})"


class _Reader:
    """The segments of a file, checked, and the arrays they become."""

    def __init__(self, header: Header, items: Items) -> None:
        self.header, self.items = header, items

    def content(self, path: Path) -> NLContent:
        """Return the content."""
        header, n, m, d = self.header, self.header.variables, self.header.rows, self.header.defined
        self._check_announced()
        _, lower, upper, _ = self._bounds("b", n)
        row_lower, row_upper, partners, partner_bounds = self._row_bounds()
        find = self.items.segments
        rows, objectives, defined = find("C", m), find("O", header.objectives), find("V", d, n)
        linear, _ = self._matrix(find("J", m), m, n, header.nonzeros)
        self._check_column_counts(linear)
        gradients = find("G", header.objectives)
        objective_linear, _ = self._matrix(gradients, header.objectives, n, header.objective_nonzeros)
        defined_linear, behind = self._matrix(defined, d, n + d, None)
        logical = find("L", header.logical_rows)
        self._trees(logical, logical.heads + 1, logical.heads.size)  # checked, not kept
        senses = objectives.numbers[1]
        self.items.require(is_whole(senses, 2), objectives.heads, "the sense of an objective is 0 or 1")
        functions = find("F", header.functions)
        self.items.alone(functions, 0)
        named = functions.heads[np.argsort(functions.owners)].tolist()
        start, has_start = self._start("x", n)
        return NLContent(
            lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper, partners=partners,
            partner_bounds=partner_bounds, linear=linear, trees=self._trees(rows, rows.heads + 1, m),
            is_maximized=senses[np.argsort(objectives.owners)] > 0, objective_linear=objective_linear,
            objective_trees=self._trees(objectives, objectives.heads + 1, header.objectives),
            defined_linear=defined_linear, defined_trees=self._trees(defined, behind, d),
            is_integer=self._integers(), logical_rows=header.logical_rows,
            functions=tuple(self._name(head) or "?" for head in named), start=start,
            dual_start=self._start("d", m)[0], has_start=has_start,
            suffixes=self._suffixes() if b"S" in self.items.initials else [],
            names=_names(path.with_suffix(".col"), n, header.name_lengths[1]),
            row_names=_names(path.with_suffix(".row"), m, header.name_lengths[0]),
            options=header.options, tolerance=header.tolerance,
        )

    def _matrix(self, segments: Segments, count: int, width: int, nonzeros: int | None) -> tuple[Any, Indices]:
        """Return the linear terms, one row for each owner, and what comes behind them."""
        letter, n = segments.letter, self.header.variables
        limits = n + segments.owners if letter == "V" else np.full(segments.heads.size, n)
        columns, values, behind = self.items.pairs(segments, limits)
        given, may_lack = values.size, letter == "G" and values.size  # AMPL counts what simplifications removed later
        if nonzeros is not None and (given > nonzeros or (given < nonzeros and not may_lack)):
            raise HeadFault(8, f"{nonzeros} nonzeros are announced for the segments {letter}, {given} are there")
        starts = np.zeros(count + 1, dtype=np.int64)
        starts[segments.owners + 1] = behind - segments.heads - 1
        kind = np.int32 if max(given, width) < 2**31 else np.int64
        parts = values, columns.astype(kind), np.cumsum(starts).astype(kind)
        return sp.csr_array(parts, shape=(count, width)), behind

    def _trees(self, segments: Segments, begins: Indices, count: int) -> Trees:
        """Return one tree for each owner in their order; the number 0 where there is none."""
        numbers, letters, first = self.items.numbers, self.items.letters, self.items.first
        if not segments.heads.size:
            zeros = np.zeros(count, dtype=np.int64)
            return Trees(zeros.astype(np.uint8), zeros.astype(np.float64), zeros, np.arange(count + 1))
        items = runs_of(begins, segments.ends - begins)
        self.items.require(first[items + 1] - first[items] == WORDS[letters[items]], items, NO_NUMBERS)
        is_part = letters[items] != ALONE
        parts, others = items[is_part], items[~is_part]
        del items, is_part  # as large as the file
        starts = np.append(np.searchsorted(parts, begins), parts.size)
        kinds, values = KINDS[letters[parts]], numbers[first[parts]]
        if self.items.strings:
            is_string = kinds == STRING
            values[is_string] = np.searchsorted(np.flatnonzero(letters == ord("h")), parts[is_string])
        self._check_parts(segments, parts, kinds, values, starts)
        counts = self._operands(parts, others, kinds, values)
        self._check_closed(segments, parts, counts, starts)
        return _in_order(segments.owners, Trees(kinds, values, counts, starts, tuple(self.items.strings)), count)

    def _check_parts(self, segments: Segments, parts: Indices, kinds: Any, values: Any, starts: Indices) -> None:
        """Raise where a part refers to what the file does not have; a defined variable uses those before it."""
        header, n = self.header, self.header.variables
        most = np.array([0, n + header.defined, ARITY.size, header.functions, self.items.count], dtype=parts.dtype)
        limits = most[kinds]
        if segments.letter == "V":
            limits = np.where(kinds == VARIABLE, np.repeat(n + segments.owners, np.diff(starts)), limits)
        holds = np.where(kinds == NUMBER, np.isfinite(values), is_whole(values, limits))
        if not holds.all():
            k = np.argmin(holds)
            self.items.fail(parts[k], WRONG_PART[kinds[k]].format(limits[k]))

    def _operands(self, parts: Indices, others: Indices, kinds: Any, values: Any) -> Indices:
        """Return how many operands each part has; of calls and some operators it is the number behind their own."""
        counts = np.zeros(parts.size, dtype=np.int64)
        is_operator = kinds == OPERATOR
        counts[is_operator] = ARITY[values[is_operator].astype(np.int64)]
        counts[kinds == CALL] = NARY
        counted = np.flatnonzero(counts < 0)
        if not (counted.size or others.size):
            return counts
        self.items.require(counts > NO_OPERATOR, parts, WRONG_PART[OPERATOR])
        is_operator, given = is_operator[counted], self.items.numbers[self.items.first[parts[counted]] + 1]
        behind = parts[counted[is_operator]] + 1
        if not np.array_equal(behind, others):
            wrong = np.setxor1d(behind, others)[0]
            self.items.fail(wrong, NO_PART if wrong in others else NO_NUMBERS)
        factor = np.where(counts[counted] == PIECEWISE, 2, 1)
        self.items.require(is_whole(given, self.items.count) & (given >= factor * is_operator), parts[counted],
                           f"it has {{:g}} operands, and a number up to {self.items.count} is possible here", given)
        counts[counted] = factor * given
        return counts

    def _check_closed(self, segments: Segments, parts: Indices, counts: Indices, starts: Indices) -> None:
        """Raise where the last operand of a tree is not its last part.

        Notes
        -----
        The sum of counts − 1 falls by one in all over a tree, and is below its earlier values there first at its end.
        """
        sums = counts - 1
        lows = np.minimum.accumulate(np.cumsum(sums, out=sums), out=sums)
        is_closed = lows < 0
        is_closed[1:] &= lows[1:] < lows[:-1]
        closed, last = np.flatnonzero(is_closed), starts[1:] - 1
        if np.array_equal(closed, last):
            return
        closed = np.append(closed, np.full(last.size, parts.size))[:last.size]
        tree = np.argmax(closed != last)
        if closed[tree] < last[tree]:
            self.items.fail(parts[closed[tree] + 1], NO_SEGMENT)
        self.items.fail(segments.ends[tree], NO_PART)

    def _bounds(self, letter: str, count: int) -> tuple[Indices, FloatVector, FloatVector, tuple[Any, Any, Any]]:
        """Return the kinds, lower and upper bounds, and the items with their numbers behind the kind."""
        segments = self.items.segments(letter)
        if count and not segments.heads.size:
            raise HeadFault(2, f"the segment {letter} is missing: {count} bounds are needed")
        items, _ = self.items.alone(segments, count)
        first, numbers = self.items.first[items], self.items.numbers
        kinds: Any = numbers[first]
        self.items.require(is_whole(kinds, PARTNER + 1), items, WRONG_KIND)
        kinds = kinds.astype(np.int64)
        words = BOUND_NUMBERS[kinds]
        self.items.require(self.items.first[items + 1] - first == words + 1, items, NO_NUMBERS)
        one, two = numbers[first + 1], numbers[first + 2]
        is_number = ~(np.isnan(one) & (words > 0) | np.isnan(two) & (words > 1))
        self.items.require(is_number, items, "a bound is not a number")
        lower = np.where(HAS_LOWER[kinds] > 0, one, -np.inf)
        upper = np.where(HAS_UPPER[kinds] > 0, np.where(words > 1, two, one), np.inf)
        lower[(lower <= -INFINITE_BOUND) & (kinds != IS_AS_STATED)] = -np.inf
        upper[(upper >= INFINITE_BOUND) & (kinds != IS_AS_STATED)] = np.inf
        if letter == "b":
            self.items.require(kinds != PARTNER, items, "a bound of kind 5 belongs to a row, not to a variable")
        return kinds, lower, upper, (items, one, two)

    def _row_bounds(self) -> tuple[FloatVector, FloatVector, Indices, Indices]:
        """Return bounds of rows, the variable of each complementarity row, −1 elsewhere, and its finite bounds."""
        header = self.header
        kinds, lower, upper, raw = self._bounds("r", header.rows)
        rows = np.flatnonzero(kinds == PARTNER)
        items, finite, variables = (part[rows] for part in raw)
        self.items.require(is_whole(finite, 4), items, "behind 5 stands which bounds are finite: 0 to 3")
        self.items.require(is_whole(variables - 1, header.variables), items,
                           f"a row is complementary to a variable from 1 to {header.variables}")
        self.items.order(variables, items, "variable {:g} is complementary to an earlier row as well; one is possible",
                         variables)
        if rows.size != header.complementarities:
            raise HeadFault(3, f"{header.complementarities} complementarity rows are announced, {rows.size} are there")
        partners, partner_bounds = np.full(kinds.size, -1, dtype=np.int64), np.zeros(kinds.size, dtype=np.int64)
        partners[rows], partner_bounds[rows] = variables - 1, finite
        return lower, upper, partners, partner_bounds

    def _start(self, letter: str, count: int) -> tuple[FloatVector, Any]:
        """Return the values of a segment x or d, and where there are some."""
        segments = self.items.segments(letter)
        indices, values, _ = self.items.pairs(segments, np.full(segments.heads.size, count))
        start, has_start = np.zeros(count), np.zeros(count, dtype=bool)
        start[indices], has_start[indices] = values, True
        return start, has_start

    def _suffixes(self) -> list[Suffix]:
        header, segments = self.header, self.items.segments("S", self.items.count)
        bits = segments.numbers[0]
        self.items.require(is_whole(bits, 2 * SUFFIX_IS_REAL), segments.heads, "a suffix' kind is 0 to 7")
        kinds = bits.astype(np.int64)
        widths = np.array([header.variables, header.rows + header.logical_rows, header.objectives, 1])
        indices, values, behind = self.items.pairs(segments, widths[kinds & SUFFIX_KIND])
        ends = np.cumsum(behind - segments.heads - 1).tolist()
        suffixes = []
        for head, kind, begin, end in zip(segments.heads.tolist(), kinds.tolist(), [0, *ends], ends, strict=False):
            own: Any = values[begin:end]
            if not kind & SUFFIX_IS_REAL and (np.abs(own) < 2.0**53).all() and (own == np.floor(own)).all():
                own = own.astype(np.int64)
            suffixes.append(Suffix(self._name(head), kind & SUFFIX_KIND, indices[begin:end], own))
        return suffixes

    def _name(self, head: int) -> str:
        return self.items.names[head].decode(errors="replace")

    def _check_announced(self) -> None:
        """Raise where the head announces what is not there, before anything of that size is allocated."""
        header, letters = self.header, self.items.initials
        for line, announced, what, letter in (
            (2, header.objectives, "objectives", b"O"), (6, header.functions, "functions", b"F"),
            (10, header.defined, "defined variables", b"V"),
            (2, header.logical_rows if b"L" in letters else 0, "logical constraints", b"L"),
        ):
            if announced != (given := letters.count(letter)):
                raise HeadFault(line, f"{announced} {what} are announced, {given} are there")

    def _check_column_counts(self, linear: sp.csr_array) -> None:
        """Raise where the segment k contradicts the segments J."""
        segments, n = self.items.segments("k"), self.header.variables
        if not segments.heads.size:
            return
        needed = max(n - 1, 0)
        self.items.require(np.maximum(segments.numbers[0], 0) == needed, segments.heads,  # −1 without variables
                           f"{needed} counts of columns are needed")
        items, _ = self.items.alone(segments, needed)
        given, = self.items.numbers_of(items, 1)
        if self.items.letters[segments.heads[0]] == ord("k"):
            given[1:] -= given[:-1].copy()
        counts = np.bincount(linear.indices, minlength=n)[:needed]
        what = "the segment says that variable {} is in {:g} rows, and the segments J have it in {}"
        self.items.require(
            given == counts, np.repeat(segments.heads, given.size), what, np.arange(given.size), given, counts)

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


def _in_order(owners: Indices, trees: Trees, count: int) -> Trees:
    """Return the trees in the order of their owners; of those without one, the number 0."""
    if owners.size == count and (owners[1:] > owners[:-1]).all():
        return trees
    given = np.diff(trees.starts)
    lengths = np.ones(count, dtype=np.int64)
    lengths[owners] = given
    starts = np.concatenate([[0], np.cumsum(lengths)])
    targets = runs_of(starts[owners], given)
    kinds, values, counts = (np.zeros(starts[-1], dtype=kind) for kind in (np.uint8, np.float64, np.int64))
    kinds[targets], values[targets], counts[targets] = trees.kinds, trees.values, trees.counts
    return Trees(kinds, values, counts, starts, trees.strings)


def _names(path: Path, count: int, longest: int) -> list[str] | None:
    """Return the names in a file beside this one, or None where it is not of this problem."""
    if not longest or not path.is_file():  # a length of 0 says that none were written
        return None
    try:
        names = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    return names[:count] if len(names) >= count else None
