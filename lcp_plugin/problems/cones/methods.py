"""Methods for complementarity over cones: block Gauss–Seidel, semismooth Newton, a central path, convex programs.

Central path of contacts with friction, followed by an interior-point method.

Let û = u + μ‖u_T‖ e_N, so that u = û − μ‖û_T‖ e_N, and S = diag(μ, 1, 1) for each contact. Then x = S r and y =
S⁻¹û are in Lorentz' cone, and are complementary. The path x ∘ y = σ e, û − μ‖û_T‖ e_N = W r + b is followed by
steps with the scaling of Nesterov and Todd, a predictor and a corrector. One step takes one factorization of W + G
S H S, H the scaling and G the derivative of u by û. The path ends near the middle of all impulses that make the
motion, where Newton's method converges. Therefore contacts with undetermined impulses are not harder than others.
Convergence is not proved, because the problem is not convex.

Newton's method on the natural map of cones, for all problems of a stack at once, and the systems of its steps.

A step solves (R_z + R_w (M + ε D)) s = −R, D = diag(d). The proximal term ε falls with the residual. It keeps the
system regular if several impulses make the same motion. Open blocks leave the system. The unknowns of the system are
the unknowns of the blocks, or the velocities of the bodies if contacts are defined by bodies and these have fewer
velocities.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.algorithm import Step
from ...core.checks import Array, Vector
from ...core.cone_stack import ConeStack, NaturalMap, length
from ...core.errors import UnsuitableProblem
from ...core.kernels.floats import NORMAL
from ...core.settings import whole_number
from ...systems.free_systems import solved
from .data import Blocks, minimizers
from .factors import Factors, factorize_matrix
from .sweeps import SWEEPS_PER_STEP, sweep_blocks

PROXIMAL, LEAST_PROXIMAL = 1e-3, 1e-12  # of d
LEAST_OF_BODIES = 1e-8  # the system of the velocities contains 1/ε
EXACT_OF_BODIES = 2.0**-36  # 1/ε enlarges rounding errors by so much
HARDER, EASIER = 100.0, 0.01  # times ε: for a singular system, and after a full step without GAIN
RECENT = 5  # a step may rise to the largest of so many residuals
HALVINGS, DECREASE = 14, 1e-4
NEWTON_GAIN, EXACT = 0.9, 2.0**-46  # a relative residual at rounding level of the linear systems


def newton_steps(
    stack: ConeStack, z: Vector, steps: int, goal: float
) -> Iterator[tuple[Any, Any, Any, float]]:
    """Yield the open problems, points, residuals and work, for the start and each step.

    Steps use a nonmonotone line search on ‖R‖₂. A problem whose residual is at most `goal` is left out.
    """
    open_ones, here, at = np.arange(stack.B), stack, z
    found = here.measure(at)
    yield open_ones, at, found.largest, 1.0
    norms, widest = np.repeat(found.norm[:, None], RECENT, 1), np.full(here.B, PROXIMAL)
    best, since, least = found.norm.copy(), np.zeros(here.B, np.int64), accuracy_of(stack)[0]
    for count in range(steps):
        # Points without a gain; each halving is a point
        going = np.isfinite(found.norm) & (found.largest > goal) & (since < 60)
        if not going.any():
            return
        if not going.all():
            kept = (open_ones, at, norms, widest, best, since)
            open_ones, at, norms, widest, best, since = (one[going] for one in kept)
            here, found = here.take(going), NaturalMap(*(one[going] for one in found))
        by_z, by_w = here.derivative(*found[1:6])
        epsilon = np.maximum(np.minimum(widest, 0.1 * found.largest), least)
        step = None
        while step is None and epsilon.min() <= 1.0:
            try:
                shift = (epsilon[:, None] * here.d)[..., None, None]
                factors = factorize_blocks(here, by_z + shift * by_w, by_w)
                step = factors.solve(-found.R)
            except np.linalg.LinAlgError:
                epsilon = np.maximum(HARDER * epsilon, LEAST_PROXIMAL)
        if step is None:
            return
        t, allowed, before, start = np.ones(here.B), norms.max(1), found.norm, at
        at = start + step
        found = here.measure(at)
        for _ in range(HALVINGS):
            is_short = ~(found.norm <= (1.0 - DECREASE * t) * allowed)
            if not is_short.any():
                break
            t[is_short] *= 0.5
            at[is_short] = (start + t[:, None, None] * step)[is_short]
            shorter = here.take(is_short).measure(at[is_short])
            for whole, part in zip(found, shorter, strict=True):
                whole[is_short] = part
        is_poor = (t < 1.0) | (found.norm >= before)
        narrower = np.where(found.norm > NEWTON_GAIN * before, EASIER * epsilon, widest)
        widest = np.where(is_poor, PROXIMAL, narrower)
        norms[:, count % RECENT] = found.norm
        tried = 1 - np.log2(t).astype(np.int64)  # each halving costs as much as a step
        since = np.where(found.norm < NEWTON_GAIN * best, 0, since + tried)
        best = np.minimum(best, found.norm)
        yield open_ones, at, found.largest, 2.0 + factors.entries / max(here.pattern.nonzeros, 1)


def accuracy_of(stack: ConeStack) -> tuple[float, float]:
    """Return the least proximal term, and the residual that no further step reduces."""
    if stack.arms is not None and stack.arms.are_fewer(stack.pattern.n):
        return LEAST_OF_BODIES, EXACT_OF_BODIES
    return LEAST_PROXIMAL, EXACT


def polish_points(stack: ConeStack, z: Vector) -> tuple[Any, Any]:
    """Return points and residuals after the linear systems of two active sets, if these reduce the residual.

    The linear systems are solved because a small residual does not imply a small error if M is ill-conditioned.
    """
    least, exact = accuracy_of(stack)
    found = stack.measure(z)
    best, smallest, shift = z, found.largest, least * stack.d[..., None, None]
    for _ in range(2):
        if (found.largest <= exact).all():
            break
        by_z, by_w = stack.derivative(*found[1:6])
        try:
            z = z + factorize_blocks(stack, by_z + shift * by_w, by_w).solve(-found.R)
        except np.linalg.LinAlgError:
            break
        found = stack.measure(z)
        is_better = found.largest < smallest
        best = np.where(is_better[:, None, None], z, best)
        smallest = np.where(is_better, found.largest, smallest)
    return best, smallest


def factorize_blocks(stack: ConeStack, mixed: Any, by_w: Array) -> Factors:
    """Return a solver for (mixed + by_w M) s = right, shape (B, k, m).

    Raises
    ------
    LinAlgError
        For a singular matrix.
    """
    pattern = stack.pattern
    # Few unknowns: open blocks are not left out
    if stack.B > 1 or (not pattern.is_sparse and pattern.n <= 12):
        J = whole_systems(stack, mixed, by_w)

        def solve_all(right: Vector) -> Any:
            return pattern.wide(solved(J, pattern.flat(right)[..., None])[..., 0])

        return Factors(solve_all, pattern.n**3 / 3.0)
    free = by_w[0].any((1, 2))
    arms = stack.arms
    if arms is not None and arms.are_fewer(pattern.sizes[free].sum()):
        return arms.factorize(mixed[0], by_w[0], np.flatnonzero(free))
    J, rows = system_of_free_rows(stack, mixed[0], by_w[0], free)
    inverse = factorize_matrix(J)

    def solve(right: Vector) -> Any:
        # of open blocks s is the right-hand side
        held = np.where(free[:, None], 0.0, right)
        known = right[0]
        if held.any():
            known = known - (by_w[0] @ pattern.times(held)[0][..., None])[..., 0]
        s = pattern.flat(held)
        s[0, rows] = inverse.solve(pattern.flat(known[None])[0, rows])
        return pattern.wide(s)

    return Factors(solve, inverse.entries)


def whole_systems(stack: ConeStack, mixed: Any, by_w: Array) -> Any:
    """Return mixed + by_w M of each problem, shape (B, n, n)."""
    pattern = stack.pattern
    row, column = pattern.inner
    J = pattern.flat(by_w @ pattern.wide(pattern.M))
    J[:, row, column] += mixed[pattern.entry(row, column)]
    return J


def system_of_free_rows(stack: ConeStack, mixed: Any, by_w: Array, free: Any) -> tuple[Any, Any]:
    """Return mixed + by_w M on rows and columns of the free blocks of one problem, and the rows."""
    pattern = stack.pattern
    rows = np.flatnonzero(free[pattern.of_row])
    if not pattern.is_sparse:
        return whole_systems(stack, mixed[None], by_w[None])[0][np.ix_(rows, rows)], rows
    row, column = pattern.inner
    entry, indptr = pattern.entry(row, column), np.searchsorted(row, np.arange(pattern.n + 1))
    parts, shape = (part[None][entry][0] for part in (by_w, mixed)), pattern.M.shape
    of_w, of_z = (sp.csr_array((part, column, indptr), shape=shape)[rows] for part in parts)
    return (of_w @ pattern.M + of_z)[:, rows], rows


Cones = NDArray[np.float64]  # shape (k, d)

TO_THE_BOUNDARY = 0.9  # share of the way to the boundary of the cones that a step goes
SHORT, CENTRED = 0.1, (0.5, 0.9)  # after a shorter step a centering step is tried, with these σ


def central_path(stack: ConeStack, z: Vector, share: float) -> Iterator[tuple[Any, float]]:
    """Yield impulses on the path of one problem, in the user's cones, (1, k, d), and the work of each step.

    Parameters
    ----------
    stack : ConeStack
        Stack of one problem.
    z : array, shape (1, k, d)
        A point near which the path begins; 0 means a cold start.
    share : float
        Distance of the start from z, relative to the largest velocity.
    """
    scale = np.ones((stack.k, stack.m))
    # The cones of the path have a slope; Newton's steps use the user's cones
    scale[:, 0] = np.where(stack.pattern.is_row, 1.0, np.maximum(stack.mu[0], 1e-3))
    speed = share * (float(np.abs(stack.q[0] / scale).max(initial=0.0)) or 1.0)
    is_row, x, y = stack.pattern.is_row, scale * z[0], np.zeros_like(scale)
    d: Any = np.median(stack.d[0]) if stack.k else 1.0
    if z.any():
        y, d = stack.slack(z)[0], stack.d[0]
        y[:, 0] = np.maximum(y[:, 0], 0.0) / scale[:, 0] + length(y[:, 1:])
    x[:, 0] += np.where(is_row, 0.0, speed / d)
    y[:, 0] += speed
    y[is_row] = 0.0
    while (step := take_step(stack, scale, x, y)) is not None:
        x, y, entries = step
        yield stack.project((x / scale)[None]), 2.0 + entries / max(stack.pattern.nonzeros, 1)


def take_step(
    stack: ConeStack, scale: Cones, x: Cones, y: Cones
) -> tuple[Cones, Cones, float] | None:
    """Return the next x and y, and the entries that the factorization processed; None if no step is possible."""
    cones, X, Y = ~stack.pattern.is_row, *(one[~stack.pattern.is_row] for one in (x, y))
    own, root = nesterov_todd_scaling(X, Y)
    eye = np.eye(stack.m)
    H = np.zeros((stack.k, stack.m, stack.m))
    H[cones] = own
    G = np.tile(eye, (stack.k, 1, 1))
    G[:, 0, 1:] -= scale[:, :1] * y[:, 1:] / np.maximum(length(y[:, 1:]), NORMAL)[:, None]
    left = apply(G, scale * y) - stack.slack((x / scale)[None])[0]
    by_z = G * scale[:, None] @ H * scale[:, None]
    least = accuracy_of(stack)[0]  # equations may depend on each other
    by_z[~cones] = (least * stack.d[0, ~cones])[:, None, None] * eye
    if not (np.isfinite(by_z).all() and np.isfinite(left).all()):
        return None
    try:
        factors = factorize_blocks(stack, by_z[None], np.broadcast_to(eye, by_z.shape)[None])

        def direction(of_cones: Cones, share: float = 1.0) -> tuple[Cones, Cones]:
            """Return dx, dy with H dx + dy = c that remove a share of the residual."""
            c = np.zeros_like(x)
            c[cones] = of_cones
            dx = factors.solve((share * left + apply(G, scale * c))[None])[0] * scale
            return dx, c - apply(H, dx)

        dx, dy = direction(-Y)
        t = min(1.0, longest(X, dx[cones]), longest(Y, dy[cones]))
        mean = float((x * y).sum()) / max(len(X), 1)
        after = float(((x + t * dx) * (y + t * dy)).sum()) / max(len(X), 1)
        at, moved = apply(root, X), apply(root, dx[cones])
        right = product(moved, at + moved) - product(at, at)
        right[:, 0] += mean * min(1.0, max(after / mean, 0.0) ** 3) if mean else 0.0
        dx, dy = direction(apply(root, quotient(right, at)))
        t = TO_THE_BOUNDARY * min(longest(X, dx[cones]), longest(Y, dy[cones]))
        for sigma in CENTRED if t < SHORT else ():
            right = -product(at, at)
            right[:, 0] += sigma * mean
            centring = direction(apply(root, quotient(right, at)), 1.0 - sigma)
            ends = (
                longest(*pair)
                for pair in zip((X, Y), (one[cones] for one in centring), strict=True)
            )
            further = TO_THE_BOUNDARY * min(ends)
            if further > t:
                (dx, dy), t = centring, further
    except np.linalg.LinAlgError:
        return None
    return x + min(1.0, t) * dx, y + min(1.0, t) * dy, factors.entries


def apply(blocks: NDArray[np.float64], x: Cones) -> Cones:
    """Return the product of each block with its part of x."""
    return np.einsum("kij,kj->ki", blocks, x)


def determinant(x: Cones) -> Vector:
    """Return x_N² − ‖x_T‖², shape (k,)."""
    tangent = np.linalg.norm(x[:, 1:], axis=1)
    return (x[:, 0] - tangent) * (x[:, 0] + tangent)


def product(a: Cones, b: Cones) -> Cones:
    """Return Jordan's product (aᵀb, a_N b_T + b_N a_T)."""
    return np.column_stack([(a * b).sum(axis=1), a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:]])


