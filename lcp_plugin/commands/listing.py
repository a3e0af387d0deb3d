"""What `lcp-plugin list` prints."""

from __future__ import annotations

import sys

from ..errors import LCPError


def list_everything() -> None:
    """Print the algorithms with what they need, and the scenes with their parameters."""
    from rich.console import Console
    from rich.table import Table

    from ..algorithms import REGISTRY, algorithm_class, from_other_packages
    from ..evidence.gallery import describe

    algorithms = Table(title="Algorithms", title_justify="left", show_lines=False)
    for heading in ("name", "needs", "proved to converge on", "an iteration costs", "source"):
        algorithms.add_column(heading)
    foreign = from_other_packages()
    for name, kind in [*((name, algorithm_class(name)) for name in REGISTRY), *foreign.items()]:
        if not isinstance(kind, LCPError):
            facts = (getattr(kind, fact, "–") for fact in ("assumption", "converges_on", "cost", "reference"))
            algorithms.add_row(name, *facts)
    scenes = Table(title="Scenes", title_justify="left")
    for heading in ("name", "what", "parameters"):
        scenes.add_column(heading)
    for name, summary, parameters in describe():
        scenes.add_row(name, summary, ", ".join(f"{key}={value}" for key, value in parameters.items()))
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(algorithms)
    for error in (one for one in foreign.values() if isinstance(one, LCPError)):
        console.print(f"left out: {error}\n", markup=False, highlight=False)
    console.print(scenes)
