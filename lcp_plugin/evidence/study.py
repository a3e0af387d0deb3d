"""study(): problems × methods × sizes, a measurement of each; tables, curves and profiles are functions of rows."""

from __future__ import annotations

import math
import os
import platform
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..core.checks import Vector
from ..core.errors import InvalidOption, LCPError, UnsuitableMatrix, UnsuitableProblem, did_you_mean
from ..core.files import checked_path
from ..core.lcp import LCP
from ..core.problem_classes import class_of, refusal
from ..core.settings import Settings, whole_number
from ..gallery import names as scene_names
from ..gallery import parse
from ..gallery.scene import SIZES, Scene, defaults_of
from . import measurement
from .cross_check import PLAIN, ConvexForm, solver_name
from .drawing import check_format, draw_curve, draw_tolerance, look_of, panels, save_figure
from .measurement import RESIDUAL, Measurement, Method

PACKAGES = ("numpy", "scipy", "numba", "cvxpy")
VALUES = {
    "iterations": "iterations",
    "work": "work [passes over M]",
    "seconds": "time [s], set-up included",
    "error": "error",
    "residual": "relative residual",
}
ERROR_LABELS = {
    measurement.TRUE_ERROR: "true error ‖z\xa0−\xa0z*‖∞",
    measurement.BOUND: "proved bound of the error ‖z\xa0−\xa0z*‖∞",
    RESIDUAL: "relative residual",
}
# statuses after which a polish may be made
ENDED = ("SOLVED", "PRECISION_LIMIT", "STALLED", "DIVERGED")
LEAST = {"work": 1.0, "seconds": 1e-9}  # a run whose start is the solution counts one pass

NO_POINTS = np.zeros((0, len(measurement.POINT)))


@dataclass(frozen=True)
class Table:
    """A table to print.

    Attributes
    ----------
    title : str
    columns : sequence of str
        Headings.
    rows : sequence of sequences
        Texts, numbers and None. Markdown shows three digits.

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
        columns = range(len(self.columns))
        has_number = [any(isinstance(row[k], int | float) for row in self.rows) for k in columns]
        marks = ["---:" if is_number else ":---" for is_number in has_number]
        texts = ([*map(_text_of, row)] for row in self.rows)
        lines = [f"| {' | '.join(cells)} |" for cells in (self.columns, *texts)]
        return "\n".join([lines[0], f"|{'|'.join(marks)}|", *lines[1:], ""])


def _text_of(value: object) -> str:
    """Return a number with three digits, – for none, a text unchanged."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True, eq=False)