def quotient(b: Cones, a: Cones) -> Cones:
    """Return the c whose Jordan product with a is b."""
    normal = ((a[:, 0] * b[:, 0] - (a[:, 1:] * b[:, 1:]).sum(axis=1)) / determinant(a))[:, None]
    return np.column_stack([normal, (b[:, 1:] - normal * a[:, 1:]) / a[:, :1]])


def nesterov_todd_scaling(x: Cones, y: Cones) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the symmetric H with H x = y, a quadratic representation, and its root, shape (k, d, d) each."""
    mirror = np.diag(np.r_[1.0, -np.ones(x.shape[1] - 1)])
    of_x, of_y = np.sqrt(determinant(x))[:, None], np.sqrt(determinant(y))[:, None]
    a, b = x / of_x, y / of_y
    w = (a @ mirror + b) / np.sqrt(2.0 * (1.0 + (a * b).sum(axis=1)))[:, None]
    half = w.copy()
    half[:, 0] += 1.0
    half /= np.sqrt(2.0 * (1.0 + w[:, 0]))[:, None]
    ratio = (of_y / of_x)[:, :, None]
    H, root = (2.0 * v[:, :, None] * v[:, None, :] - mirror for v in (w, half))
    return ratio * H, np.sqrt(ratio) * root


def longest(x: Cones, step: Cones) -> float:
    """Return the largest t for which x + t step is in the cones."""
    a = determinant(step)
    b = x[:, 0] * step[:, 0] - (x[:, 1:] * step[:, 1:]).sum(axis=1)
    c = determinant(x)
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    larger = -(b + np.where(b >= 0.0, root, -root))
    ends = np.stack([larger / a, c / larger, -x[:, 0] / step[:, 0]])
    ends[:2, b * b < a * c] = np.inf
    return float(np.where(ends > 0.0, ends, np.inf).min(initial=np.inf))


Points = Iterator[Step]  # z of shape (1, k, m), its relative residual without rounding, work

STOP = 1e-2  # of the goal: smaller changes end the sweeps
STANDSTILL, SLOW = 100, 0.2  # steps of sweeps without a gain, and their share of all
NEWTON_STEPS = 300  # of one call
PATH_STEPS, NO_GAIN = 40, 8  # of the central path, and steps without a new best
NEAR, NEARER = 1e-3, 1e-2  # residual below which Newton's steps are tried, and its later reduction
PROGRAMS, PROGRAM_WORK = 5, 20.0  # convex programs without a gain, and the work of one
# times the mean of |z_i|, or of the references, by which starts are moved at random
SPREADS = 1.0, 8.0


def sweep_points(
    stack: ConeStack,
    z: Vector,
    count: float,
    goal: float,
    *,
    each: int = SWEEPS_PER_STEP,
    patience: float = np.inf,
) -> Points:
    """Yield the points after every `each` of `count` sweeps, until the residual no longer falls."""
    least, since, steps = np.inf, 0, 0
    while steps * each < count and since <= max(patience, SLOW * steps) and least > goal:
        z, _ = sweep_blocks(stack, z, each, STOP * goal)
        residual = stack.relative_residual(z)
        if not np.isfinite(residual):
            return
        least, since = (residual, 0) if residual < NEWTON_GAIN * least else (least, since + 1)
        steps += 1
        yield Step(z, residual=residual, work=each + 1.0, iterations=1)


def newton_points(stack: ConeStack, z: Vector, steps: int, goal: float) -> Points:
    """Yield a point of Newton's method per linear system of one problem."""
    for _, at, residual, work in islice(newton_steps(stack, z, steps, goal), 1, None):
        yield Step(at, residual=float(residual[0]), work=work, iterations=1)


