"""Absolute value equations A x + B |x| = b as linear complementarity problems."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import FloatVector, checked_answer, checked_vector, rectangular_matrix
from ...core.errors import InvalidOption, UnsuitableMatrix, did_you_mean
from ...core.lcp import LCP

FORMS = ("plain", "mixed")
SINGULAR_BELOW = 1e-14  # reciprocal condition number


@dataclass(frozen=True, eq=False)
class AbsoluteValueSolution:
    """A point x and how far it is from A x + B |x| = b.

    Attributes
    ----------
    origin : AbsoluteValueOrigin
        Holds A, B and b.
    x : ndarray, shape (n,)
    """

    origin: AbsoluteValueOrigin = field(repr=False)
    x: FloatVector

    @cached_property
    def residual(self) -> float:
        """‖A x + B |x| − b‖∞ relative to 1 + the largest of A x, B |x| and b."""
        origin = self.origin
        terms = [origin.A @ self.x, origin.B @ np.abs(self.x), -origin.b]
        size = np.max([np.abs(term).max(initial=0.0) for term in terms])
        return float(np.abs(np.sum(terms, axis=0)).max(initial=0.0) / (1.0 + size))


@dataclass(frozen=True, eq=False)
class AbsoluteValueOrigin:
    """Where a problem came from: A x + B |x| = b; form "plain" or "mixed"."""

    A: Any
    B: Any
    b: FloatVector
    form: str

    def recover(self, answer: Any) -> AbsoluteValueSolution:
        """Return the x that an answer of the complementarity problem stands for.

        Parameters
        ----------
        answer : Result or array, shape (n,) in the form "plain", (2n,) in the form "mixed"

        Raises
        ------
        InvalidProblem
            Where it is no finite vector of that length.
        """
        n = self.b.size
        if self.form == "mixed":
            return AbsoluteValueSolution(self, checked_answer(answer, 2 * n)[:n])
        z = checked_answer(answer, n)
        # z is x⁻, and x⁺ = w from its definition, so that an error in z is not hidden by rounding in M.
        return AbsoluteValueSolution(
            self, np.linalg.solve(_dense(self.A + self.B), self._right(z)) - z
        )

    def _right(self, z: FloatVector) -> FloatVector:
        right: FloatVector = (self.A - self.B) @ z + self.b
        return right


def lcp_from_absolute_value(A: Any, b: ArrayLike, B: Any = None, form: str = "plain") -> LCP:
    """Return the complementarity problem equivalent to A x + B |x| = b; by default A x − |x| = b.

    With x = w − z and |x| = w + z, w and z complementary, the equation says (A + B) w = (A − B) z + b.

    Parameters
    ----------
    A : array or sparse array, shape (n, n)
        Real, finite.
    b : array, shape (n,)
    B : array or sparse array, shape (n, n), optional
        −I by default.
    form : {"plain", "mixed"}
        - plain: M = (A + B)⁻¹(A − B), q = (A + B)⁻¹b; n rows, z = max(−x, 0). Needs A + B regular, which for B = −I
          says that 1 is no eigenvalue of A. M is dense.
        - mixed: z = (x, max(−x, 0)), M = [[A + B, 2B], [I, I]], q = (−b, 0), x free; 2n rows, no condition, sparse
          where A and B are.

    Returns
    -------
    LCP
        Its ``origin.recover(result)`` gives an :class:`AbsoluteValueSolution`.

    Raises
    ------
    InvalidProblem
        Where the data do not state such an equation.
    UnsuitableMatrix
        form="plain" and A + B is singular to working precision.
    InvalidOption
        An unknown form.

    Notes
    -----
    B = −I: where all singular values of A exceed 1 there is exactly one solution for every b, and the plain M is
    positive definite, for zᵀM z = ‖A v‖² − ‖v‖² with z = (A − I) v.

    References
    ----------
    O. L. Mangasarian, R. R. Meyer, *Absolute value equations*, Linear Algebra and its Applications 419 (2006).

    Examples
    --------
    3 x − |x| = −8 at x = −2:

    >>> problem = lcp_from_absolute_value([[3]], [-8])
    >>> problem.M, problem.q
    (array([[2.]]), array([-4.]))
    >>> problem.origin.recover([2.0])
    AbsoluteValueSolution(x=array([-2.]))
    """
    if not isinstance(form, str) or form not in FORMS:
        raise InvalidOption(f"form={form!r} is not offered{did_you_mean(form, FORMS)}")
    right = checked_vector(b, "b", None)
    n = right.size
    first = rectangular_matrix(A, "A", n, n)
    identity = sp.eye_array(n, format="csr") if sp.issparse(first) else np.eye(n)
    second = rectangular_matrix(-identity if B is None else B, "B", n, n)
    if form == "mixed":
        both, unit = sp.csr_array(first + second), sp.eye_array(n, format="csr")
        M = sp.block_array([[both, sp.csr_array(2.0 * second)], [unit, unit]], format="csr")
        problem = LCP(M, np.concatenate([-right, np.zeros(n)]), lower=np.repeat([-np.inf, 0.0], n))
    else:
        columns = _solved(_dense(first + second), np.column_stack([_dense(first - second), right]))
        problem = LCP(columns[:, :n], columns[:, n])
    problem.origin = AbsoluteValueOrigin(first, second, right, form)
    return problem


def _solved(matrix: Any, right: Any) -> Any:
    """Return matrix⁻¹ right, or refuse a matrix that is singular to working precision."""
    size = matrix.shape[0]
    if size == 0:
        return right
    factor, pivots, failed = scipy.linalg.lapack.dgetrf(matrix)
    reciprocal = 0.0
    if not failed:
        reciprocal, _ = scipy.linalg.lapack.dgecon(factor, np.abs(matrix).sum(axis=0).max())
    if reciprocal < SINGULAR_BELOW:
        raise UnsuitableMatrix(
            f"A + B is singular to working precision (reciprocal condition {reciprocal:.1e}; for B = −I: 1 is an "
            'eigenvalue of A); use form="mixed"'
        )
    return scipy.linalg.lu_solve((factor, pivots), right)


def _dense(matrix: Any) -> Any:
    return matrix.toarray() if sp.issparse(matrix) else np.asarray(matrix)
