"""minimize_over_solutions(): branch and bound on the pairs of an equilibrium program.

A node leaves some cases of each pair open; its children take one case each of the pair that its relaxation violates
most, or by experience moves the bound most. The search dives: of the children it goes on with the lower bound, and when
a dive ends, with the lowest bound of all.

References
----------
J. Hu, J. E. Mitchell, J.-S. Pang, K. P. Bennett, G. Kunapuli, *On the global solution of linear programs with linear
complementarity constraints*, SIAM Journal on Optimization 19 (2008), doi:10.1137/07068463x.
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from ...core.checks import is_number
from ...core.communicator import ALONE
from ...core.deadline import Clock, is_over, time_limit
from ...core.errors import InvalidOption
from ...core.settings import Status
from ..programs.convexity import refuse_nonconvex
from ..programs.qp_proofs import QPUnboundedness
from .cuts import strengthened
from .equilibrium_program import CASES, Cases, EquilibriumProgram, case_counts
from .relaxations import LocalSearch, Node, Relaxations
from .result import EquilibriumResult

MET = 1e-9  # of 1 + |z|: a pair that the relaxation does not violate
SHARE = 0.5  # of the tolerance: how near the best value a node's bound has to be to close it
EVERY = 10  # nodes between two starts of the local search
LEAST_GAIN = 1e-9
OPTIONS = ("tolerance", "max_nodes", "max_seconds", "callback", "verbose")
GROWTH = 1.5  # of the nodes from one line of the log to the next


def minimize_over_solutions(
    problem: EquilibriumProgram, *, tolerance: float = 1e-6, max_nodes: int | None = None,
    max_seconds: float | None = None, callback: Callable[[BranchAndBound], Any] | None = None, verbose: bool = False,
) -> EquilibriumResult:
    """Return the best solution of a convex program with complementarity constraints, and a proved bound.

    Parameters
    ----------
    problem : EquilibriumProgram
    tolerance : float
        SOLVED means that the value is proved to be within tolerance · max(1, |value|) of the least.
    max_nodes : int, optional
        How many nodes may be branched on.
    max_seconds : float, optional
        Wall-clock limit in seconds; the result has what was found until then.
    callback : callable, optional
        Gets the search, with ``value``, ``lower_bound`` and ``nodes``, after each node; ends it by something true.
    verbose : bool
        Print a line at geometric intervals: nodes, value, bound, gap, seconds.

    Returns
    -------
    EquilibriumResult

    Raises
    ------
    UnsupportedModel
        Where the objective is not convex.
    InvalidOption
        Where the tolerance is not positive, a limit is negative, or the problem is of another kind.

    Notes
    -----
    Every bound is rigorous for the stored doubles, every infeasible node refuted by multipliers that are checked in
    rational arithmetic; ``result.verify()`` checks all of it again. The worst case is 2ᵏ nodes of k pairs.

    Examples
    --------
    >>> import numpy as np
    >>> from lcp_plugin import EquilibriumProgram, QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 0]], [-2, 1], lower=[-np.inf, 0])  # (x − 1)² + y − 1
    >>> problem = EquilibriumProgram.of_rows(program, [1], [[-1, 1]], [0.5])       # 0 ≤ y ⟂ y − x + ½ ≥ 0
    >>> result = minimize_over_solutions(problem)
    >>> result.status.name, round(result.value, 9), result.x.round(9), result.verify()
    ('SOLVED', -0.75, array([0.5, 0. , 0. ]), True)
    """
    if not isinstance(problem, EquilibriumProgram):
        raise InvalidOption(
            f"minimize_over_solutions needs an EquilibriumProgram, got {type(problem).__name__}; solve takes every kind"
        )
    if not (is_number(tolerance) and tolerance > 0):
        raise InvalidOption(f"tolerance must be a number > 0, got {tolerance!r}")
    for name, limit in {"max_nodes": max_nodes, "max_seconds": max_seconds}.items():
        if limit is not None and not (is_number(limit) and limit >= 0):
            raise InvalidOption(f"{name} must be a number ≥ 0, got {limit!r}")
    refuse_nonconvex(problem.program)
    with time_limit(math.inf if max_seconds is None else float(max_seconds)):
        search = BranchAndBound(problem, float(tolerance), math.inf if max_nodes is None else max_nodes)
        log = _Log() if verbose else None
        return search.run(lambda: bool((log is not None and log(search)) or (callback and callback(search))))


class BranchAndBound:
    """The nodes of a search, the open ones in order of their bounds.

    Attributes
    ----------
    nodes : int
        How many were branched on.
    """

    def __init__(self, problem: EquilibriumProgram, tolerance: float, max_nodes: float) -> None:
        self.clock, self.nodes = Clock(ALONE), 0
        self.strengthened = strengthened(problem)
        self.problem, self.tolerance, self.max_nodes = self.strengthened.problem, tolerance, max_nodes
        self.relaxations = Relaxations(self.problem, tolerance)
        self.local = LocalSearch(self.relaxations)
        self.tree: list[Node] = []
        self.descent: tuple[Cases, QPUnboundedness] | None = None
        self._open: list[tuple[float, int, Node]] = []
        self._current: Node | None = None  # open, too
        self._closed_at = math.inf  # the least bound of the leaves that are closed
        self._is_stuck = False
        self._gains: dict[tuple[int, int], list[float]] = defaultdict(list)

    @property
    def value(self) -> float:
        """The objective of the best solution found, ∞ without one."""
        return self.local.value

    @property
    def lower_bound(self) -> float:
        """What no solution is below."""
        waiting = [bound for bound, _, _ in self._open[:1]] + ([] if self._current is None else [self._current.bound])
        return min([self._closed_at, self.value, *waiting])

    @property
    def cutoff(self) -> float:
        """A bound that closes a node."""
        return self.value - SHARE * self.tolerance * max(1.0, abs(self.value)) if self.value < math.inf else math.inf

    def run(self, ends: Callable[[], bool]) -> EquilibriumResult:
        """Return the result, once no node is open, or something ends the search."""
        ended: Status | None = None
        try:
            self._current = self.relaxations.node(self.problem.all_cases)
            self.tree.append(self._current)
            self.local.start(self._current)
            while self._next() is not None and self.descent is None:
                if (ended := self._limit(ends)) is not None:
                    break
                self._branch()
        except KeyboardInterrupt:
            ended = Status.INTERRUPTED
        return self._result(ended)

    def _limit(self, ends: Callable[[], bool]) -> Status | None:
        """Return which limit ends the search now, or None."""
        if self.nodes >= self.max_nodes:
            return Status.MAX_ITERATIONS
        if is_over():
            return Status.MAX_SECONDS
        return Status.INTERRUPTED if ends() else None

    def _next(self) -> Node | None:
        """Return the node to go on with, closing those that cannot hold anything better."""
        while self._current is not None or self._open:
            if self._current is None:
                self._current = heapq.heappop(self._open)[2]
            if self._current.bound < self.cutoff:
                return self._current
            self._close(self._current)
        return None

    def _close(self, node: Node) -> None:
        self._closed_at, self._current = min(self._closed_at, node.bound), None

    def _branch(self) -> None:
        node = self._current
        assert node is not None
        assert node.point is not None
        pair = self._pair(node)
        if pair < 0:  # complementary
            self.local.descend(self.problem.nearest(node.point, node.cases))
            if node.bound >= self.cutoff:
                return
            if node.is_piece:
                self._settle(node)
                return
            pair = int(np.argmax(case_counts(node.cases)))
        self.nodes += 1
        children = []
        for case in CASES:
            if node.cases[pair] & case:
                cases = node.cases.copy()
                cases[pair] = case
                child = self.relaxations.node(cases, node)
                if math.isfinite(node.bound) and math.isfinite(child.bound):
                    self._gains[pair, case].append(child.bound - node.bound)
                children.append(child)
        children.sort(key=lambda child: child.bound)
        self.tree += children
        node.pair = pair  # last: Ctrl-C may come between any two lines, and the leaves have to hold all pieces
        self._current = None
        dives = children[0].bound < self.cutoff and children[0].point is not None
        for k, child in enumerate(children):
            if child.bound >= self.cutoff:
                self._close(child)
            elif k or not dives:
                heapq.heappush(self._open, (child.bound, len(self.tree) - k, child))
        if dives:
            if self.nodes % EVERY == 0:
                self.local.start(children[0])
            self._current = children[0]

    def _pair(self, node: Node) -> int:
        """Return the pair to branch on, −1 where the relaxation's point violates none that is open."""
        x = node.point
        assert x is not None
        violations = self.problem.violations(x)
        is_wrong = violations > MET * (1.0 + np.abs(x[self.problem.first]))
        wrong = np.flatnonzero((case_counts(node.cases) > 1) & is_wrong)
        if not wrong.size:
            return -1
        scores = np.array([self._score(int(pair)) for pair in wrong])
        new = np.flatnonzero(np.isnan(scores))
        if new.size:
            return int(wrong[new[np.argmax(violations[wrong[new]])]])
        return int(wrong[np.argmax(scores)])

    def _score(self, pair: int) -> float:
        """Return the product of what the cases of a pair have gained on average, NaN where that is not known."""
        means = [float(np.mean(self._gains[pair, case])) for case in CASES if self._gains.get((pair, case))]
        return math.prod(max(mean, LEAST_GAIN) for mean in means) if len(means) > 1 else math.nan

    def _settle(self, piece: Node) -> None:
        """Close a piece that is neither solved to its bound nor refuted: it falls for ever, or nothing is known."""
        program = self.relaxations.program(piece.cases)
        proof = None if program is None else program.proof_of_no_minimum
        if isinstance(proof, QPUnboundedness):
            self.descent = piece.cases, proof
        self._is_stuck = self._is_stuck or piece.bound < self.cutoff
        self._close(piece)

    def _result(self, ended: Status | None) -> EquilibriumResult:
        best = self.local.best
        # of the leaves: of what is open Ctrl-C may have lost a node that was being moved
        lower = min([self.value, *(node.bound for node in self.tree if node.pair < 0)]) if self.tree else -math.inf
        gap = 0.0 if self.value == lower else self.value - lower
        if self.descent is not None:
            status, lower = Status.UNBOUNDED, -math.inf
        elif best is not None and gap <= self.tolerance * max(1.0, abs(self.value)):
            status = Status.SOLVED
        elif ended is not None:
            status = ended
        else:
            is_excluded = best is None and lower == math.inf and not self._is_stuck
            status = Status.STALLED
            if is_excluded:
                status = Status.INFEASIBLE if self._is_infeasible_without_cuts() else Status.NO_SOLUTION
        is_stationary = True if status is Status.SOLVED else None
        if status is Status.STALLED or status is ended:
            is_stationary = self.local.is_stationary()
        value = -math.inf if status is Status.UNBOUNDED else self.value
        x = None if best is None or status is Status.UNBOUNDED else best.point
        return EquilibriumResult(
            self.strengthened, status, x, value, lower, is_stationary, self.nodes, self.relaxations.solved,
            self.clock.read(), self.tolerance, tuple(self.tree), self.descent,
        )

    def _is_infeasible_without_cuts(self) -> bool:
        """Return whether the linear constraints are refuted, where all are with the cuts, which hold of solutions."""
        original = self.strengthened.original
        if len(self.tree) > 1 or self.problem is original:
            return len(self.tree) == 1
        return Relaxations(original, self.tolerance).solved_node(original.all_cases).bound == math.inf


class _Log:
    """Prints a search while it goes on."""

    def __init__(self) -> None:
        self._next = 0.0
        print(f"{'nodes':>8} {'open':>7} {'value':>17} {'bound':>17} {'gap':>9} {'seconds':>9}", flush=True)

    def __call__(self, search: BranchAndBound) -> bool:
        if search.nodes >= self._next:
            self._next = max(search.nodes + 1, search.nodes * GROWTH)
            is_found = math.isfinite(search.value)
            gap = (search.value - search.lower_bound) / max(1.0, abs(search.value)) if is_found else math.inf
            print(f"{search.nodes:>8} {len(search._open) + 1:>7} {search.value:>17.9g} {search.lower_bound:>17.9g} "
                  f"{gap:>9.1e} {search.clock.read():>9.2f}", flush=True)
        return False
