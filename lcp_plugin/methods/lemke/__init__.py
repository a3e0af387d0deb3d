"""Lemke's method: complementary pivoting for dense box and mixed problems of any matrix class."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core import deadline
from ...core.algorithm import Algorithm, Step
from ...core.checks import Vector
from ...core.errors import UnsuitableProblem
from ...core.lcp import LCP
from ...core.settings import whole_number
from ...core.structure import connected_components
from ...core.tuning import PIVOTED_UP_TO
from ...judges.certificate import Certificate
from ...systems.graph import block_rows
from ..newton import classify, is_near, solve_active_set
from ..small import LOOP_UP_TO, has_numba, path_steps
from .pivoting_path import CanonicalBox, LemkePath, canonical_box, starts
from .tableau import AT_LOWER, AT_UPPER, BETWEEN, GOING_ON, RAY, SOLVED


@dataclass(frozen=True, kw_only=True)
class Lemke(Algorithm):
    """Complementary pivoting (Lemke) along w = M z + q + t r from several starts, bounds and free rows included.

    Parameters
    ----------
    max_pivots : int, optional
        Pivots of one path; 10 (n + 10) by default and, once every start was tried, 100 (n + 10) for the paths cut off.
        `auto` sets few for its first attempt.
    restarts : int, optional
        Arbitrary starts after the principled ones: every label of a bimatrix game (Lemke–Howson), r = 1 and
        r = |q| of the equilibrated problem; 20 000/n by default, but 10 to 600. An
        arbitrary start lies inside a random active set. `auto` sets 0 before other methods, Newton's steps set 2.

    Notes
    -----
    If the caller names it without options, kernels follow the first path on at most 128 unknowns.
    The path is followed on 0 ≤ z ≤ u: an upper bound is a bound of the variables, not a row. Free rows are
    eliminated, if necessary together with rows that have one bound, of which z and w then change places. A free row
    that belongs to no well-conditioned block becomes two nonnegative variables. The active set of z0 is tried first, by
    one factorization: after a small change of q it is often right; otherwise z0 has no effect. Connected components of
    the problem are solved one by one. The path belongs to a q with a perturbation at rounding level, which breaks
    ties; a path from an arbitrary start may be a loop. A path from r > 0 ends in a solution if M is a P-matrix or all
    bounds are finite, and for a feasible problem with a copositive-plus M, for example a positive semidefinite M.

    Examples
    --------
    A bimatrix game, which has no path from r > 0:

    >>> problem = LCP([[0, 0, 1, 2], [0, 0, 2, 1], [2, 1, 0, 0], [1, 2, 0, 0]], [-1, -1, -1, -1])
    >>> *_, last = Lemke().iterates(problem, np.zeros(4))
    >>> bool(Certificate.of(problem, last.z).relative_residual < 1e-14)
    True
    """

    name: ClassVar[str] = "lemke"
    needs: ClassVar[str] = "n up to a few thousand"
    solves: ClassVar[str] = "P, copositive-plus (PSD) if feasible, finite boxes"
    cost: ClassVar[str] = "O(n²) a pivot, a block of pivots a step"
    reference: ClassVar[str] = (
        "Lemke 1965, doi:10.1287/mnsc.11.7.681; Cao, Ferris 1996, doi:10.1287/moor.21.2.484"
    )
    is_monotone: ClassVar[bool] = False
    ends_on_active_set: ClassVar[bool] = True

    max_pivots: int | None = None
    restarts: int | None = None

    def __post_init__(self) -> None:
        for option, value in (("max_pivots", self.max_pivots), ("restarts", self.restarts)):
            if value is not None:
                whole_number(value, f"lemke: {option}", 0)

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the start, then the z of the path after each block of pivots, last the solution, if any.

        Raises
        ------
        UnsuitableProblem
            If a connected component is too large for a dense inverse.
        """
        components = _components_that_fit(problem)
        z = z0.copy()
        yield Step(z, work=0.0)
        entries = max(problem.nonzeros, 1)
        for rows in components:
            component = problem
            if rows.size < problem.n:
                M = sp.csr_array(problem.csr[rows][:, rows])
                bounds = {"lower": problem.lower[rows], "upper": problem.upper[rows]}
                component = LCP(M, problem.q[rows], **bounds)
            for end, touched in self._paths(component, z[rows]):
                z[rows] = np.clip(end, component.lower, component.upper)
                yield Step(z, work=touched / entries, is_settling=True)

    def first_points(self, problem: LCP, z0: Vector, tolerance: float) -> Iterator[Step] | None:
        """Return the points of the compiled path on at most 128 unknowns, unless options are set."""
        is_default = self.max_pivots is None and self.restarts is None
        is_short = is_default and 0 < problem.n <= LOOP_UP_TO and has_numba()
        return path_steps(problem, tolerance, z0) if is_short else None

    def theorem(self, problem: LCP, report: Any) -> str | None:
        """Return the reason that no path from r > 0 can end on a ray: M is a P-matrix, or all bounds are finite."""
        _components_that_fit(problem)
        if np.isfinite(problem.lower).all() and np.isfinite(problem.upper).all():
            reason = "all bounds are finite"
        elif report.is_p_matrix is True:
            reason = "M is a P-matrix"
        else:
            return None
        limit = "100 (n + 10)" if self.max_pivots is None else str(self.max_pivots)
        return f"{reason}: no path ends on a ray (Lemke 1965), if {limit} pivots suffice"

    def _paths(self, component: LCP, guess: Vector) -> Iterator[tuple[Vector, float]]:
        """Yield (z, entries touched) along successive paths until a path ends in a solution."""
        # test the active set of the start first: one factorization
        if not np.array_equal(guess, component.nearest_to_zero):
            at_lower, at_upper = guess <= component.lower, guess >= component.upper
            if is_near(component, guess):  # z may miss its bounds by rounding
                at_lower, at_upper = classify(component, guess, component.slack(guess))
            solution = solve_active_set(component, at_lower, at_upper & ~at_lower)
            if solution is not None:
                yield solution.z, solution.work * max(component.nonzeros, 1)
                if _is_good(component, np.clip(solution.z, component.lower, component.upper)):
                    return
        box = canonical_box(component)
        # the tableau overflows, so that its path cannot reach a solution in double precision
        if not box.is_finite:
            return
        path = LemkePath(box.M, box.q, box.upper)
        path.entries += box.work
        if not np.any(box.q < 0.0):
            yield from self._solution(component, box, path)
            return
        restarts = self.restarts
        if restarts is None:
            restarts = int(np.clip(20_000 // path.n, 10, 600))
            # With w_i < 0 for every z no path can end in a solution
            is_negative = (box.q < 0.0) & (box.upper == np.inf) & ~(box.M > 0.0).any(axis=1)
            restarts *= not is_negative.any()
        waiting: Any = starts(path, restarts)
        # Pivots of a round, times n + 10.
        rounds = (10, 100) if self.max_pivots is None else (0,)
        for multiple in rounds:
            limit = multiple * (path.n + 10) if self.max_pivots is None else self.max_pivots
            cut_off = []
            for start in waiting:
                if deadline.is_over():
                    return
                is_solved = yield from self._follow(component, box, path, start, limit)
                if is_solved:
                    return
                if path.pivots >= limit:
                    cut_off.append(start)
            waiting = cut_off

    def _follow(self, component: LCP, box: CanonicalBox, path: Any, start: Any, limit: int) -> Any:
        """Yield along one path; return whether it ended in a certified solution."""
        # About so many entries are touched between two steps.
        block = min(path.fresh_for, int(np.clip(5e7 / max(path.n, 1) ** 2, 32, 200)))
        outcome = GOING_ON if start(path) else RAY
        while outcome == GOING_ON and path.pivots < limit:
            outcome = path.advance(min(block, limit - path.pivots))
            if outcome == SOLVED:
                return (yield from self._solution(component, box, path))
            # A point of a path is measured after a millisecond of pivots
            if path.entries - path.reported >= 5e5:
                yield box.recover(path.z), path.touched()
        return False

    def _solution(self, component: LCP, box: CanonicalBox, path: LemkePath) -> Any:
        """Yield the end of a path, first solved again on the unscaled problem; return whether a point passes."""
        z = np.clip(box.recover(path.z), component.lower, component.upper)
        bounded = (component.lower > -np.inf) | (component.upper < np.inf)
        at_lower = component.lower == component.upper
        at_upper = np.zeros(component.n, dtype=bool)
        is_near = path.side == np.where(box.step == 0.0, BETWEEN, AT_LOWER)
        is_flipped = component.lower[box.rows] == -np.inf
        at_lower[box.rows] |= is_near & ~is_flipped
        at_upper[box.rows] |= np.where(is_flipped, is_near, path.side == AT_UPPER)
        at_lower, at_upper = at_lower & bounded, at_upper & bounded & ~at_lower
        # A free row of two nonnegative variables that are both 0 is dependent
        dependent = ~bounded & (np.bincount(box.rows, is_near, component.n) == 2)
        vertex = component
        if dependent.any():
            lower = np.where(dependent, 0.0, component.lower)
            vertex = LCP(component.matrix, component.q, lower=lower, upper=component.upper)
        is_right, at_lower = False, at_lower | dependent
        # The path leaves out what is below its perturbation
        for _ in range(1 + bool(bounded.all())):
            refined = solve_active_set(vertex, at_lower, at_upper)
            if refined is None:
                break
            polished = np.clip(refined.z, component.lower, component.upper)
            # The run ends here if the point of the only component passes.
            yield polished, path.touched() + refined.work * max(component.nonzeros, 1)
            is_right = _is_good(component, polished)
            at_lower, at_upper = classify(component, polished, component.slack(polished))
        if is_right:
            return True
        yield z, path.touched()
        return _is_good(component, z)


def _components_that_fit(problem: LCP) -> list[NDArray[np.intp]]:
    """Return the connected components; raise UnsuitableProblem if a component is too large for a dense inverse."""
    components = rows_of_components(problem)
    size = max((rows.size for rows in components), default=0)
    if size > PIVOTED_UP_TO:
        raise UnsuitableProblem(
            f"lemke keeps a dense inverse and takes connected components up to n = {PIVOTED_UP_TO}, got one of {size}; "
            'try algorithm="auto"'
        )
    return components


def rows_of_components(problem: LCP) -> list[NDArray[np.intp]]:
    """Return the rows of each connected component of M, in the order of their first rows."""
    labels = connected_components(problem.matrix)
    if labels is None:
        return [np.arange(problem.n)] if problem.n else []
    return block_rows(labels)


def _is_good(problem: LCP, z: Vector) -> bool:
    certificate = Certificate.of(problem, z)
    relative = certificate.relative_residual
    return relative <= 1e-10 or (relative <= 1e-4 and certificate.is_at_rounding_level)
