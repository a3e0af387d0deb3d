"""Plots: style and files of all of them, curves that can be read in grey, results of `solve`, and paths.

`answer.plot()` draws the unknowns by index or on their grid, contacts in their cones, and how the residual fell. Colors
of families are Okabe and Ito's colors. matplotlib loads with the first figure.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..core.checks import Vector
from ..core.errors import InvalidOption, LCPError, UnsuitableProblem
from ..core.representation import format_count
from ..core.solving.result import BaseResult, Result
from ..gallery.scene import Scene
from ..interfaces.files import write_whole
from ..problems.cones.frictional_contact import FrictionalContact
from .free_boundary import contact_level

if TYPE_CHECKING:
    from ..problems.parametric.path import Path as ParametricPath

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
    "polish": "#777777",
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
ACTIVE, FREE = "#D55E00", "#0072B2"
LABELS = ("layer", "row", "column")
PANEL_INCHES = (4.9, 4.4)


def require_matplotlib() -> Any:
    """Return matplotlib's Figure class; without matplotlib, raise an error with the command that installs it."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise LCPError(
            "a picture needs matplotlib; install it with: pip install matplotlib (or lcp_plugin[report])"
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


def look_of(family: str, k: int) -> dict[str, Any]:
    """Return color, dashes and marker of the k-th curve."""
    return {
        "color": COLORS[family],
        "linestyle": DASHES[k % len(DASHES)],
        "marker": MARKERS[k % len(MARKERS)],
        "linewidth": 1.1,
        "markersize": 3.5,
        "markerfacecolor": "white",
        "markeredgewidth": 0.9,
    }


