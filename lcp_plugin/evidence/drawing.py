"""Plots: style and files of all of them, curves that can be read in grey, results of `solve`, and paths.

`answer.plot()` draws the unknowns by index or on their grid, contacts in their cones, and how the residual fell.
matplotlib loads with the first figure.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.checks import Array, Vector
from ..core.entries import largest_in_rows, row_numbers
from ..core.errors import InvalidOption, LCPError, UnsuitableProblem, imported
from ..core.files import write_whole
from ..core.matrix import Matrix
from ..core.names import Names, format_count
from ..gallery.scene import Frame, Scene
from ..judges.certificate import Certificate
from ..problems.cones.frictional_contact import FrictionalContact
from ..solving.result import BaseResult, Result

if TYPE_CHECKING:
    from ..problems.parametric.path import Path as ParametricPath

Axes = Any  # of matplotlib, which loads with the first figure
UNTOUCHED = 1.5  # the level of a node that no bound is near to
FORMATS = (".png", ".pdf", ".svg")
STYLE: Any = {
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
    **dict.fromkeys(("axes.grid", "axes.axisbelow"), True),
    **dict.fromkeys(("pdf.fonttype", "ps.fonttype"), 42),
    **{"font.size": 9.5, "axes.titlesize": 10, "axes.titlelocation": "left"},
    **{"grid.color": "#e9e9e9", "svg.fonttype": "path"},
}
HEIGHTS = "cividis"
LABEL_SIZE = 7.0  # points
MARKERS = "osD^v<>phX*P"
DASHES = ("-", "--", "-.", ":")
JOURNAL = {"font.size": 8.0, "axes.titlesize": 8.5}
COLUMN_WIDTH, PAGE_WIDTH = 3.5, 7.1  # width of a journal's column, and of its page
ACTIVE, FREE_COLOR = "#D55E00", "#0072B2"
LABELS = ("layer", "row", "column")
PANEL_INCHES = (4.9, 4.4)


def require_matplotlib() -> Any:
    """Return matplotlib's Figure class; without matplotlib, raise an error with the command that installs it."""
    return imported("matplotlib.figure", "a picture needs matplotlib", "report", LCPError).Figure


def check_format(path: Path) -> None:
    """Raise InvalidOption if the file's ending names no plot format."""
    if path.suffix.lower() not in FORMATS:
        raise InvalidOption(f"a picture must end in {', '.join(FORMATS)}, got {path.name!r}")


def save_figure(figure: Any, path: Path) -> None:
    """Write the figure, whole or not at all; the format has been checked."""
    kind = path.suffix[1:].lower()
    with styled():  # matplotlib chooses the font when it writes the file
        write_whole({path: lambda file: figure.savefig(file, dpi=150, format=kind)})


def styled(more: Mapping[str, Any] | None = None) -> Any:
    """Return the context in which figures get this module's style."""
    require_matplotlib()
    from matplotlib import rc_context

    return rc_context(STYLE | dict(more or {}))


def look_of(k: int) -> dict[str, Any]:
    """Return color, dashes and marker of the k-th curve."""
    look = {"color": f"C{k % 10}", "linestyle": DASHES[k % len(DASHES)], "linewidth": 1.1}
    return look | {"marker": MARKERS[k % len(MARKERS)], "markersize": 3.5, "markerfacecolor": "w"}


LETTER = 0.055  # inches, at the size of labels


