"""The report: one page on error against time and stability, index.html, which needs no other file.

Beside it lie the same figures as CSV and JSON. `plan` says what is to be computed, `collect` computes it and can be
stopped, `write_report` writes the page of what there is.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

from ...core.errors import LCPError
from ...gallery import parse
from ...gallery.scene import Scene
from ..collecting import Collected, Part, Say, collect, machine
from ..curves import Curve, Report
from ..drawing import COLOURS, OWN, svg
from ..error_against_time import error_against_time
from ..exporting import csv_text, finite_content, write_text
from ..stability import PROVED, RANGES, Atlas, Cell, stability_atlas
from ..stresses import FAMILIES

__all__ = ["Collected", "Part", "ReportEffort", "collect", "plan", "require_jinja", "write_report"]

PAGE_WIDTH = 4.7  # inches, of a figure on the page
REFERENCES = ("osqp", "clarabel")
TOO_LONG_FOR_QUICK = ("sizes", RANGES, PROVED)
SCENES = (
    "paper_example_1:n=10000",
    "paper_example_2:n=10000",
    "paper_example_1:n=10000,delta=0",
    "half_active:n=10000",
    "half_active:n=10000,delta=0",
    "obstacle_2d:size=100",
    "obstacle_bumps:size=100",
    "optimal_stopping:size=100",
    "journal_bearing:size=100",
    "elastic_plastic_torsion",
    "american_put:size=2001",
    "random_h_plus:n=2000",
    "convection_diffusion:size=100",
    "rotated_anisotropy:size=60",
    "market_equilibrium",
)
QUICK_SCENES = (
    "paper_example_1:n=2500",
    "paper_example_1:n=1600,delta=0",
    "half_active:n=2500",
    "obstacle_2d:size=32",
    "obstacle_bumps:size=32",
    "optimal_stopping:size=40",
    "journal_bearing:size=32",
    "american_put:size=501",
    "market_equilibrium",
)

@dataclass(frozen=True)
class ReportEffort:
    """How much a report spends: entries of M a run may touch, and the seconds of a run and a reference."""

    entries: float
    run_seconds: float
    reference_seconds: float
    is_quick: bool


FULL = ReportEffort(entries=5e8, run_seconds=30.0, reference_seconds=20.0, is_quick=False)
QUICK = ReportEffort(entries=1e8, run_seconds=5.0, reference_seconds=3.0, is_quick=True)


def plan(scenes: Sequence[str | Scene] = (), *, quick: bool = False) -> list[Part]:
    """Return the parts of a report.

    Parameters
    ----------
    scenes : sequence of str and Scene
        As on a command line, ``name:key=value``, or with a problem of one's own; by default the report's own choice,
        and the stability atlas.
    quick : bool
        Small sizes and few repeats: to see what it looks like.

    Raises
    ------
    InvalidOption
        Where a scene does not exist.
    """
    effort = QUICK if quick else FULL
    chosen = {one if isinstance(one, str) else one.name: one for one in scenes}
    for given in chosen.values():
        if isinstance(given, str):
            parse(given)
    every = chosen or {text: text for text in (QUICK_SCENES if quick else SCENES)}
    parts = [Part("scene", name, partial(measured, given, effort)) for name, given in every.items()]
    families = [] if chosen else [one for one in FAMILIES if not (quick and one in TOO_LONG_FOR_QUICK)]
    return parts + [Part("atlas", family, partial(_stressed, family, effort)) for family in families]


def measured(given: str | Scene, effort: ReportEffort, say: Say) -> Report:
    """Return the curves of a scene."""
    scene = parse(given) if isinstance(given, str) else given
    max_work = effort.entries / max(scene.problem.nonzeros, 1)
    return error_against_time(
        scene, None, REFERENCES, max_seconds=effort.run_seconds, max_work=max_work, progress=say
    )


def _stressed(family: str, effort: ReportEffort, say: Say) -> Atlas:
    def progress(done: int, total: int, label: str) -> None:
        say(f"{done} of {total}, {label}")

    return stability_atlas(stresses=[family], quick=effort.is_quick, progress=progress)


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
    facts = machine()
    page = _template("page").render(
        machine=facts, sections=[*_scenes(collected), *_stability(collected)], missing=collected.missing,
        is_quick=is_quick,
    )
    content = {
        "machine": facts, "missing": collected.missing,
        "parts": [
            {"kind": kind, "name": name} | part.to_content() for (kind, name), part in collected.contents.items()
        ],
    }
    for name, text in _tables(collected).items():
        write_text(folder / name, text)
    write_text(folder / "report.json", json.dumps(finite_content(content), ensure_ascii=False, indent=1))
    write_text(folder / "index.html", page)
    return folder / "index.html"


def _tables(collected: Collected) -> dict[str, str]:
    """Return the CSV files that lie beside the page, text by name."""
    tables = {}
    if reports := collected.of("scene").values():
        left_out = [(report.title, *entry) for report in reports for entry in report.left_out]
        tables["curves.csv"] = csv_text(Report.columns, (row for report in reports for row in report.rows()))
        tables["left_out.csv"] = csv_text(("scene", "what", "reason"), left_out)
    if collected.of("atlas"):
        tables["stability.csv"] = _whole(collected).to_csv()
    return tables


def require_jinja() -> Any:
    """Return jinja2, or say how to install it."""
    try:
        import jinja2
    except ImportError as error:
        raise LCPError("the report needs jinja2; install it with: pip install 'lcp_plugin[report]'") from error
    return jinja2


def _template(name: str) -> Any:
    jinja2 = require_jinja()
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    text = resources.files(__package__).joinpath(f"{name}.html").read_text(encoding="utf-8")
    return environment.from_string(text, {"number": brief, "colours": COLOURS})


def _section(anchor: str, title: str, short: str, **shown: Any) -> dict[str, Any]:
    """Return a section as the page shows it."""
    from markupsafe import Markup

    body = Markup(_template(anchor).render(shown).strip())
    return {"anchor": anchor, "title": title, "short": short, "body": body}


# --- Scene by scene ---------------------------------------------------------------------------------------------


def _scenes(collected: Collected) -> Iterator[dict[str, Any]]:
    """Yield the section of error against time and work, an article a scene."""
    if reports := collected.of("scene"):
        articles = [_article(text, report) for text, report in reports.items()]
        families = _families(list(reports.values()))
        yield _section("scenes", "Scene by scene", "Scenes", scenes=articles, families=families)


def _article(text: str, report: Report) -> dict[str, Any]:
    name = re.sub(r"\W+", "-", text)
    ranking = sorted(report.curves, key=lambda curve: (not curve.is_solved, curve.seconds))
    return {
        "name": name, "text": text, "report": report,
        "seconds": figure(
            report.plot(width=PAGE_WIDTH), f"{name}-seconds", f"{report.error_kind} against seconds, {text}"
        ),
        "work": figure(
            report.plot(against="work", width=PAGE_WIDTH), f"{name}-work",
            f"{report.error_kind} against work, {text}",
        ),
        "rows": [_row(curve) for curve in ranking],
        "notes": [(curve.label, curve.note) for curve in report.curves if curve.note],
        "references": [(one.label, seconds(one.seconds), brief(one.error), one.note) for one in report.references],
    }


def _row(curve: Curve) -> dict[str, str]:
    return {
        "label": curve.label, "colour": COLOURS.get(curve.family, OWN[0]), "note": curve.note,
        "status": "" if curve.is_solved else curve.status.replace("_", " ").lower(),
        "work": count(curve.work), "iterations": str(curve.iterations), "seconds": seconds(curve.seconds),
        "setup": seconds(curve.setup_seconds), "error": brief(curve.points[-1].error),
        "spread": f"{seconds(curve.points[-1].seconds_low)} to {seconds(curve.points[-1].seconds_high)}",
    }


def _families(reports: Sequence[Report]) -> list[tuple[str, str]]:
    """Return the families that occur, each with its colour."""
    present = {curve.family for report in reports for curve in report.curves}
    present |= {"reference"} if any(report.references for report in reports) else set()
    return [(family, colour) for family, colour in COLOURS.items() if family in present]


def figure(drawn: Any, name: str, description: str) -> Any:
    """Return a matplotlib figure as the template takes it."""
    from markupsafe import Markup

    return Markup(svg(drawn, name, description))


def brief(value: float | None) -> str:
    """Return two digits of a number, a dash where there is none."""
    return "–" if value is None or math.isnan(value) else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e+")


def count(value: float) -> str:
    """Return a number of passes."""
    return f"{value:.0f}" if value < 1e5 else brief(value)


def seconds(value: float) -> str:
    """Return a time with its unit, three digits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value / 1e-6:.2g} µs"