@contextmanager
def panels(titles: Sequence[str], width: float | None = None) -> Iterator[list[Any]]:
    """Yield axes with these titles, of a figure as wide as a column, or as a page; at the end, one legend below."""
    columns = min(len(titles), 3)
    rows = -(-len(titles) // columns)
    width = width or (COLUMN_WIDTH if columns == 1 else PAGE_WIDTH)
    height = rows * 0.78 * width / columns
    with styled(JOURNAL):
        figure = require_matplotlib()(figsize=(width, height), layout="constrained")
        every = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, title in zip(every, titles, strict=False):
            axes.set_title(textwrap.fill(title, int(13 * width / columns)))
        for axes in every[len(titles) :]:
            axes.set_axis_off()
        yield [*every[: len(titles)]]
        named: dict[str, Any] = {}
        for k, axes in enumerate(every):
            handles, labels = axes.get_legend_handles_labels()
            named |= dict(zip(labels, handles, strict=True))
            if k % columns and axes.get_ylabel() == every[k - 1].get_ylabel():
                axes.yaxis.label.set_visible(False)
        longest = max(map(len, named))
        # Inches of a line and its space, and of a letter
        count = max(1, min(len(named), int(width / (0.5 + 0.055 * longest))))
        look = {"fontsize": LABEL_SIZE, "handlelength": 2.4, "columnspacing": 1.0}
        figure.legend([*named.values()], [*named], loc="outside lower center", ncols=count, **look)
        figure.set_size_inches(width, height + math.ceil(len(named) / count) * 0.17)


def draw_curve(axes: Any, x: Any, y: Any, label: str, look: Mapping[str, Any], **more: Any) -> None:
    """Draw a curve with some markers; ``is_solved=False`` ends it in a cross."""
    is_solved = more.pop("is_solved", True)
    marks = np.unique(np.linspace(0, max(len(x) - 1, 0), 7).astype(int))
    label = label if is_solved else f"{label} ✕"
    axes.plot(x, y, markevery=[*marks], label=label, zorder=3, **look, **more)
    if not is_solved:
        axes.plot(x[-1:], y[-1:], "x", color=look["color"], markersize=6, zorder=5)


def draw_tolerance(axes: Any, tolerance: float) -> None:
    """Draw the tolerance as a line with its name."""
    axes.axhline(tolerance, color="#777777", linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
    axes.text(1.0, tolerance, " tolerance", transform=axes.get_yaxis_transform(),
              rotation=90, va="bottom", color="#777777", fontsize=LABEL_SIZE - 1)  # fmt: skip


# --- A solution -----------------------------------------------------------------------------------------------


class Frame(NamedTuple):
    """Shape, node positions and labels of the unknowns, and their descriptions."""

    grid: tuple[int, ...] | None = None
    coordinates: Sequence[Any] | None = None
    labels: tuple[str, ...] = ()
    unknown: str = "x"
    active_means: str = "at a bound"
    title: str = ""


def plot_answer(answer: Any, *, axes: Any = None, shape: Sequence[int] | None = None) -> Any:
    """Return matplotlib's axes with a figure of a solution.

    The unknowns by index, or as a map on a grid with the free boundary; contact with friction as tangential impulses in
    their cones, ÷ μ r_N. A recorded run has a second panel with its residual.

    Parameters
    ----------
    answer : BaseResult
        Result of `solve`.
    axes : Axes, optional
        To draw the first panel into; by default the axes of a new figure of pyplot.
    shape : sequence of int, optional
        Shape of the grid of the unknowns, as in ``z.reshape(shape)``. With more than two axes the middle slice is
        drawn.

    Raises
    ------
    LCPError
        If matplotlib is missing.
    InvalidOption
        If the shape does not hold as many unknowns.
    UnsuitableProblem
        If the result has no x.

    Examples
    --------
    ``answer.plot(shape=(50, 100)).figure.savefig("z.png")``; a mesh: ``ax.tripcolor(*points.T, triangles, answer.x)``.
    """
    require_matplotlib()
    if not isinstance(answer, BaseResult):
        raise InvalidOption(f"plot_answer needs an answer of solve, got {type(answer).__name__}")
    if answer.x is None:
        raise UnsuitableProblem(f"the result has no x to draw: {answer.status.name}")
    frame = Frame(unknown="z" if isinstance(answer, Result) else "x")
    if shape is not None:
        frame = frame._replace(**_grid(shape, len(answer.x)))
    from matplotlib import pyplot

    return _plotted(answer, frame, axes, pyplot.figure)


def draw(answer: Any, path: Path, test_problem: Scene | None = None) -> None:
    """Save the figure of a solution, on the axes of its test problem if it has some.

    Parameters
    ----------
    answer : BaseResult
    path : Path
        .png, .pdf or .svg.
    test_problem : Scene, optional
    """
    check_format(path)
    frame = Frame(unknown="z" if isinstance(answer, Result) else "x")
    if test_problem is not None:
        one = test_problem
        frame = Frame(one.grid, one.coordinates, one.axis_labels, one.unknown, one.active_means)
        frame = frame._replace(title=one.description + "\n")
    save(_plotted(answer, frame, None, require_matplotlib()).figure, path)


def checked_shape(shape: Any, n: int) -> tuple[int, ...]:
    """Return the shape of a grid of n unknowns, or raise InvalidOption."""
    sizes = tuple(shape) if isinstance(shape, Iterable) else ()
    if not sizes or not all(isinstance(one, int | np.integer) and one > 0 for one in sizes):
        raise InvalidOption(f"shape must hold integers > 0, as (rows, columns), got {shape!r}")
    if (count := math.prod(map(int, sizes))) != n:
        raise InvalidOption(
            f"shape {sizes} has {count} unknowns, and the problem has {n}; pass the shape of its grid"
        )
    return sizes


def _grid(shape: Any, n: int) -> dict[str, Any]:
    sizes = checked_shape(shape, n)
    more = [f"axis {k}" for k in range(len(sizes) - len(LABELS))]
    return {"grid": sizes, "labels": (*more, *LABELS[-len(sizes) :])}


def _plotted(answer: Any, frame: Frame, axes: Any, new: Callable[..., Any]) -> Any:
    """Draw into the given axes, or into a new figure with a panel for the residual of a recorded run."""
    run = answer if getattr(answer, "history", ()) else None
    is_contact = isinstance(getattr(answer, "problem", None), FrictionalContact)
    draw_first = _draw_cones if is_contact and frame.grid is None else _draw_unknowns
    if axes is not None:
        draw_first(axes, answer, frame)
        return axes
    with styled():
        count = 1 if run is None else 2
        figure = new(figsize=(count * PANEL_INCHES[0], PANEL_INCHES[1]), layout="constrained")
        every = figure.subplots(1, count, squeeze=False)[0]
        draw_first(every[0], answer, frame)
        if run is not None:
            _draw_residuals(every[1], run)
        steps = format_count(answer.iterations, "iteration")
        said = f"n = {len(answer.x)}: {answer.status.name} by {answer.algorithm} in {steps}"
        figure.suptitle(frame.title + said, fontsize=10, x=0.01, ha="left")
    return every[0]


def _bounds(answer: Any) -> tuple[Vector, Vector]:
    problem: Any = getattr(answer, "problem", None)
    if problem is None:
        problem = answer.certificate.problem if isinstance(answer, Result) else answer
    problem = getattr(problem, "program", problem)
    return problem.lower, problem.upper


def _draw_unknowns(axes: Any, answer: Any, frame: Frame) -> None:
    x, (lower, upper) = np.asarray(answer.x), _bounds(answer)
    active = (x <= lower) | (x >= upper)
    grid = frame.grid
    if grid is not None and len(grid) > 1 and min(grid[-2:]) > 1:
        level = 0.5 - active.astype(float)
        if isinstance(answer, Result):
            level = contact_level(answer.certificate.problem, answer.z, answer.w)
        _draw_map(axes, x.reshape(grid), active.reshape(grid), level.reshape(grid), frame)
        return
    nodes = frame.coordinates[0] if frame.coordinates and len(frame.coordinates) == 1 else None
    where = np.arange(x.size) if nodes is None else nodes
    if nodes is not None:
        for bound, end in ((lower, min), (upper, max)):
            if np.isfinite(bound).all():
                axes.fill_between(where, bound, end(*bound, *x), color="#eeeeee", linewidth=0)
        axes.plot(where, x, color=FREE, linewidth=1.6)
        axes.plot(where, np.where(active, x, np.nan), color=ACTIVE, linewidth=3.0)
    else:
        axes.locator_params(axis="x", integer=True)
        size = 6.0 if x.size <= 60 else 2.5
        for chosen, color in ((~active, FREE), (active, ACTIVE)):
            axes.plot(where[chosen], x[chosen], ".", color=color, markersize=size, rasterized=True)
    if active.any():
        axes.set_title(f"orange: {frame.active_means}", color=ACTIVE, fontsize=8.5)
    label = "index" if nodes is None else frame.labels[0]
    axes.set(xlabel=label, ylabel=frame.unknown)


def _draw_map(axes: Any, x: Any, active: Any, level: Any, frame: Frame) -> None:
    """Draw values over a grid as colors, with the free boundary as a line and the active set dotted."""
    nodes = [*(frame.coordinates or [np.arange(size, dtype=float) for size in x.shape])]
    while x.ndim > 2:
        middle = x.shape[0] // 2
        x, active, level = x[middle], active[middle], level[middle]
    down, across = nodes[-2:]
    image = axes.pcolormesh(across, down, x, shading="nearest", cmap=HEIGHTS, rasterized=True)
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.85, pad=0.02, label=frame.unknown)
    bar.outline.set_visible(False)
    if 0.0 < active.mean() < 1.0:
        ends = [min(level.min(), -1.0), 0.0]
        axes.contourf(across, down, level, levels=ends, colors="none", hatches=["....."])
        for shade, width in (("#ffffff", 2.4), (ACTIVE, 1.3)):
            axes.contour(across, down, level, levels=[0.0], colors=shade, linewidths=width)
        axes.set_title(f"dotted: {frame.active_means}", color=ACTIVE, fontsize=8.5)
    axes.grid(visible=False)
    is_square = 0.5 * np.ptp(across) <= np.ptp(down) <= 2.0 * np.ptp(across)
    y_label, x_label = frame.labels[-2:]
    axes.set(xlabel=x_label, ylabel=y_label, aspect="equal" if is_square else "auto")


def _draw_cones(axes: Any, answer: Any, frame: Frame) -> None:
    """Draw the tangential impulse of each closed contact relative to the largest that its friction allows."""
    motion = answer.motion
    limit = answer.problem.friction * motion.normal
    shares = motion.tangential / np.where(limit > 0.0, limit, 1.0)[:, None]
    slides, count = motion.touches & ~motion.sticks, len(shares)
    is_plane = shares.shape[1] == 1
    across = np.arange(count) if is_plane else shares[:, 1]
    if is_plane:
        for end in (-1.0, 1.0):
            axes.axvline(end, color="#7A7A7A", linewidth=1.0)
        axes.set(xlim=(-1.25, 1.25), ylim=(-0.5, max(1.2 * count, 1.0)), ylabel="contact")
        axes.yaxis.get_major_locator().set_params(integer=True)
    else:
        angle = np.linspace(0.0, 2.0 * np.pi, 200)
        axes.plot(np.cos(angle), np.sin(angle), color="#7A7A7A", linewidth=1.0)
        axes.set(aspect="equal", xlim=(-1.25, 1.25), ylim=(-1.15, 1.45))
        axes.set_ylabel("second tangential impulse ÷ $\\mu\\,r_N$")
    look = {"s": float(np.clip(3000.0 / max(count, 1), 6.0, 24.0))}
    for chosen, color, marker, word in (
        (motion.sticks, FREE, "o", "stick"),
        (slides, ACTIVE, "^", "slide"),
    ):
        label = f"{np.count_nonzero(chosen)} {word}"
        axes.scatter(
            shares[chosen, 0], across[chosen], color=color, marker=marker, label=label, **look
        )
    axes.scatter(
        [],
        [],
        facecolors="none",
        edgecolors="#7A7A7A",
        label=f"{(~motion.touches).sum()} open",
        **look,
    )
    axes.legend(loc="upper center", ncols=3, columnspacing=1.0, handletextpad=0.2)
    first = "tangential" if is_plane else "first tangential"
    axes.set(xlabel=f"{first} impulse ÷ $\\mu\\,r_N$", title="Impulses in their cones")


def _draw_residuals(axes: Any, result: Any) -> None:
    """Draw how the residual of a recorded run fell with time."""
    samples = np.array(
        [(one.seconds, one.residual) for one in result.history if one.residual is not None]
    ).reshape(-1, 2)
    seconds, residuals = samples.T
    positive = [*residuals[residuals > 0.0], result.tolerance or 1.0]
    # A residual of 0 is drawn at a tenth of the least number on its logarithmic axis
    edge = 0.1 * min(positive)
    axes.semilogy(seconds, np.maximum(residuals, edge), ".-", markersize=4, color=FREE)
    if (residuals == 0.0).any():
        last = seconds[residuals == 0.0][0]
        axes.plot([last], [edge], "v", color=FREE, markersize=6)
        axes.text(last, edge, "exactly 0 ", ha="right", va="center", color=FREE, fontsize=8)
    if result.tolerance > 0.0:
        draw_tolerance(axes, result.tolerance)
    axes.locator_params(axis="x", nbins=5)
    axes.set(xlabel="seconds", ylabel="relative residual", title="residual against time")


# --- A path ---------------------------------------------------------------------------------------------------


def plot_path(path: ParametricPath, *, axes: Any = None, rows: Sequence[int] | None = None) -> Any:
    """Return matplotlib's axes with x over θ, its breakpoints as thin lines.

    Parameters
    ----------
    path : Path of :func:`lcp_plugin.trace`
    axes : Axes, optional
        Axes to draw into; by default the axes of a new figure of pyplot.
    rows : sequence of int, optional
        Numbers of the unknowns to draw; by default of those that change most.

    Raises
    ------
    UnsuitableProblem
        If the path has no pieces.
    InvalidOption
        If rows are not numbers of unknowns.
    """
    require_matplotlib()
    if not path.pieces:
        raise UnsuitableProblem(f"the path has no pieces to draw: {path.explain()}")
    theta = np.array([value for piece in path.pieces for value in (piece.begin, piece.end)])
    every = np.array(
        [piece.x_at(value) for piece in path.pieces for value in (piece.begin, piece.end)]
    )
    n = every.shape[1]
    if rows is None:
        order = np.argsort(-np.ptp(every, axis=0), kind="stable")
        rows = sorted(order[:40].tolist())  # unknowns drawn
    chosen = np.asarray(rows)
    is_whole = chosen.ndim == 1 and np.issubdtype(chosen.dtype, np.integer)
    if not is_whole or not ((chosen >= 0) & (chosen < n)).all():
        raise InvalidOption(f"rows must be integers from 0 to {n - 1}, got {rows!r}")
    if axes is None:
        import matplotlib.pyplot as plt

        with styled():
            _, axes = plt.subplots(figsize=(7.2, 4.0), layout="constrained")
    for value in path.breakpoints if len(path) <= 60 else ():  # that are drawn as lines
        axes.axvline(value, color="#dddddd", linewidth=0.7, zorder=0)
    for j in chosen:
        axes.plot(theta, every[:, j], linewidth=1.4, label=f"x[{j}]")
    if chosen.size <= 10:  # unknowns that a legend names
        axes.legend(fontsize=7.5, loc="best")
    axes.set(xlabel="parameter", ylabel="x" if chosen.size == n else f"x, {chosen.size} of {n}")
    return axes
