"""A problem changed in a way that its answers survive: every algorithm finds them again where it is proved to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inputs.families import BOUNDED, KINDS
from oracles.relations import EXACT, RELATIONS, data_of

from lcp_plugin import LCP, Status, analyze, solve
from lcp_plugin.strategies import h_plus_matrices, solved_lcps

ARRIVED = (Status.SOLVED, Status.PRECISION_LIMIT)
SEEDS = st.integers(0, 2**32 - 1)


def proved_on(*words: str) -> list[str]:
    """The algorithms whose proofs name one of these classes, and auto."""
    return [
        "auto",
        *(name for name, kind in KINDS.items() if any(word in kind.solves for word in words)),
    ]


@st.composite
def definite_matrices(draw: st.DrawFn) -> np.ndarray:
    """I + B Bᵀ of small condition, as a rule no H₊-matrices: no method needs long."""
    n = draw(st.integers(1, 4))
    B = np.array(
        draw(st.lists(st.integers(-1, 1), min_size=n * n, max_size=n * n)), dtype=float
    ).reshape(n, n)
    return np.eye(n) + B @ B.T


def comparison(M: np.ndarray) -> np.ndarray:
    """⟨M⟩, which is an M-matrix where M is an H₊-matrix."""
    return np.where(np.eye(len(M), dtype=bool), abs(M), -abs(M))


SMALL = st.integers(1, 5)
# What is drawn, and which algorithms are proved to solve it.
CLASSES: dict[str, tuple[Any, list[str]]] = {
    "H₊, bounds": (solved_lcps(h_plus_matrices(SMALL), bounds=True), [*proved_on("H₊"), "lemke"]),
    "H₊": (solved_lcps(h_plus_matrices(SMALL)), [*proved_on("H₊"), "lemke"]),
    "M": (
        solved_lcps(h_plus_matrices(SMALL).map(comparison)),
        [*proved_on("H₊", "M-matrices, bounds"), "lemke"],
    ),
    "SPD, bounds": (solved_lcps(definite_matrices(), bounds=True), proved_on("SPD", "PSD")),
}
LOSES = {  # what a relation takes from a class, beyond which the proofs do not reach
    "split": ("auto", "lemke"),
    "with a free row": ("auto", "lemke", *(name for name in proved_on("H₊") if name != "newton")),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("relation", RELATIONS)
@pytest.mark.parametrize("kind", CLASSES)
def test_answers_survive_a_change_of_the_problem(relation, kind):
    """On the classes of its proof each algorithm solves the changed problem, and the way back leads to the answer."""
    problems, proved = CLASSES[kind]
    names = [name for name in proved if name in LOSES.get(relation, proved)]
    assert "auto" in names

    @settings.get_profile("few")
    @given(problems, SEEDS)
    def agrees(drawn, seed):
        problem, exact = drawn
        before = data_of(problem)
        changed, back = RELATIONS[relation](problem, np.random.default_rng(seed))
        truth = np.array(exact, dtype=float)
        for name in names:
            if name not in ("auto", *BOUNDED) and not changes_to_lower_bounds(changed):
                continue
            result = solve(changed, name, tolerance=1e-12)
            assert result.status in ARRIVED, (name, result.status)
            error = abs(back(result.z) - truth).max()
            assert error <= 1e-6 * (1.0 + abs(truth).max()), (name, error)
        assert data_of(problem) == before

    agrees()


def changes_to_lower_bounds(problem: LCP) -> bool:
    """Whether the modulus methods take it."""
    return bool(np.isfinite(problem.lower).all() and np.all(problem.upper == np.inf))


@pytest.mark.parametrize(
    "relation", [name for name in EXACT if name not in ("split", "twice", "with a free row")]
)
def test_no_verdict_on_a_matrix_contradicts_that_on_a_changed_one(relation):
    """H, H₊ and P survive permutation, positive scaling and a regular neighbor: never True here and False there."""

    @settings.get_profile("few")
    @given(st.integers(1, 5), SEEDS)
    def agrees(n, seed):
        rng = np.random.default_rng(seed)
        M = rng.integers(-3, 4, (n, n)) + np.diag(rng.integers(0, 7, n)).astype(float)
        changed = RELATIONS[relation](LCP(M, np.zeros(n)), rng).problem
        one, other = analyze(M), analyze(changed.M)
        for verdict in ("is_h_matrix", "is_h_plus", "is_p_matrix"):
            pair = {getattr(one, verdict), getattr(other, verdict)}
            assert pair != {True, False}, (verdict, M)

    agrees()
