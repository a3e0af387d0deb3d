"""Plots of a path: the unknowns over the parameter with its breakpoints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import InvalidOption, UnsuitableProblem
from .drawing import require_matplotlib, styled

if TYPE_CHECKING:
    from ..problems.parametric.path import Path

MOST_LINES, NAMED = 40, 10  # unknowns drawn; unknowns that a legend names
MOST_MARKS = 60  # breakpoints that are drawn as lines


def plot_path(path: Path, *, axes: Any = None, rows: Sequence[int] | None = None) -> Any:
    """Return matplotlib's axes with x over θ, its breakpoints as thin lines.

    Parameters
    ----------
    path : Path
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
        raise UnsuitableProblem(f"there is no path to draw: {path.explain()}")
    theta = np.array([value for piece in path.pieces for value in (piece.begin, piece.end)])
    every = np.array(
        [piece.x_at(value) for piece in path.pieces for value in (piece.begin, piece.end)]
    )
    n = every.shape[1]
    if rows is None:
        order = np.argsort(-np.ptp(every, axis=0), kind="stable")
        rows = sorted(order[:MOST_LINES].tolist())
    chosen = np.asarray(rows)
    is_whole = chosen.ndim == 1 and np.issubdtype(chosen.dtype, np.integer)
    if not is_whole or not ((chosen >= 0) & (chosen < n)).all():
        raise InvalidOption(f"rows must be integers from 0 to {n - 1}, got {rows!r}")
    if axes is None:
        import matplotlib.pyplot as plt

        with styled():
            _, axes = plt.subplots(figsize=(7.2, 4.0), layout="constrained")
    for value in path.breakpoints if len(path) <= MOST_MARKS else ():
        axes.axvline(value, color="#dddddd", linewidth=0.7, zorder=0)
    for j in chosen:
        axes.plot(theta, every[:, j], linewidth=1.4, label=f"x[{j}]")
    if chosen.size <= NAMED:
        axes.legend(fontsize=7.5, loc="best")
    axes.set(xlabel="parameter", ylabel="x" if chosen.size == n else f"x, {chosen.size} of {n}")
    return axes
