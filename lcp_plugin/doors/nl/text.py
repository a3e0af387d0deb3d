"""Text ``.nl`` files: all lines of a kind at once, since a model of 10⁵ variables has 10⁶ lines."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector
from .content import (
    ARITY,
    BOUND_WORDS,
    LINES,
    NARY,
    NO_OPERATOR,
    PIECEWISE,
    SUFFIX_IS_REAL,
    Bounds,
    Forest,
    Header,
    Indices,
    Linear,
    NamedValues,
    Segments,
    Token,
    checked_count,
    fail,
)

FIRST_LINE = LINES + 1
BYTES_AT_ONCE = 1 << 20  # of which numbers are read: what is needed beside them stays small
NUMERIC, SEGMENT, TOKEN = 0, 1, 2
CLASS = np.zeros(256, dtype=np.uint8)
CLASS[list(b"CLVOFGJSbrkKxd")] = SEGMENT
CLASS[list(b"nlsvofh")] = TOKEN
TOKEN_KIND = np.zeros(256, dtype=np.uint8)
for _letters, _kind in ((b"nls", Token.NUMBER), (b"v", Token.VARIABLE), (b"o", Token.OPERATOR),
                        (b"f", Token.CALL), (b"h", Token.STRING)):
    TOKEN_KIND[list(_letters)] = _kind
HEADER_WORDS = {"C": 1, "L": 1, "O": 2, "V": 3, "G": 2, "J": 2, "b": 0, "r": 0, "k": 1, "K": 1, "x": 1, "d": 1}
NAMED = {  # how many numbers stand before the name
    b"F": (re.compile(rb"F(\d{1,9})\s+\d{1,9}\s+-?\d{1,9}\s+(\S+)\s*"), "a function's number, type, operands and name"),
    b"S": (re.compile(rb"S(\d{1,9})\s+(\d{1,18})\s+(\S+)\s*"), "a suffix' kind, count and name"),
}
STRING = re.compile(rb"\nh(\d{1,9}):")


def read_text(data: bytes, begin: int, header: Header, found: Segments) -> None:
    """Fill in the segments of a text file that begin at that byte."""
    _Lines(_without_strings(data, begin, found), header, found).read()


def _without_strings(data: bytes, begin: int, found: Segments) -> list[Any]:
    """Return the lines with each string, which may hold any bytes, replaced by its number."""
    pieces: list[Any] = []
    done, line = begin, FIRST_LINE
    whole = memoryview(data)
    while match := STRING.search(data, done):
        line += data.count(b"\n", done, match.start()) + 1
        end = match.end() + int(match[1])
        rest = data[end:end + 2]
        if not (rest[:1] == b"\n" or rest == b"\r\n"):
            fail(line, f"a string of {int(match[1])} bytes does not end with its line")
        pieces += [whole[done:match.start()], b"\nh%d" % len(found.strings)]
        found.strings.append(data[match.end():end])
        found.hidden_lines.append((line, found.strings[-1].count(b"\n")))
        done = end
    end = len(data)
    while end > done and data[end - 1] <= ord(" "):
        end -= 1
    return [*pieces, whole[done:end], b"\n"]


class _Lines:
    """The lines behind the head: where each begins, its first letter, and all numbers one after the other."""

    def __init__(self, pieces: list[Any], header: Header, found: Segments) -> None:
        self.header, self.found = header, found
        text = np.concatenate([np.frombuffer(piece, dtype=np.uint8) for piece in pieces])
        kind = np.int32 if text.size < 2**31 else np.int64
        ends: Any = np.flatnonzero(text == ord("\n")).astype(kind)
        self.begin = np.append(ends[:1] * 0, ends[:-1] + 1)
        self.count = ends.size
        _blank_comments(text, ends)
        self.letters = text[self.begin]
        self.classes = CLASS[self.letters]
        self.segments: Any = np.flatnonzero(self.classes == SEGMENT).astype(kind)
        self.segment_ends = np.append(self.segments[1:], self.count)
        self.names = self._named(text, ends)
        text[self.begin[self.classes != NUMERIC]] = ord(" ")
        self.first, self.numbers = self._parsed(text)

    def _named(self, text: NDArray[np.uint8], ends: Indices) -> dict[int, Any]:
        """Return what the heads of the F and S segments say, and blank them: they hold names."""
        names: dict[int, Any] = {}
        letters = self.letters[self.segments]
        for line in self.segments[(letters == ord("F")) | (letters == ord("S"))].tolist():
            begin, end = int(self.begin[line]), int(ends[line])
            head = text[begin:end].tobytes()
            pattern, needed = NAMED[head[:1]]
            names[line] = pattern.fullmatch(head)
            if names[line] is None:
                fail(line + FIRST_LINE, f"{needed} are needed")
            text[begin:end] = ord(" ")
        return names

    def _parsed(self, text: NDArray[np.uint8]) -> tuple[Indices, FloatVector]:
        """Return which word is the first of each line, and one end more, and the words as numbers."""
        first: Any = np.zeros(self.count + 1, dtype=self.begin.dtype)
        parts = [np.zeros(0)]
        borders = np.unique(np.searchsorted(self.begin, np.arange(0, text.size, BYTES_AT_ONCE)))
        for i, k in zip(borders.tolist(), [*borders[1:].tolist(), self.count], strict=True):
            begin, end = int(self.begin[i]), int(self.begin[k]) if k < self.count else text.size
            part = text[begin:end]
            is_word = part > ord(" ")
            is_word[1:] &= part[:-1] <= ord(" ")
            words = first[i + 1:k + 1]
            words[:] = np.add.reduceat(is_word, self.begin[i:k] - begin, dtype=first.dtype)
            numbers = _numbers(part, int(words.sum()))
            if numbers is None:
                bad = i + _first_bad_line(part, words)
                fail(bad + FIRST_LINE, "this is neither a number nor a letter of the format")
            parts.append(numbers)
        return np.cumsum(first, out=first), np.concatenate(parts)

    def read(self) -> None:
        """Fill in the segments."""
        if self.count and self.classes[0] != SEGMENT:
            fail(FIRST_LINE, "no segment begins here; the letters are C L V O F G J S b r k K x d")
        for letter in "CLOVJGxdbrkK":
            heads = self.letters[self.segments] == ord(letter)
            if heads.any():
                self._read_all(letter, self.segments[heads], self.segment_ends[heads])
        for line, head in self.names.items():
            end = int(self.segment_ends[np.searchsorted(self.segments, line)])
            if head[0][:1] == b"F":
                self._require_end(line + 1, end)
                self.found.functions.append((line + FIRST_LINE, int(head[1]), head[2]))
            else:
                bits = checked_count(float(head[1]), 2 * SUFFIX_IS_REAL - 1, line + FIRST_LINE, "the kind of a suffix")
                pairs = self._linear(np.array([line]), np.array([end]), np.zeros(1), np.array([float(head[2])]))
                self.found.suffixes.append(NamedValues(head[3], bits, pairs))

    def _read_all(self, letter: str, heads: Indices, ends: Indices) -> None:
        """Fill in the segments of one letter."""
        self._require_words(heads, HEADER_WORDS[letter], f"the head of a segment {letter}")
        numbers = [self.numbers[self.first[heads] + k] for k in range(HEADER_WORDS[letter])]
        if letter in "CLO":
            self.found.trees[letter] = self._forest(numbers[0], heads, heads + 1, ends)
            if letter == "O":
                self.found.senses = [checked_count(sense, 1, line + FIRST_LINE, "the sense of an objective")
                                     for sense, line in zip(numbers[1].tolist(), heads.tolist(), strict=True)]
        elif letter == "V":
            pairs = self._linear(heads, ends, numbers[0], numbers[1], is_all=False)
            self.found.linear["V"] = pairs
            self.found.trees["V"] = self._forest(numbers[0], heads, heads + 1 + pairs.counts, ends)
        elif letter in "JG":
            self.found.linear[letter] = self._linear(heads, ends, numbers[0], numbers[1])
        elif heads.size > 1 or (letter in "kK" and self.found.column_counts is not None):
            fail(heads[-1] + FIRST_LINE, f"a second segment {letter}; a file has one")
        elif letter in "xd":
            self.found.linear[letter] = self._linear(heads, ends, np.zeros(1), numbers[0])
        elif letter in "br":
            self._bounds(letter, int(heads[0]), int(ends[0]))
        else:
            self._column_counts(int(heads[0]), int(ends[0]), float(numbers[0][0]))
            self.found.is_cumulative = letter == "k"

    def _words(self, lines: Indices) -> Indices:
        """Return how many words the lines have."""
        words: Indices = self.first[lines + 1] - self.first[lines]
        return words

    def _require_words(self, lines: Indices, words: Any, what: str) -> None:
        given = self._words(lines)
        if (given != words).any():
            k = np.argmax(given != words)
            needed = np.broadcast_to(words, lines.shape)[k]
            fail(lines[k] + FIRST_LINE, f"{what} has {needed} numbers, this line {given[k]}")

    def _require_end(self, line: int, end: int) -> None:
        if line < end:
            fail(line + FIRST_LINE, "the segment before this line is complete, and no other begins here")

    def _linear(self, heads: Indices, ends: Indices, owners: Any, counts: FloatVector, is_all: bool = True) -> Linear:
        """Return pairs below the heads; `is_all` where nothing but pairs may stand there."""
        room = ends - heads - 1
        wrong = np.flatnonzero(~((counts == room) if is_all else (counts >= 0) & (counts <= room)))
        if wrong.size:
            k = wrong[0]
            fail(heads[k] + FIRST_LINE, f"{counts[k]:g} pairs of an index and a value are announced, "
                 f"{room[k]} lines follow")
        lengths = counts.astype(np.int64)
        lines = _runs(heads + 1, lengths)
        not_numeric = np.flatnonzero(self.classes[lines] != NUMERIC)
        if not_numeric.size:
            fail(lines[not_numeric[0]] + FIRST_LINE, "an index and a value are needed here")
        self._require_words(lines, 2, "a pair of an index and a value")
        at = self.first[lines]
        return Linear(_whole(owners, heads + FIRST_LINE), lengths, heads + FIRST_LINE, heads + 1 + FIRST_LINE, 1,
                      self.numbers[at], self.numbers[at + 1])

    def _bounds(self, letter: str, head: int, end: int) -> None:
        count = self.header.variables if letter == "b" else self.header.rows
        if end - head - 1 != count:
            fail(head + FIRST_LINE, f"{end - head - 1} bounds stand in the segment {letter}, and {count} are needed")
        lines = np.arange(head + 1, end)
        self._require(self._words(lines) >= 1, lines, "a bound begins with its kind")
        kinds = self.numbers[self.first[lines]]
        self._require((kinds >= 0) & (kinds <= 5) & (kinds == np.floor(kinds)), lines, "a bound's kind is 0 to 5")
        words = np.array(BOUND_WORDS)[kinds.astype(np.int64)]
        self._require_words(lines, words + 1, "a bound of this kind")
        padded = np.append(self.numbers, [0.0, 0.0])
        first, second = (np.where(words > k, padded[self.first[lines] + 1 + k], 0.0) for k in (0, 1))
        self.found.bounds[letter] = Bounds(kinds, first, second, lines + FIRST_LINE)

    def _require(self, holds: NDArray[np.bool_], lines: Indices, what: str) -> None:
        if not holds.all():
            fail(lines[np.argmin(holds)] + FIRST_LINE, what)

    def _column_counts(self, head: int, end: int, count: float) -> None:
        if max(count, 0.0) != end - head - 1:  # −1 without variables
            fail(head + FIRST_LINE, f"{count:g} counts of columns are announced, {end - head - 1} lines follow")
        lines = np.arange(head + 1, end)
        self._require(self.classes[lines] == NUMERIC, lines, "the count of a column is needed here")
        self._require_words(lines, 1, "the count of a column")
        self.found.column_counts, self.found.column_place = self.numbers[self.first[lines]], head + FIRST_LINE

    def _forest(self, owners: FloatVector, heads: Indices, begins: Indices, ends: Indices) -> Forest:
        """Return the trees that stand in the lines from `begins` to `ends`."""
        lines = _runs(begins, ends - begins)
        is_token = self.classes[lines] == TOKEN
        tokens = lines[is_token]
        starts = _sums(is_token)[_sums(ends - begins)]
        self._require((ends > begins) & (np.diff(starts) > 0), heads, "no expression follows")
        kinds = TOKEN_KIND[self.letters[tokens]]
        self._require_words(tokens, 1 + (kinds == Token.CALL), "this part of an expression")
        values = self.numbers[self.first[tokens]]
        counts = np.zeros(tokens.size, dtype=np.int64)
        is_call, is_operator = kinds == Token.CALL, kinds == Token.OPERATOR
        counts[is_call] = self._counts(tokens[is_call], self.first[tokens[is_call]] + 1)
        counts[is_operator] = self._operands(tokens[is_operator], values[is_operator], lines[~is_token])
        self._require_closed(tokens, counts, starts)
        return Forest(_whole(owners, heads + FIRST_LINE), heads + FIRST_LINE, kinds, values, counts,
                      tokens + FIRST_LINE, starts)

    def _counts(self, lines: Indices, at: Indices) -> Indices:
        """Return the numbers of operands that stand there, none of which can exceed the number of lines."""
        counts = self.numbers[at]
        self._require((counts >= 0) & (counts <= self.count) & (counts == np.floor(counts)), lines,
                      f"the number of operands must be a whole number, at most {self.count} here")
        return counts.astype(np.int64)

    def _operands(self, lines: Indices, operators: FloatVector, others: Indices) -> Indices:
        """Return how many operands each operator has; behind some of them stands a line that tells."""
        is_known = (operators >= 0) & (operators < ARITY.size) & (operators == np.floor(operators))
        self._require(is_known, lines, "there is no operator of this number")
        arity = ARITY[operators.astype(np.int64)]
        self._require(arity != NO_OPERATOR, lines, "there is no operator of this number")
        has_count = (arity == NARY) | (arity == PIECEWISE)
        count_lines = lines[has_count] + 1
        if not np.array_equal(count_lines, others):
            wrong = np.setxor1d(count_lines, others)[0]
            fail(wrong + FIRST_LINE, "a part of an expression is needed here" if wrong in others else
                 "the number of operands is needed here")
        self._require_words(count_lines, 1, "the number of operands")
        counts = self._counts(count_lines, self.first[count_lines])
        self._require(counts >= 1 + (arity[has_count] == PIECEWISE), count_lines, "an operator needs more operands")
        arity[has_count] = np.where(arity[has_count] == PIECEWISE, 2 * counts, counts)
        return arity

    def _require_closed(self, tokens: Indices, counts: Indices, starts: Indices) -> None:
        """Raise where a tree is complete before its last line, or not at it."""
        running = _sums(counts - 1)
        open_places = running[1:] + 1
        open_places -= np.repeat(running[starts[:-1]], np.diff(starts))
        del running
        is_last = np.zeros(tokens.size, dtype=bool)
        is_last[starts[1:] - 1] = True
        wrong = np.flatnonzero((open_places <= 0) != is_last)
        if wrong.size:
            k = wrong[0]
            fail(tokens[k] + FIRST_LINE, f"the expression lacks {open_places[k]} operands at its end" if is_last[k] else
                 "the expression is complete here, and its segment goes on")


def _blank_comments(text: NDArray[np.uint8], ends: Indices) -> None:
    """Overwrite with blanks what stands between a # and the end of its line."""
    hashes = np.flatnonzero(text == ord("#"))
    if hashes.size:
        stops = ends[np.searchsorted(ends, hashes)]
        is_first = np.append(True, stops[1:] != stops[:-1])
        change = np.zeros(text.size + 1, dtype=np.int8)
        change[hashes[is_first]] = 1
        change[stops[is_first]] = -1
        text[np.cumsum(change[:-1], dtype=np.int8) == 1] = ord(" ")


