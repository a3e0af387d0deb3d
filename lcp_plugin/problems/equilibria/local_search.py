"""Good points early: a piece near the relaxation's point, then from piece to piece while that descends."""

from __future__ import annotations

import itertools
import math

import numpy as np

from ...core.checks import FloatVector
from ...core.deadline import is_over
from .equilibrium_program import BETWEEN, CASES, LOWER, Cases
from .relaxations import Node, Relaxations

MEETS = 1e-7  # beside 1 + ‖x‖∞: a case that x belongs to
DESCENT = 1e-9  # of 1 + |f|
MOST_BIACTIVE = 12
MOST_NEIGHBOURS = 50
MOST_STEPS = 12  # programs towards complementarity
FIRST_WEIGHT, WEIGHT_GROWTH = 0.1, 3.0  # of products beside the objective


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
        """Its objective, ∞ as long as there is none."""
        return math.inf if self.best is None else self.best.value

    def offer(self, cases: Cases) -> Node:
        """Return the piece of these cases, one a pair, solved; keep it where it is the best."""
        key = cases.tobytes()
        if key not in self._known:
            piece = self._known[key] = self.relaxations.solved_node(cases)
            if piece.value < self.value:
                self.best = piece
        return self._known[key]

    def start(self, node: Node) -> Node | None:
        """Return the last piece of a descent that begins near the point of a node; None where it has none.

        Where that is far from complementary, programs min f(x) + ρ (Σ w̄_i (z_i − l_i) + (z̄_i − l_i) w_i) over the node,
        one after the other from its point (z̄, w̄), bring it nearer while ρ grows: the products are linearised.
        """
        point, weight, program = node.point, FIRST_WEIGHT, self.problem.program
        for _ in range(MOST_STEPS):
            if point is None or is_over():
                return None
            if not (self.problem.violations(point) > MEETS * (1.0 + np.abs(point).max(initial=0.0))).any():
                break
            gradient = self._product_gradient(point)
            size = float(np.abs(program.P @ point + program.c).max(initial=0.0)) / np.abs(gradient).max(initial=0.0)
            nearer = self.relaxations.least(node.cases, weight * (size or 1.0) * gradient)
            point, weight = point if nearer is None else nearer, weight * WEIGHT_GROWTH
        return None if point is None else self.descend(self.problem.nearest(point, node.cases))

    def _product_gradient(self, x: FloatVector) -> FloatVector:
        """Return the gradient of Σ (z_i − l_i) w_i, of Σ (z_i − u_i) w_i where w_i < 0 or z_i has no lower bound."""
        problem, gradient = self.problem, np.zeros(x.size)
        z, w = x[problem.first], x[problem.second]
        lower, upper = problem.lower, problem.upper
        is_above = np.isfinite(upper) & ((w < 0.0) | ~np.isfinite(lower))
        end = np.where(is_above, upper, np.where(np.isfinite(lower), lower, z))
        np.add.at(gradient, problem.first, np.where(is_above, np.minimum(w, 0.0), np.maximum(w, 0.0)))
        np.add.at(gradient, problem.second, z - end)
        return gradient

    def descend(self, cases: Cases) -> Node:
        """Return the last of the pieces from these cases on, each with a smaller value than the one before.

        The next one takes another case of pairs that are degenerate (z at a bound and w = 0) at the piece's solution:
        of all to which its multipliers promise a descent, or else of one of these after the other.
        """
        piece = self.offer(cases)
        while (better := self._better_neighbour(piece)) is not None:
            piece = better
        return piece

    def _better_neighbour(self, piece: Node) -> Node | None:
        if piece.value == math.inf:
            return None
        promising = self._promising(piece)
        for chosen in ([promising] if len(promising) > 1 else []) + [[one] for one in promising[:MOST_NEIGHBOURS]]:
            if is_over():
                return None
            cases = piece.cases.copy()
            for i, case in chosen:
                cases[i] = case
            neighbour = self.offer(cases)
            if neighbour.value < piece.value - DESCENT * (1.0 + abs(piece.value)):
                return neighbour
        return None

    def _promising(self, piece: Node) -> list[tuple[int, int]]:
        """Return (pair, case) of other cases of degenerate pairs towards which the objective falls, the steepest first.

        By the multipliers of the piece: where there is none, its solution is strongly stationary.
        """
        assert piece.point is not None
        assert piece.dual is not None
        problem, program = self.problem, self.problem.program
        slope = program.matrices.gradient @ np.concatenate([piece.point, piece.dual[1]]) + program.c
        size = MEETS * (1.0 + float(np.abs(program.c).max(initial=0.0)))
        found = []
        for i, case in self._other_cases(piece.point, piece.cases):
            column = problem.second[i] if piece.cases[i] == BETWEEN else problem.first[i]
            is_rise = piece.cases[i] == LOWER or case == LOWER
            fall = -slope[column] if is_rise else slope[column]
            if fall > size:
                found.append((fall, i, case))
        return [(i, case) for _, i, case in sorted(found, key=lambda one: (-one[0], *one[1:]))]

    def _other_cases(self, x: FloatVector, cases: Cases) -> list[tuple[int, int]]:
        """Return (pair, case) of the cases that x belongs to as well."""
        meets = self.problem.distances(x) <= MEETS * (1.0 + float(np.abs(x).max(initial=0.0)))
        rows, pairs = np.nonzero(meets)
        return [(int(i), CASES[k]) for k, i in zip(rows, pairs, strict=True)
                if CASES[k] != cases[i] and CASES[k] & self.problem.all_cases[i]]

    def is_stationary(self) -> bool | None:
        """Return whether the best point is B-stationary: least on every piece that holds it; None where these are many.

        Then it is a local minimum.
        """
        if self.best is None or self.best.point is None:
            return None
        if not self._promising(self.best):
            return True
        choices: dict[int, list[int]] = {}
        for i, case in self._other_cases(self.best.point, self.best.cases):
            choices.setdefault(i, [int(self.best.cases[i])]).append(case)
        if len(choices) > MOST_BIACTIVE or is_over():
            return None
        value = self.best.value
        for chosen in itertools.product(*choices.values()):
            cases = self.best.cases.copy()
            cases[list(choices)] = chosen
            if self.offer(cases).value < value - DESCENT * (1.0 + abs(value)):
                return False
        return True
