"""Binary ``.nl`` files, as AMPL writes them: the same segments in the same order as in text."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from lcp_plugin.interfaces.nl import write_nl
from lcp_plugin.interfaces.nl.reading import BIG_ENDIAN, LITTLE_ENDIAN, PARTNER, NLContent, Tree
from lcp_plugin.interfaces.nl.writing import TextWriter, count_behind, stated_bounds


def write_form(
    content: NLContent, path: Path, *, binary: bool = False, big_endian: bool = False
) -> None:
    """Write the content as text, or in either order of bytes; names lie beside it."""
    write_nl(content, path)
    if binary:
        path.write_bytes(b"".join(BinaryWriter(content, big_endian).parts()))


class BinaryWriter(TextWriter):
    """The segments as letters and numbers of fixed length."""

    format = "b"

    def __init__(self, content: NLContent, big_endian: bool) -> None:
        super().__init__(content)
        self.order = ">" if big_endian else "<"
        self.arithmetic = BIG_ENDIAN if big_endian else LITTLE_ENDIAN

    def _integers(self, *numbers: int) -> bytes:
        return struct.pack(f"{self.order}{len(numbers)}i", *numbers)

    def _line(self, letter: str, numbers: Iterable[int], text: bytes | None = None) -> None:
        self.out.append(letter.encode() + self._integers(*numbers))
        if text is not None:
            self.out.append(self._integers(len(text)) + text)

    def _pairs(self, indices: Any, values: Any) -> None:
        pairs = np.empty(
            len(indices), dtype=[("index", self.order + "i4"), ("value", self.order + "f8")]
        )
        pairs["index"], pairs["value"] = indices, values
        self.out.append(pairs.tobytes())

    def _columns(self, counts: Any) -> None:
        self._line("k", (counts.size,))
        self.out.append(counts.astype(self.order + "i4").tobytes())

    def _bounds(self, letter: str, lower: Any, upper: Any) -> None:
        self._line(letter, ())
        for kind, *numbers in stated_bounds(self.content, lower, upper, is_rows=letter == "r"):
            form = "i" if kind == PARTNER else "d"
            self.out.append(
                b"%d" % kind + struct.pack(f"{self.order}{len(numbers)}{form}", *numbers)
            )

    def _tree(self, tree: Tree) -> None:
        for kind, value, count in tree:
            self.out.append(kind.encode())
            if kind == "n":
                self.out.append(struct.pack(self.order + "d", value))
            else:
                behind = count_behind(int(value), count) if kind == "o" else 0
                self.out.append(self._integers(int(value), *[behind] * (behind > 0)))
