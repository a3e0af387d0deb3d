"""Write what was collected: index.html, one page without any other file, and the same figures as CSV and JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any

from ...errors import LCPError
from ..curves import Curve, Report
from ..drawing import COLOURS, svg
from ..exporting import csv_text, finite_content, write_text
from ..performance_profile import Profile, performance_profile
from ..pictures import draw_sketch
from .collect import Collected
from .machine import machine
from .plan import TOO_LONG_FOR_QUICK
from .summary import SPLITTING, claims, whole_atlas, with_active

WIDEST = 6  # scenes in one table: what a telephone can show


def write_report(collected: Collected, folder: Path, *, is_quick: bool) -> Path:
    """Write the page and the tables into the folder; return the path of the page.

    Parameters
    ----------
    collected : Collected
        What there is; the page says what is missing.
    folder : Path
        Where ``index.html``, ``report.json`` and the CSV files go.
    is_quick : bool
        Whether the problems are the small ones, which the page says.

    Raises
    ------
    LCPError
        Where jinja2 or matplotlib is not installed.
    """
    reports = [Report.from_content(content["report"]) for content in collected.of("scene")]
    profiles = {by: performance_profile(reports, by) for by in ("work", "seconds")} if len(reports) > 1 else {}
    facts, said = machine(), claims(collected)
    page = _template().render(
        claims=said, machine=facts, scenes=[_scene(content) for content in collected.of("scene")],
        profiles={by: figure_svg(profile.plot(), f"profile-{by}", f"Performance profile by {by}")
                  for by, profile in profiles.items() if profile.problems},
        comparison=_comparison(reports), tables=_tables(collected), checks=collected.of("check"),
        atlas=_atlas(collected), missing=collected.missing, is_quick=is_quick, colours=COLOURS, number=_number,
        families=_families(reports), too_long=TOO_LONG_FOR_QUICK,
    )
    _write_tables(collected, reports, list(profiles.values()), folder)
    content = {
        "machine": facts, "summary": [asdict(claim) for claim in said], "missing": collected.missing,
        "parts": [{"kind": kind, "name": name} | part for (kind, name), part in collected.contents.items()],
        "profiles": [profile.to_content() for profile in profiles.values()],
    }
    write_text(folder / "report.json", json.dumps(finite_content(content), ensure_ascii=False, indent=1))
    write_text(folder / "index.html", page)
    return folder / "index.html"


def require_jinja() -> Any:
    """Return jinja2, or say how to install it."""
    try:
        import jinja2
    except ImportError as error:
        raise LCPError("the report needs jinja2; install it with: pip install 'lcp_plugin[report]'") from error
    return jinja2


def _template() -> Any:
    jinja2 = require_jinja()
    text = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(text)


def figure_svg(figure: Any, name: str, description: str) -> Any:
    """Return a figure as SVG to stand inside a page."""
    from markupsafe import Markup

    return Markup(svg(figure, name, description))


# --- Scenes ---------------------------------------------------------------------------------------------------


def _scene(content: dict[str, Any]) -> dict[str, Any]:
    report, name = Report.from_content(content["report"]), re.sub(r"\W+", "-", content["text"])
    ranking = sorted(report.curves, key=lambda curve: (not curve.is_solved, curve.seconds))
    sketch = content["sketch"]
    return {
        "name": name, "text": content["text"], "report": report,
        "sketch": None if sketch is None else figure_svg(
            draw_sketch(sketch), f"{name}-sketch", f"{sketch['unknown']} of {content['text']}"
        ),
        "seconds": figure_svg(
            report.plot(), f"{name}-seconds", f"{report.error_kind} against seconds, {content['text']}"
        ),
        "work": figure_svg(
            report.plot(against="work"), f"{name}-work", f"{report.error_kind} against work, {content['text']}"
        ),
        "rows": [_row(curve) for curve in ranking],
        "notes": [(curve.label, curve.note) for curve in report.curves if curve.note],
        "references": [(one.label, _seconds(one.seconds), _number(one.error), one.note) for one in report.references],
    }


def _row(curve: Curve) -> dict[str, str]:
    return {
        "label": curve.label, "colour": COLOURS.get(curve.family, COLOURS["other"]), "note": curve.note,
        "status": "" if curve.is_solved else curve.status.replace("_", " ").lower(),
        "work": _count(curve.work), "iterations": str(curve.iterations), "seconds": _seconds(curve.seconds),
        "setup": _seconds(curve.setup_seconds), "error": _number(curve.points[-1].error),
        "spread": f"{_seconds(curve.points[-1].seconds_low)} to {_seconds(curve.points[-1].seconds_high)}",
    }


def _number(value: float | None) -> str:
    return "–" if value is None or math.isnan(value) else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e+")


def _count(value: float) -> str:
    return f"{value:.0f}" if value < 1e5 else _number(value)


def _seconds(value: float) -> str:
    """Return a time with its unit, three digits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value / 1e-6:.2g} µs"


