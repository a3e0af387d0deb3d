"""The stability atlas: answers on stiff, extreme and degenerate problems, held against exact ones."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from ..stability import PROVED, RANGES, Atlas, Cell, stability_atlas
from ..stresses import FAMILIES
from .section import Collected, Compute, ReportEffort, Say, Section, figure

TOO_LONG_FOR_QUICK = ("sizes", RANGES, PROVED)


class Stability(Section):
    """Algorithms against families of stress."""

    kind = "atlas"
    place = 2
    title = "Stability atlas"
    short = "Stability"

    def work(self, effort: ReportEffort) -> dict[str, Compute]:
        """Return one part a family."""
        families = [one for one in FAMILIES if not (effort.is_quick and one in TOO_LONG_FOR_QUICK)]
        return {family: partial(_stressed, family, effort) for family in families}

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


def _stressed(family: str, effort: ReportEffort, say: Say) -> dict[str, Any]:
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
