"""The paper's Tables 1 and 2 computed again, cell by cell, beside what it prints."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from ..algorithms import create
from ..core.algorithm import Algorithm
from ..core.certificates.row_residuals import euclidean_norm
from ..core.checks import FloatVector
from ..core.lcp import LCP
from ..gallery import build
from .contestants import fresh, paper_options
from .exporting import Table

TOLERANCE = 1e-5
DELTA = 4.0
MOST_ITERATIONS = 1000  # the paper's largest count is 59
PAPER_HEADINGS = (
    "algorithm",
    "n",
    "paper IT",
    "IT",
    "paper Res",
    "Res",
    "paper CPU",
    "CPU",
    "same IT",
    "same Res",
)


@dataclass(frozen=True)
class PaperCell:
    """One column of one row: the paper's IT, CPU and Res, and ours."""

    example: int
    algorithm: str
    relaxation: float | None
    n: int
    paper_iterations: int
    paper_seconds: float
    paper_residual: float
    iterations: int
    seconds: float
    residual: float

    @property
    def same_iterations(self) -> bool:
        """Whether IT agrees."""
        return self.iterations == self.paper_iterations

    @property
    def same_residual(self) -> bool:
        """Whether Res agrees to the two digits that the paper prints."""
        return f"{self.residual:.1e}" == f"{self.paper_residual:.1e}"


def published() -> dict[str, Any]:
    """Return the paper's figures (n = 100 … 10 000 in both tables, the misprinted 254 read as 24)."""
    text = files(__package__).joinpath("paper_tables.json").read_text(encoding="utf-8")
    content: dict[str, Any] = json.loads(text)
    return content


def cells() -> Iterator[PaperCell]:
    """Yield every cell of both tables, computed now.

    Stop at ‖min(z, Mz + q)‖₂ < 1e-5 from z = (1, 0, 1, 0, …); no row scaling; Ω = D/2 for MGS and D/(2α²)
    for MSOR, which are the values behind the printed figures.
    """
    tables = published()
    for example in (1, 2):
        for name, row in tables[f"example_{example}"].items():
            for column, n in enumerate(tables["n"]):
                scene = build(f"paper_example_{example}", n=n, delta=DELTA)
                algorithm = create(name, paper_options(name, row.get("relaxation")))
                for _ in range(2):  # the first one may compile
                    _, *measured = iterated(fresh(scene.problem), scene.start, algorithm)
                count, seconds, residual = measured
                yield PaperCell(
                    example,
                    name,
                    row.get("relaxation"),
                    n,
                    row["iterations"][column],
                    row["seconds"][column],
                    row["residual"][column],
                    int(count),
                    seconds,
                    residual,
                )


def iterated(
    problem: LCP, start: FloatVector | None, algorithm: Algorithm
) -> tuple[FloatVector, int, float, float]:
    """Return z, the iterations until Res is below the paper's ε, their seconds, and Res."""
    begin, z = time.perf_counter(), np.array(problem.nearest_to_zero if start is None else start)
    count, residual = 0, math.inf
    for count, step in enumerate(algorithm.iterates(problem, z)):
        z = step.z
        residual = euclidean_norm(np.minimum(z, problem.slack(z)), problem.matrix)
        if residual < TOLERANCE or count >= MOST_ITERATIONS:
            break
    return z, count, time.perf_counter() - begin, residual


def paper_table(computed: Iterable[PaperCell], example: int) -> Table:
    """Return one of the paper's tables, each printed figure beside the computed one."""
    rows = [
        (
            f"{one.algorithm} {one.relaxation or ''}".strip(),
            one.n,
            one.paper_iterations,
            one.iterations,
            one.paper_residual,
            float(f"{one.residual:.2g}"),
            one.paper_seconds,
            float(f"{one.seconds:.2g}"),
            "yes" if one.same_iterations else "NO",
            "yes" if one.same_residual else "no",
        )
        for one in computed
        if one.example == example
    ]
    return Table(
        f"The paper's Table {example}: Example {example}, δ = {DELTA:g}", PAPER_HEADINGS, rows
    )
