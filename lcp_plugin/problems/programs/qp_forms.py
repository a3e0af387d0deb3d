"""The optimality (KKT) conditions of a quadratic program as a complementarity problem, and the way back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector, checked_answer
from ...core.lcp import LCP
from ...proofs.no_solution.farkas import linear_program
from .criterion import PROGRAM_TOLERANCE, program_goal
from .program_matrices import as_csr, sums_and_terms
from .qp_solution import QPSolution
from .reductions import Reduction

if TYPE_CHECKING:
    from .program import QuadraticProgram
    from .qp_proofs import QPInfeasibility, QPUnboundedness

WORTH = 1e-9  # residuals of a program that small multipliers may have in place of smaller ones
CANCELS = 100.0  # times the gradient: terms that may be small, as they cancel
CANCELS_MUCH = 1e3  # the same, where the residuals are small as it is: the search takes as long as the run
ACTIVE = 1e-7  # of the unit of a row
LARGEST = 5000  # variables and rows of a program that is worth a linear program
LARGEST_IN_PASSING = 1500  # the same, where the residuals are small as it is
LARGEST_DENSE = 1_000_000  # entries of a least squares problem; .1 s; and of the active rows of a linear program
EXACTLY = 1e-12  # of the gradient: what a vertex of a linear program leaves, as a rule
RANK = 1e-12  # beside the largest singular value: what should depend on each other is independent by rounding


@dataclass(frozen=True, eq=False)
class QPOrigin:
    """Where a problem came from: a quadratic program, and the way back to its primal and dual values.

    Attributes
    ----------
    reduction : Reduction
        The program, and what is left of it, whose conditions the problem states: variables that are only defined put
        in, or not, and simple rows folded into bounds.

    Notes
    -----
    z = (x, λ, ν) with w = (P x + c + Gᵀλ + Aᵀν, h − G x, b − A x), of the rows that are left; where none are, that is
    the direct form: M = P, q = c, the bounds as they are.
    """

    reduction: Reduction
    is_of_convex_program: ClassVar[bool] = True
    _latest: dict[bytes, QPSolution] = field(default_factory=dict, init=False, repr=False)  # what was recovered last
    _proofs: list[Any] = field(default_factory=list, init=False, repr=False)
    _attempted: list[str] = field(default_factory=list, init=False, repr=False)

    @property
    def program(self) -> QuadraticProgram:
        """The program that was given."""
        return self.reduction.program

    @property
    def rows(self) -> int:
        """How many rows of G and A are left."""
        return self.reduction.reduced.constraints.rows

    @property
    def form(self) -> str:
        """"direct" where bounds are all that is left, else "kkt"."""
        return "kkt" if self.rows else "direct"

    def problem(self) -> LCP:
        """Return the problem of n + m + p rows; its symmetric part is P beside zeros."""
        program, rows = self.reduction.reduced, self.rows
        multiplier = np.where(program.constraints.is_equality[:rows], -np.inf, 0.0)
        return LCP(
            program.matrices.kkt if rows else program.matrices.hessian,
            np.concatenate([program.c, program.constraints.limit[:rows]]),
            lower=np.concatenate([program.lower, multiplier]), upper=np.append(program.upper, np.full(rows, np.inf)),
        )

    def stated(self, x: FloatVector, multipliers: FloatVector) -> FloatVector:
        """Return z of an x and multipliers of all constraints of the program; NaN counts as 0."""
        x, multipliers = self.reduction.inward(x, np.nan_to_num(multipliers))
        return np.append(x, multipliers[: self.rows])

    def recover(self, answer: Any) -> QPSolution:
        """Return the program's solution that an answer of the complementarity problem stands for.

        Parameters
        ----------
        answer : Result or array, shape (rows of the problem,)
            Right or wrong: the solution's residuals say which. Multipliers of inequalities lose a wrong sign here. A
            result with a proof that there is no solution has no multipliers, NaN, where the program is refuted too:
            what is a contradiction beside the problem's data may be none beside the program's.

        Raises
        ------
        InvalidProblem
            Where it is no finite vector of that length.
        """
        x, y = self._split(answer)
        if getattr(answer, "is_refuted", False) and self.program.refutation() is not None:
            return QPSolution.without_multipliers(self.program, self.reduction.point(x))
        key = x.tobytes() + y.tobytes()
        solution = self._latest.get(key)  # a run's judge may have asked for it
        if solution is None:
            solution = self._solution(x, y)
            self._latest.clear()
            self._latest[key] = solution
        return solution

    def is_answered(self, z: FloatVector, tolerance: float) -> bool:
        """Return whether the program's own criteria hold at what z stands for, where a run has this tolerance."""
        goal = program_goal(tolerance)
        if not np.isfinite(z).all() or not (solution := self.recover(z)).is_stationary(goal):
            return False
        return solution.is_sure(goal) or self.program.refutation(goal, is_met=True) is None

    def _solution(self, x: FloatVector, y: FloatVector) -> QPSolution:
        """Return the solution of x and multipliers y, or of smaller ones that are as good."""
        folded = self.reduction.reduced
        y[: folded.h.size] = np.maximum(y[: folded.h.size], 0.0)
        found = self._with_bounds(x, y)
        is_small = found.error <= WORTH
        if is_small and folded.n + y.size > LARGEST_IN_PASSING:
            return found
        smaller = least_multipliers(folded, x, y, CANCELS_MUCH if is_small else CANCELS)
        if smaller is None:
            return found
        other = self._with_bounds(x, smaller)
        return other if other.error <= max(found.error, WORTH) else found

    def _with_bounds(self, x: FloatVector, y: FloatVector) -> QPSolution:
        """Return the solution of x and multipliers of the rows that are left; those of bounds take what is over."""
        folded = self.reduction.reduced
        if not (np.isfinite(folded.lower) | np.isfinite(folded.upper)).any():
            return self._whole(x, np.append(y, np.zeros(2 * x.size)))
        # What the bounds have to balance, μ_lower − μ_upper.
        of_rows, sizes = sums_and_terms(folded.matrices.rows, y)
        reduced_cost = folded.P @ x + folded.c + of_rows
        terms = folded.matrices.magnitudes @ np.abs(x) + np.abs(folded.c) + sizes
        reduced_cost[_is_better_left(folded, x, reduced_cost, terms)] = 0.0
        at_lower = np.where(np.isfinite(folded.lower), np.maximum(reduced_cost, 0.0), 0.0)
        at_upper = np.where(np.isfinite(folded.upper), np.maximum(-reduced_cost, 0.0), 0.0)
        return self._whole(x, np.concatenate([y, at_lower, at_upper]))

    def _whole(self, x: FloatVector, multipliers: FloatVector) -> QPSolution:
        """Return the program's solution from x and the multipliers of the rows that are left, and of all bounds."""
        return QPSolution.of_rows(self.program, *self.reduction.outward(x, multipliers))

    def is_refuted(self, tolerance: float) -> bool:
        """Return whether the program is proved to have no minimum, in units of its own data.

        A contradiction of the problem alone may be one of rounding: an equation 1e-16 = 0 may be all that acts there.
        A tolerance of the problem below 1e-6 is none of the program.
        """
        return self.program.refutation(max(tolerance, PROGRAM_TOLERANCE)) is not None

    def end_by(self, proof: QPInfeasibility | QPUnboundedness) -> None:
        """Take note of the proof that ends a run."""
        self._proofs[:] = [proof]

    @property
    def ended_by(self) -> QPInfeasibility | QPUnboundedness | None:
        """The proof that has ended a run, if one has."""
        return self._proofs[0] if self._proofs else None

    def note_attempt(self, name: str) -> None:
        """Take note of an algorithm that has ended without an answer before there is a run, which starts there."""
        self._attempted.append(name)

    @property
    def attempted(self) -> tuple[str, ...]:
        """The algorithms that have ended without an answer before there is a run, which starts where they ended."""
        return tuple(self._attempted)

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector]:
        """Return x and the multipliers of the rows of G and A that are left."""
        n = self.reduction.reduced.n
        z = checked_answer(answer, n + self.rows)
        return z[:n], z[n:].copy()


