"""Residuals of a point on ranks: the criterion of an LCP, and a bound of the error."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph

from ..core.checks import FloatVector
from ..core.kernels.floats import EPSILON, NEGLIGIBLE, TINY
from ..core.rounding import compensated_product, lower_end, upper_end
from ..systems.comparison_sums import comparison_product

if TYPE_CHECKING:
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
    backward_error : float
        The largest v_i / T_i.
    """

    z: FloatVector = field(repr=False)
    w: FloatVector = field(repr=False)
    scaled_residual: float
    relative_residual: float
    backward_error: float
    request_error: float = field(repr=False)  # the largest v_i relative to the tolerance of row i
    is_at_rounding_level: bool

    def is_solved(self, tolerance: float, absolute: float = 0.0) -> bool:
        """Return whether the point is SOLVED at a tolerance."""
        return (
            (self.relative_residual <= tolerance or self.scaled_residual <= absolute)
            and self.backward_error <= tolerance**0.75
            and self.request_error <= tolerance**0.25
        )


@np.errstate(all="ignore")
def measured(
    problem: RowsOnRanks, components: ComponentsOnRanks, z: FloatVector
) -> CertificateOnRanks:
    """Return the certificate of a point; one rule with a single process, `MATHS` of the manual's page on SOLVED."""
    halo, d, lower, upper = problem.halo, problem.residual_scale, problem.lower, problem.upper
    size, terms = abs(problem.rows), np.diff(problem.rows.indptr) + 3
    step = problem.slack(z) / d
    z = np.where(step >= z - lower, lower, np.where(-step >= upper - z, upper, z))
    w = problem.slack(z)
    T = size @ halo.whole(np.abs(z)) + np.abs(problem.q)
    rounding = terms * (EPSILON * T + TINY) / d
    r = np.abs(np.clip(w / d, z - upper, z - lower))
    violation = np.maximum(np.where(z > lower, w, 0.0), np.where(z < upper, -w, 0.0))
    acts = np.where((violation > 0.0) | ((z > lower) & (z < upper)), T, 0.0)

    origin = problem.nearest_to_zero
    w0, T0 = problem.slack(origin), size @ halo.whole(np.abs(origin)) + np.abs(problem.q)
    r0 = np.abs(np.clip(w0 / d, origin - upper, origin - lower))
    reference = components.largest(r0)
    reference = np.minimum(reference, components.largest(acts / d))
    high = r + np.where(r > 0.0, rounding, 0.0)
    if halo.largest(components.largest(high) / reference) > SHARP * halo.largest(
        components.largest(r) / reference
    ):  # rounding in double precision decides: it is summed in twice the precision
        q = np.pad(problem.q, (0, halo.foreign))
        value, radius = compensated_product(_square(problem), halo.whole(z), q)
        ends = (end(value, radius)[: problem.own] for end in (lower_end, upper_end))
        both = [np.abs(np.clip(end / d, z - upper, z - lower)) for end in ends]
        high = np.maximum(*both) * (1.0 + 4.0 * EPSILON)
    high = np.where(np.isfinite(z), high, np.nan)
    bound = components.largest(high)
    relative = np.where(bound == 0.0, 0.0, bound / reference)

    asked = np.where(np.abs(w0) > NEGLIGIBLE * T0, np.abs(w0), 0.0)
    of_neighbours = np.zeros(problem.own)
    if problem.rows.nnz:
        rows = np.repeat(np.arange(problem.own), np.diff(problem.rows.indptr))
        np.maximum.at(of_neighbours, rows, size.data * halo.whole(asked / d)[size.indices])
    asked = np.maximum(asked, of_neighbours)
    largest_z, largest_acting = components.largest(np.abs(z)), components.largest(acts)
    counts = (problem.q != 0.0) | (NEGLIGIBLE * np.minimum(d * largest_z, largest_acting) < T)
    counts &= violation > 0.0
    is_asked = counts & (asked > 0.0) & (violation > NEGLIGIBLE * T)
    largest = halo.largest
    return CertificateOnRanks(
        z,
        w,
        largest(high),
        largest(relative),
        largest(np.where(counts, violation / np.where(T > 0.0, T, 1.0), 0.0)),
        largest(np.where(is_asked, violation / np.where(asked > 0.0, asked, 1.0), 0.0)),
        halo.everywhere(r <= 4.0 * rounding),
    )


@np.errstate(all="ignore")
def error_bound(problem: RowsOnRanks, z: FloatVector) -> float:
    """Return a proved bound of ‖z − z*‖∞ for an H₊-matrix; ∞ if M is not proved to be one.

    z − r(z) solves the problem with q + (M − D) r in place of q, because mid(l, u, ·) sees the same w. With ⟨M⟩v > 0
    its distance from z* is at most v · max_i (|M − D| |r|)_i / (⟨M⟩v)_i.
    """
    halo, d = problem.halo, problem.diagonal
    if not halo.everywhere(d > 0.0):
        return np.inf
    terms = np.diff(problem.rows.indptr) + 4
    size = abs(problem.rows)
    T = size @ halo.whole(np.abs(z)) + np.abs(problem.q)
    r = np.abs(np.clip(problem.slack(z) / d, z - problem.upper, z - problem.lower))
    r = (r + terms * (EPSILON * T + TINY) / d) * (1.0 + 4.0 * EPSILON)
    change = (size @ halo.whole(r) - d * r + terms * EPSILON * (size @ halo.whole(r))) + TINY
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
    from .hierarchy import TruncationOnRanks, build_hierarchy
    from .krylov import Krylov

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
    solution = Krylov(TruncationOnRanks(hierarchy), residual, problem.is_symmetric)
    begun, steps = solution.largest(), 0
    for gain in GAINS:
        while solution.largest() > gain * begun and steps < MOST_STEPS and solution.step():
            steps += 1
        yield ones + solution.correction()
