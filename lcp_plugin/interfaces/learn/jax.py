"""The solution of linear complementarity problems as a function of JAX: see ``help("lcp_plugin.interfaces.learn")``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
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
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from ...core.algorithm import Algorithm
from ...core.checks import check_kind, real_array
from ...core.errors import InvalidOption, InvalidProblem
from .batches import (
    Wishes,
    common_axes,
    contact_gradients,
    contacts_solved,
    gradients,
    no_second_derivative,
    solved,
    tangents,
)

__all__ = ["contact_layer", "lcp_layer"]


def lcp_layer(
    M: Any,
    q: Any,
    lower: Any = 0.0,
    upper: Any = np.inf,
    *,
    algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
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
        Where JAX does not calculate in double precision.
    InvalidProblem
        For arrays of another type or shape, and numbers that are no problem.
    NotConverged
        Where a problem of the batch is not solved; it says which.
    UnsuitableProblem, UnsupportedModel
        Where a derivative does not exist; where a second one is asked for.

    Notes
    -----
    Derivatives go backwards and forwards: ``jax.grad``, ``jax.vjp``, ``jax.jacrev``; ``jax.jvp``, ``jax.jacfwd``.
    ``jit`` and ``vmap`` may stand around them, and a mapped axis is one more of the batch.

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
        "algorithm": algorithm,
        "tolerance": tolerance,
        "max_iterations": max_iterations,
        "max_seconds": max_seconds,
        "threads": threads,
    }
    q, lower, upper = _array(q, "q"), _array(lower, "lower"), _array(upper, "upper")
    wishes, M = (Wishes(options, M), None) if sp.issparse(M) else (Wishes(options), _array(M, "M"))
    axes = common_axes(*(() if array is None else array.shape for array in (M, q, lower, upper)))
    data = [_with_axes(vector, len(axes) + 1) for vector in (q, lower, upper)]
    if M is not None:
        data.insert(0, _with_axes(M, len(axes) + 2))
    z: jax.Array = _solution.bind(*data, wishes=wishes)[0]
    return z


def contact_layer(
    W: Any,
    b: Any,
    friction: Any,
    *,
    dimension: int | None = None,
    tolerance: float = 1e-8,
    max_seconds: float | None = None,
    threads: int | None = None,
) -> jax.Array:
    """Return the impulses z of worlds with contact and friction, differentiable by W, b and friction.

    Parameters
    ----------
    W, b, friction : array, shapes (…, n, n), (…, n) and (…, k)
        As of :class:`lcp_plugin.FrictionalContact`, float64; axes in front are those of worlds, and broadcast.
    dimension : int, optional
        d, 3 by default where the rows are a multiple of 3.
    tolerance, max_seconds, threads
        As in :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    array, shape (…, n)
        The velocities are W z + b.

    Raises
    ------
    InvalidOption
        Where JAX does not calculate in double precision.
    InvalidProblem, NotConverged
        As of `lcp_layer`.

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
    options = {
        "contacts": None,
        "dimension": dimension,
        "tolerance": tolerance,
        "max_seconds": max_seconds,
        "threads": threads,
    }
    z: jax.Array = _impulses(
        *(jnp.broadcast_to(one, (*axes, *shape)) for one, shape in own), Wishes(options)
    )
    return z


def _called(function: Callable[..., Any], like: Any, *data: Any) -> Any:
    """Call a function of arrays with one axis for all worlds, whatever axes stand in front of b's last."""

    def call(*data: Any) -> Any:
        axes = data[1].shape[:-1]
        stacked = [np.asarray(one).reshape(-1, *one.shape[len(axes) :]) for one in data]
        return jax.tree.map(lambda one: one.reshape(*axes, *one.shape[1:]), function(*stacked))

    return jax.pure_callback(call, like, *data, vmap_method="broadcast_all")


@partial(jax.custom_vjp, nondiff_argnums=(3,))
def _impulses(W: Any, b: Any, friction: Any, wishes: Wishes) -> Any:
    like = jax.ShapeDtypeStruct(b.shape, np.float64)
    return _called(
        lambda *data: np.array(contacts_solved(wishes, *data).batch.z), like, W, b, friction
    )


def _impulses_forward(W: Any, b: Any, friction: Any, wishes: Wishes) -> tuple[Any, Any]:
    z = _impulses(W, b, friction, wishes)
    return z, (W, b, friction, z)


def _impulses_backward(wishes: Wishes, kept: tuple[Any, ...], g: Any) -> tuple[Any, ...]:
    def differentiate(W: Any, b: Any, friction: Any, z: Any, g: Any) -> tuple[Any, ...]:
        return contact_gradients(
            contacts_solved(wishes, W, b, friction, z), (), g
        )  # it begins at its solution

    like = tuple(jax.ShapeDtypeStruct(one.shape, np.float64) for one in kept[:3])
    by: tuple[Any, ...] = _called(differentiate, like, *kept, g)
    return by


_impulses.defvjp(_impulses_forward, _impulses_backward)


def _array(values: Any, name: str) -> Any:
    """Return the values as an array of doubles, constants as one of numpy; floats of another kind are refused."""
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


def _with_axes(array: Any, count: int) -> Any:
    """Return the array with so many axes: what vmap puts in front must be the same one for all."""
    return (
        array
        if array.ndim >= count
        else array.reshape((*(1 for _ in range(count - array.ndim)), *array.shape))
    )


# --- three primitives: z, and its derivative forwards and backwards -------------------------------------------------


