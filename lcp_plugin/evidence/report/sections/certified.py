"""What solvers' answers to convex programs are worth: proved, unproved or refuted by `certify`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from typing import Any

from ...certified_solvers import OURS, judged_answers
from ...exporting import csv_of, finite_content
from ...sample_programs import SAMPLES
from ..section import Collected, Compute, Effort, Finding, Say, Section, brief, many

ASKED = (OURS, "CLARABEL", "PIQP", "HIGHS", "OSQP", "SCS")
IN_WORDS = {OURS: "ours"}
RANKS = ("proved to 1e-06", "proved to 1e-03", "unproved", "refuted", "no answer")


class Certified(Section):
    """A table program × solver of what `certify` proves of the answers, solvers at their own settings."""

    kind = "certified"
    place = 8
    title = "What answers to convex programs are worth"
    short = "Proved answers"

    def work(self, effort: Effort) -> dict[str, Compute]:
        """Return one part a program."""
        return {name: partial(_computed, name, effort) for name in SAMPLES}

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield what is proved of each solver's answers."""
        found = collected.of(self.kind)
        if not found:
            return
        said = []
        for solver in dict.fromkeys(answer["solver"] for content in found for answer in content["answers"]):
            ranks = Counter(
                answer["verdict"] for content in found for answer in content["answers"] if answer["solver"] == solver
            )
            figures = ", ".join(f"{ranks[rank]} {_in_words(rank)}" for rank in RANKS if ranks[rank])
            said.append(f"{IN_WORDS.get(solver, solver)} {figures}")
        text = f"Answers to {many(len(found), 'convex program')}, at each solver's own settings: {'; '.join(said)}."
        yield Finding("What is proved of solvers' answers", text)

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return one row a program, a column a solver."""
        found = collected.of(self.kind)
        solvers = list(dict.fromkeys(answer["solver"] for content in found for answer in content["answers"]))
        rows = []
        for content in found:
            answers = {answer["solver"]: answer for answer in content["answers"]}
            cells = [_cell(answers[solver]) if solver in answers else ("·", "", "") for solver in solvers]
            rows.append({"program": content["program"], "size": content["size"], "cells": cells})
        return {"solvers": [IN_WORDS.get(name, name) for name in solvers], "rows": rows} if found else {}

    def files(self, collected: Collected) -> dict[str, str]:
        """Return one row an answer."""
        rows = [
            {"program": content["program"]} | answer for content in collected.of(self.kind)
            for answer in content["answers"]
        ]
        return {"certified.csv": csv_of(rows)} if rows else {}


def _computed(name: str, effort: Effort, say: Say) -> dict[str, Any]:
    import cvxpy as cp

    program, answers = SAMPLES[name](), []
    installed = {OURS, *cp.installed_solvers()}
    for answer in judged_answers(
        program, [solver for solver in ASKED if solver in installed], max_seconds=effort.reference_seconds
    ):
        say(answer.solver)
        answers.append(answer.to_content())
    found: dict[str, Any] = finite_content({"program": name, "size": repr(program), "answers": answers})
    return found


def _in_words(rank: str) -> str:
    return rank.replace("e-0", "e-")


def _cell(answer: dict[str, Any]) -> tuple[str, str, str]:
    """Return what stands in the table, its class, and what is told where a mouse rests on it."""
    verdict = answer["verdict"]
    kind = {RANKS[0]: "best", "refuted": "bad"}.get(verdict, "")
    numbers = ", ".join(f"{key} {brief(answer[key])}" for key in ("violation", "gap") if answer.get(key) is not None)
    claim = answer.get("claim", "optimal")
    if claim != "optimal":
        text = f"{claim}: {verdict.partition(' to ')[0]}"
    else:
        text = _in_words(verdict).removeprefix("proved to ") if verdict in RANKS[:2] else verdict
    return text, kind, "; ".join(filter(None, (answer["status"], numbers, answer.get("reason"))))
