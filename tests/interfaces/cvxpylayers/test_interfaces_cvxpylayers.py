"""The interface for cvxpylayers: x, multipliers and gradients are those of our own layers and of diffcp."""

from __future__ import annotations

import doctest
import sys
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("cvxpylayers.interfaces.base")

from cvxpylayers.torch import CvxpyLayer  # noqa: E402
from fresh_process import printed_by  # noqa: E402

import lcp_plugin.interfaces.cvxpylayers as interface  # noqa: E402
from lcp_plugin import InvalidOption, NotConverged, UnsupportedModel  # noqa: E402
from lcp_plugin.interfaces.cvxpylayers import LCPSolver  # noqa: E402
from lcp_plugin.interfaces.learn.torch import lcp_layer  # noqa: E402

pytestmark = pytest.mark.filterwarnings(
    "ignore::UserWarning", "ignore::DeprecationWarning", "ignore::FutureWarning"
)
N = 6


def leaves(*arrays: Any) -> list[Any]:
    return [torch.tensor(np.asarray(array, dtype=float), requires_grad=True) for array in arrays]


def answers(layer: Any, values: list[Any], **options: Any) -> tuple[list[Any], list[Any]]:
    """What the layer returns, and the gradients of a sum with weights."""
    given = leaves(*values)
    found = layer(*given, **options)
    sum(
        (torch.linspace(1, 2, one.numel(), dtype=one.dtype).reshape(one.shape) * one).sum()
        for one in found
    ).backward()
    return [one.detach().numpy() for one in found], [one.grad.numpy() for one in given]


def assert_same(ours: Any, theirs: Any, tolerance: float) -> None:
    for mine, other in zip([*ours[0], *ours[1]], [*theirs[0], *theirs[1]], strict=True):
        np.testing.assert_allclose(mine, other, atol=tolerance * (1.0 + np.abs(other).max()))


def nonnegative_least_squares() -> tuple[Any, list[Any], list[Any], list[tuple[int, ...]]]:
    A, b, x = cp.Parameter((8, N)), cp.Parameter(8), cp.Variable(N)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b)), [x >= 0])
    return problem, [A, b], [x], [(8, N), (8,)]


def general() -> tuple[Any, list[Any], list[Any], list[tuple[int, ...]]]:
    G, h, c, x = cp.Parameter((3, N)), cp.Parameter(3), cp.Parameter(N), cp.Variable(N)
    E, e = cp.Parameter((2, N)), cp.Parameter(2)
    factor = np.random.default_rng(3).standard_normal((N, N))
    constraints = [G @ x <= h, E @ x == e, x <= 2]
    objective = cp.Minimize(0.5 * cp.quad_form(x, factor @ factor.T + np.eye(N)) + c @ x)
    variables = [x, *(one.dual_variables[0] for one in constraints)]
    return (
        cp.Problem(objective, constraints),
        [G, h, c, E, e],
        variables,
        [(3, N), (3,), (N,), (2, N), (2,)],
    )


def linear() -> tuple[Any, list[Any], list[Any], list[tuple[int, ...]]]:
    c, h, x = cp.Parameter(N), cp.Parameter(), cp.Variable(N)
    return (
        cp.Problem(cp.Minimize(c @ x), [cp.norm(x, 1) <= 1, cp.sum(x) <= h]),
        [c, h],
        [x],
        [(N,), ()],
    )


@pytest.mark.parametrize("batch", [(), (3,)], ids=["single", "batch"])
@pytest.mark.parametrize("model", [nonnegative_least_squares, general, linear])
def test_values_and_gradients_are_those_of_diffcp(model: Any, batch: tuple[int, ...]) -> None:
    """To 1e-7, of programs with every kind of row, multipliers included, and of batches."""
    problem, parameters, variables, shapes = model()
    rng = np.random.default_rng(0)
    values = [0.5 * np.abs(rng.standard_normal((*batch, *shape))) + 0.1 for shape in shapes]
    values[0] = rng.standard_normal((*batch, *shapes[0]))
    ours = answers(CvxpyLayer(problem, parameters, variables, solver=LCPSolver()), values)
    exactly = {"eps": 1e-12, "max_iters": 100_000, "mode": "dense"}
    assert_same(
        ours, answers(CvxpyLayer(problem, parameters, variables), values, solver_args=exactly), 1e-7
    )


def test_gradients_are_those_of_our_own_layer() -> None:
    """To 1e-10, by a matrix of parameters that diffcp does not take; of a symmetric one cvxpylayers sees half."""
    rng = np.random.default_rng(5)
    factor, c = rng.standard_normal((N, N)), 4.0 * rng.standard_normal(N)
    P, linear, x = cp.Parameter((N, N), PSD=True), cp.Parameter(N), cp.Variable(N)
    problem = cp.Problem(cp.Minimize(0.5 * cp.quad_form(x, P) + linear @ x), [x >= -1, x <= 1])
    values = [factor @ factor.T + np.eye(N), c]
    (found,), (by_P, by_c) = answers(
        CvxpyLayer(problem, [P, linear], [x], solver=LCPSolver()), values
    )
    (own,), (own_P, own_c) = answers(lambda M, q: [lcp_layer(M, q, -1.0, 1.0)], values)
    np.testing.assert_allclose(found, own, atol=1e-12)
    np.testing.assert_allclose(by_c, own_c, atol=1e-10)
    np.testing.assert_allclose(by_P + by_P.T, own_P + own_P.T, atol=1e-10)


