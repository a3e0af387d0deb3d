"""cross_validate(): our solution compared with the solution of a convex solver, within the accuracy of both.

| M | program |
|---|---|
| symmetric positive semidefinite, to rounding | min ½ zᵀMz + qᵀz over the bounds |
| symmetric part positive semidefinite | gap program: min zᵀ(Mz + q) − lᵀa + uᵀb, Mz + q = a − b, a, b ≥ 0 |
| otherwise | none: a stationary point of a nonconvex program proves nothing |

A factorization checks both conditions. The solver gets the problem in the unknown y = D^½ z / unit, whose matrix has a
diagonal of at most 1, because the tolerances of convex solvers are absolute.

For any two points with residuals r, r′ (scaled by d, so that A = D^−½ M D^−½) and δ = D^½ (z − z′)

    δᵀAδ ≤ ‖D^½ (r − r′)‖ (‖Aδ‖ + ‖δ‖),

for all bounds: add the two projection inequalities. If M is monotone the left side is not negative, so that
δᵀAδ / (‖Aδ‖ + ‖δ‖), here the *disagreement*, is at most the *allowance* ‖D^½ r‖ + ‖D^½ r′‖. The test needs no condition
number, ignores directions in which z is not unique, and fails if a reported residual is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import numpy as np

from ..core.checks import Vector
from ..core.deadline import Clock
from ..core.entries import max_norm, scale_by
from ..core.errors import InvalidOption, did_you_mean
from ..core.kernels.floats import EPSILON
from ..core.lcp import LCP
from ..core.problem_classes import refusal
from ..core.settings import Status
from ..judges.certificate import Certificate
from ..judges.lcp import row_data, scaled_residual
from ..methods.newton import classify, solve_active_set
from ..problems.programs.program import asymmetry_of
from ..solving.dispatch import solve
from ..solving.result import Result
from ..systems.definiteness import factorized, symmetric_part

Agreement = Literal["agree", "mismatch", "not comparable"]

PLAIN, GAP = "quadratic program", "gap quadratic program"
ACCURATE_TOLERANCE = 1e-7  # of our criterion, for a point to be compared
POLISH_ROUNDS = 3  # rounds of a polish for the points of first-order methods
CLARABEL_OPTIONS = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-11)
LIMITED = dict.fromkeys(("CLARABEL", "HIGHS", "OSQP"), "time_limit") | {"SCS": "time_limit_secs"}


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

    verdict: Agreement
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
        lines = [f"{self.verdict}: {self.reason}", f"{'formulation':<18} {self.formulation}"]
        lines += [_measures("ours", self.ours, self.seconds)]
        if self.theirs is not None:
            lines += [
                _measures(self.reference, self.theirs, self.reference_seconds),
                f"{'|Δz|, |Δw|':<18} {self.difference_z:.3e}, {self.difference_w:.3e}",
                f"{'objective gap':<18} {self.objective_gap:.3e}",
                f"{'disagreement':<18} {self.disagreement:.3e}; the residuals explain {self.allowance:.3e}",
            ]
        return "\n".join(lines)

    __str__ = explain


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
        The solution to check; by default it is computed here. Its certificate is not used.
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
    convex, status = ConvexForm.of(problem), result.status.name
    is_claimed = result.is_solved or result.status is Status.PRECISION_LIMIT
    measure = partial(ours.criterion.measure_at, ours.z, ours.w)
    measured = measure(result.tolerance, absolute=result.absolute_tolerance)
    is_true = measured.passes if result.is_solved else ours.is_at_rounding_level
    is_false = is_claimed and not is_true
    check = partial(CrossCheck, reference=name, ours=ours, seconds=seconds)
    if not convex.kind:
        outcome = "false" if is_false else "consistent with our residual"
        verdict: Agreement = "mismatch" if is_false else "not comparable"
        reason = f"no convex program to compare with; our status {status} is {outcome}"
        return check(verdict, reason, formulation=convex.evidence)
    check = partial(check, formulation=f"{convex.kind} ({convex.evidence})")
    remarks = [stage.remark for stage in result.stages if stage.name == "interior_point"]
    if remarks and (name == "PIQP" or any(name.lower() in remark for remark in remarks)):
        reason = f"{name} computed our solution too (interior_point); choose another reference"
        return check("not comparable", reason)
    tight = CLARABEL_OPTIONS if name == "CLARABEL" else {}
    z, took, outcome = convex.solve_by(name, max_seconds, **tight | options)
    if z is None:
        return check("not comparable", f"{name} gave no point: {outcome}")
    theirs = polish(Certificate.of(problem, z))
    facts = convex.compare(ours, theirs)
    check = partial(check, theirs=theirs, reference_seconds=took, **facts)
    residual, reached = ours.relative_residual, theirs.relative_residual
    residuals = f"relative residuals {residual:.1e} and {reached:.1e}"
    # An interior point need not meet the test of every row: z next to a bound leaves a small w_i unchanged.
    if not reached <= ACCURATE_TOLERANCE:
        reason = f"the solution of {name} does not reach {ACCURATE_TOLERANCE:.0e}: {residuals}"
        return check("not comparable", reason)
    if is_false or not np.isfinite(ours.z).all():
        return check("mismatch", f"our status {status} is false, {name} is accurate: {residuals}")
    enough = 1e-3 if is_claimed else ACCURATE_TOLERANCE
    if not measure(enough).passes:
        return check("not comparable", f"our solution is not accurate, {status}: {residuals}")
    if not facts["disagreement"] <= facts["allowance"]:
        share = f"{facts['allowance']:.1e} of a disagreement of {facts['disagreement']:.1e}"
        return check(
            "mismatch",
            f"the residuals explain {share}: one of them is wrong, or the two sides solved different problems",
        )
    return check("agree", "the residuals and the conditioning of M explain every difference")


def _measures(name: str, side: Certificate, seconds: float) -> str:
    natural = f"natural residual {side.natural_residual:.3e}"
    return f"{name:<18} relative residual {side.relative_residual:.3e}, {natural}, {seconds:.3g} s"


# --- A convex solver through cvxpy ----------------------------------------------------------------------------


def solver_name(reference: object) -> str:
    """Return cvxpy's name of an installed solver of quadratic programs, or raise InvalidOption."""
    from cvxpy import installed_solvers

    name = reference.upper() if isinstance(reference, str) else repr(reference)
    known = [solver for solver in installed_solvers() if solver != "LCP"]
    if name not in known:
        raise InvalidOption(f"cvxpy has no solver {reference!r}{did_you_mean(name, known)}")
    return name


