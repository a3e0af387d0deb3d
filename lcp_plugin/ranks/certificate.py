"""Residuals of a point on ranks: the criterion of an LCP, and a bound of the error."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph

from ..core.certificates.criterion import RowData, RowsAtPoint
from ..core.checks import FloatVector
from ..core.kernels.floats import EPSILON, TINY
from ..core.matrix import largest_products
from ..core.rounding import compensated_product, lower_end
from ..systems.comparison_sums import comparison_product

if TYPE_CHECKING:
    from .halo import Halo
    from .problem import RowsOnRanks

SHARP = 1.5  # times the residual in double precision that rounding may add before it is enclosed sharply
GAINS = (1e-2, 1e-6)  # relative residuals of ⟨M⟩v = diag(M) after which v is tried
MOST_STEPS = 30  # v grows indefinitely if M is not an H₊-matrix


class ComponentsOnRanks:
    """The connected components of M's graph over all ranks."""

    def __init__(self, problem: RowsOnRanks) -> None:
        self.halo = halo = problem.halo
        own = problem.own
        count, local = csgraph.connected_components(_square(problem), directed=False)
        before, total = halo.places(count)
        names = local + before
        theirs = halo.whole(names[:own].astype(np.float64))[own:].astype(np.int64)
        pairs = halo.allgather_rows(np.unique(np.stack([names[own:], theirs], axis=1), axis=0))
        pattern = sp.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(total, total))
        self.count, joined = csgraph.connected_components(pattern, directed=False)
        self.labels = joined[names[:own]]
        # Several ranks share few components; only those are compared.
        self._shared = np.unique(joined[pairs[pairs[:, 0] != pairs[:, 1]].ravel()])

    def largest(self, values: FloatVector) -> FloatVector:
        """Return, per local row, the largest value ≥ 0 of its component's rows; a NaN stays."""
        found = np.zeros(self.count)
        np.maximum.at(found, self.labels, values)
        if self._shared.size:
            found[self._shared] = self.halo.all_largest(*found[self._shared].tolist())
        of_rows: FloatVector = found[self.labels]
        return of_rows


@dataclass(frozen=True, eq=False)
class CertificateOnRanks:
    """The residual of a point, measured on the problem's data; every number is the same on all ranks.

    Attributes
    ----------
    z, w : array, shape (own,)
        The point and its slack; unknowns closer to a bound than w_i/d_i are moved to it.
    scaled_residual : float
        ‖r(z)‖∞, rounding included.
    relative_residual : float
        The largest ‖r_P(z)‖∞ / ref_P of the components P.
    term_residual : float
        The least tolerance at which every row passes the componentwise test.
    is_solved : bool
        Whether the point is SOLVED at the tolerances of the run.
    """

    z: FloatVector = field(repr=False)
    w: FloatVector = field(repr=False)
    scaled_residual: float
    relative_residual: float
    term_residual: float
    is_at_rounding_level: bool
    is_solved: bool


class ProductOnRanks:
    """A matrix by which each rank multiplies the vectors of all ranks; it returns the local part."""

    def __init__(self, rows: sp.csr_array, halo: Halo) -> None:
        self.rows, self.halo, self.indptr = rows, halo, rows.indptr

    def __matmul__(self, x: FloatVector) -> FloatVector:
        product: FloatVector = self.rows @ self.halo.whole(x.astype(np.float64, copy=False))
        return product


class RowDataOnRanks(RowData):
    """M, q, bounds, d and components: the data of the criterion, of the local rows."""

    def __init__(self, problem: RowsOnRanks) -> None:
        M, size = (ProductOnRanks(one, problem.halo) for one in (problem.rows, abs(problem.rows)))
        d = problem.residual_scale
        super().__init__(M, size, problem.q, problem.lower, problem.upper, d)
        self.diagonal = problem.diagonal
        self.problem, self.components = problem, ComponentsOnRanks(problem)

    def anywhere(self, mask: Any) -> bool:
        """Return whether the mask is True in any row of any rank."""
        return self.problem.halo.anywhere(mask)

    def worst(self, values: FloatVector) -> float:
        """Return the largest of the values ≥ 0 of all ranks."""
        return self.problem.halo.largest(values)

    def largest(self, values: FloatVector) -> FloatVector:
        """Return the largest of the values ≥ 0 in the component of each row; a NaN stays."""
        return self.components.largest(values)

    def follow_chains(self, is_led: Any, is_small: Any, z: FloatVector) -> Any:
        """Return all small rows of a component with one in `is_led`: a chain over ranks is not followed."""
        return is_small & (self.largest(is_led.astype(np.float64)) > 0.0)

    def is_wrong(self, *_: Any) -> bool:
        """Return False, because no rank has all rows."""
        return False

    def carried_errors(self, d: FloatVector, v: FloatVector) -> FloatVector:
        """Return ∞, because no rank has all rows."""
        return np.full(v.shape, np.inf)

    def bound_residuals(self, z: FloatVector, at: RowsAtPoint, limit: Any) -> FloatVector:
        """Return an upper bound of every |r_i(z)|, by sums in twice the precision if rounding decides."""
        high = self.residual_ends(z, at.w, at.rounding)[1]
        r, worst = np.abs(self.residual(z, at.w)), self.worst
        if worst(self.largest(high) / limit) > SHARP * worst(self.largest(r) / limit):
            problem = self.problem
            ends = compensated_product(problem.rows, problem.halo.whole(z), problem.q)
            high = self.residual_ends(z, *ends)[1]
        return high

    def largest_products(self, x: FloatVector) -> FloatVector:
        """Return max_j |m_ij| x_j of each row, x ≥ 0."""
        return largest_products(self.absolute.rows, self.problem.halo.whole(x))