def _first_bad_line(text: NDArray[np.uint8], words: Indices) -> int:
    """Return the first line whose words are not all numbers, by bisection: all before it can be read."""
    begin = np.append(0, np.flatnonzero(text == ord("\n")) + 1)
    good, bad = 0, words.size
    while bad - good > 1:
        middle = (good + bad) // 2
        if _numbers(text[begin[good]:begin[middle]], int(words[good:middle].sum())) is None:
            bad = middle
        else:
            good = middle
    return good


def _numbers(text: NDArray[np.uint8], total: int) -> FloatVector | None:
    """Return the words of a text as numbers, or None where there are not `total` of them."""
    if not total:  # of blanks alone numpy makes a number
        return np.empty(0)
    try:
        with warnings.catch_warnings():  # what numpy 2.3 and later raise, older ones warn of
            warnings.simplefilter("error", DeprecationWarning)
            numbers = np.fromstring(text.tobytes(), dtype=np.float64, sep=" ")
    except (ValueError, DeprecationWarning):
        return None
    return numbers if numbers.size == total else None


def _sums(counts: NDArray[Any]) -> Indices:
    """Return 0 and the sum of all up to each."""
    return np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(counts)])


def _runs(begins: Indices, counts: Indices) -> Indices:
    """Return begins[0], begins[0] + 1 … counts[0] of them, then those of the next."""
    ends = np.cumsum(counts)
    runs = np.arange(ends[-1] if ends.size else 0, dtype=begins.dtype)
    runs += np.repeat((begins - ends + counts).astype(begins.dtype), counts)
    return runs


def _whole(owners: Any, places: Indices) -> Indices:
    """Return what segments belong to as whole numbers."""
    is_whole = (owners == np.floor(owners)) & (np.abs(owners) < 2.0**53)
    if not is_whole.all():
        fail(places[np.argmin(is_whole)], "the number behind the letter of a segment must be whole")
    return np.asarray(owners).astype(np.int64)