class Study:
    """Measurements of several methods on several problems.

    Attributes
    ----------
    rows : tuple of Measurement
        One per problem, size and method, in this order.
    notes : tuple of str
        Why no better error or no reference is shown; whether Ctrl-C ended the study.
    is_complete : bool
        False after Ctrl-C.
    """

    rows: tuple[Measurement, ...]
    notes: tuple[str, ...] = ()
    is_complete: bool = True

    def row(self, method: str, problem: str | None = None, size: int | None = None) -> Measurement:
        """Return the first row of a method, of a problem and a size if they are given.

        Raises
        ------
        InvalidOption
            If there is none.
        """
        for row in self.rows:
            if row.method == method and problem in (None, row.problem) and size in (None, row.size):
                return row
        hint = did_you_mean(method, [row.method for row in self.rows])
        raise InvalidOption(f"no row of {method!r}{hint}")

    def _groups(self, key: Callable[[Measurement], Any]) -> dict[Any, list[Measurement]]:
        groups: dict[Any, list[Measurement]] = {}
        for row in self.rows:
            groups.setdefault(key(row), []).append(row)
        return groups

    def table(self, value: str = "iterations") -> list[Table]:
        """Return a table per problem, methods × sizes, of "iterations", "work", "seconds", "error" or "residual".

        A cell of a method that did not reach the tolerance holds its status.
        """
        _check_choice("value", value, VALUES)
        tables = []
        for problem, rows in self._groups(lambda row: row.problem).items():
            cells = {(row.method, row.size): _cell(row, value) for row in rows}
            n = {row.size: row.n for row in rows}
            heads = ("method", *(f"n = {count or size}" for size, count in n.items()))
            methods = dict.fromkeys(row.method for row in rows)
            lines = [(method, *(cells.get((method, size)) for size in n)) for method in methods]
            tables.append(Table(f"{problem}: {VALUES[value]}", heads, lines))
        return tables

    def plot(self, against: str = "seconds", width: float | None = None) -> Any:
        """Return a matplotlib figure of the error curves; `save` writes it into a file.

        There is a panel per problem and size; against seconds with quartiles and references.

        Parameters
        ----------
        against : {"seconds", "work", "iterations"}
        width : float, optional
            Inches; by default a journal's column, or its page if there are several panels.

        Raises
        ------
        InvalidOption
            If an argument does not exist, or if no run has a point to show.
        """
        _check_choice("against", against, ("seconds", "work", "iterations"))
        hidden = None if against == "seconds" else "reference"
        shown = [row for row in self.rows if len(row.points) and row.family != hidden]
        if not shown:
            raise InvalidOption("no run has a result to draw; print() lists how each ended")
        labels = dict.fromkeys(row.method for row in shown)
        looks = {label: look_of(k) for k, label in enumerate(labels)}
        groups = self._groups(lambda row: (row.problem, row.size))
        titles = [
            re.sub(r"([:,])", r"\1 ", problem) + ("" if size is None else f", n = {rows[0].n}")
            for (problem, size), rows in groups.items()
        ]
        with panels(titles, width) as all_axes:
            for axes, rows in zip(all_axes, groups.values(), strict=True):
                drawn = [row for row in rows if row in shown]
                if drawn:
                    _draw_errors(axes, drawn, against, looks)
                else:
                    words = "no result: print() lists the reasons"
                    axes.text(0.5, 0.5, words, ha="center", transform=axes.transAxes)
        return all_axes[0].figure

    def save(self, path: str | PathLike[str], against: str = "seconds") -> None:
        """Write the plot into a file with the ending .png, .pdf or .svg.

        Raises
        ------
        InvalidOption
            If the name has another ending.
        """
        place = checked_path(path)
        check_format(place)
        save_figure(self.plot(against), place)

    def explain(self) -> str:
        """Return a line per row, below each problem, then the notes and the machine."""
        lines = []
        for (problem, _), rows in self._groups(lambda row: (row.problem, row.size)).items():
            lines += [f"{problem}: {rows[0].n} unknowns, {rows[0].nonzeros} nonzeros"]
            lines += [str(row) for row in rows]
        return "\n".join([*lines, *self.notes, machine()])

    __str__ = explain


def _check_choice(name: str, choice: object, known: Collection[str]) -> None:
    if not isinstance(choice, str) or choice not in known:
        raise InvalidOption(f"{name} must be one of {', '.join(known)}, got {choice!r}")


def _cell(row: Measurement, name: str) -> Any:
    if row.family == "reference" and name in ("seconds", "error", "residual"):
        return row.last(name)
    if not row.is_solved:
        return row.status.replace("_", " ").lower()
    return row.iterations if name == "iterations" else row.last(name)


def _draw_errors(axes: Any, rows: Sequence[Measurement], against: str, looks: Any) -> None:
    """Draw error curves of one problem with quartiles of seconds; references and polishes are single points."""
    kind = rows[0].error_kind
    axes.loglog()
    axes.set(xlabel=VALUES[against], ylabel=ERROR_LABELS.get(kind, kind))
    runs = [row for row in rows if row.is_curve]
    low, high = _range(runs or rows)
    least = LEAST.get(against, 1.0)
    for row in runs:
        y = np.clip(np.nan_to_num(row.column("error"), nan=high, posinf=high), low, high)
        look = looks[row.method]
        if against == "seconds":
            ends = (np.maximum(row.column(f"seconds_{end}"), least) for end in ("low", "high"))
            axes.fill_betweenx(y, *ends, color=look["color"], alpha=0.10, linewidth=0, zorder=2)
        x = np.maximum(row.column(against), least)
        draw_curve(axes, x, y, row.method, look, row.is_solved)
    for row in (row for row in rows if not row.is_curve):
        look = looks[row.method] | {"linestyle": "none", "markersize": 5}
        axes.plot([row.last(against)], [max(row.error, low)], label=row.method, zorder=5, **look)
    if kind == RESIDUAL and not math.isnan(rows[0].tolerance):
        draw_tolerance(axes, rows[0].tolerance)
    axes.set_ylim(low / 1.5, high)


