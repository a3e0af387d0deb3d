"""A proof that no point of the cones has a slack in the dual cones.

With friction û ∈ K* says u_N ≥ 0 at every contact. So let y be ≥ 0 on normals and 0 on tangents (in K without friction,
free in free rows, ≥ 0 in nonnegative ones), −Mᵀy in K* (0 in free rows) and qᵀy < 0: then 0 ≤ yᵀw = yᵀM z + yᵀq < 0 for
every z in K, which is a contradiction. A z whose residual is R has p = P_K(z − ŵ/d) in K, z = p + R and ŵ − d R in K*,
and so

    −qᵀy ≤ Σ_k (√(1 + μ_k²) d_k ‖y_k‖ + ‖(Mᵀy)_k‖) ‖R_k‖:

no residual is smaller than the *margin*, −qᵀy over that sum, in the unit of z. Signs are verified in exact arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.settings import Status
from .data import Blocks
from .programs import ConvexProgram
from .stack import ConeStack, length

DIGITS = (
    2.0**-20
)  # of the largest |y_i|, to which y is rounded: sums that cancel do so exactly then
MARGIN = 1e-3  # what is taken off the margin for the rounding of the sums in it


@dataclass(frozen=True, eq=False)
class NoImpulse:
    """A y as above.

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
        """Return whether y proves it, in exact arithmetic."""
        problem, M = self.problem, self.problem.rows.csr
        y = [Fraction(value) for value in self.y.tolist()]
        v = [Fraction(0)] * problem.n  # −Mᵀy
        for i in np.flatnonzero(self.y):
            for p in range(M.indptr[i], M.indptr[i + 1]):
                v[M.indices[p]] -= Fraction(float(M.data[p])) * y[i]
        for k, (first, end) in enumerate(
            zip(problem.starts[:-1].tolist(), problem.starts[1:].tolist(), strict=True)
        ):
            if end - first == 1:
                is_free = problem.lower[first] == -np.inf and problem.upper[first] == np.inf
                is_half = problem.lower[first] == 0.0 and problem.upper[first] == np.inf
                if not (
                    v[first] == 0
                    if is_free
                    else (v[first] >= 0 and y[first] >= 0)
                    if is_half
                    else y[first] == 0 and v[first] == 0
                ):
                    return False
                continue
            mu = Fraction(float(problem.slope[k]))
            tangents = sum(one**2 for one in v[first + 1 : end])
            if v[first] < 0 or v[first] ** 2 < mu**2 * tangents or y[first] < 0:
                return False
            own = sum(one**2 for one in y[first + 1 : end])
            if own > (0 if problem.has_friction else mu**2 * y[first] ** 2):
                return False
        return sum(Fraction(q) * one for q, one in zip(problem.q.tolist(), y, strict=True)) < 0

    @property
    def margin(self) -> float:
        """What no residual beside the reference of its component is smaller than, as the criterion measures it."""
        problem, stack = self.problem, ConeStack.of(self.problem)
        wide = stack.pattern.wide
        total = sum(
            Fraction(q) * Fraction(y)
            for q, y in zip(problem.q.tolist(), self.y.tolist(), strict=True)
            if y
        )
        with np.errstate(all="ignore"):
            mu = np.where(problem.sizes > 1, problem.slope, 0.0)
            pulled = problem.rows.csr.T @ self.y
            of_y, of_pull = (length(wide(one[None]))[0] for one in (self.y, pulled))
            weights = np.sqrt(1.0 + mu**2) * stack.d[0] * of_y + of_pull
            shares = np.where(weights > 0.0, weights * stack.reference[0], 0.0)
            return float(-float(total) / shares.sum() * (1.0 - MARGIN))

    def excludes(self, tolerance: float, absolute_tolerance: float) -> bool:
        """Return whether no point at all could be called SOLVED."""
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


def infeasibility_proof(problem: Blocks) -> NoImpulse | None:
    """Return a proof that there is no answer, None where Clarabel finds none that verifies."""
    program = ConvexProgram(problem)
    n, M = problem.n, problem.rows.csr
    rows: list[Any] = [program.rows]
    limits, cones, places = [program.limits], list(program.cones), []
    identity = sp.eye_array(n, format="csr")
    for first, end in zip(problem.starts[:-1].tolist(), problem.starts[1:].tolist(), strict=True):
        is_half = problem.lower[first] == 0.0 and problem.upper[first] == np.inf
        is_free = problem.lower[first] == -np.inf and problem.upper[first] == np.inf
        own = (
            slice(first, first + 1)
            if end - first == 1 or problem.has_friction
            else slice(first, end)
        )
        if end - first == 1 and not (is_half or is_free):
            continue
        rows.append(-(identity[own] @ M))
        limits.append(problem.q[own])
        places.append(np.arange(own.start, own.stop))
        size = own.stop - own.start
        kind = program.clarabel.SecondOrderConeT if size > 1 else program.clarabel.NonnegativeConeT
        cones.append(program.clarabel.ZeroConeT(1) if end - first == 1 and is_free else kind(size))
    if not places:
        return None
    nothing = sp.csc_array((n, n))
    found = program.solve(nothing, np.zeros(n), sp.vstack(rows), np.concatenate(limits), cones)
    if "PrimalInfeasible" not in str(found.status):
        return None
    dual, where = np.asarray(found.z)[program.limits.size :], np.concatenate(places)
    y = np.zeros(n)
    y[where] = dual
    size = np.abs(y).max(initial=0.0)
    for grain in (DIGITS, 2.0**-8, 0.25):
        rounded = np.round(y / (size * grain)) if size > 0.0 else y
        proof = NoImpulse(problem, rounded)
        if rounded.any() and proof.verify():
            return proof
    proof = NoImpulse(problem, y)
    return proof if y.any() and proof.verify() else None
