"""Our algorithms as a quadratic programming solver inside cvxpy: ``problem.solve(solver=lcp_plugin.QPSolver)``."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from cvxpy import settings
from cvxpy.reductions.solution import Solution, failure_solution
from cvxpy.reductions.solvers import utilities
from cvxpy.reductions.solvers.qp_solvers.qp_solver import QpSolver

from ..conversions.qp_proofs import QPInfeasibility, QPUnboundedness
from ..conversions.quadratic_program import QuadraticProgram
from ..result import Result, Status
from .qp_attempts import ended_by_caller, kkt_goal, solve_quadratic_program

SOLVE_OPTIONS = {"tolerance": 1e-9}


class _LCPQuadraticSolver(QpSolver):  # type: ignore[misc]
    """Solves convex quadratic programs, linear ones included, through their linear complementarity problem.

    The status is judged by the program's own residuals; infeasible and unbounded are said only with a proof, which
    is then found in ``problem.solver_stats.extra_stats``.

    Stateless: cvxpy keeps the compiled problem under the solver object, and uses the first one for ever. Options
    go to ``solve``: ``algorithm``, ``tolerance``, ``max_iterations``, ``max_seconds`` and the algorithm's own.
    """

    MIP_CAPABLE = False
    BOUNDED_VARIABLES = False

    def __call__(self) -> _LCPQuadraticSolver:
        """Return itself, so that ``QPSolver`` and ``QPSolver()`` mean the same."""
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
        """Return where the methods come from."""
        return "Kumar, Deepmala, Das: More on projected type iteration method and linear complementarity problem."

    def solve_via_data(
        self, data: Any, warm_start: bool, verbose: bool, solver_opts: Any, solver_cache: Any = None
    ) -> Any:
        """Return (result, solution, status, proof of no minimum or None) of the program in cvxpy's form."""
        options = {**SOLVE_OPTIONS, **solver_opts}
        program = quadratic_program(data)
        previous = solver_cache.get(self.name()) if warm_start and solver_cache is not None else None
        algorithm = options.pop("algorithm", "auto")
        result, solution = solve_quadratic_program(program, algorithm, guess=previous, **options)
        if solver_cache is not None:
            solver_cache[self.name()] = result.z
        proof = None
        is_optimal = solution.is_optimal(kkt_goal(options["tolerance"]))
        is_proven = program.__dict__.get("proof_of_no_minimum") is not None
        if not is_optimal and (is_proven or not ended_by_caller(result, options)):
            proof = program.proof_of_no_minimum
        if verbose:
            settings.LOGGER.info(result.explain() if proof is None else f"{result.explain()}\n{proof}")
        return result, solution, _status(result, is_optimal, proof), proof

    def invert(self, solution: Any, inverse_data: Any) -> Solution:
        """Return cvxpy's solution: status by the residuals of the quadratic program, values, duals."""
        result, qp, status, proof = solution
        attributes = {
            settings.SOLVE_TIME: result.seconds,
            settings.SETUP_TIME: result.setup_seconds,
            settings.NUM_ITERS: result.iterations,
            settings.EXTRA_STATS: result if proof is None else proof,
        }
        if status not in settings.SOLUTION_PRESENT:
            attributes["message"] = result.advice if proof is None else str(proof)
            return failure_solution(status, attributes)
        values = {inverse_data[self.VAR_ID]: qp.x}
        value = qp.objective + inverse_data[settings.OFFSET]
        return Solution(status, value, values, self._duals(qp, inverse_data), attributes)

    def _duals(self, qp: Any, inverse_data: Any) -> dict[Any, Any]:
        """Return the multipliers in the layout that this version of cvxpy wants."""
        if self.EQ_CONSTR not in inverse_data:
            return {self.DUAL_VAR_ID: np.concatenate([qp.equality, qp.inequality])}
        equalities = utilities.get_dual_values(
            qp.equality, utilities.extract_dual_value, inverse_data[self.EQ_CONSTR]
        )
        inequalities = utilities.get_dual_values(
            qp.inequality, utilities.extract_dual_value, inverse_data[self.NEQ_CONSTR]
        )
        return {**equalities, **inequalities}


def quadratic_program(data: Any) -> QuadraticProgram:
    """Return cvxpy's problem data as a quadratic program: min ½xᵀPx + qᵀx, Ax = b, Fx ≤ g, bounds."""
    n = int(data["n_var"])
    lower, upper = data.get(settings.LOWER_BOUNDS), data.get(settings.UPPER_BOUNDS)
    return QuadraticProgram(
        _csr(data[settings.P], (n, n)), np.asarray(data[settings.Q], dtype=np.float64),
        G=_csr(data[settings.F], (int(data["n_ineq"]), n)), h=np.asarray(data[settings.G], dtype=np.float64),
        A=_csr(data[settings.A], (int(data["n_eq"]), n)), b=np.asarray(data[settings.B], dtype=np.float64),
        lower=-np.inf if lower is None else lower, upper=np.inf if upper is None else upper,
    )


def _csr(matrix: Any, shape: tuple[int, int]) -> sp.csr_array:
    return sp.csr_array(shape) if matrix is None else sp.csr_array(matrix)


def _status(result: Result, is_optimal: bool, proof: QPInfeasibility | QPUnboundedness | None) -> str:
    if proof is not None:
        return str(settings.INFEASIBLE if isinstance(proof, QPInfeasibility) else settings.UNBOUNDED)
    if result.status in (Status.SOLVED, Status.PRECISION_LIMIT):
        return str(settings.OPTIMAL if is_optimal else settings.OPTIMAL_INACCURATE)
    if is_optimal and result.status is Status.STALLED:  # below the program's tolerance, not the run's own
        return str(settings.OPTIMAL)
    return str(settings.SOLVER_ERROR if result.status is Status.DIVERGED else settings.USER_LIMIT)


QPSolver = _LCPQuadraticSolver()
