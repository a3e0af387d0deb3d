"""The three shapes in which the optimality conditions of a quadratic program are a complementarity problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..checks import DENSE_ABOVE_DENSITY, DENSE_UP_TO_SIZE, FloatVector
from ..errors import UnsuitableMatrix
from ..matrix.definiteness import Solver, is_diagonal, positive_definite_solver
from ..problem.lcp import LCP
from .checked import checked_answer
from .qp_solution import QPSolution
from .simple_rows import FoldedRows

if TYPE_CHECKING:
    from .quadratic_program import QuadraticProgram

FORMS = ("direct", "dual", "kkt")
PROGRAM_TOLERANCE = 1e-6  # of `QPSolution.is_optimal`, by default
ENTRIES_AT_ONCE = 2**22  # of P⁻¹Cᵀ, whose columns may all be full


@dataclass(frozen=True, eq=False)
class QPOrigin:
    """Where a problem came from: a quadratic program, and the way back to its primal and dual values.

    Attributes
    ----------
    program : QuadraticProgram
    rows : FoldedRows
        What is left of its rows, and its bounds with the others folded in.
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
        x, inequality, equality = self._split(answer)
        if getattr(answer, "is_refuted", False) and self.program.refutation() is not None:
            program = self.program
            sizes = program.h.size, program.b.size, program.n, program.n
            return QPSolution(program, x, *(np.full(size, np.nan) for size in sizes))
        reduced_cost = self.program.P @ x + self.program.c
        reduced_cost = reduced_cost + self._G.T @ inequality + self._A.T @ equality
        return QPSolution(
            self.program, x, *self.rows.spread(self.program, inequality, equality, reduced_cost)
        )

    def is_refuted(self, tolerance: float) -> bool:
        """Return whether the program is proved to have no minimum, in units of its own data.

        A contradiction of the problem alone may be one of rounding: an equation 1e-16 = 0 may be all that acts there.
        A tolerance of the problem below 1e-6 is none of the program.
        """
        return self.program.refutation(max(tolerance, PROGRAM_TOLERANCE)) is not None

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector, FloatVector]:
        """Return x and the multipliers of the rows that are left of G and of A."""
        raise NotImplementedError

    @cached_property
    def _G(self) -> sp.csr_array:
        return sp.csr_array(self.program.G)[self.rows.inequalities]

    @cached_property
    def _A(self) -> sp.csr_array:
        return sp.csr_array(self.program.A)[self.rows.equalities]

    @property
    def _h(self) -> FloatVector:
        right: FloatVector = self.program.h[self.rows.inequalities]
        return right

    @property
    def _b(self) -> FloatVector:
        right: FloatVector = self.program.b[self.rows.equalities]
        return right


class DirectForm(QPOrigin):
    """M = P, q = c, lower ≤ z ≤ upper; z is x, and w balances the bounds."""

    form = "direct"

    def problem(self) -> LCP:
        """Return the problem of n rows."""
        return LCP(self.program.P, self.program.c, lower=self.rows.lower, upper=self.rows.upper)

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector, FloatVector]:
        return checked_answer(answer, self.program.n), np.zeros(0), np.zeros(0)


