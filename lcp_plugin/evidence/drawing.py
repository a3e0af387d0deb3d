"""Style and files of all plots, and plots of many lines that can be read in grey.

Colors of families are Okabe and Ito's colors. matplotlib loads with the first figure.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.errors import InvalidOption, LCPError
from ..interfaces.files.files import write_whole

FORMATS = (".png", ".pdf", ".svg")
COLORS = {
    "projected-type (NP)": "#0072B2",
    "projected relaxation (P)": "#D55E00",
    "modulus (M)": "#009E73",
    "general fixed point (GFP)": "#CC79A7",
    "multigrid": "#B07D00",
    "factorizing and pivoting": "#6A4C93",
    "auto": "#222222",
    "reference": "#56B4E9",
    "other": "#8C1D40",
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
MARKERS = "osD^v<>phX*P"
DASHES = ("-", "--", "-.", ":")
JOURNAL = {"font.size": 8.0, "axes.titlesize": 8.5}
COLUMN_WIDTH, PAGE_WIDTH = 3.5, 7.1  # width of a journal's column, and of its page
HEIGHT_RATIO, MAX_COLUMNS = 0.78, 3
MARKERS_PER_LINE = 7
LEGEND_LINE_INCHES, LETTERS_PER_INCH = 0.17, 13
NAME_INCHES, LETTER_INCHES = 0.5, 0.055  # of a line and its space in a legend, of a letter


def require_matplotlib() -> Any:
    """Return matplotlib's Figure class, or say how to install it."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise LCPError(
            "a picture needs matplotlib; install it with: pip install '.[report]'"
        ) from error
    return Figure


def check_format(path: Path) -> None:
    """Raise InvalidOption if the file's ending names no plot format."""
    if path.suffix.lower() not in FORMATS:
        raise InvalidOption(f"a picture must end in {', '.join(FORMATS)}, got {path.name!r}")


def save(figure: Any, path: Path) -> None:
    """Write the figure, whole or not at all."""
    check_format(path)
    kind = path.suffix[1:].lower()
    with styled():  # matplotlib chooses the font when it writes the file
        write_whole({path: lambda file: figure.savefig(file, dpi=150, format=kind)})


def styled(more: Mapping[str, Any] | None = None) -> Any:
    """Return the context in which figures get this module's style."""
    require_matplotlib()
    from matplotlib import rc_context

    return rc_context(STYLE | dict(more or {}))


class PanelLine(NamedTuple):
    """Curve of a panel: label, family, points, whether the run converged, quartiles of x."""

    label: str
    family: str
    x: Any
    y: Any
    converged: bool = True
    band: tuple[Any, Any] | None = None


class Panel(NamedTuple):
    """Lines over the same axes: "errors" that fall, values that grow with "sizes", or "shares" of problems.

    `marks` are single points (label, x, y); `level` is the tolerance.
    """

    title: str
    lines: Sequence[PanelLine]
    x_label: str
    y_label: str
    kind: str = "errors"
    marks: Sequence[tuple[str, float, float]] = ()
    level: float | None = None


