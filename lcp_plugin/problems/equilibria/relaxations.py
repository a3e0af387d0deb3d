"""Convex programs of nodes and complementarity pieces: solved, bounded, or proved infeasible.

A node leaves some branches of each pair open. The conditions common to these branches are bounds of variables, so
the programs of all nodes differ only in bounds. The lower bound of a node is rigorous for any multipliers
(:mod:`lcp_plugin.problems.programs.dual_bounds`). It holds for every piece below, and does not rely on the accuracy
of the solver.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.settings import Status
from ...engines import engine_class
from ...proofs.bounds.curvature import Curvature, constrained_curvature
from ..programs.dual_bounds import DualBounds, implied_box
from ..programs.engine_calls import GIVEN, run_engine
from ..programs.no_minimum import QPInfeasibility, prove_infeasible
from ..programs.program import QuadraticProgram
from ..programs.solution import QPSolution
from ..programs.solving import solve_program
from .equilibrium_program import Cases, EquilibriumProgram, case_counts

TINY = 1e-9  # of ‖x‖∞
FEASIBLE = 1e-7  # largest violation of a row by a solution, relative to its terms
ENOUGH = 0.1  # of the tolerance: a bound this close to the value is not repaired
FAR = 1e4  # times the size of x in the data: a point of larger norm counts as unbounded
MOST_PROJECTIONS = 4  # onto the linearized rows of a piece


@dataclass(eq=False)
class Node:
    """Open branches of all pairs, with the bound or the proof of infeasibility.

    Attributes
    ----------
    cases : ndarray of uint8, shape (k,)
    parent : Node or None
    pair : int
        The pair that was branched on; −1 for a leaf.
    bound : float
        No x of any piece in it has a smaller objective; ∞ if the node is infeasible.
    point : ndarray or None
        Minimizer of the relaxation, or a point of large norm if it is unbounded.
    dual : pair of ndarray or None
        The point and the multipliers that prove the bound.
    proof : QPInfeasibility or None
    value : float
        Objective at the point if the relaxation is solved, else ∞.
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
        """True if every pair has exactly one open branch."""
        return bool((case_counts(self.cases) == 1).all())


