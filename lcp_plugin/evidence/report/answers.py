"""Answers held against others: exact ones (the atlas), the paper's tables, convex solvers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from ...gallery import parse
from ..cross_check import cross_validate
from ..exporting import finite_content
from ..paper_tables import cells
from ..stability import PROVED, RANGES, Atlas, Cell, stability_atlas
from ..stresses import FAMILIES
from .section import Collected, Compute, Effort, Finding, Say, Section, figure, many, percent

# --- The stability atlas ---------------------------------------------------------------------------------------

TOO_LONG_FOR_QUICK = ("sizes", RANGES, PROVED)


class Stability(Section):
    """Algorithms against families of stress."""

    kind = "atlas"
    anchor = "stability"
    place = 4
    title = "Stability atlas"
    short = "Stability"

    def work(self, effort: Effort) -> dict[str, Compute]:
        """Return one part a family."""
        families = [one for one in FAMILIES if not (effort.is_quick and one in TOO_LONG_FOR_QUICK)]
        return {family: partial(_stressed, family, effort) for family in families}

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield the lies, the share of SOLVED, and the errors that a small residual hides."""
        atlas = _whole(collected)
        runs = f"{many(len(atlas.cells), 'run')} on stiff, extreme and degenerate problems"
        text = (f"{runs}: {many(len(atlas.lies), 'lie')}; of the {len(atlas.well_posed)} well-posed ones "
                f"{percent(atlas.solved_share)} are SOLVED.")
        if atlas.misleading:
            well_posed = sum(cell.is_well_posed for cell in atlas.misleading)
            text += (f" {len(atlas.misleading)} of the SOLVED ones hide an error of more than a thousandth behind a "
                     f"small residual, {well_posed} of them well-posed.")
        yield Finding("Stability", text)

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return the table of algorithms against families, and every cell worth a word."""
        atlas = _whole(collected)
        families = list(dict.fromkeys(cell.family for cell in atlas.cells))
        cells: dict[str, dict[str, list[Cell]]] = {}
        for cell in atlas.cells:
            cells.setdefault(cell.algorithm, {family: [] for family in families})[cell.family].append(cell)
        maps = [
            figure(atlas.plot(family=family), family.replace(" ", "-"), f"Stability: {family}")
            for family in (RANGES, PROVED) if family in families
        ]
        return {
            "maps": maps, "atlas": atlas, "families": families,
            "absent": [one for one in FAMILIES if one not in families],
            "rows": {name: [_tally(own) for own in row.values()] for name, row in cells.items()},
            "misleading": sorted(atlas.misleading, key=lambda cell: cell.condition),
        }

    def files(self, collected: Collected) -> dict[str, str]:
        """Return every cell."""
        return {"stability.csv": _whole(collected).to_csv()}


def _stressed(family: str, effort: Effort, say: Say) -> dict[str, Any]:
    def progress(done: int, total: int, label: str) -> None:
        say(f"{done} of {total}, {label}")

    return stability_atlas(stresses=[family], quick=effort.is_quick, progress=progress).to_content()


def _whole(collected: Collected) -> Atlas:
    """Return the atlas of all families."""
    return sum(map(Atlas.from_content, collected.of("atlas")), Atlas((), ()))


def _tally(cells: Sequence[Cell]) -> dict[str, Any] | None:
    if not cells:
        return None
    solved = sum(cell.status == "SOLVED" for cell in cells)
    lies = sum(not cell.told_the_truth for cell in cells)
    return {"solved": solved, "count": len(cells), "lies": lies, "share": solved / len(cells)}


# --- The paper's tables ---------------------------------------------------------------------------------------


class PaperTables(Section):
    """The paper's two tables, computed again: in each cell our count, and the paper's where it differs."""

    kind = anchor = "tables"
    place = 5
    title = "The paper's tables, computed again"
    short = "Paper's tables"
    table = "paper_tables.csv"

    def work(self, effort: Effort) -> dict[str, Compute]:
        """Return one part: both tables."""
        return {"paper": lambda say: {"cells": [finite_content(asdict(cell)) for cell in cells()]}}

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield how many counts agree."""
        every = self.rows(collected)
        equal = sum(cell["iterations"] == cell["paper_iterations"] for cell in every)
        text = f"The iteration counts agree in {equal} of {len(every)} cells, computed now."
        yield Finding("The paper's tables", text)

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return the rows of each example by algorithm and relaxation."""
        tables: dict[int, dict[str, list[Any]]] = {}
        for cell in self.rows(collected):
            name = f"{cell['algorithm']} {cell['relaxation'] or ''}".strip()
            tables.setdefault(cell["example"], {}).setdefault(name, []).append(cell)
        return {"tables": tables}

    def rows(self, collected: Collected) -> list[dict[str, Any]]:
        """Return every cell."""
        return [cell for content in collected.of(self.kind) for cell in content["cells"]]


# --- Cross-validation -----------------------------------------------------------------------------------------

CHECKED = (
    "paper_example_1:n=900", "half_active:n=900", "obstacle_2d:size=30", "obstacle_bumps:size=30",
    "optimal_stopping:size=20", "journal_bearing:size=30", "american_put:size=301", "rigid_stack", "market_equilibrium",
)


class CrossValidation(Section):
    """Our answer beside that of a convex solver that shares no code with it, on some scenes."""

    kind = "check"
    anchor = "checks"
    place = 6
    title = short = "Cross-validation"
    table = "cross_validation.csv"

    def work(self, effort: Effort) -> dict[str, Compute]:
        """Return one part a scene."""
        return {text: partial(_checked, text, effort) for text in CHECKED[: 5 if effort.is_quick else None]}

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield the verdicts."""
        verdicts = Counter(check["verdict"] for check in self.rows(collected))
        said = ", ".join(f"{number} {verdict}" for verdict, number in verdicts.most_common())
        yield Finding("Against convex solvers", f"Cross-validation of {many(verdicts.total(), 'scene')}: {said}.")

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return one row a scene."""
        return {"checks": self.rows(collected)}


def _checked(text: str, effort: Effort, say: Say) -> dict[str, Any]:
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