# --- Stability --------------------------------------------------------------------------------------------------


def _stability(collected: Collected) -> Iterator[dict[str, Any]]:
    """Yield the section of the atlas: algorithms against families, and every cell worth a word."""
    if not collected.of("atlas"):
        return
    atlas = _whole(collected)
    families = list(dict.fromkeys(cell.family for cell in atlas.cells))
    cells: dict[str, dict[str, list[Cell]]] = {}
    for cell in atlas.cells:
        cells.setdefault(cell.algorithm, {family: [] for family in families})[cell.family].append(cell)
    maps = [
        figure(atlas.plot(family=family), family.replace(" ", "-"), f"Stability: {family}")
        for family in (RANGES, PROVED) if family in families
    ]
    yield _section(
        "stability", "Stability atlas", "Stability", maps=maps, atlas=atlas, families=families,
        absent=[one for one in FAMILIES if one not in families],
        rows={name: [_tally(own) for own in row.values()] for name, row in cells.items()},
        misleading=sorted(atlas.misleading, key=lambda cell: cell.condition),
    )


def _whole(collected: Collected) -> Atlas:
    """Return the atlas of all families."""
    return sum(collected.of("atlas").values(), Atlas((), ()))


def _tally(cells: Sequence[Cell]) -> dict[str, Any] | None:
    if not cells:
        return None
    solved = sum(cell.status == "SOLVED" for cell in cells)
    lies = sum(not cell.told_the_truth for cell in cells)
    return {"solved": solved, "count": len(cells), "lies": lies, "share": solved / len(cells)}
