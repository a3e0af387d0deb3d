"""What a race between algorithms leaves behind: curves of error, work and time, and who is the best how often.

Dolan and Moré's performance profile says how often each method is the best, or within a multiple of the best.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..core.errors import InvalidOption
from .drawing import Line, Panel, draw_panels
from .exporting import Exported

TRUE_ERROR, BOUND, RESIDUAL = "true error", "rigorous bound", "residual"
AXIS_LABELS = {
    TRUE_ERROR: "true error ‖z − z*‖∞",
    BOUND: "proved bound of the error ‖z − z*‖∞",
    RESIDUAL: "relative residual",
}
AXES = {
    "iterations": "iterations",
    "work": "work [passes over M]",
    "seconds": "time [s], set-up included",
}
LEAST = {"work": 1.0, "seconds": 1e-9}
"""Less is not resolved: a run whose start is the answer counts one pass."""


class Point(NamedTuple):
    """One point of a curve.

    Attributes
    ----------
    iteration : int
        0 is the projected start, after the set-up; the last point of a curve is the answer.
    work : float
        Passes over M so far.
    seconds, seconds_low, seconds_high : float
        Median and quartiles over the repeats, set-up included, measurements excluded.
    error : float
        In the kind that the report names.
    residual : float
        Relative residual.
    """

    iteration: int
    work: float
    seconds: float
    seconds_low: float = math.nan
    seconds_high: float = math.nan
    error: float = math.nan
    residual: float = math.nan


@dataclass(frozen=True)
class Curve:
    """The error of one algorithm against time and work.

    Attributes
    ----------
    label, family : str
        What it is called here, and the family of algorithms it belongs to.
    status : str
        Name of a :class:`lcp_plugin.Status`, or "MAX_WORK" where the limit of work ended the run.
    points : tuple of Point
        The first is the set-up; none where the algorithm was REFUSED, or ended in an ERROR.
    note : str
        How its options were chosen, or what else one ought to know.
    """

    label: str
    family: str
    status: str
    points: tuple[Point, ...]
    note: str = ""

    @property
    def is_solved(self) -> bool:
        """True where the tolerance was reached."""
        return self.status == "SOLVED"

    @property
    def setup_seconds(self) -> float:
        """Seconds until the first iterate, median."""
        return self.points[0].seconds if self.points else math.nan

    @property
    def last(self) -> Point:
        """The answer; NaN where there is none."""
        return self.points[-1] if self.points else Point(0, math.nan, math.nan)

    @property
    def seconds(self) -> float:
        """Seconds until the answer, median."""
        return self.last.seconds

    @property
    def work(self) -> float:
        """Passes over M until the answer."""
        return self.last.work

    @property
    def iterations(self) -> int:
        """Iterations until the answer."""
        return self.last.iteration

    def summary(self) -> str:
        """Return what the answer took, or why there is none."""
        if not self.points:
            return self.note
        return f"{self.iterations:>7} iterations {self.work:>9.1f} passes {self.seconds:>9.3g} s"

    def line(self, against: str) -> Line:
        """Return what a figure shows of it: errors against seconds with their spread, passes or iterations."""
        iterations, work, seconds, low, high, error, _ = map(
            np.array, zip(*self.points, strict=True)
        )
        if against != "seconds":
            taken = work if against == "work" else iterations
            return Line(self.label, self.family, np.maximum(taken, 1.0), error, self.is_solved)
        return Line(self.label, self.family, seconds, error, self.is_solved, (low, high))


@dataclass(frozen=True)
class ReferencePoint:
    """What a convex solver reached through cvxpy: seconds with cvxpy's own part, error and residual of its answer."""

    label: str
    seconds: float
    error: float
    residual: float
    note: str = ""


