"""The layer for JAX: its gradients are those of differences, under jit and vmap too, and what it cannot do it says."""

import doctest
from functools import partial

import numpy as np
import pytest
from inputs.planted import planted, planted_worlds
from inputs.stacked_programs import differentiable_programs

jax = pytest.importorskip("jax")

import jax.numpy as jnp  # noqa: E402
from jax.test_util import check_grads  # noqa: E402

import lcp_plugin.interfaces.learn.jax as layers  # noqa: E402
from lcp_plugin import (  # noqa: E402
    LCP,
    FrictionalContact,
    InvalidOption,
    InvalidProblem,
    derivative,
    gallery,
    solve,
    solve_batch,
)
from lcp_plugin.interfaces.learn.jax import contact_layer, lcp_layer, qp_layer  # noqa: E402

pytestmark = pytest.mark.usefixtures("double_precision")


def test_examples_of_its_help():
    """The doctests of the module, which others leave out."""
    assert doctest.testmod(layers).failed == 0
    assert doctest.testmod(layers).attempted > 3


@pytest.mark.quick(1)
@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("shared", [True, False])
def test_gradients_are_those_of_differences(symmetric, shared):
    """jax.test_util.check_grads in M, q, lower and upper, with boxes and half-lines; also compiled."""
    M, q, lower, upper = planted(4, 5, 1, symmetric=symmetric, shared=shared, fixed=0.0)
    data = M, q, np.maximum(lower, -1e3), np.minimum(upper, 1e3)  # differences of ±inf are none
    for layer in (lcp_layer, jax.jit(lcp_layer)):
        check_grads(layer, tuple(map(jnp.array, data)), order=1, modes=["rev"], eps=1e-6)


@pytest.mark.quick(1)
@pytest.mark.parametrize("axes", [(0, 0, 0, 0), (None, 0, None, None), (0, None, 0, None)])
def test_a_mapped_axis_is_one_more_of_the_batch(axes):
    """With vmap of the layer and of its gradients, over any of the arguments, inside and outside of jit."""
    data = [
        array if axis == 0 else array[0] for array, axis in zip(planted(4, 5, 6), axes, strict=True)
    ]

    def one_by_one(function):
        rows = [
            [array[k] if axis == 0 else array for array, axis in zip(data, axes, strict=True)]
            for k in range(4)
        ]
        return jax.tree.map(lambda *parts: jnp.stack(parts), *(function(*row) for row in rows))

    gradients = jax.grad(lambda *data: (lcp_layer(*data) ** 2).sum(), argnums=(0, 1, 2, 3))
    for function in (lcp_layer, gradients):
        mapped = jax.vmap(function, axes)
        for ours in (mapped(*data), jax.jit(mapped)(*data)):
            pairs = zip(jax.tree.leaves(ours), jax.tree.leaves(one_by_one(function)), strict=True)
            assert all(np.allclose(a, b, rtol=1e-12, atol=1e-12) for a, b in pairs)


def test_jacobians():
    """jax.jacrev asks for many gradients of one solution: −M_FF⁻¹ on the free rows; also under vmap."""
    M, q, lower, upper = planted(2, 6, 7)
    jacobian = jax.jacrev(lcp_layer, argnums=1)
    mapped = jax.vmap(jacobian)(M, q, lower, upper)
    for k in range(2):
        found = derivative(solve(LCP(M[k], q[k], lower=lower[k], upper=upper[k])))
        exact = np.column_stack([found.jvp(dq=row) for row in np.eye(6)])
        for ours in (jacobian(M[k], q[k], lower[k], upper[k]), mapped[k]):
            assert np.allclose(ours, exact, rtol=1e-12, atol=1e-13)
    whole = jacobian(M, q, lower, upper)
    assert whole.shape == (2, 6, 2, 6)
    assert np.allclose(whole[1, :, 1], mapped[1], rtol=1e-13, atol=1e-14)
    assert not np.any(whole[1, :, 0])


@pytest.mark.parametrize(
    "second", [jax.hessian, lambda loss: jax.grad(lambda q: jax.grad(loss)(q).sum())]
)
def test_second_derivatives_and_forward_mode_are_refused(second):
    """JAX says that a callback has no derivative."""
    M, q = jnp.eye(2) * 2.0, -jnp.ones(2)
    with pytest.raises((TypeError, ValueError, NotImplementedError)):
        second(lambda q: (lcp_layer(M, q) ** 2).sum())(q)


