"""The spectral radius of the matrix that bounds an iteration's errors."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from planted import planted_lcp

from lcp_plugin import LCP, gallery
from lcp_plugin.algorithms import create
from lcp_plugin.proofs.guarantees import convergence_guarantee
from lcp_plugin.proofs.guarantees.radius import bound_of_errors

METHODS: list[tuple[str, dict[str, Any]]] = [
    ("npj", {"scaling": None}),
    ("npgs", {}),
    ("npsor", {"relaxation": 0.8, "scaling": None}),
    ("npaor", {"relaxation": 1.2, "acceleration": 0.7}),
    ("pj", {}),
    ("pgs", {"sweep": "backward"}),
    ("psor", {"relaxation": 1.3}),
    ("paor", {"relaxation": 0.9, "acceleration": 0.4}),
    ("mj", {}),
    ("mgs", {"omega": 1.5}),
    ("msor", {"relaxation": 0.9}),
    ("maor", {"relaxation": 0.8, "acceleration": 0.6}),
]


def planted(seed: int, n: int = 12) -> tuple[LCP, np.ndarray]:
    """A strictly dominant M of both signs, and an answer chosen first."""
    random = np.random.default_rng(seed)
    M = random.uniform(-1, 1, (n, n))
    np.fill_diagonal(M, 1.2 * np.abs(M).sum(axis=1))
    return planted_lcp(M, random, bounds=False)


@pytest.mark.parametrize(("name", "options"), METHODS, ids=[name for name, _ in METHODS])
@pytest.mark.parametrize("seed", range(3))
def test_errors_stay_below_the_matrix_of_which_it_is_the_radius(
    name: str, options: dict[str, Any], seed: int
) -> None:
    """|z_{k+1} − z*| ≤ T |z_k − z*| in every component of every step; of a modulus method by a step of x."""
    problem, exact = planted(seed)
    algorithm = create(name, options)
    T = bound_of_errors(problem, algorithm.facts(problem))
    z0 = np.random.default_rng(seed + 50).random(problem.n) * 3
    iterates = [
        step.z.copy() for step, _ in zip(algorithm.iterates(problem, z0), range(8), strict=False)
    ]
    if name.startswith("m"):  # |z − z*| ≤ |x − x*| alone: the radius is that of the errors of x
        iterates = []
    for before, after in pairwise(iterates):
        assert (abs(after - exact) <= T @ abs(before - exact) + 1e-13).all()
    assert convergence_guarantee(problem, algorithm).spectral_radius == pytest.approx(
        max(abs(np.linalg.eigvals(T)))
    )


def test_it_is_no_larger_than_a_proved_rate() -> None:
    """ρ(T) ≤ c of a projected relaxation's proof; it is that of Jacobi's and Gauss–Seidel's matrices where known."""
    n = 40
    M = sp.diags_array([-np.ones(n - 1), 2.5 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    problem = LCP(M, -np.ones(n))
    cosine = 2 * np.cos(np.pi / (n + 1)) / 2.5
    jacobi, seidel = (convergence_guarantee(problem, name) for name in ("pj", "pgs"))
    assert jacobi.jacobi_radius == pytest.approx(cosine)
    assert jacobi.spectral_radius == pytest.approx(cosine)
    assert seidel.spectral_radius == pytest.approx(cosine**2)
    for name, options in METHODS:
        found = convergence_guarantee(problem, name, **options)
        if name in ("pj", "pgs", "psor", "paor") and found.rate is not None:
            assert found.spectral_radius <= found.rate * (1 + 1e-9), name


def test_what_has_none_says_none() -> None:
    """A direct method has no such matrix; a symmetric sweep of two halves gives none here."""
    problem, _ = planted(0)
    assert convergence_guarantee(problem, "lemke").spectral_radius is None
    assert convergence_guarantee(problem, "pgs", sweep="symmetric").spectral_radius is None
    large = gallery.build("obstacle_2d", size=33).problem
    assert convergence_guarantee(large, "pgs").spectral_radius is None
