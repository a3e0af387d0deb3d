"""What the measurements say, in sentences computed from them: each claim can come out either way."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..curves import Curve, Report
from ..performance_profile import performance_profile
from .collect import Collected

SPLITTING = {
    "projected-type (NP)": "NP", "projected relaxation (P)": "P", "modulus (M)": "M",
    "general fixed point (GFP)": "GFP",
}
WORTH_A_WORD = 1.1
NO_ROOM = 1e-3  # of the diagonal: below, M has no zeroth-order term worth the name
ACTIVE = (0.1, 0.9)


@dataclass(frozen=True)
class Claim:
    """A heading of a few words and the sentence with the figures."""

    heading: str
    text: str


def claims(collected: Collected) -> list[Claim]:
    """Return what the collected parts say, the paper's promise first; nothing is said where data are missing."""
    scenes = [(content, Report.from_content(content["report"])) for content in collected.of("scene")]
    reports = [report for _, report in scenes]
    found: list[Iterator[Claim]] = [
        _promised(reports), _own_examples(reports), _slow_on_active(reports), _tuning(reports), _no_room(scenes),
        _profile(reports), _tables(collected), _checks(collected), _atlas(collected),
    ]
    return [claim for some in found for claim in some]


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _work(report: Report, *labels: str) -> list[float]:
    """Return the passes of those of the labels that were solved."""
    curves = (report.curve(label) for label in labels)
    return [_passes(curve) for curve in curves if curve is not None and curve.is_solved]


def _passes(curve: Curve) -> float:
    """Return the passes of a curve, at least one: where the start is the answer there would be nothing to compare."""
    return max(curve.work, 1.0)


def with_active(reports: Sequence[Report]) -> list[Report]:
    """Return those with 10 to 90 % of the components at a bound."""
    return [report for report in reports if ACTIVE[0] <= report.active_share <= ACTIVE[1]]


def _promised(reports: Sequence[Report]) -> Iterator[Claim]:
    active = with_active(reports)
    chosen = [report for report in active if _splittings(report)]
    if not chosen:
        return
    wins = Counter(SPLITTING[min(_splittings(report), key=lambda one: one.work).family] for report in chosen)
    said = ", ".join(f"{family} on {wins[short]}" for family, short in SPLITTING.items())
    text = (f"On {_many(len(chosen), 'scene')} with 10 to 90 % of the constraints active, the family with "
            f"the fewest passes over M is {said}.")
    factors = [_behind(report, "projected-type (NP)") for report in chosen]
    finite = [factor for factor in factors if math.isfinite(factor)]
    if finite:
        text += (f" The best projected-type (NP) method, tuned or not, needs {statistics.median(finite):.1f} times the "
                 f"passes of the best splitting in the median ({min(finite):.1f} to {max(finite):.1f}).")
    if len(active) > len(chosen):
        text += f" On {len(active) - len(chosen)} more no splitting arrives."
    yield Claim("The comparison the paper promises", text)


def _splittings(report: Report) -> list[Curve]:
    return [curve for curve in report.curves if curve.family in SPLITTING and curve.is_solved]


def _behind(report: Report, family: str) -> float:
    every = _splittings(report)
    own = [_passes(curve) for curve in every if curve.family == family]
    return min(own, default=math.inf) / min(map(_passes, every))


def _own_examples(reports: Sequence[Report]) -> Iterator[Claim]:
    own = [report for report in reports if report.title.startswith("paper_example") and "delta=4.0" in report.title]
    pairs = [(*_work(report, "PGS"), *_work(report, "NPGS paper")) for report in own]
    complete = [pair for pair in pairs if len(pair) == 2]
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
    yield Claim("On the paper's own examples", text)


def _slow_on_active(reports: Sequence[Report]) -> Iterator[Claim]:
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
            text = f"From no constraint active to {_percent(report.active_share)} of them, with the same matrix"
            text = f"{text} (n = {report.n}): {'; '.join(sentences)}."
            yield Claim(f"Active constraints, δ = {_delta(report):g}", text)


def _ratio(label: str, free: list[float], active: list[float]) -> str:
    if not free or not active:
        return ""
    factor = active[0] / free[0]
    if factor > WORTH_A_WORD:
        return f"{label} slows down {factor:.1f} times ({free[0]:.0f} to {active[0]:.0f} passes)"
    if factor < 1.0 / WORTH_A_WORD:
        return f"{label} gets {1.0 / factor:.1f} times quicker ({free[0]:.0f} to {active[0]:.0f} passes)"
    return f"{label} stays as it is ({free[0]:.0f} and {active[0]:.0f} passes)"


def _delta(report: Report) -> float:
    for word in report.title.partition(":")[2].split(","):
        name, _, value = word.partition("=")
        if name == "delta":
            return float(value)
    return math.nan


