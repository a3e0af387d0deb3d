"""Proof that a problem has no solution: a tree of cases, each closed by a Farkas vector of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from ..problem import LCP
from .exact import farkas_margin, slack_bounds
from .infeasibility import Infeasibility

LOWER, ZERO, UPPER, FIXED = "lower", "zero", "upper", "fixed"


def row_choices(lower: float, upper: float) -> tuple[str, ...]:
    """Return the cases of a row: z_i = lower with w_i ≥ 0, w_i = 0, z_i = upper with w_i ≤ 0.

    Examples
    --------
    >>> row_choices(0.0, np.inf), row_choices(-np.inf, np.inf), row_choices(1.0, 1.0)
    (('lower', 'zero'), ('zero',), ('fixed',))
    """
    if lower == upper:
        return (FIXED,)
    return (LOWER,) * (lower > -np.inf) + (ZERO,) + (UPPER,) * (upper < np.inf)


@dataclass(slots=True)
class Case:
    """One case of the tree: split by the choices of a row, or closed by a Farkas vector y."""

    row: int = -1
    branches: dict[str, Case] = field(default_factory=dict)
    y: list[Fraction] | None = None


@dataclass(frozen=True, eq=False)
class NoSolution:
    """No z solves the problem: every case of a complete tree contradicts, exactly.

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

    def verify(self) -> bool:
        """Return whether the tree covers every case and each leaf's Farkas vector holds, in exact arithmetic."""
        return all(self._is_sound(case, path) for case, path in self._cases())

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

    def _is_sound(self, case: Case, path: dict[int, str]) -> bool:
        problem = self.problem
        if case.row >= 0:
            choices = row_choices(float(problem.lower[case.row]), float(problem.upper[case.row]))
            return case.row not in path and set(case.branches) == set(choices)
        if case.y is None or case.branches:
            return False
        z_bounds = (problem.lower.tolist(), problem.upper.tolist())
        w_bounds = tuple(side.tolist() for side in slack_bounds(problem))
        for i, choice in path.items():
            if choice == ZERO:
                w_bounds[0][i] = w_bounds[1][i] = 0.0
            elif choice == LOWER:
                z_bounds[1][i], w_bounds[0][i], w_bounds[1][i] = z_bounds[0][i], 0.0, np.inf
            elif choice == UPPER:
                z_bounds[0][i], w_bounds[0][i], w_bounds[1][i] = z_bounds[1][i], -np.inf, 0.0
        margin = farkas_margin(problem, case.y, z_bounds, (w_bounds[0], w_bounds[1]))
        return margin is not None and margin < 0
