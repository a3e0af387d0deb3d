"""Stopping criterion over cones: the criterion of an LCP (:mod:`lcp_plugin.core.certificates.criterion`), by rows.

A row between bounds is a row of an LCP. Contact with friction consists of two laws with residuals and terms of their
own: Signorini's condition z_N ≥ 0 ⟂ w_N ≥ 0, a row of an LCP, and Coulomb's law of the tangential rows, with the disk
‖z_T‖ ≤ μ z_N. So a large sliding velocity does not hide a small closing velocity. A second-order cone is one law.

For a law with several rows, norms over these rows replace absolute values. Its residual is the natural map's,
z − P(z − w/d), P the projection onto the disk or cone; its violation v is the distance of −w from the normal cone
at z. The point is snapped first: rows to bounds as in an LCP, z_k to the apex if the projection of z_k − w_k/d_k is the
apex, and z_T to the length μ z_N if the projection is on the boundary. The snapped point is measured and returned.

For contacts the demand a is the largest of the component: b at a contact of a pile may be rounding error.
Projections are nonexpansive: if w is within ρ, the residual of a cone is within ‖ρ‖/d, plus rounding in P.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.certificates.criterion import RowData, RowsAtPoint, VectorEnds
from ...core.certificates.residuals import divide_nonnegative
from ...core.checks import FloatVector, read_only
from ...core.kernels.floats import EPSILON, NORMAL
from ...core.rounding import compensated_product
from .data import Blocks
from .stack import ON, OUT, WITHIN, Array, ConeStack, length

SMALL = 1e-2  # of the reference: a larger residual does not count as limited by rounding
AT_ROUNDING = 2.0**-48  # of z_T: smaller distances from points of the boundary are rounding


class ConeRows(RowData):
    """Data of the criterion by rows, for the problems of a stack: (n,) if M is sparse, otherwise (B, n).

    Parameters
    ----------
    stack : ConeStack
    """

    def __init__(self, stack: ConeStack) -> None:
        self.stack, pattern = stack, stack.pattern
        of_row, first = pattern.of_row, pattern.starts[:-1]
        lower, upper = stack.low[:, of_row], stack.high[:, of_row]
        self.is_cone = pattern.sizes[of_row] > 1
        if stack.has_friction:
            self.is_cone[first] = False
            first = np.sort(np.concatenate([first, first + 1]))
            lower, upper = np.where(self.is_cone, -np.inf, 0.0), np.inf
        self._first, self._widths = first, np.diff(np.append(first, pattern.n))  # of each law
        q, labels = pattern.flat(stack.q), pattern.labels
        scale = stack.d[:, of_row]
        q, lower, upper, scale = np.broadcast_arrays(q, lower, upper, scale)
        labels = None if labels is None else labels[:, of_row]
        if pattern.is_sparse:
            q, lower, upper, scale = q[0], lower[0], upper[0], scale[0]
            labels = None if labels is None else labels[0]
        super().__init__(pattern.M, abs(pattern.M), q, lower, upper, scale, labels)

    def flat(self, x: Array) -> Array:
        """Return an array of shape (B, k, m) by rows."""
        x = self.stack.pattern.flat(x)
        return x[0] if self.stack.pattern.is_sparse else x

    def wide(self, x: Array) -> Array:
        """Return an array by rows in the shape (B, k, m)."""
        return self.stack.pattern.wide(x[None] if x.ndim == 1 else x)

    def of_blocks(self, x: Array) -> Array:
        """Return the largest value in the rows of each block, shape (B, k)."""
        starts = self.stack.pattern.starts[:-1]
        return np.maximum.reduceat(x[None] if x.ndim == 1 else x, starts, -1)

    def _norm(self, x: Array) -> Array:
        """Return the norm of x over the rows of each law, in each of these rows."""
        return np.repeat(np.hypot.reduceat(np.abs(x), self._first, -1), self._widths, -1)

    @cached_property
    def reference(self) -> Array:
        """A lower bound of ‖r_P(z°)‖∞ in the component of each row."""
        at = self.rows(self.start)
        return self.largest(self.residual_ends(self.start, at.w, at.rounding)[0])

    @cached_property
    def demand(self) -> FloatVector:
        """Demand of each law; of contacts the largest of the component, because b may be rounding error in a pile."""
        demand: FloatVector = super().demand
        found: FloatVector = self.largest(demand) if self.stack.has_friction else self._norm(demand)
        return found

    def rows(self, z: FloatVector) -> RowsAtPoint:
        """Return the values of all laws at z."""
        at = super().rows(z)
        if not self.is_cone.any():
            return at
        stack, x, g = self.stack, self.wide(z), self.wide(at.w)
        radius, tangent = stack.mu * x[..., 0], length(x[..., 1:])
        is_on = tangent >= (1.0 - AT_ROUNDING) * radius
        outward = x / np.maximum(tangent, NORMAL)[..., None]
        if stack.has_friction:
            outward[..., 0], g = 0.0, np.where(np.arange(stack.m) > 0, g, 0.0)
            is_apex, is_free = radius == 0.0, ~is_on
        else:
            outward[..., 0] = -stack.mu
            outward /= np.sqrt(1.0 + stack.mu**2)[..., None]
            is_apex = is_on & (radius == 0.0)
            is_free = ~is_apex
        push = np.where(is_on, np.maximum(-(g * outward).sum(-1), 0.0), 0.0)
        far = g + push[..., None] * outward  # −w minus its projection onto the normal cone
        at_apex = 0.0 if stack.has_friction else stack.project(-g)
        far = np.where(is_apex[..., None], at_apex, far)
        violation = np.where(self.is_cone, self._norm(self.flat(far)), at.violation)
        is_free = self.flat(np.broadcast_to(is_free[..., None], x.shape))
        is_active = np.where(self.is_cone, is_free | (violation > 0.0), at.is_active)
        return at._replace(terms=self._norm(at.terms), violation=violation, is_active=is_active)

    def residual_ends(
        self, z: FloatVector, w: FloatVector, rounding: FloatVector, scale: Any = None
    ) -> VectorEnds:
        """Return bounds of the residual of each law for slacks within w ± rounding."""
        low, high = super().residual_ends(z, w, rounding, scale)
        if not self.is_cone.any():
            return low, high
        stack, x, g, error = self.stack, *map(self.wide, (z, w, rounding))
        d = stack.d if scale is None else np.ones_like(stack.d)
        if stack.has_friction:
            R, error = _of_coulomb(
                stack.mu * x[..., 0], x, g / d[..., None], length(error[..., 1:]) / d
            )
        else:
            R, error = _of_cones(stack, d, x, g, error)
        sizes, errors = (
            self._norm(self.flat(R)),
            self.flat(np.broadcast_to(error[..., None], x.shape)),
        )
        is_known = np.isfinite(self._norm(w + rounding + z))
        least, most = np.maximum(sizes - errors, 0.0), sizes + errors
        low = np.where(self.is_cone, np.where(is_known, least, 0.0), low)
        return low, np.where(self.is_cone, np.where(is_known, most, np.inf), high)

    def snap_to_bounds(self, z: FloatVector, w: FloatVector) -> FloatVector:
        """Return z, rows projected onto bounds as in an LCP, and cones onto the apex or boundary that they reach."""
        z = super().snap_to_bounds(z, w)
        if not self.is_cone.any():
            return z
        stack, x = self.stack, self.wide(z)
        radius, beyond = stack.mu * x[..., 0], x - self.wide(w) / stack.d[..., None]
        tangent = length(beyond[..., 1:])
        if stack.has_friction:
            is_on, is_apex = tangent > radius, radius == 0.0
        else:
            case = stack.residual(x, self.wide(w))[1]
            is_on, is_apex = case == ON, case == OUT
        edge = beyond * (radius / np.maximum(tangent, NORMAL))[..., None]
        edge[..., 0] = x[..., 0]
        is_far = length(edge - x) > AT_ROUNDING * length(x)
        moved = np.where((is_on & is_far)[..., None], edge, x)
        moved = np.where(is_apex[..., None], 0.0, moved)
        return np.where(self.is_cone, self.flat(moved), z)


def _of_coulomb(radius: Array, z: Array, step: Array, error: Array) -> tuple[Array, Array]:
    """Return the residuals z_T − P(z_T − step) of Coulomb's law, (B, k, m), and bounds of their errors, (B, k).

    The step is within `error`. Beyond the disk P divides errors by the distance from the axis.
    """
    beyond = z - step
    tangent = length(beyond[..., 1:])
    least = tangent - error
    edge = beyond * (radius / np.maximum(tangent, NORMAL))[..., None]
    is_beyond = tangent > radius
    R = np.where(is_beyond[..., None], z - edge, step)
    R[..., 0] = 0.0
    error = np.where(least > radius, error * (radius / np.maximum(least, NORMAL)), error)
    size: Array = np.where(is_beyond, radius, length(R))
    error += 8.0 * EPSILON * size
    return R, np.where(radius > 0.0, error, 0.0)


def _of_cones(stack: ConeStack, d: Array, z: Array, w: Array, error: Array) -> tuple[Array, Array]:
    """Return the residuals of second-order cones, shape (B, k, m), and bounds of their rounding errors, (B, k)."""
    plain = stack if d is stack.d else copy(stack)
    plain.d = d
    R, case, *_ = plain.residual(z, w)
    mu, within, slip = stack.mu, length(error), length(w[..., 1:])
    inside = 0.5 * (mu * z[..., 0] - length(z[..., 1:])) / (1.0 + mu)
    size = np.where((case == WITHIN) & (length(R) < inside), 0.0, length(z))
    size += (1.0 + mu) * (length(w) + within) / d
    of_projection = 2.0 * (stack.pattern.sizes + 8.0) * EPSILON * (1.0 + mu) * size
    is_open = (case == OUT) & ~z.any(-1) & (w[..., 0] - error[..., 0] >= mu * (slip + within))
    total = within / d + np.where(case == OUT, 0.0, of_projection)
    return R, np.where(is_open, 0.0, total)


class Measures:
    """Residuals of points for the problems of a stack.

    Parameters
    ----------
    stack : ConeStack
    z : array, shape (B, k, m)
        Points of the cones.
    tolerance, absolute : float

    Attributes
    ----------
    z, w : array, shape (B, k, m)
        The snapped points, which are measured, and their slack.
    sizes, relative, terms : array, shape (B, k)
        Upper bounds of the residuals, in the unit of z; relative to the reference; and the least tolerance of each
        block in the componentwise test.
    do_pass : array, shape (B, k)
        Blocks that meet the criterion.
    residual, passes, is_limited : array, shape (B,)
        The largest relative residual of each problem, whether its point is SOLVED, and whether rounding explains the
        residuals of all blocks that do not pass.

    Notes
    -----
    Sums of one problem are repeated in twice the working precision if this may decide.
    """

    @np.errstate(all="ignore")
    def __init__(self, stack: ConeStack, z: Array, tolerance: float, absolute: float = 0.0) -> None:
        rows = ConeRows(stack)
        x = rows.flat(z)
        at = rows.rows(x)
        moved = rows.snap_to_bounds(x, at.w)
        if (moved != x).any():
            x, at = moved, rows.rows(moved)
        reference = np.minimum(rows.reference, rows.active_reference(at))
        ends = rows.residual_ends(x, at.w, at.rounding)
        goal = np.maximum(tolerance * reference, absolute)
        if stack.B == 1 and (ends[1] > goal).any() and (ends[0] <= goal).all():
            M, q = (rows.M, rows.q) if x.ndim == 1 else (sp.csr_array(rows.M[0]), rows.q[0])
            sharp = compensated_product(M, np.ascontiguousarray(x.ravel()), np.ascontiguousarray(q))
            ends = rows.residual_ends(x, *(one.reshape(x.shape) for one in sharp))
        relative = divide_nonnegative(ends[1], reference)
        relative = np.where(np.isfinite(reference), relative, np.inf)
        terms = rows.term_residuals(x, at)
        do_pass = ((relative <= tolerance) & (terms <= tolerance)) | (ends[1] <= absolute)
        self.stack, self.z, self.w = stack, rows.wide(x), rows.wide(at.w)
        of_blocks = map(rows.of_blocks, (ends[1], relative, terms, ~do_pass))
        self.sizes, self.relative, self.terms, fails = of_blocks
        self.do_pass = ~fails
        self.passes = self.do_pass.all(1) & np.isfinite(self.w).all((1, 2))
        self.residual = self.relative.max(1, initial=0.0)
        is_small = (relative <= SMALL) | (reference == 0.0)
        is_open = ~(do_pass | ((ends[0] <= 0.0) & is_small))
        self.is_limited = ~rows.of_blocks(is_open).any(1)


class ConeCertificate:
    """Residuals of a point for a problem over cones.

    Attributes
    ----------
    problem : Blocks
        The problem.
    z, w : ndarray, shape (n,)
        The point, and M z + q.
    relative_residual : float
        The largest residual of a law relative to the reference of its component, rounded upwards.
    term_residual : float
        The least tolerance at which every law passes the componentwise test.
    worst_index : int
        The block of the largest relative residual; −1 without blocks.
    """

    is_linearised: ClassVar[bool] = True  # its rows are not the rows of an LCP

    def __init__(self, problem: Blocks, measures: Measures) -> None:
        self.problem, self.measures, pattern = problem, measures, measures.stack.pattern
        self.z = read_only(pattern.flat(measures.z)[0].copy())
        self.w = read_only(pattern.flat(measures.w)[0].copy())

    @property
    def relative_residual(self) -> float:
        """The largest residual of a law relative to the reference of its component."""
        return float(self.measures.residual[0])

    @property
    def term_residual(self) -> float:
        """The least tolerance at which every law passes the componentwise test."""
        return float(self.measures.terms.max(initial=0.0))

    @property
    def worst_index(self) -> int:
        """The block of the largest relative residual; −1 without blocks."""
        relative = self.measures.relative[0]
        return int(np.argmax(relative)) if relative.size else -1

    @property
    def scaled_residual(self) -> float:
        """The residual of that block, in the unit of z."""
        return float(self.measures.sizes[0, self.worst_index]) if self.z.size else 0.0

    @cached_property
    def natural_residual(self) -> float:
        """The largest ‖z_k − P_K(z_k − ŵ_k)‖, unscaled."""
        plain = copy(self.measures.stack)
        plain.d = np.ones_like(plain.d)
        with np.errstate(all="ignore"):
            return float(
                length(plain.residual(self.measures.z, self.measures.w)[0]).max(initial=0.0)
            )

    @property
    def dissipation(self) -> float:
        """−zᵀw; for contacts the energy −rᵀu that friction would take at the final velocities."""
        with np.errstate(all="ignore"):
            return float(-(self.z @ self.w))

    @property
    def lost_energy(self) -> float:
        """−rᵀ(b + u)/2, the kinetic energy that impact and friction take: impulses r change velocities b to u."""
        with np.errstate(all="ignore"):
            return float(-0.5 * (self.z @ (self.problem.q + self.w)))

    def __str__(self) -> str:
        lines = [
            ("relative residual", self.relative_residual),
            ("natural residual", self.natural_residual),
            ("term residual", self.term_residual),
            ("z · w", -self.dissipation),
        ]
        return "\n".join(f"{name:<18} {value:.3e}" for name, value in lines)