def draw_panels(panels: Sequence[Panel], width: float | None = None) -> Any:
    """Return a figure as wide as a column, or as a page if there are several panels, with one legend below.

    Raises
    ------
    InvalidOption
        If no panel has a point to show.
    """
    if not any(panel.marks or any(len(line.x) for line in panel.lines) for panel in panels):
        raise InvalidOption(
            "nothing to draw: no run has a result; print() lists how each run ended"
        )
    columns = min(len(panels), MAX_COLUMNS)
    rows = -(-len(panels) // columns)
    width = width or (COLUMN_WIDTH if columns == 1 else PAGE_WIDTH)
    families = {line.label: line.family for panel in panels for line in panel.lines}
    looks = {
        label: {
            "color": COLORS[family],
            "linestyle": DASHES[k % len(DASHES)],
            "marker": MARKERS[k % len(MARKERS)],
        }
        for k, (label, family) in enumerate(families.items())
    }
    with styled(JOURNAL):
        height = rows * HEIGHT_RATIO * width / columns
        figure = require_matplotlib()(figsize=(width, height), layout="constrained")
        every = figure.subplots(rows, columns, squeeze=False).ravel()
        named: dict[str, Any] = {}
        for k, axes in enumerate(every):
            if k >= len(panels):
                axes.set_axis_off()
                continue
            _draw_panel(axes, panels[k], looks)
            axes.set_title(textwrap.fill(panels[k].title, int(LETTERS_PER_INCH * width / columns)))
            if k % columns and panels[k].y_label == panels[k - 1].y_label:
                axes.set_ylabel("")
            if k + columns < len(panels):
                axes.set_xlabel("")
            handles, labels = axes.get_legend_handles_labels()
            named |= dict(zip(labels, handles, strict=True))
        longest = max(map(len, named))
        count = max(1, min(len(named), int(width / (NAME_INCHES + LETTER_INCHES * longest))))
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
        figure.set_size_inches(width, height + math.ceil(len(named) / count) * LEGEND_LINE_INCHES)
    return figure


def _draw_panel(axes: Any, panel: Panel, looks: Mapping[str, dict[str, Any]]) -> None:
    is_share, is_error = panel.kind == "shares", panel.kind == "errors"
    scales = {"xscale": "log", "yscale": "linear" if is_share else "log"}
    axes.set(**scales, xlabel=panel.x_label, ylabel=panel.y_label)
    shown = _range(panel.lines) if is_error else (0.0, math.inf)
    every = [max(x, 1e-9) for line in panel.lines for x in line.x] + [x for _, x, _ in panel.marks]
    if is_share:
        axes.set(xlim=(1.0, max([*every, 2.0]) * 1.1), ylim=(0.0, 1.03))
        axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
    elif every:
        axes.set_xlim(min(every) / 1.15, max(every) * 1.15)
    if is_error:
        axes.set_ylim(shown[0] / 1.5, shown[1])
    for line in panel.lines:
        _draw(axes, line, looks[line.label], shown, is_share=is_share)
    if not panel.lines:
        axes.text(
            0.5, 0.5, "no result: print() lists the reasons", ha="center", transform=axes.transAxes
        )
    for k, (label, x, y) in enumerate(panel.marks):
        look = {"color": COLORS["reference"], "markerfacecolor": "white", "linestyle": "none"}
        axes.plot(
            [x], [max(y, shown[0])], "Dsv^<>"[k % 6], markersize=5, label=label, zorder=5, **look
        )
    if panel.level is not None:
        axes.axhline(panel.level, color="#777777", linewidth=0.7, linestyle=(0, (4, 3)), zorder=1)
        axes.text(1.0, panel.level, " tolerance", transform=axes.get_yaxis_transform(),
                  rotation=90, va="bottom", color="#777777", fontsize=LABEL_SIZE - 1)  # fmt: skip


def _range(lines: Sequence[PanelLine]) -> tuple[float, float]:
    """Return the errors that are shown: from the least of a result to three times the largest start."""
    positive = [value for line in lines for value in line.y if 0.0 < value < math.inf]
    if not positive:
        return 1e-16, 1.0
    ends = [line.y[-1] for line in lines if line.converged and line.y[-1] > 0.0]
    starts = [line.y[0] for line in lines if 0.0 < line.y[0] < math.inf]
    least = min(ends, default=min(positive))
    floor = float(np.median(ends or [least])) * 1e-3
    return max(least, floor) / 2.0, 3.0 * max(starts or positive)


def _draw(
    axes: Any, line: PanelLine, look: dict[str, Any], shown: tuple[float, float], *, is_share: bool
) -> None:
    """Draw one line with its quartiles and some markers; a run that fails ends in a cross."""
    x = np.maximum(line.x, 1e-9)
    y = np.clip(np.nan_to_num(line.y, nan=shown[1], posinf=shown[1]), *shown)
    if is_share:
        x = np.concatenate([[1.0], x, [axes.get_xlim()[1]]])
        y = np.concatenate([[0.0], y, y[-1:] if len(y) else [0.0]])
    axes.plot(
        x,
        y,
        linewidth=1.1,
        markersize=3.5,
        markerfacecolor="white",
        markeredgewidth=0.9,
        markevery=[*np.unique(np.linspace(0, max(len(x) - 1, 0), MARKERS_PER_LINE).astype(int))],
        drawstyle="steps-post" if is_share else "default",
        zorder=3,
        label=f"{line.label}{'' if line.converged else ' ✕'}",
        **look,
    )
    if not line.converged and not is_share:
        axes.plot(x[-1:], y[-1:], "x", color=look["color"], markersize=6, zorder=5)
    if line.band is not None:
        low, high = line.band
        axes.fill_betweenx(
            y, np.maximum(low, 1e-9), high, color=look["color"], alpha=0.10, linewidth=0, zorder=2
        )
