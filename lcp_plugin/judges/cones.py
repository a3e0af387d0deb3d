"""Stopping criterion over cones: the criterion of an LCP (:mod:`lcp_plugin.judges.lcp`), by rows.

A row between bounds is a row of an LCP. Contact with friction consists of two laws, each with residuals and
terms: Signorini's condition z_N ≥ 0 ⟂ w_N ≥ 0, a row of an LCP, and Coulomb's law of the tangential rows, with the disk
‖z_T‖ ≤ μ z_N. So a large sliding velocity does not hide a small closing velocity. A second-order cone is one law.

For a law with several rows, norms over these rows replace absolute values. Its residual is the natural map's,
R = z − P(z − w/d), P the projection onto the disk or cone, d > 0 the unit of the block's slack, from the diagonal of M;
its violation is v = d ‖R‖, also of a z outside its cone. The point is snapped first: rows to bounds as in an
LCP, z_k to the apex if the projection of z_k − w_k/d_k is the apex, and z_T to the length μ z_N if the projection is
on the boundary. The snapped point is measured and returned.

For contacts the demand a is the largest of the component: b at a contact of a pile may be rounding error.
Projections are nonexpansive: if w is within ρ, the residual of a cone is within ‖ρ‖/d, plus rounding in P.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.checks import Array, Vector, derived_property
from ..core.cone_stack import ON, OUT, WITHIN, ConeStack, length
from ..core.kernels.compilation import helper
from ..core.kernels.floats import EPSILON, NEGLIGIBLE, NORMAL
from .lcp import Measured, RowData, RowsAtPoint, VectorEnds

AT_ROUNDING = 2.0**-48  # of z_T: smaller distances from points of the boundary are rounding
# A violation below this part of the terms of a law passes in any order of summation
CERTAINLY_NEGLIGIBLE = 0.5 * NEGLIGIBLE


class ConeRows(RowData):
    """Data of the criterion by rows, for the problems of a stack: (n,) if M is sparse, otherwise (B, n).

    Parameters
    ----------
    stack : ConeStack
    """

    def __init__(self, stack: ConeStack) -> None:
        self.stack, pattern = stack, stack.pattern
        of_row, first = pattern.of_row, pattern.starts[:-1]
        self.is_cone = pattern.sizes[of_row] > 1
        if stack.has_friction:
            self.is_cone[first] = False
            is_free = self.is_cone | pattern.is_row[of_row]  # rows are equations
            lower, upper = np.where(is_free, -np.inf, 0.0), np.full(pattern.n, np.inf)
        else:
            lower, upper = self._by_rows(stack.low), self._by_rows(stack.high)
        self._first = int(stack.has_friction)  # row of a block that belongs to the law of its cone
        self.has_cones = bool(self.is_cone.any())
        scale, labels = self._by_rows(stack.d), pattern.labels
        labels = None if labels is None else self._by_rows(labels)
        M = pattern.M
        super().__init__(M, abs(M), self.flat(stack.q), lower, upper, scale, labels)
        self.origin = np.broadcast_to(self.origin, self.q.shape)

    def _by_rows(self, x: Array) -> Array:
        """Return values of blocks in each of their rows, (B, n), or (n,) if M is sparse."""
        pattern = self.stack.pattern
        return x[0, pattern.of_row] if pattern.is_sparse else x[:, pattern.of_row]

    def flat(self, x: Array) -> Array:
        """Return an array of shape (B, k, m) by rows."""
        x = self.stack.pattern.flat(x)
        return x[0] if self.stack.pattern.is_sparse else x

    def wide(self, x: Array) -> Array:
        """Return an array by rows in the shape (B, k, m)."""
        return self.stack.pattern.wide(x[None] if x.ndim == 1 else x)

    def _with_laws(self, x: Array, values: Array) -> Array:
        """Return x with the values of cones and disks, (B, k), in their rows."""
        return np.where(self.is_cone, self._by_rows(values), x)

    def norm(self, x: Array) -> Array:
        """Return |x|, and the norm over the rows of each cone or disk in each of these rows."""
        return self._with_laws(np.abs(x), length(self.wide(x)[..., self._first :]))

    def measure_blocks(self, z: Array, tolerance: float, absolute: float = 0.0) -> Measured:
        """Return the measure of points of the cones, shape (B, k, m), snapped; numbers have the shape (B,)."""
        measured = self.measure(self.flat(z), tolerance, absolute=absolute)
        shape = (self.stack.B,)
        numbers = measured.residual, measured.passes, measured.is_limited
        residual, passes, is_limited = (np.broadcast_to(number, shape) for number in numbers)
        return Measured(self.wide(measured.z), residual, passes, is_limited, *measured[4:])

    def of_blocks(self, values: Array) -> Array:
        """Return the largest of the values by rows in each block, shape (B, k)."""
        starts = self.stack.pattern.starts[:-1]
        return np.maximum.reduceat(values[None] if values.ndim == 1 else values, starts, -1)

    @derived_property
    def demand(self) -> Vector:
        """Demand of each law; of contacts the largest of the component, because b may be rounding error in a pile."""
        demand: Vector = super().demand
        return self.largest(demand) if self.stack.has_friction else self.norm(demand)

    def rows(self, z: Vector, w: Array = None) -> RowsAtPoint:
        """Return the values of all laws at z, with its slack w if that is known."""
        at = super().rows(z, w)
        if not self.has_cones:
            return at
        stack, terms = self.stack, self.norm(at.terms)
        x, slack = self.wide(z), self.wide(at.w)
        if stack.has_friction:
            sizes, _ = _of_coulomb(stack, x, slack, 0.0 * slack)
            is_free = length(x[..., 1:]) < stack.mu * x[..., 0]
        else:
            sizes, is_free = length(stack.residual(x, slack)[0]), x.any(-1)
        violation = self._with_laws(at.violation, stack.d * sizes)
        is_active = self._with_laws(at.is_active, is_free) | (violation > NEGLIGIBLE * terms)
        return at._replace(terms=terms, violation=violation, is_active=is_active)

    def residual_ends(
        self, z: Vector, w: Vector, rounding: Any = None, scale: Any = None
    ) -> VectorEnds:
        """Return bounds of the residual of each law for slacks within w ± rounding."""
        low, high = super().residual_ends(z, w, rounding, scale)
        if not self.has_cones:
            return low, high
        rounding = np.zeros(w.shape) if rounding is None else rounding
        bounds_of = _of_coulomb if self.stack.has_friction else _of_cones
        size, error = bounds_of(self.stack, *map(self.wide, (z, w, rounding)))
        is_known = np.isfinite(size + error)
        low = self._with_laws(low, np.where(is_known, np.maximum(size - error, 0.0), 0.0))
        return low, self._with_laws(high, np.where(is_known, size + error, np.inf))

    def snap_to_bounds(self, z: Vector, w: Vector) -> Vector:
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


def _of_coulomb(stack: ConeStack, z: Array, w: Array, error: Array) -> tuple[Array, Array]:
    """Return the residuals ‖z_T − P(z_T − w_T/d)‖ of Coulomb's law, shape (B, k), and bounds of their errors.

    The slack is within w ± `error`. Beyond the disk P divides errors by the distance from the axis.
    """
    d, radius, z = stack.d[..., None], stack.mu * z[..., 0], z[..., 1:]
    step, error = w[..., 1:] / d, length(error[..., 1:] / d)
    beyond = z - step
    tangent = length(beyond)
    is_beyond, least = tangent > radius, tangent - error
    edge = beyond * (radius / np.maximum(tangent, NORMAL))[..., None]
    size = length(np.where(is_beyond[..., None], z - edge, step))
    error = np.where(least > radius, error * (radius / np.maximum(least, NORMAL)), error)
    largest: Array = np.where(is_beyond, radius, size)
    error = error + 8.0 * EPSILON * largest
    return size, np.where(radius > 0.0, error, 0.0)


def _of_cones(stack: ConeStack, z: Array, w: Array, error: Array) -> tuple[Array, Array]:
    """Return the residuals of second-order cones, shape (B, k), and bounds of their rounding errors."""
    R, case, *_ = stack.residual(z, w)
    mu, d, size, within = stack.mu, stack.d, length(R), length(error)
    inside = 0.5 * (mu * z[..., 0] - length(z[..., 1:])) / (1.0 + mu)
    terms = np.where((case == WITHIN) & (size < inside), 0.0, length(z))
    terms += (1.0 + mu) * (length(w) + within) / d
    of_projection = 2.0 * (stack.pattern.sizes + 8.0) * EPSILON * (1.0 + mu) * terms
    is_open = (case == OUT) & ~z.any(-1)
    is_open &= w[..., 0] - error[..., 0] >= mu * (length(w[..., 1:]) + within)
    total = within / d + np.where(case == OUT, 0.0, of_projection)
    return size, np.where(is_open, 0.0, total)


@helper
def bound_contacts(starts, W, b, z, mu, d, labels, tolerance, w):  # type: ignore[no-untyped-def]
    """Return an upper bound of the relative residual of contacts that the criterion accepts, ∞ if in doubt; write w.

    The test implies the criterion at z, because

    - the rounding error of w is at least twice the criterion's own bound, and projections are nonexpansive, so that
      residuals by another order of summation stay within the limits here;
    - z_T and its projection cancel: 16 ε times the larger of z_T and μ z_N is twice the criterion's bound of this;
    - the largest residual of a component is at most half of the tolerance times `limit`, and `limit` is at most the
      reference: the residual at z = 0, and the terms of a contact that presses;
    - each violation is at most 2⁻⁴³ of its terms, half of what the componentwise test allows at any tolerance.
    """
    margin, most, limits = 4.0 * (b.size + 8) * EPSILON, np.zeros(mu.size), np.zeros(mu.size)
    reference = np.zeros(mu.size)  # of each component, at the number of its first block
    products, w[:] = np.abs(W) @ np.abs(z), W @ z + b
    terms = products + np.abs(b)
    doubt = np.where(products > 0.0, terms + NORMAL, 0.0)
    for c in range(mu.size):
        first, end = starts[c], starts[c + 1]
        at, push, size, is_row = z[first], w[first], terms[first], end - first == 1
        at_origin = (abs(b[first]) if is_row else -b[first]) / d[c]
        reference[labels[c]] = max(reference[labels[c]], at_origin)
        x, drift, radius = z[first + 1 : end], w[first + 1 : end], mu[c] * z[first]
        tangent, of_disk = np.linalg.norm(x), np.linalg.norm(terms[first + 1 : end])
        beyond = x - drift / d[c]
        edge = min(radius / max(np.linalg.norm(beyond), NORMAL), 1.0) * beyond
        is_edge = tangent >= (1.0 - AT_ROUNDING) * radius
        along = np.minimum((drift * x).sum(), 0.0) if is_edge else 0.0
        across = np.linalg.norm(drift - along / np.maximum(tangent * tangent, NORMAL) * x)
        presses = at > 0.0 or is_row
        is_right = (abs(push) if presses else -push) <= CERTAINLY_NEGLIGIBLE * size
        is_right &= across <= CERTAINLY_NEGLIGIBLE * of_disk or radius == 0.0
        if not (is_right and size + of_disk < np.inf and (at >= 0.0 or is_row)):
            return np.inf
        of_normal = abs(push / d[c] if is_row else min(push / d[c], at))
        residual = max(of_normal, np.linalg.norm(x - edge))
        residual += margin * np.linalg.norm(doubt[first:end]) / d[c]
        residual += 16.0 * EPSILON * max(radius, tangent)  # z_T and its projection cancel
        most[labels[c]] = max(most[labels[c]], residual)
        if presses:
            limits[labels[c]] = max(limits[labels[c]], size / d[c])
    bound = 0.0
    for c in range(mu.size):
        limit = min(reference[labels[c]], limits[labels[c]]) * (1.0 - margin)
        if not most[labels[c]] <= 0.5 * tolerance * limit:
            return np.inf
        if limit > 0.0:
            bound = max(bound, most[labels[c]] / limit)
    return bound
