"""The results of a study: rows, the file that keeps them, and their views as tables and pictures."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InvalidOption, UnreadableFile, did_you_mean
from ..interfaces.files.files import checked_path
from .collecting import Part, fingerprint
from .curves import RESIDUAL, Curve, Point, Profile, Report, performance_profile
from .drawing import FORMATS, Line, Panel, draw_panels, save
from .exporting import AnyPath, Table, csv_text, number, save_tables, write_text

VALUES = {
    "iterations": "iterations",
    "work": "work [passes over M]",
    "seconds": "time [s], set-up included",
    "residual": "relative residual",
    "error": "error ‖z − z*‖∞",
    "radius": "spectral radius of the bound T",
}
RESULTS = {
    "work": "work",
    "seconds": "seconds",
    "seconds_low": "25 %",
    "seconds_high": "75 %",
    "residual": "residual",
    "error": "error",
}
GROWING = ("iterations", "work", "seconds")
VIEWS = (
    *VALUES,
    "results",
    "profile",
    "profile-seconds",
    "curves",
    "curves-work",
    "curves-seconds",
)
COLUMNS = (
    "problem",
    "size",
    "n",
    "nonzeros",
    "method",
    "family",
    "status",
    "iterations",
    "work",
    "seconds",
    "seconds_low",
    "seconds_high",
    "setup_seconds",
    "residual",
    "error",
    "error_kind",
    "tolerance",
    "repeats",
    "note",
    "machine",
    "radius",
    "key",
    "points",
)
RATIOS = (1.0, 2.0, 5.0, math.inf)
LEAST_SIZES, FITS = (
    3,
    1.2,
)  # behind an exponent: sizes, and the largest factor between a value and its fit
NEEDS_SIZES = f"needs {LEAST_SIZES} solved sizes"


@dataclass(frozen=True)
class Row:
    """One method on one problem of one size.

    Attributes
    ----------
    problem : str
    size : int or None
        As it was asked for; None where the problem has one.
    n, nonzeros : int
        0 where there is no problem of that size.
    error_kind : str
        What `curve.last.error` is: a true error, a rigorous bound, or the relative residual.
    tolerance : float
        Relative residual that the runs were asked for.
    repeats : int
        Runs behind the median of the seconds.
    curve : Curve
        Label of the method, status, note, and what was measured.
    machine : str
        Processor, system, threads and versions.
    radius : float
        `Guarantee.spectral_radius`; NaN where there is none.
    """

    problem: str
    size: int | None
    n: int
    nonzeros: int
    error_kind: str
    tolerance: float
    repeats: int
    curve: Curve
    machine: str = ""
    radius: float = math.nan

    def value(self, name: str) -> float | None:
        """Return one of `VALUES`, None where the method gave no answer or there is no such error."""
        if name == "radius":
            return None if math.isnan(self.radius) else self.radius
        if not self.curve.is_solved or (name == "error" and self.error_kind == RESIDUAL):
            return None
        last = self.curve.last
        return float(getattr(last, name)) if name != "iterations" else last.iteration

    def shown(self, name: str) -> Any:
        """Return the value, or in words how the run ended."""
        if self.curve.is_solved or name == "radius":
            return self.value(name)
        return self.curve.status.replace("_", " ").lower()

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> Row:
        """Return what a line of the file of raw results says."""
        numbers = {
            name: number(content[name] or None)
            for name in (
                "work",
                "seconds",
                "seconds_low",
                "seconds_high",
                "setup_seconds",
                "residual",
                "error",
            )
        }
        points: tuple[Point, ...] = ()
        if content["points"]:
            points = tuple(
                Point(int(one[0]), *map(number, one[1:])) for one in json.loads(content["points"])
            )
        elif content["iterations"] != "":
            setup = numbers.pop("setup_seconds")
            points = (
                Point(0, 0.0, setup, setup, setup),
                Point(int(content["iterations"]), **numbers),
            )
        curve = Curve(
            content["method"], content["family"], content["status"], points, content["note"]
        )
        size = None if content["size"] in ("", None) else int(content["size"])
        return cls(
            content["problem"],
            size,
            int(content["n"] or 0),
            int(content["nonzeros"] or 0),
            content["error_kind"],
            float(content["tolerance"]),
            int(content["repeats"]),
            curve,
            content["machine"],
            number(content["radius"] or None),
        )


@dataclass(frozen=True)
class Study:
    """The measurements of several methods on families of problems, with tables and pictures.

    Attributes
    ----------
    rows : tuple of Row
        One a problem, size and method, in that order.
    missing : tuple of str
        What was not measured before Ctrl-C.
    found : int
        How many rows were there from a former run.
    """

    rows: tuple[Row, ...]
    missing: tuple[str, ...] = ()
    found: int = 0

    @property
    def problems(self) -> tuple[str, ...]:
        """The names of the problems."""
        return tuple(dict.fromkeys(row.problem for row in self.rows))

    @property
    def methods(self) -> tuple[str, ...]:
        """The labels of the methods."""
        return tuple(dict.fromkeys(row.curve.label for row in self.rows))

    def reports(self) -> list[Report]:
        """Return the runs of each problem and size, as `error_against_time` returns them."""
        cases: dict[tuple[str, int | None], list[Row]] = {}
        for row in self.rows:
            cases.setdefault((row.problem, row.size), []).append(row)
        return [
            Report(
                f"{problem}, n={own[0].n}",
                "",
                own[0].n,
                own[0].nonzeros,
                own[0].error_kind,
                own[0].tolerance,
                own[0].repeats,
                math.nan,
                tuple(row.curve for row in own if row.curve.points),
            )
            for (problem, _), own in cases.items()
        ]

    def profile(self, by: str = "work") -> Profile:
        """Return Dolan and Moré's performance profile, by "work" or "seconds"."""
        return performance_profile(self.reports(), by)

    def exponent(self, problem: str, method: str, value: str = "work") -> float:
        """Return p of the fit value ~ nᵖ by least squares of logarithms.

        NaN with fewer than three solved sizes, and where a value is off the fit by more than a fifth: no power then.
        A table says which, "needs 3 solved sizes" or "no power".
        """
        x, y = (np.log(np.array(values)) for values in self._series(problem, method, value))
        if len(x) < LEAST_SIZES:
            return math.nan
        fit = np.polyfit(x, y, 1)
        return float(fit[0]) if np.abs(np.polyval(fit, x) - y).max() <= math.log(FITS) else math.nan

    def _series(self, problem: str, method: str, value: str) -> tuple[list[int], list[float]]:
        found = [
            (row.n, row.value(value))
            for row in self.rows
            if (row.problem, row.curve.label) == (problem, method)
        ]
        solved = {n: y for n, y in found if y is not None and y > 0.0}
        return list(solved), list(solved.values())

    def table(self, view: str = "iterations") -> list[Table]:
        """Return tables of a view: of a value, one a problem, methods × n; "profile"; or "results", every row.

        Raises
        ------
        InvalidOption
            Where there is no such view.
        """
        _check_view(view)
        if view == "results":
            rows = [
                (
                    row.problem,
                    row.n,
                    row.curve.label,
                    row.shown("iterations"),
                    *map(row.value, RESULTS),
                )
                for row in self.rows
            ]
            return [
                Table("Results", ("problem", "n", "method", "iterations", *RESULTS.values()), rows)
            ]
        if view.startswith("profile"):
            profile = self.profile("seconds" if view.endswith("seconds") else "work")
            rows = [
                (label, *(profile.share(label, ratio) for ratio in RATIOS))
                for label in profile.labels
            ]
            heads = ("method", *(f"within {ratio:g}" for ratio in RATIOS[:-1]), "at all")
            return [
                Table(
                    f"Share of problems solved within a multiple of the least {profile.by}",
                    heads,
                    rows,
                )
            ]
        if view.startswith("curves"):
            raise InvalidOption(
                "curves are a picture: save them as .pdf, .svg or .png; the points stand in the CSV"
            )
        return [self._values(problem, view) for problem in self.problems]

    def _values(self, problem: str, value: str) -> Table:
        rows = [row for row in self.rows if row.problem == problem]
        sizes = list(dict.fromkeys(row.size for row in rows))
        n = {row.size: row.n for row in rows if row.n}
        cells = {(row.curve.label, row.size): row.shown(value) for row in rows}
        fits = value in GROWING and len(sizes) >= LEAST_SIZES
        table = [
            (
                method,
                *(cells.get((method, size)) for size in sizes),
                *([self._exponent_or_reason(problem, method, value)] if fits else []),
            )
            for method in self.methods
        ]
        heads = (
            "method",
            *(f"n = {n[size]}" if size in n else f"size {size}" for size in sizes),
            *(["exponent"] if fits else []),
        )
        return Table(f"{problem}: {VALUES[value]}", heads, table)

    def _exponent_or_reason(self, problem: str, method: str, value: str) -> float | str:
        """Return the exponent, or in words why there is none."""
        power = self.exponent(problem, method, value)
        if not math.isnan(power):
            return round(power, 2) + 0.0
        return (
            "no power"
            if len(self._series(problem, method, value)[0]) >= LEAST_SIZES
            else NEEDS_SIZES
        )

    def plot(self, view: str = "work") -> Any:
        """Return a matplotlib figure of a view, a panel a problem; `save` writes it into a file.

        Parameters
        ----------
        view : str
            A value against n with fitted exponents; "profile" or "profile-seconds"; "curves", "curves-work" or
            "curves-seconds", error against iterations, work or time, where the study kept its curves.

        Raises
        ------
        InvalidOption
            Where there is no such view, no curves were kept, or no method gave an answer to draw.
        """
        _check_view(view)
        if view.startswith("profile"):
            return self.profile("seconds" if view.endswith("seconds") else "work").plot()
        if view == "results":
            raise InvalidOption(
                "results are a table: save them as .csv, .md or .tex; a picture shows a value"
            )
        if view.startswith("curves"):
            if all(len(row.curve.points) <= 2 for row in self.rows):
                raise InvalidOption("this study kept no curves; write study(…, curves=True)")
            against = view.partition("-")[2] or "iterations"
            panels = [report.panel(against) for report in self.reports() if report.curves]
        else:
            panels = [self._panel(problem, view) for problem in self.problems]
        return draw_panels(panels)

    def _panel(self, problem: str, value: str) -> Panel:
        families = {row.curve.label: row.curve.family for row in self.rows}
        lines = []
        for method in self.methods:
            x, y = self._series(problem, method, value)
            power = self.exponent(problem, method, value) if value in GROWING else math.nan
            text = "" if math.isnan(power) else f"$n^{{{round(power, 2) + 0.0:.2f}}}$"
            lines.append(Line(method, families[method], np.array(x), np.array(y), text=text))
        return Panel(
            problem, [line for line in lines if len(line.x)], "unknowns n", VALUES[value], "sizes"
        )

    def save(self, view: str, path: AnyPath) -> None:
        """Write a view as a table (.tex, .md, .csv) or a picture (.pdf, .svg, .png)."""
        if (place := checked_path(path)).suffix.lower() in FORMATS:
            save(self.plot(view), place)
        else:
            save_tables(self.table(view), path)

    def __str__(self) -> str:
        lines = [
            f"{row.problem:<20} {f'n = {row.n}' if row.n else '':<12} {row.curve.label:<20} "
            f"{row.curve.status:<15} {row.curve.summary()}"
            for row in self.rows
        ]
        return "\n".join([*lines, *(f"missing: {what}" for what in self.missing)])