class Relaxations:
    """Solver for the programs of nodes.

    Parameters
    ----------
    problem : EquilibriumProgram
    tolerance : float
        Relative tolerance of the gap.
    """

    def __init__(self, problem: EquilibriumProgram, tolerance: float) -> None:
        self.problem, self.tolerance, self.solved = problem, tolerance, 0

    @cached_property
    def _curvature(self) -> Curvature:
        return constrained_curvature(self.problem.program.P, self.problem.program.A)

    @cached_property
    def _box(self) -> tuple[FloatVector, FloatVector]:
        return implied_box(self.problem.program)

    def program(self, cases: Cases) -> QuadraticProgram | None:
        """Return the program of the open branches; None if some lower > upper."""
        lower, upper = self.problem.bounds(cases)
        if (lower > upper).any():
            return None
        return self.problem.program.with_vectors(lower=lower, upper=upper)

    def node(self, cases: Cases, parent: Node | None = None) -> Node:
        """Return the solved node of the branches, with its bound or a proof of infeasibility."""
        node = self.solved_node(cases)
        node.parent = parent
        if (
            node.dual is not None
            and node.point is not None
            and (program := self.program(cases)) is not None
        ):
            enough = node.value - ENOUGH * self.tolerance * self.problem.objective_size(node.point)
            node.bound = self.bound(program, node.dual, enough)
            if (
                node.bound == -math.inf
            ):  # a vertex has more zeros than multipliers to repair them by
                inside = run_engine(
                    program, engine_class("clarabel")(), self.tolerance, GIVEN
                ).solution
                dual = inside.x, np.concatenate([inside.inequality, inside.equality])
                node.bound, node.dual = self.bound(program, dual, enough), dual
        if parent is not None and parent.bound > node.bound:
            node.bound, node.dual = parent.bound, parent.dual
        return node

    def solved_node(self, cases: Cases) -> Node:
        """Return the node of the branches, solved or proved infeasible, but without a bound."""
        self.solved += 1
        node, program = Node(cases), self.program(cases)
        if program is None:
            node.bound = math.inf
            return node
        solution = _solution_of(program)
        found = [solution]
        if not solution.is_optimal():
            proof = prove_infeasible(program)
            if proof is not None and proof.is_exact and proof.excludes(self.tolerance):
                node.bound, node.proof = math.inf, proof
                return node
            found.append(self._solve_in_box(program))
        for solution in found:
            x = self._round_small(np.clip(solution.x, program.lower, program.upper), program)
            value = self.problem.objective(x)
            if node.point is None:
                node.point = x
            if (self.problem.excess_of_rows(x) <= FEASIBLE).all() and value < node.value:
                node.point, node.value = x, value
                node.dual = x, np.concatenate([solution.inequality, solution.equality])
        return node

    def _round_small(self, x: FloatVector, program: QuadraticProgram) -> FloatVector:
        """Return x with components below 1e-9 ‖x‖∞ set to 0 if this reduces violations."""
        is_tiny = np.abs(x) <= TINY * np.abs(x).max(initial=0.0)
        other = np.clip(np.where(is_tiny, 0.0, x), program.lower, program.upper)
        if np.array_equal(other, x):
            return x
        misses, misses_less = (
            self.problem.excess_of_rows(one).max(initial=0.0) for one in (x, other)
        )
        return other if misses_less < misses else x

    def bound(
        self, program: QuadraticProgram, dual: tuple[FloatVector, FloatVector], enough: float
    ) -> float:
        """Return a lower bound of the program's objective that the point and the multipliers prove."""
        box = np.maximum(self._box[0], program.lower), np.minimum(self._box[1], program.upper)
        if (box[0] > box[1]).any():
            box = program.lower, program.upper
        offset = self.problem.program.constant
        found = DualBounds(program, self._curvature, box).best(*dual, enough - offset)
        return math.nextafter(found + offset, -math.inf) if offset else found

    def local_node(self, cases: Cases, near: FloatVector) -> Node:
        """Return the node of one piece, integers rounded from a point; its value is ∞ if no solution was found.

        A convex piece is solved. Otherwise x is projected onto the linearized rows, up to four times.
        """
        node, (lower, upper), whole = Node(cases), self.problem.bounds(cases), self.problem.integers
        lower[whole] = upper[whole] = np.clip(
            np.rint(near[whole]), np.ceil(lower[whole]), np.floor(upper[whole])
        )
        if (lower > upper).any():
            return node
        x = np.clip(near, lower, upper)
        for _ in range(MOST_PROJECTIONS):
            self.solved += 1
            if self.problem.is_convex:
                program = self.problem.program.with_vectors(lower=lower, upper=upper)
            else:
                program = self._projection(x, lower, upper)
            solution = _solution_of(program)
            if not solution.is_optimal():
                return node
            x = self._round_small(np.clip(solution.x, lower, upper), program)
            if self.problem.excess(x) <= FEASIBLE:
                node.point, node.value = x, self.problem.objective(x)
                return node
        return node

    def _projection(
        self, x: FloatVector, lower: FloatVector, upper: FloatVector
    ) -> QuadraticProgram:
        """Return the program that projects x onto the rows, linearized at x."""
        own, smooth = self.problem.program, self.problem.smooth
        rows = [sp.csr_array(own.G), sp.csr_array(own.A)]
        low, high = [np.full(own.h.size, -np.inf), own.b], [own.h, own.b]
        if smooth is not None:
            slopes = sp.csr_array(smooth.map.jacobian(x))[1:]
            shift = slopes @ x - smooth.map.value(x)[1:]
            rows.append(slopes)
            low.append(smooth.lower + shift)
            high.append(smooth.upper + shift)
        return QuadraticProgram.from_ranges(
            sp.eye_array(x.size, format="csr"),
            -x,
            sp.vstack(rows, format="csr"),
            np.concatenate(low),
            np.concatenate(high),
            lower,
            upper,
        )

    def _solve_in_box(self, program: QuadraticProgram) -> QPSolution:
        """Return the solution within a large box, at its edge if the program is unbounded."""
        rows = program.constraints
        limits = np.abs(rows.limit) / program.matrices.row_sizes
        far = FAR * (1.0 + float(limits[rows.finite].max(initial=0.0)))
        return _solution_of(
            program.with_vectors(
                lower=np.maximum(program.lower, -far), upper=np.minimum(program.upper, far)
            )
        )


def _solution_of(program: QuadraticProgram) -> QPSolution:
    """Return the solution of a program; raise KeyboardInterrupt if Ctrl-C ended the solve."""
    result = solve_program(program, prove_infeasibility=False)
    if result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return result.solution