def _range(rows: Sequence[Measurement]) -> tuple[float, float]:
    """Return the errors that are shown: from the least of a result to three times the largest start."""
    errors = [row.column("error")[[0, -1]] for row in rows]
    columns = np.reshape(errors, (-1, 2)).T
    starts, ends = ([v for v in column if 0.0 < v < math.inf] for column in columns)
    ends = ends or [1e-16]
    low = max(min(ends), float(np.median(ends)) * 1e-3) / 2.0
    return low, 3.0 * max(starts or [1.0], default=1.0)


# --- Measuring ------------------------------------------------------------------------------------------------


def study(
    problems: object,
    methods: object = None,
    sizes: Sequence[int] | None = None,
    *,
    repeats: int = 3,
    tolerance: float | None = None,
    stopping: str = "criterion",
    polish: bool = True,
    max_seconds: float = 20.0,
    references: Sequence[str] = (),
) -> Study:
    """Return measurements of methods on problems of several sizes.

    Parameters
    ----------
    problems : a problem, a sequence, or a mapping of labels to its items
        LCPs, test problems of the gallery or their names, and functions of a size that return an LCP, a test problem
        or (M, q).
    methods : an algorithm, a sequence, or a mapping of labels to its items; optional
        Names, Algorithm objects and pairs as in ``("npsor", {"relaxation": 1.5})``. Tables and plots show the labels,
        as in ``{"NPSOR(1.7)": ("npsor", {"relaxation": 1.7})}``; without them a name and the options that differ from
        the defaults. By default the projected-type
        methods (ours and with the paper's settings), their relatives and ``"auto"``.
    sizes : sequence of int, optional
        Arguments of each function, ``size`` or ``n`` of each test problem.
    repeats : int
        Runs per median of seconds, after a warm-up; ≥ 1.
    tolerance : float, optional
        Residual at which a run ends: relative, 1e-8 by default; with the paper's rule 1e-5 by default.
    stopping : {"criterion", "paper"}
        Stopping rule: the criterion of `solve`, or the paper's Res = ‖min(z, M z + q)‖₂ < tolerance, for bounds
        ‖z − mid(lower, upper, z − w)‖₂, tested at every iterate. A run by the paper's rule has no polish.
    polish : bool
        Whether the polish that `solve` would make is a separate row.
    max_seconds : float
        Limit of each run in seconds.
    references : sequence of str
        Convex solvers of cvxpy, as "CLARABEL" or "OSQP", at their default options; each becomes one point. They are
        left out if M is not symmetric positive semidefinite.

    Returns
    -------
    Study
        Measurements, after Ctrl-C the finished ones. The rows of a method hold its iterates. If
        :func:`lcp_plugin.solve` would replace the last iterate by a polish, that point is a separate row, unless
        `polish` is False. A rejected
        problem or size, and a method that raises, are rows with the status REFUSED or ERROR and the reason.

    Raises
    ------
    InvalidOption, UnknownAlgorithm
        Before anything runs, if an argument cannot be used.

    Notes
    -----
    The error is the true error if the test problem has z*; else a rigorous bound if M is an H₊-matrix and the bound is
    less than the solution. Otherwise it is the relative residual. Iterations, work, errors and residuals are equal in
    every run of the same call; seconds are not.

    Examples
    --------
    >>> from lcp_plugin.evidence.study import study
    >>> result = study("half_active", ["npsor", "psor"], sizes=[100, 400], repeats=1)
    >>> [(row.n, row.method, row.status) for row in result.rows][:2]
    [(100, 'npsor', 'SOLVED'), (100, 'psor', 'SOLVED')]
    >>> result.table("iterations")[0].columns
    ('method', 'n = 100', 'n = 400')
    """
    whole_number(repeats, "repeats", 1)
    _check_choice("stopping", stopping, ("criterion", "paper"))
    is_paper = stopping == "paper"
    tolerance = (1e-5 if is_paper else 1e-8) if tolerance is None else tolerance
    Settings(tolerance=tolerance, max_seconds=max_seconds)
    entrants, targets = measurement.methods_of(methods), _label_problems(problems)
    listed = [*sizes] if isinstance(sizes, Iterable) else [sizes]
    if sizes is not None:
        listed = [whole_number(size, "each of sizes", 1, ", as [100, 400]") for size in listed]
    if not isinstance(references, list | tuple):
        raise InvalidOption(f"references must be a list of names, got {references!r}")
    references = [solver_name(name) for name in references]
    polish = polish and not is_paper
    # A run by the paper's rule has its own test in place of the relative residual
    stop, relative = ("paper_tolerance", math.nan) if is_paper else ("tolerance", tolerance)
    limits = {"tolerance": 0.0, "max_seconds": max_seconds, stop: tolerance}
    rows: list[Measurement] = []
    notes: dict[str, None] = {}
    ending = "interrupted: the rows above are complete"
    try:
        for (label, target), size in product(targets.items(), listed or [None]):
            blank = Measurement(label, size, 0, 0, "", "", "", "", relative)
            measured = _measurements(blank, target, entrants, references, repeats, polish, **limits)
            for row in measured:
                if isinstance(row, str):
                    notes[row] = None
                else:
                    rows.append(row)
    except KeyboardInterrupt:
        notes[ending] = None
    return Study(tuple(rows), tuple(notes), ending not in notes)


