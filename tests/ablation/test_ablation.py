"""The list of mechanisms finds what it leaves out, and the page has a line for each."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lcp_plugin import LCP, auto, solve
from lcp_plugin.methods.small import rounds

from . import inputs, measuring
from .mechanisms import MECHANISMS, NAMES, says
from .switching import Instead, Patch, replaced

HERE = Path(__file__).parent
TINY = [[4.0, -1.0], [-1.0, 4.0]], [-3.0, 5.0]


def one(judge: Any = inputs._by_residual) -> inputs.Input:
    return inputs.Input("tiny", "0", lambda: LCP(*TINY), solve, judge)


def test_a_mechanism_is_found() -> None:
    """What is patched stands there, and so do the lines that would go."""
    for mechanism in MECHANISMS:
        with replaced(mechanism.patches):
            pass
        assert (mechanism.lines > 0) is bool(mechanism.goes), mechanism.name


def test_a_claim_is_a_test() -> None:
    """The test that a mechanism is kept for stands where the list says."""
    for claim in filter(None, (one.claim for one in MECHANISMS)):
        path, _, name = claim.partition("::")
        assert f"\ndef {name}(" in (HERE.parent / path).read_text(encoding="utf-8"), claim


def test_what_is_no_more_is_missed() -> None:
    """A mechanism that has another name now, or another module, fails."""
    with (
        pytest.raises(KeyError),
        replaced([Patch("methods.small.rounds:Rounds.taken", says(None))]),
    ):
        pass
    with pytest.raises(ModuleNotFoundError), replaced([Patch("methods.smaller:taken", says(None))]):
        pass


def test_names_are_unique() -> None:
    """No name stands twice."""
    assert len(NAMES) == len(MECHANISMS)


def test_page_has_a_line_for_each() -> None:
    """ablation.md has a line per mechanism, in the order of the list."""
    assert [*measuring.rows_of_page()][2:] == [*NAMES]


def test_package_is_put_back() -> None:
    """A function is replaced where others imported it, too, and watched; afterwards all is as before."""
    before = rounds.is_small
    patch = Patch("methods.small.rounds:is_small", says(False))
    with replaced([patch], watched=True):
        assert auto.is_small is not before
        assert solve(LCP(*TINY)).z.round(6).tolist() == [0.75, 0.0]
    assert patch.times > 0
    with replaced([patch]):
        assert auto.is_small is rounds.is_small is not before
        assert solve(LCP(*TINY)).z.round(6).tolist() == [0.75, 0.0]
    assert auto.is_small is rounds.is_small is before


def test_a_loss_is_seen() -> None:
    """What raises without a mechanism, and so has no answer, is counted against leaving it out."""

    def wrong(old: Any) -> Any:
        return lambda *_, **__: 1 / 0

    tally = measuring.Tally("tiny")
    tally.runs.append(measuring.measure(one(), [Patch("auto:first_answer", Instead(wrong))]))
    assert tally.losses() == ["1 solved", "1 raised"]


def test_what_would_do_the_same_is_not_met(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mechanism that is asked and has nothing to say is not met; one that has is."""
    monkeypatch.setattr(measuring, "inputs", lambda: iter([one()]))
    found = measuring.meetings([*NAMES])
    assert found["search"] == []
    assert found["banded"] == []


def test_false_answers_are_seen() -> None:
    """Residuals are measured by other means than ours."""
    problem = LCP(*TINY)
    assert inputs.residual(problem, np.array([0.75, 0.0])) == 0.0
    assert inputs.residual(problem, np.array([0.75, 0.1])) > 1e-3


@pytest.mark.full
def test_unknown_names_are_refused() -> None:
    """Exit code 2, and the names that there are."""
    done = subprocess.run(
        [sys.executable, str(HERE), "bandid"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "'bandid'; there are banded" in done.stderr


@pytest.mark.full
def test_inputs_can_be_judged() -> None:
    """The first problem of each source is solved, or proved to have no solution, or left open without one."""
    for source, made in inputs.SOURCES.items():
        given = next(made(), None)
        if given is not None:  # published problems need not be here
            problem = given.state()
            assert given.source == source
            assert given.judge(problem, given.solve(problem)) != inputs.FALSE, source
