"""Interior point for monotone problems, with the active set guessed early and solved for at the end."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.algorithm import Algorithm, Step, without_warnings
from ...core.certificates.criterion import reference_residual
from ...core.certificates.row_residuals import scaled_residual
from ...core.checks import BoolVector, FloatVector
from ...core.deadline import is_over
from ...core.lcp import LCP
from ...core.tuning import SWEEPS_FIRST_UP_TO
from .attempts import ATTEMPTS
from .newton_matrix import NewtonMatrix
from .predictor_corrector import PredictorCorrector, Standstill, Starts
from .primal_active_set import PrimalActiveSet
from .quasidefinite import newton_matrix
from .suited_matrix import known_before, sizes_of_components, suited

SWEEPS_AT_ONCE = (10, 5)  # small or not
MOST_SWEEPS = 60
SETTLED = 0.005  # share of the rows that may still have changed sides when sweeping stops
FIRST_GUESS = (200, 1.0)  # changes of the first active set, 200 + n, that cost less than a dozen interior steps
LATER_GUESS = (10, 0.02)
EARLIEST_GUESS = 3
MOST_ITERATIONS = 150
MUCH_SMALLER = 0.1
CLOSED_GAP = 1e-20  # of the first gap: nothing is hidden any more
POLISHED_GAP = 1e-4  # of the first gap, no active set is looked for before; then each step is looked at
MOST_POLISHES = 12
POLISHING_ROUNDS = 4
NEAR, MOST_HELD = 1e-6, 30  # of the residual of z°; steps
FINISHED = 1e-12  # of the residual of z°: what an active set that is solved for leaves
CLASSIFICATIONS = (1.0, 1e-3, 1e3)
SAFE_TO_MULTIPLY = 400  # bits
MISSED, MISSED_FOR = 0.5, 12  # share of the infeasibility that solves leave, until pivots are tried; steps
PINNED = 1e30  # a diagonal that leaves nothing of a row's unknown, beside entries of about 1


@dataclass(frozen=True, kw_only=True)
class InteriorPoint(Algorithm):
    """Infeasible predictor–corrector: Newton on {M z + q = w⁺ − w⁻, (z − lower) w⁺ = (upper − z) w⁻ = μ}, μ → 0.

    Notes
    -----
    For monotone M, symmetric or not, also where its rows are in other units; rows bounded on one side, on both, on
    none, or fixed. Singular blocks are regularised and refined. As soon as the active set looks settled its linear
    system is solved, so that the residual of the answer is at rounding level and not only the gap. On dense symmetric M
    a few projected Gauss–Seidel sweeps guess the active set beforehand, and a primal active set method corrects the
    guess with one Cholesky factor; only where that takes long do interior steps follow, three as a rule, before it
    tries again. Elsewhere a start z0 changes nothing, but for KKT forms of programs.

    References
    ----------
    Mehrotra 1992, doi:10.1137/0802028. Gondzio 1996, doi:10.1007/BF00249643. Friedlander, Orban 2012,
    doi:10.1007/s12532-012-0035-2.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[2, 1], [1, 2]], [-5, 1])
    >>> lcp_plugin.solve(problem, InteriorPoint()).z
    array([2.5, 0. ])
    """

    name: ClassVar[str] = "interior_point"
    needs: ClassVar[str] = "monotone M"
    solves: ClassVar[str] = "– (by experience: PSD, also nonsymmetric)"
    cost: ClassVar[str] = "1 factorisation"
    reference: ClassVar[str] = "Mehrotra 1992, doi:10.1137/0802028"
    is_monotone: ClassVar[bool] = False
    why_no_start: ClassVar[str] = (
        "z0 was not used: interior_point begins from a start where M is dense and symmetric, or that of a program"
    )

    def uses_start(self, problem: LCP, z0: FloatVector) -> bool:
        """Return whether an active set is guessed before interior steps are taken."""
        with np.errstate(over="ignore", invalid="ignore"):
            kept = np.flatnonzero(np.isnan(known_before(problem)))
        of = suited(problem.matrix, None if kept.size == problem.n else kept)
        return of.is_symmetric or of.is_program

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield one step a factorisation, and the solutions of the active sets tried; end where nothing improves."""
        z = np.clip(z0, problem.lower, problem.upper)
        yield Step(z, work=1.0)
        with np.errstate(all="ignore"):
            search = Search(problem)
        yield from without_warnings(search.steps(z))

    def finish(self, problem: LCP, z: FloatVector) -> FloatVector:
        """Return z, or the solution of the linear system of the active set that z shows, where that is better."""
        with np.errstate(all="ignore"):
            left = float(np.max(np.abs(scaled_residual(problem, z, problem.slack(z))), initial=0.0))
            return z if left <= FINISHED * reference_residual(problem) else Search(problem).finished(z)


