"""The two forms of ``.nl`` files, item by item: heads of segments, pairs, bounds, and parts of expressions."""

from __future__ import annotations

from array import array
from struct import Struct

import numpy as np

from .content import BOUND_WORDS, LINES, PARTNER, Header, Token, fail

#: How many numbers stand behind the letter of a segment; a name follows in F and S.
HEADS = {"C": 1, "L": 1, "O": 2, "V": 3, "G": 2, "J": 2, "b": 0, "r": 0, "k": 1, "K": 1, "x": 1, "d": 1, "F": 3, "S": 2}
NAMED = "FS"
LONGEST_COUNT = 11  # of the digits of a string's length, with its colon
KINDS = {
    b"n": Token.NUMBER, b"l": Token.NUMBER, b"s": Token.NUMBER, b"v": Token.VARIABLE, b"o": Token.OPERATOR,
    b"f": Token.CALL, b"h": Token.STRING,
}
Part = tuple[Token, float, int]  # of an expression: its kind and value, and of a call, how many operands follow


def source_in(data: bytes, begin: int, header: Header) -> Text | Binary:
    """Return what reads a file whose segments begin at that byte."""
    return Binary(data, begin, header.byteorder) if header.is_binary else Text(data, begin)


class Text:
    """The lines behind the head. A ValueError says that there are other words in a line than are needed.

    Attributes
    ----------
    at, end : int
        How many lines have been read, and how many there are; blank ones at the end do not count.
    place : int
        The number of the line that was read last.
    strings : list of bytes
        Those in expressions, which may hold newlines.
    """

    def __init__(self, data: bytes, begin: int) -> None:
        self.data, self.strings = data, list[bytes]()
        last = max(len(data.rstrip()), begin)
        newlines = begin + np.flatnonzero(np.frombuffer(data, np.uint8, last - begin, begin) == ord("\n"))
        self.ends = array("q", np.concatenate([[begin - 1], newlines, [last]]).tobytes())  # of lines, the head's first
        self.at, self.end = 0, newlines.size + (last > begin)

    @property
    def place(self) -> int:
        """The number of the line that was read last."""
        return LINES + self.at

    def line(self) -> bytes:
        """Return the next line without its comment."""
        if self.at >= self.end:
            fail(self.place, "the file ends within a segment")
        line = self.data[self.ends[self.at] + 1:self.ends[self.at + 1]]
        self.at += 1
        return line.split(b"#")[0] if b"#" in line else line

    def head(self) -> tuple[str, list[int], bytes]:
        """Return letter, numbers and name of a segment."""
        line = self.line()
        letter = _letter(line[:1], self.place)
        words = line[1:].split()
        name = words.pop() if letter in NAMED and words else b""
        if len(words) != HEADS[letter]:
            fail(self.place, f"the head of a segment {letter} has {HEADS[letter]} numbers, this {len(words)}")
        return letter, [int(word) for word in words], name

    def pairs(self, count: int, is_real: bool) -> tuple[list[int], list[float], range]:
        """Return as many indices, values, and places."""
        begin = self.at
        try:
            lines = self.data[self.ends[begin] + 1:self.ends[begin + count]].split(b"\n") if count else []
            words = [line.split() for line in lines]
            found = [int(index) for index, _ in words], [float(value) for _, value in words]
            self.at += count
        except ValueError:  # a comment, or no pair
            found = [], []
            for _ in range(count):
                index, value = self.line().split()
                found[0].append(int(index))
                found[1].append(float(value))
        return *found, range(LINES + begin + 1, LINES + self.at + 1)

    def integer(self) -> int:
        """Return a number of operands, or of the entries of a column."""
        return int(self.line())

    def bound(self) -> tuple[int, list[float]]:
        """Return the kind of a bound and its numbers."""
        first, *numbers = self.line().split()
        kind = _bound_kind(int(first), self.place)
        if len(numbers) != BOUND_WORDS[kind]:
            fail(self.place, f"a bound of this kind has {BOUND_WORDS[kind]} numbers, this line {len(numbers)}")
        return kind, [float(number) for number in numbers]

    def part(self) -> Part:
        """Return the next part of an expression."""
        line = self.line()
        kind = _kind(line[:1], self.place)
        if kind is Token.NUMBER:
            return kind, float(line[1:]), 0
        if kind is Token.CALL:
            number, count = line[1:].split()
            return kind, int(number), int(count)
        if kind is Token.STRING:
            self._keep_string()
            return kind, len(self.strings) - 1, 0
        return kind, int(line[1:]), 0

    def _keep_string(self) -> None:
        """Keep the string that begins in the line read last; it may hold any bytes, and go over several lines."""
        place, begin = self.place, self.ends[self.at - 1] + 2
        length, colon, _ = self.data[begin:begin + LONGEST_COUNT].partition(b":")
        begin += len(length) + 1
        end = begin + int(length)
        while self.at < self.end and self.ends[self.at] < end:
            self.at += 1
        if not colon or end > self.ends[self.at] or self.data[end:self.ends[self.at]].strip():
            fail(place, "a string begins with its length, as h5:, and ends with its line")
        self.strings.append(self.data[begin:end])


