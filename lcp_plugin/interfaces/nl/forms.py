"""The two forms of ``.nl`` files: text, line by line, or bytes. Both give letters, numbers and names in the same order.

A place is the byte at which the last item read begins.
"""

from __future__ import annotations

import io
from struct import Struct
from typing import Any, NoReturn

CONVERTERS: dict[str, type] = {"i": int, "h": int, "d": float}
NO_NUMBERS = (
    "this is neither a number nor a letter of the format, or there are not as many as are needed"
)


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
        line = self._file.readline()
        self._next = self.at + len(line)
        return line.split(b"#")[0] if b"#" in line else line

    def _numbers(self, form: str, words: list[bytes]) -> list[Any]:
        try:
            return [CONVERTERS[kind](word) for kind, word in zip(form, words, strict=True)]
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
