"""The verdicts of a report, one function each: what decides it, from cheap to costly, and the evidence in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.kernels.floats import TINY, UNIT
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.structure import IntVector, row_numbers, triangular_form
from ...systems.definiteness import (
    LARGEST_SUMMAND,
    is_positive_definite,
    is_semidefinite_to_rounding,
    positive_definite_solver,
    semidefinite_margin,
    symmetric_part,
)
from ...systems.factors import factor_fits
from ...systems.graph import block_rows, diagonal_blocks, row_excess_signs
from ...systems.symmetry import asymmetry, asymmetry_of_rows
from ..exact.linear_systems import (
    EXACT_SIZE,
    exact_symmetric_part,
    has_nonnegative_pivots,
    has_positive_pivots,
)
from ..exact.rational import integers
from .h_matrix import HCertificate, decide, h_verdict
from .p_matrix import LARGEST_SIZE, is_p_matrix_by_recursion, nonpositive_pair

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
            f"symmetric up to rounding: its largest asymmetry beside the rows is {beside:.2g}",
        )
    return Verdict(False, f"asymmetry {found:.2g} beside the entries, {beside:.2g} beside rows")


@fact
def z_matrix(matrix: Matrix) -> Verdict:
    """No positive entry beside the diagonal."""
    M = matrix.csr
    rows = row_numbers(M)
    positive = np.flatnonzero((M.data > 0.0) & (rows != M.indices))
    if positive.size == 0:
        return Verdict(True, "no positive entry beside the diagonal")
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
def irreducibly_dominant(matrix: Matrix) -> Verdict:
    """Irreducible, |m_ii| ≥ Σ_j≠i |m_ij| on every row and > on one at least."""
    signs = row_excess_signs(matrix)
    if (signs < 0).any():
        return Verdict(False, f"|m_ii| < Σ|m_ij| on row {int(np.flatnonzero(signs < 0)[0])}")
    if signs.size and not (signs > 0).any():
        return Verdict(False, "|m_ii| = Σ|m_ij| on every row")
    if not irreducible(matrix).value:
        return Verdict(False, f"reducible: {diagonal_blocks(matrix)[0]} strongly connected blocks")
    return Verdict(
        True,
        f"|m_ii| ≥ Σ|m_ij|, strictly on {int((signs > 0).sum())} of {signs.size} rows; irreducible",
    )


@fact
def h_matrix(matrix: Matrix) -> Verdict:
    """⟨M⟩ is a nonsingular M-matrix, whatever the signs of the diagonal."""
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
            f"{'SPD: ' if symmetric(matrix).value else ''}{what} factorises, rounding margin included",
        )
    return Verdict(False, f"{what} does not factorise, rounding margin included")


@fact
def positive_semidefinite(matrix: Matrix) -> Verdict:
    """xᵀM x ≥ 0 for every x: exactly up to n = 10; beyond, a singular M is undecided, with the δ in the evidence."""
    if (matrix.diagonal < 0.0).any():
        return _nonpositive_diagonal(matrix) or Verdict(False, "")
    if symmetric(matrix).value and (row_excess_signs(matrix) >= 0).all():
        return Verdict(True, "λ_min ≥ 0: symmetric, m_ii ≥ Σ|m_ij| on every row, exactly", 0.0)
    definite = positive_definite(matrix)
    if definite.value:
        return Verdict(True, "λ_min > 0: positive definite", 0.0)
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
            return Verdict(True, f"λ_min ≥ 0: {what}", 0.0)
        return Verdict(False, f"λ_min < 0: {what}")
    if value:
        delta = semidefinite_margin(part)
        return Verdict(
            None, f"undecided: λ_min ≥ −{delta:.3g}, up to which nothing can be said", delta
        )
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
    pair = nonpositive_pair(matrix.csr)
    if pair is not None:
        return Verdict(False, f"the principal minor of rows {pair[0]}, {pair[1]} is not positive")
    if not irreducible(matrix).value:
        return _p_by_blocks(matrix)
    if matrix.n <= LARGEST_SIZE:
        value = is_p_matrix_by_recursion(matrix.csr)
        how = "recursive Schur complements, rounding included"
        return Verdict(
            value,
            how if value is not None else f"undecided: a minor vanishes up to rounding ({how})",
        )
    definite = positive_definite(matrix)
    if definite.value:
        return Verdict(True, "every positive definite matrix is one")
    return Verdict(None, f"not computed: n = {matrix.n} > {LARGEST_SIZE}, the minors are too many")


def _p_by_class(matrix: Matrix) -> Verdict | None:
    """Where a class decides: triangular, H₊, Z (P is M), symmetric (P is positive definite)."""
    if triangular_form(matrix) is not None:
        return Verdict(True, "triangular with positive diagonal")
    h = h_plus(matrix)
    if h.value:
        return Verdict(True, "every H₊-matrix is one")
    if z_matrix(matrix).value and h.value is False:
        return Verdict(False, "a Z-matrix that is no M-matrix")
    if symmetric(matrix).value:
        definite = positive_definite(matrix)
        return Verdict(definite.value, f"symmetric: {definite.evidence}")
    return None


def _p_by_blocks(matrix: Matrix) -> Verdict:
    """M is P exactly if each strongly connected diagonal block is."""
    undecided: Verdict | None = None
    count, labels = diagonal_blocks(matrix)
    # A block of one row is positive.
    parts = [rows for rows in block_rows(labels, count) if rows.size > 1]
    if len(parts) > LARGEST_COUNT:
        return Verdict(None, f"not computed: {len(parts)} diagonal blocks are too many")
    for rows in parts:
        part = p_matrix(Matrix(sp.csr_array(matrix.csr[rows][:, rows])))
        if part.value is False:
            return Verdict(False, f"the diagonal block of row {rows[0]}: {part.evidence}")
        if part.value is None:
            undecided = part
    if undecided is not None:
        return Verdict(None, f"a diagonal block: {undecided.evidence}")
    return Verdict(True, f"each of {count} diagonal blocks is a P-matrix")


def _nonpositive_diagonal(matrix: Matrix) -> Verdict | None:
    nonpositive = np.flatnonzero(matrix.diagonal <= 0.0)
    if nonpositive.size == 0:
        return None
    row = int(nonpositive[0])
    return Verdict(False, f"M[{row}, {row}] = {matrix.diagonal[row]:.6g}")


def _definite_by_comparison(matrix: Matrix) -> Verdict | None:
    """Decide by theorems: symmetric H₊-matrices are SPD, symmetric Z-matrices that are no H₊ are not."""
    if symmetric(matrix).value:
        h = h_plus(matrix)
        if h.value:
            return Verdict(True, "SPD: symmetric and H₊")
        if h.value is False and z_matrix(matrix).value:
            return Verdict(False, "a symmetric Z-matrix that is no M-matrix")
        pair = nonpositive_pair(matrix.csr)
        if pair is not None:
            return Verdict(
                False, f"the principal minor of rows {pair[0]}, {pair[1]} is not positive"
            )
        return None
    if _symmetric_part_certificate(matrix) is None:
        return None
    return Verdict(True, "the symmetric part is H₊: ⟨·⟩v > 0 checked, rounding included")


@fact
def _symmetric_part_certificate(matrix: Matrix) -> HCertificate | None:
    """Return v > 0 with ⟨(M + Mᵀ)/2⟩v ≥ margin > 0, or None."""
    if not _is_well_rounded(matrix):
        return None
    # Each entry of the symmetric part was rounded once, subnormal ones absolutely; the margin must survive that.
    part = sp.csr_array(sparse_symmetric_part(matrix))
    outward = np.where(row_numbers(part) == part.indices, 1.0 - 4.0 * UNIT, 1.0 + 4.0 * UNIT)
    proof = decide(
        sp.csr_array((part.data * outward, part.indices, part.indptr), shape=part.shape), None
    ).certificate
    if proof is None:
        return None
    margin = proof.margin - 2.0 * TINY * float(proof.v.sum())
    return HCertificate(proof.v, margin) if bool((margin > 0.0).all()) else None


@np.errstate(all="ignore")  # what overflows proves nothing
def eigenvalue_proven(matrix: Matrix, exponents: IntVector) -> float | None:
    """Return a double below the smallest eigenvalue of C (M + Mᵀ)/2 C, C = diag(2^exponents); None where none is > 0.

    It is what `positive_definite` rests on: exact elimination; a v with ⟨·⟩v ≥ u > 0, so that no eigenvalue is below
    min c_i² u_i/v_i (Collatz–Wielandt); or a factorisation of the matrix scaled to a unit diagonal, less twice the
    margin for its rounding, n (k + 4) 2⁻⁵² ≥ 8 n 2⁻⁵³, of which it leaves 3 n 2⁻⁵³ at least.

    Examples
    --------
    >>> eigenvalue_proven(Matrix([[0.25, 0.1], [0.1, 0.04000000000000001]]), np.array([1, 2])) > 0.0
    True
    """
    if not positive_definite(matrix).value:
        return None
    if matrix.n <= EXACT_SIZE:
        return eigenvalue_below(matrix.csr, exponents.tolist()) or None
    squares, least = np.ldexp(1.0, 2 * exponents) * (1.0 - 8.0 * UNIT), 0.0
    is_symmetric = symmetric(matrix).value
    proof = h_verdict(matrix).certificate if is_symmetric else _symmetric_part_certificate(matrix)
    if proof is not None:
        least = float((squares * (proof.margin / proof.v)).min())
    elif (
        _is_well_rounded(matrix) and positive_definite_solver(symmetric_part_of(matrix)) is not None
    ):
        least = 3.0 * matrix.n * UNIT * float((squares * matrix.diagonal).min())
    return least if 0.0 < least < np.inf else None


def eigenvalue_below(M: Any, exponents: Sequence[int]) -> float:
    """Return a double below the smallest eigenvalue of C (M + Mᵀ)/2 C, C = diag(2^exponents), by at most a quarter.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        n ≤ EXACT_SIZE, its symmetric part positive definite.
    exponents : sequence of int, shape (n,)

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> eigenvalue_below(sp.csr_array([[4.0, 2.0], [2.0, 4.0]]), [0, -1])  # of [[4, 1], [1, 1]] (5 − √13)/2 = 0.697…
    0.625
    """
    entries, exponent = integers(M.toarray().ravel())
    n, least = M.shape[0], 2 * min(exponents)
    part = [
        [
            (entries[i * n + j] + entries[j * n + i]) << (exponents[i] + exponents[j] - least)
            for j in range(n)
        ]
        for i in range(n)
    ]

    def is_below(value: int, power: int) -> bool:
        above, shift = max(-power, 0), value << max(power, 0)
        return has_positive_pivots(
            [
                [(entry << above) - shift * (i == j) for j, entry in enumerate(row)]
                for i, row in enumerate(part)
            ]
        )

    high, step = (
        min(row[i] for i, row in enumerate(part)).bit_length(),
        1,
    )  # no eigenvalue exceeds a diagonal entry
    while not is_below(1, high - step):
        step *= 2
    low = high - step
    high -= step // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if is_below(1, middle) else (low, middle)
    value = next(value for value in (7, 6, 5, 4) if is_below(value, low - 2))
    return math.ldexp(value, low - 3 + exponent + least)


def _is_well_rounded(matrix: Matrix) -> bool:
    """Return whether the rounding of the symmetric part is small beside the diagonal, and nothing overflows."""
    if symmetric(matrix).value:
        return True
    diagonal, entries = matrix.diagonal[matrix.diagonal > 0.0], matrix.csr.data
    return bool(
        (diagonal >= SMALLEST_DIAGONAL).all() and np.abs(entries).max(initial=0.0) < LARGEST_SUMMAND
    )


def _too_large(matrix: Matrix) -> str:
    return f"not computed: n = {matrix.n} is too large for a factorisation"


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
    """Whether a factorisation of the symmetric part has its end in sight."""
    return factor_fits(sparse_symmetric_part(matrix))