def _families(reports: Sequence[Report]) -> list[tuple[str, str]]:
    """Return the families that occur, each with its colour."""
    present = {curve.family for report in reports for curve in report.curves}
    present |= {"reference"} if any(report.references for report in reports) else set()
    return [(family, colour) for family, colour in COLOURS.items() if family in present]


def _comparison(reports: Sequence[Report]) -> list[dict[str, Any]]:
    """Return the tables of the promise: passes of each splitting method on the scenes with active constraints."""
    chosen = [report for report in with_active(reports) if any(curve.family in SPLITTING for curve in report.curves)]
    families = {curve.label: curve.family for report in chosen for curve in report.curves if curve.family in SPLITTING}
    width = -(-len(chosen) // max(1, -(-len(chosen) // WIDEST)))
    parts = [chosen[first : first + width] for first in range(0, len(chosen), max(width, 1))]
    return [
        {
            "heads": [(report.title.partition(":")[0], _short(report.title), _percent(report)) for report in part],
            "rows": [
                {"label": label, "colour": COLOURS[family],
                 "cells": [_cell(report.curve(label), report) for report in part]}
                for label, family in families.items()
            ],
        }
        for part in parts
    ]


def _percent(report: Report) -> str:
    return f"{100.0 * report.active_share:.0f} %"


def _short(title: str) -> str:
    """Return what tells two settings of one scene apart."""
    found = re.search(r"delta=([\d.]+)", title)
    return f"δ = {float(found[1]):g}" if found else ""


def _cell(curve: Curve | None, report: Report) -> tuple[str, bool]:
    """Return the passes and whether they are the fewest of all splittings on that scene."""
    if curve is None:
        return "·", False
    if not curve.is_solved:
        return "✕", False
    best = min(one.work for one in report.curves if one.family in SPLITTING and one.is_solved)
    return _count(curve.work), curve.work == best


# --- The other tables -----------------------------------------------------------------------------------------


def _tables(collected: Collected) -> list[dict[str, Any]]:
    """Return the paper's two tables: one row an algorithm, in each cell our count, and the paper's where it differs."""
    found = []
    for content in collected.of("tables"):
        for example in (1, 2):
            cells = [cell for cell in content["cells"] if cell["example"] == example]
            rows: dict[str, list[dict[str, Any]]] = {}
            for cell in cells:
                rows.setdefault(f"{cell['algorithm']} {cell['relaxation'] or ''}".strip(), []).append(cell)
            found.append({"example": example, "sizes": [cell["n"] for cell in next(iter(rows.values()))], "rows": rows})
    return found


def _atlas(collected: Collected) -> dict[str, Any] | None:
    """Return the atlas as a table of algorithms against families of stress, with every cell worth a word."""
    atlas = whole_atlas(collected)
    if atlas is None or not atlas.cells:
        return None
    families = list(dict.fromkeys(cell.family for cell in atlas.cells))
    rows = []
    for name in dict.fromkeys(cell.algorithm for cell in atlas.cells):
        own = [[cell for cell in atlas.cells if (cell.algorithm, cell.family) == (name, family)] for family in families]
        rows.append((name, [_tally(cells) for cells in own]))
    return {
        "families": families, "rows": rows, "lies": atlas.lies, "unsolved": atlas.unsolved, "skipped": atlas.skipped,
        "misleading": sorted(atlas.misleading, key=lambda cell: cell.condition),
        "count": len(atlas.cells), "share": atlas.solved_share, "well_posed": len(atlas.well_posed),
    }


def _tally(cells: Sequence[Any]) -> dict[str, Any] | None:
    if not cells:
        return None
    solved = sum(cell.status == "SOLVED" for cell in cells)
    lies = sum(not cell.told_the_truth for cell in cells)
    return {"solved": solved, "count": len(cells), "lies": lies, "share": solved / len(cells)}


def _write_tables(collected: Collected, reports: Sequence[Report], profiles: Sequence[Profile], folder: Path) -> None:
    rows = [row for report in reports for row in report.rows()]
    write_text(folder / "curves.csv", csv_text(Report.columns, rows))
    left_out = [(report.title, *entry) for report in reports for entry in report.left_out]
    write_text(folder / "left_out.csv", csv_text(("scene", "what", "reason"), left_out))
    for profile in profiles:
        profile.to_csv(folder / f"profile_{profile.by}.csv")
    for kind, entries in (
        ("cross_validation", collected.of("check")),
        ("paper_tables", [cell for content in collected.of("tables") for cell in content["cells"]]),
    ):
        if entries:
            columns = tuple(entries[0])
            write_text(folder / f"{kind}.csv", csv_text(columns, [tuple(entry.values()) for entry in entries]))
    atlas = whole_atlas(collected)
    if atlas is not None:
        atlas.to_csv(folder / "stability.csv")
