"""What all pictures share, style, colours, files, SVG inside a page; figures of many lines, readable in grey; and maps.

Colours of families are those of Okabe and Ito. matplotlib loads when the first figure is asked for.
"""

from __future__ import annotations

import html
import io
import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.errors import InvalidOption, LCPError
from ..interfaces.files.files import write_whole

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
}
STYLE: Any = {
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#999999",
    "axes.labelcolor": "#333333",
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "axes.grid": True,
    "grid.color": "#e9e9e9",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
}
HEIGHTS = "cividis"
LABEL_SIZE = 7.0
OWN = (
    "#8C1D40",
    "#3F3FBF",
    "#4D7C0F",
    "#00838F",
    "#7A7A7A",
    "#C2185B",
)  # of methods that belong to no family
MARKERS = "osD^v<>phX*P"
DASHES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.6)),
    (0, (1.2, 1.2)),
    (0, (6, 1.5, 1.2, 1.5)),
    (0, (3, 1, 1, 1, 1, 1)),
    (0, (11, 2)),
    (0, (2.5, 3)),
)
JOURNAL = {"font.size": 8.0, "axes.titlesize": 8.5}
COLUMN, PAGE = 3.5, 7.1
"""Inches: the width of a journal's column, and of its page."""

HEIGHT, MOST_COLUMNS, MOST_MAPS = (
    0.78,
    3,
    4,
)  # of a panel, as a share of its width; panels and maps side by side
MARKED = 7  # markers along a line
LEGEND_LINE, LETTERS = 0.17, 13  # inches; letters of a title to the inch
NAME_WIDTH, LETTER_WIDTH = (
    0.5,
    0.055,
)  # inches: of a line and the space beside it in a legend, of a letter of its name


def require_matplotlib() -> Any:
    """Return matplotlib's Figure class, or say how to install it."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise LCPError(
            "a picture needs matplotlib; install it with: pip install 'lcp_plugin[report]'"
        ) from error
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


def heights_as_colours(heights: Any) -> Any:
    """Return a colour for each height, from the lowest to the highest."""
    require_matplotlib()
    from matplotlib import colormaps

    return colormaps[HEIGHTS]((heights - heights.min()) / (float(np.ptp(heights)) or 1.0))


def svg(figure: Any, name: str, description: str) -> str:
    """Return a figure as SVG to stand inside a page: every id with the name before it, so that none meets another's."""
    buffer = io.StringIO()
    with styled({"svg.hashsalt": name}):
        figure.savefig(
            buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None}
        )
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
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
    """Return colour, dashes and marker of each curve: the family's colour, where it has one, and no two alike in grey.

    Examples
    --------
    >>> [look["marker"] for look in styles(["auto", "other", "other"])]
    ['o', 's', 'D']
    """
    seen: dict[str, int] = {}
    found = []
    for place, family in enumerate(families):
        k = seen[family] = seen.get(family, -1) + 1
        colour = COLOURS.get(family) or OWN[k % len(OWN)]
        look = {
            "color": colour,
            "linestyle": DASHES[place % len(DASHES)],
            "marker": MARKERS[place % len(MARKERS)],
        }
        found.append(look)
    return found


# --- Curves ---------------------------------------------------------------------------------------------------


class Line(NamedTuple):
    """One line of a panel: its name, the family that colours it, whether it converges, and how far x spreads.

    `text` stands behind the name where there is one, as an exponent.
    """

    label: str
    family: str
    x: Any
    y: Any
    converged: bool = True
    band: tuple[Any, Any] | None = None
    text: str = ""


class Panel(NamedTuple):
    """Lines over the same axes: "errors" that fall, values that grow with "sizes", or "shares" of problems.

    `marks` are single points: name, x, y. `level` is a height to be marked, the tolerance.
    """

    title: str
    lines: Sequence[Line]
    x_label: str
    y_label: str
    kind: str = "errors"
    marks: Sequence[tuple[str, float, float]] = ()
    level: float | None = None


