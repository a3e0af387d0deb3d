"""The layer for PyTorch: gradients agree with differences, and unsupported uses raise errors."""

from __future__ import annotations

import doctest
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.planted import planted, planted_worlds
from inputs.stacked_programs import differentiable_programs
from tools.refusals import assert_refused, refusals

torch = pytest.importorskip("torch")


import lcp_plugin.interfaces.learn.torch as layers  # noqa: E402
from lcp_plugin import (  # noqa: E402
    InvalidProblem,
    NotConverged,
    UnsuitableProblem,
    UnsupportedModel,
    derivative,
    gallery,
    solve,
)
from lcp_plugin.interfaces.learn.torch import contact_layer, lcp_layer, qp_layer  # noqa: E402

pytestmark = [
    pytest.mark.filterwarnings(
        "ignore:Sparse (CSR|invariant):UserWarning"
    ),  # PyTorch, of each CSR tensor
    pytest.mark.filterwarnings(
        "ignore:.torch.jit.script:DeprecationWarning"
    ),  # in its own forward mode
    pytest.mark.filterwarnings(
        "ignore:The .grad attribute:UserWarning"
    ),  # in its own torch.compile
]
INF = np.inf


def leaves(*arrays: Any) -> list[Any]:
    """Tensors that want a gradient."""
    return [torch.tensor(array, dtype=torch.float64, requires_grad=True) for array in arrays]


def test_examples_of_its_help():
    """The doctests of the module, which others leave out."""
    assert doctest.testmod(layers).failed == 0
    assert doctest.testmod(layers).attempted > 3


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("shared", [True, False])
def test_gradients_are_those_of_differences(symmetric, shared):
    """torch.autograd.gradcheck in M, q, lower and upper, with boxes, half-lines and free rows."""
    data = leaves(*planted(4, 5, 1, symmetric=symmetric, shared=shared, fixed=0.0))
    assert torch.autograd.gradcheck(lcp_layer, data)


def test_axes_in_front_broadcast():
    """M of shape (3, 1, n, n), q of (4, n) and one bound for all are twelve problems."""
    M, q, _, _ = planted(4, 6, 4)
    M, q, lower = leaves(M[:3, None], q, np.zeros(6))
    z = lcp_layer(M, q, lower, 2.0)
    assert z.shape == (3, 4, 6)
    one_by_one = torch.stack(
        [torch.stack([lcp_layer(M[i, 0], q[j], lower, 2.0) for j in range(4)]) for i in range(3)]
    )
    assert torch.allclose(z, one_by_one, rtol=1e-13, atol=1e-14)
    assert torch.autograd.gradcheck(lambda *data: lcp_layer(*data, 2.0), (M, q, lower))
    assert lcp_layer(M[:0], q).shape == (0, 4, 6)


def test_many_unknowns():
    """An obstacle problem with 10 000 unknowns, differentiated by its load and its obstacle."""
    scene = gallery.obstacle_2d(size=100).problem
    q, lower = leaves(scene.q, scene.lower)
    lcp_layer(scene.M, q, lower).sum().backward()
    own = derivative(solve(scene)).vjp(np.ones(scene.n))
    assert np.allclose(q.grad, own.q, rtol=1e-8, atol=1e-8 * np.abs(own.q).max())
    assert np.allclose(lower.grad, own.lower, rtol=1e-8, atol=1e-8)


def test_at_a_kink_the_gradient_is_that_of_a_piece():
    """The gradient of z = max(−q, 0)/2 at q = 0 belongs to one piece, as for a ReLU."""
    q = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    lcp_layer(torch.tensor([[2.0]], dtype=torch.float64), q).sum().backward()
    assert q.grad.item() in (0.0, -0.5)


def test_what_is_not_solved_is_named():
    """A batch with unsolvable problems, or with NaN, raises an error with their indices."""
    q = torch.zeros((2, 3, 2), dtype=torch.float64)
    M = torch.eye(2, dtype=torch.float64).repeat(2, 3, 1, 1)
    M[0, 1] = M[1, 2] = -M[0, 1]
    with pytest.raises(
        NotConverged,
        match=r"problem \(0, 1\) of the batch, nor for \(1, 2\): .*(INFEASIBLE|NO_SOL)",
    ):
        lcp_layer(M, q - 1.0)
    q[1, 0, 0] = np.nan
    with pytest.raises(InvalidProblem, match=r"problem \(1, 0\) of the batch.*q\[0\] = nan"):
        lcp_layer(torch.eye(2, dtype=torch.float64), q)
    with pytest.raises(
        NotConverged, match=r"^the layer found no solution for the problem: .*MAX_ITERATIONS"
    ):
        lcp_layer(
            2.0 * torch.eye(2, dtype=torch.float64),
            q[0, 0] - 1.0,
            algorithm="psor",
            max_iterations=0,
        )


