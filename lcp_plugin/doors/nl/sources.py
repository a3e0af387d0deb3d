"""The two forms of ``.nl`` files, item by item: heads of segments, pairs, bounds, and parts of expressions."""

from __future__ import annotations

import re
from struct import Struct

from .content import BOUND_WORDS, LINES, PARTNER, Header, Token, fail

#: How many numbers stand behind the letter of a segment; a name follows in F and S.
HEADS = {"C": 1, "L": 1, "O": 2, "V": 3, "G": 2, "J": 2, "b": 0, "r": 0, "k": 1, "K": 1, "x": 1, "d": 1, "F": 3, "S": 2}
NAMED = "FS"
KINDS = {
    b"n": Token.NUMBER, b"l": Token.NUMBER, b"s": Token.NUMBER, b"v": Token.VARIABLE, b"o": Token.OPERATOR,
    b"f": Token.CALL, b"h": Token.STRING,
}
STRING = re.compile(rb"h(\d{1,9}):")
Part = tuple[Token, float, int]  # of an expression: its kind and value, and of a call, how many operands follow


def source_in(data: bytes, begin: int, header: Header) -> Text | Binary:
    """Return what reads a file whose segments begin at that byte."""
    return Binary(data, begin, header.byteorder) if header.is_binary else Text(data, begin)


class Text:
    """The lines behind the head. A ValueError says that there are other words in a line than are needed.

    Attributes
    ----------
    at, end : int
        The byte at which the next line begins, and the end of the last that is not blank.
    place : int
        The number of the line that was read last.
    strings : list of bytes
        Those in expressions, which may hold newlines.
    """

    def __init__(self, data: bytes, begin: int) -> None:
        self.data, self.at, self.end, self.place = data, begin, len(data.rstrip()), LINES
        self.strings: list[bytes] = []

    def line(self) -> bytes:
        """Return the next line without its comment."""
        if self.at >= self.end:
            fail(self.place, "the file ends within a segment")
        stop = self.data.find(b"\n", self.at, self.end)
        stop = self.end if stop < 0 else stop
        line = self.data[self.at:stop]
        self.at, self.place = stop + 1, self.place + 1
        return line.split(b"#")[0] if b"#" in line else line

    def head(self) -> tuple[str, list[int], bytes]:
        """Return letter, numbers and name of a segment."""
        line = self.line()
        letter = _letter(line[:1], self.place)
        words = line[1:].split()
        count = HEADS[letter]
        if len(words) != count + (letter in NAMED):
            fail(self.place, f"the head of a segment {letter} has {count + (letter in NAMED)} words, this {len(words)}")
        return letter, [_whole(word) for word in words[:count]], b"".join(words[count:])

    def pair(self, is_real: bool) -> tuple[int, float]:
        """Return an index and a value."""
        index, value = self.line().split()
        return _whole(index), _real(value)

    def integer(self) -> int:
        """Return a number of operands, or of the entries of a column."""
        (number,) = self.line().split()
        return _whole(number)

    def bound(self) -> tuple[int, list[float]]:
        """Return the kind of a bound and its numbers."""
        first, *numbers = self.line().split()
        kind = _bound_kind(_whole(first), self.place)
        if len(numbers) != BOUND_WORDS[kind]:
            fail(self.place, f"a bound of this kind has {BOUND_WORDS[kind]} numbers, this line {len(numbers)}")
        return kind, [_real(number) for number in numbers]

    def part(self) -> Part:
        """Return the next part of an expression."""
        if self.data[self.at:self.at + 1] == b"h":
            return self._string()
        line = self.line()
        kind = _kind(line[:1], self.place)
        if kind is Token.CALL:
            number, count = line[1:].split()
            return kind, _whole(number), _whole(count)
        (word,) = line[1:].split()
        return kind, _real(word) if kind is Token.NUMBER else _whole(word), 0

    def _string(self) -> Part:
        match = STRING.match(self.data, self.at)
        self.place += 1
        end = self.end if match is None else match.end() + int(match[1])
        stop = self.data.find(b"\n", end)
        if match is None or self.data[end:len(self.data) if stop < 0 else stop].strip():
            fail(self.place, "a string begins with its length, as h5:, and ends with its line")
        self.strings.append(self.data[match.end():end])
        self.place += self.strings[-1].count(b"\n")
        self.at = self.end if stop < 0 else stop + 1
        return Token.STRING, len(self.strings) - 1, 0


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

    def pair(self, is_real: bool) -> tuple[int, float]:
        """Return an index and a value."""
        form = self.real_pair if is_real else self.int_pair
        self.place = self._take(form.size)
        index, value = form.unpack_from(self.data, self.place)
        return index, value

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


def _whole(word: bytes) -> int:
    """Return a whole number; Python's own 1_000 is none."""
    if not word.lstrip(b"-").isdigit():
        raise ValueError
    return int(word)


def _real(word: bytes) -> float:
    if b"_" in word:
        raise ValueError
    return float(word)
