"""How curves are drawn: one colour a family, names where the curves end, light grids, safe for the colour-blind.

Colours are those of Okabe and Ito. matplotlib loads when the first figure is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InvalidOption, LCPError
from ..problem.files import write_whole
from .curves import AXIS_LABELS, Curve, Report

if TYPE_CHECKING:
    from .performance_profile import Profile

FORMATS = (".png", ".pdf", ".svg")
COLOURS = {
    "projected-type (NP)": "#0072B2",
    "projected relaxation (P)": "#D55E00",
    "modulus (M)": "#009E73",
    "general fixed point (GFP)": "#CC79A7",
    "multigrid": "#B07D00",
    "factorising and pivoting": "#6A4C93",
    "auto": "#222222",
    "reference": "#56B4E9",
    "other": "#777777",
}
DASHES: tuple[Any, ...] = (
    "-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (3, 1, 1, 1, 1, 1)), (0, (11, 2)), (0, (2.5, 3)),
)
STYLE: Any = {
    "font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": "#999999",
    "axes.labelcolor": "#333333", "xtick.color": "#555555", "ytick.color": "#555555", "axes.grid": True,
    "grid.color": "#e9e9e9", "grid.linewidth": 0.7, "axes.axisbelow": True, "svg.fonttype": "path",
    "pdf.fonttype": 42, "ps.fonttype": 42, "axes.titlesize": 10, "axes.titlelocation": "left", "legend.frameon": False,
}
SIZE = (4.7, 4.1)
LABEL_SIZE = 8.0
STRIP = 0.36
"""Share of the height below the curves where their names stand."""

BEND = 0.22
"""Share of that height which the bent lines to the names take."""

LABEL_WIDTH = 0.047
"""Least distance of two names, as a share of the width."""

DEEPEST_BELOW_TOLERANCE = 1e-3
DIGITS = ((1.0,), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0), tuple(np.arange(1.0, 10.0, 0.2)))
"""First digits of the ticks, the first set that gives two of them."""

AXES = {"seconds": "seconds, set-up included", "work": "passes over M"}


def require_matplotlib() -> Any:
    """Return matplotlib's Figure class, or say how to install it."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise LCPError("a picture needs matplotlib; install it with: pip install 'lcp_plugin[report]'") from error
    return Figure


def check_format(path: Path) -> None:
    """Raise where the file's ending names no picture format."""
    if path.suffix.lower() not in FORMATS:
        raise InvalidOption(f"a picture must end in {', '.join(FORMATS)}, got {path.name!r}")


def save(figure: Any, path: Path) -> None:
    """Write the figure, whole or not at all."""
    check_format(path)
    kind = path.suffix[1:].lower()
    with styled():  # a font is chosen when the file is written
        write_whole({path: lambda file: figure.savefig(file, dpi=150, format=kind)})


def styled() -> Any:
    """Return the context in which figures get this module's style."""
    require_matplotlib()
    from matplotlib import rc_context

    return rc_context(STYLE)


def new_figure(size: tuple[float, float] = SIZE) -> tuple[Any, Any]:
    """Return (figure, axes), to be called within `styled`."""
    figure = require_matplotlib()(figsize=size, layout="constrained")
    return figure, figure.subplots()


def styles(families: Sequence[str]) -> list[dict[str, Any]]:
    """Return colour and dashes of each curve: the family's colour, another dash for each of its members."""
    seen: dict[str, int] = {}
    found = []
    for family in families:
        k = seen[family] = seen.get(family, -1) + 1
        found.append({"color": COLOURS.get(family, COLOURS["other"]), "linestyle": DASHES[k % len(DASHES)]})
    return found


# --- Error against time ---------------------------------------------------------------------------------------


