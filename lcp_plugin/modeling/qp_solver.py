"""Our algorithms as a quadratic programming solver inside cvxpy: ``problem.solve(solver=lcp_plugin.QPSolver)``.

Also `certify` for a cvxpy problem that any solver has filled. Its proofs are about the program that cvxpy compiles,
with the user's values in it; auxiliary variables are optimized with these values fixed. That the program is equivalent
to the problem is checked with cvxpy's values of the objective and of the constraint residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy import settings
from cvxpy.error import DCPError, SolverError
from cvxpy.reductions.solution import Solution, failure_solution
from cvxpy.reductions.solvers import utilities
from cvxpy.reductions.solvers.qp_solvers.qp_solver import QpSolver

from ..core.checks import Indices, Vector
from ..core.errors import InvalidProblem, UnsupportedModel
from ..core.names import Names
from ..expressions.rows import entry_numbers
from ..problems.programs.certification import Certification, certify
from ..problems.programs.no_minimum import QPInfeasibility
from ..problems.programs.program import QuadraticProgram
from ..problems.programs.program_matrices import as_array, may_be_small
from ..problems.programs.solution import QPSolution
from ..problems.programs.solving import solve_program
from ..problems.statement import name_of_row
from . import _compat as compat

STARTED_FROM_SOLUTION = "started from the last solution; warm_start=False starts from zero"
PROGRAM = "lcp_plugin.program"  # the key of the last program in the solver cache
CVXPY_MATRICES = (settings.P, settings.F, settings.A)


class _LCPQuadraticSolver(QpSolver):  # type: ignore[misc]
    """Solves convex quadratic programs, linear ones included, through their linear complementarity problem.

    The status is computed from the program's residuals. Infeasible and unbounded come with a proof,
    ``problem.solver_stats.extra_stats.proof``; cvxpy ≥ 1.9 passes on the multipliers that prove infeasibility as dual
    values.

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
        """Do nothing: the solver is part of this package."""

    def cite(self, data: Any) -> str:
        """Return the reference of the methods."""
        return "Kumar, Deepmala, Das: More on projected type iteration method and linear complementarity problem."

    def apply(self, problem: Any) -> tuple[Any, Any]:
        """Return the program as arrays, with the constant of its objective, and the data for `invert`."""
        data, inverse = super().apply(problem)
        return data | {settings.OFFSET: inverse[settings.OFFSET]}, inverse

    def solve_via_data(
        self, data: Any, warm_start: bool, verbose: bool, solver_opts: Any, solver_cache: Any = None
    ) -> Any:
        """Return the answer to the program in cvxpy's form."""
        cache = {} if solver_cache is None else solver_cache
        options, guess = dict(solver_opts), cache.get(self.name()) if warm_start else None
        # Overflow becomes infinite, and raises an error as such.
        with np.errstate(all="ignore"), compat.solver_errors():
            if guess is not None:
                options.setdefault("z0", guess)
            algorithm = options.pop("algorithm", "auto")
            known = {name: options.pop(name) for name in ("sense", "names") if name in options}
            program = quadratic_program(data, cache).replaced(**known)
            result = solve_program(program, algorithm, verbose=bool(verbose), **options)
            if guess is not None and options["z0"] is guess and not result.has_no_solution:
                result = replace(result, begun=STARTED_FROM_SOLUTION)
        cache[self.name()] = None if result.has_no_solution else result.z
        return result, verbose

    def invert(self, answer: Any, inverse_data: Any) -> Solution:
        """Return cvxpy's solution: status by the residuals of the quadratic program, values, duals."""
        result, verbose = answer
        if verbose:
            settings.LOGGER.info(result.explain())
        status, qp = compat.CVXPY_STATUS[result.status], result.solution
        attributes = compat.statistics(result)
        if status not in settings.SOLUTION_PRESENT:
            attributes["message"] = result.advice if result.proof is None else str(result.proof)
            failed = failure_solution(status, attributes)
            if isinstance(result.proof, QPInfeasibility):
                failed.dual_vars = self._duals(_farkas(result.proof), inverse_data)
            return failed
        values = {inverse_data[self.VAR_ID]: qp.x}
        return Solution(status, qp.objective, values, self._duals(qp, inverse_data), attributes)

    def _duals(self, qp: QPSolution, inverse_data: Any) -> dict[Any, Any]:
        """Return the multipliers by the ids of constraints."""
        by_id, entry = utilities.get_dual_values, utilities.extract_dual_value
        duals: dict[Any, Any] = by_id(qp.equality, entry, inverse_data[self.EQ_CONSTR])
        return duals | by_id(qp.inequality, entry, inverse_data[self.NEQ_CONSTR])


def _farkas(proof: QPInfeasibility) -> QPSolution:
    """Return the multipliers that prove infeasibility, the largest ±1, as a solution."""
    largest = max(map(abs, proof.multipliers))
    multipliers = np.array([float(y / largest) for y in proof.multipliers])
    return QPSolution.of_rows(proof.program, np.zeros(proof.program.n), multipliers)


