"""The verdicts of a report, one function each: tests from cheap to costly, and the evidence as text."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.kernels.floats import TINY, UNIT
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.structure import row_numbers, triangular_form
from ...systems.definiteness import (
    LARGEST_SUMMAND,
    is_positive_definite,
    is_semidefinite_to_rounding,
    semidefinite_margin,
    symmetric_part,
)
from ...systems.factors import factor_fits
from ...systems.graph import diagonal_blocks, row_excess_signs
from ...systems.symmetry import asymmetry, asymmetry_of_rows
from ..exact.linear_systems import (
    EXACT_SIZE,
    exact_symmetric_part,
    has_nonnegative_pivots,
    has_positive_pivots,
)
from .h_matrix import h_verdict, positive_margin
from .p_matrix import LARGEST_SIZE, is_p_matrix_by_recursion, nonpositive_pair

DENSE_LIMIT = 500
SYMMETRIC_TO_ROUNDING = 64 * UNIT
SMALLEST_DIAGONAL = 2.0**-960  # of a symmetric part, whose subnormal entries are rounded absolutely
UNDECIDED = "undecided: singular up to rounding"


class Verdict(NamedTuple):
    """`value` True, False, or None if it is undecided; `evidence` is the reason."""

    value: bool | None
    evidence: str


@fact
def symmetric(matrix: Matrix) -> Verdict:
    """M = Mᵀ, entry by entry."""
    found = asymmetry(matrix)
    if found == 0.0:
        return Verdict(True, "M = Mᵀ exactly")
    beside = asymmetry_of_rows(matrix)
    if min(found, beside) <= SYMMETRIC_TO_ROUNDING:
        return Verdict(
            False,
            f"symmetric up to rounding: its largest asymmetry relative to the rows is {beside:.2g}",
        )
    return Verdict(False, f"asymmetry {found:.2g} relative to entries, {beside:.2g} to rows")


@fact
def z_matrix(matrix: Matrix) -> Verdict:
    """No positive off-diagonal entry."""
    M = matrix.csr
    rows = row_numbers(M)
    positive = np.flatnonzero((M.data > 0.0) & (rows != M.indices))
    if positive.size == 0:
        return Verdict(True, "no positive off-diagonal entry")
    k = positive[0]
    return Verdict(False, f"M[{rows[k]}, {M.indices[k]}] = {M.data[k]:.6g} > 0")


@fact
def m_matrix(matrix: Matrix) -> Verdict:
    """M is a nonsingular M-matrix: Z and H₊."""
    is_z = z_matrix(matrix)
    return h_plus(matrix) if is_z.value else Verdict(False, f"no Z-matrix: {is_z.evidence}")


@fact
def strictly_dominant(matrix: Matrix) -> Verdict:
    """|m_ii| > Σ_j≠i |m_ij| on every row."""
    signs = row_excess_signs(matrix)
    if (signs > 0).all():
        return Verdict(True, "|m_ii| > Σ|m_ij| on every row, exactly")
    row = int(np.flatnonzero(signs <= 0)[0])
    return Verdict(False, f"|m_ii| {'=' if signs[row] == 0 else '<'} Σ|m_ij| on row {row}")


@fact
def h_matrix(matrix: Matrix) -> Verdict:
    """⟨M⟩ is a nonsingular M-matrix, for any signs of the diagonal."""
    return Verdict(h_verdict(matrix).is_h, h_verdict(matrix).evidence)


@fact
def h_plus(matrix: Matrix) -> Verdict:
    """M is an H-matrix with positive diagonal."""
    return _nonpositive_diagonal(matrix) or h_matrix(matrix)


@fact
def irreducible(matrix: Matrix) -> Verdict:
    """M has a strongly connected graph."""
    if diagonal_blocks(matrix)[0] <= 1:
        return Verdict(True, "the graph of M is strongly connected")
    return Verdict(False, f"{diagonal_blocks(matrix)[0]} strongly connected blocks")


@fact
def triangular(matrix: Matrix) -> Verdict:
    """Lower or upper triangular, or diagonal, in the given order."""
    form = triangular_form(matrix)
    return Verdict(form is not None, form or "entries on both sides of the diagonal")


@fact
def positive_definite(matrix: Matrix) -> Verdict:
    """xᵀM x > 0 for every x ≠ 0."""
    early = _nonpositive_diagonal(matrix) or _definite_by_comparison(matrix)
    if early is not None:
        return early
    what = "M" if symmetric(matrix).value else "the symmetric part of M"
    if not can_factorise(matrix):
        return Verdict(None, _too_large(matrix))
    value = is_positive_definite(symmetric_part_of(matrix)) if _is_well_rounded(matrix) else None
    if value is None and matrix.n <= EXACT_SIZE:
        value = has_positive_pivots(exact_symmetric_part(matrix.csr))
        return Verdict(value, f"exact elimination of {what}")
    if value is None:
        return Verdict(None, f"{UNDECIDED}: {what}")
    if value:
        return Verdict(
            True,
            f"{'SPD: ' if symmetric(matrix).value else ''}{what} has a Cholesky factor, with rounding margin",
        )
    return Verdict(False, f"{what} has no Cholesky factor, rounding margin included")


@fact
def positive_semidefinite(matrix: Matrix) -> Verdict:
    """xᵀM x ≥ 0 for every x: exactly up to n = 10; beyond, a singular M is undecided, with the δ in the evidence."""
    if (matrix.diagonal < 0.0).any():
        return _nonpositive_diagonal(matrix) or Verdict(False, "")
    if symmetric(matrix).value and (row_excess_signs(matrix) >= 0).all():
        return Verdict(True, "λ_min ≥ 0: symmetric, m_ii ≥ Σ|m_ij| on every row, exactly")
    definite = positive_definite(matrix)
    if definite.value:
        return Verdict(True, "λ_min > 0: positive definite")
    if not can_factorise(matrix):
        return Verdict(None, _too_large(matrix))
    part = symmetric_part_of(matrix)
    value = is_semidefinite_to_rounding(part) if _is_well_rounded(matrix) else None
    if value is not False and matrix.n <= EXACT_SIZE:
        what = (
            "exact elimination of M"
            if symmetric(matrix).value
            else "exact elimination of the symmetric part of M"
        )
        if has_nonnegative_pivots(exact_symmetric_part(matrix.csr)):
            return Verdict(True, f"λ_min ≥ 0: {what}")
        return Verdict(False, f"λ_min < 0: {what}")
    if value:
        delta = semidefinite_margin(part)
        return Verdict(None, f"undecided: λ_min ≥ −{delta:.3g}, below which the test cannot decide")
    if value is None and not _is_well_rounded(matrix):
        return Verdict(None, "undecided: the numbers are near the ends of the range of doubles")
    if value is None:
        return Verdict(None, f"not computed: rounding at n = {matrix.n} would hide too much")
    return Verdict(False, "a negative eigenvalue beyond rounding")


@fact
def p_matrix(matrix: Matrix) -> Verdict:
    """Every principal minor is positive."""
    early = _nonpositive_diagonal(matrix) or _p_by_class(matrix)
    if early is not None:
        return early
    if (pair := _nonpositive_pair(matrix)) is not None:
        return pair
    if matrix.n <= LARGEST_SIZE:
        value = is_p_matrix_by_recursion(matrix.csr)
        if value is not None:
            return Verdict(value, "recursive Schur complements in integers")
    definite = positive_definite(matrix)
    if definite.value:
        return Verdict(True, "every positive definite matrix is one")
    return Verdict(None, f"not computed: the minors of {matrix.n} rows are too many or too long")


def _p_by_class(matrix: Matrix) -> Verdict | None:
    """Decide by a class: triangular, H₊, Z (P is M), symmetric (P is positive definite)."""
    if triangular_form(matrix) is not None:
        return Verdict(True, "triangular with positive diagonal")
    h = h_plus(matrix)
    if h.value:
        return Verdict(True, "every H₊-matrix is one")
    if z_matrix(matrix).value and h.value is False:
        return Verdict(False, "a Z-matrix that is not an M-matrix")
    if symmetric(matrix).value:
        definite = positive_definite(matrix)
        return Verdict(definite.value, f"symmetric: {definite.evidence}")
    return None


def _nonpositive_diagonal(matrix: Matrix) -> Verdict | None:
    nonpositive = np.flatnonzero(matrix.diagonal <= 0.0)
    if nonpositive.size == 0:
        return None
    row = int(nonpositive[0])
    return Verdict(False, f"M[{row}, {row}] = {matrix.diagonal[row]:.6g}")


def _nonpositive_pair(matrix: Matrix) -> Verdict | None:
    pair = nonpositive_pair(matrix.csr)
    if pair is None:
        return None
    return Verdict(False, f"the principal minor of rows {pair[0]}, {pair[1]} is not positive")


def _definite_by_comparison(matrix: Matrix) -> Verdict | None:
    """Decide by theorems: symmetric H₊-matrices are SPD, symmetric Z-matrices that are not H₊ are not."""
    if symmetric(matrix).value:
        h = h_plus(matrix)
        if h.value:
            return Verdict(True, "SPD: symmetric and H₊")
        if h.value is False and z_matrix(matrix).value:
            return Verdict(False, "a symmetric Z-matrix that is not an M-matrix")
        return _nonpositive_pair(matrix)
    if not _has_dominant_symmetric_part(matrix):
        return None
    return Verdict(True, "the symmetric part is dominant, rounding included")


def _has_dominant_symmetric_part(matrix: Matrix) -> bool:
    """Return whether the row sums of ⟨(M + Mᵀ)/2⟩ are proven positive."""
    if not _is_well_rounded(matrix):
        return False
    # Each entry of the symmetric part was rounded once, subnormal ones absolutely; the margin must survive that.
    part = sp.csr_array(sparse_symmetric_part(matrix))
    outward = np.where(row_numbers(part) == part.indices, 1.0 - 4.0 * UNIT, 1.0 + 4.0 * UNIT)
    wider = sp.csr_array((part.data * outward, part.indices, part.indptr), shape=part.shape)
    margin = positive_margin(wider, np.ones(matrix.n))
    return margin is not None and bool((margin > 2.0 * TINY * matrix.n).all())


def _is_well_rounded(matrix: Matrix) -> bool:
    """Return whether the rounding of the symmetric part is small relative to the diagonal, and nothing overflows."""
    if symmetric(matrix).value:
        return True
    diagonal, entries = matrix.diagonal[matrix.diagonal > 0.0], matrix.csr.data
    return bool(
        (diagonal >= SMALLEST_DIAGONAL).all() and np.abs(entries).max(initial=0.0) < LARGEST_SUMMAND
    )


def _too_large(matrix: Matrix) -> str:
    return f"not computed: n = {matrix.n} is too large for a factorization"


@fact
def sparse_symmetric_part(matrix: Matrix) -> Any:
    """(M + Mᵀ)/2 as CSR, each entry rounded once."""
    if symmetric(matrix).value:
        return matrix.csr
    part = symmetric_part(matrix.csr)
    part.data.flags.writeable = False
    return part


def symmetric_part_of(matrix: Matrix) -> Any:
    """(M + Mᵀ)/2, dense where that is faster."""
    part = sparse_symmetric_part(matrix)
    return part.toarray() if matrix.n <= DENSE_LIMIT or matrix.is_dense else part


@fact
def can_factorise(matrix: Matrix) -> bool:
    """Return whether a factorization of the symmetric part is predicted to fit."""
    return factor_fits(sparse_symmetric_part(matrix))
