"""The nonlinear complementarity problem: callables and bounds, checked where they are called.

A derivative by differences moves columns that share no row together (Curtis, Powell, Reid 1974,
doi:10.1093/imamat/13.1.117).

The criterion is the criterion of the LCP that F′(x) defines at x: x is SOLVED if it passes the criterion of LCPs
(:mod:`lcp_plugin.judges.lcp`) for M = F′(x), q = F(x) − F′(x) x and the bounds, with F(x) for w. As for an LCP, each
x_i is first moved to a bound whose distance is at most the step −F_i/d_i; F and F′ are evaluated again there, and the
better of the two points is returned. A row with an infinite slope (√x at 0) counts with the slope 1. For an affine F
these are the tests of the LCP.

Three clauses are added, because the linearization is not F, and because F(x) is not summed more accurately:

- The reference is also at most the residual of F(z°), if that is defined and not 0: otherwise the reference grows
  without limit as x diverges. If z° solves a component of the linearization, ‖x − z°‖∞ takes the place of the residual
  at z°: F = x (x − 1) (x + 2) has the solution 1, where z° = 0 solves the linearization.
- No unknown x_j off its bounds moves on. Let s and t be the Newton steps from x and from x + s, both with F′(x) on the
  rows off their bounds: |t_j| is at most |s_j|/3. At a simple root it is far less, at a double root 0.25 |s_j|, at a
  triple root 0.3 |s_j|; if F tends to 0 as x diverges it is 1/e and more, with any offset of x_j. Steps below half of
  the digits of x_j, and steps that rounding errors of F make, do not count. Rounding errors made s_j if the Newton step
  from 4096 times the larger of |s_j| and |t_j| leads back by half of the way: there F is linear, and x is next to its
  root. `moves` takes two further values of F at most.
  Without a jacobian, F′(x) is then computed by central differences with longer steps, which see weak slopes.
  Nor may x_j alone reduce Σ (F_i/d_i)² most by an outward step above x_j/64, nor may rounding hide that F depends
  on x_j. Three such points end a run from a start.
- 2⁻⁵² T_i/d_i, a rounding error of F_i/d_i, is at most max(tolerance, 10⁻⁸) times the reference. Otherwise two
  contradictory rows become zero by rounding as x diverges.

A point whose multiplier diverges, as at a cusp of the constraints, passes if all rows are zero up to rounding there.

For PRECISION_LIMIT, the rounding error of F_i is measured: x moves by a few roundings, or as far as F_i needs to
change. The difference F(x + δ) − F(x) − F′(x) δ is then rounding error. It exceeds 2⁻⁵² T_i if F contains constants
larger than x, as eˣ − 1 does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from functools import cached_property
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...core import checks
from ...core.checks import AnyMatrix, BoolVector, Vector, derived_property, read_only
from ...core.entries import (
    IntVector,
    all_finite,
    clip,
    largest_in_rows,
    largest_products,
    max_norm,
    residual_scales,
)
from ...core.errors import InvalidProblem
from ...core.kernels.floats import EPSILON, HALF_OF_DIGITS, LARGEST
from ...core.lcp import LCP
from ...core.matrix import Matrix
from ...core.names import checked_names
from ...core.problem import Problem
from ...core.problem_classes import Door
from ...core.rounding import ROUNDING
from ...core.settings import Settings
from ...core.structure import components_of_dense, connected_components
from ...core.tuning import CHEAP_UP_TO
from ...judges.certificate import Certificate
from ...judges.lcp import Measured, RowData, RowsAtPoint, bound_residual
from ...methods.small import SMALL_SPARSE
from ...systems.factors import Factor, factorize

SMALLEST_TOLERANCE = 1e-14  # relative residuals below it are rounding
STEEPER = 60  # slopes 4^k that are tried in a row with an infinite slope
LONG_STEP = 2.0**-17  # about the cube root of EPSILON: central differences
STEP = float(np.sqrt(EPSILON))  # of max(|x_i|, 1): rounding and curvature take about as many digits


class Differences:
    """Forward differences on one pattern.

    Parameters
    ----------
    pattern : csc_array, shape (n, n)
    groups : array of int, shape (n,)
        The number of the group with which each column is moved.
    """

    def __init__(self, pattern: sp.csc_array, groups: NDArray[np.int32]) -> None:
        self.pattern, self.groups = pattern, groups
        columns = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))
        of_entries = groups[columns]
        ends = np.cumsum(np.bincount(of_entries))[:-1]
        places = np.split(np.argsort(of_entries, kind="stable"), ends)
        self._parts = [(at, pattern.indices[at], columns[at]) for at in places]

    @classmethod
    def on(cls, pattern: sp.csc_array | None, n: int) -> Differences:
        """Return the differences on a pattern; None means all entries.

        Raises
        ------
        InvalidProblem
            If the pattern is None and n > 1000.
        """
        if pattern is None:
            if n > CHEAP_UP_TO:
                raise InvalidProblem(
                    f"differences on all places need n ≤ {CHEAP_UP_TO}, got {n}; give a jacobian, or a pattern"
                )
            return cls(sp.csc_array(np.ones((n, n))), np.arange(n, dtype=np.int32))
        met: list[set[int]] = [set() for _ in range(n)]  # groups of the columns that meet a row
        groups = np.zeros(n, dtype=np.int32)
        for j in range(n):
            rows = pattern.indices[pattern.indptr[j] : pattern.indptr[j + 1]]
            taken = set().union(*(met[i] for i in rows))
            groups[j] = group = next(k for k in count() if k not in taken)
            for i in rows:
                met[i].add(group)
        return cls(pattern, groups)

    def at(
        self,
        F: Callable[[Vector], Vector],
        x: Vector,
        value: Vector,
        lower: Vector,
        upper: Vector,
        step: Vector | None = None,
    ) -> Any:
        """Return the derivative at x, dense if the pattern is full, given F(x), by steps within the bounds.

        If F is not defined on one side of x, the step goes to the other side. Entries that neither side gives are
        NaN.
        """
        pattern, step = self.pattern, _steps(x, lower, upper) if step is None else step
        derivative, ends = np.full(pattern.indices.size, np.nan), (x + step, x - step)
        for k, (places, rows, columns) in enumerate(self._parts):
            for end in ends:
                moved = read_only(np.where(self.groups == k, end, x))
                quotients = (F(moved) - value)[rows] / (moved - x)[columns]
                if end is ends[1]:
                    known = derivative[places]
                    quotients = np.where(np.isfinite(known), known, quotients)
                derivative[places] = quotients
                if all_finite(quotients):
                    break
        if derivative.size == math.prod(pattern.shape):
            return derivative.reshape(pattern.shape).T
        entries = derivative, pattern.indices, pattern.indptr
        return sp.csr_array(sp.csc_array(entries, shape=pattern.shape))


def _steps(x: Vector, lower: Vector, upper: Vector) -> Vector:
    """Return the step of each unknown: away from 0, or to the farther bound if a bound is close."""
    length = STEP * np.maximum(np.abs(x), 1.0)
    above, below = upper - x, x - lower
    sign = np.where(x < 0.0, -1.0, 1.0)
    ahead, behind = np.where(sign > 0.0, above, below), np.where(sign > 0.0, below, above)
    return np.where((ahead < length) & (behind > ahead), -sign, sign) * length


class UndefinedDerivativeError(InvalidProblem):
    """F has no finite derivative at a point."""


class Evaluations(NamedTuple):
    """Calls of F, also for differences, derivatives F′, and calls of F that returned NaN or infinities."""

    F: int
    jacobian: int
    undefined: int


class NonlinearProblem(Problem):
    """Find x with lower ≤ x ≤ upper and F(x) complementary to it.

    For every row i: F_i(x) ≥ 0 if x_i = lower_i, F_i(x) = 0 if lower_i < x_i < upper_i, and F_i(x) ≤ 0 if x_i =
    upper_i. A row with bounds (−∞, ∞) is the equation F_i(x) = 0. The callables are first evaluated by ``solve``.

    Parameters
    ----------
    F : callable
        ``F(x)`` returns shape (n,) for x of shape (n,), which is read-only. F should be smooth near the solution. F
        may return NaN or infinities at points where it is not defined: steps that lead there are shortened. Exceptions
        raised by F propagate.
    jacobian : callable, optional
        ``jacobian(x)`` returns the derivative, a sparse array or an ndarray of shape (n, n). By default the derivative
        is computed by forward differences on `pattern`, with columns that share no row in one evaluation. Differences
        have about half of the digits, and assume that every x_i has size 1 at least: choose the unit of x accordingly,
        or pass a jacobian. ``from_jax`` and ``from_casadi`` compute it.
    lower, upper : scalar or array, shape (n,)
        Bounds of x, lower ≤ upper; ±1e20 and beyond means none, as ±∞ does.
    pattern : sparse array, shape (n, n), optional
        Sparsity pattern of the derivative: the stored entries, with any values. Only without `jacobian`;
        without both the pattern is full, up to n = 1000.
    names : sequence of str, or a pair of sequences, optional
        Names that messages use: of the unknowns and their rows, or a pair, names of the rows and of the unknowns.

    Raises
    ------
    InvalidProblem
        If the arguments do not define such a problem.

    Examples
    --------
    >>> import numpy as np
    >>> problem = NonlinearProblem(lambda x: x**3 - np.array([8.0, -1.0]), lower=[0, 0])
    >>> problem
    NonlinearProblem(n=2, differences)
    >>> problem.linearize([2.0, 0.0]).M.diagonal().round(5)
    array([12.,  0.])
    """

    q: Any = 0.0  # that `with_q` adds to F
    origin: Any = None  # of a variational inequality
    #: Function that returns the program of its affine rows, which may be infeasible.
    affine_part: Any = None
    #: Calls of F, derivatives, and calls without a finite value, if a run counts them.
    counts: Any = None
    from_jax, from_casadi = Door(is_static=True), Door(is_static=True)

    matrix_names, start_name = (), "x0"

    def __init__(
        self,
        F: Callable[[Vector], ArrayLike],
        jacobian: Callable[[Vector], Any] | None = None,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = np.inf,
        pattern: Any = None,
        names: Any = None,
    ) -> None:
        for name, function in (("F", F), ("jacobian", jacobian)):
            if not callable(function) and (function is not None or name == "F"):
                hint = "; for a matrix and a vector there is LCP(M, q)" if name == "F" else ""
                raise InvalidProblem(
                    f"{name} must be callable as {name}(x), got {type(function).__name__}{hint}"
                )
        if not (jacobian is None or pattern is None):
            raise InvalidProblem("pattern is for differences, without a jacobian; leave one out")
        self.F, self.jacobian = F, jacobian
        self.pattern = None if pattern is None else _pattern(pattern)
        sizes = [np.shape(bound) for bound in (lower, upper) if np.ndim(bound)]
        sizes += [] if self.pattern is None else [self.pattern.shape[:1]]
        self.n: int | None = sizes[0][0] if sizes else None
        checked_names(names, self.n, self.n, are_pairs=True)
        bounds: Any = lower, upper  # numbers stay numbers until F gives the size
        self._bounds: tuple[Any, Any] = bounds
        self.lower: Vector = bounds[0]
        self.upper: Vector = bounds[1]
        self._user_names = names
        if self.n is not None:
            self._set_bounds(self.n)

    def _set_bounds(self, n: int) -> None:
        self.lower, self.upper = checks.checked_bounds(*self._bounds, n)
        self.names = checked_names(self._user_names, n, n, are_pairs=True)
        self.q = np.zeros(n)
        self._components: list[tuple[bytes, Any]] = [(b"", None)]  # copies that count share it

    def with_size(self, n: int) -> NonlinearProblem:
        """Return the problem with n unknowns, or a copy with vectors for scalar bounds.

        Raises
        ------
        InvalidProblem
            If the problem has another number of unknowns.
        """
        if self.n == n:
            return self
        if self.n is not None:
            raise InvalidProblem(f"the problem has {self.n} unknowns, and x has length {n}")
        sized = copy(self)
        sized.n = n
        sized._set_bounds(n)
        return sized

    def with_q(
        self, q: Any, *, lower: ArrayLike | None = None, upper: ArrayLike | None = None
    ) -> NonlinearProblem:
        """Return the problem of F(x) + q, with other bounds if the caller names them.

        Parameters
        ----------
        q : array, shape (n,)
        lower, upper : number or array, shape (n,), optional
        """
        q = checks.checked_vector(q, "q", self.n) if np.ndim(q) else q
        given = [value for value in (q, lower, upper) if value is not None]
        sizes = [np.size(value) for value in given if np.ndim(value)]
        if self.n is None and sizes:
            return self.with_size(sizes[0]).with_q(q, lower=lower, upper=upper)
        if self.jacobian is None and self.n is not None:
            _ = self.differences  # colored once for all q
        shifted = copy(self)
        # a proof belongs to the data of which it was made
        shifted.F, shifted.affine_part = lambda x: self.value(x) + q, None
        lower = self.lower if lower is None else lower
        upper = self.upper if upper is None else upper
        shifted._bounds = shifted.lower, shifted.upper = lower, upper  # type: ignore[assignment]
        if self.n is not None:
            shifted.lower, shifted.upper = checks.checked_bounds(lower, upper, self.n)
        return shifted

    def with_function_of(self, other: Any, name: str) -> NonlinearProblem:
        """Return the problem with the F of another problem, which errors call by a name.

        Parameters
        ----------
        other : NonlinearProblem
        name : str
        """
        if not isinstance(other, NonlinearProblem):
            need = f"{name} must be a NonlinearProblem, got {type(other).__name__}"
            raise InvalidProblem(f"{need}; return NonlinearProblem(F)")
        other = other.with_size(self.lower.size)
        return other.with_q(0.0, lower=self.lower, upper=self.upper)

    @property
    def nearest_to_zero(self) -> Vector:
        """z°, the point of the bounds nearest to 0, shape (n,)."""
        return clip(0.0, self.lower, self.upper)

    def counted(self, n: int) -> NonlinearProblem:
        """Return a copy with n unknowns that counts evaluations."""
        counting = copy(self.with_size(n))
        counting.counts = [0, 0, 0]
        return counting

    @np.errstate(all="ignore")  # F may be undefined at x: its value shows it
    def value(self, x: ArrayLike) -> Vector:
        """Return F(x), shape (n,), a read-only copy; NaN and infinities mean that F is undefined at x.

        Parameters
        ----------
        x : array, shape (n,)

        Raises
        ------
        InvalidProblem
            If F does not return a real vector of that length.
        """
        return self.evaluate(self._point(x))

    def evaluate(self, x: Vector) -> Vector:
        """Return :meth:`value` at a read-only vector, which is not copied; NumPy's warnings are off."""
        value: Any = self.F(x)
        if not checks.is_plain(value, x.size):
            need = f"F(x) must be a real vector of length {x.size} for x of shape ({x.size},)"
            value = checks.real_array(value, need)
            if value.shape != x.shape:
                raise InvalidProblem(f"{need}, got shape {value.shape}; return one number a row")
        if self.counts is not None:
            self.counts[0] += 1
            self.counts[2] += not all_finite(value)
        return read_only(value.copy())

    @np.errstate(all="ignore")
    def derivative(self, x: ArrayLike, value: Vector | None = None) -> Any:
        """Return F′(x), a CSR array or an ndarray, shape (n, n).

        Parameters
        ----------
        x : array, shape (n,)
        value : array, shape (n,), optional
            F(x), if already computed.

        Raises
        ------
        InvalidProblem
            If the derivative is not finite, or the callable returns another type or shape.
        """
        returned, name = self.call_jacobian(self._point(x), value)
        return _finite(returned, name, np.size(x))

    def call_jacobian(self, x: Vector, value: Vector | None) -> tuple[Any, str]:
        """Return F′(x), unchecked, and its name in errors."""
        if self.counts is not None:
            self.counts[1] += 1
        if self.jacobian is not None:
            returned = self.jacobian(x)
            is_array = type(returned) is np.ndarray or not sp.issparse(returned)
            return returned if is_array else sp.csr_array(returned), "jacobian(x)"
        sized, value = self.with_size(x.size), self.value(x) if value is None else value
        derivative = sized.differences.at(self.evaluate, x, value, sized.lower, sized.upper)
        return derivative, "the derivative of F by differences"

    @cached_property
    def differences(self) -> Differences:
        """The differences that compute F′ on the pattern."""
        return Differences.on(self.pattern, self.lower.size)

    @np.errstate(all="ignore")
    def linearize(self, x: ArrayLike, value: Vector | None = None) -> LCP:
        """Return the LCP with M = F′(x), q = F(x) − F′(x) x and the same bounds, which is the problem near x.

        A row with an infinite slope, as √x has at 0, gets a slope in x_i and 0 in all other unknowns: the least
        power of 4, at least 1, with which a Newton step in x_i does not change the sign of F_i. So Newton's method
        goes to a root of √x − 10⁻⁹ from below, and does not cycle.

        Parameters
        ----------
        x : array, shape (n,)
        value : array, shape (n,), optional
            F(x), if already computed.

        Raises
        ------
        InvalidProblem
            If F is not finite at x, or its derivative is NaN.
        """
        x = self._point(x)
        value, problem = self.value(x) if value is None else value, self.with_size(x.size)
        M = problem.slopes(x, value)
        q = problem.offset(x, value, M)
        return LCP(M, q, lower=problem.lower, upper=problem.upper, names=problem.names)

    def central_differences(self, x: Vector, value: Vector) -> Any:
        """Return F′(x) by longer steps on both sides, which see weak slopes that steps of half of the digits miss."""
        room = np.minimum(x - self.lower, self.upper - x)
        step = LONG_STEP * np.maximum(np.abs(x), 1.0)
        step = np.where(room > 0.0, np.minimum(step, room), step)
        data = self.evaluate, x, value, self.lower, self.upper
        return 0.5 * (self.differences.at(*data, step) + self.differences.at(*data, -step))

    def slopes(self, x: Vector, value: Vector) -> Any:
        """Return F′(x) as :meth:`linearize` uses it."""
        returned, name = self.call_jacobian(x, value)
        try:
            return _finite(returned, name, x.size)
        except UndefinedDerivativeError:
            return _finite(_replace_infinite_rows(self, x, value, returned), name, x.size)

    def offset(self, x: Vector, value: Vector, M: AnyMatrix) -> Vector:
        """Return F(x) − F′(x) x."""
        q: Vector = value - M.dot(x)
        if not all_finite(q):
            raise UndefinedDerivativeError("F(x) − F′(x) x overflows; start nearer to 0")
        return q

    def _point(self, x: ArrayLike) -> Vector:
        return checks.checked_vector(x, "x", self.n, allow_plus_infinity=True, allow_nan=True)

    def __repr__(self) -> str:
        how = "differences" if self.jacobian is None else "jacobian given"
        size = "any" if self.n is None else self.n
        return f"NonlinearProblem(n={size}, {how})"


