"""How curves are drawn: one colour a family, names where the curves end, light grids, safe for the colour-blind.

Colours are those of Okabe and Ito. matplotlib loads when the first figure is asked for.
"""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, LCPError
from ..problem.files import write_whole

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
HEIGHTS = "cividis"
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


def styled(more: Mapping[str, Any] | None = None) -> Any:
    """Return the context in which figures get this module's style, and more where it is given."""
    require_matplotlib()
    from matplotlib import rc_context

    return rc_context(STYLE | dict(more or {}))


def new_figure(size: tuple[float, float] = SIZE) -> tuple[Any, Any]:
    """Return (figure, axes), to be called within `styled`."""
    figure = require_matplotlib()(figsize=size, layout="constrained")
    return figure, figure.subplots()


def heights_as_colours(heights: Any) -> Any:
    """Return a colour for each height, from the lowest to the highest."""
    require_matplotlib()
    from matplotlib import colormaps

    return colormaps[HEIGHTS]((heights - heights.min()) / (float(np.ptp(heights)) or 1.0))


def svg(figure: Any, name: str, description: str) -> str:
    """Return a figure as SVG to stand inside a page: every id with the name before it, so that none meets another's."""
    buffer = io.StringIO()
    with styled({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg"):]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    text = re.sub(r' (width|height)="[\d.]+pt"', "", text, count=2)
    text = re.sub(r' d="[^"]*"', lambda path: _rounded(path[0]), text)
    return text.replace("<svg", f'<svg role="img" aria-label="{html.escape(description)}"', 1)


def _rounded(path: str) -> str:
    """Return a path with its coordinates to a hundredth of a point, on one line."""
    return re.sub(r"\s*\n", "", re.sub(r"(\.\d\d)\d+", r"\1", path))


def styles(families: Sequence[str]) -> list[dict[str, Any]]:
    """Return colour and dashes of each curve: the family's colour, another dash for each of its members."""
    seen: dict[str, int] = {}
    found = []
    for family in families:
        k = seen[family] = seen.get(family, -1) + 1
        found.append({"color": COLOURS.get(family, COLOURS["other"]), "linestyle": DASHES[k % len(DASHES)]})
    return found


# --- Error against time ---------------------------------------------------------------------------------------


class Line(NamedTuple):
    """One line of a figure: its name, the family that colours it, whether it converges, and how far x spreads."""

    label: str
    family: str
    x: Any
    y: Any
    converged: bool
    band: tuple[Any, Any] | None = None


Name = tuple[float, float, str, str, str]  # x, y, label, colour, marker


def draw_errors(
    lines: Sequence[Line], marks: Sequence[tuple[str, float, float]], labels: tuple[str, str], level: float | None
) -> Any:
    """Return a log–log figure of falling errors, each name below the point where its line ends.

    Parameters
    ----------
    lines : sequence of Line
    marks : sequence of (name, x, y)
        Single points.
    labels : pair of str
        Of the axes.
    level : float or None
        A height to be marked.
    """
    with styled():
        figure, axes = new_figure()
        axes.set(xscale="log", yscale="log", xlabel=labels[0], ylabel=labels[1])
        lowest, highest = _range(lines)
        strip = _below(lowest, highest)
        looks = styles([line.family for line in lines])
        names = [_draw(axes, line, look, (lowest, highest)) for line, look in zip(lines, looks, strict=True)]
        names += [(x, max(y, lowest), label, COLOURS["reference"], "D") for label, x, y in marks]
        every = [x for line in lines for x in _positive(line.x)] + [x for _, x, _ in marks]
        if every:
            axes.set_xlim(min(every) / 1.3, max(every) * 1.5)
        axes.set_ylim(strip, highest)
        axes.axhspan(strip, lowest, color="#f8f8f8", zorder=0)
        axes.set_yticks([tick for tick in axes.get_yticks() if lowest <= tick <= highest])
        _tick_width(axes)
        _name_ends(axes, names, lowest, lowest * (strip / lowest) ** BEND)
        if level is not None:
            axes.axhline(level, color="#999999", linewidth=0.7, linestyle=(0, (4, 3)), zorder=1)
    return figure


def _range(lines: Sequence[Line]) -> tuple[float, float]:
    """Return the errors that are shown: from the least of an answer to three times the largest start."""
    positive = [value for line in lines for value in line.y if 0.0 < value < math.inf]
    if not positive:
        return 1e-16, 1.0
    ends = [line.y[-1] for line in lines if line.converged and line.y[-1] > 0.0]
    starts = [line.y[0] for line in lines if 0.0 < line.y[0] < math.inf]
    least = min(ends, default=min(positive))
    floor = float(np.median(ends or [least])) * DEEPEST_BELOW_TOLERANCE
    return max(least, floor) / 2.0, 3.0 * max(starts or positive)


def _below(lowest: float, highest: float) -> float:
    """Return the lower end of an axis that leaves room for the names."""
    decades = math.log10(highest / lowest)
    return lowest / float(10.0 ** (decades * STRIP / (1.0 - STRIP)))


def _positive(x: Any) -> Any:
    return np.maximum(x, 1e-9)


def _draw(axes: Any, line: Line, look: dict[str, Any], shown: tuple[float, float]) -> Name:
    """Draw one line with its spread; return where its name belongs."""
    x, y = _positive(line.x), np.clip(np.nan_to_num(line.y, nan=shown[1], posinf=shown[1]), *shown)
    width = 2.0 if line.family in ("auto", "multigrid") else 1.4
    axes.plot(x, y, linewidth=width, solid_capstyle="round", zorder=3, **look)
    axes.plot(x[:1], y[:1], "|", color=look["color"], markersize=6, zorder=4)
    if line.band is not None:
        low, high = line.band
        axes.fill_betweenx(y, _positive(low), high, color=look["color"], alpha=0.10, linewidth=0, zorder=2)
    label, marker = (line.label, "o") if line.converged else (f"{line.label} ✕", "x")
    return float(x[-1]), float(y[-1]), label, look["color"], marker


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


def _name_ends(axes: Any, names: list[Name], edge: float, bend: float) -> None:
    """Write each name beyond the edge of the curves, side by side in the order in which they end.

    A line leads from (x, y) to the edge and bends to the name.
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


def draw_shares(lines: Sequence[Line], labels: tuple[str, str]) -> Any:
    """Return the figure of shares y that are reached at x ≥ 1, each a step, x on a logarithmic axis."""
    with styled():
        figure, axes = new_figure()
        end = max([x for line in lines for x in line.x] + [2.0]) * 1.6
        axes.set(xscale="log", xlabel=labels[0], ylabel=labels[1], xlim=(0.9, end), ylim=(-0.02, 1.0 / (1.0 - STRIP)))
        names = []
        for line, look in zip(lines, styles([line.family for line in lines]), strict=True):
            x, y = [1.0, *line.x, end], [0.0, *line.y, line.y[-1] if line.y else 0.0]
            axes.step(x, y, where="post", linewidth=1.5, **look)
            names.append((x[-2], float(y[-1]), line.label, look["color"], "o" if line.converged else "x"))
        axes.axhspan(1.02, 2.0, color="#f8f8f8", zorder=0)
        axes.set_yticks([0.0, 0.2, 0.4, 0.6, 0.8, 1.0], ["0", "20 %", "40 %", "60 %", "80 %", "100 %"])
        _tick_width(axes)
        _name_ends(axes, names, 1.02, 1.02 + BEND * STRIP)
    return figure
