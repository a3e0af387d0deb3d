"""Interior points: the convex program of a monotone problem by PIQP, then the linear system of its active set."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core import deadline
from ..core.algorithm import Algorithm, Step
from ..core.checks import Array, Indices, Vector
from ..core.entries import largest_in_rows, max_norm, row_numbers, unbounded, with_entries
from ..core.lcp import LCP
from ..core.matrix import Matrix, fact
from ..core.rounding import ROUNDING
from ..core.structure import equation_signs, is_nearly_symmetric
from ..core.tuning import DENSE_OPERATIONS, FULL_CHOLESKY_UP_TO, SPARSE_OPERATIONS
from ..engines import installed_engine
from ..engines.engine import Engine, ProgramData, SolverLimits
from ..engines.scaling import scale_program, with_sides_about_one
from ..systems.equilibration import power_of_two
from ..systems.factors import sizes_of_factor
from .lemke.pivoting_path import is_game
from .newton import classify, is_near, signature, solve_active_set
from .small import bimatrix_players

PIQP_STEPS = 60  # of PIQP: 10 to 30 if M is monotone by more than rounding


@dataclass(frozen=True, kw_only=True)
class InteriorPoint(Algorithm):
    """PIQP's interior-point method on the convex program of a monotone problem, with active-set polishing.

    Notes
    -----
    If M is symmetric, the program is min ½ zᵀM z + qᵀz in the bounds. If diag(s) M with s = ±1 is the saddle point
    problem of a program, that program is solved. A zero-sum game is a linear program. Otherwise the program is
    min zᵀ(M z + q) with M z + q ≥ 0, z ≥ 0, and similarly for other bounds. Linear solves on the active set of PIQP's
    point, and on the following active sets, reduce the residual to rounding level. If no active set is right, a second
    run of PIQP has the tolerance 1e-13. If M is not monotone, the program is not convex, and the run ends with PIQP.

    The history contains PIQP's final point and the point after each linear solve, because PIQP does not report its
    iterations. PIQP cannot be stopped: it starts only if its factorizations are predicted to fit into the remaining
    seconds, and Ctrl-C takes effect when it returns. The active set of a start z0 near the solution is tried first;
    any other start has no effect.

    References
    ----------
    Schwan, Jiang, Kuhn, Jones 2023, doi:10.1109/CDC49753.2023.10383915.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[2, 1], [1, 2]], [-5, 1])
    >>> lcp_plugin.solve(problem, InteriorPoint()).z
    array([2.5, 0. ])
    """

    name: ClassVar[str] = "interior_point"
    engine: ClassVar[str] = "piqp"
    needs: ClassVar[str] = "monotone M"
    solves: ClassVar[str] = "– (by experience: PSD, also nonsymmetric)"
    cost: ClassVar[str] = "one run of 10 to 30 factorizations"
    reference: ClassVar[str] = "Schwan, Jiang, Kuhn, Jones 2023, doi:10.1109/CDC49753.2023.10383915"
    is_monotone: ClassVar[bool] = False
    ends_on_active_set: ClassVar[bool] = True

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the start, and the point of PIQP after the solution of the system of its active set."""
        z, engine = np.clip(z0, problem.lower, problem.upper), installed_engine(self.engine)
        yield Step(z, work=1.0)
        if is_near(problem, z):
            yield from _cases(problem, z, 1)
        operations, speed = problem.n**3 / 3.0, DENSE_OPERATIONS
        if not problem.is_dense:
            operations = min(operations, sizes_of_factor(problem.matrix)[1])
            speed = SPARSE_OPERATIONS
        seconds = 20 * operations / speed  # of PIQP's factorizations
        deadline.require_seconds(seconds)
        program: Any = ZeroSumGame.of(problem)
        if program is None:
            program = MonotoneProgram.of(with_signed_equations(problem))
        # A second run is sharper: M is singular on many active sets.
        for options in ({}, {"eps_abs": 1e-13, "eps_rel": 1e-13}):
            deadline.require_seconds(seconds)
            z, steps = program.answer(engine(max_iter=PIQP_STEPS, **options))
            if not np.isfinite(z).all():
                return
            # Complementarity pieces near a point of an engine; one of a start
            cases = chain(_cases(problem, z, 20), _cases(problem, z, 5, are_ties_free=False))
            sharp = next(cases, Step(z))
            sharp.work += steps * (1.0 + operations / max(problem.nonzeros, 1))
            sharp.remark = f"{engine.name} took {steps} steps"
            yield from chain([sharp, Step(z)], cases)
            if steps in (0, PIQP_STEPS):  # PIQP gave up
                return