def error_against_time(
    target: Scene | LCP, methods: object = None, references: Sequence[str] = (), **options: Any
) -> Study:
    """Measure how the error falls with seconds and with passes over M, for each method on one problem.

    Parameters
    ----------
    target : LCP, test problem of the gallery, or its name
    methods, references : as in `study`
    **options
        The other options of `study`.

    Returns
    -------
    Study
        Study of one problem; ``print(result)``, ``result.plot()`` or ``result.save("curves.pdf")`` shows it.

    Raises
    ------
    InvalidOption, UnknownAlgorithm
        If an argument cannot be used.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> result = error_against_time(gallery.build("half_active", n=100), ["npgs", "pgs"], repeats=1)
    >>> [(row.method, row.status, row.error_kind) for row in result.rows]
    [('npgs', 'SOLVED', 'true error'), ('pgs', 'SOLVED', 'true error')]
    """
    if not isinstance(target, LCP | Scene | str):
        raise InvalidOption(f"{refusal('error_against_time', target)}; or a test problem")
    problems = {"problem": target} if isinstance(target, LCP) else [target]
    return study(problems, methods, references=references, **options)


def _measurements(
    blank: Measurement,
    target: object,
    methods: Sequence[Method],
    references: Sequence[str],
    repeats: int,
    has_polish: bool,
    **limits: Any,
) -> Iterator[Measurement | str]:
    """Yield a row per method and reference, and notes; an exception in code of the user is a row."""
    label = blank.problem
    try:
        scene = _build_problem(target, label, blank.size)
        measurement.fresh(scene.problem)
    except Exception as error:  # a function of the user may raise anything
        yield from [_entry(blank, method, "REFUSED", note=_note(error)) for method in methods]
        return
    kind, measure, reason = measurement.error_measure(scene, limits["max_seconds"])
    blank = replace(blank, n=scene.n, nonzeros=scene.problem.nonzeros, error_kind=kind)
    if reason:
        yield f"{label}: {reason}"
    for method in methods:
        try:
            status, points = measurement.measure_method(scene, method, measure, repeats, **limits)
            yield _entry(blank, method, status, points, method.note)
            if not has_polish or status not in ENDED:
                continue
            if (polish := measurement.measure_polish(scene, method, measure, **limits)) is not None:
                yield _entry(blank, Method(f"{method.label}, polished", "", "polish"), *polish)
        except (UnsuitableMatrix, UnsuitableProblem) as error:
            yield _entry(blank, method, "REFUSED", note=str(error))
        except Exception as error:  # an algorithm of the user may raise anything
            yield _entry(blank, method, "ERROR", note=_note(error))
    if not references:
        return
    convex = ConvexForm.of(scene.problem)
    if convex.kind != PLAIN:
        yield f"{label}: no convex solver, {convex.evidence}"
        return
    for name in references:
        z, seconds, outcome = convex.solve_by(name, limits["max_seconds"])
        method, status, points = Method(name, name, "reference"), "ERROR", NO_POINTS
        if z is not None:
            status = outcome.upper()
            points = np.array([(math.nan, math.nan, *[seconds] * 3, *measure(z))])
        yield _entry(blank, method, status, points, outcome)


