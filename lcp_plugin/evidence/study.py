"""study(): problems × methods × sizes → one table of raw results; tables, curves and pictures are views of it."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, LCPError, UnreadableFile, UnsuitableMatrix, UnsuitableProblem, did_you_mean
from ..kinds import kind_of, refusal
from ..problem.files import checked_path
from ..problem.lcp import LCP
from .collecting import Part, Progress, collect, data_of, fingerprint, machine
from .contestants import Contestant, contestants
from .curves import AXIS_LABELS, RESIDUAL, Curve, Point, Report
from .error_against_time import Bench, checked_numbers
from .exporting import AnyPath, Table, csv_text, number, save_tables, write_text
from .gallery import names as scene_names
from .gallery import parse, parameters_of_scene
from .gallery.scene import Scene
from .own_code import as_scene_of, is_own, load, own_source, told
from .profiles import Profile, performance_profile

VALUES = {
    "iterations": "iterations", "work": "work [passes over M]", "seconds": "time [s], set-up included",
    "residual": "relative residual", "error": "error ‖z − z*‖∞",
}
RESULTS = {
    "work": "work", "seconds": "seconds", "seconds_low": "25 %", "seconds_high": "75 %", "residual": "residual",
    "error": "error",
}
GROWING = ("iterations", "work", "seconds")
VIEWS = (*VALUES, "results", "profile", "profile-seconds", "curves", "curves-work")
COLUMNS = (
    "problem", "size", "n", "nonzeros", "method", "family", "status", "iterations", "work", "seconds", "seconds_low",
    "seconds_high", "setup_seconds", "residual", "error", "error_kind", "tolerance", "repeats", "note", "machine", "key",
    "points",
)
RATIOS = (1.0, 2.0, 5.0, math.inf)
LEAST_SIZES, FITS = 3, 1.2  # behind an exponent: sizes, and the largest factor between a value and its fit


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
    curve : Curve
        Label of the method, status, note, and what was measured.
    machine : str
        Processor, system, threads and versions.
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

    def value(self, name: str) -> float | None:
        """Return one of `VALUES`, None where the method gave no answer or there is no such error."""
        if not self.curve.is_solved or (name == "error" and self.error_kind == RESIDUAL):
            return None
        last = self.curve.last
        return float(getattr(last, name)) if name != "iterations" else last.iteration

    def shown(self, name: str) -> Any:
        """Return the value, or in words how the run ended."""
        return self.value(name) if self.curve.is_solved else self.curve.status.replace("_", " ").lower()

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> Row:
        """Return what a line of the file of raw results says."""
        numbers = {name: number(content[name] or None) for name in (
            "work", "seconds", "seconds_low", "seconds_high", "setup_seconds", "residual", "error"
        )}
        points: tuple[Point, ...] = ()
        if content["points"]:
            points = tuple(Point(int(one[0]), *map(number, one[1:])) for one in json.loads(content["points"]))
        elif content["iterations"] != "":
            setup = numbers.pop("setup_seconds")
            points = (Point(0, 0.0, setup, setup, setup), Point(int(content["iterations"]), **numbers))
        curve = Curve(content["method"], content["family"], content["status"], points, content["note"])
        size = None if content["size"] in ("", None) else int(content["size"])
        return cls(content["problem"], size, int(content["n"] or 0), int(content["nonzeros"] or 0),
                   content["error_kind"], float(content["tolerance"]), int(content["repeats"]), curve,
                   content["machine"])


@dataclass(frozen=True)
class Study:
    """A table of raw results and its views.

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
                f"{problem}, n={own[0].n}", "", own[0].n, own[0].nonzeros, own[0].error_kind, own[0].tolerance,
                own[0].repeats, math.nan, tuple(row.curve for row in own if row.curve.points),
            )
            for (problem, _), own in cases.items()
        ]

    def profile(self, by: str = "work") -> Profile:
        """Return Dolan and Moré's performance profile, by "work" or "seconds"."""
        return performance_profile(self.reports(), by)

    def exponent(self, problem: str, method: str, value: str = "work") -> float:
        """Return p of the fit value ~ nᵖ by least squares of logarithms.

        NaN with fewer than three solved sizes, and where a value is off the fit by more than a fifth: no power then.
        """
        x, y = map(np.log, self._series(problem, method, value))
        if len(x) < LEAST_SIZES:
            return math.nan
        fit = np.polyfit(x, y, 1)
        return float(fit[0]) if np.abs(np.polyval(fit, x) - y).max() <= math.log(FITS) else math.nan

    def _series(self, problem: str, method: str, value: str) -> tuple[list[int], list[float]]:
        found = [(row.n, row.value(value)) for row in self.rows if (row.problem, row.curve.label) == (problem, method)]
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
                (row.problem, row.n, row.curve.label, row.shown("iterations"), *map(row.value, RESULTS))
                for row in self.rows
            ]
            return [Table("Results", ("problem", "n", "method", "iterations", *RESULTS.values()), rows)]
        if view.startswith("profile"):
            profile = self.profile("seconds" if view.endswith("seconds") else "work")
            rows = [(label, *(profile.share(label, ratio) for ratio in RATIOS)) for label in profile.labels]
            heads = ("method", *(f"within {ratio:g}" for ratio in RATIOS[:-1]), "at all")
            return [Table(f"Share of problems solved within a multiple of the least {profile.by}", heads, rows)]
        if view.startswith("curves"):
            raise InvalidOption("curves are a picture: save them as .pdf, .svg or .png; the points stand in the CSV")
        return [self._values(problem, view) for problem in self.problems]

    def _values(self, problem: str, value: str) -> Table:
        rows = [row for row in self.rows if row.problem == problem]
        sizes = list(dict.fromkeys(row.size for row in rows))
        n = {row.size: row.n for row in rows if row.n}
        cells = {(row.curve.label, row.size): row.shown(value) for row in rows}
        fits = value in GROWING and len(sizes) >= LEAST_SIZES
        table = [
            (method, *(cells.get((method, size)) for size in sizes),
             *([round(self.exponent(problem, method, value), 2) + 0.0] if fits else []))
            for method in self.methods
        ]
        heads = ("method", *(f"n = {n[size]}" if size in n else f"size {size}" for size in sizes),
                 *(["exponent"] if fits else []))
        return Table(f"{problem}: {VALUES[value]}", heads, table)

    def plot(self, view: str = "work", path: AnyPath | None = None) -> Any:
        """Return a matplotlib figure of a view, a panel a problem, and save it where `path` is given.

        Parameters
        ----------
        view : str
            A value against n with fitted exponents; "profile" or "profile-seconds"; "curves" or "curves-work", error
            against time or work, where the study kept its curves.
        path : path, optional
            .pdf, .svg or .png.

        Raises
        ------
        InvalidOption
            Where there is no such view, or no curves were kept.
        """
        from .drawing import draw_panels, save

        _check_view(view)
        if view.startswith("profile"):
            return self.profile("seconds" if view.endswith("seconds") else "work").plot(path)
        if view == "results":
            raise InvalidOption("results are a table: save them as .csv, .md or .tex; a picture shows one value, as work")
        if view.startswith("curves"):
            if all(len(row.curve.points) <= 2 for row in self.rows):
                raise InvalidOption("this study kept no curves; write study(…, curves=True)")
            against = "work" if view.endswith("work") else "seconds"
            panels = [report.panel(against) for report in self.reports() if report.curves]
        else:
            panels = [self._panel(problem, view) for problem in self.problems]
        figure = draw_panels(panels)
        if path is not None:
            save(figure, checked_path(path))
        return figure

    def _panel(self, problem: str, value: str) -> Any:
        from .drawing import Line, Panel

        families = {row.curve.label: row.curve.family for row in self.rows}
        lines = []
        for method in self.methods:
            x, y = self._series(problem, method, value)
            power = self.exponent(problem, method, value) if value in GROWING else math.nan
            text = "" if math.isnan(power) else f"$n^{{{round(power, 2) + 0.0:.2f}}}$"
            lines.append(Line(method, families[method], np.array(x), np.array(y), text=text))
        return Panel(problem, [line for line in lines if len(line.x)], "unknowns n", VALUES[value], "sizes")

    def save(self, view: str, path: AnyPath) -> None:
        """Write a view as a table (.tex, .md, .csv) or a picture (.pdf, .svg, .png)."""
        from .drawing import FORMATS

        if checked_path(path).suffix in FORMATS:
            self.plot(view, path)
        else:
            save_tables(self.table(view), path)

    def __str__(self) -> str:
        lines = [f"{row.problem:<20} n = {row.n:<8} {row.curve.label:<20} {row.curve.status:<15} "
                 f"{row.curve.iterations:>7} iterations {row.curve.work:>9.1f} passes {row.curve.seconds:>9.3g} s"
                 for row in self.rows]
        return "\n".join([*lines, *(f"missing: {what}" for what in self.missing)])


