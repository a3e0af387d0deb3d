"""Tables on the terminal: what there is, and the paper's Tables 1 and 2 again, cell beside cell."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from ..errors import LCPError

PAPER_HEADINGS = (
    "algorithm", "n", "paper\nIT", "\nIT", "paper\nRes", "\nRes", "paper\nCPU", "\nCPU", "same\nIT", "same\nRes",
)


def print_everything() -> None:
    """Print the algorithms with what they need and their sources, and the scenes with their parameters."""
    from ..algorithms import REGISTRY, Algorithm, algorithm_class, from_other_packages
    from ..evidence.gallery import describe

    foreign = from_other_packages()
    offers = {**{name: algorithm_class(name) for name in REGISTRY}, **foreign}
    kinds = {name: kind for name, kind in offers.items() if not isinstance(kind, LCPError)}
    references = dict.fromkeys(kind.reference for kind in kinds.values() if kind.reference != Algorithm.reference)
    sources = {reference: f"[{k}]" for k, reference in enumerate(references, start=1)}
    headings = ("name", "needs", "proved to converge on", "an iteration costs", "source")
    algorithms = [
        (name, kind.assumption, kind.converges_on, kind.cost, sources.get(kind.reference, kind.reference))
        for name, kind in kinds.items()
    ]
    scenes = [
        (name, summary, ", ".join(f"{key}={value}" for key, value in parameters.items()))
        for name, summary, parameters in describe()
    ]
    console = _console(160)
    console.print(_table("Algorithms", headings, algorithms, pad_edge=False))
    for reference, source in sources.items():
        console.print(f"{source} {reference}")
    for error in (one for one in foreign.values() if isinstance(one, LCPError)):
        console.print(f"left out: {error}")
    console.print()
    console.print(_table("Scenes", ("name", "what", "parameters"), scenes, pad_edge=False))


def print_paper_tables() -> bool:
    """Print both tables, computed; return whether every iteration count is the paper's."""
    from ..evidence.paper_tables import cells

    computed = list(cells())
    console = _console(120)
    for example in (1, 2):
        rows = [
            (
                f"{cell.algorithm} {cell.relaxation or ''}", str(cell.n), str(cell.paper_iterations),
                str(cell.iterations), f"{cell.paper_residual:.1e}", f"{cell.residual:.2e}",
                f"{cell.paper_seconds:.4f}", f"{cell.seconds:.4f}",
                "yes" if cell.same_iterations else "NO", "yes" if cell.same_residual else "no",
            )
            for cell in computed if cell.example == example
        ]
        title = f"Table {example}: Example {example}, δ = 4"
        console.print(_table(title, PAPER_HEADINGS, rows, is_of_numbers=True, padding=(0, 1, 0, 0)))
    equal = sum(cell.same_iterations for cell in computed)
    equal_residual = sum(cell.same_residual for cell in computed)
    console.print(f"IT equal in {equal} of {len(computed)} cells, Res to the printed digits in {equal_residual}.")
    return equal == len(computed)


def _console(width: int) -> Any:
    """Return a console as wide as the terminal; where the output goes elsewhere, of the width given."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else width, markup=False, highlight=False)


def _table(
    title: str, headings: Iterable[str], rows: Iterable[Iterable[str]], *, is_of_numbers: bool = False, **look: Any
) -> Any:
    """Return a table that breaks long words rather than cutting them, and names and numbers never."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, **look)
    for heading in headings:
        keeps = is_of_numbers or heading in {"name", "source"}
        right = is_of_numbers and heading != "algorithm"
        table.add_column(heading, overflow="fold", no_wrap=keeps, justify="right" if right else "left")
    for row in rows:
        table.add_row(*row)
    return table
