"""`answer.plot()`: a picture of any answer, into matplotlib axes of the caller or of a new figure."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..core.checks import FloatVector
from ..core.errors import InvalidOption, UnsuitableProblem
from ..core.representation import in_words
from ..core.settings import Status
from ..core.solving.answer import Answer
from ..core.solving.result import Result
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.equilibria.result import EquilibriumResult
from ..problems.many.answers import AnswerSequence
from ..problems.march import March
from .drawing import COLOURS, HEIGHTS, require_matplotlib, save, styled
from .free_boundary import contact_level, free_boundary
from .pictures import ACTIVE, FREE, MOST_DOTS, draw_line, draw_map, draw_residuals, field_of

LABELS = ("layer", "row", "column")
PANEL = (4.9, 4.4)
SLICES, PANELS = 6, 4  # of a march: as lines, as maps


def plot_answer(
    answer: Any,
    *,
    axes: Any = None,
    shape: Sequence[int] | None = None,
    rows: Any = None,
    over: Any = None,
    mesh: Any = None,
    component: int | str = "norm",
) -> Any:
    """Return matplotlib's axes with a picture of an answer.

    - z or x by its index, or as a map over a grid or a mesh, what rests on a bound in orange or dotted. Of more than
      2000 values without either a histogram. A run that was recorded has a second panel, how its residual fell, and a
      search for the best equilibrium one, how the proved bound rose.
    - Contact with friction: the tangential impulses in their cones, ÷ μ r_N, with open contacts counted beside them.
    - A march: some of its steps. A batch: how many problems took how many iterations, a colour a status.

    Parameters
    ----------
    answer : Answer or AnswerSequence
        What `solve`, `solve_batch`, `march` and the like return.
    axes : Axes, optional
        To draw the first panel into; by default those of a new figure of pyplot.
    shape : sequence of int, optional
        Of the grid of the unknowns, (rows, columns); their order is that of ``z.reshape(shape)``. Of more than two axes
        the middle slice is drawn.
    rows : sequence of int, or of bool, optional
        The rows to draw, as those that may touch; by default all. z and w of an LCP have a panel each then.
    over : array, shape (n,) or (n, 2), optional
        Coordinates of all rows, or of those to draw alone: (n,) gives curves, (n, 2) points in the plane, coloured.
        What rests on a bound is marked in orange.
    mesh : (points, cells), optional
        Of unknowns at the points of a mesh: points (p, 2), cells (k, 3) of triangles or (k, 4) of quadrilaterals, the
        numbers of their corners in turn. Several unknowns a point stand together: ``z.reshape(p, -1)``.
    component : int or "norm", optional
        Which unknown of each point of the mesh, or the Euclidean norm of all.

    Raises
    ------
    LCPError
        Where matplotlib is missing.
    InvalidOption
        Where the shape or the mesh does not hold as many unknowns, or goes with a batch.
    UnsuitableProblem
        Where there is no x to draw.
    """
    if not isinstance(answer, (Answer, AnswerSequence)):
        raise InvalidOption(f"plot_answer needs what solve returns, got {type(answer).__name__}")
    require_matplotlib()
    if rows is not None or over is not None:
        return _plot_rows(answer, axes, shape, rows, over)
    if mesh is not None:
        return _plot_mesh(answer, axes, mesh, component)
    return _plotted(answer, axes, shape, _shown_by_pyplot)


def _plot_rows(answer: Any, axes: Any, shape: Sequence[int] | None, rows: Any, over: Any) -> Any:
    """Draw z and w of some rows over their coordinates."""
    if shape is not None:
        raise InvalidOption(
            "shape is that of all unknowns on a grid; give it without rows and over"
        )
    if not isinstance(answer, Result) or answer.z is None:
        raise InvalidOption(
            f"rows and over are for the z and w of a Result, got "
            f"{type(answer).__name__}; leave them out"
        )
    n = answer.z.size
    chosen, points = _checked_rows(rows, over, n)
    values = {"z": answer.z[chosen], "w": answer.w[chosen]}
    lower, upper = _bounds(answer)
    active = ((answer.z <= lower) | (answer.z >= upper))[chosen]
    with _panels(axes, _shown_by_pyplot, len(values), _headline(answer)) as every:
        for one, (name, numbers) in zip(every, values.items(), strict=False):
            one.set_title(name)
            if points.ndim == 1:
                order = np.argsort(points, kind="stable")
                one.plot(points[order], numbers[order], marker=".", color=FREE)
                if active.any():
                    one.plot(points[active], numbers[active], ".", color=ACTIVE)
                one.set(xlabel="row" if over is None else "coordinate", ylabel=name)
            else:
                drawn = one.scatter(points[:, 0], points[:, 1], c=numbers, s=12)
                if active.any():
                    one.scatter(
                        *points[active].T,
                        s=26,
                        facecolors="none",
                        edgecolors=ACTIVE,
                        linewidths=0.9,
                    )
                one.set(aspect="equal", xlabel="first coordinate", ylabel="second coordinate")
                one.figure.colorbar(drawn, ax=one, label=name)
    return every[0]


def _plot_mesh(answer: Any, axes: Any, mesh: Any, component: int | str) -> Any:
    """Draw the unknowns of a mesh as colours, with the free boundary, or what rests on a bound, in orange."""
    if not isinstance(answer, Answer) or answer.x is None:
        raise InvalidOption(
            f"mesh goes with one answer that has an x, got {type(answer).__name__}; of a batch or a "
            "march: answers[k].plot(mesh=…)"
        )
    points, triangles, count = _checked_mesh(mesh, len(answer.x))
    values = np.asarray(answer.x).reshape(-1, count)
    if component != "norm" and component not in range(count):
        raise InvalidOption(
            f"component must be 'norm' or a whole number from 0 to {count - 1}, got {component!r}"
        )
    alone = int(component) if component != "norm" else 0 if count == 1 else None
    shown = values[:, alone] if alone is not None else np.linalg.norm(values, axis=1)
    lower, upper = _bounds(answer)
    active = ((answer.x <= lower) | (answer.x >= upper)).reshape(-1, count).any(axis=1)
    beside = _panel_beside(answer)
    with _panels(axes, _shown_by_pyplot, 1 if beside is None else 2, _headline(answer)) as every:
        one, name = every[0], _unknown(answer)
        drawn = one.tripcolor(
            *points.T, triangles, shown, shading="gouraud", cmap=HEIGHTS, rasterized=True
        )
        label = (
            name
            if count == 1
            else f"‖{name}‖ of a point"
            if alone is None
            else f"{name}, component {alone}"
        )
        one.figure.colorbar(drawn, ax=one, shrink=0.85, pad=0.02, label=label).outline.set_visible(
            False
        )
        if count == 1 and isinstance(answer, Result):
            free_boundary(answer, mesh=(points, triangles)).draw(one, color=ACTIVE, linewidth=1.5)
        if active.any():
            one.plot(*points[active].T, ".", color=ACTIVE, markersize=2.5)
            one.set_title("orange: at a bound", color=ACTIVE, fontsize=8.5)
        one.set(aspect="equal", xlabel="x", ylabel="y")
        one.grid(visible=False)
        if beside is not None and axes is None:
            beside(every[1])
    return one


def _checked_mesh(mesh: Any, n: int) -> tuple[FloatVector, Any, int]:
    """Return points, triangles and the number of unknowns a point, or raise InvalidOption."""
    need = f"mesh must be (points, cells) of shapes (p, 2) and (k, 3) or (k, 4), p a divisor of the {n} unknowns"
    try:
        points, cells = np.asarray(mesh[0], dtype=float), np.asarray(mesh[1])
    except (TypeError, ValueError, IndexError, KeyError):
        raise InvalidOption(f"{need}, got {type(mesh).__name__}") from None
    fits = (
        points.ndim == 2 and cells.ndim == 2 and points.shape[1] == 2 and cells.shape[1] in (3, 4)
    )
    if not fits or not len(points) or n % len(points) or not np.issubdtype(cells.dtype, np.integer):
        raise InvalidOption(
            f"{need}, got {points.shape} and {cells.dtype} numbers {cells.shape}; transpose what is "
            "stored by columns"
        )
    if cells.size and (cells.min() < 0 or cells.max() >= len(points)):
        raise InvalidOption(
            f"cells must hold numbers of points, from 0 to {len(points) - 1}, got {cells.max()}"
        )
    if cells.shape[1] == 4:
        cells = np.concatenate([cells[:, :3], cells[:, [0, 2, 3]]])
    return points, cells, n // len(points)


def _checked_rows(rows: Any, over: Any, n: int) -> tuple[Any, FloatVector]:
    """Return the numbers of the rows to draw and a coordinate, or a point in the plane, of each; or raise."""
    chosen = _checked_numbers(rows, n)
    return chosen, _checked_points(over, chosen, n)


def _checked_numbers(rows: Any, n: int) -> Any:
    if rows is None:
        return np.arange(n)
    given = np.asarray(rows)
    if given.dtype == np.bool_ and given.shape == (n,):
        return np.flatnonzero(given)
    need = f"rows must be whole numbers from 0 to {n - 1}, or {n} truth values"
    if given.ndim != 1 or not np.issubdtype(given.dtype, np.integer):
        raise InvalidOption(f"{need}, got {given.dtype} numbers of shape {given.shape}")
    if not given.size:
        raise InvalidOption(f"{need}, got none")
    if (outside := given[(given < 0) | (given >= n)]).size:
        raise InvalidOption(f"{need}, got {outside[0]}")
    return given


def _checked_points(over: Any, chosen: Any, n: int) -> FloatVector:
    if over is None:
        return np.asarray(chosen, dtype=float)
    need = f"over must hold real coordinates of the {n} rows, or of the {chosen.size} drawn, shape (n,) or (n, 2)"
    try:
        points = np.asarray(over).astype(float, casting="same_kind")
    except (TypeError, ValueError):
        raise InvalidOption(
            f"{need}, got {type(over).__name__} of {np.asarray(over).dtype}"
        ) from None
    is_shaped = points.ndim == 1 or (points.ndim == 2 and points.shape[1] == 2)
    if not is_shaped or len(points) not in (n, chosen.size) or not np.isfinite(points).all():
        raise InvalidOption(f"{need}, got shape {points.shape}; they must be finite")
    return points if len(points) == chosen.size else points[chosen]


def save_plot(answer: Answer, path: Path, shape: Sequence[int] | None = None) -> None:
    """Write what `plot_answer` draws into a file, .png, .pdf or .svg."""
    save(_plotted(answer, None, shape, require_matplotlib()).figure, path)


def _plotted(answer: Any, axes: Any, shape: Sequence[int] | None, new: Callable[..., Any]) -> Any:
    """Return the axes of the picture, in a new figure where none are given."""
    if isinstance(answer, March):
        return _plot_march(answer, axes, shape, new)
    if isinstance(answer, AnswerSequence):
        return _plot_batch(answer, axes, shape, new)
    beside = _panel_beside(answer)
    draw = _draw_x
    if shape is None and isinstance(getattr(answer, "problem", None), FrictionalContact):
        draw = _draw_cones
    if answer.x is None and beside is None:
        raise UnsuitableProblem(f"there is no x to draw: {answer.status.name}")
    panels = [
        panel
        for panel in (
            None if answer.x is None else partial(draw, answer=answer, shape=shape),
            beside,
        )
        if panel is not None
    ]
    with _panels(axes, new, len(panels), _headline(answer)) as every:
        for one, panel in zip(every, panels, strict=False):  # into the caller's axes goes the first
            panel(one)
    return every[0]


def checked_shape(shape: Sequence[int] | None, n: int) -> tuple[int, ...] | None:
    """Return the shape of a grid of n unknowns, or raise InvalidOption."""
    if shape is None:
        return None
    try:
        sizes = tuple(int(size) for size in shape)
        is_whole = all(
            size == given and size > 0 for size, given in zip(sizes, shape, strict=True)
        ) and bool(sizes)
    except (TypeError, ValueError):
        sizes, is_whole = (), False
    if not is_whole:
        raise InvalidOption(f"shape must hold whole numbers > 0, as (rows, columns), got {shape!r}")
    if (held := int(np.prod(sizes, dtype=object))) != n:
        raise InvalidOption(
            f"shape {sizes} is that of {held} unknowns, and the problem has {n}; give that of its grid"
        )
    return sizes


def labels_of(shape: Sequence[int]) -> tuple[str, ...]:
    """Return what the axes of a grid are called."""
    return (*(f"axis {k}" for k in range(len(shape) - len(LABELS))), *LABELS[-len(shape) :])


# --- One answer -------------------------------------------------------------------------------------------------


def _draw_x(axes: Any, *, answer: Answer, shape: Sequence[int] | None) -> None:
    lower, upper = _bounds(answer)
    level = (
        contact_level(answer.certificate.problem, answer.z, answer.w)
        if isinstance(answer, Result)
        else None
    )
    _draw_values(
        axes, answer.x, lower, upper, checked_shape(shape, len(answer.x)), _unknown(answer), level
    )


def _draw_cones(axes: Any, *, answer: Any, shape: Sequence[int] | None) -> None:
    """Draw the tangential impulse of each closed contact beside the largest that its friction allows, 1 in any unit."""
    motion, mu = answer.motion, answer.problem.friction
    limit = mu * motion.normal
    shares = motion.tangential / np.where(limit > 0.0, limit, 1.0)[:, None]
    slides, count = motion.touches & ~motion.sticks, len(shares)
    is_plane = shares.shape[1] == 1
    across = np.arange(count) if is_plane else shares[:, 1]
    if is_plane:
        axes.axvline(-1.0, color="#7A7A7A", linewidth=1.0)
        axes.axvline(1.0, color="#7A7A7A", linewidth=1.0)
        axes.set(xlim=(-1.25, 1.25), ylim=(-0.5, max(1.2 * count, 1.0)), ylabel="contact")
        axes.yaxis.get_major_locator().set_params(integer=True)
    else:
        angle = np.linspace(0.0, 2.0 * np.pi, 200)
        axes.plot(np.cos(angle), np.sin(angle), color="#7A7A7A", linewidth=1.0)
        axes.set(aspect="equal", xlim=(-1.25, 1.25), ylim=(-1.15, 1.45))
        axes.set_ylabel("second tangential impulse ÷ $\\mu\\,r_N$")
    size = float(np.clip(3000.0 / max(count, 1), 6.0, 24.0))
    for chosen, colour, marker, word in (
        (motion.sticks, FREE, "o", "stick"),
        (slides, ACTIVE, "^", "slide"),
    ):
        axes.scatter(
            shares[chosen, 0],
            across[chosen],
            s=size,
            color=colour,
            marker=marker,
            label=f"{np.count_nonzero(chosen)} {word}",
        )
    axes.scatter(
        [],
        [],
        s=size,
        facecolors="none",
        edgecolors="#7A7A7A",
        label=f"{(~motion.touches).sum()} open",
    )
    axes.legend(loc="upper center", ncols=3, columnspacing=1.0, handletextpad=0.2)
    what = "tangential" if is_plane else "first tangential"
    axes.set(xlabel=f"{what} impulse ÷ $\\mu\\,r_N$", title="Impulses in their cones")


def _draw_values(
    axes: Any,
    x: FloatVector,
    lower: FloatVector,
    upper: FloatVector,
    shape: tuple[int, ...] | None,
    unknown: str,
    level: FloatVector | None = None,
) -> None:
    """Draw values as a map where they have two axes of more than one node, else by their index."""
    active = (x <= lower) | (x >= upper)
    if shape is not None and len(shape) > 1 and min(shape[-2:]) > 1:
        edge = None if level is None else level.reshape(shape)
        field = field_of(x.reshape(shape), active.reshape(shape), labels_of(shape), level=edge)
        draw_map(axes, field | {"unknown": unknown})
        return
    axes.locator_params(axis="x", integer=True)
    draw_line(
        axes,
        {
            "kind": "dots",
            "z": x,
            "active": active,
            "x": np.arange(x.size),
            "x_label": "index",
            "unknown": unknown,
            "active_means": "at a bound",
        },
    )


def _bounds(answer: Answer) -> tuple[FloatVector, FloatVector]:
    """Return the bounds of x."""
    problem: Any = getattr(answer, "problem", None)
    problem = (
        answer.certificate.problem if problem is None and isinstance(answer, Result) else problem
    )
    problem = getattr(
        answer if problem is None else problem, "program", problem
    )  # of a program, or beside pairs
    if getattr(problem, "is_distributed", False):
        raise UnsuitableProblem(
            "no rank holds the whole z: gather it, or save with LCP.save and plot elsewhere"
        )
    return problem.lower, problem.upper


def _unknown(answer: Answer) -> str:
    return "z" if isinstance(answer, Result) else "x"


def _headline(answer: Answer) -> str:
    value = "" if answer.objective is None else f"objective {answer.objective:.6g}, "
    size = "" if answer.x is None else f"n = {len(answer.x)}: "
    return f"{size}{answer.status.name} by {answer.algorithm},\n{value}{in_words(answer.iterations, 'iteration')}"


def _panel_beside(answer: Answer) -> Any:
    """Return what draws how the run went, None where it was not recorded."""
    if isinstance(answer, EquilibriumResult):
        return partial(_draw_search, answer=answer)
    if not getattr(answer, "history", ()):
        return None
    run: Any = getattr(
        answer, "lcp_result", answer
    )  # of a program, the run on its complementarity problem
    return partial(draw_residuals, result=run)


def _draw_search(axes: Any, *, answer: EquilibriumResult) -> None:
    """Draw how the least bound of the leaves rose from branching to branching, and the value found."""
    nodes = iter(answer.tree)
    root = next(nodes, None)
    leaves, gone = [] if root is None else [(root.bound, id(root))], set[int]()
    bounds = [one for one, _ in leaves]
    for node in nodes:
        if id(node.parent) not in gone:
            gone.add(id(node.parent))
            bounds.append(bounds[-1])
        heapq.heappush(leaves, (node.bound, id(node)))
        while leaves and leaves[0][1] in gone:
            heapq.heappop(leaves)
        bounds[-1] = min(leaves[0][0], answer.value) if leaves else answer.value
    shown = np.array(bounds)
    axes.step(
        np.arange(shown.size), np.where(np.isfinite(shown), shown, np.nan), where="post", color=FREE
    )
    if np.isfinite(answer.lower_bound):
        axes.plot([max(shown.size - 1, 0)], [answer.lower_bound], ".", color=FREE)
    if np.isfinite(answer.value):
        axes.axhline(answer.value, color=ACTIVE, linewidth=1, linestyle="--")
        axes.annotate(
            "objective found",
            (0.99, answer.value),
            (0, 3),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            ha="right",
            color=ACTIVE,
            fontsize=8,
        )
    axes.locator_params(axis="x", integer=True)
    axes.set(xlabel="nodes branched on", ylabel="proved lower bound", title=f"gap {answer.gap:.1e}")


# --- Sequences --------------------------------------------------------------------------------------------------


def _plot_march(
    march: March, axes: Any, shape: Sequence[int] | None, new: Callable[..., Any]
) -> Any:
    if not len(march):
        raise UnsuitableProblem("the march has no step to draw")
    grid = checked_shape(shape, march[0].z.size)
    is_map = (grid is not None and len(grid) > 1) or march[0].z.size > MOST_DOTS
    count = (1 if axes is not None else PANELS) if is_map else SLICES
    steps = sorted({round(k) for k in np.linspace(len(march) - 1, 0, min(count, len(march)))})
    title = f"{len(march)} steps: {march.counts()}"
    with _panels(axes, new, len(steps) if is_map else 1, title) as every:
        if is_map:
            for one, k in zip(every, steps, strict=True):
                _draw_values(one, march.z[k], *_bounds(march[k]), grid, f"z after step {k + 1}")
        else:
            _draw_slices(every[0], march, steps)
    return every[-1]


def _draw_slices(axes: Any, march: March, steps: Sequence[int]) -> None:
    """Draw z of some steps over each other, from light to dark, what rests on a bound thicker."""
    from matplotlib import colormaps

    for place, k in enumerate(steps):
        z, (lower, upper) = march.z[k], _bounds(march[k])
        colour, x = colormaps[HEIGHTS](1.0 - (place + 1) / len(steps)), np.arange(z.size)
        axes.plot(x, z, color=colour, linewidth=1.3, label=f"step {k + 1}")
        axes.plot(x, np.where((z <= lower) | (z >= upper), z, np.nan), color=colour, linewidth=3.0)
    axes.legend(fontsize="small")
    axes.set_title("thick: at a bound", fontsize=8.5)
    axes.set(xlabel="index", ylabel="z")


def _plot_batch(
    answers: AnswerSequence[Any], axes: Any, shape: Sequence[int] | None, new: Callable[..., Any]
) -> Any:
    if shape is not None:
        raise InvalidOption("shape goes with one answer: answers[k].plot(shape=…)")
    status: list[Status | None] = list(answers.status)
    table: Any = getattr(
        answers, "iterations", None
    )  # of a batch; a list of answers is looked at one by one
    if table is None:
        table = [0 if one is None else answers[k].iterations for k, one in enumerate(status)]
    iterations = np.asarray(table, dtype=np.intp)
    largest = int(iterations.max(initial=0))
    edges = np.unique(np.linspace(0, largest + 1, min(largest + 1, 30) + 1).astype(np.intp)) - 0.5
    kinds = [one for one, _ in Counter(status).most_common()]
    counts = [iterations[[other is one for other in status]] for one in kinds]
    names = [f"no {answers.ITEM}" if one is None else one.name for one in kinds]
    colours = [ACTIVE if one is not Status.SOLVED else FREE for one in kinds]
    others = iter([*COLOURS.values()][2:])
    colours = [
        colour if colour not in colours[:k] else next(others) for k, colour in enumerate(colours)
    ]
    with _panels(axes, new, 1) as every:
        one = every[0]
        if kinds:
            one.hist(
                counts,
                bins=edges,
                stacked=True,
                color=colours,
                label=[f"{name}: {len(count)}" for name, count in zip(names, counts, strict=True)],
            )
            one.legend(fontsize="small")
        one.locator_params(integer=True)
        one.set(
            xlabel="iterations",
            ylabel=f"{answers.ITEM}s",
            title=f"{len(status)} {answers.ITEM}s, {answers.seconds:.3g} s",
        )
    return every[0]


@contextmanager
def _panels(axes: Any, new: Callable[..., Any], count: int, title: str = "") -> Iterator[list[Any]]:
    """Give axes to draw into: the caller's, whose style stays, or some side by side in a new figure with a title."""
    if axes is not None:
        yield [axes]
        return
    with styled():
        figure = new(figsize=(count * PANEL[0], PANEL[1]), layout="constrained")
        yield [*figure.subplots(1, count, squeeze=False)[0]]
        if title:
            figure.suptitle(title, fontsize=10, x=0.01, ha="left")


def _shown_by_pyplot(**how: Any) -> Any:
    """Return a figure that pyplot and notebooks show."""
    from matplotlib import pyplot

    return pyplot.figure(**how)
