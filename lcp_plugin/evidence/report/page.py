"""The report: one page on error against time, index.html, which needs no other file.

Beside it lie the same figures as CSV and JSON. `plan` says what is to be computed, `collect` computes it and can be
stopped, `write_report` writes the page of what there is.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ...core.errors import LCPError
from ...gallery import parse
from ...gallery.scene import Scene
from ..collecting import Collected, Part, Say, collect, machine
from ..curves import Report
from ..drawing import COLOURS, OWN, svg
from ..error_against_time import error_against_time
from ..exporting import csv_text, finite_content, write_text

__all__ = ["Collected", "Part", "ReportEffort", "collect", "plan", "require_jinja", "write_report"]

PAGE_WIDTH = 4.7  # inches, of a figure on the page
REFERENCES = ("osqp", "clarabel")
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
    """How much a report spends: entries of M that a run may touch, and its seconds."""

    entries: float
    seconds: float


FULL, QUICK = ReportEffort(entries=5e8, seconds=30.0), ReportEffort(entries=1e8, seconds=5.0)


def plan(scenes: Sequence[str | Scene] = (), *, quick: bool = False) -> list[Part]:
    """Return the parts of a report.

    Parameters
    ----------
    scenes : sequence of str and Scene
        As on a command line, ``name:key=value``, or with a problem of one's own; by default the report's own choice.
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
    return [Part("scene", name, partial(measured, given, effort)) for name, given in every.items()]


def measured(given: str | Scene, effort: ReportEffort, say: Say) -> Report:
    """Return the curves of a scene."""
    scene = parse(given) if isinstance(given, str) else given
    max_work = effort.entries / max(scene.problem.nonzeros, 1)
    return error_against_time(
        scene, None, REFERENCES, max_seconds=effort.seconds, max_work=max_work, progress=say
    )


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
    facts, reports, jinja2 = machine(), collected.of("scene"), require_jinja()
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(__package__, ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"brief": brief, "passes": passes, "time": time}
    page = environment.get_template("page.html").render(
        machine=facts,
        scenes=[_article(*one) for one in reports.items()],
        families=_families([*reports.values()]),
        colour=lambda curve: COLOURS.get(curve.family, OWN[0]),
        reference_colour=COLOURS["reference"],
        missing=collected.missing,
        is_quick=is_quick,
    )
    content = {
        "machine": facts,
        "missing": collected.missing,
        "parts": [
            {"kind": "scene", "name": name} | report.to_content()
            for name, report in reports.items()
        ],
    }
    left_out = [(report.title, *entry) for report in reports.values() for entry in report.left_out]
    for name, text in {
        "curves.csv": csv_text(
            Report.columns, (row for report in reports.values() for row in report.rows())
        ),
        "left_out.csv": csv_text(("scene", "what", "reason"), left_out),
        "report.json": json.dumps(finite_content(content), ensure_ascii=False, indent=1),
        "index.html": page,
    }.items():
        write_text(folder / name, text)
    return folder / "index.html"


def require_jinja() -> Any:
    """Return jinja2, or say how to install it."""
    try:
        import jinja2
    except ImportError as error:
        raise LCPError(
            "the report needs jinja2; install it with: pip install 'lcp_plugin[report]'"
        ) from error
    return jinja2


def _article(text: str, report: Report) -> dict[str, Any]:
    """Return what the page shows of a scene: its figures, and its curves in the order of their answers."""
    from markupsafe import Markup

    name = re.sub(r"\W+", "-", text)
    figures = {
        against: Markup(
            svg(
                report.plot(against=against, width=PAGE_WIDTH),
                f"{name}-{against}",
                f"{report.error_kind} against {against}, {text}",
            )
        )
        for against in ("seconds", "work")
    }
    ranking = sorted(report.curves, key=lambda curve: (not curve.is_solved, curve.seconds))
    return {"name": name, "text": text, "report": report, "curves": ranking, **figures}


def _families(reports: Sequence[Report]) -> list[tuple[str, str]]:
    """Return the families that occur, each with its colour."""
    present = {curve.family for report in reports for curve in report.curves}
    present |= {"reference"} if any(report.references for report in reports) else set()
    return [(family, colour) for family, colour in COLOURS.items() if family in present]


def brief(value: float) -> str:
    """Return two digits of a number, a dash where there is none."""
    return "–" if math.isnan(value) else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e+")


def passes(value: float) -> str:
    """Return a number of passes."""
    return f"{value:.0f}" if value < 1e5 else brief(value)


def time(value: float) -> str:
    """Return a time with its unit, three digits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value / 1e-6:.2g} µs"
