"""The law of a solution over regions of parameters: where a point lies, its x, a picture, arrays, and C."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, cKDTree

from ...core.checks import FloatVector
from ...core.errors import InvalidOption
from ...core.lcp import LCP
from ...core.representation import in_words
from ...core.settings import Status
from ...interfaces.files.files import checked_path, write_whole
from ..programs.conversion import conditions
from .families import Family

NEAR = 1e-9  # how far outside a region, of the box's width, a point still counts as in it
NEIGHBOURS = 6  # centres of regions that are looked at first
JUDGED = 12  # vertices of a region near which its law is certified
SAME = 1e-9  # of an unknown, or of what acts in its row: a law and an answer
OVER = 1e-6  # of the volume
INWARD = 1e-6  # of the way from a vertex to the centre: there signs are not left to rounding


@dataclass(frozen=True, eq=False)
class Region:
    """A polyhedron of parameters, scaled to the unit box, on which the case stays.

    Attributes
    ----------
    rows, limits : ndarray, shape (m, p) and (m,)
        rows θ ≤ limits, rows of length 1, none of them superfluous.
    vertices : ndarray, shape (v, p)
    centre : ndarray, shape (p,)
        Of the largest ball inside.
    case : ndarray of int, shape (n,)
        −1 at the lower bound, 0 between, 1 at the upper one; of a program x, then the rows of G and of A, whose
        multiplier is 0 (−1) or not (0).
    z : ndarray, shape (n, p + 1)
        All unknowns are z [θ, 1].
    facets : tuple
        Which unknown leaves its case behind each row, to what, and the middle of the facet.
    """

    rows: FloatVector
    limits: FloatVector
    vertices: FloatVector = field(repr=False)
    centre: FloatVector = field(repr=False)
    case: Any = field(repr=False)
    z: FloatVector = field(repr=False)
    facets: tuple[tuple[int, int, FloatVector], ...] = field(repr=False)

    def holds(self, point: FloatVector) -> bool:
        """Whether a point of the unit box lies in it, up to rounding."""
        return bool((self.rows @ point <= self.limits + NEAR).all())

    @cached_property
    def volume(self) -> float:
        """Of the polyhedron in the unit box."""
        if self.vertices.shape[1] == 1:
            return float(np.ptp(self.vertices))
        return float(ConvexHull(self.vertices, qhull_options="QJ").volume)


class Regions(Sequence[Region]):
    """The solution of a family of problems over a box of parameters; what `regions` returns.

    Attributes
    ----------
    problem : QuadraticProgram or LCP
        At θ = 0.
    kept : ndarray of int
        Which unknowns of the optimality conditions the regions speak of: all, but for multipliers of equations that
        follow from others.
    changes : dict
        The change of each vector by θ.
    low, high : ndarray, shape (p,)
        The box.
    missed : int
        Facets behind which neither a region nor the border of what is feasible was found.
    seconds : float
        Of the search, its certificates included.
    """

    def __init__(
        self,
        family: Family,
        box: tuple[FloatVector, FloatVector],
        found: list[Region],
        missed: int,
        kept: Any,
    ) -> None:
        self.family, self.problem, self.changes = family, family.problem, family.directions
        (self.low, self.high), self.kept, self.settings = box, kept, family.settings
        self._all, self.missed, self.seconds = found, missed, 0.0

    def __len__(self) -> int:
        return len(self._all)

    def __getitem__(self, k: Any) -> Any:
        return self._all[k]

    @property
    def n(self) -> int:
        """Unknowns x (z of an LCP)."""
        return int(self.problem.n)

    @cached_property
    def laws(self) -> tuple[FloatVector, FloatVector]:
        """(F, g) of all regions in the caller's θ: x = F[k] θ + g[k], shapes (regions, n, p) and (regions, n)."""
        width = self.high - self.low
        F = np.array([region.z[: self.n, :-1] / width for region in self._all])
        g = np.array([region.z[: self.n, -1] for region in self._all]) - F @ self.low
        return F, g

    @cached_property
    def polyhedra(self) -> list[tuple[FloatVector, FloatVector]]:
        """(E, e) of each region in the caller's θ: E θ ≤ e."""
        width = self.high - self.low
        return [
            (region.rows / width, region.limits + region.rows / width @ self.low)
            for region in self._all
        ]

    @cached_property
    def coverage(self) -> float:
        """The share of the convex hull of all regions that they fill: 1 where none between them is missing."""
        every = np.concatenate([region.vertices for region in self._all])
        whole = (
            np.ptp(every) if every.shape[1] == 1 else ConvexHull(every, qhull_options="QJ").volume
        )
        return round(float(sum(region.volume for region in self._all) / whole), 9)

    @cached_property
    def status(self) -> Status:
        """SOLVED where every law is, beside vertices of its region, by the criterion of the kind; else the worst.

        The conditions of a case are affine in θ, so that a law right beside all vertices is right between them.
        """
        worst = Status.SOLVED
        for region in self._all:
            for corner in region.vertices[:JUDGED]:
                vertex = corner + INWARD * (region.centre - corner)
                status = self._judged(
                    vertex * (self.high - self.low) + self.low, region.z @ np.append(vertex, 1.0)
                )
                worst = (
                    status if status is not Status.SOLVED and worst is not Status.STALLED else worst
                )
        return worst

    def _judged(self, theta: FloatVector, z: FloatVector) -> Status:
        """Return what the criterion says of z, or of the answer of `solve` that it is but for rounding."""
        every = np.zeros(self.family.conditions.n)
        every[self.kept] = z
        point = self.family.point(theta, every)
        status = self.family.judge(point)
        if status is Status.SOLVED:
            return status
        result = self.family.solved(theta)
        if not result.is_solved:
            return status
        # Where the terms of an unknown cancel, what is left stands beside those of its row of M z + q at the answer.
        plain = point.problem if isinstance(point.problem, LCP) else conditions(point.problem)
        rows, x = plain.csr[: self.n], every[: self.n]
        terms, diagonal = (
            abs(rows) @ np.abs(every) + np.abs(plain.q[: self.n]),
            np.abs(plain.diagonal[: self.n]),
        )
        acts = np.divide(terms, diagonal, out=np.zeros(self.n), where=diagonal > 0.0)
        return (
            Status.SOLVED
            if (np.abs(result.x - x) <= SAME * np.maximum(acts, np.abs(x))).all()
            else status
        )

    @property
    def is_solved(self) -> bool:
        """True where every law is certified, no region is missing and none lies over another."""
        return self.status is Status.SOLVED and not self.missed and self.coverage <= 1.0 + OVER

    def at(self, theta: ArrayLike) -> Any:
        """Return the problem at θ, shape (p,)."""
        return self.family.at(np.asarray(theta, dtype=float))

    def locate(self, theta: ArrayLike) -> Any:
        """Return the number of the region of each θ, shape (p,) or (count, p); −1 where there is none."""
        p = self.low.size
        try:
            given = np.asarray(theta, dtype=float)
        except (TypeError, ValueError):
            raise InvalidOption(
                f"θ must be numbers of shape ({p},) or (count, {p}), got {theta!r}"
            ) from None
        if given.ndim not in (1, 2) or given.shape[-1] != p or not np.isfinite(given).all():
            more = ", as [[0.5], [0.6]] for two values of one parameter" if p == 1 else ""
            raise InvalidOption(
                f"θ must have shape ({p},) or (count, {p}){more}, and be finite, got {theta!r}"
            )
        points = (np.atleast_2d(given) - self.low) / (self.high - self.low)
        found = np.full(len(points), -1)
        tree, rows, limits = self._index
        _, near = tree.query(points, min(NEIGHBOURS, len(self)))
        near = near.reshape(len(points), -1)
        open_, inside = (
            np.arange(len(points)),
            (points >= -NEAR).all(axis=1) & (points <= 1.0 + NEAR).all(axis=1),
        )
        open_ = open_[inside]
        for k in range(near.shape[1]):
            own = near[open_, k]
            fits = (np.einsum("imp,ip->im", rows[own], points[open_]) <= limits[own] + NEAR).all(
                axis=1
            )
            found[open_[fits]] = own[fits]
            open_ = open_[~fits]
        for start in range(0, open_.size, 256):
            rest = open_[start : start + 256]
            fits = (np.einsum("rmp,ip->irm", rows, points[rest]) <= limits + NEAR).all(axis=2)
            found[rest] = np.where(fits.any(axis=1), fits.argmax(axis=1), -1)
        return found if given.ndim == 2 else int(found[0])

    @cached_property
    def _index(self) -> tuple[cKDTree, FloatVector, FloatVector]:
        """Centres of regions, and their rows made equally many by 0 ≤ 1."""
        most = max(len(region.limits) for region in self._all)
        rows, limits = np.zeros((len(self), most, self.low.size)), np.ones((len(self), most))
        for k, region in enumerate(self._all):
            rows[k, : len(region.limits)], limits[k, : len(region.limits)] = (
                region.rows,
                region.limits,
            )
        return cKDTree(np.array([region.centre for region in self._all])), rows, limits

    def x_at(self, theta: ArrayLike) -> FloatVector:
        """Return x at each θ, shape (n,) or (count, n); NaN where no region is."""
        where = np.atleast_1d(self.locate(theta))
        points = np.atleast_2d(np.asarray(theta, dtype=float))
        F, g = self.laws
        x: FloatVector = np.einsum("inp,ip->in", F[where], points) + g[where]
        x[where < 0] = np.nan
        return x if np.ndim(theta) == 2 else x[0]

    def explain(self) -> str:
        """Return in words what was found, how sure it is, and what next."""
        p = self.low.size
        state = (
            self.status.name
            if self.is_solved or self.status is not Status.SOLVED
            else "not complete"
        )
        lines = [
            f"{state}: {in_words(len(self), 'region')} of {in_words(p, 'parameter')}, on each x is affine in θ; "
            f"{self.seconds:.2g} s"
        ]
        if self.is_solved:
            lines.append(
                "every law is certified next to the vertices of its region, and so between them: it is affine"
            )
        elif self.status is not Status.SOLVED:
            lines.append(
                f"a law is not certified beside some vertex: {self.status.name}. Scale the parameters, or "
                "raise tolerance=."
            )
        if self.missed:
            lines.append(
                f"behind {in_words(self.missed, 'facet')} nothing was found: x may not be unique there, or "
                "max_regions= ended the search"
            )
        filled = sum(region.volume for region in self._all)
        if self.is_solved and abs(filled - 1.0) <= OVER:
            lines.append("they cover the whole box")
        else:
            outside = "" if self.missed else "; outside of that nothing in the box is feasible"
            lines.append(
                f"they cover {filled:.1%} of the box, and {self.coverage:.4%} of their convex hull{outside}"
            )
        if self.coverage > 1.0 + OVER:
            lines.append("some lie over others: the solution is not unique there")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"Regions({len(self)} of {self.low.size} parameters, {self.status.name}, coverage {self.coverage:g})"

    def plot(self, *, axes: Any = None, component: int = 0) -> Any:
        """Return matplotlib's axes: the regions of two parameters, coloured by one unknown; of one a line."""
        from ...evidence.path_plots import plot_regions

        return plot_regions(self, axes=axes, component=component)

    def arrays(self) -> dict[str, FloatVector]:
        """Return E, e of all regions in turn with the first row of each in starts, F, g, and the box."""
        F, g = self.laws
        E, e = (np.concatenate(parts) for parts in zip(*self.polyhedra, strict=True))
        starts = np.cumsum([0, *(len(limits) for _, limits in self.polyhedra)])
        return {
            "E": E,
            "e": e,
            "starts": starts,
            "F": F,
            "g": g,
            "low": self.low,
            "high": self.high,
        }

    def save(self, path: Any) -> None:
        """Write `arrays` into an .npz file, or into .c a function of C that finds the region and returns x."""
        place: FilePath = checked_path(path)
        if place.suffix == ".npz":
            data: Any = self.arrays()
            write_whole({place: lambda file: np.savez(file, **data)})
        elif place.suffix == ".c":
            write_whole({place: lambda file: file.write(self.to_c().encode())})
        else:
            raise InvalidOption(f"regions are saved as .npz or .c, got {place.name!r}")

    def to_c(self, name: str = "law") -> str:
        """Return a function of C, ``int law(const double *theta, double *x)``: the region, −1 where there is none."""
        if not name.isidentifier():
            raise InvalidOption(f"name must be one of C, got {name!r}")
        data, p, n = self.arrays(), self.low.size, self.n

        def table(values: Any) -> Iterator[str]:
            flat = np.asarray(values).ravel()
            for k in range(0, flat.size, 6):
                yield "  " + " ".join(f"{value:.17g}," for value in flat[k : k + 6])

        lines = [
            f"/* x = F theta + g on {len(self)} polyhedra E theta <= e; {n} unknowns, {p} parameters. */"
        ]
        for kind, key in (
            ("double", "E"),
            ("double", "e"),
            ("int", "starts"),
            ("double", "F"),
            ("double", "g"),
        ):
            lines += [f"static const {kind} {name}_{key}[] = {{", *table(data[key]), "};"]
        slack = NEAR * float(np.max(self.high - self.low))
        lines += [
            f"int {name}(const double *theta, double *x) {{",
            f"  for (int k = 0; k < {len(self)}; k++) {{",
            "    int inside = 1;",
            f"    for (int i = {name}_starts[k]; inside && i < {name}_starts[k + 1]; i++) {{",
            f"      double left = -{name}_e[i] - {slack:.3g};",
            f"      for (int j = 0; j < {p}; j++) left += {name}_E[{p} * i + j] * theta[j];",
            "      inside = left <= 0.0;",
            "    }",
            "    if (!inside) continue;",
            f"    for (int i = 0; i < {n}; i++) {{",
            f"      x[i] = {name}_g[{n} * k + i];",
            f"      for (int j = 0; j < {p}; j++) x[i] += {name}_F[({n} * k + i) * {p} + j] * theta[j];",
            "    }",
            "    return k;",
            "  }",
            "  return -1;",
            "}",
        ]
        return "\n".join(lines) + "\n"
