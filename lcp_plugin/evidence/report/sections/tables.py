"""The paper's two tables, computed again, and how many of their counts agree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from ...exporting import csv_of, finite_content
from ...paper_tables import cells
from ..section import Collected, Compute, Effort, Finding, Say, Section


class PaperTables(Section):
    """One row an algorithm, in each cell our count, and the paper's where it differs."""

    kind = "tables"
    place = 5
    title = "The paper's tables, computed again"
    short = "Paper's tables"

    def work(self, effort: Effort) -> dict[str, Compute]:
        """Return one part: both tables."""
        return {"paper": _computed}

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield how many counts agree."""
        if every := _cells(collected):
            equal = sum(cell["iterations"] == cell["paper_iterations"] for cell in every)
            text = f"The iteration counts agree in {equal} of {len(every)} cells, computed now."
            yield Finding("The paper's tables", text)

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return the rows of each example by algorithm and relaxation."""
        tables: dict[int, dict[str, list[Any]]] = {}
        for cell in _cells(collected):
            name = f"{cell['algorithm']} {cell['relaxation'] or ''}".strip()
            tables.setdefault(cell["example"], {}).setdefault(name, []).append(cell)
        return {"tables": tables} if tables else {}

    def files(self, collected: Collected) -> dict[str, str]:
        """Return every cell."""
        every = _cells(collected)
        return {"paper_tables.csv": csv_of(every)} if every else {}


def _computed(say: Say) -> dict[str, Any]:
    return {"cells": [finite_content(asdict(cell)) for cell in cells()]}


def _cells(collected: Collected) -> list[dict[str, Any]]:
    return [cell for content in collected.of("tables") for cell in content["cells"]]
