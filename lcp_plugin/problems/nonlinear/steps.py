"""Steps from a point of a nonlinear problem, in the order in which a search tries them.

The target of a Newton step solves the LCP of M = F′(x), q = F(x) − F′(x) x. Small problems solve it on arrays
(:mod:`lcp_plugin.methods.small`); large ones begin with linear solves on the active set of x, each of which may be step
enough. If no Newton step helps, the LCP of F′(x) + μD is solved for larger and larger μ, D the residual scale (proximal
steps). The last resort is a Levenberg–Marquardt step: (HᵀH + μ √(mean Φ²) I) d = −HᵀΦ, H in the generalized Jacobian of
the Fischer–Burmeister function Φ, with F(x) for w, scaled by the largest entry of each row of F′. The diagonal is not
used for it, because it may vanish with x: the diagonal of a convex power is zero at 0.

References
----------
N. H. Josephy, *Newton's method for generalized equations*, MRC report 1965, Wisconsin 1979.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core import deadline
from ...core.algorithm import Algorithm
from ...core.checks import AnyMatrix, Vector
from ...core.entries import clip, largest_in_rows, max_norm
from ...core.errors import UnsuitableMatrix, UnsuitableProblem
from ...core.kernels.floats import FREE, LARGEST, LOW, NEGLIGIBLE
from ...core.lcp import LCP
from ...core.settings import Settings
from ...judges.lcp import RowData, measured_residual
from ...methods.lemke import Lemke
from ...methods.newton import Newton, classify, fischer_burmeister, solve_active_set
from ...methods.small import SMALL_DENSE, active_point, candidates, rounds, takes_rounds
from ...solving.dispatch import method_of
from ...solving.lcp_run import LCPRun
from ...solving.plan import plan
from ...solving.result import Result
from ...solving.run import Stage
from ...systems.factors import factorize
from .data import SMALLEST_TOLERANCE, Linearization

HALVINGS = tuple(0.5**k for k in range(30))  # step lengths of Newton steps
PROXIMAL_SHIFTS = 1e-3, 1e-1, 10.0  # of the residual scale: proximal steps
DAMPINGS, DAMPED = (1e-6, 1e-3, 0.1, 10.0, 1e3), (1.0, 0.3, 0.1, 0.03)  # Levenberg–Marquardt
FORCING = 0.01  # of the residual at x: tolerance of a linearization far from a solution
# of the largest row: F′ may vanish with x, as of a power at 0, and so the unit of its rows
FLAT = 2.0**-20
ACTIVE_SETS_UP_TO = 5000  # rows; beyond, LCP methods need fewer factorizations
ACTIVE_SETS = 8  # linear solves before an LCP method


class Aim(NamedTuple):
    """Point to which a search goes.

    Attributes
    ----------
    name : str
        "Newton", "active set", "proximal" or "Levenberg–Marquardt".
    x : array, shape (n,)
    lengths : tuple of float
        Step lengths to try.
    share : float
        The merit must fall below this share.
    """

    name: str
    x: Vector
    lengths: tuple[float, ...]
    share: float = 1.0


def targets(point: Linearization, linear: str | Algorithm, tolerance: float) -> Iterator[Aim]:
    """Yield the targets from a point; the LCP of a linearization is solved by the algorithm `linear`."""
    step = None
    if linear == "auto" and not is_dense(point) and point.x.size <= ACTIVE_SETS_UP_TO:
        for shift in (0.0, min(1.0, max(point.relative, 1e-8)), 1.0):
            yield from _active_set_targets(point, shift)
        if (step := _semismooth_step(point)) is not None:
            yield Aim("semismooth", moved(point, step), (1.0,), 0.5)
    for shift in (0.0, *PROXIMAL_SHIFTS):
        if (target := lcp_step(point, linear, tolerance, shift)) is not None:
            yield Aim("proximal" if shift else "Newton", moved(point, target), HALVINGS)
        if not shift and is_dense(point):
            step = _semismooth_step(point)
        if not shift and step is not None:
            yield Aim("semismooth", moved(point, step), HALVINGS)
    phi, H = phi_and_jacobian(point)
    gradient, size = H.T @ phi, math.sqrt(phi @ phi / max(phi.size, 1))
    normal = H.T @ H
    for damping in DAMPINGS:
        if (step := solve_shifted(normal, damping * size, -gradient)) is not None:
            yield Aim("Levenberg–Marquardt", moved(point, step), DAMPED)


def is_dense(point: Linearization) -> bool:
    """Return whether linearizations are solved on arrays."""
    return point.x.size <= SMALL_DENSE and isinstance(point.M, np.ndarray)


def moved(point: Linearization, step: Vector) -> Vector:
    """Return x plus a step, exactly on the bounds that it reaches."""
    x, lower, upper = point.x, point.problem.lower, point.problem.upper
    target = np.where(step <= lower - x, lower, x + step)
    target = np.where(step >= upper - x, upper, target)
    return clip(target, lower, upper)


def lcp_step(
    point: Linearization, linear: str | Algorithm, tolerance: float, shift: float
) -> Vector | None:
    """Return a solution d of the LCP of (M + shift D) d + F(x) on the bounds of d, or None.

    The tolerance is tied to the relative residual at x. The unknown is d, because the residual at x is then the
    reference, and of several solutions a solution near x results.
    """
    if linear == "auto" and is_dense(point):
        if shift not in point.lcp_steps:  # each search begins at the same start
            M, w, lower, upper = step_data(point, shift)
            scale, size = (1.0 + shift) * point.scale, point.largest_step
            if shift:
                size = max_norm(clip(w / scale, -upper, -lower))
            point.lcp_steps[shift] = small_step(M, w, lower, upper, scale, 0.5 * size)
        return point.lcp_steps[shift]
    problem = step_problem(point, shift)
    # A linearization needs no smaller residual than a tenth of the tolerance
    relative, enough = point.relative, FORCING
    if relative > 0.0:
        enough = min(max(relative, 0.1 * tolerance / relative, SMALLEST_TOLERANCE), FORCING)
    try:
        result = solve_within(problem, linear, enough)
    except (UnsuitableMatrix, UnsuitableProblem):  # the algorithm does not take this problem
        if linear == "auto":
            raise
        result = solve_within(problem, "auto", enough)
    return result.z if result.is_solved or result.residual <= 0.5 else None


def small_step(
    M: Vector, w: Vector, lower: Vector, upper: Vector, scale: Vector, most: float
) -> Vector | None:
    """Return d with lower ≤ d ≤ upper complementary to M d + w, with a residual of at most `most`; None without one.

    The active set of 0 is tried first; d is returned at once if only rounding errors are left.
    """
    step = w / scale
    side = np.where(step >= -lower, LOW, FREE + (step <= -upper))
    d = active_point(M, w, lower, upper, side)
    if max_norm(clip((M.dot(d) + w) / scale, d - upper, d - lower)) <= NEGLIGIBLE * most:
        return d  # within the bounds up to this residual
    best, least, zero = None, most, np.zeros(w.size)
    data = RowData(M, M, w, lower, upper, scale, None, zero)

    def tried() -> Iterator[Vector]:
        yield rounds(data, zero)
        if best is None:  # perhaps a singular block: the least solution on the active set of 0
            held = np.where(w >= -lower * scale, lower, np.where(w <= -upper * scale, upper, 0.0))
            free = np.flatnonzero((w < -lower * scale) & (w > -upper * scale))
            right = -(M @ held + w)[free]
            held[free] = np.linalg.lstsq(M[np.ix_(free, free)], right)[0]
            yield held
        for _, step, _ in candidates(data, zero):
            yield step

    for step in tried():
        inside = clip(step, lower, upper)
        size = max_norm(data.residual(inside, M @ inside + w))
        if size <= least:  # NaN fails
            best, least = inside, size
        if size <= NEGLIGIBLE * most:
            break
    return best


def _active_set_targets(point: Linearization, shift: float) -> Iterator[Aim]:
    """Yield the ends of linear solves on active sets of M + shift D, until a set reproduces itself or is singular."""
    problem, zero = step_problem(point, shift), np.zeros(point.x.size)
    before = classify(problem, zero, problem.q)
    for _ in range(ACTIVE_SETS):
        solution = solve_active_set(problem, *before, near=zero)
        if solution is None or solution.system.is_singular or deadline.is_over():
            return
        now = classify(problem, solution.z, problem.slack(solution.z))
        is_last = all(map(np.array_equal, before, now))
        target = moved(point, solution.z)
        if not shift:
            lengths = HALVINGS if is_last else (1.0,)
            yield Aim("active set", target, lengths, 1.0 if is_last else 0.5)
        elif is_last:
            yield Aim("proximal", target, (1.0,), 0.8 if shift == 1.0 else 0.5)
        if is_last:
            return
        before = now


def step_data(point: Linearization, shift: float) -> tuple[Any, ...]:
    """Return M + shift D, the slack F(x) of d = 0, and the bounds of d."""
    M, w, x = point.M, point.value, point.x
    if shift:
        D = shift * without_flat_rows(point.scale)
        M = M + (sp.diags_array(D) if sp.issparse(M) else np.diag(D))
    return M, w, point.lower - x, point.upper - x


def step_problem(point: Linearization, shift: float) -> LCP:
    """Return the LCP of these data; the facts about M are shared with the linearization if nothing is shifted."""
    M, w, lower, upper = step_data(point, shift)
    return LCP(M if shift else point.lcp.matrix, w, lower=lower, upper=upper)


def phi_and_jacobian(point: Linearization) -> tuple[Vector, Any]:
    """Return Φ(x), shape (n,), and an element H of its generalized Jacobian, shape (n, n)."""
    scale = row_scale(point)
    phi = fischer_burmeister(point, point.x, point.value, scale)
    rows = phi.by_w / scale
    if sp.issparse(point.M):
        return phi.value, sp.csr_array(sp.diags_array(rows) @ point.M + sp.diags_array(phi.by_z))
    H = point.M * rows[:, None]
    H[np.diag_indices_from(H)] += phi.by_z
    return phi.value, H


def _semismooth_step(point: Linearization) -> Vector | None:
    phi, H = phi_and_jacobian(point)
    return solve_shifted(H, 0.0, -phi)


def row_scale(point: Linearization) -> Vector:
    """Return the largest |entry| of each row of F′, of flat rows more."""
    return without_flat_rows(largest_in_rows(point.M))


def without_flat_rows(sizes: Vector) -> Vector:
    """Return sizes of rows, at least FLAT times the largest size; 1 if all are 0."""
    return np.maximum(sizes, FLAT * sizes.max(initial=0.0) or 1.0)


def solve_shifted(matrix: AnyMatrix, shift: float, right: Vector) -> Vector | None:
    """Return the solution of (matrix + shift I) d = right, symmetric if shifted; None if it fails."""
    n = right.size
    is_sparse = sp.issparse(matrix)
    shifted = matrix + shift * (sp.eye_array(n, format="csr") if is_sparse else np.eye(n))
    factor = factorize(sp.csr_array(shifted) if is_sparse else shifted, is_symmetric=shift > 0.0)
    step = None if factor is None else factor.solve(right)
    return step if step is not None and np.isfinite(step).all() else None


def _stages_of_step(problem: LCP, method: Algorithm | None, goal: float) -> Iterator[Stage]:
    """Yield the stages of a linearization: no proofs, pivots last, and no method twice."""
    tried: list[Algorithm] = []
    has_bounds = np.isfinite(problem.lower).any() or np.isfinite(problem.upper).any()
    if method is None and not (has_bounds or takes_rounds(problem)):
        yield Stage(Newton(), "no bounds: a linear system")
    for stage in plan(problem, method, goal, prove_infeasibility=False):
        if stage.algorithm in tried:
            return
        if isinstance(stage.algorithm, Lemke):
            yield replace(stage, algorithm=Lemke(restarts=2)) if tried else stage
            return
        tried.append(stage.algorithm)
        yield stage


def solve_within(problem: LCP, algorithm: str | Algorithm, tolerance: float) -> Result:
    """Solve a linearization within the limits of the current run; Ctrl-C ends both runs.

    The start is the projected gradient step, so that the methods find a solution near it.
    """
    method = method_of(algorithm, {})
    absolute = tolerance * measured_residual(problem, np.zeros(problem.n))
    settings = Settings(tolerance, None, deadline.left(), min(absolute, LARGEST), polish=False)
    step = np.nan_to_num(-problem.q / problem.residual_scale)
    start = np.clip(step, problem.lower, problem.upper)
    run = LCPRun(problem, method, settings, None, deadline.Clock(settings.max_seconds), start)
    stages = _stages_of_step(problem, method, run.goal)
    return run.result(run.follow_all(stages))
