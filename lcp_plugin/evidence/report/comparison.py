"""The comparison that the paper promises, and the performance profile: what the curves of all scenes say together."""

from __future__ import annotations

import math
import re
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ..curves import Curve, Report
from ..drawing import COLOURS
from ..profiles import Profile, performance_profile
from .section import PAGE_WIDTH, Collected, Finding, Section, count, figure, many, percent

SPLITTING = ("projected-type (NP)", "projected relaxation (P)", "modulus (M)", "general fixed point (GFP)")
WORTH_A_WORD = 1.1
NO_ROOM = 1e-3  # of the diagonal: below, M has no zeroth-order term worth the name
ACTIVE = (0.1, 0.9)
WIDEST = 6  # scenes in one table: what a telephone can show


class Comparison(Section):
    """Passes over M of every splitting method on the scenes with active constraints."""

    kind = "scene"
    place = 1
    title = "The comparison the paper promises"
    short = "Comparison"

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield what the passes say, the paper's promise first."""
        reports = collected.reports()
        yield from _promised(reports)
        yield from _own_examples(reports)
        yield from _slow_on_active(reports)
        yield from _tuning(reports)
        dominance = [content["dominance"] for content in collected.of("scene")]
        yield from _no_room([
            report for report, spare in zip(reports, dominance, strict=True)
            if -NO_ROOM <= spare <= NO_ROOM and report.curve("multigrid") is not None
        ])

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return the tables, each as wide as a telephone can show."""
        reports = with_active(collected.reports())
        chosen = [report for report in reports if any(curve.family in SPLITTING for curve in report.curves)]
        if not chosen:
            return {}
        width = -(-len(chosen) // -(-len(chosen) // WIDEST))
        families = {one.label: one.family for report in chosen for one in report.curves if one.family in SPLITTING}
        parts = [chosen[first : first + width] for first in range(0, len(chosen), width)]
        return {"comparison": [_table(part, families) for part in parts]}


# --- What is told ---------------------------------------------------------------------------------------------


def _work(report: Report, label: str) -> float | None:
    """Return the passes of a curve, None where there is none that is solved."""
    curve = report.curve(label)
    return _passes(curve) if curve is not None and curve.is_solved else None


def _passes(curve: Curve) -> float:
    """Return the passes of a curve, at least one: where the start is the answer there would be nothing to compare."""
    return max(curve.work, 1.0)


def with_active(reports: Sequence[Report]) -> list[Report]:
    """Return those with 10 to 90 % of the components at a bound."""
    return [report for report in reports if ACTIVE[0] <= report.active_share <= ACTIVE[1]]


def _promised(reports: Sequence[Report]) -> Iterator[Finding]:
    active = with_active(reports)
    chosen = [report for report in active if _splittings(report)]
    if not chosen:
        return
    wins = Counter(min(_splittings(report), key=_passes).family for report in chosen)
    said = ", ".join(f"{family} on {wins[family]}" for family in SPLITTING)
    text = (f"On {many(len(chosen), 'scene')} with 10 to 90 % of the constraints active, the family with "
            f"the fewest passes over M is {said}.")
    factors = [_behind(report, "projected-type (NP)") for report in chosen]
    finite = [factor for factor in factors if math.isfinite(factor)]
    if finite:
        text += (f" The best projected-type (NP) method, tuned or not, needs {statistics.median(finite):.1f} times the "
                 f"passes of the best splitting{_in_the_median(finite)}.")
    if len(active) > len(chosen):
        text += f" On {len(active) - len(chosen)} more no splitting converges."
    yield Finding("The comparison the paper promises", text)


def _in_the_median(values: Sequence[float]) -> str:
    return f" in the median ({min(values):.1f} to {max(values):.1f})" if len(values) > 1 else ""


def _splittings(report: Report) -> list[Curve]:
    return [curve for curve in report.curves if curve.family in SPLITTING and curve.is_solved]


def _behind(report: Report, family: str) -> float:
    every = _splittings(report)
    own = [_passes(curve) for curve in every if curve.family == family]
    return min(own, default=math.inf) / min(map(_passes, every))


def _own_examples(reports: Sequence[Report]) -> Iterator[Finding]:
    complete = [
        (pgs, npgs) for report in reports if report.title.startswith("paper_example") and _delta(report) == 4.0
        if (pgs := _work(report, "PGS")) and (npgs := _work(report, "NPGS paper"))
    ]
    if not complete:
        return
    ahead = sum(pgs < npgs for pgs, npgs in complete)
    figures = "; ".join(f"{pgs:.0f} passes against {npgs:.0f}" for pgs, npgs in complete)
    if ahead == len(complete):
        text = f"Plain projected Gauss–Seidel (PGS) beats NPGS on the paper's own examples: {figures}."
    elif ahead == 0:
        text = f"NPGS beats plain projected Gauss–Seidel (PGS) on the paper's own examples: PGS {figures}."
    else:
        text = f"PGS beats NPGS on {ahead} of {len(complete)} of the paper's own examples: {figures}."
    yield Finding("On the paper's own examples", text)


def _slow_on_active(reports: Sequence[Report]) -> Iterator[Finding]:
    free = {(report.n, _delta(report)): report for report in reports if report.title.startswith("paper_example_1")}
    for report in reports:
        other = free.get((report.n, _delta(report)))
        if not report.title.startswith("half_active") or other is None:
            continue
        sentences = [
            sentence for label in ("NPGS paper", "NPSOR paper", "NPSOR", "PGS")
            if (sentence := _ratio(label, _work(other, label), _work(report, label)))
        ]
        if sentences:
            text = f"From no constraint active to {percent(report.active_share)} of them, with the same matrix"
            text = f"{text} (n = {report.n}): {'; '.join(sentences)}."
            yield Finding(f"Active constraints, δ = {_delta(report):g}", text)


def _ratio(label: str, free: float | None, active: float | None) -> str:
    if not free or not active:
        return ""
    factor = active / free
    if factor > WORTH_A_WORD:
        return f"{label} slows down {factor:.1f} times ({free:.0f} to {active:.0f} passes)"
    if factor < 1.0 / WORTH_A_WORD:
        return f"{label} gets {1.0 / factor:.1f} times quicker ({free:.0f} to {active:.0f} passes)"
    return f"{label} stays as it is ({free:.0f} and {active:.0f} passes)"


def _delta(report: Report) -> float:
    found = re.search(r"\bdelta=([^,]+)", report.title)
    return float(found[1]) if found else math.nan


def _tuning(reports: Sequence[Report]) -> Iterator[Finding]:
    for family, tuned, printed, rival in (
        ("MSOR", "MSOR tuned", "MSOR paper", "PSOR"), ("NPSOR", "NPSOR tuned", "NPSOR paper", "PSOR"),
    ):
        gains = [p / t for report in reports if (t := _work(report, tuned)) and (p := _work(report, printed))]
        against = [t / r for report in reports if (t := _work(report, tuned)) and (r := _work(report, rival))]
        if gains and against:
            behind = sum(factor > 1.0 for factor in against)
            measured = f"median of {len(gains)} scenes" if len(gains) > 1 else "on 1 scene"
            yield Finding(
                f"What tuning {family} buys",
                f"Its parameters tuned on each very problem, {family} needs {statistics.median(gains):.1f} times fewer "
                f"passes than with the paper's ({measured}). {rival}, which finds its relaxation "
                f"by itself, needs fewer on {behind} of {len(against)}.",
            )


def _no_room(chosen: Sequence[Report]) -> Iterator[Finding]:
    if not chosen:
        return

    def wins(cost: Callable[[Curve], float]) -> int:
        solved = ([curve for curve in report.curves if curve.is_solved] for report in chosen)
        return sum(min(curves, key=cost).label == "multigrid" for curves in solved if curves)

    factors = [
        min(map(_passes, found)) / own
        for report in chosen if (found := _splittings(report)) and (own := _work(report, "multigrid"))
    ]
    text = (f"On {many(len(chosen), 'scene')} whose matrix has no diagonal to spare (no zeroth-order term, δ = 0) "
            f"multigrid needs the fewest passes on {wins(lambda curve: curve.work)} and the least time on "
            f"{wins(lambda curve: curve.seconds)}.")
    if factors:
        spread = " to ".join(dict.fromkeys(f"{factor:.1f}" for factor in (min(factors), max(factors))))
        text += f" The best splitting needs {spread} times its passes."
    lost = sum(not _splittings(report) for report in chosen)
    if lost:
        text += f" On {lost} of them no splitting converges within the limit of work."
    yield Finding("Multigrid and δ = 0", text)


# --- What is shown --------------------------------------------------------------------------------------------


def _table(reports: Sequence[Report], families: dict[str, str]) -> dict[str, Any]:
    deltas = [_delta(one) for one in reports]  # what tells two settings of one scene apart
    heads = [
        (one.title.partition(":")[0], "" if math.isnan(delta) else f"δ = {delta:g}", percent(one.active_share))
        for one, delta in zip(reports, deltas, strict=True)
    ]
    rows = [
        {"label": label, "colour": COLOURS[family], "cells": [_cell(one.curve(label), one) for one in reports]}
        for label, family in families.items()
    ]
    return {"heads": heads, "rows": rows}


def _cell(curve: Curve | None, report: Report) -> tuple[str, bool]:
    """Return the passes and whether they are the fewest of all splittings on that scene."""
    if curve is None:
        return "·", False
    if not curve.is_solved:
        return "✕", False
    best = min(one.work for one in report.curves if one.family in SPLITTING and one.is_solved)
    return count(curve.work), curve.work == best


# --- The performance profile -------------------------------------------------------------------------------------


class PerformanceProfile(Section):
    """Shares of the scenes within a multiple of the best, by work and by time."""

    kind = "scene"
    anchor = "profile"
    place = 3
    title = "Performance profile"
    short = "Profile"
    template = """<div class="card">
