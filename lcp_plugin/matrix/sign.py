"""Is the sign of M right? A matrix whose diagonal is negative throughout is often meant to be its negative."""

from __future__ import annotations

from .h_matrix import h_verdict
from .matrix import Matrix, fact
from .verdicts import symmetric


@fact
def is_negative(matrix: Matrix) -> bool:
    """Whether every diagonal entry is negative, as of each negative definite matrix; not asked of rows on ranks."""
    return matrix.communicator.is_alone and matrix.n > 0 and bool((matrix.diagonal < 0.0).all())


@fact
def is_negated_m_matrix(matrix: Matrix) -> bool:
    """Whether −M is proved to be a nonsingular M-matrix."""
    has_signs = is_negative(matrix) and int((matrix.csr.data < 0.0).sum()) == matrix.n
    return has_signs and h_verdict(matrix).is_h is True


def sign_remark(matrix: Matrix) -> str:
    """Return what a negative diagonal suggests, '' where some diagonal entry is none.

    Examples
    --------
    >>> sign_remark(Matrix([[-2.0, 1.0], [1.0, -2.0]]))
    'every diagonal entry of M is negative (M[0, 0] = -2.0), and −M is a positive definite M-matrix: is its sign right?'
    >>> sign_remark(Matrix([[-2.0, 1.0], [1.0, 0.0]]))
    ''
    """
    if not is_negative(matrix):
        return ""
    known = ""
    if h_verdict(matrix).is_h:
        kind = "M-matrix" if is_negated_m_matrix(matrix) else "H₊-matrix"
        known = f", and −M is {'a positive definite' if symmetric(matrix).value else 'an'} {kind}"
    return f"every diagonal entry of M is negative (M[0, 0] = {matrix.diagonal[0]}){known}: is its sign right?"
