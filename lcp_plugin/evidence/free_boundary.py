"""The free boundary of a solution between the nodes, to a tenth of the mesh width.

A node is at its bound or not, so that the set of nodes resolves the free boundary only to one mesh width. The forces
locate it within the cell. Let g ≥ 0 be the gap between z and its bound and w the force of the bound. Let f be the
force with every node at the bound, and m the largest coupling of a row with a neighbor. In one dimension, for a node
i in contact and a free neighbor j,

    w_i + m g_j = f   and the boundary lies at x_i + (1/2 − m g_j / f) h,

exactly if f and m are constant: the discrete z is a parabola whose vertex is there. The level

    φ_i = 1/2 − w_i / f_i  at the bound,     φ_j = 1/2 + m_j g_j / f_j  elsewhere

is linear in both, is −1/2 deep in the contact, and 0 at that place if the boundary lies outside the last node in
contact (inside it, within a tenth of h). If no force presses, for example a string on a flat roof, only z is known:
−1/2 in contact, 1/2 elsewhere. On a grid or on triangles the boundary is the contour φ = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.certificates.residuals import Certificate
from ..core.checks import Vector
from ..core.errors import InvalidOption
from ..core.lcp import LCP
from ..core.matrix import largest_in_rows
from ..solving.result import Result

UNTOUCHED = 1.5  # the level of a node that no bound is near to


@dataclass(frozen=True, eq=False)
class FreeBoundary:
    """Points at which a solution leaves its bounds.

    Attributes
    ----------
    level : array, shape (n,) or longer
        Negative if z is at a bound, 0 on the boundary, linear between nodes. On a grid, the cells' centers follow
        the unknowns, each the mean of its corners.
    points : array, shape (n,) or (n, 2), or as many as levels
        The nodes.
    triangles : int array, shape (k, 3)
        Numbers of nodes in the plane; no row in one dimension.
    """

    level: Vector
    points: Vector
    triangles: np.ndarray[Any, Any]

    @property
    def positions(self) -> Vector:
        """Points in one dimension at which φ changes sign, rising, shape (k,)."""
        if self.points.ndim != 1:
            raise InvalidOption("positions are of one dimension; in the plane use segments")
        order = np.argsort(self.points, kind="stable")
        x, level = self.points[order], self.level[order]
        k = np.flatnonzero((level[:-1] < 0.0) != (level[1:] < 0.0))
        return x[k] + (x[k + 1] - x[k]) * level[k] / (level[k] - level[k + 1])

    @property
    def segments(self) -> Vector:
        """Endpoints of the boundary's segments in the plane, one per triangle, shape (k, 2, 2)."""
        level, points = self.level[self.triangles], self.points[self.triangles]
        inside = level < 0.0
        crossed = inside.any(axis=1) & ~inside.all(axis=1)
        level, points, inside = level[crossed], points[crossed], inside[crossed]
        # the corner on its own side
        alone = np.argmax(inside == (inside.sum(axis=1) == 1)[:, None], axis=1)
        rows = np.arange(len(level))[:, None]
        others = (alone[:, None] + [1, 2]) % 3
        own, its = level[rows, alone[:, None]], points[rows, alone[:, None]]
        share = own / (own - level[rows, others])
        return np.asarray(its + share[..., None] * (points[rows, others] - its))

    @property
    def area(self) -> float:
        """Area of the contact set, its boundary between the nodes; length in one dimension."""
        if self.points.ndim == 1:
            order = np.argsort(self.points, kind="stable")
            low, high = np.sort(np.stack([self.level[order][:-1], self.level[order][1:]]), axis=0)
            inside = np.clip(low / np.where(low < high, low - high, -1.0), 0.0, 1.0)
            share = np.where(high <= 0.0, 1.0, inside)
            return float(share @ np.diff(self.points[order]))
        corners = self.points[self.triangles]
        (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
        a, b, c = np.sort(self.level[self.triangles], axis=1).T
        with np.errstate(all="ignore"):
            one = a * a / ((b - a) * (c - a))  # of a triangle with one corner below 0
            two = 1.0 - c * c / ((c - a) * (c - b))
        share = np.where(c <= 0.0, 1.0, np.where(b < 0.0, two, np.where(a < 0.0, one, 0.0)))
        return float(share @ np.abs(ax * by - ay * bx) / 2.0)

    def draw(self, axes: Any, **how: Any) -> None:
        """Draw it into matplotlib's axes: lines in the plane, in one dimension a vertical line each."""
        if self.points.ndim == 1:
            for place in self.positions:
                axes.axvline(place, **how)
        elif (self.level < 0.0).any() and (self.level > 0.0).any():
            names = {"color": "colors", "linewidth": "linewidths", "linestyle": "linestyles"}
            look = {names.get(name, name): value for name, value in how.items()}
            axes.tricontour(*self.points.T, self.triangles, self.level, levels=[0.0], **look)


def contact_level(problem: LCP, z: Vector, w: Vector) -> Vector:
    """Return φ of the head of this module, shape (n,): of the bound that is nearest in its sense."""
    M = problem.csr
    rows = np.repeat(np.arange(problem.n), np.diff(M.indptr))
    coupling = largest_in_rows(M, np.where(rows == M.indices, 0.0, np.abs(M.data)))
    level = np.full(problem.n, UNTOUCHED)
    for sign, bound in ((1.0, problem.lower), (-1.0, problem.upper)):
        known = np.isfinite(bound)
        if not known.any():
            continue
        force = sign * (M @ np.where(known, bound, z) + problem.q)
        touches, gap = known & (z == bound), sign * (z - np.where(known, bound, z))
        force = np.where(touches, np.maximum(force, sign * w), force)
        presses = force > 1e-12 * (abs(M) @ np.abs(np.where(known, bound, z)) + np.abs(problem.q))
        pulls = np.where(presses, force, 1.0)
        pressed = np.where(presses, np.clip(0.5 - sign * w / pulls, -0.5, 0.5), -0.5)
        free = np.where(presses, np.minimum(0.5 + coupling * gap / pulls, UNTOUCHED), 0.5)
        level = np.where(known, np.minimum(level, np.where(touches, pressed, free)), level)
    return level


def free_boundary(
    answer: Result | Certificate,
    *,
    coordinates: Any = None,
    shape: Sequence[int] | None = None,
    mesh: Any = None,
) -> FreeBoundary:
    """Return the free boundary of an LCP's solution, located between the nodes.

    Parameters
    ----------
    answer : Result or Certificate
        Result of `solve`, of a step of `march`, or ``Certificate.of(problem, z)``.
    coordinates : array, shape (n,), or sequence of two arrays, optional
        Coordinates of the nodes of a line; or of the rows and of the columns of a grid, with nodes in the order of
        ``z.reshape(len(rows), len(columns))``. By default numbers from 0.
    shape : (int, int), optional
        Shape of a grid without coordinates.
    mesh : (points, triangles), optional
        Nodes anywhere in the plane: points (n, 2), triangles (k, 3) of their numbers. x comes first in points, as in
        plots; on a grid a point is (column, row).

    Returns
    -------
    FreeBoundary
        With `positions` of a line, or `segments` in the plane, with `area` and `draw`.

    Raises
    ------
    InvalidOption
        If the number of nodes is not the number of unknowns.

    Examples
    --------
    A string that falls onto the ground, u″ = 8 from u(0) = 1: it touches from 1/2 on, wherever the nodes are.

    >>> import numpy as np, scipy.sparse as sp
    >>> from lcp_plugin import LCP, solve
    >>> from lcp_plugin.evidence.free_boundary import free_boundary
    >>> h = 1 / 21
    >>> M = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20))
    >>> answer = solve(LCP(M, 8 * h**2 - np.eye(20)[0]))
    >>> free_boundary(answer, coordinates=h * np.arange(1, 21)).positions.round(2)
    array([0.5])
    """
    if not isinstance(answer, (Result, Certificate)):
        raise InvalidOption(
            f"free_boundary needs the answer of an LCP, a Result or Certificate.of(problem, z), got "
            f"{type(answer).__name__}"
        )
    certificate = answer.certificate if isinstance(answer, Result) else answer
    problem, z, w = certificate.problem, certificate.z, certificate.w
    points, triangles = _nodes(problem.n, coordinates, shape, mesh)
    level = contact_level(problem, z, w)
    if points.ndim == 2 and len(points) > problem.n:  # a grid's: four triangles round each centre
        corners = triangles[:, 0].reshape(4, -1)
        level = np.concatenate([level, level[corners].mean(axis=0)])
    return FreeBoundary(level, points, triangles)


def _nodes(n: int, coordinates: Any, shape: Any, mesh: Any) -> tuple[Vector, np.ndarray[Any, Any]]:
    """Return the points of the unknowns and the triangles between them."""
    if mesh is not None:
        points, triangles = np.asarray(mesh[0], dtype=float), np.asarray(mesh[1])
        if points.shape != (n, 2) or triangles.ndim != 2 or triangles.shape[1] != 3:
            raise InvalidOption(
                f"mesh must be (points, triangles) of shapes ({n}, 2) and (k, 3), got {points.shape} "
                f"and {triangles.shape}; transpose them, or take the triangles between unknowns alone"
            )
        return points, triangles
    if shape is None and (coordinates is None or np.ndim(coordinates[0]) == 0):
        line = np.asarray(np.arange(n) if coordinates is None else coordinates, dtype=float)
        if line.shape != (n,) or not np.isfinite(line).all():
            raise InvalidOption(
                f"coordinates must be {n} numbers, finite, or (rows, columns) of a grid, got "
                f"{line.shape}"
            )
        return line, np.empty((0, 3), dtype=np.intp)
    rows, columns = (
        (np.arange(size) for size in shape) if coordinates is None else map(np.asarray, coordinates)
    )
    if len(rows) * len(columns) != n:
        raise InvalidOption(
            f"a grid of {len(rows)} rows and {len(columns)} columns has not {n} unknowns; give shape= "
            "or coordinates=(rows, columns) of its nodes"
        )
    y, x = np.meshgrid(rows, columns, indexing="ij")
    nodes = np.stack([x.ravel(), y.ravel()], axis=1).astype(float)
    first = (np.arange(len(rows) - 1)[:, None] * len(columns) + np.arange(len(columns) - 1)).ravel()
    around = np.stack([first, first + 1, first + 1 + len(columns), first + len(columns)])
    centre = n + np.arange(first.size)
    sides = [np.stack([around[k], around[(k + 1) % 4], centre], axis=1) for k in range(4)]
    return np.concatenate([nodes, nodes[around].mean(axis=0)]), np.concatenate(sides)
