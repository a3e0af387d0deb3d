"""Least squares within bounds as linear complementarity problems.

:func:`lcp_plugin.problems.least_squares.solving.bounded_least_squares` is the solver for them. These are for who has
methods for complementarity, or a model that goes on from there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import FloatVector, checked_answer
from ...core.errors import InvalidOption, UnsuitableProblem, did_you_mean
from ...core.lcp import LCP
from ...core.matrix.structure import IntVector
from .data import BoundedLeastSquares

FORMS = ("normal", "mixed", "auto")


@dataclass(frozen=True, eq=False)
class LeastSquaresSolution:
    """A point x of a least squares problem; names as in ``LeastSquaresResult``.

    Attributes
    ----------
    problem : BoundedLeastSquares
        The data.
    x : ndarray, shape (n,)
        Within the bounds.
    """

    problem: BoundedLeastSquares = field(repr=False)
    x: FloatVector

    @cached_property
    def fun(self) -> FloatVector:
        """The residual A x − b, without weights, shape (m,)."""
        return self.problem.product(self.x) - self.problem.b

    @cached_property
    def cost(self) -> float:
        """½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x|."""
        return self.problem.cost(self.x, self.fun)


@dataclass(frozen=True, eq=False)
class LeastSquaresOrigin:
    """Where a problem came from; form "normal" or "mixed"."""

    problem: BoundedLeastSquares
    form: str

    def recover(self, answer: Any) -> LeastSquaresSolution:
        """Return the x that an answer of the complementarity problem stands for.

        Parameters
        ----------
        answer : Result or array, shape (N,)
            Of the complementarity problem; the first n of its unknowns are x.

        Raises
        ------
        InvalidProblem
            Where it is no finite vector of that length.
        """
        m, n = self.problem.shape
        z = checked_answer(
            answer, (n + m if self.form == "mixed" else n) + kinks(self.problem).size
        )
        return LeastSquaresSolution(
            self.problem, np.clip(z[:n], self.problem.lower, self.problem.upper)
        )


def lcp_from_least_squares(
    A: Any,
    b: ArrayLike,
    lower: ArrayLike = 0.0,
    upper: ArrayLike = np.inf,
    *,
    weights: ArrayLike | None = None,
    ridge: float = 0.0,
    l1: ArrayLike = 0.0,
    form: str = "auto",
) -> LCP:
    """Return least squares with bounds, weights, a ridge and an l1 penalty as a complementarity problem.

    Parameters
    ----------
    A : array or sparse array, shape (m, n)
        Real, finite.
    b : array, shape (m,)
    lower, upper : scalar or array, shape (n,)
    weights : array, shape (m,), optional
        ≥ 0; 1 by default. W is the diagonal matrix of them.
    ridge : float
        ≥ 0.
    l1 : number or array, shape (n,)
        ≥ 0. Where a column may take both signs, the subgradient s ∈ [−l1, l1] of its penalty is an unknown
        behind the others, with w = −x; elsewhere the penalty is linear and no more than a part of q.
    form : {"auto", "normal", "mixed"}
        - normal: M = AᵀWA + ridge I, q = −AᵀWb, z = x; n rows, symmetric positive semidefinite. Its condition is that
          of A squared.
        - mixed: z = (x, r), r = √W(b − A x) free, M = [[ridge I, −Aᵀ√W], [√W A, I]], q = (0, −√W b); n + m rows,
          monotone, as sparse and about as well-conditioned as A.

        auto: normal where AᵀA has surely no more entries than the mixed M, and doubles hold it, else mixed.

    Returns
    -------
    LCP
        Its ``origin.recover(result)`` gives a :class:`LeastSquaresSolution`.

    Raises
    ------
    InvalidProblem, InvalidOption
        Where the data do not state such a problem; an unknown form.
    UnsuitableProblem
        A is a LinearOperator; form="normal", but AᵀWA overflows or vanishes.

    Notes
    -----
    An LCP keeps the entries of M, not a product of factors: sweeps run along its rows, w is enclosed row by row for the
    proof that SOLVED is, factors need its pattern. Where AᵀA is too large or too ill-conditioned for that, the mixed
    form says the same with the entries of A.

    Examples
    --------
    >>> from lcp_plugin import solve
    >>> problem = lcp_from_least_squares([[1, 0], [1, 1], [0, 1]], [2, 1, -1])
    >>> print(problem, problem.origin.form)
    LCP(n=2, nonzeros=4, bounds 0 ≤ z) normal
    >>> solution = problem.origin.recover(solve(problem))
    >>> solution.x, solution.cost
    (array([1.5, 0. ]), 0.75)
    """
    if form not in FORMS:
        raise InvalidOption(f"form={form!r} is not offered{did_you_mean(form, FORMS)}")
    stated = BoundedLeastSquares(A, b, lower, upper, weights=weights, ridge=ridge, l1=l1)
    if not stated.has_entries:
        raise UnsuitableProblem(
            "an LCP has entries, a LinearOperator has none; use bounded_least_squares(A, b)"
        )
    m, n = stated.shape
    root, rows = stated.root_weights, sp.csr_array(stated.A)
    scaled = sp.csr_array(sp.diags_array(root, shape=(m, m)) @ rows)
    has_squares = _has_squares(scaled)
    if form == "auto":
        per_row = np.diff(rows.indptr).astype(np.int64)
        most = int(min(n**2, per_row @ per_row))  # entries of AᵀA
        form = "normal" if has_squares and most <= 2 * rows.nnz + m + n else "mixed"
    if form == "normal" and not has_squares:
        raise UnsuitableProblem(
            'squares of entries of A overflow, or vanish; use form="mixed", or rescale A and b'
        )
    if form == "normal":
        dense = stated.A * root[:, None] if stated.is_dense else scaled
        ridges = np.full(n, stated.ridge)
        M = dense.T @ dense + (
            np.diag(ridges) if stated.is_dense else sp.diags_array(ridges, shape=(n, n))
        )
        q, below, above = -stated.transposed(stated.weighted(stated.b)), stated.lower, stated.upper
    else:
        ridges, ones = sp.eye_array(n) * stated.ridge, sp.eye_array(m)
        M = sp.block_array([[ridges, -scaled.T], [scaled, ones]], format="csr")
        free = np.full(m, np.inf)
        q = np.concatenate([np.zeros(n), -root * stated.b])
        below, above = np.concatenate([stated.lower, -free]), np.concatenate([stated.upper, free])
    problem = LCP(*_with_penalty(stated, M, q), **_bounds_with_penalty(stated, below, above))
    problem.origin = LeastSquaresOrigin(stated, form)
    return problem


def kinks(problem: BoundedLeastSquares) -> IntVector:
    """Return the columns with a penalty that may take both signs, where that is no linear term."""
    return np.flatnonzero((problem.l1 > 0.0) & (problem.lower < 0.0) & (problem.upper > 0.0))


def _with_penalty(problem: BoundedLeastSquares, M: Any, q: FloatVector) -> tuple[Any, FloatVector]:
    """Return M and q with what the penalty adds: a linear term, or a row and a column for each kink."""
    columns, n = kinks(problem), problem.shape[1]
    linear = np.where(problem.upper <= 0.0, -problem.l1, problem.l1)
    linear[columns] = 0.0
    q = q.copy()
    q[:n] += linear
    if not columns.size:
        return M, q
    k = columns.size
    beside = sp.csr_array((np.ones(k), (columns, np.arange(k))), shape=(q.size, k))
    M = sp.block_array([[sp.csr_array(M), beside], [-beside.T, None]], format="csr")
    return M, np.concatenate([q, np.zeros(k)])


def _bounds_with_penalty(
    problem: BoundedLeastSquares, below: FloatVector, above: FloatVector
) -> dict[str, Any]:
    l1 = problem.l1[kinks(problem)]
    return {"lower": np.concatenate([below, -l1]), "upper": np.concatenate([above, l1])}


def _has_squares(rows: sp.csr_array) -> bool:
    """Return whether no column that is not zero has a sum of squares that overflows, or vanishes."""
    with np.errstate(over="ignore", under="ignore"):
        squares = np.bincount(rows.indices, rows.data**2, minlength=rows.shape[1])
    filled = np.bincount(rows.indices, np.abs(rows.data), minlength=rows.shape[1]) > 0.0
    return bool(np.isfinite(squares).all() and (squares[filled] >= np.finfo(np.float64).tiny).all())
