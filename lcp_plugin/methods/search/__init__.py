"""Exhaustive search for small problems: every solution exactly, or the proof that there is none.

As stages of a run, the search and a test of feasibility end with a solution or with a proof.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

import numpy as np

from ...core.algorithm import Algorithm, Step
from ...core.checks import Vector
from ...core.entries import unbounded
from ...core.errors import InvalidProblem, UnsuitableProblem
from ...core.lcp import LCP
from ...core.problem_classes import refusal
from ...core.settings import whole_number
from ...core.tuning import LINEAR_PROGRAM_UP_TO
from ...proofs.exact import exact_slack
from ...proofs.no_solution import NoSolution, find_infeasibility
from .explorer import Explorer, Face, Point, extreme_points
from .simplex import QUANTUM, Effort

LARGEST_CHOICES = 24  # rows with more than one choice
MOST_SEARCHED = 60  # rows of an exhaustive search
DEFAULT_NODES = 200_000  # of a search that the caller does not limit


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution, or vertex of a face of solutions.

    Attributes
    ----------
    z, w : ndarray, shape (n,)
        Rounded to double precision, each entry by itself. An entry beyond the largest double raises UnsuitableProblem;
        read `exact_z` then.
    exact_z, exact_w : tuple of Fraction, shape (n,)
        The solution of the problem that the stored doubles state.
    pattern : tuple of str, shape (n,)
        The choice of every row: "lower" (z at its bound, w ≥ 0), "zero" (w = 0), "upper", "fixed" (lower = upper).
    dimension : int
        Dimension of the face of all solutions with this pattern; 0 is an isolated solution.
    problem : LCP
    """

    exact_z: tuple[Fraction, ...]
    exact_w: tuple[Fraction, ...] = field(repr=False)
    pattern: tuple[str, ...] = field(repr=False)
    dimension: int
    problem: LCP = field(repr=False)

    @cached_property
    def exact_vertices(self) -> tuple[Point, ...]:
        """Vertices of the face in lexicographic order, computed on first access; each is a solution.

        Empty if the face contains a line. An unbounded face is larger than the convex hull of its vertices.
        """
        return tuple(sorted(extreme_points(self.problem, self.pattern)))

    @property
    def vertices(self) -> Vector:
        """The vertices of the face in double precision, shape (number of vertices, n)."""
        rounded = [_in_doubles(vertex, "z") for vertex in self.exact_vertices]
        return np.array(rounded).reshape(len(rounded), self.problem.n)

    @property
    def z(self) -> Vector:
        """The solution in double precision, shape (n,)."""
        return _in_doubles(self.exact_z, "z")

    @property
    def w(self) -> Vector:
        """Slack in double precision, shape (n,)."""
        return _in_doubles(self.exact_w, "w")

    @property
    def is_isolated(self) -> bool:
        """True if no other solution is nearby; False for a vertex of a continuum."""
        return self.dimension == 0

    def __str__(self) -> str:
        point = f"z = ({', '.join(map(str, self.exact_z))})"
        if self.is_isolated:
            return f"{point}, isolated"
        if next(extreme_points(self.problem, self.pattern), None) is None:
            return f"{point}, on a face of dimension {self.dimension} that contains a line"
        return f"{point}, a vertex of a face of dimension {self.dimension}"


def search(
    problem: LCP, *, first_only: bool = True, max_nodes: int = DEFAULT_NODES
) -> list[Solution] | NoSolution | None:
    """Return a solution (or all), the proof that there is none, or None if the limit was too low.

    Parameters
    ----------
    first_only : bool
        Stop at the first solution, which may be any point of the solution set; `dimension` then refers to its pattern.
    max_nodes : int
        Limit of the number of complementarity pieces; a piece costs about a millisecond at n = 10, more with long
        mantissas.

    Raises
    ------
    UnsuitableProblem
        If more than 24 rows have several complementarity pieces, or n exceeds 60.

    Examples
    --------
    A feasible problem without solution:

    >>> proof = search(LCP([[1, -2, 1], [-3, 2, -2], [1, -2, 0]], [-1, 2, 2]))
    >>> print(proof)
    no solution: each of the 6 cases of an exhaustive search contradicts, exactly
    >>> proof.verify()
    True
    """
    limit, effort = whole_number(max_nodes, "max_nodes", 1), Effort()
    for outcome in explore(problem, effort, first_only=first_only):
        if outcome is not None:
            return outcome
        if effort.cases > limit:
            break
    return None


def explore(
    problem: LCP, effort: Effort, *, first_only: bool = True
) -> Iterator[list[Solution] | NoSolution | None]:
    """Yield None after each case, then the result of `search`; `effort` counts the work."""
    if not isinstance(problem, LCP):
        raise InvalidProblem(refusal("all_solutions", problem))
    if not is_searchable(problem):
        raise UnsuitableProblem(
            f"the search takes at most {LARGEST_CHOICES} rows with several pieces and n ≤ {MOST_SEARCHED}, "
            f"got {_count_choices(problem)} and n = {problem.n}; solve(problem) looks for one solution"
        )
    explorer = Explorer(problem, effort, first_only=first_only)
    for _ in explorer.run():
        yield None
    if explorer.faces:
        yield [
            Solution(tuple(z), tuple(exact_slack(problem, z)), pattern, dimension, problem)
            for pattern, _, z, dimension in _maximal(explorer.faces)
        ]
    elif not first_only:
        # A search for all solutions skips pieces contained in others; the proof must not.
        yield from explore(problem, effort)
    else:
        yield NoSolution(problem, explorer.tree, explorer.nodes)