@dataclass(frozen=True, eq=False)
class ConvexForm:
    """The problem in equilibrated unknowns y = weight · z, and the kind of its convex program.

    Attributes
    ----------
    kind : str
        PLAIN, GAP, or "" if no convex program exists.
    evidence : str
        The reason in one line.
    problem : LCP
        Of y; its slacks are w / √d_i / unit.
    weight : ndarray, shape (n,)
        √d_i / unit.
    """

    kind: str
    evidence: str
    problem: LCP = field(repr=False)
    weight: Vector = field(repr=False)

    @classmethod
    def of(cls, lcp: LCP) -> ConvexForm:
        """Return the form that symmetry and a factorization of the symmetric part allow."""
        root = np.sqrt(np.where(lcp.diagonal > 0.0, lcp.diagonal, lcp.residual_scale))
        A, c = scale_by(lcp.M, 1.0 / root, 1.0 / root), lcp.q / root
        place = asymmetry_of(A)[1]
        matrix = "M is symmetric"
        if place is not None:
            i, j = place
            matrix = f"M[{i}, {j}] and M[{j}, {i}] differ; the symmetric part of M is"
        # Skew entries above 1 leave their rounding behind when the symmetric part cancels them.
        shift = 4.0 * (lcp.n + 2) * EPSILON * max(1.0, float(abs(A).max()))
        is_negative = (lcp.diagonal < 0.0).any()
        if is_negative or factorized(symmetric_part(A), shift) is None:
            what = "a diagonal entry is negative"
            what = what if is_negative else f"a pivot is negative at shift {shift:.1e}"
            return cls("", f"{matrix} indefinite: {what}", lcp, root)
        unit = max_norm(np.append(c, root * lcp.nearest_to_zero)) or 1.0
        lower, upper = (root * bound / unit for bound in (lcp.lower, lcp.upper))
        problem = LCP(A, c / unit, lower=lower, upper=upper)
        kind = PLAIN if place is None else GAP
        evidence = f"{matrix} positive semidefinite: factorized at shift {shift:.1e}"
        return cls(kind, evidence, problem, root / unit)

    def solve_by(
        self, name: str, max_seconds: float, **options: Any
    ) -> tuple[Vector | None, float, str]:
        """Return z or None, seconds with cvxpy's part, and cvxpy's status or the message of an exception."""
        import cvxpy as cp

        scaled, clock = self.problem, Clock()
        ends = np.array([scaled.lower, scaled.upper])
        y = cp.Variable(scaled.n, bounds=[*ends])
        share, cost, rows = 0.5, scaled.q @ y, []
        if self.kind == GAP:
            is_bound = np.isfinite(ends)
            highest = np.where(is_bound, np.inf, 0.0)
            a, b = (cp.Variable(scaled.n, bounds=[0.0, end]) for end in highest)
            lower, upper = np.where(is_bound, ends, 0.0)
            share, cost = 1.0, cost - lower @ a + upper @ b
            rows = [scaled.M @ y + scaled.q == a - b]
        # Without assume_PSD cvxpy makes the matrix dense to check it.
        curved = cp.quad_form(y, symmetric_part(scaled.csr), assume_PSD=True)
        limit = {LIMITED[name]: max_seconds} if name in LIMITED else {}
        program = cp.Problem(cp.Minimize(share * curved + cost), rows)
        try:
            program.solve(solver=name, **limit | options)
            outcome = str(program.status)
        except Exception as error:  # solvers fail with exceptions of any class
            outcome = (str(error).splitlines() or [type(error).__name__])[0]
        is_found = y.value is not None and np.isfinite(y.value).all()
        z = np.clip(y.value, *ends) / self.weight if is_found else None
        return z, clock.read(), outcome

    def compare(self, ours: Certificate, theirs: Certificate) -> dict[str, float]:
        """Return the differences as fields of a CrossCheck."""
        ys = [self.weight * side.z for side in (ours, theirs)]
        ws = [self.problem.slack(y) for y in ys]
        step, rise = ys[0] - ys[1], ws[0] - ws[1]
        sizes = float(np.linalg.norm(step) + np.linalg.norm(rise))
        gap = float(np.sum(ours.products) - np.sum(theirs.products))
        if self.kind == PLAIN:  # a difference of squares, without cancellation
            gap = float(0.5 * (ours.z - theirs.z) @ (ours.w + theirs.w))
        return {
            "difference_z": max_norm(ours.z - theirs.z),
            "difference_w": max_norm(ours.w - theirs.w),
            "objective_gap": gap,
            "disagreement": max(float(step @ rise), 0.0) / (sizes or 1.0),
            "allowance": sum(map(self._residual, ys, ws)),
        }

    def _residual(self, y: Vector, w: Vector) -> float:
        """Return ‖r(y)‖ with d = 1, rounding included."""
        data, scale = row_data(self.problem), np.ones(y.size)
        floor = data.rounding_floor(data.rows(y).terms, scale)
        return float(np.linalg.norm(np.abs(scaled_residual(self.problem, y, w, scale)) + floor))


# --- Polish ---------------------------------------------------------------------------------------------------


def polish(certificate: Certificate) -> Certificate:
    """Return the solution of the equations on the certificate's active set, if it is better."""
    for _ in range(POLISH_ROUNDS):
        problem, z = certificate.problem, certificate.z
        solved = solve_active_set(problem, *classify(problem, z, certificate.w), near=z)
        polished = certificate if solved is None else Certificate.of(problem, solved.z)
        if not polished.scaled_residual < certificate.scaled_residual:
            break
        certificate = polished
    return certificate
