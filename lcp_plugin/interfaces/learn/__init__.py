"""Layers for PyTorch and JAX: z(M, q, lower, upper) with exact gradients, batched. Needs the extra ``[learn]``.

The layers run on the CPU. The CPU build of PyTorch is sufficient and much smaller.

In PyTorch::

    import torch
    from lcp_plugin.interfaces.learn.torch import lcp_layer

    M = torch.tensor([[2.0, 1.0], [1.0, 2.0]], dtype=torch.float64, requires_grad=True)
    q = torch.tensor([[-5.0, 1.0], [1.0, -4.0]], dtype=torch.float64)
    z = lcp_layer(M, q)                                    # shape (2, 2): a solution a row of q
    z.sum().backward()                                     # M.grad is the sum over both

and in JAX::

    import jax, jax.numpy as jnp
    jax.config.update("jax_enable_x64", True)
    from lcp_plugin.interfaces.learn.jax import lcp_layer

    jax.grad(lambda q: lcp_layer(M, q).sum())(q)           # also under jit and vmap

**Shapes.** The last axis of q and of the bounds is the axis of the unknowns. The last two axes of M are its rows and
columns. Leading axes are batch axes, and broadcast as in numpy. One M of shape (n, n) for all costs one matrix. A
bound may be a number. A batch is solved by :func:`~lcp_plugin.solve_batch`; a single problem may be as large as
:func:`~lcp_plugin.solve` takes. So M may also be a sparse scipy array, a constant of the layer.

**The result** is z, solved again on the free rows, so that z is exact to rounding for any tolerance; compute
w = M z + q from it. If a problem is not SOLVED, :class:`~lcp_plugin.NotConverged` names its number in the batch.
(JAX wraps this error in its own.) With ``mask=True`` a layer returns (z, is_solved) instead: an instance that is not
solved, or whose numbers are invalid, has z = 0 and the gradient 0, and the batch continues.

**Gradients** by all four are computed by :meth:`BatchDerivative.vjp`: exact if no row is both at a bound and has w = 0.
If such a row exists, as for a ReLU at 0, they are the gradients of one of the pieces that meet there. A second
derivative raises an error. If the block of M on the free rows is singular, they belong to the least change, as
:class:`lcp_plugin.problems.sensitivity.Derivative` describes.

**Transformations.** Gradients go backward: in JAX ``grad``, ``vjp``, ``jacrev``, also under ``jit`` and ``vmap``, whose
axis becomes a batch axis; in PyTorch ``backward()``, ``torch.func.grad`` and ``torch.func.vjp``. For forward mode
use :meth:`BatchDerivative.jvp` in numpy.

**Contact with friction.** ``contact_layer(W, b, friction)`` returns the impulses of a batch, with the gradients of
:class:`~lcp_plugin.problems.sensitivity.batch_derivative.ContactBatchDerivative`.

**Double precision**, on the CPU: single precision raises an error, because a certificate of rounded data certifies
another problem. Convert before and after the layer (``q.double()``, ``z.float()``); gradients pass through that.
"""