def draw_curves(report: Report, against: str = "seconds") -> Any:
    """Return the figure of a report: log–log, each name below the point where its curve ends."""
    if not isinstance(against, str) or against not in AXES:
        raise InvalidOption(f"against must be 'seconds' or 'work', got {against!r}")
    with styled():
        figure, axes = new_figure()
        axes.set(xscale="log", yscale="log", xlabel=AXES[against], ylabel=AXIS_LABELS[report.error_kind])
        lines = styles([curve.family for curve in report.curves])
        lowest, highest = _range(report)
        axes.set_ylim(lowest, highest)
        strip = _below(lowest, highest)
        names = []
        for curve, line in zip(report.curves, lines, strict=True):
            x, y = _draw_curve(axes, curve, line, against, (lowest, highest))
            label, marker = (curve.label, "o") if curve.is_solved else (f"{curve.label} ✕", "x")
            names.append((x, y, label, line["color"], marker))
        if against == "seconds":
            names += [
                (one.seconds, max(one.error, lowest), one.label, COLOURS["reference"], "D")
                for one in report.references
            ]
        _fit_width(axes, report, against)
        axes.set_ylim(strip, highest)
        axes.axhspan(strip, lowest, color="#f8f8f8", zorder=0)
        axes.set_yticks([tick for tick in axes.get_yticks() if lowest <= tick <= highest])
        _tick_width(axes)
        _name_ends(axes, names, lowest, lowest * (strip / lowest) ** BEND)
        if report.error_kind == "residual":
            axes.axhline(report.tolerance, color="#999999", linewidth=0.7, linestyle=(0, (4, 3)), zorder=1)
    return figure


def _range(report: Report) -> tuple[float, float]:
    """Return the errors that are shown: from the least of an answer to ten times the largest start."""
    ends = [curve.points[-1].error for curve in report.curves if curve.is_solved]
    every = [point.error for curve in report.curves for point in curve.points]
    positive = [value for value in every if 0.0 < value < math.inf]
    if not positive:
        return 1e-16, 1.0
    starts = [curve.points[0].error for curve in report.curves if 0.0 < curve.points[0].error < math.inf]
    highest = 3.0 * max(starts or positive)
    least = min((value for value in ends if value > 0.0), default=min(positive))
    floor = float(np.median([value for value in ends if value > 0.0] or [least])) * DEEPEST_BELOW_TOLERANCE
    return max(least, floor) / 2.0, highest


def _below(lowest: float, highest: float) -> float:
    """Return the lower end of an axis that leaves room for the names."""
    decades = math.log10(highest / lowest)
    return lowest / float(10.0 ** (decades * STRIP / (1.0 - STRIP)))


def _abscissa(curve: Curve, against: str) -> Any:
    values = [point.seconds if against == "seconds" else max(point.work, 1.0) for point in curve.points]
    return np.maximum(values, 1e-9)


def _draw_curve(
    axes: Any, curve: Curve, line: dict[str, Any], against: str, shown: tuple[float, float]
) -> tuple[float, float]:
    """Draw one curve with its spread; return its end."""
    x = _abscissa(curve, against)
    y = np.clip(np.nan_to_num([point.error for point in curve.points], nan=shown[1], posinf=shown[1]), *shown)
    width = 2.0 if curve.family in ("auto", "multigrid") else 1.4
    axes.plot(x, y, linewidth=width, solid_capstyle="round", zorder=3, **line)
    axes.plot(x[:1], y[:1], "|", color=line["color"], markersize=6, zorder=4)
    if against == "seconds":
        low, high = ([getattr(point, name) for point in curve.points] for name in ("seconds_low", "seconds_high"))
        axes.fill_betweenx(y, np.maximum(low, 1e-9), high, color=line["color"], alpha=0.10, linewidth=0, zorder=2)
    return float(x[-1]), float(y[-1])


def _fit_width(axes: Any, report: Report, against: str) -> None:
    x = [value for curve in report.curves for value in _abscissa(curve, against)]
    if against == "seconds":
        x += [reference.seconds for reference in report.references]
    if x:
        axes.set_xlim(min(x) / 1.3, max(x) * 1.5)


def _tick_width(axes: Any) -> None:
    """Take the small ticks away; where fewer than two powers of ten are left to read a scale from, set others."""
    axes.minorticks_off()
    low, high = axes.get_xlim()
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for digits in DIGITS:
        ticks = [value for power in powers for digit in digits if low <= (value := digit * 10.0**power) <= high]
        if len(ticks) >= 2:
            break
    if digits != DIGITS[0]:
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])


