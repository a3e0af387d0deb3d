"""regions(): the solution of a program over a box of parameters, an affine law on each of finitely many polyhedra.

A case says which unknowns of the optimality conditions are free. Where it stays, z is affine in θ, and it stays as long
as free unknowns keep their bounds and w of the others its sign: a polyhedron. Behind a facet one unknown changes its
case. So from any region all of them are reached, facet by facet (Bemporad, Morari, Dua, Pistikopoulos 2002; Tøndel,
Johansen, Bemporad 2003); what one change does not give, as at a degenerate facet, a solve just behind it does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import qr
from scipy.linalg.lapack import dgetrf, dgetrs, dpotrf
from scipy.optimize import linprog
from scipy.spatial import HalfspaceIntersection, QhullError

from ...core.checks import FloatVector
from ...core.deadline import Clock
from ...core.errors import InvalidOption, UnsuitableProblem
from ...core.kind import refusal
from ...core.lcp import LCP
from ...kinds import solve_any
from ..programs.program import QuadraticProgram
from .families import ComplementarityFamily, ProgramFamily
from .regions import Region, Regions
from .staircases import Columns

BEHIND = 1e-7  # a facet, of the box's width: where the next region is looked for
CLEARLY_BEHIND = 1e-5  # where a solve is asked, whose tolerance reaches behind a facet
FLAT = 1e-9  # inner radius, of the box's width: of what is no region
SINGULAR = 1e-13  # pivot beside the largest
CROSSED = 1e-9  # of the terms of its own row
ROUNDED = 1e-15  # of the terms of an unknown: what is left where they cancel
MOST_PARAMETERS = 6
Case = np.ndarray[Any, np.dtype[np.int8]]


def regions(
    problem: Any,
    parameters: Mapping[str, Any],
    within: Any,
    *,
    tolerance: float = 1e-8,
    max_regions: int = 100_000,
) -> Regions:
    """Return the solution for every θ in a box: polyhedra, and on each x = F θ + g. Explicit model predictive control.

    Data(θ) = data + change · θ. The problem is strictly convex, or M a P-matrix: x is unique.

    Parameters
    ----------
    problem : QuadraticProgram or LCP
        Its data are those at θ = 0.
    parameters : mapping
        What depends on θ, and how: c, h, b, lower, upper of a program, q, lower, upper of an LCP, each with its change
        by θ, shape (its size, p); for p = 1 (its size,).
    within : (low, high)
        Corners of the box, shape (p,) each, p up to 6.
    tolerance : float
        Of the certificates, as in `solve`.
    max_regions : int
        Where the search ends.

    Returns
    -------
    Regions
        With `coverage`: the share of the convex hull of all regions that they fill, 1 where none is missing.

    Raises
    ------
    InvalidOption
        Where something else is to move, or shapes do not fit.
    UnsuitableProblem
        Where x is not unique, or nothing in the box is feasible.
    UnsupportedModel
        Where a program is not convex.

    Notes
    -----
    Cost: a dense factor of the free block and a small linear program a region; regions grow fast with the number of
    rows. M is held dense.

    References
    ----------
    Bemporad, Morari, Dua, Pistikopoulos, Automatica 38, 2002, doi:10.1016/S0005-1098(01)00174-1.

    Examples
    --------
    x is as near to θ as |x| ≤ 1 allows: three regions on a line.

    >>> from lcp_plugin import QuadraticProgram, regions
    >>> found = regions(QuadraticProgram([[1.0]], [0.0], lower=-1, upper=1), {"c": [-1.0]}, ([-3.0], [3.0]))
    >>> len(found), found.coverage
    (3, 1.0)
    >>> found.x_at([[-2.0], [0.5]])
    array([[-1. ],
           [ 0.5]])
    """
    clock = Clock()
    if not isinstance(max_regions, int) or max_regions < 1:
        raise InvalidOption(f"max_regions must be a whole number ≥ 1, got {max_regions!r}")
    family = _Family(problem, parameters, within, tolerance)
    found, missed = family.explored(max_regions)
    if not found:
        raise UnsuitableProblem(
            "no θ in the box was found where the problem has a solution that is unique, with its "
            "multipliers; solve it at one corner and see its explain()"
        )
    answer = Regions(family.data, (family.low, family.high), found, missed, family.kept)
    _ = answer.status
    answer.seconds = clock.read()
    return answer


@dataclass(frozen=True, eq=False)
class _Law:
    """z = Z [θ, 1] of a case, and rows a θ ≤ b of where it holds, with their terms and what leaves there."""

    case: Case
    z: FloatVector
    rows: FloatVector
    limits: FloatVector
    sizes: FloatVector
    leaves: np.ndarray[Any, Any]
    becomes: Case


class _Family:
    """A problem whose vectors are affine in several parameters.

    Inside, θ is scaled to the unit box, and the conditions to D M D z + D q with rows alike. What is rounding is told
    beside the terms of its own row alone: a limit of 1e19 that nobody reaches excuses nothing.
    """

    def __init__(self, problem: Any, parameters: Any, within: Any, tolerance: float) -> None:
        kind = ComplementarityFamily if isinstance(problem, LCP) else ProgramFamily
        if not isinstance(problem, (LCP, QuadraticProgram)):
            raise InvalidOption(refusal("regions", problem))
        self.problem = problem
        self.low, self.high = _box(within)
        self.p = self.low.size
        self.data = kind(problem, parameters, (0.0, 0.0), tolerance, self.p)
        self._lay_out()

    def _lay_out(self) -> None:
        """Make M, and q, lower and upper as columns [change by scaled θ, at its 0]."""
        problem, plain = self.problem, self.data.conditions

        def affine(pair: FloatVector) -> FloatVector:
            change = pair[1:].T
            return np.column_stack([change * (self.high - self.low), pair[0] + change @ self.low])

        self.is_strict = (
            _is_p_matrix(problem) if isinstance(problem, LCP) else _is_definite(problem)
        )
        self.kept = np.arange(plain.n)
        if not isinstance(problem, LCP):
            first = problem.n + problem.h.size
            self.kept = np.append(
                self.kept[:first], first + _independent(problem, affine(self.data.pair("b")))
            )
        self.M = plain.csr.toarray()[np.ix_(self.kept, self.kept)]
        q, lower, upper = (affine(side)[self.kept] for side in self.data.rows())
        D = Columns(self.M).units()
        self.M = D[:, None] * self.M * D
        q, lower, upper = D[:, None] * q, lower / D[:, None], upper / D[:, None]
        self.q, self.lower, self.upper, self.unit = q, lower, upper, D

    def solved(self, theta: FloatVector) -> Case | None:
        """Return the case of an answer at θ, an active set's where there is one; None where there is no answer."""
        here = np.append(theta, 1.0)
        lower, upper = self.lower @ here, self.upper @ here
        if (lower > upper + CROSSED * np.abs(upper)).any():
            return None
        problem = self.data.at(self.low + theta * (self.high - self.low))
        is_lcp = isinstance(problem, LCP)
        for algorithm in (
            ("auto",) if is_lcp else ("daqp", "auto")
        ):  # whose active rows are independent
            result = solve_any(problem, algorithm, {"prove_infeasibility": False})
            if result.is_solved:
                break
        else:
            return None
        z = self.data.followed(result, theta)[self.kept] / self.unit
        w = self.M @ z + self.q @ here
        case = np.zeros(z.size, dtype=np.int8)
        case[z - lower <= np.maximum(w, 0.0)] = -1
        case[(upper - z <= np.maximum(-w, 0.0)) & (case == 0)] = 1
        return case

    def law(self, case: Case) -> _Law | None:
        """Return the law of a case, None where its block of M is singular."""
        free, held = np.flatnonzero(case == 0), np.flatnonzero(case)
        z = np.zeros((case.size, self.p + 1))
        z[held] = np.where((case[held] < 0)[:, None], self.lower[held], self.upper[held])
        terms = np.abs(z).sum(axis=1)  # of each z before anything cancels, anywhere in the unit box
        if free.size:
            beside = self.M[np.ix_(free, held)]
            right = -self.q[free] - beside @ z[held]
            factor, order, _ = dgetrf(self.M[np.ix_(free, free)])
            pivots = np.abs(np.diag(factor))
            if not pivots.min() > SINGULAR * pivots.max():
                return None
            solved = dgetrs(factor, order, np.column_stack([right, np.eye(free.size)]))[0]
            z[free] = solved[:, : self.p + 1]
            acts = np.abs(self.q[free]).sum(axis=1) + np.abs(beside) @ terms[held]
            terms[free] = np.abs(solved[:, self.p + 1 :]) @ acts
        w = self.M[held] @ z + self.q[held]
        of_w = np.abs(self.M[held]) @ terms + np.abs(self.q[held]).sum(axis=1)
        low, high = (np.abs(side).sum(axis=1) for side in (self.lower, self.upper))
        sides = [
            (self.lower[free] - z[free], low[free] + terms[free], free, -1),
            (z[free] - self.upper[free], high[free] + terms[free], free, 1),
        ]
        is_single = (self.lower[held] == self.upper[held]).all(axis=1)  # its w may have either sign
        signed = np.where((case[held] < 0)[:, None], -w, w)[~is_single]
        sides.append((signed, of_w[~is_single], held[~is_single], 0))
        moving = (self.lower[held, :-1] != self.upper[held, :-1]).any(axis=1)
        apart = (self.lower[held] - self.upper[held])[moving]
        sides.append((apart, (low + high)[held][moving], np.full(len(apart), -1), 0))
        table, sizes, leaves = (np.concatenate([side[k] for side in sides]) for k in range(3))
        becomes = np.concatenate(
            [np.full(unknowns.size, to, dtype=np.int8) for _, _, unknowns, to in sides]
        )
        known = np.isfinite(table).all(axis=1)
        z = np.where(np.abs(z) <= ROUNDED * terms[:, None], 0.0, z)
        return _Law(
            case,
            z,
            table[known, :-1],
            -table[known, -1],
            sizes[known],
            leaves[known],
            becomes[known],
        )

    def polyhedron(self, law: _Law) -> Region | None:
        """Return the region of a law inside the unit box without rows that do not count; None where it is flat."""
        lengths = np.linalg.norm(law.rows, axis=1)
        size = CROSSED * law.sizes
        flat = lengths <= 1e-3 * size
        if (law.limits < -size)[flat].any():
            return None
        idle = (
            flat
            & (law.becomes == 0)
            & (law.leaves >= 0)
            & (law.leaves < self.problem.n)
            & (law.limits <= size)
        )
        if not self.is_strict and idle.any():
            more = (
                ""
                if isinstance(self.problem, LCP)
                else "; add a small quadratic term to the objective"
            )
            raise UnsuitableProblem(
                f"the solution is not unique: an unknown at its bound could leave it at no cost"
                f"{more}"
            )
        counts = ~flat & (law.limits < np.abs(law.rows).sum(axis=1))  # others hold in the whole box
        rows, limits = (
            law.rows[counts] / lengths[counts, None],
            law.limits[counts] / lengths[counts],
        )
        eye = np.eye(self.p)
        rows, limits = (
            np.concatenate([rows, eye, -eye]),
            np.concatenate([limits, np.ones(self.p), np.zeros(self.p)]),
        )
        leaves = np.concatenate([law.leaves[counts], np.full(2 * self.p, -1)])
        becomes = np.concatenate([law.becomes[counts], np.zeros(2 * self.p, dtype=np.int8)])
        inside = _centre(rows, limits)
        if inside is None:
            return None
        facets, vertices = _facets(rows, limits, inside)
        if not facets:
            return None
        kept = [k for k, _ in facets]
        return Region(
            rows[kept],
            limits[kept],
            vertices,
            inside,
            law.case,
            self.unit[:, None] * law.z,
            tuple((int(leaves[k]), int(becomes[k]), middle) for k, middle in facets),
        )

    def explored(self, most: int) -> tuple[list[Region], int]:
        """Return all regions that are reached, and behind how many facets neither one nor a border was found."""
        found: dict[bytes, Region] = {}
        missed: list[FloatVector] = []
        waiting = list(self._first())
        for region in waiting:
            found[region.case.tobytes()] = region
        while waiting and len(found) < most:
            region = waiting.pop()
            for (unknown, to, middle), row in zip(region.facets, region.rows, strict=True):
                if unknown < 0:
                    continue
                point = middle + BEHIND * row
                if point.min() < 0.0 or point.max() > 1.0:
                    continue  # where a case ends at the box
                other = region.case.copy()
                other[unknown] = to
                beside = found.get(other.tobytes()) or self._region(other)
                if beside is None or not beside.holds(middle):
                    further = middle + CLEARLY_BEHIND * row
                    is_known = any(one.holds(point) for one in found.values())
                    case = None if is_known else self.solved(further)
                    if case is None:  # or nothing is feasible there
                        continue
                    beside = self._region(case)
                    if beside is None or not (beside.holds(point) or beside.holds(further)):
                        missed.append(further)
                        continue
                if beside.case.tobytes() not in found and len(found) < most:
                    found[beside.case.tobytes()] = beside
                    waiting.append(beside)
        every = list(found.values())
        return every, sum(not any(one.holds(point) for one in every) for point in missed) + (
            len(found) >= most
        )

    def _first(self) -> Iterator[Region]:
        """Yield a region to begin in: of the middle of the box, else of points drawn in it."""
        random = np.random.default_rng(0)
        for point in [
            np.full(self.p, 0.5) + 1e-3 * random.standard_normal(self.p),
            *random.random((64, self.p)),
        ]:
            case = self.solved(point)
            if case is not None and (region := self._region(case)) is not None:
                yield region
                return

    def _region(self, case: Case) -> Region | None:
        law = self.law(case)
        return None if law is None else self.polyhedron(law)


