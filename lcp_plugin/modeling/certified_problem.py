"""`certify` for a cvxpy problem that some solver has filled.

What is judged are the user's own terms: the objective, the constraints and the attributes at the values of his
variables. What is proved is proved of the program that cvxpy makes of the problem for QPSolver; auxiliary variables are
as they are best beside his, and the multipliers of the bound are those of a solution of ours, since a solver's duals
may belong to another program. The duals that the problem holds are looked at, too: of the right sign, and such that
some multipliers of what cvxpy added make the gradient vanish with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy import settings
from cvxpy.error import DCPError, SolverError
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.errors import InvalidProblem, UnsupportedModel
from ..core.matrix.matrix import largest_in_rows
from ..problems.programs.certification import (
    LOOSE,
    Certification,
    ProgramProofs,
    Proved,
    Violation,
    multiplier_error,
    size_of_objective,
)
from ..problems.programs.convexity import refuse_nonconvex
from ..problems.programs.dual_bounds import DENSE_UP_TO, least_squares_above
from ..problems.programs.feasible_points import objective_bounds
from ..problems.programs.program import QuadraticProgram
from ._compat import leaf_value, name_of
from .qp_solver import ProgramEntries, QPSolver, quadratic_program
from .stated_terms import INEQUALITIES, StatedTerms, attribute_error, dense_value, sense_of, why_not

CLAIMED = {
    settings.INFEASIBLE: "infeasible",
    settings.INFEASIBLE_INACCURATE: "infeasible",
    settings.UNBOUNDED: "unbounded",
    settings.UNBOUNDED_INACCURATE: "unbounded",
}
EVALUATED = 2.0**-44  # of the terms of an expression: more than rounding makes of its value
BESIDE = 1e-9  # residuals of what cvxpy added beside the user's values


def certify_problem(problem: Any, tolerance: float) -> Certification:
    """Return what is proved about the values and the status of a cvxpy problem."""
    _check(problem)
    reduced = ReducedProblem.of(problem)
    refuse_nonconvex(reduced.program)
    proofs = ProgramProofs(reduced.program)
    if problem.status in CLAIMED:
        found = proofs.of_claim(CLAIMED[problem.status], tolerance)
    elif problem.status == settings.INFEASIBLE_OR_UNBOUNDED:
        found = _neither(proofs, tolerance)
    else:
        found = _of_values(problem, reduced, proofs, tolerance)
    return reduced.in_the_users_units(found, sense_of(problem))


def _check(problem: Any) -> None:
    """Raise where this is no solved problem that QPSolver could take."""
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
        raise UnsupportedModel("the problem has no variables: there is no answer to certify")
    if reasons := why_not(problem):
        raise UnsupportedModel(
            f"certify takes convex quadratic and linear programs, what cvxpy can write so; here {'; '.join(reasons)}"
        )
    if problem.status is None or problem.status == settings.SOLVER_ERROR:
        raise InvalidProblem(
            f"nothing to certify: the status is {problem.status}; call problem.solve() first"
        )
    if problem.status in (*CLAIMED, settings.INFEASIBLE_OR_UNBOUNDED):
        return
    for variable in problem.variables():
        value = leaf_value(variable)
        if value is None or not np.isfinite(dense_value(value)).all():
            what = "no value" if value is None else "a value that is not finite"
            raise InvalidProblem(
                f"variable {variable.name()} has {what}; solve the problem again, or set it"
            )


def _neither(proofs: ProgramProofs, tolerance: float) -> Certification:
    """Return what is proved about "infeasible or unbounded"."""
    both = [proofs.of_claim(claim, tolerance) for claim in ("infeasible", "unbounded")]
    proved = [found for found in both if found.verdict == "proved"]
    if proved:
        return proved[0]
    is_disproved = all(found.verdict == "disproved" for found in both)
    found = replace(both[1], claim="infeasible or unbounded")
    return found if is_disproved else replace(found, verdict="unproved")


def _of_values(
    problem: Any, reduced: ReducedProblem, proofs: ProgramProofs, tolerance: float
) -> Certification:
    """Return what is proved about the values of the variables."""
    with np.errstate(all="ignore"):
        terms = StatedTerms.of(problem)
        value = terms.goal - reduced.offset
        rounding = EVALUATED * (terms.size(0) + abs(reduced.offset))
        found = np.nan_to_num(terms.violated(problem), nan=np.inf)
        missed = [
            (high and high - EVALUATED * terms.size(k), high)
            for k, high in enumerate(found.tolist(), 1)
        ]
    missed += [(miss, miss) for miss in map(attribute_error, problem.variables())]
    least, largest = (max(ends, default=0.0) for ends in zip(*missed, strict=True))
    x, own, program = reduced.values(problem, proofs), proofs.own_solution, reduced.program
    at = x if x is not None else np.zeros(program.n) if own is None else own.x
    seen = Violation.of(program, at, tolerance)
    violation = Violation(
        least,
        largest,
        largest <= tolerance and (x is None or seen.is_met),
        least > tolerance and (x is None or seen.is_missed),
    )
    stated, compiled = (value - rounding, value + rounding), objective_bounds(program, at)
    is_the_same = x is not None and compiled[0] <= stated[1] and stated[0] <= compiled[1]
    proved = Proved(
        compiled if is_the_same else stated,
        violation,
        proofs.own_lower,
        proofs.upper(*([] if x is None else [x])),
        tolerance,
        size_of_objective(program, at),
    )
    if x is None:  # nothing can be said of an x that the program does not show
        return replace(proved.certification(proofs, at, "", np.zeros(0, np.intp)), _distance=None)
    said = proved.certification(
        proofs, x, _dual_error(problem, reduced, x, tolerance), reduced.columns
    )

    def distance() -> float | None:
        near = said.distance
        return (
            None
            if near is None
            else math.nextafter(near * math.sqrt(reduced.most_copies), math.inf)
        )

    return replace(said, _distance=distance)


def _dual_error(problem: Any, reduced: ReducedProblem, x: FloatVector, tolerance: float) -> str:
    """Return what is wrong with the duals that the problem holds, or nothing."""
    duals = {constraint.id: constraint.dual_value for constraint in problem.constraints}
    if any(dual is None for dual in duals.values()):
        return ""
    if (y := reduced.multipliers(duals, x, tolerance)) is not None:
        wrong = multiplier_error(
            reduced.program, x, [y], tolerance, size_of_objective(reduced.program, x)[0]
        )
        return f"the dual values are wrong: {wrong}" if wrong else ""
    size = max(
        (float(np.abs(dense_value(dual)).max(initial=0.0)) for dual in duals.values()), default=0.0
    )
    for constraint in problem.constraints:
        least = float(dense_value(duals[constraint.id]).min(initial=0.0))
        if isinstance(constraint, INEQUALITIES) and least < -LOOSE * tolerance * size:
            return f"the dual value {least:.3g} of {name_of(constraint)} has the wrong sign"
    return ""


@dataclass(frozen=True, eq=False)
class ReducedProblem:
    """The program that cvxpy makes of a problem, and where the user's variables are in it.

    Attributes
    ----------
    program : QuadraticProgram
    offset : float
        What the program leaves out of the objective that is to be minimised.
    entries : ProgramEntries
    """

    program: QuadraticProgram
    offset: float
    entries: ProgramEntries

    @classmethod
    def of(cls, problem: Any) -> ReducedProblem:
        """Return the program of a problem, which is left as it is."""
        twin = cp.Problem(problem.objective, problem.constraints)  # what is compiled stays with it
        try:
            data, chain, inverse = twin.get_problem_data(QPSolver)
        except (SolverError, DCPError) as error:
            raise UnsupportedModel(str(error)) from error
        program = quadratic_program(data)
        entries = ProgramEntries.of(problem, program, data, chain, inverse)
        return cls(program, float(inverse[-1][settings.OFFSET]), entries)

    @property
    def columns(self) -> NDArray[np.int64]:
        """The columns of the user's variables."""
        return np.unique(self._columns)

    @property
    def most_copies(self) -> int:
        """How many entries of the user's variables one column is at most: two in a symmetric matrix."""
        return int(np.bincount(self._columns, minlength=1).max())

    @property
    def _columns(self) -> NDArray[np.int64]:
        own = [entries.used for entries in (self.entries.variables or {}).values()]
        return np.concatenate([np.zeros(0, np.int64), *own])

    def values(self, problem: Any, proofs: ProgramProofs) -> FloatVector | None:
        """Return the program's x of the user's values; other variables as they are best beside these."""
        if self.entries.variables is None:
            return None
        x = np.zeros(self.program.n)
        for variable in problem.variables():
            self.entries.variables[variable.id].put_into(x, leaf_value(variable))
        added = np.setdiff1d(np.arange(x.size), self.columns)
        if added.size:
            best = ProgramProofs(_beside(self.program, x, added)).own_solution
            if best is None or not best.is_stationary(BESIDE):
                if proofs.own_solution is None:
                    return None
                x[added] = proofs.own_solution.x[added]
            else:
                x[added] = best.x
        return x

    def multipliers(
        self, duals: dict[int, Any], x: FloatVector, tolerance: float
    ) -> FloatVector | None:
        """Return these duals as multipliers of [G; A], with those of rows that cvxpy added as they are best beside x.

        None where a dual has no place, or where the rows are too many to look.
        """
        program, places = self.program, self.entries.duals
        if any(key not in places for key in duals):
            return None
        unknowns = np.full(program.n + program.constraints.rows, np.nan)
        for key, dual in duals.items():
            places[key].put_into(unknowns, dual)
        y, rows = unknowns[program.n :], program.constraints
        matrix, limit, is_equality = (
            rows.matrix[: y.size],
            rows.limit[: y.size],
            rows.is_equality[: y.size],
        )
        near = (
            LOOSE
            * tolerance
            * (largest_in_rows(matrix) * np.abs(x).max(initial=0.0) + np.abs(limit))
        )
        added = np.flatnonzero(np.isnan(y) & (is_equality | (np.abs(matrix @ x - limit) <= near)))
        y = np.asarray(np.nan_to_num(y))
        if added.size * x.size > DENSE_UP_TO:
            return None
        if added.size:
            left = program.P @ x + program.c + matrix.T @ y
            y[added] = least_squares_above(
                sp.csr_array(matrix[added].T), -left, np.where(is_equality[added], -np.inf, 0.0)
            )
        return y

    def in_the_users_units(self, found: Certification, sense: float) -> Certification:
        """Return what was found with bounds of the user's optimal value, a largest one where he maximises."""
        lower, upper = (
            None if bound is None else math.nextafter(bound + self.offset, end)
            for bound, end in ((found.lower, -math.inf), (found.upper, math.inf))
        )
        if sense < 0.0:
            lower, upper = (None if upper is None else -upper), (None if lower is None else -lower)
        return replace(found, lower=lower, upper=upper)


def _beside(
    program: QuadraticProgram, x: FloatVector, columns: NDArray[np.int64]
) -> QuadraticProgram:
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