def _finite(derivative: AnyMatrix, name: str, n: int) -> Any:
    """Return the checked derivative; UndefinedDerivativeError if only numbers are invalid."""
    try:
        return checks.rectangular_matrix(derivative, name, n, n)
    except InvalidProblem as error:
        if not (entries := _floats(derivative, n)).size or np.isfinite(entries).all():
            raise
        raise UndefinedDerivativeError(str(error)) from error


def _floats(derivative: AnyMatrix, n: int) -> Any:
    """Return the entries of a derivative of shape (n, n), none if it has another shape or type."""
    entries = derivative.data if sp.issparse(derivative) else np.asarray(derivative)
    fits = np.shape(derivative) == (n, n) and entries.dtype.kind == "f"
    return entries if fits else np.zeros(0)


def _replace_infinite_rows(
    problem: NonlinearProblem, x: Vector, value: Vector, M: AnyMatrix
) -> Any:
    """Return the derivative with diagonal rows for rows with an infinite entry."""
    n = x.size
    if not np.isinf(_floats(M, n)).any():
        return M
    is_sparse, M = sp.issparse(M), sp.coo_array(M)
    is_steep = np.zeros(n, dtype=bool)
    is_steep[M.row[np.isinf(M.data)]] = True
    slope = is_steep.astype(np.float64)
    for _ in range(STEEPER):
        step = np.where(is_steep, value / np.maximum(slope, 1.0), 0.0)
        there = np.clip(x - step, problem.lower, problem.upper)
        is_beyond = is_steep & (problem.value(there) * value < 0.0)
        if not is_beyond.any():
            break
        slope[is_beyond] *= 4.0
    kept = ~is_steep[M.row]
    rows = sp.coo_array((M.data[kept], (M.row[kept], M.col[kept])), shape=(n, n))
    levelled = sp.csr_array(rows) + sp.diags_array(slope)
    return sp.csr_array(levelled) if is_sparse else levelled.toarray()


