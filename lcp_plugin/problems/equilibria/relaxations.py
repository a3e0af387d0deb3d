"""The convex programs of a branch and bound: solved, bounded from below, or refuted; each with what proves it.

A node leaves some cases of every pair open. What holds in all of them are bounds of variables, so that the programs of
all nodes differ in these alone. The lower bound of a node is the rigorous one that any multipliers give
(:mod:`lcp_plugin.problems.programs.dual_bounds`): whatever the solver did, it holds for every piece below.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.settings import Status
from ...proofs.bounds.curvature import Curvature, constrained_curvature
from ..programs.compiled_call import solved_at_once
from ..programs.dual_bounds import DualBounds, implied_box
from ..programs.program import QuadraticProgram
from ..programs.qp_certificates import prove_infeasible
from ..programs.qp_proofs import QPInfeasibility
from ..programs.qp_solution import QPSolution
from ..programs.solving import judged_program
from .equilibrium_program import Cases, EquilibriumProgram, case_counts

TOLERANCE = 1e-9
ENOUGH = 0.1  # of the tolerance: a bound that is so near the value is not repaired
MOST_STEPS = 100  # of interior points, where there may be no solution
INSIDE = 1e-3  # beside the size of that box
FAR = 1e4  # times 1 + the largest number that bounds x: a box for what falls for ever


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
        if solution is None and (proof := self._refutation(program)) is not None:
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

    def _refutation(self, program: QuadraticProgram) -> QPInfeasibility | None:
        proof = prove_infeasible(program)
        return proof if proof is not None and proof.excludes(self.tolerance) else None

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