def draw_panels(panels: Sequence[Panel], width: float | None = None) -> Any:
    """Return a figure as wide as a column, or with several panels as a page, the names of all lines below them.

    Where lines have a text of their own, the names stand below each panel.

    Raises
    ------
    InvalidOption
        Where no panel has a point to show.
    """
    if not any(len(line.x) for panel in panels for line in panel.lines) and not any(
        panel.marks for panel in panels
    ):
        raise InvalidOption(
            "there is nothing to draw: no run gave an answer; print() says how each ended"
        )
    columns = max(1, min(len(panels), MOST_COLUMNS))
    rows = max(1, -(-len(panels) // columns))
    width = width or (COLUMN if columns == 1 else PAGE)
    labels = {line.label: line.family for panel in panels for line in panel.lines}
    looks = dict(zip(labels, styles(list(labels.values())), strict=True))
    has_own = any(line.text for panel in panels for line in panel.lines)
    with styled(JOURNAL):
        height = rows * HEIGHT * width / columns
        figure = require_matplotlib()(figsize=(width, height), layout="constrained")
        parts = list(figure.subfigures(rows, columns, squeeze=False).ravel()) if has_own else []
        axes_of = [part.subplots() for part in parts[: len(panels)]]
        every = axes_of if has_own else figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in every[len(panels) :]:
            axes.set_axis_off()
        for k, (axes, panel) in enumerate(zip(every, panels, strict=False)):
            _draw_panel(axes, panel, looks)
            axes.set_title(textwrap.fill(panel.title, int(LETTERS * width / columns)))
            if k % columns and panel.y_label == panels[k - 1].y_label:
                axes.set_ylabel("")
            if k + columns < len(panels):
                axes.set_xlabel("")
        own = [dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True)) for axes in every]
        if has_own:
            lines = [
                _name_lines(part, names, width / columns)
                for part, names in zip(parts, own, strict=False)
            ]
            below = sum(
                max(lines[first : first + columns]) for first in range(0, len(lines), columns)
            )
        else:
            below = _name_lines(
                figure, {label: handle for names in own for label, handle in names.items()}, width
            )
        figure.set_size_inches(width, height + below * LEGEND_LINE)
    return figure


def _name_lines(figure: Any, named: Mapping[str, Any], width: float) -> int:
    """Write the names below a figure of that width, where they hide nothing; return how many lines that takes."""
    if not named:
        return 0
    longest = max(map(len, named))
    count = max(1, min(len(named), int(width / (NAME_WIDTH + LETTER_WIDTH * longest))))
    figure.legend(
        named.values(),
        named.keys(),
        loc="outside lower center",
        ncols=count,
        fontsize=LABEL_SIZE,
        handlelength=2.4,
        columnspacing=1.0,
        labelspacing=0.3,
    )
    return math.ceil(len(named) / count)


