"""How measurements leave the program: as JSON, CSV, LaTeX and Markdown, each file written whole or not at all."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any, ClassVar

from ..core.errors import InvalidOption
from ..interfaces.files.files import checked_path, write_whole
from .drawing import FORMATS, save

AnyPath = str | PathLike[str]
DIGITS = 3
PLAIN = (1e-3, 1e6)
"""Between these a column of numbers does without powers of ten."""

PACKAGES = "\\usepackage{booktabs,siunitx}"
LATEX = {
    "\\": "\\textbackslash{}",
    "~": "\\textasciitilde{}",
    "^": "\\textasciicircum{}",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "δ": "$\\delta$",
    "α": "$\\alpha$",
    "β": "$\\beta$",
    "ω": "$\\omega$",
    "Ω": "$\\Omega$",
    "ρ": "$\\rho$",
    "–": "--",
    "≤": "$\\le$",
    "≥": "$\\ge$",
    "×": "$\\times$",
    "∞": "$\\infty$",
    "‖": "$\\Vert$",
    "…": "\\dots{}",
}


class Exported:
    """What a table of measurements can do: become JSON, CSV or a figure, and be saved as one of these."""

    columns: ClassVar[Sequence[str]]
    if TYPE_CHECKING:
        plot: ClassVar[Any]  # a method of each, with options of its own

    def to_content(self) -> dict[str, Any]:
        """Return everything as dictionaries and lists that JSON can hold; numbers that are not finite become None."""
        content: dict[str, Any] = finite_content(asdict(self))  # type: ignore[call-overload]
        return content

    def rows(self) -> list[tuple[Any, ...]]:
        """Return the rows of the CSV."""
        raise NotImplementedError

    def to_json(self) -> str:
        """Return everything as JSON text."""
        return json.dumps(self.to_content(), indent=1, ensure_ascii=False)

    def to_csv(self) -> str:
        """Return the rows as CSV text."""
        return csv_text(self.columns, self.rows())

    def save(self, path: AnyPath, **how: Any) -> None:
        """Write a file whose ending says what: .png, .pdf, .svg the figure, .csv the rows, .json everything.

        Parameters
        ----------
        path : path
        **how
            Of `plot`, where it is a figure.

        Raises
        ------
        InvalidOption
            Where the name has another ending, or more is said of a table.
        """
        place = checked_path(path)
        texts = {".csv": self.to_csv, ".json": self.to_json}
        kind = place.suffix.lower()
        if kind not in (*texts, *FORMATS):
            endings = ", ".join([*FORMATS, *texts])
            raise InvalidOption(f"a file of measurements must end in {endings}, got {place.name!r}")
        if kind in FORMATS:
            save(self.plot(**how), place)
        elif how:
            raise InvalidOption(
                f"{', '.join(how)} is for a picture ({', '.join(FORMATS)}), got {place.name!r}"
            )
        else:
            write_text(place, texts[kind]())


@dataclass(frozen=True)
class Table:
    """A table to be printed: texts and numbers, the same in LaTeX, Markdown and CSV.

    Attributes
    ----------
    title : str
    columns : sequence of str
        The headings.
    rows : sequence of sequences
        Of texts, numbers and None. CSV keeps all digits, the others three.

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

    def is_of_numbers(self, k: int) -> bool:
        """Return whether a number stands in column k."""
        return any(_is_number(row[k]) for row in self.rows)

    def texts(self) -> list[list[str]]:
        """Return the cells as they are shown, a dash where there is nothing."""
        shown = [_shown([row[k] for row in self.rows]) for k in range(len(self.columns))]
        return [list(row) for row in zip(*shown, strict=True)]

    def to_csv(self) -> str:
        """Return it as CSV."""
        return csv_text(self.columns, self.rows)

    def to_markdown(self) -> str:
        """Return it as Markdown, numbers to the right."""
        marks = ["---:" if self.is_of_numbers(k) else ":---" for k in range(len(self.columns))]
        lines = [f"| {' | '.join(cells)} |" for cells in (self.columns, *self.texts())]
        return "\n".join([lines[0], f"|{'|'.join(marks)}|", *lines[1:], ""])

    def to_latex(self) -> str:
        """Return a table for booktabs and siunitx; its first line says how to look at it alone."""
        columns = [
            _latex_column([row[k] for row in self.texts()], self.is_of_numbers(k))
            for k in range(len(self.columns))
        ]
        heads = ["{" + _stacked(head) + "}" for head in self.columns]
        lines = [
            [_latex_cell(cell, self.is_of_numbers(k)) for k, cell in enumerate(row)]
            for row in self.texts()
        ]
        has_groups = len({row[0] for row in self.rows}) < len(self.rows)
        body, before = [], self.rows[0][0] if self.rows else ""
        for row, cells in zip(self.rows, lines, strict=True):
            if row[0] != before and has_groups:
                body.append("\\addlinespace")
            before = row[0]
            body.append(f"{' & '.join(cells)} \\\\")
        return "\n".join(
            [
                f"% needs {PACKAGES}; alone: pdflatex '\\documentclass{{article}}{PACKAGES}\\begin{{document}}"
                "\\input{FILE}\\end{document}'",
                "\\begin{table}[htbp]",
                "\\centering\\footnotesize\\setlength{\\tabcolsep}{4pt}",
                "\\sisetup{output-exponent-marker=\\mathrm{e}}",
                f"\\caption{{{_escaped(self.title)}}}\\smallskip",
                f"\\begin{{tabular}}{{{' '.join(columns)}}}",
                "\\toprule",
                f"{' & '.join(heads)} \\\\",
                "\\midrule",
                *body,
                "\\bottomrule",
                "\\end{tabular}",
                "\\end{table}",
                "",
            ]
        )


