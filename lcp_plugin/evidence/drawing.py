"""What all pictures share: style, colours, files, and SVG inside a page.

Colours of families are those of Okabe and Ito. matplotlib loads when the first figure is asked for.
"""

from __future__ import annotations

import html
import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InvalidOption, LCPError
from ..doors.files.files import write_whole

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
    "font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": "#999999",
    "axes.labelcolor": "#333333", "xtick.color": "#555555", "ytick.color": "#555555", "axes.grid": True,
    "grid.color": "#e9e9e9", "grid.linewidth": 0.7, "axes.axisbelow": True, "svg.fonttype": "path",
    "pdf.fonttype": 42, "ps.fonttype": 42, "axes.titlesize": 10, "axes.titlelocation": "left", "legend.frameon": False,
}
HEIGHTS = "cividis"
LABEL_SIZE = 7.0


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