def _cases(problem: LCP, z: Vector, most: int, *, are_ties_free: bool = True) -> Iterator[Step]:
    """Yield the solution for the active set of z, then for the active set of this solution, while they are new."""
    system, tried, d = None, set[bytes](), problem.diagonal
    # z and w relative to one another, by the diagonal: the row of a border may be much larger than the others
    units = np.divide(problem.residual_scale, d, out=np.ones(problem.n), where=d > 0.0)
    for _ in range(most):
        sides = classify(problem, z, problem.slack(z) * units, are_ties_free=are_ties_free)
        if (case := signature(*sides)) in tried:
            return
        tried.add(case)
        solution = solve_active_set(problem, *sides, near=z, system=system)
        if solution is None or not np.isfinite(solution.z).all():
            return
        z, system = solution.z, solution.system
        yield Step(np.clip(z, problem.lower, problem.upper), work=solution.work)


@dataclass(frozen=True, eq=False)
class MonotoneProgram:
    """A program whose unknowns are some z, x, and the parts v ≥ 0 of slacks that are negative at an upper bound.

    Attributes
    ----------
    problem : LCP
    statement : ProgramData
        min ½ xᵀP x + cᵀx + Σ (upper − lower) v with R x + q + v ≥ 0, or ≤ 0, or = 0, as each row's bounds ask for;
        x, v and all vectors in `size`.
    size : float
        A power of two that the largest of costs and right-hand sides is near.
    unknowns, multipliers : array of int
        Indices of the z that are x, and that are multipliers of the rows; the others are `anchor`.
    anchor : array, shape (n,)
        A finite bound of each z, or 0.
    """

    problem: LCP
    statement: ProgramData
    size: float
    unknowns: Indices
    multipliers: Array
    anchor: Vector

    @classmethod
    def of(cls, problem: LCP) -> MonotoneProgram:
        """Return the program of the rows that are not fixed: by signs if M has them, else the gap program."""
        signs = signs_of(problem.matrix)
        M, q, lower, upper = problem.M, problem.q, problem.lower, problem.upper
        anchor = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 0.0))
        kept = np.flatnonzero(lower < upper)
        if kept.size < problem.n:
            q = problem.slack(np.where(lower < upper, 0.0, lower))[kept]
            M = M[kept][:, kept]
        if sp.issparse(M) and kept.size <= FULL_CHOLESKY_UP_TO:
            sparse = sizes_of_factor(problem.matrix)[1] / SPARSE_OPERATIONS
            M = M.toarray() if sparse > kept.size**3 / 3.0 / DENSE_OPERATIONS else M
        a, every = anchor[kept], np.arange(kept.size)
        if signs is None:
            x = y = every
            P, R, c, multipliers = M + M.T, M, q - M.T @ a, kept[:0]
        else:
            is_x = signs[kept] > 0.0 if (signs[kept] > 0.0).any() else np.ones(kept.size, np.bool_)
            x, y = np.flatnonzero(is_x), np.flatnonzero(~is_x)
            P = M[x][:, x] if y.size else M
            P, R, c, multipliers = 0.5 * (P + P.T), M[y][:, x], (q + M[:, y] @ a[y])[x], kept[y]
        bounds = lower[kept[x]], upper[kept[x]]
        statement = _statement_of(P, c, R, q[y], lower[kept][y], upper[kept][y], *bounds)
        size = float(power_of_two(_size(statement.c, statement.h, statement.b)))
        vectors = {k: getattr(statement, k) / size for k in ("c", "h", "b", "lower", "upper")}
        return cls(problem, statement._replace(**vectors), size, kept[x], multipliers, anchor)

    def answer(self, engine: Engine) -> tuple[Vector, int]:
        """Return z within its bounds, NaN if the engine has none, and its steps.

        The engine sees x in a unit in which costs are as large as coefficients.
        """
        program, problem, rows = self.statement, self.problem, self.multipliers
        z = np.where(problem.lower == problem.upper, problem.lower, 0.0)
        if not self.unknowns.size:
            return z, 0
        sizes = _size(program.c, program.h, program.b), _size(program.P, program.G, program.A)
        unit = power_of_two(sizes[0] / sizes[1]) if min(sizes) > 0.0 else 1.0
        prepared = with_sides_about_one(scale_program(program, np.full(program.c.size, unit)))
        point = prepared.outward(engine.solve(prepared.statement, SolverLimits(deadline.left())))
        z[self.unknowns] = point.x[: self.unknowns.size] * self.size
        if rows.size:
            lower, upper, y = problem.lower[rows], problem.upper[rows], np.empty(rows.size)
            is_equation = unbounded(lower, upper)
            y[is_equation] = point.y[program.h.size :]
            sign = np.where(np.isfinite(lower), 1.0, -1.0)[~is_equation]
            y[~is_equation] = sign * point.y[: program.h.size]
            z[rows] = self.anchor[rows] + y * self.size
        return np.clip(z, problem.lower, problem.upper), point.iterations