def _is_better_left(
    program: QuadraticProgram, x: FloatVector, reduced_cost: FloatVector, terms: FloatVector
) -> BoolVector:
    """Return where a reduced cost is a smaller error as a dual residual than as a multiplier of a bound not reached.

    As a residual it is relative to its terms; as a multiplier, times the distance from the bound, to those of that row.
    """
    size, bound = np.abs(reduced_cost), np.where(reduced_cost > 0.0, program.lower, program.upper)
    with np.errstate(invalid="ignore", over="ignore"):  # an infinite bound has no multiplier anyway
        unknown, objective = program.units.unknown, program.units.objective
        as_multiplier = size * np.abs(x - bound) / (objective + size * np.maximum(np.abs(x), np.abs(bound)))
        as_residual = size / np.minimum(objective / unknown + terms, program.dual_unit)
        return (program.lower < x) & (x < program.upper) & (as_residual < as_multiplier)


def least_multipliers(
    program: QuadraticProgram, x: FloatVector, y: FloatVector, cancels: float = CANCELS
) -> FloatVector | None:
    """Return multipliers of G and A of the least Σ|y_i| + Σ|μ_j|, μ those of bounds; None where these cancel nothing.

    Only those of active constraints differ from 0. Nothing is judged here: look at the residuals.

    Parameters
    ----------
    x : array, shape (n,)
    y : array, shape (rows of G + rows of A,)
        Some multipliers.
    cancels : float
        None is returned where their terms are at most so many times as large as the gradient.

    Notes
    -----
    Where active rows depend on each other, or variables are fixed, multipliers are not unique, and a method ends with
    any: those of 5e12 cancel to what some of 1e3 say at once, less their rounding.

    One linear program, then least squares on the multipliers that it leaves: their error is that of rounding, where
    the linear program's is 1e-9. Σ|·| is at most the number of nonzeros times the largest of any others.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> twice = QuadraticProgram(np.eye(1), [0.0], A=[[1.0], [2.0]], b=[1.0, 2.0])
    >>> least_multipliers(twice, np.ones(1), np.array([-1e9 - 1.0, 5e8]))
    array([ 0. , -0.5])
    """
    rows, count = program.matrices.rows, y.size
    gradient = np.asarray(program.P @ x + program.c)
    size = float(np.abs(gradient).max(initial=0.0))
    terms = program.matrices.row_sizes[:count] * np.abs(y)
    if not terms.max(initial=0.0) > cancels * size or not 0.0 < size < np.inf or program.n + count > LARGEST:
        return None
    limits, is_equality = program.constraints.limit[:count], program.constraints.is_equality[:count]
    unit = program.constraints.unit[:count]
    with np.errstate(invalid="ignore"):
        active = is_equality | (limits - rows @ x <= ACTIVE * unit)
        at_lower = x - program.lower <= ACTIVE * (program.units.unknown + np.abs(x))
        at_upper = program.upper - x <= ACTIVE * (program.units.unknown + np.abs(x))
    listed, found = np.flatnonzero(active), np.zeros(count)
    columns = sp.csc_array(as_csr(rows)[listed].T)
    if columns.nnz > LARGEST_DENSE:
        return None
    identity = sp.eye_array(program.n, format="csc")
    free = is_equality[listed]
    parts = [columns, -columns[:, np.flatnonzero(free)],
             -identity[:, np.flatnonzero(at_lower)], identity[:, np.flatnonzero(at_upper)]]
    matrix = sp.csc_array(sp.hstack(parts, format="csc"))
    answer = linear_program(np.ones(matrix.shape[1]), matrix, -gradient / size, (0.0, None), (None, None))
    if answer is None:
        return None
    found[listed] = answer.x[: listed.size]
    found[listed[free]] -= answer.x[listed.size : listed.size + int(free.sum())]
    _, _, below, above = np.split(answer.x, np.cumsum([part.shape[1] for part in parts[:3]]))
    is_balanced = np.zeros(program.n, dtype=bool)
    is_balanced[np.flatnonzero(at_lower)[below > 0.0]] = is_balanced[np.flatnonzero(at_upper)[above > 0.0]] = True
    return _polished(program, gradient, size * found, is_balanced)


