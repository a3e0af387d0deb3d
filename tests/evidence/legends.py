"""Whether the names beside a figure hide nothing of it."""

from __future__ import annotations

from typing import Any


def hides_nothing(figure: Any) -> bool:
    """Return whether the figure, or each of its parts, has a legend, and none covers axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure).draw()
    legends = [legend for one in (figure, *figure.subfigs) for legend in one.legends]
    return (
        bool(legends)
        and not any(axes.get_legend() for axes in figure.axes)
        and not any(
            legend.get_window_extent().overlaps(axes.get_window_extent())
            for legend in legends
            for axes in figure.axes
        )
    )
