"""Stopping criterion over cones: the criterion of an LCP (:mod:`lcp_plugin.core.certificates.criterion`), by rows.

A row between bounds is a row of an LCP. Contact with friction consists of two laws with residuals and terms of their
own: Signorini's condition z_N ≥ 0 ⟂ w_N ≥ 0, a row of an LCP, and Coulomb's law of the tangential rows, with the disk
‖z_T‖ ≤ μ z_N. So a large sliding velocity does not hide a small closing velocity. A second-order cone is one law.

For a law with several rows, norms over these rows replace absolute values. Its residual is the natural map's,
R = z − P(z − w/d), P the projection onto the disk or cone, d > 0 the unit of the block's slack, from the diagonal of M;
its violation is v = d ‖R‖, also of a z outside its cone. The point is snapped first: rows to bounds as in an
LCP, z_k to the apex if the projection of z_k − w_k/d_k is the apex, and z_T to the length μ z_N if the projection is
on the boundary. The snapped point is measured and returned.

For contacts the demand a is the largest of the component: b at a contact of a pile may be rounding error.
Projections are nonexpansive: if w is within ρ, the residual of a cone is within ‖ρ‖/d, plus rounding in P.

Proof that no point of the cones has a slack in the dual cones (a Farkas certificate).

K is the product of the cones, K* its dual. The slack ŵ of a cone is w, and û = w + μ‖w_T‖ e_N for a contact with
friction (:mod:`.data`). With friction, û ∈ K* means u_N ≥ 0 at every contact. Let y be ≥ 0 on normals and 0 on
tangents (in K without friction, free in free rows, ≥ 0 in nonnegative rows), with −Mᵀy in K* (0 in free rows) and
qᵀy < 0. Then 0 ≤ yᵀw = yᵀM z + yᵀq < 0 for every z in K, a contradiction. A z with the residual R has
p = P_K(z − ŵ/d) in K, z = p + R and ŵ − d R in K*, and so

    −qᵀy ≤ Σ_k (√(1 + μ_k²) d_k ‖y_k‖ + ‖(Mᵀy)_k‖) ‖R_k‖:

no residual is smaller than the *margin*, −qᵀy divided by this sum, in the unit of z. With friction ‖R_k‖ is the larger
of both laws' residuals: u_N ≥ −d |R_N|, and (z_N, z_T − R_T) is in K. Signs are verified in exact arithmetic.

If M = J Jᵀ with more rows than columns is stored in floating point, −Mᵀy is at rounding level where it should be 0. As
for an LCP (:class:`lcp_plugin.proofs.no_solution.Infeasibility`), the proof then covers the z up to a radius.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.certificates.criterion import (
    Measured,
    RowData,
    RowsAtPoint,
    VectorEnds,
    divide_nonnegative,
)
from ...core.certificates.residuals import WorstRows, worst_pairs
from ...core.checks import Vector, derived_property, read_only
from ...core.kernels.floats import EPSILON, NEGLIGIBLE, NORMAL
from ...core.matrix import is_nearly_symmetric
from ...core.names import Names, describe_radius
from ...core.settings import Status
from ...proofs.farkas import FarkasCertificate, LinearConstraints
from ...proofs.no_solution import is_minimizer_beyond_radius
from .data import Blocks, conic_rows, solve_conic
from .stack import ON, OUT, WITHIN, Array, ConeStack, length

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
        self.start = np.broadcast_to(self.start, self.q.shape)

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
        found = self.measure(self.flat(z), tolerance, absolute=absolute)
        shape = (self.stack.B,)
        numbers = found.residual, found.passes, found.is_limited
        residual, passes, is_limited = (np.broadcast_to(one, shape) for one in numbers)
        return Measured(self.wide(found.z), residual, passes, is_limited, *found[4:])

    def of_blocks(self, values: Array) -> Array:
        """Return the largest of the values by rows in each block, shape (B, k)."""
        starts = self.stack.pattern.starts[:-1]
        return np.maximum.reduceat(values[None] if values.ndim == 1 else values, starts, -1)

    @derived_property
    def demand(self) -> Vector:
        """Demand of each law; of contacts the largest of the component, because b may be rounding error in a pile."""
        demand: Vector = super().demand
        return self.largest(demand) if self.stack.has_friction else self.norm(demand)

    def rows(self, z: Vector, w: Any = None) -> RowsAtPoint:
        """Return the values of all laws at z, with its slack w if that is known."""
        at = super().rows(z, w)
        if not self.has_cones:
            return at
        stack, x, terms = self.stack, self.wide(z), self.norm(at.terms)
        violation = self._with_laws(at.violation, stack.d * self._sizes_of_laws(x, self.wide(at.w)))
        is_free = x.any(-1)
        if stack.has_friction:
            is_free = length(x[..., 1:]) < stack.mu * x[..., 0]
        is_active = self._with_laws(at.is_active, is_free) | (violation > NEGLIGIBLE * terms)
        return at._replace(terms=terms, violation=violation, is_active=is_active)

    def _sizes_of_laws(self, x: Array, w: Array) -> Array:
        """Return the residuals of cones and disks as computed, shape (B, k)."""
        stack = self.stack
        if not stack.has_friction:
            return length(stack.residual(x, w)[0])
        d = stack.d[..., None]
        return _of_coulomb(stack.mu * x[..., 0], x[..., 1:], w[..., 1:] / d, 0.0 * stack.d)[0]

    def residual_ends(
        self, z: Vector, w: Vector, rounding: Any = None, scale: Any = None
    ) -> VectorEnds:
        """Return bounds of the residual of each law for slacks within w ± rounding."""
        low, high = super().residual_ends(z, w, rounding, scale)
        if not self.has_cones:
            return low, high
        rounding = np.zeros(w.shape) if rounding is None else rounding
        stack, (x, g, error) = self.stack, map(self.wide, (z, w, rounding))
        if stack.has_friction:
            d = stack.d[..., None]
            steps = x[..., 1:], g[..., 1:] / d, length(error[..., 1:] / d)
            size, error = _of_coulomb(stack.mu * x[..., 0], *steps)
        else:
            size, error = _of_cones(stack, x, g, error)
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


def _of_coulomb(radius: Array, z: Array, step: Array, error: Array) -> tuple[Array, Array]:
    """Return the residuals ‖z_T − P(z_T − step)‖ of Coulomb's law, shape (B, k), and bounds of their errors.

    The step is within `error`. Beyond the disk P divides errors by the distance from the axis.
    """
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


def bound_residuals(stack: ConeStack, z: Array, tolerance: float) -> Array:
    """Return upper bounds of the relative residuals of contacts that the criterion accepts, (B,); ∞ if in doubt.

    The test implies the criterion at z, of shape (B, k, m) with dense M, because

    - the rounding error of w is at least twice the criterion's own bound, and projections are nonexpansive, so that
      residuals by another order of summation stay within the limits here;
    - z_T and its projection cancel: 16 ε times the larger of z_T and μ z_N is twice the criterion's bound of this;
    - the largest residual of a component is at most half of the tolerance times `limit`, and `limit` is at most the
      reference: the residual at z = 0, and the terms of a contact that presses;
    - each violation is at most 2⁻⁴³ of its terms, half of what the componentwise test allows at any tolerance.
    """
    if not stack.has_friction or stack.pattern.is_sparse:
        return np.full(stack.B, np.inf)
    w, products = stack.slack(z), stack.pattern.times(z, absolute=True)
    terms, margin = products + np.abs(stack.q), 4.0 * (stack.pattern.n + 8) * EPSILON
    d, at, tangents, push, drift = stack.d, z[..., 0], z[..., 1:], w[..., 0], w[..., 1:]
    size, is_row, radius, tangent = (
        terms[..., 0],
        stack.pattern.is_row,
        stack.mu * at,
        length(tangents),
    )
    presses = (at > 0.0) | is_row
    beyond, along = tangents - drift / d[..., None], (drift * tangents).sum(-1)
    edge = np.minimum(radius / np.maximum(length(beyond), NORMAL), 1.0)[..., None] * beyond
    along = np.where(tangent >= (1.0 - AT_ROUNDING) * radius, np.minimum(along, 0.0), 0.0)
    across = drift - (along / np.maximum(tangent * tangent, NORMAL))[..., None] * tangents
    of_disk = length(terms[..., 1:])
    is_right = np.where(presses, np.abs(push), -push) <= CERTAINLY_NEGLIGIBLE * size
    is_right &= (length(across) <= CERTAINLY_NEGLIGIBLE * of_disk) | (radius == 0.0)
    is_right &= (size + of_disk < np.inf) & ((at >= 0.0) | is_row)
    rounding = margin * length(np.where(products > 0.0, terms + NORMAL, 0.0)) / d
    normal = np.abs(np.where(is_row, push / d, np.minimum(push / d, at)))
    residual = np.maximum(normal, length(tangents - edge))
    rounding += 16.0 * EPSILON * np.maximum(radius, tangent)  # z_T and its projection cancel
    residual = stack.pattern.largest(residual + rounding)
    limit = np.minimum(stack.reference, stack.pattern.largest(presses * size / d)) * (1.0 - margin)
    is_right &= residual <= 0.5 * tolerance * limit
    bound = np.where(limit > 0.0, residual / limit, 0.0).max(1, initial=0.0)
    return np.where(is_right.all(1), bound, np.inf)


def criterion_at(problem: Blocks, x: Vector) -> tuple[ConeRows, Vector, None, Names]:
    """Return the data of the criterion, with x in their shape, no slack, and the names."""
    rows = ConeRows(ConeStack.of(problem))
    return rows, x if rows.stack.pattern.is_sparse else x[None], None, problem.rows.names


class ConeCertificate:
    """Residuals of a point for a problem over cones.

    Attributes
    ----------
    problem : Blocks
        The problem.
    z, w : ndarray, shape (n,)
        The point, and M z + q.
    tolerance : float
        Tolerance at which z is measured.
    relative_residual : float
        The largest residual of a law relative to the reference of its component, rounded upwards.
    term_residual : float
        The least tolerance at which every law passes the componentwise test.
    worst_index : int
        The block of the largest relative residual; −1 without blocks.
    """

    def __init__(
        self, problem: Blocks, z: Vector, tolerance: float, found: Measured | None = None
    ) -> None:
        self.problem, self.z, self.tolerance = problem, z, tolerance
        if found is not None:
            vars(self)["found"] = found

    @derived_property
    def criterion(self) -> ConeRows:
        """The data of the criterion."""
        return ConeRows(ConeStack.of(self.problem))

    @derived_property
    def found(self) -> Measured:
        """The measure of z."""
        pattern = self.criterion.stack.pattern
        return self.criterion.measure_at(
            self.z if pattern.is_sparse else self.z[None], None, self.tolerance
        )

    @derived_property
    def w(self) -> Vector:
        """M z + q."""
        return read_only(self.found.rows.w.ravel().copy())

    @derived_property
    def relative_residual(self) -> float:
        """The largest residual of a law relative to the reference of its component."""
        relative = divide_nonnegative(self.found.by_row.high, self.found.by_row.reference)
        return float(relative.max(initial=0.0))

    @property
    def term_residual(self) -> float:
        """The least tolerance at which every law passes the componentwise test."""
        return float(self.found.by_row.terms.max(initial=0.0))

    @property
    def worst_index(self) -> int:
        """The block of the largest relative residual; −1 without blocks."""
        relative = self.criterion.of_blocks(self.found.by_row.relative)[0]
        return int(np.argmax(relative)) if relative.size else -1

    @property
    def scaled_residual(self) -> float:
        """The residual of that block, in the unit of z."""
        if not self.z.size:
            return 0.0
        return float(self.criterion.of_blocks(self.found.by_row.high)[0, self.worst_index])

    def worst(self, tolerance: float, count: int) -> WorstRows:
        """Return the rows that fail by most."""
        found = self.found._replace(z=self.z)
        return worst_pairs(self.criterion, found, self.problem.rows.names, tolerance, count)

    @derived_property
    def natural_residual(self) -> float:
        """The largest ‖z_k − P_K(z_k − ŵ_k)‖, unscaled."""
        plain = copy(self.criterion.stack)
        plain.d = np.ones_like(plain.d)
        z, w = (plain.pattern.wide(one[None]) for one in (self.z, self.w))
        return float(length(plain.residual(z, w)[0]).max(initial=0.0))

    @derived_property
    def lost_energy(self) -> float:
        """−rᵀ(b + u)/2, the kinetic energy that impact and friction take: impulses r change velocities b to u."""
        return float(-0.5 * (self.z @ (self.problem.q + self.w)))

    def __str__(self) -> str:
        names = "relative_residual", "natural_residual", "term_residual"
        lines = [(name.replace("_", " "), getattr(self, name)) for name in names]
        lines.append(("z · w", float(self.z @ self.w)))
        return "\n".join(f"{name:<18} {value:.3e}" for name, value in lines)


DIGITS = 2.0**-20  # of the largest |y_i|: y is rounded to multiples, so that sums cancel exactly


@dataclass(frozen=True, eq=False)
class ContactInfeasibility:
    """Certificate of infeasibility y, as defined above.

    Attributes
    ----------
    problem : Blocks
    y : ndarray, shape (n,)
    """

    status: ClassVar[Status] = Status.INFEASIBLE
    is_rounding: ClassVar[bool] = False

    problem: Blocks
    y: Vector

    @derived_property
    def _found(self) -> FarkasCertificate:
        """The certificate of w ≥ 0 for any z, without cones."""
        problem, (no, all_) = self.problem, (np.zeros(self.problem.n), np.ones(self.problem.n))
        bounds = -np.inf * all_, np.inf * all_
        rows, all_true = problem.rows, all_ > 0
        anything = LinearConstraints(rows.csr, rows.q, all_true, all_true, *bounds, all_, (no, no))
        y = {int(i): Fraction(float(self.y[i])) for i in np.flatnonzero(self.y)}
        return FarkasCertificate(anything, y)

    def _is_in_cones(self, x: Any, *, is_dual: bool) -> bool:
        """Return whether x, in exact numbers, is in the cones: of the y that are allowed, or of the −Mᵀy."""
        problem = self.problem
        for k, (a, b) in enumerate(pairwise(problem.starts.tolist())):
            if b - a == 1:
                is_free, is_half = kind_of_row(problem, a)
                fits = x[a] == 0 or (is_free and is_dual) or (is_half and x[a] > 0)
            else:
                square, tangent = Fraction(float(problem.slope[k])) ** 2, x[a + 1 : b]
                size = sum(one**2 for one in tangent)
                of_y = size <= (0 if problem.has_friction else square * x[a] ** 2)
                fits = x[a] >= 0 and (of_y if is_dual else x[a] ** 2 >= square * size)
            if not fits:
                return False
        return True

    @derived_property
    def is_exact(self) -> bool:
        """True if −Mᵀy is in the dual cones, so that the proof covers all z."""
        pull = self._found.product
        return self._is_in_cones([-pull.get(j, 0) for j in range(self.problem.n)], is_dual=False)

    @property
    def radius(self) -> float:
        """Bound of the |z_j| that the proof covers."""
        return np.inf if self.is_exact else self._found.radius

    def verify(self) -> bool:
        """Return whether y proves infeasibility for the z within the radius, in exact arithmetic."""
        found, rows = self._found, self.problem.rows
        y = [Fraction(value) for value in self.y.tolist()]
        if not (found.plain > 0 and self._is_in_cones(y, is_dual=True)):
            return False
        if self.is_exact or not (found.is_rounding() and found.is_wide_beside_terms()):
            return self.is_exact
        if not is_nearly_symmetric(rows.matrix):
            return True
        return is_minimizer_beyond_radius(rows.matrix.array, rows.q, self.y, found.left)

    @derived_property
    def margin(self) -> float:
        """Lower bound of the relative residual of every point, as the criterion measures it."""
        problem, stack = self.problem, ConeStack.of(self.problem)
        pulled, wide, rows = problem.rows.csr.T @ self.y, stack.pattern.wide, ConeRows(stack)
        of_y, of_pull = (length(wide(one[None]))[0] for one in (self.y, pulled))
        weights = np.sqrt(1.0 + problem.slope**2) * stack.d[0] * of_y + of_pull
        of_rows = np.broadcast_to(rows.references[0], rows.q.shape).reshape(-1)
        references = np.maximum.reduceat(of_rows, problem.starts[:-1])
        shares = np.where(weights > 0.0, weights * references, 0.0)
        value = self._found.plain if self.is_exact else self._found.size
        # Less, for the rounding error of the sums
        return float(float(value) / shares.sum() * (1.0 - 1e-3))

    def excludes(self, tolerance: float, absolute_tolerance: float) -> bool:
        """Return whether the proof excludes SOLVED for every point."""
        return self.margin > tolerance and not absolute_tolerance

    def __str__(self) -> str:
        blocks = np.unique(self.problem.block_of_row[self.y != 0.0])
        rest = f" and {blocks.size - 5} more" if blocks.size > 5 else ""
        named = ", ".join(map(str, blocks[:5])) + rest
        points = describe_radius(self.radius, "z") or "all z"
        by = f"{self.margin:.1e} of the reference at the least"
        return f"blocks {named}: a sum of their slacks is negative for {points}, by {by}"


def kind_of_row(problem: Blocks, row: int) -> tuple[bool, bool]:
    """Return whether a row outside cones is free, and whether it is ≥ 0."""
    low, high = problem.lower[row], problem.upper[row]
    return bool(low == -np.inf and high == np.inf), bool(low == 0.0 and high == np.inf)


def infeasibility_proof(problem: Blocks) -> ContactInfeasibility | None:
    """Return a proof of infeasibility, or None if Clarabel finds no certificate that verifies."""
    try:
        import clarabel  # not for problems that have a solution
    except ImportError:
        return None

    n = problem.n
    rows, limits, cones = conic_rows(problem)
    places = [np.zeros(0, np.int64)]
    for a, b in pairwise(problem.starts.tolist()):
        size = 1 if problem.has_friction else b - a
        is_free, is_half = kind_of_row(problem, a) if b - a == 1 else (False, False)
        if b - a > 1 or is_free or is_half:
            cone = clarabel.NonnegativeConeT if size == 1 else clarabel.SecondOrderConeT
            cones.append((clarabel.ZeroConeT if is_free else cone)(size))
            places.append(np.arange(a, a + size))
    where = np.concatenate(places)
    if not where.size:
        return None
    all_rows = sp.vstack([rows, -problem.rows.csr[where]])
    all_limits = np.concatenate([limits, problem.q[where]])
    found = solve_conic(sp.csc_array((n, n)), np.zeros(n), all_rows, all_limits, cones)
    if "PrimalInfeasible" not in str(found.status):
        return None
    y = np.zeros(n)
    y[where] = np.asarray(found.z)[limits.size :]
    unit = np.abs(y).max(initial=0.0) or 1.0
    rounded: list[Any] = [np.round(y / (unit * grain)) for grain in (DIGITS, 2.0**-8, 0.25)]
    for one in [*rounded, y, without_pull(problem, y / unit)]:
        proof = ContactInfeasibility(problem, one)
        if one.any() and proof.verify():
            return proof
    return None


def without_pull(problem: Blocks, y: Vector) -> Vector:
    """Return y near a given one with Mᵀy = 0 to rounding, without its entries at rounding level."""
    used = np.flatnonzero(np.abs(y) > 1e-6)  # Clarabel's points reach 0 to about 1e-8
    # A least squares problem of a second
    columns = problem.rows.csr[used].toarray().T if used.size <= 1000 else np.zeros((0, 0))
    x, found = y[used], np.zeros(problem.n)
    for _ in range(3 if columns.size else 0):
        x = x - np.linalg.lstsq(columns, columns @ x, rcond=DIGITS)[0]
    found[used] = x
    return found