def test_a_sparse_matrix_is_a_constant():
    """An obstacle problem with 10 000 unknowns, differentiated by its load and its obstacle, compiled."""
    scene = gallery.obstacle_2d(size=100).problem
    layer = jax.jit(jax.grad(lambda q, lower: lcp_layer(scene.M, q, lower).sum(), argnums=(0, 1)))
    by_q, by_lower = layer(scene.q, scene.lower)
    own = derivative(solve(scene)).vjp(np.ones(scene.n))
    assert np.allclose(by_q, own.q, rtol=1e-8, atol=1e-8 * np.abs(own.q).max())
    assert np.allclose(by_lower, own.lower, rtol=1e-8, atol=1e-8)


def test_what_is_not_solved_is_named():
    """A batch with a problem that has no solution raises, and names it within JAX's own error."""
    M = jnp.stack([jnp.eye(2), -jnp.eye(2), jnp.eye(2)])
    for layer in (lcp_layer, jax.jit(partial(lcp_layer, fallback="host"))):
        with pytest.raises(
            Exception,
            match=r"NotConverged: the layer found no solution for problem \(1,\) of the batch",
        ):
            jax.block_until_ready(layer(M, -jnp.ones(2)))
        with pytest.raises(Exception, match=r"q\[0\] = nan"):
            jax.block_until_ready(layer(jnp.eye(2), jnp.array([jnp.nan, 0.0])))


def test_single_precision_is_refused():
    """Where JAX has not been told otherwise, and where an array has it all the same."""
    with pytest.raises(
        InvalidProblem, match=r"q must be an array of float64, got float32; write q.astype\(float\)"
    ):
        lcp_layer(jnp.eye(2), jnp.ones(2, dtype=jnp.float32))
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(InvalidOption, match="jax_enable_x64"):
        lcp_layer(jnp.eye(2), jnp.ones(2))


def test_contact_has_the_gradients_of_its_derivative():
    """Compiled, mapped and at once."""
    W, b, friction = planted_worlds(6)
    gradient = derivative(solve_batch(FrictionalContact.worlds(W, b, friction))).vjp(np.ones(6))

    def loss(W, b, friction):
        return contact_layer(W, b, friction).sum()

    ways = (
        jax.grad(loss, (0, 1, 2)),
        jax.jit(jax.grad(loss, (0, 1, 2))),
        jax.vmap(jax.grad(loss, (0, 1, 2))),
    )
    for way in ways:
        for found, expected in zip(
            way(W, b, friction), (gradient.M, gradient.q, gradient.friction), strict=True
        ):
            np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


def test_mask_replaces_the_error_of_a_failed_instance():
    """An instance without a solution has z = 0 and the gradient 0, also under jit."""
    q = jnp.array([[-1.0, 2.0], [np.nan, -1.0]])
    z, is_solved = lcp_layer(jnp.eye(2), q, mask=True)
    assert (z.tolist(), is_solved.tolist()) == ([[1.0, 0.0], [0.0, 0.0]], [True, False])
    by_q = jax.jit(jax.grad(lambda q: lcp_layer(jnp.eye(2), q, mask=True)[0].sum()))(q)
    assert by_q.tolist() == [[-1.0, 0.0], [0.0, 0.0]]


@pytest.mark.quick(2)
@pytest.mark.parametrize("names", [(), ("c", "h"), ("P", "c")])
def test_gradients_of_programs_are_those_of_differences(names):
    """check_grads in all data, plain and compiled, these with an axis of a batch; vmap; names of wrong arrays."""
    data = differentiable_programs(3, names)
    for layer in (qp_layer, jax.jit(qp_layer)):
        check_grads(layer, tuple(map(jnp.array, data.values())), order=1, modes=["rev"], eps=1e-6)
    single = differentiable_programs(3)

    def loss(c):
        return qp_layer(*(data | {"P": single["P"], "h": single["h"], "c": c}).values()).sum()

    costs = single["c"] + 0.01 * jnp.arange(3.0)[:, None]
    assert np.allclose(jax.vmap(jax.grad(loss))(costs)[1], jax.grad(loss)(costs[1]), atol=1e-12)
    with pytest.raises(InvalidProblem, match="h must have shape"):
        qp_layer(*(data | {"h": np.ones(7)}).values())
    with pytest.raises(InvalidProblem, match="c must be an array of float64, got float32"):
        qp_layer(single["P"], jnp.ones(single["c"].size, dtype=jnp.float32))
