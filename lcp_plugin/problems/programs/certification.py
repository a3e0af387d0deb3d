"""Rigorous verdicts on a claimed solution of a convex program from any solver: `certify`.

All verdicts hold for the stored doubles, rounding included, and do not rely on the solver. Weak duality gives a lower
bound of the optimal value (:mod:`lcp_plugin.problems.programs.value_bounds`), from the user's multipliers and from the
multipliers of a built-in solve. A point that is proved feasible gives an upper bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pkgutil import resolve_name
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core import deadline
from ...core.checks import Array, Vector, checked_vector, derived_property, is_number, restore_state
from ...core.entries import largest_products
from ...core.errors import InvalidOption, InvalidProblem, LCPError, did_you_mean
from ...core.kernels.floats import LARGEST, OUTWARD
from ...core.problem import check_labels
from ...core.problem_classes import CLASSES, class_of, foreign_function, refusal
from ...core.settings import checked_tolerance, whole_number
from ...judges.lcp import NEAREST
from ...judges.program import KKTErrors, PrimalDualPoint, least_size, with_zeros
from ...judges.worst_rows import WorstRow, WorstRows, worst_pairs
from ...proofs.bounds import constrained_curvature
from ...proofs.exact import sum_above
from ...solving.result import BaseResult
from . import no_minimum, value_bounds
from .no_minimum import NoMinimum, QPInfeasibility
from .program import QuadraticProgram, refuse_nonconvex
from .result import QuadraticProgramResult
from .solution import QPSolution, bound_multipliers, worst_constraints
from .solving import solve_program

PROVABLE = ("optimal", "infeasible", "unbounded")
SMALL = 400  # variables and rows of a program that is solved again for a tighter bound
UNPROVED = "nothing can be proved"
WITHIN_ROUNDING = "within rounding: a negative eigenvalue of P, as rounding of entries makes it"
NOT_BY_A_ROW = "each row passes, but F may tend to 0 as x diverges, or is at rounding level"


@np.errstate(all="ignore")  # a bound that overflows proves nothing
def certify(
    problem: Any,
    x: Any = None,
    multipliers: Any = None,
    *,
    claim: str | None = None,
    tolerance: float = 1e-6,
    max_seconds: float | None = None,
    pairs: Any = None,
) -> Certification:
    """Return the proved facts about a point of a problem, from any solver, and its worst rows.

    For a complementarity problem, "proved" means that the stopping criterion of SOLVED holds at x, which is not moved;
    so for least squares, whose x_j may be beyond a bound by the tolerance of the largest x_k. For an EquilibriumProgram
    x satisfies the rows and pairs, and its objective is within the tolerance of a proved bound: of a result with a
    proof, or of a search of 100 nodes.

    The other paragraphs are about convex quadratic and linear programs. An x_j is moved to a bound or to a row
    with one entry if no row and no gradient notices the move (1e-6 of their terms at the default tolerance), and to 0
    below 2⁻⁴² of the largest unknown of its component.
    ``certify(…).worst(5)`` lists the rows that fail by most.

    Parameters
    ----------
    problem : problem, cvxpy.Problem or Pyomo model
        Of any problem class, such as LCP or QuadraticProgram; or a model, at the present values of its variables: its
        equations and all bounds are also tested. It is not modified.
    x : array, shape (n,), result or QPSolution, optional
        The point of a problem of arrays; ``certify(result)`` is ``certify(result.program, result)``.
    multipliers : pair of arrays or QPSolution, optional
        Multipliers of G and of A that came with x, shapes (rows of G,) and (rows of A,), signs as in
        :class:`~lcp_plugin.problems.programs.solution.QPSolution`, which also has the multipliers of the bounds. They
        are checked to 10 · tolerance, relative to the terms of each condition: wrong multipliers are never proved.
        Without them the multipliers of a new solve are used.
    claim : str, optional
        The claim about a `QuadraticProgram`: "optimal", "infeasible" or "unbounded". Default: "optimal"; for a result
        or a cvxpy problem the claim of its status.
    tolerance : float
        "proved" means that x has the optimal value f* and is feasible: |f(x) − f*| ≤ tolerance · (Σ|c_j x_j|
        + |xᵀP x|), or 10⁻⁸ · tolerance of the rows' terms with their multipliers if that is more, and each c·x ≤ d or
        = d holds to tolerance · (|d| + Σ|c_j x_j|). If all terms of the objective are 0 the comparison is exact. If
        bounds of f* do not decide, the stopping criterion of programs does, with the multipliers. x may still be far
        from the minimizer if the objective is flat.
        "infeasible" is proved if every x violates a constraint by more than the tolerance,
        in the unit of the constraint, so that no x can be proved to be optimal.
    max_seconds : float, optional
        Approximate limit in seconds; claims that are not decided by then stay "unproved".
    pairs : "match" or mapping, optional
        Pairs of a square Pyomo model, as in ``solve(model, pairs=…)`` of :mod:`lcp_plugin.pyomo`.

    Returns
    -------
    Certification

    Raises
    ------
    UnsupportedModel
        If the problem is not a convex quadratic or linear program: cones, integers, a P that is not semidefinite.
    InvalidProblem
        If it has not been solved, or x or the multipliers do not fit it. For other problem classes the message names
        the right call.
    InvalidOption
        For another claim, a tolerance that is not a number in (0, 1), an impossible limit; without an x that is needed.

    Notes
    -----
    x is "disproved" if one of these is proved:

    - x violates a constraint by more than the tolerance.
    - A feasible point has an objective that is lower by more than the tolerance.
    - The program is unbounded.
    - A lower bound of f* exceeds f(x) by more than the tolerance.

    The claim "infeasible" is disproved if a feasible point exists, and "unbounded" if a finite lower bound exists. A
    Farkas certificate proves "infeasible", and a recession direction proves "unbounded", checked in rational
    arithmetic. If P is positive semidefinite only to rounding, bounds of f* require constraints that bound x. If the
    constraints are inconsistent by less than the tolerance, x is not disproved and "infeasible" is not proved. Inactive
    constraints, costs of x_j = 0 and the unit of the objective have no influence.

    A violation of constraints, however small, may lower the objective by any amount. If a feasible point is found,
    f* is bounded from both sides. Otherwise the bound by the multipliers of a new solve must agree with f(x): f* is
    then the optimal value with constraints relaxed by no more than the violation of x.

    For a cvxpy problem the values, the objective and the constraints are the user's, in double precision; bounds refer
    to the program that cvxpy derives.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> answer = certify(program, [0.5, 1.5])
    >>> answer.verdict, round(answer.lower, 12), round(answer.upper, 12)
    ('proved', -4.5, -4.5)
    >>> certify(program, [0.5, 1.51]).reason
    'a constraint is violated by 0.01'
    >>> certify(program, claim="infeasible").verdict
    'disproved'
    """
    if hasattr(problem, "measured"):  # its rows are spread over MPI ranks
        claimed = x, multipliers, claim, tolerance, max_seconds
        problem.halo.together(lambda: _check_point(problem, *claimed))
        return _verdict_at(*problem.measured(getattr(x, "x", x), float(tolerance)))
    _check_limits(tolerance, max_seconds)
    check_labels(problem, {"x": x})
    tolerance = float(tolerance)
    with deadline.limit(math.inf if max_seconds is None else float(max_seconds)):
        if isinstance(problem, QuadraticProgramResult) and x is None:
            problem, x = problem.program, problem
        if isinstance(x, QuadraticProgramResult) and claim is None and x.has_no_solution:
            claim = str(x.status.name).lower()
        if not isinstance(problem, QuadraticProgram):
            return _certify_other(problem, x, multipliers, claim, pairs, tolerance)
        if claim not in (None, *PROVABLE):
            raise InvalidOption(f"claim={claim!r} is not offered{did_you_mean(claim, PROVABLE)}")
        is_refused = claim != "infeasible" or problem.is_convex is not False
        if is_refused or no_minimum.proof_of_contradiction(problem) is None:
            refuse_nonconvex(problem)
        # Proofs are not cached under a time limit, because they may be incomplete.
        convex = problem.folded.program
        proofs = ProgramProofs.of(convex) if max_seconds is None else ProgramProofs(convex)
        if claim in ("infeasible", "unbounded"):
            verdict = proofs.prove_claim(str(claim), tolerance)
        else:
            point, y = claimed_point(problem, x, multipliers)
            verdict = proofs.prove_point(point, y, tolerance)
            for move in (proofs.on_bounds, proofs.with_zeros):
                near = point if verdict.verdict == "proved" else move(point, tolerance)
                if np.array_equal(near, point):
                    continue
                moved, is_noise = proofs.prove_point(near, y, tolerance), move == proofs.with_zeros
                if moved.verdict == "proved" or (is_noise and moved.verdict == "unproved"):
                    verdict = replace(moved, violation=verdict.violation)
            count = problem.constraints.rows
            y = np.zeros(count) if y is None else y[:count]
            rows = partial(worst_constraints, problem, point, y, tolerance)
            verdict = replace(verdict, rows=rows)
        rounding = "" if convex is problem else f", {WITHIN_ROUNDING}"
        verdict = replace(verdict, reason=f"{verdict.reason}{rounding}")
        if (shift := problem.constant) == 0.0:
            return verdict
        ends = (verdict.lower, -math.inf), (verdict.upper, math.inf)
        lower, upper = (b if b is None else math.nextafter(b + shift, e) for b, e in ends)
        return replace(verdict, lower=lower, upper=upper)


def _certify_other(
    problem: Any, x: Any, multipliers: Any, claim: Any, pairs: Any, tolerance: float
) -> Certification:
    """Return the verdict on a point of a problem of pairs, or on the values of a model."""
    name = class_of(problem)
    row = None if name is None else CLASSES[name]
    if row is not None and (row.criterion or row.verdict):
        _check_point(problem, x, multipliers, claim, tolerance)
        if row.verdict:
            return Certification(**resolve_name(f"lcp_plugin.{row.verdict}")(problem, x, tolerance))
        if isinstance(x, BaseResult):  # without a solution, of the best point
            x = getattr(x, "certificate", x).z if x.has_no_solution else x.x
        return certify_point(problem, checked_vector(x, "x", problem.n), tolerance)
    is_foreign = name is None and not isinstance(problem, (BaseResult, QPSolution))
    certify_model = foreign_function("certify", problem) if is_foreign else None
    if certify_model is None:
        raise InvalidProblem(refusal("certify", problem))
    if x is not None or multipliers is not None or claim is not None:
        raise InvalidOption("a model has values: leave out x, multipliers and claim")
    return certify_model(problem, tolerance, pairs)


def _check_point(problem: Any, x: Vector, multipliers: Any, claim: Any, *options: Any) -> None:
    """Raise InvalidOption unless x is the only claim about a problem of pairs."""
    _check_limits(*options)
    name = type(problem).__name__
    if multipliers is not None or claim is not None:
        fault = f"multipliers and claim go with a QuadraticProgram, got a {name}"
        raise InvalidOption(f"{fault}; give certify(problem, x)")
    if x is None:
        raise InvalidOption(f"certify needs a point of the {name}; give certify(problem, x)")


def certify_point(problem: Any, x: Vector, tolerance: float) -> Certification:
    """Return whether x satisfies the stopping criterion of a problem of pairs.

    x is not moved. If it passes only with zeros for unknowns at rounding level, it passes with these zeros. This is the
    function that ``solve`` applies to the points of its methods.

    Parameters
    ----------
    problem : LCP, NonlinearProblem or Blocks
    x : array, shape (n,)
    tolerance : float

    Raises
    ------
    InvalidProblem
        If an entry of x is NaN or infinite, or F is not defined at x.
    """
    criterion = resolve_name(f"lcp_plugin.{CLASSES[str(class_of(problem))].criterion}")
    x = checked_vector(x, "x", x.size)
    data, z, w, names = criterion(problem, x)
    near = x
    # Rounding errors of a bound do not count
    for bound in map(np.ravel, (data.lower, data.upper)):
        near = np.where(np.abs(x - bound) < NEAREST * np.abs(bound), bound, near)
    if not np.array_equal(near, x):
        data, z, w, names = criterion(problem, near)
    measured = data.with_zeros(data.measure_at(z, w, tolerance), tolerance)
    # The point to which a run would move x must pass too, because z_i may matter in other rows
    if np.all(measured.passes):
        near = data.snap_to_bounds(measured.z, measured.rows.w)
        if not np.array_equal(near, measured.z):
            again = data.measure_at(near, None, tolerance)
            measured = measured if np.all(again.passes) else again
    fails = bool(np.any(measured.by_row.fails(tolerance)))
    passes = not fails and bool(np.all(measured.passes))
    residual = float(np.max(measured.by_row.relative, initial=0.0))
    reason = "" if passes or fails else NOT_BY_A_ROW
    if fails and (residual <= tolerance or ((z < data.lower) | (z > data.upper)).any()):
        reason = worst_pairs(data, measured, names, tolerance, 1)[0].text
    violation = float(np.max(measured.rows.violation, initial=0.0))
    rows = partial(worst_pairs, data, measured, names, tolerance)
    return _verdict_at(passes, violation, residual, tolerance, reason, rows)


def with_side_conditions(verdict: Certification, violated: Sequence[WorstRow]) -> Certification:
    """Return the verdict on a point, disproved if it violates conditions that are not rows of its problem."""
    if not violated:
        return verdict
    violation = max(verdict.violation or 0.0, *(row.violation for row in violated))
    rows, reason = partial(_with_rows, tuple(violated), verdict), violated[0].text
    return replace(verdict, verdict="disproved", violation=violation, reason=reason, rows=rows)


def _with_rows(violated: tuple[WorstRow, ...], verdict: Certification, count: int) -> WorstRows:
    """Return the violated side conditions, then the worst rows."""
    return WorstRows((*violated, *verdict.worst(count))[:count])


def _verdict_at(
    passes: bool, violation: float, residual: float, tolerance: float, reason: str, rows: Any = None
) -> Certification:
    """Return the verdict on a point of complementarity conditions; the default reason is its residual."""
    verdict = "proved" if passes else "disproved"
    reason = reason or f"relative residual {residual:.3g}, tolerance {tolerance:g}"
    return Certification(verdict, "solved", max(0.0, violation), reason=reason, rows=rows)


def claimed_point(
    program: QuadraticProgram, x: Array, multipliers: object
) -> tuple[Vector, Vector | None]:
    """Return x, and multipliers of all constraints; for a pair, bounds get the remaining gradient."""
    if x is None:
        raise InvalidProblem(
            'certify needs an x; write certify(program, x), or certify(program, claim="infeasible")'
        )
    if isinstance(x, QuadraticProgramResult):
        x = x.solution
    if isinstance(x, QPSolution):
        x, multipliers = x.x, x if multipliers is None else multipliers
    x = checked_vector(x, "x", program.n)
    if multipliers is None:
        return x, None
    if isinstance(multipliers, QPSolution):
        size = program.constraints.limit.size
        return x, checked_vector(multipliers.multipliers, "multipliers", size)
    if not isinstance(multipliers, (tuple, list)) or len(multipliers) != 2:
        raise InvalidProblem("multipliers must be (inequality, equality) or a QPSolution")
    inequality = checked_vector(multipliers[0], "inequality", program.h.size)
    equality = checked_vector(multipliers[1], "equality", program.b.size)
    gradient = program.P @ x + program.c + program.G.T @ inequality + program.A.T @ equality
    return x, np.concatenate([inequality, equality, *bound_multipliers(program, gradient)])


def _check_limits(tolerance: float, max_seconds: Any = None) -> None:
    checked_tolerance(tolerance, may_be_zero=False)
    if max_seconds is not None and (not is_number(max_seconds) or not max_seconds > 0.0):
        raise InvalidOption(f"max_seconds must be a number > 0 or None, got {max_seconds!r}")


@dataclass(frozen=True, eq=False)
class Certification:
    """Verdict on a claimed solution of a program, with the proved bounds.

    Attributes
    ----------
    verdict : str
        "proved": the claim holds to the tolerance. "disproved": it is proved to be false. "unproved": neither.
    claim : str
        "optimal", "infeasible" or "unbounded".
    violation : float or None
        Largest violation of a constraint, in the unit of that constraint; None without an x.
    lower, upper : float or None
        Proved bounds of the optimal value; None if no bound is proved.
    gap : float or None
        A bound of the distance of f(x) from `lower`; None without an x or a lower bound.
    duality_gap : float or None
        Gap of the stopping criterion of programs with the multipliers; None if the exact bounds decide without it.
    reason : str
        Reason of the verdict.
    rows : callable or None
        Function that computes :meth:`worst`.
    """

    verdict: str
    claim: str
    violation: float | None = None
    lower: float | None = None
    upper: float | None = None
    gap: float | None = None
    duality_gap: float | None = None
    reason: str = ""
    rows: Callable[[int], WorstRows] | None = field(default=None, repr=False)

    __setstate__ = restore_state

    def worst(self, count: int = 5) -> WorstRows:
        """Return the rows of x that fail the criterion by most, the worst first; `print` shows a line for each."""
        count = whole_number(count, "count", 1)
        return WorstRows() if self.rows is None else self.rows(count)

    def __str__(self) -> str:
        numbers = {"violation": self.violation, "gap": self.gap}
        texts = [f"{name} {value:.3g}" for name, value in numbers.items() if value is not None]
        return f"{self.claim}: {self.verdict} ({', '.join([*texts, self.reason])})"


@dataclass(frozen=True, eq=False)
class ProgramProofs:
    """A convex program with all that is proved about its optimal value."""

    program: QuadraticProgram

    @classmethod
    def of(cls, program: QuadraticProgram) -> ProgramProofs:
        """Return the proofs cached with a program, because points of several solvers share them."""
        return program.known.setdefault("proofs", cls(program))

    @derived_property
    def bounds(self) -> value_bounds.DualBounds:
        """Data for lower bounds of the optimal value."""
        form = constrained_curvature(self.program.P, self.program.A)
        return value_bounds.DualBounds(self.program, form, value_bounds.implied_box(self.program))

    @derived_property
    def own_solution(self) -> QPSolution | None:
        """Solution of the program by a built-in solve; None if the time is over or the solve fails."""
        # a proof takes time as well
        with suppress(LCPError), deadline.limit(0.5 * deadline.left()):
            return solve_program(self.program, prove_infeasibility=False).solution
        return None

    @derived_property
    def own_lower(self) -> float:
        """The lower bound by the multipliers of the built-in solve."""
        if (solution := self.own_solution) is None:
            return -np.inf
        return self.lower(solution.x, solution.multipliers, solution.objective)

    def lower(self, x: Vector, y: Vector, value: float, allowed: float | None = None) -> float:
        """Return the lower bound by some multipliers, repaired if it is below the value by more than the allowed gap.

        By default the allowed gap is 1e-9 relative to the terms of the objective.
        """
        if allowed is None:  # no other form is tried below that
            allowed = 1e-9 * size_of_objective(self.program, x)[0]
        return self.bounds.best(x, y[: self.program.constraints.rows], value - allowed)

    def upper(self, *near: Vector) -> float:
        """Return a double above the objective of a feasible point near some points; or ∞."""
        values = (value_bounds.value_near(self.program, x) for x in near)
        return min((value for value in values if value is not None), default=math.inf)

    @derived_property
    def no_minimum(self) -> NoMinimum | None:
        """An exact proof that the program is infeasible or unbounded; None if no proof was found."""
        proof = no_minimum.known_proof(self.program)
        if proof is not None and not proof.is_exact:  # a solve may cache an inexact proof
            proof = no_minimum.proof_of_no_minimum(self.program, exactly=True)
        return proof if proof is not None and proof.is_exact and proof.verify() else None

    @property
    def is_small(self) -> bool:
        """True if the program is so small that an additional solve is worthwhile for a tighter bound."""
        return self.program.n + self.program.h.size + self.program.b.size <= SMALL

    # --- Claims -------------------------------------------------------------------------------------------------

    def prove_claim(self, claim: str, tolerance: float) -> Certification:
        """Return the verdict on a claim, "infeasible" or "unbounded"."""
        if (proof := self.no_minimum) is not None:
            if proof.status.name.lower() != claim:
                return Certification("disproved", claim, reason=f"the program is {proof}")
            if isinstance(proof, QPInfeasibility) and (least := proof.least_violation) <= tolerance:
                return Certification("unproved", claim, reason=f"{proof}, but by {least:.2g} only")
            return Certification("proved", claim, reason=str(proof))
        solution = self.own_solution
        upper, lower = self.upper(*([] if solution is None else [solution.x])), self.own_lower
        reason = ""
        if claim == "infeasible" and upper < math.inf:
            reason = "a feasible point is proved"
        elif claim == "unbounded" and lower > -np.inf:
            reason = f"no feasible x is below {lower + self.program.constant:.9g}"
        verdict = "disproved" if reason else "unproved"
        ends = _if_finite(lower), _if_finite(upper)
        return Certification(verdict, claim, None, *ends, reason=reason or UNPROVED)

    def on_bounds(self, x: Vector, tolerance: float) -> Vector:
        """Return x with each x_j on a bound if the move is negligible; x itself if the objective would change.

        Interior-point methods end at 1e-9 for a bound of 0, others at −1e-17. No gradient, no equality, and no row
        with a multiplier may change by more than the tolerance times its terms.
        """
        program, solution = self.program.reduced, self.own_solution
        if solution is None:
            return x
        terms, m = program.matrices.terms, program.h.size
        of_gradient = abs(terms.sparse_P) @ np.abs(x) + np.abs(program.c)
        of_rows = abs(terms.rows) @ np.abs(x) + np.abs(program.judged.d)
        sizes = np.append(of_gradient, of_rows)
        y = solution.reduced_y
        y[m:] = 1.0
        entries, moves = terms.gradient.tocoo(), np.full(program.n, np.inf)
        counts = np.append(np.ones(program.n), y)[entries.col] > 0.0
        at, sides = entries.row[counts], sizes[entries.col] / np.abs(entries.data)
        np.minimum.at(moves, at, sides[counts])
        moves = tolerance * np.where(moves < np.inf, moves, 0.0)
        near = np.where(np.abs(x - program.upper) <= moves, program.upper, x)
        near = np.where(np.abs(x - program.lower) <= moves, program.lower, near)
        change = np.abs(program.c + program.P @ near) @ np.abs(near - x)
        size = max(size_of_objective(program, x)[0], least_size(program.judged, x, y))
        return near if change <= tolerance * size else x

    def with_zeros(self, x: Vector, tolerance: float) -> Vector:
        """Return x with 0 for unknowns at rounding level of the largest of their component, as in the criterion."""
        return with_zeros(self.program.reduced.judged, x)

    def prove_point(self, x: Vector, multipliers: Vector | None, tolerance: float) -> Certification:
        """Return the verdict on a point and its multipliers of all constraints."""
        program, value = self.program, value_bounds.objective_bounds(self.program, x)
        violation, size = Violation.of(program, x, tolerance), size_of_objective(program, x)
        lower, complaint = -math.inf, ""
        if multipliers is not None:
            lower = self.lower(x, multipliers, value[0], tolerance * size[0])
            complaint = multiplier_error(program, x, multipliers, tolerance, size[0])
        numbers = value, violation, lower, self.upper(x), tolerance, size, program.constant
        bounds = ProvenBounds(*numbers)
        is_enough = bounds.is_proved() and not bounds.violation_may_lower_objective()
        if not is_enough or (self.is_small and (multipliers is None or complaint)):
            lower, near = max(lower, self.own_lower), [x]
            if (solution := self.own_solution) is not None:
                near.append(solution.x)
                y = solution.multipliers[: program.constraints.rows]
                if size[1] == 0.0:  # the comparison is exact
                    lower = max(lower, self.lower(x, y, value[0]))
                elif np.isfinite(y).all():
                    least = least_size(program.judged, x, y)
                    size = max(size[0], least), max(size[1], least)
            bounds = replace(bounds, lower=lower, upper=self.upper(*near), size=size)
            by_solve = replace(bounds, lower=self.own_lower)
            if bounds.violation_may_lower_objective() and not by_solve.is_proved():
                bought = f"its violation of {violation.largest:.2g} may buy more than the tolerance"
                complaint = complaint or bought
        verdict = bounds.certification(self, complaint)
        # An objective of 0 below every feasible one, by a violation of rounding: the criterion decides
        is_below = size[1] == 0.0 and bounds.lower > bounds.value[1]
        is_open = (verdict.verdict == "unproved" and not complaint) or is_below
        if is_open and violation.is_met:
            solved, folded = getattr(self.own_solution, "multipliers", None), program.folded
            known = [y[folded.left] for y in (multipliers, solved) if y is not None]
            errors = [KKTErrors.of(folded.reduced.judged, x, y, tolerance) for y in known]
            gaps = [error.gap for error in errors if not is_below or error.meet(tolerance)]
            if (gap := min(gaps, default=math.inf)) <= tolerance:
                reason = complaint or f"the stopping criterion holds: duality gap {gap:.2g}"
                name = "unproved" if complaint else "proved"
                verdict = replace(verdict, verdict=name, duality_gap=gap, reason=reason)
        return verdict


def size_of_objective(program: QuadraticProgram, x: Vector) -> tuple[float, float]:
    """Return doubles below and above Σ|c_j x_j| + |xᵀP x|; both are 0 if all terms are 0."""
    linear = float(np.abs(program.c * x).sum())
    below, above = (2.0 * value for value in value_bounds.objective_bounds(program, x, linear=0.0))
    curved = max(below, -above, 0.0), max(-below, above)
    return (linear + curved[0]) / OUTWARD, (linear + curved[1]) * OUTWARD


@dataclass(frozen=True)
class Violation:
    """Violation of the constraints at a point x.

    Attributes
    ----------
    largest : float
        A double above the largest violation of a constraint, in the unit of that constraint.
    is_met, is_missed : bool
        True if it is proved that all constraints hold to the tolerance, and that some constraint does not.
    """

    largest: float
    is_met: bool
    is_missed: bool

    @classmethod
    def of(cls, program: QuadraticProgram, x: Vector, tolerance: float) -> Violation:
        """Return the violation at x; constraints hold as in the criterion, relative to their terms."""
        judged = program.reduced.judged
        errors = PrimalDualPoint(judged, x, np.zeros(judged.d.size), is_exact=True).row_errors()
        largest = float(np.maximum(program.constraints.excess(x), 0.0).max(initial=0.0))
        is_missed = bool((errors > tolerance * OUTWARD**2).any())
        return cls(largest, bool((errors <= tolerance).all()), is_missed)


def largest_terms(rows: Any, limit: Vector, x: Vector) -> Vector:
    """Return the largest of |limit_i| and |rows_ij x_j| of each row; an infinite limit is none."""
    limits = np.where(np.isfinite(limit), np.abs(limit), 0.0)
    return np.maximum(largest_products(abs(rows), np.abs(x)), limits)


@dataclass(frozen=True, eq=False)
class ProvenBounds:
    """Proved numbers from which the verdict on a point follows.

    Attributes
    ----------
    value : pair of float
        Doubles below and above f(x).
    violation : Violation
    lower : float
        Lower bound of the optimal value; −∞ if there is no bound.
    upper : float
        Upper bound of the optimal value; ∞ without a feasible point.
    tolerance : float
    size : pair of float
        Doubles below and above Σ|c_j x_j| + |xᵀP x|, the reference of errors of values.
    constant : float
        Constant of the objective, which the other values do not contain.
    """

    value: tuple[float, float]
    violation: Violation
    lower: float
    upper: float
    tolerance: float
    size: tuple[float, float]
    constant: float

    @property
    def gap(self) -> float:
        """A bound of |f(x) − lower|."""
        ends = (self.value[1], -self.lower), (self.lower, -self.value[0])
        return max(0.0, *(float(sum_above(*end)) for end in ends))

    def disproof(self) -> str:
        """Return the disproof of the point as text, empty if there is none."""
        (below, above), allowed = self.value, self.tolerance * self.size[1] * OUTWARD
        least, shift = self.lower, self.constant
        if self.violation.is_missed:
            return f"a constraint is violated by {self.violation.largest:.3g}"
        if float(sum_above(self.upper, allowed)) < below:
            return f"a feasible point has the objective {self.upper + shift:.9g}, below {below + shift:.9g}"
        if least > float(sum_above(above, allowed)):
            return f"no feasible x is below {least + shift:.9g}, this one has {above + shift:.9g}"
        return ""

    def is_proved(self) -> bool:
        """Return whether the answer is optimal to the tolerance, by its value."""
        allowed = min(self.tolerance * self.size[0] / OUTWARD, LARGEST)
        return self.violation.is_met and self.gap <= allowed

    def violation_may_lower_objective(self) -> bool:
        """Return whether no feasible point shows that the violation, however small, buys less than the tolerance.

        Then a bound by multipliers that came with x may be as far below the optimal value as f(x) is.
        """
        allowed = self.value[1] + self.tolerance * self.size[0]
        return self.violation.largest > 0.0 and self.upper > allowed

    def certification(self, proofs: ProgramProofs, complaint: str) -> Certification:
        """Return the verdict and its numbers."""
        disproof, is_proved = self.disproof() or self._no_minimum(proofs), self.is_proved()
        verdict = "disproved" if disproof else "proved" if is_proved else "unproved"
        reason = disproof or self._reason(proofs.bounds.curvature.evidence, is_proved)
        if verdict == "proved" and complaint:
            verdict = "unproved"
            reason = f"{complaint}, though the objective is proved to be optimal"
        lower, upper, gap = map(_if_finite, (self.lower, self.upper, self.gap))
        largest = self.violation.largest
        return Certification(verdict, "optimal", largest, lower, upper, gap, reason=reason)

    def _no_minimum(self, proofs: ProgramProofs) -> str:
        """Return the disproof of every point, as text: the proof of the claim "infeasible", or a recession direction.

        The search requires that x violates a constraint by more than the tolerance, or that no lower bound is known.
        """
        is_missed = self.violation.largest > self.tolerance and self.upper == math.inf
        if deadline.is_over() or not (is_missed or self.lower == -math.inf):
            return ""
        proof = proofs.no_minimum
        if isinstance(proof, QPInfeasibility):
            return f"the program is {proof}" if proof.least_violation > self.tolerance else ""
        is_endless = proof is not None and proof.excludes(self.tolerance)
        return f"the program is {proof}" if is_endless else ""

    def _reason(self, evidence: str, is_proved: bool) -> str:
        if is_proved:
            return (
                f"no feasible x has an objective lower than this one's by more than {self.gap:.2g}, which the "
                f"multipliers prove by weak duality: {evidence}"
            )
        if not math.isfinite(self.lower):
            return f"{UNPROVED}: {evidence}, and no multipliers give a finite bound"
        if not self.violation.is_met:
            return f"a constraint is violated by up to {self.violation.largest:.3g}"
        return f"the objective is only proved to be within {self.gap:.3g} of the optimum"


def _if_finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def multiplier_error(
    program: QuadraticProgram, x: Vector, y: Vector, tolerance: float, size: float
) -> str:
    """Return the condition that the multipliers y violate by more than 10 · tolerance, as text; empty if none.

    The gradient is compared with its largest term, and wrong signs count by their effect on the gradient. y · slack is
    compared with the terms of the objective, `size`, and of the constraint.
    """
    rows, most = program.constraints, 10.0 * tolerance  # errors of multipliers
    columns = sp.csr_array(rows.matrix.T)
    wrong = np.where(rows.is_equality, 0.0, np.maximum(-y, 0.0))
    residual = np.abs(program.P @ x + program.c + columns @ y) + abs(columns) @ wrong
    terms = largest_terms(columns, largest_terms(program.matrices.terms.sparse_P, program.c, x), y)
    if not (residual <= most * terms).all():
        j = int((residual - most * terms).argmax())
        return f"the multipliers leave {residual[j]:.3g} of the gradient in component {j}"
    slack = np.where(rows.is_equality, 0.0, np.maximum(rows.limit - rows.matrix @ x, 0.0))
    price = np.where(y != 0.0, np.abs(y) * slack, 0.0)
    row_terms = np.abs(y) * largest_terms(rows.matrix, rows.limit, x)
    if not (price <= most * np.maximum(size, row_terms)).all():
        i = int(price.argmax())
        return f"a multiplier {y[i]:.3g} belongs to a row with {slack[i]:.3g} of slack"
    return ""
