"""Semismooth Newton on the scaled natural residual, alias primal-dual active set, with its safeguards.

The file begins with active sets, the rows at bounds, and linear systems of the others. Full and damped steps follow.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.algorithm import Algorithm, Step
from ..core.checks import Array, BoolVector, Vector
from ..core.entries import max_norm
from ..core.kernels.floats import EPSILON
from ..core.lcp import LCP
from ..judges.lcp import measured_residual, scaled_residual
from ..systems.factors import factor_operations, factorize
from ..systems.free_systems import FreeSystem
from ..systems.graph import bandwidth

LARGE_PATIENCE = 20  # rounds without a gain, if many rows change at once


class ActiveSetSolution(NamedTuple):
    """Solution for an active set.

    Attributes
    ----------
    z : ndarray, shape (n,)
        At its bound on the active rows; w = 0 on the free rows, as well as can be.
    system : FreeSystem
        The system of the free rows, for another call with the same M.
    work : float
        Matrix entries touched, including the factorization, divided by the nonzeros of M.
    """

    z: Vector
    system: FreeSystem
    work: float


def classify(
    problem: LCP, z: Vector, w: Vector, *, are_ties_free: bool = True
) -> tuple[BoolVector, BoolVector]:
    """Return (at_lower, at_upper), the bounds that z − w/d passes, d the residual scale, shape (n,) each.

    Parameters
    ----------
    z, w : ndarray, shape (n,)
        A row with equal bounds is at its lower bound. A row at a bound with w = 0 is free: its z may arrive from other
        rows, and then an active set would take one row per linear solve.
    are_ties_free : bool
        If False, such rows are at their bound, because a singular M may have no solution on the rows with them.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> at_lower, at_upper = classify(problem, np.array([2.5, 0.0]), np.array([0.0, 3.5]))
    >>> at_lower
    array([False,  True])
    """
    step = w / problem.residual_scale
    # z − step ≤ lower, written so that a small step is not lost next to a large z.
    passes = np.less if are_ties_free else np.less_equal
    at_lower = passes(z - problem.lower, step)
    at_upper = passes(problem.upper - z, -step) & ~at_lower
    is_fixed = problem.lower == problem.upper
    return at_lower | is_fixed, at_upper & ~is_fixed


def is_near(problem: LCP, z: Vector) -> bool:
    """Return whether the residual of z is at most a tenth of the residual of the default start."""
    # The active set of such a near start is likely the active set of the solution.
    start = measured_residual(problem, problem.nearest_to_zero)
    return measured_residual(problem, z) <= 0.1 * start


def signature(at_lower: BoolVector, at_upper: BoolVector) -> bytes:
    """Return a key of an active set, for the detection of cycles."""
    return np.packbits([at_lower, at_upper]).tobytes()


def solve_active_set(
    problem: LCP, *sides: BoolVector, near: Array = None, system: FreeSystem | None = None
) -> ActiveSetSolution | None:
    """Return z with z at its bounds on the active rows and w = 0 on the free rows; None if the solve overflows.

    Parameters
    ----------
    *sides : two arrays of bool, shape (n,)
        The active rows, at their lower and at their upper bounds; the bounds there are finite.
    near : ndarray, shape (n,), optional
        Target if the free block is singular: a solution close to this z is computed; 0 by default.
    system : FreeSystem, optional
        System of an earlier call with the same M, used if its rows are the free rows.

    Notes
    -----
    One factorization of the free block, see :meth:`.FreeSystem.solve_near`. The result is not tested: measure the
    residual of z.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> solve_active_set(problem, np.array([False, True]), np.array([False, False])).z
    array([2.5, 0. ])
    """
    at_lower, at_upper = sides
    z = np.where(at_lower, problem.lower, np.where(at_upper, problem.upper, 0.0))
    free = ~(at_lower | at_upper)
    if system is None or not np.array_equal(free, system.free):
        system = FreeSystem(problem.matrix, free, by_factor=True)
    before = system.work
    x = system.solve_near(-problem.slack(z), np.zeros(problem.n) if near is None else near)
    if x is None or not np.isfinite(z).all():
        return None
    return ActiveSetSolution(z + x, system, 1.0 + (system.work - before) / max(problem.nonzeros, 1))


def polish_active_set(problem: LCP, z: Vector, most_work: float) -> ActiveSetSolution | None:
    """Return the solution of the linear system of the active set of z.

    The result is None if the block is singular, so that z is not unique, or if a factorization would take more passes
    over M than `most_work`.

    Examples
    --------
    >>> polish_active_set(LCP([[2, 1], [1, 2]], [-5, 1]), np.array([2.4, 0.1]), 100.0).z
    array([2.5, 0. ])
    """
    sides = classify(problem, z, problem.slack(z))
    system = FreeSystem(problem.matrix, ~np.logical_or(*sides), by_factor=True)
    most = most_work * max(problem.nonzeros, 1)
    if factor_operations(system.principal, most) > most or system.is_singular:
        return None
    return solve_active_set(problem, *sides, near=z, system=system)


class NewtonState:
    """The iterate z with w = M z + q, the best z so far, and the work since the last step.

    Attributes
    ----------
    best_z, best : ndarray, shape (n,), and float
        The best of the iterates projected onto the bounds, and its ‖r‖∞: the data of a step.
    """

    def __init__(self, problem: LCP, z: Vector) -> None:
        self.problem = problem
        self.scale = problem.residual_scale
        self.entries = max(problem.nonzeros, 1)
        self.work = 0.0
        self.best, self.best_z = math.inf, z
        self._solved: set[bytes] = set()
        self._system: FreeSystem | None = None
        self.move(z)

    def move(self, z: Vector) -> None:
        """Move to z; store its projection if the residual is the best so far, or at rounding level.

        Small unknowns become right last, when the largest residual is at rounding level already.
        """
        self.z, self.w = z, self.slack(z)
        self.residual: Vector = np.abs(scaled_residual(self.problem, z, self.w))
        inside, residual = np.clip(z, self.problem.lower, self.problem.upper), self.residual
        if not np.array_equal(inside, z):
            residual = np.abs(scaled_residual(self.problem, inside, self.slack(inside)))
        size = float(np.max(residual, initial=0.0))
        if size <= max(self.best, EPSILON * max_norm(inside)) or not self._solved:
            self.best, self.best_z = size, inside

    @property
    def is_large(self) -> bool:
        """True if steps without clear gain end after LARGE_PATIENCE."""
        # Steps that gain little are given up early: each costs a factorization.
        return self.problem.n > 3000

    def slack(self, z: Vector) -> Vector:
        """Return M z + q, counted as work."""
        self.work += 1.0
        return self.problem.slack(z)

    def step(self) -> Step:
        """Return the best iterate as a step, with the work since the last step."""
        work, self.work = self.work, 0.0
        return Step(self.best_z, self.best, work=work)

    def is_known(self, *sides: BoolVector) -> bool:
        """Return whether this active set has been solved before."""
        return signature(*sides) in self._solved

    def solve(self, *sides: BoolVector) -> ActiveSetSolution | None:
        """Return the solution for an active set; if its block is singular, the solution nearest to the current z."""
        self._solved.add(signature(*sides))
        solution = solve_active_set(self.problem, *sides, near=self.z, system=self._system)
        if solution is not None:
            self._system = solution.system
            self.work += solution.work
        return solution


PATIENT_ROWS = 250  # a round on fewer rows costs little

SHIFT = 1e-3  # keeps the Jacobian regular if M is only P₀


@dataclass(frozen=True, kw_only=True)
class Newton(Algorithm):
    """Semismooth Newton, alias primal-dual active set: w_F = 0, and z_A at the bounds that z − w/d reaches.

    Notes
    -----
    Full steps as long as they lead to new active sets; on M-matrices these steps are finite and monotone. When an
    active set repeats or progress ends, a line search on the Fischer–Burmeister function takes over, which tries full
    steps again if they halve the function. Unsolved small problems start again from the point of the box nearest to 0.
    In theory the line search converges on P-matrices; here its steps are bounded in number. Singular blocks are
    regularized, and the residual decides about the result. On more than 3000 rows, steps that gain little end early.
    Each step yields the best z so far, projected onto the bounds.

    References
    ----------
    Hintermüller, Ito, Kunisch 2002, doi:10.1137/S1052623401383558. De Luca, Facchinei, Kanzow 1996,
    doi:10.1007/BF02592192.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[2, 1], [1, 2]], [-5, 1])
    >>> lcp_plugin.solve(problem, Newton()).z
    array([2.5, 0. ])
    """

    name: ClassVar[str] = "newton"
    needs: ClassVar[str] = "none"
    solves: ClassVar[str] = "M-matrices, bounds on one side, n ≤ 250"
    cost: ClassVar[str] = "1 factorization of the free block"
    reference: ClassVar[str] = (
        "Hintermüller, Ito, Kunisch 2002, doi:10.1137/S1052623401383558; De Luca, Facchinei, Kanzow 1996, "
        "doi:10.1007/BF02592192"
    )
    is_monotone: ClassVar[bool] = False
    ends_on_active_set: ClassVar[bool] = True

    def theorem(self, problem: LCP, report: Any) -> str | None:
        """Return the theorem on M-matrices: full steps are monotone then, at most n + 2; patience suffices for them."""
        is_one_sided = bool(np.all(problem.upper == np.inf) or np.all(problem.lower == -np.inf))
        if problem.n > PATIENT_ROWS or not is_one_sided or report.is_m_matrix is not True:
            return None
        return "M is an M-matrix and bounded on one side: monotone and finite (Hintermüller, Ito, Kunisch 2002)"

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the best z so far after each factorization; end if no further step is possible."""
        start = np.clip(z0, problem.lower, problem.upper)
        # A second start of a small problem is the point of the bounds nearest to 0.
        is_elsewhere = problem.n <= 500 and not np.array_equal(start, problem.nearest_to_zero)
        state = NewtonState(problem, start)
        yield state.step()
        if problem.n == 0 or (yield from alternating_steps(state)) or not is_elsewhere:
            return
        again = NewtonState(problem, problem.nearest_to_zero)
        if state.best < again.best:
            again.best, again.best_z = state.best, state.best_z
        yield from alternating_steps(again)