def _pattern(pattern: AnyMatrix) -> sp.csc_array:
    """Return the stored entries by columns, each with the value 1."""
    if not sp.issparse(pattern):
        need = "pattern must be a sparse array of shape (n, n)"
        pattern = sp.coo_array(checks.real_array(pattern, need))
    if pattern.ndim != 2 or pattern.shape[0] != pattern.shape[1]:
        raise InvalidProblem(f"pattern must be square, shape (n, n), got {pattern.shape}")
    places = sp.coo_array(pattern)
    stored = sp.csc_array((np.ones(places.nnz), (places.row, places.col)), shape=places.shape)
    stored.sum_duplicates()
    return stored


def components_of_pattern(problem: NonlinearProblem, M: AnyMatrix) -> Any:
    """Return the connected component of each row of F′; None if all rows are connected.

    The components are kept for the next F′ of this pattern.
    """
    if isinstance(M, np.ndarray):
        if np.logical_and.reduce(M[:1], axis=None):
            return None
        key = (M != 0.0).tobytes()
    else:
        key = M.indptr.tobytes() + M.indices.tobytes()
    if key != problem._components[0][0]:
        is_dense = isinstance(M, np.ndarray)
        labels = components_of_dense(M) if is_dense else connected_components(Matrix(M))
        problem._components[0] = key, labels
    return problem._components[0][1]