class Search:
    """The run on the rows that are not fixed, in equilibrated unknowns z = unit · y.

    Attributes
    ----------
    best_z : ndarray, shape (n,)
        The best point of the caller's problem.
    best, reference : float
        Its residual, and that of z°.
    """

    def __init__(self, problem: LCP) -> None:
        self.problem = problem
        q, lower, upper, self.known = problem.q, problem.lower, problem.upper, known_before(problem)
        kept = np.flatnonzero(np.isnan(self.known))
        self.kept = None if kept.size == problem.n else kept
        if self.kept is not None:
            q = (q + problem.M @ np.nan_to_num(self.known))[kept]
            lower, upper = lower[kept], upper[kept]
        self.suited = suited(problem.matrix, self.kept)
        self.M, self.signs, c = self.suited.M, self.suited.signs, self.suited.unit
        q = (q if self.suited.row_factors is None else self.suited.row_factors * q) * c
        size = _unit_of(q, self.M.data if sp.issparse(self.M) else self.M)
        of_z, of_w = sizes_of_components(self.suited, q, lower / c, upper / c)
        self.unit = c * size * of_z
        self.q, self.lower, self.upper = q / size / of_w, lower / self.unit, upper / self.unit
        self.entries = max(float(problem.M.nnz if sp.issparse(problem.M) else problem.M.size), 1.0)
        self.counted = 0.0  # of the primal active set's work
        self.best, self.best_z = np.inf, np.array(problem.nearest_to_zero)
        self.least = self.product = np.inf
        self.reference = reference_residual(problem)

    # --- what the driver sees ---------------------------------------------------------------------------

    def step(self, y: FloatVector, work: float) -> Step:
        """Return the best z so far, with y, projected, taken into account; `work` is what y took."""
        from .kernels.interior_rows import box_residual

        problem = self.problem
        if self.kept is None:
            z = self.unit * y
        else:
            z = self.known.copy()
            z[self.kept] = self.unit * y
        np.minimum(np.maximum(z, problem.lower, out=z), problem.upper, out=z)
        w = problem.slack(z)
        found = box_residual(z, w, problem.lower, problem.upper, problem.residual_scale)
        largest, product = map(float, found)  # the interpreter leaves scalars of numpy
        product = product if self.suited.is_program else 0.0
        if largest < self._allowed(product):
            self.best, self.product, self.best_z = largest, product, z
        self.least = min(self.least, largest)
        return Step(self.best_z, residual=self.best, work=1.0 + work / self.entries)

    def _allowed(self, product: float) -> float:
        """Return below which residual a point is the best: above the least where its product is much smaller."""
        if product < MUCH_SMALLER * self.product:
            return max(self.best, self.least / MUCH_SMALLER)
        return self.best if product <= self.product / MUCH_SMALLER else MUCH_SMALLER * self.best

    @property
    def is_convex(self) -> bool:
        """Whether the problem states a convex program, by the signs of M or as it is symmetric."""
        return self.suited.is_program or self.suited.is_symmetric

    @property
    def is_near(self) -> bool:
        """Whether the best residual is small, and yet that of no active set that was solved for."""
        return FINISHED * self.reference < self.best <= NEAR * self.reference

    # --- the stages -------------------------------------------------------------------------------------

    def steps(self, z0: FloatVector) -> Iterator[Step]:
        """Yield what the driver sees: a guess of the active set where that is cheap, then interior steps."""
        y = (z0 if self.kept is None else z0[self.kept]) / self.unit
        if not y.size:
            yield self.step(y, 0.0)
            return
        primal: PrimalActiveSet | None = None
        if self.suited.is_symmetric:
            primal = PrimalActiveSet(self.M, self.q, self.lower, self.upper)
            yield from self.guessed(primal, y)
        elif self.suited.is_program and not np.array_equal(z0, self.problem.nearest_to_zero):
            yield from self.near(y)  # of a program solved before with other numbers the active set may still be right
        yield from self.interior(primal)

    def guessed(self, primal: PrimalActiveSet, y: FloatVector) -> Iterator[Step]:
        """Sweep until few rows change sides, then correct the active set one row at a time."""
        from .kernels.symmetric_sweeps import dense_sweeps

        n = y.size
        diagonal = self.M.diagonal()
        inverse = np.divide(1.0, diagonal, out=np.zeros(n), where=diagonal > 0.0)
        y, M = y.copy(), primal.M
        sweeps, at_once = 0, SWEEPS_AT_ONCE[n > SWEEPS_FIRST_UP_TO]
        inside, changes = np.zeros(n, dtype=bool), n
        w = M @ y + self.q
        while sweeps < MOST_SWEEPS and changes > SETTLED * n:
            dense_sweeps(M, inverse, self.lower, self.upper, y, w, at_once)
            sweeps += at_once
            before, inside = inside, (self.lower < y) & (y < self.upper)
            changes = int(np.count_nonzero(before != inside))
        primal.start(y, inside)
        if n > SWEEPS_FIRST_UP_TO:
            yield self.step(y, sweeps * self.entries)
        else:  # a step of its own would cost more than it tells
            primal.work += sweeps * self.entries
        yield from self.corrected(primal, self._limit(FIRST_GUESS))

    def corrected(self, primal: PrimalActiveSet, limit: int) -> Iterator[Step]:
        """Yield the steps of the primal active set method, so many changes at the most."""
        for _ in primal.steps(limit):
            yield self.step(primal.z, primal.work - self.counted)
            self.counted = primal.work

    def interior(self, primal: PrimalActiveSet | None) -> Iterator[Step]:
        """Make interior steps and solve for the active sets they lead to; again, otherwise, where a program asks on."""
        weight = _weight_of(primal)
        for attempt in ATTEMPTS if self.suited.is_program else ATTEMPTS[:1]:
            if attempt.ridge:
                self.best = self.least = self.product = np.inf
            matrix = attempt.matrix(self.suited, primal is not None)
            point = PredictorCorrector(matrix, self.q, self.lower, self.upper)
            patience = MOST_ITERATIONS if attempt.is_pivoting or not self.suited.is_program else MISSED_FOR
            has_begun = yield from self._from(point, Starts(attempt.weight * weight), primal, patience)
            if not has_begun:
                return

    def _from(
        self, point: PredictorCorrector, starts: Starts, primal: PrimalActiveSet | None, patience: int
    ) -> Generator[Step, None, bool]:
        """Make steps from a start of that weight until nothing improves; return whether there was a start.

        Nothing does, either, where for so many steps solves leave what is infeasible, which hides the gap.
        """
        if not point.start(starts.weight):
            return False
        standstill, first_gap, counted = Standstill(self.is_convex), point.gap, point.matrix.work
        polishes, steps, held, missing, small_gap = 0, 0, 0, 0, POLISHED_GAP * point.gap
        while steps < MOST_ITERATIONS:
            made = point.advance(1, small_gap)  # the best point may be one that steps go past
            if not made:
                break
            steps += made
            step = self.step(point.z, point.matrix.work - counted)
            # A residual that is small already hides errors beside large multipliers: as long as the gap falls, go on.
            is_falling = point.gap > CLOSED_GAP * first_gap and not is_over()
            held = held + made if self.is_near and is_falling and held < MOST_HELD else 0
            if not held:
                yield step
                counted = point.matrix.work
            if steps == 2 and starts.has_better(point.length):
                steps = 0
                if not point.start(starts.weight):
                    return False
                continue
            is_closed = point.gap <= min(small_gap, point.infeasibility)
            is_missed = is_closed and point.matrix.missed >= MISSED * point.infeasibility
            missing = missing + made if is_missed else 0
            if missing >= patience or standstill.is_reached(made, self.best, point.gap, point.infeasibility):
                break
            if primal is not None:
                if steps >= EARLIEST_GUESS and point.changes <= self._limit(LATER_GUESS):
                    primal.start(np.clip(point.z, self.lower, self.upper), ~point.is_active())
                    yield from self.corrected(primal, self._limit(LATER_GUESS))
                    if primal.is_solved:  # and yet the driver asks on: what is left is a matter of rounding
                        break
                continue
            if point.has_settled and polishes < MOST_POLISHES:
                polishes += 1
                yield from self.polished(point.z, *point.active(1.0))
        for threshold in CLASSIFICATIONS:
            yield from self.polished(point.z, *point.active(threshold))
        yield self.step(point.z, 0.0)
        return True

    def _limit(self, share: tuple[int, float]) -> int:
        return share[0] + int(share[1] * self.q.size)

    def finished(self, z: FloatVector) -> FloatVector:
        """Return the better one of z and what solves for its active set."""
        y = (z if self.kept is None else z[self.kept]) / self.unit
        self.step(y, 0.0)
        if y.size:
            for _ in self.near(y):
                pass
        return self.best_z

    def near(self, y: FloatVector) -> Iterator[Step]:
        """Solve for the active set that y shows."""
        w = self.M @ y + self.q
        is_lower, is_upper = y - self.lower < w, self.upper - y < -w
        at = np.where(is_lower, self.lower, np.where(is_upper, self.upper, 0.0))
        yield from self.polished(y, is_lower | is_upper, at)

    def polished(self, y: FloatVector, active: BoolVector, at: FloatVector) -> Iterator[Step]:
        """Solve the linear system of the active set and correct the set, as long as that improves the residual."""
        y, best = y.copy(), self.best
        for _ in range(POLISHING_ROUNDS):
            y = np.where(active, at, y)
            work = self._solve_for(y, np.flatnonzero(~active))
            if not np.isfinite(y).all():
                return
            step = self.step(y, work)
            if not self.is_near:
                yield step
            w = self.M @ y + self.q
            outside = ~active & ((y < self.lower) | (y > self.upper))
            inwards = active & np.where(at == self.lower, w < 0.0, w > 0.0)
            if not (outside.any() or inwards.any()) or not self.best < best:
                return
            best = self.best
            at = np.where(outside, np.where(y < self.lower, self.lower, self.upper), at)
            active = (active | outside) & ~inwards

    def _solve_for(self, y: FloatVector, free: NDArray[np.intp]) -> float:
        """Change y on the free rows by as little as makes w = 0 there, as well as can be; return the work."""
        if not free.size:
            return 0.0
        is_free, kept = np.zeros(y.size, dtype=bool), free
        is_free[free] = True
        system: NewtonMatrix
        if self.signs is not None and sp.issparse(self.M):  # in the order of all rows, the others pinned
            system, kept = newton_matrix(self.M, False, self.signs, self.suited.symbolic), np.arange(y.size)
        else:
            block = self.M[free][:, free] if sp.issparse(self.M) else self.M[np.ix_(free, free)]
            system = newton_matrix(block, False)
        if not system.factorise(np.where(is_free, 0.0, PINNED)[kept]):
            y[free] = np.nan
            return system.work
        for _ in range(2):
            left, step = np.where(is_free, self.M @ y + self.q, 0.0), np.zeros(y.size)
            step[kept] = system.solve(left[kept])
            y[free] -= step[free]
        return system.work


def _weight_of(primal: PrimalActiveSet | None) -> float:
    """Return the size of w beside that of z where an active set gives it, else 1."""
    z, w = (0.0, 0.0) if primal is None else (float(np.abs(values).max(initial=0.0)) for values in (primal.z, primal.w))
    return w / z if z > 0.0 and 0.0 < w / z < np.inf else 1.0


def _unit_of(q: FloatVector, entries: FloatVector) -> float:
    """Return a power of two to measure y and w in: 1, or what makes y w about 1 where it would leave the range.

    With M and q of sizes m and s, y is about s/m and w about s.
    """
    of_q, of_M = (np.frexp(np.abs(values).max(initial=0.0)) for values in (q, entries))
    exponent = int(of_q[1]) - 1 - int(of_M[1]) // 2
    is_known = 0.0 < of_q[0] < np.inf and 0.0 < of_M[0] < np.inf
    return float(np.ldexp(1.0, exponent)) if is_known and SAFE_TO_MULTIPLY < abs(exponent) < 1000 else 1.0

