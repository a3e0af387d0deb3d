"""Two iterations that must coincide are run side by side; what the formulas promise, the iterates keep."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
import scipy.sparse as sp
from inputs import membranes
from inputs.families import BOUNDED, SWEEPERS
from numpy.testing import assert_allclose

from lcp_plugin import LCP, Certificate
from lcp_plugin.algorithms import REGISTRY, Algorithm, NPSplitting, create

STEPS = 30
KINDS = ["dense", "sparse", "scaled"]
EVERY_KIND = pytest.mark.parametrize("kind", KINDS)


def random_problem(kind: str, *, bounds: bool, seed: int = 0) -> LCP:
    """A random H₊ problem of 20 to 50 unknowns; with bounds: boxes, one-sided and free rows."""
    generator = np.random.default_rng(seed)
    n = int(generator.integers(20, 51))
    share = {"dense": 1.0, "sparse": 0.1, "scaled": 0.3}[kind]
    M = generator.normal(size=(n, n)) * (generator.random((n, n)) < share)
    np.fill_diagonal(M, 0.0)
    np.fill_diagonal(M, abs(M).sum(axis=1) * generator.uniform(1.05, 1.5, size=n) + 0.1)
    if kind == "scaled":
        M *= np.exp2(generator.integers(-3, 4, size=n))[:, None]
    q = -(M @ np.maximum(generator.normal(size=n), 0.0)) + M.diagonal() * np.maximum(
        generator.normal(size=n), 0.0
    )
    matrix = M if kind == "dense" else sp.csr_array(M)
    if not bounds:
        return LCP(matrix, q)
    lower, upper = np.sort(generator.normal(size=(2, n)), axis=0)
    lower[generator.random(n) < 0.3] = -np.inf
    upper[generator.random(n) < 0.3] = np.inf
    return LCP(matrix, q, lower=lower, upper=upper)


def start_for(problem: LCP) -> np.ndarray:
    return np.clip(np.linspace(-1.0, 2.0, problem.n), problem.lower, problem.upper)


def iterates(
    algorithm: Algorithm, problem: LCP, z0: np.ndarray | None = None, steps: int = STEPS
) -> np.ndarray:
    """The first iterates, start included, shape (steps + 1, n)."""
    start = start_for(problem) if z0 is None else z0
    found = np.array(
        [step.z.copy() for step in islice(algorithm.iterates(problem, start.copy()), steps + 1)]
    )
    assert np.isfinite(found).all()
    return found


def assert_same(left: np.ndarray, right: np.ndarray) -> None:
    """Equal up to rounding, relative to the size of the iterates; and there was something to compare."""
    assert left.shape == right.shape
    assert abs(left[1:] - left[:-1]).max() > 1e-3
    assert_allclose(left, right, rtol=0.0, atol=1e-12 * abs(left).max())


# --- The paper's own formulation, and its misprints --------------------------------------------------------


def method_3_1(problem: LCP, splitting: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(𝓜 + 2I + D) ζ⁺ = (𝓝 + I + D) ζ + |(A − I) ζ + σ| − σ with 𝓝 = 𝓜 − A, as the paper writes it."""
    A, sigma = problem.csr.toarray(), problem.q
    identity, D = np.eye(problem.n), np.diag(A.diagonal())
    path = [z]
    for _ in range(STEPS):
        right = (splitting - A + identity + D) @ z + abs((A - identity) @ z + sigma) - sigma
        z = np.maximum(np.linalg.solve(splitting + 2.0 * identity + D, right), 0.0)
        path.append(z)
    return np.array(path)


@EVERY_KIND
def test_a_user_s_splitting_is_the_paper_s_method(kind):
    """NPSplitting with a tridiagonal 𝓜, named or given, is Method 3.1 in dense linear algebra."""
    problem = random_problem(kind, bounds=False)
    tridiagonal = np.triu(np.tril(problem.csr.toarray(), 1), -1)
    literal = method_3_1(problem, tridiagonal, start_for(problem))
    for splitting in (
        tridiagonal,
        sp.csr_array(tridiagonal),
        sp.coo_array(tridiagonal),
        "tridiagonal",
    ):
        assert_same(
            iterates(NPSplitting(splitting=splitting, scaling=None, momentum=None), problem),
            literal,
        )


@pytest.mark.parametrize("name", REGISTRY)
def test_the_residual_of_a_step_is_the_residual_of_its_certificate(name):
    """If a step has a residual, it is the scaled residual of the certificate of its z."""
    problem = membranes.parse("random_h_plus:n=60,row_scale=10,column_scale=3").problem
    for step in islice(create(name, {}).iterates(problem, np.ones(problem.n)), 8):
        if step.residual is not None:
            exact = Certificate.of(problem, step.z).scaled_residual
            assert step.residual == pytest.approx(exact, rel=1e-11)


# --- Order of the rows -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SWEEPERS)
@EVERY_KIND
def test_backward_is_forward_on_the_reversed_problem(name, kind):
    """A backward sweep takes the steps of a forward sweep where the unknowns are numbered from the end."""
    problem = random_problem(kind, bounds=name in BOUNDED)
    reverse = np.arange(problem.n)[::-1]
    backward = iterates(create(name, {"sweep": "backward"}), problem)
    turned = LCP(
        sp.csr_array(problem.csr.toarray()[np.ix_(reverse, reverse)]),
        problem.q[reverse],
        lower=problem.lower[reverse],
        upper=problem.upper[reverse],
    )
    forward = iterates(create(name, {}), turned, start_for(problem)[reverse])
    assert_same(backward, forward[:, reverse])
