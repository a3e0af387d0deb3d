"""`certify` for a cvxpy problem that some solver has filled.

Proofs are about the program that cvxpy compiles, with the user's values in it; auxiliary variables are optimized with
these values fixed. That the program is equivalent to the problem is checked with cvxpy's values of the objective and
of the constraint residuals.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy import settings

from ..core.checks import FloatVector
from ..core.errors import InvalidProblem, UnsupportedModel
from ..expressions.rows import Indices
from ..problems.programs.certification import Certification, certify
from ..problems.programs.program import QuadraticProgram
from ..problems.programs.solving import solve_program
from ._compat import attribute_bounds, dense_value, leaf_value, name_of, sense_of, why_not
from .qp_solver import CompiledProblem

CLAIMED = {
    settings.INFEASIBLE: "infeasible",
    settings.INFEASIBLE_INACCURATE: "infeasible",
    settings.UNBOUNDED: "unbounded",
    settings.UNBOUNDED_INACCURATE: "unbounded",
}


def certify_problem(problem: Any, tolerance: float) -> Certification:
    """Return the proved properties of the values and the status of a cvxpy problem."""
    _check(problem)
    compiled = CompiledProblem.of(problem)
    if problem.status in CLAIMED:
        found = certify(compiled.program, claim=CLAIMED[problem.status], tolerance=tolerance)
    else:
        x = _point(problem, compiled)
        found = certify(compiled.program, x, tolerance=tolerance)
        if wrong := _disagreement(problem, compiled, x, tolerance):
            verdict = "disproved" if found.verdict == "disproved" else "unproved"
            found = replace(found, verdict=verdict, reason=wrong)
    lower, upper = found.lower, found.upper
    if sense_of(problem) < 0.0:
        lower, upper = (None if upper is None else -upper), (None if lower is None else -lower)
    return replace(found, lower=lower, upper=upper)


def _check(problem: Any) -> None:
    """Raise an error unless this is a solved problem that QPSolver could take."""
    if not isinstance(problem, cp.Problem):
        raise InvalidProblem(
            f"certify needs a cvxpy.Problem or a QuadraticProgram, got {type(problem).__name__}; give one of these"
        )
    if not problem.is_dcp():
        raise UnsupportedModel(
            "certify takes convex problems, and this one does not follow cvxpy's rules of convexity; "
            "problem.is_dcp() must be True"
        )
    if not problem.variables():
        raise UnsupportedModel("the problem has no variables, so there is no solution to certify")
    if reasons := why_not(problem):
        raise UnsupportedModel(
            "certify supports convex quadratic and linear programs, and problems that cvxpy compiles to them; "
            f"here {'; '.join(reasons)}"
        )
    if problem.status in (None, settings.SOLVER_ERROR, settings.INFEASIBLE_OR_UNBOUNDED):
        raise InvalidProblem(
            f"the status is {problem.status}, which cannot be certified; call problem.solve() with another solver"
        )
    if problem.status in CLAIMED:
        return
    for variable in problem.variables():
        value = leaf_value(variable)
        if value is None or not np.isfinite(dense_value(value)).all():
            what = "no value" if value is None else "a value that is not finite"
            raise InvalidProblem(
                f"variable {variable.name()} has {what}; solve the problem again, or set it"
            )


def _point(problem: Any, compiled: CompiledProblem) -> FloatVector:
    """Return the program's x of the user's values; auxiliary variables are optimized with these fixed."""
    x, entries = np.zeros(compiled.program.n), compiled.entries.values()
    for variable in problem.variables():
        compiled.entries[variable.id].put_into(x, leaf_value(variable))
    own = [one.places[one.signs != 0.0] for one in entries]
    added = np.setdiff1d(np.arange(x.size), np.concatenate(own))
    if added.size:
        x[added] = solve_program(_rest(compiled.program, x, added)).x
    return x


def _disagreement(problem: Any, compiled: CompiledProblem, x: FloatVector, tolerance: float) -> str:
    """Compare cvxpy's values of the problem with the program at x; return a mismatch, or ""."""
    program, own = compiled.program, np.abs(x)
    with np.errstate(all="ignore"):
        stated = sense_of(problem) * float(dense_value(problem.objective.value))
        value = program.objective(x)
        size = 0.5 * float(own @ (abs(program.P) @ own)) + float(np.abs(program.c) @ own)
        if not abs(stated - value) <= tolerance * (size + abs(program.constant)):
            return f"the objective is {stated:.9g}, and {value:.9g} in the program that cvxpy makes"
        largest = float(program.constraints.excess(x).max(initial=0.0))
        missed = [(name_of(one), dense_value(one.residual)) for one in problem.constraints]
        for variable in problem.variables():
            entries, (lower, upper) = dense_value(leaf_value(variable)), attribute_bounds(variable)
            name = f"the attributes of {variable.name()}"
            missed.append((name, np.maximum(lower - entries, entries - upper)))
        allowed = 10.0 * largest + tolerance * (1.0 + own.max(initial=0.0))
        for name, violations in missed:
            if not (violation := float(np.max(violations, initial=0.0))) <= allowed:
                return (
                    f"{name}: violated by {violation:.3g}, and not in the program that cvxpy makes"
                )
    return ""


def _rest(program: QuadraticProgram, x: FloatVector, columns: Indices) -> QuadraticProgram:
    """Return the program of some columns, the others being as in x; without the rows that hold only these."""
    P, G, A = (sp.csr_array(matrix) for matrix in (program.P, program.G, program.A))
    upper, equal = (
        np.flatnonzero(np.diff(sp.csr_array(rows[:, columns]).indptr)) for rows in (G, A)
    )
    return QuadraticProgram(
        P[columns][:, columns],
        program.c[columns] + P[columns] @ x,
        G[upper][:, columns],
        program.h[upper] - G[upper] @ x,
        A[equal][:, columns],
        program.b[equal] - A[equal] @ x,
        program.lower[columns],
        program.upper[columns],
    )
