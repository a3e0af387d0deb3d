"""How much a sweep of projected Gauss–Seidel contracts, from a v > 0 with ⟨M⟩v > 0."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..checks import FloatVector
from ..exact.upward import product_above, quotient_above, sum_above
from ..matrix import comparison_certificate
from ..problem.lcp import LCP


@dataclass(frozen=True, eq=False)
class HPlusCertificate:
    """A positive v with ⟨M⟩v ≥ margin > 0: M, whose diagonal is positive, is an H₊-matrix, whatever rounding did.

    Attributes
    ----------
    v, margin : ndarray, shape (n,)
        On several ranks the own parts.
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


def h_plus_certificate(problem: LCP) -> HPlusCertificate | None:
    """Return a proof that M is an H₊-matrix, or None where none was found; on several ranks all of them call.

    Examples
    --------
    >>> h_plus_certificate(LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0]))
    HPlusCertificate(contraction=0.5000000000000002)
    >>> h_plus_certificate(LCP([[1.0, 2.0], [2.0, 1.0]], [-5.0, 1.0])) is None
    True
    """
    if not problem.peers.everywhere(bool((problem.diagonal > 0.0).all())):
        return None
    certificate = comparison_certificate(problem.matrix)
    if certificate is None:
        return None
    with np.errstate(all="ignore"):
        # Rounded downwards; 1 where there is no row, as no margin_i exceeds d_i v_i.
        kept = -quotient_above(-certificate.margin, product_above(problem.diagonal, certificate.v)).max(initial=-1.0)
    least = -problem.peers.largest(-float(kept))
    return HPlusCertificate(certificate.v, certificate.margin, max(float(sum_above(1.0, -least)), 0.0))
