"""What the layers of both frameworks share: axes in front made one batch, solved, or refused in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InvalidProblem, LCPError, NotConverged
from ..solving.batch import solve_batch
from ..solving.batch_derivative import BatchDerivative
from ..solving.derivative import derivative


@dataclass(frozen=True, eq=False)
class Wishes:
    """How a layer solves.

    Attributes
    ----------
    options : dict
        What :func:`lcp_plugin.solve_batch` takes.
    M : sparse array, shape (n, n), or None
        Where it is a constant of the layer.
    """

    options: Mapping[str, Any]
    M: Any = None


def common_axes(
    M: tuple[int, ...], q: tuple[int, ...], lower: tuple[int, ...] = (), upper: tuple[int, ...] = ()
) -> tuple[int, ...]:
    """Return the axes of the batch, from the shapes: those in front of the last one, of M of the last two.

    Raises
    ------
    InvalidProblem
        Where they do not broadcast, or a bound is no number and has another length than q.

    Examples
    --------
    >>> common_axes((5, 1, 3, 3), (7, 3), (3,))
    (5, 7)
    """
    if not q:
        raise InvalidProblem("q must have shape (…, n), got a number")
    for name, shape in (("lower", lower), ("upper", upper)):
        if shape[-1:] not in ((), (1,), q[-1:]):
            raise InvalidProblem(f"{name} must be a number or have the length of q, {q[-1]}, got shape {shape}")
    sizes = {"M": M, "q": q, "lower": lower, "upper": upper}
    try:
        return np.broadcast_shapes(M[:-2], q[:-1], lower[:-1], upper[:-1])
    except ValueError:
        shapes = ", ".join(f"{name} {shape}" for name, shape in sizes.items())
        raise InvalidProblem(f"the axes in front of a problem's own must broadcast, got {shapes}") from None


def is_one(M: Any) -> bool:
    """Return whether an array or tensor of shape (…, n, n) is one matrix for all."""
    return bool(math.prod(M.shape[:-2]) == 1)


def solved(wishes: Wishes, M: Any, q: Any, lower: Any, upper: Any, z0: Any = None) -> tuple[BatchDerivative, Any]:
    """Return the derivative of all solutions, and the axes of the batch.

    Parameters
    ----------
    wishes : Wishes
    M : array, shape (…, n, n), or None for that of the wishes
    q, lower, upper, z0 : array, shape (…, n)

    Raises
    ------
    InvalidProblem
        For numbers and shapes that are no problem.
    NotConverged
        Where one is not solved.
    """
    n = q.shape[-1]
    axes = common_axes(() if M is None else M.shape, *(vector.shape for vector in (q, lower, upper)))
    count = math.prod(axes)
    q, lower, upper = (np.broadcast_to(vector, (*axes, n)).reshape(count, n) for vector in (q, lower, upper))
    if M is None:
        M = wishes.M
    elif is_one(M):
        M = M.reshape(M.shape[-2:])
    else:
        M = np.broadcast_to(M, (*axes, *M.shape[-2:])).reshape(count, *M.shape[-2:])
    start = None if z0 is None else np.broadcast_to(z0, (*axes, n)).reshape(count, n)
    found = derivative(solve_batch(M, q, lower=lower, upper=upper, z0=start, **wishes.options))
    if found.errors:
        is_none = any(isinstance(error, InvalidProblem) for error in found.errors.values())
        raise _first(found.errors, axes, InvalidProblem if is_none else NotConverged)
    return found, axes


def gradients(found: BatchDerivative, axes: tuple[int, ...], g: Any) -> tuple[Any, Any, Any]:
    """Return the gradients by q and the bounds, each of shape (…, n).

    Raises
    ------
    UnsuitableProblem
        Where a block of M on the free rows is singular, of a problem that the loss looks at.
    """
    shape = (*axes, g.shape[-1])
    g = np.broadcast_to(g, shape).reshape(len(found), g.shape[-1])
    by = found.vjp(g)
    wrong = {k: error for k, error in found.errors.items() if g[k].any()}  # of the others nothing is asked
    if wrong:
        raise _first(wrong, axes, type(next(iter(wrong.values()))))
    return by.q.reshape(shape), by.lower.reshape(shape), by.upper.reshape(shape)


def _first(errors: dict[int, LCPError], axes: tuple[int, ...], kind: type[LCPError]) -> LCPError:
    """Return an error of that kind, which says what is wrong with the first problem, and where others are."""
    places = {k: tuple(map(int, np.unravel_index(k, axes))) for k in sorted(errors)}
    first, *others = places
    also = f" (nor do {', '.join(str(places[k]) for k in others[:5])}{' …' if others[5:] else ''})" if others else ""
    where = f"problem {places[first]} of the batch" if axes else "the problem"
    return kind(f"{where} gives the layer no solution to go on with{also}: {errors[first]}")
