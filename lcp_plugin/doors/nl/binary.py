"""Binary ``.nl`` files, of either byte order: the segments of the text files, with numbers of fixed length."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from struct import Struct
from typing import Any

import numpy as np

from .content import (
    ARITY,
    BOUND_WORDS,
    NARY,
    NO_OPERATOR,
    PARTNER,
    PIECEWISE,
    SUFFIX_IS_REAL,
    Bounds,
    Forest,
    Header,
    Linear,
    NamedValues,
    Segments,
    Token,
    fail,
)


def read_binary(data: bytes, begin: int, header: Header, found: Segments) -> None:
    """Fill in the segments of a binary file that begin at that byte."""
    _Bytes(data, begin, header, found).read()


class _Pairs:
    """Linear segments of one letter in the making."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = dtype
        self.heads = array("q")
        self.pairs = bytearray()

    def whole(self) -> Linear:
        """Return them."""
        owners, counts, places, first_places = np.array(self.heads, dtype=np.int64).reshape(-1, 4).T.copy()
        pairs = np.frombuffer(self.pairs, self.dtype)
        return Linear(owners, counts, places, first_places, self.dtype.itemsize, pairs["index"].astype(np.float64),
                      pairs["value"].astype(np.float64))


class _Trees:
    """Expression trees of one letter in the making."""

    def __init__(self) -> None:
        self.owners, self.places, self.starts = array("q"), array("q"), array("q", [0])
        self.kinds, self.values, self.counts, self.token_places = array("B"), array("d"), array("q"), array("q")

    def whole(self) -> Forest:
        whole = [np.array(part, dtype=np.int64) for part in (self.owners, self.places, self.counts, self.token_places,
                                                             self.starts)]
        kinds, values = np.array(self.kinds, dtype=np.uint8), np.array(self.values)
        return Forest(whole[0], whole[1], kinds, values, whole[2], whole[3], whole[4])


