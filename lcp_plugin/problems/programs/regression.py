"""Programs that state least squares with an unknown and an equation for each residual, as cvxpy does.

min ½ Σ d_i s_i² + ½ ridge ‖x‖² + Σ c_j t_j  subject to  A x + a ∘ s = b,  ±g_j x_j ≤ k_j t_j,  lower ≤ x ≤ upper
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import Vector
from ...core.entries import max_norm, row_numbers, unbounded
from ...core.errors import LCPError
from ..least_squares.data import BoundedLeastSquares
from ..least_squares.engines import FacePoint, minimize_on_face
from .program_matrices import FULL_UP_TO

if TYPE_CHECKING:
    from .program import QuadraticProgram

Outward = Callable[[Vector], tuple[Vector, Vector]]


def regression_of(program: QuadraticProgram) -> tuple[BoundedLeastSquares, Outward] | None:
    """Return the least squares problem that a program states with a full A of moderate size, or None.

    The second value maps x to the unknowns and the multipliers of [G; A] of the program.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> P, G = sp.diags_array([0.0, 0.0, 1.0]), [[1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]]
    >>> program = QuadraticProgram(P, [0, 1, 0], G, [0, 0], [[2, 0, -1]], [3])  # ½ (2 x − 3)² + |x|
    >>> problem, outward = regression_of(program)
    >>> x, multipliers = outward(np.array([1.25]))
    >>> x, multipliers
    (array([ 1.25,  1.25, -0.5 ]), array([ 1. ,  0. , -0.5]))
    """
    c, b, n, p = program.c, program.b, program.n, program.b.size
    if not 0 < p <= (of_P := program.matrices.entries[0]) <= n:
        return None
    d, is_free = program.P.diagonal(), unbounded(program.lower, program.upper)
    A, G = sp.csr_array(program.A), sp.csr_array(program.G)
    in_A, in_G = (np.bincount(matrix.indices, minlength=n) for matrix in (A, G))
    is_residual = (d > 0.0) & (in_A == 1) & (in_G == 0) & (c == 0.0) & is_free
    is_size = (d == 0.0) & (in_A == 0) & (in_G == 2) & (c > 0.0) & is_free
    is_other, of_residuals = ~(is_residual | is_size), is_residual[A.indices]
    columns = np.flatnonzero(is_other)
    if not columns.size or (not is_size.any() and program.matrices.is_small):  # daqp is as quick
        return None
    is_full = A.nnz - p >= 0.3 * p * columns.size and min(p, columns.size) <= FULL_UP_TO
    has_even_ridge = not c[columns].any() and np.ptp(d[columns]) == 0.0
    is_residual_form = np.array_equal(row_numbers(A)[of_residuals], np.arange(p))
    is_diagonal = np.count_nonzero(d) == of_P
    if not (is_diagonal and is_residual_form and is_full and has_even_ridge):
        return None
    if program.h.any() or (np.diff(G.indptr) != 2).any():
        return None
    # The two entries of each row of G: −k t and g x
    unknowns, entries = G.indices.reshape(-1, 2), G.data.reshape(-1, 2)
    is_t = is_size[unknowns]
    if (is_t[:, 0] == is_t[:, 1]).any():
        return None
    t, x, g, k = unknowns[is_t], unknowns[~is_t], entries[~is_t], -entries[is_t]
    first, second = np.argsort(t, kind="stable").reshape(-1, 2).T  # the rows of each t
    are_pairs = (x[first] == x[second]) & (g[first] == -g[second]) & (k[first] == k[second])
    if not are_pairs.all() or (k <= 0.0).any() or (in_G[x] != 2).any():
        return None
    residuals, scales, l1 = A.indices[of_residuals], A.data[of_residuals], np.zeros(n)
    l1[x] = c[t] / k * np.abs(g)
    weights = d[residuals] / scales**2
    is_even = bool(np.ptp(weights) == 0.0)
    unit = weights[0] if is_even else 1.0
    place, rows = np.cumsum(is_other) - 1, np.zeros((p, columns.size))
    rows[row_numbers(A)[~of_residuals], place[A.indices[~of_residuals]]] = A.data[~of_residuals]
    # Below, residuals and hence multipliers are differences of rounded numbers
    if l1.any() and l1.max() < 1e-6 * unit * max_norm(rows.T @ b):
        return None
    data: dict[str, Any] = {"lower": program.lower[columns], "upper": program.upper[columns]}
    data |= {"ridge": d[columns[0]] / unit, "l1": l1[columns] / unit}
    data["weights"] = None if is_even else weights
    try:
        problem = BoundedLeastSquares(rows, b, **data)
    except LCPError:  # squares are out of the range of doubles
        return None

    def outward(point: Vector) -> tuple[Vector, Vector]:
        every, gradient, residual = np.zeros(n), np.zeros(n), problem.product(point) - b
        every[columns], every[residuals] = point, -residual / scales
        every[t] = np.abs(g * every[x]) / k
        equality = weights * residual
        gradient[columns] = problem.apply_transpose(equality) + d[columns] * point
        most, at = c[t] / k, g * every[x]
        inequality = np.clip(0.5 * (most - gradient[x] / g), 0.0, most)
        # The slope at a bound includes the multiplier of the bound: the sign of x decides which row is active.
        at_bound = (at != 0.0) & ((every[x] == program.lower[x]) | (every[x] == program.upper[x]))
        inequality = np.where(at_bound, np.where(at > 0.0, most, 0.0), inequality)
        return every, np.concatenate([inequality, equality])

    return problem, outward


def points_near(problem: BoundedLeastSquares, x: Vector) -> Iterator[Vector]:
    """Yield x, then the minimum on its face: with 400 rows and unknowns, the test of programs needs these digits."""
    yield x
    scaled = problem.scaled
    near = FacePoint(scaled, scaled.from_caller(x))
    yield scaled.to_caller(minimize_on_face(near, *scaled.rows(is_dense=True)).x)
