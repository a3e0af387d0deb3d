"""Pictures of an answer: what the scene is about, with its free boundary."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.certificates.residuals import Certificate
from ..core.certificates.row_residuals import is_at_bound
from ..core.representation import in_words
from ..core.solving.result import Result
from ..gallery.scene import Scene
from .drawing import HEIGHTS, check_format, heights_as_colours, require_matplotlib, save, styled
from .free_boundary import contact_level, free_boundary

FINEST_SURFACE = 70  # nodes along an axis
FEW = 60  # values, which are drawn larger
MOST_DOTS, BINS = 2000, 60  # values that are drawn one by one; of more a histogram of so many bins
ACTIVE, FREE = "#D55E00", "#0072B2"
ZERO_BELOW = 0.1  # of the least number on a logarithmic axis: where 0 is drawn


def draw(result: Result, path: Path, scene: Scene, march: Sequence[Result] = ()) -> None:
    """Save the picture of a result on the axes of its test problem.

    Parameters
    ----------
    result : Result
    path : Path
        .png, .pdf or .svg.
    scene : Scene
        A field is drawn as a surface and as a map with the edge of its contact set.
    march : sequence of Result, optional
        All steps of a march over one axis: the edge of the contact set is drawn over the steps.
    """
    check_format(path)
    with styled():
        is_field = scene.grid is not None and len(scene.grid) >= 2
        has_edge = len(march) > 1 and scene.coordinates is not None
        panels = 3 if is_field or has_edge else 2
        figure = require_matplotlib()(figsize=(4.9 * panels, 4.7), layout="constrained")
        if is_field:
            surface = figure.add_subplot(1, 3, 1, projection="3d")
            field = _field(scene, result.certificate)
            draw_map(figure.add_subplot(1, 3, 2), field)
            _draw_surface(surface, field)
        else:
            draw_line(figure.add_subplot(1, panels, 1), _line(scene, result.certificate))
            if has_edge:
                _draw_edge(figure.add_subplot(1, panels, 2), march, scene)
        draw_residuals(figure.add_subplot(1, panels, panels), result)
        steps = in_words(result.iterations, "iteration")
        run = f"n = {result.z.size}: {result.status.name} by {result.algorithm} in {steps}"
        figure.suptitle(f"{scene.description}\n{run}", fontsize=11, x=0.01, ha="left")
        save(figure, path)


# --- Fields ---------------------------------------------------------------------------------------------------


def _field(scene: Any, answer: Certificate) -> dict[str, Any]:
    """Return z over the grid as a map shows it: values, contact set, coordinates and names."""
    z, active = scene.picture(answer.z), scene.picture(is_at_bound(answer.problem, answer.z))
    names = {"unknown": scene.unknown, "active_means": scene.active_means}
    level = scene.picture(contact_level(answer.problem, answer.z, answer.w))
    return field_of(z, active, scene.axis_labels, scene.coordinates, level) | names


def field_of(
    z: Any,
    active: Any,
    labels: Sequence[str],
    coordinates: Sequence[Any] | None = None,
    level: Any = None,
) -> dict[str, Any]:
    """Return values over a grid of two or more axes, and which of them rest on a bound, as a map shows them.

    The level is that of `contact_level`; without it the edge of the set runs midway between nodes.
    """
    level = 0.5 - active.astype(float) if level is None else level
    axes = coordinates or tuple(np.arange(size, dtype=float) for size in z.shape)
    while z.ndim > 2:  # the middle slice of what cannot be drawn whole
        middle = z.shape[0] // 2
        z, active, level, labels, axes = (
            z[middle],
            active[middle],
            level[middle],
            labels[1:],
            axes[1:],
        )
    return {
        "z": z,
        "active": active,
        "x": axes[1],
        "y": axes[0],
        "x_label": labels[1],
        "y_label": labels[0],
        "unknown": "z",
        "active_means": "at a bound",
        "level": level,
    }


def draw_map(axes: Any, field: dict[str, Any]) -> None:
    """Draw the field from above, its contact set dotted."""
    x, y, z, active, level = (field[name] for name in ("x", "y", "z", "active", "level"))
    image = axes.pcolormesh(x, y, z, shading="nearest", cmap=HEIGHTS, rasterized=True)
    axes.figure.colorbar(
        image, ax=axes, shrink=0.85, pad=0.02, label=field["unknown"]
    ).outline.set_visible(False)
    if 0.0 < active.mean() < 1.0 and min(z.shape) > 1:
        axes.contourf(
            x, y, level, levels=[min(level.min(), -1.0), 0.0], colors="none", hatches=["....."]
        )
        for shade, width in (("#ffffff", 2.4), (ACTIVE, 1.3)):
            axes.contour(x, y, level, levels=[0.0], colors=shade, linewidths=width)
        axes.set_title(f"dotted: {field['active_means']}", color=ACTIVE, fontsize=8.5)
    axes.grid(False)
    is_square = 0.5 * np.ptp(x) <= np.ptp(y) <= 2.0 * np.ptp(x)
    axes.set(
        xlabel=field["x_label"], ylabel=field["y_label"], aspect="equal" if is_square else "auto"
    )


def _draw_surface(surface: Any, whole: dict[str, Any]) -> None:
    """Draw z as a surface, its contact set in the colour of the free boundary."""
    surface.set(
        xlabel=whole["x_label"], ylabel=whole["y_label"]
    )  # the height is named beside the colours
    if min(whole["z"].shape) < 2:
        surface.set_axis_off()
        return
    rows, columns = (
        slice(None, None, max(1, -(-size // FINEST_SURFACE))) for size in whole["z"].shape
    )
    z = whole["z"][rows, columns]
    colours = heights_as_colours(z)
    colours[whole["active"][rows, columns].astype(bool)] = (0.835, 0.369, 0.0, 1.0)
    x, y = np.meshgrid(whole["x"][columns], whole["y"][rows])
    surface.plot_surface(
        x, y, z, facecolors=colours, rcount=80, ccount=80, linewidth=0, antialiased=False
    )
    surface.view_init(elev=36, azim=-60)


# --- Lines ----------------------------------------------------------------------------------------------------


def _line(scene: Scene, answer: Certificate) -> dict[str, Any]:
    """Return z over its only axis, or by its index: bounds, contact set and names."""
    problem = answer.problem
    axes = scene.coordinates or ()
    has_axis = len(axes) == 1
    bounds = {"lower": problem.lower, "upper": problem.upper} if has_axis else {}
    return {
        "kind": "line" if has_axis else "dots",
        "z": answer.z,
        "active": is_at_bound(problem, answer.z),
        "x": axes[0] if has_axis else np.arange(answer.z.size),
        "x_label": scene.axis_labels[0] if has_axis else "index",
        "unknown": scene.unknown,
        "active_means": scene.active_means,
    } | {name: bound for name, bound in bounds.items() if np.isfinite(bound).all()}


def draw_line(axes: Any, line: dict[str, Any]) -> None:
    """Draw z, what rests on a bound in orange; grey is where z must not go."""
    if line["kind"] == "dots" and line["z"].size > MOST_DOTS:
        _draw_histogram(axes, line)
        return
    x, z, active = line["x"], line["z"], line["active"].astype(bool)
    for name, end in (("lower", min), ("upper", max)):
        if name in line:
            axes.fill_between(x, line[name], end(*line[name], *z), color="#eeeeee", linewidth=0)
    if line["kind"] == "line":
        axes.plot(x, z, color=FREE, linewidth=1.6)
        axes.plot(
            x, np.where(active, z, np.nan), color=ACTIVE, linewidth=3.0, solid_capstyle="round"
        )
    else:
        size = 2.5 if z.size > FEW else 6.0
        axes.plot(x[~active], z[~active], ".", color=FREE, markersize=size)
        axes.plot(x[active], z[active], ".", color=ACTIVE, markersize=size)
        if z.size and np.ptp(z) > 1e3 * np.median(np.abs(z[~active]) if (~active).any() else [1.0]):
            axes.set_yscale("symlog", linthresh=1e-3)
    if active.any():
        axes.set_title(f"orange: {line['active_means']}", color=ACTIVE, fontsize=8.5)
    axes.set(xlabel=line["x_label"], ylabel=line["unknown"])


def _draw_histogram(axes: Any, line: dict[str, Any]) -> None:
    """Draw how often each value occurs, of those at a bound in orange; their places are not known here."""
    z, active = line["z"], line["active"].astype(bool)
    axes.hist([z[~active], z[active]], bins=BINS, stacked=True, color=[FREE, ACTIVE])
    share = f"; orange: {line['active_means']}, {np.mean(active):.0%}" if active.any() else ""
    axes.set_title(
        f"{z.size} values{share}\nin their places: plot(shape=…) or plot(mesh=…)", fontsize=8.5
    )
    axes.set(xlabel=line["unknown"], ylabel="how many")


def _draw_edge(axes: Any, march: Sequence[Result], scene: Any) -> None:
    """Draw where the contact set that begins at the lower end of the axis ends, step by step."""
    x, edges = scene.coordinates[0], []
    for result in march:
        found = free_boundary(result, coordinates=x).positions
        is_at = is_at_bound(result.certificate.problem, result.z)
        edges.append(found[0] if found.size and is_at[0] else np.nan)
    steps = np.arange(1, len(march) + 1)
    axes.plot(steps, edges, color=ACTIVE, linewidth=1.8)
    bottom = np.nanmin(edges) if np.isfinite(edges).any() else 0.0
    axes.fill_between(steps, edges, bottom, color=ACTIVE, alpha=0.12, linewidth=0)
    axes.set_title(f"below the line: {scene.active_means}", color=ACTIVE, fontsize=9)
    axes.set(xlabel="step of the march", ylabel=scene.axis_labels[0])


def draw_residuals(axes: Any, result: Result) -> None:
    """Draw how the residual of a recorded run fell with time."""
    samples = [
        (sample.seconds, sample.residual)
        for sample in result.history
        if sample.residual is not None
    ]
    least = min([*(value for _, value in samples if value > 0.0), result.tolerance or 1.0])
    if samples:
        seconds, residuals = zip(*samples, strict=True)
        edge = ZERO_BELOW * least
        axes.semilogy(seconds, np.maximum(residuals, edge), ".-", markersize=4, color=FREE)
        if zeros := [second for second, value in samples if value == 0.0]:
            axes.plot(zeros, [edge] * len(zeros), "v", color=FREE, markersize=6)
            axes.annotate(
                "exactly 0",
                (zeros[0], edge),
                (-6, 0),
                textcoords="offset points",
                ha="right",
                va="center",
                color=FREE,
                fontsize=8,
            )
    if result.tolerance > 0.0:
        axes.axhline(result.tolerance, color=ACTIVE, linewidth=1, linestyle="--")
        axes.annotate(
            "tolerance",
            (1.0, result.tolerance),
            (3, 0),
            xycoords=("axes fraction", "data"),
            rotation=90,
            textcoords="offset points",
            va="bottom",
            color=ACTIVE,
            fontsize=7,
        )
    axes.locator_params(axis="x", nbins=5)
    axes.set(xlabel="seconds", ylabel="relative residual", title="how the residual fell")
