"""How measurements leave the program: as JSON, CSV and pictures, each file written whole or not at all."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from os import PathLike
from typing import Any, ClassVar

from ..problem.files import checked_path, write_whole

AnyPath = str | PathLike[str]


class Exported:
    """What a table of measurements can do: become JSON, CSV or a figure, and be saved as that."""

    columns: ClassVar[Sequence[str]]

    def to_content(self) -> dict[str, Any]:
        """Return everything as dictionaries and lists that JSON can hold; numbers that are not finite become None."""
        content: dict[str, Any] = finite_content(asdict(self))  # type: ignore[call-overload]
        return content

    def rows(self) -> list[tuple[Any, ...]]:
        """Return the rows of the CSV."""
        raise NotImplementedError

    def to_json(self, path: AnyPath | None = None) -> str:
        """Return everything as JSON text, and write it to `path` where one is given."""
        return _written(json.dumps(self.to_content(), indent=1, ensure_ascii=False), path)

    def to_csv(self, path: AnyPath | None = None) -> str:
        """Return the rows as CSV text, and write it to `path` where one is given."""
        return _written(csv_text(self.columns, self.rows()), path)


def _written(text: str, path: AnyPath | None) -> str:
    if path is not None:
        write_text(path, text)
    return text


def finite_content(value: Any) -> Any:
    """Return the value with every number that JSON does not know replaced by None, tuples as lists."""
    if isinstance(value, Mapping):
        return {key: finite_content(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite_content(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def number(value: float | None) -> float:
    """Return the value, NaN for None."""
    return math.nan if value is None else float(value)


def csv_text(columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table as CSV text; floats keep all their digits."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return buffer.getvalue()


def csv_of(entries: Sequence[Mapping[str, Any]]) -> str:
    """Return dictionaries as CSV text; a field stays empty where one lacks what another has."""
    columns = dict.fromkeys(name for entry in entries for name in entry)
    return csv_text(columns, ([entry.get(name, "") for name in columns] for entry in entries))


def write_text(path: AnyPath, text: str) -> None:
    """Write the whole file or nothing."""
    write_whole({checked_path(path): lambda file: file.write(text.encode("utf-8"))})
