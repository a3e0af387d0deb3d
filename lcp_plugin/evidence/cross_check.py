"""cross_validate(): our solution compared with the solution of a convex solver, within the accuracy of both.

For any two points with residuals r, r′ (scaled by d, so that A = D^−½ M D^−½) and δ = D^½ (z − z′)

    δᵀAδ ≤ ‖D^½ (r − r′)‖ (‖Aδ‖ + ‖δ‖),

for all bounds: add the two projection inequalities. If M is monotone the left side is not negative, so that
δᵀAδ / (‖Aδ‖ + ‖δ‖), here the *disagreement*, is at most the *allowance* ‖D^½ r‖ + ‖D^½ r′‖. The test needs no condition
number, ignores directions in which z is not unique, and fails if a reported residual is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ..api import solve
from ..core.certificates.criterion import row_data, scaled_residual
from ..core.certificates.residuals import Certificate
from ..core.checks import FloatVector
from ..core.errors import InvalidOption
from ..core.lcp import LCP
from ..core.problem_classes import refusal
from ..core.settings import Settings, Status
from ..core.solving.result import Result
from ..methods.newton.active_set import classify, solve_active_set
from .convex_program import PLAIN, ReferenceProgram, solve_by, solver_name

Verdict = Literal["agree", "mismatch", "not comparable"]

ACCURATE_TOLERANCE, ROUGH_TOLERANCE = (
    1e-7,
    1e-3,
)  # tolerances of our criterion that a point must meet to be compared
DIFFERENCE_RATIO = 1e-6
POLISH_ROUNDS = 3
CLARABEL_OPTIONS = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-11)


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """Comparison of our solution with the solution of a convex solver: whether both agree within the accuracy of both.

    Attributes
    ----------
    verdict : {"agree", "mismatch", "not comparable"}
        "not comparable" if no convex program exists, if one of the two solutions is not accurate, or if the same
        solver computed both.
    reason : str
        One line.
    reference : str
        cvxpy's name of the convex solver.
    formulation : str
        The convex program that the reference solved, or why there is none.
    ours, theirs : Certificate or None
        Computed here on the user's data; `theirs` after a polish on its active set.
    seconds, reference_seconds : float
        Wall-clock seconds of each; the reference's with cvxpy's part.
    difference_z, difference_w : float
        ‖z − z′‖∞ and ‖w − w′‖∞; NaN if nothing was compared.
    objective_gap : float
        Ours minus the reference's: of ½ zᵀMz + qᵀz if M is symmetric, else of the sum of the products z_i w_i, each
        z_i relative to its bound.
    disagreement, allowance : float
        δᵀAδ / (‖Aδ‖ + ‖δ‖), and the bound on it by both residuals with their rounding.
    """

    verdict: Verdict
    reason: str
    reference: str
    formulation: str
    ours: Certificate = field(repr=False)
    theirs: Certificate | None = field(default=None, repr=False)
    seconds: float = 0.0
    reference_seconds: float = 0.0
    difference_z: float = math.nan
    difference_w: float = math.nan
    objective_gap: float = math.nan
    disagreement: float = math.nan
    allowance: float = math.nan

    @property
    def agrees(self) -> bool:
        """True if the verdict is "agree"."""
        return self.verdict == "agree"

    def explain(self) -> str:
        """Return the verdict with its reason, and a line for each number."""
        lines = [
            f"{self.verdict}: {self.reason}",
            f"{'formulation':<18} {self.formulation}",
            _side("ours", self.ours, self.seconds),
        ]
        if self.theirs is not None:
            lines += [
                _side(self.reference, self.theirs, self.reference_seconds),
                f"{'|Δz|, |Δw|':<18} {self.difference_z:.3e}, {self.difference_w:.3e}",
                f"{'objective gap':<18} {self.objective_gap:.3e}",
                f"{'disagreement':<18} {self.disagreement:.3e}; the residuals explain {self.allowance:.3e}",
            ]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.explain()


@np.errstate(all="ignore")
def cross_validate(
    problem: LCP,
    result: Result | None = None,
    reference: str = "CLARABEL",
    *,
    algorithm: str = "auto",
    tolerance: float = 1e-9,
    max_seconds: float = 60.0,
    **options: Any,
) -> CrossCheck:
    """Compare our solution with the solution of a convex solver, if M makes the problem convex.

    Parameters
    ----------
    problem : LCP
        Never modified.
    result : Result, optional
        The solution to check; by default it is computed here. Its own certificate is not used.
    reference : str
        Name of any solver of quadratic programs that cvxpy has installed.
    algorithm : str
        Our algorithm if no result is given.
    tolerance : float
        Relative residual of our run.
    max_seconds : float
        Limit in seconds of our run, and of a reference that cvxpy gives a limit (CLARABEL, HIGHS, OSQP, SCS). The
        factorization that decides whether there is a convex program is not interrupted.
    **options
        Options of the reference, as ``eps_abs=1e-9`` of OSQP. Clarabel has the tolerance 1e-11 by default.

    Returns
    -------
    CrossCheck
        "not comparable" if M is neither symmetric positive semidefinite nor monotone.

    Raises
    ------
    InvalidOption, InvalidProblem
        If an argument cannot be used.

    Examples
    --------
    >>> check = cross_validate(LCP([[2, 1], [1, 2]], [-5, 1]))
    >>> check.verdict, check.difference_z < 1e-8
    ('agree', True)
    """
    if not isinstance(problem, LCP):
        raise InvalidOption(refusal("cross_validate", problem))
    if result is not None and not isinstance(result, Result):
        raise InvalidOption(f"result must be a Result of solve, got {type(result).__name__}")
    name = solver_name(reference)
    if result is None:
        result = solve(problem, algorithm, tolerance=tolerance, max_seconds=max_seconds)
    ours, seconds = Certificate.of(problem, result.z), result.seconds
    if problem.n == 0:
        return CrossCheck("agree", "the problem has no unknowns", name, "", ours)
    convex = ReferenceProgram.of(problem)
    if not convex.kind:
        is_false = _claims(result) and not _keeps_claim(result, ours)
        reason = f"no convex program to compare with; our status {result.status.name} is " + (
            "false" if is_false else "consistent with our residual"
        )
        verdict: Verdict = "mismatch" if is_false else "not comparable"
        return CrossCheck(verdict, reason, name, convex.evidence, ours, seconds=seconds)
    formulation = f"{convex.kind} ({convex.evidence})"
    if _is_computed_by(result, name):
        reason = f"{name} computed our solution too (interior_point); choose another reference"
        return CrossCheck("not comparable", reason, name, formulation, ours, seconds=seconds)
    tight = CLARABEL_OPTIONS if name == "CLARABEL" else {}
    reply = solve_by(name, convex, max_seconds, tight | options)
    if reply.z is None:
        reason = f"{name} gave no point: {reply.status}"
        return CrossCheck("not comparable", reason, name, formulation, ours, seconds=seconds)
    theirs = polish(Certificate.of(problem, reply.z))
    facts = _compare(convex, ours, theirs) if np.isfinite(ours.z).all() else {}
    return CrossCheck(
        *_verdict_of(result, ours, theirs, name, facts),
        name,
        formulation,
        ours,
        theirs,
        seconds,
        reply.seconds,
        **{key: value for key, value in facts.items() if key[0] != "_"},
    )


def _is_computed_by(result: Result, name: str) -> bool:
    """Return whether the convex solver may have computed our result: interior_point hands its program to PIQP first."""
    remarks = [stage.remark for stage in result.stages if stage.name == "interior_point"]
    return bool(remarks) and (name == "PIQP" or any(name.lower() in one for one in remarks))


def _compare(convex: ReferenceProgram, ours: Certificate, theirs: Certificate) -> dict[str, Any]:
    """Return the differences, in the unit-free variables D^½ z / unit and D^−½ w / unit where they have no unit."""
    step, rise = ours.z - theirs.z, ours.w - theirs.w
    weight, unit = convex.weight / convex.unit, convex.weight * convex.unit
    length, slope = float(np.linalg.norm(step * weight)), float(np.linalg.norm(rise / unit))
    size = max(float(np.linalg.norm(side.z * weight)) for side in (ours, theirs))
    is_plain = convex.kind == PLAIN  # the gap is a difference of squares then, without cancellation
    gap = float(0.5 * step @ (ours.w + theirs.w))
    if not is_plain:
        gap = float(np.sum(ours.products) - np.sum(theirs.products))
    return {
        "difference_z": _largest(step),
        "difference_w": _largest(rise),
        "objective_gap": gap,
        "disagreement": max(float((step * weight) @ (rise / unit)), 0.0) / (length + slope)
        if length + slope
        else 0.0,
        "allowance": _weighted_residual(convex, ours) + _weighted_residual(convex, theirs),
        "_apart": length / size if length else 0.0,
        "_rise": slope / length if length else 0.0,
    }


def _weighted_residual(convex: ReferenceProgram, side: Certificate) -> float:
    """Return ‖D^½ r‖ / unit, rounding included."""
    problem, scale = side.problem, np.square(convex.weight)
    data = row_data(problem)
    floor = data.rounding_floor(data.rows(side.z).terms, scale)
    residual = np.abs(scaled_residual(problem, side.z, side.w, scale)) + floor
    return float(np.linalg.norm(residual * convex.weight / convex.unit))


def _verdict_of(
    result: Result, ours: Certificate, theirs: Certificate, name: str, facts: dict[str, Any]
) -> tuple[Verdict, str]:
    """Return the verdict and its reason; the first that applies."""
    claimed = _claims(result)
    residuals = (
        f"relative residuals {ours.relative_residual:.1e} and {theirs.relative_residual:.1e}"
    )
    # An interior point need not meet the test of every row: z next to a bound leaves a small w_i unchanged.
    if not theirs.relative_residual <= ACCURATE_TOLERANCE:
        return (
            "not comparable",
            f"the solution of {name} does not reach {ACCURATE_TOLERANCE:.0e}: {residuals}",
        )
    if not facts or (claimed and not _keeps_claim(result, ours)):
        return (
            "mismatch",
            f"our status {result.status.name} is false, {name} is accurate: {residuals}",
        )
    if not ours.meets(Settings(tolerance=ROUGH_TOLERANCE if claimed else ACCURATE_TOLERANCE)):
        return "not comparable", f"our solution is not accurate, {result.status.name}: {residuals}"
    if not facts["disagreement"] <= facts["allowance"]:
        return "mismatch", (
            f"the residuals explain {facts['allowance']:.1e} of a disagreement of {facts['disagreement']:.1e}: one of "
            "them is wrong, or the two sides solved different problems"
        )
    if facts["_apart"] <= DIFFERENCE_RATIO:
        return "agree", "same solution within both residuals"
    if facts["_rise"] <= DIFFERENCE_RATIO:
        return "agree", "same w and objective; z is not unique"
    return "agree", (
        f"z differs by {facts['difference_z']:.1e}, within the residuals and the conditioning of M"
    )


def _claims(result: Result) -> bool:
    return result.is_solved or result.status is Status.PRECISION_LIMIT


def _keeps_claim(result: Result, ours: Certificate) -> bool:
    """Return whether the status is true for the certificate computed here."""
    if result.is_solved:
        return ours.meets(
            Settings(tolerance=result.tolerance, absolute_tolerance=result.absolute_tolerance)
        )
    return ours.is_at_rounding_level


def _largest(values: FloatVector) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def _side(name: str, side: Certificate, seconds: float) -> str:
    natural = f"natural residual {side.natural_residual:.3e}"
    return f"{name:<18} relative residual {side.relative_residual:.3e}, {natural}, {seconds:.3g} s"


# --- Polish ---------------------------------------------------------------------------------------------------


def polish(certificate: Certificate) -> Certificate:
    """Return the solution of the equations on the certificate's own active set, if it is better."""
    best, problem = certificate, certificate.problem
    for _ in range(POLISH_ROUNDS):
        at_bounds = classify(problem, best.z, best.w)
        solved = solve_active_set(problem, *at_bounds, near=best.z)
        found = best if solved is None else Certificate.of(problem, solved.z)
        if not found.scaled_residual < best.scaled_residual:
            break
        best = found
    return best
