"""The derivative of a solution by the data of its problem: a linear solve on the free rows.

Within one active set z is smooth in M, q and the bounds. F: strictly between the bounds; A: at a bound with w ≠ 0.

    M_FF dz_F = −(dM z + dq)_F − M_FA db_A,    dz_A = db_A          (b the bound that holds)

and for a function L of z, g = ∂L/∂z: M_FFᵀ λ_F = g_F, λ_A = 0, and ∂L/∂q = −λ, ∂L/∂m_ij = −λ_i z_j,
∂L/∂b_A = g_A − (Mᵀλ)_A. Where a row is at a bound *and* has w = 0 it is degenerate, and z has one-sided derivatives,
each the solution of a small LCP on those rows.

References
----------
J. S. Pang, D. Ralph, *Piecewise smoothness, local invertibility, and parametric analysis of normal maps*,
Math. Oper. Res. 21 (1996), doi:10.1287/moor.21.2.401.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..certificates.active_rows import ActiveRows, proven_rows, settled_rows
from ..certificates.error_bounds import ErrorBound, error_bound
from ..checks import BoolVector, FloatVector, finite_vector, rectangular_matrix
from ..errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ..matrix.free_systems import FreeSystem
from ..matrix.structure import row_numbers
from ..problem.lcp import LCP
from .driver import solve
from .result import Result


class Gradient(NamedTuple):
    """What a function of the solution has for gradients.

    Attributes
    ----------
    q, lower, upper : ndarray, shape (n,)
        By the entries of q and of the bounds; 0 for a bound that does not hold. Where lower = upper, the gradient
        belongs to the bound that the sign of w asks for; where both move together their sum counts.
    M : csr_array, shape (n, n)
        By the entries that M has, in their places.
    """

    q: FloatVector
    lower: FloatVector
    upper: FloatVector
    M: sp.csr_array


def derivative(result: Result) -> Derivative:
    """Return the derivative of the solution z of an LCP by M, q and the bounds.

    Parameters
    ----------
    result : Result
        SOLVED. What its run has built (the hierarchy of M) serves again.

    Returns
    -------
    Derivative
        Nothing is computed before it is asked for.

    Raises
    ------
    UnsuitableProblem
        Where the result is not SOLVED.
    InvalidOption
        Where it is no Result.

    Examples
    --------
    >>> from lcp_plugin import LCP, solve
    >>> found = derivative(solve(LCP([[2, 1], [1, 2]], [-5, 1])))
    >>> found.jvp(dq=[1, 0]), found.is_unique
    (array([-0.5,  0. ]), True)
    >>> gradient = found.vjp([1, 1])
    >>> gradient.q, gradient.lower
    (array([-0.5,  0. ]), array([0. , 0.5]))
    >>> gradient.M.toarray()
    array([[-1.25,  0.  ],
           [ 0.  ,  0.  ]])
    """
    if not isinstance(result, Result):
        raise InvalidOption(
            f"derivative needs the Result of a solve, got {type(result).__name__}; write derivative(solve(problem))"
        )
    if not result.is_solved:
        raise UnsuitableProblem(
            f"only a solution has a derivative, and this run ended {result.status.name}: {result.advice}"
        )
    return Derivative(result.certificate.problem, result.z, result.w)


class Derivative:
    """The derivative of z by the data, at one solution.

    Parameters
    ----------
    problem : LCP
    z, w : array, shape (n,)
        Its solution and slack.

    Notes
    -----
    The solution is solved for once more on its free rows, with w in twice the working precision, so that rows are
    told apart and ∂z/∂M is taken at the solution of the stored doubles, not at a z within the tolerance of it.
    """

    def __init__(self, problem: LCP, z: FloatVector, w: FloatVector) -> None:
        self.problem = problem
        self._found = z, w

    @cached_property
    def _rows(self) -> ActiveRows:
        return settled_rows(self.problem, *self._found)

    @property
    def z(self) -> FloatVector:
        """The solution at which the derivative is taken, shape (n,)."""
        return self._rows.z

    @property
    def free(self) -> BoolVector:
        """The rows that `vjp` takes as free, shape (n,); degenerate rows are held where that leaves a regular block."""
        return self._system.free

    @property
    def degenerate(self) -> NDArray[np.intp]:
        """The rows that are at a bound and have w = 0, as far as rounding of the data can tell."""
        return np.flatnonzero(self._rows.degenerate)

    @cached_property
    def bound(self) -> ErrorBound | None:
        """The error bound of z, None where M allows none."""
        try:
            return error_bound(self.problem, self.z)
        except UnsuitableMatrix:
            return None

    @cached_property
    def is_unique(self) -> bool | None:
        """Whether the derivative exists, so that jvp is linear and vjp the only gradient.

        True where a rigorous error bound proves of every row that it is strictly between its bounds, or at one with
        w ≠ 0. False where rows are degenerate, None where neither is known.
        """
        if self._rows.degenerate.any():
            return False
        bound = self.bound
        if bound is None or bound.kind != "rigorous":
            return None
        held, between = proven_rows(self.problem, bound)
        return True if self.problem.peers.everywhere(bool((held | between).all())) else None

    @cached_property
    def _system(self) -> FreeSystem:
        """The system of the free rows; where it is singular without the degenerate ones, of those as well."""
        rows = self._rows
        if rows.system is not None and np.array_equal(rows.system.free, rows.free):
            return rows.system
        system = FreeSystem(self.problem.matrix, rows.free)
        if rows.degenerate.any() and system.is_singular:
            return FreeSystem(self.problem.matrix, rows.free | rows.degenerate)
        return system

    def jvp(
        self, *, dM: Any = None, dq: ArrayLike | None = None, dlower: ArrayLike | None = None,
        dupper: ArrayLike | None = None,
    ) -> FloatVector:
        """Return how z changes with the data, dz; one-sided where rows are degenerate.

        Parameters
        ----------
        dM : array or sparse array, shape (n, n), optional
            The change of M, on any pattern.
        dq : array, shape (n,), optional
        dlower, dupper : number or array, shape (n,), optional
            The change of the bounds; only those that hold matter.

        Returns
        -------
        array, shape (n,)
            In the unit of z over that of the change.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        UnsuitableProblem
            Where the block of M on the free rows is singular, or no one-sided derivative exists.

        Examples
        --------
        >>> from lcp_plugin import LCP, solve
        >>> kink = derivative(solve(LCP([[2.0]], [0.0])))
        >>> kink.is_unique, kink.degenerate, kink.jvp(dq=[-1.0]), kink.jvp(dq=[1.0])
        (False, array([0]), array([0.5]), array([0.]))
        """
        h, dlower, dupper = self._change(dM, dq), self._moved(dlower, "dlower"), self._moved(dupper, "dupper")
        rows = self._rows
        if rows.degenerate.any():
            return _one_sided(self.problem, rows, h, dlower, dupper)
        dz = np.where(rows.at_lower, dlower, np.where(rows.at_upper, dupper, 0.0))
        matrix = self.problem.matrix
        right = -h
        if dz.any():
            right -= matrix.rows @ matrix.whole(dz)
        return dz + _solution(self._system, right)

    def dw(self, dz: ArrayLike, *, dM: Any = None, dq: ArrayLike | None = None) -> FloatVector:
        """Return the change of w = M z + q that goes with a change dz of z, shape (n,)."""
        matrix = self.problem.matrix
        product: FloatVector = matrix.rows @ matrix.whole(finite_vector(dz, "dz", self.problem.own))
        return product + self._change(dM, dq)

    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> Gradient:
        """Return the gradients of a function L(z, w) by q, the bounds and the entries of M.

        Where rows are degenerate, this is the gradient of one of the pieces that meet there (an element of the
        B-subdifferential): that on which the rows in `free` are free.

        Parameters
        ----------
        g : array, shape (n,)
            ∂L/∂z.
        gw : array, shape (n,), optional
            ∂L/∂w.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        UnsuitableProblem
            Where the block of M on the free rows is singular.
        """
        problem = self.problem
        g = finite_vector(g, "g", problem.own)
        by_w = np.zeros(problem.own) if gw is None else finite_vector(gw, "gw", problem.own)
        if by_w.any():
            g = g + self._transposed_product(by_w)
        rows, free = self._rows, self.free
        multiplier = by_w - _solution(self._system, g, transposed=True)
        by_bound = np.where(free, 0.0, g - self._transposed_product(by_w - multiplier))
        return Gradient(
            multiplier, np.where(rows.is_upper, 0.0, by_bound), np.where(rows.is_upper, by_bound, 0.0),
            _on_pattern(problem, multiplier, self.z),
        )

    def _change(self, dM: Any, dq: ArrayLike | None) -> FloatVector:
        """Return dM z + dq."""
        n = self.problem.own
        h = np.zeros(n) if dq is None else finite_vector(dq, "dq", n).copy()
        if dM is not None:
            self.problem.matrix.require_all_rows()
            h += rectangular_matrix(dM, "dM", n, n) @ self.z
        return h

    def _moved(self, change: ArrayLike | None, name: str) -> FloatVector:
        if change is None or np.ndim(change) == 0:
            change = np.full(self.problem.own, 0.0 if change is None else change)
        return finite_vector(change, name, self.problem.own)

    def _transposed_product(self, x: FloatVector) -> FloatVector:
        """Return Mᵀx."""
        matrix = self.problem.matrix
        if not x.any():
            return np.zeros(x.size)
        product: FloatVector = matrix.array.T @ x
        return product


def _solution(system: FreeSystem, right: FloatVector, *, transposed: bool = False) -> FloatVector:
    x = system.solve(right, transposed=transposed)
    if x is None:
        raise UnsuitableProblem(
            "the block of M on the free rows is singular to working precision, or too large for a factor where "
            "multigrid fails: z has no derivative that could be computed; regularise M, or fix what is not determined"
        )
    return x


def _on_pattern(problem: LCP, left: FloatVector, right: FloatVector) -> sp.csr_array:
    """Return left_i right_j in the places of M's entries."""
    rows, matrix = problem.matrix.csr_rows, problem.matrix
    data = left[row_numbers(rows)] * matrix.whole(right)[rows.indices]
    return sp.csr_array((data, rows.indices, rows.indptr), shape=rows.shape)