def study(
    problems: Any, methods: Any = None, sizes: Sequence[int] | None = None, *, repeats: int = 3,
    tolerance: float = 1e-8, max_seconds: float = 20.0, max_work: float = math.inf, error_bound: bool = False,
    curves: bool = False, out: AnyPath | None = None, progress: Progress | None = None,
) -> Study:
    """Return one table of raw results of methods on families of problems.

    Parameters
    ----------
    problems : a problem, a sequence, or a mapping of labels to its items
        Of LCPs, scenes, functions of a size that return an LCP, a scene or (M, q), and texts: a scene's name,
        ``file.py:function``, or a file.
    methods : as `error_against_time` takes them; optional
        Names, ``file.py:Class``, Algorithm objects, pairs of a name and its options, or a mapping of labels to these.
    sizes : sequence of int, optional
        Given to each function, and to each scene as its ``size`` or ``n``.
    repeats : int
        Runs behind the median of the seconds and its quartiles, after a warm-up; ≥ 1.
    tolerance, max_seconds, max_work : float
        Where each run ends.
    error_bound : bool
        Whether a rigorous bound of the error is measured where no exact answer is known; it needs an H₊-matrix.
    curves : bool
        Whether the whole run is kept, for the views "curves".
    out : path, optional
        The file of raw results, CSV. What it holds already of the same problems, methods, versions and machine is not
        measured again; every row is written when it is there.
    progress : callable, optional
        Called as ``progress(done, total, label)``.

    Returns
    -------
    Study
        Also after Ctrl-C, with what is there. A method that refuses a problem, a family that refuses a size and code
        that raises are rows with that status and the reason; those that raised are measured again next time.

    Raises
    ------
    InvalidOption, UnknownAlgorithm, UnreadableFile
        Before anything runs, where an argument cannot be used.

    Examples
    --------
    >>> from lcp_plugin import study
    >>> found = study("half_active", ["npsor", "psor"], sizes=[100, 400], repeats=1)
    >>> [(row.n, row.curve.label, row.curve.status) for row in found.rows][:2]
    [(100, 'npsor', 'SOLVED'), (100, 'psor', 'SOLVED')]
    >>> found.table("iterations")[0].columns
    ('method', 'n = 100', 'n = 400')
    """
    checked_numbers(repeats, max_work, progress)
    plan = _Plan(_problems(problems), contestants(methods), _checked_sizes(sizes), repeats, curves, {
        "tolerance": tolerance, "max_seconds": max_seconds, "max_work": max_work, "bounds": bool(error_bound),
    })
    results = ResultsFile(None if out is None else checked_path(out), with_points=curves)
    collected = collect(plan.parts(), results, progress)
    rows = tuple(map(Row.from_content, collected.contents.values()))
    return Study(rows, tuple(collected.missing), collected.found)


