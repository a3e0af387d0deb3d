"""Derivative of a solution with respect to the data (:mod:`lcp_plugin.systems.free_systems`).

Within one active set z is smooth in M, q and the bounds. The free rows are strictly between their bounds, all other
rows are at a bound with w ≠ 0. A row at a bound with w = 0 is degenerate. z then has one-sided derivatives, each
the solution of a small LCP on the free and the degenerate rows.

References
----------
J. S. Pang, D. Ralph, *Piecewise smoothness, local invertibility, and parametric analysis of normal maps*,
Math. Oper. Res. 21 (1996), doi:10.1287/moor.21.2.401.

Changes of the free rows: regular, least change if singular, one-sided at a kink.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...auto import solve_lcp
from ...core.checks import (
    BoolVector,
    FloatVector,
    change_of_vector,
    checked_vector,
    derived_property,
    rectangular_matrix,
)
from ...core.errors import InvalidOption, UnsuitableProblem
from ...core.lcp import LCP
from ...core.problem_classes import refusal
from ...core.solving.result import Result
from ...proofs.bounds import ActiveRows, settled_rows
from ...systems.free_systems import CONSISTENT, FreeSystem, LinearizedSystem
from ...systems.graph import outer_on_pattern
from ..batches.batch_run import BatchAnswers
from ..batches.instances import Listed, Stacked, Worlds
from ..cones.derivative import ConeDerivative
from ..cones.solving import ConeResult
from ..march import March
from ..march.march_derivative import MarchDerivative
from .batch_derivative import BatchDerivative, ContactBatchDerivative

SINGULAR = (
    "the block of M on the free rows is singular to working precision, too large for a generalised inverse or for a "
    "factor where multigrid fails: z has no derivative that could be computed; regularise M, or fix what is not "
    "determined"
)


def words_on_singular(system: FreeSystem) -> str:
    """Return a warning about a derivative if M is singular on the free rows."""
    inverse = system.pseudo_inverse
    if inverse is None:
        return SINGULAR
    same, rank = system.determined_slack, round(float(np.trace(inverse @ system.block)))
    is_same = same is not None and bool(same.all())
    return (
        f"M has rank {rank} on the {system.rows.size} free rows: z is one of several "
        f"solutions, w {'the same' if is_same else 'not the same'} for all of them, and this the derivative of the "
        "least change"
    )


def solution(system: FreeSystem, right: FloatVector, *, transposed: bool = False) -> FloatVector:
    """Return the solution, with least norm if the block is singular."""
    x = system.solve(right, transposed=transposed)
    if x is not None:
        return x
    inverse = system.pseudo_inverse
    if inverse is None:
        raise UnsuitableProblem(SINGULAR)
    x, right = np.zeros(right.size), right[system.rows]
    part = (inverse.T if transposed else inverse) @ right
    left = np.abs(right - system.block @ part)
    if (
        not transposed
        and (left > CONSISTENT * (abs(system.block) @ np.abs(part) + np.abs(right))).any()
    ):
        raise UnsuitableProblem(
            f"M is singular on the {part.size} free rows, and after this change no z solves them: there is no "
            "derivative in this direction; regularise M, or change q within what M z can give"
        )
    x[system.rows] = part
    return x


def one_sided(problem: LCP, rows: ActiveRows, h: FloatVector, moved: FloatVector) -> FloatVector:
    """Return the one-sided derivative: the solution of an LCP on the free and the degenerate rows.

    Rows fixed at a bound have d = db, which is `moved`, and free rows have (M d + h)_i = 0. Degenerate rows at a lower
    bound have d ≥ db and (M d + h) ≥ 0, complementary, and the mirror image at an upper bound.
    """
    lower = np.where(rows.free | (rows.degenerate & rows.is_upper), -np.inf, moved)
    upper = np.where(rows.free | (rows.degenerate & ~rows.is_upper), np.inf, moved)
    part = np.flatnonzero(rows.free | rows.degenerate)
    dz = np.where(rows.at_lower | rows.at_upper, moved, 0.0)
    M = problem.M
    block = M[part][:, part] if sp.issparse(M) else M[np.ix_(part, part)]
    small = LCP(block, (h + M @ dz)[part], lower=lower[part], upper=upper[part])
    result = solve_lcp(small)
    if not result.is_solved:
        raise UnsuitableProblem(
            f"{part.size} free and degenerate rows have no one-sided derivative that could be found: their LCP ended "
            f"{result.status.name}; the block of M on them is no P-matrix, and z may jump or have branches"
        )
    dz[part] = settled_rows(small, result.z, result.w).z
    return dz


class Gradient(NamedTuple):
    """Gradient of a function of the solution, with respect to the data of the problem.

    Attributes
    ----------
    q, lower, upper : ndarray, shape (n,)
        Gradients with respect to q and the bounds; 0 for an inactive bound. If lower = upper, the gradient belongs to
        the bound selected by the sign of w. If both bounds move together, use the sum.
    M : csr_array, shape (n, n)
        Gradient with respect to the entries of M, on the sparsity pattern of M.
    """

    q: FloatVector
    lower: FloatVector
    upper: FloatVector
    M: sp.csr_array


@np.errstate(all="ignore")
def derivative(result: Any) -> Any:
    """Return the derivative of the solution of an LCP, a batch or steps in time with respect to the data.

    For a cvxpy problem with complementarities, solved by ``method="LCP"``, the derivative is with respect to its
    parameters; see ``help("lcp_plugin.modeling")``.

    Parameters
    ----------
    result : Result or BatchAnswers or March
        SOLVED result of an LCP or of a NonlinearProblem, for which dq is a change of F. The derivative uses the
        hierarchy of M built in the run, and M is not copied: do not change its entries between the solve and this
        call.
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
        If the argument is none of these, or is a march over cones: use ``derivative(done[k])`` for each step. For a
        list of problems over cones use ``derivative(answers[k])``.

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
                "march over cones is not differentiable as a whole; derivative(done[k]) differentiates step k with "
                "respect to its q"
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
    return Derivative(certificate.problem, result.z, result.w)


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
        Solution and slack of the problem.
        The linearization at z of a nonlinear problem: dq is then a change dF of F, and nothing is proved.
    before : Derivative, optional
        Derivative for a problem with the same M, whose factorization is used again.

    Notes
    -----
    The solution is computed again on its free rows, with w in twice the working precision. The rows are then
    classified reliably, and ∂z/∂M is evaluated at the solution of the stored data instead of a z within the tolerance.

    If M is singular on the free rows, z is one of several solutions. The derivative is then the least change, in a
    scaling computed from M, by the Moore–Penrose inverse of at most 500 rows. Quantities common to all solutions,
    such as contact velocities with undetermined impulses, have the same derivative for every solution. In this case
    dM is not available, vjp requires a symmetric M, and jvp requires that no row is degenerate.
    """

    def __init__(
        self,
        problem: LCP,
        z: FloatVector,
        w: FloatVector,
        *,
        before: Derivative | None = None,
    ) -> None:
        self.problem = problem
        self._found = z, w, None if before is None else before._rows.system

    @derived_property
    def _rows(self) -> ActiveRows:
        return settled_rows(self.problem, *self._found)

    @property
    def z(self) -> FloatVector:
        """The solution at which the derivative is evaluated, shape (n,)."""
        return self._rows.z

    @property
    def free(self) -> BoolVector:
        """Rows that `vjp` treats as free, (n,); degenerate rows only to make a block regular."""
        return self._system.free

    @property
    def degenerate(self) -> NDArray[np.intp]:
        """Rows at a bound with w = 0, up to the rounding error of the data.

        Rows without a bound that only prescribe z, such as boundary values as identity rows, do not count.
        """
        return np.flatnonzero(self._rows.degenerate)

    @derived_property
    def is_unique(self) -> bool:
        """True if the derivative exists, so that jvp is linear and vjp the only gradient.

        False if rows are degenerate, or if M is singular on the free rows, up to the rounding error of the data.
        """
        return not (self._rows.degenerate.any() or self._system.is_singular)

    @derived_property
    def _system(self) -> FreeSystem:
        """System of the free rows, with the degenerate rows only if these make it regular."""
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
        """Mask of z_i shared by all solutions with this `free`, (n,); all if M_FF is regular.

        If rows are degenerate, solutions with other free rows may differ.
        """
        determined = np.ones(self.problem.q.size, np.bool_)
        determined[self._system.rows] = self._system.determined
        return determined

    @derived_property
    def advice(self) -> str:
        """Warning that the derivative is not unique, as text; "" if it is unique."""
        system, rows = self._system, self.degenerate
        if rows.size:
            named = ", ".join(map(str, rows[:5].tolist())) + (", …" if rows.size > 5 else "")
            kink = (
                f"{rows.size} rows ({named}) are at a bound with w = 0: jvp is one-sided, and vjp the gradient of one "
                "of the pieces that meet there"
            )
            return f"{kink}; {words_on_singular(system)}" if system.is_singular else kink
        return words_on_singular(system) if system.is_singular else ""

    @np.errstate(all="ignore")
    def jvp(
        self, *, dM: Any = None, dq: Any = None, dlower: Any = None, dupper: Any = None
    ) -> FloatVector:
        """Return the change dz of z for changes of the data; one-sided if rows are degenerate.

        Parameters
        ----------
        dM : array or sparse array, shape (n, n), optional
            The change of M, on any pattern.
        dq : array, shape (n,), optional
        dlower, dupper : number or array, shape (n,), optional
            Changes of the bounds; only active bounds matter.

        Returns
        -------
        array, shape (n,)
            Unit of z per unit of the data.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        UnsuitableProblem
            If no z solves the free rows after the change, if more than 500 free rows are singular, or if no one-sided
            derivative exists.

        Examples
        --------
        >>> from lcp_plugin import LCP, solve
        >>> kink = derivative(solve(LCP([[2.0]], [0.0])))
        >>> kink.is_unique, kink.degenerate, kink.jvp(dq=[-1.0]), kink.jvp(dq=[1.0])
        (False, array([0]), array([0.5]), array([0.]))
        """
        h, moved = self._change(dM, dq), self._moved(dlower, dupper)
        if self._rows.degenerate.any():
            return one_sided(self.problem, self._rows, h, moved)
        dz: FloatVector = self.tangent(h, np.where(self._rows.free, 0.0, moved))
        return dz

    def dw(self, dz: ArrayLike, *, dM: Any = None, dq: Any = None) -> FloatVector:
        """Return the change of w = M z + q for a change dz of z, shape (n,)."""
        dz = checked_vector(dz, "dz", self.problem.n)
        return self._product(dz) + self._change(dM, dq)

    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> Gradient:
        """Return the gradients of a function L(z, w) by q, the bounds and the entries of M.

        If rows are degenerate, this is the gradient of one of the pieces that meet there (an element of the
        B-subdifferential), in which the rows in `free` are free.

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
            If the block of M on more than 500 free rows is singular.
        """
        problem, n = self.problem, self.problem.n
        g, by_w = checked_vector(g, "g", n), change_of_vector(gw, "gw", n)
        rows, free = self._rows, self.free
        # w stays 0 in free rows, and its part would cancel only up to rounding
        by_w = np.where(free, 0.0, by_w)
        by_q, by_bound, _ = self.adjoint(g, by_w)
        lower, upper = (
            np.where(free | (rows.is_upper != is_upper), 0.0, by_bound)
            for is_upper in (False, True)
        )
        return Gradient(by_q, lower, upper, outer_on_pattern(problem.matrix, by_q, self.z))

    def _change(self, dM: Any, dq: ArrayLike | None) -> FloatVector:
        """Return dM z + dq."""
        n = self.problem.n
        h = change_of_vector(dq, "dq", n)
        return h if dM is None else h + rectangular_matrix(dM, "dM", n, n) @ self.z

    def _moved(self, dlower: ArrayLike | None, dupper: ArrayLike | None) -> FloatVector:
        """Return the change of the active or, for free rows, the nearer bound."""
        n = self.problem.n
        lower = change_of_vector(dlower, "dlower", n, may_be_number=True)
        upper = change_of_vector(dupper, "dupper", n, may_be_number=True)
        return np.where(self._rows.is_upper, upper, lower)

    def _product(self, x: FloatVector, *, transposed: bool = False) -> FloatVector:
        M = self.problem.matrix.array
        product: FloatVector = (M.T if transposed else M) @ x
        return product

    def _solve_free(self, right: FloatVector, *, transposed: bool = False) -> FloatVector:
        return solution(self._system, right, transposed=transposed)
