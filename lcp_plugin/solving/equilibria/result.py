"""What a branch and bound says of its problem, and how that is checked again."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ...checks import FloatVector
from ...conversions.equilibrium_program import CASES, EquilibriumProgram
from .cuts import Strengthened
from .relaxations import Node, Relaxations

FEASIBLE = 1e-7


@dataclass(frozen=True, eq=False)
class EquilibriumResult:
    """The best solution found, and a proved bound of what any solution can reach.

    Attributes
    ----------
    status : str
        "optimal": the gap is proved to be within the tolerance. "infeasible": every piece is refuted by a verified
        proof. "unbounded": a piece falls for ever. "limit": time, nodes or Ctrl-C ended the search. "unknown": some
        piece could be neither solved nor refuted.
    x : ndarray, shape (n,), or None
        In every pair one side is at its bound, or zero, as a double.
    value : float
        Its objective; ∞ without an x, −∞ where it is unbounded.
    lower_bound : float
        No solution has a smaller objective.
    is_b_stationary : bool or None
        Whether x is least on every piece that holds it, so that it is a local minimum; None where that is not known.
    nodes, programs : int
        Nodes that were branched on, and convex programs that were solved.
    seconds : float
    """

    strengthened: Strengthened = field(repr=False)
    status: str
    x: FloatVector | None = field(repr=False)
    value: float
    lower_bound: float
    is_b_stationary: bool | None
    nodes: int
    programs: int
    seconds: float
    tolerance: float = field(repr=False)
    tree: tuple[Node, ...] = field(repr=False)

    @property
    def problem(self) -> EquilibriumProgram:
        """The problem that was given."""
        return self.strengthened.original

    @property
    def gap(self) -> float:
        """The value less the bound, beside |value| where that exceeds 1."""
        if self.value == self.lower_bound:
            return 0.0
        return (self.value - self.lower_bound) / max(1.0, abs(self.value)) if math.isfinite(self.value) else math.inf

    @property
    def iterations(self) -> int:
        """The number of nodes."""
        return self.nodes

    @property
    def setup_seconds(self) -> float:
        """0."""
        return 0.0

    @property
    def is_global(self) -> bool:
        """Whether x is proved to be within the tolerance of the least."""
        return self.status == "optimal"

    def verify(self) -> bool:
        """Return whether x and the bounds of all leaves hold, from the data alone; some milliseconds a leaf."""
        if not (self._x_holds() and self._tree_covers() and self.strengthened.verify()):
            return False
        relaxations = Relaxations(self.strengthened.problem, self.tolerance)
        return all(self._leaf_holds(node, relaxations) for node in self.tree if node.pair < 0)

    def _x_holds(self) -> bool:
        if self.x is None:
            return self.value == math.inf or self.status == "unbounded"
        program = self.problem.program
        excess = (program.constraints.excess(self.x) / program.constraints.unit).max(initial=0.0)
        is_exact = bool((self.problem.violations(self.x) == 0.0).all())
        return is_exact and bool(excess <= FEASIBLE) and self.problem.objective(self.x) <= self.value

    def _tree_covers(self) -> bool:
        """Return whether the root has all cases, and the children of every node all that it has."""
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
        if program is None or leaf.bound == -math.inf:
            return True
        if leaf.proof is not None:
            same = (np.array_equal(getattr(leaf.proof.program, name), getattr(program, name))
                    for name in ("lower", "upper", "h", "b"))
            return all(same) and leaf.proof.program.matrices is program.matrices and leaf.proof.verify()
        if leaf.dual is None:
            return False
        least = min(leaf.bound, self.lower_bound)
        return relaxations.bound(program, leaf.dual, least) >= least

    def __str__(self) -> str:
        has_bound = self.status not in ("infeasible", "unbounded")
        bound = f", bound {self.lower_bound:.9g}, gap {self.gap:.1e}" if has_bound else ""
        work = f"{self.nodes} nodes, {self.programs} programs, {self.seconds:.3g} s"
        return f"{self.status}: {self.value:.9g}{bound}; {work}"
