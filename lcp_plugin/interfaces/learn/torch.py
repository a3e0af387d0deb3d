"""Solutions of linear complementarity problems as functions in PyTorch: see ``help("lcp_plugin.interfaces.learn")``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

try:
    import torch
except ImportError:
    raise ImportError(
        "lcp_plugin.interfaces.learn.torch needs PyTorch; install it with: pip install 'lcp_plugin[learn]'"
    ) from None

from ...core.checks import real_array
from ...core.errors import InvalidProblem, UnsupportedModel
from .batches import (
    LayerOptions,
    common_axes,
    contact_gradients,
    contacts_solved,
    gradients,
    is_one,
    no_second_derivative,
    solved,
)

__all__ = ["contact_layer", "lcp_layer"]


def lcp_layer(
    M: Any, q: Any, lower: Any = 0.0, upper: Any = np.inf, **options: Any
) -> torch.Tensor:
    """Return the solutions z of LCPs, differentiable by M, q, lower and upper.

    Parameters
    ----------
    M : tensor, shape (…, n, n), or a scipy sparse array of shape (n, n)
        One of shape (n, n) stands for all. A scipy array is a constant.
    q : tensor, shape (…, n)
        Leading axes are batch axes; all arguments broadcast. Tensors are float64, on the CPU.
    lower, upper : tensor, shape (…, n), or number
        A number is a constant.
    **options
        ``algorithm``, ``tolerance``, ``max_seconds``, … of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    tensor, shape (…, n)

    Raises
    ------
    InvalidProblem
        If a tensor has another type, device or shape, or its numbers are not a valid problem.
    NotConverged
        If a problem of the batch is not solved; the message names it.
    UnsuitableProblem, UnsupportedModel
        If a derivative does not exist, or if a second derivative or another transformation is requested.

    Notes
    -----
    Gradients go backward: ``backward()``, ``torch.func.grad`` and ``torch.func.vjp``.

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
    q, lower, upper = _tensor(q, "q"), _tensor(lower, "lower"), _tensor(upper, "upper")
    wishes, M = (
        (LayerOptions(options, M), None)
        if sp.issparse(M)
        else (LayerOptions(options), _tensor(M, "M"))
    )
    axes = common_axes(
        *(() if tensor is None else tuple(tensor.shape) for tensor in (M, q, lower, upper))
    )
    q, lower, upper = (vector.expand(*axes, q.shape[-1]) for vector in (q, lower, upper))
    if M is not None:
        M = M.reshape(M.shape[-2:]) if is_one(M) else M.expand(*axes, *M.shape[-2:])
    return _Solution.apply(M, q, lower, upper, wishes)


def contact_layer(W: Any, b: Any, friction: Any, *, z0: Any = None, **options: Any) -> torch.Tensor:
    """Return the impulses z of many contact problems, differentiable by W, b and friction.

    Parameters
    ----------
    W : tensor, shape (B, n, n) or (n, n)
        Matrix of :class:`lcp_plugin.FrictionalContact`, float64, on the CPU, like the other tensors; it is not copied.
    b : tensor, shape (B, n)
    friction : tensor, shape (B, k), (k,) or (), or number
    z0 : tensor, shape (B, n), optional
        Warm starts, constants.
    **options
        ``contacts`` and ``dimension`` of :class:`lcp_plugin.FrictionalContact`; ``tolerance``, ``max_seconds``,
        ``threads`` of :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    tensor, shape (B, n)
        The velocities are W z + b.

    Raises
    ------
    InvalidProblem
        If a tensor has another type, device or shape, or its numbers are not a valid problem.
    NotConverged
        If an instance is not solved; the message names it.

    Notes
    -----
    Gradients go backward, once. If contacts are degenerate, the gradient is one of several: see
    ``help(lcp_plugin.derivative)``.

    Examples
    --------
    >>> b = torch.tensor([[-1.0, 3.0, 4.0]], dtype=torch.float64)
    >>> friction = torch.tensor([0.5], dtype=torch.float64, requires_grad=True)
    >>> z = contact_layer(torch.eye(3, dtype=torch.float64), b, friction)
    >>> (z[0, 1] * 3.0 + z[0, 2] * 4.0).backward()
    >>> round(friction.grad.item(), 6)
    -5.0
    """
    W, b, friction = _tensor(W, "W"), _tensor(b, "b"), _tensor(friction, "friction")
    start = None if z0 is None else _numpy(_tensor(z0, "z0"))
    if b.ndim != 2 or W.ndim not in (2, 3):
        raise InvalidProblem(
            f"W must have shape (B, n, n) or (n, n), and b (B, n), got {tuple(W.shape)} and {tuple(b.shape)}"
        )
    if W.ndim == 2:
        W = W.expand(len(b), *W.shape)
    if friction.ndim == 1:
        friction = friction.expand(len(b), *friction.shape)
    return _Impulses.apply(W, b, friction, start, LayerOptions(options))


