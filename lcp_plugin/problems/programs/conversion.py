"""Quadratic and linear programs as linear complementarity problems, and back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import checked_vector
from ...core.errors import InvalidOption, InvalidProblem, UnsuitableMatrix, UnsuitableProblem, did_you_mean
from ...core.lcp import LCP
from ...systems.definiteness import is_semidefinite_to_rounding
from .convexity import refuse_nonconvex
from .program import QuadraticProgram, asymmetry_of
from .qp_forms import QPOrigin
from .reductions import Substitution, fold_simple_rows, substitute_definitions

FORMS = ("auto", "direct", "kkt")
__all__ = ["QuadraticProgram", "attempts", "lcp_from_lp", "lcp_from_qp", "optimality_conditions", "qp_from_lcp"]


def lcp_from_qp(program: QuadraticProgram, form: str = "auto") -> LCP:
    """Return the optimality conditions of a quadratic program as a linear complementarity problem.

    Parameters
    ----------
    program : QuadraticProgram
        Convex: UnsupportedModel where P clearly has a negative eigenvalue (to n = 5000, by one factorisation).
    form : {"auto", "direct", "kkt"}
        Rows with one nonzero become bounds first, empty rows and rows with h = ∞ go; then

        - direct, only bounds left: M = P, q = c, the bounds as they are, n rows.
        - kkt, any convex program: M = [[P, Gᵀ, Aᵀ], [−G, 0, 0], [−A, 0, 0]], q = (c, h, b), x within its bounds,
          multipliers of G not negative, those of A free. Monotone, sparse, with zeros on its diagonal.

        auto: variables that an equation of their own defines, as cvxpy writes r = A x − b, are put in where that is
        predicted to save work. Then direct where it can be, else kkt.

    Returns
    -------
    LCP
        Its ``origin.recover(result)`` gives the :class:`~lcp_plugin.problems.programs.qp_solution.QPSolution`, with the
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
    judged on the program: where its own criteria do not hold, another form may do.

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
    cheap = substitute_definitions(program, saves_work=True) if form == "auto" else None
    problem = optimality_conditions(program, cheap)
    if form == "direct" and (left := problem.origin.rows.left.size):
        raise UnsuitableProblem(
            f'form="direct" needs a program with bounds only, but {left} rows of G and A have more than one '
            'nonzero (or contradict one another); use form="kkt"'
        )
    return problem


def lcp_from_lp(
    c: ArrayLike, G: Any = None, h: ArrayLike | None = None, A: Any = None, b: ArrayLike | None = None,
    lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf,
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
        gives a :class:`~lcp_plugin.problems.programs.qp_solution.QPSolution`.

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
    >>> solution.is_optimal(tolerance=0.0)
    True
    """
    n = checked_vector(c, "c", None).size
    return lcp_from_qp(QuadraticProgram(sp.csr_array((n, n)), c, G, h, A, b, lower, upper))


def optimality_conditions(program: QuadraticProgram, substitution: Substitution | None = None) -> LCP:
    """Return the conditions of a program known to be convex, or of what a substitution leaves of it."""
    origin = QPOrigin(fold_simple_rows(program if substitution is None else substitution.reduced), substitution)
    problem = origin.problem()
    problem.origin = problem.criterion = origin
    return problem


class Attempt(NamedTuple):
    """A complementarity problem that states a program, and why it is tried."""

    problem: LCP
    because: str


def attempts(program: QuadraticProgram, first: Attempt | None = None) -> Iterator[Attempt]:
    """Yield the complementarity problems by which a convex program is worth solving, the most promising first.

    Parameters
    ----------
    program : QuadraticProgram
    first : Attempt, optional
        The most promising one, where it is known.

    Examples
    --------
    >>> program = QuadraticProgram([[0, 0], [0, 2]], [0, 0], A=[[1, -1]], b=[1], lower=[0, -np.inf])
    >>> [attempt.because for attempt in attempts(program)]
    ['the direct form, defined variables put in', 'the KKT form of the program as it stands']
    """
    if first is None:
        cheap = substitute_definitions(program, saves_work=True)
        problem = optimality_conditions(program, cheap)
        form = f"the {problem.origin.form} form"
        first = Attempt(problem, form if cheap is None else f"{form}, defined variables put in")
    yield first
    if first.problem.origin.substitution is not None:
        yield Attempt(optimality_conditions(program), "the KKT form of the program as it stands")
    elif (substitution := substitute_definitions(program)) is not None:
        yield Attempt(optimality_conditions(program, substitution), "defined variables put in")


def qp_from_lcp(problem: LCP) -> QuadraticProgram:
    """Return a quadratic program with the solutions of a linear complementarity problem.

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
        raise InvalidProblem(f"qp_from_lcp needs an LCP, got {type(problem).__name__}; write LCP(M, q)")
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
    sign = np.where(has_upper, 1.0, -1.0)[~is_free]  # G z ≤ h says w ≥ 0, or w ≤ 0 where only an upper bound is
    rows, free = np.flatnonzero(~is_free), np.flatnonzero(is_free)
    return QuadraticProgram(
        twice, q - M.T @ anchor,
        G=sp.diags_array(sign) @ M[rows] if sp.issparse(M) else sign[:, None] * M[rows], h=-sign * q[rows],
        A=M[free], b=-q[free], lower=lower, upper=upper,
    )
