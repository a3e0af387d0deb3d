"""Quadratic and linear programs as linear complementarity problems, and back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import FloatVector, checked_answer, checked_vector
from ...core.errors import (
    InvalidOption,
    InvalidProblem,
    UnsuitableMatrix,
    UnsuitableProblem,
    did_you_mean,
)
from ...core.lcp import LCP
from ...systems.definiteness import is_semidefinite_to_rounding
from .convexity import refuse_nonconvex
from .criterion import PROGRAM_TOLERANCE, program_goal
from .program import QuadraticProgram, asymmetry_of
from .program_matrices import sums_and_terms
from .reductions import DefinedVariables, FoldedRows, Reduction
from .solution import QPSolution

if TYPE_CHECKING:
    from .no_minimum import QPInfeasibility, QPUnboundedness
    from .program import QuadraticProgram

FORMS = ("auto", "direct", "kkt")
__all__ = ["QuadraticProgram", "lcp_from_lp", "lcp_from_qp", "optimality_conditions", "qp_from_lcp"]


def lcp_from_qp(program: QuadraticProgram, form: str = "auto") -> LCP:
    """Return the linear complementarity problem that the program's optimality conditions are.

    Parameters
    ----------
    program : QuadraticProgram
        Convex: UnsupportedModel where P clearly has a negative eigenvalue (to n = 5000, by one factorisation).
    form : {"auto", "direct", "kkt"}
        Rows with one nonzero become bounds first, empty rows and rows with h = ∞ go; then

        - direct, only bounds left: M = P, q = c, the bounds as they are, n rows.
        - kkt, any convex program: M = [[P, Gᵀ, Aᵀ], [−G, 0, 0], [−A, 0, 0]], q = (c, h, b), x within its bounds,
          multipliers of G not negative, those of A free. Monotone, sparse, with zeros on its diagonal.

        auto: direct where it can be, else kkt.

    Returns
    -------
    LCP
        Its ``origin.recover(result)`` gives the :class:`~lcp_plugin.problems.programs.solution.QPSolution`, with the
        multipliers of all rows and bounds, folded ones included.

    Raises
    ------
    UnsuitableProblem
        form="direct", but rows are left.
    InvalidProblem
        `program` is no QuadraticProgram.
    InvalidOption
        An unknown form.

    Notes
    -----
    Constraints that contradict one another are not looked for: such a program gives a problem without solution, or
    with one beyond all bounds; ``recover(result).status`` then looks for the proof on the program itself. SOLVED is
    judged on the program.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.2.

    Examples
    --------
    The point of x₁ + x₂ ≤ 2 nearest to (1, 2), and what the constraint costs:

    >>> problem = lcp_from_qp(QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2]))
    >>> print(problem, problem.origin.form)
    LCP(n=3, nonzeros=6, bounds 1 one-sided, 2 free) kkt
    >>> solution = problem.origin.recover([0.5, 1.5, 1.0])
    >>> solution.x, solution.inequality, solution.is_optimal(1e-12)
    (array([0.5, 1.5]), array([1.]), True)
    """
    if not isinstance(program, QuadraticProgram):
        raise InvalidProblem(
            f"lcp_from_qp needs a QuadraticProgram, got {type(program).__name__}; write QuadraticProgram(P, c, …)"
        )
    refuse_nonconvex(program)
    if form not in FORMS:
        raise InvalidOption(f"form={form!r} is not offered{did_you_mean(form, FORMS)}")
    problem = optimality_conditions(program)
    if form == "direct" and (left := problem.origin.rows):
        raise UnsuitableProblem(
            f'form="direct" needs a program with bounds only, but {left} rows of G and A have more than one '
            'nonzero (or contradict one another); use form="kkt"'
        )
    return problem


def lcp_from_lp(
    c: ArrayLike,
    G: Any = None,
    h: ArrayLike | None = None,
    A: Any = None,
    b: ArrayLike | None = None,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
) -> LCP:
    """Return the optimality conditions of min cᵀx, G x ≤ h, A x = b, lower ≤ x ≤ upper as a complementarity problem.

    Parameters
    ----------
    c : array, shape (n,)
        Real, finite.
    G, h, A, b, lower, upper
        As in :class:`~lcp_plugin.problems.programs.conversion.QuadraticProgram`.

    Returns
    -------
    LCP
        The program of the form "kkt" with P = 0 (form "direct", M = 0, where all constraints are bounds): monotone
        with M = −Mᵀ, and a diagonal of zeros, on which relaxation methods cannot run. ``origin.recover(result)``
        gives a :class:`~lcp_plugin.problems.programs.solution.QPSolution`.

    Raises
    ------
    InvalidProblem
        Where the data do not state such a program.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.2.

    Examples
    --------
    max x₁ + 2 x₂ subject to x₁ + x₂ ≤ 3, 0 ≤ x ≤ 2:

    >>> problem = lcp_from_lp([-1, -2], G=[[1, 1]], h=[3], lower=0, upper=2)
    >>> solution = problem.origin.recover([1.0, 2.0, 1.0])
    >>> solution.objective, solution.inequality, solution.upper
    (-5.0, array([1.]), array([0., 1.]))
    >>> solution.is_optimal(tolerance=1e-12)
    True
    """
    n = checked_vector(c, "c", None).size
    return lcp_from_qp(QuadraticProgram(sp.csr_array((n, n)), c, G, h, A, b, lower, upper))


def optimality_conditions(program: QuadraticProgram, *, puts_in: bool = False) -> LCP:
    """Return the conditions of a program known to be convex; for a run without the variables that equations define."""
    origin = QPOrigin.of(program)
    if puts_in:
        origin = QPOrigin(origin.reduction.then(DefinedVariables.of))
    problem = origin.problem()
    problem.origin = problem.criterion = origin
    return problem


def conditions(program: QuadraticProgram) -> LCP:
    """Return the optimality conditions of (x, inequality, equality); rows without a limit have no multiplier."""
    limits, free = np.concatenate([program.h, program.b]), np.full(program.n, np.inf)
    is_limit, none = np.isfinite(limits), np.full(program.b.size, np.inf)
    lower = np.concatenate([-free, np.zeros(program.h.size), -none])
    upper = np.concatenate([free, np.where(is_limit[: program.h.size], np.inf, 0.0), none])
    q = np.concatenate([program.c, np.where(is_limit, limits, 0.0)])
    return LCP(program.matrices.kkt, q, lower=lower, upper=upper)


def qp_from_lcp(problem: LCP) -> QuadraticProgram:
    """Return a quadratic program whose optimality conditions, or whose minimum, are the problem.

    Parameters
    ----------
    problem : LCP
        M symmetric to rounding: min ½ zᵀM z + qᵀz over the bounds; its stationary points are the solutions, all of
        them minimisers where M is positive semidefinite (`QuadraticProgram.is_convex`; not asked here).

        M not symmetric, but monotone: the gap program min (z − a)ᵀ(M z + q) with w = M z + q held to its sign, a the
        one finite bound of each row (0 and w = 0 for a free row). The problem has a solution if and only if the
        program has the minimum 0, which is aᵀq in `objective`, where the constant −aᵀq is left out.

    Raises
    ------
    InvalidProblem
        `problem` is no LCP.
    UnsuitableProblem
        M is not symmetric and a row has two finite bounds: the sign of its w is not known, so there is no such program.
    UnsuitableMatrix
        M is not symmetric, and not monotone (or too large to decide): the gap program would not be convex.

    Notes
    -----
    Cost for M not symmetric: one factorisation of its symmetric part.

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
            f"M is not symmetric and z[{i}] has two bounds, {lower[i]} and {upper[i]}: there is no quadratic program "
            "for that; solve the problem itself"
        )
    twice = M + M.T
    if is_semidefinite_to_rounding(twice) is not True:
        raise UnsuitableMatrix(
            "M is not symmetric, and its symmetric part could not be shown to be positive semidefinite: the gap "
            "program would not be convex; solve the problem itself"
        )
    has_upper, is_free = np.isfinite(upper), (lower == -np.inf) & (upper == np.inf)
    anchor = np.where(np.isfinite(lower), lower, np.where(has_upper, upper, 0.0))
    sign = np.where(has_upper, 1.0, -1.0)[
        ~is_free
    ]  # G z ≤ h says w ≥ 0, or w ≤ 0 where only an upper bound is
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
    """Where a problem came from: a quadratic program, and the way back to its primal and dual values.

    Attributes
    ----------
    reduction : Reduction
        The program, and what is left of it, whose conditions the problem states: simple rows folded into bounds.

    Notes
    -----
    z = (x, λ, ν) with w = (P x + c + Gᵀλ + Aᵀν, h − G x, b − A x), of the rows that are left; where none are, that is
    the direct form: M = P, q = c, the bounds as they are.
    """

    reduction: Reduction
    is_of_convex_program: ClassVar[bool] = True
    _latest: dict[bytes, QPSolution] = field(
        default_factory=dict, init=False, repr=False
    )  # what was recovered last
    _proofs: list[Any] = field(default_factory=list, init=False, repr=False)

    @classmethod
    def of(cls, program: QuadraticProgram) -> QPOrigin:
        """Return that of a program."""
        return cls(Reduction(program).then(FoldedRows.of))

    @property
    def program(self) -> QuadraticProgram:
        """The program that was given."""
        return self.reduction.program

    @property
    def rows(self) -> int:
        """How many rows of G and A are left."""
        return self.reduction.reduced.constraints.rows

    @property
    def n(self) -> int:
        """Number of unknowns of the problem."""
        return self.reduction.reduced.n + self.rows

    @property
    def form(self) -> str:
        """Return "direct" where bounds are all that is left, else "kkt"."""
        return "kkt" if self.rows else "direct"

    def problem(self) -> LCP:
        """Return the problem of n + m + p rows; its symmetric part is P beside zeros."""
        program, rows = self.reduction.reduced, self.rows
        multiplier = np.where(program.constraints.is_equality[:rows], -np.inf, 0.0)
        return LCP(
            program.matrices.kkt if rows else program.matrices.hessian,
            np.concatenate([program.c, program.constraints.limit[:rows]]),
            lower=np.concatenate([program.lower, multiplier]),
            upper=np.append(program.upper, np.full(rows, np.inf)),
        )

    def stated(self, x: FloatVector, multipliers: FloatVector) -> FloatVector:
        """Return z of an x and multipliers of all constraints of the program; NaN counts as 0."""
        x, multipliers = self.reduction.inward(x, np.nan_to_num(multipliers))
        return np.append(x, multipliers[: self.rows])

    def outward(self, z: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x and multipliers of all constraints of the program, those of bounds that are left 0."""
        x, y = self._split(z)
        return self.reduction.outward(x, np.append(y, np.zeros(2 * x.size)))

    def recover(self, answer: Any) -> QPSolution:
        """Return the program's solution that an answer of the complementarity problem stands for.

        Parameters
        ----------
        answer : Result or array, shape (rows of the problem,)
            Right or wrong: the solution's residuals say which. Multipliers of inequalities lose a wrong sign here. A
            result with a proof that there is no solution has no multipliers, NaN, where the program has none either:
            what is a contradiction beside the problem's data may be none beside the program's.

        Raises
        ------
        InvalidProblem
            Where it is no finite vector of that length.
        """
        x, y = self._split(answer)
        if (
            getattr(answer, "has_no_solution", False)
            and self.program.facts.accepted_proof() is not None
        ):
            return QPSolution.without_multipliers(self.program, self.reduction.point(x))
        key = x.tobytes() + y.tobytes()
        solution = self._latest.get(key)  # a run's judge may have asked for it
        if solution is None:
            y[: self.reduction.reduced.h.size] = np.maximum(y[: self.reduction.reduced.h.size], 0.0)
            solution = self._with_bounds(x, y)
            self._latest.clear()
            self._latest[key] = solution
        return solution

    def is_answered(self, z: FloatVector, tolerance: float) -> bool:
        """Return whether the program's own criteria hold at what z stands for, where a run has this tolerance."""
        goal = program_goal(tolerance)
        if not np.isfinite(z).all() or not (solution := self.recover(z)).is_stationary(goal):
            return False
        return (
            solution.is_sure(goal) or self.program.facts.accepted_proof(goal, is_met=True) is None
        )

    def _with_bounds(self, x: FloatVector, y: FloatVector) -> QPSolution:
        """Return the solution of x and multipliers of the rows that are left; those of bounds take what is over."""
        folded = self.reduction.reduced
        if not (np.isfinite(folded.lower) | np.isfinite(folded.upper)).any():
            return self._whole(x, np.append(y, np.zeros(2 * x.size)))
        # What the bounds have to balance, μ_lower − μ_upper.
        reduced_cost = folded.P @ x + folded.c + sums_and_terms(folded.matrices.rows, y)[0]
        at_lower = np.where(np.isfinite(folded.lower), np.maximum(reduced_cost, 0.0), 0.0)
        at_upper = np.where(np.isfinite(folded.upper), np.maximum(-reduced_cost, 0.0), 0.0)
        return self._whole(x, np.concatenate([y, at_lower, at_upper]))

    def _whole(self, x: FloatVector, multipliers: FloatVector) -> QPSolution:
        """Return the program's solution from x and the multipliers of the rows that are left, and of all bounds."""
        x, every = self.reduction.outward(x, multipliers)
        _refuse_infinite(self.program, every)
        return QPSolution.of_rows(self.program, x, every)

    def has_no_solution(self, tolerance: float) -> bool:
        """Return whether the program is proved to have no minimum, in units of its own data.

        A contradiction of the problem alone may be one of rounding: an equation 1e-16 = 0 may be all that acts there.
        A tolerance of the problem below 1e-6 is none of the program.
        """
        return self.program.facts.accepted_proof(max(tolerance, PROGRAM_TOLERANCE)) is not None

    def end_by(self, proof: QPInfeasibility | QPUnboundedness) -> None:
        """Take note of the proof that ends a run."""
        self._proofs[:] = [proof]

    @property
    def ended_by(self) -> QPInfeasibility | QPUnboundedness | None:
        """The proof that has ended a run, if one has."""
        return self._proofs[0] if self._proofs else None

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector]:
        """Return x and the multipliers of the rows of G and A that are left."""
        n = self.reduction.reduced.n
        z = checked_answer(answer, self.n)
        return z[:n], z[n:].copy()


def _refuse_infinite(program: QuadraticProgram, multipliers: FloatVector) -> None:
    """Raise InvalidProblem where the multiplier of a constraint is beyond the range of doubles."""
    for name, part in zip(
        ("G", "A", "lower", "upper"), program.constraints.split(multipliers), strict=True
    ):
        for row in np.flatnonzero(np.isinf(part))[:1]:
            raise InvalidProblem(
                f"the multiplier of {name}[{row}] is beyond the range of doubles, ±1.8e308; give that constraint, "
                "limits and the objective in units in which their largest coefficients are near 1"
            )
