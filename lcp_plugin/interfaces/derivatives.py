"""Nonlinear problems with exact Jacobians: F as a function of JAX, or as an expression of CasADi."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..core.checks import Array, Vector
from ..core.errors import InvalidOption, InvalidProblem, imported
from ..problems.nonlinear.data import Differences, NonlinearProblem


def from_jax(
    F: Any,
    *,
    lower: ArrayLike = 0.0,
    upper: ArrayLike = np.inf,
    sparsity: object = None,
    names: object = None,
) -> NonlinearProblem:
    """Return the problem of a function of JAX, with its exact Jacobian.

    Parameters
    ----------
    F : callable
        Takes and returns a float64 array of JAX, shape (n,). It is compiled: data that it reads are constants after
        the first call.
    lower, upper, names
        As of :class:`lcp_plugin.NonlinearProblem`.
    sparsity : sparse array, shape (n, n), optional
        Sparsity pattern of F′, as `pattern` of :class:`lcp_plugin.NonlinearProblem`. Columns that share no row are
        then computed together, and F′ is sparse. Without it F′ is dense.

    Raises
    ------
    ImportError
        If JAX is not installed: ``pip install jax``, or the extra ``[jax]``.
    InvalidOption
        If JAX calculates in single precision; also in `solve`, as InvalidProblem, if F returns single precision.

    Examples
    --------
    >>> import jax
    >>> import jax.numpy as jnp
    >>> from lcp_plugin import solve
    >>> jax.config.update("jax_enable_x64", True)
    >>> problem = NonlinearProblem.from_jax(lambda x: jnp.exp(x) - jnp.array([3.0, 0.5]), lower=jnp.zeros(2))
    >>> solve(problem).x.round(6)
    array([1.098612, 0.      ])
    """
    jax = imported("jax", "NonlinearProblem.from_jax needs JAX", "jax")
    require_double(jax, "NonlinearProblem.from_jax")
    compiled, slopes = jax.jit(F), jax.jit(jax.jacfwd(F))

    def value(x: Vector) -> Vector:
        return _in_double(compiled(x))

    if sparsity is None:
        return NonlinearProblem(value, lambda x: _in_double(slopes(x)), lower, upper, names=names)
    plain = NonlinearProblem(value, None, lower, upper, sparsity, names)
    pattern: Any = plain.pattern
    groups = Differences.on(pattern, pattern.shape[0]).groups
    rows, columns = pattern.indices, np.repeat(np.arange(groups.size), np.diff(pattern.indptr))
    seeds = 1.0 * (np.arange(groups.max(initial=-1) + 1)[:, np.newaxis] == groups)
    entries = jax.jit(lambda x: jax.vmap(jax.linearize(F, x)[1])(seeds)[groups[columns], rows])

    def jacobian(x: Vector) -> sp.csc_array:
        return sp.csc_array((_in_double(entries(x)), rows, pattern.indptr), shape=pattern.shape)

    return NonlinearProblem(value, jacobian, plain.lower, plain.upper, names=names)


IN_DOUBLE = 'begin the program with jax.config.update("jax_enable_x64", True)'


def require_double(jax: Any, name: str) -> None:
    """Raise InvalidOption unless JAX calculates in double precision."""
    if not jax.config.jax_enable_x64:
        raise InvalidOption(f"{name} works in double precision; {IN_DOUBLE}")


def _in_double(values: Any) -> Vector:
    """Return values of JAX as an array of numpy; raise InvalidProblem unless they are in double precision."""
    if getattr(values, "dtype", np.float64) != np.float64:
        raise InvalidProblem(f"F must return float64, got {values.dtype}; {IN_DOUBLE}")
    return np.asarray(values)


def from_casadi(
    x: Array, F: Any, *, lower: ArrayLike = 0.0, upper: ArrayLike = np.inf, names: Any = None
) -> NonlinearProblem:
    """Return the problem of an expression of CasADi, with its exact sparse Jacobian.

    Parameters
    ----------
    x : SX or MX, shape (n, 1)
        The unknowns: ``SX.sym("x", n)``, ``MX.sym("x", n)``, or a ``vertcat`` of symbols of SX.
    F : SX or MX, shape (n, 1), or list of them
        Expressions in no other symbols; ``casadi.substitute`` replaces other symbols by numbers.
    lower, upper, names
        As of :class:`lcp_plugin.NonlinearProblem`.

    Raises
    ------
    ImportError
        If CasADi is not installed: ``pip install casadi``, or the extra ``[casadi]``.
    InvalidProblem
        If F has other symbols than x, or not one row per unknown.

    Examples
    --------
    >>> import casadi
    >>> from lcp_plugin import solve
    >>> x = casadi.SX.sym("x", 2)
    >>> problem = NonlinearProblem.from_casadi(x, casadi.exp(x) - casadi.DM([3, 0.5]))
    >>> solve(problem).x.round(6)
    array([1.098612, 0.      ])
    """
    casadi = imported("casadi", "NonlinearProblem.from_casadi needs CasADi", "casadi")
    if not (isinstance(x, (casadi.SX, casadi.MX)) and x.is_valid_input()):
        raise InvalidProblem(f'x must be symbols of CasADi, as MX.sym("x", n), got {x!r}')
    F = type(x)(casadi.vertcat(*F) if isinstance(F, (list, tuple)) else F)
    if F.shape != x.shape or x.shape[1] != 1:
        raise InvalidProblem(f"F must have one row per unknown, got {F.shape} for x of {x.shape}")
    unknowns = {str(symbol) for symbol in casadi.symvar(x)}
    if others := [symbol for symbol in map(str, casadi.symvar(F)) if symbol not in unknowns]:
        raise InvalidProblem(f"F contains {', '.join(others)}; insert numbers by casadi.substitute")
    slopes = casadi.jacobian(F, x)
    pattern = slopes.sparsity()
    rows, ends = np.array(pattern.row(), np.int32), np.array(pattern.colind(), np.int32)
    parts = (casadi.densify(part) for part in (F, slopes.nz[:]))
    value, entries = (casadi.Function("values", [x], [part]) for part in parts)

    def jacobian(x: Vector) -> sp.csc_array:
        return sp.csc_array((entries(x).full().ravel(), rows, ends), shape=slopes.shape)

    model = NonlinearProblem(lambda x: value(x).full().ravel(), jacobian, lower, upper, names=names)
    return model.with_size(x.shape[0])
