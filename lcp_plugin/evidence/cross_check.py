"""Our answer beside that of a convex solver which shares no code with it, and a verdict that knows both accuracies.

For any two points with residuals r, r′ (scaled by d, so that A = D^−½ M D^−½) and δ = D^½ (z − z′),

    δᵀAδ ≤ ‖D^½ (r − r′)‖ (‖Aδ‖ + ‖δ‖),

whatever the bounds: add the two projection inequalities. Where M is monotone the left side is not negative, so that
δᵀAδ / (‖Aδ‖ + ‖δ‖), here the *disagreement*, must be explained by the two residuals. It needs no conditioning, is
blind to the directions in which z is not unique, and fails where a residual is not what it is said to be.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from ..api import solve
from ..core.certificates.residuals import Certificate
from ..core.certificates.row_residuals import magnitude, rounding_floor, scaled_residual
from ..core.checks import FloatVector
from ..core.errors import InvalidOption
from ..core.kind import refusal
from ..core.lcp import LCP
from ..core.settings import Settings, Status
from ..core.solving.result import Result
from ..problems.programs.certification import Certification, certify
from ..problems.programs.conversion import qp_from_lcp
from .qp_reference import (
    ACCURATE,
    PLAIN,
    Formulation,
    ReferenceRun,
    accuracy,
    attempts,
    check_reference,
)

Verdict = Literal["agree", "mismatch", "not comparable"]

CLEARLY_DIFFERENT = 1e-6
PROOF_SECONDS = 20.0  # about, of each answer


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """Our answer and that of a convex solver, and whether they agree within the accuracy of both.

    Attributes
    ----------
    verdict : {"agree", "mismatch", "not comparable"}
        "not comparable" where no independent reference was accurate, or our answer is not.
    reason : str
        One line.
    reference : str
        What was compared with; empty where nothing was.
    formulation : str
        The convex program that the reference solved, or why there is none.
    difference_z, difference_w : float
        ‖z − z′‖∞ and ‖w − w′‖∞ in their units; NaN where nothing was compared.
    objective_gap : float
        Ours minus the reference's: of ½ zᵀMz + qᵀz where M is symmetric, of the sum of all z_i w_i products
        (each z_i measured from its bound) otherwise.
    disagreement, allowance : float
        δᵀAδ / (‖Aδ‖ + ‖δ‖), and what both residuals with their rounding explain of it; in the unit of the problem,
        NaN where M is not monotone.
    ours, theirs : Certificate or None
        Measured here, on the caller's data; `theirs` also where it was too inaccurate to count.
    seconds, reference_seconds : float
        Wall-clock seconds of each; the reference's with cvxpy's part.
    tried : tuple of ReferenceRun
        Every reference that was asked, in order.
    """

    verdict: Verdict
    reason: str
    reference: str
    formulation: str
    ours: Certificate = field(repr=False)
    theirs: Certificate | None = field(repr=False)
    seconds: float
    reference_seconds: float
    tried: tuple[ReferenceRun, ...] = field(default=(), repr=False)
    difference_z: float = math.nan
    difference_w: float = math.nan
    objective_gap: float = math.nan
    disagreement: float = math.nan
    allowance: float = math.nan

    @property
    def agrees(self) -> bool:
        """True where the verdict is "agree"."""
        return self.verdict == "agree"

    @cached_property
    def proved(self) -> dict[str, Certification]:
        """What `certify` proves of both answers, as points of the program that the problem is; computed when looked at.

        Empty where M is not symmetric and positive semidefinite: then there is no such program in z alone.
        """
        if not self.formulation.startswith(PLAIN):
            return {}
        program, names = qp_from_lcp(self.ours.problem), ("ours", self.reference or "reference")
        return {
            name: certify(program, side.z, max_seconds=PROOF_SECONDS)
            for name, side in zip(names, (self.ours, self.theirs), strict=True)
            if side is not None and np.isfinite(side.z).all()
        }

    def __str__(self) -> str:
        return story(self)


def cross_validate(
    problem: LCP,
    result: Result | None = None,
    reference: str = "auto",
    *,
    algorithm: str = "auto",
    tolerance: float = 1e-9,
    max_seconds: float = 60.0,
) -> CrossCheck:
    """Return our answer compared with that of a convex solver, where M makes the problem convex.

    Parameters
    ----------
    problem : LCP
        Never modified.
    result : Result, optional
        The answer to check; by default it is computed here. Its own certificate is not trusted.
    reference : str
        "auto", or one of "daqp", "osqp", "scs", "piqp", "clarabel", "highs".
    algorithm : str
        What computes our answer where none is given.
    tolerance : float
        Of that run: relative residual.
    max_seconds : float
        Limit in seconds for our run and for each reference, as far as the solver obeys one; the factorisation that
        decides whether there is a convex program is not interrupted.

    Returns
    -------
    CrossCheck
        Whatever the solvers do. Where the problem is no convex program (M neither symmetric positive semidefinite
        nor monotone) the verdict is "not comparable" at best.

    Raises
    ------
    InvalidOption, InvalidProblem
        Where an argument cannot be used.

    Examples
    --------
    >>> check = cross_validate(LCP([[2, 1], [1, 2]], [-5, 1]))
    >>> check.verdict, check.difference_z < 1e-8
    ('agree', True)
    """
    if not isinstance(problem, LCP):
        raise InvalidOption(refusal("cross_validate", problem))
    if result is not None and not isinstance(result, Result):
        raise InvalidOption(
            f"result must be what solve() returned, got {type(result).__name__}; or leave it out"
        )
    check_reference(reference)
    if result is None:
        result = solve(problem, algorithm, tolerance=tolerance, max_seconds=max_seconds)
    ours = Certificate.of(problem, result.z)
    if problem.n == 0:
        return CrossCheck("agree", "there are no unknowns", "", "", ours, None, result.seconds, 0.0)
    formulation = Formulation.of(problem)
    if formulation.kind is None:
        return _without_program(formulation, result, ours)
    return _compared(formulation, result, ours, attempts(formulation, reference, max_seconds))


def _without_program(formulation: Formulation, result: Result, ours: Certificate) -> CrossCheck:
    """Return the check of an answer for which there is no convex program: whether it is what it says."""
    said = (
        f"our answer says {result.status.name}, and our relative residual is {accuracy(ours):.1e}"
    )
    verdict: Verdict = (
        "not comparable" if not _claims(result) or _keeps_claim(result, ours) else "mismatch"
    )
    reason = f"{formulation.evidence}; there is nothing to compare with; {said}"
    return CrossCheck(verdict, reason, "", "no convex program", ours, None, result.seconds, 0.0)


# --- Comparing ----------------------------------------------------------------------------------------------


def _compared(
    formulation: Formulation, result: Result, ours: Certificate, asked: Iterator[ReferenceRun]
) -> CrossCheck:
    """Return the check against the first accurate answer, else the best; who comes after it is not asked."""
    tried: list[ReferenceRun] = []
    while not (tried and tried[-1].is_accurate) and (one := next(asked, None)) is not None:
        tried.append(one)
    # Of those without an answer the last, which is the least likely to be just absent.
    best = min(reversed(tried), key=lambda one: one.residual)
    described = f"{formulation.kind} ({formulation.evidence})"
    pair = None
    if best.certificate is not None and np.isfinite(ours.z).all():
        pair = _Pair(formulation, ours, best.certificate)
    verdict, reason = _judged(formulation, result, ours, best, pair)
    name, facts = (best.name, pair.facts()) if pair is not None else ("", {})
    return CrossCheck(
        verdict,
        reason,
        name,
        described,
        ours,
        best.certificate,
        result.seconds,
        best.seconds,
        tuple(tried),
        **facts,
    )


def _judged(
    formulation: Formulation,
    result: Result,
    ours: Certificate,
    best: ReferenceRun,
    pair: _Pair | None,
) -> tuple[Verdict, str]:
    """Return the verdict and its reason; the table is read from the top."""
    residual = accuracy(ours)
    claimed = _claims(result)
    said = f"our relative residual is {residual:.1e}"
    if pair is None or not best.is_accurate:
        return "not comparable", f"no reference reached {ACCURATE:.0e}, the best is {best}; {said}"
    if claimed and not _keeps_claim(result, ours):
        return (
            "mismatch",
            f"our answer says {result.status.name}, but {said}; that of {best.name} is accurate",
        )
    if not residual <= (1e-3 if claimed else ACCURATE):
        return "not comparable", f"our answer is inaccurate: {result.status.name}, {said}"
    if not pair.disagreement <= pair.allowance:
        explained = f"the residuals explain {pair.allowance:.1e} of a disagreement of {pair.disagreement:.1e}"
        return (
            "mismatch",
            f"{explained}: one of them is wrong, or the two sides solved different problems",
        )
    if pair.only_z_differs:
        return "agree", "same w and objective; z is not unique"
    if not pair.is_close:
        largest = f"{_largest(pair.step):.1e}"
        return (
            "agree",
            f"z differs by {largest}, no more than the residuals and the conditioning of M explain",
        )
    return "agree", "same solution, as far as both residuals tell"


def _claims(result: Result) -> bool:
    return result.is_solved or result.status is Status.PRECISION_LIMIT


def _keeps_claim(result: Result, ours: Certificate) -> bool:
    """Return whether the status holds for the certificate measured here."""
    if result.is_solved:
        return ours.meets(
            Settings(tolerance=result.tolerance, absolute_tolerance=result.absolute_tolerance)
        )
    return ours.is_at_rounding_level


class _Pair:
    """Two answers to the same problem, in the unit-free variables y = D^½ z / unit and D^−½ w / unit."""

    def __init__(self, formulation: Formulation, ours: Certificate, theirs: Certificate) -> None:
        self.formulation, self.ours, self.theirs = formulation, ours, theirs
        scaled = formulation.scaled
        self.step, self.rise = ours.z - theirs.z, ours.w - theirs.w
        self._weight, self._unit = scaled.weight / scaled.unit, scaled.weight * scaled.unit
        step, rise = self.step * self._weight, self.rise / self._unit
        self._step, self._rise = float(np.linalg.norm(step)), float(np.linalg.norm(rise))
        size = self._step + self._rise
        self.disagreement = max(float(step @ rise), 0.0) / size if size else 0.0
        self.allowance = self._error(ours) + self._error(theirs)

    def _error(self, side: Certificate) -> float:
        """Return ‖D^½ r‖ with rounding: what r is measured to be, and may be."""
        problem = side.problem
        scale = np.square(self.formulation.scaled.weight)
        floor = rounding_floor(problem, magnitude(problem, side.z), scale)
        residual = np.abs(scaled_residual(problem, side.z, side.w, scale)) + floor
        return float(np.linalg.norm(residual * self._weight))

    @property
    def is_close(self) -> bool:
        """True where z differs by less than 1e-6 of its size."""
        size = max(
            float(np.linalg.norm(side.z * self._weight)) for side in (self.ours, self.theirs)
        )
        return self._step <= CLEARLY_DIFFERENT * size

    @property
    def only_z_differs(self) -> bool:
        """True where z differs clearly, and w and the objective by next to nothing."""
        return not self.is_close and self._rise <= CLEARLY_DIFFERENT * self._step

    def facts(self) -> dict[str, Any]:
        """Return what a check says of the pair."""
        return {
            "difference_z": _largest(self.step),
            "difference_w": _largest(self.rise),
            "objective_gap": self.objective_gap(),
            "disagreement": self.disagreement,
            "allowance": self.allowance,
        }

    def objective_gap(self) -> float:
        """Return ours minus theirs, without the cancellation of two objectives."""
        if self.formulation.kind == PLAIN:  # ½ zᵀMz + qᵀz is a difference of squares
            return float(0.5 * self.step @ (self.ours.w + self.theirs.w))
        return _gap(self.ours) - _gap(self.theirs)


def _gap(side: Certificate) -> float:
    """Return the sum of w_i⁺ (z_i − lower_i) + w_i⁻ (upper_i − z_i) over the finite bounds."""
    problem, w = side.problem, side.w
    above = np.where(np.isfinite(problem.lower), side.z - problem.lower, 0.0)
    below = np.where(np.isfinite(problem.upper), problem.upper - side.z, 0.0)
    return float(np.maximum(w, 0.0) @ above + np.maximum(-w, 0.0) @ below)


def _largest(values: FloatVector) -> float:
    return float(np.max(np.abs(values), initial=0.0))


# --- Telling ------------------------------------------------------------------------------------------------


def story(check: CrossCheck) -> str:
    """Return what a person wants to read after a check."""
    lines = [f"{check.verdict}: {check.reason}"]
    rows = [("formulation", check.formulation), ("ours", _side(check.ours, check.seconds))]
    if check.theirs is not None:
        rows.append((check.reference or "reference", _side(check.theirs, check.reference_seconds)))
    if check.reference:
        rows += [
            ("|Δz|, |Δw|", f"{check.difference_z:.3e}, {check.difference_w:.3e}"),
            ("objective gap", f"{check.objective_gap:.3e}"),
            (
                "disagreement",
                f"{check.disagreement:.3e}; the residuals explain {check.allowance:.3e}",
            ),
        ]
    rows += [(f"proved of {name}", str(said)) for name, said in check.proved.items()]
    rows += [("tried", str(one)) for one in check.tried]
    return "\n".join(lines + [f"{name:<18} {value}" for name, value in rows if value])


def _side(certificate: Certificate, seconds: float) -> str:
    natural = f"natural residual {certificate.natural_residual:.3e}"
    return f"relative residual {accuracy(certificate):.3e}, {natural}, {seconds:.3g} s"
