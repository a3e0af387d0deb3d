"""What a report computes: parts that can be computed one by one, each a function without arguments."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from ..gallery import names, parse
from ..gallery.scene import Scene

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
CHECKED = (
    "paper_example_1:n=900", "half_active:n=900", "obstacle_2d:size=30", "obstacle_bumps:size=30",
    "optimal_stopping:size=20", "journal_bearing:size=30", "american_put:size=301", "rigid_stack", "market_equilibrium",
)
TOO_LONG_FOR_QUICK = ("sizes",)  # families of the stability atlas
REFERENCES = ("osqp", "clarabel")
TRIAL = 0.25  # of the work a run may do: the limit of one trial of the tuning
SAY = Callable[[str], object]


@dataclass(frozen=True)
class Effort:
    """How much a report spends: repeats, entries of M a run may touch, and the seconds of a run and a reference."""

    repeats: int
    entries: float
    run_seconds: float
    reference_seconds: float
    is_quick: bool


FULL = Effort(repeats=3, entries=5e8, run_seconds=30.0, reference_seconds=20.0, is_quick=False)
QUICK = Effort(repeats=3, entries=1e8, run_seconds=5.0, reference_seconds=3.0, is_quick=True)


@dataclass(frozen=True)
class Part:
    """One piece of the report: its kind, its name within the kind, how it is computed, and a hash of its own data."""

    kind: str
    name: str
    compute: Callable[[SAY], dict[str, Any]]
    effort: Effort
    data: str = ""

    @property
    def settings(self) -> str:
        """Everything that the content depends on, as text."""
        return json.dumps([self.kind, self.name, asdict(self.effort), self.data])


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
    own = [text for text in (QUICK_SCENES if quick else SCENES) if text.partition(":")[0] in names()]
    chosen = {scene if isinstance(scene, str) else scene.name: scene for scene in scenes or own}
    for scene in scenes:
        if isinstance(scene, str):
            parse(scene)
    parts = [
        Part("scene", name, partial(_scene, name, scene, effort), effort, _hash(scene))
        for name, scene in chosen.items()
    ]
    if not scenes:
        parts += [
            Part("check", text, partial(_check, text, effort), effort) for text in CHECKED[: 5 if quick else None]
        ]
        parts.append(Part("tables", "paper", _tables, effort))
        parts += [Part("atlas", family, partial(_atlas, family, effort), effort) for family in _families(effort)]
    return parts


def _families(effort: Effort) -> list[str]:
    from ..stability.stresses import FAMILIES

    return [family for family in FAMILIES if not (effort.is_quick and family in TOO_LONG_FOR_QUICK)]


def _hash(scene: str | Scene) -> str:
    """Return a hash of the problem, as the content of a file may be another one next time; nothing of a text."""
    if isinstance(scene, str):
        return ""
    problem = scene.problem
    arrays = (problem.csr.indptr, problem.csr.indices, problem.csr.data, problem.q, problem.lower, problem.upper)
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def _scene(name: str, given: str | Scene, effort: Effort, say: SAY) -> dict[str, Any]:
    from ..contestants import comparison
    from ..error_against_time import best_answer, error_against_time
    from ..pictures import sketch_of

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
    import numpy as np

    diagonal = problem.diagonal
    others = np.asarray(abs(problem.csr).sum(axis=1)).ravel() - np.abs(diagonal)
    usable = diagonal != 0.0
    if not usable.any():
        return -1.0
    return float(np.median((diagonal[usable] - others[usable]) / np.abs(diagonal[usable])))


def _check(text: str, effort: Effort, say: SAY) -> dict[str, Any]:
    from ..cross_check import cross_validate
    from ..exporting import finite_content

    problem = parse(text).problem
    outcome = cross_validate(problem, max_seconds=effort.reference_seconds)
    found: dict[str, Any] = finite_content({
        "scene": text, "n": problem.n, "verdict": outcome.verdict, "reason": outcome.reason,
        "reference": outcome.reference, "difference_z": outcome.difference_z, "difference_w": outcome.difference_w,
        "ours": outcome.ours.relative_residual,
        "theirs": None if outcome.theirs is None else outcome.theirs.relative_residual,
    })
    return found


def _tables(say: SAY) -> dict[str, Any]:
    from ..exporting import finite_content
    from ..paper_tables import cells

    return {"cells": [finite_content(asdict(cell)) for cell in cells()]}


def _atlas(family: str, effort: Effort, say: SAY) -> dict[str, Any]:
    from ..stability import stability_atlas

    def progress(done: int, total: int, label: str) -> None:
        say(f"{done} of {total}, {label}")

    return stability_atlas(stresses=[family], quick=effort.is_quick, progress=progress).to_content()