@contextmanager
def panels(titles: Sequence[str], width: float | None = None) -> Iterator[list[Any]]:
    """Yield axes with these titles, of a figure as wide as a column, or as a page; at the end, one legend below."""
    columns = min(len(titles), 3)
    rows = -(-len(titles) // columns)
    width = width or (COLUMN_WIDTH if columns == 1 else PAGE_WIDTH)
    height = rows * 0.78 * width / columns
    with styled(JOURNAL):
        figure = require_matplotlib()(figsize=(width, height), layout="constrained")
        all_axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, title in zip(all_axes, titles, strict=False):
            axes.set_title(textwrap.fill(title, int(13 * width / columns)))
        for axes in all_axes[len(titles) :]:
            axes.set_axis_off()
        yield [*all_axes[: len(titles)]]
        for axes in all_axes[: len(titles)]:  # letters along two thirds of a panel's height
            lines = textwrap.fill(axes.get_ylabel(), max(int(0.67 * height / rows / LETTER), 10))
            axes.set_ylabel(lines)
        named: dict[str, Any] = {}
        for axes in all_axes:
            handles, labels = axes.get_legend_handles_labels()
            named |= dict(zip(labels, handles, strict=True))
        # Inches of a line and its space
        count = max(1, min(len(named), int(width / (0.5 + LETTER * max(map(len, named))))))
        place = {"loc": "outside lower center", "ncols": count, "fontsize": LABEL_SIZE}
        figure.legend([*named.values()], [*named], **place)
        figure.set_size_inches(width, height + math.ceil(len(named) / count) * 0.17)


def draw_curve(axes: Axes, x: Array, y: Any, label: str, look: Any, is_solved: bool) -> None:
    """Draw a curve with some markers, which ends in a cross unless it is solved."""
    marks = np.unique(np.linspace(0, max(len(x) - 1, 0), 7).astype(int))
    label = label if is_solved else f"{label} ✕"
    axes.plot(x, y, markevery=[*marks], label=label, zorder=3, **look)
    if not is_solved:
        axes.plot(x[-1:], y[-1:], "x", color=look["color"], markersize=6, zorder=5)


def draw_tolerance(axes: Axes, tolerance: float) -> None:
    """Draw the tolerance as a line with its name."""
    axes.axhline(tolerance, color="#777777", linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
    axes.text(1.0, tolerance, " tolerance", transform=axes.get_yaxis_transform(),
              rotation=90, va="bottom", color="#777777", fontsize=LABEL_SIZE - 1)  # fmt: skip


# --- A solution -----------------------------------------------------------------------------------------------


def plot_answer(
    answer: BaseResult, *, axes: Axes = None, shape: Sequence[int] | None = None
) -> Any:
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
        Shape of the grid of the unknowns, as in ``z.reshape(shape)``; by default the grid whose neighbors M couples, if
        there is one. With more than two axes the middle slice is drawn.

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
    if answer.x is None or answer.has_no_solution:
        raise UnsuitableProblem(f"the result has no x to draw: {answer.status.name}")
    from matplotlib import pyplot

    return _plotted(answer, _frame(answer, shape), axes, pyplot.figure)


def draw(answer: BaseResult, path: Path, test_problem: Scene | None = None) -> None:
    """Save the figure of a solution, on the axes of its test problem if it has some.

    Parameters
    ----------
    answer : BaseResult
    path : Path
        .png, .pdf or .svg.
    test_problem : Scene, optional
    """
    check_format(path)
    frame = _frame(answer, None) if test_problem is None else test_problem
    save_figure(_plotted(answer, frame, None, require_matplotlib()).figure, path)


def _frame(answer: Any, shape: Any) -> Frame:
    """Return the letter of the unknowns, and the grid of that shape; raise InvalidOption if it does not fit."""
    unknown, n = "z" if isinstance(answer, Result) else "x", len(answer.x)
    shape = _grid_of(answer) if shape is None else shape
    if shape is None:
        return Frame(unknown=unknown)
    try:
        sizes = np.zeros(n).reshape(shape).shape
    except (TypeError, ValueError) as error:
        raise InvalidOption(
            f"shape must be the grid of the {n} unknowns, as (rows, columns), got {shape!r}"
        ) from error
    more = (f"axis {k}" for k in range(len(sizes) - len(LABELS)))
    return Frame(grid=sizes, axis_labels=(*more, *LABELS[-len(sizes) :]), unknown=unknown)


def _grid_of(answer: Any) -> tuple[int, ...] | None:
    """Return the shape of the grid if M couples neighbors of a grid in the plane or in space only; else None."""
    M = getattr(getattr(getattr(answer, "certificate", None), "problem", None), "matrix", None)
    if not isinstance(M, Matrix):
        return None
    rows, columns = row_numbers(M.csr), M.csr.indices
    apart = np.abs(columns - rows)
    steps = np.unique(apart)[1:].tolist()
    if len(steps) not in (2, 3) or steps[0] != 1 or steps[1] == 2:
        return None
    ends = [*steps, len(answer.x)]
    is_even = all(b % a == 0 for a, b in pairwise(ends))
    is_cut = all((rows // b == columns // b)[apart == a].all() for a, b in pairwise(ends))
    return tuple(b // a for a, b in pairwise(ends))[::-1] if is_even and is_cut else None


def _plotted(answer: BaseResult, frame: Frame, axes: Axes, new: Callable[..., Any]) -> Any:
    """Draw into `axes`, or into a new figure with a panel for the residual of a recorded run."""
    is_recorded = bool(getattr(answer, "history", ()))
    is_contact = isinstance(getattr(answer, "problem", None), FrictionalContact)
    draw_first = _draw_cones if is_contact and frame.grid is None else _draw_unknowns
    if axes is not None:
        draw_first(axes, answer, frame)
        return axes
    with styled():
        count = 1 + is_recorded
        figure = new(figsize=(count * PANEL_INCHES[0], PANEL_INCHES[1]), layout="constrained")
        all_axes = figure.subplots(1, count, squeeze=False)[0]
        draw_first(all_axes[0], answer, frame)
        if is_recorded:
            _draw_residuals(all_axes[1], answer)
        steps = format_count(answer.iterations, "iteration")
        words = f"n = {len(answer.x)}: {answer.status.name} by {answer.algorithm} in {steps}"
        figure.suptitle(f"{frame.description}\n{words}".strip(), fontsize=10, x=0.01, ha="left")
    return all_axes[0]


def _drawn_bounds(answer: object) -> tuple[Vector, Vector]:
    holder: Any = answer.certificate if isinstance(answer, Result) else answer
    problem: Any = getattr(holder, "problem", holder)
    problem = getattr(problem, "program", problem)
    return problem.lower, problem.upper


def _draw_unknowns(axes: Axes, answer: Any, frame: Frame) -> None:
    from matplotlib.ticker import MaxNLocator

    x, (lower, upper) = np.asarray(answer.x), _drawn_bounds(answer)
    active = (x <= lower) | (x >= upper)
    grid = frame.grid
    if grid is not None and len(grid) > 1 and min(grid[-2:]) > 1:
        level = 0.5 - active.astype(float)
        if isinstance(answer, Result):
            level = contact_level(answer.certificate)
        _draw_map(axes, x.reshape(grid), active.reshape(grid), level.reshape(grid), frame)
        return
    for rows, color in ((~active, FREE_COLOR), (active, ACTIVE)):
        axes.plot(np.flatnonzero(rows), x[rows], ".", color=color, markersize=4.0, rasterized=True)
    if active.any():
        axes.set_title(f"orange: {frame.active_means}", color=ACTIVE, fontsize=8.5)
    axes.set(xlabel="index", ylabel=frame.unknown)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    names = [*getattr(answer, "named", ())]
    if 0 < len(names) <= 20 and not names[0].endswith("[0]"):
        axes.set_xticks(range(len(names)), names, rotation=45, ha="right")
        axes.set_xlabel("")


def contact_level(answer: Certificate) -> Vector:
    """Return a level that is negative at a bound and 0 on the free boundary, between the nodes, shape (n,).

    A node is at its bound or not, which resolves the free boundary to one mesh width. The forces locate it within the
    cell. Let g ≥ 0 be the gap between z and its bound and w the force of the bound. Let f be the force with every node
    at the bound, and m the largest coupling of a row with a neighbor. The level

        φ_i = 1/2 − w_i / f_i  at the bound,     φ_j = 1/2 + m_j g_j / f_j  elsewhere

    is linear between nodes, −1/2 deep in the contact, and 0 on the boundary to a tenth of the mesh width. If no force
    presses, it is −1/2 in contact and 1/2 elsewhere. In the plane plot its contour 0.

    Parameters
    ----------
    answer : Certificate
        ``result.certificate``, or ``Certificate.of(problem, z)``.

    Examples
    --------
    A string that falls onto the ground, u″ = 8 from u(0) = 1: it touches from 1/2 on, wherever the nodes are.

    >>> import scipy.sparse as sp
    >>> from lcp_plugin import LCP, solve
    >>> h, x = 1 / 21, np.arange(1, 21) / 21
    >>> M = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20))
    >>> result = solve(LCP(M, 8 * h**2 - np.eye(20)[0]))
    >>> np.interp(0.0, -contact_level(result.certificate), x).round(2)
    np.float64(0.5)
    """
    problem, z, w = answer.problem, answer.z, answer.w
    M = problem.csr
    rows = np.repeat(np.arange(problem.n), np.diff(M.indptr))
    coupling = largest_in_rows(M, np.where(rows == M.indices, 0.0, np.abs(M.data)))
    level = np.full(problem.n, UNTOUCHED)
    for sign, bound in ((1.0, problem.lower), (-1.0, problem.upper)):
        known = np.isfinite(bound)
        held = np.where(known, bound, z)
        force = sign * (M @ held + problem.q)
        touches, gap = known & (z == bound), sign * (z - held)
        force = np.where(touches, np.maximum(force, sign * w), force)
        presses = force > 1e-12 * (abs(M) @ np.abs(held) + np.abs(problem.q))
        pulls = np.where(presses, force, 1.0)
        pressed = np.where(presses, np.clip(0.5 - sign * w / pulls, -0.5, 0.5), -0.5)
        free = np.where(presses, np.minimum(0.5 + coupling * gap / pulls, UNTOUCHED), 0.5)
        level = np.where(known, np.minimum(level, np.where(touches, pressed, free)), level)
    return level


def _draw_map(axes: Axes, x: Array, active: Any, level: Any, frame: Frame) -> None:
    """Draw values over a grid as colors, with the free boundary as a line."""
    nodes = [*(frame.coordinates or [np.arange(size, dtype=float) for size in x.shape])]
    while x.ndim > 2:
        middle = x.shape[0] // 2
        x, active, level = x[middle], active[middle], level[middle]
    down, across = nodes[-2:]
    image = axes.pcolormesh(across, down, x, shading="nearest", cmap=HEIGHTS, rasterized=True)
    axes.figure.colorbar(image, ax=axes, shrink=0.85, pad=0.02, label=frame.unknown)
    if 0.0 < active.mean() < 1.0:
        axes.contour(across, down, level, levels=[0.0], colors=ACTIVE, linewidths=1.3)
        axes.set_title(f"orange: border of {frame.active_means}", color=ACTIVE, fontsize=8.5)
    axes.grid(visible=False)
    y_label, x_label = frame.axis_labels[-2:]
    axes.set(xlabel=x_label, ylabel=y_label)


def _draw_cones(axes: Axes, answer: Any, frame: Frame) -> None:
    """Draw the tangential impulse of each closed contact relative to the largest that its friction allows."""
    motion, angle = answer.motion, np.linspace(0.0, 2.0 * np.pi, 200)
    limit = answer.problem.friction * motion.normal
    shares = motion.tangential / np.where(limit > 0.0, limit, 1.0)[:, None]
    if is_plane := shares.shape[1] == 1:
        shares = np.column_stack([shares, np.arange(len(shares))])
        axes.plot([[-1.0, 1.0]] * 2, [[0.0] * 2, [len(shares) - 1.0] * 2], color="#7A7A7A")
    else:
        axes.plot(np.cos(angle), np.sin(angle), color="#7A7A7A", linewidth=1.0)
        axes.set(aspect="equal", ylim=(-1.1, 1.45))  # the legend is above the circle
    slides = motion.touches & ~motion.sticks
    states = ((motion.sticks, "o", "stick", FREE_COLOR), (slides, "^", "slide", ACTIVE))
    for chosen, marker, word, color in states:
        label = f"{np.count_nonzero(chosen)} {word}"
        axes.scatter(*shares[chosen].T, s=12.0, color=color, marker=marker, label=label)
    axes.scatter([], [], label=f"{(~motion.touches).sum()} open")
    axes.legend(loc="upper center", ncols=3)
    unit = "tangential impulse ÷ $\\mu\\,r_N$"
    second = "contact" if is_plane else f"second {unit}"
    axes.set(xlabel=unit, ylabel=second, title="Impulses in their cones")


def _draw_residuals(axes: Axes, result: BaseResult) -> None:
    """Draw how the residual of a recorded run fell with time."""
    samples = [sample for sample in result.history if sample.residual is not None]
    seconds = [sample.seconds for sample in samples]
    residuals = np.array([sample.residual for sample in samples])
    # A residual of 0 is drawn at a tenth of the least number on its logarithmic axis
    edge = 0.1 * min([*residuals[residuals > 0.0], result.tolerance or 1.0])
    axes.semilogy(seconds, np.maximum(residuals, edge), ".-", markersize=4, color=FREE_COLOR)
    if result.tolerance > 0.0:
        draw_tolerance(axes, result.tolerance)
    axes.set(xlabel="seconds", ylabel="relative residual", title="residual against time")


# --- A path ---------------------------------------------------------------------------------------------------


def plot_path(path: ParametricPath, *, axes: Axes = None) -> Any:
    """Return matplotlib's axes with the 40 unknowns that change most over θ, its breakpoints as thin lines.

    Parameters
    ----------
    path : Path of :func:`lcp_plugin.trace`
    axes : Axes, optional
        Axes to draw into; by default the axes of a new figure of pyplot.

    Raises
    ------
    UnsuitableProblem
        If the path has no pieces.
    """
    require_matplotlib()
    if not path.pieces:
        raise UnsuitableProblem(f"the path has no pieces to draw: {path.explain()}")
    points = max(200 // len(path), 2)  # smooth segments are curves
    pieces = [(piece, np.linspace(piece.begin, piece.end, points)) for piece in path.pieces]
    theta = np.concatenate([parameters for _, parameters in pieces])
    x = np.array([piece.x_at(at) for piece, parameters in pieces for at in parameters])
    chosen = np.sort(np.argsort(-np.ptp(x, axis=0), kind="stable")[:40])
    if axes is None:
        import matplotlib.pyplot as plt

        with styled():
            _, axes = plt.subplots(figsize=(7.2, 4.0), layout="constrained")
    for value in path.breakpoints if len(path) <= 60 else ():  # that are drawn as lines
        axes.axvline(value, color="#dddddd", linewidth=0.7, zorder=0)
    names = getattr(path.at(float(theta[0])).problem, "names", Names())
    for j in chosen.tolist():
        axes.plot(theta, x[:, j], linewidth=1.4, label=names.unknown(j, "x[{}]"))
    if chosen.size <= 10:  # unknowns that a legend names
        axes.legend(fontsize=7.5, loc="best")
    n, count = x.shape[1], chosen.size
    axes.set(xlabel="parameter", ylabel="x" if count == n else f"x, {count} of {n}")
    return axes
