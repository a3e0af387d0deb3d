"""Active sets: solve on the free columns, go there as far as the bounds allow, let go of what pulls inwards.

From a point near the answer it is a few rounds. The cost falls with each, so that no set comes twice but for rounding:
columns let go that want to cross their bound stay, and one let go alone does not want to (Lawson and Hanson).

References
----------
P. B. Stark, R. L. Parker, *Bounded-variable least-squares: an algorithm and applications*, Comput. Stat. 10 (1995).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...checks import BoolVector, FloatVector
from .faces import Faces
from .point import Point

REFINED = 0.5  # what a correction on the same face has to leave at the most to be followed by another


def active_set_steps(start: Point, faces: Faces, free: BoolVector | None = None) -> Iterator[Point]:
    """Yield points from the start on; ends at the answer up to rounding, or where no set gains any more.

    The first set is that of the columns strictly between their bounds, or `free`.
    """
    yield start
    point, free, size = start, start.is_free if free is None else free, np.inf
    while (correction := faces.correction(point, free)) is not None:
        length = point.farthest(correction)
        after = _moved(point, correction, length)
        if length == 0.0 and np.array_equal(after.x, point.x):
            fewer = _without(point, free, correction)
            if fewer is None:
                return
            free = fewer
            continue
        point = after
        yield point
        free = point.is_free
        if length >= 1.0:  # the face is solved
            noise, before, size = point.noise, size, float(np.abs(point.natural_residual).max(initial=0.0))
            pulled = np.abs(point.pull) > noise
            if not pulled.any() and not noise < size <= REFINED * before:
                return
            free = free | pulled


def _moved(point: Point, correction: FloatVector, length: float) -> Point:
    """Return the minimum over the free columns, or what the bounds allow on the way there."""
    if length >= 1.0:
        return Point(point.problem, np.clip(point.x + correction, point.problem.lower, point.problem.upper))
    return point.projected(correction, point.problem.product(correction))


def _without(point: Point, free: BoolVector, correction: FloatVector) -> BoolVector | None:
    """Return the free columns without those that were let go and want to cross the bound they are at, if that helps.

    Where all want to, the one that pulls hardest is let go alone: but for rounding it moves inwards.
    """
    let_go = free & ~point.is_free
    stay = let_go & (correction * point.gradient < 0.0)
    if stay.any():
        return point.is_free | stay
    if np.count_nonzero(let_go) <= 1:
        return None
    hardest = point.is_free.copy()
    hardest[np.argmax(np.abs(np.where(let_go, point.pull, 0.0)))] = True
    return hardest
