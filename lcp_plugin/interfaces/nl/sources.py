"""The two forms of ``.nl`` files, each as one row of items, since a text of 10⁵ variables has 10⁶ lines.

An item is the head of a segment, a part of an expression, or numbers alone: a pair, a bound, a count.
"""

from __future__ import annotations

import re
import warnings
from array import array
from itertools import chain, pairwise
from struct import Struct
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector
from .content import NARY_OPERATORS, PARTNER, PIECEWISE_OPERATOR, SUFFIX_IS_REAL, Fault, Header, Indices

#: How many numbers stand behind the letter of a segment; a name follows in F and S.
HEADS = {"C": 1, "L": 1, "O": 2, "V": 3, "G": 2, "J": 2, "b": 0, "r": 0, "k": 1, "K": 1, "x": 1, "d": 1, "F": 3, "S": 2}
NAMED, OWNED = b"FS", "CLOVGJF"  # of the latter the first number says whose they are
PAIRS = {"V": 1, "J": 1, "G": 1, "S": 1, "x": 0, "d": 0}  # which of them says how many pairs follow
PARTS = {"n": 1, "l": 1, "s": 1, "v": 1, "o": 1, "f": 2, "h": 0}  # the same of parts of expressions; h is a string
LETTERS = HEADS | PARTS
ALONE = 0  # the letter of numbers alone
IS_HEAD = np.isin(np.arange(256), [ord(letter) for letter in HEADS])
WORDS = np.zeros(256, dtype=np.uint8)
WORDS[[ALONE, *map(ord, PARTS)]] = [1, *PARTS.values()]  # alone in an expression is a number of operands
LETTER_OF = bytes(code if chr(code) in LETTERS else ALONE for code in range(256))  # a line, by its first byte
COUNTED_OPERATORS = {*NARY_OPERATORS, PIECEWISE_OPERATOR}  # behind which a number of operands stands
STRING = re.compile(rb"\nh(\d{1,9}):")
BYTES_AT_ONCE = 1 << 20  # of which numbers are read: what is needed beside them stays small
NO_NUMBERS = "this is neither a number nor a letter of the format, or there are not as many as are needed"
WRONG_KIND = f"a bound's kind is 0 to {PARTNER}"
NO_SEGMENT = f"no segment begins here; the letters are {' '.join(HEADS)}"


class Segments(NamedTuple):
    """Those of one letter: their heads and ends among the items, whose they are from 0 on, and the heads' numbers."""

    letter: str
    heads: Indices
    ends: Indices
    owners: Indices
    numbers: list[FloatVector]


