"""Is ⟨M⟩ a nonsingular M-matrix? Found by any means, believed only after a rigorous check.

Yes is proven by v > 0 with ⟨M⟩v > 0. No is proven by y ≥ 0, y ≠ 0 with ⟨M⟩y ≤ 0, since ⟨M⟩⁻¹ ≥ 0 would make such a y
nonpositive. One solve gives either: with (I − D⁻¹|B|)x = 1, x > 0 is such a v, else y = max(−x, 0) is strict on its
support. Both are checked on M itself with the bounds of :mod:`lcp_plugin.core.rounding`.

References
----------
Berman, Plemmons, *Nonnegative Matrices in the Mathematical Sciences*, SIAM 1994, ch. 6,
doi:10.1137/1.9781611971262.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, read_only
from ...core.matrix.matrix import Matrix, fact
from ...core.rounding import lower_end, upper_end
from ...systems.comparison import DIRECT_LIMIT, ComparisonMatrix
from ...systems.comparison_sums import comparison_product, exact_comparison_row
from ...systems.graph import block_rows, strong_blocks
from ..exact.linear_systems import EXACT_SIZE, exact_comparison, exact_weights, has_positive_pivots
from ..exact.rational import enclosures, rounded_down

EXACT_ROWS = 2_000  # ambiguous rows that are worth an exact sum
GAINS = (1e-2, 1e-6)  # what a solve with ⟨M⟩ shall leave of its residual
MOST_STEPS = 30  # a matrix that is not H₊ lets v grow for ever


@dataclass(frozen=True, eq=False)
class HCertificate:
    """A proof that ⟨M⟩ is a nonsingular M-matrix: ⟨M⟩v ≥ margin > 0, v > 0, both of shape (n,), read-only.

    `margin` is a lower bound of the exact product of the stored doubles.
    """

    v: FloatVector
    margin: FloatVector

    def __post_init__(self) -> None:
        object.__setattr__(self, "v", read_only(self.v))
        object.__setattr__(self, "margin", read_only(self.margin))


class Weights(NamedTuple):
    """Doubles below and above some v > 0, `low` > 0, and below ⟨M⟩v: a proof, too, where v is no vector of doubles."""

    low: FloatVector
    high: FloatVector
    margin: FloatVector


@dataclass(frozen=True, eq=False)
class HVerdict:
    """What is known about ⟨M⟩: `is_h` True, False or None, and its proof.

    `is_h` may be True without a certificate: no v of doubles was found, as where ⟨M⟩ is singular up to rounding or v
    leaves their range.
    """

    is_h: bool | None
    evidence: str
    certificate: HCertificate | None = None
    not_h_vector: FloatVector | None = None

    def __post_init__(self) -> None:
        if self.not_h_vector is not None:
            object.__setattr__(self, "not_h_vector", read_only(self.not_h_vector))


def comparison_certificate(matrix: Matrix) -> HCertificate | None:
    """Return v > 0 with ⟨M⟩v ≥ margin > 0, proven and cached for this M, or None where none was found.

    Parameters
    ----------
    matrix : Matrix

    Notes
    -----
    It says nothing of the signs of the diagonal. Cost: a few products with M; where those do not settle it, a loose
    solve with ⟨M⟩ (LAPACK, sparse LU, or multigrid).

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
    return decide(matrix.csr, lambda: ComparisonMatrix(matrix.csr))


@fact
def comparison_weights(matrix: Matrix) -> Weights | None:
    """Return enclosures of a v > 0 with ⟨M⟩v > 0, or None where no such v is at hand; exact ones up to n = 10."""
    verdict = h_verdict(matrix)
    if verdict.certificate is not None:
        return Weights(verdict.certificate.v, verdict.certificate.v, verdict.certificate.margin)
    v = exact_weights(matrix.csr) if verdict.is_h and matrix.n <= EXACT_SIZE else None
    if v is None:
        return None
    low, high = enclosures(v)
    return Weights(read_only(low), read_only(high), read_only(np.abs(matrix.diagonal)))


def positive_margin(M: Any, v: FloatVector) -> FloatVector | None:
    """Return a rigorous lower bound of ⟨M⟩v where it is positive on every row and v > 0, else None."""
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


def _certified(M: Any, v: FloatVector) -> HCertificate | None:
    margin = positive_margin(M, v)
    return None if margin is None else HCertificate(v, margin)


