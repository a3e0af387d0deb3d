"""Result of a minimization over all solutions, and its verification."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...core.checks import FloatVector
from ...core.settings import Status
from ...core.solving.base_result import NEXT, BaseResult
from ..programs.no_minimum import QPUnboundedness
from ..programs.program import QuadraticProgram
from .equilibrium_program import CASES, Cases, EquilibriumProgram, case_counts
from .relaxations import FEASIBLE, Node, Relaxations

CONTRADICTED = "contradicted"  # by a better point found here
ENDS = {  # SCIP's names
    "timelimit": Status.MAX_SECONDS,
    "nodelimit": Status.MAX_ITERATIONS,
    "totalnodelimit": Status.MAX_ITERATIONS,
    "userinterrupt": Status.INTERRUPTED,
}
BY_SCIP = "bound by SCIP, in floating point"
GLOBAL = "pip install '.[global]'"
ADVICE = {
    Status.SOLVED: "no solution is better by more than the tolerance, and result.verify() checks the proof",
    Status.INFEASIBLE: "the linear constraints are inconsistent; next: check the data (proof: result.proof)",
    Status.NO_SOLUTION: (
        "every complementarity piece is infeasible; next: check the pairs and the linear constraints "
        "(proof: result.proof)"
    ),
    Status.MAX_ITERATIONS: "node limit reached; next: raise max_nodes",
    Status.MAX_SECONDS: "time limit reached; next: raise max_seconds",
    Status.STALLED: (
        "some complementarity piece was neither solved nor proved infeasible; next: bound the unknowns, or rescale the "
        "data"
    ),
    Status.INTERRUPTED: "stopped by Ctrl-C or the callback",
}
LIMITS = (Status.MAX_ITERATIONS, Status.MAX_SECONDS, Status.INTERRUPTED)
UNCONFIRMED = "SCIP's point or its bound could not be confirmed; next: bound the unknowns, or rescale the data"
SAID = {
    "infeasible": "SCIP, in floating point, finds no solution; this is not proved, so the status is not INFEASIBLE; "
    "next: check the data",
    "unbounded": "SCIP, in floating point, reports an unbounded objective; this is not proved; next: bound the "
    "variables",
    "inforunbd": "SCIP, in floating point, reports an infeasible or unbounded problem; next: bound the variables",
    CONTRADICTED: "x is better than SCIP's bound, which is therefore ignored; next: rescale the data",
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
        The best solution. In every pair one side is exactly at its bound, or exactly zero. The violation of every row
        is at most 1e-7 of its terms.
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

    problem: EquilibriumProgram = field(repr=False)
    status: Status
    x: FloatVector | None = field(repr=False)
    value: float
    lower_bound: float
    bound_by: str | None
    nodes: int
    programs: int
    seconds: float
    tolerance: float = field(repr=False)
    tree: tuple[Node, ...] = field(repr=False)
    descent: tuple[Cases, QPUnboundedness] | None = field(default=None, repr=False)
    outside: ExternalBound | None = field(default=None, repr=False)

    @property
    def gap(self) -> float:
        """Value − bound, relative to the terms of the objective at x; ∞ without an x."""
        if self.value == self.lower_bound:
            return 0.0
        size = 0.0 if self.x is None else self.problem.objective_size(self.x)
        return (self.value - self.lower_bound) / size if size > 0.0 else math.inf

    @property
    def iterations(self) -> int:
        """The number of nodes."""
        return self.nodes

    @np.errstate(all="ignore")
    def verify(self) -> bool:
        """Return whether the status, x and the bound are verified, in some milliseconds per leaf.

        The checks use only the data. A bound by SCIP is not proved, and the result is then False.
        """
        if self.bound_by == "SCIP" or not self._x_holds():
            return False
        relaxations = Relaxations(self.problem, self.tolerance)
        if self.status is Status.UNBOUNDED:
            return self._falls(relaxations)
        holds = True
        if self.status is Status.SOLVED:
            holds = self.x is not None and self.gap <= self.tolerance
        elif self.status in (Status.INFEASIBLE, Status.NO_SOLUTION):
            holds = self.x is None and self.lower_bound == math.inf
        if not holds or self.lower_bound == -math.inf:  # a bound of −∞ needs no proof
            return holds
        return self._tree_covers() and all(
            self._leaf_holds(node, relaxations) for node in self.tree if node.pair < 0
        )

    def _x_holds(self) -> bool:
        if self.x is None:
            return self.value == (-math.inf if self.status is Status.UNBOUNDED else math.inf)
        is_exact = bool((self.problem.violations(self.x) == 0.0).all())
        return (
            is_exact
            and self.problem.excess(self.x) <= FEASIBLE
            and self.problem.objective(self.x) <= self.value
        )

    def _falls(self, relaxations: Relaxations) -> bool:
        """Return whether the proof of unboundedness is valid for a piece of this problem."""
        if self.descent is None:
            return False
        cases, proof = self.descent
        is_piece = bool(
            ((case_counts(cases) == 1) & (cases & self.problem.all_cases == cases)).all()
        )
        program = relaxations.program(cases)
        return (
            is_piece and program is not None and _is_same(proof.program, program) and proof.verify()
        )

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
                wanted = [case for case in CASES if node.cases[node.pair] & case]
                own = children.get(id(node), [])
                rest = [np.delete(child.cases, node.pair) for child in own]
                is_same = all(np.array_equal(one, np.delete(node.cases, node.pair)) for one in rest)
                if not is_same or sorted(int(child.cases[node.pair]) for child in own) != wanted:
                    return False
        return True

    def _leaf_holds(self, leaf: Node, relaxations: Relaxations) -> bool:
        program = relaxations.program(leaf.cases)
        if program is None or self.lower_bound == -math.inf:
            return True
        if leaf.proof is not None:
            proof = leaf.proof
            return _is_same(proof.program, program) and proof.is_exact and proof.verify()
        if leaf.dual is None:
            return False
        if relaxations.bound(program, leaf.dual, self.lower_bound) >= self.lower_bound:
            return True
        # A bound of the parent also holds for the leaf, because the leaf has fewer branches.
        parent = leaf.parent
        return (
            parent is not None
            and parent.dual is leaf.dual
            and self._leaf_holds(parent, relaxations)
        )

    @property
    def objective(self) -> float | None:
        """The value, or None without an x."""
        return None if self.x is None else self.value

    @property
    def algorithm(self) -> str:
        """Name of the algorithm."""
        if self.outside is None:
            return "branch and bound"
        return "SCIP, branch and bound" if self.tree else "SCIP"

    @property
    def proof(self) -> EquilibriumResult | None:
        """The result itself, which can ``verify()``, if the status is proved; otherwise None."""
        return (
            self if (self.is_solved or self.has_no_solution) and self.bound_by != "SCIP" else None
        )

    @property
    def advice(self) -> str:
        """Meaning of the status for this search, followed by advice after ``next:``."""
        if self.is_solved and self.bound_by == "SCIP":
            proof = "; prove=True asks for a proof" if self.problem.is_provable else ""
            return f"x is a solution, measured here; no better one by more than the tolerance: {BY_SCIP}{proof}"
        advice = ADVICE.get(self.status, self.status.value)
        if self.status is Status.STALLED and self.outside is not None:
            advice = SAID.get(self.outside.status, UNCONFIRMED)
        elif self.status is Status.STALLED and not self.problem.is_provable:
            advice = (
                "an objective that is not convex, smooth rows and integers are minimised by SCIP, which is not "
                f"installed, or does not load; next: {GLOBAL}; for a local way leave out the objective and "
                "differentiate the followers: derivative(problem) in cvxpy, derivative(result)"
            )
        elif self.status not in LIMITS:
            return advice
        found = (
            "no solution was found so far"
            if self.x is None
            else "x is the best solution found so far"
        )
        happened, begins, to_do = advice.partition(NEXT)
        return f"{happened}; {found}{begins}{to_do}"

    def _numbers(self) -> dict[str, float]:
        own = {
            "lower_bound": self.lower_bound,
            "gap": self.gap,
            "programs": self.programs,
            "tolerance": self.tolerance,
        }
        return {**super()._numbers(), **own}

    def describe_accuracy(self) -> str:
        """Return the value and the bound."""
        if self.has_no_solution:
            return "no least objective" if self.status is Status.UNBOUNDED else "no solution"
        bound = f"none below {self.lower_bound:.9g}" if self.lower_bound > -math.inf else "no bound"
        bound += f" ({BY_SCIP})" if self.bound_by == "SCIP" else ""
        if self.x is None:
            return f"no solution found, {bound}"
        gap = f", gap {self.gap:.1e}" if self.gap < math.inf else ""  # ∞ for an objective of 0
        return f"objective {self.value:.9g}, {bound}{gap}"

    def _effort(self) -> str:
        return (
            f"{self.algorithm}: {self.nodes} nodes, {self.programs} programs, {self.seconds:.3g} s"
        )


def _is_same(one: QuadraticProgram, other: QuadraticProgram) -> bool:
    """Return whether two programs have one matrix and the same vectors."""
    return one.matrices is other.matrices and all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("c", "lower", "upper", "h", "b")
    )