@dataclass(frozen=True)
class Report(Exported):
    """Error against time and work of several algorithms on one problem.

    Attributes
    ----------
    title, description : str
        The scene as it is written on a command line, and what it is.
    n, nonzeros : int
        Size of the problem.
    error_kind : {"true error", "rigorous bound", "residual"}
        What the error axis shows; the first two in the unit of z.
    tolerance : float
        Relative residual that the runs were asked for.
    repeats : int
        Runs behind each median of seconds.
    active_share : float
        Share of components at a bound, of the answer with the smallest residual; NaN where there is none.
    curves, references
        One per algorithm, one per reference that gave an answer.
    left_out : tuple of (what, reason)
        What this problem does not need or cannot have.
    """

    columns: ClassVar = (
        "scene",
        "algorithm",
        "family",
        "status",
        "iteration",
        "work",
        "seconds",
        "seconds_low",
        "seconds_high",
        "error_kind",
        "error",
        "residual",
    )

    title: str
    description: str
    n: int
    nonzeros: int
    error_kind: str
    tolerance: float
    repeats: int
    active_share: float
    curves: tuple[Curve, ...]
    references: tuple[ReferencePoint, ...] = ()
    left_out: tuple[tuple[str, str], ...] = ()

    def curve(self, label: str) -> Curve | None:
        """Return the curve of that label, or None."""
        return next((curve for curve in self.curves if curve.label == label), None)

    def rows(self) -> list[tuple[Any, ...]]:
        """Return one row a point, in the columns of the CSV; a reference has neither iteration nor work."""
        rows: list[tuple[Any, ...]] = [
            (
                self.title,
                curve.label,
                curve.family,
                curve.status,
                *point[:5],
                self.error_kind,
                *point[5:],
            )
            for curve in self.curves
            for point in curve.points
        ]
        for reference in self.references:
            seconds = (reference.seconds,) * 3
            rows.append(
                (
                    self.title,
                    reference.label,
                    "reference",
                    "",
                    "",
                    "",
                    *seconds,
                    self.error_kind,
                    reference.error,
                    reference.residual,
                )
            )
        return rows

    def plot(self, *, against: str = "seconds", width: float | None = None) -> Any:
        """Return a matplotlib figure of the curves; `save` writes it into a file.

        Parameters
        ----------
        against : {"seconds", "work", "iterations"}
            Seconds with their spread and the references; passes over M, the same on every machine; or iterations.
        width : float, optional
            Of the figure, inches; by default that of a journal's column.

        Raises
        ------
        InvalidOption
            Where `against` is something else, or no run has a point to show.
        LCPError
            Where matplotlib is not installed.
        """
        return draw_panels([self.panel(against)], width)

    def panel(self, against: str = "seconds") -> Panel:
        """Return what `plot` draws, as a part of a figure."""
        if not isinstance(against, str) or against not in AXES:
            raise InvalidOption(
                f"against must be 'seconds', 'work' or 'iterations', got {against!r}"
            )
        timed = against == "seconds"
        marks = [(one.label, one.seconds, one.error) for one in self.references] if timed else []
        level = self.tolerance if self.error_kind == RESIDUAL else None
        lines = [curve.line(against) for curve in self.curves]
        title = re.sub(r"([:,])", r"\1 ", self.title)
        return Panel(
            title, lines, AXES[against], AXIS_LABELS[self.error_kind], "errors", marks, level
        )

    def __str__(self) -> str:
        lines = [
            f"{self.title}: {self.error_kind} against time, {self.n} unknowns, {self.repeats} repeats"
        ]
        for curve in self.curves:
            last = curve.points[-1]
            lines.append(
                f"{curve.label:<18} {curve.status:<15} {last.iteration:>7} iterations {last.work:>9.1f} passes "
                f"{last.seconds:>9.3g} s, set-up {curve.setup_seconds:.2g} s, {self.error_kind} {last.error:.1e}"
            )
        lines += [
            f"{one.label:<18} {one.seconds:.3g} s, {one.error:.1e}" for one in self.references
        ]
        return "\n".join(
            [*lines, *(f"left out: {what}: {reason}" for what, reason in self.left_out)]
        )


