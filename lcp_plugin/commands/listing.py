"""What `lcp-plugin list` prints."""

from __future__ import annotations

import sys
from typing import Any

from ..errors import LCPError


def list_everything() -> None:
    """Print the algorithms with what they need and their sources, and the scenes with their parameters."""
    from rich.console import Console

    from ..algorithms import REGISTRY, Algorithm, algorithm_class, from_other_packages
    from ..evidence.gallery import describe

    foreign = from_other_packages()
    offers = {**{name: algorithm_class(name) for name in REGISTRY}, **foreign}
    kinds = {name: kind for name, kind in offers.items() if not isinstance(kind, LCPError)}
    references = dict.fromkeys(kind.reference for kind in kinds.values() if kind.reference != Algorithm.reference)
    sources = {reference: k for k, reference in enumerate(references, start=1)}
    algorithms = _table("Algorithms", "name", "needs", "proved to converge on", "an iteration costs", "source")
    for name, kind in kinds.items():
        source = f"[{sources[kind.reference]}]" if kind.reference in sources else kind.reference
        algorithms.add_row(name, kind.assumption, kind.converges_on, kind.cost, source)
    scenes = _table("Scenes", "name", "what", "parameters")
    for name, summary, parameters in describe():
        scenes.add_row(name, summary, ", ".join(f"{key}={value}" for key, value in parameters.items()))
    console = Console(width=None if sys.stdout.isatty() else 160, markup=False, highlight=False)
    console.print(algorithms)
    for reference, k in sources.items():
        console.print(f"[{k}] {reference}")
    for error in (one for one in foreign.values() if isinstance(one, LCPError)):
        console.print(f"left out: {error}")
    console.print()
    console.print(scenes)


def _table(title: str, *headings: str) -> Any:
    """Return an empty table that breaks long words rather than cutting them, and names never."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for heading in headings:
        table.add_column(heading, overflow="fold", no_wrap=heading in {"name", "source"})
    return table
