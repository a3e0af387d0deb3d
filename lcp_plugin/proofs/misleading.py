"""What `explain()` says where a small residual may mislead, and why a chosen method may have failed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core.settings import Status
from .bounds.active_rows import estimated_error

if TYPE_CHECKING:
    from ..core.solving.result import Result

STIFF_FACTOR = 1e3  # from here on an error so much larger than the residual is worth a word
STIFF_SPREAD = 1e6
FAR = 1e-2  # part of ‖z‖∞
FAILED = (Status.STALLED, Status.DIVERGED, Status.MAX_ITERATIONS)


def what_may_mislead(result: Result) -> list[str]:
    """Return a line for each."""
    return [line for line in (_uncovered(result), _stiffness(result)) if line]


def _uncovered(result: Result) -> str:
    """Return what to say where a chosen method failed that nothing proves to converge."""
    is_auto = isinstance(result._asked, str)
    if result.status not in FAILED or is_auto or result.certificate.problem.is_distributed:
        return ""
    guarantee = result.guarantee
    if guarantee.is_guaranteed or not guarantee.remedy:
        return ""
    return (f"{result.algorithm} on this matrix: {guarantee.verdict} ({guarantee.theorem}); what to do: "
            f"{guarantee.remedy}")


def _stiffness(result: Result) -> str:
    """Return what to say where a small residual goes, or may go, with a much larger error."""
    relative = result.certificate.relative_residual
    if result.error_bound is not None:
        factor = result.error_bound.relative / relative if relative > 0.0 else 0.0
        if not factor > STIFF_FACTOR:
            return ""
        further = "" if result.tolerance_on == "error" else ', and ask for tolerance_on="error"'
        return f"stiff: the error may be {factor:.0e} times the residual; trust the bound{further}"
    spread = result.certificate.scale_spread
    if not result.is_solved:
        return ""
    if not spread > STIFF_SPREAD:
        return _nearness_to_singular(result)
    return (f"stiff: the diagonal of M spans a factor of {spread:.0e}, so that a small residual may hide a large "
            f"error{_advised(result)}")


def _nearness_to_singular(result: Result) -> str:
    """Return what to say where the error may be a good part of z although the residual is small."""
    problem = result.certificate.problem
    if problem.is_distributed:
        return ""
    residual, size = result.certificate.scaled_residual, float(np.abs(result.z).max(initial=0.0))
    error = estimated_error(problem, result.z, result.w, residual)
    if error is None or not error > FAR * size:
        return ""
    known = f"of up to about {error:.0e}" if error < np.inf else "of any size"
    return (f"near-singular: on the free rows of M a residual of {residual:.0e} goes with an error {known}, and "
            f"‖z‖∞ = {size:.0e}{_advised(result)}")


def _advised(result: Result) -> str:
    """Return the advice to ask for a bound, where it was not asked for in vain."""
    return "" if result.no_error_bound else "; error_bound=True bounds it where M allows it"