@np.errstate(all="ignore")
def all_solutions(problem: LCP, *, max_nodes: int = DEFAULT_NODES) -> list[Solution]:
    """Return all solutions of a small problem, exactly; a continuum of solutions by its faces.

    Parameters
    ----------
    problem : LCP
        At most 24 rows with several complementarity pieces, n at most 60.
    max_nodes : int
        Limit of the number of complementarity pieces.

    Returns
    -------
    list of Solution
        In lexicographic order of z. Empty if no solution exists; `search` returns the proof. A face is listed if no
        larger face contains it, and z is one of its vertices, if it has any. ``solution.vertices`` has all, and
        faces may share vertices.

    Raises
    ------
    UnsuitableProblem
        If the problem is too large, or needs more than `max_nodes` pieces.
    InvalidProblem, InvalidOption
        If `problem` is not an LCP; if `max_nodes` is not an integer ≥ 1.

    Notes
    -----
    Branch and bound over z_i = lower_i, w_i = 0, z_i = upper_i by an exact simplex method. The stored doubles are
    the data: a payoff of 0.1 is the double nearest to it.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.3.

    Examples
    --------
    >>> for solution in all_solutions(LCP([[0, 2], [1, 0]], [-1, -1])):
    ...     print(solution)
    z = (1, 1/2), isolated
    >>> (face,) = all_solutions(LCP([[1, 1], [1, 1]], [-2, -2]))
    >>> print(face)
    z = (2, 0), a vertex of a face of dimension 1
    """
    outcome = search(problem, first_only=False, max_nodes=max_nodes)
    if outcome is None:
        raise UnsuitableProblem(
            f"the search did not end within max_nodes={max_nodes} pieces; raise max_nodes, or compute one "
            "solution with solve(problem)"
        )
    return [] if isinstance(outcome, NoSolution) else outcome


def _maximal(faces: Sequence[Face]) -> list[Face]:
    """Return the maximal faces, in lexicographic order of their vertices."""
    kept: list[Face] = []
    for face in sorted(faces, key=lambda face: (-face.dimension, face.point, face.pattern)):
        if not any(face.lies_in(other) for other in kept):
            kept.append(face)
    return sorted(kept, key=lambda face: (face.point, face.pattern))


def _in_doubles(values: Sequence[Fraction], name: str) -> Vector:
    """Return the values rounded one by one; raise an error that names the first value beyond the largest double."""
    rounded = np.zeros(len(values))
    for i, value in enumerate(values):
        try:
            rounded[i] = float(value)
        except OverflowError:
            exponent = abs(value.numerator).bit_length() - value.denominator.bit_length()
            raise UnsuitableProblem(
                f"{name}[{i}] of the exact solution is about 2^{exponent}, beyond the largest double; use "
                f"exact_{name}, or rescale the problem"
            ) from None
    return rounded


def is_searchable(problem: LCP) -> bool:
    """Return whether the problem is small enough for a search."""
    return _count_choices(problem) <= LARGEST_CHOICES and problem.n <= MOST_SEARCHED


def has_few_active_sets(problem: LCP) -> bool:
    """Return whether a search is likely to end before restarts of other methods: at most 4096 active sets, n ≤ 24."""
    bounds = 1 + (problem.lower > -np.inf) + (problem.upper < np.inf)
    count = np.prod(np.where(problem.lower < problem.upper, bounds, 1), dtype=np.float64)
    # The search takes milliseconds, at most a quarter of a second
    return problem.n <= 24 and bool(count <= 4096)


def _count_choices(problem: LCP) -> int:
    """Return the number of rows with more than one branch."""
    is_free = unbounded(problem.lower, problem.upper)
    return int(np.count_nonzero(~is_free & (problem.lower < problem.upper)))


MOST_PRODUCTS = 300 * QUANTUM  # some seconds


@dataclass(frozen=True, kw_only=True)
class FeasibilityCheck(Algorithm):
    """Looks for a proof that no z satisfies the linear inequalities."""

    name: ClassVar[str] = "feasibility"
    is_monotone: ClassVar[bool] = False

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the start, then the start again with each new proof."""
        yield Step(z0, work=0.0)
        effort = None if problem.n <= LINEAR_PROGRAM_UP_TO else 0
        proof = find_infeasibility(problem, effort_limit=effort)
        if proof is not None:
            yield Step(z0, proof=proof)


@dataclass(frozen=True, kw_only=True)
class ExhaustiveSearch(Algorithm):
    """Branch and bound over z_i = bound, w_i = 0 in exact arithmetic (Cottle, Pang, Stone, §1.3).

    n ≤ 60, at most 24 rows with several pieces. A step is at most 50 cases, each an exact linear program.
    """

    name: ClassVar[str] = "search"
    is_monotone: ClassVar[bool] = False

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield z0 during the search, then the solution, or z0 with the proof; end if that takes too much."""
        yield Step(z0, work=0.0)
        effort, reported = Effort(), Effort()
        for outcome in explore(problem, effort):
            cases, products = effort.cases - reported.cases, effort.products - reported.products
            if outcome is None and cases < 50 and products < QUANTUM:
                continue
            step = Step(z0, work=(effort.entries - reported.entries) / max(problem.nonzeros, 1))
            reported = replace(effort)
            if isinstance(outcome, list):
                try:
                    step.z = np.clip(outcome[0].z, problem.lower, problem.upper)
                except UnsuitableProblem as error:
                    step.remark = f"an enumeration of all active sets found a solution, but {error}"
            elif isinstance(outcome, NoSolution):
                step.proof = outcome.infeasibility or outcome
            elif effort.cases >= 20_000 or effort.products >= MOST_PRODUCTS:
                step.remark = f"undecided after {effort.cases} cases; all_solutions goes on"
            yield step
            if step.remark:
                return
