"""A small picture of what a scene is about: the field, line or dots of z, and where it rests on a bound."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..certificates.residuals import Certificate
from .drawing import new_figure, styled
from .gallery.scene import Scene

FINEST = 110
LONGEST = 600
ACTIVE, FREE = "#D55E00", "#0072B2"
SIZE = (3.6, 3.2)


def sketch_of(scene: Scene, answer: Certificate) -> dict[str, Any]:
    """Return what the sketch shows, coarse enough for JSON: kind, values, coordinates and names."""
    z, active = answer.z, (answer.z <= answer.problem.lower) | (answer.z >= answer.problem.upper)
    names = {"unknown": scene.unknown, "active_means": scene.active_means}
    if scene.grid is None or len(scene.grid) == 1 or min(scene.grid[-2:]) < 2:
        return names | _line(scene, z, active)
    field, resting = scene.picture(z), scene.picture(active)
    labels, axes = list(scene.axis_labels), list(scene.coordinates or map(np.arange, scene.grid))
    while field.ndim > 2:  # the middle slice of what cannot be drawn whole
        field, resting = field[field.shape[0] // 2], resting[resting.shape[0] // 2]
        labels, axes = labels[1:], axes[1:]
    rows, columns = (slice(None, None, max(1, -(-size // FINEST))) for size in field.shape)
    return names | {
        "kind": "field", "z": _rounded(field[rows, columns]), "active": resting[rows, columns].astype(int).tolist(),
        "x": _rounded(axes[1][columns]), "y": _rounded(axes[0][rows]), "x_label": labels[1], "y_label": labels[0],
    }


def _line(scene: Scene, z: Any, active: Any) -> dict[str, Any]:
    step = slice(None, None, max(1, -(-z.size // LONGEST)))
    has_axis = scene.coordinates is not None and len(scene.coordinates) == 1
    x = scene.coordinates[0] if has_axis and scene.coordinates is not None else np.arange(z.size)
    lower = scene.problem.lower
    return {
        "kind": "line" if has_axis else "dots", "z": _rounded(z[step]), "active": active[step].astype(int).tolist(),
        "x": _rounded(x[step]), "x_label": scene.axis_labels[0] if has_axis else "index",
        "lower": _rounded(lower[step]) if has_axis and np.isfinite(lower).all() else [],
    }


def _rounded(values: Any) -> Any:
    """Return five digits of each value: enough for a picture."""
    array = np.asarray(values, dtype=np.float64)
    return [float(f"{value:.5g}") for value in array] if array.ndim == 1 else [_rounded(row) for row in array]


def draw_sketch(sketch: dict[str, Any]) -> Any:
    """Return the figure of a sketch."""
    with styled():
        figure, axes = new_figure(SIZE)
        axes.grid(False)
        if sketch["kind"] == "field":
            _draw_field(figure, axes, sketch)
        else:
            _draw_line(axes, sketch)
    return figure


def _draw_field(figure: Any, axes: Any, sketch: dict[str, Any]) -> None:
    x, y = np.array(sketch["x"]), np.array(sketch["y"])
    z, active = np.array(sketch["z"]), np.array(sketch["active"], dtype=float)
    image = axes.pcolormesh(x, y, z, shading="nearest", cmap="cividis", rasterized=True)
    bar = figure.colorbar(image, ax=axes, shrink=0.85, pad=0.02, label=sketch["unknown"])
    bar.outline.set_visible(False)
    if 0.0 < active.mean() < 1.0:
        axes.contourf(x, y, active, levels=[0.5, 1.5], colors="none", hatches=["....."])
        for shade, width in (("#ffffff", 2.4), (ACTIVE, 1.3)):
            axes.contour(x, y, active, levels=[0.5], colors=shade, linewidths=width)
        axes.set_title(f"dotted: {sketch['active_means']}", color=ACTIVE, fontsize=8.5)
    is_square = 0.5 * np.ptp(x) <= np.ptp(y) <= 2.0 * np.ptp(x)
    axes.set(xlabel=sketch["x_label"], ylabel=sketch["y_label"], aspect="equal" if is_square else "auto")


def _draw_line(axes: Any, sketch: dict[str, Any]) -> None:
    x, z, active = np.array(sketch["x"]), np.array(sketch["z"]), np.array(sketch["active"], dtype=bool)
    if sketch["lower"]:
        axes.fill_between(x, sketch["lower"], min(*sketch["lower"], *z), color="#eeeeee", linewidth=0)
    if sketch["kind"] == "line":
        axes.plot(x, z, color=FREE, linewidth=1.6)
        axes.plot(x, np.where(active, z, np.nan), color=ACTIVE, linewidth=3.0, solid_capstyle="round")
    else:
        axes.plot(x[~active], z[~active], ".", color=FREE, markersize=2.5)
        axes.plot(x[active], z[active], ".", color=ACTIVE, markersize=2.5)
        if z.size and np.ptp(z) > 1e3 * np.median(np.abs(z[~active]) if (~active).any() else [1.0]):
            axes.set_yscale("symlog", linthresh=1e-3)
    if active.any():
        axes.set_title(f"orange: {sketch['active_means']}", color=ACTIVE, fontsize=8.5)
    axes.set(xlabel=sketch["x_label"], ylabel=sketch["unknown"])