def path_points(stack: ConeStack, z: Vector, share: float, goal: float) -> Points:
    """Yield points of the central path from near z, and of Newton's method close to its end."""
    best, least, near, since = z, np.inf, NEAR, 0
    for new, work in islice(central_path(stack, z, share), PATH_STEPS):
        size = stack.relative_residual(new)
        yield Step(new, residual=size, work=work, iterations=1)
        best, least, since = (new, size, 0) if size < least else (best, least, since + 1)
        if size <= near:
            for point in newton_points(stack, new, 10, goal):
                yield point
                if point.residual is not None and point.residual <= goal:
                    return
            near = NEARER * min(near, size)
        if since > NO_GAIN:
            break
    yield from newton_points(stack, best, 40, goal)


def move_at_random(stack: ConeStack, z: Vector, seed: int) -> Any:
    """Return a point of the cones near z, the same for the same seed."""
    size = max(float(np.abs(z).mean()), float(stack.reference.mean()))
    way = np.random.default_rng(seed).standard_normal(z.shape)
    return stack.project(z + SPREADS[seed % 2] * size * way)


@dataclass(frozen=True, kw_only=True)
class ConeAlgorithm:
    """A method over cones: a frozen dataclass of its options."""

    name: ClassVar[str]
    needs: ClassVar[str]
    solves: ClassVar[str]
    cost: ClassVar[str]
    reference: ClassVar[str]

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point per step from z, until the residual is at most `goal` or no longer falls."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class ConeNSGS(ConeAlgorithm):
    """Nonsmooth Gauss–Seidel: blocks are solved one after the other.

    A contact in space is solved exactly (open, stick, or the angle of sliding), any other cone by projections.

    Parameters
    ----------
    sweeps : int
        Number of sweeps per step.
    """

    name = "nsgs"
    needs = "blocks on the diagonal that are positive definite"
    solves = "cones without friction, M symmetric positive definite (by descent); else observed"
    cost = "one product with M a sweep"
    reference = "Jourdan, Alart, Jean 1998, doi:10.1016/S0045-7825(97)00137-1"

    sweeps: int = SWEEPS_PER_STEP

    def __post_init__(self) -> None:
        whole_number(self.sweeps, "nsgs: sweeps", 1)

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point every few sweeps."""
        return sweep_points(stack, z, np.inf, goal, each=self.sweeps, patience=STANDSTILL)


@dataclass(frozen=True, kw_only=True)
class ConeNewton(ConeAlgorithm):
    """Semismooth Newton on the natural map R(z) = z − P(z − ŵ/d), with a nonmonotone line search on ‖R‖₂."""

    name = "newton"
    needs = "enough memory for a factorization"
    solves = "locally, where the generalized derivatives are regular"
    cost = "one factor of the blocks that are not open"
    reference = "Alart, Curnier 1991, doi:10.1016/0045-7825(91)90022-X"

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point per linear system, until no step reduces the residual."""
        return newton_points(stack, z, NEWTON_STEPS, goal)


