"""Quadratic and linear programs as linear complementarity problems, and back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import Array, Vector, checked_answer
from ...core.entries import unbounded
from ...core.errors import InvalidProblem, UnsuitableMatrix, UnsuitableProblem
from ...core.lcp import LCP
from ...core.names import Names
from ...core.settings import PROVEN, Status
from ...judges.program import PROGRAM_TOLERANCE
from ...systems.definiteness import is_semidefinite_to_rounding
from .no_minimum import accepted_proof
from .program import VECTORS, QuadraticProgram, asymmetry_of, refuse_nonconvex
from .result import QuadraticProgramResult
from .solution import QPSolution

UNKNOWN_RUN: dict[str, Any] = {
    "algorithm": "given point",
    "iterations": 0,
    "seconds": 0.0,
    "history": (),
    "stages": (),
}

__all__ = ["QuadraticProgram", "lcp_from_qp", "optimality_conditions", "qp_from_lcp"]


def lcp_from_qp(program: QuadraticProgram) -> LCP:
    """Return the linear complementarity problem that the program's optimality conditions are.

    Parameters
    ----------
    program : QuadraticProgram
        Convex: UnsupportedModel if P clearly has a negative eigenvalue (to n = 5000, by one factorization).
        Rows with one nonzero become bounds first, empty rows and rows with h = ∞ go; then

        - direct, if only bounds are left: M = P, q = c, the same bounds, n rows;
        - kkt, else: M = [[P, Gᵀ, Aᵀ], [−G, 0, 0], [−A, 0, 0]], q = (c, h, b), x within its bounds,
          multipliers of G not negative, multipliers of A free. Monotone, sparse, with zeros on its diagonal.

    Returns
    -------
    LCP
        Problem whose ``origin.recover(result)`` returns the
        :class:`~lcp_plugin.problems.programs.result.QuadraticProgramResult`, with the multipliers of all rows and
        bounds, including folded rows.

    Raises
    ------
    InvalidProblem
        `program` is not a QuadraticProgram.

    Notes
    -----
    Inconsistent constraints are not detected: such a program gives a problem without solution, or with a solution
    beyond all bounds; ``solve(program)`` searches for the proof on the program itself. ``solve(problem)`` tests z as a
    solution of this LCP, as of any other; ``origin.recover(result)`` tests x as a solution of the program.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.2.

    Examples
    --------
    The point of x₁ + x₂ ≤ 2 nearest to (1, 2), and the multiplier of the constraint:

    >>> problem = lcp_from_qp(QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2]))
    >>> print(problem, problem.origin.form)
    LCP(n=3, nonzeros=6, bounds 1 one-sided, 2 free) kkt
    >>> result = problem.origin.recover([0.5, 1.5, 1.0])
    >>> result.x, result.solution.inequality, result.status.name
    (array([0.5, 1.5]), array([1.]), 'SOLVED')
    """
    if not isinstance(program, QuadraticProgram):
        raise InvalidProblem(
            f"lcp_from_qp needs a QuadraticProgram, got {type(program).__name__}; write QuadraticProgram(P, c, …)"
        )
    refuse_nonconvex(program)
    return optimality_conditions(program)


def optimality_conditions(program: QuadraticProgram) -> LCP:
    """Return the conditions of a program known to be convex."""
    origin = QPOrigin(program)
    return conditions(origin.reduced, Names(origin.row_name)).with_origin(origin)


def conditions(program: QuadraticProgram, names: Names | None = None) -> LCP:
    """Return the optimality conditions of (x, inequality, equality); rows without a limit have no multiplier."""
    matrices = program.matrices
    q, lower, upper = condition_vectors(*(getattr(program, name) for name in VECTORS))
    M = matrices.kkt if sum(matrices.sizes[:2]) else matrices.hessian
    return LCP(M, q, lower=lower, upper=upper, names=names)


def condition_vectors(c: Any, h: Any, b: Array, lower: Array, upper: Array) -> tuple[Any, Any, Any]:
    """Return q, lower and upper of the conditions, for vectors of one program or with an axis for many."""
    is_limit = np.isfinite(h)
    q = np.concatenate([c, np.where(is_limit, h, 0.0), b], axis=-1)
    below = np.concatenate([lower, np.zeros(h.shape), np.full(b.shape, -np.inf)], axis=-1)
    ends = [upper, np.where(is_limit, np.inf, 0.0), np.full(b.shape, np.inf)]
    return q, below, np.concatenate(ends, axis=-1)


def qp_from_lcp(problem: LCP) -> QuadraticProgram:
    """Return a quadratic program whose optimality conditions, or whose minimum, are the problem.

    Parameters
    ----------
    problem : LCP
        M symmetric to rounding: min ½ zᵀM z + qᵀz over the bounds; its stationary points are the solutions, all of
        them minimizers if M is positive semidefinite (`QuadraticProgram.is_convex`; not checked here).

        M not symmetric, but monotone: the gap program min (z − a)ᵀ(M z + q) with w = M z + q held to its sign, a the
        finite bound of each row (0 and w = 0 for a free row). The problem has a solution if and only if the
        program has the minimum 0, which is aᵀq in `objective`, where the constant −aᵀq is left out.

    Raises
    ------
    InvalidProblem
        `problem` is not an LCP.
    UnsuitableProblem
        M is not symmetric and a row has two finite bounds: the sign of its w is unknown, so no such program exists.
    UnsuitableMatrix
        M is not symmetric, and not monotone (or too large to decide): the gap program would not be convex.

    Notes
    -----
    Cost for M not symmetric: one factorization of its symmetric part.

    Examples
    --------
    >>> print(qp_from_lcp(LCP([[2, 1], [1, 2]], [-5, 1])))
    QuadraticProgram(n=2, 0 inequalities, 0 equalities)
    >>> print(qp_from_lcp(LCP([[2, 3], [1, 2]], [-5, 1])))
    QuadraticProgram(n=2, 2 inequalities, 0 equalities)
    """
    if not isinstance(problem, LCP):
        raise InvalidProblem(
            f"qp_from_lcp needs an LCP, got {type(problem).__name__}; write LCP(M, q)"
        )
    M, q, lower, upper = problem.M, problem.q, problem.lower, problem.upper
    if asymmetry_of(M)[1] is None:
        return QuadraticProgram(M, q, lower=lower, upper=upper)
    boxed = np.isfinite(lower) & np.isfinite(upper)
    if boxed.any():
        i = int(np.flatnonzero(boxed)[0])
        raise UnsuitableProblem(
            f"M is not symmetric and z[{i}] has two bounds, {lower[i]} and {upper[i]}: no equivalent quadratic "
            "program exists; solve the LCP itself"
        )
    twice = M + M.T
    if is_semidefinite_to_rounding(twice) is not True:
        raise UnsuitableMatrix(
            "M is not symmetric, and its symmetric part could not be shown to be positive semidefinite: the gap "
            "program would not be convex; solve the problem itself"
        )
    has_upper, is_free = np.isfinite(upper), unbounded(lower, upper)
    anchor = np.where(np.isfinite(lower), lower, np.where(has_upper, upper, 0.0))
    # G z ≤ h means w ≥ 0, or w ≤ 0 if only an upper bound exists
    sign = np.where(has_upper, 1.0, -1.0)[~is_free]
    rows, free = np.flatnonzero(~is_free), np.flatnonzero(is_free)
    return QuadraticProgram(
        twice,
        q - M.T @ anchor,
        G=sp.diags_array(sign) @ M[rows] if sp.issparse(M) else sign[:, None] * M[rows],
        h=-sign * q[rows],
        A=M[free],
        b=-q[free],
        lower=lower,
        upper=upper,
    )


@dataclass(frozen=True, eq=False)
class QPOrigin:
    """Origin of a converted LCP: the quadratic program, and the recovery of its primal and dual values.

    Attributes
    ----------
    program : QuadraticProgram
        The user's program. The problem contains the conditions of `reduced`: rows of one variable are bounds.
    F : callable or None
        The map of a variational inequality over the constraints of the program, in place of its gradient.

    Notes
    -----
    z = (x, λ, ν) with w = (P x + c + Gᵀλ + Aᵀν, h − G x, b − A x), of the remaining rows; without rows it is
    the direct form: M = P, q = c, the same bounds.
    """

    program: QuadraticProgram
    F: Callable[[Vector], Vector] | None = None

    @property
    def reduced(self) -> QuadraticProgram:
        """The program without rows of one variable."""
        return self.program.reduced

    @property
    def rows(self) -> int:
        """Number of remaining rows of G and A."""
        return self.reduced.constraints.rows

    def row_name(self, i: int) -> str:
        """Return the name of row i of the problem if it is a row of G or A, else nothing."""
        k = i - self.program.n
        return self.program.name(int(self.program.folded.left[k])) if k >= 0 else ""

    @property
    def is_of_convex_program(self) -> bool:
        """True unless the problem is a variational inequality, whose map need not be a gradient."""
        return self.F is None

    @property
    def form(self) -> str:
        """Return "direct" if only bounds remain, else "kkt"; "variational" for such an inequality."""
        return "variational" if self.F else "kkt" if self.rows else "direct"

    def _has_slack(self, answer: Any, c: Vector, z: Vector) -> bool:
        """Return whether a result has the slack of this problem at z, where c = F(x), and not of other data."""
        (x, y), terms = np.split(z, [self.program.n]), self.reduced.matrices.terms
        d = np.where(np.isfinite(self.reduced.judged.d), self.reduced.judged.d, 0.0)
        slack = np.concatenate([c + terms.columns @ y, d - terms.rows @ x])
        return bool((np.abs(slack - answer.w) <= 1e-9 * answer.certificate.rows.terms).all())

    @np.errstate(all="ignore")
    def recover(self, answer: Any, tolerance: float = PROGRAM_TOLERANCE) -> QuadraticProgramResult:
        """Return the result of the program, with the status that the test of programs gives to this point.

        Parameters
        ----------
        answer : Result or array, shape (rows of the problem,)
            Result of the complementarity problem, of any status, or its z. Multipliers with a wrong sign become 0. If
            the result has a proof of infeasibility, a proof for the program is searched: constraints that are
            inconsistent relative to the LCP's data may be consistent relative to the program's.
        tolerance : float
            Tolerance of the duality gap.

        Returns
        -------
        QuadraticProgramResult
            SOLVED if x is optimal; otherwise the status of the run, or PRECISION_LIMIT or STALLED if only the test of
            the program fails. Its `solution` has x, the multipliers and both measures.

        Raises
        ------
        InvalidProblem
            If it is not a finite vector of that length.
        """
        n = self.program.n
        z, proof = checked_answer(answer, n + self.rows), None
        program = self.program if self.F is None else self.program.with_vectors(c=self.F(z[:n]))
        if getattr(answer, "has_no_solution", False):
            proof = accepted_proof(self.program)
        if proof is not None:
            solution, status = QPSolution.none(program), proof.status
        else:
            # an inequality that is solved by the criterion of its problem is
            is_solved = self.F is not None and getattr(answer, "is_solved", False)
            if is_solved and (is_solved := self._has_slack(answer, program.c, z)):
                # The gradient of a free unknown may be a rounding error
                balance = -(self.reduced.matrices.terms.columns @ z[n:])
                rounding = 1e-12 * answer.certificate.rows.terms[:n]
                is_zero = np.abs(program.c - balance) <= rounding
                is_zero &= unbounded(program.lower, program.upper)
                program = program.with_vectors(c=np.where(is_zero, balance, program.c))
            solution = QPSolution.from_reduced(program, z[:n], z[n:])
            errors = solution.errors_for(tolerance)
            status = getattr(answer, "status", Status.SOLVED)
            if is_solved or errors.meet(tolerance):
                status = Status.SOLVED
            elif status is Status.SOLVED or status in PROVEN:
                is_near = errors.nearly_meet(tolerance)
                status = Status.PRECISION_LIMIT if is_near else Status.STALLED
        fields = {name: getattr(answer, name, none) for name, none in UNKNOWN_RUN.items()}
        if status is not Status.SOLVED and self.F is None:
            fields["begun"] = "solve(problem.origin.program) solves the program itself"
        return QuadraticProgramResult(solution, proof, status=status, tolerance=tolerance, **fields)