def test_a_singular_block_has_the_gradient_of_least_change():
    """The gradient uses the generalized inverse."""
    M, q = leaves(np.ones((2, 2)), np.zeros(2))
    lcp_layer(M, q, -INF).sum().backward()
    assert np.allclose(q.grad, [-0.5, -0.5], atol=1e-15)


@pytest.mark.full
def test_what_autograd_must_not_do():
    """A second derivative, and a matrix changed between the passes, raise errors."""
    M, q = leaves(np.eye(2) * 2.0, -np.ones(2))
    for of in (lambda z: z.square().sum(), lambda z: z.sum()):
        for by in (M, q):
            loss = of(lcp_layer(M, q))
            (first,) = torch.autograd.grad(loss, by, create_graph=True)
            with pytest.raises(UnsupportedModel, match="no second derivative"):
                (loss + first.square().sum()).backward()
    z = lcp_layer(M, q)
    with torch.no_grad():
        M += 1.0
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        z.sum().backward()


def test_what_the_loss_ignores_may_be_singular():
    """A problem without derivative costs the others nothing, and a batch may have no unknowns."""
    M, q = leaves(np.array([[[2.0]], [[0.0]]]), np.array([[-2.0], [0.0]]))
    lcp_layer(M, q, -INF)[0].sum().backward()
    assert q.grad.tolist() == [[-0.5], [0.0]]
    assert lcp_layer(*leaves(np.zeros((0, 0)), np.zeros(0))).shape == (0,)


def test_torch_func_takes_gradients_and_no_vmap():
    """Functions torch.func.grad and vjp support the layer; vmap raises an error."""
    M = torch.tensor([[2.0, 1.0], [1.0, 2.0]], dtype=torch.float64)
    q = torch.tensor([-5.0, 1.0], dtype=torch.float64)
    for same in (M, sp.csr_array(M.numpy())):
        gradient = torch.func.grad(lambda q, same=same: lcp_layer(same, q).sum())
        assert gradient(q).tolist() == [-0.5, 0.0]
    z, back = torch.func.vjp(lambda q: lcp_layer(M, q), q)
    assert back(torch.ones_like(z))[0].tolist() == [-0.5, 0.0]
    with pytest.raises(RuntimeError, match="vmap"):
        torch.func.vmap(lambda q: lcp_layer(M, q))(torch.stack([q, -q]))


EYE, ONES = np.eye(2), np.ones(2)


@refusals(r"""
lcp_layer(t(EYE), t(ONES).float()) → q must be a tensor of float64, .*; write q.d
lcp_layer(t(EYE).to_sparse(), t(ONES)) → M must be dense, got torch.sparse_coo.*M.to_dense\(\), or give a scipy array
lcp_layer(t(EYE).to("meta"), t(ONES)) → M must be on the CPU, got meta
lcp_layer(EYE, 1j * ONES) → q must be an array of real numbers, got complex
lcp_layer(t(EYE), t(np.ones((3, 2))), t(np.zeros((4, 2)))) → must broadcast, got M
lcp_layer(t(EYE), t(ONES), t(np.zeros(3))) → lower must have shape \(…, 2\), or be a number, got \(3,\)
""")
def test_what_is_refused(call, words):
    """Other types, devices, layouts and shapes raise errors with the argument and the remedy."""
    assert_refused(
        call,
        words,
        {**globals(), "t": lambda array: torch.tensor(array, dtype=float)},
        InvalidProblem,
    )


def test_contact_has_the_gradients_of_differences():
    """Gradients by W (symmetric), b and friction, also a scalar, agree with differences."""
    W, b, friction = leaves(*planted_worlds(6))

    def layer(A, b, friction):
        return contact_layer(A + A.mT, b, friction, tolerance=1e-12)

    assert torch.autograd.gradcheck(
        layer, (0.5 * W.detach().requires_grad_(), b, friction), atol=1e-4
    )
    one = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda mu: contact_layer(W[0].detach(), b.detach(), mu, dimension=3), (one,), atol=1e-4
    )


