"""Reading ``.nl`` files: the segments of either form, checked, become an `NLContent`."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.errors import UnreadableFile
from ..files.files import INFINITE_BOUND, checked_path
from .binary import read_binary
from .content import (
    PARTNER,
    SUFFIX_IS_REAL,
    SUFFIX_KIND,
    Bounds,
    Fault,
    Forest,
    Header,
    HeadFault,
    Indices,
    Linear,
    NLContent,
    Segments,
    Suffix,
    Token,
    Trees,
    fail,
    read_header,
)
from .text import read_text

ENDING = ".nl"
SHOWN = 40  # bytes of a line that a message quotes


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
    try:
        data = source.read_bytes()
    except FileNotFoundError as error:
        raise UnreadableFile(f"no such file: {source}") from error
    except OSError as error:
        raise UnreadableFile(f"cannot read {source}: {error.strerror or error}") from error
    found = Segments()
    try:
        header, begin = read_header(data)
        with np.errstate(invalid="ignore"):  # of a signalling NaN, which is refused
            (read_binary if header.is_binary else read_text)(data, begin, header, found)
            return _Content(source, header, found).content()
    except Fault as fault:
        raise UnreadableFile(
            f"cannot read {source}, {_place(data, found, fault)}: {fault}; the file is damaged, or no .nl file: "
            "write it again"
        ) from fault


def _place(data: bytes, found: Segments, fault: Fault) -> str:
    """Return where a fault is: the line and what it says, or the byte."""
    is_in_head = isinstance(fault, HeadFault)
    if data[:1] == b"b" and not is_in_head:
        return f"byte {fault.place}"
    line, begin = fault.place if is_in_head else found.line(fault.place), 0
    for _ in range(line - 1):
        begin = data.find(b"\n", begin) + 1 or len(data)
    text = data[begin:begin + SHOWN].split(b"\n")[0].decode("ascii", errors="replace")
    return f"line {line} ({text!r})"


class _Content:
    """The checks between segments, and the arrays they become."""

    def __init__(self, source: Path, header: Header, found: Segments) -> None:
        self.source, self.header, self.found = source, header, found

    def content(self) -> NLContent:
        """Return the content."""
        header, found = self.header, self.found
        n, d = header.variables, header.defined
        self._check_announced()
        _, lower, upper, _ = self._bounds("b", n)
        row_kinds, row_lower, row_upper, raw = self._bounds("r", header.rows)
        partners, partner_bounds = self._partners(row_kinds, raw)
        linear = self._matrix("J", header.rows, n, 0, header.nonzeros)
        self._check_column_counts(linear)
        self._check_defined()
        start, has_start = self._start("x", n)
        trees = {letter: self._trees(letter, count, first) for letter, count, first in (
            ("C", header.rows, 0), ("O", header.objectives, 0), ("V", d, n))}
        if "L" in found.trees:  # checked, not kept
            self._trees("L", header.logical_rows, 0)
        is_maximized = np.zeros(header.objectives, dtype=bool)
        if "O" in found.trees:
            is_maximized[found.trees["O"].owners] = np.array(found.senses, dtype=bool)
        return NLContent(
            lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper, partners=partners,
            partner_bounds=partner_bounds, linear=linear, trees=trees["C"], is_maximized=is_maximized,
            objective_linear=self._matrix("G", header.objectives, n, 0, header.objective_nonzeros),
            objective_trees=trees["O"], defined_linear=self._matrix("V", d, n + d, n, None),
            defined_trees=trees["V"], is_integer=self._integers(), logical_rows=header.logical_rows,
            functions=self._functions(), start=start, dual_start=self._start("d", header.rows)[0],
            has_start=has_start, suffixes=[self._suffix(one) for one in found.suffixes],
            names=self._names(".col", n, header.name_lengths[1]),
            row_names=self._names(".row", header.rows, header.name_lengths[0]),
            options=header.options, tolerance=header.tolerance,
        )

    def _bounds(self, letter: str, count: int) -> tuple[FloatVector, FloatVector, FloatVector, Bounds]:
        """Return kinds, lower and upper bounds, and the segment itself."""
        empty = np.zeros(0)
        none = Bounds(empty, empty, empty, np.zeros(0, dtype=np.int64))
        raw = self.found.bounds.get(letter, none)
        if raw.kinds.size != count:
            raise HeadFault(2, f"the segment {letter} is missing: {count} bounds are needed")
        self._require(~(np.isnan(raw.first) | np.isnan(raw.second)), raw.places, "a bound is not a number")
        kinds, lower, upper = raw.kinds, raw.first.copy(), raw.first.copy()
        lower[(kinds == 1) | (kinds == 3) | (kinds == PARTNER)] = -np.inf
        upper[(kinds == 2) | (kinds == 3) | (kinds == PARTNER)] = np.inf
        upper[kinds == 0] = raw.second[kinds == 0]
        lower[(lower <= -INFINITE_BOUND) & (kinds != 4)] = -np.inf
        upper[(upper >= INFINITE_BOUND) & (kinds != 4)] = np.inf
        if letter == "b":
            self._require(kinds != PARTNER, raw.places, "a bound of kind 5 belongs to a row, not to a variable")
        return kinds, lower, upper, raw

    def _partners(self, kinds: FloatVector, raw: Bounds) -> tuple[Indices, Indices]:
        """Return the variable that each complementarity row goes with, −1 elsewhere, and its finite bounds."""
        n, is_pair = self.header.variables, kinds == PARTNER
        places = raw.places[is_pair]
        bounds, partner = raw.first[is_pair], raw.second[is_pair]
        self._require((bounds == np.floor(bounds)) & (bounds >= 0) & (bounds <= 3), places,
                      "behind 5 stands which bounds are finite: 0 to 3")
        self._require((partner == np.floor(partner)) & (partner >= 1) & (partner <= n), places,
                      f"a row is complementary to a variable from 1 to {n}")
        if places.size != self.header.complementarities:
            raise HeadFault(3, f"{self.header.complementarities} complementarity rows are announced, "
                            f"{places.size} are there")
        order = np.argsort(partner, kind="stable")
        again = order[1:][np.diff(partner[order]) == 0]
        if again.size:
            k = again.min()
            fail(places[k], f"variable {partner[k]:g} is complementary to an earlier row as well; one row is possible")
        partners, partner_bounds = (np.full(kinds.size, fill, dtype=np.int64) for fill in (-1, 0))
        partners[is_pair], partner_bounds[is_pair] = partner.astype(np.int64) - 1, bounds.astype(np.int64)
        return partners, partner_bounds

    def _require(self, holds: Any, places: Indices, what: str) -> None:
        if not holds.all():
            fail(places[np.argmin(holds)], what)

    def _check_owners(self, letter: str, owners: Indices, places: Indices, first: int, count: int) -> None:
        """Raise where a segment belongs to nothing, or two to the same."""
        self._require((owners >= first) & (owners < first + count), places,
                      f"a segment {letter} has a number from {first} to {first + count - 1}" if count else
                      f"the head announces nothing that a segment {letter} could belong to")
        order = np.argsort(owners, kind="stable")
        again = order[1:][np.diff(owners[order]) == 0]
        if again.size:
            fail(places[again.min()], f"a second segment {letter}{owners[again.min()]}; a file has one")

    def _pairs(self, pairs: Linear, width: int, *, is_finite: bool = True) -> Indices:
        """Return the indices of pairs, each of them checked."""
        columns = pairs.columns
        holds = (columns >= 0) & (columns < width) & (columns == np.floor(columns))
        if not holds.all():
            k = int(np.argmin(holds))
            fail(pairs.place(k), f"the index {columns[k]:g} lies outside 0 … {width - 1}")
        if is_finite and not np.isfinite(pairs.values).all():
            k = int(np.argmin(np.isfinite(pairs.values)))
            fail(pairs.place(k), f"the value {pairs.values[k]} is not finite")
        return columns.astype(np.int64)

    def _matrix(self, letter: str, count: int, width: int, first: int, nonzeros: int | None) -> sp.csr_array:
        """Return the linear terms of segments, one row for each owner."""
        pairs = self.found.linear.get(letter)
        given = 0 if pairs is None else pairs.columns.size
        # AMPL counts for G what its simplifications removed later, too.
        if nonzeros is not None and (given > nonzeros or (given < nonzeros and (letter == "J" or not given))):
            raise HeadFault(8, f"{nonzeros} nonzeros are announced for the segments {letter}, {given} are there")
        if pairs is None:
            return sp.csr_array((count, width))
        self._check_owners(letter, pairs.owners, pairs.places, first, count)
        columns, values = self._pairs(pairs, width), pairs.values
        rows = np.repeat(pairs.owners - first, pairs.counts)
        key = rows * max(width, 1) + columns
        if not (np.diff(key) > 0).all():
            order = np.argsort(key, kind="stable")
            again = order[1:][np.diff(key[order]) == 0]
            if again.size:
                fail(pairs.place(int(again.min())), f"a second entry of variable {columns[again.min()]} in one segment")
            columns, values = columns[order], values[order]
        lengths = np.zeros(count, dtype=np.int64)
        lengths[pairs.owners - first] = pairs.counts
        starts = np.concatenate([[0], np.cumsum(lengths)])
        kind = np.int32 if max(columns.size, width) < 2**31 else np.int64
        return sp.csr_array((values, columns.astype(kind), starts.astype(kind)), shape=(count, width))

    def _check_column_counts(self, linear: sp.csr_array) -> None:
        """Raise where the segment k contradicts the segments J."""
        announced = self.found.column_counts
        if announced is None:
            return
        place, n = self.found.column_place, self.header.variables
        if announced.size != max(n - 1, 0):
            fail(place, f"{announced.size} counts of columns are given, and {max(n - 1, 0)} are needed")
        counts = np.bincount(linear.indices, minlength=max(n, 1))[:announced.size]
        given = np.diff(announced, prepend=0.0) if self.found.is_cumulative else announced
        wrong = np.flatnonzero(given != counts)
        if wrong.size:
            j = wrong[0]
            fail(place, f"the segment says that variable {j} is in {given[j]:g} rows, and the segments J have it in "
                 f"{counts[j]}")

    def _check_announced(self) -> None:
        """Raise where the head announces what is not there, before anything of that size is allocated."""
        header, trees = self.header, self.found.trees
        for line, announced, what, count in (
            (2, header.objectives, "objectives", trees["O"].owners.size if "O" in trees else 0),
            (6, header.functions, "functions", len(self.found.functions)),
            (10, header.defined, "defined variables", trees["V"].owners.size if "V" in trees else 0),
        ):
            if announced != count:
                raise HeadFault(line, f"{announced} {what} are announced, {count} are there")
        if "L" in trees and (count := trees["L"].owners.size) != header.logical_rows:
            raise HeadFault(2, f"{header.logical_rows} logical constraints are announced, {count} are there")

    def _check_defined(self) -> None:
        """Raise where a defined variable uses itself or one behind it."""
        n = self.header.variables
        forest, pairs = self.found.trees.get("V"), self.found.linear.get("V")
        if forest is None or pairs is None:
            return
        owners = np.repeat(pairs.owners, pairs.counts)
        late = np.flatnonzero((pairs.columns >= owners) & (pairs.columns >= n))
        if late.size:
            fail(pairs.place(int(late[0])), f"the defined variable {owners[late[0]]} uses {pairs.columns[late[0]]:g}, "
                 "which is not before it")
        owners = np.repeat(forest.owners, np.diff(forest.starts))
        is_late = (forest.kinds == Token.VARIABLE) & (forest.values >= owners) & (forest.values >= n)
        if is_late.any():
            k = int(np.argmax(is_late))
            fail(forest.token_places[k], f"the defined variable {owners[k]} uses {forest.values[k]:g}, "
                 "which is not before it")

    def _trees(self, letter: str, count: int, first: int) -> Trees:
        """Return one tree for each owner in their order; the number 0 where there is none."""
        strings = tuple(self.found.strings)
        forest = self.found.trees.get(letter)
        if forest is None:
            zeros = np.zeros(count, dtype=np.int64)
            return Trees(zeros.astype(np.uint8), zeros.astype(np.float64), zeros, np.arange(count + 1), strings)
        self._check_owners(letter, forest.owners, forest.places, first, count)
        self._check_tokens(forest)
        owners = forest.owners - first
        lengths = np.ones(count, dtype=np.int64)
        lengths[owners] = np.diff(forest.starts)
        starts = np.concatenate([[0], np.cumsum(lengths)])
        if owners.size == count and (np.diff(owners) > 0).all():
            return Trees(forest.kinds, forest.values, forest.counts, starts, strings)
        targets = np.repeat(starts[owners] - forest.starts[:-1], np.diff(forest.starts)) + np.arange(forest.kinds.size)
        parts = []
        for part in (forest.kinds, forest.values, forest.counts):
            parts.append(np.zeros(starts[-1], dtype=part.dtype))
            parts[-1][targets] = part
        return Trees(parts[0], parts[1], parts[2], starts, strings)

    def _check_tokens(self, forest: Forest) -> None:
        """Raise where a part of an expression refers to what the file does not have."""
        header, values, kinds = self.header, forest.values, forest.kinds
        for kind, count, what in (
            (Token.VARIABLE, header.variables + header.defined, "variables"),
            (Token.CALL, header.functions, "functions"),
            (Token.STRING, len(self.found.strings), "strings"),
        ):
            holds = (kinds != kind) | ((values >= 0) & (values < count) & (values == np.floor(values)))
            self._require(holds, forest.token_places, f"there are {count} {what} here, numbered from 0")
        self._require((kinds != Token.NUMBER) | np.isfinite(values), forest.token_places, "a number is not finite")

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

    def _functions(self) -> tuple[str, ...]:
        names = [""] * self.header.functions
        for place, number, name in self.found.functions:
            if not 0 <= number < len(names) or names[number]:
                fail(place, f"there are {len(names)} functions, numbered from 0, each with one segment F")
            names[number] = name.decode(errors="replace") or "?"
        return tuple(names)

    def _start(self, letter: str, count: int) -> tuple[FloatVector, Any]:
        """Return the values of a segment x or d, and where there are some."""
        start, has_start = np.zeros(count), np.zeros(count, dtype=bool)
        pairs = self.found.linear.get(letter)
        if pairs is not None:
            indices = self._pairs(pairs, count)
            start[indices], has_start[indices] = pairs.values, True
            if np.count_nonzero(has_start) != indices.size:
                fail(pairs.places[0], f"the segment {letter} gives two values for one index")
        return start, has_start

    def _suffix(self, one: Any) -> Suffix:
        header, kind = self.header, one.bits & SUFFIX_KIND
        counts = (header.variables, header.rows + header.logical_rows, header.objectives, 1)
        indices = self._pairs(one.pairs, counts[kind], is_finite=False)
        values: Any = one.pairs.values
        if not one.bits & SUFFIX_IS_REAL and (np.abs(values) < 2.0**53).all() and (values == np.floor(values)).all():
            values = values.astype(np.int64)
        return Suffix(one.name.decode(errors="replace"), kind, indices, values)

    def _names(self, ending: str, count: int, longest: int) -> list[str] | None:
        """Return the names in a file beside this one, or None where it is not of this problem."""
        path = self.source.with_suffix(ending)
        if not longest or not path.is_file():  # a length of 0 says that none were written
            return None
        try:
            names = path.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return None
        return names[:count] if len(names) >= count else None