class ZeroSumGame(NamedTuple):
    """Game of costs K, L > 0, each unit of a best reply 1, in which K + λ L = r 1ᵀ + 1 cᵀ for some λ > 0.

    Terms that the other player's action adds to all costs have no influence on the equilibria, so that these are the
    saddle points of xᵀ(K − 1 cᵀ) y over probabilities x and y.

    Attributes
    ----------
    is_row : array of bool, shape (n,)
        Mask of the rows of the first player.
    K, L, losses : array, shape (m, k)
        Costs of both players, and K − 1 cᵀ divided by its largest entry.
    """

    is_row: Any
    K: Vector
    L: Vector
    losses: Vector

    @classmethod
    def of(cls, problem: LCP) -> ZeroSumGame | None:
        """Return the game, or None if the problem is none, or not a zero-sum game to rounding.

        Examples
        --------
        >>> ZeroSumGame.of(LCP.from_game([[1, -1], [-1, 1]], [[-1, 1], [1, -1]])).losses
        array([[-1.,  1.],
               [ 1., -1.]])
        >>> ZeroSumGame.of(LCP.from_game([[3, 0], [5, 1]], [[3, 5], [0, 1]])) is None
        True
        """
        if not is_game(problem):
            return None
        M = problem.matrix.toarray()
        is_row: Any = bimatrix_players(M, problem.q)
        costs = M / -problem.q[:, np.newaxis]
        K, L = costs[is_row][:, ~is_row], costs[~is_row][:, is_row].T
        of_K, of_L = (C - C.mean(0) - C.mean(1)[:, np.newaxis] + C.mean() for C in (K, L))
        ratio = -np.vdot(of_K, of_L) / np.vdot(of_L, of_L)
        both, sizes = K + ratio * L, (np.abs(K).max(), ratio * np.abs(L).max())
        # rounding of a game
        if not (ratio > 0.0 and np.abs(of_K + ratio * of_L).max() <= 1e-11 * max(sizes)):
            return None
        losses = K - (both.mean(0) - both.mean())
        losses -= losses.mean()
        return cls(is_row, K, L, losses / np.abs(losses).max())

    def answer(self, engine: Engine) -> tuple[Vector, int]:
        """Return z, NaN if the engine has none, and its steps."""
        m, k = self.losses.shape
        # x and the value of the game, which is the least
        P, c = np.zeros((m + 1, m + 1)), np.append(np.zeros(m), 1.0)
        inequalities = np.column_stack([self.losses.T, -np.ones(k)]), np.zeros(k)
        equation = np.append(np.ones(m), 0.0)[np.newaxis], np.ones(1)
        bounds = np.append(np.zeros(m), -np.inf), np.full(m + 1, np.inf)
        statement = ProgramData(P, c, *inequalities, *equation, *bounds)
        point = engine.solve(statement, SolverLimits(deadline.left()))
        x, y, z = np.maximum(point.x[:m], 0.0), np.maximum(point.y[:k], 0.0), np.empty(m + k)
        z[self.is_row], z[~self.is_row] = x / (x @ self.L @ y), y / (x @ self.K @ y)
        return z, point.iterations


def _size(*parts: Any) -> float:
    return max(max_norm(part.data if sp.issparse(part) else part) for part in parts)


def _statement_of(
    P: Any, c: Vector, R: Any, q: Vector, low: Vector, high: Vector, lower: Vector, upper: Vector
) -> ProgramData:
    """Return the statement with lower ≤ x ≤ upper, of rows whose multipliers are between `low` and `high`."""
    below, above = np.isfinite(low), np.isfinite(high)
    rows, equations, boxed = map(np.flatnonzero, (below | above, ~(below | above), below & above))
    sign, k = np.where(below, 1.0, -1.0)[rows], boxed.size
    A = -R[equations]
    G = sp.diags_array(-sign) @ R[rows] if sp.issparse(R) else -sign[:, np.newaxis] * R[rows]
    if k:
        places = np.searchsorted(rows, boxed), np.arange(k)
        v = sp.csr_array((np.full(k, -1.0), places), shape=(rows.size, k))
        if sp.issparse(R):
            P = sp.block_diag([P, sp.csr_array((k, k))])
            A = sp.hstack([A, sp.csr_array((equations.size, k))])
            G = sp.hstack([G, v])
        else:
            P, A, G = np.pad(P, (0, k)), np.pad(A, ((0, 0), (0, k))), np.hstack([G, v.toarray()])
    if sp.issparse(R):
        P, G, A = map(sp.csr_array, (P, G, A))
    c = np.append(c, (high - low)[boxed])
    bounds = np.append(lower, np.zeros(k)), np.append(upper, np.full(k, np.inf))
    return ProgramData(P, c, G, sign * q[rows], A, q[equations], *bounds)


