"""Directions of other solutions of an LCP near a solution."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import null_space

from ..core.checks import FloatMatrix
from ..core.kernels.floats import EPSILON, NORMAL
from ..core.lcp import LCP
from ..systems.free_systems import CONSISTENT, LEAST_SQUARES_UP_TO
from .bounds import ActiveRows
from .farkas import linear_program


@np.errstate(all="ignore")
def directions_of_solutions(problem: LCP, rows: ActiveRows) -> FloatMatrix | None:
    """Return directions, shape (n, k), that span all solutions near a solution; None for more than 500 rows.

    For d in a free row (M d)_i = 0, in a degenerate row d_i ≥ 0 and (M d)_i ≥ 0 at a lower bound, the mirror image at
    an upper bound, and d = 0 elsewhere. Degenerate rows also need (M + Mᵀ) d = 0: if M is monotone, these are all
    solutions, otherwise perhaps some of them.

    Parameters
    ----------
    problem : LCP
    rows : ActiveRows
        Of the solution.

    Examples
    --------
    Any share of the load is a solution:

    >>> from lcp_plugin.proofs.bounds import settled_rows
    >>> problem = LCP([[1, 1], [1, 1]], [-2, -2])
    >>> z = np.array([1.0, 1.0])
    >>> directions_of_solutions(problem, settled_rows(problem, z, problem.slack(z))).shape
    (2, 1)
    """
    part = np.flatnonzero(rows.free | rows.degenerate)
    if part.size > LEAST_SQUARES_UP_TO:
        return None
    block = problem.csr[part][:, part].toarray()
    is_degenerate = rows.degenerate[part]
    stated = block[~is_degenerate]
    if is_degenerate.any():
        stated = np.vstack([stated, block + block.T])
    basis = _null_space(stated)
    sign = np.where(rows.is_upper[part], -1.0, 1.0)[is_degenerate, np.newaxis]
    cone = np.vstack([sign * basis[is_degenerate], sign * (block @ basis)[is_degenerate]])
    basis = basis @ _span(cone)
    directions = np.zeros((problem.n, basis.shape[1]))
    directions[part] = basis
    return directions


def moving(directions: FloatMatrix) -> NDArray[np.intp]:
    """Return the numbers of the unknowns that differ in the solutions along these directions."""
    size = np.abs(directions).max(axis=1, initial=0.0)
    return np.flatnonzero(size > CONSISTENT * size.max(initial=0.0))


def _null_space(matrix: FloatMatrix, tolerance: float = 0.0) -> FloatMatrix:
    """Return a basis of {y: matrix · y = 0}, as columns."""
    columns = np.abs(matrix).max(axis=0, initial=0.0)
    unit = 1.0 / np.where(columns > 0.0, np.maximum(columns, NORMAL), 1.0)
    scaled = matrix * unit
    largest = np.abs(scaled).max(axis=1, initial=0.0)
    scaled = scaled[largest > 0.0] / largest[largest > 0.0, np.newaxis]
    if not scaled.size:
        return np.eye(matrix.shape[1])
    # Times the tolerance of numpy's matrix_rank: the entries are rounded also
    least = max(8.0 * max(scaled.shape) * EPSILON, tolerance)
    basis = unit[:, np.newaxis] * null_space(scaled, least)
    return np.asarray(basis / np.abs(basis).max(axis=0, initial=0.0))


def _span(cone: FloatMatrix) -> FloatMatrix:
    """Return a basis of the span of {y: cone · y ≥ 0}: a linear program finds the rows that are 0 in all of it."""
    size = np.abs(cone).max(axis=1, initial=0.0)
    cone = cone[size > CONSISTENT] / size[size > CONSISTENT, np.newaxis]
    cone[np.abs(cone) <= CONSISTENT] = 0.0  # rounding of a computed basis
    m, k = cone.shape
    if not m:
        return np.eye(k)
    cost = np.concatenate([np.zeros(k), -np.ones(m)])
    bounds = np.repeat([[-np.inf, 0.0], [np.inf, 1.0]], [k, m], axis=1)
    at_most = np.hstack([-cone, np.eye(m)]), np.zeros(m)
    result = linear_program(cost, sp.csr_array((0, k + m)), 0.0, bounds, at_most)
    if result is None:
        return np.zeros((k, 0))
    return _null_space(cone[result.x[k:] < 0.5], CONSISTENT)  # slacks that are 0, not 1
