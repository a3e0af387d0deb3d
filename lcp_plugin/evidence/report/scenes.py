"""Scene by scene: error against time and work, every figure, what was left out."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from ...gallery import parse
from ...gallery.scene import Scene
from ..collecting import data_of
from ..curves import Curve, Report
from ..drawing import COLOURS, OWN
from ..error_against_time import error_against_time
from ..exporting import csv_text
from .section import PAGE_WIDTH, Collected, Part, ReportEffort, Say, Section, brief, count, figure, seconds

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
REFERENCES = ("osqp", "clarabel")


class Scenes(Section):
    """Error against time and work on each scene."""

    kind = "scene"
    place = 1
    title = "Scene by scene"
    short = "Scenes"

    def parts(self, scenes: Mapping[str, str | Scene], effort: ReportEffort) -> Iterator[Part]:
        """Yield one part a scene; a misspelt one is refused before anything runs."""
        chosen = scenes or {text: text for text in (QUICK_SCENES if effort.is_quick else SCENES)}
        for given in scenes.values():
            if isinstance(given, str):
                parse(given)
        for name, given in chosen.items():
            yield Part(self.kind, name, partial(measured, name, given, effort), effort, _hash(given))

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return an article a scene, and the colours of the families that occur."""
        articles = [_article(content) for content in collected.of("scene")]
        reports = [article["report"] for article in articles]
        return {"scenes": articles, "families": _families(reports)} if articles else {}

    def files(self, collected: Collected) -> dict[str, str]:
        """Return every point of every curve, and what was left out."""
        reports = collected.reports()
        rows = [row for report in reports for row in report.rows()]
        left_out = [(report.title, *entry) for report in reports for entry in report.left_out]
        return {
            "curves.csv": csv_text(Report.columns, rows),
            "left_out.csv": csv_text(("scene", "what", "reason"), left_out),
        }


# --- What is computed -----------------------------------------------------------------------------------------


def _hash(scene: str | Scene) -> str:
    """Return a hash of the problem, as the content of a file may be another one next time; nothing of a text."""
    return "" if isinstance(scene, str) else data_of(scene.problem)


def measured(name: str, given: str | Scene, effort: ReportEffort, say: Say) -> dict[str, Any]:
    """Return the curves of a scene."""
    scene = parse(given) if isinstance(given, str) else given
    max_work = effort.entries / max(scene.problem.nonzeros, 1)
    report = error_against_time(
        scene, None, REFERENCES, repeats=effort.repeats, max_seconds=effort.run_seconds, max_work=max_work,
        progress=say,
    )
    return {"text": name, "report": report.to_content()}


# --- What is shown --------------------------------------------------------------------------------------------


def _article(content: dict[str, Any]) -> dict[str, Any]:
    report, name = Report.from_content(content["report"]), re.sub(r"\W+", "-", content["text"])
    ranking = sorted(report.curves, key=lambda curve: (not curve.is_solved, curve.seconds))
    return {
        "name": name, "text": content["text"], "report": report,
        "seconds": figure(
            report.plot(width=PAGE_WIDTH), f"{name}-seconds", f"{report.error_kind} against seconds, {content['text']}"
        ),
        "work": figure(
            report.plot(against="work", width=PAGE_WIDTH), f"{name}-work",
            f"{report.error_kind} against work, {content['text']}",
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
