"""The solution of linear complementarity problems as a function of JAX: see ``help("lcp_plugin.interfaces.learn")``."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

try:
    import jax
except ImportError:
    raise ImportError(
        "lcp_plugin.interfaces.learn.jax needs JAX; install it with: pip install 'lcp_plugin[learn]'"
    ) from None

import jax.numpy as jnp

from ...core.checks import check_kind, real_array
from ...core.errors import InvalidOption, InvalidProblem
from .batches import (
    LayerOptions,
    common_axes,
    contact_gradients,
    contacts_solved,
    gradients,
    is_one,
    solved,
)

__all__ = ["contact_layer", "lcp_layer"]


def lcp_layer(M: Any, q: Any, lower: Any = 0.0, upper: Any = np.inf, **options: Any) -> jax.Array:
    """Return the solutions z of LCPs, differentiable by M, q, lower and upper.

    Parameters
    ----------
    M : array, shape (…, n, n), or a scipy sparse array of shape (n, n)
        One of shape (n, n) stands for all. A scipy array is a constant.
    q : array, shape (…, n)
        Leading axes are batch axes; all arguments broadcast. Arrays of JAX are float64.
    lower, upper : array, shape (…, n), or number
    **options
        ``algorithm``, ``tolerance``, ``max_seconds``, … of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    array, shape (…, n)

    Raises
    ------
    InvalidOption
        If JAX does not calculate in double precision.
    InvalidProblem
        If an array has another type or shape, or its numbers are not a valid problem.
    NotConverged
        If a problem of the batch is not solved; the message names it.
    UnsuitableProblem, UnsupportedModel
        If a derivative does not exist, or a second derivative is requested.

    Notes
    -----
    Gradients go backward: ``jax.grad``, ``jax.vjp``, ``jax.jacrev``, also under ``jit`` and ``vmap``; a mapped axis is
    one more of the batch.

    Examples
    --------
    >>> jax.config.update("jax_enable_x64", True)
    >>> M, q = jnp.array([[2.0, 1.0], [1.0, 2.0]]), jnp.array([[-5.0, 1.0], [1.0, -4.0]])
    >>> lcp_layer(M, q).tolist()
    [[2.5, 0.0], [0.0, 2.0]]
    >>> jax.grad(lambda q: lcp_layer(M, q).sum())(q).tolist()
    [[-0.5, 0.0], [0.0, -0.5]]
    """
    if not jax.config.jax_enable_x64:
        raise InvalidOption(
            'lcp_layer works in double precision; begin the program with jax.config.update("jax_enable_x64", True)'
        )
    q, lower, upper = _array(q, "q"), _array(lower, "lower"), _array(upper, "upper")
    wishes, M = (
        (LayerOptions(options, M), None)
        if sp.issparse(M)
        else (LayerOptions(options), _array(M, "M"))
    )
    axes = common_axes(*(() if array is None else array.shape for array in (M, q, lower, upper)))
    n = q.shape[-1]
    if M is not None and M.shape[-2:] != (n, n):
        raise InvalidProblem(f"M must have shape (…, n, n), n = {n} as q has, got {M.shape}")
    data = [jnp.broadcast_to(vector, (*axes, n)) for vector in (q, lower, upper)]
    if M is None or is_one(M):
        M = jnp.zeros((0, 0)) if M is None else M.reshape(n, n)
        M = M.reshape(*(1 for _ in axes), *M.shape)
    else:
        M = jnp.broadcast_to(M, (*axes, n, n))
    z: jax.Array = _solution(M, *data, wishes)
    return z


def contact_layer(W: Any, b: Any, friction: Any, **options: Any) -> jax.Array:
    """Return the impulses z of contact problems with friction, differentiable by W, b and friction.

    Parameters
    ----------
    W, b, friction : array, shapes (…, n, n), (…, n) and (…, k)
        Arguments of :class:`lcp_plugin.FrictionalContact`, float64. Leading axes are batch axes, and broadcast.
    **options
        ``dimension``, by default 3 if the number of rows is a multiple of 3; ``tolerance``, ``max_seconds``,
        ``threads`` of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    array, shape (…, n)
        The velocities are W z + b.

    Raises
    ------
    InvalidOption
        If JAX does not calculate in double precision.
    InvalidProblem, NotConverged
        For the reasons that `lcp_layer` names.

    Notes
    -----
    Derivatives go backwards: ``jax.grad``, ``jax.vjp``, ``jax.jacrev``, under ``jit`` and ``vmap`` as well.

    Examples
    --------
    >>> jax.config.update("jax_enable_x64", True)
    >>> b, friction = jnp.array([-1.0, 3.0, 4.0]), jnp.array([0.5])
    >>> jax.grad(lambda mu: contact_layer(jnp.eye(3), b, mu) @ jnp.array([0.0, 3.0, 4.0]))(friction).round(6).tolist()
    [-5.0]
    """
    if not jax.config.jax_enable_x64:
        raise InvalidOption(
            'contact_layer works in double precision; begin with jax.config.update("jax_enable_x64", True)'
        )
    W, b, friction = _array(W, "W"), _array(b, "b"), _array(friction, "friction")
    axes = np.broadcast_shapes(W.shape[:-2], b.shape[:-1], friction.shape[:-1])
    own = (W, W.shape[-2:]), (b, b.shape[-1:]), (friction, friction.shape[-1:])
    z: jax.Array = _impulses(
        *(jnp.broadcast_to(one, (*axes, *shape)) for one, shape in own), LayerOptions(options)
    )
    return z


def _called(function: Callable[..., Any], like: Any, own: tuple[int, ...], *data: Any) -> Any:
    """Call a numpy function with one batch axis; `own` counts the other axes of each array.

    vmap adds leading axes to all arrays, so that only the last `own` axes belong to a problem.
    """

    def call(*data: Any) -> Any:
        axes = np.broadcast_shapes(
            *(one.shape[: one.ndim - count] for one, count in zip(data, own, strict=True))
        )
        stacked = []
        for one, count in zip(data, own, strict=True):
            front, shape = one.shape[: one.ndim - count], one.shape[one.ndim - count :]
            is_one = count == 2 and math.prod(front) == 1  # one matrix for all
            whole = np.asarray(one) if is_one else np.broadcast_to(np.asarray(one), (*axes, *shape))
            stacked.append(whole.reshape(1 if is_one else math.prod(axes), *shape))
        answers = function(*stacked)
        return jax.tree.map(lambda answer: answer.reshape(*axes, *answer.shape[1:]), answers)

    return jax.pure_callback(call, like, *data, vmap_method="broadcast_all")


def _like(*arrays: Any) -> tuple[Any, ...]:
    return tuple(jax.ShapeDtypeStruct(one.shape, np.float64) for one in arrays)


@partial(jax.custom_vjp, nondiff_argnums=(3,))
def _impulses(W: Any, b: Any, friction: Any, wishes: LayerOptions) -> Any:
    return _called(
        lambda *data: np.array(contacts_solved(wishes, *data).batch.z),
        _like(b)[0],
        (2, 1, 1),
        W,
        b,
        friction,
    )


def _impulses_forward(W: Any, b: Any, friction: Any, wishes: LayerOptions) -> tuple[Any, Any]:
    z = _impulses(W, b, friction, wishes)
    return z, (W, b, friction, z)


def _impulses_backward(wishes: LayerOptions, kept: tuple[Any, ...], g: Any) -> tuple[Any, ...]:
    def differentiate(W: Any, b: Any, friction: Any, z: Any, g: Any) -> tuple[Any, ...]:
        return contact_gradients(contacts_solved(wishes, W, b, friction, z), (), g)  # starts at z

    by: tuple[Any, ...] = _called(differentiate, _like(*kept[:3]), (2, 1, 1, 1, 1), *kept, g)
    return by


_impulses.defvjp(_impulses_forward, _impulses_backward)


@partial(jax.custom_vjp, nondiff_argnums=(4,))
def _solution(M: Any, q: Any, lower: Any, upper: Any, wishes: LayerOptions) -> Any:
    def solve(*data: Any) -> Any:
        return np.array(solved(wishes, *_with_matrix(wishes, data))[0].z)

    return _called(solve, _like(q)[0], (2, 1, 1, 1), M, q, lower, upper)


def _solution_forward(
    M: Any, q: Any, lower: Any, upper: Any, wishes: LayerOptions
) -> tuple[Any, tuple[Any, ...]]:
    z = _solution(M, q, lower, upper, wishes)
    return z, (M, q, lower, upper, z)


def _solution_backward(wishes: LayerOptions, kept: tuple[Any, ...], g: Any) -> tuple[Any, ...]:
    def differentiate(*data: Any) -> tuple[Any, ...]:
        *stated, g = data
        found, axes = solved(wishes, *_with_matrix(wishes, stated))  # starts at z
        return gradients(found, axes, g)

    M, q, lower, upper, z = kept
    by = _called(differentiate, _like(q, lower, upper), (2, 1, 1, 1, 1, 1), *kept, g)
    if wishes.M is not None:
        return jnp.zeros(M.shape), *by
    by_M = by[0][..., :, None] * z[..., None, :]
    shared = tuple(k for k in range(M.ndim - 2) if M.shape[k] == 1)
    return by_M.sum(shared, keepdims=True), *by


_solution.defvjp(_solution_forward, _solution_backward)


def _with_matrix(wishes: LayerOptions, data: Any) -> list[Any]:
    """Return the data, with None instead of M if M is a constant."""
    M, *vectors = data
    return [M if wishes.M is None else None, *vectors]


def _array(values: Any, name: str) -> Any:
    """Return the values as an array of doubles, constants as one of numpy; floats of another kind are rejected."""
    need = f"{name} must be an array of real numbers"
    if not isinstance(values, jax.Array):
        if not any(isinstance(part, jax.Array) for part in jax.tree.leaves(values)):
            return real_array(values, need)
        values = jnp.asarray(values)  # a list of them
    if values.dtype == np.float64:
        return values
    if jnp.issubdtype(values.dtype, jnp.floating):
        raise InvalidProblem(
            f"{name} must be an array of float64, got {values.dtype}; write {name}.astype(float)"
        )
    check_kind(values.dtype, need)
    return values.astype(np.float64)
