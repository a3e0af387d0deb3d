"""What a branch and bound says of its problem, and how that is checked again."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ...checks import FloatVector
from ...conversions.equilibrium_program import CASES, Cases, EquilibriumProgram, case_counts
from ...conversions.program import QuadraticProgram
from ...conversions.qp_proofs import QPInfeasibility, QPUnboundedness
from .cuts import Strengthened
from .relaxations import Node, Relaxations

FEASIBLE = 1e-7


@dataclass(frozen=True, eq=False)
class EquilibriumResult:
    """The best solution found, and a proved bound of what any solution can reach.

    Attributes
    ----------
    strengthened : Strengthened
        The problem with its cuts, and what proves these.
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
        Wall-clock seconds.
    tolerance : float
        Of the gap.
    tree : tuple of Node
        What `verify` checks.
    descent : pair or None
        The piece that falls for ever, and the proof.
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
    descent: tuple[Cases, QPUnboundedness] | None = field(default=None, repr=False)

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
        """Return whether the status, x and the bound hold, from the data alone; some milliseconds a leaf."""
        if not (self._x_holds() and self.strengthened.verify()):
            return False
        relaxations = Relaxations(self.strengthened.problem, self.tolerance)
        if self.status == "unbounded":
            return self._falls(relaxations)
        is_proved = {
            "optimal": self.x is not None and self.gap <= self.tolerance,
            "infeasible": self.x is None and self.lower_bound == math.inf,
        }
        if not is_proved.get(self.status, True) or self.lower_bound == -math.inf:  # which says nothing
            return is_proved.get(self.status, True)
        return self._tree_covers() and all(
            self._leaf_holds(node, relaxations) for node in self.tree if node.pair < 0
        )

    def _x_holds(self) -> bool:
        if self.x is None:
            return self.value == (-math.inf if self.status == "unbounded" else math.inf)
        program = self.problem.program
        excess = (program.constraints.excess(self.x) / program.constraints.unit).max(initial=0.0)
        is_exact = bool((self.problem.violations(self.x) == 0.0).all())
        return is_exact and bool(excess <= FEASIBLE) and self.problem.objective(self.x) <= self.value

    def _falls(self, relaxations: Relaxations) -> bool:
        """Return whether the proof of descent is one, of a piece of this problem."""
        if self.descent is None:
            return False
        cases, proof = self.descent
        is_piece = bool(((case_counts(cases) == 1) & (cases & self.problem.all_cases == cases)).all())
        program = relaxations.program(cases)
        return is_piece and program is not None and _is_of(proof, program) and proof.verify()

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
        if program is None or self.lower_bound == -math.inf:
            return True
        if leaf.proof is not None:
            return _is_of(leaf.proof, program) and leaf.proof.verify()
        if leaf.dual is None:
            return False
        if relaxations.bound(program, leaf.dual, self.lower_bound) >= self.lower_bound:
            return True
        # what holds of more cases than its own holds of them
        parent = leaf.parent
        return parent is not None and parent.dual is leaf.dual and self._leaf_holds(parent, relaxations)

    def __str__(self) -> str:
        has_bound = self.status not in ("infeasible", "unbounded")
        bound = f", bound {self.lower_bound:.9g}, gap {self.gap:.1e}" if has_bound else ""
        work = f"{self.nodes} nodes, {self.programs} programs, {self.seconds:.3g} s"
        return f"{self.status}: {self.value:.9g}{bound}; {work}"


def _is_of(proof: QPInfeasibility | QPUnboundedness, program: QuadraticProgram) -> bool:
    """Return whether a proof speaks of this program."""
    mine = proof.program
    return mine.matrices is program.matrices and all(
        np.array_equal(getattr(mine, name), getattr(program, name)) for name in ("c", "lower", "upper", "h", "b")
    )