def _name_ends(axes: Any, names: list[tuple[float, float, str, str, str]], edge: float, bend: float) -> None:
    """Write each name beyond the edge of the curves, side by side in the order in which they end.

    `names` holds (x, y, label, colour, marker); a line leads from (x, y) to the edge and bends to the name.
    """
    low, high = np.log10(axes.get_xlim())
    is_below = bend < edge
    order = sorted(names)
    wanted = [(math.log10(x) - low) / (high - low) for x, *_ in order]
    for (x, y, label, colour, marker), place in zip(order, spread(wanted, LABEL_WIDTH), strict=True):
        at = 10.0 ** (low + place * (high - low))
        axes.plot([x, x, at], [y, edge, bend], color=colour, linewidth=0.6, alpha=0.6, zorder=1)
        hollow = {"markerfacecolor": "white"} if marker == "D" else {}
        axes.plot([x], [y], marker, color=colour, markersize=4.2, markeredgewidth=1.3, zorder=5, **hollow)
        axes.annotate(
            label, (at, bend), (0, -2 if is_below else 2), textcoords="offset points", rotation=90, ha="center",
            va="top" if is_below else "bottom", fontsize=LABEL_SIZE, color=colour, annotation_clip=False,
        )


def spread(places: Sequence[float], gap: float, low: float = 0.015, high: float = 0.985) -> list[float]:
    """Return the places moved as little as needed to lie at least `gap` apart within [low, high], order kept.

    Examples
    --------
    >>> [round(place, 2) for place in spread([0.5, 0.5, 0.9], 0.1)]
    [0.45, 0.55, 0.9]
    """
    count = len(places)
    if count * gap > high - low:
        gap = (high - low) / max(count, 1)
    groups: list[list[float]] = []  # mean place wanted for the first of the group, number in it
    for k, place in enumerate(places):
        groups.append([place - k * gap, 1.0])
        while len(groups) > 1 and groups[-2][0] > groups[-1][0]:
            mean, size = groups.pop()
            before, many = groups.pop()
            groups.append([(before * many + mean * size) / (many + size), many + size])
    shifts = [mean for mean, size in groups for _ in range(int(size))]
    first, last = low, high - (count - 1) * gap
    return [min(max(shift, first), last) + k * gap for k, shift in enumerate(shifts)]


# --- Performance profile --------------------------------------------------------------------------------------


def draw_profile(profile: Profile) -> Any:
    """Return the figure of a performance profile: share of problems solved within a multiple of the best."""
    with styled():
        figure, axes = new_figure()
        unit = "passes over M" if profile.by == "work" else "seconds"
        axes.set(xscale="log", xlabel=f"{unit}, as a multiple of the best", ylabel="share of the problems solved")
        finite = [r for row in profile.ratios for r in row if math.isfinite(r)]
        end = max([*finite, 2.0]) * 1.6
        axes.set(xlim=(0.9, end), ylim=(-0.02, 1.0 / (1.0 - STRIP)))
        names = []
        for k, line in enumerate(styles(profile.families)):
            ratios = sorted(r for r in profile.ratios[k] if math.isfinite(r))
            heights = np.arange(1, len(ratios) + 1) / max(len(profile.problems), 1)
            x, y = [1.0, *ratios, end], [0.0, *heights, heights[-1] if ratios else 0.0]
            axes.step(x, y, where="post", linewidth=1.5, **line)
            is_complete = len(ratios) == len(profile.problems)
            names.append((x[-2], float(y[-1]), profile.labels[k], line["color"], "o" if is_complete else "x"))
        axes.axhspan(1.02, 2.0, color="#f8f8f8", zorder=0)
        axes.set_yticks([0.0, 0.2, 0.4, 0.6, 0.8, 1.0], ["0", "20 %", "40 %", "60 %", "80 %", "100 %"])
        _tick_width(axes)
        _name_ends(axes, names, 1.02, 1.02 + BEND * STRIP)
    return figure
