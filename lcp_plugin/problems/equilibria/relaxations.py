"""The convex programs of a branch and bound: solved, bounded, or refuted, with proofs; and good points early.

A node leaves some cases of every pair open. What holds in all of them are bounds of variables, so that the programs of
all nodes differ in these alone. The lower bound of a node is the rigorous one that any multipliers give
(:mod:`lcp_plugin.problems.programs.dual_bounds`): whatever the solver did, it holds for every piece below.

Good points come from a piece near the relaxation's point, then from piece to piece while that descends.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.deadline import is_over
from ...core.settings import Status
from ...proofs.bounds.curvature import Curvature, constrained_curvature
from ..programs.compiled_call import solved_at_once
from ..programs.dual_bounds import DualBounds, implied_box
from ..programs.program import QuadraticProgram
from ..programs.qp_certificates import prove_infeasible
from ..programs.qp_proofs import QPInfeasibility
from ..programs.qp_solution import QPSolution
from ..programs.solving import judged_program
from .equilibrium_program import BETWEEN, CASES, LOWER, Cases, EquilibriumProgram, case_counts

TOLERANCE = 1e-9
ENOUGH = 0.1  # of the tolerance: a bound that is so near the value is not repaired
MOST_STEPS = 100  # of interior points, where there may be no solution
INSIDE = 1e-3  # beside the size of that box
FAR = 1e4  # times 1 + the largest number that bounds x: a box for what falls for ever
MEETS = 1e-7  # beside 1 + ‖x‖∞: a case that x belongs to
DESCENT = 1e-9  # of 1 + |f|
MOST_BIACTIVE = 12
MOST_NEIGHBOURS = 50
MOST_NEARER = 12  # programs towards complementarity
FIRST_WEIGHT, WEIGHT_GROWTH = 0.1, 3.0  # of products beside the objective


@dataclass(eq=False)
class Node:
    """Open cases of all pairs, and what is proved of them.

    Attributes
    ----------
    cases : ndarray of uint8, shape (k,)
    parent : Node or None
    pair : int
        On which its children differ, −1 for a leaf.
    bound : float
        No x of any piece in it has a smaller objective; ∞ where there is none.
    point : ndarray or None
        Where the relaxation is least, or falls.
    dual : pair of ndarray or None
        The point and the multipliers that prove the bound.
    proof : QPInfeasibility or None
    value : float
        The objective at the point where the relaxation is solved, else ∞.
    """

    cases: Cases
    parent: Node | None = None
    pair: int = -1
    bound: float = -math.inf
    point: FloatVector | None = None
    dual: tuple[FloatVector, FloatVector] | None = field(default=None, repr=False)
    proof: QPInfeasibility | None = field(default=None, repr=False)
    value: float = math.inf

    @property
    def is_piece(self) -> bool:
        """Whether every pair has one case left."""
        return bool((case_counts(self.cases) == 1).all())


class Relaxations:
    """Solves the programs of nodes.

    Parameters
    ----------
    problem : EquilibriumProgram
    tolerance : float
        Of the gap that is asked for.
    """

    def __init__(self, problem: EquilibriumProgram, tolerance: float) -> None:
        program = problem.program
        self.problem, self.tolerance, self.solved = problem, tolerance, 0
        self._are_small = False  # whether the compiled call has taken one of the programs
        self.curvature: Curvature = constrained_curvature(program.P, program.A)
        self.box = implied_box(program)

    def program(self, cases: Cases) -> QuadraticProgram | None:
        """Return the program of some cases; None where their bounds exclude each other."""
        lower, upper = self.problem.bounds(cases)
        if (lower > upper).any():
            return None
        return self.problem.program.with_vectors(lower=lower, upper=upper)

    def node(self, cases: Cases, parent: Node | None = None) -> Node:
        """Return the node of some cases, solved, and bounded or refuted."""
        node = self.solved_node(cases)
        node.parent = parent
        if node.value < math.inf and (program := self.program(cases)) is not None and node.dual is not None:
            enough = node.value - ENOUGH * self.tolerance * max(1.0, abs(node.value))
            node.bound = self.bound(program, node.dual, enough)
        if parent is not None and parent.bound > node.bound:
            node.bound, node.dual = parent.bound, parent.dual
        return node

    def solved_node(self, cases: Cases) -> Node:
        """Return the node of some cases, solved or refuted, but without a bound."""
        self.solved += 1
        node, program = Node(cases), self.program(cases)
        if program is None:
            node.bound = math.inf
            return node
        solution = self._solution(program)
        proof = prove_infeasible(program) if solution is None else None
        if proof is not None and proof.excludes(self.tolerance):
            node.bound, node.proof = math.inf, proof
            return node
        if solution is None:
            solution = self._within_a_box(program)
        node.point = np.clip(solution.x, program.lower, program.upper)
        if solution.program is program:  # otherwise it falls for ever, or nothing is known
            node.value = self.problem.objective(node.point)
            node.dual = solution.x, np.concatenate([solution.inequality, solution.equality])
        return node

    def least(self, cases: Cases, slope: FloatVector) -> FloatVector | None:
        """Return a point of a node where the objective + slope · x is least; None where none is found."""
        program = self.program(cases)
        if program is None:
            return None
        self.solved += 1
        solution = self._solution(program.with_vectors(program.c + slope))
        return None if solution is None else np.clip(solution.x, program.lower, program.upper)

    def bound(self, program: QuadraticProgram, dual: tuple[FloatVector, FloatVector], enough: float) -> float:
        """Return a lower bound of the program's objective that the point and the multipliers prove."""
        box = np.maximum(self.box[0], program.lower), np.minimum(self.box[1], program.upper)
        if (box[0] > box[1]).any():
            box = program.lower, program.upper
        offset = self.problem.offset
        found = DualBounds(program, self.curvature, box).best(*dual, enough - offset)
        return math.nextafter(found + offset, -math.inf) if offset else found

    def _solution(self, program: QuadraticProgram) -> QPSolution | None:
        """Return the solution of a program, None where a first try finds none: it may have none."""
        found = solved_at_once(program, TOLERANCE)
        self._are_small = self._are_small or found is not None
        if found is not None:
            return found.solution
        if self._are_small:
            return None
        solution = _by_steps(program, algorithm="interior_point", max_iterations=MOST_STEPS)
        return solution if solution.is_stationary() else None

    def _within_a_box(self, program: QuadraticProgram) -> QPSolution:
        """Return the solution of a program that a first try does not find, or else one within a large box.

        Along what falls for ever that one lies far out.
        """
        limits = np.concatenate([program.lower, program.upper, program.h, program.b])
        far = FAR * (1.0 + float(np.abs(limits[np.isfinite(limits)]).max(initial=0.0)))
        within = program.with_vectors(lower=np.maximum(program.lower, -far), upper=np.minimum(program.upper, far))
        found = solved_at_once(within, TOLERANCE)
        solution = _by_steps(within) if found is None else found.solution
        is_inside = bool(np.abs(solution.x).max(initial=0.0) < far * (1.0 - INSIDE)) and solution.is_stationary()
        return replace(solution, program=program) if is_inside else solution


def _by_steps(program: QuadraticProgram, **options: Any) -> QPSolution:
    """Return what a run of steps finds; Ctrl-C, which ends it with a status, ends the search, too."""
    result = judged_program(program, tolerance=TOLERANCE, refute=False, **options)
    if result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return result.solution


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
        for _ in range(MOST_NEARER):
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
