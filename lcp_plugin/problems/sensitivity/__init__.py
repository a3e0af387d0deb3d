"""The derivative of a solution by the data of its problem, as :mod:`lcp_plugin.systems.linearized` states it.

Within one active set z is smooth in M, q and the bounds: the free rows are those strictly between their bounds, others
at one with w ≠ 0. If a row is at a bound *and* has w = 0 it is degenerate, and z has one-sided derivatives, each the
solution of a small LCP on the free and the degenerate rows.

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

from ...core.checks import BoolVector, FloatVector, finite_vector, rectangular_matrix
from ...core.errors import InvalidOption, UnsuitableProblem
from ...core.lcp import LCP
from ...core.problem_classes import refusal
from ...core.solving.result import Result
from ...proofs.bounds.active_rows import ActiveRows, settled_rows
from ...systems.free_systems import FreeSystem
from ...systems.graph import outer_on_pattern
from ...systems.linearized import LinearizedSystem
from ..batches.batch_run import BatchAnswers
from ..batches.stated import Listed, Stacked
from ..batches.worlds import Worlds
from ..cones.derivative import ConeDerivative
from ..cones.solving import ConeResult
from ..march import March
from ..march.march_derivative import MarchDerivative
from .batch_derivative import BatchDerivative
from .contact_batch_derivative import ContactBatchDerivative
from .free_solutions import one_sided, solution, words_on_singular


class Gradient(NamedTuple):
    """Gradient of a function of the solution, with respect to the data of the problem.

    Attributes
    ----------
    q, lower, upper : ndarray, shape (n,)
        By the entries of q and of the bounds; 0 for a bound that does not hold. If lower = upper, the gradient
        belongs to the bound that the sign of w asks for; where both move together their sum counts.
    M : csr_array, shape (n, n)
        By the entries that M has, in their places.
    """

    q: FloatVector
    lower: FloatVector
    upper: FloatVector
    M: sp.csr_array


@np.errstate(under="ignore")
def derivative(result: Any) -> Any:
    """Return the derivative of the solution of an LCP, a batch or steps in time with respect to the data.

    For a cvxpy problem with complementarities, solved by ``method="LCP"``, the derivative is with respect to its
    parameters; see ``help("lcp_plugin.modeling")``.

    Parameters
    ----------
    result : Result or BatchAnswers or March
        SOLVED, of an LCP; or of a NonlinearProblem, for which dq is a change of F. The hierarchy of M that the run has
        built is used again, and M is not copied: do not change its entries between the solve and this call.
        For cones see :class:`~lcp_plugin.problems.cones.derivative.ConeDerivative`.

    Returns
    -------
    Derivative or BatchDerivative or ContactBatchDerivative or MarchDerivative
        All quantities are computed on first access. ``errors`` of a batch derivative lists the problems without one.

    Raises
    ------
    UnsuitableProblem
        If a Result is not SOLVED, or a march was not solved to its end.
    InvalidOption
        If it is none of these, or a march over cones: use ``derivative(done[k])`` for each step. For a list of problems
        over cones use ``derivative(answers[k])``.

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
    if isinstance(result, BatchAnswers):
        return _derivative_of_batch(result)
    if isinstance(result, March):
        if not isinstance(result.problem, LCP):
            raise InvalidOption(
                "no derivative leads through a march over cones; write derivative(done[k]) for that of step k by its q"
            )
        return MarchDerivative(result, Derivative)
    if type(result).__module__.startswith("cvxpy."):
        from ...modeling.model_derivative import derivative_of

        return derivative_of(result)
    if not isinstance(result, Result):
        raise InvalidOption(refusal("derivative", result))
    if not result.is_solved:
        why = f"this run ended {result.status.name}: {result.advice}"
        raise UnsuitableProblem(f"only a solution has a derivative, and {why}")
    if isinstance(result, ConeResult):
        return ConeDerivative(result.problem, result.z)
    certificate = result.certificate
    return Derivative(
        certificate.problem, result.z, result.w, is_linearised=certificate.is_linearised
    )


