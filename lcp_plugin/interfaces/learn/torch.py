"""Solutions of linear complementarity problems as functions in PyTorch: see ``help("lcp_plugin.interfaces.learn")``."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

try:
    import torch
except ImportError:
    raise ImportError(
        "lcp_plugin.interfaces.learn.torch needs PyTorch; install it with: pip install 'lcp_plugin[learn]'"
    ) from None

from ...core.algorithm import Algorithm
from ...core.checks import real_array
from ...core.errors import InvalidProblem, UnsupportedModel
from .batches import (
    Wishes,
    common_axes,
    contact_gradients,
    contact_tangents,
    contacts_solved,
    gradients,
    is_one,
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
    UnsuitableProblem, UnsupportedModel
        Where a derivative does not exist; where a second one, or another transformation, is asked for.

    Notes
    -----
    ``torch.func`` and forward mode may stand around it, and an axis that is mapped is one more of the batch.
    ``torch.compile`` leaves it beside its graphs.

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
        "algorithm": algorithm,
        "tolerance": tolerance,
        "max_iterations": max_iterations,
        "max_seconds": max_seconds,
        "threads": threads,
    }
    if torch.compiler.is_compiling():  # torch shows the next line to whoever forbids graph breaks
        return torch.compiler.disable(_layer)(
            M, q, lower, upper, options
        )  # a graph break: leave out fullgraph=True
    return _layer(M, q, lower, upper, options)


def _layer(M: Any, q: Any, lower: Any, upper: Any, options: dict[str, Any]) -> Any:
    q, lower, upper = _tensor(q, "q"), _tensor(lower, "lower"), _tensor(upper, "upper")
    wishes, M = (Wishes(options, M), None) if sp.issparse(M) else (Wishes(options), _tensor(M, "M"))
    is_stack = M is not None and M.layout is torch.strided
    axes = common_axes(
        *(() if tensor is None else tuple(tensor.shape) for tensor in (M, q, lower, upper))
    )
    q, lower, upper = (vector.expand(*axes, q.shape[-1]) for vector in (q, lower, upper))
    if is_stack:
        M = M.reshape(M.shape[-2:]) if is_one(M) else M.expand(*axes, *M.shape[-2:])
    return _Solution.apply(M, q, lower, upper, wishes)


def contact_layer(
    W: Any,
    b: Any,
    friction: Any,
    *,
    contacts: Any = None,
    dimension: int | None = None,
    z0: Any = None,
    tolerance: float = 1e-8,
    max_seconds: float | None = None,
    threads: int | None = None,
) -> torch.Tensor:
    """Return the impulses z of many worlds with contact and friction, differentiable by W, b and friction.

    Parameters
    ----------
    W : tensor, shape (B, n, n) or (n, n)
        As of :class:`lcp_plugin.FrictionalContact`, float64, on the CPU, like the others; read where it lies.
    b : tensor, shape (B, n)
    friction : tensor, shape (B, k), (k,) or (), or number
    contacts, dimension
        As of :class:`lcp_plugin.FrictionalContact`.
    z0 : tensor, shape (B, n), optional
        Warm starts, constants.
    tolerance, max_seconds, threads
        As in :func:`lcp_plugin.solve_batch`.

    Returns
    -------
    tensor, shape (B, n)
        The velocities are W z + b.

    Raises
    ------
    InvalidProblem
        For tensors of another type, place or shape, and numbers that are no problem.
    NotConverged
        Where a world is not solved; it says which.

    Notes
    -----
    ``backward()`` and forward mode; a second derivative is refused, ``torch.func.vmap`` by torch. Where contacts are
    degenerate the gradient is one of several, see ``help(lcp_plugin.derivative)``.

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
    options = {
        "contacts": contacts,
        "dimension": dimension,
        "tolerance": tolerance,
        "max_seconds": max_seconds,
        "threads": threads,
    }
    if W.ndim == 2:
        W = W.expand(len(b), *W.shape)
    if friction.ndim == 1:
        friction = friction.expand(len(b), *friction.shape)
    return _Impulses.apply(W, b, friction, start, Wishes(options))


