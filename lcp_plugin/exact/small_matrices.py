"""Small matrices in integer arithmetic: the last word where rounding hides the answer.

Doubles are dyadic numbers: a power of two makes a row integers and changes no sign of a principal minor. Elimination
without fractions (Bareiss) keeps them integers, each a minor of the matrix it began with.

References
----------
E. H. Bareiss, *Sylvester's identity and multistep integer-preserving Gaussian elimination*, Math. Comp. 22 (1968),
doi:10.1090/S0025-5718-1968-0226829-0.
"""

from __future__ import annotations

from typing import Any

EXACT_SIZE = 10  # rows; minors of doubles are long numbers
COMMON_DENOMINATOR = 2**1074

Rows = list[list[int]]


def exact_rows(M: Any) -> Rows:
    """Return the entries of a CSR array as integers, each row times a power of two."""
    return [_shortened(row) for row in _times_denominator(M)]


def exact_comparison(M: Any) -> Rows:
    """Return ⟨M⟩ as integers, each row times a power of two."""
    rows = exact_rows(M)
    return [[abs(entry) if i == j else -abs(entry) for j, entry in enumerate(row)] for i, row in enumerate(rows)]


def exact_symmetric_part(M: Any) -> Rows:
    """Return M + Mᵀ as integers, each row times a power of two."""
    rows = _times_denominator(M)
    return [_shortened([entry + rows[j][i] for j, entry in enumerate(row)]) for i, row in enumerate(rows)]


def _times_denominator(M: Any) -> Rows:
    ratios = [[float(entry).as_integer_ratio() for entry in row] for row in M.toarray()]
    return [[above * (COMMON_DENOMINATOR // below) for above, below in row] for row in ratios]


def _shortened(row: list[int]) -> list[int]:
    zeros = min(((entry & -entry).bit_length() - 1 for entry in row if entry), default=0)
    return [entry >> zeros for entry in row]


def has_positive_pivots(matrix: Rows) -> bool:
    """Return whether elimination without exchanges meets positive pivots only.

    For a symmetric matrix that means positive definite, for a Z-matrix a nonsingular M-matrix.
    """
    before = 1
    while matrix:
        pivot = matrix[0][0]
        if pivot <= 0:
            return False
        matrix, before = eliminated(matrix, before), pivot
    return True


def has_nonnegative_pivots(matrix: Rows) -> bool:
    """Return whether a symmetric matrix is positive semidefinite: a pivot of zero has nothing beside it."""
    before = 1
    while matrix:
        pivot = matrix[0][0]
        if pivot < 0 or (pivot == 0 and any(matrix[0])):
            return False
        matrix, before = (eliminated(matrix, before), pivot) if pivot else (_without_first(matrix), before)
    return True


def has_positive_minors(matrix: Rows, before: int = 1) -> bool:
    """Return whether all principal minors are positive; `before` is the pivot eliminated last."""
    if not matrix:
        return True
    pivot = matrix[0][0]
    if pivot <= 0:
        return False
    return has_positive_minors(_without_first(matrix), before) and has_positive_minors(
        eliminated(matrix, before), pivot
    )


def eliminated(matrix: Rows, before: int) -> Rows:
    """Return the Schur complement of the first pivot times that pivot, all of it divided by the pivot before."""
    top = matrix[0]
    return [
        [(top[0] * entry - row[0] * above) // before for entry, above in zip(row[1:], top[1:], strict=True)]
        for row in matrix[1:]
    ]


def _without_first(matrix: Rows) -> Rows:
    return [row[1:] for row in matrix[1:]]
