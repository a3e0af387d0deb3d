"""What a run that did not solve its problem should do: never what has just run, nor the default where that ran."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..algorithm import Algorithm
from ..checks import FloatVector
from ..kernels.floats import EPSILON
from ..lcp import LCP
from ..matrix.row_signs import why_not_monotone
from ..matrix.row_sums import has_positive_diagonal
from ..policy.stages import Stage
from ..settings import Status
from .answer import NEXT

ROUNDING = 4.0 * EPSILON
MOST_DIGITS = 308.0  # of a double
LIMITS = (Status.MAX_ITERATIONS, Status.MAX_SECONDS)
WITHOUT_END = (Status.STALLED, Status.DIVERGED)
EXCLUDED = "no solution was found, and a search of all cases in double precision saw none"
FAR_OUT = "no start leads to a solution within that size; next: check the data"
OVERFLOWS = "M z + q overflows already at the point of the bounds nearest to 0; next: divide M and q by the same number"
TRIED = "auto has tried what suits this M"
ELSEWHERE = "another start z0 may lead elsewhere"


def advice_of_run(
    problem: LCP,
    chosen: Any,
    stages: Sequence[Stage],
    goal: float,
    words: Mapping[Status, str],
    left_out: Sequence[str] = (),
) -> dict[Status, str]:
    """Return the advice of each status with which a run may have ended, what happened and what to do.

    Parameters
    ----------
    problem : LCP
        In the units of the run.
    chosen : str or Algorithm
        What was asked for.
    stages : sequence of Stage
        What ran.
    goal : float
        The residual that was asked for.
    words : mapping from Status to str
        What happened, where another than the status's own is right.
    left_out : sequence of str
        What auto did not try, and why.

    Examples
    --------
    >>> from lcp_plugin.algorithms import create
    >>> said = advice_of_run(LCP([[2.0]], [1.0]), create("npsor", {"scaling": None}), (), 1e-8, {})
    >>> said[Status.DIVERGED].partition("; next: ")[2]
    'try scaling="auto", which is enough where M is an H₊-matrix, or algorithm="auto"'
    >>> advice_of_run(LCP([[2.0]], [1.0]), "auto", (), 1e-8, {})[Status.MAX_ITERATIONS]
    'the iteration limit came first; next: raise max_iterations, or go on from z0=result.z'
    """
    said = {status: words.get(status, status.value) for status in (*LIMITS, *WITHOUT_END)}
    other = _other_call(problem, chosen) if isinstance(chosen, Algorithm) else ""
    is_excluded = bool(stages) and stages[-1].least_residual > goal
    reached = stages[-1].z if stages and isinstance(chosen, Algorithm) else None
    goes_on = reached is None or chosen.uses_start(problem, reached)
    for status in LIMITS:
        said[status] += ", or go on from z0=result.z" * goes_on
        said[status] = (
            said[status].replace("; next: ", f"; next: try {other}, or ") if other else said[status]
        )
    is_far_out = any(stage.has_no_solution_nearby for stage in stages)
    end = FAR_OUT if is_far_out else f"next: try {other}" if other else _elsewhere(left_out)
    end = beyond_doubles(problem) or "; ".join(
        filter(None, (why_not_monotone(problem.matrix), end))
    )
    for status in WITHOUT_END:
        said[status] = EXCLUDED if is_excluded else f"{said[status]}; {end}"
    return {**words, **said}


def _elsewhere(left_out: Sequence[str]) -> str:
    """Return what is left to do where auto has come to its end, and what it did not try."""
    but_not = f", but not {', nor '.join(left_out)}" if left_out else ""
    return f"{TRIED}{but_not}; next: {ELSEWHERE}"


def advice_beside_a_wrong_row(words: Mapping[Status, str], row: str) -> dict[Status, str]:
    """Return the advice where the residual is small enough and a row, which it names, is wrong in its own terms."""
    wrong = f"the residual is small enough, but a row is wrong beside its own terms q_i and m_ij z_j: {row}"
    units = "state rows and unknowns in units in which the entries of M are of one size"
    said = {status: f"{wrong}; {words[status]}" for status in LIMITS}
    for status in WITHOUT_END:
        _, _, end = words[status].partition(NEXT)
        said[status] = f"{wrong}{NEXT}{'; '.join(filter(None, (units, end)))}"
    return {**words, **said}


def beyond_doubles(problem: LCP) -> str:
    """Return what to do where a row asks for a z beyond the largest double, or M z + q is that at once; '' elsewhere.

    Where w_i(z°) has the wrong sign and no bound stops z, some |z_j| is at least |w_i|/Σ_j |m_ij|.

    Parameters
    ----------
    problem : LCP

    Examples
    --------
    >>> print(beyond_doubles(LCP([[1e-200]], [-1e200])))
    row 0 has |q| = 1e+200 beside entries of M up to 1e-200, so that |z| is at least 1e+400, beyond the largest double;
    next: state the unknowns in a larger unit; divide M by 1e-200, q by 1e+200, and z is in units of 1e+200/1e-200
    >>> beyond_doubles(LCP([[1e-200]], [1e200])), beyond_doubles(LCP([[1e-200]], [-1e200], upper=1.0))
    ('', '')
    """
    largest = problem.matrix.row_largest
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        w = problem.slack(problem.nearest_to_zero)
        wrong = ((w < 0.0) & (problem.upper == np.inf)) | ((w > 0.0) & (problem.lower == -np.inf))
        exponents = np.where(
            wrong, np.log10(np.abs(problem.q)) - np.log10(largest * problem.n), -np.inf
        )
    i = int(np.argmax(exponents)) if exponents.size else 0
    if not exponents.size or not exponents[i] > MOST_DIGITS or not exponents[i] < np.inf:
        return "" if np.isfinite(w).all() else OVERFLOWS
    q, m = f"{abs(problem.q[i]):.3g}", f"{largest[i]:.3g}"
    return (
        f"row {problem.own_rows.start + i} has |q| = {q} beside entries of M up to {m}, so that |z| is at least "
        f"1e+{exponents[i]:.0f}, beyond the largest double; next: state the unknowns in a larger unit; divide M by "
        f"{m}, q by {q}, and z is in units of {q}/{m}"
    )


def advice_on_given_rows(problem: LCP, z: FloatVector, w: FloatVector) -> str:
    """Return what to do with rows that only give z, as boundary values do, and lie at a bound with w = 0; '' for none.

    Each is a kink of the solution for :func:`lcp_plugin.derivative`, which an equation is not.

    Parameters
    ----------
    problem : LCP
    z, w : array, shape (n,)

    Examples
    --------
    >>> import numpy as np
    >>> z = np.array([1.0, 1.5])
    >>> print(advice_on_given_rows(LCP([[1, 0], [-1, 2]], [-1, -2], lower=1.0), z, np.zeros(2)))
    M has nothing but a diagonal entry in row 0, where z is at a bound with w = 0: if such a row only gives z, as a
    boundary value does, leave its bounds out (lower = -inf, upper = inf), and derivative() sees no kink in it
    """
    if problem.is_distributed:
        return ""
    counts = (
        np.count_nonzero(problem.M, axis=1) if problem.is_dense else np.diff(problem.csr.indptr)
    )
    rows = np.flatnonzero(
        (counts == 1) & (problem.diagonal != 0.0) & (problem.lower < problem.upper)
    )
    near = ROUNDING * np.abs(z[rows])
    is_held = (z[rows] <= problem.lower[rows] + near) | (z[rows] >= problem.upper[rows] - near)
    rows = rows[is_held & (np.abs(w[rows]) <= ROUNDING * np.abs(problem.q[rows]))]
    if not rows.size:
        return ""
    named = (
        " and ".join(map(str, rows))
        if rows.size <= 2
        else f"{rows[0]}, {rows[1]} and {rows.size - 2} more"
    )
    return (
        f"M has nothing but a diagonal entry in row{'s' * (rows.size > 1)} {named}, where z is at a bound with w = 0: "
        "if such a row only gives z, as a boundary value does, leave its bounds out (lower = -inf, upper = inf), and "
        "derivative() sees no kink in it"
    )


def _other_call(problem: LCP, chosen: Algorithm) -> str:
    """Return another call than the one that has failed: what its options lack, or auto."""
    is_unscaled = getattr(chosen, "scaling", "auto") is None and bool(
        has_positive_diagonal(problem.matrix).all()
    )
    scaled = 'scaling="auto", which is enough where M is an H₊-matrix, or ' if is_unscaled else ""
    return f'{scaled}algorithm="auto"'


NOTHING_TO_DO = (
    "where it begins the residual is within the tolerance already, and nothing was left to do"
)


def unused_start(problem: LCP, chosen: Any, start: Any) -> str:
    """Return what to say of a start that the caller gave and the algorithm does not use; '' elsewhere.

    Parameters
    ----------
    problem : LCP
        In the units of the run, as the start is.
    chosen : str or Algorithm
    start : array, shape (n,)
    """
    is_given = isinstance(chosen, Algorithm) and bool((start != problem.nearest_to_zero).any())
    return chosen.why_no_start if is_given and not chosen.uses_start(problem, start) else ""