class Items:
    """The items of a file in their order, and its end as one more.

    Attributes
    ----------
    letters : ndarray of uint8, shape (t + 1,)
    places : ndarray of int, shape (t + 1,)
        The byte at which each begins.
    first : ndarray of int, shape (t + 1,)
        Which of the numbers is the first of each.
    numbers : ndarray, shape (k + 2,)
        Of all items, and two zeros.
    names : dict of int to bytes
        Of functions and suffixes, by their heads.
    strings : list of bytes
        Those in expressions, which may hold any bytes.
    initials : bytes
        The letters of all heads; K, whose counts are not cumulative, as k.
    """

    def __init__(
        self, letters: Any, places: Any, first: Any, numbers: Any, names: dict[int, bytes], strings: list[bytes]
    ) -> None:
        self.letters, self.places, self.first, self.numbers, self.names = letters, places, first, numbers, names
        self.strings, self.count = strings, letters.size - 1
        self._heads = np.flatnonzero(IS_HEAD[letters]).astype(first.dtype)
        self._ends = np.append(self._heads[1:], self._heads.dtype.type(self.count))
        self.initials = letters[self._heads].tobytes().replace(b"K", b"k")
        if self.count and not IS_HEAD[letters[0]]:
            self.fail(0, NO_SEGMENT)

    def fail(self, item: int, what: str) -> NoReturn:
        """Raise the Fault of an item."""
        raise Fault(self.places[item], what if item < self.count else "the file ends within a segment")

    def require(self, holds: Any, items: Indices, what: str, *values: Any) -> None:
        """Raise for the first item of which it does not hold, with its values."""
        if not _all(holds):
            k = int(np.argmin(holds))
            self.fail(items[k], what.format(*(value[k] for value in values)))

    def order(self, keys: Any, items: Indices, what: str, values: Any) -> Any:
        """Return the order in which the keys increase; raise where one comes a second time."""
        if _all(keys[1:] > keys[:-1]):
            return slice(None)
        order = np.unique(keys, return_index=True)[1]
        if order.size < keys.size:
            self.require(np.isin(np.arange(keys.size), order), items, what, values)
        return order

    def numbers_of(self, items: Indices, count: int) -> list[FloatVector]:
        """Return the numbers of items that have so many each."""
        first = self.first[items]
        self.require(self.first[items + 1] - first == count, items, NO_NUMBERS)
        return [self.numbers[first + k] for k in range(count)]

    def segments(self, letter: str, count: int = 1, first: int = 0) -> Segments:
        """Return the segments of a letter, each of another one of so many owners, numbered from `first`; S has none."""
        if letter.encode() not in self.initials:
            none = self._heads[:0]
            return Segments(letter, none, none, none, [np.zeros(0)] * HEADS[letter])
        which = np.flatnonzero(np.frombuffer(self.initials, dtype=np.uint8) == ord(letter))
        heads = self._heads[which]
        numbers = self.numbers_of(heads, HEADS[letter])
        if letter in OWNED:
            owners: Any = numbers[0] - first
            self.require(is_whole(owners, count), heads, f"a segment {letter} has a number from {first} to "
                         f"{first + count - 1}" if count else
                         f"the head announces nothing that a segment {letter} could belong to")
            self.order(owners, heads, f"a second segment {letter}{{:.0f}}; a file has one", numbers[0])
        else:
            owners = np.arange(heads.size)
            self.require(owners < count, heads, f"a second segment {letter}; a file has one")
        return Segments(letter, heads, self._ends[which], owners.astype(np.int64), numbers)

    def alone(self, segments: Segments, counts: Any) -> tuple[Indices, Indices]:
        """Return the numbers alone behind the heads, as many as announced, and what comes behind them."""
        begins = segments.heads + 1
        behind = begins + np.fmax(np.fmin(counts, segments.ends - begins), 0).astype(begins.dtype)
        items = runs_of(begins, behind - begins)
        self.require(self.letters[items] == ALONE, items, NO_NUMBERS)
        is_all = behind - begins == counts
        self.require(is_all if segments.letter == "V" else is_all & (behind == segments.ends), behind, NO_NUMBERS)
        return items, behind

    def pairs(self, segments: Segments, limits: Any) -> tuple[Indices, FloatVector, Indices]:
        """Return indices below the limit of each segment, values, and what comes behind the pairs of each.

        They are sorted within each segment, but of suffixes, of which whatever they say is let pass.
        """
        if not segments.heads.size:
            return segments.heads, np.zeros(0), segments.heads
        items, behind = self.alone(segments, segments.numbers[PAIRS[segments.letter]])
        lengths = behind - segments.heads - 1
        indices, values = self.numbers_of(items, 2)
        limits = np.repeat(limits, lengths)
        self.require(is_whole(indices, limits), items, "the index {:g} lies outside 0 … {:g}", indices, limits - 1)
        if segments.letter != "S":
            self.require(np.isfinite(values), items, "the value {} is not finite", values)
            keys = np.repeat(segments.owners * limits.max(initial=0), lengths) + indices
            order = self.order(keys, items, "a second entry of variable {:g} in one segment", indices)
            indices, values = indices[order], values[order]
        return indices.astype(np.int64), values, behind


def _all(holds: NDArray[np.bool_]) -> bool:
    """Return holds.all() in a quarter of its time, which small files see."""
    return int(np.count_nonzero(holds)) == holds.size


def is_whole(values: Any, limit: Any) -> NDArray[np.bool_]:
    """Return which are whole numbers from 0 to below the limit."""
    is_whole: NDArray[np.bool_] = (values >= 0) & (values < limit) & (values == np.floor(values))
    return is_whole


