"""Proof that no point of the cones has a slack in the dual cones (a Farkas certificate).

With friction, û ∈ K* means u_N ≥ 0 at every contact. Let y be ≥ 0 on normals and 0 on tangents (in K without
friction, free in free rows, ≥ 0 in nonnegative rows), with −Mᵀy in K* (0 in free rows) and qᵀy < 0. Then 0 ≤ yᵀw =
yᵀM z + yᵀq < 0 for every z in K, a contradiction. A z with the residual R has p = P_K(z − ŵ/d) in K, z = p + R and
ŵ − d R in K*,
and so

    −qᵀy ≤ Σ_k (√(1 + μ_k²) d_k ‖y_k‖ + ‖(Mᵀy)_k‖) ‖R_k‖:

no residual is smaller than the *margin*, −qᵀy divided by this sum, in the unit of z. With friction ‖R_k‖ is the larger
of both laws' residuals: u_N ≥ −d |R_N|, and (z_N, z_T − R_T) is in K. Signs are verified in exact arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, derived_property
from ...core.settings import Status
from .certificate import ConeRows
from .data import Blocks
from .programs import conic_rows, solve_conic
from .stack import ConeStack, length

DIGITS = 2.0**-20  # of the largest |y_i|: y is rounded to multiples, so that sums cancel exactly
MARGIN = 1e-3  # reduction of the margin, for the rounding error of its sums


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
    y: FloatVector

    def verify(self) -> bool:
        """Return whether y proves infeasibility, in exact arithmetic."""
        problem, M = self.problem, self.problem.rows.csr
        y = [Fraction(value) for value in self.y.tolist()]
        v = [Fraction(0)] * problem.n  # −Mᵀy
        for i in np.flatnonzero(self.y):
            for p in range(M.indptr[i], M.indptr[i + 1]):
                v[M.indices[p]] -= Fraction(float(M.data[p])) * y[i]
        for k, (a, b) in enumerate(pairwise(problem.starts.tolist())):
            if b - a == 1:
                is_free, is_half = kind_of_row(problem, a)
                is_right = v[a] == 0 and (is_free or y[a] == 0)
                is_right |= is_half and v[a] >= 0 and y[a] >= 0
            else:
                square = Fraction(float(problem.slope[k])) ** 2
                is_right = min(v[a], y[a]) >= 0
                is_right &= v[a] ** 2 >= square * sum(one**2 for one in v[a + 1 : b])
                most = 0 if problem.has_friction else square * y[a] ** 2
                is_right &= sum(one**2 for one in y[a + 1 : b]) <= most
            if not is_right:
                return False
        return self._value < 0

    @property
    def _value(self) -> Fraction:
        """The exact qᵀy."""
        pairs = zip(self.problem.q.tolist(), self.y.tolist(), strict=True)
        return sum((Fraction(q) * Fraction(y) for q, y in pairs if y), Fraction(0))

    @derived_property
    def margin(self) -> float:
        """Lower bound of the relative residual of every point, as the criterion measures it."""
        problem, stack = self.problem, ConeStack.of(self.problem)
        pulled, wide, rows = problem.rows.csr.T @ self.y, stack.pattern.wide, ConeRows(stack)
        of_y, of_pull = (length(wide(one[None]))[0] for one in (self.y, pulled))
        weights = np.sqrt(1.0 + problem.slope**2) * stack.d[0] * of_y + of_pull
        of_rows = np.broadcast_to(rows.reference, rows.q.shape).reshape(-1)
        references = np.maximum.reduceat(of_rows, problem.starts[:-1])
        shares = np.where(weights > 0.0, weights * references, 0.0)
        return float(-float(self._value) / shares.sum() * (1.0 - MARGIN))

    def excludes(self, tolerance: float, absolute_tolerance: float) -> bool:
        """Return whether the proof excludes SOLVED for every point."""
        return self.margin > tolerance and not absolute_tolerance

    def __str__(self) -> str:
        blocks = np.unique(self.problem.block_of_row[self.y != 0.0])
        named = ", ".join(map(str, blocks[:5])) + (
            "" if blocks.size <= 5 else f" and {blocks.size - 5} more"
        )
        return (
            f"blocks {named}: a sum of their slacks with weights of the dual cone is negative whatever z is, by "
            f"{self.margin:.1e} of the reference at the least"
        )


def kind_of_row(problem: Blocks, row: int) -> tuple[bool, bool]:
    """Return whether a row outside cones is free, and whether it is ≥ 0."""
    low, high = problem.lower[row], problem.upper[row]
    return bool(low == -np.inf and high == np.inf), bool(low == 0.0 and high == np.inf)


def infeasibility_proof(problem: Blocks) -> ContactInfeasibility | None:
    """Return a proof of infeasibility, or None if Clarabel finds no certificate that verifies."""
    import clarabel  # not for problems that have a solution

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
    for grain in (DIGITS, 2.0**-8, 0.25, None):
        rounded: Any = y if grain is None else np.round(y / (unit * grain))
        proof = ContactInfeasibility(problem, rounded)
        if rounded.any() and proof.verify():
            return proof
    return None