def quadratic_program(data: Any, cache: Any) -> QuadraticProgram:
    """Return cvxpy's problem data as a quadratic program: min ½xᵀPx + qᵀx, Ax = b, Fx ≤ g, bounds.

    If the program in the cache has the same matrices, its factorization and scaling are shared.
    """
    rows = n, m, p = [int(data[key]) for key in ("n_var", "n_ineq", "n_eq")]
    given = zip((data[key] for key in CVXPY_MATRICES), rows, strict=True)
    matrices = [sp.csc_array((size, n)) if part is None else part for part, size in given]
    q, g, b = data[settings.Q], data[settings.G], data[settings.B]
    constant = float(data[settings.OFFSET])
    key = [[array.tobytes() for array in (M.indptr, M.indices, M.data)] for M in matrices]
    kept, before = cache.get(PROGRAM, ([], None))
    if key == kept:
        return before.with_vectors(q, g, b, constant=constant)
    is_small = may_be_small(n, m + p, (matrix.nnz for matrix in matrices))
    P, F, A = map(as_array, matrices) if is_small else matrices
    program = QuadraticProgram(P, q, G=F, h=g, A=A, b=b, constant=constant)
    cache[PROGRAM] = key, program
    return program


QPSolver = _LCPQuadraticSolver()


class Entries(NamedTuple):
    """Unknowns of a program that are the entries of a variable, column by column.

    Attributes
    ----------
    places : ndarray of int
    signs : ndarray
        −1 if the entry is the negative of the unknown, 0 if the entry is always zero.
    shape : tuple
    """

    places: Indices
    signs: Vector
    shape: tuple[int, ...]

    @classmethod
    def of(cls, variable: Any, columns: dict[int, int], chain: Any, inverse: Any) -> Entries:
        """Return the entries of a user's variable.

        cvxpy's inversion would project the numbers onto the variable's bounds.
        """
        numbers = 1.0 + entry_numbers(variable.shape)
        leaf = variable
        for reduction, known in zip(chain.reductions, inverse, strict=False):
            if isinstance(known, tuple) and known and isinstance(known[0], dict):
                # CvxAttr2Constr's variable instead of one with attributes.
                leaf = known[0].get(variable.id, leaf)
                if variable.id in known[0] and leaf.size != variable.size:
                    counted = {leaf.id: 1.0 + entry_numbers(leaf.shape)}
                    reduced = Solution(settings.OPTIMAL, 0.0, counted, {}, {})
                    numbers = reduction.invert(reduced, known).primal_vars[variable.id]
        if leaf.id not in columns and variable.size:
            raise UnsupportedModel(
                f"{variable.name()} is not found again in the program that cvxpy made; use plain variables"
            )
        flat = np.rint(compat.by_columns(np.broadcast_to(numbers, variable.shape)))
        places = np.maximum(np.abs(flat).astype(np.int64) - 1, 0) + columns.get(leaf.id, 0)
        return cls(places, np.sign(flat), variable.shape)

    def taken(self, unknowns: Vector) -> Any:
        """Return the value that the unknowns give."""
        return (self.signs * unknowns[self.places]).reshape(self.shape, order="F")

    def put_into(self, unknowns: Vector, value: Any) -> None:
        """Set the unknowns so that they give the value."""
        is_used = self.signs != 0.0
        flat = self.signs * compat.by_columns(value)
        unknowns[self.places[is_used]] = flat[is_used]


@dataclass(frozen=True, eq=False)
class CompiledProblem:
    """The program that cvxpy compiles a problem to.

    Attributes
    ----------
    program : QuadraticProgram
    entries : dict
        Entries of each variable, by its id.
    """

    program: QuadraticProgram
    entries: dict[int, Entries]

    @classmethod
    def of(cls, problem: cp.Problem, *, is_folded: bool = False, **options: Any) -> CompiledProblem:
        """Return the program of a problem; if folded, rows of one unknown become bounds.

        Raises
        ------
        UnsupportedModel
            If it is not a quadratic program.
        """
        twin = cp.Problem(problem.objective, problem.constraints)  # what is compiled stays with it
        try:
            data, chain, inverse = twin.get_problem_data(QPSolver, **options)
        except (SolverError, DCPError) as error:
            raise UnsupportedModel(str(error)) from error
        columns = data[settings.PARAM_PROB].var_id_to_col
        entries = {v.id: Entries.of(v, columns, chain, inverse) for v in problem.variables()}
        program = quadratic_program(data, {}).replaced(names=_names_of(problem, data, entries))
        if is_folded:
            program = program.reduced.replaced(constant=program.constant)
        return cls(program, entries)

    def values(self, x: Vector) -> dict[int, Any]:
        """Return the value of each variable by its id."""
        return {key: item.taken(x) for key, item in self.entries.items()}


