"""Result of a quadratic program: a point, its two measures on the unscaled program, and the status that they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.checks import Vector
from ...core.entries import max_norm
from ...core.names import describe_radius, three_digits_below
from ...core.settings import Status
from ...judges.program import ROWS, SHARP
from ...judges.worst_rows import WorstRows
from ...solving.result import NEXT, BaseResult
from .no_minimum import NoMinimum
from .program import QuadraticProgram
from .solution import MULTIPLIERS, QPSolution, worst_constraints

# ratio of coefficients, above which a sum loses half of the digits of its small terms
FAR_APART = 1e8
ADVICE = {
    Status.SOLVED: "x is optimal within the tolerance, as measured on your data",
    Status.PRECISION_LIMIT: "the residuals are small, but not within the tolerance",
    Status.INFEASIBLE: "no x satisfies all constraints; next: print(result.conflict), which of them conflict",
    Status.STALLED: (
        "no point passes the test, and no proof of infeasibility or unboundedness was found or requested; "
        "next: check the data and their units"
    ),
}


@dataclass(frozen=True, eq=False, repr=False)
class QuadraticProgramResult(BaseResult):
    """Result of a quadratic program, tested on the unscaled program.

    Attributes
    ----------
    status : Status
        SOLVED (optimal) by the two measures, INFEASIBLE or UNBOUNDED with a proof, PRECISION_LIMIT if the measures
        are small, but above the tolerance; otherwise why the run ended.
    solution : QPSolution
        x, the multipliers and the two measures.
    algorithm, iterations, seconds
        Steps of the solver that found this point; wall-clock seconds of the entire run.
    tolerance : float
        Tolerance of the duality gap; rows are tested to 1e-9 at every tolerance.
    proof : QPInfeasibility or QPUnboundedness or None
        Proof of INFEASIBLE or UNBOUNDED.
    stages : tuple of StageRecord
        Stages of the run, in order.
    history : tuple of Sample
        With ``record=True``, the start and the end of an external solver, or the samples of a run on the LCP.
    begun : str
        Same meaning as in :class:`lcp_plugin.Result`.
    doubtful : QPInfeasibility or QPUnboundedness or None
        Proof that holds only by rounding, or only within a radius, so that it excludes no solution.
    """

    _advice = ADVICE

    solution: QPSolution
    proof: NoMinimum | None = None
    doubtful: NoMinimum | None = None

    @property
    def program(self) -> QuadraticProgram:
        """The program."""
        return self.solution.program

    @property
    def x(self) -> Vector:
        """Minimizer, or the best point found, shape (n,); NaN if the program is proved infeasible or unbounded."""
        return self.solution.x

    @property
    def z(self) -> Vector:
        """X and the multipliers of the rows that are not bounds: a start for a further run."""
        return np.concatenate([self.x, self.solution.reduced_y])

    @property
    def objective(self) -> float | None:
        """Objective in the sense of the program; None if the program is proved infeasible or unbounded."""
        return None if self.has_no_solution else self.program.sense * self.solution.objective + 0.0

    @property
    def duals(self) -> dict[str, Vector]:
        """The multipliers ``inequality``, ``equality``, ``lower``, ``upper``, with cvxpy's signs."""
        return {name: getattr(self.solution, name) for name in MULTIPLIERS}

    def _advice_of_status(self) -> str:
        happened, begins, to_do = super()._advice_of_status().partition(NEXT)
        if self.status is Status.PRECISION_LIMIT:
            begins, to_do = NEXT, self._way_to_precision()
            if self.doubtful is not None:
                happened = self.doubtful.doubt
            elif self.tolerance < self._rounding_level:
                happened = f"the tolerance {self.tolerance:.0e} is below the rounding level {self._rounding_level:.0e}"
        return happened + begins + to_do

    @property
    def _rounding_level(self) -> float:
        """Gap below which plain sums of the program do not measure."""
        return SHARP * sum(self.program.matrices.terms.C.shape)

    def _way_to_precision(self) -> str:
        """Return the next step for a point that nearly passes: scaling only if the sizes of coefficients differ."""
        terms = self.program.matrices.terms
        sizes = np.abs(np.concatenate([terms.rows.data, terms.sparse_P.data, self.program.c]))
        sizes = sizes[sizes > 0.0]
        if sizes.size and sizes.max() > FAR_APART * sizes.min():
            return (
                f"rescale the data, whose coefficients are {sizes.min():.0e} to {sizes.max():.0e}"
            )
        if self.solution.primal_residual > ROWS:
            return "print(certify(program, result).worst()), which rows fail"
        return f"set a tolerance above {max(self.solution.duality_gap, self._rounding_level):.0e}"

    def _clauses(self) -> list[str]:
        """Return doubts: larger x that a proof does not exclude, a program that is not convex, an x inside a face."""
        if self.has_no_solution:
            points = "" if self.proof is None else describe_radius(self.proof.radius, "x")
            return [f"of {points}: a larger one is not excluded"] if points else []
        if self.is_solved and not self.program.matrices.has_curvature and not self._is_vertex():
            return [
                'the optimum is not unique, and x is not a vertex: solve(program, "highs") returns one if there is one'
            ]
        if self.program.is_convex is not False:
            return []
        doubt = "at rounding level or of fixed unknowns"
        if not self.is_solved:
            doubt = "so the program is not convex, unless this is a rounding error"
        return [f"P has a negative eigenvalue, {doubt}"]

    def _is_vertex(self) -> bool:
        """Return whether active rows and bounds determine x; True also if this is not computed, for many rows."""
        program, size = self.program, ROWS * max_norm(self.x)
        is_free = (self.x > program.lower + size) & (self.x < program.upper - size)
        rows, limit = program.matrices.terms.rows, np.append(program.h, program.b)
        terms = abs(rows) @ np.abs(self.x) + np.abs(limit)
        is_active = np.isfinite(limit) & (np.abs(rows @ self.x - limit) <= ROWS * terms)
        free, active = np.count_nonzero(is_free), np.count_nonzero(is_active)
        if free > active or free == 0:
            return free == 0
        if free > 1000:  # a rank of a second
            return True
        return bool(np.linalg.matrix_rank(rows[is_active][:, is_free].toarray()) == free)

    def _worst(self, count: int) -> WorstRows:
        y = np.concatenate([self.solution.inequality, self.solution.equality])
        return worst_constraints(self.program, self.x, y, self.tolerance, count)

    def describe_accuracy(self) -> str:
        """Return the two measures and their tolerances, or the proof of infeasibility or unboundedness, as text."""
        if self.proof is None:
            solution = self.solution
            return (
                f"objective {self.objective:.9g}; constraints are violated by {solution.primal_residual:.1e} "
                f"(tolerance {ROWS:.0e}), the duality gap is {solution.duality_gap:.1e} "
                f"(tolerance {self.tolerance:.0e}), each relative to its terms"
            )
        least = getattr(self.proof, "least_violation", 0.0)
        missed = f"\nevery point violates a constraint by {three_digits_below(least)} or more"
        return f"{self.proof}{missed if least else ''}"