def _polished(
    program: QuadraticProgram, gradient: FloatVector, y: FloatVector, is_balanced: BoolVector
) -> FloatVector:
    """Return the multipliers near y, 0 where they are 0, that leave least of the gradient where no bound takes it."""
    from scipy.linalg import solve_triangular

    used, left = np.flatnonzero(y), np.flatnonzero(~is_balanced)
    rest = np.abs(gradient + y @ program.matrices.rows)[left].max(initial=0.0)
    if rest > EXACTLY * np.abs(gradient).max() and used.size * left.size <= LARGEST_DENSE:
        block = as_csr(program.matrices.rows)[used][:, left].toarray().T
        y, (Q, R) = y.copy(), np.linalg.qr(block)
        sizes = np.abs(R.diagonal())
        # Rows of a vertex of that linear program are independent as a rule.
        has_rank = used.size <= left.size and sizes.min() > RANK * sizes.max()
        for _ in range(2):  # the second takes off what the first has rounded
            rest = gradient[left] + block @ y[used]
            y[used] -= solve_triangular(R, Q.T @ rest) if has_rank else np.linalg.lstsq(block, rest, rcond=RANK)[0]
    is_inequality = ~program.constraints.is_equality[: y.size]
    return np.where(is_inequality, np.maximum(y, 0.0), y)