@dataclass(frozen=True, eq=False)
class NamesOnDemand:
    """Names of the rows and unknowns of the program of a cvxpy problem, which is compiled again for the first name."""

    problem: cp.Problem

    @cached_property
    def names(self) -> Names:
        """All names."""
        return CompiledProblem.of(self.problem).program.names

    def row(self, i: int) -> str:
        """Return the name of a row of G, then of A."""
        return self.names.row(i, "")

    def unknown(self, i: int) -> str:
        """Return the name of an unknown."""
        return self.names.unknown(i, "")


def _names_of(problem: cp.Problem, data: Any, entries: dict[int, Entries]) -> Names:
    """Return the names of the rows and unknowns of the program that cvxpy compiles, in the user's words.

    A row that cvxpy adds, as for abs(x) <= 1, has no name.
    """
    constraints = enumerate(problem.constraints)
    names = {row.id: partial(compat.row_of, row, number=k) for k, row in constraints}
    # rows of G, then of A
    compiled = data[settings.PARAM_PROB].constraints
    compiled = sorted(compiled, key=lambda constraint: isinstance(constraint, compat.EQUATIONS))
    rows: list[Any] = [(constraint.size, names.get(constraint.id)) for constraint in compiled]
    places = [(variable, entries[variable.id].places) for variable in problem.variables()]
    count = sum(size for size, _ in rows)
    return Names(partial(name_of_row, rows, range(count)), partial(_unknown_name, places))


def _unknown_name(places: list[tuple[Any, Indices]], column: int) -> str:
    for variable, entries in places:
        if (at := np.flatnonzero(entries == column)).size:
            return compat.entry_of(variable, int(at[0]))
    return ""


CLAIMED = dict.fromkeys((settings.INFEASIBLE, settings.INFEASIBLE_INACCURATE), "infeasible")
CLAIMED |= dict.fromkeys((settings.UNBOUNDED, settings.UNBOUNDED_INACCURATE), "unbounded")


def certify_problem(problem: cp.Problem, tolerance: float) -> Certification:
    """Return the proved properties of the values and the status of a solved cvxpy problem that QPSolver could take."""
    if not problem.is_dcp():
        raise UnsupportedModel(
            "certify takes problems that follow cvxpy's rules of convexity; problem.is_dcp() must be True"
        )
    if not problem.variables():
        raise UnsupportedModel("the problem has no variables, so there is no solution to certify")
    if reasons := compat.why_not(problem):
        raise UnsupportedModel(
            f"certify takes problems that cvxpy compiles to convex quadratic programs: {'; '.join(reasons)}"
        )
    if problem.status in (None, settings.SOLVER_ERROR, settings.INFEASIBLE_OR_UNBOUNDED):
        raise InvalidProblem(
            f"the status is {problem.status}, without a point; call problem.solve() with another solver"
        )
    claim = CLAIMED.get(problem.status)
    for variable in problem.variables() if claim is None else ():
        value = compat.leaf_value(variable)
        if value is None or not np.isfinite(compat.by_columns(value)).all():
            what = "no value" if value is None else "a value that is not finite"
            raise InvalidProblem(f"variable {variable.name()} has {what}; solve again, or set it")
    compiled = CompiledProblem.of(problem)
    point = _point(problem, compiled) if claim is None else None
    certification = certify(compiled.program, point, claim=claim, tolerance=tolerance)
    if compat.sense_of(problem) > 0.0:
        return certification
    lower, upper = certification.lower, certification.upper
    lower, upper = (None if upper is None else -upper), (None if lower is None else -lower)
    return replace(certification, lower=lower, upper=upper)


def _point(problem: cp.Problem, compiled: CompiledProblem) -> Vector:
    """Return the program's x of the user's values; auxiliary variables are optimized with these values fixed."""
    x, entries = np.zeros(compiled.program.n), compiled.entries.values()
    for variable in problem.variables():
        compiled.entries[variable.id].put_into(x, compat.leaf_value(variable))
    of_variables = [item.places[item.signs != 0.0] for item in entries]
    added = np.setdiff1d(np.arange(x.size), np.concatenate(of_variables))
    if added.size:
        x[added] = solve_program(_program_of_columns(compiled.program, x, added)).x
    return x


def _program_of_columns(program: QuadraticProgram, x: Vector, columns: Indices) -> QuadraticProgram:
    """Return the program of some columns with all other columns fixed at x, without rows of only fixed columns."""
    P, rows = sp.csr_array(program.P)[columns], list[Any]()
    for matrix, right in ((program.G, program.h), (program.A, program.b)):
        part = sp.csr_array(sp.csr_array(matrix)[:, columns])
        kept = np.flatnonzero(np.diff(part.indptr))
        rows += [part[kept], (right - matrix @ x)[kept]]
    lower, upper = program.lower[columns], program.upper[columns]
    c = program.c[columns] + P @ x
    G, h, A, b = rows
    return QuadraticProgram(P[:, columns], c, G, h, A, b, lower=lower, upper=upper)