def runs_of(begins: Indices, counts: Indices) -> Indices:
    """Return begins[0], begins[0] + 1 … counts[0] of them, then those of the next."""
    ends = np.cumsum(counts, dtype=begins.dtype)
    runs: Indices = np.repeat(begins - ends + counts, counts)
    runs += np.arange(runs.size, dtype=runs.dtype)
    return runs


def items_of(data: bytes, begin: int, header: Header) -> Items:
    """Return the items of a file whose segments begin at that byte."""
    return _Binary(data, begin, header).items() if header.is_binary else _items_of_text(data, begin)


def _items_of_text(data: bytes, begin: int) -> Items:
    """Return one item for each line; blank ones at the end do not count."""
    text = bytearray(data[begin:].rstrip())
    if text:
        text += b"\n"
    strings, names = _cut_strings(text, begin), {}
    view = np.frombuffer(text, dtype=np.uint8)
    kind = np.int32 if len(data) < 2**31 else np.int64
    begins: Any = np.append(-1, np.flatnonzero(view == ord("\n"))).astype(kind)
    begins += 1
    if b"#" in text:
        _blank_comments(view, begins[1:] - 1)
    letters = np.frombuffer(view[begins[:-1]].tobytes().translate(LETTER_OF) + bytes([ALONE]), dtype=np.uint8)
    for item in np.flatnonzero((letters == NAMED[0]) | (letters == NAMED[1])).tolist():
        line = bytes(text[begins[item]:begins[item + 1]]).rstrip()
        names[item] = line.split()[-1]
        view[begins[item] + len(line) - len(names[item]):begins[item + 1]] = ord(" ")
    view[begins[:-1][letters[:-1] > 0]] = ord(" ")
    first, numbers = _words(view, begins, begin)
    return Items(letters, begins + begin, first, numbers, names, strings)


def _cut_strings(text: bytearray, begin: int) -> list[bytes]:
    """Return what stands behind h, and blank it; each goes with its length before it, over lines if need be."""
    strings = []
    for match in STRING.finditer(text):
        end = match.end() + int(match[1])
        stop = text.find(b"\n", end)
        if stop < 0 or text[end:stop].strip():
            raise Fault(begin + match.start() + 1, "a string begins with its length, as h5:, and ends with its line")
        strings.append(bytes(text[match.end():end]))
        text[match.start(1):end] = b" " * (end - match.start(1))
    return strings


def _blank_comments(text: NDArray[np.uint8], ends: Indices) -> None:
    """Overwrite with blanks what stands between a # and the end of its line."""
    hashes = np.flatnonzero(text == ord("#"))
    stops = np.searchsorted(ends, hashes)
    hashes = hashes[np.concatenate([[True], stops[1:] > stops[:-1]])]  # the first of each line
    change = np.zeros(text.size, dtype=np.int8)
    change[hashes], change[ends[stops]] = 1, -1
    text[np.cumsum(change, out=change) == 1] = ord(" ")


def _words(text: NDArray[np.uint8], begins: Indices, place: int) -> tuple[Indices, FloatVector]:
    """Return which word is the first of each line, and all words as numbers."""
    first = np.zeros(begins.size, dtype=begins.dtype)
    blocks = [*np.searchsorted(begins, np.arange(0, text.size, BYTES_AT_ONCE)).tolist(), begins.size - 1]
    parts = []
    for i, k in pairwise(blocks):
        part = text[begins[i]:begins[k]]
        is_word = part > ord(" ")
        is_word[1:] &= part[:-1] <= ord(" ")
        words = np.flatnonzero(is_word)
        first[i + 1:k + 1] = first[i] + words.searchsorted(begins[i + 1:k + 1] - begins[i])
        numbers = _numbers(part, words.size)
        if numbers is None:
            counts = np.diff(first)
            bad = next(j for j in range(i, k) if _numbers(text[begins[j]:begins[j + 1]], int(counts[j])) is None)
            raise Fault(place + begins[bad], NO_SEGMENT if chr(text[begins[bad]]).isalpha() else NO_NUMBERS)
        parts.append(numbers)
    return first, np.concatenate([*parts, np.zeros(2)])


