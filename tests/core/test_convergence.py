"""Every algorithm on every class of matrices it is meant for: solved, and the right z."""

from __future__ import annotations

from functools import cache
from itertools import islice
from typing import NamedTuple

import numpy as np
import pytest
import scipy.sparse as sp
from inputs import membranes
from inputs.families import BOUNDED, MODULUS
from inputs.planted import planted_lcp

from lcp_plugin import LCP, Certificate, Status, gallery, solve
from lcp_plugin.algorithms import REGISTRY, create

ALL = ("auto", *REGISTRY)


class Solved(NamedTuple):
    """A problem with its exact solution."""

    problem: LCP
    z: np.ndarray


# --- The matrix classes ------------------------------------------------------------------------------------


def positive_definite(n: int, seed: int) -> np.ndarray:
    """B Bᵀ + n I with small integers: far from diagonally dominant."""
    B = np.random.default_rng(seed).integers(-3, 4, size=(n, n)).astype(float)
    return B @ B.T + n * np.eye(n)


def scene(text: str) -> Solved:
    found = membranes.parse(text)
    assert found.exact is not None
    return Solved(found.problem, found.exact)


CLASSES = {
    "H₊, small": lambda: scene("random_h_plus:n=12,row_scale=0,column_scale=0"),
    "H₊, sparse, wild rows": lambda: scene("random_h_plus:n=300,row_scale=20,column_scale=10"),
    "M-matrix, nonsymmetric": lambda: planted_lcp(
        gallery.paper_example_2(n=400, delta=1.0).problem.csr, 0, bounds=False
    ),
    "five-point + 4 I": lambda: scene("half_active:n=400"),
    "five-point": lambda: scene("half_active:n=400,delta=0"),
    "SPD, not H₊": lambda: planted_lcp(positive_definite(40, seed=0), 0, bounds=False, unit=40.0),
}


@cache
def problem_of(kind: str) -> Solved:
    return Solved(*CLASSES[kind]())


NOT_FOR = {
    "SPD, not H₊": (*MODULUS, "pj", "paor", "gfp"),
    "H₊, sparse, wild rows": ("interior_point",),
}
PAIRS = [
    pytest.param(name, kind, id=f"{name}-{kind}")
    for name in ALL
    for kind in CLASSES
    if name not in NOT_FOR.get(kind, ()) and not (kind == "SPD, not H₊" and name.startswith("np"))
]


def error(z: np.ndarray, exact: np.ndarray) -> float:
    return float(abs(z - exact).max() / abs(exact).max())


@pytest.mark.quick(19)
@pytest.mark.parametrize(("name", "kind"), PAIRS)
def test_it_arrives(name, kind):
    """The final status is SOLVED, and z is the exact one to seven digits."""
    problem, exact = problem_of(kind)
    result = solve(problem, name, max_iterations=5000)
    assert result.status is Status.SOLVED
    assert result.certificate.relative_residual <= 1e-8
    assert error(result.z, exact) < 1e-7


# --- Bounds ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["auto", *BOUNDED])
def test_boxes_and_free_rows(name):
    """On an H₊-matrix the exact z is found, and its rows at a bound are at that bound exactly."""
    M = membranes.random_h_plus(n=200, row_scale=0, column_scale=0).problem.csr
    problem, exact = planted_lcp(M, 0)
    assert Certificate.of(problem, exact).relative_residual <= 1e-13
    result = solve(problem, name)
    assert result.status is Status.SOLVED
    assert error(result.z, exact) < 1e-7
    w = problem.slack(exact)
    for bound, held in ((problem.lower, w > 0.0), (problem.upper, w < 0.0)):
        assert held.any()
        assert np.array_equal(result.z[held], bound[held])


@pytest.mark.parametrize("name", [name for name in ALL if name.startswith("np")])
def test_np_finishes_with_exact_zeros(name):
    """NP iterates approach a bound for ever; the last sweep puts strictly active components exactly there."""
    problem, exact = problem_of("five-point + 4 I")
    is_active = problem.slack(exact) > 0.0
    result = solve(problem, name)
    assert result.status is Status.SOLVED
    assert not result.z[is_active].any()
    iterates = create(name, {}).iterates(problem, np.ones(problem.n))
    *_, last = islice(iterates, result.iterations)
    assert np.mean(last.z[is_active] > 0.0) > 0.5


# --- Automatic relaxation ----------------------------------------------------------------------------------


def random_h_plus(n: int, seed: int) -> np.ndarray:
    """A dense H₊-matrix of any signs, from well conditioned to nearly singular."""
    generator = np.random.default_rng(seed)
    M = generator.normal(size=(n, n)) * (generator.random((n, n)) < generator.uniform(0.1, 1.0))
    np.fill_diagonal(M, 0.0)
    np.fill_diagonal(M, (1.0 + 10.0 ** generator.uniform(-3.0, 0.0)) * abs(M).sum(axis=1) + 1e-3)
    return M * np.exp2(generator.integers(-8, 9, size=n))


@pytest.mark.full
@pytest.mark.parametrize("matrices", [random_h_plus, positive_definite], ids=["H₊", "SPD"])
def test_automatic_relaxation_never_fails_where_gauss_seidel_converges(matrices):
    """On 100 random problems of each class PSOR is SOLVED wherever PGS is, and on the whole not slower."""
    total = {"pgs": 0, "psor": 0}
    for seed in range(100):
        n = 5 + seed % 30
        M = matrices(n, seed)
        problem, _ = planted_lcp(sp.csr_array(M) if seed % 2 else M, seed, bounds=False)
        results = {name: solve(problem, name, max_iterations=20_000) for name in total}
        assert results["pgs"].status is Status.SOLVED
        assert results["psor"].status is Status.SOLVED
        assert results["psor"].iterations <= 3 * results["pgs"].iterations + 10
        for name, result in results.items():
            total[name] += result.iterations
    assert total["psor"] <= 1.1 * total["pgs"]
