"""Tables printed by `analyze` and `list`: proofs about a matrix, guarantees of algorithms, and names."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from operator import attrgetter
from typing import Any

from .. import gallery
from ..algorithms import REGISTRY, algorithm_class, paper_options
from ..core.lcp import LCP
from ..engines import ENGINES, engine_class
from ..evidence.measurement import PAPER_MSOR
from ..problems.cones.methods import CONE_METHODS
from ..proofs.guarantees import rounded_up
from ..proofs.verdicts import wrapped
from ..solving.analysis import analyze
from ..solving.explanation import convergence_guarantee

_PAPER = ("npj", "npgs", "npsor", "npaor", "npsplitting", "mgs")
PAPER_VARIANTS = {name: paper_options(name) for name in _PAPER} | {
    "msor": {"omega": paper_options("msor", PAPER_MSOR)["omega"]}
}


def analysis(problem: object) -> str:
    """Return the report on a problem, and the guarantees for an LCP, as text for a terminal.

    Examples
    --------
    >>> print(analysis(LCP([[4, -1], [-1, 4]], [-3, 5])).splitlines()[0])
    LCP(n=2, nonzeros=4, bounds 0 ≤ z)
    """
    report = str(analyze(problem))
    if not isinstance(problem, LCP):
        return report
    lines = [report, "", f"{'algorithm':<25} {'verdict':<12} {'rate':<8} because"]
    first: dict[str, str] = {}
    variants: list[tuple[str, dict[str, Any]]] = [(name, {}) for name in ("auto", *REGISTRY)]
    for name, options in (*variants, *PAPER_VARIANTS.items()):
        title = ", ".join([name, *(f"{key}={_short(value)}" for key, value in options.items())])
        guarantee = convergence_guarantee(problem, name, **options)
        rate = "" if guarantee.rate is None else rounded_up(guarantee.rate)
        because = guarantee.theorem + (f" → {guarantee.remedy}" if guarantee.remedy else "")
        named = f"as {first[because]}" if because in first else because
        first.setdefault(because, title)
        lines += wrapped(f"{title:<25} {guarantee.verdict:<12} {rate:<8} ", named)
    return "\n".join(lines)


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value).lower()


def print_names() -> None:
    """Print algorithms and external solvers with needs and sources, and test problems with their parameters."""
    from rich.console import Console

    # as wide as the terminal; 160 letters if the output goes elsewhere
    width = None if sys.stdout.isatty() else 160
    terminal = Console(width=width, markup=False, highlight=False)
    heads = ("name", "needs", "proved to converge on", "an iteration costs")
    lists: dict[str, dict[str, Any]] = {
        "Algorithms": {name: algorithm_class(name) for name in REGISTRY},
        "Algorithms over cones, and for contact with friction": {**CONE_METHODS},
    }
    for title, algorithms in lists.items():
        facts = attrgetter("needs", "solves", "cost")
        rows = [(name, *facts(algorithm)) for name, algorithm in algorithms.items()]
        terminal.print(_table(title, heads, rows))
    engines = {name: engine_class(name) for name in ENGINES}
    facts = attrgetter("solves", "cost", "obeys")
    rows = [(name, *facts(engine)) for name, engine in engines.items()]
    heads = ("name", "solves", "costs", "options that act during a run")
    terminal.print(_table("External solvers, for convex programs", heads, rows))
    sources: dict[str, list[str]] = {}
    for algorithms in (*lists.values(), engines):
        for name, algorithm in algorithms.items():
            sources.setdefault(algorithm.reference, []).append(name)
    for reference, names in sources.items():
        terminal.print(f"{', '.join(dict.fromkeys(names))}: {reference}")
    scenes = [
        (name, summary, ", ".join(f"{key}={value}" for key, value in parameters.items()))
        for name, summary, parameters in gallery.describe()
    ]
    terminal.print(_table("Test problems", ("name", "description", "parameters"), scenes))


def _table(title: str, headings: Iterable[str], rows: Iterable[Iterable[Any]]) -> Any:
    """Return a table of rich that breaks long words, except in the first column."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for k, heading in enumerate(headings):
        table.add_column(heading, overflow="fold", no_wrap=k == 0)
    for row in rows:
        table.add_row(*map(str, row))
    return table
