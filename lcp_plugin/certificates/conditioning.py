"""How far a small residual may be from the answer: an estimate by the condition of M on the free rows.

To first order z − z* = (S M_FF)⁻¹ r_F on the rows F strictly between their bounds, S = D⁻¹: an error as large as
‖(S M_FF)⁻¹‖∞ ‖r‖∞ may hide behind a residual r. The norm is estimated from a few solves with one factorisation; this
proves nothing (see `error_bounds` for what does) and costs a factorisation, so that it is asked for, and only where
that is cheap.

References
----------
N. J. Higham, F. Tisseur, *A block algorithm for matrix 1-norm estimation*, SIAM J. Matrix Anal. Appl. 21 (2000),
doi:10.1137/S0895479899356080.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..matrix.factors import factor_fits, sparse_lu
from ..problem.lcp import LCP

DENSE_UP_TO = 500  # rows: a few milliseconds
SPARSE_UP_TO = 20_000


def estimated_error(problem: LCP, z: FloatVector, w: FloatVector, residual: float) -> float | None:
    """Return an estimate of the largest ‖z − z*‖∞ that goes with a scaled residual, or None where it is too costly.

    Parameters
    ----------
    problem : LCP
    z, w : arrays, shape (n,)
        A point and its slack.
    residual : float
        ‖r(z)‖∞, in the unit of z.

    Examples
    --------
    >>> problem = LCP([[1, -1 + 2**-30], [-1 + 2**-30, 1]], [-1, -1])
    >>> z = np.full(2, 2.0**30)
    >>> round(estimated_error(problem, z, problem.slack(z), 1e-8), 6)
    10.737418
    """
    scale = problem.residual_scale
    with np.errstate(all="ignore"):
        target = z - w / scale
        free = np.flatnonzero((target > problem.lower) & (target < problem.upper))
    if not free.size or not residual > 0.0 or not np.isfinite(residual):
        return 0.0 if residual == 0.0 or not free.size else None
    with np.errstate(all="ignore"):
        norm = _norm_of_inverse(problem, free)
    return None if norm is None else residual * norm


def _norm_of_inverse(problem: LCP, free: Any) -> float | None:
    """Return LAPACK's or Hager's estimate of ‖(S M_FF)⁻¹‖∞, ∞ where that is singular, None where it costs too much."""
    scale = problem.residual_scale[free]
    if free.size <= DENSE_UP_TO:
        from scipy.linalg import lapack

        block = problem.M[free][:, free]
        block = (block.toarray() if sp.issparse(block) else block) / scale[:, None]
        if not np.isfinite(block).all():
            return None
        norm = float(np.abs(block).sum(axis=1).max())
        reciprocal = norm * lapack.dgecon(lapack.dgetrf(block)[0], norm, norm="I")[0]
        return 1.0 / reciprocal if reciprocal > 0.0 else np.inf
    if free.size > SPARSE_UP_TO or problem.is_dense:
        return None
    sparse = sp.diags_array(1.0 / scale) @ problem.csr[free][:, free]
    if not np.isfinite(sparse.data).all() or not factor_fits(sparse):
        return None
    from scipy.sparse.linalg import LinearOperator, onenormest

    try:
        factor = sparse_lu(sparse)
    except RuntimeError:
        return np.inf
    transpose = LinearOperator(
        sparse.shape, dtype=np.float64, matvec=lambda x: factor.solve(x, "T"), rmatvec=factor.solve
    )
    return float(onenormest(transpose, t=1))  # more columns at once would be drawn from numpy's global generator
