"""Shared part of both frameworks' layers: leading axes become one batch, which is solved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.errors import InvalidProblem, LCPError, NotConverged, UnsupportedModel
from ...problems.batches.batch import solve_batch
from ...problems.cones.frictional_contact import FrictionalContact
from ...problems.sensitivity import derivative
from ...problems.sensitivity.batch_derivative import BatchDerivative
from ...problems.sensitivity.contact_batch_derivative import ContactBatchDerivative


@dataclass(eq=False)
class LayerOptions:
    """Options of one call of a layer, and its derivative once it is found.

    Attributes
    ----------
    options : dict
        Options of :func:`lcp_plugin.solve_batch`.
    M : sparse array, shape (n, n), or None
        M if it is a constant of the layer.
    found : BatchDerivative or ContactBatchDerivative or None
        Derivative that PyTorch uses under any transformation of the call; JAX starts again from z.
    """

    options: Mapping[str, Any]
    M: Any = None
    found: BatchDerivative | ContactBatchDerivative | None = None


def common_axes(
    M: tuple[int, ...], q: tuple[int, ...], lower: tuple[int, ...] = (), upper: tuple[int, ...] = ()
) -> tuple[int, ...]:
    """Return the batch axes: all axes in front of the last one (of M: in front of the last two).

    Raises
    ------
    InvalidProblem
        If the axes do not broadcast, or a bound is not a number and has another length than q.

    Examples
    --------
    >>> common_axes((5, 1, 3, 3), (7, 3), (3,))
    (5, 7)
    """
    if not q:
        raise InvalidProblem("q must have shape (…, n), got a number")
    for name, shape in (("lower", lower), ("upper", upper)):
        if shape[-1:] not in ((), (1,), q[-1:]):
            raise InvalidProblem(
                f"{name} must be a number or have the length of q, {q[-1]}, got shape {shape}"
            )
    try:
        return np.broadcast_shapes(M[:-2], q[:-1], lower[:-1], upper[:-1])
    except ValueError:
        raise InvalidProblem(
            f"the axes in front of a problem's own must broadcast, got M {M}, q {q}, lower {lower}, upper {upper}"
        ) from None


def is_one(M: Any) -> bool:
    """Return whether an array or tensor of shape (…, n, n) is one matrix for all."""
    return bool(math.prod(M.shape[:-2]) == 1)


def solved(
    wishes: LayerOptions, M: Any, q: Any, lower: Any, upper: Any, z0: Any = None
) -> tuple[BatchDerivative, Any]:
    """Return the derivative of all solutions, and the axes of the batch.

    Parameters
    ----------
    wishes : LayerOptions
    M : array, shape (…, n, n), or None for ``wishes.M``
    q, lower, upper, z0 : array, shape (…, n)

    Raises
    ------
    InvalidProblem
        If numbers or shapes are not a valid problem.
    NotConverged
        If a problem is not solved.
    """
    axes = common_axes(
        () if M is None else M.shape, *(vector.shape for vector in (q, lower, upper))
    )

    def stacked(array: Any, own: tuple[int, ...]) -> Any:
        return np.broadcast_to(array, (*axes, *own)).reshape(math.prod(axes), *own)

    q, lower, upper, z0 = (
        None if one is None else stacked(one, q.shape[-1:]) for one in (q, lower, upper, z0)
    )
    if M is not None:
        M = M.reshape(M.shape[-2:]) if is_one(M) else stacked(M, M.shape[-2:])
    M = wishes.M if M is None else M
    answers = solve_batch(M, q, lower=lower, upper=upper, z0=z0, **wishes.options)
    found = derivative(answers)
    _check_solved(found, axes)
    return found, axes


def gradients(found: BatchDerivative, axes: tuple[int, ...], g: Any) -> tuple[Any, ...]:
    """Return the gradients by q and the bounds, each of the shape of g, (…, n) with the axes of the batch in front.

    Raises
    ------
    UnsuitableProblem
        If a problem that the loss depends on has no gradient.
    """
    rows = g.reshape(len(found), g.shape[-1])
    gradient = found.vjp(rows)
    wrong = {k: error for k, error in found.errors.items() if rows[k].any()}
    if wrong:
        raise _first(wrong, axes, type(next(iter(wrong.values()))))
    answers = gradient.q, gradient.lower, gradient.upper
    for one in answers:
        one[[*found.errors]] = 0.0  # the loss does not depend on them
    return tuple(one.reshape(g.shape) for one in answers)


def contacts_solved(
    wishes: LayerOptions, W: Any, b: Any, friction: Any, z0: Any = None
) -> ContactBatchDerivative:
    """Return the derivative of a batch of contact problems.

    Parameters
    ----------
    wishes : LayerOptions
        Options of FrictionalContact and of solve_batch.
    W, b, friction, z0 : array, shapes (B, n, n), (B, n), (B, k), (B, n)

    Raises
    ------
    InvalidProblem
        If numbers or shapes are not a valid problem.
    NotConverged
        If a problem is not solved.
    """
    of_worlds = {name: wishes.options.get(name) for name in ("contacts", "dimension")}
    others = {name: wish for name, wish in wishes.options.items() if name not in of_worlds}
    worlds = FrictionalContact.worlds(W, b, friction, **of_worlds)
    found: ContactBatchDerivative = derivative(solve_batch(worlds, z0=z0, **others))
    _check_solved(found, (len(found),))
    return found


def contact_gradients(found: ContactBatchDerivative, _: tuple[int, ...], g: Any) -> tuple[Any, ...]:
    """Return the gradients by W, b and friction, from the gradient by z, shape (B, n)."""
    gradient = found.vjp(g)
    return gradient.M, gradient.q, gradient.friction


def no_second_derivative(remedy: str) -> UnsupportedModel:
    """Return the error of who asks for one."""
    return UnsupportedModel(
        "a solution of an LCP has no second derivative here: z is piecewise smooth, and only its first derivative "
        f"is computed; {remedy}"
    )


def _check_solved(found: Any, axes: tuple[int, ...]) -> None:
    """Raise if a problem of the batch is not solved."""
    if found.errors:
        is_none = any(isinstance(error, InvalidProblem) for error in found.errors.values())
        raise _first(found.errors, axes, InvalidProblem if is_none else NotConverged)


def _first(errors: dict[int, LCPError], axes: tuple[int, ...], kind: type[LCPError]) -> LCPError:
    """Return an error that reports the first failed problem and the numbers of the others."""
    places = {k: tuple(map(int, np.unravel_index(k, axes))) for k in sorted(errors)}
    first, *others = places
    also = (
        f" (nor do {', '.join(str(places[k]) for k in others[:5])}{' …' if others[5:] else ''})"
        if others
        else ""
    )
    where = f"problem {places[first]} of the batch" if axes else "the problem"
    return kind(f"{where} gives the layer no solution to go on with{also}: {errors[first]}")
