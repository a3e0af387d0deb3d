"""Small matrices in rational arithmetic: the last word where rounding hides the answer."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

EXACT_SIZE = 10  # rows; fractions of doubles are long numbers

Rows = list[list[Fraction]]


def exact_rows(M: Any) -> Rows:
    """Return the entries of a CSR array as fractions."""
    return [[Fraction(float(entry)) for entry in row] for row in M.toarray()]


def exact_comparison(M: Any) -> Rows:
    """Return ⟨M⟩ as fractions."""
    rows = exact_rows(M)
    return [[abs(entry) if i == j else -abs(entry) for j, entry in enumerate(row)] for i, row in enumerate(rows)]


def exact_symmetric_part(M: Any) -> Rows:
    """Return M + Mᵀ as fractions."""
    rows = exact_rows(M)
    return [[entry + rows[j][i] for j, entry in enumerate(row)] for i, row in enumerate(rows)]


def has_positive_pivots(matrix: Rows) -> bool:
    """Return whether elimination without exchanges meets positive pivots only.

    For a symmetric matrix that means positive definite, for a Z-matrix a nonsingular M-matrix.
    """
    while matrix:
        if matrix[0][0] <= 0:
            return False
        matrix = schur_complement(matrix)
    return True


def has_nonnegative_pivots(matrix: Rows) -> bool:
    """Return whether a symmetric matrix is positive semidefinite: a pivot of zero has nothing beside it."""
    while matrix:
        pivot = matrix[0][0]
        if pivot < 0 or (pivot == 0 and any(matrix[0])):
            return False
        matrix = schur_complement(matrix) if pivot else [row[1:] for row in matrix[1:]]
    return True


def has_positive_minors(matrix: Rows) -> bool:
    """Return whether all principal minors are positive."""
    if not matrix:
        return True
    if matrix[0][0] <= 0:
        return False
    return has_positive_minors([row[1:] for row in matrix[1:]]) and has_positive_minors(schur_complement(matrix))


def schur_complement(matrix: Rows) -> Rows:
    """Return the Schur complement of the first pivot, which is not zero."""
    top = matrix[0]
    return [
        [entry - row[0] * above / top[0] for entry, above in zip(row[1:], top[1:], strict=True)] for row in matrix[1:]
    ]
