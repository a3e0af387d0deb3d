"""A table of texts and numbers, as Markdown and as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any


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
        has_number = [any(isinstance(one, int | float) for one in column) for column in columns]
        marks = ["---:" if is_number else ":---" for is_number in has_number]
        texts = ([*map(_cell, row)] for row in self.rows)
        lines = [f"| {' | '.join(cells)} |" for cells in (self.columns, *texts)]
        return "\n".join([lines[0], f"|{'|'.join(marks)}|", *lines[1:], ""])


def _cell(value: Any) -> str:
    """Return a number with three digits, – for none, a text unchanged."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV text; floats keep all their digits."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()
