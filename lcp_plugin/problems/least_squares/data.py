"""Least squares within bounds: checked unscaled data, and the problem scaled for a method.

Residuals and gradients come with bounds of their rounding errors.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core import checks
from ...core.checks import AnyMatrix, Array, BoolVector, Vector, read_only
from ...core.entries import clip
from ...core.errors import InvalidOption, InvalidProblem
from ...core.kernels.floats import EPSILON, OUTWARD, TINY
from ...core.names import shared_labels
from ...core.problem import Problem
from ...core.rounding import compensated_product, gamma
from ...judges.lcp import RAN_AWAY
from ...systems.equilibration import power_of_two

MAX_DENSE_ENTRIES = 10**6  # of A: dense copies cost little
LARGEST_SCALE = 500  # exponent of a scale, so that squares of scales are in range
SQUARED_RANGE = 1e-130, 1e145  # of a largest entry: squares, also of rounding errors, are doubles
OF_BOUNDS = "nearest_to_zero", "bounds_per_column"  # properties that depend on them


class BoundedLeastSquares(Problem):
    """Minimize ½ Σ weights_i (A x − b)_i² + ½ ridge ‖x‖² + Σ l1_j |x_j| over lower ≤ x ≤ upper.

    With l1 > 0 and ``lower=-inf`` it is the lasso, with an additional ridge the elastic net.

    Parameters
    ----------
    A : array or sparse array, shape (m, n)
        Real, finite. An array of float64 and a canonical CSR array are used without a copy.
    b : array, shape (m,)
    lower, upper : scalar or array, shape (n,)
        0 and ∞ by default; 1e20 and beyond means none.
    weights : array, shape (m,), or None
        ≥ 0; None means 1.
    ridge : float
        ≥ 0.
    l1 : number or array, shape (n,)
        ≥ 0; 0 leaves a column, such as an intercept, without this penalty. If every column has a penalty of at least
        ‖AᵀWb‖∞ and 0 lies within its bounds, x = 0 is the solution.

    Raises
    ------
    InvalidProblem, InvalidOption
        If the data do not define such a problem.

    Examples
    --------
    >>> from lcp_plugin import solve
    >>> solve(BoundedLeastSquares([[1, 0], [0, 1]], [3, -0.5], lower=-np.inf, l1=1.0)).x
    array([2., 0.])

    Attributes
    ----------
    is_sparse, is_dense : bool
        Whether A is a sparse array, or an ndarray.
    """

    axes = "A ax", "b a", "weights a", "l1 x", "lower x", "upper x"
    matrix_names, vector_names = ("A", "weights", "ridge"), ("b", "l1", "lower", "upper")
    other_names, start_name = (), "x0"

    def __init__(
        self,
        A: AnyMatrix,
        b: ArrayLike,
        *,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = np.inf,
        weights: ArrayLike | None = None,
        ridge: float = 0.0,
        l1: ArrayLike = 0.0,
    ) -> None:
        shared_labels(self.axes, locals())
        self.A = _checked_matrix(A)
        self.is_dense = isinstance(self.A, np.ndarray)
        self.is_sparse = not self.is_dense
        m, n = self.shape = self.A.shape
        need = f"b must be a vector of length {m}, an entry per row of A"
        if getattr(b, "ndim", 1) == 2:
            batch = "solve_batch(BoundedLeastSquares(A, b[:, 0]), b.T)"
            need += f" (for many right-hand sides: {batch})"
        self.b = checks.checked_vector(b, "b", m, need=need)
        self.lower, self.upper = checks.checked_bounds(lower, upper, n)
        self.weights = None
        if weights is not None:
            self.weights = _nonnegative(checks.checked_vector(weights, "weights", m), "weights")
        if not checks.is_number(ridge) or not 0.0 <= ridge < np.inf:
            raise InvalidOption(f"ridge must be a finite number ≥ 0, got {ridge!r}")
        self.ridge = float(ridge)
        self._check_range("A", self.A.data if self.is_sparse else self.A, "A and b")
        self._check_range("b", self.b, "A and b")
        self.l1 = _nonnegative(checks.checked_bound(l1, "l1", n), "l1")

    def __repr__(self) -> str:
        kind = "dense" if self.is_dense else "sparse"
        penalty = ", l1" if self.l1.any() else ""
        m, n = self.shape
        return f"BoundedLeastSquares({m} rows, {n} columns, {kind}{penalty})"

    def _check_range(self, name: str, entries: Array, what: str) -> None:
        """Raise InvalidProblem if squares of the largest entries, or of √weights, leave the range of doubles."""
        if not self.is_in_range(entries.ravel()):
            largest = np.abs(entries).max() * self._largest_root
            raise InvalidProblem(
                f"the largest entry of {name} (with weights) is {largest:.3g}, whose square is out of range; divide "
                f"{what} by a number that brings it near 1"
            )

    def is_in_range(self, entries: Vector) -> Any:
        """Return whether squares of the largest entry, or of √weights, of each row are in the range of doubles."""
        largest = np.abs(entries).max(-1, initial=0.0) * self._largest_root
        least, most = SQUARED_RANGE
        return (largest == 0.0) | ((largest >= least) & (largest <= most))

    @cached_property
    def _largest_root(self) -> float:
        return 1.0 if self.weights is None else max(1.0, float(self.root_weights.max(initial=0.0)))

    def with_vectors(  # type: ignore[override]
        self,
        b: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        l1: ArrayLike | None = None,
    ) -> BoundedLeastSquares:
        """Return the problem with other vectors, which shares the cached properties of A, weights and ridge.

        Parameters
        ----------
        b, lower, upper, l1 : arrays, shapes (m,), (n,), (n,), (n,), optional
            The present ones by default.

        Raises
        ------
        InvalidProblem, InvalidOption
            As the class.

        Examples
        --------
        >>> BoundedLeastSquares([[1, 0], [0, 1]], [3, -0.5]).with_vectors(b=[1, 2]).b
        array([1., 2.])
        """
        m, n = self.shape
        b = self.b if b is None else checks.checked_vector(b, "b", m)
        l1 = self.l1 if l1 is None else _nonnegative(checks.checked_bound(l1, "l1", n), "l1")
        self._check_range("b", b, "b, lower and upper")
        bounds = self.lower, self.upper
        if lower is not None or upper is not None:
            bounds = checks.checked_bounds(
                self.lower if lower is None else lower, self.upper if upper is None else upper, n
            )
        return self.stack(b, *bounds, l1)

    def stack(self, b: Vector, lower: Vector, upper: Vector, l1: Vector) -> BoundedLeastSquares:
        """Return the problem with other, checked vectors; an axis in front, shapes (B, m) and (B, n), makes a stack."""
        _ = self.row_units, self.root_weights, self.has_terms, self.terms  # shared from now on
        _ = self.nearest_to_zero, self.bounds_per_column
        of_bounds = () if lower is self.lower and upper is self.upper else OF_BOUNDS
        made = checks.copy_without(self, "scaled", *of_bounds)
        made.b, made.lower, made.upper, made.l1 = b, lower, upper, l1
        return made

    @property
    def is_small(self) -> bool:
        """True if m · n is so small that dense copies are cheap."""
        return self.shape[0] * self.shape[1] <= MAX_DENSE_ENTRIES

    @cached_property
    def has_terms(self) -> BoolVector:
        """Mask of the rows of A that may have entries, shape (m,)."""
        return np.asarray(np.diff(self.A.indptr) > 0 if self.is_sparse else self.A.any(axis=1))

    @cached_property
    def sizes(self) -> Any:
        """|A|."""
        return abs(self.A)

    @cached_property
    def row_units(self) -> Vector:
        """Sizes of the rows of A with columns of unit length, 1 for an empty one, shape (m,)."""
        unit = self.sizes @ (1.0 / self.column_scales)
        return np.where(unit > 0.0, unit, 1.0)

    @cached_property
    def terms(self) -> tuple[int, int]:
        """Largest number of terms in a row sum, and in a column sum."""
        A, (m, n) = self.A, self.shape
        if not self.is_sparse:
            return n, m
        of_columns = np.bincount(A.indices, minlength=1)
        return int(np.diff(A.indptr).max(initial=0)), int(of_columns.max())

    @cached_property
    def nearest_to_zero(self) -> Vector:
        """The point of [lower, upper] nearest to 0, shape (n,)."""
        return read_only(clip(0.0, self.lower, self.upper))

    @cached_property
    def bounds_per_column(self) -> Any:
        """Number of finite bounds of each column, shape (n,)."""
        return np.isfinite(self.lower).astype(int) + np.isfinite(self.upper)

    def checked_start(self, x0: ArrayLike) -> Vector:
        """Return the start within the bounds, shape (n,); raise InvalidOption if x0 is not a finite vector."""
        start = checks.vector_option(x0, "x0", self.shape[1], may_be_number=True)
        return np.clip(start, self.lower, self.upper)

    def product(self, x: Vector) -> Vector:
        """Return A x."""
        return np.asarray(self.A @ x)

    def apply_transpose(self, y: Vector) -> Vector:
        """Return Aᵀy."""
        return np.asarray(self.A.T @ y)

    def apply_weights(self, y: Vector) -> Vector:
        """Return weights · y."""
        return y if self.weights is None else self.weights * y

    def cost(self, x: Vector, residual: Vector) -> Any:
        """Return the objective value at x, given its residual A x − b; shape (B,) for a stack."""
        with np.errstate(all="ignore"):  # of an x too large to be squared
            penalty = self.ridge * np.vecdot(x, x) if self.ridge > 0.0 else 0.0
            squares = np.vecdot(self.apply_weights(residual), residual)
            return 0.5 * (squares + penalty) + np.vecdot(self.l1, np.abs(x))

    @cached_property
    def weighted_matrix(self) -> Any:
        """Return √weights A, an ndarray or a CSR array."""
        if self.weights is None:
            return self.A
        if self.is_sparse:
            return sp.csr_array(sp.diags_array(self.root_weights) @ self.A)
        return self.root_weights[:, None] * self.A

    @cached_property
    def column_scales(self) -> Vector:
        """Powers of two near the lengths of the columns of (√weights A; √ridge I), 1 for an empty one, shape (n,)."""
        lengths = np.zeros(self.shape[1])
        if self.shape[0]:
            sizes = abs(self.weighted_matrix)
            largest = sizes.max(axis=0)
            unit = power_of_two(largest.toarray() if self.is_sparse else largest, LARGEST_SCALE)
            squares = (sizes * (1.0 / unit)) ** 2  # which do not vanish
            lengths = unit * np.sqrt(squares.sum(axis=0))
        return read_only(power_of_two(np.hypot(lengths, np.sqrt(self.ridge)), LARGEST_SCALE))

    @cached_property
    def normal_equations(self) -> tuple[Vector, Vector]:
        """√W A by columns of about unit length, dense, shape (m, n), and AᵀWA + ridge in these units, shape (n, n)."""
        A = self.weighted_matrix
        A = (A.toarray() if self.is_sparse else A) / self.column_scales
        gram = A.T @ A
        gram.flat[:: len(gram) + 1] += self.ridge / self.column_scales / self.column_scales
        return A, gram

    @cached_property
    def scaled(self) -> ScaledLeastSquares:
        """The problem as the methods scale it."""
        return ScaledLeastSquares(self)

    @cached_property
    def root_weights(self) -> Vector:
        """√weights, shape (m,)."""
        return np.ones(self.shape[0]) if self.weights is None else np.sqrt(self.weights)


class ScaledLeastSquares:
    """Problem scaled to columns of about unit length and b of about unit size.

    That is min ½‖A x − b‖² + ½ Σ ridge x² + Σ l1 |x|, the last of which is linear in an orthant: min … + linearᵀx.

    Parameters
    ----------
    problem : BoundedLeastSquares

    Attributes
    ----------
    lower, upper, ridge, l1, linear : ndarray, shape (n,)
    has_kink : ndarray of bool, shape (n,)
        Mask of the columns with a penalty that may take both signs.
    has_no_corner : bool
        True if no column has a bound or a penalty.
    whole : ScaledLeastSquares
        The problem of which this is an orthant, or itself.
    b : ndarray, shape (m,)
    columns : ndarray, shape (n,)
        Divisors of the columns of A.
    size : float
        Divisor of b.
    """

    def __init__(self, problem: BoundedLeastSquares) -> None:
        self.problem, self.n = problem, problem.shape[1]
        self._root, self.columns = problem.root_weights, problem.column_scales
        sizes = self._root * problem.b * problem.has_terms, self.columns * problem.nearest_to_zero
        largest = np.abs(np.concatenate(sizes)).max(initial=0.0)
        self.size = float(power_of_two(largest, LARGEST_SCALE))
        self.lower, self.upper = self.from_caller(problem.lower), self.from_caller(problem.upper)
        self.b = self._root * problem.b / self.size
        self.ridge = problem.ridge / self.columns / self.columns
        # A column with this penalty is 0
        self.l1 = np.minimum(problem.l1 / self.columns / self.size, 1e300)
        self.linear = np.where(self.upper <= 0.0, -self.l1, self.l1)
        self.has_no_corner = not (problem.bounds_per_column.any() or self.l1.any())
        self.has_kink = (self.l1 > 0.0) & (self.lower < 0.0) & (self.upper > 0.0)
        self.whole = self
        self.nearest_to_zero = np.clip(0.0, self.lower, self.upper)

    def orthant(self, x: Vector, slope: Vector) -> ScaledLeastSquares:
        """Return the orthant problem: each column on the side of 0 of x, or in the descent direction if x is 0."""
        if not self.has_kink.any():
            return self
        falls = self.has_kink & ((x < 0.0) | ((x == 0.0) & (slope > 0.0)))
        part = copy(self)
        part.lower = np.where(self.has_kink & ~falls, 0.0, self.lower)
        part.upper = np.where(falls, 0.0, self.upper)
        part.linear = np.where(falls, -self.l1, self.linear)
        return part

    def from_caller(self, x: Vector) -> Vector:
        """Return x scaled."""
        return x * (self.columns / self.size)

    def to_caller(self, x: Vector) -> Vector:
        """Return the unscaled x, exactly at a bound if the scaled x is at this bound."""
        lower = np.where(self.has_kink & (self.lower == 0.0), 0.0, self.problem.lower)
        upper = np.where(self.has_kink & (self.upper == 0.0), 0.0, self.problem.upper)
        unscaled = np.clip(x * (self.size / self.columns), lower, upper)
        return np.where(x <= self.lower, lower, np.where(x >= self.upper, upper, unscaled))

    def product(self, x: Vector) -> Vector:
        """Return A x."""
        return self._root * self.problem.product(x / self.columns)

    def apply_transpose(self, y: Vector) -> Vector:
        """Return Aᵀy."""
        return self.problem.apply_transpose(self._root * y) / self.columns

    def matrix(self, *, is_dense: bool) -> Any:
        """Return A, an ndarray or a CSR array."""
        A = self.problem.weighted_matrix
        if self.problem.is_dense:
            return A / self.columns
        A = sp.csr_array(A @ sp.diags_array(1.0 / self.columns))
        return A.toarray() if is_dense else A

    def rows(self, *, is_dense: bool) -> tuple[Any, Vector]:
        """Return A and b with a row √ridge_j x_j = 0 per column with a ridge."""
        A = self.matrix(is_dense=is_dense)
        if not self.ridge.any():
            return A, self.b
        root = np.sqrt(self.ridge)
        b = np.append(self.b, np.zeros(self.n))
        if isinstance(A, np.ndarray):
            return np.vstack([A, np.diag(root)]), b
        return sp.csr_array(sp.vstack([A, sp.diags_array(root)])), b


def _nonnegative(vector: Vector, name: str) -> Vector:
    """Return the vector; raise InvalidProblem unless its entries are finite and ≥ 0."""
    is_right = (vector >= 0.0) & (vector < np.inf)
    if not is_right.all():
        i, what = int(np.argmin(is_right)), "column" if name == "l1" else "row"
        fault = f"{name}[{i}] = {vector[i]}; 0 leaves a {what} out"
        raise InvalidProblem(f"{name} must be finite and ≥ 0, but {fault}")
    return vector


def _checked_matrix(A: AnyMatrix) -> Any:
    matrix = checks.rectangular_matrix(A, "A", None, None, is_copied=False)
    is_by_columns = isinstance(matrix, np.ndarray) and not matrix.flags.c_contiguous
    is_kept = not is_by_columns or (matrix.flags.f_contiguous and matrix.size > MAX_DENSE_ENTRIES)
    return matrix if is_kept else read_only(np.array(matrix, order="C"))


Ball = tuple[Vector, Vector]
"""Values and radii: the exact values lie within."""

NO_ROWS = np.empty(0)


class Enclosures:
    """Residuals and gradients of a problem with bounds of their rounding errors.

    Vectors of a stack (`BoundedLeastSquares.stack`) have an axis in front, shape (B, m) or (B, n).

    Parameters
    ----------
    problem : BoundedLeastSquares

    Attributes
    ----------
    reference : float
        ‖AᵀWb‖∞ in units in which columns have about unit length. If AᵀWb is 0, of the gradient at the
        point of [lower, upper] nearest to 0; if that is 0 as well, that point is a solution.
    """

    def __init__(self, problem: BoundedLeastSquares) -> None:
        self.problem = problem

    def cost_above(self, x: Vector) -> Any:
        """Return an upper bound of the cost of x."""
        value, radius = self.residual(x)
        return self.problem.cost(x, np.abs(value) + radius)

    @cached_property
    def shortest(self) -> Vector:
        """Shortest solution without bounds and l1, shape (n,)."""
        scaled = self.problem.scaled
        return scaled.to_caller(shortest_solution(*scaled.rows(is_dense=True)))

    def residual(self, x: Vector) -> Ball:
        """Return A x − b."""
        problem = self.problem
        size = apply_to(problem.sizes, np.abs(x)) + np.abs(problem.b)
        return apply_to(problem.A, x) - problem.b, _rounding(size, problem.terms[0])

    @cached_property
    def most_rounding(self) -> Vector:
        """Rounding errors of A x − b that the data explain, shape (…, m): of terms up to 2²⁰ times the terms at x°.

        The terms of rows are compared in units of the rows of A, with columns of unit length.
        """
        problem = self.problem
        size, unit = apply_to(problem.sizes, np.abs(problem.nearest_to_zero)), problem.row_units
        largest = ((size + np.abs(problem.b)) / unit).max(-1, keepdims=True, initial=0.0)
        return gamma(2 * problem.terms[0] + 8) * RAN_AWAY * unit * largest

    def explained(self, x: Vector, residual: Ball) -> Ball:
        """Return A x − b with its rounding errors as far as the data explain them; sharply if x ran away."""
        (value, radius), most = residual, self.most_rounding
        if x.ndim == 1 and (radius > most).any():
            value = compensated_product(sp.csr_array(self.problem.A), x, -self.problem.b)[0]
            if self.problem.is_small:  # nearly dependent columns have such solutions
                most = np.maximum(most, 4.0 * self.residual(self.shortest)[1])
        return value, np.minimum(radius, most)

    def gradient(self, x: Vector, residual: Ball) -> Ball:
        """Return AᵀW(A x − b) + ridge x."""
        value, radius = self.apply_transpose(*residual)
        if not self.problem.ridge > 0.0:
            return value, radius
        added = self.problem.ridge * x
        value = value + added
        rounding = 4.0 * EPSILON * (np.abs(value) + np.abs(added))
        return value, OUTWARD * (radius + rounding + TINY * (x != 0.0))

    def gradient_at(self, x: Vector, y: Vector) -> Ball:
        """Return AᵀWy + ridge x."""
        return self.gradient(x, (y, NO_ROWS))

    def apply_transpose(self, y: Vector, radius: Vector) -> Ball:
        """Return AᵀWy for a y known up to radius; an empty radius means that y is exact."""
        problem = self.problem
        weighted, sizes, terms = problem.apply_weights(y), problem.sizes.T, problem.terms[1]
        value, size = apply_to(problem.A.T, weighted), apply_to(sizes, np.abs(weighted))
        unsure = OUTWARD * apply_to(sizes, problem.apply_weights(radius)) if radius.size else 0.0
        return value, _rounding(size + unsure, terms) + unsure

    @cached_property
    def reference(self) -> float:
        """The unit of residuals; see the class."""
        problem, start = self.problem, self.problem.nearest_to_zero
        value = problem.apply_transpose(problem.apply_weights(problem.b))
        if not value.any():
            value = self.gradient(start, self.residual(start))[0]
        return float((np.abs(value) / problem.column_scales).max(initial=0.0))


def _rounding(size: Vector, terms: int) -> Any:
    """Return bounds of the rounding errors of B v, from |B||v| and the number of terms in a row."""
    return gamma(2 * terms + 8) * OUTWARD * size + (2 * terms + 8) * TINY * (size > 0.0)


def shortest_solution(A: Vector, b: Vector) -> Vector:
    """Return the shortest x of least ‖A x − b‖; singular values below max(m, n) ε of the largest are 0."""
    from scipy.linalg import lstsq

    return lstsq(A, b, max(A.shape) * EPSILON, check_finite=False, lapack_driver="gelsy")[0]


def apply_to(B: AnyMatrix, v: Vector) -> Vector:
    """Return B v, for each row of v if v has two axes."""
    return B.dot(v) if v.ndim == 1 else v @ B.T
