"""The nonlinear complementarity problem: callables and bounds, checked where they are called."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import (
    FloatVector,
    checked_bounds,
    checked_vector,
    read_only,
    real_array,
    rectangular_matrix,
)
from ...core.errors import InvalidProblem
from ...core.lcp import LCP
from .differences import Differences


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

    def __init__(
        self,
        F: Callable[[FloatVector], ArrayLike],
        jacobian: Callable[[FloatVector], Any] | None = None,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = np.inf,
        pattern: Any = None,
    ) -> None:
        self.F, self.jacobian = _callable(F, "F"), jacobian
        if jacobian is not None:
            _callable(jacobian, "jacobian")
            if pattern is not None:
                raise InvalidProblem(
                    "pattern is for differences, and a jacobian was given as well; leave one out"
                )
        self.pattern = None if pattern is None else _pattern(pattern)
        sizes = [np.shape(bound) for bound in (lower, upper) if np.ndim(bound)]
        sizes += [] if self.pattern is None else [self.pattern.shape[:1]]
        self.n: int | None = sizes[0][0] if sizes else None
        self._bounds = lower, upper
        if self.n is not None:
            self._set_bounds(self.n)

    def _set_bounds(self, n: int) -> None:
        self.lower, self.upper = checked_bounds(*self._bounds, n)
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
            raise InvalidProblem(
                f"the problem has {self.n} unknowns by its bounds or pattern, and x has length {n}"
            )
        sized = object.__new__(NonlinearProblem)
        sized.__dict__.update(self.__dict__, n=n)
        sized._set_bounds(n)
        return sized

    def value(self, x: ArrayLike) -> FloatVector:
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
        value = real_array(returned, need)
        if value.shape != x.shape:
            raise InvalidProblem(f"{need}, got shape {value.shape}; return one number a row")
        return read_only(value.copy())

    def derivative(self, x: ArrayLike, value: FloatVector | None = None) -> Any:
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

    def call_jacobian(self, x: FloatVector, value: FloatVector | None) -> tuple[Any, str]:
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

    def linearize(self, x: ArrayLike, value: FloatVector | None = None) -> LCP:
        """Return the LCP with M = F′(x), q = F(x) − F′(x) x and the same bounds, which is the problem near x.

        A row with an infinite slope, as √x has at 0, gets the slope 1 in x_i and 0 in all other unknowns. The sign of
        F_i is then correct, and x_i stays at its bound or leaves it.

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
        M = _finite(_replace_infinite_rows(returned, x.size), name, x.size)
        problem = self.with_size(x.size)
        with np.errstate(all="ignore"):
            q = value - M @ x
            if not np.isfinite(q).all():
                raise UndefinedDerivativeError(
                    "F(x) − F′(x) x overflows; start nearer to 0, or scale F and x"
                )
            return LCP(M, q, lower=problem.lower, upper=problem.upper)

    def _point(self, x: ArrayLike) -> FloatVector:
        return checked_vector(x, "x", self.n, allow_plus_infinity=True, allow_nan=True)

    def __repr__(self) -> str:
        how = "differences" if self.jacobian is None else "jacobian given"
        size = "any" if self.n is None else self.n
        return f"NonlinearProblem(n={size}, {how})"


def _finite(derivative: Any, name: str, n: int) -> Any:
    """Return the checked derivative; UndefinedDerivativeError if only numbers are invalid."""
    try:
        return rectangular_matrix(derivative, name, n, n)
    except InvalidProblem as error:
        entries = derivative.data if sp.issparse(derivative) else np.asarray(derivative)
        if (
            np.shape(derivative) == (n, n)
            and entries.dtype.kind == "f"
            and not np.isfinite(entries).all()
        ):
            raise UndefinedDerivativeError(str(error)) from error
        raise


def _replace_infinite_rows(derivative: Any, n: int) -> Any:
    """Return the derivative with identity rows for rows with an infinite entry."""
    entries = derivative.data if sp.issparse(derivative) else np.asarray(derivative)
    if np.shape(derivative) != (n, n) or entries.dtype.kind != "f" or not np.isinf(entries).any():
        return derivative
    M = sp.coo_array(derivative)
    is_steep = np.zeros(n, dtype=bool)
    is_steep[M.row[np.isinf(M.data)]] = True
    kept = ~is_steep[M.row]
    rows = sp.coo_array((M.data[kept], (M.row[kept], M.col[kept])), shape=(n, n))
    levelled = sp.csr_array(rows) + sp.diags_array(is_steep.astype(np.float64))
    return sp.csr_array(levelled) if sp.issparse(derivative) else levelled.toarray()


def _callable(given: Any, name: str) -> Any:
    if not callable(given):
        hint = "; for a matrix and a vector there is LCP(M, q)" if name == "F" else ""
        raise InvalidProblem(
            f"{name} must be callable as {name}(x), got {type(given).__name__}{hint}"
        )
    return given


def _pattern(pattern: Any) -> sp.csc_array:
    """Return the stored entries by columns, each with the value 1."""
    if not sp.issparse(pattern):
        pattern = sp.coo_array(
            real_array(pattern, "pattern must be a sparse array of shape (n, n)")
        )
    if pattern.ndim != 2 or pattern.shape[0] != pattern.shape[1]:
        raise InvalidProblem(
            f"pattern must be a square sparse array (n×n), got shape {pattern.shape}"
        )
    places = sp.coo_array(pattern)
    stored = sp.csc_array((np.ones(places.nnz), (places.row, places.col)), shape=places.shape)
    stored.sum_duplicates()
    return stored