def alternating_steps(state: NewtonState) -> Generator[Step, None, bool]:
    """Yield full steps and damped steps alternately; return whether an active set settled."""
    for _ in range(3):
        if (yield from full_steps(state)):
            return True
        before = state.best
        yield from damped_steps(state)
        if not state.best < (0.9 * before if state.is_large else before):
            break
    return False


def full_steps(state: NewtonState) -> Generator[Step, None, bool]:
    """Yield undamped active-set steps, until an active set repeats or neither residual nor changes fall.

    Return whether the last set reproduced itself with a regular block: only rounding errors remain.
    """
    problem = state.problem
    # Full steps without a smaller residual or fewer changes, plus one per row up to PATIENT_ROWS
    patience = LARGE_PATIENCE if state.is_large else 30 + min(problem.n, PATIENT_ROWS)
    lowest, fewest, idle = math.inf, problem.n + 1, 0
    previous = classify(problem, state.z, state.w)
    while idle < patience and not state.is_known(*previous):
        solution = state.solve(*previous)
        if solution is None:
            return False
        state.move(solution.z)
        yield state.step()
        present = classify(problem, state.z, state.w)
        changes = int(np.count_nonzero((present[0] != previous[0]) | (present[1] != previous[1])))
        if changes == 0:
            return not solution.system.is_singular
        size = float(np.sum(state.residual))
        idle = 0 if size < lowest or changes < fewest else idle + 1
        lowest, fewest = min(lowest, size), min(fewest, changes)
        previous = present
    return False