def _newton_step(M: AnyMatrix, w: Vector, at: IntVector) -> tuple[Factor | None, Vector]:
    """Return the factor of the block of M in some rows, and the Newton step there; None and 0 if it is singular."""
    block = M[at[:, np.newaxis], at] if isinstance(M, np.ndarray) else M[at][:, at]
    factor = factorize(block)
    return factor, np.zeros(at.size) if factor is None else -factor.solve(w[at])


COMPUTED_TOGETHER = (
    *("M", "absolute", "q", "scale"),
    *("terms", "steps", "largest_step", "least_residual"),
)
REACHES = 4.0 ** np.arange(-25, 1)  # shares of x, from some roundings to x itself
SAMPLES = 5  # of the rounding error of each F_i
FAR_STEPS = 4096.0  # at which Newton's step leads back if rounding errors made it


class Linearization(RowData):
    """The problem near a point x: F(x), and on first use the LCP of F′(x) and its data of the criterion.

    F(x) is w, and no sums are computed in twice the precision.

    It is one class because all of its measures are measures of x.

    Parameters
    ----------
    problem : NonlinearProblem
    x : array, shape (n,)
        A copy is kept.
    """

    matrix = "F′"

    def __init__(self, problem: NonlinearProblem, x: Vector) -> None:
        self.problem, self.x = problem, read_only(x.copy())
        self.lower, self.upper = problem.lower, problem.upper
        self.value = problem.evaluate(self.x)
        self._measured: Measured | None = None
        self._is_small: bool | None = None
        self.run_sizes: tuple[float, float, float] | None = None  # in the units of a run
        self.lcp_steps: dict[float, Vector | None] = {}  # of a small problem, by shift

    def __getattr__(self, name: str) -> Any:
        """Return F′(x), dense if it has few rows, or another datum of the linearization; all are computed together.

        M, |M| (`absolute`), q = F(x) − F′(x) x, the scales d_i, T_i (`terms`), r(x) (`steps`), which is signed, its
        norm (`largest_step`) and that relative to the largest T_i/d_i, a lower bound of the relative residual
        (`least_residual`). It raises the errors of :meth:`NonlinearProblem.linearize`.
        """
        if name in COMPUTED_TOGETHER:
            M = self.problem.slopes(self.x, self.value)
            if self.x.size <= SMALL_SPARSE and not isinstance(M, np.ndarray):
                M = M.toarray()
            q, self.absolute = self.problem.offset(self.x, self.value, M), abs(M)
            self.M, self.q, self.terms = M, q, self.absolute.dot(np.abs(self.x)) + np.abs(q)
            self.scale = residual_scales(M.diagonal(), largest_in_rows(M))
            self.steps = self.steps_at(self)
            self.largest_step = max_norm(self.steps)
            self.least_residual = self.largest_step / max(max_norm(self.terms / self.scale), 1e-300)
        return object.__getattribute__(self, name)  # a property's own error, if it has raised one

    def steps_at(self, there: Linearization) -> Vector:
        """Return the residuals of another point in the scale of x, of a quotient that underflows 0."""
        return clip(there.value / self.scale, there.x - self.upper, there.x - self.lower)

    def at(self, x: Vector) -> Linearization:
        """Return the linearization at another point, with the same `at_origin`."""
        if np.logical_and.reduce(x == self.origin):
            return self.at_origin
        point = Linearization(self.problem, x)
        point.at_origin = self.at_origin
        return point

    @derived_property
    def at_origin(self) -> Linearization:
        """The linearization at z°, the point of the bounds nearest to 0; F need not be defined there."""
        nearest = self.problem.nearest_to_zero
        return self if (self.x == nearest).all() else Linearization(self.problem, nearest)

    @property
    def origin(self) -> Vector:
        """The point z°."""
        return self.at_origin.x

    @cached_property
    def labels(self) -> Any:
        """Connected component of each row; None if all rows are connected."""
        return components_of_pattern(self.problem, self.M)

    @cached_property
    def _linear_references(self) -> tuple[Vector, Vector]:
        """The references of the linearization."""
        return RowData.references.func(self)  # type: ignore[attr-defined]

    @cached_property
    def is_solved_at_origin(self) -> Any:
        """Mask of the rows whose component of the linearization z° solves."""
        return self._linear_references[1] == 0.0

    @cached_property
    def residual_at_origin(self) -> Vector:
        """The residual of F(z°) in the component of each row; ∞ if it is 0 or F is not defined there."""
        origin = self.at_origin.value
        residual = np.abs(self.residual(self.origin, origin))
        of_value = self.largest(np.where(np.isfinite(origin), residual, np.inf))
        return np.where(of_value > 0.0, of_value, np.inf)

    @cached_property
    def references(self) -> tuple[Vector, Vector]:
        """References as the docstring of this module defines them."""
        distance = self.largest(np.abs(self.x - self.origin))
        distance = np.maximum(distance, self.largest_slack_at_origin)
        least, most = (
            np.minimum(np.where(self.is_solved_at_origin, distance, end), self.residual_at_origin)
            for end in self._linear_references
        )
        return least, most

    def rows(self, z: Vector, w: Any = None) -> RowsAtPoint:
        """Return the values of all rows at z; a slack w that is known is F(x), without a bound of its rounding."""
        at = super().rows(z, w)
        return at if w is None else at._replace(rounding=np.zeros(z.size))

    def sharp_product(self, z: Vector) -> None:
        """Return None: F is not a sum."""

    def measure_at(self, z: Vector, w: Any, tolerance: float, absolute: float = 0.0) -> Measured:
        """Measure x; it passes only if also no unknown grows, and rounding errors of F are small."""
        measured = super().measure_at(z, w, tolerance, absolute)
        # Smaller rounding errors of F do not count, for any tolerance; z° has none
        limit, at = max(tolerance, 1e-8) * measured.by_row.reference * self.scale, measured.rows
        is_lost = (at.is_active & (limit > 0.0) & (EPSILON * at.terms > limit)).any()
        passes = measured.passes and not is_lost
        if passes and (absolute == 0.0 or (measured.by_row.high > absolute).any()):
            passes = not self.moves.any()
        return measured._replace(passes=passes)

    @derived_property
    def noise(self) -> Vector:
        """Estimate of the rounding error inside each F_i/d_i, shape (n,); NaN if F is not defined near x.

        It is the largest |F(x + δ) − F(x) − F′(x) δ|_i / d_i of five steps, the first of which is the least in
        `REACHES` that changes F_i: 1 − e⁻ˣ is constant next to a small x.
        """
        x, noise, left = self.x, np.zeros(self.x.size), np.full(self.x.size, SAMPLES)
        step = -self.residual(x, self.value)
        way = np.copysign(np.maximum(np.abs(x), np.abs(step)), step)
        left[step == 0.0] = 0
        for share in REACHES:
            near = np.clip(x + share * way, self.lower, self.upper)
            change = self.problem.value(near) - self.value
            error = np.abs(change - self.M @ (near - x)) / self.scale
            is_open = (left > 0) & ((change != 0.0) | (left < SAMPLES))
            noise, left = np.where(is_open, np.maximum(noise, error), noise), left - is_open
            if not left.any():
                break
        return noise

    def rounding_floor(self, terms: Vector, scale: Vector | None = None) -> Any:
        """Return the rounding level of each residual, with the rounding error inside F."""
        return super().rounding_floor(terms, scale) + self.noise

    @cached_property
    def lcp(self) -> LCP:
        """The problem with M = F′(x), q = F(x) − F′(x) x."""
        problem, M = self.problem, self.M
        return LCP(M, self.q, lower=problem.lower, upper=problem.upper, names=problem.names)

    @cached_property
    def is_defined(self) -> bool:
        """True if F and its derivative are finite at x."""
        if not all_finite(self.value):
            return False
        try:
            self.q  # noqa: B018
        except UndefinedDerivativeError:
            return False
        return True

    @property
    def violation(self) -> Vector:
        """Violation of the sign of each F_i, in its unit, shape (n,)."""
        x, w, problem = self.x, self.value, self.problem
        return np.maximum(w * (x > problem.lower), -w * (x < problem.upper))

    @derived_property
    def certificate(self) -> Certificate:
        """The certificate of x as a solution of the linearization, which ``derivative`` and ``explain`` use."""
        return Certificate.at(self.lcp, self.x, criterion=self, rows=self.rows_here)

    @cached_property
    def rows_here(self) -> RowsAtPoint:
        """Values of all rows at x."""
        return self.rows(self.x, self.value)

    def measure_by(self, settings: Settings) -> Measured:
        """Return the measure of x by the stopping criterion; without rows if a sufficient test accepts x."""
        if self._measured is None:
            goal, absolute = settings.goal, settings.absolute_tolerance
            bound = bound_residual(self, self.x, goal, self.residual_at_origin)
            is_sure = bound < math.inf and (self.largest_step < absolute or not self.moves.any())
            full = None if is_sure else self.measure_at(self.x, self.value, goal, absolute)
            self._measured = full or Measured(self.x, bound, passes=True)
        return self._measured

    def is_small(self, settings: Settings) -> bool:
        """Return whether the relative residual is at most the tolerance."""
        if self._is_small is None:
            goal, absolute = settings.goal, settings.absolute_tolerance
            is_open = self.least_residual <= max(goal, SMALLEST_TOLERANCE)
            is_open = is_open or self.largest_step <= absolute
            self._is_small = is_open and bool(self.measure_by(settings).residual <= goal)
        return self._is_small

    def passes(self, settings: Settings) -> bool:
        """Return whether x is SOLVED."""
        return self.is_small(settings) and bool(self.measure_by(settings).passes)

    def is_endless(self, settings: Settings) -> bool:
        """Return whether x would pass if no unknown moved on."""
        if not self.is_small(settings) or self.measure_by(settings).passes:
            return False
        fails = self.measure_by(settings).by_row.fails(settings.goal)
        return not fails.any() and bool(self.moves.any())

    def is_limited(self, settings: Settings) -> bool:
        """Return whether x fails only because of rounding, estimated by further values of F."""
        return bool(self.are_limited(self.measure_by(settings), settings.goal))

    @derived_property
    def relative(self) -> float:
        """The relative residual of x."""
        return float(self.residuals_at(self.x, self.rows_here, ROUNDING).worst)

    @cached_property
    def moves(self) -> BoolVector:
        """Mask of the unknowns that move on, as the docstring of this module defines them.

        F is evaluated at two further points at most and, without a jacobian, for one F′(x) by central differences.
        """
        return _moving_unknowns(self)