def _entry(
    blank: Measurement, method: Method, status: str, points: Vector = NO_POINTS, note: str = ""
) -> Measurement:
    label, family = method.label, method.family
    return replace(blank, method=label, family=family, status=status, points=points, note=note)


def _note(error: BaseException) -> str:
    words = " ".join(str(error).split())
    return words if isinstance(error, LCPError) else f"{type(error).__name__}: {words}"


# --- The problems ---------------------------------------------------------------------------------------------


def _label_problems(source: object) -> dict[str, Any]:
    """Return the problems, or functions that build them, by their labels."""
    if isinstance(source, Mapping):
        return {str(label): _check_problem(problem) for label, problem in source.items()}
    if isinstance(source, str | LCP | Scene | tuple) or callable(source) or class_of(source):
        source = [source]
    problems = [*source] if isinstance(source, Iterable) else []
    if not problems:
        raise InvalidOption(f"problems must be problems, functions or names, got {source!r}")
    labeled: dict[str, Any] = {}
    for k, problem in enumerate(problems, start=1):
        name = problem if isinstance(problem, str) else getattr(problem, "__name__", f"problem {k}")
        label = problem.title if isinstance(problem, Scene) else str(name)
        labeled[label if label not in labeled else f"{label} {k}"] = _check_problem(problem)
    return labeled


def _check_problem(problem: object) -> Any:
    if isinstance(problem, str):
        name = problem.partition(":")[0].strip()
        if name not in scene_names():
            hint = did_you_mean(name, scene_names(), is_listed=True)
            raise InvalidOption(f"unknown test problem {problem!r}{hint}; a file: load_problem()")
        return partial(_build_by_name, problem)
    is_function = callable(problem) and class_of(problem) is None
    if isinstance(problem, LCP | Scene | tuple) or is_function:
        return problem
    raise InvalidOption(f"{refusal('study', problem)}; or a test problem, (M, q) or a function")


def _build_by_name(text: str, size: int | None = None) -> Scene:
    name, _, settings = text.partition(":")
    if size is None:
        return parse(text)
    if not (keys := SIZES & defaults_of(name.strip()).keys()):
        raise InvalidOption(f"{name!r} has neither size nor n; leave sizes out")
    return parse(f"{text}{',' if settings else ':'}{keys.pop()}={size}")


def _build_problem(target: object, label: str, size: int | None) -> Scene:
    """Return the test problem of a problem, of (M, q), or of a function of the size."""
    if callable(target):
        target = target() if size is None else target(size)
    elif size is not None:
        raise InvalidOption(f"{label} is one problem; leave out sizes, or give a function")
    if isinstance(target, tuple) and 2 <= len(target) <= 4:
        bounds = dict(zip(("lower", "upper"), target[2:], strict=False))
        target = LCP(*target[:2], **bounds)
    if isinstance(target, LCP):
        return Scene(problem=target, name=label)
    if isinstance(target, Scene):
        return target
    kind = type(target).__name__
    raise InvalidOption(f"{label} is not an LCP, a test problem or (M, q), got {kind}")


def machine() -> str:
    """Return processor, system and versions in a line; no name of a computer or a user."""
    cpu = Path("/proc/cpuinfo")
    text = cpu.read_text(encoding="utf-8") if cpu.exists() else ""
    named = re.search(r"^model name\s*: *(.*)$", text, re.MULTILINE)
    processor = named[1] if named else platform.processor() or platform.machine()
    facts = [processor, f"{os.cpu_count()} cores", f"Python {platform.python_version()}"]
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            facts.append(f"{name} {version(name)}")
    return f"measured on {platform.system()}: {', '.join(facts)}"
