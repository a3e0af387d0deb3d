"""Many problems with one matrix: prepare it once, solve for each q."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..algorithms import Algorithm
from ..errors import InvalidOption, InvalidProblem, LCPError, UnknownAlgorithm
from ..matrix.row_sums import has_positive_diagonal, inverse_residual_scale, row_splits
from ..problem.lcp import LCP
from ..settings import CallersOwn, Status
from .driver import solve
from .result import Result


def prepare(problem: LCP) -> LCP:
    """Return the same problem with all that depends on M alone computed: diagonal, row splits, symmetry, hierarchy.

    ``problem.with_q(q)`` shares it, so that a march in time pays for it once; a solve without it computes what it
    needs when it needs it.

    Parameters
    ----------
    problem : LCP

    Raises
    ------
    InvalidOption
        Where it is no LCP.

    Examples
    --------
    >>> problem = prepare(LCP([[2, -1], [-1, 2]], [-1, 0]))
    >>> [float(solve(problem.with_q([-1, q])).z[0].round(6)) for q in (0.0, 1.0)]
    [0.666667, 0.5]
    """
    if not isinstance(problem, LCP):
        raise InvalidOption(f"prepare needs an LCP, got {type(problem).__name__}; write prepare(LCP(M, q))")
    from ..algorithms.multigrid import Multigrid
    from ..algorithms.multigrid_run import hierarchy_of

    inverse_residual_scale(problem.matrix)
    for backward in (False, True):
        row_splits(problem.matrix, backward)
    if problem.peers.everywhere(bool(has_positive_diagonal(problem.matrix).all())):
        hierarchy_of(problem.matrix, Multigrid.coarsest)
    return problem


def solve_many(
    problem: LCP, Q: ArrayLike | Sequence[ArrayLike], algorithm: str | Algorithm = "auto", **options: Any
) -> list[Result | LCPError]:
    """Return one entry a column of Q, in order: its Result, or the error that says what is wrong with it.

    Parameters
    ----------
    problem : LCP
        Gives M and the bounds; its own q is not used.
    Q : array, shape (n, k), or a sequence of k vectors
        A vector of another length, or with NaN in it, is an InvalidProblem in its place and does not stop the rest.
    algorithm, **options
        As for :func:`lcp_plugin.solve`.

    Returns
    -------
    list of Result or LCPError
        Of length k; shorter only where a run was INTERRUPTED, which ends the batch.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        What concerns all columns, before the first.
    InvalidProblem
        Where Q is no collection of vectors, or none of them has length n: a transposed Q, for one.
    Exception
        What a callback raises, whatever it is, as in :func:`lcp_plugin.solve`.

    Examples
    --------
    >>> answers = solve_many(LCP([[2, 1], [1, 2]], [0, 0]), [[-5, 1], [np.nan, 0], [1, 1]])
    >>> [type(answer).__name__ for answer in answers], answers[0].z.round(6)
    (['Result', 'InvalidProblem', 'Result'], array([2.5, 0. ]))
    """
    if not isinstance(problem, LCP):
        raise InvalidOption(f"solve_many needs an LCP, got {type(problem).__name__}; write solve_many(LCP(M, q), Q)")
    callers = CallersOwn(options["callback"]) if callable(options.get("callback")) else None
    if callers is not None:
        options["callback"] = callers
    answers: list[Result | LCPError] = []
    for q in _columns(Q, problem.n):
        try:
            answer: Result | LCPError = solve(problem.with_q(q), algorithm, **options)
        except (InvalidOption, UnknownAlgorithm):
            raise
        except LCPError as error:
            if callers is not None and error is callers.raised:
                raise
            answer = error
        answers.append(answer)
        if isinstance(answer, Result) and answer.status is Status.INTERRUPTED:
            break
    return answers


def _columns(Q: Any, n: int) -> list[Any]:
    need = f"Q must be an array of shape (n, k), n = {n}, or a list of vectors of length {n}"
    if isinstance(Q, np.ndarray) and Q.ndim == 2:
        if Q.shape[0] != n:
            hint = "; its rows are vectors of that length: give Q.T" if Q.shape[1] == n else ""
            raise InvalidProblem(f"{need}, got an array of shape {Q.shape}{hint}")
        return [np.ascontiguousarray(column) for column in Q.T]
    if isinstance(Q, np.ndarray) or not isinstance(Q, Sequence) or isinstance(Q, str):
        shape = f"an array of shape {Q.shape}" if isinstance(Q, np.ndarray) else type(Q).__name__
        raise InvalidProblem(f"{need}, got {shape}")
    lengths = {_length(q) for q in Q}
    if Q and n not in lengths:
        hint = "; they are as many as rows: give the columns" if len(Q) == n else ""
        found = ", ".join(map(str, sorted(lengths)))
        raise InvalidProblem(f"{need}, got a list of {len(Q)} with lengths {found}{hint}")
    return list(Q)


def _length(q: Any) -> int:
    if isinstance(q, np.ndarray):
        return q.size
    return len(q) if hasattr(q, "__len__") else 1
