"""Derivative of solutions over cones by q, M, bounds and friction, from R(z; M, q, μ) = 0.

The derivative is computed as in :mod:`lcp_plugin.systems.free_systems` with the generalized derivatives of Newton's
steps, and R_μ dμ. If several impulses solve the problem, dz is the change of least norm, and dw belongs to it: the
motions may differ also, as of a box that slides and spins on four corners. If a block is on the boundary of two modes,
dz is one-sided: it uses the elements of the piece into which dz and dw lead.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...core import checks
from ...core.checks import AnyMatrix, Array, Vector, derived_property
from ...core.cone_stack import ON, WITHIN, ConeStack, length
from ...core.errors import InvalidOption, UnsuitableProblem
from ...core.matrix import Matrix
from ...core.rounding import ROUNDING
from ...systems.free_systems import FreeSystem, LinearizedSystem
from ...systems.graph import outer_on_pattern
from .data import Blocks
from .factors import cone_stack_of
from .newton import polish_points, system_of_free_rows

PIECES, ALIKE = 20, 1e-12  # at most, for one direction, and the change of dz at which it ends


class ConeGradient(NamedTuple):
    """Gradients of a function by q and bounds, (n,), M on its pattern, and friction, (k,)."""

    q: Vector
    M: sp.csr_array
    friction: Vector
    lower: Vector
    upper: Vector


class StackDerivative(LinearizedSystem):
    """Derivatives of the solutions of a stack by the data, for vectors of shape (B, n).

    The attribute `system` requires B = 1.

    Parameters
    ----------
    stack : ConeStack
    z : array, shape (B, k, m)
        Solutions, which are refined first.
    """

    def __init__(self, stack: ConeStack, z: Array) -> None:
        self.stack = stack
        self.z = polish_points(stack, z)[0]
        self.w = stack.slack(self.z)
        self.take_element_at(self.z, self.w)

    def take_element_at(self, z: Array, w: Array) -> None:
        """Select the generalized derivative at z and w, the solution or a point nearby.

        w is set to 0 for sticking contacts, because gradients by least norm would depend on the direction of its
        rounding error.
        """
        stack = self.stack
        sticks = stack.has_friction & (stack.residual(z, w)[1] == WITHIN)
        w = np.where(sticks[..., None], 0.0, w)
        R, case, *others = stack.residual(z, w)
        self.point, self.projection = (z, w), (R, np.where(sticks, WITHIN, case), *others)
        self.by_z, self.by_w = stack.derivative(w, *self.projection[1:])
        self.is_free = self.by_w.any((-1, -2))

    @derived_property
    def system(self) -> Any:
        """The factorization of the system of the free blocks, for one problem."""
        J, _ = system_of_free_rows(self.stack, self.by_z[0], self.by_w[0], self.is_free[0])
        return FreeSystem(Matrix(sp.csr_array(J)), np.ones(J.shape[0], np.bool_), by_factor=True)

    @derived_property
    def degenerate(self) -> Array:
        """Blocks on the boundary of two modes, up to rounding error, shape (B, k)."""
        shift = np.zeros_like(self.z)
        shift[..., 0] = self._rounding
        points = self.z - shift, self.z, self.z + shift
        below, modes, above = (self.stack.residual(z, self.w)[1] for z in points)
        return (below != modes) | (above != modes)

    @derived_property
    def _rounding(self) -> Array:
        """Rounding error of z and w/d of each block, (B, k)."""
        terms = self.stack.pattern.times(self.z, absolute=True) + np.abs(self.stack.q)
        size = length(terms) / self.stack.d
        return ROUNDING * np.where(size == 0.0, 1.0, size)  # nothing acts: any size will do

    def branch_towards(self, dz: Array, dw: Array) -> StackDerivative:
        """Return the derivative of the piece into which dz and dw move degenerate blocks."""
        wide = self.stack.pattern.wide
        dz, dw = wide(dz), wide(dw)
        size = length(np.abs(dz) + np.abs(dw) / self.stack.d[..., None])
        moved = self.degenerate & (size > 0.0)
        t = np.where(moved, self._rounding / np.where(moved, size, 1.0), 0.0)[..., None]
        piece = checks.copy_without(self, "system", "by_friction")
        piece.take_element_at(self.z + t * dz, self.w + t * dw)
        return piece

    @derived_property
    def by_friction(self) -> Array:
        """R_μ, shape (B, n), not 0 on the boundary of cones."""
        stack, (z, w), mu = self.stack, self.point, self.stack.mu
        if not stack.has_friction:
            return np.zeros(stack.pattern.flat(z).shape)
        case, x, tangent, _ = self.projection[1:]
        x, tangent = x / stack.d[..., None], tangent / stack.d
        speed = length(w[..., 1:])
        radius = (x[..., 0] - mu * speed / stack.d + mu * tangent) / (1.0 + mu * mu)
        change = (tangent - 2.0 * mu * radius) / (1.0 + mu * mu)
        rows = speed[..., None] * self.by_w[..., 0]
        rows[..., 0] -= change
        rows[..., 1:] -= ((radius + mu * change) / tangent)[..., None] * x[..., 1:]
        return stack.pattern.flat(np.where((case == ON)[..., None], rows, 0.0))

    def gradients(self, g: Array, by_w: Array) -> tuple[Array, Array, Array]:
        """Return the gradients by q, by the active bounds, and by friction, (B, k)."""
        by_q, by_bound, multiplier = self.adjoint(g, by_w)
        return by_q, by_bound, -self.stack.pattern.wide(self.by_friction * multiplier).sum(-1)

    def _product(self, x: Array, *, transposed: bool = False) -> Array:
        pattern, M = self.stack.pattern, self.stack.pattern.M
        if pattern.is_sparse:
            return ((M.T if transposed else M) @ x[0])[None]
        return ((M.swapaxes(1, 2) if transposed else M) @ x[:, :, None])[:, :, 0]

    def _by_slack(self, x: Array, *, transposed: bool = False) -> Array:
        blocks = self.by_w.swapaxes(-1, -2) if transposed else self.by_w
        return self.stack.pattern.flat((blocks @ self.stack.pattern.wide(x)[..., None])[..., 0])

    def _solve_free(self, right: Array, *, transposed: bool = False) -> Array:
        x, rows = np.zeros(right.shape), self.is_free[0][self.stack.pattern.of_row]
        if rows.any():
            solution = self.system.least_solution(right[0, rows], transposed=transposed)
            if solution is None:
                raise UnsuitableProblem(
                    "more than 500 rows have several answers for one motion; add a small compliance "
                    "to the diagonal of W"
                )
            x[0, rows] = solution
        return x


class ConeDerivative:
    """Derivative of z by the data, at one solution.

    Parameters
    ----------
    problem : ConeProblem or FrictionalContact
    z : array, shape (n,)
        Solution of the problem, which is refined first.
    """

    def __init__(self, problem: Blocks, z: Vector) -> None:
        stack = cone_stack_of(problem)
        self.problem = problem
        self._of = StackDerivative(stack, stack.pattern.wide(np.array(z)[None]))
        self.z, self.w = (stack.pattern.flat(vector)[0] for vector in (self._of.z, self._of.w))

    @property
    def free(self) -> NDArray[np.intp]:
        """The rows of the blocks that are not open."""
        return np.flatnonzero(self._of.is_free[0][self.problem.block_of_row])

    @property
    def is_singular(self) -> bool:
        """True if several z make one motion, up to rounding error; dz is then of least norm."""
        return bool(self._of.system.is_singular)

    @property
    def is_unique(self) -> bool | None:
        """False if blocks are degenerate or z is not unique, else None (not proved)."""
        return False if self.degenerate.size or self.is_singular else None

    @derived_property
    def degenerate(self) -> NDArray[np.intp]:
        """Blocks on the boundary of two modes, where the derivative is not unique."""
        return np.flatnonzero(self._of.degenerate[0])

    @checks.changes_by_name
    def jvp(
        self,
        *,
        dq: Array = None,
        dM: AnyMatrix = None,
        dfriction: Array = None,
        dlower: Array = None,
        dupper: Array = None,
    ) -> Vector:
        """Return the change dz, shape (n,), for changes of the data; one-sided at a kink.

        Parameters
        ----------
        dq : array, shape (n,), optional
            db of contacts.
        dM : array, shape (n, n), optional
            dW of contacts.
        dfriction : number or array, shape (k,), optional
        dlower, dupper : array, shape (n,), optional
            Changes of the bounds; only active bounds matter.

        Notes
        -----
        For a change dm of a mass matrix m, use dM = −J m⁻¹ dm m⁻¹ Jᵀ. For a change du of the bodies' velocities, use
        dq = J du.
        """
        problem, n = self.problem, self.problem.n
        low = checks.change_of_vector(dlower, "dlower", n)
        high = checks.change_of_vector(dupper, "dupper", n)
        if dfriction is not None and not problem.has_friction:
            raise InvalidOption("dfriction is of a FrictionalContact; a ConeProblem has none")
        p = problem.equations
        k = problem.slope.size - p
        friction = checks.change_of_vector(dfriction, "dfriction", k, may_be_number=True)
        slopes = np.append(friction, np.zeros(p))[problem.block_of_row]
        h = checks.change_of_slack(dM, dq, self.z)

        def change(of: StackDerivative) -> Vector:
            """Return dz with the selected generalized derivative."""
            of_bounds = self._by_bound(self._holds(of), low, high)[None]
            return of.tangent(h[None], of_bounds, of.by_friction * slopes)[0]

        dz, is_there = change(self._of), (self.z <= problem.lower, self.z >= problem.upper)
        # A wider cone places z as a larger normal force does
        first = problem.starts[:-1]
        moved = -self._by_bound(is_there, low, high)
        moved[first] += (
            self.z[first] * slopes[first] / np.where(problem.slope > 0.0, problem.slope, np.inf)
        )
        for _ in range(PIECES if self.degenerate.size else 0):
            dw = problem.rows.csr @ dz + h
            piece = self._of.branch_towards((dz + moved)[None], dw[None])
            last, dz = dz, change(piece)
            if np.abs(dz - last).max(initial=0.0) <= ALIKE * np.abs(dz).max(initial=0.0):
                break
        return dz

    @staticmethod
    def _by_bound(holds: tuple[Any, Any], low: Vector, high: Vector) -> Vector:
        """Return the changes of the bounds that hold rows, 0 in other rows."""
        is_lower, is_upper = holds
        return np.where(is_upper, high, np.where(is_lower, low, 0.0))

    def dw(self, dz: ArrayLike, *, dq: Array = None, dM: AnyMatrix = None) -> Vector:
        """Return the change of w = M z + q for a change dz of z, shape (n,)."""
        return self.problem.rows.csr @ np.asarray(dz) + checks.change_of_slack(dM, dq, self.z)

    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> ConeGradient:
        """Return the gradients of a function L, with g = ∂L/∂z and gw = ∂L/∂w (default 0), (n,)."""
        n, by_w = self.problem.n, checks.change_of_vector(gw, "gw", self.problem.n)
        parts = self._of.gradients(checks.checked_vector(g, "g", n)[None], by_w[None])
        by_q, by_bound, by_friction = (part[0] for part in parts)
        by_M = outer_on_pattern(self.problem.rows.matrix, by_q, self.z)
        lower, upper = (np.where(holds, by_bound, 0.0) for holds in self._holds(self._of))
        by_friction = by_friction[: by_friction.size - self.problem.equations]
        return ConeGradient(by_q, by_M, by_friction, lower, upper)

    def _holds(self, of: StackDerivative) -> tuple[Any, Any]:
        """Return the masks of the rows at their lower and at their upper bound."""
        problem, pattern = self.problem, of.stack.pattern
        at_bound = (~of.is_free[0] & pattern.is_row)[pattern.of_row]
        z, w = (pattern.flat(vector)[0] for vector in of.point)
        is_lower = (z <= problem.lower) & ((z < problem.upper) | (w > 0.0))
        return at_bound & is_lower, at_bound & ~is_lower
