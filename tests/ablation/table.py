"""The rows that were measured, and the page that is made of them."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from .mechanisms import NAMES

HERE = Path(__file__).parent
CSV, PAGE = HERE / "ablation.csv", HERE / "ablation.md"
SLOWER = 1.5  # times as long in the mean of a source of inputs: a loss
HEAD = """# What each mechanism buys

Written by `python tests/ablation`: each is left out alone, and what meets it is solved beside everything on, in turn,
in one process. Counts are of the inputs that meet it, everything on → without it; work and time are without ÷ with,
their geometric mean, time in seconds of the processor; "at most" is the source of inputs where leaving it out costs
most time. Lines are lines of code that it alone needs. A row loses nothing where no
answer and no proof is lost, no false one added, nothing raised, and no source takes {slower} × as long: such a
mechanism is deleted. "a of b" was measured in part, within a limit of seconds: measure it whole (`--seconds`) before
anything goes. What no input meets is not shown to be of use. Where inputs show no loss and a test fails without it,
that test is named. Threads gain time on the wall, which is not counted here.

"""
COLUMNS = (
    "mechanism",
    "what for",
    "met",
    "solved",
    "proved",
    "false",
    "work",
    "time",
    "at most",
    "lines",
    "loses",
)


def columns() -> list[str]:
    from .measuring import Tally

    return Tally.columns()


def read() -> list[dict[str, str]]:
    """Return the rows of the file."""
    if not CSV.exists():
        return []
    with CSV.open(encoding="utf-8", newline="") as file:
        return [*csv.DictReader(file)]


def write(rows: list[dict[str, str]]) -> None:
    """Write the file and the page."""
    with CSV.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    write_page(rows)


def write_page(rows: list[dict[str, str]]) -> None:
    """Write a line for each mechanism, then for each pair, in the order of the list."""
    measured = [*dict.fromkeys(row["mechanism"] for row in rows)]
    pairs = [name for name in measured if " + " in name]
    lines = [HEAD.format(slower=SLOWER) + line(COLUMNS), line(["---"] * len(COLUMNS))]
    for name in [*NAMES, *pairs]:
        lines.append(line(cells_of(name, [row for row in rows if row["mechanism"] == name])))
    free = [
        name
        for name, one in NAMES.items()
        if name in measured and not (one.claim or lost(rows_of(rows, name)))
    ]
    unmet = [name for name in free if not total(rows_of(rows, name), "met")]
    shown = [name + of_all(rows_of(rows, name)) for name in free if name not in unmet]
    lines += ["", f"Lose nothing, of so many that meet them: {', '.join(shown) or 'none'}."]
    lines += ["", f"Never met: {', '.join(unmet) or 'none'}."]
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")


def rows_of(rows: list[dict[str, str]], name: str) -> list[dict[str, str]]:
    return [row for row in rows if row["mechanism"] == name]


def of_all(rows: list[dict[str, str]]) -> str:
    """Return how many inputs were measured of those that meet it, in parentheses; nothing where all were."""
    met, left = total(rows, "met"), total(rows, "left")
    return f" ({met} of {met + left})" if left else ""


def line(cells: tuple[str, ...] | list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def total(rows: list[dict[str, str]], column: str) -> int:
    return sum(int(row[column]) for row in rows)


def lost(rows: list[dict[str, str]]) -> list[str]:
    """Return in words what leaving it out loses."""
    found = []
    for name in ("solved", "proved"):
        if (less := sum(max(int(row[name]) - int(row[f"{name}_off"]), 0) for row in rows)) > 0:
            found.append(f"{less} {name}")
    if (more := sum(max(int(row["false_off"]) - int(row["false"]), 0) for row in rows)) > 0:
        found.append(f"{more} false")
    if (raised := total(rows, "raised_off")) > 0:
        found.append(f"{raised} raised")
    slow = [row for row in rows if float(row["time"]) >= SLOWER]
    return found + ([f"time: {', '.join(row['source'] for row in slow)}"] if slow else [])


def cells_of(name: str, rows: list[dict[str, str]]) -> list[str]:
    """Return the cells of a mechanism's line, or of a pair's."""
    parts = [NAMES[one] for one in name.split(" + ")]
    purpose, lines = (
        (parts[0].purpose if len(parts) == 1 else ""),
        str(sum(part.lines for part in parts)),
    )
    if not rows:
        return [name, purpose, "not measured", *[""] * 6, lines, ""]
    met = total(rows, "met")
    counts = [
        f"{total(rows, one)} → {total(rows, f'{one}_off')}" for one in ("solved", "proved", "false")
    ]

    def over_all(column: str) -> float:
        logs = [int(row["met"]) * math.log(float(row[column])) for row in rows]
        return math.exp(math.fsum(logs) / met) if met else 1.0

    worst = max(rows, key=lambda row: float(row["time"]))
    most = "" if not met else f"{float(worst['time']):.2f} {worst['source']}"
    of = of_all(rows).strip(" ()") or str(met)
    ratios = [f"{over_all(column):.2f}" if met else "" for column in ("work", "time")]
    claims = [f"`{part.claim.partition('::')[2]}`" for part in parts if part.claim]
    loss = "; ".join(lost(rows) or claims) or ("nothing" if met else "never met")
    return [name, purpose, of, *counts, *ratios, most, lines, loss]
