"""What is proved about a matrix whose rows lie on several ranks, and what that says about an error."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..certificates.error_bounds import ErrorBound
from ..certificates.row_inequality import RowInequality
from ..certificates.upward import product_above, quotient_above
from ..errors import UnsuitableMatrix
from ..problem import FloatVector
from ..rounding import comparison_product, lower_end
from .collective import largest, total
from .problem import DistributedLCP
from .rows import Rows

SOLVE_TOLERANCES = (1e-2, 1e-6)


@dataclass(frozen=True, eq=False)
class HPlusCertificate:
    """A positive v with ⟨M⟩v ≥ margin > 0 on every rank: M is an H₊-matrix, whatever rounding did.

    Attributes
    ----------
    v, margin : ndarray, shape (last − first,)
        The own parts.
    contraction : float
        max_i (1 − margin_i/(d_i v_i)): a sweep of projected Gauss–Seidel reduces the error in the norm max |e_i|/v_i by
        this factor at least, with the pivots that the ranks need up to (contraction + f)/(1 + f), f = max weight_i/d_i.
    """

    v: FloatVector = field(repr=False)
    margin: FloatVector = field(repr=False)
    contraction: float


def h_plus_certificate(problem: DistributedLCP) -> HPlusCertificate | None:
    """Return a proof that M is an H₊-matrix, or None where none was found; all ranks call.

    v solves ⟨M⟩v = 1 roughly, by the multigrid of this package. That it does its work is verified row by row with all
    rounding counted.
    """
    if total(problem.comm, float(np.count_nonzero(~(problem.diagonal > 0.0))))[0]:
        return None
    for v in _candidates(problem):
        if largest(problem.comm, -float(v.min(initial=np.inf)))[0] >= 0.0:
            continue
        whole = problem.rows.filled(v)
        value, radius = comparison_product(problem.rows.as_csr(), whole)
        margin = lower_end(value, radius)
        with np.errstate(all="ignore"):
            kept = margin / (problem.diagonal * v)
            lowest = -largest(problem.comm, -float(kept.min(initial=np.inf)))[0]
        if lowest > 0.0 and np.isfinite(lowest):
            return HPlusCertificate(v, margin, float(np.nextafter(1.0 - lowest, 2.0)))
    return None


def _candidates(problem: DistributedLCP):  # type: ignore[no-untyped-def]
    """Yield vectors that may be such a v: constants, then solutions of ⟨M⟩v = 1, each nearer than the one before."""
    from .solving import solve

    own = problem.layout.own
    yield np.ones(own)
    rows = problem.rows
    magnitudes = -np.abs(rows.data)
    on_diagonal = rows.indices == np.repeat(np.arange(rows.count, dtype=rows.indices.dtype), np.diff(rows.indptr))
    np.negative(magnitudes, out=magnitudes, where=on_diagonal)
    numbers = np.concatenate([np.arange(problem.first, problem.last), rows.ghosts])
    comparison = DistributedLCP(
        Rows(problem.layout, rows.indptr, numbers[rows.indices], magnitudes), -problem.diagonal,
        np.zeros(own), np.full(own, np.inf),
    )
    for tolerance in SOLVE_TOLERANCES:
        yield np.maximum(solve(comparison, "multigrid", tolerance=tolerance).z, 0.0)


def error_bound(problem: DistributedLCP, z: FloatVector) -> ErrorBound:
    """Return a bound of |z − z*| from the v-certificate, its componentwise part on the own rows; all ranks call.

    Raises
    ------
    UnsuitableMatrix
        On every rank, where M is not proved to be an H₊-matrix.
    """
    certificate = h_plus_certificate(problem)
    if certificate is None:
        raise UnsuitableMatrix("M was not proved to be an H₊-matrix: nothing bounds the error on several ranks")
    own = problem.layout.own
    ghosts = problem.rows.ghosts.size
    local, whole = problem.at(z)
    v = problem.rows.filled(certificate.v).copy()
    margin = np.concatenate([certificate.margin, v[own:]])  # a foreign row is z_j = its value
    with np.errstate(all="ignore"):
        at = RowInequality.at(local, whole)
        t, = largest(problem.comm, at.inflation(v, margin))
        y = product_above(np.float64(t), v)
        active, inactive = at.classified(y)
        worst, size = largest(problem.comm, float(y[:own].max(initial=0.0)), float(np.abs(z).max(initial=0.0)))
        relative = 0.0 if worst == 0.0 else float(quotient_above(worst, size)) if size > 0.0 else np.inf
    del ghosts
    return ErrorBound(y[:own], worst, relative, "rigorous", "v-certificate", active[:own], inactive[:own])


def error_bound_or_reason(problem: DistributedLCP, z: FloatVector) -> tuple[ErrorBound | None, str]:
    """Return the bound, or None and why there is none."""
    try:
        return error_bound(problem, z), ""
    except UnsuitableMatrix as error:
        return None, str(error)