def _is_definite(program: QuadraticProgram) -> bool:
    """Return whether P is positive definite, as it seems in doubles."""
    P = program.P.toarray() if hasattr(program.P, "toarray") else np.asarray(program.P)
    return bool(program.n) and dpotrf(P)[1] == 0


def _is_p_matrix(problem: LCP) -> bool:
    """Return whether M is proved to be a P-matrix, so that z is unique; raise where it is proved to be none."""
    from ...proofs.verdicts import analyze

    verdict = analyze(problem).is_p_matrix
    if verdict is False:
        raise UnsuitableProblem(
            "M is no P-matrix, so that z is not unique for some q; all_solutions(problem) lists "
            "those of one q, trace follows one of them"
        )
    return bool(verdict)


def _independent(program: QuadraticProgram, b: FloatVector) -> Any:
    """Return the numbers of equations that do not follow from others."""
    A = program.A.toarray() if hasattr(program.A, "toarray") else np.asarray(program.A)
    if not len(A):
        return np.arange(0)
    whole = np.column_stack([A, b])
    lengths = np.linalg.norm(A, axis=1)
    even = whole / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    ranks, orders = [], []
    for rows in (even[:, : program.n], even):
        R, order = qr(rows.T, mode="r", pivoting=True)
        pivots = np.abs(np.diag(R[: min(rows.shape)]))
        ranks.append(int((pivots > 1e-12 * max(pivots.max(initial=0.0), 1e-300)).sum()))
        orders.append(order)
    if ranks[1] > ranks[0]:
        raise UnsuitableProblem(
            "equations depend on each other, and their right-hand sides do not for every θ; leave "
            "out what follows from others"
        )
    return np.sort(orders[0][: ranks[0]])