<p>On how many of the scenes an algorithm converges within a multiple of the best one's cost. At the left end: how often
it is the best; a ✕ behind a name says that it does not solve all of them.</p>
<div class="plots two">
{% for caption, figure in figures.items() %}
<figure class="profile"><figcaption>{{ caption }}</figcaption>{{ figure }}</figure>
{% endfor %}
</div>
</div>"""

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield who is first how often, and who solved every scene."""
        for work, seconds in _profiles(collected):
            by_work, by_time = (max(one.labels, key=one.share) for one in (work, seconds))
            every = [label for label in work.labels if work.share(label, math.inf) == 1.0]
            yield Finding(
                "Over all scenes",
                f"Of {many(len(work.problems), 'scene')} {by_work} has the fewest passes on "
                f"{percent(work.share(by_work))}, {by_time} the least time on {percent(seconds.share(by_time))}. "
                f"Solved every one: {', '.join(every) or 'nobody'}.",
            )

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return both figures."""
        figures = {
            f"By {caption}": figure(
                profile.plot(width=PAGE_WIDTH), f"profile-{profile.by}", f"Performance profile by {profile.by}"
            )
            for pair in _profiles(collected) for profile, caption in zip(pair, ("passes over M", "time"), strict=True)
        }
        return {"figures": figures} if figures else {}

    def files(self, collected: Collected) -> dict[str, str]:
        """Return every ratio."""
        return {f"profile_{profile.by}.csv": profile.to_csv() for pair in _profiles(collected) for profile in pair}

    def content(self, collected: Collected) -> dict[str, Any]:
        """Return every ratio."""
        return {"profiles": [profile.to_content() for pair in _profiles(collected) for profile in pair]}


def _profiles(collected: Collected) -> Iterator[tuple[Profile, Profile]]:
    """Yield the profiles by work and by seconds, where there are two scenes and one was solved."""
    reports = collected.reports()
    if len(reports) > 1 and any(curve.is_solved for report in reports for curve in report.curves):
        yield performance_profile(reports, "work"), performance_profile(reports, "seconds")
