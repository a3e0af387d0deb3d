"""The central path of contacts with friction, which an interior point follows.

With û = u + μ‖u_T‖ e_N, of which u = û − μ‖û_T‖ e_N, and S = diag(μ, 1, 1) of each contact, x = S r and y = S⁻¹û lie in
Lorentz' cone, and are complementary. The path x ∘ y = σ e, û − μ‖û_T‖ e_N = W r + b is followed by steps with the
scaling of Nesterov and Todd, a predictor and a corrector; one step is a factor of W + G S H S, H the scaling and G the
derivative of u by û. It ends near the middle of all impulses that make the motion, where Newton's method converges:
many more contacts than bodies determine are no harder than few. Nothing is proved, as the problem is not convex.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...systems.factors import factor_fits, factorise
from .data import Blocks

Cones = NDArray[np.float64]  # shape (k, d)

LEAST_SLOPE = 1e-3  # of the cones that the path is in: Newton's steps have the caller's
TO_THE_BOUNDARY = 0.9
SHORT, CENTRED = (
    0.1,
    (0.5, 0.9),
)  # a step that is no longer goes to the path instead, to these parts of σ


class CentralPath:
    """The point x, y on its way, each of shape (k, d), of a problem with one pattern for the rows of a block of M."""

    @np.errstate(all="ignore")
    def __init__(self, problem: Blocks, M: Any) -> None:
        self.problem, self.M = problem, M
        k, d = problem.slope.size, int(problem.sizes.max(initial=1))
        self.slope = np.maximum(problem.slope, LEAST_SLOPE)
        self.scale = np.ones((k, d))
        self.scale[:, 0] = self.slope
        speed = float(np.abs(problem.q.reshape(k, d) / self.scale).max(initial=0.0)) or 1.0
        self.x, self.y = np.zeros((k, d)), np.zeros((k, d))
        self.x[:, 0], self.y[:, 0] = speed / np.median(problem.scale), speed
        self.identity, self.entries = (
            np.broadcast_to(np.eye(d), (k, d, d)).copy(),
            np.empty(self.M.nnz),
        )

    @property
    def point(self) -> FloatVector:
        """Impulses in the caller's cones, shape (n,)."""
        return self.problem.projected((self.x / self.scale).ravel())

    @np.errstate(all="ignore")
    def step(self) -> float | None:
        """Take a step; return its work in products with M, and None where none is possible."""
        from .kernels import newton_rows

        x, y, scale, M = self.x, self.y, self.scale, self.M
        H, root = scaling(x, y)
        slip = (
            y[:, 1:] / np.maximum(np.linalg.norm(y[:, 1:], axis=1), np.finfo(float).tiny)[:, None]
        )
        G = self.identity.copy()
        G[:, 0, 1:] -= self.slope[:, None] * slip
        left = apply(G, scale * y).ravel() - M @ (x / scale).ravel() - self.problem.q
        by_z = np.einsum("kia,ka,kab,kb->kib", G, scale, H, scale)
        if not (np.isfinite(by_z).all() and np.isfinite(left).all()):
            return None
        indptr, indices = np.empty_like(M.indptr), np.empty_like(M.indices)
        newton_rows(
            self.problem.starts,
            by_z,
            self.identity,
            M.indptr,
            M.indices,
            M.data,
            np.zeros(len(x)),
            np.arange(x.size),
            indptr,
            indices,
            self.entries,
        )
        J = sp.csr_array((self.entries, indices, indptr), shape=M.shape)
        factor = factorise(J, has_symmetric_pattern=True) if factor_fits(J) else None
        if factor is None:
            return None

        def direction(c: Cones, share: float = 1.0) -> tuple[Cones, Cones]:
            """Return the changes of x and y with H dx + dy = c that take a share of what is left of the motion."""
            right = share * left + apply(G, scale * c).ravel()
            dx = factor.solve(right).reshape(x.shape) * scale
            return dx, c - apply(H, dx)

        dx, dy = direction(-y)
        length = min(1.0, longest(x, dx), longest(y, dy))
        mean = float((x * y).sum()) / len(x)
        after = float(((x + length * dx) * (y + length * dy)).sum()) / len(x)
        at, moved = apply(root, x), apply(root, dx)
        right = product(moved, at + moved) - product(
            at, at
        )  # root⁻¹ y = at, and root⁻¹ dy = −at − moved
        right[:, 0] += mean * min(1.0, max(after / mean, 0.0) ** 3)
        dx, dy = direction(apply(root, quotient(right, at)))
        length = TO_THE_BOUNDARY * min(longest(x, dx), longest(y, dy))
        for sigma in CENTRED if length < SHORT else ():
            right = -product(at, at)
            right[:, 0] += sigma * mean
            centring = direction(apply(root, quotient(right, at)), 1.0 - sigma)
            further = TO_THE_BOUNDARY * min(longest(x, centring[0]), longest(y, centring[1]))
            if further > length:
                (dx, dy), length = centring, further
        length = min(1.0, length)
        self.x, self.y = x + length * dx, y + length * dy
        return (factor.work + 2.0 * factor.solve_work) / max(self.problem.nonzeros, 1) + 1.0


def apply(blocks: NDArray[np.float64], x: Cones) -> Cones:
    """Return the product of each block with its part of x."""
    found: Cones = np.einsum("kij,kj->ki", blocks, x)
    return found


def determinant(x: Cones) -> FloatVector:
    """Return x_N² − ‖x_T‖², shape (k,)."""
    tangent = np.linalg.norm(x[:, 1:], axis=1)
    found: FloatVector = (x[:, 0] - tangent) * (x[:, 0] + tangent)
    return found


def product(a: Cones, b: Cones) -> Cones:
    """Return Jordan's product (aᵀb, a_N b_T + b_N a_T)."""
    return np.column_stack([(a * b).sum(axis=1), a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:]])


def quotient(b: Cones, a: Cones) -> Cones:
    """Return the c whose Jordan product with a is b."""
    normal = ((a[:, 0] * b[:, 0] - (a[:, 1:] * b[:, 1:]).sum(axis=1)) / determinant(a))[:, None]
    return np.column_stack([normal, (b[:, 1:] - normal * a[:, 1:]) / a[:, :1]])


def scaling(x: Cones, y: Cones) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
    with np.errstate(all="ignore"):
        a = determinant(step)
        b = x[:, 0] * step[:, 0] - (x[:, 1:] * step[:, 1:]).sum(axis=1)
        c = determinant(x)
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        larger = -(b + np.where(b >= 0.0, root, -root))
        ends = np.stack([larger / a, c / larger, -x[:, 0] / step[:, 0]])
        ends[:2, b * b < a * c] = np.inf
        return float(np.where(ends > 0.0, ends, np.inf).min(initial=np.inf))
