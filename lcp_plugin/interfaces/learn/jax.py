"""The solution of linear complementarity problems as a function of JAX: see ``help("lcp_plugin.interfaces.learn")``."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from functools import partial
from typing import Any

import numpy as np

try:
    import jax
except ImportError:
    raise ImportError(
        "lcp_plugin.interfaces.learn.jax needs JAX; install it with: pip install jax (or lcp_plugin[jax])"
    ) from None

import jax.numpy as jnp
from scipy.sparse import issparse

from ...core.checks import AnyMatrix, Array, real_array
from ...core.errors import InvalidOption, InvalidProblem
from ...core.kernels.floats import EPSILON, NORMAL
from ...methods.small import LOOP_UP_TO
from ...methods.small_lcps_in_jax import has_arrays, real_values, solve_lcp
from ..derivatives import require_double
from . import ContactLayer, Layer, LayerCall, LCPLayer, QPLayer

__all__ = ["contact_layer", "lcp_layer", "qp_layer", "solve_lcp"]

LCPArrays = Callable[
    ..., tuple[Any, ...]
]  # of arrays: M, q and bounds of LCPs, and which of them are suitable


def lcp_layer(
    M: AnyMatrix,
    q: Array,
    lower: Array = 0.0,
    upper: Array = np.inf,
    *,
    mask: bool = False,
    fallback: str | None = None,
    **options: Any,
) -> Any:
    """Return the solutions z of LCPs, differentiable by M, q, lower and upper.

    Parameters
    ----------
    M : array, shape (…, n, n), or a scipy sparse array of shape (n, n)
        One of shape (n, n) stands for all. A scipy array is a constant.
    q : array, shape (…, n)
        Leading axes are batch axes; all arguments broadcast. Arrays of JAX are float64.
    lower, upper : array, shape (…, n), or number
    mask : bool
        If True, return the pair (z, is_solved). An instance that is not solved then has z = 0 and the gradient 0,
        instead of an error for the entire batch.
    fallback : "host", optional
        Within ``jit`` and ``vmap``, :func:`solve_lcp` solves LCPs with at most 128 unknowns on their device, without a
        callback; an instance that it does not solve is NaN without `mask`. "host" solves such a batch on the host.
    **options
        ``algorithm``, ``tolerance``, ``max_seconds``, … of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    array, shape (…, n), or with `mask` a pair of it and an array of bool, shape (…)

    Raises
    ------
    InvalidOption
        If JAX does not calculate in double precision.
    InvalidProblem
        If an array has another type or shape, or its numbers are not a valid problem.
    NotConverged
        If a problem of the batch is not solved, without `mask`; the message names it. Where JAX calls the host, it
        raises its own JaxRuntimeError with this text: use `mask`.
    UnsuitableProblem, UnsupportedModel
        If a derivative does not exist, or a second derivative is requested.

    Notes
    -----
    Gradients go backward: ``jax.grad``, ``jax.vjp``, ``jax.jacrev``, also under ``jit`` and ``vmap``; a mapped axis
    becomes a batch axis. Within ``jit`` and without `fallback`, small problems have forward and second derivatives. An
    option other than ``tolerance`` is one of the host, where all problems are then solved.

    Examples
    --------
    >>> jax.config.update("jax_enable_x64", True)
    >>> M, q = jnp.array([[2.0, 1.0], [1.0, 2.0]]), jnp.array([[-5.0, 1.0], [1.0, -4.0]])
    >>> lcp_layer(M, q).tolist()
    [[2.5, 0.0], [0.0, 2.0]]
    >>> jax.grad(lambda q: lcp_layer(M, q).sum())(q).tolist()
    [[-0.5, 0.0], [0.0, -0.5]]
    """
    require_double(jax, "lcp_layer")
    call = LCPLayer.of(_float_array, M, q, (lower, upper), mask=mask, **options)
    return _broadcast_solution(call, None if issparse(M) else _all_suited, fallback)


def qp_layer(
    P: AnyMatrix,
    c: Array,
    G: AnyMatrix = None,
    h: Array = None,
    A: AnyMatrix = None,
    b: Array = None,
    lower: Array = -np.inf,
    upper: Array = np.inf,
    *,
    mask: bool = False,
    fallback: str | None = None,
    **options: Any,
) -> Any:
    """Return the solutions x of quadratic programs, differentiable by all data.

    Parameters
    ----------
    P, c, G, h, A, b : array, shapes (…, n, n), (…, n), (…, m, n), (…, m), (…, p, n) and (…, p)
        min ½ xᵀP x + cᵀx subject to G x ≤ h, A x = b; no rows by default, or with an empty array. Leading axes are
        batch axes; all arguments broadcast. Float64. Only the symmetric part of P matters; it must be positive
        semidefinite. None as P is a linear program.
    lower, upper : array, shape (…, n), or number
    mask, fallback
        As in `lcp_layer`; an x with its multipliers is a solution of the LCP of the optimality conditions.
    **options
        ``algorithm``, ``tolerance``, ``max_seconds``, ``threads`` of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    array, shape (…, n), or with `mask` a pair of it and an array of bool, shape (…)

    Raises
    ------
    InvalidOption, InvalidProblem, NotConverged, UnsuitableProblem
        For the reasons that `lcp_layer` names.

    Examples
    --------
    >>> jax.config.update("jax_enable_x64", True)
    >>> c, G, h = jnp.array([-1.0, -2.0]), jnp.ones((1, 2)), jnp.array([2.0])
    >>> jax.jacrev(qp_layer, 1)(jnp.eye(2), c, G, h).round(6).tolist()
    [[-0.5, 0.5], [0.5, -0.5]]
    """
    require_double(jax, "qp_layer")
    data = dict(P=P, c=c, G=G, h=h, A=A, b=b, lower=lower, upper=upper)
    return _broadcast_solution(
        QPLayer.of(_float_array, data, mask=mask, **options), _conditions, fallback
    )


def contact_layer(W: Any, b: Any, friction: Any, *, mask: bool = False, **options: Any) -> Any:
    """Return the impulses z of contact problems with friction, differentiable by W, b and friction.

    Parameters
    ----------
    W, b, friction : array, shapes (…, n, n), (…, n) and (…, k)
        Arguments of :class:`lcp_plugin.FrictionalContact`, float64. Leading axes are batch axes, and broadcast.
    mask : bool
        As in `lcp_layer`.
    **options
        ``contacts``, ``dimension``, ``equations`` of :class:`lcp_plugin.FrictionalContact`; ``tolerance``,
        ``max_seconds``, ``threads`` of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    array, shape (…, n), or with `mask` a pair of it and an array of bool, shape (…)
        The velocities are W z + b.

    Raises
    ------
    InvalidOption, InvalidProblem, NotConverged
        For the reasons that `lcp_layer` names.

    Examples
    --------
    >>> jax.config.update("jax_enable_x64", True)
    >>> b, friction = jnp.array([-1.0, 3.0, 4.0]), jnp.array([0.5])
    >>> jax.grad(lambda mu: contact_layer(jnp.eye(3), b, mu) @ jnp.array([0.0, 3.0, 4.0]))(friction).round(6).tolist()
    [-5.0]
    """
    require_double(jax, "contact_layer")
    return _broadcast_solution(ContactLayer.of(_float_array, W, b, friction, mask=mask, **options))


def _broadcast_solution(
    call: LayerCall, statement: LCPArrays | None = None, fallback: str | None = None
) -> Any:
    """Return the solutions, with a mask if the layer has one; `vmap` needs arrays with all batch axes."""
    if fallback not in (None, "host"):
        raise InvalidOption(f'fallback must be "host" or None, got {fallback!r}')
    layer, data = call
    shapes = [array.shape for array in data]
    axes = layer.axes_of(*shapes)
    wide = tuple(
        array.reshape(*(1 for _ in axes), *shape)  # one matrix for all
        if len(shape) == 2 and math.prod(array.shape[:-2]) == 1
        else jnp.broadcast_to(array, (*axes, *shape))
        for array, shape in zip(data, layer.problem_shapes(*shapes), strict=True)
    )
    # Under `grad` alone the arrays have values; within `jit` or `vmap` they have none
    has_no_values = any(isinstance(jax.lax.stop_gradient(x), jax.core.Tracer) for x in data)
    if statement is not None and has_no_values and not layer.options.keys() - {"tolerance"}:
        *lcp, is_suitable = statement(*wide)
        if 0 < lcp[1].shape[-1] <= LOOP_UP_TO:
            z, is_solved = solve_lcp(*lcp, **layer.options)
            z, is_solved = z[..., : wide[1].shape[-1]], is_solved & is_suitable
            if fallback == "host":
                on_host = partial(_solution, layer)
                z, is_solved = jax.lax.cond(
                    is_solved.all(), lambda _: (z, is_solved), on_host, wide
                )
            z = jnp.where(is_solved[..., None], z, 0.0 if layer.mask else jnp.nan)
            return (z, is_solved) if layer.mask else z
    solution = _solution(layer, wide)
    return solution if layer.mask else solution[0]


def _all_suited(*data: Array) -> tuple[Any, ...]:
    return *data, True


def _conditions(
    P: Array, c: Array, G: Array, h: Array, A: Array, b: Array, lower: Array, upper: Array
) -> Any:
    """Return the optimality conditions of programs, as LCPs in x and the multipliers, and which programs are convex."""
    axes, n = c.shape[:-1], c.shape[-1]
    C = jnp.concatenate([jnp.broadcast_to(rows, (*axes, *rows.shape[-2:])) for rows in (G, A)], -2)
    P = jnp.broadcast_to(0.5 * (P + P.swapaxes(-1, -2)), (*axes, n, n))
    M = jnp.zeros((*axes, n + C.shape[-2], n + C.shape[-2]))
    M = M.at[..., :n, :n].set(P).at[..., :n, n:].set(C.swapaxes(-1, -2)).at[..., n:, :n].set(-C)
    fixed = jax.lax.stop_gradient(P)
    noise = n * EPSILON * abs(fixed).max((-1, -2), keepdims=True) + NORMAL
    is_convex = jnp.isfinite(jnp.linalg.cholesky(fixed + noise * jnp.eye(n))).all((-1, -2))
    zero, far = jnp.zeros_like(h), jnp.full_like(b, np.inf)
    lower, upper = (
        jnp.concatenate([lower, zero, -far], -1),
        jnp.concatenate([upper, zero + np.inf, far], -1),
    )
    return M, jnp.concatenate([c, h, b], -1), lower, upper, is_convex


def _called(function: Callable[..., Any], like: Array, *data: Array) -> Any:
    """Call a numpy function; vmap adds a leading axis to all arrays."""
    return jax.pure_callback(
        lambda *data: function(*map(np.asarray, data)), like, *data, vmap_method="broadcast_all"
    )


def _like(array: Array) -> Any:
    return jax.ShapeDtypeStruct(array.shape, np.float64)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _solution(layer: Layer, data: tuple[Any, ...]) -> Any:
    is_solved = jax.ShapeDtypeStruct(data[1].shape[:-1], np.bool_)
    return _called(copy(layer).solve, (_like(data[1]), is_solved), *data)


def _solution_forward(layer: Layer, data: tuple[Any, ...]) -> tuple[Any, tuple[Any, ...]]:
    z, is_solved = _solution(layer, data)
    return (z, is_solved), (data, z)


def _solution_backward(
    layer: Layer, kept: tuple[Any, ...], gradients: tuple[Any, Any]
) -> tuple[Any, ...]:
    def differentiate(*arrays: Array) -> tuple[Any, ...]:
        *data, z, g = arrays
        at_z = copy(layer)
        at_z.solve(*data, z0=z)
        return at_z.gradients(g)

    (data, z), (g, _) = kept, gradients
    return (_called(differentiate, tuple(map(_like, data)), *data, z, g),)


_solution.defvjp(_solution_forward, _solution_backward)


def _float_array(values: Array, name: str) -> Any:
    """Return the values as a float64 array, of numpy if they are constants; other float types are rejected."""
    if not has_arrays(values):
        return real_array(values, f"{name} must be an array of real numbers")
    if (array := real_values(values, name)).dtype == np.float64:
        return array
    raise InvalidProblem(
        f"{name} must be an array of float64, got {array.dtype}; write {name}.astype(float)"
    )