def is_nonpositive(M: Any, y: FloatVector) -> bool:
    """Return whether ⟨M⟩y ≤ 0 is proven on every row, for y ≥ 0, y ≠ 0."""
    if not (np.isfinite(y).all() and (y >= 0.0).all() and y.any()):
        return False
    value, radius = comparison_product(M, y)
    doubtful = np.flatnonzero(~(upper_end(value, radius) <= 0.0))
    return doubtful.size <= EXACT_ROWS and all(
        exact_comparison_row(M, y, int(row)) <= 0 for row in doubtful
    )


@np.errstate(all="ignore")  # what overflows fails its check
def decide(M: Any, comparison: Any, *, by_blocks: bool = True) -> HVerdict:
    """Return whether ⟨M⟩ is a nonsingular M-matrix; `comparison` makes its ComparisonMatrix, None: cheap stages only.

    Stages: the diagonal, v = 1, sweeps, one solve, and the strongly connected blocks one by one.
    """
    n = M.shape[0]
    zeros = np.flatnonzero(M.diagonal() == 0.0)
    if zeros.size:
        y = np.zeros(n)
        y[zeros[0]] = 1.0
        return HVerdict(False, f"M[{zeros[0]}, {zeros[0]}] = 0", not_h_vector=y)
    verdict = _by_row_sums(M)
    if verdict.is_h is not None:
        return verdict
    if comparison is None:
        return _by_sweeps(M, ComparisonMatrix(M)) or verdict
    system: ComparisonMatrix = comparison()
    verdict = _by_sweeps(M, system) or _by_solving(M, system)
    if verdict.is_h is None and by_blocks:
        verdict = _by_blocks(M, verdict)
    if verdict.is_h is None and n <= EXACT_SIZE:
        is_h = has_positive_pivots(exact_comparison(M))
        v = exact_weights(M) if is_h else None
        certificate = None if v is None else _certified(M, _centred(enclosures(v)[1]))
        return HVerdict(
            is_h, "exact elimination of ⟨M⟩: ρ(D⁻¹|B|) is 1 up to rounding", certificate
        )
    return verdict


def _by_row_sums(M: Any) -> HVerdict:
    ones = np.ones(M.shape[0])
    value, radius = comparison_product(M, ones)
    low, high = lower_end(value, radius), upper_end(value, radius)
    if (low > 0.0).all():
        upper = float(np.nanmax(1.0 - value / np.abs(M.diagonal()), initial=0.0))
        evidence = f"v = 1: every row sum of ⟨M⟩ is positive, ρ(D⁻¹|B|) ≤ {upper:.6g}"
        return HVerdict(True, evidence, HCertificate(ones, low))
    if (high <= 0.0).all():
        return HVerdict(False, "y = 1: no row sum of ⟨M⟩ is positive", not_h_vector=ones)
    return HVerdict(None, "row sums of ⟨M⟩ have both signs or vanish")


def _by_sweeps(M: Any, system: ComparisonMatrix) -> HVerdict | None:
    """Take some power steps with (I + D⁻¹|B|)/2, until both Collatz–Wielandt bounds are on one side of 1."""
    x = np.ones(M.shape[0])
    for sweep in range(5):  # a solve costs more
        step = (system.matrix @ x) / system.diagonal
        ratio = 1.0 - step / x
        low, high = float(ratio.min()), float(ratio.max())
        if not np.isfinite(low + high):
            return None
        proven = _proven(M, system.to_caller(x), low, high, f"{sweep} sweeps")
        if proven is not None:
            return proven
        x = x - 0.5 * step
    return None


def _proven(M: Any, v: FloatVector, low: float, high: float, how: str) -> HVerdict | None:
    if high < 1.0:
        certificate = _certified(M, v)
        if certificate is not None:
            return HVerdict(
                True, f"v after {how}: ⟨M⟩v > 0 checked, ρ(D⁻¹|B|) ≤ {high:.6g}", certificate
            )
    if low >= 1.0 and is_nonpositive(M, v):
        return HVerdict(
            False, f"y after {how}: ⟨M⟩y ≤ 0 checked, ρ(D⁻¹|B|) ≥ {low:.6g}", not_h_vector=v
        )
    return None