@dataclass(frozen=True)
class Profile(Exported):
    """Cost of every algorithm on every problem, divided by the least on that problem.

    Attributes
    ----------
    by : {"work", "seconds"}
        Passes over M, or median seconds, until the tolerance was reached.
    labels, families : tuple of str
        The algorithms.
    problems : tuple of str
        Those that at least one algorithm solved.
    ratios : tuple of tuples
        One row an algorithm, one entry a problem, ≥ 1; ∞ where it was not solved.
    """

    columns: ClassVar = ("algorithm", "family", "scene", "by", "ratio")

    by: str
    labels: tuple[str, ...]
    families: tuple[str, ...]
    problems: tuple[str, ...]
    ratios: tuple[tuple[float, ...], ...]

    def share(self, label: str, within: float = 1.0) -> float:
        """Return the share of the problems that the algorithm solves within that multiple of the best."""
        if label not in self.labels:
            raise InvalidOption(
                f"no algorithm {label!r} in this profile; it has {', '.join(self.labels)}"
            )
        row = self.ratios[self.labels.index(label)]
        return (
            sum(ratio <= within and ratio < math.inf for ratio in row) / len(row)
            if row
            else math.nan
        )

    def rows(self) -> list[tuple[Any, ...]]:
        """Return one row an algorithm and problem, in the columns of the CSV."""
        return [
            (label, family, problem, self.by, ratio)
            for label, family, row in zip(self.labels, self.families, self.ratios, strict=True)
            for problem, ratio in zip(self.problems, row, strict=True)
        ]

    def plot(self, *, width: float | None = None) -> Any:
        """Return a matplotlib figure, so many inches wide; `save` writes it into a file."""
        lines = [
            Line(
                label,
                family,
                finite,
                [(k + 1) / len(row) for k in range(len(finite))],
                len(finite) == len(row),
            )
            for label, family, row in zip(self.labels, self.families, self.ratios, strict=True)
            for finite in [sorted(ratio for ratio in row if math.isfinite(ratio))]
        ]
        unit = {"work": "work", "seconds": "time"}[self.by]
        title = f"Performance profile, {len(self.problems)} problems"
        panel = Panel(
            title,
            lines,
            f"{unit}, as a multiple of the best",
            "share of the problems solved",
            "shares",
        )
        return draw_panels([panel], width)


def performance_profile(reports: Sequence[Report], by: str = "work") -> Profile:
    """Return the performance profile; an algorithm that was left out of a problem counts as not solving it.

    Parameters
    ----------
    reports : sequence of Report
        One a problem, at least one.
    by : {"work", "seconds"}
        "work" gives the same profile on every machine.

    Raises
    ------
    InvalidOption
        Where `by` is something else, or there is no report.

    References
    ----------
    Dolan, Moré, *Benchmarking optimization software with performance profiles*, Math. Program. 91, 2002,
    doi:10.1007/s101070100263.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> from lcp_plugin.evidence.error_against_time import error_against_time
    >>> report = error_against_time(gallery.build("half_active", n=100), ["npgs", "pgs"], repeats=1)
    >>> performance_profile([report]).share("pgs")
    1.0
    """
    if by not in LEAST:
        raise InvalidOption(f"by must be 'work' or 'seconds', got {by!r}")
    if isinstance(reports, Report):
        raise InvalidOption(
            "a performance profile needs a list of reports, got one Report; write [report]"
        )
    if not reports:
        raise InvalidOption("a performance profile needs at least one report, got none")
    families = {curve.label: curve.family for report in reports for curve in report.curves}
    solved = [report for report in reports if any(curve.is_solved for curve in report.curves)]
    best = [min(_cost(curve, by) for curve in report.curves) for report in solved]
    ratios = tuple(
        tuple(
            _cost(report.curve(label), by) / least
            for report, least in zip(solved, best, strict=True)
        )
        for label in families
    )
    return Profile(
        by,
        tuple(families),
        tuple(families.values()),
        tuple(report.title for report in solved),
        ratios,
    )


def _cost(curve: Curve | None, by: str) -> float:
    if curve is None or not curve.is_solved:
        return math.inf
    return max(float(getattr(curve, by)), LEAST[by])
