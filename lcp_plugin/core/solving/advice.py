"""Advice of a run that did not solve its problem: what happened and what to do next."""

from __future__ import annotations

from typing import Any

from ..algorithm import Algorithm
from ..lcp import LCP
from ..settings import Settings, Status

LIMITS = (Status.MAX_ITERATIONS, Status.MAX_SECONDS)
WITHOUT_END = (Status.STALLED, Status.DIVERGED)
NOTHING_TO_DO = "the residual of the start is within the tolerance already; no iteration was needed"


def advice_of_run(problem: LCP, chosen: Any, settings: Settings) -> dict[Status, str]:
    """Return the advice of each possible termination status of the run.

    Parameters
    ----------
    problem : LCP
    chosen : str or Algorithm
        The algorithm of the call.
    settings : Settings

    Examples
    --------
    >>> advice_of_run(LCP([[2.0]], [1.0]), "auto", Settings())[Status.MAX_ITERATIONS]
    'iteration limit reached; next: raise max_iterations, or continue from z0=result.z'
    """
    said = {status: status.value for status in (*LIMITS, *WITHOUT_END)}
    other = 'algorithm="auto"' if isinstance(chosen, Algorithm) else ""
    for status in LIMITS:
        said[status] += ", or continue from z0=result.z"
        if other:
            said[status] = said[status].replace("; next: ", f"; next: try {other}, or ")
    tried = "auto has tried all methods that suit this matrix; next: try another start z0"
    end = f"next: try {other}" if other else tried
    if (negative := (problem.diagonal < 0.0)).all() and negative.size:
        end = f"every m_ii is negative: is −M meant, as for a Laplacian with the other sign? {end}"
    elif negative.any():
        end = f"M is not monotone (m_ii < 0 in {problem.names.row(int(negative.argmax()))}); {end}"
    for status in WITHOUT_END:
        said[status] += f"; {end}"
    if not settings.prove_infeasibility:
        said[Status.STALLED] += "; not proved infeasible, because prove_infeasibility=False"
    return said
