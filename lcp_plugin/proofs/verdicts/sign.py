"""What a look at M tells: its classes in words; whether its sign is right.

A matrix whose diagonal is negative throughout is often meant to be its negative.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.structure import triangular_form
from .h_matrix import h_verdict
from .verdicts import symmetric, z_matrix


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


def classes_in_words(matrix: Matrix) -> str:
    """Return what one look at the entries tells of M; nothing where the rows are on several ranks.

    Examples
    --------
    >>> classes_in_words(Matrix([[2.0, -1.0], [-1.0, 2.0]]))
    'dense, symmetric, a Z-matrix, with positive diagonal'
    """
    return ", ".join(_classes(matrix))


def _classes(matrix: Matrix) -> Iterator[str]:
    if not matrix.communicator.is_alone:
        return
    yield "dense" if matrix.is_dense else "sparse"
    if symmetric(matrix).value:
        yield "symmetric"
    if (form := triangular_form(matrix)) is not None:
        yield form if form == "diagonal" else f"{form} triangular"
    if z_matrix(matrix).value:
        yield "a Z-matrix"
    yield "with positive diagonal" if (matrix.diagonal > 0.0).all() else "with a diagonal not everywhere positive"