def test_mask_replaces_the_error_of_a_failed_instance():
    """An instance without a solution has z = 0 and the gradient 0, and does not change the others."""
    M, q = leaves(np.eye(2), [[-1.0, 2.0], [np.nan, -1.0], [-3.0, -4.0]])
    z, is_solved = lcp_layer(M, q, mask=True)
    assert is_solved.tolist() == [True, False, True]
    assert z.tolist() == [[1.0, 0.0], [0.0, 0.0], [3.0, 4.0]]
    z.sum().backward()
    assert q.grad.tolist() == [[-1.0, 0.0], [0.0, 0.0], [-1.0, -1.0]]
    assert M.grad.tolist() == [[-4.0, -4.0], [-3.0, -4.0]]  # −λ zᵀ of the first and the third
    W, b = np.stack([np.eye(3), -np.eye(3)]), leaves([[-1.0, 3.0, 4.0]] * 2)[0]
    start, mu = torch.zeros(2, 3).double(), torch.tensor([0.5]).double()
    r, is_solved = contact_layer(torch.tensor(W), b, mu, z0=start, mask=True)
    r.sum().backward()
    assert is_solved.tolist() == [True, False]
    assert r[1].tolist() == b.grad[1].tolist() == [0.0, 0.0, 0.0]
    assert b.grad[0].abs().sum() > 0.0


@pytest.mark.parametrize("names", [(), ("c", "h"), ("P", "c"), ("G", "b", "lower")])
def test_gradients_of_programs_are_those_of_differences(names):
    """torch.autograd.gradcheck in all data, these with an axis of a batch; rows in None or empty as in qpth."""
    data = leaves(*differentiable_programs(3, names).values())
    assert torch.autograd.gradcheck(qp_layer, data)
    P, c, G, h = data[:4]
    empty = torch.empty(0)
    assert torch.equal(qp_layer(P, c, G, h, empty, empty), qp_layer(P, c, G, h))


def test_a_program_layer_names_what_does_not_fit():
    """The array with a wrong shape or type, a program without a solution, dependent rows; kinks have a gradient."""
    data = differentiable_programs(2)
    n = data["c"].size
    for name, wrong in (
        ("G", np.ones((3, n + 1))),
        ("h", np.ones(7)),
        ("b", np.ones(7)),
        ("c", np.ones(n + 1)),
    ):
        with pytest.raises(InvalidProblem, match=f"{name} must have shape"):
            qp_layer(*leaves(*(data | {name: wrong}).values()))
    with pytest.raises(
        InvalidProblem, match=r"P must be a tensor of float64, got torch.float32; write P.double"
    ):
        qp_layer(torch.eye(2), torch.ones(2).double())
    with pytest.raises(InvalidProblem, match="G is given without h"):
        qp_layer(torch.eye(2).double(), torch.ones(2).double(), torch.eye(2).double())
    eye, ones = torch.eye(2).double(), torch.ones(1, 2).double()
    limits = torch.tensor([[1.0], [-1.0]]).double()
    with pytest.raises(NotConverged, match=r"problem \(1,\) of the batch"):
        qp_layer(eye, torch.zeros(2).double(), ones, limits, lower=0.0)
    is_solved = qp_layer(eye, torch.zeros(2).double(), ones, limits, lower=0.0, mask=True)[1]
    assert is_solved.tolist() == [True, False]
    with pytest.raises(NotConverged, match=r"result = solve\(QuadraticProgram\(P, c, G"):
        qp_layer(eye, torch.zeros(2).double(), ones, limits[1], lower=0.0)
    with pytest.raises(InvalidProblem, match=r"G must have shape \(…, m, 2\), got \(2,\)"):
        qp_layer(eye, torch.zeros(2).double(), ones[0], limits[0])
    for P in (-eye, torch.stack([eye, -eye]), torch.stack([-eye, -eye])):
        with pytest.raises(UnsupportedModel, match="not convex"):
            qp_layer(P, torch.zeros(2).double(), lower=-1.0, upper=1.0)
    c = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    qp_layer(eye, c, lower=0.0).sum().backward()  # as a ReLU at 0
    assert c.grad.isfinite().all()
    rows, right = torch.ones(2, 2).double(), torch.ones(2).double()
    with pytest.raises(UnsuitableProblem, match="row 0 of A, row 1 of A"):
        qp_layer(eye, c, A=rows, b=right).sum().backward()


def test_a_layer_without_P_is_a_linear_program():
    """The cheaper unknown is at the limit of the row, and moves with it."""
    c = torch.tensor([-1.0, -2.0]).double()
    h = torch.tensor([2.0], dtype=torch.float64, requires_grad=True)
    x = qp_layer(None, c, torch.ones(1, 2).double(), h, lower=0.0)
    x[1].backward()
    assert x.tolist() == pytest.approx([0.0, 2.0])
    assert h.grad.tolist() == pytest.approx([1.0])
