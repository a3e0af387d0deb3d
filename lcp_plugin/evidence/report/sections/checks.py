"""Cross-validation: our answers beside those of convex solvers that share no code with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from typing import Any

from ...cross_check import cross_validate
from ...exporting import csv_of, finite_content
from ...gallery import parse
from ..section import Collected, Compute, Effort, Finding, Say, Section, many

CHECKED = (
    "paper_example_1:n=900", "half_active:n=900", "obstacle_2d:size=30", "obstacle_bumps:size=30",
    "optimal_stopping:size=20", "journal_bearing:size=30", "american_put:size=301", "rigid_stack", "market_equilibrium",
)


class CrossValidation(Section):
    """Our answer beside another's on some scenes."""

    kind = "check"
    place = 6
    title = "Cross-validation"
    short = "Cross-validation"

    def work(self, effort: Effort) -> dict[str, Compute]:
        """Return one part a scene."""
        return {text: partial(_computed, text, effort) for text in CHECKED[: 5 if effort.is_quick else None]}

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield the verdicts."""
        verdicts = Counter(content["verdict"] for content in collected.of("check"))
        if verdicts:
            said = ", ".join(f"{number} {verdict}" for verdict, number in verdicts.most_common())
            yield Finding("Against convex solvers", f"Cross-validation of {many(verdicts.total(), 'scene')}: {said}.")

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return one row a scene."""
        return {"checks": collected.of("check")} if collected.of("check") else {}

    def files(self, collected: Collected) -> dict[str, str]:
        """Return one row a scene."""
        checks = collected.of("check")
        return {"cross_validation.csv": csv_of(checks)} if checks else {}


def _computed(text: str, effort: Effort, say: Say) -> dict[str, Any]:
    problem = parse(text).problem
    outcome = cross_validate(problem, max_seconds=effort.reference_seconds)
    found: dict[str, Any] = finite_content({
        "scene": text, "n": problem.n, "verdict": outcome.verdict, "reason": outcome.reason,
        "reference": outcome.reference, "difference_z": outcome.difference_z, "difference_w": outcome.difference_w,
        "ours": outcome.ours.relative_residual,
        "theirs": None if outcome.theirs is None else outcome.theirs.relative_residual,
        "certified": {name: said.verdict for name, said in outcome.proved.items()}.get("ours"),
    })
    return found
