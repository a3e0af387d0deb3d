"""The two forms of ``.nl`` files: text, line by line, or bytes. Both give letters, numbers and names in the same order.

A place is the byte at which the last item read begins.
"""

from __future__ import annotations

import io
from struct import Struct
from typing import Any, NoReturn

from .content import PARTNER

BOUNDS = ("dd", "d", "d", "", "d", "ii")  # the numbers behind the kind of a bound
#: Conversion of words to numbers, integers (i) or not (d).
CONVERTERS: dict[str, list[type]] = {
    form: [int if kind == "i" else float for kind in form]
    for form in ("", "i", "ii", "iii", "id", "d", "dd")
}
NUMBERS = {"n": "d", "l": "i", "s": "h"}  # the letters of numbers, and their forms in bytes
NO_NUMBERS = (
    "this is neither a number nor a letter of the format, or there are not as many as are needed"
)
WRONG_KIND = f"a bound's kind is 0 to {PARTNER}"


class NLSyntaxError(ValueError):
    """Error in a file, with its line or byte."""

    def __init__(self, place: int, what: str) -> None:
        super().__init__(what)
        self.place = place


class _Form:
    data: bytes
    at: int

    def fail(self, what: str) -> NoReturn:
        """Raise NLSyntaxError at the last item read."""
        raise NLSyntaxError(
            self.at, what if self.at < len(self.data) else "the file ends within a segment"
        )


class TextFormReader(_Form):
    """The segments of a text file; blank lines at its end do not count, and comments begin with #.

    Attributes
    ----------
    at : int
        The place of the line that has been read last.
    """

    def __init__(self, data: bytes, begin: int) -> None:
        self.data = data.rstrip() + b"\n"
        self._file = io.BytesIO(self.data)
        self._file.seek(begin)
        self.at = self._next = begin
        self._words: list[bytes] = []

    def letter(self) -> str:
        """Return the first letter of the next line, nothing at the end of the file."""
        line = self._line()
        self._words = line[1:].split()
        return chr(line[0]) if line else ""

    def integers(self, count: int, *, has_name: bool = False) -> list[Any]:
        """Return the integers behind the letter."""
        return self._numbers("i" * count, self._words[: len(self._words) - has_name])

    def real(self, letter: str) -> float:
        """Return the number that follows a letter of type."""
        value: float = self._numbers("d", self._words)[0]
        return value

    def row(self, form: str) -> list[Any]:
        """Return the numbers of the next line, whole ones (i) or not (d)."""
        return self._numbers(form, self._line().split())

    def bound(self) -> list[Any]:
        """Return the type of a bound and the numbers that follow."""
        kind, *words = self._line().split() or [b""]
        (number,) = self._numbers("i", [kind])
        if not 0 <= number < len(BOUNDS):
            self.fail(WRONG_KIND)
        return [number, *self._numbers(BOUNDS[number], words)]

    def _line(self) -> bytes:
        self.at = self._next
        line = self._file.readline()
        self._next = self.at + len(line)
        return line.split(b"#")[0] if b"#" in line else line

    def _numbers(self, form: str, words: list[bytes]) -> list[Any]:
        try:
            return [kind(word) for kind, word in zip(CONVERTERS[form], words, strict=True)]
        except ValueError:
            self.fail(NO_NUMBERS)


class BinaryFormReader(_Form):
    """The segments of a binary file, read as `TextFormReader` is.

    Parameters
    ----------
    data : bytes
    begin : int
    order : str
        "<" or ">", as struct writes it.
    """

    def __init__(self, data: bytes, begin: int, order: str) -> None:
        self.data, self.order = data, order
        self.at = self._next = begin
        self._structs: dict[str, Struct] = {}

    def letter(self) -> str:
        """Return the next byte as a letter, nothing at the end of the file."""
        self.at = self._next
        self._next += 1
        return chr(self.data[self.at]) if self.at < len(self.data) else ""

    def integers(self, count: int, *, has_name: bool = False) -> list[Any]:
        """Return the integers behind the letter."""
        numbers = self._numbers("i" * count)
        if has_name:
            self._take(self._numbers("i")[0])
        return numbers

    def real(self, letter: str) -> float:
        """Return the number that follows a letter of type."""
        return float(self._numbers(NUMBERS[letter])[0])

    def row(self, form: str) -> list[Any]:
        """Return the next numbers, whole ones (i) or not (d)."""
        self.at = self._next
        return self._numbers(form)

    def bound(self) -> list[Any]:
        """Return the type of a bound and the numbers that follow."""
        kind = self.letter()
        if kind not in {str(number) for number in range(len(BOUNDS))}:
            self.fail(WRONG_KIND)
        return [int(kind), *self._numbers(BOUNDS[int(kind)])]

    def _numbers(self, form: str) -> list[Any]:
        if form not in self._structs:
            self._structs[form] = Struct(self.order + form)
        struct = self._structs[form]
        return list(struct.unpack_from(self.data, self._take(struct.size)))

    def _take(self, length: int) -> int:
        """Return the start of a given number of bytes, and move on by it."""
        begin, left = self._next, len(self.data) - self._next
        if not 0 <= length <= left:
            raise NLSyntaxError(begin, f"{length} bytes are needed here, and {left} follow")
        self._next = begin + length
        return begin