# --- the safeguard: a line search on the Fischer–Burmeister function ---


class LinearizedPhi(NamedTuple):
    """Φ(z) and the diagonals of its Jacobian diag(by_z) + diag(by_w/d) M, shape (n,) each."""

    value: Vector
    by_z: Vector
    by_w: Vector

    @property
    def norm(self) -> float:
        """‖Φ‖₂."""
        return float(np.linalg.norm(self.value))


def fischer_burmeister(
    problem: Any, z: Vector, w: Vector, scale: Vector | None = None
) -> LinearizedPhi:
    """Return Φ, zero exactly at solutions: φ(z − lower, −φ(upper − z, −w/d)), φ(a, b) = a + b − √(a² + b²).

    d is the scale of the residual unless `scale` replaces it, shape (n,), > 0. If a bound is infinite, its φ is
    replaced by its limit; a row with equal bounds gives z − lower.

    References
    ----------
    Billups 1995, *Algorithms for complementarity problems and generalized equations*, PhD thesis, Wisconsin.
    """
    s = w / (problem.residual_scale if scale is None else scale)
    value, by_z, by_s = s, np.zeros(s.size), np.ones(s.size)
    if (has_upper := np.isfinite(problem.upper)).any():
        turned, by_a, by_b = _phi(problem.upper - z, -s)
        value = np.where(has_upper, -turned, s)
        by_z, by_s = np.where(has_upper, by_a, 0.0), np.where(has_upper, by_b, 1.0)
    if (has_lower := np.isfinite(problem.lower)).any():
        inner = value
        value, by_a, by_b = _phi(z - problem.lower, inner)
        value = np.where(has_lower, value, inner)
        by_z = np.where(has_lower, by_a + by_b * by_z, by_z)
        by_s = np.where(has_lower, by_b * by_s, by_s)
    is_fixed = problem.lower == problem.upper
    parts = (z - problem.lower, value), (1.0, by_z), (0.0, by_s)
    return LinearizedPhi(*(np.where(is_fixed, *pair) for pair in parts))


