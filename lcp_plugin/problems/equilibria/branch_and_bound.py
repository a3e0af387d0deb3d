"""minimize_over_solutions(): the best solution by SCIP and by branch and bound.

The search begins with a few built-in nodes, because they close many small problems with a proof, whereas SCIP may
search long, or fail. If SCIP is installed, it searches next. The branches of its point define a complementarity
piece, which is solved again here. More built-in nodes follow if the user requests a proof, if SCIP is not
installed, or if SCIP reports that no solution or no least solution exists, which needs a proof. A node leaves
several branches of each pair open. Each child of a node takes one branch of the pair that the relaxation of the
node violates most. The search dives: it continues with the child of the lowest bound, and when a dive ends, with
the lowest bound of all open nodes.

References
----------
J. Hu, J. E. Mitchell, J.-S. Pang, K. P. Bennett, G. Kunapuli, *On the global solution of linear programs with linear
complementarity constraints*, SIAM Journal on Optimization 19 (2008), doi:10.1137/07068463x.

Early solutions follow from the values of a start, and from points of relaxations. A solution belongs to at least one
piece. The minimizer of a piece is not worse than any solution in the piece, so a start only determines branches.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core import deadline
from ...core.checks import Vector, is_number, vector_option
from ...core.errors import InvalidOption, UnsupportedModel
from ...core.settings import PROVEN, Status, checked_callback, checked_tolerance
from ...solving.run import Budget, Named, Stage
from ..programs.no_minimum import QPUnboundedness, known_proof
from .equilibrium_program import Cases, EquilibriumProgram, branches
from .relaxations import ENDS, EquilibriumResult, ExternalBound, Node, Relaxations
from .scip import minimize_or_none


@np.errstate(all="ignore")
def minimize_over_solutions(
    problem: EquilibriumProgram,
    *,
    tolerance: float = 1e-6,
    max_nodes: int | None = None,
    max_seconds: float | None = None,
    callback: Callable[[BranchAndBound], Any] | None = None,
    verbose: bool = False,
    x0: ArrayLike | None = None,
    prove: bool = False,
) -> EquilibriumResult:
    """Return the best solution of a program with complementarity constraints, and a lower bound.

    Parameters
    ----------
    problem : EquilibriumProgram
    tolerance : float
        SOLVED means that value − bound is at most the tolerance times the terms of the objective at x.
    max_nodes : int, optional
        Maximum number of branched nodes.
    max_seconds : float, optional
        Wall-clock limit in seconds; the result then contains the best solution so far.
    callback : callable, optional
        Called with the search, with ``value``, ``lower_bound`` and ``nodes``, after each node; a true return value
        ends the search.
    verbose : bool
        Print a line at geometric intervals: nodes, value, bound, gap, seconds.
    x0 : array, shape (n,), optional
        Starting point. If it is a solution, the result is not worse.
    prove : bool
        If True, the bound is proved here, even if SCIP is installed.

    Returns
    -------
    EquilibriumResult
        ``bound_by`` is "proof" for a rigorous bound and "SCIP" for SCIP's bound in floating point.

    Raises
    ------
    UnsupportedModel
        If prove is True and pieces are not convex, or if SCIP does not support a function.
    InvalidOption
        If the tolerance is not between 0 and 1, a limit is negative, or the problem belongs to another class.

    Notes
    -----
    Built-in bounds are rigorous for the stored floating-point data. Multipliers that are checked in rational
    arithmetic prove every infeasible node, and ``result.verify()`` checks all proofs again. The worst case is 2ᵏ nodes
    for k pairs. SCIP (``pip install '.[global]'``) also accepts objectives that are not convex, smooth rows
    and integers.

    Examples
    --------
    >>> import numpy as np
    >>> from lcp_plugin import EquilibriumProgram, QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 0]], [-2, 1], lower=[-np.inf, 0])  # (x − 1)² + y − 1
    >>> problem = EquilibriumProgram.of_rows(program, [1], [[-1, 1]], [0.5])       # 0 ≤ y ⟂ y − x + ½ ≥ 0
    >>> result = minimize_over_solutions(problem, prove=True)
    >>> result.status.name, round(result.value, 9), result.x.round(9), result.bound_by, result.verify()
    ('SOLVED', -0.75, array([0.5, 0. , 0. ]), 'proof', True)
    """
    if not isinstance(problem, EquilibriumProgram):
        raise InvalidOption(
            f"minimize_over_solutions needs an EquilibriumProgram, got {type(problem).__name__}; solve takes every kind"
        )
    checked_tolerance(tolerance, may_be_zero=False)
    checked_callback(callback)
    for name, limit in {"max_nodes": max_nodes, "max_seconds": max_seconds}.items():
        if limit is not None and not (is_number(limit) and limit >= 0):
            raise InvalidOption(f"{name} must be a number ≥ 0, got {limit!r}")
    if prove and not problem.is_provable:
        _refuse_proof(problem)
    search = BranchAndBound(problem, float(tolerance), math.inf if max_nodes is None else max_nodes)
    limit = math.inf if max_seconds is None else float(max_seconds)
    if x0 is not None:  # the result is not worse than the start
        search.start = vector_option(x0, "x0", problem.program.n)
        with deadline.limit(max(limit, 1.0)):  # seconds, for its piece
            search.solve_nearest_piece(search.start)
    with deadline.limit(limit):
        if verbose:
            print(f"{'nodes':>8} {'value':>17} {'bound':>17} {'gap':>9} {'seconds':>9}", flush=True)
        watchers = [*[BranchAndBound.print_line] * verbose, *filter(None, [callback])]
        return search.run(lambda: any([bool(watcher(search)) for watcher in watchers]), prove)


def _refuse_proof(problem: EquilibriumProgram) -> None:
    what = "integers" if problem.integers.size else "a smooth part that is not quadratic"
    if problem.smooth is None and not problem.has_convex_objective:
        what = "an objective that is not convex"
    raise UnsupportedModel(
        f"prove=True needs affine rows, a convex quadratic objective and no integers, and this problem has {what}; "
        "leave it out: the bound is SCIP's then"
    )


def planned(problem: EquilibriumProgram) -> tuple[str, Any, list[Stage]]:
    """Return the matrix and the stages of a program with pairs for `analyze`."""
    own, has_scip = Named("branch and bound"), minimize_or_none() is not None
    budget = Budget(f"{_nodes_before_scip(problem)} nodes" if has_scip else "")
    stages = [Stage(own, "each node bounds several pieces, with a proof of its bound", budget)]
    if not problem.is_provable:
        stages = [] if has_scip else [Stage(own, "some pieces alone: SCIP is not installed")]
    if has_scip:
        because = "a bound in floating point, also of objectives that are not convex"
        stages.append(Stage(Named("SCIP"), because))
    return "P", problem.program.P, stages


def _nodes_before_scip(problem: EquilibriumProgram) -> int:
    """Return the nodes of the search here, before SCIP: 9 nodes close 30 pairs that take SCIP 5 s."""
    return 300 // max(1, problem.pairs)


class BranchAndBound:
    """Branch and bound; the open nodes are sorted by their bounds.

    It is one class because each step changes the open nodes, the best piece and the bound together.

    Attributes
    ----------
    nodes : int
        Number of branched nodes, including SCIP's.
    best : Node or None
        The piece whose solution has the least objective.
    """

    def __init__(self, problem: EquilibriumProgram, tolerance: float, max_nodes: float) -> None:
        self.clock, self.nodes = deadline.Clock(), 0
        self.problem, self.tolerance, self.max_nodes = problem, tolerance, max_nodes
        self.relaxations = Relaxations(problem, tolerance)
        self.best = Node(problem.all_cases)  # without a point yet, of value ∞
        self._solved_pieces: set[bytes] = set()
        self.start: Vector | None = None
        self.outside: ExternalBound | None = None
        self._outside_value = math.inf  # of SCIP's point, until it is confirmed
        self.descent: tuple[Cases, QPUnboundedness] | None = None
        self._is_infeasible = self._is_stuck = False
        self.tree: list[Node] = []
        self._open: list[tuple[float, int, Node]] = []
        self._current: Node | None = None  # open, too
        self._next_line = 0.0
        self._closed_at = math.inf  # the least bound of the leaves that are closed

    def print_line(self) -> None:
        """Print a line of progress, at geometric intervals."""
        if self.nodes >= self._next_line:
            # Half as many nodes again to the next line
            self._next_line = max(self.nodes + 1, self.nodes * 1.5)
            gap = self.value - self.lower_bound if math.isfinite(self.value) else math.inf
            numbers = f"{self.value:>17.9g} {self.lower_bound:>17.9g} {gap:>9.1e}"
            print(f"{self.nodes:>8} {numbers} {self.clock.read():>9.2f}", flush=True)

    @property
    def value(self) -> float:
        """Objective of the best solution; ∞ before the first solution."""
        return min(self.best.value, self._outside_value)

    @property
    def lower_bound(self) -> float:
        """Lower bound of the objective over all solutions."""
        open_nodes = *(node for *_, node in self._open[:1]), self._current
        bounds = (node.bound for node in open_nodes if node is not None)
        bound = min([self._closed_at, *bounds])
        outside = -math.inf if self.outside is None else self.outside.bound
        return min(self.value, max(bound if self.tree else -math.inf, outside))

    @property
    def cutoff(self) -> float:
        """The least bound that closes a node."""
        # A node is closed if its bound is this close to the best value
        return self.best.value - 0.5 * self.allowed

    @property
    def allowed(self) -> float:
        """The gap within the tolerance, relative to the objective terms of the incumbent."""
        point = self.best.point
        return 0.0 if point is None else self.tolerance * self.problem.objective_size(point)

    def run(self, ends: Callable[[], bool], prove: bool) -> EquilibriumResult:
        """Run the search until the gap is closed or a limit is reached, and return the result."""
        try:
            ended = self._run(ends, prove)
        except KeyboardInterrupt:
            ended = Status.INTERRUPTED
        return self._result(ended)

    def _run(self, ends: Callable[[], bool], prove: bool) -> Status | None:
        engine, is_provable = minimize_or_none(), self.problem.is_provable
        if is_provable:
            most = math.inf if engine is None else _nodes_before_scip(self.problem)
            ended = self._search(ends, most)
            is_done = self.descent is not None or (self._next() is None and not self._is_stuck)
            if ended is not None or is_done:
                return ended
        if self.best.point is None:
            self._try_decisions()
        if engine is None:
            return None
        ended = self._run_scip(engine, ends)
        is_closed = self.best.value - self.lower_bound <= self.allowed
        if ended is not None or (is_closed and not prove):
            return ended
        seems_infeasible = self.outside is not None and self.outside.status == "infeasible"
        if is_provable or (self.problem.is_convex and seems_infeasible):  # integers or not
            # A proof of SCIP's status may be too expensive
            return self._search(ends, math.inf if prove else 2000)
        # SCIP's bound of an objective of 0 has a rounding error.
        if self.problem.has_convex_relaxation and not self.tree:
            self._root()
        return None

    def _root(self) -> None:
        """Solve the relaxation with all branches open."""
        self._current = root = self.relaxations.node(self.problem.all_cases)
        self.tree.append(root)
        self._is_infeasible = root.bound == math.inf
        if root.point is not None:
            self.solve_nearest_piece(root.point)

    def _try_decisions(self) -> None:
        """Look for a first point: the pairs solved at the start, at the bounds and at the relaxation's decision."""
        program = self.problem.program
        nearest = np.clip(0.0, program.lower, program.upper)
        ends = [np.where(np.isfinite(end), end, nearest) for end in (program.lower, program.upper)]
        if self.problem.has_convex_relaxation and not self.tree:
            self._root()
        for x in (self.start, *(root.point for root in self.tree[:1]), *ends):
            if deadline.is_over() or self.best.point is not None:
                return
            point = None if x is None else self.problem.answer(self.relaxations.projected(x))
            if point is not None:
                self.solve_nearest_piece(point)

    def _run_scip(self, engine: Callable[..., Any], ends: Callable[[], bool]) -> Status | None:
        """Run a global solver and store its result; return the status of a limit, or None."""
        before = self.nodes

        def report_progress(value: float, bound: float, nodes: int) -> bool:
            self.nodes, self._outside_value = before + nodes, value
            self.outside = ExternalBound("", bound)
            return ends()

        result = engine(self.problem, self.tolerance, self.max_nodes, report_progress)
        self.nodes, self._outside_value = before + result.nodes, math.inf
        self.outside = ExternalBound(result.status, result.bound)
        if result.x is not None:
            self.solve_nearest_piece(result.x)
        if self.best.value < result.bound - self.allowed:  # a better point refutes the bound
            self.outside = ExternalBound(result.status, -math.inf)
        return ENDS.get(result.status)

    def _search(self, ends: Callable[[], bool], most: float) -> Status | None:
        """Branch on at most `most` nodes; return the status of a limit reached, or None."""
        if not self.tree:
            self._root()
        last = self.nodes + most
        while self.nodes < last and self.descent is None and (node := self._next()) is not None:
            if self.nodes >= self.max_nodes:
                return Status.MAX_ITERATIONS
            if deadline.is_over():
                return Status.MAX_SECONDS
            if ends():
                return Status.INTERRUPTED
            self._branch(node)
        return None

    def _next(self) -> Node | None:
        """Return the node to continue with; close nodes whose bounds exclude a better solution."""
        while self._current is not None or self._open:
            if self._current is None:
                self._current = heapq.heappop(self._open)[2]
            if self._current.bound < self.cutoff:
                return self._current
            self._close(self._current)
        return None

    def _close(self, node: Node) -> None:
        self._closed_at, self._current = min(self._closed_at, node.bound), None

    def _branch(self, node: Node) -> None:
        assert node.point is not None
        pair = self._pair(node.cases, node.point)
        if pair < 0:  # complementary
            self.solve_nearest_piece(node.point, node.cases)
            if node.bound >= self.cutoff:
                return
            if node.is_piece:
                self._settle(node)
                return
            pair = int(np.argmax(np.bitwise_count(node.cases)))
        self.nodes += 1
        children = [self.relaxations.node(cases, node) for cases in branches(node.cases, pair)]
        children.sort(key=lambda child: child.bound)
        self.tree += children
        node.pair = pair  # last, because Ctrl-C may come between any two lines and the leaves must cover all pieces
        self._current = None
        for k, child in enumerate(children):
            if child.bound >= self.cutoff:
                self._closed_at = min(self._closed_at, child.bound)
            elif k or child.point is None:
                heapq.heappush(self._open, (child.bound, len(self.tree) - k, child))
            else:
                self._current = child

    def _pair(self, cases: Cases, x: Vector) -> int:
        """Return the pair to branch on; −1 if the relaxation's point x violates no undecided pair."""
        violations = self.problem.violations(x)
        # Such a pair counts as complementary
        is_wrong = violations > 1e-9 * (1.0 + np.abs(x[self.problem.first]))
        is_wrong &= np.bitwise_count(cases) > 1
        return int(np.argmax(np.where(is_wrong, violations, 0.0))) if is_wrong.any() else -1

    def _settle(self, piece: Node) -> None:
        """Close a piece that is not solved to its bound: it is unbounded below or undecided."""
        program = self.relaxations.program(piece.cases)
        proof = None if program is None else known_proof(program)
        if isinstance(proof, QPUnboundedness):
            self.descent = piece.cases, proof
        self._is_stuck |= piece.bound < self.cutoff
        self._close(piece)

    def solve_nearest_piece(self, x: Vector, cases: Cases | None = None) -> None:
        """Solve the piece of the open branches nearest to x, and keep its solution if it is the best.

        A piece that is not convex, or has integers, is solved near x.
        """
        cases = self.problem.nearest(x, self.problem.all_cases if cases is None else cases)
        is_local = not self.problem.is_provable
        key = cases.tobytes() + x.tobytes() * is_local
        if key not in self._solved_pieces:
            solve = self.relaxations
            piece = solve.local_node(cases, x) if is_local else solve.solved_node(cases)
            self._solved_pieces.add(key)
            if piece.value < self.best.value:
                self.best = piece

    def _result(self, ended: Status | None) -> EquilibriumResult:
        value = self.best.value  # ∞ without a point
        # The bound is computed from the leaves, because Ctrl-C may have removed a node from the heap.
        bounds = [node.bound for node in self.tree if node.pair < 0]
        lower = min([value, *bounds]) if self.tree else -math.inf
        bound_by = "proof" if lower > -math.inf else None
        is_open = value < math.inf and value - lower > self.allowed
        if self.outside is not None and is_open and self.outside.bound > lower:
            lower, bound_by = min(self.outside.bound, value), "SCIP"
        if self.descent is not None:
            status, bound_by, lower, value = Status.UNBOUNDED, None, -math.inf, -math.inf
        elif value < math.inf and value - lower <= self.allowed:
            status = Status.SOLVED
        elif ended is not None:
            status = ended
        elif value < math.inf or lower < math.inf or self._is_stuck:
            status = Status.STALLED
        else:
            status = Status.INFEASIBLE if self._is_infeasible else Status.NO_SOLUTION
        is_own = self.outside is None or self.tree
        by = ["SCIP"] * (self.outside is not None) + ["branch and bound"] * bool(is_own)
        point = self.best.point
        if status in PROVEN:
            point = np.full(self.problem.program.n, np.nan)
        outcome = point, value, lower, bound_by, self.relaxations.solved, tuple(self.tree)
        fields: Any = {"status": status, "algorithm": ", ".join(by), "tolerance": self.tolerance}
        fields |= {"iterations": self.nodes, "seconds": self.clock.read()}
        return EquilibriumResult(self.problem, *outcome, self.descent, self.outside, **fields)
