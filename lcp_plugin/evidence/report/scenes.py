"""Scene by scene: error against time and work, a sketch, every figure, what was left out; and derivatives' errors."""

from __future__ import annotations

import re
import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from ...certificates.row_residuals import is_at_bound
from ...checks import FloatVector
from ...problem.lcp import LCP
from ...solving.derivative import derivative
from ...solving.driver import solve
from ..collecting import data_of
from ..contestants import comparison, fresh
from ..curves import Curve, Report
from ..drawing import COLOURS, LABEL_SIZE, new_figure, styled
from ..error_against_time import best_answer, error_against_time
from ..exporting import csv_text
from ..figures import OWN
from ..gallery import parse
from ..gallery.scene import Scene
from ..pictures import draw_sketch, sketch_of
from .section import PAGE_WIDTH, Collected, Effort, Finding, Part, Say, Section, brief, count, figure, many, seconds

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
TRIAL = 0.25  # of the work a run may do: the limit of one trial of the tuning


class Scenes(Section):
    """Error against time and work on each scene."""

    kind = "scene"
    place = 2
    title = "Scene by scene"
    short = "Scenes"

    def parts(self, scenes: Mapping[str, str | Scene], effort: Effort) -> Iterator[Part]:
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


def measured(name: str, given: str | Scene, effort: Effort, say: Say) -> dict[str, Any]:
    """Return the curves of a scene, what its matrix has to spare, and a sketch of its answer."""
    scene = parse(given) if isinstance(given, str) else given
    max_work = effort.entries / max(scene.problem.nonzeros, 1)
    say("tuning Ω and relaxations")
    entrants = comparison(scene.problem, start=scene.start, tolerance=1e-8, max_work=TRIAL * max_work)
    report = error_against_time(
        scene, entrants, REFERENCES, repeats=effort.repeats, max_seconds=effort.run_seconds, max_work=max_work,
        progress=say,
    )
    say("sketch")
    answer = best_answer(scene)
    return {
        "text": name,
        "report": report.to_content(),
        "dominance": _dominance(scene.problem),
        "sketch": None if answer is None else sketch_of(scene, answer),
    }


def _dominance(problem: Any) -> float:
    """Return the median of (m_ii − Σ_{j≠i} |m_ij|) / |m_ii|: 0 where a Laplacian has no zeroth-order term."""
    diagonal = problem.diagonal
    others = np.asarray(abs(problem.csr).sum(axis=1)).ravel() - np.abs(diagonal)
    usable = diagonal != 0.0
    if not usable.any():
        return -1.0
    return float(np.median((diagonal[usable] - others[usable]) / np.abs(diagonal[usable])))


# --- What is shown --------------------------------------------------------------------------------------------


