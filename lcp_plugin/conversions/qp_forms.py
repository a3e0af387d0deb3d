"""The three shapes in which the optimality conditions of a quadratic program are a complementarity problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..checks import DENSE_UP_TO_SIZE, BoolVector, FloatVector, checked_answer
from ..errors import UnsuitableMatrix, UnsuitableProblem
from ..matrix.definiteness import is_diagonal
from ..matrix.factors import factor_fits
from ..problem.lcp import LCP
from .constraints import FoldedRows
from .least_multipliers import least_multipliers
from .program_matrices import Indices, is_kept_dense
from .qp_solution import QPSolution

if TYPE_CHECKING:
    from .program import QuadraticProgram

WELL_CONDITIONED = 1e6  # the dual form loses as many digits of x as this has
PROGRAM_TOLERANCE = 1e-6  # of `QPSolution.is_optimal`, by default
WORTH = 1e-9  # residuals of a program that small multipliers may have in place of smaller ones
ENTRIES_AT_ONCE = 2**22  # of P⁻¹Cᵀ, whose columns may all be full


@dataclass(frozen=True, eq=False)
class QPOrigin:
    """Where a problem came from: a quadratic program, and the way back to its primal and dual values.

    Attributes
    ----------
    program : QuadraticProgram
    rows : FoldedRows
        The program with its simple rows folded into bounds, ``rows.folded``, whose conditions the problem states.
    form : str
        "direct", "dual" or "kkt".
    """

    program: QuadraticProgram
    rows: FoldedRows
    form: ClassVar[str]

    def problem(self) -> LCP:
        """Return the complementarity problem of this form."""
        raise NotImplementedError

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
        rows, folded = self.program.constraints, self.rows.folded
        if getattr(answer, "is_refuted", False) and self.program.refutation() is not None:
            return QPSolution(self.program, x, *rows.split(np.full(rows.limit.size, np.nan)))
        y[: folded.h.size] = np.maximum(y[: folded.h.size], 0.0)
        found = self._with_bounds(x, y)
        smaller = least_multipliers(folded, x, y)
        if smaller is None:
            return found
        other = self._with_bounds(x, smaller)
        return other if _error(other) <= max(_error(found), WORTH) else found

    def _with_bounds(self, x: FloatVector, y: FloatVector) -> QPSolution:
        """Return the solution of x and multipliers of the rows that are left; those of bounds take what is over."""
        rows, folded = self.program.constraints, self.rows.folded
        # What the bounds have to balance, μ_lower − μ_upper.
        reduced_cost = folded.P @ x + folded.c + y @ folded.matrices.rows
        of_P, of_rows = folded.matrices.magnitudes
        terms = of_P @ np.abs(x) + np.abs(folded.c) + np.abs(y) @ of_rows
        reduced_cost[_is_better_left(folded, x, reduced_cost, terms)] = 0.0
        at_lower = np.where(np.isfinite(folded.lower), np.maximum(reduced_cost, 0.0), 0.0)
        at_upper = np.where(np.isfinite(folded.upper), np.maximum(-reduced_cost, 0.0), 0.0)
        return QPSolution(self.program, x, *rows.split(self.rows.unfold(np.concatenate([y, at_lower, at_upper]))))

    def is_refuted(self, tolerance: float) -> bool:
        """Return whether the program is proved to have no minimum, in units of its own data.

        A contradiction of the problem alone may be one of rounding: an equation 1e-16 = 0 may be all that acts there.
        A tolerance of the problem below 1e-6 is none of the program.
        """
        return self.program.refutation(max(tolerance, PROGRAM_TOLERANCE)) is not None

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector]:
        """Return x and the multipliers of the rows of G and A that are left."""
        raise NotImplementedError


class DirectForm(QPOrigin):
    """M = P, q = c, lower ≤ z ≤ upper; z is x, and w balances the bounds."""

    form = "direct"

    def problem(self) -> LCP:
        """Return the problem of n rows."""
        program, left = self.rows.folded, self.rows.left.size
        if left:
            raise UnsuitableProblem(
                f'form="direct" needs a program with bounds only, but {left} rows of G and A have more than one '
                'nonzero (or contradict one another); use form="dual" or form="kkt"'
            )
        return LCP(program.matrices.hessian, program.c, lower=program.lower, upper=program.upper)

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector]:
        return checked_answer(answer, self.program.n), np.zeros(0)


class KKTForm(QPOrigin):
    """z = (x, λ, ν) with w = (P x + c + Gᵀλ + Aᵀν, h − G x, b − A x)."""

    form = "kkt"

    def problem(self) -> LCP:
        """Return the problem of n + m + p rows; its symmetric part is P beside zeros."""
        program, rows = self.rows.folded, self.rows.left.size
        multiplier = np.where(program.constraints.is_equality[:rows], -np.inf, 0.0)
        return LCP(
            program.matrices.kkt, np.concatenate([program.c, program.constraints.limit[:rows]]),
            lower=np.concatenate([program.lower, multiplier]), upper=np.append(program.upper, np.full(rows, np.inf)),
        )

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector]:
        n = self.program.n
        z = checked_answer(answer, n + self.rows.left.size)
        return z[:n], z[n:].copy()


class DualForm(QPOrigin):
    """z holds the multipliers of C x ≤ d, C = [G; A; I_fixed; −I_lower; I_upper]; w = d − C x, x = −P⁻¹(c + Cᵀz)."""

    form = "dual"

    def is_worthwhile(self) -> bool:
        """Whether it is well conditioned, not clearly insoluble, and easier to solve than the KKT form.

        That is: no more entries even where M is full; or P diagonal and M a graph's Laplacian; or P diagonal, fewer
        rows, and no factor of the KKT form that fits.
        """
        left = self.rows.left.size
        size = left + sum(part.size for part in _bound_rows(self.rows.folded))
        if not left or not (self.program.P.diagonal() > 0.0).all():
            return False
        if not (self._is_smaller(size) or self._is_laplacian() or self._is_all_that_fits(size)):
            return False
        return not self.rows.contradict() and self.program.matrices.condition <= WELL_CONDITIONED

    def _is_smaller(self, size: int) -> bool:
        of_P, of_rows = self.rows.folded.matrices.entries
        return size**2 <= of_P + 2 * of_rows

    def _is_laplacian(self) -> bool:
        """Whether each variable stands in one constraint, or in two with opposite signs: M is an M-matrix then."""
        if self.rows.folded.matrices.most_rows > 2 or not is_diagonal(self.program.P):
            return False
        C = self._constraints[0]
        counts = np.bincount(C.indices, minlength=self.program.n)
        signs = np.bincount(C.indices, np.sign(C.data), minlength=self.program.n)
        return bool(np.all((counts <= 1) | ((counts == 2) & (signs == 0.0))))

    def _is_all_that_fits(self, size: int) -> bool:
        left, n = self.rows.left.size, self.program.n
        if size > left + n or not is_diagonal(self.program.P) or left + n <= DENSE_UP_TO_SIZE:
            return False
        return not factor_fits(self.rows.folded.matrices.kkt.csr)

    def problem(self) -> LCP:
        """Return the problem with one row a constraint."""
        C, d = self._constraints
        m, free = self.rows.folded.h.size, self.rows.folded.b.size + _bound_rows(self.rows.folded)[0].size
        lower = np.zeros(d.size)
        lower[m : m + free] = -np.inf
        q = d + C @ self._solve(self.program.c)
        return LCP(self._delassus(), q, lower=lower)

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector]:
        C, d = self._constraints
        z = checked_answer(answer, d.size)
        return -self._solve(self.program.c + C.T @ z), z[: self.rows.left.size].copy()

    def _delassus(self) -> Any:
        """Return C P⁻¹Cᵀ, exactly symmetric: sparse where it is sparse."""
        C, d = self._constraints
        P = self.program.P
        if is_diagonal(P):
            half = C @ sp.diags_array(1.0 / np.sqrt(P.diagonal()))
            return _kept_as_suits(half @ half.T)
        width = max(1, ENTRIES_AT_ONCE // max(self.program.n, 1))
        parts = []
        for start in range(0, d.size, width):
            # A column of P⁻¹Cᵀ is exactly zero on the blocks of P that the constraint does not touch.
            columns = self._solve(C[start : start + width].T.toarray())
            parts.append(sp.csc_array(C @ columns))
        M = sp.hstack(parts, format="csr") if parts else sp.csr_array((0, 0))
        return _kept_as_suits((M + M.T) * 0.5)

    @cached_property
    def _constraints(self) -> tuple[sp.csr_array, FloatVector]:
        every = self.rows.folded.constraints
        listed = np.concatenate([np.arange(self.rows.left.size), *_bound_rows(self.rows.folded)])
        return every.matrix[listed], every.limit[listed]

    def _solve(self, right: Any) -> Any:
        solver = self.program.matrices.solver
        if solver is None:
            raise UnsuitableMatrix(
                'form="dual" needs P positive definite, but its factorisation found no proof of that; use form="kkt"'
            )
        return solver(right)


FORMS: dict[str, type[QPOrigin]] = {"direct": DirectForm, "dual": DualForm, "kkt": KKTForm}


def _error(solution: QPSolution) -> float:
    return max(solution.residual, solution.row_residual)


def _is_better_left(
    program: QuadraticProgram, x: FloatVector, reduced_cost: FloatVector, terms: FloatVector
) -> BoolVector:
    """Return where a reduced cost is a smaller error as a dual residual than as a multiplier of a bound not reached.

    As a residual it is relative to its terms; as a multiplier, times the distance from the bound, to those of that row.
    """
    size, bound = np.abs(reduced_cost), np.where(reduced_cost > 0.0, program.lower, program.upper)
    with np.errstate(invalid="ignore", over="ignore"):  # an infinite bound has no multiplier anyway
        as_multiplier = size * np.abs(x - bound) / (1.0 + size * np.maximum(np.abs(x), np.abs(bound)))
        as_residual = size / np.minimum(1.0 + terms, program.dual_unit)
        return (program.lower < x) & (x < program.upper) & (as_residual < as_multiplier)


def _bound_rows(program: QuadraticProgram) -> list[Indices]:
    """Return the rows of all constraints that fix a variable, bound one below, and above."""
    is_fixed, rows, n = program.lower == program.upper, program.constraints.rows, program.n
    below, above = (np.isfinite(bound) & ~is_fixed for bound in (program.lower, program.upper))
    return [first + np.flatnonzero(kind) for first, kind in ((rows + n, is_fixed), (rows, below), (rows + n, above))]


def _kept_as_suits(M: sp.csr_array) -> Any:
    """Return a small, full matrix as an ndarray."""
    return M.toarray() if is_kept_dense(M.shape[0], M.nnz) else M