def _phi(a: Vector, b: Vector) -> tuple[Vector, Vector, Vector]:
    """Return φ(a, b) and an element of its generalized derivative."""
    root = np.hypot(a, b)
    # a + b − root cancels if a and b are positive.
    sum_ = a + b
    value = np.where(sum_ > 0.0, 2.0 * a * b / np.where(sum_ > 0.0, sum_ + root, 1.0), sum_ - root)
    safe = np.where(root > 0.0, root, 1.0)
    by_a, by_b = (1.0 - np.where(root > 0.0, x / safe, np.sqrt(0.5)) for x in (a, b))
    return value, by_a, by_b


def damped_steps(state: NewtonState) -> Iterator[Step]:
    """Yield steps of a line search that reduce ‖Φ‖; end if ‖Φ‖ stagnates."""
    state.move(state.best_z)
    phi = fischer_burmeister(state.problem, state.z, state.w)
    recent, lowest, since = [phi.norm], phi.norm, 0
    # Steps without a fall of ‖Φ‖ by 1 %; by 30 % on large problems.
    gain, patience = (0.7, LARGE_PATIENCE) if state.is_large else (0.99, 25)
    while len(recent) <= 150 and since < patience and 0.0 < phi.norm < np.inf:
        # The line search compares with the worst of the last five merits.
        following = _searched(state, phi, max(recent[-5:]))
        if following is None:
            return
        phi = following
        recent.append(phi.norm)
        yield state.step()
        since, lowest = (0, phi.norm) if phi.norm < gain * lowest else (since + 1, lowest)


def _searched(state: NewtonState, phi: LinearizedPhi, reference: float) -> LinearizedPhi | None:
    """Move along the Newton direction of Φ, or its steepest descent, until ½‖Φ‖² falls enough."""
    jacobian = phi_jacobian(state.problem, phi, 0.0)
    gradient = jacobian.T @ phi.value
    for direction in (_newton_direction(state, phi), -gradient):
        if direction is None:
            continue
        slope = float(gradient @ direction)
        if not slope < -1e-14 * float(np.linalg.norm(gradient) * np.linalg.norm(direction)):
            continue
        length = 1.0
        for _ in range(25):
            z = state.z + length * direction
            candidate = fischer_burmeister(state.problem, z, state.slack(z))
            if 0.5 * candidate.norm**2 <= 0.5 * reference**2 + 1e-4 * length * slope:
                state.move(z)
                return candidate
            length *= 0.5
    return None


def _newton_direction(state: NewtonState, phi: LinearizedPhi) -> Vector | None:
    largest = max_norm(phi.value)
    shift = SHIFT * largest / (largest + max_norm(state.z) + 1e-300)
    jacobian = phi_jacobian(state.problem, phi, min(shift, SHIFT))
    factor = factorize(jacobian, bandwidth=bandwidth(state.problem.matrix))
    if factor is None:
        return None
    state.work += (factor.work + factor.solve_work) / state.entries
    direction = factor.solve(-phi.value)
    return direction if np.isfinite(direction).all() else None


def phi_jacobian(problem: LCP, phi: LinearizedPhi, shift: float) -> Any:
    """Return the Jacobian of Φ plus shift times the identity, dense or CSR as M is."""
    M, rows, diagonal = problem.M, phi.by_w / problem.residual_scale, phi.by_z + shift
    if sp.issparse(M):
        return sp.csr_array(sp.diags_array(rows) @ M + sp.diags_array(diagonal))
    jacobian = M * rows[:, None]
    jacobian[np.diag_indices_from(jacobian)] += diagonal
    return jacobian
