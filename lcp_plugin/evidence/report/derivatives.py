"""Derivative error against time, on scenes whose answer and so whose derivative is known."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from ...certificates.row_residuals import is_at_bound
from ...checks import FloatVector
from ...problem.lcp import LCP
from ...solving.derivative import derivative
from ...solving.driver import solve
from ..contestants import fresh
from ..drawing import COLOURS, LABEL_SIZE, new_figure, styled
from ..gallery import parse
from ..gallery.scene import Scene
from .section import Collected, Effort, Finding, Part, Say, Section, brief, figure, many

SCENES = ("half_active:n=10000", "paper_example_2:n=10000")
QUICK_SCENES = ("half_active:n=2500",)
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
TOLD, LEAST = 1e-8, 1e-17  # the usual tolerance; an error of zero is drawn there
WAYS = {"derivative": "multigrid", "difference": "reference"}  # and the family that colours each


class Derivatives(Section):
    """How far dz/dq · h is from the exact one after how much time, and what difference of solves give."""

    kind = "derivative"
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
        chosen = scenes or {text: text for text in (QUICK_SCENES if effort.is_quick else SCENES)}
        for name, given in chosen.items():
            scene = parse(given) if isinstance(given, str) else given
            if scene.exact is not None and scene.steps == 1 and not is_at_bound(scene.problem, scene.exact).all():
                yield Part(self.kind, name, partial(_computed, name, scene, effort), effort)

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


def _computed(name: str, scene: Scene, effort: Effort, say: Say) -> dict[str, Any]:
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
