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
from ..problems.programs.certification import LOOSE, Certification, ProgramProofs, Proved, multiplier_beside_slack
from ..problems.programs.convexity import refuse_nonconvex
from ..problems.programs.dual_bounds import DENSE_UP_TO, least_squares_above
from ..problems.programs.program import QuadraticProgram
from ._compat import leaf_value, name_of
from .qp_solver import ProgramEntries, QPSolver, quadratic_program
from .stated_terms import INEQUALITIES, StatedTerms, attribute_error, dense_value, sense_of, why_not

CLAIMED = {
    settings.INFEASIBLE: "infeasible", settings.INFEASIBLE_INACCURATE: "infeasible",
    settings.UNBOUNDED: "unbounded", settings.UNBOUNDED_INACCURATE: "unbounded",
}
EVALUATED = 2.0**-44  # of the terms of an expression: more than rounding makes of its value
BESIDE = 1e-9  # residuals of what cvxpy added beside the user's values
ACTIVE = 1e-5  # of a row's unit: rows that cvxpy added and whose multipliers are free to be anything ≥ 0


def certify_problem(problem: Any, tolerance: float) -> Certification:
    """Return what is proved about the values and the status of a cvxpy problem."""
    _check(problem)
    reduced = ReducedProblem.of(problem)
    refuse_nonconvex(reduced.program)
    proofs = ProgramProofs(reduced.program)
    if problem.status in CLAIMED:
        found = proofs.of_claim(CLAIMED[problem.status], tolerance)
    elif problem.status == getattr(settings, "INFEASIBLE_OR_UNBOUNDED", None):
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
        raise InvalidProblem(f"nothing to certify: the status is {problem.status}; call problem.solve() first")
    if problem.status in CLAIMED or problem.status == getattr(settings, "INFEASIBLE_OR_UNBOUNDED", None):
        return
    for variable in problem.variables():
        value = leaf_value(variable)
        if value is None or not np.isfinite(dense_value(value)).all():
            what = "no value" if value is None else "a value that is not finite"
            raise InvalidProblem(f"variable {variable.name()} has {what}; solve the problem again, or set it")


def _neither(proofs: ProgramProofs, tolerance: float) -> Certification:
    """Return what is proved about "infeasible or unbounded"."""
    both = [proofs.of_claim(claim, tolerance) for claim in ("infeasible", "unbounded")]
    proved = [found for found in both if found.verdict == "proved"]
    if proved:
        return proved[0]
    is_disproved = all(found.verdict == "disproved" for found in both)
    found = replace(both[1], claim="infeasible or unbounded")
    return found if is_disproved else replace(found, verdict="unproved")


def _of_values(problem: Any, reduced: ReducedProblem, proofs: ProgramProofs, tolerance: float) -> Certification:
    """Return what is proved about the values of the variables."""
    with np.errstate(all="ignore"):
        terms = StatedTerms.of(problem)
        value = terms.goal - reduced.offset
        rounding = EVALUATED * (terms.size(0) + abs(reduced.offset))
        found = np.nan_to_num(terms.violated(problem), nan=np.inf)
        missed = [(high and high - EVALUATED * terms.size(k), high) for k, high in enumerate(found.tolist(), 1)]
    missed += [(miss, miss) for miss in map(attribute_error, problem.variables())]
    violation = (max((low for low, _ in missed), default=0.0), max((high for _, high in missed), default=0.0))
    x = reduced.values(problem, proofs)
    proved = Proved(
        (value - rounding, value + rounding), violation, proofs.own_lower, proofs.upper(*([] if x is None else [x])),
        tolerance, reduced.program.scaling.objective,
    )
    complaint = "" if x is None else _dual_error(problem, reduced, x, tolerance)
    if x is None:  # nothing can be said of an x that the program does not show
        own = proofs.own_solution
        blind = np.zeros(reduced.program.n) if own is None else own.x
        return replace(proved.certification(proofs, blind, complaint, np.zeros(0, np.intp)), distance=None)
    said = proved.certification(proofs, x, complaint, reduced.columns)
    if said.distance is None:
        return said
    return replace(said, distance=math.nextafter(said.distance * math.sqrt(reduced.most_copies), math.inf))


