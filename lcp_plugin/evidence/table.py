"""A table of texts and numbers, as Markdown and as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

DIGITS = 3
PLAIN = (1e-3, 1e6)  # a column of numbers between these is printed without powers of ten


@dataclass(frozen=True)
class Table:
    """A table to print.

    Attributes
    ----------
    title : str
    columns : sequence of str
        Headings.
    rows : sequence of sequences
        Texts, numbers and None. CSV keeps all digits, Markdown three.

    Examples
    --------
    >>> print(Table("t", ("method", "passes"), [("psor", 12.345), ("lemke", None)]).to_markdown())
    | method | passes |
    |:---|---:|
    | psor | 12.3 |
    | lemke | – |
    <BLANKLINE>
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]

    def __str__(self) -> str:
        return f"{self.title}\n\n{self.to_markdown()}"

    def to_markdown(self) -> str:
        """Return the table as Markdown, numbers to the right."""
        columns = [[row[k] for row in self.rows] for k in range(len(self.columns))]
        marks = ["---:" if any(map(_is_number, column)) else ":---" for column in columns]
        texts = zip(*map(_shown, columns), strict=True)
        lines = [f"| {' | '.join(cells)} |" for cells in (self.columns, *texts)]
        return "\n".join([lines[0], f"|{'|'.join(marks)}|", *lines[1:], ""])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _shown(column: Sequence[Any]) -> list[str]:
    """Return the cells of a column, its numbers alike: with as many decimals, or with powers of ten."""
    numbers = [abs(value) for value in column if _is_number(value) and value]
    low, high = min(numbers, default=1.0), max(numbers, default=1.0)
    is_plain = PLAIN[0] <= low and high < PLAIN[1] and high / low < 1e4
    given = max(
        (len(repr(value).partition(".")[2]) for value in column if isinstance(value, float)),
        default=0,
    )
    decimals = min(max(0, DIGITS - 1 - math.floor(math.log10(low))), given)

    def shown(value: Any) -> str:
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            return "–"
        if not isinstance(value, float):
            return str(value)
        if is_plain:
            return f"{value + 0.0:.{decimals}f}"
        digits, _, power = f"{value:.1e}".partition("e")
        return f"{digits}e{int(power)}"

    return [shown(value) for value in column]


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV text; floats keep all their digits."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()