def _check_view(view: Any) -> None:
    if view not in VIEWS:
        raise InvalidOption(f"unknown view {view!r}{did_you_mean(view, VIEWS)}")


# --- What takes part ------------------------------------------------------------------------------------------


def _problems(given: Any) -> dict[str, Any]:
    """Return what is built of each problem, by its name."""
    if isinstance(given, Mapping):
        return {str(label): _named(one) for label, one in given.items()}
    if isinstance(given, str | LCP | Scene | tuple) or callable(given) or kind_of(given) is not None:
        given = [given]
    try:
        listed = list(given)
    except TypeError:
        listed = []
    if not listed:
        raise InvalidOption(f'problems must be a list of problems, functions or names, got {given!r}; write ["own.py:f"]')
    return {label_of(one, k): _named(one) for k, one in enumerate(listed)}


def label_of(one: Any, k: int = 0) -> str:
    """Return what a problem is called in a study: a function's name, a scene or file as it is written."""
    if isinstance(one, str):
        return one.partition(":")[2] if is_own(one) and one.partition(":")[0] not in scene_names() else one
    return getattr(one, "name", "") or getattr(one, "__name__", "") or f"problem {k + 1}"


def _named(one: Any) -> Any:
    """Return a problem, or a function of the size, that a text names; anything else as it is."""
    if not isinstance(one, str):
        if isinstance(one, LCP | Scene | tuple) or (callable(one) and kind_of(one) is None):
            return one
        raise InvalidOption(f'{refusal("study", one)}; or a scene, (M, q), a function of the size')
    name = one.partition(":")[0].strip()
    if name in scene_names():
        return partial(_scene, one)
    if is_own(one):
        return load(one)
    if not (Path(one).exists() or set(one) & set("/\\.")):
        raise InvalidOption(f"{one!r} is neither a scene, a file nor file.py:function{did_you_mean(name, scene_names())}")
    from ..conversions.program_files import load_problem

    return _named(load_problem(one))