def _one_sided(
    problem: LCP, rows: ActiveRows, h: FloatVector, dlower: FloatVector, dupper: FloatVector
) -> FloatVector:
    """Return the one-sided derivative: the solution of an LCP on the free and the degenerate rows.

    d = db on the rows that are held, (M d + h)_i = 0 on the free ones; on a degenerate one at its lower bound d ≥ db,
    (M d + h) ≥ 0, complementary, and the mirror image at an upper bound.
    """
    moved = np.where(rows.is_upper, dupper, dlower)
    lower = np.where(rows.free | (rows.degenerate & rows.is_upper), -np.inf, moved)
    upper = np.where(rows.free | (rows.degenerate & ~rows.is_upper), np.inf, moved)
    part = np.flatnonzero(rows.free | rows.degenerate)
    dz = np.where(rows.at_lower | rows.at_upper, moved, 0.0)
    M = problem.M
    block = M[part][:, part] if sp.issparse(M) else M[np.ix_(part, part)]
    small = LCP(block, (h + M @ dz)[part], lower=lower[part], upper=upper[part])
    result = solve(small)
    if not result.is_solved:
        raise UnsuitableProblem(
            f"{part.size} free and degenerate rows have no one-sided derivative that could be found: their LCP ended "
            f"{result.status.name}; the block of M on them is no P-matrix, and z may jump or have branches"
        )
    dz[part] = settled_rows(small, result.z, result.w).z
    return dz