@dataclass(frozen=True, kw_only=True)
class ConeInteriorPoint(ConeAlgorithm):
    """Primal–dual interior point on De Saxcé's cones, Nesterov–Todd scaling, then Newton."""

    name = "interior_point"
    needs = "contacts with friction, and enough memory for a factorization"
    solves = "observed: also where many contacts make the same motion"
    cost = "one factor of all blocks a step, some 15 to 40 of them"
    reference = "Acary, Armand, Nguyen, Shpakovych 2024, doi:10.1080/10556788.2023.2296438"

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point per factorization."""
        if not problem.has_friction:
            raise UnsuitableProblem(f'{self.name} needs friction; try algorithm="fixed_point"')
        return path_points(stack, np.zeros_like(z), 1.0, goal)


@dataclass(frozen=True, kw_only=True)
class FixedPoint(ConeAlgorithm):
    """Fixed point over convex programs: min ½ zᵀM z + (q + s e_N)ᵀz over K, with fixed s = μ‖w_T‖.

    Each program is solved by Clarabel, an interior-point method on cones. If M is not symmetric, the program uses
    its symmetric part, and the remainder of M z is fixed as s is. Without friction, and for symmetric M, one
    program yields the solution.
    """

    name = "fixed_point"
    needs = "a symmetric part of M that is positive semidefinite"
    solves = "cones without friction, M symmetric positive semidefinite"
    cost = "one conic program, some ten to thirty factors"
    reference = "Acary, Cadoux, Lemaréchal, Malick 2011, doi:10.1002/zamm.201000073"

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point per program until five gain nothing, and Newton's points."""
        best, least, since = z, stack.relative_residual(z), 0
        for found in minimizers(problem, stack.pattern.flat(z)[0]):
            z = stack.pattern.wide(found[None])
            residual = stack.relative_residual(z)
            is_gain = residual < NEWTON_GAIN * least
            best, least, since = (z, residual, 0) if is_gain else (best, least, since + 1)
            yield Step(z, residual=residual, work=PROGRAM_WORK, iterations=1)
            if least <= goal or since >= PROGRAMS:
                break
        yield from newton_points(stack, best, 30, goal)


CLASSES = ConeNSGS, ConeNewton, ConeInteriorPoint, FixedPoint
METHODS: dict[str, type[ConeAlgorithm]] = {one.name: one for one in CLASSES}
