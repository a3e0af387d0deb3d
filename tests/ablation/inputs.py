"""Inputs that are solved with and without a mechanism: applications, published problems, and cases of the campaign.

All are judged by references, exact arithmetic or other solvers, never by a status.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from applications.table import FALSE_FROM, Case, cases
from inputs.published_problems import (
    COMPLEMENTARITY,
    CONTACTS,
    PROGRAMS,
    PublishedProgram,
    errors_of_contact,
    errors_of_lcp,
    read,
)

from lcp_plugin import LCP, FrictionalContact, QuadraticProgram, solve

RIGHT, OPEN, FALSE = "right", "open", "false"
TOLERANCE = 1e-6  # of published problems
MOST_UNKNOWNS = 2500  # of published programs
ROUNDS = 2  # of the campaign


@dataclass(frozen=True)
class Input:
    """An input problem: its source, its name, a solver and a judge of the result: RIGHT, OPEN or FALSE."""

    source: str
    name: str
    solve: Callable[[], Any]
    judge: Callable[[Any], str]


def applications() -> Iterator[Input]:
    """Yield applications, unscaled and scaled, and membranes for which grids are made."""
    membranes = [Case("obstacle_2d", {"side": side}) for side in (150, 300)]
    for case in (*cases(full=False), *membranes):
        for units in ("own", "both"):
            yield Input(
                "applications",
                f"{case.name} {units}",
                partial(case.run, "auto", units),
                partial(_by_reference, case),
            )


def _by_reference(case: Case, ran: Any) -> str:
    result, z = ran
    if not result.is_solved:
        return OPEN
    return RIGHT if case.error(z, [z]) < FALSE_FROM else FALSE


def published() -> Iterator[Input]:
    """Yield published problems."""
    for name in COMPLEMENTARITY:
        yield _published(
            name,
            lambda of: LCP(of["M"], of["q"], lower=of["lower"], upper=of["upper"]),
            errors_of_lcp,
        )
    for name in CONTACTS:
        yield _published(
            f"fc3d_{name}",
            lambda of: FrictionalContact(of["M"], of["q"], of["mu"]),
            errors_of_contact,
        )
    for name in (name for name, n in PROGRAMS.items() if n <= MOST_UNKNOWNS):
        program = PublishedProgram.read(name)
        rows = program.P, program.q, program.A, program.l, program.u
        yield Input(
            "published",
            name,
            lambda rows=rows: solve(QuadraticProgram.from_ranges(*rows)),
            partial(_by_errors, lambda x, program=program: max(program.errors(x))),
        )


def _published(
    name: str, problem: Callable[[Any], Any], errors: Callable[[Any, Any], float]
) -> Input:
    arrays = read(name)
    return Input(
        "published",
        name,
        lambda: solve(problem(arrays)),
        partial(_by_errors, partial(errors, arrays)),
    )


def _by_errors(errors: Callable[[Any], float], result: Any) -> str:
    if not result.is_solved:
        return OPEN
    return RIGHT if errors(result.x) <= TOLERANCE else FALSE


def campaign() -> Iterator[Input]:
    """Yield cases of the campaign; times include the judgement."""
    from campaigns.kinds import ROUND, SCHEDULE, VIOLATIONS

    def judge(findings: list[Any]) -> str:
        if any(what in VIOLATIONS for what, _ in findings):
            return FALSE
        return OPEN if findings else RIGHT

    for number in range(ROUNDS * len(SCHEDULE)):
        name, kind = SCHEDULE[number % len(SCHEDULE)]
        yield Input(
            name,
            f"{kind} {number}",
            lambda case=ROUND[name][0], kind=kind, number=number: [
                *case(np.random.default_rng(number), kind)
            ],
            judge,
        )


def inputs() -> Iterator[Input]:
    """Yield all inputs."""
    yield from applications()
    yield from published()
    yield from campaign()
