"""Quadratic programs as linear complementarity problems, and back."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..checks import DENSE_UP_TO_SIZE, FloatVector, check_order, checked_bound
from ..errors import InvalidOption, InvalidProblem, UnsuitableMatrix, UnsuitableProblem, did_you_mean
from ..matrix.definiteness import (
    Solver,
    condition_estimate,
    is_diagonal,
    is_semidefinite_to_rounding,
    positive_definite_solver,
)
from ..problem.lcp import LCP
from .checked import asymmetry_of, attach_origin, checked_matrix, checked_vector, symmetric
from .constraints import Constraints, FoldedRows, fold_simple_rows
from .convexity import refuse_nonconvex
from .qp_certificates import proof_of_no_minimum
from .qp_forms import FORMS, DirectForm, DualForm, KKTForm
from .qp_proofs import QPInfeasibility, QPUnboundedness

WELL_CONDITIONED = 1e6  # the dual form loses as many digits of x as this has
INFINITE_LIMIT = 1e20  # the convention of file formats


@dataclass(frozen=True, eq=False)
class RangeRows:
    """Which rows l ≤ a x ≤ u became which: G holds the rows with a finite u, then those with a finite l, negated.

    Attributes
    ----------
    count : int
        Number of rows that were given.
    inequalities, equalities : ndarray of int
        For each row of G and of A the row it comes from.
    upper_count : int
        How many rows of G come from an upper limit.
    """

    count: int
    inequalities: Any
    equalities: Any
    upper_count: int


@dataclass(frozen=True, eq=False, init=False)
class QuadraticProgram:
    """Minimise ½ xᵀP x + cᵀx subject to G x ≤ h, A x = b, lower ≤ x ≤ upper; checked, read-only data.

    Parameters
    ----------
    P : array or sparse array, shape (n, n)
        Real, finite, symmetric. Rounding errors in the symmetry are averaged away, and ``asymmetry`` says how
        large they were. Sparse stays sparse. Whether P is positive semidefinite is not asked here: see `is_convex`.
    c : array, shape (n,)
        Real, finite.
    G, h : array or sparse array, shape (m, n), and array, shape (m,), optional
        An h of ∞ says nothing about its row.
    A, b : array or sparse array, shape (p, n), and array, shape (p,), optional
    lower, upper : scalar or array, shape (n,)
        In the unit of x; none by default.

    Attributes
    ----------
    asymmetry : float
        max |p_ij − p_ji| of the P that was given.

    Raises
    ------
    InvalidProblem
        Where the data do not state such a program.

    Examples
    --------
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> program
    QuadraticProgram(n=2, 1 inequality, 0 equalities)
    >>> program.objective([0.5, 1.5])
    -4.5
    """

    P: Any
    c: FloatVector
    G: Any
    h: FloatVector
    A: Any
    b: FloatVector
    lower: FloatVector
    upper: FloatVector
    asymmetry: float = field(default=0.0)
    ranges: RangeRows | None = field(default=None, repr=False)

    def __init__(
        self, P: Any, c: ArrayLike, G: Any = None, h: ArrayLike | None = None, A: Any = None,
        b: ArrayLike | None = None, lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf,
    ) -> None:
        vector = checked_vector(c, "c", None)
        n = vector.size
        P, asymmetry = symmetric(checked_matrix(P, "P", n, n))
        rows, limits = _checked_rows(G, h, "G", "h", n, allow_plus_infinity=True)
        equations, right = _checked_rows(A, b, "A", "b", n, allow_plus_infinity=False)
        below, above = checked_bound(lower, "lower", n), checked_bound(upper, "upper", n)
        check_order(below, above)
        self._keep(P=P, c=vector, G=rows, h=limits, A=equations, b=right, lower=below, upper=above, asymmetry=asymmetry)

    @classmethod
    def from_ranges(
        cls, P: Any, c: ArrayLike, A: Any, lower_rows: ArrayLike, upper_rows: ArrayLike,
        lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf,
    ) -> QuadraticProgram:
        """Return the program min ½ xᵀP x + cᵀx over lower_rows ≤ A x ≤ upper_rows, lower ≤ x ≤ upper.

        Parameters
        ----------
        P, c, lower, upper
            As in the class.
        A : array or sparse array, shape (m, n)
        lower_rows, upper_rows : scalar or array, shape (m,)
            Limits of the rows: an equation where they are equal. 1e20 and beyond means none, for the bounds too.

        Raises
        ------
        InvalidProblem
            As the class, and where a lower limit is above its upper one.

        Examples
        --------
        >>> program = QuadraticProgram.from_ranges(np.eye(2), [0, 0], [[1, 1], [1, -1]], [2, -1], [2, 1])
        >>> program
        QuadraticProgram(n=2, 2 inequalities, 1 equality)
        """
        n = checked_vector(c, "c", None).size
        rows = sp.csr_array(checked_matrix(A, "A", None, n))
        m = rows.shape[0]
        low, high = (
            _with_infinities(checked_bound(limit, name, m))
            for limit, name in ((lower_rows, "lower_rows"), (upper_rows, "upper_rows"))
        )
        check_order(low, high)
        is_equality = low == high
        above, below = (np.flatnonzero(np.isfinite(limit) & ~is_equality) for limit in (high, low))
        equal = np.flatnonzero(is_equality)
        program = cls(
            P, c, sp.vstack([rows[above], -rows[below]], format="csr"), np.concatenate([high[above], -low[below]]),
            rows[equal], low[equal],
            _with_infinities(checked_bound(lower, "lower", n)), _with_infinities(checked_bound(upper, "upper", n)),
        )
        ranges = RangeRows(m, np.concatenate([above, below]), equal, above.size)
        program._keep(ranges=ranges)
        return program

    @property
    def n(self) -> int:
        """Number of variables."""
        return int(self.c.size)

    @property
    def is_convex(self) -> bool | None:
        """Whether P is positive semidefinite to rounding; None where n is too large to say. One factorisation."""
        return is_semidefinite_to_rounding(self.P)

    @cached_property
    def proof_of_no_minimum(self) -> QPInfeasibility | QPUnboundedness | None:
        """A proof that the convex program is infeasible or unbounded; looked for once, None where none was found.

        It holds for the stored doubles, by however little: `margin` says by how much, `refutation` whether it counts.
        """
        return proof_of_no_minimum(self)

    def refutation(self, tolerance: float = 1e-6) -> QPInfeasibility | QPUnboundedness | None:
        """Return the proof that no x at all can be called optimal at this tolerance, or None where there is none."""
        proof = self.proof_of_no_minimum
        return proof if proof is not None and proof.excludes(tolerance) else None

    @cached_property
    def constraints(self) -> Constraints:
        """All constraints as rows of one matrix, with the units in which they are judged."""
        return Constraints.of(self)

    def with_rows(
        self, G: Any, h: FloatVector, A: Any, b: FloatVector, lower: FloatVector, upper: FloatVector
    ) -> QuadraticProgram:
        """Return the program with other constraints, which are not checked."""
        made = object.__new__(QuadraticProgram)
        made._keep(P=self.P, c=self.c, G=G, h=h, A=A, b=b, lower=lower, upper=upper)
        return made

    def _keep(self, **data: Any) -> None:
        for name, value in data.items():
            object.__setattr__(self, name, value)

    def objective(self, x: ArrayLike) -> float:
        """Return ½ xᵀP x + cᵀx for x of shape (n,)."""
        point = checked_vector(x, "x", self.n)
        return float(0.5 * (point @ (self.P @ point)) + self.c @ point)

    def __repr__(self) -> str:
        m, p = self.h.size, self.b.size
        averaged = f", asymmetry {self.asymmetry:.1e} averaged away" if self.asymmetry else ""
        rows = f"{m} inequalit{'y' if m == 1 else 'ies'}, {p} equalit{'y' if p == 1 else 'ies'}"
        return f"QuadraticProgram(n={self.n}, {rows}{averaged})"


def lcp_from_qp(program: QuadraticProgram, form: str = "auto") -> LCP:
    """Return the linear complementarity problem that the program's optimality conditions are.

    Parameters
    ----------
    program : QuadraticProgram
        Convex: UnsupportedModel where P clearly has a negative eigenvalue (to n = 5000, by one factorisation).
    form : {"auto", "direct", "dual", "kkt"}
        Rows with one nonzero become bounds first, empty rows and rows with h = ∞ go; then

        - direct, only bounds left: M = P, q = c, the bounds as they are, n rows.
        - dual, P positive definite (proven by a factorisation): C x ≤ d collects what is left of G, A and all finite
          bounds; M = C P⁻¹Cᵀ, q = d + C P⁻¹c, equations as free rows. Symmetric positive semidefinite with a positive
          diagonal, sparse where P⁻¹ is, otherwise dense.
        - kkt, any convex program: M = [[P, Gᵀ, Aᵀ], [−G, 0, 0], [−A, 0, 0]], q = (c, h, b), x within its bounds,
          multipliers of G not negative, those of A free. Monotone, sparse, with zeros on its diagonal.

        auto: direct where it can be; dual where P is positive definite with a condition number (at unit diagonal) of
        at most about 1e6, it has no more rows than kkt, M is not a dense matrix of more than 5000 rows, and no row
        contradicts the bounds (which kkt shows at once); else kkt.

    Returns
    -------
    LCP
        Its ``origin.recover(result)`` gives the :class:`~lcp_plugin.conversions.qp_solution.QPSolution`, with the
        multipliers of all rows and bounds, folded ones included.

    Raises
    ------
    UnsuitableProblem
        form="direct", but rows are left.
    UnsuitableMatrix
        form="dual", but P could not be proven positive definite.
    InvalidProblem
        `program` is no QuadraticProgram.
    InvalidOption
        An unknown form.

    Notes
    -----
    Constraints that contradict one another are not looked for: such a program gives a problem without solution, or
    with one beyond all bounds; ``recover(result).status`` then looks for the proof on the program itself. Where
    `is_stationary` of what ``recover`` returns is False, solve again with a smaller tolerance, or take form="kkt".

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.2.

    Examples
    --------
    The point of x₁ + x₂ ≤ 2 nearest to (1, 2), and what the constraint costs:

    >>> problem = lcp_from_qp(QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2]))
    >>> problem, problem.origin.form
    (LCP(n=1, nonzeros=1, bounds 0 ≤ z), 'dual')
    >>> solution = problem.origin.recover([1.0])
    >>> solution.x, solution.inequality, solution.is_optimal(1e-12)
    (array([0.5, 1.5]), array([1.]), True)
    """
    if not isinstance(program, QuadraticProgram):
        raise InvalidProblem(
            f"lcp_from_qp needs a QuadraticProgram, got {type(program).__name__}; write QuadraticProgram(P, c, …)"
        )
    refuse_nonconvex(program)
    return optimality_conditions(program, form)


def optimality_conditions(program: QuadraticProgram, form: str = "auto") -> LCP:
    """Return what `lcp_from_qp` does, of a program known to be convex."""
    if form not in (*FORMS, "auto"):
        raise InvalidOption(f"form={form!r} is not offered{did_you_mean(form, (*FORMS, 'auto'))}")
    rows = fold_simple_rows(program)
    solver: Solver | None = None
    if form == "dual" or (form == "auto" and _dual_is_small(program, rows)):
        solver = positive_definite_solver(program.P)
    if form == "auto":
        is_dual = solver is not None and condition_estimate(program.P, solver) <= WELL_CONDITIONED
        form = "direct" if not rows.left.size else "dual" if is_dual else "kkt"
    if form == "direct":
        if rows.left.size:
            raise UnsuitableProblem(
                f'form="direct" needs a program with bounds only, but {rows.left.size} rows of G and A have more than '
                'one nonzero (or contradict one another); use form="dual" or form="kkt"'
            )
        direct = DirectForm(program, rows)
        return attach_origin(direct.problem(), direct)
    if form == "kkt":
        kkt = KKTForm(program, rows)
        return attach_origin(kkt.problem(), kkt)
    if solver is None:
        raise UnsuitableMatrix(
            'form="dual" needs P positive definite, but its factorisation found no proof of that; use form="kkt"'
        )
    dual = DualForm.with_solver(program, rows, solver)
    return attach_origin(dual.problem(), dual)


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
    >>> qp_from_lcp(LCP([[2, 1], [1, 2]], [-5, 1]))
    QuadraticProgram(n=2, 0 inequalities, 0 equalities)
    >>> qp_from_lcp(LCP([[2, 3], [1, 2]], [-5, 1]))
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


def _with_infinities(limit: FloatVector) -> FloatVector:
    """Return the limit with ±1e20 and beyond read as ±∞."""
    return np.where(np.abs(limit) >= INFINITE_LIMIT, np.copysign(np.inf, limit), limit)


def _dual_is_small(program: QuadraticProgram, rows: FoldedRows) -> bool:
    """Whether the dual problem is no larger than the KKT one, no large dense matrix, and not clearly insoluble."""
    if not rows.left.size:
        return False
    size = DualForm.size(rows)
    is_small = size <= rows.left.size + program.n and (size <= DENSE_UP_TO_SIZE or is_diagonal(program.P))
    return is_small and not rows.contradict()


def _checked_rows(
    matrix: Any, right: ArrayLike | None, name: str, right_name: str, n: int, *, allow_plus_infinity: bool
) -> tuple[Any, FloatVector]:
    """Return the checked matrix and right-hand side; none of either is no rows."""
    if (matrix is None) != (right is None):
        given, missing = (name, right_name) if right is None else (right_name, name)
        raise InvalidProblem(f"{name} and {right_name} belong together, got {given} without {missing}")
    if matrix is None:
        matrix, right = sp.csr_array((0, n)), np.zeros(0)
    checked = checked_matrix(matrix, name, None, n)
    return checked, checked_vector(right, right_name, checked.shape[0], allow_plus_infinity=allow_plus_infinity)
