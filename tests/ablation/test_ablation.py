"""The list of mechanisms finds what it leaves out, and the page has a line for each."""

from __future__ import annotations

from itertools import islice
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


def tiny() -> inputs.Input:
    return inputs.Input("tiny", "0", lambda: solve(LCP(*TINY)), _is_right)


def _is_right(result: Any) -> str:
    return inputs.RIGHT if np.allclose(result.z, [0.75, 0.0]) else inputs.FALSE


def test_a_mechanism_is_found() -> None:
    """The definitions that are patched exist; a missing one fails."""
    for mechanism in MECHANISMS:
        with replaced(mechanism.patches):
            pass
    with (
        pytest.raises(KeyError),
        replaced([Patch("methods.small.rounds:Rounds.taken", says(None))]),
    ):
        pass


def test_a_claim_is_a_test() -> None:
    """The test that a mechanism is kept for stands where the list says."""
    for claim in filter(None, (one.claim for one in MECHANISMS)):
        path, _, name = claim.partition("::")
        assert f"\ndef {name}(" in (HERE.parent / path).read_text(encoding="utf-8"), claim


def test_page_has_a_line_for_each() -> None:
    """ablation.md has a line per mechanism, in the order of the list."""
    assert [*measuring.rows_of_page()][2:] == [*NAMES]


def test_package_is_put_back() -> None:
    """A function is replaced where others imported it, and watched; afterwards all is as before."""
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


def test_a_loss_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """An exception without a mechanism is counted against leaving it out; what would do the same is not met."""

    def wrong(old: Any) -> Any:
        return lambda *_, **__: 1 / 0

    tally = measuring.Tally("tiny")
    tally.runs.append(measuring.measure(tiny(), [Patch("auto:first_candidate", Instead(wrong))]))
    assert tally.losses() == ["1 right", "1 raised"]
    monkeypatch.setattr(measuring, "inputs", lambda: iter([tiny()]))
    assert measuring.meetings([*NAMES])["search"] == []


@pytest.mark.full
def test_inputs_can_be_judged() -> None:
    """The first inputs of each source are not judged to be false."""
    for source in (inputs.applications(), inputs.published(), inputs.campaign()):
        for one in islice(source, 2):
            assert one.judge(one.solve()) != inputs.FALSE, one.name
