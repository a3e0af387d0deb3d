"""The paper's Tables 1 and 2 computed again, cell by cell, beside what it prints."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from time import perf_counter
from typing import Any

from ..algorithms import Algorithm, create
from ..certificates.residuals import Certificate
from ..checks import FloatVector
from ..problem.lcp import LCP
from .gallery import build

TOLERANCE = 1e-5
MOST_ITERATIONS = 100_000
DELTA = 4.0


@dataclass(frozen=True)
class Cell:
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


def cells() -> Iterator[Cell]:
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
                _, count, seconds, residual = iterated(scene.problem, scene.start, algorithm)
                yield Cell(
                    example, name, row.get("relaxation"), n, row["iterations"][column], row["seconds"][column],
                    row["residual"][column], count, seconds, residual,
                )


def iterated(
    problem: LCP, start: FloatVector | None, algorithm: Algorithm
) -> tuple[FloatVector, int, float, float]:
    """Return z, the iterations until Res is below the paper's ε, their seconds without compilation, and Res."""
    z0 = problem.nearest_to_zero if start is None else start
    next(algorithm.iterates(problem, z0))
    z, count, residual, begin = z0, 0, math.inf, perf_counter()
    for count, step in enumerate(algorithm.iterates(problem, z0)):
        z, told = step.z, step.euclidean
        residual = Certificate.of(problem, z).euclidean_residual if told is None else told
        if residual < TOLERANCE or count >= MOST_ITERATIONS:
            break
    return z, count, perf_counter() - begin, residual


def paper_options(name: str, relaxation: float | None) -> dict[str, Any]:
    """Return the options that the paper's tables were computed with."""
    if name.startswith("np"):
        return {"scaling": None} | ({"relaxation": relaxation} if relaxation else {})
    if name == "msor" and relaxation:
        return {"relaxation": relaxation, "omega": 1.0 / (2.0 * relaxation**2)}
    return {"omega": 0.5}
