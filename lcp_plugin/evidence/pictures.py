"""One picture of an answer: what the scene is about, with its free boundary, and how the residual fell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..solving.result import Result
from .drawing import check_format, require_matplotlib, save, styled
from .gallery.scene import Scene

FINEST_SURFACE = 70
ACTIVE, FREE = "#D55E00", "#0072B2"
ZERO_BELOW = 0.1  # of the least number on a logarithmic axis: where 0 is drawn


def draw(result: Result, path: Path, scene: Scene | None = None, march: Sequence[Result] = ()) -> None:
    """Save the picture of a result, in the scene's own coordinates where it has a grid.

    Parameters
    ----------
    result : Result
    path : Path
        .png, .pdf or .svg.
    scene : Scene, optional
        A field is drawn as a surface and as a map with the edge of its contact set.
    march : sequence of Result, optional
        All steps of a march over one axis: the edge of the contact set is drawn over the steps.
    """
    check_format(path)
    with styled():
        is_field = scene is not None and scene.grid is not None and len(scene.grid) >= 2
        has_edge = len(march) > 1 and scene is not None and scene.coordinates is not None
        panels = 3 if is_field or has_edge else 2
        figure = require_matplotlib()(figsize=(4.9 * panels, 4.7), layout="constrained")
        if is_field:
            surface = figure.add_subplot(1, 3, 1, projection="3d")
            _draw_field(figure, surface, figure.add_subplot(1, 3, 2), result, scene)
        else:
            _draw_line(figure.add_subplot(1, panels, 1), result, scene)
            if has_edge:
                _draw_edge(figure.add_subplot(1, panels, 2), march, scene)
        _draw_residuals(figure.add_subplot(1, panels, panels), result)
        title = scene.description if scene is not None else ""
        run = f"n = {result.z.size}: {result.status.name} by {result.algorithm} in {result.iterations} iterations"
        figure.suptitle(f"{title}\n{run}".strip(), fontsize=11, x=0.01, ha="left")
        save(figure, path)


def _active(result: Result) -> Any:
    """Return which components rest on a bound."""
    problem = result.certificate.problem
    return (result.z <= problem.lower) | (result.z >= problem.upper)


def _draw_field(figure: Any, surface: Any, axes: Any, result: Result, scene: Any) -> None:
    field, active = scene.picture(result.z), scene.picture(_active(result))
    labels = scene.axis_labels
    coordinates = scene.coordinates or tuple(np.arange(size, dtype=float) for size in field.shape)
    while field.ndim > 2:  # the middle slice of what cannot be drawn whole
        field, active = field[field.shape[0] // 2], active[active.shape[0] // 2]
        labels, coordinates = labels[1:], coordinates[1:]
    rows, columns = coordinates
    image = axes.pcolormesh(columns, rows, field, shading="nearest", cmap="cividis", rasterized=True)
    figure.colorbar(image, ax=axes, shrink=0.8, label=scene.unknown).outline.set_visible(False)
    if active.any() and not active.all() and min(field.shape) > 1:
        for shade, width in (("#ffffff", 2.8), (ACTIVE, 1.5)):
            axes.contour(columns, rows, active, levels=[0.5], colors=shade, linewidths=width)
        axes.set_title(f"inside the line: {scene.active_means}", color=ACTIVE, fontsize=9)
    axes.grid(False)
    axes.set(xlabel=labels[1], ylabel=labels[0], aspect="equal" if _is_square(rows, columns) else "auto")
    _draw_surface(surface, field, active, rows, columns)
    surface.set(xlabel=labels[1], ylabel=labels[0])  # the height is named beside the colours


def _draw_surface(surface: Any, field: Any, active: Any, rows: Any, columns: Any) -> None:
    """Draw z as a surface, its contact set in the colour of the free boundary."""
    from matplotlib import colormaps

    if min(field.shape) < 2:
        surface.set_axis_off()
        return
    steps = tuple(slice(None, None, max(1, -(-size // FINEST_SURFACE))) for size in field.shape)
    field, active, rows, columns = field[steps], active[steps], rows[steps[0]], columns[steps[1]]
    height = float(np.ptp(field)) or 1.0
    colours = colormaps["cividis"]((field - field.min()) / height)
    colours[active.astype(bool)] = (0.835, 0.369, 0.0, 1.0)
    x, y = np.meshgrid(columns, rows)
    surface.plot_surface(x, y, field, facecolors=colours, rcount=80, ccount=80, linewidth=0, antialiased=False)
    surface.view_init(elev=36, azim=-60)


def _is_square(rows: Any, columns: Any) -> bool:
    height, width = float(np.ptp(rows)), float(np.ptp(columns))
    return bool(0.5 * width <= height <= 2.0 * width)


def _draw_line(axes: Any, result: Result, scene: Scene | None) -> None:
    problem = result.certificate.problem
    has_axis = scene is not None and scene.coordinates is not None
    x = scene.coordinates[0] if scene is not None and scene.coordinates is not None else np.arange(result.z.size)
    style = {"linewidth": 1.6} if result.z.size > 60 or has_axis else {"marker": "o", "linewidth": 0.8}
    for bound, name in ((problem.lower, "lower"), (problem.upper, "upper")):
        if np.isfinite(bound).all() and bound.size:
            axes.plot(x, bound, color="0.6", linewidth=1, linestyle="--", label=f"{name} bound")
    name = scene.unknown if scene is not None else "z"
    axes.plot(x, result.z, color=FREE, label=name, **style)
    touching = _active(result)
    if touching.any() and not touching.all():
        means = scene.active_means if scene is not None else "at a bound"
        axes.plot(x[touching], result.z[touching], ".", color=ACTIVE, markersize=4, label=means)
    label = scene.axis_labels[0] if scene is not None and scene.axis_labels else "index"
    axes.set(xlabel=label, ylabel=name)
    axes.legend(fontsize=8)


def _draw_edge(axes: Any, march: Sequence[Result], scene: Any) -> None:
    """Draw where the contact set that begins at the lower end of the axis ends, step by step."""
    x, edges = scene.coordinates[0], []
    for result in march:
        free = np.flatnonzero(~_active(result))
        edges.append(x[free[0] - 1] if free.size and free[0] > 0 else np.nan)
    steps = np.arange(1, len(march) + 1)
    axes.plot(steps, edges, color=ACTIVE, linewidth=1.8)
    bottom = np.nanmin(edges) if np.isfinite(edges).any() else 0.0
    axes.fill_between(steps, edges, bottom, color=ACTIVE, alpha=0.12, linewidth=0)
    axes.set_title(f"below the line: {scene.active_means}", color=ACTIVE, fontsize=9)
    axes.set(xlabel="step of the march", ylabel=scene.axis_labels[0])


def _draw_residuals(axes: Any, result: Result) -> None:
    samples = [(sample.seconds, sample.residual) for sample in result.history if sample.residual is not None]
    least = min([*(value for _, value in samples if value > 0.0), result.tolerance or 1.0])
    if samples:
        seconds, residuals = zip(*samples, strict=True)
        edge = ZERO_BELOW * least
        axes.semilogy(seconds, np.maximum(residuals, edge), ".-", markersize=4, color=FREE)
        if zeros := [second for second, value in samples if value == 0.0]:
            axes.plot(zeros, [edge] * len(zeros), "v", color=FREE, markersize=6)
            axes.annotate("exactly 0", (zeros[0], edge), (-6, 0), textcoords="offset points", ha="right", va="center",
                          color=FREE, fontsize=8)
    if result.tolerance > 0.0:
        axes.axhline(result.tolerance, color=ACTIVE, linewidth=1, linestyle="--")
        axes.annotate("tolerance", (0.99, result.tolerance), (0, 3), xycoords=("axes fraction", "data"),
                      textcoords="offset points", ha="right", color=ACTIVE, fontsize=8)
    axes.locator_params(axis="x", nbins=5)
    axes.set(xlabel="seconds", ylabel=f"{result.measure} residual", title="how the residual fell")
