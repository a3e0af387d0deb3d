"""Pictures of a path: unknowns over the parameter with its breakpoints, the objective, and how many rows act."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import InvalidOption, UnsuitableProblem
from .drawing import require_matplotlib, styled

if TYPE_CHECKING:
    from ..problems.parametric.path import Path

MOST_LINES, NAMED, BETWEEN = (
    40,
    10,
    12,
)  # unknowns drawn; of which a legend names; values of an objective a piece
MOST_MARKS = 60  # breakpoints that are drawn as lines


def plot_path(path: Path, *, axes: Any = None, rows: Sequence[int] | None = None) -> Any:
    """Return matplotlib's axes with x over θ; of a new figure with the objective and the rows that act below.

    Parameters
    ----------
    path : Path
    axes : Axes, optional
        To draw x into, and nothing else.
    rows : sequence of int, optional
        Which unknowns; those that change most by default.

    Raises
    ------
    UnsuitableProblem
        Where the path has no pieces.
    InvalidOption
        Where rows are no numbers of unknowns.
    """
    require_matplotlib()
    if not path.pieces:
        raise UnsuitableProblem(f"there is no path to draw: {path.explain()}")
    if axes is not None:
        _draw_unknowns(axes, path, rows)
        axes.set_xlabel("parameter")
        return axes
    import matplotlib.pyplot as plt

    with styled():
        has_objective = not np.isnan(path.objective(path.start)).any()
        heights = [2.4, 1.0, 1.0] if has_objective else [2.4, 1.0]
        figure, every = plt.subplots(
            len(heights),
            1,
            figsize=(7.2, 1.6 + 1.35 * sum(heights)),
            sharex=True,
            height_ratios=heights,
            layout="constrained",
        )
        _draw_unknowns(every[0], path, rows)
        if has_objective:
            values = np.unique(
                np.concatenate([np.linspace(p.begin, p.end, BETWEEN) for p in path.pieces])
            )
            every[1].plot(values, path.objective(values), color="#222222", linewidth=1.4)
            every[1].set_ylabel("objective")
        _draw_active(every[-1], path)
        every[-1].set_xlabel("parameter")
        figure.suptitle(repr(path), fontsize=10, x=0.01, ha="left")
    return every[0]


def _draw_unknowns(axes: Any, path: Path, rows: Sequence[int] | None) -> None:
    """Draw unknowns as polygons, which they are, and breakpoints as thin lines."""
    theta = np.array([value for piece in path.pieces for value in (piece.begin, piece.end)])
    every = np.array(
        [piece.x0 + value * piece.x1 for piece in path.pieces for value in (piece.begin, piece.end)]
    )
    n = every.shape[1]
    if rows is None:
        spread = np.ptp(every, axis=0)
        rows = sorted(np.argsort(-spread, kind="stable")[:MOST_LINES].tolist())
    chosen = np.asarray(rows)
    if (
        chosen.ndim != 1
        or not np.issubdtype(chosen.dtype, np.integer)
        or not ((chosen >= 0) & (chosen < n)).all()
    ):
        raise InvalidOption(f"rows must be whole numbers from 0 to {n - 1}, got {rows!r}")
    for value in path.breakpoints if len(path) <= MOST_MARKS else ():
        axes.axvline(value, color="#dddddd", linewidth=0.7, zorder=0)
    for j in chosen:
        axes.plot(theta, every[:, j], linewidth=1.4, label=f"x[{j}]")
    if chosen.size <= NAMED:
        axes.legend(fontsize=7.5, loc="best")
    axes.set_ylabel("x" if chosen.size == n else f"x, {chosen.size} of {n}")


def _draw_active(axes: Any, path: Path) -> None:
    """Draw how many unknowns and rows are on each side, as steps."""
    forward = path.breakpoints[0] <= path.breakpoints[-1]
    order = slice(None, None, 1 if forward else -1)
    ends = path.breakpoints[order]
    cases = np.array([piece.case for piece in path.pieces])
    names = {
        -1: "at the lower bound",
        0: "between",
        1: "at the upper bound",
        2: "at 0 by the penalty",
    }
    for case, colour in zip(names, ("#D55E00", "#0072B2", "#CC79A7", "#777777"), strict=True):
        counts = (cases == case).sum(axis=1)
        if counts.any():
            axes.stairs(
                counts[order], ends, baseline=None, color=colour, linewidth=1.3, label=names[case]
            )
    axes.set_ylabel("rows")
    axes.legend(fontsize=7.5, loc="best")
