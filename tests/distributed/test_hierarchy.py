"""The hierarchy of rows on several ranks is what products of whole matrices say."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import pytest
from launch import run

PROBLEMS = ("obstacle_2d", "obstacle_3d", "wind", "anisotropy", "one way")
RANKS = (1, 2, 3, 4)


@functools.cache
def found(ranks: int) -> dict[str, dict[str, float]]:
    done = run(ranks, str(Path(__file__).parent / "hierarchy_on_ranks.py"))
    assert done.returncode == 0, done.stderr
    answer: dict[str, dict[str, float]] = json.loads(done.stdout.strip().splitlines()[-1])
    return answer


@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_transfers_and_products_are_those_of_whole_matrices(ranks: int, name: str) -> None:
    """R is Pᵀ (Pᵀ D⁻¹), every coarse matrix R M P, and there are at least three grids."""
    here = found(ranks)[name]
    assert here["grids"] >= 3
    assert here["transfers"] < 1e-14
    assert here["products"] < 1e-13


@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_an_update_on_ranks_equals_a_computation_from_scratch(ranks: int, name: str) -> None:
    """After any sequence of free sets the coarse matrices are those of the truncated interpolation."""
    assert found(ranks)[name]["truncation"] < 1e-11


@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("name", ["obstacle_2d", "obstacle_3d", "anisotropy"])
def test_a_cycle_on_ranks_is_symmetric(ranks: int, name: str) -> None:
    """The truncated V-cycle is a symmetric map, so that conjugate gradients may use it, and moves no fixed unknown."""
    assert found(ranks)[name]["cycle"] < 1e-10