def _scene(text: str, size: int | None = None) -> Scene:
    if size is None:
        return parse(text)
    name, _, settings = text.partition(":")
    parameters = parameters_of_scene(name.strip())
    key = next((key for key in ("size", "n") if key in parameters), None)
    if key is None:
        raise InvalidOption(f"scene {name!r} has neither size nor n, so that sizes mean nothing to it; leave them out")
    return parse(f"{text}{',' if settings else ':'}{key}={size}")


def _checked_sizes(sizes: Any) -> list[int | None]:
    if sizes is None:
        return [None]
    listed = list(sizes) if isinstance(sizes, Sequence | np.ndarray) and not isinstance(sizes, str) else [sizes]
    for size in listed:
        if isinstance(size, bool) or not isinstance(size, int | np.integer) or size < 1:
            raise InvalidOption(f"sizes must be whole numbers ≥ 1, as [100, 400], got {size!r}")
    return [int(size) for size in listed] or [None]


# --- What is measured -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Cell(Part):
    """A part of a study: one method on one problem of one size."""

    place: tuple[str, str, str] = ("", "", "")
    data_hash: Callable[[], str] = field(default=str)

    def key(self, program: str) -> str:
        """Return a hash of everything that the row depends on; it builds the problem."""
        return Part(self.kind, self.name, self.compute, data=self.data + self.data_hash()).key(program)


