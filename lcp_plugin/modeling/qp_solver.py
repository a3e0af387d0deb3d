"""Our algorithms as a quadratic programming solver inside cvxpy: ``problem.solve(solver=lcp_plugin.QPSolver)``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from cvxpy import settings
from cvxpy.reductions.solution import Solution, failure_solution
from cvxpy.reductions.solvers import utilities
from cvxpy.reductions.solvers.qp_solvers.qp_solver import QpSolver

from ..problems.programs.criterion import QPSolution
from ..problems.programs.no_minimum import QPInfeasibility
from ..problems.programs.program import QuadraticProgram
from ..problems.programs.solving import QuadraticProgramResult, solve_program
from ._compat import CVXPY_STATUS, name_of, solver_errors, statistics
from .stated_terms import dense_value

BEGUN = "started from the last solution; warm_start=False starts from zero"
PROGRAM = "lcp_plugin.program"  # the key of the last program in the solver cache
MATRIX_KEYS = (settings.P, settings.F, settings.A)
DIGITS = 0.005  # of which the last of three digits is at least a tenth
MOST_NAMED = 5  # constraints that a contradiction lists


class _LCPQuadraticSolver(QpSolver):  # type: ignore[misc]
    """Solves convex quadratic programs, linear ones included, through their linear complementarity problem.

    The status is computed from the program's residuals. Infeasible and unbounded come with a proof,
    ``problem.solver_stats.extra_stats.proof``; cvxpy ≥ 1.9 passes on the multipliers that prove infeasibility as dual
    values, and `conflicting_constraints` names the constraints that have some.

    Stateless, because cvxpy keeps the compiled problem under the first solver object. Options
    go to ``solve``: ``algorithm``, ``tolerance``, ``max_iterations``, ``max_seconds``,
    ``threads`` and the algorithm's own.
    """

    #: cvxpy ≥ 1.9 infers bounds, some of them wrong, for solvers with BOUNDED_VARIABLES. We decline; simple rows
    #: become bounds again in our reduction.
    BOUNDED_VARIABLES = False

    def __call__(self) -> _LCPQuadraticSolver:
        """Return the solver, so that ``QPSolver`` and ``QPSolver()`` are equivalent."""
        return self

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other)

    def __hash__(self) -> int:
        return hash(type(self))

    def name(self) -> str:
        """Return "LCP"."""
        return "LCP"

    def import_solver(self) -> None:
        """Do nothing: it is here."""

    def cite(self, data: Any) -> str:
        """Return the reference of the methods."""
        return "Kumar, Deepmala, Das: More on projected type iteration method and linear complementarity problem."

    def solve_via_data(
        self, data: Any, warm_start: bool, verbose: bool, solver_opts: Any, solver_cache: Any = None
    ) -> Any:
        """Return the answer to the program in cvxpy's form."""
        cache = {} if solver_cache is None else solver_cache
        # Overflow becomes infinite, and raises an error as such.
        with np.errstate(all="ignore"), solver_errors():
            return self._answer(data, warm_start, verbose, solver_opts, cache)

    def _answer(
        self, data: Any, warm_start: bool, verbose: bool, solver_opts: Any, cache: Any
    ) -> QuadraticProgramResult:
        options = dict(solver_opts)
        guess = cache.get(self.name()) if warm_start else None
        program = quadratic_program(data, cache)
        algorithm = options.pop("algorithm", "auto")
        if guess is not None:
            options.setdefault("z0", guess)
        found = solve_program(program, algorithm, verbose=bool(verbose), **options)
        if guess is not None and options["z0"] is guess and found.z is not None:
            found = replace(found, begun=BEGUN)
        # An external solver leaves no z: no complementarity problem was made.
        cache[self.name()] = found.z
        if verbose:
            settings.LOGGER.info(found.explain())
        return found

    def invert(self, result: Any, inverse_data: Any) -> Solution:
        """Return cvxpy's solution: status by the residuals of the quadratic program, values, duals."""
        status, attributes, qp = CVXPY_STATUS[result.status], statistics(result), result.solution
        if status not in settings.SOLUTION_PRESENT:
            attributes["message"] = result.advice if result.proof is None else str(result.proof)
            failed = failure_solution(status, attributes)
            if isinstance(result.proof, QPInfeasibility):
                failed.dual_vars = self._duals(_farkas(result.proof), inverse_data)
            return failed
        values = {inverse_data[self.VAR_ID]: qp.x}
        value = qp.objective + inverse_data[settings.OFFSET]
        return Solution(status, value, values, self._duals(qp, inverse_data), attributes)

    def _duals(self, qp: QPSolution, inverse_data: Any) -> dict[Any, Any]:
        """Return the multipliers by the ids of constraints."""
        duals: dict[Any, Any] = {}
        for values, constraints in (
            (qp.equality, self.EQ_CONSTR),
            (qp.inequality, self.NEQ_CONSTR),
        ):
            duals |= utilities.get_dual_values(
                values, utilities.extract_dual_value, inverse_data[constraints]
            )
        return duals