class Binary:
    """The same of a binary file; `place` is the byte at which the item begins that was read last."""

    def __init__(self, data: bytes, begin: int, order: str) -> None:
        self.data, self.at, self.end, self.place = data, begin, len(data), begin
        self.strings: list[bytes] = []
        self.int, self.real_pair, self.int_pair = (Struct(order + form) for form in ("i", "id", "ii"))
        self.bounds = [Struct(order + form) for form in ("dd", "d", "d", "", "d", "ii")]  # by kind
        self.numbers = {b"n": Struct(order + "d"), b"s": Struct(order + "h")}  # of all other letters an int

    def _take(self, length: int) -> int:
        """Return where so many bytes begin, and go behind them."""
        begin = self.at
        if not 0 <= length <= self.end - begin:
            fail(begin, f"{length} bytes are needed here, and {self.end - begin} follow")
        self.at = begin + length
        return begin

    def _int(self) -> int:
        return int(self.int.unpack_from(self.data, self._take(4))[0])

    def _text(self) -> bytes:
        length = self._int()
        begin = self._take(length)
        return self.data[begin:self.at]

    def _letter(self) -> bytes:
        self.place = self._take(1)
        return self.data[self.place:self.at]

    def head(self) -> tuple[str, list[int], bytes]:
        """Return letter, numbers and name of a segment."""
        letter = _letter(self._letter(), self.place)
        return letter, [self._int() for _ in range(HEADS[letter])], self._text() if letter in NAMED else b""

    def pairs(self, count: int, is_real: bool) -> tuple[list[int], list[float], range]:
        """Return as many indices, values, and places."""
        form = self.real_pair if is_real else self.int_pair
        begin = self._take(count * form.size)
        found = list(form.iter_unpack(self.data[begin:self.at]))
        return [index for index, _ in found], [value for _, value in found], range(begin, self.at + 1, form.size)

    def integer(self) -> int:
        """Return a number of operands, or of the entries of a column."""
        self.place = self.at
        return self._int()

    def bound(self) -> tuple[int, list[float]]:
        """Return the kind of a bound and its numbers."""
        kind = _bound_kind(self._letter()[0] - ord("0"), self.place)
        form = self.bounds[kind]
        return kind, list(form.unpack_from(self.data, self._take(form.size)))

    def part(self) -> Part:
        """Return the next part of an expression."""
        letter = self._letter()
        kind = _kind(letter, self.place)
        if kind is Token.STRING:
            self.strings.append(self._text())
            return kind, len(self.strings) - 1, 0
        form = self.numbers.get(letter, self.int)
        value = form.unpack_from(self.data, self._take(form.size))[0]
        return kind, value, self._int() if kind is Token.CALL else 0


def _letter(letter: bytes, place: int) -> str:
    name = letter.decode("latin-1")
    if name not in HEADS:
        fail(place, f"no segment begins with {name!r}; the letters are {' '.join(HEADS)}")
    return name


def _kind(letter: bytes, place: int) -> Token:
    kind = KINDS.get(letter)
    if kind is None:
        fail(place, "a part of an expression is needed here")
    return kind


def _bound_kind(kind: int, place: int) -> int:
    if not 0 <= kind <= PARTNER:
        fail(place, f"a bound's kind is 0 to {PARTNER}")
    return kind