def with_signed_equations(problem: LCP) -> LCP:
    """Return the problem with a skew border, if possible, and signs of equations that make M + Mᵀ smaller.

    The solutions do not change.
    """
    (units, data), M = skew_border(problem.matrix), problem.M
    if (units != 1.0).any():
        M = with_entries(problem.csr, data)
        M = M if sp.issparse(problem.M) else M.toarray()
    units = units * equation_signs(M, unbounded(problem.lower, problem.upper))
    if (units == 1.0).all():
        return problem
    bounds = {"lower": problem.lower, "upper": problem.upper}
    return LCP(M * np.sign(units)[:, None], problem.q * units, **bounds)


@fact
def skew_border(matrix: Matrix) -> tuple[Vector, Vector]:
    """Return units of rows, and the entries of M with them: rows of 0 diagonal that are multiples of their columns.

    Examples
    --------
    >>> skew_border(Matrix([[2.0, -1.0], [4.0, 0.0]]))
    (array([1.  , 0.25]), array([ 2., -1.,  1.]))
    """
    none = np.ones(matrix.n), np.zeros(0)
    if matrix.diagonal.all() or (mirrored := _entries_across(matrix)) is None:
        return none
    M = matrix.csr
    rows, ratios = row_numbers(M), np.abs(mirrored) / np.abs(M.data)
    most, inverse = largest_in_rows(M, np.stack([ratios, 1.0 / ratios]))
    is_border = (np.abs(most * inverse - 1.0) <= ROUNDING) & (np.abs(most - 1.0) > ROUNDING)
    units = np.where(is_border, most, 1.0)
    if (np.abs(units[rows] - units[M.indices] * ratios) > 10.0 * ROUNDING * units[rows]).any():
        return none
    return units, np.where(is_border[rows], np.copysign(mirrored, M.data), M.data)


@fact
def signs_of(matrix: Matrix) -> Vector | None:
    """Return signs s, shape (n,), with diag(s) M symmetric to rounding and 0 between negative signs, or None.

    Examples
    --------
    >>> signs_of(Matrix([[2.0, 3.0], [-3.0, 0.0]]))
    array([ 1., -1.])
    >>> signs_of(Matrix([[2.0, 3.0], [-1.0, 0.0]])) is None
    True
    """
    from scipy.sparse.csgraph import connected_components

    if is_nearly_symmetric(matrix):
        return np.ones(matrix.n)
    if (mirrored := _entries_across(matrix)) is None:
        return None
    M, n = matrix.csr, matrix.n
    size, rows, columns = ROUNDING * np.abs(M.data), row_numbers(M).astype(np.int64), M.indices
    is_same = np.abs(M.data - mirrored) <= size
    if not (is_same | (np.abs(M.data + mirrored) <= size)).all():
        return None
    # In a graph of every row and its opposite, a row that is connected with its opposite has no consistent sign.
    beside = columns + np.where(is_same, 0, n)
    edges = np.append(rows, rows + n), np.append(beside, (beside + n) % (2 * n))
    part = connected_components(
        sp.csr_array((np.ones(2 * rows.size), edges), shape=(2 * n, 2 * n)), directed=False
    )[1]
    bends = np.zeros(2 * n, dtype=bool)
    bends[part[rows[is_same]]] = True
    bent, opposite = bends[part[:n]], bends[part[n:]]
    if (part[:n] == part[n:]).any() or (bent & opposite).any():
        return None
    return np.where(bent | (~opposite & (part[:n] <= part[n:])), 1.0, -1.0)


def _entries_across(matrix: Matrix) -> Vector | None:
    """Return m_ji for each entry m_ij of the CSR array, or None if the pattern is not symmetric."""
    M, mirrored = matrix.csr, sp.csr_array(matrix.csr.T)
    mirrored.sort_indices()
    places = (M.indptr, mirrored.indptr), (M.indices, mirrored.indices)
    return mirrored.data if all(np.array_equal(*both) for both in places) else None