class KKTForm(QPOrigin):
    """z = (x, λ, ν) with w = (P x + c + Gᵀλ + Aᵀν, h − G x, b − A x)."""

    form = "kkt"

    def problem(self) -> LCP:
        """Return the problem of n + m + p rows; its symmetric part is P beside zeros."""
        m, p = self._h.size, self._b.size
        return LCP(
            self._matrix(),
            np.concatenate([self.program.c, self._h, self._b]),
            lower=np.concatenate([self.rows.lower, np.zeros(m), np.full(p, -np.inf)]),
            upper=np.concatenate([self.rows.upper, np.full(m + p, np.inf)]),
        )

    def _matrix(self) -> Any:
        """Return M, an ndarray where it is small and full."""
        P, C = self.program.P, sp.vstack([self._G, self._A], format="csr")
        n, rows = self.program.n, C.shape[0]
        nonzeros = (P.nnz if sp.issparse(P) else np.count_nonzero(P)) + 2 * C.nnz
        if n + rows > DENSE_UP_TO_SIZE or nonzeros <= DENSE_ABOVE_DENSITY * (n + rows) ** 2:
            return sp.block_array([[sp.csr_array(P), C.T], [-C, sp.csr_array((rows, rows))]], format="csr")
        M = np.zeros((n + rows, n + rows))
        M[:n, :n] = P.toarray() if sp.issparse(P) else P
        M[n:, :n] = -C.toarray()
        M[:n, n:] = C.toarray().T
        return M

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector, FloatVector]:
        n, m, p = self.program.n, self._h.size, self._b.size
        x, inequality, equality = np.split(checked_answer(answer, n + m + p), [n, n + m])
        return x, np.maximum(inequality, 0.0), equality


class DualForm(QPOrigin):
    """z holds the multipliers of C x ≤ d, C = [G; A; I_fixed; −I_lower; I_upper]; w = d − C x, x = −P⁻¹(c + Cᵀz)."""

    form = "dual"

    @classmethod
    def with_solver(cls, program: QuadraticProgram, rows: FoldedRows, solver: Solver) -> DualForm:
        """Return the form with the factorisation that proved P positive definite."""
        made = cls(program, rows)
        made.__dict__["_solve"] = solver
        return made

    @staticmethod
    def size(rows: FoldedRows) -> int:
        """Return the number of rows of the problem."""
        fixed, below, above = _bound_rows(rows)
        return rows.count + int(fixed.size + below.size + above.size)

    def problem(self) -> LCP:
        """Return the problem with one row a constraint."""
        C, d = self._constraints
        m, free = self._h.size, self._b.size + _bound_rows(self.rows)[0].size
        lower = np.zeros(d.size)
        lower[m : m + free] = -np.inf
        return LCP(self._delassus(), d + C @ self._solve(self.program.c), lower=lower)

    def _split(self, answer: Any) -> tuple[FloatVector, FloatVector, FloatVector]:
        C, d = self._constraints
        z = checked_answer(answer, d.size)
        x = -self._solve(self.program.c + C.T @ z)
        m, p = self._h.size, self._b.size
        return x, np.maximum(z[:m], 0.0), z[m : m + p]

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
        fixed, below, above = _bound_rows(self.rows)
        identity = sp.eye_array(self.program.n, format="csr")
        C = sp.vstack([self._G, self._A, identity[fixed], -identity[below], identity[above]], format="csr")
        lower, upper = self.rows.lower, self.rows.upper
        return C, np.concatenate([self._h, self._b, upper[fixed], -lower[below], upper[above]])

    @cached_property
    def _solve(self) -> Solver:
        solver = positive_definite_solver(self.program.P)
        if solver is None:
            raise UnsuitableMatrix('form="dual" needs P positive definite; use form="kkt"')
        return solver

    def __getstate__(self) -> dict[str, Any]:
        """Leave the factorisation behind, which cannot be pickled and can be computed again."""
        return {name: value for name, value in self.__dict__.items() if name != "_solve"}


def _bound_rows(rows: FoldedRows) -> tuple[Any, Any, Any]:
    """Return the variables that are fixed, those bounded below, and those bounded above."""
    fixed = rows.lower == rows.upper
    below, above = np.isfinite(rows.lower) & ~fixed, np.isfinite(rows.upper) & ~fixed
    return np.flatnonzero(fixed), np.flatnonzero(below), np.flatnonzero(above)


def _kept_as_suits(M: sp.csr_array) -> Any:
    """Return a small, full matrix as an ndarray."""
    n = M.shape[0]
    return M.toarray() if n <= DENSE_UP_TO_SIZE and M.nnz > DENSE_ABOVE_DENSITY * n * n else M
