"""Central path of contacts with friction, followed by an interior-point method.

Let û = u + μ‖u_T‖ e_N, so that u = û − μ‖û_T‖ e_N, and S = diag(μ, 1, 1) for each contact. Then x = S r and y =
S⁻¹û are in Lorentz' cone, and are complementary. The path x ∘ y = σ e, û − μ‖û_T‖ e_N = W r + b is followed by
steps with the scaling of Nesterov and Todd, a predictor and a corrector. One step takes one factorization of W + G
S H S, H the scaling and G the derivative of u by û. The path ends near the middle of all impulses that make the
motion, where Newton's method converges. Therefore contacts with undetermined impulses are not harder than others.
Convergence is not proved, because the problem is not convex.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Vector
from ...core.cone_stack import ConeStack, length
from ...core.kernels.floats import NORMAL
from .newton import accuracy_of, factorize_blocks

Cones = NDArray[np.float64]  # shape (k, d)

TO_THE_BOUNDARY = 0.9  # share of the way to the boundary of the cones that a step goes
SHORT, CENTERED = 0.1, (0.5, 0.9)  # after a shorter step a centering step is tried, with these σ


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
    cones, eye = ~stack.pattern.is_row, np.eye(stack.m)
    X, Y, H = x[cones], y[cones], np.zeros((stack.k, stack.m, stack.m))
    H[cones], root = nesterov_todd_scaling(X, Y)
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

        def reach(dx: Cones, dy: Cones) -> float:
            """Return the step length to the boundary of the cones."""
            return min(longest(X, dx[cones]), longest(Y, dy[cones]))

        dx, dy = direction(-Y)
        t = min(1.0, reach(dx, dy))
        mean = float((x * y).sum()) / max(len(X), 1)
        after = float(((x + t * dx) * (y + t * dy)).sum()) / max(len(X), 1)
        root_x, root_dx = apply(root, X), apply(root, dx[cones])
        right = jordan_product(root_dx, root_x + root_dx) - jordan_product(root_x, root_x)
        right[:, 0] += mean * min(1.0, max(after / mean, 0.0) ** 3) if mean else 0.0
        dx, dy = direction(apply(root, jordan_quotient(right, root_x)))
        t = TO_THE_BOUNDARY * reach(dx, dy)
        for sigma in CENTERED if t < SHORT else ():
            right = -jordan_product(root_x, root_x)
            right[:, 0] += sigma * mean
            centering = direction(apply(root, jordan_quotient(right, root_x)), 1.0 - sigma)
            further = TO_THE_BOUNDARY * reach(*centering)
            if further > t:
                (dx, dy), t = centering, further
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


def jordan_product(a: Cones, b: Cones) -> Cones:
    """Return Jordan's product (aᵀb, a_N b_T + b_N a_T)."""
    return np.column_stack([(a * b).sum(axis=1), a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:]])


def jordan_quotient(b: Cones, a: Cones) -> Cones:
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