class _Impulses(torch.autograd.Function):  # type: ignore[misc]
    """Impulses z of a batch of contact problems."""

    @staticmethod
    def forward(W: Any, b: Any, friction: Any, start: Any, run: LayerOptions) -> Any:
        """Solve."""
        run.found = contacts_solved(run, _numpy(W), _numpy(b), _numpy(friction), start)
        return torch.from_numpy(run.found.batch.z.copy())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], z: Any) -> None:
        """Keep the data of the derivative."""
        *given, _, ctx.run = inputs
        ctx.has_one_friction = inputs[2].ndim == 0
        ctx.save_for_backward(*given, z)

    @staticmethod
    def backward(ctx: Any, g: Any) -> tuple[Any, ...]:
        """Return the gradients by all arguments."""
        *_, z = ctx.saved_tensors  # torch raises an error if one was changed in place
        by_W, by_b, by_friction = _Gradient.apply(contact_gradients, ctx.run, z, g)
        return by_W, by_b, by_friction.sum() if ctx.has_one_friction else by_friction, None, None


class _Solution(torch.autograd.Function):  # type: ignore[misc]
    """Solutions z; M of shape (n, n), or (…, n, n) with as many axes in front as the vectors, or None."""

    @staticmethod
    def forward(M: Any, q: Any, lower: Any, upper: Any, run: LayerOptions) -> Any:
        """Solve."""
        run.found, axes = solved(run, *map(_numpy, (M, q, lower, upper)))
        return torch.from_numpy(run.found.z.reshape(*axes, q.shape[-1]).copy())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], z: Any) -> None:
        """Keep the data of the derivative."""
        *given, ctx.run = inputs
        ctx.save_for_backward(*given, z)

    @staticmethod
    def backward(ctx: Any, g: Any) -> tuple[Any, ...]:
        """Return the gradients by all arguments."""
        M, *_, z = ctx.saved_tensors  # torch raises an error if one was changed in place
        by_q, by_lower, by_upper = _Gradient.apply(gradients, ctx.run, z, g)
        by_M = None
        if ctx.needs_input_grad[0]:  # ∂L/∂m_ij is ∂L/∂q_i z_j, summed if one M is for all
            by_M = by_q.unsqueeze(-1) * z.unsqueeze(-2)
            by_M = by_M.sum_to_size(M.shape)
        return by_M, by_q, by_lower, by_upper, None


class _Gradient(torch.autograd.Function):  # type: ignore[misc]
    """Gradients by a function of batches.py at a solution z; a derivative of them is rejected."""

    @staticmethod
    def forward(function: Callable[..., Any], run: LayerOptions, z: Any, g: Any) -> tuple[Any, ...]:
        """Return the gradients."""
        return tuple(map(torch.from_numpy, function(run.found, tuple(z.shape[:-1]), _numpy(g))))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], answers: tuple[Any, ...]) -> None:
        """Keep nothing."""

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        """Reject."""
        raise no_second_derivative("leave out create_graph, or detach the gradient")


def _tensor(values: Any, name: str) -> Any:
    """Return the values as a tensor of doubles on the CPU; what is a tensor of another kind is rejected."""
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
        return None if tensor is None else tensor.detach().numpy()
    except RuntimeError as error:  # within vmap
        raise UnsupportedModel(
            "the layer was given a tensor that torch does not let it read, as under torch.func.vmap: give it the "
            f"axes of the batch in front ({error})"
        ) from error
