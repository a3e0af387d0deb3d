"""What is proved about anybody's answer to a convex program: `certify`.

Everything that is said holds for the stored doubles, rounding included; the solver is never believed. A lower bound of
the optimal value comes from weak duality (:mod:`lcp_plugin.problems.programs.dual_bounds`), with the multipliers that
came with the answer and with those of a solution of our own; an upper bound from a point that is proved to be feasible.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, checked_vector, is_number, restored
from ...core.deadline import is_over, seconds_left, time_limit
from ...core.errors import InvalidOption, InvalidProblem, LCPError, did_you_mean
from ...core.kernels.floats import EPSILON, LARGEST
from ...core.matrix.matrix import largest_in_rows
from ...core.problem_classes import class_of, refusal
from ...core.rounding import compensated_product, gamma
from ...core.solving.answer import Answer
from ...proofs.bounds.curvature import constrained_curvature
from ...proofs.bounds.solution_bounds import norm_above
from ...proofs.exact.rational import enclosures
from ...proofs.exact.upward import quotient_above, sum_above
from .convexity import refuse_nonconvex
from .criterion import excused_rows
from .dual_bounds import DualBounds, implied_box
from .feasible_points import FeasiblePoint, FeasiblePoints, objective_bounds
from .no_minimum import QPInfeasibility, QPUnboundedness, proof_of_no_minimum
from .program import QuadraticProgram
from .program_matrices import as_csr
from .reductions import FoldedRows
from .solution import QPSolution
from .solving import QuadraticProgramResult, solve_program

CLAIMS = ("optimal", "infeasible", "unbounded")
SHARE = 0.5  # of a time limit: what multipliers may take, so that what they prove is left as much
ALMOST = 1e-9  # residuals of a program at which no other form of it is tried
SMALL = 400  # variables and rows of a program that is solved once more for a sharper bound
OUTWARD = 1.0 + 2.0**-30
NOTHING = "nothing can be proved"
LOOSE = (
    10.0  # times the tolerance: errors of x beside ‖x‖∞, of multipliers beside their column's terms
)
ACTS = 1e-2  # of the terms that act at x: what is small beside these is right in a column whose own terms are small


@np.errstate(all="ignore")  # what overflows proves nothing
def certify(
    problem: Any,
    x: Any = None,
    multipliers: Any = None,
    *,
    claim: str | None = None,
    tolerance: float = 1e-6,
    max_seconds: float | None = None,
) -> Certification:
    """Return what is proved about an answer to a convex quadratic or linear program, whoever found it.

    Parameters
    ----------
    problem : cvxpy.Problem or QuadraticProgram
        A cvxpy problem that some solver has filled; it is left as it is.
    x : array, shape (n,), QPSolution or QuadraticProgramResult, optional
        The answer to a `QuadraticProgram`; ``certify(result)`` is ``certify(result.program, result)``.
    multipliers : array, pair of arrays or QPSolution, optional
        Those of G and A that came with x: one array of them, with those of the lower and upper bounds behind them if
        you like, or a pair, or all four. Shapes (rows of G,), (rows of A,), (n,), (n,), signs as in
        :class:`~lcp_plugin.problems.programs.solution.QPSolution`. They are a part of the answer: wrong ones are
        never proved. Without them those of a solution of our own serve.
    claim : str, optional
        What is to be proved of a `QuadraticProgram`: "optimal", "infeasible" or "unbounded". By default "optimal",
        and of a result or a cvxpy problem what its status says.
    tolerance : float
        "proved" means: x has the optimal value f*, |f(x) − f*| ≤ tolerance · (Σ|c_j x_j| + |xᵀP x|), and meets the
        constraints: each c·x ≤ d or = d holds but for tolerance · max(|d|, largest |c_j x_j|, 1e-6 of what acts on the
        row), or where no x_j moves, within its bounds, by more than tolerance · min(1, ‖x‖∞). Where all terms are 0
        the comparison is exact. Neither is x proved to be farther than 10 · tolerance · ‖x‖∞ from every optimal one,
        nor are multipliers that came with it wrong by more than 10 · tolerance beside the terms of their conditions:
        sign, gradient, and 0 where x leaves slack. Of "infeasible": that every x violates a constraint by more than
        this, in its own unit, so that no x can be proved to be optimal.
    max_seconds : float, optional
        About how many seconds may be spent; what is not done by then stays unproved.

    Returns
    -------
    Certification

    Raises
    ------
    UnsupportedModel
        Where the problem is no convex quadratic or linear program: cones, integers, a P that is not semidefinite.
    InvalidProblem
        Where it has not been solved, or x or the multipliers do not fit it. Of other kinds it names the right call.
    InvalidOption
        For another claim, a tolerance that is no positive number, an impossible limit.

    Notes
    -----
    Disproved is: x that is proved to violate a constraint by more than that; a feasible point whose objective is lower
    by more, or falls for ever; a lower bound above f(x) by more; x that is proved to be farther than that from every
    optimal one; "infeasible" beside a feasible point; "unbounded" beside a finite lower bound. "infeasible" and
    "unbounded" are proved by a Farkas vector and by a direction of descent, checked in rational arithmetic. A P that is
    positive semidefinite only to rounding gives bounds where the constraints bound x. Constraints that contradict by
    less than the tolerance may be met to it: neither is such an x disproved nor "infeasible" proved. No limit that x
    leaves slack, no cost of an x_j that is 0, and no unit of the objective changes a verdict.

    An optimal value does not show errors of x below √tolerance: an x that is off by 1e-4 often has it to 1e-8, as
    have answers of interior points where a constraint is active without a multiplier. That is why "proved" asks for
    more. Where x violates constraints, however little, that may lower the objective by any amount. Where a feasible
    point is found, f* is bounded from both sides. Where none is, the bound by multipliers of our own has to agree with
    f(x): f* is then that of constraints moved by no more than x violates them.

    Of a cvxpy problem the values, the objective and the constraints are yours, in double precision; bounds are those
    of the program that cvxpy makes of it.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> answer = certify(program, [0.5, 1.5])
    >>> answer.verdict, round(answer.lower, 12), round(answer.upper, 12), answer.distance < 1e-6
    ('proved', -4.5, -4.5, True)
    >>> certify(program, [0.5, 1.51]).reason
    'a constraint is violated by 0.01'
    >>> certify(program, claim="infeasible").verdict
    'disproved'
    """
    _check_options(tolerance, max_seconds)
    with time_limit(math.inf if max_seconds is None else float(max_seconds)):
        if isinstance(problem, QuadraticProgramResult) and x is None:
            problem, x = problem.program, problem
        if isinstance(x, QuadraticProgramResult) and claim is None and x.has_no_solution:
            claim = str(x.status.name).lower()
        if not isinstance(problem, QuadraticProgram):
            if class_of(problem) is not None or isinstance(problem, (Answer, QPSolution)):
                raise InvalidProblem(refusal("certify", problem))
            if x is not None or multipliers is not None or claim is not None:
                raise InvalidOption(
                    "x, multipliers and claim go with a QuadraticProgram; a cvxpy problem has its own"
                )
            from ...modeling.certified_problem import certify_problem

            return certify_problem(problem, float(tolerance))
        if claim not in (None, *CLAIMS):
            raise InvalidOption(f"claim={claim!r} is not offered{did_you_mean(claim, CLAIMS)}")
        contradicts = (
            claim == "infeasible"
            and problem.is_convex is False
            and (problem.facts.proof_of_contradiction() is not None)
        )
        if not contradicts:
            refuse_nonconvex(problem)
        # What a time limit cut short is not kept.
        proofs = ProgramProofs.of(problem) if max_seconds is None else ProgramProofs(problem)
        if claim in ("infeasible", "unbounded"):
            return proofs.of_claim(str(claim), float(tolerance))
        answer = _answer(problem, x, multipliers)
        return proofs.of_answer(*answer, float(tolerance))


def _answer(
    program: QuadraticProgram, x: Any, multipliers: Any
) -> tuple[FloatVector, list[FloatVector] | None]:
    """Return x and the checked multipliers, of G and A or of all constraints."""
    if x is None:
        raise InvalidProblem(
            "certify needs the x that is claimed to be optimal; give certify(program, x), or a claim"
        )
    if isinstance(x, QuadraticProgramResult):
        x = x.solution
    if isinstance(x, QPSolution):
        x, multipliers = x.x, x if multipliers is None else multipliers
    point = checked_vector(x, "x", program.n)
    if multipliers is None:
        return point, None
    sizes = {
        "inequality": program.h.size,
        "equality": program.b.size,
        "lower": program.n,
        "upper": program.n,
    }
    if isinstance(multipliers, QPSolution):
        parts: Sequence[Any] = [getattr(multipliers, name) for name in sizes]
    elif isinstance(multipliers, Mapping):
        if unknown := [name for name in multipliers if name not in sizes]:
            raise InvalidProblem(
                f"unknown multipliers {unknown[0]!r}{did_you_mean(unknown[0], sizes)}"
            )
        last = 4 if {"lower", "upper"} & set(multipliers) else 2
        parts = [multipliers.get(name, np.zeros(size)) for name, size in list(sizes.items())[:last]]
    elif (
        isinstance(multipliers, (tuple, list))
        and len(multipliers) in (2, 4)
        and not is_number(multipliers[0])
    ):
        parts = multipliers
    else:
        parts = _split(checked_vector(multipliers, "multipliers", None), list(sizes.values()))
    return point, [
        checked_vector(part, name, size)
        for part, (name, size) in zip(parts, sizes.items(), strict=False)
    ]


def _split(values: FloatVector, sizes: list[int]) -> list[FloatVector]:
    ends = np.cumsum(sizes).tolist()
    if values.size not in (ends[1], ends[3]):
        raise InvalidProblem(
            f"multipliers must have length {ends[1]}, one a row of G and A, or {ends[3]} with those of the bounds, got "
            f"{values.size}"
        )
    return [
        part
        for part, end in zip(np.split(values, ends[:3]), ends, strict=True)
        if end <= values.size
    ]


def _check_options(tolerance: Any, max_seconds: Any) -> None:
    if not is_number(tolerance) or not 0.0 < tolerance < math.inf:
        raise InvalidOption(f"tolerance must be a number > 0, got {tolerance!r}")
    if max_seconds is not None and (not is_number(max_seconds) or not max_seconds > 0.0):
        raise InvalidOption(f"max_seconds must be a number > 0 or None, got {max_seconds!r}")


@dataclass(frozen=True, eq=False)
class Certification:
    """What is proved about an answer to a program.

    Attributes
    ----------
    verdict : str
        "proved": the claim holds to the tolerance. "disproved": it is proved to be false. "unproved": neither.
    claim : str
        "optimal", "infeasible" or "unbounded".
    violation : float or None
        The largest violation of a constraint, in its own unit; None where there is no x.
    lower, upper : float or None
        Proved bounds of the optimal value, None where nothing is proved.
    gap : float or None
        A bound of the distance of f(x) from `lower`; None without an x or a lower bound.
    reason : str
        Why this is the verdict.
    distance : float or None
        Upper bound of ‖x − x*‖₂, √(2 gap/μ) with the curvature μ; None if the optimal x* is not proved to be unique.
    """

    verdict: str
    claim: str
    violation: float | None = None
    lower: float | None = None
    upper: float | None = None
    gap: float | None = None
    reason: str = ""
    distance: float | None = None

    __setstate__ = restored

    def __str__(self) -> str:
        numbers = (
            f"{name} {value:.3g}"
            for name in ("violation", "gap", "distance")
            if (value := getattr(self, name)) is not None
        )
        return f"{self.claim}: {self.verdict} ({', '.join([*numbers, self.reason])})"


@dataclass(frozen=True, eq=False)
class ProgramProofs:
    """A convex program with all that is proved about its optimal value."""

    program: QuadraticProgram

    @classmethod
    def of(cls, program: QuadraticProgram) -> ProgramProofs:
        """Return the proofs that are kept with a program: the answers of several solvers need them once."""
        kept: ProgramProofs = program.__dict__.setdefault("_proofs", cls(program))
        return kept

    @cached_property
    def bounds(self) -> DualBounds:
        """What lower bounds are made of."""
        form = constrained_curvature(self.program.P, self.program.A)
        return DualBounds(self.program, form, implied_box(self.program))

    @cached_property
    def points(self) -> FeasiblePoints:
        """Where feasible points come from."""
        return FeasiblePoints(self.program)

    @cached_property
    def own_solution(self) -> QPSolution | None:
        """The solution of the program that we find; None where there is no time, or the problem overflows."""
        with suppress(LCPError), time_limit(SHARE * seconds_left()):  # a proof takes time as well
            return solve_program(self.program, prove_infeasibility=False).solution
        return None

    @cached_property
    def own_lower(self) -> float:
        """The lower bound by the multipliers of our own solution."""
        own = self.own_solution
        return (
            -np.inf
            if own is None
            else self.lower(own.x, own.inequality, own.equality, own.objective)
        )

    def lower(
        self,
        x: FloatVector,
        inequality: FloatVector,
        equality: FloatVector,
        value: float,
        allowed: float | None = None,
    ) -> float:
        """Return the lower bound by some multipliers, repaired where they prove less than the value but for a gap.

        By default an allowed gap is 1e-9 beside the terms of the objective.
        """
        enough = value - (
            ALMOST * size_of_objective(self.program, x)[0] if allowed is None else allowed
        )
        return self.bounds.best(x, np.concatenate([inequality, equality]), enough)

    def upper(
        self, *near: FloatVector, exactly: bool = True, by_own: bool = True
    ) -> list[FeasiblePoint]:
        """Return points that are proved to be feasible, near those given and our own solution, or else any.

        Rational arithmetic looks for one where doubles prove none, unless it is not to, and nobody for a solution of
        our own that is not to be looked at.
        """
        found = [point for x in near if (point := self.points.near(x)) is not None]
        if "own_solution" in self.__dict__ or (self.is_small and by_own):
            found += self._own_point
        return found if found or not exactly else self._inside

    @cached_property
    def _own_point(self) -> list[FeasiblePoint]:
        own = None if self.own_solution is None else self.points.near(self.own_solution.x)
        return [] if own is None else [own]

    @cached_property
    def _inside(self) -> list[FeasiblePoint]:
        inside = self.points.inside
        return [] if inside is None else [FeasiblePoint.of(self.program, *enclosures(inside))]

    @cached_property
    def no_minimum(self) -> QPInfeasibility | QPUnboundedness | None:
        """An exact proof that the program has no minimum; None where none was found."""
        proof = self.program.facts.proof_of_no_minimum
        if proof is not None and not proof.is_exact:  # what a solve keeps need not be
            proof = proof_of_no_minimum(self.program, exactly=True)
        return proof if proof is not None and proof.is_exact and proof.verify() else None

    @property
    def is_small(self) -> bool:
        """Whether a solution of our own is worth its time where nothing depends on it."""
        return self.program.n + self.program.h.size + self.program.b.size <= SMALL

    # --- Claims -------------------------------------------------------------------------------------------------

    def of_claim(self, claim: str, tolerance: float) -> Certification:
        """Return what is proved about "infeasible" or "unbounded"."""
        if (proof := self.no_minimum) is not None:
            if proof.verdict != claim:
                return Certification("disproved", claim, reason=f"the program is {proof}")
            if isinstance(proof, QPInfeasibility) and (least := proof.least_violation) <= tolerance:
                return Certification("unproved", claim, reason=f"{proof}, but by {least:.2g} only")
            return Certification("proved", claim, reason=str(proof))
        points = self.upper()
        upper = min((point.value for point in points), default=math.inf)
        lower = self.own_lower
        unproved = Certification(
            "unproved", claim, lower=_if_finite(lower), upper=_if_finite(upper), reason=NOTHING
        )
        if claim == "infeasible" and points:
            return replace(unproved, verdict="disproved", reason="a feasible point is proved")
        if claim == "unbounded" and lower > -np.inf:
            return replace(
                unproved, verdict="disproved", reason=f"no feasible x is below {lower:.9g}"
            )
        return unproved

    def of_answer(
        self, x: FloatVector, given: list[FloatVector] | None, tolerance: float
    ) -> Certification:
        """Return what is proved about a point, and the multipliers that came with it."""
        value, violation = (
            objective_bounds(self.program, x),
            Violation.of(self.program, x, tolerance),
        )
        size = size_of_objective(self.program, x)
        lower, complaint = -math.inf, ""
        if given is not None:
            lower = self.lower(x, given[0], given[1], value[0], tolerance * size[0])
            complaint = multiplier_error(self.program, x, given, tolerance, size[0])
        found = Proved(
            value, violation, lower, self.upper(x, exactly=False, by_own=False), tolerance, size
        )
        is_enough = found.is_proved() and not found.may_have_bought()
        if not is_enough or (self.is_small and (given is None or complaint)):
            lower = max(lower, self.own_lower)
            if (
                lower < value[0] and size[1] == 0.0 and (own := self.own_solution) is not None
            ):  # nothing else will do
                lower = max(lower, self.lower(x, own.inequality, own.equality, value[0]))
            points = self.upper(x, exactly=False) or self.upper(x, exactly=not violation.is_missed)
            found = replace(found, lower=lower, points=points)
            if found.may_have_bought() and not replace(found, lower=self.own_lower).is_proved():
                complaint = (
                    complaint
                    or f"its violation of {violation.largest:.2g} may buy more than the tolerance"
                )
        return found.certification(self, x, complaint)


def size_of_objective(program: QuadraticProgram, x: FloatVector) -> tuple[float, float]:
    """Return doubles below and above Σ|c_j x_j| + |xᵀP x|; both are 0 where all terms are."""
    linear = float(np.abs(program.c * x).sum())
    below, above = (2.0 * value for value in objective_bounds(program, x, linear=0.0))
    curved = max(below, -above, 0.0), max(-below, above)
    return (linear + curved[0]) / OUTWARD, (linear + curved[1]) * OUTWARD


@dataclass(frozen=True)
class Violation:
    """By how much an x violates the constraints.

    Attributes
    ----------
    least, largest : float
        Doubles below and above the largest violation of a constraint, in its own unit.
    is_met, is_missed : bool
        Whether it is proved that no constraint is violated by more than a tolerance allows, and that one is.
    """

    least: float
    largest: float
    is_met: bool
    is_missed: bool

    @classmethod
    @np.errstate(all="ignore")  # what overflows is not met
    def of(cls, program: QuadraticProgram, x: FloatVector, tolerance: float) -> Violation:
        """Return that of x: beside the terms of each row, what a step of each x_j within its bounds mends, what acts.

        What acts excuses a row here as it does where a program is solved: neither call may refute the other.
        """
        rows = program.constraints
        finite = rows.finite
        matrix, limit, is_equality = (
            rows.matrix[finite],
            rows.limit[finite],
            rows.is_equality[finite],
        )
        value, radius = compensated_product(matrix, x, -limit)
        step = tolerance * min(1.0, float(np.abs(x).max(initial=0.0)))
        below, above = step_within_bounds(program, x, step)
        positive, negative = matrix.maximum(0.0), (-matrix).maximum(0.0)
        falls, rises = positive @ below + negative @ above, positive @ above + negative @ below
        mended = np.where(is_equality & (value < 0.0), rises, falls)
        size = np.where(is_equality, np.abs(value), value)
        least, largest = np.maximum(size - radius, 0.0), np.maximum(rows.excess(x)[finite], 0.0)
        allowed = np.maximum(tolerance * largest_terms(matrix, limit, x), mended)
        if (largest > allowed).any():
            excused = np.concatenate([excused_rows(program, x), np.zeros(2 * program.n)])[finite]
            allowed = np.maximum(allowed, excused)
        return cls(
            float(least.max(initial=0.0)) / OUTWARD,
            float(largest.max(initial=0.0)),
            bool((largest <= allowed).all()),
            bool((least > allowed * OUTWARD).any()),
        )


def step_within_bounds(
    program: QuadraticProgram, x: FloatVector, step: float
) -> tuple[FloatVector, FloatVector]:
    """Return how far each x_j may move down and up, no farther than a step and within bounds, rows of one x_j too."""
    folded = FoldedRows.of(program).reduced
    return np.clip(OUTWARD * (x - folded.lower), 0.0, step), np.clip(
        OUTWARD * (folded.upper - x), 0.0, step
    )


def largest_terms(rows: Any, limit: FloatVector, x: FloatVector) -> FloatVector:
    """Return the largest of |limit_i| and |rows_ij x_j| of each row; an infinite limit is none."""
    terms = sp.csr_array(
        (np.abs(rows.data * x[rows.indices]), rows.indices, rows.indptr), rows.shape
    )
    return np.maximum(largest_in_rows(terms), np.where(np.isfinite(limit), np.abs(limit), 0.0))


@dataclass(frozen=True, eq=False)
class Proved:
    """The numbers that a verdict on an answer is made of.

    Attributes
    ----------
    value : pair of float
        Doubles below and above f(x).
    violation : Violation
    lower : float
        Of the optimal value; −∞ where there is none.
    points : list of FeasiblePoint
    tolerance : float
    size : pair of float
        Doubles below and above Σ|c_j x_j| + |xᵀP x|: errors of values are measured beside that.
    """

    value: tuple[float, float]
    violation: Violation
    lower: float
    points: list[FeasiblePoint] = field(repr=False)
    tolerance: float
    size: tuple[float, float]

    @property
    def upper(self) -> float:
        """Of the optimal value; ∞ where there is none."""
        return min((point.value for point in self.points), default=math.inf)

    @property
    def gap(self) -> float:
        """A bound of |f(x) − lower|."""
        return max(
            float(sum_above(self.value[1], -self.lower)),
            float(sum_above(self.lower, -self.value[0])),
            0.0,
        )

    def disproof(self) -> str:
        """Return what disproves the answer, or nothing."""
        (below, above), allowed = self.value, self.tolerance * self.size[1] * OUTWARD
        if self.violation.is_missed:
            return f"a constraint is violated by {self.violation.least:.3g}"
        if float(sum_above(self.upper, allowed)) < below:
            return f"a feasible point has the objective {self.upper:.9g}, below {below:.9g}"
        if self.lower > float(sum_above(above, allowed)):
            return f"no feasible x is below {self.lower:.9g}, and this one has {above:.9g}"
        return ""

    def is_proved(self) -> bool:
        """Return whether the answer is optimal to the tolerance, by its value."""
        return self.violation.is_met and self.gap <= min(
            self.tolerance * self.size[0] / OUTWARD, LARGEST
        )

    def may_have_bought(self) -> bool:
        """Return whether no feasible point shows that the violation, however small, buys less than the tolerance.

        Then a bound by multipliers that came with x may be as far below the optimal value as f(x) is.
        """
        return (
            self.violation.largest > 0.0
            and self.upper > self.value[1] + self.tolerance * self.size[0]
        )

    def certification(
        self, proofs: ProgramProofs, x: FloatVector, complaint: str, columns: Any = slice(None)
    ) -> Certification:
        """Return the verdict and its numbers; distances in some of the columns."""
        near, far, far_in_columns = distances(proofs, x, self.points, self.lower, columns)
        disproof, is_proved = self.disproof() or self._no_minimum(proofs), self.is_proved()
        size = float(np.abs(x).max(initial=0.0))
        disproof = disproof or self._error_of_x(size, far_in_columns, "x")
        verdict = "disproved" if disproof else "proved" if is_proved else "unproved"
        reason = disproof or self._reason(proofs.bounds.curvature.evidence, is_proved)
        complaint = (
            self._error_of_x(size, far, "x, with the variables that cvxpy added,") or complaint
        )
        if verdict == "proved" and complaint:
            verdict, reason = "unproved", complaint
        if is_proved and verdict != "proved":
            reason += ", though the objective is proved to be optimal"
        return Certification(
            verdict,
            "optimal",
            self.violation.largest,
            _if_finite(self.lower),
            _if_finite(self.upper),
            _if_finite(self.gap),
            reason,
            _if_finite(near),
        )

    def _no_minimum(self, proofs: ProgramProofs) -> str:
        """Return what disproves every answer, whatever its numbers are; looked for where there is no lower bound."""
        proof = proofs.no_minimum if self.lower == -math.inf and not is_over() else None
        is_endless = isinstance(proof, QPUnboundedness) and proof.excludes(self.tolerance)
        return f"the program is {proof}" if is_endless else ""

    def _error_of_x(self, size: float, far: float, what: str) -> str:
        """Return what proves that an x of that size is not optimal although its value may be, or nothing."""
        is_far = far > LOOSE * self.tolerance * size
        return f"{what} is proved to be at least {far:.3g} from every optimal one" if is_far else ""

    def _reason(self, evidence: str, is_proved: bool) -> str:
        if is_proved:
            return (
                f"no feasible x has an objective lower than this one's by more than {self.gap:.2g}, which the "
                f"multipliers prove by weak duality: {evidence}"
            )
        if not math.isfinite(self.lower):
            return f"{NOTHING}: {evidence}, and no multipliers give a finite bound"
        if not self.violation.is_met:
            return f"a constraint is violated by up to {self.violation.largest:.3g}"
        return f"the objective is only proved to be within {self.gap:.3g} of the optimum"


@np.errstate(all="ignore")  # what overflows bounds nothing
def distances(
    proofs: ProgramProofs,
    x: FloatVector,
    points: Sequence[FeasiblePoint],
    lower: float,
    columns: Any,
) -> tuple[float, float, float]:
    """Return bounds, from above and from below, of ‖x − x*‖₂ for every optimal x*; ∞ where that is not the only one.

    The bound from above is that of some columns, and a third one bounds these from below.

    Notes
    -----
    Let y be feasible and g = 2 (f(y) − lower). Then Σ μ_i (y_i − x*_i)² ≤ g: a value that is optimal to t leaves x an
    error of √t. With Q = P + ρ AᵀA, the form of the curvature, u = x − y and e = x − x*, also where some μ_i are 0,

        ‖Q u‖‖e‖ ≥ uᵀQ e = uᵀQ u + uᵀQ (y − x*) ≥ uᵀQ u − √(uᵀQ u · g).
    """
    curvature, near, far, far_in_columns = proofs.bounds.curvature, math.inf, 0.0, 0.0
    if lower == -math.inf or not curvature.is_semidefinite:
        return near, far, far_in_columns
    least = float(curvature.weights[columns].min(initial=math.inf))
    for point in points:
        u, gap = x - point.near, 2.0 * max(float(sum_above(point.value, -lower)), 0.0)
        blur = float(norm_above(point.radius + EPSILON * np.abs(u)))
        far = max(far, _length_below(proofs, u, gap) / OUTWARD - blur * OUTWARD)
        if 0.0 < least < math.inf:
            blur += math.sqrt(float(quotient_above(gap, least))) * OUTWARD
            length = float(norm_above(np.abs(u[columns])))
            near = min(near, (length + blur) * OUTWARD)
            far_in_columns = max(far_in_columns, length / OUTWARD**2 - blur * OUTWARD)
    is_all = np.unique(np.arange(x.size)[columns]).size == x.size
    far = max(far, far_in_columns)
    return near, far, far if is_all else far_in_columns


def _length_below(proofs: ProgramProofs, u: FloatVector, gap: float) -> float:
    """Return (uᵀQ u − √(uᵀQ u · gap)) / ‖Q u‖, rounded down; 0 where rounding hides it."""
    P, A, penalty = (
        proofs.program.matrices.sparse_P,
        as_csr(proofs.program.A),
        proofs.bounds.curvature.penalty,
    )
    bent = P @ u + penalty * (A.T @ (A @ u))
    terms = abs(P) @ np.abs(u) + penalty * (abs(A).T @ (abs(A) @ np.abs(u)))
    share = gamma(2 * u.size + A.shape[0] + 8)
    square, rounding = float(u @ bent), share * float(np.abs(u) @ terms)
    length = float(np.linalg.norm(bent) + share * np.linalg.norm(terms))
    if not (square > rounding and 0.0 < length < math.inf):
        return 0.0
    return (square - rounding - math.sqrt((square + rounding) * gap)) / length


def _if_finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@np.errstate(all="ignore")  # what overflows is wrong
def multiplier_error(
    program: QuadraticProgram,
    x: FloatVector,
    given: list[FloatVector],
    tolerance: float,
    terms_of_objective: float,
) -> str:
    """Return what is wrong with multipliers that were given, beyond what repairing them may excuse, or nothing.

    The terms of column j are c_j, p_jk x_k and c_ij y_i; what is small beside ACTS times the largest of the first two
    where x is off its bounds is right, too. A bound without a multiplier takes up what is left of the gradient.
    """
    rows, names, y = (
        program.constraints,
        ("inequality", "equality", "lower", "upper"),
        np.concatenate(given),
    )
    P, of_rows = program.matrices.sparse_P, sp.csr_array(rows.matrix.T)
    if y.size < rows.limit.size:
        left = program.P @ x + program.c + rows.matrix[: y.size].T @ y
        sides = (
            np.where(np.isfinite(bound), np.maximum(sign * left, 0.0), 0.0)
            for sign, bound in ((1.0, program.lower), (-1.0, program.upper))
        )
        y = np.concatenate([y, *sides])
    base = largest_terms(P, program.c, x)
    terms = np.maximum(base, largest_terms(of_rows, base, y))
    acts = float(base[(program.lower < x) & (x < program.upper)].max(initial=0.0))
    allowed = LOOSE * tolerance * np.maximum(terms, ACTS * acts)
    is_finite = np.isfinite(rows.limit)
    wrong = np.where(rows.is_equality, 0.0, np.where(is_finite, np.maximum(-y, 0.0), np.abs(y)))
    pulls = np.abs(of_rows.data) * wrong[of_rows.indices] > np.repeat(
        allowed, np.diff(of_rows.indptr)
    )
    if pulls.any():
        i = int(of_rows.indices[np.argmax(pulls)])
        if not is_finite[i]:
            return f"a multiplier {y[i]:.3g} stands where there is no limit"
        ends = np.cumsum([0, *rows.sizes])
        k = int(np.searchsorted(ends, i, side="right")) - 1
        return f"the multiplier {names[k]}[{i - ends[k]}] = {y[i]:.3g} has the wrong sign"
    slack = np.where(
        is_finite & ~rows.is_equality, np.maximum(rows.limit - rows.matrix @ x, 0.0), 0.0
    )
    own = np.abs(y) * largest_terms(rows.matrix, rows.limit, x)
    excess = np.abs(y * slack) - LOOSE * tolerance * np.maximum(terms_of_objective, own)
    given_size, worst = sum(part.size for part in given), int(np.argmax(excess))
    if excess.max(initial=0.0) > 0.0 and worst < given_size:
        return f"a multiplier {y[worst]:.3g} stands where there is {slack[worst]:.3g} of slack"
    s = program.P @ x + program.c + rows.matrix.T @ np.where(excess > 0.0, 0.0, y)
    if (np.abs(s) > allowed).any():
        j = int((np.abs(s) - allowed).argmax())
        return f"the multipliers leave {abs(s[j]):.3g} of the gradient in component {j}"
    return ""