@np.errstate(all="ignore")
def measured(
    data: RowDataOnRanks, z: FloatVector, tolerance: float, absolute: float
) -> CertificateOnRanks:
    """Return the certificate of a point by the criterion of a single process."""
    found, halo = data.measure(z, tolerance, absolute=absolute), data.problem.halo
    at = found.rows
    floor = 4.0 * data.rounding_floor(at.terms)
    return CertificateOnRanks(
        found.z,
        at.w,
        halo.largest(data.residual_ends(found.z, at.w, at.rounding)[1]),
        found.residual,
        found.terms,
        halo.everywhere(np.abs(data.residual(found.z, at.w)) <= floor),
        bool(found.passes),
    )


@np.errstate(all="ignore")
def error_bound(data: RowDataOnRanks, z: FloatVector) -> float:
    """Return a proved bound of ‖z − z*‖∞ for an H₊-matrix; ∞ if M is not proved to be one.

    z − r(z) solves the problem with q + (M − D) r in place of q, because mid(l, u, ·) sees the same w. With ⟨M⟩v > 0
    its distance from z* is at most v · max_i (|M − D| |r|)_i / (⟨M⟩v)_i.
    """
    problem, d = data.problem, data.problem.diagonal
    halo = problem.halo
    if not halo.everywhere(d > 0.0):
        return np.inf
    at = data.rows(z)
    r = data.residual_ends(z, at.w, at.rounding, d)[1]
    moved = data.absolute @ r
    change = moved - d * r + (np.diff(problem.rows.indptr) + 4) * EPSILON * moved + TINY
    bound = np.inf
    for v in _weights(problem):
        margin = lower_end(*comparison_product(_square(problem), halo.whole(v)))[: problem.own]
        if halo.everywhere((v > 0.0) & (margin > 0.0)):
            share = halo.largest(change / margin)
            bound = min(bound, halo.largest((r + v * share) * (1.0 + 8.0 * EPSILON)))
    return bound


def _square(problem: RowsOnRanks) -> Any:
    """Return the local rows followed by empty rows for the ghosts."""
    rows, width = problem.rows, problem.rows.shape[1]
    indptr = np.pad(rows.indptr, (0, width - problem.own), "edge")
    return sp.csr_array((rows.data, rows.indices, indptr), shape=(width, width))


def _weights(problem: RowsOnRanks) -> Any:
    """Yield vectors v that may have ⟨M⟩v > 0: ones, then approximate solutions of ⟨M⟩v = diag(M)."""
    from ..systems.hierarchy.truncation import KrylovCorrection
    from .hierarchy import TruncationOnRanks, build_hierarchy

    ones = np.ones(problem.own)
    yield ones
    comparison = sp.csr_array(
        (-np.abs(problem.rows.data), problem.rows.indices, problem.rows.indptr),
        shape=problem.rows.shape,
    )
    rows = np.repeat(np.arange(problem.own), np.diff(comparison.indptr))
    is_diagonal = comparison.indices == rows
    comparison.data[is_diagonal] *= -1.0
    hierarchy = build_hierarchy(comparison, problem.halo, scales_rows=not problem.is_symmetric)
    residual = problem.diagonal - comparison @ np.ones(comparison.shape[1])
    solution = KrylovCorrection(TruncationOnRanks(hierarchy), residual, problem.is_symmetric)
    begun, steps = solution.largest(), 0
    for gain in GAINS:
        while solution.largest() > gain * begun and steps < MOST_STEPS and solution.step():
            steps += 1
        solution.apply_to(ones, v := np.empty(problem.own))
        yield v
