"""A matrix with the wrong sign is told so at once, what may solve it is tried, and nothing that takes long."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, Status, analyze, solve
from lcp_plugin.proofs.verdicts.report import sign_remark


def negated_laplacian(k: int) -> sp.csr_array:
    """Return minus the five-point stencil on k × k nodes."""
    line = sp.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(k, k))
    return sp.csr_array(sp.kron(line, sp.eye_array(k)) + sp.kron(sp.eye_array(k), line))


def stages_of(result: Any) -> list[str]:
    return [stage.name for stage in result.stages]


@pytest.mark.few(2)
@pytest.mark.parametrize("k", [4, 10])
def test_a_negated_m_matrix_is_proved_infeasible(k: int) -> None:
    """A problem with −M an M-matrix and a random q has no solution, and a proof shows it."""
    M, rng = negated_laplacian(k), np.random.default_rng(k)
    infeasible = solve(LCP(M, rng.standard_normal(k * k)))
    assert infeasible.status is Status.INFEASIBLE
    assert infeasible.infeasibility.verify()


@pytest.mark.few(1)
@pytest.mark.parametrize("bounds", [{"lower": -1.0}, {"lower": np.r_[-np.inf, np.zeros(15)]}])
def test_lower_bounds_may_be_any(bounds: dict[str, Any]) -> None:
    """The same holds for lower bounds of any kind, free rows included, as far as a proof can be had."""
    M, statuses = negated_laplacian(4), set()
    for seed in range(20):
        problem = LCP(M, 3.0 * np.random.default_rng(seed).standard_normal(16), **bounds)
        result = solve(problem)
        x = -np.linalg.solve(M.toarray(), problem.q)
        assert result.is_solved == bool((x >= problem.lower - 1e-12).all())
        statuses.add(result.status)
    assert statuses <= {Status.SOLVED, Status.INFEASIBLE}


@pytest.mark.parametrize(
    ("M", "words"),
    [
        (
            [[-2.0, 1.0], [1.0, -2.0]],
            "(M[0, 0] = -2.0), and −M is a positive definite M-matrix: is its sign right?",
        ),
        ([[-2.0, 1.0], [0.5, -2.0]], "and −M is an M-matrix"),
        ([[-2.0, -1.0], [1.0, -2.0]], "and −M is an H₊-matrix"),
        ([[-1.0, -2.0], [2.0, -3.0]], "(M[0, 0] = -1.0): is its sign right?"),
        ([[-1.0, 2.0], [2.0, 0.0]], ""),
        (np.zeros((0, 0)), ""),
    ],
)
def test_the_remark_says_what_is_proved(M: Any, words: str) -> None:
    """Where every diagonal entry is negative, the remark shows one and says what −M is proved to be; else nothing."""
    said = sign_remark(LCP(M, np.zeros(len(M))).matrix)
    assert words in said
    assert bool(said) == bool(words)
    if "M-matrix" in words:
        assert analyze(-np.array(M)).is_m_matrix
