"""The verdicts of a report, one function each: what decides it, from cheap to costly, and the evidence in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..exact.linear_systems import EXACT_SIZE, exact_symmetric_part, has_nonnegative_pivots, has_positive_pivots
from ..exact.rounding import TINY, UNIT
from .definiteness import LARGEST_SUMMAND, is_positive_definite, is_semidefinite_to_rounding, semidefinite_margin
from .h_matrix import prove_m_matrix
from .matrix import Matrix
from .p_matrix import LARGEST_SIZE, is_p_matrix_by_recursion, nonpositive_pair
from .structure import block_rows, row_numbers

if TYPE_CHECKING:
    from .report import MatrixReport

DENSE_LIMIT = 500
LARGEST_COUNT = 1_000  # of diagonal blocks to look at one by one
SYMMETRIC_TO_ROUNDING = 64 * UNIT
SMALLEST_DIAGONAL = 2.0**-960  # of a symmetric part, whose subnormal entries are rounded absolutely
UNDECIDED = "undecided: singular up to rounding"


class Verdict(NamedTuple):
    """`value` True, False, or None where it is undecided; `evidence` says why; `delta`: see `semidefinite_delta`."""

    value: bool | None
    evidence: str
    delta: float | None = None


def symmetric(report: MatrixReport) -> Verdict:
    """M = Mᵀ, entry by entry."""
    found = report.asymmetry
    if found == 0.0:
        return Verdict(True, "M = Mᵀ exactly")
    to_rounding = ", symmetric up to rounding" if found <= SYMMETRIC_TO_ROUNDING else ""
    return Verdict(False, f"largest relative asymmetry {found:.3g}{to_rounding}")


def z_matrix(report: MatrixReport) -> Verdict:
    """No positive entry beside the diagonal."""
    M = report.csr
    rows = row_numbers(M)
    positive = np.flatnonzero((M.data > 0.0) & (rows != M.indices))
    if positive.size == 0:
        return Verdict(True, "no positive entry beside the diagonal")
    k = positive[0]
    return Verdict(False, f"M[{rows[k]}, {M.indices[k]}] = {M.data[k]:.6g} > 0")


def m_matrix(report: MatrixReport) -> Verdict:
    """M is a nonsingular M-matrix: Z and H₊."""
    is_z = report.verdict("is_z_matrix")
    return report.verdict("is_h_plus") if is_z.value else Verdict(False, f"no Z-matrix: {is_z.evidence}")


def strictly_dominant(report: MatrixReport) -> Verdict:
    """|m_ii| > Σ_j≠i |m_ij| on every row."""
    signs = report.row_excess_signs
    if (signs > 0).all():
        return Verdict(True, "|m_ii| > Σ|m_ij| on every row, exactly")
    row = int(np.flatnonzero(signs <= 0)[0])
    return Verdict(False, f"|m_ii| {'=' if signs[row] == 0 else '<'} Σ|m_ij| on row {row}")


def irreducibly_dominant(report: MatrixReport) -> Verdict:
    """Irreducible, |m_ii| ≥ Σ_j≠i |m_ij| on every row and > on one at least."""
    signs = report.row_excess_signs
    if (signs < 0).any():
        return Verdict(False, f"|m_ii| < Σ|m_ij| on row {int(np.flatnonzero(signs < 0)[0])}")
    if signs.size and not (signs > 0).any():
        return Verdict(False, "|m_ii| = Σ|m_ij| on every row")
    if not report.is_irreducible:
        return Verdict(False, f"reducible: {report.blocks} strongly connected blocks")
    return Verdict(True, f"|m_ii| ≥ Σ|m_ij|, strictly on {int((signs > 0).sum())} of {signs.size} rows; irreducible")


def h_matrix(report: MatrixReport) -> Verdict:
    """⟨M⟩ is a nonsingular M-matrix, whatever the signs of the diagonal."""
    return Verdict(report.h_verdict.is_h, report.h_verdict.evidence)


def h_plus(report: MatrixReport) -> Verdict:
    """M is an H-matrix with positive diagonal."""
    return _nonpositive_diagonal(report) or report.verdict("is_h_matrix")


def irreducible(report: MatrixReport) -> Verdict:
    """M has a strongly connected graph."""
    if report.blocks <= 1:
        return Verdict(True, "the graph of M is strongly connected")
    return Verdict(False, f"{report.blocks} strongly connected blocks")


def triangular(report: MatrixReport) -> Verdict:
    """Lower or upper triangular, or diagonal, in the given order."""
    form = report.triangular_form
    return Verdict(form is not None, form or "entries on both sides of the diagonal")


def positive_definite(report: MatrixReport) -> Verdict:
    """xᵀM x > 0 for every x ≠ 0."""
    early = _nonpositive_diagonal(report) or _definite_by_comparison(report)
    if early is not None:
        return early
    what = "M" if report.is_symmetric else "the symmetric part of M"
    if not report.can_factorise:
        return Verdict(None, _too_large(report))
    value = is_positive_definite(report.symmetric_part) if _is_well_rounded(report) else None
    if value is None and report.n <= EXACT_SIZE:
        value = has_positive_pivots(exact_symmetric_part(report.csr))
        return Verdict(value, f"exact elimination of {what}")
    if value is None:
        return Verdict(None, f"{UNDECIDED}: {what}")
    if value:
        return Verdict(True, f"{'SPD: ' if report.is_symmetric else ''}{what} factorises, rounding margin included")
    return Verdict(False, f"{what} does not factorise, rounding margin included")


def positive_semidefinite(report: MatrixReport) -> Verdict:
    """xᵀM x ≥ 0 for every x: exactly up to n = 10; beyond, a singular M is undecided, with the δ in the evidence."""
    if (report.diagonal < 0.0).any():
        return _nonpositive_diagonal(report) or Verdict(False, "")
    if report.is_symmetric and (report.row_excess_signs >= 0).all():
        return Verdict(True, "λ_min ≥ 0: symmetric, m_ii ≥ Σ|m_ij| on every row, exactly", 0.0)
    definite = report.verdict("is_positive_definite")
    if definite.value:
        return Verdict(True, "λ_min > 0: positive definite", 0.0)
    if not report.can_factorise:
        return Verdict(None, _too_large(report))
    part = report.symmetric_part
    value = is_semidefinite_to_rounding(part) if _is_well_rounded(report) else None
    if value is not False and report.n <= EXACT_SIZE:
        what = "exact elimination of M" if report.is_symmetric else "exact elimination of the symmetric part of M"
        if has_nonnegative_pivots(exact_symmetric_part(report.csr)):
            return Verdict(True, f"λ_min ≥ 0: {what}", 0.0)
        return Verdict(False, f"λ_min < 0: {what}")
    if value:
        delta = semidefinite_margin(part)
        return Verdict(None, f"undecided: λ_min ≥ −{delta:.3g}, up to which nothing can be said", delta)
    if value is None and not _is_well_rounded(report):
        return Verdict(None, "undecided: the numbers are near the ends of the range of doubles")
    if value is None:
        return Verdict(None, f"not computed: rounding at n = {report.n} would hide too much")
    return Verdict(False, "a negative eigenvalue beyond rounding")


def p_matrix(report: MatrixReport) -> Verdict:
    """Every principal minor is positive."""
    early = _nonpositive_diagonal(report) or _p_by_class(report)
    if early is not None:
        return early
    pair = nonpositive_pair(report.csr)
    if pair is not None:
        return Verdict(False, f"the principal minor of rows {pair[0]}, {pair[1]} is not positive")
    if not report.is_irreducible:
        return _p_by_blocks(report)
    if report.n <= LARGEST_SIZE:
        value = is_p_matrix_by_recursion(report.csr)
        how = "recursive Schur complements, rounding included"
        return Verdict(value, how if value is not None else f"undecided: a minor vanishes up to rounding ({how})")
    definite = report.verdict("is_positive_definite")
    if definite.value:
        return Verdict(True, "every positive definite matrix is one")
    return Verdict(None, f"not computed: n = {report.n} > {LARGEST_SIZE}, the minors are too many")


def _p_by_class(report: MatrixReport) -> Verdict | None:
    """Where a class decides: triangular, H₊, Z (P is M), symmetric (P is positive definite)."""
    if report.triangular_form is not None:
        return Verdict(True, "triangular with positive diagonal")
    h = report.verdict("is_h_plus")
    if h.value:
        return Verdict(True, "every H₊-matrix is one")
    if report.is_z_matrix and h.value is False:
        return Verdict(False, "a Z-matrix that is no M-matrix")
    if report.is_symmetric:
        definite = report.verdict("is_positive_definite")
        return Verdict(definite.value, f"symmetric: {definite.evidence}")
    return None


def _p_by_blocks(report: MatrixReport) -> Verdict:
    """M is P exactly if each strongly connected diagonal block is."""
    undecided: Verdict | None = None
    # A block of one row is positive.
    parts = [rows for rows in block_rows(report.block_labels, report.blocks) if rows.size > 1]
    if len(parts) > LARGEST_COUNT:
        return Verdict(None, f"not computed: {len(parts)} diagonal blocks are too many")
    for rows in parts:
        part = type(report)(Matrix(sp.csr_array(report.csr[rows][:, rows]))).verdict("is_p_matrix")
        if part.value is False:
            return Verdict(False, f"the diagonal block of row {rows[0]}: {part.evidence}")
        if part.value is None:
            undecided = part
    if undecided is not None:
        return Verdict(None, f"a diagonal block: {undecided.evidence}")
    return Verdict(True, f"each of {report.blocks} diagonal blocks is a P-matrix")


def _nonpositive_diagonal(report: MatrixReport) -> Verdict | None:
    nonpositive = np.flatnonzero(report.diagonal <= 0.0)
    if nonpositive.size == 0:
        return None
    row = int(nonpositive[0])
    return Verdict(False, f"M[{row}, {row}] = {report.diagonal[row]:.6g}")


def _definite_by_comparison(report: MatrixReport) -> Verdict | None:
    """Decide by theorems: symmetric H₊-matrices are SPD, symmetric Z-matrices that are no H₊ are not."""
    if report.is_symmetric:
        h = report.verdict("is_h_plus")
        if h.value:
            return Verdict(True, "SPD: symmetric and H₊")
        if h.value is False and report.is_z_matrix:
            return Verdict(False, "a symmetric Z-matrix that is no M-matrix")
        pair = nonpositive_pair(report.csr)
        if pair is not None:
            return Verdict(False, f"the principal minor of rows {pair[0]}, {pair[1]} is not positive")
        return None
    if not _is_well_rounded(report):
        return None
    # Each entry of the symmetric part was rounded once, subnormal ones absolutely; the margin must survive that.
    part = sp.csr_array(report.sparse_symmetric_part)
    proof = prove_m_matrix(part.diagonal() * (1.0 - 4.0 * UNIT), part * (1.0 + 4.0 * UNIT), effort="cheap").certificate
    if proof is not None and bool((proof.margin > 2.0 * TINY * proof.v.sum()).all()):
        return Verdict(True, "the symmetric part is H₊: ⟨·⟩v > 0 checked, rounding included")
    return None


def _is_well_rounded(report: MatrixReport) -> bool:
    """Return whether the rounding of the symmetric part is small beside the diagonal, and nothing overflows."""
    if report.is_symmetric:
        return True
    diagonal, entries = report.diagonal[report.diagonal > 0.0], report.csr.data
    return bool((diagonal >= SMALLEST_DIAGONAL).all() and np.abs(entries).max(initial=0.0) < LARGEST_SUMMAND)


def _too_large(report: MatrixReport) -> str:
    return f"not computed: n = {report.n} is too large for a factorisation"