TABLES = {".tex": Table.to_latex, ".md": Table.to_markdown, ".csv": Table.to_csv}


def save_tables(tables: Iterable[Table], path: AnyPath) -> None:
    """Write tables, one below the other.

    Parameters
    ----------
    tables : iterable of Table
    path : path
        Its ending says how: .tex, .md or .csv.

    Raises
    ------
    InvalidOption
        Where it has another ending.
    """
    place = checked_path(path)
    if place.suffix not in TABLES:
        raise InvalidOption(f"a table must end in {', '.join(TABLES)}, got {place.name!r}")
    write_text(place, "\n".join(TABLES[place.suffix](table) for table in tables))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _shown(column: Sequence[Any]) -> list[str]:
    """Return the cells of a column, its numbers alike: whole, with as many decimals, or with powers of ten."""
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
        return f"{value + 0.0:.{decimals}f}" if is_plain else _brief(value)

    return [shown(value) for value in column]


def _stacked(head: str) -> str:
    """Return a heading of two words on two lines."""
    words = [_escaped(word) for word in head.split(" ")]
    return "\\shortstack{" + "\\\\".join(words) + "}" if len(words) == 2 else " ".join(words)


def _brief(value: float) -> str:
    """Return two digits and a power of ten without idle signs and zeros."""
    digits, _, power = f"{value:.1e}".partition("e")
    return f"{digits}e{int(power)}"


def _latex_column(cells: Sequence[str], is_of_numbers: bool) -> str:
    """Return the kind of a column, of numbers with space for the longest part before and behind the point."""
    if not is_of_numbers:
        return "l"
    numbers = [cell for cell in cells if _is_number_text(cell)]
    parts = [cell.lstrip("-").partition("e")[0].partition(".") for cell in numbers]
    before, behind = (max((len(part[k]) for part in parts), default=1) for k in (0, 2))
    powers = [cell.partition("e")[2] for cell in numbers if "e" in cell]
    power = f"e-{max(len(one.lstrip('-')) for one in powers)}" if powers else ""
    sign = "-" if any(cell.startswith("-") for cell in numbers) else ""
    return f"S[table-format={sign}{before}{f'.{behind}' if behind else ''}{power}]"


def _is_number_text(cell: str) -> bool:
    return cell.lstrip("-")[:1].isdigit()


def _latex_cell(cell: str, is_of_numbers: bool) -> str:
    is_number = is_of_numbers and _is_number_text(cell)
    return cell if is_number else f"{{{_escaped(cell)}}}" if is_of_numbers else _escaped(cell)


def _escaped(text: str) -> str:
    return "".join(LATEX.get(sign, sign) for sign in text)


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


def write_text(path: AnyPath, text: str) -> None:
    """Write the whole file or nothing."""
    write_whole({checked_path(path): lambda file: file.write(text.encode("utf-8"))})