def _solve(M: Any, q: Any, lower: Any, upper: Any, *, wishes: Wishes) -> tuple[Any, ...]:
    found, axes = solved(wishes, M, q, lower, upper)
    return (found.z.reshape(*axes, q.shape[-1]),)


def _differentiate(
    function: Callable[..., tuple[Any, ...]],
    M: Any,
    q: Any,
    lower: Any,
    upper: Any,
    z: Any,
    *given: Any,
    wishes: Wishes,
) -> tuple[Any, ...]:
    """Return what a function of batches.py, linear in what is given, says at a solution."""
    return function(
        *solved(wishes, M, q, lower, upper, z), *given
    )  # it begins at its solution: one look says so


def _primitive(function: Callable[..., tuple[Any, ...]], count: int, linear: int) -> Primitive:
    """Return the primitive of JAX for a function of numpy arrays: at once, in compiled code, and mapped by vmap.

    Parameters
    ----------
    function : callable
        Takes M, q, lower, upper and more, and the keyword `wishes`.
    count : int
        How many arrays it returns, all of one shape.
    linear : int
        In how many of its arguments, the last ones, it is linear; they have that shape. None: those of the batch.
    """
    primitive = Primitive("lcp_layer")
    primitive.multiple_results = True

    def call(wishes: Wishes, *data: Any) -> tuple[Any, ...]:
        return function(*_with_matrix(wishes, map(np.asarray, data)), wishes=wishes)

    def shape(data: Sequence[Any], wishes: Wishes) -> Any:
        M, q, *bounds = (
            () if array is None else array.shape for array in _with_matrix(wishes, data)[:4]
        )
        return data[-1].shape if linear else common_axes(M, q, *bounds) + q[-1:]

    def compiled(*data: Any, wishes: Wishes) -> Any:
        like = jax.ShapeDtypeStruct(shape(data, wishes), np.float64)
        return jax.pure_callback(partial(call, wishes), (like,) * count, *data)

    def mapped(data: Sequence[Any], dims: Sequence[int | None], *, wishes: Wishes) -> Any:
        pairs = list(zip(data, dims, strict=True))
        size = next(array.shape[k] for array, k in pairs if k is not None)
        data = [array[None] if k is None else jnp.moveaxis(array, k, 0) for array, k in pairs]
        whole = [
            jnp.broadcast_to(array, (size, *array.shape[1:]))
            for array in data[len(data) - linear :]
        ]
        return primitive.bind(*data[: len(data) - linear], *whole, wishes=wishes), [0] * count

    primitive.def_impl(lambda *data, wishes: [jnp.asarray(array) for array in call(wishes, *data)])
    primitive.def_abstract_eval(
        lambda *data, wishes: [data[0].update(shape=shape(data, wishes))] * count
    )
    batching.primitive_batchers[primitive] = mapped
    mlir.register_lowering(primitive, mlir.lower_fun(compiled, multiple_results=True))
    return primitive


def _with_matrix(wishes: Wishes, data: Iterable[Any]) -> list[Any]:
    """Return the data with M in front, None where it is a constant."""
    return [*data] if wishes.M is None else [None, *data]


_solution = _primitive(_solve, 1, 0)
_tangent = _primitive(partial(_differentiate, tangents), 1, 3)
_gradient = _primitive(partial(_differentiate, gradients), 3, 1)


def _solution_jvp(data: Sequence[Any], moved: Sequence[Any], *, wishes: Wishes) -> tuple[Any, Any]:
    """Return z, and dz by dM z + dq and the changes of the bounds."""
    (z,) = _solution.bind(*data, wishes=wishes)
    by_M, *by = _with_matrix(wishes, moved)
    by = [
        np.broadcast_to(0.0, z.shape)
        if isinstance(one, ad.Zero)
        else jnp.broadcast_to(one, z.shape)
        for one in by
    ]
    if by_M is not None and not isinstance(by_M, ad.Zero):
        by[0] = by[0] + jnp.matmul(by_M, z[..., None])[..., 0]
    return [z], _tangent.bind(*data, z, *by, wishes=wishes)


def _linear_jvp(
    primitive: Primitive, linear: int, data: Any, moved: Any, *, wishes: Wishes
) -> tuple[Any, Any]:
    """Return the values, and their changes where only what they are linear in moves."""
    point, moved = data[:-linear], [*moved[:-linear], *map(ad.instantiate_zeros, moved[-linear:])]
    if not all(isinstance(one, ad.Zero) for one in moved[:-linear]):
        raise no_second_derivative(
            "put jax.lax.stop_gradient around the first, or take differences of it"
        )
    return primitive.bind(*data, wishes=wishes), primitive.bind(
        *point, *moved[-linear:], wishes=wishes
    )


def _transposed(
    other: Primitive, linear: int, g: Sequence[Any], *data: Any, wishes: Wishes
) -> list[Any]:
    """Return the gradients of a derivative by what it is linear in: the derivative the other way."""
    by = other.bind(*data[:-linear], *map(ad.instantiate_zeros, g), wishes=wishes)
    asked = [ad.is_undefined_primal(one) for one in data[-linear:]]
    return [None] * len(data[:-linear]) + [
        one if is_asked else None for one, is_asked in zip(by, asked, strict=True)
    ]


ad.primitive_jvps[_solution] = _solution_jvp
for _one, _other, _linear in ((_tangent, _gradient, 3), (_gradient, _tangent, 1)):
    ad.primitive_jvps[_one] = partial(_linear_jvp, _one, _linear)
    ad.primitive_transposes[_one] = partial(_transposed, _other, _linear)