def _article(content: dict[str, Any]) -> dict[str, Any]:
    report, name = Report.from_content(content["report"]), re.sub(r"\W+", "-", content["text"])
    ranking = sorted(report.curves, key=lambda curve: (not curve.is_solved, curve.seconds))
    sketch = content["sketch"]
    return {
        "name": name, "text": content["text"], "report": report,
        "sketch": None if sketch is None else figure(
            draw_sketch(sketch), f"{name}-sketch", f"{sketch['unknown']} of {content['text']}"
        ),
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


# --- Derivative error against time ------------------------------------------------------------------------------

DERIVED = ("half_active:n=10000", "paper_example_2:n=10000")
QUICK_DERIVED = ("half_active:n=2500",)
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
TOLD, LEAST = 1e-8, 1e-17  # the usual tolerance; an error of zero is drawn there
WAYS = {"derivative": "multigrid", "difference": "reference"}  # and the family that colours each


class Derivatives(Section):
    """How far dz/dq · h is from the exact one after how much time, and what difference of solves give."""

    kind = "derivative"
    anchor = "derivatives"
    place = 7
    title = "Derivative error against time"
    short = "Derivatives"
    table = "derivatives.csv"
    template = """<div class="card">
<p>How z changes with q in a direction for which the exact change is known, over the seconds from (M, q) on; each point
belongs to one tolerance from 1e-2 to 1e-10. Derivative: one solve, and one linear solve on its free rows. Difference:
two solves, with a step of the root of the tolerance between them.</p>
<div class="plots two">
{% for caption, figure in figures.items() %}
<figure class="profile"><figcaption>{{ caption }}</figcaption>{{ figure }}</figure>
{% endfor %}
</div>
</div>"""

    def parts(self, scenes: Mapping[str, str | Scene], effort: Effort) -> Iterator[Part]:
        """Yield one part for each scene that knows its answer."""
        chosen = scenes or {text: text for text in (QUICK_DERIVED if effort.is_quick else DERIVED)}
        for name, given in chosen.items():
            scene = parse(given) if isinstance(given, str) else given
            if scene.exact is not None and scene.steps == 1 and not is_at_bound(scene.problem, scene.exact).all():
                yield Part(self.kind, name, partial(_derived, name, scene, effort), effort)

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield how far both are off at the usual tolerance."""
        told = [point for point in self.rows(collected) if point["tolerance"] == TOLD]
        worst = {way: max(point["error"] for point in told if point["way"] == way) for way in WAYS}
        yield Finding(
            "Derivatives",
            f"On {many(len(collected.of(self.kind)), 'scene')} with a known answer, solved to {TOLD:g}, the "
            f"derivative of z is off by at most {brief(worst['derivative'])}, relatively; a difference of two "
            f"solves by up to {brief(worst['difference'])}.",
        )

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return a figure a scene."""
        found = collected.of(self.kind)
        return {"figures": {content["scene"]: _figure(content, k) for k, content in enumerate(found)}}

    def rows(self, collected: Collected) -> list[dict[str, Any]]:
        """Return every point."""
        return [{"scene": one["scene"]} | point for one in collected.of(self.kind) for point in one["points"]]


def _planted(problem: LCP, z: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return a random change of the exact z on its free rows, and a change of q that has it for its derivative.

    Rows at a bound stay there; where w = 0 as well, w grows to the side that holds them.
    """
    held, sizes = is_at_bound(problem, z), np.random.default_rng(0).uniform(0.5, 1.5, (2, problem.n))
    dz = np.where(held, 0.0, sizes[0])
    dw = np.where(held, np.where(z == problem.lower, sizes[1], -sizes[1]), 0.0) * problem.residual_scale
    return dz, dw - problem.csr @ dz


def _derived(name: str, scene: Scene, effort: Effort, say: Say) -> dict[str, Any]:
    problem, points = scene.problem, []
    exact, h = _planted(problem, np.asarray(scene.exact))
    for tolerance in TOLERANCES:
        say(f"{tolerance:g}")
        for way in WAYS:
            seconds = []
            for _ in range(effort.repeats + 1):  # the first one may compile
                stated_anew, began = fresh(problem), time.perf_counter()
                change = _change(way, stated_anew, h, tolerance)
                seconds.append(time.perf_counter() - began)
            error = np.abs(change - exact).max() / np.abs(exact).max()
            median = statistics.median(seconds[1:])
            points.append({"way": way, "tolerance": tolerance, "seconds": median, "error": float(error)})
    return {"scene": name, "n": scene.n, "points": points}


def _change(way: str, problem: LCP, h: FloatVector, tolerance: float) -> FloatVector:
    """Return dz for dq = h."""
    result = solve(problem, tolerance=tolerance)
    if way == "derivative":
        return derivative(result).jvp(dq=h)
    step = np.sqrt(tolerance) * np.abs(problem.q).max() / np.abs(h).max()
    change: FloatVector = (solve(problem.with_q(problem.q + step * h), tolerance=tolerance).z - result.z) / step
    return change


def _figure(content: dict[str, Any], number: int) -> Any:
    with styled():
        drawn, axes = new_figure()
        for way, family in WAYS.items():
            points = [point for point in content["points"] if point["way"] == way]
            seconds, errors = [one["seconds"] for one in points], [max(one["error"], LEAST) for one in points]
            axes.plot(seconds, errors, "o-", color=COLOURS[family], markersize=4.5, linewidth=1.0, label=way)
            for k in (0, -1) if way == "difference" else ():
                axes.annotate(f"{TOLERANCES[k]:.0e}", (seconds[k], errors[k]), (0, 6), textcoords="offset points",
                              color=COLOURS[family], fontsize=LABEL_SIZE, ha="center")
        axes.set(xscale="log", yscale="log", ylim=(LEAST / 3.0, 10.0), xlabel="seconds", ylabel="relative error of dz")
        axes.margins(x=0.12)
        axes.legend(loc="best")
    return figure(drawn, f"derivative-{number}", f"Derivative error against time on {content['scene']}")
