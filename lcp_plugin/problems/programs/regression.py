"""Programs that state least squares with an unknown and an equation for each residual, as cvxpy does.

min ½ Σ d_i s_i² + ½ ridge ‖x‖² + Σ c_j t_j  subject to  A x + a ∘ s = b,  ±g_j x_j ≤ k_j t_j,  lower ≤ x ≤ upper
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import Vector
from ...core.deadline import seconds_left
from ...core.errors import LCPError
from ...core.matrix import row_numbers
from ..least_squares.data import BoundedLeastSquares
from ..least_squares.engines import FacePoint, minimize_on_face
from ..least_squares.solving import solve_least_squares
from .program_matrices import FULL_UP_TO, Indices

if TYPE_CHECKING:
    from .program import QuadraticProgram

NOISE = 2.0**-40  # of b: residuals that are all rounding errors


class Regression(NamedTuple):
    """Least squares problem of a program, and the places of its parts in the program.

    Attributes
    ----------
    program : QuadraticProgram
    problem : BoundedLeastSquares
    columns, residuals : ndarray of int
        Unknowns of the program that are x, and the residual of each equation.
    scales : ndarray
        Coefficient a of each residual.
    sizes, pairs : ndarray of int, shapes (k,) and (k, 2)
        Unknowns t, and the two rows of G of each.
    slopes, weights : ndarray, shape (k,)
        Coefficient g in the first row of a pair, and coefficient k of t.
    penalized : ndarray of int, shape (k,)
        Place in x of the unknown of each pair.
    """

    program: QuadraticProgram
    problem: BoundedLeastSquares
    columns: Indices
    residuals: Indices
    scales: Vector
    sizes: Indices
    pairs: Indices
    slopes: Vector
    weights: Vector
    penalized: Indices

    @classmethod
    def of(cls, program: QuadraticProgram) -> Regression | None:
        """Return the form of a program with a full A of moderate size, or None if it has another form.

        Examples
        --------
        >>> from lcp_plugin import QuadraticProgram
        >>> A = sp.csr_array([[3.0, 1.0, -1.0, 0.0], [1.0, 2.0, 0.0, -1.0]])
        >>> program = QuadraticProgram(sp.diags_array([0.0, 0.0, 2.0, 2.0]), np.zeros(4), A=A, b=[1.0, 2.0])
        >>> Regression.of(program).problem
        BoundedLeastSquares(2 rows, 2 columns, dense)
        """
        P, c, G, A, n, p = program.P, program.c, program.G, program.A, program.n, program.b.size
        if not (sp.issparse(P) and 0 < p <= P.nnz <= n):
            return None
        d, is_free = P.diagonal(), np.isneginf(program.lower) & np.isposinf(program.upper)
        A, G = sp.csr_array(A), sp.csr_array(G)
        in_A, in_G = (np.bincount(one.indices, minlength=n) for one in (A, G))
        is_residual = (d > 0.0) & (in_A == 1) & (in_G == 0) & (c == 0.0) & is_free
        own = np.flatnonzero(is_residual[A.indices])
        is_size = (d == 0.0) & (in_A == 0) & (in_G == 2) & (c > 0.0) & is_free
        columns, sizes = np.flatnonzero(~(is_residual | is_size)), np.flatnonzero(is_size)
        if (
            not columns.size
            or np.count_nonzero(d) < P.nnz
            or not np.array_equal(row_numbers(A)[own], np.arange(p))
            or A.nnz - p < 0.3 * p * columns.size
            or min(p, columns.size) > FULL_UP_TO
            or c[columns].any()
            or np.ptp(d[columns]) > 0.0
            or program.h.any()
            or (np.diff(G.indptr) != 2).any()
            or G.shape[0] != 2 * sizes.size
        ):
            return None
        # A place in each row of G, both rows of a t together
        at: Any = np.flatnonzero(is_size[G.indices])
        at = at[np.argsort(G.indices[at], kind="stable")].reshape(-1, 2)
        other = at ^ 1  # each row has two entries
        x, g, k = G.indices[other], G.data[other], -G.data[at]
        place = np.full(n, -1)
        place[columns] = np.arange(columns.size)
        are_pairs = (
            (place[x] >= 0).all(axis=1)
            & (x[:, 0] == x[:, 1])
            & (g[:, 0] == -g[:, 1])
            & (k[:, 0] == k[:, 1])
        )
        if not (are_pairs & (k[:, 0] > 0.0)).all() or np.unique(x[:, 0]).size < sizes.size:
            return None
        scales, penalized = A.data[own], place[x[:, 0]]
        squares, l1 = d[A.indices[own]] / scales**2, np.zeros(columns.size)
        l1[penalized] = c[sizes] / k[:, 0] * np.abs(g[:, 0])
        is_even = bool(np.ptp(squares) == 0.0)
        unit = squares[0] if is_even else 1.0
        inner, rows = place[A.indices] >= 0, np.zeros((p, columns.size))
        rows[row_numbers(A)[inner], place[A.indices[inner]]] = A.data[inner]
        bounds, weights = (
            (program.lower[columns], program.upper[columns]),
            None if is_even else squares,
        )
        ridge, l1 = d[columns[0]] / unit, l1 / unit
        try:
            problem = BoundedLeastSquares(
                rows, program.b, *bounds, weights=weights, ridge=ridge, l1=l1
            )
        except LCPError:  # squares are out of the range of doubles
            return None
        own, pairs = A.indices[own], at // 2
        return cls(
            program, problem, columns, own, scales, sizes, pairs, g[:, 0], k[:, 0], penalized
        )

    def points(self, options: dict[str, Any]) -> Iterator[tuple[Vector, Vector, str, int]]:
        """Yield x and y of the program with the solver and its steps: of a solution, and of the minimum on its face."""
        problem = self.problem
        if np.isfinite(limit := seconds_left()):
            options = {**options, "max_seconds": limit}
        found = solve_least_squares(problem, **options)
        yield *self.outward(found.x), found.algorithm, found.iterations
        scaled = problem.scaled
        near = FacePoint(scaled, scaled.from_caller(found.x))
        x = scaled.to_caller(minimize_on_face(near, *scaled.rows(is_dense=True)).x)
        yield *self.outward(x), found.algorithm, found.iterations

    def outward(self, x: Vector) -> tuple[Vector, Vector]:
        """Return the unknowns and the multipliers of [G; A] of the program at x."""
        program, b = self.program, self.problem.b
        residual = self.problem.product(x) - b
        if np.abs(residual).max() <= NOISE * np.abs(b).max():  # an exact fit
            residual = np.zeros(b.size)
        d, every, k = program.P.diagonal(), np.zeros(program.n), self.weights
        every[self.columns], every[self.residuals] = x, -residual / self.scales
        every[self.sizes] = np.abs(self.slopes * x[self.penalized]) / k
        equality = d[self.residuals] * residual / self.scales**2
        gradient = self.problem.apply_transpose(equality) + d[self.columns] * x
        sums, inequality = program.c[self.sizes] / k, np.zeros(program.h.size)
        first = np.clip(0.5 * (sums - gradient[self.penalized] / self.slopes), 0.0, sums)
        inequality[self.pairs[:, 0]], inequality[self.pairs[:, 1]] = first, sums - first
        return every, np.concatenate([inequality, equality])