def _numbers(text: NDArray[np.uint8], count: int) -> FloatVector | None:
    """Return the words of a text as numbers, or None where there are not `count` of them."""
    if not count:  # of blanks alone numpy makes a number
        return None if text.tobytes().strip() else np.zeros(0)
    try:
        with warnings.catch_warnings():  # what numpy 2.3 and later raise, older ones warn of
            warnings.simplefilter("error", DeprecationWarning)
            numbers: FloatVector = np.fromstring(text.tobytes(), sep=" ")
    except (ValueError, DeprecationWarning):
        return None
    return numbers if numbers.size == count else None


class _Binary:
    """What has been read of a binary file."""

    def __init__(self, data: bytes, begin: int, header: Header) -> None:
        self.data, self.at, self.header, self.order = data, begin, header, header.byteorder
        self.letters, self.numbers = bytearray(), array("d")
        self.places, self.first = (array("i" if len(data) < 2**31 else "q") for _ in range(2))
        self.names, self.strings = dict[int, bytes](), list[bytes]()

    def items(self) -> Items:
        """Return the items."""
        data, end = self.data, len(self.data)
        forms = {ord(letter): Struct(f"{self.order}{count}i") for letter, count in LETTERS.items()}
        forms |= {ord("n"): Struct(self.order + "d"), ord("s"): Struct(self.order + "h")}
        while self.at < end:
            code = data[self.at]
            if code not in forms:
                raise Fault(self.at, NO_SEGMENT)
            own = self._add(code, forms[code])
            if code not in b"nlsv" and (code != ord("o") or own[0] in COUNTED_OPERATORS):
                self._add_behind(chr(code), *own)
        self.letters.append(ALONE)
        self.places.append(end)
        self.first.append(len(self.numbers))
        self.numbers.extend((0.0, 0.0))
        letters, places, first, numbers = map(np.asarray, (self.letters, self.places, self.first, self.numbers))
        return Items(letters, places, first, numbers, self.names, self.strings)

    def _add(self, code: int, form: Struct, *kind: int) -> tuple[Any, ...]:
        """Add an item of one byte and numbers, which are returned."""
        place = self._take(1 + form.size)
        own = (*kind, *form.unpack_from(self.data, place + 1))
        self.letters.append(code)
        self.places.append(place)
        self.first.append(len(self.numbers))
        self.numbers.extend(own)
        return own

    def _add_behind(self, letter: str, *own: int) -> None:
        """Add what stands behind a letter and its numbers: a text, numbers alone."""
        if letter == "h":
            self.strings.append(self._text())
        elif letter in "FS":
            self.names[len(self.letters) - 1] = self._text()
        if letter in PAIRS:
            self._add_all("id" if letter != "S" or own[0] & SUFFIX_IS_REAL else "ii", own[PAIRS[letter]])
        elif letter in "okK":
            self._add_all("i", 1 if letter == "o" else max(own[0], 0))  # −1 without variables
        elif letter in "br":
            forms = {b"%d" % k: Struct(self.order + form) for k, form in enumerate(("dd", "d", "d", "", "d", "ii"))}
            for _ in range(self.header.variables if letter == "b" else self.header.rows):
                kind = self.data[self.at:self.at + 1]
                if kind not in forms:
                    raise Fault(self.at, WRONG_KIND)
                self._add(ALONE, forms[kind], int(kind))

    def _add_all(self, form: str, count: int) -> None:
        """Add so many items of numbers alone."""
        numbers = Struct(self.order + form)
        begin, first = self._take(count * numbers.size), len(self.numbers)
        self.letters += bytes(count)
        self.places.extend(range(begin, begin + count * numbers.size, numbers.size))
        self.first.extend(range(first, first + count * len(form), len(form)))
        self.numbers.extend(chain.from_iterable(numbers.iter_unpack(self.data[begin:self.at])))

    def _take(self, length: int) -> int:
        """Return where so many bytes begin, and go behind them."""
        begin, left = self.at, len(self.data) - self.at
        if not 0 <= length <= left:
            raise Fault(begin, f"{length} bytes are needed here, and {left} follow")
        self.at = begin + length
        return begin

    def _text(self) -> bytes:
        length = Struct(self.order + "i").unpack_from(self.data, self._take(4))
        begin = self._take(*length)
        return self.data[begin:self.at]
