"""Rules of `explain()`: errors behind a small residual, a method without a theorem, the likely mistake of a model.

The likely mistake of a model without a solution is named by a fact of M, or F′, at the last point.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.algorithm import Algorithm
from ..core.checks import Vector
from ..core.entries import max_norm, or_one
from ..core.errors import InvalidOption, UnsuitableMatrix
from ..core.lcp import LCP
from ..core.names import listed
from ..core.problem_classes import refusal
from ..core.settings import LIMITS, PROVEN, Status
from ..core.splittings import PSOR
from ..core.tuning import PIVOTED_UP_TO
from ..judges.certificate import Certificate
from ..methods.lemke import Lemke
from ..proofs.bounds import error_bound, estimated_error, free_rows, settled_rows
from ..proofs.farkas import without_rounding
from ..proofs.guarantees import GUARANTEED, NOT_COVERED, Guarantee, guarantee_of
from ..proofs.uniqueness import directions_of_solutions, moving
from ..systems.free_systems import CONSISTENT, LEAST_SQUARES_UP_TO, FreeSystem
from .dispatch import method_of

INDEX = re.compile(r"(\[[^\[\]]*\]|, entry .*)$")  # of a row of a constraint
READ_BOUND = "; result.error_bound is a bound of it, where M allows one"


def what_may_mislead(solution: Certificate, work: float) -> str:
    """Return the warning that other solutions exist, or that a small residual may hide a large error; or ""."""
    return _other_solutions(solution) or _stiffness(solution, work)


def lack_of_a_theorem(guarantee: Guarantee, algorithm: str, advice: str) -> str:
    """Return the warning, after a failure of a method, that no theorem covers it; or ""."""
    if guarantee.is_guaranteed or not guarantee.remedy:
        return ""
    unproven = f"nothing proves that {algorithm} converges on this matrix ({guarantee.theorem})"
    is_said = all('algorithm="auto"' in said for said in (guarantee.remedy, advice))
    return unproven if is_said else f"{unproven}; remedy: {guarantee.remedy}"


def _other_solutions(solution: Certificate) -> str:
    """Return the warning that other solutions exist, with the names of the unknowns that differ, or ""."""
    problem, z, w = solution.problem, solution.z, solution.w
    if free_rows(problem, z, w).sum() > LEAST_SQUARES_UP_TO:
        return ""
    rows = settled_rows(problem, z, w)
    directions = directions_of_solutions(problem, rows)
    if directions is None or not directions.size:
        return ""
    names = listed(map(problem.names.unknown, moving(directions).tolist()))
    changes = np.abs(problem.matrix.csr @ directions).max(axis=1)
    terms = (abs(problem.matrix.csr) @ np.abs(directions)).max(axis=1)
    is_same = bool((changes <= CONSISTENT * terms.max()).all())
    same = "; w is the same for all of them" if is_same else ""
    return f"z is one of several solutions: the data do not determine {names}{same}; to choose one, add an objective"


def _stiffness(solution: Certificate, work: float) -> str:
    """Return the warning that a small residual goes, or may go, with a much larger error, or ""."""
    problem = solution.problem
    scale = problem.residual_scale
    spread = float(scale.max(initial=1.0) / scale.min(initial=np.inf))
    if not spread > 1e6:
        return _nearness_to_singular(solution)
    stiff = f"stiff: the diagonal of M spans a factor of {spread:.0e}, where a small residual may hide a large error"
    # A bound costs less than a run of 100 passes over M, or is of few unknowns
    if problem.n > 1000 and work < 100.0:
        return f"{stiff} of z{READ_BOUND}"
    try:
        bound = error_bound(problem, solution.z)
    except UnsuitableMatrix:
        return f"{stiff} of z, and nothing about M allows a bound of it"
    return (
        f"{stiff} of z: here it is proved to be at most {bound.infinity:.1e}, which is {bound.relative:.1e} times the "
        "largest |z_i|"
    )


def _nearness_to_singular(solution: Certificate) -> str:
    """Return the warning that M is nearly singular on the free rows, so that z may have a large error, or ""."""
    problem, z, w = solution.problem, solution.z, solution.w
    residual, size = solution.scaled_residual, max_norm(z)
    error = estimated_error(problem, z, w, residual)
    if error is None or not error > 1e-2 * size:  # part of ‖z‖∞
        return ""
    system = FreeSystem(problem.matrix, free_rows(problem, z, w))
    known = f"of up to about {error:.0e}" if error < np.inf else "that cannot be bounded so"
    wrong = ": z may be wrong in every digit" if error > size else ""
    return (
        f"near-singular: the system of the {system.rows.size} unknowns between their bounds magnifies errors: a "
        f"residual of {residual:.0e} goes with an error of z {known}, while the largest |z_i| is {size:.0e}{wrong}"
        f"{READ_BOUND}"
    )


def likely_mistake_of(last: Certificate, status: Status) -> str:
    """Return the likely mistake of a model, or ""; of a right model too the last point may look wrong."""
    problem = last.problem
    if isinstance(problem, LCP) and status is Status.NO_SOLUTION:
        return reversed_row(problem)
    is_open = isinstance(problem, LCP) and status not in (*LIMITS, *PROVEN, Status.INTERRUPTED)
    return likely_mistake(problem, last.z, last.w) if is_open else ""


def reversed_row(problem: LCP, *, is_linearized: bool = False) -> str:
    """Return the row, or the rows of one constraint, with the signs of the unknown's column; "" if there is none.

    A row with a sign has M_ii = 0 and M_ij M_ji > 0 for all its terms, and no row j is such a row. For a linear problem
    also the row of the only negative diagonal entry.
    """
    M, names, diagonal = problem.matrix.csr, problem.names, problem.diagonal
    negative = np.flatnonzero(diagonal < 0.0)
    if negative.size == 1 < problem.n and not is_linearized:
        return f"the sign of {names.pair(negative[0])[0]} may be wrong: only its diagonal entry is negative"
    products = sp.csr_array((M - sp.diags_array(diagonal)).multiply(M.T))
    terms, equal = (np.asarray(entries.sum(1)) for entries in (products != 0.0, products > 0.0))
    has_sign = np.isfinite(problem.lower) != np.isfinite(problem.upper)
    is_suspect = (diagonal == 0.0) & (terms == equal) & (terms > 1) & has_sign
    is_suspect &= (products != 0.0) @ is_suspect == 0  # both, as in a game
    if not is_suspect.any():
        return ""
    first = int(np.argmax(is_suspect))
    row, unknown = names.pair(first)
    name = INDEX.sub("", names.row(first))
    same = [i for i in range(problem.n) if INDEX.sub("", names.row(i)) == name]
    if len(same) > 1 and is_suspect[same].all():
        row, unknown = f"{name}, in all {len(same)} rows,", "their unknowns"
    return (
        f"the sign of {row} may be wrong: its terms have the signs of the terms of {unknown} in other rows; in the "
        "conditions of a market or of a program they have opposite signs"
    )


def likely_mistake(problem: LCP, z: Vector, w: Vector) -> str:
    """Return a row that its unknown cannot correct, a row of two units, or dependent rows: the first of them, or ""."""
    from scipy.sparse.csgraph import connected_components  # slow to import

    M, names = problem.matrix.csr, problem.names
    if wrong_sign := reversed_row(problem, is_linearized=True):
        return wrong_sign
    # w_i depends on z_i, also through other pairs, only if both are on a cycle of the pattern.
    component = connected_components(M, connection="strong")[1]
    is_apart = (np.bincount(component)[component] == 1) & (M.diagonal() == 0.0)
    is_wrong = np.where(w < 0.0, problem.upper == np.inf, problem.lower == -np.inf)
    wrong = np.abs(w) / problem.residual_scale * (is_apart & is_wrong)
    if wrong.max(initial=0.0) > 0.0:
        i = int(np.argmax(wrong))
        row, unknown = names.pair(i)
        return (
            f"{row} is {w[i]:.6g}, and {unknown} has no effect on it; see whether a term is missing"
        )
    inverse = abs(without_rounding(M))
    inverse.data = 1.0 / inverse.data
    ratio = problem.matrix.row_largest * inverse.max(axis=1).toarray().ravel()
    if ratio.max(initial=1.0) >= 1e12:  # two coefficients in different units
        i = int(np.argmax(ratio))
        return f"the coefficients of {names.row(i)} differ by a factor of {ratio[i]:.0e}; see its units"
    free = np.flatnonzero(free_rows(problem, z, w))
    if not 1 < free.size <= 400:  # singular vectors of larger matrices take more than .1 s
        return ""
    block = M[free][:, free].toarray()
    lengths = np.linalg.norm(block, axis=1, keepdims=True)
    left, values, _ = np.linalg.svd(block / or_one(lengths))
    part = np.abs(left[:, -1]) >= 0.1 * np.abs(left[:, -1]).max()  # rows with less are not named
    if values[-1] > 1e-6 * values[0] or part.sum() == 1:  # derivatives may be differences
        return ""
    return (
        f"the rows {listed(map(names.row, free[part]))} are dependent at this point; if they are everywhere, fix an "
        "unknown, as the price of a numeraire"
    )


def convergence_guarantee(
    problem: LCP, algorithm: str | Algorithm = "auto", **options: Any
) -> Guarantee:
    """Return the convergence guarantee of an algorithm on this matrix, for all q and all starts.

    Parameters
    ----------
    problem : LCP
    algorithm : str or Algorithm
        A registered name, "auto", or an object such as ``NPSOR(relaxation=1.5)``.
    **options
        Options of the named algorithm.

    Returns
    -------
    Guarantee
        ``verdict`` "guaranteed" or "not covered", with theorem, rate, weights v and a remedy.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        If the name or an option does not exist, or `problem` is not an LCP.

    Notes
    -----
    Cost: some passes over M, a loose solve with its comparison matrix if dominance does not decide, and a
    factorization if M is symmetric. Iterates are assumed exact, step sizes rounded as in a run. It holds for any q,
    boxes and free rows included.

    Examples
    --------
    >>> from lcp_plugin import LCP
    >>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
    >>> guarantee = convergence_guarantee(problem, "npsor", momentum=None)
    >>> guarantee.verdict, round(guarantee.rate, 3)
    ('guaranteed', 0.648)
    """
    if not isinstance(problem, LCP):
        raise InvalidOption(refusal("convergence_guarantee", problem))
    return guarantee_of_choice(problem, method_of(algorithm, options))


def guarantee_of_choice(problem: LCP, method: Algorithm | None) -> Guarantee:
    """Return the guarantee of a method, or of "auto" for None."""
    if method is not None:
        return guarantee_of(problem, method)
    # auto ends with this method, which runs to its end if the methods before it fail
    last = guarantee_of(problem, method := last_resort(problem))
    if not last.is_guaranteed:
        return Guarantee(NOT_COVERED, last.theorem)
    return Guarantee(GUARANTEED, f"after any other methods it runs {method.name}: {last.theorem}")


def last_resort(problem: LCP) -> Algorithm:
    """Return the method that auto follows to its end if no earlier method converges."""
    return Lemke() if problem.n <= PIVOTED_UP_TO else PSOR()
