"""Convex programs of nodes and complementarity pieces: solved, bounded, or proved infeasible.

A node leaves some branches of each pair open. The conditions common to these branches are bounds of variables, so
the programs of all nodes differ only in bounds. The lower bound of a node is rigorous for any multipliers
(:mod:`lcp_plugin.problems.programs.value_bounds`). It holds for every piece below, and does not rely on the accuracy
of the solver. The result of the minimization, and its verification, are also here.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import Vector
from ...core.entries import largest_in_rows
from ...core.errors import UnsupportedModel
from ...core.kernels.floats import NORMAL
from ...core.settings import Status
from ...engines.linear_program import FEASIBLE
from ...proofs.bounds import Curvature, constrained_curvature
from ...solving.result import BaseResult
from ..programs.no_minimum import QPInfeasibility, QPUnboundedness, prove_infeasible
from ..programs.program import QuadraticProgram
from ..programs.solution import QPSolution
from ..programs.solving import solve_program
from ..programs.value_bounds import DualBounds, implied_box
from .equilibrium_program import Cases, EquilibriumProgram, branches

PENALTY = 2.0**6  # of the largest entry of P, for rows whose largest entry is 1


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
    point: Vector | None = None
    dual: tuple[Vector, Vector] | None = field(default=None, repr=False)
    proof: QPInfeasibility | None = field(default=None, repr=False)
    value: float = math.inf

    @property
    def is_piece(self) -> bool:
        """True if every pair has exactly one open branch."""
        return bool((np.bitwise_count(self.cases) == 1).all())


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
    def _facts(self) -> tuple[Curvature, tuple[Vector, Vector]]:
        """The curvature on the equalities, and the bounds that the constraints imply."""
        program = self.problem.program
        return constrained_curvature(program.P, program.A), implied_box(program)

    def program(self, cases: Cases) -> QuadraticProgram | None:
        """Return the program of the open branches; None if some lower > upper."""
        lower, upper = self.problem.bounds(cases)
        if (lower > upper).any():
            return None
        return self.problem.program.with_vectors(lower=lower, upper=upper)

    def node(self, cases: Cases, parent: Node | None = None) -> Node:
        """Return the solved node of the branches, with its bound or a proof of infeasibility."""
        node, program = self.solved_node(cases), self.program(cases)
        node.parent = parent
        if node.dual is not None and program is not None:
            size = self.problem.objective_size(node.dual[0])
            # A bound this close to the value is not repaired
            enough = node.value - 0.1 * self.tolerance * size
            node.bound = self.bound(program, node.dual, enough)
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
        solutions = [_solved_program(program)]
        if not solutions[0].is_optimal():
            proof = prove_infeasible(program)
            if proof is not None and proof.is_exact and proof.excludes(self.tolerance):
                node.bound, node.proof = math.inf, proof
                return node
            solutions.append(self._solve_in_box(program))
        for solution in solutions:
            x = self._round_small(np.clip(solution.x, program.lower, program.upper), program)
            value = self.problem.objective(x)
            if node.point is None:
                node.point = x
            if (self.problem.excess_of_rows(x) <= FEASIBLE).all() and value < node.value:
                node.point, node.value = x, value
                node.dual = x, np.concatenate([solution.inequality, solution.equality])
        return node

    def _round_small(self, x: Vector, program: QuadraticProgram) -> Vector:
        """Return x with components below 1e-9 ‖x‖∞ set to 0 if this reduces violations."""
        is_tiny = np.abs(x) <= 1e-9 * np.abs(x).max(initial=0.0)  # of ‖x‖∞
        other = np.clip(np.where(is_tiny, 0.0, x), program.lower, program.upper)
        if np.array_equal(other, x):
            return x
        excess, rounded = (self.problem.excess_of_rows(point) for point in (x, other))
        return other if rounded.max(initial=0.0) < excess.max(initial=0.0) else x

    def bound(self, program: QuadraticProgram, dual: tuple[Vector, Vector], enough: float) -> float:
        """Return a lower bound of the program's objective that the point and the multipliers prove.

        Bounds that the constraints imply hold for every feasible x. If they cross the bounds of the program, no x is
        feasible, and every number is a bound.
        """
        curvature, (low, high) = self._facts
        box = np.maximum(low, program.lower), np.minimum(high, program.upper)
        offset = self.problem.program.constant
        bound = DualBounds(program, curvature, box).best(*dual, enough - offset)
        return math.nextafter(bound + offset, -math.inf) if offset else bound

    def local_node(self, cases: Cases, near: Vector) -> Node:
        """Return the node of one piece, integers rounded from a point; its value is ∞ without a solution.

        A convex piece is solved. Otherwise x is projected onto the linearized rows, and the objective is minimized over
        these as long as it falls: up to four programs. An objective that is not convex is linearized.
        """
        node, (lower, upper), whole = Node(cases), self.problem.bounds(cases), self.problem.integers
        least, most = np.ceil(lower[whole]), np.floor(upper[whole])
        lower[whole] = upper[whole] = np.clip(np.rint(near[whole]), least, most)
        if (lower > upper).any():
            return node
        if self.problem.smooth is None and (exact := self._minimizer(lower, upper)) is not None:
            node.point, node.value = exact, self.problem.objective(exact)
            return node
        x = np.clip(near, lower, upper)
        for _ in range(4):  # projections onto the linearized rows
            program = self._linearized(x, lower, upper, is_feasible=node.point is not None)
            if program is None:
                return node
            solution = _solved_program(program)
            self.solved += 1
            if not solution.is_optimal():
                return node
            step = self._round_small(np.clip(solution.x, lower, upper), program) - x
            is_partial = node.point is not None and not self.problem.has_convex_relaxation
            tried = [x + share * step for share in ((1.0, 0.5, 0.25) if is_partial else (1.0,))]
            x = min(tried, key=self.problem.objective)
            if self.problem.excess(x) <= FEASIBLE:
                if not self.problem.objective(x) < node.value:
                    return node
                node.point, node.value = x, self.problem.objective(x)
        return node

    def _minimizer(self, lower: Vector, upper: Vector) -> Vector | None:
        """Return the minimizer over affine rows if the objective plus PENALTY ‖A x − b‖² is convex there, else None."""
        program, rows = self.problem.program, sp.csr_array(self.problem.program.A)
        unit = 1.0 / np.maximum(largest_in_rows(rows), NORMAL)
        rows, P = sp.csr_array(sp.diags_array(unit) @ rows), sp.csr_array(program.P)
        penalty = PENALTY * float(abs(P).max())
        c = program.c - penalty * (rows.T @ (unit * program.b))
        with suppress(UnsupportedModel):
            P = P + penalty * (rows.T @ rows)
            penalized = program.with_data(P=P, c=c, lower=lower, upper=upper)
            solution = _solved_program(penalized, tolerance=1e-10)
            self.solved += 1
            x = self._round_small(np.clip(solution.x, lower, upper), solution.program)
            if solution.is_optimal() and self.problem.excess(x) <= FEASIBLE:
                return x
        return None

    def _linearized(
        self, x: Vector, lower: Vector, upper: Vector, *, is_feasible: bool
    ) -> QuadraticProgram | None:
        """Return the program over the rows linearized at x: of the point nearest to x, or of the least objective.

        None if x is outside of the domain of a smooth row.
        """
        program, smooth = self.problem.program, self.problem.smooth
        rows = [sp.csr_array(program.G), sp.csr_array(program.A)]
        low, high = [np.full(program.h.size, -np.inf), program.b], [program.h, program.b]
        gradient = program.P @ x + program.c
        if smooth is not None:
            slopes = sp.csr_array(smooth.map.jacobian(x))
            gradient = gradient + slopes[[0]].toarray()[0]
            shift = slopes[1:] @ x - smooth.map.value(x)[1:]
            if not np.isfinite(shift).all():
                return None
            rows.append(slopes[1:])
            low.append(smooth.lower + shift)
            high.append(smooth.upper + shift)
        P, c = sp.eye_array(x.size, format="csr"), -x
        if is_feasible and self.problem.has_convex_relaxation:
            P, c = program.P, program.c
        elif is_feasible:
            P, c = sp.csr_array(P.shape), gradient
        A, ends = sp.vstack(rows, format="csr"), (np.concatenate(low), np.concatenate(high))
        return QuadraticProgram.from_ranges(P, c, A, *ends, lower, upper)

    def projected(self, x: Vector) -> Vector:
        """Return the point nearest to x that satisfies the affine rows and bounds, complementary or not."""
        program = self.problem.program
        near = program.with_data(P=sp.eye_array(x.size), c=-x)
        return np.clip(_solved_program(near).x, program.lower, program.upper)

    def _solve_in_box(self, program: QuadraticProgram) -> QPSolution:
        """Return the solution within a large box, at its edge if the program is unbounded."""
        rows = program.constraints
        limits = np.abs(rows.limit) / rows.coefficient_sizes
        # Times the size of x in the data: a point of larger norm counts as unbounded
        far = 1e4 * (1.0 + float(limits[rows.finite].max(initial=0.0)))
        lower, upper = np.maximum(program.lower, -far), np.minimum(program.upper, far)
        return _solved_program(program.with_vectors(lower=lower, upper=upper))


def _solved_program(program: QuadraticProgram, **options: Any) -> QPSolution:
    """Return the solution of a program; raise KeyboardInterrupt if Ctrl-C ended the solve."""
    result = solve_program(program, prove_infeasibility=False, **options)
    if result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return result.solution


ENDS = {  # SCIP's names
    "timelimit": Status.MAX_SECONDS,
    "nodelimit": Status.MAX_ITERATIONS,
    "totalnodelimit": Status.MAX_ITERATIONS,
    "userinterrupt": Status.INTERRUPTED,
}
BY_SCIP = "bound by SCIP, in floating point"
ADVICE = {
    Status.SOLVED: "no solution is better by more than the tolerance, and result.verify() checks the proof",
    Status.INFEASIBLE: "the linear constraints are inconsistent; next: print(result.conflict)",
    Status.NO_SOLUTION: "every complementarity piece is infeasible; next: check pairs and constraints",
    Status.MAX_ITERATIONS: "node limit reached; next: raise max_nodes",
    Status.MAX_SECONDS: "time limit reached; next: raise max_seconds",
    Status.STALLED: "some complementarity piece is undecided; next: bound the unknowns, or rescale",
    Status.INTERRUPTED: "stopped by Ctrl-C or the callback",
}


class ExternalBound(NamedTuple):
    """Last status and bound of another solver."""

    status: str
    bound: float


@dataclass(frozen=True, eq=False, repr=False)
class EquilibriumResult(BaseResult):
    """The best solution found, and a lower bound of the objective over all solutions.

    Attributes
    ----------
    problem : EquilibriumProgram
        The problem passed by the caller.
    status : Status
        SOLVED: x is a solution, and the gap is within the tolerance. INFEASIBLE: a verified proof shows that the
        linear constraints are infeasible. NO_SOLUTION: verified proofs show that every piece is infeasible. UNBOUNDED:
        a piece is unbounded below. MAX_ITERATIONS, MAX_SECONDS, INTERRUPTED: nodes, time, Ctrl-C or the callback ended
        the search. STALLED: some piece was neither solved nor proved infeasible, or no bound of the objective is
        known.
    x : ndarray, shape (n,), or None
        The best solution; NaN with a proof that none exists. In every pair one side is exactly at its bound, or exactly
        zero. The violation of every row is at most 1e-7 of its terms.
    value : float
        Objective at x; ∞ without an x, −∞ if the objective is unbounded.
    lower_bound : float
        No solution has a smaller objective.
    bound_by : str or None
        "proof": the bound is proved, and `verify` checks the proof. "SCIP": the bound was computed by SCIP in floating
        point. None: no bound is known.
    nodes, programs : int
        Branched nodes, including SCIP's, and convex programs solved here.
    seconds : float
        Wall-clock seconds.
    tolerance : float
        Relative tolerance of the gap.
    tree : tuple of Node
        Nodes of the search, which `verify` checks.
    descent : pair or None
        The piece that is unbounded below, and the proof of it.
    outside : ExternalBound or None
        SCIP's last status and bound, if SCIP ran.
    """

    _advice = ADVICE

    problem: EquilibriumProgram
    x: Vector | None
    value: float
    lower_bound: float
    bound_by: str | None
    programs: int
    tree: tuple[Node, ...]
    descent: tuple[Cases, QPUnboundedness] | None = None
    outside: ExternalBound | None = None

    @property
    def gap(self) -> float:
        """Value − bound, relative to the terms of the objective at x; ∞ without an x."""
        if self.value == self.lower_bound:
            return 0.0
        size = 0.0 if self.x is None else self.problem.objective_size(self.x)
        return (self.value - self.lower_bound) / size if size > 0.0 else math.inf

    @property
    def nodes(self) -> int:
        """The number of nodes, `iterations`."""
        return self.iterations

    @np.errstate(all="ignore")
    def verify(self) -> bool:
        """Return whether the status, x and the bound are verified, in some milliseconds per leaf.

        The checks use only the data. A bound by SCIP is not proved, and the result is then False.
        """
        if self.bound_by == "SCIP" or not self._is_x_valid():
            return False
        relaxations = Relaxations(self.problem, self.tolerance)
        if self.status is Status.UNBOUNDED:
            return self.lower_bound == -math.inf and self._is_descent_valid(relaxations)
        holds = True
        if self.status is Status.SOLVED:
            holds = self.x is not None and self.gap <= self.tolerance
        elif self.has_no_solution:
            is_covered = self.status is Status.NO_SOLUTION or len(self.tree) == 1
            holds = self.lower_bound == math.inf and is_covered
        if not holds or self.lower_bound == -math.inf:  # a bound of −∞ needs no proof
            return holds
        leaves = (node for node in self.tree if node.pair < 0)
        return self._tree_covers() and all(self._leaf_holds(leaf, relaxations) for leaf in leaves)

    def _is_x_valid(self) -> bool:
        if self.x is None or np.isnan(self.x).all():
            return self.value == (-math.inf if self.status is Status.UNBOUNDED else math.inf)
        is_exact = bool((self.problem.violations(self.x) == 0.0).all())
        is_feasible = is_exact and self.problem.excess(self.x) <= FEASIBLE
        return is_feasible and self.problem.objective(self.x) <= self.value

    def _is_descent_valid(self, relaxations: Relaxations) -> bool:
        """Return whether the proof of unboundedness is valid for a piece of this problem."""
        if self.descent is None:
            return False
        cases, proof = self.descent
        is_open = cases & self.problem.all_cases == cases
        is_piece = bool(((np.bitwise_count(cases) == 1) & is_open).all())
        program = relaxations.program(cases)
        is_proved = program is not None and _is_same(proof.program, program) and proof.verify()
        return is_piece and is_proved

    def _tree_covers(self) -> bool:
        """Return whether the root has all branches, and children cover their node's branches."""
        children: dict[int, list[Node]] = {}
        for node in self.tree:
            children.setdefault(id(node.parent), []).append(node)
        roots = children.get(id(None), [])
        if len(roots) != 1 or not np.array_equal(roots[0].cases, self.problem.all_cases):
            return False
        for node in self.tree:
            if node.pair >= 0:
                below = sorted(child.cases.tolist() for child in children.get(id(node), []))
                if below != [cases.tolist() for cases in branches(node.cases, node.pair)]:
                    return False
        return True

    def _leaf_holds(self, leaf: Node, relaxations: Relaxations) -> bool:
        program = relaxations.program(leaf.cases)
        if program is None:
            return True
        if leaf.proof is not None:
            proof = leaf.proof
            return _is_same(proof.program, program) and proof.is_exact and proof.verify()
        dual, parent = leaf.dual, leaf.parent
        if dual is None or relaxations.bound(program, dual, self.lower_bound) >= self.lower_bound:
            return dual is not None
        # A bound of the parent also holds for the leaf, because the leaf has fewer branches.
        return parent is not None and parent.dual is dual and self._leaf_holds(parent, relaxations)

    @property
    def objective(self) -> float | None:
        """The value in the sense of the program, or None without an x."""
        return None if math.isinf(self.value) else self.problem.program.sense * self.value

    @property
    def proof(self) -> EquilibriumResult | None:
        """The result itself, which can ``verify()``, if the status is proved; otherwise None."""
        is_final = self.is_solved or self.has_no_solution
        return self if is_final and self.bound_by != "SCIP" else None

    @property
    def _farkas_proof(self) -> QPInfeasibility | None:
        """The proof that the linear constraints are inconsistent without any branch; None if there is none."""
        return next((node.proof for node in self.tree if node.parent is None), None)

    def _advice_of_status(self) -> str:
        if self.is_solved and self.bound_by == "SCIP":
            proof = "; prove=True asks for a proof" if self.problem.is_provable else ""
            return f"x is a solution, measured here; no better one by more than the tolerance: {BY_SCIP}{proof}"
        if self.status is Status.STALLED and self.outside is not None:
            report = f"SCIP, in floating point, reports {self.outside.status}, which could not be confirmed"
            return f"{report}: nothing is proved; next: bound the variables, or rescale the data"
        if self.status is Status.STALLED and not self.problem.is_provable:
            return (
                "an objective that is not convex, smooth rows and integers need SCIP, which is not installed, or does "
                "not load; next: pip install pyscipopt (or lcp_plugin[global]); for a local way leave out the "
                "objective and differentiate the followers: derivative(problem) in cvxpy, derivative(result)"
            )
        return super()._advice_of_status()

    def _clauses(self) -> list[str]:
        if self.is_solved or self.has_no_solution:
            return []
        outcome = "no solution was found" if self.x is None else "x is the best solution found"
        return [f"{outcome} so far"]

    def describe_accuracy(self) -> str:
        """Return the value and the bound."""
        if self.has_no_solution:
            return "no least objective" if self.status is Status.UNBOUNDED else "no solution"
        sense = self.problem.program.sense
        which, bound = "below" if sense > 0.0 else "above", "no bound"
        if self.lower_bound > -math.inf:
            bound = f"none {which} {sense * self.lower_bound:.9g}"
        bound += f" ({BY_SCIP})" if self.bound_by == "SCIP" else ""
        if self.x is None:
            return f"no solution found, {bound}"
        gap = f", gap {self.gap:.1e}" if self.gap < math.inf else ""  # ∞ for an objective of 0
        return f"objective {self.objective:.9g}, {bound}{gap}"

    def _effort(self) -> str:
        counts = f"{self.nodes} nodes, {self.programs} programs"
        return f"{self.algorithm}: {counts}, {self.seconds:.3g} s"


def _is_same(program: QuadraticProgram, other: QuadraticProgram) -> bool:
    """Return whether two programs have one matrix and the same vectors."""
    names = "c", "lower", "upper", "h", "b"
    are_same = (np.array_equal(getattr(program, name), getattr(other, name)) for name in names)
    return program.matrices is other.matrices and all(are_same)