def _by_solving(M: Any, system: ComparisonMatrix) -> HVerdict:
    """Solve (I − D⁻¹|B|)x = weights; weights 1, then |x|, which makes every row's margin relative to its own v."""
    weights = np.ones(M.shape[0])
    for _ in range(3):
        magnitudes = weights
        for tolerance in (0.1, 1e-3, 1e-7):  # a loose solve is often enough
            x = system.solve(system.diagonal * weights, tolerance=tolerance)
            if x is None:
                return HVerdict(None, "⟨M⟩ is numerically singular, or too large to be factorised")
            x = x / np.abs(x).max()
            magnitudes = np.abs(x)
            proven = _proven_by_solution(M, system, x)
            if proven is not None:
                return proven
            if x.size <= DIRECT_LIMIT:  # a tighter tolerance gives the same
                break
        weights = np.maximum(magnitudes, 1e-30)
    return HVerdict(
        None, "the solution of (I − D⁻¹|B|)x = 1 passes neither check: ρ is 1 up to rounding"
    )


def _proven_by_solution(M: Any, system: ComparisonMatrix, x: FloatVector) -> HVerdict | None:
    if (x > 0.0).all():
        certificate = _certified(M, _centred(system.to_caller(x)))
        if certificate is not None:
            smallest = float((certificate.margin / np.abs(M.diagonal()) / certificate.v).min())
            evidence = f"v from a solve with ⟨M⟩: ⟨M⟩v > 0 checked, ρ(D⁻¹|B|) ≤ 1 − {smallest:.3g}"
            return HVerdict(True, evidence, certificate)
    y = _centred(system.to_caller(np.maximum(-x, 0.0)))
    if is_nonpositive(M, y):
        return HVerdict(False, "y ≥ 0 from a solve with ⟨M⟩: ⟨M⟩y ≤ 0 checked", not_h_vector=y)
    return None


def _by_blocks(M: Any, verdict: HVerdict) -> HVerdict:
    """Decide each strongly connected block for itself: ⟨M⟩ is an M-matrix exactly if all of them are."""
    count, labels = strong_blocks(M)
    if count == 1:
        return verdict
    v = np.ones(M.shape[0])
    margin: FloatVector = np.abs(M.diagonal())
    undecided = 0
    for rows in block_rows(labels, count):
        if rows.size == 1:
            continue
        block = sp.csr_array(M[rows][:, rows])
        block.sort_indices()
        part = decide(block, lambda block=block: ComparisonMatrix(block), by_blocks=False)
        if part.not_h_vector is not None:
            y = np.zeros(v.size)
            y[rows] = part.not_h_vector
            if is_nonpositive(M, y):
                return HVerdict(False, f"a diagonal block: {part.evidence}", not_h_vector=y)
        if part.certificate is None:
            undecided += 1
        else:
            v[rows], margin[rows] = part.certificate.v, part.certificate.margin
    if undecided:
        return HVerdict(
            None, f"{undecided} of {count} diagonal blocks undecided: {verdict.evidence}"
        )
    evidence = f"each of {count} irreducible diagonal blocks is an H-matrix, ⟨block⟩v > 0 checked"
    return HVerdict(True, evidence, _joined(M, count, labels, v, margin))


def _joined(
    M: Any, count: int, labels: Any, v: FloatVector, margin: FloatVector
) -> HCertificate | None:
    """Return one v from those of the blocks, each scaled up until what couples to it takes half its margin."""
    diagonal_part = sp.diags_array(M.diagonal(), format="csr")
    coupling = sp.coo_array(abs(M - diagonal_part))
    between = labels[coupling.row] != labels[coupling.col]
    rows, columns, weight = coupling.row[between], coupling.col[between], coupling.data[between]
    factor = np.ones(count)
    for _ in range(1_000):  # each raises a factor, or ends
        load = np.bincount(rows, weight * (v * factor[labels])[columns], v.size)
        needed = np.zeros(factor.size)
        np.maximum.at(needed, labels, 2.0 * load / margin)
        short = needed > factor
        if not short.any():
            break
        factor[short] = np.exp2(np.ceil(np.log2(needed[short])))
        if not np.isfinite(factor).all():
            return None
    return _certified(M, _centred(v * factor[labels]))


def _centred(v: FloatVector) -> FloatVector:
    """Return v ≥ 0 times a power of two that keeps products with it away from the ends of the range."""
    positive = v[v > 0.0]
    if positive.size == 0 or not np.isfinite(positive).all():
        return v
    middle = int(np.frexp(positive.max())[1] + np.frexp(positive.min())[1]) // 2
    return np.ldexp(v, -middle)