def _tuning(reports: Sequence[Report]) -> Iterator[Claim]:
    for family, tuned, printed, rival in (
        ("MSOR", "MSOR tuned", "MSOR paper", "PSOR"), ("NPSOR", "NPSOR tuned", "NPSOR paper", "PSOR"),
    ):
        gains = [p[0] / t[0] for report in reports if (t := _work(report, tuned)) and (p := _work(report, printed))]
        against = [t[0] / r[0] for report in reports if (t := _work(report, tuned)) and (r := _work(report, rival))]
        if gains and against:
            behind = sum(factor > 1.0 for factor in against)
            yield Claim(
                f"What tuning {family} buys",
                f"Its parameters tuned on each very problem, {family} needs {statistics.median(gains):.1f} times fewer "
                f"passes than with the paper's (median of {len(gains)} scenes). {rival}, which finds its relaxation "
                f"by itself, needs fewer on {behind} of {len(against)}.",
            )


def _no_room(scenes: Sequence[tuple[dict[str, Any], Report]]) -> Iterator[Claim]:
    chosen = [
        report for content, report in scenes
        if -NO_ROOM <= content["dominance"] <= NO_ROOM and report.curve("multigrid") is not None
    ]
    if not chosen:
        return

    def wins(cost: Callable[[Curve], float]) -> int:
        solved = ([curve for curve in report.curves if curve.is_solved] for report in chosen)
        return sum(min(curves, key=cost).label == "multigrid" for curves in solved if curves)

    factors = [
        min(map(_passes, found)) / own[0]
        for report in chosen if (found := _splittings(report)) and (own := _work(report, "multigrid"))
    ]
    text = (f"On {_many(len(chosen), 'scene')} whose matrix has no diagonal to spare (no zeroth-order term, δ = 0) "
            f"multigrid needs the fewest passes on {wins(lambda curve: curve.work)} and the least time on "
            f"{wins(lambda curve: curve.seconds)}.")
    if factors:
        text += f" The best splitting needs {min(factors):.1f} to {max(factors):.1f} times its passes."
    lost = sum(not _splittings(report) for report in chosen)
    if lost:
        text += f" On {lost} of them no splitting arrives within the limit of work."
    yield Claim("Multigrid and δ = 0", text)


def _profile(reports: Sequence[Report]) -> Iterator[Claim]:
    if len(reports) < 2:
        return
    work, seconds = performance_profile(reports, "work"), performance_profile(reports, "seconds")
    if not work.problems:
        return
    by_work = max(work.labels, key=work.share)
    by_time = max(seconds.labels, key=seconds.share)
    every = [label for label in work.labels if work.share(label, math.inf) == 1.0]
    yield Claim(
        "Over all scenes",
        f"Of {len(work.problems)} scenes {by_work} has the fewest passes on {_percent(work.share(by_work))}, "
        f"{by_time} the least time on {_percent(seconds.share(by_time))}. "
        f"Solved every one: {', '.join(every) or 'nobody'}.",
    )


def _tables(collected: Collected) -> Iterator[Claim]:
    for content in collected.of("tables"):
        cells = content["cells"]
        equal = sum(cell["iterations"] == cell["paper_iterations"] for cell in cells)
        yield Claim("The paper's tables", f"The iteration counts agree in {equal} of {len(cells)} cells, computed now.")


def _checks(collected: Collected) -> Iterator[Claim]:
    verdicts = Counter(content["verdict"] for content in collected.of("check"))
    if verdicts:
        said = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common())
        yield Claim("Against convex solvers", f"Cross-validation of {_many(verdicts.total(), 'scene')}: {said}.")


def _atlas(collected: Collected) -> Iterator[Claim]:
    atlas = whole_atlas(collected)
    if atlas is not None and atlas.cells:
        text = (f"{len(atlas.cells)} runs on stiff, extreme and degenerate problems: {len(atlas.lies)} lies; of the "
                f"{len(atlas.well_posed)} well-posed ones {_percent(atlas.solved_share)} are SOLVED.")
        if atlas.misleading:
            well_posed = sum(cell.is_well_posed for cell in atlas.misleading)
            text += (f" {len(atlas.misleading)} of the SOLVED ones hide an error of more than a thousandth behind a "
                     f"small residual, {well_posed} of them well-posed.")
        yield Claim("Stability", text)


def whole_atlas(collected: Collected) -> Any:
    """Return the atlas of all families, or None."""
    contents = collected.of("atlas")
    if not contents:
        return None
    from ..stability import Atlas

    atlas = Atlas((), ())
    for content in contents:
        atlas = atlas + Atlas.from_content(content)
    return atlas