def _moving_unknowns(rows: Linearization) -> BoolVector:
    problem, x, n = rows.problem, rows.x, rows.x.size
    step, sizes = rows.value / rows.scale, np.abs(x)
    free = (step < x - rows.lower) & (step > x - rows.upper)  # others are at a bound, or nearly
    largest, at = rows.largest(sizes), free.nonzero()[0]
    least = HALF_OF_DIGITS * np.maximum(sizes, HALF_OF_DIGITS * largest)
    w, is_small = np.where(free, rows.value, 0.0), n <= CHEAP_UP_TO
    single = np.zeros(n) if is_small and not w.any() else _single_steps(rows, free)
    moves = free & (single * np.sign(x) > 2.0**-6 * np.maximum(sizes, 2.0**-10 * largest))
    flat = _flat_unknowns(rows, free)
    if is_any_flat := bool(flat.any()):
        moves |= _depends_on(rows, flat, free)
    if not w.any() or not (is_small or (np.abs(single) > least).any()):
        return moves
    factor, step = _newton_step(rows.M, w, at)
    if problem.jacobian is None and (factor is None or (np.abs(step) > least[at]).any()):
        factor, step = _newton_step(problem.central_differences(x, rows.value), w, at)
    if factor is None or (np.abs(step) <= least[at]).all():
        return moves
    signs, rounding = np.random.default_rng(0).choice([-1.0, 1.0], n), EPSILON * rows.terms
    lost = np.abs(factor.solve((signs * rounding)[at]))
    is_open, reach = ~(np.abs(step) <= np.maximum(least[at], lost)), np.abs(step)
    for is_second in () if is_any_flat else (False, True):  # flat unknowns took both values
        if not is_open.any():
            break
        there = x.copy()
        there[at] += np.where(is_open, np.copysign(reach, step), 0.0)
        there = np.clip(there, rows.lower, rows.upper)
        way, back = (there - x)[at], factor.solve(problem.value(there)[at])
        if is_second:  # rounding errors made the step if a far point leads back
            is_open &= ~((way * back >= 0.5 * way**2) & (way != 0.0))
        else:
            is_open &= ~(np.abs(back) <= reach / 3.0)
            reach = FAR_STEPS * np.maximum(reach, np.abs(back))
    moves[at] |= is_open
    return moves


