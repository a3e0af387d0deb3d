"""Performance profile: how often each algorithm is the best, and how far behind it is where it is not."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any

from ..errors import InvalidOption
from ..problem.files import checked_path
from .curves import Curve, Report, csv_text, finite_content, write_text

LEAST = {"work": 1.0, "seconds": 1e-9}
"""Less is not told apart: a run whose start is the answer counts one pass."""


@dataclass(frozen=True)
class Profile:
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

    def to_content(self) -> dict[str, Any]:
        """Return everything as JSON can hold it; ∞ becomes None."""
        found: dict[str, Any] = finite_content(asdict(self))
        return found

    def to_json(self, path: str | PathLike[str] | None = None) -> str:
        """Return everything as JSON text, and write it to `path` where one is given."""
        text = json.dumps(self.to_content(), indent=1, ensure_ascii=False)
        if path is not None:
            write_text(path, text)
        return text

    def to_csv(self, path: str | PathLike[str] | None = None) -> str:
        """Return one line an algorithm and problem as CSV text, and write it to `path` where one is given."""
        rows: list[tuple[Any, ...]] = [
            (label, family, problem, self.by, ratio)
            for label, family, row in zip(self.labels, self.families, self.ratios, strict=True)
            for problem, ratio in zip(self.problems, row, strict=True)
        ]
        text = csv_text(("algorithm", "family", "scene", "by", "ratio"), rows)
        if path is not None:
            write_text(path, text)
        return text

    def plot(self, path: str | PathLike[str] | None = None) -> Any:
        """Return a matplotlib figure, and save it where `path` is given."""
        from .drawing import draw_profile, save

        figure = draw_profile(self)
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
    >>> from lcp_plugin.evidence import gallery
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
