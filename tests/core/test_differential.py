"""All algorithms against each other, against exact enumeration, and the long campaign's judges in a few cases."""

from __future__ import annotations

import campaign as trust
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.exact import exact_solution

from lcp_plugin import LCP, Status, UnsuitableMatrix, UnsuitableProblem, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.strategies import h_plus_matrices, solved_lcps

ALL = ["auto", *REGISTRY]


def answers(problem: LCP, names: list[str]) -> dict[str, np.ndarray]:
    """Z of every algorithm that says SOLVED, or that no better z has doubles."""
    found = {}
    for name in names:
        try:
            result = solve(problem, name, tolerance=1e-12)
        except (UnsuitableMatrix, UnsuitableProblem):
            continue
        if result.status in (Status.SOLVED, Status.PRECISION_LIMIT):
            found[name] = result.z
    return found


@settings.get_profile("few")
@given(solved_lcps(h_plus_matrices(st.integers(1, 5))))
def test_all_algorithms_agree_with_each_other_and_with_enumeration(drawn):
    """On an H₊-matrix all eighteen and auto find the one solution that exact enumeration finds, too."""
    problem, planted = drawn
    exact = exact_solution(problem)
    assert exact.z == planted
    found = answers(problem, ALL)
    # which have no proof on H₊
    assert {*ALL} - {*found} <= {"interior_point", "newton", "multigrid"}
    truth = np.array([float(value) for value in exact.z])
    for name, z in found.items():
        assert abs(z - truth).max() <= 1e-7 * (1.0 + abs(truth).max()), name


# --- The campaign itself --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", autouse=True)
def campaign_process():
    """Load the packages that the campaign compares with."""
    trust.load_others()


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", trust.ROUND)
def test_the_campaign_finds_nothing_in_a_few_cases(name):
    """Every kind of the long campaign runs, and finds nothing."""
    kinds = trust.ROUND[name][1]
    for k, kind in enumerate(kinds[:6]):
        found = [
            finding
            for finding in trust.run(name, kind, 7_000_000 + k)
            if finding.what in trust.VIOLATIONS
        ]
        assert not found, (kind, k)
