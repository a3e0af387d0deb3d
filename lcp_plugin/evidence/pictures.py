"""One picture of an answer: the solution with its contact set, and how the residual fell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, LCPError
from ..problem_files import write_whole
from ..result import Result
from .gallery import Scene

FORMATS = (".png", ".pdf", ".svg")


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


def draw(result: Result, path: Path, scene: Scene | None = None) -> None:
    """Save the picture of a result; with a scene that has a grid, z is drawn in the scene's own coordinates."""
    check_format(path)
    figure = require_matplotlib()(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1))
    grid = scene.grid if scene is not None else None
    if grid is not None and len(grid) >= 2:
        _draw_field(figure, left, result, scene)
    else:
        _draw_line(left, result, scene)
    _draw_residuals(right, result)
    title = scene.description if scene is not None else f"n = {result.z.size}"
    run = f"{result.status.name} by {result.algorithm} in {result.iterations} iterations"
    figure.suptitle(f"{title}  n = {result.z.size}\n{run}" if scene is not None else f"{title}: {run}", fontsize=11)
    write_whole({path: lambda file: figure.savefig(file, dpi=130, format=path.suffix[1:].lower())})


def _active(result: Result) -> Any:
    """Return which components rest on a bound."""
    problem = result.certificate.problem
    return (result.z <= problem.lower) | (result.z >= problem.upper)


def _draw_field(figure: Any, axes: Any, result: Result, scene: Any) -> None:
    field, active = scene.picture(result.z), scene.picture(_active(result))
    labels = scene.axis_labels
    coordinates = scene.coordinates
    while field.ndim > 2:  # the middle slice of what cannot be drawn whole
        field, active = field[field.shape[0] // 2], active[active.shape[0] // 2]
        labels, coordinates = labels[1:], coordinates[1:] if coordinates else None
    rows, columns = coordinates or tuple(np.arange(size, dtype=float) for size in field.shape)
    image = axes.pcolormesh(columns, rows, field, shading="nearest", cmap="viridis", rasterized=True)
    figure.colorbar(image, ax=axes, label="z")
    if active.any() and not active.all() and min(field.shape) > 1:
        axes.contour(columns, rows, active, levels=[0.5], colors="white", linewidths=1.2)
        axes.plot([], [], color="0.6", label="edge of the contact set (white line)")
        axes.legend(loc="upper right", fontsize=8, framealpha=0.85)
    axes.set(xlabel=labels[1], ylabel=labels[0], aspect="equal" if _is_square(rows, columns) else "auto")


def _is_square(rows: Any, columns: Any) -> bool:
    height, width = float(np.ptp(rows)), float(np.ptp(columns))
    return bool(0.2 * width <= height <= 5.0 * width)


def _draw_line(axes: Any, result: Result, scene: Scene | None) -> None:
    problem = result.certificate.problem
    has_axis = scene is not None and scene.coordinates is not None
    x = scene.coordinates[0] if scene is not None and scene.coordinates is not None else np.arange(result.z.size)
    style = {"linewidth": 1.4} if result.z.size > 60 or has_axis else {"marker": "o", "linewidth": 0.8}
    for bound, name in ((problem.lower, "lower"), (problem.upper, "upper")):
        if np.isfinite(bound).all() and bound.size:
            axes.plot(x, bound, color="0.6", linewidth=1, linestyle="--", label=name)
    axes.plot(x, result.z, color="C0", label="z", **style)
    touching = _active(result)
    if touching.any() and not touching.all():
        axes.plot(x[touching], result.z[touching], ".", color="C3", markersize=4, label="at a bound")
    label = scene.axis_labels[0] if scene is not None and scene.axis_labels else "index"
    axes.set(xlabel=label, ylabel="z")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def _draw_residuals(axes: Any, result: Result) -> None:
    samples = [sample for sample in result.history if sample.residual is not None and sample.residual > 0.0]
    if samples:
        axes.semilogy([s.seconds for s in samples], [s.residual for s in samples], ".-", markersize=4, color="C0")
    if result.tolerance > 0.0:
        axes.axhline(result.tolerance, color="C3", linewidth=1, linestyle="--", label="tolerance")
        axes.legend(fontsize=8)
    axes.locator_params(axis="x", nbins=5)
    axes.set(xlabel="seconds", ylabel=f"{result.measure} residual")
    axes.grid(alpha=0.3, which="both")