class _Bytes:
    """A file and the place in it; every read checks that the file goes that far."""

    def __init__(self, data: bytes, begin: int, header: Header, found: Segments) -> None:
        self.data, self.at, self.end, self.header = data, begin, len(data), header
        order = header.byteorder
        self.order = order
        self.int_of = Struct(order + "i")
        self.pair_of = {value: np.dtype([("index", order + "i4"), ("value", order + value)]) for value in ("f8", "i4")}
        self.readers: dict[int, tuple[int, int, Callable[..., Any]]] = {
            ord(letter): (kind, (form := Struct(order + code)).size, form.unpack_from) for letter, kind, code in (
                ("n", Token.NUMBER, "d"), ("l", Token.NUMBER, "i"), ("s", Token.NUMBER, "h"),
                ("v", Token.VARIABLE, "i"), ("o", Token.OPERATOR, "i"), ("f", Token.CALL, "i"),
            )
        }
        self.found = found
        self.pairs: dict[str, _Pairs] = {}
        self.trees: dict[str, _Trees] = {}

    def read(self) -> None:
        """Fill in the segments."""
        while self.at < self.end:
            letter = chr(self.data[self.at])
            if letter not in "CLOVJGxdbrkKFS":
                fail(self.at, f"no segment begins with {letter!r}")
            self.at += 1
            self._segment(letter, self.at - 1)
        self.found.linear |= {letter: pairs.whole() for letter, pairs in self.pairs.items()}
        self.found.trees |= {letter: trees.whole() for letter, trees in self.trees.items()}

    def _segment(self, letter: str, place: int) -> None:
        if letter in "CLO":
            owner = self._int()
            if letter == "O":
                sense = self._int()
                if sense not in (0, 1):
                    fail(place, f"the sense of an objective is {sense}, and only 0 and 1 are possible here")
                self.found.senses.append(sense)
            self._tree(letter, owner, place)
        elif letter == "V":
            owner, count = self._int(), self._int()
            self._int()
            self._linear("V", owner, count, place)
            self._tree("V", owner, place)
        elif letter in "JG":
            self._linear(letter, self._int(), self._int(), place)
        elif letter == "F":
            number, _, _ = self._int(), self._int(), self._int()
            self.found.functions.append((place, number, self._text()))
        elif letter == "S":
            self._suffix(place)
        elif letter in self.pairs or letter in self.found.bounds or (
            letter in "kK" and self.found.column_counts is not None
        ):
            fail(place, f"a second segment {letter}; a file has one")
        elif letter in "xd":
            self._linear(letter, 0, self._int(), place)
        elif letter in "br":
            self._bounds(letter)
        else:
            dtype, count = np.dtype(self.order + "i4"), max(self._int(), 0)
            counts = np.frombuffer(self.data, dtype, count, self._room(dtype, count, "counts of columns"))
            self.found.column_counts, self.found.column_place = counts.astype(np.float64), place
            self.found.is_cumulative = letter == "k"

    def _take(self, length: int) -> int:
        """Return where so many bytes begin, and go behind them."""
        begin = self.at
        if self.end - begin < length:
            fail(self.end, "the file ends within a segment")
        self.at = begin + length
        return begin

    def _int(self) -> int:
        return int(self.int_of.unpack_from(self.data, self._take(4))[0])

    def _text(self) -> bytes:
        place, length = self.at, self._int()
        if not 0 <= length <= self.end - self.at:
            fail(place, f"a text of {length} bytes is announced, and {self.end - self.at} follow")
        begin = self._take(length)
        return self.data[begin:begin + length]

    def _room(self, dtype: Any, count: int, what: str) -> int:
        """Return where so many numbers begin, after a look at whether they are there, and go behind them."""
        room = (self.end - self.at) // dtype.itemsize
        if not 0 <= count <= room:
            fail(self.at, f"{count} {what} are announced, and there is room for {room}")
        return self._take(count * dtype.itemsize)

    def _linear(self, letter: str, owner: int, count: int, place: int, value: str = "f8") -> None:
        dtype = self.pair_of[value]
        first = self._room(dtype, count, "pairs of an index and a value")
        pairs = self.pairs.setdefault(letter, _Pairs(dtype))
        pairs.heads.extend((owner, count, place, first))
        pairs.pairs += self.data[first:self.at]

    def _suffix(self, place: int) -> None:
        bits, count = self._int(), self._int()
        name = self._text()
        if not 0 <= bits < 2 * SUFFIX_IS_REAL:
            fail(place, f"the kind of a suffix is {bits}, and only 0 to {2 * SUFFIX_IS_REAL - 1} is possible here")
        self._linear("S", 0, count, place, "f8" if bits & SUFFIX_IS_REAL else "i4")
        self.found.suffixes.append(NamedValues(name, bits, self.pairs.pop("S").whole()))

    def _bounds(self, letter: str) -> None:
        count = self.header.variables if letter == "b" else self.header.rows
        kinds, first, second, places = array("B"), array("d"), array("d"), array("q")
        one, two, partner = (Struct(self.order + form) for form in ("d", "dd", "ii"))
        data = self.data
        for _ in range(count):
            at = self._take(1)
            kind = data[at] - ord("0")
            if not 0 <= kind <= PARTNER:
                fail(at, "a bound's kind is 0 to 5")
            numbers: tuple[float, ...] = ()
            if kind == PARTNER:
                numbers = partner.unpack_from(data, self._take(8))
            elif words := BOUND_WORDS[kind]:
                numbers = (one if words == 1 else two).unpack_from(data, self._take(8 * words))
            kinds.append(kind)
            first.append(numbers[0] if numbers else 0.0)
            second.append(numbers[1] if len(numbers) > 1 else 0.0)
            places.append(at)
        self.found.bounds[letter] = Bounds(
            np.array(kinds, dtype=np.float64), np.array(first), np.array(second), np.array(places, dtype=np.int64)
        )

    def _tree(self, letter: str, owner: int, place: int) -> None:
        """Read tokens until every operand has come."""
        trees = self.trees.setdefault(letter, _Trees())
        trees.owners.append(owner)
        trees.places.append(place)
        add_kind, add_value = trees.kinds.append, trees.values.append
        add_count, add_place = trees.counts.append, trees.token_places.append
        data, readers, wanted = self.data, self.readers, 1
        while wanted:
            at = self._take(1)
            reader = readers.get(data[at])
            if reader is not None:
                kind, length, unpack = reader
                value = unpack(data, self._take(length))[0]
            elif data[at] == ord("h"):
                kind, value = Token.STRING, len(self.found.strings)
                self.found.strings.append(self._text())
            else:
                fail(at, "a part of an expression is needed here")
            count = 0
            if kind == Token.OPERATOR:
                count = self._operands(value, at)
            elif kind == Token.CALL:
                count = self._count(0, at)
            add_kind(kind)
            add_value(value)
            add_count(count)
            add_place(at)
            wanted += count - 1
        trees.starts.append(len(trees.kinds))

    def _operands(self, operator: int, at: int) -> int:
        arity = int(ARITY[operator]) if 0 <= operator < ARITY.size else NO_OPERATOR
        if arity == NO_OPERATOR:
            fail(at, "there is no operator of this number")
        if arity == NARY:
            return self._count(1, at)
        return 2 * self._count(2, at) if arity == PIECEWISE else arity

    def _count(self, least: int, at: int) -> int:
        count = self._int()
        if not least <= count <= self.end - self.at:
            fail(at, f"{count} operands are announced, and {self.end - self.at} bytes follow")
        return count