def _draw_panel(axes: Any, panel: Panel, looks: Mapping[str, dict[str, Any]]) -> None:
    is_share = panel.kind == "shares"
    axes.set(
        xscale="log",
        yscale="linear" if is_share else "log",
        xlabel=panel.x_label,
        ylabel=panel.y_label,
    )
    shown = _range(panel.lines) if panel.kind == "errors" else (0.0, math.inf)
    every = [x for line in panel.lines for x in _positive(line.x)] + [x for _, x, _ in panel.marks]
    if is_share:
        axes.set(xlim=(1.0, max([*every, 2.0]) * 1.1), ylim=(0.0, 1.03))
        axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
    elif every:
        axes.set_xlim(min(every) / 1.15, max(every) * 1.15)
    if panel.kind == "errors":
        axes.set_ylim(shown[0] / 1.5, shown[1])
    for line in panel.lines:
        _draw(axes, line, looks[line.label], shown, is_share=is_share)
    if not panel.lines:
        axes.text(
            0.5,
            0.5,
            "no answer: print() says why",
            ha="center",
            transform=axes.transAxes,
            color="#777777",
        )
    for k, (label, x, y) in enumerate(panel.marks):
        axes.plot(
            [x],
            [max(y, shown[0])],
            "Dsv^<>"[k % 6],
            color=COLOURS["reference"],
            markerfacecolor="white",
            markersize=5,
            label=label,
            linestyle="none",
            zorder=5,
        )
    if panel.level is not None:
        axes.axhline(panel.level, color="#777777", linewidth=0.7, linestyle=(0, (4, 3)), zorder=1)
        axes.annotate(
            "tolerance",
            (1.0, panel.level),
            (2, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            rotation=90,
            va="bottom",
            color="#777777",
            fontsize=LABEL_SIZE - 1,
        )


def _range(lines: Sequence[Line]) -> tuple[float, float]:
    """Return the errors that are shown: from the least of an answer to three times the largest start."""
    positive = [value for line in lines for value in line.y if 0.0 < value < math.inf]
    if not positive:
        return 1e-16, 1.0
    ends = [line.y[-1] for line in lines if line.converged and line.y[-1] > 0.0]
    starts = [line.y[0] for line in lines if 0.0 < line.y[0] < math.inf]
    least = min(ends, default=min(positive))
    floor = float(np.median(ends or [least])) * 1e-3  # what lies deeper is left out
    return max(least, floor) / 2.0, 3.0 * max(starts or positive)


def _positive(x: Any) -> Any:
    return np.maximum(x, 1e-9)


def _draw(
    axes: Any, line: Line, look: dict[str, Any], shown: tuple[float, float], *, is_share: bool
) -> None:
    """Draw one line with its spread and some markers; one that fails ends in a cross."""
    x, y = _positive(line.x), np.clip(np.nan_to_num(line.y, nan=shown[1], posinf=shown[1]), *shown)
    if is_share:
        edge = axes.get_xlim()[1]
        x, y = (
            np.concatenate([[1.0], x, [edge]]),
            np.concatenate([[0.0], y, y[-1:] if len(y) else [0.0]]),
        )
    label = f"{line.label}{'' if line.converged else ' ✕'}  {line.text}".rstrip()
    every = [*np.unique(np.linspace(0, max(len(x) - 1, 0), MARKED).astype(int))] if len(x) else None
    axes.plot(
        x,
        y,
        linewidth=1.1,
        markersize=3.5,
        markerfacecolor="white",
        markeredgewidth=0.9,
        markevery=every,
        drawstyle="steps-post" if is_share else "default",
        zorder=3,
        label=label,
        **look,
    )
    if not line.converged and not is_share:
        axes.plot(x[-1:], y[-1:], "x", color=look["color"], markersize=6, zorder=5)
    if line.band is not None:
        low, high = line.band
        axes.fill_betweenx(
            y, _positive(low), high, color=look["color"], alpha=0.10, linewidth=0, zorder=2
        )


# --- Maps of stability ----------------------------------------------------------------------------------------


def draw_maps(
    maps: Mapping[str, Mapping[tuple[str, str], str]],
    outcomes: Mapping[str, tuple[str, str]],
    title: str,
    width: float | None = None,
) -> Any:
    """Return a figure with a map a name, rows × columns of outcomes, each in its colour and with its sign."""
    rows, extents = (
        list(dict.fromkeys(place[k] for one in maps.values() for place in one)) for k in (0, 1)
    )
    columns = min(len(maps), MOST_MAPS)
    lines, width = -(-len(maps) // columns), width or (PAGE if columns > 1 else COLUMN)
    with styled(JOURNAL | {"axes.grid": False}):
        from matplotlib.patches import Patch

        height = 0.7 + lines * (0.3 + 0.55 * width / columns)
        figure = require_matplotlib()(figsize=(width, height), layout="constrained")
        every = figure.subplots(lines, columns, squeeze=False)
        for k, axes in enumerate(every.ravel()):
            if k >= len(maps):
                axes.set_axis_off()
                continue
            name, found = list(maps.items())[k]
            for (row, extent), outcome in found.items():
                x, y = extents.index(extent), rows.index(row)
                colour, sign = outcomes[outcome]
                axes.fill_between(
                    [x - 0.5, x + 0.5],
                    y - 0.5,
                    y + 0.5,
                    facecolor=colour,
                    edgecolor="white",
                    linewidth=0.8,
                )
                axes.text(x, y, sign, ha="center", va="center", fontsize=LABEL_SIZE)
            axes.set_title(name)
            axes.set(xlim=(-0.5, len(extents) - 0.5), ylim=(len(rows) - 0.5, -0.5))
            axes.set_xticks(range(0, len(extents), 2), extents[::2], fontsize=LABEL_SIZE)
            axes.set_yticks(
                range(len(rows)),
                rows if k % columns == 0 else [""] * len(rows),
                fontsize=LABEL_SIZE,
            )
            axes.tick_params(length=0)
            if k + columns >= len(maps):
                axes.set_xlabel("stiffness 10^k: k", fontsize=LABEL_SIZE)
        figure.suptitle(title, x=0.01, ha="left", fontsize=9)
        signs = [
            Patch(
                facecolor=colour, edgecolor="#999999", label=f"{name} {sign}".strip(), linewidth=0.5
            )
            for name, (colour, sign) in outcomes.items()
        ]
        figure.legend(
            handles=signs,
            loc="outside lower center",
            ncols=max(1, int(width / 1.4)),
            fontsize=LABEL_SIZE,
        )
    return figure