def _centre(rows: FloatVector, limits: FloatVector) -> FloatVector | None:
    """Return the centre of the largest ball inside; None where there is none of a radius that counts."""
    p = rows.shape[1]
    found = linprog(
        np.append(np.zeros(p), -1.0),
        np.column_stack([rows, np.ones(len(rows))]),
        limits,
        bounds=[(None, None)] * p + [(None, 1.0)],
        method="highs",
    )
    if found.x is None or found.x[-1] <= FLAT:
        return None
    centre: FloatVector = found.x[:-1]
    return centre


def _facets(
    rows: FloatVector, limits: FloatVector, inside: FloatVector
) -> tuple[list[tuple[int, FloatVector]], FloatVector]:
    """Return the rows that bound the polyhedron, each with the middle of its facet, and all vertices."""
    if rows.shape[1] == 1:
        ends = limits / rows[:, 0]
        high, low = (
            np.where(rows[:, 0] > 0, ends, np.inf).argmin(),
            np.where(rows[:, 0] < 0, ends, -np.inf).argmax(),
        )
        facets = [(int(k), ends[[k]]) for k in (low, high)]
        return facets, np.array([ends[[low]], ends[[high]]])
    try:
        hull = HalfspaceIntersection(np.column_stack([rows, -limits]), inside)
    except QhullError:
        return [], np.empty((0, rows.shape[1]))
    vertices = hull.intersections
    touching: dict[int, list[int]] = {}
    for k, tied in enumerate(hull.dual_facets):
        for row in tied:
            touching.setdefault(int(row), []).append(k)
    facets = []
    for row, own in sorted(touching.items()):
        corners = vertices[own]
        if len(own) >= rows.shape[1] and np.ptp(corners, axis=0).max() > FLAT:
            facets.append((row, corners.mean(axis=0)))
    return facets, vertices


def _box(within: Any) -> tuple[FloatVector, FloatVector]:
    """Return the corners of the box, or raise InvalidOption."""
    try:
        low, high = (np.atleast_1d(np.asarray(end, dtype=float)) for end in within)
        fits = low.shape == high.shape and low.ndim == 1 and bool(np.all(low < high))
    except (TypeError, ValueError):
        fits = False
    if not fits or not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise InvalidOption(
            f"within must be (low, high), the corners of a box of finite numbers, low < high, got "
            f"{within!r}"
        )
    if low.size > MOST_PARAMETERS:
        raise InvalidOption(
            f"regions takes up to {MOST_PARAMETERS} parameters, got {low.size}; trace follows one of "
            "them"
        )
    return low, high
