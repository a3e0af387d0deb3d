"""The extreme points of a face of solutions, without rounding."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

from ...exact.simplex import Effort, ExactSimplex
from ...problem.lcp import LCP
from .explorer import Explorer

Point = tuple[Fraction, ...]


def extreme_points(problem: LCP, pattern: Sequence[str]) -> Iterator[Point]:
    """Yield the extreme points of all solutions of a pattern, each once; none where they contain a line.

    Parameters
    ----------
    problem : LCP
    pattern : sequence of str, shape (n,)
        The choice of every row, as of a ``Solution``.

    Notes
    -----
    Bounds are made equations one after the other, in order, each where it lowers the dimension of what is left. An
    extreme point is what is left in dimension 0: the first independent ones of the bounds that it meets lead to it.
    """
    explorer = Explorer(problem, Effort(), first_only=False)
    simplex = explorer.simplex
    _finish(simplex.solve_equations())
    for i, choice in enumerate(pattern):
        if len(explorer.choices[i]) > 1:
            explorer.choose(i, choice)
    if _finish(simplex.refutation()) is None:
        bounds = [(x, at) for x in range(2 * problem.n) for at in set(simplex.bounds(x)) if at is not None]
        found = set()
        for point in _corners(simplex, sorted(bounds), 0):
            if point not in found:
                found.add(point)
                yield point


def _corners(simplex: ExactSimplex, bounds: list[tuple[int, int]], first: int) -> Iterator[Point]:
    """Yield where the set that is left ends in a point, once some of the bounds from the first on are met."""
    dimension = _finish(simplex.release_fixed())
    if dimension == 0:
        yield tuple(simplex.point())
        return
    for k in range(first, len(bounds)):
        x, at = bounds[k]
        before = simplex.bounds(x)
        if before == (at, at):
            continue
        simplex.set_bounds(x, at, at)
        if _finish(simplex.refutation()) is None and _finish(simplex.release_fixed()) < dimension:
            yield from _corners(simplex, bounds, k + 1)
        simplex.set_bounds(x, *before)
        _finish(simplex.refutation())


def _finish(steps: Iterator[None]) -> Any:
    """Return what a generator returns at its end."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value