def _derivative_of_batch(batch: BatchAnswers) -> BatchDerivative | ContactBatchDerivative:
    problems = batch.problems
    if isinstance(problems, Worlds):
        return ContactBatchDerivative(batch, derivative)
    are_lcps = isinstance(problems, Stacked) or (isinstance(problems, Listed) and problems.are_lcps)
    if are_lcps and isinstance(batch.z, np.ndarray):
        return BatchDerivative(batch, derivative)
    of_one_size = "the derivative of a batch takes problems of one size"
    need = of_one_size if are_lcps else refusal("derivative", batch)
    raise InvalidOption(f"{need}; write [derivative(answer) for answer in batch]")


class Derivative(LinearizedSystem):
    """The derivative of a solution z with respect to the data of its problem.

    Parameters
    ----------
    problem : LCP
    z, w : array, shape (n,)
        Its solution and slack.
    is_linearised : bool
        Whether the problem is a nonlinear one near z: a change dF of F is dq then, and nothing is proved.
    before : Derivative, optional
        Of a problem with the same M: its factor serves again.

    Notes
    -----
    The solution is solved for again on its free rows, with w in twice the working precision, so that rows are
    told apart and ∂z/∂M is taken at the solution of the stored doubles, not at a z within the tolerance of it.

    Where M is singular on the free rows, z is one of several solutions, and the derivative that of the least change,
    in the scaling that M needs: by the Moore–Penrose inverse of at most 500 rows. What all solutions share, as
    the velocities of contacts whose impulses are not determined, has the derivative by it that all of them give.

    There is no dM there, no vjp where M is not symmetric, and no jvp where rows are degenerate.
    """

    def __init__(
        self,
        problem: LCP,
        z: FloatVector,
        w: FloatVector,
        *,
        is_linearised: bool = False,
        before: Derivative | None = None,
    ) -> None:
        self.problem, self.is_linearised = problem, is_linearised
        self._found = z, w, None if before is None else before._rows.system

    @cached_property
    def _rows(self) -> ActiveRows:
        return settled_rows(self.problem, *self._found)

    @property
    def z(self) -> FloatVector:
        """The solution at which the derivative is taken, shape (n,)."""
        return self._rows.z

    @property
    def free(self) -> BoolVector:
        """The rows that `vjp` takes as free, shape (n,); degenerate ones only if they make the block regular."""
        return self._system.free

    @property
    def degenerate(self) -> NDArray[np.intp]:
        """The rows that are at a bound and have w = 0, as far as rounding of the data can tell.

        Rows that only give z, as boundary values written as rows of the identity, are none without a bound.
        """
        return np.flatnonzero(self._rows.degenerate)

    @cached_property
    def _is_degenerate(self) -> bool:
        return bool(self._rows.degenerate.any())

    @cached_property
    def is_unique(self) -> bool:
        """Whether the derivative exists, so that jvp is linear and vjp the only gradient.

        False if rows are degenerate or M is singular on the free rows, as far as rounding of the data can tell.
        """
        return not (self._is_degenerate or self._system.is_singular)

    @cached_property
    def _system(self) -> FreeSystem:
        """The system of the free rows; where only the degenerate ones make it regular, of those as well."""
        rows = self._rows
        if rows.system is not None and np.array_equal(rows.system.free, rows.free):
            return rows.system
        system = FreeSystem(self.problem.matrix, rows.free)
        if rows.degenerate.any() and system.is_singular:
            freed = FreeSystem(self.problem.matrix, rows.free | rows.degenerate)
            return system if freed.is_singular else freed
        return system

    @property
    def determined(self) -> BoolVector:
        """Which z_i are the same for all solutions with the rows in `free` free, shape (n,); all where M_FF is regular.

        If rows are degenerate, solutions with other free rows may have others.
        """
        determined = np.ones(self.problem.q.size, np.bool_)
        determined[self._system.rows] = self._system.determined
        return determined

    @cached_property
    def advice(self) -> str:
        """What to know of a derivative that is not the only one, in words; "" where none is known of others."""
        system, rows = self._system, self.degenerate
        if rows.size:
            named = ", ".join(map(str, rows[:5].tolist())) + (", …" if rows.size > 5 else "")
            kink = (
                f"{rows.size} rows ({named}) are at a bound with w = 0: jvp is one-sided, and vjp the gradient of one "
                "of the pieces that meet there"
            )
            return f"{kink}; {words_on_singular(system)}" if system.is_singular else kink
        return words_on_singular(system) if system.is_singular else ""

    def jvp(
        self, *, dM: Any = None, dq: Any = None, dlower: Any = None, dupper: Any = None
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
            Where no z solves the free rows after the change, or more than 500 of them are singular, or no one-sided
            derivative exists.

        Examples
        --------
        >>> from lcp_plugin import LCP, solve
        >>> kink = derivative(solve(LCP([[2.0]], [0.0])))
        >>> kink.is_unique, kink.degenerate, kink.jvp(dq=[-1.0]), kink.jvp(dq=[1.0])
        (False, array([0]), array([0.5]), array([0.]))
        """
        h, moved = self._change(dM, dq), self._moved(dlower, dupper)
        if self._is_degenerate:
            return one_sided(self.problem, self._rows, h, moved)
        dz: FloatVector = self.tangent(h, np.where(self._rows.free, 0.0, moved))
        return dz

    def dw(self, dz: ArrayLike, *, dM: Any = None, dq: Any = None) -> FloatVector:
        """Return the change of w = M z + q that goes with a change dz of z, shape (n,)."""
        return self._product(self._checked(dz, "dz")) + self._change(dM, dq)

    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> Gradient:
        """Return the gradients of a function L(z, w) by q, the bounds and the entries of M.

        If rows are degenerate, this is the gradient of one of the pieces that meet there (an element of the
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
            Where the block of M on more than 500 free rows is singular.
        """
        problem = self.problem
        g, by_w = self._checked(g, "g"), self._optional(gw, "gw")
        rows, free = self._rows, self.free
        by_w = np.where(
            free, 0.0, by_w
        )  # w stays 0 there, and its part would cancel only up to rounding
        by_q, by_bound, _ = self.adjoint(g, by_w)
        lower, upper = (
            np.where(free | (rows.is_upper != is_upper), 0.0, by_bound)
            for is_upper in (False, True)
        )
        return Gradient(by_q, lower, upper, outer_on_pattern(problem.matrix, by_q, self.z))

    def _change(self, dM: Any, dq: ArrayLike | None) -> FloatVector:
        """Return dM z + dq."""
        h = self._optional(dq, "dq")
        n = self.problem.n
        return h if dM is None else h + rectangular_matrix(dM, "dM", n, n) @ self.z

    def _moved(self, dlower: ArrayLike | None, dupper: ArrayLike | None) -> FloatVector:
        """Return the change of the bound at which a row is, or would be."""
        is_lower = ~self._rows.is_upper
        return np.where(
            is_lower, self._optional(dlower, "dlower"), self._optional(dupper, "dupper")
        )

    def _optional(self, values: ArrayLike | None, name: str) -> FloatVector:
        """Return a finite vector: zeros where nothing is given; that of a bound may be of one number."""
        if values is None or (name in ("dlower", "dupper") and np.ndim(values) == 0):
            values = np.full(self.problem.q.size, 0.0 if values is None else values)
        return self._checked(values, name)

    def _checked(self, values: ArrayLike, name: str) -> FloatVector:
        """Return a finite vector."""
        return finite_vector(values, name, self.problem.q.size)

    def _acts(self, x: FloatVector) -> bool:
        return bool(x.any())

    def _product(self, x: FloatVector, *, transposed: bool = False) -> FloatVector:
        M = self.problem.matrix.array
        product: FloatVector = (M.T if transposed else M) @ x
        return product

    def _solve_free(self, right: FloatVector, *, transposed: bool = False) -> FloatVector:
        return solution(self._system, right, transposed=transposed)
