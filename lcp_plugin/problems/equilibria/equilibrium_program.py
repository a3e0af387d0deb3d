"""Programs with complementarity constraints: the best of the solutions of a complementarity problem."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...core import checks
from ...core.checks import AnyMatrix, Array, Indices, Vector, checked_bounds, checked_vector
from ...core.entries import largest_in_rows
from ...core.errors import InvalidProblem, LCPError, UnsupportedModel
from ...proofs import exact
from ..nonlinear.data import NonlinearProblem
from ..nonlinear.solving import solve_nonlinear
from ..programs.program import QuadraticProgram, refuse_nonconvex

#: The open branches of each pair, as a sum of LOWER, BETWEEN, UPPER.
Cases = NDArray[np.uint8]

# Branches of a pair: z at its lower bound and w ≥ 0, or w = 0, or z at its upper bound and w ≤ 0.
LOW_CASE, FREE_CASE, HIGH_CASE = 1, 2, 4
CASES = (LOW_CASE, FREE_CASE, HIGH_CASE)
# A share of `size_of_data`: at the tolerance 1e-6 ten times the rounding error of SCIP, 1e-9
LEAST_SHARE = 1e-2


def branches(cases: Cases, pair: int) -> list[Cases]:
    """Return the cases of the children of a node: one open branch of the pair each."""
    is_pair = np.arange(cases.size) == pair
    return [np.where(is_pair, np.uint8(case), cases) for case in CASES if cases[pair] & case]


@dataclass(frozen=True, eq=False)
class SmoothPart:
    """A smooth term f(x) of the objective, and smooth rows lower ≤ g(x) ≤ upper.

    Attributes
    ----------
    map : object
        Object with ``value(x)`` = (f, g), shape (1 + m,), and ``jacobian(x)``, CSR of shape (1 + m, n). SCIP also
        needs the expression program of a model.
    lower, upper : array, shape (m,)
        Bounds of g; equal for an equality.
    """

    map: Any
    lower: Vector
    upper: Vector


@dataclass(frozen=True, eq=False)
class EquilibriumProgram:
    """Minimize ½ xᵀP x + cᵀx over the constraints of a program and over pairs of variables z ⟂ w.

    Each complementarity piece (one branch per pair) is a program; the solution is the best of all pieces. Proofs
    require convex pieces: P ⪰ 0, no integers, no smooth objective.

    It is one class because violations, pieces and objective are measured on the same pairs and terms.

    Parameters
    ----------
    program : QuadraticProgram
        Objective, rows and bounds; P may be indefinite.
    first, second : array of int, shape (k,)
        The variables z = x_first and w = x_second of each pair: w ≥ 0 if z is at its lower bound, w ≤ 0 if z is at its
        upper bound, w = 0 between them; w = 0 if z has no bounds.
    lower, upper : scalar or array, shape (k,), optional
        The bounds of z in the pairs, ±1e20 and beyond for none; by default the program's bounds. If you pass
        other bounds, the program's bounds remain as ordinary constraints.
    integers : array of int, optional
        The variables that are integers.
    smooth : SmoothPart, optional
        Terms and rows that are neither linear nor quadratic.

    Raises
    ------
    InvalidProblem
        If the pairs are not two lists of variables of the same length.

    Examples
    --------
    The solution of 0 ≤ x₀ ⟂ x₁ ≥ 0 and x₀ + x₁ = 1 with the least x₀ + 2 x₁:

    >>> program = QuadraticProgram(np.zeros((2, 2)), [1, 2], A=[[1, 1]], b=[1], lower=0)
    >>> EquilibriumProgram(program, [0], [1])
    EquilibriumProgram(n=2, 1 pair)
    """

    program: QuadraticProgram
    first: Indices
    second: Indices
    lower: Array = None
    upper: Array = None
    integers: Array = ()
    smooth: SmoothPart | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.program, QuadraticProgram):
            raise InvalidProblem(
                f"program must be a QuadraticProgram, got {type(self.program).__name__}"
            )
        for name in ("first", "second", "integers"):
            index = np.asarray(getattr(self, name))
            n, k = self.program.n, np.size(index if name == "integers" else self.first)
            if index.ndim != 1 or (index.size and index.dtype.kind not in "iu") or index.size != k:
                raise InvalidProblem(
                    f"{name} must be a list of {k} variables, got dtype {index.dtype} and shape {index.shape}; give "
                    "for each pair the index of z in first, the index of w in second; integers lists integer variables"
                )
            if (outside := index[(index < 0) | (index >= n)]).size:
                raise InvalidProblem(f"{name} must number variables 0 to {n - 1}, got {outside[0]}")
            checks.fill(self, **{name: index.astype(np.int64)})
        low = self.program.lower[self.first] if self.lower is None else self.lower
        high = self.program.upper[self.first] if self.upper is None else self.upper
        lower, upper = checked_bounds(low, high, self.first.size)
        checks.fill(self, lower=lower, upper=upper)

    @classmethod
    def of_rows(
        cls, program: QuadraticProgram, columns: Any, M: AnyMatrix, q: ArrayLike
    ) -> EquilibriumProgram:
        """Return the problem with z = x_columns ⟂ w = M x + q; w is appended to x as new variables.

        Parameters
        ----------
        program : QuadraticProgram
        columns : array of int, shape (k,)
        M, q : array or sparse array, shape (k, n), and array, shape (k,)

        Examples
        --------
        >>> program = QuadraticProgram([[2, 0], [0, 0]], [-2, 1], lower=[-np.inf, 0])
        >>> EquilibriumProgram.of_rows(program, [1], [[-1, 1]], [0.5])  # 0 ≤ y ⟂ y − x + ½ ≥ 0
        EquilibriumProgram(n=3, 1 pair)
        """
        n, k = program.n, np.size(columns)
        rows = sp.csr_array(checks.rectangular_matrix(M, "M", k, n))
        right = -checked_vector(q, "q", k)
        P, G, A = (sp.csr_array(matrix) for matrix in (program.P, program.G, program.A))
        free = np.full(k, np.inf)
        wider = QuadraticProgram(
            sp.block_diag([P, sp.csr_array((k, k))], format="csr"),
            np.append(program.c, np.zeros(k)),
            sp.hstack([G, sp.csr_array((program.h.size, k))], format="csr"),
            program.h,
            sp.block_array([[A, None], [rows, -sp.eye_array(k)]], format="csr"),
            np.append(program.b, right),
            np.append(program.lower, -free),
            np.append(program.upper, free),
            program.constant,
        )
        return cls(wider, np.asarray(columns), np.arange(n, n + k))

    @property
    def pairs(self) -> int:
        """The number of pairs."""
        return int(self.first.size)

    @cached_property
    def all_cases(self) -> Cases:
        """The branches of each pair, shape (k,); if a z + b w = 0, z = 0 is a part of w = 0."""
        A = sp.csr_array(self.program.A)
        start = A.indptr[:-1][(np.diff(A.indptr) == 2) & (self.program.b == 0.0)]
        start = start[A.data[start] * A.data[start + 1] != 0.0]
        tied = set(map(frozenset, zip(A.indices[start], A.indices[start + 1], strict=True)))
        pairs = map(frozenset, zip(self.first, self.second, strict=True))
        is_separate = np.array([pair not in tied for pair in pairs], bool)
        ends = (self.lower, self.upper)
        lower, upper = (np.isfinite(end) & (is_separate | (end != 0.0)) for end in ends)
        return (FREE_CASE + LOW_CASE * lower + HIGH_CASE * upper).astype(np.uint8)

    def bounds(self, cases: Cases) -> tuple[Vector, Vector]:
        """Return the bounds of x common to all open branches; infeasible if some lower > upper."""
        lower, upper = np.array(self.program.lower), np.array(self.program.upper)
        z, w = self.first, self.second
        np.maximum.at(lower, z, np.where(cases == HIGH_CASE, self.upper, self.lower))
        np.minimum.at(upper, z, np.where(cases == LOW_CASE, self.lower, self.upper))
        np.maximum.at(lower, w, np.where(cases & HIGH_CASE, -np.inf, 0.0))
        np.minimum.at(upper, w, np.where(cases & LOW_CASE, np.inf, 0.0))
        return lower, upper

    @cached_property
    def has_convex_objective(self) -> bool:
        """True unless P is found to be indefinite."""
        try:
            refuse_nonconvex(self.program)
        except UnsupportedModel:
            return False
        return True

    @property
    def is_convex(self) -> bool:
        """True if the pieces are convex programs once integers are fixed."""
        return self.smooth is None and self.has_convex_objective

    @property
    def has_convex_relaxation(self) -> bool:
        """True if the objective is convex, and the smooth part, if any, has no term in it."""
        result = None if self.smooth is None else getattr(self.smooth.map, "result", None)
        has_no_term = result is not None and not (result.matrix[[0]].nnz or result.offset[0])
        return self.has_convex_objective and (self.smooth is None or has_no_term)

    @property
    def is_provable(self) -> bool:
        """True if bounds of pieces can be proved."""
        return self.is_convex and not self.integers.size

    def redundant_unknowns(self) -> Indices:
        """Return free unknowns that may be 0, because they are in affine rows only, with dependent columns.

        Each column is a linear combination of columns of other free unknowns, checked exactly. Multipliers of
        redundant equations are such unknowns. They have no bound, and no branch decides them.
        """
        program, smooth = self.program, self.smooth
        rows, others = [sp.csr_array(program.G), sp.csr_array(program.A)], [sp.csr_array(program.P)]
        if smooth is not None:  # an expression program, or else SCIP cannot read it
            if not hasattr(smooth.map, "levels"):
                return np.zeros(0, np.int64)
            result = smooth.map.result.matrix
            rows.append(result[1:, : program.n])
            others += [result[[0]]]
            others += [part.matrix for level in smooth.map.levels for part in level.arguments]
        is_free = np.isinf(program.lower) & np.isinf(program.upper) & (program.c == 0.0)
        used = np.concatenate([matrix.indices for matrix in others])
        is_free[used[used < program.n]] = False
        is_free[self.first[self.all_cases & (LOW_CASE | HIGH_CASE) > 0]] = False
        is_free[np.concatenate([self.second, self.integers])] = False
        free = np.flatnonzero(is_free)
        columns = sp.csr_array(sp.vstack(rows, format="csc")[:, free].T)
        if not 0 < columns.shape[0] * columns.shape[1] <= exact.MOST_ENTRIES:
            return free[:0]
        spanning = exact.rank_profile(exact.exact_rows(columns))[0]
        rows_of_span = exact.rational_rows(sp.csr_array(columns[spanning].T))
        zeros, is_movable = [exact.ZERO] * len(spanning), [True] * len(spanning)
        is_redundant = np.zeros(free.size, dtype=bool)
        for j in np.delete(np.arange(free.size), spanning):
            column = exact.rational(columns[[j]].toarray()[0])
            combination = exact.solved_nearby(rows_of_span, column, zeros, is_movable)
            is_redundant[j] = combination is not None
        return free[is_redundant]

    def answer(self, x: Vector) -> Vector | None:
        """Return x with the pairs solved, nearly at least, while all other variables keep their values.

        None unless each w is the only one in some affine or smooth equality, which then defines it.
        """
        point, z, w = np.array(x), self.first, self.second
        if (definitions := self._definitions(point)) is None:
            return None
        rows, unit = definitions

        def F(values: Vector) -> Vector:
            point[z] = values
            return self._equalities(point)[0][rows] / unit

        def jacobian(values: Vector) -> sp.csr_array:
            point[z] = values
            return sp.csr_array(sp.diags_array(1.0 / unit) @ self._equalities(point)[1][rows][:, z])

        problem = NonlinearProblem(F, jacobian, self.lower, self.upper)
        # The point of an early end may pass as well.
        try:
            answer = solve_nonlinear(
                problem, x[z], check_jacobian=False, prove_infeasibility=False, max_iterations=30
            )
        except LCPError:  # the functions are not defined at the start
            return None
        point[z], point[w] = answer.z, answer.w
        return point

    def with_slacks(self, x: Vector) -> Vector:
        """Return x with the w that equalities define."""
        point = np.array(x)
        if (definitions := self._definitions(point)) is not None:
            rows, unit = definitions
            point[self.second] = self._equalities(point)[0][rows] / unit
        return point

    def _definitions(self, x: Vector) -> tuple[Indices, Vector] | None:
        """Set w to 0 in x; return the equality that defines each w, and minus its coefficient; None if one has none."""
        x[self.second] = 0.0
        entries = sp.csr_array(self._equalities(x)[1][:, self.second])
        counts = np.diff(entries.indptr)
        alone = sp.csc_array(sp.diags_array((counts == 1).astype(np.float64)) @ entries)
        alone.eliminate_zeros()
        if (np.diff(alone.indptr) == 0).any():
            return None
        first = alone.indptr[:-1]
        return alone.indices[first].astype(np.int64), -alone.data[first]

    def _equalities(self, x: Vector) -> tuple[Vector, sp.csr_array]:
        """Return the residuals of the equalities, affine and smooth ones, and their derivatives."""
        A, b, smooth = sp.csr_array(self.program.A), self.program.b, self.smooth
        if smooth is None:
            return A @ x - b, A
        is_equality = smooth.lower == smooth.upper
        value = (smooth.map.value(x)[1:] - smooth.lower)[is_equality]
        slopes = sp.csr_array(smooth.map.jacobian(x))[1:][is_equality]
        return np.append(A @ x - b, value), sp.csr_array(sp.vstack([A, slopes]))

    def distances(self, x: Vector) -> Vector:
        """Return the distance of x from the three branches of each pair, shape (3, k); ∞ for a missing branch."""
        z, w = x[self.first], x[self.second]
        below, above = self.lower - z, z - self.upper
        between = np.maximum(np.abs(w), np.maximum(below, above))
        return np.array([np.maximum(np.abs(below), -w), between, np.maximum(np.abs(above), w)])

    def violations(self, x: Vector) -> Vector:
        """Return the complementarity violation of each pair at x, shape (k,)."""
        return self.distances(x).min(axis=0)

    def nearest(self, x: Vector, cases: Cases) -> Cases:
        """Return the open branch of each pair that is nearest to x, shape (k,)."""
        choices = np.array(CASES, dtype=np.uint8)
        is_closed = (cases & choices[:, None]) == 0
        return choices[np.argmin(np.where(is_closed, np.inf, self.distances(x)), axis=0)]

    def objective(self, x: Vector) -> float:
        """Return ½ xᵀP x + cᵀx + constant, plus f(x) if there is a smooth part."""
        smooth = 0.0 if self.smooth is None else float(self.smooth.map.value(x)[0])
        return self.program.objective(x) + smooth

    def objective_size(self, x: Vector) -> float:
        """Return Σ |c_j x_j| + ½ |xᵀP x| + |constant| + |objective|, the reference of a gap.

        If the objective is not convex, it is at least 1 % of `size_of_data`. All terms may be 0 at x, and SCIP's bound
        of the optimum 0 has a rounding error.
        """
        parts = (0.5 * (x @ (self.program.P @ x)), self.program.constant, self.objective(x))
        size = float(np.abs(self.program.c * x).sum()) + sum(abs(float(part)) for part in parts)
        return size if self.has_convex_objective else max(size, LEAST_SHARE * self.size_of_data)

    @cached_property
    def size_of_data(self) -> float:
        """Σ |c_j| X_j + ½ Xᵀ|P|X, X_j the least |d_i/c_ij| ≠ 0 of the rows and bounds: the unit of x_j in the data."""
        rows, X = self.program.constraints, np.full(self.program.n, np.inf)
        entries = sp.coo_array(rows.matrix)
        limits = np.abs(rows.limit[entries.row] / entries.data)
        is_unit = np.isfinite(limits) & (limits > 0.0)
        np.minimum.at(X, entries.col[is_unit], limits[is_unit])
        X[np.isinf(X)] = 0.0
        return float(np.abs(self.program.c) @ X + 0.5 * (X @ (abs(self.program.P) @ X)))

    def excess(self, x: Vector) -> float:
        """Return the largest violation at x: rows relative to their terms, pairs and integers absolute."""
        excess = [self.excess_of_rows(x), self.violations(x), np.abs(x - np.rint(x))[self.integers]]
        if self.smooth is not None:
            value, slopes = self.smooth.map.value(x), abs(self.smooth.map.jacobian(x))
            ends = np.nan_to_num(np.abs([self.smooth.lower, self.smooth.upper]), posinf=0.0)
            terms = ends.max(axis=0) + np.abs(value[1:]) + (slopes @ np.abs(x))[1:]
            missed = np.maximum(self.smooth.lower - value[1:], value[1:] - self.smooth.upper)
            excess.append(missed / np.where(terms > 0.0, terms, 1.0))
            excess.append(np.where(np.isfinite(value), 0.0, np.inf))
        worst = float(np.concatenate(excess).max(initial=0.0))
        return math.inf if math.isnan(worst) else worst

    def excess_of_rows(self, x: Vector) -> Vector:
        """Return the violation of each row at x relative to its terms d_i and c_ij x_j."""
        rows = self.program.constraints
        missed = rows.excess(x)
        sizes = largest_in_rows(sp.csr_array(rows.matrix.multiply(np.abs(x))))
        sizes = np.where(np.diff(rows.matrix.indptr) > 0, sizes, rows.own_sizes)
        terms = np.maximum(np.nan_to_num(np.abs(rows.limit), posinf=0.0), sizes)
        return np.where(missed > 0.0, missed / np.where(terms > 0.0, terms, 1.0), 0.0)

    def __repr__(self) -> str:
        return f"EquilibriumProgram(n={self.program.n}, {self.pairs} pair{'' if self.pairs == 1 else 's'})"
