"""The nonlinear complementarity problem: callables and bounds, checked where they are called.

The derivative of a function by differences: columns that share no row are moved together.

References
----------
A. R. Curtis, M. J. D. Powell, J. K. Reid, *On the estimation of sparse Jacobian matrices*, IMA J. Appl. Math. 13
(1974), doi:10.1093/imamat/13.1.117.

The criterion of a nonlinear problem: the one of the LCP that F′(x) defines at x.

x is SOLVED if it passes the criterion of LCPs (:mod:`lcp_plugin.judges.lcp`) for M = F′(x), q = F(x) −
F′(x) x and the bounds, with F(x) for w. As for an LCP, each x_i is first moved to a bound whose distance is at most the
step −F_i/d_i; F and F′ are evaluated again there, and the better of the two points is returned. A row with an infinite
slope (√x at 0) counts with the slope 1. For an affine F these are the tests of the LCP.

Two clauses are added, because the linearization is not F, and because F(x) is not summed more accurately:

- The reference is also at most the residual of F(z°), if that is defined and not 0: otherwise the reference grows
  without limit as x diverges. If z° solves a component of the linearization, ‖x − z°‖∞ takes the place of the residual
  at z°: F = x (x − 1) (x + 2) has the solution 1, where z° = 0 solves the linearization.
- No unknown x_j off its bounds grows: the change of x_j alone that minimizes Σ (F_i/d_i)² is not an outward step above
  x_j/64. Otherwise F tends to 0 as x diverges. Three such steps end a run from a start.
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
from itertools import count
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...core import checks
from ...core.checks import BoolVector, Vector, derived_property, read_only
from ...core.errors import InvalidProblem
from ...core.kernels.floats import EPSILON
from ...core.lcp import LCP
from ...core.names import checked_names
from ...core.settings import Settings
from ...judges.certificate import Certificate
from ...judges.lcp import Measured, RowData, RowsAtPoint, row_data

DENSE_PATTERN_UP_TO = 1000  # unknowns; each costs one evaluation of F per derivative
STEEPER = 60  # slopes 4^k that are tried in a row with an infinite slope
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
        self._columns = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))
        of_entries = groups[self._columns]
        ends = np.cumsum(np.bincount(of_entries))[:-1]
        self._places = np.split(np.argsort(of_entries, kind="stable"), ends)

    @classmethod
    def on(cls, pattern: sp.csc_array | None, n: int) -> Differences:
        """Return the differences on a pattern; None means all entries.

        Raises
        ------
        InvalidProblem
            If the pattern is None and n > 1000.
        """
        if pattern is None:
            if n > DENSE_PATTERN_UP_TO:
                raise InvalidProblem(
                    f"differences on all places need n ≤ {DENSE_PATTERN_UP_TO}, got {n}; give a jacobian, or a pattern"
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
        self, F: Callable[[Vector], Vector], x: Vector, value: Vector, lower: Vector, upper: Vector
    ) -> Any:
        """Return the derivative at x, dense if the pattern is full, given F(x), by steps within the bounds.

        If F is not defined on one side of x, the step goes to the other side. Entries that neither side gives are
        NaN.
        """
        pattern, columns = self.pattern, self._columns
        step, derivative = _steps(x, lower, upper), np.full(pattern.nnz, np.nan)
        for k, places in enumerate(self._places):
            for way in (step, -step):
                moved = np.where(self.groups == k, x + way, x)
                change = F(moved) - value
                found = change[pattern.indices[places]] / (moved - x)[columns[places]]
                known = derivative[places]
                derivative[places] = np.where(np.isfinite(known), known, found)
                if np.isfinite(derivative[places]).all():
                    break
        found = sp.csc_array((derivative, pattern.indices, pattern.indptr), shape=pattern.shape)
        is_full = pattern.nnz == math.prod(pattern.shape)
        return found.toarray() if is_full else sp.csr_array(found)


def _steps(x: Vector, lower: Vector, upper: Vector) -> Vector:
    """Return the step of each unknown: away from 0, or to the farther bound if a bound is close."""
    length = STEP * np.maximum(np.abs(x), 1.0)
    above, below = upper - x, x - lower
    sign = np.where(x < 0.0, -1.0, 1.0)
    ahead, behind = np.where(sign > 0.0, above, below), np.where(sign > 0.0, below, above)
    return np.where((ahead < length) & (behind > ahead), -sign, sign) * length


class UndefinedDerivativeError(InvalidProblem):
    """F has no finite derivative at a point."""


class NonlinearProblem:
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
        or pass a jacobian.
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

    origin: Any = None  # of a variational inequality
    #: Function that returns the program of its affine rows, which may be infeasible.
    affine_part: Any = None

    def __init__(
        self,
        F: Callable[[Vector], ArrayLike],
        jacobian: Callable[[Vector], Any] | None = None,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = np.inf,
        pattern: Any = None,
        names: Any = None,
    ) -> None:
        for name, given in (("F", F), ("jacobian", jacobian)):
            if not callable(given) and (given is not None or name == "F"):
                hint = "; for a matrix and a vector there is LCP(M, q)" if name == "F" else ""
                kind = type(given).__name__
                raise InvalidProblem(f"{name} must be callable as {name}(x), got {kind}{hint}")
        if not (jacobian is None or pattern is None):
            raise InvalidProblem("pattern is for differences, without a jacobian; leave one out")
        self.F, self.jacobian = F, jacobian
        self.pattern = None if pattern is None else _pattern(pattern)
        sizes = [np.shape(bound) for bound in (lower, upper) if np.ndim(bound)]
        sizes += [] if self.pattern is None else [self.pattern.shape[:1]]
        self.n: int | None = sizes[0][0] if sizes else None
        checked_names(names, self.n, self.n, are_pairs=True)
        self._bounds, self._given_names = (lower, upper), names
        if self.n is not None:
            self._set_bounds(self.n)

    def _set_bounds(self, n: int) -> None:
        self.lower, self.upper = checks.checked_bounds(*self._bounds, n)
        self.names = checked_names(self._given_names, n, n, are_pairs=True)
        self._differences: Differences | None = None

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
        sized = object.__new__(NonlinearProblem)
        sized.__dict__.update(self.__dict__, n=n)
        sized._set_bounds(n)
        return sized

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
        x = self._point(x)
        with np.errstate(all="ignore"):  # F may be undefined at x: its value shows it
            returned = self.F(x)
        need = f"F(x) must be a real vector of length {x.size} for x of shape ({x.size},)"
        value = checks.real_array(returned, need)
        if value.shape != x.shape:
            raise InvalidProblem(f"{need}, got shape {value.shape}; return one number a row")
        return read_only(value.copy())

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
        if self.jacobian is not None:
            with np.errstate(all="ignore"):
                returned = self.jacobian(x)
            return (sp.csr_array(returned) if sp.issparse(returned) else returned), "jacobian(x)"
        problem = self.with_size(x.size)
        if problem._differences is None:
            problem._differences = Differences.on(self.pattern, x.size)
        value = self.value(x) if value is None else value
        derivative = problem._differences.at(self.value, x, value, problem.lower, problem.upper)
        return derivative, "the derivative of F by differences"

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
        value = self.value(x) if value is None else value
        returned, name = self.call_jacobian(x, value)
        problem = self.with_size(x.size)
        M = _finite(_replace_infinite_rows(problem, x, value, returned), name, x.size)
        with np.errstate(all="ignore"):
            q = value - M @ x
            if not np.isfinite(q).all():
                raise UndefinedDerivativeError("F(x) − F′(x) x overflows; start nearer to 0")
            return LCP(M, q, lower=problem.lower, upper=problem.upper, names=problem.names)

    def _point(self, x: ArrayLike) -> Vector:
        return checks.checked_vector(x, "x", self.n, allow_plus_infinity=True, allow_nan=True)

    def __repr__(self) -> str:
        how = "differences" if self.jacobian is None else "jacobian given"
        size = "any" if self.n is None else self.n
        return f"NonlinearProblem(n={size}, {how})"


def _finite(derivative: Any, name: str, n: int) -> Any:
    """Return the checked derivative; UndefinedDerivativeError if only numbers are invalid."""
    try:
        return checks.rectangular_matrix(derivative, name, n, n)
    except InvalidProblem as error:
        if not (entries := _floats(derivative, n)).size or np.isfinite(entries).all():
            raise
        raise UndefinedDerivativeError(str(error)) from error


def _floats(derivative: Any, n: int) -> Any:
    """Return the entries of a derivative of shape (n, n), none if it has another shape or type."""
    entries = derivative.data if sp.issparse(derivative) else np.asarray(derivative)
    fits = np.shape(derivative) == (n, n) and entries.dtype.kind == "f"
    return entries if fits else np.zeros(0)


def _replace_infinite_rows(problem: NonlinearProblem, x: Vector, value: Vector, M: Any) -> Any:
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


def _pattern(pattern: Any) -> sp.csc_array:
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


MOVES = 4.0 ** np.arange(-25, 1)  # shares of x, from some roundings to x itself
SAMPLES = 5  # of the rounding error of each F_i


class LinearizedRows(RowData):
    """Data of the criterion at x: the linearization there, with F(x) for w, and without sums in twice the precision.

    Parameters
    ----------
    problem : NonlinearProblem
    lcp : LCP
        The linearization at x.
    x, value, origin_value : ndarray, shape (n,)
        The point, F(x) and F(z°).
    """

    matrix = "F′"

    def __init__(
        self, problem: NonlinearProblem, lcp: LCP, x: Vector, value: Vector, origin_value: Vector
    ) -> None:
        self.__dict__.update(row_data(lcp).__dict__)
        self.problem, self.lcp, self.x, self.value = problem, lcp, x, value
        ends, distance = self.references, self.largest(np.abs(x - self.start))
        residual = np.abs(self.residual(self.start, origin_value))
        of_value = self.largest(np.where(np.isfinite(origin_value), residual, np.inf))
        of_value = np.where(of_value > 0.0, of_value, np.inf)
        bounded = (np.where(self.is_at_start, distance, end) for end in ends)
        least, most = (np.minimum(one, of_value) for one in bounded)
        self.references = least, most

    def rows(self, z: Vector, w: Any = None) -> RowsAtPoint:
        """Return the values of all rows at z; a slack w that is known is F(x), without a bound of its rounding."""
        at = super().rows(z, w)
        return at if w is None else at._replace(rounding=np.zeros(z.size))

    def sharp_product(self, z: Vector) -> None:
        """Return None: F is not a sum."""

    def measure_at(self, *given: Any, **how: Any) -> Measured:
        """Measure x; it passes only if also no unknown grows, and rounding errors of F are small."""
        found = super().measure_at(*given, **how)
        # Smaller rounding errors of F do not count, for any tolerance; z° has none
        limit, at = max(given[2], 1e-8) * found.by_row.reference * self.scale, found.rows
        is_lost = (at.is_active & (limit > 0.0) & (EPSILON * at.terms > limit)).any()
        return found._replace(passes=found.passes and not (is_lost or self.growing.any()))

    @derived_property
    def growing(self) -> BoolVector:
        """Mask of the unknowns off their bounds that would grow by a part, if they alone minimized the residuals.

        Then F tends to 0 as x diverges, and rows have the scale of other unknowns: x₀ − 1 + e^(−x₁) = 0 = x₀ − 1.
        """
        lcp, x = self.lcp, self.x
        weights = np.where(self.rows(x, self.value).is_active, 1.0, 0.0) / self.scale
        slopes = sp.csr_array(sp.diags_array(weights) @ lcp.csr)
        step = -(slopes.T @ (weights * self.value)) / (slopes.multiply(slopes).T @ np.ones(x.size))
        is_free = (x > lcp.lower) & (x < lcp.upper)
        size = np.maximum(np.abs(x), 2.0**-10 * self.largest(np.abs(x)))
        return np.asarray(is_free & (step * np.sign(x) > 2.0**-6 * size))

    @derived_property
    def noise(self) -> Vector:
        """Estimate of the rounding error inside each F_i/d_i, shape (n,); NaN if F is not defined near x.

        It is the largest |F(x + δ) − F(x) − F′(x) δ|_i / d_i of five steps, the first of which is the least in
        `MOVES` that changes F_i: 1 − e⁻ˣ is constant next to a small x.
        """
        x, found, left = self.x, np.zeros(self.x.size), np.full(self.x.size, SAMPLES)
        step = -self.residual(x, self.value)
        way = np.copysign(np.maximum(np.abs(x), np.abs(step)), step)
        left[step == 0.0] = 0
        for share in MOVES:
            near = np.clip(x + share * way, self.lower, self.upper)
            change = self.problem.value(near) - self.value
            error = np.abs(change - self.M @ (near - x)) / self.scale
            is_open = (left > 0) & ((change != 0.0) | (left < SAMPLES))
            found, left = np.where(is_open, np.maximum(found, error), found), left - is_open
            if not left.any():
                break
        return found

    def rounding_floor(self, terms: Vector, scale: Vector | None = None) -> Any:
        """Return the rounding level of each residual, with the rounding error inside F."""
        return super().rounding_floor(terms, scale) + self.noise


class Linearization:
    """The problem near a point x: F(x), and the LCP of F′(x), computed on first use.

    Parameters
    ----------
    problem : NonlinearProblem
    x : array, shape (n,)
        A copy is kept.
    """

    def __init__(self, problem: NonlinearProblem, x: Vector) -> None:
        self.problem, self.x = problem, read_only(x.copy())
        self.value = problem.value(self.x)

    def at(self, x: Vector) -> Linearization:
        """Return the linearization at another point, with the same `origin`."""
        is_origin = np.array_equal(x, self.origin.x)
        found = self.origin if is_origin else Linearization(self.problem, x)
        found.origin = self.origin
        return found

    @derived_property
    def origin(self) -> Linearization:
        """The linearization at z°, the point of the bounds nearest to 0; F need not be defined there."""
        nearest = np.clip(0.0, self.problem.lower, self.problem.upper)
        return self if np.array_equal(self.x, nearest) else Linearization(self.problem, nearest)

    @derived_property
    def lcp(self) -> LCP:
        """The problem with M = F′(x), q = F(x) − F′(x) x; errors as of :meth:`NonlinearProblem.linearize`."""
        return self.problem.linearize(self.x, self.value)

    @derived_property
    def is_defined(self) -> bool:
        """True if F and its derivative are finite here."""
        if not np.isfinite(self.value).all():
            return False
        try:
            self.lcp  # noqa: B018
        except UndefinedDerivativeError:
            return False
        return True

    @derived_property
    def certificate(self) -> Certificate:
        """The certificate of x as a solution of the linearization, which ``derivative`` and ``explain`` use."""
        origin = self.origin.value
        data = LinearizedRows(self.problem, self.lcp, self.x, self.value, origin)
        return Certificate.at(self.lcp, self.x, criterion=data, rows=data.rows(self.x, self.value))

    def measure(self, settings: Settings) -> Measured:
        """Return the measure of x by the stopping criterion."""
        data, absolute = self.certificate.criterion, settings.absolute_tolerance
        return data.measure_at(self.x, self.value, settings.goal, absolute)

    def is_limited(self, settings: Settings) -> bool:
        """Return whether x fails only because of rounding, estimated by further values of F."""
        data = self.certificate.criterion
        return bool(data.are_limited(self.measure(settings), settings.goal))

    @derived_property
    def residual(self) -> float:
        """The relative residual of x."""
        return self.certificate.relative_residual
