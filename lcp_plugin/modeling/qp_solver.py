"""Our algorithms as a quadratic programming solver inside cvxpy: ``problem.solve(solver=lcp_plugin.QPSolver)``."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from cvxpy import settings
from cvxpy.reductions.solution import Solution, failure_solution
from cvxpy.reductions.solvers import utilities
from cvxpy.reductions.solvers.qp_solvers.qp_solver import QpSolver

from ..conversions.quadratic_program import QuadraticProgram, lcp_from_qp
from ..conversions.substitution import substitute_definitions
from ..driver import solve as solve_lcp
from ..errors import UnsuitableMatrix, UnsupportedModel
from ..problem import LCP
from ..result import Result, Status

KKT_TOLERANCE = 1e-6
LARGEST_CHECKED = 5000
SOLVE_OPTIONS = {"tolerance": 1e-9}
NOT_STRICTLY_CONVEX = (
    "this program is not strictly convex, which no algorithm here solves yet; use another cvxpy solver, or add a "
    "small multiple of cp.sum_squares(x) to the objective"
)


class _LCPQuadraticSolver(QpSolver):  # type: ignore[misc]
    """Solves strictly convex quadratic programs through their linear complementarity problem.

    Stateless: cvxpy keeps the compiled problem under the solver object, and uses the first one for ever. Options
    go to ``solve``: ``algorithm``, ``tolerance``, ``max_iterations``, ``max_seconds`` and the algorithm's own.
    """

    MIP_CAPABLE = False
    BOUNDED_VARIABLES = True

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
        """Return (result, solution) of the quadratic program in cvxpy's form."""
        options = {**SOLVE_OPTIONS, **solver_opts}
        program = quadratic_program(data)
        substitution = substitute_definitions(program)
        problem = strictly_convex_lcp(program if substitution is None else substitution.reduced)
        previous = solver_cache.get(self.name()) if warm_start and solver_cache is not None else None
        if previous is not None and previous.size == problem.n and "z0" not in options:
            options["z0"] = previous
        algorithm = options.pop("algorithm", "auto")
        result = solve_lcp(problem, algorithm, **options)
        if solver_cache is not None:
            solver_cache[self.name()] = result.z
        if verbose:
            print(result.explain())
        solution = problem.origin.recover(result)
        return result, solution if substitution is None else substitution.recover(solution)

    def invert(self, solution: Any, inverse_data: Any) -> Solution:
        """Return cvxpy's solution: status by the residuals of the quadratic program, values, duals."""
        result, qp = solution
        attributes = {
            settings.SOLVE_TIME: result.seconds,
            settings.SETUP_TIME: result.setup_seconds,
            settings.NUM_ITERS: result.iterations,
            settings.EXTRA_STATS: result,
        }
        status = _status(result, qp)
        if status not in settings.SOLUTION_PRESENT:
            attributes["message"] = result.advice
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


def strictly_convex_lcp(program: QuadraticProgram) -> LCP:
    """Return the direct or the dual complementarity problem of a strictly convex program.

    Raises
    ------
    UnsupportedModel
        Where it is not strictly convex: the KKT form that it needs has zeros on its diagonal, which no
        splitting method gets over.
    """
    problem = lcp_from_qp(program)
    if problem.origin.form == "kkt":
        try:
            problem = lcp_from_qp(program, "dual")
        except UnsuitableMatrix as error:
            raise UnsupportedModel(NOT_STRICTLY_CONVEX) from error
    is_small = program.n <= LARGEST_CHECKED  # beyond, cvxpy's own check of convexity has to do
    if problem.origin.form == "direct" and not (
        (problem.diagonal > 0.0).all() and not (is_small and program.is_convex is False)
    ):
        raise UnsupportedModel(NOT_STRICTLY_CONVEX)
    return problem


def _status(result: Result, qp: Any) -> str:
    if result.status in (Status.SOLVED, Status.PRECISION_LIMIT):
        is_optimal = qp.is_optimal(max(KKT_TOLERANCE, 10.0 * result.tolerance))
        return str(settings.OPTIMAL if is_optimal else settings.OPTIMAL_INACCURATE)
    if result.status is Status.DIVERGED:
        return str(settings.SOLVER_ERROR)
    return str(settings.USER_LIMIT)


QPSolver = _LCPQuadraticSolver()
