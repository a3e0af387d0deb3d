"""Newton with a line search on the Fischer–Burmeister function: the safeguard of the active-set iteration."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...checks import FloatVector
from ...matrix.factors import factorise
from ...matrix.structure import bandwidth
from ...problem.lcp import LCP
from ..base import Step
from .active_set import classify
from .newton_state import LARGE_PATIENCE, NewtonState

LONGEST_RUN = 150
SUFFICIENT = 1e-4
FULL_STEP_GAIN = 0.5  # a full active-set step must reduce ‖Φ‖ to this share
HALVINGS = 25
MEMORY = 5  # the line search compares with the worst of so many merits
STAGNANT = 25  # steps without a fall of ‖Φ‖ by one per cent; by thirty within LARGE_PATIENCE on large ones
SHIFT = 1e-3  # keeps the Jacobian regular where M is only P₀


class Linearised(NamedTuple):
    """Φ(z) and the diagonals of its Jacobian diag(by_z) + diag(by_w/d) M, shape (n,) each."""

    value: FloatVector
    by_z: FloatVector
    by_w: FloatVector

    @property
    def norm(self) -> float:
        """‖Φ‖₂."""
        return float(np.linalg.norm(self.value))


def fischer_burmeister(
    problem: LCP, z: FloatVector, w: FloatVector, scale: FloatVector | None = None
) -> Linearised:
    """Return Φ, zero exactly at solutions: φ(z − lower, −φ(upper − z, −w/d)), φ(a, b) = a + b − √(a² + b²).

    d is the scale of the residual unless another one is given, shape (n,), > 0. Where a bound is infinite, its φ is
    replaced by its limit; a row with equal bounds gives z − lower.

    References
    ----------
    Billups 1995, *Algorithms for complementarity problems and generalized equations*, PhD thesis, Wisconsin.
    """
    with np.errstate(all="ignore"):
        s = w / (problem.residual_scale if scale is None else scale)
        value, by_a, by_b = _phi(problem.upper - z, -s)
        has_upper, has_lower = np.isfinite(problem.upper), np.isfinite(problem.lower)
        p = np.where(has_upper, -value, s)
        p_by_z, p_by_s = np.where(has_upper, by_a, 0.0), np.where(has_upper, by_b, 1.0)
        value, by_a, by_b = _phi(z - problem.lower, p)
        value = np.where(has_lower, value, p)
        by_z = np.where(has_lower, by_a + by_b * p_by_z, p_by_z)
        by_s = np.where(has_lower, by_b * p_by_s, p_by_s)
        is_fixed = problem.lower == problem.upper
        return Linearised(
            np.where(is_fixed, z - problem.lower, value), np.where(is_fixed, 1.0, by_z), np.where(is_fixed, 0.0, by_s)
        )


def _phi(a: FloatVector, b: FloatVector) -> tuple[FloatVector, FloatVector, FloatVector]:
    """Return φ(a, b) and an element of its generalised derivative."""
    root = np.hypot(a, b)
    # a + b − root cancels where a and b are positive.
    sum_ = a + b
    value = np.where(sum_ > 0.0, 2.0 * a * b / np.where(sum_ > 0.0, sum_ + root, 1.0), sum_ - root)
    safe = np.where(root > 0.0, root, 1.0)
    by_a = np.where(root > 0.0, 1.0 - a / safe, 1.0 - np.sqrt(0.5))
    by_b = np.where(root > 0.0, 1.0 - b / safe, 1.0 - np.sqrt(0.5))
    return value, by_a, by_b


def damped_steps(state: NewtonState) -> Generator[Step, None, bool]:
    """Yield steps that reduce ‖Φ‖: full active-set steps where they do so at once, else a line search.

    Ends where ‖Φ‖ stagnates; returns whether an active set reproduced itself with a regular block.
    """
    state.move(np.clip(state.best_z, state.problem.lower, state.problem.upper))
    phi = fischer_burmeister(state.problem, state.z, state.w)
    recent, lowest, since = [phi.norm], phi.norm, 0
    gain, patience = (0.7, LARGE_PATIENCE) if state.is_large else (0.99, STAGNANT)
    for _ in range(LONGEST_RUN):
        if not 0.0 < phi.norm < np.inf:
            return False
        full = _full_step(state, phi)
        is_settled = full is not None and full[1]
        following = _searched(state, phi, max(recent[-MEMORY:])) if full is None else full[0]
        if following is None:
            return False
        phi = following
        recent.append(phi.norm)
        yield state.step()
        if is_settled:
            return True
        since, lowest = (0, phi.norm) if phi.norm < gain * lowest else (since + 1, lowest)
        if since >= patience:
            break
    return False


def _full_step(state: NewtonState, phi: Linearised) -> tuple[Linearised, bool] | None:
    """Move to the solution of the active set of z if it is a new one and halves ‖Φ‖; return whether that settled it."""
    at_lower, at_upper = classify(state.problem, state.z, state.w)
    if state.is_known(at_lower, at_upper):
        return None
    solution = state.solve(at_lower, at_upper)
    if solution is None:
        return None
    w = state.slack(solution.z)
    found = fischer_burmeister(state.problem, solution.z, w)
    if not found.norm <= FULL_STEP_GAIN * phi.norm:
        return None
    state.move(solution.z)
    again = classify(state.problem, state.z, state.w)
    is_same = np.array_equal(again[0], at_lower) and np.array_equal(again[1], at_upper)
    return found, is_same and not solution.is_singular


def _searched(state: NewtonState, phi: Linearised, reference: float) -> Linearised | None:
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
        for _ in range(HALVINGS):
            z = state.z + length * direction
            found = fischer_burmeister(state.problem, z, state.slack(z))
            if 0.5 * found.norm**2 <= 0.5 * reference**2 + SUFFICIENT * length * slope:
                state.move(z)
                return found
            length *= 0.5
    return None


def _newton_direction(state: NewtonState, phi: Linearised) -> FloatVector | None:
    largest = float(np.max(np.abs(phi.value), initial=0.0))
    shift = SHIFT * largest / (largest + float(np.max(np.abs(state.z), initial=0.0)) + 1e-300)
    jacobian = phi_jacobian(state.problem, phi, min(shift, SHIFT))
    factor = factorise(jacobian, bandwidth=bandwidth(state.problem.matrix))
    if factor is None:
        return None
    state.work += (factor.work + factor.solve_work) / state.entries
    direction = factor.solve(-phi.value)
    return direction if np.isfinite(direction).all() else None


def phi_jacobian(problem: LCP, phi: Linearised, shift: float, scale: FloatVector | None = None) -> Any:
    """Return the Jacobian of Φ in that scale plus shift times the identity, dense or CSR as M is."""
    M = problem.M
    rows, diagonal = phi.by_w / (problem.residual_scale if scale is None else scale), phi.by_z + shift
    if sp.issparse(M):
        return sp.csr_array(sp.diags_array(rows) @ M + sp.diags_array(diagonal))
    jacobian = M * rows[:, None]
    jacobian[np.diag_indices_from(jacobian)] += diagonal
    return jacobian