def _check_view(view: Any) -> None:
    if view not in VIEWS:
        raise InvalidOption(f"unknown view {view!r}{did_you_mean(view, VIEWS)}")


def name_of(size: Any, method: str) -> str:
    """Return what a row is called among those of its problem."""
    return method if size in ("", None) else f"size {size}, {method}"


class ResultsFile:
    """The file of raw results: one line a row, rewritten whole whenever there is another; without a path, memory.

    Raises
    ------
    UnreadableFile
        Where the file is there and holds something else.
    """

    def __init__(self, path: Path | None, *, with_points: bool) -> None:
        self.path, self.with_points, self.program = path, with_points, ""
        self.rows: dict[tuple[str, str], dict[str, Any]] = {}
        if path is not None:
            self.program = fingerprint()
            if path.exists():
                self._read_all(path)
            else:
                write_text(
                    path, csv_text(COLUMNS, ())
                )  # what cannot be written is reported before anything runs

    def _read_all(self, path: Path) -> None:
        try:
            text = path.read_text(encoding="utf-8")
            lines = list(csv.DictReader(io.StringIO(text)))
            if text.partition("\n")[0] != ",".join(COLUMNS):
                raise ValueError
        except (OSError, ValueError, csv.Error):
            raise UnreadableFile(
                f"{path} holds no results of a study; choose another name"
            ) from None
        self.rows = {(row["problem"], name_of(row["size"], row["method"])): row for row in lines}

    def read(self, part: Part) -> dict[str, Any] | None:
        """Return the row of a part, None where there is none, where it raised, or where something has changed."""
        row = self.rows.get((part.kind, part.name))
        if (
            row is None
            or row["status"] == "ERROR"
            or (self.with_points and row["iterations"] and not row["points"])
        ):
            return None
        return row if row["key"] == part.key(self.program) else None

    def write(self, part: Part, content: dict[str, Any]) -> None:
        """Keep the row of a part."""
        if self.path is None:
            return
        content["key"] = part.key(self.program)
        self.rows[part.kind, part.name] = content
        write_text(
            self.path,
            csv_text(COLUMNS, ([row[name] for name in COLUMNS] for row in self.rows.values())),
        )
