"""Solutions of linear complementarity problems as functions in PyTorch: see ``help("lcp_plugin.interfaces.learn")``."""

from __future__ import annotations

from typing import Any

import numpy as np

try:
    import torch
except ImportError:
    raise ImportError(
        "lcp_plugin.interfaces.learn.torch needs PyTorch; install it with: pip install torch "
        "(or lcp_plugin[torch])"
    ) from None

from ...core.checks import AnyMatrix, Array, real_array
from ...core.errors import InvalidProblem, UnsupportedModel
from . import ContactLayer, Layer, LayerCall, LCPLayer, QPLayer

__all__ = ["contact_layer", "lcp_layer", "qp_layer"]


def lcp_layer(
    M: Any, q: Any, lower: Array = 0.0, upper: Array = np.inf, *, mask: bool = False, **options: Any
) -> Any:
    """Return the solutions z of LCPs, differentiable by M, q, lower and upper.

    Parameters
    ----------
    M : tensor, shape (…, n, n), or a scipy sparse array of shape (n, n)
        One of shape (n, n) stands for all. A scipy array is a constant.
    q : tensor, shape (…, n)
        Leading axes are batch axes; all arguments broadcast. Tensors are float64, on the CPU.
    lower, upper : tensor, shape (…, n), or number
        A number is a constant.
    mask : bool
        If True, return the pair (z, is_solved). An instance that is not solved then has z = 0 and the gradient 0,
        instead of an error for the entire batch.
    **options
        ``algorithm``, ``tolerance``, ``max_seconds``, … of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    tensor, shape (…, n), or with `mask` a pair of it and a tensor of bool, shape (…)

    Raises
    ------
    InvalidProblem
        If a tensor has another type, device or shape, or its numbers are not a valid problem.
    NotConverged
        If a problem of the batch is not solved, without `mask`; the message names it.
    UnsuitableProblem, UnsupportedModel
        If a derivative does not exist, or if a second derivative or another transformation is requested.

    Examples
    --------
    >>> M = torch.tensor([[2.0, 1.0], [1.0, 2.0]], dtype=torch.float64)
    >>> q = torch.tensor([[-5.0, 1.0], [1.0, -4.0]], dtype=torch.float64, requires_grad=True)
    >>> z = lcp_layer(M, q)
    >>> z.tolist()
    [[2.5, 0.0], [0.0, 2.0]]
    >>> z.sum().backward()
    >>> q.grad.tolist()
    [[-0.5, 0.0], [0.0, -0.5]]
    """
    return _solutions(LCPLayer.of(_tensor, M, q, (lower, upper), mask=mask, **options))


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
    **options: Any,
) -> Any:
    """Return the solutions x of quadratic programs, differentiable by all data.

    Parameters
    ----------
    P, c, G, h, A, b : tensor, shapes (…, n, n), (…, n), (…, m, n), (…, m), (…, p, n) and (…, p)
        min ½ xᵀP x + cᵀx subject to G x ≤ h, A x = b; no rows by default, or with an empty tensor. Leading axes are
        batch axes; all arguments broadcast. Float64, on the CPU. Only the symmetric part of P matters; it must be
        positive semidefinite. None as P is a linear program.
    lower, upper : tensor, shape (…, n), or number
    mask : bool
        As in `lcp_layer`.
    **options
        ``algorithm``, ``tolerance``, ``max_seconds``, ``threads`` of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    tensor, shape (…, n), or with `mask` a pair of it and a tensor of bool, shape (…)

    Raises
    ------
    InvalidProblem, NotConverged, UnsuitableProblem, UnsupportedModel
        For the reasons that `lcp_layer` names.

    Examples
    --------
    >>> P = torch.eye(2, dtype=torch.float64)
    >>> c = torch.tensor([[-1.0, -2.0], [-1.0, -0.5]], dtype=torch.float64, requires_grad=True)
    >>> G, h = torch.ones(1, 2, dtype=torch.float64), torch.tensor([2.0], dtype=torch.float64)
    >>> x = qp_layer(P, c, G, h)
    >>> x.detach().round(decimals=6).tolist()
    [[0.5, 1.5], [1.0, 0.5]]
    >>> x[:, 0].sum().backward()
    >>> c.grad.round(decimals=6).tolist()
    [[-0.5, 0.5], [-1.0, 0.0]]
    """
    data = dict(P=P, c=c, G=G, h=h, A=A, b=b, lower=lower, upper=upper)
    return _solutions(QPLayer.of(_tensor, data, mask=mask, **options))