def _flat_unknowns(rows: Linearization, free: BoolVector) -> BoolVector:
    """Return the free unknowns off z° on which the linearization depends by rounding errors at most."""
    rounding = 8.0 * EPSILON * rows.terms
    level = np.where(free, np.minimum(1.0 / rounding, LARGEST), 0.0)  # terms of 0 too
    columns = rows.absolute.T
    columns = columns if isinstance(columns, np.ndarray) else sp.csr_array(columns)
    share = largest_products(columns, level) * np.abs(rows.x)
    return free & (share <= 1.0) & (rows.x != rows.origin)


def _single_steps(rows: Linearization, free: BoolVector) -> Vector:
    """Return the change of each x_j that minimizes Σ (F_i/d_i)² of the free rows if no other unknown changes."""
    weights = np.where(free, 1.0, 0.0) / rows.scale
    squares = weights * weights
    steps = -rows.M.T.dot(squares * rows.value) / (rows.absolute**2).T.dot(squares)
    return np.asarray(np.where(np.isfinite(steps), steps, 0.0))


def _depends_on(rows: Linearization, flat: BoolVector, free: BoolVector) -> BoolVector:
    """Return the flat unknowns on which F depends at z°, and near x not beyond rounding, by two values of F."""
    way, rounding = np.where(flat, rows.x - rows.origin, 0.0), 8.0 * EPSILON * rows.terms
    near, far = (
        np.where(free, rows.problem.value(rows.x - part * way) - rows.value, 0.0)
        for part in (2.0**-10, 1.0)
    )
    if (np.abs(near) > rounding).any():  # differences of F miss the slope
        return flat & (rows.value @ near > 16.0 * (near @ near))
    return flat & (np.abs(far) > rounding).any()
