"""The solution of linear complementarity problems as a function of PyTorch: see ``help("lcp_plugin.learn")``."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

try:
    import torch
except ImportError:
    raise ImportError(
        "lcp_plugin.learn.torch needs PyTorch; install it with: pip install 'lcp_plugin[learn]'"
    ) from None

from ..algorithms import Algorithm
from ..checks import real_array
from ..errors import InvalidProblem, UnsupportedModel
from .batches import Wishes, common_axes, gradients, is_one, solved

__all__ = ["lcp_layer"]


def lcp_layer(
    M: Any, q: Any, lower: Any = 0.0, upper: Any = np.inf, *, algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-8, max_iterations: int | None = None, max_seconds: float | None = None,
    threads: int | None = None,
) -> torch.Tensor:
    """Return the solutions z of LCPs, differentiable by M, q, lower and upper.

    Parameters
    ----------
    M : tensor, shape (…, n, n), or a CSR tensor or scipy sparse array of shape (n, n)
        One of shape (n, n) stands for all. A scipy array is a constant.
    q : tensor, shape (…, n)
        Axes in front are those of a batch; all arguments broadcast. Tensors are float64, on the CPU.
    lower, upper : tensor, shape (…, n), or number
        A number is a constant.
    algorithm, tolerance, max_iterations, max_seconds, threads
        As in :func:`lcp_plugin.solve_batch`; max_seconds in seconds for the whole batch.

    Returns
    -------
    tensor, shape (…, n)

    Raises
    ------
    InvalidProblem
        For tensors of another type, place or shape, and numbers that are no problem.
    NotConverged
        Where a problem of the batch is not solved; it says which.

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
    options = {
        "algorithm": algorithm, "tolerance": tolerance, "max_iterations": max_iterations, "max_seconds": max_seconds,
        "threads": threads,
    }
    q, lower, upper = _tensor(q, "q"), _tensor(lower, "lower"), _tensor(upper, "upper")
    wishes, M = (Wishes(options, M), None) if sp.issparse(M) else (Wishes(options), _tensor(M, "M"))
    is_stack = M is not None and M.layout is torch.strided
    axes = common_axes(*(() if tensor is None else tuple(tensor.shape) for tensor in (M, q, lower, upper)))
    q, lower, upper = (vector.expand(*axes, q.shape[-1]) for vector in (q, lower, upper))
    if is_stack:
        M = M.reshape(M.shape[-2:]) if is_one(M) else M.expand(*axes, *M.shape[-2:])
    z: torch.Tensor = _Solution.apply(M, q, lower, upper, wishes)
    return z


class _Solution(torch.autograd.Function):  # type: ignore[misc]
    """z and its gradients; M of shape (n, n) or (…, n, n) with all axes of the batch, dense or CSR, or None."""

    @staticmethod
    def forward(ctx: Any, M: Any, q: Any, lower: Any, upper: Any, wishes: Wishes) -> Any:
        """Solve, and keep what the backward pass asks."""
        arrays = (vector.detach().numpy() for vector in (q, lower, upper))
        found, axes = solved(Wishes(wishes.options, _scipy(M)) if _is_csr(M) else wishes, _numpy(M), *arrays)
        ctx.found, ctx.axes = found, axes
        z = torch.from_numpy(found.z.reshape(q.shape).copy())
        ctx.save_for_backward(M, q, lower, upper, z)
        return z

    @staticmethod
    def backward(ctx: Any, g: Any) -> tuple[Any, ...]:
        """Return the gradients by all arguments."""
        given = ctx.saved_tensors  # torch refuses where one was changed in place: the solver reads M as it lies
        return *_Gradient.apply(ctx.found, ctx.axes, ctx.needs_input_grad[0], g, *given), None


class _Gradient(torch.autograd.Function):  # type: ignore[misc]
    """The gradients of z; their own derivatives are refused, whichever way they are asked for."""

    @staticmethod
    def forward(ctx: Any, found: Any, axes: Any, wants_entries: bool, g: Any, M: Any, *others: Any) -> tuple[Any, ...]:
        """Return the gradients by M, q, lower and upper; None for an M of which nobody asks."""
        by = [torch.from_numpy(array) for array in gradients(found, axes, g.detach().numpy())]
        return _by_entries(M, by[0], others[-1]) if wants_entries else None, *by

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        """Refuse."""
        raise UnsupportedModel(
            "a solution of an LCP has no second derivative here: z is piecewise smooth, and only its first derivative "
            "is computed; leave out create_graph, or detach the gradient"
        )


def _by_entries(M: Any, by_q: Any, z: Any) -> Any:
    """Return the gradient by the entries of M: ∂L/∂m_ij is ∂L/∂q_i z_j, summed where one M stands for all."""
    n = z.shape[-1]
    if _is_csr(M):
        entries = torch.zeros(M.values().numel(), dtype=z.dtype)
        rows = torch.repeat_interleave(torch.arange(n), M.crow_indices().diff())
        for left, right in zip(by_q.reshape(-1, n), z.reshape(-1, n), strict=True):
            entries += left[rows] * right[M.col_indices()]
        return torch.sparse_csr_tensor(M.crow_indices(), M.col_indices(), entries, M.shape)
    if M.ndim == 2:
        return by_q.reshape(-1, n).T @ z.reshape(-1, n)
    return by_q.unsqueeze(-1) * z.unsqueeze(-2)


def _tensor(values: Any, name: str) -> Any:
    """Return the values as a tensor of doubles on the CPU; what is a tensor of another kind is refused."""
    if not isinstance(values, torch.Tensor):
        return torch.from_numpy(real_array(values, f"{name} must be an array of real numbers").copy())
    if values.dtype is not torch.float64:
        raise InvalidProblem(f"{name} must be a tensor of float64, got {values.dtype}; write {name}.double()")
    if values.device.type != "cpu":
        raise InvalidProblem(f"{name} must be on the CPU, got {values.device}; write {name}.cpu()")
    if values.layout is torch.strided or (name == "M" and values.layout is torch.sparse_csr and values.ndim == 2):
        return values
    need = "dense, or one CSR tensor of shape (n, n)" if name == "M" else "dense"
    raise InvalidProblem(
        f"{name} must be {need}, got {values.layout} of shape {tuple(values.shape)}; "
        f"write {name}.{'to_sparse_csr' if name == 'M' and values.ndim == 2 else 'to_dense'}()"
    )


def _is_csr(M: Any) -> bool:
    return M is not None and M.layout is torch.sparse_csr


def _scipy(M: Any) -> Any:
    M = M.detach()
    return sp.csr_array((M.values().numpy(), M.col_indices().numpy(), M.crow_indices().numpy()), shape=tuple(M.shape))


def _numpy(M: Any) -> Any:
    return None if M is None or _is_csr(M) else M.detach().numpy()
