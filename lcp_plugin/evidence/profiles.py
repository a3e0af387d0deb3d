"""Dolan and Moré's performance profile: how often each method is the best, or within a multiple of the best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from ..core.errors import InvalidOption
from ..doors.files.files import checked_path
from .curves import Curve, Report
from .drawing import save
from .exporting import AnyPath, Exported
from .figures import Line, Panel, draw_panels

LEAST = {"work": 1.0, "seconds": 1e-9}
"""Less is not told apart: a run whose start is the answer counts one pass."""


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
            raise InvalidOption(f"no algorithm {label!r} in this profile; it has {', '.join(self.labels)}")
        row = self.ratios[self.labels.index(label)]
        return sum(ratio <= within and ratio < math.inf for ratio in row) / len(row) if row else math.nan

    def rows(self) -> list[tuple[Any, ...]]:
        """Return one row an algorithm and problem, in the columns of the CSV."""
        return [
            (label, family, problem, self.by, ratio)
            for label, family, row in zip(self.labels, self.families, self.ratios, strict=True)
            for problem, ratio in zip(self.problems, row, strict=True)
        ]

    def plot(self, path: AnyPath | None = None, *, width: float | None = None) -> Any:
        """Return a matplotlib figure, so many inches wide, and save it where `path` is given."""
        lines = [
            Line(label, family, finite, [(k + 1) / len(row) for k in range(len(finite))], len(finite) == len(row))
            for label, family, row in zip(self.labels, self.families, self.ratios, strict=True)
            for finite in [sorted(ratio for ratio in row if math.isfinite(ratio))]
        ]
        unit = {"work": "work", "seconds": "time"}[self.by]
        title = f"Performance profile, {len(self.problems)} problems"
        panel = Panel(title, lines, f"{unit}, as a multiple of the best", "share of the problems solved", "shares")
        figure = draw_panels([panel], width)
        if path is not None:
            save(figure, checked_path(path))
        return figure


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
        raise InvalidOption("a performance profile needs a list of reports, got one Report; write [report]")
    if not reports:
        raise InvalidOption("a performance profile needs at least one report, got none")
    families = {curve.label: curve.family for report in reports for curve in report.curves}
    solved = [report for report in reports if any(curve.is_solved for curve in report.curves)]
    best = [min(_cost(curve, by) for curve in report.curves) for report in solved]
    ratios = tuple(
        tuple(_cost(report.curve(label), by) / least for report, least in zip(solved, best, strict=True))
        for label in families
    )
    return Profile(by, tuple(families), tuple(families.values()), tuple(report.title for report in solved), ratios)


def _cost(curve: Curve | None, by: str) -> float:
    if curve is None or not curve.is_solved:
        return math.inf
    return max(float(getattr(curve, by)), LEAST[by])
