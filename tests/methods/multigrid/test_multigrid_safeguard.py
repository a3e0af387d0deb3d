"""The theorem on projected multigrid: it converges on symmetric positive definite M whatever its corrections are."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from planted import planted_lcp

from lcp_plugin import LCP, Status, gallery, solve
from lcp_plugin.methods.multigrid import Multigrid
from lcp_plugin.methods.multigrid.multigrid_safeguard import Safeguard
from lcp_plugin.proofs.guarantees import convergence_guarantee
from lcp_plugin.systems.hierarchy.truncation import Truncation

WAYS: dict[str, Callable[[np.ndarray, np.random.Generator], Any]] = {
    "random": lambda x, generator: generator.normal(size=x.size) * np.abs(x).max(initial=0.0),
    "reversed": lambda x, generator: -x,
    "zero": lambda x, generator: 0.0,
    "a million times too large": lambda x, generator: 1e6 * x,
    "a little too large": lambda x, generator: 2.2 * x,
    "no number": lambda x, generator: np.nan,
}


def break_corrections(monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    correct, generator = Truncation.correct, np.random.default_rng(0)

    def broken(self: Truncation, k: int) -> None:
        correct(self, k)
        self.grids[k].x[:] = WAYS[way](self.grids[k].x.copy(), generator)

    monkeypatch.setattr(Truncation, "correct", broken)


@pytest.mark.few(1)
@pytest.mark.parametrize("scene", ["obstacle_2d:size=20", "elastic_plastic_torsion:size=20"])
@pytest.mark.parametrize("way", WAYS)
def test_broken_corrections_do_not_keep_it_from_the_solution(
    monkeypatch: pytest.MonkeyPatch, way: str, scene: str
) -> None:
    """With each V-cycle's answer replaced by nonsense the run is SOLVED all the same, at the same z."""
    problem = gallery.parse(scene).problem
    expected = solve(problem, "multigrid", tolerance=1e-11).z
    break_corrections(monkeypatch, way)
    result = solve(problem, "multigrid")
    assert result.status is Status.SOLVED
    assert np.abs(result.z - expected).max() <= 1e-5 * np.abs(expected).max()


def planted(seed: int, n: int) -> tuple[LCP, np.ndarray]:
    """Return a problem with a positive definite M, couplings of both signs, bounds of all kinds, and its solution."""
    generator = np.random.default_rng(seed)
    B = sp.random_array(
        (n, n), density=3.0 / n, rng=generator, data_sampler=generator.standard_normal
    )
    M = sp.csr_array(B @ B.T + sp.diags_array(generator.uniform(0.3, 1.0, n)))
    return planted_lcp(M, generator)


@given(st.integers(0, 10**6), st.integers(70, 150), st.sampled_from(sorted(WAYS)))
def test_it_converges_on_positive_definite_matrices_from_any_start(
    seed: int, n: int, way: str
) -> None:
    """Planted solutions are found from random starts, corrections broken, with few unknowns on the coarsest grid."""
    problem, z = planted(seed, n)
    start = np.random.default_rng(seed + 1).normal(scale=100.0, size=n)
    with pytest.MonkeyPatch.context() as monkeypatch:
        break_corrections(monkeypatch, way)
        result = solve(problem, "multigrid", z0=start, coarsest=5, tolerance=1e-9)
    assert result.status is Status.SOLVED
    assert np.abs(result.z - z).max() <= 1e-6


def test_free_sets_that_come_back_do_not_hold_up_the_run() -> None:
    """Where rounds on one free set after the other would go in a circle, the run goes on by single corrections."""
    generator = np.random.default_rng(2924)
    n = int(generator.integers(100, 350))
    density = generator.uniform(2, 5) / n
    B = sp.random_array(
        (n, n), density=density, rng=generator, data_sampler=generator.standard_normal
    )
    M = sp.csr_array(B @ B.T + 10.0 ** -generator.uniform(1, 4) * sp.eye_array(n))
    problem = LCP(M, generator.normal(size=n))
    result = solve(problem, "multigrid", z0=generator.normal(scale=10.0, size=n))
    assert result.status is Status.SOLVED
    assert result.iterations <= 300


@pytest.mark.few(3)
@pytest.mark.parametrize("way", sorted(WAYS))
def test_the_energy_of_accepted_iterates_falls(monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    """From one accepted iterate to the next the energy falls, or the least residual does by a tenth."""
    problem = gallery.build("obstacle_2d", size=12).problem
    taken: list[tuple[float, float]] = []
    accept = Safeguard._accept

    def noted(
        self: Safeguard, z: np.ndarray, residual: float, slack: np.ndarray | None = None
    ) -> None:
        taken.append((float(z @ (0.5 * (problem.csr @ z) + problem.q)), residual))
        accept(self, z, residual, slack)

    monkeypatch.setattr(Safeguard, "_accept", noted)
    break_corrections(monkeypatch, way)
    assert solve(problem, "multigrid", coarsest=5, tolerance=1e-10).is_solved
    assert len(taken) > 3
    least = np.inf
    for (before, _), (energy, residual) in pairwise(taken):
        assert energy <= before + 1e-12 * abs(before) or residual < 0.9 * least
        least = min(least, residual)


@given(st.integers(0, 10**6))
def test_the_change_of_the_energy_is_exact_up_to_its_own_margin(seed: int) -> None:
    """Beside rational arithmetic the computed change is off by at most what is said about rounding."""
    problem, z = planted(seed, 12)
    generator = np.random.default_rng(seed)
    one, other = z + generator.normal(size=12), z + generator.normal(scale=1e-6, size=12)

    def energy(point: np.ndarray) -> Fraction:
        x = [Fraction(float(value)) for value in point]
        M, q = problem.csr.toarray(), problem.q
        rows = [sum((Fraction(M[i, j]) * x[j] for j in range(12)), Fraction(0)) for i in range(12)]
        return sum((x[i] * (rows[i] / 2 + Fraction(float(q[i]))) for i in range(12)), Fraction(0))

    change, noise, _ = Safeguard(problem, True, one, 1.0)._energy_change(other)
    assert abs(Fraction(change) - (energy(other) - energy(one))) <= Fraction(noise)


def test_what_is_proven_about_multigrid() -> None:
    """It is guaranteed on positive definite matrices, unless it hands over; not on others."""
    problem = gallery.build("obstacle_2d", size=10).problem
    assert convergence_guarantee(problem, "multigrid").is_guaranteed
    assert not convergence_guarantee(problem, Multigrid(hands_over=True)).is_guaranteed
    assert not convergence_guarantee(
        LCP([[1.0, -2.0], [-2.0, 1.0]], [0.0, 0.0]), "multigrid"
    ).is_guaranteed
    assert not convergence_guarantee(
        LCP([[2.0, -1.0], [-0.5, 2.0]], [0.0, 0.0]), "multigrid"
    ).is_guaranteed