class _Plan:
    """Problems × sizes × methods, and how each is measured; one problem is held at a time."""

    def __init__(
        self, problems: dict[str, Any], methods: list[Contestant], sizes: list[int | None], repeats: int, curves: bool,
        limits: dict[str, Any],
    ) -> None:
        self.problems, self.methods, self.sizes = problems, methods, sizes
        self.repeats, self.curves, self.limits = repeats, curves, limits
        self.scene = lru_cache(maxsize=1)(self._built)
        self.bench = lru_cache(maxsize=1)(lambda label, size: Bench(self.scene(label, size), **limits))
        facts = machine()
        self.machine = "; ".join(f"{name} {fact}" for name, fact in facts.items())

    def _built(self, label: str, size: int | None) -> Scene:
        given = self.problems[label]
        return as_scene_of(given, label, None if isinstance(given, LCP | Scene) and self.sizes == [None] else size)

    def parts(self) -> list[_Cell]:
        """Return a part for each cell."""
        return [
            _Cell(
                label, f"{'' if size is None else f'size {size}, '}{one.label}", partial(self.measured, label, size, one),
                data=json.dumps([repr(one.algorithm), own_source(one.algorithm), self.repeats, str(self.limits)]),
                place=(label, "" if size is None else str(size), one.label),
                data_hash=partial(self._data, label, size),
            )
            for label in self.problems for size in self.sizes for one in self.methods
        ]

    def _data(self, label: str, size: int | None) -> str:
        try:
            return data_of(self.scene(label, size).problem)
        except Exception as error:  # it is told where it is measured
            return told(error)

    def measured(self, label: str, size: int | None, one: Contestant, say: Any) -> dict[str, Any]:
        """Return the row of a cell, whatever somebody's code does."""
        n = nonzeros = 0
        kind = ""
        try:
            scene = self.scene(label, size)
            n, nonzeros = scene.n, scene.problem.nonzeros
            bench = self.bench(label, size)
            kind = bench.yardstick.kind
            curve = bench.curve(one, self.repeats)
        except (LCPError, ValueError) as error:
            is_refusal = n == 0 or isinstance(error, UnsuitableMatrix | UnsuitableProblem)
            curve = Curve(one.label, one.family, "REFUSED" if is_refusal else "ERROR", (), told(error))
        except Exception as error:  # whatever somebody's own code raises: the other rows are worth keeping
            curve = Curve(one.label, one.family, "ERROR", (), told(error))
        last, has = curve.last, bool(curve.points)
        points = json.dumps([[None if value != value else value for value in point] for point in curve.points])
        return dict(zip(COLUMNS, (
            label, "" if size is None else size, n, nonzeros, one.label, one.family, curve.status,
            last.iteration if has else "", *map(_blank, (last.work, last.seconds, last.seconds_low, last.seconds_high,
            curve.setup_seconds, last.residual, last.error)), kind, self.limits["tolerance"], self.repeats, curve.note,
            self.machine, "", points if self.curves and has else "",
        ), strict=True))


def _blank(value: float) -> float | str:
    return "" if math.isnan(value) else value


class ResultsFile:
    """The file of raw results: one line a row, rewritten whole whenever there is another; without a path, memory.

    Raises
    ------
    UnreadableFile
        Where the file is there and holds something else.
    """

    def __init__(self, path: Path | None, *, with_points: bool) -> None:
        self.path, self.with_points, self.program = path, with_points, ""
        self.rows: dict[tuple[str, str, str], dict[str, Any]] = {}
        if path is not None:
            self.program = fingerprint()
            if path.exists():
                self._read_all(path)
            else:
                write_text(path, csv_text(COLUMNS, ()))  # what cannot be written is told before anything runs

    def _read_all(self, path: Path) -> None:
        try:
            text = path.read_text(encoding="utf-8")
            lines = list(csv.DictReader(io.StringIO(text)))
            if text.partition("\n")[0] != ",".join(COLUMNS):
                raise ValueError
        except (OSError, ValueError, csv.Error):
            raise UnreadableFile(f"{path} holds no results of a study; choose another name") from None
        self.rows = {(row["problem"], row["size"], row["method"]): row for row in lines}

    def read(self, part: Any) -> dict[str, Any] | None:
        """Return the row of a part, None where there is none, where it raised, or where something has changed."""
        row = self.rows.get(part.place)
        if row is None or row["status"] == "ERROR" or (self.with_points and row["iterations"] and not row["points"]):
            return None
        return row if row["key"] == part.key(self.program) else None

    def write(self, part: Any, content: dict[str, Any]) -> None:
        """Keep the row of a part."""
        if self.path is None:
            return
        content["key"] = part.key(self.program)
        self.rows[part.place] = content
        write_text(self.path, csv_text(COLUMNS, ([row[name] for name in COLUMNS] for row in self.rows.values())))
