"""What `lcp-plugin tables` does: the paper's Tables 1 and 2 again, cell beside cell."""

from __future__ import annotations

import sys

HEADINGS = (
    "algorithm", "n", "paper\nIT", "\nIT", "paper\nRes", "\nRes", "paper\nCPU", "\nCPU", "same\nIT", "same\nRes",
)


def print_tables() -> bool:
    """Print both tables, computed; return whether every iteration count is the paper's."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    from ..evidence.paper_tables import cells

    computed = list(cells())
    console = Console(width=None if sys.stdout.isatty() else 120)
    for example in (1, 2):
        table = Table(
            title=f"Table {example}: Example {example}, δ = 4", title_justify="left", box=SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
        )
        for heading in HEADINGS:
            table.add_column(heading, justify="left" if heading == "algorithm" else "right", no_wrap=True)
        for cell in (cell for cell in computed if cell.example == example):
            table.add_row(
                f"{cell.algorithm} {cell.relaxation or ''}", str(cell.n),
                str(cell.paper_iterations), str(cell.iterations),
                f"{cell.paper_residual:.1e}", f"{cell.residual:.2e}",
                f"{cell.paper_seconds:.4f}", f"{cell.seconds:.4f}",
                "yes" if cell.same_iterations else "NO", "yes" if cell.same_residual else "no",
            )
        console.print(table)
    equal = sum(cell.same_iterations for cell in computed)
    equal_residual = sum(cell.same_residual for cell in computed)
    console.print(f"IT equal in {equal} of {len(computed)} cells, Res to the printed digits in {equal_residual}.")
    return equal == len(computed)
