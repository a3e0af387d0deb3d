"""Is ⟨M⟩ a nonsingular M-matrix? Found by any means, accepted only after a rigorous check.

Yes is proven by v > 0 with ⟨M⟩v > 0. No is proven by y ≥ 0, y ≠ 0 with ⟨M⟩y ≤ 0, since ⟨M⟩⁻¹ ≥ 0 would make this y
nonpositive. One solve gives either: with (I − D⁻¹|B|)x = 1, x > 0 is a valid v, else y = max(−x, 0) is strict on its
support. Both are checked on M itself with the bounds of :mod:`lcp_plugin.core.rounding`; the verdict is undecided if
rounding makes both fail.

References
----------
Berman, Plemmons, *Nonnegative Matrices in the Mathematical Sciences*, SIAM 1994, ch. 6,
doi:10.1137/1.9781611971262.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.checks import FloatVector, read_only
from ...core.matrix.matrix import Matrix, fact
from ...core.rounding import lower_end, upper_end
from ...systems.comparison import ComparisonMatrix
from ...systems.comparison_sums import comparison_product, exact_comparison_row
from ..exact.rational import rounded_down

EXACT_ROWS = 2_000  # ambiguous rows that are worth an exact sum
TOLERANCES = 0.1, 1e-3, 1e-7  # of the solves, if they iterate: a loose one is often enough
SMALLEST_WEIGHT = 1e-30


@dataclass(frozen=True, eq=False)
class HCertificate:
    """A proof that ⟨M⟩ is a nonsingular M-matrix: ⟨M⟩v ≥ margin > 0, v > 0, both of shape (n,), read-only.

    `margin` is a lower bound of the exact product of the stored doubles.
    """

    v: FloatVector
    margin: FloatVector


@dataclass(frozen=True, eq=False)
class HVerdict:
    """Verdict on ⟨M⟩: `is_h` True, False or None, and its proof."""

    is_h: bool | None
    evidence: str
    certificate: HCertificate | None = None
    not_h_vector: FloatVector | None = None


def comparison_certificate(matrix: Matrix) -> HCertificate | None:
    """Return v > 0 with ⟨M⟩v ≥ margin > 0, proven and cached for this M, or None if none was found.

    Parameters
    ----------
    matrix : Matrix

    Notes
    -----
    It does not depend on the signs of the diagonal. Cost: a product with M; if that does not decide, up to three
    solves with ⟨M⟩ (LAPACK, sparse LU, or multigrid).

    Examples
    --------
    >>> certificate = comparison_certificate(Matrix([[2, -2], [-1, 2]]))
    >>> bool((certificate.margin > 0).all())
    True
    >>> comparison_certificate(Matrix([[1, 2], [2, 1]])) is None
    True
    """
    return h_verdict(matrix).certificate


@fact
def h_verdict(matrix: Matrix) -> HVerdict:
    """Return whether M is an H-matrix, with its proof."""
    return decide(matrix.csr)


def positive_margin(M: Any, v: FloatVector) -> FloatVector | None:
    """Return a rigorous lower bound of ⟨M⟩v if it is positive on every row and v > 0, else None."""
    if not ((v > 0.0) & np.isfinite(v)).all():
        return None
    value, radius = comparison_product(M, v)
    margin = lower_end(value, radius)
    doubtful = np.flatnonzero(~(margin > 0.0))
    if doubtful.size > EXACT_ROWS:
        return None
    for row in doubtful:
        exact = exact_comparison_row(M, v, int(row))
        margin[row] = rounded_down(exact) if exact > 0 else 0.0
        if not margin[row] > 0.0:
            return None
    return margin


def is_nonpositive(M: Any, y: FloatVector) -> bool:
    """Return whether ⟨M⟩y ≤ 0 is proven on every row, for y ≥ 0, y ≠ 0."""
    if not (np.isfinite(y).all() and (y >= 0.0).all() and y.any()):
        return False
    value, radius = comparison_product(M, y)
    doubtful = np.flatnonzero(~(upper_end(value, radius) <= 0.0))
    return doubtful.size <= EXACT_ROWS and all(
        exact_comparison_row(M, y, int(row)) <= 0 for row in doubtful
    )


def decide(M: Any) -> HVerdict:
    """Return whether ⟨M⟩ is a nonsingular M-matrix: v = 1, then solutions of ⟨M⟩v = |diag(M)| w for w = 1, then |v|.

    Weights |v| make the margin of every row relative to its own v.
    """
    n = M.shape[0]
    zeros = np.flatnonzero(M.diagonal() == 0.0)
    if zeros.size:
        y = np.zeros(n)
        y[zeros[0]] = 1.0
        return HVerdict(False, f"M[{zeros[0]}, {zeros[0]}] = 0", not_h_vector=read_only(y))
    ones = read_only(np.ones(n))
    if (margin := positive_margin(M, ones)) is not None:
        return HVerdict(
            True, "v = 1: every row sum of ⟨M⟩ is positive", HCertificate(ones, read_only(margin))
        )
    if is_nonpositive(M, ones):
        return HVerdict(False, "y = 1: no row sum of ⟨M⟩ is positive", not_h_vector=ones)
    system, weights = ComparisonMatrix(M), ones
    for tolerance in TOLERANCES:
        x = system.solve(system.diagonal * weights, tolerance=tolerance)
        if x is None:
            return HVerdict(None, "⟨M⟩ is numerically singular, or too large to be factorized")
        v = _centred(system.to_caller(x))
        if (margin := positive_margin(M, v)) is not None:
            smallest = float((margin / np.abs(M.diagonal()) / v).min())
            evidence = f"v from a solve with ⟨M⟩: ⟨M⟩v > 0 checked, ρ(D⁻¹|B|) ≤ 1 − {smallest:.3g}"
            return HVerdict(True, evidence, HCertificate(read_only(v), read_only(margin)))
        y = _centred(system.to_caller(np.maximum(-x, 0.0)))
        if is_nonpositive(M, y):
            return HVerdict(
                False, "y ≥ 0 from a solve with ⟨M⟩: ⟨M⟩y ≤ 0 checked", not_h_vector=read_only(y)
            )
        weights = np.maximum(np.abs(x) / np.abs(x).max(), SMALLEST_WEIGHT)
    return HVerdict(None, "solutions of ⟨M⟩v = |diag(M)| pass neither check: ρ is 1 up to rounding")


def _centred(v: FloatVector) -> FloatVector:
    """Return v ≥ 0 times a power of two that keeps products with it away from the ends of the range."""
    positive = v[v > 0.0]
    if positive.size == 0 or not np.isfinite(positive).all():
        return v
    middle = int(np.frexp(positive.max())[1] + np.frexp(positive.min())[1]) // 2
    return np.ldexp(v, -middle)
