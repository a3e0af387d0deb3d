"""Whether a result tells the truth, judged in rational arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...certificates.references import rounding_of_data
from ...certificates.row_residuals import scaled_residual
from ...checks import FloatVector
from ...exact.rounding import compensated_product
from ...problem.exactly import exact_slack
from ...problem.lcp import LCP
from ...settings import Status
from ...solving.result import Result
from .exact_answers import Answer

EPSILON, SMALLEST = Fraction(1, 2**52), Fraction(1, 2**1074)
ROUNDINGS = 2.0**-48  # relative, of some operations more than a residual takes after its slack
LARGEST_EXACT = 2000  # rows up to which all is done in fractions at once
FLOORS_MEASURED = 5  # what double precision takes for 4 floors can be a little more


def exact_residuals(problem: LCP, z: FloatVector) -> list[Fraction]:
    """Return |z − mid(lower, upper, z − w/d)| of every row without any rounding, for a finite z."""
    rows = zip(
        map(Fraction, z.tolist()), exact_slack(problem, z), problem.residual_scale.tolist(), problem.lower.tolist(),
        problem.upper.tolist(), strict=True,
    )
    # The comparison of a fraction with ±∞ is exact as well.
    return [abs(x - Fraction(min(max(x - w / Fraction(d), lower), upper))) for x, w, d, lower, upper in rows]


def rounding_floors(problem: LCP, z: FloatVector) -> list[Fraction]:
    """Return what rounding explains of each row's residual, k_i ε (|M||z| + |q|)_i/d_i and underflow, exactly."""
    M = problem.csr
    entries = [abs(Fraction(value) * Fraction(z[j])) for value, j in zip(M.data.tolist(), M.indices, strict=True)]
    floors = []
    for i, (q, d) in enumerate(zip(problem.q.tolist(), problem.residual_scale.tolist(), strict=True)):
        row = entries[M.indptr[i] : M.indptr[i + 1]]
        size = abs(Fraction(q)) + sum(row)
        floors.append((len(row) + 2) * (EPSILON * size + SMALLEST) / Fraction(d) + SMALLEST)
    return floors


def lie_in(result: Result, exact: Answer | None) -> str:
    """Return what is untrue in a result, or an empty text.

    Parameters
    ----------
    result : Result
        Of a run with the tolerance on the relative residual.
    exact : sequence of Fraction, shape (n,), optional
        The one solution, or None where it is not unique or does not exist.

    Notes
    -----
    A lie is a SOLVED whose exact residual exceeds tolerance · ‖r(z°)‖ in a part, both exact, a PRECISION_LIMIT with a
    row that rounding does not explain, a proof of no solution where there is one, a rigorous error bound that is
    exceeded, and a z that is not finite or not within its bounds.
    """
    problem, z = result.certificate.problem, result.z
    if not np.isfinite(z).all():
        return "z is not finite"
    if not np.array_equal(np.clip(z, problem.lower, problem.upper), z):
        return "z lies outside its bounds"
    if exact is not None:
        if result.status in (Status.INFEASIBLE, Status.NO_SOLUTION):
            return f"{result.status.name}, but there is a solution"
        if not _bound_holds(result, exact):
            return "|z − z*| exceeds its rigorous bound"
    return _lie_about_residual(result)


def _lie_about_residual(result: Result) -> str:
    if result.status not in (Status.SOLVED, Status.PRECISION_LIMIT):
        return ""
    problem = result.certificate.problem
    if result.status is Status.SOLVED and problem.n > LARGEST_EXACT and _is_surely_solved(result):
        return ""
    residuals = exact_residuals(problem, result.z)
    if result.status is Status.PRECISION_LIMIT:
        floors = rounding_floors(problem, result.z)
        explained = all(r <= FLOORS_MEASURED * floor for r, floor in zip(residuals, floors, strict=True))
        if result.infeasibility is not None and result.infeasibility.is_rounding:
            explained |= max(residuals) <= Fraction(rounding_of_data(problem)) * (1 + EPSILON)
        return "" if explained else "PRECISION_LIMIT, but rounding does not explain the residual"
    references = _references(problem, exact_residuals(problem, problem.nearest_to_zero))
    is_true = all(r <= Fraction(result.tolerance) * of for r, of in zip(residuals, references, strict=True))
    return "" if is_true else "SOLVED, but the exact residual is above the tolerance"


def _references(problem: LCP, at_zero: Sequence[Any]) -> list[Any]:
    """Return the largest value of the part of each row."""
    from scipy.sparse.csgraph import connected_components  # not our own parts, which are judged here

    pattern = sp.csr_array((np.ones(problem.csr.nnz), problem.csr.indices, problem.csr.indptr), shape=problem.csr.shape)
    labels = connected_components(pattern, directed=True, connection="weak")[1].tolist()
    largest: dict[int, Any] = {}
    for label, value in zip(labels, at_zero, strict=True):
        largest[label] = max(value, largest.get(label, value))
    return [largest[label] for label in labels]


def _is_surely_solved(result: Result) -> bool:
    """Return whether bounds of the exact residuals already prove the tolerance; False says nothing."""
    problem = result.certificate.problem
    _, above = _residual_bounds(problem, result.z)
    below, _ = _residual_bounds(problem, problem.nearest_to_zero)
    references = np.array(_references(problem, below.tolist()))
    return bool(np.all(above <= result.tolerance * references * (1.0 - ROUNDINGS)))


def _residual_bounds(problem: LCP, z: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return bounds of |r| from below and above: w with its proved radius, and a few roundings after it."""
    with np.errstate(all="ignore"):
        w, radius = compensated_product(problem.csr, z, problem.q)
        residual = np.abs(scaled_residual(problem, z, w))
        radius = radius / problem.residual_scale * (1.0 + ROUNDINGS) + ROUNDINGS * residual
        return residual - radius, residual + radius


def _bound_holds(result: Result, exact: Answer) -> bool:
    bound = result.error_bound
    if bound is None or bound.kind != "rigorous":
        return True
    rows = zip(result.z.tolist(), exact, bound.componentwise.tolist(), strict=True)
    return all(abs(Fraction(z) - answer) <= limit for z, answer, limit in rows)