def test_gradients_are_those_of_differences() -> None:
    """torch.autograd.gradcheck through the whole layer."""
    problem, parameters, variables, shapes = general()
    layer = CvxpyLayer(problem, parameters, variables[:1], solver=LCPSolver(tolerance=1e-12))
    rng = np.random.default_rng(1)
    values = leaves(
        *(rng.standard_normal(shape) + (1.0 if k == 1 else 0.0) for k, shape in enumerate(shapes))
    )
    assert torch.autograd.gradcheck(lambda *given: layer(*given)[0], values, eps=1e-6, atol=1e-5)


def test_one_solver_serves_several_layers() -> None:
    """Each layer keeps the places of its own numbers, whichever was made last."""
    solver, layers = LCPSolver(), []
    for model in (nonnegative_least_squares, general):
        problem, parameters, variables, shapes = model()
        values = [np.random.default_rng(2).random(shape) for shape in shapes]
        layers.append(
            (
                CvxpyLayer(problem, parameters, variables, solver=solver),
                values,
                answers(CvxpyLayer(problem, parameters, variables, solver=LCPSolver()), values),
            )
        )
    for layer, values, alone in layers:
        assert_same(answers(layer, values), alone, 0.0)


def test_jax_is_refused_in_words() -> None:
    """Where cvxpylayers calls no solver of one's own, the message says which layers do."""
    pytest.importorskip("jax")
    layers = pytest.importorskip("cvxpylayers.jax")
    problem, parameters, variables, shapes = nonnegative_least_squares()
    layer = layers.CvxpyLayer(problem, parameters, variables, solver=LCPSolver())
    with pytest.raises(
        UnsupportedModel, match=r"in PyTorch alone; in JAX take lcp_plugin\.learn\.jax"
    ):
        layer(*(np.ones(shape) for shape in shapes))


def test_what_is_unsolved_is_an_error() -> None:
    """Infeasible and unbounded programs, by number, with the proof in words; limits and wrong options, too."""
    x, h = cp.Variable(2), cp.Parameter(2)
    layer = CvxpyLayer(
        cp.Problem(cp.Minimize(cp.sum_squares(x)), [x >= h[0], x <= h[1]]),
        [h],
        [x],
        solver=LCPSolver(),
    )
    with pytest.raises(
        NotConverged, match="program 1 of the batch gives the layer no solution: it is infeasible"
    ):
        layer(torch.tensor([[0.0, 1.0], [1.0, 0.0]], dtype=torch.float64))
    with pytest.raises(InvalidOption, match="did you mean 'tolerance'"):
        LCPSolver(tolerence=1e-9)
    with pytest.raises(
        InvalidOption, match=r"^algorithm=.auto. has no options.*did you mean 'tolerance'"
    ):
        layer(torch.tensor([0.0, 1.0], dtype=torch.float64), solver_args={"tolerence": 1e-9})
    layer = CvxpyLayer(cp.Problem(cp.Minimize(h @ x), [x >= 0]), [h], [x], solver=LCPSolver())
    with pytest.raises(
        NotConverged, match="the program gives the layer no solution: it is unbounded"
    ):
        layer(-torch.ones(2, dtype=torch.float64))


def test_what_is_no_program_is_refused_at_once() -> None:
    """Other cones and integers, when the layer is made."""
    x, c = cp.Variable(2), cp.Parameter(2)
    problem = cp.Problem(cp.Minimize(c @ x), [cp.norm(x, 2) <= 1])
    with pytest.raises(
        UnsupportedModel, match="this one needs second-order cones; write norms of one and infinity"
    ):
        CvxpyLayer(problem, [c], [x], solver=LCPSolver())
    with pytest.raises(UnsupportedModel, match="this one needs exponential cones"):
        CvxpyLayer(cp.Problem(cp.Minimize(cp.sum(cp.exp(x)) + c @ x)), [c], [x], solver=LCPSolver())


def test_examples_of_its_help() -> None:
    """The doctests of the module, which others leave out."""
    found = doctest.testmod(interface)
    assert found.attempted > 5
    assert not found.failed


def test_without_cvxpylayers_it_says_what_to_install() -> None:
    """Nothing else imports it."""
    code = (
        "import sys\nsys.modules['cvxpylayers'] = None\nimport lcp_plugin.interfaces\n"
        "try:\n    import lcp_plugin.interfaces.cvxpylayers\nexcept ImportError as error:\n    print(error)"
    )
    assert printed_by(code).endswith("install it with: pip install 'cvxpylayers>=1.2'")
    assert "cvxpylayers" in sys.modules
