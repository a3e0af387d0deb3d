"""Certificates over cones: the residuals of a point, and proofs that no point is a solution.

A proof is a Farkas certificate: no point of the cones has a slack in the dual cones. K is the product of the cones, K*
its dual. The slack ŵ of a cone is w, and û = w + μ‖w_T‖ e_N for a contact with friction (:mod:`.data`). With friction,
û ∈ K* means u_N ≥ 0 at every contact. Let y be ≥ 0 on normals and 0 on tangents (in K without friction, free in free
rows, ≥ 0 in nonnegative rows), with −Mᵀy in K* (0 in free rows) and qᵀy < 0. Then 0 ≤ yᵀw = yᵀM z + yᵀq < 0 for every z
in K, a contradiction. A z with the residual R has p = P_K(z − ŵ/d) in K, z = p + R and ŵ − d R in K*, and so

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

from ...core.checks import Array, Vector, derived_property, read_only
from ...core.cone_stack import length
from ...core.names import Names, describe_radius, listed
from ...core.settings import Status
from ...core.structure import is_nearly_symmetric
from ...judges.certificate import describe_measures
from ...judges.cones import ConeRows
from ...judges.lcp import Measured, divide_nonnegative
from ...judges.worst_rows import WorstRows, worst_pairs
from ...proofs.farkas import FarkasCertificate, LinearConstraints
from ...proofs.no_solution import is_minimizer_beyond_radius
from ...systems.equilibration import power_of_two
from .data import Blocks, conic_rows, solve_conic
from .factors import cone_stack_of


def criterion_at(problem: Blocks, x: Vector) -> tuple[ConeRows, Vector, None, Names]:
    """Return the data of the criterion, with x in their shape, no slack, and the names."""
    rows = ConeRows(cone_stack_of(problem))
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
        self, problem: Blocks, z: Vector, tolerance: float, measured: Measured | None = None
    ) -> None:
        self.problem, self.z, self.tolerance = problem, z, tolerance
        if measured is not None:
            self.measured = measured

    @derived_property
    def criterion(self) -> ConeRows:
        """The data of the criterion."""
        return ConeRows(cone_stack_of(self.problem))

    @derived_property
    def measured(self) -> Measured:
        """The measure of z."""
        z = self.z if self.criterion.stack.pattern.is_sparse else self.z[None]
        return self.criterion.measure_at(z, None, self.tolerance)

    @derived_property
    def w(self) -> Vector:
        """M z + q."""
        return read_only(self.measured.rows.w.ravel().copy())

    @derived_property
    def relative_residual(self) -> float:
        """The largest residual of a law relative to the reference of its component."""
        relative = divide_nonnegative(self.measured.by_row.high, self.measured.by_row.reference)
        return float(relative.max(initial=0.0))

    @property
    def term_residual(self) -> float:
        """The least tolerance at which every law passes the componentwise test."""
        return float(self.measured.by_row.componentwise.max(initial=0.0))

    @property
    def worst_index(self) -> int:
        """The block of the largest relative residual; −1 without blocks."""
        relative = self.criterion.of_blocks(self.measured.by_row.relative)[0]
        return int(np.argmax(relative)) if relative.size else -1

    @property
    def scaled_residual(self) -> float:
        """The residual of that block, in the unit of z."""
        if not self.z.size:
            return 0.0
        return float(self.criterion.of_blocks(self.measured.by_row.high)[0, self.worst_index])

    def worst(self, tolerance: float, count: int) -> WorstRows:
        """Return the rows that fail by most."""
        measured = self.measured._replace(z=self.z)
        return worst_pairs(self.criterion, measured, self.problem.rows.names, tolerance, count)

    @derived_property
    def natural_residual(self) -> float:
        """The largest ‖z_k − P_K(z_k − ŵ_k)‖, unscaled."""
        plain = copy(self.criterion.stack)
        plain.d = np.ones_like(plain.d)
        z, w = (plain.pattern.wide(vector[None]) for vector in (self.z, self.w))
        return float(length(plain.residual(z, w)[0]).max(initial=0.0))

    @derived_property
    def lost_energy(self) -> float:
        """−rᵀ(b + u)/2, the kinetic energy that impact and friction take: impulses r change velocities b to u."""
        return float(-0.5 * (self.z @ (self.problem.q + self.w)))

    def __str__(self) -> str:
        names = "relative_residual", "natural_residual", "term_residual"
        return f"{describe_measures(self, *names)}\n{'z · w':<18} {float(self.z @ self.w):.3e}"


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
    def _farkas(self) -> FarkasCertificate:
        """The certificate of w ≥ 0 for any z, without cones."""
        rows, all_rows = self.problem.rows, np.ones(self.problem.n, np.bool_)
        ones = all_rows.astype(np.float64)
        signs, bounds, errors = (all_rows, all_rows), (-np.inf * ones, np.inf * ones), 0.0 * ones
        constraints = LinearConstraints(rows.csr, rows.q, *signs, *bounds, ones, (errors, errors))
        y = {int(i): Fraction(float(self.y[i])) for i in np.flatnonzero(self.y)}
        return FarkasCertificate(constraints, y)

    def _is_in_cones(self, x: Array, *, is_dual: bool) -> bool:
        """Return whether x, in exact numbers, is in the cones: of the y that are allowed, or of the −Mᵀy."""
        problem = self.problem
        for k, (a, b) in enumerate(pairwise(problem.starts.tolist())):
            if b - a == 1:
                is_free, is_half = kind_of_row(problem, a)
                fits = x[a] == 0 or (is_free and is_dual) or (is_half and x[a] > 0)
            else:
                square, tangent = Fraction(float(problem.slope[k])) ** 2, x[a + 1 : b]
                size = sum(entry**2 for entry in tangent)
                of_y = size <= (0 if problem.has_friction else square * x[a] ** 2)
                fits = x[a] >= 0 and (of_y if is_dual else x[a] ** 2 >= square * size)
            if not fits:
                return False
        return True

    @derived_property
    def is_exact(self) -> bool:
        """True if −Mᵀy is in the dual cones, so that the proof covers all z."""
        pull = self._farkas.product
        return self._is_in_cones([-pull.get(j, 0) for j in range(self.problem.n)], is_dual=False)

    @property
    def radius(self) -> float:
        """Bound of the |z_j| that the proof covers."""
        return np.inf if self.is_exact else self._farkas.radius

    def verify(self) -> bool:
        """Return whether y proves infeasibility for the z within the radius, in exact arithmetic."""
        farkas, rows = self._farkas, self.problem.rows
        y = [Fraction(value) for value in self.y.tolist()]
        if not (farkas.plain > 0 and self._is_in_cones(y, is_dual=True)):
            return False
        if self.is_exact or not (farkas.is_rounding() and farkas.is_wide()):
            return self.is_exact
        if not is_nearly_symmetric(rows.matrix):
            return True
        return is_minimizer_beyond_radius(rows.matrix.array, rows.q, self.y, farkas.left)

    @derived_property
    def margin(self) -> float:
        """Lower bound of the relative residual of every point, as the criterion measures it."""
        problem, stack = self.problem, cone_stack_of(self.problem)
        pulled, wide, rows = problem.rows.csr.T @ self.y, stack.pattern.wide, ConeRows(stack)
        of_y, of_pull = (length(wide(vector[None]))[0] for vector in (self.y, pulled))
        weights = np.sqrt(1.0 + problem.slope**2) * stack.d[0] * of_y + of_pull
        references = rows.of_blocks(np.broadcast_to(rows.references[0], rows.q.shape))[0]
        shares = np.where(weights > 0.0, weights * references, 0.0)
        value = self._farkas.plain if self.is_exact else self._farkas.size
        # Less, for the rounding error of the sums
        return float(float(value) / shares.sum() * (1.0 - 1e-3))

    def excludes(self, tolerance: float, absolute_tolerance: float) -> bool:
        """Return whether the proof excludes SOLVED for every point."""
        return self.margin > tolerance and not absolute_tolerance

    def __str__(self) -> str:
        blocks = np.unique(self.problem.block_of_row[self.y != 0.0])
        names = listed(map(str, blocks), 5)
        points = describe_radius(self.radius, "z") or "all z"
        by = f"{self.margin:.1e} of the reference at the least"
        return f"blocks {names}: a sum of their slacks is negative for {points}, by {by}"


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
    # Clarabel's tolerances are absolute; a certificate does not depend on the unit of W and q, nor on the unit of z
    M, q = problem.rows.csr[where], problem.q[where]
    scale, size = power_of_two(np.abs(M.data).max(initial=0.0)), power_of_two(np.abs(q).max())
    all_rows = sp.vstack([rows, -M / scale])
    all_limits = np.concatenate([limits * (scale / size), q / size])
    solution = solve_conic(sp.csc_array((n, n)), np.zeros(n), all_rows, all_limits, cones)
    if "PrimalInfeasible" not in str(solution.status):
        return None
    y = np.zeros(n)
    y[where] = np.asarray(solution.z)[limits.size :]
    unit = np.abs(y).max(initial=0.0) or 1.0
    rounded: list[Any] = [np.round(y / (unit * grain)) for grain in (DIGITS, 2.0**-8, 0.25)]
    for multipliers in [*rounded, y, without_pull(problem, y / unit)]:
        proof = ContactInfeasibility(problem, multipliers)
        if multipliers.any() and proof.verify():
            return proof
    return None


def without_pull(problem: Blocks, y: Vector) -> Vector:
    """Return a vector near y with Mᵀy = 0 to rounding, without the entries of y at rounding level."""
    used = np.flatnonzero(np.abs(y) > 1e-6)  # Clarabel's points reach 0 to about 1e-8
    # A least squares problem of a second
    columns = problem.rows.csr[used].toarray().T if used.size <= 1000 else np.zeros((0, 0))
    x, sparse_y = y[used], np.zeros(problem.n)
    for _ in range(3 if columns.size else 0):
        x = x - np.linalg.lstsq(columns, columns @ x, rcond=DIGITS)[0]
    sparse_y[used] = x
    return sparse_y