class _Impulses(torch.autograd.Function):  # type: ignore[misc]
    """z of many worlds with contact."""

    @staticmethod
    def forward(W: Any, b: Any, friction: Any, start: Any, run: Wishes) -> Any:
        """Solve."""
        run.found = contacts_solved(run, _numpy(W), _numpy(b), _numpy(friction), start)
        return torch.from_numpy(run.found.batch.z.copy())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], z: Any) -> None:
        """Keep what the derivatives ask."""
        *given, _, ctx.run = inputs
        ctx.has_one_friction = inputs[2].ndim == 0
        ctx.save_for_backward(*given, z)
        ctx.save_for_forward(*given, z)

    @staticmethod
    def backward(ctx: Any, g: Any) -> tuple[Any, ...]:
        """Return the gradients by all arguments."""
        *_, z = ctx.saved_tensors  # torch refuses where one was changed in place
        by_W, by_b, by_friction = _Derivative.apply(contact_gradients, ctx.run, None, z, g)
        return by_W, by_b, by_friction.sum() if ctx.has_one_friction else by_friction, None, None

    @staticmethod
    def jvp(ctx: Any, dW: Any, db: Any, dfriction: Any, *_: Any) -> Any:
        """Return the change of z."""
        *given, z = ctx.saved_tensors
        pairs = zip((dW, db, dfriction), given, strict=True)
        moved = [torch.zeros_like(one) if by is None else by for by, one in pairs]
        return _Derivative.apply(contact_tangents, ctx.run, None, z, *moved)[0]


class _Solution(torch.autograd.Function):  # type: ignore[misc]
    """z; M of shape (n, n) or (…, n, n) with as many axes in front as the others, dense or CSR, or None."""

    @staticmethod
    def forward(M: Any, q: Any, lower: Any, upper: Any, run: Wishes) -> Any:
        """Solve."""
        wishes, stack = (Wishes(run.options, _scipy(M)), None) if _is_csr(M) else (run, M)
        run.found, axes = solved(wishes, *map(_numpy, (stack, q, lower, upper)))
        return torch.from_numpy(run.found.z.reshape(*axes, q.shape[-1]).copy())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], z: Any) -> None:
        """Keep what the derivatives ask."""
        *given, ctx.run = inputs
        ctx.save_for_backward(*given, z)
        ctx.save_for_forward(z)

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[Any, ...], M: Any, q: Any, lower: Any, upper: Any, run: Wishes
    ) -> Any:
        """Solve with one axis more in front."""
        of_M, *dims, _ = in_dims
        vectors = [
            _in_front(*pair, info.batch_size) for pair in zip((q, lower, upper), dims, strict=True)
        ]
        if of_M is not None:
            M = M.movedim(of_M, 0)
            axes = (1,) * (vectors[0].ndim + 1 - M.ndim)
            M = M.reshape(M.shape[0], *axes, *M.shape[1:])
        return _Solution.apply(M, *vectors, run), 0

    @staticmethod
    def backward(ctx: Any, g: Any) -> tuple[Any, ...]:
        """Return the gradients by all arguments."""
        M, *_, z = (
            ctx.saved_tensors
        )  # torch refuses where one was changed in place: the solver reads M as it lies
        entries = _entries(M, z) if ctx.needs_input_grad[0] else None
        by_q, by_lower, by_upper, *by_M = _Derivative.apply(gradients, ctx.run, entries, z, g)
        if by_M and _is_csr(M):
            by_M = [torch.sparse_csr_tensor(M.crow_indices(), M.col_indices(), *by_M, M.shape)]
        return *(by_M or [None]), by_q, by_lower, by_upper, None

    @staticmethod
    def jvp(ctx: Any, dM: Any, dq: Any, dlower: Any, dupper: Any, _: Any) -> Any:
        """Return the change of z."""
        (z,) = ctx.saved_tensors
        change, *moved = (
            torch.zeros_like(z) if vector is None else vector for vector in (dq, dlower, dupper)
        )
        if dM is not None:
            change = change + (dM @ z.unsqueeze(-1)).squeeze(-1)
        return _Derivative.apply(tangents, ctx.run, None, z, change, *moved)[0]


