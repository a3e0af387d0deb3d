"""Proof that a problem has no solution: a tree of cases, each closed by a Farkas vector of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from ..problem.lcp import LCP
from .infeasibility import Infeasibility
from .refutation import Closing, Refutation, closed_exactly, row_choices


@dataclass(slots=True)
class Case:
    """One case of the tree: split by the choices of a row, or closed by a Farkas vector y."""

    row: int = -1
    branches: dict[str, Case] = field(default_factory=dict)
    y: list[Fraction] | None = None


@dataclass(frozen=True, eq=False)
class NoSolution(Refutation):
    """No z solves the problem: every case of a complete tree contradicts, exactly; `margin` says by how much.

    Attributes
    ----------
    tree : Case
        Each split names a row and covers all its choices; each leaf holds a Farkas vector of its linear constraints.
    nodes : int
        How many cases the search looked at.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.3
    (complementary cones: one a choice of every row).
    """

    problem: LCP = field(repr=False)
    tree: Case = field(repr=False)
    nodes: int = 0

    @property
    def leaves(self) -> int:
        """Number of closed cases."""
        return sum(case.row < 0 for case, _ in self._cases())

    @property
    def infeasibility(self) -> Infeasibility | None:
        """The Farkas vector of the whole problem, where its linear constraints contradict without any split."""
        if self.tree.y is None or not any(self.tree.y):
            return None
        largest = max(map(abs, self.tree.y))
        exact = tuple(value / largest for value in self.tree.y)
        return Infeasibility(self.problem, np.array([float(value) for value in exact]), exact)

    def closings(self) -> Iterator[Closing | None]:
        """Yield what closes each leaf, in exact arithmetic; None for one that does not, or a split that leaves gaps."""
        for case, path in self._cases():
            if case.row >= 0:
                if case.row in path or set(case.branches) != set(self._choices(case.row)):
                    yield None
            elif case.y is None or case.branches:
                yield None
            else:
                yield closed_exactly(self.problem, case.y, path)

    def __str__(self) -> str:
        leaves = self.leaves
        cases = "the only case" if leaves == 1 else f"each of the {leaves} cases"
        return f"no solution: {cases} of an exhaustive search contradicts, exactly"

    def _cases(self) -> Iterator[tuple[Case, dict[int, str]]]:
        stack: list[tuple[Case, dict[int, str]]] = [(self.tree, {})]
        while stack:
            case, path = stack.pop()
            yield case, path
            stack.extend((branch, path | {case.row: choice}) for choice, branch in case.branches.items())

    def _choices(self, row: int) -> tuple[str, ...]:
        return row_choices(float(self.problem.lower[row]), float(self.problem.upper[row]))
