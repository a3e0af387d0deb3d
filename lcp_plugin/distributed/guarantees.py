"""What is proved about a matrix whose rows lie on several ranks, and what that says about an error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ..certificates.error_bounds import ErrorBound
from ..certificates.row_inequality import BoolVector, RowInequality
from ..checks import FloatVector
from ..errors import UnsuitableMatrix
from ..exact.rounding import comparison_product, lower_end
from ..exact.upward import product_above, quotient_above, sum_above
from ..peers.ranks.collective import largest, total
from ..peers.ranks.rows import Rows
from .problem import DistributedLCP

SOLVE_TOLERANCES = (1e-2, 1e-6)
MOST_CYCLES = 200  # a matrix that is not H₊ lets v grow for ever
NO_PROOF = (
    "on several ranks an error bound needs an H₊-matrix (⟨M⟩v > 0 for some v > 0, positive diagonal), and M was not "
    "proven to be one; use the residuals, or solve on one machine, where a positive definite M is bounded as well"
)


@dataclass(frozen=True, eq=False)
class HPlusCertificate:
    """A positive v with ⟨M⟩v ≥ margin > 0 on every rank: M is an H₊-matrix, whatever rounding did.

    Attributes
    ----------
    v, margin : ndarray, shape (last − first,)
        The own parts.
    contraction : float
        An upper bound of c = max_i (1 − margin_i/(d_i v_i)), the same on every rank.

    Notes
    -----
    A sweep of projected Gauss–Seidel makes the error e in the norm max_i |e_i|/v_i at most c times as large. With ω_i
    added to the pivot d_i, as `pgs` does for the couplings of row i to other ranks, it is (c + f)/(1 + f) times,
    f = max_i ω_i/d_i. For with |e_j| ≤ t v_j before the sweep, and afterwards on the rows done, projection brings
    nothing apart and so

        (d_i + ω_i)|e_i| ≤ ω_i t v_i + Σ_{j≠i} |m_ij| t v_j ≤ (ω_i + d_i − margin_i/v_i) t v_i,

    that is |e_i| ≤ t v_i (f_i + c_i)/(1 + f_i), which grows with f_i and with c_i; and it is ≤ t v_i, so that the rows
    that follow find what was assumed. Of exact arithmetic.
    """

    v: FloatVector = field(repr=False)
    margin: FloatVector = field(repr=False)
    contraction: float


@dataclass(frozen=True, eq=False)
class DistributedErrorBound(ErrorBound):
    """An :class:`lcp_plugin.ErrorBound` whose arrays are the own parts and whose numbers speak of all rows.

    Attributes
    ----------
    n, active, inactive : int
        How many rows there are, and how many of them are proven to be what, over all ranks.
    """

    n: int = 0
    active: int = 0
    inactive: int = 0

    @property
    def is_active_set_proven(self) -> bool:
        """True where every row of every rank is proven active or inactive."""
        return self.active + self.inactive == self.n

    def __str__(self) -> str:
        return (
            f"‖z − z*‖∞ ≤ {self.infinity:.3e}, relative {self.relative:.3e} ({self.kind}, {self.method})\n"
            f"proven: {self.active} active, {self.inactive} inactive, {self.n - self.active - self.inactive} "
            f"of {self.n} undecided"
        )


def h_plus_certificate(problem: DistributedLCP) -> HPlusCertificate | None:
    """Return a proof that M is an H₊-matrix, or None where none was found; all ranks call.

    v is a vector of ones or solves ⟨M⟩v = diag(M) roughly, by the multigrid of this package. That it does its work is
    verified row by row with all rounding counted.
    """
    if largest(problem.comm, float(not (problem.diagonal > 0.0).all()))[0]:
        return None
    for v in _candidates(problem):
        if not -largest(problem.comm, -float(v.min(initial=np.inf)))[0] > 0.0:
            continue
        with np.errstate(all="ignore"):
            margin = lower_end(*comparison_product(problem.rows.as_csr(), problem.rows.filled(v)))
            # Rounded downwards; 1 where there is no row, as no margin_i exceeds d_i v_i.
            kept = -quotient_above(-margin, product_above(problem.diagonal, v)).max(initial=-1.0)
            least, least_kept = (-one for one in largest(problem.comm, -float(margin.min(initial=np.inf)), -kept))
        if least > 0.0 and least_kept >= 0.0:
            return HPlusCertificate(v, margin, max(float(sum_above(1.0, -least_kept)), 0.0))
    return None


def _candidates(problem: DistributedLCP) -> Iterator[FloatVector]:
    """Yield vectors that may be such a v: ones, then solutions of ⟨M⟩v = diag(M), each nearer than the one before."""
    from .solving import solve

    own, rows = problem.layout.own, problem.rows
    yield np.ones(own)
    magnitudes = -np.abs(rows.data)
    on_diagonal = rows.indices == np.repeat(np.arange(rows.count, dtype=rows.indices.dtype), np.diff(rows.indptr))
    np.negative(magnitudes, out=magnitudes, where=on_diagonal)
    numbers = np.concatenate([np.arange(problem.first, problem.last), rows.ghosts])
    comparison = DistributedLCP(
        Rows(problem.layout, rows.indptr, numbers[rows.indices], magnitudes), -problem.diagonal,
        np.zeros(own), np.full(own, np.inf),
    )
    start = np.ones(own)
    for tolerance in SOLVE_TOLERANCES:
        start = solve(comparison, "multigrid", z0=start, tolerance=tolerance, max_iterations=MOST_CYCLES).z
        yield start


def error_bound(
    problem: DistributedLCP, z: FloatVector, certificate: HPlusCertificate | None = None
) -> DistributedErrorBound:
    """Return a bound of |z − z*| from the v-certificate, its componentwise part on the own rows; all ranks call.

    Parameters
    ----------
    problem : DistributedLCP
    z : array, shape (last − first,)
        The own part of any point; where one rank's part is not finite the bound is ∞.
    certificate : HPlusCertificate, optional
        Of this M, where it is at hand.

    Raises
    ------
    UnsuitableMatrix
        On every rank, where M is not proved to be an H₊-matrix.
    """
    z = problem.own_part(z)
    certificate = certificate or h_plus_certificate(problem)
    if certificate is None:
        raise UnsuitableMatrix(NO_PROOF)
    own = problem.layout.own
    is_fixed = problem.lower == problem.upper
    if largest(problem.comm, float(not np.isfinite(z).all()))[0]:
        is_free = (problem.lower == -np.inf) & (problem.upper == np.inf)
        return _counted(problem, np.full(own, np.inf), z, is_fixed, is_free)
    local, whole = problem.at(z)
    v = problem.rows.filled(certificate.v).copy()
    margin = np.concatenate([certificate.margin, v[own:]])  # a foreign row is z_j = its value
    with np.errstate(all="ignore"):
        at = RowInequality.at(local, whole)
        t, = largest(problem.comm, at.inflation(v, margin))
        y = product_above(np.float64(t), v)
        active, inactive = at.classified(y)
    return _counted(problem, y[:own], z, active[:own] | is_fixed, inactive[:own])


def _counted(
    problem: DistributedLCP, y: FloatVector, z: FloatVector, active: BoolVector, inactive: BoolVector
) -> DistributedErrorBound:
    size = float(np.abs(z).max(initial=0.0))
    worst, size = largest(problem.comm, float(y.max(initial=0.0)), size)
    relative = 0.0 if worst == 0.0 else np.inf
    if 0.0 < worst < np.inf and size > 0.0:
        with np.errstate(all="ignore"):
            relative = float(quotient_above(np.float64(worst), np.float64(size)))
    counts = total(problem.comm, float(np.count_nonzero(active)), float(np.count_nonzero(inactive)))
    return DistributedErrorBound(
        y, worst, relative, "rigorous", "v-certificate", active, inactive,
        n=problem.n, active=int(counts[0]), inactive=int(counts[1]),
    )