class _Derivative(torch.autograd.Function):  # type: ignore[misc]
    """What a function of batches.py says at a solution z; a derivative of that is refused, whichever way."""

    @staticmethod
    def forward(
        function: Callable[..., Any],
        run: Wishes,
        entries: Callable[..., Any] | None,
        z: Any,
        *given: Any,
    ) -> tuple[Any, ...]:
        """Return the gradients by q, lower, upper and, where `entries` computes that, M; or the change of z, alone.

        All of it by numpy: an elementwise operation of torch wakes its threads, which then spin beside whatever runs.
        """
        answers = function(run.found, tuple(z.shape[:-1]), *map(_numpy, given))
        by_M = () if entries is None else (entries(answers[0], _numpy(z)),)
        return tuple(map(torch.from_numpy, (*answers, *by_M)))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], answers: tuple[Any, ...]) -> None:
        """Keep nothing."""

    @staticmethod
    def vmap(
        info: Any,
        in_dims: tuple[Any, ...],
        function: Any,
        run: Wishes,
        entries: Any,
        z: Any,
        *given: Any,
    ) -> Any:
        """Return them with one axis more in front."""
        _, _, _, of_z, *dims = in_dims
        z = z.unsqueeze(0) if of_z is None else z.movedim(of_z, 0)  # one z may have many gradients
        answers = _Derivative.apply(
            function,
            run,
            entries,
            z,
            *(_in_front(*pair, info.batch_size) for pair in zip(given, dims, strict=True)),
        )
        return answers, (0,) * len(answers)

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        """Refuse."""
        raise no_second_derivative("leave out create_graph, or detach the gradient")

    jvp = backward


def _in_front(tensor: Any, axis: int | None, size: int) -> Any:
    """Return the tensor with the axis that is mapped in front, as long as that is."""
    return tensor.expand(size, *tensor.shape) if axis is None else tensor.movedim(axis, 0)


def _entries(M: Any, z: Any) -> Callable[[Any, Any], Any]:
    """Return what computes the gradient by the entries of M: ∂L/∂m_ij is ∂L/∂q_i z_j, summed where one M is for all."""
    if not _is_csr(M):
        return partial(_by_entries, tuple(M.shape), z.ndim - 1)
    pattern = _scipy(M)
    return partial(
        _by_pattern, np.repeat(np.arange(z.shape[-1]), np.diff(pattern.indptr)), pattern.indices
    )


def _by_entries(shape: tuple[int, ...], own: int, by_q: Any, z: Any) -> Any:
    """Return it for a dense M of that shape and so many axes of a batch; vmap may have put more in front."""
    mapped, n = by_q.ndim - 1 - own, z.shape[-1]
    if len(shape) == 2:
        left, right = (
            rows.reshape(*rows.shape[:mapped], math.prod(rows.shape[mapped:-1]), n)
            for rows in (by_q, z)
        )
        return left.swapaxes(-1, -2) @ right
    products = by_q[..., :, np.newaxis] * z[..., np.newaxis, :]
    same = tuple(mapped + k for k, size in enumerate(shape[:-2]) if size == 1)
    return products.sum(same, keepdims=True) if same else products


def _by_pattern(rows: Any, columns: Any, by_q: Any, z: Any) -> Any:
    """Return it for a CSR tensor with entries in these places."""
    n, total = z.shape[-1], np.zeros(rows.size)
    for left, right in zip(by_q.reshape(-1, n), z.reshape(-1, n), strict=True):
        total += left[rows] * right[columns]
    return total


def _tensor(values: Any, name: str) -> Any:
    """Return the values as a tensor of doubles on the CPU; what is a tensor of another kind is refused."""
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
    if name == "M" and values.layout is torch.sparse_csr and values.ndim == 2:
        return _readable(values)
    need = "dense, or one CSR tensor of shape (n, n)" if name == "M" else "dense"
    raise InvalidProblem(
        f"{name} must be {need}, got {values.layout} of shape {tuple(values.shape)}; "
        f"write {name}.{'to_sparse_csr' if name == 'M' and values.ndim == 2 else 'to_dense'}()"
    )


def _readable(M: Any) -> Any:
    """Return a CSR tensor, or say what to write where torch hides its entries."""
    try:
        M.crow_indices()
    except RuntimeError as error:
        raise UnsupportedModel(
            "M is a CSR tensor, and torch.func cannot differentiate beside one; give a scipy array, which is a "
            "constant, or a dense tensor, or call backward()"
        ) from error
    return M


def _is_csr(M: Any) -> bool:
    return M is not None and M.layout is torch.sparse_csr


def _scipy(M: Any) -> Any:
    M = M.detach()
    return sp.csr_array(
        (M.values().numpy(), M.col_indices().numpy(), M.crow_indices().numpy()),
        shape=tuple(M.shape),
    )


def _numpy(tensor: Any) -> Any:
    try:
        return None if tensor is None else tensor.detach().numpy()
    except RuntimeError as error:  # the vmap of before torch.func
        raise UnsupportedModel(
            "the layer was given a tensor that torch does not let it read, as under vectorize=True or "
            f"is_grads_batched=True: write torch.func.jacrev or torch.func.vmap instead ({error})"
        ) from error
