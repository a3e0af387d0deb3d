"""The collection: what its entries claim is true, and auto solves, proves infeasible or certifies every one of them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from collection import all_entries
from collection.entry import Entry
from collection.judgement import false_claim, judge
from oracles.truth import INFEASIBLE, SOLVABLE, ExactData, decide

from lcp_plugin import LCP, solve

TOLERANCE = 1e-9
ENTRIES = all_entries()


def named(entry: Entry) -> str:
    return entry.name


# --- What the entries claim -----------------------------------------------------------------------------------------


def test_names_are_unique_and_sources_are_given():
    """Every entry has a name of its own and says where it comes from; there are at least 120."""
    assert len({entry.name for entry in ENTRIES}) == len(ENTRIES) >= 120
    assert all(entry.source for entry in ENTRIES)


@pytest.mark.full
def test_declared_solutions_are_exact():
    """Each declared solution is complementary in rational arithmetic, without any tolerance."""
    wrong = [
        e.name
        for e in ENTRIES
        if e.solution is not None and not ExactData(e.problem).is_solution(e.solution)
    ]
    assert not wrong


@pytest.mark.full
def test_exhaustive_search_agrees_with_every_small_entry():
    """Up to twelve unknowns the declared truth is what an exact, independent search finds."""
    for entry in ENTRIES:
        if entry.is_small:
            truth = decide(entry.problem)
            assert truth.verdict == entry.truth, entry.name
            assert truth.z is None or ExactData(entry.problem).is_solution(truth.z), entry.name


@pytest.mark.parametrize(
    ("truth", "status", "z", "complaint"),
    [
        (SOLVABLE, "SOLVED", [2.0, 0.0], ""),
        (SOLVABLE, "SOLVED", [2.0 + 1e-7, 0.0], "lie"),
        (INFEASIBLE, "SOLVED", [2.0, 0.0], "false SOLVED"),
        (SOLVABLE, "INFEASIBLE", [2.0, 0.0], "false INFEASIBLE"),
        (INFEASIBLE, "INFEASIBLE", [2.0, 0.0], "without a proof"),
        (SOLVABLE, "STALLED", [0.0, 0.0], ""),
    ],
)
def test_false_claims_are_noticed(truth, status, z, complaint):
    """The judge of this file and of the campaigns objects to each kind of false claim, and to no honest one."""
    claim = SimpleNamespace(status=SimpleNamespace(name=status), z=np.array(z), infeasibility=None)
    message = false_claim(LCP([[2.0, 1.0], [1.0, 2.0]], [-4.0, -2.0]), truth, claim, TOLERANCE)
    assert complaint in message
    assert bool(complaint) == bool(message)


# --- What auto makes of them ----------------------------------------------------------------------------------------


@pytest.mark.quick(8)
@pytest.mark.parametrize("entry", ENTRIES, ids=named)
def test_auto_says_the_truth(entry):
    """Solvable: solved to 1e-9 or as far as rounding permits; else proven infeasible, or searched without a find."""
    result = solve(entry.problem, tolerance=TOLERANCE)
    assert judge(entry, result, TOLERANCE) == ""
