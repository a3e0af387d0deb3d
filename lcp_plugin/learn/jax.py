"""The solution of linear complementarity problems as a function of JAX: see ``help("lcp_plugin.learn")``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

try:
    import jax
except ImportError:
    raise ImportError("lcp_plugin.learn.jax needs JAX; install it with: pip install 'lcp_plugin[learn]'") from None

import jax.numpy as jnp

from ..algorithms import Algorithm
from ..errors import InvalidOption, InvalidProblem
from .batches import Wishes, common_axes, gradients, is_one, solved

__all__ = ["lcp_layer"]


def lcp_layer(
    M: Any, q: Any, lower: Any = 0.0, upper: Any = np.inf, *, algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-8, max_iterations: int | None = None, max_seconds: float | None = None,
    threads: int | None = None,
) -> jax.Array:
    """Return the solutions z of LCPs, differentiable by M, q, lower and upper.

    Parameters
    ----------
    M : array, shape (…, n, n), or a scipy sparse array of shape (n, n)
        One of shape (n, n) stands for all. A scipy array is a constant.
    q : array, shape (…, n)
        Axes in front are those of a batch; all arguments broadcast. Arrays of JAX are float64.
    lower, upper : array, shape (…, n), or number
    algorithm, tolerance, max_iterations, max_seconds, threads
        As in :func:`lcp_plugin.solve_batch`; max_seconds in seconds for the whole batch.

    Returns
    -------
    array, shape (…, n)

    Raises
    ------
    InvalidOption
        Where JAX has not been told to calculate in double precision.
    InvalidProblem
        For arrays of another type or shape, and numbers that are no problem.
    NotConverged
        Where a problem of the batch is not solved; it says which.

    Notes
    -----
    Derivatives go backwards: ``jax.grad``, ``jax.vjp``, ``jax.jacrev``. ``jit`` and ``vmap`` may stand around them, and
    a mapped axis is one more of the batch.

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
    options = {
        "algorithm": algorithm, "tolerance": tolerance, "max_iterations": max_iterations, "max_seconds": max_seconds,
        "threads": threads,
    }
    q, lower, upper = _array(q, "q"), _array(lower, "lower"), _array(upper, "upper")
    wishes, M = (Wishes(options, M), None) if sp.issparse(M) else (Wishes(options), _array(M, "M"))
    axes = common_axes(*(() if array is None else array.shape for array in (M, q, lower, upper)))
    q, lower, upper = (jnp.broadcast_to(vector, (*axes, q.shape[-1])) for vector in (q, lower, upper))
    if M is not None:  # as many axes as the others, so that one that vmap puts in front is the same for all
        shape = (*(1 for _ in axes), *M.shape[-2:]) if is_one(M) else (*axes, *M.shape[-2:])
        M = M.reshape(shape) if is_one(M) else jnp.broadcast_to(M, shape)
    z: jax.Array = _solution(wishes, M, q, lower, upper)
    return z


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _solution(wishes: Wishes, M: Any, q: Any, lower: Any, upper: Any) -> Any:
    """Return z; M of shape (1, …, n, n) or (…, n, n) with all axes of the batch, or None."""
    return _in_numpy(partial(_solve, wishes), _like(q), M, q, lower, upper)


def _forward(wishes: Wishes, *data: Any) -> tuple[Any, Any]:
    z = _solution(wishes, *data)
    return z, (*data, z)


def _backward(wishes: Wishes, kept: Any, g: Any) -> tuple[Any, ...]:
    M, z = kept[0], kept[-1]
    by = _in_numpy(partial(_differentiate, wishes), (_like(z),) * 3, *kept, g)
    return None if M is None else _by_entries(M, by[0], z), *by


_solution.defvjp(_forward, _backward)


def _solve(wishes: Wishes, *data: Any) -> Any:
    found, axes = solved(wishes, *data)
    return found.z.reshape(*axes, found.z.shape[-1])


def _differentiate(wishes: Wishes, M: Any, q: Any, lower: Any, upper: Any, z: Any, g: Any) -> Any:
    found, axes = solved(wishes, M, q, lower, upper, z)  # it begins at its solution: one look says so
    every = np.broadcast_shapes(axes, g.shape[:-1])
    by = tuple(np.empty((*every, g.shape[-1])) for _ in range(3))
    ours = [mine == whole for mine, whole in zip(axes, every, strict=True)]
    for place in np.ndindex(*(1 if own else whole for own, whole in zip(ours, every, strict=True))):  # many g, one z
        at = tuple(slice(None) if own else slice(k, k + 1) for own, k in zip(ours, place, strict=True))
        for whole, part in zip(by, gradients(found, axes, g[at]), strict=True):
            whole[at] = part
    return by


def _by_entries(M: Any, by_q: Any, z: Any) -> Any:
    """Return the gradient by the entries of M: ∂L/∂m_ij is ∂L/∂q_i z_j, summed where one M stands for all."""
    if is_one(M):
        n = z.shape[-1]
        return (by_q.reshape(-1, n).T @ z.reshape(-1, n)).reshape(M.shape)
    return by_q[..., :, None] * z[..., None, :]


def _array(values: Any, name: str) -> Any:
    """Return the values as an array of doubles; floats of another kind are refused."""
    if isinstance(values, jax.Array) and jnp.issubdtype(values.dtype, jnp.floating) and values.dtype != jnp.float64:
        raise InvalidProblem(f"{name} must be an array of float64, got {values.dtype}; write {name}.astype(float)")
    if np.iscomplexobj(values):
        raise InvalidProblem(f"{name} must be an array of real numbers, got complex ones; give the real part")
    return jnp.asarray(values, dtype=jnp.float64)


def _like(array: Any) -> Any:
    return jax.ShapeDtypeStruct(array.shape, array.dtype)


def _in_numpy(function: Callable[..., Any], like: Any, *data: Any) -> Any:
    """Return what a function of numpy arrays gives: at once where the numbers are there, so that its errors arrive."""
    def call(*data: Any) -> Any:
        return function(*(None if array is None else np.asarray(array) for array in data))

    if any(isinstance(array, jax.core.Tracer) for array in data):
        return jax.pure_callback(call, like, *data, vmap_method="expand_dims")
    return jax.tree.map(jnp.asarray, call(*data))
