"""Answers that owe nothing to the package: active sets by scipy's factors, refined with longer residuals."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import nnls
from scipy.sparse.linalg import splu

ROUNDING = 1e-12  # of a row's own terms: what a right answer may leave
LEAST_SQUARES = 1e-10  # and one of nonnegative least squares
ROUNDS = 300
# rounds without fewer wrong rows, until one row at a time is exchanged (Júdice and Pires)
PATIENCE = 8


class NoReference(Exception):
    """No active set was found whose answer is complementary to rounding."""


def active_sets(problem: Any, starts: Iterable[Any]) -> Any:
    """Return z by block principal pivoting from the active sets of these points, then from the bounds.

    Of a P-matrix it ends for any start; what it returns is checked in extended precision.
    """
    M, q, lower, upper = problem
    d = scale(M)
    for z in [*starts, np.clip(0.0, lower, upper)]:
        trial = z - (M @ z + q) / d
        try:
            return checked(
                problem,
                _pivoted(problem, np.where(trial <= lower, -1, np.where(trial >= upper, 1, 0))),
            )
        except NoReference:
            continue
    raise NoReference("no active set ends in an answer")


def _pivoted(problem: Any, side: Any) -> Any:
    M, q, lower, upper = problem
    fewest, patience = q.size + 1, PATIENCE
    for _ in range(ROUNDS):
        z, w = _with_sides(problem, side)
        small = 1e-13 * (abs(M) @ abs(z) + abs(q))  # a wrong sign of that size is rounding
        wrong = np.where(side == 0, (z < lower) * -1 + (z > upper) * 1, 0)  # goes to that side
        leaves = ((side < 0) & (w < -small)) | ((side > 0) & (w > small))
        leaves &= lower < upper
        rows = np.flatnonzero((wrong != 0) | leaves)
        if not rows.size:
            return z
        if rows.size < fewest:
            fewest, patience = rows.size, PATIENCE
        elif patience:
            patience -= 1
        else:
            rows = rows[-1:]  # Murty's rule
        side = side.copy()
        side[rows] = wrong[rows]
    raise NoReference("the active sets go on changing")


def _with_sides(problem: Any, side: Any) -> tuple[Any, Any]:
    """Return z at these bounds, free where the side is 0, and w: refined until both are as good as doubles are."""
    M, _, lower, upper = problem
    free = np.flatnonzero(side == 0)
    z = np.where(side < 0, lower, np.where(side > 0, upper, 0.0))
    if free.size:
        try:
            factor = splu(sp.csc_array(M[free][:, free]))
        except RuntimeError as error:  # exactly singular
            raise NoReference(str(error)) from error
        with np.errstate(all="ignore"):
            for _ in range(4):
                z[free] -= factor.solve(slack(problem, z)[free].astype(float))
        if not np.isfinite(z).all():
            raise NoReference("singular")
    w = slack(problem, z).astype(float)
    w[free] = 0.0
    return z, w


def semidefinite(problem: Any, starts: Iterable[Any]) -> Any:
    """Return one of the z ≥ 0 of a monotone M, w being the same for all: nonnegative least squares on idle rows.

    Idle are rows whose w is 0; from a start that tells these, all of M z on them follows, and so on the others.
    """
    M, q, *_ = problem
    M, sizes = M.toarray(), (1e-6, 1e-4, 1e-9)
    for start, size in product(starts, sizes):
        idle = np.flatnonzero(M @ start + q <= size * (abs(M) @ abs(start) + abs(q)))
        z = np.zeros(q.size)
        try:
            z[idle] = nnls(M[np.ix_(idle, idle)], -q[idle])[0]
            return checked(problem, z, LEAST_SQUARES)
        except (NoReference, RuntimeError):
            continue
    raise NoReference("no set of idle rows has an answer")


def slack(problem: Any, z: Any) -> Any:
    """Return w = M z + q in extended precision."""
    M, q, *_ = problem
    w, filled = q.astype(np.longdouble), np.flatnonzero(np.diff(M.indptr))
    w[filled] += np.add.reduceat(M.data.astype(np.longdouble) * z[M.indices], M.indptr[filled])
    return w


def checked(problem: Any, z: Any, rounding: float = ROUNDING) -> Any:
    """Return z where it is complementary up to rounding of the terms of each of its rows."""
    M, q, lower, upper = problem
    w, terms = slack(problem, z), abs(M) @ abs(z) + abs(q)
    wrong = np.where(z <= lower, -w, np.where(z >= upper, w, abs(w)))
    wrong = np.where(lower == upper, 0.0, wrong)
    if (z < lower).any() or (z > upper).any() or (wrong > rounding * terms).any():
        raise NoReference(
            f"wrong by {np.max(wrong / np.maximum(terms, 1e-300)):.1e} of a row's terms"
        )
    return z


def violation(problem: Any, z: Any) -> float:
    """Return the largest natural residual in the units of the problem beside that of the point nearest to 0."""
    M, _, lower, upper = problem
    d = scale(M)
    first = np.clip(0.0, lower, upper)
    norms = [
        float(abs(x - np.clip(x - slack(problem, x) / d, lower, upper)).max()) for x in (z, first)
    ]
    return norms[0] / norms[1]


def scale(M: Any) -> Any:
    """Return the diagonal of M, the largest entry of a row where it is negligible."""
    d, largest = abs(M.diagonal()), abs(M).max(axis=1).toarray().ravel()
    return np.where(d > 1e-10 * largest, d, np.where(largest > 0.0, largest, 1.0))
