"""Branch and bound over the choices of every row, by an exact simplex method, and extreme points of the solutions.

All arithmetic is exact.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import NamedTuple

from ...core.lcp import LCP
from ...proofs.exact import integer_matrix, slack_bounds
from ...proofs.no_solution import FIXED, LOWER, SLACKLESS, UPPER, Case, row_choices
from .simplex import Bound, Effort, ExactSimplex

Point = tuple[Fraction, ...]
Choice = tuple[str, Bound, Bound]  # a choice, and the bounds of its basic variable
Closed = dict[tuple[int, str], list[Fraction]]  # excluded choices of rows, each with its proof


class Face(NamedTuple):
    """Polyhedron of the solutions of one pattern of choices, with one vertex.

    `tight[i]` holds all choices of row i that every point of it satisfies.
    """

    pattern: tuple[str, ...]
    tight: tuple[frozenset[str], ...]
    point: list[Fraction]
    dimension: int

    def lies_in(self, other: Face) -> bool:
        """Return whether every point of this face satisfies the pattern of the other face."""
        return all(choice in tight for choice, tight in zip(other.pattern, self.tight, strict=True))


class Explorer:
    """Depth-first search that ends with the faces of solutions or, if no face exists, with the tree that proves this.

    It is one class because each choice is made, examined and undone on one simplex table.
    """

    def __init__(self, problem: LCP, effort: Effort, *, first_only: bool) -> None:
        self.problem, self.effort = problem, effort
        self.first_only = first_only
        self.n = problem.n
        self.choices = list(map(row_choices, problem.lower.tolist(), problem.upper.tolist()))
        data = integer_matrix(problem.matrix), problem.q, (problem.lower, problem.upper)
        self.simplex = ExactSimplex(*data, slack_bounds(problem), effort)
        self.root_bounds = [self.simplex.bounds(x) for x in range(2 * self.n)]
        self.weights = [max(map(abs, row[:-1]), default=0) or 1 for row in self.simplex.rows]
        self.faces: list[Face] = []
        self.tree = Case()
        self.nodes = 0
        self.path: list[tuple[int, str]] = []

    def run(self) -> Iterator[None]:
        """Visit the complementarity pieces until the search ends; yield after each piece.

        A face may have been added to `faces`. Choices that were made before hold in all pieces.
        """
        self.simplex.solve_equations()
        stack = [(len(self.path), -1, "", self.tree)]
        while stack:
            depth, row, choice, case = stack.pop()
            while len(self.path) > depth:
                i, _ = self.path.pop()
                for x in (i, self.n + i):
                    self.simplex.set_bounds(x, *self.root_bounds[x])
            if row >= 0:
                self.choose(row, choice)
            branches, depth = self._examined(case), len(self.path)
            stack += [(depth, case.row, name, case.branches[name]) for name in reversed(branches)]
            self.nodes += 1
            self.effort.cases += 1
            yield
            if self.first_only and self.faces:
                return

    def _examined(self, case: Case) -> list[str]:
        """Close the piece, record its face, or split it; return the branches to visit."""
        case.y = self.simplex.infeasibility_proof()
        if case.y is not None:
            return []
        decided = {i for i, _ in self.path}
        undecided = [i for i in range(self.n) if i not in decided and len(self.choices[i]) > 1]
        closed, implied = self._conclusions()
        case.row, is_solution = self._row_to_split(undecided, closed, implied)
        if is_solution and (self.first_only or case.row < 0):
            self._record(undecided)
            return []
        i = case.row
        for choice in self.choices[i]:
            case.branches[choice] = Case(y=closed.get((i, choice)))
        if not self.first_only and i in implied:
            return [implied[i]]  # every other choice describes a part of this one
        return [choice for choice in self.choices[i] if (i, choice) not in closed]

    def _conclusions(self) -> tuple[Closed, dict[int, str]]:
        """Return the choices that a row of the tableau excludes, each with its proof, and choices that always hold."""
        simplex, n = self.simplex, self.n
        closed, implied = Closed(), dict[int, str]()
        for row, x in enumerate(simplex.basic):
            low, high = simplex.implied_range(row)
            if low is None and high is None:
                continue
            i, d = x % n, simplex.denominator
            targets: list[Choice] = [(LOWER, 0, None), (SLACKLESS, 0, 0), (UPPER, None, 0)]
            if x < n:
                (bottom, top) = self.root_bounds[x]
                targets = [(LOWER, bottom, bottom), (UPPER, top, top)]
            for choice, lowest, highest in targets:
                if choice not in self.choices[i]:
                    continue
                if lowest is not None and high is not None and high < lowest * d:
                    closed.setdefault((i, choice), simplex.farkas(row, 1))
                elif highest is not None and low is not None and low > highest * d:
                    closed.setdefault((i, choice), simplex.farkas(row, -1))
                elif lowest is not None and lowest == highest:
                    # Do row and bounds determine the value of this basic variable?
                    value, (least, most) = lowest * d, simplex.bounds(x)
                    if (low == value or least == lowest) and (high == value or most == lowest):
                        implied.setdefault(i, choice)
        return closed, implied

    def _row_to_split(
        self, undecided: list[int], closed: Closed, implied: dict[int, str]
    ) -> tuple[int, bool]:
        """Return the row to split (−1 if no row remains), and whether the present point solves the problem."""
        values = self.simplex.numerators()
        best, worst = -1, 0
        for i in undecided:
            size = self._violation(i, values)
            if size > worst:
                best, worst = i, size
        is_solution = best < 0
        if is_solution and self.first_only:
            return -1, True
        for i in undecided:
            if i in implied or sum((i, choice) not in closed for choice in self.choices[i]) <= 1:
                return i, is_solution
        return (undecided[0] if is_solution and undecided else best), is_solution

    def _violation(self, i: int, values: list[int]) -> int:
        z, w, d = values[i], values[self.n + i], self.simplex.denominator
        bottom, top = self.root_bounds[i]
        bound = bottom if w > 0 else top
        gap = abs(z - bound * d) if bound is not None else 0
        return gap * abs(w) // self.weights[i] + (gap != 0 and w != 0)

    def choose(self, i: int, choice: str) -> None:
        """Fix a choice of row i, one level deeper in the tree."""
        self.path.append((i, choice))
        bottom, top = self.root_bounds[i]
        if choice == SLACKLESS:
            self.simplex.set_bounds(self.n + i, 0, 0)
        elif choice == LOWER:
            self.simplex.set_bounds(i, bottom, bottom)
            self.simplex.set_bounds(self.n + i, 0, None)
        else:
            self.simplex.set_bounds(i, top, top)
            self.simplex.set_bounds(self.n + i, None, 0)

    def _record(self, undecided: list[int]) -> None:
        """Add the face of the present pattern; undecided rows take the choices that the point satisfies."""
        for i in undecided:
            w = self.simplex.numerators()[self.n + i]
            self.choose(i, SLACKLESS if w == 0 else LOWER if w > 0 else UPPER)
        simplex = self.simplex
        simplex.infeasibility_proof()
        simplex.go_to_vertex()
        pattern = dict(self.path)
        complete = tuple(pattern.get(i, self.choices[i][0]) for i in range(self.n))
        point = simplex.point()
        before = [simplex.bounds(x) for x in range(2 * self.n)]
        is_point = simplex.release_fixed() == 0
        tight = tuple(self._tight(i, choice, is_point) for i, choice in enumerate(complete))
        dimension = simplex.release_fixed()
        for x, bounds in enumerate(before):
            simplex.set_bounds(x, *bounds)
        self.faces.append(Face(complete, tight, point, dimension))

    def _tight(self, i: int, choice: str, is_point: bool) -> frozenset[str]:
        """Return the choices of row i that hold at every point of the face, and fix their variables."""
        if choice == FIXED or len(self.choices[i]) == 1:
            return frozenset(self.choices[i])
        if choice == SLACKLESS:
            bottom, top = self.root_bounds[i]
            others: list[tuple[str, int, Bound, int]] = [(LOWER, i, bottom, 1), (UPPER, i, top, -1)]
        else:
            others = [(SLACKLESS, self.n + i, 0, 1 if choice == LOWER else -1)]
        tight = [choice]
        for other, x, at, direction in others:
            if at is None or self.simplex.position(x) != at:
                continue
            if is_point or not self.simplex.can_leave(x, direction):
                self.simplex.set_bounds(x, at, at)
                tight.append(other)
        return frozenset(tight)


def extreme_points(problem: LCP, pattern: Sequence[str]) -> Iterator[Point]:
    """Yield the extreme points of all solutions of a pattern, each once; the set has none if it contains a line.

    Parameters
    ----------
    problem : LCP
    pattern : sequence of str, shape (n,)
        Choice of every row, as in the pattern of a ``Solution``.

    Notes
    -----
    The search turns bounds into equalities in order, if an equality lowers the dimension of the remaining face. A face
    of dimension 0 is an extreme point. The first independent active bounds of every extreme point lead to this point.
    """
    explorer = Explorer(problem, Effort(), first_only=False)
    simplex = explorer.simplex
    simplex.solve_equations()
    for i, choice in enumerate(pattern):
        if len(explorer.choices[i]) > 1:
            explorer.choose(i, choice)
    if simplex.infeasibility_proof() is None:
        ends = ((x, at) for x in range(2 * problem.n) for at in set(simplex.bounds(x)))
        bounds, known = sorted((x, at) for x, at in ends if at is not None), set()
        for point in _corners(simplex, bounds, 0):
            if point not in known:
                known.add(point)
                yield point


def _corners(simplex: ExactSimplex, bounds: list[tuple[int, int]], first: int) -> Iterator[Point]:
    """Yield the points that remain when some of the bounds, from number `first` on, become equalities."""
    dimension = simplex.release_fixed()
    if dimension == 0:
        yield tuple(simplex.point())
        return
    for k in range(first, len(bounds)):
        x, at = bounds[k]
        before = simplex.bounds(x)
        if before == (at, at):
            continue
        simplex.set_bounds(x, at, at)
        if simplex.infeasibility_proof() is None and simplex.release_fixed() < dimension:
            yield from _corners(simplex, bounds, k + 1)
        simplex.set_bounds(x, *before)
        simplex.infeasibility_proof()