def _farkas(proof: QPInfeasibility) -> QPSolution:
    """Return the multipliers that prove infeasibility, the largest ±1, as a solution."""
    largest = max(map(abs, proof.multipliers))
    multipliers = np.array([float(y / largest) for y in proof.multipliers])
    return QPSolution.of_rows(proof.program, np.zeros(proof.program.n), multipliers)


def quadratic_program(data: Any, cache: Any) -> QuadraticProgram:
    """Return cvxpy's problem data as a quadratic program: min ½xᵀPx + qᵀx, Ax = b, Fx ≤ g, bounds.

    If the program in the cache has the same matrices, its factorization and scaling are shared.
    """
    n, rows = int(data["n_var"]), (int(data[key]) for key in ("n_var", "n_ineq", "n_eq"))
    P, F, A = given = [
        sp.csc_array((size, n)) if data[key] is None else data[key]
        for size, key in zip(rows, MATRIX_KEYS, strict=True)
    ]
    q, g, b = data[settings.Q], data[settings.G], data[settings.B]
    before: QuadraticProgram | None
    kept, before = cache.get(PROGRAM, ((), None))
    if before is not None and all(map(_are_same, given, kept)):
        return before.with_vectors(q, g, b)
    program = QuadraticProgram(P, q, G=F, h=g, A=A, b=b)
    cache[PROGRAM] = [one.copy() for one in given], program
    return program


def _are_same(one: Any, other: Any) -> bool:
    """Return whether two sparse matrices have the same shape and the same arrays."""
    return one.shape == other.shape and all(
        np.array_equal(getattr(one, part), getattr(other, part))
        for part in ("indptr", "indices", "data")
    )


QPSolver = _LCPQuadraticSolver()


def _rounded_down(value: float) -> str:
    """Return three digits of a lower bound that are no more than it."""
    text = f"{value:.3g}"
    return text if float(text) <= value else f"{value * (1.0 - DIGITS):.3g}"


def conflicting_constraints(problem: Any, proof: QPInfeasibility) -> str:
    """Return the constraints of an infeasible problem that have a multiplier, the largest first, and their violation.

    Parameters
    ----------
    problem : cvxpy.Problem
        Solved by QPSolver: its dual values are the multipliers that prove infeasibility.
    proof : QPInfeasibility
        ``problem.solver_stats.extra_stats.proof``.
    """
    weights = []
    for constraint in problem.constraints:
        dual = constraint.dual_value
        if dual is None or not np.any(values := np.atleast_1d(np.abs(dense_value(dual)))):
            continue
        first = np.unravel_index(np.argmax(values), values.shape)
        entry = "" if values.size == 1 else f", entry {', '.join(map(str, map(int, first)))}"
        others = int(np.count_nonzero(values)) - 1
        more = f" and {others} more of its entries" if others else ""
        weights.append((float(values.max()), f"{name_of(constraint)}{entry}{more}"))
    weights.sort(key=lambda pair: -pair[0])
    named = "; ".join(name for _, name in weights[:MOST_NAMED])
    left = f"; and {len(weights) - MOST_NAMED} more" if len(weights) > MOST_NAMED else ""
    if not named:
        return ""
    what = "are inconsistent" if len(weights) > 1 else "cannot hold"
    return f"{named}{left} {what}: every point violates a constraint by {_rounded_down(proof.least_violation)} or more"