def _dual_error(problem: Any, reduced: ReducedProblem, x: FloatVector, tolerance: float) -> str:
    """Return what is wrong with the duals that the problem holds, or nothing."""
    duals = {constraint.id: constraint.dual_value for constraint in problem.constraints}
    if any(dual is None for dual in duals.values()):
        return ""
    size = max((float(np.abs(dense_value(dual)).max(initial=0.0)) for dual in duals.values()), default=0.0)
    y, scaling = reduced.multipliers(duals), reduced.program.scaling
    if y is not None and y.size:
        size = max(size, scaling.objective / float(scaling.coefficient[: y.size].max()))
    for constraint in problem.constraints:
        least = float(dense_value(duals[constraint.id]).min(initial=0.0))
        if isinstance(constraint, INEQUALITIES) and least < -LOOSE * tolerance * size:
            return f"the dual value {least:.3g} of {name_of(constraint)} has the wrong sign"
    if y is None:
        return ""
    if idle := multiplier_beside_slack(reduced.program, x, np.nan_to_num(y), tolerance):
        return idle
    left = reduced.gradient_left(y, x, tolerance)
    return f"the dual values leave {left:.3g} of the gradient" if left else ""


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

    def multipliers(self, duals: dict[int, Any]) -> FloatVector | None:
        """Return these duals as multipliers of [G; A], NaN for rows that cvxpy added; None where one has no place."""
        places = self.entries.duals
        if any(key not in places for key in duals):
            return None
        unknowns = np.full(self.program.n + self.program.constraints.rows, np.nan)
        for key, dual in duals.items():
            places[key].put_into(unknowns, dual)
        return unknowns[self.program.n :]

    def gradient_left(self, y: FloatVector, x: FloatVector, tolerance: float) -> float:
        """Return what is left of the gradient beside these multipliers and any of the rows that cvxpy added.

        0 where it is no more than errors of multipliers may be, and where nothing can be said.
        """
        program, rows = self.program, self.program.constraints
        is_added, y = np.isnan(y), np.nan_to_num(y)
        matrix = rows.matrix[: rows.rows]
        value = np.abs(matrix @ x - rows.limit[: rows.rows])
        is_equality = rows.is_equality[: rows.rows]
        added = np.flatnonzero(is_added & (is_equality | (value <= ACTIVE * rows.unit[: rows.rows])))
        s = program.P @ x + program.c + matrix.T @ y
        terms = [abs(sp.csr_array(program.P)) @ np.abs(x), np.abs(program.c), abs(matrix).T @ np.abs(y)]
        if added.size:
            if added.size * s.size > DENSE_UP_TO:
                return 0.0
            found = least_squares_above(
                sp.csr_array(matrix[added].T), -s, np.where(is_equality[added], -np.inf, 0.0)
            )
            s = s + matrix[added].T @ found
            terms.append(abs(matrix[added]).T @ np.abs(found))
        unit = program.scaling.objective / program.scaling.unknown
        excess = np.abs(s) - LOOSE * tolerance * (unit + np.max(terms, axis=0))
        return float(np.abs(s[excess > 0.0]).max(initial=0.0))

    def in_the_users_units(self, found: Certification, sense: float) -> Certification:
        """Return what was found with bounds of the user's optimal value, a largest one where he maximises."""
        lower, upper = (
            None if bound is None else math.nextafter(bound + self.offset, end)
            for bound, end in ((found.lower, -math.inf), (found.upper, math.inf))
        )
        if sense < 0.0:
            lower, upper = (None if upper is None else -upper), (None if lower is None else -lower)
        return replace(found, lower=lower, upper=upper)


def _beside(program: QuadraticProgram, x: FloatVector, columns: NDArray[np.int64]) -> QuadraticProgram:
    """Return the program of some columns, the others being as in x; without the rows that hold only these."""
    P, G, A = (sp.csr_array(matrix) for matrix in (program.P, program.G, program.A))
    upper, equal = (np.flatnonzero(np.diff(sp.csr_array(rows[:, columns]).indptr)) for rows in (G, A))
    return QuadraticProgram(
        P[columns][:, columns], program.c[columns] + P[columns] @ x,
        G[upper][:, columns], program.h[upper] - G[upper] @ x, A[equal][:, columns], program.b[equal] - A[equal] @ x,
        program.lower[columns], program.upper[columns],
    )