def contact_layer(
    W: AnyMatrix, b: Array, friction: Array, *, z0: Array = None, mask: bool = False, **options: Any
) -> Any:
    """Return the impulses z of many contact problems, differentiable by W, b and friction.

    Parameters
    ----------
    W, b, friction : tensor, shapes (…, n, n), (…, n) and (…, k); friction also number
        Arguments of :class:`lcp_plugin.FrictionalContact`, float64, on the CPU. Leading axes are batch axes, and
        broadcast. W is not copied.
    z0 : tensor, shape (B, n), optional
        Warm starts, constants.
    mask : bool
        As in `lcp_layer`.
    **options
        ``contacts``, ``dimension``, ``equations`` of :class:`lcp_plugin.FrictionalContact`; ``tolerance``,
        ``max_seconds``, ``threads`` of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    tensor, shape (…, n), or with `mask` a pair of it and a tensor of bool, shape (…)
        The velocities are W z + b.

    Raises
    ------
    InvalidProblem, NotConverged
        For the reasons that `lcp_layer` names.

    Examples
    --------
    >>> b = torch.tensor([[-1.0, 3.0, 4.0]], dtype=torch.float64)
    >>> friction = torch.tensor([0.5], dtype=torch.float64, requires_grad=True)
    >>> z = contact_layer(torch.eye(3, dtype=torch.float64), b, friction)
    >>> (z[0, 1] * 3.0 + z[0, 2] * 4.0).backward()
    >>> round(friction.grad.item(), 6)
    -5.0
    """
    if z0 is not None:
        options["z0"] = _numpy(_tensor(z0, "z0"))
    return _solutions(ContactLayer.of(_tensor, W, b, friction, mask=mask, **options))


def _solutions(call: LayerCall) -> Any:
    """Return the solutions, with a mask if the layer has one."""
    layer, data = call
    solution = _Solution.apply(layer, *data)
    return solution if layer.mask else solution[0]


class _Solution(torch.autograd.Function):  # type: ignore[misc]
    """Solutions z of a layer of problems as a function of its arrays."""

    @staticmethod
    def forward(layer: Layer, *data: Any) -> Any:
        """Solve."""
        z, is_solved = layer.solve(*map(_numpy, data))
        return torch.from_numpy(z), torch.from_numpy(np.array(is_solved))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], outputs: tuple[Any, Any]) -> None:
        """Keep the layer, which has the derivative."""
        ctx.layer, *data = inputs
        z, is_solved = outputs
        ctx.mark_non_differentiable(is_solved)
        ctx.save_for_backward(*data, z)

    @staticmethod
    def backward(ctx: Any, g: Array, _: object) -> tuple[Any, ...]:
        """Return the gradients by all arguments."""
        *_, z = ctx.saved_tensors  # torch raises an error if one was changed in place
        return None, *_Gradient.apply(ctx.layer, z, g)


class _Gradient(torch.autograd.Function):  # type: ignore[misc]
    """Gradients of a layer at a solution z; a derivative of them is rejected."""

    @staticmethod
    def forward(layer: Layer, z: Array, g: Array) -> tuple[Any, ...]:
        """Return the gradients."""
        return tuple(map(torch.from_numpy, layer.gradients(_numpy(g))))

    @staticmethod
    def setup_context(ctx: object, inputs: tuple[Any, ...], answers: tuple[Any, ...]) -> None:
        """Keep nothing."""

    @staticmethod
    def backward(ctx: object, *_: Any) -> Any:
        """Reject."""
        raise UnsupportedModel(
            "a solution of an LCP has no second derivative here: z is piecewise smooth, and only its first derivative "
            "is computed; leave out create_graph, or detach the gradient"
        )


def _tensor(values: Array, name: str) -> Any:
    """Return the values as a float64 tensor on the CPU; other tensors are rejected."""
    if not isinstance(values, torch.Tensor):
        return torch.from_numpy(
            real_array(values, f"{name} must be an array of real numbers").copy()
        )
    if values.dtype is not torch.float64:
        raise InvalidProblem(
            f"{name} must be a tensor of float64, got {values.dtype}; write {name}.double()"
        )
    if values.device.type != "cpu":
        raise InvalidProblem(f"{name} must be on the CPU, got {values.device}; write {name}.cpu()")
    if values.layout is torch.strided:
        return values
    raise InvalidProblem(
        f"{name} must be dense, got {values.layout} of shape {tuple(values.shape)}; write {name}.to_dense(), "
        "or give a scipy array as M, which is a constant"
    )


def _numpy(tensor: Any) -> Any:
    try:
        return tensor.detach().numpy()
    except RuntimeError as error:  # within vmap
        raise UnsupportedModel(
            "the layer was given a tensor that torch does not let it read, as under torch.func.vmap: give it the "
            f"axes of the batch in front ({error})"
        ) from error
