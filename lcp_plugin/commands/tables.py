"""The paper's Tables 1 and 2 again, cell beside cell; and what is proved of a matrix and of every method on it."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..algorithms import REGISTRY, create, from_other_packages
from ..core.errors import LCPError
from ..core.lcp import LCP
from ..evidence.contestants import PAPER_MSOR, paper_options
from ..evidence.exporting import finite_content, save_tables
from ..evidence.paper_tables import cells, paper_table
from ..proofs.guarantees import convergence_guarantee
from ..proofs.guarantees.theorems import BAI, CRYER, LEVITIN, PAPER, PAPER_TITLE, Guarantee
from ..proofs.verdicts import analyze
from .terminal import console, table

SOURCES = dict(enumerate((PAPER, CRYER, BAI, LEVITIN), start=1))
WIDEST = 100
EVIDENCE = 41  # where the evidence begins in a line of the matrix report
PAPER_VARIANTS: dict[str, dict[str, Any]] = {
    **{
        name: paper_options(name, None)
        for name in ("npj", "npgs", "npsor", "npaor", "npsplitting", "mgs")
    },
    "msor": {"omega": paper_options("msor", PAPER_MSOR)["omega"]},
}


def print_paper_tables(out: Path | None = None) -> bool:
    """Print both tables, computed, and save them where asked; return whether every iteration count is the paper's."""
    if out is not None:
        save_tables([], out)  # a name that cannot be written is refused before anything is computed
    computed = list(cells())
    tables, terminal = [paper_table(computed, example) for example in (1, 2)], console(120)
    for one in tables:
        headings = [
            *one.columns[:2],
            *("\n".join(head.rpartition(" ")[::2]) for head in one.columns[2:]),
        ]
        terminal.print(
            table(one.title, headings, one.texts(), is_of_numbers=True, padding=(0, 1, 0, 0))
        )
    equal = sum(one.same_iterations for one in computed)
    equal_residual = sum(one.same_residual for one in computed)
    terminal.print(
        f"IT equal in {equal} of {len(computed)} cells, Res to the printed digits in {equal_residual}."
    )
    if out is not None:
        save_tables(tables, out)
        terminal.print(f"saved {out}")
    return equal == len(computed)


# --- analyze --------------------------------------------------------------------------------------------------


def guarantees(problem: LCP) -> Iterator[tuple[str, Guarantee]]:
    """Yield (title, guarantee) of auto, of every algorithm at its defaults, and of the paper's variants."""
    for name in ("auto", *REGISTRY, *_usable_from_outside()):
        yield name, convergence_guarantee(problem, name)
    for name, options in PAPER_VARIANTS.items():
        shown = ", ".join(f"{option}={_short(value)}" for option, value in options.items())
        yield f"{name}, {shown}", convergence_guarantee(problem, name, **options)


def analysis(problem: LCP) -> str:
    """Return both tables as text for a terminal.

    Examples
    --------
    >>> print(analysis(LCP([[4, -1], [-1, 4]], [-3, 5])).splitlines()[0])
    matrix of size 2, 4 nonzeros
    """
    lines = [
        part
        for line in str(analyze(problem)).splitlines()
        for part in _wrapped(line[:EVIDENCE], line[EVIDENCE:])
    ]
    lines += ["", f"{'algorithm':<25} {'verdict':<12} {'rate':<8} because"]
    said: dict[str, list[str]] = {}
    first: dict[str, str] = {}
    for title, guarantee in guarantees(problem):
        rate = "" if guarantee.rate is None else _rate(guarantee.rate)
        because = guarantee.theorem + (f" → {guarantee.remedy}" if guarantee.remedy else "")
        named = f"as {first[because]}" if because in first else _with_numbers(because)
        first.setdefault(because, title)
        lines += _wrapped(f"{title:<25} {guarantee.verdict:<12} {rate:<8} ", named)
        if guarantee.paper:
            said.setdefault(guarantee.paper, []).append(title.partition(",")[0])
    lines.append("")
    for k, source in SOURCES.items():
        if any(source in text for text in first):
            lines += _wrapped(f"[{k}] ", f"{source}, {PAPER_TITLE}" if source == PAPER else source)
    if said:
        lines += ["", "The paper's Theorem 4.2, for its methods without row scaling:"]
        lines += [
            line for text, names in said.items() for line in _wrapped(f"{', '.join(names)}: ", text)
        ]
    return "\n".join(lines).rstrip()


def analysis_content(problem: LCP) -> dict[str, Any]:
    """Return both tables as a dictionary that JSON can hold; numbers that are not finite become None."""
    rows = [
        {
            "algorithm": title,
            "verdict": found.verdict,
            "theorem": found.theorem,
            "rate": found.rate,
            "rate_of": found.speaks_of if found.rate is not None else None,
            "remedy": found.remedy,
            "theorem_4_2": found.paper,
        }
        for title, found in guarantees(problem)
    ]
    content: dict[str, Any] = finite_content(
        {"matrix": analyze(problem).to_content(), "convergence": rows}
    )
    return content


def _wrapped(title: str, text: str) -> list[str]:
    """Return the text beside its title, in lines that fit the terminal."""
    columns = min(WIDEST, shutil.get_terminal_size().columns) if sys.stdout.isatty() else WIDEST
    return textwrap.wrap(
        text, columns, initial_indent=title, subsequent_indent=" " * len(title)
    ) or [title.rstrip()]


def _usable_from_outside() -> Iterator[str]:
    """Yield the names of other packages' algorithms that can be made without an option."""
    for name in from_other_packages():
        with suppress(LCPError):  # `lcp-plugin list` says what is wrong with it
            create(name, {})
            yield name


def _with_numbers(text: str) -> str:
    """Return the text with [1], [2] … for its sources."""
    for k, source in SOURCES.items():
        text = text.replace(f"({source})", f"[{k}]").replace(source, f"[{k}]")
    return text


def _rate(rate: float) -> str:
    """Return the rate rounded up, or its distance to 1 where that is what counts."""
    return f"{math.ceil(1000.0 * rate) / 1000.0:.3f}" if rate <= 0.99 else f"1-{1.0 - rate:.0e}"


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value).lower()
