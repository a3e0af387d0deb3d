"""Solutions early: from given values, from followers solved for fixed leaders, and from piece to piece downhill.

A solution belongs to one piece or more. The least point of a piece is no worse than any solution in it, so that cases
are all that a start has to give; where pairs are degenerate there, a neighbouring piece may be better still.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from ...auto import solve_lcp
from ...core.checks import BoolVector, FloatVector
from ...core.deadline import is_over, seconds_left
from ...core.errors import LCPError
from ...core.lcp import LCP
from ...core.settings import Status
from .equilibrium_program import BETWEEN, CASES, LOWER, Cases, EquilibriumProgram
from .relaxations import Node, Relaxations

MEETS = 1e-7  # beside 1 + ‖x‖∞: a case that x belongs to
DESCENT = 1e-9  # of 1 + |f|
MOST_BIACTIVE = 12
NEAR, MOST_DOUBTFUL = (
    1e-5,
    6,
)  # beside 1 + ‖x‖∞: pairs of another solver's point whose case is in doubt
MOST_NEIGHBOURS = 50
MOST_CORNERS = 4  # leaders of whose bounds all combinations are tried
FOLLOWING = (
    "interior_point",
    "lemke",
)  # the program that followers solve, where there is one; else one path of pivots
UNBOUNDED = 1.0  # from the one bound that a leader has: where a start lies


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
        self._followed: Iterator[FloatVector | None] | None = None

    @property
    def value(self) -> float:
        """Its objective, ∞ as long as there is none."""
        return math.inf if self.best is None else self.best.value

    def offer(self, cases: Cases, near: FloatVector | None = None) -> Node:
        """Return the piece of these cases, one a pair, solved; keep it where it is the best.

        Where pieces are not convex, or hold integers, it is solved near a point.
        """
        is_local = not self.problem.is_provable
        key = cases.tobytes() + (near.tobytes() if is_local and near is not None else b"")
        if key not in self._known:
            if is_local and near is not None:
                piece = self.relaxations.local_node(cases, near)
            else:
                piece = self.relaxations.solved_node(cases)
            self._known[key] = piece
            if piece.value < self.value:
                self.best = piece
        return self._known[key]

    def descend(self, cases: Cases, near: FloatVector) -> Node:
        """Return the last of the pieces from these cases on, each with a smaller value than the one before.

        The next one takes another case of pairs that are degenerate (z at a bound and w = 0) at the piece's solution:
        of all to which its multipliers promise a descent, or else of one of these after the other.
        """
        piece = self.offer(cases, near)
        while (better := self._better_neighbour(piece)) is not None:
            piece = better
        return piece

    def from_point(self, x: FloatVector, cases: Cases | None = None) -> Node | None:
        """Return the last piece of a descent from the cases that a point is nearest to; None where it has no value."""
        nearest = self.problem.nearest(x, self.problem.all_cases if cases is None else cases)
        piece = self.descend(nearest, x)
        return piece if piece.value < math.inf else None

    def from_leaders(self, guess: FloatVector | None, most: int | None = None) -> None:
        """Descend from equilibria of the followers, leaders fixed here and there; at the next so many places."""
        if self._followed is None:
            self._followed = followers_solved(self.problem, guess)
        for x in itertools.islice(self._followed, most):
            if x is not None:
                self.from_point(x)
            if is_over():
                return

    def confirm(self, x: FloatVector, value: float) -> None:
        """Descend from the cases of a point that others found, and from others near it, until the value is reached."""
        self.from_point(x)
        near = self.problem.distances(x) <= NEAR * (1.0 + float(np.abs(x).max(initial=0.0)))
        chosen = self.problem.nearest(x, self.problem.all_cases)
        doubtful = np.flatnonzero(near.sum(axis=0) > 1)[:MOST_DOUBTFUL]
        choices = [
            [case for case, is_near in zip(CASES, near[:, i], strict=True) if is_near]
            for i in doubtful
        ]
        for cases in itertools.product(*choices):
            if self.value <= value or is_over():
                return
            chosen[doubtful] = cases
            self.descend(chosen.copy(), x)

    def _better_neighbour(self, piece: Node) -> Node | None:
        if piece.value == math.inf:
            return None
        promising = self._promising(piece)
        for chosen in ([promising] if len(promising) > 1 else []) + [
            [one] for one in promising[:MOST_NEIGHBOURS]
        ]:
            if is_over():
                return None
            cases = piece.cases.copy()
            for i, case in chosen:
                cases[i] = case
            neighbour = self.offer(cases, piece.point)
            if neighbour.value < piece.value - DESCENT * (1.0 + abs(piece.value)):
                return neighbour
        return None

    def _promising(self, piece: Node) -> list[tuple[int, int]]:
        """Return (pair, case) of other cases of degenerate pairs towards which the objective falls, the steepest first.

        By the multipliers of the piece: where there is none, its solution is strongly stationary. All of them where
        multipliers are not known.
        """
        assert piece.point is not None
        others = self._other_cases(piece.point, piece.cases)
        if piece.dual is None:
            return others
        problem, program = self.problem, self.problem.program
        slope = program.matrices.gradient @ np.concatenate([piece.point, piece.dual[1]]) + program.c
        size = MEETS * (1.0 + float(np.abs(program.c).max(initial=0.0)))
        found = []
        for i, case in others:
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
        return [
            (int(i), CASES[k])
            for k, i in zip(rows, pairs, strict=True)
            if CASES[k] != cases[i] and CASES[k] & self.problem.all_cases[i]
        ]

    def is_stationary(self) -> bool | None:
        """Return whether the best point is B-stationary: least on every piece that holds it; None where these are many.

        Then it is a local minimum, integers fixed.
        """
        if self.best is None or self.best.point is None:
            return None
        if self.best.dual is not None and not self._promising(self.best):
            return True
        best, value, choices = self.best, self.best.value, dict[int, list[int]]()
        for i, case in self._other_cases(self.best.point, self.best.cases):
            choices.setdefault(i, [int(self.best.cases[i])]).append(case)
        if len(choices) > MOST_BIACTIVE or is_over():
            return None
        for chosen in itertools.product(*choices.values()):
            cases = best.cases.copy()
            cases[list(choices)] = chosen
            if self.offer(cases, best.point).value < value - DESCENT * (1.0 + abs(value)):
                return False
        return True


def followers_solved(
    problem: EquilibriumProgram, guess: FloatVector | None
) -> Iterator[FloatVector | None]:
    """Yield equilibria of the followers: leaders at the guess, in the middle of their bounds, at corners.

    None where none was found. Followers are what rows and pairs determine; nothing is yielded where smooth rows are
    among them.
    """
    if problem.smooth is not None and problem.smooth.lower.size:
        return
    is_leader = leaders(problem)
    if is_leader is None:
        return
    lower, upper = (end[is_leader] for end in problem.bounds(problem.all_cases))
    low = np.where(np.isfinite(lower), lower, np.minimum(upper - UNBOUNDED, 0.0))
    high = np.where(np.isfinite(upper), upper, np.maximum(low + UNBOUNDED, 0.0))
    middle = 0.5 * (low + high)
    wishes = [middle, low, high]
    if guess is not None:
        wishes.insert(0, np.clip(guess[is_leader], lower, upper))
    if 1 < low.size <= MOST_CORNERS:
        wishes += [
            np.where(high_ones, high, low)
            for high_ones in itertools.product((False, True), repeat=low.size)
        ]
    is_whole = np.zeros(is_leader.size, dtype=bool)
    is_whole[problem.integers] = True
    for wish in wishes:
        yield _followed(problem, is_leader, np.where(is_whole[is_leader], np.rint(wish), wish))


def leaders(problem: EquilibriumProgram) -> BoolVector | None:
    """Return which variables rows and pairs leave open, shape (n,); None where they are no complementarity problem.

    Each row and each pair is matched with a variable, those that rather follow first: sides of pairs, then what has the
    fewest bounds; what is left leads.
    """
    program, k = problem.program, problem.pairs
    A, n = sp.coo_array(sp.csr_array(program.A)), program.n
    if A.shape[0] + k > n or np.unique(problem.first).size < k:
        return None
    is_paired = np.zeros(n, dtype=bool)
    is_paired[problem.first] = is_paired[problem.second] = True
    bounds = np.isfinite(program.lower).astype(int) + np.isfinite(program.upper)
    weight = np.where(is_paired, 1.0, 2.0 + 4.0 * bounds)
    weight[problem.integers] = 100.0
    rows = np.concatenate([A.row, A.shape[0] + np.arange(k), A.shape[0] + np.arange(k)])
    columns = np.concatenate([A.col, problem.first, problem.second])
    place = np.unique(rows * n + columns)
    if not place.size:
        return np.ones(n, dtype=bool)
    graph = sp.csr_array((weight[place % n], (place // n, place % n)), shape=(A.shape[0] + k, n))
    try:
        _, matched = min_weight_full_bipartite_matching(graph)
    except ValueError:  # some rows and pairs have fewer variables than they are
        return None
    is_leader = np.ones(n, dtype=bool)
    is_leader[matched] = False
    return is_leader if not is_leader[is_paired].any() else None


def _followed(
    problem: EquilibriumProgram, is_leader: BoolVector, values: FloatVector
) -> FloatVector | None:
    """Return x with the followers' complementarity problem solved for these values of the leaders."""
    program, k, n = problem.program, problem.pairs, problem.program.n
    own = np.flatnonzero(~is_leader)
    place = np.full(n, -1)
    place[own] = np.arange(own.size)
    x = np.zeros(n)
    x[is_leader] = values
    A = sp.csr_array(program.A)
    # z ⟂ w, and the rows go with the followers that are the z of no pair
    z, w = place[problem.first], place[problem.second]
    others = np.setdiff1d(np.arange(own.size), z)
    pairs = sp.csr_array((np.ones(k), (z, w)), shape=(own.size, own.size))
    M = sp.csr_array(
        pairs
        + sp.csr_array(
            (np.ones(others.size), (others, np.arange(others.size))), shape=(own.size, A.shape[0])
        )
        @ A[:, own]
    )
    q, lower, upper = np.zeros(own.size), np.full(own.size, -np.inf), np.full(own.size, np.inf)
    q[others], lower[z], upper[z] = A @ x - program.b, problem.lower, problem.upper
    followers = LCP(M, q, lower=lower, upper=upper)
    for name in FOLLOWING:
        limit = seconds_left()
        try:
            seconds = None if math.isinf(limit) else limit
            found = solve_lcp(followers, name, prove_infeasibility=False, max_seconds=seconds)
        except LCPError:
            continue
        if found.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if found.status in (Status.SOLVED, Status.PRECISION_LIMIT):
            x[own] = found.z
            return x
    return None
