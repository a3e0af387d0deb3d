"""Warnings of `explain()`: a small residual that may mislead, and a chosen method without a convergence proof."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core.errors import UnsuitableMatrix
from ..core.names import listed
from ..core.settings import Status
from ..proofs.bounds import error_bound, estimated_error, free_rows, settled_rows
from ..proofs.uniqueness import directions_of_solutions, moving
from ..systems.free_systems import CONSISTENT, LEAST_SQUARES_UP_TO, FreeSystem

if TYPE_CHECKING:
    from .result import Result

FAILED = (Status.STALLED, Status.DIVERGED, Status.MAX_ITERATIONS)


def what_may_mislead(result: Result) -> list[str]:
    """Return a line for each."""
    return [*filter(None, (_uncovered(result), _other_solutions(result) or _stiffness(result)))]


def _uncovered(result: Result) -> str:
    """Return the warning after a failure of a chosen method that no theorem covers, or ""."""
    if result.status not in FAILED or result._asked is None:  # by "auto"
        return ""
    guarantee = result.guarantee
    if guarantee.is_guaranteed or not guarantee.remedy:
        return ""
    unproven = (
        f"nothing proves that {result.algorithm} converges on this matrix ({guarantee.theorem})"
    )
    is_said = all('algorithm="auto"' in said for said in (guarantee.remedy, result.advice))
    return unproven if is_said else f"{unproven}; remedy: {guarantee.remedy}"


def _other_solutions(result: Result) -> str:
    """Return the warning that other solutions exist, with the names of the unknowns that differ, or ""."""
    problem = result.certificate.problem
    if not result.is_solved or free_rows(problem, result.z, result.w).sum() > LEAST_SQUARES_UP_TO:
        return ""
    rows = settled_rows(problem, result.z, result.w)
    directions = directions_of_solutions(problem, rows)
    if directions is None or not directions.size:
        return ""
    names = listed(map(problem.names.unknown, moving(directions).tolist()))
    changes = np.abs(problem.matrix.csr @ directions).max(axis=1)
    terms = (abs(problem.matrix.csr) @ np.abs(directions)).max(axis=1)
    is_same = bool((changes <= CONSISTENT * terms.max()).all())
    same = "; w is the same for all of them" if is_same else ""
    return f"z is one of several solutions: the data do not determine {names}{same}; to choose one, add an objective"


def _stiffness(result: Result) -> str:
    """Return the warning that a small residual goes, or may go, with a much larger error, or ""."""
    relative = result.certificate.relative_residual
    if result.error_bound is not None:
        factor = result.error_bound.relative / relative if relative > 0.0 else 0.0
        # An error so much larger than the residual is worth a word
        if not factor > 1e3:
            return ""
        return f"stiff: the error may be {factor:.0e} times the residual; trust the bound"
    if not result.is_solved:
        return ""
    scale = result.certificate.problem.residual_scale
    spread = float(scale.max(initial=1.0) / scale.min(initial=np.inf))
    if not spread > 1e6:
        return _nearness_to_singular(result)
    stiff = f"stiff: the diagonal of M spans a factor of {spread:.0e}, where a small residual may hide a large error"
    problem = result.certificate.problem
    # A bound costs less than a run of 100 passes over M, or is of few unknowns
    if problem.n > 1000 and result.work < 100.0:
        return f"{stiff} of z{_advised(result)}"
    try:
        bound = error_bound(problem, result.z)
    except UnsuitableMatrix:
        return f"{stiff} of z, and nothing about M allows a bound of it"
    return (
        f"{stiff} of z: here it is proved to be at most {bound.infinity:.1e}, which is {bound.relative:.1e} times the "
        "largest |z_i|"
    )


def _nearness_to_singular(result: Result) -> str:
    """Return the warning that M is nearly singular on the free rows, so that z may have a large error, or ""."""
    problem = result.certificate.problem
    residual, size = result.certificate.scaled_residual, float(np.abs(result.z).max(initial=0.0))
    error = estimated_error(problem, result.z, result.w, residual)
    if error is None or not error > 1e-2 * size:  # part of ‖z‖∞
        return ""
    system = FreeSystem(problem.matrix, free_rows(problem, result.z, result.w))
    known = f"of up to about {error:.0e}" if error < np.inf else "that cannot be bounded so"
    wrong = ": z may be wrong in every digit" if error > size else ""
    return (
        f"near-singular: the system of the {system.rows.size} unknowns between their bounds magnifies errors: a "
        f"residual of {residual:.0e} goes with an error of z {known}, while the largest |z_i| is {size:.0e}{wrong}"
        f"{_advised(result)}"
    )


def _advised(result: Result) -> str:
    """Return the advice to request a bound, unless the request already failed."""
    advice = "; error_bound=True computes a bound of it, where M allows one"
    return "" if result.no_error_bound else advice
