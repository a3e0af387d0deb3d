"""Early solutions: from given values, and by local descent over neighboring complementarity pieces.

A solution belongs to at least one piece. The minimizer of a piece is not worse than any solution in the piece, so a
start only needs to determine branches. If pairs are degenerate at the minimizer, a neighboring piece may be better.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from ...core.checks import FloatVector
from ...core.deadline import is_over
from .equilibrium_program import CASES, Cases
from .relaxations import Node, Relaxations

MEETS = 1e-7  # relative to 1 + ‖x‖∞: distance up to which x belongs to a branch
DESCENT = 1e-9  # of 1 + |f|
NEAR = 1e-5  # relative to 1 + ‖x‖∞: pairs of another solver's point whose branch is in doubt
MOST_DOUBTFUL = 6
MOST_NEIGHBOURS = 50


class LocalSearch:
    """The best point found so far.

    Parameters
    ----------
    relaxations : Relaxations

    Attributes
    ----------
    best : Node or None
        The piece whose solution has the least objective.
    """

    def __init__(self, relaxations: Relaxations) -> None:
        self.relaxations, self.problem = relaxations, relaxations.problem
        self.best: Node | None = None
        self._known: dict[bytes, Node] = {}

    @property
    def value(self) -> float:
        """Objective of the best point; ∞ before the first point."""
        return math.inf if self.best is None else self.best.value

    def offer(self, cases: Cases, near: FloatVector | None = None) -> Node:
        """Solve the piece with one branch per pair, keep it if it is the best, and return it.

        A piece that is not convex, or has integers, is solved near a point.
        """
        is_local = not self.problem.is_provable
        key = cases.tobytes() + (near.tobytes() if is_local and near is not None else b"")
        if key not in self._known:
            if is_local and near is not None:
                piece = self.relaxations.local_node(cases, near)
            else:
                piece = self.relaxations.solved_node(cases)
            self._known[key] = piece
            if piece.value < self.value:
                self.best = piece
        return self._known[key]

    def descend(self, cases: Cases, near: FloatVector) -> None:
        """Descend from these branches near a point, each step to a piece of smaller value.

        Each step takes other branches for pairs that are degenerate (z at a bound and w = 0) at the solution of the
        piece. It first changes all these pairs, and then one pair after the other.
        """
        piece: Node | None = self.offer(cases, near)
        while piece is not None:
            piece = self._better_neighbour(piece)

    def from_point(self, x: FloatVector, cases: Cases | None = None) -> None:
        """Descend from the branches nearest to x."""
        self.descend(self.problem.nearest(x, self.problem.all_cases if cases is None else cases), x)

    def confirm(self, x: FloatVector, value: float) -> None:
        """Descend from the branches at and near an external point, until the value is reached."""
        self.from_point(x)
        near = self.problem.distances(x) <= NEAR * (1.0 + float(np.abs(x).max(initial=0.0)))
        chosen = self.problem.nearest(x, self.problem.all_cases)
        doubtful = np.flatnonzero(near.sum(axis=0) > 1)[:MOST_DOUBTFUL]
        choices = [
            [case for case, is_near in zip(CASES, near[:, i], strict=True) if is_near]
            for i in doubtful
        ]
        for cases in itertools.product(*choices):
            if self.value <= value or is_over():
                return
            chosen[doubtful] = cases
            self.descend(chosen.copy(), x)

    def _better_neighbour(self, piece: Node) -> Node | None:
        if piece.value == math.inf:
            return None
        assert piece.point is not None
        promising = self._other_cases(piece.point, piece.cases)
        for chosen in ([promising] if len(promising) > 1 else []) + [
            [one] for one in promising[:MOST_NEIGHBOURS]
        ]:
            if is_over():
                return None
            cases = piece.cases.copy()
            for i, case in chosen:
                cases[i] = case
            neighbour = self.offer(cases, piece.point)
            if neighbour.value < piece.value - DESCENT * (1.0 + abs(piece.value)):
                return neighbour
        return None

    def _other_cases(self, x: FloatVector, cases: Cases) -> list[tuple[int, int]]:
        """Return (pair, branch) of all further branches to which x belongs."""
        meets = self.problem.distances(x) <= MEETS * (1.0 + float(np.abs(x).max(initial=0.0)))
        rows, pairs = np.nonzero(meets)
        return [
            (int(i), CASES[k])
            for k, i in zip(rows, pairs, strict=True)
            if CASES[k] != cases[i] and CASES[k] & self.problem.all_cases[i]
        ]
